"""Finds the main peak of a histogram, before anything is fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks, peak_widths

# Standard errors by which a peak must stand out of what surrounds it; part of the largest peak's
# area that the main one must have.
_STANDS_OUT, _LARGE = 5.0, 0.25
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
    """

    height: float
    centroid: float
    width: float
    background: float
    low: float
    high: float


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
    for smoothing in (1.0, 2.0, 4.0, 8.0):
        smooth = gaussian_filter1d(counts, smoothing, mode="nearest")
        found, _ = find_peaks(smooth, prominence=1e-9)
        if not len(found):
            return None
        widths, _, _, _ = peak_widths(smooth, found, 0.5)
        if smoothing >= 0.15 * widths[np.argmax(widths)] or smoothing == 8.0:
            break
    found, told = find_peaks(smooth, prominence=_STANDS_OUT * np.sqrt(smooth.max()) / 3)
    noise = np.sqrt(np.maximum(smooth[found], 1.0) / (2 * math.sqrt(math.pi) * smoothing))
    clear = told["prominences"] > _STANDS_OUT * noise
    found, prominences = found[clear], told["prominences"][clear]
    if not len(found):
        return None
    widths, _, _, _ = peak_widths(smooth, found, 0.5)
    areas = prominences * widths
    main = np.flatnonzero(areas >= _LARGE * areas.max())[-1]
    top, bin_width = found[main], values[1] - values[0]
    width = max(widths[main] / _FWHM, 1.0) * bin_width
    below = np.arange(max(0, top - math.ceil(4 * width / bin_width)), top + 1)
    high = math.inf
    if main + 1 < len(found):
        high = values[top + np.argmin(smooth[top : found[main + 1]])]
    return Found(
        float(prominences[main]), float(values[top]), float(width),
        float(smooth[top] - prominences[main]), float(values[below[np.argmin(smooth[below])]]),
        float(high),
    )  # fmt: skip


def peak_inside(values: NDArray[np.float64], counts: NDArray[np.float64]) -> Found:
    """The peak of a window that the user chose, whether it stands out or not."""
    smooth = gaussian_filter1d(counts, max(1.0, len(values) / 20), mode="nearest")
    background = float(min(smooth[0], smooth[-1]))
    above = np.maximum(counts - background, 0.0) + 1e-9
    top = int(np.argmax(smooth))
    near = smooth > 0.5 * (smooth[top] + background)
    centroid = float(np.average(values[near], weights=above[near]))
    width = max(np.ptp(values[near]) / _FWHM, values[1] - values[0])
    return Found(
        max(float(smooth[top]) - background, 1.0), centroid, float(width), background,
        -math.inf, math.inf,
    )  # fmt: skip
