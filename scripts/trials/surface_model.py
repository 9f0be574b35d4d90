"""Campaigns fitted to surfaces: formulas, or photon records that are reweighted.

`CampaignModel` is a model as `inference.model.Model` asks for, of surfaces that somebody else
makes, so that fits can be tried on a bench that is known exactly. Further scene parameters are
interpolated between surfaces.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.efficiency.eta_surface import EtaSurface
from mcrim_mitsuba.efficiency.surface import EtaPoint, Lagrange
from mcrim_mitsuba.inference.model import (
    Prediction,
    free_parameters,
    refuse_unnamed_coefficients,
)

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


class EfficiencySurface(Protocol):
    """The light collection efficiency of one configuration as a function of its unknowns."""

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        """Range of alpha_scat in which the surface may be asked; its lower end is above 0."""

    def evaluate(
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        error: bool = True,
    ) -> EtaPoint:
        """Efficiency, its error and its gradient at one point.

        Raises InputError outside the surface's range, and where its photons say too little; a
        search that only passes through may do without this `check`, and without the `error`,
        which may be NaN then.
        """

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        """Monte Carlo covariance of eta at two points, each a value for every parameter."""


class RecordSurface(EtaSurface):
    """An efficiency surface of photon records."""

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        return self.grid.alpha_scat_range_per_cm

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        points = [(point[ALPHA_SCAT], point[ALPHA_ABS]) for point in (first, second)]
        batches = self.batches(points)
        products = np.prod(batches - batches.mean(axis=0), axis=1)
        return float(products.sum()) / (len(batches) * (len(batches) - 1))


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

    def evaluate(
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        error: bool = True,
        **scene_parameters: float,
    ) -> EtaPoint:
        points = self._at_nodes(alpha_scat_per_cm, alpha_abs_per_cm, check, error)
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
        self, alpha_scat: float, alpha_abs: float, check: bool, error: bool
    ) -> list[EtaPoint]:
        """The nodes' surfaces at one pair of coefficients."""
        points = [
            node.evaluate(alpha_scat, alpha_abs, check=check, error=error) for node in self._nodes
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


#: Gives the surface of one configuration: every scene parameter with its value, alpha_scat
#: and alpha_abs left out.
SurfaceMaker = Callable[[dict[str, Value]], EfficiencySurface]


def _configurations(
    campaign: Campaign,
) -> tuple[
    list[tuple[tuple[tuple[str, Value], ...], dict[str, Value], dict[str, float]]],
    tuple[InterpolationAxis, ...],
]:
    """Per reading what tells its configuration apart, its parameters and its coefficients; and
    the axes between whose nodes surfaces are interpolated."""
    named = campaign.parameters
    fixed = {name: known.start for name, known in named.items() if known.fixed}
    further = {
        name: (known.minimum, known.maximum)
        for name, known in named.items()
        if not known.fixed and name not in (ALPHA_SCAT, ALPHA_ABS)
    }
    with placed(path=campaign.path):
        axes = axes_for(further) if further else ()
    rows = []
    for reading in campaign.measurements.readings:
        values = {**campaign.scene.parameters, **fixed, **reading.parameters}
        coefficients = {name: float(values.pop(name)) for name in (ALPHA_SCAT, ALPHA_ABS)}
        configuration = {name: v for name, v in values.items() if name not in further}
        rows.append((tuple(sorted(configuration.items())), values, coefficients))
    return rows, axes


class CampaignModel:
    """Predicts a campaign's readings, for any values of its free parameters; see `Model`.

    `surfaces` is called once per distinct configuration, and where further scene parameters are
    free, once per node of the interpolation (5 nodes for one parameter, 9 for two).

    Raises InputError if the scene does not name alpha_scat and alpha_abs, if the surfaces do not
    cover alpha_scat's range, or as `axes_for`.
    """

    def __init__(self, campaign: Campaign, surfaces: SurfaceMaker) -> None:
        self.campaign = campaign
        self.readings = campaign.measurements.readings
        refuse_unnamed_coefficients(campaign)
        self._fixed_scale = campaign.scale.start if campaign.scale is not None else math.nan
        made: dict[tuple, EfficiencySurface] = {}
        asked, axes = _configurations(campaign)
        for key, values, _ in asked:
            if key not in made:
                made[key] = _surface(axes, surfaces, values)
        # surfaces, with coefficients that are not fitted and whether a reading in use asks, and
        # every reading's place among them: most readings ask what others do
        places: dict[tuple, int] = {}
        self._asked: list[tuple[EfficiencySurface, dict[str, float], bool]] = []
        self._place_of = np.empty(len(asked), int)
        for row, (reading, (key, _, coefficients)) in enumerate(
            zip(self.readings, asked, strict=True)
        ):
            held = {n: v for n, v in coefficients.items() if n not in campaign.free}
            own = (key, *held.items(), reading.use)
            if own not in places:
                places[own] = len(places)
                self._asked.append((made[key], held, reading.use))
            self._place_of[row] = places[own]
        bounds = (surface.alpha_scat_bounds_per_cm for surface in made.values())
        lows, highs = zip(*bounds, strict=True)
        self.free = free_parameters(
            campaign,
            {ALPHA_SCAT: (max(lows), min(highs))},
            "the simulated photons tell about {:g}..{:g} only",
            "simulate scattering coefficients within min and max",
        )

    def predict(self, theta: Array, *, check: bool = False, covariance: bool = False) -> Prediction:
        values = {p.name: float(v) for p, v in zip(self.free, theta, strict=True)}
        scale = values.pop(SCALE, self._fixed_scale)
        error = check or covariance
        points = [
            surface.evaluate(**values, **known, check=check and used, error=error)
            for surface, known, used in self._asked
        ]
        # the scale is in no surface's gradient
        slopes = [[point.gradient.get(p.name, 0.0) for p in self.free] for point in points]
        eta = np.array([point.eta for point in points])[self._place_of]
        eta_slopes = np.array(slopes).reshape(len(points), len(self.free))[self._place_of]
        is_scale = np.array([float(p.name == SCALE) for p in self.free])
        sigmas = np.array([point.sigma for point in points])
        interpolation_errors = np.array([point.interpolation_error for point in points])
        return Prediction(
            scale=scale,
            eta=eta,
            eta_slopes=eta_slopes,
            signal=scale * eta,
            signal_slopes=scale * eta_slopes + np.outer(eta, is_scale),
            signal_per_eta=np.full(len(eta), scale),
            eta_sigma=sigmas[self._place_of] if error else None,
            interpolation_error=interpolation_errors[self._place_of],
            eta_errors=self._errors(sigmas, values)[self._place_of] if covariance else None,
        )

    def predict_many(self, thetas: Array) -> Array:
        return np.array([self.predict(theta).signal for theta in thetas])

    def _errors(self, sigmas: Array, values: Mapping[str, float]) -> Array:
        """(asked, asked) Monte Carlo errors of eta by independent sources: those of a surface."""
        errors = np.diag(sigmas)
        of_surfaces: dict[int, list[int]] = {}
        for place, (surface, _, _) in enumerate(self._asked):
            of_surfaces.setdefault(id(surface), []).append(place)
        for places in of_surfaces.values():
            if len(places) > 1:
                covariance = np.diag(sigmas[places] ** 2)
                for i, j in itertools.combinations(range(len(places)), 2):
                    surface, first, _ = self._asked[places[i]]
                    second = self._asked[places[j]][1]
                    covariance[i, j] = covariance[j, i] = (
                        sigmas[places[j]] ** 2
                        if first == second
                        else surface.covariance({**values, **second}, {**values, **first})
                    )
                sizes, directions = np.linalg.eigh(covariance)
                errors[np.ix_(places, places)] = directions * np.sqrt(np.maximum(sizes, 0.0))
        return errors


def _surface(
    axes: tuple[InterpolationAxis, ...], surfaces: SurfaceMaker, values: dict[str, Value]
) -> EfficiencySurface:
    """The surface of a configuration, interpolated in further scene parameters."""
    if not axes:
        return surfaces(values)
    return InterpolatedSurface(axes, lambda node: surfaces({**values, **node}))
