"""Responses of a campaign's readings to physical effects: from the cache, else simulated.

Every configuration is simulated once as it is, with a mask that covers nothing: what its photons
met answers every smaller aperture, and every effect that only weights photons. Other effects are
simulated at their nodes. All runs draw the same random numbers, so that what they have in common
cancels, and batches of one number belong together.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, filled, modules_of
from mcrim_mitsuba.effects.surroundings import FORWARD_BEAM
from mcrim_mitsuba.efficiency.eta_grid import (
    BATCHES,
    EtaGrid,
    Grid,
    TableRequest,
    TableUnit,
    averaged,
    difference,
    table_of,
)
from mcrim_mitsuba.efficiency.proposals import choose_proposals
from mcrim_mitsuba.efficiency.responses import Anchor, Axis, EffectResponse, Point, Responses, stack
from mcrim_mitsuba.efficiency.surface import chebyshev_nodes
from mcrim_mitsuba.optics.slab_transmittance import measured_transmittance, transmittance
from mcrim_mitsuba.runs.cache import code_hash, record_versions
from mcrim_mitsuba.runs.executors import Job, current_executor, many_units_executor, number_of
from mcrim_mitsuba.scene.scene_file import SceneFile, ScenePlan
from mcrim_mitsuba.scene.spectrophotometer import (
    ACCEPTANCE,
    BEAM_AXIS,
    GAP_INDEX,
    scattered_share,
    spectrophotometer_of,
)
from mcrim_mitsuba.transport.launch_plan import LANES, ScatteringProposals

#: Photons of a simulation with an effect in the scene, and how many times as many of a
#: configuration as it is: all effects are compared with it.
EFFECT_PHOTONS, PLAIN_FACTOR = 16 * LANES, 4
#: Part of an effect's photons that a first look takes.
LOOK_PART = 1 / 8
#: The same for all effects at once where a fit ends.
ANCHOR_FACTOR = 2
#: Most photons of one simulation: its records are held in memory.
_MOST_PHOTONS = 512 * LANES
#: alpha_scat around which the usual proposals lie, and a usual alpha_abs, 1/cm.
USUAL_ALPHA_SCAT_PER_CM, USUAL_ALPHA_ABS_PER_CM = 0.5, 0.04
#: Proposals, and their shares: nearly as good as one of its own for 0.2 to 1 /cm, and a half as
#: good over the whole range. In 1/16, not 1/64: a quarter of the lanes, which follow four times as
#: many photons each, wait less for each other, and a simulation takes a fifth to a third less time.
_PROPOSALS_PER_CM = (0.05, 0.12, 0.25, 0.45, 0.8, 1.4, 2.5, 4.5)
_SHARES = (1, 2, 3, 3, 3, 2, 1, 1)
_RANGE_PER_CM = (0.05, 5.0)
#: The same where transmittances are among the readings.
_BEAM_RANGE_PER_CM = 0.002, 5.0
_BEAM_PROPOSALS_PER_CM = (0.003, 0.012, 0.04, 0.12, 0.3, 0.6, 1.3, 3.5)
_BEAM_SHARES = (2, 2, 2, 2, 3, 2, 2, 1)
#: Ends of the range where a fit goes beyond these: as far as eta is ever worked out.
_WIDE_RANGE_PER_CM = (0.0005, 10.0)
#: Part of `_RANGE_PER_CM` where a campaign's start may lie.
_STARTS_PER_CM = (0.15, 1.7)
_ABSORPTION_PER_CM = (0.003, 0.15)
#: How far below an absorption that is asked for the grid reaches, and its outermost ends, 1/cm.
_LEAST_REACH, _LEAST_ABSORPTION_PER_CM, _MOST_ABSORPTION_PER_CM = 3.0, 1e-3, 2.0
#: Scene parameter that is the radius of the hole in a mask, and a radius (in window widths) that
#: leaves all of a square window open.
APERTURE, WINDOW, _OPEN = "aperture_radius_mm", "window_width_mm", 2.0
#: Nodes of a fitted acceptance, and where, in degrees, its logarithm takes over from itself.
_ACCEPTANCE_NODES, _ACCEPTANCE_SCALE_DEG = 7, 2.0
#: Stands for infinity in a scene.
_AS_GOOD_AS_INFINITE = 1e9
#: Half angle that takes all that leaves a face.
_HALF_SPACE_DEG = 90.0
#: Pieces of a band of light, each with as much of it.
_MOST_COLOURS = 24
#: Number of what a chunk holds; another layout gets another one.
_LAYOUT = 2
#: Part of once scattered light that a beam's detector may take where the closed form of the
#: transmittance is used: it is then right to 0.05 % for mean free paths of 2 cm.
_CLOSED_FORM_SHARE = 1e-3
#: Nodes of a fitted scene parameter that is no effect's, its own value included.
_SCENE_NODES = 5


#: Of a simulation: scene, what differs from it, photons.
_Identity = tuple[str, str, int]
#: Key of the simulations of the bench as it is; all effects at once have theirs behind it.
_PLAIN = ""


@dataclass(frozen=True)
class _Simulation:
    """One simulation, as one reading sees it."""

    base: SceneFile
    #: What differs from it.
    overrides: Mapping[str, Value]
    #: Of the configuration as the readings name it.
    parameters: Mapping[str, Value]
    #: The mask's radius, to be cut out of the records; None: the scene is run as it is.
    radius_mm: float | None
    photons: int
    check: bool = False
    #: Whether it is of a spectrophotometer; `radius_mm` is then its acceptance in degrees.
    of_beam: bool = False

    @functools.cached_property
    def identity(self) -> _Identity:
        """What tells simulations apart; one may serve several masks."""
        overrides = json.dumps(self.overrides, sort_keys=True)
        return self.base.content_hash, overrides, self.photons

    def table(
        self,
        *,
        coarse: bool = True,
        effect: Effect | None = None,
        values: Mapping[str, float] | None = None,
    ) -> _Wanted:
        """A table of eta that is wanted of it: of its records, weighted by an effect or not.

        The number of its chunk in the cache is made of all that it depends on.
        """
        identity: list[object] = [*self.identity, self.radius_mm, coarse]
        if effect is not None:
            known = self.parameters.items()
            parameters = {n: v for n, v in known if n not in (ALPHA_SCAT, ALPHA_ABS)}
            code = code_hash(modules_of([effect]))
            identity += [effect.name, code, dict(values or {}), parameters]
        number = number_of(*identity)
        request = TableRequest(
            number, coarse, self.radius_mm, effect, values or {}, self.parameters, self.of_beam
        )
        return _Wanted(self, number, request)


class _Wanted(NamedTuple):
    """A table, of which simulation."""

    simulation: _Simulation
    number: int
    request: TableRequest


def _not_dark(table: EtaGrid, photons: int) -> EtaGrid:
    """A beam of which no photon arrives, as behind ground faces, has fewer than one of them."""
    dark = ~np.isfinite(table.log_eta)
    log_eta = np.where(dark, -math.log(photons), table.log_eta)
    return EtaGrid(log_eta, np.where(dark, np.float32(0.0), table.deviations))


def _within(wanted: _Wanted, angle_deg: float) -> _Wanted:
    """The same table of a beam's light within another half angle."""
    run, of = replace(wanted.simulation, radius_mm=angle_deg), wanted.request
    return run.table(coarse=of.coarse, effect=of.effect, values=of.values)


#: By the place in an effect's response, its nodes and the reading: the table of the bench as it
#: is, from as many photons, and the one with the effect. Nothing where the effect is not there.
_Pairs = dict[tuple[int, ...], tuple[_Wanted, _Wanted]]


class Beyond(NamedTuple):
    """At which ends of the usual range of alpha_scat a fit goes beyond it."""

    low: bool = False
    high: bool = False


_WITHIN = Beyond()


class ResponseMaker:
    """Makes the responses of a campaign's readings, effect by effect.

    The photons of `run` are those of a simulation with an effect in the scene; those as the bench
    is get `PLAIN_FACTOR` times as many. Its precision does not matter. `what` is its name in
    progress. The range of alpha_scat goes on beyond the usual lower or higher end where a fit does.
    """

    def __init__(
        self, campaign: Campaign, run: Run, what: str = "simulation", *, beyond: Beyond = _WITHIN
    ) -> None:
        self.campaign, self._what = campaign, what
        units = min(max(round(run.photons_or(EFFECT_PHOTONS) / LANES), 1), _MOST_PHOTONS // LANES)
        self._effect_photons = units * LANES
        self._look_photons = max(round(LOOK_PART * units), 1) * LANES
        self._plain_photons = min(PLAIN_FACTOR * units * LANES, _MOST_PHOTONS)
        self._run = run
        self.grid, self.coarse, self._proposals = _coverage(campaign, beyond)
        self._open_mask = _has_open_mask(campaign.scene)
        light = campaign.spectrum
        self._colours = None if light is None else light.colours(_MOST_COLOURS)
        self._made: dict[int, EtaGrid] = {}
        # simulations that responses rest on, by effect, and those that the cache had
        self._rests_on: dict[str, set[_Identity]] = {}
        self._seen: dict[_Identity, bool] = {}
        self._cache = current_executor().cache(
            {
                "what": "eta tables",
                "seed": run.seed,
                "proposals": asdict(self._proposals),
                "grids": [asdict(self.grid), asdict(self.coarse)],
                "versions": record_versions(run.variant, TableUnit.__module__),
                "layout": _LAYOUT,
            }
        )
        # how transmittances were found
        self._said: list[str] = []

    @property
    def photons(self) -> int:
        """That responses rest on: not those of a first look where there was a second one."""
        return sum(photons for *_, photons in self._used)

    @property
    def cached_photons(self) -> int:
        """Those of them that the cache had."""
        return sum(each[2] for each in self._used if self._seen[each])

    @property
    def _used(self) -> set[_Identity]:
        return set[_Identity]().union(*self._rests_on.values())

    @property
    def notes(self) -> list[str]:
        """What the user must know of the cache."""
        return list(self._cache.notes)

    @property
    def said(self) -> list[str]:
        """How transmittances were found, by a closed form or not."""
        return list(dict.fromkeys(self._said))

    # ---- simulations of the readings -----------------------------------------------------------

    def _simulation(
        self,
        scene: SceneFile,
        values: Mapping[str, Value],
        photons: int,
        *,
        of_beam: bool,
        check: bool = False,
    ) -> _Simulation:
        """A run of a scene, or of its crystal's transmittance, at a configuration's values."""
        scene = _seen(scene, of_beam)
        named = {n: v for n, v in values.items() if n not in (ALPHA_SCAT, ALPHA_ABS)}
        radius = None
        if of_beam:
            radius = float(named[ACCEPTANCE])
            named[ACCEPTANCE] = _HALF_SPACE_DEG
        elif self._open_mask and _has_open_mask(scene):
            radius = float(named[APERTURE])
            named[APERTURE] = _OPEN * float(named[WINDOW])
        overrides = {n: v for n, v in named.items() if n in scene.parameters}
        return _Simulation(_usual(scene), overrides, values, radius, photons, check, of_beam)

    # ---- responses ---------------------------------------------------------------------------

    def make(self, effects: Sequence[Effect], look: Collection[str] = ()) -> Responses:
        """Simulated responses of the campaign's bench, as it is and with each of the effects.

        Effects that change no light, but how readings are read, need no simulation and are left
        out. Those named by `look` get a part of the photons, for a first look. Raises InputError if
        a scene is not sound, leaks, or cannot take an effect.
        """
        scene = self.campaign.scene
        # one without parameters that the scene has already is in all its simulations
        asked = [
            effect
            for effect in effects
            if effect.reading is None and (effect.parameters or not effect.is_in(scene))
        ]
        asked += [_as_effect(self.campaign, name) for name in self._further_parameters()]
        plain, plain_looks, closed = [], [], []
        for row, values in enumerate(configurations(self.campaign)):
            of_beam = self.campaign.measurements.readings[row].of_beam
            run = self._simulation(
                scene, values, self._plain_photons, of_beam=of_beam, check=self._run.check
            )
            closed.append(self._closed_form(row, run) if of_beam else None)
            plain_looks.append(replace(run, photons=self._effect_photons, check=False))
            plain.append(run if closed[-1] is None else plain_looks[-1])
        # where a model may change the acceptance, every effect's response depends on it
        acceptance = next((p for e in asked if e.of_beam for p in e.parameters), None)
        plans = [
            self._plan(effect, plain_looks, acceptance, is_look=True)
            if effect.name in look
            else self._plan(effect, plain, acceptance, is_look=False)
            for effect in asked
        ]
        of_effects = (each for _, pairs in plans for pair in pairs.values() for each in pair)
        of_photons = [
            (run.table(coarse=False), run.table()) if known is None else ()
            for run, known in zip(plain, closed, strict=True)
        ]
        wanted = [each for pair in of_photons for each in pair]
        tables = self._tables([*wanted, *of_effects])
        self._rest_on(_PLAIN, wanted)
        for effect, (_, pairs) in zip(asked, plans, strict=True):
            self._rest_on(effect.name, [each for pair in pairs.values() for each in pair])
        benches = [
            known or tuple(tables[each.number] for each in pair)
            for known, pair in zip(closed, of_photons, strict=True)
        ]
        log_eta, deviations = stack([fine for fine, _ in benches])
        coarse = [each for _, each in benches]
        self._refuse_darkness(log_eta, 0)
        responses = {
            effect.name: self._response(effect, axes, pairs, tables, plain, coarse)
            for effect, (axes, pairs) in zip(asked, plans, strict=True)
        }
        return Responses(self.grid, self.coarse, log_eta, deviations, responses, self.photons)

    def anchor(self, effects: Sequence[Effect], values: Mapping[str, float]) -> Anchor:
        """All effects at once, simulated at values of the free parameters, the scale left out."""
        physical = [effect for effect in effects if effect.reading is None]
        photons = min(ANCHOR_FACTOR * self._effect_photons, _MOST_PHOTONS)
        readings = self.campaign.measurements.readings
        named, runs = [], []
        for reading, own in zip(readings, configurations(self.campaign), strict=True):
            # without a liquid such effects do nothing, but their edits would change the scene
            idle = [each for each in physical if each.filled_only and not filled(own)]
            scene = self.campaign.scene
            for effect in physical:
                scene = scene if effect in idle else _with_effect(scene, effect)
            free = _seen(scene, reading.of_beam).parameters.keys() - reading.parameters.keys()
            free -= {p.name for effect in idle for p in effect.parameters}
            if reading.of_beam:
                free -= {GAP_INDEX}
            there = {**self._left(scene, own), **{n: v for n, v in values.items() if n in free}}
            for name in (ALPHA_SCAT, ALPHA_ABS):  # a sample may have its own
                if (of := self.campaign.parameter_of(reading, name)) != name:
                    there[name] = values[of]
            named.append(there)
            run = self._simulation(scene, there, photons, of_beam=reading.of_beam)
            runs.append(run.table(coarse=False))
        tables = self._tables(runs)
        self._rest_on(" ".join((_PLAIN, *(effect.name for effect in effects))), runs)
        log_eta, deviations = stack([tables[wanted.number] for wanted in runs])
        scattering, absorption = (
            [float(own[name]) for own in named] for name in (ALPHA_SCAT, ALPHA_ABS)
        )
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
        # a mask cannot be taken off records that were made with it
        return (effect.weight or effect.colours) is not None and (
            self._open_mask or effect.mask_column == "mask_radius_mm"
        )

    def _is_seen(self, effect: Effect, with_effect: SceneFile, run: _Simulation) -> bool:
        """Whether a reading can see an effect at all."""
        if effect.filled_only and not filled(run.parameters):
            return False
        if effect.of_beam:
            return self._at_own_acceptance(run)
        if effect.name in self._further_parameters():
            return effect.name in run.parameters and not (effect.name == GAP_INDEX and run.of_beam)
        if not run.of_beam:
            return True
        # a beam sees what changes in its scene, where only the crystal is left of the bench
        before = _beam_of(self.campaign.scene)
        if with_effect is self.campaign.scene:  # which has it, or its parameters
            return any(p.name in before.parameters for p in effect.parameters)
        return before.content_hash != _beam_of(with_effect).content_hash

    def _at_own_acceptance(self, run: _Simulation) -> bool:
        """Whether it is of a beam with the campaign's acceptance: others say what theirs is."""
        return run.of_beam and run.parameters[ACCEPTANCE] == self.campaign.values[ACCEPTANCE]

    def _left(self, scene: SceneFile, values: Mapping[str, Value]) -> dict[str, Value]:
        """A configuration's values without those that an effect in the scene sets itself."""
        own = self.campaign.scene.parameters
        return {
            name: value
            for name, value in values.items()
            if name not in own or scene.parameters.get(name) == own[name]
        }

    def _plan(
        self,
        effect: Effect,
        plain: Sequence[_Simulation],
        acceptance: EffectParameter | None,
        *,
        is_look: bool,
    ) -> tuple[tuple[Axis, ...], _Pairs]:
        """Nodes of an effect, and the tables that its response is made of.

        The nodes of `acceptance` come last, if a beam sees the effect.
        """
        photons = self._look_photons if is_look else self._effect_photons
        scene = self.campaign.scene
        benches = [{**self.campaign.values, **run.parameters} for run in plain]
        weighs = self._weighs(effect)
        few = is_look and (not weighs or effect.proposal is not None)
        axes = tuple(
            _axis(parameter, self.campaign.values, benches, few) for parameter in effect.parameters
        )
        with_effect = scene
        if effect.edit is not None and (not weighs or any(run.of_beam for run in plain)):
            with_effect = _with_effect(scene, effect)
        if not weighs or effect.proposal is not None:
            scene = _with_effect(scene, effect)
        seen = [row for row, run in enumerate(plain) if self._is_seen(effect, with_effect, run)]
        # half angles at which beams see the effect; None: each at its own
        further: Axis | None = None
        angles: Sequence[float | None] = [None]
        in_beams = not effect.of_beam and any(plain[row].of_beam for row in seen)
        if acceptance is not None and in_beams:
            further = _axis(acceptance, self.campaign.values, benches)
            angles = [further.nominal + value for value in further.values]
        pairs: _Pairs = {}
        nodes = list(np.ndindex(*(len(axis.values) for axis in axes)))
        for row in seen:
            run = plain[row]
            own, reference = run, run.table()
            if weighs and effect.proposal is not None:
                values = {**run.parameters, **effect.proposal}
                own = self._simulation(scene, values, photons, of_beam=run.of_beam)
                # its own run without the effect: what is common to both cancels
                absent = {p.name: p.absent for p in effect.parameters if p.absent is not None}
                reference = own.table(effect=effect, values=absent)
            elif not weighs:
                reference = replace(run, photons=photons, check=False).table()
            if effect.of_beam:  # it weighs all that leaves the crystal
                own = replace(run, radius_mm=_HALF_SPACE_DEG)
            for node in nodes:
                # an axis begins with the value at which the effect is not there, if it has one
                if any(
                    i == 0 and a.parameter.absent is not None
                    for i, a in zip(node, axes, strict=True)
                ):
                    continue
                there = {a.name: a.nominal + a.values[i] for i, a in zip(node, axes, strict=True)}
                if weighs:
                    wanted = own.table(effect=effect, values=there)
                else:
                    values = {**self._left(scene, run.parameters), **there}
                    wanted = self._simulation(scene, values, photons, of_beam=run.of_beam).table()
                for i, angle in enumerate(angles):
                    place = (*node, row) if angle is None else (*node, i, row)
                    if angle is None or not self._at_own_acceptance(run):
                        pairs[place] = reference, wanted
                    else:
                        pairs[place] = _within(reference, angle), _within(wanted, angle)
        return axes if further is None else (*axes, further), pairs

    def _response(
        self,
        effect: Effect,
        axes: tuple[Axis, ...],
        pairs: _Pairs,
        tables: Mapping[int, EtaGrid],
        plain: Sequence[_Simulation],
        known: Sequence[EtaGrid],
    ) -> EffectResponse:
        """An effect's tables over those of the bench as it is."""
        readings = len(self.campaign.measurements.readings)
        shape = (*(len(axis.values) for axis in axes), readings, *self.coarse.counts)
        log_ratio = np.zeros(shape)
        deviations = np.zeros((BATCHES, *shape), dtype=np.float32)
        for place, (reference, wanted) in pairs.items():
            before, row = tables[reference.number], place[-1]
            better = known[row]
            # of a beam within another angle nothing better is known
            if reference.request.radius_mm != plain[row].radius_mm:
                better = before
            changed = tables[wanted.number]
            if self.campaign.measurements.readings[row].of_beam:
                changed = _not_dark(changed, wanted.simulation.photons)
            made = difference(changed, before, better)
            log_ratio[place] = made.log_eta
            of_batches: Any = (slice(None), *place)
            deviations[of_batches] = made.deviations
        self._refuse_darkness(log_ratio, len(axes), f" with {effect.name}")
        return EffectResponse(axes, log_ratio, deviations)

    def _closed_form(self, row: int, run: _Simulation) -> tuple[EtaGrid, EtaGrid] | None:
        """Fine and coarse tables of a transmittance where its closed form holds."""
        label = self.campaign.measurements.readings[row].label
        assert run.radius_mm is not None  # of every beam
        scene = run.base.with_overrides(run.overrides)
        share = scattered_share(scene, run.radius_mm)
        if share is None or share > _CLOSED_FORM_SHARE:
            self._said.append(f"{label}: the beam is simulated")
            return None
        self._said.append(f"{label}: the closed form, the crystal being polished as it is")
        axis = str(scene.parameters[BEAM_AXIS])
        length = float(scene.parameters[f"crystal_{'height' if axis == 'z' else 'width'}_mm"])

        def table(grid: Grid) -> EtaGrid:
            alpha_scat, alpha_abs = grid.coefficients_per_cm()
            internal = transmittance(alpha_scat + alpha_abs, length)
            log_t = np.log(measured_transmittance(internal, float(scene.parameters["n_crystal"])))
            return EtaGrid(log_t, np.zeros((BATCHES, *log_t.shape), dtype=np.float32))

        return table(self.grid), table(self.coarse)

    def _refuse_darkness(self, log_eta: NDArray[np.float64], axis: int, beyond: str = "") -> None:
        """Refuse tables without light; `axis` is that of the readings."""
        dark = np.argwhere(~np.isfinite(log_eta))
        if not len(dark):
            return
        measurements = self.campaign.measurements
        reading = measurements.readings[dark[0][axis]]
        problem = f"no light is detected in the configuration of {reading.label}{beyond}"
        raise measurements.refusal(reading, None, problem, "check its parameters")

    # ---- simulation --------------------------------------------------------------------------

    def _of_light(self, table: EtaGrid, grid: Grid) -> EtaGrid:
        """A table averaged over the light's wavelengths, where the campaign has a spectrum."""
        return table if self._colours is None else averaged(table, grid, self._colours)

    def _rest_on(self, what: str, wanted: Sequence[_Wanted]) -> None:
        """Keep what something rests on, in place of what it rested on before."""
        self._rests_on[what] = {each.simulation.identity for each in wanted}

    def _tables(self, wanted: Sequence[_Wanted]) -> Mapping[int, EtaGrid]:
        """The wanted tables by number; those of one simulation are made together."""
        # what the cache has is asked for too: parts of an array job must see the same units
        missing: dict[tuple[str, str, int], dict[int, _Wanted]] = {}
        for each in wanted:
            if each.number not in self._made:
                missing.setdefault(each.simulation.identity, {})[each.number] = each
        # the first of every scene before all others: processes compile unlike kernels then
        first = {of[0]: of for of in reversed(missing)}.values()
        ordered = sorted(missing, key=lambda of: of not in first)
        groups = [list(missing[of].values()) for of in ordered]
        jobs = []
        for members in groups:
            of = members[0].simulation
            unit = TableUnit(
                self._what,
                ScenePlan(of.base, of.overrides),
                self._run.seed,
                self._run.variant,
                not any(each.simulation.check for each in members),
                self._proposals,
                of.photons,
                (self.grid, self.coarse),
                tuple(each.request for each in members),
            )
            jobs.append(Job(unit, self._cache))
        errors: list[float] = []

        def report(what: str, done: int, total: int, note: str = "") -> None:
            worst = f", errors up to {100 * max(errors):.2g} %" if errors else ""
            self._run.tell(what, done, total, f"{note}{worst}")

        executor = many_units_executor(self._run.threads)
        for done in executor.do(jobs, threads=self._run.threads, progress=report):
            self._seen.setdefault(groups[done.index][0].simulation.identity, done.cached)
            for each in groups[done.index]:
                grid = self.coarse if each.request.coarse else self.grid
                table = table_of(done.chunks[each.number].arrays, grid)
                if not each.request.of_beam:
                    table = self._of_light(table, grid)
                self._made[each.number] = table
                errors.append(table.usual_error)
        return self._made


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
    found = []
    for reading in campaign.measurements.readings:
        values = {**campaign.values, **held, **reading.parameters}
        values |= {n: v for n, v in absent.items() if n in values}
        known = _seen(campaign.scene, reading.of_beam).parameters
        # in the beam there is air where the bench has a liquid
        values |= {n: known[n] for n in (GAP_INDEX,) if reading.of_beam and n in known}
        found.append({n: v for n, v in values.items() if n in known})
    return found


_beam_of = functools.lru_cache(maxsize=64)(spectrophotometer_of)


def _seen(scene: SceneFile, of_beam: bool) -> SceneFile:
    """The scene itself, or that of a beam through its crystal."""
    return _beam_of(scene) if of_beam else scene


@functools.lru_cache(maxsize=128)
def _with_effect(scene: SceneFile, effect: Effect) -> SceneFile:
    """The scene with an effect in it, where it is not there yet."""
    names = [p.name for p in effect.parameters]
    if effect.is_in(scene) or (names and all(name in scene.parameters for name in names)):
        return scene
    return scene.edited(add(effect, scene))


@functools.lru_cache(maxsize=64)
def _usual(scene: SceneFile) -> SceneFile:
    """With usual coefficients: records answer all, so scenes that differ in these only are one."""
    usual = {ALPHA_SCAT: USUAL_ALPHA_SCAT_PER_CM, ALPHA_ABS: USUAL_ALPHA_ABS_PER_CM}
    return scene.with_overrides(usual)


def _axis(
    parameter: EffectParameter,
    own: Mapping[str, Value],
    configurations: Sequence[Mapping[str, Value]],
    few: bool = False,
) -> Axis:
    """Nodes of a parameter, drawn in where a configuration's bench does not take all of them.

    For a first look every other one is enough, where they lie on one side of the absence.
    """
    nominal = float(own[parameter.nominal]) if parameter.nominal else 0.0
    absent = [] if parameter.absent is None else [0.0 if parameter.nominal else parameter.absent]
    nodes = list(parameter.nodes)
    if few and len(nodes) > 2 and parameter.absent is not None and min(nodes) > parameter.absent:
        nodes = nodes[::-1][::2][::-1]
    if parameter.limits is not None:
        lows, highs = zip(*(parameter.limits(values) for values in configurations), strict=True)
        low, high = max(lows), min(highs)
        below = max([1.0, *(node / low for node in nodes if node < low < 0)])
        above = max([1.0, *(node / high for node in nodes if node > high > 0)])
        nodes = [node / (below if node < 0 else above) for node in nodes]
    return Axis(parameter, [*absent, *nodes], nominal)


def _as_effect(campaign: Campaign, name: str) -> Effect:
    """A fitted scene parameter as an effect that is absent at the scene's value."""
    known, own = campaign.parameters[name], float(campaign.values[name])
    if not (math.isfinite(known.minimum) and math.isfinite(known.maximum)):
        problem = f"{name} has the range {known.minimum:g}..{known.maximum:g}"
        mend = "give a finite min and a larger finite max: it is simulated between them"
        raise InputError(problem, mend, path=campaign.path)
    if name == ACCEPTANCE:
        return _acceptance_as_effect(campaign)
    nodes = chebyshev_nodes(known.minimum, known.maximum, _SCENE_NODES)
    # the scene's value stands in for the nearest of them
    nodes = np.delete(nodes, int(np.abs(nodes - own).argmin()))
    parameter = EffectParameter(
        name=name,
        unit="",
        meaning="a parameter of the scene",
        minimum=known.minimum,
        maximum=known.maximum,
        start=known.start,
        absent=own,
        plausible=(known.minimum, known.maximum),
        nodes=tuple(map(float, nodes)),
    )
    # nothing to be written into the scene: it has the parameter
    return Effect(name, name, "", "", parameters=(parameter,), edit=lambda editor: None)


def _acceptance_as_effect(campaign: Campaign) -> Effect:
    """The fitted acceptance of a spectrophotometer, by the half angle itself."""
    known, own = campaign.parameters[ACCEPTANCE], float(campaign.values[ACCEPTANCE])
    scale = _ACCEPTANCE_SCALE_DEG
    low, high = np.log1p(np.array([known.minimum, known.maximum]) / scale)
    nodes = scale * np.expm1(chebyshev_nodes(low, high, _ACCEPTANCE_NODES))
    nodes = np.clip(nodes, known.minimum, known.maximum)
    nodes = np.delete(nodes, int(np.abs(nodes - own).argmin()))
    (parameter,) = FORWARD_BEAM.parameters
    by_angle = replace(
        parameter,
        minimum=known.minimum,
        maximum=known.maximum,
        start=known.start,
        absent=own,
        plausible=(known.minimum, known.maximum),
        nodes=tuple(map(float, nodes)),
        nominal=None,
        scale=scale,
        limits=None,
    )
    return replace(FORWARD_BEAM, name=ACCEPTANCE, parameters=(by_angle,))


def _coverage(campaign: Campaign, beyond: Beyond) -> tuple[Grid, Grid, ScatteringProposals]:
    """Grids and proposals that cover what a campaign may ask for.

    Most campaigns get the same, so that the cache serves them all.
    """
    starts = [known.start for known in _of_all(campaign, ALPHA_SCAT)]
    if ALPHA_SCAT not in campaign.parameters:
        starts.append(float(campaign.scene.parameters[ALPHA_SCAT]))
    factor, usual = 1.0, _STARTS_PER_CM[0] <= min(starts) <= max(starts) <= _STARTS_PER_CM[1]
    if not usual and len(starts) == 1:
        factor = float(f"{starts[0] / USUAL_ALPHA_SCAT_PER_CM:.1g}")
    least, most = _RANGE_PER_CM
    scattering = (factor * least, factor * most)
    drawn, shares = _PROPOSALS_PER_CM, _SHARES
    low, high = _ABSORPTION_PER_CM
    if campaign.beam or (len(starts) > 1 and not usual):
        # a transmittance may allow next to no losses, and the readings of light much scattering;
        # crystals may be as unlike
        scattering, drawn, shares = _BEAM_RANGE_PER_CM, _BEAM_PROPOSALS_PER_CM, _BEAM_SHARES
        factor = 1.0
        low = _LEAST_ABSORPTION_PER_CM
    of_all = _of_all(campaign, ALPHA_ABS)
    own = [known.start for known in of_all]
    if ALPHA_ABS not in campaign.parameters:
        own.append(float(campaign.scene.parameters[ALPHA_ABS]))
    # a column of absorptions, one per crystal
    own += [
        float(reading.parameters[ALPHA_ABS])
        for reading in campaign.measurements.readings
        if ALPHA_ABS in reading.parameters
    ]
    if min(own) < _LEAST_REACH * low:
        low = max(float(f"{min(own) / _LEAST_REACH:.1g}"), _LEAST_ABSORPTION_PER_CM)
    highest = max(own)
    for known in of_all:
        if known.fixed:
            continue
        spread = known.maximum
        if known.prior is not None and known.prior_sigma is not None:
            spread = known.prior + 4 * known.prior_sigma
        highest = max(highest, min(known.maximum, spread))
    while high < min(highest, _MOST_ABSORPTION_PER_CM):
        high *= 2.0
    proposals = ScatteringProposals(tuple(factor * a for a in drawn), shares, low)
    if any(beyond):
        ends = zip(beyond, _WIDE_RANGE_PER_CM, scattering, strict=True)
        least, most = (outermost if goes else usual for goes, outermost, usual in ends)
        scattering = min(least, scattering[0]), max(most, scattering[1])
        proposals = choose_proposals(*scattering, low)
    absorption = low, high
    return Grid(scattering, absorption), Grid(scattering, absorption, coarse=True), proposals


def _of_all(campaign: Campaign, name: str) -> list[CampaignParameter]:
    """What a campaign says of a coefficient, and of those that samples have in its place."""
    samples = [sample.own[name] for sample in campaign.samples.values() if name in sample.own]
    named = [name, *(own.name for own in samples)]
    return [campaign.parameters[each] for each in named if each in campaign.parameters]


@functools.lru_cache(maxsize=64)
def _has_open_mask(scene: SceneFile) -> bool:
    """Whether the scene's aperture parameter is the radius of masks on a square window, only.

    Of black ones: light that others reflect goes on.
    """
    if APERTURE not in scene.parameters or WINDOW not in scene.parameters:
        return False
    masks = (bsdf for bsdf in scene.root.iter("bsdf") if bsdf.get("type") == "aperture")
    if any(part.get("name") == "reflectance" for mask in masks for part in mask):
        return False
    wider = scene.with_overrides({APERTURE: _OPEN * float(scene.parameters[WINDOW])})
    for before, after in zip(scene.root.iter(), wider.root.iter(), strict=True):
        parent = before.getparent()
        if before.attrib != after.attrib and not (
            before.get("name") == "radius"
            and parent is not None
            and parent.get("type") == "aperture"
        ):
            return False
    return True
