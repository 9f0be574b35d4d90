"""Histograms of photons per event: read, made of a list of events, searched for their peaks.

Files are read as `data_table` says: text, CSV and spreadsheets' exports. Two columns are the bin
centres and the counts; one column is the number of photons of every event.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.data_table import DataTable, read_data_table
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import inside
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.laboratory.columns import (
    INSTRUMENTS,
    counts_alone,
    refuse_numbered,
    refuse_other_columns,
    refuse_photoelectrons,
    refuse_uncalibrated,
    uncalibrated,
)

#: Part of its height to which the counts must fall beside a peak that is alone.
SHALLOW = 0.5
#: Standard errors by which a peak must stand out of what surrounds it.
_STANDS_OUT = 5.0
#: Part of the largest peak's area that the main one must have.
_LARGE = 0.25
#: Smoothings of the counts that are tried: standard deviations in bins.
_SMOOTHINGS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.7, 8.0)


@dataclass(frozen=True)
class Found:
    """Roughly where the main peak lies."""

    #: Counts per bin above the background, position and standard deviation in the unit of the
    #: bins, counts per bin.
    height: float
    centroid: float
    width: float
    background: float
    _: KW_ONLY
    #: The valleys below and above; high is infinite where no other peak lies above.
    low: float
    high: float
    #: How far the counts do not fall there, as a part of the height.
    low_level: float = 0.0
    high_level: float = 0.0


def main_peak(
    values: Array, counts: Array, variances: Array | None = None, above: float = -math.inf
) -> Found | None:
    """The main peak: of the large ones that of the highest value; None where none stands out.

    Bin centres ascend, all bins of one width; `variances`, (bins,), where they are not Poisson's;
    a pedestal that is not `above`, however large, does not count.
    """
    smooth, tops, _, areas = _clear_peaks(counts, variances)
    counted = values[tops] > above
    tops, areas = tops[counted], areas[counted]
    if not len(tops):
        return None
    main = np.flatnonzero(areas >= _LARGE * areas.max())[-1]
    top, bin_width = tops[main], values[1] - values[0]
    # on that side where it falls off further: the other may be cut, or reach into another peak
    sides = []
    for side in (smooth[top::-1], smooth[top:]):
        higher = np.flatnonzero(side > side[0])
        side = side[: higher[0]] if len(higher) else side
        height = float(side[0] - side.min())
        sides.append((height, int(np.argmax(side < side[0] - 0.5 * height))))
    height, half_width = max(sides)
    width = max(2.0 * half_width / FWHM, 1.0) * bin_width
    # the valleys: within four widths below, and on the way to the next peak above
    below = np.arange(max(0, top - math.ceil(4 * width / bin_width)), top + 1)
    low = below[np.argmin(smooth[below])]
    high = top + np.argmin(smooth[top : tops[main + 1]]) if main + 1 < len(tops) else top
    base = smooth[top] - height
    return Found(
        height,
        float(values[top]),
        float(width),
        float(base),
        low=float(values[low]),
        high=float(values[high]) if high > top else math.inf,
        low_level=float((smooth[low] - base) / height) if low > 0 else 0.0,
        high_level=float((smooth[high] - base) / height) if high > top else 0.0,
    )


def clear_peaks(
    values: Array, counts: Array, variances: Array | None
) -> list[tuple[float, float, float]]:
    """Place, standard deviation and roughly the events of all peaks that stand out, ascending.

    As `main_peak` takes them; places and deviations are in the unit of the bins.
    """
    step = float(values[1] - values[0])
    _, tops, widths, areas = _clear_peaks(counts, variances)
    found = zip(values[tops].tolist(), (widths * step / FWHM).tolist(), areas.tolist(), strict=True)
    return list(found)


def _clear_peaks(
    counts: Array, variances: Array | None
) -> tuple[Array, NDArray[Any], Array, Array]:
    """Smoothed counts, and of peaks that stand out of them places, widths (bins) and areas.

    Counts are smoothed until neighbours agree within their errors: until the smoothing is not small
    against the widest peak.
    """
    # these take half a second to import
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks, peak_widths

    for smoothing in _SMOOTHINGS:
        smooth = gaussian_filter1d(counts, smoothing, mode="nearest")
        tops, properties = find_peaks(smooth, prominence=1e-9)
        widths, prominences = peak_widths(smooth, tops, 0.5)[0], properties["prominences"]
        if smoothing >= 0.15 * widths.max(initial=0.0):
            break
    # of counts that a Gaussian has smoothed
    of_counts = smooth[tops] if variances is None else variances[tops]
    noise = np.sqrt(np.maximum(of_counts, 1.0) / (2 * math.sqrt(math.pi) * smoothing))
    clear = prominences > _STANDS_OUT * noise
    return smooth, tops[clear], widths[clear], (prominences * widths)[clear]


def peak_inside(values: Array, counts: Array) -> Found | None:
    """The peak of a window that the user chose, however little it stands out; None without one."""
    from scipy.ndimage import gaussian_filter1d

    smooth = gaussian_filter1d(counts, max(1.0, len(values) / 20), mode="nearest")
    top, background = int(np.argmax(smooth)), float(min(smooth[0], smooth[-1]))
    height = float(smooth[top]) - background
    near = smooth > background + 0.5 * height
    if not near.any():
        return None
    width = max(np.ptp(values[near]) / FWHM, values[1] - values[0])
    centroid = float(np.average(values[near], weights=smooth[near]))
    return Found(height, centroid, float(width), background, low=-math.inf, high=math.inf)


# Bins for a list of events, narrow enough for its main peak.
#
# The rule of Freedman and Diaconis (Z. Wahrscheinlichkeitstheorie 57 (1981) 453) takes the
# quartiles of all events: with a pedestal far from a narrow peak, they tell how far, not how
# narrow.


#: Widest bins that show the main peak, in its standard deviations; and those that are made.
_COARSE = 0.5
_FINE = 0.2
#: How much narrower bins may become than the quartiles ask for.
_NARROWER = 200
#: Empty bins beside the events, where a peak is searched.
_MARGIN = 8
#: How many bins there may be.
_MOST_BINS = 100_000
#: Part of a step by which numbers may be away from whole steps.
_UNEVEN = 0.01


def _sorted_into_bins(events: Array, width: float) -> tuple[Array, Array]:
    """Centres and counts of bins of one width, the first about the lowest number."""
    lowest = float(events.min())
    counts = np.bincount(np.floor((events - lowest) / width + 0.5).astype(int)).astype(float)
    return lowest + width * np.arange(len(counts), dtype=float), counts


def _bin_width(events: Array) -> float:
    """Width of a bin that shows the main peak; 0 where half of the events are alike.

    The quartiles may lie in a pedestal far away from it.
    """
    low, high = np.percentile(events, (25, 75))
    finer = width = 2.0 * float(high - low) / math.cbrt(len(events))
    if not width:
        return 0.0
    step, least = _step(events), max(width / _NARROWER, float(np.ptp(events)) / _MOST_BINS)
    while finer >= least:
        # `main_peak` smooths over up to eight bins
        fine = _whole_steps(finer / 8, step)
        centres, counts = _sorted_into_bins(events, fine)
        # a peak in the last bin has sides too
        centres = centres[0] + fine * np.arange(-_MARGIN, len(centres) + _MARGIN)
        peak = main_peak(centres, np.pad(counts, _MARGIN))
        if peak is None:
            break
        if finer <= _COARSE * peak.width or fine == step:
            return _whole_steps(finer, step)
        finer = _FINE * peak.width
    # a spike of equal numbers has no width
    return _whole_steps(width, step)


def _step(events: Array) -> float:
    """The step of numbers that electronics give in steps; 0 for others."""
    different = np.unique(events)
    step = float(np.diff(different).min(initial=math.inf))
    steps = (different - different[0]) / step
    even = len(different) < 0.5 * len(events) and np.all(np.abs(steps - np.round(steps)) < _UNEVEN)
    return step if even else 0.0


def _whole_steps(width: float, step: float) -> float:
    """Bins that hold now two, now three of the numbers that can occur would make a comb."""
    return max(round(width / step), 1) * step if step else width


#: Lists of some million events.
_LIMIT_MB = 50
#: With fewer bins, or events in a list, no peak could be told from its background.
_FEWEST_BINS = 8
_FEWEST_EVENTS = 300
_ROLES = ("bin centre", "counts")
#: Numbers beyond these are slips; whole ones are exact below them.
_LARGEST_CENTRE = 1e12
_MOST_COUNTS = 1e15
#: Bins may be coulombs.
_NARROWEST = 1e-30


@dataclass(frozen=True, eq=False)
class Histogram:
    """Events by the photons that were detected in them."""

    #: The file.
    path: Path
    #: Its comment lines without the ``#``, and lines of text.
    comments: tuple[str, ...]
    #: (bins,) float64: Bin centres, ascending, all bins of one width.
    photons: Array
    #: (bins,) float64: Whole numbers of events.
    counts: Array


def read_histogram(path: str | Path, *, channels: bool = False) -> Histogram:
    """Read and check a histogram.

    Two columns: bin centres (photons per event), ascending or descending, and counts. Or one
    column, the photons of each event, 300 events at least: whole numbers get a bin each, others
    bins after Freedman and Diaconis, or a fifth of the main peak's standard deviation where those
    are too wide for it, of a width that the steps of the numbers divide.

    With `channels` the bins are a digitiser's channels, which a calibration turns into
    photoelectrons; one column named counts then has those of the channels from 0.

    Raises InputError, with file and line, if anything cannot be used; if the bins are channels or
    may be, unless they are to be, and the other way round.
    """
    if (suffix := inside(Path(path))[0].suffix.lower()) in INSTRUMENTS and not channels:
        raise uncalibrated(f"{suffix} files hold channels of a digitiser", Path(path))
    table = read_data_table(path, roles=_ROLES, limit_mb=_LIMIT_MB)
    columns = table.values.shape[1]
    if columns > 2:
        mend = "keep the bin centres and the counts"
        raise table.refusal(0, None, f"{columns} columns, not 2", mend)
    # no sum of their squares could hold larger numbers
    limits = zip(table.values.T, (_LARGEST_CENTRE, _MOST_COUNTS), strict=False)
    for column, (values, limit) in enumerate(limits):
        bad = np.flatnonzero(np.abs(values) > limit)
        if len(bad):
            problem = f"{values[bad[0]]:g} is too large for a histogram"
            raise table.refusal(int(bad[0]), column, problem, f"write numbers up to {limit:g}")
    if columns == 1 and counts_alone(table):
        numbered = np.column_stack([np.arange(len(table.values)), table.values])
        if not channels:
            raise uncalibrated("a column of counts has those of a digitiser's channels", table.path)
        table = replace(table, values=numbered.astype(float), names=None)
        columns = 2
    photons, counts = _binned(table) if columns == 1 else _checked(table)
    if channels:
        refuse_photoelectrons(table)
    else:
        refuse_uncalibrated(table, photons, counts)
    return Histogram(table.path, table.comments, photons, counts)


def _checked(table: DataTable) -> tuple[Array, Array]:
    """Bin centres and counts, ascending."""
    photons, counts = table.values.T
    refuse_other_columns(table)
    bad = np.flatnonzero((counts < 0) | (counts != np.floor(counts)))
    if len(bad):
        count, thousand = float(counts[bad[0]]), 1000.0 * float(counts[bad[0]])
        problem = f"{count:.10g} counts are not a number of events"
        mend = "write counts that are neither scaled nor subtracted: their errors are the square "
        mend += "roots"
        # three decimals, as in 8.635
        whole = abs(thousand - round(thousand)) < 1e-6 and thousand % 10 > 0.5
        if 1.0 <= count < 1000.0 and whole:
            mend = f"write {thousand:.0f}, if the point separates thousands; else correct it"
        raise table.refusal(int(bad[0]), None, problem, mend)
    if len(photons) < _FEWEST_BINS:
        mend = f"a histogram has {_FEWEST_BINS} at least"
        raise InputError(f"only {len(photons)} bins", mend, path=table.path)
    steps = np.diff(photons)
    falls = bool(np.all(steps < 0))
    bad = np.flatnonzero(steps <= 0)
    if len(bad) and not falls:
        row = int(bad[0]) + 1
        problem = f"the bin centre {photons[row]:g} does not follow {photons[row - 1]:g}"
        mend = "sort the bins, each once"
        if _may_be_decimals(table):
            mend = "write decimal points, if this is a list of events with decimal commas"
        raise table.refusal(row, None, problem, mend)
    width = float(np.median(np.abs(steps)))
    if width < _NARROWEST:
        mend = "write the bin centres in a larger unit"
        raise InputError(f"the bins are {width:g} wide", mend, path=table.path)
    bad = np.flatnonzero(np.abs(np.abs(steps) - width) > _UNEVEN * width)
    if len(bad):
        row = int(bad[0]) + 1
        apart = f"{abs(steps[row - 1]):g} from the one before, not {width:g}"
        problem = f"the bin at {photons[row]:g} is {apart}"
        mend = "give all bins one width; write empty bins with 0 counts"
        raise table.refusal(row, None, problem, mend)
    if not counts.any():
        raise InputError("all bins are empty", "name another file", path=table.path)
    refuse_numbered(table)
    return (photons[::-1].copy(), counts[::-1].copy()) if falls else (photons, counts)


def _may_be_decimals(table: DataTable) -> bool:
    """Whether two columns without names may be one, split at decimal commas."""
    steps = np.diff(table.values[:, 0])
    if table.names is not None or len(steps) < _FEWEST_BINS:
        return False
    unordered = max(np.mean(steps > 0), np.mean(steps < 0)) < 0.8
    return bool(unordered and np.all(table.values == np.floor(table.values)))


def _binned(table: DataTable) -> tuple[Array, Array]:
    """Bin centres and counts of a list of events."""
    events = table.values[:, 0]
    if len(events) < _FEWEST_EVENTS:
        raise InputError(
            f"one column of {len(events)} numbers is no histogram, and as a list of events it is "
            "too short",
            f"write bin centres and counts, or {_FEWEST_EVENTS} events at least",
            path=table.path,
        )
    whole = bool(np.all(events == np.floor(events)))
    if whole and events.min() < 0:
        row = int(np.argmax(events < 0))
        problem = f"{events[row]:g} photons in an event"
        raise table.refusal(row, None, problem, "write the numbers as counted")
    lowest, width = float(events.min()), 1.0 if whole else _bin_width(events)
    bins = math.ceil((events.max() - lowest) / width + 0.5) if width > 0 else 0
    if not _FEWEST_BINS <= bins <= _MOST_BINS:
        problem = f"events from {lowest:g} to {events.max():g} photons fill {bins} bins"
        mend = f"is this a list of photons per event? It should fill {_FEWEST_BINS} to {_MOST_BINS}"
        raise InputError(problem, mend, path=table.path)
    return _sorted_into_bins(events, width)
