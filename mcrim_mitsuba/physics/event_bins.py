"""Bins for a list of events, narrow enough for its main peak.

The rule of Freedman and Diaconis (Z. Wahrscheinlichkeitstheorie 57 (1981) 453) takes the quartiles
of all events: with a pedestal far from a narrow peak, they tell how far, not how narrow.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.physics.peak_search import main_peak

# Bins in standard deviations of the main peak: so narrow they must be, and are made; how much
# narrower they may become, and how many there may be.
_COARSE, _FINE, _NARROWER, _MOST_FINE = 0.5, 0.2, 200, 100_000
# Empty bins beside the events, where a peak is searched.
_MARGIN = 8
# Of a step: how far numbers may be from whole steps.
_UNEVEN = 0.01


def sorted_into_bins(
    events: NDArray[np.float64], width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres and counts of bins of one width, the first about the lowest number.

    Parameters
    ----------
    events : (events,) float64
    width : float
        Of a bin, above 0.
    """
    lowest = float(events.min())
    numbers = np.floor((events - lowest) / width + 0.5).astype(int)
    counts = np.bincount(numbers).astype(float)
    return lowest + width * np.arange(len(counts), dtype=float), counts


def bin_width(events: NDArray[np.float64]) -> float:
    """Width of a bin; 0 where half of the events are alike.

    Parameters
    ----------
    events : (events,) float64
        In any order, not all of them whole numbers.
    """
    low, high = np.percentile(events, (25, 75))
    width = 2.0 * float(high - low) / math.cbrt(len(events))
    step = _step(events)
    if not width:
        return 0.0
    return _whole_steps(_resolving(events, width, step), step)


def _resolving(events: NDArray[np.float64], width: float, step: float) -> float:
    """A width that shows the main peak: the quartiles may lie in a pedestal far away from it."""
    least = max(width / _NARROWER, float(np.ptp(events)) / _MOST_FINE)
    finer = width
    while finer >= least:
        # `main_peak` smooths over up to eight bins
        fine = _whole_steps(finer / 8, step)
        centres, counts = sorted_into_bins(events, fine)
        # a peak in the last bin has sides too
        centres = centres[0] + fine * np.arange(-_MARGIN, len(centres) + _MARGIN)
        found = main_peak(centres, np.pad(counts, _MARGIN))
        if found is None:
            return width
        if finer <= _COARSE * found.width or fine == step:
            return finer
        finer = _FINE * found.width
    # a spike of equal numbers has no width
    return width


def _step(events: NDArray[np.float64]) -> float:
    """Of numbers that electronics give in steps; 0 for others."""
    different = np.unique(events)
    step = float(np.diff(different).min(initial=math.inf))
    steps = (different - different[0]) / step
    even = len(different) < 0.5 * len(events) and np.all(np.abs(steps - np.round(steps)) < _UNEVEN)
    return step if even else 0.0


def _whole_steps(width: float, step: float) -> float:
    """Bins that hold now two, now three of the numbers that can occur would make a comb."""
    return max(round(width / step), 1) * step if step else width
