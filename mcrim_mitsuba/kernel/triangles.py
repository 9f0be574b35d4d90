"""The surfaces of a scene in triangles, for pictures."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.scene_model import SceneModel
from mcrim_mitsuba.picture.view import Triangles

#: Steps along each of the two coordinates of a curved surface.
STEPS = 96


def surface_triangles(model: SceneModel) -> tuple[Triangles, ...]:
    """The triangles of every surface, in the order of ``model.surfaces``.

    Raises
    ------
    InputError
        For a curved shape of which Mitsuba knows no points.
    """
    flat: dict[int, list[np.ndarray]] = {}
    for face in model.flat_faces:
        a, b, d = face.corner, face.corner + face.edge_u, face.corner + face.edge_v
        own = [(a, b, d)] if face.triangle else [(a, b, b + face.edge_v), (a, b + face.edge_v, d)]
        flat.setdefault(face.surface, []).extend(np.array(own))
    return tuple(
        Triangles(np.array(flat[number])) if number in flat else _curved(shape)
        for number, shape in enumerate(model.shapes)
    )


def _curved(shape) -> Triangles:
    """The triangles of a shape that is no set of few flat faces."""
    if shape.is_mesh():
        return _of_mesh(shape)
    u = np.linspace(0.0, 1.0, STEPS + 1)
    # closer towards the ends, which are the poles of a sphere
    v = (1.0 - np.cos(np.pi * u)) / 2
    grid_u, grid_v = (g.ravel() for g in np.meshgrid(u, v, indexing="ij"))
    try:
        samples = shape.sample_position(0.0, mi.Point2f(grid_u.tolist(), grid_v.tolist()))
        points = np.array(samples.p, dtype=float).T.reshape(STEPS + 1, STEPS + 1, 3)
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{shape.id()}: no picture can be made of a {shape.class_name()} "
            f"({str(error).splitlines()[0]})",
            "write the shape as a mesh",
        ) from None
    normals = np.broadcast_to(np.array(samples.n, dtype=float), (3, grid_u.size))
    normals = normals.T.reshape(points.shape)
    corners, towards = (
        np.concatenate(
            [
                np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:]], axis=2).reshape(-1, 3, 3),
                np.stack([grid[:-1, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 3, 3),
            ]
        )
        for grid in (points, normals)
    )
    return _orderly(corners, towards)


def _of_mesh(shape) -> Triangles:
    parameters = mi.traverse(shape)
    indices = np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3)
    corners = np.array(parameters["vertex_positions"], dtype=float).reshape(-1, 3)[indices]
    if shape.has_flipped_normals():
        corners = corners[:, ::-1]
    return _orderly(corners, None)


def _orderly(corners, normals) -> Triangles:
    """Without triangles of no area, and all anticlockwise about their normals."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    kept = area > 1e-9 * area.max()
    corners, across = corners[kept], across[kept]
    if normals is None:
        return Triangles(corners)
    normals = normals[kept]
    turned = (across * normals.sum(axis=1)).sum(axis=1) < 0
    corners[turned], normals[turned] = corners[turned, ::-1], normals[turned, ::-1]
    return Triangles(corners, normals)
