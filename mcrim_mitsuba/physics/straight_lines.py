"""Interpolation and integrals of curves that are straight between the points of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Three points of Gauss and Legendre on -1..1: exact for polynomials up to the fifth degree.
GAUSS, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(3)


class Interpolation:
    """Straight lines between the points of a grid, as a matrix: values there to values here."""

    def __init__(self, points: NDArray[np.float64], places: NDArray[np.float64]) -> None:
        self._count = points.size
        self._left = np.clip(np.searchsorted(points, places, side="right") - 1, 0, points.size - 2)
        step = points[self._left + 1] - points[self._left]
        self._share = (places - points[self._left]) / step

    def at(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The matrix times values."""
        return (1 - self._share) * values[self._left] + self._share * values[self._left + 1]

    def back(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """The transposed matrix times weights."""
        left = np.bincount(self._left, (1 - self._share) * weights, self._count)
        right = np.bincount(self._left + 1, self._share * weights, self._count)
        return np.asarray(left + right, float)


def integral_weights(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights by which values on a grid make the integral of the line through them."""
    return product_weights(grid, np.ones_like(grid))


def product_weights(grid: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights by which another curve's values make the integral of the product of both.

    Simpson's rule between each two points, exact for the product of two straight lines: over a
    step h it is h (2 a c + a d + b c + 2 b d) / 6.
    """
    step, left, right = np.diff(grid) / 6, values[:-1], values[1:]
    weights = np.zeros_like(grid)
    weights[:-1] += step * (2 * left + right)
    weights[1:] += step * (left + 2 * right)
    return weights


def integral_of_square(
    grid: NDArray[np.float64], weight: NDArray[np.float64], values: NDArray[np.float64]
) -> float:
    """Integral of a weight times values squared, both straight between the grid's points."""
    share = (1 + GAUSS) / 2
    w = weight[:-1, None] * (1 - share) + weight[1:, None] * share
    v = values[:-1, None] * (1 - share) + values[1:, None] * share
    return float(np.sum(np.diff(grid)[:, None] * GAUSS_WEIGHTS / 2 * w * v**2))
