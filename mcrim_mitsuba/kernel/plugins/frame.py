"""Shape plugin ``frame``: a flat square with a square hole, as one surface."""

from __future__ import annotations

import mitsuba as mi

from mcrim_mitsuba.kernel.flat_mesh import cut_fraction, is_there, rectangle, set_polygons


class Frame(mi.Mesh):
    """Square frame in the plane z = 0 of its own coordinates, normal along +z.

    The window's entrance face beside the crystal is such a surface: the part
    under the crystal is another interface. XML: ``<shape type="frame">`` with

    ``outer_width`` : float
        Outer edge length in the scene's millimetres.
    ``inner_width`` or ``rim`` : float
        Edge length of the hole, or width of the frame itself; a rim of 0 is no frame at all.
    ``cut`` : float f, default 0
        What lies at x < -W/2 + f W is left out, W being the outer width.
    ``index`` : float, optional
        Index of what fills the space beside the cut; where it is that of air, nothing is cut.
    ``to_world`` : transform
        Where it stands in the scene.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        outer, cut = float(props["outer_width"]), cut_fraction(props)
        if ("inner_width" in props) == ("rim" in props):
            raise ValueError("a frame has either an inner_width or a rim")
        if "rim" in props:
            rim = float(props["rim"])
            if not 0.0 <= rim < outer / 2:
                raise ValueError(
                    f"a frame's rim ({rim:g}) must be positive or 0, and less than half of its "
                    f"outer_width ({outer:g})"
                )
            inner = outer - 2 * rim
        else:
            inner = float(props["inner_width"])
            if not outer > inner > 0.0:
                raise ValueError(
                    f"a frame's outer_width ({outer:g}) must exceed its inner_width ({inner:g})"
                )
        self.outer_width, self.inner_width = outer, inner
        # Four rectangles around the hole, each a quarter turn from the last: rectangles
        # are what the transport tests fastest.
        o, i = outer / 2, inner / 2
        sides = [((-o, i), (i, o)), ((-o, -i), (-o, i)), ((-i, o), (-o, -i)), ((i, o), (-i, o))]
        start = cut * outer - o
        sides = [((max(x[0], start), x[1]), y) for x, y in sides]
        set_polygons(
            self,
            [rectangle(x, y) for x, y in sides if is_there(*x, outer) and is_there(*y, outer)],
            props.get("to_world", mi.ScalarTransform4f()),
        )

    def to_string(self) -> str:
        return f"Frame[outer_width = {self.outer_width}, inner_width = {self.inner_width}]"


mi.register_shape("frame", Frame)
