"""What effects do to readings around the baseline fit, and what chance gains by them.

Around the baseline fit the readings and priors, whitened and freed of what the free parameters
follow, are ndf independent standard normal numbers z. There ``chi2 = |z|^2``, and an effect is a
curve s(value) through the origin: with it ``chi2 = |z - s|^2``, at best. The curve is sampled at
the effect's nodes, every other parameter fitted there to the baseline's own prediction. What the
scale does meanwhile is kept with it. So all sets of effects are weighed in closed form
(`closed_form`), and gains under the null hypothesis drawn by the thousand, without a single further
fit, with bounds, ranges that end, and effects without a parameter (a point instead of a curve, the
gain then negative as often as not) all included; R. B. Davies, Biometrika 64 (1977) 247, for why no
chi-squared distribution describes parameters that only exist under the alternative.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import null_space
from scipy.special import chdtrc, ndtr, ndtri

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.effects.effect import EffectParameter
from mcrim_mitsuba.inference.closed_form import Cause
from mcrim_mitsuba.inference.drivers import Minimum, newton
from mcrim_mitsuba.inference.evidence import PriorDensity
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.settings import CHANCE, STRIPS
from mcrim_mitsuba.inference.statistic import Statistic


class BaselineFrame:
    """The readings and priors around a fit, whitened and freed of what its parameters follow."""

    def __init__(self, fit: Minimum) -> None:
        self.fit = fit
        own = fit.statistic
        self.statistic = own.against(fit.signal[own.used], fit.theta.copy())
        slopes = self._whitened(fit.slopes, np.eye(len(fit.theta)))[:, fit.movable]
        self._basis = null_space(slopes.T).T
        #: (dimensions,) The readings and priors.
        self.z = self._basis @ self._whitened(fit.residuals, own.prior - fit.theta)
        # d ln(scale) / d whitened readings and priors; 0 where the scale is held
        self._of_scale = np.zeros(len(slopes))
        names = [fit.names[place] for place in fit.movable]
        if SCALE in names:
            self._of_scale = np.linalg.pinv(slopes)[names.index(SCALE)] / fit.values[SCALE]

    @property
    def scale_variance(self) -> float:
        """Of the logarithm of the fitted scale."""
        return float(self._of_scale @ self._of_scale)

    def of_factors(self, factors: Array) -> tuple[Array, Array]:
        """What factors exp(x) on predictions do: (dimensions, k) to z, and (k,) to ln(scale).

        `factors` are (used, k) changes of the logarithms; all else follows as far as it can.
        """
        own, fit = self.fit.statistic, self.fit
        changes = fit.signal[own.used][:, None] * factors
        moved = self._whitened(changes, np.zeros((len(fit.theta), factors.shape[1])))
        return self._basis @ moved, -(self._of_scale @ moved)

    def readings_moved(self, z: Array) -> Array:
        """(used,) by how many standard errors a displacement of z moves predicted readings."""
        return np.asarray(z @ self._basis, float)[: len(self.statistic.signal)]

    def log_scale(self, statistic: Statistic, theta: Array) -> float:
        """Of a model's scale, over that of the fit; 0 where it is held."""
        if SCALE not in self.fit.names:
            return 0.0
        # a fit may end where all signal is background
        return math.log(max(statistic.values(theta)[SCALE] / self.fit.values[SCALE], 1e-6))

    def _whitened(self, of_readings: Array, of_parameters: Array) -> Array:
        weight = self.fit.statistic.prior_weight
        rows = np.sqrt(weight[weight > 0])
        of_priors = (of_parameters[weight > 0].T * rows).T
        return np.concatenate([self.fit.weights.whiten(of_readings.T).T, of_priors])

    @property
    def dimensions(self) -> int:
        """Degrees of freedom."""
        return len(self._basis)

    def displacement(self, statistic: Statistic, theta: Array) -> Array:
        """(dimensions,) of a model's prediction from the fit's."""
        fit = self.fit
        of_readings = statistic.model.predict(theta).signal - fit.signal
        values = statistic.values(theta)
        of_parameters = np.array([values[name] for name in fit.names]) - fit.theta
        return self._basis @ self._whitened(of_readings[fit.statistic.used], of_parameters)


@dataclass(frozen=True, eq=False)
class Curve:
    """What an effect does to the readings."""

    #: (points, dimensions) float64: The absence of an effect with parameters is the first, at the
    #: origin.
    points: Array
    #: (segments, 2) int: Points between which the curve is straight.
    ends: np.ndarray
    #: Absent at an end of its range.
    boundary: bool
    #: (points, parameters) Values of the effect's parameters, that of the absence first.
    sizes: Array
    #: (points,) Logarithm of the scale over that of the fit.
    log_scales: Array

    def gains(self, drawn: Array) -> Array:
        """(draws,) largest gain in chi2 along the curve, for (draws, dimensions) readings.

        A point p of the curve gains r^2 - (r - p)^2 = 2 r p - p^2 for readings r; on a segment
        from a to a + s the best is where r - p is across it, at a + t s with t = (r - a) s / s^2.
        """
        products, squares = drawn @ self.points.T, (self.points**2).sum(axis=1)
        best = (2.0 * products - squares).max(axis=1)
        if len(self.ends):
            a, b = self.ends.T
            segment = self.points[b] - self.points[a]
            segment_squared = np.maximum((segment**2).sum(axis=1), 1e-300)
            a_segment = np.einsum("ij,ij->i", self.points[a], segment)
            r_segment = products[:, b] - products[:, a]
            t = np.clip((r_segment - a_segment) / segment_squared, 0.0, 1.0)
            p_squared = squares[a] + t * (2.0 * a_segment + t * segment_squared)
            gain = 2.0 * (products[:, a] + t * r_segment) - p_squared
            best = np.maximum(best, gain.max(axis=1))
        return best

    def at_distance(self, squared: float) -> tuple[Array, float] | None:
        """Where the curve first has a squared length, and ln(scale) there; None where never."""
        lengths = (self.points**2).sum(axis=1)
        moves = np.column_stack([self.points, self.log_scales])
        for a, b in self.ends:
            low, high = sorted((a, b), key=lambda point: lengths[point])
            if lengths[low] <= squared <= lengths[high] > 0.0:
                # on a straight line through the origin the length is that of the part
                from_end, to_end = math.sqrt(lengths[low]), math.sqrt(lengths[high])
                part = (math.sqrt(squared) - from_end) / max(to_end - from_end, 1e-12)
                there = moves[low] + part * (moves[high] - moves[low])
                return there[:-1], float(there[-1])
        return None

    def separation(self, point: Array) -> float:
        """Squared distance of a (dimensions,) point from the curve."""
        return float(point @ point - self.gains(point[None])[0])


def curve_of(
    explanations: Explanations, effect: str, frame: BaselineFrame, besides: tuple[str, ...] = ()
) -> Curve:
    """How an effect displaces the readings from a fit, as its size grows.

    Its profile is fitted to readings that the fit predicts exactly, so that all that moves is the
    effect, and what the other parameters do to follow it. The fit is the baseline's, or one with
    the effects `besides`.
    """
    added = (*besides, effect)
    statistic = explanations.statistic(added)
    centre = frame.fit.values
    prior = statistic.theta({**{p.name: p.prior or 0.0 for p in statistic.free}, **centre})
    # the effect's own priors, if a campaign gives any, stay where they are
    own = [statistic.index(n) for n in explanations.free_parameters(added, effect)]
    prior[own] = statistic.prior[own]
    ideal = statistic.against(frame.statistic.signal, prior)
    if own:
        profile = explanations.profile(
            added, effect, frame.fit, statistic=ideal, steps=4, precision=0.02
        )
        thetas = [theta for _, theta in profile]
    else:  # on or off
        thetas = [newton(ideal, statistic.theta(centre), frame.fit.weights, steps=4).point]
    points = np.array([frame.displacement(statistic, theta) for theta in thetas])
    log_scales = np.array([frame.log_scale(statistic, theta) for theta in thetas])
    if not own:
        return Curve(points, np.empty((0, 2), int), False, np.empty((1, 0)), log_scales)
    absent = statistic.theta({**centre, **explanations.absent(effect)})
    thetas = [absent, *thetas]
    free = [statistic.free[i] for i in own]
    return Curve(
        np.vstack([np.zeros(frame.dimensions), points]),
        _neighbours(np.array([statistic.internal(theta)[own] for theta in thetas])),
        not any(p.minimum < at < p.maximum for p, at in zip(free, absent[own], strict=True)),
        sizes=np.array([theta[own] for theta in thetas]),
        log_scales=np.append(0.0, log_scales),
    )


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


# ---- causes of the closed form ----


def cause_of(explanations: Explanations, effect: str, curve: Curve) -> Cause:
    """An effect as a cause: its prior in strips along its curve."""
    names = explanations.free_parameters((effect,), effect)
    densities = explanations.priors((effect,))
    moves = np.column_stack([curve.points, curve.log_scales])
    if not names:
        shares, middles, halves = np.ones(1), moves, np.zeros_like(moves)
    elif len(names) == 1:
        (name,), parameters = names, explanations.effects[effect].parameters
        parameter = next(p for p in parameters if p.name == name)
        origin = parameter.origin(explanations.scene)
        shares, middles, halves = _strips(parameter, origin, densities[name], curve, moves)
    else:
        shares, middles, halves = _cells([densities[name] for name in names], curve, moves)
    return Cause(
        name=effect,
        log_odds=explanations.log_odds((effect,)),
        log_weights=np.log(np.maximum(shares, 1e-300) / shares.sum()),
        origins=middles[:, :-1],
        slopes=halves[:, :-1],
        log_scales=middles[:, -1],
        log_scale_slopes=halves[:, -1],
    )


def _strips(
    parameter: EffectParameter, origin: float, density: PriorDensity, curve: Curve, moves: Array
) -> tuple[Array, Array, Array]:
    """(strips,) parts of a parameter's prior, and (strips, ...) middles and half widths of moves.

    Moves are interpolated along the curve, in the coordinate in which the effect's responses are.
    """
    values, absent = curve.sizes[:, 0], parameter.absent
    known = slice(0 if absent is not None else 1, None)  # without an absence no first point
    at = parameter.coordinates_of(values[known] - origin)
    at, first = np.unique(at, return_index=True)
    move_at = PchipInterpolator(at, moves[known][first])
    low, high = density.value(np.array([-8.0, 8.0]))
    z_edges = ndtri(np.linspace(1e-9, 1.0 - 1e-9, len(STRIPS.two_sided)))
    if absent is not None and math.isfinite(absent):
        nothing, margin = origin + absent, 1e-6 * (high - low)
        z_edges = np.array(STRIPS.two_sided)
        if nothing < low + margin:
            z_edges = np.array(STRIPS.one_sided)
        elif nothing > high - margin:
            z_edges = -np.array(STRIPS.one_sided)[::-1]
    edges = np.clip(parameter.coordinates_of(density.value(z_edges) - origin), at[0], at[-1])
    ends, middles = move_at(edges), move_at(0.5 * (edges[1:] + edges[:-1]))
    return np.diff(ndtr(z_edges)), middles, 0.5 * np.diff(ends, axis=0)


def _cells(densities: list[PriorDensity], curve: Curve, moves: Array) -> tuple[Array, Array, Array]:
    """The same of several parameters: a cell of the prior around each node of their product.

    In a cell the effect goes on half the way to the neighbour that is farthest.
    """
    shares = np.ones(len(curve.sizes) - 1)
    for density, values in zip(densities, curve.sizes[1:].T, strict=True):
        levels = np.unique(values)
        z = np.array([density.z_of(between) for between in 0.5 * (levels[1:] + levels[:-1])])
        shares *= np.diff(np.concatenate([[0.0], ndtr(z), [1.0]]))[np.searchsorted(levels, values)]
    halves = np.zeros_like(moves)
    for a, b in curve.ends:
        half = 0.5 * (moves[b] - moves[a])
        for point in (a, b):
            if half @ half > halves[point] @ halves[point]:
                halves[point] = half
    return shares, moves[1:], halves[1:]


# ---- what chance gains ----


class NullDistribution:
    """Gains of fitted effects, drawn where none of them is there."""

    def __init__(self, explanations: Explanations, effects: Iterable[str], seed: int = 0) -> None:
        self.frame = BaselineFrame(explanations.baseline)
        #: By effect.
        self.curves = {name: curve_of(explanations, name, self.frame) for name in effects}
        drawn = np.random.default_rng(seed).standard_normal((CHANCE.draws, self.frame.dimensions))
        gains = [curve.gains(drawn) for curve in self.curves.values()]
        self.largest = np.sort(np.max(gains, axis=0)) if gains else np.zeros(CHANCE.draws)

    def p_global(self, gain: float) -> float:
        """Probability that the best of all effects gains as much by chance."""
        above = CHANCE.draws - int(np.searchsorted(self.largest, gain))
        if above > CHANCE.tail * CHANCE.draws or gain <= 0:
            return (1.0 + above) / (1.0 + CHANCE.draws)
        # few or no draws are that high: the tail of chi-squared, joined where there are enough
        joint = float(np.quantile(self.largest, 1.0 - CHANCE.tail))
        return CHANCE.tail * float(chdtrc(1, gain) / chdtrc(1, joint)) if joint > 0 else 0.0

    def p_gain(self, effect: str, gain: float) -> float:
        """Probability that this effect, named beforehand, gains as much by chance.

        Of an effect that is absent inside its range chi-squared with its number of parameters, at
        a boundary the half of it (H. Chernoff, Ann. Math. Stat. 25 (1954) 573); without a parameter
        the gain 2 z s - s^2 is Gaussian.
        """
        curve = self.curves[effect]
        parameters = curve.sizes.shape[1]
        if parameters == 0:
            size = max(float(np.linalg.norm(curve.points[0])), 1e-9)
            return float(ndtr(-(gain + size**2) / (2.0 * size)))
        p = float(chdtrc(parameters, max(gain, 0.0)))
        return 0.5 * p if curve.boundary and gain > 0 else p
