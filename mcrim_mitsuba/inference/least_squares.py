"""Fits of one campaign by the hundred, as a diagnosis needs them.

`likelihood` finds a campaign's minimum with MINUIT; a diagnosis fits the campaign hundreds of
times, mostly starting close to the answer, and takes `core.descent`. The statistic is that of
`likelihood`: the covariance is held during a descent and updated between descents.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.descent import Array, minimise
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference.likelihood import (
    MOST_UPDATES,
    SETTLED,
    ErrorMatrices,
    Likelihood,
    Whitener,
    local_minima,
    p_value,
)
from mcrim_mitsuba.inference.model import Model

# Points of the scan in alpha_scat that finds the baseline's starts.
_SCAN_POINTS = 13
# Longest step in the logarithm of alpha_scat.
_LONGEST_STEP = 1.5


@dataclass(frozen=True)
class Weights:
    """A covariance of the readings in use, ready to weigh with."""

    #: (used, used) float64
    covariance: Array
    #: (used, used) float64: W with W^T W the inverse covariance.
    whitener: Array
    #: Of the covariance.
    log_determinant: float

    @classmethod
    def of(cls, covariance: Array) -> Weights:
        """From a (used, used) covariance."""
        factor = np.linalg.cholesky(covariance)
        return cls(covariance, np.linalg.inv(factor), 2.0 * float(np.log(np.diag(factor)).sum()))

    def whiten(self, x: Array) -> Array:
        """W x of (..., used) vectors."""
        return (self.whitener @ x.T).T

    @cached_property
    def inverse(self) -> Array:
        """(used, used) inverse covariance."""
        return self.whitener.T @ self.whitener


class LeastSquaresProblem(Likelihood):
    """Readings and priors against a model, in the coordinates that are searched.

    `coordinates` are ``log`` or ``reciprocal`` for the parameters that are searched in their
    logarithm or in 1 / value. alpha_scat always is in its logarithm; all others in themselves.
    """

    def __init__(self, model: Model, coordinates: Mapping[str, str] | None = None) -> None:
        super().__init__(model)
        kinds = [
            "log" if parameter.logarithmic else (coordinates or {}).get(parameter.name, "linear")
            for parameter in self.free
        ]
        #: (free,) Which parameters are searched in their logarithm.
        self.logarithmic = np.array([kind == "log" for kind in kinds], bool)
        self._reciprocal = np.array([kind == "reciprocal" for kind in kinds], bool)
        self._curved = bool((self.logarithmic | self._reciprocal).any())
        self.bounds = tuple(np.array([(p.minimum, p.maximum) for p in self.free]).reshape(-1, 2).T)
        minimum, maximum = map(self.internal, self.bounds)
        #: (free,) The bounds in the searched coordinates.
        self.low, self.high = np.minimum(minimum, maximum), np.maximum(minimum, maximum)
        self._priors = np.flatnonzero(self.prior_weight)
        self._prior_rows = np.zeros((len(self._priors), len(self.free)))
        self._prior_rows[np.arange(len(self._priors)), self._priors] = -np.sqrt(
            self.prior_weight[self._priors]
        )

    def index(self, name: str) -> int:
        """Place of a free parameter."""
        return self.names.index(name)

    def parameter(self, name: str) -> CampaignParameter:
        """A free parameter with its bounds."""
        return self.free[self.index(name)]

    def against(self, signal: Array, prior: Array | None = None) -> LeastSquaresProblem:
        """The same model against other (used,) readings and (free,) centres of the priors."""
        other = copy.copy(self)
        other.signal = signal
        if prior is not None:
            other.prior = prior
        return other

    def with_unexplained(self, covariance: Array) -> LeastSquaresProblem:
        """The same with a (used, used) relative covariance of what the model does not explain."""
        other = copy.copy(self)
        other._unexplained = covariance
        return other

    def exchanged(self, order: NDArray[np.int64]) -> LeastSquaresProblem:
        """The same with its (used,) readings, and their own errors, in another order."""
        other = copy.copy(self)
        other.signal, other.variance = self.signal[order], self.variance[order]
        return other

    def theta(self, values: Mapping[str, float]) -> Array:
        """(free,) parameters from values by name; the others at their start."""
        return np.array([values.get(n, s) for n, s in zip(self.names, self.start, strict=True)])

    def values(self, theta: Array) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, theta.tolist(), strict=True))

    def internal(self, theta: Array) -> Array:
        """(free,) coordinates that are searched."""
        x = np.array(theta, float)
        if self._curved:
            x[self.logarithmic] = np.log(x[self.logarithmic])
            with np.errstate(divide="ignore"):
                x[self._reciprocal] = 1.0 / x[self._reciprocal]
        return x

    def external(self, x: Array) -> Array:
        """(free,) parameters of searched coordinates."""
        theta = x.copy()
        if self._curved:
            theta[self.logarithmic] = np.exp(theta[self.logarithmic])
            theta[self._reciprocal] = 1.0 / theta[self._reciprocal]
        return theta

    def slopes_of_external(self, theta: Array) -> Array:
        """(free,) d parameter / d searched coordinate."""
        chain = np.ones(len(theta))
        chain[self.logarithmic] = theta[self.logarithmic]
        chain[self._reciprocal] = -(theta[self._reciprocal] ** 2)
        return chain

    def weights_at(self, theta: Array) -> tuple[ErrorMatrices, Weights]:
        """The covariance of the readings as a point in parameter space predicts it."""
        errors = self.errors_at(theta)
        return errors, Weights.of(errors.total)

    def evaluate(self, theta: Array, weights: Weights | Whitener) -> tuple[Array, Array]:
        """Whitened residuals (used + priors,), and their slopes in the searched coordinates."""
        prediction = self.model.predict(theta)
        of_readings = weights.whiten(self.residuals(prediction))
        slopes = -weights.whiten(self.signal_slopes(prediction).T).T
        if len(self._priors):
            at = self._priors
            of_priors = (self.prior[at] - theta[at]) * np.sqrt(self.prior_weight[at])
            of_readings = np.concatenate([of_readings, of_priors])
            slopes = np.vstack([slopes, self._prior_rows])
        if self._curved:
            slopes = slopes * self.slopes_of_external(theta)
        return of_readings, slopes


def descend(
    problem: LeastSquaresProblem,
    theta: Array,
    weights: Weights | Whitener,
    *,
    held: Sequence[int] = (),
    steps: int = 40,
    precision: float = 1e-5,
) -> tuple[Array, float, bool]:
    """Parameters, chi2 and whether it converged, downhill from a start with the weights held.

    `held` are the places of parameters that stay; the rest is as for `core.descent.minimise`.
    """

    def height_at(x: Array) -> tuple[float, Array, Array]:
        residuals, slopes = problem.evaluate(problem.external(x), weights)
        return float(residuals @ residuals), slopes.T @ residuals, slopes.T @ slopes

    x, chi2, converged = minimise(
        height_at,
        problem.internal(theta),
        problem.low,
        problem.high,
        held=held,
        longest=np.where(problem.logarithmic, _LONGEST_STEP, np.inf),
        steps=steps,
        precision=precision,
    )
    # a bound's logarithm may come back as a number beyond it
    return np.clip(problem.external(x), *problem.bounds), chi2, converged


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the statistic, with what the linear theory around it needs."""

    problem: LeastSquaresProblem
    #: (free,) float64
    theta: Array
    #: With `weights`, which the minimum itself predicts.
    chi2: float
    errors: ErrorMatrices
    weights: Weights
    #: (readings,) float64: Predicted, for all readings.
    signal: Array
    #: (used, free) float64: d predicted signal / d parameter.
    slopes: Array
    converged: bool
    #: Per parameter, the bound that stopped it.
    at_bound: tuple[str | None, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.problem.names

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name."""
        return self.problem.values(self.theta)

    @property
    def ndf(self) -> int:
        """Readings in use + priors - free parameters."""
        return self.problem.ndf

    @property
    def p_value(self) -> float | None:
        """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
        return p_value(self.chi2, self.ndf)

    @property
    def deviance(self) -> float:
        """-2 log(likelihood) up to a constant, by which fits compare.

        chi2 alone would prefer the fit with the largest Monte Carlo errors.
        """
        return self.chi2 + self.weights.log_determinant

    @property
    def residuals(self) -> Array:
        """(used,) reading minus prediction."""
        return self.problem.signal - self.signal[self.problem.used]

    @cached_property
    def weighted_residuals(self) -> Array:
        """(used,) C^-1 r at the minimum; P r of `precision` has what priors pull besides."""
        return self.weights.inverse @ self.residuals

    @cached_property
    def information(self) -> Array:
        """(free, free) Fisher information, priors included."""
        whitened = self.weights.whitener @ self.slopes
        return whitened.T @ whitened + np.diag(self.problem.prior_weight)

    @cached_property
    def parameter_covariance(self) -> Array:
        """(free, free) inverse of the information; what no reading tells has a huge variance."""
        return inverse(self.information)

    @cached_property
    def movable(self) -> Array:
        """Indices of the parameters that no bound stops."""
        return np.array([i for i, side in enumerate(self.at_bound) if side is None], int)

    @cached_property
    def precision(self) -> Array:
        """(used, used) inverse covariance of readings whose parameters are unknown.

        P = C^-1 - C^-1 J (J^T C^-1 J + prior weights)^-1 J^T C^-1: what the parameters can
        follow weighs nothing. Parameters at a bound do not follow.
        """
        at = self.movable
        followed = self.weights.inverse @ self.slopes[:, at]
        return self.weights.inverse - followed @ inverse(self.information[np.ix_(at, at)]) @ (
            followed.T
        )


def inverse(matrix: Array) -> Array:
    """Inverse of a (k, k) information matrix; where it says nothing, the variance is huge."""
    if not len(matrix):
        return matrix
    diagonal = np.diag(matrix)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1e-12))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    values = np.maximum(values, 1e-13)
    return (vectors / values) @ vectors.T / np.outer(size, size)


def settle(problem: LeastSquaresProblem, theta: Array) -> Fit:
    """The minimum that a start leads to, its covariance updated until it agrees with it."""
    for _ in range(MOST_UPDATES):
        before = theta
        errors, weights = problem.weights_at(theta)
        theta, chi2, converged = descend(problem, theta, weights)
        prediction = problem.model.predict(theta)
        slopes = prediction.signal_slopes[problem.used]
        whitened = weights.whitener @ slopes
        curvatures = (whitened**2).sum(axis=0) + problem.prior_weight
        rise = (theta - problem.prior) * problem.prior_weight
        rise -= whitened.T @ (weights.whitener @ problem.residuals(prediction))
        sides = tuple(map(problem.side, range(len(theta)), theta, curvatures, rise))
        fit = Fit(
            problem, theta, chi2, errors, weights, prediction.signal, slopes, converged, sides
        )
        shift = theta - before
        if shift @ fit.information @ shift < SETTLED:
            break
    return fit


def best_of(
    problem: LeastSquaresProblem, starts: Iterable[Array], weights: Weights, *, follow: int = 2
) -> Fit:
    """The lowest minimum that some (free,) starts lead to.

    The weights are held while the starts are followed; the lowest few, `follow`, then get their
    own.
    """
    ends: list[tuple[float, Array]] = []
    for start in starts:
        theta, chi2, _ = descend(problem, start, weights)
        if all(abs(chi2 - other) > 1e-3 * (1.0 + other) for other, _ in ends):
            ends.append((chi2, theta))
    ends.sort(key=lambda end: end[0])
    fits = [settle(problem, theta) for _, theta in ends[:follow]]
    return min(fits, key=lambda fit: fit.deviance)


def fit_from_scratch(problem: LeastSquaresProblem) -> Fit:
    """The best fit of a model about which nothing is known: alpha_scat is scanned."""
    theta = problem.theta({})
    for name, rows in problem.scales.items():
        place = problem.index(name)
        theta[place] = 1.0
        predicted = problem.model.predict(theta).signal[problem.used]
        # the statistic is nearly quadratic in the scale: the descent mends what is left
        theta[place] = float(np.median((problem.signal / predicted)[rows]))
    if not len(theta):
        return settle(problem, theta)
    first = problem.errors_before_any_fit()
    weights = Weights.of(first.total)
    if ALPHA_SCAT not in problem.names:
        return best_of(problem, [theta], weights)
    place = problem.index(ALPHA_SCAT)
    known = problem.free[place]
    heights, starts = [], []
    for value in np.geomspace(known.minimum, known.maximum, _SCAN_POINTS):
        start = theta.copy()
        start[place] = value
        start, height, _ = descend(problem, start, weights, held=[place], steps=4, precision=0.1)
        heights.append(height)
        starts.append(start)
    lowest = local_minima(heights)[:3]
    return best_of(problem, [starts[i] for i in lowest], weights, follow=3)
