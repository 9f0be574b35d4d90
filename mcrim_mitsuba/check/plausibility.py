"""Values that cannot be, or that look like another unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.check.report import Problem
from mcrim_mitsuba.files.limits import (
    LARGEST_PER_CM,
    LONGEST_PART_MM,
    SHORTEST_PART_MM,
    judge,
)
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.values import parse_number
from mcrim_mitsuba.units import MM_PER_CM

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.scene_model import Volume


def problems_of_parameters(file: SceneFile) -> list[Problem]:
    """Scene parameters that are negative, out of range or look like another unit."""
    problems = []
    for name, value in file.parameters.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        found = judge(name, float(value))
        if found is not None:
            kind, text, mend = found
            default = file.defaults[name]
            if name in file.overrides:
                text = f"the value given for {name} is {value:g}: {text}"
                problems.append(Problem(kind, text, mend, file.path))
            else:
                problems.append(
                    Problem(kind, f"{name} = {value:g}: {text}", mend, default.path, default.line)
                )
    return problems or _too_wide(file)


def _too_wide(file: SceneFile) -> list[Problem]:
    """A crystal that does not fit on its window."""
    names = ("crystal_width_mm", "window_width_mm")
    if any(name not in file.parameters for name in names):
        return []
    crystal, window = (float(file.parameters[name]) for name in names)
    if crystal < window:
        return []
    default = file.defaults["crystal_width_mm"]
    return [
        Problem(
            "value",
            f"crystal_width_mm = {crystal:g} is not smaller than window_width_mm = {window:g}",
            "make the crystal narrower or the window wider",
            default.path,
            default.line,
        )
    ]


def problems_of_rotations(file: SceneFile) -> list[Problem]:
    """Rotations whose axis is not a unit vector: Mitsuba shears and scales with them."""
    problems = []
    for element in file.root.iter("rotate"):
        path, line = file.place_of(element)
        written = element.get("value", "").replace(",", " ").split()
        axis = [
            parse_number("a rotation's axis", number, path=path, line=line)
            for number in written or (element.get(name, "0") for name in "xyz")
        ]
        length = math.hypot(*axis)
        if abs(length - 1.0) > 1e-4:
            unit = [value / length for value in axis] if length else [0.0, 0.0, 1.0]
            mended = " ".join(f'{n}="{v:.6g}"' for n, v in zip("xyz", unit, strict=False))
            problems.append(
                Problem(
                    "value",
                    f"the axis of this <rotate> has the length {length:.4g}: Mitsuba would "
                    "distort the shape",
                    f"give it the length 1: {mended}",
                    path,
                    line,
                )
            )
    return problems


def problems_of_media(file: SceneFile, volumes: Sequence[Volume]) -> list[Problem]:
    """Coefficients that no medium has, an albedo above 1 among them.

    Parameters
    ----------
    file : SceneFile
    volumes : sequence of `kernel.scene_model.Volume`
    """
    problems = []
    for volume in volumes[1:]:
        element = next((e for e in file.root.iter("medium") if e.get("id") == volume.name), None)
        if element is None:
            continue
        place = file.place_of(element)
        scat, absorption = volume.alpha_scat_per_mm, volume.alpha_abs_per_mm
        if not (math.isfinite(scat) and math.isfinite(absorption)):
            text, mend = "has a coefficient that is not a finite number", "write a number"
        elif absorption < -1e-9 * abs(scat) and element.get("type") != "bulk":
            albedo = scat / (scat + absorption)
            text = f"has an albedo of {albedo:.4g}: it would make light"
            mend = "albedo is scattering / (scattering + absorption): give 0 to 1"
        elif scat < 0 or absorption < 0:
            text, mend = "has a negative coefficient", "give 0 or more, in 1/cm"
        elif max(scat, absorption) * MM_PER_CM > LARGEST_PER_CM:
            largest = max(scat, absorption) * MM_PER_CM
            text = f"has a coefficient of {largest:.4g} /cm; it looks like 1/m"
            mend = "write coefficients in 1/cm (sigma_t of a homogeneous medium: 1/mm)"
        else:
            continue
        problems.append(Problem("coefficient", f"medium {volume.name!r} {text}", mend, *place))
    return problems


def problems_of_crystal(
    file: SceneFile, lower: np.ndarray, upper: np.ndarray, name: str
) -> list[Problem]:
    """A crystal whose size looks like another unit, whatever the parameters are called.

    Parameters
    ----------
    lower, upper : ndarray, shape (3,)
        Its bounding box in scene units, which are millimetres.
    name : str
        Its medium.
    """
    sizes = upper - lower
    text = " x ".join(f"{size:g}" for size in sizes)
    if sizes.max() < 5 * SHORTEST_PART_MM:
        unit, factor = "metres", 1000.0
    elif sizes.max() > LONGEST_PART_MM:
        unit, factor = "micrometres", 0.001
    else:
        return []
    in_mm = " x ".join(f"{size * factor:g}" for size in sizes)
    return [
        Problem(
            "unit",
            f"the crystal measures {text} in scene units, which are mm; it looks like {unit}",
            f"write lengths in mm: {in_mm}",
            *file.place_of_id(name),
        )
    ]
