"""The article's own method: alpha_scat from the ratio of two readings.

V. Alenkov et al., JINST 8 P06002, eq. 5 and fig. 4: the ratio of the light outputs in two
couplings equals R(alpha_scat) = eta_1 / eta_2 and does not depend on the light yield.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.efficiency.surface import EfficiencySurface, EtaPoint

# Points, equally spaced in log(alpha_scat), between which R is taken to be monotonic.
_GRID = 61


@dataclass(frozen=True)
class RatioSolution:
    """Scattering coefficient at which two efficiencies have a given ratio, 1/cm."""

    value: float
    #: ratio_sigma over the slope ``|dR / d alpha_scat|`` at `value`.
    statistical_sigma: float
    #: Solutions at ratio -+ ratio_sigma, whichever way R runs; None where there is none
    #: within the bounds.
    lower: float | None
    upper: float | None
    #: From the errors of the two simulations, taken as independent.
    monte_carlo_sigma: float


def alpha_scat_from_ratio(
    surface_1: EfficiencySurface,
    surface_2: EfficiencySurface,
    alpha_abs_per_cm: float,
    ratio: float,
    ratio_sigma: float,
    bounds_per_cm: tuple[float, float],
) -> RatioSolution:
    """Solve eta_1 / eta_2 = ratio for alpha_scat.

    Raises InputError if no alpha_scat within the bounds gives the ratio (the range that R takes is
    said), if more than one does, or as `EfficiencySurface.evaluate`.

    Parameters
    ----------
    surface_1, surface_2 : EfficiencySurface
        Of the two configurations; in alpha_scat and alpha_abs only.
    alpha_abs_per_cm : float
        Absorption of the crystal, known from elsewhere.
    ratio, ratio_sigma : float
        Reading 1 over reading 2 and its standard error.
    bounds_per_cm : tuple of two floats
        Where to look, both above 0; where the surfaces say nothing is left out.
    """
    low, high = bounds_per_cm
    if not 0 < low < high < math.inf:
        problem = f"alpha_scat cannot be sought between {low:g} and {high:g} /cm"
        raise InputError(problem, "give two finite bounds above 0, the smaller first")

    def at(alpha_scat: float) -> tuple[EtaPoint, EtaPoint]:
        return (
            surface_1.evaluate(alpha_scat, alpha_abs_per_cm),
            surface_2.evaluate(alpha_scat, alpha_abs_per_cm),
        )

    def r(alpha_scat: float) -> float:
        one, two = at(alpha_scat)
        return one.eta / two.eta

    grid, values = _scan(r, low, high)

    def crossings(target: float) -> list[float]:
        above = values >= target
        steps = np.flatnonzero(above[1:] != above[:-1])
        return [
            float(brentq(lambda a: r(a) - target, grid[i], grid[i + 1], xtol=1e-9 * grid[i]))
            for i in steps
        ]

    solutions = crossings(ratio)
    between = f"between {grid[0]:g} and {grid[-1]:g} /cm"
    if not solutions:
        raise InputError(
            f"no alpha_scat {between} gives the ratio {ratio:g}: the model reaches "
            f"{values.min():.4g}..{values.max():.4g}",
            "widen the bounds, or check the readings, their order and alpha_abs",
        )
    if len(solutions) > 1:
        places = ", ".join(f"{a:.4g}" for a in solutions)
        raise InputError(
            f"{len(solutions)} values of alpha_scat {between} give the ratio {ratio:g}: {places}",
            "narrow the bounds to the one that is meant",
        )
    (value,) = solutions
    ends = crossings(ratio - ratio_sigma) + crossings(ratio + ratio_sigma)
    one, two = at(value)
    slope = ratio * (one.gradient[ALPHA_SCAT] / one.eta - two.gradient[ALPHA_SCAT] / two.eta)
    relative = math.hypot(one.sigma / one.eta, two.sigma / two.eta)
    return RatioSolution(
        value=value,
        statistical_sigma=ratio_sigma / abs(slope),
        lower=max((end for end in ends if end <= value), default=None),
        upper=min((end for end in ends if end >= value), default=None),
        monte_carlo_sigma=ratio * relative / abs(slope),
    )


def _scan(r: Callable[[float], float], low: float, high: float) -> tuple[Array, Array]:
    """Scattering coefficients and R there, without those at which the surfaces say nothing."""
    known, refusal = [], None
    for alpha_scat in np.geomspace(low, high, _GRID):
        try:
            known.append((alpha_scat, r(alpha_scat)))
        except InputError as error:
            refusal = error
    if refusal is not None and not known:
        raise refusal
    grid, values = np.array(known).T
    return grid, values
