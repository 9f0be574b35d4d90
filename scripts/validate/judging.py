"""Are z-scores a sample of the standard normal? Which error would have been noticed?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, chi2, kstest, norm

Array = NDArray[np.float64]
Scores = Sequence[float] | Array
#: Probability that right programs fail the validation.
FALSE_ALARM = 0.01
#: Tests of each program; they share the false-alarm level evenly (Bonferroni).
TESTS = ("mean", "chi2", "shape", "largest")
#: With this probability an error would have been noticed.
POWER = 0.95
_BAND_SAMPLES = 20_000


@dataclass(frozen=True)
class Judgement:
    """What the z-scores of one program say."""

    benches: int  # independent z-scores of eta (or of a closed form's quantity), one per bench
    scores: int  # all z-scores, those of the other fates too
    mean: float  # of the independent z-scores
    mean_error: float
    rms: float
    median_error: float  # of a bench: the relative error of the difference
    shift: float  # weighted mean of our value over the other's, minus 1
    shift_error: float
    #: ``mean``: that the mean is 0. ``chi2``: the sum of squares, from both sides. ``shape``:
    #: Kolmogorov and Smirnov's test. ``largest``: the largest abs(z) of all scores, fates
    #: included, by Bonferroni's bound, which holds although the fates of a bench are correlated.
    p_values: dict[str, float]
    largest: float  # of all scores, with its sign
    level: float  # false-alarm level of each of these tests
    #: Relative errors that are found with probability `POWER`: one common to all benches, by the
    #: test of the mean; and one of one bench of median precision, by the test of the largest.
    noticed_shift: float
    noticed_error: float

    @property
    def agrees(self) -> bool:
        return all(p >= self.level for p in self.p_values.values())


def judge(z: Scores, sigma: Scores, all_z: Scores, programs: int) -> Judgement:
    """Test z-scores against the standard normal.

    Of (benches,) independent z-scores, with the relative errors of the differences behind them, and
    of all (scores,), those of the other fates too. So many programs share `FALSE_ALARM`.
    """
    z, sigma, all_z = (np.asarray(values, float) for values in (z, sigma, all_z))
    n, level = len(z), FALSE_ALARM / (programs * len(TESTS))
    squares = float(np.sum(z**2))
    largest = float(all_z[np.argmax(np.abs(all_z))])
    weight = 1 / sigma**2
    # a shift d moves z by d / sigma each, and their mean by the mean of that
    lift = float(np.mean(1 / sigma)) * math.sqrt(n)
    beyond, sure = norm.isf(level / 2), norm.ppf(POWER)
    beyond_all = norm.isf(level / len(all_z) / 2)
    p_values = {
        "mean": 2 * float(norm.sf(abs(np.mean(z)) * math.sqrt(n))),
        "chi2": min(1.0, 2 * float(min(chi2.sf(squares, n), chi2.cdf(squares, n)))),
        "shape": float(kstest(z, norm.cdf).pvalue),
        "largest": min(1.0, len(all_z) * 2 * float(norm.sf(abs(largest)))),
    }
    return Judgement(
        benches=n,
        scores=len(all_z),
        mean=float(np.mean(z)),
        mean_error=1 / math.sqrt(n),
        rms=math.sqrt(squares / n),
        median_error=float(np.median(sigma)),
        shift=float(np.sum(z * sigma * weight) / np.sum(weight)),
        shift_error=float(1 / math.sqrt(np.sum(weight))),
        p_values=p_values,
        largest=largest,
        level=level,
        noticed_shift=float((beyond + sure) / lift),
        noticed_error=float((beyond_all + sure) * np.median(sigma)),
    )


def agree(judgements: Mapping[str, Judgement]) -> bool:
    """Whether every program passed; right programs do so with 1 - `FALSE_ALARM` or more."""
    return all(judgement.agrees for judgement in judgements.values())


def quantile_band(n: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Where sorted normal scores lie: expected, and a band that holds all with 1 - `FALSE_ALARM`.

    Every sorted score has the same chance to leave the band (equal local levels: Aldor-Noiman,
    Brown, Buja, Rolke and Stine, The American Statistician 67, 2013, 249). All are (n,).
    """
    rank = np.arange(1, n + 1)
    one = beta(rank, n + 1 - rank)
    below = one.cdf(np.sort(np.random.default_rng(seed).random((_BAND_SAMPLES, n)), axis=1))
    extreme = np.minimum(below, 1 - below).min(axis=1)
    local = float(np.quantile(extreme, FALSE_ALARM))
    return norm.ppf(one.median()), norm.ppf(one.ppf(local)), norm.ppf(one.ppf(1 - local))
