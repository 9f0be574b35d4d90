"""Which effects of a catalogue explain a campaign's misfit: simulate, fit, rank, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.campaign.campaign import Campaign, LightYieldInput, as_campaign
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.candidates import (
    Candidate,
    CandidateMaker,
    Limit,
    MeasurementProposals,
    NextMeasurement,
    next_measurements,
    upper_limits,
)
from mcrim_mitsuba.inference.compare import Comparison, Suspect, comparison_of
from mcrim_mitsuba.inference.estimates import Ranking
from mcrim_mitsuba.inference.explanations import (
    Explanations,
    Models,
    NullDistribution,
    plausible_ranges,
)
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.verdict import (
    ADEQUATE,
    UNEXPLAINED,
    Evidence,
    RepairStep,
    steps,
    too_few_readings,
)
from mcrim_mitsuba.inference.workbench import Workbench

# Leading explanations that further measurements are to tell apart: each costs simulations.
_MOST_RIVALS = 3


@dataclass(frozen=True)
class Diagnosis:
    """Why a campaign does not fit, as far as its readings tell."""

    #: ``adequate``, ``missing_effect``, ``ambiguous``, ``unexplained``, ``too_few_readings``.
    verdict: str
    #: In a sentence.
    reason: str
    #: The campaign as it is.
    baseline: Comparison
    #: Every effect alone, the best first.
    candidates: tuple[Candidate, ...]
    #: The best pairs, where no effect alone suffices; the best first.
    pairs: tuple[Candidate, ...]
    #: Effects that the data cannot tell apart, the best first; of pairs, their effects.
    leading: tuple[str, ...]
    #: The same as sets that each explain the data.
    leading_sets: tuple[tuple[str, ...], ...]
    #: Where the data are adequate.
    upper_limits: dict[str, Limit]
    suspect_readings: tuple[Suspect, ...]
    repair: tuple[RepairStep, ...]
    next_measurements: tuple[NextMeasurement, ...]
    #: Effects that could not be fitted, with the reason.
    not_tried: dict[str, str]
    #: Wall time.
    seconds: float


@dataclass(frozen=True)
class Diagnosed:
    """What explains a campaign's misfit."""

    #: Of the campaign as it is.
    baseline: Calibration
    diagnosis: Diagnosis
    provenance: Provenance


def diagnose(campaign: str | Path | Campaign, *, run: Run = Run()) -> Diagnosed:
    """Rank the catalogue's effects as explanations of a campaign's misfit.

    Parameters and errors as for `compare`.
    """
    return diagnose_on(Workbench(as_campaign(campaign), run))


def diagnose_on(bench: Workbench) -> Diagnosed:
    """`diagnose` with a workbench that can be used further."""
    campaign = bench.campaign
    # without degrees of freedom nothing can be judged: spare the simulations
    if campaign.ndf > 0:
        bench.candidates = bench.possible()
    bench.simulate(tuple(bench.candidates))
    found = diagnose_models(
        bench.model,
        {effect.name: effect for effect in campaign.switched_on} | bench.candidates,
        present=campaign.effects,
        scene=campaign.scene.parameters,
        light_yield=campaign.light_yield,
        proposals=bench.proposals(),
        seed=bench.run.seed,
        progress=lambda words: bench.run.tell(words, 1, 1),
    )
    return Diagnosed(fit_model(bench.model(), profile=False), found, bench.provenance())


def diagnose_models(
    models: Models,
    effects: Mapping[str, Effect],
    *,
    present: tuple[str, ...] = (),
    scene: Mapping[str, Value] | None = None,
    light_yield: LightYieldInput | None = None,
    proposals: MeasurementProposals | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Rank a catalogue's effects as explanations of a campaign's misfit.

    Parameters
    ----------
    models : callable
        ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple
        of names) besides its own; with the interface of `model.CampaignModel`, and if it has
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
    proposals : MeasurementProposals, optional
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
    own = [effects[name] for name in present if name in effects]
    compared = comparison_of(baseline, light_yield, plausible_ranges(own, scene or {}))
    judged = too_few_readings(baseline)
    chosen: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    pairs: tuple[Candidate, ...] = ()
    limits = {}
    if judged is None:
        say(f"fitting {len(tried)} effects")
        singles = Ranking({(name,): fit for name, fit in explanations.singles().items()})
        say("drawing what chance would gain")
        null = NullDistribution(explanations, [name for (name,) in singles.order], seed)
        maker = CandidateMaker(explanations, null, light_yield)
        candidates = maker.singles(singles)
        evidence = Evidence(explanations, singles, null, compared.suspects)
        judged = evidence.first_verdict()
        of_pairs = None
        if judged is None:
            say("fitting pairs of effects")
            best_pairs = explanations.ranked_pairs()
            ranked = Ranking({pair: explanations.fit(pair) for pair in best_pairs})
            pairs = maker.pairs(ranked)
            judged = evidence.last_verdict(ranked)
            of_pairs = ranked if evidence.needs(ranked) else None
        if judged.word == ADEQUATE:
            say("following limits")
            limits = upper_limits(explanations)
        elif singles.order and not (judged.word == UNEXPLAINED and judged.suspects):
            say("repairing")
            chosen = evidence.effects_to_add(of_pairs)
            if judged.word == UNEXPLAINED:
                judged = evidence.verdict_of_more(chosen, judged)
                # effects that do not explain the readings would only bias what is fitted
                chosen = chosen if judged.leading else ()
    proposed: tuple[NextMeasurement, ...] = ()
    if proposals is not None and len(judged.leading) > 1:
        say("looking for what to measure next")
        rivals = judged.leading[:_MOST_RIVALS]
        proposed = next_measurements(explanations, rivals, proposals)
    return Diagnosis(
        verdict=judged.word,
        reason=judged.reason,
        baseline=compared,
        candidates=candidates,
        pairs=pairs,
        leading=tuple(dict.fromkeys(name for group in judged.leading for name in group)),
        leading_sets=judged.leading,
        upper_limits=limits,
        suspect_readings=judged.suspects,
        repair=steps(explanations, chosen, light_yield),
        next_measurements=proposed,
        not_tried=dict(explanations.refused),
        seconds=time.perf_counter() - began,
    )


def _to_try(effects: Mapping, present: tuple[str, ...]) -> dict:
    """Effects that the campaign does not have and that what it has does not exclude."""
    barred = set(present).union(*(effects[name].excludes for name in present if name in effects))
    return {
        name: effect
        for name, effect in effects.items()
        if name not in barred and not set(effect.excludes) & set(present)
    }
