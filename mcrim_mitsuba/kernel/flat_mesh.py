"""Meshes of a few flat polygons: what the geometric plugins of a bench are made of."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.kernel.filling import is_filled

#: What is narrower than this part of the whole is rounding of single precision: not there.
NARROWEST = 1e-6


def set_polygons(mesh, polygons: Sequence, to_world) -> None:
    """Fill a mesh (`mitsuba.Mesh`) with flat polygons.

    Sets ``mesh.empty``: whether there are none. Mitsuba knows no mesh without triangles, so an
    empty one has a single triangle without area, which no ray hits; `kernel.scene_model` leaves
    such shapes out.

    Parameters
    ----------
    mesh : mitsuba.Mesh
    polygons : sequence of array_like, shape (corners, 3)
        Convex, in mm of the shape's own coordinates; anticlockwise as seen from the side that
        the normal points to.
    to_world : mitsuba.ScalarTransform4f
    """
    mesh.empty = not polygons
    if mesh.empty:
        polygons = [np.zeros((3, 3))]
    corners = np.concatenate([np.asarray(polygon, dtype=np.float64) for polygon in polygons])
    matrix = np.array(to_world.matrix, dtype=np.float64)
    corners = np.column_stack([corners, np.ones(len(corners))]) @ matrix.T
    triangles, first = [], 0
    for polygon in polygons:
        count = len(polygon)
        triangles += [(first, first + i, first + i + 1) for i in range(1, count - 1)]
        first += count
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(corners[:, :3].ravel())
    parameters["faces"] = mi.UInt32(np.ravel(triangles))
    parameters.update()


def rectangle(x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
    """The corners of a rectangle in the plane z = 0, normal along +z."""
    return np.array([(x[0], y[0], 0.0), (x[1], y[0], 0.0), (x[1], y[1], 0.0), (x[0], y[1], 0.0)])


def is_there(low: float, high: float, whole: float) -> bool:
    """Whether what lies between two coordinates is more than rounding of a whole width."""
    return high - low > NARROWEST * whole


def cut_fraction(props) -> float:
    """The part of a width that is cut off at the side of low x: where a bubble of air is.

    ``cut`` of the shape (0 when absent); 0 too where the shape's ``index``, that of what fills
    the rest, is that of air.

    Raises
    ------
    ValueError
        If it is not between 0 and 1.
    """
    cut = float(props.get("cut", 0.0))
    if not 0.0 <= cut <= 1.0:
        raise ValueError(f"cut is {cut:g}; give a fraction, 0 to 1")
    filled = "index" not in props or is_filled(float(props["index"]))
    return cut if filled else 0.0
