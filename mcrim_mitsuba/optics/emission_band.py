"""Indices over an emission band: what one index for all of a scintillator's light leaves out."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.optics.dispersion import Dispersion
from mcrim_mitsuba.optics.materials import Material, material
from mcrim_mitsuba.optics.spectrum import Spectrum, average_over, detected_light

#: Part of an emission that may lie where the index is not known.
LARGEST_OUTSIDE = 0.1
# Shares below this are rounding, or the last bin of a spectrum.
_NOTEWORTHY = 1e-4


@dataclass(frozen=True)
class IndexOverBand:
    """Index of a material, weighted with an emission spectrum."""

    material: Material
    #: Weighted mean; of a birefringent crystal that of (2 n_o + n_e) / 3.
    mean: float
    #: Standard deviation of the index over the band: a property of the light, no error of the mean.
    spread: float
    ordinary_mean: float
    _: KW_ONLY
    #: None where there is no birefringence.
    extraordinary_mean: float | None
    #: Weighted mean of the wavelength.
    mean_wavelength_nm: float
    #: Share of the emission at wavelengths outside the range of the formula. There the index at
    #: the end of the range stands for it.
    outside: float
    #: By how much that may be wrong: what a straight line beyond the end would have added to the
    #: mean.
    outside_sigma: float

    @property
    def birefringence(self) -> float:
        """Mean of n_e - n_o; 0 where there is none."""
        if self.extraordinary_mean is None:
            return 0.0
        return self.extraordinary_mean - self.ordinary_mean

    @property
    def sigma(self) -> float:
        """Standard error of `mean`."""
        return math.hypot(self.material.sigma, self.outside_sigma)

    @property
    def notes(self) -> tuple[str, ...]:
        """What must be known before using the mean."""
        if self.outside < _NOTEWORTHY:
            return ()
        shortest, longest = self.material.range_nm
        return (
            f"{100 * self.outside:.1f} % of the emission is outside {shortest:g} to {longest:g} "
            f"nm, where the index of {self.material.name} is known; the index at the end of the "
            f"range stands for it, which may be wrong by {self.outside_sigma:.2g}",
        )


def index_over(name: str, emission: Spectrum) -> IndexOverBand:
    """Index of a material over an emission, in any unit per nm; beyond its points it is 0.

    Raises InputError if the material is unknown, if more than `LARGEST_OUTSIDE` of the emission
    lies where its index is not, or if the emission has no area.
    """
    medium = material(name)
    shortest, longest = medium.range_nm
    # a point at each end of the range: no stretch of the integral crosses it
    ends = [end for end in medium.range_nm if emission.first_nm < end < emission.last_nm]
    grid = np.union1d(emission.wavelength_nm, ends)
    emission = replace(emission, wavelength_nm=grid, values=emission.at(grid), sigmas=None)

    def mean_of(ray: Dispersion) -> float:
        """Of one ray's index, beyond the range of both that at its end."""
        return average_over(
            emission, lambda nm: ray.index(np.clip(nm, shortest, longest), medium.name)
        )[0]

    outside, _ = average_over(emission, lambda nm: ((nm < shortest) | (nm > longest)).astype(float))
    if outside > LARGEST_OUTSIDE:
        raise emission.refusal(
            f"{100 * outside:.0f} % of the emission is outside {shortest:g} to {longest:g} nm, "
            f"where the index of {medium.name} is known",
            "give the index as a number, or of a material that is known over the whole band",
        )
    mean, spread = average_over(emission, medium.held_index)
    change_beyond = 0.0
    if outside > 0:
        change_beyond, _ = average_over(emission, lambda nm: _beyond_the_end(medium, nm))
    return IndexOverBand(
        material=medium,
        mean=mean,
        spread=spread,
        ordinary_mean=mean_of(medium.ordinary),
        extraordinary_mean=None if medium.extraordinary is None else mean_of(medium.extraordinary),
        mean_wavelength_nm=average_over(emission, lambda nm: nm)[0],
        outside=outside,
        outside_sigma=abs(change_beyond),
    )


def _beyond_the_end(medium: Material, wavelength_nm: Array) -> Array:
    """What a straight line beyond the nearer end of the range adds to the index there."""
    shortest, longest = medium.range_nm
    # slopes over the first and the last nanometre of the range
    at_ends = medium.index([shortest, shortest + 1.0, longest - 1.0, longest])
    first_slope, last_slope = np.diff(at_ends)[[0, -1]]
    beyond = wavelength_nm - np.clip(wavelength_nm, shortest, longest)
    return beyond * np.where(beyond < 0, first_slope, last_slope)


#: The maximum of light of which nothing else is said: that of CaMoO4.
USUAL_NM = 540.0
#: Width of a band of which no more than the maximum is given: self-trapped excitons in oxides.
USUAL_WIDTH_NM = 150.0
#: How far a Gaussian band is followed, in widths.
WIDTHS = 1.5
#: Step of all integrals.
_STEP_NM = 1.0
#: Points of Gauss and Legendre over a band.
_POINTS = 12


@dataclass(frozen=True, eq=False)
class BandIndices:
    """A material's indices at the wavelengths of its light."""

    #: Their means, with their errors.
    over: IndexOverBand
    #: (wavelengths,) float64: Mean index of all directions and polarisations, and how much of the
    #: light has it; the parts sum to 1.
    indices: Array
    parts: Array
    #: Where the band is from, in words.
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
    known. Without an emission a Gaussian band about `wavelength_nm`, or as the catalogue has it,
    stands in for it, and beyond the range of the material's formula the index at its end.

    Raises InputError if the material is unknown, if nothing tells where its band is, or if its
    index is not known over too much of it.
    """
    medium = material(name)
    if emission is None:
        emission, origin = _gaussian(medium, wavelength_nm)
    else:
        origin = f"the emission of {emission.name}" if emission.name else "the emission"
        if quantum_efficiency is not None:
            emission = detected_light(emission, quantum_efficiency)
            origin += " as the tube sees it"
    over = index_over(medium.name, emission)
    steps = math.ceil((emission.last_nm - emission.first_nm) / _STEP_NM)
    nm = np.linspace(emission.first_nm, emission.last_nm, steps + 1)
    # noise about 0 is no light
    parts = np.clip(np.interp(nm, emission.wavelength_nm, emission.values), 0.0, None)
    return BandIndices(over, medium.held_index(nm), parts / parts.sum(), origin)


def _gaussian(medium: Material, wavelength_nm: float | None) -> tuple[Spectrum, str]:
    """A Gaussian band at a wavelength, or where the material usually emits; its origin in words."""
    fwhm = medium.emission_fwhm_nm or USUAL_WIDTH_NM
    maximum = medium.emission_nm if wavelength_nm is None else wavelength_nm
    # of a maximum alone the catalogue does not tell how much of the light has which index
    if maximum is None or (wavelength_nm is None and medium.emission_fwhm_nm is None):
        problem = f"nothing tells where {medium.name} emits"
        mend = "give its emission (--emission) or the maximum of its band (--wavelength-nm)"
        if maximum is not None:
            problem = f"{medium.name} emits about {maximum:g} nm, but nothing tells over what width"
            mend = f"give its emission (--emission), or --wavelength-nm {maximum:g} for {fwhm:g} nm"
        raise InputError(problem, mend)
    nm = maximum + fwhm * np.linspace(-WIDTHS, WIDTHS, round(2 * WIDTHS * fwhm / _STEP_NM) + 1)
    values = np.exp(-4.0 * math.log(2.0) * ((nm - maximum) / fwhm) ** 2)
    return Spectrum(nm, values), f"an assumed Gaussian band about {maximum:g} nm, {fwhm:g} nm wide"


def scattering_of_colours(
    exponent: float, wavelength_nm: float, bandwidth_nm: float
) -> tuple[Array, Array]:
    """Parts of the light of a Gaussian band, and scattering over that at its maximum.

    alpha_scat goes as wavelength to the power of -exponent; the band, whose full width at half
    maximum is `bandwidth_nm`, is cut off at `WIDTHS`. By Gauss and Legendre: means of what is
    smooth over the band are right to 1e-5. Both (points,) float64; parts sum to 1.
    """
    x, weights = np.polynomial.legendre.leggauss(_POINTS)
    # in standard deviations of the band
    z = WIDTHS * FWHM * x
    parts = weights * np.exp(-0.5 * z**2)
    wavelengths_over_maximum = 1.0 + z / FWHM * bandwidth_nm / wavelength_nm
    return parts / parts.sum(), wavelengths_over_maximum**-exponent
