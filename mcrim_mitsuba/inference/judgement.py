"""What the fits of a campaign's explanations say: the verdict, and what it rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from scipy.special import chdtrc, logsumexp

from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.inference.compare import Suspect
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.estimates import corrected, left_out_error
from mcrim_mitsuba.inference.evidence import Hypothesis
from mcrim_mitsuba.inference.explanations import Explanations, NullDistribution, Ranking
from mcrim_mitsuba.inference.rival_causes import UNKNOWN
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, JUDGING, RIVALS

#: The verdicts of a diagnosis.
TOO_FEW_READINGS = "too_few_readings"
ADEQUATE = "adequate"
MISSING_EFFECT = "missing_effect"
AMBIGUOUS = "ambiguous"
UNEXPLAINED = "unexplained"


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
    #: Of the effects alone.
    singles: Ranking
    null: NullDistribution
    #: Of two at once; None where an effect alone explains the readings.
    pairs: Ranking | None = None
    #: What else may explain the readings: wrong ones, the likeliest first, with whose they are.
    instrument: Sequence[tuple[Hypothesis, Suspect]] = ()
    #: What has no name.
    unknown_causes: Sequence[Hypothesis] = ()

    @property
    def baseline(self) -> Minimum:
        """The campaign as it is."""
        return self.explanations.baseline

    @property
    def p_of_best_gain(self) -> float:
        """Probability that chance alone gains as much as the effect that gains most."""
        chi2 = [self.explanations.fit(effects).chi2 for effects in self.singles.order]
        return self.null.p_global(self.baseline.chi2 - min(chi2)) if chi2 else 1.0

    @property
    def is_adequate(self) -> bool:
        """Whether neither the readings nor the best effect's gain refuse the campaign as it is."""
        p = self.baseline.p_value
        return p is not None and p >= ACCEPTABLE_P and self.p_of_best_gain >= ACCEPTABLE_P

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """All that may explain the readings."""
        pairs = () if self.pairs is None else self.pairs.order
        of_effects = [(), *self.singles.order, *pairs]
        return [
            *map(self._of_effects, of_effects),
            *(hypothesis for hypothesis, _ in self.instrument),
            *self.unknown_causes,
        ]

    def _of_effects(self, effects: tuple[str, ...]) -> Hypothesis:
        explanations = self.explanations
        common = RIVALS.common_to_pairs if len(effects) > 1 else 0.0
        return Hypothesis(
            explanations.evidence(effects), explanations.log_odds(effects), effects, common=common
        )

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """Readings that explain the misfit about as well as those that do best."""
        if not self.instrument:
            return ()
        best = self.instrument[0][0].log_weight
        return tuple(
            suspect
            for hypothesis, suspect in self.instrument
            if suspect.p_value is not None
            and suspect.p_value >= JUDGING.barely_explains
            and hypothesis.log_weight > best - JUDGING.rival
        )

    @property
    def single_explains(self) -> bool:
        """Whether an effect alone explains the readings, and no worse than what has no name."""
        order = self.singles.order
        return bool(order) and self._names(order[0]) and explains(self.singles.best, ACCEPTABLE_P)

    def _names(self, effects: tuple[str, ...]) -> bool:
        """Whether effects are likelier than anything that has no name."""
        weights = [each.log_weight for each in self.unknown_causes]
        return not weights or self._of_effects(effects).log_weight >= float(logsumexp(weights))

    @cached_property
    def verdict(self) -> Verdict:
        """What is said of the campaign."""
        baseline, suspects = self.baseline, self.suspects
        if self.is_adequate:
            return Verdict(
                ADEQUATE,
                f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom ("
                f"{p_equals(baseline.p_value)}), and no effect gains more than chance would ("
                f"{p_equals(self.p_of_best_gain)})",
            )
        ranking, best = self._leading()
        leading = () if ranking is None else ranking.leading()
        if suspects:
            others = [h for h in self.hypotheses if h.effects or h.besides == UNKNOWN]
            rivals = float(logsumexp([each.log_weight for each in others]))
            lead = self.instrument[0][0].log_weight - rivals
            if lead > JUDGING.rival or (lead > 0.0 and not leading):
                return _of_suspects(suspects)
            if lead > -JUDGING.rival and leading:
                return Verdict(
                    AMBIGUOUS,
                    f"{self._titles(leading)} and {suspects[0].words} explain the misfit about "
                    "equally well: check the reading first",
                    leading,
                    suspects,
                )
        if ranking is not None:
            return self._of_leading(ranking)
        return Verdict(
            UNEXPLAINED,
            f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom, and something that "
            "is in no catalogue is likelier than any effect, or two together: of these "
            f"{best.chi2:.3g} for {best.ndf} at best",
        )

    def _of_leading(self, ranking: Ranking) -> Verdict:
        """The verdict where explanations lead: one is missing, several cannot be told apart."""
        leading, best = ranking.leading(), ranking.best
        p = best.p_value
        quality = f"chi2 = {best.chi2:.3g} for {best.ndf} degrees of freedom"
        quality += f" ({p_equals(p)})" if p is not None else ""
        if len(leading) == 1:
            reason = f"{self._titles(leading)} explains the misfit: {quality}"
            unknown, others = (
                [h.log_weight for h in self.hypotheses if (h.besides == UNKNOWN) is of_none]
                for of_none in (True, False)
            )
            if unknown and logsumexp(unknown) - logsumexp(others) > -JUDGING.doubt:
                reason += "; but so may something that is in no catalogue"
                return Verdict(AMBIGUOUS, reason, leading)
            return Verdict(MISSING_EFFECT, reason, leading)
        unsettled = ranking.unsettled()
        near = tuple(each for each in leading if each not in unsettled)
        if len(near) > 1:
            reason = (
                f"the readings cannot tell apart {self._titles(near)}: {quality} with the first"
            )
        else:
            reason = f"{self._titles(near)} explains the misfit: {quality}"
        if unsettled:
            reason += f"; more photons would tell whether {self._titles(unsettled)} may as well"
        return Verdict(AMBIGUOUS, reason, leading, unsettled=unsettled)

    def _titles(self, leading: tuple[tuple[str, ...], ...]) -> str:
        """What leads, in words; of many the likeliest: the ranking has them all."""
        *first, last = map(self.explanations.title, leading)
        if len(leading) > JUDGING.most_named:
            first, last = first[: JUDGING.most_named], f"{len(leading) - JUDGING.most_named} others"
        return f"{', '.join(first)} and {last}" if first else last

    def _leading(self) -> tuple[Ranking | None, Minimum]:
        """Which explanations lead, if any do, and of all effects the fit that does best.

        First single effects, then pairs, where these were needed and tried: those lead of which the
        best has a name and fits well enough.
        """
        singles, pairs, best = self.singles, self.pairs, self.baseline
        significant = self.p_of_best_gain < ACCEPTABLE_P
        needs_pairs = pairs is not None and self._needs(pairs)
        if singles.order:
            best = singles.best
            level = JUDGING.barely_explains if pairs is not None else ACCEPTABLE_P
            named = self._names(singles.order[0])
            if significant and not needs_pairs and named and explains(best, level):
                return singles, best
        if pairs is not None and pairs.order:
            best = pairs.best
            named = self._names(pairs.order[0])
            if needs_pairs and named and explains(best, JUDGING.pair_explains):
                return pairs, best
        return None, best

    def _needs(self, pairs: Ranking) -> bool:
        """Whether two effects explain the readings significantly better than the best one alone.

        Asked where that one leaves a p-value below 0.01. The gain is corrected for the number of
        partners, or of all pairs where the best does without the best single effect.
        """
        if not pairs.order:
            return False
        alone, best = self.singles.best, pairs.best
        if not explains(alone, JUDGING.barely_explains):
            return True
        order = self.singles.order
        tries = len(order) if order[0][0] in pairs.order[0] else math.comb(len(order), 2)
        further = max(len(best.names) - len(alone.names), 1)
        gain = max(alone.chi2 - best.chi2, 0.0)
        return corrected(float(chdtrc(further, gain)), tries) < ACCEPTABLE_P

    def chain(self) -> tuple[str, ...]:
        """Effects that together explain the readings where no two do; empty if none do.

        One after the other, from the best pair on, while its gain is significant, and it explains
        what was not explained or the error on readings left out falls.
        """
        explanations, null, pairs = self.explanations, self.null, self.pairs
        chosen = pairs.order[0] if pairs is not None and pairs.order else self.singles.order[0]
        while len(chosen) < JUDGING.most_effects:
            ranked = explanations.ranked_further(chosen)
            if not ranked:
                break
            now, best = explanations.fit(chosen), explanations.fit(ranked[0])
            further = ranked[0][-1]
            significant = null.p_of_best(further, now.chi2 - best.chi2) < JUDGING.significant
            if not (significant and _justified(now, best)):
                break
            chosen = (*chosen, further)
        return chosen if explains(explanations.fit(chosen), JUDGING.pair_explains) else ()


def explains(fit: Minimum, level: float) -> bool:
    """Whether a fit leaves nothing to explain, as far as its readings can tell."""
    p = fit.p_value
    return fit.chi2 < 1.0 if p is None else p >= level


def _of_suspects(suspects: tuple[Suspect, ...]) -> Verdict:
    """The verdict where wrong readings explain the misfit better than physics."""
    others = f", or {suspects[1].words}" if len(suspects) > 1 else ""
    return Verdict(
        UNEXPLAINED,
        f"{suspects[0].words}{others} explains the misfit better than any effect: check that "
        "before physics is blamed",
        suspects=suspects,
    )


def _justified(now: Minimum, more: Minimum) -> bool:
    """Whether a fit with more effects is worth them.

    It is where it explains what was not explained; else the error on readings left out must fall.
    A reading that alone holds a new parameter has a large one, however right the effect.
    """
    if explains(more, ACCEPTABLE_P) and not explains(now, ACCEPTABLE_P):
        return True
    return left_out_error(more) < left_out_error(now)
