"""Shapes of a band of photons per event, and realistic histograms that hold one.

Three kinds of events: those of the band, whose light varies from event to event and whose photons
are counted (Poisson); a pedestal of events that have next to no light, such as noise of the tube;
and a continuum of events that lost some of their energy. Dark counts come on top of all of them.

Dark counts add to the mean: the band's mean is `mean_photons` + `dark_photons`, and this is what
a fit finds. Where the dark counts of a gate were measured, subtract them from the reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields

import numpy as np
from scipy.special import gammaln, ndtr, xlogy

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError

GAUSSIAN = "gaussian"
COUNTING = "counting"

# Reach of the sum over the mean number of photons, in standard deviations.
_REACH = 6.0
# Spacing of its nodes in widths of what is summed: the error is exp(-2 pi^2 / spacing^2), 1e-9.
_SPACING = 1.0
#: Variance of the numbers above which they are as good as Gaussian: a skewness of 3 / 1000 at most,
#: where the sum is of millions of terms.
_GAUSSIAN_FROM = 1e6


def band(
    shape: str, values: Array, centroid: float, spread: float, bin_width: float
) -> tuple[Array, Array]:
    """Density per unit of the bins, and its (2, bins) derivatives by centroid and spread.

    The spread is the width of a Gaussian, or the variance of the mean number of photons. Bins that
    are narrower than a photon, as of calibrated channels, take the density at their centres.
    """
    if shape == GAUSSIAN:
        return gaussian(values, centroid, spread)
    return counting(values, centroid, spread, max(round(bin_width), 1))


def gaussian(values: Array, centroid: float, width: float) -> tuple[Array, Array]:
    """Density of a Gaussian, and its (2, bins) derivatives by centroid and width."""
    deviation = (values - centroid) / width
    density = np.exp(-0.5 * deviation**2) / (width * math.sqrt(2.0 * math.pi))
    return density, np.stack([density * deviation, density * (deviation**2 - 1.0)]) / width


def counting(values: Array, mean: float, variance: float, bin_width: int) -> tuple[Array, Array]:
    """Density per photon of counted photons whose mean number varies as a Gaussian.

    Probability P(n) of n photons, by the generating function exp(m (z - 1) + v (z - 1)^2 / 2),
    whence dP/dm = P(n - 1) - P(n) and dP/dv = (P(n - 2) - 2 P(n - 1) + P(n)) / 2.

    Mean and variance are those of the Gaussian; the variance of the numbers is larger by the
    mean, and where that is large they are Gaussian themselves. Between the bins' centres the gamma
    function carries P on. Also returned are the (2, bins) derivatives by mean and variance.
    """
    if (whole := max(variance, 0.0) + mean) > _GAUSSIAN_FROM:
        width = math.sqrt(whole)
        low, high = (step(values + side * bin_width, mean, width) for side in (-0.5, 0.5))
        by_mean, by_width = (low[1] - high[1]) / bin_width
        by_variance = by_width / (2.0 * width)
        return (low[0] - high[0]) / bin_width, np.stack([by_mean + by_variance, by_variance])
    first = values - 0.5 * (bin_width - 1)
    spread = math.sqrt(max(variance, 0.0))
    nodes = math.ceil(_REACH / _SPACING * math.sqrt(1.0 + variance / mean))
    deviations = np.linspace(-_REACH, _REACH, 2 * nodes + 1)
    weights = np.exp(-0.5 * deviations**2)
    means = np.maximum(mean + spread * deviations, 1e-9)
    # P(n - 2), P(n - 1) and the numbers of the bin
    numbers = first[:, None] + np.arange(-2, bin_width)
    counted = np.maximum(numbers, 0.0)
    exponents = counted[..., None] * np.log(means) - means - gammaln(counted + 1.0)[..., None]
    chances = np.exp(exponents) @ (weights / weights.sum())
    chances[numbers <= -1.0] = 0.0
    below, before, last = (chances[:, i : i + bin_width].sum(axis=1) / bin_width for i in range(3))
    return last, np.stack([before - last, 0.5 * (below - 2.0 * before + last)])


@dataclass(frozen=True)
class EscapeLine:
    """Events of a peak that lack the energy of a quantum which left the crystal."""

    #: The energy that stays, as a part of the peak's.
    kept: float
    #: Events, as a part of the peak's, None: to be fitted; the standard error of a fitted one.
    share: float | None = None
    share_sigma: float = 0.0


@dataclass(frozen=True)
class Below:
    """What lies under a peak and below it, besides a linear background.

    A step is the continuum that ends under the peak (Compton scattering around and in the crystal):
    it falls as the integral of a Gaussian of the peak's width (G. W. Phillips and K. W. Marlow,
    Nucl. Instr. Meth. 137 (1976) 525). Escape lines lie where the light of the energy that stays
    does, in proportion, their variances with it.
    """

    #: Energies of quanta that escape, keV, with their shares; None: to be fitted.
    quanta: tuple[tuple[float, float | None], ...] = ()
    step: bool = False
    #: Of the peak; only with quanta it must be known.
    energy_keV: float | None = None

    @property
    def lines(self) -> tuple[EscapeLine, ...]:
        """Lines of quanta that have less than the peak's energy.

        Raises InputError if that is not known, or a number of a quantum not above 0.
        """
        for number in (number for of in self.quanta for number in of if number is not None):
            if not number > 0:
                mend = "give keV, and events over those of the peak"
                raise InputError(f"{number:g} of an escape line is not above 0", mend)
        if (energy := self.energy_keV) is None and self.quanta:
            raise InputError("escape lines without the energy of the peak", "give its energy_keV")
        kept = ((1.0 - quantum / (energy or 1.0), share) for quantum, share in self.quanta)
        return tuple(EscapeLine(part, share) for part, share in kept if part > 0.0)


def with_lines(
    shape: str,
    values: Array,
    centroid: float,
    spread: float,
    bin_width: float,
    lines: Sequence[tuple[float, float]],
) -> tuple[Array, Array]:
    """Density of a `band` and of its escape lines, each given by what is kept and by its share.

    Also returned are the (2 + lines, bins) derivatives by centroid, spread and shares.
    """
    density, slopes = band(shape, values, centroid, spread, bin_width)
    of_lines = []
    for kept, share in lines:
        narrower = math.sqrt(kept) if shape == GAUSSIAN else kept
        of_line, by = band(shape, values, kept * centroid, narrower * spread, bin_width)
        density = density + share * of_line
        slopes = slopes + share * np.array([[kept], [narrower]]) * by
        of_lines.append(of_line)
    return density, np.vstack([slopes, *of_lines])


def step(values: Array, centroid: float, width: float) -> tuple[Array, Array]:
    """A step down from 1 to 0 at the centroid, and its (2, bins) derivatives by both."""
    density, _ = gaussian(values, centroid, width)
    deviation = (values - centroid) / width
    return ndtr(-deviation), np.stack([density, density * deviation])


def numbers_per_bin(values: Array) -> int | None:
    """How many whole numbers each bin holds; None where bins are not of whole numbers."""
    width = values[1] - values[0]
    numbers = round(width)
    lowest = values[0] - 0.5 * (numbers - 1)
    whole = numbers >= 1 and abs(width - numbers) < 0.01 and abs(lowest - round(lowest)) < 0.01
    return numbers if whole else None


# Beyond the mean of the band, in its standard deviations: where a histogram may end.
_LAST = 8.0
_MOST_EVENTS = 1e12
_MOST_RELATIVE = 1e3
_LARGEST_MEAN = 10_000.0
#: Of each number: whether it must be above 0, and its largest value.
RANGES = {
    "mean_photons": (True, _LARGEST_MEAN),
    "peak_events": (False, _MOST_EVENTS),
    "intrinsic_spread": (False, 0.3),
    "pedestal": (False, _MOST_RELATIVE),
    "pedestal_photons": (True, _LARGEST_MEAN),
    "continuum": (False, _MOST_RELATIVE),
    "continuum_photons": (True, _LARGEST_MEAN),
    "dark_photons": (False, _LARGEST_MEAN),
}


@dataclass(frozen=True)
class PhotonSpectrum:
    """Photons per event of a crystal, and how many events of each kind there are.

    In a measuring time of some minutes at a rate per second, the band has rate * 60 * minutes.

    Raises InputError if a number is negative, not finite, or too large to mean something.
    """

    #: Mean number of photons that an event of the band brings, dark counts not among them.
    mean_photons: float
    #: Events of the band.
    peak_events: float = 20_000.0
    #: Relative standard deviation of the light of the band's events, besides the counting.
    intrinsic_spread: float = 0.10
    #: Events whose numbers of photons n follow exp(-n / pedestal_photons), per event of the band.
    pedestal: float = 0.75
    _: KW_ONLY
    pedestal_photons: float = 1.2
    #: The same for the continuum.
    continuum: float = 0.15
    continuum_photons: float = 25.0
    #: Mean number of dark counts in every event: dark rate times gate.
    dark_photons: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            above, most = RANGES[field.name]
            if not (value > 0 if above else value >= 0) or not value <= most:
                mend = f"give a number {'above 0, at most' if above else 'from 0 to'} {most:g}"
                raise InputError(f"{field.name} is {value:g}", mend)

    @property
    def pedestal_events(self) -> float:
        """Events of the pedestal."""
        return self.pedestal * self.peak_events

    @property
    def continuum_events(self) -> float:
        """Events of the continuum."""
        return self.continuum * self.peak_events

    def photons(self) -> Array:
        """(bins,) whole numbers from 0 to well beyond the band."""
        mean = self.mean_photons + self.dark_photons
        width = math.sqrt(mean + (self.intrinsic_spread * self.mean_photons) ** 2)
        return np.arange(math.ceil(mean + _LAST * width) + 1.0)

    def expected(self, photons: Array) -> Array:
        """(bins,) expected events, for whole numbers from 0 to some largest one, each once."""
        variance = (self.intrinsic_spread * self.mean_photons) ** 2
        band, _ = counting(photons, self.mean_photons, variance, 1)
        events = self.peak_events * band
        for number, fall in (
            (self.pedestal_events, self.pedestal_photons),
            (self.continuum_events, self.continuum_photons),
        ):
            events = events - number * math.expm1(-1.0 / fall) * np.exp(-photons / fall)
        if self.dark_photons:
            mean = self.dark_photons
            dark = np.exp(xlogy(photons, mean) - gammaln(photons + 1.0) - mean)
            events = np.convolve(events, dark)[: len(photons)]
        return events

    def sample(self, seed: int | np.random.Generator) -> Array:
        """(bins,) counts of one measurement, Poisson numbers, for `photons`."""
        return np.random.default_rng(seed).poisson(self.expected(self.photons())).astype(float)

    def events(self, seed: int | np.random.Generator) -> Array:
        """(events,) photons of one measurement's events, in random order."""
        random = np.random.default_rng(seed)
        return random.permutation(np.repeat(self.photons(), self.sample(random).astype(int)))
