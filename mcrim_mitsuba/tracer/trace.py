"""Run the tracer over many photons."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mcrim_mitsuba.tracer.batch import Batch
from mcrim_mitsuba.tracer.bench import Bench, whole_number
from mcrim_mitsuba.tracer.layout import FATES, FIRST_FATE, MM_PER_CM, Layout, Place
from mcrim_mitsuba.tracer.result import DetectedHistories, TracerResult


def trace(
    bench: Bench,
    photons: int,
    seed: int,
    *,
    max_depth: int = 2000,
    batch: int = 50_000,
    histories: bool = False,
    progress: Callable[[int], None] | None = None,
) -> TracerResult:
    """Trace photons from birth to fate: analog Monte Carlo, one fate each.

    Parameters
    ----------
    bench : Bench
        The scene.
    photons : int
        Number of photons to emit, at least 1.
    seed : int
        Not negative. The same seed, photons and batch give the same counts
        (with the same NumPy build, up to rounding at a decision).
    max_depth : int, optional
        Straight flights after which a photon counts as truncated. Light that
        total reflection traps in a clear crystal ends so.
    batch : int, optional
        Photons that fly together. Memory grows with it and not with `photons`
        (but `histories` take 12 bytes per detected photon).
    histories : bool, optional
        Keep the detected photons' scatterings and paths.
    progress : callable, optional
        Called after each batch with the number of photons done.

    Raises
    ------
    InputError
        If one of the whole numbers is none, or too small.
    """
    photons = whole_number("photons", photons, 1)
    seed = whole_number("seed", seed, 0)
    max_depth = whole_number("max_depth", max_depth, 1)
    batch = whole_number("batch", batch, 1)

    layout = Layout(bench)
    counts = np.zeros(len(Place), dtype=np.int64)
    scatterings, paths = [], []
    seeds = np.random.SeedSequence(seed)
    done = 0
    while done < photons:
        size = min(batch, photons - done)
        rng = np.random.Generator(np.random.PCG64(seeds.spawn(1)[0]))
        flock = Batch(bench, layout, size, rng)
        for _ in range(max_depth):
            flock.fly()
            ended = flock.place >= FIRST_FATE
            counts += np.bincount(flock.place[ended], minlength=len(Place))
            if histories:
                detected = flock.place == Place.DETECTED
                scatterings.append(flock.scatterings[detected])
                paths.append(flock.path[detected])
            flock.keep(~ended)
            if not len(flock):
                break
        counts[Place.TRUNCATED] += len(flock)
        done += size
        if progress is not None:
            progress(done)

    kept = None
    if histories:
        kept = DetectedHistories(np.concatenate(scatterings), np.concatenate(paths) / MM_PER_CM)
    return TracerResult(
        photons, seed, {name: int(counts[place]) for place, name in FATES.items()}, kept
    )
