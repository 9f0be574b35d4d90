"""Axes with a scene's cross-section, and places for labels on which they hide nothing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import binary_erosion

from mcrim_mitsuba.check.cut import CrossSection, masked
from mcrim_mitsuba.check.words import volume_indices

if TYPE_CHECKING:
    from mcrim_mitsuba.check.report import Interface
    from mcrim_mitsuba.kernel.scene_model import SceneModel

# Calm, and of different lightness, so that a grey print still tells neighbours apart.
COLOURS = ("#7aa6cf", "#f7e7b9", "#bcd3b4", "#d9a48f", "#9a86b8", "#8fb5b0")
INK, _DETECTOR, _OTHER = "#222222", "#b3261e", "#777777"
#: Pixels: a cell of the grid on which labels find their place; the space beside and above a label.
_CELL, _CLEAR = 3, np.array([8, 4])


class Panel:
    """Axes with the cross-section, and a grid of cells on which labels find free places."""

    def __init__(
        self, ax: Axes, cut: CrossSection, model: SceneModel, interfaces: Sequence[Interface]
    ) -> None:
        self.ax, self.cut, self.model, self.indices = ax, cut, model, volume_indices(interfaces)
        self.box = ax.get_window_extent()
        self.named: dict[str, list[np.ndarray]] = {}
        shape = int(self.box.height // _CELL) + 1, int(self.box.width // _CELL) + 1
        self.owner, self.taken = np.zeros(shape, dtype=int), np.zeros(shape, dtype=bool)
        self.crossed = np.zeros(shape, dtype=bool)
        rows, columns = np.ogrid[0.5 : shape[0], 0.5 : shape[1]]
        for region in cut.regions:
            ax.fill(*region.outline.T, color=COLOURS[region.volume % len(COLOURS) - 1], lw=0.2)
            low, high = np.split(self.cells(region.outline), 2)
            low, high = (
                np.interp(columns, side[:, 0], side[:, 1], np.inf, np.inf)
                for side in (low, high[::-1])
            )
            self.owner[(low < rows) & (rows < high)] = region.volume
        styles = {"dielectric": (INK, 0.8), "diffuse reflector": (INK, 1.5),
                  "detector": (_DETECTOR, 5.0)}  # fmt: skip
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
        targets = targets[:: len(targets) // 40 + 1] + 0.5 if beside else targets.mean(axis=0)[None]
        room = ~self.taken & ((self.owner == volume) | (beside & (self.owner == 0)))
        for text in texts if len(targets) else ():
            artist = self.ax.text(
                0, 0, text, size=10.5, va="bottom", parse_math=False, zorder=6,
                bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.0},
            )  # fmt: skip
            w, h = size = (artist.get_window_extent().size + 2 * _CLEAR).astype(int) // _CELL + 1
            low = np.argwhere(_within(room, w, h) == w * h)[:, None, ::-1]
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
            # rather further away than on a path
            cost = cost + 0.7 * _within(self.crossed, w, h)[low[..., 1], low[..., 0]]
            spot, target = np.unravel_index(cost.argmin(), cost.shape)
            (column, row), corner = low[spot, 0], low[spot, 0] + _CLEAR / _CELL
            ends = np.array([corner, start[spot, target], targets[target]]) * _CELL + self.box.p0
            corner, *link = self.ax.transData.inverted().transform(ends)
            artist.set_position(corner)
            if beside and leader:
                self.line(np.array(link), INK, 0.8)
                self.ax.plot(*link[1], "o", color=INK, markersize=4, markeredgecolor="white")
                x, z = targets[target].astype(int)
                self.taken[max(z - 5, 0) : z + 6, max(x - 5, 0) : x + 6] = True
            self.taken[row : row + h, column : column + w] = True
            return True
        return False


def _within(cells: np.ndarray, wide: int, tall: int) -> np.ndarray:
    """How many of `cells` (bool) are set in the rectangle above and to the right of each."""
    sums = np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return sums[tall:, wide:] - sums[:-tall, wide:] - sums[tall:, :-wide] + sums[:-tall, :-wide]
