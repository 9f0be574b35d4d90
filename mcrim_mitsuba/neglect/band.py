"""The indices that a crystal has over its emission band."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.materials import IndexOverBand, Material, index_over, material
from mcrim_mitsuba.physics.spectrum import Spectrum, detected_light

#: Where there is no spectrum: a Gaussian band, its maximum and its full width at half maximum, of
#: the materials for which they are known. CaMoO4: V. B. Mikhailik and H. Kraus, Phys. Stat. Sol. B
#: 247 (2010) 1583, and section 4 of V. Alenkov et al., JINST 8 (2013) P06002.
USUAL_BANDS_NM = {"CaMoO4": (540.0, 150.0)}
#: Width of a band of which only the maximum is given: self-trapped excitons in oxides.
_USUAL_WIDTH_NM = 150.0
#: How far a Gaussian band is followed, in widths, and the step of all integrals.
_WIDTHS, _STEP_NM = 1.5, 1.0


@dataclass(frozen=True, eq=False)
class BandIndices:
    """A material's indices at the wavelengths of its light.

    Attributes
    ----------
    over : IndexOverBand
        Their means, with their errors.
    indices, parts : (wavelengths,) float64
        Mean index of all directions and polarisations, and how much of the light has it; the
        parts sum to 1.
    origin : str
        Where the band is from, in words.
    """

    over: IndexOverBand
    indices: NDArray[np.float64]
    parts: NDArray[np.float64]
    origin: str

    @property
    def material(self) -> Material:
        """Whose index it is."""
        return self.over.material


def indices_over_band(
    name: str,
    emission: Spectrum | None = None,
    quantum_efficiency: Spectrum | None = None,
    wavelength_nm: float | None = None,
) -> BandIndices:
    """A material's indices over an emission band.

    Light counts as it is detected: by the emission, times the quantum efficiency where it is
    known. Beyond the range of the material's formula the index at its end stands in.

    Parameters
    ----------
    name : str
        Of the catalogue of materials.
    emission, quantum_efficiency : Spectrum, optional
        Without an emission, a Gaussian band stands in for it.
    wavelength_nm : float, optional
        That band's maximum; `USUAL_BANDS_NM` without it.

    Raises
    ------
    InputError
        If the material is unknown, if nothing tells where its band is, or if its index is not
        known over too much of it.
    """
    found = material(name)
    if emission is None:
        emission, origin = _gaussian(found, wavelength_nm)
    else:
        origin = f"the emission of {emission.name}" if emission.name else "the emission"
        if quantum_efficiency is not None:
            emission = detected_light(emission, quantum_efficiency)
            origin += " as the tube sees it"
    over = index_over(found.name, emission)
    steps = math.ceil((emission.last_nm - emission.first_nm) / _STEP_NM)
    at = np.linspace(emission.first_nm, emission.last_nm, steps + 1)
    parts = np.clip(np.interp(at, emission.wavelength_nm, emission.values), 0.0, None)
    return BandIndices(over, found.index(np.clip(at, *found.range_nm)), parts / parts.sum(), origin)


def _gaussian(found: Material, wavelength_nm: float | None) -> tuple[Spectrum, str]:
    """A Gaussian band, and what it is in words."""
    usual = USUAL_BANDS_NM.get(found.name)
    maximum, width = usual if usual is not None else (wavelength_nm, _USUAL_WIDTH_NM)
    maximum = maximum if wavelength_nm is None else wavelength_nm
    if maximum is None:
        raise InputError(
            f"nothing tells where {found.name} emits",
            "give its emission (--emission) or the maximum of its band (--wavelength-nm)",
        )
    at = maximum + width * np.linspace(-_WIDTHS, _WIDTHS, round(2 * _WIDTHS * width / _STEP_NM) + 1)
    values = np.exp(-4.0 * math.log(2.0) * ((at - maximum) / width) ** 2)
    return Spectrum(at, values), (
        f"an assumed Gaussian band about {maximum:g} nm, {width:g} nm wide"
    )
