"""What is simulated of a campaign, and the models that are made of it."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import product

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.entries import NEXT_MINUTES, NEXT_SIGMA
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, TRANSMITTANCE, Reading
from mcrim_mitsuba.campaign.treatments import as_in_scene, states, taken_off
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, SOURCE_Z, Value
from mcrim_mitsuba.core.rounding import number
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.catalogue import refusal_of
from mcrim_mitsuba.effects.effect import WRONG, Effect
from mcrim_mitsuba.effects.scene_edits import GAP, HEIGHT, WIDTH
from mcrim_mitsuba.efficiency.attenuation import SOURCE_WIDTH
from mcrim_mitsuba.efficiency.eta_grid import APERTURE, WINDOW
from mcrim_mitsuba.efficiency.proposals import LEAST_ABSORPTION_PER_CM, Beyond
from mcrim_mitsuba.efficiency.response_maker import PLAIN_FACTOR, ResponseMaker
from mcrim_mitsuba.efficiency.responses import Anchor, Responses, Sizes
from mcrim_mitsuba.efficiency.schedule import Schedule
from mcrim_mitsuba.inference.drivers import Minimum, find_minima, newton
from mcrim_mitsuba.inference.explanations import Models, plausible_priors
from mcrim_mitsuba.inference.fit import Calibration, UndeterminedError, fit_model, result_of
from mcrim_mitsuba.inference.model import ResponseModel, acts_on, held, refuse_unnamed_coefficients
from mcrim_mitsuba.inference.settings import EXTENT, ONE_SIGMA, SCREENING, USUAL
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.scene.spectrophotometer import (
    ACCEPTANCE,
    BEAM_AXIS,
    BEAM_PARAMETERS,
    GAP_INDEX,
    spectrophotometer_of,
    too_wide,
)
from mcrim_mitsuba.transport.variants import versions

#: What scenes call a crystal's length, and its width.
CRYSTAL_LENGTHS = (HEIGHT, "crystal_length_mm")
CRYSTAL_WIDTHS = (WIDTH, "crystal_diameter_mm")
#: Effects of the catalogue that a number of the bench is another one, and the number: names, in a
#: campaign in which that has a tolerance, of the effects that it is wrong.
NUMBERS_OF = {"crystal_index": "n_crystal", "gap_index": "n_gap", "gap_thickness": "gap_mm"}


@dataclass(frozen=True)
class MeasurementProposals:
    """Configurations that the laboratory can build."""

    #: Scene parameters of each, by name.
    configurations: Sequence[dict[str, Value]]
    #: Of these configurations one after the other, taken for readings: of light, of beams.
    models: Sequence[Models]
    #: Of the campaign's readings, made once more.
    repeated: Models
    #: Of a new reading; one, or (m,).
    relative_sigma: float | Array
    #: What a parameter's change from the scene's value takes besides a mounting.
    minutes: Mapping[str, float] = field(default_factory=dict)
    #: What the scene says of its parameters, by name.
    comments: Mapping[str, str] = field(default_factory=dict)
    #: The scene's own values, from which nothing is changed.
    own: Mapping[str, Value] = field(default_factory=dict)
    #: What rows switch, as each of these has it, in words; and the parameters that do it.
    switched: Sequence[Sequence[str]] = ()
    switched_by: Collection[str] = ()

    def predict(self, effects: tuple[str, ...], thetas: Array, rows: Sequence[int]) -> Array:
        """(points, m + rows) signals of the model with these effects at (points, free) parameters.

        Behind those of the configurations stand those of the campaign's `rows`, made once more.
        """
        new = [models(effects).predict_many(thetas) for models in self.models]
        return np.hstack([*new, self.repeated(effects).predict_many(thetas)[:, rows]])

    def noise(self, effects: tuple[str, ...], theta: Array, rows: Sequence[int]) -> Array:
        """(m + rows,) relative errors of what is predicted, by the simulation."""
        *new, again = (
            np.asarray(prediction.eta_sigma) / prediction.eta
            for models in (*self.models, self.repeated)
            for prediction in [models(effects).predict(theta, check=True)]
        )
        return np.concatenate([*new, again[rows]])

    def hours(self, *configurations: Mapping[str, Value]) -> float:
        """To mount some configurations; what two have in common is changed once."""
        changes = {item for configuration in configurations for item in configuration.items()}
        further = sum(
            self.minutes.get(name, 0.0) for name, value in changes if self.own.get(name) != value
        )
        return (EXTENT.minutes_per_mounting * len(configurations) + further) / 60.0


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignModels:
    """What was simulated of a campaign, and the models that it makes; values that never change."""

    campaign: Campaign
    responses: Responses
    #: All of the campaign's own effects at once, where its own fit ends; None where their responses
    #: add up exactly.
    anchor: Anchor | None
    #: Effects, and pairs of them, whose simulations had all photons at all sizes.
    precise: frozenset[str]
    #: Effects of which only those between some sizes had.
    near: Mapping[str, Sizes] = field(default_factory=dict)

    @property
    def simulated(self) -> frozenset[str]:
        """Effects that models can have, besides the campaign's own: those of the readings too."""
        responses, catalogue = self.responses.effects, self.campaign.catalogue
        return frozenset(n for n, e in catalogue.items() if n in responses or e.reading is not None)

    def acts(self, effect: str) -> bool:
        """Whether a simulated effect changes what any reading in use is made of."""
        if (response := self.responses.effects.get(effect)) is None:
            return True
        used = [reading.use for reading in self.campaign.measurements.readings]
        moved = response.log_ratio.swapaxes(0, -3)[used]
        return bool(np.abs(moved).max(initial=0.0) >= SCREENING.acts)

    def are_precise(self, wanted: Mapping[str, Sizes | None]) -> bool:
        """Whether all photons tell of effects, and pairs of them, at some sizes; None: at all."""
        return all(
            name in self.precise or (sizes is not None and self.near.get(name) == sizes)
            for name, sizes in wanted.items()
        )

    def is_precise(self, effect: str, values: Mapping[str, float]) -> bool:
        """Whether all photons tell of an effect, at the value of its parameter among these."""
        if (sizes := self.near.get(effect)) is None:
            return effect in self.precise
        (axis, *_) = self.responses.effects[effect].axes
        return sizes[0] <= values[axis.name] <= sizes[1]

    def model(self, effects: Sequence[str] = ()) -> ResponseModel:
        """The campaign's model with more effects than its own switched on."""
        return self.model_of(self.campaign.with_effects(effects))

    def reduced_model(self, effects: Sequence[str]) -> ResponseModel:
        """The campaign's model with these of its own effects alone."""
        campaign = self.campaign.with_only(effects)
        anchor = self.anchor if campaign.effects == self.campaign.effects else None
        return ResponseModel(campaign, self.responses, campaign.switched_on, anchor)

    def model_of(self, campaign: Campaign, anchor: Anchor | None = None) -> ResponseModel:
        """The model of a campaign with the same configurations, anchored here or elsewhere."""
        anchor = self.anchor if anchor is None else anchor
        return ResponseModel(campaign, self.responses, campaign.switched_on, anchor)


def not_adding_up(effects: Sequence[str], chi2: float, by_responses: float) -> str:
    """What to say where effects that were simulated together do not fit as their responses did.

    `by_responses` is the chi2 of these; empty where both fit alike.
    """
    if chi2 < max(EXTENT.not_adding_up * by_responses, by_responses + EXTENT.worse):
        return ""
    return (
        f"with {' and '.join(effects)} simulated together chi2 is {number(chi2)}, not "
        f"{number(by_responses)} as their responses had it: the effects do not add up, or an "
        "effect's file acts otherwise alone than beside others"
    )


class CampaignSimulations:
    """Simulates what models of a campaign rest on, and keeps the account of it.

    The photons of `run` are those of every simulation with an effect; configurations as they are
    get several times as many. With a precision eta of these is simulated to it, as far as it can.
    The same campaign, run and version give the same simulations, so that every verb shows the same
    fit of the campaign as it is.
    """

    def __init__(self, campaign: Campaign, run: Run) -> None:
        self.campaign = campaign
        photons, precision = run.photons, run.precision
        if precision is not None:
            enough = round(EXTENT.photons_per_precision / precision**2 / PLAIN_FACTOR)
            photons = max(enough if photons is None else min(enough, photons), 1)
        self.run = replace(run, photons=photons)
        self._start = time.perf_counter()
        self._schedules: list[Schedule] = []
        self._models: CampaignModels | None = None
        # of the campaign's own effects; whether one is needed is known once there are models
        self._anchor: Anchor | None = None
        # of the campaign as it is by its responses, found to see whether its grid is wide enough
        self._minima: list[Minimum] = []
        self._beyond, self._most_per_cm = Beyond(), math.inf
        self._fit: Calibration | None = None
        self.notes: list[str] = []
        #: Effects that the scene cannot take, with the reason; filled by `possible`.
        self.not_tried: dict[str, str] = {}

    def of(self, campaign: Campaign) -> CampaignSimulations:
        """Those of a campaign with the same configurations, which go on from here."""
        other = copy.copy(self)
        other.campaign, other._fit, other._minima = campaign, None, []
        if self._models is not None:
            other._models = replace(self._models, campaign=campaign)
        if campaign.effects != self.campaign.effects:
            other._anchor = None
        return other

    @property
    def models(self) -> CampaignModels:
        """What was simulated so far; of the bench as it is, if nothing was."""
        return self._models or self.simulate()

    def simulate(
        self,
        effects: Sequence[str] = (),
        look: Collection[str] = (),
        near: Mapping[str, Sizes] = {},
    ) -> CampaignModels:
        """What models rest on, with some effects besides the campaign's own.

        Two, as in ``"ground + gel_creep"``, are simulated together: what both do need not be the
        sum of what each does. What was simulated before is not simulated again. What `look` names
        gets a first look with a part of the photons, if it had no more before; what is `near` some
        sizes gets all photons there, and elsewhere those of a look.
        """
        if self._models is None and effects:
            self.simulate()
        catalogue = self.campaign.catalogue
        pairs = [name for name in effects if " + " in name]
        singles = [name for name in effects if " + " not in name]
        wanted = [catalogue[name] for name in (*self.campaign.effects, *singles)]
        precise = frozenset[str]() if self._models is None else self._models.precise
        few = {*look, *near}
        precise |= {e.name for e in wanted if e.name not in few or e.reading is not None}
        precise |= {*pairs} - few
        wrapped = self.campaign.scene.parts.all("shape", "wrapping")
        if self._models is None and self.campaign.tolerances and wrapped:
            # tolerances are simulated on what is then known to be wide enough: they take as long;
            # elsewhere a part of a job would make all of the bench as it is, and not its share
            without = replace(self.campaign, tolerances=())
            of_bench = self.maker.make(wanted, tolerances=False)
            models = CampaignModels(
                campaign=without, responses=of_bench, anchor=None, precise=frozenset()
            )
            if not self._is_covered(models):
                del self.maker
                return self.simulate(effects, look, near)
        self._models = CampaignModels(
            campaign=self.campaign,
            responses=self.maker.make(wanted, few - precise, pairs=pairs, near=near),
            anchor=self._anchor,
            precise=precise,
            near={name: sizes for name, sizes in near.items() if name not in precise},
        )
        if not self._is_covered(self._models):
            self._models = None
            del self.maker
            return self.simulate(effects, look, near)
        if self._anchor is None and not self.maker.is_exact(self.campaign.switched_on):
            fit = self._anchored(self.campaign, profile=False)
            assert isinstance(fit.model, ResponseModel)
            self._anchor = fit.model.anchor
            self._models = replace(self._models, anchor=self._anchor)
        return self._models

    def _is_covered(self, models: CampaignModels) -> bool:
        """Whether scattering is simulated as far as readings ask, and no farther than is told.

        If not, its range is set anew.
        """
        if self._minima:
            return True
        if (most := models.responses.told_to_per_cm) < self._most_per_cm:
            self._most_per_cm = most
            return False
        if all(self._beyond):
            return True
        minima, before = find_minima(Statistic(models.model())), self._beyond
        self._beyond = self._goes_beyond(minima[0])
        self._minima = minima if self._beyond == before and models.campaign is self.campaign else []
        return self._beyond == before

    def _goes_beyond(self, minimum: Minimum) -> Beyond:
        """At which ends the readings ask for coefficients that the simulations do not cover.

        They do where chi2 has not risen by `ONE_SIGMA` up to there, or it is near, and the campaign
        allows more: of readings that are far from described, chi2 is steep and rough.
        """
        statistic, beyond = minimum.statistic, self._beyond._asdict()
        for place, bounds in enumerate(statistic.free):
            coefficient = self.campaign.stands_for(bounds.name)
            if coefficient not in (ALPHA_SCAT, ALPHA_ABS):
                continue
            allowed = self.campaign.parameters[bounds.name]
            low, high = bounds.minimum, bounds.maximum
            # by the name in `Beyond`: where the end is, and whether the campaign allows more
            ends = {"clear": (low, low > max(allowed.minimum, LEAST_ABSORPTION_PER_CM))}
            if coefficient == ALPHA_SCAT:
                most = min(allowed.maximum, self._most_per_cm)
                ends = {"low": (low, low > allowed.minimum), "high": (high, high < most)}
            for side, (end, goes_on) in ends.items():
                if goes_on:
                    start = minimum.theta.copy()
                    start[place] = end
                    near = abs(math.log(minimum.theta[place] / end)) < math.log(EXTENT.near_end)
                    chi2 = newton(statistic, start, minimum.weights, held=[place]).height
                    beyond[side] |= near or chi2 < minimum.chi2 + ONE_SIGMA
        return Beyond(**beyond)

    def fit(self) -> Calibration:
        """The campaign's own fit, the one that every verb shows; errors as `fit_model`."""
        if self._fit is None:
            models = self.models
            # what joint simulations correct has other minima
            minima = self._minima if self._anchor is None else []
            self._fit = result_of(minima or find_minima(Statistic(models.model())), profile=True)
        return self._fit

    def settled_fit(
        self, effects: Sequence[str] = (), starts: Mapping[str, float] | None = None
    ) -> Calibration:
        """The fit with more effects, of the model that was simulated where that fit ends.

        Responses add up what effects do one by one, between nodes; where that is not exact, all
        effects are simulated together where the fit ended, and it is repeated from there.

        Where the readings leave the sizes of the added effects open, what is plausible becomes
        their prior: the model's campaign has it, and a note of the fit tells.

        It begins at `starts`: an effect's responses may have several minima. Errors as `fit_model`.
        """
        campaign = self.campaign.with_effects(effects).with_starts(starts or {})
        added = [self.campaign.catalogue[name] for name in effects]
        plausible = plausible_priors(added, self.models.model())
        try:
            fit = self._settled(campaign)
            open_sizes = [
                n for n, (_, s) in plausible.items() if fit.parameters[n].sigma > EXTENT.open * s
            ]
        except UndeterminedError:
            if not plausible:
                raise
            open_sizes = list(plausible)
        if not open_sizes:
            return fit
        priors = {name: plausible[name] for name in open_sizes}
        fit = self._settled(campaign.with_priors(priors))
        sizes = "; ".join(f"{name} {number(at)} ± {number(s)}" for name, (at, s) in priors.items())
        note = f"the readings leave sizes open, and what is plausible is their prior: {sizes}"
        return replace(fit, notes=(*fit.notes, note))

    def _settled(self, campaign: Campaign) -> Calibration:
        if self.maker.is_exact(campaign.switched_on):
            return fit_model(self.models.model_of(campaign))
        return self._anchored(campaign, profile=True)

    def _anchored(self, campaign: Campaign, *, profile: bool) -> Calibration:
        """The fit of a campaign's model, all effects simulated together where it ends."""
        fit = fit_model(self.models.model_of(campaign), profile=False)
        by_responses = fit.chi2
        for _ in range(EXTENT.most_anchors):
            model = self.anchored_model(campaign, fit.values)
            before, fit = fit, fit_model(model, profile=False)
            sigmas = np.array([fit.parameters[name].sigma for name in fit.names])
            moved = np.abs(fit.theta - before.theta) / np.maximum(sigmas, 1e-300)
            if np.all(moved < EXTENT.settled):
                break
        if profile:
            fit = fit_model(model)
        note = not_adding_up(campaign.effects, fit.chi2, by_responses)
        return replace(fit, notes=(*fit.notes, note)) if note else fit

    def anchored_model(self, campaign: Campaign, values: Mapping[str, float]) -> ResponseModel:
        """A campaign's model, corrected by a simulation of all its effects at once at some values.

        Fits begin there.
        """
        campaign = campaign.with_starts(values)
        maker = self._maker_of(campaign, f"simulation with {' and '.join(campaign.effects)}")
        # sizes of effects that are held are in the scene, too
        anchor = maker.anchor(campaign.switched_on, {**held(campaign), **values})
        return self.models.model_of(campaign, anchor)

    @cached_property
    def maker(self) -> ResponseMaker:
        """What makes the responses of the campaign's own readings."""
        return self._maker_of(self.campaign, "simulation")

    def _maker_of(self, campaign: Campaign, what: str, part: float = 1.0) -> ResponseMaker:
        """What makes responses of a campaign, its progress shown under a name."""
        # what cannot be diagnosed takes little time as it is
        sigma = self._usual_sigma(of_beam=False) if self.campaign.ndf > 0 else None
        most = self._most_per_cm
        maker = ResponseMaker(
            campaign, self.run, what, part=part, sigma=sigma, beyond=self._beyond, most_per_cm=most
        )
        self._schedules.append(maker.schedule)
        return maker

    def proposals(self) -> MeasurementProposals:
        """What could be measured next; it is simulated when it is asked for."""
        light, beams, switched = self._not_measured()
        minutes = self.campaign.next_measurements.get(NEXT_MINUTES, {})
        of_parts = [(taken_off(self.campaign, [name]), of) for name, of in minutes.items()]
        sigmas = [self._usual_sigma(of_beam=False)] * len(light)
        sigmas += [self._usual_sigma(of_beam=True)] * len(beams)
        return MeasurementProposals(
            [*light, *beams],
            [self.predict_at(kind, EXTENT.proposed_part) for kind in (light, beams) if kind],
            self._repeated(),
            np.array(sigmas),
            minutes={n: of for off, of in of_parts for n in off} | minutes,
            comments={n: known.comment for n, known in self.campaign.scene.defaults.items()},
            own={**BEAM_PARAMETERS, **self.campaign.values},
            switched=[*switched, *([] for _ in beams)],
            switched_by=self._switched_by,
        )

    @property
    def refusals(self) -> list[str]:
        """What was not tried, and why, in sentences."""
        return [f"{name} was not tried: {why}" for name, why in self.not_tried.items()]

    @property
    def _switched_by(self) -> tuple[str, ...]:
        """Scene parameters by which rows switch something."""
        measured = self.campaign.measurements
        names = dict.fromkeys(name for row in measured.readings for name in row.parameters)
        return tuple(name for name in names if name not in measured.columns)

    def _repeated(self) -> Models:
        """Models of the campaign's readings, as if they were made now, after all others."""
        models, measured = self.models, self.campaign.measurements
        # readings without a line come last
        now = tuple(replace(reading, line=0) for reading in measured.readings)
        campaign = replace(self.campaign, measurements=replace(measured, readings=now))
        return cache(lambda effects: models.model_of(campaign.with_effects(effects)))

    def _usual_sigma(self, *, of_beam: bool) -> float:
        """Relative error of a proposed reading of a kind."""
        given = self.campaign.next_measurements.get(NEXT_SIGMA)
        if given is not None and not of_beam:
            return float(given)
        rows = self.campaign.measurements.in_use
        used = [r.sigma / r.signal for r in rows if r.of_beam == of_beam]
        return float(np.median(used)) if used else EXTENT.usual_sigma

    def predict_at(
        self,
        configurations: Sequence[Mapping[str, Value]],
        part: float = 1.0,
        *,
        tolerances: bool = False,
    ) -> Callable[[tuple[str, ...]], ResponseModel]:
        """Models of configurations, taken for readings that nobody made, with some effects.

        All are of light, or all of beams. They are simulated when they are first asked for, with a
        part of the photons, and the bench's numbers count as exact without `tolerances`.
        """
        # an acceptance that is the instrument's own is as wrong as that, or fitted with it
        own = {ACCEPTANCE: self.campaign.values.get(ACCEPTANCE)}
        readings = tuple(
            Reading(
                label=", ".join(f"{n} = {v}" for n, v in each.items()),
                signal=math.nan,
                sigma=math.nan,
                parameters={n: v for n, v in each.items() if n != KIND and v != own.get(n)},
                kind=str(each.get(KIND, LIGHT)),
            )
            for each in configurations
        )
        # no columns: what one proposal changes may be fitted to the others
        measured = replace(self.campaign.measurements, columns=(), readings=readings)
        proposed = replace(self.campaign, measurements=measured)
        if not tolerances:
            proposed = replace(proposed, tolerances=())
        if readings[0].of_beam:
            proposed = replace(proposed, beam={**BEAM_PARAMETERS, **self.campaign.beam})

        @cache
        def maker() -> ResponseMaker:
            return self._maker_of(proposed, "proposed measurements", part)

        @cache  # what is predicted with some effects has its noise asked for next
        def model(effects: tuple[str, ...]) -> ResponseModel:
            campaign = proposed.with_effects(effects)
            responses = maker().make(campaign.switched_on)
            return ResponseModel(campaign, responses, campaign.switched_on)

        return model

    def _not_measured(
        self,
    ) -> tuple[list[dict[str, Value]], list[dict[str, Value]], list[list[str]]]:
        """What the laboratory can build and did not measure: of light, and transmittances.

        Last, in words, what of the things that rows switch those of light have.
        """
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

        light = [reading for reading in campaign.measurements.readings if not reading.of_beam]
        # a treatment's size is fitted where it is on
        as_usual = {n: scene[n] for n in self._switched_by if isinstance(scene.get(n), str)}
        # what rows say is told, though it be the scene's value
        as_usual |= {
            name: scene[name]
            for name in campaign.measurements.columns
            if name in scene and any(r.parameters.get(name) != scene[name] for r in light)
        }
        proposals, switched = list[dict[str, Value]](), list[list[str]]()
        for cells in buildable(campaign):
            changed, off = as_in_scene(campaign, cells)
            proposal = {**changed, **{n: v for n, v in as_usual.items() if n not in changed}}
            if new(proposal):
                proposals.append(proposal)
                switched.append(states(campaign, off))
        if len(proposals) > EXTENT.most_proposals:
            self.notes.append(
                f"of {len(proposals)} configurations that could be measured next, "
                f"{EXTENT.most_proposals} were looked at: restrict [next_measurements]"
            )
        beams = [p for p in _beams(campaign) if new(p)]
        most = slice(EXTENT.most_proposals)
        return proposals[most], beams[most], switched[most]

    def provenance(self) -> Provenance:
        """What was spent so far."""
        of_caches = [note for schedule in self._schedules for note in schedule.notes]
        of_caches += self.maker.notes
        return Provenance(
            seed=self.run.seed,
            photons=sum(schedule.photons for schedule in self._schedules),
            cached_photons=sum(schedule.cached_photons for schedule in self._schedules),
            scene_hash=self.campaign.scene.content_hash,
            versions=versions(self.run.variant, self.run.threads),
            seconds=time.perf_counter() - self._start,
            notes=tuple(dict.fromkeys((*self.notes, *of_caches))),
        )

    def possible(self) -> dict[str, Effect]:
        """Effects of the catalogue that the scene can take and does not have."""
        found = {}
        campaign = self.campaign
        # a number with a tolerance is a candidate by itself
        numbers = {tolerance.number.parameter for tolerance in campaign.tolerances}
        # where values differ each is, and of liquids, which share a temperature, all together
        parts = {f"{WRONG}{tolerance.number.name}" for tolerance in campaign.tolerances}
        parts |= {f"{WRONG}{t.number.parameter}" for t in campaign.tolerances if t.number.is_index}
        for name, effect in campaign.catalogue.items():
            there = (*campaign.effects, *campaign.treatments, *campaign.known_physics)
            if name in there or effect.is_in(campaign.scene) or not effect.offered:
                continue
            if NUMBERS_OF.get(name) in numbers or (effect.number and name not in parts):
                continue
            if effect.of_beam and not campaign.beam:
                continue
            if not effect.acts_in(campaign.scene):
                continue
            if effect.reading is not None and not acts_on(effect, campaign):
                continue
            if any(name in campaign.catalogue[other].excludes for other in there):
                continue
            try:
                campaign.with_effects([name])
            except InputError as error:
                refusal: str | None = error.problem
            else:
                refusal = refusal_of(effect, campaign.scene) if effect.edit is not None else None
            if refusal is None:
                found[name] = effect
            else:
                self.not_tried[name] = refusal
        return found


def calibrate(simulations: CampaignSimulations) -> Calibration:
    """Fit a campaign's readings, and with them the light yield.

    The precision of its run is that of eta in every configuration, where the fit ends; a note of
    the simulations tells where it was not reached.

    Raises InputError if a configuration's scene is not sound, or the readings do not determine the
    parameters.
    """
    campaign, run = simulations.campaign, simulations.run
    refuse_unnamed_coefficients(campaign)
    simulations.simulate()
    run.tell(f"fitting {len(campaign.measurements.in_use)} readings", 1, 1)
    fit = simulations.fit()
    worst = max(row.eta_sigma / row.eta for row in fit.rows)
    if run.precision is not None and worst > run.precision:
        simulations.notes.append(
            f"eta is known to {100 * worst:.2g} % only in one of the configurations"
        )
    return fit


def as_numbers(names: Iterable[str], possible: Collection[str]) -> tuple[str, ...]:
    """Names of effects, with ``wrong:n_crystal`` in the place of ``crystal_index`` where possible.

    Of a number that differs from reading to reading these are those of its values, if all together
    are none.
    """
    found = dict[str, None]()
    for name in names:
        whole = f"{WRONG}{NUMBERS_OF.get(name)}"
        parts = [other for other in possible if other.startswith(f"{whole}=")]
        others = [whole] if whole in possible else parts
        found |= dict.fromkeys([name] if name in possible or not others else others)
    return tuple(found)


def spent_together(spent: Sequence[Provenance], notes: Iterable[str] = ()) -> Provenance:
    """What benches spent of one run, the first begun first; `notes` precede theirs."""
    return replace(
        spent[0],
        photons=sum(each.photons for each in spent),
        cached_photons=sum(each.cached_photons for each in spent),
        notes=tuple(dict.fromkeys([*notes, *(note for each in spent for note in each.notes)])),
    )


def buildable(campaign: Campaign) -> list[dict[str, Value]]:
    """Configurations that may be proposed, as what differs from the scene and cells of switches.

    What rows switch stays as in the first, unless the campaign says what may be built of it: all
    of it at once may be no bench of theirs.
    """
    light = (reading for reading in campaign.measurements.readings if not reading.of_beam)
    first = next(light, None)
    # another sample is no bench of the campaign's own
    off = first.without if first and not first.sample else ()
    as_first = {name: float(name not in off) for name in campaign.measurements.switches}
    return [{**as_first, **cells} for cells in _buildable(campaign)]


def _buildable(campaign: Campaign) -> list[dict[str, Value]]:
    """These without what only the first row says."""
    scene = campaign.scene.parameters
    names = {*scene, *campaign.measurements.switches}
    given = {name: v for name, v in campaign.next_measurements.items() if name in names}
    if given or BEAM_PARAMETERS.keys() & campaign.next_measurements.keys():
        if not given:
            return []
        return [dict(zip(given, values, strict=True)) for values in product(*given.values())]
    # the scene's own values, those of the campaign's readings, and usual ones beside the scene's
    scene, columns = campaign.scene.parameters, campaign.measurements.columns
    width = next((float(scene[name]) for name in CRYSTAL_WIDTHS if name in scene), 0.0)
    widest = USUAL.widest_mask * float(scene.get(WINDOW, width))
    usual: dict[str, list[float]] = {
        GAP_INDEX: [],
        APERTURE: [part * width for part in USUAL.masks if 0.0 < part * width <= widest],
        GAP: [factor * float(scene.get(GAP, 0.0)) for factor in USUAL.gaps],
    }
    for name in CRYSTAL_LENGTHS:
        usual[name] = [factor * float(scene.get(name, 0.0)) for factor in USUAL.crystals]
    sizes = [*usual, *(name for name in columns if name.endswith("_mm") and name not in usual)]
    readings = [each for each in campaign.measurements.readings if not each.of_beam]
    values = {
        name: sorted(
            {
                float(scene[name]),
                *(float(f"{value:.3g}") for value in usual.get(name, ())),
                *(float(each.parameters.get(name, scene[name])) for each in readings),
            }
        )
        for name in sizes
        if name in scene
    }
    couplings, masks = values.pop(GAP_INDEX, []), values.pop(APERTURE, [])
    further = (
        n for n in USUAL.liquids if couplings and all(abs(n - m) > USUAL.alike for m in couplings)
    )
    found = _combinations({GAP_INDEX: sorted([*couplings, *further]), APERTURE: masks})
    # the readings of one coupling tell little more of another one between
    ends = [couplings[0], couplings[-1]] if len(couplings) > 1 else [*couplings, *USUAL.other_end]
    for name, others in values.items():
        found += _combinations({GAP_INDEX: ends if couplings else [], name: others})
    named = {GAP_INDEX, *campaign.measurements.columns}
    found = [{n: v for n, v in each.items() if n in named or v != scene[n]} for each in found]
    found = [each for each in found if _lit({**scene, **each})]
    return [each for place, each in enumerate(found) if each and each not in found[:place]]


def _lit(scene: Mapping[str, Value]) -> bool:
    """Whether the slab in which light is born lies in a crystal of these parameters."""
    names = (HEIGHT, SOURCE_Z, SOURCE_WIDTH)
    if not all(name in scene for name in names):
        return True
    height, middle, width = (float(scene[name]) for name in names)
    return -width / 2.0 < middle < height + width / 2.0


def _combinations(axes: Mapping[str, Sequence[float]]) -> list[dict[str, Value]]:
    """All combinations of values of those parameters that have any."""
    axes = {name: values for name, values in axes.items() if values}
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values()) if axes]


def _beams(campaign: Campaign) -> list[dict[str, Value]]:
    """Transmittances that may be proposed, each as what tells it from the campaign's own."""
    allowed = campaign.next_measurements
    given = {name: values for name, values in allowed.items() if name in BEAM_PARAMETERS}
    if not given and any(name not in (NEXT_SIGMA, NEXT_MINUTES) for name in allowed):
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
        found = [{ACCEPTANCE: angle} for angle in USUAL.acceptances_deg]
        other = "x" if own[BEAM_AXIS] == "z" else "z"
        same = {ACCEPTANCE: own[ACCEPTANCE]}
        found += [
            {**same, BEAM_AXIS: other},
            {**same, BEAM_AXIS: "z", HEIGHT: USUAL.long_crystal * float(campaign.values[HEIGHT])},
        ]
    return [
        {KIND: TRANSMITTANCE, **each}
        for each in found
        if too_wide({**campaign.scene.parameters, **own, **each}) is None
    ]
