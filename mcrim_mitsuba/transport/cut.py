"""Cuts a loaded scene with a vertical plane: which volume lies where, and which faces it meets.

Only indices come from the scene's text: lines traced in the cutting plane say which volume
lies where, so that boxes, spheres and meshes are treated alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from mcrim_mitsuba.transport.scene_model import SceneModel
from mcrim_mitsuba.transport.volume_consistency import trace_crossings

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
    """What a vertical plane of a scene shows; what no region fills is air.

    Of planes across x, `normal` 0, the places that are called x here are those along y.
    """

    level_mm: float
    regions: tuple[Region, ...]
    traces: tuple[Trace, ...]
    normal: int = 1

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


def cross_section(model: SceneModel, level_mm: float, normal: int = 1) -> CrossSection:
    """Cut a loaded scene with the plane ``y = level_mm``, or across x where `normal` is 0."""
    regions, traces = [], []
    for along in (2, 0):
        for positions, coords, surfaces, behind in _sweep(model, level_mm, normal, along):
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
    return CrossSection(level_mm, tuple(regions), tuple(traces), normal)


def _sweep(model: SceneModel, level_mm: float, normal: int, side: int) -> Iterator[tuple]:
    """Runs of neighbouring parallel lines (`side` 2: vertical, 0: horizontal) that meet the same.

    For each: x of vertical or z of horizontal lines, shape (lines,), and z or x of their crossings,
    (lines, crossings), in mm; surfaces and sides of these, as in `volume_consistency.Crossings`.
    """
    level = 1 - normal
    along, across = (2, level) if side else (level, 2)
    tolerance = FINEST * model.size_mm
    boxes = [shape.bbox() for shape in model.shapes]
    edges = np.array([(box.min[across], box.max[across]) for box in boxes]).ravel()
    pending = np.linspace(edges.min(), edges.max(), LINES + 2)[1:-1]
    # edges show what is thinner than the distance of these lines
    pending = np.concatenate([pending, *(edges + k * tolerance for k in (-9, -3, 3, 9))])
    crossed_by: dict[float, _Met] = {}
    rng = np.random.default_rng(0)
    for _ in range(20):
        crossed_by |= _lines(model, level_mm + ASIDE * model.size_mm, along, across, pending)
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


def _lines(
    model: SceneModel, level: float, along: int, across: int, positions: np.ndarray
) -> dict[float, _Met]:
    """Surfaces, sides and coordinates of the crossings of parallel lines, by position."""
    origin, direction = np.full((len(positions), 3), level), np.eye(3)[[along] * len(positions)]
    origin[:, along], origin[:, across] = -2.0 * model.size_mm, positions
    met = trace_crossings(model, origin, direction)
    met_by: dict[float, _Met] = {}
    for line, distance in enumerate(met.distance):
        count = int(np.isfinite(distance).sum())
        surfaces, behind = (s[line, :count].tolist() for s in (met.surface, met.from_behind))
        coords = met.origin[line, along] + distance[:count]
        met_by[float(met.origin[line, across])] = (surfaces, behind, coords)
    return met_by


def _bends(lines: Mapping[float, _Met], along: Sequence[float], tolerance: float) -> np.ndarray:
    """Neighbouring lines, (n, 2), between which what they meet is the same, but not straight."""
    pairs = []
    for _, run in groupby(along, key=lambda place: lines[place][:2]):
        places = np.array([*run])
        coords = np.array([lines[place][2] for place in places])
        share = (np.diff(places)[:-1] / (places[2:] - places[:-2]))[:, None]
        straight = coords[:-2] + share * (coords[2:] - coords[:-2])
        bent = (np.abs(straight - coords[1:-1]) > tolerance).any(axis=1)
        steps = np.column_stack([places[:-1], places[1:]])
        both = np.stack([steps[:-1], steps[1:]], axis=1)[bent].reshape(-1, 2)
        pairs.append(both[np.ptp(both, axis=1) > 3 * tolerance])
    return np.concatenate(pairs)


def masked(model: SceneModel, cut: CrossSection) -> list[Trace]:
    """The parts of the traces that masks, which lie more or less flat, cover."""
    parts = []
    for trace in cut.traces:
        face, line = model.surfaces[trace.surface], trace.points[trace.points[:, 0].argsort()]
        x, y = face.axis_mm[:: 1 if cut.normal else -1]
        radius = face.aperture_radius_mm
        if np.isfinite(radius):
            # rounding must not leave a speck beside a hole as wide as the face
            half = np.sqrt(max(radius**2 - (cut.level_mm - y) ** 2, 0.0)) + FINEST * model.size_mm
            for rims in ((-np.inf, x - half), (x + half, np.inf)):
                at = np.clip(line[:, 0], *rims)
                part = np.column_stack([at, np.interp(at, *line.T)])
                parts += [Trace(trace.surface, part, trace.back)] if np.ptp(at) > 0 else []
    return parts
