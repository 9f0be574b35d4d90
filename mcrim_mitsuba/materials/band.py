"""Index of refraction over an emission band: what one index for all its light leaves out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.materials.catalogue import material
from mcrim_mitsuba.materials.material import Material
from mcrim_mitsuba.physics.spectrum import Spectrum, average_over

#: Part of an emission that may lie where the index is not known.
LARGEST_OUTSIDE = 0.1
# Shares below this are rounding, or the last bin of a spectrum.
_NOTEWORTHY = 1e-4


@dataclass(frozen=True)
class IndexOverBand:
    """Index of a material, weighted with an emission spectrum.

    Attributes
    ----------
    material : Material
    mean : float
        Weighted mean; of a birefringent crystal that of (2 n_o + n_e) / 3.
    spread : float
        Standard deviation of the index over the band: a property of the light, no error of the
        mean.
    ordinary_mean : float
    extraordinary_mean : float or None
        None where there is no birefringence.
    mean_wavelength_nm : float
        Weighted mean of the wavelength.
    outside : float
        Share of the emission at wavelengths outside the range of the formula. There the index at
        the end of the range stands for it.
    outside_sigma : float
        By how much that may be wrong: what a straight line beyond the end would have added to the
        mean.
    """

    material: Material
    mean: float
    spread: float
    ordinary_mean: float
    extraordinary_mean: float | None
    mean_wavelength_nm: float
    outside: float
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
    """Index of a material over an emission spectrum.

    Parameters
    ----------
    name : str
        As for `material`.
    emission : Spectrum
        In any unit per nm; beyond its points it is 0.

    Raises
    ------
    InputError
        If the material is unknown, if more than `LARGEST_OUTSIDE` of the emission lies where its
        index is not, or if the emission has no area.
    """
    known = material(name)
    shortest, longest = known.range_nm
    grid = emission.wavelength_nm
    ends = [end for end in known.range_nm if grid[0] < end < grid[-1]]
    # a point at each end of the range: no stretch of the integral crosses it
    grid = np.union1d(grid, ends)
    emission = replace(emission, wavelength_nm=grid, values=emission.at(grid), sigmas=None)

    def over_range(index: Callable[[NDArray], NDArray]) -> tuple[float, float]:
        return average_over(emission, lambda each: index(np.clip(each, shortest, longest)))

    outside, _ = average_over(
        emission, lambda each: ((each < shortest) | (each > longest)).astype(float)
    )
    if outside > LARGEST_OUTSIDE:
        raise emission.refusal(
            f"{100 * outside:.0f} % of the emission is outside {shortest:g} to {longest:g} nm, "
            f"where the index of {known.name} is known",
            "give the index as a number, or of a material that is known over the whole band",
        )
    mean, spread = over_range(known.index)
    ordinary, _ = over_range(lambda each: known.ordinary.index(each, known.name))
    extraordinary, other = None, known.extraordinary
    if other is not None:
        extraordinary, _ = over_range(lambda each: other.index(each, known.name))
    missing = 0.0
    if outside > 0:
        missing, _ = average_over(emission, lambda each: _beyond_the_end(known, each))
    return IndexOverBand(
        material=known,
        mean=mean,
        spread=spread,
        ordinary_mean=ordinary,
        extraordinary_mean=extraordinary,
        mean_wavelength_nm=average_over(emission, lambda each: each)[0],
        outside=outside,
        outside_sigma=abs(missing),
    )


def _beyond_the_end(known: Material, wavelength_nm: NDArray) -> NDArray:
    """What a straight line beyond the nearer end of the range adds to the index there."""
    shortest, longest = known.range_nm
    step_nm = 1.0
    at_ends = known.index([shortest, shortest + step_nm, longest - step_nm, longest])
    first, last = np.diff(at_ends)[[0, -1]] / step_nm
    beyond = wavelength_nm - np.clip(wavelength_nm, shortest, longest)
    return beyond * np.where(beyond < 0, first, last)
