"""Interpolation on a line: weights that turn values at nodes into values between them.

Polynomials in their barycentric form: J.-P. Berrut and L. N. Trefethen, SIAM Review 46 (2004) 501.
Through Chebyshev nodes their error falls geometrically for smooth functions (L. N. Trefethen,
Approximation Theory and Approximation Practice, chapters 2 and 8).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Lagrange:
    """Interpolation through nodes on a line.

    Parameters
    ----------
    nodes : sequence of float
        Distinct, in any order.

    Attributes
    ----------
    nodes : (nodes,) float64
    """

    def __init__(self, nodes: Sequence[float] | NDArray[np.float64]) -> None:
        self.nodes = np.array(nodes, dtype=np.float64)
        # the size of the numbers cancels; without this, products of many distances overflow
        size = np.ptp(self.nodes) or 1.0
        distance = (self.nodes[:, None] - self.nodes[None]) / size
        np.fill_diagonal(distance, 1.0)
        self._barycentric = 1.0 / distance.prod(axis=1)
        # derivatives at the nodes themselves
        slope = self._barycentric[None] / self._barycentric[:, None] / distance / size
        np.fill_diagonal(slope, 0.0)
        np.fill_diagonal(slope, -slope.sum(axis=1))
        self._slope_at_nodes = slope

    def __len__(self) -> int:
        return len(self.nodes)

    def weights(self, x: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weights of the nodes' values at x, and their derivatives by x; (nodes,) each."""
        distance = x - self.nodes
        nearest = int(np.abs(distance).argmin())
        if abs(distance[nearest]) <= 1e-12 * (np.ptp(self.nodes) or 1.0):
            at = np.zeros(len(self.nodes))
            at[nearest] = 1.0
            return at, self._slope_at_nodes[nearest]
        terms = self._barycentric / distance
        weights = terms / terms.sum()
        # d/dx of terms / sum(terms), with d terms / dx = -terms / distance
        inverse = 1.0 / distance
        return weights, weights * (weights @ inverse - inverse)


class Lines:
    """Straight lines from node to node, for what has kinks.

    Parameters
    ----------
    nodes : sequence of float
        Distinct, in any order; two at least.

    Attributes
    ----------
    nodes : (nodes,) float64
    """

    def __init__(self, nodes: Sequence[float]) -> None:
        self.nodes = np.array(nodes, dtype=np.float64)
        self._order = np.argsort(self.nodes)

    def __len__(self) -> int:
        return len(self.nodes)

    def weights(self, x: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Lagrange.weights`; beyond the last node its line goes on."""
        rising = self.nodes[self._order]
        right = int(np.clip(np.searchsorted(rising, x), 1, len(rising) - 1))
        low, high = self._order[right - 1], self._order[right]
        width = self.nodes[high] - self.nodes[low]
        weights, slopes = np.zeros(len(self.nodes)), np.zeros(len(self.nodes))
        weights[high] = (x - self.nodes[low]) / width
        weights[low] = 1.0 - weights[high]
        slopes[high], slopes[low] = 1.0 / width, -1.0 / width
        return weights, slopes


def chebyshev_nodes(low: float, high: float, count: int) -> NDArray[np.float64]:
    """(count,) extrema of the Chebyshev polynomial, rising, the ends of the range included."""
    middle, half = (low + high) / 2, (high - low) / 2
    return middle - half * np.cos(np.pi * np.arange(count) / (count - 1))
