"""Photon records while a kernel runs: every detected photon writes its row of a table."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.lane_plan import LanePlan
from mcrim_mitsuba.kernel.scene_model import OUTSIDE, SceneModel, opaque
from mcrim_mitsuba.units import MM_PER_CM

_MOST = 65535
# Half precision (5e-4, unbiased) is plenty for the rest, which only enters further weights.
_KINDS = {
    "k": np.uint16,
    "reflections": np.uint16,
    "w": np.float32,
    "batch": np.uint8,
}


@dataclass
class History:
    """What photon records keep of a flight.

    Attributes
    ----------
    scatterings : UInt32
        In the emitting volume.
    reflections : UInt32
        Back into the emitting volume, partial or total, at its polished faces.
    path : dict of int to Float
        Path in mm in every volume but the outside.
    """

    scatterings: object
    reflections: object
    path: dict


class RecordStore:
    """Rows for all photons of a launch, four columns to a table because they are written at once.

    Parameters
    ----------
    model : SceneModel
    photons : int
    """

    def __init__(self, model: SceneModel, photons: int) -> None:
        self._volumes = [n for n in range(len(model.volumes)) if n != OUTSIDE]
        self._names = [model.volumes[n].name for n in self._volumes]
        self._photons = photons
        # weight, both counts, depth, cosine, radius, and a path per volume
        columns = 5 + len(self._volumes)
        # Only the first table is read where nothing was written: its weight says so.
        self.tables = [dr.zeros(mi.Float, 4 * photons)]
        self.tables += [dr.empty(mi.Float, 4 * photons) for _ in range((columns - 1) // 4)]

    def nothing(self, lanes: int = 1) -> History:
        """The history of a photon at birth."""
        return History(
            dr.zeros(mi.UInt32, lanes),
            dr.zeros(mi.UInt32, lanes),
            {n: dr.zeros(mi.Float, lanes) for n in self._volumes},
        )

    def put(self, slot, detected, weight, history, birth, cosine, position) -> None:
        """Write the rows (`slot`, UInt32) of the photons that are `detected` (Mask)."""
        counts = dr.minimum(history.scatterings, _MOST) | (
            dr.minimum(history.reflections, _MOST) << 16
        )
        row = [
            weight,
            dr.reinterpret_array(mi.Float, counts),
            *history.path.values(),
            birth.z,
            cosine,
            dr.sqrt(dr.square(position.x) + dr.square(position.y)),
        ]
        row += [mi.Float(0.0)] * (4 * len(self.tables) - len(row))
        for number, table in enumerate(self.tables):
            dr.scatter(table, mi.Vector4f(*row[4 * number : 4 * number + 4]), slot, detected)

    def columns(self, plan: LanePlan, crystal: int, top_mm: float) -> dict[str, np.ndarray]:
        """The rows that were written, by column, in the order of the photons.

        Parameters
        ----------
        plan : LanePlan
            With as many photons for every lane.
        crystal : int
            The emitting volume.
        top_mm : float
            Height from which the depth of birth is counted.

        Returns
        -------
        dict of str to ndarray of shape (detected,)
            ``k`` (uint16, scatterings in the crystal), ``reflections`` (uint16, internal ones at
            its polished faces), ``w`` (float32, weight at the proposal's absorption),
            ``path_<medium>_cm`` (float32 in the crystal, else float16), ``birth_depth_mm``
            (float16, below the top of the crystal), ``arrival_cosine`` (float16, to the normal
            of the detector),
            ``arrival_radius_mm`` (float16, from the axis x = y = 0), ``batch`` (uint8).
        """
        every = dr.arange(mi.UInt32, self._photons)
        seen = dr.compress(dr.gather(mi.Float, self.tables[0], 4 * every) > 0.0)
        columns = [c for table in self.tables for c in dr.gather(mi.Vector4f, table, seen)]
        weight, counts, *columns = columns
        paths, (height, cosine, radius) = (
            columns[: len(self._names)],
            columns[len(self._names) :][:3],
        )
        lane = seen // opaque([self._photons // plan.lanes], mi.UInt32)
        counts = dr.reinterpret_array(mi.UInt32, counts)
        found = {
            "k": counts & _MOST,
            "reflections": counts >> 16,
            "w": weight,
            **{f"path_{n}_cm": p / MM_PER_CM for n, p in zip(self._names, paths, strict=True)},
            "birth_depth_mm": opaque([top_mm]) - height,
            "arrival_cosine": cosine,
            "arrival_radius_mm": radius,
            "batch": dr.gather(mi.UInt32, opaque(plan.batch, mi.UInt32), lane),
        }
        dr.eval(found)
        exact = f"path_{self._names[self._volumes.index(crystal)]}_cm"
        return {
            name: np.asarray(column).astype(
                np.float32 if name == exact else _KINDS.get(name, np.float16)
            )
            for name, column in found.items()
        }
