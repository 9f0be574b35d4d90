"""Rehearsals: what a campaign's own design makes of causes that are known, in closed form.

An effect is hidden in readings that were not made, at the campaign's configurations and with its
errors, and all causes are weighed. Withheld from the causes it shows how far the light yield is
then from the truth, and so by how much the error is too small where what is missing has no name.
Left among them it shows how often such readings would name it, before they are believed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri, softmax

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.inference.closed_form import (
    MOST_CAUSES,
    Cause,
    Discrepancy,
    Surroundings,
    WeighedSets,
    weigh_sets,
    weigh_singles,
)
from mcrim_mitsuba.inference.displacement import BaselineFrame, Curve
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, DISCREPANCY, JUDGING, REHEARSALS, RIVALS

#: Where the intervals that hold 95 % and 68 % end, and the median: parts below.
QUANTILES = (0.025, 0.159, 0.5, 0.841, 0.975)


def quantile(shares: Array, means: Array, sigmas: Array, part: float) -> float:
    """Below which this part of Gaussians lies that have these shares; all (k,) float64."""

    def above(x: float) -> float:
        return float(shares @ ndtr((x - means) / sigmas)) - part

    low, high = (means - 9.0 * sigmas).min(), (means + 9.0 * sigmas).max()
    return float(brentq(above, low, high, xtol=1e-9))


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """A campaign without its readings: all that these could be explained by."""

    frame: BaselineFrame
    #: Of effects, which are the first causes, by name.
    curves: Mapping[str, Curve]
    causes: tuple[Cause, ...]
    surroundings: tuple[Surroundings, ...]
    discrepancy: Discrepancy
    #: (causes, causes) Which two cannot be there at the same time.
    excluded: NDArray[np.bool_]

    def weighed(
        self, z: Array, *, withheld: Collection[int] = (), most: int = MOST_CAUSES
    ) -> WeighedSets:
        """All sets of causes but the withheld ones, with `most` of them at a time."""
        causes = [place for place in range(len(self.causes)) if place not in withheld]
        return weigh_sets(
            [self.causes[place] for place in causes],
            self.surroundings,
            z,
            discrepancy=self.discrepancy,
            scale_variance=self.frame.scale_variance,
            excluded=self.excluded[np.ix_(causes, causes)],
            most=most,
        )


# ---- an effect withheld ----


#: Shares of Gaussians, their means and their standard deviations.
Mixture = tuple[Array, Array, Array]


def of_instrument(sets: WeighedSets, effects: int) -> NDArray[np.bool_]:
    """(sets,) Which have a wrong reading or understated errors, and nothing without a name.

    The first causes are `effects`, so many.
    """
    there = (sets.members >= effects).any(axis=1) | (sets.error_factors != 1.0)
    return np.asarray(there & (sets.amplitudes == 0.0))


def widening(
    design: Design, mixture: Mixture, p_unnamed: float, p_instrument: float
) -> tuple[float, float]:
    """Factors on the intervals of ln(scale), a `mixture`, that hold 68 % and 95 %.

    Every effect in turn is there, of the size that gives the campaign's own misfit, and withheld
    from the causes. How far the truth is then from the median, over the half intervals, says how
    much they hold where what is missing has no name, which has the probability `p_unnamed`. It may
    also look like the instrument's, which has the probability `p_instrument`, as often as it does
    in rehearsals. Intervals are then as narrow as if nothing were missing, and the truth is as far
    from the median as there. Where the readings are described there is no misfit that a size could
    have.
    """
    z, p, effects = design.frame.z, design.frame.fit.p_value, len(design.curves)
    excess = float(z @ z) - len(z)
    described = p is None or p >= ACCEPTABLE_P or excess <= 0.0
    rivals = RIVALS.bad_odds + RIVALS.swapped_odds + RIVALS.understated_odds
    most_mistaken = p_instrument * DISCREPANCY.odds / (DISCREPANCY.odds + rivals)
    likely = p_unnamed + most_mistaken >= REHEARSALS.likely
    if described or not likely or design.frame.scale_variance == 0.0:
        return 1.0, 1.0
    noise = np.random.default_rng(0).standard_normal((effects, len(z)))
    missed, odds = [], []
    for place, curve in enumerate(design.curves.values()):
        hidden = curve.at_distance(excess)
        if hidden is not None:
            moved, log_scale = hidden
            sets = design.weighed(moved + noise[place], withheld=(place,), most=MOST_CAUSES - 1)
            shares = softmax(sets.log_weights)
            alike = float(shares[of_instrument(sets, effects - 1)].sum())
            missed.append((*_missed_by(sets, shares, log_scale), alike))
            odds.append(_odds_of_more(design.causes[place], excess))
    if not missed:
        return 1.0, 1.0
    shares = np.array(odds) / sum(odds)
    away, over_95, over_68, alike = np.array(missed).T
    # by the odds before the readings, and by how often it looks so, part of the instrument's is its
    mistaken = DISCREPANCY.odds * shares * alike
    mistaken *= p_instrument / (mistaken.sum() + rivals)
    ends = [quantile(*mixture, part) for part in QUANTILES]
    factor_68, factor_95 = (
        _held_by(
            np.concatenate([over, 2.0 * away / (ends[-1 - place] - ends[place])]),
            np.concatenate([p_unnamed * shares, mistaken]),
            -float(ndtri(QUANTILES[place])),
        )
        for place, over in ((1, over_68), (0, over_95))
    )
    return factor_68, factor_95


def _odds_of_more(cause: Cause, excess: float) -> float:
    """Odds, before the readings, that a cause is there and misses them by more than this.

    They are never 0: what no usual size does a strange one may.
    """
    sizes = ndtri((np.arange(16) + 0.5) / 16)[:, None, None]
    moves = cause.origins + sizes * cause.slopes  # (sizes, strips, dimensions)
    more = ((moves**2).sum(axis=2) >= excess).mean(axis=0)
    return math.exp(cause.log_odds) * max(float(np.exp(cause.log_weights) @ more), 1e-6)


def _held_by(distances: Array, shares: Array, width: float) -> float:
    """Factor on a half interval of so many standard deviations from which it holds its part.

    The truth is at one of these `distances`, (k,) in half intervals, which have shares; for what is
    left of the probability it is that of a Gaussian.
    """
    level = float(2.0 * ndtr(width) - 1.0)
    factors = np.unique(np.concatenate([np.linspace(1.0, 3.0, 41), np.maximum(distances, 1.0)]))
    held = (shares * (distances <= factors[:, None])).sum(axis=1)
    held += (1.0 - shares.sum()) * (2.0 * ndtr(width * factors) - 1.0)
    enough = np.flatnonzero(held >= level)
    return float(factors[enough[0]] if len(enough) else factors[-1])


def _missed_by(sets: WeighedSets, shares: Array, log_scale: float) -> tuple[float, float, float]:
    """How far the median is from the truth; the same over the half intervals of 95 and 68 %."""
    likely = shares > REHEARSALS.least_share  # sets that matter
    sigmas = np.sqrt(np.maximum(sets.variances[likely], 1e-16))
    mixture = shares[likely] / shares[likely].sum(), sets.log_scales[likely], sigmas
    lower_95, lower, median, upper, upper_95 = (quantile(*mixture, part) for part in QUANTILES)
    missed = log_scale - median
    if missed > 0.0:
        return missed, missed / (upper_95 - median), missed / (upper - median)
    return -missed, missed / (lower_95 - median), missed / (lower - median)


# ---- what a campaign can say ----


@dataclass(frozen=True, kw_only=True)
class Capability:
    """What readings of a campaign's design would say of effects of usual sizes."""

    #: By effect, how often it, or its family, would be named (0..1).
    named: dict[str, float]
    #: How often another family would be.
    false: float
    #: Relative standard error of the light yield, without the detector's efficiency, in the middle
    #: of all these campaigns; None where the scale is held.
    light_yield_sigma: float | None


def capability(
    design: Design, families: Mapping[str, str], seed: int = 0, sure: float = JUDGING.named
) -> Capability:
    """Readings with every effect in turn, of sizes drawn from its prior, weighed one at a time.

    `families` are those of effects, by name; they are named from the probability `sure` on.
    """
    if not design.curves:
        return Capability(named={}, false=0.0, light_yield_sigma=None)
    rng, names = np.random.default_rng(seed), list(design.curves)
    readings = []
    for cause in design.causes[: len(names)]:
        strips = rng.choice(len(cause.log_weights), REHEARSALS.draws, p=np.exp(cause.log_weights))
        size = rng.standard_normal((REHEARSALS.draws, 1))
        readings.append(cause.origins[strips] + size * cause.slopes[strips])
    z = np.concatenate(readings)
    members, log_weights, log_scales, variances = weigh_singles(
        design.causes,
        design.surroundings,
        z + rng.standard_normal(z.shape),
        discrepancy=design.discrepancy,
        scale_variance=design.frame.scale_variance,
    )
    shares = softmax(log_weights, axis=1)
    kinds = sorted({families[name] for name in names})
    own = np.array([kinds.index(families[name]) for name in names], int)
    of_sets = np.append(own, np.full(len(design.causes) - len(names) + 1, -1))[members]
    by_kind = shares @ (of_sets[:, None] == np.arange(len(kinds)))
    likeliest = np.where(by_kind.max(axis=1) >= sure, by_kind.argmax(axis=1), -1)
    true = np.repeat(own, REHEARSALS.draws)
    hits = (likeliest == true).reshape(len(names), -1).mean(axis=1)
    means = (shares * log_scales).sum(axis=1, keepdims=True)
    sigmas = np.sqrt((shares * (variances + (log_scales - means) ** 2)).sum(axis=1))
    return Capability(
        named=dict(zip(names, hits.tolist(), strict=True)),
        false=float(np.mean((likeliest >= 0) & (likeliest != true))),
        light_yield_sigma=float(np.median(sigmas)) if design.frame.scale_variance > 0.0 else None,
    )
