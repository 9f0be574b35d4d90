"""Refractive index by wavelength, and what one index stands for in a uniaxial crystal.

In a direction at the angle theta to the optic axis a uniaxial crystal carries two waves, the
ordinary one with n_o and the extraordinary one with n(theta),

    1 / n(theta)^2 = cos^2(theta) / n_o^2 + sin^2(theta) / n_e^2

(M. Born and E. Wolf, Principles of Optics, 7th ed., Cambridge 1999, section 15.3). Unpolarised
scintillation is born half in each, evenly over all directions: the mean index is (2 n_o + n_e) / 3
to first order in n_e - n_o, and that is what one index has to be. Two errors remain.

The spread of the indices about their mean. If a photon kept its wave all the way, eta would be the
mean of the efficiencies of all indices; if every reflection mixed the two waves, as oblique ones
do, eta would be nearly that of the mean index. The difference of the two is of second order in
n_e - n_o and bounds this error.

The direction of the optic axis. What gets out through the face above the detector flies near the
face's normal. With the axis at the angle beta to the normal this light has the mean index
(n_o + n(beta)) / 2, or n_o + (n_e - n_o) sin^2(beta) / 2: n_o for a crystal that is cut across its
axis, half-way to n_e for one that is cut along it. For an axis of unknown direction sin^2(beta) has
the mean 2/3 (the mean index again) and the variance 4/45, so that the index that matters is
uncertain by (n_e - n_o) / sqrt(45), which is 0.30 of half the span from n_o to n_e. The error is of
first order, and an upper estimate: light that leaves at slant angles, or through other faces,
averages over directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError

NM_PER_UM = 1000.0
#: Index of refraction at wavelengths in micrometres; each of the forms below is one.
Formula = Callable[[Array], Array]


@dataclass(frozen=True)
class Sellmeier:
    """n^2 = 1 + constant + sum of B l^2 / (l^2 - C)."""

    #: B of each resonance.
    strengths: tuple[float, ...]
    #: C of each resonance, the square of its wavelength in micrometres.
    squares_um2: tuple[float, ...]
    #: What resonances far away add.
    constant: float = 0.0

    def __call__(self, wavelength_um: Array) -> Array:
        square = wavelength_um**2
        terms = zip(self.strengths, self.squares_um2, strict=True)
        return np.sqrt(1.0 + self.constant + sum(b * square / (square - c) for b, c in terms))


@dataclass(frozen=True)
class Cauchy:
    """n = A + B / l^2 + C / l^4; `coefficients` are A, B in um^2 and C in um^4.

    A alone is one number for all wavelengths, where nobody has published more.
    """

    coefficients: tuple[float, ...]

    def __call__(self, wavelength_um: Array) -> Array:
        terms = (a * wavelength_um ** (-2.0 * k) for k, a in enumerate(self.coefficients))
        return np.asarray(sum(terms))


@dataclass(frozen=True)
class Gas:
    """n = 1 + sum of B / (C - 1/l^2), the form of Ciddor's air."""

    #: B and C of each resonance, in squares of the wave number (1/um^2).
    strengths_per_um2: tuple[float, ...]
    squares_per_um2: tuple[float, ...]

    def __call__(self, wavelength_um: Array) -> Array:
        wave_number = wavelength_um**-2.0
        terms = zip(self.strengths_per_um2, self.squares_per_um2, strict=True)
        return np.asarray(1.0 + sum(b / (c - wave_number) for b, c in terms))


@dataclass(frozen=True)
class Dispersion:
    """A formula, and the wavelengths at which it holds."""

    formula: Formula
    #: Limits of the measurements behind it, both included.
    shortest_nm: float
    longest_nm: float

    def covers(self, wavelength_nm: ArrayLike) -> NDArray[np.bool_]:
        """Whether each wavelength lies in the range."""
        wavelength_nm = np.asarray(wavelength_nm, dtype=float)
        return (self.shortest_nm <= wavelength_nm) & (wavelength_nm <= self.longest_nm)

    def index(self, wavelength_nm: ArrayLike, material: str) -> Array:
        """Index of refraction, float64 of the wavelengths' shape; nothing is extrapolated.

        Raises InputError if a wavelength is outside the range; it names the `material`.
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

    def group_index(self, wavelength_nm: ArrayLike, material: str) -> Array:
        """n - lambda dn/dlambda, the speed of light in vacuum over that of a pulse.

        Raises InputError if a wavelength is outside the range; it names the `material`.
        """
        index, um = self.index(wavelength_nm, material), np.asarray(wavelength_nm) / NM_PER_UM
        above, below = (self.formula(um * (1.0 + step)) for step in (_STEP, -_STEP))
        # relative steps: lambda dn/dlambda is dn by them
        return index - (above - below) / (2.0 * _STEP)


#: Relative step of a derivative by the wavelength: right to 1e-9, also beside a range's end.
_STEP = 1e-4
#: Directions over which the extraordinary wave is averaged: exact to the twelfth digit.
_DIRECTIONS = 8


def extraordinary_index(n_ordinary: float, n_extraordinary: float, cos_theta: ArrayLike) -> Array:
    """n(theta) of the extraordinary wave, theta between the wave's normal and the optic axis.

    Raises InputError if an index is below 1 or a cosine is outside -1..1.
    """
    _refuse_indices(n_ordinary, n_extraordinary)
    square = np.asarray(cos_theta, dtype=float) ** 2
    if not np.all(square <= 1.0):
        raise InputError("a cosine is outside -1..1", "count the angle from the optic axis")
    return 1.0 / np.sqrt(square / n_ordinary**2 + (1.0 - square) / n_extraordinary**2)


def indices_of_light(n_ordinary: float, n_extraordinary: float) -> tuple[Array, Array]:
    """Indices that unpolarised light of all directions has, and their parts, (indices,) each.

    The parts sum to 1; the first index is the ordinary one, with one half.

    Raises InputError if an index is below 1.
    """
    # cosines of the angle to the axis from 0 to 1; weights sum to 2, half of the light has them
    nodes, weights = np.polynomial.legendre.leggauss(_DIRECTIONS)
    extraordinary = extraordinary_index(n_ordinary, n_extraordinary, (1.0 + nodes) / 2)
    return np.array([n_ordinary, *extraordinary]), np.array([0.5, *(weights / 4)])


def orientation_sigma(n_ordinary: float, n_extraordinary: float) -> float:
    """Standard error of the index for an axis of unknown direction; InputError for n below 1."""
    _refuse_indices(n_ordinary, n_extraordinary)
    return abs(n_extraordinary - n_ordinary) / math.sqrt(45.0)


def _refuse_indices(*indices: float) -> None:
    for index in indices:
        if not (math.isfinite(index) and index >= 1.0):
            raise InputError(f"the refractive index {index:g} is below 1", "give both indices")
