"""Fast path: the scene's few flat faces are intersected in vector registers.

A bench has a few dozen flat faces; testing them without a tree, without
virtual calls and with the loop's state in registers is several times faster
than `scene.ray_intersect`. Plane equations are exact, so there is no epsilon
by which a ray is moved off a face, and thin gaps do not leak. The faces of convex volumes,
which are nearly all, are tested as planes (`transport.convex`), the others one by one.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport import surface_physics
from mcrim_mitsuba.transport.conversion import opaque, opaque_vector
from mcrim_mitsuba.transport.convex import (
    NO_FACE,
    ConvexBody,
    Disc,
    Ray,
    Solid,
    convex_solids,
    is_any,
    slack_of,
)
from mcrim_mitsuba.transport.film import FilmTrips, film_before
from mcrim_mitsuba.transport.folding import FoldedBody
from mcrim_mitsuba.transport.scene_model import OTHER, OUTSIDE, RoundWall, SceneModel, Surface
from mcrim_mitsuba.transport.shuttle import Shuttle

#: More faces than this, or planes of convex volumes, and a tree is faster.
MOST_FACES = 64
#: Beyond which component of a unit normal a face counts as perpendicular to an axis.
AXIS_ALIGNED = 1.0 - 1e-7


def suits(model: SceneModel) -> bool:
    """Whether the fast path can follow light through this scene."""
    if model.faces is None or any(surface.kind == OTHER for surface in model.surfaces):
        return False
    solids = convex_solids(model)
    alone = _standing_alone(model, solids)
    sides = [model.surfaces[model.flat_faces[number].surface].sides for number in alone]
    if any(model.endless in pair for pair in sides if model.endless is not None):
        return False
    tests = len(alone) + len(model.walls) + sum(len(solid.planes) for solid in solids)
    return tests <= MOST_FACES


@dataclass(frozen=True)
class _Rectangle:
    """A face perpendicular to an axis; numbers are opaque, the rest is literal in the kernel."""

    axis: int
    positive: bool
    plane: Any
    middle: dict[int, Any]
    half: dict[int, Any]
    #: What of it is left.
    circle: Disc | None = None

    def crossed(self, ray, reciprocal, offset):
        """Where a ray crosses the plane, from the reciprocal speed; whether from behind."""
        upwards = ray.direction[self.axis] > 0
        t = dr.fma(self.plane, reciprocal[self.axis], -offset[self.axis])
        return t, upwards if self.positive else ~upwards

    def inside(self, ray, t):
        """Whether a point of the ray, which lies in the plane, lies on the face."""
        inside = mi.Mask(True)
        for i, half in self.half.items():
            along = dr.fma(t, ray.direction[i], ray.origin[i])
            if i in self.middle:
                along -= self.middle[i]
            inside &= dr.abs(along) <= half
        if self.circle is not None:
            inside &= self.circle.holds(dr.fma(ray.direction, t, ray.origin))
        return inside


@dataclass(frozen=True)
class _Oblique:
    """A face at any angle: coordinates along its edges by the dual basis, in mm."""

    triangle: bool
    normal: Any
    corner: Any
    dual: list
    extent: list
    slack: Any

    def crossed(self, ray, _reciprocal, _offset):
        """Where a ray crosses the plane; whether from behind."""
        towards = dr.dot(ray.direction, self.normal)
        return dr.dot(self.corner - ray.origin, self.normal) / towards, towards > 0

    def inside(self, ray, t):
        """Whether a point of the ray, which lies in the plane, lies on the face."""
        point, slack = dr.fma(ray.direction, t, ray.origin - self.corner), self.slack
        u, v = (dr.dot(point, row) for row in self.dual)
        inside = (u >= -slack) & (v >= -slack)
        if self.triangle:
            share = u / self.extent[0] + v / self.extent[1]
            return inside & (share <= 1.0 + slack / self.extent[0])
        return inside & (u <= self.extent[0] + slack) & (v <= self.extent[1] + slack)


class FlatPath:
    """Intersection and interaction with a scene of flat faces, for which `suits` is true.

    With `polarization` photons carry a field, see `surface_physics`. In the volume `fold` flights
    pass over total reflections, as far as they can, and lead through a wrapping's film and back.
    """

    name = "fast path for flat faces"

    def __init__(self, model: SceneModel, polarization: bool, fold: int | None = None) -> None:
        if any(wall.outwards for wall in model.walls):
            self.name = "fast path for flat and round faces"
        self.model = model
        self.polarization = polarization
        faces = model.flat_faces
        # Slack where faces meet: rounding of positions of the scene's size in single
        # precision, so that no ray slips out between two faces.
        self._slack_mm = slack_of(model)
        self._numbers: dict[float, mi.Float] = {}
        self._behind = self._number(-100.0 * self._slack_mm)
        solids = convex_solids(model)

        def body(solid: Solid) -> ConvexBody:
            parts = model, solid, lambda i: self._shape(faces[i]), self._number
            if solid.volume == fold and FoldedBody.suits(model, solid, polarization):
                return FoldedBody(*parts, polarization)
            return ConvexBody(*parts)

        self._bodies = [body(solid) for solid in solids]
        #: Where flights pass over total reflections.
        self.folded = next((b for b in self._bodies if isinstance(b, FoldedBody)), None)
        #: What leads light through the film before a wrapping.
        wrapped = None if polarization else next((s for s in solids if s.volume == fold), None)
        film = None if wrapped is None else film_before(model, wrapped)
        self.film = None if film is None else FilmTrips(model, film)
        #: What leads it to and fro between a wrapping's mirrors.
        self.shuttle = None
        if film is not None and self.folded is not None:
            self.shuttle = Shuttle.before(model, film, self.folded)
        # numbers of the faces that are tested one by one, their interior and exterior, their bounds
        self._alone = [
            (number, model.surfaces[faces[number].surface].sides, self._shape(faces[number]))
            for number in _standing_alone(model, solids)
        ]
        # round walls, whose normals depend on the place, are numbered behind the flat faces
        self._walls = [(wall, Disc(wall.circle, self._number)) for wall in model.walls]
        self._walls_alone = _walls_alone(model, solids)
        self._tables = surface_physics.SurfaceTables(*rows_of(model))
        #: As of `surface_physics.SurfaceTables`.
        self.surfaces_may_absorb = self._tables.may_absorb
        self.surfaces_scatter = self._tables.may_scatter

    def _number(self, value: float):
        """A number of the kernel; faces that share it also share what is computed from it."""
        key = float(np.float32(value))
        if key not in self._numbers:
            self._numbers[key] = opaque([key])
        return self._numbers[key]

    def _shape(self, face) -> _Rectangle | _Oblique:
        """Plane and bounds of a face."""
        axis = int(np.argmax(np.abs(face.normal)))
        edges = (face.edge_u, face.edge_v)
        aligned = not face.triangle and all(
            np.abs(v).max() > AXIS_ALIGNED * np.linalg.norm(v) for v in (face.normal, *edges)
        )
        if not aligned:
            # Rows of the dual basis give the coordinates along the edges; they are divided
            # so that a slack in mm can be compared with them.
            dual = np.linalg.inv(np.column_stack([*edges, face.normal]))[:2]
            extent = 1.0 / np.linalg.norm(dual, axis=1)
            return _Oblique(
                triangle=face.triangle,
                normal=opaque_vector(face.normal),
                corner=opaque_vector(face.corner),
                dual=[opaque_vector(row * size) for row, size in zip(dual, extent, strict=True)],
                extent=[opaque([size]) for size in extent],
                slack=self._number(self._slack_mm),
            )
        far = face.corner + face.edge_u + face.edge_v
        middle, half = (face.corner + far) / 2, np.abs(far - face.corner) / 2
        others = [other for other in range(3) if other != axis]
        return _Rectangle(
            axis=axis,
            positive=bool(face.normal[axis] > 0),
            plane=self._number(face.corner[axis]),
            # most faces of a bench are centred on an axis: nothing to subtract there
            middle={i: self._number(middle[i]) for i in others if abs(middle[i]) > self._slack_mm},
            half={i: self._number(half[i] + self._slack_mm) for i in others},
            circle=None if face.circle is None else Disc(face.circle, self._number),
        )

    def intersect(self, ray_o, ray_d, last_face, volume, rng=None):
        """Nearest face ahead: distance (Float, mm, infinite where nothing is) and number (UInt32).

        A face is met only from the volume that it borders or stands in, and one that is tested
        alone never by a photon that is on it; so a point that rounding has put just behind a face
        near an edge still meets that face, at a distance of (nearly) zero. Where a wrapping touches
        at random, `rng` tells where it does so next.
        """
        reciprocal = dr.rcp(ray_d)
        offset = ray_o * reciprocal
        best, which = mi.Float(dr.inf), mi.UInt32(NO_FACE)
        here = [volume == number for number in range(len(self.model.volumes))]
        endless = self.model.endless
        if endless is not None:
            here[OUTSIDE] |= here[endless]
        ray = Ray(ray_o, ray_d, rng)
        for body in self._bodies:
            best, which = body.meet(ray, best, which, here, last_face)
        for face, (interior, exterior), shape in self._alone:
            number = mi.UInt32(face)
            t, leaving = shape.crossed(ray, reciprocal, offset)
            if interior != exterior:
                bordering = (leaving & here[interior]) | (~leaving & here[exterior])
                ahead = (t > self._behind) & bordering
            else:
                ahead = (t > 0.0) & here[interior]
            hit = ahead & shape.inside(ray, t) & (t < best) & (last_face != number)
            best, which = dr.select(hit, t, best), dr.select(hit, number, which)
        for index, (wall, disc) in enumerate(self._walls):
            if wall in self._walls_alone:
                number = mi.UInt32(len(self.model.flat_faces) + index)
                for t, hit in self._crossings(ray, wall, disc, here, last_face == number):
                    nearer = hit & (t < best)
                    nearer &= self._between(ray, t, disc.axis, wall.low_mm, wall.high_mm)
                    nearer &= self._between(ray, t, 2, wall.above_mm, wall.below_mm)
                    best, which = dr.select(nearer, t, best), dr.select(nearer, number, which)
        if endless is not None:
            others = here[endless] & (which != NO_FACE)
            which = dr.select(others, which + self._count, which)
        return dr.maximum(best, 0.0), which

    def _crossings(self, ray: Ray, wall: RoundWall, disc: Disc, here, on_it):
        """Where a ray crosses a round wall, and whether light, `on_it` or not, meets it there."""
        within, around = self.model.within(wall), self.model.around(wall)
        leaves, enters, root2 = disc.crossings(ray)
        # what lies within may be the outside, whose light need not come near
        near = root2 > 0.0
        if within == around:
            # a sheet, met from either side; of light on it, what flies inwards meets it again
            inwards, near = enters > -dr.inf, near & here[within]
            return [
                (enters, ~on_it & (enters > 0.0) & near),
                (leaves, (~on_it | inwards) & (leaves > 0.0) & near),
            ]
        t = dr.select(here[within], leaves, enters)
        # light around it that is on it flies away from it
        faced = here[within] | (here[around] & ~on_it)
        return [(t, faced & (t > self._behind) & near)]

    def _between(self, ray: Ray, t, axis: int, low: float, high: float):
        """Whether a point of the ray lies between two levels on an axis, as far as there are."""
        along, between = dr.fma(t, ray.direction[axis], ray.origin[axis]), mi.Mask(True)
        if low > -np.inf:
            between &= along >= self._number(low)
        return between & (along <= self._number(high)) if high < np.inf else between

    @staticmethod
    def face_of(face):
        """Number (UInt32) of the face that `intersect` found."""
        return face

    def interact(self, position, direction, field, face, uniforms, rng, active):
        """What happens at the face: see `surface_physics.interact`."""
        row = self._tables.at(face, active)
        self.turn_normals(row, face, position)
        film, beyond = self.film, None
        if film is not None:
            beyond = functools.partial(film.go, face=face, rng=rng, active=active)
        touched = None if self.folded is None else self.folded.touched
        return surface_physics.interact(
            row,
            position,
            direction,
            field,
            uniforms,
            rng,
            active,
            beyond,
            is_any(face, touched) if touched else None,
        )

    def turn_normals(self, row, face, position) -> None:
        """Give rows of round walls their normals at the places where light meets them."""
        if self.model.endless is not None:
            face = dr.select(face >= self._count, face - self._count, face)
        for number, (wall, disc) in enumerate(self._walls):
            outwards = disc.outwards(position)
            mine = face == len(self.model.flat_faces) + number
            row.normal = dr.select(mine, outwards if wall.outwards else -outwards, row.normal)

    @property
    def _count(self) -> int:
        """Of faces and walls."""
        return len(self.model.flat_faces) + len(self.model.walls)


def rows_of(model: SceneModel) -> tuple[list[Surface], list[np.ndarray]]:
    """Surface and normal of every flat face and then of every wall, as the tables have them.

    Where a volume is endless, all once more as light in it meets them.
    """
    numbers = [face.surface for face in model.flat_faces]
    surfaces = [model.surfaces[i] for i in (*numbers, *(wall.surface for wall in model.walls))]
    normals = [face.normal for face in model.flat_faces] + [np.zeros(3)] * len(model.walls)
    if model.endless is None:
        return surfaces, normals
    return surfaces + [model.open_to(surface) for surface in surfaces], normals * 2


def _standing_alone(model: SceneModel, solids: list[Solid]) -> list[int]:
    """Faces that are no part of the convex solids' tests: they border none, or lie inside one."""
    convex = {solid.volume for solid in solids}
    sides = [set(model.surfaces[face.surface].sides) for face in model.flat_faces]
    return [i for i, pair in enumerate(sides) if len(pair) == 1 or not pair & convex]


def _walls_alone(model: SceneModel, solids: list[Solid]) -> list[RoundWall]:
    """Round walls that are no part of the convex solids' tests."""
    of_solids = {number for solid in solids for number in solid.walls}
    return [wall for number, wall in enumerate(model.walls) if number not in of_solids]
