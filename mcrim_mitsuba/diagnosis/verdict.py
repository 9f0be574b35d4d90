"""What the fits amount to: one of five verdicts, with the reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import chdtrc

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.null import NullDistribution
from mcrim_mitsuba.diagnosis.ranking import LEADING, Ranking
from mcrim_mitsuba.diagnosis.result import (
    ADEQUATE,
    AMBIGUOUS,
    MISSING_EFFECT,
    TOO_FEW_READINGS,
    UNEXPLAINED,
)
from mcrim_mitsuba.diagnosis.solver import Fit
from mcrim_mitsuba.diagnosis.suspects import EXPLAINS, Alternative

# Adequate: the campaign's own p-value is not below, nor that of the best effect's gain. Together
# they refuse 2 % of campaigns with nothing hidden.
_ADEQUATE = 0.01

# A pair must fit no worse: after it nothing else is tried, so it is given more room.
_PAIR_EXPLAINS = 0.003

# An effect alone that fits no better than 0.01, but no worse than this, still explains the readings
# where no pair is significantly better: with the right effect one campaign in a hundred is such.
_BARELY_EXPLAINS = 1e-4


@dataclass(frozen=True)
class Verdict:
    """A verdict.

    Attributes
    ----------
    word : str
    reason : str
        In a sentence.
    leading : tuple of tuple of str
        Sets of effects that the data cannot tell apart, the best first.
    suspects : tuple of Alternative
        Readings that explain the misfit as well as the leading effects, or better.
    """

    word: str
    reason: str
    leading: tuple[tuple[str, ...], ...] = ()
    suspects: tuple[Alternative, ...] = ()


def too_few_readings(baseline: Fit) -> Verdict | None:
    """The verdict where there are no degrees of freedom to judge by, else None."""
    if baseline.ndf > 0:
        return None
    return Verdict(
        TOO_FEW_READINGS,
        f"{baseline.problem.knowns} readings and priors determine {len(baseline.names)} free "
        "parameters: none is left to check the model with",
    )


def first_verdict(
    explanations: Explanations,
    singles: Ranking,
    null: NullDistribution,
    suspects: list[Alternative],
) -> Verdict | None:
    """The verdict as far as readings and single effects decide; None where pairs must be tried.

    Parameters
    ----------
    explanations : Explanations
    singles : Ranking
        Of the effects alone.
    null : NullDistribution
    suspects : list of Alternative
        The likeliest first.
    """
    baseline = explanations.baseline
    p = statistics.p_of_fit(baseline)
    p_global = p_of_best_gain(explanations, singles, null)
    if p is not None and p >= _ADEQUATE and p_global >= _ADEQUATE:
        return Verdict(
            ADEQUATE,
            f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom (p = {p:.2g}), and "
            f"no effect gains more than chance would (p = {p_global:.2g})",
        )
    leading: tuple[tuple[str, ...], ...] = ()
    of_effects, barely, well = math.inf, False, False
    if singles.order and p_global < _ADEQUATE:
        best = explanations.fit((singles.order[0],))
        leading = tuple((name,) for name in singles.leading())
        of_effects = statistics.criterion(best) + 2.0 * math.log(len(singles.order))
        barely, well = explains(best, _BARELY_EXPLAINS), explains(best, EXPLAINS)
    if suspects:
        lead = of_effects - suspicion(baseline, suspects[0])
        if lead > LEADING or not barely:
            return _of_suspects(suspects)
        if lead >= -LEADING:
            return Verdict(
                AMBIGUOUS,
                f"{_effects(leading)} and {_words(suspects[0])} explain the misfit about equally "
                "well: check the reading first",
                leading,
                tuple(suspects),
            )
    if well:
        return _of_leading(leading, explanations)
    return None


def p_of_best_gain(explanations: Explanations, singles: Ranking, null: NullDistribution) -> float:
    """Probability that chance alone gains as much as the effect that gains most."""
    chi2 = min((explanations.fit((name,)).chi2 for name in singles.order), default=math.inf)
    return null.p_global(explanations.baseline.chi2 - chi2) if singles.order else 1.0


def pairs_are_needed(explanations: Explanations, singles: Ranking, pairs: Ranking) -> bool:
    """Whether two effects explain the readings significantly better than the best one alone.

    Asked where that one leaves a p-value below 0.01. The gain is corrected for the number of
    partners, or of all pairs where the best does without the best single effect.
    """
    if not pairs.order:
        return False
    alone, best = explanations.fit((singles.order[0],)), explanations.fit(pairs.order[0])
    if not explains(alone, _BARELY_EXPLAINS):
        return True
    count = len(singles.order)
    tries = count if singles.order[0] in pairs.order[0] else count * (count - 1) / 2
    further = max(len(best.names) - len(alone.names), 1)
    gain = max(alone.chi2 - best.chi2, 0.0)
    return statistics.corrected(float(chdtrc(further, gain)), tries) < _ADEQUATE


def last_verdict(
    explanations: Explanations,
    singles: Ranking,
    null: NullDistribution,
    pairs: Ranking,
    needed: bool,
) -> Verdict:
    """The verdict where no effect alone explains the readings well, nor a suspect one.

    Parameters
    ----------
    explanations : Explanations
    singles : Ranking
    null : NullDistribution
    pairs : Ranking
    needed : bool
        See `pairs_are_needed`.
    """
    baseline = explanations.baseline
    if not needed:
        significant = p_of_best_gain(explanations, singles, null) < _ADEQUATE
        if significant and explains(explanations.fit((singles.order[0],)), _BARELY_EXPLAINS):
            return _of_leading(tuple((name,) for name in singles.leading()), explanations)
    elif pairs.order and explains(explanations.fit(pairs.order[0]), _PAIR_EXPLAINS):
        return _of_leading(pairs.leading(), explanations)
    order = pairs.order or tuple((name,) for name in singles.order)
    best = explanations.fit(order[0]) if order else baseline
    return Verdict(
        UNEXPLAINED,
        f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom, and no effect of the "
        f"catalogue, nor two together, explain it: {best.chi2:.3g} for {best.ndf} at best",
    )


def suspicion(baseline: Fit, alternative: Alternative) -> float:
    """What compares with `statistics.criterion` of the best effect + 2 log(number of effects).

    2 log(tries) stands for the many ways to suspect a reading.
    """
    chi2 = alternative.suspect.chi2 + baseline.weights.log_determinant
    unknowns = len(baseline.names) + alternative.parameters
    return chi2 + 2.0 * unknowns + 2.0 * math.log(alternative.tries)


def explains(fit: Fit, level: float) -> bool:
    """Whether a fit leaves nothing to explain, as far as its readings can tell."""
    p = statistics.p_of_fit(fit)
    return fit.chi2 < 1.0 if p is None else p >= level


def _of_suspects(suspects: list[Alternative]) -> Verdict:
    others = f", or {_words(suspects[1])}" if len(suspects) > 1 else ""
    return Verdict(
        UNEXPLAINED,
        f"{_words(suspects[0])}{others} explains the misfit better than any effect: check that "
        "before physics is blamed",
        suspects=tuple(suspects),
    )


def _words(alternative: Alternative) -> str:
    suspect = alternative.suspect
    if suspect.kind == "swapped_rows":
        return f"a swap of {' and '.join(suspect.labels)}"
    return f"a bad reading {suspect.labels[0]} ({suspect.pull:+.1f} sigma)"


def _effects(leading: tuple[tuple[str, ...], ...]) -> str:
    return ", ".join(" with ".join(effects) for effects in leading)


def _of_leading(leading: tuple[tuple[str, ...], ...], explanations: Explanations) -> Verdict:
    best = explanations.fit(leading[0])
    p = statistics.p_of_fit(best)
    quality = f"chi2 = {best.chi2:.3g} for {best.ndf} degrees of freedom"
    quality += f" (p = {p:.2g})" if p is not None else ""
    if len(leading) == 1:
        return Verdict(
            MISSING_EFFECT, f"{_effects(leading)} explains the misfit: {quality}", leading
        )
    return Verdict(
        AMBIGUOUS,
        f"the readings cannot tell apart {_effects(leading)}: {quality} with the first",
        leading,
    )


def verdict_of_more(
    explanations: Explanations, chosen: tuple[str, ...], before: Verdict
) -> Verdict:
    """The verdict where no pair explains the readings, but three effects or more may."""
    fit = explanations.fit(chosen)
    p_value = statistics.p_of_fit(fit)
    if len(chosen) < 3 or p_value is None or p_value < _PAIR_EXPLAINS:
        return before
    return Verdict(
        MISSING_EFFECT,
        f"{' + '.join(chosen)} together explain the misfit: chi2 "
        f"{explanations.baseline.chi2:.3g} -> {fit.chi2:.3g} (ndf {fit.ndf}, p = {p_value:.2g}); "
        "nothing less does",
        leading=(tuple(chosen),),
    )
