"""Light that goes to and fro between two mirrors, many times in one step (docs/theory.md).

Between mirrors before opposite faces of a box light keeps its angle, and is reflected totally at
all other faces. A cycle is a crossing of the crystal and a trip through the film; it meets a face
twice, with the same reflectance, and a mirror once. So it is drawn at once how often light passes
before a face reflects it, and how often mirrors do before one absorbs it. Each cycle moves it by as
much along its straight way through mirror images of the box. It stops before a trip that would pass
by an edge, and before it scatters.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import dielectric
from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.convex import is_any, slack_of
from mcrim_mitsuba.transport.film import WrappingFilm
from mcrim_mitsuba.transport.folding import FoldedBody
from mcrim_mitsuba.transport.scene_model import OUTSIDE, SceneModel
from mcrim_mitsuba.transport.surface_physics import ALIVE, REFLECTOR, Outcome

#: Films thicker than this part of the crystal pass by an edge too soon to be worth it.
_THICKEST = 0.1
#: Most crossings in one step.
_MOST_CROSSINGS = 64.0
#: Edges along an axis that are looked at on the way.
_EDGES = 3
#: Reciprocal of the logarithm of a reflectance of 1.
_LOSSLESS = -1e30
#: Half a step between uniform numbers: none has the logarithm of 0.
_HALF_STEP = 2.0**-24
#: Least component of a direction, for divisions.
_LEAST = 1e-9


class Shuttle:
    """The mirrors before opposite faces of a box, in the kernel."""

    def __init__(self, film: WrappingFilm, body: FoldedBody, eta: float) -> None:
        self._crystal, self._mirrors = film.crystal.volume, _mirrored(film)
        self._eta, self._twice = opaque([eta]), opaque([2.0 * film.distance_mm])
        kept = film.surface.reflectance
        self._per_log = opaque([1.0 / math.log(kept) if 0.0 < kept < 1.0 else _LOSSLESS * kept])
        slabs, self._totals = zip(*(body.axes[axis][:2] for axis in range(3)), strict=True)
        self._low = mi.Vector3f(*(slab.sides[False].offset for slab in slabs))
        self._high = mi.Vector3f(*(slab.sides[True].offset for slab in slabs))

    @classmethod
    def before(cls, model: SceneModel, film: WrappingFilm, body: FoldedBody) -> Shuttle | None:
        """That of a film, or None where light goes trip by trip.

        A thin film, before all of two opposite faces of a box whose axes all fold; of a wrapping
        that reflects as a mirror alone, and touches nowhere. The crystal scatters evenly.
        """
        pairs = [model.flat_faces[face] for pair in _mirrored(film).values() for face in pair]
        if len(body.axes) < 3 or film.surface.mirror_part < 1.0 or not pairs:
            return None
        etas = {model.surfaces[face.surface].eta for face in pairs}
        corners = np.concatenate([face.corners for face in pairs])
        beyond = [
            (corners @ plane.axis - plane.offset) * (1.0 if plane.high else -1.0)
            for plane in film.within.planes
        ]
        suits = (
            len(etas) == 1
            and np.max(beyond) <= slack_of(model)
            and film.distance_mm <= _THICKEST * np.ptp(corners, axis=0).min()
            and not model.volumes[film.crystal.volume].uneven
            and not any(surface.contact for surface in model.surfaces)
        )
        return cls(film, body, etas.pop()) if suits else None

    def _turned(self, face, vector):
        """With the component along the normal of a face (UInt32) first; done twice, as before."""
        turned = mi.Vector3f(vector)
        for axis, faces in self._mirrors.items():
            swapped = mi.Vector3f(vector)
            swapped[0], swapped[axis] = vector[axis], vector[0]
            turned = dr.select(is_any(face, faces), swapped, turned)
        return turned

    def go(self, outcome: Outcome, face, free_mm, rng, active):
        """Take light on that is at a face (UInt32) and flies to the mirror opposite.

        It is `free_mm` (Float) from where it scatters. What it flies in the crystal is returned
        (Float, mm), with the reflections there (UInt32).
        """
        # here, not once for all: Dr.Jit would order the next launch's kernel in another way
        total = mi.Vector3f(*(dr.maximum(*ends) for ends in self._totals))
        given = outcome.direction, outcome.position, self._low, self._high, total
        flying, place, low, high, total = (self._turned(face, vector) for vector in given)
        # along the normal of the mirrors, and in widths of the box along the two other axes
        cosine, eta2 = dr.maximum(dr.abs(flying.x), _LEAST), dr.square(self._eta)
        in_film2 = dr.fma(eta2, dr.square(cosine), 1.0 - eta2)
        in_film = dr.maximum(dr.safe_sqrt(in_film2), _LEAST)
        crossing_mm, trip_mm = (high.x - low.x) / cosine, self._twice / in_film
        width = (high - low).yz
        part, upwards = dr.maximum(dr.abs(flying.yz), _LEAST), flying.yz > 0.0
        start = dr.select(upwards, (place - low).yz, (high - place).yz) / width
        crossing, trip = part * crossing_mm / width, self._eta * part * trip_mm / width
        mine = active & (outcome.fate == ALIVE) & (outcome.volume == self._crystal)
        mine &= is_any(face, [f for pair in self._mirrors.values() for f in pair])
        mine &= (in_film2 > 0.0) & dr.all(1.0 - dr.square(flying.yz) >= total.yz)

        reflectance = dielectric.reflectance(self._eta, cosine, in_film)
        until_turn, until_taken, last = (rng.next_float32() + _HALF_STEP for _ in range(3))
        passes = dr.floor(dr.log(until_turn) / dr.log(1.0 - reflectance))
        kept = dr.floor(dr.log(until_taken) * self._per_log)
        edge = _first_edge(start, crossing, trip)
        most = dr.minimum(dr.maximum(dr.min(edge), 1.0), _MOST_CROSSINGS) - 1.0
        most = dr.minimum(most, dr.floor(free_mm / crossing_mm))
        cycles = dr.minimum(dr.minimum(dr.floor(0.5 * passes), kept), most)
        # in the next cycle a face or a mirror does what it was drawn to do
        ends = cycles < most
        turns = ends & (passes == 2.0 * cycles)
        leaves = ends & ~turns
        taken = leaves & (kept == cycles)
        crossings = cycles + dr.select(ends, 1.0, 0.0)
        trips = cycles + dr.select(leaves, 1.0, 0.0)
        at = start + crossings * crossing + trips * trip
        # what the face reflects into the film goes to the mirror once more
        again = leaves & ~taken & ~dr.any(_passes_edge(at + trip, trip))
        stays = leaves & ~taken & (~again | (last < reflectance))
        at = dr.select(again, at + trip, at)
        trips += dr.select(again, 1.0, 0.0)
        taken |= again & (kept < trips)

        # where it is reflected in the film it flies away from the face outwards
        is_low = (flying.x > 0.0) ^ ((mi.UInt32(crossings) & 1) == 1)
        speed = dr.select(stays, in_film, cosine) * dr.select(is_low ^ stays, 1.0, -1.0)
        images = dr.floor(at)
        upwards ^= (mi.Vector2u(images) & 1) == 1
        at = dr.select(upwards, low.yz + (at - images) * width, high.yz - (at - images) * width)
        part *= dr.select(upwards, 1.0, -1.0) * dr.select(stays, self._eta, 1.0)
        place = mi.Vector3f(dr.select(is_low, low.x, high.x), at.x, at.y)
        self._put(outcome, face, is_low, place, mi.Vector3f(speed, part.x, part.y), mine)
        outcome.fate = dr.select(mine & taken, mi.UInt32(REFLECTOR), outcome.fate)
        outcome.volume = dr.select(mine & stays, mi.UInt32(OUTSIDE), outcome.volume)
        outcome.in_film += dr.select(mine, trips * trip_mm, 0.0)
        hits = mi.UInt32(outcome.from_reflector)
        outcome.from_reflector = hits + dr.select(mine, mi.UInt32(trips), 0)
        folds = mi.UInt32(dr.sum(images)) + dr.select(turns, mi.UInt32(1), 0)
        return dr.select(mine, crossings * crossing_mm, 0.0), dr.select(mine, folds, 0)

    def _put(self, outcome: Outcome, face, is_low, place, flying, mine) -> None:
        """Give light its face, the low one or the high one, its place and its direction."""
        for faces in self._mirrors.values():
            met = dr.select(is_low, mi.UInt32(faces[0]), mi.UInt32(faces[1]))
            outcome.face = dr.select(mine & is_any(face, faces), met, outcome.face)
        outcome.position = dr.select(mine, mi.Point3f(self._turned(face, place)), outcome.position)
        outcome.direction = dr.select(mine, self._turned(face, flying), outcome.direction)


def _passes_edge(at, trip):
    """Whether a trip that ends at some place passes by an edge, along either axis."""
    return at - dr.floor(at) < trip


def _first_edge(start, crossing, trip):
    """Number of the first cycle that may pass by an edge along either axis, at the soonest."""
    cycle = crossing + trip
    first = dr.ceil((_EDGES + 1 - start) / cycle)
    for edge in range(_EDGES, 0, -1):
        number = dr.maximum(dr.ceil((edge - start) / cycle), 1.0)
        first = dr.select(_passes_edge(start + number * cycle, trip), number, first)
    return first


def _mirrored(film: WrappingFilm) -> dict[int, tuple[int, int]]:
    """Numbers of the low and the high face across an axis, where walls stand before both."""
    ends = {
        (plane.axis.index(1.0), plane.high): plane.faces[0]
        for plane in film.crystal.planes
        if sorted(plane.axis) == [0.0, 0.0, 1.0] and plane.faces[0] in film.walls
    }
    axes = [a for a in range(3) if (a, False) in ends and (a, True) in ends]
    return {axis: (ends[axis, False], ends[axis, True]) for axis in axes}
