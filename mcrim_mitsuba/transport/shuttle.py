"""Light that goes to and fro between two mirrors, many times in one step.

Where mirrors stand before two opposite faces of a box, light that leaves by one of them comes back
and leaves by the other, at the same angle, a dozen times; at all other faces it is reflected
totally (`transport.folding`). From crossing to crossing it meets a face twice, from inside and from
the film, with the same reflectance. So it is drawn at once how often it passes before a face
reflects it, and how often mirrors do before one absorbs it. Each cycle moves it by as much along
its straight way through mirror images of the box: a crossing of the crystal, and a trip through the
film. It stops before a trip that would pass by an edge, and before it scatters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

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

#: Films thicker than this part of the crystal's width pass by an edge too soon to be worth it.
_THICKEST = 0.1
#: Most crossings in one step.
_MOST_CROSSINGS = 64.0
#: Edges along an axis that are looked at; light stops before the next one.
_EDGES = 3
#: Reciprocal of the logarithm of a reflectance of 1.
_LOSSLESS = -1e30
#: Half a step between uniform numbers: none has the logarithm of 0.
_HALF_STEP = 2.0**-24
#: Least component of a direction, for divisions.
_LEAST = 1e-9


@dataclass(kw_only=True)
class _Course:
    """Light's way along one of the two axes that its mirrors are not on, in widths of the box."""

    low: Any
    high: Any
    width: Any
    #: Mask: Whether it flies upwards.
    upwards: Any
    #: Size of its direction's component.
    part: Any
    #: From the plane behind it.
    start: Any
    #: Of a crossing of the crystal, and of a trip through the film.
    crossing: Any
    trip: Any

    def after(self, crossings, trips):
        """Where it is then, along its straight way."""
        return dr.fma(trips, self.trip, dr.fma(crossings, self.crossing, self.start))

    def passes_edge(self, at):
        """Whether a trip that ends at some place passes by an edge (Mask)."""
        return at - dr.floor(at) < self.trip

    def first_edge(self):
        """Number (Float, from 1) of the first cycle that may pass by an edge, at the soonest."""
        per_cycle, first = dr.rcp(self.crossing + self.trip), mi.Float(dr.inf)
        for edge in range(1, _EDGES + 1):
            number = dr.maximum(dr.ceil((edge - self.start) * per_cycle), 1.0)
            passes = self.passes_edge(self.after(number, number))
            first = dr.select(passes & (number < first), number, first)
        unseen = dr.maximum(dr.ceil((_EDGES + 1 - self.start) * per_cycle), 1.0)
        return dr.minimum(first, unseen)

    def folded(self, at):
        """Place (mm), whether light flies upwards there, and how many edges it has passed."""
        image = dr.floor(at)
        edges = mi.UInt32(image)
        upwards = self.upwards ^ ((edges & 1) == 1)
        along = (at - image) * self.width
        return dr.select(upwards, self.low + along, self.high - along), upwards, edges


class Shuttle:
    """The mirrors before opposite faces of a box, in the kernel."""

    def __init__(self, film: WrappingFilm, body: FoldedBody, eta: float) -> None:
        self._crystal, self._body = film.crystal.volume, body
        self._eta, self._twice = opaque([eta]), opaque([2.0 * film.distance_mm])
        kept = film.surface.reflectance
        log = math.log(kept) if kept else -math.inf
        self._per_log = opaque([1.0 / log if log else _LOSSLESS])
        self._mirrors = _mirrored(film)
        self._bounds = {
            axis: (slab.sides[False].offset, slab.sides[True].offset, dr.maximum(*totals))
            for axis, (slab, totals, _, _) in body.axes.items()
        }

    @classmethod
    def before(cls, model: SceneModel, film: WrappingFilm, body: FoldedBody) -> Shuttle | None:
        """That of a film, or None where light goes trip by trip.

        - It wraps a box, all axes of which fold, and stands before all of two opposite faces.
        - The film is thin.
        - It reflects as a mirror alone, and touches nowhere.
        - The crystal scatters evenly.
        """
        pairs = [model.flat_faces[face] for pair in _mirrored(film).values() for face in pair]
        if len(body.axes) < 3 or film.surface.mirror_part < 1.0 or not pairs:
            return None
        if model.volumes[film.crystal.volume].uneven or any(s.contact for s in model.surfaces):
            return None
        for plane in film.within.planes:
            sign = 1.0 if plane.high else -1.0
            for face in pairs:
                beyond = sign * (face.corners @ plane.axis - plane.offset)
                if beyond.max() > slack_of(model):
                    return None
        ends = [face.corners.mean(axis=0) for face in pairs]
        across = min(
            np.linalg.norm(high - low) for low, high in zip(ends[::2], ends[1::2], strict=True)
        )
        if film.distance_mm > _THICKEST * across:
            return None
        etas = {model.surfaces[face.surface].eta for face in pairs}
        return cls(film, body, etas.pop()) if len(etas) == 1 else None

    def _of(self, face, values):
        """Of some values, by axis, that of the axis which a face (UInt32) lies across."""
        picked = None
        for axis, faces in self._mirrors.items():
            value = values(axis)
            picked = value if picked is None else dr.select(is_any(face, faces), value, picked)
        return picked

    def _way(self, outcome: Outcome, face, number: int, crossing_mm, trip_mm):
        """The first or the second one, and whether its ends reflect all of the light (Mask)."""

        def of(values):
            return self._of(face, lambda axis: values(_others(axis)[number]))

        part, at = of(lambda i: outcome.direction[i]), of(lambda i: outcome.position[i])
        low, high, total = (of(lambda i, k=k: self._bounds[i][k]) for k in range(3))
        width, per_width = (of(lambda i, k=k: self._body.axes[i][k]) for k in (2, 3))
        upwards, size = part > 0.0, dr.maximum(dr.abs(part), _LEAST)
        way = _Course(
            low=low,
            high=high,
            width=width,
            upwards=upwards,
            part=size,
            start=dr.select(upwards, at - low, high - at) * per_width,
            crossing=size * crossing_mm * per_width,
            trip=self._eta * size * trip_mm * per_width,
        )
        return way, dr.fma(-part, part, 1.0) >= total

    def go(self, outcome: Outcome, face, free_mm, rng, active):
        """Take light on that is at a face (UInt32) and flies to the mirror opposite.

        It is `free_mm` (Float) from where it scatters. What it flies in the crystal is returned
        (Float, mm), with the reflections there (UInt32).
        """
        towards = self._of(face, lambda axis: outcome.direction[axis])
        cosine = dr.maximum(dr.abs(towards), _LEAST)
        eta2 = dr.square(self._eta)
        in_film2 = dr.fma(eta2, dr.square(cosine), 1.0 - eta2)
        in_film = dr.maximum(dr.safe_sqrt(in_film2), _LEAST)
        reflectance = dielectric.reflectance(self._eta, cosine, in_film)
        crossing_mm = self._of(face, lambda axis: self._body.axes[axis][2]) / cosine
        trip_mm = self._twice / in_film
        mine = active & (outcome.fate == ALIVE) & (outcome.volume == self._crystal)
        mine &= (in_film2 > 0.0) & is_any(
            face, [f for pair in self._mirrors.values() for f in pair]
        )
        ways = []
        for number in range(2):
            way, reflects = self._way(outcome, face, number, crossing_mm, trip_mm)
            ways.append(way)
            mine &= reflects

        until_turn, until_taken, last = (rng.next_float32() + _HALF_STEP for _ in range(3))
        passes = dr.floor(dr.log(until_turn) / dr.log(1.0 - reflectance))
        kept = dr.floor(dr.log(until_taken) * self._per_log)
        most = dr.minimum(ways[0].first_edge(), ways[1].first_edge())
        most = dr.minimum(dr.minimum(most, _MOST_CROSSINGS) - 1.0, dr.floor(free_mm / crossing_mm))
        cycles = dr.minimum(dr.minimum(dr.floor(0.5 * passes), kept), most)
        # in the next cycle a face or a mirror does what it was drawn to do
        ends = cycles < most
        turns = ends & (passes == 2.0 * cycles)
        leaves = ends & ~turns
        taken = leaves & (kept == cycles)
        crossings = cycles + dr.select(ends, 1.0, 0.0)
        trips = cycles + dr.select(leaves, 1.0, 0.0)
        # what the face reflects into the film goes to the mirror once more
        stays = leaves & ~taken
        again = mi.Mask(stays)
        for way in ways:
            again &= ~way.passes_edge(way.after(crossings, trips + 1.0))
        trips += dr.select(again, 1.0, 0.0)
        taken |= again & (kept < trips)
        stays &= ~again | (last < reflectance)

        outcome.fate = dr.select(mine & taken, mi.UInt32(REFLECTOR), outcome.fate)
        hits = dr.select(mine, mi.UInt32(trips), 0)
        outcome.from_reflector = mi.UInt32(outcome.from_reflector) + hits
        outcome.in_film += dr.select(mine, trips * trip_mm, 0.0)
        outcome.volume = dr.select(mine & stays, mi.UInt32(OUTSIDE), outcome.volume)
        edges = self._put(outcome, face, ways, (crossings, trips, stays), (towards, in_film), mine)
        folds = edges + dr.select(turns, mi.UInt32(1), 0)
        return dr.select(mine, crossings * crossing_mm, 0.0), dr.select(mine, folds, 0)

    def _put(self, outcome: Outcome, face, ways: list[_Course], counts, cosines, mine):
        """Give light its place, direction and face; how many edges it has passed (UInt32)."""
        (crossings, trips, stays), (towards, in_film) = counts, cosines
        # where it is reflected in the film it flies away from the face outwards
        low = (towards > 0.0) ^ ((mi.UInt32(crossings) & 1) == 1)
        speed = dr.select(stays, in_film, dr.abs(towards))
        speed = dr.select(low ^ stays, speed, -speed)
        stretch = dr.select(stays, self._eta, 1.0)
        ends = [way.folded(way.after(crossings, trips)) for way in ways]
        parts = [
            stretch * dr.select(upwards, way.part, -way.part)
            for way, (_, upwards, _) in zip(ways, ends, strict=True)
        ]
        at_mirror = dr.select(
            low,
            self._of(face, lambda axis: self._bounds[axis][0]),
            self._of(face, lambda axis: self._bounds[axis][1]),
        )
        direction, place = mi.Vector3f(outcome.direction), mi.Point3f(outcome.position)
        number = mi.UInt32(outcome.face)
        for axis, faces in self._mirrors.items():
            here = mine & is_any(face, faces)
            values = [(axis, at_mirror, speed)]
            values += [
                (other, end[0], part)
                for other, end, part in zip(_others(axis), ends, parts, strict=True)
            ]
            for i, at, part in values:
                place[i] = dr.select(here, at, place[i])
                direction[i] = dr.select(here, part, direction[i])
            met = dr.select(low, mi.UInt32(faces[0]), mi.UInt32(faces[1]))
            number = dr.select(here, met, number)
        outcome.direction, outcome.position, outcome.face = direction, place, number
        return ends[0][2] + ends[1][2]


def _others(axis: int) -> list[int]:
    return [other for other in range(3) if other != axis]


def _mirrored(film: WrappingFilm) -> dict[int, tuple[int, int]]:
    """Numbers of the low and the high face across an axis, where walls stand before both."""
    ends = {
        (plane.axis.index(1.0), plane.high): plane.faces[0]
        for plane in film.crystal.planes
        if sorted(plane.axis) == [0.0, 0.0, 1.0] and plane.faces[0] in film.walls
    }
    axes = [a for a in range(3) if (a, False) in ends and (a, True) in ends]
    return {axis: (ends[axis, False], ends[axis, True]) for axis in axes}
