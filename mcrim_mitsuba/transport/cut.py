"""Cuts a loaded scene with a vertical plane: which volume lies where, and which faces it meets.

Only indices come from the scene's text: lines traced in the cutting plane say which volume
lies where, so that boxes, spheres and meshes are treated alike. `cross_section` is the whole cut;
`lower_edge` a block around the lower edge of the crystal, much enlarged, to be photographed.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.transport.photograph_parts import (
    BLACK,
    GLOSSY,
    MATTE,
    RED,
    STEEL,
    Body,
    Finish,
    Triangles,
    grey_of,
)
from mcrim_mitsuba.transport.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, OUTSIDE, SceneModel
from mcrim_mitsuba.transport.volume_consistency import trace_crossings

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.bulk import CrystalVolume

#: Lines per direction, before the places where neighbours differ are looked at more closely.
LINES = 400
#: How closely such a place is located, relative to the scene's size.
FINEST = 3e-6
#: The plane is moved by so much of it: lines along mesh edges are left out (`crossings.RIM`).
ASIDE = 1e-5


@dataclass(frozen=True)
class Region:
    """A part of a volume: a polygon, float64, shape (2 n, 2), x and z in mm, n corners below."""

    volume: int
    outline: np.ndarray


@dataclass(frozen=True)
class Trace:
    """The line along which the plane cuts a face: float64, shape (n, 2), x and z in mm."""

    surface: int
    points: np.ndarray
    back: np.ndarray  # unit vector along x or z to the side that the normal points away from


@dataclass(frozen=True)
class CrossSection:
    """What the plane ``y = y_mm`` of a scene shows; what no region fills is air."""

    y_mm: float
    regions: tuple[Region, ...]
    traces: tuple[Trace, ...]

    def area(self, volume: int) -> float:
        """Area (mm2) of a volume, given by its index among ``model.volumes``."""
        rings = [r.outline.T for r in self.regions if r.volume == volume]
        return sum(abs(float(x @ (np.roll(z, -1) - np.roll(z, 1)))) / 2 for x, z in rings)

    def corners(self, volume: int) -> np.ndarray:
        """Corners of a volume that the plane cuts, shape (n, 2), x and z in mm."""
        return np.concatenate([r.outline for r in self.regions if r.volume == volume])

    def levels(self, at: float, axis: int) -> np.ndarray:
        """z of the flat faces at some x (`axis` 0), or x of the steep ones at some z (1), mm."""
        lines = [trace.points for trace in self.traces if trace.back[axis] == 0]
        lines = [line for line in lines if line[0, axis] <= at <= line[-1, axis]]
        return np.unique([np.interp(at, line[:, axis], line[:, 1 - axis]) for line in lines])


#: What a line meets: surfaces, whether each from behind, and where.
_Met = tuple[list[int], list[bool], np.ndarray]


def cross_section(model: SceneModel, y_mm: float) -> CrossSection:
    """Cut a loaded scene (`scene_model.SceneModel`) with the vertical plane ``y = y_mm``."""
    regions, traces = [], []
    for along in (2, 0):
        for positions, coords, surfaces, behind in _sweep(model, y_mm, along):
            lines = [np.column_stack([positions, c] if along else [c, positions]) for c in coords.T]
            for surface, front, coord, line in zip(surfaces, behind, coords.T, lines, strict=True):
                # lines show those parts best that are nearly perpendicular to them; rounding
                # must not decide where a face, such as a chamfer, lies at 45 degrees
                rise, step = np.abs(np.diff(coord)), np.diff(positions)
                keep = np.flatnonzero(rise <= 1.01 * step if along else 1.01 * rise < step)
                parts = np.split(keep, np.flatnonzero(np.diff(keep) > 1) + 1)
                back = np.roll([-1.0 if front else 1.0, 0.0], along // 2)
                traces += [Trace(surface, line[p[0] : p[-1] + 2], back) for p in parts if len(p)]
            sides = [(model.surfaces[s].exterior, model.surfaces[s].interior) for s in surfaces]
            sides = [s[::-1] if b else s for s, b in zip(sides, behind, strict=True)]
            for i, ((_, volume), (same, _)) in enumerate(pairwise(sides if along else ())):
                if volume == same != 0:  # if faces disagree nothing is filled: see `check_scene`
                    regions.append(Region(volume, np.vstack([lines[i], lines[i + 1][::-1]])))
    return CrossSection(y_mm, tuple(regions), tuple(traces))


def _sweep(model: SceneModel, y_mm: float, along: int) -> Iterator[tuple]:
    """Runs of neighbouring parallel lines (`along` 2: vertical, 0: horizontal) that meet the same.

    For each: x of vertical or z of horizontal lines, shape (lines,), and z or x of their crossings,
    (lines, crossings), in mm; surfaces and sides of these, as in `volume_consistency.Crossings`.
    """
    across, tolerance = 2 - along, FINEST * model.size_mm
    boxes = [shape.bbox() for shape in model.shapes]
    edges = np.array([(box.min[across], box.max[across]) for box in boxes]).ravel()
    pending = np.linspace(edges.min(), edges.max(), LINES + 2)[1:-1]
    # edges show what is thinner than the distance of these lines
    pending = np.concatenate([pending, *(edges + k * tolerance for k in (-9, -3, 3, 9))])
    crossed_by: dict[float, _Met] = {}
    rng = np.random.default_rng(0)
    for _ in range(20):
        crossed_by |= _lines(model, y_mm + ASIDE * model.size_mm, along, pending)
        places = sorted(crossed_by)
        changes = [(a, b) for a, b in pairwise(places) if crossed_by[a][:2] != crossed_by[b][:2]]
        wide = [(a, b) for a, b in changes if b - a > tolerance]
        pairs = np.array([*wide, *_bends(crossed_by, places, 10 * tolerance)])
        if not len(pairs):
            break
        # Not evenly: a line that meets a rim is left out and must not be tried for ever; and with
        # one line that is known to hit: `trace_crossings` may fail where none does.
        shares = (np.arange(8) + rng.random((len(pairs), 8))) / 8
        pending = pairs[:, :1] + shares * np.ptp(pairs, axis=1, keepdims=True)
        pending = np.append(pending, next(place for place in places if crossed_by[place][0]))
    # what lies before the first change and after the last one is outside the scene
    for (before, start), (end, after) in pairwise(changes):
        if crossed_by[start][0]:
            inner = [place for place in places if start <= place <= end]
            crossed = np.array([crossed_by[place][2] for place in inner])
            coords = np.pad(crossed, ((1, 1), (0, 0)), "edge")
            positions = np.array([(before + start) / 2, *inner, (end + after) / 2])
            yield positions, coords, *crossed_by[start][:2]


def _lines(model: SceneModel, y: float, along: int, positions: np.ndarray) -> dict[float, _Met]:
    """Surfaces, sides and coordinates of the crossings of parallel lines, by position."""
    origin, direction = np.full((len(positions), 3), y), np.eye(3)[[along] * len(positions)]
    origin[:, along], origin[:, 2 - along] = -2.0 * model.size_mm, positions
    met = trace_crossings(model, origin, direction)
    met_by: dict[float, _Met] = {}
    for line, distance in enumerate(met.distance):
        count = int(np.isfinite(distance).sum())
        surfaces, behind = (s[line, :count].tolist() for s in (met.surface, met.from_behind))
        coords = met.origin[line, along] + distance[:count]
        met_by[float(met.origin[line, 2 - along])] = (surfaces, behind, coords)
    return met_by


def _bends(
    lines: Mapping[float, _Met], places: Sequence[float], tolerance: float
) -> Iterator[tuple[float, float]]:
    """Neighbouring lines between which what they meet is the same, but not straight."""
    for a, b, c in zip(places, places[1:], places[2:], strict=False):
        if lines[a][:2] == lines[b][:2] == lines[c][:2]:
            straight = lines[a][2] + (b - a) / (c - a) * (lines[c][2] - lines[a][2])
            if (np.abs(straight - lines[b][2]) > tolerance).any():
                yield from (pair for pair in ((a, b), (b, c)) if np.ptp(pair) > 3 * tolerance)


def masked(model: SceneModel, cut: CrossSection) -> list[Trace]:
    """The parts of the traces that masks, which lie more or less flat, cover."""
    parts = []
    for trace in cut.traces:
        face, line = model.surfaces[trace.surface], trace.points[trace.points[:, 0].argsort()]
        (x, y), radius = face.axis_mm, face.aperture_radius_mm
        if np.isfinite(radius):
            # rounding must not leave a speck beside a hole as wide as the face
            half = np.sqrt(max(radius**2 - (cut.y_mm - y) ** 2, 0.0)) + FINEST * model.size_mm
            for rims in ((-np.inf, x - half), (x + half, np.inf)):
                at = np.clip(line[:, 0], *rims)
                part = np.column_stack([at, np.interp(at, *line.T)])
                parts += [Trace(trace.surface, part, trace.back)] if np.ptp(at) > 0 else []
    return parts


# ---- the block around the crystal's lower edge -----------------------------------------

#: Colours of the cut volumes, in their order: linear red, green and blue.
_COLOURS = (
    (0.20, 0.42, 0.66),
    (0.93, 0.56, 0.07),
    (0.42, 0.66, 0.44),
    (0.72, 0.36, 0.26),
    (0.40, 0.28, 0.55),
    (0.26, 0.52, 0.50),
)
#: Width of the block over its height.
WIDE = 2.2
#: Depth of the block over its height.
DEEP = 0.5
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
        sheet = _sheet(scaled(trace.points), _SHEET * np.asarray(side), finish)
        if sheet is not None:
            sheets[name], body = sheet
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
    layers = []
    for a, b in pairwise(levels):
        whole = a > low and b < high
        left = np.array([[-WIDE / 2, 0.0, (z - centre[2]) / height] for z in (a, b)])
        volume = _volume_at(cut, at, (a + b) / 2)
        if whole or volume:
            layers.append(Layer(volume, float(b - a) if whole else None, left))
    return tuple(layers)


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
    # a line that leaves the block between two of its points bends there
    leaves = [_meets(line, z) for line in (low, high) for z in (-0.5, 0.5)]
    x = np.concatenate([low[:, 0], *leaves])
    x = np.unique([*ends, *x[(x > ends[0]) & (x < ends[1])]])
    bottom, top = (np.clip(np.interp(x, *line.T), -0.5, 0.5) for line in (low, high))
    if not (top - bottom > 1e-6).any():
        return []
    return [Body(_prism(np.column_stack([x, bottom]), np.column_stack([x, top])), finish)]


def _meets(line: np.ndarray, z: float) -> np.ndarray:
    """Where on the first axis a line (shape (n, 2)) crosses a height."""
    x, above = line[:, 0], line[:, 1] - z
    before = np.flatnonzero(above[:-1] * above[1:] < 0.0)
    part = above[before] / (above[before] - above[before + 1])
    return x[before] + part * (x[before + 1] - x[before])


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


def _prism(outline: np.ndarray, opposite: np.ndarray, front: float = 0.0) -> Triangles:
    """The band between two lines of as many points (x and z, shape (n, 2)), DEEP deep."""

    def at(line: np.ndarray, y: float) -> np.ndarray:
        return np.column_stack([line[:, 0], np.full(len(line), y), line[:, 1]])

    near, far = (np.stack([at(outline, y), at(opposite, y)]) for y in (front, DEEP))
    quads = []
    for i in range(len(outline) - 1):
        quads.append((near[0, i], near[0, i + 1], near[1, i + 1], near[1, i]))
        quads += [(near[k, i], near[k, i + 1], far[k, i + 1], far[k, i]) for k in (0, 1)]
    quads += [(near[0, i], near[1, i], far[1, i], far[0, i]) for i in (0, -1)]
    return Triangles(np.array([t for q in quads for t in (q[:3], (q[0], q[2], q[3]))]))
