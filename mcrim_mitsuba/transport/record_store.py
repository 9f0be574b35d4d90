"""Photon records while a kernel runs: what is written down of every detected photon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.transport.launch_plan import LanePlan
from mcrim_mitsuba.transport.scene_model import OUTSIDE, SceneModel, opaque

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.loop import Step

#: Columns that every scene can give besides those of all records, and how they are kept. Half
#: precision (5e-4, unbiased) is plenty for what varies slowly.
COLUMNS = {
    "reflections": np.uint16,
    "reflector_hits": np.uint8,
    "detector_hits": np.uint8,
    "mask_radius_mm": np.float32,
    "scattering_path_cm": np.float32,
    "log_rayleigh": np.float32,
    "birth_depth_mm": np.float16,
    "arrival_cosine": np.float16,
    "arrival_radius_mm": np.float16,
    "arrival_x_mm": np.float32,
    "arrival_y_mm": np.float32,
    "arrival_z_mm": np.float32,
    "arrival_angle_deg": np.float32,
}
_OF_ALL_RECORDS = {"w": np.float32, "k": np.uint16, "path_cm": np.float32, "batch": np.uint8}
_COUNTS = ("reflections", "reflector_hits", "detector_hits")
ARRIVAL_PLACE = ("arrival_x_mm", "arrival_y_mm", "arrival_z_mm")
_AT_THE_END = (
    "birth_depth_mm", "arrival_cosine", "arrival_radius_mm", *ARRIVAL_PLACE, "arrival_angle_deg"
)  # fmt: skip
#: Path weighted with the strength of scattering, which the weights of graded crystals need.
SCATTERING_PATH = "scattering_path_cm"


@dataclass
class History:
    """What photon records keep of a flight."""

    #: UInt32: In the emitting volume.
    scatterings: Any
    #: In the emitting volume, mm.
    path: Any
    #: dict of str to UInt32 or Float: What the columns that were asked for need: counts, paths in
    #: mm, the largest square of a distance from a mask's axis in mm^2.
    further: dict


class RecordStore:
    """Rows for all photons of a launch, four columns to a table because they are written at once.

    Parameters
    ----------
    model : SceneModel
    source : int
        The emitting volume.
    photons : int
    columns : sequence of str
        Wanted besides those of all records: of `COLUMNS`, or ``path_<medium>_cm`` of a medium that
        does not emit. Where the emitting volume scatters unevenly, `SCATTERING_PATH` is
        always among them.

    Raises
    ------
    InputError
        For a column that the scene does not give.
    """

    def __init__(
        self, model: SceneModel, source: int, photons: int, columns: Sequence[str]
    ) -> None:
        others = [n for n in range(len(model.volumes)) if n not in (OUTSIDE, source)]
        self._paths = {f"path_{model.volumes[n].name}_cm": n for n in others}
        for name in columns:
            if name not in COLUMNS and name not in self._paths:
                raise InputError(
                    f"photon records have no column {name!r}",
                    f"use one of {', '.join([*COLUMNS, *self._paths])}",
                )
        if model.volumes[source].scattering_gradient:
            columns = (*columns, SCATTERING_PATH)
        self.columns = tuple(dict.fromkeys(columns))
        self._source = source
        self._photons = photons
        count = 3 + len(self.columns)
        # Only the first table is read where nothing was written: its weight says so.
        self.tables = [dr.zeros(mi.Float, 4 * photons)]
        self.tables += [dr.empty(mi.Float, 4 * photons) for _ in range((count - 1) // 4)]

    def nothing(self, lanes: int = 1) -> History:
        """The history of a photon at birth."""
        kept = [name for name in self.columns if name not in _AT_THE_END]
        kinds = {name: mi.UInt32 if name in _COUNTS else mi.Float for name in kept}
        further = {name: dr.zeros(kind, lanes) for name, kind in kinds.items()}
        return History(dr.zeros(mi.UInt32, lanes), dr.zeros(mi.Float, lanes), further)

    def grown(self, history: History, step: Step) -> History:
        """The history after one more flight."""
        mine = step.inside[self._source]
        scattered = step.scatters & ~step.dies & mine
        count = history.scatterings + dr.select(scattered, mi.UInt32(1), mi.UInt32(0))
        path = history.path + dr.select(mine, step.distance, 0.0)
        known = history.further.items()
        further = {n: self._grown(n, value, step, mine, scattered) for n, value in known}
        return History(count, path, further)

    def _grown(self, name, value, step: Step, mine, scattered):
        outcome = step.outcome
        if name in self._paths:
            return value + dr.select(step.inside[self._paths[name]], step.distance, 0.0)
        if name == SCATTERING_PATH:
            return value + dr.select(mine, step.weighted, 0.0)
        if name == "log_rayleigh":
            cosine = dr.dot(step.p.d, step.scattered)
            relative = 0.75 * dr.fma(cosine, cosine, 1.0)
            return value + dr.select(scattered, dr.log(relative), 0.0)
        if name == "mask_radius_mm":
            if outcome.mask_radius2_mm2 is None:
                return value
            return dr.maximum(value, dr.select(step.at_surface, outcome.mask_radius2_mm2, 0.0))
        event = {
            "reflections": outcome.polished & ~outcome.crossed & mine,
            "reflector_hits": outcome.from_reflector,
            "detector_hits": outcome.from_detector,
        }[name]
        if event is None:
            return value
        event &= step.at_surface & ~step.ended
        return value + dr.select(event, mi.UInt32(1), mi.UInt32(0))

    def put(self, slot, detected, weight, history, birth, cosine, position) -> None:
        """Write the rows (`slot`, UInt32) of the photons that are `detected` (Mask).

        `birth` is a function that gives the birthplace (Point3f, mm); `cosine` and `position`
        (Point3f, mm) are those of the arrival, the angle to the normal.
        """
        row = [weight, history.scatterings, history.path]
        for name in self.columns:
            if name == "birth_depth_mm":
                row.append(birth().z)
            elif name == "arrival_cosine":
                row.append(cosine)
            elif name == "arrival_radius_mm":
                row.append(dr.sqrt(dr.square(position.x) + dr.square(position.y)))
            elif name in ARRIVAL_PLACE:
                row.append(position[ARRIVAL_PLACE.index(name)])
            elif name == "arrival_angle_deg":
                row.append(dr.rad2deg(dr.safe_acos(cosine)))
            else:
                row.append(history.further[name])
        row += [mi.Float(0.0)] * (4 * len(self.tables) - len(row))
        row = [dr.reinterpret_array(mi.Float, v) if isinstance(v, mi.UInt32) else v for v in row]
        for number, table in enumerate(self.tables):
            dr.scatter(table, mi.Vector4f(*row[4 * number : 4 * number + 4]), slot, detected)

    def collected(self, plan: LanePlan, top_mm: float) -> dict[str, np.ndarray]:
        """The rows that were written, by column, in the order of the photons.

        Parameters
        ----------
        plan : LanePlan
            With as many photons for every lane.
        top_mm : float
            Height from which the depth of birth is counted.

        Returns
        -------
        dict of str to ndarray of shape (detected,)
            ``k`` (uint16, scatterings in the crystal), ``path_cm`` (float32, in the crystal), ``w``
            (float32, weight at the proposal's absorption), ``batch`` (uint8), and of what was
            asked for ``reflections`` (uint16, internal ones at the crystal's polished faces),
            ``reflector_hits`` and ``detector_hits`` (uint8, times that a diffuse reflector or
            a detector sent the photon back), ``mask_radius_mm`` (float32, largest distance from
            the axis of a mask at which its face was met; 0 if none), ``scattering_path_cm``
            (float32, path in the crystal weighted with the relative strength of scattering),
            ``log_rayleigh`` (float32, sum of log(3/4 (1 + cos^2)) over scatterings in the crystal),
            ``path_<medium>_cm`` (float16), ``birth_depth_mm`` (float16, below the top of the
            crystal), ``arrival_cosine`` (float16, to the normal of the detector),
            ``arrival_angle_deg`` (float32, the angle itself), ``arrival_radius_mm`` (float16, from
            the axis x = y = 0) and ``arrival_x_mm`` and so on (float32, in the scene's
            coordinates). Counts stay at the largest number of their kind.
        """
        every = dr.arange(mi.UInt32, self._photons)
        seen = dr.compress(dr.gather(mi.Float, self.tables[0], 4 * every) > 0.0)
        rows = [c for table in self.tables for c in dr.gather(mi.Vector4f, table, seen)]
        lane = seen // opaque([self._photons // plan.lanes], mi.UInt32)
        found = {
            "w": rows[0],
            "k": _count(rows[1], np.uint16),
            "path_cm": rows[2] / MM_PER_CM,
            "batch": dr.gather(mi.UInt32, opaque(plan.batch, mi.UInt32), lane),
        }
        kinds: dict[str, Any] = dict(_OF_ALL_RECORDS)
        for name, value in zip(self.columns, rows[3:], strict=False):
            kinds[name] = COLUMNS.get(name, np.float16)
            if name in _COUNTS:
                value = _count(value, kinds[name])
            elif name == "mask_radius_mm":
                value = dr.sqrt(value)
            elif name == "birth_depth_mm":
                value = opaque([top_mm]) - value
            elif name == SCATTERING_PATH or name in self._paths:
                value = value / MM_PER_CM
            found[name] = value
        dr.eval(found)
        return {name: np.asarray(column).astype(kinds[name]) for name, column in found.items()}


def _count(value, kind):
    """A count of the table, at most the largest of its kind."""
    return dr.minimum(dr.reinterpret_array(mi.UInt32, value), int(np.iinfo(kind).max))
