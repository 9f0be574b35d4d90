"""Run the tracer over many photons."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.reference.flight import Flights, PhotonArrays, Record, head_on
from mcrim_mitsuba.reference.geometry import FATES, FIRST_FATE, REGIONS, Floats, Place


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


@dataclass(frozen=True)
class FateCounts:
    """How often each fate was met."""

    photons: int
    seed: int
    #: Photons by fate; the values add up to ``photons``.
    counts: dict[str, int]
    #: Part that the detector detects of what arrives head-on; it was calibrated so.
    head_on: float = field(default=1.0, kw_only=True)

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
        n = self.photons
        return {
            fate: ((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3))) ** 0.5
            for fate, k in self.counts.items()
        }

    @property
    def eta(self) -> float:
        """Light collection efficiency: detected over emitted, relative to light head-on."""
        return self.budget["detected"] / self.head_on

    @property
    def eta_sigma(self) -> float:
        """Standard deviation of `eta`."""
        return self.budget_sigma["detected"] / self.head_on


@dataclass(frozen=True)
class TracerResult(FateCounts):
    """Every photon's fate, counted.

    The fates: detected, absorbed_crystal, absorbed_gap, absorbed_window, absorbed_aperture,
    absorbed_reflector, absorbed_surface (losses at the crystal's faces and what the detector
    refuses), escaped, truncated (still on their way after the largest number of flights) and lost
    (numerically astray: an error of ours if it is not 0).
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
    bench: Bench,
    photons: int,
    seed: int,
    *,
    max_depth: int = 2000,
    batch: int = 20_000,
    histories: bool = False,
    progress: Callable[[int], None] | None = None,
) -> TracerResult:
    """Trace photons from birth to fate: analog Monte Carlo, one fate each.

    The same seed, photons and batch give the same counts (with the same NumPy build, up to rounding
    at a decision). After `max_depth` straight flights a photon counts as truncated: light that
    total reflection traps in a clear crystal ends so. A `batch` of photons is under way at the same
    time; memory grows with it and not with `photons` (but `histories`, which keep what the detected
    ones went through, take 44 bytes each). `progress` is called now and then with the number of
    photons done, at last with `photons`.

    Raises InputError if one of the whole numbers is none, or too small.
    """
    photons = whole_number("photons", photons, 1)
    seed = whole_number("seed", seed, 0)
    max_depth = whole_number("max_depth", max_depth, 1)
    batch = whole_number("batch", batch, 1)

    flights = Flights(bench, np.random.Generator(np.random.PCG64(seed)), histories)
    counts, detected = _follow(flights, photons, max_depth, batch, progress)
    fates = {name: int(counts[place]) for place, name in FATES.items()}
    return TracerResult(
        photons, seed, fates, _histories(detected) if histories else None, head_on=head_on(bench)
    )


def _follow(
    flights: Flights,
    photons: int,
    max_depth: int,
    batch: int,
    progress: Callable[[int], None] | None,
) -> tuple[NDArray[np.int64], list[Floats]]:
    """How many photons met each fate (`Place`); and of the detected `Record`, cosine, radius."""
    counts = np.zeros(len(Place), dtype=np.int64)
    detected: list[Floats] = [np.zeros((len(Record) + 2, 0))]
    # photons under way, by the region that they are to fly in
    waiting: dict[Place, list[PhotonArrays]] = {region: [] for region in REGIONS}
    emitted = 0
    while emitted < photons or any(waiting.values()):
        crowds = {region: sum(map(len, groups)) for region, groups in waiting.items()}
        under_way = sum(crowds.values())
        # newborn photons keep the arrays long: short ones cost NumPy as much
        if emitted < photons and under_way <= batch // 2:
            if progress is not None and emitted > under_way:
                progress(emitted - under_way)
            newborn = min(batch - under_way, photons - emitted)
            waiting[flights.birthplace].append(flights.births(newborn))
            crowds[flights.birthplace] += newborn
            emitted += newborn
        # the largest crowd goes on: photons are independent of each other
        region = max(REGIONS, key=crowds.__getitem__)
        flock, waiting[region] = PhotonArrays.join(waiting[region]), []
        place = flights.fly(region, flock)
        place[(place < FIRST_FATE) & (flock.flights >= max_depth)] = Place.TRUNCATED
        here = np.bincount(place, minlength=len(Place))
        counts += here
        for region in REGIONS:
            if here[region]:
                waiting[region].append(flock.take(np.flatnonzero(place == region)))
        if flock.record is not None and here[Place.DETECTED]:
            arrived = flock.take(np.flatnonzero(place == Place.DETECTED))
            assert arrived.record is not None  # as of all
            detected.append(np.vstack((arrived.record, flights.arrivals(arrived))))
    if progress is not None:
        progress(photons)
    return counts, detected


def _histories(detected: list[Floats]) -> DetectedHistories:
    """Records of detected photons, joined of the (quantities, photons) arrays of every crowd."""
    *record, cosine, radius = np.concatenate(detected, axis=1)
    return DetectedHistories(
        scatterings=record[Record.SCATTERINGS].astype(np.int32),
        path_cm=record[Record.PATH] / MM_PER_CM,
        scattering_path_cm=record[Record.SCATTERING_PATH] / MM_PER_CM,
        mask_radius_mm=record[Record.MASK_RADIUS],
        arrival_cosine=cosine,
        arrival_radius_mm=radius,
    )
