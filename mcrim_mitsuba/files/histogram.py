"""Reads a histogram of photons per event: two columns, bin centre and counts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import read_text
from mcrim_mitsuba.files.values import parse_number

_LIMIT_MB = 10
#: With fewer bins no peak could be told from its background.
_FEWEST_BINS = 8
#: Of a bin's width: how far its centre may be from where the others put it.
_UNEVEN = 0.01


@dataclass(frozen=True, eq=False)
class Histogram:
    """Events by the photons that were detected in them.

    Attributes
    ----------
    path : Path
        The file.
    comments : tuple of str
        Its comment lines without the ``#``.
    photons : (bins,) float64
        Bin centres, ascending, all bins of one width.
    counts : (bins,) float64
        Whole numbers of events.
    """

    path: Path
    comments: tuple[str, ...]
    photons: NDArray[np.float64]
    counts: NDArray[np.float64]


def read_histogram(path: str | Path) -> Histogram:
    """Read and check a histogram.

    Parameters
    ----------
    path : str or Path
        Text, two numbers a line with a comma, a semicolon or blanks between them: bin centre
        (photons per event) and counts. Lines that begin with # are comments; one line of names
        may come first.

    Raises
    ------
    InputError
        With file and line, if anything cannot be used.
    """
    path = Path(path)
    comments: list[str] = []
    rows: list[tuple[int, float, float]] = []
    named = False
    for line, text in enumerate(read_text(path, _LIMIT_MB).split("\n"), start=1):
        text = text.strip(" \t,;")
        if text.startswith("#"):
            comments.append(text.lstrip("#").strip())
            continue
        cells = text.replace(",", " ").replace(";", " ").split()
        if not cells:
            continue
        if not rows and not named and not any(map(_begins_a_number, cells)):
            named = True
            continue
        rows.append((line, *_numbers(cells, path, line)))
    _check_together(rows, path)
    _, photons, counts = np.array(rows).T
    return Histogram(path, tuple(comments), photons, counts)


def _begins_a_number(cell: str) -> bool:
    return cell[0] in "+-.0123456789"


def _numbers(cells: list[str], path: Path, line: int) -> tuple[float, float]:
    place = {"path": path, "line": line}
    if len(cells) != 2:
        raise InputError(
            f"{len(cells)} {'cell' if len(cells) == 1 else 'cells'}, not 2",
            "write the bin's centre and its counts", **place,
        )  # fmt: skip
    centre = parse_number("bin centre", cells[0], **place)
    counts = parse_number("counts", cells[1], **place)
    if counts < 0 or counts != math.floor(counts):
        raise InputError(
            f"{counts:g} counts are not a number of events",
            "write counts that are neither scaled nor subtracted: their errors are the square "
            "roots", **place,
        )  # fmt: skip
    return centre, counts


def _check_together(rows: list[tuple[int, float, float]], path: Path) -> None:
    """What only shows when bins are seen side by side."""
    if len(rows) < _FEWEST_BINS:
        raise InputError(
            f"only {len(rows)} bins", f"a histogram has {_FEWEST_BINS} at least", path=path
        )
    width = rows[1][1] - rows[0][1]
    for (_, before, _), (line, centre, _) in pairwise(rows):
        place = {"path": path, "line": line}
        if centre <= before:
            raise InputError(
                f"the bin centre {centre:g} does not follow {before:g}",
                "sort the bins, each once", **place,
            )  # fmt: skip
        if abs(centre - before - width) > _UNEVEN * width:
            raise InputError(
                f"the bin at {centre:g} is {centre - before:g} from the one before, not {width:g}",
                "give all bins one width; write empty bins with 0 counts", **place,
            )  # fmt: skip
    if not any(counts for _, _, counts in rows):
        raise InputError("all bins are empty", "name another file", path=path)
