"""Which effects of a catalogue explain a campaign's misfit: simulate, fit, rank, judge."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from scipy.special import chdtrc, logsumexp

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.rounding import p_equals
from mcrim_mitsuba.core.run import Provenance, Run
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
    ACCEPTABLE_P,
    LIGHT_YIELD,
    ParameterEstimate,
    corrected,
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
from mcrim_mitsuba.inference.explanations import (
    Explanations,
    Models,
    NullDistribution,
    Ranking,
)
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.least_squares import Fit
from mcrim_mitsuba.inference.next_measurements import (
    MeasurementProposals,
    NextMeasurement,
    next_measurements,
)
from mcrim_mitsuba.inference.race import Memory, contenders
from mcrim_mitsuba.inference.unexplained import (
    COMMON_TO_PAIRS,
    UNKNOWN,
    of_instrument,
    unnamed,
)
from mcrim_mitsuba.inference.workbench import Workbench

#: Probability from which an effect counts as one that a diagnosis rests on.
_LIKELY = 0.01
#: The family of wrong readings.
INSTRUMENT = "instrument"
#: The verdicts of a diagnosis.
TOO_FEW_READINGS = "too_few_readings"
ADEQUATE = "adequate"
MISSING_EFFECT = "missing_effect"
AMBIGUOUS = "ambiguous"
UNEXPLAINED = "unexplained"

# A campaign is adequate where neither its own p-value is below `ACCEPTABLE_P` nor that of the best
# effect's gain: together they refuse 2 % of campaigns with nothing hidden.

# A pair must fit no worse: after it nothing else is tried, so it is given more room.
_PAIR_EXPLAINS = 0.003
# An effect alone that fits no better than 0.01, but no worse than this, still explains the readings
# where no pair is significantly better: with the right effect one campaign in a hundred is such.
_BARELY_EXPLAINS = 1e-4
# A further effect must gain what chance gives the best of all effects this rarely.
_SIGNIFICANT = 0.01
# Logarithm of the odds from which one explanation is no rival of another.
_RIVAL = 3.0
# The same of what has no name beside the only effect that leads: it has been there where a relative
# of what was missing fitted well, at a usual size (trials with effects left out of the catalogue).
_DOUBT = 2.7
# Explanations that a sentence names.
_MOST_SAID = 4
# Effects added at most.
_MOST_EFFECTS = 4


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
    #: What else may explain the readings: wrong ones, the likeliest first, with whose they are.
    instrument: Sequence[tuple[Hypothesis, Suspect]] = ()
    #: What has no name.
    unnamed: Sequence[Hypothesis] = ()

    @property
    def baseline(self) -> Fit:
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

    def hypotheses(self, pairs: Ranking | None) -> list[Hypothesis]:
        """All that may explain the readings."""
        of_effects = [(), *self.singles.order, *(pairs.order if pairs is not None else ())]
        return [
            *map(self._of_effects, of_effects),
            *(hypothesis for hypothesis, _ in self.instrument),
            *self.unnamed,
        ]

    def _of_effects(self, effects: tuple[str, ...]) -> Hypothesis:
        explanations = self.explanations
        common = COMMON_TO_PAIRS if len(effects) > 1 else 0.0
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
            and suspect.p_value >= _BARELY_EXPLAINS
            and hypothesis.log_weight > best - _RIVAL
        )

    @property
    def single_explains(self) -> bool:
        """Whether an effect alone explains the readings, and no worse than what has no name."""
        order = self.singles.order
        return bool(order) and self._names(order[0]) and explains(self.singles.best, ACCEPTABLE_P)

    def _names(self, effects: tuple[str, ...]) -> bool:
        """Whether effects are likelier than anything that has no name."""
        weights = [each.log_weight for each in self.unnamed]
        return not weights or self._of_effects(effects).log_weight >= float(logsumexp(weights))

    def verdict(self, pairs: Ranking | None) -> Verdict:
        """What is said of the campaign; pairs are given where they were looked at."""
        baseline, suspects = self.baseline, self.suspects
        if self.is_adequate:
            return Verdict(
                ADEQUATE,
                f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom ("
                f"{p_equals(baseline.p_value)}), and no effect gains more than chance would ("
                f"{p_equals(self.p_of_best_gain)})",
            )
        leading, best = self._leading(pairs)
        if suspects:
            others = [h for h in self.hypotheses(pairs) if h.effects or h.besides == UNKNOWN]
            rivals = float(logsumexp([each.log_weight for each in others]))
            lead = self.instrument[0][0].log_weight - rivals
            if lead > _RIVAL or (lead > 0.0 and not leading):
                return _of_suspects(suspects)
            if lead > -_RIVAL and leading:
                return Verdict(
                    AMBIGUOUS,
                    f"{self._titles(leading)} and {suspects[0].words} explain the misfit about "
                    "equally well: check the reading first",
                    leading,
                    suspects,
                )
        if leading:
            return self._of_leading(leading, best, pairs)
        return Verdict(
            UNEXPLAINED,
            f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom, and something that "
            "is in no catalogue is likelier than any effect, or two together: of these "
            f"{best.chi2:.3g} for {best.ndf} at best",
        )

    def _of_leading(
        self, leading: tuple[tuple[str, ...], ...], best: Fit, pairs: Ranking | None
    ) -> Verdict:
        p = best.p_value
        quality = f"chi2 = {best.chi2:.3g} for {best.ndf} degrees of freedom"
        quality += f" ({p_equals(p)})" if p is not None else ""
        if len(leading) == 1:
            reason = f"{self._titles(leading)} explains the misfit: {quality}"
            unknown, others = (
                [h.log_weight for h in self.hypotheses(pairs) if (h.besides == UNKNOWN) is of_none]
                for of_none in (True, False)
            )
            if unknown and logsumexp(unknown) - logsumexp(others) > -_DOUBT:
                reason += "; but so may something that is in no catalogue"
                return Verdict(AMBIGUOUS, reason, leading)
            return Verdict(MISSING_EFFECT, reason, leading)
        ranking = self.singles if pairs is None or leading[0] in self.singles.order else pairs
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
        if len(leading) > _MOST_SAID:
            first, last = first[:_MOST_SAID], f"{len(leading) - _MOST_SAID} others"
        return f"{', '.join(first)} and {last}" if first else last

    def _leading(self, pairs: Ranking | None) -> tuple[tuple[tuple[str, ...], ...], Fit]:
        """Effects that explain the readings, and of all effects the fit that does best."""
        singles, found = self.singles, self.baseline
        significant = self.p_of_best_gain < ACCEPTABLE_P
        if singles.order:
            found = singles.best
            alone = pairs is None or not self.needs(pairs)
            level = _BARELY_EXPLAINS if pairs is not None else ACCEPTABLE_P
            if alone and significant and self._names(singles.order[0]) and explains(found, level):
                return singles.leading(), found
        if pairs is not None and pairs.order:
            found = pairs.best
            if (
                self.needs(pairs)
                and self._names(pairs.order[0])
                and explains(found, _PAIR_EXPLAINS)
            ):
                return pairs.leading(), found
        return (), found

    def needs(self, pairs: Ranking) -> bool:
        """Whether two effects explain the readings significantly better than the best one alone.

        Asked where that one leaves a p-value below 0.01. The gain is corrected for the number of
        partners, or of all pairs where the best does without the best single effect.
        """
        if not pairs.order:
            return False
        alone, best = self.singles.best, pairs.best
        if not explains(alone, _BARELY_EXPLAINS):
            return True
        order = self.singles.order
        tries = len(order) if order[0][0] in pairs.order[0] else math.comb(len(order), 2)
        further = max(len(best.names) - len(alone.names), 1)
        gain = max(alone.chi2 - best.chi2, 0.0)
        return corrected(float(chdtrc(further, gain)), tries) < ACCEPTABLE_P

    def chain(self, pairs: Ranking | None) -> tuple[str, ...]:
        """Effects that together explain the readings where no two do; empty if none do.

        One after the other, from the best pair on, while its gain is significant, and it explains
        what was not explained or the error on readings left out falls.
        """
        explanations, null = self.explanations, self.null
        chosen = pairs.order[0] if pairs is not None and pairs.order else self.singles.order[0]
        while len(chosen) < _MOST_EFFECTS:
            ranked = explanations.ranked_further(chosen)
            if not ranked:
                break
            now, best = explanations.fit(chosen), explanations.fit(ranked[0])
            further = ranked[0][-1]
            significant = null.p_of_best(further, now.chi2 - best.chi2) < _SIGNIFICANT
            if not (significant and _justified(now, best)):
                break
            chosen = (*chosen, further)
        return chosen if explains(explanations.fit(chosen), _PAIR_EXPLAINS) else ()


def explains(fit: Fit, level: float) -> bool:
    """Whether a fit leaves nothing to explain, as far as its readings can tell."""
    p = fit.p_value
    return fit.chi2 < 1.0 if p is None else p >= level


def _of_suspects(suspects: tuple[Suspect, ...]) -> Verdict:
    others = f", or {suspects[1].words}" if len(suspects) > 1 else ""
    return Verdict(
        UNEXPLAINED,
        f"{suspects[0].words}{others} explains the misfit better than any effect: check that "
        "before physics is blamed",
        suspects=suspects,
    )


def _justified(now: Fit, more: Fit) -> bool:
    """Whether a fit with more effects is worth them.

    It is where it explains what was not explained; else the error on readings left out must fall.
    A reading that alone holds a new parameter has a large one, however right the effect.
    """
    if explains(more, ACCEPTABLE_P) and not explains(now, ACCEPTABLE_P):
        return True
    return left_out_error(more) < left_out_error(now)


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
    #: The same as sets that each explain the data, or may do so: see `unsettled`.
    leading_sets: tuple[tuple[str, ...], ...]
    #: Where the data are adequate.
    upper_limits: dict[str, Limit]
    suspect_readings: tuple[Suspect, ...]
    repair: tuple[RepairStep, ...]
    next_measurements: tuple[NextMeasurement, ...]
    #: Effects that could not be fitted, with the reason.
    not_tried: dict[str, str]
    #: How likely the sets of effects that were fitted are beside each other, averaged over
    #: plausible sizes, ``none`` among them; pairs joined by ``+``. Empty with too few readings.
    probabilities: dict[str, float]
    #: Averaged over all of these; None where the campaign does not say how to get it.
    light_yield_averaged: AveragedYield | None
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


@dataclass(frozen=True)
class Diagnosed:
    """What explains a campaign's misfit."""

    #: Of the campaign as it is.
    baseline: Calibration
    diagnosis: Diagnosis
    provenance: Provenance


def diagnose(
    campaign: str | Path | Campaign,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    run: Run = Run(),
) -> Diagnosed:
    """Rank the catalogue's effects as explanations of a campaign's misfit.

    Other parameters and errors as for `compare`.

    Parameters
    ----------
    without, only : sequence of str
        Effects that are left out, and those that alone are tried.
    """
    return diagnose_on(Workbench(as_campaign(campaign), run), without=without, only=only)


def diagnose_on(
    bench: Workbench,
    *,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
    adding: Sequence[str] = (),
) -> Diagnosed:
    """`diagnose` with a workbench that can be used further.

    `adding` are the effects of the repair, whatever the verdict.
    """
    campaign = bench.campaign
    possible = bench.possible()
    tried = _tried(possible, campaign, without, only)
    if adding:
        _tried(possible, campaign, (), adding)
        campaign.with_effects(adding)
    # without degrees of freedom nothing can be judged: spare the simulations
    if campaign.ndf > 0:
        bench.candidates = tried
    elif adding:
        problem = "no reading is left over that an effect could be added for"
        raise InputError(problem, "measure more configurations", path=campaign.path)
    if only:
        bench.notes.append(f"probabilities are among those tried, {', '.join(tried)}")
    elif without:
        bench.notes.append(f"left out of the diagnosis: {', '.join(dict.fromkeys(without))}")
    names = tuple(bench.candidates)
    memory = Memory(bench, names)
    precise = memory.read()
    if precise is None:
        bench.simulate(names, look=set(names) - {*adding})
        bench.run.tell("looking for what deserves more photons", 1, 1)
        precise = contenders(bench.model, bench.candidates)
    first = frozenset(precise)
    while True:
        bench.simulate(names, look=set(names) - {*precise, *adding})
        found = diagnose_models(
            bench.model,
            bench.candidates,
            proposals=bench.proposals(),
            adding=tuple(dict.fromkeys(adding)),
            seed=bench.run.seed,
            progress=lambda words: bench.run.tell(words, 1, 1),
        )
        if bench.precise >= (named := _rests_on(found, names)):
            break
        # where chance favours one first look after the other, none is hopeless
        precise |= named if precise <= first else set(names)
    memory.write(precise)
    if campaign.next_measurements and found.verdict not in (AMBIGUOUS, UNEXPLAINED):
        bench.notes.append(
            "what to measure next is listed only where effects are to be told apart, or where none "
            "explains the readings"
        )
    return Diagnosed(fit_model(bench.model(), profile=False), found, bench.provenance())


def _rests_on(found: Diagnosis, tried: Collection[str]) -> set[str]:
    """Effects that a diagnosis names or counts with."""
    if found.verdict == ADEQUATE:
        return set()
    likely = {key for key, p in found.probabilities.items() if p > _LIKELY}
    counted = {name for key in likely for name in key.split(" + ")} & set(tried)
    added = {name for step in found.repair for name in step.effects}
    return {*found.leading, *found.set_aside, *counted, *added}


def _tried(
    possible: Mapping[str, Effect], campaign: Campaign, without: Sequence[str], only: Sequence[str]
) -> dict[str, Effect]:
    """Of the effects that could be missing those that somebody wants to be tried."""
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


def diagnose_models(
    models: Models,
    effects: Mapping[str, Effect],
    *,
    proposals: MeasurementProposals | None = None,
    adding: tuple[str, ...] = (),
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """`diagnose` of models, however they were made.

    ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple of
    names) besides its own; with the interface of `model.CampaignModel`, and if it has
    ``eta_batches(theta)``, the (batches, readings) deviations of log(eta) in batches of the
    simulation that are common to all models, gains have an error. It may raise `InputError` where
    the scene cannot take an effect.

    `effects` may be missing, and `proposals` be measured next. The repair adds `adding`, whatever
    the verdict. `seed` is of the campaigns that are drawn to know what chance gains, and `progress`
    is told in words what is being done.
    """
    began = time.perf_counter()
    say = progress or (lambda words: None)
    say("fitting the campaign as it is")
    explanations = Explanations(models, effects)
    baseline = explanations.baseline
    say("looking for suspect readings")
    compared = comparison_of(baseline)
    chosen: tuple[str, ...] = ()
    set_aside: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    pairs: tuple[Candidate, ...] = ()
    limits = {}
    weighed = Weighing({}, None)
    families: tuple[FamilyProbability, ...] = ()
    hypotheses: list[Hypothesis] = []
    if baseline.ndf <= 0:
        judged = Verdict(
            TOO_FEW_READINGS,
            f"{baseline.problem.knowns} readings and priors determine {len(baseline.names)} free "
            "parameters: none is left to check the model with",
        )
    else:
        say(f"fitting {len(effects)} effects")
        alone = [(name,) for name in explanations.singles()]
        say("averaging over plausible sizes")
        singles = Ranking(explanations, alone)
        say("drawing what chance would gain")
        null = NullDistribution(explanations, [name for (name,) in singles.order], seed)
        maker = CandidateMaker(explanations, null)
        candidates = maker.singles(singles)
        evidence = Judgement(explanations, singles, null)
        of_pairs = None
        if evidence.is_adequate:
            evidence = replace(evidence, unnamed=unnamed(explanations, ()))
        else:
            say("looking for what is no effect")
            evidence = replace(
                evidence,
                instrument=of_instrument(explanations),
                unnamed=unnamed(explanations, singles.order),
            )
            if not evidence.single_explains:
                say("fitting pairs of effects")
                ranked = Ranking(explanations, explanations.ranked_pairs())
                pairs, of_pairs = maker.pairs(ranked), ranked
        judged = evidence.verdict(of_pairs)
        hypotheses = evidence.hypotheses(of_pairs)
        weighed = weigh(hypotheses, baseline.problem.model.campaign.light_yield)
        families = _families(hypotheses, weighed, explanations)
        if judged.word == ADEQUATE:
            say("following limits")
            limits = upper_limits(explanations)
        elif singles.order and not (judged.word == UNEXPLAINED and judged.suspects):
            say("repairing")
            if judged.leading:
                # the one that does more comes first
                chosen = tuple(
                    sorted(judged.leading[0], key=lambda name: explanations.fit((name,)).chi2)
                )
                if not adding and not explanations.is_plausible(chosen):
                    chosen, set_aside = (), chosen
            else:
                # what would be needed: effects that do not explain the readings would only bias
                # what is fitted
                set_aside = evidence.chain(of_pairs)
        if adding:
            if not explanations.possible(adding):
                problem = f"{', '.join(adding)} cannot be fitted to these readings"
                raise InputError(problem, "choose fewer, or others")
            chosen = adding
    proposed: tuple[NextMeasurement, ...] = ()
    if proposals is not None and judged.word in (AMBIGUOUS, UNEXPLAINED):
        say("looking for what to measure next")
        proposed = next_measurements(explanations, judged.leading, hypotheses, proposals)
    return Diagnosis(
        verdict=judged.word,
        reason=judged.reason,
        baseline=compared,
        candidates=candidates,
        pairs=pairs,
        leading=tuple(dict.fromkeys(name for group in judged.leading for name in group)),
        leading_sets=judged.leading,
        unsettled=judged.unsettled,
        upper_limits=limits,
        suspect_readings=judged.suspects,
        repair=steps(explanations, chosen),
        next_measurements=proposed,
        not_tried=dict(explanations.refused),
        probabilities=dict(sorted(weighed.probabilities.items(), key=lambda each: -each[1])),
        light_yield_averaged=weighed.light_yield,
        seconds=time.perf_counter() - began,
        families=families,
        set_aside=set_aside,
        titles={name: effect.title for name, effect in effects.items()},
    )


def _families(
    hypotheses: Sequence[Hypothesis], weighed: Weighing, explanations: Explanations
) -> tuple[FamilyProbability, ...]:
    """Probabilities by family."""
    members: dict[str, list[tuple[float, str]]] = {}
    for name, each in {each.name: each for each in hypotheses}.items():
        family = NOTHING_MISSING
        if each.besides:
            family = UNKNOWN if each.besides == UNKNOWN else INSTRUMENT
        elif each.effects:
            family = explanations.family(each.effects)
        members.setdefault(family, []).append((weighed.probabilities[name], name))
    found = (
        FamilyProbability(
            family,
            sum(p for p, _ in each),
            tuple(name for _, name in sorted(each, reverse=True) if name != NOTHING_MISSING),
        )
        for family, each in members.items()
    )
    return tuple(sorted(found, key=lambda one: -one.probability))
