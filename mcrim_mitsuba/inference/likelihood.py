"""The statistic of readings and priors, its minima, and the intervals around them by MINUIT."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from iminuit import Minuit
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.special import chdtrc

from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference.model import Model, Prediction

# Smallest eigenvalue of the Fisher information (of parameters scaled to unit diagonal) that
# still tells the parameters apart: below it is rounding.
_LEAST_INFORMATION = 1e-10
# Distance from a bound, in standard errors, that counts as being there.
_AT_BOUND = 0.02
#: Updates of the covariance, and the shift (in standard errors, squared) that ends them.
MOST_UPDATES, SETTLED = 6, 1e-4


def p_value(chi2: float, ndf: int) -> float | None:
    """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
    return float(chdtrc(ndf, chi2)) if ndf > 0 else None


def undetermined(information: Array, names: Sequence[str]) -> list[str]:
    """Parameters that some combination of can change without changing a reading.

    `information` is Fisher's, (names, names), priors included.
    """
    diagonal = np.diag(information)
    without = [name for name, known in zip(names, diagonal, strict=True) if not known > 0]
    if without or not names:
        return without
    values, vectors = np.linalg.eigh(information / np.sqrt(np.outer(diagonal, diagonal)))
    weights = np.abs(vectors[:, 0]) if values[0] < _LEAST_INFORMATION else np.zeros(len(names))
    return [name for name, weight in zip(names, weights, strict=True) if weight > 0.1]


def local_minima(heights: Sequence[float]) -> list[int]:
    """Places lower than both neighbours, the lowest first."""
    walls = np.concatenate([[np.inf], heights, [np.inf]])
    found = np.flatnonzero((walls[1:-1] <= walls[:-2]) & (walls[1:-1] <= walls[2:]))
    return found[np.argsort(walls[1:-1][found], kind="stable")].tolist()


@dataclass(frozen=True)
class ErrorMatrices:
    """Covariance of the readings in use, by origin.

    It is held by what makes it: campaigns have up to 10,000 readings, whose matrices, (used, used)
    float64, are made only for who asks for them.
    """

    #: (used,) float64: Squares of the readings' own errors.
    variance: Array
    #: (used,) float64: The error that a reading shares with all of its mounting: group_sigma times
    #: the predicted signal.
    shared: Array
    #: (used,) int64: Number of the mounting.
    mountings: NDArray[np.int64]
    #: (used, sources) float64: Errors of the predictions by independent sources.
    simulated: Array
    #: (used, used) float64: Covariance of what no parameter explains, if it is to be weighed.
    unexplained: Array | None = None

    @property
    def readings(self) -> Array:
        """Their own errors, what mountings share and what no parameter explains."""
        matrix = np.diag(self.variance)
        if self.shared.any():
            same = self.mountings[:, None] == self.mountings
            matrix = matrix + same * np.outer(self.shared, self.shared)
        return matrix if self.unexplained is None else matrix + self.unexplained

    @property
    def total(self) -> Array:
        """Covariance of reading minus prediction."""
        return self.readings + self.simulated @ self.simulated.T

    def of(self, rows: NDArray[np.bool_]) -> ErrorMatrices:
        """Those of some readings, of which nothing is unexplained."""
        return ErrorMatrices(
            self.variance[rows], self.shared[rows], self.mountings[rows], self.simulated[rows]
        )

    def statistical_variances(self, response: Array) -> Array:
        """(k,) variances, by `readings`, of numbers that move by (k, used) with the readings."""
        shared = [np.bincount(self.mountings, moved) for moved in response * self.shared]
        variances = response**2 @ self.variance + np.square(shared).sum(axis=-1)
        if self.unexplained is not None:
            variances += ((response @ self.unexplained) * response).sum(axis=1)
        return variances


class Whitener:
    """Weighs readings by the inverse of their covariance, of which no matrix is made.

    The covariance is diagonal but for what few sources add, S of them: u u^T each. Where these are
    orthogonal, 1 / sqrt(1 + u u^T) takes from a vector a part of what it has along them.
    """

    def __init__(self, errors: ErrorMatrices) -> None:
        # what no two readings share belongs to their own errors
        lone = np.count_nonzero(errors.simulated, axis=0) < 2
        variance = errors.variance + np.square(errors.simulated[:, lone]).sum(axis=1)
        self._root = 1.0 / np.sqrt(variance)
        shared = errors.shared * self._root
        squares = np.bincount(errors.mountings, shared**2)
        roots = np.sqrt(1.0 + squares)
        mountings = csr_array((shared, (errors.mountings, np.arange(len(shared)))))
        # (sources, used) directions and what is taken along them
        self._sources: list[tuple[Any, Array]] = []
        if shared.any():
            self._sources = [(mountings, -1.0 / (roots * (1.0 + roots)))]
        rest = self._taken(self._root * errors.simulated[:, ~lone].T, self._sources)
        _, sizes, directions = np.linalg.svd(rest, full_matrices=False)
        self._sources.append((directions, 1.0 / np.sqrt(1.0 + sizes**2) - 1.0))
        #: Of the covariance.
        self.log_determinant = float(
            np.log(variance).sum() + np.log1p(squares).sum() + np.log1p(sizes**2).sum()
        )

    def whiten(self, x: Array) -> Array:
        """W x of (..., used) vectors, W^T W the inverse covariance."""
        return self._taken(self._root * x, self._sources)

    def weigh(self, x: Array) -> Array:
        """The inverse covariance times (..., used) vectors."""
        return self._root * self._taken(self.whiten(x), self._sources[::-1])

    @staticmethod
    def _taken(x: Array, sources: list[tuple[Any, Array]]) -> Array:
        for directions, parts in sources:
            x = x + (x @ directions.T * parts) @ directions
        return x


class Likelihood:
    """Readings and priors against a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        #: The free parameters, in the model's order.
        self.free = tuple(model.free)
        self.names = tuple(p.name for p in self.free)
        #: (free,) Where the campaign lets searches begin; 0 where it does not say.
        self.start = np.array([0.0 if math.isnan(p.start) else p.start for p in self.free])
        #: (readings,) Which of the model's readings the statistic uses.
        self.used = np.array([reading.use for reading in model.readings])
        used = [reading for reading in model.readings if reading.use]
        self.labels = tuple(reading.label for reading in used)
        named = np.array([model.campaign.parameter_of(reading, SCALE) for reading in used])
        #: The free scales, the campaign's and those of samples, by the (used,) readings' masks.
        self.scales = {n: named == n for n in dict.fromkeys(named.tolist()) if n in self.names}
        #: (used,) The readings, and the squares of their own errors.
        self.signal = np.array([reading.signal for reading in used])
        self.variance = np.array([reading.sigma for reading in used]) ** 2
        self._shared = np.array([reading.group_sigma or 0.0 for reading in used])
        groups = [reading.group or "" for reading in used]
        self._mountings = np.unique(groups, return_inverse=True)[1]
        # relative covariance of what no parameter explains
        self._unexplained: Array | None = None
        #: (free,) The weight is 1 / sigma^2; both are 0 without a prior.
        self.prior = np.array([0.0 if p.prior is None else p.prior for p in self.free])
        self.prior_weight = np.array(
            [0.0 if p.prior_sigma is None else p.prior_sigma**-2 for p in self.free]
        )

    @property
    def knowns(self) -> int:
        """Readings in use + priors."""
        return len(self.signal) + int(np.count_nonzero(self.prior_weight))

    @property
    def ndf(self) -> int:
        """Readings in use + priors - free parameters."""
        return self.knowns - len(self.free)

    def residuals(self, prediction: Prediction) -> Array:
        """(used,) reading minus predicted signal."""
        return self.signal - prediction.signal[self.used]

    def signal_slopes(self, prediction: Prediction) -> Array:
        """(used, free) d predicted signal / d parameter."""
        return prediction.signal_slopes[self.used]

    def errors_at(self, theta: Array) -> ErrorMatrices:
        """Covariance of the readings in use as a point in parameter space predicts it."""
        prediction = self.model.predict(theta, covariance=True)
        assert prediction.eta_errors is not None  # asked for
        signal, per_eta = prediction.signal[self.used], prediction.signal_per_eta[self.used]
        return ErrorMatrices(
            self.variance,
            self._shared * signal,
            self._mountings,
            per_eta[:, None] * prediction.eta_errors[self.used],
            None if self._unexplained is None else self._unexplained * np.outer(signal, signal),
        )

    def errors_before_any_fit(self) -> ErrorMatrices:
        """The same without a model: shared errors from the readings, no Monte Carlo error."""
        none = np.zeros((len(self.signal), 0))
        return ErrorMatrices(self.variance, self._shared * self.signal, self._mountings, none)

    def best_scale(self, eta: Array, errors: ErrorMatrices, name: str = SCALE) -> float:
        """The scale that fits (readings,) efficiencies best: the statistic is quadratic in it."""
        rows = self.scales[name]
        eta = eta[self.used][rows]
        weighted = Whitener(errors.of(rows)).weigh(eta)
        place = self.names.index(name)
        weight, prior = self.prior_weight[place], self.prior[place]
        return float((weighted @ self.signal[rows] + weight * prior) / (weighted @ eta + weight))

    def prior_pulls(self, theta: Array) -> Array:
        """(free,) distance from the prior in its sigmas; 0 without a prior."""
        return (theta - self.prior) * np.sqrt(self.prior_weight)

    def side(self, place: int, value: float, curvature: float, slope: float) -> str | None:
        """The bound that a parameter has reached, if any.

        The curvature is 1 / sigma^2; of two bounds within reach it is the one that the slope of
        chi2 leads to.
        """
        close = _AT_BOUND / math.sqrt(curvature) if curvature > 0 else 0.0
        at_minimum = value - self.free[place].minimum <= close
        at_maximum = self.free[place].maximum - value <= close
        if at_minimum and at_maximum:
            return "max" if slope < 0 else "min"
        return "min" if at_minimum else "max" if at_maximum else None


class FrozenStatistic:
    """chi2 with the covariance held at one estimate of the parameters.

    The shared and the Monte Carlo errors scale with the predicted signal. Left free, they
    would let the fit buy a smaller chi2 with larger errors, unless the logarithm of their
    determinant were added; held, and updated between fits, they give the same estimate as
    iteratively reweighted least squares, without that bias and without R. W. Peelle's (which
    comes from scaling them with the readings).
    """

    def __init__(self, likelihood: Likelihood, errors: ErrorMatrices) -> None:
        self.likelihood = likelihood
        self.errors = errors
        self._whitener = Whitener(errors)
        #: Of the covariance: what two statistics with different ones differ by besides chi2.
        self.log_determinant = self._whitener.log_determinant
        self._last: tuple[bytes, Prediction] | None = None

    def chi2(self, theta: Array) -> float:
        """Readings' chi2 plus the priors'."""
        residuals = self._whitener.whiten(self.likelihood.residuals(self._predict(theta)))
        pulls = self.likelihood.prior_pulls(theta)
        return float(residuals @ residuals + pulls @ pulls)

    def gradient(self, theta: Array) -> Array:
        """(free,) d chi2 / d parameter, exact."""
        prediction = self._predict(theta)
        weighted = self._whitener.weigh(self.likelihood.residuals(prediction))
        of_readings = self.likelihood.signal_slopes(prediction).T @ weighted
        of_priors = self.likelihood.prior_pulls(theta) * np.sqrt(self.likelihood.prior_weight)
        return 2.0 * (of_priors - of_readings)

    def information(self, theta: Array) -> Array:
        """(free, free) Fisher information, priors included."""
        slopes = self._whitener.whiten(self.likelihood.signal_slopes(self._predict(theta)).T)
        return slopes @ slopes.T + np.diag(self.likelihood.prior_weight)

    def response(self, theta: Array) -> Array:
        """(free, used) J^T C^-1: how the readings move the estimate, before the covariance."""
        return self._whitener.weigh(self.likelihood.signal_slopes(self._predict(theta)).T)

    def _predict(self, theta: Array) -> Prediction:
        """The model's prediction; a minimiser asks for chi2 and gradient of one point in turn."""
        key = theta.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, self.likelihood.model.predict(theta))
        return self._last[1]


# ---- minima and intervals, by MINUIT ----
#
# alpha_scat is searched in its logarithm, since eta changes with it over decades; intervals
# by profile likelihood do not depend on that. F. James and M. Roos, Comput. Phys. Commun. 10
# (1975) 343 (MINUIT); F. James, MINUIT manual (CERN D506), section 7.3 (MINOS).

# Points of the scan in alpha_scat that finds the starts, and how many of its minima to follow.
_SCAN_POINTS = 31
_MOST_STARTS = 3
# MINUIT stops at an expected distance to the minimum of 0.002 times this.
_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Optimum:
    """A minimum of the statistic."""

    #: (free,) float64: Parameters, in the order of the model's.
    theta: Array
    chi2: float
    #: With the covariance that the minimum itself predicts, within the tolerance.
    statistic: FrozenStatistic
    converged: bool
    #: Per parameter, the bound that stopped it.
    at_bound: tuple[str | None, ...]

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.statistic.likelihood.names, self.theta.tolist(), strict=True))

    @property
    def information(self) -> Array:
        """(free, free) Fisher information, priors included."""
        return self.statistic.information(self.theta)

    @property
    def deviance(self) -> float:
        """-2 log(likelihood) up to a constant, by which minima compare.

        chi2 alone would prefer the minimum with the largest Monte Carlo errors.
        """
        return self.chi2 + self.statistic.log_determinant


@dataclass(frozen=True)
class Interval:
    """Where the profile of the statistic has risen by 1: 68.3 % for a Gaussian likelihood."""

    lower: float
    upper: float
    #: Ends that are the parameter's bound, before the statistic had risen by 1.
    cut: tuple[str, ...]


def find_minima(likelihood: Likelihood) -> list[Optimum]:
    """Minima of the statistic, the lowest first; more than one where the model is ambiguous."""
    found: list[Optimum] = []
    for start in _starts(likelihood):
        optimum = _descend(likelihood, start)
        gaps = [_distance(optimum.theta, other.theta, optimum.information) for other in found]
        if all(gap > 0.01 for gap in gaps):
            found.append(optimum)
    return sorted(found, key=lambda optimum: optimum.deviance)


def _starts(likelihood: Likelihood) -> list[Array]:
    """Local minima of a scan in alpha_scat, each with its best scale; others at their start."""
    free, names = likelihood.free, likelihood.names
    errors = likelihood.errors_before_any_fit()
    statistic = FrozenStatistic(likelihood, errors)
    grid = [likelihood.start.copy()]
    if ALPHA_SCAT in names:
        known = free[names.index(ALPHA_SCAT)]
        grid = [likelihood.start.copy() for _ in range(_SCAN_POINTS)]
        values = np.geomspace(known.minimum, known.maximum, _SCAN_POINTS)
        for theta, value in zip(grid, values, strict=True):
            theta[names.index(ALPHA_SCAT)] = value
    for name in likelihood.scales:
        place = names.index(name)
        known = free[place]
        for theta in grid:
            best = likelihood.best_scale(likelihood.model.predict(theta).eta, errors, name)
            theta[place] = min(max(best, known.minimum), known.maximum)
    heights = [statistic.chi2(theta) for theta in grid]
    return [grid[i] for i in local_minima(heights)[:_MOST_STARTS]]


def _descend(likelihood: Likelihood, theta: Array) -> Optimum:
    """The minimum that a start leads to, its covariance updated until it agrees with it."""
    for _ in range(MOST_UPDATES):
        before = theta
        statistic = FrozenStatistic(likelihood, likelihood.errors_at(theta))
        theta, chi2, converged = _minimise(statistic, theta)
        information = statistic.information(theta)
        if _distance(theta, before, information) < SETTLED:
            break
    slopes = statistic.gradient(theta)
    sides = map(likelihood.side, range(len(theta)), theta, np.diag(information), slopes)
    return Optimum(theta, chi2, statistic, converged, tuple(sides))


def _distance(one: Array, other: Array, information: Array) -> float:
    """Squared distance of two estimates in standard errors."""
    return float((one - other) @ information @ (one - other))


def _minimise(
    statistic: FrozenStatistic, start: Array, held: int | None = None
) -> tuple[Array, float, bool]:
    """Parameters at the minimum, its chi2, and whether MINUIT was content."""
    if len(start) == (held is not None):
        return start, statistic.chi2(start), True
    minuit = _minuit(statistic, start)
    if held is not None:
        minuit.values[held] = _internal(statistic.likelihood.free[held], start[held])
        minuit.fixed[held] = True
    minuit.migrad()
    converged = minuit.valid
    if not converged:
        # at a node of a response with kinks, slopes do not vanish: SIMPLEX needs none
        chi2 = minuit.fval
        minuit.simplex()
        converged = minuit.valid and chi2 - minuit.fval < SETTLED
    return _external(statistic, np.array(minuit.values)), float(minuit.fval), bool(converged)


def _minuit(statistic: FrozenStatistic, start: Array) -> Minuit:
    """MINUIT, ready to minimise from a start."""
    free = statistic.likelihood.free
    limits = [(_internal(p, p.minimum), _internal(p, p.maximum)) for p in free]
    inside, first_steps = [], []
    for parameter, value, (low, high) in zip(free, start, limits, strict=True):
        x = _internal(parameter, value)
        # clear of the bounds, on which MINUIT's transformation has no slope
        margin = 0.01 * (high - low if math.isfinite(high - low) else max(abs(x), 1e-6))
        inside.append(min(max(x, low + margin), high - margin))
        own = 0.1 if parameter.logarithmic else parameter.prior_sigma
        first_steps.append(0.05 * abs(inside[-1]) or 0.01 if own is None else own)

    def chi2(x: Array) -> float:
        return statistic.chi2(_external(statistic, x))

    def gradient(x: Array) -> Array:
        theta = _external(statistic, x)
        # d alpha_scat / d log(alpha_scat) = alpha_scat
        chain = [v if p.logarithmic else 1.0 for p, v in zip(free, theta, strict=True)]
        return statistic.gradient(theta) * chain

    minuit = Minuit(chi2, np.array(inside), grad=gradient, name=[p.name for p in free])
    minuit.errordef = Minuit.LEAST_SQUARES
    minuit.tol = _TOLERANCE
    minuit.limits = limits
    minuit.errors = first_steps
    return minuit


def _internal(parameter: CampaignParameter, value: float) -> float:
    return math.log(value) if parameter.logarithmic else float(value)


def _external_value(parameter: CampaignParameter, x: float) -> float:
    value = math.exp(x) if parameter.logarithmic else float(x)
    # the logarithm of a bound may come back as a number beyond it
    return min(max(value, parameter.minimum), parameter.maximum)


def _external(statistic: FrozenStatistic, x: Array) -> Array:
    """(free,) parameters of MINUIT's variables; readings at which arithmetic ends are refused."""
    if not np.all(np.isfinite(x)):
        measured = statistic.likelihood.model.campaign.measurements
        low, high = (side(measured.in_use, key=lambda r: r.signal / r.sigma) for side in (min, max))
        raise InputError(
            "the readings cannot be fitted together: they are from "
            f"{low.signal:g} ± {low.sigma:g} ({low.label}) to {high.signal:g} ± {high.sigma:g} "
            f"({high.label})",
            "check their units and errors",
            path=measured.path,
        )
    free = statistic.likelihood.free
    return np.array([_external_value(p, value) for p, value in zip(free, x, strict=True)])


def intervals(optimum: Optimum) -> list[Interval]:
    """Interval of every parameter by MINOS; by following the profile where MINOS cannot.

    MINOS extrapolates from the curvature in MINUIT's transformed variables, and these have
    none at a bound.
    """
    found_by_minos = _minos(optimum)
    found = []
    for index, parameter in enumerate(optimum.statistic.likelihood.free):
        ends, cut = [], []
        for side, bound in (("min", parameter.minimum), ("max", parameter.maximum)):
            end, reached = found_by_minos.get((parameter.name, side)), True
            if end is None:
                end, reached = _follow_profile(optimum, index, bound)
            ends.append(end)
            cut += [] if reached else [side]
        found.append(Interval(ends[0], ends[1], tuple(cut)))
    return found


def _minos(optimum: Optimum) -> dict[tuple[str, str], float]:
    """Those ends of the intervals that MINOS finds, by parameter and side."""
    if not optimum.converged or any(optimum.at_bound):
        return {}
    minuit = _minuit(optimum.statistic, optimum.theta)
    minuit.migrad()
    if not minuit.valid:
        return {}
    minuit.minos()
    ends = {}
    for parameter in optimum.statistic.likelihood.free:
        error, x = minuit.merrors[parameter.name], minuit.values[parameter.name]
        if error.lower_valid:
            ends[parameter.name, "min"] = _external_value(parameter, x + error.lower)
        if error.upper_valid:
            ends[parameter.name, "max"] = _external_value(parameter, x + error.upper)
    return ends


def _follow_profile(optimum: Optimum, index: int, bound: float) -> tuple[float, bool]:
    """Where the profile has risen by 1 on the way to a bound; the bound, False if nowhere."""
    best = optimum.theta[index]
    theta = optimum.theta

    def rise(value: float) -> float:
        nonlocal theta
        start = theta.copy()
        start[index] = value
        theta, chi2, _ = _minimise(optimum.statistic, start, held=index)
        return chi2 - optimum.chi2 - 1.0

    step = math.copysign(1.0 / math.sqrt(optimum.information[index, index]), bound - best)
    inner = best
    while inner != bound:
        outer = best + step if abs(step) < abs(bound - best) else bound
        if rise(outer) > 0:
            end = brentq(rise, inner, outer, xtol=1e-4 * abs(outer - inner), rtol=1e-6)
            return float(end), True
        inner, step = outer, 2.0 * step
    return float(bound), False
