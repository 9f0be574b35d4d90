"""Shape plugin ``panel``: a rectangle that may be trimmed all around or cut in two."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.flat_mesh import cut_fraction, is_there, rectangle, set_polygons

KEEP = ("beyond", "before")


class Panel(mi.Mesh):
    """A rectangle of x and y from -1 to 1, as Mitsuba's own, of which a part may be left out.

    XML: ``<shape type="panel">`` with

    ``to_world`` : transform
        It may scale, rotate and move, but not shear.
    ``trim`` : float, default 0
        What is cut off from each of the four edges, in the scene's millimetres.
    ``cut`` : float f, default 0
        The line x = -W/2 + f W cuts the panel in two; W is its full width along its own x axis.
    ``keep`` : string, default ``beyond``
        Which part stays: ``beyond`` the line (greater x) or ``before`` it.
    ``index`` : float, optional
        Index of what lies beyond the line; where it is that of air, nothing is cut (f = 0).
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        cut, keep = cut_fraction(props), str(props.get("keep", KEEP[0]))
        trim = float(props.get("trim", 0.0))
        to_world = props.get("to_world", mi.ScalarTransform4f())
        matrix = np.array(to_world.matrix, dtype=np.float64)
        width, depth = 2.0 * np.linalg.norm(matrix[:3, :2], axis=0)
        if keep not in KEEP:
            raise ValueError(f"a panel's keep is {keep!r}; give {' or '.join(KEEP)}")
        if not min(width, depth) > 0.0:
            raise ValueError("a panel has no area: look for a scale of 0 in its transform")
        if not 0.0 <= trim < min(width, depth) / 2:
            raise ValueError(
                f"a panel's trim ({trim:g}) must be positive or 0, and less than half of its "
                f"width and height ({width:g} x {depth:g})"
            )
        self.size = (width, depth, trim, cut, keep)
        low, high = trim / width, 1.0 - trim / width
        low, high = (max(low, cut), high) if keep == "beyond" else (low, min(high, cut))
        corners = 2.0 * rectangle((low, high), (trim / depth, 1.0 - trim / depth))
        corners = corners - (1.0, 1.0, 0.0)
        set_polygons(self, [corners] if is_there(low, high, 1.0) else [], to_world)

    def to_string(self) -> str:
        return "Panel[{:g} x {:g}, trim = {:g}, cut = {:g}, keep = {}]".format(*self.size)


mi.register_shape("panel", Panel)
