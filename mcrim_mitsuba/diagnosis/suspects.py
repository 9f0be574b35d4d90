"""Readings that may be wrong: a single bad one, or two rows swapped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, ndtr

from mcrim_mitsuba.diagnosis.result import Suspect
from mcrim_mitsuba.diagnosis.solver import Array, Fit, Weights, descend
from mcrim_mitsuba.diagnosis.statistics import corrected, left_out, p_value

#: A fit with a p-value from here explains the readings.
EXPLAINS = 0.01

#: The campaign's misfit must be this unlikely before a reading is suspected.
_MISFIT = 0.01

# Suspects of each kind that are fitted exactly, after all were judged to first order.
_TO_THE_END = 6

# Variance that leaves a reading out.
_OUT = 1e8

# Suspects as good as the best, within this in chi2.
_RIVAL = 4.0


@dataclass(frozen=True)
class Alternative:
    """A suspect with what ranks it against physical effects.

    Attributes
    ----------
    suspect : Suspect
    parameters : int
        Unknowns that the suspicion adds.
    tries : int
        How many suspicions of its kind were tried.
    """

    suspect: Suspect
    parameters: int
    tries: int


def find_suspects(fit: Fit) -> list[Alternative]:
    """Single readings and pairs of rows that account for a misfit, the likeliest first.

    Parameters
    ----------
    fit : Fit
        Of the campaign as it is.

    Returns
    -------
    list of Alternative
        Empty where the campaign fits, or has no degrees of freedom to say so. Those that explain
        the readings as well as the best; or the best one, where it accounts for most of the
        misfit.
    """
    p = p_value(fit.chi2, fit.ndf)
    if p is None or p > _MISFIT:
        return []
    found = [*_bad_readings(fit), *_swapped_rows(fit)]
    found = [one for one in found if one.suspect.p_gain < _MISFIT]
    found.sort(key=_score)
    explaining = [one for one in found if one.suspect.explains]
    return [one for one in explaining if _score(one) < _score(explaining[0]) + _RIVAL]


def _score(alternative: Alternative) -> float:
    """What ranks suspicions: chi2, unknowns and the number of ways to suspect."""
    return (
        alternative.suspect.chi2 + 2.0 * alternative.parameters + 2.0 * math.log(alternative.tries)
    )


def _bad_readings(fit: Fit) -> list[Alternative]:
    """Single readings, each with an offset of its own."""
    n = len(fit.problem.signal)
    _, pulls = left_out(fit)
    found = []
    for i in np.argsort(-np.abs(pulls))[:_TO_THE_END]:
        covariance = fit.weights.covariance.copy()
        covariance[i, i] *= _OUT
        _, chi2, _ = descend(fit.problem, fit.theta, Weights.of(covariance))
        gain = fit.chi2 - chi2
        p = p_value(chi2, fit.ndf - 1)
        suspect = Suspect(
            kind="bad_reading",
            labels=(fit.problem.labels[i],),
            delta_chi2=gain,
            p_gain=corrected(float(chdtrc(1, max(gain, 0.0))), n),
            chi2=chi2,
            ndf=fit.ndf - 1,
            p_value=p,
            # to first order the square of the pull is the gain
            pull=math.copysign(math.sqrt(max(gain, 0.0)), pulls[i]),
            explains=p is not None and p >= EXPLAINS,
        )
        found.append(Alternative(suspect, 1, n))
    return found


def _swapped_rows(fit: Fit) -> list[Alternative]:
    """Pairs of rows, with their signals and errors exchanged."""
    n = len(fit.problem.signal)
    pairs = list(combinations(range(n), 2))
    followed = []
    for i, j in pairs:
        order = np.arange(n)
        order[[i, j]] = j, i
        covariance = _exchanged(fit, order)
        problem = fit.problem.against(fit.problem.signal[order])
        weights = Weights.of(covariance)
        theta, chi2, _ = descend(problem, fit.theta, weights, steps=3, precision=0.3)
        followed.append((chi2, i, j, problem, weights, theta))
    followed.sort(key=lambda item: item[0])
    found = []
    for _, i, j, problem, weights, theta in followed[:_TO_THE_END]:
        _, chi2, _ = descend(problem, theta, weights)
        gain = fit.chi2 - chi2
        p = p_value(chi2, fit.ndf)
        suspect = Suspect(
            kind="swapped_rows",
            labels=(fit.problem.labels[i], fit.problem.labels[j]),
            delta_chi2=gain,
            p_gain=corrected(_chance(fit, i, j, gain), len(pairs)),
            chi2=chi2,
            ndf=fit.ndf,
            p_value=p,
            pull=None,
            explains=p is not None and p >= EXPLAINS,
        )
        found.append(Alternative(suspect, 0, len(pairs)))
    return found


def _exchanged(fit: Fit, order: np.ndarray) -> Array:
    """The covariance once signals have moved: their own errors move along, all else stays."""
    own = np.diag(np.array([r.sigma**2 for r in fit.problem.model.readings if r.use]))
    rest = fit.weights.covariance - own
    return rest + own[np.ix_(order, order)]


def _chance(fit: Fit, i: int, j: int, gain: float) -> float:
    """Probability that exchanging two correct rows lowers chi2 by as much.

    Exchanging moves the readings by a known amount: the gain is 2 z s - s^2, s the size of what the
    parameters cannot follow.
    """
    predicted = fit.signal[fit.problem.used]
    moved = np.zeros(len(predicted))
    moved[i], moved[j] = predicted[j] - predicted[i], predicted[i] - predicted[j]
    size = math.sqrt(max(float(moved @ fit.precision @ moved), 1e-12))
    return float(ndtr(-(gain + size**2) / (2.0 * size)))
