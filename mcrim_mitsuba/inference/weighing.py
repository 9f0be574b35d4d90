"""All that may explain the readings, weighed: sets of effects, wrong readings, a discrepancy.

All sets of up to three causes are weighed in closed form (`closed_form`). Single effects and the
likeliest other sets get the evidence of the model itself, which knows no straight lines; what is
left of the probability keeps its closed form. So neither the hypotheses nor their odds depend on
what the readings happen to say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, softmax

from mcrim_mitsuba.campaign.parameter import SCALE, LightYieldInput
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.rounding import number, pdg, probability
from mcrim_mitsuba.inference import rehearsal, rival_causes
from mcrim_mitsuba.inference.closed_form import (
    MOST_CAUSES,
    Indices,
    Surroundings,
    WeighedSets,
    weigh_sets,
)
from mcrim_mitsuba.inference.compare import BAD_READING, Suspect, WrongRows, suspected
from mcrim_mitsuba.inference.displacement import BaselineFrame, NullDistribution, cause_of, curve_of
from mcrim_mitsuba.inference.drivers import Minimum, settle
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING, Evidence, evidence_of, log_sum
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.settings import HYPOTHESES, RIVALS

#: All hypotheses that are too unlikely to be listed.
OTHERS = "others"
#: The family of wrong readings and understated errors.
INSTRUMENT = "instrument"


@dataclass(frozen=True)
class AveragedYield:
    """The light yield averaged over all that may explain the readings, photons per keV.

    The average is no Gaussian: an unlikely model may be far from the others. So the value is the
    median, with the intervals that hold 68 % and 95 %.
    """

    value: float
    #: Half the width of the interval that holds 68 %.
    sigma: float
    #: Its parts, by their variances: within the models, the detector's efficiency included; between
    #: them; and by what is in no catalogue.
    within: float
    between: float
    catalogue: float
    #: Ends of the intervals that hold 68 % and 95 %.
    lower: float = math.nan
    upper: float = math.nan
    lower_95: float = math.nan
    upper_95: float = math.nan

    def __str__(self) -> str:
        named = {
            "within models": self.within,
            "between them": self.between,
            "for what is in no catalogue": self.catalogue,
        }
        parts = ", ".join(f"{words} {number(part, 2)}" for words, part in named.items())
        ends = ""
        if math.isfinite(self.lower_95):
            ends = f"95 %: {number(self.lower_95, 2)} to {number(self.upper_95, 2)}; "
        return f"{pdg(self.value, self.sigma)} ph/keV ({ends}{parts})"


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """Something that may explain the readings."""

    #: Effects that are added.
    effects: tuple[str, ...] = ()
    #: What is there besides, which is no effect.
    besides: tuple[str, ...] = ()
    #: Of the discrepancy; 0: there is none.
    amplitude: float = 0.0
    #: Natural logarithm of its weight, over that of the campaign as it is.
    log_weight: float
    #: Mean and standard deviation of ln(scale / that of the baseline).
    log_scale: float
    log_scale_sigma: float
    #: Where the model itself was averaged over.
    evidence: Evidence | None = None
    #: Of the fit with it.
    p_value: float | None = None
    #: Of its wrong readings.
    suspect: Suspect | None = None

    @property
    def name(self) -> str:
        """As probabilities are listed."""
        return " + ".join(self.causes) or NOTHING_MISSING

    @property
    def causes(self) -> tuple[str, ...]:
        """All that is there; none where nothing is missing."""
        return (*self.effects, *self.besides)


@dataclass(frozen=True, kw_only=True)
class Weighing:
    """How likely all hypotheses are beside each other."""

    #: The likeliest first, those alike but for an amplitude or a factor each by itself.
    hypotheses: tuple[Hypothesis, ...]
    #: (hypotheses,) float64: Their probabilities, which sum to 1.
    shares: Array
    #: By effect and by family, what includes it; the instrument is a family, and so is what has no
    #: name.
    inclusion: dict[str, float]
    families: dict[str, float]
    #: Probability of what was weighed in closed form alone, and by how much this differed, in the
    #: middle, where sets were weighed in both ways: of the logarithm of the odds.
    closed_part: float
    closed_error: float
    #: Probability that something moves the light yield by more than its error, or a reading by two
    #: of its errors.
    moving: float
    #: Of a larger misfit than that of the readings, whichever hypothesis is true.
    p_value: float
    #: What they are weighed with.
    design: rehearsal.Design
    #: Factors on the intervals of ln(scale) that hold 68 % and 95 %, by rehearsals.
    widening: tuple[float, float] = (1.0, 1.0)

    @property
    def caution(self) -> str:
        """What is to be said of the closed form; empty where it decides little, or is exact."""
        exact = self.closed_error < HYPOTHESES.exact
        if exact or self.closed_part < HYPOTHESES.decides:
            return ""
        return (
            f"{probability(self.closed_part)} of the probability is of sets of causes that were "
            f"weighed in closed form, which differs by {self.closed_error:.1f} in the logarithm of "
            "the odds from fits: such far effects are no straight lines"
        )

    @property
    def mixture(self) -> rehearsal.Mixture:
        """Of ln(scale / that of the baseline), a Gaussian for each hypothesis."""
        means, sigmas = np.array([(h.log_scale, h.log_scale_sigma) for h in self.hypotheses]).T
        return self.shares, means, sigmas

    def probability(self, holds: Callable[[Hypothesis], bool]) -> float:
        """Of all hypotheses for which something holds."""
        which = np.array([holds(hypothesis) for hypothesis in self.hypotheses])
        return float(self.shares[which].sum())

    def light_yield(
        self, known: LightYieldInput | None, scale: float | None
    ) -> AveragedYield | None:
        """Averaged over all; None where nothing turns the baseline's fitted scale into it."""
        if known is None or scale is None:
            return None
        _, means, sigmas = self.mixture
        efficiency = known.relative_sigma
        unnamed = np.array([h.amplitude > 0.0 for h in self.hypotheses])
        middle = rehearsal.quantile(self.shares, means, sigmas, 0.5)
        factor_68, factor_95 = self.widening
        # all that the efficiency does is common to all hypotheses, and is not widened
        factors = factor_95, factor_68, 1.0, factor_68, factor_95
        ends = []
        for part, factor in zip(rehearsal.QUANTILES, factors, strict=True):
            wider = middle + factor * (means - middle), np.hypot(factor * sigmas, efficiency)
            ends.append(rehearsal.quantile(self.shares, *wider, part))
        lower_95, lower, value, upper, upper_95 = (known.per_scale * scale * np.exp(ends)).tolist()
        # parts as those of the variance, but no part is farther away than 95 % of all
        reach = max(ends[4] - ends[2], ends[2] - ends[0])
        means = middle + np.clip(means - middle, -reach, reach)
        mean, sigmas = float(self.shares @ means), np.minimum(sigmas, reach)
        between, own = self.shares * (means - mean) ** 2, self.shares * sigmas**2
        variances = np.array(
            [own[~unnamed].sum(), between[~unnamed].sum(), (own + between)[unnamed].sum()]
        )
        # what rehearsals add is for what is in no catalogue
        variances[2] += (factor_68**2 - 1.0) * variances.sum()
        variances[0] += efficiency**2
        sigma = 0.5 * (upper - lower)
        within, unsure, catalogue = (sigma * np.sqrt(variances / variances.sum())).tolist()
        return AveragedYield(
            value, sigma, within, unsure, catalogue, lower, upper, lower_95, upper_95
        )


def weigh_hypotheses(
    explanations: Explanations,
    null: NullDistribution,
    *,
    closed: bool = False,
    together: Collection[tuple[str, ...]] = (),
) -> Weighing:
    """Weigh all sets of causes, the likeliest by the model's own evidence, or all `closed`.

    So are effects `together` that may fit where those of the closed form, on straight lines about
    fits without them, do not.
    """
    weigher = _Weigher(explanations, null)
    if closed:
        return weigher.weighing()
    for effects in ((), *((name,) for name in null.curves), *together):
        weigher.average_over(weigher.place_of(effects))
    for effect in weigher.centres():
        weigher.centre_on(effect)
    for _ in range(HYPOTHESES.in_full):
        place = weigher.likeliest_closed()
        if place is None:
            break
        weigher.average_over(place)
    return weigher.weighing()


class _Weigher:
    """Sets in closed form, of which one after the other gets its own evidence."""

    def __init__(self, explanations: Explanations, null: NullDistribution) -> None:
        self._explanations, self._surroundings = explanations, rival_causes.surroundings()
        self._readings = rival_causes.suspicious(null.frame)
        self._frame, curves = null.frame, null.curves
        beside = rival_causes.frame_beside(explanations, null.frame)
        if beside is not None:
            self._frame = beside
            curves = {name: curve_of(explanations, name, beside) for name in null.curves}
        self._effects = tuple(curves)
        self._discrepancy = rival_causes.DiscrepancyModel(explanations, self._frame)
        self._covariance = self._discrepancy.covariance()
        causes = [cause_of(explanations, name, curve) for name, curve in curves.items()]
        causes += rival_causes.wrong_readings(self._frame, self._readings)
        self._log_odds_of = {cause.name: cause.log_odds for cause in causes}
        # which two causes cannot be there together
        readings = [set(wrong.rows) for wrong in self._readings.values()]
        effects, count = self._explanations.effects, len(self._effects)
        excluded = np.zeros((count + len(readings),) * 2, bool)
        for i, one in enumerate(self._effects):
            for j, other in enumerate(self._effects[:i]):
                refused = one in effects[other].excludes or other in effects[one].excludes
                excluded[i, j] = excluded[j, i] = refused
        for i, one_row in enumerate(readings):
            for j, other_row in enumerate(readings):
                excluded[count + i, count + j] = i != j and bool(one_row & other_row)
        self._excluded = excluded
        self.design = rehearsal.Design(
            frame=self._frame,
            curves=curves,
            causes=tuple(causes),
            surroundings=self._surroundings,
            discrepancy=self._discrepancy.seen_from(self._frame),
            excluded=self._excluded,
        )
        self.sets: WeighedSets = self.design.weighed(self._frame.z)
        # (3, sets): along a short last axis numpy looks slowly
        self._members = np.ascontiguousarray(self.sets.members.T)
        is_effect = (self._members >= 0) & (self._members < len(self._effects))
        self._with_effect = np.asarray(is_effect.any(axis=0))
        self._keys = self._keys_of(self.sets.members, self.sets.within)
        self._by_key = np.argsort(self._keys)
        self._log_weights = self.sets.log_weights - self.sets.log_weights[0]
        self._log_scales, self._variances = self.sets.log_scales.copy(), self.sets.variances.copy()
        self._full: dict[int, Hypothesis] = {}
        # what evidences differ by from the closed form, by place; of sets that are not near as such
        self._rises: dict[int, float] = {}
        self._errors: list[float] = []
        self._centred = np.zeros(len(self._log_weights), bool)
        if beside is not None:
            self._join()

    def _keys_of(self, members: Indices, within: Indices) -> Indices:
        """(sets,) A number for every set in its surroundings, whatever its members' order."""
        count = len(self._effects) + len(self._readings) + 1
        first, second, third = np.sort(members, axis=1).T + 1
        return ((within * count + first) * count + second) * count + third

    def _join(self) -> None:
        """Sets around another point than the baseline, and evidences, which are over that of it.

        What has no name alone, of the likeliest amplitude, is the same in both.
        """
        none = self.sets.members[:, 0] < 0
        lone = np.flatnonzero(none & (self.sets.amplitudes > 0.0))
        place = int(lone[self._log_weights[lone].argmax()])
        self.average_over(place)
        rise = self._rises[place]
        self._log_scales += self._full[place].log_scale - self._log_scales[place]
        self._log_weights[np.arange(len(none)) != place] += rise
        self._rises[place] = 0.0
        self._errors.clear()

    def centres(self) -> list[str]:
        """Effects around whose own fit sets are to be weighed, the likeliest first."""
        weights = {name: self._log_weights[self.place_of((name,))] for name in self._effects}
        least = max(weights.values(), default=0.0) + math.log(HYPOTHESES.centred)
        likely = (name for name, weight in weights.items() if weight > max(least, 0.0))
        names = sorted(likely, key=lambda name: -weights[name])
        return names[: HYPOTHESES.most_centres]

    def centre_on(self, effect: str) -> None:
        """Weigh all sets with an effect around its own fit: lines are straight for less far."""
        centre, explanations = self._effects.index(effect), self._explanations
        frame = BaselineFrame(explanations.fit((effect,)))
        others, causes = [], []
        for i, other in enumerate(self._effects):
            apart = self._excluded[i, centre] or i == centre
            if not apart and explanations.possible((effect, other)):
                curve = curve_of(explanations, other, frame, (effect,))
                causes.append(cause_of(explanations, other, curve))
                others.append(i)
        causes += rival_causes.wrong_readings(frame, self._readings)
        others += range(len(self._effects), len(self._excluded))
        sets = weigh_sets(
            causes,
            self._surroundings,
            frame.z,
            discrepancy=self._discrepancy.seen_from(frame),
            scale_variance=frame.scale_variance,
            excluded=self._excluded[np.ix_(others, others)],
            most=MOST_CAUSES - 1,
        )
        members = np.append(others, -1)[sets.members]
        members[:, -1] = centre  # two further causes at most
        keys = self._keys_of(members, sets.within)
        at = np.searchsorted(self._keys, keys, sorter=self._by_key)
        places = self._by_key[np.minimum(at, len(self._keys) - 1)]
        there = (self._keys[places] == keys) & ~self._centred[places]
        there &= ~np.isin(places, list(self._full))
        places, own = places[there], self._full[self.place_of((effect,))]
        self._centred[places] = True
        self._log_weights[places] = own.log_weight + (sets.log_weights - sets.log_weights[0])[there]
        self._log_scales[places] = own.log_scale + sets.log_scales[there]
        self._variances[places] = sets.variances[there]

    def place_of(self, effects: tuple[str, ...]) -> int:
        """Of a set of effects in plain surroundings."""
        members = np.full((1, MOST_CAUSES), -1)
        members[0, : len(effects)] = [self._effects.index(name) for name in effects]
        key = self._keys_of(members, np.zeros(1, int))
        return int(self._by_key[np.searchsorted(self._keys, key, sorter=self._by_key)[0]])

    def likeliest_closed(self) -> int | None:
        """The likeliest set that has no evidence of its own; None where it is not worth one."""
        closed = self._log_weights.copy()
        if self._full:
            top = max(self._full, key=lambda place: closed[place])
            # where lines are not straight for it, nothing else says whether all of it is needed
            if abs(self._rises[top]) > HYPOTHESES.exact:
                closed[self._simpler(top)] = math.inf
        closed[list(self._full)] = -math.inf
        place = int(closed.argmax())
        worth = math.log(HYPOTHESES.worth) + float(log_sum(self._log_weights))
        return place if closed[place] > worth else None

    def _simpler(self, place: int) -> list[int]:
        """Sets with one cause less, and that of all its causes in plain surroundings."""
        members, within = self.sets.members[place], self.sets.within[place]
        fewer = [np.where(members == one, -1, members) for one in members if one >= 0]
        around = [within] * len(fewer) + [np.int64(0)] * int(within > 0)
        fewer += [members] * int(within > 0)
        if not fewer:
            return []
        keys = self._keys_of(np.array(fewer), np.array(around))
        return list(self._by_key[np.searchsorted(self._keys, keys, sorter=self._by_key)])

    def average_over(self, place: int) -> None:
        """Give a set the evidence of its model, averaged over plausible sizes."""
        names, around = self.sets.names(place), self.sets.surroundings[self.sets.within[place]]
        effects = tuple(name for name in names if name not in self._readings)
        wrong = tuple(name for name in names if name in self._readings)
        if not self._explanations.possible(effects):  # more parameters than readings and priors
            self._full[place], self._rises[place] = self._closed(place), 0.0
            return
        own_part = math.exp(self._log_weights[place] - float(log_sum(self._log_weights)))
        rough = own_part < HYPOTHESES.precise
        if around.is_plain and not wrong:
            fit = self._explanations.fit(effects)
            # all others are compared with that of no effect
            evidence = self._explanations.evidence(effects, rough=rough and bool(effects))
            evidences = [(fit, evidence)]
        else:
            evidences = self._averaged(effects, wrong, around, rough=rough)
        logs = [evidence.log for _, evidence in evidences]
        fit, evidence = evidences[int(np.argmax(logs))]
        log = float(log_sum(np.array(logs))) - math.log(len(logs))
        own = self._explanations.log_odds(effects) + around.log_prior
        own += sum(self._log_odds_of[name] for name in wrong)
        closed = float(self._log_weights[place])
        self._log_weights[place] = log - self._explanations.evidence(()).log + own
        self._rises[place] = float(self._log_weights[place]) - closed
        if len(names) > 1 or not around.is_plain:
            self._errors.append(abs(self._rises[place]))
        log_scale, sigma = self._scale_of(evidence)
        self._full[place] = replace(
            self._closed(place),
            log_scale=log_scale,
            log_scale_sigma=sigma,
            evidence=evidence,
            p_value=fit.p_value,
            suspect=self._suspect(wrong, fit),
        )

    def _averaged(
        self, effects: tuple[str, ...], wrong: tuple[str, ...], around: Surroundings, *, rough: bool
    ) -> list[tuple[Minimum, Evidence]]:
        """Fits and evidences with wrong readings of every size, in some surroundings."""
        explanations, start = self._explanations, self._explanations.fit(effects)
        statistic, own = start.statistic, start.statistic
        covariance = around.amplitude**2 * self._covariance
        if around.error_factor != 1.0:
            signal = start.signal[statistic.used]
            stated = start.weights.errors.readings / np.outer(signal, signal)
            covariance = covariance + (around.error_factor**2 - 1.0) * stated
        single = np.zeros(len(covariance))
        for name in wrong:
            if self._readings[name].partners:
                own = own.exchanged(*self._readings[name].exchange(len(single)))
            else:
                single[list(self._readings[name].rows)] = 1.0
        evidences = []
        for size in RIVALS.bad_sizes if single.any() else (0.0,):
            own = own.with_unexplained(covariance + np.diag(size**2 * single))
            fit = settle(own, start.theta)
            evidences.append((fit, evidence_of(fit, explanations.priors(effects), rough=rough)))
        return evidences

    def _scale_of(self, evidence: Evidence) -> tuple[float, float]:
        """Mean and standard deviation of ln(scale / that of the baseline)."""
        if SCALE not in evidence.mean or not evidence.mean[SCALE] > 0.0:
            return 0.0, 0.0
        mean = evidence.mean[SCALE] / self._explanations.baseline.values[SCALE]
        variance = math.log1p((evidence.sigma[SCALE] / evidence.mean[SCALE]) ** 2)
        return math.log(mean) - 0.5 * variance, math.sqrt(variance)

    def _suspect(self, wrong: tuple[str, ...], fit: Minimum) -> Suspect | None:
        """Wrong readings, or two exchanged rows, as they are told."""
        if not wrong:
            return None
        baseline = self._explanations.baseline
        suspicions = [self._readings[name] for name in wrong]
        together = suspicions[0]
        if len(wrong) > 1:
            rows = tuple(sorted({row for suspicion in suspicions for row in suspicion.rows}))
            labels = tuple(baseline.statistic.labels[row] for row in rows)
            together = WrongRows(BAD_READING, labels, rows)
        pull = None
        if together.kind == BAD_READING and len(together.rows) == 1:
            # to first order the square of the pull is the gain
            away = float(baseline.weighted_residuals[together.rows[0]])
            pull = math.copysign(math.sqrt(max(baseline.chi2 - fit.chi2, 0.0)), away)
        return suspected(baseline, together, fit.chi2, pull)

    def _closed(self, place: int) -> Hypothesis:
        """A set by its closed form."""
        names, around = self.sets.names(place), self.sets.surroundings[self.sets.within[place]]
        besides = [name for name in names if name in self._readings]
        besides += [rival_causes.UNKNOWN] if around.amplitude > 0.0 else []
        besides += [rival_causes.UNDERSTATED] if around.error_factor != 1.0 else []
        return Hypothesis(
            effects=tuple(name for name in names if name not in self._readings),
            besides=tuple(besides),
            amplitude=around.amplitude,
            log_weight=float(self._log_weights[place]),
            log_scale=float(self._log_scales[place]),
            log_scale_sigma=math.sqrt(max(self._variances[place], 1e-16)),
        )

    def weighing(self) -> Weighing:
        """All hypotheses with their probabilities."""
        shares = softmax(self._log_weights)
        listed = set(np.flatnonzero(shares >= 1e-3 * HYPOTHESES.listed).tolist()) | set(self._full)
        # by place where they differ by rounding only
        order = sorted(listed, key=lambda place: (-round(float(shares[place]), 9), place))
        hypotheses = [
            replace(self._full.get(p) or self._closed(p), log_weight=float(self._log_weights[p]))
            for p in order
        ]
        kept = np.array([shares[place] for place in order])
        in_full = np.array([place in self._full for place in order])
        weighing = Weighing(
            hypotheses=tuple(hypotheses),
            shares=kept / kept.sum(),
            inclusion={
                name: float(shares[(self._members == i).any(axis=0)].sum())
                for i, name in enumerate(self._effects)
            },
            families=self._families(shares),
            closed_part=float(1.0 - kept[in_full].sum()),
            closed_error=float(np.median(self._errors)) if self._errors else 0.0,
            moving=self._moving(shares),
            p_value=_p_value(hypotheses, kept),
            design=self.design,
        )
        factors = rehearsal.widening(
            self.design,
            weighing.mixture,
            float(shares[~self._with_effect & (self.sets.amplitudes > 0.0)].sum()),
            float(shares[rehearsal.of_instrument(self.sets, len(self._effects))].sum()),
        )
        return replace(weighing, widening=factors)

    def _families(self, shares: Array) -> dict[str, float]:
        """Probability of all sets with a member of a family, the likeliest first."""
        sets, count = self.sets, len(self._effects)
        members: dict[str, NDArray[np.bool_]] = {}
        for i, name in enumerate(self._effects):
            family = self._explanations.effects[name].family
            held = (self._members == i).any(axis=0)
            members[family] = members.get(family, np.zeros(len(shares), bool)) | held
        members[INSTRUMENT] = (self._members >= count).any(axis=0) | (sets.error_factors != 1.0)
        members[rival_causes.UNKNOWN] = sets.amplitudes > 0.0
        families = {family: float(shares[held].sum()) for family, held in members.items()}
        families[NOTHING_MISSING] = float(shares[self.place_of(())])
        return dict(sorted(families.items(), key=lambda item: -item[1]))

    def _moving(self, shares: Array) -> float:
        """Probability that a cause moves the light yield, or a reading, by more than is harmless.

        A set moves the yield by a Gaussian of its own mean and width, with that of the baseline
        taken off. The error of the yield is the whole one, with the detector's efficiency.
        """
        sets, own = self.sets, self._frame.scale_variance
        means, variances = self._log_scales.copy(), self._variances.copy()
        for place, hypothesis in self._full.items():
            means[place], variances[place] = hypothesis.log_scale, hypothesis.log_scale_sigma**2
        there = (sets.members[:, 0] >= 0) | (sets.amplitudes > 0.0)
        stated = own * sets.error_factors**2
        width = np.sqrt(np.maximum(variances - stated, 1e-12 + 1e-6 * own))
        limit = math.sqrt(own)
        if (known := self._frame.fit.statistic.model.campaign.light_yield) is not None:
            limit = math.hypot(limit, known.relative_sigma)
        moves = ndtr((-limit - means) / width) + ndtr((means - limit) / width)
        moves *= there
        # a wrong reading moves no prediction but through what is fitted
        for likely in np.flatnonzero(self._with_effect & (shares > HYPOTHESES.listed)).tolist():
            readings = self._frame.readings_moved(sets.moved(likely, self._frame.z))
            if np.abs(readings).max(initial=0.0) > 2.0:
                moves[likely] = 1.0
        return float(shares @ moves)


def _p_value(hypotheses: Iterable[Hypothesis], shares: Array) -> float:
    """Of a larger misfit than that of the readings, averaged over hypotheses that were fitted."""
    pairs = zip(hypotheses, shares.tolist(), strict=True)
    fitted = [
        (share, hypothesis.p_value) for hypothesis, share in pairs if hypothesis.p_value is not None
    ]
    total = sum(share for share, _ in fitted)
    return sum(share * p for share, p in fitted) / total if total > 0.0 else 1.0
