"""Straight lines through a scene: which faces they cross, in which order, from which side."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.kernel.scene_model import SceneModel

#: Lines that pass closer than this (relative to the scene's size) to a face's rim are left out:
#: there rounding of single precision positions decides which of two faces is met.
RIM = 1e-6
#: Crossings followed along one line of a scene with curved faces.
MOST_CROSSINGS = 64


@dataclass(frozen=True)
class Crossings:
    """Crossings of lines with faces, one row per line, ordered along it.

    Attributes
    ----------
    surface : ndarray of int, shape (lines, crossings)
        Index among ``model.surfaces``; -1 after the last crossing.
    from_behind : ndarray of bool, same shape
        Whether the line comes from the interior side.
    distance : ndarray of float64, same shape
        Distance from the line's start in mm; infinite after the last crossing.
    origin, direction : ndarray of float64, shape (lines, 3)
    """

    surface: np.ndarray
    from_behind: np.ndarray
    distance: np.ndarray
    origin: np.ndarray
    direction: np.ndarray

    def point(self, line, crossing) -> np.ndarray:
        """Position (mm) of a crossing."""
        return self.origin[line] + self.distance[line, crossing] * self.direction[line]


def probe_lines(model: SceneModel, seed: int = 0, per_shape: int = 1500):
    """Lines that come from outside and go through all parts of a scene.

    Half of a flat face's lines aim close to its rim, where faces that should meet may not.

    Returns
    -------
    origin, direction : ndarray of float64, shape (lines, 3)
    """
    rng = np.random.default_rng(seed)
    targets = []
    for shape in model.shapes:
        box = shape.bbox()
        lower, upper = np.array(box.min, dtype=float), np.array(box.max, dtype=float)
        targets.append(lower + (upper - lower) * rng.random((per_shape, 3)))
    faces = model.faces or ()
    of_shape = Counter(face.surface for face in faces)
    for face in faces:
        # a shape of many faces, such as chamfers, needs no more lines than a few large ones do
        along = rng.random((per_shape // max(2, of_shape[face.surface] // 2), 2))
        side = rng.integers(0, 4, len(along))
        across = 1e-3 * rng.standard_normal(len(along))
        a = np.choose(side, [across, 1 + across, along[:, 0], along[:, 0]])
        b = np.choose(side, [along[:, 1], along[:, 1], across, 1 + across])
        targets.append(face.corner + a[:, None] * face.edge_u + b[:, None] * face.edge_v)
    target = np.concatenate(targets)
    direction = rng.standard_normal(target.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return target - 4.0 * model.size_mm * direction, direction


def trace_crossings(model: SceneModel, origin, direction) -> Crossings:
    """All crossings of the lines, exactly for flat faces, by Mitsuba's intersection otherwise."""
    if model.faces is not None:
        return _through_flat_faces(model, origin, direction)
    return _through_any_shapes(model, origin, direction)


def _through_flat_faces(model, origin, direction) -> Crossings:
    distance = np.full((len(origin), len(model.faces)), np.inf)
    behind = np.zeros(distance.shape, dtype=bool)
    ambiguous = np.zeros(len(origin), dtype=bool)
    for number, face in enumerate(model.faces):
        towards = direction @ face.normal
        behind[:, number] = towards > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (face.corner @ face.normal - origin @ face.normal) / towards
            dual = np.linalg.inv(np.column_stack([face.edge_u, face.edge_v, face.normal]))
            a, b = (origin @ v + t * (direction @ v) - face.corner @ v for v in dual[:2])
            margin = np.minimum(a, b)
            margin = np.minimum(margin, 1 - a - b if face.triangle else 1 - np.maximum(a, b))
        rim = RIM * model.size_mm / min(np.linalg.norm(face.edge_u), np.linalg.norm(face.edge_v))
        ambiguous |= np.abs(margin) <= rim
        distance[:, number] = np.where((margin > 0) & (t > 0), t, np.inf)
    origin, direction = origin[~ambiguous], direction[~ambiguous]
    distance, behind = distance[~ambiguous], behind[~ambiguous]
    order = np.argsort(distance, axis=1, kind="stable")
    distance = np.take_along_axis(distance, order, axis=1)
    most = max(int(np.isfinite(distance).sum(axis=1).max()), 1)
    distance, order = distance[:, :most], order[:, :most]
    surface_of = np.array([face.surface for face in model.faces])
    surface = np.where(np.isfinite(distance), surface_of[order], -1)
    from_behind = np.take_along_axis(behind, order, axis=1)
    return Crossings(surface, from_behind, distance, origin, direction)


def _through_any_shapes(model, origin, direction) -> Crossings:
    import drjit as dr
    import mitsuba as mi

    from mcrim_mitsuba.kernel.scene_model import surface_numbers

    number_of = surface_numbers(model)
    start = mi.Point3f(origin.T.astype(np.float32))
    along = mi.Vector3f(direction.T.astype(np.float32))
    ray, columns = mi.Ray3f(start, along), []
    alive = np.ones(len(origin), dtype=bool)
    for _ in range(MOST_CROSSINGS):
        si = model.scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=False)
        hit = si.is_valid()
        number = number_of(si.shape, hit)
        reached = dr.dot(si.p - start, along)
        behind = dr.dot(si.n, along) > 0
        ray = si.spawn_ray(along)
        dr.eval(hit, number, reached, behind, ray)
        # a line that has left has no position to go on from
        alive = alive & np.array(hit)
        columns.append(
            (
                np.where(alive, np.array(number).astype(int), -1),
                np.array(behind),
                np.where(alive, np.array(reached, dtype=float), np.inf),
            )
        )
        if not alive.any():
            break
    surface, behind, distance = (np.stack(rows, axis=1) for rows in zip(*columns, strict=True))
    return Crossings(surface, behind, distance, origin, direction)
