"""The numbers that the article prints, with their places, and the rule that judges ours.

V. Alenkov et al., JINST 8 (2013) P06002, arXiv:1303.5952. Only what is printed is here; what
follows from it is in `arithmetic`, what is simulated in `simulated`. Units are the article's:
mm, 1/cm, %, keV, photons per keV.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, SupportsFloat

from mcrim_mitsuba.laboratory.error_budget import Uncertain

_PRINTED = re.compile(r"(?P<value>\d+(\.\d+)?)(±(?P<sigma>\d+(\.\d+)?)|-(?P<high>\d+(\.\d+)?))?")


@dataclass(frozen=True, kw_only=True)
class Printed:
    """A number as the article prints it."""

    #: Its characters, e.g. ``0.54±0.10``.
    text: str
    value: float
    #: The true value may be this far away without the print changing: half a unit of
    #: the last digit, or half the width of a printed range.
    rounding: float
    #: The standard error that is printed with it.
    sigma: float | None
    #: Section, equation or table.
    where: str
    unit: str = ""

    @property
    def stated_sigma(self) -> float:
        """`sigma` of a number that is printed with one; ValueError without."""
        if self.sigma is None:
            raise ValueError(f"{self.text} is printed without an error")
        return self.sigma


def printed(text: str, where: str, unit: str = "") -> Printed:
    """A number from its characters, or a range, ``0.3-0.4``: anything within it agrees.

    Raises ValueError if they are not ``value``, ``value±error`` or ``low-high``.
    """
    match = _PRINTED.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a number with or without an error")
    sigma, low = match["sigma"], float(match["value"])
    high = float(match["high"] or low)
    decimals = len(match["value"].partition(".")[2])
    return Printed(
        text=text,
        value=(low + high) / 2,
        rounding=(high - low) / 2 or 0.5 * 10.0**-decimals,
        sigma=None if sigma is None else float(sigma),
        where=where,
        unit=unit,
    )


class Derived(NamedTuple):
    """A value that follows from printed numbers, and what their rounding may move it by."""

    value: float
    rounding: float


def from_printed(formula: Callable[..., SupportsFloat], *inputs: Printed) -> Derived:
    """A formula's value at printed numbers, and the sum of what rounding each one moves it by."""
    values = [number.value for number in inputs]
    value = float(formula(*values))
    rounding = 0.0
    for place, number in enumerate(inputs):
        shifted = values.copy()
        shifted[place] += number.rounding
        rounding += abs(float(formula(*shifted)) - value)
    return Derived(value, rounding)


class Table1Line(NamedTuple):
    """One line of Table 1: what a transmittance makes of the crystal and its efficiencies."""

    transmittance_percent: Printed
    alpha_abs_per_cm: Printed
    alpha_scat_per_cm: Printed
    eta_air_percent: Printed
    eta_gel_percent: Printed

    @property
    def etas_percent(self) -> tuple[Printed, Printed]:
        """Efficiencies of air and gel."""
        return self.eta_air_percent, self.eta_gel_percent


_UNITS_OF_TABLE_1 = ("%", "1/cm", "1/cm", "%", "%")
TABLE_1 = tuple(
    Table1Line(*map(printed, texts, itertools.repeat("Table 1"), _UNITS_OF_TABLE_1))
    for texts in (
        ("98.6", "0.014", "0.42", "28", "48"),
        ("96.0", "0.039", "0.54", "25", "43"),
        ("93.0", "0.072", "0.73", "23", "40"),
    )
)
NOMINAL = TABLE_1[1]

# ---- Sections 3 to 5: the crystal and the bench ---------------------------------------
CRYSTAL_MM = printed("10.0", "Sec. 4", "mm")
MEASURED_TRANSMITTANCE = printed("76", "Sec. 4", "%")
CORRECTED_TRANSMITTANCE = printed("96", "Sec. 4", "%")
ROUGHNESS_NM = printed("50", "Sec. 4", "nm")
EMISSION_NM = printed("540", "Sec. 4", "nm")
N_CRYSTAL = printed("2.01", "Sec. 4")
N_AIR = printed("1.00", "Sec. 4")
N_GEL = printed("1.46", "Sec. 4")
N_WINDOW = printed("1.52", "Sec. 5")
GAP_MM = printed("0.05", "Sec. 4", "mm")
WINDOW_WIDTH_MM = printed("28", "Sec. 5", "mm")
WINDOW_THICKNESS_MM = printed("1", "Sec. 5", "mm")
APERTURE_DIAMETER_MM = printed("28", "Sec. 5", "mm")
#: The source is that much smaller than the crystal.
SOURCE_MARGIN_MM = printed("0.001", "Sec. 5", "mm")
#: Rays of one simulated efficiency.
RAYS = replace(printed("100000", "Sec. 5"), text="100,000")
RELATIVE_INDEX_GEL = printed("1.38", "Sec. 5")
ETA_FACE_AIR = printed("6.6", "Eq. 6", "%")
ETA_FACE_GEL = printed("15.6", "Eq. 6", "%")
#: "identical numbers within the error limit of less than 1 %"
ZEMAX_FACE_RELATIVE_ERROR = 0.01

# ---- Sections 6.1 to 6.3 ------------------------------------------------------------------
ENERGY_KEV = printed("59.5", "Sec. 4", "keV")
SIGNAL_AIR = printed("14.3±0.2", "Sec. 6.1", "photons")
SIGNAL_GEL = printed("24.5±0.4", "Sec. 6.1", "photons")
RATIO = printed("0.583±0.012", "Sec. 6.2")
ALPHA_SCAT = printed("0.54±0.10", "Sec. 6.2", "1/cm")
GEL_MAXIMUM = printed("0.3-0.4", "Sec. 6.2", "1/cm")
#: Above it eta_air shows "little change".
FLAT_ABOVE = printed("0.5", "Sec. 6.2", "1/cm")
SCANNED_FROM = printed("0.01", "Sec. 6.2", "1/cm")
SCANNED_TO = printed("2", "Sec. 6.2", "1/cm")
THIN_ETA = printed("63", "Sec. 6.2", "%")
CAWO4_QUOTED_ETA = printed("15.2", "Sec. 6.2", "%")
CAWO4_QUOTED_SIGNAL = printed("3.8", "Sec. 6.2", "%")
CAWO4_QUOTED_QUANTUM_EFFICIENCY = printed("25", "Sec. 6.2", "%")
EFFICIENCY = printed("0.127", "Sec. 6.3")
YIELD_AIR = printed("7.5", "Sec. 6.3", "ph/keV")
YIELD_GEL = printed("7.5", "Sec. 6.3", "ph/keV")
ETA_ERROR = printed("12", "Sec. 6.3", "%")
EFFICIENCY_ERROR = printed("10", "Sec. 6.3", "%")
SIGNAL_ERROR = printed("1.6", "Sec. 6.3", "%")
TOTAL_ERROR = printed("16", "Sec. 6.3", "%")
LIGHT_YIELD = printed("7.5±1.2", "Sec. 6.3", "ph/keV")

# ---- Section 6.4 --------------------------------------------------------------------------
CAWO4_YIELD = printed("16.2±1.6", "Sec. 6.4", "ph/keV")
CAWO4_ETA = printed("16.2", "Sec. 6.4", "%")
CAWO4_EFFICIENCY = printed("0.221", "Sec. 6.4")
CAWO4_SIGNAL = printed("40.1±0.4", "Sec. 6.4", "photons")
CAWO4_ALPHA_ABS = printed("0.065", "Sec. 6.4", "1/cm")
CAWO4_ALPHA_SCAT = printed("0.061", "Sec. 6.4", "1/cm")
#: What Eq. 7 is evaluated with; Table 1 has 25 %.
RELATIVE_ETA = printed("0.23", "Eq. 7")
RELATIVE_YIELD = printed("7.1±1.7", "Eq. 7", "ph/keV")
SIMPLE_COMPARISON = printed("5.6", "Sec. 6.4", "ph/keV")

# ---- Section 6.5 --------------------------------------------------------------------------
WRAPPED_ETA = printed("56", "Sec. 6.5", "%")
TEFLON_LOW = printed("0.95", "Sec. 2")
TEFLON_HIGH = printed("0.98", "Sec. 2")
TEFLON = printed("0.95-0.98", "Sec. 2")
KIM_MEASURED = printed("3.5", "Sec. 6.5", "ph/keV")
KIM_ASSUMED_ETA = printed("90", "Sec. 6.5", "%")
KIM_EFFICIENCY = printed("80", "Sec. 6.5", "%")
KIM_YIELD = printed("4.9±0.59", "Table 2", "ph/keV")
KIM_CORRECTED = printed("7.8", "Sec. 6.5", "ph/keV")

#: Table 2 apart from the line of [13] and that of the article itself: printed, what it is.
TABLE_2 = (
    (printed("20", "Table 2", "%"), "[7], relative to CsI-Tl"),
    (printed("4", "Table 2", "%"), "[11], relative to CsI-Tl"),
    (printed("36", "Table 2", "%"), "[12], relative to CaWO4"),
    (printed("9", "Table 2", "%"), "no reference printed, relative to NaI-Tl"),
    (printed("3.0", "Table 2", "ph/keV"), "[29], photomultiplier"),
    (printed("8.9±3.5", "Table 2", "ph/keV"), "[9], relative to CaWO4"),
)

#: Quoted, assumed or measured by the article; nothing in it allows them to be recomputed. What is
#: used here comes first.
QUOTED = (
    (SIGNAL_AIR, "N_air, photons counted per event"),
    (SIGNAL_GEL, "N_gel, photons counted per event"),
    (ENERGY_KEV, "energy of the gammas of Am-241"),
    (EFFICIENCY, "detector efficiency for CaMoO4, Eq. 3"),
    (CAWO4_EFFICIENCY, "detector efficiency for CaWO4, Eq. 3"),
    (EFFICIENCY_ERROR, "error of the detector efficiencies"),
    (CAWO4_SIGNAL, "N of CaWO4, photons counted per event"),
    (CAWO4_YIELD, "light yield of CaWO4, [28]"),
    (TEFLON, "reflectivity of Teflon tape"),
    (printed("9.63", "Sec. 1", "%"), "natural abundance of Mo-100"),
    (printed("3034", "Sec. 1", "keV"), "Q-value of its double beta decay"),
    (printed("10", "Sec. 2", "%"), "spread of absolute yields, [18]"),
    (printed("1.9", "Sec. 6.5"), "index below which 90 % may do"),
    (ROUGHNESS_NM, "roughness of the polish"),
    (EMISSION_NM, "maximum of the emission"),
    (printed("400-650", "Sec. 6.2", "nm"), "range of the transmittances"),
    (printed("5", "Sec. 4", "%"), "error of the quantum efficiency"),
    (printed("10", "Sec. 4", "min"), "duration of each of 4 data sets"),
    (printed("60", "Sec. 6.2", "%"), "eta of BGO with gel, [15]"),
    (printed("41", "Sec. 6.2", "%"), "eta of LSO-Ce with gel, [27]"),
)


# One number of the article beside ours, and the rule that judges the two.

AGREES = "agrees"
DIFFERS = "differs"
INCONSISTENT = "article inconsistent"
REFERENCE = "reference only"

#: Standard errors of the difference within which two numbers agree.
AGREEMENT_SIGMAS = 2.0
RULE = (
    f"'agrees': the difference is within {AGREEMENT_SIGMAS:g} of its standard errors plus the "
    "rounding of the printed digits, those of the numbers that ours is computed from included. "
    "An error that both numbers share does not count. Numbers that the article simulated carry "
    "the binomial error of its 100,000 rays."
)


@dataclass(frozen=True, kw_only=True)
class ArticleRow:
    """One number of the article and ours."""

    #: Heading that it belongs under; empty until all rows are put together.
    section: str
    #: What it is and where the article has it.
    quantity: str
    #: Of every number of the row; empty for a pure number.
    unit: str
    #: The article's number; None where it gives none.
    paper: float | None
    #: The standard error printed with it.
    paper_sigma: float | None
    #: Its characters; empty where there is none.
    paper_text: str
    #: None where nothing here recomputes it.
    ours: float | None
    #: Statistical standard error of ours, counting and Monte Carlo.
    sigma: float | None
    #: Systematic standard error of ours; None where there is none.
    systematic: float | None
    #: ``agrees``, ``differs``, ``article inconsistent`` or ``reference only``.
    verdict: str
    #: What the reader must know to judge the row.
    remark: str = ""


def compare(
    quantity: str,
    paper: Printed | None,
    ours: Derived | Uncertain | SupportsFloat | None,
    *,
    sigma: float | None = None,
    systematic: float | None = None,
    difference_sigma: float | None = None,
    rounding: float = 0.0,
    unit: str | None = None,
    inconsistent: bool = False,
    judged: bool = True,
    remark: str = "",
) -> ArticleRow:
    """A row with its verdict, by `RULE`; its unit is the printed number's unless given.

    Ours comes with its rounding (`Derived`), with its statistical and systematic errors
    (`Uncertain`), or alone, `sigma` and `systematic` being its errors; `rounding` is what that of
    printed numbers may move it by.
    `difference_sigma` is the standard error of the difference where it is not all three errors in
    quadrature, because the two numbers share some.
    `inconsistent` says that the article's own numbers contradict this one: a finding of the reader,
    recorded in `arithmetic.inconsistencies`, which overrules the rule. Numbers that stand side by
    side and need not agree are not `judged`.
    """
    if isinstance(ours, Uncertain):
        sigma, systematic = ours.statistical_sigma, ours.systematic_sigma
    number = ours.value if isinstance(ours, (Derived, Uncertain)) else ours
    given = number, sigma, systematic
    value, sigma, systematic = (None if part is None else float(part) for part in given)
    if difference_sigma is None:
        parts = (paper.sigma if paper else None, sigma, systematic)
        difference_sigma = math.hypot(*(part or 0.0 for part in parts))
    verdict = REFERENCE
    if paper is not None and value is not None and judged:
        if isinstance(ours, Derived):
            rounding = rounding or ours.rounding
        limit = paper.rounding + rounding + AGREEMENT_SIGMAS * difference_sigma
        # a hair for numbers that lie exactly on the limit, such as 0.5 - 0.45 against 0.05
        agrees = abs(value - paper.value) <= limit * (1 + 1e-9)
        verdict = INCONSISTENT if inconsistent else AGREES if agrees else DIFFERS
    return ArticleRow(
        section="",
        quantity=quantity,
        unit=(paper.unit if paper else "") if unit is None else unit,
        paper=paper.value if paper else None,
        paper_sigma=paper.sigma if paper else None,
        paper_text=paper.text if paper else "",
        ours=value,
        sigma=sigma,
        systematic=systematic,
        verdict=verdict,
        remark=remark,
    )
