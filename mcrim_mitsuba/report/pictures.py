"""Figures as data URIs: nothing is loaded, nothing can be executed."""

from __future__ import annotations

import base64
import io
import re
import warnings
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from mcrim_mitsuba.figures.style import Numbers, numbers_text

# matplotlib writes texts into comments and a date into the metadata; a page needs neither
_COMMENTS = re.compile(r"<!--.*?-->\n?|<metadata>.*?</metadata>\n?|<!DOCTYPE.*?>\n?", re.DOTALL)
# a hundredth of a point is not seen
_PATHS, _FURTHER_DIGITS = re.compile(r' d="[^"]*"'), re.compile(r"(\.\d\d)\d+")
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_PIXELS_PER_INCH = 96
_COLOURS = 256


@dataclass(frozen=True)
class Picture:
    """A figure of the report.

    Attributes
    ----------
    name : str
        Of the file that its numbers are saved as.
    alt : str
        What it shows, for those who do not see it.
    source : str
        ``data:`` URI.
    width, height : int
        Natural size, pixels.
    numbers : tuple of (str, str, str)
        Of every CSV with what is behind it: what it holds, its name, and its ``data:`` URI.
    """

    name: str
    alt: str
    source: str
    width: int
    height: int
    numbers: tuple[tuple[str, str, str], ...] = ()


def of_figure(name: str, figure: Figure, alt: str, **numbers: Numbers) -> Picture:
    """A figure as vector graphics, its texts as outlines: it looks the same everywhere.

    Parameters
    ----------
    name : str
    figure : Figure
    alt : str
    numbers : Numbers
        Tables behind it, by what they hold.
    """
    stream = io.StringIO()
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": name}), warnings.catch_warnings():
        # a label in a script that the font lacks shows boxes; tables and CSV have it
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = _NOT_XML.sub("", _COMMENTS.sub("", stream.getvalue()))
    text = _PATHS.sub(lambda path: _FURTHER_DIGITS.sub(r"\1", path[0]), text)
    width, height = (round(inches * _PIXELS_PER_INCH) for inches in figure.get_size_inches())
    tables = tuple(
        (
            what.replace("_", " "),
            name if len(numbers) == 1 else f"{name}-{what}",
            _uri("text/csv;charset=utf-8", numbers_text(*table).encode()),
        )
        for what, table in numbers.items()
    )
    return Picture(name, alt, _uri("image/svg+xml", text.encode()), width, height, tables)


def of_pixels(name: str, pixels: NDArray[np.uint8], alt: str) -> Picture:
    """A photograph, in so few colours that it is easy to mail."""
    stream = io.BytesIO()
    few = Image.fromarray(pixels).quantize(_COLOURS, dither=Image.Dither.NONE)
    few.save(stream, format="png", optimize=True)
    height, width = pixels.shape[:2]
    return Picture(name, alt, _uri("image/png", stream.getvalue()), width, height)


def _uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
