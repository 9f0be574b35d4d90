"""What follows from the article's printed numbers alone, by its own formulas.

A number computed here differs from the printed one only if the article disagrees with itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, SupportsFloat

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import ArticleRow, Printed, compare
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.laboratory.error_budget import Uncertain, quotient
from mcrim_mitsuba.laboratory.light_yield import light_yield_by_reference, light_yield_ph_per_keV
from mcrim_mitsuba.optics.attenuation import (
    absorption_coefficient,
    internal_transmittance,
    transmittance,
)
from mcrim_mitsuba.optics.fresnel import escape_fraction, trapped_fraction


def from_printed(formula: Callable[..., SupportsFloat], *inputs: Printed) -> tuple[float, float]:
    """A formula's value at printed numbers, and what their rounding may move it by.

    The second is the sum over the inputs of the change when each is moved by its rounding.
    """
    values = [number.value for number in inputs]
    value = float(formula(*values))
    moved = 0.0
    for place, number in enumerate(inputs):
        shifted = values.copy()
        shifted[place] += number.rounding
        moved += abs(float(formula(*shifted)) - value)
    return value, moved


def derived(
    section: str,
    quantity: str,
    paper: Printed | None,
    formula: Callable[..., SupportsFloat],
    *inputs: Printed,
    **known: Any,
) -> ArticleRow:
    """What a formula makes of printed numbers, as a row; `known` as for `compare`."""
    value, moved = from_printed(formula, *inputs)
    return compare(section, quantity, paper, value, rounding=moved, **known)


def escape_per_face(n: float) -> float:
    """Fraction of isotropic light that leaves a bare polished box, per face, at any index.

    The escape cones about the three axes overlap where n < sqrt(2), and light in two cones
    leaves only once: Eq. 6 less 12 overlaps (three pairs of axes, four signs), shared by six
    faces. The overlap of two cones of half-angle r at right angles covers the solid angle
    2 (pi - arccos(-cot^2 r) - 2 cos r arccos(cot r)); three cones meet below sqrt(3/2) only.

    Parameters
    ----------
    n : float
        Index of the crystal relative to its surroundings, at least sqrt(3/2).

    Raises
    ------
    ValueError
        If n is below that.
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
    return quotient(
        above=[("signal", counted(p.SIGNAL_AIR, "air"))],
        below=[("signal", counted(p.SIGNAL_GEL, "gel"))],
    )


def transmittance_rows() -> list[ArticleRow]:
    """Eq. 4 both ways, and the correction of Section 4."""
    rows = []
    for line in p.TABLE_1:
        percent, alpha = line.transmittance_percent, line.alpha_abs_per_cm
        rows += [
            derived(
                p.TRANSMITTANCE, f"alpha_abs from T = {percent.text} %, Eq. 4", alpha,
                lambda t, d: absorption_coefficient(t / 100, d), percent, p.CRYSTAL_MM,
                inconsistent=line == p.NOMINAL,
            ),
            derived(
                p.TRANSMITTANCE, f"T from alpha_abs = {alpha.text} /cm, Eq. 4", percent,
                lambda a, d: 100 * transmittance(a, d), alpha, p.CRYSTAL_MM,
                inconsistent=line == p.NOMINAL,
            ),
        ]  # fmt: skip

    def corrected(percent: float, n: float) -> Array:
        return 100 * internal_transmittance(percent / 100, n)

    _, moved = from_printed(corrected, p.MEASURED_TRANSMITTANCE, p.N_CRYSTAL)
    return [
        *rows,
        derived(
            p.TRANSMITTANCE, "T from the measured 76 %, Sec. 4", p.CORRECTED_TRANSMITTANCE,
            corrected, p.MEASURED_TRANSMITTANCE, p.N_CRYSTAL, inconsistent=True,
            remark="all orders of reflection, added without interference; the rounding of 76 % "
            f"and 2.01 is worth ±{moved:.1f} %",
        ),
        derived(
            p.TRANSMITTANCE, "alpha_abs from the measured 76 %, Sec. 4",
            p.NOMINAL.alpha_abs_per_cm,
            lambda t, n, d: absorption_coefficient(corrected(t, n) / 100, d),
            p.MEASURED_TRANSMITTANCE, p.N_CRYSTAL, p.CRYSTAL_MM, inconsistent=True,
        ),
    ]  # fmt: skip


def bare_crystal_rows() -> list[ArticleRow]:
    """Eq. 6 as a closed form."""
    return [
        derived(p.BARE_CRYSTAL, "one face, n = 2.01, Eq. 6", p.ETA_FACE_AIR,
                lambda n: 100 * escape_fraction(n), p.N_CRYSTAL),
        derived(p.BARE_CRYSTAL, "relative index to gel, 2.01/1.46", p.RELATIVE_INDEX_GEL,
                lambda n, m: n / m, p.N_CRYSTAL, p.N_GEL),
        derived(p.BARE_CRYSTAL, "one face, n = 2.01/1.46, Eq. 6", p.ETA_FACE_GEL,
                lambda n, m: 100 * escape_fraction(n / m), p.N_CRYSTAL, p.N_GEL),
        compare(p.BARE_CRYSTAL, "one face, the stated n = 1.38, Eq. 6", p.ETA_FACE_GEL,
                float(100 * escape_fraction(p.RELATIVE_INDEX_GEL.value)), inconsistent=True,
                remark="15.6 % needs the index before it was rounded"),
        compare(p.BARE_CRYSTAL, "trapped for ever, n = 2.01, 1 - 6 faces", None,
                float(100 * trapped_fraction(p.N_CRYSTAL.value)), unit="%"),
    ]  # fmt: skip


def ratio_rows() -> list[ArticleRow]:
    """Eq. 5 from the two signals."""
    ratio = article_ratio()
    _, moved = from_printed(lambda a, g: a / g, p.SIGNAL_AIR, p.SIGNAL_GEL)
    return [
        compare(
            p.RATIO_SECTION, "R = 14.3/24.5, Eq. 5", p.RATIO, ratio.value, sigma=ratio.sigma,
            difference_sigma=0.0, rounding=moved,
            remark=f"{ratio.value:.4f} ± {ratio.sigma:.4f}: the article cuts digits off "
            "where rounding gives 0.584 ± 0.013",
        ),
        compare(p.RATIO_SECTION, "relative error of N_gel, Sec. 6.3", p.SIGNAL_ERROR,
                100 * p.SIGNAL_GEL.stated_sigma / p.SIGNAL_GEL.value),
        compare(p.RATIO_SECTION, "relative error of N_air", None,
                100 * p.SIGNAL_AIR.stated_sigma / p.SIGNAL_AIR.value, unit="%",
                remark="the article takes the larger one, 1.6 %, for both"),
    ]  # fmt: skip


def yield_row(
    section: str, quantity: str, paper: Printed, found: Uncertain, **known: Any
) -> ArticleRow:
    """A light yield with its two kinds of errors; `known` as for `compare`."""
    return compare(
        section, quantity, paper, found.value, sigma=found.statistical_sigma,
        systematic=found.systematic_sigma, **known,
    )  # fmt: skip


def light_yield_rows() -> list[ArticleRow]:
    """Eqs. 1 and 2 with the article's own efficiencies, and its error budget."""
    rows = []
    for name, coupling, signal, eta, paper in (
        ("Y1 (air)", "air", p.SIGNAL_AIR, p.NOMINAL.eta_air_percent, p.YIELD_AIR),
        ("Y2 (gel)", "gel", p.SIGNAL_GEL, p.NOMINAL.eta_gel_percent, p.YIELD_GEL),
    ):
        found = light_yield_ph_per_keV(
            counted(signal, coupling), with_eta_error(eta.value / 100),
            efficiency(p.EFFICIENCY), p.ENERGY_KEV.value,
        )  # fmt: skip
        _, moved = from_printed(
            lambda n, e, h, k: n / (e * h / 100 * k), signal, p.EFFICIENCY, eta, p.ENERGY_KEV
        )
        rows.append(yield_row(
            p.LIGHT_YIELD_SECTION, f"{name}, the article's eta = {eta.text} %", paper, found,
            difference_sigma=0.0, rounding=moved,
            remark=f"rounds to {found.value:.1f}, which the rounding of {eta.text} % covers"
            if round(found.value, 1) != paper.value else "",
        ))  # fmt: skip
    # the largest deviation from the middle line
    eta_error, moved = max(
        from_printed(lambda a, b: 100 * abs(a / b - 1), value, middle)
        for low, middle, high in (
            [line.eta_air_percent for line in p.TABLE_1],
            [line.eta_gel_percent for line in p.TABLE_1],
        )
        for value in (low, high)
    )
    return [
        *rows,
        compare(p.LIGHT_YIELD_SECTION, "error of eta: spread of Table 1", p.ETA_ERROR, eta_error,
                rounding=moved,
                remark="largest deviation from the middle line: 28/25 and 48/43"),
        derived(p.LIGHT_YIELD_SECTION, "total error: 12, 10, 1.6 % in quadrature", p.TOTAL_ERROR,
                math.hypot, p.ETA_ERROR, p.EFFICIENCY_ERROR, p.SIGNAL_ERROR),
        derived(p.LIGHT_YIELD_SECTION, "total error: 16 % of 7.5",
                p.printed(str(p.LIGHT_YIELD.sigma), "Sec. 6.3", "ph/keV"),
                lambda y, e: y * e / 100, p.LIGHT_YIELD, p.TOTAL_ERROR),
    ]  # fmt: skip


def counted(signal: Printed, whose: str) -> Uncertain:
    """A signal with its printed error, independent of those of other couplings and crystals."""
    return Uncertain(signal.value, statistical={f"counts, {whose}": signal.stated_sigma})


def with_eta_error(eta: float) -> Uncertain:
    """A light collection efficiency with the article's ±12 %, a systematic error."""
    return Uncertain(eta, systematic={"eta": eta * p.ETA_ERROR.value / 100})


def efficiency(printed: Printed) -> Uncertain:
    """A detector efficiency with the article's ±10 %, a systematic error."""
    sigma = printed.value * p.EFFICIENCY_ERROR.value / 100
    return Uncertain(printed.value, systematic={"detector_efficiency": sigma})


def reference_yield() -> Uncertain:
    """The light yield of CaWO4 with its printed error."""
    sigma = p.CAWO4_YIELD.stated_sigma
    return Uncertain(p.CAWO4_YIELD.value, systematic={"reference light yield": sigma})


def relative_yield(eta: Uncertain, cawo4_eta: Uncertain) -> Uncertain:
    """Eq. 7, ph/keV, with all errors as the article takes them: independent.

    Parameters
    ----------
    eta, cawo4_eta : Uncertain
        Efficiencies of CaMoO4 and CaWO4 at the air gap, fractions.
    """
    return light_yield_by_reference(
        counted(p.SIGNAL_AIR, "air"), eta.own("CaMoO4"), efficiency(p.EFFICIENCY).own("CaMoO4"),
        counted(p.CAWO4_SIGNAL, "CaWO4"), cawo4_eta.own("CaWO4"),
        efficiency(p.CAWO4_EFFICIENCY).own("CaWO4"), reference_yield(),
    )  # fmt: skip


def relative_rows() -> list[ArticleRow]:
    """Eq. 7 with the article's own numbers, and the comparison that it warns of."""
    cawo4_eta = p.CAWO4_ETA.value / 100
    stated = relative_yield(with_eta_error(p.RELATIVE_ETA.value), with_eta_error(cawo4_eta))
    of_table_1 = relative_yield(
        with_eta_error(p.NOMINAL.eta_air_percent.value / 100), with_eta_error(cawo4_eta)
    )
    rows = []
    for what, eta, found in (
        ("stated eta = 0.23", p.RELATIVE_ETA, stated),
        ("Table 1's 25 %", p.NOMINAL.eta_air_percent, of_table_1),
    ):
        # eq. 7 is a product of powers: the roundings' relative effects add
        moved = found.value * sum(
            number.rounding / number.value
            for number in (p.SIGNAL_AIR, p.CAWO4_EFFICIENCY, p.CAWO4_ETA, p.CAWO4_SIGNAL,
                           p.EFFICIENCY, eta, p.CAWO4_YIELD)
        )  # fmt: skip
        rows.append(yield_row(
            p.RELATIVE, f"Y, {what}, Eq. 7", p.RELATIVE_YIELD, found, difference_sigma=0.0,
            rounding=moved, inconsistent=found is of_table_1,
        ))  # fmt: skip
    equal = derived(
        p.RELATIVE, "equal collection: 14.3/40.1 x 16.2", p.SIMPLE_COMPARISON,
        lambda a, b, y: a / b * y, p.SIGNAL_AIR, p.CAWO4_SIGNAL, p.CAWO4_YIELD, inconsistent=True,
    )  # fmt: skip
    assert equal.ours is not None  # computed just now
    return [
        *rows,
        compare(
            p.RELATIVE, "error of Eq. 7", p.printed("1.7", "Eq. 7", "ph/keV"), stated.sigma,
            remark="12 % on each eta, 10 % on each efficiency, 9.9 % on the yield of CaWO4, counts",
        ),
        equal,
        compare(
            p.RELATIVE, "with the efficiencies", p.SIMPLE_COMPARISON,
            equal.ours * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value, inconsistent=True,
            remark="equal collection alone overrates the yield: 5.6 takes equal efficiencies as "
            "well",
        ),
    ]  # fmt: skip


def table_2_rows() -> list[ArticleRow]:
    """Table 2 and the correction of reference [13]."""

    def kim(quantity: str, paper: Printed, eta: Printed) -> ArticleRow:
        return derived(
            p.TABLE_2_SECTION, quantity, paper, lambda y, h, e: y / (h * e / 1e4),
            p.KIM_MEASURED, eta, p.KIM_EFFICIENCY,
        )  # fmt: skip

    return [
        *(compare(p.TABLE_2_SECTION, what, number, None) for number, what in p.TABLE_2),
        kim("[13]: 3.5/(0.90 x 0.80)", p.KIM_YIELD, p.KIM_ASSUMED_ETA),
        kim("[13] corrected: 3.5/(0.56 x 0.80)", p.KIM_CORRECTED, p.WRAPPED_ETA),
    ]


def quoted_rows() -> list[ArticleRow]:
    """What the article takes from measurement or literature; used here, or kept as it is."""
    used = (
        (p.SIGNAL_AIR, "N_air, photons counted per event"),
        (p.SIGNAL_GEL, "N_gel, photons counted per event"),
        (p.ENERGY_KEV, "energy of the gammas of Am-241"),
        (p.EFFICIENCY, "detector efficiency for CaMoO4, Eq. 3"),
        (p.CAWO4_EFFICIENCY, "detector efficiency for CaWO4, Eq. 3"),
        (p.EFFICIENCY_ERROR, "error of the detector efficiencies"),
        (p.CAWO4_SIGNAL, "N of CaWO4, photons counted per event"),
        (p.CAWO4_YIELD, "light yield of CaWO4, [28]"),
        (p.TEFLON, "reflectivity of Teflon tape"),
    )
    return [
        compare(p.QUOTED_SECTION, f"{what}, {number.where}", number, None)
        for number, what in (*used, *p.QUOTED)
    ]
