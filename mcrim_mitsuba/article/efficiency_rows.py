"""The article's simulated numbers beside ours: bare crystals, Table 1, other crystals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.arithmetic import escape_per_face
from mcrim_mitsuba.article.published import ArticleRow, Printed, compare, from_printed
from mcrim_mitsuba.article.simulated import (
    COUPLINGS,
    DEFAULT_WRAP_REFLECTANCE,
    GEL,
    Simulated,
    SimulatedLine,
)
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.inference.corrections import Quantities
from mcrim_mitsuba.inference.estimates import spread
from mcrim_mitsuba.optics.fresnel import trapped_fraction

#: Points, 1/cm, and degree of the polynomial in log(alpha_scat) that finds the gel curve's
#: maximum. The curve is skew: a parabola is 0.003 off, this cubic 0.0003 (zero of the gradient).
PEAK_POINTS_PER_CM = (0.2, 0.253, 0.32, 0.405, 0.513, 0.65)
_PEAK_DEGREE = 3


def article_monte_carlo_sigma(eta: float) -> float:
    """Binomial standard error of an efficiency from the article's 100,000 rays."""
    return math.sqrt(eta * (1.0 - eta) / p.RAYS.value)


def _relative_sigma_of_ratio(etas: Iterable[float]) -> float:
    """Binomial standard error of the ratio of two efficiencies of the article, as a part of it.

    They are independent: what ZEMAX's splitting of rays may gain is not known.
    """
    return math.hypot(*(article_monte_carlo_sigma(eta) / eta for eta in etas))


def _growth(first: Quantities, last: Quantities) -> tuple[Array, Array]:
    """Last over first quantities, and their relative Monte Carlo errors.

    Both come from the same photons, whose batches are compared.
    """
    batches = last.batches / last.values - first.batches / first.values
    return last.values / first.values, spread(batches)


def largest_eta_deviation(lines: Sequence[SimulatedLine]) -> float:
    """Largest relative deviation of eta from the nominal transmittance's, over Table 1.

    The rule that gives the article's ±12 % from its own table.
    """
    nominal = next(line for line in lines if line.printed == p.NOMINAL)
    return max(float(np.abs(line.etas / nominal.etas - 1).max()) for line in lines)


def position_of_maximum(points: Sequence[Quantities], place: int) -> tuple[float, float]:
    """alpha_scat at which a quantity is largest, 1/cm, and its Monte Carlo error.

    The maximum of a least-squares cubic in log(alpha_scat) through `PEAK_POINTS_PER_CM`. They come
    from the same photons, each batch of which has a maximum of its own, to first order.

    Raises ValueError if the cubic has no maximum between the outermost points.
    """
    x = np.log(PEAK_POINTS_PER_CM)
    solve = np.linalg.pinv(np.vander(x, _PEAK_DEGREE + 1, increasing=True))
    curve = np.polynomial.Polynomial(solve @ [point.values[place] for point in points])
    slope, bend = curve.deriv(), curve.deriv(2)
    inside = [
        float(root.real)
        for root in slope.roots()
        if abs(root.imag) < 1e-12 and x[0] < root.real < x[-1] and bend(root.real) < 0
    ]
    if len(inside) != 1:
        raise ValueError(f"the efficiency has {len(inside)} maxima between the points")
    (peak,) = inside
    # by its slope there over the bend every batch moves the maximum
    of_batches = solve @ [point.batches[:, place] for point in points]
    slopes = [float(np.polynomial.Polynomial(batch).deriv()(peak)) for batch in of_batches.T]
    position = math.exp(peak)
    return position, position * float(spread(np.array(slopes) / bend(peak)))


# The article's simulated numbers beside ours.

_WORD = {True: "polarised", False: "unpolarised"}
_SHORT = {True: "pol.", False: "unpol."}
_ETAS = ("eta_air", "eta_gel")


def bare_crystal_rows(simulated: Simulated) -> Iterator[ArticleRow]:
    """Eq. 6 by Mitsuba: all light that leaves a crystal without losses, over its six faces."""
    faces = (p.ETA_FACE_AIR, p.ETA_FACE_GEL)
    for (n, result), paper in zip(simulated.bare.items(), faces, strict=True):
        face = 100 * (1 - result.budget["truncated"]) / 6
        sigma = 100 * result.budget_sigma["truncated"] / 6
        exact = 100 * escape_per_face(n)
        remark = f"closed form of this geometry {exact:.3f} %, {_distance(face, exact, sigma)}"
        if n < math.sqrt(2):
            twice = "the six escape cones overlap, and Eq. 6 counts the light in two of them twice"
            remark += f"; below n = sqrt(2) {twice}"
        of_both = math.hypot(sigma, p.ZEMAX_FACE_RELATIVE_ERROR * paper.value)
        remark += "; the article's own limit of 1 % enters the verdict"
        what = f"one face, n = {n:.4g}, by Mitsuba"
        yield compare(what, paper, face, sigma=sigma, difference_sigma=of_both, remark=remark)
    result = simulated.bare[p.N_CRYSTAL.value]
    trapped, sigma = 100 * result.budget["truncated"], 100 * result.budget_sigma["truncated"]
    distance = _distance(trapped, float(100 * trapped_fraction(p.N_CRYSTAL.value)), sigma)
    what, remark = "trapped for ever, n = 2.01, by Mitsuba", f"{distance} from the closed form"
    yield compare(what, None, trapped, sigma=sigma, unit="%", remark=remark)


def _distance(ours: float, exact: float, sigma: float) -> str:
    return f"{(ours - exact) / sigma:+.1f} of our standard errors"


def bench_rows(simulated: Simulated, photons: int) -> Iterator[ArticleRow]:
    """The scene's parameters beside the article's description."""
    bench, cawo4 = simulated.parameters, simulated.cawo4.parameters
    aperture_mm = 2.0 * float(bench["aperture_radius_mm"])
    stated = (
        ("crystal width", p.CRYSTAL_MM, bench["crystal_width_mm"]),
        ("crystal height", p.CRYSTAL_MM, bench["crystal_height_mm"]),
        ("index of the crystal", p.N_CRYSTAL, bench["n_crystal"]),
        ("gap", p.GAP_MM, bench["gap_mm"]),
        ("index of the gap, empty", p.N_AIR, bench["n_gap"]),
        ("window width", p.WINDOW_WIDTH_MM, bench["window_width_mm"]),
        ("window thickness", p.WINDOW_THICKNESS_MM, bench["window_thickness_mm"]),
        ("index of the window", p.N_WINDOW, bench["n_window"]),
        ("diameter of the aperture", p.APERTURE_DIAMETER_MM, aperture_mm),
        ("index of the gap, gel", p.N_GEL, COUPLINGS[GEL]),
        ("alpha_abs of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_ABS, cawo4[ALPHA_ABS]),
        ("alpha_scat of CaWO4, Sec. 6.4", p.CAWO4_ALPHA_SCAT, cawo4[ALPHA_SCAT]),
    )
    yield from (compare(what, number, float(ours)) for what, number, ours in stated)
    what, remark = "source smaller than", "ours fills the crystal: there is no surface to keep off"
    yield compare(f"{what} the crystal by", p.SOURCE_MARGIN_MM, 0.0, judged=False, remark=remark)
    of_rays = f"{100 * article_monte_carlo_sigma(0.25):.2f} % (of all light)"
    remark = f"100,000 rays alone leave an error of {of_rays} on an efficiency of 25 %"
    what = "rays per point; ours: per curve"
    yield compare(what, p.RAYS, photons, judged=False, remark=remark)


def table_1_rows(simulated: Simulated) -> Iterator[ArticleRow]:
    """alpha_scat where the simulated ratio is the measured one."""
    for line in simulated.lines:
        ours, printed = line.alpha_scat, line.printed
        statistical, monte_carlo = (ours.contributions[n] for n in ("statistical", "monte_carlo"))
        of_rays = p.RATIO.value * _relative_sigma_of_ratio(line.etas) / abs(line.ratio_slope_cm)
        of_both = math.hypot(monte_carlo, of_rays)
        what = f"alpha_scat, T = {printed.transmittance_percent.text} %, {_WORD[line.polarised]}"
        paper = p.ALPHA_SCAT if printed == p.NOMINAL else printed.alpha_scat_per_cm
        remark = (
            f"{ours.value:.3f} ± {statistical:.3f} (from R) ± {monte_carlo:.3f} (Monte "
            f"Carlo); the article's rays leave ±{of_rays:.3f} on its own"
        )
        yield compare(
            what, paper, ours.value, sigma=ours.sigma, difference_sigma=of_both, remark=remark
        )
    ours = simulated.nominal.alpha_scat
    of_ratio = ours.contributions["statistical"]
    # its own Monte Carlo error is that of the slope of R, between the ends of the interval
    assert ours.lower is not None and ours.upper is not None  # profiled
    ends = (simulated.nominal.at(end) for end in (ours.lower, ours.upper))
    (*_, grown), (*_, relative) = _growth(*ends)
    what = "error of alpha_scat from that of R, Sec. 6.2"
    paper = p.printed("0.10", "Sec. 6.2", "1/cm")
    sigma = of_ratio * relative / abs(math.log(grown))
    rounding = of_ratio * p.RATIO.rounding / p.RATIO.stated_sigma
    remark = f"R ± 0.012 gives {ours.lower:.2f} to {ours.upper:.2f} /cm: not quite symmetric"
    yield compare(what, paper, of_ratio, sigma=sigma, rounding=rounding, remark=remark)


def efficiency_rows(simulated: Simulated) -> Iterator[ArticleRow]:
    """Efficiencies at our coefficients and at the article's, and the shape of the curves."""
    for line in simulated.lines:
        percent, way = line.printed.transmittance_percent, _SHORT[line.polarised]
        etas = zip(_ETAS, line.printed.etas_percent, line.etas, *line.eta_sigmas, strict=True)
        for name, paper, eta, of_ratio, monte_carlo in etas:
            what = f"{name}, T = {percent.text} %, at our fit, {way}"
            yield _eta_row(what, paper, eta, monte_carlo, of_ratio=of_ratio)
    for line in simulated.lines:
        scattering = line.printed.alpha_scat_per_cm
        absorption, way = line.printed.alpha_abs_per_cm, _SHORT[line.polarised]
        sigmas = line.at(scattering.value).sigmas
        for place, (name, paper) in enumerate(zip(_ETAS, line.printed.etas_percent, strict=True)):
            eta = from_printed(
                lambda *at, c=line.couplings, i=place: c.at(*at).values[i], scattering, absorption
            )
            what = f"{name} at ({absorption.text}, {scattering.text}) /cm, {way}"
            yield _eta_row(what, paper, eta.value, sigmas[place], moved=eta.rounding)
    yield from _shape_rows(simulated.nominal)


def _eta_row(
    what: str,
    paper: Printed,
    eta: float,
    monte_carlo: float,
    *,
    of_ratio: float = 0.0,
    moved: float = 0.0,
    systematic: float = 0.0,
    remark: str = "",
) -> ArticleRow:
    """An efficiency in %; the error `of_ratio` is the article's own, too."""
    return compare(
        what,
        paper,
        100 * eta,
        sigma=100 * math.hypot(of_ratio, monte_carlo),
        systematic=100 * systematic or None,
        rounding=100 * moved,
        difference_sigma=100 * math.hypot(monte_carlo, systematic, article_monte_carlo_sigma(eta)),
        remark=remark,
    )


def _shape_rows(line: SimulatedLine) -> Iterator[ArticleRow]:
    point = line.at(p.ALPHA_SCAT.value)
    *etas, ratio = point.values
    sigma = float(point.sigmas[2])
    of_both = math.hypot(sigma, ratio * _relative_sigma_of_ratio(etas))
    position, position_sigma = position_of_maximum([line.at(a) for a in PEAK_POINTS_PER_CM], 1)
    what = "R at the article's (0.039, 0.54) /cm, pol."
    yield compare(what, p.RATIO, ratio, sigma=sigma, difference_sigma=of_both)
    what, paper = "maximum of the gel curve, Sec. 6.2", p.GEL_MAXIMUM
    remark = "at T = 96 %; its place moves with the absorption (Fig. 3)"
    yield compare(what, paper, position, sigma=position_sigma, remark=remark)
    flat = p.FLAT_ABOVE.value
    for low, high in ((0.1, flat), (flat, p.SCANNED_TO.value)):
        (grown, *_), (relative, *_) = _growth(line.at(low), line.at(high))
        what = f"eta_air grows from {low:g} to {high:g} /cm by"
        remark = 'the article: "little change" above 0.5 /cm' if low == flat else ""
        percent, of_batches = 100 * (grown - 1), 100 * grown * relative
        yield compare(what, None, percent, sigma=of_batches, unit="%", remark=remark)


def other_crystal_rows(simulated: Simulated) -> Iterator[ArticleRow]:
    """The thin sample, CaWO4 and the wrapped cube."""
    inputs = p.CAWO4_QUOTED_SIGNAL, p.CAWO4_QUOTED_QUANTUM_EFFICIENCY
    quoted = from_printed(lambda s, q: 100 * s / q, *inputs)
    wrapped = simulated.wrapped[DEFAULT_WRAP_REFLECTANCE]
    spread = " and ".join(
        f"{100 * result.eta:.1f} % at {reflectance:g}"
        for reflectance, result in simulated.wrapped.items()
        if reflectance != DEFAULT_WRAP_REFLECTANCE
    )
    thin, cawo4 = simulated.thin, simulated.cawo4
    clear = f"without absorption {100 * simulated.thin_clear.eta:.1f} %"
    remark = f"with 0.54 and 0.039 /cm, for the article states no others; {clear}"
    what = "eta of thin CaMoO4, 1 mm, gel, Sec. 6.2"
    yield _eta_row(what, p.THIN_ETA, thin.eta, thin.eta_sigma, remark=remark)
    yield compare("CaWO4 of [20]: 3.8/0.25, Sec. 6.2", p.CAWO4_QUOTED_ETA, quoted)
    what = "eta of CaWO4, air, Sec. 6.4"
    remark = "its size and index are not given: a 10 mm cube with n = 1.92 is taken"
    yield _eta_row(what, p.CAWO4_ETA, cawo4.eta, cawo4.eta_sigma, remark=remark)
    film = f"five faces behind an air film, Lambertian, reflectance {DEFAULT_WRAP_REFLECTANCE:g}"
    remark = f"{film}; {spread}: the article does not say how it wraps"
    what, sizes = "eta of CaMoO4 cube, wrapped, gel, Sec. 6.5", (wrapped.eta, wrapped.eta_sigma)
    yield _eta_row(what, p.WRAPPED_ETA, *sizes, systematic=wrapped_spread(simulated), remark=remark)


def wrapped_spread(simulated: Simulated) -> float:
    """Half the spread of the wrapped cube's efficiency over the reflectances of Teflon tape."""
    etas = [result.eta for result in simulated.wrapped.values()]
    return (max(etas) - min(etas)) / 2
