"""Puts an effect of the catalogue into a scene."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from pathlib import Path

from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_editor import SceneEditor
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.suggest import did_you_mean
from mcrim_mitsuba.files.values import Value, parse_number


class BrokenEffectError(InputError):
    """An effect's own code is wrong; other refusals are the scene's."""


def add(
    effect: str | Effect,
    scene: SceneFile,
    values: Mapping[str, float | str] | None = None,
    folder: str | Path | None = None,
) -> str:
    """The text of a scene with an effect in it; the scene's own file is left alone.

    Parameters
    ----------
    effect : str or Effect
        Its name in the catalogue, or the effect itself.
    scene : SceneFile
        Overrides do not enter the text.
    values : mapping of str to float or str, optional
        Of its parameters, as the scene takes them (an index, not its offset); what is left out
        gets the catalogue's start.
    folder : str or Path, optional
        Of the user's own effects, see `catalogue`.

    Returns
    -------
    str
        For `SceneFile.edited`, or to be written.

    Raises
    ------
    InputError
        If there is no such effect, if it belongs to the readings or is in the scene already, if
        a value is out of the catalogue's range, or if the scene is not such that the effect
        could be put into it.
    """
    known = catalogue(folder) if isinstance(effect, str) or folder is not None else {}
    chosen = effect_of(effect, known, scene.path) if isinstance(effect, str) else effect
    if chosen.edit is None:
        where = "the readings" if chosen.reading is not None else "the photon records"
        raise InputError(
            f"{chosen.name} belongs to {where}, not to the scene",
            f'write effects = ["{chosen.name}"] in the campaign; `mcrim repair` does',
            path=scene.path,
        )  # fmt: skip
    _refuse_what_is_there(chosen, scene, known or catalogue())
    given = _values(chosen, scene, values or {})
    editor = SceneEditor(scene, given)
    for parameter in chosen.parameters:
        if parameter.nominal is None:
            editor.declare(parameter.name, given[parameter.name], parameter.comment())
    try:
        chosen.edit(editor)
    except InputError:
        raise
    except Exception as error:  # whatever a user's file does
        raise _broken(chosen, f"{type(error).__name__}: {error}", error) from None
    text = editor.finished()
    try:
        scene.edited(text)
    except InputError as error:
        raise _broken(chosen, f"what it writes is not a sound scene: {error.problem}") from None
    return text


def _broken(effect: Effect, problem: str, error: Exception | None = None) -> BrokenEffectError:
    """The refusal of an effect whose own code is wrong, with its file and line."""
    assert effect.edit is not None
    file, line = effect.edit.__code__.co_filename, effect.edit.__code__.co_firstlineno
    frames = traceback.extract_tb(error.__traceback__) if error is not None else []
    own = [frame.lineno for frame in frames if frame.filename == file]
    return BrokenEffectError(
        f"the effect {effect.name} cannot be written into the scene: {problem}",
        "mend its edit function", path=file, line=own[-1] if own else line,
    )  # fmt: skip


def effect_of(name: str, known: Mapping[str, Effect], path: str | Path | None = None) -> Effect:
    """The effect of a name, or an InputError that says which there are."""
    if name not in known:
        raise InputError(f"there is no effect {name}", did_you_mean(name, known), path=path)
    return known[name]


def _refuse_what_is_there(effect: Effect, scene: SceneFile, known: Mapping[str, Effect]) -> None:
    """Refuse an effect that the scene has already, or one that it excludes."""
    for name in (effect.name, *effect.excludes):
        for parameter in known[name].parameters if name in known else effect.parameters:
            if parameter.nominal is None and parameter.name in scene.defaults:
                place = scene.defaults[parameter.name]
                raise InputError(
                    f"the scene has the parameter {parameter.name} of {name} already",
                    f"change its value there, or give it with -D {parameter.name}=..."
                    if name == effect.name
                    else f"{effect.name} and {name} exclude each other",
                    path=place.path,
                    line=place.line,
                )


def _values(effect: Effect, scene: SceneFile, given: Mapping[str, float | str]) -> dict[str, float]:
    """Values of all its parameters, as the scene takes them."""
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    for name in given:
        if name not in parameters:
            raise InputError(
                f"{name} is not a parameter of {effect.name}",
                did_you_mean(name, parameters) if parameters else "it has none: leave out -D",
            )
    values = {}
    for name, parameter in parameters.items():
        start, low, high = _range(parameter, scene.parameters, scene.path)
        value = given.get(name, start)
        values[name] = parse_number(name, value, given=True) if isinstance(value, str) else value
        if not low <= values[name] <= high:
            raise InputError(
                f"{name} = {values[name]:g} is outside the catalogue's range",
                f"give {low:g} to {high:g}{parameter.unit and f' {parameter.unit}'}",
            )
    return values


def _range(
    parameter: EffectParameter, scene: Mapping[str, Value], path: Path
) -> tuple[float, float, float]:
    """Start and range in the scene's terms, without the noise of binary sums."""
    if parameter.nominal is not None and not isinstance(scene.get(parameter.nominal), float):
        raise InputError(
            f"the scene has no parameter {parameter.nominal}",
            f'declare it: <default name="{parameter.nominal}" value="..."/>', path=path,
        )  # fmt: skip
    start, low, high = (round(value, 12) for value in parameter.range_in(scene))
    return start, low, high
