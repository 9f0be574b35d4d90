"""How large an effect may be, where the data are adequate without it."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.result import Limit
from mcrim_mitsuba.diagnosis.solver import Fit, descend

# Rise of chi2 at 95 % confidence: one-sided where the effect is absent at a bound, else two-sided.
_ONE_SIDED, _TWO_SIDED = 2.706, 3.841

# Relative precision of a limit.
_PRECISION = 2e-3


def upper_limits(explanations: Explanations) -> dict[str, Limit]:
    """Limits on every effect by profile likelihood, all other parameters fitted along the way.

    Parameters
    ----------
    explanations : Explanations

    Returns
    -------
    dict of str to Limit
        By effect; of an effect with several parameters by ``effect.parameter``.
    """
    baseline, found = explanations.baseline, {}
    for effect, fit in explanations.singles().items():
        names = explanations.free_parameters((effect,), effect)
        gain = baseline.chi2 - fit.chi2
        if not names:
            found[effect] = Limit(None, None, None, None, gain, bool(-gain > _TWO_SIDED))
        for name in names:
            key = effect if len(names) == 1 else f"{effect}.{name}"
            found[key] = _limit(explanations, effect, name, fit, gain)
    return found


def _limit(explanations: Explanations, effect: str, name: str, fit: Fit, gain: float) -> Limit:
    absent = explanations.absent(effect)[name]
    parameter = fit.problem.free[fit.problem.index(name)]
    below, above = absent > parameter.minimum, absent < parameter.maximum
    rise = _TWO_SIDED if below and above else _ONE_SIDED
    # not nested where the range ends before the effect is absent
    lowest = min(fit.chi2, explanations.baseline.chi2)
    nodes = [node[name] for node in explanations.nodes((effect,), effect)]
    return Limit(
        parameter=name,
        absent=absent,
        lower=_end(fit, name, parameter.minimum, nodes, lowest + rise) if below else None,
        upper=_end(fit, name, parameter.maximum, nodes, lowest + rise) if above else None,
        delta_chi2=gain,
        excluded=False,
    )


def _end(fit: Fit, name: str, bound: float, nodes: list[float], height: float) -> float:
    """Where the profile passes a height on the way to a bound; infinite if nowhere."""
    problem, place = fit.problem, fit.problem.index(name)
    theta = fit.theta.copy()
    sign = math.copysign(1.0, bound - theta[place])

    def internal(value: float) -> float:
        start = fit.theta.copy()
        start[place] = value
        return float(problem.internal(start)[place])

    # a profile depends a little on where it comes from: every point keeps its first height, so
    # that the ends of a search have the signs that they were chosen for
    known = {internal(fit.theta[place]): fit.chi2 - height}

    def above(x: float) -> float:
        nonlocal theta
        if x in known:
            return known[x]
        coordinates = problem.internal(theta)
        coordinates[place] = x
        theta, chi2, _ = descend(
            problem,
            problem.external(coordinates),
            fit.weights,
            held=[place],
            steps=8,
            precision=0.01,
        )
        known[x] = chi2 - height
        return known[x]

    stops = sorted({*nodes, bound}, key=lambda v: sign * v)
    inner = internal(fit.theta[place])
    sigma = math.sqrt(fit.parameter_covariance[place, place])
    if sigma * 2.0 < abs(bound - fit.theta[place]):
        # the linear guess comes first
        stops.append(float(fit.theta[place] + 2.0 * sign * sigma))
        stops.sort(key=lambda v: sign * v)
    for stop in stops:
        if sign * (stop - fit.theta[place]) <= 0 or not math.isfinite(stop):
            continue
        outer = internal(stop)
        if above(outer) > 0:
            width = abs(outer - inner)
            x = brentq(above, inner, outer, xtol=_PRECISION * width, rtol=1e-6, maxiter=25)
            coordinates = problem.internal(theta)
            coordinates[place] = x
            return float(problem.external(coordinates)[place])
        inner = outer
    return float(np.copysign(np.inf, sign))
