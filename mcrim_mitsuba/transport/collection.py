"""Derivatives of eta by Dr.Jit's automatic differentiation, through the simulation itself.

Photon records give the same derivatives at every point for nothing; these are here to hold them
against, and for scenes of which no records are wanted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, MM_PER_CM
from mcrim_mitsuba.transport import flat_path, general_path, loop
from mcrim_mitsuba.transport.launch_plan import BATCHES, FIRST_LAUNCH, LANES, FateTally, plan_lanes
from mcrim_mitsuba.transport.photon_records import PhotonRecords, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation

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
    """Fates of the photons followed so far."""

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
            found = loop.launch(
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


# Photon records of one launch, as the fit takes them.

#: Light that may be cut off at the depth limit: less than any error that is asked for.
MOST_TRUNCATED = 1e-5
#: Photons that may be cut off in any case: in a short run they are within the error.
FEW_TRUNCATED = 3.0


class Recorder:
    """Simulates a configuration's photon records, launch by launch.

    Parameters
    ----------
    simulation : Simulation
        Its own coefficients do not matter.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._path = choose_path(simulation.model, simulation.polarization)
        self._tally = FateTally()

    def record(
        self,
        proposals: ScatteringProposals,
        photons: int,
        *,
        seed: int,
        number: int,
        columns: Sequence[str] = (),
    ) -> PhotonRecords:
        """Histories of the photons of one launch that are detected.

        Parameters
        ----------
        proposals : Proposals
            With shares in units of 1 / `lane_plan.UNITS`.
        photons : int
            A multiple of `lane_plan.LANES`.
        seed, number : int
            Of the run and of the launch.
        columns : sequence of str
            What ``further`` of the records holds, see `record_store.RecordStore`; where the
            crystal scatters unevenly, it always holds ``scattering_path_cm``.

        Raises
        ------
        InputError
            If the scene leaks, keeps more light than records may miss, or does not have a column.
        """
        simulation = self._simulation
        # Scattered light gets out in the end; what is cut off would be missing at every alpha.
        max_depth = simulation.integrator.depth_limit(scatters=True)
        found = loop.launch(
            self._path,
            simulation.crystal,
            plan_lanes(photons, proposals.units),
            seed=seed,
            number=number,
            max_depth=max_depth,
            alpha_scat_per_mm=np.array(proposals.alpha_scat_per_cm) / MM_PER_CM,
            alpha_abs_per_mm=proposals.alpha_abs_per_cm / MM_PER_CM,
            columns=columns,
        )
        self._tally.add(found.photons_per_batch, found.weights)
        refuse_leaks(self._tally)
        truncated = self._tally.fraction("truncated")
        if truncated > max(MOST_TRUNCATED, FEW_TRUNCATED / self._tally.photons):
            raise InputError(
                f"{100 * truncated:.2g} % of the light was still under way after "
                f"{max_depth:,} flights",
                "raise max_depth of the integrator, or ask for more absorption",
                path=simulation.file.path,
            )
        further = dict(found.records)
        core = {name: further.pop(name) for name in ("k", "path_cm", "w", "batch")}
        return PhotonRecords(
            **core,
            batches=BATCHES,
            photons_per_proposal=np.array(proposals.units) * (photons // sum(proposals.units)),
            alpha_scat_proposals_per_cm=np.array(proposals.alpha_scat_per_cm),
            alpha_abs_proposal_per_cm=proposals.alpha_abs_per_cm,
            further=further,
        )


# Derivatives of eta by Dr.Jit's automatic differentiation, through the simulation itself.
#
# Photon records give the same derivatives at every point for nothing; these are here to hold them
# against, and for scenes of which no records are wanted.

_TANGENTS = {
    ALPHA_SCAT: loop.Tangent(alpha_scat_per_mm=1.0 / MM_PER_CM),
    ALPHA_ABS: loop.Tangent(alpha_abs_per_mm=1.0 / MM_PER_CM),
}


@dataclass(frozen=True)
class EtaSlope:
    """Eta and its derivative, each with its standard error; cm for the derivative."""

    eta: float
    eta_sigma: float
    slope: float
    slope_sigma: float


def eta_slope(simulation, name: str, *, photons: int, seed: int = 0) -> EtaSlope:
    """Derivative of eta with respect to a coefficient of the crystal.

    Photons' ways stay as they are drawn; their weights, and the probabilities with which
    they were drawn, are differentiated (Dr.Jit's forward mode through the transport loop).

    Parameters
    ----------
    simulation : kernel.simulation.Simulation
        Scattering: alpha_scat above 0.
    name : str
        ``alpha_scat_per_cm`` or ``alpha_abs_per_cm``.
    photons : int
        Followed in one launch: some millions at most.
    seed : int
    """
    found = loop.launch(
        choose_path(simulation.model, simulation.polarization),
        simulation.crystal,
        plan_lanes(photons),
        seed=seed,
        number=0,
        max_depth=simulation.depth_limit,
        tangent=_TANGENTS[name],
    )
    values = []
    for sums in (found.weights["detected"], found.detected_slope):
        each = sums / found.photons_per_batch
        values += [float(each.mean()), float(each.std(ddof=1) / len(each) ** 0.5)]
    return EtaSlope(*values)
