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
from matplotlib.path import Path as Polygon
from scipy.ndimage import binary_erosion

from mcrim_mitsuba.check.words import volume_indices
from mcrim_mitsuba.errors import InputError

#: Lines per direction, before the places where neighbours differ are looked at more closely.
LINES = 400
#: How closely such a place is located, relative to the scene's size.
FINEST = 3e-6
#: The plane is moved aside by so much of the scene's size: lines along mesh edges that lie in the
#: plane itself would be left out (`kernel.crossings.RIM`).
ASIDE = 1e-5
# Calm, and of different lightness, so that a grey print still tells neighbours apart.
_COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
_INK, _DETECTOR, _FRAME = "#222222", "#b3261e", "#d95f02"
_WIDTH_IN, _MARGIN_IN, _DETAIL_IN, _DPI = 12.0, 0.85, 2.6, 150
#: Pixels: a cell of the grid on which labels find their place; the space beside and above a label.
_CELL, _CLEAR = 3, np.array([8, 4])


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
    """The line along which the plane cuts a face: float64, shape (n, 2), x and z in mm.

    `back`, a unit vector along x or z, leads to the side that the face's normal points away from.
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

    def outline(self, volume: int) -> np.ndarray:
        """Corners of a volume that the plane cuts, shape (n, 2), mm."""
        return np.concatenate([r.outline for r in self.regions if r.volume == volume])

    def levels(self, at: float, axis: int) -> np.ndarray:
        """z of the flat faces at some x (`axis` 0), or x of the steep ones at some z (1), mm."""
        lines = [trace.points for trace in self.traces if trace.back[axis] == 0]
        lines = [line for line in lines if line[0, axis] <= at <= line[-1, axis]]
        return np.unique([np.interp(at, line[:, axis], line[:, 1 - axis]) for line in lines])


def cross_section(model, y_mm: float) -> CrossSection:
    """Cut a loaded scene (`kernel.scene_model.SceneModel`) with the vertical plane ``y = y_mm``."""
    y = y_mm + ASIDE * model.size_mm
    columns, rows = _sweep(model, y, along=2), _sweep(model, y, along=0)
    regions = [region for run in columns for region in _regions(model, *run)]
    traces = [trace for run in columns for trace in _traces(*run, along=2)]
    traces += [trace for run in rows for trace in _traces(*run, along=0)]
    return CrossSection(y_mm, tuple(regions), tuple(traces))


def _sweep(model, y: float, along: int) -> list[tuple]:
    """Runs of neighbouring parallel lines (`along` 2: vertical, 0: horizontal) that meet the same.

    Returns
    -------
    list of (positions, coords, surfaces, from_behind)
        x of vertical or z of horizontal lines, shape (lines,), and z or x of their crossings,
        shape (lines, crossings), in mm; for each crossing as in `kernel.crossings.Crossings`.
    """
    across, tolerance = 2 - along, FINEST * model.size_mm
    box, shapes = model.scene.bbox(), [shape.bbox() for shape in model.scene.shapes()]
    edges = np.array([(b.min[across], b.max[across]) for b in shapes]).ravel()
    pending = np.linspace(box.min[across], box.max[across], LINES + 2)[1:-1]
    # edges show what is thinner than the distance of these lines
    pending = np.concatenate([pending, *(edges + k * tolerance for k in (-9, -3, 3, 9))])
    found, rng = {}, np.random.default_rng(0)
    for _ in range(20):
        found |= _lines(model, y, along, pending)
        places = sorted(found)
        changes = [(a, b) for a, b in pairwise(places) if found[a][:2] != found[b][:2]]
        pairs = np.array([(a, b) for a, b in changes if b - a > tolerance])
        if not len(pairs):
            break
        # Not evenly: a line that meets a rim is left out and must not be tried for ever. And one
        # line that is known to hit: `trace_crossings` fails where none does.
        shares = (np.arange(8) + rng.random((len(pairs), 8))) / 8
        pending = pairs[:, :1] + shares * np.ptp(pairs, axis=1, keepdims=True)
        pending = np.append(pending, next(place for place in places if found[place][0]))
    runs = []
    # what lies before the first change and after the last one is outside the scene
    for (before, start), (end, after) in pairwise(changes):
        surfaces, behind, _ = found[start]
        if surfaces:
            inner = [place for place in places if start <= place <= end]
            coords = np.pad([found[place][2] for place in inner], ((1, 1), (0, 0)), "edge")
            positions = np.array([(before + start) / 2, *inner, (end + after) / 2])
            runs.append((positions, coords, surfaces, behind))
    return runs


def _lines(model, y: float, along: int, positions) -> dict[float, tuple]:
    """Surfaces, sides and coordinates of the crossings of parallel lines, by position."""
    from mcrim_mitsuba.kernel.crossings import trace_crossings

    direction = np.zeros((len(positions), 3))
    direction[:, along] = 1.0
    origin = np.full((len(positions), 3), y)
    origin[:, along], origin[:, 2 - along] = -2.0 * model.size_mm, positions
    met, found = trace_crossings(model, origin, direction), {}
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
    """What lies between the crossings of a run of vertical lines."""
    faces = [model.surfaces[s] for s in surfaces]
    sides = [(f.interior, f.exterior) for f in faces]
    sides = [side if b else side[::-1] for side, b in zip(sides, behind, strict=True)]
    regions = []
    for i, ((_, volume), (same, _)) in enumerate(pairwise(sides)):
        # where faces contradict each other nothing is filled: finding out why is for `check_scene`
        if volume == same != 0:
            there, back = (np.column_stack([positions, coords[:, k]]) for k in (i, i + 1))
            regions.append(Region(volume, np.concatenate([there, back[::-1]])))
    return regions


def _traces(positions, coords, surfaces, behind, along: int) -> list[Trace]:
    """Those parts of the faces that are nearly perpendicular to a run of lines."""
    traces = []
    for surface, front, coord in zip(surfaces, behind, coords.T, strict=True):
        rise, step = np.abs(np.diff(coord)), np.diff(positions)
        keep = np.flatnonzero(rise <= step if along else rise < step)
        points = np.column_stack([positions, coord] if along else [coord, positions])
        back = np.roll([-1.0 if front else 1.0, 0.0], along // 2)
        for part in np.split(keep, np.flatnonzero(np.diff(keep) > 1) + 1):
            if len(part):
                traces.append(Trace(surface, points[part[0] : part[-1] + 2], tuple(back)))
    return traces


def masked(model, cut: CrossSection) -> list[np.ndarray]:
    """Where masks cover faces: straight pieces, each of shape (2, 2), x and z in mm."""
    pieces = []
    for trace in cut.traces:
        face = model.surfaces[trace.surface]
        (x, y), radius = face.aperture_centre_mm, face.aperture_radius_mm
        if not np.isfinite(radius):
            continue
        # rounding must not leave a speck beside a hole as wide as the face
        half = np.sqrt(max(radius**2 - (cut.y_mm - y) ** 2, 0.0)) + FINEST * model.size_mm
        for start, end in pairwise(trace.points):
            rims = (x - start[0] + np.array([-half, half])) / (end[0] - start[0] or np.inf)
            stops = np.array([0.0, *sorted(rims[(rims > 0) & (rims < 1)]), 1.0])
            parts = pairwise(start + stops[:, None] * (end - start))
            pieces += [np.array(p) for p in parts if abs(np.mean(p, axis=0)[0] - x) > half]
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
    box, inner_in = model.scene.bbox(), _WIDTH_IN - 1.5 * _MARGIN_IN
    (middle_x, _, middle_z), (wide, _, tall) = np.array(box.center()), np.array(box.extents())
    # with inches of air around the scene, for labels
    per_mm = min((inner_in - 2.0) / wide, 4.6 / tall)
    main_in = max(tall * per_mm + 1.4, 2.4)
    view = _closer_view(cut, crystal.volume, inner_in / _DETAIL_IN)
    times = _DETAIL_IN / (view[3] - view[2]) / per_mm if view else 0.0
    enlarges = times > 1.3
    below_in = _MARGIN_IN + enlarges * (_DETAIL_IN + 0.9)
    height_in = below_in + main_in + 1.5
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    changed = ", ".join(f"{name} = {_plain(file.parameters[name])}" for name in file.overrides)
    words = [_readable(*item) for item in file.parameters.items()]
    words = textwrap.fill("\N{NO-BREAK SPACE}· ".join(words), 135, max_lines=3, placeholder=" ...")
    style = {"x": 0.5, "ha": "center", "va": "top", "color": _INK, "linespacing": 1.4}
    title = file.path.name + (f" with {changed}" if changed else "")
    figure.text(y=1 - 0.18 / height_in, s=title, size=16, weight="bold", **style)
    figure.text(y=1 - 0.55 / height_in, s=words, size=9.5, **style)

    def panel(bottom_in, tall_in, limits, title) -> _Panel:
        place = np.array([_MARGIN_IN, bottom_in, inner_in, tall_in])
        ax = figure.add_axes(place / np.tile([_WIDTH_IN, height_in], 2))
        ax.set(xlim=limits[:2], ylim=limits[2:], xlabel="x (mm)", ylabel="z (mm)")
        ax.set_title(title, size=11, loc="left")
        return _Panel(ax, cut, model, indices)

    x, z = inner_in / 2 / per_mm, main_in / 2 / per_mm
    limits = (middle_x - x, middle_x + x, middle_z - z, middle_z + z)
    title = f"Vertical plane y = {cut.y_mm:.3g} mm, to scale"
    if (mask := _mask(model)) and not masked(model, cut):
        title += f"; the {mask} does not reach it"
    main, enlarged = panel(below_in, main_in, limits, title), {}
    if enlarges:
        title = f"The frame above, enlarged {times:.2g} times, alike in both directions"
        detail = panel(_MARGIN_IN, _DETAIL_IN, view, title)
        detail.measure()
        detail.label(brief=True)
        frame = np.array(view)[np.array([[0, 2], [1, 2], [1, 3], [0, 3], [0, 2]])]
        main.line(frame, _FRAME, 1.5)
        enlarged = {f"enlarged {times:.2g} times below": [frame]}
    main.label(enlarged)
    return figure


def _readable(name: str, value) -> str:
    """A scene parameter in words that stay on one line."""
    unit = next((unit for unit in ("_per_cm", "_mm") if name.endswith(unit)), "")
    words = f"{name.removesuffix(unit)}_{_plain(value)}{unit.replace('per_', '/')}"
    return words.replace("_", "\N{NO-BREAK SPACE}")


def _plain(value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def _mask(model) -> str:
    """The holes of the scene's masks; empty where there is none."""
    radii = {s.aperture_radius_mm for s in model.surfaces if np.isfinite(s.aperture_radius_mm)}
    radii = " or ".join(f"{radius:g}" for radius in sorted(radii))
    return radii and f"black mask (hole of radius {radii} mm)"


def _closer_view(cut: CrossSection, crystal: int, aspect: float) -> tuple[float, ...] | None:
    """Limits (x, x, z, z; mm) around the thinnest volume or layer at the crystal's lower edge."""
    volumes = {region.volume for region in cut.regions}
    if crystal not in volumes:
        return None
    outline = cut.outline(crystal)
    bottom, size = outline[:, 1].min(), np.ptp(outline)
    x = outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max()
    layers = [(cut.area(v) / np.ptp(cut.outline(v), axis=0).max(),
               cut.outline(v).min(axis=0), cut.outline(v).max(axis=0)) for v in volumes]  # fmt: skip
    below = cut.levels(x - 1e-3 * size, 0)
    below = below[below < bottom - 1e-4 * size]
    if below.size:
        layers.append((bottom - below[-1], (x, below[-1]), (x, bottom)))
    thickness, low, high = min(layers, key=lambda layer: layer[0])
    x, z = np.clip((x, bottom), low, high)
    half = 1.6 * thickness
    if 0 < bottom - low[1] < 6 * thickness:  # room for all between it and the crystal
        z, half = (bottom + low[1]) / 2, max(half, 0.7 * (bottom - low[1]))
    return x - half * aspect, x + half * aspect, z - half, z + half


class _Panel:
    """Axes with the cross-section, and a grid of cells on which labels find free places."""

    def __init__(self, ax, cut: CrossSection, model, indices: dict[str, float]) -> None:
        from mcrim_mitsuba.kernel.scene_model import DETECTOR, DIELECTRIC, DIFFUSE, KIND_NAMES

        self.ax, self.cut, self.model, self.indices = ax, cut, model, indices
        self.box = ax.get_window_extent()
        shape = int(self.box.height // _CELL), int(self.box.width // _CELL)
        self.owner, self.taken = np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool)
        centres = np.indices(shape)[::-1].reshape(2, -1).T + 0.5
        for region in cut.regions:
            colour = _COLOURS[(region.volume - 1) % len(_COLOURS)]
            ax.fill(*region.outline.T, facecolor=colour, edgecolor=colour, linewidth=0.2)
            inside = Polygon(self.cells(region.outline)).contains_points(centres)
            self.owner[inside.reshape(shape)] = region.volume
        styles = {DIELECTRIC: (_INK, 0.8), DIFFUSE: (_INK, 1.5), DETECTOR: (_DETECTOR, 5.0)}
        band = 16 * np.diff(ax.get_ylim())[0] / self.box.height
        self.named: dict[str, list] = {}
        for trace in cut.traces:
            face = model.surfaces[trace.surface]
            text = KIND_NAMES[face.kind]
            if face.kind == DIFFUSE:
                text = f"{face.name}: {text}, {100 * face.reflectance:.3g} %"
                far = trace.points + band * np.array(trace.back)
                ax.fill(*np.concatenate([trace.points, far[::-1]]).T, facecolor="white",
                        edgecolor=_INK, hatch="//////", linewidth=0.0)  # fmt: skip
                self.line(far, "none", 0.0)
            if face.kind != DIELECTRIC:
                self.named.setdefault(text, []).append(trace.points)
            self.line(trace.points, *styles.get(face.kind, ("#777777", 3.0)))
        for piece in masked(model, cut):
            self.named.setdefault(_mask(model), []).append(piece)
            self.line(piece, "black", 5.0)

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
        for axis, share in ((0, 0.48), (1, 0.8)):  # beside the crystal's edge, and above it
            at = limits[axis] @ (1 - share, share)
            levels = self.cut.levels(at, axis)
            levels = levels[(levels > limits[1 - axis, 0]) & (levels < limits[1 - axis, 1])]
            for ends in pairwise(levels):
                points = np.insert(np.array(ends)[:, None], axis, at, axis=1)
                self.ax.annotate("", *points, arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0})
                self.line(points, "none", 0.0)
                column, row = self.cells(points).mean(axis=0).astype(int)
                volume = self.owner[row, column]
                text = f"{'' if volume else 'air, '}{np.ptp(ends):.3g} mm"
                self.place([text], np.array([[column, row]]), volume, beside=True, leader=False)

    def label(self, notes=None, brief: bool = False) -> None:
        """Name everything in view; `notes` are further lines (mm) by text."""
        outside = [(text, np.concatenate([self.on(line) for line in lines]), 0)
                   for text, lines in (self.named | (notes or {})).items()]  # fmt: skip
        for volume in sorted({region.volume for region in self.cut.regions}):
            texts, own = self.texts(volume, brief), self.owner == volume
            if own.any() and self.place(texts, np.argwhere(own)[:, ::-1].mean(axis=0)[None], volume):
                continue
            cells = np.argwhere(binary_erosion(own, iterations=3))[:, ::-1]
            # what is too thin to be seen is pointed at by its outline
            cells = cells if len(cells) else self.on(self.cut.outline(volume))
            outside.append((texts[0], cells, volume))
        for text, cells, volume in outside:
            self.place([text], cells, volume, beside=True)
        self.place(["air, n = 1"], np.array([self.owner.shape[::-1]]), 0)

    def texts(self, volume: int, brief: bool) -> list[str]:
        """What to say of a volume, the longest first."""
        medium, (wide, tall) = self.model.volumes[volume], np.ptp(self.cut.outline(volume), axis=0)
        index = self.indices.get(medium.name)
        name = medium.name + (f", n = {index:g}" if index else "")
        size = f"{wide:.4g} mm wide, {tall:.4g} mm high"
        scat, absorption = 10 * medium.alpha_scat_per_mm, 10 * medium.alpha_abs_per_mm
        if brief or not (scat or absorption):
            return [f"{name}, {size}", name]
        return [f"{name}\n{size}\nscatters {scat:.4g} /cm\nabsorbs {absorption:.4g} /cm"]

    def place(self, texts, targets, volume: int, beside=False, leader=True) -> bool:
        """Write the first text that fits where nothing else is, near to one of some cells.

        The text lies in `volume`, wholly; `beside` it may lie in air too, and a leader shows what
        it belongs to. `targets` are columns and rows of cells, shape (n, 2).
        """
        targets, limit = targets[:: len(targets) // 40 + 1] + 0.5, np.array(self.owner.shape[::-1]) - 1
        room = ~self.taken & ((self.owner == volume) | (beside & (self.owner == 0)))
        sums = np.pad(room.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        for text in texts if len(targets) else ():
            artist = self.ax.text(0, 0, text, size=10.5, linespacing=1.3, va="bottom")
            size = artist.get_window_extent().size
            w, h = ((size + 2 * _CLEAR) // _CELL).astype(int) + 1
            inside = sums[h:, w:] - sums[:-h, w:] - sums[h:, :-w] + sums[:-h, :-w]
            low = np.argwhere(inside == w * h)[:, None, ::-1]
            if not len(low):
                artist.remove()
                continue
            low = low[:: len(low) // 5000 + 1] if beside else low
            # from the point of the text's rectangle that is next to the target, or its middle
            start = np.clip(targets, low, low + (w, h)) if beside else low + (w / 2, h / 2)
            cost = np.linalg.norm(start - targets, axis=2)
            if beside and leader:  # long enough to be seen, rather steep, across nothing else
                cost = np.abs(cost - 14) + np.maximum(10 - np.abs(start - targets)[..., 1], 0)
                for share in np.linspace(0, 0.8, 9):
                    at = np.minimum(start + share * (targets - start), limit).astype(int)
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
