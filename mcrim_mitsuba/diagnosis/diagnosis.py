"""The front door: which effects of a catalogue explain a campaign's misfit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from mcrim_mitsuba.diagnosis.candidates import CandidateMaker
from mcrim_mitsuba.diagnosis.comparison import comparison_of
from mcrim_mitsuba.diagnosis.explanations import Explanations, Models, plausible_ranges
from mcrim_mitsuba.diagnosis.limits import upper_limits
from mcrim_mitsuba.diagnosis.next_measurements import Proposals, next_measurements
from mcrim_mitsuba.diagnosis.null import BaselineFrame, NullDistribution, curve_of
from mcrim_mitsuba.diagnosis.ranking import Ranking
from mcrim_mitsuba.diagnosis.repair import choose_effects, steps
from mcrim_mitsuba.diagnosis.result import (
    ADEQUATE,
    UNEXPLAINED,
    Candidate,
    Diagnosis,
    NextMeasurement,
)
from mcrim_mitsuba.diagnosis.suspects import find_suspects
from mcrim_mitsuba.diagnosis.verdict import (
    first_verdict,
    last_verdict,
    pairs_are_needed,
    too_few_readings,
    verdict_of_more,
)
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.files.campaign import LightYieldInput
from mcrim_mitsuba.files.values import Value

# Leading explanations that further measurements are to tell apart: each costs simulations.
_MOST_RIVALS = 3


def diagnose(
    models: Models,
    effects: Mapping[str, Effect],
    *,
    present: tuple[str, ...] = (),
    scene: Mapping[str, Value] | None = None,
    light_yield: LightYieldInput | None = None,
    proposals: Proposals | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Rank a catalogue's effects as explanations of a campaign's misfit.

    Parameters
    ----------
    models : callable
        ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple
        of names) besides its own; with the interface of `fit.model.CampaignModel`, and if it has
        ``eta_batches(theta)``, the (batches, readings) deviations of log(eta) in batches of the
        simulation that are common to all models, gains have an error. May raise `InputError` where
        the scene cannot take an effect.
    effects : mapping of str to Effect
        The catalogue.
    present : tuple of str
        Effects that the campaign has already.
    scene : mapping of str to Value, optional
        The scene's parameters; needed for effects with a nominal value.
    light_yield : LightYieldInput, optional
        Turns the scale into photons per keV.
    proposals : Proposals, optional
        What could be measured next.
    seed : int
        Of the campaigns that are drawn to know what chance gains.
    progress : callable, optional
        Told in words what is being done.
    """
    began = time.perf_counter()
    say = progress or (lambda words: None)
    say("fitting the campaign as it is")
    tried = _to_try(effects, present)
    explanations = Explanations(models, tried, scene or {})
    baseline = explanations.baseline
    say("looking for suspect readings")
    suspects = find_suspects(baseline)
    verdict = too_few_readings(baseline)
    chosen: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    pairs: tuple[Candidate, ...] = ()
    limits = {}
    if verdict is None:
        say(f"fitting {len(tried)} effects")
        singles = Ranking(explanations.singles())
        say("drawing what chance would gain")
        frame = BaselineFrame(baseline)
        curves = {name: curve_of(explanations, (name,), name, frame) for name in singles.order}
        null = NullDistribution(curves, seed)
        maker = CandidateMaker(explanations, frame, curves, null, light_yield)
        candidates = maker.singles(singles)
        verdict = first_verdict(explanations, singles, null, suspects)
        of_pairs = None
        if verdict is None:
            say("fitting pairs of effects")
            best_pairs = explanations.ranked_pairs()
            ranked = Ranking({pair: explanations.fit(pair) for pair in best_pairs})
            needed = pairs_are_needed(explanations, singles, ranked)
            pairs = maker.pairs(ranked)
            verdict = last_verdict(explanations, singles, null, ranked, needed)
            of_pairs = ranked if needed else None
        if verdict.word == ADEQUATE:
            say("following limits")
            limits = upper_limits(explanations)
        elif singles.order and not (verdict.word == UNEXPLAINED and verdict.suspects):
            say("repairing")
            chosen = choose_effects(explanations, singles, null, of_pairs)
            if verdict.word == UNEXPLAINED:
                verdict = verdict_of_more(explanations, chosen, verdict)
                # effects that do not explain the readings would only bias what is fitted
                chosen = chosen if verdict.leading else ()
    proposed: tuple[NextMeasurement, ...] = ()
    if proposals is not None and len(verdict.leading) > 1:
        say("looking for what to measure next")
        rivals = verdict.leading[:_MOST_RIVALS]
        proposed = next_measurements(explanations, rivals, proposals)
    plausible = {
        name: ends
        for effect in present
        if effect in effects
        for name, ends in plausible_ranges(effects[effect], scene or {}).items()
    }
    return Diagnosis(
        verdict=verdict.word,
        reason=verdict.reason,
        baseline=comparison_of(baseline, suspects, light_yield, plausible),
        candidates=candidates,
        pairs=pairs,
        leading=tuple(dict.fromkeys(name for group in verdict.leading for name in group)),
        leading_sets=verdict.leading,
        upper_limits=limits,
        suspect_readings=tuple(one.suspect for one in verdict.suspects),
        repair=steps(explanations, chosen, light_yield),
        next_measurements=proposed,
        not_tried=dict(explanations.refused),
        seconds=time.perf_counter() - began,
    )


def _to_try(effects: Mapping, present: tuple[str, ...]) -> dict:
    """Effects that the campaign does not have and that what it has does not exclude."""
    barred = set(present)
    for name in present:
        barred.update(effects[name].excludes if name in effects else ())
    return {
        name: effect
        for name, effect in effects.items()
        if name not in barred and not set(effect.excludes) & set(present)
    }
