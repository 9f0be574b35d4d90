"""A reading's bench as a small picture: crystal, gap, mask and window seen from the side.

It is drawn from the parameters that scenes of such benches name, to scale but for the gap; benches
with other names get none, and are told in words alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.numbers import Value, unit_of, without_unit
from mcrim_mitsuba.scene.check_text import is_filled

#: Pixels of the picture, and of its rim.
_WIDTH = 240.0
_HEIGHT = 170.0
_RIM = 10.0
#: Pixels that a gap is thick at least, and a mask: both are thinner than a line.
_GAP = 5.0
_MASK = 3.0
_ROUGH = 2.0
_SIDES = ("x", "y", "width", "height")
#: Of all faces of the crystal.
_ROUGHNESSES = ("roughness_alpha", "ground_alpha", "rms_roughness_nm")
_CRYSTAL = ("crystal_width_mm", "crystal_height_mm")
_BENCH = (*_CRYSTAL, "gap_mm", "n_gap", "window_width_mm", "window_thickness_mm")
#: What is told of a bench, whether readings differ in it or not.
_ALWAYS = ("n_gap", "gap_mm", "aperture_radius_mm", "crystal_height_mm")


def bench_picture(reading: Reading, values: Mapping[str, Value]) -> dict[str, Any] | None:
    """Shapes to draw, in pixels, each with its `kind`; None where the scene has other parameters.

    `values` are the scene's parameters of the reading's configuration.
    """
    if reading.of_beam:
        if not all(name in values for name in _CRYSTAL):
            return None
        wide, tall = (float(values[name]) for name in _CRYSTAL)
        per_mm = min((_WIDTH - 6 * _RIM) / wide, (_HEIGHT - 6 * _RIM) / tall)
        upright = values.get("beam_axis", "z") == "z"
        beam = (2 * _MASK, _HEIGHT) if upright else (_WIDTH, 2 * _MASK)
        shapes = [
            {"kind": kind, "x": (_WIDTH - width) / 2, "y": (_HEIGHT - height) / 2}
            | {"width": width, "height": height}
            for kind, width, height in (("crystal", wide * per_mm, tall * per_mm), ("beam", *beam))
        ]
        return {"width": _WIDTH, "height": _HEIGHT, "shapes": shapes}
    if not all(name in values for name in _BENCH):
        return None
    wide, tall, gap, n_gap, window, thick = (float(values[name]) for name in _BENCH)
    across = (_WIDTH - 2 * _RIM) / max(wide, window)
    per_mm = min(across, (_HEIGHT - 2 * _RIM - _GAP) / (tall + gap + thick))
    middle, gap_px = _WIDTH / 2, max(gap * per_mm, _GAP)
    foot = _RIM + tall * per_mm
    plate = foot + gap_px

    def box(kind: str, width_mm: float, top: float, height: float) -> dict[str, Any]:
        width = width_mm * per_mm
        return {"kind": kind, "x": middle - width / 2, "y": top, "width": width, "height": height}

    shapes = [
        box("crystal", wide, _RIM, tall * per_mm),
        box("liquid" if is_filled(n_gap) else "air", wide, foot, gap_px)
        | {"opacity": min(max(n_gap - 1.0, 0.0) + 0.1, 0.9)},
        box("window", window, plate, thick * per_mm),
        box("detector", window, plate + thick * per_mm, _MASK),
    ]
    of_mask = (("aperture_radius_mm", window), ("mask_offset_mm", 0.0))
    radius, off = (float(values.get(name, absent)) * per_mm for name, absent in of_mask)
    plane = box("mask", window, plate - _MASK, _MASK)
    ends = (plane["x"], middle + off - radius), (middle + off + radius, _WIDTH - plane["x"])
    shapes += [plane | {"x": low, "width": high - low} for low, high in ends if low < high]
    shapes += _added(shapes[0], shapes[1], per_mm, values)
    end = plate + thick * per_mm + _MASK + _RIM
    return {"width": _WIDTH, "height": round(end, 1), "shapes": shapes}


def _added(
    crystal: Mapping[str, Any], gap: Mapping[str, Any], per_mm: float, values: Mapping[str, Value]
) -> list[dict[str, Any]]:
    """What effects add to a bench, by the sizes of theirs among its parameters."""

    def size(*names: str) -> float:
        return max(float(values.get(name, 0.0)) for name in names)

    x, y, wide, tall = (crystal[name] for name in _SIDES)
    foot, right = y + tall, x + wide
    filled = float(gap["kind"] == "liquid")
    bubble, disc = size("bubble_fraction"), math.sqrt(size("bubble_area_fraction") * 4.0 / math.pi)
    collar, leg = filled * size("collar_mm") * per_mm, size("chamfer_mm") * per_mm
    rough = {
        face: _ROUGH
        * any(map(size, (*_ROUGHNESSES, f"{face}_roughness_alpha", f"ground_{face}_alpha")))
        for face in ("top", "side", "bottom")
    }
    lid, wrap = size("top_reflectance"), size("wrap_reflectance")
    # whatever the parameter is called that says which faces a wrapping leaves bare
    bare = " ".join(text for text in values.values() if isinstance(text, str)).split()
    covers = {face: wrap * (face not in bare) for face in ("top", "sides")}
    bars = [
        ("air", x, foot, filled * bubble * wide, gap["height"]),
        ("air", x + 0.5 * (1.0 - disc) * wide, foot, filled * disc * wide, gap["height"]),
        *(("liquid", left, foot - collar, _GAP, collar) for left in (x - _GAP, right)),
        *(("air", left, y, leg, leg) for left in (x, right - leg)),
        *(("air", left, y, rough["side"], tall) for left in (x, right - _ROUGH)),
        ("air", x, y, wide, rough["top"]),
        ("air", x, foot - _ROUGH, wide, rough["bottom"]),
        ("mask", x, y - _MASK, wide, _MASK * bool(lid or covers["top"])),
        *(("mask", at, y, _MASK * bool(covers["sides"]), tall) for at in (x - _MASK, right)),
    ]
    look = {"mask": {"opacity": 1.0 - 0.7 * max(lid, wrap)}}
    return [
        {"kind": kind, **dict(zip(_SIDES, sides, strict=True)), **look.get(kind, {})}
        for kind, *sides in bars
        if min(sides[2:]) > 0.0
    ]


def bench_words(
    reading: Reading, values: Mapping[str, Value], columns: Sequence[str]
) -> list[tuple[str, str]]:
    """Name and value of what a reading's bench has, what readings differ in first."""
    names = [n for n in columns if n in reading.parameters]
    if not reading.of_beam:
        names += [n for n in _ALWAYS if n in values and n not in names]
    of_row = [("sample", reading.sample)] * bool(reading.sample)
    of_row += [("without", ", ".join(reading.without))] * bool(reading.without)
    if reading.energy_keV is not None:
        of_row.append(("line", f"{reading.energy_keV:g} keV"))
    return of_row + [
        (without_unit(n), _text(n, reading.parameters.get(n, values.get(n)), values)) for n in names
    ]


def _text(name: str, value: Value | None, values: Mapping[str, Value]) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    text = " ".join(filter(None, (text, unit_of(name))))
    if name == "n_gap" and isinstance(value, (int, float)):
        return f"{text}, {'filled' if is_filled(float(value)) else 'air'}"
    window = values.get("window_width_mm")
    if name == "aperture_radius_mm" and window is not None and value is not None:
        return f"{text}, no mask" if float(value) >= float(window) / 2 else text
    return text
