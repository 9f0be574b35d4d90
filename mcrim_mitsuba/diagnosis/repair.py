"""Adds effects while the data justify it."""

from __future__ import annotations

from mcrim_mitsuba.diagnosis import statistics
from mcrim_mitsuba.diagnosis.estimates import estimates
from mcrim_mitsuba.diagnosis.explanations import Explanations
from mcrim_mitsuba.diagnosis.null import NullDistribution
from mcrim_mitsuba.diagnosis.ranking import Ranking, error_of_difference
from mcrim_mitsuba.diagnosis.result import RepairStep
from mcrim_mitsuba.diagnosis.solver import Fit
from mcrim_mitsuba.diagnosis.suspects import EXPLAINS
from mcrim_mitsuba.diagnosis.verdict import explains
from mcrim_mitsuba.files.campaign import LightYieldInput
from mcrim_mitsuba.fit.result import LIGHT_YIELD

# A further effect must gain what chance gives the best of all effects this rarely.
_SIGNIFICANT = 0.01

# Effects added at most.
_MOST_EFFECTS = 4


def choose_effects(
    explanations: Explanations,
    singles: Ranking,
    null: NullDistribution,
    pairs: Ranking | None,
) -> tuple[str, ...]:
    """Effects to add to a campaign that does not fit, in this order.

    The best effect alone if its gain is significant; where it leaves a misfit, the best pair. A
    further one only if its gain is significant, and it explains what was not explained or the error
    on readings left out falls.

    Parameters
    ----------
    explanations : Explanations
    singles : Ranking
        Of single effects, one at least.
    null : NullDistribution
    pairs : Ranking or None
        Of pairs, where no effect alone explains the readings.
    """
    chosen: tuple[str, ...] = (singles.order[0],)
    gain = explanations.baseline.chi2 - explanations.fit(chosen).chi2
    if pairs is None and null.p_global(gain) >= _SIGNIFICANT:
        return ()
    if pairs is not None and pairs.order:
        pair = pairs.order[0]
        if _justified(explanations.fit(chosen), explanations.fit(pair)):
            # the one that does more comes first
            chosen = tuple(sorted(pair, key=lambda name: explanations.fit((name,)).chi2))
    while len(chosen) < _MOST_EFFECTS:
        further = _best_further(explanations, chosen, null)
        if further is None:
            return chosen
        chosen = (*chosen, further)
    return chosen


def _best_further(
    explanations: Explanations, chosen: tuple[str, ...], null: NullDistribution
) -> str | None:
    """The effect most worth adding, if any is."""
    now = explanations.fit(chosen)
    ranked = explanations.ranked_further(chosen)
    if not ranked:
        return None
    best = explanations.fit(ranked[0])
    name = ranked[0][-1]
    significant = null.p_of_best(name, now.chi2 - best.chi2) < _SIGNIFICANT
    return name if significant and _justified(now, best) else None


def _justified(now: Fit, more: Fit) -> bool:
    """Whether a fit with more effects is worth them.

    It is where it explains what was not explained; else the error on readings left out must fall.
    A reading that alone holds a new parameter has a large one, however right the effect.
    """
    if explains(more, EXPLAINS) and not explains(now, EXPLAINS):
        return True
    return statistics.left_out_error(more) < statistics.left_out_error(now)


def steps(
    explanations: Explanations, chosen: tuple[str, ...], light_yield: LightYieldInput | None
) -> tuple[RepairStep, ...]:
    """The campaign as it came, then with one effect after the other."""
    made = []
    before = explanations.baseline
    for count in range(len(chosen) + 1):
        effects = chosen[:count]
        fit = explanations.fit(effects)
        parameters = estimates(fit, light_yield)
        of_light = parameters.get(LIGHT_YIELD)
        made.append(
            RepairStep(
                step=count,
                added=effects[-1] if effects else None,
                effects=effects,
                chi2=fit.chi2,
                ndf=fit.ndf,
                p_value=statistics.p_of_fit(fit),
                rms_pull=statistics.rms_pull(fit),
                left_out_error=statistics.left_out_error(fit),
                delta_chi2_sigma=error_of_difference(fit, before),
                parameters=parameters,
                light_yield_ph_per_keV=(
                    {"value": of_light.value, "sigma": of_light.sigma} if of_light else None
                ),
            )
        )
        before = fit
    return tuple(made)
