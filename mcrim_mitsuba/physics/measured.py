"""A measured number with its statistical and systematic errors kept apart."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from mcrim_mitsuba.errors import InputError


@dataclass(frozen=True)
class Measured:
    """A value and two standard errors in the value's own unit.

    Attributes
    ----------
    value : float
        The number.
    statistical : float
        Error that repeating the measurement reduces.
    systematic : float
        Error that it does not reduce.
    """

    value: float
    statistical: float = 0.0
    systematic: float = 0.0

    @property
    def total(self) -> float:
        """Both errors in quadrature, in the value's unit."""
        return math.hypot(self.statistical, self.systematic)


def quotient(
    above: Iterable[tuple[str, Measured | float]], below: Iterable[tuple[str, Measured | float]]
) -> Measured:
    """Product of the factors `above` over the product of those `below`.

    Relative errors of the factors, taken as independent, add in quadrature; statistical
    and systematic ones separately.

    Parameters
    ----------
    above, below : iterable of (name, Measured or float)
        Factors, all above 0; a plain number has no error. Names serve the error message.

    Raises
    ------
    InputError
        If a factor is not above 0 or not finite.
    """
    value, statistical, systematic = 1.0, [], []
    for factors, power in ((above, 1), (below, -1)):
        for name, factor in factors:
            known = factor if isinstance(factor, Measured) else Measured(float(factor))
            if not (known.value > 0 and math.isfinite(known.value)):
                raise InputError(f"the {name} is {known.value:g}", "give a number above 0")
            value *= known.value**power
            statistical.append(known.statistical / known.value)
            systematic.append(known.systematic / known.value)
    return Measured(
        value, value * relative_error(*statistical), value * relative_error(*systematic)
    )


def relative_error(*parts: float) -> float:
    """Relative errors of independent factors in quadrature: 0.12, 0.10, 0.016 give 0.157."""
    return math.hypot(*parts)
