"""What the hypotheses' probabilities say of a campaign: the verdict, and what it rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.rounding import p_equals, probability
from mcrim_mitsuba.inference.compare import Suspect
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.estimates import error_of_difference
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.rehearsal import Capability, capability
from mcrim_mitsuba.inference.rival_causes import UNDERSTATED, UNKNOWN
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, HYPOTHESES, JUDGING
from mcrim_mitsuba.inference.weighing import INSTRUMENT, OTHERS, AveragedYield, Hypothesis, Weighing

#: The verdicts of a diagnosis.
TOO_FEW_READINGS = "too_few_readings"
ADEQUATE = "adequate"
MISSING_EFFECT = "missing_effect"
AMBIGUOUS = "ambiguous"
UNEXPLAINED = "unexplained"


#: What has a probability beside effects and readings that are wrong, in words.
NO_EFFECTS = {
    UNKNOWN: "something that is in no catalogue",
    UNDERSTATED: "errors of the readings that are all stated too small",
    NOTHING_MISSING: "nothing missing",
}


@dataclass(frozen=True)
class Verdict:
    """What the fits say of a campaign."""

    word: str
    #: In a sentence.
    reason: str
    #: Sets of effects that the data cannot tell apart, the best first.
    leading: tuple[tuple[str, ...], ...] = ()
    #: Readings that explain the misfit as well as the leading effects, or better.
    suspects: tuple[Suspect, ...] = ()
    #: Sets among the leading ones that only the simulation's error keeps there.
    unsettled: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Judgement:
    """What a verdict rests on."""

    explanations: Explanations
    null: NullDistribution
    weighing: Weighing
    #: Probability of a family from which it is named.
    sure: float = JUDGING.named

    @property
    def baseline(self) -> Minimum:
        """The campaign as it is."""
        return self.explanations.baseline

    @property
    def is_adequate(self) -> bool:
        """Whether nothing that matters is missing, as far as the readings tell.

        It is where they are not unlike what is expected, and nothing is likely to move the light
        yield by more than its error, or the prediction of a reading by two of its own.
        """
        weighing = self.weighing
        described = self._is_described and weighing.p_value >= ACCEPTABLE_P
        return described and weighing.moving < JUDGING.harmless

    @property
    def _is_described(self) -> bool:
        """Whether the campaign as it is describes its readings."""
        return explains(self.baseline, ACCEPTABLE_P)

    @cached_property
    def singles(self) -> tuple[tuple[str, ...], ...]:
        """Effects alone, the likeliest first."""
        evidence = self.explanations.evidence
        return tuple(sorted(((n,) for n in self.null.curves), key=lambda key: -evidence(key).log))

    @property
    def larger_sets(self) -> tuple[tuple[str, ...], ...]:
        """Sets of two effects and more that explain what fewer do not, the likeliest first."""
        evident = {h.effects for h in self.weighing.hypotheses if h.evidence and not h.besides}
        sets = (h.effects for h, _ in self.groups if len(h.effects) > 1)
        return tuple(effects for effects in dict.fromkeys(sets) if effects in evident)

    def behind(self, effects: tuple[str, ...]) -> float:
        """How far effects are behind the best of as many, twice the logarithm of the evidence."""
        same = self.singles if len(effects) == 1 else self.larger_sets
        best = max(self.explanations.evidence(key).log for key in same)
        return 2.0 * (best - self.explanations.evidence(effects).log)

    @cached_property
    def group_of(self) -> dict[str, str]:
        """By hypotheses' names, that of the one to which it adds nothing, or its own.

        To a set of effects nothing is added by what is less likely and holds more: a further cause
        that the readings do not ask for.
        """
        shares: dict[str, float] = {}
        weighing = self.weighing
        for hypothesis, share in zip(weighing.hypotheses, weighing.shares.tolist(), strict=True):
            shares[hypothesis.name] = shares.get(hypothesis.name, 0.0) + share
        by_name = {hypothesis.name: hypothesis for hypothesis in weighing.hypotheses}
        groups: dict[str, str] = {}
        heads: list[tuple[str, frozenset[str]]] = []
        for name in _likeliest_first(shares):
            causes = frozenset(by_name[name].causes)
            groups[name] = next((head for head, fewer in heads if fewer < causes), name)
            if groups[name] == name and by_name[name].effects:
                heads.append((name, causes))
        return groups

    @cached_property
    def groups(self) -> tuple[tuple[Hypothesis, float], ...]:
        """The hypotheses that head a group, with the probability of it, the likeliest first."""
        weighing, shares = self.weighing, dict.fromkeys(self.group_of.values(), 0.0)
        for hypothesis, share in zip(weighing.hypotheses, weighing.shares.tolist(), strict=True):
            shares[self.group_of[hypothesis.name]] += share
        heads = {h.name: h for h in reversed(weighing.hypotheses)}
        return tuple((heads[name], shares[name]) for name in _likeliest_first(shares))

    @property
    def probabilities(self) -> dict[str, float]:
        """Of these groups by name, the likeliest first; all that are not listed are ``others``."""
        by_name = {hypothesis.name: share for hypothesis, share in self.groups}
        listed = {n: p for n, p in by_name.items() if p >= HYPOTHESES.listed}
        for name in (UNKNOWN, NOTHING_MISSING):
            listed.setdefault(name, by_name.get(name, 0.0))
        return {**listed, OTHERS: max(1.0 - sum(listed.values()), 0.0)}

    @cached_property
    def credible(self) -> tuple[tuple[Hypothesis, float], ...]:
        """The fewest of these groups that hold 95 %."""
        credible, sum_so_far = [], 0.0
        for hypothesis, share in self.groups:
            credible.append((hypothesis, share))
            sum_so_far += share
            if sum_so_far >= JUDGING.credible:
                break
        return tuple(credible)

    @cached_property
    def leading(self) -> tuple[tuple[str, ...], ...]:
        """Sets of effects among them, the likeliest first.

        Where the likeliest describes the readings, none whose own fit they refuse: what explains
        them is then what is beside it, something without a name or larger errors.
        """
        sets = [h for h, _ in self.credible if h.effects]
        if sets and not self._is_refused(sets[0]):
            sets = [hypothesis for hypothesis in sets if not self._is_refused(hypothesis)]
        return tuple(dict.fromkeys(h.effects for h in sets))

    def _is_refused(self, hypothesis: Hypothesis) -> bool:
        """Whether effects, beside wrong readings, leave a misfit that is hardly chance."""
        p, effects = hypothesis.p_value, hypothesis.effects
        # these describe any readings
        if {UNKNOWN, UNDERSTATED} & {*hypothesis.besides} and self.explanations.possible(effects):
            p = self.explanations.fit(effects).p_value
        return p is not None and p < JUDGING.refused

    @cached_property
    def unsettled(self) -> tuple[tuple[str, ...], ...]:
        """Further sets of effects that more photons might let lead: within two of its errors."""
        if not self.leading:
            return ()
        fit_of, best = self.explanations.fit, self.explanations.fit(self.leading[0])
        best_refused = best.p_value is not None and best.p_value < JUDGING.refused
        best_weight = max(h.log_weight for h, _ in self.credible if h.effects)
        lowest = best_weight + math.log(1.0 - JUDGING.credible)
        return tuple(
            h.effects
            for h in self.weighing.hypotheses
            if h.effects and not h.besides and h.evidence is not None
            # two errors of chi2, which is twice the logarithm of a weight
            if not any(set(leads) <= set(h.effects) for leads in self.leading)
            and h.log_weight + error_of_difference(fit_of(h.effects), best) >= lowest
            and (best_refused or not self._is_refused(h))
        )

    @property
    def named_families(self) -> tuple[str, ...]:
        """Families of which a member is missing as good as surely, the likeliest first."""
        others = (INSTRUMENT, UNKNOWN, NOTHING_MISSING)
        families = self.weighing.families.items()
        return tuple(family for family, p in families if p >= self.sure and family not in others)

    @property
    def light_yield(self) -> AveragedYield | None:
        """Averaged over all; None where nothing turns the fitted scale into it."""
        known = self.baseline.statistic.model.campaign.light_yield
        return self.weighing.light_yield(known, self.baseline.values.get(SCALE))

    def capability(self, seed: int) -> Capability:
        """What such readings could say, whatever they say."""
        families = {name: effect.family for name, effect in self.explanations.effects.items()}
        return capability(self.weighing.design, families, seed, self.sure)

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """Wrong readings that may explain the misfit, the likeliest first."""
        suspects: dict[tuple[str, tuple[str, ...]], Suspect] = {}
        for suspect in (h.suspect for h, _ in self.credible if h.suspect is not None):
            suspects.setdefault((suspect.kind, suspect.labels), suspect)
        return tuple(suspects.values())

    @cached_property
    def verdict(self) -> Verdict:
        """What is said of the campaign."""
        baseline, weighing = self.baseline, self.weighing
        quality = f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom"
        if self.is_adequate:
            return Verdict(
                ADEQUATE,
                f"{quality} ({p_equals(baseline.p_value)}), and with a probability of "
                f"{probability(1.0 - weighing.moving)} nothing is missing that moves the light "
                "yield by more than its error, or a reading by more than two of its",
            )
        of_instrument = weighing.families[INSTRUMENT]
        of_effects = weighing.probability(lambda h: bool(h.effects))
        suspects = self.suspects
        if suspects and of_instrument >= self.sure:
            return _of_suspects(suspects)
        if of_effects >= 0.5 and weighing.p_value >= ACCEPTABLE_P and self.leading:
            return self._of_leading(suspects)
        if self._is_described:
            nothing = probability(weighing.families[NOTHING_MISSING])
            reason = f"{quality} ({p_equals(baseline.p_value)}): the readings do not tell whether "
            reason += f"anything is missing; nothing is ({nothing}), or {self._likeliest()}"
            return Verdict(AMBIGUOUS, reason, self.leading)
        if suspects and of_instrument > of_effects:
            return _of_suspects(suspects)
        reason = f"{quality}, and that an effect of the catalogue explains it has a probability of "
        reason += f"{probability(of_effects)} only; likeliest is {self._likeliest()}"
        return Verdict(UNEXPLAINED, reason, suspects=suspects)

    def _likeliest(self) -> str:
        """The likeliest but for nothing, in words, with its probability."""
        hypothesis, share = next(item for item in self.groups if item[0].name != NOTHING_MISSING)
        words = [self.explanations.title(hypothesis.effects)] if hypothesis.effects else []
        if hypothesis.suspect is not None:
            words.append(hypothesis.suspect.words)
        words += [NO_EFFECTS[name] for name in hypothesis.besides if name in NO_EFFECTS]
        return f"{' with '.join(words)} ({probability(share)})"

    def _of_leading(self, suspects: tuple[Suspect, ...]) -> Verdict:
        """The verdict where effects lead: one is missing, or several cannot be told apart."""
        leading, best = self.leading, self.explanations.fit(self.leading[0])
        quality = f"chi2 = {best.chi2:.3g} for {best.ndf} degrees of freedom"
        quality += f" ({p_equals(best.p_value)})" if best.p_value is not None else ""
        if suspects:
            words = f"{self._titles(leading)} or {suspects[0].words} may explain the misfit"
            return Verdict(AMBIGUOUS, f"{words}: check the reading first", leading, suspects)
        named, unsettled = self.named_families, self.unsettled
        if unsettled:
            reason = f"{self._titles(leading)} may explain the misfit: {quality} with the first; "
            reason += f"more photons would tell whether {self._titles(unsettled)} may as well"
            return Verdict(AMBIGUOUS, reason, leading + unsettled, unsettled=unsettled)
        if len(leading) == 1:
            described = explains(best, ACCEPTABLE_P)
            how = "explains the misfit" if described else "explains most of the misfit, not all"
            reason = f"{self._titles(leading)} {how}: {quality}"
            families = {self.explanations.effects[name].family for name in leading[0]}
            left = best.chi2 - best.ndf
            of_all = left < JUDGING.left * (self.baseline.chi2 - self.baseline.ndf)
            if families <= set(named) and (described or of_all):
                return Verdict(MISSING_EFFECT, reason, leading)
            besides = "so may" if described else "there may be"
            reason += f"; but {besides} something that is in no catalogue"
            return Verdict(AMBIGUOUS, reason, leading)
        reason = f"the readings cannot tell apart {self._titles(leading)}: {quality} with the first"
        # effects of no family are no relatives
        if named := tuple(family for family in named if family != OTHERS):
            reason += f"; that it is of the family {' and '.join(named)} is as good as sure"
        return Verdict(AMBIGUOUS, reason, leading)

    def _titles(self, leading: tuple[tuple[str, ...], ...]) -> str:
        """What leads, in words; of many the likeliest: the ranking has them all."""
        *first, last = map(self.explanations.title, leading)
        if len(leading) > JUDGING.most_named + 1:
            first, last = first[: JUDGING.most_named], f"{len(leading) - JUDGING.most_named} others"
        return f"{', '.join(first)} and {last}" if first else last


def explains(fit: Minimum, level: float) -> bool:
    """Whether a fit leaves nothing to explain, as far as its readings can tell."""
    p = fit.p_value
    return fit.chi2 < 1.0 if p is None else p >= level


def _likeliest_first(shares: dict[str, float]) -> list[str]:
    """Names by their probabilities; where these differ by rounding only, by themselves."""
    return sorted(shares, key=lambda name: (-round(shares[name], 9), name))


def _of_suspects(suspects: tuple[Suspect, ...]) -> Verdict:
    """The verdict where wrong readings explain the misfit better than physics."""
    others = f", or {suspects[1].words}" if len(suspects) > 1 else ""
    better = f"{suspects[0].words}{others} explains the misfit better than any effect"
    reason = f"{better}: check that before physics is blamed"
    return Verdict(UNEXPLAINED, reason, suspects=suspects)
