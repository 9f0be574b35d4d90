"""Photons launched into a loaded scene: how many at once, what becomes of them, what is handed on.

Every run is a row of launches (`Launcher`). `collect` counts fates until enough are known, a
`Recorder` keeps the histories of detected photons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import arguments_of, signals_wait
from mcrim_mitsuba.transport import loop
from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.bulk import CrystalVolume
from mcrim_mitsuba.transport.flat_path import FlatPath, suits
from mcrim_mitsuba.transport.general_path import GeneralPath
from mcrim_mitsuba.transport.launch_plan import (
    BATCHES,
    FIRST_LAUNCH,
    LANES,
    SHARE_STEPS,
    FateTally,
    PhotonRecords,
    ScatteringProposals,
    detected_by,
    plan_lanes,
)
from mcrim_mitsuba.transport.record_store import TrailStore
from mcrim_mitsuba.transport.scene_model import SceneModel

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation

#: Fraction of lost light above which no number is given: the scene leaks. Below it stands what
#: Mitsuba's own intersection loses at edges by rounding (about one in 5e7 reflections).
MOST_LOST = 1e-4
#: Photons per lane and launch; fixed, because results must not depend on the machine's speed.
PER_LANE_FLAT = 256
#: The same where Mitsuba intersects.
PER_LANE_GENERAL = 128
#: Light of photon records that may be cut off at the depth limit: less than any error that is
#: asked for.
MOST_TRUNCATED = 1e-5
#: Photons that may be in any case: in a short run they are within the error.
FEW_TRUNCATED = 3.0

Progress = Callable[[int, int, float, float], None]


def choose_path(
    model: SceneModel, polarization: bool, general: bool = False, fold: int | None = None
):
    """The fast path where it can follow light through the scene, else the general one.

    `general` asks for this in any case (for cross-checks); `fold` is as of `FlatPath`.
    """
    if suits(model) and not general:
        return FlatPath(model, polarization, fold)
    return GeneralPath(model, polarization, trace_all=general)


class Launcher:
    """Launches photons into a crystal's scene; without `fold` they fly to every reflection."""

    @signals_wait()
    def __init__(
        self,
        crystal: CrystalVolume,
        polarization: bool,
        general: bool = False,
        *,
        fold: bool = True,
    ) -> None:
        self._crystal, model, counted = crystal, crystal.model, "detected"
        volume = crystal.volume if fold else None
        #: As `choose_path` chooses.
        self.path = choose_path(model, polarization, general, volume)
        if model.counted is not None and len(model.detectors) > 1:
            counted = detected_by(model.detectors[model.counted])
        #: Of all launches so far; eta is what the integrator counts.
        self.tally = FateTally(head_on=model.head_on, counted=counted)

    @property
    def size(self) -> int:
        """Photons of a launch, the first one of a run left out."""
        fast = isinstance(self.path, FlatPath)
        return LANES * (PER_LANE_FLAT if fast else PER_LANE_GENERAL)

    @signals_wait()
    def launch(
        self,
        photons: int,
        *,
        proposals: ScatteringProposals | None = None,
        batches: int = BATCHES,
        may_leak: bool = False,
        **options,
    ) -> loop.Launch:
        """Follow photons, shared out in `batches` by `launch_plan.plan_lanes`.

        `proposals` are in place of the scene's own coefficients of the crystal: with several the
        photons are a multiple of the lanes. `options`, ``seed`` among them, are those of
        `loop.Loop`.

        Raises InputError if the scene leaks, unless it `may_leak`, or does not have a record
        column.
        """
        units = (SHARE_STEPS,) if proposals is None else proposals.units
        plan = plan_lanes(photons, units, batches)
        launch = loop.launch(self.path, self._crystal, plan, proposals=proposals, **options)
        self.tally.add(launch.photons_per_batch, launch.weights)
        lost = self.tally.fraction("lost")
        if lost > MOST_LOST and not may_leak:
            problem = f"{100 * lost:.3g} % of the light left a volume without crossing a face"
            mend = "run `mcrim check` on the scene: a face is missing, reversed or too small"
            raise InputError(problem, mend)
        return launch

    def launches(
        self, photons: int, *, first: int = FIRST_LAUNCH, precision: float | None = None, **options
    ) -> Iterator[loop.Launch]:
        """Launches until so many photons are followed, the `first` of another size.

        Or until eta is known to a relative precision; `options` are those of `launch`.
        """
        done = number = 0
        while done < photons and not self.tally.reaches(precision):
            chunk = min(self.size if number else first, photons - done)
            if precision is not None and number:
                chunk = min(chunk, self.tally.lacking(precision))
            yield self.launch(chunk, number=number, **options)
            done, number = done + chunk, number + 1


def collect(
    launcher: Launcher,
    photons: float,
    *,
    seed: int,
    max_depth: int,
    precision: float | None = None,
    progress: Progress | None = None,
) -> bool:
    """Fill a fresh launcher's tally, as `Simulation.collect`; whether the user interrupted."""
    photons, seed = arguments_of(photons, seed)
    tally, options = launcher.tally, {"seed": seed, "max_depth": max_depth}
    try:
        for _ in launcher.launches(photons, precision=precision, **options):
            if progress is not None:
                progress(tally.photons, photons, tally.eta, tally.eta_sigma)
    except KeyboardInterrupt:
        if tally.photons == 0:
            raise
        return True
    return False


def slope_along(
    launcher: Launcher,
    tangent: Mapping[int, Sequence[float]],
    photons: int,
    *,
    seed: int,
    max_depth: int,
) -> tuple[float, float]:
    """Derivative of eta along a `tangent` of coefficients (`loop.Loop`), and its standard error."""
    photons, seed = arguments_of(photons, seed)
    slopes = FateTally(head_on=launcher.tally.head_on)
    launches = launcher.launches(
        photons, first=launcher.size, seed=seed, max_depth=max_depth, tangent=tangent
    )
    for launch in launches:
        assert launch.detected_slope is not None
        slopes.add(launch.photons_per_batch, {"detected": launch.detected_slope})
    return slopes.eta, slopes.eta_sigma


class Recorder:
    """Simulates photon records of a configuration, launch by launch, whatever its coefficients."""

    def __init__(self, simulation: Simulation, *, fold: bool = True) -> None:
        self._simulation, self._launcher = simulation, simulation.launcher(fold=fold)

    def record(
        self,
        proposals: ScatteringProposals,
        photons: int,
        *,
        seed: int,
        number: int,
        columns: Sequence[str] = (),
        batches: int = BATCHES,
    ) -> PhotonRecords:
        """Histories of the photons, a multiple of the lanes, of one launch that are detected.

        Shares of the `proposals` and `batches` are as of `launch_plan.plan_lanes`: fewer batches
        have fewer lanes, which wait less for each other. `columns` are what ``further`` of the
        records holds, see `record_store.RecordStore`; where the crystal scatters unevenly, it
        always holds ``scattering_path_cm``.

        Raises InputError if the scene leaks, keeps more light than records may miss, or does not
        have a column.
        """
        # Scattered light gets out in the end; what is cut off would be missing at every alpha.
        max_depth = self._simulation.integrator.depth_limit(scatters=True)
        further = self._launcher.launch(
            photons,
            seed=seed,
            number=number,
            max_depth=max_depth,
            proposals=proposals,
            batches=batches,
            columns=columns,
        ).records
        tally = self._launcher.tally
        truncated = tally.fraction("truncated")
        if truncated > max(MOST_TRUNCATED, FEW_TRUNCATED / tally.photons):
            raise InputError(
                f"{100 * truncated:.2g} % of the light was still under way after "
                f"{max_depth:,} flights",
                "raise max_depth of the integrator, or ask for more absorption",
                path=self._simulation.file.path,
            )
        return PhotonRecords(
            **{name: further.pop(name) for name in ("k", "path_cm", "w", "batch")},
            batches=batches,
            photons_per_proposal=np.array(proposals.units) * (photons // sum(proposals.units)),
            alpha_scat_proposals_per_cm=np.array(proposals.alpha_scat_per_cm),
            alpha_abs_proposal_per_cm=proposals.alpha_abs_per_cm,
            further=further,
        )


# Trails of photons: all of their straight flights, from birth to their fate.

#: Flights of which trails keep the starts: more than a picture could show.
FLIGHTS_KEPT = 64


@dataclass(frozen=True, eq=False)
class Trails:
    """Trails of independent photons, each with one fate."""

    #: ndarray of str, shape (photons,): as in `results.SimulationResult.budget`.
    fates: np.ndarray
    #: ndarray of int, shape (photons,): all of them, also those that are not kept.
    flights: np.ndarray
    #: ndarray of float64, shape (photons, FLIGHTS_KEPT, 4): Where flights begin, mm, and the
    #: number, among ``model.volumes``, of the volume that each goes through; then anything.
    starts: np.ndarray
    _ends: np.ndarray
    _directions: np.ndarray

    @property
    def shares(self) -> dict[str, float]:
        """Fraction of the photons that met each fate, of those that occurred."""
        names, counts = np.unique(self.fates, return_counts=True)
        parts = (counts / len(self.fates)).tolist()
        return dict(zip(names.tolist(), parts, strict=True))

    def ways(self, most: int, away_mm: float) -> np.ndarray:
        """Points (mm) of all trails, of `most` flights at most: (photons, most + 1, 3), then NaN.

        An escaping photon's last flight, which has no end, goes on for `away_mm`; `most` is less
        than `FLIGHTS_KEPT`.
        """
        points = self.starts[:, : most + 1, :3].copy()
        points[np.arange(most + 1) >= self.flights[:, None]] = np.nan
        whole = np.flatnonzero(self.flights <= most)
        away = np.where(self.fates == "escaped", away_mm, 0.0)[whole, None]
        points[whole, self.flights[whole]] = self._ends[whole] + away * self._directions[whole]
        return points


def follow_trails(simulation: Simulation, photons: int = LANES, *, seed: int = 0) -> Trails:
    """Follow photons by the transport that simulates, and write down where they fly.

    Absorption takes photons whole here, where simulations lower their weights: shares of fates are
    the same but for their larger errors. A photon takes 1 kB.
    """
    store = TrailStore(photons, FLIGHTS_KEPT)
    simulation.launcher(fold=False).launch(
        photons, seed=seed, number=0, max_depth=simulation.depth_limit, may_leak=True, trails=store
    )
    starts, ends, last = (
        np.array(table, dtype=np.float64).reshape(-1, 4) for table in store.tables
    )
    volume, code = np.divmod(ends[:, 3].astype(int), TrailStore.CODES)
    volumes = simulation.model.volume_names
    fates = [
        f"absorbed_{volumes[v]}" if c == physics.VOLUME else loop.SURFACE_FATES[c]
        for v, c in zip(volume, code, strict=True)
    ]
    flights, by_photon = last[:, 3].astype(int), starts.reshape(photons, FLIGHTS_KEPT, 4)
    return Trails(np.array(fates), flights, by_photon, ends[:, :3], last[:, :3])
