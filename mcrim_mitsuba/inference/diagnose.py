"""Which effects of a catalogue explain a campaign's misfit.

The stages: `diagnose` screens (a first look at all effects) and repeats what follows until all
that it rests on was simulated in full; `diagnose_models` fits and judges (`_judged`), weighs,
repairs and advises. Each gives a small record to the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.effects.catalogue import effect_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.candidates import (
    Candidate,
    CandidateMaker,
    Limit,
    determined_estimates,
    upper_limits,
)
from mcrim_mitsuba.inference.compare import Comparison, Suspect, comparison_of
from mcrim_mitsuba.inference.estimates import (
    LIGHT_YIELD,
    ParameterEstimate,
    error_of_difference,
    left_out_error,
    rms_pull,
)
from mcrim_mitsuba.inference.evidence import (
    NOTHING_MISSING,
    AveragedYield,
    Hypothesis,
    Weighing,
    weigh,
)
from mcrim_mitsuba.inference.explanations import Explanations, Models, NullDistribution, Ranking
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.judgement import (
    ADEQUATE,
    AMBIGUOUS,
    TOO_FEW_READINGS,
    UNEXPLAINED,
    Judgement,
)
from mcrim_mitsuba.inference.next_measurements import NextMeasurement, next_measurements
from mcrim_mitsuba.inference.rival_causes import UNKNOWN, bad_readings, unknown_cause
from mcrim_mitsuba.inference.screening import ScreeningCache, promising_effects
from mcrim_mitsuba.inference.settings import JUDGING
from mcrim_mitsuba.inference.simulations import CampaignSimulations, MeasurementProposals
from mcrim_mitsuba.runs.executors import more_units_follow

#: The family of wrong readings.
INSTRUMENT = "instrument"

# ---- the steps of a repair ----


@dataclass(frozen=True)
class RepairStep:
    """One step of the repair."""

    step: int
    #: The effect; None for the campaign as it came.
    added: str | None
    #: All added so far.
    effects: tuple[str, ...]
    #: Of the fit.
    chi2: float
    ndf: int
    p_value: float | None
    rms_pull: float
    left_out_error: float
    #: Simulation's error of chi2's fall in this step.
    delta_chi2_sigma: float
    parameters: dict[str, ParameterEstimate]
    #: ``value`` and ``sigma``.
    light_yield_ph_per_keV: dict[str, float] | None
    #: The effect in words.
    title: str = ""


class FinalStep(RepairStep):
    """All effects simulated together where the fit ended; steps add their responses."""


def final_step(last: RepairStep, final: Calibration) -> FinalStep:
    """What follows the last step of a repair, by the fit of the mended campaign."""
    squares = [row.pull**2 for row in final.rows if row.use]
    unknown = dict.fromkeys(("added", "left_out_error", "delta_chi2_sigma"))
    fields = {name: getattr(final, name) for name in ("chi2", "ndf", "p_value", "parameters")}
    fields |= {"rms_pull": (sum(squares) / len(squares)) ** 0.5, "title": "all simulated together"}
    return FinalStep(**vars(last) | unknown | fields)


def steps(explanations: Explanations, chosen: tuple[str, ...]) -> tuple[RepairStep, ...]:
    """The campaign as it came, then with one effect after the other."""
    made = []
    before = explanations.baseline
    for count in range(len(chosen) + 1):
        effects = chosen[:count]
        fit = explanations.fit(effects)
        parameters = determined_estimates(fit, explanations.evidence(effects))
        of_light = parameters.get(LIGHT_YIELD)
        made.append(
            RepairStep(
                step=count,
                added=effects[-1] if effects else None,
                effects=effects,
                chi2=fit.chi2,
                ndf=fit.ndf,
                p_value=fit.p_value,
                rms_pull=rms_pull(fit),
                left_out_error=left_out_error(fit),
                delta_chi2_sigma=error_of_difference(fit, before),
                parameters=parameters,
                light_yield_ph_per_keV=(
                    {"value": of_light.value, "sigma": of_light.sigma} if of_light else None
                ),
                title=explanations.title(effects[-1:]),
            )
        )
        before = fit
    return tuple(made)


# ---- the whole ----


@dataclass(frozen=True)
class FamilyProbability:
    """How likely it is that something of a family is missing: its effects are relatives."""

    #: ``none`` where nothing is missing; of a pair of two families both, joined by ``+``.
    family: str
    probability: float
    #: Those of `Diagnosis.probabilities`, the likeliest first.
    effects: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why a campaign does not fit, as far as its readings tell."""

    #: ``adequate``, ``missing_effect``, ``ambiguous``, ``unexplained``, ``too_few_readings``.
    verdict: str
    #: In a sentence.
    reason: str
    #: The campaign as it is.
    baseline: Comparison
    #: Every effect alone, the best first.
    candidates: tuple[Candidate, ...] = ()
    #: The best pairs, where no effect alone suffices; the best first.
    pairs: tuple[Candidate, ...] = ()
    #: Effects that the data cannot tell apart, the best first; of pairs, their effects.
    leading: tuple[str, ...] = ()
    #: The same as sets that each explain the data, or may do so: see `unsettled`.
    leading_sets: tuple[tuple[str, ...], ...] = ()
    #: Where the data are adequate.
    upper_limits: dict[str, Limit] = field(default_factory=dict)
    suspect_readings: tuple[Suspect, ...] = ()
    repair: tuple[RepairStep, ...]
    next_measurements: tuple[NextMeasurement, ...] = ()
    #: Effects that could not be fitted, with the reason.
    not_tried: dict[str, str] = field(default_factory=dict)
    #: How likely the sets of effects that were fitted are beside each other, averaged over
    #: plausible sizes, ``none`` among them; pairs joined by ``+``. Empty with too few readings.
    probabilities: dict[str, float] = field(default_factory=dict)
    #: Averaged over all of these; None where the campaign does not say how to get it.
    light_yield_averaged: AveragedYield | None = None
    #: Wall time.
    seconds: float
    #: The same probabilities by family, the likeliest first.
    families: tuple[FamilyProbability, ...] = ()
    #: What a repair would add, were its size one that a laboratory meets.
    set_aside: tuple[str, ...] = ()
    #: The effects that are named, in words.
    titles: dict[str, str] = field(default_factory=dict)
    #: Sets among the leading ones that are far behind the best, but within the simulation's error.
    unsettled: tuple[tuple[str, ...], ...] = ()

    def candidate(self, effects: Collection[str]) -> Candidate | None:
        """The effect or the pair that these effects are, if it was fitted."""
        tried = (*self.candidates, *self.pairs)
        return next((fit for fit in tried if set(fit.effects) == set(effects)), None)


@more_units_follow()
def diagnose(
    simulations: CampaignSimulations,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    adding: Sequence[str] = (),
) -> Diagnosis:
    """Rank the catalogue's effects as explanations of a campaign's misfit.

    Parameters as of the public function `diagnose`; `adding` are the effects of the repair,
    whatever the verdict.

    Raises InputError if a scene is not sound, or the readings do not determine the parameters.
    """
    campaign, run = simulations.campaign, simulations.run
    candidates = _candidates(simulations, without, only, adding)
    simulations.simulate()
    run.tell("fitting the campaign as it is", 1, 1)
    baseline = simulations.fit()
    names = tuple(candidates)
    screened = ScreeningCache(simulations, names)
    precise = screened.read()
    if precise is None:
        models = simulations.simulate(names, look=set(names) - {*adding})
        run.tell("looking for what deserves more photons", 1, 1)
        precise = promising_effects(models.model, candidates, baseline.minimum)
    first = frozenset(precise)
    while True:
        models = simulations.simulate(names, look=set(names) - {*precise, *adding})
        diagnosis = diagnose_models(
            models.model,
            candidates,
            fit=baseline,
            proposals=simulations.proposals(),
            adding=tuple(dict.fromkeys(adding)),
            seed=run.seed,
            progress=lambda words: run.tell(words, 1, 1),
        )
        if models.precise >= (named := _rests_on(diagnosis, names)):
            break
        # what the diagnosis names gets all photons; if that names others again, all effects do
        precise |= named if precise <= first else set(names)
    screened.write(precise)
    if campaign.next_measurements and diagnosis.verdict not in (AMBIGUOUS, UNEXPLAINED):
        simulations.notes.append(
            "what to measure next is listed only where effects are to be told apart, or where none "
            "explains the readings"
        )
    return diagnosis


def _candidates(
    simulations: CampaignSimulations,
    without: Sequence[str],
    only: Sequence[str],
    adding: Sequence[str],
) -> dict[str, Effect]:
    """Effects that are tried; none without degrees of freedom, where nothing can be judged.

    What is to be left out, tried alone or added is refused here if that cannot be, and the notes
    tell of it.
    """
    campaign = simulations.campaign
    possible = simulations.possible()
    tried = _tried(possible, campaign, without, only)
    if adding:  # refuses what cannot be added
        _tried(possible, campaign, (), adding)
        campaign.with_effects(adding)
    if campaign.ndf <= 0:
        if adding:
            problem = "no reading is left over that an effect could be added for"
            raise InputError(problem, "measure more configurations", path=campaign.path)
        tried = {}
    if only:
        simulations.notes.append(f"probabilities are among those tried, {', '.join(tried)}")
    elif without:
        left_out = ", ".join(dict.fromkeys(without))
        simulations.notes.append(f"left out of the diagnosis: {left_out}")
    return tried


def _tried(
    possible: Mapping[str, Effect], campaign: Campaign, without: Sequence[str], only: Sequence[str]
) -> dict[str, Effect]:
    """Of the `possible` effects, which could be missing, `only` these or all, `without` others.

    Raises InputError if one of them is not known or not possible, or none is left.
    """
    for name in (*without, *only):
        effect_of(name, campaign.catalogue)
    for name in only:
        if name not in possible:
            problem = f"{name} is there already, or the scene cannot take it"
            raise InputError(problem, did_you_mean(name, possible), path=campaign.path)
    wanted = set(only or possible) - set(without)
    if possible and not wanted:
        raise InputError("no effect is left to be tried", "leave out fewer")
    return {name: effect for name, effect in possible.items() if name in wanted}


def _rests_on(diagnosis: Diagnosis, tried: Collection[str]) -> set[str]:
    """Effects that a diagnosis names or counts with."""
    if diagnosis.verdict == ADEQUATE:
        return set()
    likely = {key for key, p in diagnosis.probabilities.items() if p > JUDGING.likely}
    counted = {name for key in likely for name in key.split(" + ")} & set(tried)
    added = {name for step in diagnosis.repair for name in step.effects}
    return {*diagnosis.leading, *diagnosis.set_aside, *counted, *added}


def diagnose_models(
    models: Models,
    effects: Mapping[str, Effect],
    *,
    fit: Calibration | None = None,
    proposals: MeasurementProposals | None = None,
    adding: tuple[str, ...] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda words: None,
) -> Diagnosis:
    """The diagnosis of models, however they were made.

    ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple of
    names) besides its own; with the interface of `model.Model`, and if it has
    ``eta_batches(theta)``, the (batches, readings) deviations of log(eta) in batches of the
    simulation that are common to all models, gains have an error. It may raise `InputError` where
    the scene cannot take an effect.

    `effects` may be missing, and `proposals` be measured next. `fit` is that of the campaign as it
    is, made here where it is not given. The repair adds `adding`, whatever the verdict. `seed` is
    of the campaigns that are drawn to know what chance gains, and `progress` is told in words what
    is being done.
    """
    began = time.perf_counter()
    fit = fit_model(models(())) if fit is None else fit
    explanations = Explanations(models, effects, fit.minimum)
    progress("looking for suspect readings")
    compared = comparison_of(fit)
    titles = {name: effect.title for name, effect in effects.items()}
    if fit.ndf <= 0:
        return Diagnosis(
            verdict=TOO_FEW_READINGS,
            reason=f"{fit.minimum.statistic.knowns} readings and priors determine "
            f"{len(fit.names)} free parameters: none is left to check the model with",
            baseline=compared,
            repair=steps(explanations, ()),
            seconds=time.perf_counter() - began,
            titles=titles,
        )
    judgement = _judged(explanations, seed, progress)
    verdict, hypotheses = judgement.verdict, judgement.hypotheses
    candidates = CandidateMaker(judgement)
    weighing = weigh(hypotheses, fit.model.campaign.light_yield)
    limits = {}
    if verdict.word == ADEQUATE:
        progress("following limits")
        limits = upper_limits(explanations)
    chosen, set_aside = _repair(judgement, adding, progress)
    advice: tuple[NextMeasurement, ...] = ()
    if proposals is not None and verdict.word in (AMBIGUOUS, UNEXPLAINED):
        progress("looking for what to measure next")
        advice = next_measurements(explanations, verdict.leading, hypotheses, proposals)
    return Diagnosis(
        verdict=verdict.word,
        reason=verdict.reason,
        baseline=compared,
        candidates=candidates.singles(),
        pairs=candidates.pairs(),
        leading=tuple(dict.fromkeys(name for group in verdict.leading for name in group)),
        leading_sets=verdict.leading,
        unsettled=verdict.unsettled,
        upper_limits=limits,
        suspect_readings=verdict.suspects,
        repair=steps(explanations, chosen),
        next_measurements=advice,
        not_tried=dict(explanations.refused),
        probabilities=dict(sorted(weighing.probabilities.items(), key=lambda item: -item[1])),
        light_yield_averaged=weighing.light_yield,
        seconds=time.perf_counter() - began,
        families=_families(hypotheses, weighing, explanations),
        set_aside=set_aside,
        titles=titles,
    )


def _judged(explanations: Explanations, seed: int, progress: Callable[[str], None]) -> Judgement:
    """Every effect fitted, pairs where no effect alone suffices, and what else there may be."""
    progress(f"fitting {len(explanations.effects)} effects")
    alone = [(name,) for name in explanations.singles()]
    progress("averaging over plausible sizes")
    singles = Ranking(explanations, alone)
    progress("drawing what chance would gain")
    null = NullDistribution(explanations, [name for (name,) in singles.order], seed)
    judgement = Judgement(explanations, singles, null)
    if judgement.is_adequate:
        return replace(judgement, unknown_causes=unknown_cause(explanations, ()))
    progress("looking for what is no effect")
    judgement = replace(
        judgement,
        instrument=bad_readings(explanations),
        unknown_causes=unknown_cause(explanations, singles.order),
    )
    if judgement.single_explains:
        return judgement
    progress("fitting pairs of effects")
    return replace(judgement, pairs=Ranking(explanations, explanations.ranked_pairs()))


def _repair(
    judgement: Judgement, adding: tuple[str, ...], progress: Callable[[str], None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Effects that a repair adds, and those that it would add, were they plausible or sufficient.

    Raises InputError if effects that are to be added whatever the verdict cannot be fitted.
    """
    explanations, verdict = judgement.explanations, judgement.verdict
    if adding:
        if not explanations.possible(adding):
            problem = f"{', '.join(adding)} cannot be fitted to these readings"
            raise InputError(problem, "choose fewer, or others")
        return adding, ()
    if verdict.word == ADEQUATE or not judgement.singles.order:
        return (), ()
    if verdict.word == UNEXPLAINED and verdict.suspects:
        return (), ()
    progress("repairing")
    if not verdict.leading:
        # what would be needed: effects that do not explain the readings would only bias what is
        # fitted
        return (), judgement.chain()
    # the one that does more comes first
    best = sorted(verdict.leading[0], key=lambda name: explanations.fit((name,)).chi2)
    chosen = tuple(best)
    return (chosen, ()) if explanations.is_plausible(chosen) else ((), chosen)


def _families(
    hypotheses: Sequence[Hypothesis], weighed: Weighing, explanations: Explanations
) -> tuple[FamilyProbability, ...]:
    """Probabilities by family, the likeliest first: relatives among effects, or readings."""
    members: dict[str, list[tuple[float, str]]] = {}
    # hypotheses of one name, such as sizes of an unknown cause, are weighed together
    for name, hypothesis in {hypothesis.name: hypothesis for hypothesis in hypotheses}.items():
        family = NOTHING_MISSING
        if hypothesis.besides:
            family = UNKNOWN if hypothesis.besides == UNKNOWN else INSTRUMENT
        elif hypothesis.effects:
            family = explanations.family(hypothesis.effects)
        members.setdefault(family, []).append((weighed.probabilities[name], name))
    families = (
        FamilyProbability(
            family,
            sum(p for p, _ in weighed_names),
            tuple(n for _, n in sorted(weighed_names, reverse=True) if n != NOTHING_MISSING),
        )
        for family, weighed_names in members.items()
    )
    return tuple(sorted(families, key=lambda family: -family.probability))
