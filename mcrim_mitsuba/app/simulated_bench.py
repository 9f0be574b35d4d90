"""The bench of the page's readings: what was simulated of it, and what its model says."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mcrim_mitsuba.app.state import (
    HELD,
    PRIOR,
    Control,
    Known,
    Settings,
    Shown,
    effect_control,
    known_of,
    parameter_control,
)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run, one_thread
from mcrim_mitsuba.efficiency.response_maker import configurations
from mcrim_mitsuba.efficiency.responses import Anchor
from mcrim_mitsuba.inference.drivers import newton
from mcrim_mitsuba.inference.estimates import fitted_rows
from mcrim_mitsuba.inference.model import UNKNOWN_SCALE, Model, ResponseModel
from mcrim_mitsuba.inference.simulations import CampaignModels, CampaignSimulations
from mcrim_mitsuba.inference.statistic import Statistic, Weights, p_value
from mcrim_mitsuba.output.sentences import parameter_words

#: Updates of the covariance while the scale is fitted.
_SCALE_STEPS = 2
#: Models that are kept ready.
_MOST_MODELS = 30


class SimulatedBench:
    """The configurations of some readings, with what was simulated of them.

    It serves every campaign whose readings have these configurations, whatever they read (`fits`).
    Only jobs simulate; what the model says is asked for from any thread.

    Parameters
    ----------
    campaign : Campaign
    run : Run
        See `inference.simulations.CampaignSimulations`.
    """

    def __init__(self, campaign: Campaign, run: Run) -> None:
        self._simulations = CampaignSimulations(campaign, run)
        self._simulated: CampaignModels | None = None
        self._shape = _shape(campaign)
        self._models: dict[Any, tuple[Campaign, ResponseModel]] = {}
        #: Effects that were simulated; None before the bench as it is was.
        self.ready: frozenset[str] | None = None
        #: Rises whenever the model says something else than before.
        self.version = 0
        # joint simulations where fits ended, by the effects switched on
        self._anchors: dict[tuple[str, ...], Anchor] = {}
        readings = campaign.measurements.readings
        largest_signal = max(abs(reading.signal) for reading in readings)
        #: Of the campaign's own parameters; the scale comes last.
        self.controls = self._own_controls(campaign, largest_signal)
        # sliders are the bench's
        pairs = zip(configurations(campaign), readings, strict=True)
        own = campaign.values  # those of a beam too
        of_bench = [own | values for values, reading in pairs if not reading.of_beam]
        known = (own, of_bench or [own], largest_signal)
        #: Effects that can be switched on, with their controls.
        self.effects = {
            name: (effect, tuple(effect_control(one, *known) for one in effect.parameters))
            for name, effect in self._simulations.possible().items()
        }
        #: Why some effects cannot be switched on.
        self.refused = tuple(dict.fromkeys(self._simulations.notes))

    def fits(self, campaign: Campaign) -> bool:
        """Whether the readings of a campaign have these configurations."""
        return _shape(campaign) == self._shape

    # ---- what can be moved -------------------------------------------------------------------

    def _own_controls(self, campaign: Campaign, largest_signal: float) -> tuple[Control, ...]:
        grid = self._simulations.grid
        covered = {
            ALPHA_SCAT: grid.alpha_scat_range_per_cm,
            ALPHA_ABS: grid.alpha_abs_range_per_cm,
        }
        own = [
            parameter_control(known, parameter_words(campaign, name)[0], covered.get(of))
            for name, known in campaign.parameters.items()
            # what else is held was not simulated; the factor of all samples is known beforehand
            if (of := campaign.stands_for(name)) in covered
            or not (known.fixed or name == EFFICIENCY_FACTOR)
        ]
        # a quarter of the light is a usual part
        usual, scale = 4.0 * largest_signal, campaign.scale or UNKNOWN_SCALE
        start = usual if math.isnan(scale.start) else scale.start
        meaning, _ = parameter_words(campaign, SCALE)
        own.append(
            Control(
                name=SCALE,
                title="scale",
                unit="signal at η = 1",
                minimum=0.0,
                maximum=3.0 * max(usual, start),
                start=start,
                meaning=meaning,
                known=known_of(campaign.scale),
            )
        )
        return tuple(own)

    @property
    def all_controls(self) -> list[Control]:
        """Those of the effects too."""
        return [*self.controls, *(c for _, own in self.effects.values() for c in own)]

    def known(self, settings: Settings) -> dict[str, Known]:
        """What is known of every parameter."""
        return {c.name: settings.known.get(c.name, c.known) for c in self.all_controls}

    def moves_as(self, other: SimulatedBench) -> bool:
        """Whether another one has the same controls."""
        return all(
            getattr(self, name) == getattr(other, name)
            for name in ("controls", "effects", "refused")
        )

    # ---- simulation --------------------------------------------------------------------------

    def simulate(self, effects: Collection[str] = ()) -> None:
        """Simulate what is not simulated yet: the bench as it is, and effects."""
        ready = self.ready
        precise = self._simulated.precise if self._simulated is not None else ()
        if ready is None or any(n not in ready or n not in precise for n in effects):
            before = ready or frozenset()
            wanted = sorted({*before, *effects})
            self._simulations.simulate(wanted, look=before - {*effects})
            self.take(self._simulations)

    def take(self, simulations: CampaignSimulations) -> None:
        """Go on with what was simulated, here or for other knowledge of the same bench."""
        self._simulations = simulations.of(self._simulations.campaign)
        self._simulated = simulations.models
        self.ready = self._simulated.simulated
        self.version += 1

    def fitted_campaign(
        self, campaign: Campaign, settings: Settings
    ) -> tuple[Campaign, tuple[str, ...]]:
        """A campaign with what is known at some settings, and the effects that it lacks still.

        It has those effects whose parameters the user knows something of.
        """
        known = self.known(settings)
        own = {
            name: [c.name for c in self.effects[name][1]]
            for name in settings.effects
            if any(known[c.name] != c.known for c in self.effects[name][1])
        }
        campaign = campaign.with_effects(tuple(own))
        names = {c.name for c in self.controls if c.name != SCALE}.union(*own.values())
        parameters = {
            name: known[name].of(parameter, settings.values[name]) if name in names else parameter
            for name, parameter in campaign.parameters.items()
        }
        scale = campaign.scale
        if scale is not None or known[SCALE] != Known():
            scale = known[SCALE].of(scale or UNKNOWN_SCALE, settings.values[SCALE])
        rest = tuple(sorted(name for name in settings.effects if name not in own))
        return replace(campaign, parameters=parameters, scale=scale), rest

    def simulations_of(self, campaign: Campaign) -> CampaignSimulations:
        """The simulations with other knowledge or readings: what there is serves them too."""
        return self._simulations.of(campaign)

    def keep_anchor(self, effects: tuple[str, ...], model: Model) -> None:
        """Models with these effects are corrected as this one from now on."""
        if isinstance(model, ResponseModel) and model.anchor is not None:
            self._anchors[tuple(sorted(effects))] = model.anchor
            self.version += 1

    def settle_at(self, campaign: Campaign, settings: Settings) -> dict[str, float]:
        """Simulate all that is switched on together, where the controls are.

        So that the page shows what a simulation of the downloaded scene gives. Returns the values.
        """
        names = tuple(sorted(settings.effects))
        switched_on = [campaign.catalogue[n] for n in (*campaign.effects, *names)]
        # sizes of other effects may be the scene's own parameters: those stay as they are
        used = {*campaign.parameters, *(p.name for e in switched_on for p in e.parameters)}
        values = {name: value for name, value in settings.values.items() if name in used}
        if not self._simulations.is_exact(switched_on):
            free = self._model(campaign, names, self.known(settings)).free
            here = {p.name: values.get(p.name, p.start) for p in free if p.name != SCALE}
            with_effects = campaign.with_effects(names)
            self.keep_anchor(names, self._simulations.anchored_model(with_effects, here))
        return values

    # ---- what the model says -----------------------------------------------------------------

    @one_thread()
    def show(self, campaign: Campaign, settings: Settings) -> Shown | None:
        """Predictions at some settings; None before the campaign's readings were simulated.

        Takes about a millisecond.
        """
        if self.ready is None or not self.fits(campaign):
            return None
        effects = tuple(name for name in settings.effects if name in self.ready)
        known = self.known(settings)
        model = self._model(campaign, effects, known)
        statistic = Statistic(model)
        theta = np.array(
            [
                min(max(settings.values.get(p.name, p.start), p.minimum), p.maximum)
                if p.name != SCALE
                else settings.values[SCALE]
                for p in model.free
            ]
        )
        names, sigma = [parameter.name for parameter in model.free], 0.0
        if settings.fit_scale:
            theta, sigma = _fit_scale(statistic, theta)
        weights = Weights(statistic.errors_at(theta))
        prediction = model.predict(theta, check=True)
        assert prediction.eta_sigma is not None  # checked
        assert prediction.interpolation_error is not None
        errors = list(map(math.hypot, prediction.eta_sigma, prediction.interpolation_error))
        held = sum(known[name].how == HELD for name in names if name in known)
        chi2, ndf = statistic.chi2(theta, weights), statistic.ndf + held
        return Shown(
            rows=fitted_rows(model.readings, prediction, errors),
            chi2=chi2,
            ndf=ndf,
            p_value=p_value(chi2, ndf),
            scale=prediction.scale,
            light_yield=_light_yield(campaign, prediction.scale, sigma),
            pending=tuple(name for name in settings.effects if name not in effects),
        )

    def _model(
        self, campaign: Campaign, effects: tuple[str, ...], known: Mapping[str, Known]
    ) -> ResponseModel:
        """What is held is free in it: it stands at its value, and moves when that is moved."""
        names = tuple(sorted(effects))
        priors = {n: k.gaussian for n, k in known.items() if k.gaussian is not None}
        anchor = self._anchors.get(names)
        # while nothing new was simulated a model stays what it is
        key = (names, tuple(priors.items()), id(campaign), self.version)
        if key not in self._models:
            own = campaign.with_effects(names)

            def movable(name: str, parameter: CampaignParameter) -> CampaignParameter:
                return Known(PRIOR, *priors.get(name, (None, None))).of(parameter, math.nan)

            parameters = {
                name: movable(name, parameter) if name in known else parameter
                for name, parameter in own.parameters.items()
            }
            scale = movable(SCALE, own.scale or UNKNOWN_SCALE)
            own = replace(own, parameters=parameters, scale=scale)
            if len(self._models) >= _MOST_MODELS:
                self._models = {}
            assert self._simulated is not None  # only then is anything shown
            model = self._simulated.model_of(own, anchor)
            # with what its key is the identity of
            self._models[key] = (campaign, model)
        return self._models[key][1]


def _shape(campaign: Campaign) -> list[tuple[str, dict[str, Value]]]:
    """What tells benches apart."""
    return [(r.kind, r.parameters) for r in campaign.measurements.readings]


def _light_yield(
    campaign: Campaign, scale: float, sigma: float
) -> tuple[float, float, float] | None:
    """See `Shown.light_yield`; `sigma` is the scale's."""
    known = campaign.light_yield
    if known is None or SCALE not in campaign.free:
        return None
    relative = known.detector_efficiency_sigma / known.detector_efficiency
    if (shared := campaign.parameters.get(EFFICIENCY_FACTOR)) is not None:
        relative = math.hypot(relative, shared.prior_sigma or 0.0)
    return scale * known.per_scale, sigma * known.per_scale, scale * known.per_scale * relative


def _fit_scale(statistic: Statistic, theta: Array) -> tuple[Array, float]:
    """Parameters with the scale that follows the readings, and its error; all else is held."""
    place = statistic.index(SCALE)
    held = [i for i in range(len(theta)) if i != place]
    for _ in range(_SCALE_STEPS):
        weights = Weights(statistic.errors_at(theta))
        theta, _, _ = newton(statistic, theta, weights, held=held)
    slopes = statistic.evaluate(theta, weights)[1][:, place]
    return theta, float(slopes @ slopes) ** -0.5
