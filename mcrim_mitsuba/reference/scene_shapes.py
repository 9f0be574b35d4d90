"""Shapes of a scene's text as faces: what each plugin's attributes mean, read anew.

Shares no code with the transport, which reads the loaded scene.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.reference.faces import (
    Face,
    Floats,
    around,
    ellipse,
    ellipsoid,
    half_space,
    mantle,
    polygon,
    with_round_hole,
)
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.mesh_file import read_mesh
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import Node, three_numbers, transform_matrix

#: What is narrower than this part of the whole is not there.
_NARROWEST = 1e-6
#: Distance, mm, of a beam's detector behind the crystal; at least this part of the crystal's size.
_BEHIND_MM = 0.005
_BEHIND_PART = 2.5e-4


class Properties:
    """What is written within an element of a scene."""

    def __init__(self, file: SceneFile, node: Node) -> None:
        self.file, self.node = file, node

    def __contains__(self, name: str) -> bool:
        return self.node.named(name) is not None

    def refusal(self, problem: str) -> InputError:
        """The error that the tracer does not know something of this element."""
        path, line = self.file.place_of(self.node)
        problem = f"the independent tracer does not know {problem} ({self.node.label})"
        return InputError(problem, "simulate it without a crosscheck", path=path, line=line)

    def text(self, name: str, default: str = "") -> str:
        """A property as it is written."""
        found = self.node.named(name)
        return default if found is None else found.get("value", default)

    def number(self, name: str, default: float | None = None) -> float:
        """A number; of a grey spectrum that of all colours."""
        text = self.text(name)
        if not text and default is not None:
            return default
        values = {float(part) for part in text.replace(",", " ").split()}
        if len(values) != 1:
            raise self.refusal(f"{name} = {text!r}")
        return values.pop()

    def flag(self, name: str) -> bool:
        """Whether a property is true."""
        return self.text(name, "false") == "true"

    def point(self, name: str, default: Sequence[float] = (0.0, 0.0, 0.0)) -> Floats:
        """A point or vector."""
        found = self.node.named(name)
        return np.array(default if found is None else three_numbers(found, 0.0), float)

    def is_filled(self) -> bool:
        """Whether the shape's ``index``, where it has one, is more than that of air."""
        return "index" not in self or is_filled(self.number("index"))


def to_world(shape: Properties) -> Floats:
    """Matrix, (4, 4), of a shape's transform."""
    try:
        return transform_matrix(shape.node.named("to_world"))
    except ValueError as error:
        raise shape.refusal(str(error)) from None


def faces_of(shape: Properties) -> list[Face]:
    """Faces of a shape; none where it is empty. InputError if it is not known."""
    read = _READERS.get(shape.node.type)
    if read is None:
        raise shape.refusal(f"shapes of type {shape.node.type}")
    matrix = to_world(shape)
    # Mitsuba turns these round, or inside out, where a transform mirrors them
    mirrored = shape.node.type in ("disk", "sphere") and np.linalg.det(matrix[:3, :3]) < 0.0
    flips = shape.flag("flip_normals") != mirrored
    return [face.flipped if flips else face for face in read(shape, matrix)]


def _moved(matrix: Floats, points: Any) -> Floats:
    return np.asarray(points, float) @ matrix[:3, :3].T + matrix[:3, 3]


def _square(x: Sequence[float], y: Sequence[float]) -> list[tuple[float, float, float]]:
    """Corners of a rectangle in the plane z = 0, its front upwards."""
    return [(x[0], y[0], 0.0), (x[1], y[0], 0.0), (x[1], y[1], 0.0), (x[0], y[1], 0.0)]


def _up(points: Any, z: float) -> Floats:
    return np.asarray(points, float) + np.array([0.0, 0.0, z])


def _prism(foot: Any, top: Any) -> list[list]:
    """Sides between two polygons of as many corners, both anticlockwise from above."""
    pairs = zip(foot, np.roll(foot, -1, axis=0), np.roll(top, -1, axis=0), top, strict=True)
    return [list(side) for side in pairs]


# Mitsuba's own shapes.


def _cube(shape: Properties, matrix: Floats) -> list[Face]:
    top, foot = (_up(_square((-1, 1), (-1, 1)), z) for z in (1.0, -1.0))
    return [polygon(_moved(matrix, side)) for side in [top, foot[::-1], *_prism(foot, top)]]


def _cylinder(shape: Properties, matrix: Floats) -> list[Face]:
    foot, end = shape.point("p0"), shape.point("p1", (0.0, 0.0, 1.0))
    radius, along = shape.number("radius", 1.0), end - foot
    u = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    u *= radius / np.linalg.norm(u)
    v = np.cross(along, u) / np.linalg.norm(along)
    return [mantle(_moved(matrix, foot), *(matrix[:3, :3] @ way for way in (u, v, along)))]


def _mesh(shape: Properties, matrix: Floats) -> list[Face]:
    paths = [folder / shape.text("filename") for folder in (shape.file.path.parent, Path())]
    path = next((path for path in paths if path.is_file()), paths[0])
    try:
        vertices, triangles = read_mesh(path, shape.node.type)
    except (ValueError, LookupError):
        raise shape.refusal(f"the format of {path.name}") from None
    return [polygon(_moved(matrix, vertices[triangle])) for triangle in triangles]


# Ours.


def _thickness(shape: Properties) -> float:
    return shape.number("thickness") + shape.number("thickness_offset", 0.0)


def _cut(shape: Properties) -> float:
    """Where, from -1 to 1, a bubble ends that begins at the side of low x."""
    return 2.0 * shape.number("cut", 0.0) * shape.is_filled() - 1.0


def _disc_radius(shape: Properties, width: float) -> float:
    """Of the disc that takes a part of a square; 0 where there is none."""
    radius = width * math.sqrt(shape.number("disc") / math.pi) * shape.is_filled()
    return radius if radius > _NARROWEST * width else 0.0


def _panel(shape: Properties, matrix: Floats) -> list[Face]:
    """A rectangle from -1 to 1 of which what lies on one side of a line, or a disc, is left out."""
    sizes = np.linalg.norm(matrix[:3, :2], axis=0)
    keep, trim, middle = shape.text("keep", "beyond"), shape.number("trim", 0.0), matrix[:3, 3]
    ends = [[trim / size - 1.0, 1.0 - trim / size] for size in sizes]
    if "disc" in shape:
        radius = _disc_radius(shape, 2.0 * float(sizes[0]))
        ways = (matrix[:3, :2] * radius / sizes[0]).T
        if keep == "inside":
            return [ellipse(middle, *ways)] if radius else []
        whole = polygon(_moved(matrix, _square(*ends)))
        return [with_round_hole(whole, middle, *ways) if radius else whole]
    along, line, upper = 0, _cut(shape), keep == "beyond"
    if "level" in shape:
        along = int(np.abs(matrix[2, :2]).argmax())
        rises = float(matrix[2, along])
        part = min(shape.number("level") / abs(2.0 * rises), 1.0) * shape.is_filled()
        line = (2.0 * part - 1.0) * math.copysign(1.0, rises)
        upper = (keep == "above") == (rises > 0.0)
    low, high = ends[along]
    ends[along] = [max(low, line), high] if upper else [low, min(high, line)]
    is_there = ends[along][1] - ends[along][0] > 2.0 * _NARROWEST
    return [polygon(_moved(matrix, _square(*ends)))] if is_there else []


def _regular(sides: int, width: float) -> Floats:
    """Corners of a regular polygon of this width across flats, one side across the x axis."""
    angle = (2.0 * np.arange(sides) - 1.0) * math.pi / sides
    radius = width / 2.0 / math.cos(math.pi / sides)
    return radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(sides)))


def _frame(shape: Properties, matrix: Floats) -> list[Face]:
    """A square with a hole: square, oblong, of several sides or round."""
    outer, sides = shape.number("outer_width"), int(shape.number("sides", 4))
    half, start = outer / 2.0, _cut(shape) * outer / 2.0
    whole = polygon(_moved(matrix, _square((start, half), (-half, half))))
    if "inner_diameter" in shape:
        ways = (matrix[:3, :2] * shape.number("inner_diameter") / 2.0).T
        return [with_round_hole(whole, matrix[:3, 3], *ways)]
    inner = outer - 2.0 * shape.number("rim") if "rim" in shape else shape.number("inner_width")
    if outer - inner <= 2.0 * _NARROWEST * outer or half - start <= _NARROWEST * outer:
        return []
    wide, deep = inner / 2.0, shape.number("inner_depth", inner) / 2.0
    hole = _regular(sides, inner) if sides != 4 else _square((-wide, wide), (-deep, deep))
    return around(whole, _moved(matrix, hole))


def _gap_sides(shape: Properties, matrix: Floats) -> list[Face]:
    half, start = shape.number("width") / 2.0, _cut(shape)
    top = _square((start * half, half), (-half, half))
    walls = _prism(_up(top, -_thickness(shape)), top) if 1.0 - start > 2.0 * _NARROWEST else []
    return [polygon(_moved(matrix, wall)) for wall in walls]


def _round_wall(shape: Properties, matrix: Floats) -> list[Face]:
    radius, (x, y, z) = _disc_radius(shape, shape.number("width")), np.eye(3)
    deep = _thickness(shape) * z
    return [mantle(-deep, radius * x, radius * y, deep).flipped] if radius else []


def _chamfers(shape: Properties, matrix: Floats) -> list[Face]:
    """Hexagons: each takes a leg off both faces at an edge, and ends in points at the corners."""
    width, height, leg = (shape.number(name) for name in ("width", "height", "leg"))
    half, faces = np.array([width, width, height]) / 2.0, list[Face]()
    # how far corners lie from the box's on the two faces, and along the edge
    insets = leg * np.array([(0.0, 1.0, 1.0), (0.5, 0.5, 0.5), (1.0, 0.0, 1.0)])
    signs = tuple(itertools.product((-1.0, 1.0), repeat=2))
    for along, sign in itertools.product(range(3) if leg else (), signs):
        axes = [(along + 1) % 3, (along + 2) % 3, along]
        corners = np.zeros((6, 3))
        for i, inset in enumerate((*insets, *insets[::-1])):
            corners[i, axes] = np.array([*sign, 1.0 if i > 2 else -1.0]) * (half[axes] - inset)
        if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ corners.mean(axis=0) < 0.0:
            corners = corners[::-1]
        faces.append(polygon(_moved(matrix, _up(corners, half[2]))))
    return faces


class WrappedSolid:
    """What is around a box, prism or cylinder: walls and a lid behind a film, or paint."""

    def __init__(self, shape: Properties, matrix: Floats) -> None:
        self.film, self.height = shape.number("film"), shape.number("height")
        self.without = set(shape.text("without").replace(",", " ").split())
        self.sides = 0 if "diameter" in shape else int(shape.number("sides", 4))
        self.width = shape.number("width" if self.sides else "diameter")
        self._matrix = matrix
        #: The z at which walls, contact and paint begin.
        self.foot = float(matrix[2, 3])
        self.begin = self.foot + shape.number("missing", 0.0) * self.height

    def faces(self) -> list[Face]:
        """Walls and lid; they face what they are around."""
        if not self.film:
            return []
        x, y, z = self._matrix[:3, :3].T
        lid = "top" not in self.without
        rise = self.height + self.film * lid - (self.begin - self.foot)
        foot, reach = self._matrix[:3, 3] + (self.begin - self.foot) * z, self.width / 2 + self.film
        if not self.sides:
            top = ellipse(foot + rise * z, reach * x, reach * y)
            wall = mantle(foot, reach * x, reach * y, rise * z)
            return [f.flipped for f, name in ((top, "top"), (wall, "sides")) if self._has(name)]
        ring = _regular(self.sides, 2.0 * reach) @ np.array([x, y, z]) + foot
        whole = [polygon(ring + rise * z), *map(polygon, _prism(ring, ring + rise * z))]
        return [face.flipped for face in whole if self._has(self._wall(face))]

    def touches(self, face: Face) -> bool:
        """Whether a face is one that it can touch: within it, not on its foot, nor left out."""
        local = face.box - self._matrix[:3, 3]
        rounding = 1e-6 * max(self.width, self.height)
        corner = self.width / 2.0 / math.cos(math.pi / self.sides) if self.sides else self.width / 2
        angles = 2.0 * math.pi / max(self.sides, 1) * np.arange(self.sides)
        x, y, _ = local.mean(axis=0) @ self._matrix[:3, :3]
        before = x * np.cos(angles) + y * np.sin(angles) <= self.width / 2.0 + rounding
        within = np.abs(local[:, :2]).max() <= corner + rounding and before.all()
        stands = local[0, 2] >= -rounding and rounding < local[1, 2] <= self.height + rounding
        return bool(within and stands and self._has(self._wall(face)))

    def _has(self, name: str) -> bool:
        return name not in self.without and (name == "top" or "sides" not in self.without)

    def _wall(self, face: Face) -> str:
        """The name of the wall that is before a face, or of the lid."""
        if face.plane is None:
            return "sides"
        x, y, z = face.plane[:3] @ self._matrix[:3, :3]
        if z > max(abs(x), abs(y)):
            return "top"
        if self.sides != 4:
            return "sides"
        return ("right" if x > 0 else "left") if abs(x) > abs(y) else "back" if y > 0 else "front"


def _beam_detector(shape: Properties, matrix: Floats) -> list[Face]:
    width, height = shape.number("width"), shape.number("height")
    half, along = np.array([width, width, height]) / 2.0, "xyz".index(shape.text("axis", "x"))
    corners, across = np.zeros((4, 3)), [(along + 1) % 3, (along + 2) % 3]
    corners[:, along] = half[along] + max(_BEHIND_MM, _BEHIND_PART * max(width, height))
    corners[:, across] = half[across] * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return [polygon(_moved(matrix, _up(corners, half[2]))).flipped]


def _polygon(shape: Properties, matrix: Floats) -> list[Face]:
    width = shape.number("width")
    corners = _regular(int(shape.number("sides", 4)), width)
    return [polygon(_moved(matrix, corners))] if width else []


def _prism_sides(shape: Properties, matrix: Floats) -> list[Face]:
    sides, width = int(shape.number("sides", 4)), shape.number("width")
    top_width = shape.number("top_width", width)
    walls = _prism(_regular(sides, width), _up(_regular(sides, top_width), shape.number("height")))
    return [polygon(_moved(matrix, wall if top_width else wall[:3])) for wall in walls]


def _lying(shape: Properties) -> tuple[float, float, float, float]:
    """Radius and half length of a cylinder along x on z = 0, half width and height of the strip."""
    radius, half = shape.number("diameter") / 2.0, shape.number("length") / 2.0
    wet = shape.number("wetted_width") / 2.0
    return radius, half, wet, wet**2 / (radius + math.sqrt(radius**2 - wet**2))


def _lying_mantle(shape: Properties, matrix: Floats) -> list[Face]:
    (radius, half, _, level), (x, y, z) = _lying(shape), np.eye(3)
    whole = mantle(radius * z - half * x, radius * y, radius * z, 2.0 * half * x)
    edge = half_space(z if shape.text("keep") == "wet" else -z, level * z)
    return [replace(whole, bounds=(*whole.bounds, edge))]


def _lying_fillet(shape: Properties, matrix: Floats) -> list[Face]:
    """The sides of what is below a lying cylinder: two walls along it, two ends that it bounds."""
    (radius, half, wet, level), (_, y, z) = _lying(shape), np.eye(3)
    strip = _square((-half, half), (-wet, wet))
    walls = [polygon(w) for w in _prism(_up(strip, -shape.number("thickness")), _up(strip, level))]
    for i, place in ((1, half), (3, -half)):
        walls[i] = with_round_hole(walls[i], (place, 0.0, radius), radius * y, radius * z)
    return walls


_READERS: dict[str, Callable[[Properties, Floats], list[Face]]] = {
    "rectangle": lambda _, matrix: [polygon(_moved(matrix, _square((-1, 1), (-1, 1))))],
    "cube": _cube,
    "disk": lambda _, matrix: [ellipse(matrix[:3, 3], matrix[:3, 0], matrix[:3, 1])],
    "cylinder": _cylinder,
    "sphere": lambda shape, matrix: [
        ellipsoid(
            _moved(matrix, shape.point("center")), matrix[:3, :3] * shape.number("radius", 1.0)
        )
    ],
    "obj": _mesh,
    "ply": _mesh,
    "panel": _panel,
    "frame": _frame,
    "gap_sides": _gap_sides,
    "round_wall": _round_wall,
    "chamfers": _chamfers,
    "wrapping": lambda shape, matrix: WrappedSolid(shape, matrix).faces(),
    "beam_detector": _beam_detector,
    "polygon": _polygon,
    "prism_sides": _prism_sides,
    "lying_mantle": _lying_mantle,
    "lying_fillet": _lying_fillet,
}
