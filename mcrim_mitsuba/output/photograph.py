"""A picture of a bench: as it stands, taken apart, and its gap enlarged."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.text import Text
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial import ConvexHull, QhullError

from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import attributes, refuse_suffix, write_bytes
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output.cross_section import SectionAxes, closer_view, heading
from mcrim_mitsuba.output.figure_style import shortened
from mcrim_mitsuba.scene.check_text import Interface, is_filled
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.transport.check import interfaces_of, volume_indices
from mcrim_mitsuba.transport.cut import cross_section
from mcrim_mitsuba.transport.photograph_parts import (
    TINTS,
    BenchPart,
    Body,
    Camera,
    PhotographedBench,
    exploded,
    framed,
    raised,
)
from mcrim_mitsuba.transport.variants import versions

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation

#: Pixels of the sheet.
WIDTH = 1800
HEIGHT = 1150
#: Pixels over which a photograph fades into the sheet.
_RIM = 60
#: What an empty floor becomes, 0 to 1 before the curve of sRGB: the colour of the sheet.
_FLOOR = 0.93
#: Colours of texts, of quiet ones, of leaders, of air.
INK = "#1d2733"
QUIET = "#4d5863"
LEADER = "#7d8894"
AIR = "#2f7fc1"
_DPI = 100


@dataclass(frozen=True)
class Label:
    """A text on the picture."""

    text: str
    #: Left, top, right and bottom, in pixels from the upper left corner.
    box: tuple[float, float, float, float]
    #: Pixel that its leader ends at.
    target: tuple[float, float] | None = None


@dataclass
class Photo:
    """A photograph and where its upper left corner lies on the sheet, in pixels."""

    camera: Camera
    left: int
    top: int

    def at(self, points: ArrayLike) -> np.ndarray:
        """Pixels of the sheet, shape (..., 2), of points of the photograph's scene."""
        return self.camera.project(points) + np.array([self.left, self.top])

    def per_mm(self, place_mm: np.ndarray) -> float:
        """Pixels per mm at a place, (3,) in mm, across the line of sight."""
        across, _, _ = self.camera.axes
        return float(np.ptp(self.at([place_mm, place_mm + across])[:, 0]))


class Sheet:
    """The picture as it is put together; `scale` is pixels over those of the full size."""

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.labels: list[Label] = []
        shape = (round(HEIGHT * scale), round(WIDTH * scale), 3)
        self.pixels = np.full(shape, _tone(np.ones(1))[0], dtype=float)
        self.figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI * scale)
        self.canvas = FigureCanvasAgg(self.figure)
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, shape[1]), ylim=(shape[0], 0))
        self.axes.axis("off")

    def put(self, photograph: np.ndarray, panel: Photo) -> None:
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
        size: float,
        *,
        target: tuple[float, float] | None = None,
        **style: Any,
    ) -> None:
        """Write at a place (pixels)."""
        usual: dict[str, Any] = {"color": INK, "va": "top", "linespacing": 1.25}
        artist = self.axes.text(x, y, text, size=size, parse_math=False, **usual | style)
        self.note([artist], target)

    def note(self, artists: Iterable[Text], target: tuple[float, float] | None = None) -> None:
        """Keep the places of texts."""
        high = self.pixels.shape[0]
        for artist in artists:
            box = artist.get_window_extent()
            place = (box.x0, high - box.y1, box.x1, high - box.y0)
            self.labels.append(Label(artist.get_text(), place, target))

    def line(self, points: ArrayLike) -> None:
        """A line through (points, 2) places of the sheet."""
        self.axes.plot(*np.asarray(points).T, color=LEADER, lw=1.2)

    def finished(self) -> np.ndarray:
        """The pixels, uint8, shape (height, width, 3)."""
        high, wide = self.pixels.shape[:2]
        look: dict[str, Any] = {"interpolation": "none", "aspect": "auto", "zorder": -1}
        self.axes.imshow(np.clip(self.pixels, 0.0, 1.0), extent=(0, wide, high, 0), **look)
        self.axes.set(xlim=(0, wide), ylim=(high, 0))
        self.canvas.draw()
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()


def apart(wanted: ArrayLike, heights: ArrayLike, low: float, high: float) -> np.ndarray:
    """Tops of boxes that are near the wanted ones but neither overlap nor leave a range.

    `wanted` and `heights`, shape (n,), are in the order from top to bottom.
    """
    ends = np.concatenate([[0.0], np.cumsum(heights)])
    # the nearest values that never fall: neighbours that collide move together
    spread = isotonic_regression(np.asarray(wanted, dtype=float) - ends[:-1]).x
    return np.clip(spread, low, max(low, high - ends[-1])) + ends[:-1]


def _tone(light: np.ndarray) -> np.ndarray:
    """Linear light, 1 an empty floor, as values of sRGB; what is brighter fades into white."""
    linear = _FLOOR * light
    bright = 1.0 - (1.0 - _FLOOR) * np.exp(-(linear - _FLOOR) / (1.0 - _FLOOR))
    linear = np.where(linear > _FLOOR, bright, linear)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


# What stands beside the photographs.

#: Where the labels of the parts begin, in pixels of the full sheet.
_LEFT = 1490
#: Height of a line over the size of its letters, in pixels per point.
_LINE = 1.39


def label_bench(sheet: Sheet, panel: Photo, place_mm: np.ndarray) -> None:
    """A ring around the place that is enlarged below."""
    (x, y), scale, camera = panel.at(place_mm), sheet.scale, panel.camera
    sheet.axes.add_patch(Circle((x, y), 13 * scale, fill=False, ec=INK, lw=1.6))
    end = (panel.left + 0.74 * camera.width, panel.top + 0.93 * camera.height)
    sheet.line([(x + 9 * scale, y + 9 * scale), end])
    sheet.text(end[0] + 6 * scale, end[1] - 9 * scale, "enlarged below", 11.5)


def draw_edge(
    sheet: Sheet, simulation: Simulation, interfaces: Sequence[Interface]
) -> tuple[np.ndarray, float]:
    """The cross-section around the crystal's lower edge, in the colours of the photographs.

    Returns its middle, (3,) in mm, and its pixels per mm.
    """
    model, crystal = simulation.model, simulation.crystal
    cut = cross_section(model, float(crystal.lower[1] + crystal.upper[1]) / 2)
    x, z, half = closer_view(cut, crystal.volume)
    half = min(half, _CLOSE * float(np.ptp(cut.corners(crystal.volume))))
    left, top, wide, high = _EDGE
    place = (left / WIDTH, 1.0 - (top + high) / HEIGHT, wide / WIDTH, high / HEIGHT)
    aside = half * wide / high
    axes = sheet.figure.add_axes(place, xlabel="x (mm)", ylabel="z (mm)")
    axes.set(xlim=(x - aside, x + aside), ylim=(z - half, z + half))
    indices = volume_indices(interfaces)
    colours = [
        to_hex(np.clip(_tone(np.array(tint) ** 2), 0.0, 1.0))
        if is_filled(indices.get(volume.name, np.inf))
        else "none"
        for volume, tint in zip(model.volumes[1:], itertools.cycle(TINTS), strict=False)
    ]
    section = SectionAxes(axes, cut, model, interfaces, colours)
    section.measure()
    section.label(brief=True)
    sheet.note(text for text in axes.texts if text.get_text())
    return np.array([x, cut.level_mm, z]), sheet.scale * high / (2 * half)


def label_parts(
    sheet: Sheet, panel: Photo, parts: Sequence[BenchPart], lifts: Sequence[float]
) -> None:
    """What each part is, to the right of it."""
    scale = sheet.scale
    left = scale * _LEFT
    rows = []
    for part, lift in zip(parts, lifts, strict=True):
        seen = panel.at(raised(part.points, lift))
        if not part.bodies:  # the outline of what cannot be seen
            with contextlib.suppress(QhullError):
                outline = seen[ConvexHull(seen).vertices]
                air = Polygon(outline, fc=to_rgba(AIR, 0.12), ec=AIR, lw=1.8, ls=(0, (4, 3)))
                sheet.axes.add_patch(air)
        target = seen[seen[:, 0] > seen[:, 0].max() - 0.5 * scale].mean(axis=0)
        rows.append((target, part))
    rows.sort(key=lambda row: row[0][1])
    room = panel.camera.height - 50 * scale
    heights = np.array([(1.75 + 1.3 * len(part.details)) * _LINE * scale for _, part in rows])
    size = min(13.0, room / heights.sum())
    heights *= size
    tops = [target[1] - 0.9 * size * scale for target, _ in rows]
    low = panel.top + 40 * scale
    for (target, part), top in zip(rows, apart(tops, heights, low, low + room), strict=True):
        name, details = shortened(part.name, 24), "\n".join(map(shortened, part.details))
        below = top + 2.0 * size * scale
        sheet.text(left, top, name, size + 1, weight="bold", target=tuple(target))
        sheet.text(left, below, details, size - 1.5, color=QUIET)
        start = (left - 8 * scale, top + 0.9 * size * scale)
        sheet.line([start, (left - 28 * scale, start[1]), target])
        sheet.axes.plot(*target, "o", color=INK, markersize=5, markeredgecolor="white")


# The picture.

#: Variants that know colours.
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")
#: Light paths per pixel.
SAMPLES = 16
#: Left, top, width and height of the photographs of the bench, of its lower edge and of its
#: parts, in pixels of the full sheet; what is right of the parts belongs to their labels.
BENCH_PANEL = (0, 100, 890, 590)
_EDGE = (90, 740, 780, 350)
_PARTS = (870, 100, 660, 1050)
_EDGE_CAPTION = (0, 690)
#: The most of the crystal's size that half the height of its enlarged edge shows.
_CLOSE = 0.1
_FIELD_DEG = 20.0
#: Margins of the photograph of the parts: left, right, top and bottom, over its size.
_MARGINS = (0.09, 0.1, 0.06, 0.06)
#: Spaces between the parts that are tried, over the width of the widest; the first one that does
#: not make the picture smaller is taken, or the last.
_SPACINGS = (0.6, 0.5, 0.42, 0.36, 0.3, 0.26)


@dataclass(frozen=True, eq=False, kw_only=True)
class Rendering:
    """A picture of a bench."""

    #: ndarray of uint8, shape (height, width, 3): All of it, and the bench as it stands alone,
    #: without labels.
    pixels: np.ndarray
    view: np.ndarray
    #: All texts, with their places.
    labels: tuple[Label, ...]
    #: Names of the parts that are shown, lowest first.
    parts: tuple[str, ...]
    #: Light paths per pixel, and what they were drawn from.
    samples: int
    seed: int
    #: Effective scene parameters.
    parameters: dict[str, object]
    #: SHA-256 of the scene after substitution.
    scene_hash: str
    versions: dict[str, str]

    def document(self, picture: str, seconds: float) -> dict[str, Any]:
        """As ``mcrim render --json`` writes it, of a `picture` that was saved after `seconds`."""
        high, wide = self.pixels.shape[:2]
        whole = {"kind": "rendering", "version": 1, "picture": picture, "width": wide}
        whole |= {"height": high, **attributes(self, "parts samples seed"), "seconds": seconds}
        return whole | attributes(self, "parameters versions scene_hash")

    def png(self) -> bytes:
        """The picture as a PNG file."""
        from PIL import Image

        file = io.BytesIO()
        Image.fromarray(self.pixels).save(file, format="png")
        return file.getvalue()

    def save(self, path: str | Path) -> None:
        """Write the picture; ``path`` ends in ``.png``.

        Raises InputError if the suffix is another one, or the file cannot be written.
        """
        path = Path(path)
        refuse_suffix(path, (".png",), "a picture cannot be written as")
        write_bytes(path, self.png())


def render(
    scene: str | Path | SceneFile,
    overrides: Mapping[str, Value] | None = None,
    *,
    samples: int | None = None,
    scale: float = 1.0,
    run: Run = Run(),
) -> Rendering:
    """Photograph a bench as it stands and taken apart, and its lower edge enlarged.

    `samples` are light paths per pixel, `SAMPLES` when not given; `scale` is that of the pixels
    over the full size, 1800 x 1150. The run is of a variant of `VARIANTS`, and the same seed gives
    the same picture; photons and precision do not matter.

    Raises InputError if the scene cannot be read or is not sound, the variant has no colours, or a
    shape cannot be drawn.
    """
    if run.variant not in VARIANTS:
        problem = f"the variant {run.variant!r} makes no pictures in colour"
        raise InputError(problem, f"use {' or '.join(VARIANTS)}")
    from mcrim_mitsuba.transport.simulation import Simulation

    simulation = Simulation(scene, overrides, variant=run.variant, threads=run.threads)
    file, model = simulation.file, simulation.model
    from mcrim_mitsuba.transport.photograph import surface_triangles

    with placed(path=file.path):
        triangles = surface_triangles(model)
    interfaces = interfaces_of(file, model)
    whole = PhotographedBench(model, triangles, volume_indices(interfaces))
    parts, bench = whole.parts(), whole.assembled()
    samples, sheet = samples or SAMPLES, Sheet(scale)
    lifts, view = _taken_apart(sheet, parts)
    panels = [
        _panel(sheet, BENCH_PANEL, _corners(bench), (0.62, -1.0, 0.5), (0.07, 0.07, 0.1, 0.07)),
        view,
    ]
    lifted = ((body, up) for part, up in zip(parts, lifts, strict=True) for body in part.bodies)
    apart = [Body(body.triangles.moved((0.0, 0.0, up)), body.finish) for body, up in lifted]
    _expose(sheet, [bench, apart], panels, samples, run)
    left, top, wide, high = (round(scale * side) for side in BENCH_PANEL)
    view = np.clip(sheet.pixels[top : top + high, left : left + wide], 0.0, 1.0)
    place_mm, per_mm = draw_edge(sheet, simulation, interfaces)
    _write_titles(sheet, file, per_mm / panels[0].per_mm(place_mm), scale)
    label_bench(sheet, panels[0], place_mm)
    label_parts(sheet, panels[1], parts, lifts)
    return Rendering(
        pixels=sheet.finished(),
        view=np.round(255.0 * view).astype(np.uint8),
        labels=tuple(sheet.labels),
        parts=tuple(part.name for part in parts),
        samples=samples,
        seed=run.seed,
        parameters=dict(file.parameters),
        scene_hash=file.content_hash,
        versions=versions(run.variant),
    )


def _expose(
    sheet: Sheet, bodies: Sequence[Sequence[Body]], panels: Sequence[Photo], samples: int, run: Run
) -> None:
    """Photograph the bodies of each panel, and put the pictures on the sheet."""
    from mcrim_mitsuba.transport.photograph import photograph

    for number, (in_panel, panel) in enumerate(zip(bodies, panels, strict=True)):

        def report(done: int, _: int, before: int = number * samples) -> None:
            run.tell("rendering", before + done, len(panels) * samples)

        points = _corners(in_panel)
        floor = points[:, 2].min() - 0.004 * np.ptp(points, axis=0).max()
        light = photograph(
            in_panel, panel.camera, floor, samples=samples, seed=run.seed, progress=report
        )
        sheet.put(light, panel)


def _write_titles(sheet: Sheet, file: SceneFile, times: float, scale: float) -> None:
    """The scene's name and parameters, and a caption for each panel."""
    title, parameters = heading(file.path.name, file.overrides, file.parameters)
    sheet.text(24 * scale, 20 * scale, title, 19, weight="bold")
    sheet.text(24 * scale, 56 * scale, parameters, 9.5, color=QUIET)
    enlarged = f"enlarged {float(f'{times:.2g}'):g} times"
    for (left, top), words in (
        (BENCH_PANEL[:2], "The bench as it stands"),
        (_EDGE_CAPTION, f"The crystal's lower edge, cut open, {enlarged}"),
        ((_PARTS[0] + 24, _PARTS[1]), "The parts, moved apart, to scale"),
    ):
        sheet.text(scale * (left + 24), scale * (top + 8), words, 13, weight="bold")


def _corners(bodies: Sequence[Body]) -> np.ndarray:
    return np.concatenate([body.triangles.corners.reshape(-1, 3) for body in bodies])


def _taken_apart(sheet: Sheet, parts: Sequence[BenchPart]) -> tuple[list[float], Photo]:
    """How far the parts are lifted, as wide apart as the photograph is high; and its panel."""
    for spacing in _SPACINGS:
        lifts = exploded(parts, spacing)
        points = np.concatenate([raised(p.points, up) for p, up in zip(parts, lifts, strict=True)])
        panel = _panel(sheet, _PARTS, points, (0.62, -1.0, 0.55), _MARGINS)
        wide = np.ptp(panel.camera.project(points)[:, 0]) / panel.camera.width
        if wide > 0.995 - _MARGINS[0] - _MARGINS[1]:
            break
    return lifts, panel


def _panel(
    sheet: Sheet,
    place: tuple[float, ...],
    points: np.ndarray,
    direction: tuple[float, float, float],
    margins: tuple[float, float, float, float],
) -> Photo:
    """A photograph that shows all of `points`, at its place on the sheet."""
    left, top, width, height = (round(sheet.scale * value) for value in place)
    return Photo(framed(points, direction, _FIELD_DEG, width, height, margins), left, top)


# A photograph that a report waits for is made in another process, by ``python -m
# mcrim_mitsuba.output.photograph``: Mitsuba compiles every scene that lives in a process into each
# picture's kernel. After a diagnosis many do, and the page that asked for the report answers
# meanwhile; the rest of the report is made meanwhile too.

#: Exit status of the process where the scene or the variant cannot be drawn.
_REFUSED = 2


class Photograph:
    """A picture that is being drawn; it is waited for when it is asked for.

    The process writes pickled pixels to its standard output, or a line to its standard error and
    fails.
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    def __getstate__(self) -> dict[str, Any]:
        return {"_developed": self._developed}  # a process cannot be sent to another

    @property
    def picture(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """Pixels of the whole and of the bench as it stands, or None: a report does without."""
        return self._developed[0]

    @property
    def trouble(self) -> str:
        """Why there is no picture."""
        return self._developed[1]

    @functools.cached_property
    def _developed(self) -> tuple[tuple[NDArray[np.uint8], NDArray[np.uint8]] | None, str]:
        """The pixels that the process drew, and why there are none."""
        pixels, complaint = self._process.communicate()
        if self._process.returncode != 0:
            words = complaint.decode(errors="replace").strip() or "the process that draws it ended"
            return None, words.splitlines()[-1]
        return pickle.loads(pixels), ""


def begin_photograph(scene: SceneFile, run: Run, scale: float) -> Photograph:
    """Begin to draw a scene, `scale` times as large as `mcrim render`; by the run's variant."""
    job = scene, Run(variant=run.variant, threads=run.threads), scale
    command = [sys.executable, "-m", "mcrim_mitsuba.output.photograph"]
    try:
        with tempfile.TemporaryFile() as stdin:  # a pipe would have to be written meanwhile
            pickle.dump(job, stdin)
            stdin.seek(0)
            pipe = subprocess.PIPE
            return Photograph(subprocess.Popen(command, stdin=stdin, stdout=pipe, stderr=pipe))
    except OSError as error:
        # a file without a name does not say where it lies
        place = error.filename or tempfile.gettempdir()
        raise OSError(error.errno, error.strerror, place) from None


def main() -> int:
    """Draw what standard input asks for; the pixels go to standard output."""
    try:
        scene, run, scale = pickle.load(sys.stdin.buffer)
        picture = render(scene, scale=scale, run=run)
    except InputError as error:
        print(error.problem, file=sys.stderr)
        return _REFUSED
    pickle.dump((picture.pixels, picture.view), sys.stdout.buffer)
    return 0


if __name__ == "__main__":
    sys.exit(main())
