"""Eta of configurations as functions of the coefficients: from the cache, else simulated.

Units of launches answer their photons on a grid (`efficiency.eta_grid`); more of them are simulated
until the photons or the precision that are asked for are reached.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import Run, one_thread
from mcrim_mitsuba.efficiency.eta_grid import (
    DETECTOR_HIT,
    MASK,
    EtaGrid,
    Grid,
    GridReweighter,
    content_of,
    counted,
    merged,
    refuse_shared_coefficients,
    standard_error,
    table_of,
)
from mcrim_mitsuba.efficiency.proposals import SMALLEST_PER_CM, choose_proposals
from mcrim_mitsuba.efficiency.surface import Coefficients, EtaPoint
from mcrim_mitsuba.runs import executors
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.runs.scene_units import LaunchBlock, planned
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.launch_plan import LANES, PhotonRecords, ScatteringProposals

#: Photons of a first look, which shows how many a precision takes.
FIRST_LOOK = 262_144
#: The most photons of a launch; fixed, so that longer runs begin with the same launches.
LARGEST_LAUNCH = 2_097_152
#: The most that a wanted precision may cost.
MOST_PHOTONS = 400_000_000
#: Rounds of simulating more, each with a better idea of how many photons are lacking.
_MOST_ROUNDS = 6
#: More photons than are lacking by the present error, which has an error itself.
_MARGIN = 1.06
#: Relative error, of about a hundred photons, above which neither eta nor its error is trusted.
_LARGEST_ERROR = 0.1
#: Upper end of a range over its lower one, at least, and what is added to that of alpha_abs.
_SHORTEST = 1.2
_LEAST_PER_CM = 0.01
#: Number of what the cache holds; another layout gets another one.
_LAYOUT = 1


class EtaSurface:
    """The light collection efficiency of one configuration over a range of coefficients.

    The statistical error is the spread between independent batches of photons.
    """

    def __init__(self, grid: Grid, table: EtaGrid) -> None:
        self.grid, self.table = grid, table

    @classmethod
    def of(cls, grid: Grid, *records: PhotonRecords) -> EtaSurface:
        """The surface of one or more launches' records of one configuration."""
        parts = [GridReweighter(launch, grid, batches=launch.batches).table() for launch in records]
        return cls(grid, merged(parts, [launch.photons for launch in records]))

    def evaluate(
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        error: bool = True,
    ) -> EtaPoint:
        """Efficiency, its error and its gradient at one point.

        Raises InputError outside the surface's range, and where its photons say too little; a
        search that only passes through may do without this `check`, and without the `error`, which
        takes most of the time and is NaN then.
        """
        point = alpha_scat_per_cm, alpha_abs_per_cm
        ranges = self.grid.alpha_scat_range_per_cm, self.grid.alpha_abs_range_per_cm
        for name, value, (low, high) in zip((ALPHA_SCAT, ALPHA_ABS), point, ranges, strict=True):
            # a fit's bounds come back from logarithms: allow for their rounding
            if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
                problem = f"{name} = {value:g} is outside {low:g}..{high:g}, what was simulated"
                raise InputError(problem, "simulate a range that holds it")
        if 0.0 < alpha_scat_per_cm < SMALLEST_PER_CM:
            raise InputError(
                f"at alpha_scat_per_cm = {alpha_scat_per_cm:g} light flies too far for photons "
                f"simulated at {SMALLEST_PER_CM:g} /cm",
                "ask for no scattering, or more",
            )
        place = float(self.grid.place_of_scattering(np.array(alpha_scat_per_cm)))
        across = float(self.grid.place_of_absorption(np.array(alpha_abs_per_cm)))
        scattering, by_scattering = self.grid.scattering.weights(place)
        absorption, by_absorption = self.grid.absorption.weights(across)
        log_eta = self.table.log_eta
        eta = math.exp(scattering @ log_eta @ absorption)
        sigma = float(self.relative_sigmas([point])[0]) if check or error else math.nan
        if check and not sigma < _LARGEST_ERROR:
            raise InputError(
                f"at alpha_scat_per_cm = {alpha_scat_per_cm:g}, alpha_abs_per_cm = "
                f"{alpha_abs_per_cm:g} too few photons tell eta: its error is {100 * sigma:.2g} %",
                "simulate more photons, or a scattering and an absorption nearer to these",
            )
        gradient = {
            ALPHA_SCAT: eta * float(by_scattering @ log_eta @ absorption) / math.exp(place),
            ALPHA_ABS: eta * float(scattering @ log_eta @ by_absorption) / math.exp(across),
        }
        return EtaPoint(eta=eta, sigma=sigma * eta, gradient=gradient)

    def answer(self, point: Coefficients) -> EtaPoint | None:
        """`evaluate`; None where it refuses."""
        try:
            return self.evaluate(*point)
        except InputError:
            return None

    def etas(self, points: Sequence[Coefficients]) -> NDArray[np.float64]:
        """(points,) eta, unchecked."""
        return self._etas_by(self._weights(points))

    def batches(self, points: Sequence[Coefficients]) -> NDArray[np.float64]:
        """(batches, points) eta as every batch alone finds it."""
        weights = self._weights(points)
        flat = self.table.deviations.reshape(len(self.table.deviations), -1)
        return self._etas_by(weights) * (1.0 + flat @ weights.T)

    def relative_sigmas(self, points: Sequence[Coefficients]) -> NDArray[np.float64]:
        """(points,) sigma / eta, unchecked; NaN where no light arrives."""
        batches = self.batches(points)
        return standard_error(batches) / batches.mean(axis=0)

    def _weights(self, points: Sequence[Coefficients]) -> NDArray[np.float64]:
        """(points, nodes) weights of the grid's nodes."""
        return self.grid.weights_at(*np.array(points, dtype=np.float64).T)

    def _etas_by(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points,) eta by the weights of the nodes."""
        return np.exp(weights @ self.table.log_eta.ravel())


class Cut(NamedTuple):
    """What of the records counts; None each: all."""

    #: Radius of the hole of a mask, mm.
    mask_mm: float | None = None
    #: Whose light.
    detector: str | None = None


@dataclass(frozen=True)
class GridBlock(LaunchBlock):
    """Launches of photons, answered on a grid for one cut of the records or several."""

    proposals: ScatteringProposals
    grid: Grid
    cuts: tuple[Cut, ...] = (Cut(),)

    def make(self, threads: int | None) -> dict[int, executors.Content]:
        """Simulate; one thread weighs a launch's records while the next one is under way."""
        simulation = self.loaded(threads)  # chooses an LLVM before Dr.Jit is imported
        from mcrim_mitsuba.transport.collection import Recorder

        recorder, detectors = Recorder(simulation), simulation.model.detectors
        columns = [MASK] if any(cut.mask_mm is not None for cut in self.cuts) else []
        columns += [DETECTOR_HIT] if any(cut.detector is not None for cut in self.cuts) else []
        tables: list[Future[EtaGrid]] = []
        with one_thread(), ThreadPoolExecutor(1) as weigher:
            for number, photons in enumerate(self.launches, self.first):
                records = recorder.record(
                    self.proposals, photons, seed=self.seed, number=number, columns=columns
                )
                # two launches' records at most lie in memory
                for before in tables[-1:]:
                    before.result()
                tables.append(weigher.submit(self._tables, records, detectors))
            whole = merged([table.result() for table in tables], self.launches)
        return {self.numbers[0]: content_of(whole)}

    def _tables(self, records: PhotonRecords, detectors: list[str]) -> EtaGrid:
        """Records on the grid, all of their batches kept; its first axis is that of the cuts."""
        gathering = GridReweighter(records, self.grid, batches=records.batches)
        tables = []
        for radius_mm, detector in self.cuts:
            mask = None if radius_mm is None else MASK
            kept = counted(records, mask, radius_mm, detector, detectors)
            tables.append(gathering.table(None if kept is None else kept[gathering.order]))
        return EtaGrid(
            np.stack([table.log_eta for table in tables]),
            np.stack([table.deviations for table in tables], axis=1),
        )


@dataclass(frozen=True)
class EtaRequest:
    """A configuration and what is to be known of it."""

    #: Its name in progress.
    what: str
    scene: SceneFile
    #: Where errors matter.
    points: Sequence[Coefficients]
    #: With its precision, that of every point that photons can answer.
    run: Run
    #: What else may be asked for, in alpha_scat and in alpha_abs; None for the points' own range.
    alpha_scat_range_per_cm: tuple[float, float] | None = None
    alpha_abs_range_per_cm: tuple[float, float] | None = None
    #: To be answered by the same photons, which a mask in the scene must not keep off then, and
    #: whose integrator counts all detectors.
    cuts: tuple[Cut, ...] = (Cut(),)

    @property
    def grid(self) -> Grid:
        """That answers all that may be asked for; long enough to have slopes."""
        scattering, absorption = zip(*self.points, strict=True)
        low, high = self.alpha_scat_range_per_cm or (min(scattering), max(scattering))
        least, most = self.alpha_abs_range_per_cm or (min(absorption), max(absorption))
        return Grid(
            (low, max(high, _SHORTEST * low)), (least, max(most, _SHORTEST * least + _LEAST_PER_CM))
        )


class EtaRun:
    """The photons that shall fulfil a request, more and more of them.

    The scene's own coefficients do not matter.
    """

    def __init__(self, request: EtaRequest) -> None:
        refuse_shared_coefficients(request.scene)
        run = request.run
        self.request, self.most = request, run.photons_or(MOST_PHOTONS)
        self._grid = request.grid
        least_absorption, _ = self._grid.alpha_abs_range_per_cm
        self._proposals = choose_proposals(*self._grid.alpha_scat_range_per_cm, least_absorption)
        self._tables: list[EtaGrid] = []
        self._photons_of: list[int] = []
        self._launches = 0
        #: How many of its photons the cache had.
        self.cached_photons = 0
        #: Largest relative error of the points that can be answered; 0 where that is enough.
        self.worst = math.inf
        key = {
            "what": "eta on a grid",
            "scene": request.scene.content_hash,
            "seed": run.seed,
            "proposals": dataclasses.asdict(self._proposals),
            "grid": dataclasses.asdict(self._grid),
            "cuts": request.cuts,
            "versions": record_versions(run.variant, __name__),
            "layout": _LAYOUT,
        }
        self._cache = executors.current_executor().cache(key)

    @property
    def photons(self) -> int:
        """So far."""
        return sum(self._photons_of)

    @property
    def surfaces(self) -> list[EtaSurface]:
        """Of all photons so far, one for each cut; ValueError if there are none."""
        if not self._tables:
            raise ValueError("nothing was simulated yet")
        whole = merged(self._tables, self._photons_of)
        return [
            EtaSurface(self._grid, EtaGrid(log_eta, whole.deviations[:, number]))
            for number, log_eta in enumerate(whole.log_eta)
        ]

    @property
    def notes(self) -> list[str]:
        """What the user must know of the cache."""
        return list(self._cache.notes)

    def jobs(self, photons: int) -> list[executors.Job]:
        """Units that are missing to have so many photons at least, to be taken in this order."""
        of, run = self.request, self.request.run
        lacking = -(-photons // LANES) * LANES - self.photons
        bench = of.what, of.scene, run.seed, run.variant
        asked = self._proposals, self._grid, of.cuts
        jobs = []
        for number, block in planned(lacking, self._launches, LARGEST_LAUNCH):
            checked = number > 0 or not run.check
            unit = GridBlock(*bench, checked, number, block, *asked)
            jobs.append(executors.Job(unit, self._cache))
        return jobs

    def take(self, done: executors.Finished) -> None:
        """Keep what a unit found."""
        unit = done.job.unit
        assert isinstance(unit, GridBlock)
        (chunk,) = done.chunks.values()
        cuts = len(self.request.cuts)
        self._tables.append(table_of(chunk.arrays, cuts, *self._grid.counts))
        self._photons_of.append(unit.photons)
        self._launches += len(unit.launches)
        self.cached_photons += unit.photons if done.cached else 0

    def look(self) -> None:
        """See what the photons so far tell."""
        sigmas = np.array([s.relative_sigmas(self.request.points) for s in self.surfaces])
        self.worst = float(sigmas[sigmas < _LARGEST_ERROR].max(initial=0.0))

    def goal(self) -> int:
        """Photons to have next."""
        precision = self.request.run.precision
        if precision is None:
            return self.most
        if self.worst <= precision or self.photons >= self.most:
            return 0
        return min(self.most, int(self.photons * (self.worst / precision) ** 2 * _MARGIN))


def record_surface(
    scene: SceneFile, points: Sequence[Coefficients], *, run: Run, **further: Any
) -> tuple[EtaSurface, EtaRun]:
    """One simulation that answers all points; `further` fields are those of an `EtaRequest`.

    Raises InputError if the scene is not sound, leaks, or keeps more light than records may miss.
    """
    return record_surfaces([EtaRequest("simulation", scene, points, run, **further)])[0]


def record_surfaces(requests: Sequence[EtaRequest]) -> list[tuple[EtaSurface, EtaRun]]:
    """One simulation per configuration, all of them at once; see `record_surface`.

    Threads and progress are those of the first.
    """
    runs = [EtaRun(request) for request in requests]
    _extend([(run, min(FIRST_LOOK, run.most)) for run in runs], by_all=True)
    for _ in range(_MOST_ROUNDS):
        goals = [(run, run.goal()) for run in runs]
        lacking = [(run, goal) for run, goal in goals if goal > run.photons]
        if not lacking:
            break
        _extend(lacking)
    return [(run.surfaces[0], run) for run in runs]


def _extend(goals: Sequence[tuple[EtaRun, int]], *, by_all: bool = False) -> None:
    """Have more photons of some configurations, and see what they tell."""
    if not goals:
        return
    of_all = goals[0][0].request.run
    pairs = [(run, job) for run, photons in goals for job in run.jobs(photons)]
    before = {run.request.what: (run, run.photons) for run, _ in goals}

    def report(what: str, done: int, total: int, note: str = "") -> None:
        run, had = before[what]
        if had:
            error = run.worst * math.sqrt(had / (had + done))
            note += f", errors up to {100 * error:.2g} %"
        of_all.tell(what, had + done, had + total, note)

    jobs = [job for _, job in pairs]
    executor = executors.many_units_executor(of_all.threads)
    for done in executor.do(jobs, threads=of_all.threads, by_all=by_all, progress=report):
        pairs[done.index][0].take(done)
    for run, _ in goals:
        run.look()
