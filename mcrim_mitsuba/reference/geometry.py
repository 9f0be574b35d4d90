"""The bench's media and bodies: convex bodies, where rays cross them, what lies behind faces."""

from __future__ import annotations

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

_PARALLEL = 1e-300
"""Stands for a speed of zero towards a plane, so that no division yields a NaN."""

# faces of `Box`, in the order of its half-spaces
BOTTOM, TOP = 4, 5
#: Of an upright `Cylinder`, beside these.
WALL = 0
# the face towards lower x, y and z; the opposite one has the next number
_FIRST_FACES = np.array([[0], [2], [4]])


@dataclass(frozen=True, eq=False)
class HalfSpaceBody:
    """The points x with ``normals @ x <= offsets``.

    A ray crosses the planes at t = slack / speed, where slack is the distance
    to a plane (positive inside) and speed the component of the direction along
    its outward normal. Inside, the ray ends at the smallest t among the planes
    it approaches; from outside it enters at the largest t among the planes it
    faces, provided that it has not left through another one by then
    (T. L. Kay and J. T. Kajiya, SIGGRAPH 1986, for slabs; M. Cyrus and
    J. Beck, Computers and Graphics 3, 1978, for convex polyhedra).
    """

    #: (faces, 3) float64: Unit outward normals.
    normals: Floats
    #: (faces,) float64, mm: Distance of each plane from the origin along its normal.
    offsets: Floats

    def exit(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """Where rays that start inside leave the body.

        Only planes that the ray approaches count, so a photon that was just
        reflected off a plane cannot meet it again, however it was rounded.

        Returns
        -------
        distance : (n,) float64, mm
            Not negative, even for a start that rounding has put outside.
        face : (n,) intp
        strayed : (n,) bool
            True where the start is outside by more than `TOLERANCE_MM`.
        """
        slack, speed = self._slack_and_speed(position, direction)
        distance = np.full(position.shape[1], np.inf)
        face = np.zeros(position.shape[1], dtype=np.intp)
        with np.errstate(divide="ignore", invalid="ignore"):
            times = slack / speed
        for index in range(len(self.offsets)):
            closer = (speed[index] > 0.0) & (times[index] < distance)
            np.copyto(distance, times[index], where=closer)
            np.copyto(face, index, where=closer)
        np.maximum(distance, 0.0, out=distance)
        return distance, face, ~(slack.min(axis=0) >= -TOLERANCE_MM)

    def entry(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """Where rays that start outside meet the body.

        A ray that starts on the body's surface must not be asked about (a
        convex body is not met twice): rounding would decide the answer.

        What is returned is as of `exit`; the distance is infinite where the ray misses, and
        starts inside have strayed.
        """
        slack, speed = self._slack_and_speed(position, direction)
        count = position.shape[1]
        enters, leaves = np.full(count, -np.inf), np.full(count, np.inf)
        face = np.zeros(count, dtype=np.intp)
        # a ray parallel to a plane is never ahead of it: it "left" long ago if
        # it is outside that plane, and never leaves if it is inside
        speed[np.abs(speed) < _PARALLEL] = _PARALLEL
        times = slack / speed
        for index in range(len(self.offsets)):
            approached = speed[index] < 0.0
            later = approached & (times[index] > enters)
            np.copyto(enters, times[index], where=later)
            np.copyto(face, index, where=later)
            np.copyto(leaves, times[index], where=~approached & (times[index] < leaves))
        met = (np.maximum(enters, 0.0) < leaves) & (enters > -TOLERANCE_MM)
        distance = np.where(met, np.maximum(enters, 0.0), np.inf)
        return distance, face, ~(slack.min(axis=0) <= TOLERANCE_MM)

    def contains(self, position: Floats) -> Flags:
        """True where a point, (3, n) in mm, is in the body: (n,) bool."""
        inside: Flags = self.normals @ position <= self.offsets[:, None]
        return np.all(inside, axis=0)

    def snap(self, position: Floats, face: Indices) -> tuple[Floats, Floats]:
        """Move points that lie on a face to rounding onto it as exactly as float64 can.

        For planes along the axes the coordinate becomes exact, which keeps
        planes that bodies share (the crystal's side and the gap's) shared. The faces' outward
        unit normals are returned too.
        """
        normal = self.normals.T[:, face]
        return position + (self.offsets[face] - dot(normal, position)) * normal, normal

    def _slack_and_speed(self, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
        return self.offsets[:, None] - self.normals @ position, self.normals @ direction


class Box(HalfSpaceBody):
    """A box with faces along the axes: the same answers as `HalfSpaceBody`, sooner.

    The faces are -x, +x, -y, +y, `BOTTOM` and `TOP`.
    """

    def __init__(self, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
        """Make the box between two corners, in mm."""
        axes = np.repeat(np.eye(3), 2, axis=0)
        axes[::2] *= -1.0
        corners = np.array([low, high], dtype=np.float64)
        offsets = corners.T * [-1.0, 1.0]
        # adding zero turns -0.0 into 0.0
        super().__init__(axes + 0.0, offsets.ravel() + 0.0)
        self._low, self._high = corners[:, :, None]
        self._planes = corners.T.ravel() + 0.0

    def exit(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As `HalfSpaceBody.exit`; a direction along a plane never reaches it."""
        ahead = ~np.signbit(direction)
        times = np.where(ahead, self._high, self._low)
        times -= position
        with np.errstate(divide="ignore", invalid="ignore"):
            times /= direction
        # fmin leaves out the NaN of a start on a plane that the flight is parallel to
        distance = np.fmin(np.fmin(times[0], times[1]), times[2])
        faces = ahead + _FIRST_FACES
        face = np.where(times[1] == distance, faces[1], faces[2])
        np.copyto(face, faces[0], where=times[0] == distance)
        strayed = self._beyond(position, TOLERANCE_MM)
        np.maximum(distance, 0.0, out=distance)
        return distance, face, strayed

    def entry(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As `HalfSpaceBody.entry`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low = (self._low - position) / direction
            to_high = (self._high - position) / direction
        # of a start on a plane that the flight is parallel to, the NaN is left out
        near, far = np.fmin(to_low, to_high), np.fmax(to_low, to_high)
        enters = np.maximum(np.maximum(near[0], near[1]), near[2])
        leaves = np.minimum(np.minimum(far[0], far[1]), far[2])
        faces = np.signbit(direction) + _FIRST_FACES
        face = np.where(near[1] == enters, faces[1], faces[2])
        np.copyto(face, faces[0], where=near[0] == enters)
        met = (np.maximum(enters, 0.0) < leaves) & (enters > -TOLERANCE_MM)
        distance = np.where(met, np.maximum(enters, 0.0), np.inf)
        return distance, face, ~self._beyond(position, -TOLERANCE_MM)

    def snap(self, position: Floats, face: Indices) -> tuple[Floats, Floats]:
        """As `HalfSpaceBody.snap`: the coordinate becomes exact."""
        snapped = position.copy()
        snapped[face >> 1, np.arange(face.size)] = self._planes[face]
        return snapped, self.normals.T.take(face, axis=1)

    def _beyond(self, position: Floats, margin: float) -> Flags:
        """True where a point is not inside by more than -``margin`` on every axis (or a NaN)."""
        inside = (position >= self._low - margin) & (position <= self._high + margin)
        return ~(inside[0] & inside[1] & inside[2])


def box(half_width: float, z_low: float, z_high: float) -> Box:
    """A square box about the z axis: x, y in +-``half_width``, z in [``z_low``, ``z_high``], mm."""
    return Box((-half_width, -half_width, z_low), (half_width, half_width, z_high))


def chamfered_box(half_width: float, height: float, leg: float) -> HalfSpaceBody:
    """A square box on z = 0 about the z axis whose twelve edges carry 45 degree chamfers.

    The faces are those of `Box`, followed by the twelve chamfers, each of which takes `leg` mm
    away of the two faces that met in the edge.
    """
    plain = box(half_width, 0.0, height)
    normals, offsets = list(plain.normals), list(plain.offsets)
    for one in range(6):
        # faces 2 i and 2 i + 1 are opposite to each other
        for other in range(one - one % 2 + 2, 6):
            normals.append((plain.normals[one] + plain.normals[other]) / math.sqrt(2.0))
            offsets.append((plain.offsets[one] + plain.offsets[other] - leg) / math.sqrt(2.0))
    return HalfSpaceBody(np.array(normals), np.array(offsets))


class Cylinder(HalfSpaceBody):
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
        # it has no planes, but ends
        super().__init__(np.zeros((TOP + 1, 3)), np.zeros(TOP + 1))
        self._radius, self._levels = radius, np.array([low, high])
        self._axis = axis
        self._across: Indices = np.array([other for other in range(3) if other != axis])
        self._centre = np.array(centre)[:, None]
        #: Number of the round side.
        self.wall = 2 * int(self._across[0])
        self._low_end = 2 * axis

    def exit(self, position: Floats, direction: Floats) -> tuple[Floats, Indices, Flags]:
        """As `HalfSpaceBody.exit`."""
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
        """As `HalfSpaceBody.entry`."""
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
        met = ~misses & ~outside & (np.maximum(enters, 0.0) < leaves) & (enters > -TOLERANCE_MM)
        distance = np.where(met, np.maximum(enters, 0.0), np.inf)
        face = np.where(wall_in >= end_in, self.wall, self._low_end + (speed < 0.0))
        return distance, face, self._holds(position, -TOLERANCE_MM)

    def snap(self, position: Floats, face: Indices) -> tuple[Floats, Floats]:
        """As `HalfSpaceBody.snap`."""
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
        """As `HalfSpaceBody.contains`."""
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
        """As `HalfSpaceBody.entry`."""
        distance, face, strayed = super().entry(position, direction)
        far = np.isinf(distance)
        arrival = position + np.where(far, 0.0, distance) * direction
        arrival[0] = 0.0
        distance[self._crystal.contains(arrival)] = np.inf
        return distance, face, strayed & ~self._crystal.contains(position)


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
        strength: Floats | None = None,
    ) -> Floats:
        """Draw the distances to the next absorption or scattering: (n,), mm.

        Scattering is ``strength``, (n,), times as strong, if that is given.

        With a gradient the optical depth after s mm is A s + B s^2; the root of
        A s + B s^2 = depth is taken in the form that does not cancel. Where the parabola never
        gets so high, which is outside of 0 <= z <= height, the distance is infinite.
        """
        depth: Floats = rng.standard_exponential((position.shape[1],))
        scattering: float | Floats = self.scattering_per_mm
        if strength is not None:
            scattering = scattering * strength
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
        self, rng: np.random.Generator, position: Floats, strength: Floats | None = None
    ) -> Flags:
        """Draw for collisions at these points whether they scatter (or absorb): (n,) bool.

        The two exponential laws share one free path; ``strength`` is as of `free_path`.
        """
        if not self.absorption_per_mm:
            return np.ones(position.shape[1], dtype=bool)
        scattering: float | Floats = self.scattering_per_mm
        if strength is not None:
            scattering = scattering * strength
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
        half, height = bench.crystal_width_mm / 2.0, bench.height_mm
        entrance = -bench.gap_thickness_mm
        chamfer, collar = bench.chamfer_mm, bench.narrow_collar_height_mm
        crystal: HalfSpaceBody
        crystal = chamfered_box(half, height, chamfer) if chamfer else box(half, 0.0, height)
        gap: HalfSpaceBody = box(half + NARROW_COLLAR_WIDTH_MM, entrance, collar)
        if not collar:
            gap = Box((bench.gap_left_mm, -half, entrance), (half, half, 0.0))
        #: Radius of the round foot of a cylinder that stands.
        self._foot_mm: float | None = None
        #: Half the length and half the width of the strip on which a cylinder that lies is wet, and
        #: how high it reaches.
        self._strip_mm: tuple[float, float, float] | None = None
        if bench.crystal_diameter_mm is not None:
            radius = bench.crystal_diameter_mm / 2.0
            if bench.crystal_length_mm is None or bench.wetted_width_mm is None:
                self._foot_mm = radius
                crystal, gap = Cylinder(radius, 0.0, height), Cylinder(radius, entrance, 0.0)
            else:
                reach, wet = bench.crystal_length_mm / 2.0, bench.wetted_width_mm / 2.0
                self._strip_mm = reach, wet, bench.wetted_height_mm
                crystal = Cylinder(radius, -reach, reach, 0, (0.0, radius))
                gap = BelowCylinder((-reach, -wet, entrance), self._strip_mm, crystal)
        half_window, back = bench.window_width_mm / 2.0, entrance - bench.window_thickness_mm
        window = box(half_window, back, entrance)
        in_beam = bench.beam_diameter_mm is not None
        #: Crystal, gap, window and, for a wrapped crystal, the film's box, which contains it. In a
        #: beam there is the crystal only.
        self.bodies: dict[Place, HalfSpaceBody] = {Place.CRYSTAL: crystal}
        if not in_beam:
            self.bodies |= {Place.GAP: gap, Place.WINDOW: window}
        wrapped = bench.wrap_reflectance is not None
        around_crystal = Place.FILM if wrapped else Place.OUTSIDE
        #: For the two regions of air, outside and film, and for a gap whose liquid stands around
        #: the crystal or a bubble: the bodies that light can meet there.
        self.seen_from: dict[Place, tuple[Place, ...]] = {Place.OUTSIDE: tuple(self.bodies)}
        if wrapped:
            film = bench.film_mm
            self.bodies[Place.FILM] = box(half + film, 0.0, height + film)
            self.seen_from[Place.OUTSIDE] = (Place.FILM, Place.GAP, Place.WINDOW)
            self.seen_from[Place.FILM] = (Place.CRYSTAL,)
        if collar or bench.lies:
            self.seen_from[Place.GAP] = (Place.CRYSTAL,)
        self._bubble_mm = bench.bubble_radius_mm
        if self._bubble_mm:
            self.bodies[Place.BUBBLE] = Cylinder(self._bubble_mm, entrance, 0.0)
            self.seen_from[Place.GAP] = (Place.BUBBLE,)

        air = Medium(1.0)
        gap_absorption = bench.gap_absorption_per_cm if bench.is_filled else 0.0
        absorption = bench.alpha_abs_per_cm / MM_PER_CM
        scattering = bench.alpha_scat_per_cm / MM_PER_CM
        #: By region, and so their indices, (7,) float64.
        self.media = (
            Medium(bench.n_crystal, absorption, scattering, bench.scattering_gradient, height),
            Medium(bench.gap_index, gap_absorption / MM_PER_CM),
            Medium(bench.n_window, bench.window_absorption_per_cm / MM_PER_CM),
            air,
            air,
            Medium(bench.gap_index),
            air,
        )
        self.index = np.array([medium.index for medium in self.media])
        low, high = np.array([[-half], [-half], [0.0]]), np.array([[half], [half], [height]])
        #: The axis that detectors are across.
        self.detector_axis = BEAM_AXES.index(bench.beam_axis) if in_beam else 2
        #: A point on the axis of the detector, and of the mask, (3, 1), mm.
        self.detector_centre = (low + high) / 2.0
        if not in_beam:
            self.detector_centre = np.array([[bench.mask_offset_mm], [0.0], [0.0]])
        #: The reflecting sheet above the crystal, or the plate that detects a beam.
        self.sheet = _before(2, low, high, TOP_FILM_MM) if bench.top_reflectance else None
        self.plate = _before(self.detector_axis, low, high, PLATE_DISTANCE_MM) if in_beam else None

        self._face_roughness = np.array(bench.face_roughness)
        self.is_rough = bool(self._face_roughness.any())
        self._half_footprint_mm = half
        self._half_bottom = half - chamfer
        self._entrance_mm, self._half_window = entrance, half_window
        self._collar_mm, self._wet_mm = collar, bench.wet_height_mm
        self._half_spot = bench.black_spot_mm / 2.0
        self._half_gap = half + NARROW_COLLAR_WIDTH_MM if collar else half
        self._gap_left = -self._half_gap if collar else bench.gap_left_mm
        self._has_bubble = self._gap_left > -half
        self._aperture_squared = bench.aperture_radius_mm**2
        self._masked_face = {}
        if bench.aperture_at_detector:
            self._masked_face = {Place.WINDOW: BOTTOM}
        elif not in_beam:
            self._masked_face = {Place.GAP: BOTTOM, Place.BUBBLE: BOTTOM, Place.WINDOW: TOP}
        # the neighbour through each face, where one neighbour is all there is
        faces = len(self.bodies[Place.CRYSTAL].offsets)
        self._neighbour = np.full((len(REGIONS), faces), Place.OUTSIDE, dtype=np.int8)
        self._neighbour[Place.CRYSTAL] = around_crystal
        if not in_beam:
            self._neighbour[Place.CRYSTAL, BOTTOM] = Place.GAP
        # a collar's top is beside the crystal
        self._neighbour[Place.GAP, TOP] = Place.OUTSIDE if collar else Place.CRYSTAL
        self._neighbour[Place.GAP, BOTTOM] = Place.WINDOW
        self._neighbour[Place.WINDOW, BOTTOM] = Place.DETECTED
        for face, place in ((WALL, Place.GAP), (BOTTOM, Place.WINDOW), (TOP, Place.CRYSTAL)):
            self._neighbour[Place.BUBBLE, face] = place

    def behind(self, body: Place, face: Indices, position: Floats) -> Codes:
        """What light from within crystal, gap, bubble or window finds behind a face, at a point.

        `Place` codes, (n,) int8: a region, or the fate of light that ends there.
        """
        place = self._neighbour[body].take(face)
        if self._bubble_mm and body in (Place.CRYSTAL, Place.WINDOW):
            towards_gap = face == (BOTTOM if body == Place.CRYSTAL else TOP)
            under_bubble = towards_gap & (np.hypot(position[0], position[1]) < self._bubble_mm)
        if body == Place.CRYSTAL:
            if self._has_bubble:
                place[(face == BOTTOM) & (position[0] < self._gap_left)] = Place.OUTSIDE
            if self._collar_mm:
                place[(face != BOTTOM) & (position[2] < self._collar_mm)] = Place.GAP
            if self._wet_mm:
                place[(face < BOTTOM) & (position[2] < self._wet_mm)] = Place.LIQUID
            if self._bubble_mm:
                place[under_bubble] = Place.BUBBLE
            if self._strip_mm is not None:
                place[(face >= 2) & (position[2] < self._strip_mm[2])] = Place.GAP
            self._end_on_spot(place, face, position)
            return place
        if body == Place.WINDOW:
            under_gap = self._under_gap(position)
            place[(face == TOP) & under_gap] = Place.GAP
            if self._bubble_mm:
                place[under_bubble] = Place.BUBBLE
        elif self._half_bottom < self._half_footprint_mm:
            on_rim = np.maximum(np.abs(position[0]), np.abs(position[1])) > self._half_bottom
            place[(face == TOP) & on_rim] = Place.OUTSIDE
        self._end_on_mask(place, body, face, position)
        return place

    def _under_gap(self, position: Floats) -> Flags:
        """True where points of the window's entrance face border the gap: (n,) bool."""
        if self._foot_mm is not None:
            return np.hypot(position[0], position[1]) <= self._foot_mm
        if self._strip_mm is not None:
            along, across, _ = self._strip_mm
            return (np.abs(position[0]) <= along) & (np.abs(position[1]) <= across)
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
        speed, way = -direction[2], position[2] - self._entrance_mm
        falling = np.flatnonzero((speed > 0.0) & (way > 0.0))
        arrival = position[:, falling] + way[falling] / speed[falling] * direction[:, falling]
        inside = np.maximum(np.abs(arrival[0]), np.abs(arrival[1])) <= self._half_window
        return falling[inside], arrival[:, inside]

    def of_crystal(self, body: Place, ahead: Codes) -> Flags:
        """True where what light meets on a body, with this ahead, is a face of the crystal."""
        if body == Place.CRYSTAL:
            return np.ones(ahead.shape, dtype=bool)
        return ahead == Place.CRYSTAL

    def roughness(self, body: Place, face: Indices, ahead: Codes) -> Floats:
        """GGX alpha of what light meets on a body's faces, with this ahead: (n,) float64."""
        # the crystal's face that other bodies know is its foot
        own = face if body == Place.CRYSTAL else BOTTOM
        return np.where(self.of_crystal(body, ahead), self._face_roughness[own], 0.0)

    def on_mask_plane(self, body: Place, face: Indices) -> Flags:
        """True where a face lies in the mask's plane: (n,) bool."""
        if body not in self._masked_face:
            return np.zeros(face.shape, dtype=bool)
        return face == self._masked_face[body]

    def _end_on_mask(self, place: Codes, body: Place, face: Indices, position: Floats) -> None:
        """Let light end where a face carries the mask at this point."""
        if body in self._masked_face:
            radius_squared = (position[0] - self.detector_centre[0]) ** 2 + position[1] ** 2
            masked = self.on_mask_plane(body, face) & (radius_squared > self._aperture_squared)
            place[masked] = Place.ABSORBED_APERTURE

    def _end_on_spot(self, place: Codes, face: Indices, position: Floats) -> None:
        """Let light end where the crystal's top face is painted black."""
        if self._half_spot:
            in_square = np.maximum(np.abs(position[0]), np.abs(position[1])) <= self._half_spot
            place[(face == TOP) & in_square] = Place.ABSORBED_SURFACE


def _before(axis: int, low: Floats, high: Floats, distance_mm: float) -> Plate:
    """A rectangle of a box's size, this far beyond its higher end on an axis."""
    low, high = low.copy(), high.copy()
    level_mm = float(high[axis, 0]) + distance_mm
    low[axis], high[axis] = -np.inf, np.inf
    return Plate(axis, level_mm, low, high)
