"""What a check hands back."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mcrim_mitsuba.errors import InputError


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a scene.

    Attributes
    ----------
    kind : str
        ``index``, ``missing_face``, ``leak``, ``reversed_face``, ``overlap``, ``thin_gap``,
        ``coefficient``, ``unit``, ``detector``, ``surface``, ``value`` or ``file``.
    text, mend : str
        What is wrong; what to do.
    path : Path or str
        None for a file that has no name.
    line : int or None
    """

    kind: str
    text: str
    mend: str
    path: Path | str | None
    line: int | None = None
    column: str | int | None = None

    def error(self) -> InputError:
        """The problem as the exception that the command line prints."""
        return InputError(self.text, self.mend, path=self.path, line=self.line, column=self.column)

    def __str__(self) -> str:
        return str(self.error())


@dataclass(frozen=True)
class Interface:
    """A face and what it says of its two sides.

    Attributes
    ----------
    surface : str
        Id of the shape.
    kind : str
        What light meets there.
    interior, exterior : str
        Volumes behind and in front of it; ``outside`` where none is named.
    n_interior, n_exterior : float or None
        Refractive indices; ``None`` for surfaces that have none (detector, reflector).
    path : Path
    line : int
        Where the shape is written.
    """

    surface: str
    kind: str
    interior: str
    exterior: str
    n_interior: float | None
    n_exterior: float | None
    path: Path
    line: int | None


@dataclass(frozen=True)
class CheckReport:
    """The result of `check_scene`.

    Attributes
    ----------
    ok : bool
    problems : tuple of Problem
        Most basic first; later checks are left out where an earlier one makes them meaningless.
    parameters : dict
        Effective scene parameters.
    interfaces : tuple of Interface
    words : tuple of str
        What the scene means, in sentences.
    """

    problems: tuple[Problem, ...]
    parameters: dict[str, object]
    interfaces: tuple[Interface, ...] = ()
    words: tuple[str, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.problems
