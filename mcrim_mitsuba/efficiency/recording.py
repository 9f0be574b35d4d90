"""Photon records of configurations: from the cache where they are, else simulated in units."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.cells import CellSums
from mcrim_mitsuba.efficiency.reweighting import EtaSurface, choose_proposals, improve_shares
from mcrim_mitsuba.efficiency.surface import Coefficients
from mcrim_mitsuba.runs.cache import RecordCache, record_versions
from mcrim_mitsuba.runs.executors import Content, Finished, Job, current_executor
from mcrim_mitsuba.runs.scene_units import LaunchBlock, planned
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.launch_plan import LANES, PhotonRecords, ScatteringProposals


@dataclass(frozen=True)
class RecordBlock(LaunchBlock):
    """Launches of photon records, gathered in cells."""

    proposals: ScatteringProposals

    def make(self, threads: int | None) -> dict[int, Content]:
        """Simulate; one thread gathers a launch's records while the next one is under way."""
        from mcrim_mitsuba.transport.collection import Recorder

        recorder = Recorder(self.loaded(threads))
        pending: Future[CellSums] | None = None
        with ThreadPoolExecutor(1) as gatherer:
            for number, photons in enumerate(self.launches, self.first):
                records = recorder.record(self.proposals, photons, seed=self.seed, number=number)
                gathered = None if pending is None else pending.result()
                pending = gatherer.submit(_gather, gathered, records)
            assert pending is not None
            return {self.numbers[0]: pending.result().to_arrays()}


def _gather(gathered: CellSums | None, records: PhotonRecords) -> CellSums:
    if gathered is None:
        return CellSums(records)
    gathered.add(records)
    return gathered


#: Photons of a first look, which shows how best to share out the others.
FIRST_LOOK = 262_144
#: The most photons of a launch; fixed, so that longer runs begin with the same launches.
LARGEST_LAUNCH = 2_097_152
#: The most that a wanted precision may cost.
MOST_PHOTONS = 400_000_000
#: Rounds of simulating more, each with a better idea of how many photons are lacking.
_MOST_ROUNDS = 6
#: More photons than are lacking by the present error, which has an error itself.
_MARGIN = 1.06
#: Part of the photons that the first look's error asks for, to be spent before looking again.
_FIRST_STEP = 0.6
#: Number of what the cache holds; another layout gets another one.
_LAYOUT = 4
#: Points at which shares are judged.
_MOST_DESIGN_POINTS = 16

#: What lets some places, or some of the light, scatter more than others.
_UNEVEN = ("scattering_gradient", "scattering_exponent")


class RecordRun:
    """Photon records of one configuration, extended until they answer well enough.

    The scene's own coefficients do not matter, nor do the photons and the precision of `run`.
    Proposals have shares in units of 1 / `launch_plan.SHARE_STEPS`; `what` is its name in progress.
    """

    def __init__(
        self, scene: SceneFile, proposals: ScatteringProposals, run: Run, what: str = "simulation"
    ) -> None:
        self.what = what
        self._scene = scene
        self._run = run
        self._launches = 0
        self._sums: CellSums | None = None
        self._caches: list[RecordCache] = []
        #: Photons of the records, and how many of them the cache had.
        self.photons = self.cached_photons = 0
        self.use(proposals)

    def use(self, proposals: ScatteringProposals) -> None:
        """Draw further photons with other shares of the same proposals."""
        self._proposals = proposals
        self._cache = current_executor().cache(
            {
                "scene": self._scene.content_hash,
                "seed": self._run.seed,
                "proposals": dataclasses.asdict(proposals),
                "versions": record_versions(self._run.variant, __name__),
                "layout": _LAYOUT,
            }
        )
        self._caches.append(self._cache)

    @property
    def surface(self) -> EtaSurface:
        """Of all photons so far; ValueError if there are none."""
        if self._sums is None:
            raise ValueError("nothing was simulated yet")
        return EtaSurface(self._sums)

    @property
    def notes(self) -> list[str]:
        """What the user must know of the cache."""
        return list(dict.fromkeys(note for cache in self._caches for note in cache.notes))

    def extend(self, photons: int) -> None:
        """Record more, to have so many photons at least, those so far included.

        Raises InputError if the scene is not sound, leaks, or keeps more light than records may
        miss.
        """
        for done in current_executor().do(
            self.jobs(photons), threads=self._run.threads, progress=self._run.progress
        ):
            self.take(done)

    def jobs(self, photons: int) -> list[Job]:
        """Units that are missing to have so many photons at least, to be taken in this order."""
        lacking = -(-photons // LANES) * LANES - self.photons
        jobs = []
        for number, block in planned(lacking, self._launches, LARGEST_LAUNCH):
            unit = RecordBlock(
                self.what,
                self._scene,
                self._run.seed,
                self._run.variant,
                number > 0 or not self._run.check,
                number,
                block,
                self._proposals,
            )
            jobs.append(Job(unit, self._cache))
        return jobs

    def take(self, done: Finished) -> None:
        """Gather what a unit found."""
        unit = done.job.unit
        assert isinstance(unit, RecordBlock)
        (chunk,) = done.chunks.values()
        found = CellSums.from_arrays(chunk.arrays, chunk.metadata)
        if self._sums is None:
            self._sums = found
        else:
            self._sums.merge(found)
        self._launches += len(unit.launches)
        self.photons += unit.photons
        self.cached_photons += unit.photons if done.cached else 0


def surfaces_answer(scene: SceneFile) -> bool:
    """Whether `record_surface` serves a scene: not where scattering is uneven.

    There the path that scattering counts is another one than that which absorption does, and a
    surface knows one path only. (Tables of responses know both.)
    """
    for element in scene.root.iter("float"):
        name = element.get("name")
        if name in _UNEVEN:
            path, line = scene.place_of(element)
            if parse_number(name, element.get("value", ""), path=path, line=line) != 0.0:
                return False
    return True


@dataclass(frozen=True)
class EtaRequest:
    """A configuration and what is to be known of it."""

    #: Its name in progress.
    what: str
    scene: SceneFile
    #: Where errors matter; alpha_scat above 0.
    points: Sequence[Coefficients]
    #: With its precision, that of every point that records can answer.
    run: Run
    #: What else may be asked for; None for the points' own range.
    alpha_scat_range_per_cm: tuple[float, float] | None = None


def record_surface(
    scene: SceneFile,
    points: Sequence[Coefficients],
    *,
    run: Run,
    alpha_scat_range_per_cm: tuple[float, float] | None = None,
) -> tuple[EtaSurface, RecordRun]:
    """One simulation that answers all points.

    Parameters
    ----------
    scene, points, run, alpha_scat_range_per_cm
        See `EtaRequest`.

    Raises
    ------
    InputError
        As `RecordRun.extend`, and where `surfaces_answer` says no.
    """
    return record_surfaces([EtaRequest("simulation", scene, points, run, alpha_scat_range_per_cm)])[
        0
    ]


def record_surfaces(wishes: Sequence[EtaRequest]) -> list[tuple[EtaSurface, RecordRun]]:
    """One simulation per configuration, all of them at once; see `record_surface`.

    Threads and progress are those of the first.
    """
    looks = [AdaptiveRun(wish) for wish in wishes]
    _extend([(look, min(FIRST_LOOK, look.most)) for look in looks], by_all=True)
    for look in looks:
        look.share_out()
    for _ in range(_MOST_ROUNDS):
        goals = [(look, look.goal()) for look in looks]
        lacking = [(look, goal) for look, goal in goals if goal > look.photons]
        if not lacking:
            break
        _extend(lacking)
    return [(look.seen, look) for look in looks]


class AdaptiveRun(RecordRun):
    """The run that shall fulfil a wish."""

    def __init__(self, wish: EtaRequest) -> None:
        if not surfaces_answer(wish.scene):
            problem = "one surface cannot answer for scattering that is uneven"
            raise InputError(problem, "simulate each point on its own", path=wish.scene.path)
        self.wish, self.most = wish, wish.run.photons_or(MOST_PHOTONS)
        self._scattering, self._absorption = (
            sorted({point[i] for point in wish.points}) for i in (0, 1)
        )
        ends = self._scattering[0], self._scattering[-1]
        low, high = wish.alpha_scat_range_per_cm or ends
        proposals = choose_proposals(low, high, self._absorption[0])
        super().__init__(wish.scene, proposals, wish.run, wish.what)
        #: Largest error of all photons that may come, times the root of their number.
        self.noise: float | None = None
        # the first look's error is that of other shares: a good part of the way, then look again
        self._margin = _FIRST_STEP

    def look(self) -> None:
        """See what the records so far tell."""
        self.seen = self.surface
        precision = self.wish.run.precision
        if precision is not None:
            self._worst = _worst(self.seen, self.wish.points, precision)

    def share_out(self) -> None:
        """Let further photons go where they are needed."""
        points = _design_points(self._scattering, self._absorption)
        self.noise = _worst(self.seen, points, 0.0) * math.sqrt(self.photons)
        if self.photons < self.most:
            self.use(improve_shares(self.seen, points))

    def goal(self) -> int:
        """Photons to have next."""
        precision = self.wish.run.precision
        if precision is None:
            return self.most
        if self._worst <= precision or self.photons >= self.most:
            return 0
        lacking = (self._worst / precision) ** 2
        margin = self._margin if self._margin * lacking > 1.0 else _MARGIN
        self._margin = _MARGIN
        return min(self.most, int(self.photons * lacking * margin))


def _extend(goals: Sequence[tuple[AdaptiveRun, int]], *, by_all: bool = False) -> None:
    """Have more photons of some configurations, and see what they tell."""
    if not goals:
        return
    run = goals[0][0].wish.run
    pairs = [(look, job) for look, photons in goals for job in look.jobs(photons)]
    before = {look.what: (look, look.photons) for look, _ in goals}

    def report(what: str, done: int, total: int, note: str = "") -> None:
        look, had = before[what]
        if look.noise is not None:
            note += f", errors up to {100 * look.noise / math.sqrt(had + done):.2g} %"
        run.tell(what, had + done, had + total, note)

    jobs = [job for _, job in pairs]
    for done in current_executor().do(jobs, threads=run.threads, by_all=by_all, progress=report):
        pairs[done.index][0].take(done)
    for look, _ in goals:
        look.look()


def _worst(surface: EtaSurface, points: Sequence[Coefficients], enough: float) -> float:
    """Largest relative error of the points that the surface answers; 0 if none exceeds `enough`."""
    sigmas = surface.relative_sigmas(points)
    for i in np.argsort(-np.nan_to_num(sigmas, nan=0.0)):
        if not sigmas[i] > enough:
            break
        if surface.answer(points[i]) is not None:
            return float(sigmas[i])
    return 0.0


def _design_points(scattering: list[float], absorption: list[float]) -> list[Coefficients]:
    """Some of all points: where errors are largest is smooth in both coefficients."""
    ends = sorted({absorption[0], absorption[-1]})
    count = min(len(scattering), _MOST_DESIGN_POINTS // len(ends))
    chosen = np.unique(np.linspace(0, len(scattering) - 1, count).round().astype(int))
    return [(scattering[i], a) for a in ends for i in chosen]
