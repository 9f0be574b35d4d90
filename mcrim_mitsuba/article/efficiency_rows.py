"""The article's simulated numbers beside ours: bare crystals, Table 1, other crystals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.arithmetic import escape_per_face
from mcrim_mitsuba.article.published import ArticleRow, Printed, Table1Line, compare, from_printed
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
PEAK_POINTS_PER_CM = (0.2, 0.253, 0.32, 0.405, 0.513, 0.65)
_PEAK_DEGREE = 3


@dataclass(frozen=True, kw_only=True)
class FittedLine:
    """A line of Table 1 as simulated here."""

    #: The article's, whose T and alpha_abs are taken over.
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
        relative = _relative_sigma_of_ratio(self.air, self.gel)
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
    return math.sqrt(eta * (1.0 - eta) / p.RAYS.value)


def _relative_sigma_of_ratio(*points: EtaPoint) -> float:
    """Binomial standard error of the ratio of two efficiencies of the article, as a part of it."""
    return math.hypot(*(article_monte_carlo_sigma(point.eta) / point.eta for point in points))


def fit_line(curve: RatioCurve) -> FittedLine:
    """Solve eta_air / eta_gel = R for alpha_scat at one transmittance of Table 1."""
    alpha_abs = curve.line.alpha_abs_per_cm.value
    couplings = curve.air.coupling, curve.gel.coupling
    of_air, of_gel = (coupling.surface for coupling in couplings)
    solution = alpha_scat_from_ratio(
        of_air, of_gel, alpha_abs, p.RATIO.value, p.RATIO.stated_sigma, _BOUNDS_PER_CM
    )
    air, gel = (coupling.at(solution.value, alpha_abs) for coupling in couplings)
    return FittedLine(
        line=curve.line,
        polarised=curve.polarised,
        solution=solution,
        air=air,
        gel=gel,
        monte_carlo_of_sigma=_monte_carlo_of_sigma(curve, solution),
    )


def _monte_carlo_of_sigma(curve: RatioCurve, solution: RatioSolution) -> float:
    """Monte Carlo error of ``statistical_sigma``, which is that of the slope of R.

    The slope is taken between the ends of the interval.
    """
    ends = (
        solution.lower or solution.value - solution.statistical_sigma,
        solution.upper or solution.value + solution.statistical_sigma,
    )
    alpha_abs = curve.line.alpha_abs_per_cm.value
    (air, air_variance), (gel, gel_variance) = (
        _growth(side.coupling.surface, *ends, alpha_abs) for side in (curve.air, curve.gel)
    )
    spread = math.sqrt(max(air_variance + gel_variance, 0.0))
    return solution.statistical_sigma * spread / abs(math.log(air / gel))


def _growth(
    surface: EfficiencySurface, low: float, high: float, alpha_abs: float
) -> tuple[float, float]:
    """Ratio of the efficiencies at two alpha_scat, and its relative Monte Carlo variance.

    Both come from the same photons: their covariance enters.
    """
    first, last = surface.evaluate(low, alpha_abs), surface.evaluate(high, alpha_abs)
    common = surface.covariance(
        {ALPHA_SCAT: low, ALPHA_ABS: alpha_abs}, {ALPHA_SCAT: high, ALPHA_ABS: alpha_abs}
    )
    variance = (
        (first.sigma / first.eta) ** 2
        + (last.sigma / last.eta) ** 2
        - 2 * common / (first.eta * last.eta)
    )
    return last.eta / first.eta, variance


def fit_table_1(curves: Iterable[RatioCurve]) -> Fits:
    """All lines of Table 1, by whether polarisation was followed."""
    fits = [fit_line(curve) for curve in curves]
    return {
        polarised: [fit for fit in fits if fit.polarised is polarised]
        for polarised in (True, False)
    }


#: Lines of Table 1, by whether polarisation was followed.
Fits = Mapping[bool, Sequence[FittedLine]]


def nominal_of(lines: Sequence[FittedLine]) -> FittedLine:
    """The line of the nominal transmittance."""
    return next(fit for fit in lines if fit.line == p.NOMINAL)


def largest_eta_deviation(fitted: Sequence[FittedLine]) -> float:
    """Largest relative deviation of eta from the nominal transmittance's, over Table 1.

    The rule that gives the article's ±12 % from its own table.
    """
    nominal = nominal_of(fitted)
    return max(
        max(abs(fit.air.eta / nominal.air.eta - 1), abs(fit.gel.eta / nominal.gel.eta - 1))
        for fit in fitted
    )


def at_printed_point(coupling: Coupling, line: Table1Line) -> tuple[EtaPoint, float]:
    """Efficiency at the article's own coefficients, and what their rounding may move it by."""
    printed = {ALPHA_SCAT: line.alpha_scat_per_cm, ALPHA_ABS: line.alpha_abs_per_cm}
    point = coupling.at(*(number.value for number in printed.values()))
    return point, sum(abs(point.gradient[name]) * n.rounding for name, n in printed.items())


def position_of_maximum(surface: EfficiencySurface, alpha_abs_per_cm: float) -> tuple[float, float]:
    """alpha_scat at which an efficiency is largest, 1/cm, and its Monte Carlo error.

    The maximum of a least-squares cubic in log(alpha_scat) through six points. They come
    from the same photons; their covariances, which the surface gives, are propagated through
    the least squares to the position.

    Raises ValueError if the cubic has no maximum between the outermost points.
    """
    x = np.log(PEAK_POINTS_PER_CM)
    points = [{ALPHA_SCAT: a, ALPHA_ABS: alpha_abs_per_cm} for a in PEAK_POINTS_PER_CM]
    eta = np.array([surface.evaluate(a, alpha_abs_per_cm).eta for a in PEAK_POINTS_PER_CM])
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


# The article's simulated numbers beside ours.

_WORD = {True: "polarised", False: "unpolarised"}
_SHORT = {True: "pol.", False: "unpol."}
_ETAS = ("eta_air", "eta_gel")


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
        rows.append(
            compare(
                f"one face, n = {n:.4g}, by Mitsuba",
                paper,
                face,
                sigma=sigma,
                difference_sigma=math.hypot(sigma, p.ZEMAX_FACE_RELATIVE_ERROR * paper.value),
                remark=f"{remark}; the article's own limit of 1 % enters the verdict",
            )
        )
    result = simulated.bare[p.N_CRYSTAL.value]
    trapped, sigma = 100 * result.budget["truncated"], 100 * result.budget_sigma["truncated"]
    distance = _distance(trapped, float(100 * trapped_fraction(p.N_CRYSTAL.value)), sigma)
    what, remark = "trapped for ever, n = 2.01, by Mitsuba", f"{distance} from the closed form"
    return [*rows, compare(what, None, trapped, sigma=sigma, unit="%", remark=remark)]


def _distance(ours: float, exact: float, sigma: float) -> str:
    return f"{(ours - exact) / sigma:+.1f} of our standard errors"


def bench_rows(simulated: Simulated, photons: int) -> list[ArticleRow]:
    """The scene's parameters beside the article's description."""
    bench, cawo4 = simulated.parameters, simulated.cawo4.parameters
    stated = (
        ("crystal width", p.CRYSTAL_MM, bench["crystal_width_mm"]),
        ("crystal height", p.CRYSTAL_MM, bench["crystal_height_mm"]),
        ("index of the crystal", p.N_CRYSTAL, bench["n_crystal"]),
        ("gap", p.GAP_MM, bench["gap_mm"]),
        ("index of the gap, empty", p.N_AIR, bench["n_gap"]),
        ("window width", p.WINDOW_WIDTH_MM, bench["window_width_mm"]),
        ("window thickness", p.WINDOW_THICKNESS_MM, bench["window_thickness_mm"]),
        ("index of the window", p.N_WINDOW, bench["n_window"]),
        (
            "diameter of the aperture",
            p.APERTURE_DIAMETER_MM,
            2.0 * float(bench["aperture_radius_mm"]),
        ),
        ("index of the gap, gel", p.N_GEL, simulated.couplings[GEL, True].n_gap),
        ("alpha_abs of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_ABS, cawo4[ALPHA_ABS]),
        ("alpha_scat of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_SCAT, cawo4[ALPHA_SCAT]),
    )
    return [
        *(compare(what, number, float(ours)) for what, number, ours in stated),
        compare(
            "source smaller than the crystal by",
            p.SOURCE_MARGIN_MM,
            0.0,
            judged=False,
            remark="ours fills the crystal: there is no surface to keep off",
        ),
        compare(
            "rays per point; ours: per curve",
            p.RAYS,
            photons,
            judged=False,
            remark="100,000 rays alone leave an error of "
            f"{100 * article_monte_carlo_sigma(0.25):.2f} % (of all light) on an efficiency "
            "of 25 %",
        ),
    ]


def table_1_rows(fits: Fits) -> list[ArticleRow]:
    """alpha_scat where the simulated ratio is the measured one."""
    rows = []
    for fit in (fit for lines in fits.values() for fit in lines):
        ours, article_sigma = fit.solution, fit.article_monte_carlo_sigma
        rows.append(
            compare(
                f"alpha_scat, T = {fit.line.transmittance_percent.text} %, {_WORD[fit.polarised]}",
                p.ALPHA_SCAT if fit.line == p.NOMINAL else fit.line.alpha_scat_per_cm,
                ours.value,
                sigma=math.hypot(ours.statistical_sigma, ours.monte_carlo_sigma),
                difference_sigma=math.hypot(ours.monte_carlo_sigma, article_sigma),
                remark=f"{ours.value:.3f} ± {ours.statistical_sigma:.3f} (from R) ± "
                f"{ours.monte_carlo_sigma:.3f} (Monte Carlo); the article's rays leave "
                f"±{article_sigma:.3f} on its own",
            )
        )
    nominal = nominal_of(fits[True])
    ours, interval = nominal.solution, ""
    if ours.lower is not None and ours.upper is not None:
        interval = f"R ± 0.012 gives {ours.lower:.2f} to {ours.upper:.2f} /cm: not quite symmetric"
    rows.append(
        compare(
            "error of alpha_scat from that of R, Sec. 6.2",
            p.printed("0.10", "Sec. 6.2", "1/cm"),
            ours.statistical_sigma,
            sigma=nominal.monte_carlo_of_sigma,
            rounding=ours.statistical_sigma * p.RATIO.rounding / p.RATIO.stated_sigma,
            remark=interval,
        )
    )
    return rows


def efficiency_rows(simulated: Simulated, fits: Fits) -> list[ArticleRow]:
    """Efficiencies at our coefficients and at the article's, and the shape of the curves."""
    rows = []
    for fit in (fit for lines in fits.values() for fit in lines):
        what = f"T = {fit.line.transmittance_percent.text} %, at our fit, {_SHORT[fit.polarised]}"
        for name, paper, point in zip(
            _ETAS, fit.line.etas_percent, (fit.air, fit.gel), strict=True
        ):
            from_ratio, monte_carlo = fit.eta_sigma(point)
            sigma = math.hypot(from_ratio, monte_carlo)
            rows.append(_eta_row(f"{name}, {what}", paper, point, sigma, monte_carlo))
    for polarised, line in itertools.product((True, False), p.TABLE_1):
        at = f"({line.alpha_abs_per_cm.text}, {line.alpha_scat_per_cm.text}) /cm"
        for name, paper, coupling in zip(
            _ETAS, line.etas_percent, simulated.pair(polarised), strict=True
        ):
            point, moved = at_printed_point(coupling, line)
            what = f"{name} at {at}, {_SHORT[polarised]}"
            rows.append(_eta_row(what, paper, point, point.sigma, point.sigma, moved))
    return rows + _shape_rows(simulated)


def _eta_row(
    what: str,
    paper: Printed,
    point: EtaPoint,
    sigma: float,
    monte_carlo: float,
    moved: float = 0.0,
) -> ArticleRow:
    """An efficiency in %; its whole error is `sigma`, of which `monte_carlo` is not shared."""
    return compare(
        what,
        paper,
        100 * point.eta,
        sigma=100 * sigma,
        rounding=100 * moved,
        difference_sigma=100 * math.hypot(monte_carlo, article_monte_carlo_sigma(point.eta)),
    )


def _shape_rows(simulated: Simulated) -> list[ArticleRow]:
    alpha_abs = p.NOMINAL.alpha_abs_per_cm.value
    air, gel = simulated.pair(True)
    points = air.at(p.ALPHA_SCAT.value, alpha_abs), gel.at(p.ALPHA_SCAT.value, alpha_abs)
    ratio = points[0].eta / points[1].eta
    sigma = ratio * math.hypot(*(point.sigma / point.eta for point in points))
    theirs = ratio * _relative_sigma_of_ratio(*points)
    position, position_sigma = position_of_maximum(gel.surface, alpha_abs)
    rows = [
        compare(
            "R at the article's (0.039, 0.54) /cm, pol.",
            p.RATIO,
            ratio,
            sigma=sigma,
            difference_sigma=math.hypot(sigma, theirs),
        ),
        compare(
            "maximum of the gel curve, Sec. 6.2",
            p.GEL_MAXIMUM,
            position,
            sigma=position_sigma,
            remark="at T = 96 %; its place moves with the absorption (Fig. 3)",
        ),
    ]
    flat = p.FLAT_ABOVE.value
    for low, high in ((0.1, flat), (flat, p.SCANNED_TO.value)):
        grown, variance = _growth(air.surface, low, high, alpha_abs)
        rows.append(
            compare(
                f"eta_air grows from {low:g} to {high:g} /cm by",
                None,
                100 * (grown - 1),
                sigma=100 * grown * math.sqrt(variance),
                unit="%",
                remark='the article: "little change" above 0.5 /cm' if low == flat else "",
            )
        )
    return rows


def other_crystal_rows(simulated: Simulated) -> list[ArticleRow]:
    """The thin sample, CaWO4 and the wrapped cube."""
    quoted = from_printed(
        lambda s, q: 100 * s / q, p.CAWO4_QUOTED_SIGNAL, p.CAWO4_QUOTED_QUANTUM_EFFICIENCY
    )
    wrapped = simulated.wrapped[DEFAULT_WRAP_REFLECTANCE]
    spread = " and ".join(
        f"{100 * result.eta:.1f} % at {reflectance:g}"
        for reflectance, result in simulated.wrapped.items()
        if reflectance != DEFAULT_WRAP_REFLECTANCE
    )
    return [
        _crystal(
            "thin CaMoO4, 1 mm, gel, Sec. 6.2",
            p.THIN_ETA,
            simulated.thin,
            None,
            "with 0.54 and 0.039 /cm, for the article states no others; without absorption "
            f"{100 * simulated.thin_clear.eta:.1f} %",
        ),
        compare("CaWO4 of [20]: 3.8/0.25, Sec. 6.2", p.CAWO4_QUOTED_ETA, quoted),
        _crystal(
            "CaWO4, air, Sec. 6.4",
            p.CAWO4_ETA,
            simulated.cawo4,
            None,
            "its size and index are not given: a 10 mm cube with n = 1.92 is taken",
        ),
        _crystal(
            "CaMoO4 cube, wrapped, gel, Sec. 6.5",
            p.WRAPPED_ETA,
            wrapped,
            100 * wrapped_spread(simulated),
            f"five faces behind an air film, Lambertian, reflectance "
            f"{DEFAULT_WRAP_REFLECTANCE:g}; {spread}: the article does not say how it wraps",
        ),
    ]


def _crystal(
    what: str, paper: Printed, result: SimulationResult, systematic: float | None, remark: str
) -> ArticleRow:
    sigma, theirs = 100 * result.eta_sigma, 100 * article_monte_carlo_sigma(result.eta)
    return compare(
        f"eta of {what}",
        paper,
        100 * result.eta,
        sigma=sigma,
        systematic=systematic,
        difference_sigma=math.hypot(sigma, systematic or 0.0, theirs),
        remark=remark,
    )


def wrapped_spread(simulated: Simulated) -> float:
    """Half the spread of the wrapped cube's efficiency over the reflectances of Teflon tape."""
    etas = [result.eta for result in simulated.wrapped.values()]
    return (max(etas) - min(etas)) / 2
