"""Responses of a campaign's readings to physical effects: from the cache, else simulated.

Every configuration is simulated once as it is, with a mask that covers nothing: what its photons
met answers every smaller aperture, and every effect that only weights photons. Other effects are
simulated at their nodes. All runs draw the same random numbers, so that what they have in common
cancels, and batches of one number belong together.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.cache import RecordCache, record_versions
from mcrim_mitsuba.effects import add, filled
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.eta_table import EtaTable, Gathering, Grid
from mcrim_mitsuba.fit.lagrange import chebyshev_nodes
from mcrim_mitsuba.fit.proposals import Proposals
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.fit.response import Anchor, Axis, EffectResponse, Point, Responses, stack
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.kernel.lane_plan import LANES
from mcrim_mitsuba.recording import RunOptions

#: Photons of a simulation with an effect in the scene, and how many times as many of a
#: configuration as it is, which all effects are compared with.
EFFECT_PHOTONS, PLAIN_FACTOR = 48 * LANES, 5
#: Most photons of one simulation: its records are held in memory.
_MOST_PHOTONS = 512 * LANES
#: alpha_scat around which the usual proposals lie, 1/cm.
USUAL_ALPHA_SCAT_PER_CM = 0.5
#: Proposals, and their shares in 1/64: nearly as good as one of its own for 0.2 to 1 /cm, and a
#: half as good over the whole range.
_PROPOSALS_PER_CM = (0.05, 0.12, 0.25, 0.45, 0.8, 1.4, 2.5, 4.5)
_SHARES = (5, 8, 11, 13, 11, 8, 4, 4)
_RANGE_PER_CM = (0.05, 5.0)
#: Part of `_RANGE_PER_CM` where a campaign's start may lie.
_STARTS_PER_CM = (0.15, 1.7)
_ABSORPTION_PER_CM = (0.004, 0.15)
_FINE, _COARSE = (17, 6), (7, 4)
#: Scene parameter that is the radius of the hole in a mask, and a radius (in window widths) that
#: leaves all of a square window open.
APERTURE, WINDOW, _OPEN = "aperture_radius_mm", "window_width_mm", 0.75
#: What a chunk holds, flattened.
_COLUMNS = ("log_eta", "deviations")
#: Number of what a chunk holds; another layout gets another one.
_LAYOUT = 1
#: Nodes of a fitted scene parameter that is no effect's, its own value included.
_SCENE_NODES = 5

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Job:
    """A table that is wanted from a run: the records as they are, or weighted by an effect."""

    coarse: bool
    effect: Effect | None = None
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> list[object]:
        """What identifies it in the cache."""
        if self.effect is None:
            return [self.coarse]
        return [self.coarse, self.effect.name, _source_hash(self.effect), dict(self.values)]


@dataclass(frozen=True)
class _Run:
    """One simulation and what is wanted of it.

    Attributes
    ----------
    scene : SceneFile
    parameters : dict of str to value
        Of the configuration as the readings name it.
    radius_mm : float or None
        The mask's radius, to be cut out of the records; None: the scene is run as it is.
    jobs : tuple of _Job
    photons : int
    check : bool
    """

    scene: SceneFile
    parameters: Mapping[str, Value]
    radius_mm: float | None
    jobs: tuple[_Job, ...]
    photons: int
    check: bool


class ResponseMaker:
    """Makes the responses of a campaign's readings, effect by effect.

    Parameters
    ----------
    campaign : Campaign
    options : RunOptions
    photons : int, optional
        Of a simulation with an effect in the scene; those as the bench is get `PLAIN_FACTOR`
        times as many.
    progress : callable, optional
        ``progress(done, total)`` in photons.

    Attributes
    ----------
    photons, cached_photons : int
        Photons that the tables rest on, and those of them that the cache had.
    trouble : str or None
        Why the cache could not be used.
    """

    def __init__(
        self,
        campaign: Campaign,
        options: RunOptions,
        photons: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.campaign = campaign
        units = min(max(round((photons or EFFECT_PHOTONS) / LANES), 1), _MOST_PHOTONS // LANES)
        self._effect_photons = units * LANES
        self._plain_photons = min(PLAIN_FACTOR * units * LANES, _MOST_PHOTONS)
        self._options = options
        self._progress = progress
        self._versions = record_versions(options.variant)
        self.grid, self.coarse, self._proposals = _coverage(campaign)
        self.photons = self.cached_photons = 0
        self.trouble: str | None = None
        self._open_mask = _has_open_mask(campaign.scene)
        self._made: dict[tuple[object, ...], EtaTable] = {}

    # ---- what the configurations are ---------------------------------------------------------

    def _configurations(self) -> list[dict[str, Value]]:
        """Scene parameters of every reading, fitted effects absent and others at their start."""
        campaign = self.campaign
        held = {n: known.start for n, known in campaign.parameters.items() if known.fixed}
        absent = {
            p.name: p.absent
            for name in campaign.effects
            for p in campaign.catalogue[name].parameters
            if p.nominal is None and p.absent is not None
        }
        found = []
        for reading in campaign.measurements.readings:
            values = {**campaign.scene.parameters, **held, **reading.parameters}
            values |= {n: v for n, v in absent.items() if n in values}
            found.append({n: v for n, v in values.items() if n in campaign.scene.parameters})
        return found

    def _run(self, scene: SceneFile, values: Mapping[str, Value], jobs, *, photons, check=False):
        """A run of a scene at a configuration's values."""
        named = dict(values)
        # the records answer all coefficients: let scenes that differ in these only be one
        for name in (ALPHA_SCAT, ALPHA_ABS):
            named[name] = self.campaign.scene.parameters[name]
        radius = None
        if self._open_mask:
            radius = float(named[APERTURE])
            named[APERTURE] = _OPEN * float(named[WINDOW])
        overrides = {n: v for n, v in named.items() if n in scene.parameters}
        return _Run(scene.with_overrides(overrides), values, radius, tuple(jobs), photons, check)

    # ---- responses ---------------------------------------------------------------------------

    def make(self, effects: Sequence[Effect]) -> Responses:
        """Responses of the bench as it is and of effects.

        Parameters
        ----------
        effects : sequence of Effect
            Those of the readings are left out.

        Raises
        ------
        InputError
            If a scene is not sound, leaks, or cannot take an effect.
        """
        configurations = self._configurations()
        scene = self.campaign.scene
        # one without parameters that the scene has already is in all its simulations
        asked = [
            effect
            for effect in effects
            if effect.reading is None and (effect.parameters or not effect.is_in(scene))
        ]
        asked += [_as_effect(self.campaign, name) for name in self._further_parameters()]
        plans = {effect.name: self._plan(effect, configurations) for effect in asked}
        weighted = [
            job
            for effect in asked
            if self._weighs(effect) and effect.proposal is None
            for job in plans[effect.name].jobs
        ]
        plain = [_Job(coarse=False), _Job(coarse=True), *weighted]
        base = [
            self._run(self.campaign.scene, values, plain, photons=self._plain_photons,
                      check=self._options.check)
            for values in configurations
        ]  # fmt: skip
        runs = base + [run for plan in plans.values() for rows in plan.runs for run in rows]
        tables = self._tables(list(dict.fromkeys(map(_Hashed, runs))))
        fine, coarse = ([tables[_Hashed(run)][i] for run in base] for i in (0, 1))
        log_eta, deviations = stack(fine)
        self._refuse_darkness(log_eta)
        responses = {}
        for effect in asked:
            responses[effect.name] = self._response(
                effect, plans[effect.name], base, plain, coarse, tables
            )
        return Responses(self.grid, self.coarse, log_eta, deviations, responses, self.photons)

    def anchor(self, effects: Sequence[Effect], values: Mapping[str, float]) -> Anchor:
        """All effects at once, simulated at one point.

        Parameters
        ----------
        effects : sequence of Effect
        values : mapping of str to float
            Free parameters, the scale left out.
        """
        scene = self.campaign.scene
        physical = [effect for effect in effects if effect.reading is None]
        for effect in physical:
            scene = self._with_effect(scene, effect)
        overrides = {n: v for n, v in values.items() if n in scene.parameters}
        runs, coefficients = [], ([], [])
        for reading, own in zip(
            self.campaign.measurements.readings, self._configurations(), strict=True
        ):
            named = {**own, **{n: v for n, v in overrides.items() if n not in reading.parameters}}
            for name, column in zip((ALPHA_SCAT, ALPHA_ABS), coefficients, strict=True):
                column.append(float(named[name]))
            runs.append(self._run(scene, named, [_Job(coarse=False)], photons=self._plain_photons))
        tables = self._tables(list(dict.fromkeys(map(_Hashed, runs))))
        log_eta, deviations = stack([tables[_Hashed(run)][0] for run in runs])
        point = Point.of(self.grid, *coefficients)
        return Anchor(dict(values), point.value(log_eta), point.values(deviations))

    def is_exact(self, effects: Sequence[Effect]) -> bool:
        """Whether what responses make of effects together is exact, and not interpolated."""
        physical = [effect for effect in effects if effect.reading is None]
        return not self._further_parameters() and (
            not physical
            or (len(physical) == 1 and (self._weighs(physical[0]) or not physical[0].parameters))
        )

    def _further_parameters(self) -> list[str]:
        """Fitted scene parameters that no effect brings."""
        of_effects = {
            p.name for name in self.campaign.effects
            for p in self.campaign.catalogue[name].parameters
        }  # fmt: skip
        return [
            name
            for name, known in self.campaign.parameters.items()
            if not known.fixed and name not in (ALPHA_SCAT, ALPHA_ABS) and name not in of_effects
        ]

    def _weighs(self, effect: Effect) -> bool:
        """Whether an effect is predicted by weighting photon records."""
        # a mask cannot be taken off records that were made with it
        return effect.weight is not None and (
            self._open_mask or effect.mask_column == "mask_radius_mm"
        )

    def _with_effect(self, scene: SceneFile, effect: Effect) -> SceneFile:
        """The scene with an effect in it, where it is not there yet."""
        names = [p.name for p in effect.parameters]
        if effect.is_in(scene) or (names and all(name in scene.parameters for name in names)):
            return scene
        return scene.edited(add(effect, scene))

    def _plan(self, effect: Effect, configurations: list[dict[str, Value]]) -> _Plan:
        """Nodes of an effect, and the runs that its tables come from."""
        axes = [
            _axis(parameter, self.campaign.scene, configurations) for parameter in effect.parameters
        ]
        nodes = list(itertools.product(*(axis.values for axis in axes)))
        jobs = [
            _Job(True, effect, {a.name: a.nominal + v for a, v in zip(axes, node, strict=True)})
            for node in nodes
        ]
        if self._weighs(effect) and effect.proposal is None:
            return _Plan(axes, nodes, jobs, [])
        scene = self._with_effect(self.campaign.scene, effect)
        runs = []
        for values in configurations:
            if effect.filled_only and not filled(values):
                runs.append([])
            elif self._weighs(effect):
                own = {**values, **effect.proposal}
                runs.append([self._run(scene, own, jobs, photons=self._effect_photons)])
            else:
                runs.append(
                    [
                        self._run(
                            scene, {**values, **job.values}, [_Job(coarse=True)],
                            photons=self._effect_photons,
                        )
                        for node, job in zip(nodes, jobs, strict=True)
                        if not _is_absent(axes, node)
                    ]
                )  # fmt: skip
        return _Plan(axes, nodes, jobs, runs)

    def _response(self, effect, plan, base, plain, coarse, tables) -> EffectResponse:
        """An effect's tables over those of the bench as it is."""
        ratios, deviations = [], []
        for row, before in enumerate(coarse):
            own_ratio, own_deviations, runs = [], [], iter(plan.runs[row] if plan.runs else ())
            for number, node in enumerate(plan.nodes):
                nothing = plan.axes and _is_absent(plan.axes, node)
                if nothing or (effect.filled_only and not filled(base[row].parameters)):
                    own_ratio.append(np.zeros_like(before.log_eta))
                    own_deviations.append(np.zeros_like(before.deviations))
                    continue
                if not plan.runs:
                    table = tables[_Hashed(base[row])][_place(plain, plan.jobs[number])]
                elif self._weighs(effect):
                    table = tables[_Hashed(plan.runs[row][0])][number]
                else:
                    table = tables[_Hashed(next(runs))][0]
                own_ratio.append(table.log_eta - before.log_eta)
                own_deviations.append(table.deviations - before.deviations)
            ratios.append(own_ratio)
            deviations.append(own_deviations)
        shape = [len(axis.values) for axis in plan.axes]
        log_ratio = np.moveaxis(np.array(ratios), 0, 1)  # nodes, readings, ...
        self._refuse_darkness(log_ratio, effect)
        spread = np.moveaxis(np.array(deviations), (0, 1, 2), (2, 1, 0))  # batches, nodes, ...
        return EffectResponse(
            tuple(plan.axes),
            log_ratio.reshape(*shape, *log_ratio.shape[1:]),
            spread.reshape(spread.shape[0], *shape, *spread.shape[2:]),
        )

    def _refuse_darkness(self, log_eta: NDArray[np.float64], effect: Effect | None = None) -> None:
        if np.isfinite(log_eta).all():
            return
        row = int(np.argwhere(~np.isfinite(log_eta))[0][0 if effect is None else 1])
        reading = self.campaign.measurements.readings[row]
        beyond = "" if effect is None else f" with {effect.name}"
        raise InputError(
            f"no light is detected in the configuration of {reading.label}{beyond}",
            "check its parameters",
            path=self.campaign.measurements.path,
            line=reading.line,
        )

    # ---- simulation --------------------------------------------------------------------------

    def _tables(self, runs: Sequence[_Hashed]) -> dict[_Hashed, list[EtaTable]]:
        """The tables of all runs; those that differ in the mask only are simulated together."""
        found: dict[_Hashed, dict[int, EtaTable]] = {}
        groups: dict[tuple[str, int], list[_Hashed]] = {}
        for hashed in runs:
            key = (hashed.run.scene.content_hash, hashed.run.photons)
            groups.setdefault(key, []).append(hashed)
        todo = []
        self.photons += sum(photons for _, photons in groups)
        for (_, photons), members in groups.items():
            cache = self._cache(members[0].run)
            missing = False
            for hashed in members:
                found[hashed] = self._from_cache(cache, hashed.run)
                missing |= len(found[hashed]) < len(hashed.run.jobs)
            if missing:
                todo.append((cache, members))
            else:
                self.cached_photons += photons
        total, done = sum(members[0].run.photons for _, members in todo), 0
        with ThreadPoolExecutor(1) as gatherer:
            pending: Future | None = None
            for cache, members in todo:
                records = self._simulate(members, found)
                if pending is not None:
                    pending.result()
                pending = gatherer.submit(self._gather, records, cache, members, found)
                done += members[0].run.photons
                if self._progress is not None:
                    self._progress(done, total)
            if pending is not None:
                pending.result()
        return {
            hashed: [tables[i] for i in range(len(hashed.run.jobs))]
            for hashed, tables in found.items()
        }

    def _simulate(self, members: Sequence[_Hashed], found) -> PhotonRecords:
        """The records of one simulation, with the columns that its missing jobs need."""
        from mcrim_mitsuba.kernel.records import Recorder
        from mcrim_mitsuba.kernel.simulation import Simulation

        columns = []
        for hashed in members:
            if hashed.run.radius_mm is not None:
                columns.append("mask_radius_mm")
            for number, job in enumerate(hashed.run.jobs):
                if number not in found[hashed] and job.effect is not None:
                    columns += [*job.effect.columns, job.effect.mask_column]
        run = members[0].run
        simulation = Simulation(
            run.scene, variant=self._options.variant, threads=self._options.threads,
            check=run.check,
        )  # fmt: skip
        return Recorder(simulation).record(
            self._proposals, run.photons, seed=self._options.seed, number=0,
            columns=tuple(dict.fromkeys(columns)),
        )  # fmt: skip

    def _gather(self, records: PhotonRecords, cache, members: Sequence[_Hashed], found) -> None:
        """Tables of the jobs that the cache did not have, and write them to it."""
        for hashed in members:
            run, have = hashed.run, found[hashed]
            prepared: dict[tuple[bool, str], Gathering] = {}
            for number, job in enumerate(run.jobs):
                if number in have:
                    continue
                mask = "mask_radius_mm" if job.effect is None else job.effect.mask_column
                key = (job.coarse, mask)
                if key not in prepared:
                    kept = None
                    if run.radius_mm is not None:
                        kept = np.asarray(records.further[mask]) <= run.radius_mm
                    grid = self.coarse if job.coarse else self.grid
                    prepared[key] = Gathering(records, grid, kept)
                gathering, weight = prepared[key], None
                if job.effect is not None:
                    weight = job.effect.weight(
                        {
                            name: np.asarray(records.further[name])[gathering.order]
                            for name in job.effect.columns
                        },
                        job.values,
                        run.parameters,
                    )
                have[number] = gathering.table(weight)
                chunk_number = self._number(run, job)
                self._made[run.scene.content_hash, run.photons, chunk_number] = have[number]
                cache.write(
                    chunk_number,
                    {name: getattr(have[number], name).ravel() for name in _COLUMNS},
                    {},
                )
                self.trouble = self.trouble or cache.trouble

    def _cache(self, run: _Run) -> RecordCache:
        return RecordCache(
            {
                "what": "eta tables",
                "scene": run.scene.content_hash,
                "seed": self._options.seed,
                "photons": run.photons,
                "proposals": asdict(self._proposals),
                "grids": [asdict(self.grid), asdict(self.coarse)],
                "versions": self._versions,
                "layout": _LAYOUT,
            }
        )

    @staticmethod
    def _number(run: _Run, job: _Job) -> int:
        """Number of a job's chunk."""
        parameters = {} if job.effect is None else run.parameters
        name = json.dumps([run.radius_mm, job.name, parameters], sort_keys=True, default=str)
        return int(hashlib.sha256(name.encode()).hexdigest()[:7], 16)

    def _from_cache(self, cache: RecordCache, run: _Run) -> dict[int, EtaTable]:
        tables = {}
        for number, job in enumerate(run.jobs):
            chunk_number = self._number(run, job)
            key = (run.scene.content_hash, run.photons, chunk_number)
            if key not in self._made and (chunk := cache.read(chunk_number)) is not None:
                shape = (self.coarse if job.coarse else self.grid).counts
                self._made[key] = EtaTable(
                    chunk.arrays["log_eta"].reshape(shape),
                    chunk.arrays["deviations"].reshape(-1, *shape),
                )
            if key in self._made:
                tables[number] = self._made[key]
        return tables


@dataclass(frozen=True)
class _Plan:
    """Nodes of an effect, the tables wanted at them, and per reading the runs they come from.

    Without runs they come from the bench as it is.
    """

    axes: list[Axis]
    nodes: list[tuple[float, ...]]
    jobs: list[_Job]
    runs: list[list[_Run]]


class _Hashed:
    """A run by what it is: runs of equal scenes and jobs are one."""

    def __init__(self, run: _Run) -> None:
        self.run = run
        jobs = json.dumps([job.name for job in run.jobs], sort_keys=True, default=str)
        self._key = (run.scene.content_hash, run.radius_mm, run.photons, jobs)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Hashed) and self._key == other._key


def _place(jobs: Sequence[_Job], wanted: _Job) -> int:
    return next(i for i, job in enumerate(jobs) if job.name == wanted.name)


def _is_absent(axes: Sequence[Axis], node: Sequence[float]) -> bool:
    """Whether the effect is not there at a node."""
    return any(
        axis.parameter.absent is not None
        and value == (0.0 if axis.parameter.nominal else axis.parameter.absent)
        for axis, value in zip(axes, node, strict=True)
    )


def _axis(
    parameter: EffectParameter, scene: SceneFile, configurations: Sequence[Mapping[str, Value]]
) -> Axis:
    """Nodes of a parameter, drawn in where a configuration's bench does not take all of them."""
    nominal = float(scene.parameters[parameter.nominal]) if parameter.nominal else 0.0
    absent = [] if parameter.absent is None else [0.0 if parameter.nominal else parameter.absent]
    nodes = list(parameter.nodes)
    if parameter.limits is not None:
        lows, highs = zip(*(parameter.limits(values) for values in configurations), strict=True)
        low, high = max(lows), min(highs)
        below = max([1.0, *(node / low for node in nodes if node < low < 0)])
        above = max([1.0, *(node / high for node in nodes if node > high > 0)])
        nodes = [node / (below if node < 0 else above) for node in nodes]
    return Axis(parameter, [*absent, *nodes], nominal)


def _as_effect(campaign: Campaign, name: str) -> Effect:
    """A fitted scene parameter as an effect that is absent at the scene's value."""
    known, own = campaign.parameters[name], float(campaign.scene.parameters[name])
    if not (math.isfinite(known.minimum) and math.isfinite(known.maximum)):
        raise InputError(
            f"{name} has the range {known.minimum:g}..{known.maximum:g}",
            "give a finite min and a larger finite max: it is simulated between them",
            path=campaign.path,
        )
    nodes = chebyshev_nodes(known.minimum, known.maximum, _SCENE_NODES)
    # the scene's value stands in for the nearest of them
    nodes = np.delete(nodes, int(np.abs(nodes - own).argmin()))
    parameter = EffectParameter(
        name=name, unit="", meaning="a parameter of the scene", minimum=known.minimum,
        maximum=known.maximum, start=known.start, absent=own,
        plausible=(known.minimum, known.maximum), nodes=tuple(map(float, nodes)),
    )  # fmt: skip
    # nothing to be written into the scene: it has the parameter
    return Effect(name, name, "", "", parameters=(parameter,), edit=lambda editor: None)


def _coverage(campaign: Campaign) -> tuple[Grid, Grid, Proposals]:
    """Grids and proposals that cover what a campaign may ask for.

    Most campaigns get the same, so that the cache serves them all.
    """
    known = campaign.parameters.get(ALPHA_SCAT)
    start = known.start if known is not None else float(campaign.scene.parameters[ALPHA_SCAT])
    factor = 1.0
    if not _STARTS_PER_CM[0] <= start <= _STARTS_PER_CM[1]:
        factor = float(f"{start / USUAL_ALPHA_SCAT_PER_CM:.1g}")
    scattering = tuple(factor * end for end in _RANGE_PER_CM)
    known = campaign.parameters.get(ALPHA_ABS)
    low, high = _ABSORPTION_PER_CM
    if known is None or known.fixed:
        needed = [float(campaign.scene.parameters[ALPHA_ABS]) if known is None else known.start]
    elif known.prior is not None:
        needed = [max(known.minimum, 1e-3, known.prior - 4 * known.prior_sigma),
                  min(known.maximum, known.prior + 4 * known.prior_sigma)]  # fmt: skip
    else:
        needed = [max(known.minimum, 0.1 * known.start), known.maximum]
    # a column of absorptions, one per crystal
    needed += [
        float(r.parameters[ALPHA_ABS])
        for r in campaign.measurements.readings
        if ALPHA_ABS in r.parameters
    ]
    if min(needed) < low:
        low = max(float(f"{0.5 * min(needed):.1g}"), 1e-3)
    while high < min(max(needed), 2.4):
        high *= 2.0
    proposals = Proposals(tuple(factor * a for a in _PROPOSALS_PER_CM), _SHARES, low)
    return (
        Grid(scattering, (low, high), _FINE),
        Grid(scattering, (low, high), _COARSE),
        proposals,
    )


def _has_open_mask(scene: SceneFile) -> bool:
    """Whether the scene's aperture parameter is the radius of masks on a square window, only."""
    if APERTURE not in scene.parameters or WINDOW not in scene.parameters:
        return False
    wider = scene.with_overrides({APERTURE: _OPEN * float(scene.parameters[WINDOW])})
    for before, after in zip(scene.root.iter(), wider.root.iter(), strict=True):
        if before.attrib != after.attrib and not (
            before.get("name") == "radius" and before.getparent().get("type") == "aperture"
        ):
            return False
    return True


def _source_hash(effect: Effect) -> str:
    """SHA-256 of the file that an effect's weight is written in."""
    if effect.weight is None:
        return ""
    return hashlib.sha256(Path(effect.weight.__code__.co_filename).read_bytes()).hexdigest()
