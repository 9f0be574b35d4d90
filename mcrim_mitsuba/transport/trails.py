"""Trails of photons through a scene: all of a photon's straight flights, from birth to its fate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.transport import loop
from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.collection import choose_path
from mcrim_mitsuba.transport.launch_plan import LANES, plan_lanes
from mcrim_mitsuba.transport.record_store import TrailStore
from mcrim_mitsuba.transport.simulation import Simulation

#: Flights of which trails keep the starts: more than a picture could show.
FLIGHTS_KEPT = 64


@dataclass(frozen=True, eq=False)
class Trail:
    """A photon's way."""

    #: As in `results.SimulationResult.budget`.
    fate: str
    #: ndarray of float64, shape (n + 1, 3): Where its flights begin, and where the last one ends,
    #: mm; without that end where it made more flights than are kept.
    points: np.ndarray
    #: ndarray of int, shape (n,) or (n + 1,): The volume, among ``model.volumes``, that each flight
    #: goes through.
    volumes: np.ndarray
    #: All of them, also those that are not kept.
    flights: int
    #: ndarray of float64, shape (3,): Of the last flight.
    direction: np.ndarray

    @property
    def complete(self) -> bool:
        """Whether all flights are kept."""
        return len(self.volumes) == self.flights


@dataclass(frozen=True, eq=False)
class Trails:
    """Trails of independent photons, each with one fate."""

    #: ndarray of str, shape (photons,)
    fates: np.ndarray
    #: ndarray of int, shape (photons,)
    flights: np.ndarray
    _starts: np.ndarray
    _ends: np.ndarray
    _directions: np.ndarray

    @property
    def shares(self) -> dict[str, float]:
        """Fraction of the photons that met each fate, of those that occurred."""
        names, counts = np.unique(self.fates, return_counts=True)
        parts = (counts / len(self.fates)).tolist()
        return dict(zip(names.tolist(), parts, strict=True))

    def trail(self, number: int) -> Trail:
        """That of one photon."""
        kept = min(int(self.flights[number]), self._starts.shape[1])
        points = self._starts[number, :kept, :3]
        if kept == self.flights[number]:
            points = np.vstack([points, self._ends[number]])
        return Trail(
            fate=str(self.fates[number]),
            points=points,
            volumes=self._starts[number, :kept, 3].astype(int),
            flights=int(self.flights[number]),
            direction=self._directions[number],
        )


def follow_trails(simulation: Simulation, photons: int = LANES, *, seed: int = 0) -> Trails:
    """Follow photons by the transport that simulates, and write down where they fly.

    Absorption takes photons whole here, where simulations lower their weights: shares of fates are
    the same but for their larger errors.

    Parameters
    ----------
    simulation : Simulation
    photons : int
        Each takes 1 kB.
    seed : int

    Returns
    -------
    Trails
        The same for the same seed.
    """
    store = TrailStore(photons, FLIGHTS_KEPT)
    path = choose_path(simulation.model, simulation.polarization)
    loop.launch(
        path, simulation.crystal, plan_lanes(photons), seed=seed, number=0,
        max_depth=simulation.depth_limit, trails=store,
    )  # fmt: skip
    starts, ends, last = store.collected()
    volume, code = np.divmod(ends[:, 3].astype(int), TrailStore.CODES)
    volumes = simulation.model.volume_names
    fates = [
        f"absorbed_{volumes[v]}" if c == physics.VOLUME else loop.SURFACE_FATES[c]
        for v, c in zip(volume, code, strict=True)
    ]
    return Trails(np.array(fates), last[:, 3].astype(int), starts, ends[:, :3], last[:, :3])
