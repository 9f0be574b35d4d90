"""What a piece of physics that the model leaves out does to a campaign's results."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mcrim_mitsuba.neglect.quantities import Shift


@dataclass(frozen=True)
class Neglected:
    """A piece of physics, put into the campaign's model.

    Attributes
    ----------
    name : str
        Its id, an effect's where it is one.
    title : str
        A few words for tables.
    correction : bool
        True: its size is known and the model can take it, so that it has to be put in. False: the
        model has no place for it, and it counts as a systematic error.
    put_in : str
        What was put in, with its numbers.
    mend : str
        How it is corrected, or what would make the error smaller.
    at_fixed : dict of str to Shift
        Efficiencies and their ratio at the coefficients that the campaign's own fit found.
    refitted : dict of str to Shift
        The same, and all parameters, where the fit with the piece ends.
    """

    name: str
    title: str
    correction: bool
    put_in: str
    mend: str
    at_fixed: dict[str, Shift]
    refitted: dict[str, Shift]


@dataclass(frozen=True)
class Total:
    """A number with its errors, without and with what the model leaves out.

    Attributes
    ----------
    value, sigma : float
        As the campaign's own fit has it.
    neglected_sigma : float
        Systematic errors of what cannot be corrected, in quadrature.
    corrected, corrected_sigma : float or None
        After all corrections at once, with the error of the fit that has them and
        `neglected_sigma`; None where there is nothing to correct.
    """

    value: float
    sigma: float
    neglected_sigma: float
    corrected: float | None = None
    corrected_sigma: float | None = None

    @property
    def sigma_with_neglected(self) -> float:
        """`sigma` and `neglected_sigma` in quadrature."""
        return math.hypot(self.sigma, self.neglected_sigma)
