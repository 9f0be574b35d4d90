"""Shape plugin ``gap_sides``: the four thin sides of the gap under a crystal."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.flat_mesh import cut_fraction, is_there, set_polygons


class GapSides(mi.Mesh):
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
    ``to_world`` : transform
        Where it stands in the scene.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        width, cut = float(props["width"]), cut_fraction(props)
        nominal = float(props["thickness"])
        thickness = nominal + float(props.get("thickness_offset", 0.0))
        if not width > 0.0:
            raise ValueError(f"the gap's width is {width:g}; it must be positive")
        if not thickness > 0.0:
            raise ValueError(
                f"the gap's thickness is {nominal:g} and {thickness:g} with its offset; "
                "it must be positive"
            )
        self.size = (width, thickness, cut)
        a, start = width / 2, cut * width - width / 2
        ring = [(start, -a), (a, -a), (a, a), (start, a)]
        walls = [
            np.array([(*one, -thickness), (*other, -thickness), (*other, 0.0), (*one, 0.0)])
            for one, other in zip(ring, ring[1:] + ring[:1], strict=True)
        ]
        to_world = props.get("to_world", mi.ScalarTransform4f())
        set_polygons(self, walls if is_there(start, a, width) else [], to_world)

    def to_string(self) -> str:
        return "GapSides[width = {:g}, thickness = {:g}, cut = {:g}]".format(*self.size)


mi.register_shape("gap_sides", GapSides)
