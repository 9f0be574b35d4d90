"""Causes that are no effect of the catalogue: wrong readings, and something without a name.

If what a bench lacks is in no catalogue, the best of many wrong effects may fit all the same, with
an error that is much too small. So these causes are rivals of all effects, weighed by evidence as
they are.

Wrong readings: one, two or three readings are wrong, or two rows were exchanged. A wrong reading
has a further error of its own. To first order its evidence is a closed form, so that all sets of
three are looked at; the best few are fitted.

Something without a name: a smooth function g of the configuration multiplies the predictions by
exp(g). It is a Gaussian process (C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for
Machine Learning, MIT Press 2006; for what models lack: M. C. Kennedy and A. O'Hagan, J. R. Statist.
Soc. B 63 (2001) 425) over index, mask, height, gap and whatever else differs between readings; its
amplitude is learned from the misfit. No reading tells what g has in common to all: that much the
light yield may be off, in the proportion that trials with effects left out of the catalogue show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice

import numpy as np

from mcrim_mitsuba.campaign.measurements import KIND, LIGHT
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.inference.compare import (
    BAD_READING,
    SWAPPED_ROWS,
    Suspect,
    likely_swaps,
    suspected,
)
from mcrim_mitsuba.inference.drivers import Minimum, settle
from mcrim_mitsuba.inference.evidence import Hypothesis, evidence_of
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.settings import RIVALS
from mcrim_mitsuba.inference.statistic import Statistic

#: What something without a name is called beside effects.
UNKNOWN = "unknown"


def unknown_cause(
    explanations: Explanations, singles: Sequence[tuple[str, ...]]
) -> list[Hypothesis]:
    """Something without a name, alone and besides each of the best effects.

    `singles` are fitted effects, the likeliest first.
    """
    fits = {effects: explanations.fit(effects) for effects in singles}
    lowest = min((fit.deviance for fit in fits.values()), default=0.0)
    near = [effects for effects, fit in fits.items() if fit.deviance < lowest + RIVALS.beside]
    correlation = _correlation(explanations.baseline.statistic)
    hypotheses = []
    # twice the size is half as likely: prior 1 / (amplitude norm)
    norm = sum(1.0 / amplitude for amplitude in RIVALS.amplitudes)
    for effects in [(), *near[: RIVALS.most_beside]]:
        best, priors = -math.inf, explanations.priors(effects)
        of_effects = explanations.log_odds(effects)
        odds = RIVALS.beside_odds if effects else RIVALS.unknown_odds
        for amplitude in RIVALS.amplitudes:
            own = explanations.statistic(effects).with_unexplained(amplitude**2 * correlation)
            fit = settle(own, explanations.fit(effects).theta)
            evidence = evidence_of(fit, priors, hopeless=True)
            log_odds = of_effects + math.log(odds / (amplitude * norm))
            common = RIVALS.common_to_all * amplitude
            hypotheses.append(Hypothesis(evidence, log_odds, effects, UNKNOWN, common, amplitude))
            best = max(best, evidence.log)
            if evidence.log < best - RIVALS.fallen:
                break
    return hypotheses


def unknown_cause_at(
    explanations: Explanations,
    hypothesis: Hypothesis,
    thetas: Array,
    configurations: Sequence[Mapping[str, Value]],
) -> Array:
    """(points, configurations) what has no name, of log(reading), drawn given the readings.

    The hypothesis is one of `unknown_cause`; `thetas` are (points, free) parameters of the model
    with its effects. Configurations are given by what they differ from the scene; a transmittance
    has a ``kind``, and feels nothing of an unknown cause.
    """
    fit = explanations.fit(hypothesis.effects)
    statistic = fit.statistic
    used, count = len(statistic.signal), len(thetas)
    covariance = hypothesis.amplitude**2 * _correlation(statistic, configurations)
    signal = fit.signal[statistic.used]
    errors = fit.weights.covariance / np.outer(signal, signal)
    predicted = statistic.model.predict_many(thetas)[:, statistic.used]
    gain = np.linalg.solve(covariance[:used, :used] + errors, covariance[:used, used:])
    mean = (statistic.signal / predicted - 1.0) @ gain
    left = covariance[used:, used:] - covariance[used:, :used] @ gain
    values, vectors = np.linalg.eigh(left)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.random.default_rng(0).standard_normal((count, len(configurations)))
    return np.asarray(mean + drawn @ spread.T, float)


def _correlation(statistic: Statistic, further: Sequence[Mapping[str, Value]] = ()) -> Array:
    """Correlations of what something without a name does to readings: exp(-d^2 / 2 length^2).

    (used + further,) squared; `further` are configurations by what they differ from the scene. d is
    the distance of two configurations: of every parameter that differs between readings in parts of
    their range, of lengths in that of their logarithms. To a beam it does nothing.
    """
    readings = [r for r in statistic.model.readings if r.use]
    values = statistic.model.campaign.values
    rows = [
        *((r.parameters, r.of_beam) for r in readings),
        *((each, each.get(KIND, LIGHT) != LIGHT) for each in further),
    ]
    light = [i for i, (_, of_beam) in enumerate(rows) if not of_beam]
    read = sum(i < len(readings) for i in light)
    squared_distance = np.zeros((len(light), len(light)))
    names = {n for i in light[:read] for n in rows[i][0]}
    for name in sorted(names):
        cells = [rows[i][0].get(name, values.get(name)) for i in light]
        places = _places(name, cells, read)
        squared_distance += np.subtract.outer(places, places) ** 2
    correlation = np.zeros((len(rows), len(rows)))
    correlation[np.ix_(light, light)] = np.exp(-0.5 * squared_distance / RIVALS.length**2)
    return correlation


def _places(name: str, cells: Sequence[Value | None], read: int) -> Array:
    """(cells,) places of values in their range: 0 to 1 for the first ones, those of readings."""
    numbers = [float(c) for c in cells if isinstance(c, int | float)]
    if len(numbers) == len(cells):
        at = np.array(numbers)
        if name.endswith("_mm") and at.min() > 0.0:
            at = np.log(at)
    else:  # names
        levels = sorted({str(cell) for cell in cells})
        at = np.array([float(levels.index(str(cell))) for cell in cells])
    low, span = at[:read].min(), float(np.ptp(at[:read]))
    return (at - low) / span if span > 0.0 else np.zeros(len(at))


def bad_readings(explanations: Explanations) -> list[tuple[Hypothesis, Suspect]]:
    """Wrong readings and exchanged rows that explain the readings, the likeliest first.

    The campaign is as it is otherwise.
    """
    statistic = explanations.baseline.statistic
    suspected_sets = [_bad(explanations, places) for places in _worst(explanations)]
    log_odds = math.log(RIVALS.swapped_odds / max(math.comb(len(statistic.signal), 2), 1))
    for places in likely_swaps(explanations.baseline, RIVALS.fitted):
        order = np.arange(len(statistic.signal), dtype=np.int64)
        order[list(places)] = places[::-1]
        fit = settle(statistic.exchanged(order), explanations.baseline.theta)
        suspected_sets.append(_named(explanations, SWAPPED_ROWS, places, fit, log_odds))
    return sorted(suspected_sets, key=lambda each: -each[0].log_weight)


def _named(
    explanations: Explanations, kind: str, places: Sequence[int], fit: Minimum, log_odds: float
) -> tuple[Hypothesis, Suspect]:
    """What a fit without trust in some readings says, and of which it is."""
    evidence = evidence_of(fit, explanations.priors(()), hopeless=True)
    baseline, pull = explanations.baseline, None
    if kind == BAD_READING and len(places) == 1:
        # to first order the square of the pull is the gain
        away = float(baseline.weighted_residuals[places[0]])
        pull = math.copysign(math.sqrt(max(baseline.chi2 - fit.chi2, 0.0)), away)
    suspect = suspected(baseline, kind, places, fit.chi2, pull)
    return Hypothesis(evidence, log_odds, besides=suspect.words, common=RIVALS.bad_common), suspect


def _bad(explanations: Explanations, places: tuple[int, ...]) -> tuple[Hypothesis, Suspect]:
    """Wrong readings, averaged over how wrong they are."""
    statistic, made = explanations.baseline.statistic, []
    log_odds = len(places) * math.log(RIVALS.bad_odds / len(statistic.signal))
    for size in RIVALS.bad_sizes:
        further = np.zeros(len(statistic.signal))
        further[list(places)] = size**2
        fit = settle(statistic.with_unexplained(np.diag(further)), explanations.baseline.theta)
        made.append(_named(explanations, BAD_READING, places, fit, log_odds))
    best, suspect = max(made, key=lambda each: each[0].evidence.log)
    # what the other sizes say of the parameters is much the same
    shares = [math.exp(each.evidence.log - best.evidence.log) for each, _ in made]
    return replace(best, log_odds=log_odds + math.log(sum(shares) / len(made))), suspect


def _worst(explanations: Explanations) -> list[tuple[int, ...]]:
    """Sets of readings that, were they wrong, would explain most, a few of each size.

    With a further variance t of the readings B the logarithm of the evidence rises to first order
    by (v^T (1/t + P_B)^-1 v - log det(1 + t P_B)) / 2, P the inverse covariance of readings whose
    parameters are unknown, and v = (C^-1 r)_B of the residuals r (`Minimum.weighted_residuals`).
    """
    baseline = explanations.baseline
    precision, weighted = baseline.precision, baseline.weighted_residuals
    signal = np.abs(baseline.signal[baseline.statistic.used])
    found = []
    for count in range(1, min(RIVALS.most_bad, max(baseline.ndf - 1, 0)) + 1):
        best: list[tuple[float, tuple[int, ...]]] = []
        every = combinations(range(len(signal)), count)
        # of hundreds of readings there are millions
        while some := list(islice(every, RIVALS.sets_at_once)):
            sets = np.array(some)
            within = precision[sets[:, :, None], sets[:, None, :]]
            pulled, gains = weighted[sets], np.full(len(sets), -np.inf)
            for size in RIVALS.bad_sizes:
                t = (size * signal[sets]) ** 2
                inner = within + np.eye(count) / t[:, None, :]
                follow = np.linalg.solve(inner, pulled[..., None])[..., 0]
                log_det = np.linalg.slogdet(inner)[1] + np.log(t).sum(axis=1)
                gains = np.maximum(gains, 0.5 * ((pulled * follow).sum(axis=1) - log_det))
            highest = np.argsort(-gains, kind="stable")[: RIVALS.fitted]
            best += [(gains[i], some[i]) for i in highest]
            best = sorted(best, key=lambda each: -each[0])[: RIVALS.fitted]
        found += [places for _, places in best]
    return found
