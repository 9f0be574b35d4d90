"""Simulate one configuration: short runs at once, long ones in units that are kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.runs.array_job import PartExecutor
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.runs.executors import Content, Executor, Task, current_executor
from mcrim_mitsuba.runs.scene_units import LaunchBlock, planned, remember
from mcrim_mitsuba.transport.launch_plan import FIRST_LAUNCH
from mcrim_mitsuba.transport.simulation import DEFAULT_PHOTONS, SimulationResult

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation


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
_AT_ONCE = 16
#: Part of the photons that a precision asks for, to be spent before looking again.
_FIRST_STEP = 0.8
_LAYOUT = 1
#: The most that a precision may cost.
MOST_PHOTONS = 10**10


def collect(
    simulation: Simulation, *, run: Run = Run(), what: str = "simulating"
) -> SimulationResult:
    """Light collection efficiency and the fates of all photons.

    Parameters
    ----------
    simulation : Simulation
        Checked.
    run : Run
        Of 2 million photons, with a precision as many as it takes. Its variant is the
        simulation's, its progress is told eta.
    what : str
        Its name in progress.

    Raises
    ------
    InputError
        As `Simulation.collect`.
    """
    photons = run.photons_or(MOST_PHOTONS if run.precision else DEFAULT_PHOTONS)
    size = simulation.launcher().size

    def tell(done: int, total: int, eta: float, sigma: float) -> None:
        if run.precision is not None and sigma > 0 and eta > 0:
            # photons needed for the precision, as known so far
            total = min(total, max(done, round(done * (sigma / eta / run.precision) ** 2)))
        run.tell(what, done, total, f"eta {eta:.4f} ± {sigma:.4f}")

    if (
        type(current_executor()) is Executor
        and _lacking(simulation, photons, run) <= _AT_ONCE * size
    ):
        return simulation.collect(
            photons, precision=run.precision, seed=run.seed, progress=tell if run.progress else None
        )
    return _collect_in_units(simulation, photons, run, what, size, tell)


def _lacking(simulation: Simulation, photons: int, run: Run) -> int:
    """Photons that a run takes; with a precision, by a first launch."""
    if run.precision is None:
        return photons
    launcher, first = simulation.launcher(), min(photons, FIRST_LAUNCH)
    launcher.launch(first, seed=run.seed, number=0, max_depth=simulation.depth_limit)
    return min(photons, launcher.tally.lacking(run.precision))


def _collect_in_units(
    simulation: Simulation,
    photons: int,
    run: Run,
    what: str,
    size: int,
    tell: Callable[[int, int, float, float], None],
) -> SimulationResult:
    """As `Simulation.collect`, in units of launches of `size` photons after the first one."""
    from mcrim_mitsuba.transport.launch_plan import FateTally

    remember(simulation)
    precision, max_depth = run.precision, simulation.depth_limit
    cache = current_executor().cache(
        {
            "what": "tallies",
            "scene": simulation.file.content_hash,
            "seed": run.seed,
            "max_depth": max_depth,
            "versions": record_versions(simulation.variant, __name__),
            "layout": _LAYOUT,
        }
    )
    tally = FateTally(head_on=simulation.model.head_on)
    launches, cached, path, interrupted = 0, 0, "", False
    start, seconds = time.perf_counter(), 0.0
    try:
        while tally.photons < photons and not tally.reaches(precision):
            wanted = photons - tally.photons
            if precision is not None:
                wanted = min(wanted, tally.lacking(precision) if tally.photons else FIRST_LAUNCH)
                if wanted > _AT_ONCE * size:
                    wanted = int(_FIRST_STEP * wanted)
            tasks = [
                Task(
                    TallyBlock(
                        what,
                        simulation.file,
                        run.seed,
                        simulation.variant,
                        True,
                        number,
                        block,
                        max_depth,
                    ),
                    cache,
                )
                for number, block in planned(wanted, launches, size)
            ]
            by_all = tally.photons == 0 and len(tasks) == 1
            for done in current_executor().do(tasks, threads=run.threads, by_all=by_all):
                (chunk,) = done.chunks.values()
                tally.merge(FateTally(*(chunk.metadata[name] for name in _TALLY)))
                unit = done.task.unit
                assert isinstance(unit, TallyBlock)
                launches += len(unit.launches)
                cached += unit.photons if done.cached else 0
                seconds += chunk.metadata["seconds"]
                path = chunk.metadata["path"]
                tell(tally.photons, photons, tally.eta, tally.eta_sigma)
    except KeyboardInterrupt:
        # a part of an array job has no result, and is not done
        if tally.photons == 0 or isinstance(current_executor(), PartExecutor):
            raise
        interrupted = True
    return simulation.result(
        tally,
        photons,
        run.seed,
        precision,
        # of an earlier run's photons the time that they took then
        seconds=seconds if cached else time.perf_counter() - start,
        path_name=path,
        interrupted=interrupted,
        max_depth=max_depth,
        cached_photons=cached,
        notes=cache.notes,
    )
