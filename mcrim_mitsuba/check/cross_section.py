"""Draws a vertical cross-section of a loaded scene, to scale, with what light meets where.

Only indices come from the scene's text: lines traced in the cutting plane say which volume
lies where, so that boxes, spheres and meshes are drawn alike.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

from mcrim_mitsuba.check.words import volume_indices
from mcrim_mitsuba.errors import InputError

#: Lines per direction, before the places where neighbours differ are looked at more closely.
LINES = 400
#: How closely such a place is located, relative to the scene's size.
FINEST = 3e-6
#: The plane is moved aside by so much of the scene's size: lines along mesh edges that lie in the
#: plane itself would be left out (`kernel.crossings.RIM`).
ASIDE = 1e-5
#: Stands for a volume where the faces on its two sides name different ones.
CONTRADICTION = -1

# Calm, and of different lightness, so that a grey print still tells neighbours apart.
_COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
_DETECTOR, _INK, _WRONG = "#b3261e", "#333333", "#ff8a80"
_WIDTH_IN, _MARGIN_IN, _DPI = 12.0, 0.75, 150
#: Pixels: a cell of the grid on which labels find their place; the space around a label.
_CELL, _CLEAR = 4, 6


@dataclass(frozen=True)
class Region:
    """A part of a volume in the plane: a polygon, float64, shape (n, 2), x and z in mm."""

    volume: int
    outline: np.ndarray

    @property
    def area(self) -> float:
        """In mm2."""
        (x, z), (next_x, next_z) = self.outline.T, np.roll(self.outline, -1, axis=0).T
        return float(abs((x * next_z - next_x * z).sum())) / 2


@dataclass(frozen=True)
class Trace:
    """The line along which the plane cuts a face.

    `points` is float64 of shape (n, 2), x and z in mm; `back` the direction, along the axis that
    is more nearly perpendicular to it, to the side that the face's normal points away from.
    """

    surface: int
    points: np.ndarray
    back: tuple[float, float]


@dataclass(frozen=True)
class CrossSection:
    """What the plane ``y = y_mm`` of a scene shows; what no region fills is air."""

    y_mm: float
    regions: tuple[Region, ...]
    traces: tuple[Trace, ...]

    def area(self, volume: int) -> float:
        """Area (mm2) of a volume, given by its index among ``model.volumes``."""
        return sum(region.area for region in self.regions if region.volume == volume)

    def box(self, volume: int) -> np.ndarray:
        """Lower and upper corner of a volume that the plane cuts, shape (2, 2), mm."""
        points = np.concatenate([r.outline for r in self.regions if r.volume == volume])
        return np.array([points.min(axis=0), points.max(axis=0)])

    def levels(self, at: float, axis: int) -> np.ndarray:
        """z of the flat faces at some x (`axis` 0), or x of the steep ones at some z (1), mm."""
        lines = [t.points for t in self.traces if t.back[axis] == 0]
        lines = [p for p in lines if p[0, axis] <= at <= p[-1, axis]]
        return np.unique([np.interp(at, p[:, axis], p[:, 1 - axis]) for p in lines])


def cross_section(model, y_mm: float) -> CrossSection:
    """Cut a loaded scene (`kernel.scene_model.SceneModel`) with the vertical plane ``y = y_mm``."""
    y = y_mm + ASIDE * model.size_mm
    columns = _sweep(model, y, along=2)
    regions = [region for run in columns for region in _regions(model, *run)]
    traces = [trace for run in columns for trace in _traces(*run, 2)]
    traces += [trace for run in _sweep(model, y, along=0) for trace in _traces(*run, 0)]
    return CrossSection(y_mm, tuple(regions), tuple(traces))


def _sweep(model, y: float, along: int) -> list[tuple]:
    """Runs of neighbouring parallel lines (`along` 2: vertical, 0: horizontal) that meet the same.

    Returns
    -------
    list of (positions, coords, surfaces, from_behind)
        x of vertical or z of horizontal lines, shape (lines,); their crossings' z or x, shape
        (lines, crossings), both ascending, in mm; of each crossing what
        `kernel.crossings.Crossings` says.
    """
    across, tolerance = 2 - along, FINEST * model.size_mm
    box, shapes = model.scene.bbox(), [shape.bbox() for shape in model.scene.shapes()]
    edges = np.array([(b.min[across], b.max[across]) for b in shapes]).ravel()
    pending = np.linspace(box.min[across], box.max[across], LINES + 2)[1:-1]
    # edges show what is thinner than the distance of these lines
    pending = np.concatenate([pending, *(edges + 3 * k * tolerance for k in (-3, -1, 1, 3))])
    found, rng = {}, np.random.default_rng(0)
    for _ in range(60):
        found |= _lines(model, y, along, pending)
        places = sorted(found)
        changes = [(a, b) for a, b in pairwise(places) if found[a][:2] != found[b][:2]]
        pairs = np.array([(a, b) for a, b in changes if b - a > tolerance]).reshape(-1, 2)
        hits = [place for place in places if found[place][0]]
        if not len(pairs) or not hits:
            break
        # Not halfway: a line that meets a rim is left out and must not be tried for ever. And one
        # line that is known to hit: `trace_crossings` fails where none does.
        pending = pairs[:, 0] + np.ptp(pairs, axis=1) * rng.uniform(0.3, 0.7, len(pairs))
        pending = np.append(pending, hits[0])
    runs = []
    # what lies before the first change and after the last one is outside the scene
    for (before, start), (end, after) in pairwise(changes):
        inner = [place for place in places if start <= place <= end]
        coords = np.array([found[place][2] for place in inner])
        surfaces, behind, _ = found[start]
        if surfaces:
            positions = np.array([(before + start) / 2, *inner, (end + after) / 2])
            runs.append((positions, np.pad(coords, ((1, 1), (0, 0)), "edge"), surfaces, behind))
    return runs


def _lines(model, y, along, positions) -> dict[float, tuple]:
    """Surfaces, sides and coordinates of the crossings of parallel lines, by position."""
    from mcrim_mitsuba.kernel.crossings import trace_crossings

    direction = np.zeros((len(positions), 3))
    direction[:, along] = 1.0
    origin = np.full((len(positions), 3), y)
    origin[:, along], origin[:, 2 - along] = -2.0 * model.size_mm, positions
    met = trace_crossings(model, origin, direction)
    found = {}
    for line, distance in enumerate(met.distance):
        # nothing after the first miss counts
        count = int(np.logical_and.accumulate(np.isfinite(distance)).sum())
        found[float(met.origin[line, 2 - along])] = (
            tuple(met.surface[line, :count].tolist()),
            tuple(met.from_behind[line, :count].tolist()),
            met.origin[line, along] + distance[:count],
        )
    return found


def _regions(model, positions, coords, surfaces, behind) -> list[Region]:
    faces = [model.surfaces[s] for s in surfaces]
    sides = [(f.interior, f.exterior) if b else (f.exterior, f.interior)
             for f, b in zip(faces, behind, strict=True)]  # fmt: skip
    regions = []
    for i, ((_, volume), (same, _)) in enumerate(pairwise(sides)):
        low, high = coords[:, i], coords[:, i + 1]
        if volume != same:
            volume = CONTRADICTION
        # faces that lie on each other have nothing between them
        if volume != 0 and (high - low).max() > 10 * FINEST * model.size_mm:
            there, back = np.column_stack([positions, low]), np.column_stack([positions, high])
            regions.append(Region(volume, np.concatenate([there, back[::-1]])))
    return regions


def _traces(positions, coords, surfaces, behind, along) -> list[Trace]:
    """Those parts of the faces that are nearly perpendicular to the lines."""
    traces = []
    for surface, front, coord in zip(surfaces, behind, coords.T, strict=True):
        rise, step = np.abs(np.diff(coord)), np.diff(positions)
        keep = np.flatnonzero(rise <= step if along else rise < step)
        points = np.column_stack([positions, coord] if along else [coord, positions])
        back = (0.0, 1.0) if along else (1.0, 0.0)
        back = tuple(-b if front else b for b in back)
        for part in np.split(keep, np.flatnonzero(np.diff(keep) > 1) + 1):
            if len(part):
                traces.append(Trace(surface, points[part[0] : part[-1] + 2], back))
    return traces


def masked(model, cut: CrossSection) -> list[np.ndarray]:
    """Where masks cover faces: straight pieces, each of shape (2, 2), x and z in mm."""
    pieces = []
    for trace in cut.traces:
        face = model.surfaces[trace.surface]
        (x, y), radius = face.aperture_centre_mm, face.aperture_radius_mm
        if not np.isfinite(radius):
            continue
        half = np.sqrt(max(radius**2 - (cut.y_mm - y) ** 2, 0.0))
        for start, end in pairwise(trace.points):
            with np.errstate(divide="ignore", invalid="ignore"):
                rims = (np.array([x - half, x + half]) - start[0]) / (end[0] - start[0])
            stops = np.array([0.0, *sorted(rims[(rims > 0) & (rims < 1)]), 1.0])
            for piece in pairwise(start + stops[:, None] * (end - start)):
                # rounding must not leave a speck beside a hole as wide as the face
                if abs(np.mean(piece, axis=0)[0] - x) > half + 10 * FINEST * model.size_mm:
                    pieces.append(np.array(piece))
    return pieces


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
    kind = path.suffix.lower()[1:]
    if kind not in ("png", "svg"):
        problem = f"a cross-section cannot be drawn as {path.suffix or 'a file without suffix'}"
        raise InputError(problem, "let the name end in .png or .svg", path=path)
    figure = _figure(simulation, volume_indices(interfaces))
    try:
        figure.savefig(path, format=kind, dpi=_DPI)
    except OSError as error:
        problem = f"the picture cannot be written ({error.strerror or error})"
        mend = "name a file in a folder that exists and may be written to"
        raise InputError(problem, mend, path=path) from None


def _figure(simulation, indices: dict[str, float]) -> Figure:
    crystal, file, model = simulation.crystal, simulation.file, simulation.model
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    box = model.scene.bbox()
    centre, wide, tall = (box.min + box.max) / 2, *(box.max - box.min)[[0, 2]]
    inner_in, detail_in = _WIDTH_IN - 1.5 * _MARGIN_IN, 2.6
    # inches of air around the scene, for labels
    per_mm = min((inner_in - 2.0) / wide, 4.6 / tall)
    main_in = max(tall * per_mm + 1.4, 2.4)
    view = _closer_view(cut, crystal.volume, inner_in / detail_in)
    times = detail_in / (view[3] - view[2]) / per_mm if view else 0.0
    below_in = _MARGIN_IN + (detail_in + 0.9 if times > 1.3 else 0.0)
    height_in = below_in + main_in + 1.5
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    changed = ", ".join(f"{name} = {value}" for name, value in file.overrides.items())
    title = file.path.name + (f" with {changed}" if changed else "")
    words = [_readable(*item) for item in file.parameters.items() if item[0] != "polarization"]
    words = textwrap.fill("  ·  ".join(words), 140, max_lines=3, placeholder=" ...")
    style = {"ha": "center", "va": "top", "color": _INK, "linespacing": 1.4}
    figure.text(0.5, 1 - 0.18 / height_in, title, size=16, weight="bold", **style)
    figure.text(0.5, 1 - 0.55 / height_in, words, size=9.5, **style)

    def panel(bottom_in, tall_in, limits, title) -> _Panel:
        place = (_MARGIN_IN / _WIDTH_IN, bottom_in / height_in,
                 inner_in / _WIDTH_IN, tall_in / height_in)  # fmt: skip
        ax = figure.add_axes(place, xlim=limits[:2], ylim=limits[2:])
        ax.set(xlabel="x (mm)", ylabel="z (mm)")
        ax.set_title(title, size=11, loc="left")
        return _Panel(ax, cut, model, indices)

    x, z = inner_in / 2 / per_mm, main_in / 2 / per_mm
    middle = centre[2] - 0.1 / per_mm
    limits = (centre[0] - x, centre[0] + x, middle - z, middle + z)
    main = panel(below_in, main_in, limits, f"Vertical plane y = {cut.y_mm:.3g} mm, to scale")
    enlarged = []
    if times > 1.3:
        title = f"The frame above, enlarged {times:.2g} times, alike in both directions"
        detail = panel(_MARGIN_IN, detail_in, view, title)
        detail.measure()
        detail.label()
        frame = np.array(view)[[[0, 2], [1, 2], [1, 3], [0, 3], [0, 2]]]
        main.line(frame, "black", 1.2)
        enlarged = [(f"enlarged {times:.2g} times below", frame)]
    main.label(enlarged)
    return figure


def _readable(name: str, value) -> str:
    """A scene parameter in words."""
    unit = next((u for u in ("_per_cm", "_mm") if name.endswith(u)), "")
    words = name.removesuffix(unit).replace("_", " ")
    return f"{words} {value:g} {unit.replace('_per_', '/')}".replace("_", "").strip()


def _closer_view(cut: CrossSection, crystal: int, aspect: float) -> tuple[float, ...] | None:
    """Limits (x, x, z, z; mm) around the thinnest volume or layer at the crystal's lower edge."""
    volumes = {region.volume for region in cut.regions}
    if crystal not in volumes:
        return None
    outline = np.concatenate([r.outline for r in cut.regions if r.volume == crystal])
    (_, bottom), size = cut.box(crystal)[0], np.ptp(outline)
    x = outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max()
    layers = [(cut.area(v) / np.ptp(cut.box(v), axis=0).max(), cut.box(v)) for v in volumes]
    below = cut.levels(x - 1e-3 * size, 0)
    below = below[below < bottom - 1e-4 * size]
    if below.size:
        layers.append((bottom - below[-1], np.array([[x, below[-1]], [x, bottom]])))
    thickness, (low, high) = min(layers, key=lambda layer: layer[0])
    x, z = np.clip((x, bottom), low, high)
    half = 1.6 * thickness
    if 0 < bottom - low[1] < 6 * thickness:  # room for all between it and the crystal
        z, half = (bottom + low[1]) / 2, max(half, 0.7 * (bottom - low[1]))
    return x - half * aspect, x + half * aspect, z - half, z + half


class _Panel:
    """Axes with the cross-section, and a grid of cells on which labels find free places."""

    def __init__(self, ax, cut: CrossSection, model, indices: dict[str, float]) -> None:
        from mcrim_mitsuba.kernel.scene_model import DETECTOR, DIELECTRIC, DIFFUSE

        self.ax, self.cut, self.model, self.indices = ax, cut, model, indices
        self.box = ax.get_window_extent()
        shape = int(self.box.height // _CELL), int(self.box.width // _CELL)
        self.owner, self.free = np.zeros(shape, dtype=int), np.ones(shape, dtype=bool)
        self.taken = np.zeros(shape, dtype=bool)
        centres = np.indices(shape)[::-1].reshape(2, -1).T + 0.5
        for region in cut.regions:
            colour = _COLOURS[(region.volume - 1) % len(_COLOURS)]
            colour = _WRONG if region.volume == CONTRADICTION else colour
            ax.fill(*region.outline.T, facecolor=colour, edgecolor=colour, linewidth=0.2)
            inside = Outline(self.cells(region.outline)).contains_points(centres)
            self.owner[inside.reshape(shape)] = region.volume
        styles = {DIELECTRIC: (_INK, 0.8), DIFFUSE: (_INK, 1.5), DETECTOR: (_DETECTOR, 5.0)}
        band = 16 * np.diff(ax.get_ylim())[0] / self.box.height
        for trace in cut.traces:
            kind = model.surfaces[trace.surface].kind
            if kind == DIFFUSE:
                far = trace.points + band * np.array(trace.back)
                ax.fill(*np.concatenate([trace.points, far[::-1]]).T, facecolor="white",
                        edgecolor=_INK, hatch="//////", linewidth=0.0)  # fmt: skip
                self.block(far)
            self.line(trace.points, *styles.get(kind, ("#777777", 3.0)))
        for piece in masked(model, cut):
            self.line(piece, "black", 5.0)

    def cells(self, points) -> np.ndarray:
        """Points (mm) in units of cells from the lower left corner, shape (n, 2)."""
        return (self.ax.transData.transform(points) - self.box.p0) / _CELL

    def line(self, points, colour, width) -> None:
        """Draw a line (mm, shape (n, 2)) that labels stay clear of."""
        self.ax.plot(*np.transpose(points), color=colour, lw=width, solid_capstyle="butt")
        self.block(points)

    def block(self, points) -> None:
        """Keep labels off a line."""
        columns, rows = self.on(self.cells(points))
        self.free[rows, columns] = False

    def on(self, cells) -> np.ndarray:
        """Columns and rows of the cells that a line goes through."""
        far = np.clip(cells, -10, np.array(self.free.shape[::-1]) + 10)
        parts = [np.linspace(a, b, 2 + int(np.abs(b - a).max())) for a, b in pairwise(far)]
        at = np.floor(np.concatenate(parts)).astype(int)
        return at[((at >= 0) & (at < self.free.shape[::-1])).all(axis=1)].T

    def measure(self) -> None:
        """Arrows with dimensions across all that begins and ends in view on two lines."""
        limits = np.array([self.ax.get_xlim(), self.ax.get_ylim()])
        for axis, share in ((0, 0.07), (1, 0.8)):
            at = limits[axis] @ (1 - share, share)
            levels = self.cut.levels(at, axis)
            levels = levels[(levels > limits[1 - axis, 0]) & (levels < limits[1 - axis, 1])]
            for ends in pairwise(levels):
                points = np.insert(np.array(ends)[:, None], axis, at, axis=1)
                arrow = {"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0, "color": "black"}
                self.ax.annotate("", *points, arrowprops=arrow)
                self.block(points)
                column, row = self.cells(points).mean(axis=0).astype(int)
                self.place([f"{np.ptp(ends):.3g} mm"], points.mean(axis=0, keepdims=True),
                           self.owner[row, column], leader=False)  # fmt: skip

    def label(self, notes=()) -> None:
        """Name everything that is in view; `notes` are further pairs of text and points (mm)."""
        lines: dict[str, list] = {}
        for trace in self.cut.traces:
            if text := _meets(self.model.surfaces[trace.surface]):
                lines.setdefault(text, []).append(trace.points)
        if pieces := masked(self.model, self.cut):
            lines["black mask"] = pieces
        outside = [([text], parts, 0) for text, parts in (*lines.items(), *notes)]
        for volume in sorted({region.volume for region in self.cut.regions}):
            texts, cells = self.texts(volume), np.argwhere(self.owner == volume)[:, ::-1]
            if not len(cells) or not self.place(texts, cells.mean(axis=0), volume):
                own = [r.outline for r in self.cut.regions if r.volume == volume]
                middles = [(line + line[::-1])[: len(line) // 2] / 2 for line in own]
                outside.append((texts[:1], middles, volume))
        for texts, parts, volume in outside:
            cells = np.concatenate([self.on(self.cells(part)).T for part in parts])
            self.place(texts, cells, volume, beside=True)
        self.place(["air, n = 1"], np.array(self.free.shape[::-1]), 0)

    def texts(self, volume: int) -> list[str]:
        """What to say of a volume, the longest first."""
        if volume == CONTRADICTION:
            return ["faces contradict each other here", "?"]
        medium, (wide, tall) = self.model.volumes[volume], np.ptp(self.cut.box(volume), axis=0)
        name = medium.name
        if name in self.indices:
            name += f", n = {self.indices[name]:g}"
        texts = [f"{name}, {wide:.4g} mm wide, {tall:.4g} mm high", name]
        scat, absorption = 10 * medium.alpha_scat_per_mm, 10 * medium.alpha_abs_per_mm
        if scat or absorption:
            more = f"scatters {scat:.4g} /cm\nabsorbs {absorption:.4g} /cm"
            texts = [f"{name}\n{wide:.4g} mm wide, {tall:.4g} mm high\n{more}", *texts]
        return texts

    def place(self, texts, targets, volume: int, beside=False, leader=True) -> bool:
        """Write the first text that fits where nothing else is, near to one of some cells.

        Parameters
        ----------
        texts : sequence of str
        targets : ndarray, shape (n, 2) or (2,)
            Columns and rows.
        volume : int
            The text lies in it, wholly; with `beside` it may also lie in air, and a leader shows
            what it belongs to.
        """
        targets = np.atleast_2d(targets)
        targets = targets[:: len(targets) // 40 + 1]
        room = self.free & ((self.owner == volume) | (beside & (self.owner == 0)))
        sums = np.pad(room.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        for text in texts if len(targets) else ():
            artist = self.ax.text(0, 0, text, size=10.5, linespacing=1.3, va="bottom")
            size = artist.get_window_extent()
            w, h = (int((side + 2 * _CLEAR) // _CELL) + 1 for side in (size.width, size.height))
            inside = sums[h:, w:] - sums[:-h, w:] - sums[h:, :-w] + sums[:-h, :-w]
            low = np.argwhere(inside == w * h)[:, ::-1]
            if not len(low):
                artist.remove()
                continue
            low = low[:: len(low) // 5000 + 1, None]
            # where a leader would start: the point of the text's rectangle next to the target
            start = np.clip(targets, low, low + (w, h)) if beside else low + (w / 2, h / 2)
            cost = np.abs(np.linalg.norm(start - targets, axis=2) - (8 if leader else 0))
            best, link = None, np.inf
            for at in np.argsort(cost, axis=None)[:300]:
                spot, target = np.unravel_index(at, cost.shape)
                columns, rows = self.on(np.array([start[spot, target], targets[target] + 0.5]))
                # a leader that crosses other text is useless, one across other volumes poor
                crossed = beside * (100 * self.taken[rows, columns].sum()
                                    + (~np.isin(self.owner[rows, columns], (0, volume))).sum())
                if cost.flat[at] + crossed < link:
                    best, link = (spot, target), cost.flat[at] + crossed
                    path = columns, rows
            (column, row), target = low[best[0], 0], targets[best[1]] + 0.5
            ends = np.array([(column, row), start[best], target]) * _CELL + self.box.p0
            corner, *ends = self.ax.transData.inverted().transform(ends + [[_CLEAR] * 2, [0] * 2, [0] * 2])
            artist.set_position(corner)
            for grid, value in ((self.free, False), (self.taken, True)):
                grid[row : row + h, column : column + w] = value
            if beside and leader:
                self.taken[path[1], path[0]] = True
                self.free[path[1], path[0]] = False
                self.ax.plot(*np.transpose(ends), color=_INK, lw=0.8, marker="o", markevery=[1], ms=3)
            return True
        return False


def _meets(face) -> str:
    """What to say of a face that is more than polish."""
    from mcrim_mitsuba.kernel.scene_model import DIELECTRIC, DIFFUSE, KIND_NAMES

    if face.kind == DIFFUSE:
        return f"{face.name}: diffuse reflector, {100 * face.reflectance:.3g} %"
    return "" if face.kind == DIELECTRIC else KIND_NAMES[face.kind]
