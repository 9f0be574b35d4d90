"""Shape plugin ``frame``: a flat square with a square hole, as one surface."""

from __future__ import annotations

import mitsuba as mi
import numpy as np


class Frame(mi.Mesh):
    """Square frame in the plane z = 0 of its own coordinates, normal along +z.

    The window's entrance face beside the crystal is such a surface: the part
    under the crystal is another interface. XML: ``<shape type="frame">`` with

    ``outer_width``, ``inner_width`` : float
        Edge lengths in the scene's millimetres; the outer is the longer one.
    ``to_world`` : transform
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        outer, inner = float(props["outer_width"]), float(props["inner_width"])
        to_world = props.get("to_world", mi.ScalarTransform4f())
        if not outer > inner > 0.0:
            raise ValueError(
                f"a frame's outer_width ({outer:g}) must exceed its inner_width ({inner:g})"
            )
        self.outer_width, self.inner_width = outer, inner
        matrix = np.array(to_world.matrix, dtype=np.float64)
        # Four rectangles around the hole, each a quarter turn from the last: rectangles
        # are what the transport tests fastest.
        o, i = outer / 2, inner / 2
        quad = np.array([(-o, i), (i, i), (i, o), (-o, o)])
        quarter_turn = np.array([(0.0, -1.0), (1.0, 0.0)])
        corners = np.vstack([quad @ np.linalg.matrix_power(quarter_turn, k) for k in range(4)])
        corners = np.column_stack([corners, np.zeros(16), np.ones(16)]) @ matrix.T
        triangles = [(4 * k, 4 * k + a, 4 * k + a + 1) for k in range(4) for a in (1, 2)]
        parameters = mi.traverse(self)
        parameters["vertex_positions"] = mi.Float(corners[:, :3].ravel())
        parameters["faces"] = mi.UInt32(np.ravel(triangles))
        parameters.update()

    def to_string(self) -> str:
        return f"Frame[outer_width = {self.outer_width}, inner_width = {self.inner_width}]"


mi.register_shape("frame", Frame)
