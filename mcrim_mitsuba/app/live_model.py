"""The model of some readings on the page: what was simulated of it, and what it says."""

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
    Controls,
    Known,
    Settings,
    Shown,
    effect_control,
    known_of,
    parameter_control,
)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run, one_thread
from mcrim_mitsuba.efficiency.response_maker import configurations
from mcrim_mitsuba.efficiency.responses import Anchor
from mcrim_mitsuba.inference.drivers import newton
from mcrim_mitsuba.inference.estimates import fitted_rows
from mcrim_mitsuba.inference.model import UNKNOWN_SCALE, ResponseModel
from mcrim_mitsuba.inference.simulations import CampaignModels, CampaignSimulations
from mcrim_mitsuba.inference.statistic import Statistic, Weights, p_value
from mcrim_mitsuba.output.sentences import parameter_words

#: Updates of the covariance while the scale is fitted.
_SCALE_STEPS = 2
#: Models that are kept ready.
_MOST_MODELS = 30


class LiveModel:
    """The model of the configurations of some readings, with what was simulated of them.

    It serves every campaign whose readings have these configurations, whatever they read (`fits`).
    Only jobs simulate, as `inference.simulations.CampaignSimulations` says of a run; what the model
    says is asked for from any thread.
    """

    def __init__(self, campaign: Campaign, run: Run) -> None:
        #: What there is of them serves those ``of`` other knowledge or readings too.
        self.simulations = CampaignSimulations(campaign, run)
        self._simulated: CampaignModels | None = None
        self._shape = _shape(campaign)
        #: What can be moved.
        self.controls = _controls(campaign, self.simulations)
        #: Rises whenever the model says something else than before.
        self.version = 0
        #: What tells its anchors from those of other readings.
        self.mark = object()
        self._models: dict[Any, tuple[Campaign, ResponseModel]] = {}

    def fits(self, campaign: Campaign) -> bool:
        """Whether the readings of a campaign have these configurations."""
        return _shape(campaign) == self._shape

    # ---- simulation --------------------------------------------------------------------------

    @property
    def ready(self) -> frozenset[str] | None:
        """Effects that were simulated; None before the bench as it is was."""
        return None if self._simulated is None else self._simulated.simulated

    def simulate(self, effects: Collection[str] = ()) -> None:
        """Simulate what is not simulated yet: the bench as it is, and effects."""
        before, precise = frozenset[str](), frozenset[str]()
        if self._simulated is not None:
            before, precise = self._simulated.simulated, self._simulated.precise
            if before & precise >= set(effects):
                return
        self.simulations.simulate(sorted({*before, *effects}), look=before - {*effects})
        self.take(self.simulations)

    def take(self, simulations: CampaignSimulations) -> None:
        """Go on with what was simulated, here or for other knowledge of the same bench."""
        self.simulations = simulations.of(self.simulations.campaign)
        self._simulated = simulations.models
        self.version += 1

    def settle_at(self, campaign: Campaign, settings: Settings) -> tuple[dict[str, float], Any]:
        """Simulate all that is switched on together, where the controls are.

        So that the page can show what a simulation of the downloaded scene gives. Returns the
        values, and the model that is corrected so, where that makes a difference.
        """
        names = tuple(sorted(settings.effects))
        switched_on = [campaign.catalogue[n] for n in (*campaign.effects, *names)]
        # sizes of other effects may be the scene's own parameters: those stay as they are
        used = {*campaign.parameters, *(p.name for e in switched_on for p in e.parameters)}
        values = {name: value for name, value in settings.values.items() if name in used}
        if not self.simulations.maker.is_exact(switched_on):
            free = self._model(campaign, names, self.controls.known(settings)).free
            here = {p.name: values.get(p.name, p.start) for p in free if p.name != SCALE}
            return values, self.simulations.anchored_model(campaign.with_effects(names), here)
        return values, None

    # ---- what the model says -----------------------------------------------------------------

    @one_thread()
    def show(
        self, campaign: Campaign, settings: Settings, anchor: Anchor | None = None
    ) -> Shown | None:
        """Predictions at some settings; None before the campaign's readings were simulated.

        Takes about a millisecond. The `anchor` corrects for effects that act together.
        """
        ready = self.ready
        if ready is None or not self.fits(campaign):
            return None
        effects = tuple(name for name in settings.effects if name in ready)
        knowledge = self.controls.known(settings)
        statistic = Statistic(self._model(campaign, effects, knowledge, anchor))
        # where the controls are, within their ranges but for the scale
        theta = np.empty(len(statistic.free))
        for place, p in enumerate(statistic.free):
            value = settings.values.get(p.name, p.start)
            theta[place] = value if p.name == SCALE else min(max(value, p.minimum), p.maximum)
        # the scale follows the readings, all else is held
        held = [i for i in range(len(theta)) if i != statistic.index(SCALE)]
        for _ in range(_SCALE_STEPS * settings.fit_scale):
            theta = newton(statistic, theta, Weights(statistic.errors_at(theta)), held=held).point
        prediction = statistic.model.predict(theta, check=True, covariance=True)
        assert prediction.eta_sigma is not None  # checked
        assert prediction.interpolation_error is not None
        errors = list(map(math.hypot, prediction.eta_sigma, prediction.interpolation_error))
        weights = Weights(statistic.errors_at(theta))
        chi2 = statistic.chi2(theta, weights)
        pulled = weights.weigh(statistic.residuals(prediction))
        prediction = prediction.where_off(weights.errors.tolerances, pulled)
        entry = campaign.light_yield if SCALE in campaign.free else None
        by_hand = sum(n in knowledge and knowledge[n].how == HELD for n in statistic.names)
        ndf = statistic.ndf + by_hand
        return Shown(
            rows=fitted_rows(statistic.model, prediction, errors),
            chi2=chi2,
            ndf=ndf,
            p_value=p_value(chi2, ndf),
            scale=prediction.scale,
            light_yield=prediction.scale * entry.per_scale if entry else None,
            pending=tuple(name for name in settings.effects if name not in effects),
        )

    def _model(
        self,
        campaign: Campaign,
        effects: tuple[str, ...],
        knowledge: Mapping[str, Known],
        anchor: Anchor | None = None,
    ) -> ResponseModel:
        """What is held is free in it: it stands at its value, and moves when that is moved."""
        names = tuple(sorted(effects))
        priors = {n: k.gaussian for n, k in knowledge.items() if k.gaussian is not None}
        # while nothing new was simulated a model stays what it is
        key = (names, tuple(priors.items()), id(campaign), id(anchor), self.version)
        if key not in self._models:
            assert self._simulated is not None  # only then is anything shown
            if len(self._models) >= _MOST_MODELS:
                self._models = {}
            movable = campaign.with_effects(names)
            parameters = {**movable.parameters, SCALE: movable.scale or UNKNOWN_SCALE}
            # with priors where they are known, and nothing held
            for name in parameters.keys() & knowledge.keys():
                prior = Known(PRIOR, *(knowledge[name].gaussian or (None, None)))
                parameters[name] = prior.of(parameters[name], math.nan)
            movable = replace(movable, scale=parameters.pop(SCALE), parameters=parameters)
            model = self._simulated.model_of(movable, anchor)
            # with what its key is the identity of; the model has its anchor
            self._models[key] = (campaign, model)
        return self._models[key][1]


def _controls(campaign: Campaign, simulations: CampaignSimulations) -> Controls:
    """What can be moved of a campaign's model."""
    readings = campaign.measurements.readings
    largest_signal = max(abs(reading.signal) for reading in readings)
    # sliders are the bench's, not those of a beam
    pairs = zip(configurations(campaign), readings, strict=True)
    benches = [campaign.values | values for values, reading in pairs if not reading.of_beam]
    scope = (campaign.values, benches or [campaign.values], largest_signal)
    effects = {
        name: (effect, tuple(effect_control(parameter, *scope) for parameter in effect.parameters))
        for name, effect in simulations.possible().items()
    }
    covered = {
        ALPHA_SCAT: simulations.maker.grid.alpha_scat_range_per_cm,
        ALPHA_ABS: simulations.maker.grid.alpha_abs_range_per_cm,
    }
    parameters = [
        parameter_control(parameter, parameter_words(campaign, name)[0], covered.get(of))
        for name, parameter in campaign.parameters.items()
        # what else is held was not simulated; the factor of all samples is known beforehand
        if (of := campaign.stands_for(name)) in covered
        or not (parameter.fixed or name == EFFICIENCY_FACTOR)
    ]
    # a quarter of the light is a usual part
    usual, start = 4.0 * largest_signal, (campaign.scale or UNKNOWN_SCALE).start
    start = usual if math.isnan(start) else start
    scale = Control(
        name=SCALE,
        title="scale",
        unit="signal at η = 1",
        minimum=0.0,
        maximum=3.0 * max(usual, start),
        start=start,
        meaning=parameter_words(campaign, SCALE)[0],
        known=known_of(campaign.scale),
    )
    refused = tuple(dict.fromkeys((*simulations.refusals, *simulations.notes)))
    return Controls(parameters=(*parameters, scale), effects=effects, refused=refused)


def _shape(campaign: Campaign) -> list[tuple[str, dict[str, Value]]]:
    """What tells benches apart."""
    return [(r.kind, r.parameters) for r in campaign.measurements.readings]
