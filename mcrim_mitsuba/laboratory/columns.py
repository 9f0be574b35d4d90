"""What the columns of a histogram hold: photoelectrons, a digitiser's channels, or something else.

A digitiser counts events by channel; what a channel stands for is known by a calibration alone. A
table of channels that is taken for one of photoelectrons gives wrong numbers without a word, so
that nothing is taken for photoelectrons that is named channels, that names nothing and has a peak
narrower than counted photons can be, or that is a column of counts.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from mcrim_mitsuba.core.data_table import DataTable
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError

#: First columns of spectra and of traces, and second ones of what each event gave.
_NO_BINS = re.compile(r"wave.?(length|number)|lambda|λ|wellenl|длина|time(?!.?over)|zeit|время")
_NO_BIN_UNITS = ("nm", "µm", "Å", "eV", "1/cm", "s", "ms", "min", "h")
_PER_EVENT = re.compile(
    r"photon|\bamp|charge|ladung|(?<![a-z])p\.?h?\.?e(?![a-z])|electron|volt|height|area"
)
_PER_EVENT_UNITS = ("pe", "p.e.", "phe", "v", "mv", "pc", "fc")
_OF_BINS = re.compile(r"count|event|entr|hits|freq|anzahl|häufig")
_PHOTOELECTRONS = re.compile(r"photon|electron|(?<![a-z])p\.?h?\.?e(?![a-z])")
#: An energy is calibrated by the peak itself; an edge is half a bin away from the bin's centre.
_NO_CENTRES = re.compile(r"edge|bin.?low|^(?!.*(photon|electron)).*(energ|[km]ev\b)")
_CHANNELS = re.compile(
    r"(?<![a-z])(adc|ch|chan|chans|channels?|mca|lsb|kan[aä]le?)(?![a-z])|канал"
    r"|^bins?(?!.?(cent|mid|low|upp|edge))"
)
#: Photons of an event that need no name in a list: digitisers count further.
_FEW = 255
#: Numbered events: more than this part of neighbours differs by more than 3 standard errors,
_JUMPS = 0.05
#: and all are in no order: the ratio of von Neumann (Ann. Math. Stat. 12 (1941) 367) of their ranks
#: is 1.
_ORDERLESS = (0.8, 1.2)
_FEWEST_EVENTS = 300
#: Standard errors by which a peak is narrower than counted photons can be, its least events, and
#: bins within which its width is taken, in widths to each side.
_NARROWER = 5.0
_FEWEST_IN_PEDESTAL = 100
_AROUND = 3.0
#: Lowest place of such a peak: at a photon or two its width says nothing.
_LOWEST = 20.0
#: Smoothings that are tried for it, standard deviations in bins, and the counts over which it is
#: smooth enough.
_SMOOTHINGS = (0.7, 1.4, 2.8, 5.6)
_SMOOTH = 30.0
#: How many times slower it may fall above its top than below.
_LOPSIDED = 3

#: Files of instruments, whose spectra are always in channels.
INSTRUMENTS = (".spe", ".n42", ".chn", ".cnf", ".mca", ".gxml", ".pcf", ".spc", ".root")

_ADD = (
    'give a calibration: [calibration] with single_photoelectron = "spe.csv" (or channels per '
    "photoelectron) in the campaign, or --calibration FILE.toml with that table"
)


def uncalibrated(what: str, path: Path) -> InputError:
    """The refusal of channels where photoelectrons are wanted, with the entries that mend it."""
    return InputError(f"{what}, not photoelectrons", _ADD, path=path)


def refuse_uncalibrated(table: DataTable, bins: Array, counts: Array) -> None:
    """Refuse bins, ascending evenly, that are or may be channels, by their name or a pedestal.

    A list of events must say what it holds, unless these are small whole numbers.
    """
    name = _first_name(table)
    unit = (table.units[0] or "").lower() if table.units else ""
    if _NO_CENTRES.search(f"{name} {unit}"):
        problem = f"the first column, {name}, has energies or edges of bins"
        raise InputError(problem, "give centres: photons or calibrated channels", path=table.path)
    if _PHOTOELECTRONS.search(name):
        return
    if _CHANNELS.search(name):
        raise uncalibrated(f"the first column, {name}, holds channels of a digitiser", table.path)
    if _PER_EVENT.search(name) or unit in _PER_EVENT_UNITS:
        return
    if (place := _pedestal(bins, counts)) is not None:
        raise uncalibrated(
            f"the peak at {place:g} is narrower than counted photons can be, as a pedestal is: "
            "these are channels of a digitiser",
            table.path,
        )
    events = table.values[:, 0]
    if table.values.shape[1] == 1 and (events.max() > _FEW or np.any(events != np.floor(events))):
        raise InputError(
            f"a list of {len(events)} events may be one of photoelectrons, charges or channels",
            "name it in a line above: photoelectrons, charge (in the readings' unit), or adc",
            path=table.path,
        )


def _first_name(table: DataTable) -> str:
    """The first column's name in small letters; empty without one."""
    return "" if table.names is None else table.names[0].lower()


def _pedestal(bins: Array, counts: Array) -> float | None:
    """Place of the lowest peak, if it is narrower than the square root of its place."""
    if bins[0] < 0 or (lowest := lowest_peak(counts)) is None:
        return None
    top, half_width = lowest
    around = math.ceil(_AROUND * half_width)
    near = slice(max(top - around, 0), top + around + 1)
    events = max(counts[near].sum(), 1.0)
    place = float(np.average(bins[near], weights=counts[near]))
    variance = float(np.average((bins[near] - place) ** 2, weights=counts[near]))
    narrow = place - variance > _NARROWER * variance * math.sqrt(2.0 / events)
    return float(bins[top]) if place > _LOWEST and 2.0 * variance < place and narrow else None


def lowest_peak(counts: Array) -> tuple[int, int] | None:
    """Place and half width at half height, in bins, of the first peak; None where none begins.

    It has a hundredth of the counts, and falls to half as fast on both sides.
    """
    from scipy.ndimage import gaussian_filter1d

    enough = np.flatnonzero(np.cumsum(counts) >= max(_FEWEST_IN_PEDESTAL, 0.01 * counts.sum()))
    if not len(enough):
        return None
    for smoothing in _SMOOTHINGS:
        smooth = gaussian_filter1d(counts, smoothing, mode="constant")
        top = int(enough[0])
        # uphill from where a hundredth of the counts lie below
        while top + 1 < len(smooth) and smooth[top + 1 : top + 4].max() > smooth[top]:
            top += 1
        if smooth[top] * smoothing >= _SMOOTH:
            break
    below = np.flatnonzero(smooth[top::-1] < 0.5 * smooth[top])
    above = np.flatnonzero(smooth[top:] < 0.5 * smooth[top])
    # where a continuum begins it falls slowly or not at all
    if not len(below) or not len(above) or above[0] > _LOPSIDED * below[0]:
        return None
    return top, int(min(below[0], above[0]))


def refuse_photoelectrons(table: DataTable) -> None:
    """Refuse bins that are photoelectrons already, where channels are calibrated."""
    if _PHOTOELECTRONS.search(name := _first_name(table)):
        mend = "remove [calibration], or name the spectrum in channels"
        raise InputError(f"the first column, {name}, is calibrated already", mend, path=table.path)


def counts_alone(table: DataTable) -> bool:
    """Whether a single column is the counts of channels, not a list of events.

    Raises InputError where it may be either: whole numbers without a name, in some order.
    """
    values, name = table.values[:, 0], _first_name(table)
    if _OF_BINS.search(name):
        return True
    whole = bool(np.all(values == np.floor(values)) and values.min() >= 0)
    if name or not whole or len(values) < _FEWEST_EVENTS or _order(values) > _ORDERLESS[0]:
        return False
    problem = f"a column of {len(values)} whole numbers may be counts by channel"
    problem += ", or photoelectrons by event"
    raise InputError(problem, "name it in a line above: counts, or photoelectrons", path=table.path)


def _order(values: Array) -> float:
    """Von Neumann's ratio of ranks: 1 where neighbours are independent, 0 if sorted."""
    _, ranks = np.unique(values, return_inverse=True)
    variance = ranks.var()
    return float(np.mean(np.diff(ranks) ** 2) / (2.0 * variance)) if variance else 0.0


def refuse_other_columns(table: DataTable) -> None:
    """Refuse two columns that are swapped, or those of a spectrum, a trace, a list of events."""
    steps = np.diff(table.values, axis=0)
    even = np.all((steps[:1] > 0) & np.isclose(steps, steps[:1]), axis=0)
    if len(steps) > 1 and even[1] and not even[0]:
        problem = "the columns are swapped: the second one ascends evenly, as bins do"
        raise InputError(problem, "write bins first, then counts", path=table.path)
    if table.names is None:
        return
    (bins, events), (unit, other) = table.names, table.units
    first, second = bins.lower(), events.lower()
    if re.match("counts?|entries", first) and _CHANNELS.search(second):
        problem = f"the names are swapped: {bins}, {events}, above bins and counts"
        raise InputError(problem, "name the bins first, then the counts", path=table.path)
    if _NO_BINS.search(first) or unit in _NO_BIN_UNITS:
        problem = f"the first column, {bins}, is not what an event gave"
        mend = "write bin centres in photons per event, and how many events each bin has"
        raise InputError(problem, mend, path=table.path)
    listed = first.startswith(("event", "trigger")) and "photon" in second
    given = _PER_EVENT.search(second) or (other or "").lower() in _PER_EVENT_UNITS
    if listed or (given and not _OF_BINS.search(second)):
        raise InputError(
            f"the second column, {events}, holds no numbers of events: this looks like a list of "
            "numbered events",
            f"keep the column {events} alone, or write bin centres first and then counts",
            path=table.path,
        )


def refuse_numbered(table: DataTable) -> None:
    """Refuse counts that jump from bin to bin in no order: a list of numbered events."""
    counts = table.values[:, 1]
    if len(counts) < _FEWEST_EVENTS:
        return
    # part of the steps that are larger than three standard errors of the counts
    jumps = np.mean(np.diff(counts) ** 2 > 9.0 * (counts[1:] + counts[:-1]))
    if jumps > _JUMPS and _ORDERLESS[0] < _order(counts) < _ORDERLESS[1]:
        raise InputError(
            f"the counts of {len(counts)} bins jump from bin to bin in no order: this looks like "
            "a list of numbered events",
            "keep the second column alone; if most bins of a histogram are empty, join bins",
            path=table.path,
        )
