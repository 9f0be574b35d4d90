"""From a digitiser's channels to photoelectrons: (channel - pedestal) / gain x range ratio.

The gain is that of single photoelectrons, in a range of the amplifier that is so many times, the
range ratio, finer than that of the light. All readings share the errors of the gain and of the
ratio, which is one factor on all of them and leaves their ratios alone, and that of a pedestal that
was measured once, which is one shift of all of them. A pedestal that every spectrum has of its own
is an error of its own.

A background's spectrum is subtracted by live times. The differences are Gaussian; their variance,
that of both spectra, is taken of counts that are smoothed over the neighbours, for their own roots
would give bins that fell low too much weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.laboratory.digitiser import ChannelSpectrum, read_channels
from mcrim_mitsuba.laboratory.histogram import Histogram, main_peak, read_histogram
from mcrim_mitsuba.laboratory.peak import Repeated, combine, fit_peak
from mcrim_mitsuba.laboratory.peak_band import Peak
from mcrim_mitsuba.laboratory.single_photoelectron import (
    Pedestal,
    SinglePhotoelectrons,
    fit_pedestal,
)

#: Bins of the main peak's standard deviation, at most.
_FINE = 8.0
#: Smoothing of the counts for their variances, in widths of the main peak.
_SMOOTH = 0.3
#: Least part of a peak's error that is its own.
_OWN = 0.05
#: Variance of bins far from all counts.
_LEAST = 0.3


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Channels per photoelectron, and its standard error."""

    value: float
    sigma: float
    #: The spectrum that it comes of, and what was fitted to it; None of a number.
    spectrum: ChannelSpectrum | None = None
    fit: SinglePhotoelectrons | None = None


@dataclass(frozen=True, kw_only=True)
class ChannelCalibration:
    """What turns channels into photoelectrons."""

    gain: Gain
    #: One for all spectra; None: every spectrum's own.
    pedestal: Pedestal | None
    #: The run that it comes of; None of a number, and without one.
    pedestal_run: ChannelSpectrum | None = None
    #: Channels per photoelectron where the gain was measured, over those where the light is.
    range_ratio: float = 1.0
    range_ratio_sigma: float = 0.0
    #: k of reading = true / (1 + k true), per photoelectron.
    nonlinearity: float = 0.0
    nonlinearity_sigma: float = 0.0
    background: ChannelSpectrum | None = None
    #: Of spectra whose files do not say it, s: their live time; their real time where every event
    #: makes the digitiser dead for so long.
    live_time_s: float | None = None
    dead_time_us: float | None = None

    @property
    def per_channel(self) -> float:
        """Photoelectrons of a channel of the light's range."""
        return self.range_ratio / self.gain.value

    @property
    def parts(self) -> dict[str, float]:
        """Relative errors that all readings share, by origin."""
        parts = {
            "gain": self.gain.sigma / self.gain.value,
            "range ratio": self.range_ratio_sigma / self.range_ratio,
        }
        return {origin: sigma for origin, sigma in parts.items() if sigma > 0.0}

    @property
    def scale_sigma(self) -> float:
        """Relative standard error that all readings share."""
        return math.hypot(*self.parts.values())

    @property
    def offset_sigma(self) -> float:
        """What the pedestal's error moves all readings by, in photoelectrons."""
        return 0.0 if self.pedestal is None else self.pedestal.sigma * self.per_channel

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know of the calibration."""
        fit, spectrum = self.gain.fit, self.gain.spectrum
        if fit is None or spectrum is None:
            return ()
        notes = [f"{spectrum.path.name}: {warning}" for warning in fit.warnings]
        if fit.crosstalk and fit.crosstalk > 3.0 * (fit.crosstalk_sigma or 0.0):
            notes.append(
                f"photoelectrons are fired cells, and crosstalk fires more of them: crosstalk = "
                f"{fit.crosstalk:.3g}, crosstalk_sigma = {fit.crosstalk_sigma:.1g} in [light_yield]"
            )
            notes.append(
                "few photoelectrons do not tell how many cells there are: name the effect "
                "cell_saturation, with the number of the data sheet as a prior of cells"
            )
        return tuple(notes)

    def light(self, photoelectrons: float) -> tuple[float, float]:
        """Photoelectrons that the readout would give if it were linear, and the slope there."""
        kept = 1.0 - self.nonlinearity * photoelectrons
        if not kept > 0.0:
            problem = f"nonlinearity = {self.nonlinearity:g} of {photoelectrons:.4g} photoelectrons"
            raise InputError(problem, "below 1 over them it has no answer: correct it")
        return photoelectrons / kept, kept**-2.0


@dataclass(frozen=True, eq=False)
class CalibratedHistogram(Histogram):
    """A histogram in photoelectrons, and what it was in channels.

    Channels are joined to bins of an eighth of the main peak's standard deviation.
    """

    _: KW_ONLY
    spectrum: ChannelSpectrum
    calibration: ChannelCalibration
    pedestal: Pedestal
    #: (bins,) of `counts`, from which a background was subtracted; None: of Poisson's law.
    variances: Array | None
    #: (bins,) The background that was subtracted; None without one.
    background: Array | None


def fit_histogram(histogram: Histogram, **options: Any) -> Peak | None:
    """The main peak of a histogram of photons per event; options and errors as of `fit_peak`."""
    if isinstance(histogram, CalibratedHistogram):
        options |= {"variances": histogram.variances, "photoelectrons": True}
    return fit_peak(histogram.photons, histogram.counts, **options)


def window_of(
    histogram: Histogram, window: tuple[float, float] | None
) -> tuple[float, float] | None:
    """A window in the unit of a histogram's file, as the part of its photons per event.

    Raises InputError if it is of channels that the spectrum does not have.
    """
    if window is None or not isinstance(histogram, CalibratedHistogram):
        return window
    first, last = histogram.spectrum.channels[[0, -1]]
    if not first <= window[0] < window[1] <= last:
        problem = f"the window {window[0]:g} to {window[1]:g} does not lie in the spectrum"
        raise InputError(problem, f"give two ascending channels from {first:g} to {last:g}")
    ends = np.array(window) - histogram.pedestal.position
    low, high = (ends * histogram.calibration.per_channel).tolist()
    # the last channels may be too few for a bin
    return max(low, histogram.photons[0]), min(high, histogram.photons[-1])


def read_photons(path: str | Path, calibration: ChannelCalibration | None) -> Histogram:
    """A histogram of photons per event, or a digitiser's spectrum, calibrated.

    Raises InputError as `read_histogram` and `read_channels` do.
    """
    if calibration is None:
        return read_histogram(path)
    return calibrated(read_channels(path), calibration)


def photons_of(histogram: Histogram, peak: Peak) -> tuple[float, float]:
    """Photons per event by a histogram's peak, and the standard error that it shares with none."""
    if not isinstance(histogram, CalibratedHistogram):
        return peak.centroid, peak.centroid_sigma
    calibration = histogram.calibration
    light, slope = calibration.light(peak.centroid)
    own = 0.0 if calibration.pedestal is not None else histogram.pedestal.sigma
    return light, slope * math.hypot(peak.centroid_sigma, own * calibration.per_channel)


def background_noise(histogram: Histogram, peak: Peak) -> Array:
    """(channels,) What the counts of the background's run, by their errors, move photons by.

    All spectra share them; none without a background that was subtracted.
    """
    if not isinstance(histogram, CalibratedHistogram) or histogram.background is None:
        return np.zeros(0)
    calibration, counts = histogram.calibration, histogram.spectrum.counts
    assert calibration.background is not None
    of_run = calibration.background.counts
    per_bin = np.zeros(len(histogram.photons))
    per_bin[(histogram.photons >= peak.low) & (histogram.photons <= peak.high)] = peak.per_count
    join = round(float(np.diff(histogram.photons[:2])[0]) / calibration.per_channel)
    per_channel = np.repeat(per_bin, join)
    per_channel = np.pad(per_channel, (0, len(counts) - len(per_channel)))
    ratio = float(histogram.background.sum() / of_run[: join * len(per_bin)].sum())
    return -calibration.light(peak.centroid)[1] * ratio * per_channel * np.sqrt(of_run)


def combined_photons(peaks: Sequence[tuple[Histogram, Peak]]) -> tuple[Repeated, float, Array]:
    """Mean photons of mountings, its error without and with the `background_noise`, and this."""
    noises = [background_noise(*peak) for peak in peaks]
    values = [photons_of(*peak) for peak in peaks]
    # the background's part is less than the whole, but for rounding
    both = ((sigma, noise @ noise) for (_, sigma), noise in zip(values, noises, strict=True))
    own = [math.sqrt(max(sigma**2 - float(part), (_OWN * sigma) ** 2)) for sigma, part in both]
    combined, noise = combine([value for value, _ in values], own), np.mean(noises, axis=0)
    whole = math.hypot(combined.sigma, float(np.linalg.norm(noise)))
    return replace(combined, sigma=whole), combined.sigma, noise


def calibrated(
    spectrum: ChannelSpectrum, calibration: ChannelCalibration, width: float | None = None
) -> CalibratedHistogram:
    """A spectrum of light in photoelectrons, its background subtracted.

    Its bins are an eighth of a standard deviation of `width` photoelectrons; None: the main peak's.

    Raises InputError if it has no pedestal where it should, or does not go with the background.
    """
    spectrum = with_live_time(spectrum, calibration.live_time_s, calibration.dead_time_us)
    if (pedestal := calibration.pedestal) is None:  # its own, below its main peak
        pedestal = fit_pedestal(spectrum.channels, spectrum.counts)
        main = None
        if pedestal is not None:
            lowest = pedestal.position + 1.0 / calibration.per_channel
            main = main_peak(spectrum.channels, spectrum.counts, above=lowest)
        if pedestal is None or main is None or main.centroid - main.width < pedestal.position:
            mend = 'give it under [calibration]: pedestal = 120, or a run: pedestal = "dark.csv"'
            raise InputError("no pedestal stands out at the low end", mend, path=spectrum.path)
    counts, background, ratio = spectrum.counts, None, 0.0
    if calibration.background is not None:
        ratio = _live_times(spectrum, calibration.background)
        background = ratio * calibration.background.counts
        counts = counts - background
    photons = (spectrum.channels - pedestal.position) * calibration.per_channel
    step = photons[1] - photons[0]
    if width is None:
        variances = None if background is None else spectrum.counts
        place = main_peak(photons, counts, variances, above=1.0 + step)
        width = place.width if place is not None else step
    join = max(int(width / (_FINE * step)), 1)
    bins = len(photons) // join

    def joined(values: Array) -> Array:
        return np.asarray(values[: bins * join].reshape(bins, join).sum(axis=1), float)

    variances = None
    if background is not None:
        bins_wide = width / (step * join)
        variances = _variances(joined(spectrum.counts), joined(background), ratio, bins_wide)
    return CalibratedHistogram(
        spectrum.path,
        spectrum.comments,
        joined(photons) / join,
        joined(counts),
        spectrum=spectrum,
        calibration=calibration,
        pedestal=pedestal,
        variances=variances,
        background=None if background is None else joined(background),
    )


def _live_times(spectrum: ChannelSpectrum, background: ChannelSpectrum) -> float:
    """Live time of a spectrum over that of its background, whose channels must be the same."""
    if not np.array_equal(background.channels, spectrum.channels):
        ends = (f"{c[0]:g} to {c[-1]:g}" for c in (spectrum.channels, background.channels))
        problem = f"its channels are not those of the background: {' and '.join(ends)}"
        raise InputError(problem, "take both with the same settings", path=spectrum.path)
    times = spectrum.live_time_s, background.live_time_s
    for each, time in zip((spectrum, background), times, strict=True):
        if time is None:
            raise InputError(
                "the file does not say its live time in seconds, to subtract the background by it",
                "give live_time_s (of the spectra) and background_live_time_s under [calibration]",
                path=each.path,
            )
    return (times[0] or 0.0) / (times[1] or 1.0)


def _variances(counts: Array, background: Array, ratio: float, width: float) -> Array:
    """Variances of counts less a background that was scaled by the ratio of live times."""
    from scipy.ndimage import gaussian_filter1d

    of_both = counts + ratio * background
    smooth = gaussian_filter1d(of_both, max(_SMOOTH * width, 0.5), mode="nearest")
    return np.asarray(np.maximum(smooth, _LEAST), float)


def with_live_time(
    spectrum: ChannelSpectrum, live_time_s: float | None, dead_time_us: float | None
) -> ChannelSpectrum:
    """A spectrum with its live time, where the file has none.

    With a dead time the given one is the real time, of which every event took that much away: a
    detector that does not extend it (G. F. Knoll, Radiation Detection and Measurement, 4.VII).

    Raises InputError if nothing would be left of it.
    """
    if spectrum.live_time_s is not None or live_time_s is None:
        return spectrum
    dead_s = 1e-6 * (dead_time_us or 0.0) * float(spectrum.counts.sum())
    if not dead_s < live_time_s:
        problem = f"its events were dead for {dead_s:.4g} s of {live_time_s:g} s"
        raise InputError(problem, "check the time, and dead_time_us", path=spectrum.path)
    return replace(spectrum, live_time_s=live_time_s - dead_s)
