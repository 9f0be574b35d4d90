"""Reads a histogram of photons per event, or a list of events that is sorted into one.

Files are read as `data_table` says: text, CSV and spreadsheets' exports. Two columns are the bin
centres and the counts; one column is the number of photons of every event.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.data_table import DataTable, read_data_table
from mcrim_mitsuba.physics.event_bins import bin_width, sorted_into_bins

#: Lists of some million events.
_LIMIT_MB = 50
#: With fewer bins, or events in a list, no peak could be told from its background.
_FEWEST_BINS, _FEWEST_EVENTS = 8, 300
_MOST_BINS = 100_000
#: Of a bin's width: how far its centre may be from where the others put it.
_UNEVEN = 0.01
_ROLES = ("bin centre", "counts")
#: Numbers beyond these are slips; whole ones are exact below them. Bins may be coulombs.
_LARGEST_CENTRE, _MOST_COUNTS, _NARROWEST = 1e12, 1e15, 1e-30
#: First columns of spectra and of traces, and second ones of what each event gave.
_NO_BINS = re.compile(r"wave.?(length|number)|lambda|λ|wellenl|длина|time(?!.?over)|zeit|время")
_NO_BIN_UNITS = ("nm", "µm", "Å", "eV", "1/cm", "s", "ms", "min", "h")
_PER_EVENT = re.compile(
    r"photon|\bamp|charge|ladung|(?<![a-z])p\.?h?\.?e(?![a-z])|electron|volt|height|area"
)
_PER_EVENT_UNITS = ("pe", "p.e.", "phe", "v", "mv", "pc", "fc")
_OF_BINS = re.compile(r"count|event|entr|hits|freq|anzahl|häufig")
#: Numbered events: this part of neighbours differs by more than 3 standard errors, and all are in
#: no order: the ratio of von Neumann (Ann. Math. Stat. 12 (1941) 367) of their ranks is 1.
_JUMPS, _ORDERLESS = 0.05, (0.8, 1.2)


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
        others bins after Freedman and Diaconis (Z. Wahrscheinlichkeitstheorie 57 (1981) 453), or
        a fifth of the main peak's standard deviation where those are too wide for it, of a width
        that the steps of the numbers divide.

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
    _refuse_huge(table)
    photons, counts = _binned(table) if columns == 1 else _checked(table)
    return Histogram(table.path, table.comments, photons, counts)


def _refuse_huge(table: DataTable) -> None:
    """What no sum of squares could hold."""
    limits = (_LARGEST_CENTRE, _MOST_COUNTS)
    for column, limit in enumerate(limits[: table.values.shape[1]]):
        bad = np.flatnonzero(np.abs(table.values[:, column]) > limit)
        if len(bad):
            raise table.refusal(
                int(bad[0]), column,
                f"{table.values[bad[0], column]:g} is too large for a histogram",
                f"write numbers up to {limit:g}",
            )  # fmt: skip


def _refuse_other_columns(table: DataTable) -> None:
    """Names that are those of a spectrum, a trace or a list of events."""
    if table.names is None:
        return
    (bins, events), (unit, other) = table.names, table.units
    first, second = bins.lower(), events.lower()
    if _NO_BINS.search(first) or unit in _NO_BIN_UNITS:
        raise InputError(
            f"the first column, {bins}, is not what an event gave",
            "write bin centres in photons per event, and how many events each bin has",
            path=table.path,
        )  # fmt: skip
    listed = first.startswith(("event", "trigger")) and "photon" in second
    given = _PER_EVENT.search(second) or (other or "").lower() in _PER_EVENT_UNITS
    if listed or (given and not _OF_BINS.search(second)):
        raise InputError(
            f"the second column, {events}, holds no numbers of events: this looks like a list of "
            "numbered events",
            f"keep the column {events} alone, or write bin centres first and then counts",
            path=table.path,
        )  # fmt: skip


def _refuse_numbered(table: DataTable) -> None:
    """Counts that jump from bin to bin in no order are no histogram."""
    counts = table.values[:, 1]
    if len(counts) < _FEWEST_EVENTS:
        return
    steps = np.diff(counts)
    jumps = np.mean(steps**2 > 9.0 * (counts[1:] + counts[:-1]))
    _, ranks = np.unique(counts, return_inverse=True)
    variance = ranks.var()
    order = np.mean(np.diff(ranks) ** 2) / (2.0 * variance) if variance else 0.0
    if jumps > _JUMPS and _ORDERLESS[0] < order < _ORDERLESS[1]:
        raise InputError(
            f"the counts of {len(counts)} bins jump from bin to bin in no order: this looks like "
            "a list of numbered events",
            "keep the second column alone; if most bins of a histogram are empty, join bins",
            path=table.path,
        )  # fmt: skip


def _checked(table: DataTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bin centres and counts, ascending."""
    photons, counts = table.values.T
    _refuse_other_columns(table)
    bad = np.flatnonzero((counts < 0) | (counts != np.floor(counts)))
    if len(bad):
        count = float(counts[bad[0]])
        raise _refusal(
            table, bad[0], f"{count:.10g} counts are not a number of events",
            f"write {1000 * count:.0f}, if the point separates thousands; else correct it"
            if _may_be_thousands(count)
            else "write counts that are neither scaled nor subtracted: their errors are the square "
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
            "write decimal points, if this is a list of events with decimal commas"
            if _may_be_decimals(table)
            else "sort the bins, each once",
        )  # fmt: skip
    width = float(np.median(np.abs(steps)))
    if width < _NARROWEST:
        raise InputError(
            f"the bins are {width:g} wide", "write the bin centres in a larger unit",
            path=table.path,
        )  # fmt: skip
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
    _refuse_numbered(table)
    return (photons[::-1].copy(), counts[::-1].copy()) if falls else (photons, counts)


def _may_be_thousands(count: float) -> bool:
    """Whether it has three decimals, as in 8.635."""
    thousand = 1000.0 * count
    return 1.0 <= count < 1000.0 and abs(thousand - round(thousand)) < 1e-6 and thousand % 10 > 0.5


def _may_be_decimals(table: DataTable) -> bool:
    """Whether two columns without names may be one, split at decimal commas."""
    whole = bool(np.all(table.values == np.floor(table.values)))
    steps = np.diff(table.values[:, 0])
    ordered = max(np.mean(steps > 0), np.mean(steps < 0))
    few = len(steps) < _FEWEST_BINS
    return table.names is None and whole and not few and bool(ordered < 0.8)


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
    lowest, width = float(events.min()), 1.0 if whole else bin_width(events)
    bins = math.ceil((events.max() - lowest) / width + 0.5) if width > 0 else 0
    if not _FEWEST_BINS <= bins <= _MOST_BINS:
        raise InputError(
            f"events from {lowest:g} to {events.max():g} photons fill {bins} bins",
            f"is this a list of photons per event? It should fill {_FEWEST_BINS} to {_MOST_BINS}",
            path=table.path,
        )
    return sorted_into_bins(events, width)


def _refusal(table: DataTable, row: int, problem: str, mend: str) -> InputError:
    return table.refusal(int(row), None, problem, mend)
