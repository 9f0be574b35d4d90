"""What a kernel writes down while it runs: records of detected photons, and trails of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.transport.conversion import opaque, opaque_vector
from mcrim_mitsuba.transport.launch_plan import LanePlan
from mcrim_mitsuba.transport.scene_model import OUTSIDE

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.bulk import CrystalVolume
    from mcrim_mitsuba.transport.loop import Step


@dataclass(frozen=True)
class Recorded:
    """How a column of the records comes about; functions take a `loop.Step`."""

    #: NumPy's type in which it is kept. Half precision (5e-4, unbiased) is plenty for what varies
    #: slowly; counts stay at the largest number of their type.
    kind: Any
    #: What a flight adds (Float, or Mask or UInt32 of a count; ``None`` where nothing ever does),
    #: from the step and whether the flight is in the crystal (Mask).
    adds: Callable[..., Any] | None = None
    #: What an arrival tells (Float), from the last step and a function of no arguments for the
    #: place of birth (Point3f, mm), seen from the crystal's left, front and top downwards.
    arrival: Callable[..., Any] | None = None
    #: What is kept, from the value of the kernel.
    kept: Callable[..., Any] = lambda value: value

    @property
    def counts(self) -> bool:
        """Whether the kernel's values are UInt32 instead of Float."""
        return np.issubdtype(self.kind, np.integer)


def _cm(value):
    return value / MM_PER_CM


def _scattered(step: Step, mine):
    return step.scatters & ~step.dies & mine


def _log_rayleigh(step: Step, mine):
    cosine = dr.dot(step.arriving, step.scattered)
    return dr.select(_scattered(step, mine), dr.log(0.75 * dr.fma(cosine, cosine, 1.0)), 0.0)


def _at_surface(event: Callable[..., Any]) -> Callable[..., Any]:
    """How often (UInt32 or ``None``) something happens at a surface, where the photon goes on."""

    def happens(step: Step, mine):
        happened = event(step.outcome, mine)
        goes_on = step.at_surface & ~step.ended
        return None if happened is None else dr.select(goes_on, mi.UInt32(happened), 0)

    return happens


_REFLECTS = _at_surface(lambda outcome, mine: outcome.polished & ~outcome.crossed & mine)


#: Of all records: the weight at the proposal's absorption, scatterings in the crystal, path in it.
_OF_ALL = {
    "w": Recorded(np.float32, arrival=lambda step, birth: step.w),
    "k": Recorded(np.uint32, _scattered),
    "path_cm": Recorded(
        np.float32, lambda step, mine: dr.select(mine, step.distance, 0.0), kept=_cm
    ),
}
#: Path in the crystal weighted with the strength of scattering, for the weights of graded crystals.
SCATTERING_PATH = "scattering_path_cm"
#: Largest distance from the axis of a mask at which its face was met; 0 if none.
MASK_RADIUS = "mask_radius_mm"
ARRIVAL_PLACE = ("arrival_x_mm", "arrival_y_mm", "arrival_z_mm")
#: Of a birth, along x, y and downwards; other than ``birth_depth_mm`` in full precision.
BIRTH_PLACE = ("birth_from_left_mm", "birth_from_front_mm", "birth_from_top_mm")
#: What every scene can give besides.
COLUMNS = {
    # internal ones at the crystal's polished faces: where a flight ends, and that it passed over
    "reflections": Recorded(
        np.uint16,
        lambda step, mine: _REFLECTS(step, mine) + (0 if step.folds is None else step.folds),
    ),
    # encounters from inside with the crystal's rough faces
    "rough_hits": Recorded(
        np.uint16,
        _at_surface(
            lambda outcome, mine: None if outcome.met_rough is None else outcome.met_rough & mine
        ),
    ),
    # times that a diffuse reflector, or a detector, sent the photon back
    "reflector_hits": Recorded(np.uint8, _at_surface(lambda outcome, mine: outcome.from_reflector)),
    "detector_hits": Recorded(np.uint8, _at_surface(lambda outcome, mine: outcome.from_detector)),
    # times that the upper side of a mask did
    "mask_hits": Recorded(np.uint8, _at_surface(lambda outcome, mine: outcome.from_mask)),
    MASK_RADIUS: Recorded(
        np.float32, lambda step, mine: step.outcome.mask_radius2_mm2, kept=dr.sqrt
    ),
    SCATTERING_PATH: Recorded(
        np.float32, lambda step, mine: dr.select(mine, step.weighted, 0.0), kept=_cm
    ),
    # sum of log(3/4 (1 + cos^2)) over scatterings in the crystal
    "log_rayleigh": Recorded(np.float32, _log_rayleigh),
    # below the top of the crystal
    "birth_depth_mm": Recorded(np.float16, arrival=lambda step, birth: birth().z),
    # from the crystal's side of the lowest x
    "birth_side_mm": Recorded(np.float16, arrival=lambda step, birth: birth().x),
    # to the normal of the detector
    "arrival_cosine": Recorded(np.float16, arrival=lambda step, birth: step.outcome.cosine),
    # from the detector's axis
    "arrival_radius_mm": Recorded(
        np.float16, arrival=lambda step, birth: dr.sqrt(step.outcome.from_axis2_mm2)
    ),
    **{
        name: Recorded(np.float32, arrival=lambda step, birth, axis=axis: step.position[axis])
        for axis, name in enumerate(ARRIVAL_PLACE)
    },
    **{
        name: Recorded(np.float32, arrival=lambda step, birth, axis=axis: birth()[axis])
        for axis, name in enumerate(BIRTH_PLACE)
    },
    "arrival_angle_deg": Recorded(
        np.float32, arrival=lambda step, birth: dr.rad2deg(dr.safe_acos(step.outcome.cosine))
    ),
}


#: What scenes of several detectors can give: the number of that which took the photon.
OF_DETECTORS = {
    "detector": Recorded(
        np.uint8, arrival=lambda step, birth: dr.reinterpret_array(mi.Float, step.outcome.detector)
    )
}


def _path_in(volume: int) -> Recorded:
    """Path in a volume that does not emit, cm: that of light outside all others, too."""

    def path(step: Step, mine):
        flown = dr.select(step.inside[volume], step.distance, 0.0)
        if volume != OUTSIDE or step.outcome.in_film is None:
            return flown
        return flown + dr.select(step.at_surface & ~step.ended, step.outcome.in_film, 0.0)

    return Recorded(np.float16, path, kept=_cm)


class RecordStore:
    """Rows for all photons of a launch, four columns to a table because they are written at once.

    `columns` are wanted besides those of all records: of `COLUMNS`, or ``path_<medium>_cm`` of a
    medium that does not emit (``path_outside_cm`` of light outside all of them). Where the emitting
    volume scatters unevenly, `SCATTERING_PATH` is always among them.

    Raises InputError for a column that the scene does not give.
    """

    def __init__(self, emitter: CrystalVolume, photons: int, columns: Sequence[str]) -> None:
        volumes = emitter.model.volumes
        others = [n for n in range(len(volumes)) if n != emitter.volume]
        several = OF_DETECTORS if len(emitter.model.detectors) > 1 else {}
        available = COLUMNS | several | {f"path_{volumes[n].name}_cm": _path_in(n) for n in others}
        for name in columns:
            if name not in available:
                problem = f"photon records have no column {name!r}"
                raise InputError(problem, f"use one of {', '.join(available)}")
        if volumes[emitter.volume].uneven:
            columns = (*columns, SCATTERING_PATH)
        self._columns = _OF_ALL | {name: available[name] for name in columns}
        self._source, self._photons = emitter.volume, photons
        self._left_front_top = opaque_vector([*emitter.lower[:2], emitter.upper[2]])
        self._head_on = emitter.model.head_on
        # Only the first table is read where nothing was written: its weight says so.
        self.tables = [dr.zeros(mi.Float, 4 * photons)]
        further = range((len(self._columns) - 1) // 4)
        self.tables += [dr.empty(mi.Float, 4 * photons) for _ in further]

    def nothing(self, lanes: int = 1) -> dict[str, Any]:
        """The history of a photon at birth: UInt32 or Float, by column."""
        return {
            name: dr.zeros(mi.UInt32 if column.counts else mi.Float, lanes)
            for name, column in self._columns.items()
            if column.adds
        }

    def grown(self, history: dict[str, Any], step: Step) -> dict[str, Any]:
        """The history after one more flight."""
        mine, grown = step.inside[self._source], dict(history)
        for name, column in self._columns.items():
            more = column.adds and column.adds(step, mine)
            if more is None:
                continue
            if name == MASK_RADIUS:
                grown[name] = dr.maximum(grown[name], dr.select(step.at_surface, more, 0.0))
            else:
                grown[name] = grown[name] + (mi.UInt32(more) if column.counts else more)
        return grown

    def put(self, slot, detected, step: Step, history: dict[str, Any], birth) -> None:
        """Write the rows (`slot`, UInt32) of the photons that are `detected` (Mask).

        `birth` is a function that gives the birthplace (Point3f, mm).
        """

        def place():
            away = birth() - self._left_front_top
            return mi.Point3f(away.x, away.y, -away.z)

        row = [
            column.arrival(step, place)
            if column.arrival
            else dr.reinterpret_array(mi.Float, history[name])
            for name, column in self._columns.items()
        ]
        row += [mi.Float(0.0)] * (4 * len(self.tables) - len(row))
        for number, table in enumerate(self.tables):
            dr.scatter(table, mi.Vector4f(*row[4 * number : 4 * number + 4]), slot, detected)

    def collected(self, plan: LanePlan) -> dict[str, np.ndarray]:
        """The rows that were written, by column, in the order of the photons: (detected,) each.

        Columns of all records, ``batch`` (uint8) among them, and what was asked for.
        """
        every = dr.arange(mi.UInt32, self._photons)
        seen = dr.compress(dr.gather(mi.Float, self.tables[0], 4 * every) > 0.0)
        kinds = {"batch": np.uint8} | {name: c.kind for name, c in self._columns.items()}
        if not dr.width(seen):
            return {name: np.zeros(0, kind) for name, kind in kinds.items()}
        rows = [c for table in self.tables for c in dr.gather(mi.Vector4f, table, seen)]
        # the first lanes may follow one photon more
        per_lane, more = divmod(self._photons, plan.lanes)
        of_more = opaque([more * (per_lane + 1)], mi.UInt32)
        later = opaque([more], mi.UInt32) + (seen - of_more) // opaque([per_lane], mi.UInt32)
        lane = dr.select(seen < of_more, seen // opaque([per_lane + 1], mi.UInt32), later)
        columns = {"batch": dr.gather(mi.UInt32, opaque(plan.batch, mi.UInt32), lane)}
        for (name, column), value in zip(self._columns.items(), rows, strict=False):
            if column.counts:
                most = int(np.iinfo(column.kind).max)
                value = dr.minimum(dr.reinterpret_array(mi.UInt32, value), most)
            columns[name] = column.kept(value)
        if self._head_on != 1.0:
            columns["w"] /= self._head_on
        dr.eval(columns)
        return {name: np.asarray(column).astype(kinds[name]) for name, column in columns.items()}


class TrailStore:
    """Tables of all photons' trails, with so many flights of each; ends are kept in any case."""

    #: More than there are fates.
    CODES = 16

    def __init__(self, photons: int, flights: int) -> None:
        self._flights = flights
        #: Starts of flights (x, y, z in mm, volume), ends (x, y, z in mm, fate and volume as
        #: ``fate + CODES * volume``) and the last flights (direction, number of flights); four
        #: numbers each (Float), because they are written at once.
        self.tables = [
            dr.zeros(mi.Float, 4 * rows) for rows in (photons * flights, photons, photons)
        ]

    def put(self, slot, active, step: Step) -> None:
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
