"""What all figures share: canvas, colours, legends, parameters and fates, the CSV beside."""

from __future__ import annotations

import io
import itertools
import math
import textwrap
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import is_there, refuse_suffix, write_bytes, write_text
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output.codec import csv_lines
from mcrim_mitsuba.output.describe_scene import fate_words
from mcrim_mitsuba.output.sentences import title_of

#: Columns and rows of the CSV beside a figure.
Numbers = tuple[Sequence[str], Sequence[Sequence[object]]]

#: Suffixes of the files that `save` writes.
SUFFIXES = (".png", ".pdf")

#: Their darkness tells these apart in grey.
DARK = "#0b2f5c"
WARM = "#c2410c"
LIGHT = "#5aa7ad"
GREY = "#4d4d4d"
PALE = "0.87"
_INK = "#222222"

#: Decorates everything that draws.
styled = rc_context({"font.size": 11})
_DPI = 200
#: Letters in a line of a title, at least.
_FEWEST_LETTERS = 16
#: Letters in a title of a user's own, at most.
_MOST_LETTERS = 300


def canvas(width_inches: float, height_inches: float) -> Figure:
    """An empty figure whose parts find their places themselves."""
    figure = Figure(figsize=(width_inches, height_inches), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


#: Along which axes a quiet grid lies.
Lines = Literal["both", "x", "y"]


def axes_of(
    width_inches: float = 7.2,
    height_inches: float = 5.0,
    *grid: int,
    lines: Lines = "both",
    **options: Any,
) -> tuple[Figure, Any]:
    """A `canvas` with one axes, or a `grid` of them: so many below, and beside each other."""
    figure = canvas(width_inches, height_inches)
    axes = figure.subplots(*grid, **options)
    for each in figure.axes:
        open_axes(each, lines)
    return figure, axes


#: Most panels side by side.
_ACROSS = 3


def panels_of(count: int) -> tuple[int, int]:
    """How many rows panels stand in, of nearly equal length, and how many panels in a row."""
    down = math.ceil(count / _ACROSS)
    return down, math.ceil(count / down)


def panels(figure: Figure, count: int, lines: Lines, **options: Any) -> list[Axes]:
    """So many axes, as `panels_of` arranges them."""
    down, across = panels_of(count)
    grid = figure.subplots(down, across, squeeze=False, **options).ravel()
    for axes in grid[:count]:
        open_axes(axes, lines)
    for axes in grid[count:]:
        axes.set_axis_off()
    return list(grid[:count])


def open_axes(axes: Axes, lines: Lines = "both") -> None:
    """A quiet grid behind the data, along ``x``, ``y`` or ``both``; no frame above and beside."""
    axes.grid(axis=lines, color="0.92", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend(axes: Axes, handles: Sequence[Artist] | None = None, **options: Any) -> None:
    """A legend without a frame, labels of users as they are; by default of all that has a label."""
    entries = {} if handles is None else {"handles": handles}
    for text in axes.legend(**entries, **{"fontsize": 9.5, "frameon": False} | options).get_texts():
        text.set_parse_math(False)


def legend_above(axes: Axes, handles: Sequence[Artist] | None = None, **options: Any) -> None:
    """A legend over the axes, where it can hide nothing."""
    place = {"loc": "lower left", "bbox_to_anchor": (0, 1.0), "borderaxespad": 0.2}
    legend(axes, handles, columnspacing=1.4, **place, **options)


def legend_of(
    figure: Figure, handles: Sequence[Artist], where: str, ncols: int, **more: Any
) -> None:
    """A legend of the whole figure, outside its axes: ``lower center``, ..."""
    options: dict[str, Any] = {"loc": f"outside {where}", "fontsize": 9.5, "frameon": False}
    figure.legend(handles=handles, ncols=ncols, **options | more)


def text_after_bar(axes: Axes, text: str, end: tuple[float, float], **look: Any) -> None:
    """A text at the right of a bar's end, four points away; `end` is (x, y) in data units."""
    points: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 9.5}
    axes.annotate(text, end, (4, 0), **points, **look)


def text_in_bar(axes: Axes, text: str, middle: tuple[float, float], **look: Any) -> None:
    """A text in the middle of a part of a bar, which is (x, y) in data units."""
    axes.text(*middle, text, ha="center", va="center", fontsize=10, **look)


def paper(alpha: float, pad: float) -> dict[str, Any]:
    """A box of white behind a text, which hides as much of what is behind it as `alpha` says."""
    return {"facecolor": "white", "edgecolor": "none", "alpha": alpha, "pad": pad}


def band(axes: Axes, x: np.ndarray, y: np.ndarray, sigma: np.ndarray, **look: Any) -> None:
    """One standard error on either side of a curve."""
    axes.fill_between(x, y - sigma, y + sigma, lw=0, **look)


def shortened(name: str, most: int = 34) -> str:
    """A name of at most so many characters: of a long one both ends, which tell it from others."""
    name = visible(" ".join(name.split()))
    if len(name) <= most:
        return name
    head = most // 2
    tail = most - head - 1  # the ellipsis is a character too
    return f"{name[:head].rstrip()}…{name[-tail:].lstrip()}"


def in_lines(name: str, letters: int = 34, lines: int = 3) -> str:
    """A name in about so many lines of so many letters."""
    return textwrap.fill(shortened(name, lines * letters), letters)


def shortened_apart(names: Sequence[str], most: int = 34) -> list[str]:
    """Names of at most so many characters, no two alike: without shared words, or numbered."""
    words = [visible(name).split() for name in names]
    for _ in range(2):  # from their beginnings, then backwards from their ends
        if any(len(" ".join(name)) > most for name in words):
            columns = zip(*(name[:-1] for name in words), strict=False)  # a word stays of each
            shared = sum(1 for _ in itertools.takewhile(lambda at: len(set(at)) == 1, columns))
            words = [name[shared:] for name in words]
        words = [name[::-1] for name in words]
    short = [shortened(" ".join(name).strip(",;"), most) for name in words]
    if len(set(short)) == len(set(names)):
        return short
    return [f"{i}: {shortened(name, most - len(f'{i}: '))}" for i, name in enumerate(short, 1)]


def entitle(figure: Figure, words: str, weight: str = "bold") -> None:
    """A title over a figure, in as many lines as keep it within the figure's width."""
    lines = words.split("\n")
    letters = max(map(len, lines))
    look = {"fontsize": 11.5, "weight": weight, "parse_math": False}
    while True:
        text = "\n".join(textwrap.fill(line, letters) for line in lines)
        heading = figure.suptitle(text, x=0.01, ha="left", **look)
        if heading.get_window_extent().x1 <= figure.bbox.width or letters < _FEWEST_LETTERS:
            return
        # too wide: the same again in lines that are a tenth shorter
        letters = letters * 9 // 10


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure in the format of its suffix, one of `SUFFIXES`.

    Raises InputError if the file cannot be written.
    """
    path = Path(path)
    refuse_suffix(path, SUFFIXES, "a figure cannot be drawn as")
    write_bytes(path, content_of(figure, path.suffix.lower()[1:]))
    return path


def content_of(figure: Figure, form: str, **options: Any) -> bytes:
    """A figure's file in a format, such as ``png``, by these options of matplotlib."""
    content = io.BytesIO()
    # journals take TrueType fonts in a PDF, not Type 3
    with warnings.catch_warnings(), rc_context({"pdf.fonttype": 42}):
        # a label in a script that the font lacks shows boxes; tables and CSV have it
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(content, format=form, **{"dpi": _DPI, **options})
    return content.getvalue()


def numbers_beside(path: str | Path) -> Path:
    """Where the numbers behind a figure go: its name with ``.csv``."""
    path = Path(path)
    return path.parent / f"{path.stem}.csv"


def refuse_table_without_figure(numbers: Path) -> None:
    """Refuse (InputError) to replace a table that lies beside no figure of its name."""
    if not is_there(numbers):
        return
    names = (path.name for path in numbers.parent.iterdir() if path.stem == numbers.stem)
    if not any(name.lower().endswith(SUFFIXES) for name in names):
        problem = "a figure's numbers would replace this table, which lies there without one"
        raise InputError(problem, "name another figure, or move the table", path=numbers)


def numbers_of(
    records: Iterable[Any], names: str, **further: Callable[[Any], object]
) -> tuple[list[str], list[tuple[object, ...]]]:
    """Columns and rows of a CSV: attributes of records, and what functions make of a record.

    Columns stand in the order of `names`, which blanks part; those of `further` that are not among
    them come last.
    """
    columns = list(dict.fromkeys((*names.split(), *further)))
    cells = [further.get(name) or attrgetter(name) for name in columns]
    return columns, [tuple(cell(record) for cell in cells) for record in records]


def numbers_in(columns: Mapping[str, Any]) -> Numbers:
    """Columns and rows of a CSV from arrays, (rows,) each, by name; one value is in every row."""
    arrays = (np.asarray(cells, dtype=object) for cells in columns.values())
    return list(columns), list(zip(*np.broadcast_arrays(*arrays), strict=True))


def rows_of_bars(axes: Axes, names: Sequence[str], above: float = 0.5, **look: Any) -> None:
    """Name bars that lie below each other from 0 on, with so much of a row `above` the first."""
    axes.set_yticks(range(len(names)), names, **look)
    axes.set_ylim(len(names) - 0.5, -above)
    axes.tick_params(axis="y", length=0)


def numbers_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """The text of a CSV; what is not known or not finite is an empty cell."""
    return csv_lines(columns, (map(_cell, row) for row in rows))


def _cell(value: object) -> object:
    """A number to seven digits, empty where it is not finite; anything else as it is."""
    if isinstance(value, float):
        return f"{value:.7g}" if math.isfinite(value) else ""
    return value


@dataclass(frozen=True)
class Drawing:
    """A figure with the numbers behind it."""

    figure: Figure
    #: Of the CSV; none of a cross-section.
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()

    def entitled(self, title: str) -> Drawing:
        """Put a title over the figure, above what it says there itself; gives itself back."""
        subtitle = self.figure.get_suptitle()
        words = "\n".join(filter(None, (shortened(title, _MOST_LETTERS), subtitle)))
        entitle(self.figure, words, "normal" if "\n" in subtitle else "bold")
        return self

    def save(self, path: str | Path) -> tuple[Path, ...]:
        """Write the figure (PNG or PDF) and its numbers, if any (CSV of the same name).

        Raises InputError if a file cannot be written.
        """
        picture, numbers = save(self.figure, path), numbers_beside(path)
        if not self.columns:
            return (picture,)
        write_text(numbers, numbers_text(self.columns, self.rows))
        return picture, numbers


def sentence_instead(text: str, numbers: Numbers) -> Drawing:
    """A drawing of one sentence, which says why there is nothing to draw."""
    figure = canvas(6.0, 1.2)
    figure.text(0.02, 0.5, text, va="center")
    return Drawing(figure, *numbers)


# Fitted parameters as axes and titles name them, with their units.

_KNOWN_PARAMETERS = {
    LIGHT_YIELD: "light yield (photons per keV)",
    SCALE: "scale (signal per efficiency)",
}


def parameter_title(name: str) -> str:
    """A parameter in words with its unit."""
    # a $ would begin a formula
    return _KNOWN_PARAMETERS.get(name) or shortened(title_of(name), 44).replace("$", r"\$")


def signal_title(unit: str, line_end: str = " ") -> str:
    """What an axis of signals is called; where the unit is not known, `unit` is empty."""
    return f"signal{line_end}({shortened(unit or 'unit of the measurement file', 40)})"


# Fates of light: in one order, each with its colour, hatch and marker.


@dataclass(frozen=True)
class FateStyle:
    """One fate's look; hatches, markers and lines tell fates apart where colours do not."""

    #: Such as ``absorbed at the mask``.
    words: str
    #: Colours of its paths, dark; of its bars, of their edge and hatches, and of words on them.
    line: str
    fill: str
    #: Of its bars, and of the ends of its paths.
    hatch: str
    marker: str
    #: Line style of its paths.
    dashes: str | tuple
    edge: str = _INK
    text: str = "black"


_DASHED = (0, (6, 1.5))
_DOTTED = (0, (1.2, 1.2))
_MIXED = (0, (4, 1.2, 1, 1.2))
#: By fate the fields of a `FateStyle` after its words; the last two where they differ.
_LOOKS: dict[str, tuple[Any, ...]] = {
    "detected": (DARK, DARK, "", "o", "-", _INK, "white"),
    "absorbed_crystal": ("#7a1f5c", "#c9a0bd", "//", "X", _DASHED),
    "absorbed_gap": ("#00625a", "#8fd0c8", "\\\\", "P", _MIXED),
    "absorbed_window": ("#31572c", "#b5d0a4", "..", "p", _MIXED),
    "absorbed_aperture": ("#111111", "#555555", "xx", "s", _DOTTED, "black", "white"),
    "absorbed_reflector": ("#6b4a00", "#d8b365", "++", "D", _DOTTED),
    "absorbed_surface": ("#37474f", "#a9bcc6", "oo", "h", _MIXED),
    "escaped": (WARM, "#f6dccd", "", "^", (0, (3, 1.3))),
    "truncated": ("#3d3d3d", "#9a9a9a", "--", "*", ":"),
    "lost": ("#3d3d3d", "white", "**", "v", ":"),
}


#: Of light absorbed in a medium that a user named.
_OTHER_MEDIUM = ("#004a7c", "#9cc7e0", "||", "d", _DASHED)


def fate_style(fate: str) -> FateStyle:
    """How a fate is drawn, by its name in `SimulationResult.budget`."""
    return FateStyle(fate_words(fate), *_LOOKS.get(fate, _OTHER_MEDIUM))


def ordered(fates: Iterable[str]) -> list[str]:
    """Fates in the order of all figures: what is wanted first, what is wrong last."""
    places: dict[str, float] = {fate: place for place, fate in enumerate(_LOOKS)}
    # media that users named stand behind the bench's own and before the mask
    other_media = places["absorbed_aperture"] - 0.5
    return sorted(set(fates), key=lambda fate: (places.get(fate, other_media), fate))


# Transmittances beside signals of light: a second scale.


def units_of_signals(readings: Sequence[tuple[float, bool]]) -> np.ndarray:
    """(readings,) factors that put signals, each with whether it is a transmittance, on one axis.

    Signals of light stay as they are; a transmittance of 1 is drawn where the largest of these is.
    """
    light = [abs(signal) for signal, of_beam in readings if not of_beam]
    return np.array([max(light, default=1.0) if of_beam else 1.0 for _, of_beam in readings])
