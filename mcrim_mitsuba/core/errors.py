"""The one exception that means: the user's input is wrong, not our code; and words for it."""

from __future__ import annotations

import contextlib
import difflib
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

#: Characters of a problem: what was given may be a megabyte, and the line is for a person.
_LONGEST = 1200
#: Characters of a mend, which may list names.
_LONGEST_MEND = 2000
#: Longer names are no slips, and comparing them takes long.
_LONGEST_NAME = 200


class InputError(ValueError):
    """Something the user gave cannot be used.

    Rendered as one line, ``place: what is wrong; how to mend it``, which the command line prints as
    it is and leaves with exit status 2. The problem has the value that was given. It came from the
    file `path`, its `line`, counted from 1, and its `column`: a name (CSV) or a position counted
    from 1 (XML, TOML).
    """

    def __init__(
        self,
        problem: str,
        mend: str,
        *,
        path: str | Path | None = None,
        line: int | None = None,
        column: str | int | None = None,
    ) -> None:
        self.problem = problem
        self.mend = mend
        self.path = None if path is None else str(path)
        self.line = line
        self.column = column
        self.others: tuple[InputError, ...] = ()  # what else was found wrong on the way
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # exceptions are pickled by their message, which is not what they are made of
        return type(self).__new__, (type(self), *self.args), self.__dict__

    @property
    def place(self) -> str:
        """``file, line 3, column signal``, or an empty string."""
        parts = {"": self.path or None, "line ": self.line, "column ": self.column}
        return ", ".join(f"{what}{at}" for what, at in parts.items() if at is not None)

    def __str__(self) -> str:
        text = f"{_cut(self.problem)}; {_cut(self.mend, _LONGEST_MEND)}"
        text = f"{_cut(self.place)}: {text}" if self.place else text
        # one line whatever was typed: a label or a path may hold a newline
        return visible(" ".join(text.split()))

    def _render_traceback_(self) -> list[str]:
        """What a notebook shows of it: the line, without the calls that led there."""
        return [f"{type(self).__name__}: {self}"]


def _cut(text: str, longest: int = _LONGEST) -> str:
    """A text without its middle, where it is long."""
    return text if len(text) <= longest else f"{text[: longest // 2]} … {text[-longest // 3 :]}"


@contextlib.contextmanager
def said_by(
    refusal: Callable[[str, str], InputError], *, placed_too: bool = True
) -> Iterator[None]:
    """What is refused inside, as `refusal` makes it of the problem and the mend: with its place.

    What names a file already stays as it is unless that is `placed_too`.
    """
    try:
        yield
    except InputError as error:
        if error.path is not None and not placed_too:
            raise
        raise refusal(error.problem, error.mend) from None


def placed(beginning: str = "", **place: Any) -> contextlib.AbstractContextManager[None]:
    """Refusals of what is done meanwhile are of this `place`; their problems get a `beginning`."""
    before = f"{beginning}: " if beginning else ""
    return said_by(lambda problem, mend: InputError(before + problem, mend, **place))


def closest(name: str, names: Iterable[str]) -> str | None:
    """The one of some names that is most like `name`; None if nothing comes close."""
    if len(name) > _LONGEST_NAME:
        return None
    return next(iter(difflib.get_close_matches(name, list(names), n=1)), None)


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Phrase for the second half of an `InputError` about an unknown name, as typed.

    ``did you mean n_gap? Known are: gap_mm, n_gap``, in the order of `names`; without the guess if
    nothing comes close. A word of a name, such as ``height``, stands for the first that has it.
    """
    names = list(names)
    if not names:
        return "there are no names to choose from"
    listing = f"nown are: {', '.join(names)}"
    guess = closest(name, names)
    if guess is None and len(name) <= _LONGEST_NAME:
        words = {word: whole for whole in names[::-1] for word in whole.split("_")}
        long_words = [word for word in words if len(word) > 3]
        guess = words.get("".join(difflib.get_close_matches(name, long_words, 1, 0.8)))
    return f"did you mean {guess}? K{listing}" if guess else f"k{listing}"


# Joiners shape letters and emoji; what else is invisible, or reorders a line, is shown as its code.
_JOINERS = "\u200c\u200d"
_INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def visible(text: object, keep: str = "") -> str:
    """A text with invisible characters, but for those to `keep`, as their codes: <U+202E>."""
    return "".join(
        f"<U+{ord(c):04X}>"
        if unicodedata.category(c) in _INVISIBLE and c not in _JOINERS and c not in keep
        else c
        for c in str(text)
    )
