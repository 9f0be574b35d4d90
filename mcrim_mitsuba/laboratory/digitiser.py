"""Spectra in channels, as digitisers and multichannel analysers write them.

Text, CSV and spreadsheets' exports are read as `histogram` says. The formats of instruments are
read by SpecUtils (Sandia National Laboratories), histograms of ROOT by uproot: both come with
``pip install 'mcrim-mitsuba[formats]'``.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import inside, read_bytes
from mcrim_mitsuba.laboratory.columns import INSTRUMENTS
from mcrim_mitsuba.laboratory.histogram import read_histogram

_LIMIT_MB = 50
_ROOT = ".root"
_FEWEST_CHANNELS = 8
#: Histograms that are listed where none is named.
_MOST_LISTED = 12
_LIVE_TIME = re.compile(
    r"live[ _-]?time(?P<before>[^0-9.+-]*(?:- )?)"
    r"(?P<number>[\d.,:]+(?:e[+-]?\d+)?)[\s(\[]*+(?P<unit>[^\W\d_]*+%?)(?!\d)",
    re.IGNORECASE,
)
#: What follows a number of seconds, unless it is another time; and units before a number that it
#: is not in.
_SECONDS = re.compile(r"(s(ecs?|econds?)?)?|(real|dead|clock|total).*", re.IGNORECASE)
_NO_SECONDS = re.compile(
    r"(?<![^\W_])(h(rs?|ours?)?|min(utes?)?|days?|[µμun]s|m(illi|icro)?s(ec)?\w*)(?![^\W_])|%",
    re.IGNORECASE,
)
_INSTALL = "pip install 'mcrim-mitsuba[formats]'"
_EXPORT = "or export it as two columns of text, channel and counts"


@dataclass(frozen=True, eq=False)
class ChannelSpectrum:
    """Events by the channel of a digitiser."""

    #: The file.
    path: Path
    comments: tuple[str, ...]
    #: (channels,) float64: Their numbers, ascending by one step; a channel's middle is its number.
    channels: Array
    #: (channels,) float64: Whole numbers of events.
    counts: Array
    _: KW_ONLY
    #: How long events could be taken, s; None where the file does not say it.
    live_time_s: float | None = None


def read_channels(path: str | Path) -> ChannelSpectrum:
    """Read a spectrum in channels, whatever wrote it; of ROOT files ``file.root:name`` too.

    Raises InputError, with file and line where there is one, if it cannot be used: text as
    `read_histogram` says; other formats if what reads them is missing or fails, or if they hold
    several spectra.
    """
    path, named = inside(Path(path))
    suffix = path.suffix.lower()
    if suffix not in INSTRUMENTS:
        read = read_histogram(path, channels=True)
        times = [time for words in read.comments if (time := _live_time_in(words)) is not None]
        live = _checked_time(path, times[0]) if times else None
        spectrum = ChannelSpectrum(path, read.comments, read.photons, read.counts, live_time_s=live)
    else:
        spectrum = _of_root(path, named) if suffix == _ROOT else _of_instrument(path)
    if not spectrum.counts.any():
        raise InputError("all channels are empty", "name another file", path=path)
    return spectrum


def _live_time_in(comment: str) -> float | None:
    """The live time that a comment tells in seconds; minutes or 1,200.5 are not taken for them."""
    of = _LIVE_TIME.search(comment)
    if of is None or _NO_SECONDS.search(of["before"]) or not _SECONDS.fullmatch(of["unit"]):
        return None
    try:
        return float(of["number"].rstrip(".,"))
    except ValueError:  # commas, or hours and minutes
        return None


def _checked_time(path: Path, live_time_s: float) -> float:
    """A live time above 0."""
    if not live_time_s > 0:
        problem = f"its live time is {live_time_s:g} s"
        raise InputError(problem, "correct it, or remove it and give live_time_s", path=path)
    return live_time_s


def _reader(name: str, path: Path) -> Any:
    """The module that reads a file, which is there and not too large."""
    read_bytes(path, _LIMIT_MB)
    try:
        return importlib.import_module(name)
    except ImportError:
        problem = f"{path.suffix} files are read by {name}, which is not installed"
        raise InputError(problem, f"{_INSTALL}, {_EXPORT}", path=path) from None


def _of_instrument(path: Path) -> ChannelSpectrum:
    """A spectrum by SpecUtils."""
    SpecUtils = _reader("SpecUtils", path)  # noqa: N806
    file = SpecUtils.SpecFile()
    try:
        file.loadFile(str(path), SpecUtils.ParserType.Auto)
    except (RuntimeError, ValueError):
        problem = f"SpecUtils finds no spectrum in it, as {path.suffix} or another format"
        raise InputError(problem, f"is it whole? If so, {_EXPORT[3:]}", path=path) from None
    spectra = [each for each in file.measurements() if each.numGammaChannels() >= _FEWEST_CHANNELS]
    if len(spectra) != 1:
        problem = f"{len(spectra)} spectra in one file"
        raise InputError(problem, "give each a file of its own", path=path)
    counts = np.array(spectra[0].gammaCounts(), float)
    live_time_s, real_time_s = float(spectra[0].liveTime()), float(spectra[0].realTime())
    said = live_time_s > 0 or real_time_s > 0
    comments, channels = (str(spectra[0].title()),), np.arange(float(len(counts)))
    live = _checked_time(path, live_time_s) if said else None
    return ChannelSpectrum(path, comments, channels, _whole(path, counts), live_time_s=live)


def _of_root(path: Path, wanted: str) -> ChannelSpectrum:
    """A histogram (TH1) of a ROOT file, the only one or by its name, its bins as numbered there."""
    uproot = _reader("uproot", path)
    try:
        with uproot.open(path) as file:
            classes = file.classnames(cycle=False).items()
            there = [name for name, of in classes if of.startswith("TH1")]
            named = [name for name in there if name == wanted or not wanted]
            histogram: Any = file[named[0]] if len(named) == 1 else None
            if histogram is not None:
                edges = np.asarray(histogram.axis().edges(), float)
                counts = np.asarray(histogram.values(), float)
    except Exception:  # of a broken file uproot raises what its parts do
        raise InputError("uproot cannot read it", "is it whole?", path=path) from None
    if histogram is None:
        problem = f"{len(there)} histograms (TH1) in one file, none of them {wanted or 'named'}"
        listed = f"{', '.join(there[:_MOST_LISTED])}{' ...' * (len(there) > _MOST_LISTED)}"
        mend = f"name one, as {path.name}:{there[0]}, of {listed}" if there else "name another file"
        raise InputError(problem, mend, path=path)
    name = named[0]
    steps = np.diff(edges)
    if len(counts) < _FEWEST_CHANNELS or not np.allclose(steps, steps[0]):
        problem = f"the histogram {name} has {len(counts)} bins, or bins of several widths"
        raise InputError(problem, f"give {_FEWEST_CHANNELS} of one width at least", path=path)
    return ChannelSpectrum(path, (name,), 0.5 * (edges[1:] + edges[:-1]), _whole(path, counts))


def _whole(path: Path, counts: Array) -> Array:
    """Counts, if they are whole numbers of events."""
    bad = np.flatnonzero((counts < 0) | (counts != np.floor(counts)))
    if len(bad):
        problem = f"{counts[bad[0]]:g} counts in channel {bad[0]} are not a number of events"
        raise InputError(problem, "take counts that are neither scaled nor subtracted", path=path)
    return counts
