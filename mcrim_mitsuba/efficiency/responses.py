"""How a campaign's readings respond to alpha_scat, alpha_abs and physical effects.

The logarithm of eta is a sum: that of the bench as it is, and of every effect what it adds.
Each is a polynomial through values at nodes. Of one effect that is exact at the nodes; of two that
do not add up, what they add beside their sum may be known too. Several effects at once are
corrected by simulating them together where a fit ends (`Anchor`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.effects.effect import EffectParameter
from mcrim_mitsuba.efficiency.eta_grid import EtaGrid, Grid, standard_error
from mcrim_mitsuba.efficiency.surface import Cubics, Lagrange

#: The smallest and the largest value of an effect's parameter that somebody asks for.
Sizes = tuple[float, float]
#: Relative error of eta at a node, above which its photons do not tell it: few carry all weight.
_UNKNOWN = 0.2


@dataclass(frozen=True, eq=False)
class Point:
    """Weights of the nodes of a grid at one alpha_scat and alpha_abs per reading."""

    #: (readings, 3, nodes) float64: Of a table's values, scattering nodes by absorption nodes, and
    #: the weights' derivatives by alpha_scat and by alpha_abs (1/cm); one row where all readings
    #: share it.
    weights: NDArray[np.float64]

    @classmethod
    def of(cls, grid: Grid, alpha_scat: Sequence[float], alpha_abs: Sequence[float]) -> Point:
        """Of (readings,) coefficients in 1/cm."""
        pairs = list(zip(alpha_scat, alpha_abs, strict=True))
        found: dict[tuple[float, float], NDArray[np.float64]] = {}
        for a_s, a_a in dict.fromkeys(pairs):
            scattering, by_log_scat = grid.scattering.weights(math.log(a_s))
            offset = a_a + grid.offset_per_cm
            absorption, by_log_abs = grid.absorption.weights(math.log(offset))
            along = np.array([scattering, by_log_scat / a_s])
            across = np.array([absorption, by_log_abs / offset])
            # the fourth is the mixed derivative
            found[a_s, a_a] = (across[:, None, None] * along[:, :, None]).reshape(4, -1)[:3]
        return cls(np.array([found[pair] for pair in (pairs if len(found) > 1 else found)]))

    def on(self, coarser: NDArray[np.float64]) -> Point:
        """The same on a grid of fewer nodes, whose polynomials go exactly through these ones."""
        return Point(self.weights @ coarser)

    def value(self, table: NDArray) -> NDArray[np.float64]:
        """(..., readings) of a (..., readings, scattering nodes, absorption nodes) table."""
        return self.value_and_slopes(table)[0]

    def value_and_slopes(self, table: NDArray) -> NDArray[np.float64]:
        """(3, ..., readings) values, and their slopes by alpha_scat and by alpha_abs.

        Of a (..., readings, scattering nodes, absorption nodes) table.
        """
        flat = table.reshape(*table.shape[:-2], self.weights.shape[-1])
        if len(self.weights) == 1:
            found = flat.reshape(-1, flat.shape[-1]) @ self.weights[0].T
            return found.T.reshape(3, *flat.shape[:-1])
        return np.einsum("...rn,rkn->k...r", flat, self.weights)

    def values(self, tables: NDArray) -> NDArray[np.float64]:
        """(batches, readings) of (batches, readings, scattering nodes, absorption nodes)."""
        flat, weights = tables.reshape(*tables.shape[:2], -1), self.weights[:, 0]
        weights = weights.astype(tables.dtype)
        if len(weights) == 1:
            return flat @ weights[0]
        return np.einsum("brn,rn->br", flat, weights)


class Axis:
    """One parameter of an effect: its nodes and the coordinate in which they are joined.

    Nodes are values of the parameter (for a `nominal` one, offsets from there), the absent one
    first where there is one; the order of the response's tables.
    """

    def __init__(
        self, parameter: EffectParameter, nodes: Sequence[float], nominal: float = 0.0
    ) -> None:
        self.parameter = parameter
        self.name = parameter.name
        self.nominal = nominal
        self.values = tuple(float(node) for node in nodes)
        nodes = [parameter.coordinate_of(value) for value in self.values]
        #: In the coordinate.
        self.nodes = (Cubics if parameter.kinked else Lagrange)(nodes)

    def weights(self, value: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(nodes,) weights at a value of the parameter, and their derivatives by it."""
        x, slope = self.parameter.coordinate_and_slope(value - self.nominal)
        weights, derivative = self.nodes.weights(x)
        return weights, derivative * slope


@dataclass(frozen=True, eq=False)
class EffectResponse:
    """What an effect adds to log(eta)."""

    #: Per parameter; none for an effect that is on or off.
    axes: tuple[Axis, ...]
    #: (nodes..., readings, scattering nodes, absorption nodes) float64: Zero at the absent value.
    log_ratio: NDArray[np.float64]
    #: (batches, nodes..., readings, scattering nodes, absorption nodes) float32: Of the batches'
    #: log_ratio.
    deviations: NDArray[np.float32]

    def added(self, values: Sequence[float]) -> NDArray[np.float64]:
        """(1 + axes, readings, ...) tables of the addition at some values, and of its slopes."""
        of_axes = [axis.weights(value) for axis, value in zip(self.axes, values, strict=True)]
        # the slope of none, of the first, ...
        outer = [
            _outer([of[i == j] for j, of in enumerate(of_axes)]) for i in range(-1, len(of_axes))
        ]
        of_nodes = self.log_ratio.reshape(len(outer[0]), -1)
        return (np.array(outer) @ of_nodes).reshape(-1, *self.log_ratio.shape[len(of_axes) :])

    @cached_property
    def at_absence(self) -> NDArray[np.float64]:
        """(readings, scattering nodes, absorption nodes) slope by its one parameter, at 0."""
        return self.added([0.0])[1]

    def weights_at(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """(points, nodes of all axes) weights of the nodes at (points,) values of each axis."""
        weights = np.ones((1, 1))
        for axis, own in zip(self.axes, values, strict=True):
            each = axis.nodes.weights_at(axis.parameter.coordinates_of(own - axis.nominal))
            points = max(len(weights), len(each))
            weights = (weights[:, :, None] * each[:, None, :]).reshape(points, -1)
        return weights

    def less(self, single: EffectResponse, place: tuple[int, ...], reading: int) -> None:
        """Take off, at a node and of a reading, what one of several effects adds alone there."""
        at = {
            axis.name: axis.nominal + axis.values[i]
            for axis, i in zip(self.axes, place, strict=True)
        }
        values = [np.array([at.get(axis.name, axis.nominal)]) for axis in single.axes]
        (weights,) = single.weights_at(values)
        tables = single.log_ratio.reshape(len(weights), *single.log_ratio.shape[-3:])
        self.log_ratio[(*place, reading)] -= np.tensordot(weights, tables[:, reading], 1)
        batches = single.deviations.reshape(len(single.deviations), *tables.shape)
        added = np.tensordot(batches[:, :, reading], weights, (1, 0))
        self.deviations.swapaxes(0, -3)[(reading, *place)] -= added

    def deviations_at(self, point: Point, values: Sequence[float]) -> NDArray[np.float64]:
        """(batches, readings) deviations of the addition."""
        each = [
            axis.weights(value)[0].astype(np.float32)
            for axis, value in zip(self.axes, values, strict=True)
        ]
        batches, of_nodes = self.deviations, _outer(each)
        nodes = batches.reshape(len(batches), len(of_nodes), -1)
        added = np.matmul(of_nodes, nodes).reshape(len(batches), *batches.shape[-3:])
        return point.values(added)

    def interpolation_error(self, point: Point, values: Sequence[float]) -> NDArray[np.float64]:
        """(readings,) size of the error that interpolation makes; 0 without parameters.

        Taken from what another polynomial through the nearest nodes gives.
        """
        error = np.zeros(self.log_ratio.shape[len(self.axes)])
        of_node = point.value(self.log_ratio).reshape(-1, len(error))
        each = [axis.weights(value)[0] for axis, value in zip(self.axes, values, strict=True)]
        whole = _outer(each) @ of_node
        for number, (axis, value) in enumerate(zip(self.axes, values, strict=True)):
            nodes, x = axis.nodes.nodes, axis.parameter.coordinate_of(value - axis.nominal)
            near = np.argsort(np.abs(nodes - x), kind="stable")
            # next to cubics the parabola through the nearest nodes, of which they are blends, next
            # to a polynomial the one without the farthest node
            kept = np.sort(near[:3] if axis.parameter.kinked else near[:-1])
            fewer = np.zeros(len(nodes))
            fewer[kept] = Lagrange(nodes[kept]).weights(x)[0]
            other = [fewer if i == number else weights for i, weights in enumerate(each)]
            error += np.abs(_outer(other) @ of_node - whole)
        return error


def _outer(weights: Sequence[NDArray]) -> NDArray:
    """(nodes of all axes,) products of the axes' weights; a single 1 without axes."""
    product = weights[0] if weights else np.ones(1)
    for each in weights[1:]:
        product = (product[:, None] * each).reshape(-1)
    return product


@dataclass(frozen=True, eq=False)
class Anchor:
    """A joint simulation of all effects at one point, which a sum of single ones only estimates."""

    #: What was simulated together: effects, and scene parameters that are fitted.
    effects: frozenset[str]
    #: Where: the free parameters, the scale left out.
    values: Mapping[str, float]
    #: (readings,) float64
    log_eta: NDArray[np.float64]
    #: (batches, readings) float64
    deviations: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of a campaign's readings."""

    #: Of `log_eta`, and of the effects' responses.
    grid: Grid
    coarse: Grid
    #: (readings, scattering nodes, absorption nodes) float64: Of the bench as it is.
    log_eta: NDArray[np.float64]
    #: (batches, readings, scattering nodes, absorption nodes) float32
    deviations: NDArray[np.float32]
    #: Those that act on eta; effects of the readings need none. Of two, ``"ground + gel_creep"``,
    #: it is what both add beside the sum of what each does.
    effects: Mapping[str, EffectResponse] = field(default_factory=dict)
    #: All photons behind it.
    photons: int = 0

    @cached_property
    def told_to_per_cm(self) -> float:
        """Scattering up to which photons tell every reading's eta; infinite if in the whole grid.

        Of a long crystal none may arrive at the highest nodes, whatever weights say, and what is
        wrong there moves the polynomial everywhere. No node is given up if already the lowest is
        not known.
        """
        errors = standard_error(self.deviations).max(axis=(0, 2))
        first = int(np.argmax(errors > _UNKNOWN))
        return float(np.exp(self.grid.scattering.nodes[first - 1])) if first else math.inf

    @cached_property
    def coarser(self) -> NDArray[np.float64]:
        """(nodes, coarse nodes) weights of `coarse` at the nodes of `grid`; powers are fewer."""
        scattering = self.coarse.scattering.weights_at(self.grid.scattering.nodes)
        absorption = self.coarse.absorption.weights_at(self.grid.absorption.nodes)
        return np.asarray(np.kron(scattering, absorption), np.float64)


def stack(tables: Sequence[EtaGrid]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Tables of all readings as (readings, ...) and (batches, readings, ...)."""
    log_eta = np.stack([table.log_eta for table in tables])
    return log_eta, np.stack([table.deviations for table in tables], axis=1)


def errors_of(deviations: NDArray) -> NDArray[np.float64]:
    """(readings, batches) errors of mean logarithms from (batches, readings) deviations.

    Their products E E^T are the covariance.
    """
    batches = len(deviations)
    return np.asarray(deviations.T, np.float64) / math.sqrt(batches * (batches - 1))


def held_at(
    response: EffectResponse, values: ArrayLike, parts: ArrayLike = (1.0,)
) -> EffectResponse:
    """An effect held at a value, or at a value for each part of the light: one that is on or off.

    Values, (values,), are of its own parameter, the first, as the scene takes it (an index, not its
    offset); an acceptance that it depends on besides stays. `parts`, (values,), are of the light,
    none negative: their sum need not be 1. Over several values eta itself is averaged, not its
    logarithm: photons of every value are counted.

    Raises ValueError if the response has no parameter, or one of several values is beyond its
    outermost nodes.
    """
    if not response.axes:
        raise ValueError("an effect of 0 parameters held at a value of one")
    axis, *further = response.axes
    values = np.asarray(values, dtype=float)
    low, high = (axis.nominal + end for end in (min(axis.values), max(axis.values)))
    if len(values) > 1 and (values.min() < low or values.max() > high):
        problem = f"{axis.name} = {values.min():g}..{values.max():g} is beyond {low:g}..{high:g}"
        raise ValueError(problem)
    # (values, nodes): what each node contributes to the logarithm at each value
    nodes = np.array([axis.weights(value)[0] for value in values])
    eta = np.exp(np.tensordot(nodes, response.log_ratio, axes=1))
    share = np.asarray(parts, dtype=float) / np.sum(parts)
    eta *= share.reshape(-1, *[1] * (eta.ndim - 1))
    total = eta.sum(axis=0)
    of_nodes = np.tensordot(nodes.T, eta / total, axes=1)
    deviations = np.einsum("n...,bn...->b...", of_nodes, response.deviations)
    return EffectResponse(tuple(further), np.log(total), deviations.astype(np.float32))
