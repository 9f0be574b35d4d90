"""Draws a vertical cross-section of a loaded scene, to scale, with what light meets where.

Only indices come from the scene's text: lines traced in the cutting plane say which volume
lies where, so that boxes, spheres and meshes are drawn alike.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.ndimage import binary_erosion

from mcrim_mitsuba.check.words import volume_indices
from mcrim_mitsuba.errors import InputError

#: Lines per direction, before the places where neighbours differ are looked at more closely.
LINES = 400
#: How closely such a place is located, relative to the scene's size.
FINEST = 3e-6
#: The plane is moved by so much of it: lines along mesh edges are left out (`crossings.RIM`).
ASIDE = 1e-5

# Calm, and of different lightness, so that a grey print still tells neighbours apart.
_COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
_INK, _DETECTOR, _OTHER, _FRAME = "#222222", "#b3261e", "#777777", "#d95f02"
_WIDTH_IN, _MARGIN_IN, _DETAIL_IN, _DPI = 12.0, 0.85, 2.6, 150
#: Pixels: a cell of the grid on which labels find their place; the space beside and above a label.
_CELL, _CLEAR = 3, np.array([8, 4])


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


def cross_section(model, y_mm: float) -> CrossSection:
    """Cut a loaded scene (`kernel.scene_model.SceneModel`) with the vertical plane ``y = y_mm``."""
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


def _sweep(model, y_mm: float, along: int) -> Iterator[tuple]:
    """Runs of neighbouring parallel lines (`along` 2: vertical, 0: horizontal) that meet the same.

    For each: x of vertical or z of horizontal lines, shape (lines,), and z or x of their crossings,
    (lines, crossings), in mm; surfaces and sides of these, as in `kernel.crossings.Crossings`.
    """
    across, tolerance = 2 - along, FINEST * model.size_mm
    boxes = [shape.bbox() for shape in model.shapes]
    edges = np.array([(box.min[across], box.max[across]) for box in boxes]).ravel()
    pending = np.linspace(edges.min(), edges.max(), LINES + 2)[1:-1]
    # edges show what is thinner than the distance of these lines
    pending = np.concatenate([pending, *(edges + k * tolerance for k in (-9, -3, 3, 9))])
    found, rng = {}, np.random.default_rng(0)
    for _ in range(20):
        found |= _lines(model, y_mm + ASIDE * model.size_mm, along, pending)
        places = sorted(found)
        changes = [(a, b) for a, b in pairwise(places) if found[a][:2] != found[b][:2]]
        pairs = [(a, b) for a, b in changes if b - a > tolerance]
        pairs = np.array([*pairs, *_bends(found, places, 10 * tolerance)])
        if not len(pairs):
            break
        # Not evenly: a line that meets a rim is left out and must not be tried for ever; and with
        # one line that is known to hit: `trace_crossings` may fail where none does.
        shares = (np.arange(8) + rng.random((len(pairs), 8))) / 8
        pending = pairs[:, :1] + shares * np.ptp(pairs, axis=1, keepdims=True)
        pending = np.append(pending, next(place for place in places if found[place][0]))
    # what lies before the first change and after the last one is outside the scene
    for (before, start), (end, after) in pairwise(changes):
        if found[start][0]:
            inner = [place for place in places if start <= place <= end]
            coords = np.pad([found[place][2] for place in inner], ((1, 1), (0, 0)), "edge")
            positions = np.array([(before + start) / 2, *inner, (end + after) / 2])
            yield positions, coords, *found[start][:2]


def _lines(model, y: float, along: int, positions) -> dict[float, tuple]:
    """Surfaces, sides and coordinates of the crossings of parallel lines, by position."""
    from mcrim_mitsuba.kernel.crossings import trace_crossings

    origin, direction = np.full((len(positions), 3), y), np.eye(3)[[along] * len(positions)]
    origin[:, along], origin[:, 2 - along] = -2.0 * model.size_mm, positions
    met, found = trace_crossings(model, origin, direction), {}
    for line, distance in enumerate(met.distance):
        count = int(np.isfinite(distance).sum())
        met_here = [sides[line, :count].tolist() for sides in (met.surface, met.from_behind)]
        coords = met.origin[line, along] + distance[:count]
        found[float(met.origin[line, 2 - along])] = (*met_here, coords)
    return found


def _bends(found, places, tolerance: float):
    """Neighbouring lines between which what they meet is the same, but not straight."""
    for a, b, c in zip(places, places[1:], places[2:], strict=False):
        if found[a][:2] == found[b][:2] == found[c][:2]:
            straight = found[a][2] + (b - a) / (c - a) * (found[c][2] - found[a][2])
            if (np.abs(straight - found[b][2]) > tolerance).any():
                yield from (pair for pair in ((a, b), (b, c)) if np.ptp(pair) > 3 * tolerance)


def masked(model, cut: CrossSection) -> list[Trace]:
    """The parts of the traces that masks, which lie more or less flat, cover."""
    parts = []
    for trace in cut.traces:
        face, line = model.surfaces[trace.surface], trace.points[trace.points[:, 0].argsort()]
        (x, y), radius = face.aperture_centre_mm, face.aperture_radius_mm
        if np.isfinite(radius):
            # rounding must not leave a speck beside a hole as wide as the face
            half = np.sqrt(max(radius**2 - (cut.y_mm - y) ** 2, 0.0)) + FINEST * model.size_mm
            for rims in ((-np.inf, x - half), (x + half, np.inf)):
                at = np.clip(line[:, 0], *rims)
                part = np.column_stack([at, np.interp(at, *line.T)])
                parts += [Trace(trace.surface, part, trace.back)] if np.ptp(at) > 0 else []
    return parts


def draw_cross_section(simulation, interfaces, path: str | Path) -> None:
    """Draw a loaded scene to scale in the vertical plane through the middle of its crystal.

    A second panel enlarges the thinnest layer at the crystal's lower edge, where there is one.

    Parameters
    ----------
    simulation : kernel.simulation.Simulation
    interfaces : sequence of check.report.Interface
        From `check.scene.interfaces_of`: they know the indices.
    path : str or Path
        The picture, overwritten if it exists: PNG (1800 pixels wide) or SVG by its suffix.

    Raises
    ------
    InputError
        If the suffix is another one or the file cannot be written.
    """
    path = Path(path)
    if (kind := path.suffix.lower()[1:]) not in ("png", "svg"):
        problem = f"a cross-section cannot be drawn as {path.suffix or 'a file without suffix'}"
        raise InputError(problem, "let the name end in .png or .svg", path=path)
    figure = _figure(simulation, interfaces)
    try:
        figure.savefig(path, format=kind, dpi=_DPI)
    except OSError as error:
        problem = f"the picture cannot be written ({error.strerror or error})"
        raise InputError(problem, "name a file in a writable folder", path=path) from None


def _figure(simulation, interfaces) -> Figure:
    """Title, parameters, the panel to scale and, where something is thin, the enlarged one."""
    crystal, file, model = simulation.crystal, simulation.file, simulation.model
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    box, inner_in = model.scene.bbox(), _WIDTH_IN - 1.5 * _MARGIN_IN
    (middle_x, _, middle_z), (wide, _, tall) = np.array(box.center()), np.array(box.extents())
    per_mm = min((inner_in - 2.0) / wide, 4.6 / tall)  # with inches of air for labels
    main_in = max(tall * per_mm + 1.5, 2.9)
    view = _closer_view(cut, crystal.volume)
    times = round(_DETAIL_IN / 2 / view[2] / per_mm, 1)
    below_in = _MARGIN_IN + (times > 1.3) * (_DETAIL_IN + 0.9)
    height_in = below_in + main_in + 1.5
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)  # which measures texts
    words = {n: f"{v:g}" if isinstance(v, float) else v for n, v in file.parameters.items()}
    changed = ", ".join(f"{name}={words[name]}" for name in file.overrides)
    title = textwrap.shorten(f"{file.path.name} {changed and 'with'} {changed}", 90)
    words = textwrap.fill(",  ".join(map("{0[0]}={0[1]}".format, words.items())), 150, max_lines=3)
    style = {"ha": "center", "va": "top", "color": _INK, "linespacing": 1.4, "parse_math": False}
    figure.text(0.5, 1 - 0.18 / height_in, title, size=16, weight="bold", **style)
    figure.text(0.5, 1 - 0.55 / height_in, words, size=9.5, **style)

    def panel(bottom_in, tall_in, x, z, half, title) -> _Panel:
        place = np.array([_MARGIN_IN, bottom_in, inner_in, tall_in])
        ax = figure.add_axes(place / np.tile([_WIDTH_IN, height_in], 2), xlabel="x (mm)")
        wide = half * inner_in / tall_in
        ax.set(xlim=(x - wide, x + wide), ylim=(z - half, z + half), ylabel="z (mm)")
        ax.set_title(title, size=11, loc="left")
        return _Panel(ax, cut, model, interfaces)

    title = f"Vertical plane y = {cut.y_mm:.3g} mm, to scale"
    if np.isfinite([s.aperture_radius_mm for s in model.surfaces]).any() and not masked(model, cut):
        title += "; the black mask does not reach it"
    main = panel(below_in, main_in, middle_x, middle_z, main_in / 2 / per_mm, title)
    if times > 1.3:
        title = f"The frame above, enlarged {times:g} times, alike in both directions"
        detail = panel(_MARGIN_IN, _DETAIL_IN, *view, title)
        detail.measure()
        detail.label(brief=True)
        frame = detail.ax.viewLim.corners()[[0, 1, 3, 2, 0]]
        main.line(frame, _FRAME, 1.5)
        main.named[f"enlarged {times:g} times below"] = [frame]
    main.label()
    return figure


def _closer_view(cut: CrossSection, crystal: int) -> tuple[float, float, float]:
    """x, z, half height (mm) around the thinnest volume or layer at the crystal's lower edge."""
    boxes = {r.volume: (cut.corners(r.volume).min(axis=0), cut.corners(r.volume).max(axis=0))
             for r in cut.regions}  # fmt: skip
    if crystal not in boxes:  # it is not closed: nothing to be seen
        return 0.0, 0.0, np.inf
    (_, bottom), size, outline = boxes[crystal][0], np.ptp(boxes[crystal]), cut.corners(crystal)
    x = outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max()
    layers = [(cut.area(v) / np.ptp(box, axis=0).max(), *box) for v, box in boxes.items()]
    below = cut.levels(x - 1e-3 * size, 0)
    below = below[below < bottom - 1e-4 * size]
    layers += [(bottom - z, (x, z), (x, bottom)) for z in below[-1:]]
    thickness, low, high = min(layers, key=lambda layer: layer[0])
    x, z = np.clip((x, bottom), low, high)
    half = 1.6 * thickness
    if 0 < bottom - low[1] < 6 * thickness:  # room for all between it and the crystal
        z, half = (bottom + low[1]) / 2, max(half, 0.7 * (bottom - low[1]))
    return x, z, half


class _Panel:
    """Axes with the cross-section, and a grid of cells on which labels find free places."""

    def __init__(self, ax, cut: CrossSection, model, interfaces) -> None:
        self.ax, self.cut, self.model, self.indices = ax, cut, model, volume_indices(interfaces)
        self.box, self.named = ax.get_window_extent(), {}
        shape = int(self.box.height // _CELL) + 1, int(self.box.width // _CELL) + 1
        self.owner, self.taken = np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool)
        rows, columns = np.ogrid[0.5 : shape[0], 0.5 : shape[1]]
        for region in cut.regions:
            ax.fill(*region.outline.T, color=_COLOURS[region.volume % len(_COLOURS) - 1], lw=0.2)
            low, high = np.split(self.cells(region.outline), 2)
            low, high = (np.interp(columns, *side.T, np.inf, np.inf) for side in (low, high[::-1]))
            self.owner[(low < rows) & (rows < high)] = region.volume
        styles = {"dielectric": (_INK, 0.8), "diffuse reflector": (_INK, 1.5),
                  "detector": (_DETECTOR, 5.0)}  # fmt: skip
        band = 16 * np.diff(ax.get_ylim()) / self.box.height  # mm: as thick as 16 pixels
        for trace in cut.traces:
            face, kind = model.surfaces[trace.surface], interfaces[trace.surface].kind
            text, percent = kind, 100 * face.reflectance
            if percent > 0:
                text = f"{face.name}: {kind}, {percent:.3g} %"
                far = trace.points[::-1] + band * trace.back
                ax.fill(*np.vstack([trace.points, far]).T, fc="white", ec=_INK, hatch="/" * 6, lw=0)
                self.line(far, "none", 0.0)
            if kind != "dielectric":
                self.named.setdefault(text, []).append(trace.points)
            self.line(trace.points, *styles.get(kind, (_OTHER, 3.0)))
        for trace in masked(model, cut):
            radius = model.surfaces[trace.surface].aperture_radius_mm
            self.named.setdefault(f"black mask, hole radius {radius:g} mm", []).append(trace.points)
            self.line(trace.points, "black", 5.0)

    def cells(self, points) -> np.ndarray:
        """Points (mm) in units of cells from the lower left corner, shape (n, 2)."""
        return (self.ax.transData.transform(points) - self.box.p0) / _CELL

    def on(self, points) -> np.ndarray:
        """Columns and rows, shape (n, 2), of the cells that a line goes through."""
        shape = np.array(self.owner.shape[::-1])
        ends = np.clip(self.cells(points), -10, shape + 10)
        parts = [np.linspace(a, b, 2 + int(np.abs(b - a).max())) for a, b in pairwise(ends)]
        cells = np.floor(np.concatenate(parts)).astype(int)
        return cells[((cells >= 0) & (cells < shape)).all(axis=1)]

    def line(self, points, colour: str, width: float) -> None:
        """Draw a line (mm, shape (n, 2)) that labels stay clear of."""
        points = np.round(points, 5)  # single precision would make a straight line wriggle
        self.ax.plot(*points.T, color=colour, lw=width, solid_capstyle="butt")
        self.taken[tuple(self.on(points).T[::-1])] = True

    def measure(self) -> None:
        """Arrows with dimensions across all that begins and ends in view on two lines."""
        limits = np.array([self.ax.get_xlim(), self.ax.get_ylim()])
        for axis, share in ((0, 0.49), (1, 0.8)):  # beside the crystal's edge, and above it
            at, (low, high) = limits[axis] @ (1 - share, share), limits[1 - axis]
            levels = self.cut.levels(at, axis)
            for ends in pairwise(levels[(levels > low) & (levels < high)]):
                line = np.insert(np.array(ends)[:, None], axis, at, axis=1)
                self.ax.annotate("", *line, arrowprops=dict(arrowstyle="<->", shrinkA=0, shrinkB=0))
                self.line(line, "none", 0.0)
                cell = self.cells(line).mean(axis=0).astype(int)
                volume = self.owner[cell[1], cell[0]]
                text = f"{np.ptp(ends):.3g} mm" if volume else f"air, {np.ptp(ends):.3g} mm"
                self.place([text], cell[None], volume, beside=True, leader=False)

    def label(self, brief: bool = False) -> None:
        """Name everything in view."""
        outside = [([t], np.vstack([*map(self.on, lines)]), 0) for t, lines in self.named.items()]
        for volume in sorted({region.volume for region in self.cut.regions}):
            texts, own = self.texts(volume, brief), self.owner == volume
            if not own.any() or not self.place(texts, np.argwhere(own)[:, ::-1], volume):
                cells = np.argwhere(binary_erosion(own, iterations=3))[:, ::-1]
                cells = cells if len(cells) else self.on(self.cut.corners(volume))  # it is thin
                outside.append((texts, cells, volume))
        for texts, cells, volume in outside:
            self.place(texts, cells, volume, beside=True)
        self.place(["air, n = 1"], np.array([self.owner.shape[::-1]]), 0)

    def texts(self, volume: int, brief: bool) -> list[str]:
        """What to say of a volume, the longest first."""
        medium, (wide, tall) = self.model.volumes[volume], np.ptp(self.cut.corners(volume), axis=0)
        index, size = self.indices.get(medium.name), f"{wide:.4g} mm wide, {tall:.4g} mm high"
        name = medium.name + (f", n = {index:g}" if index else "")
        scat, absorption = 10 * medium.alpha_scat_per_mm, 10 * medium.alpha_abs_per_mm
        more = f"scatters {scat:.4g} /cm", f"absorbs {absorption:.4g} /cm"
        full = ["\n".join([name, size, *more]), ", ".join([name, *more])]
        return [f"{name}, {size}", name] if brief or not (scat or absorption) else full

    def place(self, texts, targets, volume: int, beside=False, leader=True) -> bool:
        """Write the first text that fits, near to one of the cells `targets`, shape (n, 2).

        It lies in `volume`, or (`beside`) in air too, with a leader. False if there is no place.
        """
        targets = targets[:: len(targets) // 40 + 1] + 0.5 if beside else targets.mean(axis=0)[None]
        room = ~self.taken & ((self.owner == volume) | (beside & (self.owner == 0)))
        sums = np.pad(room.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        for text in texts if len(targets) else ():
            artist = self.ax.text(0, 0, text, size=10.5, va="bottom", parse_math=False)
            w, h = size = (artist.get_window_extent().size + 2 * _CLEAR).astype(int) // _CELL + 1
            inside = sums[h:, w:] - sums[:-h, w:] - sums[h:, :-w] + sums[:-h, :-w]
            low = np.argwhere(inside == w * h)[:, None, ::-1]
            if not len(low):
                artist.remove()
                continue
            low = low[:: len(low) // 5000 + 1] if beside else low
            # from the point of the text's rectangle that is next to the target, or its middle
            start = np.clip(targets, low, low + size - 1) if beside else low + size / 2
            cost = np.linalg.norm(start - targets, axis=2)
            if beside and leader:  # long enough to be seen, rather steep, across nothing else
                cost = np.abs(cost - 14) + np.maximum(10 - np.abs(start - targets)[..., 1], 0)
                for share in np.linspace(0, 0.8, 9):
                    at = (start + share * (targets - start)).astype(int)
                    at = at[..., 1], at[..., 0]
                    cost += 20 * (self.taken[at] | ~np.isin(self.owner[at], (0, volume)))
            spot, target = np.unravel_index(cost.argmin(), cost.shape)
            (column, row), corner = low[spot, 0], low[spot, 0] + _CLEAR / _CELL
            ends = np.array([corner, start[spot, target], targets[target]]) * _CELL + self.box.p0
            corner, *link = self.ax.transData.inverted().transform(ends)
            artist.set_position(corner)
            if beside and leader:
                self.line(link, _INK, 0.8)
                self.ax.plot(*link[1], "o", color=_INK, markersize=4, markeredgecolor="white")
                x, z = targets[target].astype(int)
                self.taken[max(z - 5, 0) : z + 6, max(x - 5, 0) : x + 6] = True
            self.taken[row : row + h, column : column + w] = True
            return True
        return False
