"""Hypotheses side by side: campaigns of the same readings, and what these say of each.

Every campaign is fitted by itself. Its evidence is that of a diagnosis, with the same densities of
the sizes of its effects, and all campaigns share the prior of the scale, so that evidences compare.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.special import softmax

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import attributes
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.rounding import counted, p_equals, probability
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.inference import estimates
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.judgement import AMBIGUOUS, UNEXPLAINED, explains
from mcrim_mitsuba.inference.model import UNKNOWN_SCALE
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P, EXPLAINING
from mcrim_mitsuba.inference.simulations import CampaignSimulations, spent_together
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.runs.array_job import PartDoneError

#: What hypotheses are called, in the order in which they are given; so many are compared at most.
NAMES = ("A", "B", "C")
#: The verdict where one hypothesis leads alone and describes the readings.
PREFERRED = "preferred"
# What makes a row of a measurement file, its scene parameters besides, and how far numbers may
# differ that were read from histograms in one campaign and written out in the other.
_OF_A_ROW = tuple("label kind sample signal sigma use group group_sigma shared".split())
_ROUNDED = 1e-6


@dataclass(frozen=True)
class FittedHypothesis:
    """What the readings say of one campaign."""

    #: ``A``, ``B`` or ``C``.
    name: str
    #: Its file; None where there is none.
    campaign: Path | None
    #: What it switches on over its scene, in the file's order.
    effects: tuple[str, ...]
    #: As in `Calibration`.
    chi2: float
    ndf: int
    p_value: float | None
    #: On readings left out of the fit, in their standard errors.
    left_out_error: float
    #: Natural logarithm of the likelihood averaged over the priors, less that of the best; and its
    #: error by the points of the average and by the simulation.
    log_evidence: float
    log_evidence_sigma: float
    #: Among those compared, each as likely as the others before the readings.
    probability: float
    #: The free ones, and the light yield.
    parameters: dict[str, estimates.ParameterEstimate]
    #: All readings, in the file's order.
    rows: tuple[estimates.FittedRow, ...]

    #: What it switches on, in words.
    titles: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """``B (air bubble in the gap)``."""
        return f"{self.name} ({' with '.join(self.titles) or 'nothing added'})"


@dataclass(frozen=True)
class SideBySide:
    """Hypotheses on the same readings."""

    #: ``preferred``, ``ambiguous`` or ``unexplained``.
    verdict: str
    #: In a sentence.
    reason: str
    #: Names of those that the data cannot tell from the likeliest, which is the first.
    leading: tuple[str, ...]
    #: In the order in which they were given.
    hypotheses: tuple[FittedHypothesis, ...]
    #: By label, in the file's order: the largest difference of two predictions, in standard errors
    #: of the reading.
    apart: dict[str, float]

    @property
    def named(self) -> dict[str, FittedHypothesis]:
        """The hypotheses by name."""
        return {one.name: one for one in self.hypotheses}


def compare_hypotheses(
    campaigns: Sequence[str | Path | Campaign], *, run: Run = Run()
) -> tuple[SideBySide, Provenance, dict[str, str]]:
    """Fit campaigns of the same readings and weigh them against each other.

    There are two or three; scenes, effects, priors and starts may differ. All are simulated with
    the same random numbers. Beside the comparison stand the provenance of all together, and the
    hashes of the scenes by hypothesis.

    Raises InputError if a file is wrong, a scene is not sound, or the readings do not determine the
    parameters; or if the readings, or what is known of the scale, are not the same.
    """
    given = [as_campaign(one) for one in campaigns]
    refuse_unlike(given)
    parameters = given[0].parameters
    # what is simulated depends on where the coefficients start, and fits do not
    starts = {n: parameters[n].start for n in (ALPHA_SCAT, ALPHA_ABS) if n in parameters}
    pairs = zip(NAMES, given, strict=False)
    benches = {name: CampaignSimulations(one.with_starts(starts), run) for name, one in pairs}
    explained, fits = dict[str, Explanations](), dict[str, Calibration]()
    done: PartDoneError | None = None
    for bench in benches.values():
        try:
            bench.simulate()
        except PartDoneError as part:  # of an array job: it does its share of each before it ends
            done = part
    if done is not None:
        raise done
    for name, simulations in benches.items():
        scales = next((others.scales for others in explained.values()), {})
        switched_on = {effect.name: effect for effect in simulations.campaign.switched_on}
        models = simulations.models.reduced_model
        fits[name] = simulations.fit()
        as_it_is = find_minima(Statistic(models(())))[0] if switched_on else fits[name].minimum
        explained[name] = Explanations(models, switched_on, as_it_is, scales)
        explained[name].know(switched_on, fits[name].minimum)
    notes = [f"{name}: {note}" for name, fit in fits.items() for note in fit.notes]
    found = side_by_side(explained, fits)
    spent = [bench.provenance() for bench in benches.values()]
    scenes = {name: each.scene_hash for name, each in zip(benches, spent, strict=True)}
    return found, spent_together(spent, notes), scenes


def side_by_side(
    explained: Mapping[str, Explanations], results: Mapping[str, Calibration]
) -> SideBySide:
    """Hypotheses by name, each with all effects that its explanations know, of the same readings.

    Those whose evidence is as close to the best as explanations are that lead a diagnosis together
    cannot be told from it.
    """
    fits = {name: fit.minimum for name, fit in results.items()}
    evidences = {name: own.evidence(own.effects) for name, own in explained.items()}
    order = sorted(explained, key=lambda name: -evidences[name].log)
    best = order[0]
    probabilities = dict(zip(evidences, softmax([e.log for e in evidences.values()]), strict=True))
    noise = {name: estimates.error_of_difference(fit, fits[best]) for name, fit in fits.items()}
    sampled = {name: each.log_sigma for name, each in evidences.items()}
    errors = {n: math.hypot(sampled[n], sampled[best], 0.5 * noise[n]) for n in fits} | {best: 0.0}
    hypotheses = tuple(
        FittedHypothesis(
            name=name,
            campaign=fit.statistic.model.campaign.path,
            effects=tuple(explained[name].effects),
            **attributes(results[name], "chi2 ndf p_value parameters rows"),
            left_out_error=estimates.left_out_error(fit),
            log_evidence=evidences[name].log - evidences[best].log,
            log_evidence_sigma=errors[name],
            probability=float(probabilities[name]),
            titles=tuple(each.title for each in explained[name].effects.values()),
        )
        for name, fit in fits.items()
    )
    named = dict(zip(fits, hypotheses, strict=True))
    leading = tuple(
        n for n in order if -2.0 * named[n].log_evidence <= EXPLAINING.leading + 2.0 * noise[n]
    )
    verdict, reason = _verdict([named[name] for name in leading], results[best])
    # as they are shown: each with its bench's numbers off as the readings have them
    predicted = np.ptp([[row.model for row in fit.rows] for fit in results.values()], axis=0)
    pairs = zip(results[best].rows, predicted, strict=True)
    apart = {row.label: float(far / row.sigma) for row, far in pairs}
    return SideBySide(verdict, reason, leading, hypotheses, apart)


def _verdict(leading: Sequence[FittedHypothesis], fit: Calibration) -> tuple[str, str]:
    """The verdict and its reason; the fit is that of the first."""
    best = leading[0]
    quality = f"chi2 = {fit.chi2:.3g} without degrees of freedom"
    if fit.p_value is not None:
        degrees = f"{counted(fit.ndf, 'degree')} of freedom"
        quality = f"chi2 = {fit.chi2:.3g} for {degrees} ({p_equals(fit.p_value)})"
    likeliest = f"{best.words} is the likeliest of those compared, {probability(best.probability)}"
    if not explains(fit.minimum, ACCEPTABLE_P):
        return UNEXPLAINED, f"{likeliest}, but it does not describe the readings: {quality}"
    if len(leading) > 1:
        *others, last = (one.words for one in leading)
        names = f"{', '.join(others)} and {last}"
        return AMBIGUOUS, f"the readings cannot tell apart {names}: {quality} with the first"
    describes = "and describes the readings" if fit.p_value is not None else "as far as it goes"
    return PREFERRED, f"{likeliest}, {describes}: {quality}"


# ---- what must be the same ----


def refuse_unlike(campaigns: Sequence[Campaign]) -> None:
    """Refuse campaigns that cannot be compared: InputError with the first file and row.

    Readings must be the same, and what is known of the scale too: a prior of one alone would decide
    between them.
    """
    if not 2 <= len(campaigns) <= len(NAMES):
        problem = f"{len(campaigns)} hypotheses cannot be compared"
        raise InputError(problem, f"name two or {len(NAMES)} campaigns of the same readings")
    first, *others = campaigns
    for other in others:
        ours, theirs = first.measurements, other.measurements
        mend = "let both campaigns name the same measurements"
        for one, another in zip_longest(ours.readings, theirs.readings):
            if another is None:
                problem = f"{one.label} of {ours.path} is not among the readings"
                raise InputError(problem, mend, path=theirs.path)
            if one is None:
                problem = f"{another.label} is not among the readings of {ours.path}"
                raise theirs.refusal(another, None, problem, mend)
            for name, expected, given in _differences(one, another):
                problem = f"{name} of {another.label} is {given}, but {expected} in {ours.path}"
                raise theirs.refusal(another, name, problem, mend)
        if _of_scale(first) != _of_scale(other):
            mend = "give [parameters.scale] the same start, prior, min, max and fixed in both"
            mend += ", or leave it out of both"
            raise InputError(f"the scale is not treated as in {first.path}", mend, path=other.path)


def _of_scale(campaign: Campaign) -> tuple[float | None, ...]:
    known = campaign.scale or UNKNOWN_SCALE
    held = known.start if known.fixed else None
    return known.minimum, known.maximum, known.prior, known.prior_sigma, held


def _differences(one: Reading, another: Reading) -> Iterator[tuple[str, str, str]]:
    """What differs between two rows: its name, and both values."""
    names = dict.fromkeys((*one.parameters, *another.parameters))
    pairs: list[tuple[str, object, object]] = [
        *((name, getattr(one, name), getattr(another, name)) for name in _OF_A_ROW),
        *((name, one.parameters.get(name), another.parameters.get(name)) for name in names),
    ]
    for name, expected, theirs in pairs:
        alike = expected == theirs
        if isinstance(expected, float) and isinstance(theirs, float):
            alike = math.isclose(expected, theirs, rel_tol=_ROUNDED)
        if not alike:
            yield name, _cell(expected), _cell(theirs)


def _cell(value: object) -> str:
    """A cell of a measurement file in words."""
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:g}" if isinstance(value, float) else str(value)
