"""Values of scene parameters: text to number, true/false or text, and back.

The unit of a parameter is the end of its name; a name with a unit, or a refractive
index (``n_...``), must hold a finite number. An index may name a material instead.
"""

from __future__ import annotations

import math
import numbers
import re
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.limits import LARGEST, SMALLEST
from mcrim_mitsuba.files.material_index import MaterialIndex, names_material, read_index

Value = float | bool | int | str

_UNITS = {"_per_cm": "1/cm", "_mm": "mm", "_nm": "nm", "_keV": "keV", "_deg": "degrees"}
#: Longer ones are floats: Mitsuba's integers have 64 bits.
_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
# Mitsuba's own grammar of a number; Python's float() would also take 1_0 and nan
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
_BOOLEANS = {"true": True, "false": False}


def unit_of(name: str) -> str | None:
    """Unit that ends a parameter's name: ``mm`` for ``gap_mm``; None without one."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), None)


def parse_number(what: str, text: str, *, given: bool = False, **place: Any) -> float:
    """Finite number from text.

    Parameters
    ----------
    what : str
        Name of the quantity, for the error message.
    text : str
        The number with a decimal point; blanks around it do not matter.
    given : bool
        The text does not stand in the file that `place` names: the message must say so.
    **place
        ``path``, ``line``, ``column`` of the text, for the error message.

    Raises
    ------
    InputError
        If it is not a finite number; a decimal comma gets its own hint.
    """
    stripped = text.strip()
    if not stripped:
        raise InputError(f"{what} is empty", "write a number", **place)
    refuse_decimal_comma(what, stripped, given=given, **place)
    if not _NUMBER.fullmatch(stripped) or not math.isfinite(float(stripped)):
        raise InputError(
            f"{_said(what, stripped, given)} is not a finite number",
            "write a plain number such as 1.46, without a unit",
            **place,
        )
    number = float(stripped)
    if number and not SMALLEST <= abs(number) <= LARGEST:
        raise InputError(
            f"{_said(what, stripped, given)} is too {'large' if abs(number) > 1 else 'small'} for "
            "any quantity",
            f"give 0, or a number from {SMALLEST:g} to {LARGEST:g} of either sign",
            **place,
        )
    return number


def refuse_decimal_comma(what: str, text: str, *, given: bool = False, **place: Any) -> None:
    """Refuse ``12,5`` and ``12,5%``, with the hint to write a point. Parameters as `parse_number`.

    Raises
    ------
    InputError
    """
    if _DECIMAL_COMMA.fullmatch(text.removesuffix("%")):
        raise InputError(
            f"{_said(what, text, given)} has a decimal comma",
            f"write a decimal point: {text.replace(',', '.')}",
            **place,
        )


def parse_material(
    name: str, text: str, *, given: bool = False, folder: Path | None = None, **place: Any
) -> MaterialIndex | None:
    """The index that a text such as ``BK7@540nm`` stands for; None if it names no material.

    Parameters
    ----------
    name, text, given, **place
        As for `parse_number`; only indices (``n_...``) can name materials.
    folder : Path, optional
        As for `files.material_index.read_index`.

    Raises
    ------
    InputError
        As `files.material_index.read_index`.
    """
    if not names_material(name, text):
        return None
    return read_index(_said(name, text.strip(), given), text, folder, **place)


def _said(what: str, text: str, given: bool) -> str:
    return f"the value given for {what}, '{text}'," if given else f"{what} = '{text}'"


def parse_value(name: str, text: str, **place: Any) -> Value:
    """Value of the scene parameter `name`, of the kind its text shows.

    Returns
    -------
    float, int, bool or str
        Always a float where the name carries a unit or starts with ``n_``.

    Raises
    ------
    InputError
        If a number is required and there is none, if a number is not finite or has a
        decimal comma, or if there is no value at all.
    """
    stripped = text.strip()
    if not stripped:
        raise InputError(f"{name} has no value", "write one between the quotes", **place)
    if (named := parse_material(name, text, **place)) is not None:
        return named.value
    if unit_of(name) or name.startswith("n_"):
        return parse_number(name, text, **place)
    if stripped.lower() in _BOOLEANS:
        return _BOOLEANS[stripped.lower()]
    if _INTEGER.fullmatch(stripped):
        return int(stripped)
    if any(form.fullmatch(stripped) for form in (_NUMBER, _DECIMAL_COMMA, _NOT_FINITE)):
        return parse_number(name, text, **place)
    return text


def parse_like(name: str, text: str, example: Value, *, given: bool = False, **place: Any) -> Value:
    """Value of the parameter `name`, of the same kind as the one the scene has.

    Parameters
    ----------
    name, text, given, **place
        As for `parse_number`.
    example : float, int, bool or str
        The scene's own value. Where it is an integer, a whole number stays one (Mitsuba
        does not take 10.0 for an integer) and another number becomes a float.

    Raises
    ------
    InputError
        If the text is of another kind or blank.
    """
    if not text.strip():
        said = f"the value given for {name} is blank" if given else f"{name} has no value"
        raise InputError(said, "give one", **place)
    if isinstance(example, bool):
        if text.strip().lower() not in _BOOLEANS:
            raise InputError(
                f"{_said(name, text.strip(), given)} is neither true nor false",
                "write true or false",
                **place,
            )
        return _BOOLEANS[text.strip().lower()]
    if isinstance(example, str):
        return text
    if (named := parse_material(name, text, given=given, **place)) is not None:
        return named.value
    number = parse_number(name, text, given=given, **place)
    return int(number) if isinstance(example, int) and number.is_integer() else number


def value_text(value: object) -> str:
    """Text of a value as a scene file or ``-D`` holds it; ``repr`` digits, so nothing is lost."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return repr(float(value))
    return str(value)
