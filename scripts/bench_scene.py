"""The article's bench as a scene, changed by numbers of it and of effects, for who builds many."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

from shared import SCENE, SCENES

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.spectrophotometer import BEAM_PARAMETERS, spectrophotometer_of

#: What the article's bench is.
USUAL = dict(read_scene(SCENE).parameters)
#: Parameters that mean nothing where the gap is not filled.
FILLED_ONLY = (
    "gap_index_offset",
    "gap_absorption_per_cm",
    "bubble_fraction",
    "bubble_area_fraction",
    "collar_mm",
    "narrow_collar_mm",
)
#: Scenes that have other forms, by a parameter that they alone have.
_HOMES = {
    "wrap_reflectance": "camoo4_wrapped.xml",
    "crystal_length_mm": "camoo4_cylinder_lying.xml",
    "crystal_diameter_mm": "camoo4_cylinder.xml",
}
#: In place of an effect's number: slopes of rough faces are Beckmann's, not GGX's.
BECKMANN = "beckmann"
#: In no catalogue: liquid stands so high around the crystal's foot, with an outer wall 1 mm away.
NARROW_COLLAR = "narrow_collar_mm"
WIDTH = "crystal_width_mm"
_ROUGH = '<float name="roughness_alpha"'


def bench_scene(**values: Value | None) -> SceneFile:
    """The bench with these numbers, and the effects that have them; None: not there.

    Effects without a number go by their names. With a number of a beam the crystal is taken from
    its bench into a spectrophotometer. InputError if nothing is called so, or does not fit.
    """
    there = {n: v for n, v in values.items() if not (v is None or v is False or v == math.inf)}
    scene = _with_parts(frozenset(there))
    if NARROW_COLLAR in there:
        there["collar_width_mm"] = float(there.get(WIDTH, USUAL[WIDTH])) + 2.0
    return scene.with_overrides({n: v for n, v in there.items() if n in scene.parameters})


@functools.lru_cache(maxsize=64)
def _with_parts(names: frozenset[str]) -> SceneFile:
    """A scene that has parameters of these names."""
    home = next((file for name, file in _HOMES.items() if name in names), SCENE.name)
    scene = read_scene(SCENES / home)
    if NARROW_COLLAR in names:
        scene = scene.edited(_with_narrow_collar(SCENE.read_text(encoding="utf-8")))
    known = {*scene.parameters, *BEAM_PARAMETERS, BECKMANN}
    for effect in catalogue(SCENES / "own_effects").values():
        own = {parameter.name for parameter in effect.parameters} or {effect.name}
        if own & (names - known) and effect.edit is not None:
            scene = scene.edited(add(effect, scene))
            known |= own
    if unknown := sorted(names - known):
        raise InputError(f"no bench has {', '.join(unknown)}", "leave it out")
    if BECKMANN in names and scene.unwritten_text:
        slopes = f'<string name="distribution" value="beckmann"/>{_ROUGH}'
        scene = scene.edited(scene.unwritten_text.replace(_ROUGH, slopes))
    return spectrophotometer_of(scene) if names & set(BEAM_PARAMETERS) else scene


def unlike(values: Mapping[str, Value]) -> tuple[tuple[str, Value], ...]:
    """What of a bench's values is not as in the article, sorted."""
    return tuple(sorted((n, v) for n, v in values.items() if v != USUAL.get(n, False)))


def _with_narrow_collar(text: str) -> str:
    """The text of the article's bench with liquid around the crystal's foot."""
    for side in ("right", "left", "back", "front"):
        start, end = _shape(text, f"crystal_side_{side}")
        dry = text[start:end].replace('"rectangle"', '"panel"')
        level = f'<float name="level" value="${NARROW_COLLAR}"/>\n    <string name="keep" value='
        wet = dry.replace(f"crystal_side_{side}", f"crystal_wet_{side}")
        wet = wet.replace("crystal_to_air", "crystal_to_gap")
        dry = dry.replace("<ref id", f'{level}"above"/>\n    <ref id', 1)
        wet = wet.replace("<ref id", f'{level}"below"/>\n    <ref id', 1)
        wet = wet.replace("</shape>", '<ref name="exterior" id="gap"/>\n  </shape>')
        text = text[:start] + dry + wet + text[end:]
        start, end = _shape(text, f"gap_side_{side}")
        text = text[:start] + text[end:]
    for name in ("window_under_gap", "window_beside_gap"):
        start, end = _shape(text, name)
        wider = text[start:end].replace("$crystal_width_mm", "$collar_width_mm")
        text = text[:start] + wider + text[end:]
    text = text[:end] + _COLLAR + text[end:]
    declared = f'<default name="{NARROW_COLLAR}" value="1"/>\n  <default name="collar_width_mm" '
    return text.replace("<default", f'{declared}value="12"/>\n  <default', 1)


def _shape(text: str, name: str) -> tuple[int, int]:
    """Where a shape stands."""
    start = text.rindex("<shape", 0, text.index(f'id="{name}"'))
    return start, text.index("</shape>", start) + len("</shape>")


#: Its outer wall, and its top.
_COLLAR = f"""
  <shape type="gap_sides" id="gap_sides">
    <float name="width" value="$collar_width_mm"/>
    <float name="thickness" value="$gap_mm"/>
    <float name="thickness_offset" value="${NARROW_COLLAR}"/>
    <transform name="to_world"><translate z="${NARROW_COLLAR}"/></transform>
    <ref id="gap_to_air"/>
    <ref name="interior" id="gap"/>
  </shape>
  <shape type="frame" id="collar_top">
    <float name="outer_width" value="$collar_width_mm"/>
    <float name="inner_width" value="$crystal_width_mm"/>
    <transform name="to_world"><translate z="${NARROW_COLLAR}"/></transform>
    <ref id="gap_to_air"/>
    <ref name="interior" id="gap"/>
  </shape>
"""
