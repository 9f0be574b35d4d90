"""Shape plugins of crystals that are no boxes: polygon, prism_sides, lying_mantle, lying_fillet."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.transport.plugins import shapes, sizes
from mcrim_mitsuba.transport.scene_model import Circle, RoundWall

#: Steps around a lying cylinder that is drawn.
_AROUND = 192


class Polygon(shapes.Polygons):
    """A regular polygon in the plane z = 0 of its own coordinates, normal along +z.

    XML: ``<shape type="polygon">`` with

    ``sides`` : integer, default 4
        How many.
    ``width`` : float
        Across flats, in the scene's millimetres; one side is across the x axis. 0 is no polygon.
    """

    def polygons(self, props, to_world):
        width, sides = float(props["width"]), shapes.sides_of(props)
        if not width >= 0.0:
            raise ValueError(f"a polygon's width is {width:g}; give 0 or more")
        return shapes.polygon_faces(sides, width) if width else []


class PrismSides(shapes.Polygons):
    """The sides of an upright prism or of a pyramid, cut or whole, normals outwards.

    Its foot is a regular polygon in the plane z = 0 of its own coordinates. XML:
    ``<shape type="prism_sides">`` with

    ``sides`` : integer, default 4
        How many.
    ``width`` : float
        Of the foot, across flats, in the scene's millimetres; one side is across the x axis.
    ``top_width`` : float, default ``width``
        The same at the top; 0 makes a point.
    ``height`` : float
        From the foot to the top.
    """

    def polygons(self, props, to_world):
        (width, height), sides = sizes(props, "width", "height"), shapes.sides_of(props)
        top_width = float(props.get("top_width", width))
        if not top_width >= 0.0:
            raise ValueError(f"a prism's top_width is {top_width:g}; give 0 or more")
        foot, top = (shapes.regular_polygon(sides, across) for across in (width, top_width))
        top[:, 2] = height
        sides_around = []
        for i in range(sides):
            j = (i + 1) % sides
            upper = [top[j], top[i]] if top_width else [top[i]]
            sides_around.append(np.array([foot[i], foot[j], *upper]))
        return sides_around


class _Lying(shapes.Polygons):
    """What is around the lowest line of a cylinder that lies along x on z = 0."""

    def _sizes(self, props: mi.Properties, to_world: np.ndarray) -> tuple[float, float, float]:
        """Radius, length, and half the width that is wet."""
        diameter, length = sizes(props, "diameter", "length")
        wet = float(props["wetted_width"])
        if np.abs(to_world - np.eye(4)).max() > 0.0:
            raise ValueError("a lying cylinder lies along x on z = 0: leave to_world out")
        if not 0.0 < wet < diameter:
            raise ValueError(
                f"a lying cylinder's wetted_width ({wet:g}) must be positive and less than its "
                f"diameter ({diameter:g})"
            )
        return diameter / 2, length, wet / 2


def _height(radius: float, y: np.ndarray | float) -> np.ndarray:
    """Of a lying cylinder's lower half above its lowest line, at a distance from that, mm."""
    # not the difference of two that are nearly alike
    return np.square(y) / (radius + np.sqrt(radius**2 - np.square(y)))


class LyingMantle(_Lying):
    """A part of the side of a cylinder that lies along x on z = 0, normals outwards.

    It is drawn as narrow facets; light meets a cylinder. XML: ``<shape type="lying_mantle">`` with

    ``diameter``, ``length`` : float
        In the scene's millimetres.
    ``wetted_width`` : float
        Of the strip along its lowest line, which is what lies at ``|y|`` up to half of this.
    ``keep`` : string
        ``wet``: the strip; ``dry``: the rest.
    """

    def polygons(self, props, to_world):
        radius, length, wet = self._sizes(props, to_world)
        keep = str(props["keep"])
        if keep not in ("wet", "dry"):
            raise ValueError(f"a lying_mantle's keep is {keep!r}; give wet or dry")
        is_wet, level = keep == "wet", float(_height(radius, wet))
        circle, half = Circle((0.0, radius), radius, axis=0), length / 2
        heights = {"below_mm" if is_wet else "above_mm": level}
        self.wall = RoundWall(circle, -half, half, -1, outwards=True, **heights)
        edge = float(np.arcsin(wet / radius))
        # from the lowest line on, against the clock seen from +x
        start, end = (-edge, edge) if is_wet else (edge, 2.0 * np.pi - edge)
        angle = np.linspace(start, end, max(2, round(_AROUND * (end - start) / 2.0 / np.pi)) + 1)
        y, z = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
        return [
            np.array([(half, *near), (-half, *near), (-half, *far), (half, *far)])
            for near, far in itertools.pairwise(zip(y, z, strict=True))
        ]


class LyingFillet(_Lying):
    """The sides of what fills the space below a lying cylinder, down to a plane; normals outwards.

    Two upright walls along it and two ends, which the cylinder bounds above. XML:
    ``<shape type="lying_fillet">`` with

    ``diameter``, ``length``, ``wetted_width`` : float
        As of ``lying_mantle``, in the scene's millimetres.
    ``thickness`` : float
        Of what is below the cylinder's lowest line.
    """

    def polygons(self, props, to_world):
        radius, length, wet = self._sizes(props, to_world)
        (thickness,) = sizes(props, "thickness")
        half, level = length / 2, float(_height(radius, wet))
        x, y, z = np.diag([length, 2.0 * wet, thickness + level])
        low = np.array([-half, -wet, -thickness])
        circle = Circle((0.0, radius), radius, inside=False, axis=0)
        self.round_faces = (
            (low, x, z, None),
            (low + y, z, x, None),
            (low, z, y, circle),
            (low + x, y, z, circle),
        )
        walls: Sequence = [
            np.array([low, low + x, low + x + z, low + z]),
            np.array([low + y, low + y + z, low + y + z + x, low + y + x]),
        ]
        under = [(at, float(_height(radius, at))) for at in np.linspace(-wet, wet, 17)]
        ends = []
        for (left, up), (right, next_up) in itertools.pairwise(under):
            foot = [(half, left, -thickness), (half, right, -thickness)]
            end = np.array([*foot, (half, right, next_up), (half, left, up)])
            ends += [end, (end * (-1.0, 1.0, 1.0))[::-1]]
        return [*walls, *ends]


for _shape, _name in {
    Polygon: "polygon",
    PrismSides: "prism_sides",
    LyingMantle: "lying_mantle",
    LyingFillet: "lying_fillet",
}.items():
    mi.register_shape(_name, _shape)
