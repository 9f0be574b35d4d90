"""What form a volume has, in words: a box, a cylinder, a prism, a pyramid; of others the size."""

from __future__ import annotations

import numpy as np

from mcrim_mitsuba.transport.convex import Solid, convex_solids
from mcrim_mitsuba.transport.scene_model import SceneModel

#: Names of regular prisms and pyramids by the number of their sides.
_BY_SIDES = {4: "square", 6: "hexagonal", 8: "octagonal"}
#: What is alike to this part of the size is the same: positions are of single precision.
_ALIKE = 1e-5
#: A cylinder that is lower than this part of its diameter is a disc.
_FLAT = 0.1


def form_of(model: SceneModel, volume: int) -> str:
    """Form and size of a volume, such as ``cylinder of 10 mm diameter, 20 mm high``.

    Of one that has no name here, and of a box, the widths along x, y and z.
    """
    lower, upper = model.bounds(volume)
    return named_form(model, volume) or " x ".join(f"{v:.4g}" for v in upper - lower) + " mm"


def named_form(model: SceneModel, volume: int) -> str | None:
    """Form and size of a cylinder, a prism or a pyramid; ``None`` of any other volume."""
    solid = next((solid for solid in convex_solids(model) if solid.volume == volume), None)
    if solid is None:
        return None
    if solid.circle is None:
        return _prism(model, solid)
    lower, upper = model.bounds(volume)
    return _cylinder(solid, upper - lower)


def _cylinder(solid: Solid, sizes: np.ndarray) -> str:
    assert solid.circle is not None
    axis, diameter = solid.circle.axis, 2.0 * solid.circle.radius_mm
    length = float(sizes[axis])
    if axis != 2:
        words = f"cylinder of {diameter:.4g} mm diameter, {length:.4g} mm long"
        return f"{words}, lying along {'xyz'[axis]}"
    if length < _FLAT * diameter:
        return f"disc of {diameter:.4g} mm diameter, {length:.4g} mm thick"
    return f"cylinder of {diameter:.4g} mm diameter, {length:.4g} mm high"


def _prism(model: SceneModel, solid: Solid) -> str | None:
    """An upright regular prism (a box too) or pyramid of an even number of sides, or ``None``."""
    ends: dict[bool, np.ndarray] = {}
    leaning = []
    for plane in solid.planes:
        x, y, z = plane.axis
        corners = np.concatenate([model.flat_faces[number].corners for number in plane.faces])
        if (x, y) == (0.0, 0.0):
            ends[plane.high == (z > 0.0)] = corners
        else:
            leaning.append((bool(z), corners))
    foot = ends.get(False)
    every = np.concatenate([corners for _, corners in leaning])
    if foot is None or len(leaning) % 2:
        return None
    size, sides = np.ptp(every, axis=0).max(), len(leaning)
    upright = not any(leans for leans, _ in leaning)
    if upright and sides == 4:
        return None
    top = ends.get(True)
    if top is None:
        tip = every[every[:, 2] >= every[:, 2].max() - _ALIKE * size]
        if np.ptp(tip, axis=0).max() > _ALIKE * size:
            return None
        top = tip
    across = [_across_flats(corners, sides, size) for corners in (foot, top)]
    if across[0] is None or across[1] is None:
        return None
    kind, height = _BY_SIDES.get(sides, f"{sides}-sided"), f"{np.ptp(every[:, 2]):.4g} mm high"
    flats = "wide" if sides == 4 else "across flats"
    if upright:
        return f"{kind} prism, {across[0]:.4g} mm {flats}, {height}"
    if abs(across[0] - across[1]) <= _ALIKE * size:
        return None
    if across[1] == 0.0:
        return f"{kind} pyramid, {across[0]:.4g} mm {flats}, {height}"
    widths = f"{across[0]:.4g} mm {flats} below and {across[1]:.4g} mm above"
    return f"cut {kind} pyramid, {widths}, {height}"


def _across_flats(corners: np.ndarray, sides: int, size: float) -> float | None:
    """Width across flats of the regular polygon that these make up in a plane; 0 of a point."""
    points = corners[:, :2]
    if np.ptp(points, axis=0).max() <= _ALIKE * size:
        return 0.0
    from scipy.spatial import ConvexHull  # slow, and most scenes need none

    around = points[ConvexHull(points).vertices]
    away = np.linalg.norm(around - (around.min(axis=0) + around.max(axis=0)) / 2, axis=1)
    edges = np.linalg.norm(around - np.roll(around, 1, axis=0), axis=1)
    regular = len(around) == sides and max(np.ptp(away), np.ptp(edges)) <= 10.0 * _ALIKE * size
    return float(2.0 * away[0] * np.cos(np.pi / sides)) if regular else None
