"""A vertical cross-section of a loaded scene, to scale, with what light meets where.

A few photons' paths, traced by the transport itself, show which fates light meets.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Sequence
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
from matplotlib.text import Text
from scipy.ndimage import binary_erosion

from mcrim_mitsuba.core.files import refuse_suffix, write_bytes
from mcrim_mitsuba.core.numbers import said
from mcrim_mitsuba.output.figure_style import fate_style, ordered
from mcrim_mitsuba.transport.check import volume_indices
from mcrim_mitsuba.transport.cut import CrossSection, cross_section, masked
from mcrim_mitsuba.transport.launch_plan import LANES
from mcrim_mitsuba.transport.scene_model import SceneModel

if TYPE_CHECKING:
    from mcrim_mitsuba.scene.check_text import Interface
    from mcrim_mitsuba.scene.scene_file import SceneFile
    from mcrim_mitsuba.transport.collection import Trail
    from mcrim_mitsuba.transport.simulation import Simulation


# Calm, and of different lightness, so that a grey print still tells neighbours apart.
COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
#: Colours of lines: of most, of the detector, of what is neither volume nor detector.
INK = "#222222"
_DETECTOR = "#b3261e"
_OTHER = "#777777"
#: Pixels of a cell of the grid on which labels find their place.
_CELL = 3
#: Pixels of the space beside and above a label.
_CLEAR = np.array([8, 4])


@dataclass(frozen=True, kw_only=True)
class _Placing:
    """How a label's place is chosen; lengths and penalties in cells of the grid."""

    #: Targets and places that are tried at most: more are thinned out.
    most_targets: int = 40
    most_places: int = 5000
    #: A leader is best that long, and at least so high: long enough to be seen, rather steep.
    leader: float = 14.0
    height: float = 10.0
    #: Points of a leader, from its beginning to this part of it, that are looked at, and what each
    #: costs that lies on a line or in a volume that is not meant.
    points: int = 9
    looked_at: float = 0.8
    on_something: float = 20.0
    #: What each cell of a photon's path under the label costs.
    on_path: float = 0.7
    #: Half the side of the square around a leader's end that other labels leave free.
    around_end: int = 5


_PLACING = _Placing()


class SectionAxes:
    """Axes with the cross-section, and a grid of cells on which labels find free places."""

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
        self.named: dict[str, list[np.ndarray]] = {}
        shape = int(self.box.height // _CELL) + 1, int(self.box.width // _CELL) + 1
        self.owner, self.taken = np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool)
        self.crossed = np.zeros(shape, dtype=bool)
        rows, columns = np.ogrid[0.5 : shape[0], 0.5 : shape[1]]
        for region in cut.regions:
            ax.fill(*region.outline.T, color=colours[region.volume % len(colours) - 1], lw=0.2)
            low, high = np.split(self.cells(region.outline), 2)
            low, high = (
                np.interp(columns, side[:, 0], side[:, 1], np.inf, np.inf)
                for side in (low, high[::-1])
            )
            self.owner[(low < rows) & (rows < high)] = region.volume
        styles = {
            "dielectric": (INK, 0.8),
            "diffuse reflector": (INK, 1.5),
            "detector": (_DETECTOR, 5.0),
        }
        band = 16 * np.diff(ax.get_ylim()) / self.box.height  # mm: as thick as 16 pixels
        for trace in cut.traces:
            face, kind = model.surfaces[trace.surface], interfaces[trace.surface].kind
            text, percent = kind, 100 * face.reflectance
            if percent > 0:
                text = f"{face.name}: {kind}, {percent:.3g} %"
                far = trace.points[::-1] + band * trace.back
                ax.fill(*np.vstack([trace.points, far]).T, fc="white", ec=INK, hatch="/" * 6, lw=0)
                self.line(far, "none", 0.0)
            if kind != "dielectric":
                self.named.setdefault(text, []).append(trace.points)
            self.line(trace.points, *styles.get(kind, (_OTHER, 3.0)))
        for trace in masked(model, cut):
            radius = model.surfaces[trace.surface].aperture_radius_mm
            self.named.setdefault(f"black mask, hole radius {radius:g} mm", []).append(trace.points)
            self.line(trace.points, "black", 5.0)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Points (mm) in units of cells from the lower left corner, shape (n, 2)."""
        return (self.ax.transData.transform(points) - self.box.p0) / _CELL

    def on(self, points: np.ndarray) -> np.ndarray:
        """Columns and rows, shape (n, 2), of the cells that a line goes through."""
        shape = np.array(self.owner.shape[::-1])
        ends = np.clip(self.cells(points), -10, shape + 10)
        parts = [np.linspace(a, b, 2 + int(np.abs(b - a).max())) for a, b in pairwise(ends)]
        cells = np.floor(np.concatenate(parts)).astype(int)
        return cells[((cells >= 0) & (cells < shape)).all(axis=1)]

    def line(self, points: np.ndarray, colour: str, width: float) -> None:
        """Draw a line (mm, shape (n, 2)) that labels stay clear of."""
        points = np.round(points, 5)  # single precision would make a straight line wriggle
        self.ax.plot(*points.T, color=colour, lw=width, solid_capstyle="butt")
        self.taken[tuple(self.on(points).T[::-1])] = True

    def cross(self, points: np.ndarray) -> None:
        """Let labels avoid a line (mm, shape (n, 2)) where they can, and its ends always."""
        self.crossed[tuple(self.on(points).T[::-1])] = True
        for x, z in self.cells(points[[0, -1]]).astype(int).clip(0):
            self.taken[max(z - 3, 0) : z + 4, max(x - 3, 0) : x + 4] = True

    def measure(self) -> None:
        """Arrows with dimensions across all that begins and ends in view on two lines."""
        limits = np.array([self.ax.get_xlim(), self.ax.get_ylim()])
        for axis, share in ((0, 0.49), (1, 0.8)):  # beside the crystal's edge, and above it
            at, (low, high) = limits[axis] @ (1 - share, share), limits[1 - axis]
            levels = self.cut.levels(at, axis)
            for ends in pairwise(levels[(levels > low) & (levels < high)]):
                line = np.insert(np.array(ends)[:, None], axis, at, axis=1)
                arrow = {"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0}
                self.ax.annotate("", line[0], line[1], arrowprops=arrow)
                self.line(line, "none", 0.0)
                cell = self.cells(line).mean(axis=0).astype(int)
                volume = self.owner[cell[1], cell[0]]
                text = f"{np.ptp(ends):.3g} mm" if volume else f"air, {np.ptp(ends):.3g} mm"
                self.place([text], cell[None], volume, beside=True, leader=False)

    def label(self, brief: bool = False) -> None:
        """Name everything in view."""
        outside = [([t], np.vstack([*map(self.on, lines)]), 0) for t, lines in self.named.items()]
        for volume in sorted({region.volume for region in self.cut.regions}):
            texts, its_cells = self.texts(volume, brief), self.owner == volume
            if not its_cells.any() or not self.place(
                texts, np.argwhere(its_cells)[:, ::-1], volume
            ):
                cells = np.argwhere(binary_erosion(its_cells, iterations=3))[:, ::-1]
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

    def place(
        self,
        texts: Sequence[str],
        targets: np.ndarray,
        volume: int,
        beside: bool = False,
        leader: bool = True,
    ) -> bool:
        """Write the first text that fits, near to one of the cells `targets`, shape (n, 2).

        It lies in `volume`, or (`beside`) in air too, with a leader. False if there is no place.
        """
        if not len(targets):
            return False
        few = targets[:: len(targets) // _PLACING.most_targets + 1] + 0.5
        targets = few if beside else targets.mean(axis=0)[None]
        room = ~self.taken & ((self.owner == volume) | (beside & (self.owner == 0)))
        for text in texts:
            artist = self._text(text)
            w, h = size = (artist.get_window_extent().size + 2 * _CLEAR).astype(int) // _CELL + 1
            # lower left corners of rectangles that are free, (places, 1, 2)
            low = np.argwhere(_within(room, w, h) == w * h)[:, None, ::-1]
            if not len(low):
                artist.remove()
                continue
            low = low[:: len(low) // _PLACING.most_places + 1] if beside else low
            # from the point of the text's rectangle that is next to the target, or its middle
            start = np.clip(targets, low, low + size - 1) if beside else low + size / 2
            cost = np.linalg.norm(start - targets, axis=2)
            if beside and leader:
                cost = self._cost_of_leader(start, targets, volume)
            on_paths = _within(self.crossed, w, h)[low[..., 1], low[..., 0]]
            cost = cost + _PLACING.on_path * on_paths
            spot, target = np.unravel_index(cost.argmin(), cost.shape)
            (column, row), corner = low[spot, 0], low[spot, 0] + _CLEAR / _CELL
            ends = np.array([corner, start[spot, target], targets[target]]) * _CELL + self.box.p0
            corner, *link = self.ax.transData.inverted().transform(ends)
            artist.set_position(corner)
            if beside and leader:
                self._draw_leader(np.array(link), targets[target].astype(int))
            self.taken[row : row + h, column : column + w] = True
            return True
        return False

    def _text(self, text: str) -> Text:
        """A label, not yet at its place."""
        return self.ax.text(
            0,
            0,
            text,
            size=10.5,
            va="bottom",
            parse_math=False,
            zorder=6,
            bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.0},
        )

    def _cost_of_leader(self, start: np.ndarray, targets: np.ndarray, volume: int) -> np.ndarray:
        """What leaders from (places, targets, 2) to (targets, 2) cells cost: (places, targets)."""
        length = np.linalg.norm(start - targets, axis=2)
        height = np.abs(start - targets)[..., 1]
        cost = np.abs(length - _PLACING.leader) + np.maximum(_PLACING.height - height, 0)
        for share in np.linspace(0, _PLACING.looked_at, _PLACING.points):
            at = (start + share * (targets - start)).astype(int)
            at = at[..., 1], at[..., 0]
            meets = self.taken[at] | ~np.isin(self.owner[at], (0, volume))
            cost += _PLACING.on_something * meets
        return cost

    def _draw_leader(self, link: np.ndarray, end: np.ndarray) -> None:
        """Draw a leader (mm, shape (2, 2)) and keep the cells around its end, (2,), free."""
        self.line(link, INK, 0.8)
        self.ax.plot(*link[1], "o", color=INK, markersize=4, markeredgecolor="white")
        (x, z), near = end, _PLACING.around_end
        self.taken[max(z - near, 0) : z + near + 1, max(x - near, 0) : x + near + 1] = True


def _within(cells: np.ndarray, wide: int, tall: int) -> np.ndarray:
    """How many of `cells` (bool) are set in the rectangle above and to the right of each."""
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

    The same for the same scene. Among a fate's photons those are chosen that take few flights, or
    as many as is typical, stay near the plane of the picture and keep away from other paths.

    One path goes through `view`, lowest and highest x and z (mm) of what is enlarged, shape (2, 2),
    if it can.
    """
    from mcrim_mitsuba.transport.collection import follow_trails

    trails, size = follow_trails(simulation), simulation.model.size_mm
    middle = (simulation.crystal.lower[1] + simulation.crystal.upper[1]) / 2
    shares = {f: s for f, s in trails.shares.items() if s >= LEAST_SHARE}
    paths: list[DrawnTrail] = []
    for fate in ordered(shares):
        numbers = np.flatnonzero(trails.fates == fate)
        lines = [_line(trails.trail(number), size) for number in numbers.tolist()]
        flights = trails.flights[numbers]
        # one path that is easily followed, and of common fates a typical one
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
            apart = [costs[i] + _nearness(lines[i][:, [0, 2]], paths, size) for i in best]
            chosen = best[int(np.argmin(apart))]
            points, trapped = lines.pop(chosen), bool(flights[chosen] > MOST_FLIGHTS)
            flights = np.delete(flights, chosen)
            if view is not None and _through([points], view)[0]:
                view = None
            paths.append(DrawnTrail(fate, points[:, [0, 2]], trapped))
    return tuple(paths), shares


def _line(trail: Trail, size: float) -> np.ndarray:
    """Points (x, y, z) of a trail as it is drawn."""
    if trail.flights > MOST_FLIGHTS:
        return trail.points[: MOST_FLIGHTS + 1]
    if trail.fate == "escaped":
        # the flight after the last face has no end
        return np.vstack([trail.points[:-1], trail.points[-1] + _AWAY * size * trail.direction])
    return trail.points


def _segments(lines: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Begin and end of all lines' segments, shape (n, 3), and which line each is of."""
    owner = np.repeat(np.arange(len(lines)), [len(line) - 1 for line in lines])
    begin = np.concatenate([line[:-1] for line in lines])
    return begin, np.concatenate([line[1:] for line in lines]), owner


def _costs_alone(lines: list[np.ndarray], middle: float, size: float) -> np.ndarray:
    """What speaks against drawing each line: y that the picture hides, and too short a length."""
    begin, end, owner = _segments(lines)
    steps = end - begin
    length, seen = (
        np.bincount(owner, np.linalg.norm(part, axis=1), len(lines))
        for part in (steps, steps[:, ::2])
    )
    aside = np.array([np.abs(line[:, 1] - middle).max() for line in lines]) / size
    hidden = 1.5 * (1.0 - seen / np.maximum(length, 1e-9 * size))
    return aside + hidden + 3.0 * np.maximum(0.0, _SEEN - seen / size)


def _through(lines: list[np.ndarray], view: np.ndarray) -> np.ndarray:
    """Whether each line goes through a rectangle in x and z, shape (lines,), bool."""
    begin, end, owner = _segments(lines)
    begin, step = begin[:, ::2], (end - begin)[:, ::2]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = (view[:, None] - begin) / step
    enter = np.nanmax(crossings.min(axis=0), axis=1)
    leave = np.nanmin(crossings.max(axis=0), axis=1)
    met = (enter < leave) & (leave > 0.0) & (enter < 1.0)
    return np.bincount(owner, met, len(lines)) > 0


def _nearness(points: np.ndarray, others: list[DrawnTrail], size: float) -> float:
    """How close a line (x, z) comes to the paths that are there, and their ends to each other."""
    places, cost = _sampled(points), 0.0
    for other in others:
        there = _sampled(other.points)
        away = np.linalg.norm(places[:, None] - there, axis=2).min(axis=1) / size
        ends = np.linalg.norm(places[-1] - there[-1]) / size
        cost += 0.5 * float(np.exp(-8.0 * away).mean()) + 0.3 * float(np.exp(-6.0 * ends))
    return cost


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points along a line, shape (n, 2)."""
    share = np.linspace(0.0, 1.0, 6)[:, None]
    return np.vstack([a + share * (b - a) for a, b in pairwise(points)])


def draw_path(ax: Axes, path: DrawnTrail) -> None:
    """Draw a path behind all labels: an open dot where it begins, the fate's marker at its end."""
    style = fate_style(path.fate)
    ax.plot(
        *path.points.T,
        color=style.line,
        ls=style.dashes,
        lw=1.3,
        zorder=3,
        path_effects=[_HALO],
        solid_joinstyle="round",
        dash_joinstyle="round",
    )
    ax.plot(*path.points[0], **_BIRTH)
    ax.plot(*path.points[-1], **_end(path.fate, path.trapped, path.points))


_BIRTH: dict[str, Any] = {
    "marker": "o",
    "ms": 4.5,
    "mfc": "white",
    "mec": INK,
    "mew": 1.1,
    "zorder": 3.2,
    "ls": "",
}


def _end(fate: str, trapped: bool, points: np.ndarray | None = None) -> dict[str, Any]:
    """How a path's end is marked: filled where the photon ended, open where it goes on."""
    style = fate_style(fate)
    marker: str | tuple[int, int, float] = style.marker
    if fate == "escaped" and points is not None:
        across, up = points[-1] - points[-2]
        marker = (3, 0, float(np.degrees(np.arctan2(up, across))) - 90.0)
    face = "white" if trapped else style.line
    return {
        "marker": marker,
        "ms": 7.5,
        "mfc": face,
        "mec": style.line if trapped else "white",
        "mew": 1.4 if trapped else 0.8,
        "zorder": 3.4,
        "ls": "",
    }


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
#: Inches of the figure, of its margins and of the enlarged part.
_WIDTH_IN = 12.0
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


def cross_section_figure(simulation: Simulation, interfaces: tuple[Interface, ...]) -> Figure:
    """A loaded scene to scale in the vertical plane through the middle of its crystal.

    A second panel enlarges the thinnest layer at the crystal's lower edge, where there is one. Both
    show a few photons' paths, projected on the plane; the same scene gives the same ones.
    `interfaces` come from `transport.check.interfaces_of`: they know the indices.
    """
    crystal, file, model = simulation.crystal, simulation.file, simulation.model
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    box, inner_in = model.scene.bbox(), _WIDTH_IN - 1.5 * _MARGIN_IN
    (middle_x, _, middle_z), (wide, _, tall) = np.array(box.center()), np.array(box.extents())
    per_mm = min((inner_in - 2.0) / wide, 4.6 / tall)  # with inches of air for labels
    main_in = max(tall * per_mm + 1.5, 2.9)
    view = closer_view(cut, crystal.volume)
    times = round(_DETAIL_IN / 2 / view[2] / per_mm, 1)
    below_in, frame = _MARGIN_IN, None
    if times > 1.3:
        below_in += _DETAIL_IN + 0.9
        reach = view[2] * np.array([inner_in / _DETAIL_IN, 1.0])
        frame = np.array([view[:2] - reach, view[:2] + reach])
    paths, shares = chosen_paths(simulation, frame)
    handles = _handles(paths, shares)
    height_in = below_in + main_in + 1.75 + 0.22 * -(-len(handles) // _PER_ROW)
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)  # which measures texts
    _write_above(figure, file, handles if paths else ())

    def panel(
        bottom_in: float, tall_in: float, x: float, z: float, half: float, title: str
    ) -> SectionAxes:
        place = np.array([_MARGIN_IN, bottom_in, inner_in, tall_in])
        ax = figure.add_axes(place / np.tile([_WIDTH_IN, height_in], 2), xlabel="x (mm)")
        wide = half * inner_in / tall_in
        ax.set(xlim=(x - wide, x + wide), ylim=(z - half, z + half), ylabel="z (mm)")
        ax.set_title(title, size=11, loc="left")
        section = SectionAxes(ax, cut, model, interfaces)
        for path in paths:
            draw_path(ax, path)
            section.cross(path.points)
        return section

    title = f"Vertical plane y = {cut.y_mm:.3g} mm, to scale"
    if np.isfinite([s.aperture_radius_mm for s in model.surfaces]).any() and not masked(model, cut):
        title += "; the black mask does not reach it"
    main = panel(below_in, main_in, middle_x, middle_z, main_in / 2 / per_mm, title)
    if frame is not None:
        title = f"The frame above, enlarged {times:g} times, alike in both directions"
        detail = panel(_MARGIN_IN, _DETAIL_IN, *view, title)
        detail.measure()
        detail.label(brief=True)
        rim = detail.ax.viewLim.corners()[[0, 1, 3, 2, 0]]
        main.line(rim, _FRAME, 1.5)
        main.named[f"enlarged {times:g} times below"] = [rim]
    main.label()
    return figure


def _write_above(figure: Figure, file: SceneFile, handles: Sequence[Line2D]) -> None:
    """The scene's name with its parameters, and the legend of the paths, if there are any."""
    height_in = figure.get_figheight()
    changed = ", ".join(said(name, file.parameters[name]) for name in file.overrides)
    title = textwrap.shorten(f"{file.path.name} {changed and 'with'} {changed}", 90)
    # in small print, what may be typed
    typed = (
        f"{n}={v:g}" if isinstance(v, float) else f"{n}={str(v).lower()}"
        for n, v in file.parameters.items()
    )
    shown = textwrap.fill(",  ".join(typed), 150, max_lines=3)
    style: dict[str, Any] = {
        "ha": "center",
        "va": "top",
        "color": INK,
        "linespacing": 1.4,
        "parse_math": False,
    }
    figure.text(0.5, 1 - 0.18 / height_in, title, size=16, weight="bold", **style)
    figure.text(0.5, 1 - 0.55 / height_in, shown, size=9.5, **style)
    if handles:
        figure.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, 1 - 1.2 / height_in),
            ncols=_PER_ROW,
            fontsize=9.5,
            frameon=False,
            handlelength=2.6,
            columnspacing=1.4,
            borderaxespad=0.0,
            title=_TITLE,
            title_fontsize=9.5,
        )


def closer_view(cut: CrossSection, crystal: int) -> tuple[float, float, float]:
    """x, z, half height (mm) around the thinnest volume or layer at the crystal's lower edge."""
    boxes = {
        r.volume: (cut.corners(r.volume).min(axis=0), cut.corners(r.volume).max(axis=0))
        for r in cut.regions
    }
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
