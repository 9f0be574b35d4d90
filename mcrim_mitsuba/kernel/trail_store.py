"""Trails while a kernel runs: where every photon's flights begin, and where its last one ends."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel import surface_physics as physics


class TrailStore:
    """Tables of all photons' trails.

    Parameters
    ----------
    photons : int
    flights : int
        Of each photon, how many are kept; the end is kept in any case.

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
        self._photons, self._flights = photons, flights
        self.tables = [
            dr.zeros(mi.Float, 4 * rows) for rows in (photons * flights, photons, photons)
        ]

    def put(self, slot, active, step, volume, start, direction, end, fate) -> None:
        """Write a free flight.

        Parameters
        ----------
        slot : UInt32
            Number of the photon.
        active : Mask
            Whether the lane follows a photon at all.
        step, volume : UInt32
            Flights before this one; the volume it goes through.
        start, direction, end : Point3f, Vector3f, Point3f
            mm; unit direction.
        fate : UInt32
            What became of the photon at its end, of `surface_physics`.
        """
        starts, ends, last = self.tables
        kept = active & (step < self._flights)
        row = mi.Vector4f(start.x, start.y, start.z, mi.Float(volume))
        dr.scatter(starts, row, slot * self._flights + step, kept)
        over = active & (fate != physics.ALIVE)
        code = mi.Float(fate + self.CODES * volume)
        dr.scatter(ends, mi.Vector4f(end.x, end.y, end.z, code), slot, over)
        # a count of flights is exact in single precision up to 2^24
        row = mi.Vector4f(direction.x, direction.y, direction.z, mi.Float(step + 1))
        dr.scatter(last, row, slot, over)

    def collected(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The tables, float64: shape (photons, flights, 4), (photons, 4) and (photons, 4)."""
        starts, ends, last = (np.array(table, dtype=np.float64) for table in self.tables)
        return (
            starts.reshape(self._photons, self._flights, 4),
            ends.reshape(-1, 4),
            last.reshape(-1, 4),
        )
