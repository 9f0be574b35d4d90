"""Sentences on results, for terminal, figures and report, each worded once."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mcrim_mitsuba.campaign.editor import beam_notes
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.samples import EFFICIENCY_FACTOR, of_sample
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, titled, unit_of
from mcrim_mitsuba.core.rounding import (
    capital,
    counted,
    number,
    p_equals,
    p_text,
    pdg,
    pdg_parts,
    percent,
    probability,
    short_text,
)
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow, ParameterEstimate
from mcrim_mitsuba.inference.evidence import NOTHING_MISSING
from mcrim_mitsuba.inference.judgement import AMBIGUOUS, MISSING_EFFECT, NO_EFFECTS, UNEXPLAINED
from mcrim_mitsuba.inference.plan import (
    EFFICIENCY,
    EVENTS_ORIGIN,
    MOUNTINGS_ORIGIN,
    PRIOR,
    SO_FAR,
    STATISTICAL,
    ExpectedError,
    Plan,
    Planning,
)
from mcrim_mitsuba.inference.rival_causes import UNKNOWN
from mcrim_mitsuba.inference.settings import ACCEPTABLE_P
from mcrim_mitsuba.inference.statistic import is_misfit
from mcrim_mitsuba.inference.weighing import OTHERS
from mcrim_mitsuba.laboratory.error_budget import Contribution, ErrorBudget, contribution

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign
    from mcrim_mitsuba.campaign.measurements import Reading
    from mcrim_mitsuba.inference.candidates import Candidate, Limit
    from mcrim_mitsuba.inference.compare import Comparison, Suspect, Trend
    from mcrim_mitsuba.inference.diagnose import Diagnosis, RepairStep
    from mcrim_mitsuba.inference.fit import Calibration
    from mcrim_mitsuba.inference.hypotheses import FittedHypothesis, SideBySide
    from mcrim_mitsuba.inference.next_measurements import NextMeasurement
    from mcrim_mitsuba.inference.profiles import Profile

# From here on readings of light and of the beam are said to pull apart, standard errors.
_PULLS_APART = 2.0
# Gain in chi2 that is only the solver's precision.
_NO_GAIN = 0.01


def fails(fit: Comparison | Calibration) -> bool:
    """Whether the model does not describe the readings."""
    return is_misfit(fit.chi2, fit.p_value)


def estimate_text(estimate: ParameterEstimate) -> str:
    """``0.54 ± 0.02``; at a bound, where sigma is no error, ``0.05, at its bound``."""
    if estimate.at_bound is None:
        if math.isinf(estimate.sigma):
            return f"{estimate.value:.4g}, not determined"
        return pdg(estimate.value, estimate.sigma)
    # at a bound of 0 the search ends close to it
    value = 0.0 if abs(estimate.value) < 1e-6 * estimate.sigma else estimate.value
    return f"{value:.4g}, at its bound"


def reading_label(reading: FittedRow | Reading) -> str:
    """A reading's name, and that it is not used where it is not."""
    return reading.label if reading.use else f"{reading.label} (not used)"


def added_text(step: RepairStep) -> str:
    """What a step of a repair adds: ``+ air bubble in the gap``, of the first ``as it came``."""
    if step.added is None:
        return step.title or "as it came"
    return f"+ {step.title or step.added}"


def light_text(fit: Calibration) -> str:
    """The fitted light yield with its error, else the scale; ``held`` where neither is fitted."""
    light = fit.parameters.get(LIGHT_YIELD, fit.parameters.get(SCALE))
    return "held" if light is None else estimate_text(light)


def size_text(candidate: Candidate, separator: str = "; ") -> str:
    """What a fit makes of an effect: ``surface loss = 0.0123 ± 0.0008``; ``on`` without a size."""
    sizes = (f"{title_of(n)} = {estimate_text(size)}" for n, size in candidate.sizes.items())
    return separator.join(sizes) or "on"


def plausibility(candidate: Candidate) -> str:
    """Whether a laboratory usually meets an effect at its fitted size; or that it has no size."""
    if not candidate.effect_parameters:
        return "on or off"
    if candidate.at_bound:
        # at the end where it is not there, nothing is gained
        return "absent" if abs(candidate.delta_chi2) < _NO_GAIN else "end of its range"
    if candidate.tolerances_off is not None:
        off = f"{candidate.tolerances_off:.1f} tolerances"
        return f"{off} off" if candidate.plausible else f"unusual: {off}"
    return "usual size" if candidate.plausible else "unusual size"


def together(names: Sequence[str], word: str = "and") -> str:
    """Names, one at least, as a sentence has them: ``a``, ``a and b``, ``a, b and c``."""
    *first, last = names
    return f"{', '.join(first)} {word} {last}" if first else last


def titles_of(diagnosis: Diagnosis | Planning, effects: Iterable[str]) -> list[str]:
    """Titles of effects, given by their ids; what has no title is called by its id."""
    return [diagnosis.titles.get(name, name) for name in effects]


def in_words(diagnosis: Diagnosis, effects: Iterable[str]) -> str:
    """Effects, given by their ids: ``air bubble in the gap and bevel of the edges``."""
    return together(titles_of(diagnosis, effects))


def leading_candidates(diagnosis: Diagnosis) -> list[Candidate]:
    """The effects or pairs that the data cannot tell apart, the best first.

    Without those that only the simulation's error lets lead: the verdict names them.
    """
    settled = (names for names in diagnosis.leading_sets if names not in diagnosis.unsettled)
    return [candidate for candidate in map(diagnosis.candidate, settled) if candidate is not None]


def likeliest_first(diagnosis: Diagnosis, tried: Iterable[Candidate]) -> list[Candidate]:
    """Effects or pairs by their probabilities, those too unlikely to have one as they came."""
    return sorted(tried, key=lambda c: -diagnosis.probabilities.get(c.effect, 0.0))


def signal_text(of_beam: bool, value: float, sigma: float | None) -> str:
    """A reading or what predicts it, transmittances in per cent: ``(76.0 ± 1.2) %``."""
    if not of_beam:
        return pdg(value, sigma)
    text = pdg(100 * value, 100 * sigma if sigma else None)  # a closed form has no error
    return f"({text}) %" if "±" in text else f"{text} %"


def beam_conflict(comparison: Comparison) -> list[str]:
    """Where light and beam contradict each other, in sentences: none where the model fits."""
    if not fails(comparison):
        return []
    beams = {row.label for row in comparison.rows if row.of_beam}
    return [
        f"the couplings and the beam pull apart: {label} was measured {abs(pull):.1f} standard "
        f"errors {'above' if pull > 0 else 'below'} what all other readings predict, which ask for "
        f"{'more' if pull > 0 else 'less'} to be lost in the crystal than the beam loses"
        for label, pull in comparison.left_out_pulls.items()
        if label in beams and abs(pull) > _PULLS_APART
    ]


# Readings at which hypotheses are said to differ most.
_MOST_APART = 3


def hypothesis_text(hypothesis: FittedHypothesis) -> str:
    """``mended.toml, with air bubble in the gap``: where a hypothesis is from, and its effects."""
    titles = hypothesis.titles
    added = f"with {together(titles)}" if titles else "nothing added to its scene"
    return added if hypothesis.campaign is None else f"{hypothesis.campaign}, {added}"


def most_apart(compared: SideBySide) -> list[str]:
    """Labels of the readings at which hypotheses differ most, these first."""
    return sorted(compared.apart, key=lambda label: -compared.apart[label])[:_MOST_APART]


def prediction_text(row: FittedRow) -> str:
    """What a model predicts of a reading, to the place that the reading's error deserves."""
    return value_of(signal_text(row.of_beam, row.model, row.sigma))


def apart_text(compared: SideBySide) -> str:
    """Where hypotheses differ most, with what they predict there, and where next, in a sentence."""
    first, *next_labels = most_apart(compared)
    # the same reading beside each hypothesis
    rows = [
        next(r for r in hypothesis.rows if r.label == first) for hypothesis in compared.hypotheses
    ]
    measured = signal_text(rows[0].of_beam, rows[0].measured, rows[0].sigma)
    text = (
        f"They differ most at {first}: {together([prediction_text(row) for row in rows])} where "
        f"{measured} was measured, {compared.apart[first]:.1f} standard errors of the reading"
    )
    if not next_labels:
        return text
    further = [f"{label} ({compared.apart[label]:.1f})" for label in next_labels]
    return f"{text}; then at {together(further)}"


def likeliest_of(diagnosis: Diagnosis) -> Candidate | None:
    """What is likeliest, if it is an effect or a pair; else None."""
    # probabilities come with the highest first
    name = next(iter(diagnosis.probabilities), None)
    tried = (*diagnosis.candidates, *diagnosis.pairs)
    return next((candidate for candidate in tried if candidate.effect == name), None)


def averaged_yield(
    diagnosis: Diagnosis, simulated: Calibration | None = None, effects: tuple[str, ...] = ()
) -> str:
    """The light yield over all that the readings allow, and beside it that of the best fit.

    The best fit has the likeliest effects, if it is effects that are likeliest; where these are the
    `effects` that were added, it is that of their simulation. Empty where the campaign does not say
    how to get the light yield.
    """
    averaged = diagnosis.light_yield_averaged
    if averaged is None:
        return ""
    name, p = next(iter(diagnosis.probabilities.items()))
    likeliest, likely = likeliest_of(diagnosis), f"({probability(p)})"
    estimate = diagnosis.baseline.parameters.get(LIGHT_YIELD)
    best = "" if estimate is None else estimate_text(estimate)
    if likeliest is not None:
        if light := likeliest.light_yield_ph_per_keV:
            best = pdg(light["value"], light["sigma"])
        if simulated is not None and {*effects} == {*likeliest.effects}:
            best = estimate_text(simulated.parameters[LIGHT_YIELD])
        best += f" with {in_words(diagnosis, likeliest.effects)} {likely}"
    elif name == NOTHING_MISSING:
        best += f" with nothing missing {likely}"
    else:
        what = NO_EFFECTS.get(name, f"a {name}")
        best += f" with nothing missing; the likeliest is {what} {likely}"
    return (
        f"Light yield: {averaged}, averaged over all explanations and sizes that the readings "
        f"allow: {quoted(diagnosis)}; the best fit alone gives {best}"
    )


def quoted(diagnosis: Diagnosis) -> str:
    """Whether the averaged light yield is to be quoted: a mended campaign says so itself."""
    other = diagnosis.baseline.model.campaign.yield_to_quote
    if not other:
        return "the one to quote"
    return f"given what repair added; the one to quote is {other}"


def shares_text(diagnosis: Diagnosis) -> str:
    """What the readings leave probable, nothing and no catalogue's among it: of 100 % in all."""
    percents: dict[str, float] = {}
    for name, p in diagnosis.probabilities.items():
        if name != OTHERS and (p >= 0.01 or name in NO_EFFECTS):
            causes = name.split(" + ")
            what = " with ".join(NO_EFFECTS.get(c) or diagnosis.titles.get(c, c) for c in causes)
            percents[what] = round(100.0 * p, 0 if 0.0095 <= p <= 0.9905 else 1)
    left = round(100.0 - sum(percents.values()), 1)
    if not percents:
        return ""  # too few readings
    # less than nothing is rounding
    what = "all else" if left > 0.0 else next(iter(percents))
    percents[what] = percents.get(what, 0.0) + left
    return f"Of 100 %: {', '.join(f'{what} {percent:g} %' for what, percent in percents.items())}."


def family_probabilities(diagnosis: Diagnosis) -> str:
    """``surface 91 %, housing 4 %; others < 0.1 % each``; a set of two families is in both."""
    missing = (likely for likely in diagnosis.families if likely.family != NOTHING_MISSING)
    probabilities = {likely.family: probability(likely.probability) for likely in missing}
    nothing = probability(diagnosis.probabilities.get(NOTHING_MISSING, 0.0))
    likely_families = [
        f"{IN_NO_CATALOGUE if family == UNKNOWN else family} {p}"
        for family, p in probabilities.items()
        if not p.startswith("<")
    ]
    others = "; others < 0.1 % each" if len(likely_families) < len(probabilities) else ""
    return f"{', '.join([*likely_families, f'nothing missing {nothing}'])}{others}"


def capability_text(result: Diagnosis | Planning, readings: str = "such readings") -> str:
    """What readings could say of effects of usual sizes, in a sentence; or nothing."""
    can = result.capability
    if can is None or not can.named:
        return ""
    often = sorted((n for n, p in can.named.items() if p > 0.5), key=lambda n: -can.named[n])
    words = f"What {readings} can say: of {counted(len(can.named), 'effect')} of usual sizes they "
    words += f"would name {len(often)} more often than not"
    if often:
        pairs = zip(often, titles_of(result, often), strict=True)
        first = [f"{title} {probability(can.named[name])}" for name, title in pairs]
        words += f" ({', '.join(first[:MOST_NAMED])}{', ...' if len(first) > MOST_NAMED else ''})"
    words += f". A wrong one would be named in {probability(can.false)} of all campaigns"
    if can.light_yield_sigma is not None:
        words += f"; the light yield would be known to {percent(can.light_yield_sigma)}"
        words += ", the detector's efficiency not counted"
    return f"{words}."


def mistakable(diagnosis: Diagnosis) -> str:
    """What the leading effects, all together, could be mistaken for, in a sentence; or nothing.

    The likeliest are named, and how many there are besides.
    """
    leading, leading_effects = leading_candidates(diagnosis), _leading_effects(diagnosis)
    mimics = dict.fromkeys(name for candidate in leading for name in candidate.mimics)
    likeliest_first = dict.fromkeys((*(c.effect for c in diagnosis.candidates), *mimics))
    others = [name for name in likeliest_first if name in mimics and name not in leading_effects]
    if not others:
        return ""
    words = together(_some(diagnosis, list(leading_effects)))
    words += f" could be mistaken for {'each other and for ' if len(leading) > 1 else ''}"
    return f"By these readings {words}{together(_some(diagnosis, others), 'or')}."


def _some(diagnosis: Diagnosis, names: Sequence[str]) -> list[str]:
    """Titles of the first of some effects, and how many others there are."""
    # a few more are named, too
    shown = names if len(names) <= MOST_NAMED + 2 else names[:MOST_NAMED]
    left = len(names) - len(shown)
    return titles_of(diagnosis, shown) + ([f"{left} others"] if left else [])


def told_apart(diagnosis: Diagnosis, measurement: NextMeasurement) -> list[str]:
    """Pairs of leading explanations that a further reading tells apart, in words."""
    sets = diagnosis.leading_sets
    words = {" + ".join(names): " with ".join(titles_of(diagnosis, names)) for names in sets}
    return [" from ".join(words.get(name, name) for name in pair) for pair in measurement.separates]


def not_tried(diagnosis: Diagnosis) -> list[str]:
    """Effects that could not be fitted, each with the reason."""
    reasons = diagnosis.not_tried.items()
    return [f"{in_words(diagnosis, [name])} ({name}): {why}" for name, why in reasons]


def how_to_look(diagnosis: Diagnosis) -> list[str]:
    """How to look for the leading effects without a fit, a sentence or two for each."""
    look = {candidate.effect: candidate.look for candidate in diagnosis.candidates}
    looked_for = (name for name in list(_leading_effects(diagnosis))[:MOST_NAMED] if look.get(name))
    return [f"{capital(in_words(diagnosis, [name]))}: {look[name]}" for name in looked_for]


def _leading_effects(diagnosis: Diagnosis) -> dict[str, None]:
    """Ids of all leading effects, in the order of `leading_candidates`."""
    return dict.fromkeys(name for c in leading_candidates(diagnosis) for name in c.effects)


def set_aside_text(diagnosis: Diagnosis) -> str:
    """Why a repair does not add what is likeliest, its size or a doubt; empty where it does."""
    names = diagnosis.set_aside
    if not names:
        return ""
    fit, words = diagnosis.candidate(names), in_words(diagnosis, names)
    size = "" if fit is None else f" ({size_text(fit)})"
    if diagnosis.verdict == UNEXPLAINED:
        return (
            f"Of effects {words} would be needed{size}, which are not added: "
            f"{IN_NO_CATALOGUE} is likelier. If you have seen them, say --effect {','.join(names)}."
        )
    return (
        f"The likeliest explanation, {words}{size}, has a size that a laboratory does "
        f"not usually meet, and is not added. If you have seen it, say --effect {','.join(names)}."
    )


def suspicion(suspect: Suspect) -> str:
    """What may be wrong with readings, in a sentence: swapped, several wrong, or one."""
    left = f"{number(suspect.chi2)} (ndf {suspect.ndf}, {p_equals(suspect.p_value)})"
    gain = f"chi2 falls by {number(suspect.delta_chi2)} to {left}"
    chance = f"probability of as much by chance {p_text(suspect.p_gain)}"
    if suspect.kind == "swapped_rows":
        first, second = suspect.labels
        return f"{first} and {second} look swapped: with the two exchanged {gain}; {chance}"
    if suspect.kind == "swapped_treatments":
        look = f"the labels of all rows of {together(suspect.labels)} look swapped"
        return f"{look}: with these exchanged {gain}; {chance}"
    if len(suspect.labels) > 1:
        return f"{together(suspect.labels)} look wrong: without them {gain}; {chance}"
    off = "" if suspect.pull is None else f", {suspect.pull:+.1f} sigma from the others' prediction"
    return f"{suspect.labels[0]} looks wrong{off}: without it {gain}; {chance}"


def verdict_words(verdict: str) -> str:
    """``Too few readings``."""
    return capital(verdict.replace("_", " "))


def short_headline(diagnosis: Diagnosis) -> str:
    """The verdict in a few words: ``Air bubble in the gap explains the misfit``, ``Adequate``."""
    leading = leading_candidates(diagnosis)
    if diagnosis.verdict != MISSING_EFFECT or not leading:
        return verdict_words(diagnosis.verdict)
    effects = leading[0].effects
    verb = "explain" if len(effects) > 1 else "explains"
    p = leading[0].p_value
    how_much = "the misfit" if p is None or p >= ACCEPTABLE_P else "most of the misfit"
    return f"{capital(in_words(diagnosis, effects))} {verb} {how_much}"


def headline(diagnosis: Diagnosis, simulated: Calibration | None = None) -> str:
    """The verdict in a sentence: an effect with its size and what is gained, or the reason.

    Where the effect was `simulated`, with nothing else added, the numbers are that fit's.
    """
    leading = leading_candidates(diagnosis)
    if diagnosis.verdict != MISSING_EFFECT or not leading:
        of_trial = r": chi2 = [^;]* with the first" if simulated is not None else "^$"
        return f"{short_headline(diagnosis)}: {re.sub(of_trial, '', diagnosis.reason)}"
    best = leading[0]
    if simulated is not None:
        numbers = {name: getattr(simulated, name) for name in ("parameters", "chi2", "ndf")}
        best = replace(best, p_value=simulated.p_value, **numbers)
    return (
        f"{short_headline(diagnosis)} ({together(best.effects)}: {size_text(best)}): chi2 "
        f"{number(diagnosis.baseline.chi2)} -> {number(best.chi2)} "
        f"(ndf {best.ndf}, {p_equals(best.p_value)})"
    )


def quality(comparison: Comparison | Calibration) -> str:
    """chi2 beside what is expected, and what that means."""
    # an exact fit's chi2 is rounding
    chi2, ndf = number(round(comparison.chi2, 6)), comparison.ndf
    if comparison.p_value is None:
        words = f"chi2 = {chi2} without degrees of freedom: "
        if fails(comparison):
            return words + "the model does not describe the readings, from which bounds keep it"
        return (
            f"{words}the readings determine the parameters, but say nothing about whether the "
            "model is right"
        )
    expected = f"{ndf} ± {math.sqrt(2.0 * ndf):.1f} is expected (ndf = {ndf})"
    words = f"chi2 = {chi2} where {expected}, {p_equals(comparison.p_value)}: "
    if fails(comparison):
        return words + "the model does not describe the readings"
    if comparison.p_value > 1.0 - ACCEPTABLE_P / 10:
        return words + "the readings agree better than their errors allow: are these too large?"
    return words + "the model describes the readings"


def misfit_shares(comparison: Comparison) -> dict[str, float]:
    """Every used reading's part of the sum of squared pulls, by label, the largest first."""
    squares = {row.label: row.pull**2 for row in comparison.rows if row.use}
    total = sum(squares.values()) or 1.0  # an exact fit has no misfit to share out
    largest_first = sorted(squares.items(), key=lambda item: -item[1])
    return {label: square / total for label, square in largest_first}


def carriers(comparison: Comparison) -> str:
    """The fewest readings that make up half of the squared pulls, in a sentence."""
    shares = misfit_shares(comparison)
    sums = list(itertools.accumulate(shares.values()))
    last = next((place for place, part in enumerate(sums) if part >= 0.5), len(sums) - 1)
    readings = [f"{label} ({100 * part:.0f} %)" for label, part in shares.items()][: last + 1]
    few = f"{len(readings)} of {len(shares)} readings: {', '.join(readings)}"
    return f"{100 * sums[last]:.0f} % of the squared pulls are those of {few}"


def trend_text(trend: Trend) -> str:
    """How the pulls run along a bench parameter, in a sentence."""
    by_level = zip(trend.levels, trend.mean_pulls, strict=True)
    pulls = ", ".join(f"{short_text(level)}: {pull:+.1f}" for level, pull in by_level)
    words = f"mean pull along {trend.parameter}: {pulls}"
    if trend.p_value is None:
        return f"{words} (chi2 falls by {number(trend.delta_chi2)} without the trend)"
    clear = "a trend" if trend.p_value < 0.05 else "no clear trend"
    return f"{words} ({clear}, {p_equals(trend.p_value)})"


def limit_text(limit: Limit) -> str:
    """What adequate data allow of an effect, 95 %: ``< 0.3``; without a size, what chi2 says."""
    if limit.parameter is None or limit.excluded:
        change = f"chi2 {'rises' if limit.delta_chi2 < 0 else 'falls'} by "
        change += number(abs(limit.delta_chi2))
        return f"excluded ({change} with it)" if limit.excluded else f"not excluded ({change})"
    # beyond an infinite end there is no limit; where an end is None, none is to be had
    ends = limit.lower, limit.upper
    lower, upper = (end if end is not None and math.isfinite(end) else None for end in ends)
    if lower is None and upper is None:
        return "no limit within its range"
    if lower is None:
        return f"< {number(upper)}" + (" (no limit below)" if limit.lower is not None else "")
    if upper is None:
        return f"> {number(lower)}" + (" (no limit above)" if limit.upper is not None else "")
    return f"{number(lower)} to {number(upper)}"


def outcomes_text(measurement: NextMeasurement) -> str:
    """The light yield's error by outcomes: ``± 2.0 % in 7 of 10 outcomes, else ± 4.0 %``."""
    error, otherwise = measurement.light_yield_sigma, measurement.light_yield_sigma_otherwise
    if error is None or measurement.light_yield_kept is None:
        return "-"
    tenths = round(10.0 * measurement.light_yield_kept)
    if otherwise is None or tenths == 10:
        return f"± {percent(error)}"
    return f"± {percent(error)} in {tenths} of 10 outcomes, else ± {percent(otherwise)}"


#: Standard errors that hold 95 % of a Gaussian likelihood; over these, how near or far the ends of
#: an interval that holds as much may be.
_SIGMAS_95 = 1.96
_LIKE_PARABOLA = 2 / 3, 3 / 2


def shapes(profiles: Iterable[Profile]) -> list[str]:
    """What the standard error does not tell: 95 % intervals that are not twice as wide as it."""
    lines = []
    near, far = _LIKE_PARABOLA
    for profile in profiles:
        # an end is None where a bound cuts the interval off: it ends there, and may be near
        ends, bounds = profile.interval_95, profile.values[[0, -1]].tolist()
        interval = [bound if end is None else end for end, bound in zip(ends, bounds, strict=True)]
        parabola = [profile.value + sign * _SIGMAS_95 * profile.sigma for sign in (-1, 1)]
        widths = [abs(end - profile.value) / (_SIGMAS_95 * profile.sigma) for end in interval]
        pairs = zip(widths, ends, strict=True)
        if any(width > far or (width < near and end is not None) for width, end in pairs):
            real, of_sigma = (
                " to ".join(value_of(pdg(end, profile.sigma)) for end in pair)
                for pair in (interval, parabola)
            )
            lines.append(
                f"{profile.name}: the 95 % interval is {real}, not {of_sigma} as "
                f"{pdg(profile.value, profile.sigma)} would have it: chi2 does not rise like a "
                "parabola"
            )
    return lines


# What to measure next for the light yield, by the parts of its error.

# What contributions to an error are called, by origin; others by their origins.
_CALLED = {
    "counts": "the readings themselves",
    "statistical": "the readings themselves",
    "prior": "what is known beforehand",
    "plausible": "the size of what is missing",
    "absorption": "the absorption of the crystal",
    "detector_efficiency": "the detector's efficiency",
    "quantum efficiency curve": "the detector's quantum efficiency",
    "collection_efficiency": "the part of the photoelectrons that is counted",
    "crosstalk": "crosstalk and afterpulses",
    "tube scale": "the scale of the detector's efficiency",
    "emission spectrum": "the emission spectrum",
    "source depth": "the depth of the source",
    "photoelectron scale": "the channels per photoelectron",
    "pedestal": "pedestal, background and nonlinearity of the readings",
    "tolerances": "the bench's numbers",
    "tolerance": "the number",
    "monte_carlo": "the simulation",
}


def title_of(name: str) -> str:
    """A fitted parameter in words with its unit: ``light yield (ph/keV)``, ``scale of bar 2``."""
    if (of_one_sample := of_sample(name)) is not None:
        parameter, sample = of_one_sample
        words, bracket, unit = title_of(parameter).partition(" (")
        return f"{words} of {sample}{bracket}{unit}"
    # columns of tables are narrow
    return "light yield (ph/keV)" if name == LIGHT_YIELD else titled(name)


def quantity(name: str) -> str:
    """A fitted parameter in words without its unit, for what is told in per cent."""
    return title_of(name).partition(" (")[0]


def what_next(budget: ErrorBudget, of: str) -> str:
    """The largest reducible part of the error of a result, named `of`, and what helps; or ""."""
    # contributions come with the largest first
    part = next((part for part in budget.contributions if part.reducible), None)
    if part is None or not math.isfinite(budget.total) or not part.relative:
        return ""
    # such as "counts, air": an origin, and whose it is
    origin, _, owner = part.name.partition(", ")
    what = " of ".join(filter(None, (_CALLED.get(origin, origin), owner)))
    share, whole = percent(abs(part.relative)), percent(budget.total)
    verb = "simulate" if origin == "monte_carlo" else "measure"
    return (
        f"What to {verb} next: {what}: {share.removesuffix(' %')} of the {of}'s {whole}, in "
        f"quadrature. What helps: {part.by}."
    )


def which_eta(fit: Calibration) -> str:
    """Of which bench the efficiencies of a fit are; nothing where its numbers are as written."""
    if not any(abs(n.offset) > _NOTHING * n.tolerance.sigma for n in fit.offsets):
        return ""
    return (
        "eta is that of the bench whose numbers are off as the readings have them; simulate "
        "takes them as the scene says, and gives another"
    )


def next_for_fit(fit: Calibration, priors: Iterable[str]) -> str:
    """What to measure next for a fit's light yield or scale; nothing where it has no error."""
    name = LIGHT_YIELD if LIGHT_YIELD in fit.parameters else SCALE
    estimate = fit.parameters.get(name)
    if estimate is None or estimate.at_bound is not None or not estimate.value:
        return ""
    origin = "absorption" if list(priors) == [ALPHA_ABS] else "prior"
    return what_next(ErrorBudget(_parts(estimate, origin)), quantity(name))


def next_for_average(diagnosis: Diagnosis) -> str:
    """What to measure next for the averaged light yield; nothing where there is none."""
    averaged, likeliest = diagnosis.light_yield_averaged, likeliest_of(diagnosis)
    parameters = diagnosis.baseline.parameters if likeliest is None else likeliest.parameters
    estimate = parameters.get(LIGHT_YIELD)
    if averaged is None or estimate is None or estimate.at_bound is not None or not estimate.sigma:
        return ""
    # the error of the fits, shared out as in the likeliest; then what there is between the fits
    of_fit, within = ErrorBudget(_parts(estimate, "prior")), averaged.within / averaged.value
    parts = of_fit.contributions
    scaled = (replace(part, relative=part.relative * within / of_fit.total) for part in parts)
    between, catalogue = (part / averaged.value for part in (averaged.between, averaged.catalogue))
    other_reading = "a further reading that tells them apart"
    beside = (
        Contribution("which explanation is right", between, "systematic", True, by=other_reading),
        Contribution("what is in no catalogue", catalogue, "systematic", False, by=""),
    )
    return what_next(ErrorBudget((*scaled, *beside)), "averaged light yield")


def _parts(estimate: ParameterEstimate, prior: str) -> tuple[Contribution, ...]:
    """Contributions to a result's error, relative; what its priors make is called `prior`."""
    parts = dict(estimate.contributions)
    if estimate.efficiency_contributions and parts.pop("detector_efficiency", None):
        parts |= estimate.efficiency_contributions
    return tuple(
        contribution(prior if origin == "prior" else origin, part / estimate.value)
        for origin, part in parts.items()
    )


# What a planning found, in sentences.

# Parts of an error that make less than this of its square are not named.
_NAMED = 0.03
# By origin, what lowers it.
_MENDS = {
    EFFICIENCY: (
        "a detector whose quantum efficiency is calibrated better, or a comparison with a crystal "
        "of known light yield (mcrim lab relative)"
    ),
    "quantum efficiency curve": (
        "a quantum-efficiency curve of this very detector, measured better, or a comparison with a "
        "crystal of known light yield (mcrim lab relative)"
    ),
    "emission spectrum": "an emission spectrum measured better",
    SO_FAR: "the same readings made once more",
    EVENTS_ORIGIN: "more events in each histogram",
    MOUNTINGS_ORIGIN: "more mountings of each coupling",
    PRIOR + ALPHA_ABS: (
        "a transmittance measured better (mcrim lab absorption), or more couplings, which "
        "determine the absorption themselves"
    ),
}


def verdict(planning: Planning) -> tuple[str, ...]:
    """The cheapest plan; or what forbids the wanted error, and what of its statistical part."""
    wanted, plan = percent(planning.wanted), planning.cheapest
    if (now := planning.so_far) is not None and now.total <= planning.wanted:
        return (f"The readings so far have the light yield to {percent(now.total)}: enough.",)
    if plan is not None:
        return (f"Cheapest plan for a light yield to {wanted}: {plan_text(planning, plan)}",)
    couplings, floor = planning.lowest_floor
    impossible = floor.total > planning.wanted
    text = _forbidden(planning, couplings, floor) if impossible else _not_among_these(planning)
    if (plan := planning.cheapest_statistical) is not None:
        alone = f"The statistical part alone reaches {wanted} with {plan_text(planning, plan)}"
    else:
        plan = min(planning.plans, key=lambda p: p.light_yield.statistical)
        alone = f"Nor does the statistical part alone: the least is {plan_text(planning, plan)}"
    return text, alone


def plan_text(planning: Planning, plan: Plan, more: int = 0) -> str:
    """``n_gap = 1, 1.46; 4 mountings of 10,000 events each: 5 h, light yield to 10.6 % (...)``.

    `more` digits of the light yield's error than usual may be asked for.
    """
    light, scattering = plan.light_yield, plan.alpha_scat
    count = counted(plan.mountings, "mounting")
    text = (
        f"{planning.name(plan.configurations)}; {count} of {plan.events:,.0f} events each: "
        f"{plan.hours:.1f} h, light yield to {percent(light.total, more)} (statistical "
        f"{percent(light.statistical)}, systematic {percent(light.systematic)})"
    )
    return text if scattering is None else f"{text}, scattering to {percent(scattering.total)}"


def rehearsal_text(planning: Planning) -> str:
    """What the proposed plan could name of missing effects, in a sentence; or that none shows."""
    plan = planning.proposed
    also = "" if planning.so_far is None else "those so far and of "
    readings = f"readings of {also}{planning.name(plan.configurations)}"
    if planning.capability is None:  # what determines all parameters lacks one reading, no more
        return (
            f"No missing effect could show in {readings}: none is left to check the model with. "
            "That takes one more, with another coupling, mask or height."
        )
    mountings = f"{counted(plan.mountings, 'mounting')} of {plan.events:,.0f} events each"
    return capability_text(planning, f"{readings} ({mountings})")


def _forbidden(planning: Planning, couplings: tuple[int, ...], floor: ExpectedError) -> str:
    """That readings of these couplings without error would not do, and what forbids it first."""
    parts = sorted(((part, origin) for origin, part in floor.parts.items()), reverse=True)
    largest = parts[0][1]
    more = _digits_apart(planning.wanted, floor.total)
    large = [(part, origin) for part, origin in parts if part**2 > _NAMED * floor.total**2]
    makes = together([f"{origin} {percent(part)}" for part, origin in large])
    text = (
        f"A light yield to {percent(planning.wanted, more)} cannot be reached, however many events "
        f"and mountings: readings without error ({planning.name(couplings)}) would leave "
        f"{percent(floor.total, more)} ({makes}). What forbids it first is the {largest}"
    )
    # the least variance that all other parts leave
    others = min(p.light_yield.total**2 - p.light_yield.parts[largest] ** 2 for p in planning.plans)
    if others < planning.wanted**2:
        needed = percent(math.sqrt(planning.wanted**2 - others))
        text += f": with the most precise of these plans it would have to fall to {needed}"
    else:
        text += ", and it is not the only part that is too large"
    return f"{text}. It is reduced by {_mend(largest)}"


def _not_among_these(planning: Planning) -> str:
    """That more statistics would do: the most precise plan, and what of it to improve first."""
    least = min(planning.plans, key=lambda p: p.light_yield.total)
    parts = least.light_yield.parts.items()
    parts_of_plan = {
        origin: part for origin, part in parts if origin in STATISTICAL or origin.startswith(PRIOR)
    }
    largest = max(parts_of_plan, key=parts_of_plan.__getitem__)
    more = _digits_apart(planning.wanted, least.light_yield.total)
    return (
        f"A light yield to {percent(planning.wanted, more)} is not among these plans; the most "
        f"precise is {plan_text(planning, least, more)}. What it would take first: {_mend(largest)}"
    )


def _mend(origin: str) -> str:
    """What lowers the part of an error with this origin, such as ``prior of alpha_abs_per_cm``."""
    if origin.startswith(PRIOR):
        return _MENDS.get(origin, f"{origin.removeprefix(PRIOR)} measured better by other means")
    return _MENDS.get(origin, _MENDS[EFFICIENCY])


def _digits_apart(first: float, second: float) -> int:
    """Digits that `percent` needs besides the usual ones to tell two fractions apart."""
    return next((more for more in range(6) if percent(first, more) != percent(second, more)), 0)


# Sentences of the report, for readers who did not do the measurement.

#: What the usual parameters are, and their units.
NAMES = {
    LIGHT_YIELD: ("light yield", "photons per keV"),
    SCALE: ("scale: signal per unit of efficiency", "unit of the readings"),
    ALPHA_SCAT: ("scattering coefficient of the crystal", "1/cm"),
    ALPHA_ABS: ("absorption coefficient of the crystal", "1/cm"),
}
#: What has no name, in words.
IN_NO_CATALOGUE = NO_EFFECTS[UNKNOWN]
#: Leading effects that are named in a sentence and explained; tables have all.
MOST_NAMED = 4
#: Effects and pairs of them that a table or figure shows, besides the leading ones.
MOST_EFFECTS = 12
MOST_PAIRS = 6
_REPEATING_LOWERS = ("statistical", "monte_carlo")
#: Part of an error that is not worth a digit.
_NOTHING = 1e-3


def parameter_words(campaign: Campaign, name: str) -> tuple[str, str]:
    """Meaning and unit of a fitted parameter: a usual one, of a sample, an effect or the scene."""
    if name in NAMES:
        meaning, unit = NAMES[name]
        return meaning, campaign.unit if name == SCALE and campaign.unit else unit
    if name == EFFICIENCY_FACTOR:
        return "factor on the detector's efficiency, one for all samples", ""
    of_one_sample = of_sample(name)
    if of_one_sample is not None and of_one_sample[1] in campaign.samples:
        parameter, sample = of_one_sample
        meaning, unit = parameter_words(campaign, parameter)
        return f"{meaning}, of {sample}", unit
    for effect in campaign.catalogue.values():
        for effect_parameter in effect.parameters:
            if effect_parameter.name == name:
                return effect_parameter.meaning, effect_parameter.unit
    # the author of the scene may have written what it is
    default = campaign.scene.defaults.get(name)
    return (default.comment if default else ""), unit_of(name) or ""


def errors_apart(estimate: ParameterEstimate) -> tuple[float, float]:
    """Statistical error, which repeating the measurement or the simulation lowers; systematic."""
    origins = estimate.contributions
    return (
        math.hypot(*(origins.get(origin, 0.0) for origin in _REPEATING_LOWERS)),
        math.hypot(*(part for origin, part in origins.items() if origin not in _REPEATING_LOWERS)),
    )


def value_with_errors(estimate: ParameterEstimate) -> str:
    """``7.8 ± 0.2 ± 0.8``: statistical first, systematic second; at a bound the value alone."""
    if estimate.at_bound is not None:
        return f"{estimate.value:.4g}, at the end of its range"
    if not math.isfinite(estimate.sigma):
        return pdg(estimate.value, None)
    # what does not count is none: 0.039 ± 0 ± 0.012
    parts = (part if part > _NOTHING * estimate.sigma else 0.0 for part in errors_apart(estimate))
    return pdg_parts(estimate.value, *parts)


def interval(estimate: ParameterEstimate) -> str:
    """Ends of the interval, in one more digit than its width deserves; ``-`` where not known."""
    if estimate.lower is None or estimate.upper is None:
        return "-"
    width = estimate.upper - estimate.lower
    if not 0 < width < math.inf:
        return f"{number(estimate.lower, 4)} to {number(estimate.upper, 4)}"
    # half the width is an error: a tenth of that has one digit more
    ends = (pdg(end, width / 20) for end in (estimate.lower, estimate.upper))
    return " to ".join(map(value_of, ends))


def value_of(text: str) -> str:
    """The value of ``1.23 ± 0.05``, of ``(1.23 ± 0.05)e7`` with its power of ten: ``1.23e7``."""
    value, _, sigma = text.partition(" ± ")
    _, bracket, power = sigma.partition(")")
    return f"{value.lstrip('(')}{power}" if bracket else value


def gain_text(candidate: Candidate) -> str:
    """Fall of χ² with an effect, and the simulation's error; what is not worth a digit is 0."""
    if max(abs(candidate.delta_chi2), candidate.delta_chi2_sigma) < _NO_GAIN:
        return "0"
    sigma = candidate.delta_chi2_sigma
    return pdg(candidate.delta_chi2, max(sigma, _NO_GAIN) if sigma else None)


def pull_text(pull: float) -> str:
    """``+1.23``; what vanishes has no sign."""
    return f"{pull:+.2f}".replace("+0.00", "0.00").replace("-0.00", "0.00")


def reliability(diagnosis: Diagnosis, fit: Calibration, effects: tuple[str, ...]) -> str:
    """How far the numbers of a fit with these effects can be believed."""
    words = f"{capital(quality(fit))}."
    if fails(fit):
        if diagnosis.light_yield_averaged is not None:
            return f"Only the averaged light yield: all other errors know nothing of it. {words}"
        return f"Do not quote these numbers, whose errors know nothing of it. {words}"
    if not effects:
        return words
    added = in_words(diagnosis, effects)
    if diagnosis.verdict == AMBIGUOUS:
        several = "one explanation of several; the numbers hold only if it is the right one"
        return f"{words} But {added} is {several}."
    return f"{words} This holds with {added} added to the bench."


def beam_doubt(campaign: Campaign, calibration: Calibration) -> str:
    """What speaks against the scattering that was found; empty where nothing does."""
    estimate = calibration.parameters.get(ALPHA_SCAT)
    if campaign.raw is None or estimate is None:
        return ""
    return " ".join(f"But {note}." for note in beam_notes(campaign.raw, estimate.value))
