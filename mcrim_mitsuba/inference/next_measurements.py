"""What to measure next: by how much a further reading would lower the light yield's error.

Every explanation of the readings predicts a further one, with the parameters that it allows. Drawn
from their probabilities these are points; a reading that is made at one of them changes the weights
of all others by Bayes' theorem, and what is left of the light yield's spread and of the doubt which
explanation it is is what the reading buys (preposterior analysis: H. Raiffa and R. Schlaifer,
Applied Statistical Decision Theory, Harvard 1961; K. Chaloner and I. Verdinelli, Statistical
Science 10 (1995) 273). Something without a name predicts by its Gaussian process, given the
readings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, TRANSMITTANCE
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import Value, unit_of
from mcrim_mitsuba.core.rounding import short_text
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.rehearsal import QUANTILES
from mcrim_mitsuba.inference.rival_causes import DiscrepancyModel, discrepancy_at
from mcrim_mitsuba.inference.settings import ADVICE
from mcrim_mitsuba.inference.simulations import MeasurementProposals
from mcrim_mitsuba.inference.weighing import Hypothesis
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.spectrophotometer import ACCEPTANCE, BEAM_AXIS, GAP_INDEX


@dataclass(frozen=True)
class NextMeasurement:
    """A further reading, or two together, and what it would tell."""

    #: Scene parameters; of a transmittance those of its beam, and ``kind``.
    parameters: dict[str, Value]
    #: Pairs of leading explanations that it would tell apart.
    separates: tuple[tuple[str, str], ...]
    #: Mean over all pairs of what the wrong one's chi2 would rise above the right one's.
    expected_delta_chi2: float
    #: Those of a second reading, where two are proposed together.
    also: dict[str, Value] | None
    #: Relative standard error that the averaged light yield would most likely have; None where
    #: nothing turns a fitted scale into a light yield.
    light_yield_sigma: float | None
    #: Expected probability of the explanation that would then be the likeliest.
    probability: float
    #: To mount what is proposed.
    hours: float
    #: The reading, or the two, in words: `configuration_words`.
    words: str = ""


# Parameters of usual benches: what is said of a value, {} being it.
_SAID = {
    "aperture_radius_mm": "mask of {} mm radius",
    "gap_mm": "gap of {} mm",
    "crystal_height_mm": "crystal {} mm high",
    "crystal_width_mm": "crystal {} mm wide",
    BEAM_AXIS: "beam along {}",
    ACCEPTANCE: "within {} degrees",
}
# In a scene's comment, what a value stands for: ``1.00 for air, 1.46 for the optical gel``.
_STANDS_FOR = re.compile(r"([\d.]+) for (?:the |an? )?([^,;:]+)")


def configuration_words(parameters: Mapping[str, Value], comments: Mapping[str, str]) -> str:
    """A configuration in words: ``optical gel (n = 1.46), mask of 4 mm radius``.

    Its parameters are the scene's or the beam's, perhaps with ``kind``; `comments` on the scene's
    say what values stand for, and what else parameters are called.
    """
    said = [TRANSMITTANCE] if parameters.get(KIND, LIGHT) == TRANSMITTANCE else []
    for name, value in parameters.items():
        text = short_text(value)
        called = {float(n): what.strip() for n, what in _STANDS_FOR.findall(comments.get(name, ""))}
        if name == KIND:
            continue
        if name == GAP_INDEX:
            usual = "liquid" if is_filled(float(value)) else "air"
            said.append(f"{called.get(float(value), usual)} (n = {text})")
        elif name in _SAID:
            said.append(_SAID[name].format(text))
        elif value in called:
            said.append(f"{called[float(value)]} ({name} = {text})")
        else:
            meaning = re.split("[,:]", comments.get(name, ""))[0].strip()
            unit = unit_of(name) if meaning else None
            said.append(" ".join(filter(None, (meaning or f"{name} =", text, unit))))
    return ", ".join(said)


def next_measurements(
    judgement: Judgement, proposals: MeasurementProposals
) -> tuple[NextMeasurement, ...]:
    """Configurations by what a reading there would buy per hour.

    That is half of the part by which the light yield's error would fall, and half of that by which
    the doubt which explanation is right would, discounted by how surely it does.

    Returns
    -------
    tuple of NextMeasurement
        The best first, at most ten, with the best two together among them.
    """
    if not proposals.configurations:
        return ()
    known = judgement.baseline.statistic.model.campaign.light_yield
    efficiency = known.detector_efficiency_sigma / known.detector_efficiency if known else 0.0
    cloud = _cloud(judgement, proposals)
    # what leads only beside wrong readings predicts with them
    leading = [effects for effects in judgement.leading if " + ".join(effects) in cloud.names]
    outcomes = cloud.outcomes()
    before, _, sure = cloud.left(np.zeros((1, len(cloud.weights))), efficiency)

    def bought_by(places: tuple[int, ...]) -> _Bought:
        told = np.sum([cloud.log_likelihood(outcomes, i) for i in places], axis=0)
        error, kept, probability = cloud.left(told, efficiency)
        fallen = 1.0 - error / before if cloud.yields is not None else 0.0
        doubt = (probability - sure) / max(1.0 - sure, 1e-9)
        worth = 0.5 * (fallen + doubt) / proposals.hours(*places)
        has_yield = known is not None and cloud.yields is not None
        return _Bought(worth * kept**ADVICE.discount, error if has_yield else None, probability)

    single: list[tuple[int, ...]] = [(i,) for i in range(len(proposals.configurations))]
    bought = {places: bought_by(places) for places in single}
    best = sorted(bought, key=lambda places: -bought[places].worth)
    best_single = [place for (place,) in best[: ADVICE.together]]
    pairs = {places: bought_by(places) for places in combinations(best_single, 2)}
    if pairs:
        best_pair = max(pairs, key=lambda places: pairs[places].worth)
        bought[best_pair] = pairs[best_pair]
    order = sorted(bought, key=lambda places: -bought[places].worth)[: ADVICE.most]
    rises, rivals = cloud.rises(leading[: ADVICE.most_rivals])
    names = [" + ".join(effects) for effects in leading]
    rivals_named = [(names[a], names[b]) for a, b in rivals]
    return tuple(
        _proposed(places, bought[places], proposals, rises, rivals_named) for places in order
    )


class _Bought(NamedTuple):
    """What readings in one or two configurations would buy."""

    #: Half the sum of the parts by which error and doubt fall, per hour, discounted.
    worth: float
    #: Relative error of the light yield that most outcomes leave; None where no yield is known.
    light_yield_sigma: float | None
    #: Mean probability of the explanation that would then be the likeliest.
    probability: float


def _proposed(
    places: tuple[int, ...],
    bought: _Bought,
    proposals: MeasurementProposals,
    rises: Array,
    rivals: Sequence[tuple[str, str]],
) -> NextMeasurement:
    """Readings at the configurations of these places, as a proposal.

    `rises`, (rivals, configurations), is the difference in chi2 by which a reading would separate
    two explanations that are rivals.
    """
    risen = rises[:, list(places)].sum(axis=1)
    first, *second = (dict(proposals.configurations[i]) for i in places)
    return NextMeasurement(
        parameters=first,
        separates=tuple(
            pair for pair, rise in zip(rivals, risen, strict=True) if rise >= ADVICE.separated
        ),
        expected_delta_chi2=float(risen.mean()) if len(risen) else 0.0,
        also=second[0] if second else None,
        light_yield_sigma=bought.light_yield_sigma,
        probability=bought.probability,
        hours=proposals.hours(*places),
        words="; and ".join(
            configuration_words(parameters, proposals.comments) for parameters in (first, *second)
        ),
    )


@dataclass(frozen=True)
class _Cloud:
    """Points of all explanations that are likely, and what they predict."""

    #: (points,) of which explanation each is, by `names`; probabilities, which sum to 1.
    of: Array
    names: tuple[str, ...]
    weights: Array
    #: (points, m) predicted further readings, and their (m,) or one relative standard error.
    signals: Array
    relative_sigma: Array
    #: (points,) light yields up to a factor, with what no reading tells, in rising order of these;
    #: None where the scale is not fitted.
    yields: Array | None

    def outcomes(self) -> Array:
        """(outcomes, m) further readings, made at some of the points: every other one.

        The others answer them (`left`): a point that made a reading knows it too well.
        """
        rng = np.random.default_rng(0)
        at = (np.arange(ADVICE.outcomes) + 0.5) / ADVICE.outcomes
        cumulated = np.cumsum(self.weights[::2])
        true = np.minimum(np.searchsorted(cumulated, at * cumulated[-1]), len(cumulated) - 1)
        noise = rng.standard_normal((ADVICE.outcomes, self.signals.shape[1]))
        return self.signals[2 * true] * (1.0 + self.relative_sigma * noise)

    def log_likelihood(self, readings: Array, place: int) -> Array:
        """(outcomes, points) of the readings of one configuration, by all points."""
        predicted = self.signals[:, place]
        away = (readings[:, place, None] - predicted) / (self.relative_sigma[place] * predicted)
        return np.asarray(-0.5 * away**2 - np.log(predicted), float)

    def left(self, log_likelihood: Array, efficiency: float) -> tuple[float, float, float]:
        """Relative error of the light yield after outcomes, (outcomes, points) of logarithms.

        The one that most outcomes are near, their part, and the mean probability of the likeliest
        explanation.
        """
        answering = np.where(np.arange(len(self.weights)) % 2 == 1, self.weights, 0.0)
        weights = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True)) * answering
        weights /= weights.sum(axis=1, keepdims=True)
        by_name = np.stack([weights[:, self.of == k].sum(axis=1) for k in range(len(self.names))])
        probability = float(by_name.max(axis=0).mean())
        if self.yields is None:
            return math.nan, math.nan, probability
        cumulated = np.cumsum(weights, axis=1)
        _, low, median, high, _ = (
            self.yields[np.minimum((cumulated < part).sum(axis=1), len(self.yields) - 1)]
            for part in QUANTILES
        )
        error = np.hypot(0.5 * (high - low) / median, efficiency)
        return *_most_kept(error), probability

    def rises(self, leading: Sequence[tuple[str, ...]]) -> tuple[Array, list[tuple[int, int]]]:
        """(pairs, m): with one of two true, what a reading raises the chi2 of the other by."""
        pairs = list(combinations(range(len(leading)), 2))
        means, variances = [], []
        for effects in leading:
            own = self.of == self.names.index(" + ".join(effects))
            # by quantiles: one point far away would make up most of a variance
            low, middle, high = np.quantile(self.signals[own], ndtr((-1.0, 0.0, 1.0)), axis=0)
            means.append(middle)
            variances.append((0.5 * (high - low)) ** 2)
        rises = [
            (means[a] - means[b]) ** 2
            / (
                (self.relative_sigma * 0.5 * (means[a] + means[b])) ** 2
                + np.maximum(variances[a], variances[b])
            )
            for a, b in pairs
        ]
        return np.array(rises).reshape(len(pairs), self.signals.shape[1]), pairs


def _most_kept(errors: Array) -> tuple[float, float]:
    """An error that most of (outcomes,) errors are near, and the part of them that are.

    The median of as many as lie within `ADVICE.kept` of one value: of outcomes that go either way
    the median of all may lie where hardly any are.
    """
    errors = np.sort(np.maximum(errors, 1e-12))
    # behind the last error that is alike, for ranges that begin with each one
    ends = np.searchsorted(errors, errors * (1.0 + ADVICE.kept) / (1.0 - ADVICE.kept), side="right")
    first = int(np.argmax(ends - np.arange(len(errors))))
    promised = float(np.median(errors[first : ends[first]]))
    return promised, float(np.mean(np.abs(errors / promised - 1.0) < ADVICE.kept))


def _cloud(judgement: Judgement, proposals: MeasurementProposals) -> _Cloud:
    """Points of the leading explanations and of all others that are likely."""
    likely = _likely(judgement)
    count = len(proposals.configurations)
    group_of = judgement.group_of
    names = tuple(dict.fromkeys(group_of[each.name] for each, _ in likely))
    discrepancy = DiscrepancyModel(judgement.explanations, judgement.null.frame)
    of, weights, signals, scales = [], [], [], []
    variance = np.zeros(count)
    for each, share in likely:
        assert each.evidence is not None  # those alone predict
        effects, points = tuple(sorted(each.effects)), each.evidence.draws
        predicted = proposals.predict(effects, points)
        variance += share * proposals.noise(effects, np.median(points, axis=0)) ** 2
        if each.amplitude:  # something without a name
            predicted = predicted * np.exp(
                discrepancy_at(
                    judgement.explanations.fit(effects),
                    discrepancy,
                    each.amplitude,
                    points,
                    proposals.configurations,
                )
            )
        of.append(np.full(len(points), names.index(group_of[each.name])))
        weights.append(np.full(len(points), share / len(points)))
        signals.append(np.maximum(predicted, 1e-300))
        free = tuple(each.evidence.mean)
        scales.append(points[:, free.index(SCALE)] if SCALE in free else np.zeros(len(points)))
    relative = np.broadcast_to(np.asarray(proposals.relative_sigma, float), (count,))
    # what the simulation does not tell apart, a reading will not tell either
    relative = np.sqrt(relative**2 + variance / sum(share for _, share in likely))
    weight, scale = np.concatenate(weights), np.concatenate(scales)
    order = np.argsort(scale, kind="stable")
    return _Cloud(
        of=np.concatenate(of)[order],
        names=names,
        weights=weight[order] / weight.sum(),
        signals=np.concatenate(signals)[order],
        relative_sigma=relative,
        yields=scale[order] if scale.all() else None,
    )


def _likely(judgement: Judgement) -> list[tuple[Hypothesis, float]]:
    """Hypotheses that predict, with their probabilities, the likeliest first.

    The first few of those that lead, and all others that are likely, as long as their sets of
    effects, each of which takes a simulation, are not too many.
    """
    rivals = {tuple(sorted(effects)) for effects in judgement.leading[: ADVICE.most_rivals]}
    sets, likely = {(), *rivals}, []
    weighing = judgement.weighing
    for each, share in zip(weighing.hypotheses, weighing.shares.tolist(), strict=True):
        effects = tuple(sorted(each.effects))
        if each.evidence is None:
            continue
        leads = not each.besides and effects in rivals
        affordable = effects in sets or len(sets) <= ADVICE.most_sets
        if leads or (share >= ADVICE.likely and affordable):
            sets.add(effects)
            likely.append((each, share))
    return likely
