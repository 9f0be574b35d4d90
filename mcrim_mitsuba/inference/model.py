"""A campaign's readings as functions of its free parameters.

`Model` is what fits ask for; `ResponseModel` answers from responses of the readings to the
coefficients and to effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.effects.effect import Effect, Rows
from mcrim_mitsuba.efficiency.responses import Anchor, EffectResponse, Point, Responses, errors_of


@dataclass(frozen=True)
class Prediction:
    """What a point in parameter space predicts for every reading, used or not."""

    #: Signal per eta, of the campaign's own crystal.
    scale: float
    #: (readings,) float64
    eta: Array
    #: (readings, free parameters) float64: d eta / d parameter; 0 for the scale.
    eta_slopes: Array
    #: (readings,) float64: In the readings' unit.
    signal: Array
    #: (readings, free parameters) float64: d signal / d parameter.
    signal_slopes: Array
    #: (readings,) float64: d signal / d eta.
    signal_per_eta: Array
    #: (readings,) float64: Monte Carlo standard error of `eta`, and estimated size of its
    #: interpolation error; None unless asked for, the first by a check or the covariance, the
    #: second by a check.
    eta_sigma: Array | None = None
    interpolation_error: Array | None = None
    #: (readings, sources) float64 or None: Monte Carlo errors of `eta` by independent sources, E of
    #: its covariance E E^T; None unless asked for. Readings that share a simulation share its
    #: error; different simulations are independent.
    eta_errors: Array | None = None
    #: (readings, tolerances) float64 or None: Change of `eta` by a standard uncertainty of each of
    #: the campaign's numbers; with `eta_errors`, where it has tolerances.
    eta_of_tolerances: Array | None = None

    def where_off(self, tolerances: Array, weighted_residuals: Array) -> Prediction:
        """With the bench's numbers off as the readings have them: T^T C^-1 r of their tolerances.

        That is how likely offsets are, in standard uncertainties, with T, (used, tolerances), what
        these do to the readings, and C^-1 r (used,).
        """
        if self.eta_of_tolerances is None:
            return self
        moved = self.eta_of_tolerances @ (tolerances.T @ weighted_residuals)
        return replace(self, eta=self.eta + moved, signal=self.signal + self.signal_per_eta * moved)


class Model(Protocol):
    """What fits ask of a model."""

    @property
    def campaign(self) -> Campaign: ...

    @property
    def free(self) -> tuple[CampaignParameter, ...]:
        """In the order of `Campaign.free`, bounds cut down to what was simulated."""

    @property
    def readings(self) -> tuple[Reading, ...]: ...

    def predict(self, theta: Array, *, check: bool = False, covariance: bool = False) -> Prediction:
        """Every reading's prediction for values of the free parameters, in the order of `free`.

        With `check` points of the readings in use where a simulation says too little are refused
        (InputError), and the errors of eta are told; `covariance` is the Monte Carlo one.
        """

    def predict_many(self, thetas: Array) -> Array:
        """(points, readings) signals of (points, free parameters) values; nothing is refused."""


#: What a campaign that says nothing of the scale means: free, above 0, no prior.
UNKNOWN_SCALE = CampaignParameter(SCALE, math.nan, 0.0, math.inf, fixed=False)


def _named(campaign: Campaign) -> dict[str, CampaignParameter]:
    """The campaign's parameters, the scale among them."""
    return {**campaign.parameters, SCALE: campaign.scale or UNKNOWN_SCALE}


def held(campaign: Campaign) -> dict[str, float]:
    """What the campaign names and holds."""
    return {name: known.start for name, known in _named(campaign).items() if known.fixed}


def refuse_unnamed_coefficients(campaign: Campaign) -> None:
    """Refuse a scene whose coefficients are no parameters: it cannot be fitted."""
    for name in (ALPHA_SCAT, ALPHA_ABS):
        if name not in campaign.scene.parameters:
            problem = f"the scene has no parameter {name}"
            mend = f'name the crystal\'s coefficient in a <default name="{name}" .../>'
            raise InputError(problem, mend, path=campaign.scene.path)


def free_parameters(
    campaign: Campaign, ranges: Mapping[str, tuple[float, float]], known: str, mend: str
) -> tuple[CampaignParameter, ...]:
    """The free parameters, their bounds cut down to the ranges that were simulated."""
    parameters = [_named(campaign)[name] for name in campaign.free]
    for place, parameter in enumerate(parameters):
        if parameter.name not in ranges:
            continue
        low, high = ranges[parameter.name]
        least, most = max(parameter.minimum, low), min(parameter.maximum, high)
        if least >= most:
            limits = f"{parameter.name} may be {parameter.minimum:g}..{parameter.maximum:g}"
            problem = f"{limits}, but {known.format(low, high)}"
            raise InputError(problem, mend, path=campaign.path)
        start = min(max(parameter.start, least), most)
        parameters[place] = replace(parameter, start=start, minimum=least, maximum=most)
    return tuple(parameters)


# ---- from responses ----


def _energy_ratios(campaign: Campaign) -> Array:
    """(readings,) energies over that which each row's scale refers to; 1 where none is told."""
    rows = campaign.measurements.readings
    told = [row.energy_keV for row in rows if row.energy_keV is not None]
    known = campaign.energies_keV
    return np.array(
        [
            1.0
            if row.energy_keV is None
            else row.energy_keV / known.get(campaign.parameter_of(row, SCALE), told[0])
            for row in rows
        ]
    )


def _rows(campaign: Campaign) -> Rows:
    """What effects of the readings know of a campaign's rows."""
    readings, scene = campaign.measurements.readings, campaign.scene.parameters
    # what is only proposed has no line
    read = [i for i, each in enumerate(readings) if each.line and not each.of_beam]
    position = np.full(len(readings), 0.5)
    position[read] = np.linspace(-0.5, 0.5, len(read)) if len(read) > 1 else 0.0
    others = [
        campaign.parameter_of(each, SCALE) == SCALE
        and any(
            name.startswith("crystal_") and name.endswith("_mm") and value != scene.get(name)
            for name, value in each.parameters.items()
        )
        for each in readings
    ]
    return Rows(position, np.array(others, dtype=bool), _energy_ratios(campaign))


def _read_with(effect: Effect, campaign: Campaign) -> Array:
    """(readings,) bool: Which of them an effect of the readings acts on."""
    readings = campaign.measurements.readings
    return np.array([not row.of_beam and effect.name not in row.without for row in readings])


def acts_on(effect: Effect, campaign: Campaign) -> bool:
    """Whether an effect of the readings changes any that is used: there may be one crystal only."""
    assert effect.reading is not None
    readings = campaign.measurements.readings
    # its own signals: some do nothing to a signal of 1, powers and thresholds among them
    signals = np.array([reading.signal for reading in readings])
    read = effect.reading(signals, effect.parameters[0].start, _rows(campaign))[0]
    used = _read_with(effect, campaign) & [each.use for each in readings]
    # a background may begin at none
    return bool((read != signals)[used].any()) or effect.parameters[0].start == 0.0


class ResponseModel:
    """Predicts a campaign's readings with some effects switched on; see `Model`.

    It answers in a fraction of a millisecond, and refuses nothing. The campaign has the effects'
    parameters among its own.
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
        self.responses, self.anchor = responses, anchor
        self._of_light = np.array([not reading.of_beam for reading in self.readings])
        self._measured = _rows(campaign)
        # by coefficient and scale, the parameter that stands for it in every reading
        self._named = {
            name: [campaign.parameter_of(reading, name) for reading in self.readings]
            for name in (ALPHA_SCAT, ALPHA_ABS, SCALE)
        }
        # of effects of the readings, the name of their one parameter, what it does and to which
        self._of_readings = [
            (effect.parameters[0].name, effect.reading, _read_with(effect, campaign))
            for effect in sorted(effects, key=lambda effect: effect.order)
            if effect.reading is not None
        ]
        names = dict.fromkeys([*(effect.name for effect in effects), *campaign.parameters])
        #: Responses to the effects that are switched on, and to other scene parameters that are
        #: fitted.
        self.switched_on = {n: responses.effects[n] for n in names if n in responses.effects}
        of_names = {frozenset(n.split(" + ")): r for n, r in responses.effects.items()}
        #: The same with what pairs of them add, by all effects that it is the response to.
        self.added = {on: r for on, r in of_names.items() if on <= self.switched_on.keys()}
        # an effect's response may depend on a beam's parameter, too, that is not fitted
        axes = {axis.name for response in self.switched_on.values() for axis in response.axes}
        unfitted = axes - set(campaign.parameters)
        self._held = {**{n: float(campaign.values[n]) for n in unfitted}, **held(campaign)}
        beyond = "only {:g}..{:g} is simulated", "give it min and max within that range"
        self.free = free_parameters(campaign, self._simulated_ranges(), *beyond)
        #: Place of every free parameter, by its name.
        self.column = {parameter.name: i for i, parameter in enumerate(self.free)}
        self._set_rows()
        self._latest: PredictionPoint | None = None
        self._shift: Array | None = None
        if anchor is not None:
            values = {**self._held, **anchor.values}
            self._shift = anchor.log_eta - PredictionPoint(self, values, anchor.effects).log_eta

    def _simulated_ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges that were simulated, of coefficients, samples' own too, and of effects."""
        grid = self.responses.grid
        covered = {ALPHA_SCAT: grid.alpha_scat_range_per_cm, ALPHA_ABS: grid.alpha_abs_range_per_cm}
        ranges = {own: covered[name] for name in covered for own in (name, *self._named[name])}
        for axis in (axis for response in self.switched_on.values() for axis in response.axes):
            ends = [axis.nominal + value for value in axis.values if math.isfinite(value)]
            high = math.inf if any(map(math.isinf, axis.values)) else max(ends)
            ranges[axis.name] = (min(ends), high)
        return ranges

    def _set_rows(self) -> None:
        """Which readings each coefficient and scale stands for."""
        # parameters that change signals, but no eta
        self._of_signal = {SCALE, *self._named[SCALE], EFFICIENCY_FACTOR}
        #: By coefficient or scale, and by the parameter that stands for it, (readings,) its rows.
        self.rows_of = {
            name: {own: np.array(named) == own for own in dict.fromkeys(named)}
            for name, named in self._named.items()
        }
        # (readings, scales) signal of light per scale and eta; a beam's is its eta
        lit = self._measured.energy_ratio * self._of_light
        self._per_scale = np.transpose([lit * rows for rows in self.rows_of[SCALE].values()])
        # rows that have the same coefficients, whatever these are: most are of one crystal
        columns = (self._coefficients(name) for name in (ALPHA_SCAT, ALPHA_ABS))
        self._own = list(zip(*columns, strict=True))
        self._alike: dict[tuple[str | float, ...], list[int]] = {}
        for row, own in enumerate(self._own):
            self._alike.setdefault(own, []).append(row)

    def _values(self, theta: Array) -> dict[str, float]:
        """All parameters that the campaign names, free and held."""
        return {**self._held, **dict(zip(self.column, theta.tolist(), strict=True))}

    def _at(self, values: Mapping[str, float]) -> PredictionPoint:
        """What the responses say at these values; who asks next often asks for another scale."""
        values = {name: value for name, value in values.items() if name not in self._of_signal}
        latest = self._latest  # other threads may replace it meanwhile
        if latest is None or latest.values != values:
            latest = self._latest = PredictionPoint(self, values)
        return latest

    def predict(self, theta: Array, *, check: bool = False, covariance: bool = False) -> Prediction:
        values = self._values(theta)
        at = self._at(values)
        eta = np.exp(at.log_eta if self._shift is None else at.log_eta + self._shift)
        eta_slopes = eta[:, None] * at.slopes
        signal, signal_slopes, per_eta = self._read(values, *self._sent(values, eta, eta_slopes))
        eta_errors = eta_sigma = None
        if covariance or check:
            eta_errors = eta[:, None] * errors_of(at.deviations)
            eta_sigma = np.sqrt(np.square(eta_errors).sum(axis=1))
        return Prediction(
            scale=values[SCALE],
            eta=eta,
            eta_slopes=eta_slopes,
            signal=signal,
            signal_slopes=signal_slopes,
            signal_per_eta=per_eta,
            eta_sigma=eta_sigma,
            interpolation_error=at.interpolation_error() * eta if check else None,
            eta_errors=eta_errors if covariance else None,
            eta_of_tolerances=eta[:, None] * at.by_tolerances if covariance else None,
        )

    def _sent(
        self, values: Mapping[str, float], eta: Array, eta_slopes: Array
    ) -> tuple[Array, Array, Array]:
        """Signals that light sends out, their slopes, and d signal / d eta.

        Scale times efficiency factor times eta; a transmittance is the efficiency itself, and no
        photomultiplier read it.
        """
        common = values.get(EFFICIENCY_FACTOR, 1.0)
        scales = self._per_scale @ [values[name] for name in self.rows_of[SCALE]]
        per_eta = common * scales + ~self._of_light
        slopes = per_eta[:, None] * eta_slopes
        for name, per_scale in zip(self.rows_of[SCALE], self._per_scale.T, strict=True):
            if name in self.column:
                slopes[:, self.column[name]] = common * per_scale * eta
        if EFFICIENCY_FACTOR in self.column:
            slopes[:, self.column[EFFICIENCY_FACTOR]] = scales * eta
        return per_eta * eta, slopes, per_eta

    def _read(
        self, values: Mapping[str, float], signal: Array, slopes: Array, per_eta: Array
    ) -> tuple[Array, Array, Array]:
        """The same as they are read, by the effects of the readings one after the other."""
        for name, reading, rows in self._of_readings:
            read, by_signal, by_value = reading(signal, values[name], self._measured)
            signal = np.where(rows, read, signal)
            by_signal = np.where(rows, by_signal, 1.0)
            per_eta = per_eta * by_signal
            slopes = slopes * by_signal[:, None]
            if name in self.column:
                slopes[:, self.column[name]] += np.where(rows, by_value, 0.0)
        return signal, slopes, per_eta

    def predict_many(self, thetas: Array) -> Array:
        values: dict[str, Array] = {n: np.array([v]) for n, v in self._held.items()}
        values |= {p.name: thetas[:, i] for i, p in enumerate(self.free)}
        log_eta = np.empty((len(thetas), len(self.readings)))
        for named, rows in self._alike.items():
            pair = [values[n] if isinstance(n, str) else np.array([n]) for n in named]
            fine = self.responses.grid.weights_at(*pair)
            coarse = fine @ self.responses.coarser
            of_rows = fine @ self.responses.log_eta[rows].reshape(len(rows), -1).T
            for response in self.added.values():
                weights = response.weights_at([values[axis.name] for axis in response.axes])
                tables = response.log_ratio[..., rows, :, :].reshape(-1, coarse.shape[1])
                # of all nodes and readings at once: products with few columns are slow
                at_nodes = (coarse @ tables.T).reshape(len(coarse), -1, len(rows))
                of_rows = of_rows + np.einsum("pn,pnr->pr", weights, at_nodes)
            log_eta[:, rows] = of_rows
        if self._shift is not None:
            log_eta += self._shift
        scales = np.stack(np.broadcast_arrays(*(values[n] for n in self.rows_of[SCALE])), axis=-1)
        scales = scales * values.get(EFFICIENCY_FACTOR, np.ones(1))[:, None]
        signal = (scales @ self._per_scale.T + ~self._of_light) * np.exp(log_eta)
        for name, reading, reads in self._of_readings:
            # formulas of effects take numbers, and as well a column of them
            size: Any = values[name][:, None]
            signal = np.where(reads, reading(signal, size, self._measured)[0], signal)
        return signal

    def eta_batches(self, theta: Array) -> Array:
        """(batches, readings) deviations of log(eta) in the simulation's batches.

        Batches of one number belong together in all responses that were simulated with one seed.
        """
        return self._at(self._values(theta)).deviations

    def _coefficients(self, name: str) -> list[str | float]:
        """Every reading's own coefficient: its parameter, fitted or held, or a number."""
        default = self.campaign.values[name]
        known = self._held.keys() | self.column.keys()
        return [
            own if own in known else float(reading.parameters.get(name, default))
            for own, reading in zip(self._named[name], self.readings, strict=True)
        ]

    def point(self, values: Mapping[str, float]) -> Point:
        """The coefficients' place on the grid of the bench."""
        own = self._own if len(self._alike) > 1 else self._own[:1]
        pairs = [[values[n] if isinstance(n, str) else n for n in named] for named in own]
        return Point.of(self.responses.grid, *zip(*pairs, strict=True))

    @cached_property
    def of_tolerances(self) -> Array:
        """(tolerances, readings, ...) what a standard uncertainty of each adds, as of `added`."""
        by_name = self.responses.effects
        moved = [
            of.sigma * by_name[of.number.name].at_absence
            for of in self.campaign.tolerances
            if of.number.name in by_name
        ]
        return np.reshape(moved, (len(moved), len(self.readings), *self.responses.coarse.counts))


class PredictionPoint:
    """What a model's responses say where its parameters, but for the scale, have some values."""

    def __init__(
        self,
        model: ResponseModel,
        values: Mapping[str, float],
        effects: frozenset[str] | None = None,
    ) -> None:
        self.values = values
        self._model = model
        self._fine = model.point(values)
        self._coarse = self._fine.on(model.responses.coarser)
        # each with its parameters' values
        self._switched_on = {
            names: (response, [values[axis.name] for axis in response.axes])
            for names, response in model.added.items()
            if effects is None or names <= effects
        }
        # (3, readings) with slopes by alpha_scat and alpha_abs
        all_of_it = self._fine.value_and_slopes(model.responses.log_eta)
        #: (readings, free) d log_eta / d parameter; of one that changes no light they are 0.
        self.slopes = np.zeros((len(model.readings), len(model.free)))
        for response, own in self._switched_on.values():
            added = self._coarse.value_and_slopes(response.added(own))
            all_of_it = all_of_it + added[:, 0]
            for axis, slopes in zip(response.axes, added[0, 1:], strict=True):
                # a beam's parameter may be one of several effects' responses
                if axis.name in model.column:
                    self.slopes[:, model.column[axis.name]] += slopes
        #: (readings,) Without the anchor's correction.
        self.log_eta, by_scat, by_abs = all_of_it
        for name, by_coefficient in ((ALPHA_SCAT, by_scat), (ALPHA_ABS, by_abs)):
            for parameter, rows in model.rows_of[name].items():
                if parameter in model.column:
                    self.slopes[:, model.column[parameter]] = rows * by_coefficient

    @property
    def _added(self) -> dict[frozenset[str], tuple[EffectResponse, list[float]]]:
        """Responses that no joint simulation has in it."""
        joint = frozenset[str]() if self._model.anchor is None else self._model.anchor.effects
        return {names: known for names, known in self._switched_on.items() if not names <= joint}

    @cached_property
    def deviations(self) -> Array:
        """(batches, readings) deviations of log(eta)."""
        if self._model.anchor is None:
            deviations = self._fine.values(self._model.responses.deviations)
        else:
            deviations = self._model.anchor.deviations
        for response, own in self._added.values():
            deviations = deviations + response.deviations_at(self._coarse, own)
        return deviations

    @cached_property
    def by_tolerances(self) -> Array:
        """(readings, tolerances) change of log(eta) by a standard uncertainty of each number."""
        return self._coarse.value(self._model.of_tolerances).T

    def interpolation_error(self) -> Array:
        """(readings,) estimated size of the error that interpolation makes in log(eta).

        That of what pairs of effects add, which is little, is not counted.
        """
        error = np.zeros(len(self.log_eta))
        for names, (response, own) in self._added.items():
            if len(names) == 1:
                error += response.interpolation_error(self._coarse, own)
        return error
