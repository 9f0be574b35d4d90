"""The centroid of the main peak in a histogram of photons per event.

A band on a linear background is fitted to the counts around the peak with their Poisson
likelihood: S. Baker and R. D. Cousins, Nucl. Instr. Meth. 221 (1984) 437. The band has one of two
shapes. "gaussian" is the field's usual one. "counting" is what a photon counter sees: the mean
number of photons varies from event to event as a Gaussian, and each event's photons are counted
(Poisson). Such a band leans towards small numbers: a Gaussian that is fitted to it lies below the
mean number, which is what a light yield needs: by 0.3 to 0.4 photons within 1.5 widths, by 0.6 with
a background that is fitted too, or within the top alone.

Background and windows are chosen for the least bias of the expected counts of 20,000 events at 14.3
and 24.5 photons, with a pedestal and a continuum that both fall off exponentially. A line over -1.8
to +2.5 widths leaves 0.05 and -0.06 standard errors; wider windows, and an exponential instead of a
line, leave more at 14.3 (0.12 to 0.33), where the tail of the pedestal reaches into them.

Which shape is right is not left to chi2: a pedestal that reaches into the window makes the band of
a photon counter look like a Gaussian. Whole numbers are counted, unless they cannot be."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtr

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.rounding import counted, p_equals, pdg
from mcrim_mitsuba.laboratory.histogram import SHALLOW, Found, main_peak, peak_inside
from mcrim_mitsuba.laboratory.peak_band import LEAST_P, Peak, fit_band, reaching
from mcrim_mitsuba.laboratory.peak_shapes import COUNTING, GAUSSIAN, Below, numbers_per_bin

AUTO = "auto"
SHAPES = (AUTO, COUNTING, GAUSSIAN)

# Window in widths of the peak, below and above its centroid, and fits until its bins stay the same.
_WINDOW = {GAUSSIAN: (2.0, 2.0), COUNTING: (1.8, 2.5)}
# With a step, which only what lies above the peak tells from a slope, or escape lines.
_WIDE = {GAUSSIAN: (3.0, 5.0), COUNTING: (2.5, 5.0)}
_MOST_FITS = 8
# Bins of a window: five parameters and one degree of freedom.
_FEWEST_BINS = 6
# Standard errors by which a band is narrower than counted photons can be.
_NARROWER = 3.0


def fit_peak(
    values: Array,
    counts: Array,
    *,
    shape: str = AUTO,
    window: tuple[float, float] | None = None,
    below: Below | None = None,
    variances: Array | None = None,
    photoelectrons: bool = False,
) -> Peak | None:
    """Fit the main peak: of the large ones that of the highest value; None if none stands out.

    The pedestal, and peaks of escaping quanta, lie below it. `values` are bin centres, ascending,
    all bins of one width, and `counts` numbers of events, (bins,) float64.

    The shape is "counting", which needs bins of whole numbers; "gaussian"; or "auto": "counting"
    for bins of whole numbers, "gaussian" for others, and for whole numbers that cannot be photons:
    a Gaussian fits, narrower than the square root of its centroid, and "counting" does not.
    The window is the lowest and the highest bin centre to fit; unless given, it is chosen about the
    centroid, but not beyond the valleys to other peaks. What lies `below` the peak besides a line
    is fitted too, in a wider window, which reaches down to escape lines that are merged with it.
    `variances`, (bins,), are those of counts from which others were subtracted. Bins that are known
    to be `photoelectrons`, though no whole numbers, are counted too.

    Raises InputError if the shape is not known or not possible, or the window cannot be used.
    """
    whole = photoelectrons or numbers_per_bin(values) is not None
    _check(values, shape, window, whole)
    if window is None:
        lowest = 1.0 + values[1] - values[0] if photoelectrons else -math.inf
        place = main_peak(values, counts, variances, above=lowest)
    else:
        inside = _inside(values, window)
        place = peak_inside(values[inside], counts[inside])
    if place is None:
        return None
    shapes = (COUNTING, GAUSSIAN) if whole else (GAUSSIAN,)
    data = values, counts, variances
    fits = {name: _fit_shape(*data, place, name, window, below or Below()) for name in shapes}
    peak = fits.pop(shape if shape != AUTO else _likely(fits))
    if peak is None:
        return None
    other = next(iter(fits.values()), None)
    doubts = [*_doubts_of_fit(values, peak, place, window), *_doubts_of_lines(peak, below)]
    if shape == AUTO and whole:
        doubts += _doubts_of_shape(peak, other)
    return replace(peak, other=other, warnings=tuple(doubts))


def _likely(fits: dict[str, Peak | None]) -> str:
    """The shape to choose: counting, unless only a Gaussian describes the band.

    A Gaussian is chosen if it fits, counting does not, and the band is narrower than counted
    photons can be, whose variance is their mean or more.
    """
    if COUNTING not in fits:
        return GAUSSIAN
    counted, bell = fits[COUNTING], fits[GAUSSIAN]
    counts_fit = counted is not None and counted.p_value >= LEAST_P
    if counts_fit or bell is None or bell.p_value < LEAST_P:
        return COUNTING
    missing = bell.centroid - bell.width**2
    sigma = math.hypot(bell.centroid_sigma, 2 * bell.width * bell.width_sigma)
    return GAUSSIAN if missing > _NARROWER * sigma else COUNTING


def _check(values: Array, shape: str, window: tuple[float, float] | None, whole: bool) -> None:
    """Refuse a shape that is not known or not for such bins, and a window beyond the histogram."""
    if shape not in SHAPES:
        raise InputError(f"'{shape}' is no shape of a peak", did_you_mean(shape, SHAPES))
    if shape == COUNTING and not whole:
        raise InputError(
            "the bins are not of whole photon numbers, and the shape 'counting' counts photons",
            "write one bin for each number of photons, or fit the shape 'gaussian'",
        )
    if window is None:
        return
    low, high = window
    half = 0.5 * (values[1] - values[0])
    first, last = values[0] - half, values[-1] + half
    if not first <= low < high <= last:
        problem = f"the window {low:g} to {high:g} does not lie in the histogram"
        raise InputError(problem, f"give two ascending numbers from {first:g} to {last:g}")
    bins = int(_inside(values, window).sum())
    if bins < _FEWEST_BINS:
        problem = f"the window {low:g} to {high:g} has only {bins} bins"
        raise InputError(problem, f"a peak needs {_FEWEST_BINS} at least")


def _inside(values: Array, window: tuple[float, float]) -> NDArray[np.bool_]:
    """(bins,) those in a window."""
    return (values >= window[0]) & (values <= window[1])


def _fit_shape(
    values: Array,
    counts: Array,
    variances: Array | None,
    place: Found,
    shape: str,
    given: tuple[float, float] | None,
    below: Below,
) -> Peak | None:
    """Fit one shape, again until its window stays the same."""

    def fitted(inside: NDArray[np.bool_], start: Array) -> tuple[Peak, Array, bool]:
        of_counts = None if variances is None else variances[inside]
        return fit_band(values[inside], counts[inside], shape, start, of_counts, below)

    # events, centroid, spread and the background at both ends, as `fit_band` has them
    events = place.height * place.width * math.sqrt(2 * math.pi) / (values[1] - values[0])
    spread = place.width if shape == GAUSSIAN else place.width**2 - place.centroid
    start = np.array([events, place.centroid, spread, place.background, place.background])
    if given is not None:
        only, _, clear = fitted(_inside(values, given), start)
        return only if clear else None
    peak: Peak | None = None
    window = np.zeros(len(values), bool)
    for _ in range(_MOST_FITS):
        at, before = peak or place, window
        width = at.width if shape == GAUSSIAN else max(at.width, math.sqrt(max(at.centroid, 0.0)))
        lower, upper = (_WIDE if below.step or below.lines else _WINDOW)[shape]
        low = max(at.centroid - lower * width, place.low)
        for line in reaching(below, low, at.centroid, width):
            low = min(low, line.kept * at.centroid - lower * math.sqrt(line.kept) * width)
        window = _inside(values, (low, min(at.centroid + upper * width, place.high)))
        if window.sum() < _FEWEST_BINS or np.array_equal(window, before):
            break
        peak, start, _ = fitted(window, start)
    return peak


# Widths on each side of the centroid that a fit must see.
_SEEN = 1.5
# Part of the height by which a background must not rise: the usual one falls.
_RISE = 0.25
# Part of the height by which it must not fall.
_FALL = 0.10
# What the fall does to the centroid, in widths, if the background is no line but a flat continuum
# that ends at the centroid: 0.26 to 0.31 of the expected counts of 14.3 and 24.5 photons.
_SHIFT = 0.3
# Part of the centroid, in photons, above which the square of the width is that of counting.
_COUNTED = 0.3
# Error of an escape line's share, of the peak's events, above which it says nothing.
_SHARE_SIGMA = 0.2
# Relative error of the centroid above which there were too few events.
_POOR = 0.02


def _doubts_of_fit(
    values: Array, peak: Peak, place: Found, given: tuple[float, float] | None
) -> Iterator[str]:
    """A sentence for each doubt about a peak that was searched at a `place`."""
    yield from _doubts_of_window(values, peak, place, given)
    yield from _doubts_of_background(peak)
    relative = peak.centroid_sigma / max(abs(peak.centroid), 1e-9)
    if relative > _POOR:
        yield (
            f"the peak is poor, some {peak.events:.0f} events: its centroid is known to "
            f"± {peak.centroid_sigma:.2g} only ({100 * relative:.1f} %)"
        )
    if peak.p_value < LEAST_P:
        yield (
            f"the fit is bad (chi2 = {peak.chi2:.1f}, ndf = {peak.ndf}, {p_equals(peak.p_value)}): "
            f"its errors are {math.sqrt(peak.chi2 / peak.ndf):.2g} times those of the counts"
        )
    yield from _doubts_of_bins(values, peak)


def _doubts_of_window(
    values: Array, peak: Peak, place: Found, given: tuple[float, float] | None
) -> Iterator[str]:
    """Whether the peak is cut, or merged with another one."""
    half = 0.5 * peak.bin_width
    for seen, side, at_end, level in (
        (peak.centroid - peak.low + half, "below", peak.low == values[0], place.low_level),
        (peak.high - peak.centroid + half, "above", peak.high == values[-1], place.high_level),
    ):
        how_far = f"{seen / peak.width:.2g} widths {side} its centroid"
        # no event has less than no photon
        cut = seen < _SEEN * peak.width and not (side == "below" and values[0] == 0 and at_end)
        if given is not None:
            if cut:
                yield f"the peak is cut by the window, only {how_far}: choose a wider one"
        elif cut and at_end:
            yield f"the peak is cut by the end of the histogram, only {how_far}"
        elif cut or (level > SHALLOW and not (side == "below" and peak.lines)):
            yield (
                f"the peak is merged with what lies {side} it: between them the counts fall to "
                f"{100 * level:.0f} % of its height, and the fit ends {how_far}"
            )


def _doubts_of_background(peak: Peak) -> Iterator[str]:
    """Whether the background rises or falls by more than a line under a peak may."""
    rise = peak.background_slope * (peak.high - peak.low)
    at = np.array(peak.centroid)
    height = peak.counts_at(at) - peak.background_at(at)
    if rise > _RISE * height > 0:
        yield (
            "the peak is merged with what lies above it: the background rises by "
            f"{100 * rise / height:.0f} % of its height"
        )
    shift = -_SHIFT * rise / height * peak.width if height > 0 else 0.0
    if -rise > _FALL * height > 0 and shift > peak.centroid_sigma:
        yield (
            f"the background falls by {-100 * rise / height:.0f} % of the peak's height, and may "
            f"be no line: the centroid may be off by some {shift:.2g} "
            f"({100 * shift / max(peak.centroid, 1e-9):.1g} %), too low if a continuum ends under "
            "the peak (fit a step), too high if the tail of a pedestal reaches in"
        )


def _doubts_of_lines(peak: Peak, below: Below | None) -> Iterator[str]:
    """Escape lines that were asked for, and tell nothing."""
    missing = len(below.lines if below else ()) - len(peak.lines)
    if missing:
        yield f"{counted(missing, 'escape line')} below the fitted bins: not a part of the fit"
    for line in peak.lines:
        if line.share_sigma > _SHARE_SIGMA:
            yield (
                f"the escape line at {line.kept:.3g} of the centroid is not told from the peak "
                f"(share {pdg(line.share or 0.0, line.share_sigma)}): give its share"
            )


def _doubts_of_bins(values: Array, peak: Peak) -> Iterator[str]:
    """Whether the bins are what they seem: photons, or not, at their centres."""
    if (
        peak.shape == GAUSSIAN
        and peak.width**2 > _COUNTED * peak.centroid > 0
        and numbers_per_bin(values) is None
    ):
        # mean less mode is about k3 / (2 k2); of counted photons whose mean m has the variance v,
        # k2 = m + v and k3 = m + 3 v: 0.63 of 14.94 with v = (10 %)^2, where this gives 0.60
        lean = peak.width**2 / (2 * peak.centroid)
        if lean > peak.centroid_sigma:
            yield (
                "the bins are no whole photon numbers, and a Gaussian was fitted: if they are "
                "photons or photoelectrons that were counted, the band leans, the Gaussian finds "
                f"its top, and the mean lies some {lean:.2g} ({100 * lean / peak.centroid:.1g} %) "
                "higher, or more where the charge of a single one varies"
            )
    if abs(peak.bin_width - 1.0) < 0.01 and abs(values[0] % 1.0 - 0.5) < 0.01:
        yield (
            "the bins are centred between whole numbers: if their lower edges are the numbers of "
            "photons, the centroid is 0.5 too high"
        )


def _doubts_of_shape(peak: Peak, other: Peak | None) -> Iterator[str]:
    """Doubts where whole numbers are not photons, or another shape describes them better."""
    if peak.shape == GAUSSIAN:
        yield (
            f"the peak is narrower, {peak.width:.3g}, than counted photons can be (the square root "
            f"of {peak.centroid:.4g}): its bins are no photon numbers, and a Gaussian was fitted; "
            "if they are, something else reaches into the window: choose the shape counting"
        )
    elif other is not None and peak.p_value < min(LEAST_P, other.p_value):
        yield (
            f"a Gaussian describes the counts better, with a centroid of {other.centroid:.4g} "
            f"instead of {peak.centroid:.4g}: if the bins are photon numbers, look for what else "
            "reaches into the window, and choose another; if not, choose the shape gaussian"
        )


# One number from repeated measurements, as the article has from four mountings of its crystal.
#
# Mountings scatter by nature, and by more than the error of each centroid: the article's by 0.4 of
# 14.3 photons, where the fit of a histogram knows its centroid to 0.07. The mean therefore takes
# its error from the scatter, and a scatter above the errors is reported, not a fault. Of three
# values or two it is hardly known, its relative error being 1 / sqrt(2 (n - 1)), and this is said.
# Inconsistent are
#
# - an outlier: a value that differs from the mean of the others by more than their own scatter (or
#   the errors, if larger) lets expect, by Student's t with two degrees of freedom less than there
#   are values. The chance that any of n values is called so by mistake is 1 % (p < 1 % / n each).
#   Three values at least; of four, an outlier is 23 standard deviations of the others away;
# - a scatter above 10 % of the mean, three times the article's, which the errors do not explain (p
#   < 1 %). For two values this is the only test.

# Chance of an alarm where nothing is wrong.
_LEAST_P = 0.01
# Relative scatter that no mounting makes.
_MOST_SCATTER = 0.10
# Values whose scatter is hardly known.
_FEW = 3


@dataclass(frozen=True)
class Repeated:
    """Mean of repeated measurements."""

    #: Plain mean, and the larger of the two errors below.
    mean: float
    sigma: float
    #: Standard deviation of the values over the square root of their number; None for one value.
    scatter_sigma: float | None
    #: From the errors of the values.
    internal_sigma: float
    _: KW_ONLY
    #: Of the values about their weighted mean, with their own errors.
    chi2: float
    ndf: int
    #: Chance of a larger chi2; None for one value. Below 1 %, mountings scatter by more than
    #: the errors.
    p_value: float | None
    #: Neither an outlier nor a scatter that no mounting makes.
    consistent: bool
    #: Positions of the outliers, from 0.
    outliers: tuple[int, ...]
    #: What is inconsistent, outliers first, and that the values are few, a sentence each.
    warnings: tuple[str, ...]


def combine(values: Sequence[float], sigmas: Sequence[float]) -> Repeated:
    """Mean of repeated measurements with both of its errors.

    Raises InputError if there is no value, or a number is not finite or an error not above 0.
    """
    x, errors = np.asarray(values, float), np.asarray(sigmas, float)
    if not len(x) or x.shape != errors.shape:
        problem = f"{len(x)} values with {len(errors)} errors"
        raise InputError(problem, "give each value an error, one at least")
    for value, error in zip(x, errors, strict=True):
        if not (math.isfinite(value) and math.isfinite(error) and error > 0):
            raise InputError(f"{value:g} ± {error:g} cannot be averaged", "give an error above 0")
    mean, internal = float(x.mean()), float(np.linalg.norm(errors)) / len(x)
    ndf = len(x) - 1
    if ndf == 0:
        chi2, p_value, spread, scatter = 0.0, None, 0.0, None
    else:
        weighted = float(np.average(x, weights=errors**-2.0))
        chi2 = float(np.sum(((x - weighted) / errors) ** 2))
        p_value, spread = float(chdtrc(ndf, chi2)), float(x.std(ddof=1))
        scatter = spread / math.sqrt(len(x))
    outliers = _outliers(x, errors)
    warnings = [
        f"value {i + 1}, {x[i]:.4g}, is an outlier: the others have a mean of "
        f"{np.delete(x, i).mean():.4g} and scatter by {np.delete(x, i).std(ddof=1):.2g}"
        for i in outliers
    ]
    if p_value is not None and p_value < _LEAST_P and spread > _MOST_SCATTER * abs(mean):
        warnings.append(
            f"the values scatter by {spread:.2g}, more than {100 * _MOST_SCATTER:.0f} % of their "
            f"mean: are they all of one configuration?"
        )
    consistent = not warnings
    if 1 < len(x) <= _FEW:
        warnings.append(
            f"the scatter of only {len(x)} values is itself known to "
            f"{100 / math.sqrt(2 * ndf):.0f} %, and the error of their mean no better: measure more"
        )
    return Repeated(
        mean,
        max(scatter or 0.0, internal),
        scatter,
        internal,
        chi2=chi2,
        ndf=ndf,
        p_value=p_value,
        consistent=consistent,
        outliers=outliers,
        warnings=tuple(warnings),
    )


def _outliers(x: np.ndarray, errors: np.ndarray) -> tuple[int, ...]:
    """Values that the others do not let expect."""
    count = len(x)
    if count < 3:
        return ()
    outliers = []
    for i in range(count):
        others, their_errors = np.delete(x, i), np.delete(errors, i)
        by_errors = errors[i] ** 2 + np.mean(their_errors**2) / (count - 1)
        expected = max(others.var(ddof=1) * count / (count - 1), by_errors)
        t = abs(x[i] - others.mean()) / math.sqrt(expected)
        if 2 * stdtr(count - 2, -t) < _LEAST_P / count:
            outliers.append(i)
    return tuple(outliers)
