"""Interpolation on a line: weights that turn values at nodes into values between them.

Polynomials in their barycentric form: J.-P. Berrut and L. N. Trefethen, SIAM Review 46 (2004) 501.
Through Chebyshev nodes their error falls geometrically for smooth functions (L. N. Trefethen,
Approximation Theory and Approximation Practice, chapters 2 and 8).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class Lagrange:
    """Interpolation through distinct nodes on a line, in any order."""

    def __init__(self, nodes: Sequence[float] | NDArray[np.float64]) -> None:
        self.nodes = np.array(nodes, dtype=np.float64)
        # the size of the numbers cancels; without this, products of many distances overflow
        size = float(np.ptp(self.nodes)) or 1.0
        # nearer than this to a node is at it
        self._at_node = 1e-12 * size
        distance = (self.nodes[:, None] - self.nodes[None]) / size
        np.fill_diagonal(distance, 1.0)
        self._barycentric = 1.0 / distance.prod(axis=1)
        # derivatives at the nodes themselves
        slope = self._barycentric[None] / self._barycentric[:, None] / distance / size
        np.fill_diagonal(slope, 0.0)
        np.fill_diagonal(slope, -slope.sum(axis=1))
        self._slope_at_nodes = slope

    def weights(self, x: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weights of the nodes' values at x, and their derivatives by x; (nodes,) each."""
        distance = x - self.nodes
        nearest = int(abs(distance).argmin())
        if abs(distance[nearest]) <= self._at_node:
            at = np.zeros(len(self.nodes))
            at[nearest] = 1.0
            return at, self._slope_at_nodes[nearest]
        inverse = 1.0 / distance
        terms = self._barycentric * inverse
        weights = terms / np.add.reduce(terms)
        # d/dx of terms / sum(terms), with d terms / dx = -terms / distance
        return weights, weights * (weights @ inverse - inverse)

    def weights_at(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points, nodes) weights at (points,) values."""
        distance = x[:, None] - self.nodes
        near = abs(distance) <= self._at_node
        some = near.any()
        terms = self._barycentric / (np.where(near, 1.0, distance) if some else distance)
        weights = terms / terms.sum(axis=1, keepdims=True)
        if some:
            weights[near.any(axis=1)] = near[near.any(axis=1)]
        return weights


class Cubics:
    """Cubics from node to node, for what bends sharply somewhere; two distinct nodes at least.

    Between two nodes it is the blend of the parabolas through either and its neighbours (slopes of
    three points: C. de Boor, A Practical Guide to Splines, chapter IV), so that a value is felt by
    the nearest nodes only: a bend far away makes no waves here, as it would in a polynomial.
    """

    def __init__(self, nodes: Sequence[float]) -> None:
        # takes half of the time of starting a process that simulates, which has no use for it
        from scipy.interpolate import CubicHermiteSpline

        self.nodes = np.array(nodes, dtype=np.float64)
        order = np.argsort(self.nodes)
        rising, units = self.nodes[order], np.eye(len(order))[order]
        slopes = np.gradient(units, rising, axis=0, edge_order=2 if len(order) > 2 else 1)
        self._joint = CubicHermiteSpline(rising, units, slopes)
        self._slope = self._joint.derivative()
        # by piece: where it begins, and its coefficients; a spline that is called, or asked for
        # them, takes ten times as long
        self._pieces = list(zip(rising.tolist(), *self._joint.c, strict=False))
        self._breaks = rising[1:-1].tolist()
        self._ends = float(rising[0]), float(rising[-1])

    def weights(self, x: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Lagrange.weights`; beyond the last node it goes on as a line."""
        inside = min(max(x, self._ends[0]), self._ends[1])
        begin, a, b, c, d = self._pieces[bisect_right(self._breaks, inside)]
        t = inside - begin
        slope = (3.0 * a * t + 2.0 * b) * t + c
        return ((a * t + b) * t + c) * t + d + (x - inside) * slope, slope

    def weights_at(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points, nodes) weights at (points,) values."""
        inside = np.clip(x, *self._ends)
        beyond = (x - inside)[:, None]
        return np.asarray(self._joint(inside) + beyond * self._slope(inside), np.float64)


def chebyshev_nodes(low: float, high: float, count: int) -> NDArray[np.float64]:
    """(count,) extrema of the Chebyshev polynomial, rising, the ends of the range included.

    A single one is at the lower end.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    return middle - half * np.cos(np.pi * np.arange(count) / max(count - 1, 1))


#: alpha_scat and alpha_abs, 1/cm.
Coefficients = tuple[float, float]


@dataclass(frozen=True)
class EtaPoint:
    """The light collection efficiency at one point of a surface."""

    #: Light collection efficiency and its Monte Carlo standard error.
    eta: float
    sigma: float
    #: d eta / d parameter for every parameter of the surface, per unit of that parameter.
    gradient: dict[str, float]
    #: Estimated size of the error of interpolating between simulations, not part of
    #: `sigma`; 0 where nothing was interpolated.
    interpolation_error: float = 0.0
