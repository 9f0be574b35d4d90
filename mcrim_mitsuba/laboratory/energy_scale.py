"""Several lines of known energies in one spectrum: light per keV, and what makes peaks wide.

The squares of relative widths add: counting 1 / N, the spread of single photoelectrons (F - 1) / N,
F being the excess noise factor, and the crystal's own; over 1 / N they lie on a line whose value at
0 is intrinsic (P. Dorenbos et al., IEEE Trans. Nucl. Sci. 42 (1995) 2190).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.laboratory.calibration import (
    CalibratedHistogram,
    calibrated,
    fit_histogram,
    photons_of,
)
from mcrim_mitsuba.laboratory.histogram import Histogram, clear_peaks
from mcrim_mitsuba.laboratory.peak_band import Peak, Width, WidthParts, width_of, width_parts

#: Peaks among which lines are searched, by their events.
_MOST_PEAKS = 12
#: Spread of light per keV, as a part, that lines of one spectrum have at most.
_MOST_SPREAD = 0.30
#: Of a fit's window, in widths below and above.
_WINDOW = (1.8, 2.2)
#: Lines that tell the intrinsic width beside the counting, with something left to check.
_FEWEST = 3
_SINGLE = "spread of single photoelectrons"


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line of known energy in a spectrum."""

    energy_keV: float
    peak: Peak
    #: Photons per event, and per keV over that of the line of the highest energy, with the standard
    #: errors that lines do not share.
    photons: float
    photons_sigma: float
    relative: float
    relative_sigma: float
    #: Its width: ``place`` is the spread of single photoelectrons, ``rest`` what is left.
    width: WidthParts

    @property
    def per_keV(self) -> float:
        """Photons per keV."""
        return self.photons / self.energy_keV


def lines_of(histogram: Histogram, energies_keV: Sequence[float]) -> tuple[Line, ...]:
    """Lines of these energies, ascending, in one histogram of photons per event.

    Of the peaks that stand out those are taken whose photons per keV agree best.

    Raises InputError, of the file, if there are none, or one cannot be fitted.
    """
    energies = sorted(energies_keV)
    histogram, variances = _with_bins_for(histogram, 0.0), None
    if isinstance(histogram, CalibratedHistogram):
        variances = histogram.variances
    peaks = [p for p in clear_peaks(histogram.photons, histogram.counts, variances) if p[0] > 0]
    peaks = sorted(sorted(peaks, key=lambda peak: -peak[2])[:_MOST_PEAKS])
    sets = []
    for chosen in itertools.combinations(peaks, len(energies)):
        logs = np.log([place for place, _, _ in chosen]) - np.log(energies)
        sets.append((float(np.std(logs)), -chosen[-1][2], chosen))
    spread, _, found = min(sets, default=(math.inf, 0.0, ()))
    if spread > _MOST_SPREAD:
        listed = ", ".join(f"{energy:g}" for energy in energies)
        problem = f"{len(peaks)} peaks stand out, but none at the ratios of {listed} keV"
        raise InputError(problem, "name the lines that are in sight", path=histogram.path)
    fitted = [_fitted(histogram, place, width) for place, width, _ in found]
    gain = histogram.calibration.gain.fit if isinstance(histogram, CalibratedHistogram) else None
    excess = gain.excess_noise_factor - 1.0 if gain is not None else 0.0
    photons, sigmas = np.array([photons_of(histogram, peak) for peak in fitted]).T
    relative = photons / energies / (photons[-1] / energies[-1])
    shared = np.where(np.arange(len(energies)) < len(energies) - 1, sigmas[-1] / photons[-1], 0.0)
    relative_sigmas = relative * np.sign(shared) * np.hypot(sigmas / photons, shared)
    return tuple(
        Line(
            energy_keV=energy,
            peak=peak,
            photons=float(photons[i]),
            photons_sigma=float(sigmas[i]),
            relative=float(relative[i]),
            relative_sigma=float(relative_sigmas[i]),
            width=width_parts(peak, _SINGLE, math.sqrt(max(excess, 0.0) / peak.centroid), 0.0),
        )
        for i, (energy, peak) in enumerate(zip(energies, fitted, strict=True))
    )


def _fitted(histogram: Histogram, place: float, width: float) -> Peak:
    """The peak about a place."""
    below, above = _WINDOW
    histogram = _with_bins_for(histogram, width)
    peak = fit_histogram(histogram, window=(place - below * width, place + above * width))
    if peak is None:
        problem = f"the peak at {place:.4g} photons cannot be fitted"
        raise InputError(problem, "leave its line out, or measure longer", path=histogram.path)
    return peak


def _with_bins_for(histogram: Histogram, width: float) -> Histogram:
    """A histogram, its channels joined to bins for a peak of this standard deviation."""
    if not isinstance(histogram, CalibratedHistogram):
        return histogram
    return calibrated(histogram.spectrum, histogram.calibration, width)


def intrinsic_width(lines: Sequence[Line]) -> tuple[Width, float] | None:
    """Full width at half maximum at infinite light, and what is counted per photon, F of F / N.

    By a line through the squares of the relative widths over 1 / N, weighted; None for fewer than
    three lines, of which nothing would be left to check it.
    """
    if len(lines) < _FEWEST:
        return None
    widths = [line.width.total for line in lines]
    squares = np.array([width.fwhm**2 for width in widths]) / FWHM**2
    sigmas = np.array([2.0 * width.fwhm * width.sigma for width in widths]) / FWHM**2
    per_photon = [1.0 / line.peak.centroid for line in lines]
    line = np.polyfit(per_photon, squares, 1, w=1.0 / sigmas, cov="unscaled")
    (counted, intrinsic), covariance = line
    return width_of(max(intrinsic, 0.0), math.sqrt(covariance[1, 1])), float(counted)
