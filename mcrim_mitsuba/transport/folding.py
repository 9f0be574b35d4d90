"""Flights of light in the crystal that pass over total reflections (drawn in docs/theory.md).

Where a polished face reflects all of the light, nothing happens but that one component of the
direction changes its sign. In a box no other face's angle changes by that. So it is known before a
flight which faces light may leave by, and when it comes to the first of these: it goes there at
once, or to where it scatters, along a straight line through mirror images of the crystal, and place
and direction are folded back. The path is as long as it is from reflection to reflection. Along a
round wall, which light meets at the same angle every time, it is turned back instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import drjit as dr
import mitsuba as mi

from mcrim_mitsuba.transport.conversion import opaque
from mcrim_mitsuba.transport.convex import NO_FACE, ConvexBody, Ray, Solid, is_any
from mcrim_mitsuba.transport.scene_model import DIELECTRIC, SceneModel, Surface

#: Most widths of the crystal that are flown at once: single precision then errs by 6e-6 of a width.
#: Longer flights go on from there.
MOST_WIDTHS = 64.0
#: Sine squared that no angle of incidence has.
_NEVER = 2.0
#: Part by which sines squared must exceed that of the critical angle, for rounding.
_MARGIN = 1e-6


# ---- what may be folded --------------------------------------------------------------------------


def total_from(surface: Surface, volume: int) -> float:
    """Sine squared of the angle of incidence from which on light from a volume is only reflected.

    A face that is rough, hazy, masked, takes part of the light, or is no interface of two
    dielectrics does other things too at any angle: 2 there. One that a wrapping touches everywhere
    with the same probability does so but for that, see `FoldedBody`.
    """
    polished = surface.kind == DIELECTRIC and not (surface.roughness or surface.haze)
    if (
        not polished
        or surface.contact == 1.0
        or surface.contact_above_mm > -math.inf
        or surface.surface_loss
        or surface.aperture_radius_mm < math.inf
    ):
        return _NEVER
    ratio = surface.eta if surface.interior == volume else 1.0 / surface.eta
    return float(ratio**-2) * (1.0 + _MARGIN)


def folded_axes(model: SceneModel, solid: Solid) -> tuple[int, ...]:
    """Axes of the scene (0, 1, 2) along which light's direction may change its sign unseen.

    - Nothing stands in the solid that light would meet on its straight way.
    - Two of its planes are across the axis, and all other faces along it: there the angles of
      incidence stay as they are, and so does all that happens later, mirrored.
    - One of these two planes reflects all light at some angle (`total_from`); where a wrapping
      touches faces of them, it does so to all of a plane, and to both, if so, alike.
    - Scattering is as strong at either of two places that are mirror images along the axis.

    Trails are not folded, because they show every reflection. Of polarised light see `traps`.
    """
    uneven = bool(model.volumes[solid.volume].scattering_gradient)

    def folds(axis: int) -> bool:
        across = [p for p in solid.planes if sorted(map(abs, p.axis)) == [0.0, 0.0, 1.0]]
        across = [p for p in across if p.axis[axis]]
        along = [p for p in solid.planes if not p.axis[axis]]
        return (
            (len(across), len(along)) == (2, len(solid.planes) - 2)
            and (solid.circle is None or solid.circle.axis == axis)
            and not (uneven and axis == 2)
            and min(_all_total_from(model, solid, p.faces) for p in across) < 1.0
            and None not in (touched := [_contact_of(model, solid, p.faces) for p in across])
            and len({contact for contact in touched if contact}) < 2
        )

    return () if _holds_something(model, solid) else tuple(filter(folds, range(3)))


def wall_folds(model: SceneModel, solid: Solid) -> bool:
    """Whether light's direction may turn unseen where the solid's round wall reflects it.

    It meets the wall at the same angle every time, keeps its angle to the ends, and goes on as far
    round the axis. The wall must reflect all light at some angle; scattering must be as strong all
    around the axis.
    """
    if solid.circle is None or _holds_something(model, solid):
        return False
    uneven = bool(model.volumes[solid.volume].scattering_gradient) and solid.circle.axis != 2
    touched = any(model.surfaces[model.walls[number].surface].contact for number in solid.walls)
    return not uneven and not touched and _walls_total_from(model, solid) < 1.0


def traps(model: SceneModel, solid: Solid) -> bool:
    """Whether light may be held until it scatters: by the box, or the round wall with its ends.

    Total reflection turns the field of polarised light, which tells what becomes of it at the next
    face that is open, and which scattering takes away. So of that light only what no face lets out
    is passed over reflections, and that by no wrapping that touches.
    """
    axes = [0, 1, 2] if solid.circle is None else [solid.circle.axis]
    return (
        list(folded_axes(model, solid)) == axes
        and (solid.circle is None or wall_folds(model, solid))
        and all(
            _all_total_from(model, solid, p.faces) < 1.0 and not _contact_of(model, solid, p.faces)
            for p in solid.planes
        )
    )


def _holds_something(model: SceneModel, solid: Solid) -> bool:
    """Whether light in a solid meets faces that are not around it."""
    borders = [face.surface for face in model.flat_faces] + [wall.surface for wall in model.walls]
    bordering = sum(solid.volume in model.surfaces[number].sides for number in borders)
    return bordering > len(solid.walls) + sum(len(plane.faces) for plane in solid.planes)


def _all_total_from(model: SceneModel, solid: Solid, faces: Iterable[int]) -> float:
    """`total_from` of all of some flat faces."""
    surfaces = {model.flat_faces[face].surface for face in faces}
    return max(total_from(model.surfaces[number], solid.volume) for number in surfaces)


def _contact_of(model: SceneModel, solid: Solid, faces: Iterable[int]) -> float | None:
    """Probability that a wrapping touches light which a plane would reflect totally.

    None where that differs from face to face; 0 of what light is never passed over at.
    """
    if _all_total_from(model, solid, faces) >= 1.0:
        return 0.0
    contacts = {model.surfaces[model.flat_faces[face].surface].contact for face in faces}
    return contacts.pop() if len(contacts) == 1 else None


def _walls_total_from(model: SceneModel, solid: Solid) -> float:
    surfaces = [model.surfaces[model.walls[number].surface] for number in solid.walls]
    return max(total_from(surface, solid.volume) for surface in surfaces)


# ---- how it is folded ----------------------------------------------------------------------------


class FoldedBody(ConvexBody):
    """A convex solid in the kernel, in which light flies on over total reflections.

    Flights end `MOST_WIDTHS` away at the latest, at `NO_FACE` where no face is there. Where a
    wrapping touches faces, each of these reflections is none with that probability: how many there
    are before is drawn at once, and the flight ends at a face of `touched` then. Of `polarized`
    light only what the solid traps flies on, see `traps`.
    """

    def __init__(self, model: SceneModel, solid: Solid, shape_of, number, polarized: bool) -> None:
        super().__init__(model, solid, shape_of, number)
        self._polarized = polarized
        axes = folded_axes(model, solid)
        planes = {(plane.axis, plane.high): plane for plane in solid.planes}
        #: By axis that folds: its slab, where its ends reflect all, its width (mm) and 1 over that.
        self.axes: dict[int, tuple] = {}
        self._straight, widths = [], []
        self._contacts: dict[int, tuple] = {}
        #: Numbers of faces that light meets at an angle of total reflection where it is touched.
        self.touched: list[int] = []
        for slab in self._slabs:
            axis = next((a for a in axes if slab.axis[a]), None)
            if axis is None:
                self._straight.append(slab)
                continue
            ends = [planes[slab.axis, high] for high in (False, True)]
            widths.append(ends[1].offset - ends[0].offset)
            # not shared where they agree by chance: the kernel must not depend on indices
            totals = [opaque([_all_total_from(model, solid, end.faces)]) for end in ends]
            self.axes[axis] = slab, totals, number(widths[-1]), number(1.0 / widths[-1])
            contacts = [_contact_of(model, solid, end.faces) or 0.0 for end in ends]
            if any(contacts):
                per_log = opaque([1.0 / math.log1p(-max(contacts))])
                self._contacts[axis] = per_log, *map(bool, contacts)
                pairs = zip(ends, contacts, strict=True)
                self.touched += [f for end, c in pairs if c for f in end.faces]
        self._wall_total = None
        if wall_folds(model, solid):
            assert solid.circle is not None
            widths.append(2.0 * solid.circle.radius_mm)
            self._wall_total = opaque([_walls_total_from(model, solid)])
        self._longest = number(MOST_WIDTHS * max(widths))

    @classmethod
    def suits(cls, model: SceneModel, solid: Solid, polarized: bool) -> bool:
        """Whether anything of a solid folds."""
        if polarized:
            return traps(model, solid)
        return bool(folded_axes(model, solid)) or wall_folds(model, solid)

    def _is_trapped(self, ray: Ray):
        """Whether all faces reflect all light that flies so (Mask)."""
        trapped = mi.Mask(True)
        if self._wall is not None:
            trapped &= self._reflects_round(self._wall.disc.crossings(ray)[2])
        for axis, (_, totals, _, _) in self.axes.items():
            sine2 = dr.fma(-ray.direction[axis], ray.direction[axis], 1.0)
            trapped &= sine2 >= dr.maximum(*totals)
        return trapped

    def _way_out(self, way, ray: Ray):
        if self._polarized:
            trapped = self._is_trapped(ray)
            distance = dr.select(trapped, self._longest, way.out)
            number = dr.select(trapped, mi.UInt32(NO_FACE), way.leaving)
            return distance, self._face_at(number, ray, distance)
        out = self._way_through(ray, self._straight)
        if self._wall is not None:
            t, _, root2 = self._wall.disc.crossings(ray)
            opens = ~self._reflects_round(root2)
            out.let_out(opens & (t < out.out), t, self._wall.met_at(ray, t))
        for axis, (slab, totals, width, _) in self.axes.items():
            reciprocal, start, upwards = ray.along(slab.axis, slab.weights)
            sine2 = dr.fma(-ray.direction[axis], ray.direction[axis], 1.0)
            low, high = slab.sides[False], slab.sides[True]
            # past the first of the two where that reflects all, and past the second likewise
            opens = sine2 < dr.select(upwards, totals[1], totals[0])
            then_opens = sine2 < dr.select(upwards, totals[0], totals[1])
            t = (dr.select(upwards, high.offset, low.offset) - start) * reciprocal
            t_then = dr.fma(width, dr.abs(reciprocal), t)
            t_open = dr.select(opens, t, dr.select(then_opens, t_then, dr.inf))
            number = dr.select(upwards == opens, mi.UInt32(high.leave), mi.UInt32(low.leave))
            out.let_out(t_open < out.out, t_open, number)
            if axis in self._contacts:
                per_log, at_low, at_high = self._contacts[axis]
                # reflections before the one that is none, of those where it could be none
                missed = dr.floor(dr.log(1.0 - ray.rng.next_float32()) * per_log)
                if not (at_low and at_high):
                    # every other one: from the first on, or from the second
                    missed = 2.0 * missed + dr.select(upwards == mi.Mask(at_high), 0.0, 1.0)
                t = dr.fma(missed, dr.abs(width * reciprocal), t)
                first = missed == 2.0 * dr.floor(0.5 * missed)
                number = dr.select(upwards == first, mi.UInt32(high.leave), mi.UInt32(low.leave))
                out.let_out(~opens & (t < t_open) & (t < out.out), t, number)
        out.let_out(out.out >= self._longest, self._longest, mi.UInt32(NO_FACE))
        if any(side.leave_rows for side in self._sides):
            place, flying, _ = self.folded(ray.origin, ray.direction, out.out, out.leaving, True)
            ray = Ray(place, flying)
        return out.out, self._face_at(out.leaving, ray, mi.Float(0.0))

    def folded(self, origin, direction, distance, met, mine):
        """Place, direction and number (UInt32) of reflections at the end of light's flights.

        `met` (UInt32) is the face that a flight reached, or `NO_FACE`; `mine` (Mask) tells which
        are in the solid. Others are straight.
        """
        place, flying = dr.fma(direction, distance, origin), mi.Vector3f(direction)
        folds = mi.UInt32(0)
        if self._polarized:
            mine = mine & self._is_trapped(Ray(origin, direction))  # the mask is the caller's
        if self._wall_total is not None:
            folds = self._turn(place, flying, Ray(origin, direction), distance, mine)
        for axis, (slab, _, width, per_width) in self.axes.items():
            low, high = slab.sides[False], slab.sides[True]
            along = place[axis] - low.offset
            cell = dr.floor(along * per_width)
            number = mi.Int32(cell)
            odd = mine & ((number & 1) == 1)
            rest = dr.fma(-cell, width, along)
            x = dr.select(odd, high.offset - rest, low.offset + rest)
            v = dr.select(odd, -direction[axis], direction[axis])
            count = mi.UInt32(dr.abs(number))
            # a face that is met is met exactly, by light that flies towards it
            speed, upwards = dr.abs(v), direction[axis] > 0.0
            level = mi.Int32(dr.round(along * per_width))
            before = mi.UInt32(dr.select(upwards, level - 1, -level))
            for side, towards in ((low, -speed), (high, speed)):
                here = is_any(met, [side.leave, *(other for other, _ in side.leave_rows)])
                x, v = dr.select(here, side.offset, x), dr.select(here, towards, v)
                count = dr.select(here, before, count)
            place[axis] = dr.select(mine, x, place[axis])
            flying[axis] = dr.select(mine, v, direction[axis])
            folds += dr.select(mine, count, 0)
        return place, flying, folds

    def _reflects_round(self, root2):
        """Whether the round wall reflects all light that it meets at such an angle (Mask)."""
        assert self._wall is not None
        if self._wall_total is None:
            return mi.Mask(False)
        return 1.0 - root2 / dr.square(self._wall.disc.radius) >= self._wall_total

    def _turn(self, place, flying, ray: Ray, distance, mine):
        """Turn places and directions by the reflections at the round wall; their number."""
        assert self._wall is not None
        disc = self._wall.disc
        first, _, root2 = disc.crossings(ray)
        away, along = disc.away(ray.origin), mi.Vector2f(*(ray.direction[i] for i in disc.across))
        chord = 2.0 * dr.safe_sqrt(root2) / dr.squared_norm(along)
        turns = mine & self._reflects_round(root2) & (distance > first)
        count = dr.select(turns, dr.floor((distance - first) / chord) + 1.0, 0.0)
        # each chord is the one before, turned about the axis by what it spans there
        lever = along.y * away.x - along.x * away.y
        span = 2.0 * dr.atan2(dr.safe_sqrt(root2), dr.abs(lever))
        sine, cosine = dr.sincos(dr.mulsign(count * span, lever))
        last = dr.fma(along, distance - count * chord, away)
        for vector, (x, y), middle in ((place, last, disc.centre), (flying, along, (0.0, 0.0))):
            turned = dr.fma(x, cosine, -y * sine), dr.fma(x, sine, y * cosine)
            for i, part, at in zip(disc.across, turned, middle, strict=True):
                vector[i] = dr.select(turns, part + at, vector[i])
        return mi.UInt32(count)
