"""The catalogue: the effects that come with the package, and a user's own."""

from __future__ import annotations

import ast
import importlib
import sys
import traceback
import types
from collections.abc import Mapping
from pathlib import Path

from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import read_text
from mcrim_mitsuba.files.suggest import did_you_mean

#: In the order of the catalogue; each is a module of this package.
BUILT_IN = (
    "polarization",
    "anisotropic_scattering",
    "rayleigh_scattering",
    "scattering_gradient",
    "source_depth",
    "surface_roughness",
    "surface_absorption",
    "crystal_index",
    "gap_index",
    "gap_thickness",
    "gap_absorption",
    "gap_bubble",
    "top_reflector",
    "detector_reflection",
    "detector_angle",
    "detector_radius",
    "aperture_at_detector",
    "edge_chamfer",
    "background",
    "saturation",
)
_LIMIT_MB = 1
_MEND = "it must end with EFFECT = Effect(name=..., title=..., physics=..., source=..., ...)"


def catalogue(folder: str | Path | None = None) -> dict[str, Effect]:
    """All effects by name, those of the package first.

    Parameters
    ----------
    folder : str or Path, optional
        Holds the user's own effects: every ``*.py`` in it (``_*.py`` left out) is Python that
        ends in ``EFFECT = Effect(...)``. The files are executed: name only a folder that you
        trust.

    Raises
    ------
    InputError
        With file and line, if one of the user's files is not an effect or takes a name that
        is taken.
    """
    found = {name: _built_in(name) for name in BUILT_IN}
    if folder is None:
        return found
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("not a folder of effects", "name a folder", path=folder)
    own = [path for path in sorted(folder.glob("*.py")) if not path.name.startswith("_")]
    if not own:
        raise InputError(
            "there is no effect in this folder", "put *.py files with EFFECT there", path=folder
        )
    lines = {}
    for path in own:
        effect, lines[path] = _execute(path)
        _refuse_taken_names(effect, found, path, lines[path])
        found[effect.name] = effect
    for path, effect in zip(own, list(found.values())[len(BUILT_IN) :], strict=True):
        for other in effect.excludes:
            if other not in found:
                raise InputError(
                    f"{effect.name} excludes {other}, which is no effect",
                    did_you_mean(other, found), path=path, line=lines[path],
                )  # fmt: skip
    return found


def exclude_each_other(effects: list[Effect]) -> tuple[str, str] | None:
    """The first two names that cannot be together; None if all can."""
    for effect in effects:
        for other in effects:
            if other.name in effect.excludes:
                return effect.name, other.name
    return None


def _built_in(name: str) -> Effect:
    return importlib.import_module(f"mcrim_mitsuba.effects.{name}").EFFECT


def _execute(path: Path) -> tuple[Effect, int]:
    """The effect that a user's file defines, and the line that does."""
    text = read_text(path, _LIMIT_MB)
    try:
        tree = ast.parse(text, str(path))
        code = compile(tree, str(path), "exec")
    except (SyntaxError, ValueError) as error:
        raise InputError(
            f"not Python: {getattr(error, 'msg', None) or error}", "mend this line",
            path=path, line=getattr(error, "lineno", None),
        ) from None  # fmt: skip
    module = types.ModuleType(f"mcrim_effect_{path.stem}")
    module.__file__ = str(path)
    # dataclasses of the file look themselves up here
    sys.modules[module.__name__] = module
    try:
        exec(code, module.__dict__)
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame.lineno for frame in frames if frame.filename == str(path)]
        raise InputError(
            f"{type(error).__name__}: {error}", "mend this line",
            path=path, line=own[-1] if own else None,
        ) from None  # fmt: skip
    line = _line_of_effect(tree)
    effect = getattr(module, "EFFECT", None)
    if effect is None:
        raise InputError("no EFFECT is defined here", _MEND, path=path, line=line)
    if not isinstance(effect, Effect):
        raise InputError(
            f"EFFECT is of type {type(effect).__name__}, not Effect", _MEND, path=path, line=line
        )
    return effect, line


def _line_of_effect(tree: ast.Module) -> int:
    """Where EFFECT is assigned last; the first line if nowhere."""
    lines = [
        name.lineno
        for name in ast.walk(tree)
        if isinstance(name, ast.Name) and name.id == "EFFECT" and isinstance(name.ctx, ast.Store)
    ]
    return max(lines, default=1)


def _refuse_taken_names(effect: Effect, taken: Mapping[str, Effect], path: Path, line: int) -> None:
    """Names of effects and of parameters are unique: files refer to them."""
    if effect.name in taken:
        raise InputError(
            f"an effect {effect.name} exists already", "give EFFECT another name",
            path=path, line=line,
        )  # fmt: skip
    owners = {p.name: other.name for other in taken.values() for p in other.parameters}
    seen: set[str] = set()
    for parameter in effect.parameters:
        if parameter.name in owners or parameter.name in seen:
            raise InputError(
                f"{parameter.name} is a parameter of {owners.get(parameter.name, effect.name)} "
                "already", "give the parameter another name", path=path, line=line,
            )  # fmt: skip
        seen.add(parameter.name)
