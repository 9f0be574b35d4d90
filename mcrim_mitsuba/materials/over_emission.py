"""A material's index as a function of wavelength that serves a whole emission spectrum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.materials.band import index_over
from mcrim_mitsuba.materials.material import Material
from mcrim_mitsuba.physics.spectrum import Spectrum


@dataclass(frozen=True)
class IndexCurve:
    """Index of a material over wavelength.

    Attributes
    ----------
    function : callable
        From wavelengths in nm to indices; beyond the range of the material's formula it stays at
        the range's end.
    sigma : float
        Standard error of the index, common to all wavelengths.
    notes : tuple of str
        What the reader must know before using it.
    """

    function: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    sigma: float
    notes: tuple[str, ...]


def index_curve(name: str, emission: Spectrum) -> IndexCurve:
    """The index wherever a crystal emits.

    Parameters
    ----------
    name : str
        As for `catalogue.material`.
    emission : Spectrum

    Raises
    ------
    InputError
        As `band.index_over`: an unknown material, or too much of the emission out of its range.
    """
    band = index_over(name, emission)
    return IndexCurve(held_index(band.material), band.sigma, band.notes)


def held_index(known: Material) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """A material's index as a function of wavelengths in nm, held beyond the range's ends."""
    shortest, longest = known.range_nm
    return lambda wavelength_nm: known.index(np.clip(wavelength_nm, shortest, longest))
