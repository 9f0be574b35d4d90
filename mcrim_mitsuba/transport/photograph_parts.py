"""The parts of a bench as they are photographed: bodies before a camera, plain numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.numbers import MM_PER_CM
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, SceneModel, Surface

#: Linear red, green and blue.
Colour = tuple[float, float, float]

#: Kinds of `Finish`.
GLASS = "glass"
MATTE = "matte"
GLOSSY = "glossy"
METAL = "metal"
#: Cosine between the normals of two faces that meet in a sharp edge: 25 degrees.
_SHARP = 0.906
#: Height over width of a plate, and the roughness of its rim.
_PLATE = 0.12
_GROUND_RIM = 0.4


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
        """This surface with its two sides exchanged."""
        turned = None if self.normals is None else -self.normals[:, ::-1]
        return Triangles(self.corners[:, ::-1], turned)

    def moved(self, offset: ArrayLike) -> Triangles:
        """This surface elsewhere; `offset` in mm, shape (3,)."""
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
        """Pixels (x to the right, y down), shape (..., 2), of points in mm, shape (..., 3)."""
        right, up, ahead = self.axes
        relative = np.asarray(points, dtype=float) - self.eye
        scale = self.width / 2 / self.half_width / (relative @ ahead)
        x = self.width / 2 + scale * (relative @ right)
        return np.stack([x, self.height / 2 - scale * (relative @ up)], axis=-1)


def framed(
    points: ArrayLike,
    direction: ArrayLike,
    field_deg: float,
    width: int,
    height: int,
    margins: tuple[float, float, float, float],
) -> Camera:
    """A camera that sees all points (shape (n, 3), mm) within margins of the picture.

    `direction` leads from the points to the camera, shape (3,); `margins` are left, right, top and
    bottom, as parts of the width and of the height.
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
    """Thin rods (of a radius in mm) along the sharp edges of something, given by all its faces."""
    corners = np.concatenate([shape.corners for shape in shapes])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    size = np.ptp(corners.reshape(-1, 3), axis=0).max()
    sides = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
    of_side = np.repeat(normals, 3, axis=0)
    # sides between the same two places meet in one edge; each place has a number of its own
    places = np.round(sides.reshape(-1, 3) / (1e-5 * size)).astype(int)
    places = (places - places.min(axis=0)) @ (10**12, 10**6, 1)
    _, place = np.unique(places, return_inverse=True)
    ends = np.sort(place.reshape(-1, 2), axis=1)
    pairs = ends[:, 0] * len(places) + ends[:, 1]
    _, first, edge, sharing = np.unique(
        pairs, return_index=True, return_inverse=True, return_counts=True
    )
    lowest = np.ones(len(first))
    np.minimum.at(lowest, edge, np.einsum("ij,ij->i", of_side[first[edge]], of_side))
    boxes = corners.min(axis=1).T.copy(), corners.max(axis=1).T.copy()
    sharp, alone = lowest < _SHARP, first[sharing == 1]
    kept = [s for s in alone if _is_rim(sides[s], of_side[s], corners, normals, boxes)]
    # in the order of the triangles
    return Triangles(_square_rods(sides[np.union1d(first[sharp], np.array(kept, int))], radius))


def _is_rim(
    ends: np.ndarray,
    normal: np.ndarray,
    corners: np.ndarray,
    normals: np.ndarray,
    boxes: tuple[np.ndarray, np.ndarray],
) -> bool:
    """Whether no triangle goes on beyond an edge, as one of other corners may.

    `boxes` are the lowest and highest coordinates, shape (3, n), of each triangle: few hold what
    is beyond, along one axis already.
    """
    along = ends[1] - ends[0]
    beyond = ends.mean(axis=0) + 1e-3 * np.cross(along, normal)
    apart = 1e-4 * np.linalg.norm(along)
    slack = apart / _SHARP  # along `normal`
    held: Any = np.s_[:]
    for low, high, place in zip(*boxes, beyond, strict=True):
        inside = np.flatnonzero((low[held] <= place + slack) & (place - slack <= high[held]))
        held = inside if isinstance(held, slice) else held[inside]
    corners, normals = corners[held], normals[held]
    level = np.abs(np.einsum("ij,ij->i", beyond - corners[:, 0], normals))
    near = corners[(normals @ normal > _SHARP) & (level < apart)]
    sides = np.cross(np.roll(near, -1, axis=1) - near, beyond - near) @ normal
    return not bool((sides >= 0).all(axis=1).any())


def _square_rods(ends: np.ndarray, radius: float) -> np.ndarray:
    """Square rods between pairs of points, shape (n, 2, 3), in triangles."""
    start, end = ends[:, 0], ends[:, 1]
    along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    aside *= radius / np.linalg.norm(aside, axis=1)[:, None]
    other = np.cross(along, aside)
    ring, rods = [aside, other, -aside, -other], []
    for side, next_side in zip(ring, ring[1:] + ring[:1], strict=True):
        rods += [start + side, end + side, end + next_side]
        rods += [start + side, end + next_side, start + next_side]
    return np.stack(rods, axis=1).reshape(-1, 3, 3)


# The parts of a bench as they are photographed: volumes, masks, detectors, reflectors.

#: What the glass of a volume lets through at each face, by the order of the volumes. The hues are
#: those of the cross-section of `mcrim check`.
TINTS: tuple[Colour, ...] = (
    (0.80, 0.90, 0.985),
    (1.0, 0.74, 0.28),
    (0.84, 0.94, 0.86),
    (0.95, 0.76, 0.68),
    (0.86, 0.80, 0.95),
    (0.80, 0.93, 0.91),
)
CLEAR = (1.0, 1.0, 1.0)
#: Of a detector.
RED = (0.50, 0.035, 0.025)
#: Of a mask.
BLACK = (0.012, 0.012, 0.013)
#: Of what is neither glass nor matte.
STEEL = (0.6, 0.6, 0.62)
#: Of the lines along the edges of what is white.
GREY = (0.25, 0.25, 0.26)
#: Radius of the lines along the edges of glass, over its size.
_ROD = 0.0028
#: Sectors into which the surroundings of a mask's hole are cut.
_SECTORS = 180
#: A mask is drawn this far off the face that it lies on, over 1 mm plus the scene's size: rays
#: that start at the face must meet it (`transport.check.RAY_OFFSET`).
_ABOVE = 1.5e-4


@dataclass(frozen=True, eq=False)
class BenchPart:
    """One part of the bench."""

    name: str
    #: Lines that say more: index, size, coefficients.
    details: tuple[str, ...]
    #: How it looks alone in air; none where it is air itself.
    bodies: tuple[Body, ...]
    #: ndarray, shape (n, 3): Its corners, mm.
    points: np.ndarray

    @property
    def lower(self) -> np.ndarray:
        """(3,) lowest coordinates, mm."""
        return self.points.min(axis=0)

    @property
    def upper(self) -> np.ndarray:
        """(3,) highest coordinates, mm."""
        return self.points.max(axis=0)


class PhotographedBench:
    """A bench, as it stands or taken apart, by its surfaces' triangles and volumes' indices."""

    def __init__(
        self, model: SceneModel, triangles: Sequence[Triangles], indices: Mapping[str, float]
    ) -> None:
        self._model, self._indices = model, indices
        self._faces = list(zip(model.surfaces, triangles, strict=True))
        self._volumes = range(1, len(model.volumes))
        # alike in both pictures
        self._masks = [self._mask(*face) for face in self._faces]
        self._rods = {
            number: _rods([shape for _, shape in self._enclosing(number)], _shade(number))
            for number in self._volumes
            if not self._is_air(number)
        }

    def assembled(self) -> tuple[Body, ...]:
        """The bench as it stands: every face once, with the light of both its sides."""
        bodies = [rods for of_volume in self._rods.values() for rods in of_volume]
        for (surface, shape), mask in zip(self._faces, self._masks, strict=True):
            if surface.seen.kind == DIELECTRIC:
                inner, outer = map(self._tint, surface.sides)
                tint = (inner[0] * outer[0], inner[1] * outer[1], inner[2] * outer[2])
                rough = max(surface.roughness, 0.3 * surface.hazy_part)
                bodies.append(Body(shape, Finish(GLASS, tint, surface.eta, rough)))
            else:
                bodies.append(Body(shape, _opaque(surface.seen)))
                if surface.seen.kind == DIFFUSE:
                    bodies += _rods([shape], GREY)
            bodies += mask
        return tuple(bodies)

    def parts(self) -> list[BenchPart]:
        """Its parts, lowest first."""
        parts = [self._volume(number) for number in self._volumes]
        masks: dict[tuple[float, tuple[float, float], int], list[Body]] = {}
        faces: dict[tuple[object, ...], list[tuple[Surface, Triangles]]] = {}
        for (surface, shape), mask in zip(self._faces, self._masks, strict=True):
            if mask:
                level = round(float(shape.corners[:, :, 2].mean()) / (1e-4 * self._model.size_mm))
                hole = (surface.aperture_radius_mm, surface.axis_mm, level)
                masks.setdefault(hole, []).extend(mask)
            if (surface := surface.seen).kind != DIELECTRIC:
                key = (surface.kind, surface.reflectance, surface.plugin, *surface.sides)
                faces.setdefault(key, []).append((surface, shape))
        for (radius, *_), bodies in masks.items():
            points = _points(body.triangles for body in bodies)
            details = (f"black, hole radius {radius:g} mm",)
            parts.append(BenchPart("mask", details, tuple(bodies), points))
        parts += map(_face, faces.values())
        return sorted(parts, key=lambda part: (part.lower[2] + part.upper[2], part.upper[2]))

    def _volume(self, number: int) -> BenchPart:
        """A volume, enclosed by all faces that border it."""
        from mcrim_mitsuba.transport.solid_names import named_form

        volume = self._model.volumes[number]
        points = _points([shape for _, shape in self._enclosing(number)])
        index, air = self._indices.get(volume.name), self._is_air(number)
        size = np.ptp(points, axis=0)
        wide = f"{size[0]:.4g} × {size[1]:.4g} mm, {size[2]:.3g} mm thick"
        if size[2] > 0.3 * size[:2].max():
            wide = " × ".join(f"{side:.4g}" for side in size) + " mm"
        details = [f"n = {index:g}"] if index else []
        if index and size[2] < 0.03 * size[:2].max():
            details[0] += " (air)" if air else " (filled)"
        named = named_form(self._model, number)
        details += [wide] if named is None else named.split(", ")
        scat, absorb = (MM_PER_CM * a for a in (volume.alpha_scat_per_mm, volume.alpha_abs_per_mm))
        if scat or absorb:
            details += [f"scatters {scat:.3g} /cm", f"absorbs {absorb:.3g} /cm"]
        bodies: list[Body] = []
        if not air:
            plate = size[2] < _PLATE * size[:2].max()
            for surface, shape in self._enclosing(number):
                # the rim of a thin plate is ground: clear, it shows its edges as a ladder of images
                rim = plate and np.ptp(shape.corners[..., :2], axis=(0, 1)).min() < 1e-6
                rough = max(surface.roughness, 0.3 * surface.hazy_part, _GROUND_RIM * rim)
                bodies.append(Body(shape, Finish(GLASS, self._tint(number), index or 1.5, rough)))
            bodies += self._rods[number]
        return BenchPart(volume.name, tuple(details), tuple(bodies), points)

    def _enclosing(self, number: int) -> list[tuple[Surface, Triangles]]:
        """The faces that border a volume, as seen from outside it."""
        return [
            (surface, shape if surface.interior == number else shape.reversed())
            for surface, shape in self._faces
            if surface.interior != surface.exterior and number in surface.sides
        ]

    def _is_air(self, number: int) -> bool:
        """Whether a volume other than the outside holds no more than a gas."""
        index = self._indices.get(self._model.volumes[number].name)
        return index is not None and not is_filled(index)

    def _tint(self, number: int) -> Colour:
        """What a volume's glass lets through at each face; air is clear."""
        clear = number not in self._volumes or self._is_air(number)
        return CLEAR if clear else TINTS[(number - 1) % len(TINTS)]

    def _mask(self, surface: Surface, shape: Triangles) -> list[Body]:
        """The mask on a face, on both sides of it; nothing where there is none."""
        if not np.isfinite(surface.aperture_radius_mm):
            return []
        flat = _outside_circle(shape.corners, surface.axis_mm, surface.aperture_radius_mm)
        above = np.array([0.0, 0.0, _ABOVE * (1.0 + self._model.size_mm)])
        both = Triangles(np.concatenate([flat + above, flat - above]))
        return [Body(both, Finish(GLOSSY, BLACK))] if len(flat) else []


def _face(group: Sequence[tuple[Surface, Triangles]]) -> BenchPart:
    """A detector, a reflector or another opaque face, of one or more surfaces that are alike."""
    surface, _ = group[0]
    others = len({other.name for other, _ in group}) - 1
    more = f" and {others} more" if others else ""
    percent, finish = f"{100 * surface.reflectance:.3g} %", _opaque(surface)
    shapes = [shape for _, shape in group]
    rods: list[Body] = []
    if surface.kind == DETECTOR:
        says = f"reflects {percent} of the light" if surface.reflectance else "takes all light"
        if surface.acceptance_deg < 90.0:
            says = f"takes light within {surface.acceptance_deg:.4g}°"
        finish = Finish(GLOSSY, finish.colour)
    elif surface.kind == DIFFUSE:
        how = "as a mirror" if surface.mirror_part == 1.0 else "diffusely"
        says = f"reflects {percent}, {how}" if surface.reflectance else "black"
        rods = _rods(shapes, GREY)
    else:
        says = surface.plugin
    bodies = [Body(shape, finish) for shape in shapes] + rods
    return BenchPart(surface.name + more, (says,), tuple(bodies), _points(shapes))


def _opaque(surface: Surface) -> Finish:
    if surface.kind == DETECTOR:
        return Finish(MATTE, RED)
    grey = 0.92 * surface.reflectance
    return Finish(MATTE, (grey,) * 3) if surface.kind == DIFFUSE else Finish(METAL, STEEL)


def _rods(shapes: Sequence[Triangles], shade: Colour) -> list[Body]:
    """Dark lines along the edges of a part, in this colour."""
    size = np.sort(np.ptp(np.concatenate([s.corners for s in shapes]), axis=(0, 1)))
    rods = edges(shapes, min(_ROD * size[2], size[0] / 3 or np.inf))
    return [Body(rods, Finish(MATTE, shade))] if len(rods.corners) else []


def _shade(number: int) -> Colour:
    """The hue of a volume, dark."""
    red, green, blue = (0.35 * t**6 for t in TINTS[(number - 1) % len(TINTS)])
    return red, green, blue


def _outside_circle(triangles: np.ndarray, centre: tuple[float, float], radius: float):
    """What of horizontal triangles lies outside a circle, in triangles: shape (n, 3, 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, _SECTORS + 1)
    outside = []
    x, y, middle = np.cos(angles), np.sin(angles), (angles[:-1] + angles[1:]) / 2
    # of each sector: beyond its first ray, before its second, beyond the chord between them
    across = [[-y[:-1], x[:-1]], [y[1:], -x[1:]], [np.cos(middle), np.sin(middle)]]
    normals: np.ndarray = np.moveaxis(np.array(across), 2, 0)
    offsets = np.array([0.0, 0.0, radius * np.cos(np.pi / _SECTORS)])
    far = np.linalg.norm(triangles[..., :2] - centre, axis=2).max(axis=1) > radius
    for triangle in triangles[far]:
        beyond = normals @ (triangle[:, :2] - centre).T - offsets[:, None]
        for number in np.flatnonzero((beyond > 0).any(axis=2).all(axis=1)):
            polygon = triangle
            for normal, offset in zip(normals[number], offsets, strict=True):
                polygon = _clipped(polygon, (polygon[:, :2] - centre) @ normal - offset)
            outside += [polygon[[0, i, i + 1]] for i in range(1, len(polygon) - 1)]
    return np.array(outside).reshape(-1, 3, 3)


def _clipped(polygon: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """The part of a convex polygon whose corners' `distance` is positive."""
    kept = []
    for i in range(len(polygon)):
        a, b = distance[i - 1], distance[i]
        if (a > 0) != (b > 0):
            kept.append(polygon[i - 1] + a / (a - b) * (polygon[i] - polygon[i - 1]))
        if b > 0:
            kept.append(polygon[i])
    return np.array(kept).reshape(-1, 3)


def _points(shapes: Iterable[Triangles]) -> np.ndarray:
    """All different corners of some triangles, shape (n, 3)."""
    points = np.concatenate([s.corners.reshape(-1, 3) for s in shapes])
    points = points[np.lexsort(points.T[::-1])]  # which `unique` sorts slowly
    return points[np.append(True, (points[1:] != points[:-1]).any(axis=1))]


def exploded(parts: Sequence[BenchPart], spacing: float) -> list[float]:
    """Lift (mm) of every part, lowest first, so that none touches another.

    Parts that lie beside each other are not moved apart; `spacing` is between those above each
    other, over the width of the widest.
    """
    spacing *= max(float((part.upper - part.lower)[:2].max()) for part in parts)
    lifts: list[float] = []
    for number, part in enumerate(parts):
        tops = [
            below.upper[2] + lift + spacing
            for below, lift in zip(parts[:number], lifts, strict=True)
            if np.all((part.lower < below.upper)[:2] & (below.lower < part.upper)[:2])
        ]
        lifts.append(float(max(tops, default=part.lower[2]) - part.lower[2]))
    return lifts


def raised(points: np.ndarray, lift: float) -> np.ndarray:
    """Points (shape (..., 3), mm) that are lifted."""
    return points + np.array([0.0, 0.0, lift])
