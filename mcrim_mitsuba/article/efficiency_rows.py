"""The article's simulated numbers beside ours: bare crystals, Table 1, other crystals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.arithmetic import escape_per_face, from_printed
from mcrim_mitsuba.article.published import ArticleRow, Printed, Table1Line, compare
from mcrim_mitsuba.article.simulated import (
    DEFAULT_WRAP_REFLECTANCE,
    GEL,
    Coupling,
    RatioCurve,
    Simulated,
)
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.efficiency.surface import EfficiencySurface, EtaPoint
from mcrim_mitsuba.inference.ratio import RatioSolution, alpha_scat_from_ratio
from mcrim_mitsuba.optics.fresnel import trapped_fraction
from mcrim_mitsuba.transport.simulation import SimulationResult

#: Where alpha_scat is sought, 1/cm.
_BOUNDS_PER_CM = (0.1, 2.0)

#: Points, 1/cm, and degree of the polynomial in log(alpha_scat) that finds the gel curve's
#: maximum. The curve is skew: a parabola is 0.003 off, this cubic 0.0003 (zero of the gradient).
_PEAK_POINTS_PER_CM = (0.2, 0.253, 0.32, 0.405, 0.513, 0.65)
_PEAK_DEGREE = 3


@dataclass(frozen=True)
class FittedLine:
    """A line of Table 1 as simulated here."""

    #: Table1Line: The article's, whose T and alpha_abs are taken over.
    line: Table1Line
    polarised: bool
    #: alpha_scat where eta_air / eta_gel is the measured R.
    solution: RatioSolution
    #: Efficiencies there.
    air: EtaPoint
    gel: EtaPoint
    #: Monte Carlo error of the solution's ``statistical_sigma``, 1/cm.
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


def nominal_of(lines: Sequence[FittedLine]) -> FittedLine:
    """The line of the nominal transmittance."""
    return next(fit for fit in lines if fit.line == p.NOMINAL)


def largest_eta_deviation(fitted: Sequence[FittedLine]) -> float:
    """Largest relative deviation of eta from the nominal transmittance's, over Table 1.

    The rule that gives the article's ±12 % from its own table.
    """
    nominal = nominal_of(fitted)
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


def position_of_maximum(surface: EfficiencySurface, alpha_abs_per_cm: float) -> tuple[float, float]:
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


# The article's simulated numbers beside ours: bare crystals, Table 1, other crystals.

Fits = Mapping[bool, Sequence[FittedLine]]

_WORD = {True: "polarised", False: "unpolarised"}


def bare_crystal_rows(simulated: Simulated) -> list[ArticleRow]:
    """Eq. 6 by Mitsuba: all light that leaves a crystal without losses, over its six faces."""
    rows = []
    for (n, result), paper in zip(
        simulated.bare.items(), (p.ETA_FACE_AIR, p.ETA_FACE_GEL), strict=True
    ):
        face = 100 * (1 - result.budget["truncated"]) / 6
        sigma = 100 * result.budget_sigma["truncated"] / 6
        exact = 100 * escape_per_face(n)
        remark = f"closed form of this geometry {exact:.3f} %, {_distance(face, exact, sigma)}"
        if n < math.sqrt(2):
            remark += (
                "; below n = sqrt(2) the six escape cones overlap, and Eq. 6 counts the light "
                "in two of them twice"
            )
        rows.append(compare(
            p.BARE_CRYSTAL, f"one face, n = {n:.4g}, by Mitsuba", paper, face, sigma=sigma,
            difference_sigma=math.hypot(sigma, p.ZEMAX_FACE_RELATIVE_ERROR * paper.value),
            remark=f"{remark}; the article's own limit of 1 % enters the verdict",
        ))  # fmt: skip
    result = simulated.bare[p.N_CRYSTAL.value]
    trapped, sigma = 100 * result.budget["truncated"], 100 * result.budget_sigma["truncated"]
    exact = float(100 * trapped_fraction(p.N_CRYSTAL.value))
    rows.append(compare(
        p.BARE_CRYSTAL, "trapped for ever, n = 2.01, by Mitsuba", None, trapped,
        sigma=sigma, unit="%", remark=_distance(trapped, exact, sigma) + " from the closed form",
    ))  # fmt: skip
    return rows


def _distance(ours: float, exact: float, sigma: float) -> str:
    return f"{(ours - exact) / sigma:+.1f} of our standard errors"


def bench_rows(simulated: Simulated, photons: int) -> list[ArticleRow]:
    """The scene's parameters beside the article's description."""
    stated = (
        ("crystal width", p.CRYSTAL_MM, "crystal_width_mm", 1.0),
        ("crystal height", p.CRYSTAL_MM, "crystal_height_mm", 1.0),
        ("index of the crystal", p.N_CRYSTAL, "n_crystal", 1.0),
        ("gap", p.GAP_MM, "gap_mm", 1.0),
        ("index of the gap, empty", p.N_AIR, "n_gap", 1.0),
        ("window width", p.WINDOW_WIDTH_MM, "window_width_mm", 1.0),
        ("window thickness", p.WINDOW_THICKNESS_MM, "window_thickness_mm", 1.0),
        ("index of the window", p.N_WINDOW, "n_window", 1.0),
        ("diameter of the aperture", p.APERTURE_DIAMETER_MM, "aperture_radius_mm", 2.0),
    )
    rows = [
        compare(p.BENCH, what, number, factor * float(simulated.parameters[name]))
        for what, number, name, factor in stated
    ]
    gel = simulated.couplings[GEL, True].n_gap
    cawo4 = simulated.cawo4.parameters
    rows += [
        compare(p.BENCH, "index of the gap, gel", p.N_GEL, gel),
        compare(p.BENCH, "alpha_abs of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_ABS,
                float(cawo4["alpha_abs_per_cm"])),
        compare(p.BENCH, "alpha_scat of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_SCAT,
                float(cawo4["alpha_scat_per_cm"])),
        compare(p.BENCH, "source smaller than the crystal by", p.SOURCE_MARGIN_MM, 0.0,
                judged=False, remark="ours fills the crystal: there is no surface to keep off"),
    ]  # fmt: skip
    rays = Printed(f"{p.RAYS:,}", p.RAYS, 0.5, None, "Sec. 5")
    rows.append(compare(
        p.BENCH, "rays per point; ours: per curve", rays, photons, judged=False,
        remark="100,000 rays alone leave an error of "
        f"{100 * article_monte_carlo_sigma(0.25):.2f} % (of all light) on an efficiency of 25 %",
    ))  # fmt: skip
    return rows


def table_1_rows(fits: Fits) -> list[ArticleRow]:
    """alpha_scat where the simulated ratio is the measured one."""
    rows = []
    for polarised, lines in fits.items():
        for fit in lines:
            found, paper = fit.solution, fit.line.alpha_scat_per_cm
            is_nominal = fit.line == p.NOMINAL
            rows.append(compare(
                p.TABLE_1_SECTION,
                f"alpha_scat, T = {fit.line.transmittance_percent.text} %, {_WORD[polarised]}",
                p.ALPHA_SCAT if is_nominal else paper, found.value,
                sigma=math.hypot(found.statistical_sigma, found.monte_carlo_sigma),
                difference_sigma=math.hypot(
                    found.monte_carlo_sigma, fit.article_monte_carlo_sigma
                ),
                remark=f"{found.value:.3f} ± {found.statistical_sigma:.3f} (from R) ± "
                f"{found.monte_carlo_sigma:.3f} (Monte Carlo); the article's rays leave "
                f"±{fit.article_monte_carlo_sigma:.3f} on its own",
            ))  # fmt: skip
    nominal = nominal_of(fits[True])
    found, interval = nominal.solution, ""
    if found.lower is not None and found.upper is not None:
        interval = (
            f"R ± 0.012 gives {found.lower:.2f} to {found.upper:.2f} /cm: not quite symmetric"
        )
    rows.append(compare(
        p.TABLE_1_SECTION, "error of alpha_scat from that of R, Sec. 6.2",
        p.printed("0.10", "Sec. 6.2", "1/cm"), found.statistical_sigma,
        sigma=nominal.monte_carlo_of_sigma,
        rounding=found.statistical_sigma * p.RATIO.rounding / p.RATIO.stated_sigma,
        remark=interval,
    ))  # fmt: skip
    return rows


def efficiency_rows(simulated: Simulated, fits: Fits) -> list[ArticleRow]:
    """Efficiencies at our coefficients and at the article's, and the shape of the curves."""
    rows = []
    for polarised, lines in fits.items():
        for fit in lines:
            for name, paper, point in _couplings(fit.line, (fit.air, fit.gel)):
                from_ratio, monte_carlo = fit.eta_sigma(point)
                what = f"{name}, T = {fit.line.transmittance_percent.text} %, at our fit"
                sigma = math.hypot(from_ratio, monte_carlo)
                rows.append(_eta_row(what, polarised, paper, point, sigma, monte_carlo))
    for polarised in (True, False):
        for line in p.TABLE_1:
            for name, paper, coupling in _couplings(line, simulated.pair(polarised)):
                point, moved = at_printed_point(coupling, line)
                at = f"({line.alpha_abs_per_cm.text}, {line.alpha_scat_per_cm.text}) /cm"
                what = f"{name} at {at}"
                rows.append(_eta_row(what, polarised, paper, point, point.sigma, moved=moved))
    return rows + _shape_rows(simulated)


_T = TypeVar("_T")


def _couplings(line: Table1Line, of_both: tuple[_T, _T]) -> Iterator[tuple[str, Printed, _T]]:
    """Name, printed efficiency and ours of air and gel."""
    printed = (line.eta_air_percent, line.eta_gel_percent)
    return zip(("eta_air", "eta_gel"), printed, of_both, strict=True)


def _eta_row(
    what: str, polarised: bool, paper: Printed, point: EtaPoint, sigma: float,
    monte_carlo: float | None = None, moved: float = 0.0,
) -> ArticleRow:  # fmt: skip
    """An efficiency in %; the difference has the Monte Carlo errors of both, `sigma` of ours."""
    ours = sigma if monte_carlo is None else monte_carlo
    return compare(
        p.EFFICIENCY_SECTION, f"{what}, {'pol.' if polarised else 'unpol.'}", paper,
        100 * point.eta, sigma=100 * sigma, rounding=100 * moved,
        difference_sigma=100 * math.hypot(ours, article_monte_carlo_sigma(point.eta)),
    )  # fmt: skip


def _shape_rows(simulated: Simulated) -> list[ArticleRow]:
    alpha_abs = p.NOMINAL.alpha_abs_per_cm.value
    air, gel = simulated.pair(True)
    points = air.at(p.ALPHA_SCAT.value, alpha_abs), gel.at(p.ALPHA_SCAT.value, alpha_abs)
    ratio = points[0].eta / points[1].eta
    relative = math.hypot(*(point.sigma / point.eta for point in points))
    rows = [compare(
        p.EFFICIENCY_SECTION, "R at the article's (0.039, 0.54) /cm, pol.", p.RATIO, ratio,
        sigma=ratio * relative, difference_sigma=math.hypot(
            ratio * relative,
            ratio * math.hypot(*(article_monte_carlo_sigma(q.eta) / q.eta for q in points)),
        ),
    )]  # fmt: skip
    position, sigma = position_of_maximum(gel.surface, alpha_abs)
    rows.append(compare(
        p.EFFICIENCY_SECTION, "maximum of the gel curve, Sec. 6.2", p.GEL_MAXIMUM, position,
        sigma=sigma, remark="at T = 96 %; its place moves with the absorption (Fig. 3)",
    ))  # fmt: skip
    for low, high in ((0.1, p.FLAT_ABOVE.value), (p.FLAT_ABOVE.value, p.SCANNED_TO.value)):
        growth, sigma = _growth_percent(air.surface, low, high, alpha_abs)
        rows.append(compare(
            p.EFFICIENCY_SECTION, f"eta_air grows from {low:g} to {high:g} /cm by", None, growth,
            sigma=sigma, unit="%",
            remark='the article: "little change" above 0.5 /cm'
            if low == p.FLAT_ABOVE.value else "",
        ))  # fmt: skip
    return rows


def _growth_percent(
    surface: EfficiencySurface, low: float, high: float, alpha_abs: float
) -> tuple[float, float]:
    """Growth of an efficiency between two alpha_scat, %, and its Monte Carlo error."""
    first, last = surface.evaluate(low, alpha_abs), surface.evaluate(high, alpha_abs)
    common = surface.covariance(
        {ALPHA_SCAT: low, ALPHA_ABS: alpha_abs}, {ALPHA_SCAT: high, ALPHA_ABS: alpha_abs}
    )
    variance = (
        (first.sigma / first.eta) ** 2
        + (last.sigma / last.eta) ** 2
        - 2 * common / (first.eta * last.eta)
    )
    ratio = last.eta / first.eta
    return 100 * (ratio - 1), 100 * ratio * math.sqrt(variance)


def other_crystal_rows(simulated: Simulated) -> list[ArticleRow]:
    """The thin sample, CaWO4 and the wrapped cube."""
    quoted, moved = from_printed(
        lambda s, q: 100 * s / q, p.CAWO4_QUOTED_SIGNAL, p.CAWO4_QUOTED_QUANTUM_EFFICIENCY
    )
    wrapped = simulated.wrapped[DEFAULT_WRAP_REFLECTANCE]
    spread = " and ".join(
        f"{100 * result.eta:.1f} % at {reflectance:g}"
        for reflectance, result in simulated.wrapped.items()
        if reflectance != DEFAULT_WRAP_REFLECTANCE
    )
    return [
        _crystal("thin CaMoO4, 1 mm, gel, Sec. 6.2", p.THIN_ETA, simulated.thin, None,
                 "with 0.54 and 0.039 /cm, for the article states no others; without absorption "
                 f"{100 * simulated.thin_clear.eta:.1f} %"),
        compare(p.OTHER_CRYSTALS, "CaWO4 of [20]: 3.8/0.25, Sec. 6.2", p.CAWO4_QUOTED_ETA,
                quoted, rounding=moved),
        _crystal("CaWO4, air, Sec. 6.4", p.CAWO4_ETA, simulated.cawo4, None,
                 "its size and index are not given: a 10 mm cube with n = 1.92 is taken"),
        _crystal("CaMoO4 cube, wrapped, gel, Sec. 6.5", p.WRAPPED_ETA, wrapped,
                 100 * wrapped_spread(simulated),
                 f"five faces behind an air film, Lambertian, reflectance "
                 f"{DEFAULT_WRAP_REFLECTANCE:g}; {spread}: the article does not say how it wraps"),
    ]  # fmt: skip


def _crystal(
    what: str, paper: Printed, result: SimulationResult, systematic: float | None, remark: str
) -> ArticleRow:
    sigma = 100 * result.eta_sigma
    return compare(
        p.OTHER_CRYSTALS, f"eta of {what}", paper, 100 * result.eta, sigma=sigma,
        systematic=systematic, remark=remark,
        difference_sigma=math.hypot(
            sigma, systematic or 0.0, 100 * article_monte_carlo_sigma(result.eta)
        ),
    )  # fmt: skip


def wrapped_spread(simulated: Simulated) -> float:
    """Half the spread of the wrapped cube's efficiency over the reflectances of Teflon tape."""
    etas = [result.eta for result in simulated.wrapped.values()]
    return (max(etas) - min(etas)) / 2
