"""A vertical cross-section of a loaded scene, to scale, with what light meets where.

A few photons' paths, traced by the transport itself, show which fates light meets.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from scipy.ndimage import binary_erosion

from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import refuse_suffix, write_bytes
from mcrim_mitsuba.core.numbers import Value, said
from mcrim_mitsuba.output.figure_style import Drawing, fate_style, ordered, paper
from mcrim_mitsuba.transport.check import interfaces_of, volume_indices
from mcrim_mitsuba.transport.cut import CrossSection, Trace, cross_section, masked
from mcrim_mitsuba.transport.launch_plan import LANES
from mcrim_mitsuba.transport.scene_model import SceneModel, Surface

if TYPE_CHECKING:
    from mcrim_mitsuba.output.scene_results import CheckResult
    from mcrim_mitsuba.scene.check_text import Interface, SceneProblem
    from mcrim_mitsuba.scene.scene_file import SceneFile
    from mcrim_mitsuba.transport.simulation import Simulation


# Calm, and of different lightness, so that a grey print still tells neighbours apart.
COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
#: Colours of lines: of most, of the detector, of what is neither volume nor detector.
INK = "#222222"
_DETECTOR = "#b3261e"
_FAULT = "#ff1f1f"
_OTHER = "#777777"
#: What effects have added, by an attribute of a face that tells how much, and by its name's end.
_ADDED_INK = "#00838f"
_FINISHES = {
    "roughness": "rough face, α = {:.2g}",
    "hazy_part": "hazy face, {:.0%} scattered",
    "surface_loss": "lossy face, {:.2g} of every reflection",
    "contact": "wrapping in contact, {:.0%}",
}
_ADDED = {
    "_bubble": "air bubble in the gap",
    "chamfers": "bevelled edge",
    "_wet": "collar of the liquid",
}
#: Pixels of a cell of the grid on which labels find their place.
_CELL = 3
#: Cells of a line that are looked at, at most.
_MOST_CELLS = 400_000
#: Pixels of the space beside and above a label.
_CLEAR = np.array([8, 4])


# How a label's place is chosen; lengths and penalties in cells of the grid.
#: Targets and places that are tried at most: more are thinned out.
_MOST_TARGETS = 40
_MOST_PLACES = 5000
#: A leader is best that long, and at least so high: long enough to be seen, rather steep.
_LEADER = 14.0
_LEAST_HEIGHT = 10.0
#: Points of a leader, from its beginning to this part of it, that are looked at, and what each
#: costs that lies on a line or in a volume that is not meant.
_POINTS = 9
_LOOKED_AT = 0.8
_ON_SOMETHING = 20.0
#: What each cell of a photon's path under the label costs.
_ON_PATH = 0.7
#: Half the side of the square around a leader's end that other labels leave free.
_AROUND_END = 5


class SectionAxes:
    """Axes with the cross-section, and a grid of cells on which labels find free places.

    Arrays of the grid have (rows, columns); places on it are columns and rows, as x and z.
    """

    def __init__(
        self,
        ax: Axes,
        cut: CrossSection,
        model: SceneModel,
        interfaces: Sequence[Interface],
        colours: Sequence[str] = COLOURS,
    ) -> None:
        self.ax, self.cut, self.model, self.indices = ax, cut, model, volume_indices(interfaces)
        self.box = ax.get_window_extent()
        #: Lines (mm, shape (n, 2)) that have a label, by its text.
        self.named: dict[str, list[np.ndarray]] = {}
        shape = int(self.box.height // _CELL) + 1, int(self.box.width // _CELL) + 1
        #: Of each cell: the volume there, 0 for air; what labels must and what they should avoid.
        self.owner, self.taken = np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool)
        self.crossed = np.zeros(shape, dtype=bool)
        # colour the volumes, and note which cells they have
        rows, columns = (places + 0.5 for places in np.ogrid[*map(slice, self.owner.shape)])
        for region in self.cut.regions:
            self.fill(region.outline, color=colours[region.volume % len(colours) - 1], lw=0.2)
            # the first half of an outline is its lower edge, the second its upper one, backwards;
            # no cell lies above infinity, beside the region
            lower, upper = np.split(self.in_cells(region.outline), 2)
            low, high = (
                np.interp(columns, edge[:, 0], edge[:, 1], np.inf, np.inf)
                for edge in (lower, upper[::-1])
            )
            self.owner[(low < rows) & (rows < high)] = region.volume
        self._draw_faces(interfaces)

    def _draw_faces(self, interfaces: Sequence[Interface]) -> None:
        """Draw lines where the plane cuts faces, hatched behind reflectors, and the black mask."""
        reflectors = dict.fromkeys(("diffuse reflector", "mirror", "black surface"), (INK, 1.5))
        styles = reflectors | {"dielectric": (INK, 0.8), "detector": (_DETECTOR, 5.0)}
        band = 16 * np.diff(self.ax.get_ylim()) / self.box.height  # mm: as thick as 16 pixels
        for trace in self.cut.traces:
            surface = self.model.surfaces[trace.surface]
            face = surface.seen
            kind = interfaces[trace.surface].kind
            text = f"{face.name}: {kind}" if kind in reflectors else kind
            if face.reflectance > 0:
                text = f"{face.name}: {kind}, {100 * face.reflectance:.3g} %"
                # paint lies outside of the face that wears it
                far = trace.points[::-1] + band * (-trace.back if surface.painted else trace.back)
                self.fill(np.vstack([trace.points, far]), fc="white", ec=INK, hatch="/" * 6, lw=0)
                self.line(far, "none", 0.0)
            if kind != "dielectric":
                self.named.setdefault(text, []).append(trace.points)
            self.line(trace.points, *styles.get(kind, (_OTHER, 3.0)))
            self._draw_added(surface, trace, band)
        for trace in masked(self.model, self.cut):
            radius = self.model.surfaces[trace.surface].aperture_radius_mm
            x, y = self.model.surfaces[trace.surface].axis_mm
            text = f"black mask, hole radius {radius:g} mm"
            text += f" about x = {x:g}, y = {y:g} mm" if x or y else ""
            self.named.setdefault(text, []).append(trace.points)
            self.line(trace.points, "black", 5.0)

    def _draw_added(self, surface: Surface, trace: Trace, band: np.ndarray) -> None:
        """What an effect has made of a face: rough, hazy, bevelled, wet, beside a bubble, ..."""
        texts = [
            text.format(getattr(surface, name)).replace("%", " %")
            for name, text in _FINISHES.items()
            if getattr(surface, name)
        ]
        texts += [text for end, text in _ADDED.items() if surface.name.endswith(end)]
        if surface.exterior == self.model.endless:  # a strip of the liquid outside
            outline = np.vstack([trace.points, trace.points[::-1] - band * trace.back])
            self.fill(outline, color=COLOURS[1], lw=0)
        if not texts:
            return
        self.named.setdefault(", ".join(texts), []).append(trace.points)
        self.line(trace.points, _ADDED_INK, 3.0)
        if surface.roughness or surface.haze:  # like the profile of a rough face, outside of it
            profile = trace.points - 0.25 * band * trace.back
            (line,) = self.ax.plot(*profile.T, color=_ADDED_INK, lw=0.8)
            line.set_sketch_params(scale=3, length=20, randomness=6)

    def fill(self, outline: np.ndarray, **look: Any) -> None:
        """Fill a polygon (mm, shape (n, 2)); the limits are set, and need not be found of it."""
        self.ax.add_artist(Polygon(outline, **look))

    def in_cells(self, points: np.ndarray) -> np.ndarray:
        """Points (mm) in units of cells from the lower left corner, shape (n, 2)."""
        return (self.ax.transData.transform(points) - self.box.p0) / _CELL

    def cells_of(self, line: np.ndarray) -> np.ndarray:
        """Columns and rows, shape (n, 2), of the cells that a line (mm, (n, 2)) goes through."""
        shape = np.array(self.owner.shape[::-1])
        # far ends may lie anywhere outside: to cut them off there would turn the line
        ends = self.in_cells(line)
        steps = np.diff(ends, axis=0)
        counts = np.minimum(2 + np.abs(steps).max(axis=1), _MOST_CELLS).astype(int)
        part = np.repeat(np.arange(len(counts)), counts)
        share = (np.arange(len(part)) - (np.cumsum(counts) - counts)[part]) / (counts - 1)[part]
        cells = np.floor(ends[part] + share[:, None] * steps[part]).astype(int)
        return cells[((cells >= 0) & (cells < shape)).all(axis=1)]

    def line(self, points: np.ndarray, colour: str, width: float) -> None:
        """Draw a line (mm, shape (n, 2)) that labels stay clear of."""
        points = np.round(points, 5)  # single precision would make a straight line wriggle
        self.ax.plot(*points.T, color=colour, lw=width, solid_capstyle="butt")
        self.taken[*self.cells_of(points).T[::-1]] = True

    def avoid(self, path: np.ndarray) -> None:
        """Let labels avoid a path (mm, shape (n, 2)) where they can, and its ends always."""
        self.crossed[*self.cells_of(path).T[::-1]] = True
        for end in self.in_cells(path[[0, -1]]).astype(int).clip(0):
            self._take_around(end, 3)

    def _take_around(self, cell: np.ndarray, near: int) -> None:
        """Let labels keep away from the square around a cell, column and row, by so many cells."""
        rows, columns = (slice(max(i - near, 0), i + near + 1) for i in cell[::-1])
        self.taken[rows, columns] = True

    def measure(self) -> None:
        """Draw arrows with dimensions across all that begins and ends in view on two lines."""
        limits = np.array([self.ax.get_xlim(), self.ax.get_ylim()])
        # an upright line beside the crystal's edge (x is fixed), and a level one above it
        for axis, share in ((0, 0.49), (1, 0.8)):
            at, (low, high) = limits[axis] @ (1 - share, share), limits[1 - axis]
            levels = self.cut.levels(at, axis)
            for ends in pairwise(levels[(levels > low) & (levels < high)]):
                line = np.insert(np.array(ends)[:, None], axis, at, axis=1)
                arrow = {"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0}
                self.ax.annotate("", line[0], line[1], arrowprops=arrow)
                self.line(line, "none", 0.0)
                column, row = middle = self.in_cells(line).mean(axis=0).astype(int)
                volume = self.owner[row, column]
                text = f"{np.ptp(ends):.3g} mm" if volume else f"air, {np.ptp(ends):.3g} mm"
                self.place([text], middle[None], volume, beside=True, leader=False)

    def label(self, brief: bool = False) -> None:
        """Name everything in view: volumes inside if there is room, all else beside by a leader."""
        # texts, cells that a leader may point to, and the volume that it may go through
        named = self.named.items()
        beside = [([text], np.vstack([*map(self.cells_of, lines)]), 0) for text, lines in named]
        for volume in sorted({region.volume for region in self.cut.regions}):
            texts, inside = self.texts(volume, brief), self.owner == volume
            if not self.place(texts, np.argwhere(inside)[:, ::-1], volume):
                # cells that are not at its edge, unless it is thin
                cells = np.argwhere(binary_erosion(inside, iterations=3))[:, ::-1]
                cells = cells if len(cells) else self.cells_of(self.cut.corners(volume))
                beside.append((texts, cells, volume))
        for texts, cells, volume in beside:
            self.place(texts, cells, volume, beside=True)
        self.place(["air, n = 1"], np.array([self.owner.shape[::-1]]), 0)

    def texts(self, volume: int, brief: bool) -> list[str]:
        """What to say of a volume, longest first: its size if `brief`, else coefficients too."""
        medium, (wide, tall) = self.model.volumes[volume], np.ptp(self.cut.corners(volume), axis=0)
        index, size = self.indices.get(medium.name), f"{wide:.4g} mm wide, {tall:.4g} mm high"
        name = medium.name + (f", n = {index:g}" if index else "")
        scattering, absorption = 10 * medium.alpha_scat_per_mm, 10 * medium.alpha_abs_per_mm  # 1/cm
        if brief or not (scattering or absorption):
            return [f"{name}, {size}", name]
        coefficients = f"scatters {scattering:.4g} /cm", f"absorbs {absorption:.4g} /cm"
        return ["\n".join([name, size, *coefficients]), ", ".join([name, *coefficients])]

    def place(
        self,
        texts: Sequence[str],
        targets: np.ndarray,
        volume: int,
        beside: bool = False,
        leader: bool = True,
    ) -> bool:
        """Write the first text that fits, near to one of the cells `targets`, shape (n, 2).

        It lies in `volume` near the middle of the targets, or (`beside`) in air too near one of
        them, with a leader to it. False if there is no target or no place.
        """
        if not len(targets):
            return False
        few = targets[:: len(targets) // _MOST_TARGETS + 1] + 0.5
        targets = few if beside else targets.mean(axis=0)[None]
        room = ~self.taken & ((self.owner == volume) | (beside & (self.owner == 0)))
        look: dict[str, Any] = {"size": 10.5, "va": "bottom", "zorder": 6}
        for text in texts:
            artist = self.ax.text(0, 0, text, parse_math=False, **look)
            w, h = size = (artist.get_window_extent().size + 2 * _CLEAR).astype(int) // _CELL + 1
            # lower left corners of rectangles that are free, (places, 1, 2)
            low = np.argwhere(_count_in_rectangles(room, w, h) == w * h)[:, None, ::-1]
            if not len(low):
                artist.remove()
                continue
            low = low[:: len(low) // _MOST_PLACES + 1] if beside else low
            # (places, targets, 2): the point of the text's rectangle that is next to the target, or
            # its middle
            start = np.clip(targets, low, low + size - 1) if beside else low + size / 2
            on_paths = _count_in_rectangles(self.crossed, w, h)[low[..., 1], low[..., 0]]
            if beside and leader:
                cost = self._cost_of_leader(start, targets, volume, on_paths)
            else:
                cost = np.linalg.norm(start - targets, axis=2) + _ON_PATH * on_paths
            best, target = np.unravel_index(cost.argmin(), cost.shape)
            (column, row), corner = low[best, 0], low[best, 0] + _CLEAR / _CELL
            points = np.array([corner, start[best, target], targets[target]]) * _CELL + self.box.p0
            corner, *link = self.ax.transData.inverted().transform(points)
            artist.set_position(corner)
            if on_paths[best].any():  # else it would only hide what it names
                artist.set_bbox(paper(0.7, 1.0))
            if beside and leader:
                self.line(np.array(link), INK, 0.8)
                self.ax.plot(*link[1], "o", color=INK, markersize=4, markeredgecolor="white")
                self._take_around(targets[target].astype(int), _AROUND_END)
            self.taken[row : row + h, column : column + w] = True
            return True
        return False

    def _cost_of_leader(
        self, start: np.ndarray, targets: np.ndarray, volume: int, on_paths: np.ndarray
    ) -> np.ndarray:
        """What leaders from (places, targets, 2) to (targets, 2) cells cost: (places, targets).

        Each text lies on `on_paths` cells of paths, (places, 1), too. Infinite where another is
        cheaper whatever the leader lies on.
        """
        length = np.linalg.norm(start - targets, axis=2)
        height = np.abs(start - targets)[..., 1]
        least = np.abs(length - _LEADER) + np.maximum(_LEAST_HEIGHT - height, 0)
        least += _ON_PATH * on_paths
        on_cell = _ON_SOMETHING * (self.taken | ~np.isin(self.owner, (0, volume)))
        cost, bound = np.full_like(least, np.inf), np.quantile(least, 0.01)
        for _ in range(2):  # the cheapest few, and those that may be cheaper than the best of them
            near = np.nonzero(least <= bound)
            begin, away = start[near], targets[near[1]] - start[near]
            shares = np.linspace(0, _LOOKED_AT, _POINTS)[:, None, None]
            columns, rows = np.moveaxis((begin + shares * away).astype(int), -1, 0)
            cost[near] = least[near] + on_cell[rows, columns].sum(axis=0)
            bound = cost.min()
        return cost


def _count_in_rectangles(cells: np.ndarray, wide: int, tall: int) -> np.ndarray:
    """How many of `cells` (bool) are set in the rectangle above and to the right of each."""
    # by sums over all cells to the left and below, of which four tell a rectangle's
    sums = np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[tall:, wide:] - sums[:-tall, wide:] - sums[tall:, :-wide] + sums[:-tall, :-wide]


# A few photons' paths for the cross-section: short ones of every fate that matters.

#: Fates of less of the light are not shown.
LEAST_SHARE = 0.01
#: Fates of more of the light get two paths.
COMMON_SHARE = 0.15
#: Flights of a path that is easily followed.
_WANTED_FLIGHTS = 5
#: Flights that are drawn of longer paths.
MOST_FLIGHTS = 16
#: How far an escaping photon's last flight is drawn, over the scene's size.
_AWAY = 0.16
#: Length over the scene's size that is long enough to be seen.
_SEEN = 0.4
#: Photons to choose from.
_CANDIDATES = 50
_PER_ROW = 5
_TITLE = (
    "Photons' paths, projected on the plane, and how much of the light meets the same fate "
    f"(of {LANES:,} photons)"
)
_HALO = patheffects.withStroke(linewidth=2.6, foreground="white", alpha=0.75)


@dataclass(frozen=True)
class DrawnTrail:
    """A photon's path in the plane of the picture."""

    fate: str
    #: ndarray of float64, shape (n, 2): x and z in mm: birth, turns and end.
    points: np.ndarray
    #: Whether it goes on for longer than is drawn.
    trapped: bool


def chosen_paths(
    simulation: Simulation, view: np.ndarray | None
) -> tuple[tuple[DrawnTrail, ...], dict[str, float]]:
    """Paths to be drawn, and the share of the light of every fate that is shown.

    The same for the same scene. Of each fate a path of few flights is chosen, and of common fates
    one that has as many as is typical; they stay near the plane of the picture and keep away from
    other paths. One path goes through `view`, lowest and highest x and z (mm) of what is enlarged,
    shape (2, 2), if it can.
    """
    from mcrim_mitsuba.transport.collection import follow_trails

    trails, size = follow_trails(simulation), simulation.model.size_mm
    middle = (simulation.crystal.lower[1] + simulation.crystal.upper[1]) / 2
    shares = {f: s for f, s in trails.shares.items() if s >= LEAST_SHARE}
    ways, paths = trails.ways(MOST_FLIGHTS, _AWAY * size), list[DrawnTrail]()
    for fate in ordered(shares):
        lines, flights = ways[trails.fates == fate], trails.flights[trails.fates == fate]
        wanted_flights = [_WANTED_FLIGHTS]
        if shares[fate] >= COMMON_SHARE:
            wanted_flights.append(np.median(flights))
        for wanted in wanted_flights:
            costs = _costs_alone(lines, middle, size) + np.abs(np.log(flights / wanted))
            if view is not None:
                # through its middle, or at least through a corner
                inner = view.mean(axis=0) + 0.5 * (view - view.mean(axis=0))
                costs -= 1.5 * _through(lines, inner) + _through(lines, view)
            best = np.argsort(costs, kind="stable")[:_CANDIDATES]
            others = [_sampled(path.points) for path in paths]
            apart = [costs[i] + _nearness(_flat(lines[i]), others, size) for i in best]
            chosen = best[int(np.argmin(apart))]
            if view is not None and _through(lines[[chosen]], view)[0]:
                view = None
            trapped = bool(flights[chosen] > MOST_FLIGHTS)
            paths.append(DrawnTrail(fate, _flat(lines[chosen]), trapped))
            lines, flights = np.delete(lines, chosen, axis=0), np.delete(flights, chosen)
    return tuple(paths), shares


def _flat(line: np.ndarray) -> np.ndarray:
    """x and z, shape (n, 2), of the points of a way, as far as it goes."""
    return line[np.isfinite(line[:, 0])][:, [0, 2]]


def _segments(lines: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Begin and end of all lines' segments, shape (n, 3), and which line each is of."""
    there = np.isfinite(lines[:, 1:, 0])
    return lines[:, :-1][there], lines[:, 1:][there], np.nonzero(there)[0]


def _costs_alone(lines: np.ndarray, middle: float, size: float) -> np.ndarray:
    """What speaks against each line: far from y = `middle`, much that is hidden, too short."""
    begin, end, owner = _segments(lines)
    steps = end - begin
    lengths = (np.linalg.norm(part, axis=1) for part in (steps, steps[:, ::2]))
    length, seen = (np.bincount(owner, of_steps, len(lines)) for of_steps in lengths)
    aside = np.nanmax(np.abs(lines[..., 1] - middle), axis=1) / size
    # a path that ends where it began has no length
    hidden = 1.5 * (1.0 - seen / np.maximum(length, 1e-9 * size))
    return aside + hidden + 3.0 * np.maximum(0.0, _SEEN - seen / size)


def _through(lines: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Whether each line goes through a rectangle in x and z, shape (lines,), bool."""
    begin, end, owner = _segments(lines)
    begin, step = begin[:, ::2], (end - begin)[:, ::2]
    # (2, segments, 2): where along a segment it meets the borders, 0 at its begin and 1 at its end
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = (view[:, None] - begin) / step
    # inside are those that have entered both strips, in x and in z, and left neither
    enter = np.nanmax(crossings.min(axis=0), axis=1)
    leave = np.nanmin(crossings.max(axis=0), axis=1)
    met = (enter < leave) & (leave > 0.0) & (enter < 1.0)
    return np.bincount(owner, met, len(lines)) > 0


def _nearness(points: np.ndarray, others: list[np.ndarray], size: float) -> float:
    """How close a line (x, z) comes to others, given by samples, and their ends to each other."""
    samples, cost = _sampled(points), 0.0
    for other in others:
        away = np.linalg.norm(samples[:, None] - other, axis=2).min(axis=1) / size
        ends = np.linalg.norm(samples[-1] - other[-1]) / size
        cost += 0.5 * float(np.exp(-8.0 * away).mean()) + 0.3 * float(np.exp(-6.0 * ends))
    return cost


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points along a line, six on each of its segments, shape (n, 2)."""
    share = np.linspace(0.0, 1.0, 6)[:, None]
    return (points[:-1, None] + share * np.diff(points, axis=0)[:, None]).reshape(-1, 2)


def draw_path(ax: Axes, path: DrawnTrail) -> None:
    """Draw a path behind all labels: an open dot where it begins, the fate's marker at its end."""
    style = fate_style(path.fate)
    look: dict[str, Any] = {"color": style.line, "ls": style.dashes, "lw": 1.3, "zorder": 3}
    look |= {"solid_joinstyle": "round", "dash_joinstyle": "round", "path_effects": [_HALO]}
    ax.plot(*path.points.T, **look)
    ax.plot(*path.points[0], **_BIRTH)
    ax.plot(*path.points[-1], **_end(path.fate, path.trapped, path.points))


_BIRTH: dict[str, Any] = {"marker": "o", "ms": 4.5, "mfc": "white", "mec": INK, "mew": 1.1}
_BIRTH |= {"zorder": 3.2, "ls": ""}


def _end(fate: str, trapped: bool, points: np.ndarray | None = None) -> dict[str, Any]:
    """How a path's end is marked: filled where the photon ended, open where it goes on."""
    style = fate_style(fate)
    marker: str | tuple[int, int, float] = style.marker
    if fate == "escaped" and points is not None:
        across, up = points[-1] - points[-2]
        # three corners, a plain polygon, turned from pointing upwards
        marker = (3, 0, float(np.degrees(np.arctan2(up, across))) - 90.0)
    look: dict[str, Any] = {"mfc": style.line, "mec": "white", "mew": 0.8}
    if trapped:
        look = {"mfc": "white", "mec": style.line, "mew": 1.4}
    return look | {"marker": marker, "ms": 7.5, "zorder": 3.4, "ls": ""}


def _handles(paths: tuple[DrawnTrail, ...], shares: dict[str, float]) -> list[Line2D]:
    """The legend's entries: birth, and every fate with its share of the light."""
    handles = [Line2D([], [], label="birth", **_BIRTH)] if paths else []
    for fate in ordered(shares):
        style, percent = fate_style(fate), 100 * shares[fate]
        # no digit that so few photons do not know
        sigma = 100 * math.sqrt(shares[fate] * (1.0 - shares[fate]) / LANES)
        label = f"{style.words}, {percent:.{0 if sigma > 0.1 else 1}f} %"
        look = _end(fate, False) | {"color": style.line, "lw": 1.4, "ls": style.dashes}
        handles.append(Line2D([], [], label=label, **look))
    if any(path.trapped for path in paths):
        look = _end("detected", True) | {"mec": INK}
        handles.append(Line2D([], [], label=f"open: goes on after {MOST_FLIGHTS} flights", **look))
    return handles


# The picture: a panel to scale and, where something is thin, an enlarged one.

#: Suffixes of the pictures that can be drawn.
SUFFIXES = (".png", ".svg", ".pdf")

_FRAME = "#d95f02"
#: Inches of the figure, of a brief one, of its margins and of the enlarged part.
_WIDTH_IN = 12.0
_BRIEF_IN = 7.0
_MARGIN_IN = 0.85
_DETAIL_IN = 2.6
_DPI = 150


def write_cross_section(figure: Figure, path: str | Path) -> None:
    """Write a figure: PNG (1800 pixels wide), SVG or PDF by the suffix; a file there is replaced.

    Raises InputError if the suffix is another one or the file cannot be written.
    """
    path = Path(path)
    refuse_suffix(path, SUFFIXES, "a cross-section cannot be drawn as")
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.lower()[1:], dpi=_DPI)
    write_bytes(path, content.getvalue())


def draw_check(checked: CheckResult) -> Drawing:
    """The cross-section of a checked scene, what is wrong with it in red.

    Where such a scene cannot be assembled it is drawn without the override that is wrong, or with 1
    for a parameter that is; where that is no scene either, what is wrong is written, with its line.
    """
    from mcrim_mitsuba.transport.simulation import Simulation

    faults, run = checked.problems, checked.run
    words = {word for fault in faults for word in re.findall(r"\w+", fault.text)}
    named = checked.parameters.keys() & words - checked.overrides.keys()
    right = {name: value for name, value in checked.overrides.items() if name not in words}
    for overrides in (checked.overrides, {**right, **dict.fromkeys(named, 1.0)}):
        with contextlib.suppress(InputError):
            simulation = Simulation(
                checked.scene, overrides, variant=run.variant, threads=run.threads, check=False
            )
            faces = interfaces_of(simulation.file, simulation.model)
            return Drawing(cross_section_figure(simulation, faces, faults=faults))
    lines = []
    for fault in faults:  # of which there are some: what is sound can be assembled
        lines += ["", *textwrap.wrap(visible(str(fault)), 100)]
        if fault.line is not None and fault.path is not None:
            text = Path(fault.path).read_text(encoding="utf-8", errors="replace").splitlines()
            lines.append(f"{fault.line:5}  {visible(text[fault.line - 1])[:90]}")
    figure = Figure(figsize=(_WIDTH_IN, 0.4 + 0.26 * len(lines)), dpi=_DPI)
    FigureCanvasAgg(figure)
    look: dict[str, Any] = {"color": _FAULT, "size": 11, "family": "monospace", "va": "center"}
    figure.text(0.02, 0.5, "\n".join(lines), parse_math=False, **look)
    return Drawing(figure)


def _faulty_surfaces(
    model: SceneModel, interfaces: Sequence[Interface], fault: SceneProblem
) -> set[int]:
    """Indices of the surfaces that a problem names, or of those around a volume that it names.

    Where it names neither, parts of its words count: ``gap_mm`` is of the gap, ``alpha`` of the
    crystal.
    """
    words = set(re.findall(r"\w+", fault.text.replace("alpha_", "crystal_alpha_")))
    words |= {face.surface for face in interfaces if face.line == fault.line}
    for names in (words, {part for word in words for part in word.split("_")}):
        surfaces = {i for i, surface in enumerate(model.surfaces) if surface.name in names}
        volumes = [i for i, name in enumerate(model.volume_names) if i and name in names]
        if surfaces or volumes:
            return surfaces or {i for volume in volumes for i in model.bordering(volume)}
    return set()


def cross_section_figure(
    simulation: Simulation,
    interfaces: tuple[Interface, ...],
    *,
    brief: bool = False,
    faults: Sequence[SceneProblem] = (),
) -> Figure:
    """A loaded scene to scale in the vertical plane through the middle of its crystal.

    A second panel enlarges the thinnest layer at the crystal's lower edge, where there is one. Both
    show a few photons' paths, projected on the plane; the same scene gives the same ones. A crystal
    that lies is cut across its axis as well. If `brief`, it is for a narrow column, without paths,
    second panel and heading. What `faults` are about is red; no light goes through such a scene.
    `interfaces` come from `transport.check.interfaces_of`: they know the indices.
    """
    crystal, file, model = simulation.crystal, simulation.file, simulation.model
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    width_in, above_in = (_BRIEF_IN, 0.4) if brief else (_WIDTH_IN, 1.75)
    box, inner_in = model.scene.bbox(), width_in - 1.5 * _MARGIN_IN
    (middle_x, middle_y, middle_z), (wide, _, tall) = map(np.array, (box.center(), box.extents()))
    # with inches of air for labels
    per_mm = min((inner_in - 2.0) / wide, (2.8 if brief else 4.6) / tall)
    main_in = max(tall * per_mm + 1.5, 2.9)
    closer_x, closer_z, closer_half = closer_view(cut, crystal.volume)
    times = round(_DETAIL_IN / 2 / closer_half / per_mm, 1)
    # a crystal that lies along x shows what it is across that
    lies = not brief and any(wall.circle.axis == 0 for wall in model.walls)
    first_in = _MARGIN_IN + lies * (main_in + 0.9)
    below_in, frame = first_in, None
    if times > 1.3 and not brief:  # else the second panel would show hardly more
        below_in += _DETAIL_IN + 0.9
        reach = closer_half * np.array([inner_in / _DETAIL_IN, 1.0])
        frame = np.array([closer_x, closer_z]) + np.multiply.outer([-1, 1], reach)
    faulty = set().union(*(_faulty_surfaces(model, interfaces, fault) for fault in faults))
    paths, shares = ((), {}) if brief or faults else chosen_paths(simulation, frame)
    handles = _handles(paths, shares)
    words = "\n".join(textwrap.fill(visible(str(fault)), 130) for fault in faults)
    lines = -(-len(handles) // _PER_ROW) + words.count("\n")
    height_in = below_in + main_in + above_in + 0.22 * lines
    figure = FigureCanvasAgg(Figure((width_in, height_in), _DPI)).figure  # which measures texts
    if not brief:
        _write_above(figure, file, handles if paths else (), words)

    def panel(
        cut: CrossSection, bottom_in: float, tall_in: float, x: float, z: float, half: float
    ) -> SectionAxes:
        """Axes so high above the figure's lower edge, and so tall, about x and z +- half (mm)."""
        place = np.array([_MARGIN_IN, bottom_in, inner_in, tall_in])
        ax = figure.add_axes(place / np.tile([width_in, height_in], 2))
        ax.set_xlabel(f"{'yx'[cut.normal]} (mm)")
        wide = half * inner_in / tall_in
        ax.set(xlim=(x - wide, x + wide), ylim=(z - half, z + half), ylabel="z (mm)")
        ax.set_title(_plane(cut, model), size=11, loc="left")
        section = SectionAxes(ax, cut, model, interfaces)
        for trace in cut.traces:
            if trace.surface in faulty:
                section.line(trace.points, _FAULT, 4.0)
                section.named.setdefault("here", []).append(trace.points)
        for path in paths if cut.normal else ():
            draw_path(ax, path)
            section.avoid(path.points)
        return section

    half = main_in / 2 / per_mm
    main = panel(cut, below_in, main_in, middle_x, middle_z, half)
    if lies:
        across = cross_section(model, float(crystal.lower[0] + crystal.upper[0]) / 2, normal=0)
        panel(across, _MARGIN_IN, main_in, middle_y, middle_z, half).label()
    if frame is not None:
        detail = panel(cut, first_in, _DETAIL_IN, closer_x, closer_z, closer_half)
        title = f"The frame above, enlarged {times:g} times, alike in both directions"
        detail.ax.set_title(title, size=11, loc="left")
        detail.measure()
        detail.label(brief=True)
        # corners come from left to right, the lower one first: here they go around
        rim = detail.ax.viewLim.corners()[[0, 1, 3, 2, 0]]
        main.line(rim, _FRAME, 1.5)
        main.named[f"enlarged {times:g} times below"] = [rim]
    main.label()
    return figure


def _plane(cut: CrossSection, model: SceneModel) -> str:
    """Where the plane of a panel lies, and that it misses the mask where it does."""
    plane = f"Vertical plane {'xy'[cut.normal]} = {cut.level_mm:.3g} mm, to scale"
    has_mask = np.isfinite([surface.aperture_radius_mm for surface in model.surfaces]).any()
    missed = has_mask and not masked(model, cut)
    return f"{plane}; the black mask does not reach it" if missed else plane


def _write_above(figure: Figure, file: SceneFile, handles: Sequence[Line2D], faults: str) -> None:
    """The scene's name with its parameters, and the legend of the paths or what is wrong."""
    height_in = figure.get_figheight()
    title, shown = heading(file.path.name, file.overrides, file.parameters, "=", 150, 3)
    style: dict[str, Any] = {"ha": "center", "va": "top", "color": INK, "linespacing": 1.4}
    style["parse_math"] = False
    figure.text(0.5, 1 - 0.18 / height_in, title, size=16, weight="bold", **style)
    figure.text(0.5, 1 - 0.55 / height_in, shown, size=9.5, **style)
    if faults:
        figure.text(0.5, 1 - 1.15 / height_in, faults, size=11, **style | {"color": _FAULT})
    if handles:
        look: dict[str, Any] = {"fontsize": 9.5, "title": _TITLE, "title_fontsize": 9.5}
        look |= {"frameon": False, "handlelength": 2.6, "columnspacing": 1.4, "borderaxespad": 0.0}
        place: dict[str, Any] = {"loc": "upper center", "ncols": _PER_ROW}
        place["bbox_to_anchor"] = (0.5, 1 - 1.2 / height_in)
        figure.legend(handles=handles, **place, **look)


def heading(
    name: str,
    overrides: Iterable[str],
    parameters: Mapping[str, Value],
    equals: str = "\xa0=\xa0",
    letters: int = 190,
    most_lines: int = 2,
) -> tuple[str, str]:
    """Title and parameters of a scene as they stand above its picture."""
    changed = ", ".join(said(key, parameters[key]) for key in overrides)
    title = textwrap.shorten(f"{name} {changed and 'with'} {changed}", 90)
    # in small print, as they may be typed; a line ends between parameters
    shown = ",  ".join(
        f"{key}{equals}{f'{value:g}' if isinstance(value, float) else str(value).lower()}"
        for key, value in parameters.items()
    )
    return title, textwrap.fill(shown, letters, max_lines=most_lines, placeholder=" …")


def closer_view(cut: CrossSection, crystal: int) -> tuple[float, float, float]:
    """x, z, half the height (mm) about the thinnest volume or layer at the crystal's lower edge."""
    corners = {region.volume: cut.corners(region.volume) for region in cut.regions}
    boxes = {volume: (c.min(axis=0), c.max(axis=0)) for volume, c in corners.items()}
    if crystal not in boxes:  # it is not closed: nothing to be seen
        return 0.0, 0.0, np.inf
    (_, bottom), size, outline = boxes[crystal][0], np.ptp(boxes[crystal]), cut.corners(crystal)
    # the lower edge's right end; tolerances are of the single precision of the scene
    x = outline[outline[:, 1] <= bottom + 1e-6 * size, 0].max()
    # thickness, lowest and highest corner: of volumes area over length
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
