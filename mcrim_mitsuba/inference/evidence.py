"""Evidence: how likely the readings are under a model, averaged over plausible sizes.

chi2 at its best rewards an effect for sizes that no laboratory meets. So each parameter has a prior
density, and a model's evidence is its likelihood averaged over these (D. J. C. MacKay, Information
Theory, Inference, and Learning Algorithms, Cambridge 2003, chapter 28). A parameter is the image of
a standard normal number z: its prior is then the same for all, bounds are at infinity, and the
average is an expectation over N(0, 1)^k. It is sampled by importance: Student t densities around
the likelihood's maxima, with the prior itself mixed in, so that nothing plausible is forgotten (T.
Hesterberg, Technometrics 37 (1995) 185).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.settings import EVIDENCE
from mcrim_mitsuba.inference.statistic import Statistic

#: The name of the model without further effects.
NOTHING_MISSING = "none"


@dataclass(frozen=True)
class PriorDensity:
    """What is known of a parameter before the readings, as an image of a standard normal number."""

    #: Cumulated probabilities (0..1) to values, arrays of one shape.
    quantile: Callable[[Array], Array]

    def value(self, z: Array) -> Array:
        """Values of the parameter for standard normal numbers."""
        return self.quantile(ndtr(np.minimum(np.maximum(z, -EVIDENCE.farthest), EVIDENCE.farthest)))

    def z_of(self, value: float) -> float:
        """The standard normal number of a value, by sections; drawn into the range."""
        low, high = -EVIDENCE.farthest, EVIDENCE.farthest
        for _ in range(5):  # 16 / 64^5 is 1e-8
            z = np.linspace(low, high, 65)
            above = min(max(int(np.searchsorted(self.value(z), value)), 1), 64)
            low, high = float(z[above - 1]), float(z[above])
        return 0.5 * (low + high)


def even(low: float, high: float) -> PriorDensity:
    """Evenly between two values; in the logarithm where the range is wide."""
    if low > 0 and high > EVIDENCE.wide * low:
        return PriorDensity(lambda u: low * (high / low) ** u)
    return PriorDensity(lambda u: low + (high - low) * u)


def gaussian(mean: float, sigma: float, low: float, high: float) -> PriorDensity:
    """A Gaussian, cut off at the bounds."""
    below, above = ndtr((low - mean) / sigma), ndtr((high - mean) / sigma)

    def quantile(u: Array) -> Array:
        # of a mean below the bounds the last parts round to all of it, which is infinitely far
        part = np.minimum(below + (above - below) * u, 1.0 - 1e-16)
        return np.clip(mean + sigma * ndtri(part), low, high)

    return PriorDensity(quantile)


def size(absent: float, plausible: tuple[float, float], low: float, high: float) -> PriorDensity:
    """Of an effect's size: 95 % inside the plausible range, around its absence, with long tails.

    Student's t on either side of `absent`, with a width of its own for each side; where the
    plausible range is on one side only, all is there. From `low` to `high` the effect is defined,
    or a campaign allows it, without the absence too: beyond, the density is cut off.
    """
    end = float(stdtrit(EVIDENCE.tails, 0.5 + 0.5 * EVIDENCE.plausible_part))
    widths = [max(absent - plausible[0], 0.0) / end, max(plausible[1] - absent, 0.0) / end]

    def part_within(distance: float, width: float) -> float:
        """Part of one side's density up to a distance from the absence."""
        if width == 0.0:
            return 0.0
        return 2.0 * float(stdtr(EVIDENCE.tails, max(distance, 0.0) / width)) - 1.0

    # of either side: parts of its density where the range begins and ends, and signed widths
    begins = np.array([part_within(absent - high, widths[0]), part_within(low - absent, widths[1])])
    ends = np.array([part_within(absent - low, widths[0]), part_within(high - absent, widths[1])])
    share_below = float(ends[0] > begins[0]) / float((ends > begins).sum())
    shares = np.maximum([share_below, 1.0 - share_below], 1e-300)
    away = np.array([-widths[0], widths[1]])

    def quantile(u: Array) -> Array:
        side = np.where(u < share_below, 0, 1)
        # how far u is through its side, from the absence outwards
        through = abs(u - share_below) / shares[side]
        part = 0.5 + 0.5 * (begins[side] + (ends - begins)[side] * through)
        return absent + away[side] * stdtrit(EVIDENCE.tails, np.minimum(part, 1.0 - 1e-16))

    return PriorDensity(quantile)


def of_parameter(parameter: CampaignParameter) -> PriorDensity:
    """Of a parameter that a campaign fits: its own prior, or evenly between its bounds."""
    if parameter.prior is not None and parameter.prior_sigma is not None:
        return gaussian(
            parameter.prior, parameter.prior_sigma, parameter.minimum, parameter.maximum
        )
    return even(parameter.minimum, parameter.maximum)


@dataclass(frozen=True)
class Evidence:
    """A model's evidence, and what the readings say of it, averaged over its parameters."""

    #: Natural logarithm of the likelihood's average over the prior, up to a constant that all
    #: models of a campaign share; and its error from the points.
    log: float
    log_sigma: float
    #: Parameters' means and standard deviations over the posterior density.
    mean: dict[str, float]
    sigma: dict[str, float]
    #: Points that the averages are as good as.
    effective_points: float
    #: (`EVIDENCE.draws`, free) float64: Parameters that are equally likely.
    draws: Array


def evidence_of(
    fit: Minimum, priors: Mapping[str, PriorDensity], *, rough: bool = False
) -> Evidence:
    """Evidence of the model of a fit, with a prior for every free parameter.

    The fit's covariance of the readings is taken for all parameters. A `rough` one is of few
    points where these tell enough, for models that matter little.
    """
    sampled = _Sampled(fit, [priors[name] for name in fit.names])
    if not fit.names:  # all is held: the likelihood itself
        log = float(sampled.log_likelihood(np.empty((1, 0)))[0])
        return Evidence(log, 0.0, {}, {}, math.inf, np.empty((EVIDENCE.draws, 0)))
    modes = [sampled.maximum(fit.theta)]
    # models are compared: the same points for all
    rng = np.random.default_rng(0)
    points, rounds = EVIDENCE.points, EVIDENCE.rounds
    if rough:
        points, rounds = EVIDENCE.few_points, EVIDENCE.few_rounds
    for remaining in reversed(range(rounds)):
        z, log_ratio = _drawn(modes, points // rounds if remaining else points, rng)
        theta = sampled.values(z)
        log_weight = sampled.log_likelihood(theta) + log_ratio
        total = float(log_sum(log_weight))
        log, share = total - math.log(len(z)), np.exp(log_weight - total)
        if remaining:
            modes.append(_gathered(z, share))
            best = sampled.maximum(theta[int(share.argmax())])
            if all(np.linalg.norm(best[0] - other) > EVIDENCE.apart for other, _ in modes):
                modes.append(best)
    mean = share @ theta
    spread = np.sqrt(np.maximum(share @ (theta - mean) ** 2, 0.0))
    effective = 1.0 / float((share**2).sum())
    log_sigma = math.sqrt(max(1.0 / effective - 1.0 / points, 0.0))
    if rough and log_sigma > EVIDENCE.unsure:
        return evidence_of(fit, priors)
    at = np.searchsorted(np.cumsum(share), (np.arange(EVIDENCE.draws) + 0.5) / EVIDENCE.draws)
    return Evidence(
        log=log,
        log_sigma=log_sigma,
        mean=dict(zip(fit.names, mean.tolist(), strict=True)),
        sigma=dict(zip(fit.names, spread.tolist(), strict=True)),
        effective_points=effective,
        draws=theta[np.minimum(at, len(theta) - 1)],
    )


class _Sampled:
    """A model's likelihood as a function of standard normal numbers."""

    def __init__(self, fit: Minimum, priors: Sequence[PriorDensity]) -> None:
        self._statistic: Statistic = fit.statistic
        self._weights, self._priors = fit.weights, priors

    def values(self, z: Array) -> Array:
        """(points, free) parameters of (points, free) standard normal numbers."""
        return np.array([p.value(of) for p, of in zip(self._priors, z.T, strict=True)]).T

    def log_likelihood(self, theta: Array) -> Array:
        """(points,) of (points, free) parameters, up to a constant of the campaign."""
        predicted = self._statistic.model.predict_many(theta)[:, self._statistic.used]
        residuals = self._weights.whiten(self._statistic.signal - predicted)
        chi2 = np.einsum("pr,pr->p", residuals, residuals)
        return np.asarray(-0.5 * (chi2 + self._weights.log_determinant))

    def maximum(self, theta: Array) -> tuple[Array, Array]:
        """(free,) numbers z where the posterior density is highest, and their covariance.

        By Gauss' and Newton's method from parameters, steps halved where they lead upwards.
        """
        z = np.array([p.z_of(value) for p, value in zip(self._priors, theta, strict=True)])
        residuals, slopes = self._linear(z)
        height = float(residuals @ residuals + z @ z)
        for _ in range(EVIDENCE.descents):
            step = -np.linalg.solve(slopes.T @ slopes + np.eye(len(z)), slopes.T @ residuals + z)
            step *= min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-12))
            for _ in range(6):
                their_residuals, their_slopes = self._linear(z + step)
                new = float(their_residuals @ their_residuals + (z + step) @ (z + step))
                if new < height:
                    break
                step = 0.5 * step
            else:
                break
            gained, z, height = height - new, z + step, new
            residuals, slopes = their_residuals, their_slopes
            if gained < 1e-3:
                break
        return z, np.asarray(np.linalg.inv(slopes.T @ slopes + np.eye(len(z))), float)

    def _linear(self, z: Array) -> tuple[Array, Array]:
        """(used,) whitened residuals and their (used, free) slopes."""
        step, whiten = EVIDENCE.step, self._weights.whiten
        theta, higher, lower = self.values(np.vstack([z, z + step, z - step]))
        prediction = self._statistic.model.predict(theta)
        slopes = prediction.signal_slopes[self._statistic.used] * ((higher - lower) / (2.0 * step))
        return whiten(self._statistic.residuals(prediction)), -whiten(slopes.T).T


def _gathered(z: Array, share: Array) -> tuple[Array, Array]:
    """Mean and covariance of weighted points; not narrower than a few of them tell."""
    mean = share @ z
    away = z - mean
    covariance = (share * away.T) @ away
    return mean, covariance + EVIDENCE.narrowest**2 * np.eye(z.shape[1])


def _drawn(
    modes: Sequence[tuple[Array, Array]], points: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """(points, free) numbers of a mixture, and the logarithm of the prior over its density there.

    Of the prior, a standard normal density, and of Student's t around each maximum, its centre and
    covariance: their tails, somewhat wider, let no weight become large.
    """
    dimensions, n = len(modes[0][0]), EVIDENCE.sampled_tails
    shares = [EVIDENCE.from_prior] + [(1.0 - EVIDENCE.from_prior) / len(modes)] * len(modes)
    counts = [round(share * points) for share in shares]
    counts[0] += points - sum(counts)
    parts = [rng.standard_normal((counts[0], dimensions))]
    factors: list[Array] = [
        np.asarray(EVIDENCE.wider * np.linalg.cholesky(covariance), float)
        for _, covariance in modes
    ]
    for (centre, _), factor, count in zip(modes, factors, counts[1:], strict=True):
        stretch = np.sqrt(n / rng.chisquare(n, count))[:, None]
        normal = rng.standard_normal((count, dimensions)) @ factor.T
        parts.append(centre + normal * stretch)
    z = np.concatenate(parts)
    log_normal = -0.5 * np.einsum("pk,pk->p", z, z) - 0.5 * dimensions * math.log(2.0 * math.pi)
    log_densities = [log_normal] + [
        _log_student(n, z - centre, factor)
        for (centre, _), factor in zip(modes, factors, strict=True)
    ]
    return z, log_normal - log_sum(np.log(shares)[:, None] + log_densities)


def log_sum(logs: Array) -> Array:
    """Logarithm of the sum of exp(logs) over their first axis; scipy's takes many times as long."""
    highest = np.maximum(logs.max(axis=0), np.finfo(float).min)  # of none there is -inf
    with np.errstate(divide="ignore"):
        return np.asarray(highest + np.log(np.exp(logs - highest).sum(axis=0)))


def _log_student(n: float, away: Array, factor: Array) -> Array:
    """(points,) logarithm of Student's density with n degrees of freedom.

    At (points, free) distances from its centre; its scale matrix is ``factor factor^T``.
    """
    k = away.shape[1]
    squared = (np.linalg.solve(factor, away.T) ** 2).sum(0)
    log_determinant = float(np.log(np.diag(factor)).sum())
    constant = math.lgamma((n + k) / 2) - math.lgamma(n / 2) - 0.5 * k * math.log(n * math.pi)
    return np.asarray(constant - log_determinant - 0.5 * (n + k) * np.log1p(squared / n), float)
