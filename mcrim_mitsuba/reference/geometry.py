"""The bench's media and bodies: convex bodies, where rays cross them, what lies behind faces."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.efficiency.bench import (
    BEAM_AXES,
    NARROW_COLLAR_WIDTH_MM,
    PLATE_DISTANCE_MM,
    TOP_FILM_MM,
    Bench,
)

#: Arrays of the tracer; those of vectors have the shape (3, n).
Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
#: `layout.Place` codes.
Codes = NDArray[np.int8]

TOLERANCE_MM = 1e-9
"""Float64 rounding stays below 1e-13 mm on a bench of centimetres; a photon further than
this on the wrong side of a plane is lost, which the tracer counts and never forgives."""

# Faces of `Box`; a crystal with chamfers has the most.
BOTTOM = 4
TOP = 5
#: Of an upright `Cylinder`, beside these.
WALL = 0
_MOST_FACES = 18


class Box:
    """A box with faces along the axes, whose twelve edges may carry 45 degree chamfers.

    It is what lies between pairs of parallel planes, ``low <= axis @ x <= high``. Inside, a ray
    ends at the nearest of the planes that it approaches; from outside it enters where the last of
    the slabs is entered, provided that none has been left by then (T. L. Kay and J. T. Kajiya,
    SIGGRAPH 1986). The faces are -x, +x, -y, +y, `BOTTOM` and `TOP`, then the chamfers.
    """

    def __init__(
        self, low: tuple[float, float, float], high: tuple[float, float, float], leg: float = 0.0
    ) -> None:
        """Make the box between two corners; a chamfer takes `leg` off two faces. All in mm."""
        axes, lows, highs = list(np.eye(3)), list(low), list(high)
        for i, j in itertools.combinations(range(3) if leg else (), 2):
            for sign in (1.0, -1.0):
                ends = sorted((sign * low[j], sign * high[j]))
                axes.append((np.eye(3)[i] + sign * np.eye(3)[j]) / math.sqrt(2.0))
                lows.append((low[i] + ends[0] + leg) / math.sqrt(2.0))
                highs.append((high[i] + ends[1] - leg) / math.sqrt(2.0))
        self._axes = np.array(axes)
        self._low, self._high = np.array([lows, highs], dtype=np.float64)[:, :, None]
        self._planes = np.column_stack((lows, highs)).ravel() + 0.0
        signs = np.tile([-1.0, 1.0], len(axes))
        #: (faces, 3) float64: Unit outward normals. Adding zero turns -0.0 into 0.0.
        self.normals = np.repeat(self._axes, 2, axis=0) * signs[:, None] + 0.0
        #: (faces,) float64, mm: Distance of each plane from the origin along its normal.
        self.offsets = self._planes * signs + 0.0
        # the faces towards lower coordinates; the opposite one has the next number
        self._first_faces = 2 * np.arange(len(axes))[:, None]

    def exit(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """Where rays that start inside leave the body: distance in mm, face, and strays, (n,) each.

        Only planes that the ray approaches count, so a photon that was just
        reflected off a plane cannot meet it again, however it was rounded. The distance is not
        negative, even for a start that rounding has put outside; one that is outside by more than
        `TOLERANCE_MM` has strayed.
        """
        along, speed = self._along(position), self._along(direction)
        # of each axis one plane is ahead; a direction along a plane never reaches it
        ahead = ~np.signbit(speed)
        times = np.where(ahead, self._high, self._low)
        times -= along
        with np.errstate(divide="ignore", invalid="ignore"):
            times /= speed
        # fmin leaves out the NaN of a start on a plane that the flight is parallel to
        distance = np.fmin.reduce(times)
        face = _face_of(times == distance, ahead + self._first_faces)
        strayed = self._beyond(along, TOLERANCE_MM)
        return np.maximum(distance, 0.0, out=distance), face, strayed

    def entry(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """Where rays that start outside meet the body.

        A ray that starts on the body's surface must not be asked about (a
        convex body is not met twice): rounding would decide the answer.

        What is returned is as of `exit`; the distance is infinite where the ray misses, and
        starts inside have strayed.
        """
        along, speed = self._along(position), self._along(direction)
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low, to_high = (self._low - along) / speed, (self._high - along) / speed
        # of a start on a plane that the flight is parallel to, the NaN is left out
        near = np.fmin(to_low, to_high)
        enters, leaves = np.maximum.reduce(near), np.minimum.reduce(np.fmax(to_low, to_high))
        face = _face_of(near == enters, np.signbit(speed) + self._first_faces)
        return _if_met(enters, leaves), face, ~self._beyond(along, -TOLERANCE_MM)

    def contains(self, position: Floats) -> Flags:
        """True where a point, (3, n) in mm, is in the body: (n,) bool."""
        return ~self._beyond(self._along(position), 0.0)

    def snap(self, position: Floats, face: Indices) -> tuple[Floats, Floats]:
        """Move points that lie on a face to rounding onto it as exactly as float64 can.

        For planes along the axes the coordinate becomes exact, which keeps
        planes that bodies share (the crystal's side and the gap's) shared. The faces' outward
        unit normals are returned too.
        """
        normal = self.normals.T.take(face, axis=1)
        if len(self._axes) > 3:
            return position + (self.offsets[face] - dot(normal, position)) * normal, normal
        snapped = position.copy()
        snapped[face >> 1, np.arange(face.size)] = self._planes[face]
        return snapped, normal

    def _along(self, vectors: Floats) -> Floats:
        """Components along the axes of the slabs: (slabs, n)."""
        return vectors if len(self._axes) == 3 else self._axes @ vectors

    def _beyond(self, along: Floats, margin: float) -> Flags:
        """True where a point is not inside by more than -``margin`` on every axis (or a NaN)."""
        inside = (along >= self._low - margin) & (along <= self._high + margin)
        return ~np.logical_and.reduce(inside)


def _face_of(met: Flags, faces: Indices) -> Indices:
    """Which of the slabs' faces, (slabs, n), is met: the first of several, (n,)."""
    face = faces[-1]
    for number in range(len(faces) - 2, -1, -1):
        face = np.where(met[number], faces[number], face)
    return face


def _if_met(enters: Floats, leaves: Floats) -> Floats:
    """Distance to a body that rays enter before they leave it; infinite where they do not."""
    ahead = np.maximum(enters, 0.0)
    return np.where((ahead < leaves) & (enters > -TOLERANCE_MM), ahead, np.inf)


def box(half_width: float, z_low: float, z_high: float, leg: float = 0.0) -> Box:
    """A square `Box` about the z axis: x, y in +-``half_width``, z in [``z_low``, ``z_high``]."""
    return Box((-half_width, -half_width, z_low), (half_width, half_width, z_high), leg)


class Cylinder:
    """A cylinder along one of the axes, which answers for itself.

    Its ends are the faces of `Box` on that axis, `BOTTOM` and `TOP` of one along z, and its round
    side is the face `wall`: `WALL` of one along z.
    """

    def __init__(
        self,
        radius: float,
        low: float,
        high: float,
        axis: int = 2,
        centre: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Make it between two levels on the axis 0, 1 or 2; `centre` is its place on the others."""
        self._radius, self._levels = radius, np.array([low, high])
        self._axis = axis
        self._across: Indices = np.array([other for other in range(3) if other != axis])
        self._centre = np.array(centre)[:, None]
        #: Number of the round side.
        self.wall = 2 * int(self._across[0])
        self._low_end = 2 * axis

    def exit(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As of `Box`: through the wall, or the end that is ahead."""
        _, to_wall, _ = self._wall_crossings(position, direction)
        speed = direction[self._axis]
        ahead = np.where(speed > 0.0, *self._levels[::-1, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            to_end = (ahead - position[self._axis]) / speed
        to_end[np.isnan(to_end)] = np.inf
        distance = np.maximum(np.minimum(to_wall, to_end), 0.0)
        face = np.where(to_wall < to_end, self.wall, self._low_end + (speed > 0.0))
        return distance, face, ~self._holds(position, TOLERANCE_MM)

    def entry(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As of `Box`: through the wall, or the end that faces the flight."""
        wall_in, wall_out, misses = self._wall_crossings(position, direction)
        along, speed = position[self._axis], direction[self._axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            times = (self._levels[:, None] - along) / speed
        end_in, end_out = times.min(axis=0), times.max(axis=0)
        # a flight in the plane of an end is between the ends, or on the rim
        end_in[np.isnan(end_in)], end_out[np.isnan(end_out)] = -np.inf, np.inf
        enters, leaves = np.maximum(wall_in, end_in), np.minimum(wall_out, end_out)
        # flights along an end plane, on the far side of it
        outside = (speed == 0.0) & ((along < self._levels[0]) | (along > self._levels[1]))
        distance = np.where(misses | outside, np.inf, _if_met(enters, leaves))
        face = np.where(wall_in >= end_in, self.wall, self._low_end + (speed < 0.0))
        return distance, face, self._holds(position, -TOLERANCE_MM)

    def snap(self, position: Floats, face: Indices) -> tuple[Floats, Floats]:
        """As of `Box`: onto the wall along the radius, onto an end along the axis."""
        snapped, normal = position.copy(), np.zeros_like(position)
        wall, end = np.flatnonzero(face == self.wall), np.flatnonzero(face != self.wall)
        away = position[np.ix_(self._across, wall)] - self._centre
        away /= np.hypot(*away)
        normal[np.ix_(self._across, wall)] = away
        snapped[np.ix_(self._across, wall)] = self._centre + self._radius * away
        side = face[end] - self._low_end
        normal[self._axis, end] = np.where(side == 1, 1.0, -1.0)
        snapped[self._axis, end] = self._levels[side]
        return snapped, normal

    def contains(self, position: Floats) -> Flags:
        """As of `Box`."""
        return self._holds(position, 0.0)

    def _wall_crossings(self, position: Floats, direction: Floats) -> tuple[Floats, Floats, Flags]:
        """Where rays enter and leave the endless mantle, mm; and whether they never do.

        The roots of a t^2 + 2 b t + c = 0, of two forms of each that which does not cancel.
        """
        (x, y), (u, v) = position[self._across] - self._centre, direction[self._across]
        a, b, c = u * u + v * v, x * u + y * v, x * x + y * y - self._radius**2
        root2 = b * b - a * c
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(np.maximum(root2, 0.0))
            enters = np.where(b > 0.0, -(b + root) / a, c / (root - b))
            leaves = np.where(b > 0.0, -c / (b + root), (root - b) / a)
        enters[np.isnan(enters)], leaves[np.isnan(leaves)] = -np.inf, np.inf
        return enters, leaves, (c > 0.0) & ((root2 <= 0.0) | (b >= 0.0))

    def _holds(self, position: Floats, margin: float) -> Flags:
        """True where a point is inside by more than -``margin``."""
        (low, high), along = self._levels, position[self._axis]
        inside = (along >= low - margin) & (along <= high + margin)
        away = position[self._across] - self._centre
        return inside & (np.hypot(*away) <= self._radius + margin)


class BelowCylinder(Box):
    """The part of a box that lies below a lying cylinder whose ends are in the box's.

    Light inside meets the cylinder by `Cylinder.entry`; light from outside enters by the sides, and
    by the ends where the cylinder is not.
    """

    def __init__(
        self, low: tuple[float, float, float], high: tuple[float, float, float], crystal: Cylinder
    ) -> None:
        super().__init__(low, high)
        self._crystal = crystal

    def entry(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As of `Box`, but not through what is inside of the crystal."""
        distance, face, strayed = super().entry(position, direction)
        far = np.isinf(distance)
        arrival = position + np.where(far, 0.0, distance) * direction
        arrival[0] = 0.0
        distance[self._crystal.contains(arrival)] = np.inf
        return distance, face, strayed & ~self._crystal.contains(position)


#: A convex body of the bench.
Body = Box | Cylinder


def dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Scalar products of the columns of two (3, n) arrays: (n,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True)
class Medium:
    """A transparent medium; its scattering may grow linearly from z = 0 to z = ``height_mm``.

    With u = 2 z / height - 1, the scattering coefficient at z is
    ``scattering_per_mm`` (1 + ``gradient`` u).
    """

    index: float
    absorption_per_mm: float = 0.0
    scattering_per_mm: float = 0.0
    #: From -1 to 1.
    gradient: float = 0.0
    #: Without meaning where there is no gradient.
    height_mm: float = 1.0

    @property
    def extinction_per_mm(self) -> float:
        """Absorption and scattering together, at middle height."""
        return self.absorption_per_mm + self.scattering_per_mm

    def free_path(
        self,
        rng: np.random.Generator,
        position: Floats,
        direction: Floats,
        strength: float | Floats = 1.0,
    ) -> Floats:
        """Draw the distances to the next absorption or scattering: (n,), mm.

        Scattering is ``strength``, (n,), times as strong.

        With a gradient the optical depth after s mm is A s + B s^2; the root of
        A s + B s^2 = depth is taken in the form that does not cancel. Where the parabola never
        gets so high, which is outside of 0 <= z <= height, the distance is infinite.
        """
        depth: Floats = rng.standard_exponential((position.shape[1],))
        scattering = self.scattering_per_mm * strength
        if not self.gradient:
            depth /= self.absorption_per_mm + scattering
            return depth
        at_start = self.absorption_per_mm + scattering * self._strength(position)
        growth = scattering * self._growth_per_mm(direction)
        discriminant = at_start**2 + 4.0 * growth * depth
        denominator = at_start + np.sqrt(np.maximum(discriminant, 0.0))
        never = (discriminant < 0.0) | (denominator == 0.0)
        return np.where(never, np.inf, 2.0 * depth / np.where(never, 1.0, denominator))

    def scatters(
        self, rng: np.random.Generator, position: Floats, strength: float | Floats = 1.0
    ) -> Flags:
        """Draw for collisions at these points whether they scatter (or absorb): (n,) bool.

        The two exponential laws share one free path; ``strength`` is as of `free_path`.
        """
        if not self.absorption_per_mm:
            return np.ones(position.shape[1], dtype=bool)
        scattering = self.scattering_per_mm * strength
        if self.gradient:
            scattering = scattering * self._strength(position)
        draw: Floats = rng.random((position.shape[1],))
        return draw * (self.absorption_per_mm + scattering) >= self.absorption_per_mm

    def scattering_path(self, position: Floats, direction: Floats, distance: Floats) -> Floats:
        """Integral of 1 + gradient u along flights from ``position``: (n,) float64, mm."""
        if not self.gradient:
            return distance
        return distance * (self._strength(position) + self._growth_per_mm(direction) * distance)

    def _strength(self, position: Floats) -> Floats:
        """Scattering relative to that at middle height; rounding never makes it negative."""
        strength = 1.0 + self.gradient * (2.0 * position[2] / self.height_mm - 1.0)
        return np.maximum(strength, 0.0)

    def _growth_per_mm(self, direction: Floats) -> Floats:
        """Half of the relative strength's slope along the flight."""
        return self.gradient * direction[2] / self.height_mm


class Place(IntEnum):
    """Where a photon is: in a region, or at its end (its fate)."""

    CRYSTAL = 0
    GAP = 1
    WINDOW = 2
    FILM = 3  # the air between crystal and wrap
    OUTSIDE = 4  # the open air, an air bubble at the gap's side included
    LIQUID = 5  # that has crept up the crystal, for light that has left into it
    BUBBLE = 6  # a round one in the gap, of air
    DETECTED = 7
    ABSORBED_CRYSTAL = 8
    ABSORBED_GAP = 9
    ABSORBED_WINDOW = 10
    ABSORBED_APERTURE = 11
    ABSORBED_REFLECTOR = 12
    ABSORBED_SURFACE = 13  # of the crystal or of the detector
    ESCAPED = 14
    TRUNCATED = 15
    LOST = 16  # numerically out of its region: must never happen


FIRST_FATE = Place.DETECTED
REGIONS = tuple(place for place in Place if place < FIRST_FATE)
FATES = {place: place.name.lower() for place in Place if place >= FIRST_FATE}


class Plate(NamedTuple):
    """A black or reflecting rectangle across one of the axes, in mm."""

    #: 0, 1 or 2.
    axis: int
    #: Where on that axis it lies.
    level_mm: float
    #: (3, 1) float64: Its lowest and highest coordinates; infinite along the axis.
    low: Floats
    high: Floats

    def reached(
        self, position: Floats, direction: Floats, within: Floats
    ) -> tuple[Indices, Floats]:
        """Which rays, closer to it than so many mm, meet it from below or from behind.

        From the side of the lower coordinates, that is. Their indices, and where: (3, m), mm.
        """
        speed, way = direction[self.axis], self.level_mm - position[self.axis]
        rising = np.flatnonzero((speed > 0.0) & (way > 0.0))
        time = way[rising] / speed[rising]
        arrival = position[:, rising] + time * direction[:, rising]
        inside = ((arrival >= self.low) & (arrival <= self.high)).all(axis=0)
        inside &= time < within[rising]
        arrival[self.axis] = self.level_mm
        return rising[inside], arrival[:, inside]


class Layout:
    """The bench, or the crystal in a beam, as convex bodies with media and neighbours."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        half, height = bench.crystal_width_mm / 2.0, bench.height_mm
        in_beam = bench.beam_diameter_mm is not None
        #: Crystal, gap, window and, for a wrapped crystal, the film's box, which contains it. In a
        #: beam there is the crystal only.
        self.bodies = _bodies(bench)
        #: For the two regions of air, outside and film, and for a gap whose liquid stands around
        #: the crystal or a bubble: the bodies that light can meet there.
        self.seen_from: dict[Place, tuple[Place, ...]] = {
            Place.OUTSIDE: tuple(p for p in self.bodies if p not in (Place.FILM, Place.BUBBLE))
        }
        if Place.FILM in self.bodies:
            self.seen_from[Place.OUTSIDE] = (Place.FILM, Place.GAP, Place.WINDOW)
            self.seen_from[Place.FILM] = (Place.CRYSTAL,)
        if bench.narrow_collar_height_mm or bench.lies:
            self.seen_from[Place.GAP] = (Place.CRYSTAL,)
        if Place.BUBBLE in self.bodies:
            self.seen_from[Place.GAP] = (Place.BUBBLE,)
        #: By region, and so their indices, (7,) float64.
        self.media = _media(bench)
        self.index = np.array([medium.index for medium in self.media])
        low, high = np.array([[-half], [-half], [0.0]]), np.array([[half], [half], [height]])
        #: The axis that detectors are across.
        self.detector_axis = BEAM_AXES.index(bench.beam_axis) if in_beam else 2
        #: A point on the axis of the detector, and of the mask, (3, 1), mm.
        self.detector_centre = (low + high) / 2.0
        if not in_beam:
            self.detector_centre = np.array([[bench.mask_offset_mm], [0.0], [0.0]])
        distance_mm = PLATE_DISTANCE_MM if in_beam else TOP_FILM_MM if bench.top_reflectance else 0
        #: The reflecting sheet above the crystal, or the plate that detects a beam.
        self.plate = _before(self.detector_axis, low, high, distance_mm) if distance_mm else None
        self._face_roughness = np.array(bench.face_roughness)
        self.is_rough = bool(self._face_roughness.any())
        self._half_gap, self._gap_left = half, bench.gap_left_mm
        if bench.narrow_collar_height_mm:
            self._half_gap = half + NARROW_COLLAR_WIDTH_MM
            self._gap_left = -self._half_gap
        self._masked_face = {}
        if bench.aperture_at_detector:
            self._masked_face = {Place.WINDOW: BOTTOM}
        elif not in_beam:
            self._masked_face = {Place.GAP: BOTTOM, Place.BUBBLE: BOTTOM, Place.WINDOW: TOP}
        self._neighbour = _neighbours(bench)

    def behind(self, body: Place, face: Indices, position: Floats) -> Codes:
        """What light from within crystal, gap, bubble or window finds behind a face, at a point.

        `Place` codes, (n,) int8: a region, or the fate of light that ends there.
        """
        bench, place = self._bench, self._neighbour[body].take(face)
        half = bench.crystal_width_mm / 2.0
        if bench.bubble_radius_mm and body in (Place.CRYSTAL, Place.WINDOW):
            towards_gap = face == (BOTTOM if body == Place.CRYSTAL else TOP)
            at_bubble = np.hypot(position[0], position[1]) < bench.bubble_radius_mm
            under_bubble = towards_gap & at_bubble
        if body == Place.CRYSTAL:
            if self._gap_left > -half:
                place[(face == BOTTOM) & (position[0] < self._gap_left)] = Place.OUTSIDE
            if bench.narrow_collar_height_mm:
                wet = position[2] < bench.narrow_collar_height_mm
                place[(face != BOTTOM) & wet] = Place.GAP
            if bench.wet_height_mm:
                place[(face < BOTTOM) & (position[2] < bench.wet_height_mm)] = Place.LIQUID
            if bench.bubble_radius_mm:
                place[under_bubble] = Place.BUBBLE
            if bench.lies:
                place[(face >= 2) & (position[2] < bench.wetted_height_mm)] = Place.GAP
            self._end_on_spot(place, face, position)
            return place
        if body == Place.WINDOW:
            under_gap = self._under_gap(position)
            place[(face == TOP) & under_gap] = Place.GAP
            if bench.bubble_radius_mm:
                place[under_bubble] = Place.BUBBLE
        elif bench.chamfer_mm:
            from_axis = np.maximum(np.abs(position[0]), np.abs(position[1]))
            place[(face == TOP) & (from_axis > half - bench.chamfer_mm)] = Place.OUTSIDE
        self._end_on_mask(place, body, face, position)
        return place

    def _under_gap(self, position: Floats) -> Flags:
        """True where points of the window's entrance face border the gap: (n,) bool."""
        bench = self._bench
        if bench.crystal_length_mm is not None and bench.wetted_width_mm is not None:
            along, across = np.abs(position[0]), np.abs(position[1])
            return (along <= bench.crystal_length_mm / 2) & (across <= bench.wetted_width_mm / 2)
        if bench.crystal_diameter_mm is not None:
            return np.hypot(position[0], position[1]) <= bench.crystal_diameter_mm / 2.0
        under = np.maximum(position[0], np.abs(position[1])) <= self._half_gap
        return under & (position[0] >= self._gap_left)

    def within(self, body: Place, face: Indices, position: Floats) -> Codes:
        """What light from the air finds on a body's face: the body itself, or an end.

        Codes as in `behind`. The window's back face is never met: light goes up only after
        meeting the window, so never below it.
        """
        place = np.full(face.shape, body, dtype=np.int8)
        if body == Place.FILM:
            # light enters the film by its open rim only
            place[face != BOTTOM] = Place.ABSORBED_REFLECTOR
        else:
            self._end_on_mask(place, body, face, position)
            if body == Place.CRYSTAL:
                self._end_on_spot(place, face, position)
        return place

    def through_liquid(self, position: Floats, direction: Floats) -> tuple[Indices, Floats]:
        """Which light that flies in the endless liquid falls on the plate's entrance face, where.

        Their indices, and the places: (3, m), mm. All other light meets nothing.
        """
        speed, way = -direction[2], position[2] + self._bench.gap_thickness_mm
        falling = np.flatnonzero((speed > 0.0) & (way > 0.0))
        arrival = position[:, falling] + way[falling] / speed[falling] * direction[:, falling]
        from_axis = np.maximum(np.abs(arrival[0]), np.abs(arrival[1]))
        inside = from_axis <= self._bench.window_width_mm / 2.0
        return falling[inside], arrival[:, inside]

    def of_crystal(self, body: Place, ahead: Codes) -> Flags:
        """True where what light meets on a body, with this ahead, is a face of the crystal."""
        if body == Place.CRYSTAL:
            return np.ones(ahead.shape, dtype=bool)
        return ahead == Place.CRYSTAL

    def roughness(self, body: Place, face: Indices, ahead: Codes) -> Floats:
        """GGX alpha of what light meets on a body's faces, with this ahead: (n,) float64."""
        # the crystal's face that other bodies know is its foot
        crystal_face = face if body == Place.CRYSTAL else BOTTOM
        return np.where(self.of_crystal(body, ahead), self._face_roughness[crystal_face], 0.0)

    def on_mask_plane(self, body: Place, face: Indices) -> Flags:
        """True where a face lies in the mask's plane: (n,) bool."""
        if body not in self._masked_face:
            return np.zeros(face.shape, dtype=bool)
        return face == self._masked_face[body]

    def _end_on_mask(self, place: Codes, body: Place, face: Indices, position: Floats) -> None:
        """Let light end where a face carries the mask at this point."""
        if body in self._masked_face:
            radius_squared = (position[0] - self.detector_centre[0]) ** 2 + position[1] ** 2
            outside = radius_squared > self._bench.aperture_radius_mm**2
            place[self.on_mask_plane(body, face) & outside] = Place.ABSORBED_APERTURE

    def _end_on_spot(self, place: Codes, face: Indices, position: Floats) -> None:
        """Let light end where the crystal's top face is painted black."""
        half_mm = self._bench.black_spot_mm / 2.0
        if half_mm:
            in_square = np.maximum(np.abs(position[0]), np.abs(position[1])) <= half_mm
            place[(face == TOP) & in_square] = Place.ABSORBED_SURFACE


def _bodies(bench: Bench) -> dict[Place, Body]:
    """The bench's bodies by their places; of a beam's bench the crystal alone."""
    crystal, gap = _crystal_and_gap(bench)
    if bench.beam_diameter_mm is not None:
        return {Place.CRYSTAL: crystal}
    half, height = bench.crystal_width_mm / 2.0, bench.height_mm
    entrance = -bench.gap_thickness_mm
    window = box(bench.window_width_mm / 2.0, entrance - bench.window_thickness_mm, entrance)
    bodies = {Place.CRYSTAL: crystal, Place.GAP: gap, Place.WINDOW: window}
    if bench.wrap_reflectance is not None:
        bodies[Place.FILM] = box(half + bench.film_mm, 0.0, height + bench.film_mm)
    if bench.bubble_radius_mm:
        bodies[Place.BUBBLE] = Cylinder(bench.bubble_radius_mm, entrance, 0.0)
    return bodies


def _crystal_and_gap(bench: Bench) -> tuple[Body, Body]:
    """The crystal in its form, standing or lying, and the gap below it with its collar."""
    half, height = bench.crystal_width_mm / 2.0, bench.height_mm
    entrance, collar = -bench.gap_thickness_mm, bench.narrow_collar_height_mm
    if bench.crystal_diameter_mm is not None:
        radius = bench.crystal_diameter_mm / 2.0
        if bench.crystal_length_mm is None or bench.wetted_width_mm is None:
            return Cylinder(radius, 0.0, height), Cylinder(radius, entrance, 0.0)
        reach, wet = bench.crystal_length_mm / 2.0, bench.wetted_width_mm / 2.0
        lying = Cylinder(radius, -reach, reach, 0, (0.0, radius))
        strip = reach, wet, bench.wetted_height_mm
        return lying, BelowCylinder((-reach, -wet, entrance), strip, lying)
    crystal = box(half, 0.0, height, bench.chamfer_mm)
    if collar:
        return crystal, box(half + NARROW_COLLAR_WIDTH_MM, entrance, collar)
    return crystal, Box((bench.gap_left_mm, -half, entrance), (half, half, 0.0))


def _media(bench: Bench) -> tuple[Medium, ...]:
    """The media by region; a liquid absorbs, the air of an empty gap does not."""
    air, gap_absorption = Medium(1.0), bench.gap_absorption_per_cm if bench.is_filled else 0.0
    crystal = Medium(
        bench.n_crystal,
        bench.alpha_abs_per_cm / MM_PER_CM,
        bench.alpha_scat_per_cm / MM_PER_CM,
        bench.scattering_gradient,
        bench.height_mm,
    )
    by_region = {
        Place.CRYSTAL: crystal,
        Place.GAP: Medium(bench.gap_index, gap_absorption / MM_PER_CM),
        Place.WINDOW: Medium(bench.n_window, bench.window_absorption_per_cm / MM_PER_CM),
        Place.LIQUID: Medium(bench.gap_index),
    }
    return tuple(by_region.get(region, air) for region in REGIONS)


def _neighbours(bench: Bench) -> Codes:
    """The neighbour through each face of a region, where one is all there is: (regions, faces)."""
    neighbour = np.full((len(REGIONS), _MOST_FACES), Place.OUTSIDE, dtype=np.int8)
    if bench.wrap_reflectance is not None:
        neighbour[Place.CRYSTAL] = Place.FILM
    if bench.beam_diameter_mm is None:
        neighbour[Place.CRYSTAL, BOTTOM] = Place.GAP
    # a collar's top is beside the crystal
    neighbour[Place.GAP, TOP] = Place.OUTSIDE if bench.narrow_collar_height_mm else Place.CRYSTAL
    neighbour[Place.GAP, BOTTOM] = Place.WINDOW
    neighbour[Place.WINDOW, BOTTOM] = Place.DETECTED
    for face, place in ((WALL, Place.GAP), (BOTTOM, Place.WINDOW), (TOP, Place.CRYSTAL)):
        neighbour[Place.BUBBLE, face] = place
    return neighbour


def _before(axis: int, low: Floats, high: Floats, distance_mm: float) -> Plate:
    """A rectangle of a box's size, this far beyond its higher end on an axis."""
    low, high = low.copy(), high.copy()
    level_mm = float(high[axis, 0]) + distance_mm
    low[axis], high[axis] = -np.inf, np.inf
    return Plate(axis, level_mm, low, high)
