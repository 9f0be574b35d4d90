"""Convex bodies as intersections of half-spaces, and where straight rays cross them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

        Parameters
        ----------
        position : (3, n) float64, mm
        direction : (3, n) float64
            Unit vectors.

        Returns
        -------
        distance : (n,) float64, mm
            Not negative, even for a start that rounding has put outside.
        face : (n,) intp
            Index of the plane.
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

        Parameters
        ----------
        position : (3, n) float64, mm
        direction : (3, n) float64
            Unit vectors.

        Returns
        -------
        distance : (n,) float64, mm
            Not negative; infinity where the ray misses.
        face : (n,) intp
            Index of the plane entered through; without meaning for a miss.
        strayed : (n,) bool
            True where the start is inside by more than `TOLERANCE_MM`.
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
        planes that bodies share (the crystal's side and the gap's) shared.

        Parameters
        ----------
        position : (3, n) float64, mm
        face : (n,) intp

        Returns
        -------
        position : (3, n) float64, mm
        normal : (3, n) float64
            Outward unit normals of the faces.
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

    The faces are those of `Box`, followed by the twelve chamfers.

    Parameters
    ----------
    half_width, height : float, mm
    leg : float, mm
        What each chamfer takes away of the two faces that met in the edge.
    """
    plain = box(half_width, 0.0, height)
    normals, offsets = list(plain.normals), list(plain.offsets)
    for one in range(6):
        # faces 2 i and 2 i + 1 are opposite to each other
        for other in range(one - one % 2 + 2, 6):
            normals.append((plain.normals[one] + plain.normals[other]) / math.sqrt(2.0))
            offsets.append((plain.offsets[one] + plain.offsets[other] - leg) / math.sqrt(2.0))
    return HalfSpaceBody(np.array(normals), np.array(offsets))


def dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Scalar products of the columns of two (3, n) arrays: (n,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
