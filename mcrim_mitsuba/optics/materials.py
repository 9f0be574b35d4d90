"""Materials of a light-yield bench: indices, densities and light, with sources; a table beside.

What the table names has its dispersion from refractiveindex.info, or what that lacks. Any entry of
that database is a material too, as ``rii:main/BaF2/Malitson``. Solids and liquids were measured in
air unless their source says otherwise: the difference to vacuum (a factor 1.0003) is below what any
of them means for light collection.
"""

from __future__ import annotations

import functools
import re
import tomllib
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.optics.dispersion import Dispersion, MeanFormula, NumberedFormula
from mcrim_mitsuba.optics.refractiveindex_info import AXES, PREFIX, RAYS, Page, read_pages

#: Extinction beyond which no light crosses a part: at 500 nm it falls to 1/e in 4 micrometres.
OPAQUE = 0.01


@dataclass(frozen=True)
class Material:
    """Indices of refraction; density and light, as far as they are known."""

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
    #: The imaginary part of the index, k; None where it is not known.
    extinction: Dispersion | None = None
    #: Standard error of the index, estimated: of the formula, and of one sample against another;
    #: 0 where nothing is said of it.
    sigma: float = 0.0
    #: Chemical formula.
    formula: str | None = None
    density_g_per_cm3: float | None = None
    #: Maximum of a scintillator's emission, its full width at half maximum, and the decay time of
    #: the component with most of the light.
    emission_nm: float | None = None
    emission_fwhm_nm: float | None = None
    decay_ns: float | None = None
    #: Citation of density, emission and decay.
    properties_source: str | None = None

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
        return not (isinstance(formula, NumberedFormula) and len(formula.coefficients) == 1)

    def held_index(self, wavelength_nm: ArrayLike) -> Array:
        """Index of refraction; beyond the range of its formula that at the nearer end."""
        return self.index(np.clip(wavelength_nm, *self.range_nm))

    def is_opaque(self, wavelength_nm: float) -> bool:
        """Whether it absorbs light within micrometres, as metals do, as far as k is known.

        Light does not cross it, and Fresnel's formulas for two transparent media do not hold.
        """
        k = self.extinction
        return bool(k is not None and k.covers(wavelength_nm) and k.at(wavelength_nm) > OPAQUE)

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


_TABLE: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)
#: Names of all materials of the table, rays of birefringent crystals included.
NAMES = tuple(
    name + suffix
    for name, entries in _TABLE.items()
    for suffix in (("", "_o", "_e") if entries.get("birefringent") else ("",))
)
_BY_NAME = {name.lower(): name for name in NAMES}
#: Books of the database's first shelf are called by their formula.
_FORMULA = re.compile(r"main/((?:[A-Z][a-z]?[0-9]*)+)/")


def is_known(name: str) -> bool:
    """Whether a text is a material's name, no more: the table's, or of the database's form."""
    name = name.strip().lower()
    return name in _BY_NAME or (name.startswith(PREFIX) and "@" not in name)


@functools.lru_cache(maxsize=256)
def material(name: str) -> Material:
    """A material, or a ray (``CaMoO4_o``, ``CaMoO4_e``), in capitals or not; else InputError.

    The table's, or, where the name begins with ``rii:``, an entry of refractiveindex.info.
    """
    asked = name.strip()
    if asked.lower().startswith(PREFIX):
        return _of_database(read_pages(asked[len(PREFIX) :]))
    known = _BY_NAME.get(asked.lower())
    if known is None:
        mend = f"{did_you_mean(asked, NAMES)}; or {PREFIX}shelf/book/page of refractiveindex.info"
        raise InputError(f"no material is called '{name}'", mend)
    if known not in _TABLE:
        return material(known[:-2]).ray(known[-1])
    entries = dict(_TABLE[known])
    endings = RAYS if entries.pop("birefringent", False) else ("",)
    if (path := entries.pop("database", None)) is not None:
        return replace(_of_database(read_pages(path, (endings,))), name=known, **entries)
    n, limits_nm = entries.pop("n"), entries.pop("range_nm")
    n = n if isinstance(n, dict) else {"number": 5, "coefficients": [n]}
    formula = NumberedFormula(n["number"], tuple(n["coefficients"]))
    return Material(known, ordinary=Dispersion(formula, *limits_nm), **entries)


def catalogue() -> tuple[Material, ...]:
    """The materials of the table, birefringent crystals once."""
    return tuple(map(material, _TABLE))


def _of_database(pages: tuple[Page, ...]) -> Material:
    """One page of the database, or the rays of a crystal; of a biaxial one their mean."""
    first, rays = pages[0], [page.index for page in pages]
    name = first.path if len(pages) == 1 else first.path.removesuffix(RAYS[0]).removesuffix(AXES[0])
    ordinary, extraordinary = rays[0], rays[1] if len(pages) == len(RAYS) else None
    if len(pages) == len(AXES):
        limits_nm = max(r.shortest_nm for r in rays), min(r.longest_nm for r in rays)
        ordinary = Dispersion(MeanFormula(tuple(r.formula for r in rays)), *limits_nm)
    formula = _FORMULA.match(name)
    return Material(
        PREFIX + name,
        "; and ".join(page.what for page in pages),
        first.source,
        ordinary,
        extraordinary=extraordinary,
        extinction=first.extinction,
        formula=formula and formula[1],
    )


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


def density_of(name: str) -> float | None:
    """Density in g/cm3 of a material, else of the first with a formula; None if not known."""
    wanted, densities = name.strip(), "density_g_per_cm3"
    if is_known(wanted):
        medium = material(wanted)
        if medium.density_g_per_cm3 is not None or medium.formula is None:
            return medium.density_g_per_cm3
        wanted = medium.formula
    of_it = (entry for entry in _TABLE.values() if entry.get("formula") == wanted)
    return next((entry[densities] for entry in of_it if densities in entry), None)
