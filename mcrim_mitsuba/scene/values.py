"""Values of scene parameters from texts: one, a list, or a material's refractive index.

An index may be given by a material's name: ``BK7@540nm``, ``CaMoO4@band.csv``,
``rii:main/BaF2/Malitson@540nm``.
"""

from __future__ import annotations

import functools
import re
import unicodedata
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import is_there
from mcrim_mitsuba.core.numbers import (
    BOOLEANS,
    DECIMAL_COMMA,
    INTEGER,
    NOT_FINITE,
    NUMBER,
    Value,
    as_said,
    parse_number,
    unit_of,
)
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.materials import Material, is_known, material
from mcrim_mitsuba.optics.spectrum import average_over

SEPARATOR = "@"
_WAVELENGTH = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([a-zA-Zµμ]*)")
# No index is known better, and what is shown is then what is used.
_INDEX_DECIMALS = 5
_EXAMPLE = (
    "{0}@540nm for one wavelength, or {0}@emission.csv for the mean over an emission spectrum"
)


@dataclass(frozen=True)
class MaterialIndex:
    """An index of refraction, and where it comes from."""

    #: As the file has it.
    text: str
    #: The index, to five decimals.
    value: float
    material: Material
    wavelength_nm: float | None
    _: KW_ONLY
    #: Spectrum over which the index was averaged; one of the two is given.
    emission: Path | None
    #: What must be known of the average.
    notes: tuple[str, ...] = ()

    @property
    def group_index(self) -> float:
        """n - lambda dn/dlambda of the material, at the wavelength or over the emission."""
        if self.wavelength_nm is not None:
            return float(self.material.group_index(self.wavelength_nm))
        assert self.emission is not None  # one of the two is given
        from mcrim_mitsuba.optics.spectrum_file import read_spectrum

        # at wavelengths where the index is not known, that of the end, as for the index
        def held(wavelength_nm: np.ndarray) -> np.ndarray:
            return self.material.group_index(np.clip(wavelength_nm, *self.material.range_nm))

        return average_over(read_spectrum(self.emission, "emission"), held)[0]

    @property
    def words(self) -> str:
        """Material, wavelength, error and source."""
        material = self.material
        error = f"known to {material.sigma:g}" if material.sigma else "its error is not stated"
        at = (
            f"at {self.wavelength_nm:g} nm"
            if self.emission is None
            else f"over the emission of {self.emission.name}"
        )
        if material.extraordinary:
            at += ", mean of all directions and polarisations (2 n_o + n_e) / 3"
        notes = "".join(f"; {note}" for note in self.notes)
        return f"{material.name} ({material.what}) {at}, {error}; source: {material.source}{notes}"


def names_material(name: str, text: str) -> bool:
    """Whether the text of the parameter `name` is a material's, not a number's."""
    return name.startswith("n_") and (SEPARATOR in text or is_known(text))


def read_index(what: str, text: str, folder: Path | None = None, **place: Any) -> MaterialIndex:
    """Index of refraction that a text names.

    The text is ``MATERIAL@540nm``, or ``MATERIAL@FILE`` for the mean over the emission spectrum in
    a file, whose relative path starts from `folder`, or from that of the file in `place`: ``path``,
    ``line``, ``column`` of the text. Refusals begin with `what`: the parameter and its text.

    Raises InputError if the material or the unit is unknown, the spectrum cannot be read, or the
    material's index is not known at the wavelength, or for too much of the emission.
    """
    medium, where = material_at(what, text, **place)
    if isinstance(where, str):
        path = (Path(place.get("path") or "").parent if folder is None else folder) / where
        if not is_there(path):
            problem = f"{what} names neither a wavelength nor a file: {path} does not exist"
            raise InputError(problem, f"write {_EXAMPLE.format(medium.name)}", **place)
        from mcrim_mitsuba.optics.spectrum_file import read_spectrum

        emission = read_spectrum(path, "emission")
        with placed(what.rstrip(","), **place):
            band = index_over(medium.name, emission)
            _refuse_opaque(medium, band.mean_wavelength_nm)
        value, notes = round(band.mean, _INDEX_DECIMALS), (*emission.notes, *band.notes)
        return MaterialIndex(text.strip(), value, medium, None, emission=path, notes=notes)
    with placed(what.rstrip(","), **place):
        _refuse_opaque(medium, where)
        value = round(float(medium.index(where)), _INDEX_DECIMALS)
    return MaterialIndex(text.strip(), value, medium, where, emission=None)


def material_at(what: str, text: str, **place: Any) -> tuple[Material, float | str]:
    """Material and wavelength in nm, or the name of an emission spectrum, of such a text.

    Parameters and errors as `read_index`, which also reads the spectrum.
    """
    name, _, where = (part.strip() for part in text.partition(SEPARATOR))
    with placed(what.rstrip(","), **place):
        medium = material(name)
    if not where:
        mend = f"write {_EXAMPLE.format(medium.name)}"
        raise InputError(f"{what} names a material without a wavelength", mend, **place)
    wavelength = _WAVELENGTH.fullmatch(where)
    if wavelength is None:
        return medium, where
    number, unit = wavelength.groups()
    if unit != "nm":
        how = f"in '{unit}'" if unit else "without its unit"
        mend = f"write it in nm: {_EXAMPLE.format(medium.name)}"
        raise InputError(f"{what} gives the wavelength {how}", mend, **place)
    return medium, float(number)


def _refuse_opaque(medium: Material, wavelength_nm: float) -> None:
    if medium.is_opaque(wavelength_nm):
        mend = "name a transparent material; `mcrim lab index` says what this one reflects"
        raise InputError(f"{medium.name} is opaque at {wavelength_nm:g} nm", mend)


def parse_material(
    name: str, text: str, *, given: bool = False, folder: Path | None = None, **place: Any
) -> MaterialIndex | None:
    """The index that a text such as ``BK7@540nm`` stands for; None if it names no material.

    Only indices (``n_...``) can name materials. Parameters as for `parse_number`; `folder` and
    errors as for `read_index`.
    """
    if not names_material(name, text):
        return None
    return read_index(as_said(name, text.strip(), given), text, folder, **place)


def parse_value(name: str, text: str, **place: Any) -> Value:
    """Value of the scene parameter `name`, of the kind its text shows.

    It is a float wherever the name carries a unit or starts with ``n_``.

    Raises InputError if a number is required and there is none, if a number is not finite or has a
    decimal comma, or if there is no value at all.
    """
    stripped = text.strip()
    if not stripped:
        raise InputError(f"{name} has no value", "write one between the quotes", **place)
    if (named := parse_material(name, text, **place)) is not None:
        return named.value
    if unit_of(name) or name.startswith("n_"):
        return parse_number(name, text, **place)
    if stripped.lower() in BOOLEANS:
        return BOOLEANS[stripped.lower()]
    if INTEGER.fullmatch(stripped):
        return int(stripped)
    if any(form.fullmatch(stripped) for form in (NUMBER, DECIMAL_COMMA, NOT_FINITE)):
        return parse_number(name, text, **place)
    return text


def parse_like(name: str, text: str, example: Value, *, given: bool = False, **place: Any) -> Value:
    """Value of the parameter `name`, of the same kind as the scene's own, `example`.

    Where that is an integer, a whole number stays one (Mitsuba does not take 10.0 for an integer)
    and another number becomes a float. Other parameters as for `parse_number`.

    Raises InputError if the text is of another kind or blank.
    """
    if not text.strip():
        problem = f"the value given for {name} is blank" if given else f"{name} has no value"
        raise InputError(problem, "give one", **place)
    if isinstance(example, bool):
        if text.strip().lower() not in BOOLEANS:
            problem = f"{as_said(name, text.strip(), given)} is neither true nor false"
            raise InputError(problem, "write true or false", **place)
        return BOOLEANS[text.strip().lower()]
    if isinstance(example, str):
        return text
    if (named := parse_material(name, text, given=given, **place)) is not None:
        return named.value
    number = parse_number(name, text, given=given, **place)
    return int(number) if isinstance(example, int) and number.is_integer() else number


#: Blanks that Mitsuba passes over.
_BLANKS = " \t\r\n"
_AXES = ("value", "x", "y", "z")
#: Attributes that hold numbers, by element.
_NUMBERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("boolean", "float", "integer", "spectrum"), ("value",)),
    **dict.fromkeys(("point", "scale", "translate", "vector"), _AXES),
    "rotate": ("angle", *_AXES),
}


def refuse_misread(
    tag: str, attribute: str, what: str, text: str, *, given: bool = False, **place: Any
) -> None:
    """Refuse (InputError) what Mitsuba could not read there; other parameters of `parse_number`."""
    refuse_odd_blanks(what, text, **place)
    # a material where none can be named has its own refusal
    if attribute not in _NUMBERS.get(tag, ()) or SEPARATOR in text:
        return
    if tag == "spectrum" and ":" in text:  # wavelengths and values
        return
    if tag == "boolean":
        parse_like(what, text, True, given=given, **place)
    several = attribute == "value" and "x" in _NUMBERS[tag]
    for number in text.replace(",", " ").split() if several else [text]:
        if tag != "boolean" and not NOT_FINITE.fullmatch(number.strip()):
            parse_number(what, number, given=given, **place)


@functools.lru_cache(maxsize=4096)
def is_readable(tag: str, attribute: str, text: str) -> bool:
    """Whether `refuse_misread` lets it pass; scenes that differ in few values are read often."""
    try:
        refuse_misread(tag, attribute, "", text)
    except InputError:
        return False
    return True


def refuse_odd_blanks(what: str, text: str, **place: Any) -> None:
    """Refuse (InputError) a text with blanks at its ends that look like spaces and are none."""
    before, after = text[: len(text) - len(text.lstrip())], text[len(text.rstrip()) :]
    if odd := (before + after).strip(_BLANKS):
        blank = f"{unicodedata.name(odd[0], 'blank').lower()} (U+{ord(odd[0]):04X})"
        problem = f"{what} = '{text.strip()}' has a {blank} beside it, which looks like a space"
        raise InputError(problem, "delete it", **place)


MOST_VALUES = 100_000
#: Points of tables: a campaign needs thousands.
MOST_POINTS = 1_000_000
# no number begins so, but the decimals of one may: 0,039
_STEP_DECIMALS = re.compile(r"0[0-9]+")
_COUNT = re.compile(r"\s*[0-9]{1,9}\s*")
#: Two whole numbers with a comma between, or one with decimals.
_TWO_OR_ONE = re.compile(r"([+-]?[0-9]+),([0-9]+)")
_FORMS = "give 0.1,0.5 or start:stop:count, such as 0.01:2:40 or log:0.01:2:40"


def parse_list(option: str, text: str, name: str = "", folder: Path | None = None) -> list[float]:
    """Numbers of a list that a user typed, in the order given.

    Messages name the `option` where it was typed. If `name`, the parameter that takes the
    numbers, is an index (``n_...``), they may be materials, such as ``1.0,BK7@540nm``; relative
    paths of spectra (``CaMoO4@emission.csv``) start from `folder`. Between semicolons numbers may
    have decimal commas: ``0,1;0,5``.

    Raises InputError if a number is not finite, a count is not a positive whole number, a
    logarithmic range touches zero, the list is empty or very long, or a material cannot be used.
    """

    def number(part: str) -> float:
        if names_material(name, part):
            return read_index(f"{option} = '{part.strip()}'", part, folder).value
        return parse_number(option, part)

    body = text.strip()
    logarithmic = body.startswith("log:")
    # names of materials may have a colon
    if not logarithmic and (":" not in body or SEPARATOR in body):
        if not body:
            raise InputError(f"{option} is empty", _FORMS)
        if ";" in body:
            elements = [
                part.replace(",", ".") if DECIMAL_COMMA.fullmatch(part.strip()) else part
                for part in body.split(";")
            ]
        else:
            elements = body.split(",")
            # elements such as 039: 0,039 would be the two numbers 0 and 39
            for before, element in zip(["0", *elements], map(str.strip, elements), strict=False):
                if _STEP_DECIMALS.fullmatch(element):
                    whole = before.strip() or "0"
                    whole = whole if whole.lstrip("+-").isdecimal() else "0"
                    problem = f"{option}: '{element}' begins with 0, as after a decimal comma"
                    raise InputError(problem, f"write {whole}.{element}; commas separate numbers")
        return [number(part) for part in elements]
    parts = body.removeprefix("log:").split(":")
    if len(parts) != 3:
        raise InputError(f"{option} = {text!r} is not a range", _FORMS)
    start, stop = parse_number(option, parts[0]), parse_number(option, parts[1])
    if not _COUNT.fullmatch(parts[2]) or not 1 <= int(parts[2]) <= MOST_VALUES:
        raise InputError(f"{option}: the count {parts[2]!r} is not a whole number above 0", _FORMS)
    count = int(parts[2])
    if logarithmic and min(start, stop) <= 0:
        raise InputError(f"{option}: a logarithmic range cannot touch 0", "start above 0")
    return (np.geomspace if logarithmic else np.linspace)(start, stop, count).tolist()


def told_of_comma(option: str, text: str | None) -> list[str]:
    """What a comma was taken for in a list such as ``0,5``; nothing where there is no doubt.

    Raises InputError if it is surely a decimal comma, or as likely as not: lists go up.
    """
    match = _TWO_OR_ONE.fullmatch((text or "").strip())
    if match is None:
        return []
    first, second = match.groups()
    if int(second) <= int(first):
        problem = f"{option} = '{text}' may be one number with a decimal comma, or two"
        raise InputError(problem, f"write {first}.{second} for one, {first};{second} for two")
    return [
        f"{option} = {first},{second} is two values, {first} and {second}; for one write "
        f"{first}.{second}"
    ]


def refuse_many_points(points: int) -> None:
    """Refuse (InputError) tables of more than `MOST_POINTS`, which would never be done."""
    if points > MOST_POINTS:
        mend = "give shorter lists; eta is smooth, and values between can be interpolated"
        raise InputError(f"{points:,} points are asked for, {MOST_POINTS:,} are the most", mend)
