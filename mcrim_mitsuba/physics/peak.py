"""The centroid of the main peak in a histogram of counts.

A Gaussian on a linear background is fitted to the counts around the peak with their Poisson
likelihood: S. Baker and R. D. Cousins, Nucl. Instr. Meth. 221 (1984) 437.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.signal import find_peaks, peak_widths

# Standard errors by which a peak must stand out of what surrounds it; part of the largest peak's
# area that the main one must have.
_STANDS_OUT, _LARGE = 5.0, 0.25
# Window in widths of the peak, and fits until its bins stay the same.
_WINDOW, _MOST_FITS = 2.0, 8
# Bins of a window: five parameters and one degree of freedom.
_FEWEST_BINS = 6
_FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))


@dataclass(frozen=True)
class Peak:
    """A Gaussian on a linear background.

    Attributes
    ----------
    centroid, centroid_sigma : float
        In the unit of the bins. Where chi2 exceeds ndf the error is larger by the square root
        of chi2 / ndf (Review of Particle Physics, Introduction, section 5.2.2).
    width, width_sigma : float
        Standard deviation of the Gaussian, in the unit of the bins.
    height : float
        Of the Gaussian, in counts per bin.
    background, background_slope : float
        At the centroid, in counts per bin, and per unit of the bins.
    chi2, ndf : float, int
        Likelihood ratio of the Poisson counts, distributed as chi2.
    low, high : float
        Centres of the first and last bin that were fitted.
    """

    centroid: float
    centroid_sigma: float
    width: float
    width_sigma: float
    height: float
    background: float
    background_slope: float
    chi2: float
    ndf: int
    low: float
    high: float

    def background_at(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected background per bin."""
        return self.background + self.background_slope * (values - self.centroid)

    def counts_at(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected counts per bin."""
        deviation = (values - self.centroid) / self.width
        return self.height * np.exp(-0.5 * deviation**2) + self.background_at(values)


def fit_peak(values: NDArray[np.float64], counts: NDArray[np.float64]) -> Peak | None:
    """Fit the main peak: of the large ones that of the highest value.

    The pedestal, and peaks of escaping quanta, lie below it. A Gaussian on a linear background
    is fitted within two widths of the peak, but not beyond the valley below it.

    Parameters
    ----------
    values : (bins,) float64
        Bin centres, ascending, all bins of one width.
    counts : (bins,) float64

    Returns
    -------
    Peak or None
        None where no peak stands out.
    """
    first = _main_peak(values, counts)
    if first is None:
        return None
    start, valley = first
    peak = None
    window = np.zeros(len(values), bool)
    for _ in range(_MOST_FITS):
        centroid, width = (start[1], start[2]) if peak is None else (peak.centroid, peak.width)
        before = window
        window = (np.abs(values - centroid) <= _WINDOW * width) & (values >= valley)
        if window.sum() < _FEWEST_BINS:
            return peak
        if np.array_equal(window, before):
            break
        peak = _fit(values[window], counts[window], start)
        ends = np.maximum(peak.background_at(np.array([peak.low, peak.high])), 0.0)
        start = np.array([peak.height, peak.centroid, peak.width, *ends])
    return peak


def _main_peak(
    values: NDArray[np.float64], counts: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float] | None:
    """Where a fit may start, and the valley below the peak."""
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
    valley = values[below[np.argmin(smooth[below])]]
    base = smooth[top] - prominences[main]
    return np.array([prominences[main], values[top], width, base, base]), float(valley)


def _background_shapes(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, bins) lines that are 1 at one end of the window and 0 at the other."""
    along = (values - values[0]) / (values[-1] - values[0])
    return np.stack([1.0 - along, along])


def _fit(
    values: NDArray[np.float64], counts: NDArray[np.float64], start: NDArray[np.float64]
) -> Peak:
    """Fit a window; the background, given by what it is at the window's ends, is never negative.

    A peak of Poisson numbers is lopsided, which a line that may go below 0 would take up.
    """
    ends = _background_shapes(values)
    logarithms = np.where(counts > 0, counts * np.log(np.maximum(counts, 1.0)), 0.0)

    def expected(p: NDArray[np.float64]) -> NDArray[np.float64]:
        bell = np.exp(-0.5 * ((values - p[1]) / p[2]) ** 2)
        return np.maximum(p[0] * bell + p[3:] @ ends, 1e-6)

    def residuals(p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Signed square roots of every bin's part of the likelihood ratio."""
        of_model = expected(p)
        deviance = 2 * (of_model - counts + logarithms - counts * np.log(of_model))
        return np.sign(of_model - counts) * np.sqrt(np.maximum(deviance, 0.0))

    least = np.array([0.0, values[0], 0.2 * (values[1] - values[0]), 0.0, 0.0])
    most = np.array([np.inf, values[-1], np.ptp(values), np.inf, np.inf])
    inside = np.clip(start, least + 1e-9 * np.abs(least) + 1e-9, most)
    found = least_squares(
        residuals, inside, bounds=(least, most), x_scale=np.maximum(np.abs(inside), 1.0)
    )
    p = found.x
    deviation = (values - p[1]) / p[2]
    bell = np.exp(-0.5 * deviation**2)
    by_shape = [bell, p[0] * bell * deviation / p[2], p[0] * bell * deviation**2 / p[2]]
    # a background at 0 stays there
    slopes = np.stack([*by_shape, *ends[p[3:] > 1e-3 * math.sqrt(p[0])]])
    covariance = np.linalg.pinv((slopes / expected(p)) @ slopes.T)
    chi2, ndf = float(2 * found.cost), len(values) - len(slopes)
    worse = math.sqrt(max(chi2 / ndf, 1.0))
    sigma = worse * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    slope = (p[4] - p[3]) / (values[-1] - values[0])
    return Peak(
        centroid=float(p[1]), centroid_sigma=float(sigma[1]), width=float(p[2]),
        width_sigma=float(sigma[2]), height=float(p[0]),
        background=float(p[3] + slope * (p[1] - values[0])), background_slope=float(slope),
        chi2=chi2, ndf=ndf, low=float(values[0]), high=float(values[-1]),
    )  # fmt: skip
