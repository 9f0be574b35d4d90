"""Profile likelihoods: how chi2 rises with one parameter while all others follow.

Intervals, 95 % curves and limits are read from these curves. The covariance is held at the
solution. S. S. Wilks, Ann. Math. Stat. 9 (1938) 60; W. A. Rolke, A. M. Lopez and J. Conrad, Nucl.
Instr. Meth. A 551 (2005) 493.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, minimize_scalar

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.core.descent import Array, Descent
from mcrim_mitsuba.inference.drivers import Minimum, newton
from mcrim_mitsuba.inference.settings import CURVE, RISE_95, Pace
from mcrim_mitsuba.inference.statistic import Statistic, Weights, inverse


@dataclass(frozen=True, eq=False, kw_only=True)
class Profile:
    """Rise of chi2 along one parameter, minimised over all others within their bounds."""

    #: Its unit ends it, as a campaign's parameters'.
    name: str
    #: (points,) float64: Ascending, about equally spaced in the square root of the rise; they end
    #: where chi2 has risen by 9, or at a bound.
    values: Array
    #: (points,) float64
    delta_chi2: Array
    #: (points,) float64: d delta_chi2 / d value, exact.
    slopes: Array
    #: The solution and its standard error by linear propagation: delta_chi2 is
    #: ((values - value) / sigma)^2 where the model is linear.
    value: float
    sigma: float
    #: What the campaign knows from elsewhere.
    prior: float | None = None
    prior_sigma: float | None = None
    #: ``min`` and ``max`` where the curve ends at the parameter's bound on that side.
    ends: tuple[str | None, str | None] = (None, None)

    @property
    def curve(self) -> CubicHermiteSpline:
        """The rise between the points: cubic, by values and slopes."""
        return CubicHermiteSpline(self.values, self.delta_chi2, self.slopes)

    @property
    def interval_95(self) -> tuple[float | None, float | None]:
        """Ends of the interval that holds 95 %; None where a bound comes before."""
        return self.crossings(RISE_95)

    def crossings(self, rise: float) -> tuple[float | None, float | None]:
        """Where the curve crosses a rise below and above the solution; None where it does not."""
        return crossings(self.values, self.delta_chi2, self.slopes, rise)


def crossings(
    x: Array, heights: Array, slopes: Array, height: float
) -> tuple[float | None, float | None]:
    """Where a cubic through points crosses a height on either side of its lowest point.

    `x` are (points,) ascending. None where the curve ends before.
    """
    lowest = int(np.argmin(heights))
    curve = CubicHermiteSpline(x, heights, slopes) if len(x) > 1 else None

    def crossing(outward: range) -> float | None:
        for inner in outward:
            outer = inner + outward.step
            if curve is not None and heights[outer] >= height:
                fine = min(2e-12, 1e-6 * abs(x[outer] - x[inner]))
                place = brentq(lambda at: float(curve(at)) - height, x[inner], x[outer], xtol=fine)
                return float(place)
        return None

    return crossing(range(lowest, 0, -1)), crossing(range(lowest, len(x) - 1))


@lru_cache(maxsize=4)
def profiles_of(minimum: Minimum) -> tuple[Profile, ...]:
    """Profiles of every free parameter, and of the light yield where the campaign tells it.

    That of the light yield minimises over the scale and over the detector efficiency, whose
    relative error is a Gaussian factor on the light yield. The last few are kept.
    """
    statistic, weights = minimum.statistic, minimum.weights
    end = newton(statistic, minimum.theta, weights, precision=CURVE.precision)
    profiles = {
        name: _profile(ProfileWalk(statistic, weights, end, name), minimum)
        for name in minimum.names
    }
    for scale, (name, light_yield) in statistic.model.campaign.light_yields.items():
        if scale in profiles:
            profiles[name] = _of_light_yield(profiles[scale], name, light_yield)
    return tuple(profiles.values())


def _profile(walk: ProfileWalk, minimum: Minimum) -> Profile:
    """The curve of a walk in the parameter's own unit."""
    statistic, place = minimum.statistic, walk.place
    parameter, (_, rises, slopes) = statistic.free[place], walk.points.T
    thetas = np.repeat(minimum.theta[None], len(rises), axis=0)
    thetas[:, place] = walk.values
    # d parameter / d searched coordinate; a reciprocal's values descend where coordinates ascend
    scale = np.array([statistic.slopes_of_external(theta)[place] for theta in thetas])
    order = np.argsort(walk.values)
    return Profile(
        name=parameter.name,
        values=walk.values[order],
        delta_chi2=rises[order],
        slopes=(slopes / scale)[order],
        value=float(walk.theta[place]),
        sigma=math.sqrt(minimum.covariance[place, place]),
        prior=parameter.prior,
        prior_sigma=parameter.prior_sigma,
        ends=(
            "min" if walk.values.min() == parameter.minimum else None,
            "max" if walk.values.max() == parameter.maximum else None,
        ),
    )


class ProfileWalk:
    """The profile of one parameter in the coordinate in which minima are searched.

    It begins at the `solution`, where a descent ended, and goes outwards on both sides.
    """

    def __init__(
        self,
        statistic: Statistic,
        weights: Weights,
        solution: Descent,
        name: str,
        pace: Pace = CURVE,
    ) -> None:
        self._statistic, self._weights, self._pace = statistic, weights, pace
        self._chi2 = solution.height
        self.theta, self.place = solution.point, statistic.index(name)
        coordinates = statistic.internal(solution.point)
        start = float(coordinates[self.place])
        # where the others were best, by this one's coordinate, and chi2's curvature there
        self._followed = {start: (coordinates, solution.curvature)}
        curvature = float(inverse(solution.curvature)[self.place, self.place]) ** -1
        walls = (float(end[self.place]) for end in (statistic.low, statistic.high))
        sides = [self._side(start, wall, curvature) for wall in walls]
        middle = (start, 0.0, 2.0 * float(solution.gradient[self.place]))
        #: (points, 3) float64: Coordinates, ascending, rises of chi2 and their slopes.
        self.points = np.array([*sides[0][::-1], middle, *sides[1]])

    @property
    def values(self) -> Array:
        """(points,) of the parameter; a bound that was reached is there to the last digit."""
        return np.array([self._value(x) for x in self.points[:, 0]])

    def crossings(self, rise: float) -> tuple[float | None, float | None]:
        """Values of the parameter below and above the solution; None where chi2 stays lower.

        Where the cubic through the points misses the profile, it gets more points.
        """
        for _ in range(self._pace.most_refinements):
            x, rises, slopes = self.points.T
            ends = crossings(x, rises, slopes, rise)
            further = [
                (end, *self._height(end))
                for end in ends
                if end is not None and end not in self._followed
            ]
            if all(abs(height - rise) < self._pace.miss * rise for _, height, _ in further):
                break
            rows = np.array([*self.points, *further])
            self.points = rows[np.argsort(rows[:, 0])]
        low, high = (None if end is None else self._value(end) for end in ends)
        # in a reciprocal coordinate above is below
        first, last = (self._value(x) for x in self.points[[0, -1], 0])
        return (low, high) if first <= last else (high, low)

    def _value(self, x: float) -> float:
        """The parameter at a searched coordinate; at a wall the bound itself, without rounding."""
        statistic, place = self._statistic, self.place
        for bound, wall in zip(statistic.bounds, statistic.walls, strict=True):
            if x == wall[place]:
                return float(bound[place])
        coordinates = statistic.internal(self.theta)
        coordinates[place] = x
        return float(statistic.external(coordinates)[place])

    def _height(self, x: float, start: float | None = None) -> tuple[float, float]:
        """Rise and slope at a coordinate; the others begin where they were best nearest to it.

        Or where they were best at `start`.
        """
        statistic, place = self._statistic, self.place
        others = np.arange(len(self.theta)) != place
        if start is None:
            start = min(self._followed, key=lambda coordinate: abs(coordinate - x))
        coordinates, information = self._followed[start]
        ahead = coordinates.copy()
        # they begin where they are best to first order
        ahead[others] -= inverse(information[np.ix_(others, others)]) @ (
            information[others, place] * (x - coordinates[place])
        )
        ahead[place] = x
        theta = statistic.external(np.clip(ahead, statistic.low, statistic.high))
        end = newton(statistic, theta, self._weights, held=[place], precision=self._pace.precision)
        self._followed[x] = statistic.internal(end.point), end.curvature
        # others at their best do not add to the slope
        return end.height - self._chi2, 2.0 * float(end.gradient[place])

    def _side(self, start: float, wall: float, curvature: float) -> _Points:
        """(coordinate, rise, slope) of the points from the solution to one side."""
        points = _walk(self._height, start, wall, curvature, self._pace)
        if not _jumps(points):
            return points
        # where the others jump to another minimum, that may have been the lower one before
        lowest = [points[-1]]
        for (x, rise, slope), (outer, *_) in zip(points[-2::-1], points[:0:-1], strict=True):
            lowest.append((x, *min((rise, slope), self._height(x, outer))))
        return lowest[::-1]


_Points = list[tuple[float, float, float]]


def _walk(
    height: Callable[[float], tuple[float, float]],
    start: float,
    wall: float,
    curvature: float,
    pace: Pace = CURVE,
) -> _Points:
    """(coordinate, rise, slope) outwards until the rise is the pace's end, or to the wall.

    A parabola through the last point, of its slope and the curvature there, says how far it is to
    the next root of the rise.
    """
    side = math.copysign(1.0, wall - start)
    x, rise, slope = start, 0.0, 0.0
    least = pace.least_curvature * curvature
    longest = 0.5 / math.sqrt(curvature)
    points: _Points = []
    while x != wall and rise < pace.end and len(points) < pace.most_points:
        # a little beyond the end, lest rounding asks for one more point
        stride = 1.001 * math.sqrt(pace.end) / pace.points
        wanted = (math.sqrt(max(rise, 0.0)) + stride) ** 2 - rise
        step = min(_distance(wanted, side * slope, curvature), longest)
        before, slope_before = x, slope
        x = x + side * step
        if (wall - x) * side <= 0:
            x = wall
        rise, slope = height(x)
        points.append((x, rise, slope))
        curvature = max((slope - slope_before) / (2 * (x - before)), least)
        longest = 2 * abs(x - before)
    return points


def _jumps(points: _Points) -> bool:
    """Whether the rises are not those of their slopes."""
    x, rise, slope = np.array(points or [(0.0, 0.0, 0.0)]).T
    by_slopes = np.diff(x) * (slope[1:] + slope[:-1]) / 2
    return bool(np.any(np.abs(np.diff(rise) - by_slopes) > CURVE.jump))


def _distance(rise: float, slope: float, curvature: float) -> float:
    """Least x > 0 with slope x + curvature x^2 = rise."""
    slope = max(slope, 0.0)
    return 2 * rise / (slope + math.sqrt(slope**2 + 4 * curvature * rise))


def _of_light_yield(scale: Profile, name: str, light_yield: LightYieldInput) -> Profile:
    """Profile of the light yield, scale / (energy efficiency), from that of the scale.

    The efficiency is a parameter with a Gaussian prior: each light yield has the scale for which
    the rise of the scale's profile and of the prior together is least.
    """
    per_scale = light_yield.per_scale
    relative = light_yield.relative_sigma
    value = scale.value * per_scale
    sigma = math.hypot(scale.sigma * per_scale, value * relative)
    if relative == 0:
        return Profile(
            name=name,
            values=scale.values * per_scale,
            delta_chi2=scale.delta_chi2,
            slopes=scale.slopes / per_scale,
            value=value,
            sigma=sigma,
            ends=scale.ends,
        )
    curve, low, high = scale.curve, float(scale.values[0]), float(scale.values[-1])

    def height(photons_per_keV: float) -> tuple[float, float]:
        """Rise of chi2 at a light yield, and its slope."""

        def rise(of_scale: float) -> float:
            factor = photons_per_keV / (of_scale * per_scale)
            return float(curve(of_scale)) + ((factor - 1) / relative) ** 2

        best = minimize_scalar(
            rise, bounds=(low, high), method="bounded", options={"xatol": 1e-7 * (high - low)}
        )
        factor = photons_per_keV / (best.x * per_scale)
        return float(best.fun), 2 * (factor - 1) / (relative**2 * best.x * per_scale)

    below, above = (_walk(height, value, wall, sigma**-2) for wall in (0.0, math.inf))
    values, rises, slopes = np.array([*below[::-1], (value, 0.0, 0.0), *above]).T
    return Profile(
        name=name, values=values, delta_chi2=rises, slopes=slopes, value=value, sigma=sigma
    )
