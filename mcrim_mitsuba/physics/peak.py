"""The centroid of the main peak in a histogram of photons per event.

A band on a linear background is fitted to the counts around the peak with their Poisson
likelihood: S. Baker and R. D. Cousins, Nucl. Instr. Meth. 221 (1984) 437. The band has one of two
shapes. "gaussian" is the field's usual one. "counting" is what a photon counter sees: the mean
number of photons varies from event to event as a Gaussian, and each event's photons are counted
(Poisson). Such a band leans towards small numbers: a Gaussian that is fitted to it finds its top,
0.6 photons below the mean number (4 % of 14.3), and the mean is what a light yield needs.

Background and windows are chosen for the least bias of the expected counts of 20,000 events at 14.3
and 24.5 photons, with a pedestal and a continuum that both fall off exponentially. A line over -1.8
to +2.5 widths leaves 0.05 and -0.06 standard errors; wider windows, and an exponential instead of a
line, leave more at 14.3 (0.12 to 0.33), where the tail of the pedestal reaches into them.

Which shape is right is not left to chi2: a pedestal that reaches into the window makes the band of
a photon counter look like a Gaussian. Whole numbers are counted, unless they cannot be.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.physics.peak_band import LEAST_P, Peak, fit_band
from mcrim_mitsuba.physics.peak_search import Found, main_peak, peak_inside
from mcrim_mitsuba.physics.peak_shapes import COUNTING, GAUSSIAN, numbers_per_bin
from mcrim_mitsuba.physics.peak_warnings import doubts_of_shape, warnings_of

__all__ = ["AUTO", "COUNTING", "GAUSSIAN", "SHAPES", "Peak", "fit_peak"]

AUTO = "auto"
SHAPES = (AUTO, COUNTING, GAUSSIAN)

# Window in widths of the peak, below and above its centroid, and fits until its bins stay the same.
_WINDOW = {GAUSSIAN: (2.0, 2.0), COUNTING: (1.8, 2.5)}
_MOST_FITS = 8
# Bins of a window: five parameters and one degree of freedom.
_FEWEST_BINS = 6
# Standard errors by which a band is narrower than counted photons can be.
_NARROWER = 3.0


def fit_peak(
    values: NDArray[np.float64],
    counts: NDArray[np.float64],
    *,
    shape: str = AUTO,
    window: tuple[float, float] | None = None,
) -> Peak | None:
    """Fit the main peak: of the large ones that of the highest value.

    The pedestal, and peaks of escaping quanta, lie below it. The window is chosen about the
    centroid, but not beyond the valleys to other peaks.

    Parameters
    ----------
    values : (bins,) float64
        Bin centres, ascending, all bins of one width.
    counts : (bins,) float64
        Numbers of events.
    shape : str
        "counting", which needs bins of whole numbers; "gaussian"; or "auto": "counting" for bins
        of whole numbers, "gaussian" for others, and for whole numbers that cannot be photons: a
        Gaussian fits, narrower than the square root of its centroid, and "counting" does not.
    window : (float, float), optional
        Lowest and highest bin centre to fit; without it, it is chosen.

    Returns
    -------
    Peak or None
        None where no peak stands out.

    Raises
    ------
    InputError
        If the shape is not known or not possible, or the window cannot be used.
    """
    whole = numbers_per_bin(values) is not None
    _check(values, shape, window, whole)
    if window is None:
        found = main_peak(values, counts)
    else:
        inside = _given(values, window)
        found = peak_inside(values[inside], counts[inside])
    if found is None:
        return None
    fits = {
        name: _fit_shape(values, counts, found, name, window)
        for name in ((COUNTING, GAUSSIAN) if whole else (GAUSSIAN,))
    }
    chosen = shape if shape != AUTO else _likely(fits)
    peak = fits.pop(chosen)
    if peak is None:
        return None
    other = next(iter(fits.values()), None)
    doubts = warnings_of(values, peak, found, window)
    if shape == AUTO and whole:
        doubts += doubts_of_shape(peak, other)
    return replace(peak, other=other, warnings=tuple(doubts))


def _likely(fits: dict[str, Peak | None]) -> str:
    """Counting, where it can be."""
    if COUNTING not in fits:
        return GAUSSIAN
    counted, bell = fits[COUNTING], fits[GAUSSIAN]
    counts_fit = counted is not None and counted.p_value >= LEAST_P
    if counts_fit or bell is None or bell.p_value < LEAST_P:
        return COUNTING
    missing = bell.centroid - bell.width**2
    sigma = math.hypot(bell.centroid_sigma, 2 * bell.width * bell.width_sigma)
    return GAUSSIAN if missing > _NARROWER * sigma else COUNTING


def _check(
    values: NDArray[np.float64], shape: str, window: tuple[float, float] | None, whole: bool
) -> None:
    if shape not in SHAPES:
        raise InputError(f"'{shape}' is no shape of a peak", f"give one of {', '.join(SHAPES)}")
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
        raise InputError(
            f"the window {low:g} to {high:g} does not lie in the histogram",
            f"give two ascending numbers from {first:g} to {last:g}",
        )
    bins = int(_given(values, window).sum())
    if bins < _FEWEST_BINS:
        raise InputError(
            f"the window {low:g} to {high:g} has only {bins} bins",
            f"a peak needs {_FEWEST_BINS} at least",
        )


def _given(values: NDArray[np.float64], window: tuple[float, float]) -> NDArray[np.bool_]:
    """(bins,) those that the user wants to be fitted."""
    return (values >= window[0]) & (values <= window[1])


def _window(
    values: NDArray[np.float64], centroid: float, width: float, found: Found,
    reach: tuple[float, float],
) -> NDArray[np.bool_]:  # fmt: skip
    """(bins,) the bins to fit."""
    low = max(centroid - reach[0] * width, found.low)
    high = min(centroid + reach[1] * width, found.high)
    return (values >= low) & (values <= high)


def _fit_shape(
    values: NDArray[np.float64],
    counts: NDArray[np.float64],
    found: Found,
    shape: str,
    given: tuple[float, float] | None,
) -> Peak | None:
    """Fit one shape, again until its window stays the same."""
    start = _start(shape, found, values)
    if given is not None:
        inside = _given(values, given)
        only, _, clear = fit_band(values[inside], counts[inside], shape, start)
        return only if clear else None
    peak: Peak | None = None
    window = np.zeros(len(values), bool)
    for _ in range(_MOST_FITS):
        at = found if peak is None else peak
        before = window
        width = at.width if shape == GAUSSIAN else max(at.width, math.sqrt(max(at.centroid, 0.0)))
        window = _window(values, at.centroid, width, found, _WINDOW[shape])
        if window.sum() < _FEWEST_BINS or np.array_equal(window, before):
            break
        peak, start, _ = fit_band(values[window], counts[window], shape, start)
    return peak


def _start(shape: str, found: Found, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Events, centroid, spread and the background at both ends, as `fit_band` has them."""
    events = found.height * found.width * math.sqrt(2 * math.pi) / (values[1] - values[0])
    spread = found.width if shape == GAUSSIAN else found.width**2 - found.centroid
    return np.array([events, found.centroid, spread, found.background, found.background])
