"""What every surface of eta offers the fit, and surfaces interpolated between simulations.

Interpolation on a line: weights that turn values at nodes into values between them.

Polynomials in their barycentric form: J.-P. Berrut and L. N. Trefethen, SIAM Review 46 (2004) 501.
Through Chebyshev nodes their error falls geometrically for smooth functions (L. N. Trefethen,
Approximation Theory and Approximation Practice, chapters 2 and 8).
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT


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
        self.nodes = np.array(nodes, dtype=np.float64)
        order = np.argsort(self.nodes)
        rising, units = self.nodes[order], np.eye(len(order))[order]
        slopes = np.gradient(units, rising, axis=0, edge_order=2 if len(order) > 2 else 1)
        self._joint = CubicHermiteSpline(rising, units, slopes)
        self._slope = self._joint.derivative()
        self._breaks = rising[1:-1].tolist()
        self._ends = float(rising[0]), float(rising[-1])

    def weights(self, x: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `Lagrange.weights`; beyond the last node it goes on as a line."""
        inside = min(max(x, self._ends[0]), self._ends[1])
        # a spline that is called takes ten times as long to find its way to four coefficients
        piece = bisect_right(self._breaks, inside)
        t = inside - self._joint.x[piece]
        a, b, c, d = self._joint.c[:, piece]
        slope = (3.0 * a * t + 2.0 * b) * t + c
        return ((a * t + b) * t + c) * t + d + (x - inside) * slope, slope

    def weights_at(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points, nodes) weights at (points,) values."""
        inside = np.clip(x, *self._ends)
        beyond = (x - inside)[:, None]
        return np.asarray(self._joint(inside) + beyond * self._slope(inside), np.float64)


def chebyshev_nodes(low: float, high: float, count: int) -> NDArray[np.float64]:
    """(count,) extrema of the Chebyshev polynomial, rising, the ends of the range included."""
    middle, half = (low + high) / 2, (high - low) / 2
    return middle - half * np.cos(np.pi * np.arange(count) / (count - 1))


# The light collection efficiency as a function: what all surfaces can be asked, and those in
# further scene parameters.
#
# What cannot be reweighted (an index, the gap's thickness) is simulated at Chebyshev nodes, and log
# eta is a polynomial between them.


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
    #: Detected photons of equal weight that would be worth as much.
    effective_sample_size: float
    #: Estimated size of the error of interpolating between simulations, not part of
    #: `sigma`; 0 where nothing was interpolated.
    interpolation_error: float = 0.0


class EfficiencySurface(ABC):
    """The light collection efficiency of one configuration as a function of its unknowns."""

    @property
    @abstractmethod
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        """Range of alpha_scat in which the surface may be asked; its lower end is above 0."""

    def evaluate(
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        errors: bool = True,
        **scene_parameters: float,
    ) -> EtaPoint:
        """Efficiency, its error and its gradient at one point.

        Parameters
        ----------
        alpha_scat_per_cm, alpha_abs_per_cm : float
        check : bool
            Refuse a point whose statistical error cannot be trusted. A search that only
            passes through may do without, and check where it ends.
        errors : bool
            Compute `sigma` and `effective_sample_size`, which takes longest; without, and
            without `check`, they are NaN.
        **scene_parameters : float
            Further ones of the surface, in the units of their names.

        Raises
        ------
        InputError
            Outside the surface's range, or where its photons carry no information.
        """
        target = alpha_scat_per_cm, alpha_abs_per_cm
        return self._point(target, check, errors, **scene_parameters)

    @abstractmethod
    def _point(
        self, target: Coefficients, check: bool, errors: bool, **scene_parameters: float
    ) -> EtaPoint:
        """What `evaluate` answers."""

    @abstractmethod
    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        """Monte Carlo covariance of eta at two points, each a value for every parameter."""


# Nodes per parameter, by the number of parameters: 5 simulations for one, 9 for two.
_NODES = {1: 5, 2: 3}


@dataclass(frozen=True)
class InterpolationAxis:
    """One scene parameter and its Chebyshev nodes."""

    name: str
    #: Range, in the unit of the name.
    minimum: float
    maximum: float
    #: Number of nodes.
    count: int

    @property
    def nodes(self) -> NDArray[np.float64]:
        """(count,) zeros of the Chebyshev polynomial, falling, strictly inside the range.

        The kind that leaves the ends out, because there a scene may not exist (a gap of
        0 mm) or be another one (n_gap = 1 is not filled).
        """
        middle, half = (self.minimum + self.maximum) / 2, (self.maximum - self.minimum) / 2
        return middle + half * np.cos(np.pi * (np.arange(self.count) + 0.5) / self.count)

    def weights(self, value: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lagrange's basis polynomials and their derivatives at a value, (count,) each.

        Raises InputError if the value is outside the range.
        """
        slack = 1e-9 * (self.maximum - self.minimum)
        if not self.minimum - slack <= value <= self.maximum + slack:
            raise InputError(
                f"{self.name} = {value:g} is outside {self.minimum:g}..{self.maximum:g}, "
                "the range that was simulated",
                "give it other min and max",
            )
        return self._lagrange.weights(value)

    @cached_property
    def _lagrange(self) -> Lagrange:
        return Lagrange(self.nodes)


def axes_for(ranges: Mapping[str, tuple[float, float]]) -> tuple[InterpolationAxis, ...]:
    """Axes for one or two scene parameters with their ranges.

    Raises InputError for more than two parameters, and for a range that is not finite.
    """
    if len(ranges) not in _NODES:
        raise InputError(
            f"{', '.join(ranges)}: {len(ranges)} scene parameters to fit besides alpha_scat and "
            "alpha_abs",
            "fit at most two and hold the others with fixed = true: three would take 27 or more "
            "simulations per reading, and few readings tell so many unknowns apart",
        )
    for name, (low, high) in ranges.items():
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            mend = "give a finite min and a larger finite max: it is simulated between them"
            raise InputError(f"{name} has the range {low:g}..{high:g}", mend)
    count = _NODES[len(ranges)]
    return tuple(InterpolationAxis(name, low, high, count) for name, (low, high) in ranges.items())


class InterpolatedSurface(EfficiencySurface):
    """The light collection efficiency with one or two further scene parameters.

    The Monte Carlo error is that of the nodes' independent
    simulations, carried through the interpolation.

    Parameters
    ----------
    axes : sequence of InterpolationAxis
    at_node : callable
        ``at_node({name: value, ...})`` returns the surface simulated there. Called once per
        node.
    """

    def __init__(
        self,
        axes: Sequence[InterpolationAxis],
        at_node: Callable[[dict[str, float]], EfficiencySurface],
    ) -> None:
        self._axes = tuple(axes)
        names = [axis.name for axis in axes]
        self._nodes = [
            at_node(dict(zip(names, map(float, values), strict=True)))
            for values in itertools.product(*(axis.nodes for axis in axes))
        ]

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        lows, highs = zip(*(node.alpha_scat_bounds_per_cm for node in self._nodes), strict=True)
        return max(lows), min(highs)

    def _point(
        self, target: Coefficients, check: bool, errors: bool, **scene_parameters: float
    ) -> EtaPoint:
        points = self._at_nodes(*target, check, errors)
        eta_nodes = np.array([point.eta for point in points])
        log_eta = np.log(eta_nodes)
        weights, slopes = self._weights(scene_parameters)
        eta = math.exp(weights @ log_eta)
        relative = weights * [point.sigma for point in points] / eta_nodes
        relative_slope = {
            name: weights @ (np.array([point.gradient[name] for point in points]) / eta_nodes)
            for name in (ALPHA_SCAT, ALPHA_ABS)
        }
        relative_slope |= {name: slope @ log_eta for name, slope in slopes.items()}
        return EtaPoint(
            eta=eta,
            sigma=eta * float(np.linalg.norm(relative)),
            gradient={name: eta * float(slope) for name, slope in relative_slope.items()},
            effective_sample_size=min(point.effective_sample_size for point in points),
            interpolation_error=eta * self._relative_error(log_eta),
        )

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        sides, etas = [], []
        for point in (first, second):
            nodes = self._at_nodes(point[ALPHA_SCAT], point[ALPHA_ABS], False, False)
            eta_nodes = np.array([node.eta for node in nodes])
            weights, _ = self._weights({axis.name: point[axis.name] for axis in self._axes})
            sides.append(weights / eta_nodes)
            etas.append(math.exp(weights @ np.log(eta_nodes)))
        relative = sum(
            one * other * node.covariance(first, second)
            for node, one, other in zip(self._nodes, *sides, strict=True)
        )
        return etas[0] * etas[1] * float(relative)

    def _at_nodes(
        self, alpha_scat: float, alpha_abs: float, check: bool, errors: bool
    ) -> list[EtaPoint]:
        """The nodes' surfaces at one pair of coefficients."""
        points = [
            node.evaluate(alpha_scat, alpha_abs, check=check, errors=errors) for node in self._nodes
        ]
        if min(point.eta for point in points) <= 0:
            names = ", ".join(axis.name for axis in self._axes)
            problem = f"in part of the range of {names} no light is detected"
            raise InputError(problem, "give narrower min and max")
        return points

    def _weights(
        self, values: Mapping[str, float]
    ) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Weights of the nodes, (nodes,), and their derivatives along every axis."""
        each = {axis.name: axis.weights(values[axis.name]) for axis in self._axes}
        weights = _product(basis for basis, _ in each.values())
        slopes = {
            name: _product(pair[1] if other == name else pair[0] for other, pair in each.items())
            for name in each
        }
        return weights, slopes

    def _relative_error(self, log_eta: NDArray[np.float64]) -> float:
        """Size of the first term left out, from the decay of the Chebyshev coefficients.

        They fall geometrically for a smooth function, so the next one is about the last one
        times the ratio of the last two; never taken above the last one. The Monte Carlo noise
        of the nodes enters, so the estimate is seldom below it.
        """
        values = log_eta.reshape([axis.count for axis in self._axes])
        left_out = 0.0
        for number, axis in enumerate(self._axes):
            # from values at the nodes to Chebyshev coefficients
            order = np.arange(axis.count)
            angle = np.pi * (order + 0.5) / axis.count
            transform = 2.0 / axis.count * np.cos(np.outer(order, angle))
            transform[0] /= 2.0
            along = np.moveaxis(values, number, 0).reshape(axis.count, -1)
            before, last = np.abs(transform @ along)[-2:].max(axis=1)
            left_out += last * min(1.0, last / before if before > 0 else 1.0)
        return float(left_out)


def _product(factors: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Outer product of one-dimensional weights, flattened in the order of the nodes."""
    result = np.ones(1)
    for factor in factors:
        result = np.outer(result, factor).ravel()
    return result
