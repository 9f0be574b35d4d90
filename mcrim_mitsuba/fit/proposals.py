"""Which scattering coefficients to simulate so that a range of them can be answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from mcrim_mitsuba.fit.reweighting import EtaSurface

# Ratio of neighbouring proposals where light scatters a few times; it shrinks where light
# scatters often, because the number of scatterings then tells proposals apart.
_LARGEST_RATIO = 3.2
# Scattering coefficient (1/cm) around which that begins on benches of a centimetre.
_MANY_SCATTERINGS_PER_CM = 2.0
# A proposal below this wastes photons on light that stays trapped; weights reach down from it.
_LOWEST_PROPOSAL_PER_CM = 0.04
# How far above the highest proposal weights reach where light scatters a few times.
_REACH_ABOVE = 0.2
# Below this, light that total reflection traps hardly ever scatters within the depth limit.
_SMALLEST_PER_CM = 1e-3

# Exponent of the p-norm that stands for a maximum, so that there are slopes.
_SHARPNESS = 30.0
# Relative gain in time below which shares are good enough.
_ENOUGH = 1e-4


@dataclass(frozen=True)
class Proposals:
    """How photons are to be drawn.

    Attributes
    ----------
    alpha_scat_per_cm : tuple of float
        Scattering coefficients, rising.
    units : tuple of int
        Share of each in units of 1 / their sum; 0 for one that nobody needs any more.
    alpha_abs_per_cm : float
        Absorption coefficient.
    """

    alpha_scat_per_cm: tuple[float, ...]
    units: tuple[int, ...]
    alpha_abs_per_cm: float


def choose_proposals(
    lowest_per_cm: float, highest_per_cm: float, lowest_alpha_abs_per_cm: float, units: int
) -> Proposals:
    """Proposals that cover a range with equal shares.

    Parameters
    ----------
    lowest_per_cm, highest_per_cm : float
        Range of alpha_scat that will be asked for.
    lowest_alpha_abs_per_cm : float
        Least absorption that will be asked for, which is also simulated.
    units : int
        What the shares sum to.
    """
    # Weights of trapped light keep a finite variance only where
    # 2 (alpha_scat + alpha_abs) >= proposed alpha_scat + proposed alpha_abs.
    reachable = 0.9 * (2.0 * lowest_per_cm + lowest_alpha_abs_per_cm)
    low = max(min(max(lowest_per_cm, _LOWEST_PROPOSAL_PER_CM), reachable), _SMALLEST_PER_CM)
    # weights reach a little higher, and less so where the number of scatterings is sharper
    reach = _REACH_ABOVE / (1.0 + highest_per_cm / _MANY_SCATTERINGS_PER_CM)
    high = max(highest_per_cm / (1.0 + reach), 2.0 * low)
    proposals = [low]
    while proposals[-1] < high:
        last = proposals[-1]
        step = np.log(_LARGEST_RATIO) / (1.0 + last / _MANY_SCATTERINGS_PER_CM)
        proposals.append(last * np.exp(step))
    # the last step is shortened, and with it all the others, so that they end at the top
    stretch = np.log(high / low) / np.log(proposals[-1] / low)
    values = low * (np.array(proposals) / low) ** stretch
    equal = np.full(len(values), 1.0 / len(values))
    return Proposals(tuple(values.tolist()), _in_units(equal, units), lowest_alpha_abs_per_cm)


def improve_shares(
    surface: EtaSurface, points: Sequence[tuple[float, float]], units: int
) -> Proposals:
    """Shares that make the largest relative error over some points as small as they can.

    What each share would do to the errors is read off a surface that has been simulated with
    any shares. Time is part of the bargain: a photon of a low proposal flies for longer.

    Parameters
    ----------
    surface : EtaSurface
    points : sequence of (alpha_scat_per_cm, alpha_abs_per_cm)
        Where the surface will be asked.
    units : int
        What the shares sum to.

    Returns
    -------
    Proposals
        Of the surface.
    """
    densities, squares, cost = surface.design(points)

    def worst(logits: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Log of time for a given worst error (smoothed), and its slopes."""
        shares = np.exp(logits - logsumexp(logits))
        mixture = shares @ densities
        over = squares / mixture
        variances = over.sum(axis=1)
        time = shares @ cost
        log_worst = logsumexp(_SHARPNESS * np.log(variances)) / _SHARPNESS
        heed = np.exp(_SHARPNESS * (np.log(variances) - log_worst))
        of_shares = -(heed / variances) @ (over @ (densities / mixture).T) + cost / time
        slopes = shares * (of_shares - shares @ of_shares)
        return float(log_worst + np.log(time)), slopes

    start = np.zeros(len(cost))
    found = minimize(
        worst, start, jac=True, method="L-BFGS-B", bounds=[(-6.0, 3.0)] * len(start),
        options={"ftol": _ENOUGH},
    )  # fmt: skip
    shares = np.exp(found.x - logsumexp(found.x))
    # less than half a unit is not worth a lane; the lowest says how far down weights may reach
    shares[1:][shares[1:] * units < 0.5] = 0.0
    return Proposals(
        tuple(surface.alpha_scat_proposals_per_cm.tolist()),
        _in_units(shares / shares.sum(), units),
        surface.alpha_abs_proposal_per_cm,
    )


def _in_units(shares: NDArray[np.float64], units: int) -> tuple[int, ...]:
    """Whole numbers in these proportions with a sum of `units`; only a share of 0 gets 0."""
    least = (shares > 0).astype(int)
    whole = np.maximum(np.floor(shares * units).astype(int), least)
    while whole.sum() != units:
        lacking = shares * units - whole
        if whole.sum() < units:
            whole[np.argmax(lacking)] += 1
        else:
            whole[np.argmin(np.where(whole > least, lacking, np.inf))] -= 1
    return tuple(whole.tolist())
