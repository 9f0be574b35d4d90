"""Finds the minima of a campaign's statistic and the intervals around them, with MINUIT.

alpha_scat is searched in its logarithm, since eta changes with it over decades; intervals
by profile likelihood do not depend on that. F. James and M. Roos, Comput. Phys. Commun. 10
(1975) 343 (MINUIT); F. James, MINUIT manual (CERN D506), section 7.3 (MINOS).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from iminuit import Minuit
from numpy.typing import NDArray
from scipy.optimize import brentq

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter
from mcrim_mitsuba.fit.likelihood import FrozenStatistic, Likelihood
from mcrim_mitsuba.fit.surface import ALPHA_SCAT

# Points of the scan in alpha_scat that finds the starts, and how many of its minima to follow.
_SCAN_POINTS = 31
_MOST_STARTS = 3

# Updates of the covariance, and the shift (in standard errors, squared) that ends them.
_MOST_UPDATES = 6
_SETTLED = 1e-4

# Distance from a bound, in standard errors, that counts as being there.
_AT_BOUND = 0.02

# MINUIT stops at an expected distance to the minimum of 0.002 times this.
_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Optimum:
    """A minimum of the statistic.

    Attributes
    ----------
    theta : (free,) float64
        Parameters, in the order of the model's.
    chi2 : float
    statistic : FrozenStatistic
        With the covariance that the minimum itself predicts, within the tolerance.
    converged : bool
    at_bound : tuple of ("min", "max" or None)
        Per parameter, the bound that stopped it.
    """

    theta: NDArray[np.float64]
    chi2: float
    statistic: FrozenStatistic
    converged: bool
    at_bound: tuple[str | None, ...]

    @property
    def deviance(self) -> float:
        """-2 log(likelihood) up to a constant, by which minima compare.

        chi2 alone would prefer the minimum with the largest Monte Carlo errors.
        """
        return self.chi2 + self.statistic.log_determinant


@dataclass(frozen=True)
class Interval:
    """Where the profile of the statistic has risen by 1: 68.3 % for a Gaussian likelihood.

    Attributes
    ----------
    lower, upper : float
    cut : tuple of ("min" and/or "max")
        Ends that are the parameter's bound, before the statistic had risen by 1.
    """

    lower: float
    upper: float
    cut: tuple[str, ...]


def find_minima(likelihood: Likelihood) -> list[Optimum]:
    """Minima of the statistic, the lowest first; more than one where the model is ambiguous.

    Parameters
    ----------
    likelihood : Likelihood
        With one free parameter at least.
    """
    found: list[Optimum] = []
    for start in _starts(likelihood):
        optimum = _descend(likelihood, start)
        information = optimum.statistic.information(optimum.theta)
        if all(_distance(optimum.theta, other.theta, information) > 0.01 for other in found):
            found.append(optimum)
    return sorted(found, key=lambda optimum: optimum.deviance)


def _starts(likelihood: Likelihood) -> list[NDArray[np.float64]]:
    """Local minima of a scan in alpha_scat, each with its best scale; others at their start."""
    free = likelihood.model.free
    names = [p.name for p in free]
    errors = likelihood.errors_before_any_fit()
    statistic = FrozenStatistic(likelihood, errors)
    base = np.array([0.0 if math.isnan(p.start) else p.start for p in free])
    grid = [base]
    if ALPHA_SCAT in names:
        known = free[names.index(ALPHA_SCAT)]
        grid = [base.copy() for _ in range(_SCAN_POINTS)]
        values = np.geomspace(known.minimum, known.maximum, _SCAN_POINTS)
        for theta, value in zip(grid, values, strict=True):
            theta[names.index(ALPHA_SCAT)] = value
    if SCALE in names:
        known = free[names.index(SCALE)]
        for theta in grid:
            best = likelihood.best_scale(likelihood.model.predict(theta).eta, errors)
            theta[names.index(SCALE)] = min(max(best, known.minimum), known.maximum)
    heights = np.array([statistic.chi2(theta) for theta in grid])
    walls = np.concatenate([[np.inf], heights, [np.inf]])
    lowest = np.flatnonzero((heights <= walls[:-2]) & (heights <= walls[2:]))
    lowest = lowest[np.argsort(heights[lowest], kind="stable")][:_MOST_STARTS]
    return [grid[i] for i in lowest]


def _descend(likelihood: Likelihood, theta: NDArray[np.float64]) -> Optimum:
    """The minimum that a start leads to, its covariance updated until it agrees with it."""
    for _ in range(_MOST_UPDATES):
        before = theta
        statistic = FrozenStatistic(likelihood, likelihood.errors_at(theta))
        theta, chi2, converged = _minimise(statistic, theta)
        information = statistic.information(theta)
        if _distance(theta, before, information) < _SETTLED:
            break
    sides = tuple(
        _side(value, parameter, curvature)
        for value, parameter, curvature in zip(
            theta, likelihood.model.free, np.diag(information), strict=True
        )
    )
    return Optimum(theta, chi2, statistic, converged, sides)


def _distance(
    one: NDArray[np.float64], other: NDArray[np.float64], information: NDArray[np.float64]
) -> float:
    """Squared distance of two estimates in standard errors."""
    return float((one - other) @ information @ (one - other))


def _side(value: float, parameter: CampaignParameter, curvature: float) -> str | None:
    """The bound that a parameter has reached, if any; the curvature is 1 / sigma^2."""
    close = _AT_BOUND / math.sqrt(curvature) if curvature > 0 else 0.0
    if value - parameter.minimum <= close:
        return "min"
    if parameter.maximum - value <= close:
        return "max"
    return None


def _minimise(
    statistic: FrozenStatistic, start: NDArray[np.float64], held: int | None = None
) -> tuple[NDArray[np.float64], float, bool]:
    """Parameters at the minimum, its chi2, and whether MINUIT was content."""
    if held is not None and len(start) == 1:
        return start, statistic.chi2(start), True
    minuit = _minuit(statistic, start)
    if held is not None:
        minuit.values[held] = _internal(statistic.likelihood.model.free[held], start[held])
        minuit.fixed[held] = True
    minuit.migrad()
    converged = minuit.valid
    if not converged:
        # at a node of a response with kinks, slopes do not vanish: SIMPLEX needs none
        chi2 = minuit.fval
        minuit.simplex()
        converged = minuit.valid and chi2 - minuit.fval < _SETTLED
    return _external(statistic, np.array(minuit.values)), float(minuit.fval), bool(converged)


def _minuit(statistic: FrozenStatistic, start: NDArray[np.float64]) -> Minuit:
    """MINUIT, ready to minimise from a start."""
    free = statistic.likelihood.model.free
    limits = [(_internal(p, p.minimum), _internal(p, p.maximum)) for p in free]
    inside = [
        _inside(_internal(p, value), *limit)
        for p, value, limit in zip(free, start, limits, strict=True)
    ]

    def chi2(x: NDArray[np.float64]) -> float:
        return statistic.chi2(_external(statistic, x))

    def gradient(x: NDArray[np.float64]) -> NDArray[np.float64]:
        theta = _external(statistic, x)
        # d alpha_scat / d log(alpha_scat) = alpha_scat
        chain = [v if p.name == ALPHA_SCAT else 1.0 for p, v in zip(free, theta, strict=True)]
        return statistic.gradient(theta) * chain

    minuit = Minuit(chi2, np.array(inside), grad=gradient, name=[p.name for p in free])
    minuit.errordef = Minuit.LEAST_SQUARES
    minuit.tol = _TOLERANCE
    minuit.limits = limits
    minuit.errors = [_first_step(p, x) for p, x in zip(free, inside, strict=True)]
    return minuit


def _internal(parameter: CampaignParameter, value: float) -> float:
    return math.log(value) if parameter.name == ALPHA_SCAT else float(value)


def _external_value(parameter: CampaignParameter, x: float) -> float:
    return math.exp(x) if parameter.name == ALPHA_SCAT else float(x)


def _external(statistic: FrozenStatistic, x: NDArray[np.float64]) -> NDArray[np.float64]:
    free = statistic.likelihood.model.free
    if not np.all(np.isfinite(x)):
        raise _unfittable(statistic.likelihood)
    return np.array([_external_value(p, value) for p, value in zip(free, x, strict=True)])


def _unfittable(likelihood: Likelihood) -> InputError:
    """The refusal of readings at which arithmetic ends."""
    measurements = likelihood.model.campaign.measurements
    low, high = (side(measurements.in_use, key=lambda r: r.signal / r.sigma) for side in (min, max))
    return InputError(
        "the readings cannot be fitted together: they are from "
        f"{low.signal:g} ± {low.sigma:g} ({low.label}) to {high.signal:g} ± {high.sigma:g} "
        f"({high.label})",
        "check their units and errors",
        path=measurements.path,
    )


def _inside(x: float, low: float, high: float) -> float:
    """A start clear of the bounds, on which MINUIT's transformation has no slope."""
    margin = 0.01 * (high - low) if math.isfinite(high - low) else 0.01 * max(abs(x), 1e-6)
    return min(max(x, low + margin), high - margin)


def _first_step(parameter: CampaignParameter, x: float) -> float:
    if parameter.name == ALPHA_SCAT:
        return 0.1
    if parameter.prior_sigma is not None:
        return parameter.prior_sigma
    return 0.05 * abs(x) or 0.01


def intervals(optimum: Optimum) -> list[Interval]:
    """Interval of every parameter by MINOS; by following the profile where MINOS cannot.

    MINOS extrapolates from the curvature in MINUIT's transformed variables, and these have
    none at a bound.
    """
    free = optimum.statistic.likelihood.model.free
    ends = _minos(optimum)
    found = []
    for index, parameter in enumerate(free):
        values: dict[str, float] = {}
        cut = []
        for side, bound in (("min", parameter.minimum), ("max", parameter.maximum)):
            value, reached = ends.get((parameter.name, side)), True
            if value is None:
                value, reached = _follow_profile(optimum, index, bound)
            if not reached:
                cut.append(side)
            values[side] = value
        found.append(Interval(values["min"], values["max"], tuple(cut)))
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
    for parameter in optimum.statistic.likelihood.model.free:
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

    information = optimum.statistic.information(optimum.theta)
    step = math.copysign(1.0 / math.sqrt(information[index, index]), bound - best)
    inner = best
    while inner != bound:
        outer = best + step if abs(step) < abs(bound - best) else bound
        if rise(outer) > 0:
            end = brentq(rise, inner, outer, xtol=1e-4 * abs(outer - inner), rtol=1e-6)
            return float(end), True
        inner, step = outer, 2.0 * step
    return float(bound), False
