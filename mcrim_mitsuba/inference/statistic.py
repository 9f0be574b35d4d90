"""The statistic of a campaign: readings and priors against a model.

    chi2 = r^T C^-1 r + sum of ((theta - prior) / prior_sigma)^2

with r = signal - predicted signal and C from the readings' errors, the relative errors that
mountings share, the Monte Carlo errors of eta, and the tolerances of the bench's numbers: an offset
of each, to first order and with a Gaussian prior, is integrated out. C scales with the predicted
signal. Left free, that would let a fit buy a smaller chi2 with larger errors, unless the logarithm
of its determinant were added; so C is held as `Weights` during a descent and updated between
descents. This gives the same estimate as iteratively reweighted least squares, without that bias
and without R. W. Peelle's (which comes from scaling errors with the readings).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import chdtrc

from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.inference.model import Model, Prediction
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, FIT_NOTES, LINEAR


def p_value(chi2: float, ndf: int) -> float | None:
    """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
    return float(chdtrc(ndf, chi2)) if ndf > 0 else None


def is_misfit(chi2: float, p: float | None) -> bool:
    """Whether a model does not describe its readings, by a p-value or, where there is none, chi2.

    Priors and bounds may keep a fit without degrees of freedom from the readings.
    """
    return chi2 > FIT_NOTES.largest_pull**2 if p is None else p < ACCEPTABLE_P


def undetermined(information: Array, names: Sequence[str]) -> list[str]:
    """Parameters that some combination of can change without changing a reading.

    `information` is Fisher's, (names, names), priors included.
    """
    diagonal = np.diag(information)
    without = [name for name, size in zip(names, diagonal, strict=True) if not size > 0]
    if without or not names:
        return without
    values, vectors = np.linalg.eigh(information / np.sqrt(np.outer(diagonal, diagonal)))
    weights = (
        np.abs(vectors[:, 0]) if values[0] < LINEAR.least_information else np.zeros(len(names))
    )
    return [name for name, weight in zip(names, weights, strict=True) if weight > 0.1]


def inverse(matrix: Array) -> Array:
    """Inverse of a (k, k) information matrix; where it says nothing, the variance is huge."""
    if not len(matrix):
        return matrix
    diagonal = np.diag(matrix)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1e-12))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    values = np.maximum(values, 1e-13)
    return (vectors / values) @ vectors.T / np.outer(size, size)


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
    #: (used, tolerances) float64: What a standard uncertainty of each number of the bench does to
    #: the predictions; an offset of each has been integrated out.
    tolerances: Array
    #: (used, sources) float64: What the errors of the pedestal, of the readout's nonlinearity and
    #: of a background that readings share do to them.
    pedestal: Array
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
    def predicted(self) -> Array:
        """(used, sources) errors of predictions, and what readings share: all independent."""
        return np.hstack([self.simulated, self.tolerances, self.pedestal])

    @property
    def total(self) -> Array:
        """Covariance of reading minus prediction."""
        predicted = self.predicted
        return self.readings + predicted @ predicted.T

    def statistical_variances(self, response: Array) -> Array:
        """(k,) variances, by `readings`, of numbers that move by (k, used) with the readings."""
        shared = [np.bincount(self.mountings, moved) for moved in response * self.shared]
        variances = response**2 @ self.variance + np.square(shared).sum(axis=-1)
        if self.unexplained is not None:
            variances += ((response @ self.unexplained) * response).sum(axis=1)
        return variances


class Weights:
    """Weighs readings by the inverse of their covariance C = D + sum of u u^T over its sources.

    D is diagonal, the errors that readings have alone. A source adds errors that readings share:
    u, (used,), is what a mounting does to its readings, or an independent part of the simulation's
    error. In units of sqrt(D) and for orthogonal u,

        W = C^(-1/2) = 1 - sum of u u^T / (r (1 + r)),  r = sqrt(1 + u^T u)

    so that no matrix is needed. Mountings are orthogonal, as no reading is in two; what the
    simulation adds is taken after the mountings' W, and made orthogonal by its singular values. A
    few readings, or what no parameter explains, are weighed by a matrix all the same.
    """

    def __init__(self, errors: ErrorMatrices) -> None:
        self.errors = errors
        self._matrix: Array | None = None
        #: Of the covariance: what two minima with different ones differ by besides chi2.
        self.log_determinant: float
        if errors.unexplained is not None or len(errors.variance) <= LINEAR.few_readings:
            self._use_matrix()
        else:
            self._use_sources()

    def _use_matrix(self) -> None:
        """Weigh by the inverse of the covariance's factor, (used, used)."""
        factor = np.linalg.cholesky(self.covariance)
        self._matrix = np.linalg.inv(factor)
        self.log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())

    def _use_sources(self) -> None:
        """Weigh by the sources one after the other, without any matrix."""
        errors = self.errors
        # what no two readings share belongs to their own errors
        predicted = errors.predicted
        lone = np.count_nonzero(predicted, axis=0) < 2
        variance = errors.variance + np.square(predicted[:, lone]).sum(axis=1)
        self._root = 1.0 / np.sqrt(variance)
        shared = errors.shared * self._root
        of_mountings = np.bincount(errors.mountings, shared**2).astype(float)
        mountings = csr_array((shared, (errors.mountings, np.arange(len(shared)))))
        #: (sources, used) orthogonal u, and their (sources,) 1 / (r (1 + r)).
        self._sources: list[tuple[Any, Array]] = []
        if shared.any():
            self._sources = [(mountings, _taken_along(of_mountings))]
        rest = self._taken(self._root * predicted[:, ~lone].T, self._sources)
        _, sizes, directions = np.linalg.svd(rest, full_matrices=False)
        self._sources.append((sizes[:, None] * directions, _taken_along(sizes**2)))
        self.log_determinant = float(
            np.log(variance).sum() + np.log1p(of_mountings).sum() + np.log1p(sizes**2).sum()
        )

    @cached_property
    def covariance(self) -> Array:
        """(used, used) covariance of reading minus prediction."""
        return self.errors.total

    @cached_property
    def inverse(self) -> Array:
        """(used, used) inverse covariance."""
        if self._matrix is not None:
            return self._matrix.T @ self._matrix
        return self.weigh(np.eye(len(self.errors.variance)))

    def whiten(self, x: Array) -> Array:
        """W x of (..., used) vectors, W^T W the inverse covariance."""
        if self._matrix is not None:
            return (self._matrix @ x.T).T
        return self._taken(self._root * x, self._sources)

    def weigh(self, x: Array) -> Array:
        """The inverse covariance times (..., used) vectors."""
        if self._matrix is not None:
            return x @ self.inverse
        return self._root * self._taken(self.whiten(x), self._sources[::-1])

    @staticmethod
    def _taken(x: Array, sources: list[tuple[Any, Array]]) -> Array:
        """(..., used) vectors without what they have along sources."""
        for vectors, parts in sources:
            x = x - (x @ vectors.T * parts) @ vectors
        return x


def _taken_along(squares: Array) -> Array:
    """1 / (r (1 + r)) of sources with these squared lengths; r = sqrt(1 + square)."""
    roots = np.sqrt(1.0 + squares)
    return np.asarray(1.0 / (roots * (1.0 + roots)), float)


class Statistic:
    """Readings and priors against a model, in the coordinates in which minima are searched.

    alpha_scat is searched in its logarithm, since eta changes with it over decades; the parameters
    of effects in the coordinate that the effect names, ``log`` or ``reciprocal``; all others in
    themselves, scales of very large or small readings in units of these.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        #: The free parameters, in the model's order.
        self.free: tuple[CampaignParameter, ...] = tuple(model.free)
        self.names = tuple(p.name for p in self.free)
        #: (free,) Where the campaign lets searches begin; 0 where it does not say.
        self.start = np.array([0.0 if math.isnan(p.start) else p.start for p in self.free])
        # relative covariance of what no parameter explains
        self._unexplained: Array | None = None
        #: (readings,) Which of the model's readings the statistic uses.
        self.used = np.array([reading.use for reading in self.model.readings])
        used = [reading for reading in self.model.readings if reading.use]
        self.labels = tuple(reading.label for reading in used)
        scale_of = np.array([self.model.campaign.parameter_of(reading, SCALE) for reading in used])
        #: The free scales, the campaign's and those of samples, by the (used,) readings' masks.
        self.scales = {
            n: scale_of == n for n in dict.fromkeys(scale_of.tolist()) if n in self.names
        }
        #: (used,) The readings, and the squares of their own errors.
        self.signal = np.array([reading.signal for reading in used])
        self.variance = np.array([reading.sigma for reading in used]) ** 2
        # relative error that a mounting's readings share, and the number of the mounting
        self._shared = np.array([reading.group_sigma or 0.0 for reading in used])
        sources = max((len(reading.shared) for reading in used), default=0)
        self._sources = np.zeros((len(used), sources))
        for row, reading in zip(self._sources, used, strict=True):
            row[: len(reading.shared)] = reading.shared
        self._of_light = np.array([not reading.of_beam for reading in used], bool)
        groups = [reading.group or "" for reading in used]
        self._mountings = np.unique(groups, return_inverse=True)[1]
        #: (free,) The weight is 1 / sigma^2; both are 0 without a prior.
        self.prior = np.array([0.0 if p.prior is None else p.prior for p in self.free])
        weights = [0.0 if p.prior_sigma is None else p.prior_sigma**-2 for p in self.free]
        self.prior_weight = np.array(weights)
        self._priors = np.flatnonzero(self.prior_weight)
        self._prior_roots = np.sqrt(self.prior_weight[self._priors])
        self._prior_rows = np.zeros((1 + len(self.free), len(self._priors)))
        self._prior_rows[1 + self._priors, np.arange(len(self._priors))] = -self._prior_roots
        self._set_coordinates()

    def _set_coordinates(self) -> None:
        """In which coordinate each parameter is searched, and its bounds there."""
        of_effects = {
            p.name: p.coordinate
            for effect in self.model.campaign.switched_on
            for p in effect.parameters
        }
        kinds = ["log" if p.logarithmic else of_effects.get(p.name, "linear") for p in self.free]
        #: (free,) Which parameters are searched in their logarithm.
        self.logarithmic = np.array([kind == "log" for kind in kinds], bool)
        self._reciprocal = np.array([kind == "reciprocal" for kind in kinds], bool)
        self._inverted = bool(self._reciprocal.any())
        # of scales, where readings are far from 1: descents have sizes of their own
        self._units = np.ones(len(self.free))
        for name, rows in self.scales.items():
            size = round(math.log2(np.median(np.abs(self.signal[rows])) or 1.0))
            self._units[self.index(name)] = 2.0**size if abs(size) > LINEAR.usual_size else 1.0
        self._curved = self._inverted or bool(self.logarithmic.any() or (self._units != 1.0).any())
        self.bounds = tuple(np.array([(p.minimum, p.maximum) for p in self.free]).reshape(-1, 2).T)
        #: (free,) Minimum and maximum in the searched coordinates; and the same, the lower first.
        self.walls = self.internal(self.bounds[0]), self.internal(self.bounds[1])
        self.low, self.high = np.minimum(*self.walls), np.maximum(*self.walls)

    # ---- the same model against other readings ----

    def against(self, signal: Array, prior: Array | None = None) -> Statistic:
        """With other (used,) readings and (free,) centres of the priors."""
        other = copy.copy(self)
        other.signal = signal
        if prior is not None:
            other.prior = prior
        return other

    def with_unexplained(self, covariance: Array) -> Statistic:
        """With a (used, used) relative covariance of what the model does not explain."""
        other = copy.copy(self)
        other._unexplained = covariance
        return other

    def exchanged(self, order: NDArray[np.int64], factors: Array | float = 1.0) -> Statistic:
        """With the (used,) readings, and their own errors, in another order, times factors."""
        other = copy.copy(self)
        other.signal = factors * self.signal[order]
        other.variance = np.square(factors) * self.variance[order]
        return other

    # ---- parameters ----

    def index(self, name: str) -> int:
        """Place of a free parameter."""
        return self.names.index(name)

    def parameter(self, name: str) -> CampaignParameter:
        """A free parameter with its bounds."""
        return self.free[self.index(name)]

    def theta(self, values: Mapping[str, float]) -> Array:
        """(free,) parameters from values by name; the others at their start."""
        return np.array([values.get(n, s) for n, s in zip(self.names, self.start, strict=True)])

    def values(self, theta: Array) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, theta.tolist(), strict=True))

    def internal(self, theta: Array) -> Array:
        """(free,) coordinates that are searched."""
        x = np.array(theta, float) / self._units
        if self._curved:
            x[self.logarithmic] = np.log(x[self.logarithmic])
            with np.errstate(divide="ignore"):
                x[self._reciprocal] = 1.0 / x[self._reciprocal]
        return x

    def external(self, x: Array) -> Array:
        """(free,) parameters of searched coordinates, within their bounds.

        Raises InputError where arithmetic ended on the way: readings that no arithmetic holds.
        """
        if not math.isfinite(x.sum()):
            raise self._beyond_arithmetic()
        theta = x * self._units
        if self._curved:
            np.exp(x, where=self.logarithmic, out=theta)
            if self._inverted:
                with np.errstate(divide="ignore"):
                    theta[self._reciprocal] = 1.0 / theta[self._reciprocal]
        # the logarithm of a bound may come back as a number beyond it
        low, high = self.bounds
        return np.minimum(np.maximum(theta, low), high)

    def at_bounds(self, theta: Array) -> Array:
        """(free,) parameters, at a bound where they have come as near to it as rounding.

        A descent creeps there, and no scene can have a bevel of 1e-14 mm.
        """
        low, high = self.bounds
        width = high - low
        near = LINEAR.rounding * np.where(np.isfinite(width), width, 0.0)
        theta = np.where(theta - low <= near, low, theta)
        return np.where(high - theta <= near, high, theta)

    def slopes_of_external(self, theta: Array) -> Array:
        """(free,) d parameter / d searched coordinate."""
        chain = np.where(self.logarithmic, theta, self._units)
        if self._inverted:
            chain[self._reciprocal] = -(theta[self._reciprocal] ** 2)
        return chain

    def _beyond_arithmetic(self) -> InputError:
        """The error of readings so unlike that no number can hold their chi2."""
        measured = self.model.campaign.measurements
        low, high = (side(measured.in_use, key=lambda r: r.signal / r.sigma) for side in (min, max))
        ends = (f"{end.signal:g} ± {end.sigma:g} ({end.label})" for end in (low, high))
        problem = f"the readings cannot be fitted together: they are from {' to '.join(ends)}"
        return InputError(problem, "check their units and errors", path=measured.path)

    def side(self, place: int, value: float, curvature: float, slope: float) -> str | None:
        """The bound that a parameter has reached, if any.

        The curvature is 1 / sigma^2; of two bounds within reach it is the one that the slope of
        chi2 leads to. Of what hardly acts all values are less than sigma apart: a part of the
        range is near enough then.
        """
        close = LINEAR.at_bound / math.sqrt(curvature) if curvature > 0 else 0.0
        close = min(close, LINEAR.at_bound * (self.free[place].maximum - self.free[place].minimum))
        at_minimum = value - self.free[place].minimum <= close
        at_maximum = self.free[place].maximum - value <= close
        if at_minimum and at_maximum:
            return "max" if slope < 0 else "min"
        return "min" if at_minimum else "max" if at_maximum else None

    # ---- the statistic ----

    @property
    def knowns(self) -> int:
        """Readings in use + priors."""
        return len(self.signal) + len(self._priors)

    @property
    def ndf(self) -> int:
        """Readings in use + priors - free parameters."""
        return self.knowns - len(self.free)

    def errors_at(self, theta: Array) -> ErrorMatrices:
        """Covariance of the readings in use as a point in parameter space predicts it."""
        prediction = self.model.predict(theta, covariance=True)
        assert prediction.eta_errors is not None  # asked for
        signal, per_eta = prediction.signal[self.used], prediction.signal_per_eta[self.used]
        tolerances = np.zeros((len(signal), 0))
        if prediction.eta_of_tolerances is not None:
            tolerances = per_eta[:, None] * prediction.eta_of_tolerances[self.used]
        return ErrorMatrices(
            self.variance,
            self._shared * signal,
            self._mountings,
            per_eta[:, None] * prediction.eta_errors[self.used],
            tolerances,
            self._of_pedestal(signal),
            None if self._unexplained is None else self._unexplained * np.outer(signal, signal),
        )

    def errors_before_any_fit(self) -> ErrorMatrices:
        """Covariance without a model: shared errors from the readings, no Monte Carlo error."""
        none, shared = np.zeros((len(self.signal), 0)), self._shared * self.signal
        of_pedestal = self._of_pedestal(self.signal)
        return ErrorMatrices(self.variance, shared, self._mountings, none, none, of_pedestal)

    def _of_pedestal(self, signal: Array) -> Array:
        """(used, sources) what readings of light share by their calibration and background."""
        moved = self.model.campaign.common_errors.moved(signal, self._of_light)
        return np.hstack([moved, self._sources])

    def residuals(self, prediction: Prediction) -> Array:
        """(used,) reading minus predicted signal."""
        return self.signal - prediction.signal[self.used]

    def prior_pulls(self, theta: Array) -> Array:
        """(free,) distance from the prior in its sigmas; 0 without a prior."""
        return (theta - self.prior) * np.sqrt(self.prior_weight)

    def evaluate(self, theta: Array, weights: Weights) -> tuple[Array, Array]:
        """Whitened residuals (used + priors,), and their slopes in the searched coordinates.

        chi2 is their sum of squares.
        """
        prediction = self.model.predict(theta)
        # in one go: the residuals, and their slopes by every parameter
        moved = np.concatenate([prediction.signal[None], prediction.signal_slopes.T])[:, self.used]
        moved[0] -= self.signal
        rows = np.concatenate([weights.whiten(-moved), self._prior_rows], axis=1)
        rows[0, len(self.signal) :] = (self.prior - theta)[self._priors] * self._prior_roots
        if self._curved:
            rows[1:] *= self.slopes_of_external(theta)[:, None]
        return rows[0], rows[1:].T

    def chi2(self, theta: Array, weights: Weights) -> float:
        """Readings' chi2 plus the priors'."""
        residuals, _ = self.evaluate(theta, weights)
        return float(residuals @ residuals)
