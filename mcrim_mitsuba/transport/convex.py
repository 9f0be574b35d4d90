"""Volumes that are convex: light inside one needs only the planes of its faces, not their bounds.

The way out of a convex solid is the nearest plane ahead that looks along the flight, and the way in
is the farthest plane that looks against it, where that comes before the way out (M. Cyrus and
J. Beck, Computers and Graphics 3 (1978) 23). Parallel planes are tested together, as a slab,
and no light is lost between two faces, because they have no edges.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from mcrim_mitsuba.transport.scene_model import OUTSIDE, SceneModel, opaque

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
    #: The volume that is not convex from which light can come in; ``None`` where there is none.
    around: int | None

    def test(self):
        """A function that tells of points (Point3f, mm) whether they lie in it (Mask)."""
        known = [
            (plane, [opaque([value]) for value in plane.axis], opaque([plane.offset]))
            for plane in self.planes
        ]

        def inside(point):
            held = mi.Mask(True)
            for plane, weights, offset in known:
                level = _component(point, plane.axis, weights)
                held &= (level <= offset) if plane.high else (level >= offset)
            return held

        return inside


#: Solids of each model that lives: a model's scene must not live longer than its user wants it.
_known_solids: weakref.WeakKeyDictionary[SceneModel, list[Solid]] = weakref.WeakKeyDictionary()


def convex_solids(model: SceneModel) -> list[Solid]:
    """The volumes of a scene that are convex and enclosed by flat faces, but for the outside.

    One with several neighbours that are not convex counts as not convex itself.
    """
    if model not in _known_solids:
        _known_solids[model] = _find_convex_solids(model)
    return _known_solids[model]


def _find_convex_solids(model: SceneModel) -> list[Solid]:
    axes: list[np.ndarray] = []
    found = {
        number: planes
        for number in range(len(model.volumes))
        if number != OUTSIDE and (planes := _planes(model, number, axes)) is not None
    }
    while True:
        around = {
            number: {
                side
                for plane in planes
                for face in plane.faces
                for side in _sides(model, face)
                # no light comes back from a liquid without end
                if side not in found and side != model.endless
            }
            for number, planes in found.items()
        }
        kept = {number: found[number] for number, others in around.items() if len(others) <= 1}
        if len(kept) == len(found):
            break
        found = kept
    return [
        Solid(number, tuple(planes), next(iter(around[number]), None))
        for number, planes in found.items()
    ]


def _sides(model: SceneModel, face: int) -> tuple[int, int]:
    """Volumes on the two sides of a flat face."""
    return model.surfaces[model.flat_faces[face].surface].sides


def _planes(model: SceneModel, volume: int, axes: list[np.ndarray]) -> list[Plane] | None:
    """The planes around a volume, or ``None`` if its flat faces do not enclose a convex solid.

    `axes` are those known so far; new ones are added.
    """
    slack, area = slack_of(model), 0.0
    # what stands in it is tested for itself: it leaves a hole in what encloses it
    stands_in = any(volume in model.surfaces[wall.surface].sides for wall in model.walls)
    planes: list[Plane] = []
    own_corners: list[np.ndarray] = []
    for number, face in enumerate(model.flat_faces):
        interior, exterior = _sides(model, number)
        if volume not in (interior, exterior) or interior == exterior:
            continue
        outwards = face.normal if interior == volume else -face.normal
        own = face.corners
        own_corners.append(own)
        area += face.filled_area if stands_in else face.area
        axis = _axis(face.normal, own, axes, slack / 2)
        levels, high = own @ axis, bool(axis @ outwards > 0)
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
    corners = np.concatenate(own_corners)
    for plane in planes:
        beyond = (corners @ plane.axis - plane.offset) * (1.0 if plane.high else -1.0)
        if beyond.max() > slack:
            return None
    try:
        hull = ConvexHull(corners)
    except QhullError:
        return None
    # Faces on the hull that cover all of it: less than a strip along the edges may be missing.
    return planes if abs(area - hull.area) <= 4.0 * slack * np.sqrt(hull.area) else None


def _axis(normal, corners, axes: list[np.ndarray], tolerance: float) -> np.ndarray:
    """The axis of a face: a known or a simple one, if no corner is moved by more than this."""
    scaled = normal / normal[np.argmax(np.abs(normal))]
    rounded = np.round(scaled) + 0.0
    simple = np.where(np.abs(scaled - rounded) < 0.1, rounded, scaled)
    for axis in (*axes, simple, scaled):
        if np.ptp(corners @ axis) <= tolerance:
            break
    if not any(axis is known for known in axes):
        axes.append(axis)
    return axis


class Ray:
    """A ray, with what the planes of several solids share."""

    def __init__(self, origin, direction) -> None:
        self.origin, self.direction = origin, direction
        self._known: dict[tuple[float, ...], tuple] = {}

    def along(self, axis: tuple[float, ...], weights: list):
        """Along an axis: the reciprocal of the speed, the start, and whether it goes upwards."""
        if axis not in self._known:
            reciprocal = dr.rcp(_component(self.direction, axis, weights))
            # from the reciprocal, so that a speed of zero of either sign is right as well
            self._known[axis] = (
                reciprocal, _component(self.origin, axis, weights), reciprocal > 0.0
            )  # fmt: skip
        return self._known[axis]


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
        slabs: dict[tuple[float, ...], _Slab] = {}
        for plane in solid.planes:
            if plane.axis not in slabs:
                slabs[plane.axis] = _Slab(plane.axis, [number(value) for value in plane.axis])
            slabs[plane.axis].sides[plane.high] = self._side(model, plane, shape_of, number)
        self._slabs = list(slabs.values())

    def _side(self, model: SceneModel, plane: Plane, shape_of, number) -> _Side:
        rows: dict[int, list[int]] = {}
        for face in plane.faces:
            rows.setdefault(model.flat_faces[face].surface, []).append(face)
        # What has the most faces is what light meets that meets no other: nothing to test.
        ordered = sorted(rows.values(), key=len)
        from_around = [row for row in ordered if self.solid.around in _sides(model, row[0])]

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

    def meet(self, ray: Ray, best, which, here):
        """Where light leaves the solid, or enters it, if that is nearer than what is known.

        `best` (Float) and `which` (UInt32), the distance of the nearest face so far and its number,
        are returned as they are then; `here` tells of every volume whether light is in it (Mask).
        """
        enters = self.solid.around is not None
        out, leaving = mi.Float(dr.inf), mi.UInt32(NO_FACE)
        into, entering, slowness = mi.Float(-dr.inf), mi.UInt32(NO_FACE), mi.Float(0.0)
        for slab in self._slabs:
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
            nearer = far_faces & (t < out)
            out, leaving = dr.select(nearer, t, out), dr.select(nearer, mi.UInt32(far), leaving)
            if enters:
                t = (near_at - start) * reciprocal
                farther = near_faces & (t > into)
                into = dr.select(farther, t, into)
                entering = dr.select(farther, mi.UInt32(near), entering)
                slowness = dr.select(farther, reciprocal, slowness)
        inside = here[self.solid.volume]
        for slab in self._slabs:
            for side in slab.sides.values():
                leaving = _resolve(leaving, side.leave, side.leave_rows, ray, out)
                if enters:
                    entering = _resolve(entering, side.enter, side.enter_rows, ray, into)
        met = inside & (out < best)
        best, which = dr.select(met, out, best), dr.select(met, leaving, which)
        if enters:
            # what rounding has put just behind a face near an edge still meets that face
            ahead = into >= -self._slack * dr.abs(slowness)
            met = here[self.solid.around] & ahead & (into <= out) & (into < best)
            met &= entering != NO_FACE
            best, which = dr.select(met, into, best), dr.select(met, entering, which)
        return best, which


def _choice(mask, one: int, other: int):
    return one if one == other else dr.select(mask, mi.UInt32(one), mi.UInt32(other))


def _resolve(number, found: int, rows, ray: Ray, t):
    """Which face of a plane is met at some distance, where it is `found` so far."""
    here = number == found if rows else None
    for other, shapes in rows:
        inside = mi.Mask(False)
        for shape in shapes:
            inside |= shape.inside(ray, t)
        number = dr.select(here & inside, mi.UInt32(other), number)
    return number
