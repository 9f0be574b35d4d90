"""What follows from the article's printed numbers alone, and where they contradict each other."""

from __future__ import annotations

import math
from collections.abc import Iterator

from scipy.optimize import brentq

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import ArticleRow, Printed, compare, from_printed
from mcrim_mitsuba.article.simulated import DEFAULT_WRAP_REFLECTANCE, Simulated
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.laboratory.error_budget import Uncertain, quotient
from mcrim_mitsuba.laboratory.light_yield import light_yield_by_reference, light_yield_ph_per_keV
from mcrim_mitsuba.laboratory.peak import GAUSSIAN, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.optics import slab_transmittance as slab
from mcrim_mitsuba.optics.fresnel import escape_fraction, trapped_fraction


def _counted(signal: Printed, crystal: str) -> Uncertain:
    """A signal with its printed error, independent of those of other couplings and crystals."""
    return Uncertain(signal.value, statistical={f"counts, {crystal}": signal.stated_sigma})


#: The two signals, of air and gel.
SIGNALS = (_counted(p.SIGNAL_AIR, "air"), _counted(p.SIGNAL_GEL, "gel"))
CAWO4_SIGNAL = _counted(p.CAWO4_SIGNAL, "CaWO4")
CAWO4_YIELD = Uncertain(
    p.CAWO4_YIELD.value, systematic={"reference light yield": p.CAWO4_YIELD.stated_sigma}
)


def escape_per_face(n: float) -> float:
    """Fraction of isotropic light that leaves a bare polished box, per face, at any index.

    The escape cones about the three axes overlap where n < sqrt(2), and light in two cones
    leaves only once: Eq. 6 less 12 overlaps (three pairs of axes, four signs), shared by six
    faces. The overlap of two cones of half-angle r at right angles covers the solid angle
    2 (pi - arccos(-cot^2 r) - 2 cos r arccos(cot r)); three cones meet below sqrt(3/2) only.

    `n` is relative to the surroundings. Raises ValueError if it is below sqrt(3/2).
    """
    if n < math.sqrt(1.5):
        raise ValueError(f"three escape cones overlap at n = {n:g}: give at least 1.2248")
    if n >= math.sqrt(2.0):
        return float(escape_fraction(n))
    cos_r = math.sqrt(1.0 - 1.0 / n**2)
    cot_r = cos_r * n
    overlap = 2.0 * (math.pi - math.acos(-(cot_r**2)) - 2.0 * cos_r * math.acos(cot_r))
    return float(escape_fraction(n)) - 12.0 * overlap / (4.0 * math.pi) / 6.0


def article_ratio() -> Uncertain:
    """R of Eq. 5 from the two signals, with the error of the signals."""
    air, gel = SIGNALS
    return quotient(above=[("signal", air)], below=[("signal", gel)])


def _corrected(percent: float, n: float) -> Array:
    """A transmittance in % without the multiple reflections of the faces."""
    return 100 * slab.internal_transmittance(percent / 100, n)


def _alpha_abs(percent: Array | float, mm: float) -> Array | float:
    """Eq. 4: the absorption coefficient, 1/cm, of a transmittance in %."""
    return slab.absorption_coefficient(percent / 100, mm)


def transmittance_rows() -> Iterator[ArticleRow]:
    """Eq. 4 both ways, and the correction of Section 4."""
    for line in p.TABLE_1:
        percent, alpha = line.transmittance_percent, line.alpha_abs_per_cm
        nominal = line == p.NOMINAL
        what = f"alpha_abs from T = {percent.text} %, Eq. 4"
        of_t = from_printed(_alpha_abs, percent, p.CRYSTAL_MM)
        yield compare(what, alpha, of_t, inconsistent=nominal)
        what = f"T from alpha_abs = {alpha.text} /cm, Eq. 4"
        of_alpha = from_printed(lambda a, d: 100 * slab.transmittance(a, d), alpha, p.CRYSTAL_MM)
        yield compare(what, percent, of_alpha, inconsistent=nominal)
    measured = (p.MEASURED_TRANSMITTANCE, p.N_CRYSTAL)
    corrected = from_printed(_corrected, *measured)
    of_digits = f"the rounding of 76 % and 2.01 is worth ±{corrected.rounding:.1f} %"
    remark = f"all orders of reflection, added without interference; {of_digits}"
    what, paper = "T from the measured 76 %, Sec. 4", p.CORRECTED_TRANSMITTANCE
    yield compare(what, paper, corrected, inconsistent=True, remark=remark)
    what, paper = "alpha_abs from the measured 76 %, Sec. 4", p.NOMINAL.alpha_abs_per_cm
    ours = from_printed(lambda t, n, d: _alpha_abs(_corrected(t, n), d), *measured, p.CRYSTAL_MM)
    yield compare(what, paper, ours, inconsistent=True)


def bare_crystal_rows() -> Iterator[ArticleRow]:
    """Eq. 6 as a closed form."""
    indices = (p.N_CRYSTAL, p.N_GEL)
    face = from_printed(lambda n: 100 * escape_fraction(n), p.N_CRYSTAL)
    yield compare("one face, n = 2.01, Eq. 6", p.ETA_FACE_AIR, face)
    index = from_printed(lambda n, m: n / m, *indices)
    yield compare("relative index to gel, 2.01/1.46", p.RELATIVE_INDEX_GEL, index)
    face = from_printed(lambda n, m: 100 * escape_fraction(n / m), *indices)
    yield compare("one face, n = 2.01/1.46, Eq. 6", p.ETA_FACE_GEL, face)
    what, remark = "the stated n = 1.38, Eq. 6", "15.6 % needs the index before it was rounded"
    of_stated = 100 * escape_fraction(p.RELATIVE_INDEX_GEL.value)
    yield compare(f"one face, {what}", p.ETA_FACE_GEL, of_stated, inconsistent=True, remark=remark)
    trapped = 100 * trapped_fraction(p.N_CRYSTAL.value)
    yield compare("trapped for ever, n = 2.01, 1 - 6 faces", None, trapped, unit="%")


def ratio_rows() -> Iterator[ArticleRow]:
    """Eq. 5 from the two signals."""
    ratio = article_ratio()
    of_gel, of_air = (100 * n.stated_sigma / n.value for n in (p.SIGNAL_GEL, p.SIGNAL_AIR))
    yield compare(
        "R = 14.3/24.5, Eq. 5",
        p.RATIO,
        ratio.value,
        sigma=ratio.sigma,
        difference_sigma=0.0,
        rounding=from_printed(lambda a, g: a / g, p.SIGNAL_AIR, p.SIGNAL_GEL).rounding,
        remark=f"{ratio.value:.4f} ± {ratio.sigma:.4f}: the article cuts digits off "
        "where rounding gives 0.584 ± 0.013",
    )
    yield compare("relative error of N_gel, Sec. 6.3", p.SIGNAL_ERROR, of_gel)
    remark = "the article takes the larger one, 1.6 %, for both"
    yield compare("relative error of N_air", None, of_air, unit="%", remark=remark)


def light_yield_rows() -> Iterator[ArticleRow]:
    """Eqs. 1 and 2 with the article's own efficiencies, and its error budget."""
    air, gel = SIGNALS
    for name, signal, uncertain, eta, paper in (
        ("Y1 (air)", p.SIGNAL_AIR, air, p.NOMINAL.eta_air_percent, p.YIELD_AIR),
        ("Y2 (gel)", p.SIGNAL_GEL, gel, p.NOMINAL.eta_gel_percent, p.YIELD_GEL),
    ):
        ours = absolute_yield(uncertain, with_eta_error(eta.value / 100))
        printed = from_printed(
            lambda n, e, h, k: n / (e * h / 100 * k), signal, p.EFFICIENCY, eta, p.ENERGY_KEV
        )
        what, of_digits = f"{name}, the article's eta = {eta.text} %", printed.rounding
        covered = f"rounds to {ours.value:.1f}, which the rounding of {eta.text} % covers"
        remark = "" if round(ours.value, 1) == paper.value else covered
        yield compare(what, paper, ours, difference_sigma=0.0, rounding=of_digits, remark=remark)
    low, middle, high = (line.etas_percent for line in p.TABLE_1)
    spread = max(
        from_printed(lambda a, b: 100 * abs(a / b - 1), eta, nominal)
        for line in (low, high)
        for eta, nominal in zip(line, middle, strict=True)
    )
    remark = "largest deviation from the middle line: 28/25 and 48/43"
    yield compare("error of eta: spread of Table 1", p.ETA_ERROR, spread, remark=remark)
    total = from_printed(math.hypot, p.ETA_ERROR, p.EFFICIENCY_ERROR, p.SIGNAL_ERROR)
    yield compare("total error: 12, 10, 1.6 % in quadrature", p.TOTAL_ERROR, total)
    stated = p.printed(str(p.LIGHT_YIELD.sigma), "Sec. 6.3", "ph/keV")
    total = from_printed(lambda y, e: y * e / 100, p.LIGHT_YIELD, p.TOTAL_ERROR)
    yield compare("total error: 16 % of 7.5", stated, total)


def with_eta_error(eta: float) -> Uncertain:
    """A light collection efficiency with the article's ±12 %, a systematic error."""
    return Uncertain(eta, systematic={"eta": eta * p.ETA_ERROR.value / 100})


def efficiency(printed: Printed) -> Uncertain:
    """A detector efficiency with the article's ±10 %, a systematic error."""
    sigma = printed.value * p.EFFICIENCY_ERROR.value / 100
    return Uncertain(printed.value, systematic={"detector_efficiency": sigma})


def absolute_yield(signal: Uncertain, eta: Uncertain) -> Uncertain:
    """The light yield of CaMoO4 by Eqs. 1 and 2, ph/keV, from a signal of 59.5 keV gammas."""
    return light_yield_ph_per_keV(signal, eta, efficiency(p.EFFICIENCY), p.ENERGY_KEV.value)


def relative_yield(eta: Uncertain, cawo4_eta: Uncertain) -> Uncertain:
    """The light yield of CaMoO4 by Eq. 7, ph/keV, with all errors as the article takes them.

    They are independent. Arguments are the efficiencies of CaMoO4 and CaWO4 at the air gap.
    """
    ours = (SIGNALS[0], eta.own("CaMoO4"), efficiency(p.EFFICIENCY).own("CaMoO4"))
    theirs = (cawo4_eta.own("CaWO4"), efficiency(p.CAWO4_EFFICIENCY).own("CaWO4"))
    return light_yield_by_reference(*ours, CAWO4_SIGNAL, *theirs, CAWO4_YIELD)


def relative_rows() -> Iterator[ArticleRow]:
    """Eq. 7 with the article's own numbers, and the comparison that it warns of."""
    cawo4_eta = with_eta_error(p.CAWO4_ETA.value / 100)
    stated = relative_yield(with_eta_error(p.RELATIVE_ETA.value), cawo4_eta)
    of_table_1 = relative_yield(with_eta_error(p.NOMINAL.eta_air_percent.value / 100), cawo4_eta)
    # Eq. 7 once more, of the printed digits; _w is CaWO4, h a detector's efficiency
    of_cawo4 = (p.CAWO4_SIGNAL, p.CAWO4_ETA, p.CAWO4_EFFICIENCY, p.CAWO4_YIELD)
    printed = from_printed(
        lambda n, eta, h, n_w, eta_w, h_w, y_w: n * h_w * eta_w / 100 / (n_w * h * eta) * y_w,
        *(p.SIGNAL_AIR, p.RELATIVE_ETA, p.EFFICIENCY, *of_cawo4),
    )
    alone, paper, of_digits = _signals_alone(), p.RELATIVE_YIELD, printed.rounding
    what = "Y, stated eta = 0.23, Eq. 7"
    yield compare(what, paper, stated, difference_sigma=0.0, rounding=of_digits)
    yield compare("Y, Table 1's 25 %, Eq. 7", paper, of_table_1, inconsistent=True)
    error = p.printed("1.7", "Eq. 7", "ph/keV")
    remark = "12 % on each eta, 10 % on each efficiency, 9.9 % on the yield of CaWO4, counts"
    yield compare("error of Eq. 7", error, stated.sigma, remark=remark)
    what, paper = "equal collection: 14.3/40.1 x 16.2", p.SIMPLE_COMPARISON
    yield compare(what, paper, alone, inconsistent=True)
    what, ours = "with the efficiencies", alone * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value
    remark = "equal collection alone overrates the yield: 5.6 takes equal efficiencies as well"
    yield compare(what, paper, ours, inconsistent=True, remark=remark)


def _signals_alone() -> float:
    """Eq. 7 where light collection and detector efficiencies are the same, ph/keV."""
    return p.SIGNAL_AIR.value / p.CAWO4_SIGNAL.value * p.CAWO4_YIELD.value


def table_2_rows() -> Iterator[ArticleRow]:
    """Table 2 and the correction of reference [13]."""
    yield from (compare(what, number, None) for number, what in p.TABLE_2)
    for quantity, paper, eta in (
        ("[13]: 3.5/(0.90 x 0.80)", p.KIM_YIELD, p.KIM_ASSUMED_ETA),
        ("[13] corrected: 3.5/(0.56 x 0.80)", p.KIM_CORRECTED, p.WRAPPED_ETA),
    ):
        inputs = (p.KIM_MEASURED, eta, p.KIM_EFFICIENCY)
        yield compare(quantity, paper, from_printed(lambda y, h, e: y / (h * e / 1e4), *inputs))


def quoted_rows() -> Iterator[ArticleRow]:
    """What the article takes from measurement or literature; used here, or kept as it is."""
    yield from (compare(f"{what}, {number.where}", number, None) for number, what in p.QUOTED)


# Where the article contradicts itself, and where it leaves something open.
#
# Found by reading it; the rows that the sentences concern carry the verdict ``article
# inconsistent``.


def mean_of_centroid(centroid: float) -> float:
    """Mean number of photons of a band in which a Gaussian finds a centroid.

    The band's intrinsic spread, pedestal and continuum are those that `PhotonSpectrum` takes as
    usual; spreads of 5 and 15 % move the mean by 0.9 %.
    """

    def beyond_centroid(mean: float) -> float:
        spectrum = PhotonSpectrum(mean)
        photons = spectrum.photons()
        peak = fit_peak(photons, spectrum.expected(photons), shape=GAUSSIAN)
        assert peak is not None  # a clear one was drawn
        return peak.centroid - centroid

    return brentq(beyond_centroid, 0.97 * centroid, 1.15 * centroid, xtol=1e-4)


def inconsistencies() -> tuple[str, ...]:
    """One sentence for each contradiction within the article."""
    path = p.CRYSTAL_MM.value
    corrected = _corrected(p.MEASURED_TRANSMITTANCE.value, p.N_CRYSTAL.value)
    from_t = slab.absorption_coefficient(p.NOMINAL.transmittance_percent.value / 100, path)
    from_alpha = 100 * slab.transmittance(p.NOMINAL.alpha_abs_per_cm.value, path)
    gel_index = p.N_CRYSTAL.value / p.N_GEL.value
    relative = _signals_alone()
    per_eta = relative * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value * p.CAWO4_ETA.value / 100
    ratio = article_ratio()
    return (
        f"Eq. 4: T = 96.0 % over 10 mm is {from_t:.4f} /cm; the article writes 0.039, which is "
        f"T = {from_alpha:.1f} %.",
        f"Sec. 4: 76 % corrected for multiple reflection at n = 2.01 is T = {corrected:.1f} % "
        f"({slab.absorption_coefficient(corrected / 100, path):.3f} /cm), not 96 % (0.039 /cm).",
        'Eq. 5: the right-hand side reads "eta_1/eta_1"; it means eta_1/eta_2.',
        f"Eq. 6: with the stated n = 1.38 it gives "
        f"{100 * escape_fraction(p.RELATIVE_INDEX_GEL.value):.1f} %; the printed 15.6 % is that "
        f"of n = 2.01/1.46 = {gel_index:.4f}.",
        'Sec. 6.2: "Fig. 2" for the curves of eta means Fig. 3.',
        f"Sec. 6.2: 14.3/24.5 is {ratio.value:.4f} ± {ratio.sigma:.4f}; printed is "
        "0.583 ± 0.012, both cut off instead of rounded.",
        f"Eq. 7: evaluated with eta = 0.23 for CaMoO4 ({per_eta / p.RELATIVE_ETA.value:.1f} "
        f"ph/keV), while Table 1 has 25 % for the same air gap "
        f"({100 * per_eta / p.NOMINAL.eta_air_percent.value:.1f} ph/keV).",
        'Sec. 6.4: "alpha_scat" of CaWO4 appears twice, as 0.065 and 0.061 /cm; the first is its '
        "absorption coefficient.",
        f'Sec. 6.4: "5.6 ph/keV" for equal light collection: 14.3/40.1 x 16.2 is {relative:.1f}, '
        f"and {relative * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value:.2f} with the two "
        "detector efficiencies.",
    )


def open_points(simulated: Simulated) -> tuple[str, ...]:
    """One sentence for each number that the article does not specify, or that ours contradicts."""
    wrapped = [100 * result.eta for result in simulated.wrapped.values()]
    middle = 100 * simulated.wrapped[DEFAULT_WRAP_REFLECTANCE].eta
    air, gel = (mean_of_centroid(signal.value) for signal in (p.SIGNAL_AIR, p.SIGNAL_GEL))
    return (
        "Sec. 6.1: counted photons lean towards small numbers, and a Gaussian fitted to their band "
        f"finds its top, not its mean, which Eq. 2 needs: centroids of {p.SIGNAL_AIR.value:g} and "
        f"{p.SIGNAL_GEL.value:g} are those of {air:.1f} and {gel:.1f} photons per event (10 % "
        f"intrinsic spread), and the ratio is {air / gel:.3f}; see `mcrim lab peak`.",
        f"Sec. 6.2: a thin sample with gel: the article says 63 %, this bench gives "
        f"{100 * simulated.thin.eta:.1f} %.",
        "Secs. 6.2, 6.4: dimensions and index of the CaWO4 crystal are not given; a 10 mm cube of "
        f"n = 1.92 gives {100 * simulated.cawo4.eta:.1f} %, the article has 16.2 %.",
        f"Sec. 6.5: the wrapped cube (56 %) is not specified; a Lambertian reflector behind air "
        f"gives {middle:.1f} % ({min(wrapped):.1f} to {max(wrapped):.1f} % for reflectances of "
        f"{p.TEFLON_LOW.text} to {p.TEFLON_HIGH.text}), and [13] then "
        f"{p.KIM_MEASURED.value / (middle * p.KIM_EFFICIENCY.value / 1e4):.1f} instead of "
        "7.8 ph/keV.",
        "Figs. 2-4: their data are not in the text; our curves carry Table 1's values and the "
        "band of the measured R instead, and our Fig. 2 shows synthetic histograms. Eq. 3 cannot "
        "be evaluated without the spectra.",
    )
