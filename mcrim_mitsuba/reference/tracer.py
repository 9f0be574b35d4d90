"""Trace many photons over a bench's faces, by threads."""

from __future__ import annotations

import contextlib
import operator
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM, Value
from mcrim_mitsuba.core.run import processors
from mcrim_mitsuba.reference import walk
from mcrim_mitsuba.reference.compiling import say_if_slow
from mcrim_mitsuba.reference.faces import FacedBench, Floats
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

#: Flights after which a photon is given up, where nothing is said of it.
MOST_FLIGHTS = 2000
#: Photons that a thread follows at a time.
_BLOCK = 16_384
_FATES = {
    walk.DETECTED: "detected",
    walk.APERTURE: "absorbed_aperture",
    walk.REFLECTOR: "absorbed_reflector",
    walk.SURFACE: "absorbed_surface",
    walk.ESCAPED: "escaped",
    walk.TRUNCATED: "truncated",
    walk.LOST: "lost",
}


@dataclass(frozen=True, eq=False)
class DetectedHistories:
    """What each detected photon went through, for reweighting.

    A photon's weight under other coefficients is (scat'/scat)^scatterings
    exp(-(scat' - scat) scattering_path_cm) exp(-(abs' - abs) path_cm): the
    tracer itself absorbs with abs. And a run whose mask leaves the whole plate
    free answers every aperture: keep the photons with mask_radius_mm up to its
    radius.
    """

    #: (detected,) int32: Number of bulk scatterings.
    scatterings: NDArray[np.int32]
    #: (detected,) float64: Path in the crystal.
    path_cm: Floats
    #: (detected,) float64: The same, weighted with the scattering's strength relative to that at
    #: middle height, at the band's maximum; equal to ``path_cm`` where all is even.
    scattering_path_cm: Floats
    #: (detected,) float64: Largest distance from the axis at which the photon met the mask's plane,
    #: from either side: the plate's entrance face or, with ``aperture_at_detector``, its back face.
    mask_radius_mm: Floats
    #: (detected,) float64: Cosine of the angle to the detector's normal, in the plate; behind a
    #: beam, in air.
    arrival_cosine: Floats
    #: (detected,) float64: Distance from the axis at which the photon was detected.
    arrival_radius_mm: Floats
    #: (detected,) str: Id of the detector.
    detector: NDArray[np.str_]


@dataclass(frozen=True)
class FateCounts:
    """How often each fate was met."""

    photons: int
    seed: int
    #: Photons by fate; the values add up to ``photons``.
    counts: dict[str, int]
    #: Part that the detector detects of what arrives head-on; it was calibrated so.
    head_on: float = field(default=1.0, kw_only=True)
    #: Detected photons by the ids of detectors, and the one that eta is of; empty: of all.
    detectors: dict[str, int] = field(default_factory=dict, kw_only=True)
    read: str = field(default="", kw_only=True)

    @property
    def budget(self) -> dict[str, float]:
        """Fraction of the emitted photons by fate."""
        return {fate: count / self.photons for fate, count in self.counts.items()}

    @property
    def budget_sigma(self) -> dict[str, float]:
        """Standard deviation of each fraction.

        That of the binomial proportion's posterior under a uniform prior,
        Beta(k + 1, n - k + 1): sqrt(k (n - k) / n^3) for large counts, and
        about 1/n rather than 0 when no photon, or every one, met that fate.
        """
        return {fate: self._sigma(count) for fate, count in self.counts.items()}

    def _sigma(self, count: int) -> float:
        n = self.photons
        return float(((count + 1) * (n - count + 1) / ((n + 2) ** 2 * (n + 3))) ** 0.5)

    @property
    def _counted(self) -> int:
        return self.detectors[self.read] if self.read else self.counts["detected"]

    @property
    def eta(self) -> float:
        """Light collection efficiency: detected over emitted, relative to light head-on."""
        return self._counted / self.photons / self.head_on

    @property
    def eta_sigma(self) -> float:
        """Standard deviation of `eta`."""
        return self._sigma(self._counted) / self.head_on


@dataclass(frozen=True)
class TracerResult(FateCounts):
    """Every photon's fate, counted.

    The fates: detected, absorbed_aperture, absorbed_reflector, absorbed_surface (losses at the
    crystal's faces and what the detector refuses), escaped, truncated (still on their way after
    the largest number of flights), lost (numerically astray: an error of ours if it is not 0) and
    ``absorbed_`` with the name of each volume.
    """

    #: None unless asked for. Results are compared without them.
    histories: DetectedHistories | None = field(default=None, compare=False)


def whole_number(name: str, value: Any, lowest: int) -> int:
    """`value` as an int of at least `lowest`; InputError if it is none."""
    with contextlib.suppress(TypeError):
        if not isinstance(value, bool) and operator.index(value) >= lowest:
            return operator.index(value)
    raise InputError(
        f"{name} = {value!r} cannot be used", f"give a whole number, at least {lowest}"
    )


def trace(
    bench: str | Path | SceneFile | FacedBench,
    photons: int,
    seed: int,
    *,
    overrides: Mapping[str, Value] | None = None,
    max_depth: int | None = None,
    histories: bool = False,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> TracerResult:
    """Trace photons from birth to fate: analog Monte Carlo, one fate each.

    The bench is a sound scene, whose parameters `overrides` may change, or given by its faces. The
    same seed gives the same fates whatever the threads (all processors, if not given): each photon
    has a generator of its own. After `max_depth` straight flights (what the scene says, else 2000)
    a photon counts as truncated: light that total reflection traps in a clear crystal ends so.
    `histories`, what the detected ones went through, take 60 bytes each. `progress` is called now
    and then with the number of photons done, at last with `photons`.

    Raises InputError if the tracer does not know a part of the scene, which it names, or one of the
    whole numbers is none, or too small.
    """
    photons, seed = whole_number("photons", photons, 1), whole_number("seed", seed, 0)
    if not isinstance(bench, FacedBench):
        bench = read_bench(read_scene(bench, overrides))
    if max_depth is None:
        max_depth = bench.most_flights or MOST_FLIGHTS
    max_depth = whole_number("max_depth", max_depth, 1)
    say_if_slow()
    tables, birth = bench.tables()
    root = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]

    def walked(first: int, count: int) -> tuple[NDArray[np.int64], Floats]:
        """Fates and records of so many photons from one on."""
        fates, records = np.empty(count, np.int64), np.empty((count, walk.RECORDED))
        # the generator's words overflow, as they shall
        with np.errstate(over="ignore"):
            rng, number = np.empty(1, np.uint64), np.uint64(first)
            walk.follow(
                tables, birth, rng, root, number, max_depth, bench.polarised, fates, records
            )
        return fates, records

    def block(first: int) -> tuple[Counter[int], Counter[int], Floats]:
        """Fates, detections by surface, and records of the detected, of photons from one on."""
        fates, records = walked(first, min(_BLOCK, photons - first))
        detected = records[fates == walk.DETECTED]
        places = Counter(detected[:, walk.PLACE].astype(int).tolist())
        return Counter(fates.tolist()), places, detected if histories else detected[:0]

    # numba compiles here, of no photons: several threads at it stumble over each other
    walked(0, 0)
    fates, places, records, done = Counter[int](), Counter[int](), [], 0
    pool = ThreadPoolExecutor(threads or processors())
    try:
        for own_fates, own_places, detected in pool.map(block, range(0, photons, _BLOCK)):
            fates += own_fates
            places += own_places
            records.append(detected)
            done += sum(own_fates.values())
            if progress is not None:
                progress(done)
    finally:
        pool.shutdown(cancel_futures=True)
    counts = {name: fates[fate] for fate, name in _FATES.items()}
    for number, volume in enumerate(bench.volume_names[1:], start=1):
        counts[f"absorbed_{volume}"] = fates[walk.ABSORBED + number]
    return TracerResult(
        photons,
        seed,
        counts,
        _histories(np.concatenate(records), bench.detectors) if histories else None,
        head_on=bench.head_on,
        detectors={name: places[number] for number, name in bench.detectors.items()},
        read=bench.read,
    )


def _histories(records: Floats, detectors: dict[int, str]) -> DetectedHistories:
    """Of rows of records."""
    return DetectedHistories(
        scatterings=records[:, walk.SCATTERINGS].astype(np.int32),
        path_cm=records[:, walk.PATH] / MM_PER_CM,
        scattering_path_cm=records[:, walk.SCATTERING_PATH] / MM_PER_CM,
        mask_radius_mm=records[:, walk.MASK_RADIUS],
        arrival_cosine=records[:, walk.COSINE],
        arrival_radius_mm=records[:, walk.RADIUS],
        detector=np.array([detectors[int(n)] for n in records[:, walk.PLACE]], dtype=np.str_),
    )
