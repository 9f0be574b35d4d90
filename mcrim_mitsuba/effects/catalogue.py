"""The catalogue: effects of the package, of other distributions, of a user's folder."""

from __future__ import annotations

import ast
import functools
import sys
import traceback
import types
from collections.abc import Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.files import read_text
from mcrim_mitsuba.core.numbers import number_of, parse_number
from mcrim_mitsuba.core.run import OWN_MODULES
from mcrim_mitsuba.effects import crystal, crystal_faces, detector, gap, readings, surroundings
from mcrim_mitsuba.effects.effect import OLD_NAMES, WRONG, Effect, function_of, with_new_names
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Effects of the package by name: those of each part of the bench, as they stand in its module.
BUILT_IN = {
    effect.name: effect
    for part in (crystal, crystal_faces, gap, surroundings, detector, readings)
    for effect in vars(part).values()
    if isinstance(effect, Effect)
}
#: Entry points of installed distributions: an `Effect` each, or a module with `EFFECT`.
ENTRY_POINTS = "mcrim_mitsuba.effects"
_LIMIT_MB = 1
_MEND = "it must end with EFFECT = Effect(name=..., title=..., physics=..., source=..., ...)"
#: Of an effect, for `InputError`.
_Place = dict[str, Any]


def catalogue(folder: str | Path | None = None) -> dict[str, Effect]:
    """All effects by name: those of the package, of installed distributions, of a folder.

    Every ``*.py`` in the user's own folder (``_*.py`` left out) is Python that ends in
    ``EFFECT = Effect(...)``. The files are executed: name only a folder that you trust.

    Raises InputError, with file and line, or distribution, if what it holds is not an effect or
    takes a name that is taken.
    """
    effects = dict(BUILT_IN)
    added = list(_installed()) if folder is None else [*_installed(), *_effects_of(Path(folder))]
    for effect, place in added:
        # files refer to names of effects and of parameters
        if effect.name in effects or effect.name in OLD_NAMES:
            problem = f"an effect {effect.name} exists already"
            raise InputError(problem, "give EFFECT another name", **place)
        owners = {p.name: e.name for e in effects.values() for p in e.parameters} | OLD_NAMES
        for parameter in effect.parameters:
            if parameter.name in owners:
                problem = f"{parameter.name} is a parameter of {owners[parameter.name]} already"
                raise InputError(problem, "give the parameter another name", **place)
            owners[parameter.name] = effect.name
        effects[effect.name] = effect
    for effect, place in added:
        for other in effect.excludes:
            if other not in effects:
                problem = f"{effect.name} excludes {other}, which is no effect"
                raise InputError(problem, did_you_mean(other, effects), **place)
    return effects


@functools.cache
def entry_points_there_are() -> tuple[EntryPoint, ...]:
    """Entry points of all distributions; looking for them takes tens of milliseconds."""
    return tuple(sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name))


def _installed() -> Iterator[tuple[Effect, _Place]]:
    """Effects that other distributions bring."""
    for point in entry_points_there_are():
        place: _Place = {"path": f"distribution {point.dist.name}" if point.dist else point.value}
        mend = f"mend the entry point {point.name} of {ENTRY_POINTS}, or uninstall it"
        try:
            loaded = point.load()
        except (Exception, SystemExit) as error:
            raise InputError(f"{type(error).__name__}: {error}", mend, **place) from None
        effect = getattr(loaded, "EFFECT", loaded)
        if not isinstance(effect, Effect):
            problem = f"{point.value} is of type {type(effect).__name__}, not Effect"
            raise InputError(problem, mend, **place)
        yield effect, place


def _effects_of(folder: Path) -> Iterator[tuple[Effect, _Place]]:
    """Effects of the files in a folder."""
    if not folder.is_dir():
        raise InputError("not a folder of effects", "name a folder", path=folder)
    files = [path for path in sorted(folder.glob("*.py")) if not path.name.startswith("_")]
    if not files:
        problem = "there is no effect in this folder"
        raise InputError(problem, "put *.py files with EFFECT there", path=folder)
    for path in files:
        effect, line = _execute(path)
        yield effect, {"path": path, "line": line}


def exclude_each_other(effects: list[Effect]) -> tuple[str, str] | None:
    """The first two names that cannot be together; None if all can."""
    names = [effect.name for effect in effects]
    return next(((e.name, other) for e in effects for other in names if other in e.excludes), None)


def _execute(path: Path) -> tuple[Effect, int]:
    """The effect that a user's file defines, and the line that does."""
    text = read_text(path, _LIMIT_MB)
    try:
        tree = ast.parse(text, str(path))
        code = compile(tree, str(path), "exec")
    except (SyntaxError, ValueError) as error:
        problem = f"not Python: {getattr(error, 'msg', None) or error}"
        mend = "mend this line"
        raise InputError(problem, mend, path=path, line=getattr(error, "lineno", None)) from None
    module = types.ModuleType(f"{OWN_MODULES}{path.stem}")
    module.__file__ = str(path)
    # dataclasses of the file look themselves up here
    sys.modules[module.__name__] = module
    try:
        exec(code, module.__dict__)
    except (Exception, SystemExit) as error:
        problem, line = f"{type(error).__name__}: {error}", _line_within(str(path), error)
        raise InputError(problem, "mend this line", path=path, line=line) from None
    # where EFFECT is assigned last; the first line if nowhere
    names = (node for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id == "EFFECT")
    line = max((n.lineno for n in names if isinstance(n.ctx, ast.Store)), default=1)
    effect = getattr(module, "EFFECT", None)
    if effect is None:
        raise InputError("no EFFECT is defined here", _MEND, path=path, line=line)
    if not isinstance(effect, Effect):
        problem = f"EFFECT is of type {type(effect).__name__}, not Effect"
        raise InputError(problem, _MEND, path=path, line=line)
    return effect, line


def _line_within(file: str, error: BaseException) -> int | None:
    """The line of a file that an error came from; None if it is none of the file's."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((frame.lineno for frame in frames[::-1] if frame.filename == file), None)


# Puts an effect of the catalogue into a scene.


class BrokenEffectError(InputError):
    """An effect's own code is wrong; other refusals are the scene's."""


def add(
    effect: str | Effect,
    scene: SceneFile,
    values: Mapping[str, float | str] | None = None,
    folder: str | Path | None = None,
) -> str:
    """The text of a scene with an effect in it, for `SceneFile.edited`, or to be written.

    The effect is named as in the catalogue, to which a user's `folder` adds, or given itself.
    `values` are those of its parameters, as the scene takes them (an index, not its offset); what
    is left out gets the catalogue's start. Overrides of the scene do not enter the text.

    Raises InputError if there is no such effect, if it belongs to the readings or is in the scene
    already, if a value is out of the catalogue's range, or if the scene is not such that the effect
    could be put into it.
    """
    effects = catalogue(folder) if isinstance(effect, str) or folder is not None else {}
    name = with_new_names(effect)
    chosen = effect_of(name, effects, scene.path) if isinstance(effect, str) else effect
    if chosen.edit is None:
        where = "the readings" if chosen.reading is not None else "the photon records"
        problem = f"{chosen.name} belongs to {where}, not to the scene"
        mend = f'write effects = ["{chosen.name}"] in the campaign; `mcrim repair` does'
        raise InputError(problem, mend, path=scene.path)
    _refuse_what_is_there(chosen, scene, effects or catalogue())
    chosen.refuse_without_part(scene)
    if chosen.filled_only and "n_gap" not in scene.parameters:
        problem = "the scene has no parameter n_gap"
        raise InputError(problem, "write the gap's index as one", path=scene.path)
    given = _values(chosen, scene, values or {})
    editor = SceneEditor(scene, given)
    for parameter in chosen.parameters:
        if parameter.nominal is None:
            editor.declare(parameter.name, given[parameter.name], parameter.comment())
    try:
        chosen.edit(editor)
        text = editor.finished()
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # whatever a user's file does
        raise _broken(chosen, f"{type(error).__name__}: {error}", error) from None
    try:
        scene.edited(text)
    except InputError as error:
        raise _broken(chosen, f"what it writes is not a sound scene: {error.problem}") from None
    return text


#: By scene and name the effect that was tried and why it was refused, see `refusal_of`.
_TRIED: dict[tuple[object, ...], tuple[Effect, str | None]] = {}
_MOST_TRIED = 2000


def refusal_of(effect: Effect, scene: SceneFile) -> str | None:
    """Why `add` refuses an effect by its usual values, or None; once for scenes that say the same.

    Raises BrokenEffectError as `add` does.
    """
    key = (*scene.says, effect.name)
    # by name, for who wrote an effect of one's own may have mended it; a file may be another now
    if key in _TRIED and _TRIED[key][0] is effect and not any(scene.naming()):
        return _TRIED[key][1]
    problem = None
    try:
        add(effect, scene)
    except BrokenEffectError:
        raise
    except InputError as error:
        problem = error.problem
    if len(_TRIED) >= _MOST_TRIED:
        _TRIED.clear()
    _TRIED[key] = effect, problem
    return problem


def _broken(effect: Effect, problem: str, error: BaseException | None = None) -> BrokenEffectError:
    """The refusal of an effect whose own code is wrong, with its file and line."""
    assert effect.edit is not None
    code = function_of(effect.edit).__code__
    file, line = code.co_filename, code.co_firstlineno
    if error is not None:
        line = _line_within(file, error) or line
    problem = f"the effect {effect.name} cannot be written into the scene: {problem}"
    return BrokenEffectError(problem, "mend its edit function", path=file, line=line)


def effect_of(name: str, effects: Mapping[str, Effect], path: str | Path | None = None) -> Effect:
    """The effect of a name, or an InputError that says which there are."""
    if name not in effects:
        mend = did_you_mean(name, effects)
        if name.startswith(WRONG) and not any(other.startswith(WRONG) for other in effects):
            mend = "campaigns have such effects; in a scene write the number itself"
        raise InputError(f"there is no effect {name}", mend, path=path)
    return effects[name]


def _refuse_what_is_there(effect: Effect, scene: SceneFile, effects: Mapping[str, Effect]) -> None:
    """Refuse an effect that the scene has already, or one that it excludes."""
    for name in (effect.name, *effect.excludes):
        for parameter in effects[name].parameters if name in effects else effect.parameters:
            if parameter.nominal is None and parameter.name in scene.defaults:
                place = scene.defaults[parameter.name]
                problem = f"the scene has the parameter {parameter.name} of {name} already"
                mend = f"{effect.name} and {name} exclude each other"
                if name == effect.name:
                    mend = f"change its value there, or give it with -D {parameter.name}=..."
                raise InputError(problem, mend, path=place.path, line=place.line)


def _values(effect: Effect, scene: SceneFile, given: Mapping[str, float | str]) -> dict[str, float]:
    """Values of all its parameters, as the scene takes them."""
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    for name in given:
        if name not in parameters:
            mend = did_you_mean(name, parameters) if parameters else "it has none: leave out -D"
            raise InputError(f"{name} is not a parameter of {effect.name}", mend)
    values = {}
    for name, parameter in parameters.items():
        nominal = parameter.nominal
        if nominal is not None and not isinstance(scene.parameters.get(nominal), float):
            mend = f'declare it: <default name="{nominal}" value="..."/>'
            raise InputError(f"the scene has no parameter {nominal}", mend, path=scene.path)
        start, low, high = parameter.range_in(scene.parameters)
        value = given.get(name, start)
        values[name] = (
            parse_number(name, value, given=True)
            if isinstance(value, str)
            else number_of(name, value, "give a number")
        )
        if not low <= values[name] <= high:
            mend = f"give {low:g} to {high:g}{parameter.unit and f' {parameter.unit}'}"
            raise InputError(f"{name} = {values[name]:g} is outside the catalogue's range", mend)
    return values
