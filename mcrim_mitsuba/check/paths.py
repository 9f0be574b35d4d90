"""A few photons' paths for the cross-section: short ones of every fate that matters."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mcrim_mitsuba.figures.fate_style import fate_style, ordered

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.simulation import Simulation
    from mcrim_mitsuba.kernel.trails import Trail

#: Fates of less of the light are not shown; those of more get two paths.
LEAST_SHARE, COMMON_SHARE = 0.01, 0.15
#: Flights of a path that is easily followed; of longer paths so many are drawn.
_WANTED_FLIGHTS, MOST_FLIGHTS = 5, 16
#: How far an escaping photon's last flight is drawn, over the scene's size.
_AWAY = 0.16
#: Length over the scene's size that is long enough to be seen, and photons to choose from.
_SEEN, _CANDIDATES = 0.4, 50
_PER_ROW = 5
_TITLE = "Photons' paths, projected on the plane, and how much of the light meets the same fate"
_HALO = patheffects.withStroke(linewidth=2.6, foreground="white", alpha=0.75)


@dataclass(frozen=True)
class Path:
    """A photon's path in the plane of the picture.

    Attributes
    ----------
    fate : str
    points : ndarray of float64, shape (n, 2)
        x and z in mm: birth, turns and end.
    trapped : bool
        Whether it goes on for longer than is drawn.
    """

    fate: str
    points: np.ndarray
    trapped: bool


def chosen_paths(
    simulation: Simulation, view: np.ndarray | None
) -> tuple[tuple[Path, ...], dict[str, float]]:
    """Paths to be drawn, and the share of the light of every fate that is shown.

    The same for the same scene. Among a fate's photons those are chosen that take few flights, or
    as many as is typical, stay near the plane of the picture and keep away from other paths.

    Parameters
    ----------
    simulation : kernel.simulation.Simulation
    view : ndarray of float64, shape (2, 2), or None
        Lowest and highest x and z (mm) of what is enlarged: one path goes through it, if it can.
    """
    from mcrim_mitsuba.kernel.trails import follow_trails

    trails, size = follow_trails(simulation), simulation.model.size_mm
    middle = (simulation.crystal.lower[1] + simulation.crystal.upper[1]) / 2
    shares = {f: s for f, s in trails.shares.items() if s >= LEAST_SHARE}
    paths: list[Path] = []
    for fate in ordered(shares):
        numbers = np.flatnonzero(trails.fates == fate)
        lines = [_line(trails.trail(number), size) for number in numbers.tolist()]
        flights = trails.flights[numbers]
        # one path that is easily followed, and of common fates a typical one
        wanted = (_WANTED_FLIGHTS, np.median(flights))
        for many in wanted if shares[fate] >= COMMON_SHARE else wanted[:1]:
            costs = _costs_alone(lines, middle, size) + np.abs(np.log(flights / many))
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
            paths.append(Path(fate, points[:, [0, 2]], trapped))
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
    enter, leave = (
        np.nanmax(crossings.min(axis=0), axis=1),
        np.nanmin(crossings.max(axis=0), axis=1),
    )
    met = (enter < leave) & (leave > 0.0) & (enter < 1.0)
    return np.bincount(owner, met, len(lines)) > 0


def _nearness(points: np.ndarray, others: list[Path], size: float) -> float:
    """How close a line (x, z) comes to the paths that are there, and their ends to each other."""
    own, cost = _sampled(points), 0.0
    for other in others:
        there = _sampled(other.points)
        away = np.linalg.norm(own[:, None] - there, axis=2).min(axis=1) / size
        ends = np.linalg.norm(own[-1] - there[-1]) / size
        cost += 0.5 * float(np.exp(-8.0 * away).mean()) + 0.3 * float(np.exp(-6.0 * ends))
    return cost


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points along a line, shape (n, 2)."""
    share = np.linspace(0.0, 1.0, 6)[:, None]
    return np.vstack([a + share * (b - a) for a, b in pairwise(points)])


def draw_path(ax: Axes, path: Path) -> None:
    """Draw a path behind all labels: an open dot where it begins, the fate's marker at its end."""
    style = fate_style(path.fate)
    ax.plot(
        *path.points.T, color=style.line, ls=style.dashes, lw=1.3, zorder=3, path_effects=[_HALO],
        solid_joinstyle="round", dash_joinstyle="round",
    )  # fmt: skip
    ax.plot(*path.points[0], **_BIRTH)
    ax.plot(*path.points[-1], **_end(path.fate, path.trapped, path.points))


_BIRTH: dict[str, Any] = {
    "marker": "o", "ms": 4.5, "mfc": "white", "mec": "#222222", "mew": 1.1, "zorder": 3.2, "ls": "",
}  # fmt: skip


def _end(fate: str, trapped: bool, points: np.ndarray | None = None) -> dict[str, Any]:
    """How a path's end is marked: filled where the photon ended, open where it goes on."""
    style = fate_style(fate)
    marker: str | tuple[int, int, float] = style.marker
    if fate == "escaped" and points is not None:
        across, up = points[-1] - points[-2]
        marker = (3, 0, float(np.degrees(np.arctan2(up, across))) - 90.0)
    face = "white" if trapped else style.line
    return {"marker": marker, "ms": 7.5, "mfc": face, "mec": style.line if trapped else "white",
            "mew": 1.4 if trapped else 0.8, "zorder": 3.4, "ls": ""}  # fmt: skip


def legend_rows(paths: tuple[Path, ...], shares: dict[str, float]) -> int:
    """Rows of the legend below its title."""
    return -(-len(_handles(paths, shares)) // _PER_ROW)


def draw_legend(
    figure: Figure, place: tuple, paths: tuple[Path, ...], shares: dict[str, float]
) -> None:
    """Explain the paths; the middle of the legend's upper edge is at `place`, in parts of `figure`.

    Does nothing where there are none.
    """
    if paths:
        figure.legend(
            handles=_handles(paths, shares), loc="upper center", bbox_to_anchor=place,
            ncols=_PER_ROW, fontsize=9.5, frameon=False, handlelength=2.6, columnspacing=1.4,
            borderaxespad=0.0, title=_TITLE, title_fontsize=9.5,
        )  # fmt: skip


def _handles(paths: tuple[Path, ...], shares: dict[str, float]) -> list[Line2D]:
    handles = [Line2D([], [], label="birth", **_BIRTH)] if paths else []
    for fate in ordered(shares):
        style, percent = fate_style(fate), 100 * shares[fate]
        label = f"{style.words}, {percent:.{0 if percent >= 9.95 else 1}f} %"
        look = _end(fate, False) | {"color": style.line, "lw": 1.4, "ls": style.dashes}
        handles.append(Line2D([], [], label=label, **look))
    if any(path.trapped for path in paths):
        look = _end("detected", True) | {"mec": "#222222"}
        handles.append(Line2D([], [], label=f"open: goes on after {MOST_FLIGHTS} flights", **look))
    return handles
