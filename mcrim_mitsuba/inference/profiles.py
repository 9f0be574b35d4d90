"""Profile likelihoods: how chi2 rises with one parameter while all others follow.

The covariance is held at the solution, as for the intervals of `calibrate`: the curves cross 1
where its intervals end. S. S. Wilks, Ann. Math. Stat. 9 (1938) 60; W. A. Rolke, A. M. Lopez and
J. Conrad, Nucl. Instr. Meth. A 551 (2005) 493.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, minimize_scalar

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.least_squares import LeastSquaresProblem, descend
from mcrim_mitsuba.inference.likelihood import Whitener
from mcrim_mitsuba.inference.model import Model

#: Rises of chi2 that hold 68.3 % and 95.4 % of a Gaussian likelihood, and where curves end.
ONE_SIGMA, TWO_SIGMA, END = 1.0, 4.0, 9.0
# That which holds 95 %.
_RISE_95 = 3.841
#: Points on either side of the solution.
POINTS = 12
# Fall of chi2, still to be expected, that ends a descent.
_SETTLED = 1e-12
# Rise of chi2 from point to point that its slopes do not account for.
_JUMP = 0.05
# A flat profile is followed this many times as many points as a parabola, and no further.
_PATIENCE = 3


@dataclass(frozen=True, eq=False)
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
    prior: float | None
    prior_sigma: float | None
    #: ``min`` and ``max`` where the curve ends at the parameter's bound on that side.
    ends: tuple[str | None, str | None]

    @property
    def curve(self) -> CubicHermiteSpline:
        """The rise between the points: cubic, by values and slopes."""
        return CubicHermiteSpline(self.values, self.delta_chi2, self.slopes)

    @property
    def interval_95(self) -> tuple[float | None, float | None]:
        """Ends of the interval that holds 95 %; None where a bound comes before."""
        return self.crossings(_RISE_95)

    def crossings(self, rise: float) -> tuple[float | None, float | None]:
        """Where the curve crosses a rise below and above the solution; None where it does not."""
        at, curve = int(np.argmin(self.delta_chi2)), self.curve

        def crossing(outward: range) -> float | None:
            for inner in outward:
                outer = inner + outward.step
                if self.delta_chi2[outer] >= rise:
                    ends = self.values[inner], self.values[outer]
                    return float(brentq(lambda v: float(curve(v)) - rise, *ends))
            return None

        return crossing(range(at, 0, -1)), crossing(range(at, len(self.values) - 1))


def profiles_of(model: Model, calibration: Calibration) -> tuple[Profile, ...]:
    """Profiles of every free parameter, and of the light yield where the campaign tells it.

    That of the light yield minimises over the scale and over the detector efficiency, whose
    relative error is a Gaussian factor on the light yield. The calibration is the model's fit.
    """
    problem = LeastSquaresProblem(model)
    weights = Whitener(problem.errors_at(calibration.theta))
    best, least, _ = descend(problem, calibration.theta, weights, precision=_SETTLED)
    profiles = {
        parameter.name: _profile(problem, weights, best, least, index)
        for index, parameter in enumerate(problem.free)
    }
    for scale, (name, known) in model.campaign.light_yields.items():
        if scale in profiles and name in calibration.parameters:
            profiles[name] = _of_light_yield(profiles[scale], name, known)
    return tuple(profiles.values())


def _profile(
    problem: LeastSquaresProblem, weights: Whitener, best: Array, least: float, index: int
) -> Profile:
    """One parameter's, from the solution and its chi2 outwards."""

    def slopes_at(theta: Array) -> tuple[Array, Array]:
        """(free,) d chi2 / d parameter and (free, free) information, in the parameters' units."""
        residuals, slopes = problem.evaluate(theta, weights)
        slopes = slopes / problem.slopes_of_external(theta)
        return 2.0 * slopes.T @ residuals, slopes.T @ slopes

    parameter, value = problem.free[index], float(best[index])
    slope, information = slopes_at(best)
    sigma = math.sqrt(np.linalg.inv(information)[index, index])
    others = np.arange(len(best)) != index
    low, high = np.array([(p.minimum, p.maximum) for p in problem.free]).T
    sides = []
    for bound in (parameter.minimum, parameter.maximum):
        theta = best

        def height(value: float) -> tuple[float, float]:
            nonlocal theta
            # the others begin where they are best to first order
            start, information = theta.copy(), slopes_at(theta)[1]
            start[others] -= np.linalg.solve(
                information[np.ix_(others, others)],
                information[others, index] * (value - theta[index]),
            )
            start[index] = value
            start = np.clip(start, low, high)
            theta, chi2, _ = descend(problem, start, weights, held=[index], precision=_SETTLED)
            # others at their best do not add to the slope
            return chi2 - least, float(slopes_at(theta)[0][index])

        found = _walk(height, value, bound, sigma)
        # where the others jump to another minimum, that may have been the lower one before
        if _jumps(found):
            back = [height(value) for value, _, _ in found[::-1]]
            found = [
                (value, *min((rise, slope), there))
                for (value, rise, slope), there in zip(found, back[::-1], strict=True)
            ]
        sides.append(found)
    # without a point the solution itself is at the bound
    below, above = sides
    ends = (
        "min" if not below or below[-1][0] == parameter.minimum else None,
        "max" if not above or above[-1][0] == parameter.maximum else None,
    )
    return Profile(
        parameter.name,
        *_joined(sides, value, float(slope[index])),
        value,
        sigma,
        parameter.prior,
        parameter.prior_sigma,
        ends,
    )


_Points = list[tuple[float, float, float]]


def _walk(
    height: Callable[[float], tuple[float, float]], start: float, bound: float, sigma: float
) -> _Points:
    """(value, rise, slope) outwards until the rise is `END`, or to the bound.

    A parabola through the last point, of its slope and the curvature found so far, says how far it
    is to the next root of the rise.
    """
    side = math.copysign(1.0, bound - start)
    value, rise, slope = start, 0.0, 0.0
    curvature, longest = sigma**-2, 0.5 * sigma
    found: _Points = []
    while value != bound and rise < END and len(found) < _PATIENCE * POINTS:
        # a little beyond the end, lest rounding asks for one more point
        wanted = (math.sqrt(max(rise, 0.0)) + 1.001 * math.sqrt(END) / POINTS) ** 2 - rise
        step = min(_distance(wanted, side * slope, curvature), longest)
        before, slope_before = value, slope
        value = value + side * step
        if (bound - value) * side <= 0:
            value = bound
        rise, slope = height(value)
        found.append((value, rise, slope))
        curvature = max((slope - slope_before) / (2 * (value - before)), 1e-3 / sigma**2)
        longest = 2 * abs(value - before)
    return found


def _jumps(found: _Points) -> bool:
    """Whether the rises are not those of their slopes."""
    value, rise, slope = np.array(found or [(0.0, 0.0, 0.0)]).T
    by_slopes = np.diff(value) * (slope[1:] + slope[:-1]) / 2
    return bool(np.any(np.abs(np.diff(rise) - by_slopes) > _JUMP))


def _distance(rise: float, slope: float, curvature: float) -> float:
    """Least x > 0 with slope x + curvature x^2 = rise."""
    slope = max(slope, 0.0)
    return 2 * rise / (slope + math.sqrt(slope**2 + 4 * curvature * rise))


def _joined(sides: list[_Points], start: float, slope: float) -> tuple[Array, Array, Array]:
    """Values, rises and slopes of both sides and the solution between them, ascending."""
    below, above = sides
    rows = np.array([*below[::-1], (start, 0.0, slope), *above])
    return rows[:, 0], rows[:, 1], rows[:, 2]


def _of_light_yield(scale: Profile, name: str, known: LightYieldInput) -> Profile:
    """Of scale / (energy efficiency): over the scale, with a Gaussian factor for the efficiency."""
    per_scale = known.per_scale
    relative = known.detector_efficiency_sigma / known.detector_efficiency
    value = scale.value * per_scale
    sigma = math.hypot(scale.sigma * per_scale, value * relative)
    if relative == 0:
        return Profile(
            name,
            scale.values * per_scale,
            scale.delta_chi2,
            scale.slopes / per_scale,
            value,
            sigma,
            None,
            None,
            scale.ends,
        )
    curve, low, high = scale.curve, float(scale.values[0]), float(scale.values[-1])

    def height(light_yield: float) -> tuple[float, float]:
        def rise(of_scale: float) -> float:
            factor = light_yield / (of_scale * per_scale)
            return float(curve(of_scale)) + ((factor - 1) / relative) ** 2

        found = minimize_scalar(
            rise, bounds=(low, high), method="bounded", options={"xatol": 1e-7 * (high - low)}
        )
        factor = light_yield / (found.x * per_scale)
        return float(found.fun), 2 * (factor - 1) / (relative**2 * found.x * per_scale)

    sides = [_walk(height, value, bound, sigma) for bound in (0.0, math.inf)]
    return Profile(name, *_joined(sides, value, 0.0), value, sigma, None, None, (None, None))
