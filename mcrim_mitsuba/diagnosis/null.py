"""How much the best of many effects gains where the model without them is right.

Around the baseline fit the readings and priors, whitened and freed of what the free parameters
follow, are ndf independent standard normal numbers z. There ``chi2 = |z|^2``, and an effect is a
curve s(value) through the origin: with it ``chi2 = |z - s|^2``, at best. The curve is sampled at
the effect's nodes, every other parameter fitted there to the baseline's own prediction, and
straight between them. So gains under the null hypothesis are drawn by the thousand without a single
further fit, with bounds, ranges that end, and effects without a parameter (a point instead of a
curve, the gain then negative as often as not) all included; R. B. Davies, Biometrika 64 (1977) 247,
for why no chi-squared distribution describes parameters that only exist under the alternative.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import null_space
from scipy.special import chdtrc, ndtr

from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.solver import Array, Fit, Problem, descend
from mcrim_mitsuba.diagnosis.statistics import corrected

# Campaigns drawn under the null hypothesis.
_DRAWS = 4000

# Beyond the draws' own reach: the quantile from which the tail of chi-squared goes on.
_TAIL = 0.02


class BaselineFrame:
    """The readings and priors around a fit, whitened and freed of what its parameters follow."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.problem = fit.problem.against(fit.signal[fit.problem.used], fit.theta.copy())
        slopes = self._whitened(fit.slopes, np.eye(len(fit.theta)))
        self._basis = null_space(slopes[:, fit.movable].T).T

    def _whitened(self, of_readings: Array, of_parameters: Array) -> Array:
        weight = self.fit.problem.prior_weight
        rows = np.sqrt(weight[weight > 0])
        of_priors = (of_parameters[weight > 0].T * rows).T
        return np.concatenate([self.fit.weights.whitener @ of_readings, of_priors])

    @property
    def dimensions(self) -> int:
        """Degrees of freedom."""
        return len(self._basis)

    def displacement(self, problem: Problem, theta: Array) -> Array:
        """(dimensions,) of a model's prediction from the fit's."""
        fit = self.fit
        of_readings = problem.model.predict(theta).signal - fit.signal
        values = dict(zip(problem.names, theta.tolist(), strict=True))
        of_parameters = np.array([values[name] for name in fit.names]) - fit.theta
        return self._basis @ self._whitened(of_readings[fit.problem.used], of_parameters)


@dataclass(frozen=True, eq=False)
class Curve:
    """What an effect does to the readings.

    Attributes
    ----------
    points : (points, dimensions) float64
        The absence of an effect with parameters is the first, at the origin.
    ends : (segments, 2) int
        Points between which the curve is straight.
    boundary : bool
        Absent at an end of its range.
    parameters : int
        How many the effect brings.
    """

    points: Array
    ends: np.ndarray
    boundary: bool
    parameters: int

    def gains(self, drawn: Array) -> Array:
        """(draws,) largest gain in chi2 along the curve, for (draws, dimensions) readings."""
        along, norms = drawn @ self.points.T, (self.points**2).sum(axis=1)
        best = (2.0 * along - norms).max(axis=1)
        if len(self.ends):
            a, b = self.ends.T
            step = self.points[b] - self.points[a]
            length = np.maximum((step**2).sum(axis=1), 1e-300)
            across = np.einsum("ij,ij->i", self.points[a], step)
            rise = along[:, b] - along[:, a]
            t = np.clip((rise - across) / length, 0.0, 1.0)
            gain = 2.0 * (along[:, a] + t * rise) - (norms[a] + t * (2.0 * across + t * length))
            best = np.maximum(best, gain.max(axis=1))
        return best

    def separation(self, point: Array) -> float:
        """Squared distance of a (dimensions,) point from the curve."""
        return float(point @ point - self.gains(point[None])[0])


def curve_of(
    explanations: Explanations, added: tuple[str, ...], effect: str, frame: BaselineFrame
) -> Curve:
    """An effect's curve around the fit with `added` but the effect."""
    problem = explanations.problem(added)
    centre = frame.fit.values
    prior = problem.theta({**{p.name: p.prior or 0.0 for p in problem.free}, **centre})
    # the effect's own priors, if a campaign gives any, stay where they are
    own = [problem.index(n) for n in explanations.free_parameters(added, effect)]
    prior[own] = problem.prior[own]
    ideal = problem.against(frame.problem.signal, prior)
    if not own:
        theta, _, _ = descend(ideal, problem.theta(centre), frame.fit.weights, steps=4)
        point = frame.displacement(problem, theta)
        return Curve(point[None], np.empty((0, 2), int), False, 0)
    profile = explanations.profile(added, effect, frame.fit, problem=ideal, steps=3, precision=0.02)
    thetas = [theta for _, theta in profile]
    points = np.array([frame.displacement(problem, theta) for theta in thetas])
    absent = problem.theta({**centre, **explanations.absent(effect)})
    x = np.array([problem.internal(theta)[own] for theta in [absent, *thetas]])
    points = np.vstack([np.zeros(frame.dimensions), points])
    boundary = explanations.is_boundary(added, effect)
    return Curve(points, _neighbours(x), boundary, len(own))


def _neighbours(x: Array) -> np.ndarray:
    """(segments, 2) pairs of (points, parameters) that follow each other along one parameter.

    The first point is the absence of the effect, and every line along one parameter starts there.
    """
    if x.shape[1] == 1:
        order = np.argsort(x[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]], axis=1)
    pairs = [(0, i) for i in range(1, len(x))]
    for axis in range(x.shape[1]):
        others = np.delete(x, axis, axis=1)
        for row in np.unique(others[1:], axis=0):
            line = 1 + np.flatnonzero((others[1:] == row).all(axis=1))
            line = line[np.argsort(x[line, axis])]
            pairs += list(pairwise(line))
    return np.array(pairs, int).reshape(-1, 2)


class NullDistribution:
    """Gains of all effects, drawn where none of them is there.

    Parameters
    ----------
    curves : dict of str to Curve
    seed : int
    """

    def __init__(self, curves: dict[str, Curve], seed: int) -> None:
        self._curves = curves
        dimensions = next((c.points.shape[1] for c in curves.values()), 0)
        drawn = np.random.default_rng(seed).standard_normal((_DRAWS, dimensions))
        gains = [curve.gains(drawn) for curve in curves.values()]
        self.largest = np.sort(np.max(gains, axis=0)) if gains else np.zeros(_DRAWS)

    def p_global(self, gain: float) -> float:
        """Probability that the best of all effects gains as much by chance."""
        above = _DRAWS - int(np.searchsorted(self.largest, gain))
        if above > _TAIL * _DRAWS or gain <= 0:
            return (1.0 + above) / (1.0 + _DRAWS)
        # few or no draws are that high: the tail of chi-squared, joined where there are enough
        joint = float(np.quantile(self.largest, 1.0 - _TAIL))
        return _TAIL * float(chdtrc(1, gain) / chdtrc(1, joint)) if joint > 0 else 0.0

    def p_gain(self, effect: str, gain: float) -> float:
        """Probability that this effect, named beforehand, gains as much by chance.

        Of an effect that is absent inside its range chi-squared with its number of parameters, at
        a boundary the half of it (H. Chernoff, Ann. Math. Stat. 25 (1954) 573); without a parameter
        the gain 2 z s - s^2 is Gaussian.
        """
        curve = self._curves[effect]
        if curve.parameters == 0:
            size = max(float(np.linalg.norm(curve.points[0])), 1e-9)
            return float(ndtr(-(gain + size**2) / (2.0 * size)))
        p = float(chdtrc(curve.parameters, max(gain, 0.0)))
        return 0.5 * p if curve.boundary and gain > 0 else p

    def p_of_best(self, effect: str, gain: float) -> float:
        """`p_gain` corrected for as many tries as there are effects, without drawing."""
        return corrected(self.p_gain(effect, gain), len(self._curves))
