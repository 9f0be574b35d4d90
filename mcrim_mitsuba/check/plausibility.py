"""Values that cannot be, or that look like another unit."""

from __future__ import annotations

import math

from mcrim_mitsuba.check.indices import LARGEST_INDEX
from mcrim_mitsuba.check.report import Problem
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.units import MM_PER_CM

#: Lengths of a bench outside this range (mm) are taken for another unit.
SHORTEST_PART_MM, LONGEST_PART_MM = 0.1, 500.0
SHORTEST_GAP_MM = 1e-3
#: Coefficients above this (1/cm) would leave no light to measure; 1/m is the likely unit.
LARGEST_PER_CM = 100.0
_GAPS = ("gap", "film", "offset", "chamfer", "depth")


def problems_of_parameters(file: SceneFile) -> list[Problem]:
    """Scene parameters that are negative, out of range or look like another unit."""
    problems = []
    for name, value in file.parameters.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        found = _judge(name, float(value))
        if found is not None:
            kind, text, mend = found
            default = file.defaults[name]
            if name in file.overrides:
                problems.append(Problem(kind, f"-D {name}={value:g}: {text}", mend, file.path))
            else:
                problems.append(
                    Problem(kind, f"{name} = {value:g}: {text}", mend, default.path, default.line)
                )
    return problems


def _judge(name: str, value: float) -> tuple[str, str, str] | None:
    """Kind, text and mend for a value that cannot be right; ``None`` for one that can."""
    if name.endswith("_mm") and "offset" not in name:
        gap = any(word in name for word in _GAPS)
        shortest = SHORTEST_GAP_MM if gap else SHORTEST_PART_MM
        if value <= 0:
            return "value", "a length must be positive", "give it in mm"
        if value < shortest:
            metres = value * 1000.0
            return ("unit", f"{value:g} mm is hardly a bench; it looks like metres",
                    f"write it in mm: {metres:g}")  # fmt: skip
        if value > (LONGEST_PART_MM if not gap else 10.0) and "depth" not in name:
            return ("unit", f"{value:g} mm is hardly a bench; it looks like micrometres",
                    f"write it in mm: {value / 1000.0:g}")  # fmt: skip
    if name.endswith("_per_cm"):
        if value < 0:
            return "coefficient", "a coefficient cannot be negative", "give 0 or more, in 1/cm"
        if value > LARGEST_PER_CM:
            return ("unit", "no light would leave such a crystal; it looks like 1/m",
                    f"write it in 1/cm: {value / 100.0:g}")  # fmt: skip
    if name.startswith("n_") and not 1.0 <= value <= LARGEST_INDEX:
        return ("index", "this is no refractive index",
                f"give a number from 1 to {LARGEST_INDEX:g}")  # fmt: skip
    if name.endswith("reflectance") and not 0.0 <= value <= 1.0:
        return "value", "a reflectance lies between 0 and 1", "give a fraction, not percent"
    return None


def problems_of_rotations(file: SceneFile) -> list[Problem]:
    """Rotations whose axis is not a unit vector: Mitsuba shears and scales with them."""
    problems = []
    for element in file.root.iter("rotate"):
        if element.get("value"):
            axis = [float(v) for v in element.get("value").replace(",", " ").split()]
        else:
            axis = [float(element.get(name, 0.0)) for name in "xyz"]
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
                    *file.place_of(element),
                )
            )
    return problems


def problems_of_media(file: SceneFile, volumes) -> list[Problem]:
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


def problems_of_crystal(file: SceneFile, lower, upper, name: str) -> list[Problem]:
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
