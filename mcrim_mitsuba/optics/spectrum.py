"""Curves over wavelength, and means of them over a scintillator's emission.

Between its points a curve is a straight line. All integrals are exact for such curves: the
product of two of them is a quadratic between the points of both grids."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError

#: Three points of Gauss and Legendre on -1..1: exact for polynomials up to the fifth degree.
_GAUSS, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)


class _Interpolation:
    """Straight lines between the points of a grid, as a matrix: values there to values here."""

    def __init__(self, points: Array, places: Array) -> None:
        self._count = points.size
        self._left = np.clip(np.searchsorted(points, places, side="right") - 1, 0, points.size - 2)
        self._share = (places - points[self._left]) / (points[self._left + 1] - points[self._left])

    def at(self, values: Array) -> Array:
        """Values at the places, from those at the grid's points: the matrix times these."""
        return (1 - self._share) * values[self._left] + self._share * values[self._left + 1]

    def back(self, weights: Array) -> Array:
        """Weights of the grid's points, from those of the places: the transposed matrix."""
        left = np.bincount(self._left, (1 - self._share) * weights, self._count)
        right = np.bincount(self._left + 1, self._share * weights, self._count)
        return np.asarray(left + right, float)


def _integral(grid: Array, values: Array) -> float:
    """Integral of the line through values on a grid."""
    return float(_product_weights(grid, np.ones_like(grid)) @ values)


def _product_weights(grid: Array, values: Array) -> Array:
    """Weights by which another curve's values make the integral of the product of both.

    Simpson's rule between each two points, exact for the product of two straight lines: over a
    step h it is h (2 a c + a d + b c + 2 b d) / 6.
    """
    step, left, right = np.diff(grid) / 6, values[:-1], values[1:]
    weights = np.zeros_like(grid)
    weights[:-1] += step * (2 * left + right)
    weights[1:] += step * (left + 2 * right)
    return weights


#: Of the emission's area: what may lie where a curve has no points.
LARGEST_OUTSIDE = 1e-3
#: Less than this is rounding, and nobody is told.
_SMALLEST_OUTSIDE = 1e-6
#: Of its maximum: an emission that ends higher is cut off.
_CUT_OFF = 0.05


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A curve over wavelength.

    Raises InputError if the points are fewer than two, not ascending or not finite, or an error is
    negative.
    """

    #: (points,) float64: Ascending, two at least.
    wavelength_nm: Array
    #: (points,) float64: Emission in any unit per nm; efficiencies and transmittances as fractions.
    values: Array
    #: (points,) float64 or None: Standard errors of the values, each independent of the others;
    #: None: not known.
    sigmas: Array | None = None
    #: Where it comes from, such as its file, for messages.
    name: str = ""
    _: KW_ONLY
    #: What the reader must know before using it.
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Take the arrays as float64, and refuse those that are no curve."""
        arrays = []
        for name in ("wavelength_nm", "values", "sigmas"):
            if (given := getattr(self, name)) is not None:
                arrays.append(np.asarray(given, dtype=np.float64))
                object.__setattr__(self, name, arrays[-1])
        points = self.wavelength_nm.size
        if any(array.shape != (points,) for array in arrays) or points < 2:
            problem = "a curve needs two points at least, each with a wavelength and a value"
            raise self.refusal(problem, "add them")
        if not all(np.all(np.isfinite(array)) for array in arrays):
            raise self.refusal("a point is not finite", "correct or remove it")
        if not np.all(np.diff(self.wavelength_nm) > 0):
            raise self.refusal("the wavelengths do not ascend", "sort them, each once")
        if self.sigmas is not None and np.any(self.sigmas < 0):
            raise self.refusal("an error is negative", "give standard errors")

    @property
    def first_nm(self) -> float:
        """Its shortest wavelength."""
        return float(self.wavelength_nm[0])

    @property
    def last_nm(self) -> float:
        """Its longest wavelength."""
        return float(self.wavelength_nm[-1])

    def at(self, wavelength_nm: ArrayLike) -> Array:
        """Values between the points, by straight lines; InputError beyond the curve."""
        wavelength_nm = np.asarray(wavelength_nm, dtype=np.float64)
        outside = (wavelength_nm < self.first_nm) | (wavelength_nm > self.last_nm)
        if np.any(outside):
            raise self.refusal(
                f"the curve goes from {self.first_nm:g} to {self.last_nm:g} nm and has no value at "
                f"{float(wavelength_nm[outside].flat[0]):g} nm",
                "extend it, or choose a wavelength within it",
            )
        return np.interp(wavelength_nm, self.wavelength_nm, self.values)

    def sigma_at(self, wavelength_nm: float) -> float | None:
        """Standard error of `at` one wavelength within the curve; None where it is not known."""
        if self.sigmas is None:
            return None
        weights = _Interpolation(self.wavelength_nm, np.array([wavelength_nm])).back(np.ones(1))
        return float(np.linalg.norm(weights * self.sigmas))

    def refusal(self, problem: str, mend: str) -> InputError:
        """An error that names where the curve comes from."""
        return InputError(problem, mend, path=self.name or None)


def detected_light(emission: Spectrum, quantum_efficiency: Spectrum) -> Spectrum:
    """What a detector sees of an emission: their product, with which light counts in a signal.

    Absorption and index act on the light that is detected: N is the integral of s e eta over the
    wavelength, s the emission and e the efficiency (Eqs. 2 and 3 of the article). The efficiency
    is 0 beyond its points. The emission's errors are not carried on.
    """
    nm = np.union1d(emission.wavelength_nm, quantum_efficiency.wavelength_nm)
    nm = nm[(emission.first_nm <= nm) & (nm <= emission.last_nm)]
    points = quantum_efficiency.wavelength_nm, quantum_efficiency.values
    efficiency = np.interp(nm, *points, left=0.0, right=0.0)
    return Spectrum(nm, emission.at(nm) * efficiency, name=emission.name)


@dataclass(frozen=True, eq=False)
class WeightedMean:
    """Mean of a curve, weighted with an emission."""

    #: In the curve's unit.
    value: float
    #: Standard deviation of the curve over the emission: what one number leaves out.
    spread: float
    #: Standard errors of the mean by the errors of the curve's points and of the emission's,
    #: each point independent; None where these are not known.
    quantity_sigma: float | None
    emission_sigma: float | None
    _: KW_ONLY
    #: (points of the curve,) float64: Change of the mean with each of the curve's values.
    quantity_derivatives: Array
    #: (points of the emission,) float64: Change of the mean with each of the emission's values.
    emission_derivatives: Array
    #: Fraction of the emission's area where the curve has no points; it is left out.
    outside: float
    #: What the reader must know before using the mean.
    notes: tuple[str, ...]


def weighted_mean(emission: Spectrum, quantity: Spectrum, what: str = "the curve") -> WeightedMean:
    """Integral of emission times quantity over that of the emission (Eq. 3 of the article).

    Errors are propagated linearly with the exact derivatives of the quotient. Beyond its points
    the emission, in any unit per nm, is 0. Messages call the quantity `what`.

    Raises InputError if more than `LARGEST_OUTSIDE` of the emission lies where the quantity has no
    points, or the emission has no area.
    """
    outside, notes = _refuse_extrapolation(emission, quantity, what)
    grid = common_grid(emission, quantity)
    of_emission = _Interpolation(emission.wavelength_nm, grid)
    of_quantity = _Interpolation(quantity.wavelength_nm, grid)
    # the emission s and the quantity q on one grid
    s, q = of_emission.at(emission.values), of_quantity.at(quantity.values)
    area = _integral(grid, s)
    value = float(s @ _product_weights(grid, q)) / area
    by_quantity = of_quantity.back(_product_weights(grid, s)) / area
    # of a quotient: the numerator's derivative less the mean times the denominator's
    by_emission = of_emission.back(_product_weights(grid, q - value)) / area
    # three places between each two points, (points - 1, 3): s (q - value)^2 is a cubic there
    share = (1 + _GAUSS) / 2
    weight, off = (of[:-1, None] * (1 - share) + of[1:, None] * share for of in (s, q - value))
    variance = float(np.sum(np.diff(grid)[:, None] * _GAUSS_WEIGHTS / 2 * weight * off**2)) / area
    return WeightedMean(
        value=value,
        # noise of the emission below 0 may make it negative
        spread=math.sqrt(max(variance, 0.0)),
        quantity_sigma=_propagated(by_quantity, quantity.sigmas),
        emission_sigma=_propagated(by_emission, emission.sigmas),
        quantity_derivatives=by_quantity,
        emission_derivatives=by_emission,
        outside=outside,
        notes=notes,
    )


def average_over(emission: Spectrum, function: Callable[[Array], Array]) -> tuple[float, float]:
    """Mean of a function of wavelength over an emission, and its standard deviation there.

    Three points of Gauss and Legendre between each two of the emission's: exact where the
    function is a polynomial of the fourth degree there, its deviation where it is of the second.

    The function takes wavelengths in nm, (n,) float64, to values of the same shape.

    Raises InputError if the emission has no area; and what the function raises.
    """
    _area(emission)
    left, step = emission.wavelength_nm[:-1, None], np.diff(emission.wavelength_nm)[:, None]
    places = left + step * (1 + _GAUSS) / 2
    values = np.asarray(function(places.ravel()), dtype=np.float64)
    weights = (emission.at(places) * step * _GAUSS_WEIGHTS / 2).ravel()
    mean = float(weights @ values / weights.sum())
    variance = float(weights @ (values - mean) ** 2 / weights.sum())
    return mean, math.sqrt(max(variance, 0.0))


def cut_off_note(emission: Spectrum) -> str | None:
    """That an emission ends where it is still high; None where it does not."""
    highest = float(emission.values.max())
    ends = zip((emission.first_nm, emission.last_nm), emission.values[[0, -1]], strict=True)
    high = [
        f"{100 * value / highest:.0f} % of its maximum at {place:g} nm"
        for place, value in ends
        if value > _CUT_OFF * highest
    ]
    if not high:
        return None
    return f"the emission is cut off: it still has {' and '.join(high)}; what follows counts as 0"


def _area(emission: Spectrum) -> float:
    """Integral of an emission; raises InputError if it is not above 0."""
    area = _integral(emission.wavelength_nm, emission.values)
    if not area > 0:
        problem = "the emission has no area"
        raise emission.refusal(problem, "give intensities above 0, the background subtracted once")
    return area


def _refuse_extrapolation(
    emission: Spectrum, quantity: Spectrum, what: str
) -> tuple[float, tuple[str, ...]]:
    """Fraction of the emission outside, and notes; InputError above `LARGEST_OUTSIDE`."""
    area = _area(emission)
    parts = []
    for where, low, high in (
        (f"below {quantity.first_nm:g} nm", emission.first_nm, quantity.first_nm),
        (f"above {quantity.last_nm:g} nm", quantity.last_nm, emission.last_nm),
    ):
        if low < high:
            # it is 0 beyond its points
            ends = np.clip((low, high), emission.first_nm, emission.last_nm)
            nm = emission.wavelength_nm
            grid = np.unique([*ends, *nm[(nm > ends[0]) & (nm < ends[1])]])
            part = abs(_integral(grid, emission.at(grid))) / area
            if part > _SMALLEST_OUTSIDE:
                parts.append((part, f"{100 * part:.2g} % {where}"))
    outside = sum(part for part, _ in parts)
    shares = " and ".join(text for _, text in parts)
    if outside > LARGEST_OUTSIDE:
        problem = f"{what} ends where the crystal still emits: of the emission {shares}"
        mend = "extend the curve, or cut the emission there if it is no light of the crystal"
        raise quantity.refusal(problem, mend)
    notes = (f"{shares} of the emission lies outside {what} and is left out",) if parts else ()
    return outside, notes


def common_grid(first: Spectrum, second: Spectrum) -> Array:
    """Points of both grids where both curves are."""
    grid = np.union1d(first.wavelength_nm, second.wavelength_nm)
    low, high = max(first.first_nm, second.first_nm), min(first.last_nm, second.last_nm)
    return grid[(grid >= low) & (grid <= high)]


def _propagated(derivatives: Array, sigmas: Array | None) -> float | None:
    """Standard error by independent errors of points; None where these are not known."""
    return None if sigmas is None else float(np.linalg.norm(derivatives * sigmas))
