"""Two ways down a statistic, and the minima that they lead to.

`newton` is for the thousands of fits of a diagnosis, which mostly start close to the answer.
`minuit` is for a campaign's own fit: it says whether it is content, and its simplex gets along with
kinks. F. James and M. Roos, Comput. Phys. Commun. 10 (1975) 343.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from iminuit import Minuit

from mcrim_mitsuba.core.descent import Array, Descent, minimise
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference.settings import LINEAR, SEARCH
from mcrim_mitsuba.inference.statistic import Statistic, Weights, inverse, p_value


def newton(
    statistic: Statistic,
    theta: Array,
    weights: Weights,
    *,
    held: Sequence[int] = (),
    steps: int = 40,
    precision: float = 1e-5,
) -> Descent:
    """Walk downhill from a start, with the weights held.

    `held` are the places of parameters that stay; the rest is as for `core.descent.minimise`. The
    height is chi2, and the point is one of parameters; slopes and second derivatives are in the
    searched coordinates.
    """

    def height_at(x: Array) -> tuple[float, Array, Array]:
        residuals, slopes = statistic.evaluate(statistic.external(x), weights)
        return float(residuals @ residuals), slopes.T @ residuals, slopes.T @ slopes

    end = minimise(
        height_at,
        statistic.internal(theta),
        statistic.low,
        statistic.high,
        held=held,
        longest=np.where(statistic.logarithmic, SEARCH.longest_log_step, np.inf),
        steps=steps,
        precision=precision,
    )
    return end._replace(point=statistic.external(end.point))


def minuit(statistic: Statistic, theta: Array, weights: Weights) -> tuple[Array, float, bool]:
    """Parameters, chi2 and whether MINUIT is content, from a start with the weights held."""
    if not len(theta):
        return theta, statistic.chi2(theta, weights), True
    latest: dict[bytes, tuple[float, Array]] = {}

    def evaluated(x: Array) -> tuple[float, Array]:
        # MINUIT asks for chi2 and slopes of one point in turn
        key = x.tobytes()
        if key not in latest:
            residuals, slopes = statistic.evaluate(statistic.external(x), weights)
            latest.clear()
            latest[key] = float(residuals @ residuals), 2.0 * residuals @ slopes
        return latest[key]

    x = statistic.internal(theta)
    inside, first_steps = [], []
    limits = list(zip(statistic.low.tolist(), statistic.high.tolist(), strict=True))
    for place, (low, high) in enumerate(limits):
        # clear of the bounds, on which MINUIT's transformation has no slope
        margin = 1e-6 * (high - low if math.isfinite(high - low) else abs(x[place]) or 1e-6)
        inside.append(min(max(x[place], low + margin), high - margin))
        prior_weight = float(statistic.prior_weight[place])
        step = 0.05 * abs(inside[-1]) or 0.01
        if statistic.logarithmic[place]:
            step = 0.1
        elif prior_weight:
            step = prior_weight**-0.5
        first_steps.append(step)
    start = np.array(inside)
    search = Minuit(
        lambda x: evaluated(x)[0], start, grad=lambda x: evaluated(x)[1], name=statistic.names
    )
    search.errordef = Minuit.LEAST_SQUARES
    search.tol = SEARCH.minuit_tolerance
    search.limits = limits
    search.errors = first_steps
    search.migrad()
    # MINUIT's transformation has no slope at a bound, and it creeps there
    for place, walls in enumerate(limits):
        at_wall = np.array(search.values)
        at_wall[place] = min(walls, key=lambda wall: abs(wall - search.values[place]))
        if np.isfinite(at_wall[place]) and evaluated(at_wall)[0] < search.fval:
            search.values[place], search.fixed[place] = at_wall[place], True
    if any(search.fixed) and not all(search.fixed):
        search.migrad()
    content = search.valid
    if not content:
        # at a node of a response with kinks, slopes do not vanish: SIMPLEX needs none
        before = search.fval
        search.simplex()
        content = search.valid and before - search.fval < SEARCH.settled
    return statistic.external(np.array(search.values)), float(search.fval), bool(content)


@dataclass(frozen=True, eq=False)
class Minimum:
    """A minimum of the statistic, with what the linear theory around it needs."""

    statistic: Statistic
    #: (free,) float64
    theta: Array
    #: With `weights`, which the minimum itself predicts.
    chi2: float
    weights: Weights
    #: (readings,) float64: Predicted, for all readings.
    signal: Array
    #: (used, free) float64: d predicted signal / d parameter.
    slopes: Array
    converged: bool
    #: Per parameter, the bound that stopped it.
    at_bound: tuple[str | None, ...]

    @classmethod
    def at(
        cls, statistic: Statistic, theta: Array, chi2: float, weights: Weights, converged: bool
    ) -> Minimum:
        """The minimum where a descent ended."""
        theta = statistic.at_bounds(theta)
        prediction = statistic.model.predict(theta)
        slopes = prediction.signal_slopes[statistic.used]
        whitened = weights.whiten(slopes.T)
        # half the first and second derivatives of chi2 along each parameter: which bound stopped it
        half_slopes = (theta - statistic.prior) * statistic.prior_weight
        half_slopes -= whitened @ weights.whiten(statistic.residuals(prediction))
        curvatures = (whitened**2).sum(axis=1) + statistic.prior_weight
        sides = tuple(map(statistic.side, range(len(theta)), theta, curvatures, half_slopes))
        return cls(statistic, theta, chi2, weights, prediction.signal, slopes, converged, sides)

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.statistic.names

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return self.statistic.values(self.theta)

    @property
    def ndf(self) -> int:
        """Readings in use + priors - free parameters."""
        return self.statistic.ndf

    @property
    def p_value(self) -> float | None:
        """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
        return p_value(self.chi2, self.ndf)

    @property
    def deviance(self) -> float:
        """-2 log(likelihood) up to a constant, by which minima compare.

        chi2 alone would prefer the minimum with the largest Monte Carlo errors.
        """
        return self.chi2 + self.weights.log_determinant

    @property
    def residuals(self) -> Array:
        """(used,) reading minus prediction."""
        return self.statistic.signal - self.signal[self.statistic.used]

    @cached_property
    def weighted_residuals(self) -> Array:
        """(used,) C^-1 r at the minimum; P r of `precision` has what priors pull besides."""
        return self.weights.weigh(self.residuals)

    @cached_property
    def information(self) -> Array:
        """(free, free) Fisher information, priors included."""
        whitened = self.weights.whiten(self.slopes.T)
        return whitened @ whitened.T + np.diag(self.statistic.prior_weight)

    @cached_property
    def bounds_weight(self) -> Array:
        """(free,) 1 / variance of what bounds tell of a parameter that is hardly known otherwise.

        Where the information allows more than they do, that is an even distribution between them:
        what lies beyond must not widen other errors. It is 0 elsewhere.
        """
        low, high = self.statistic.bounds
        squared = np.square(high - low)
        return np.where(np.diag(self._unbounded) > squared, 12.0 / squared, 0.0)

    @cached_property
    def _unbounded(self) -> Array:
        return inverse(self.information)

    @cached_property
    def covariance(self) -> Array:
        """(free, free) inverse of the information, with what the bounds tell where that is more."""
        if not self.bounds_weight.any():
            return self._unbounded
        return inverse(self.information + np.diag(self.bounds_weight))

    @cached_property
    def response(self) -> Array:
        """(free, used) d parameter / d reading, to first order."""
        return self.covariance @ self.weights.weigh(self.slopes.T)

    @cached_property
    def movable(self) -> Array:
        """Indices of the parameters that no bound stops, and that act at all between theirs."""
        low, high = self.statistic.bounds
        sigmas = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        acts = high - low > LINEAR.at_bound * sigmas
        sides = enumerate(self.at_bound)
        return np.array([i for i, side in sides if side is None and acts[i]], int)

    @cached_property
    def precision(self) -> Array:
        """(used, used) inverse covariance of readings whose parameters are unknown.

        P = C^-1 - C^-1 J (J^T C^-1 J + prior weights)^-1 J^T C^-1: what the parameters can
        follow weighs nothing. Parameters at a bound do not follow.
        """
        at = self.movable
        followed = self.weights.weigh(self.slopes[:, at].T)
        within = inverse(self.information[np.ix_(at, at)])
        return self.weights.inverse - followed.T @ within @ followed

    def distance(self, theta: Array) -> float:
        """Squared distance of (free,) parameters from here, in standard errors."""
        away = theta - self.theta
        return float(away @ self.information @ away)


def settle(statistic: Statistic, theta: Array, *, precision: float = 1e-5) -> Minimum:
    """The minimum that a start leads to, its covariance updated until it agrees with it."""
    for _ in range(SEARCH.most_updates):
        start, weights = theta, Weights(statistic.errors_at(theta))
        end = newton(statistic, theta, weights, precision=precision)
        minimum = Minimum.at(statistic, end.point, end.height, weights, end.converged)
        theta = end.point
        if minimum.distance(start) < SEARCH.settled:
            break
    return minimum


def best_of(statistic: Statistic, starts: Iterable[Array], weights: Weights) -> Minimum:
    """The lowest minimum that some (free,) starts lead to.

    The weights are held while the starts are followed; the lowest two then get their own.
    """
    ends: list[Descent] = []
    for start in starts:
        descent = newton(statistic, start, weights)
        rises = (abs(descent.height - end.height) / (1.0 + end.height) for end in ends)
        if all(rise > SEARCH.same_height for rise in rises):
            ends.append(descent)
    ends.sort(key=lambda end: end.height)
    minima = [settle(statistic, end.point) for end in ends[:2]]
    return min(minima, key=lambda minimum: minimum.deviance)


def find_minima(statistic: Statistic) -> list[Minimum]:
    """Minima of a campaign about which nothing is known, the lowest first.

    More than one where the model is ambiguous. alpha_scat and sizes of effects are scanned; every
    minimum of a scan is followed by Newton's method, and ended by MINUIT.
    """
    weights = Weights(statistic.errors_before_any_fit())
    minima: list[Minimum] = []
    for start in _starts(statistic, weights):
        end = newton(statistic, start, weights)
        rough = settle(statistic, end.point, precision=SEARCH.newton_precision)
        if any(rough.distance(other.theta) <= SEARCH.apart for other in minima):
            continue
        theta, chi2, content = minuit(statistic, rough.theta, rough.weights)
        # MINUIT begins clear of the bounds, and may end a little above where it was
        if chi2 > rough.chi2:
            theta, chi2 = rough.theta, rough.chi2
        minimum = Minimum.at(statistic, theta, chi2, rough.weights, content)
        if all(minimum.distance(other.theta) > SEARCH.apart for other in minima):
            minima.append(minimum)
    return sorted(minima, key=lambda minimum: minimum.deviance)


def _starts(statistic: Statistic, weights: Weights) -> list[Array]:
    """Local minima of a scan in alpha_scat, each with its best scale; all else at its start.

    And, from the lowest of them on, those along the size of each effect, all else fitted: responses
    bend at the nodes of that.
    """
    theta = statistic.theta({})
    scales = [statistic.index(name) for name in statistic.scales]
    theta[scales] = np.where(theta[scales] > 0.0, theta[scales], 1.0)
    others = [place for place in range(len(theta)) if place not in scales]

    def with_best_scale(start: Array) -> Descent:
        for name, rows in statistic.scales.items():
            place = statistic.index(name)
            predicted = statistic.model.predict(start).signal[statistic.used]
            # the statistic is nearly quadratic in the scale: the descent mends what is left
            start[place] *= float(np.median((statistic.signal / predicted)[rows]))
        start = np.clip(start, *statistic.bounds)
        return newton(statistic, start, weights, held=others, steps=3, precision=0.01)

    def lowest(scan: Sequence[Descent]) -> list[Array]:
        minima = local_minima([end.height for end in scan])
        return [scan[i].point for i in minima[: SEARCH.most_starts]]

    starts = [with_best_scale(theta.copy()).point]
    if ALPHA_SCAT in statistic.names:
        bounds = statistic.parameter(ALPHA_SCAT)
        values = np.geomspace(bounds.minimum, bounds.maximum, SEARCH.scan_points)
        at = [{**statistic.values(theta), ALPHA_SCAT: value} for value in values]
        scan = [with_best_scale(statistic.theta(each)) for each in at]
        if np.ptp([end.height for end in scan]) >= SEARCH.flat:
            starts = lowest(scan)
    campaign, first = statistic.model.campaign, statistic.values(starts[0])
    sizes = (size for effect in campaign.switched_on for size in effect.parameters)
    for size in (size for size in sizes if size.name in statistic.names):
        bounds, held = statistic.parameter(size.name), [statistic.index(size.name)]
        nodes = size.origin(campaign.values) + np.array(size.nodes)
        values = np.unique(np.clip(nodes, bounds.minimum, bounds.maximum))
        along = [statistic.theta({**first, size.name: value}) for value in values]
        ends = (newton(statistic, t, weights, held=held, steps=4, precision=0.05) for t in along)
        starts += lowest([*ends])
    return starts


def local_minima(heights: Sequence[float]) -> list[int]:
    """Places lower than both neighbours, the lowest first."""
    walls = np.concatenate([[np.inf], heights, [np.inf]])
    places = np.flatnonzero((walls[1:-1] <= walls[:-2]) & (walls[1:-1] <= walls[2:]))
    return places[np.argsort(walls[1:-1][places], kind="stable")].tolist()
