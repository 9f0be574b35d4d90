"""Collect light in chunks: flat memory, progress, interrupts, a wanted precision."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel import flat_path, general_path, transport
from mcrim_mitsuba.kernel.lane_plan import FIRST_LAUNCH, LANES, plan_lanes
from mcrim_mitsuba.kernel.tally import FateTally

#: Fraction of lost light above which no number is given: the scene leaks. Below it stands what
#: Mitsuba's own intersection loses at edges by rounding (about one in 5e7 reflections).
MOST_LOST = 1e-4
#: Photons per lane and launch; fixed, because results must not depend on the machine's speed.
PER_LANE_FLAT, PER_LANE_GENERAL = 256, 128
MOST_PHOTONS = 10**13
#: More photons than a precision lacks by the present error, which has an error itself.
MARGIN = 1.06

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
    """

    tally: FateTally
    seconds: float
    interrupted: bool
    path_name: str


def collect(model, emitter, *, photons, seed, max_depth, polarization, precision=None,
            progress: Progress | None = None, general=False) -> Collected:  # fmt: skip
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

    Raises
    ------
    InputError
        If the number of photons or the seed is out of range, or if the scene leaks.
    """
    refuse_arguments(photons, seed)
    photons = int(photons)
    path = choose_path(model, polarization, general)
    size = launch_size(path)
    tally, interrupted = FateTally(), False
    start = time.perf_counter()
    number = 0
    try:
        while tally.photons < photons:
            chunk = min(size if number else FIRST_LAUNCH, photons - tally.photons)
            if precision is not None and number:
                chunk = min(chunk, lacking(tally, precision))
            found = transport.launch(
                path, emitter, plan_lanes(chunk), seed=seed, number=number, max_depth=max_depth
            )
            number += 1
            tally.add(found.photons_per_batch, found.weights)
            refuse_leaks(tally)
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
    )


def refuse_arguments(photons: float, seed: int) -> None:
    """Refuse numbers of photons and seeds that no run has; raises InputError."""
    if not 1 <= photons <= MOST_PHOTONS or photons != int(photons):
        raise InputError(f"the number of photons is {photons}", "give a whole number, 1 to 1e13")
    if seed < 0:
        raise InputError(f"the seed is {seed}", "give 0 or a positive integer")


def launch_size(path) -> int:
    """Photons of a launch, the first one of a run left out."""
    fast = isinstance(path, flat_path.FlatPath)
    return LANES * (PER_LANE_FLAT if fast else PER_LANE_GENERAL)


def lacking(tally: FateTally, precision: float) -> int:
    """Photons that a relative error of eta still takes, by the present one; whole lanes."""
    eta, sigma = tally.fraction("detected"), tally.sigma("detected")
    if eta <= 0:
        return MOST_PHOTONS
    more = tally.photons * (MARGIN * (sigma / (precision * eta)) ** 2 - 1.0)
    return LANES * max(4, math.ceil(min(more, MOST_PHOTONS) / LANES))


def choose_path(model, polarization: bool, general: bool = False):
    """The fast path where it can follow light through the scene, else the general one."""
    if flat_path.suits(model) and not general:
        return flat_path.FlatPath(model, polarization)
    return general_path.GeneralPath(model, polarization, trace_all=general)


def refuse_leaks(tally: FateTally) -> None:
    """Refuse a scene that loses light; raises InputError."""
    lost = tally.fraction("lost")
    if lost > MOST_LOST:
        raise InputError(
            f"{100 * lost:.3g} % of the light left a volume without crossing a face",
            "run `mcrim check` on the scene: a face is missing, reversed or too small",
        )
