"""Finds the main peak of a histogram, before anything is fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks, peak_widths

#: Part of its height to which the counts must fall beside a peak that is alone.
SHALLOW = 0.5
# Standard errors by which a peak must stand out of what surrounds it; part of the largest peak's
# area that the main one must have.
_STANDS_OUT, _LARGE = 5.0, 0.25
# Of the counts, standard deviation in bins.
_SMOOTHINGS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.7, 8.0)
_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))


@dataclass(frozen=True)
class Found:
    """Roughly where the main peak lies.

    Attributes
    ----------
    height, centroid, width, background : float
        Counts per bin above the background, position and standard deviation in the unit of the
        bins, counts per bin.
    low, high : float
        The valleys below and above; high is infinite where no other peak lies above.
    low_level, high_level : float
        How far the counts do not fall there, as a part of the height.
    """

    height: float
    centroid: float
    width: float
    background: float
    low: float
    high: float
    low_level: float = 0.0
    high_level: float = 0.0


def main_peak(values: NDArray[np.float64], counts: NDArray[np.float64]) -> Found | None:
    """The main peak: of the large ones that of the highest value.

    Parameters
    ----------
    values : (bins,) float64
        Bin centres, ascending, all bins of one width.
    counts : (bins,) float64

    Returns
    -------
    Found or None
        None where no peak stands out.
    """
    # as smooth as needed for neighbours to agree within their errors
    for smoothing in _SMOOTHINGS:
        smooth = gaussian_filter1d(counts, smoothing, mode="nearest")
        found, _ = find_peaks(smooth, prominence=1e-9)
        if not len(found):
            return None
        widths, _, _, _ = peak_widths(smooth, found, 0.5)
        if smoothing >= 0.15 * widths[np.argmax(widths)] or smoothing == _SMOOTHINGS[-1]:
            break
    found, told = find_peaks(smooth, prominence=1e-9)
    noise = np.sqrt(np.maximum(smooth[found], 1.0) / (2 * math.sqrt(math.pi) * smoothing))
    clear = told["prominences"] > _STANDS_OUT * noise
    found, prominences = found[clear], told["prominences"][clear]
    if not len(found):
        return None
    widths, _, _, _ = peak_widths(smooth, found, 0.5)
    areas = prominences * widths
    main = np.flatnonzero(areas >= _LARGE * areas.max())[-1]
    top, bin_width = found[main], values[1] - values[0]
    height, half_width = _half_width(smooth, top)
    width = max(2.0 * half_width / _FWHM, 1.0) * bin_width
    below = np.arange(max(0, top - math.ceil(4 * width / bin_width)), top + 1)
    low = below[np.argmin(smooth[below])]
    high = top
    if main + 1 < len(found):
        high = top + np.argmin(smooth[top : found[main + 1]])
    base = smooth[top] - height
    return Found(
        height, float(values[top]), float(width), float(base), float(values[low]),
        float(values[high]) if high > top else math.inf,
        float((smooth[low] - base) / height) if low > 0 else 0.0,
        float((smooth[high] - base) / height) if high > top else 0.0,
    )  # fmt: skip


def _half_width(smooth: NDArray[np.float64], top: int) -> tuple[float, int]:
    """Height and half width of a peak, in bins, on that side where it falls off further.

    The other side may be cut, or reach into another peak.
    """
    sides = []
    for side in (smooth[top::-1], smooth[top:]):
        higher = np.flatnonzero(side > side[0])
        side = side[: higher[0]] if len(higher) else side
        height = float(side[0] - side.min())
        sides.append((height, int(np.argmax(side < side[0] - 0.5 * height))))
    return max(sides)


def peak_inside(values: NDArray[np.float64], counts: NDArray[np.float64]) -> Found | None:
    """The peak of a window that the user chose, however little it stands out; None without one."""
    smooth = gaussian_filter1d(counts, max(1.0, len(values) / 20), mode="nearest")
    top, background = int(np.argmax(smooth)), float(min(smooth[0], smooth[-1]))
    height = float(smooth[top]) - background
    near = smooth > background + 0.5 * height
    if not near.any():
        return None
    width = max(np.ptp(values[near]) / _FWHM, values[1] - values[0])
    centroid = float(np.average(values[near], weights=smooth[near]))
    return Found(height, centroid, float(width), background, -math.inf, math.inf)
