"""Table 1 again: the scattering coefficient from the ratio, and the efficiencies there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.curves import RatioCurve
from mcrim_mitsuba.article.published import Printed, Table1Line
from mcrim_mitsuba.article.simulated import Coupling
from mcrim_mitsuba.fit.ratio import RatioSolution, alpha_scat_from_ratio
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT, EtaPoint, Surface

#: Where alpha_scat is sought, 1/cm.
_BOUNDS_PER_CM = (0.1, 2.0)

#: Points, 1/cm, and degree of the polynomial in log(alpha_scat) that finds the gel curve's
#: maximum. The curve is skew: a parabola is 0.003 off, this cubic 0.0003 (zero of the gradient).
_PEAK_POINTS_PER_CM = (0.2, 0.253, 0.32, 0.405, 0.513, 0.65)
_PEAK_DEGREE = 3


@dataclass(frozen=True)
class FittedLine:
    """A line of Table 1 as simulated here.

    Attributes
    ----------
    line : Table1Line
        The article's, whose T and alpha_abs are taken over.
    polarised : bool
    solution : RatioSolution
        alpha_scat where eta_air / eta_gel is the measured R.
    air, gel : EtaPoint
        Efficiencies there.
    monte_carlo_of_sigma : float
        Monte Carlo error of the solution's ``statistical_sigma``, 1/cm.
    """

    line: Table1Line
    polarised: bool
    solution: RatioSolution
    air: EtaPoint
    gel: EtaPoint
    monte_carlo_of_sigma: float

    @property
    def ratio_slope_cm(self) -> float:
        """dR / d alpha_scat at the solution."""
        return p.RATIO.stated_sigma / self.solution.statistical_sigma

    @property
    def article_monte_carlo_sigma(self) -> float:
        """Error that the article's own 100,000 rays leave on alpha_scat, 1/cm.

        Binomial, for two independent efficiencies: what ZEMAX's splitting of rays may gain is
        not known.
        """
        relative = math.hypot(*(
            article_monte_carlo_sigma(point.eta) / point.eta for point in (self.air, self.gel)
        ))  # fmt: skip
        return p.RATIO.value * relative / self.ratio_slope_cm

    def eta_sigma(self, point: EtaPoint) -> tuple[float, float]:
        """Errors of an efficiency at the solution: from the signals' ratio, and Monte Carlo."""
        slope = abs(point.gradient[ALPHA_SCAT])
        return (
            slope * self.solution.statistical_sigma,
            math.hypot(point.sigma, slope * self.solution.monte_carlo_sigma),
        )

    @property
    def air_per_ratio(self) -> float:
        """d log(eta_air) / d log(R) at the solution: what a wrong ratio does to eta_air."""
        slope = self.air.gradient[ALPHA_SCAT] / self.air.eta
        return slope * p.RATIO.value / self.ratio_slope_cm


def article_monte_carlo_sigma(eta: float) -> float:
    """Binomial standard error of an efficiency from the article's 100,000 rays."""
    return math.sqrt(eta * (1.0 - eta) / p.RAYS)


def fit_line(curve: RatioCurve) -> FittedLine:
    """Solve eta_air / eta_gel = R for alpha_scat at one transmittance of Table 1."""
    alpha_abs = curve.line.alpha_abs_per_cm.value
    solution = alpha_scat_from_ratio(
        curve.air, curve.gel, alpha_abs, p.RATIO.value, p.RATIO.stated_sigma, _BOUNDS_PER_CM
    )
    air, gel = (c.coupling.at(solution.value, alpha_abs) for c in (curve.air, curve.gel))
    return FittedLine(
        curve.line, curve.polarised, solution, air, gel, _monte_carlo_of_sigma(curve, solution)
    )


def _monte_carlo_of_sigma(curve: RatioCurve, solution: RatioSolution) -> float:
    """Monte Carlo error of ``statistical_sigma``, which is that of the slope of R.

    The slope is taken between the ends of the interval, whose efficiencies come from the same
    photons: their covariances enter.
    """
    ends = (
        solution.lower or solution.value - solution.statistical_sigma,
        solution.upper or solution.value + solution.statistical_sigma,
    )
    difference = variance = 0.0
    for sign, side in ((1.0, curve.air), (-1.0, curve.gel)):
        places = [{ALPHA_SCAT: a, ALPHA_ABS: curve.line.alpha_abs_per_cm.value} for a in ends]
        low, high = (side.coupling.at(*place.values()) for place in places)
        difference += sign * math.log(high.eta / low.eta)
        shared = side.covariance(*places) / (low.eta * high.eta)
        variance += (low.sigma / low.eta) ** 2 + (high.sigma / high.eta) ** 2 - 2.0 * shared
    return solution.statistical_sigma * math.sqrt(max(variance, 0.0)) / abs(difference)


def fit_table_1(curves: Iterable[RatioCurve]) -> dict[bool, tuple[FittedLine, ...]]:
    """All lines of Table 1, by whether polarisation was followed."""
    found = [fit_line(curve) for curve in curves]
    return {
        polarised: tuple(fit for fit in found if fit.polarised is polarised)
        for polarised in (True, False)
    }


def largest_eta_deviation(fitted: Sequence[FittedLine]) -> float:
    """Largest relative deviation of eta from the nominal transmittance's, over Table 1.

    The rule that gives the article's ±12 % from its own table.
    """
    nominal = next(found for found in fitted if found.line == p.NOMINAL)
    return max(
        max(abs(found.air.eta / nominal.air.eta - 1), abs(found.gel.eta / nominal.gel.eta - 1))
        for found in fitted
    )


def at_printed_point(coupling: Coupling, line: Table1Line) -> tuple[EtaPoint, float]:
    """Efficiency at the article's own coefficients, and what their rounding may move it by."""
    point = coupling.at(line.alpha_scat_per_cm.value, line.alpha_abs_per_cm.value)
    moved = _moved(point, ALPHA_SCAT, line.alpha_scat_per_cm)
    return point, moved + _moved(point, ALPHA_ABS, line.alpha_abs_per_cm)


def _moved(point: EtaPoint, name: str, number: Printed) -> float:
    return abs(point.gradient[name]) * number.rounding


def position_of_maximum(surface: Surface, alpha_abs_per_cm: float) -> tuple[float, float]:
    """alpha_scat at which an efficiency is largest, 1/cm, and its Monte Carlo error.

    The maximum of a least-squares cubic in log(alpha_scat) through six points. They come
    from the same photons; their covariances, which the surface gives, are propagated through
    the least squares to the position.

    Raises
    ------
    ValueError
        If the cubic has no maximum between the outermost points.
    """
    x = np.log(_PEAK_POINTS_PER_CM)
    points = [{ALPHA_SCAT: a, ALPHA_ABS: alpha_abs_per_cm} for a in _PEAK_POINTS_PER_CM]
    eta = np.array([surface.evaluate(a, alpha_abs_per_cm).eta for a in _PEAK_POINTS_PER_CM])
    covariance = np.empty((len(x), len(x)))
    for i, first in enumerate(points):
        for j, second in enumerate(points[: i + 1]):
            covariance[i, j] = covariance[j, i] = surface.covariance(first, second)
    powers = np.vander(x, _PEAK_DEGREE + 1, increasing=True)
    solve = np.linalg.pinv(powers)
    curve = np.polynomial.Polynomial(solve @ eta)
    slope, bend = curve.deriv(), curve.deriv(2)
    inside = [
        float(root.real)
        for root in slope.roots()
        if abs(root.imag) < 1e-12 and x[0] < root.real < x[-1] and bend(root.real) < 0
    ]
    if len(inside) != 1:
        raise ValueError(f"the efficiency has {len(inside)} maxima between the points")
    (peak,) = inside
    # the slope at the maximum is linear in eta, and the maximum moves by -slope / bend
    weights = np.array([k * peak ** (k - 1) if k else 0.0 for k in range(_PEAK_DEGREE + 1)])
    moves = weights @ solve / bend(peak)
    position = math.exp(peak)
    return position, position * float(np.sqrt(moves @ covariance @ moves))
