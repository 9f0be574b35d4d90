"""Shape plugin ``chamfers``: the cut edges of a box-shaped crystal."""

from __future__ import annotations

import itertools

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.flat_mesh import set_polygons

#: Legs below this part of the crystal's size are lost in the rounding of single precision.
SHORTEST_LEG = 1e-5


class Chamfers(mi.Mesh):
    """The twelve 45 degree faces along the edges of a box, normals outwards.

    The box stands on z = 0, centred on the z axis of its own coordinates. Where three chamfers
    meet they end in a point, without a facet at the corner: each is a hexagon. XML:
    ``<shape type="chamfers">`` with

    ``width``, ``height`` : float
        Of the box, in the scene's millimetres.
    ``leg`` : float
        What each chamfer takes from both faces beside it; 0 is no chamfer.
    ``to_world`` : transform
        Where it stands in the scene.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        width, height, leg = (float(props[name]) for name in ("width", "height", "leg"))
        if not min(width, height) > 0.0:
            raise ValueError("the width and the height of what is chamfered must be positive")
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
        self.size = (width, height, leg)
        to_world = props.get("to_world", mi.ScalarTransform4f())
        set_polygons(self, _hexagons(width, height, leg) if leg else [], to_world)

    def to_string(self) -> str:
        return "Chamfers[width = {:g}, height = {:g}, leg = {:g}]".format(*self.size)


def _hexagons(width: float, height: float, leg: float) -> list[np.ndarray]:
    """The twelve chamfers of a box, each in three parts."""
    half = np.array([width, width, height]) / 2
    middle = np.array([0.0, 0.0, half[2]])
    return [
        middle + part
        for along in range(3)
        for signs in itertools.product((-1.0, 1.0), (-1.0, 1.0))
        for part in _hexagon(half, along, signs, leg)
    ]


def _hexagon(half, along: int, signs: tuple[float, float], leg: float) -> list[np.ndarray]:
    """One chamfer as its rectangle and the triangles at its two ends.

    So `kernel.scene_model` gets the fewest flat faces. The box of these half widths is centred
    on the origin; the edge runs along an axis and lies on the given sides of the two others.
    """
    one, other = (axis for axis in range(3) if axis != along)
    outwards = np.zeros(3)
    outwards[[one, other]] = signs

    def point(end: float, inset_one: float, inset_other: float, inset_end: float):
        inset, side = np.zeros(3), outwards.copy()
        inset[[one, other, along]], side[along] = (inset_one, inset_other, inset_end), end
        return side * (half - inset)

    (a, b), (d, c) = ((point(end, 0, leg, leg), point(end, leg, 0, leg)) for end in (-1.0, 1.0))
    low, high = (point(end, leg / 2, leg / 2, leg / 2) for end in (-1.0, 1.0))
    parts = []
    for part in map(np.array, ((a, b, c, d), (a, b, low), (c, d, high))):
        faces_outwards = np.cross(part[1] - part[0], part[2] - part[0]) @ outwards > 0
        parts.append(part if faces_outwards else part[::-1])
    return parts


mi.register_shape("chamfers", Chamfers)
