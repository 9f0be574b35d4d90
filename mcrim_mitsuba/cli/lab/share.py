"""Fractions as people write them on a command line."""

from __future__ import annotations

import click

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.values import parse_number


class Share(click.ParamType):
    """``0.05`` or ``5%``: a number from 0 up to, but not including, 1."""

    name = "fraction"

    def convert(self, value, param, ctx) -> float:
        if isinstance(value, float):
            return value
        what = param.opts[0]
        number = parse_share(what, value)
        if not 0 <= number < 1:
            raise InputError(f"{what} = {value}", "give 0 or more, below 1: 0.05 or 5%")
        return number


def parse_share(what: str, text: str) -> float:
    """Number of ``0.76`` or ``76%``.

    Raises
    ------
    InputError
        If it is neither.
    """
    bare = text.strip()
    number = parse_number(what, bare.removesuffix("%"))
    return number / 100 if bare.endswith("%") else number
