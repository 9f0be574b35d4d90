"""Trails of photons through a scene: all of a photon's straight flights, from birth to its fate."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import loop
from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.launch_plan import LANES
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
        starts, flights = self._starts[number], int(self.flights[number])
        starts = starts[:flights]
        points = starts[:, :3]
        if len(starts) == flights:
            points = np.vstack([points, self._ends[number]])
        volumes, direction = starts[:, 3].astype(int), self._directions[number]
        return Trail(str(self.fates[number]), points, volumes, flights, direction)


class TrailStore:
    """Tables of all photons' trails, with so many flights of each; ends are kept in any case.

    Attributes
    ----------
    tables : list of Float
        Starts of flights (x, y, z in mm, volume), ends (x, y, z in mm, fate and volume as
        ``fate + CODES * volume``) and the last flights (direction, number of flights); four
        numbers each, because they are written at once.
    """

    #: More than there are fates.
    CODES = 16

    def __init__(self, photons: int, flights: int) -> None:
        self._flights = flights
        self.tables = [
            dr.zeros(mi.Float, 4 * rows) for rows in (photons * flights, photons, photons)
        ]

    def put(self, slot, active, step: loop.Step) -> None:
        """Write a free flight of the photons number `slot`, where the lane is `active`."""
        starts, ends, last = self.tables
        p, o, d = step.p, step.p.o, step.p.d
        kept = active & (p.steps < self._flights)
        row = mi.Vector4f(o.x, o.y, o.z, mi.Float(p.volume))
        dr.scatter(starts, row, slot * self._flights + p.steps, kept)
        # `survive` is the part that a flight up to here leaves of the light
        taken_at = dr.minimum(-dr.log(step.survive) / step.a_a, step.distance)
        end = dr.select(step.dies, dr.fma(d, taken_at, o), step.position)
        over = active & step.ended
        code = mi.Float(step.fate + self.CODES * p.volume)
        dr.scatter(ends, mi.Vector4f(end.x, end.y, end.z, code), slot, over)
        # a count of flights is exact in single precision up to 2^24
        dr.scatter(last, mi.Vector4f(d.x, d.y, d.z, mi.Float(p.steps + 1)), slot, over)


def follow_trails(simulation: Simulation, photons: int = LANES, *, seed: int = 0) -> Trails:
    """Follow photons by the transport that simulates, and write down where they fly.

    Absorption takes photons whole here, where simulations lower their weights: shares of fates are
    the same but for their larger errors. A photon takes 1 kB.
    """
    store = TrailStore(photons, FLIGHTS_KEPT)
    simulation.launcher().launch(
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
