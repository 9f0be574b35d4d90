"""Simulate one configuration: short runs at once, long ones in units that are kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from mcrim_mitsuba.cache import record_versions
from mcrim_mitsuba.kernel.lane_plan import FIRST_LAUNCH
from mcrim_mitsuba.results import SimulationResult
from mcrim_mitsuba.work import Crew, Progress, Task, current_crew
from mcrim_mitsuba.work.array_job import PartCrew
from mcrim_mitsuba.work.blocks import planned
from mcrim_mitsuba.work.loaded import remember
from mcrim_mitsuba.work.tally_block import TallyBlock, tally_of

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.simulation import Simulation

#: Launches up to which a run of this process is made at once: again is as quick as kept.
_AT_ONCE = 16
#: Part of the photons that a precision asks for, to be spent before looking again.
_FIRST_STEP = 0.8
_LAYOUT = 1


def collect(
    simulation: Simulation,
    photons: int,
    *,
    precision: float | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
    what: str = "simulating",
) -> SimulationResult:
    """Light collection efficiency and the fates of all photons.

    Parameters
    ----------
    simulation : Simulation
        Checked.
    photons : int
        Photons to follow; with `precision`, at most.
    precision : float, optional
        Wanted relative standard error of eta.
    seed : int
    threads : int, optional
    progress : callable, optional
        See `work.Progress`; the note tells eta.
    what : str

    Raises
    ------
    InputError
        As `Simulation.collect`.
    """
    from mcrim_mitsuba.kernel.collection import choose_path, launch_size, refuse_arguments

    refuse_arguments(photons, seed)
    size = launch_size(choose_path(simulation.model, simulation.polarization))
    told = None if progress is None else _teller(progress, what, precision)
    if type(current_crew()) is Crew:
        lacking = photons if precision is None else _lacking(simulation, photons, precision, seed)
        if lacking <= _AT_ONCE * size:
            return simulation.collect(photons, precision=precision, seed=seed, progress=told)
    return _LongRun(simulation, seed, threads, what, size).collect(photons, precision, told)


def _lacking(simulation: Simulation, photons: int, precision: float, seed: int) -> int:
    """Photons that a precision takes, by a first launch."""
    from mcrim_mitsuba.kernel.collection import lacking

    first = simulation.integrator.collect(
        simulation.model, simulation.crystal, photons=min(photons, FIRST_LAUNCH), seed=seed
    )
    return min(photons, lacking(first.tally, precision))


def _teller(
    progress: Progress, what: str, precision: float | None
) -> Callable[[int, int, float, float], None]:
    """Progress as a simulation tells it: photons, and eta with its error."""

    def tell(done: int, total: int, eta: float, sigma: float) -> None:
        if precision is not None and sigma > 0 and eta > 0:
            # photons needed for the precision, as known so far
            total = min(total, max(done, round(done * (sigma / eta / precision) ** 2)))
        progress(what, done, total, f"eta {eta:.4f} ± {sigma:.4f}")

    return tell


class _LongRun:
    """A simulation whose launches are done in units.

    Parameters
    ----------
    simulation : Simulation
    seed : int
    threads : int or None
    what : str
    size : int
        Photons of a launch, the first one left out.
    """

    def __init__(
        self, simulation: Simulation, seed: int, threads: int | None, what: str, size: int
    ) -> None:
        self._simulation, self._seed, self._threads = simulation, seed, threads
        self._what, self._size, self._launches = what, size, 0
        self._max_depth = simulation.depth_limit
        remember(simulation)
        self._cache = current_crew().cache(
            {
                "what": "tallies",
                "scene": simulation.file.content_hash,
                "seed": seed,
                "max_depth": self._max_depth,
                "versions": record_versions(simulation.variant),
                "layout": _LAYOUT,
            }
        )

    def collect(
        self,
        photons: int,
        precision: float | None,
        told: Callable[[int, int, float, float], None] | None,
    ) -> SimulationResult:
        """As `Simulation.collect`."""
        from mcrim_mitsuba.kernel.collection import lacking
        from mcrim_mitsuba.kernel.tally import FateTally

        tally, cached, path, interrupted = FateTally(), 0, "", False
        start, seconds = time.perf_counter(), 0.0
        try:
            while tally.photons < photons:
                wanted = photons - tally.photons
                if precision is not None:
                    more = lacking(tally, precision) if tally.photons else FIRST_LAUNCH
                    wanted = min(wanted, more)
                    if wanted > _AT_ONCE * self._size:
                        wanted = int(_FIRST_STEP * wanted)
                tasks = self._tasks(wanted)
                for done in current_crew().do(
                    tasks, threads=self._threads, by_all=tally.photons == 0 and len(tasks) == 1
                ):
                    (chunk,) = done.chunks.values()
                    tally.merge(tally_of(chunk.metadata))
                    unit = done.task.unit
                    assert isinstance(unit, TallyBlock)
                    self._launches += len(unit.launches)
                    cached += unit.photons if done.cached else 0
                    seconds += chunk.metadata["seconds"]
                    path = chunk.metadata["path"]
                    if told is not None:
                        eta = tally.fraction("detected")
                        told(tally.photons, photons, eta, tally.sigma("detected"))
                eta, sigma = tally.fraction("detected"), tally.sigma("detected")
                if precision is not None and eta > 0 and sigma <= precision * eta:
                    break
        except KeyboardInterrupt:
            # a part of an array job has no result, and is not done
            if tally.photons == 0 or isinstance(current_crew(), PartCrew):
                raise
            interrupted = True
        return self._simulation.result(
            tally, photons, self._seed, precision,
            # of an earlier run's photons the time that they took then
            seconds=seconds if cached else time.perf_counter() - start,
            path_name=path, interrupted=interrupted, max_depth=self._max_depth,
            cached_photons=cached, notes=self._cache.notes,
        )  # fmt: skip

    def _tasks(self, photons: int) -> list[Task]:
        """Units of the next launches."""
        tasks, simulation = [], self._simulation
        for number, block in planned(photons, self._launches, FIRST_LAUNCH, self._size):
            unit = TallyBlock(
                self._what, simulation.file, self._seed, simulation.variant, self._max_depth,
                number, block,
            )  # fmt: skip
            tasks.append(Task(unit, self._cache))
        return tasks
