"""What is put before the camera, and the camera: plain numbers that know nothing of Mitsuba."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

#: Linear red, green and blue.
Colour = tuple[float, float, float]

#: Kinds of `Finish`.
GLASS, MATTE, GLOSSY, METAL = "glass", "matte", "glossy", "metal"
#: Cosine between the normals of two faces that meet in a sharp edge: 25 degrees.
_SHARP = 0.906


@dataclass(frozen=True)
class Finish:
    """What a body looks like."""

    #: ``glass`` (an interface that refracts), ``matte``, ``glossy`` (matte under a clear coat)
    #: or ``metal``.
    kind: str
    #: Linear red, green, blue, 0 to 1: reflected, or of glass let through by each face.
    colour: Colour = (1.0, 1.0, 1.0)
    #: Of glass: index behind the face over index in front of it.
    index_ratio: float = 1.0
    #: Of glass: GGX alpha; 0 is polished.
    roughness: float = 0.0


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface in triangles."""

    #: ndarray of float64, shape (n, 3, 3): Triangle, corner, coordinate (mm); anticlockwise seen
    #: from the exterior.
    corners: np.ndarray
    #: ndarray of float64, shape (n, 3, 3), or None: Towards the exterior at each corner of a curved
    #: surface; ``None`` where it is flat.
    normals: np.ndarray | None = None

    def reversed(self) -> Triangles:
        """The same surface with its two sides exchanged."""
        turned = None if self.normals is None else -self.normals[:, ::-1]
        return Triangles(self.corners[:, ::-1], turned)

    def moved(self, offset: ArrayLike) -> Triangles:
        """The same surface elsewhere; `offset` in mm, shape (3,)."""
        return Triangles(self.corners + np.asarray(offset), self.normals)


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles with a finish."""

    triangles: Triangles
    finish: Finish


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera that stands upright."""

    #: ndarray, shape (3,): Where it stands and the point in the middle of the picture, mm.
    eye: np.ndarray
    target: np.ndarray
    #: Horizontal angle of view.
    field_deg: float
    #: Pixels.
    width: int
    height: int

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors to the right, upwards and ahead."""
        ahead = self.target - self.eye
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        return right, np.cross(right, ahead), ahead

    @property
    def half_width(self) -> float:
        """Tangent of half the angle of view."""
        return float(np.tan(np.radians(self.field_deg) / 2))

    def project(self, points: ArrayLike) -> np.ndarray:
        """Pixels (x to the right, y downwards, from the upper left corner) of points in mm.

        Shapes (..., 3) and (..., 2).
        """
        right, up, ahead = self.axes
        relative = np.asarray(points, dtype=float) - self.eye
        scale = self.width / 2 / self.half_width / (relative @ ahead)
        x = self.width / 2 + scale * (relative @ right)
        return np.stack([x, self.height / 2 - scale * (relative @ up)], axis=-1)


def framed(points: ArrayLike, direction: ArrayLike, field_deg: float, width: int, height: int,
           margins: tuple[float, float, float, float]) -> Camera:  # fmt: skip
    """A camera that sees all points within margins of the picture.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        mm.
    direction : array_like, shape (3,)
        From the points to the camera.
    field_deg : float
    width, height : int
        Pixels.
    margins : tuple of float
        Left, right, top and bottom, as parts of the width and of the height.
    """
    direction = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    points = np.asarray(points, dtype=float)
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    reach = float(np.linalg.norm(points - target, axis=1).max())
    left, right, top, bottom = margins
    wanted = np.array([left * width, top * height, (1 - right) * width, (1 - bottom) * height])
    distance = 4.0 * reach / np.tan(np.radians(field_deg) / 2)
    for _ in range(12):
        camera = Camera(target + distance * direction, target, field_deg, width, height)
        seen = camera.project(points)
        low, high = seen.min(axis=0), seen.max(axis=0)
        grows = float(((high - low) / (wanted[2:] - wanted[:2])).max())
        per_pixel = 2 * camera.half_width * distance / width
        across, up, _ = camera.axes
        shift = (low + high) / 2 - (wanted[:2] + wanted[2:]) / 2
        target = target + per_pixel * (shift[0] * across - shift[1] * up)
        distance *= grows
    return Camera(target + distance * direction, target, field_deg, width, height)


def edges(shapes: Iterable[Triangles], radius: float) -> Triangles:
    """Thin rods along the sharp edges of something, which show where glass or white ends.

    Parameters
    ----------
    shapes : sequence of Triangles
        All of its faces.
    radius : float
        Of the rods, mm.
    """
    corners = np.concatenate([shape.corners for shape in shapes])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    known: dict[tuple, list] = {}
    for triangle, normal in zip(corners, normals, strict=True):
        for ends in triangle[[[0, 1], [1, 2], [2, 0]]]:
            key = tuple(sorted(map(tuple, np.round(ends / (1e-5 * size)).astype(int).tolist())))
            known.setdefault(key, []).append((ends, normal))
    rods = []
    for found in known.values():
        ends, normal = found[0]
        others = [other for _, other in found[1:]]
        sharp = any(normal @ other < _SHARP for other in others)
        if sharp or (not others and _is_rim(ends, normal, corners, normals)):
            rods.append(_rod(ends[0], ends[1], radius))
    return Triangles(np.concatenate(rods) if rods else np.zeros((0, 3, 3)))


def _is_rim(ends: np.ndarray, normal: np.ndarray, corners: np.ndarray, normals: np.ndarray) -> bool:
    """Whether no triangle goes on beyond an edge, as one of other corners may."""
    along = ends[1] - ends[0]
    beyond = ends.mean(axis=0) + 1e-3 * np.cross(along, normal)
    level = np.abs(np.einsum("ij,ij->i", beyond - corners[:, 0], normals))
    near = corners[(normals @ normal > _SHARP) & (level < 1e-4 * np.linalg.norm(along))]
    sides = np.cross(np.roll(near, -1, axis=1) - near, beyond - near) @ normal
    return not bool((sides >= 0).all(axis=1).any())


def _rod(start: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    """A square rod between two points, in triangles."""
    along = (end - start) / np.linalg.norm(end - start)
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    aside *= radius / np.linalg.norm(aside)
    other = np.cross(along, aside)
    ring, rod = [aside, other, -aside, -other], []
    for one, two in zip(ring, ring[1:] + ring[:1], strict=True):
        rod.append((start + one, end + one, end + two))
        rod.append((start + one, end + two, start + two))
    return np.array(rod)
