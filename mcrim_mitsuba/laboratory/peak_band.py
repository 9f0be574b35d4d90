"""A band on its background, fitted to bins by its Poisson likelihood; parts of its width.

S. Baker and R. D. Cousins, Nucl. Instr. Meth. 221 (1984) 437: the likelihood ratio of the counts is
distributed as chi2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from mcrim_mitsuba.core.descent import Array, minimise
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.laboratory import peak_shapes
from mcrim_mitsuba.laboratory.peak_shapes import GAUSSIAN, Below, EscapeLine

# Most steps of a fit.
_MOST_STEPS = 100
# The fall of chi2 still to be expected that ends it.
_CLOSE = 1e-9

#: Expected counts, all above 0, and their (parameters, bins) derivatives.
_Model = Callable[[Array], tuple[Array, Array]]


def _most_likely(
    expected: _Model,
    counts: Array,
    start: Array,
    bounds: tuple[Array, Array],
    held: Sequence[int],
    variances: Array | None,
) -> tuple[Array, Array, Array, float]:
    """Parameters of the largest likelihood, within bounds, expected counts, slopes and chi2.

    Fisher's scoring, damped (`core.descent`); Poisson's likelihood, or Gauss' with `variances`.
    """
    filled = counts > 0

    def chi2_at(p: Array) -> tuple[float, Array, Array]:
        """chi2, half its gradient, and Fisher's information in place of the second derivatives."""
        of_model, slopes = expected(p)
        if variances is not None:
            missing = of_model - counts
            weighed = slopes / variances
            return float(missing @ (missing / variances)), weighed @ missing, weighed @ slopes.T
        ratio = np.log(counts[filled] / of_model[filled])
        chi2 = 2 * (np.sum(of_model - counts) + np.sum(counts[filled] * ratio))
        return float(chi2), slopes @ (1.0 - counts / of_model), (slopes / of_model) @ slopes.T

    end = minimise(chi2_at, start, *bounds, held=held, steps=_MOST_STEPS, precision=_CLOSE)
    return end.point, *expected(end.point), max(end.height, 0.0)


def _inverse_information(slopes: Array, variances: Array) -> Array:
    """Inverse of Fisher's information: the covariance of the parameters."""
    information = (slopes / variances) @ slopes.T
    # in units that make its diagonal 1
    size = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(size, size)
    return np.linalg.pinv(scaled, hermitian=True) * np.outer(size, size)


#: A fit that is worse by chance is rarer than this.
LEAST_P = 0.01
# Standard errors of its events by which a peak must stand out.
_STANDS_OUT = 5.0


@dataclass(frozen=True)
class Peak:
    """A band on a linear background, with what was asked for below it."""

    #: "counting" or "gaussian".
    shape: str
    #: In the unit of the bins: the mean of the band ("counting": the mean number of photons). The
    #: error is that of the counts; where a fit as bad has a chance below 1 %, it is larger by
    #: the square root of chi2 / ndf (Review of Particle Physics, Introduction, section 5.2.2).
    centroid: float
    centroid_sigma: float
    #: Standard deviation of the band, in the unit of the bins; "counting": the square root of
    #: the mean and the variance of the mean.
    width: float
    _: KW_ONLY
    width_sigma: float
    #: Of the band, beyond the window too.
    events: float
    #: In the unit of the bins.
    bin_width: float
    #: At the centroid, in counts per bin, and per unit of the bins.
    background: float
    background_slope: float
    #: Of the continuum that ends under the peak, in counts per bin; 0: none was fitted.
    step: float = 0.0
    step_sigma: float = 0.0
    #: Those that reach the fitted bins.
    lines: tuple[EscapeLine, ...] = ()
    #: Likelihood ratio of the Poisson counts, distributed as chi2.
    chi2: float
    ndf: int
    #: Chance of a larger chi2.
    p_value: float
    #: Centres of the first and last bin that were fitted.
    low: float
    high: float
    #: (bins,) By how much a count more in each of the fitted bins moves the centroid.
    per_count: Array = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    #: What the reader must know before using the centroid, a sentence each.
    warnings: tuple[str, ...] = ()
    #: The fit of the other shape; None where it cannot be fitted.
    other: Peak | None = None

    @property
    def intrinsic_spread(self) -> float | None:
        """Relative standard deviation of the mean number of photons; None for a Gaussian."""
        if self.shape == GAUSSIAN:
            return None
        return math.sqrt(max(self.width**2 - self.centroid, 0.0)) / self.centroid

    @property
    def fitted_below(self) -> dict[str, Any]:
        """Step and escape lines, those that were fitted."""
        step = {"step": self.step, "step_sigma": self.step_sigma} if self.step_sigma else {}
        return step | ({"escape_lines": list(map(asdict, self.lines))} if self.lines else {})

    def background_at(self, values: Array) -> Array:
        """Expected background per bin, with a step."""
        shade, _ = peak_shapes.step(values, self.centroid, self.width)
        line = self.background + self.background_slope * (values - self.centroid)
        return line + self.step * shade

    def counts_at(self, values: Array) -> Array:
        """Expected counts per bin."""
        values = np.asarray(values, float)
        spread = self.width if self.shape == GAUSSIAN else self.width**2 - self.centroid
        lines = [(line.kept, line.share or 0.0) for line in self.lines]
        density, _ = peak_shapes.with_lines(
            self.shape, values.ravel(), self.centroid, spread, self.bin_width, lines
        )
        band = self.events * self.bin_width * density
        return band.reshape(values.shape) + self.background_at(values)


#: Where the parameters of a fit are: events, centroid, spread as `peak_shapes.band` has it, the
#: background at the first and at the last bin, the step, and the share of each escape line.
_ENDS = slice(3, 5)
_STEP = 5
_SHARES = 6
#: Where a share begins.
_SHARE = 0.05
#: Widths to which a line reaches.
_REACH = 2.0


def reaching(below: Below, lowest: float, centroid: float, width: float) -> tuple[EscapeLine, ...]:
    """Escape lines of a peak that reach bins from a lowest one on."""
    return tuple(
        line
        for line in below.lines
        if line.kept * centroid + _REACH * math.sqrt(line.kept) * width > lowest
    )


def fit_band(
    values: Array,
    counts: Array,
    shape: str,
    start: Array,
    variances: Array | None = None,
    below: Below | None = None,
) -> tuple[Peak, Array, bool]:
    """Fit all bins that are given.

    The background, given by what it is at both ends, is never negative: a peak of Poisson numbers
    leans, which a line that may go below 0 would take up. Counts from which others were subtracted
    come with their `variances`, (bins,): they are Gaussian, and what is left of a background may be
    negative. A step and escape lines, where asked for, are never negative.

    It starts at, and also returns, events, centroid, spread as `peak_shapes.band` has it and the
    background at both ends; last, whether the peak stands out. Its warnings are left to others.
    """
    bin_width, below = values[1] - values[0], below or Below()
    width = start[2] if shape == GAUSSIAN else math.sqrt(max(start[1] + start[2], start[1]))
    lines = reaching(below, values[0], start[1], width)
    shares = [_SHARE if line.share is None else line.share for line in lines]
    expected = _model(values, shape, [line.kept for line in lines], positive=variances is None)
    if shape == GAUSSIAN:
        lowest, narrowest, widest = values[0], 0.2 * bin_width, np.ptp(values)
    else:
        lowest, narrowest, widest = max(values[0], 1e-3), 0.0, np.ptp(values) ** 2
    emptiest = 0.0 if variances is None else -np.inf
    least = np.array([0.0, lowest, narrowest, emptiest, emptiest, *[0.0] * (1 + len(lines))])
    most = np.array([np.inf, values[-1], widest, *[np.inf] * (3 + len(lines))])
    asked = np.array([True] * 5 + [below.step, *(line.share is None for line in lines)])
    begin, held = np.array([*start, 0.0, *shares]), np.flatnonzero(~asked).tolist()
    fitted = _most_likely(expected, counts, begin, (least, most), held, variances)
    p, of_model, slopes, chi2 = fitted
    width = p[2] if shape == GAUSSIAN else math.sqrt(p[1] + p[2])
    height = p[0] * bin_width / (width * math.sqrt(2 * math.pi))
    # a background at 0 stays there
    free = asked.copy()
    if variances is None:
        free[_ENDS] = p[_ENDS] > 1e-3 * math.sqrt(height)
    covariance = np.zeros((len(p), len(p)))
    of_counts = of_model if variances is None else variances
    covariance[np.ix_(free, free)] = _inverse_information(slopes[free], of_counts)
    per_count = covariance[1] @ (slopes / of_counts)
    ndf = int(len(values) - free.sum())
    p_value = float(chdtrc(ndf, chi2))
    covariance *= max(chi2 / ndf, 1.0) if p_value < LEAST_P else 1.0
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    of_width = np.array([0.0, 1.0]) if shape == GAUSSIAN else np.full(2, 0.5 / width)
    slope = (p[4] - p[3]) / (values[-1] - values[0])
    peak = Peak(
        shape=shape,
        centroid=float(p[1]),
        centroid_sigma=float(sigmas[1]),
        width=float(width),
        width_sigma=math.sqrt(max(of_width @ covariance[1:3, 1:3] @ of_width, 0.0)),
        events=float(p[0]),
        bin_width=float(bin_width),
        background=float(p[3] + slope * (p[1] - values[0])),
        background_slope=float(slope),
        step=float(p[_STEP]),
        step_sigma=float(sigmas[_STEP]),
        lines=tuple(
            replace(line, share=float(share), share_sigma=float(sigma))
            for line, share, sigma in zip(lines, p[_SHARES:], sigmas[_SHARES:], strict=True)
        ),
        chi2=chi2,
        ndf=ndf,
        p_value=p_value,
        low=float(values[0]),
        high=float(values[-1]),
        per_count=per_count,
    )
    return peak, p[:_STEP], bool(p[0] ** 2 > _STANDS_OUT**2 * covariance[0, 0])


def _model(values: Array, shape: str, kept: Sequence[float], *, positive: bool) -> _Model:
    """Expected counts of bins, and their slopes, of the parameters that `_ENDS` names."""
    bin_width = values[1] - values[0]
    along = (values - values[0]) / (values[-1] - values[0])
    ends = np.stack([1.0 - along, along])

    def expected(p: Array) -> tuple[Array, Array]:
        lines = list(zip(kept, p[_SHARES:], strict=True))
        density, slopes = peak_shapes.with_lines(shape, values, p[1], p[2], bin_width, lines)
        width = p[2] if shape == GAUSSIAN else math.sqrt(p[1] + p[2])
        shade, by = peak_shapes.step(values, p[1], width)
        slopes = p[0] * bin_width * slopes
        # the width of counted photons is the root of the sum of both
        slopes[0] += p[_STEP] * (by[0] + (0.0 if shape == GAUSSIAN else 0.5 / width * by[1]))
        slopes[1] += p[_STEP] * (1.0 if shape == GAUSSIAN else 0.5 / width) * by[1]
        of_model = p[0] * bin_width * density + p[_ENDS] @ ends + p[_STEP] * shade
        if positive:
            of_model = np.maximum(of_model, 1e-6)
        return of_model, np.vstack([bin_width * density, slopes[:2], ends, shade, slopes[2:]])

    return expected


# A peak's width by its origins: counted photoelectrons, where gammas stop, and the rest.
#
# Relative variances add: of N photoelectrons that are counted 1 / N, of light that is collected
# better from some places than from others the square of eta's relative rms over them. What is left
# is the crystal's own non-proportionality, the gain's spread of single photoelectrons, and
# electronics.


@dataclass(frozen=True)
class Width:
    """A full width at half maximum over the centroid, and its standard error."""

    fwhm: float
    sigma: float


@dataclass(frozen=True)
class WidthParts:
    """Parts of a peak's width, which add in quadrature."""

    #: Where gammas stop, in words.
    source: str
    total: Width
    #: By counting photoelectrons, as many as the centroid says.
    counting: Width
    #: By where gammas stop.
    place: Width
    _: KW_ONLY
    #: What is left; 0 where the others make more than the whole.
    rest: Width
    #: By how many standard errors the others' variance exceeds the whole; 0 where it does not.
    excess: float


def width_parts(peak: Peak, source: str, rms: float, rms_sigma: float) -> WidthParts:
    """The width of a peak in photoelectrons, by its origins.

    `source` says in words where gammas stop; `rms` is the relative one of eta over these places.
    """
    n, n_sigma = peak.centroid, peak.centroid_sigma
    total = (peak.width / n) ** 2
    # of a width and a centroid whose errors are independent
    by_width, by_centroid = 2.0 * total * peak.width_sigma / peak.width, 2.0 * total * n_sigma / n
    of_count, of_place = n_sigma / n**2, 2.0 * rms * rms_sigma
    rest = total - 1.0 / n - rms**2
    # the centroid is in the whole and in the counting
    sigma = math.hypot(by_width, by_centroid - of_count, of_place)
    whole = width_of(total, math.hypot(by_width, by_centroid))
    counting = width_of(1.0 / n, of_count)
    place, left = Width(FWHM * rms, FWHM * rms_sigma), width_of(max(rest, 0.0), sigma)
    return WidthParts(source, whole, counting, place, rest=left, excess=max(-rest, 0.0) / sigma)


def width_of(variance: float, sigma: float) -> Width:
    """The width of a relative variance and its error; near zero that of the square."""
    root = math.sqrt(variance)
    return Width(FWHM * root, FWHM * sigma / max(2.0 * root, math.sqrt(sigma)))
