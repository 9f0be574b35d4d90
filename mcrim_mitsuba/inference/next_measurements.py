"""What to measure next: by how much a further reading would lower the light yield's error.

Beside readings in new configurations, those that may be wrong are made once more, numbers with a
prior are measured again, and somebody looks for what may be missing: each is a column of one table.
Every explanation of the readings predicts it, with the parameters that it allows. Drawn from their
probabilities these are points; what is then measured at one of them changes the weights of all
others by Bayes' theorem, and what is left of the light yield's spread and of the doubt which
explanation it is is what the measurement buys (preposterior analysis: H. Raiffa and R. Schlaifer,
Applied Statistical Decision Theory, Harvard 1961; K. Chaloner and I. Verdinelli, Statistical
Science 10 (1995) 273). Something without a name predicts by its Gaussian process, given the
readings.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, TRANSMITTANCE
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import Value, unit_of
from mcrim_mitsuba.core.rounding import number, short_text
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.rehearsal import QUANTILES
from mcrim_mitsuba.inference.rival_causes import DiscrepancyModel, discrepancy_at
from mcrim_mitsuba.inference.settings import ADVICE
from mcrim_mitsuba.inference.simulations import MeasurementProposals
from mcrim_mitsuba.inference.weighing import Hypothesis
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.spectrophotometer import ACCEPTANCE, BEAM_AXIS, GAP_INDEX

#: Kinds of what is proposed: a reading in a new configuration, a reading made once more, a number
#: with a prior that is measured again, a look at the bench.
READING, REPEAT, NUMBER, LOOK = "reading", "repeat", "number", "look"


@dataclass(frozen=True)
class NextMeasurement:
    """Something to be measured, or two things together, and what it would tell."""

    #: `READING`, `REPEAT`, `NUMBER` or `LOOK`; of two together both, joined by ``+``.
    kind: str
    #: Scene parameters of a reading; of a transmittance those of its beam, and ``kind``.
    parameters: dict[str, Value]
    #: Pairs of leading explanations that it would tell apart.
    separates: tuple[tuple[str, str], ...]
    #: Mean over all pairs of what the wrong one's chi2 would rise above the right one's.
    expected_delta_chi2: float
    #: Those of the second, where two are proposed together.
    also: dict[str, Value] | None
    #: Relative standard error that the averaged light yield would most likely have; None where
    #: nothing turns a fitted scale into a light yield.
    light_yield_sigma: float | None
    #: Part of the outcomes that leave about this error, and the median error of all others; None
    #: where there are no others.
    light_yield_kept: float | None
    light_yield_sigma_otherwise: float | None
    #: Expected probability of the explanation that would then be the likeliest.
    probability: float
    #: To mount, measure or look.
    hours: float
    #: What is proposed, in words.
    words: str

    @property
    def is_of_readings(self) -> bool:
        """Whether nothing but readings in new configurations is proposed."""
        return set(self.kind.split(" + ")) == {READING}


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
    phrases = [TRANSMITTANCE] if parameters.get(KIND, LIGHT) == TRANSMITTANCE else []
    for name, value in parameters.items():
        text = short_text(value)
        called = {float(n): what.strip() for n, what in _STANDS_FOR.findall(comments.get(name, ""))}
        if name == KIND:
            continue
        if name == GAP_INDEX:
            usual = "liquid" if is_filled(float(value)) else "air"
            phrases.append(f"{called.get(float(value), usual)} (n = {text})")
        elif name in _SAID:
            phrases.append(_SAID[name].format(text))
        elif value in called:
            phrases.append(f"{called[float(value)]} ({name} = {text})")
        else:
            meaning = _meaning(name, comments)
            unit = unit_of(name) if meaning else None
            phrases.append(" ".join(filter(None, (meaning or f"{name} =", text, unit))))
    return ", ".join(phrases)


def _meaning(name: str, comments: Mapping[str, str]) -> str:
    """What a scene's comment calls a parameter; empty without one."""
    return re.split("[,:]", comments.get(name, ""))[0].strip()


def next_measurements(
    judgement: Judgement, proposals: MeasurementProposals
) -> tuple[NextMeasurement, ...]:
    """What can be done next, by what it would buy per hour.

    That is half of the part by which the light yield's error would fall, and half of that by which
    the doubt which explanation is right would, discounted by how surely it does. The best come
    first, at most ten, with the best two together among them; what buys nothing only where nothing
    does.
    """
    likely = _likely(judgement)
    offers = _offers(judgement, proposals, likely)
    if not offers:
        return ()
    cloud = _cloud(judgement, proposals, likely, offers)
    # what leads only beside wrong readings predicts with them
    leading = [effects for effects in judgement.leading if " + ".join(effects) in cloud.names]
    averaged, known = judgement.light_yield, judgement.baseline.statistic.model.campaign.light_yield
    outcomes, answering = cloud.half(0).outcomes(), cloud.half(1)
    if averaged is not None and known is not None and cloud.yields is not None:
        answering = answering.as_wide_as(averaged.sigma / averaged.value, known.relative_sigma)
    before = answering.left(np.zeros((1, len(answering.weights))))

    def hours(places: tuple[int, ...]) -> float:
        chosen = [offers[i] for i in places]
        mounted = [offer.parameters for offer in chosen if offer.is_reading]
        return proposals.hours(*mounted) + sum(offer.minutes for offer in chosen) / 60.0

    @functools.lru_cache(ADVICE.together)
    def likelihood(place: int) -> Array:
        return answering.log_likelihood(outcomes, place)

    def bought_by(places: tuple[int, ...]) -> tuple[float, _Left]:
        """Half the sum of the parts by which error and doubt fall, per hour, discounted."""
        left = answering.left(sum(map(likelihood, places[1:]), likelihood(places[0])))
        fallen = 1.0 - left.error / before.error if cloud.yields is not None else 0.0
        doubt = (left.probability - before.probability) / max(1.0 - before.probability, 1e-6)
        worth = 0.5 * (fallen + doubt) / hours(places) * left.kept**ADVICE.discount
        # by place where they differ by rounding only
        return round(worth, 6), left

    single: list[tuple[int, ...]] = [(i,) for i in range(len(offers))]
    bought = {places: bought_by(places) for places in single}
    best = sorted(bought, key=lambda places: -bought[places][0])
    best_single = [place for (place,) in best[: ADVICE.together]]
    pairs = {places: bought_by(places) for places in combinations(best_single, 2)}
    if pairs:
        best_pair = max(pairs, key=lambda places: pairs[places][0])
        bought[best_pair] = pairs[best_pair]
    telling = [places for places in bought if bought[places][0] > 0.0] or list(bought)
    order = sorted(telling, key=lambda places: -bought[places][0])[: ADVICE.most]
    rises, rivals = cloud.rises(leading[: ADVICE.most_rivals])
    names = [" + ".join(effects) for effects in leading]
    has_yield = averaged is not None and cloud.yields is not None

    def proposed(places: tuple[int, ...]) -> NextMeasurement:
        chosen, left = [offers[i] for i in places], bought[places][1]
        # by which a reading would separate explanations that are rivals
        risen = rises[:, list(places)].sum(axis=1)
        by_pair = zip(rivals, risen, strict=True)
        return NextMeasurement(
            kind=" + ".join(offer.kind for offer in chosen),
            parameters=chosen[0].parameters,
            separates=tuple(
                (names[a], names[b]) for (a, b), rise in by_pair if rise >= ADVICE.separated
            ),
            expected_delta_chi2=float(risen.mean()) if len(risen) else 0.0,
            also=chosen[1].parameters if chosen[1:] else None,
            light_yield_sigma=left.error if has_yield else None,
            light_yield_kept=left.kept if has_yield else None,
            light_yield_sigma_otherwise=left.otherwise if has_yield else None,
            probability=left.probability,
            hours=hours(places),
            words="; and ".join(offer.words for offer in chosen),
        )

    return tuple(map(proposed, order))


@dataclass(frozen=True)
class _Offer:
    """Something that can be done next."""

    #: As of `NextMeasurement`.
    kind: str
    words: str
    #: Standard error: of a reading the relative one, without the simulation's.
    sigma: float
    #: What is mounted for a reading, by what differs from the scene.
    parameters: dict[str, Value] = field(default_factory=dict)
    #: What it takes besides mountings.
    minutes: float = 0.0
    #: Place of a repeated reading; the parameter or the effect.
    row: int = -1
    name: str = ""

    @property
    def is_reading(self) -> bool:
        """Whether something is mounted for it."""
        return self.kind in (READING, REPEAT)


def _offers(
    judgement: Judgement,
    proposals: MeasurementProposals,
    likely: Sequence[tuple[Hypothesis, float]],
) -> list[_Offer]:
    """New configurations, readings that may be wrong, numbers with a prior, looks; in this order.

    Looks are for effects that lead.
    """
    sigmas = np.broadcast_to(proposals.relative_sigma, len(proposals.configurations))
    offers, states = [], proposals.switched or [[]] * len(sigmas)
    errors = sigmas.tolist()
    for parameters, switched, sigma in zip(proposals.configurations, states, errors, strict=True):
        set_by_hand = {n: v for n, v in parameters.items() if n not in proposals.switched_by}
        phrases = [configuration_words(set_by_hand, proposals.comments), *switched]
        offers.append(_Offer(READING, ", ".join(filter(None, phrases)), sigma, parameters))
    suspects = (hypothesis.suspect for hypothesis, _ in likely if hypothesis.suspect)
    wrong = {label for suspect in suspects for label in suspect.labels}
    statistic = judgement.baseline.statistic
    for row, reading in enumerate(statistic.model.readings):
        if reading.label in wrong:
            of_beam = {KIND: reading.kind} if reading.of_beam else {}
            words, sigma = f"reading {reading.label} once more", reading.sigma / reading.signal
            offers.append(_Offer(REPEAT, words, sigma, {**of_beam, **reading.parameters}, row=row))
    for parameter in statistic.free:
        name, sigma = parameter.name, parameter.prior_sigma
        if parameter.prior is not None and sigma is not None:
            # of "1/cm" what follows a number
            unit = (unit_of(name) or "").removeprefix("1")
            words = f"{_meaning(name, proposals.comments) or name} measured again, to "
            words += f"{number(sigma)} {unit}".strip()
            offers.append(_Offer(NUMBER, words, sigma, minutes=ADVICE.number_minutes, name=name))
    # of 1, there, or 0: with this error a look is so often on the right side of 1/2
    blur = 0.5 / float(ndtri(ADVICE.look_right))
    for name in dict.fromkeys(name for effects in judgement.leading for name in effects):
        effect = judgement.explanations.effects[name]
        if effect.look and not effect.always_there:
            words = f"look for {effect.title}"
            offers.append(_Offer(LOOK, words, blur, minutes=ADVICE.look_minutes, name=name))
    return offers


@dataclass(frozen=True)
class _Cloud:
    """Points of all explanations that are likely, and what they predict."""

    #: (points,) of which explanation each is, by `names`; their probabilities, up to a factor.
    of: Array
    names: tuple[str, ...]
    weights: Array
    #: Probability (0..1) of all of these explanations together.
    covered: float
    #: (points, m) what they predict of every offer, and its standard error.
    signals: Array
    sigmas: Array
    #: (points,) light yields up to a factor, with what no reading tells, in rising order of these;
    #: None where the scale is not fitted.
    yields: Array | None
    #: Factor on the yields' spread, and the relative error of the detector's efficiency besides.
    widening: float = 1.0
    efficiency: float = 0.0

    def half(self, first: int) -> _Cloud:
        """Every other point: 0, to measure at; 1, to answer (what made it knows it too well)."""
        of, weights, count = self.of[first::2], self.weights[first::2], len(self.names)
        parts = np.bincount(of, weights, count) / np.bincount(self.of, self.weights, count)
        return replace(
            self,
            of=of,
            weights=weights / parts[of],  # explanations are as likely as with all points
            signals=self.signals[first::2],
            sigmas=self.sigmas[first::2],
            yields=None if self.yields is None else self.yields[first::2],
        )

    def outcomes(self) -> Array:
        """(outcomes, m) what is then measured, made at some of the points."""
        rng = np.random.default_rng(0)
        at = (np.arange(ADVICE.outcomes) + 0.5) / ADVICE.outcomes
        cumulated = np.cumsum(self.weights)
        true = np.minimum(np.searchsorted(cumulated, at * cumulated[-1]), len(cumulated) - 1)
        noise = rng.standard_normal((ADVICE.outcomes, self.signals.shape[1]))
        return self.signals[true] + self.sigmas[true] * noise

    def log_likelihood(self, readings: Array, place: int) -> Array:
        """(outcomes, points) of what is measured of one offer, by all points."""
        sigma = self.sigmas[:, place]
        away = (readings[:, place, None] - self.signals[:, place]) / sigma
        return np.asarray(-0.5 * away**2 - np.log(sigma), float)

    def as_wide_as(self, error: float, efficiency: float) -> _Cloud:
        """With a factor on the yields' spread by which what tells nothing leaves the error of now.

        That is relative, with what is too unlikely to be a point, what rehearsals add, and the
        detector's `efficiency`.
        """
        spread = self.left(np.zeros((1, len(self.weights)))).error
        # no spread, where all points have one yield, widens to none
        widening = math.sqrt(max(error**2 - efficiency**2, 0.0)) / max(spread, 1e-12)
        return replace(self, widening=widening, efficiency=efficiency)

    def left(self, log_likelihood: Array) -> _Left:
        """What outcomes leave, (outcomes, points) of logarithms; no point: as likely as it was."""
        weights = log_likelihood - log_likelihood.max(axis=1, keepdims=True)
        weights = np.exp(weights, out=weights)
        weights *= self.weights
        cumulated = np.cumsum(weights, axis=1)
        total = cumulated[:, -1:]
        of_name = self.of[:, None] == np.arange(len(self.names))
        by_name = (weights @ of_name.astype(float)) / total
        probability = self.covered * min(float(by_name.max(axis=1).mean()), 1.0)
        if self.yields is None:
            return _Left(math.nan, 1.0, None, probability)
        low, median, high = (
            self.yields[np.minimum((cumulated < part * total).sum(axis=1), len(self.yields) - 1)]
            for part in QUANTILES[1:4]
        )
        error = np.hypot(self.widening * 0.5 * (high - low) / median, self.efficiency)
        return _Left(*_most_kept(error), probability)

    def rises(self, leading: Sequence[tuple[str, ...]]) -> tuple[Array, list[tuple[int, int]]]:
        """(pairs, m): with one of two true, what a reading raises the chi2 of the other by."""
        pairs = list(combinations(range(len(leading)), 2))
        means, sigmas, variances = [], [], []
        for effects in leading:
            members = self.of == self.names.index(" + ".join(effects))
            # by quantiles: one point far away would make up most of a variance
            low, middle, high = np.quantile(self.signals[members], ndtr((-1.0, 0.0, 1.0)), axis=0)
            means.append(middle)
            sigmas.append(np.median(self.sigmas[members], axis=0))
            variances.append((0.5 * (high - low)) ** 2)
        rises = [
            (means[a] - means[b]) ** 2
            / (0.25 * (sigmas[a] + sigmas[b]) ** 2 + np.maximum(variances[a], variances[b]))
            for a, b in pairs
        ]
        return np.array(rises).reshape(len(pairs), self.signals.shape[1]), pairs


class _Left(NamedTuple):
    """What outcomes leave."""

    #: Relative error of the light yield that most leave, the part of them that do, and the median
    #: of the others, None where there are none; nan and all where the scale is not fitted.
    error: float
    kept: float
    otherwise: float | None
    #: Mean probability of the explanation that is then the likeliest.
    probability: float


def _most_kept(errors: Array) -> tuple[float, float, float | None]:
    """An error that most of (outcomes,) errors are near, their part, and the others' median.

    The median of as many as lie within `ADVICE.kept` of one value: of outcomes that go either way
    the median of all may lie where hardly any are.
    """
    errors = np.sort(np.maximum(errors, 1e-12))
    # behind the last error that is alike, for ranges that begin with each one
    ends = np.searchsorted(errors, errors * (1.0 + ADVICE.kept) / (1.0 - ADVICE.kept), side="right")
    first = int(np.argmax(ends - np.arange(len(errors))))
    promised = float(np.median(errors[first : ends[first]]))
    near = np.abs(errors / promised - 1.0) < ADVICE.kept
    otherwise = None if near.all() else float(np.median(errors[~near]))
    return promised, float(near.mean()), otherwise


def _cloud(
    judgement: Judgement,
    proposals: MeasurementProposals,
    likely: Sequence[tuple[Hypothesis, float]],
    offers: Sequence[_Offer],
) -> _Cloud:
    """Points of all these explanations, and what they predict of every offer."""
    configurations = [offer.parameters for offer in offers if offer.is_reading]
    rows = [offer.row for offer in offers if offer.kind == REPEAT]
    count = len(configurations)
    group_of = judgement.group_of
    names = tuple(dict.fromkeys(group_of[each.name] for each, _ in likely))
    discrepancy = DiscrepancyModel(judgement.explanations, judgement.null.frame)
    of, weights, signals, scales = [], [], [], []
    variance = np.zeros(count)
    for each, share in likely:
        assert each.evidence is not None  # those alone predict
        effects, points = tuple(sorted(each.effects)), each.evidence.draws
        predicted = proposals.predict(effects, points, rows)
        variance += share * proposals.noise(effects, np.median(points, axis=0), rows) ** 2
        if each.amplitude:  # something without a name
            fit = judgement.explanations.fit(effects)
            added = discrepancy_at(fit, discrepancy, each.amplitude, points, configurations)
            predicted = predicted * np.exp(added)
        of.append(np.full(len(points), names.index(group_of[each.name])))
        weights.append(np.full(len(points), share / len(points)))
        free = tuple(each.evidence.mean)
        others = [
            points[:, free.index(offer.name)]
            if offer.kind == NUMBER
            else np.full(len(points), float(offer.name in effects))
            for offer in offers[count:]
        ]
        signals.append(np.column_stack([np.maximum(predicted, 1e-300), *others]))
        scales.append(points[:, free.index(SCALE)] if SCALE in free else np.zeros(len(points)))
    weight, scale, signal = map(np.concatenate, (weights, scales, signals))
    sigma = np.tile([offer.sigma for offer in offers], (len(signal), 1))
    # what the simulation does not tell apart, a reading will not tell either
    relative = np.sqrt(sigma[:, :count] ** 2 + variance / sum(share for _, share in likely))
    sigma[:, :count] = relative * signal[:, :count]
    order = np.argsort(scale, kind="stable")
    return _Cloud(
        of=np.concatenate(of)[order],
        names=names,
        weights=weight[order],
        covered=min(sum(share for _, share in likely), 1.0),
        signals=signal[order],
        sigmas=sigma[order],
        yields=scale[order] if scale.all() else None,
    )


def _likely(judgement: Judgement) -> list[tuple[Hypothesis, float]]:
    """Hypotheses that predict, with their probabilities, the likeliest first.

    The first few of those that lead, and all others that are likely, as long as their sets of
    effects, each of which takes a simulation, are not too many. They stand for what adds nothing
    to them, and share its probability.
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
    group_of, parts = judgement.group_of, dict.fromkeys(judgement.group_of.values(), 0.0)
    for hypothesis, share in likely:
        parts[group_of[hypothesis.name]] += share
    wholes = {head.name: whole for head, whole in judgement.groups}
    heads = [group_of[hypothesis.name] for hypothesis, _ in likely]
    pairs = zip(likely, heads, strict=True)
    return [(hypothesis, share * wholes[head] / parts[head]) for (hypothesis, share), head in pairs]
