"""Volumes that are convex: light inside one needs only the planes of its faces, not their bounds.

They are enclosed by flat faces, or by a round wall and the two ends across it. The way out of a
convex solid is the nearest plane ahead that looks along the flight, and the way in is the farthest
plane that looks against it, where that comes before the way out (M. Cyrus and J. Beck, Computers
and Graphics 3 (1978) 23). Parallel planes are tested together, as a slab, and no light is lost
between two faces, because they have no edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.scene_model import OUTSIDE, Circle, Kept, RoundWall, SceneModel

#: A volume of more planes than this is left to others: a tree is faster.
MOST_PLANES = 64
#: The number of no face.
NO_FACE = 0xFFFFFFFF


def slack_of(model: SceneModel) -> float:
    """Rounding (mm) of positions of the scene's size in single precision, with a margin."""
    return 4e-7 * model.size_mm


@dataclass
class Plane:
    """A plane in which faces of a solid lie."""

    #: A vector along the normal whose largest component is 1 or -1; 0 and 1 are exact. Parallel
    #: planes of one scene have the same.
    axis: tuple[float, ...]
    #: Whether the solid lies where ``axis . x <= offset``; else it lies above.
    high: bool
    #: ``axis . x`` of its points.
    offset: float
    #: Indices among ``model.faces``.
    faces: list[int]


@dataclass(frozen=True)
class Solid:
    """A convex volume."""

    #: Index among ``model.volumes``.
    volume: int
    planes: tuple[Plane, ...]
    #: The volumes that are not convex from which light can come in. One at most, but for what
    #: clings to a round wall.
    around: tuple[int, ...]
    #: Indices among ``model.walls`` of the round wall between the planes, which are its ends then.
    #: Where there are two, the second is what the first leaves out above it.
    walls: tuple[int, ...] = ()
    #: Where this wall is.
    circle: Circle | None = None

    def test(self):
        """A function that tells of points (Point3f, mm) whether they lie in it (Mask)."""
        planes = [
            (plane, [opaque([value]) for value in plane.axis], opaque([plane.offset]))
            for plane in self.planes
        ]
        disc = None if self.circle is None else Disc(self.circle, lambda value: opaque([value]))

        def inside(point):
            held = mi.Mask(True) if disc is None else disc.holds(point)
            for plane, weights, offset in planes:
                level = _component(point, plane.axis, weights)
                held &= (level <= offset) if plane.high else (level >= offset)
            return held

        return inside


#: Solids by geometry: benches that follow each other often differ in their surfaces alone.
_known_solids = Kept[list[Solid]](64)


def convex_solids(model: SceneModel) -> list[Solid]:
    """The volumes of a scene that are convex and enclosed by flat faces, but for the outside.

    One with several neighbours that are not convex counts as not convex itself.
    """
    return _known_solids.of(model.geometry, lambda: _find_convex_solids(model))


def _find_convex_solids(model: SceneModel) -> list[Solid]:
    axes: list[np.ndarray] = []
    round_walls = {
        number: walls
        for number in range(len(model.volumes))
        if number != OUTSIDE and (walls := _round_wall(model, number))
    }
    # what is around a round solid
    hollow = {model.around(model.walls[wall]) for walls in round_walls.values() for wall in walls}
    enclosed = {
        number: planes
        for number in range(len(model.volumes))
        if number not in {OUTSIDE, *hollow}
        and (planes := _planes(model, number, axes, round_walls.get(number, ()))) is not None
    }
    clinging = hollow - {OUTSIDE}
    while True:
        around = {}
        for number, planes in enclosed.items():
            surfaces = [model.flat_faces[face].surface for plane in planes for face in plane.faces]
            surfaces += [model.walls[wall].surface for wall in round_walls.get(number, ())]
            sides = {side for surface in surfaces for side in model.surfaces[surface].sides}
            # no light comes back from a liquid without end
            around[number] = sides - enclosed.keys() - {model.endless}
        several = [number for number, others in around.items() if len(others - clinging) > 1]
        if not several:
            break
        for number in several:
            del enclosed[number]
    solids = []
    for number, planes in enclosed.items():
        walls = round_walls.get(number, ())
        circle = model.walls[walls[0]].circle if walls else None
        solids.append(Solid(number, tuple(planes), tuple(sorted(around[number])), walls, circle))
    return solids


def _round_wall(model: SceneModel, volume: int) -> tuple[int, ...]:
    """Indices of the walls that are all of the round wall around a volume; none if it has none."""
    numbers = [i for i, wall in enumerate(model.walls) if model.within(wall) == volume]
    # in the order of their heights
    numbers.sort(key=lambda i: model.walls[i].above_mm)
    walls = [model.walls[i] for i in numbers]
    if not walls or any(volume == model.around(wall) for wall in model.walls):
        return ()
    places = [
        (w.circle.axis, *w.circle.centre_mm, w.circle.radius_mm, w.low_mm, w.high_mm) for w in walls
    ]
    same = np.allclose(places, places[0], atol=slack_of(model))
    ends = [-np.inf, *(wall.below_mm for wall in walls)]
    whole = ends == [*(wall.above_mm for wall in walls), np.inf] and len(walls) <= 2
    return tuple(numbers) if same and whole else ()


def _sides(model: SceneModel, face: int) -> tuple[int, int]:
    """Volumes on the two sides of a flat face."""
    return model.surfaces[model.flat_faces[face].surface].sides


def _planes(
    model: SceneModel, volume: int, axes: list[np.ndarray], walls: tuple[int, ...]
) -> list[Plane] | None:
    """The planes around a volume, or ``None`` if its faces do not enclose a convex solid.

    `axes` are those known so far; new ones are added. `walls` are of its round wall.
    """
    slack, area = slack_of(model), 0.0
    # what stands in it is tested for itself: it leaves a hole in what encloses it
    stands_in = any(volume in model.surfaces[wall.surface].sides for wall in model.walls)
    planes: list[Plane] = []
    all_corners: list[np.ndarray] = []
    for number, face in enumerate(model.flat_faces):
        interior, exterior = _sides(model, number)
        if volume not in (interior, exterior) or interior == exterior:
            continue
        outwards = face.normal if interior == volume else -face.normal
        corners = face.corners
        all_corners.append(corners)
        area += face.filled_area if stands_in else face.area
        axis = _axis(face.normal, corners, axes, slack / 2)
        levels, high = corners @ axis, bool(axis @ outwards > 0)
        offset, side = float(levels.min() + levels.max()) / 2, (tuple(axis.tolist()), high)
        for plane in planes:
            if (plane.axis, plane.high) == side and abs(plane.offset - offset) <= slack / 2:
                plane.faces.append(number)
                break
        else:
            planes.append(Plane(*side, offset, [number]))
            if len(planes) > MOST_PLANES:
                return None
    if not planes:
        return None
    if walls:
        return planes if _are_ends(model, planes, model.walls[walls[0]]) else None
    corners = np.concatenate(all_corners)
    for plane in planes:
        beyond = (corners @ plane.axis - plane.offset) * (1.0 if plane.high else -1.0)
        if beyond.max() > slack:
            return None
    whole = _hull_area(corners, planes)
    # Faces on the hull that cover all of it: less than a strip along the edges may be missing.
    return planes if abs(area - whole) <= 4.0 * slack * np.sqrt(whole) else None


def _hull_area(corners: np.ndarray, planes: list[Plane]) -> float:
    """Area of the convex hull of corners that lie within planes; 0 where they are flat.

    Of six planes along the axes that of the box: if faces cover less, the hull is no matter.
    """
    if len(planes) == 6 and {plane.axis for plane in planes} == set(map(tuple, np.eye(3).tolist())):
        length, width, height = np.ptp(corners, axis=0).tolist()
        return 2.0 * (length * width + (length + width) * height)
    from scipy.spatial import ConvexHull, QhullError  # a third of a second, for few scenes

    try:
        return float(ConvexHull(corners).area)
    except QhullError:
        return 0.0


def _are_ends(model: SceneModel, planes: list[Plane], wall: RoundWall) -> bool:
    """Whether planes are the two ends of a round wall, and their faces all of these."""
    slack, circle = slack_of(model), wall.circle
    along = tuple(np.eye(3)[circle.axis].tolist())
    offsets = sorted((plane.offset, plane.high) for plane in planes)
    if [plane.axis for plane in planes] != [along] * 2 or offsets[0][1]:
        return False
    if not np.allclose([offset for offset, _ in offsets], (wall.low_mm, wall.high_mm), atol=slack):
        return False
    for plane in planes:
        area = 0.0
        for number in plane.faces:
            face = model.flat_faces[number]
            disc = face.circle
            if disc is None:
                away = np.hypot(*(face.corners[:, circle.across] - circle.centre_mm).T)
                held = away.max() <= circle.radius_mm + slack
            else:
                off = np.subtract(disc.centre_mm, circle.centre_mm)
                held = disc.inside and np.hypot(*off) + disc.radius_mm <= circle.radius_mm + slack
            if not held:
                return False
            area += face.area
        if abs(area - circle.area) > 4.0 * slack * circle.radius_mm:
            return False
    return True


def _axis(normal, corners, axes: list[np.ndarray], tolerance: float) -> np.ndarray:
    """The axis of a face: a known or a simple one, if no corner is moved by more than this."""
    scaled = normal / normal[np.argmax(np.abs(normal))]
    rounded = np.round(scaled) + 0.0
    simple = np.where(np.abs(scaled - rounded) < 0.1, rounded, scaled)
    for axis in (*axes, simple, scaled):
        if np.ptp(corners @ axis) <= tolerance:
            break
    if not any(axis is other for other in axes):
        axes.append(axis)
    return axis


class Ray:
    """A ray, with what the planes of several solids share, and light's random numbers."""

    def __init__(self, origin, direction, rng=None) -> None:
        self.origin, self.direction, self.rng = origin, direction, rng
        self._known: dict[tuple[float, ...], tuple] = {}

    def along(self, axis: tuple[float, ...], weights: list):
        """Along an axis: the reciprocal of the speed, the start, and whether it goes upwards."""
        if axis not in self._known:
            reciprocal = dr.rcp(_component(self.direction, axis, weights))
            # from the reciprocal, so that a speed of zero of either sign is right as well
            start, upwards = _component(self.origin, axis, weights), reciprocal > 0.0
            self._known[axis] = reciprocal, start, upwards
        return self._known[axis]


class Disc:
    """A circle in the kernel; `number` makes its numbers."""

    def __init__(self, circle: Circle, number) -> None:
        self.axis = circle.axis
        self.across = circle.across
        self.centre = [number(value) for value in circle.centre_mm]
        self.radius = number(circle.radius_mm)
        self._radius2 = number(circle.radius_mm**2)
        self._inside = circle.inside

    def away(self, point):
        """From its axis (Vector2f, mm)."""
        return mi.Vector2f(*(point[i] - at for i, at in zip(self.across, self.centre, strict=True)))

    def outwards(self, point):
        """Unit vector away from its axis (Vector3f) at points of its circle."""
        away, normal = self.away(point), mi.Vector3f(0.0)
        for i, part in zip(self.across, away, strict=True):
            normal[i] = part
        return dr.normalize(normal)

    def holds(self, point):
        """Whether a point of the face's plane (Point3f, mm) lies on the face."""
        inside = dr.squared_norm(self.away(point)) <= self._radius2
        return inside if self._inside else ~inside

    def crossings(self, ray: Ray):
        """Where a ray leaves the wall on the circle, and where it comes in.

        Distances (Float, mm) at which light within leaves, and light around enters, infinite where
        that misses; and the square of what over the radius is the cosine to the normals there.
        """
        away = self.away(ray.origin)
        along = mi.Vector2f(*(ray.direction[i] for i in self.across))
        a, b = dr.squared_norm(along), dr.dot(away, along)
        c = dr.squared_norm(away) - self._radius2
        root2 = dr.fma(b, b, -a * c)
        root, outwards = dr.safe_sqrt(root2), b >= 0.0
        # the roots of a quadratic without cancellation: -q / a and -c / q
        q = b + dr.select(outwards, root, -root)
        leaves = dr.select(outwards, -c, -q) / dr.select(outwards, q, a)
        enters = dr.select(outwards, -dr.inf, -c / q)
        # what flies along the axis is within it for ever, or never
        missed = dr.select(c < 0.0, -dr.inf, dr.inf)
        return leaves, dr.select(root2 > 0.0, enters, missed), root2


def _component(vector, axis, weights):
    """``axis . vector``; weights other than 0 and 1 come as numbers of the kernel."""
    total = None
    for value, literal, weight in zip(vector, axis, weights, strict=True):
        if literal == 0.0:
            continue
        if abs(literal) == 1.0:
            term = value if literal > 0.0 else -value
            total = term if total is None else total + term
        else:
            total = value * weight if total is None else dr.fma(value, weight, total)
    return total


@dataclass
class _Side:
    """One plane of a solid in the kernel."""

    #: Where light inside leaves.
    offset: Any
    #: Where light from around enters; where none can, the plane is moved outwards by the
    #: slack, so that it does not come before a neighbour that can be entered.
    entered_at: Any
    #: Numbers of the faces met, before `leave_rows` and `enter_rows` tell more; `NO_FACE` where
    #: no light can enter.
    leave: int
    enter: int
    #: list of (int, list of shapes): Other faces of the plane, by the number of the first face of
    #: their surface.
    leave_rows: list
    enter_rows: list


@dataclass
class _Slab:
    """The planes of one axis: the high one and the low one, as far as there are such."""

    axis: tuple[float, ...]
    weights: list
    sides: dict[bool, _Side] = field(default_factory=dict)


class ConvexBody:
    """A convex solid in the kernel.

    `shape_of` gives the bounds of a flat face from its index, an object with ``inside(ray, t)``,
    and `number` a number of the kernel from a float.
    """

    def __init__(self, model: SceneModel, solid: Solid, shape_of, number) -> None:
        self.solid = solid
        self._slack = number(slack_of(model))
        self._wall = None if solid.circle is None else _Mantle(model, solid, number)
        slabs: dict[tuple[float, ...], _Slab] = {}
        for plane in solid.planes:
            if plane.axis not in slabs:
                slabs[plane.axis] = _Slab(plane.axis, [number(value) for value in plane.axis])
            slabs[plane.axis].sides[plane.high] = self._side(model, plane, shape_of, number)
        self._slabs = list(slabs.values())
        self._enters = bool(solid.around)

    def _side(self, model: SceneModel, plane: Plane, shape_of, number) -> _Side:
        rows: dict[int, list[int]] = {}
        for face in plane.faces:
            rows.setdefault(model.flat_faces[face].surface, []).append(face)
        # What has the most faces is what light meets that meets no other: nothing to test.
        ordered = sorted(rows.values(), key=len)
        around = set(self.solid.around)
        from_around = [row for row in ordered if around & set(_sides(model, row[0]))]

        def tests(rows):
            return [(row[0], [shape_of(face) for face in row]) for row in rows[:-1]]

        shift = slack_of(model) if plane.high else -slack_of(model)
        return _Side(
            offset=number(plane.offset),
            entered_at=number(plane.offset if from_around else plane.offset + shift),
            leave=ordered[-1][0],
            enter=from_around[-1][0] if from_around else NO_FACE,
            leave_rows=tests(ordered),
            enter_rows=tests(from_around),
        )

    def meet(self, ray: Ray, best, which, here, last_face):
        """Where light leaves the solid, or enters it, if that is nearer than what is known.

        `best` (Float) and `which` (UInt32), the distance of the nearest face so far and its number,
        are returned as they are then; `here` tells of every volume whether light is in it (Mask).
        Light around a round wall that is on it, by `last_face` (UInt32), flies away from it.
        """
        way = self._way_through(ray, self._slabs)
        if self._wall is not None:
            t, t_in, root2 = self._wall.disc.crossings(ray)
            way.let_out(t < way.out, t, self._wall.met_at(ray, t))
            if self._enters:
                steep = self._wall.disc.radius * dr.rsqrt(root2)
                number = self._wall.met_at(ray, t_in)
                way.let_in(t_in > way.into, t_in, number, dr.minimum(steep, _GRAZING))
                way.entering = dr.select(
                    self._wall.is_of(last_face), mi.UInt32(NO_FACE), way.entering
                )
        out, leaving = self._way_out(way, ray)
        met = here[self.solid.volume] & (out < best)
        best, which = dr.select(met, out, best), dr.select(met, leaving, which)
        if self._enters:
            for side in self._sides:
                way.entering = _resolve(way.entering, side.enter, side.enter_rows, ray, way.into)
            # what rounding has put just behind a face near an edge still meets that face
            ahead = way.into >= -self._slack * dr.abs(way.slowness)
            around, *others = (here[volume] for volume in self.solid.around)
            for other in others:
                around = around | other  # not |=, which would change `here` too
            met = around & ahead & (way.into <= way.out) & (way.into < best)
            met &= way.entering != NO_FACE
            best, which = dr.select(met, way.into, best), dr.select(met, way.entering, which)
        return best, which

    @property
    def _sides(self) -> list[_Side]:
        return [side for slab in self._slabs for side in slab.sides.values()]

    def _way_out(self, way: _Way, ray: Ray):
        """Where light inside leaves (mm), and by which face (UInt32)."""
        return way.out, self._face_at(way.leaving, ray, way.out)

    def _face_at(self, number, ray: Ray, t):
        """Which face of a plane (UInt32), by its first one, light inside meets at a distance."""
        for side in self._sides:
            number = _resolve(number, side.leave, side.leave_rows, ray, t)
        return number

    def _way_through(self, ray: Ray, slabs: list[_Slab]) -> _Way:
        """Where the planes let a ray out, and in, as if there were nothing else."""
        way = _Way(
            out=mi.Float(dr.inf),
            leaving=mi.UInt32(NO_FACE),
            into=mi.Float(-dr.inf),
            entering=mi.UInt32(NO_FACE),
            slowness=mi.Float(0.0),
        )
        for slab in slabs:
            reciprocal, start, upwards = ray.along(slab.axis, slab.weights)
            high, low = slab.sides.get(True), slab.sides.get(False)
            if high is None or low is None:
                side = high or low
                assert side is not None
                facing = upwards if low is None else ~upwards
                far_at, far, near_at, near = side.offset, side.leave, side.entered_at, side.enter
                far_faces, near_faces = facing, ~facing
            else:
                far_at = dr.select(upwards, high.offset, low.offset)
                far = _choice(upwards, high.leave, low.leave)
                near_at = dr.select(upwards, low.entered_at, high.entered_at)
                near = _choice(upwards, low.enter, high.enter)
                far_faces = near_faces = mi.Mask(True)
            t = (far_at - start) * reciprocal
            way.let_out(far_faces & (t < way.out), t, mi.UInt32(far))
            if self._enters:
                t = (near_at - start) * reciprocal
                way.let_in(near_faces & (t > way.into), t, mi.UInt32(near), reciprocal)
        return way


@dataclass(kw_only=True)
class _Way:
    """A ray's way through a solid."""

    #: Where it leaves (mm), and by which face.
    out: Any
    leaving: Any
    #: Where it enters, by which face, and the reciprocal of the speed towards that.
    into: Any
    entering: Any
    slowness: Any

    def let_out(self, nearer, t, number) -> None:
        """End it at a distance where that is `nearer`."""
        self.out = dr.select(nearer, t, self.out)
        self.leaving = dr.select(nearer, number, self.leaving)

    def let_in(self, farther, t, number, slowness) -> None:
        """Begin it at a distance where that is `farther`."""
        self.into = dr.select(farther, t, self.into)
        self.entering = dr.select(farther, number, self.entering)
        self.slowness = dr.select(farther, slowness, self.slowness)


#: Largest reciprocal of the cosine to a round wall's normal by which its slack grows.
_GRAZING = 1e3


class _Mantle:
    """The round wall of a solid in the kernel."""

    def __init__(self, model: SceneModel, solid: Solid, number) -> None:
        assert solid.circle is not None
        self.disc = Disc(solid.circle, number)
        self._numbers = [len(model.flat_faces) + wall for wall in solid.walls]
        self._level = number(model.walls[solid.walls[0]].below_mm)

    def met_at(self, ray: Ray, t):
        """Number (UInt32) of the face that is met at some distance."""
        if len(self._numbers) == 1:
            return mi.UInt32(self._numbers[0])
        return _choice(dr.fma(t, ray.direction.z, ray.origin.z) <= self._level, *self._numbers)

    def is_of(self, face):
        """Whether faces of these numbers (UInt32) are this wall (Mask)."""
        return is_any(face, self._numbers)


def is_any(face, numbers: Sequence[int]):
    """Whether faces (UInt32) have one of these numbers (Mask)."""
    mine = face == numbers[0]
    for number in numbers[1:]:
        mine |= face == number
    return mine


def _choice(mask, number: int, otherwise: int):
    same = number == otherwise
    return number if same else dr.select(mask, mi.UInt32(number), mi.UInt32(otherwise))


def _resolve(number, first: int, rows, ray: Ray, t):
    """Which face of a plane is met at some distance, where it is the `first` so far."""
    here = number == first if rows else None
    for other, shapes in rows:
        inside = mi.Mask(False)
        for shape in shapes:
            inside |= shape.inside(ray, t)
        number = dr.select(here & inside, mi.UInt32(other), number)
    return number
