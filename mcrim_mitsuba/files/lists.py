"""Lists of numbers as users type them: ``0.1,0.5``, ``0.01:2:40`` or ``log:0.01:2:40``."""

from __future__ import annotations

import re

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.values import parse_number

MOST_VALUES = 100_000
# no number begins so, but the decimals of one may: 0,039
_DECIMALS = re.compile(r"0[0-9]+")
_FORMS = "give 0.1,0.5 or start:stop:count, such as 0.01:2:40 or log:0.01:2:40"


def parse_list(option: str, text: str) -> list[float]:
    """Numbers of a list that a user typed, in the order given.

    Parameters
    ----------
    option : str
        Where it was typed, for the error message.
    text : str

    Raises
    ------
    InputError
        If a number is not finite, a count is not a positive whole number, a logarithmic
        range touches zero, or the list is empty or very long.
    """
    body = text.strip()
    logarithmic = body.startswith("log:")
    if not logarithmic and ":" not in body:
        if not body:
            raise InputError(f"{option} is empty", _FORMS)
        elements = body.split(",")
        _refuse_decimal_commas(option, elements)
        return [parse_number(option, part) for part in elements]
    parts = body.removeprefix("log:").split(":")
    if len(parts) != 3:
        raise InputError(f"{option} = {text!r} is not a range", _FORMS)
    start, stop = parse_number(option, parts[0]), parse_number(option, parts[1])
    if not parts[2].strip().isdecimal() or not 1 <= int(parts[2]) <= MOST_VALUES:
        raise InputError(f"{option}: the count {parts[2]!r} is not a whole number above 0", _FORMS)
    count = int(parts[2])
    if logarithmic:
        if min(start, stop) <= 0:
            raise InputError(f"{option}: a logarithmic range cannot touch 0", "start above 0")
        return np.geomspace(start, stop, count).tolist()
    return np.linspace(start, stop, count).tolist()


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
