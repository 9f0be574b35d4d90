"""Lists of numbers as users type them: ``0.1,0.5``, ``0.01:2:40`` or ``log:0.01:2:40``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.material_index import names_material, read_index
from mcrim_mitsuba.files.values import parse_number

MOST_VALUES = 100_000
#: Points of tables: a campaign needs thousands.
MOST_POINTS = 1_000_000
# no number begins so, but the decimals of one may: 0,039
_DECIMALS = re.compile(r"0[0-9]+")
_COUNT = re.compile(r"\s*[0-9]{1,9}\s*")
_FORMS = "give 0.1,0.5 or start:stop:count, such as 0.01:2:40 or log:0.01:2:40"


def parse_list(option: str, text: str, name: str = "", folder: Path | None = None) -> list[float]:
    """Numbers of a list that a user typed, in the order given.

    Parameters
    ----------
    option : str
        Where it was typed, for the error message.
    text : str
    name : str, optional
        Parameter that takes the numbers. Those of an index (``n_...``) may be materials, such
        as ``1.0,BK7@540nm``.
    folder : Path, optional
        That relative paths of spectra (``CaMoO4@emission.csv``) start from.

    Raises
    ------
    InputError
        If a number is not finite, a count is not a positive whole number, a logarithmic
        range touches zero, the list is empty or very long, or a material cannot be used.
    """

    def number(part: str) -> float:
        if names_material(name, part):
            return read_index(f"{option} = '{part.strip()}'", part, folder).value
        return parse_number(option, part)

    body = text.strip()
    logarithmic = body.startswith("log:")
    if not logarithmic and ":" not in body:
        if not body:
            raise InputError(f"{option} is empty", _FORMS)
        elements = body.split(",")
        _refuse_decimal_commas(option, elements)
        return [number(part) for part in elements]
    parts = body.removeprefix("log:").split(":")
    if len(parts) != 3:
        raise InputError(f"{option} = {text!r} is not a range", _FORMS)
    start, stop = parse_number(option, parts[0]), parse_number(option, parts[1])
    if not _COUNT.fullmatch(parts[2]) or not 1 <= int(parts[2]) <= MOST_VALUES:
        raise InputError(f"{option}: the count {parts[2]!r} is not a whole number above 0", _FORMS)
    count = int(parts[2])
    if logarithmic:
        if min(start, stop) <= 0:
            raise InputError(f"{option}: a logarithmic range cannot touch 0", "start above 0")
        return np.geomspace(start, stop, count).tolist()
    return np.linspace(start, stop, count).tolist()


def refuse_many_points(points: int) -> None:
    """Refuse tables that would never be done.

    Raises
    ------
    InputError
        If there are more than `MOST_POINTS`.
    """
    if points > MOST_POINTS:
        raise InputError(
            f"{points:,} points are asked for, {MOST_POINTS:,} are the most",
            "give shorter lists; eta is smooth, and values between can be interpolated",
        )


def _refuse_decimal_commas(option: str, elements: list[str]) -> None:
    """``0,039`` would be the two numbers 0 and 39."""
    for before, element in zip(["", *elements], elements, strict=False):
        decimals = element.strip()
        if not _DECIMALS.fullmatch(decimals):
            continue
        whole = before.strip() or "0"
        meant = f"{whole}.{decimals}" if whole.lstrip("+-").isdecimal() else f"0.{decimals}"
        raise InputError(
            f"{option}: '{decimals}' begins with 0, as after a decimal comma",
            f"write {meant}; commas separate numbers",
        )
