"""A block cut out of a bench around the lower edge of its crystal, much enlarged."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.cut import CrossSection, Trace, cross_section, masked
from mcrim_mitsuba.transport.photograph_bodies import GLOSSY, MATTE, Body, Finish, Triangles
from mcrim_mitsuba.transport.photograph_parts import BLACK, RED, STEEL, grey_of

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.bulk import CrystalVolume
    from mcrim_mitsuba.transport.scene_model import SceneModel

#: Colours of the cut volumes, in their order: linear red, green and blue.
_COLOURS = (
    (0.20, 0.42, 0.66),
    (0.93, 0.56, 0.07),
    (0.42, 0.66, 0.44),
    (0.72, 0.36, 0.26),
    (0.40, 0.28, 0.55),
    (0.26, 0.52, 0.50),
)
#: Width and depth of the block over its height.
WIDE, DEEP = 2.2, 0.5
#: The thinnest layer's part of the block's height.
_SHARE = 0.3
#: Thickness of masks, detectors and reflectors over the block's height.
_SHEET = 0.025


@dataclass(frozen=True)
class Layer:
    """What lies above each other under the crystal."""

    #: Index among ``model.volumes``.
    volume: int
    #: ``None`` where it goes on outside the block.
    thickness_mm: float | None
    #: ndarray, shape (2, 3): Its lower and upper end at the left of the cut, in units of the block.
    edge: np.ndarray


@dataclass(frozen=True, eq=False)
class Block:
    """What is cut out, moved to the origin and enlarged so that it is 1 high."""

    bodies: tuple[Body, ...]
    #: ndarray, shape (8, 3): The corners of its box.
    points: np.ndarray
    #: Lowest first.
    layers: tuple[Layer, ...]
    #: dict of str to ndarray, shape (3,): The masks, detectors and reflectors that are seen: a
    #: point on each, by name.
    sheets: dict[str, np.ndarray]
    #: ndarray, shape (3,): Where the origin lies in the scene.
    centre_mm: np.ndarray
    height_mm: float


def lower_edge(model: SceneModel, crystal: CrystalVolume, indices: Mapping[str, float]) -> Block:
    """Cut a block out around the lower edge of the crystal, at the right of its middle plane.

    `indices` are those of the volumes by their names.
    """
    from mcrim_mitsuba.transport.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, OUTSIDE

    y = float(crystal.lower[1] + crystal.upper[1]) / 2
    cut = cross_section(model, y)
    outline, size = cut.corners(crystal.volume), float(np.ptp(cut.corners(crystal.volume)))
    bottom = float(outline[:, 1].min())
    x = float(outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max())
    below = cut.levels(x - 1e-3 * size, 0)
    below = below[below < bottom - 1e-4 * size]
    gap = bottom - float(below[-1]) if len(below) else 0.03 * size
    height = min(gap / _SHARE, 2.0 * size)
    centre = np.array([x - 0.12 * WIDE * height, y, bottom - gap / 2])

    def scaled(x_and_z: ArrayLike) -> np.ndarray:
        return (np.asarray(x_and_z) - centre[[0, 2]]) / height

    bodies = []
    for region in cut.regions:
        name = model.volumes[region.volume].name
        if name not in indices or is_filled(indices[name]):
            low, high = np.split(scaled(region.outline), 2)
            finish = Finish(GLOSSY, _COLOURS[(region.volume - 1) % len(_COLOURS)])
            bodies += _extruded(low, high[::-1], finish)
    sheets: dict[str, np.ndarray] = {}

    def add_sheet(trace: Trace, side: ArrayLike, finish: Finish, name: str) -> None:
        made = _sheet(scaled(trace.points), _SHEET * np.asarray(side), finish)
        if made is not None:
            sheets[name], body = made
            bodies.append(body)

    for trace in cut.traces:
        surface = model.surfaces[trace.surface]
        if surface.kind != DIELECTRIC:
            colour = {DETECTOR: RED, DIFFUSE: grey_of(surface)}
            side = trace.back if surface.interior == OUTSIDE else -trace.back
            add_sheet(trace, side, Finish(MATTE, colour.get(surface.kind, STEEL)), surface.name)
    for trace in masked(model, cut):
        add_sheet(trace, (0.0, 1.0), Finish(GLOSSY, BLACK), "mask")
    signs = list(itertools.product((-1, 1), (0, 1), (-1, 1)))
    points = np.array([WIDE / 2, DEEP, 0.5]) * signs
    layers = _layers(cut, centre, height, bottom)
    return Block(tuple(bodies), points, layers, sheets, centre, height)


def _layers(
    cut: CrossSection, centre: np.ndarray, height: float, bottom: float
) -> tuple[Layer, ...]:
    """The layers at the left of a block."""
    at = centre[0] - 0.3 * WIDE * height
    low, high = centre[2] - height / 2, centre[2] + height / 2
    levels = cut.levels(at, 0)
    levels = np.array([low, *levels[(levels > low) & (levels < high)], high])
    found = []
    for a, b in pairwise(levels):
        whole = a > low and b < high
        left = np.array([[-WIDE / 2, 0.0, (z - centre[2]) / height] for z in (a, b)])
        volume = _volume_at(cut, at, (a + b) / 2)
        if whole or volume:
            found.append(Layer(volume, float(b - a) if whole else None, left))
    return tuple(found)


def _volume_at(cut: CrossSection, x: float, z: float) -> int:
    """The volume at a point of the cut; 0 is air outside."""
    for region in cut.regions:
        low, high = np.split(region.outline, 2)
        high = high[::-1]
        if low[0, 0] <= x <= low[-1, 0] and np.interp(x, *low.T) <= z <= np.interp(x, *high.T):
            return region.volume
    return 0


def _extruded(low: np.ndarray, high: np.ndarray, finish: Finish) -> list[Body]:
    """What lies between two lines of equal x (shape (n, 2)) within the block, made solid."""
    ends = np.clip(low[[0, -1], 0], -WIDE / 2, WIDE / 2)
    if ends[1] - ends[0] < 1e-6:
        return []
    x = np.unique([*ends, *low[(low[:, 0] > ends[0]) & (low[:, 0] < ends[1]), 0]])
    bottom, top = (np.clip(np.interp(x, *line.T), -0.5, 0.5) for line in (low, high))
    if not (top - bottom > 1e-6).any():
        return []
    return [Body(_prism(np.column_stack([x, bottom]), np.column_stack([x, top])), finish)]


def _sheet(points: np.ndarray, aside: np.ndarray, finish: Finish) -> tuple[np.ndarray, Body] | None:
    """A line (shape (n, 2)) within the block, made a sheet that reaches `aside`; a point of it."""
    reach = np.array([WIDE / 2, 0.5])
    across = int(np.ptp(points, axis=0).argmin())
    inside = np.clip(points, -reach, reach)
    outside = np.abs(points[:, across]).min() > reach[across]
    if outside or np.ptp(inside[:, 1 - across]) < 1e-6:
        return None
    x, z = inside[np.argmax(inside.sum(axis=1))] + aside / 2
    # a little before the cut, so that it is not hidden in what it lies on
    body = Body(_prism(inside, inside + aside, front=-0.5 * _SHEET), finish)
    return np.array([x, 0.0, z]), body


def _prism(one: np.ndarray, other: np.ndarray, front: float = 0.0) -> Triangles:
    """The band between two lines of as many points (x and z, shape (n, 2)), DEEP deep."""

    def at(line: np.ndarray, y: float) -> np.ndarray:
        return np.column_stack([line[:, 0], np.full(len(line), y), line[:, 1]])

    near, far = (np.stack([at(one, y), at(other, y)]) for y in (front, DEEP))
    quads = []
    for i in range(len(one) - 1):
        quads.append((near[0, i], near[0, i + 1], near[1, i + 1], near[1, i]))
        quads += [(near[k, i], near[k, i + 1], far[k, i + 1], far[k, i]) for k in (0, 1)]
    quads += [(near[0, i], near[1, i], far[1, i], far[0, i]) for i in (0, -1)]
    return Triangles(np.array([t for q in quads for t in (q[:3], (q[0], q[2], q[3]))]))
