"""Puts photographs together on one sheet, with labels beside what they name."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from mcrim_mitsuba.picture.view import Camera

#: Pixels of the sheet, and of the heading above the photographs.
WIDTH, HEIGHT, HEADING = 1800, 1150, 100
#: Pixels over which a photograph fades into the sheet.
_RIM = 60
#: What an empty floor becomes, 0 to 1 before the curve of sRGB: the colour of the sheet.
_FLOOR = 0.93
INK, QUIET, LEADER, AIR = "#1d2733", "#4d5863", "#7d8894", "#2f7fc1"
_DPI = 100


@dataclass(frozen=True)
class Label:
    """A text on the picture.

    Attributes
    ----------
    text : str
    box : tuple of float
        Left, top, right and bottom, in pixels from the upper left corner.
    target : tuple of float or None
        Pixel that its leader ends at.
    """

    text: str
    box: tuple[float, float, float, float]
    target: tuple[float, float] | None = None


@dataclass
class Panel:
    """A photograph and where its upper left corner lies on the sheet, in pixels."""

    camera: Camera
    left: int
    top: int

    def at(self, points: ArrayLike) -> np.ndarray:
        """Pixels of the sheet, shape (..., 2), of points of the photograph's scene."""
        return self.camera.project(points) + np.array([self.left, self.top])


@dataclass
class Sheet:
    """The picture as it is put together.

    Parameters
    ----------
    scale : float
        Pixels over those of the full size.
    """

    scale: float = 1.0
    labels: list[Label] = field(default_factory=list)

    def __post_init__(self) -> None:
        shape = (round(HEIGHT * self.scale), round(WIDTH * self.scale), 3)
        self.pixels = np.full(shape, _tone(np.ones(1))[0], dtype=float)
        self.figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI * self.scale)
        self.canvas = FigureCanvasAgg(self.figure)
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, shape[1]), ylim=(shape[0], 0))
        self.axes.axis("off")

    def put(self, photograph: np.ndarray, panel: Panel) -> None:
        """Paste a photograph (linear, in units of the floor), shape (height, width, 3)."""
        high, wide = photograph.shape[:2]
        # towards its rim an empty floor, so that photographs have no visible borders
        rims = (np.minimum(np.arange(n) + 1, n - np.arange(n)) for n in (high, wide))
        rows, columns = (np.clip(rim / (_RIM * self.scale), 0.0, 1.0) for rim in rims)
        photograph = 1.0 + (photograph - 1.0) * (rows[:, None] * columns)[:, :, None]
        # at some scales rounding makes it a pixel larger than the place that is left
        place = self.pixels[panel.top : panel.top + high, panel.left : panel.left + wide]
        place[:] = _tone(photograph)[: place.shape[0], : place.shape[1]]

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float = 13,
        *,
        target: tuple[float, float] | None = None,
        **style: Any,
    ) -> Label:
        """Write at a place (pixels); returns the label."""
        usual: dict[str, Any] = {"color": INK, "va": "top", "linespacing": 1.25}
        artist = self.axes.text(x, y, text, size=size, parse_math=False, **usual | style)
        box = artist.get_window_extent()
        high = self.pixels.shape[0]
        label = Label(text, (box.x0, high - box.y1, box.x1, high - box.y0), target)
        self.labels.append(label)
        return label

    def line(self, points: ArrayLike, colour: str = LEADER, width: float = 1.2) -> None:
        """A line through (points, 2) places of the sheet."""
        x, y = np.asarray(points).T
        self.axes.plot(x, y, color=colour, lw=width)

    def dot(self, point: Sequence[float] | np.ndarray) -> None:
        """A small disc at a place of the sheet."""
        x, y = point
        self.axes.plot(x, y, "o", color=INK, markersize=5, markeredgecolor="white")

    def ring(self, centre: tuple[float, float], radius: float) -> None:
        """A circle on the sheet."""
        self.axes.add_patch(Circle(centre, radius, fill=False, ec=INK, lw=1.6))

    def span(self, ends: np.ndarray) -> None:
        """An arrow with two heads; shape (2, 2)."""
        style = {"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0, "color": INK, "lw": 1.3}
        self.axes.annotate("", ends[0], ends[1], arrowprops=style)

    def ghost(self, points: np.ndarray) -> None:
        """The outline of what cannot be seen, air; `points` in pixels, shape (n, 2)."""
        try:
            outline = points[ConvexHull(points).vertices]
        except QhullError:
            return
        self.axes.add_patch(Polygon(outline, fc=to_rgba(AIR, 0.12), ec=AIR, lw=1.8, ls=(0, (4, 3))))

    def finished(self) -> np.ndarray:
        """The pixels, uint8, shape (height, width, 3)."""
        high, wide = self.pixels.shape[:2]
        self.axes.imshow(
            np.clip(self.pixels, 0.0, 1.0), extent=(0, wide, high, 0), interpolation="none",
            aspect="auto", zorder=-1,
        )  # fmt: skip
        self.axes.set(xlim=(0, wide), ylim=(high, 0))
        self.canvas.draw()
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()


def apart(wanted: ArrayLike, heights: ArrayLike, low: float, high: float) -> np.ndarray:
    """Tops of boxes that are near the wanted ones but neither overlap nor leave a range.

    Parameters
    ----------
    wanted, heights : ndarray, shape (n,)
        In the order from top to bottom.
    low, high : float
    """
    tops = np.array(wanted, dtype=float)
    ends = np.concatenate([[0.0], np.cumsum(heights)])
    shifted = tops - ends[:-1]
    # the nearest values that never fall: neighbours that collide move together
    groups: list[list[float]] = []
    for value in shifted:
        groups.append([value, 1.0])
        while len(groups) > 1 and groups[-2][0] > groups[-1][0]:
            (b, m), (a, n) = groups.pop(), groups.pop()
            groups.append([(a * n + b * m) / (n + m), n + m])
    spread = np.repeat([v for v, _ in groups], [int(n) for _, n in groups])
    return np.clip(spread, low, max(low, high - ends[-1])) + ends[:-1]


def heading(name: str, overrides: Iterable[str], words: Mapping[str, str]) -> tuple[str, str]:
    """Title and parameters of a scene as they stand above its picture."""
    changed = ", ".join(f"{key}={words[key]}" for key in overrides)
    title = textwrap.shorten(f"{name} {changed and 'with'} {changed}", 90)
    shown = ",  ".join(f"{key} = {value}" for key, value in words.items())
    return title, textwrap.fill(shown, 190, max_lines=2, placeholder=" …")


def _tone(light: np.ndarray) -> np.ndarray:
    """Linear light, 1 an empty floor, as values of sRGB; what is brighter fades into white."""
    linear = _FLOOR * light
    bright = 1.0 - (1.0 - _FLOOR) * np.exp(-(linear - _FLOOR) / (1.0 - _FLOOR))
    linear = np.where(linear > _FLOOR, bright, linear)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
