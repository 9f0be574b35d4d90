"""Numbers with their errors, as people write them on a command line."""

from __future__ import annotations

import re
from dataclasses import dataclass

import click

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.values import parse_number

_BETWEEN = re.compile(r"±|\+/-|\+-")


@dataclass(frozen=True)
class NumberWithError:
    """A positive number and its standard error in the same unit; 0 where none was given."""

    value: float
    sigma: float


class WithError(click.ParamType):
    """``14.3±0.2``, ``14.3+-0.2``, ``14.3 ± 1.4%``, or 14.3 for a number without error.

    Parameters
    ----------
    fraction : bool
        The number is at most 1; without an error it may be in per cent: 25%.
    """

    name = "number±error"

    def __init__(self, *, fraction: bool = False) -> None:
        self.fraction = fraction

    def convert(self, value, param, ctx) -> NumberWithError:
        if isinstance(value, NumberWithError):
            return value
        what = param.opts[0]
        text, *errors = _BETWEEN.split(value)
        if len(errors) > 1:
            raise InputError(
                f"{what} = '{value}' has {len(errors)} errors", "write one, such as 14.3±0.2"
            )
        number = self._number(what, text, alone=not errors)
        if number <= 0:
            raise InputError(f"{what} = {number:g}", "give a number above 0")
        if self.fraction and number > 1:
            raise InputError(f"{what} = {number:g} is above 1", "give a fraction: 0.25 for 25 %")
        return NumberWithError(number, _sigma(what, errors[0], number) if errors else 0.0)

    def _number(self, what: str, text: str, *, alone: bool) -> float:
        bare = text.strip()
        if not (self.fraction and bare.endswith("%")):
            return parse_number(what, text)
        number = parse_number(what, bare.removesuffix("%")) / 100
        if not alone:
            # 25%±3%: three of a hundred, or three of the 25?
            raise InputError(
                f"{what} is in per cent and has an error, which may mean two things",
                f"write {number:g} and its error, in the same unit (±0.01) or relative (±4%)",
            )
        return number


def _sigma(what: str, text: str, number: float) -> float:
    """Standard error from its text, in the number's unit."""
    bare = text.strip()
    error = parse_number(f"the error of {what}", bare.removesuffix("%"))
    sigma = error / 100 * number if bare.endswith("%") else error
    if sigma < 0:
        raise InputError(f"the error of {what} is {error:g}", "give one that is not negative")
    if sigma >= number:
        raise InputError(
            f"the error of {what} is as large as the number itself",
            "errors are propagated to first order: give one well below it",
        )
    return sigma
