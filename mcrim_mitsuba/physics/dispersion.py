"""Refractive index by wavelength: the formulas in which dispersion is published.

Formulas take the wavelength in micrometres, as their sources do; `Dispersion` takes
nanometres and refuses what lies outside the range that was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.errors import InputError

NM_PER_UM = 1000.0


class Formula(Protocol):
    """Index of refraction as a function of the wavelength."""

    def __call__(self, wavelength_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Index at each wavelength (micrometres)."""
        ...


@dataclass(frozen=True)
class Sellmeier:
    """n^2 = 1 + constant + sum of B l^2 / (l^2 - C).

    Attributes
    ----------
    strengths : tuple of float
        B of each resonance.
    squares_um2 : tuple of float
        C of each resonance, the square of its wavelength in micrometres.
    constant : float
        What resonances far away add.
    """

    strengths: tuple[float, ...]
    squares_um2: tuple[float, ...]
    constant: float = 0.0

    @classmethod
    def of_resonances(
        cls, strengths: Sequence[float], resonances_um: Sequence[float], constant: float = 0.0
    ) -> Sellmeier:
        """The form whose sources give the resonances' wavelengths, not their squares."""
        return cls(tuple(strengths), tuple(each**2 for each in resonances_um), constant)

    def __call__(self, wavelength_um: NDArray[np.float64]) -> NDArray[np.float64]:
        square = wavelength_um**2
        terms = zip(self.strengths, self.squares_um2, strict=True)
        return np.sqrt(1.0 + self.constant + sum(b * square / (square - c) for b, c in terms))


@dataclass(frozen=True)
class Cauchy:
    """n = A + B / l^2 + C / l^4; `coefficients` are A, B in um^2 and C in um^4."""

    coefficients: tuple[float, ...]

    def __call__(self, wavelength_um: NDArray[np.float64]) -> NDArray[np.float64]:
        terms = (a * wavelength_um ** (-2.0 * k) for k, a in enumerate(self.coefficients))
        return np.asarray(sum(terms))


@dataclass(frozen=True)
class Gas:
    """n = 1 + sum of B / (C - 1/l^2), the form of Ciddor's air.

    Attributes
    ----------
    strengths_per_um2, squares_per_um2 : tuple of float
        B and C of each resonance, in squares of the wave number (1/um^2).
    """

    strengths_per_um2: tuple[float, ...]
    squares_per_um2: tuple[float, ...]

    def __call__(self, wavelength_um: NDArray[np.float64]) -> NDArray[np.float64]:
        wave_number = wavelength_um**-2.0
        terms = zip(self.strengths_per_um2, self.squares_per_um2, strict=True)
        return np.asarray(1.0 + sum(b / (c - wave_number) for b, c in terms))


@dataclass(frozen=True)
class Constant:
    """One number for all wavelengths: nobody has published more."""

    index: float

    def __call__(self, wavelength_um: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full_like(wavelength_um, self.index)


@dataclass(frozen=True)
class Dispersion:
    """A formula, and the wavelengths at which it holds.

    Attributes
    ----------
    formula : Formula
    shortest_nm, longest_nm : float
        Limits of the measurements behind it, both included.
    """

    formula: Formula
    shortest_nm: float
    longest_nm: float

    def covers(self, wavelength_nm: ArrayLike) -> NDArray[np.bool_]:
        """Whether each wavelength lies in the range."""
        wavelength_nm = np.asarray(wavelength_nm, dtype=float)
        return (self.shortest_nm <= wavelength_nm) & (wavelength_nm <= self.longest_nm)

    def index(self, wavelength_nm: ArrayLike, material: str) -> NDArray[np.float64]:
        """Index of refraction; nothing is extrapolated.

        Parameters
        ----------
        wavelength_nm : float or array
        material : str
            Its name, for the refusal.

        Returns
        -------
        ndarray of float64
            Of the same shape.

        Raises
        ------
        InputError
            If a wavelength is outside the range.
        """
        wavelength_nm = np.asarray(wavelength_nm, dtype=float)
        outside = wavelength_nm[~self.covers(wavelength_nm)]
        if outside.size:
            raise InputError(
                f"the index of {material} is known from {self.shortest_nm:g} to "
                f"{self.longest_nm:g} nm, not at {outside.flat[0]:.10g} nm",
                "name a wavelength in this range, or give the index as a number",
            )
        return self.formula(wavelength_nm / NM_PER_UM)
