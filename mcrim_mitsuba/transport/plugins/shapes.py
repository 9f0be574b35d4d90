"""Shape plugins, each a few flat polygons: panel, frame, gap_sides, chamfers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.conversion import write_parameters
from mcrim_mitsuba.transport.plugins import BEAM_AXES, beam_axis, sizes
from mcrim_mitsuba.transport.scene_model import Circle, RoundWall

#: What is narrower than this part of the whole is rounding of single precision: not there.
NARROWEST = 1e-6


class Polygons(mi.Mesh):
    """A shape of flat polygons, which may be rotated, scaled and moved by its ``to_world``.

    Mitsuba knows no mesh without triangles, so a shape that is `empty` has a single triangle
    without area, which no ray hits; `transport.conversion` leaves such shapes out.
    """

    #: Corner, two edges (float64, shape (3,), mm) and a `Circle` or None: the faces that the
    #: polygons are drawn for, where one is round or has a round hole.
    round_faces: tuple[tuple, ...] = ()
    #: The wall that they are drawn for.
    wall: RoundWall | None = None

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        matrix = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, dtype=np.float64)
        polygons = self.polygons(props, matrix)
        self.empty = not polygons
        if self.empty:
            polygons = [np.zeros((3, 3))]
        corners = np.concatenate([np.asarray(polygon, dtype=np.float64) for polygon in polygons])
        corners = np.column_stack([corners, np.ones(len(corners))]) @ matrix.T
        triangles, first = [], 0
        for polygon in polygons:
            triangles += [(first, first + i, first + i + 1) for i in range(1, len(polygon) - 1)]
            first += len(polygon)
        vertices, faces = mi.Float(corners[:, :3].ravel()), mi.UInt32(np.ravel(triangles))
        write_parameters(self, vertex_positions=vertices, faces=faces)

    def polygons(self, props: mi.Properties, to_world: np.ndarray) -> Sequence:
        """The polygons, convex, by their corners, shape (corners, 3) each.

        In mm of the shape's own coordinates; anticlockwise as seen from the side that the normal
        points to. `to_world` is float64, shape (4, 4).
        """
        raise NotImplementedError

    def to_string(self) -> str:
        return f"{type(self).__name__}[id = {self.id()}, triangles = {self.face_count()}]"


def rectangle(x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
    """The corners of a rectangle in the plane z = 0, normal along +z."""
    return np.array([(x[0], y[0], 0.0), (x[1], y[0], 0.0), (x[1], y[1], 0.0), (x[0], y[1], 0.0)])


def is_there(low: float, high: float, whole: float) -> bool:
    """Whether what lies between two coordinates is more than rounding of a whole width."""
    return high - low > NARROWEST * whole


#: Sides of the polygon that is drawn for a circle, of the same area.
_AROUND = 96


def _ring(radius: float) -> np.ndarray:
    """Corners around the origin, anticlockwise seen from above, of the polygon for a circle."""
    step = 2.0 * np.pi / _AROUND
    angles = step * np.arange(_AROUND)
    corners = np.column_stack([np.cos(angles), np.sin(angles)])
    return radius * np.sqrt(step / np.sin(step)) * corners


def _square_around(ring: np.ndarray, half: float) -> list[np.ndarray]:
    """What a square of this half width has around a ring of corners, shape (n, 3), in its plane."""
    # out to the edges in the same directions, those of the corners among them
    rim = half * ring / np.abs(ring).max(axis=1)[:, None]
    following = np.roll(np.arange(len(ring)), -1)
    return [np.array([ring[i], rim[i], rim[j], ring[j]]) for i, j in enumerate(following.tolist())]


def _disc_radius(props, width: float) -> float:
    """Radius of the disc that is a shape's ``disc`` of a square of this width; 0 where none is.

    None is where the shape's ``index``, that of what is around the disc, is that of air.
    """
    share = float(props["disc"])
    if not 0.0 <= share < np.pi / 4.0:
        raise ValueError(f"disc is {share:g}; give 0 to 0.78: it must lie in the square")
    filled = "index" not in props or is_filled(float(props["index"]))
    return width * float(np.sqrt(share / np.pi)) if filled else 0.0


def cut_fraction(props) -> float:
    """The part of a width that is cut off at the side of low x: where a bubble of air is.

    ``cut`` of the shape (0 when absent); 0 too where the shape's ``index``, that of what fills
    the rest, is that of air. Raises ValueError if it is not between 0 and 1.
    """
    cut = float(props.get("cut", 0.0))
    if not 0.0 <= cut <= 1.0:
        raise ValueError(f"cut is {cut:g}; give a fraction, 0 to 1")
    filled = "index" not in props or is_filled(float(props["index"]))
    return cut if filled else 0.0


KEEP = ("beyond", "before", "above", "below", "outside", "inside")


class PanelShape(Polygons):
    """A rectangle of x and y from -1 to 1, as Mitsuba's own, of which a part may be left out.

    XML: ``<shape type="panel">`` with

    ``to_world`` : transform
        It may scale, rotate and move, but not shear.
    ``trim`` : float, default 0
        What is cut off from each of the four edges, in the scene's millimetres.
    ``cut`` : float f, default 0
        The line x = -W/2 + f W cuts the panel in two; W is its full width along its own x axis.
    ``level`` : float
        In place of ``cut``, of an upright panel: a horizontal line this far above its lower edge,
        in the scene's millimetres, cuts it in two.
    ``disc`` : float
        In place of ``cut``, of a square that lies flat: a disc about its middle of this part of its
        area cuts it in two.
    ``keep`` : string, default ``beyond``
        Which part stays: ``beyond`` the line (greater x) or ``before`` it; ``above`` or ``below``
        a level; ``outside`` or ``inside`` a disc.
    ``index`` : float, optional
        Index of what lies beyond the line, below the level or around the disc; where it is that of
        air, nothing is cut (f = 0, level 0, disc 0).
    """

    def polygons(self, props, to_world):
        cut, keep = cut_fraction(props), str(props.get("keep", KEEP[0]))
        trim = float(props.get("trim", 0.0))
        width, depth = 2.0 * np.linalg.norm(to_world[:3, :2], axis=0)
        if keep not in KEEP:
            raise ValueError(f"a panel's keep is {keep!r}; give {' or '.join(KEEP)}")
        if not min(width, depth) > 0.0:
            raise ValueError("a panel has no area: look for a scale of 0 in its transform")
        if not 0.0 <= trim < min(width, depth) / 2:
            raise ValueError(
                f"a panel's trim ({trim:g}) must be positive or 0, and less than half of its "
                f"width and height ({width:g} x {depth:g})"
            )
        if ("disc" in props) != (keep in ("outside", "inside")):
            raise ValueError(f"a panel's keep is {keep!r}: outside or inside, and only of a disc")
        if "disc" in props:
            return self._round(_disc_radius(props, width), keep == "inside", trim, to_world)
        parts = [(trim / size, 1.0 - trim / size) for size in (width, depth)]
        # part of a width that is cut off at its lower end, of which axis, and which part stays
        axis, upper = 0, keep in ("beyond", "above")
        if ("level" in props) != (keep in ("above", "below")):
            raise ValueError(f"a panel's keep is {keep!r}: above or below, and only of a level")
        if "level" in props:
            axis, cut, upwards = _level_fraction(props, to_world)
            upper = upper == upwards
        low, high = parts[axis]
        low, high = (max(low, cut), high) if upper else (low, min(high, cut))
        parts[axis] = low, high
        corners = 2.0 * rectangle(parts[0], parts[1]) - (1.0, 1.0, 0.0)
        return [corners] if is_there(low, high, 1.0) else []

    def _round(self, radius: float, inside: bool, trim: float, to_world: np.ndarray) -> Sequence:
        """The disc, or what is left around it."""
        width, depth = 2.0 * np.linalg.norm(to_world[:3, :2], axis=0)
        slanted = max(abs(width - depth), np.abs(to_world[2, :2]).max()) > NARROWEST * width
        if trim or slanted:
            raise ValueError("a panel with a disc is a square that lies flat, without a trim")
        whole = 2.0 * rectangle((0.0, 1.0), (0.0, 1.0)) - (1.0, 1.0, 0.0)
        if not is_there(0.0, radius, width):
            return [] if inside else [whole]
        middle, half = to_world[:3, 3], to_world[:3, :2].T
        if inside:
            half = half * (2.0 * radius / width)
        circle = Circle((float(middle[0]), float(middle[1])), radius, inside)
        self.round_faces = ((middle - half[0] - half[1], 2.0 * half[0], 2.0 * half[1], circle),)
        ring = _ring(2.0 * radius / width)
        ring = np.column_stack([ring, np.zeros(len(ring))])
        return [ring] if inside else _square_around(ring, 1.0)


def _level_fraction(props, to_world: np.ndarray) -> tuple[int, float, bool]:
    """Where a level cuts an upright panel: its own axis, the part of it, whether that goes up."""
    level, rises = float(props["level"]), to_world[2, :2]
    axis = int(np.argmax(np.abs(rises)))
    height = 2.0 * abs(float(rises[axis]))
    if not height > 0.0:
        raise ValueError("a panel with a level stands upright: this one lies flat")
    if not level >= 0.0:
        raise ValueError(f"a panel's level is {level:g}; give 0 or more")
    wet = "index" not in props or is_filled(float(props["index"]))
    part = min(level / height, 1.0) if wet else 0.0
    upwards = bool(rises[axis] > 0.0)
    return axis, part if upwards else 1.0 - part, upwards


def regular_polygon(sides: int, width: float) -> np.ndarray:
    """Corners, shape (sides, 3), against the clock, of a regular polygon in the plane z = 0.

    `width` is that across flats, twice the distance of a side from the middle; one side is across
    the x axis.
    """
    angles = 2.0 * np.pi / sides * (np.arange(sides) - 0.5)
    radius = width / 2.0 / np.cos(np.pi / sides)
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(sides)])


def polygon_faces(sides: int, width: float) -> list[np.ndarray]:
    """What a `regular_polygon` is made of: itself of four sides, else rhombi, which are faces."""
    corners = regular_polygon(sides, width)
    if sides == 4:
        return [corners]
    step, middle = 2 - sides % 2, np.zeros((1, 3))
    around = np.concatenate([corners, corners[:1]])
    return [np.concatenate([middle, around[i : i + step + 1]]) for i in range(0, sides, step)]


def sides_of(props: mi.Properties) -> int:
    """The number of sides that a shape's ``sides`` is; 4 where it has none."""
    sides = int(props.get("sides", 4))
    if not 3 <= sides <= MOST_SIDES:
        raise ValueError(f"sides is {sides}; give 3 to {MOST_SIDES}, or a cylinder")
    return sides


#: Of a polygon: one of more is better a circle.
MOST_SIDES = 12


class Frame(Polygons):
    """Square frame in the plane z = 0 of its own coordinates, normal along +z.

    The window's entrance face beside the crystal is such a surface: the part
    under the crystal is another interface. XML: ``<shape type="frame">`` with

    ``outer_width`` : float
        Outer edge length in the scene's millimetres; that of the hole is no frame at all.
    ``inner_width`` or ``rim`` : float
        Edge length of the hole, or width of the frame itself; a rim of 0 is no frame at all.
    ``inner_depth`` : float, default ``inner_width``
        Of the hole along y, where it is not square.
    ``inner_diameter`` : float
        In place of ``inner_width``: the hole is round.
    ``sides`` : integer, default 4
        The hole is a regular polygon, ``inner_width`` being that across flats.
    ``cut`` : float f, default 0
        What lies at x < -W/2 + f W is left out, W being the outer width.
    ``index`` : float, optional
        Index of what fills the space beside the cut; where it is that of air, nothing is cut.
    """

    def polygons(self, props, to_world):
        outer, cut = float(props["outer_width"]), cut_fraction(props)
        if sum(name in props for name in ("inner_width", "inner_diameter", "rim")) != 1:
            raise ValueError("a frame has either an inner_diameter, an inner_width or a rim")
        if "rim" in props:
            rim = float(props["rim"])
            if not 0.0 <= rim < outer / 2:
                raise ValueError(
                    f"a frame's rim ({rim:g}) must be positive or 0, and less than half of its "
                    f"outer_width ({outer:g})"
                )
            inner = outer - 2 * rim
        else:
            name = "inner_width" if "inner_width" in props else "inner_diameter"
            inner = float(props[name])
            # a square hole of its whole width leaves no frame at all
            is_none = name == "inner_width" and inner == outer
            if not (outer > inner or is_none) or not inner > 0.0:
                problem = f"a frame's outer_width ({outer:g}) must exceed its {name} ({inner:g})"
                raise ValueError(problem)
        deep, sides = float(props.get("inner_depth", inner)), sides_of(props)
        if "inner_depth" in props and not outer >= deep > 0.0:
            problem = f"a frame's outer_width ({outer:g}) must exceed its inner_depth ({deep:g})"
            raise ValueError(problem)
        if "inner_diameter" in props or sides != 4:
            if cut or "inner_depth" in props:
                raise ValueError("a frame with a cut or an inner_depth has a hole of four sides")
            return self._around(props, to_world, outer / 2, inner, sides)
        # Four rectangles around the hole, each a quarter turn from the last: rectangles
        # are what the transport tests fastest.
        o, i, k = outer / 2, inner / 2, deep / 2
        walls = [((-o, i), (k, o)), ((-o, -i), (-o, k)), ((-i, o), (-o, -k)), ((i, o), (-k, o))]
        start = cut * outer - o
        walls = [((max(x[0], start), x[1]), y) for x, y in walls]
        return [rectangle(x, y) for x, y in walls if is_there(*x, outer) and is_there(*y, outer)]

    def _around(self, props, to_world, half: float, inner: float, sides: int) -> Sequence:
        """What is around a round hole, or around one of this number of sides."""
        if "inner_diameter" not in props:
            corners = regular_polygon(sides, inner)
            if np.abs(corners).max() >= half:
                raise ValueError("a frame's hole reaches beyond its outer_width")
            return _square_around(_with_diagonals(corners), half)
        if "sides" in props:
            raise ValueError("a frame's hole is round, or has sides")
        if np.abs(to_world[:3, :3] - np.eye(3)).max() > 0.0:
            raise ValueError("a frame with a round hole lies flat: it can only be moved")
        middle, edges = to_world[:3, 3], 2.0 * half * np.eye(3)
        circle = Circle((float(middle[0]), float(middle[1])), inner / 2, inside=False)
        self.round_faces = ((middle - edges[0] / 2 - edges[1] / 2, edges[0], edges[1], circle),)
        ring = _ring(inner / 2)
        return _square_around(np.column_stack([ring, np.zeros(len(ring))]), half)


def _with_diagonals(corners: np.ndarray) -> np.ndarray:
    """Corners around the origin, and where the diagonals of a square meet the edges between."""
    around = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        met = [0.0]
        for diagonal in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)):
            # start + t (end - start) = s diagonal, s > 0
            edge = np.column_stack([end[:2] - start[:2], -np.array(diagonal)])
            if abs(np.linalg.det(edge)) < NARROWEST * np.linalg.norm(edge) ** 2:
                continue
            t, s = np.linalg.solve(edge, -start[:2])
            if NARROWEST < t < 1.0 - NARROWEST and s > 0.0:
                met.append(float(t))
        around += [start + t * (end - start) for t in sorted(met)]
    return np.array(around)


class GapSides(Polygons):
    """Four walls below the plane z = 0 of its own coordinates, normals outwards.

    They stand around a square centred on the z axis. XML: ``<shape type="gap_sides">`` with

    ``width``, ``thickness`` : float
        Of the gap, in the scene's millimetres.
    ``thickness_offset`` : float, default 0
        What is added to the thickness.
    ``cut`` : float f, default 0
        The wall of low x stands at x = -W/2 + f W, W being the width: beside it is a bubble.
    ``index`` : float, optional
        Index of what fills the gap; where it is that of air, nothing is cut.
    """

    def polygons(self, props, to_world):
        (width,), cut = sizes(props, "width"), cut_fraction(props)
        nominal = float(props["thickness"])
        thickness = nominal + float(props.get("thickness_offset", 0.0))
        if not thickness > 0.0:
            raise ValueError(
                f"the gap's thickness is {nominal:g} and {thickness:g} with its offset; "
                "it must be positive"
            )
        a, start = width / 2, cut * width - width / 2
        ring = [(start, -a), (a, -a), (a, a), (start, a)]
        walls = [
            np.array([(*foot, -thickness), (*end, -thickness), (*end, 0.0), (*foot, 0.0)])
            for foot, end in zip(ring, ring[1:] + ring[:1], strict=True)
        ]
        return walls if is_there(start, a, width) else []


class RoundWallShape(Polygons):
    """The wall of a round bubble in a gap, below the plane z = 0; normals point to its axis.

    XML: ``<shape type="round_wall">`` with

    ``width``, ``thickness`` : float
        Of the gap, in the scene's millimetres.
    ``thickness_offset`` : float, default 0
        What is added to the thickness.
    ``disc`` : float
        Part of the gap's square that the bubble takes, about the z axis.
    ``index`` : float, optional
        Index of what fills the gap; where it is that of air, there is no wall.
    """

    def polygons(self, props, to_world):
        radius = _disc_radius(props, float(props["width"]))
        thickness = float(props["thickness"]) + float(props.get("thickness_offset", 0.0))
        if np.abs(to_world - np.eye(4)).max() > 0.0:
            problem = "a round wall stands about the z axis, below z = 0: leave to_world out"
            raise ValueError(problem)
        if not is_there(0.0, radius, float(props["width"])):
            return []
        self.wall = RoundWall(Circle((0.0, 0.0), radius), -thickness, 0.0, -1)
        ring = _ring(radius)
        return [
            np.array([(*end, -thickness), (*start, -thickness), (*start, 0.0), (*end, 0.0)])
            for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True)
        ]


#: Legs below this part of the crystal's size are lost in the rounding of single precision.
SHORTEST_LEG = 1e-5


class Chamfers(Polygons):
    """The twelve 45 degree faces along the edges of a box, normals outwards.

    The box stands on z = 0, centred on the z axis of its own coordinates. Where three chamfers
    meet they end in a point, without a facet at the corner: each is a hexagon. XML:
    ``<shape type="chamfers">`` with

    ``width``, ``height`` : float
        Of the box, in the scene's millimetres.
    ``leg`` : float
        What each chamfer takes from both faces beside it; 0 is no chamfer.
    """

    def polygons(self, props, to_world):
        (width, height), leg = sizes(props, "width", "height"), float(props["leg"])
        if not 0.0 <= 2.0 * leg < min(width, height):
            raise ValueError(
                f"a chamfer's leg ({leg:g}) must be positive or 0, and twice of it less than "
                f"width and height ({width:g} and {height:g})"
            )
        if 0.0 < leg < SHORTEST_LEG * max(width, height):
            raise ValueError(
                f"a chamfer's leg ({leg:g}) is too short for single precision; give 0, or at "
                f"least {SHORTEST_LEG * max(width, height):g}"
            )
        half = np.array([width, width, height]) / 2
        middle = np.array([0.0, 0.0, half[2]])
        return [
            middle + part
            for along in range(3)
            for signs in itertools.product((-1.0, 1.0), (-1.0, 1.0))
            for part in (_hexagon(half, along, signs, leg) if leg else ())
        ]


def _hexagon(half, along: int, signs: tuple[float, float], leg: float) -> list[np.ndarray]:
    """One chamfer as its rectangle and the triangles at its two ends.

    So `transport.conversion` gets the fewest flat faces. The box of these half widths is centred
    on the origin; the edge runs along an axis and lies on the given sides of the two others.
    """
    first, second = (axis for axis in range(3) if axis != along)
    outwards = np.zeros(3)
    outwards[[first, second]] = signs

    def point(end: float, inset_one: float, inset_other: float, inset_end: float):
        inset, side = np.zeros(3), outwards.copy()
        inset[[first, second, along]], side[along] = (inset_one, inset_other, inset_end), end
        return side * (half - inset)

    (a, b), (d, c) = ((point(end, 0, leg, leg), point(end, leg, 0, leg)) for end in (-1.0, 1.0))
    low, high = (point(end, leg / 2, leg / 2, leg / 2) for end in (-1.0, 1.0))
    parts = []
    for part in map(np.array, ((a, b, c, d), (a, b, low), (c, d, high))):
        faces_outwards = np.cross(part[1] - part[0], part[2] - part[0]) @ outwards > 0
        parts.append(part if faces_outwards else part[::-1])
    return parts


#: Distance of a beam's detector behind the crystal: light at any angle still arrives on it.
BEHIND_MM = 0.005
#: The same over the crystal's size, at least, so that rays tell the two apart.
BEHIND_PART = 2.5e-4


class BeamDetector(Polygons):
    """A plate right behind the side of a box where a beam along an axis leaves it, facing it.

    The box stands on z = 0, centred on the z axis of its own coordinates; the plate covers the
    side. XML: ``<shape type="beam_detector">`` with

    ``width``, ``height`` : float
        Of the box, in the scene's millimetres.
    ``axis`` : string, default ``x``
        ``x``, ``y`` or ``z``: that of the beam.
    """

    def polygons(self, props, to_world):
        (width, height), axis = sizes(props, "width", "height"), beam_axis(props)
        half = np.array([width, width, height]) / 2
        along = BEAM_AXES.index(axis)
        across, up = (along + 1) % 3, (along + 2) % 3
        # clockwise as seen from beyond, so that the normal points back at the crystal
        corners = np.zeros((4, 3))
        corners[:, along] = half[along] + max(BEHIND_MM, BEHIND_PART * max(width, height))
        corners[:, across] = half[across] * np.array([-1, -1, 1, 1])
        corners[:, up] = half[up] * np.array([-1, 1, 1, -1])
        corners[:, 2] += half[2]
        return [corners]


for _shape, _name in {
    PanelShape: "panel",
    Frame: "frame",
    GapSides: "gap_sides",
    Chamfers: "chamfers",
    RoundWallShape: "round_wall",
    BeamDetector: "beam_detector",
}.items():
    mi.register_shape(_name, _shape)
