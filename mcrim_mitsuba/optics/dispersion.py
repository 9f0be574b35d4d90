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
class NumberedFormula:
    """One of the nine formulas of refractiveindex.info, by which publications fit dispersion.

    They are defined in "Dispersion formulas" among that database's documents (M. N. Polyanskiy,
    Sci. Data 11 (2024) 94): 1 and 2 are Sellmeier's, 5 is Cauchy's, 6 that of gases, 7
    Herzberger's.
    """

    number: int
    #: C1, C2, ... of the formula, lengths in micrometres; where there are fewer, the others are 0.
    coefficients: tuple[float, ...]

    def __call__(self, wavelength_um: Array) -> Array:
        um = np.asarray(wavelength_um, dtype=float)
        square, (first, *rest) = um**2, self.coefficients
        # 7 to 9 have none
        pairs = list(zip(rest[::2], rest[1::2], strict=False))
        match self.number:
            case 1:
                return np.sqrt(1 + first + sum(b * square / (square - c**2) for b, c in pairs))
            case 2:
                return np.sqrt(1 + first + sum(b * square / (square - c) for b, c in pairs))
            case 3:
                return np.sqrt(first + sum(b * um**power for b, power in pairs))
            case 4:
                both = zip(pairs[:4:2], pairs[1:4:2], strict=True)
                resonances = sum(b * um**p / (square - c**q) for (b, p), (c, q) in both)
                return np.sqrt(first + resonances + sum(b * um**p for b, p in pairs[4:]))
            case 5:
                return np.asarray(first + sum((b * um**power for b, power in pairs), 0.0 * um))
            case 6:
                return np.asarray(1 + first + sum(b / (c - 1 / square) for b, c in pairs))
            case 7:
                inverse = 1 / (square - 0.028)
                powers = (inverse, inverse**2, square, square**2, square**3)
                terms = zip(rest, powers, strict=True)
                return np.asarray(first + sum(c * power for c, power in terms))
            case 8:
                b, c, d = rest
                ratio = first + b * square / (square - c) + d * square
                return np.sqrt((1 + 2 * ratio) / (1 - ratio))
            case _:
                b, c, d, e, f = rest
                resonance = d * (um - e) / ((um - e) ** 2 + f)
                return np.sqrt(first + b / (square - c) + resonance)


@dataclass(frozen=True, eq=False)
class Tabulated:
    """Between tabulated values, at least two, straight lines in 1/l^2, and on beyond the ends.

    Cauchy's formula is nearly straight in it: of tables in steps of 100 nm, as those of W. L. Bond,
    J. Appl. Phys. 36 (1965) 1674, straight lines in l would be wrong by 0.005 in the visible.
    """

    #: (points,) float64, ascending.
    wavelengths_um: Array
    values: Array

    def __call__(self, wavelength_um: Array) -> Array:
        x, y = self.wavelengths_um**-2, self.values
        left = np.clip(np.searchsorted(self.wavelengths_um, wavelength_um) - 1, 0, x.size - 2)
        slopes = np.diff(y) / np.diff(x)
        return np.asarray(y[left] + (wavelength_um**-2 - x[left]) * slopes[left])


@dataclass(frozen=True)
class MeanFormula:
    """The mean of several indices, such as the three principal ones of a biaxial crystal."""

    formulas: tuple[Formula, ...]

    def __call__(self, wavelength_um: Array) -> Array:
        return np.mean([formula(wavelength_um) for formula in self.formulas], axis=0)


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
        return self.at(wavelength_nm)

    def at(self, wavelength_nm: ArrayLike) -> Array:
        """What the formula gives, float64 of the wavelengths' shape, in its range or not."""
        return self.formula(np.asarray(wavelength_nm, dtype=float) / NM_PER_UM)

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
