"""Materials of a light-yield bench: dispersion and densities, each with its source.

Solids and liquids were measured in air unless their source says otherwise: the difference to
vacuum (a factor 1.0003) is below what any of them means for light collection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.optics.dispersion import Cauchy, Dispersion, Gas, Sellmeier


@dataclass(frozen=True)
class Material:
    """Indices of refraction, and for solids and liquids of one formula the density."""

    #: As scenes write it.
    name: str
    #: What it is, and at which temperature.
    what: str
    #: Citation of the dispersion.
    source: str
    #: The ordinary ray's; the only one where there is no birefringence.
    ordinary: Dispersion
    extraordinary: Dispersion | None = None
    #: Standard error of the index, estimated: of the formula, and of one sample against another.
    sigma: float = 0.0
    #: Chemical formula.
    formula: str | None = None
    density_g_per_cm3: float | None = None

    @property
    def range_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength at which all of its indices are known."""
        both = [self.ordinary, self.extraordinary or self.ordinary]
        return max(each.shortest_nm for each in both), min(each.longest_nm for each in both)

    def index(self, wavelength_nm: ArrayLike) -> Array:
        """Index of refraction; of a birefringent crystal the mean (2 n_o + n_e) / 3.

        Light of all directions and polarisations meets the ordinary index in two of three
        directions of the field and the extraordinary one in the third; a scene has one index
        per volume. Float64, of the wavelengths' shape.

        Raises
        ------
        InputError
            If a wavelength is outside the range of the formula.
        """
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return ordinary
        return (2.0 * ordinary + self.extraordinary.index(wavelength_nm, self.name)) / 3.0

    def held_index(self, wavelength_nm: ArrayLike) -> Array:
        """`index`, and beyond the ends of its range that at the end."""
        return self.index(np.clip(wavelength_nm, *self.range_nm))

    def birefringence(self, wavelength_nm: ArrayLike) -> Array:
        """n_e - n_o; 0 where there is none. Parameters and errors as `index`."""
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return np.zeros_like(ordinary)
        return self.extraordinary.index(wavelength_nm, self.name) - ordinary

    def ray(self, suffix: str) -> Material:
        """One ray, ``o`` or ``e``, of a birefringent crystal, which it must be."""
        kind = {"o": "ordinary", "e": "extraordinary"}[suffix]
        name, what = f"{self.name}_{suffix}", f"{self.what}, {kind} ray"
        return replace(self, name=name, what=what, ordinary=getattr(self, kind), extraordinary=None)


_BOND = (
    "W. L. Bond, J. Appl. Phys. 36 (1965) 1674-1677, as fitted in Handbook of Optics, 3rd ed., "
    "vol. 4, McGraw-Hill 2009"
)
_DODGE = (
    "I. H. Malitson and M. J. Dodge, J. Opt. Soc. Am. 62 (1972) 1405; formula: M. J. Dodge in "
    "Handbook of Laser Science and Technology, vol. IV, CRC Press 1986, p. 30"
)
_RHEIMS = "J. Rheims, J. Koeser and T. Wriedt, Meas. Sci. Technol. 8 (1997) 601-605"
_SCHNEIDER = (
    "F. Schneider, J. Draheim, R. Kamberger and U. Wallrabe, Sens. Actuators A 151 (2009) 95-99"
)
_NOMINAL = "nominal value of the maker ({}), to be checked against the lot's data sheet"
# What the unknown dispersion of a silicone adds over 400..700 nm (that of PDMS is +0.016 and
# -0.005 away from 589 nm), with a data sheet's third digit.
_CONSTANT_SIGMA = 0.01


def _resonances(
    shortest_nm: float, longest_nm: float, strengths: tuple[float, ...],
    wavelengths_um: tuple[float, ...], constant: float = 0.0,
) -> Dispersion:  # fmt: skip
    """Sellmeier's formula by the resonances' wavelengths, not their squares, where it holds."""
    squares_um2 = tuple(each**2 for each in wavelengths_um)
    return Dispersion(Sellmeier(strengths, squares_um2, constant), shortest_nm, longest_nm)


def _of_maker(name: str, what: str, index: float, source: str) -> Material:
    """A coupling medium of which only one number, at no wavelength, has been published."""
    what = f"{what}; one number without dispersion, taken for the 589 nm of refractometers"
    one_number = Dispersion(Cauchy((index,)), 400.0, 700.0)
    return Material(name, what, source, one_number, sigma=_CONSTANT_SIGMA)


MATERIALS = (
    Material(
        "CaMoO4", "calcium molybdate, at room temperature", _BOND,
        _resonances(450.0, 3800.0, (2.7840, 1.2425), (0.1483, 11.576)),
        _resonances(450.0, 3800.0, (2.8045, 1.0055), (0.1542, 10.522)),
        sigma=0.002, formula="CaMoO4", density_g_per_cm3=4.25,
    ),
    Material(
        "CaWO4", "calcium tungstate, at room temperature", _BOND,
        _resonances(450.0, 4000.0, (2.5493, 0.9200), (0.1347, 10.815)),
        _resonances(450.0, 4000.0, (2.6041, 4.1237), (0.1379, 21.371)),
        sigma=0.002, formula="CaWO4", density_g_per_cm3=6.06,
    ),
    Material(
        "BK7", "N-BK7, the borosilicate crown glass of windows, at 20 C",
        "SCHOTT optical glass catalogue of 2017-01-20",
        Dispersion(Sellmeier((1.03961212, 0.231792344, 1.01046945),
                             (0.00600069867, 0.0200179144, 103.560653)), 300.0, 2500.0),
        sigma=0.0005, density_g_per_cm3=2.51,
    ),
    Material(
        "BOROFLOAT33",
        "borosilicate float glass, near that of photomultiplier windows, at room temperature",
        "SCHOTT, BOROFLOAT 33 Optical Properties, June 2021, as fitted in refractiveindex.info",
        _resonances(240.0, 1550.0, (0.78657, 0.18285), (0.10856, 4.427), constant=0.3542),
        sigma=0.001, density_g_per_cm3=2.23,
    ),
    Material(
        "fused_silica", "fused silica, at 20 C",
        "I. H. Malitson, J. Opt. Soc. Am. 55 (1965) 1205-1208",
        _resonances(210.0, 3710.0, (0.6961663, 0.4079426, 0.8974794),
                    (0.0684043, 0.1162414, 9.896161)),
        sigma=0.0001, formula="SiO2", density_g_per_cm3=2.20,
    ),
    Material(
        "sapphire", "synthetic sapphire, at 20 C", _DODGE,
        _resonances(200.0, 5000.0, (1.4313493, 0.65054713, 5.3414021),
                    (0.0726631, 0.1193242, 18.028251)),
        _resonances(200.0, 5000.0, (1.5039759, 0.55069141, 6.5927379),
                    (0.0740288, 0.1216529, 20.072248)),
        sigma=0.0005, formula="Al2O3", density_g_per_cm3=3.98,
    ),
    Material("vacuum", "vacuum", "by definition", Dispersion(Cauchy((1.0,)), 0.0, math.inf)),
    Material(
        "air", "dry air at 15 C, 101.325 kPa, 450 ppm of carbon dioxide",
        "P. E. Ciddor, Appl. Opt. 35 (1996) 1566-1573",
        Dispersion(Gas((0.05792105, 0.00167917), (238.0185, 57.362)), 230.0, 1690.0),
        sigma=0.00002,
    ),
    Material(
        "water", "distilled water at 20 C, against vacuum",
        "M. Daimon and A. Masumura, Appl. Opt. 46 (2007) 3811-3820",
        Dispersion(Sellmeier((5.684027565e-1, 1.726177391e-1, 2.086189578e-2, 1.130748688e-1),
                             (5.101829712e-3, 1.821153936e-2, 2.620722293e-2, 1.069792721e1)),
                   182.0, 1129.0),
        sigma=0.0003, formula="H2O", density_g_per_cm3=0.998,
    ),
    Material(
        "glycerol",
        "glycerol, at room temperature; it takes up water from the air, which lowers its index",
        "V. Gupta et al., Adv. Photonics Res. 3 (2022) 2200152, supporting information",
        Dispersion(Cauchy((1.46004, 3.94934611e-3, -1.77343e-5)), 400.0, 710.0),
        sigma=0.004, formula="C3H8O3", density_g_per_cm3=1.26,
    ),
    Material(
        "ethanol", "ethanol at 20 C", _RHEIMS,
        Dispersion(Cauchy((1.35265, 0.00306, 0.00002)), 476.5, 830.0),
        sigma=0.0005, formula="C2H6O", density_g_per_cm3=0.789,
    ),
    Material(
        "PDMS", "silicone rubber (Sylgard 184); its maker gives 1.412 at 589 nm, 0.02 less",
        _SCHNEIDER,
        Dispersion(Sellmeier((1.0093,), (0.013185,)), 350.0, 700.0),
        sigma=0.02,
    ),
    Material(
        "RTV615", "silicone rubber (RTV 615); its maker gives 1.406 at 589 nm, 0.024 less",
        _SCHNEIDER,
        Dispersion(Sellmeier((1.0057,), (0.013217,)), 350.0, 700.0),
        sigma=0.02,
    ),
    Material(
        "Cargille_06350", "fused-silica matching liquid, code 06350, at 25 C",
        "Cargille, Fused Silica Matching Liquid Code 06350 data sheet, 30 November 2017",
        Dispersion(Cauchy((1.44719, 3.83343e-3, 5.66134e-5)), 225.0, 1550.0),
        sigma=0.0005,
    ),
    Material(
        "Cargille_50350", "fused-silica matching liquid, code 50350, at 25 C",
        "Cargille, Fused Silica Matching Liquid Code 50350 data sheet, 30 November 2017",
        Dispersion(Cauchy((1.446902, 3.98963e-3, 3.757747e-5)), 225.0, 1550.0),
        sigma=0.0005,
    ),
    Material(
        "Cargille_BK7", "BK-7 matching liquid, at 25 C",
        "Cargille, BK-7 Matching Liquid data sheet, 27 March 2023",
        Dispersion(Cauchy((1.502639, 4.7089420e-3, 6.3670450e-5)), 350.0, 1550.0),
        sigma=0.0005,
    ),
    _of_maker(
        "Cargille_0607", "optical gel, code 0607", 1.46,
        "V. Alenkov et al., JINST 8 (2013) P06002, section 4",
    ),
    _of_maker("BC-630", "silicone grease BC-630", 1.465, _NOMINAL.format("Saint-Gobain")),
    _of_maker("EJ-550", "silicone grease EJ-550", 1.463, _NOMINAL.format("Eljen")),
)  # fmt: skip


_BY_NAME = {
    each.name.lower(): each
    for known in MATERIALS
    for each in (known, *((known.ray("o"), known.ray("e")) if known.extraordinary else ()))
}
#: Names of all materials, rays of birefringent crystals included.
NAMES = tuple(each.name for each in _BY_NAME.values())


def is_known(name: str) -> bool:
    """Whether the catalogue has a material of this name."""
    return name.strip().lower() in _BY_NAME


def material(name: str) -> Material:
    """A material of the catalogue, in capitals or not; ``CaMoO4_o`` and ``CaMoO4_e`` are two rays.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    try:
        return _BY_NAME[name.strip().lower()]
    except KeyError:
        raise InputError(f"no material is called '{name}'", did_you_mean(name, NAMES)) from None


def chemical_formula(name: str) -> str:
    """Chemical formula of a material of the catalogue; any other text is taken for a formula.

    Raises
    ------
    InputError
        If the material is a mixture: its name may look like a formula (BK7 is no boron).
    """
    if not is_known(name):
        return name.strip()
    known = material(name)
    if known.formula is None:
        problem = f"{known.name} has no chemical formula in the catalogue of materials"
        raise InputError(problem, "write a chemical formula such as CaMoO4")
    return known.formula


def density_of(formula: str) -> float | None:
    """Density in g/cm3 of the material of a chemical formula; None if there is none."""
    by_formula = {known.formula: known.density_g_per_cm3 for known in MATERIALS[::-1]}
    return by_formula.get(formula.strip())
