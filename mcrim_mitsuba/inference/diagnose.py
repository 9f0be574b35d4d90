"""Which effects of a catalogue explain a campaign's misfit: simulate, fit, rank, judge."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from scipy.special import chdtrc

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.effects.catalogue import effect_of
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.candidates import (
    Candidate,
    CandidateMaker,
    Limit,
    MeasurementProposals,
    NextMeasurement,
    determined_estimates,
    next_measurements,
    upper_limits,
)
from mcrim_mitsuba.inference.compare import SWAPPED_ROWS, Comparison, Suspect, comparison_of
from mcrim_mitsuba.inference.estimates import (
    ACCEPTABLE_P,
    LIGHT_YIELD,
    ParameterEstimate,
    corrected,
    criterion,
    error_of_difference,
    left_out_error,
    rms_pull,
)
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING, AveragedYield, Weighing, weigh
from mcrim_mitsuba.inference.explanations import (
    LEADING,
    Explanations,
    Models,
    NullDistribution,
    Ranking,
)
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.least_squares import Fit
from mcrim_mitsuba.inference.race import Memory, contenders
from mcrim_mitsuba.inference.workbench import Workbench

#: Probability from which an effect counts as one that a diagnosis rests on.
_LIKELY = 0.01
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


@dataclass(frozen=True)
class Judgement:
    """What a verdict rests on."""

    explanations: Explanations
    #: Of the effects alone.
    singles: Ranking
    null: NullDistribution
    #: The likeliest first.
    suspects: tuple[Suspect, ...]

    @property
    def baseline(self) -> Fit:
        """The campaign as it is."""
        return self.explanations.baseline

    @property
    def p_of_best_gain(self) -> float:
        """Probability that chance alone gains as much as the effect that gains most."""
        chi2 = [self.explanations.fit(effects).chi2 for effects in self.singles.order]
        return self.null.p_global(self.baseline.chi2 - min(chi2)) if chi2 else 1.0

    def first_verdict(self) -> Verdict | None:
        """As far as readings and single effects decide; None where pairs must be tried."""
        singles, suspects, baseline = self.singles, self.suspects, self.baseline
        p, p_global = baseline.p_value, self.p_of_best_gain
        if p is not None and p >= ACCEPTABLE_P and p_global >= ACCEPTABLE_P:
            return Verdict(
                ADEQUATE,
                f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom (p = {p:.2g}), "
                f"and no effect gains more than chance would (p = {p_global:.2g})",
            )
        leading: tuple[tuple[str, ...], ...] = ()
        of_effects, barely, well = math.inf, False, False
        if singles.order and p_global < ACCEPTABLE_P:
            leading = singles.leading()
            of_effects = criterion(singles.best) + 2.0 * math.log(len(singles.order))
            barely = explains(singles.best, _BARELY_EXPLAINS)
            well = explains(singles.best, ACCEPTABLE_P)
        if suspects:
            # 2 log(tries), of effects and in the score, stands for the many ways to be suspected
            of_suspects = baseline.weights.log_determinant + 2.0 * len(baseline.names)
            score = suspects[0].score(len(baseline.problem.signal))
            lead = of_effects - (of_suspects + score)
            if lead > LEADING or not barely:
                return _of_suspects(suspects)
            if lead >= -LEADING:
                return Verdict(
                    AMBIGUOUS,
                    f"{_effects(leading)} and {_words(suspects[0])} explain the misfit about "
                    "equally well: check the reading first",
                    leading,
                    suspects,
                )
        return _of_leading(leading, singles.best) if well else None

    def last_verdict(self, pairs: Ranking) -> Verdict:
        """The verdict where no effect alone explains the readings well, nor a suspect one."""
        baseline, singles = self.baseline, self.singles
        if not self.needs(pairs):
            significant = self.p_of_best_gain < ACCEPTABLE_P
            if significant and explains(singles.best, _BARELY_EXPLAINS):
                return _of_leading(singles.leading(), singles.best)
        elif explains(pairs.best, _PAIR_EXPLAINS):
            return _of_leading(pairs.leading(), pairs.best)
        best = pairs.best if pairs.order else singles.best if singles.order else baseline
        return Verdict(
            UNEXPLAINED,
            f"chi2 = {baseline.chi2:.3g} for {baseline.ndf} degrees of freedom, and no effect of "
            f"the catalogue, nor two together, explain it: {best.chi2:.3g} for {best.ndf} at best",
        )

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

    def effects_to_add(self, pairs: Ranking | None) -> tuple[str, ...]:
        """Effects to add to a campaign that does not fit, in this order.

        The best effect alone if its gain is significant; where it leaves a misfit, the best pair. A
        further one only if its gain is significant, and it explains what was not explained or the
        error on readings left out falls. Pairs are given where no effect alone explains the
        readings; of effects there is one at least.
        """
        explanations, null, now = self.explanations, self.null, self.singles.best
        chosen = self.singles.order[0]
        if pairs is None and null.p_global(self.baseline.chi2 - now.chi2) >= _SIGNIFICANT:
            return ()
        if pairs is not None and pairs.order and _justified(now, pairs.best):
            # the one that does more comes first
            chosen = tuple(sorted(pairs.order[0], key=lambda name: explanations.fit((name,)).chi2))
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
        return chosen

    def verdict_of_more(self, chosen: tuple[str, ...], before: Verdict) -> Verdict:
        """The verdict where no pair explains the readings, but three effects or more may."""
        fit = self.explanations.fit(chosen)
        p_value = fit.p_value
        if len(chosen) < 3 or p_value is None or p_value < _PAIR_EXPLAINS:
            return before
        return Verdict(
            MISSING_EFFECT,
            f"{' + '.join(chosen)} together explain the misfit: chi2 {self.baseline.chi2:.3g} -> "
            f"{fit.chi2:.3g} (ndf {fit.ndf}, p = {p_value:.2g}); nothing less does",
            leading=(tuple(chosen),),
        )


def explains(fit: Fit, level: float) -> bool:
    """Whether a fit leaves nothing to explain, as far as its readings can tell."""
    p = fit.p_value
    return fit.chi2 < 1.0 if p is None else p >= level


def _of_leading(leading: tuple[tuple[str, ...], ...], best: Fit) -> Verdict:
    p = best.p_value
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


def _of_suspects(suspects: tuple[Suspect, ...]) -> Verdict:
    others = f", or {_words(suspects[1])}" if len(suspects) > 1 else ""
    return Verdict(
        UNEXPLAINED,
        f"{_words(suspects[0])}{others} explains the misfit better than any effect: check that "
        "before physics is blamed",
        suspects=suspects,
    )


def _words(suspect: Suspect) -> str:
    if suspect.kind == SWAPPED_ROWS:
        return f"a swap of {' and '.join(suspect.labels)}"
    return f"a bad reading {suspect.labels[0]} ({suspect.pull:+.1f} sigma)"


def _effects(leading: tuple[tuple[str, ...], ...]) -> str:
    return ", ".join(" with ".join(effects) for effects in leading)


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
            )
        )
        before = fit
    return tuple(made)


def _named(chosen: tuple[str, ...], leading: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The most of some effects, from the first on, that a verdict names as one explanation."""
    sets = set(map(frozenset, leading))
    counts = (n for n in range(len(chosen), 0, -1) if frozenset(chosen[:n]) in sets)
    return chosen[: next(counts, 0)]


# ---- the whole ----

# Leading explanations that further measurements are to tell apart: each costs simulations.
_MOST_RIVALS = 3


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
    #: The same as sets that each explain the data.
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


@dataclass(frozen=True)
class Diagnosed:
    """What explains a campaign's misfit."""

    #: Of the campaign as it is.
    baseline: Calibration
    diagnosis: Diagnosis
    provenance: Provenance


def diagnose(
    campaign: str | Path | Campaign, *, without: Sequence[str] = (), only: Sequence[str] = (),
    run: Run = Run(),
) -> Diagnosed:  # fmt: skip
    """Rank the catalogue's effects as explanations of a campaign's misfit.

    Other parameters and errors as for `compare`.

    Parameters
    ----------
    without, only : sequence of str
        Effects that are left out, and those that alone are tried.
    """
    return diagnose_on(Workbench(as_campaign(campaign), run), without=without, only=only)


def diagnose_on(
    bench: Workbench, *, without: Sequence[str] = (), only: Sequence[str] = (),
    adding: Sequence[str] = (),
) -> Diagnosed:  # fmt: skip
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
        if bench.precise >= (named := _rests_on(found)):
            break
        # where chance favours one first look after the other, none is hopeless
        precise |= named if precise <= first else set(names)
    memory.write(precise)
    return Diagnosed(fit_model(bench.model(), profile=False), found, bench.provenance())


def _rests_on(found: Diagnosis) -> set[str]:
    """Effects that a diagnosis names or counts with."""
    if found.verdict == ADEQUATE:
        return set()
    likely = {key for key, p in found.probabilities.items() if p > _LIKELY} - {NOTHING_MISSING}
    counted = {name for key in likely for name in key.split(" + ")}
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

    Parameters
    ----------
    models : callable
        ``models(added)`` gives the model of the campaign with the effects `added` (a sorted tuple
        of names) besides its own; with the interface of `model.CampaignModel`, and if it has
        ``eta_batches(theta)``, the (batches, readings) deviations of log(eta) in batches of the
        simulation that are common to all models, gains have an error. May raise `InputError` where
        the scene cannot take an effect.
    effects : mapping of str to Effect
        That may be missing.
    proposals : MeasurementProposals, optional
        What could be measured next.
    adding : tuple of str
        Effects of the repair, whatever the verdict.
    seed : int
        Of the campaigns that are drawn to know what chance gains.
    progress : callable, optional
        Told in words what is being done.
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
        sets = [(), *singles.order]
        evidence = Judgement(explanations, singles, null, compared.suspects)
        first, of_pairs = evidence.first_verdict(), None
        if first is not None:
            judged = first
        else:
            say("fitting pairs of effects")
            best_pairs = explanations.ranked_pairs()
            ranked = Ranking(explanations, best_pairs)
            pairs = maker.pairs(ranked)
            sets += ranked.order
            judged = evidence.last_verdict(ranked)
            of_pairs = ranked if evidence.needs(ranked) else None
        weighed = weigh(
            {effects: explanations.evidence(effects) for effects in sets},
            len(alone),
            baseline.problem.model.campaign.light_yield,
        )
        if judged.word == ADEQUATE:
            say("following limits")
            limits = upper_limits(explanations)
        elif singles.order and not (judged.word == UNEXPLAINED and judged.suspects):
            say("repairing")
            chosen = evidence.effects_to_add(of_pairs)
            if judged.word == UNEXPLAINED:
                judged = evidence.verdict_of_more(chosen, judged)
            # effects that do not explain the readings would only bias what is fitted
            chosen = _named(chosen, judged.leading)
            if not adding and not explanations.is_plausible(chosen):
                chosen, set_aside = (), chosen
        if adding:
            if not explanations.possible(adding):
                problem = f"{', '.join(adding)} cannot be fitted to these readings"
                raise InputError(problem, "choose fewer, or others")
            chosen = adding
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
        repair=steps(explanations, chosen),
        next_measurements=proposed,
        not_tried=dict(explanations.refused),
        probabilities={
            " + ".join(effects) or NOTHING_MISSING: p
            for effects, p in sorted(weighed.probabilities.items(), key=lambda each: -each[1])
        },
        light_yield_averaged=weighed.light_yield,
        seconds=time.perf_counter() - began,
        families=_families(weighed, explanations),
        set_aside=set_aside,
    )


def _families(weighed: Weighing, explanations: Explanations) -> tuple[FamilyProbability, ...]:
    """Probabilities by family."""
    members: dict[str, list[tuple[float, str]]] = {}
    for effects, p in weighed.probabilities.items():
        family = explanations.family(effects) or NOTHING_MISSING
        members.setdefault(family, []).append((p, " + ".join(effects)))
    found = (
        FamilyProbability(
            family,
            sum(p for p, _ in each),
            tuple(name for _, name in sorted(each, reverse=True) if name),
        )
        for family, each in members.items()
    )
    return tuple(sorted(found, key=lambda one: -one.probability))
