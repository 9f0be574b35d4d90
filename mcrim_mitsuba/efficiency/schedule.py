"""Simulations of a campaign: the tables of eta that are wanted of each, and what they took."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.effect import Effect, modules_of
from mcrim_mitsuba.efficiency.eta_grid import EtaGrid, TableRequest, TableUnit, averaged, table_of
from mcrim_mitsuba.efficiency.proposals import Coverage
from mcrim_mitsuba.runs.cache import code_hash, record_versions
from mcrim_mitsuba.runs.executors import Job, current_executor, many_units_executor, number_of
from mcrim_mitsuba.scene.emitted_light import Colours
from mcrim_mitsuba.scene.scene_file import SceneFile, ScenePlan

#: Number of what a chunk holds; another layout gets another one.
_LAYOUT = 2


class Identity(NamedTuple):
    """What tells simulations apart."""

    scene_hash: str
    #: What differs from the scene, as JSON.
    overrides: str
    photons: int


@dataclass(frozen=True, kw_only=True)
class PlannedRun:
    """A simulation as one reading sees it; one simulation may serve several masks."""

    base: SceneFile
    #: What differs from it.
    overrides: Mapping[str, Value]
    #: Of the configuration as the readings name it.
    parameters: Mapping[str, Value]
    #: The mask's radius, to be cut out of the records; None: the scene is run as it is.
    radius_mm: float | None
    photons: int
    #: Whose light counts, as the records tell; None: the scene's.
    detector: str | None = None
    check: bool = False
    #: Whether it is of a spectrophotometer; `radius_mm` is then its acceptance in degrees.
    of_beam: bool = False

    @functools.cached_property
    def identity(self) -> Identity:
        """What tells the simulation from others."""
        overrides = json.dumps(self.overrides, sort_keys=True)
        return Identity(self.base.content_hash, overrides, self.photons)

    def table(
        self,
        *,
        coarse: bool = True,
        effect: Effect | None = None,
        values: Mapping[str, float] | None = None,
    ) -> WantedTable:
        """A table of eta that is wanted of its records, weighted by an effect or not.

        The number of its chunk in the cache is made of all that it depends on.
        """
        identity: list[object] = [*self.identity, self.radius_mm, self.detector, coarse]
        if effect is not None:
            light = ALPHA_SCAT, ALPHA_ABS
            parameters = {n: v for n, v in self.parameters.items() if n not in light}
            code = code_hash(modules_of([effect]))
            identity += [effect.name, code, dict(values or {}), parameters]
        request = TableRequest(
            number=number_of(*identity),
            coarse=coarse,
            radius_mm=self.radius_mm,
            detector=self.detector,
            effect=effect,
            values=values or {},
            parameters=self.parameters,
            of_beam=self.of_beam,
        )
        return WantedTable(self, request)


class WantedTable(NamedTuple):
    """A table, and the simulation that it is of."""

    run: PlannedRun
    request: TableRequest

    @property
    def number(self) -> int:
        """Of its chunk in the cache."""
        return self.request.number


class Schedule:
    """Has tables of eta made, every one once, and keeps the account of what they took.

    With the `colours` of a light, tables are its means. `what` is their name in progress; the
    photons and the precision of `run` do not matter.
    """

    def __init__(self, run: Run, coverage: Coverage, colours: Colours | None, what: str) -> None:
        self._run, self._coverage, self._colours, self._what = run, coverage, colours, what
        self._made: dict[int, EtaGrid] = {}
        # simulations that results rest on, by result, and which of them the cache had
        self._rests_on: dict[str, set[Identity]] = {}
        self._was_cached: dict[Identity, bool] = {}
        self._cache = current_executor().cache(
            {
                "what": "eta tables",
                "seed": run.seed,
                "proposals": asdict(coverage.proposals),
                "grids": [asdict(coverage.fine), asdict(coverage.coarse)],
                "versions": record_versions(run.variant, TableUnit.__module__),
                "layout": _LAYOUT,
            }
        )

    @property
    def photons(self) -> int:
        """That results rest on: not those of a first look where there was a second one."""
        return sum(identity.photons for identity in self._used)

    @property
    def cached_photons(self) -> int:
        """Those of them that the cache had."""
        return sum(of.photons for of in self._used if self._was_cached[of])

    @property
    def _used(self) -> set[Identity]:
        return set[Identity]().union(*self._rests_on.values())

    @property
    def notes(self) -> list[str]:
        """What the user must know of the cache."""
        return list(self._cache.notes)

    def rest_on(self, result: str, wanted: Sequence[WantedTable]) -> None:
        """Keep what a result rests on, in place of what it rested on before."""
        self._rests_on[result] = {table.run.identity for table in wanted}

    def tables(
        self, wanted: Sequence[WantedTable], *, by_all: bool = False
    ) -> Mapping[int, EtaGrid]:
        """All tables made so far by number, the wanted ones among them.

        Those of one simulation are made together. Few that decide what comes next are made
        `by_all`, see `runs.executors.Executor`.

        Raises InputError if a scene is not sound, or leaks.
        """
        # what the cache has is asked for too: parts of an array job must see the same units
        missing: dict[Identity, dict[int, WantedTable]] = {}
        for table in wanted:
            if table.number not in self._made:
                missing.setdefault(table.run.identity, {})[table.number] = table
        # the first of every scene before all others: processes compile unlike kernels then
        first: dict[str, Identity] = {}
        for identity in missing:
            first.setdefault(identity.scene_hash, identity)
        ordered = sorted(missing, key=lambda identity: identity != first[identity.scene_hash])
        groups = [list(missing[identity].values()) for identity in ordered]
        largest_error = 0.0

        def report(what: str, done: int, total: int, note: str = "") -> None:
            worst = f", errors up to {100 * largest_error:.2g} %" if largest_error else ""
            self._run.tell(what, done, total, f"{note}{worst}")

        jobs = [Job(self._unit(members), self._cache) for members in groups]
        executor = many_units_executor(self._run.threads)
        for done in executor.do(jobs, threads=self._run.threads, by_all=by_all, progress=report):
            members = groups[done.index]
            self._was_cached.setdefault(members[0].run.identity, done.cached)
            for table in members:
                eta = self._of_light(table, done.chunks[table.number].arrays)
                self._made[table.number] = eta
                largest_error = max(largest_error, eta.usual_error)
        return self._made

    def _unit(self, tables: Sequence[WantedTable]) -> TableUnit:
        """One simulation with all tables that are wanted of it."""
        of = tables[0].run
        return TableUnit(
            what=self._what,
            scene=ScenePlan(of.base, of.overrides),
            seed=self._run.seed,
            variant=self._run.variant,
            checked=not any(table.run.check for table in tables),
            proposals=self._coverage.proposals,
            photons=of.photons,
            grids=(self._coverage.fine, self._coverage.coarse),
            requests=tuple(table.request for table in tables),
        )

    def _of_light(self, wanted: WantedTable, arrays: Mapping) -> EtaGrid:
        """The table that a chunk holds, averaged over the light's colours where those are known."""
        request = wanted.request
        grid = self._coverage.coarse if request.coarse else self._coverage.fine
        table = table_of(arrays, *grid.counts)
        if self._colours is None or request.of_beam:
            return table
        return averaged(table, grid, self._colours)
