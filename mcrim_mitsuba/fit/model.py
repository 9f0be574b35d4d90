"""A campaign's readings as functions of its free parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.interpolation import InterpolatedSurface, InterpolationAxis, axes_for
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT, EtaPoint, Surface

#: Gives the surface of one configuration: every scene parameter with its value, alpha_scat
#: and alpha_abs left out.
SurfaceMaker = Callable[[dict[str, Value]], Surface]


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
    surface: Surface
    known: dict[str, float]


@dataclass(frozen=True)
class Prediction:
    """What a point in parameter space predicts for every reading, used or not.

    Attributes
    ----------
    scale : float
        Signal per eta.
    points : tuple of EtaPoint
        The efficiency of every reading.
    eta : (readings,) float64
    eta_slopes : (readings, free parameters) float64
        d eta / d parameter; 0 for the scale.
    signal : (readings,) float64
        In the readings' unit.
    signal_slopes : (readings, free parameters) float64
        d signal / d parameter.
    signal_per_eta : (readings,) float64
        d signal / d eta.
    eta_covariance : (readings, readings) float64 or None
        Monte Carlo covariance of `eta`; None unless asked for. Readings that share a
        simulation share its error; different simulations are independent.
    """

    scale: float
    points: tuple[EtaPoint, ...]
    eta: NDArray[np.float64]
    eta_slopes: NDArray[np.float64]
    signal: NDArray[np.float64]
    signal_slopes: NDArray[np.float64]
    signal_per_eta: NDArray[np.float64]
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
        made: dict[tuple, Surface] = {}
        rows = []
        asked, axes = _configurations(self.campaign)
        for reading, (key, values, coefficients) in zip(self.readings, asked, strict=True):
            if key not in made:
                made[key] = (
                    InterpolatedSurface(axes, partial(_at_node, surfaces, values))
                    if axes
                    else surfaces(values)
                )
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
        low, high = max(parameter.minimum, *lows), min(parameter.maximum, *highs)
        if low >= high:
            raise InputError(
                f"{ALPHA_SCAT} may be {parameter.minimum:g}..{parameter.maximum:g}, but the "
                f"simulated photons tell about {max(lows):g}..{min(highs):g} only",
                "simulate scattering coefficients within min and max",
                path=self.campaign.path,
            )
        start = min(max(parameter.start, low), high)
        return CampaignParameter(
            ALPHA_SCAT, start, low, high, parameter.prior, parameter.prior_sigma, fixed=False
        )

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


def _at_node(
    surfaces: SurfaceMaker, values: Mapping[str, Value], node: Mapping[str, float]
) -> Surface:
    """The surface of a configuration at a node of the interpolation."""
    return surfaces({**values, **node})


def refuse_unnamed_coefficients(campaign: Campaign) -> None:
    """A scene that hides its coefficients cannot be fitted."""
    for name in (ALPHA_SCAT, ALPHA_ABS):
        if name not in campaign.scene.parameters:
            raise InputError(
                f"the scene has no parameter {name}",
                f'name the crystal\'s coefficient in a <default name="{name}" .../>',
                path=campaign.scene.path,
            )
