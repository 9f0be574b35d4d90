"""Finds materials by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.suggest import did_you_mean
from mcrim_mitsuba.materials.data import MATERIALS
from mcrim_mitsuba.materials.material import Material

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
    """A material of the catalogue.

    Parameters
    ----------
    name : str
        In capitals or not; ``CaMoO4_o`` and ``CaMoO4_e`` are the two rays of ``CaMoO4``.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    try:
        return _BY_NAME[name.strip().lower()]
    except KeyError:
        raise InputError(f"no material is called '{name}'", did_you_mean(name, NAMES)) from None


def index(name: str, wavelength_nm: ArrayLike) -> float | NDArray[np.float64]:
    """Index of refraction of a material.

    Parameters
    ----------
    name : str
        As for `material`; the name of a birefringent crystal alone stands for the mean over
        directions and polarisations, (2 n_o + n_e) / 3.
    wavelength_nm : float or array

    Returns
    -------
    float or ndarray of float64
        Of the shape of the wavelengths.

    Raises
    ------
    InputError
        If the material is unknown, or a wavelength outside the range of its formula.
    """
    found = material(name).index(wavelength_nm)
    return float(found) if found.ndim == 0 else found


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
        raise InputError(
            f"{known.name} has no chemical formula in the catalogue of materials",
            "write a chemical formula such as CaMoO4",
        )
    return known.formula


def density_of(formula: str) -> float | None:
    """Density in g/cm3 of the material of a chemical formula; None if there is none."""
    for known in MATERIALS:
        if known.formula is not None and known.formula == formula.strip():
            return known.density_g_per_cm3
    return None
