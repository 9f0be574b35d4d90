"""Pedestal and gain of a digitiser's channels, from spectra of next to no light.

The number n of photoelectrons of such flashes is Poisson's; in silicon, where a cell that fires may
fire others, it is the generalised Poisson's (S. Vinogradov, NIM A 695 (2012) 247)

    P(n) = mu (mu + n lam)^(n - 1) exp(-mu - n lam) / n!,   lam = -ln(1 - crosstalk),

and n of them make a Gaussian at pedestal + n gain of the variance noise^2 + n spread^2 (E. H.
Bellamy et al., NIM A 339 (1994) 468, without the discharges that they add to the pedestal). An
afterpulse adds a charge that falls exponentially (V. Chmill et al., NIM A 854 (2017) 70), one an
event at most. All numbers are those of the largest Poisson likelihood of the counts, by MINUIT.

Tubes without a pedestal in sight tell the gain by the excess of noise alone: mean M and variance V
of a flash of equal light are gain mu and gain^2 mu F, F being the excess noise factor
1 + (spread / gain)^2, so that the gain is V / (M F).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial

import numpy as np
from scipy.special import chdtrc, gammaln, log_ndtr, ndtr, xlogy

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.laboratory.columns import lowest_peak
from mcrim_mitsuba.laboratory.peak_band import LEAST_P, fit_band
from mcrim_mitsuba.laboratory.peak_shapes import GAUSSIAN

_PARAMETERS = ("events", "mean", "pedestal", "noise", "gain", "spread", "lam", "after", "decay")
#: Of what silicon has besides; afterpulses are tried where a fit without is bad, and kept where
#: they lower chi2 by so much.
_CROSSTALK = ("lam",)
_AFTERPULSES = ("lam", "after", "decay")
_TOLD = 25.0
#: Of a pedestal's fit: widths to both sides, for light lies above it, and fits until it stays.
_BELOW = 3.0
_ABOVE = 1.7
_FITS = 4
#: Its height over what lies under it; the part of its events that may lie below it, so many widths
#: away.
_OVER = 2.0
_LITTLE = 0.02
_CLEAR = 5.0
_FEWEST_BINS = 7
#: Bins of the fit in widths of the pedestal; the likelihood integrates over them.
_BIN = 0.3
#: Expected counts of the groups of bins that are judged by chi2.
_FEWEST_EXPECTED = 8.0
#: Ratio of spread and gain below which single photoelectrons are told apart, as in silicon.
_RESOLVED = 0.25
#: Where the fit begins: spreads over gain, and lam.
_STARTS = ((0.08, 0.0), (0.08, 0.12), (0.35, 0.0), (0.35, 0.12))
#: chi2 / ndf above which further starts are tried.
_FAIR = 2.0
#: Most photoelectrons of an event beyond those that the highest channel holds.
_BEYOND = 8
_MOST_MEAN = 30.0
_MOST_NUMBERS = 200
_LARGEST_LAM = 0.7


@dataclass(frozen=True)
class Pedestal:
    """Where events without light lie, in channels."""

    position: float
    sigma: float
    #: Standard deviation of the noise; None where the position is given as a number.
    width: float | None = None


@dataclass(frozen=True)
class SinglePhotoelectrons:
    """What a spectrum of a few photoelectrons says, in channels of its own range."""

    #: Channels per photoelectron.
    gain: float
    gain_sigma: float
    _: KW_ONLY
    pedestal: Pedestal
    #: Mean number of photoelectrons of an event, without those that crosstalk adds.
    mean: float
    mean_sigma: float
    #: Probability that a cell that fires fires others at once; None of a tube, 0.
    crosstalk: float | None = None
    crosstalk_sigma: float | None = None
    #: Probability that a cell that fired has an afterpulse in the gate; None where none is told.
    afterpulsing: float | None = None
    afterpulsing_sigma: float | None = None
    #: Standard deviation of a photoelectron's charge, in channels; None by excess noise.
    spread: float | None = None
    #: Mean square of the charge over the square of its mean, for each primary photoelectron.
    excess_noise_factor: float
    excess_noise_factor_sigma: float
    events: float
    #: Likelihood ratio of the counts, and the chance of a larger one; None by excess noise. Errors
    #: are those of the counts; where that chance is below 1 %, larger by sqrt(chi2 / ndf).
    chi2: float | None = None
    ndf: int = 0
    p_value: float | None = None
    #: Of the expected counts, as they were fitted; none by excess noise.
    parameters: tuple[float, ...] = ()
    #: What the reader must know, a sentence each.
    warnings: tuple[str, ...] = ()

    def counts_below(self, channels: Array) -> Array:
        """Expected counts below these places."""
        numbers = math.ceil((channels.max() - self.pedestal.position) / self.gain) + _BEYOND
        return _cumulative(channels, self.parameters, max(numbers, _BEYOND))


def fit_pedestal(channels: Array, counts: Array) -> Pedestal | None:
    """The pedestal: the lowest peak, by a Gaussian about its top; None where none begins.

    Channels ascend by the same step; counts are numbers of events, (bins,) float64 both.
    """
    if (lowest := lowest_peak(counts)) is None:
        return None
    step = channels[1] - channels[0]
    top, half_width = lowest
    position, width = float(channels[top]), max(2.0 * half_width / FWHM, 0.5) * step
    for _ in range(_FITS):
        near = (channels > position - _BELOW * width) & (channels < position + _ABOVE * width)
        if near.sum() < _FEWEST_BINS:  # it is of a few bins: their mean
            width = max(width, step)
            near = np.abs(channels - position) <= _BELOW * width
            mean = float(np.average(channels[near], weights=counts[near]))
            spread = math.sqrt(np.average((channels[near] - mean) ** 2, weights=counts[near]))
            sigma = max(spread, 0.29 * width) / math.sqrt(counts[near].sum())
            return Pedestal(mean, sigma, max(spread, 1e-3))
        start = np.array([counts[near].sum(), position, width, 0.0, 0.0])
        peak, _, _ = fit_band(channels[near], counts[near], GAUSSIAN, start)
        if not peak.counts_at(np.array(peak.centroid)) > _OVER * peak.background:
            return None
        position, width, sigma = peak.centroid, peak.width, peak.centroid_sigma
    # a continuum goes on below a peak of its own
    below = counts[channels < position - _CLEAR * width].sum()
    if below > _LITTLE * counts[np.abs(channels - position) < _CLEAR * width].sum():
        return None
    return Pedestal(position, sigma, width)


def chances(mean: float, lam: float, numbers: int) -> Array:
    """(numbers,) probabilities of 0, 1, ... photoelectrons; Poisson's where lam is 0.

    Below 0, which a fit may pass through, they end where mean + n lam would be negative.
    """
    n = np.arange(numbers)
    rate = np.maximum(mean + n * lam, 0.0)
    with np.errstate(divide="ignore"):
        return np.exp(math.log(mean) + xlogy(n - 1, rate) - rate - gammaln(n + 1.0))


def _cumulative(edges: Array, values: Sequence[float], numbers: int) -> Array:
    """Expected counts below the edges of bins; values of the parameters as `_PARAMETERS` names."""
    events, mean, pedestal, noise, gain, spread, lam, after, decay = values
    n = np.arange(numbers)
    widths = np.sqrt(noise**2 + n * spread**2)
    away = (edges[:, None] - pedestal - n * gain) / widths
    below = ndtr(away)
    if after > 0.0:
        faster = widths / decay
        late = np.exp(0.5 * faster**2 - away * faster + log_ndtr(away - faster))
        below = below - (1.0 - (1.0 - after) ** n) * late
    return np.asarray(events * (below @ chances(mean, lam, numbers)), float)


def fit_single_photoelectrons(
    channels: Array, counts: Array, *, crosstalk: bool | None = None
) -> SinglePhotoelectrons:
    """Fit pedestal, gain, spread and mean number, by the likelihood that this module names.

    With `crosstalk` its probability is fitted too; None: where single photoelectrons are told
    apart, as in silicon they are. Afterpulses are, where the counts demand them. Channels ascend by
    one step, (bins,) float64.

    Raises InputError if no pedestal is in sight, or nothing above it.
    """
    if (lowest := lowest_peak(counts)) is None:
        raise InputError(
            "no pedestal stands out at the low end, and without it no single photoelectrons",
            "let some events have no light, or give excess_noise_factor and the pedestal of a run "
            "in the dark: then mean and variance of one flash tell the gain, less surely",
        )
    step = channels[1] - channels[0]
    top, half_width = lowest
    noise = max(2.0 * half_width / FWHM, 0.5)  # in channels of the spectrum
    filled = np.flatnonzero(counts)
    first, last = filled[0], filled[-1] + 1
    join = max(int(_BIN * noise), 1)
    last += -(last - first) % join
    seen = np.concatenate([counts, np.zeros(max(last - len(counts), 0))])[first:last]
    seen = seen.reshape(-1, join).sum(axis=1)
    edges = channels[0] + step * (np.arange(first, last + 1, join) - 0.5)
    start, numbers = _start(channels, counts, float(channels[top]), noise * step)
    freed = _CROSSTALK if crosstalk else ()
    fitted = _descend(edges, seen, _starts(start, freed), numbers, freed)
    if crosstalk is None and fitted.values["spread"] < _RESOLVED * fitted.values["gain"]:
        freed = _CROSSTALK
        fitted = _descend(edges, seen, _starts(start, freed), numbers, freed)
    result = _result(fitted, edges, seen, numbers)
    if freed and (result.p_value or 1.0) < LEAST_P:
        begin = {**fitted.values.to_dict(), "after": 0.03}
        further = _descend(edges, seen, [begin], numbers, _AFTERPULSES)
        if further.valid and further.fval < fitted.fval - _TOLD:
            result = _result(further, edges, seen, numbers)
    return result


def _starts(start: dict[str, float], freed: Sequence[str]) -> list[dict[str, float]]:
    """Where fits begin, with these parameters of silicon."""
    starts = []
    for spread, lam in _STARTS if freed else _STARTS[::2]:
        gain = start["gain"] * (1.0 - lam)
        further = {"spread": spread * gain, "lam": lam, "after": 0.0, "decay": 0.5 * gain}
        starts.append({**start, "gain": gain, **further})
    return starts


def _start(
    channels: Array, counts: Array, pedestal: float, noise: float
) -> tuple[dict[str, float], int]:
    """Where the fit begins, and how many numbers of photoelectrons count."""
    events = float(counts.sum())
    half = (channels > pedestal - _BELOW * noise) & (channels < pedestal)
    at_top = float(counts[channels == pedestal].sum())
    dark = min((2.0 * counts[half].sum() + at_top) / events, 0.999)
    mean = -math.log(max(dark, 1e-4))
    gain = (float(np.average(channels, weights=counts)) - pedestal) / mean
    if not gain > noise or dark > 0.98:
        mend = "let a twentieth of the events have light, better a half"
        raise InputError("next to nothing lies above the pedestal", mend)
    numbers = math.ceil((channels[counts > 0].max() - pedestal) / gain) + _BEYOND
    start = {"events": events, "mean": mean, "pedestal": pedestal, "noise": noise, "gain": gain}
    return start, min(numbers, _MOST_NUMBERS)


def _descend(  # type: ignore[no-untyped-def]
    edges: Array,
    counts: Array,
    starts: Sequence[dict[str, float]],
    numbers: int,
    freed: Sequence[str],
):
    """MINUIT at the best of the minima that several starts lead to."""
    from iminuit import Minuit
    from iminuit.cost import ExtendedBinnedNLL

    def model(x: Array, *values: float) -> Array:
        return _cumulative(x, values, numbers)

    cost = ExtendedBinnedNLL(counts, edges, model, name=_PARAMETERS)
    fits = []
    for start in starts:
        fit = Minuit(cost, **start)
        fit.limits["events", "noise", "gain"] = (1e-6, None)
        fit.limits["spread"] = (0.0, None)
        fit.limits["mean"] = (1e-3, _MOST_MEAN)
        fit.limits["lam"] = (-_LARGEST_LAM, _LARGEST_LAM)
        fit.limits["after"] = (0.0, _LARGEST_LAM)
        fit.limits["decay"] = (0.05 * start["gain"], 3.0 * start["gain"])
        for name in _AFTERPULSES:
            fit.fixed[name] = name not in freed
        fit.strategy = 0
        fits.append(fit)
    fits.sort(key=lambda fit: cost(*fit.values))
    for tried, fit in enumerate(fits, start=1):
        fit.migrad()
        # two agree, or it is no other's neighbour
        if tried > 1 and fit.valid and fit.fmin.reduced_chi2 < _FAIR:
            break
    best = min(fits[:tried], key=lambda fit: fit.fval)
    best.strategy = 1
    best.migrad()
    best.hesse()
    return best


def _result(fit, edges: Array, counts: Array, numbers: int) -> SinglePhotoelectrons:  # type: ignore[no-untyped-def]
    """What a fit says."""
    value, covariance = dict(zip(fit.parameters, fit.values, strict=True)), fit.covariance
    gain, lam, spread = value["gain"], value["lam"], value["spread"]
    chi2, groups = _judged(counts, np.diff(_cumulative(edges, tuple(fit.values), numbers)))
    ndf = groups - fit.nfit
    p_value = float(chdtrc(ndf, chi2)) if ndf > 0 else None
    bad = p_value is not None and p_value < LEAST_P
    worse = math.sqrt(chi2 / ndf) if bad else 1.0
    error = {name: worse * of for name, of in zip(fit.parameters, fit.errors, strict=True)}
    relative = (spread / gain) ** 2
    # d F / d gain, spread, lam
    kept, names = 1.0 - lam, ["gain", "spread", "lam"]
    slopes = np.array([-2.0 * relative / gain, 2.0 * spread / gain**2, kept**-3 - relative / kept])
    slopes = slopes * kept
    part = np.zeros((3, 3)) if covariance is None else np.asarray(covariance[names])
    warnings = []
    if not fit.valid or covariance is None:
        warnings.append("the fit of single photoelectrons did not settle: look at its picture")
    if bad and p_value is not None:
        warnings.append(
            f"the fit of single photoelectrons is bad (chi2 = {chi2:.1f}, ndf = {ndf}, "
            f"{p_equals(p_value)}): its errors are {worse:.2g} times those of the counts; is the "
            "pedestal one Gaussian, and no threshold in the spectrum?"
        )
    crosstalk = None if fit.fixed["lam"] else -math.expm1(-lam)
    told = not fit.fixed["after"]
    return SinglePhotoelectrons(
        gain,
        error["gain"],
        pedestal=Pedestal(value["pedestal"], error["pedestal"], value["noise"]),
        mean=value["mean"],
        mean_sigma=error["mean"],
        crosstalk=crosstalk,
        crosstalk_sigma=None if crosstalk is None else error["lam"] * math.exp(-lam),
        afterpulsing=value["after"] if told else None,
        afterpulsing_sigma=error["after"] if told else None,
        spread=spread,
        excess_noise_factor=1.0 / kept + relative * kept,
        excess_noise_factor_sigma=worse * math.sqrt(max(slopes @ part @ slopes, 0.0)),
        events=value["events"],
        parameters=tuple(fit.values),
        chi2=chi2,
        ndf=ndf,
        p_value=p_value,
        warnings=tuple(warnings),
    )


def _judged(counts: Array, expected: Array) -> tuple[float, int]:
    """The likelihood ratio of groups of bins with enough counts, and how many there are."""
    # bins belong to the group that the counts below their middles say
    group = ((np.cumsum(expected) - 0.5 * expected) / _FEWEST_EXPECTED).astype(int)
    group = np.unique(group, return_inverse=True)[1]
    n, mu = np.bincount(group, counts), np.maximum(np.bincount(group, expected), 1e-12)
    return float(2.0 * np.sum(mu - n + xlogy(n, n / mu))), len(n)


def gain_by_excess_noise(
    channels: Array, counts: Array, pedestal: Pedestal, factor: float, factor_sigma: float
) -> SinglePhotoelectrons:
    """The gain by mean and variance of flashes of equal light, where the excess noise is known.

    It takes all events for such flashes: what the light itself varies by is in the gain, too.

    Raises InputError if they vary by no more than the pedestal does.
    """
    events = float(counts.sum())
    average = partial(np.average, weights=counts)
    charge = float(average(channels)) - pedestal.position
    deviations = channels - pedestal.position - charge
    variance = float(average(deviations**2))
    noise = (pedestal.width or 0.0) ** 2
    if not charge > 0 or not variance > noise:
        problem = "the flashes are no larger or no wider than the pedestal"
        raise InputError(problem, "give another pedestal, or flashes of more light")
    charge_sigma = math.hypot(math.sqrt(variance / events), pedestal.sigma)
    variance_sigma = math.sqrt(max(float(average(deviations**4)) - variance**2, 0.0) / events)
    gain = (variance - noise) / (charge * factor)
    parts = variance_sigma / (variance - noise), charge_sigma / charge, factor_sigma / factor
    relative = math.hypot(*parts)
    return SinglePhotoelectrons(
        gain,
        gain * relative,
        pedestal=pedestal,
        mean=charge / gain,
        mean_sigma=charge / gain * math.hypot(relative, charge_sigma / charge),
        excess_noise_factor=factor,
        excess_noise_factor_sigma=factor_sigma,
        events=events,
        warnings=(
            "the gain comes of mean and variance of one flash, which is less sure than single "
            "photoelectrons: light that varies from flash to flash makes it too large",
        ),
    )
