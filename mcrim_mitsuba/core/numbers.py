"""Numbers as people type them: texts to numbers and back, units, and what a value may be.

The unit of a parameter is the end of its name.
"""

from __future__ import annotations

import math
import numbers
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError

#: Millimetres per centimetre; coefficients are converted once, where a scene is read.
MM_PER_CM = 10.0
#: Full width at half maximum of a Gaussian over its standard deviation.
FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))

ALPHA_SCAT = "alpha_scat_per_cm"
ALPHA_ABS = "alpha_abs_per_cm"
COEFFICIENTS = ALPHA_SCAT, ALPHA_ABS
#: Parameter that says whose light is eta: the id of a detector's shape, or all of several.
COUNTED = "detector"
ALL_DETECTORS = "all"

Value = float | bool | int | str

#: What names say less well than words do.
_CALLED = {
    ALPHA_SCAT: "scattering",
    ALPHA_ABS: "absorption",
    "n_gap": "gap index",
    "n_crystal": "crystal index",
    "n_window": "window index",
    "aperture_radius_mm": "mask radius",
}
_UNITS = {"_per_cm": "1/cm", "_deg": "degrees", "_ph_per_keV": "ph/keV"}
_UNITS |= {f"_{unit}": unit for unit in ("mm", "nm", "ps", "keV")}
#: Longer ones are floats: Mitsuba's integers have 64 bits.
INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
# Mitsuba's own grammar of a number; Python's float() would also take 1_0 and nan
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
#: Parameters and options whose values may be materials.
_INDEX = re.compile(r"(^|[ -])n[_-]")
_MATERIAL = ", or a material at a wavelength, such as glycerol@540nm (`mcrim lab index` lists them)"
BOOLEANS = {"true": True, "false": False}


#: An offset of a number of the bench, or of one of its values: as `effects.effect.BenchNumber`.
_OFFSET = re.compile(r"wrong_(.+?)((?:_\d+)*)_offset(_mm)?")


def unit_of(name: str) -> str | None:
    """Unit that ends a parameter's name: ``mm`` for ``gap_mm``; None without one."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)


def without_unit(name: str) -> str:
    """A parameter's name without its unit, in words: ``scattering`` for ``alpha_scat_per_cm``."""
    if name in _CALLED:
        return _CALLED[name]
    if offset := _OFFSET.fullmatch(name):
        number, value, unit = offset.groups(default="")
        words = without_unit(number + unit)
        return " ".join((words, *([value[1:].replace("_", ".")] if value else []), "off"))
    ending = next((ending for ending in _UNITS if name.endswith(ending)), "")
    return name.removesuffix(ending).replace("_", " ")


def titled(name: str) -> str:
    """A parameter's name in words with its unit: ``gap (mm)`` for ``gap_mm``."""
    unit = unit_of(name)
    return without_unit(name) + (f" ({unit})" if unit else "")


def said(name: str, value: object) -> str:
    """A parameter's value in words: ``gap 0.05 mm``, ``polarization off``."""
    if isinstance(value, (bool, np.bool_)):
        return f"{without_unit(name)} {'on' if value else 'off'}"
    shown = f"{value:g}" if isinstance(value, numbers.Real) else str(value)
    return " ".join(filter(None, (without_unit(name), shown, unit_of(name))))


def parse_number(what: str, text: str, *, given: bool = False, **place: Any) -> float:
    """Finite number from text with a decimal point; blanks around it do not matter.

    For the error message, `what` names the quantity, and `place` has ``path``, ``line`` and
    ``column`` of the text; what is `given` does not stand in that file, and the message says so.

    Raises InputError if it is not a finite number; a decimal comma gets its own hint.
    """
    stripped = text.strip()
    if not stripped:
        raise InputError(f"{what} is empty", "write a number", **place)
    refuse_decimal_comma(what, stripped, given=given, **place)
    if not NUMBER.fullmatch(stripped) or not math.isfinite(float(stripped)):
        problem = f"{as_said(what, stripped, given)} is not a finite number"
        mend = "write a plain number such as 1.46, without a unit"
        if NUMBER.fullmatch(percents := stripped.removesuffix("%").strip()) and "%" in stripped:
            mend = f"write a fraction: {float(percents) / 100.0:g}"
        raise InputError(problem, mend + (_MATERIAL if _INDEX.search(what) else ""), **place)
    number = float(stripped)
    if number and not SMALLEST <= abs(number) <= LARGEST:
        size = "large" if abs(number) > 1 else "small"
        problem = f"{as_said(what, stripped, given)} is too {size} for any quantity"
        mend = f"give 0, or a number from {SMALLEST:g} to {LARGEST:g} of either sign"
        raise InputError(problem, mend, **place)
    return number


def number_of(what: str, value: object, mend: str) -> float:
    """A finite number from any kind that Python has, or from its text; integers stay such.

    `what` and `mend` are for the message, as ``the seed`` and ``give 0 or a positive integer``.

    Raises InputError if it is none: true and false, complex numbers and arrays of several are not.
    """
    if isinstance(value, str):
        value = int(value) if INTEGER.fullmatch(value) else parse_number(what, value)
    if isinstance(value, (np.ndarray, np.generic)) and value.ndim == 0:
        value = value.item()
    if not isinstance(value, bool) and isinstance(value, (numbers.Real, Decimal)):
        number = int(value) if isinstance(value, numbers.Integral) else float(value)
        if abs(number) <= LARGEST:
            return number
    raise InputError(f"{what} is {value}", mend)


def whole_of(what: str, value: object, mend: str, least: int, most: float = math.inf) -> int:
    """A whole number within limits, of any kind that `number_of` takes; what it refuses, too."""
    number = number_of(what, value, mend)
    if not (least <= number <= most and abs(number - round(number)) <= 1e-9 * abs(number)):
        raise InputError(f"{what} is {value}", mend)
    return round(number)


def refuse_decimal_comma(what: str, text: str, *, given: bool = False, **place: Any) -> None:
    """Refuse ``12,5`` and ``12,5%`` by an InputError with a hint; parameters as `parse_number`."""
    if DECIMAL_COMMA.fullmatch(text.removesuffix("%")):
        problem = f"{as_said(what, text, given)} has a decimal comma"
        raise InputError(problem, f"write a decimal point: {text.replace(',', '.')}", **place)


def as_said(what: str, text: str, given: bool) -> str:
    return f"the value given for {what}, '{text}'," if given else f"{what} = '{text}'"


def value_text(value: object) -> str:
    """Text of a value as a scene file or ``-D`` holds it; ``repr`` digits, so nothing is lost."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    return repr(float(value)) if isinstance(value, numbers.Real) else str(value)


# What a scene parameter's value can be, judged by its name and unit.

#: Sizes of all numbers but 0: beyond them squares and products of a few would overflow.
SMALLEST = 1e-60
LARGEST = 1e60
#: Anything above is not the index of a transparent solid (diamond has 2.4, germanium 4.0).
LARGEST_INDEX = 4.5
#: Lengths of a bench outside this range (mm) are taken for another unit.
SHORTEST_PART_MM = 0.1
LONGEST_PART_MM = 2500.0
#: Ends of names of lengths and coefficients that are in none of a scene's units.
_FOREIGN = re.compile(r"_(um|(?<!per_)cm|m|inch|per_mm)$")
#: The same for what is thin by nature.
SHORTEST_GAP_MM = 1e-3
LONGEST_GAP_MM = 10.0
#: Coefficients above this (1/cm) would leave no light to measure; 1/m is the likely unit.
LARGEST_PER_CM = 100.0
#: Of lines (keV) that scintillators are read with: X-rays to cosmic muons; below, it is in MeV.
ENERGIES_KEV = 1.0, 1e6
#: How an energy beyond these is mended.
IN_KEV = "write it in keV: 662 for 0.662 MeV"
#: Photons per keV that crystals make: no more than one for each 3 eV.
YIELDS_PER_KEV = 1e-3, 330.0
#: How one is mended that is given and above.
PER_KEV = "give photons per keV: 8.2 for 8200 per MeV"
# Beyond these a value is possible, but seldom meant: it gets a note.
#: Gaps and films (mm) are of 0.01 to 0.5, and 1 or 2 where air is left on purpose.
WIDEST_USUAL_GAP_MM = 3.0
#: Light that turns after a third of a millimetre (1/cm) is in milk glass or powder, not a crystal.
LARGEST_USUAL_PER_CM = 30.0
#: Scene parameter: where along the crystal light is born, above its bottom.
SOURCE_Z = "source_z_mm"
#: In names of depths that gammas reach; a crystal's depth is a length as any other.
_OF_GAMMAS = ("source_depth", "side_depth")
#: In names of what is thin by nature.
THIN = ("gap", "film", "chamfer", *_OF_GAMMAS)
#: Lengths that may be 0: then the part is not there.
_MAY_BE_ZERO = ("chamfer", "collar", "film", "rim")
#: Ranges in which parameters of effects have a meaning (the catalogue's are narrower).
MEANINGFUL = {
    "scattering_g": (-0.999, 0.999),
    "scattering_gradient": (-1.0, 1.0),
    "roughness_alpha": (0.0, 1.0),
    "surface_loss": (0.0, 1.0),
    "ground_loss": (0.0, 1.0),
    "wrap_contact": (0.0, 1.0),
    "wrap_specular": (0.0, 1.0),
    "wrap_missing": (0.0, 0.99),
    "gap_index_offset": (-0.5, 0.5),
    "gap_offset_mm": (-LONGEST_GAP_MM, LONGEST_GAP_MM),
    "bubble_fraction": (0.0, 1.0),
    "angular_falloff": (-1.0, 1.0),
    "radial_falloff": (0.0, 1.0),
    "detector_specular": (0.0, 1.0),
    "housing_reflectance": (0.0, 1.0),
}


def judge(name: str, value: float) -> tuple[str, str, str] | None:
    """What is wrong with a parameter's value, in the unit that ends its name; None: nothing.

    Returns the kind, ``value``, ``unit``, ``coefficient`` or ``index``, the problem and its mend.
    """
    low, high = MEANINGFUL.get(name, (-math.inf, math.inf))
    if not low <= value <= high:
        mend = f"give a number from {low:g} to {high:g}"
        return "value", f"it lies between {low:g} and {high:g}", mend
    # offsets and heights may be negative, and a source's depth may exceed the crystal
    is_length = re.search(r"(?<!_per)(?<!_z)_mm$", name) and "offset" not in name
    if is_length and (wrong := _judge_length(name, value)):
        return wrong
    if name.endswith("_per_cm"):
        if value < 0:
            return "coefficient", "a coefficient cannot be negative", "give 0 or more, in 1/cm"
        if value > LARGEST_PER_CM:
            problem = "no light would leave such a crystal; it looks like 1/m"
            return "unit", problem, f"write it in 1/cm: {value / 100.0:g}"
    if name.startswith("n_") and not 1.0 <= value <= LARGEST_INDEX:
        mend = f"give a number from 1 to {LARGEST_INDEX:g}"
        return "index", "this is no refractive index", mend
    if name.endswith("reflectance") and not 0.0 <= value <= 1.0:
        return "value", "a reflectance lies between 0 and 1", "give a fraction, not percent"
    return None


def doubts(parameters: Mapping[str, Value]) -> Iterator[tuple[str, str]]:
    """Names of parameters whose values are hardly meant, with what is odd of each.

    Scene parameters, and light yields (names that end with ``_ph_per_keV``).
    """
    (least, most), asks = YIELDS_PER_KEV, "is the energy in MeV, or are the signals no photons?"
    sizes = {name: float(v) for name, v in parameters.items() if isinstance(v, int | float)}
    radius, window = sizes.get("aperture_radius_mm", 0.0), sizes.get("window_width_mm", math.inf)
    for name, value in sizes.items():
        thin = name.endswith("_mm") and ("gap" in name or "film" in name)
        usual = WIDEST_USUAL_GAP_MM if thin else math.inf
        usual = LARGEST_USUAL_PER_CM if name in COEFFICIENTS else usual
        if _FOREIGN.search(name):
            yield name, "is named in a unit that nobody reads: lengths count in mm, a bulk in 1/cm"
        if value > usual:
            yield name, f"is {value:g}, seldom more than {usual:g}: is it meant in {unit_of(name)}?"
        if name.endswith("_ph_per_keV") and not least <= value <= most:
            yield name, f"is {value:.3g}, which no crystal makes: {asks}"
    if radius > window:
        text = f"is {radius:g} mm: such a mask covers nothing of a window {window:g} mm wide"
        yield "aperture_radius_mm", text


def _judge_length(name: str, value: float) -> tuple[str, str, str] | None:
    """What is wrong with a length in mm, as `judge` says it."""
    thin = any(word in name for word in THIN)
    may_vanish = any(word in name for word in _MAY_BE_ZERO)
    shortest = SHORTEST_GAP_MM if thin or may_vanish else SHORTEST_PART_MM
    longest = LONGEST_GAP_MM if thin else LONGEST_PART_MM
    if value == 0 and may_vanish:
        return None
    if value <= 0:
        return "value", "a length must be positive", "give it in mm"
    if value < shortest:
        meant, factor = "metres", 1000.0
    elif value > longest and not any(word in name for word in _OF_GAMMAS):
        meant, factor = "micrometres", 1.0 / 1000.0
    else:
        return None
    problem = f"{value:g} mm is hardly a bench; it looks like {meant}"
    return "unit", problem, f"write it in mm: {value * factor:g}"
