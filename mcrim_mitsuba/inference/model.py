"""A campaign's readings as functions of its free parameters.

`CampaignModel` reads surfaces of photon records, one per configuration; `ResponseModel` responses
of the readings to the coefficients and to effects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.responses import (
    Anchor,
    EffectResponse,
    Point,
    Responses,
    covariance_of,
)
from mcrim_mitsuba.efficiency.surface import (
    EfficiencySurface,
    EtaPoint,
    InterpolatedSurface,
    InterpolationAxis,
    axes_for,
)

#: Gives the surface of one configuration: every scene parameter with its value, alpha_scat
#: and alpha_abs left out.
SurfaceMaker = Callable[[dict[str, Value]], EfficiencySurface]


def configurations(campaign: Campaign) -> list[dict[str, Value]]:
    """What a model of the campaign asks surfaces for, each configuration once, in this order."""
    asked: list[dict[str, Value]] = []
    rows, axes = _configurations(campaign)
    distinct: dict[tuple[tuple[str, Value], ...], dict[str, Value]] = {}
    for key, values, _ in rows:
        distinct.setdefault(key, values)
    for values in distinct.values():
        nodes = itertools.product(*(axis.nodes for axis in axes))
        names = [axis.name for axis in axes]
        asked += [{**values, **dict(zip(names, map(float, node), strict=True))} for node in nodes]
    return asked


def _configurations(
    campaign: Campaign,
) -> tuple[
    list[tuple[tuple[tuple[str, Value], ...], dict[str, Value], dict[str, float]]],
    tuple[InterpolationAxis, ...],
]:
    """Per reading what tells its configuration apart, its parameters and its coefficients; and
    the axes between whose nodes surfaces are interpolated."""
    named = campaign.parameters
    held = {name: known.start for name, known in named.items() if known.fixed}
    further = {
        name: (known.minimum, known.maximum)
        for name, known in named.items()
        if not known.fixed and name not in (ALPHA_SCAT, ALPHA_ABS)
    }
    try:
        axes = axes_for(further) if further else ()
    except InputError as error:
        raise InputError(error.problem, error.mend, path=campaign.path) from None
    rows = []
    for reading in campaign.measurements.readings:
        values = {**campaign.scene.parameters, **held, **reading.parameters}
        coefficients = {name: float(values.pop(name)) for name in (ALPHA_SCAT, ALPHA_ABS)}
        configuration = {name: v for name, v in values.items() if name not in further}
        rows.append((tuple(sorted(configuration.items())), values, coefficients))
    return rows, axes


#: What a campaign that says nothing of the scale means: free, above 0, no prior.
UNKNOWN_SCALE = CampaignParameter(SCALE, math.nan, 0.0, math.inf, None, None, fixed=False)


@dataclass(frozen=True)
class _Row:
    """A reading with its surface, and the values of the surface's parameters that are known."""

    reading: Reading
    surface: EfficiencySurface
    known: dict[str, float]


@dataclass(frozen=True)
class Prediction:
    """What a point in parameter space predicts for every reading, used or not."""

    #: Signal per eta.
    scale: float
    #: The efficiency of every reading.
    points: tuple[EtaPoint, ...]
    #: (readings,) float64
    eta: NDArray[np.float64]
    #: (readings, free parameters) float64: d eta / d parameter; 0 for the scale.
    eta_slopes: NDArray[np.float64]
    #: (readings,) float64: In the readings' unit.
    signal: NDArray[np.float64]
    #: (readings, free parameters) float64: d signal / d parameter.
    signal_slopes: NDArray[np.float64]
    #: (readings,) float64: d signal / d eta.
    signal_per_eta: NDArray[np.float64]
    #: (readings, readings) float64 or None: Monte Carlo covariance of `eta`; None unless asked for.
    #: Readings that share a simulation share its error; different simulations are independent.
    eta_covariance: NDArray[np.float64] | None = None


class Model(Protocol):
    """What fits ask of a model: `CampaignModel` says what each part means."""

    @property
    def campaign(self) -> Campaign: ...

    @property
    def free(self) -> tuple[CampaignParameter, ...]: ...

    @property
    def readings(self) -> tuple[Reading, ...]: ...

    def predict(
        self, theta: NDArray[np.float64], *, check: bool = False, covariance: bool = False
    ) -> Prediction: ...


class CampaignModel:
    """Predicts a campaign's readings, for any values of its free parameters.

    Parameters
    ----------
    campaign : Campaign
    surfaces : callable
        See `SurfaceMaker`. Called once per distinct configuration, and where further scene
        parameters are free, once per node of the interpolation.

    Attributes
    ----------
    free : tuple of CampaignParameter
        In the order of `Campaign.free`: alpha_scat's bounds cut down to what the surfaces
        cover, the others as the campaign has them.
    readings : tuple of Reading

    Raises
    ------
    InputError
        If the scene does not name alpha_scat and alpha_abs, if the surfaces do not cover
        alpha_scat's range, or as `axes_for`.
    """

    def __init__(self, campaign: Campaign, surfaces: SurfaceMaker) -> None:
        self.campaign = campaign
        self.readings = campaign.measurements.readings
        self._fixed_scale = campaign.scale.start if campaign.scale is not None else math.nan
        refuse_unnamed_coefficients(campaign)
        self._rows = self._build_rows(surfaces)
        named = {**campaign.parameters, SCALE: campaign.scale or UNKNOWN_SCALE}
        self.free = tuple(self._within_surfaces(named[name]) for name in campaign.free)

    def _build_rows(self, surfaces: SurfaceMaker) -> tuple[_Row, ...]:
        """Every reading with the surface of its configuration, each surface made once."""
        made: dict[tuple, EfficiencySurface] = {}
        rows = []
        asked, axes = _configurations(self.campaign)
        for reading, (key, values, coefficients) in zip(self.readings, asked, strict=True):
            if key not in made:
                made[key] = _between(axes, surfaces, values) if axes else surfaces(values)
            known = {n: v for n, v in coefficients.items() if n not in self.campaign.free}
            rows.append(_Row(reading, made[key], known))
        return tuple(rows)

    def _within_surfaces(self, parameter: CampaignParameter) -> CampaignParameter:
        """The parameter with the bounds that the fit may use."""
        if parameter.name != ALPHA_SCAT:
            return parameter
        lows, highs = zip(
            *(row.surface.alpha_scat_bounds_per_cm for row in self._rows), strict=True
        )
        low, high = max(lows), min(highs)
        return _cut(
            parameter, low, high, f"the simulated photons tell about {low:g}..{high:g} only",
            "simulate scattering coefficients within min and max", self.campaign,
        )  # fmt: skip

    def predict(
        self, theta: NDArray[np.float64], *, check: bool = False, covariance: bool = False
    ) -> Prediction:
        """Every reading's efficiency for values of the free parameters.

        Parameters
        ----------
        theta : (free parameters,) float64
            In the order of `free`.
        check : bool
            Refuse (InputError) points of the readings in use where a surface says too little.
        covariance : bool
            Also compute the Monte Carlo covariance.
        """
        values = {p.name: float(v) for p, v in zip(self.free, theta, strict=True)}
        scale = values.pop(SCALE, self._fixed_scale)
        arguments = [{**values, **row.known} for row in self._rows]
        # readings of one configuration ask the same: answer once
        answers: dict[tuple, EtaPoint] = {}
        points = []
        for row, asked in zip(self._rows, arguments, strict=True):
            careful = check and row.reading.use
            key = (id(row.surface), careful, *sorted(asked.items()))
            if key not in answers:
                answers[key] = row.surface.evaluate(
                    **asked, check=careful, errors=check or covariance
                )
            points.append(answers[key])
        # the scale is in no surface's gradient
        slopes = [[point.gradient.get(p.name, 0.0) for p in self.free] for point in points]
        eta = np.array([point.eta for point in points])
        eta_slopes = np.array(slopes).reshape(len(points), len(self.free))
        is_scale = np.array([float(p.name == SCALE) for p in self.free])
        return Prediction(
            scale=scale,
            points=tuple(points),
            eta=eta,
            eta_slopes=eta_slopes,
            signal=scale * eta,
            signal_slopes=scale * eta_slopes + np.outer(eta, is_scale),
            signal_per_eta=np.full(len(eta), scale),
            eta_covariance=self._eta_covariance(points, arguments) if covariance else None,
        )

    def _eta_covariance(
        self, points: Sequence[EtaPoint], arguments: Sequence[Mapping[str, float]]
    ) -> NDArray[np.float64]:
        """(readings, readings) Monte Carlo covariance of eta."""
        matrix = np.diag([point.sigma**2 for point in points])
        for i, row in enumerate(self._rows):
            for j, other in enumerate(self._rows[:i]):
                if row.surface is not other.surface:
                    continue
                matrix[i, j] = matrix[j, i] = (
                    points[i].sigma ** 2
                    if arguments[i] == arguments[j]
                    else row.surface.covariance(arguments[i], arguments[j])
                )
        return matrix


def _between(
    axes: tuple[InterpolationAxis, ...], surfaces: SurfaceMaker, values: dict[str, Value]
) -> EfficiencySurface:
    """The surface of a configuration, interpolated in further scene parameters."""
    return InterpolatedSurface(axes, lambda node: surfaces({**values, **node}))


def _cut(
    parameter: CampaignParameter, low: float, high: float, known: str, mend: str, campaign: Campaign
) -> CampaignParameter:
    """A parameter with its bounds cut down to what was simulated."""
    least, most = max(parameter.minimum, low), min(parameter.maximum, high)
    if least >= most:
        raise InputError(
            f"{parameter.name} may be {parameter.minimum:g}..{parameter.maximum:g}, but {known}",
            mend, path=campaign.path,
        )  # fmt: skip
    start = min(max(parameter.start, least), most)
    return replace(parameter, start=start, minimum=least, maximum=most)


def refuse_unnamed_coefficients(campaign: Campaign) -> None:
    """A scene that hides its coefficients cannot be fitted."""
    for name in (ALPHA_SCAT, ALPHA_ABS):
        if name not in campaign.scene.parameters:
            raise InputError(
                f"the scene has no parameter {name}",
                f'name the crystal\'s coefficient in a <default name="{name}" .../>',
                path=campaign.scene.path,
            )


# ---- with effects, from responses ----

_Found = TypeVar("_Found")


class _Latest(Generic[_Found]):
    """What was found last: who asks next often asks for another scale only."""

    def __init__(self) -> None:
        self._known: tuple[list[tuple[str, float]], _Found] | None = None

    def get(self, values: Mapping[str, float], find: Callable[[], _Found]) -> _Found:
        """What `find` gives at these values, of which the scale does not matter."""
        key = sorted((name, value) for name, value in values.items() if name != SCALE)
        known = self._known  # other threads may replace it meanwhile
        if known is None or known[0] != key:
            known = self._known = (key, find())
        return known[1]


_LogEta = tuple[NDArray[np.float64], dict[str, NDArray[np.float64]], tuple[Point, Point]]


class ResponseModel:
    """Predicts a campaign's readings with some effects switched on.

    It has what `CampaignModel` has for `Likelihood` and the searches, and answers in a fraction
    of a millisecond.

    Parameters
    ----------
    campaign : Campaign
        With the effects' parameters among its own.
    responses : Responses
    effects : sequence of Effect
        Those switched on.
    anchor : Anchor, optional

    Attributes
    ----------
    free : tuple of CampaignParameter
        In the order of `Campaign.free`; bounds cut down to what the responses cover.
    readings : tuple of Reading
    """

    def __init__(
        self,
        campaign: Campaign,
        responses: Responses,
        effects: Sequence[Effect],
        anchor: Anchor | None = None,
    ) -> None:
        refuse_unnamed_coefficients(campaign)
        self.campaign = campaign
        self.readings = campaign.measurements.readings
        self._responses = responses
        in_order = sorted(effects, key=lambda effect: effect.order)
        # name of the one parameter, and what it does to signals
        self._of_readings = [
            (effect.parameters[0].name, effect.reading)
            for effect in in_order
            if effect.reading is not None
        ]
        self._eta_effects = [effect for effect in effects if effect.name in responses.effects]
        named = {**campaign.parameters, SCALE: campaign.scale or UNKNOWN_SCALE}
        self._held = {name: known.start for name, known in named.items() if known.fixed}
        self.free = tuple(self._within_responses(named[name]) for name in campaign.free)
        self._anchor = anchor
        self._latest_log_eta: _Latest[_LogEta] = _Latest()
        self._latest_deviations: _Latest[NDArray[np.float64]] = _Latest()
        self._shift: NDArray[np.float64] | None = None
        if anchor is not None:
            values = {**self._held, **anchor.values}
            self._shift = anchor.log_eta - self._log_eta(values)[0]

    def _within_responses(self, parameter: CampaignParameter) -> CampaignParameter:
        """The parameter with the bounds that the fit may use."""
        grid = self._responses.grid
        ranges = {
            ALPHA_SCAT: grid.alpha_scat_range_per_cm,
            ALPHA_ABS: grid.alpha_abs_range_per_cm,
        }
        for effect in self._eta_effects:
            for axis in self._responses.effects[effect.name].axes:
                ends = [axis.nominal + value for value in axis.values if math.isfinite(value)]
                high = math.inf if any(map(math.isinf, axis.values)) else max(ends)
                ranges[axis.name] = (min(ends), high)
        if parameter.name not in ranges:
            return parameter
        low, high = ranges[parameter.name]
        return _cut(
            parameter, low, high, f"only {low:g}..{high:g} is simulated",
            "give it min and max within that range", self.campaign,
        )  # fmt: skip

    def predict(
        self, theta: NDArray[np.float64], *, check: bool = False, covariance: bool = False
    ) -> Prediction:
        """Every reading's prediction; see `CampaignModel.predict`. Nothing is refused."""
        free = {p.name: float(v) for p, v in zip(self.free, theta, strict=True)}
        values = {**self._held, **free}
        scale = values[SCALE]
        log_eta, slopes, point = self._latest_log_eta.get(values, lambda: self._log_eta(values))
        if self._shift is not None:
            log_eta = log_eta + self._shift
        eta = np.exp(log_eta)
        eta_slopes = np.zeros((len(eta), len(self.free)))
        for i, parameter in enumerate(self.free):
            if parameter.name in slopes:
                eta_slopes[:, i] = eta * slopes[parameter.name]
        signal = scale * eta
        signal_slopes = scale * eta_slopes
        if SCALE in free:
            signal_slopes[:, list(free).index(SCALE)] = eta
        per_eta = np.full(len(eta), scale)
        for name, reading in self._of_readings:
            signal, by_signal, by_value = reading(signal, values[name])
            per_eta = per_eta * by_signal
            signal_slopes = signal_slopes * by_signal[:, None]
            if name in free:
                signal_slopes[:, list(free).index(name)] += by_value
        eta_covariance, sigma = None, np.full(len(eta), math.nan)
        if covariance or check:
            deviations = self._latest_deviations.get(
                values, lambda: self._deviations(values, point)
            )
            eta_covariance = np.outer(eta, eta) * covariance_of(deviations)
            sigma = np.sqrt(np.diag(eta_covariance))
        error = self._interpolation_error(values, point) * eta if check else np.zeros(len(eta))
        return Prediction(
            scale=scale,
            points=tuple(
                EtaPoint(float(e), float(s), {}, math.nan, float(i))
                for e, s, i in zip(eta, sigma, error, strict=True)
            ) if covariance or check else (),
            eta=eta,
            eta_slopes=eta_slopes,
            signal=signal,
            signal_slopes=signal_slopes,
            signal_per_eta=per_eta,
            eta_covariance=eta_covariance if covariance else None,
        )  # fmt: skip

    def eta_batches(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(batches, readings) deviations of log(eta) in the simulation's batches.

        Batches of one number belong together in all responses that were simulated with one seed.
        """
        free = {p.name: float(v) for p, v in zip(self.free, theta, strict=True)}
        values = {**self._held, **free}
        return self._deviations(values, self._points(values))

    def _coefficients(self, values: Mapping[str, float], name: str) -> list[float]:
        """Every reading's own coefficient: fitted, held, its column's or the scene's."""
        if name in values:
            return [values[name]] * len(self.readings)
        default = self.campaign.scene.parameters[name]
        return [float(reading.parameters.get(name, default)) for reading in self.readings]

    def _points(self, values: Mapping[str, float]) -> tuple[Point, Point]:
        """Where all readings are on the fine grid and on the coarse one."""
        coefficients = [self._coefficients(values, name) for name in (ALPHA_SCAT, ALPHA_ABS)]
        fine, coarse = self._responses.grid, self._responses.coarse
        return Point.of(fine, *coefficients), Point.of(coarse, *coefficients)

    def _log_eta(self, values: Mapping[str, float]) -> _LogEta:
        """(readings,) log(eta), its slopes by parameter, and the points it was taken at."""
        point = self._points(values)
        log_eta, by_scat, by_abs = point[0].value_and_slopes(self._responses.log_eta)
        slopes: dict[str, NDArray[np.float64]] = {}
        for response, own in self._switched_on(values):
            more, more_by_scat, more_by_abs, by_axis = response.at(point[1], own)
            log_eta, by_scat, by_abs = log_eta + more, by_scat + more_by_scat, by_abs + more_by_abs
            slopes |= {axis.name: by_axis[:, i] for i, axis in enumerate(response.axes)}
        return log_eta, {**slopes, ALPHA_SCAT: by_scat, ALPHA_ABS: by_abs}, point

    def _deviations(
        self, values: Mapping[str, float], point: tuple[Point, Point]
    ) -> NDArray[np.float64]:
        if self._anchor is not None:
            return self._anchor.deviations
        deviations = point[0].values(self._responses.deviations)
        for response, own in self._switched_on(values):
            deviations = deviations + response.deviations_at(point[1], own)
        return deviations

    def _interpolation_error(
        self, values: Mapping[str, float], point: tuple[Point, Point]
    ) -> NDArray[np.float64]:
        error = np.zeros(len(self.readings))
        if self._anchor is None:
            for response, own in self._switched_on(values):
                error += response.interpolation_error(point[1], own)
        return error

    def _switched_on(
        self, values: Mapping[str, float]
    ) -> Iterator[tuple[EffectResponse, list[float]]]:
        """Responses to the effects that are switched on, each with its parameters' values."""
        for effect in self._eta_effects:
            response = self._responses.effects[effect.name]
            yield response, [values[axis.name] for axis in response.axes]
