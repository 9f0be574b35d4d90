"""Collect light in chunks: flat memory, progress, interrupts, a wanted precision."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel import flat_path, general_path, transport
from mcrim_mitsuba.kernel.tally import FateTally

#: Fraction of lost light above which no number is given: the scene leaks. Below it stands what
#: Mitsuba's own intersection loses at edges by rounding (about one in 5e7 reflections).
MOST_LOST = 1e-4
#: Photons per lane and launch; fixed, because results must not depend on the machine's speed.
PER_LANE_FLAT, PER_LANE_GENERAL = 256, 32
#: Photons of the first launch, which compiles the kernel and shows that all is well.
FIRST_LAUNCH = 65_536
MOST_PHOTONS = 10**13

Progress = Callable[[int, int, float, float], None]


@dataclass(frozen=True)
class Collected:
    """Fates of the photons followed so far.

    Attributes
    ----------
    tally : FateTally
    seconds : float
    interrupted : bool
    path_name : str
    records : dict of str to ndarray, or None
        See `transport.Launch`.
    photons_per_proposal : ndarray of int64
        Photons emitted per proposal of alpha_scat; one entry where there were no proposals.
    """

    tally: FateTally
    seconds: float
    interrupted: bool
    path_name: str
    records: dict[str, np.ndarray] | None
    photons_per_proposal: np.ndarray


def collect(model, emitter, *, photons, seed, max_depth, polarization, precision=None,
            progress: Progress | None = None, general=False, keep_records=False,
            alpha_scat_per_mm=None, alpha_abs_per_mm=None) -> Collected:  # fmt: skip
    """Follow photons until enough are done, or until the user interrupts.

    Parameters
    ----------
    model : SceneModel
    emitter : CrystalVolume
    photons : int
        How many; with `precision`, how many at most.
    seed : int
    max_depth : int
        Free flights after which a photon is truncated.
    polarization : bool
    precision : float, optional
        Stop once the relative standard error of eta is below this.
    progress : callable, optional
        Called as ``progress(done, photons, eta, eta_sigma)`` after each launch.
    general : bool
        Use the general path even where the fast one would do (for cross-checks).
    keep_records, alpha_scat_per_mm, alpha_abs_per_mm
        See `transport.launch`.

    Raises
    ------
    InputError
        If the number of photons or the seed is out of range, or if the scene leaks.
    """
    if not 1 <= photons <= MOST_PHOTONS or photons != int(photons):
        raise InputError(f"the number of photons is {photons}", "give a whole number, 1 to 1e13")
    photons = int(photons)
    if seed < 0:
        raise InputError(f"the seed is {seed}", "give 0 or a positive integer")
    fast = flat_path.suits(model) and not general
    path = (flat_path.FlatPath if fast else general_path.GeneralPath)(model, polarization)
    size = transport.LANES * (PER_LANE_FLAT if fast else PER_LANE_GENERAL)
    tally, records, interrupted = FateTally(), [], False
    emitted = np.zeros(1 if alpha_scat_per_mm is None else len(alpha_scat_per_mm), dtype=np.int64)
    start = time.perf_counter()
    number = 0
    try:
        while tally.photons < photons:
            chunk = min(size if number else FIRST_LAUNCH, photons - tally.photons)
            found = transport.launch(
                path, emitter, photons=chunk, seed=seed, number=number, max_depth=max_depth,
                alpha_scat_per_mm=alpha_scat_per_mm, alpha_abs_per_mm=alpha_abs_per_mm,
                keep_records=keep_records,
            )  # fmt: skip
            number += 1
            tally.add(found.photons_per_lane, found.weights)
            lane = np.arange(len(found.photons_per_lane)) % len(emitted)
            emitted += np.bincount(lane, found.photons_per_lane, len(emitted)).astype(np.int64)
            if found.records is not None:
                records.append(found.records)
            _refuse_leaks(tally)
            eta, sigma = tally.fraction("detected"), tally.sigma("detected")
            if progress is not None:
                progress(tally.photons, photons, eta, sigma)
            if precision is not None and eta > 0 and sigma <= precision * eta:
                break
    except KeyboardInterrupt:
        if tally.photons == 0:
            raise
        interrupted = True
    return Collected(
        tally=tally,
        seconds=time.perf_counter() - start,
        interrupted=interrupted,
        path_name=path.name,
        records={k: np.concatenate([r[k] for r in records]) for k in records[0]}
        if records
        else None,
        photons_per_proposal=emitted,
    )


def _refuse_leaks(tally: FateTally) -> None:
    lost = tally.fraction("lost")
    if lost > MOST_LOST:
        raise InputError(
            f"{100 * lost:.3g} % of the light left a volume without crossing a face",
            "run `mcrim check` on the scene: a face is missing, reversed or too small",
        )
