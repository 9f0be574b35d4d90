"""Materials of a light-yield bench: indices and densities, each with its source; a table beside.

Solids and liquids were measured in air unless their source says otherwise: the difference to
vacuum (a factor 1.0003) is below what any of them means for light collection.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.optics.dispersion import Cauchy, Dispersion, Formula, Gas, Sellmeier


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
    _: KW_ONLY
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
        return max(ray.shortest_nm for ray in both), min(ray.longest_nm for ray in both)

    def index(self, wavelength_nm: ArrayLike) -> Array:
        """Index of refraction; of a birefringent crystal the mean (2 n_o + n_e) / 3.

        Light of all directions and polarisations meets the ordinary index in two of three
        directions of the field and the extraordinary one in the third; a scene has one index
        per volume. Float64, of the wavelengths' shape.

        Raises InputError if a wavelength is outside the range of the formula.
        """
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return ordinary
        return (2.0 * ordinary + self.extraordinary.index(wavelength_nm, self.name)) / 3.0

    def group_index(self, wavelength_nm: ArrayLike) -> Array:
        """n - lambda dn/dlambda, a mean as of `index`; InputError outside the formula's range."""
        ordinary = self.ordinary.group_index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return ordinary
        extraordinary = self.extraordinary.group_index(wavelength_nm, self.name)
        return (2.0 * ordinary + extraordinary) / 3.0

    @property
    def is_dispersive(self) -> bool:
        """Whether its index is known at more than one wavelength."""
        formula = self.ordinary.formula
        return not (isinstance(formula, Cauchy) and len(formula.coefficients) == 1)

    def held_index(self, wavelength_nm: ArrayLike) -> Array:
        """Index of refraction; beyond the range of its formula that at the nearer end."""
        return self.index(np.clip(wavelength_nm, *self.range_nm))

    def birefringence(self, wavelength_nm: ArrayLike) -> Array:
        """n_e - n_o, 0 without a second ray; refuses wavelengths outside the formula's range."""
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return np.zeros_like(ordinary)
        return self.extraordinary.index(wavelength_nm, self.name) - ordinary

    def ray(self, suffix: str) -> Material:
        """One ray of a birefringent crystal: `suffix` ``o`` the ordinary, ``e`` the other."""
        kind = {"o": "ordinary", "e": "extraordinary"}[suffix]
        name, what = f"{self.name}_{suffix}", f"{self.what}, {kind} ray"
        return replace(self, name=name, what=what, ordinary=getattr(self, kind), extraordinary=None)


def _formula(entries: dict[str, Any]) -> Formula:
    """The dispersion formula that has these parameters: Cauchy's, a gas's or Sellmeier's."""
    parameters: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in entries.items()
    }
    if "wavelengths_um" in parameters:
        wavelengths_um = parameters.pop("wavelengths_um")
        parameters["squares_um2"] = tuple(length_um**2 for length_um in wavelengths_um)
    if "coefficients" in parameters:
        return Cauchy(**parameters)
    return Gas(**parameters) if "strengths_per_um2" in parameters else Sellmeier(**parameters)


def _read_materials() -> Iterator[Material]:
    """The catalogue's materials, from the TOML file beside this module."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    for name, entries in tomllib.loads(text).items():
        limits_nm = entries.pop("range_nm")
        for ray in {"ordinary", "extraordinary"} & entries.keys():
            entries[ray] = Dispersion(_formula(entries[ray]), *limits_nm)
        yield Material(name, **entries)


MATERIALS = tuple(_read_materials())
_BY_NAME = {
    medium.name.lower(): medium
    for mean in MATERIALS
    for medium in (mean, *((mean.ray("o"), mean.ray("e")) if mean.extraordinary else ()))
}
#: Names of all materials, rays of birefringent crystals included.
NAMES = tuple(medium.name for medium in _BY_NAME.values())


def is_known(name: str) -> bool:
    """Whether the catalogue has a material of this name."""
    return name.strip().lower() in _BY_NAME


def material(name: str) -> Material:
    """A material, or a ray (``CaMoO4_o``, ``CaMoO4_e``), in capitals or not; else InputError."""
    try:
        return _BY_NAME[name.strip().lower()]
    except KeyError:
        raise InputError(f"no material is called '{name}'", did_you_mean(name, NAMES)) from None


def chemical_formula(name: str) -> str:
    """Chemical formula of a material of the catalogue; any other text is taken for a formula.

    Raises InputError if the material is a mixture: its name may look like a formula (BK7 is no
    boron).
    """
    if not is_known(name):
        return name.strip()
    medium = material(name)
    if medium.formula is None:
        problem = f"{medium.name} has no chemical formula in the catalogue of materials"
        raise InputError(problem, "write a chemical formula such as CaMoO4")
    return medium.formula


def density_of(formula: str) -> float | None:
    """Density in g/cm3 of the material of a chemical formula; None if there is none."""
    # of several of one formula the first counts
    by_formula = {medium.formula: medium.density_g_per_cm3 for medium in MATERIALS[::-1]}
    return by_formula.get(formula.strip())
