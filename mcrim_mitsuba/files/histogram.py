"""Reads a histogram of photons per event, or a list of events that is sorted into one.

Files are read as `data_table` says: text, CSV and spreadsheets' exports. Two columns are the bin
centres and the counts; one column is the number of photons of every event.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.data_table import DataTable, read_data_table

#: Lists of some million events.
_LIMIT_MB = 50
#: With fewer bins, or events in a list, no peak could be told from its background.
_FEWEST_BINS, _FEWEST_EVENTS = 8, 300
_MOST_BINS = 100_000
#: Of a bin's width: how far its centre may be from where the others put it.
_UNEVEN = 0.01
_ROLES = ("bin centre", "counts")


@dataclass(frozen=True, eq=False)
class Histogram:
    """Events by the photons that were detected in them.

    Attributes
    ----------
    path : Path
        The file.
    comments : tuple of str
        Its comment lines without the ``#``, and lines of text.
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
        Two columns: bin centres (photons per event), ascending or descending, and counts. Or one
        column, the photons of each event, 300 events at least: whole numbers get a bin each,
        others bins after Freedman and Diaconis (Z. Wahrscheinlichkeitstheorie 57 (1981) 453),
        of a width that the steps of the numbers divide.

    Raises
    ------
    InputError
        With file and line, if anything cannot be used.
    """
    table = read_data_table(path, roles=_ROLES, limit_mb=_LIMIT_MB)
    columns = table.values.shape[1]
    if columns > 2:
        raise table.refusal(
            0, None, f"{columns} columns, not 2", "keep the bin centres and the counts"
        )
    photons, counts = _binned(table) if columns == 1 else _checked(table)
    return Histogram(table.path, table.comments, photons, counts)


def _checked(table: DataTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bin centres and counts, ascending."""
    photons, counts = table.values.T
    names = [name.lower() for name in table.names or ("", "")]
    if names[0].startswith("event") and "photon" in names[1]:
        raise InputError(
            "this looks like a list of numbered events", "keep the column of photons",
            path=table.path,
        )  # fmt: skip
    bad = np.flatnonzero((counts < 0) | (counts != np.floor(counts)))
    if len(bad):
        raise _refusal(
            table, bad[0], f"{counts[bad[0]]:g} counts are not a number of events",
            "write counts that are neither scaled nor subtracted: their errors are the square "
            "roots",
        )  # fmt: skip
    if len(photons) < _FEWEST_BINS:
        raise InputError(
            f"only {len(photons)} bins", f"a histogram has {_FEWEST_BINS} at least",
            path=table.path,
        )  # fmt: skip
    steps = np.diff(photons)
    falls = bool(np.all(steps < 0))
    bad = np.flatnonzero(steps <= 0)
    if len(bad) and not falls:
        row = bad[0] + 1
        raise _refusal(
            table, row, f"the bin centre {photons[row]:g} does not follow {photons[row - 1]:g}",
            "sort the bins, each once",
        )  # fmt: skip
    width = float(np.median(np.abs(steps)))
    bad = np.flatnonzero(np.abs(np.abs(steps) - width) > _UNEVEN * width)
    if len(bad):
        row = bad[0] + 1
        raise _refusal(
            table, row,
            f"the bin at {photons[row]:g} is {abs(steps[row - 1]):g} from the one before, not "
            f"{width:g}", "give all bins one width; write empty bins with 0 counts",
        )  # fmt: skip
    if not counts.any():
        raise InputError("all bins are empty", "name another file", path=table.path)
    return (photons[::-1].copy(), counts[::-1].copy()) if falls else (photons, counts)


def _binned(table: DataTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bin centres and counts of a list of events."""
    events = table.values[:, 0]
    if len(events) < _FEWEST_EVENTS:
        raise InputError(
            f"one column of {len(events)} numbers is no histogram, and as a list of events it is "
            "too short",
            f"write bin centres and counts, or {_FEWEST_EVENTS} events at least", path=table.path,
        )  # fmt: skip
    whole = bool(np.all(events == np.floor(events)))
    if whole and events.min() < 0:
        row = int(np.argmax(events < 0))
        raise _refusal(
            table, row, f"{events[row]:g} photons in an event", "write the numbers as counted"
        )
    lowest, width = float(events.min()), 1.0 if whole else _width(events)
    bins = math.ceil((events.max() - lowest) / width + 0.5) if width > 0 else 0
    if not _FEWEST_BINS <= bins <= _MOST_BINS:
        raise InputError(
            f"events from {lowest:g} to {events.max():g} photons fill {bins} bins",
            f"is this a list of photons per event? It should fill {_FEWEST_BINS} to {_MOST_BINS}",
            path=table.path,
        )
    centres = lowest + width * np.arange(bins)
    numbers = np.floor((events - lowest) / width + 0.5).astype(int)
    return centres, np.bincount(numbers, minlength=bins).astype(float)


def _width(events: NDArray[np.float64]) -> float:
    """Width of a bin; 0 where half of the events are alike."""
    low, high = np.percentile(events, (25, 75))
    width = 2.0 * float(high - low) / math.cbrt(len(events))
    different = np.unique(events)
    step = float(np.diff(different).min(initial=math.inf))
    steps = (different - different[0]) / step
    # bins that hold now two, now three of the numbers that can occur would make a comb
    if len(different) < 0.5 * len(events) and np.all(np.abs(steps - np.round(steps)) < _UNEVEN):
        return max(round(width / step), 1) * step if width else 0.0
    return width


def _refusal(table: DataTable, row: int, problem: str, mend: str) -> InputError:
    return table.refusal(int(row), None, problem, mend)
