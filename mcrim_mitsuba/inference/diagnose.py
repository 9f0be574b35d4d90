"""Which effects of a catalogue explain a campaign's misfit.

The stages: `diagnose` screens (a first look at all effects) and lets `judge` fit, weigh and choose
a repair until all that its judgement rests on was simulated in full; `diagnosis_of` ranks and
advises. Each gives a small record to the next.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.run import one_thread
from mcrim_mitsuba.effects.catalogue import effect_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.responses import Sizes
from mcrim_mitsuba.inference.candidates import (
    Candidate,
    CandidateMaker,
    Limit,
    determined_estimates,
    upper_limits,
)
from mcrim_mitsuba.inference.compare import Comparison, Suspect, comparison_of
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.estimates import (
    LIGHT_YIELD,
    ParameterEstimate,
    error_of_difference,
    left_out_error,
    rms_pull,
)
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING
from mcrim_mitsuba.inference.explanations import Explanations, Models
from mcrim_mitsuba.inference.fit import Calibration, UndeterminedError, fit_model
from mcrim_mitsuba.inference.judgement import (
    ADEQUATE,
    AMBIGUOUS,
    TOO_FEW_READINGS,
    UNEXPLAINED,
    Judgement,
    explains,
)
from mcrim_mitsuba.inference.next_measurements import NextMeasurement, next_measurements
from mcrim_mitsuba.inference.rehearsal import Capability
from mcrim_mitsuba.inference.rival_causes import UNKNOWN
from mcrim_mitsuba.inference.screening import Screened, ScreeningCache, promising_effects
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, EXPLAINING, EXTENT, HYPOTHESES, JUDGING
from mcrim_mitsuba.inference.simulations import (
    CampaignModels,
    CampaignSimulations,
    MeasurementProposals,
    as_numbers,
    not_adding_up,
)
from mcrim_mitsuba.inference.weighing import INSTRUMENT, AveragedYield, weigh_hypotheses
from mcrim_mitsuba.runs.executors import more_units_follow

#: What is told of a diagnosis (`core.run.JobProgress`): its parts, and their usual times, %.
PARTS = (("sim", 18), ("sim", 42), ("sim", 27), ("trying", 4), ("weighing", 6), ("proposed", 3))


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
    """What takes the place of the last step of a repair, by the fit of the mended campaign."""
    squares = [row.pull**2 for row in final.rows if row.use]
    unknown = dict.fromkeys(("added", "left_out_error", "delta_chi2_sigma"))
    fields = {name: getattr(final, name) for name in ("chi2", "ndf", "p_value", "parameters")}
    # without a step of its own it was chosen by hand
    title = f"+ {last.title}, simulated" if last.effects else "all simulated together"
    fields |= {"rms_pull": (sum(squares) / len(squares)) ** 0.5, "title": title}
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

    #: ``none`` where nothing is missing.
    family: str
    #: Of all sets with a member: those of several families add up to more than 1.
    probability: float
    #: Its members in sets of `Diagnosis.probabilities`, the likeliest first.
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
    #: Likely sets of two effects and three, the best first.
    pairs: tuple[Candidate, ...] = ()
    #: Effects that the data cannot tell apart, the best first; of sets, their effects.
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
    #: How likely causes are beside each other, averaged over plausible sizes: ``none``, and several
    #: joined by ``+``, each with what adds nothing to it; all that are not listed are ``others``.
    #: Empty with too few readings.
    probabilities: dict[str, float] = field(default_factory=dict)
    #: By effect, the probability of all sets with it.
    inclusion: dict[str, float] = field(default_factory=dict)
    #: A part of the probability is of sets that were weighed in closed form, and where this is not
    #: exact: what may be wrong with it, in words; else empty.
    caution: str = ""
    #: What such readings could say, whatever they say; None with too few.
    capability: Capability | None = None
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
    sure: float = JUDGING.named,
) -> Diagnosis:
    """Rank the catalogue's effects as explanations of a campaign's misfit.

    Parameters as of the public function `diagnose`; `adding` are the effects of the repair,
    whatever the verdict.

    Raises InputError if a scene is not sound, or the readings do not determine the parameters.
    """
    campaign, run = simulations.campaign, simulations.run
    possible = simulations.possible()
    without, only, adding = (as_numbers(names, possible) for names in (without, only, adding))
    candidates = _candidates(simulations, possible, without, only, adding)
    simulations.simulate()
    run.tell("fitting the campaign as it is", 1, 1)
    baseline = simulations.fit()
    names = tuple(candidates)

    def progress(words: str) -> None:
        run.tell(words, 1, 1)

    cache = ScreeningCache(simulations, names)
    screened = cache.read()
    precise = {**({} if screened is None else screened.precise), **dict.fromkeys(adding)}
    models = _simulated(simulations, names, precise)
    idle = {name for name in names if not models.acts(name)} - {*adding}
    if idle & {*only}:
        problem = f"{', '.join(sorted(idle & {*only}))} changes none of the readings"
        raise InputError(problem, "leave it out", path=campaign.path)
    possible, candidates = (
        {name: effect for name, effect in of.items() if name not in idle}
        for of in (possible, candidates)
    )
    names = tuple(candidates)
    if screened is None:
        run.tell("looking for what deserves more photons", 1, 1)
        screened = Screened(promising_effects(models.model, candidates, baseline.minimum))

    def weighed(models: CampaignModels, pairs: Collection[str]) -> Judged:
        return judge(
            models.model,
            candidates,
            catalogue=possible,
            fit=baseline,
            adding=tuple(dict.fromkeys(adding)),
            together=pairs,
            sure=sure,
            seed=run.seed,
            progress=progress,
        )

    judged, screened = _judged_precisely(simulations, names, screened, adding, weighed)
    # only now: whatever may be measured next is simulated for it
    diagnosis = diagnosis_of(judged, simulations.proposals(), progress=progress)
    refused = simulations.not_tried
    titles = {name: campaign.catalogue[name].title for name in refused}
    diagnosis = replace(
        diagnosis,
        not_tried={**refused, **diagnosis.not_tried},
        titles={**titles, **diagnosis.titles},
    )
    cache.write(screened)
    simulations.notes += _not_adding_up(simulations, judged)
    if diagnosis.caution:
        simulations.notes.append(diagnosis.caution)
    if campaign.next_measurements and diagnosis.verdict not in (AMBIGUOUS, UNEXPLAINED):
        simulations.notes.append(
            "what to measure next is listed only where effects are to be told apart, or where none "
            "explains the readings"
        )
    return diagnosis


def _judged_precisely(
    simulations: CampaignSimulations,
    names: tuple[str, ...],
    screened: Screened,
    adding: Sequence[str],
    weighed: Callable[[CampaignModels, Collection[str]], Judged],
) -> tuple[Judged, Screened]:
    """The judgement of which all that it names had all photons, and what it rests on.

    Pairs of effects are simulated together where no cause alone explains the readings.
    """
    models, first = simulations.models, frozenset(screened.precise)
    precise, pairs, together = dict(screened.precise), set(screened.pairs), True
    while True:
        wanted = {**precise, **dict.fromkeys(adding)}
        if not (models.are_precise(wanted) and pairs <= models.responses.effects.keys()):
            try:
                models = _simulated(simulations, (*names, *sorted(pairs)), wanted)
            except InputError as error:
                if not pairs:
                    raise
                problem = f"pairs of effects could not be simulated together: {error.problem}"
                simulations.notes.append(f"{problem}; what both do is taken for the sum")
                precise = {name: of for name, of in precise.items() if name not in pairs}
                together, pairs = False, set()
                continue
        judged = weighed(models, pairs)
        lacking = {
            name
            for names in judged.rests_on
            for name in names
            if not models.is_precise(name, judged.explanations.fit(names).values)
        }
        if together and not pairs and not lacking:
            pairs = judged.pairs
        likely = pairs & judged.likely_pairs
        if models.precise >= likely and not lacking and pairs <= models.responses.effects.keys():
            return judged, Screened(precise, pairs)
        # what the diagnosis names gets all photons; if that names others again, all effects do
        if lacking:
            precise |= dict.fromkeys(lacking if precise.keys() & {*names} <= first else names)
        precise |= dict.fromkeys(likely)


def _simulated(
    simulations: CampaignSimulations, names: Sequence[str], precise: Mapping[str, Sizes | None]
) -> CampaignModels:
    """Models with effects, and pairs of them, after a look at those that need not be `precise`."""
    near = {name: sizes for name, sizes in precise.items() if sizes is not None}
    return simulations.simulate(names, look={*names} - precise.keys(), near=near)


def _not_adding_up(simulations: CampaignSimulations, judged: Judged) -> list[str]:
    """What is to be said of leading sets of effects that do not fit where they are simulated.

    Sets are weighed by responses of one effect, or two at once, which add up in log(eta).
    """
    leading = () if judged.judgement is None else judged.judgement.verdict.leading
    notes: list[str] = []
    for effects in [names for names in leading if len(names) > 1][: EXTENT.most_together]:
        by_responses = judged.explanations.fit(effects)
        with contextlib.suppress(UndeterminedError):
            fit = simulations.settled_fit(effects, by_responses.values)
            note = not_adding_up(fit.model.campaign.effects, fit.chi2, by_responses.chi2)
            notes += [note] if note else []
    return notes


def _candidates(
    simulations: CampaignSimulations,
    possible: Mapping[str, Effect],
    without: Sequence[str],
    only: Sequence[str],
    adding: Sequence[str],
) -> dict[str, Effect]:
    """Effects that are tried of those possible; none where no degrees of freedom are left to judge.

    What is to be left out, tried alone or added is refused here if that cannot be, and the notes
    tell of it.
    """
    campaign = simulations.campaign
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


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What a campaign's readings say of its explanations."""

    fit: Calibration
    explanations: Explanations
    #: None where no degrees of freedom are left to judge by.
    judgement: Judgement | None
    #: Effects that a repair adds, and those that it would add, were they plausible or sufficient.
    chosen: tuple[str, ...] = ()
    set_aside: tuple[str, ...] = ()
    #: Of the campaigns that are drawn.
    seed: int
    seconds: float

    @property
    def rests_on(self) -> set[tuple[str, ...]]:
        """Sets of effects that it names or counts with."""
        judgement = self.judgement
        if judgement is None or judgement.verdict.word == ADEQUATE:
            return set()
        tried, of_sets = self.explanations.effects, judgement.probabilities.items()
        likely = (key.split(" + ") for key, p in of_sets if p > JUDGING.likely)
        counted = {tuple(name for name in names if name in tried) for names in likely}
        return {*judgement.verdict.leading, self.set_aside, self.chosen, *counted}

    @property
    def pairs(self) -> set[str]:
        """Pairs of the likeliest effects with others, where no cause alone explains the readings.

        All sets are weighed by responses that add up; what two do together may be another thing.
        """
        judgement, explanations = self.judgement, self.explanations
        if judgement is None or explains(judgement.baseline, ACCEPTABLE_P):
            return set()
        verdict, inclusion = judgement.verdict, judgement.weighing.inclusion
        singles = [names for names in verdict.leading[:1] if len(names) == 1]
        if verdict.suspects or any(explains(explanations.fit(n), ACCEPTABLE_P) for n in singles):
            return set()
        effects = [n for n, effect in explanations.effects.items() if effect.edit is not None]
        likely = [name for name in effects if inclusion.get(name, 0.0) > EXTENT.least_of_centre]
        centres = sorted(likely, key=lambda name: -inclusion[name])
        pairs = ((c, n) for c in centres[: EXTENT.most_centres] for n in effects if n != c)
        return {" + ".join(sorted(pair)) for pair in pairs if explanations.possible(pair)}

    @property
    def likely_pairs(self) -> set[str]:
        """Pairs of effects that are likely, or in sets that lead."""
        if self.judgement is None:
            return set()
        weighing, leading = self.judgement.weighing, self.judgement.verdict.leading
        shares = zip(weighing.hypotheses, weighing.shares.tolist(), strict=True)
        likely = [h.effects for h, p in shares if len(h.effects) == 2 and p > JUDGING.likely]
        pairs = (pair for names in (*likely, *leading) for pair in combinations(names, 2))
        return {" + ".join(sorted(pair)) for pair in pairs}


@one_thread()
def judge(
    models: Models,
    effects: Mapping[str, Effect],
    *,
    catalogue: Mapping[str, Effect] | None = None,
    fit: Calibration | None = None,
    adding: tuple[str, ...] = (),
    together: Collection[str] = (),
    sure: float = JUDGING.named,
    seed: int = 0,
    progress: Callable[[str], None] = lambda words: None,
) -> Judged:
    """Which effects explain the readings of models, however these were made.

    ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple of
    names) besides its own; with the interface of `model.Model`, and if it has
    ``eta_batches(theta)``, the (batches, readings) deviations of log(eta) in batches of the
    simulation that are common to all models, gains have an error. It may raise `InputError` where
    the scene cannot take an effect.

    `effects` are tried, of all in the `catalogue` that may be missing (by default the same). `fit`
    is that of the campaign as it is, made here where it is not given. The repair adds `adding`,
    whatever the verdict. Of pairs of effects `together`, such as ``"ground + gap_bubble"``, models
    know more than what each does. A family is named from the probability `sure` on. `seed` is of
    the campaigns that are drawn to know what chance gains, and `progress` is told in words what is
    being done.
    """
    began = time.perf_counter()
    fit = fit_model(models(())) if fit is None else fit
    explanations = Explanations(models, effects, fit.minimum, catalogue=catalogue)
    judgement: Judgement | None = None
    chosen: tuple[str, ...] = ()
    set_aside: tuple[str, ...] = ()
    if fit.ndf > 0:
        pairs = [tuple(pair.split(" + ")) for pair in sorted(together)]
        judgement = _judged(explanations, pairs, seed, sure, progress)
        chosen, set_aside = _repair(judgement, adding, progress)
    return Judged(
        fit=fit,
        explanations=explanations,
        judgement=judgement,
        chosen=chosen,
        set_aside=set_aside,
        seed=seed,
        seconds=time.perf_counter() - began,
    )


@one_thread()
def diagnosis_of(
    judged: Judged,
    proposals: MeasurementProposals | None = None,
    *,
    progress: Callable[[str], None] = lambda words: None,
) -> Diagnosis:
    """The diagnosis of what was judged, with advice where `proposals` may be measured next."""
    began = time.perf_counter()
    fit, explanations, judgement = judged.fit, judged.explanations, judged.judgement
    progress("looking for suspect readings")
    compared = comparison_of(fit)
    titles = {name: effect.title for name, effect in explanations.effects.items()}
    if judgement is None:
        return Diagnosis(
            verdict=TOO_FEW_READINGS,
            reason=f"{fit.minimum.statistic.knowns} readings and priors determine "
            f"{len(fit.names)} free parameters: none is left to check the model with",
            baseline=compared,
            repair=steps(explanations, ()),
            seconds=judged.seconds + time.perf_counter() - began,
            titles=titles,
        )
    verdict, weighing = judgement.verdict, judgement.weighing
    candidates = CandidateMaker(judgement)
    limits = {}
    if verdict.word == ADEQUATE:
        progress("following limits")
        limits = upper_limits(explanations)
    advice: tuple[NextMeasurement, ...] = ()
    if proposals is not None and verdict.word in (AMBIGUOUS, UNEXPLAINED):
        progress("looking for what to measure next")
        advice = next_measurements(judgement, proposals)
    return Diagnosis(
        verdict=verdict.word,
        reason=verdict.reason,
        baseline=compared,
        candidates=candidates.singles(),
        pairs=candidates.larger_sets(),
        leading=tuple(dict.fromkeys(name for group in verdict.leading for name in group)),
        leading_sets=verdict.leading,
        unsettled=verdict.unsettled,
        upper_limits=limits,
        suspect_readings=verdict.suspects,
        repair=steps(explanations, judged.chosen),
        next_measurements=advice,
        not_tried=dict(explanations.refused),
        probabilities=judgement.probabilities,
        inclusion=weighing.inclusion,
        caution=weighing.caution,
        capability=judgement.capability(judged.seed),
        light_yield_averaged=judgement.light_yield,
        seconds=judged.seconds + time.perf_counter() - began,
        families=_families(judgement),
        set_aside=judged.set_aside,
        titles=titles,
    )


def _judged(
    explanations: Explanations,
    pairs: Sequence[tuple[str, ...]],
    seed: int,
    sure: float,
    progress: Callable[[str], None],
) -> Judgement:
    """Every effect fitted, and all sets of causes weighed."""
    progress(f"trying {len(explanations.effects)} effects")
    fits = explanations.singles()
    lowest = min((fit.deviance for fit in fits.values()), default=0.0)
    for name, fit in fits.items():
        explanations.evidence((name,), rough=fit.deviance > lowest + EXPLAINING.hopeless)
    progress("drawing what chance would gain")
    null = NullDistribution(explanations, fits, seed)
    progress("weighing all sets of causes")
    by_pair = {pair: explanations.fit(pair) for pair in pairs}
    lowest = min((fit.deviance for fit in by_pair.values()), default=0.0)
    near = [p for p, fit in by_pair.items() if fit.deviance < lowest + EXPLAINING.hopeless]
    return Judgement(explanations, null, weigh_hypotheses(explanations, null, together=near), sure)


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
    if verdict.word == ADEQUATE or not judgement.singles:
        return (), ()
    if verdict.word == UNEXPLAINED and verdict.suspects:
        return (), ()
    progress("repairing")
    if not verdict.leading:
        # what would be needed: effects that do not explain the readings would only bias what is
        # fitted
        sets = [
            key for key in judgement.larger_sets if explains(explanations.fit(key), ACCEPTABLE_P)
        ]
        return (), sets[0] if sets else ()
    # the one that does more comes first
    best = sorted(verdict.leading[0], key=lambda name: explanations.fit((name,)).chi2)
    chosen = tuple(best)
    return (chosen, ()) if explanations.is_plausible(chosen) else ((), chosen)


def _families(judgement: Judgement) -> tuple[FamilyProbability, ...]:
    """Probabilities by family, the likeliest first: relatives among effects, or readings."""
    effects = judgement.explanations.effects
    members: dict[str, dict[str, None]] = {}
    listed = judgement.probabilities
    for hypothesis in (head for head, _ in judgement.groups if head.name in listed):
        for effect in hypothesis.effects:
            members.setdefault(effects[effect].family, {})[effect] = None
        for cause in hypothesis.besides:
            if cause != UNKNOWN:
                members.setdefault(INSTRUMENT, {})[cause] = None
    return tuple(
        FamilyProbability(family, p, tuple(members.get(family, ())))
        for family, p in judgement.weighing.families.items()
        if p >= HYPOTHESES.listed or family == NOTHING_MISSING
    )
