"""A campaign with the responses of its readings, from which models are made."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import product

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.entries import NEXT_MINUTES, NEXT_SIGMA
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, TRANSMITTANCE, Reading
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.rounding import number
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.catalogue import BrokenEffectError, add
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.response_maker import EFFECT_PHOTONS, ResponseMaker
from mcrim_mitsuba.efficiency.responses import Responses
from mcrim_mitsuba.inference.explanations import plausible_priors
from mcrim_mitsuba.inference.fit import Calibration, UndeterminedError, fit_model
from mcrim_mitsuba.inference.model import ResponseModel, acts_on, held
from mcrim_mitsuba.scene.spectrophotometer import (
    ACCEPTANCE,
    BEAM_AXIS,
    BEAM_PARAMETERS,
    spectrophotometer_of,
    too_wide,
)

#: What may be proposed where a campaign does not say: liquids and apertures with each other, and
#: other gaps and crystals with each of two liquids.
USUAL_LIQUIDS, USUAL_APERTURES_MM = (1.0, 1.333, 1.46, 1.515, 1.74), (14.0, 7.0, 4.0)
USUAL_FURTHER = {"gap_mm": (0.5,), "crystal_height_mm": (20.0, 2.0)}

#: Transmittances, where there is one already: within other angles, and through a long crystal.
USUAL_ACCEPTANCES_DEG, _LONG = (1.0, 30.0), ("crystal_height_mm", 20.0)
#: Part of the photons that simulations of proposed measurements get: they decide nothing.
PROPOSED_PART = 0.25
#: How far, in its standard errors, a parameter may move when the effects are simulated together
#: before they are simulated once more where it went; and how often.
SETTLED, MOST_ANCHORS = 0.5, 2
#: Standard errors of what is plausible from which the readings leave a size open.
OPEN = 2.0
#: Most configurations that are simulated to see what they would tell.
MOST_PROPOSALS = 40
#: How much worse than by responses chi2 may be where effects are simulated together before a note
#: tells: by this factor and by this much.
NOT_ADDING_UP, _WORSE = 2.0, 10.0
#: Time that a mounting takes.
MINUTES_PER_MOUNTING = 30.0
#: Relative error of a proposed reading, where the campaign's readings do not say.
_USUAL_SIGMA = 0.01


@dataclass(frozen=True)
class MeasurementProposals:
    """Configurations that the laboratory can build."""

    #: Scene parameters of each, by name.
    configurations: Sequence[dict[str, Value]]
    #: ``predict(effects, thetas)`` gives their (points, m) signals, of the model with these effects
    #: at (points, free) values of its free parameters.
    predict: Callable[[tuple[str, ...], Array], Array]
    #: Of a new reading; one, or (m,).
    relative_sigma: float | Array
    #: What a parameter's change from the scene's value takes besides a mounting.
    minutes: Mapping[str, float] = field(default_factory=dict)
    #: What the scene says of its parameters, by name.
    comments: Mapping[str, str] = field(default_factory=dict)
    #: The scene's own values, from which nothing is changed.
    own: Mapping[str, Value] = field(default_factory=dict)
    #: ``noise(effects, theta)`` gives the simulation's (m,) relative errors of what is predicted;
    #: None where there is none.
    noise: Callable[[tuple[str, ...], Array], Array] | None = None

    def hours(self, *places: int) -> float:
        """To mount some of the configurations; what two have in common is changed once."""
        changes = {item for i in places for item in self.configurations[i].items()}
        further = sum(
            self.minutes.get(name, 0.0) for name, value in changes if self.own.get(name) != value
        )
        return (MINUTES_PER_MOUNTING * len(places) + further) / 60.0


class Workbench:
    """A campaign with the responses of its readings, from which models are made.

    The photons of `run` are those of every simulation with an effect; configurations as they are
    get several times as many. Its precision does not matter.
    """

    def __init__(self, campaign: Campaign, run: Run) -> None:
        self.campaign = campaign
        self.run = run
        self._start = time.perf_counter()
        self._makers: list[ResponseMaker] = []
        self.notes: list[str] = []
        #: Effects that could be missing; those that a diagnosis tries.
        self.candidates: dict[str, Effect] = {}
        #: What was simulated; `simulate` comes first.
        self.responses: Responses
        #: Effects whose simulations had all photons.
        self.precise: set[str] = set()

    def simulate(self, effects: Sequence[str] = (), look: Collection[str] = ()) -> None:
        """Make the responses, with those of some effects besides the campaign's own.

        What was simulated before is not simulated again. Effects named by `look` get a first look
        with a part of the photons, if they had no more before.
        """
        catalogue = self.campaign.catalogue
        made = [catalogue[name] for name in (*self.campaign.effects, *effects)]
        self.precise |= {
            each.name for each in made if each.name not in look or each.reading is not None
        }
        self.responses = self.own_maker.make(made, set(look) - self.precise)

    @property
    def simulated(self) -> frozenset[str]:
        """Effects that models can have, besides the campaign's own: those of the readings too."""
        known, catalogue = self.responses.effects, self.campaign.catalogue
        return frozenset(n for n, e in catalogue.items() if n in known or e.reading is not None)

    @cached_property
    def own_maker(self) -> ResponseMaker:
        """What makes the responses of the campaign's own readings."""
        return self.maker(self.campaign, "simulation")

    def model(
        self, effects: Sequence[str] = (), starts: Mapping[str, float] | None = None
    ) -> ResponseModel:
        """The campaign's model with more effects than its own switched on."""
        return self._model(self.campaign.with_effects(effects).with_starts(starts or {}))

    def reduced_model(self, effects: Sequence[str]) -> ResponseModel:
        """The campaign's model with these of its own effects alone."""
        return self._model(self.campaign.with_only(effects))

    def _model(self, campaign: Campaign) -> ResponseModel:
        return ResponseModel(campaign, self.responses, campaign.switched_on)

    def anchored_model(self, effects: Sequence[str], values: Mapping[str, float]) -> ResponseModel:
        """The same, corrected by a simulation of all effects at once at some values.

        Fits begin there.
        """
        return self._anchored(self.campaign.with_effects(effects), values)

    def _anchored(self, campaign: Campaign, values: Mapping[str, float]) -> ResponseModel:
        campaign = campaign.with_starts(values)
        maker = self.maker(campaign, f"simulation with {' and '.join(campaign.effects)}")
        # sizes of effects that are held are in the scene, too
        anchor = maker.anchor(campaign.switched_on, {**held(campaign), **values})
        return ResponseModel(campaign, self.responses, campaign.switched_on, anchor)

    def settled_model(
        self, effects: Sequence[str] = (), starts: Mapping[str, float] | None = None
    ) -> tuple[ResponseModel, Calibration]:
        """The model that was simulated where its own fit ends, and that fit.

        Responses add up what effects do one by one, between nodes; where that is not exact, all
        effects are simulated together where the fit ended, and it is repeated from there.

        Where the readings leave the sizes of the added effects open, what is plausible becomes
        their prior: the model's campaign has it, and a note of the fit tells.

        It begins at `starts`: an effect's responses may have several minima. Errors as `fit_model`.
        """
        campaign = self.campaign.with_effects(effects).with_starts(starts or {})
        added = [self.campaign.catalogue[name] for name in effects]
        known = plausible_priors(added, self.model())
        try:
            model, found = self._settled(campaign)
            open_sizes = [n for n, (_, s) in known.items() if found.parameters[n].sigma > OPEN * s]
        except UndeterminedError:
            if not known:
                raise
            open_sizes = list(known)
        if not open_sizes:
            return model, found
        priors = {name: known[name] for name in open_sizes}
        model, found = self._settled(campaign.with_priors(priors))
        said = "; ".join(f"{name} {number(at)} ± {number(s)}" for name, (at, s) in priors.items())
        note = f"the readings leave sizes open, and what is plausible is their prior: {said}"
        return model, replace(found, notes=(*found.notes, note))

    def _settled(self, campaign: Campaign) -> tuple[ResponseModel, Calibration]:
        """A campaign's model, simulated where its fit ends, and that fit."""
        model = self._model(campaign)
        if self.own_maker.is_exact(campaign.switched_on):
            return model, fit_model(model)
        found = fit_model(model, profile=False)
        by_responses = found.chi2
        for _ in range(MOST_ANCHORS):
            model = self._anchored(campaign, found.values)
            before, found = found, fit_model(model, profile=False)
            sigmas = np.array([found.parameters[name].sigma for name in found.names])
            if np.all(np.abs(found.theta - before.theta) / np.maximum(sigmas, 1e-300) < SETTLED):
                break
        found = fit_model(model)
        if found.chi2 < max(NOT_ADDING_UP * by_responses, by_responses + _WORSE):
            return model, found
        names = " and ".join(campaign.effects)
        note = (
            f"with {names} simulated together chi2 is {number(found.chi2)}, not "
            f"{number(by_responses)} as their responses, simulated one by one, had it: the effects "
            "do not add up, or an effect's file acts otherwise alone than beside others"
        )
        return model, replace(found, notes=(*found.notes, note))

    def proposals(self) -> MeasurementProposals:
        """What could be measured next; it is simulated when it is asked for."""
        light, beams = self._not_measured()
        asked = [self._proposed(each) for each in (light, beams) if each]

        def predict(effects: tuple[str, ...], thetas: Array) -> Array:
            return np.hstack([model(effects).predict_many(thetas) for model in asked])

        def noise(effects: tuple[str, ...], theta: Array) -> Array:
            found = [model(effects).predict(theta, check=True) for model in asked]
            return np.concatenate([np.asarray(each.eta_sigma) / each.eta for each in found])

        sigmas = [self._usual_sigma(of_beam=False)] * len(light)
        sigmas += [self._usual_sigma(of_beam=True)] * len(beams)
        minutes = self.campaign.next_measurements.get(NEXT_MINUTES, {})
        comments = {n: known.comment for n, known in self.campaign.scene.defaults.items()}
        return MeasurementProposals(
            [*light, *beams],
            predict,
            np.array(sigmas),
            minutes,
            comments,
            {**BEAM_PARAMETERS, **self.campaign.values},
            noise,
        )

    def _usual_sigma(self, *, of_beam: bool) -> float:
        """Relative error of a proposed reading of a kind."""
        given = self.campaign.next_measurements.get(NEXT_SIGMA)
        if given is not None and not of_beam:
            return float(given)
        rows = self.campaign.measurements.in_use
        used = [r.sigma / r.signal for r in rows if r.of_beam == of_beam]
        return float(np.median(used)) if used else _USUAL_SIGMA

    def _proposed(
        self, configurations: Sequence[Mapping[str, Value]]
    ) -> Callable[[tuple[str, ...]], ResponseModel]:
        """The model with some effects of configurations of one kind, taken for readings."""
        readings = tuple(
            Reading(
                label=", ".join(f"{n} = {v}" for n, v in each.items()),
                signal=1.0,
                sigma=1.0,
                parameters={n: v for n, v in each.items() if n != KIND},
                kind=str(each.get(KIND, LIGHT)),
            )
            for each in configurations
        )
        # no columns: what one proposal changes may be fitted to the others
        measured = replace(self.campaign.measurements, columns=(), readings=readings)
        proposed = replace(self.campaign, measurements=measured)
        if readings[0].of_beam:
            proposed = replace(proposed, beam={**BEAM_PARAMETERS, **self.campaign.beam})

        @cache
        def maker() -> ResponseMaker:
            return self.maker(proposed, "proposed measurements", PROPOSED_PART)

        @cache  # what is predicted with some effects has its noise asked for next
        def model(effects: tuple[str, ...]) -> ResponseModel:
            campaign = proposed.with_effects(effects)
            responses = maker().make(campaign.switched_on)
            return ResponseModel(campaign, responses, campaign.switched_on)

        return model

    def _not_measured(self) -> tuple[list[dict[str, Value]], list[dict[str, Value]]]:
        """What the laboratory can build and did not measure: of light, and transmittances."""
        campaign = self.campaign
        scene: dict[str, Value] = {**BEAM_PARAMETERS, **campaign.values}

        def new(proposal: Mapping[str, Value]) -> bool:
            measured = (
                {KIND: reading.kind, **reading.parameters}
                for reading in campaign.measurements.readings
                if reading.sample not in campaign.samples
                or not campaign.samples[reading.sample].own
            )
            own = {KIND: LIGHT, **proposal}
            return not any(
                all(own.get(n, scene.get(n)) == row.get(n, scene.get(n)) for n in {*own, *row})
                for row in measured
            )

        found = [p for p in _buildable(campaign) if new(p)]
        if len(found) > MOST_PROPOSALS:
            self.notes.append(
                f"of {len(found)} configurations that could be measured next, {MOST_PROPOSALS} "
                "were looked at: restrict [next_measurements]"
            )
        return found[:MOST_PROPOSALS], [p for p in _beams(campaign) if new(p)][:MOST_PROPOSALS]

    def provenance(self) -> Provenance:
        """What was spent so far."""
        from mcrim_mitsuba.transport.variants import versions

        of_caches = [note for maker in self._makers for note in maker.notes]
        of_caches += self.own_maker.said
        return Provenance(
            seed=self.run.seed,
            photons=sum(maker.photons for maker in self._makers),
            cached_photons=sum(maker.cached_photons for maker in self._makers),
            scene_hash=self.campaign.scene.content_hash,
            versions=versions(self.run.variant, self.run.threads),
            seconds=time.perf_counter() - self._start,
            notes=tuple(dict.fromkeys((*self.notes, *of_caches))),
        )

    def maker(self, campaign: Campaign, what: str, part: float = 1.0) -> ResponseMaker:
        """What makes responses of a campaign, its progress shown under a name."""
        photons = max(round(part * self.run.photons_or(EFFECT_PHOTONS)), 1)
        maker = ResponseMaker(campaign, replace(self.run, photons=photons), what)
        self._makers.append(maker)
        return maker

    def possible(self) -> dict[str, Effect]:
        """Effects of the catalogue that the scene can take and does not have."""
        found = {}
        campaign = self.campaign
        for name, effect in campaign.catalogue.items():
            there = (*campaign.effects, *campaign.known_physics)
            if name in there or effect.is_in(campaign.scene):
                continue
            if effect.of_beam and not campaign.beam:
                continue
            if effect.reading is not None and not acts_on(effect, campaign):
                continue
            if any(name in campaign.catalogue[other].excludes for other in there):
                continue
            try:
                campaign.with_effects([name])
                if effect.edit is not None:
                    add(effect, campaign.scene)
            except BrokenEffectError:
                raise
            except InputError as error:
                self.notes.append(f"{name} was not tried: {error.problem}")
                continue
            found[name] = effect
        return found


def spent_together(spent: Sequence[Provenance], notes: Iterable[str] = ()) -> Provenance:
    """What benches spent of one run, the first begun first; `notes` precede theirs."""
    return replace(
        spent[0],
        photons=sum(each.photons for each in spent),
        cached_photons=sum(each.cached_photons for each in spent),
        notes=tuple(dict.fromkeys([*notes, *(note for each in spent for note in each.notes)])),
    )


def _buildable(campaign: Campaign) -> list[dict[str, Value]]:
    """Configurations that may be proposed, each as what differs from the scene."""
    scene = campaign.scene.parameters
    given = {name: v for name, v in campaign.next_measurements.items() if name in scene}
    if given or BEAM_PARAMETERS.keys() & campaign.next_measurements.keys():
        if not given:
            return []
        return [dict(zip(given, values, strict=True)) for values in product(*given.values())]
    found: list[dict[str, Value]] = []
    if "n_gap" in scene and "aperture_radius_mm" in scene:
        each = product(USUAL_LIQUIDS, USUAL_APERTURES_MM)
        found = [{"n_gap": n, "aperture_radius_mm": radius} for n, radius in each]
    for name, values in USUAL_FURTHER.items():
        if name in scene and "n_gap" in scene:
            found += [{"n_gap": n, name: v} for n in (1.0, 1.46) for v in values]
    return found


def _beams(campaign: Campaign) -> list[dict[str, Value]]:
    """Transmittances that may be proposed, each as what tells it from the campaign's own."""
    allowed = campaign.next_measurements
    given = {name: values for name, values in allowed.items() if name in BEAM_PARAMETERS}
    if not given and any(name in campaign.scene.parameters for name in allowed):
        return []
    try:
        spectrophotometer_of(campaign.scene)
    except InputError:
        return []  # the scene does not say enough of its crystal
    own = {**BEAM_PARAMETERS, **campaign.beam}
    found: list[dict[str, Value]] = []
    if given:
        found = [dict(zip(given, values, strict=True)) for values in product(*given.values())]
    elif not campaign.beam:
        found = [{ACCEPTANCE: own[ACCEPTANCE]}]
    else:
        found = [{ACCEPTANCE: angle} for angle in USUAL_ACCEPTANCES_DEG]
        other = "x" if own[BEAM_AXIS] == "z" else "z"
        same = {ACCEPTANCE: own[ACCEPTANCE]}
        found += [{**same, BEAM_AXIS: other}, {**same, BEAM_AXIS: "z", _LONG[0]: _LONG[1]}]
    return [
        {KIND: TRANSMITTANCE, **each}
        for each in found
        if too_wide({**campaign.scene.parameters, **own, **each}) is None
    ]
