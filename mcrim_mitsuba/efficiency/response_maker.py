"""Responses of a campaign's readings to physical effects: from the cache, else simulated.

Every configuration is simulated once as it is, with a mask that covers nothing: what its photons
met answers every smaller aperture, and every effect that only weights photons. Other effects are
simulated at their nodes. All runs draw the same random numbers, so that what they have in common
cancels, and batches of one number belong together.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.tolerances import Tolerance
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALL_DETECTORS, ALPHA_ABS, ALPHA_SCAT, COUNTED, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, filled
from mcrim_mitsuba.effects.surroundings import FORWARD_BEAM
from mcrim_mitsuba.efficiency.eta_grid import (
    APERTURE,
    BATCHES,
    EtaGrid,
    Grid,
    difference,
    has_open_mask,
    open_aperture,
    refuse_shared_coefficients,
    tells_detectors,
)
from mcrim_mitsuba.efficiency.proposals import USUAL_ALPHA_SCAT_PER_CM, WITHIN, Beyond, coverage_of
from mcrim_mitsuba.efficiency.responses import (
    Anchor,
    Axis,
    EffectResponse,
    Point,
    Responses,
    Sizes,
    stack,
)
from mcrim_mitsuba.efficiency.schedule import Identity, PlannedRun, Schedule, WantedTable
from mcrim_mitsuba.efficiency.surface import chebyshev_nodes
from mcrim_mitsuba.optics.slab_transmittance import measured_transmittance, transmittance
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import (
    ACCEPTANCE,
    GAP_INDEX,
    polished_slab,
    scattered_share,
    spectrophotometer_of,
)
from mcrim_mitsuba.transport.launch_plan import LANES

#: Most photons of a simulation with an effect in the scene, where nothing else is said, and how
#: many times as many of a configuration as it is: all effects are compared with it.
EFFECT_PHOTONS, PLAIN_FACTOR = 16 * LANES, 4
#: Error of a simulation in a wrapping, over that of its reading, from which on it needs no more
#: photons (those of the article's benches are 0.2 to 1.2). Elsewhere few take as long as many.
_PRECISE = 0.7
#: Part of the most photons of an effect that a first look takes; of few a part tells nothing.
LOOK_PART = 1 / 8
#: How many times as many one at a pair of effects takes, which is of one size only: that they add
#: up is usual, and must not be lost in noise.
PAIR_LOOKS = 2
#: The same for all effects at once where a fit ends.
ANCHOR_FACTOR = 2
#: Most photons of one simulation: its records are held in memory.
_MOST_PHOTONS = 512 * LANES
#: A usual alpha_abs, 1/cm.
USUAL_ALPHA_ABS_PER_CM = 0.04
#: Nodes of a fitted acceptance, and where, in degrees, its logarithm takes over from itself.
_ACCEPTANCE_NODES, _ACCEPTANCE_SCALE_DEG = 7, 2.0
#: Stands for infinity in a scene.
_AS_GOOD_AS_INFINITE = 1e9
#: Half angle that takes all that leaves a face.
_HALF_SPACE_DEG = 90.0
#: Pieces of a band of light, each with as much of it.
_MOST_COLOURS = 24
#: Part of once scattered light that a beam's detector may take where the closed form of the
#: transmittance is used: it is then right to 0.05 % for mean free paths of 2 cm.
_CLOSED_FORM_SHARE = 1e-3
#: Nodes of a fitted scene parameter that is no effect's, its own value included.
_SCENE_NODES = 5
#: The result that is the bench as it is.
_PLAIN = "plain bench"


class _Node(NamedTuple):
    """An effect at a value, as one reading sees it: two tables of the same photons."""

    #: Of the value, in the order of the effect's axes.
    place: tuple[int, ...]
    #: Number of the reading.
    reading: int
    #: Of the bench as it is.
    reference: WantedTable
    #: With the effect.
    changed: WantedTable


@dataclass(frozen=True)
class _EffectPlan:
    """What an effect's response is made of; readings without nodes do not see the effect."""

    #: Of the effect, or of a tolerance.
    name: str
    axes: tuple[Axis, ...]
    nodes: Sequence[_Node]

    @property
    def tables(self) -> list[WantedTable]:
        """All that are wanted."""
        return [table for node in self.nodes for table in (node.reference, node.changed)]


class _Bench(NamedTuple):
    """A reading's configuration without further effects."""

    run: PlannedRun
    #: Fine and coarse tables where they follow from a closed form, which needs no photons.
    closed_form: tuple[EtaGrid, EtaGrid] | None
    #: Those that are wanted where they do not.
    tables: tuple[WantedTable, ...]


def _within(wanted: WantedTable, angle_deg: float) -> WantedTable:
    """A beam's table with the light within another half angle."""
    of = wanted.request
    run = replace(wanted.run, radius_mm=angle_deg)
    return run.table(coarse=of.coarse, effect=of.effect, values=of.values)


class ResponseMaker:
    """Makes the responses of a campaign's readings, effect by effect.

    The photons of `run` are those of a simulation with an effect in the scene; those as the bench
    is get `PLAIN_FACTOR` times as many. Its precision does not matter. Without a number they are
    `part` of `EFFECT_PHOTONS`; with `sigma`, the relative error of readings that nobody made, those
    of light in a wrapping get what their errors ask for, as a first look at the bench tells: the
    fewest, by powers of two, with which eta's error is below `_PRECISE` of the reading's. `what` is
    its name in progress. The range of alpha_scat goes on beyond the usual lower or higher end where
    a fit does, and up to `most_per_cm`.
    """

    def __init__(
        self,
        campaign: Campaign,
        run: Run,
        what: str = "simulation",
        *,
        part: float = 1.0,
        sigma: float | None = None,
        beyond: Beyond = WITHIN,
        most_per_cm: float = math.inf,
    ) -> None:
        self.campaign, self._sigma = campaign, sigma
        self._readings = campaign.measurements.readings
        self._given, self._part = run.photons is not None, part
        units = _units(part * run.photons_or(EFFECT_PHOTONS))
        self._effect_photons = units * LANES
        self._look_photons = max(round(LOOK_PART * units), 1) * LANES
        self._check = run.check
        self._open_mask = has_open_mask(campaign.scene)
        coverage, light = coverage_of(campaign, beyond, most_per_cm), campaign.spectrum
        self.grid, self._coarse = coverage.fine, coverage.coarse
        colours = None if light is None else light.colours(_MOST_COLOURS)
        #: Account of the simulations: photons, what the cache had, notes.
        self.schedule = Schedule(run, coverage, colours, what)
        # by reading: the closed form, or that its beam is simulated
        self._ways: dict[str, str] = {}

    @property
    def notes(self) -> list[str]:
        """How transmittances were had, by a closed form or not."""
        return [f"{label}: {way}" for label, way in self._ways.items()]

    # ---- simulations of the readings -----------------------------------------------------------

    def _simulation(
        self,
        scene: SceneFile,
        values: Mapping[str, Value],
        photons: int,
        *,
        of_beam: bool,
        check: bool = False,
    ) -> PlannedRun:
        """A run of a scene, or of its crystal's transmittance, at a configuration's values."""
        scene = _scene_for(scene, of_beam)
        parameters = {n: v for n, v in values.items() if n not in (ALPHA_SCAT, ALPHA_ABS)}
        radius = None
        if of_beam:
            radius = float(parameters[ACCEPTANCE])
            parameters[ACCEPTANCE] = _HALF_SPACE_DEG
        elif self._open_mask and has_open_mask(scene):
            radius = float(parameters[APERTURE])
            parameters |= open_aperture(parameters)
        detector = None
        if tells_detectors(scene) and parameters[COUNTED] != ALL_DETECTORS:
            detector = str(parameters[COUNTED])
            parameters[COUNTED] = ALL_DETECTORS
        return PlannedRun(
            base=_usual(scene),
            overrides={n: v for n, v in parameters.items() if n in scene.parameters},
            parameters=values,
            radius_mm=radius,
            detector=detector,
            photons=photons,
            check=check,
            of_beam=of_beam,
        )

    # ---- responses -----------------------------------------------------------------------------

    def make(
        self,
        effects: Sequence[Effect],
        look: Collection[str] = (),
        *,
        pairs: Collection[str] = (),
        near: Mapping[str, Sizes] = {},
        tolerances: bool = True,
    ) -> Responses:
        """Simulated responses of the campaign's bench, as it is and with each of the effects.

        Effects that change no light, but how readings are read, need no simulation and are left
        out. `pairs` of names are simulated together, too. Those named by `look` get a part of the
        photons, for a first look, at fewer nodes if they are not `near` any size, and pairs a
        single size of each effect; at nodes between two sizes, and next to these, all photons fly.
        Of the bench's numbers `tolerances` are left out where nobody asks for them. Raises
        InputError if a scene is not sound, leaks, or cannot take an effect.
        """
        benches = self._benches()
        plain = [bench.run for bench in benches]
        plans = list(self._plans(effects, look, plain, near))
        by_name = {effect.name: effect for effect in effects}
        for pair in sorted(pairs):
            both = [by_name[name] for name in pair.split(" + ")]
            plans.append(self._plan_of_pair(both, plain, is_look=pair in look))
        if tolerances:
            plans += [self._plan_of_tolerance(each, plain) for each in self.campaign.tolerances]
        of_benches = [table for bench in benches for table in bench.tables]
        wanted = [*of_benches, *(table for plan in plans for table in plan.tables)]
        tables = self.schedule.tables(wanted, by_all=not tolerances)
        self.schedule.rest_on(_PLAIN, of_benches)
        for plan in plans:
            self.schedule.rest_on(plan.name, plan.tables)
        known = [
            bench.closed_form or [tables[table.number] for table in bench.tables]
            for bench in benches
        ]
        log_eta, deviations = stack([fine for fine, _ in known])
        self._refuse_darkness(log_eta)
        coarse = {
            (number, bench.run.radius_mm): table
            for number, (bench, (_, table)) in enumerate(zip(benches, known, strict=True))
        }
        responses = {plan.name: self._response(plan, tables, coarse) for plan in plans}
        for plan in (plan for plan in plans if plan.name in pairs):
            for node, name in product(plan.nodes, plan.name.split(" + ")):
                responses[plan.name].less(responses[name], node.place, node.reading)
        return Responses(
            self.grid, self._coarse, log_eta, deviations, responses, self.schedule.photons
        )

    def _benches(self) -> list[_Bench]:
        """Of every reading, with the photons that the bench as it is gets."""
        benches = []
        for reading, values, own in zip(
            self._readings, configurations(self.campaign), self._photons, strict=True
        ):
            run = self._simulation(
                self.campaign.scene,
                values,
                min(PLAIN_FACTOR * own, _MOST_PHOTONS),
                of_beam=reading.of_beam,
                check=self._check and not self.looks,
            )
            closed_form = self._closed_form(reading.label, run) if reading.of_beam else None
            if closed_form is None:
                tables: tuple[WantedTable, ...] = run.table(coarse=False), run.table()
            else:
                # what effects do to it is simulated
                run, tables = replace(run, photons=own, check=False), ()
            benches.append(_Bench(run, closed_form, tables))
        return benches

    @functools.cached_property
    def looks(self) -> list[PlannedRun]:
        """First looks at the bench as it is, by reading; none where all get as many photons."""
        scene, of_beam = self.campaign.scene, any(reading.of_beam for reading in self._readings)
        wrapped = scene.parts.all("shape", "wrapping")
        if self._given or self._sigma is None or of_beam or not wrapped:
            return []
        return [
            self._simulation(scene, values, self._look_photons, of_beam=False, check=self._check)
            for values in configurations(self.campaign)
        ]

    @functools.cached_property
    def _photons(self) -> list[int]:
        """Of every reading's simulations with an effect."""
        if not self.looks:
            return [self._effect_photons] * len(self._readings)
        tables = self.schedule.tables([run.table() for run in self.looks], by_all=True)
        most = EFFECT_PHOTONS // LANES
        asked: dict[Identity, int] = {}
        for run, reading in zip(self.looks, self._readings, strict=True):
            assert self._sigma is not None
            sigma = self._sigma if math.isnan(reading.sigma) else reading.sigma / reading.signal
            error = tables[run.table().number].usual_error / (_PRECISE * sigma)
            units = error**2 * run.photons / LANES
            # in the dark nothing is known
            units = min(2 ** max(math.ceil(math.log2(units)), 0), most) if units > 0.0 else most
            # readings that masks are cut out for share their photons
            asked[run.identity] = max(units, asked.get(run.identity, 0))
        return [_units(self._part * asked[run.identity] * LANES) * LANES for run in self.looks]

    def _plans(
        self,
        effects: Sequence[Effect],
        look: Collection[str],
        plain: Sequence[PlannedRun],
        near: Mapping[str, Sizes],
    ) -> Iterator[_EffectPlan]:
        """Plans of the effects that act on light, and of fitted scene parameters of no effect."""
        scene = self.campaign.scene
        acting = [
            effect
            for effect in effects
            # one without parameters that the scene has already is in all its simulations
            if effect.reading is None and (effect.parameters or not effect.is_in(scene))
        ]
        acting += [_as_effect(self.campaign, name) for name in self._further_parameters()]
        # where a model may change the acceptance, every effect's response depends on it
        acceptance = next((p for e in acting if e.of_beam for p in e.parameters), None)
        few = [
            replace(run, photons=own, check=False)
            for run, own in zip(plain, self._photons, strict=True)
        ]
        for effect in acting:
            sizes = near.get(effect.name)
            # those told by the same photons at all nodes get all of them
            is_look = effect.name in look and (sizes is None or not self._weighs(effect))
            runs = few if is_look else plain
            yield self._plan(effect, runs, acceptance, sizes, is_look=is_look)

    def _plan(
        self,
        effect: Effect,
        plain: Sequence[PlannedRun],
        acceptance: EffectParameter | None,
        sizes: Sizes | None,
        *,
        is_look: bool,
    ) -> _EffectPlan:
        """An effect at the nodes of its parameters."""
        weighs_plain = self._weighs(effect) and effect.proposal is None
        few = is_look and sizes is None and not weighs_plain
        axes = self._axes(effect.parameters, plain, few)
        if few and effect.number is not None:
            # as its tolerance, which is simulated anyway; what an index does bends
            (parameter,) = effect.parameters
            nodes = sorted(parameter.nodes, key=abs)
            nodes = nodes[:2] + (nodes[-2:] if effect.number.is_index else [])
            axes = (Axis(parameter, [0.0, *nodes]),)
        return self._plan_along(axes, effect, plain, acceptance, sizes, is_look=is_look)

    def _axes(
        self, parameters: Sequence[EffectParameter], plain: Sequence[PlannedRun], few: bool = False
    ) -> tuple[Axis, ...]:
        """Nodes of parameters that all readings' benches take; `few` as of `_axis`."""
        benches = [{**self.campaign.values, **run.parameters} for run in plain]
        return tuple(_axis(p, self.campaign.values, benches, few) for p in parameters)

    def _plan_of_tolerance(self, tolerance: Tolerance, plain: Sequence[PlannedRun]) -> _EffectPlan:
        """A number of the bench, off a little either way."""
        effect = tolerance.wrong
        axes = (Axis(effect.parameters[0], [0.0, *filter(None, tolerance.near)]),)
        plan = self._plan_along(axes, effect, plain, is_look=True)
        return replace(plan, name=tolerance.number.name)

    def _plan_of_pair(
        self, effects: Sequence[Effect], plain: Sequence[PlannedRun], *, is_look: bool
    ) -> _EffectPlan:
        """Two effects at once, for readings of light that see both."""
        parts = (1.0,) if is_look else (0.5, 1.0)
        parameters = [parameter for effect in effects for parameter in effect.parameters]
        axes = tuple(_toward_plausible(axis, parts) for axis in self._axes(parameters, plain))
        seeing = []
        for number, (run, row) in enumerate(zip(plain, self._readings, strict=True)):
            if not row.of_beam and all(self._is_seen(effect, run, row) for effect in effects):
                most = PAIR_LOOKS * self._look_photons if is_look else _MOST_PHOTONS
                photons = min(self._photons[number], most)
                seeing.append((number, replace(run, photons=photons, check=False)))
        nodes = []
        for place, values in _nodes(axes):
            benches = list(self.benches_with(effects, values))
            for number, run in seeing:
                changed = self._simulation(*benches[number], run.photons, of_beam=False)
                nodes.append(_Node(place, number, run.table(), changed.table()))
        return _EffectPlan(" + ".join(effect.name for effect in effects), axes, nodes)

    def _plan_along(
        self,
        axes: tuple[Axis, ...],
        effect: Effect,
        plain: Sequence[PlannedRun],
        acceptance: EffectParameter | None = None,
        sizes: Sizes | None = None,
        *,
        is_look: bool,
    ) -> _EffectPlan:
        """An effect at nodes of some axes; those of `acceptance` are last, where beams see it.

        A look is no look near `sizes` of its one axis.
        """
        readings = self._readings
        seeing = [n for n, run in enumerate(plain) if self._is_seen(effect, run, readings[n])]
        further = None
        if acceptance and not effect.of_beam and any(plain[number].of_beam for number in seeing):
            (further,) = self._axes([acceptance], plain)
        precise = set() if sizes is None else _near(axes[0], sizes)
        nodes: list[_Node] = []
        for number in seeing:
            run, row, most = plain[number], readings[number], self._photons[number]
            photons = most
            # a number of the bench is looked at as its tolerance is simulated, for every fit
            if is_look and (effect.number is None or most == self._effect_photons):
                photons = min(most, self._look_photons)
            few = self._sources(effect, run, photons)
            every = self._sources(effect, run, most) if precise else few
            at_own_acceptance = self._at_own_acceptance(run)
            for place, values in _nodes(axes):
                source, reference = every if place in precise else few
                changed = self._changed(effect, source, run, self._moved(row, values))
                if further is None:
                    nodes.append(_Node(place, number, reference, changed))
                    continue
                for i, offset in enumerate(further.values):
                    pair = reference, changed
                    if at_own_acceptance:
                        angle = further.nominal + offset
                        pair = _within(reference, angle), _within(changed, angle)
                    nodes.append(_Node((*place, i), number, *pair))
        return _EffectPlan(effect.name, axes if further is None else (*axes, further), nodes)

    def _sources(
        self, effect: Effect, run: PlannedRun, photons: int
    ) -> tuple[PlannedRun, WantedTable]:
        """What an effect is told by, and the table of the same photons without it.

        An effect that weighs photons is told by those of the bench as it is; if it has a proposal,
        by those of a bench with that, which are weighed back for the reference. Others have a
        simulation for each value, which differs from the source by that.
        """
        if not self._weighs(effect):
            source = replace(run, photons=photons, check=False)
            return source, source.table()
        if effect.edit is not None:  # or the scene cannot have it, and is refused
            _with_effect(self.campaign.scene, effect)
        if effect.proposal is not None:
            scene = _with_effect(self.campaign.scene, effect)
            values = {**run.parameters, **effect.proposal}
            source = self._simulation(scene, values, photons, of_beam=run.of_beam)
            absent = {p.name: p.absent for p in effect.parameters if p.absent is not None}
            return source, source.table(effect=effect, values=absent)
        # what weighs a beam's angles weighs all that leaves the crystal
        source = replace(run, radius_mm=_HALF_SPACE_DEG) if effect.of_beam else run
        return source, run.table()

    def _changed(
        self, effect: Effect, source: PlannedRun, run: PlannedRun, values: Mapping[str, float]
    ) -> WantedTable:
        """The table with an effect at some values; `source` as of `_sources`."""
        if self._weighs(effect):
            return source.table(effect=effect, values=values)
        scene = _with_effect(self.campaign.scene, effect)
        there = self._left(scene, run.parameters)
        there |= _as_scene_values(effect, run.parameters, values)
        return self._simulation(scene, there, source.photons, of_beam=run.of_beam).table()

    def _response(
        self,
        plan: _EffectPlan,
        tables: Mapping[int, EtaGrid],
        known: Mapping[tuple[int, float | None], EtaGrid],
    ) -> EffectResponse:
        """An effect's tables over those of the bench as it is.

        Of more photons, or by a closed form, the latter are `known` by reading and mask, or angle.
        """
        readings = self._readings
        shape = (*(len(axis.values) for axis in plan.axes), len(readings), *self._coarse.counts)
        log_ratio = np.zeros(shape)
        deviations = np.zeros((BATCHES, *shape), dtype=np.float32)
        for node in plan.nodes:
            plain, changed = (_lit(tables[of.number], of) for of in (node.reference, node.changed))
            better = known.get((node.reading, node.reference.request.radius_mm), plain)
            added = difference(changed, plain, better)
            log_ratio[(*node.place, node.reading)] = added.log_eta
            of_batches: Any = (slice(None), *node.place, node.reading)
            deviations[of_batches] = added.deviations
        return EffectResponse(plan.axes, log_ratio, deviations)

    def benches_with(
        self, effects: Sequence[Effect], values: Mapping[str, float]
    ) -> Iterator[tuple[SceneFile, dict[str, Value]]]:
        """Of every reading the scene with all effects, and its parameters' values.

        `values` are of the free parameters; the scale is no matter of the bench.
        """
        physical = [effect for effect in effects if effect.reading is None]
        for reading, values_of in zip(self._readings, configurations(self.campaign), strict=True):
            # without a liquid such effects do nothing, but their edits would change the scene
            idle = [
                effect
                for effect in physical
                if effect.name in reading.without or (effect.filled_only and not filled(values_of))
            ]
            scene = self.campaign.scene
            for effect in physical:
                scene = scene if effect in idle else _with_effect(scene, effect)
            free = _scene_for(scene, reading.of_beam).parameters.keys() - reading.parameters.keys()
            free -= {p.name for effect in idle for p in effect.parameters}
            if reading.of_beam:
                free -= {GAP_INDEX}
            moved = self._moved(reading, values)
            there = self._left(scene, values_of) | {n: v for n, v in moved.items() if n in free}
            for name in (ALPHA_SCAT, ALPHA_ABS):  # a sample may have its own
                if (of := self.campaign.parameter_of(reading, name)) != name:
                    there[name] = values[of]
            for effect in physical:
                if effect.number is not None and effect.number.is_of(there):
                    sizes = {p.name: values.get(p.name, 0.0) for p in effect.parameters}
                    there |= _as_scene_values(effect, there, sizes)
            yield scene, there

    def anchor(self, effects: Sequence[Effect], values: Mapping[str, float]) -> Anchor:
        """All effects at once, simulated at values of the free parameters, the scale left out."""
        points, wanted = [], []
        benches = self.benches_with(effects, values)
        for reading, (scene, there), own in zip(
            self._readings, benches, self._photons, strict=True
        ):
            points.append(there)
            most = min(ANCHOR_FACTOR * own, _MOST_PHOTONS)
            run = self._simulation(scene, there, most, of_beam=reading.of_beam)
            wanted.append(run.table(coarse=False))
        tables = self.schedule.tables(wanted)
        self.schedule.rest_on(" ".join((_PLAIN, *(effect.name for effect in effects))), wanted)
        log_eta, deviations = stack([tables[table.number] for table in wanted])
        scattering = [float(there[ALPHA_SCAT]) for there in points]
        absorption = [float(there[ALPHA_ABS]) for there in points]
        point = Point.of(self.grid, scattering, absorption)
        return Anchor(
            effects=frozenset([*(effect.name for effect in effects), *self.campaign.parameters]),
            values=dict(values),
            log_eta=point.value(log_eta),
            deviations=point.values(deviations),
        )

    def is_exact(self, effects: Sequence[Effect]) -> bool:
        """Whether what responses make of effects together is exact, and not interpolated."""
        physical = [effect for effect in effects if effect.reading is None]
        return not self._further_parameters() and (
            not physical
            or (len(physical) == 1 and (self._weighs(physical[0]) or not physical[0].parameters))
        )

    def _further_parameters(self) -> list[str]:
        """Fitted scene parameters that no effect brings."""
        of_effects = {p.name for effect in self.campaign.switched_on for p in effect.parameters}
        return [
            name
            for name, known in self.campaign.parameters.items()
            if not known.fixed
            and name in self.campaign.values
            and name not in (ALPHA_SCAT, ALPHA_ABS)
            and name not in of_effects
        ]

    def _weighs(self, effect: Effect) -> bool:
        """Whether an effect is predicted by weighting photon records."""
        if not _weighs_in(self.campaign.scene, effect):
            return False
        # a mask cannot be taken off records that were made with it
        return (effect.weight or effect.colours) is not None and (
            self._open_mask or effect.mask_column == "mask_radius_mm"
        )

    def _moved(self, row: Reading, values: Mapping[str, float]) -> dict[str, float]:
        """Values of an effect, those tied to them too, without what a row has of its own."""
        ties = self.campaign.ties.items()
        moved = {**values, **{name: values[of] for name, of in ties if of in values}}
        return {name: value for name, value in moved.items() if name not in row.parameters}

    def _is_seen(self, effect: Effect, run: PlannedRun, row: Reading) -> bool:
        """Whether a reading can see an effect at all."""
        if effect.name in row.without:
            return False
        if effect.number is not None:
            return effect.number.is_of(run.parameters)
        if effect.filled_only and not filled(run.parameters):
            return False
        if effect.lacks is not None and not effect.acts_in(run.base.with_overrides(run.overrides)):
            return False
        if effect.of_beam:
            return self._at_own_acceptance(run)
        if effect.name in self._further_parameters():
            known = self._moved(row, {effect.name: 0.0}).keys() & run.parameters.keys()
            return bool(known) and not (effect.name == GAP_INDEX and run.of_beam)
        if not run.of_beam:
            return True
        # a beam sees what changes in its scene, where only the crystal is left of the bench
        before = _beam_of(self.campaign.scene)
        with_effect = self.campaign.scene
        if effect.edit is not None:
            with_effect = _with_effect(with_effect, effect)
        if with_effect is self.campaign.scene:  # which has it, or its parameters
            return any(p.name in before.parameters for p in effect.parameters)
        return before.content_hash != _beam_of(with_effect).content_hash

    def _at_own_acceptance(self, run: PlannedRun) -> bool:
        """Whether it is of a beam with the campaign's acceptance: others say what theirs is."""
        return run.of_beam and run.parameters[ACCEPTANCE] == self.campaign.values[ACCEPTANCE]

    def _left(self, scene: SceneFile, values: Mapping[str, Value]) -> dict[str, Value]:
        """A configuration's values without those that an effect in the scene sets itself."""
        before = self.campaign.scene.parameters
        return {
            name: value
            for name, value in values.items()
            if name not in before or scene.parameters.get(name) == before[name]
        }

    def _closed_form(self, label: str, run: PlannedRun) -> tuple[EtaGrid, EtaGrid] | None:
        """Fine and coarse tables of a transmittance where its closed form holds."""
        assert run.radius_mm is not None  # of every beam
        scene = run.base.with_overrides(run.overrides)
        slab = polished_slab(scene)
        if slab is None or scattered_share(slab[0], run.radius_mm) > _CLOSED_FORM_SHARE:
            self._ways[label] = "the beam is simulated"
            return None
        self._ways[label] = "the closed form, the crystal being polished as it is"
        n, length = slab

        def table(grid: Grid) -> EtaGrid:
            alpha_scat, alpha_abs = grid.coefficients_per_cm()
            internal = transmittance(alpha_scat + alpha_abs, length)
            log_t = np.log(measured_transmittance(internal, n))
            return EtaGrid(log_t, np.zeros((BATCHES, *log_t.shape), dtype=np.float32))

        return table(self.grid), table(self._coarse)

    def _refuse_darkness(self, log_eta: NDArray[np.float64]) -> None:
        """Refuse tables, (readings, ...), without light."""
        dark = np.argwhere(~np.isfinite(log_eta))
        if not len(dark):
            return
        measurements = self.campaign.measurements
        reading = measurements.readings[dark[0][0]]
        problem = f"no light is detected in the configuration of {reading.label}"
        raise measurements.refusal(reading, None, problem, "check its parameters")


def _lit(table: EtaGrid, wanted: WantedTable) -> EtaGrid:
    """A table; of light of which no photon arrives, as behind ground faces, of fewer than one."""
    dark = ~np.isfinite(table.log_eta)
    if not dark.any():
        return table
    log_eta = np.where(dark, -math.log(wanted.run.photons), table.log_eta)
    return EtaGrid(log_eta, np.where(dark, np.float32(0.0), table.deviations))


def _units(photons: float) -> int:
    """Photons in `LANES`, one at least, as many as memory holds at most."""
    return min(max(round(photons / LANES), 1), _MOST_PHOTONS // LANES)


def configurations(campaign: Campaign) -> list[dict[str, Value]]:
    """Scene parameters of every reading, fitted effects absent and others at their start."""
    held = {n: known.start for n, known in campaign.parameters.items() if known.fixed}
    absent = {
        # a scene has no infinite numbers, but one that is as good
        p.name: min(p.absent, _AS_GOOD_AS_INFINITE)
        for effect in campaign.switched_on
        for p in effect.parameters
        if p.nominal is None and p.absent is not None
    }
    of_readings = []
    alike = {**campaign.values, **held}
    alike |= {name: alike[of] for name, of in campaign.ties.items()}
    for reading in campaign.measurements.readings:
        values = {**alike, **reading.parameters}
        values |= {n: v for n, v in absent.items() if n in values}
        known = _scene_for(campaign.scene, reading.of_beam).parameters
        # in the beam there is air where the bench has a liquid
        values |= {n: known[n] for n in (GAP_INDEX,) if reading.of_beam and n in known}
        of_readings.append({n: v for n, v in values.items() if n in known})
    return of_readings


_beam_of = functools.lru_cache(maxsize=64)(spectrophotometer_of)


def _scene_for(scene: SceneFile, of_beam: bool) -> SceneFile:
    """The scene itself, or that of a beam through its crystal."""
    return _beam_of(scene) if of_beam else scene


@functools.lru_cache(maxsize=128)
def _with_effect(scene: SceneFile, effect: Effect) -> SceneFile:
    """The scene with an effect in it, where it is not there yet, or is written there at all."""
    if effect.number is not None:
        return scene
    names = [p.name for p in effect.parameters]
    if effect.is_in(scene) or (names and all(name in scene.parameters for name in names)):
        return scene
    return scene.edited(add(effect, scene))


@functools.lru_cache(maxsize=128)
def _weighs_in(scene: SceneFile, effect: Effect) -> bool:
    """Whether a weight holds in a scene; every node of every reading asks."""
    return effect.weighs_in is None or effect.weighs_in(scene)


@functools.lru_cache(maxsize=64)
def _usual(scene: SceneFile) -> SceneFile:
    """With usual coefficients: records answer all, so scenes that differ in these only are one."""
    refuse_shared_coefficients(scene)
    usual = {ALPHA_SCAT: USUAL_ALPHA_SCAT_PER_CM, ALPHA_ABS: USUAL_ALPHA_ABS_PER_CM}
    return scene.with_overrides(usual)


def _axis(
    parameter: EffectParameter,
    own: Mapping[str, Value],
    configurations: Sequence[Mapping[str, Value]],
    few: bool = False,
) -> Axis:
    """Nodes of a parameter, drawn in where a configuration's bench does not take all of them.

    For a first look every other one on either side of the absence is enough, with the farthest.
    """
    nominal = float(own[parameter.nominal]) if parameter.nominal else 0.0
    absent = [] if parameter.absent is None else [0.0 if parameter.nominal else parameter.absent]
    nodes = list(parameter.nodes)
    if few and len(nodes) > 2:
        if absent:
            lower = [node for node in nodes if node < absent[0]]
            upper = [node for node in nodes if node > absent[0]]
            nodes = lower[::2] + upper[::-1][::2][::-1]
        else:
            nodes = [*nodes[:-1:2], nodes[-1]]
    if parameter.limits is not None:
        lows, highs = zip(*(parameter.limits(values) for values in configurations), strict=True)
        low, high = max(lows), min(highs)
        below = max([1.0, *(node / low for node in nodes if node < low < 0)])
        above = max([1.0, *(node / high for node in nodes if node > high > 0)])
        nodes = [node / (below if node < 0 else above) for node in nodes]
    return Axis(parameter, [*absent, *nodes], nominal)


def _near(axis: Axis, sizes: Sizes) -> set[tuple[int]]:
    """Places on an axis between two sizes, and next to them on either side."""
    values = np.array(axis.values) + axis.nominal
    low = values[values < sizes[0]].max(initial=-math.inf)
    high = values[values > sizes[1]].min(initial=math.inf)
    return {(int(place),) for place in np.flatnonzero((low <= values) & (values <= high))}


def _toward_plausible(axis: Axis, parts: Sequence[float]) -> Axis:
    """An axis with the nodes nearest to parts of the way from the absence to plausible ends."""
    parameter, nodes = axis.parameter, np.array(axis.values)
    x = parameter.coordinates_of(nodes)
    origin, *ends = parameter.coordinates_of(np.array([nodes[0], *parameter.plausible]))
    of_sides = [(x - origin) * (end - origin) > 0.0 for end in ends]
    wanted = [
        int(np.flatnonzero(side)[np.abs(x[side] - origin - part * (end - origin)).argmin()])
        for side, end in zip(of_sides, ends, strict=True)
        for part in parts
        if side.any()
    ]
    absent = [] if parameter.absent is None else [0]
    return Axis(parameter, nodes[[*absent, *sorted(set(wanted))]].tolist(), axis.nominal)


def _as_scene_values(
    effect: Effect, values_of: Mapping[str, Value], values: Mapping[str, float]
) -> dict[str, Value]:
    """Values of an effect's parameters as a configuration's scene takes them."""
    number = effect.number
    if number is None:
        return dict(values)
    return {number.parameter: float(values_of[number.parameter]) + sum(values.values())}


def _nodes(axes: Sequence[Axis]) -> Iterator[tuple[tuple[int, ...], dict[str, float]]]:
    """Places in some axes at which the effect is there, and its parameters' values."""
    for place in np.ndindex(*(len(axis.values) for axis in axes)):
        at = list(zip(place, axes, strict=True))
        # an axis begins with the value at which the effect is not there, if it has one
        if not any(i == 0 and axis.parameter.absent is not None for i, axis in at):
            yield place, {axis.name: axis.nominal + axis.values[i] for i, axis in at}


def _as_effect(campaign: Campaign, name: str) -> Effect:
    """A fitted scene parameter as an effect, absent at the scene's value; acceptance by angle."""
    known, own = campaign.parameters[name], float(campaign.values[name])
    low, high = known.minimum, known.maximum
    if not (math.isfinite(low) and math.isfinite(high)):
        problem = f"{name} has the range {low:g}..{high:g}"
        mend = "give a finite min and a larger finite max: it is simulated between them"
        raise InputError(problem, mend, path=campaign.path)
    treated = [campaign.catalogue[effect] for effect in campaign.treatments]
    size = next((p for e in treated for p in e.parameters if p.name == name), None)
    if size is not None:
        nodes = np.array([node for node in size.nodes if low < node < high])
    elif name == ACCEPTANCE:
        first, last = np.log1p(np.array([low, high]) / _ACCEPTANCE_SCALE_DEG)
        nodes = _ACCEPTANCE_SCALE_DEG * np.expm1(chebyshev_nodes(first, last, _ACCEPTANCE_NODES))
    else:
        nodes = chebyshev_nodes(low, high, _SCENE_NODES)
    # rounding takes the first or the last beyond its end
    nodes = np.clip(nodes, low, high)
    # the scene's value stands in for the nearest of them
    nodes = np.delete(nodes, np.abs(nodes - own).argsort()[:1])
    if size is not None:
        nodes = np.array(sorted({low, *nodes, high} - {own}))
    fields: dict[str, Any] = {"minimum": low, "maximum": high, "plausible": (low, high)}
    fields |= {"start": known.start, "absent": own, "nodes": tuple(map(float, nodes))}
    if name == ACCEPTANCE:
        (parameter,) = FORWARD_BEAM.parameters
        fields |= {"nominal": None, "scale": _ACCEPTANCE_SCALE_DEG, "limits": None}
        return replace(FORWARD_BEAM, name=name, parameters=(replace(parameter, **fields),))
    parameter = (
        EffectParameter(name=name, unit="", meaning="a parameter of the scene", **fields)
        if size is None
        # its nodes were chosen about an absent value, which a polynomial through them needs
        else replace(size, kinked=True, **fields)
    )
    # nothing to be written into the scene: it has the parameter
    return Effect(name, name, "", "", parameters=(parameter,), edit=lambda editor: None)
