"""Where gammas stop in a crystal: their attenuation length from tabulated cross-sections.

xraydb is imported only when it is asked: that takes longer than all else.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.optics.materials import chemical_formula, density_of

SOURCE = (
    "W. T. Elam, B. D. Ravel and J. R. Sieber, Radiat. Phys. Chem. 63 (2002) 121-128 (by xraydb); "
    "error as in J. H. Hubbell and S. M. Seltzer, NISTIR 5632 (1995)"
)
#: Energies between which the tables are trustworthy.
LOWEST_KEV = 1.0
HIGHEST_KEV = 800.0
#: Relative standard error of tabulated coefficients (Hubbell and Seltzer: 1 to 2 % for photon
#: energies above 5 keV, more near edges).
TABLES_SIGMA = 0.02
_EV_PER_KEV = 1000.0
#: No solid is denser (osmium has 22.6); kg/m3 are likely.
_DENSEST_G_PER_CM3 = 25.0
# NaI(Tl), LaBr3(Ce3+), NaI:Tl; brackets with a count behind them are part of a formula
_ION = r"[A-Z][a-z]?[0-9]*\+?"
_DOPING = re.compile(rf"\s*(\({_ION}(,\s*{_ION})*\)|:\s*{_ION}(,\s*{_ION})*)\s*$")


@dataclass(frozen=True)
class AttenuationLength:
    """Depth in which the number of gammas falls to 1/e.

    The light of the full-energy peak is born where the energy is deposited. Coherent scattering
    deposits nothing and deflects little: the total coefficient counts it as a stop, the total
    without it as nothing. `length_mm` is that of the total coefficient, which is what tables and
    articles give; the difference of the two is part of the error. (Following single 59.5 keV
    gammas in 10 mm of CaMoO4 with all three processes, the absorbed energy lies 1.08 mm deep in
    the mean, as `without_coherent_mm` has it.)
    """

    #: Chemical formula.
    formula: str
    energy_keV: float
    density_g_per_cm3: float
    #: Its parts: photoelectric absorption, Compton and Rayleigh scattering.
    photoelectric_per_cm: float
    _: KW_ONLY
    incoherent_per_cm: float
    coherent_per_cm: float
    #: Part of the gammas whose K X-ray escapes through the face that they came in by, and the mean
    #: energy that these events lose.
    escaping: float = 0.0
    escaping_keV: float = 0.0

    @property
    def escape_loss(self) -> float:
        """Part of the deposited energy that escapes in the mean, by which a centroid is low."""
        return self.escaping * self.escaping_keV / self.energy_keV

    @property
    def per_cm(self) -> float:
        """Total linear attenuation coefficient, 1/cm."""
        return self.photoelectric_per_cm + self.incoherent_per_cm + self.coherent_per_cm

    @property
    def length_mm(self) -> float:
        """1/e depth of the total coefficient, mm."""
        return MM_PER_CM / self.per_cm

    @property
    def without_coherent_mm(self) -> float:
        """1/e depth if coherently scattered gammas go on as if nothing had happened, mm."""
        return MM_PER_CM / (self.per_cm - self.coherent_per_cm)

    @property
    def tables_sigma_mm(self) -> float:
        """Standard error of `length_mm` by that of the tables."""
        return TABLES_SIGMA * self.length_mm

    @property
    def process_sigma_mm(self) -> float:
        """Standard error of `length_mm` by the doubt which processes stop a gamma."""
        return self.without_coherent_mm - self.length_mm

    @property
    def sigma_mm(self) -> float:
        """Standard error of `length_mm`: both in quadrature."""
        return math.hypot(self.tables_sigma_mm, self.process_sigma_mm)

    def stopped_within(self, depth_mm: ArrayLike) -> Array:
        """Fraction of gammas with their first interaction above a depth, at normal incidence."""
        return -np.expm1(-np.asarray(depth_mm, dtype=float) / self.length_mm)


@functools.lru_cache(maxsize=64)  # half of the time of reading a campaign once more
def attenuation_length_mm(
    formula: str, energy_keV: float, density_g_per_cm3: float | None = None
) -> AttenuationLength:
    """Attenuation length of gammas of one energy in a compound.

    The formula is a chemical one, such as ``CaMoO4``, or the name of a material that has one;
    elements have their natural isotopes. Without a density that of the material of this formula in
    the catalogue is taken.

    Raises InputError if the formula cannot be read, the energy is not from `LOWEST_KEV` to
    `HIGHEST_KEV`, or the density is neither given nor known.
    """
    if not LOWEST_KEV <= energy_keV <= HIGHEST_KEV:
        raise InputError(
            f"an energy of {energy_keV:.10g} keV is outside {LOWEST_KEV:g} to {HIGHEST_KEV:g} keV, "
            "the range of the attenuation tables",
            "give the gammas' energy in keV",
        )
    named, formula = formula, chemical_formula(formula)
    amounts = _amounts(formula)
    density = density_of(named) if density_g_per_cm3 is None else density_g_per_cm3
    if density is None:
        mend = "give it: --density-g-per-cm3, or density_g_per_cm3 in a campaign"
        raise InputError(f"the density of {formula} is not in the catalogue of materials", mend)
    mend = "give it in g/cm3: 4.25 for CaMoO4"
    if not (math.isfinite(density) and density > 0):
        raise InputError(f"a density of {density:g} g/cm3 is not above 0", mend)
    if density > _DENSEST_G_PER_CM3:
        raise InputError(f"no solid has a density of {density:g} g/cm3", mend)
    import xraydb

    masses = {name: count * xraydb.atomic_mass(name) for name, count in amounts.items()}

    def per_cm(
        kind: str, energy_eV: float = energy_keV * _EV_PER_KEV, elements: Iterable[str] = masses
    ) -> float:
        """Coefficient of one process by some of the elements; without them by all."""
        per_element = (
            masses[name] * float(xraydb.mu_elam(name, energy_eV, kind=kind)) for name in elements
        )
        return density * sum(per_element) / sum(masses.values())

    length = AttenuationLength(
        formula,
        float(energy_keV),
        float(density),
        photoelectric_per_cm=per_cm("photo"),
        incoherent_per_cm=per_cm("incoh"),
        coherent_per_cm=per_cm("coh"),
    )
    escaping, lost = _escaping(length, masses, per_cm)
    return replace(length, escaping=escaping, escaping_keV=lost / escaping if escaping else 0.0)


def _escaping(
    length: AttenuationLength, elements: Iterable[str], per_cm: Callable[..., float]
) -> tuple[float, float]:
    """Part of the gammas whose K X-ray escapes, and what they lose, keV per gamma.

    `per_cm` gives coefficients by kind, energy in eV and elements.
    """
    import xraydb

    escaping = lost = 0.0
    for element in elements:
        edge = xraydb.xray_edge(element, "K")
        if edge.energy >= length.energy_keV * _EV_PER_KEV:
            continue
        # gammas that this element absorbs in its K shell, and that shine
        share = per_cm("photo", elements=(element,)) / length.per_cm
        share *= (1.0 - 1.0 / edge.jump_ratio) * edge.fyield
        for line in xraydb.xray_lines(element, "K").values():
            # births exp(-t/d) below the face, half of the X-rays upwards, less what is absorbed on
            # the way: P. Axel, Rev. Sci. Instrum. 25 (1954) 391
            absorbed = per_cm("total", line.energy) / length.per_cm
            out = share * line.intensity * 0.5 * (1.0 - absorbed * math.log1p(1.0 / absorbed))
            escaping, lost = escaping + out, lost + out * line.energy / _EV_PER_KEV
    return escaping, lost


def _amounts(formula: str) -> dict[str, float]:
    """Atoms of each element in a chemical formula."""
    import xraydb

    mend = "write a chemical formula such as CaMoO4, with the elements' own capitals"
    if (doping := _DOPING.search(formula)) is not None:
        mend = f"write {formula[: doping.start()]}: a doping stops hardly any gammas"
        raise InputError(f"'{formula}' names a doping, which is no part of the formula", mend)
    try:
        amounts = xraydb.chemparse(formula)
    except ValueError:
        amounts = {}
    if not amounts or not all(0 < number < math.inf for number in amounts.values()):
        raise InputError(f"'{formula}' is no chemical formula", mend)
    for element in amounts:
        # the tables end at californium
        if xraydb.atomic_number(element) > 98:
            raise InputError(f"{element} is not in the attenuation tables", mend)
    return amounts
