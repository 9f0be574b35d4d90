"""How a campaign's readings respond to alpha_scat, alpha_abs and physical effects.

The logarithm of eta is a sum: that of the bench as it is, and of every effect what it adds.
Each is a polynomial through values at nodes. Of one effect that is exact at the nodes; several
effects at once are corrected by simulating them together where a fit ends (`Anchor`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.effects.effect import EffectParameter
from mcrim_mitsuba.efficiency.eta_grid import BATCHES, EtaGrid, Grid
from mcrim_mitsuba.efficiency.surface import Cubics, Lagrange


@dataclass(frozen=True, eq=False)
class Point:
    """Weights of the nodes of a grid at one alpha_scat and alpha_abs per reading."""

    #: (readings, scattering nodes) float64: Weights, and their derivatives by alpha_scat (1/cm);
    #: one row where all readings share it.
    scattering: NDArray[np.float64]
    scattering_slope: NDArray[np.float64]
    #: (readings, absorption nodes) float64
    absorption: NDArray[np.float64]
    absorption_slope: NDArray[np.float64]

    @classmethod
    def of(cls, grid: Grid, alpha_scat: Sequence[float], alpha_abs: Sequence[float]) -> Point:
        """Of (readings,) coefficients in 1/cm."""
        if len(set(alpha_scat)) == len(set(alpha_abs)) == 1:
            alpha_scat, alpha_abs = alpha_scat[:1], alpha_abs[:1]
        pairs = list(zip(alpha_scat, alpha_abs, strict=True))
        found: dict[tuple[float, float], list[NDArray[np.float64]]] = {}
        for a_s, a_a in dict.fromkeys(pairs):
            scattering, by_log_scat = grid.scattering.weights(np.log(a_s))
            offset = a_a + grid.OFFSET_PER_CM
            absorption, by_log_abs = grid.absorption.weights(np.log(offset))
            found[a_s, a_a] = [scattering, by_log_scat / a_s, absorption, by_log_abs / offset]
        return cls(*map(np.array, zip(*(found[pair] for pair in pairs), strict=True)))

    def value(self, table: NDArray) -> NDArray[np.float64]:
        """(readings,) of a (readings, scattering nodes, absorption nodes) table."""
        along = np.matmul(table, self.absorption[:, :, None])[:, :, 0]
        return (self.scattering * along).sum(1)

    def value_and_slopes(
        self, table: NDArray
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(readings,) value, and its slopes by alpha_scat and by alpha_abs."""
        along = np.matmul(table, self.absorption[:, :, None])[:, :, 0]
        across = np.matmul(table, self.absorption_slope[:, :, None])[:, :, 0]
        return (
            (self.scattering * along).sum(1),
            (self.scattering_slope * along).sum(1),
            (self.scattering * across).sum(1),
        )

    def values(self, tables: NDArray) -> NDArray[np.float64]:
        """(batches, readings) of (batches, readings, scattering nodes, absorption nodes)."""
        along = np.matmul(tables, self.absorption.astype(tables.dtype)[:, :, None])[..., 0]
        return (along * self.scattering.astype(tables.dtype)).sum(-1)


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

    def at(
        self, point: Point, values: Sequence[float]
    ) -> tuple[NDArray[np.float64], NDArray, NDArray, NDArray[np.float64]]:
        """(readings,) addition, its slopes by alpha_scat and alpha_abs, and (readings, axes)."""
        each = [axis.weights(value) for axis, value in zip(self.axes, values, strict=True)]
        table = self._along([weights for weights, _ in each], self.log_ratio)
        by_axis = [
            point.value(
                self._along(
                    [slope if j == i else weights for j, (weights, slope) in enumerate(each)],
                    self.log_ratio,
                )
            )
            for i in range(len(each))
        ]
        slopes = np.array(by_axis).T.reshape(table.shape[0], len(each))
        return (*point.value_and_slopes(table), slopes)

    def weights_at(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """(points, nodes of all axes) weights of the nodes at (points,) values of each axis."""
        weights = np.ones((1, 1))
        for axis, own in zip(self.axes, values, strict=True):
            each = axis.nodes.weights_at(axis.parameter.coordinates_of(own - axis.nominal))
            points = max(len(weights), len(each))
            weights = (weights[:, :, None] * each[:, None, :]).reshape(points, -1)
        return weights

    def deviations_at(self, point: Point, values: Sequence[float]) -> NDArray[np.float64]:
        """(batches, readings) deviations of the addition."""
        each = [
            axis.weights(value)[0].astype(np.float32)
            for axis, value in zip(self.axes, values, strict=True)
        ]
        batches = self.deviations
        for weights in each:
            batches = np.einsum("n,bn...->b...", weights, batches)
        return point.values(batches)

    @staticmethod
    def _along(weights: Sequence[NDArray], table: NDArray) -> NDArray:
        for each in weights:
            table = np.tensordot(each, table, axes=1)
        return table

    def interpolation_error(self, point: Point, values: Sequence[float]) -> NDArray[np.float64]:
        """(readings,) size of the error that interpolation makes; 0 without parameters.

        Taken from what another polynomial through the nearest nodes gives.
        """
        error = np.zeros(self.log_ratio.shape[len(self.axes)])
        for number, (axis, value) in enumerate(zip(self.axes, values, strict=True)):
            weights = [a.weights(v)[0] for a, v in zip(self.axes, values, strict=True)]
            nodes, x = axis.nodes.nodes, axis.parameter.coordinate_of(value - axis.nominal)
            near = np.argsort(np.abs(nodes - x), kind="stable")
            # next to cubics the parabola through the nearest nodes, of which they are blends, next
            # to a polynomial the one without the farthest node
            kept = np.sort(near[:3] if axis.parameter.kinked else near[:-1])
            fewer = np.zeros(len(nodes))
            fewer[kept] = Lagrange(nodes[kept]).weights(x)[0]
            whole = point.value(self._along(weights, self.log_ratio))
            weights[number] = fewer
            error += np.abs(point.value(self._along(weights, self.log_ratio)) - whole)
        return error


@dataclass(frozen=True, eq=False)
class Anchor:
    """A joint simulation of all effects at one point, which a sum of single ones only estimates."""

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
    #: Those that act on eta; effects of the readings need none.
    effects: Mapping[str, EffectResponse] = field(default_factory=dict)
    #: All photons behind it.
    photons: int = 0


def stack(tables: Sequence[EtaGrid]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Tables of all readings as (readings, ...) and (batches, readings, ...)."""
    log_eta = np.stack([table.log_eta for table in tables])
    return log_eta, np.stack([table.deviations for table in tables], axis=1)


def covariance_of(deviations: NDArray) -> NDArray[np.float64]:
    """(readings, readings) covariance of mean logarithms from (batches, readings) deviations."""
    deviations = np.asarray(deviations, dtype=np.float64)
    return deviations.T @ deviations / (BATCHES * (BATCHES - 1))


# Light that has many values of an effect's parameter at once, such as indices over a band.


def mixture(response: EffectResponse, values: ArrayLike, weights: ArrayLike) -> EffectResponse:
    """The mean of eta over values of an effect's parameter, as an effect that is on or off.

    Eta itself is averaged, not its logarithm: photons of every value are counted.

    Parameters
    ----------
    response : EffectResponse
        With one parameter.
    values : (values,) array_like
        Of the parameter, as the scene takes it (an index, not its offset).
    weights : (values,) array_like
        Parts of the light, none negative; their sum need not be 1.

    Raises
    ------
    ValueError
        If the response has not one parameter, or a value is beyond its outermost nodes.
    """
    if len(response.axes) != 1:
        raise ValueError(f"a mixture over {len(response.axes)} parameters")
    (axis,) = response.axes
    values = np.asarray(values, dtype=float)
    low, high = (axis.nominal + end for end in (min(axis.values), max(axis.values)))
    if values.min() < low or values.max() > high:
        problem = f"{axis.name} = {values.min():g}..{values.max():g} is beyond {low:g}..{high:g}"
        raise ValueError(problem)
    # (values, nodes): what each node contributes to the logarithm at each value
    nodes = np.array([axis.weights(value)[0] for value in values])
    parts = np.exp(np.tensordot(nodes, response.log_ratio, axes=1))
    parts *= (np.asarray(weights, dtype=float) / np.sum(weights))[:, None, None, None]
    total = parts.sum(axis=0)
    of_nodes = np.tensordot(nodes.T, parts / total, axes=1)
    deviations = np.einsum("nrsa,bnrsa->brsa", of_nodes, response.deviations)
    return EffectResponse((), np.log(total), deviations.astype(np.float32))
