"""Trace many photons over a bench's faces, by threads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import whole_of
from mcrim_mitsuba.core.run import arguments_of, processors
from mcrim_mitsuba.reference import walk
from mcrim_mitsuba.reference.compiling import say_if_slow
from mcrim_mitsuba.reference.faces import FacedBench
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

#: Flights after which a photon is given up, where nothing is said of it.
MOST_FLIGHTS = 2000
#: Photons that a thread follows at a time.
_BLOCK = 16_384


@dataclass(frozen=True)
class TracerResult:
    """Every photon's fate, counted.

    The fates: detected, absorbed_aperture, absorbed_reflector, absorbed_surface (losses at the
    crystal's faces and what the detector refuses), escaped, truncated (still on their way after
    the largest number of flights), lost (numerically astray: an error of ours if it is not 0) and
    ``absorbed_`` with the name of each volume.
    """

    photons: int
    seed: int
    #: Photons by fate; the values add up to ``photons``.
    counts: dict[str, int]
    #: Part that the detector detects of what arrives head-on; it was calibrated so.
    head_on: float = field(default=1.0, kw_only=True)
    #: Detected photons by the ids of detectors, and the one that eta is of; empty: of all.
    detectors: dict[str, int] = field(default_factory=dict, kw_only=True)
    read: str = field(default="", kw_only=True)
    #: Of each detected photon, in the fields of `walk.HISTORY`: for reweighting. Its weight under
    #: other coefficients is (scat'/scat)^scatterings exp(-(scat' - scat) scattering_path_cm)
    #: exp(-(abs' - abs) path_cm): the tracer itself absorbs with abs. And a run whose mask leaves
    #: the whole plate free answers every aperture: keep the photons with mask_radius_mm up to its
    #: radius. None unless asked for. Results are compared without them.
    histories: np.recarray | None = field(default=None, compare=False, kw_only=True)

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


def trace(
    bench: str | Path | SceneFile | FacedBench,
    photons: int,
    seed: int,
    *,
    max_depth: int | None = None,
    histories: bool = False,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> TracerResult:
    """Trace photons from birth to fate: analog Monte Carlo, one fate each.

    The bench is a sound scene, or given by its faces. The same seed gives the same fates whatever
    the threads (all processors, if not given): each photon has a generator of its own. After
    `max_depth` straight flights (what the scene says, else 2000) a photon counts as truncated:
    light that total reflection traps in a clear crystal ends so. `histories`, what the detected
    ones went through, take 64 bytes each. `progress` is called now and then with the number of
    photons done, at last with `photons`.

    Raises InputError if the tracer does not know a part of the scene, which it names, or one of the
    whole numbers is none, or too small.
    """
    photons, seed = arguments_of(photons, seed)
    if not isinstance(bench, FacedBench):
        bench = read_bench(read_scene(bench))
    if max_depth is None:
        max_depth = bench.most_flights or MOST_FLIGHTS
    max_depth = whole_of("max_depth", max_depth, "give a whole number, at least 1", 1)
    say_if_slow()
    tables, birth = bench.tables()
    root = np.random.SeedSequence(seed).generate_state(1, np.uint64)[0]

    def block(first: int) -> NDArray:
        """Histories of photons from one on."""
        records = np.zeros(max(0, min(_BLOCK, photons - first)), walk.HISTORY)
        # the generator's words overflow, as they shall
        with np.errstate(over="ignore"):
            rng, number = np.empty(1, np.uint64), np.uint64(first)
            walk.follow(tables, birth, rng, root, number, max_depth, bench.polarised, records)
        return records

    # numba compiles here, of no photons: several threads at it stumble over each other
    block(photons)
    fates, places, kept, done = Counter[int](), Counter[int](), [], 0
    pool = ThreadPoolExecutor(threads or processors())
    try:
        for records in pool.map(block, range(0, photons, _BLOCK)):
            detected = records[records["fate"] == walk.DETECTED]
            fates.update(records["fate"].tolist())
            places.update(detected["surface"].tolist())
            kept.append(detected if histories else detected[:0])
            done += len(records)
            if progress is not None:
                progress(done)
    finally:
        pool.shutdown(cancel_futures=True)
    counts = {name: fates[fate] for fate, name in enumerate(walk.FATES)}
    for number, volume in enumerate(bench.volume_names[1:], start=1):
        counts[f"absorbed_{volume}"] = fates[walk.ABSORBED + number]
    return TracerResult(
        photons,
        seed,
        counts,
        head_on=bench.head_on,
        detectors={name: places[number] for number, name in bench.detectors.items()},
        read=bench.read,
        histories=np.concatenate(kept).view(np.recarray) if histories else None,
    )
