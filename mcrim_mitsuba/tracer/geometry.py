"""Convex bodies as intersections of half-spaces, and where straight rays cross them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TOLERANCE_MM = 1e-9
"""Float64 rounding stays below 1e-13 mm on a bench of centimetres; a photon further than
this on the wrong side of a plane is lost, which the tracer counts and never forgives."""

_PARALLEL = 1e-300
"""Stands for a speed of zero towards a plane, so that no division yields a NaN."""

# faces of `box`, in the order of its half-spaces
BOTTOM, TOP = 4, 5


@dataclass(frozen=True)
class ConvexBody:
    """The points x with ``normals @ x <= offsets``.

    A ray crosses the planes at t = slack / speed, where slack is the distance
    to a plane (positive inside) and speed the component of the direction along
    its outward normal. Inside, the ray ends at the smallest t among the planes
    it approaches; from outside it enters at the largest t among the planes it
    faces, provided that it has not left through another one by then
    (T. L. Kay and J. T. Kajiya, SIGGRAPH 1986, for slabs; M. Cyrus and
    J. Beck, Computers and Graphics 3, 1978, for convex polyhedra).

    Attributes
    ----------
    normals : (faces, 3) float64
        Unit outward normals.
    offsets : (faces,) float64, mm
        Distance of each plane from the origin along its normal.
    """

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]

    def exit(
        self, position: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.bool_]]:
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

    def entry(
        self, position: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.bool_]]:
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

    def snap(
        self, position: NDArray[np.float64], face: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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

    def _slack_and_speed(
        self, position: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.offsets[:, None] - self.normals @ position, self.normals @ direction


def box(half_width: float, z_low: float, z_high: float) -> ConvexBody:
    """A square box about the z axis: x, y in +-``half_width``, z in [``z_low``, ``z_high``].

    All in mm. The faces are -x, +x, -y, +y, `BOTTOM` and `TOP`.
    """
    axes = np.repeat(np.eye(3), 2, axis=0)
    axes[::2] *= -1.0
    offsets = np.array([half_width] * 4 + [-z_low, z_high])
    # adding zero turns -0.0 into 0.0
    return ConvexBody(axes + 0.0, offsets)


def dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scalar products of the columns of two (3, n) arrays: (n,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
