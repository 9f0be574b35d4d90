"""A material's index as a function of wavelength that serves a whole emission spectrum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.materials.band import index_over
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
    shortest, longest = band.material.range_nm
    return IndexCurve(
        lambda nm: band.material.index(np.clip(nm, shortest, longest)), band.sigma, band.notes
    )
