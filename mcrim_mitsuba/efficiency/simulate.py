"""Simulate one configuration: short runs at once, long ones in units that are kept."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.runs.array_job import PartExecutor
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.runs.executors import Content, Executor, Finished, Job, current_executor
from mcrim_mitsuba.runs.scene_units import LaunchBlock, planned, remember
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.launch_plan import FIRST_LAUNCH, FateTally
from mcrim_mitsuba.transport.simulation import DEFAULT_PHOTONS, Simulation, SimulationResult

#: What a chunk holds of a tally.
_TALLY = ("photons", "batches", "sums", "squares")


@dataclass(frozen=True)
class TallyBlock(LaunchBlock):
    """Launches that are tallied by the photons' fates."""

    #: Free flights after which a photon is given up.
    max_depth: int

    def make(self, threads: int | None) -> dict[int, Content]:
        launcher = self.loaded(threads).launcher()
        start, tally = time.perf_counter(), launcher.tally
        for number, photons in enumerate(self.launches, self.first):
            launcher.launch(photons, seed=self.seed, number=number, max_depth=self.max_depth)
        data = {name: getattr(tally, name) for name in _TALLY}
        data |= {"seconds": time.perf_counter() - start, "path": launcher.path.name}
        return {self.numbers[0]: ({}, data)}


#: Launches up to which a run of this process is made at once: again is as quick as kept.
AT_ONCE = 16
#: Part of the photons that a precision asks for, to be spent before looking again.
_FIRST_STEP = 0.8
_LAYOUT = 2
#: The most that a precision may cost.
MOST_PHOTONS = 10**10


def collect(
    simulation: Simulation,
    *,
    run: Run = Run(),
    what: str = "simulating",
    max_depth: int | None = None,
) -> SimulationResult:
    """Light collection efficiency of a checked simulation, and the fates of all photons.

    A run has 2 million photons where it says nothing, with a precision as many as it takes. Its
    variant is the simulation's; its progress is called `what` and told eta. After `max_depth` free
    flights, the scene's number where it is not given, a photon is given up.

    Errors are those of `Simulation.collect`.
    """
    photons = run.photons_or(MOST_PHOTONS if run.precision else DEFAULT_PHOTONS)
    max_depth = max_depth or simulation.depth_limit

    def tell(done: int, total: int, eta: float, sigma: float) -> None:
        if run.precision is not None and sigma > 0 and eta > 0:
            # photons needed for the precision, as known so far
            total = min(total, max(done, round(done * (sigma / eta / run.precision) ** 2)))
        run.tell(what, done, total, f"eta {eta:.4f} ± {sigma:.4f}")

    if (
        type(current_executor()) is Executor
        and _lacking(simulation, photons, run, max_depth) <= AT_ONCE * simulation.launcher().size
    ):
        report = tell if run.progress else None
        return simulation.collect(
            photons, precision=run.precision, seed=run.seed, progress=report, max_depth=max_depth
        )
    return _collect_in_units(simulation, photons, run, what, max_depth, tell)


def collect_whole(
    scene: Path | SceneFile,
    overrides: Mapping[str, Value],
    what: str,
    run: Run,
    max_depth: int | None = None,
) -> SimulationResult:
    """`collect` of a bench of its own; KeyboardInterrupt where it was cut short."""
    simulation = Simulation(scene, overrides, variant=run.variant, threads=run.threads)
    result = collect(simulation, run=run, what=what, max_depth=max_depth)
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def _lacking(simulation: Simulation, photons: int, run: Run, max_depth: int) -> int:
    """Photons that a run takes; with a precision, by a first launch."""
    if run.precision is None:
        return photons
    launcher, first = simulation.launcher(), min(photons, FIRST_LAUNCH)
    launcher.launch(first, seed=run.seed, number=0, max_depth=max_depth)
    return min(photons, launcher.tally.lacking(run.precision))


class _UnitTally:
    """What the units of one run have tallied so far."""

    def __init__(self, empty: FateTally) -> None:
        self.tally = empty
        self.launches = self.cached_photons = 0
        self.seconds, self.path = 0.0, ""

    def add(self, done: Finished) -> None:
        """Take in a unit."""
        (chunk,) = done.chunks.values()
        unit = done.job.unit
        assert isinstance(unit, TallyBlock)
        self.tally.merge(FateTally(*(chunk.metadata[name] for name in _TALLY)))
        self.launches += len(unit.launches)
        self.cached_photons += unit.photons if done.cached else 0
        self.seconds += chunk.metadata["seconds"]
        self.path = chunk.metadata["path"]

    def lacking(self, photons: int, precision: float | None, size: int) -> int:
        """Photons to follow before looking again at what is reached; 0 at the end.

        Launches have `size` of them.
        """
        tally = self.tally
        if tally.photons >= photons or tally.reaches(precision):
            return 0
        wanted = photons - tally.photons
        if precision is None:
            return wanted
        wanted = min(wanted, tally.lacking(precision) if tally.photons else FIRST_LAUNCH)
        return int(_FIRST_STEP * wanted) if wanted > AT_ONCE * size else wanted


def _collect_in_units(
    simulation: Simulation,
    photons: int,
    run: Run,
    what: str,
    max_depth: int,
    tell: Callable[[int, int, float, float], None],
) -> SimulationResult:
    """Collect light in units of launches that are kept; see `Simulation.collect`."""
    remember(simulation)
    executor, launcher = current_executor(), simulation.launcher()
    size = launcher.size
    key = {
        "what": "tallies",
        "scene": simulation.file.content_hash,
        "seed": run.seed,
        "max_depth": max_depth,
        "versions": record_versions(simulation.variant, __name__),
        "layout": _LAYOUT,
    }
    cache = executor.cache(key)
    block = functools.partial(
        TallyBlock, what, simulation.file, run.seed, simulation.variant, True, max_depth=max_depth
    )
    so_far, interrupted = _UnitTally(launcher.tally), False
    tally, start = so_far.tally, time.perf_counter()
    try:
        while wanted := so_far.lacking(photons, run.precision, size):
            launches = planned(wanted, so_far.launches, size)
            jobs = [Job(block(first=n, launches=of_unit), cache) for n, of_unit in launches]
            by_all = tally.photons == 0 and len(jobs) == 1
            for done in executor.do(jobs, threads=run.threads, by_all=by_all):
                so_far.add(done)
                tell(tally.photons, photons, tally.eta, tally.eta_sigma)
    except KeyboardInterrupt:
        # a part of an array job has no result, and is not done
        if tally.photons == 0 or isinstance(executor, PartExecutor):
            raise
        interrupted = True
    # of an earlier run's photons the time that they took then
    return simulation.result(
        tally,
        photons,
        run.seed,
        run.precision,
        seconds=so_far.seconds if so_far.cached_photons else time.perf_counter() - start,
        path_name=so_far.path,
        interrupted=interrupted,
        max_depth=max_depth,
        cached_photons=so_far.cached_photons,
        notes=cache.notes,
    )
