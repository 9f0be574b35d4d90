"""Photon records of one configuration: from the cache where they are, else simulated."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.cache import RecordCache, record_versions
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.fit.cells import CellSums
from mcrim_mitsuba.fit.proposals import Proposals, choose_proposals, improve_shares
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.fit.reweighting import EtaSurface, largest_coefficient
from mcrim_mitsuba.kernel.lane_plan import FIRST_LAUNCH, LANES, UNITS
from mcrim_mitsuba.kernel.variants import DEFAULT_VARIANT

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
#: Number of what `_to_chunk` writes; another layout gets another one.
_LAYOUT = 2
#: Points at which shares are judged.
_MOST_DESIGN_POINTS = 16

Progress = Callable[[int, int], None]
Point = tuple[float, float]


@dataclass(frozen=True)
class RunOptions:
    """What all runs of a job have in common.

    Attributes
    ----------
    seed : int
    variant : str
    threads : int or None
    check : bool
        Whether scenes that are simulated are checked first.
    """

    seed: int = 0
    variant: str = DEFAULT_VARIANT
    threads: int | None = None
    check: bool = True


class RecordRun:
    """Photon records of one configuration, extended until they answer well enough.

    Parameters
    ----------
    scene : SceneFile
        Its own coefficients do not matter.
    proposals : Proposals
        With shares in units of 1 / `kernel.lane_plan.UNITS`.
    options : RunOptions

    Attributes
    ----------
    photons, cached_photons : int
        Photons of the records, and how many of them the cache had.
    trouble : str or None
        Why the cache could not be used.
    """

    def __init__(self, scene: SceneFile, proposals: Proposals, options: RunOptions) -> None:
        self._scene = scene
        self._options = options
        self._recorder = None
        self._number = 0
        self._sums: CellSums | None = None
        self.photons = self.cached_photons = 0
        self.trouble: str | None = None
        self.use(proposals)

    def use(self, proposals: Proposals) -> None:
        """Draw further photons with other shares of the same proposals."""
        self._proposals = proposals
        self._cache = RecordCache(
            {
                "scene": self._scene.content_hash,
                "seed": self._options.seed,
                "proposals": dataclasses.asdict(proposals),
                "versions": record_versions(self._options.variant),
                "layout": _LAYOUT,
            }
        )

    @property
    def surface(self) -> EtaSurface:
        """Of all photons so far."""
        return EtaSurface(self._sums)

    def extend(self, photons: int, progress: Progress | None = None) -> None:
        """Record more photons.

        Parameters
        ----------
        photons : int
            To have at least, those so far included.
        progress : callable, optional
            ``progress(done, photons)`` after each launch.

        Raises
        ------
        InputError
            If the scene is not sound, leaks, or keeps more light than records may miss.
        """
        photons = -(-photons // LANES) * LANES
        # one thread keeps and gathers a launch's records while the next one is under way
        with ThreadPoolExecutor(1) as keeper:
            kept: Future | None = None
            while self.photons < photons:
                largest = LARGEST_LAUNCH if self._number else FIRST_LAUNCH
                records, cached = self._launch(min(largest, photons - self.photons))
                if kept is not None:
                    kept.result()
                kept = keeper.submit(self._keep, self._number, records, cached)
                self._number += 1
                self.photons += records.photons
                if progress is not None:
                    progress(self.photons, photons)
            if kept is not None:
                kept.result()

    def _launch(self, photons: int) -> tuple[PhotonRecords, bool]:
        """The next launch, and whether the cache had it."""
        chunk = self._cache.read(self._number)
        if chunk is not None and chunk.metadata["photons"] == photons:
            return _from_chunk(chunk), True
        return self._simulated().record(
            self._proposals, photons, seed=self._options.seed, number=self._number
        ), False

    def _keep(self, number: int, records: PhotonRecords, cached: bool) -> None:
        """Write a launch's records to the cache, and gather them."""
        if cached:
            self.cached_photons += records.photons
        else:
            self._cache.write(number, *_to_chunk(records))
            self.trouble = self.trouble or self._cache.trouble
        if self._sums is None:
            self._sums = CellSums(records, largest_coefficient(records))
        else:
            self._sums.add(records)

    def _simulated(self):
        """The recorder; loading a scene takes a second, which cached records do without."""
        if self._recorder is None:
            from mcrim_mitsuba.kernel.records import Recorder
            from mcrim_mitsuba.kernel.simulation import Simulation

            self._recorder = Recorder(
                Simulation(
                    self._scene,
                    variant=self._options.variant,
                    threads=self._options.threads,
                    check=self._options.check,
                )
            )
        return self._recorder


def surfaces_answer(scene: SceneFile) -> bool:
    """Whether `record_surface` serves a scene: not where scattering has a gradient.

    There the path that scattering counts is another one than that which absorption does, and a
    surface knows one path only. (Tables of responses know both.)
    """
    return not any(
        element.get("name") == "scattering_gradient" and float(element.get("value")) != 0.0
        for element in scene.root.iter("float")
    )


def record_surface(
    scene: SceneFile,
    points: Sequence[Point],
    *,
    photons: int | None = None,
    precision: float | None = None,
    alpha_scat_range_per_cm: tuple[float, float] | None = None,
    options: RunOptions,
    progress: Progress | None = None,
) -> tuple[EtaSurface, RecordRun]:
    """One simulation that answers all points.

    Parameters
    ----------
    scene : SceneFile
    points : sequence of (alpha_scat_per_cm, alpha_abs_per_cm)
        Where errors matter; alpha_scat above 0.
    photons : int, optional
        To spend; with `precision`, at most.
    precision : float, optional
        Wanted relative standard error of every point that records can answer.
    alpha_scat_range_per_cm : tuple of float, optional
        What else may be asked for; the points' own range when not given.
    options : RunOptions
    progress : callable, optional
        ``progress(done, photons)`` after each launch.

    Raises
    ------
    InputError
        As `RecordRun.extend`, and where `surfaces_answer` says no.
    """
    if not surfaces_answer(scene):
        raise InputError(
            "one surface cannot answer for scattering with a gradient",
            "simulate each point on its own", path=scene.path,
        )  # fmt: skip
    most = photons or MOST_PHOTONS
    scattering, absorption = (sorted({point[i] for point in points}) for i in (0, 1))
    low, high = alpha_scat_range_per_cm or (scattering[0], scattering[-1])
    run = RecordRun(scene, choose_proposals(low, high, absorption[0], UNITS), options)
    run.extend(min(FIRST_LOOK, most), progress)
    surface = run.surface
    if run.photons < most:
        run.use(improve_shares(surface, _design_points(scattering, absorption), UNITS))
    if precision is None:
        run.extend(most, progress)
        return run.surface, run
    # the first look's error was that of other shares: a good part of the way, then look again
    margin = _FIRST_STEP
    for _ in range(_MOST_ROUNDS):
        worst = _worst(surface, points, precision)
        if worst <= precision or run.photons >= most:
            break
        run.extend(min(most, int(run.photons * margin * (worst / precision) ** 2)), progress)
        surface, margin = run.surface, _MARGIN
    return surface, run


def _worst(surface: EtaSurface, points: Sequence[Point], enough: float) -> float:
    """Largest relative error of the points that the surface answers; 0 if none exceeds `enough`."""
    sigmas = surface.relative_sigmas(points)
    for i in np.argsort(-np.nan_to_num(sigmas, nan=0.0)):
        if not sigmas[i] > enough:
            break
        if surface.answers(*points[i]):
            return float(sigmas[i])
    return 0.0


def _design_points(scattering: list[float], absorption: list[float]) -> list[Point]:
    """Some of all points: where errors are largest is smooth in both coefficients."""
    ends = sorted({absorption[0], absorption[-1]})
    count = min(len(scattering), _MOST_DESIGN_POINTS // len(ends))
    chosen = np.unique(np.linspace(0, len(scattering) - 1, count).round().astype(int))
    return [(scattering[i], a) for a in ends for i in chosen]


def _to_chunk(records: PhotonRecords) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    arrays = {name: getattr(records, name) for name in ("k", "path_cm", "w", "batch")}
    metadata = {
        "photons": records.photons,
        "batches": records.batches,
        "photons_per_proposal": records.photons_per_proposal.tolist(),
        "alpha_scat_proposals_per_cm": records.alpha_scat_proposals_per_cm.tolist(),
        "alpha_abs_proposal_per_cm": records.alpha_abs_proposal_per_cm,
    }
    return arrays | dict(records.further), metadata


def _from_chunk(chunk) -> PhotonRecords:
    arrays, metadata = dict(chunk.arrays), dict(chunk.metadata)
    metadata.pop("photons")
    core = {name: arrays.pop(name) for name in ("k", "path_cm", "w", "batch")}
    return PhotonRecords(**core, **metadata, further=arrays)
