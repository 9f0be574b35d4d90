"""Results on campaigns described as tables and sentences, which terminal, report and page show.

What is known of a fitted parameter, a reading, an explanation, a limit, a proposal, a step of a
repair or a part of an error is worded by one function. Results, the report and the page are lists
of what these give. A `Cell` is a text with the number behind it and its error, which data frames
have; a `Column` says what it shows of a record.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.tolerances import USUAL
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, titled
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
)
from mcrim_mitsuba.effects.effect import BenchNumber
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow, ParameterEstimate
from mcrim_mitsuba.output import sentences
from mcrim_mitsuba.output.description import (
    Cell,
    Column,
    Description,
    Piece,
    Sentence,
    Table,
    described,
    listed,
    measured,
    records,
    row,
    shown,
    strong,
    table,
)
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path

if TYPE_CHECKING:
    from mcrim_mitsuba.inference.budget import Budget
    from mcrim_mitsuba.inference.candidates import Candidate
    from mcrim_mitsuba.inference.compare import Comparison, Suspect
    from mcrim_mitsuba.inference.corrections import Shift
    from mcrim_mitsuba.inference.diagnose import Diagnosis, RepairStep
    from mcrim_mitsuba.inference.fit import Calibration
    from mcrim_mitsuba.inference.hypotheses import FittedHypothesis
    from mcrim_mitsuba.inference.next_measurements import NextMeasurement
    from mcrim_mitsuba.inference.plan import Planning
    from mcrim_mitsuba.inference.profiles import Profile
    from mcrim_mitsuba.laboratory.error_budget import Contribution, ErrorBudget
    from mcrim_mitsuba.output import campaign_results as results


def _spent(result: results.CampaignShown) -> dict[str, Any]:
    """What a result rests on, and what the reader must know: options of `described`."""
    work = result.provenance
    return {
        "spent": f"{work.photons:,} photons ({work.cached_photons:,} of the cache), seed "
        f"{work.seed}, {work.seconds:.1f} s",
        "notes": result.notes,
    }


# A fitted parameter.

#: What parameters are called in files, and by programs.
_TYPED = Column("id", "id", left=True, small=True)
_ORIGINS = ("statistical", "prior", "monte_carlo", "detector_efficiency")


#: Of the bench, with tolerances.
_NUMBERS = (
    Column("number", of=lambda n: Cell(_number_words(n.tolerance.number), n.tolerance.number.name)),
    Column("tolerance", of="tolerance.sigma", form=".2g"),
    Column("off, by the readings", "offset", of=lambda n: measured(n.offset, n.sigma)),
    Column(
        "of the light yield", "of_scale", form=lambda part: "-" if part is None else percent(part)
    ),
)


def _title(name: str) -> Cell:
    """A fitted parameter in words, and its name for data frames."""
    return Cell(sentences.title_of(name), name)


def estimated(estimate: ParameterEstimate | None) -> Cell:
    """A parameter with its error; nothing where a model has none of it."""
    if estimate is None:
        return Cell("")
    # at a bound sigma is no error: it knows nothing of the bound
    sigma = None if estimate.at_bound else estimate.sigma
    return Cell(sentences.estimate_text(estimate), estimate.value, sigma)


def parameters_table(
    parameters: Mapping[str, ParameterEstimate],
    profiles: Iterable[Profile] = (),
    meanings: Mapping[str, str] | None = None,
) -> Table:
    """Every parameter with its error and its 68.3 % interval.

    With `meanings` by parameter, which may be an empty mapping, the statistical and the systematic
    error are shown too. Data frames have them anyhow, and the ends of intervals, those of 95 % too
    where there are profiles.
    """
    intervals_95 = {profile.name: profile.interval_95 for profile in profiles}
    columns = (
        "parameter",
        *([Column("meaning", left=True)] if meanings else []),
        "value",
        *(Column(kind, hidden=meanings is None) for kind in ("statistical", "systematic")),
        "68.3 % interval",
        *(Column(end, hidden=True) for end in ("lower", "upper", "lower_95", "upper_95")),
        _TYPED,
    )
    rows = []
    for name, estimate in parameters.items():
        errors: tuple[float | None, ...] = (None, None)
        if estimate.at_bound is None and estimate.contributions:
            errors = sentences.errors_apart(estimate)
        ends = (estimate.lower, estimate.upper, *intervals_95.get(name, (None, None)))
        of_kinds = (shown(error, lambda e: "" if e is None else number(e, 2)) for error in errors)
        interval = (sentences.interval(estimate), *(Cell("", end) for end in ends))
        first = (_title(name), *([meanings[name]] if meanings else []), estimated(estimate))
        rows.append((*first, *of_kinds, *interval, name))
    return table("parameters", columns, rows)


def _shapes(profiles: Iterable[Profile]) -> Iterator[Piece]:
    """A line for each 95 % interval that its standard error does not tell."""
    return (strong(f"- {words}") for words in sentences.shapes(profiles))


def _number_words(number: BenchNumber) -> str:
    return titled(number.parameter) if number.value is None else number.words


def numbers_of_bench(fit: Calibration) -> Iterator[Piece]:
    """The bench's numbers that matter, how far off the readings have them, and what of others."""
    scale = fit.parameters.get(SCALE)
    relative = scale.sigma / scale.value if scale and scale.value and not scale.at_bound else 0.0
    matter = [number for number in fit.offsets if number.matters(relative)]
    if matter:
        yield records("numbers of the bench", _NUMBERS, matter)
    if others := len(fit.offsets) - len(matter):
        left = counted(others, "more number" if matter else "number")
        yield (
            f"{left} of the bench with usual uncertainties ({USUAL}; [tolerances] says otherwise) "
            f"matter{'s' if others == 1 else ''} little"
        )


def _origins(fit: Calibration) -> Iterator[Piece]:
    """Where the errors of a fit come from; parameters at a bound have none that mean anything."""
    named = {origin for estimate in fit.parameters.values() for origin in estimate.contributions}
    origins = (*_ORIGINS, *(name for name in ("pedestal", "tolerances") if name in named))
    columns = ("parameter", *(name.replace("_", " ") for name in origins))
    rows = []
    for name, estimate in fit.parameters.items():
        parts = {} if estimate.at_bound else estimate.contributions
        rows.append((_title(name), *(shown(parts.get(origin), ".2g") for origin in origins)))
    yield table("where the errors come from", columns, rows)
    yield from numbers_of_bench(fit)
    light = fit.parameters.get(LIGHT_YIELD)
    if light is not None and light.efficiency_contributions:
        words = (f"{name} {part:.2g}" for name, part in light.efficiency_contributions.items())
        yield f"detector efficiency in {sentences.title_of(LIGHT_YIELD)}: {', '.join(words)}"


# A reading beside what a model predicts.


def _signal(of_beam: bool, value: float, sigma: float) -> Cell:
    return Cell(sentences.signal_text(of_beam, value, sigma), value, sigma)


_READING = (
    Column("reading", of=sentences.reading_label),
    Column("measured", of=lambda row: _signal(row.of_beam, row.measured, row.sigma)),
    Column("model", of=lambda row: _signal(row.of_beam, row.model, row.model_sigma)),
    Column("pull", form="+.2f"),
)
# a closed form, such as that of a beam, has no error
_ETA = Column("eta (simulation's error)", "eta", of=lambda r: measured(r.eta, r.eta_sigma or None))


def fitted_readings(
    rows: Iterable[FittedRow], *further: Column, suspects: Collection[str] = ()
) -> Table:
    """Readings beside a fit, with the efficiencies behind its predictions or `further` columns.

    Suspects, by their labels, are to be looked at first.
    """
    looks = {"strong": lambda row: row.label in suspects, "weak": lambda row: not row.use}
    return records("readings", (*_READING, *(further or [_ETA])), rows, **looks)


def compared_readings(comparison: Comparison) -> Table:
    """Readings beside predictions, also those from all others, and which carry the misfit."""
    shares, left_out = sentences.misfit_shares(comparison), comparison.left_out_pulls
    suspects = {label for suspect in comparison.suspects for label in suspect.labels}
    others = Column(
        "pull from the others", "left_out_pull", of=lambda r: shown(left_out.get(r.label), "+.2f")
    )
    misfit = Column(
        "of the misfit", "part_of_misfit", of=lambda r: shown(shares.get(r.label), _whole_percent)
    )
    return fitted_readings(comparison.rows, others, misfit, suspects=suspects)


def _whole_percent(part: float | None) -> str:
    return "" if part is None else f"{100.0 * part:.0f} %"


def misfit_pieces(comparison: Comparison) -> list[Piece]:
    """What chi2 says, which readings and trends carry the misfit, and what may have taken it up."""
    fails, absorbed = sentences.fails(comparison), (fitted.words for fitted in comparison.absorbed)
    return [
        strong(sentences.quality(comparison)),
        listed([sentences.carriers(comparison)] if fails else []),
        listed(sentences.beam_conflict(comparison)),
        suspects_pieces(comparison.suspects),
        listed(map(sentences.trend_text, comparison.trends)),
        listed(absorbed, "Fitted parameters that may have taken up a misfit:"),
    ]


def suspects_pieces(suspects: Sequence[Suspect]) -> Iterator[Sentence]:
    """Readings that may be wrong."""
    heading = "Look at these readings before physics is blamed:"
    return listed(map(sentences.suspicion, suspects), heading)


def of_fit(fit: results.FitResult) -> Description:
    """Parameters, where their errors come from, readings beside the model, what it took."""
    light, result = fit.parameters.get(LIGHT_YIELD), ""
    if light is not None:
        doubt = ", but the model does not describe the readings" if sentences.fails(fit) else ""
        result = f"Light yield: {sentences.estimate_text(light)} ph/keV{doubt}"
    chance = "no p-value without degrees of freedom"
    if fit.p_value is not None:
        chance = p_equals(fit.p_value)
    return described(
        "fit of a campaign",
        strong(result),
        parameters_table(fit.parameters, fit.profiles),
        _shapes(fit.profiles),
        _origins(fit),
        strong(sentences.next_for_fit(fit, fit.model.campaign.priors)),
        fitted_readings(fit.rows),
        sentences.which_eta(fit),
        f"chi2 = {fit.chi2:.3g}, ndf = {fit.ndf}, {chance}; {fit.provenance.photons:,} photons "
        f"in {len(fit.rows)} readings, seed {fit.provenance.seed}, {fit.seconds:.1f} s",
        notes=fit.notes,
    )


def of_comparison(comparison: results.ComparisonResult) -> Description:
    """Readings beside predictions, what chi2 says, and where the misfit lies."""
    quality, *misfit = misfit_pieces(comparison)
    pieces = (quality, compared_readings(comparison), misfit)
    parameters = parameters_table(comparison.parameters)
    return described("a campaign beside its model", *pieces, parameters, **_spent(comparison))


# Hypotheses, and fits of the page, side by side.

_LEGEND_OF_HYPOTHESES = (
    "ln evidence: natural logarithm of the likelihood averaged over plausible sizes, less that of "
    "the best; probability: among those compared, each as likely as the others before the "
    "readings; left out: rms error on readings left out of the fit, in standard errors; light "
    "yield: photons per keV, with the statistical and the systematic error"
)
#: Of fits and hypotheses; then of hypotheses alone.
_FIGURES = (
    Column("chi2", form=number),
    Column("ndf", form="d"),
    Column("p", form=p_text, of="p_value"),
)


def _log_evidence(hypothesis: FittedHypothesis) -> Cell:
    """Relative to the best hypothesis, which has 0 without an error."""
    value, sigma = hypothesis.log_evidence, hypothesis.log_evidence_sigma
    return measured(value, sigma) if sigma else Cell("0", value)


def _light(hypothesis: FittedHypothesis) -> Cell:
    light = hypothesis.parameters.get(LIGHT_YIELD)
    if light is None:
        return Cell("")
    return Cell(sentences.value_with_errors(light), light.value, light.sigma)


_FIGURES_OF_HYPOTHESES = (
    *_FIGURES,
    Column("left out", form=number, of="left_out_error"),
    Column("ln evidence", of=_log_evidence),
    Column("probability", form=probability),
    Column("light yield", of=_light),
)


def side_by_side(
    title: str, columns: Iterable[Column], beside: Mapping[str, Any], first: str | Column = ""
) -> Table:
    """A table turned round: a column for each record of `beside`, a row for each of `columns`.

    `beside` has the records by what their columns are called; the column of titles is `first`. Rows
    that say nothing of any record are left out.
    """
    rows = (row(column.title, *map(column.cell, beside.values())) for column in columns)
    filled = (line for line in rows if any(cell.text for cell in line.cells[1:]))
    return table(title, (first, *beside), filled)


def sizes_beside(
    beside: Mapping[str, Any], without: Sequence[str] = (), *, typed: bool = False
) -> Table:
    """Parameters of several fits beside each other, those that a fit holds too; ids if `typed`."""

    def held(fit: Any) -> Mapping[str, float]:
        return getattr(fit, "fixed", {})  # hypotheses have none

    def cell(fit: Any, name: str) -> Cell:
        if name in held(fit):
            return Cell(f"{held(fit)[name]:.4g}, held", held(fit)[name])
        return estimated(fit.parameters.get(name))

    fits = beside.values()
    every_name = dict.fromkeys(name for fit in fits for name in (*fit.parameters, *held(fit)))
    names = [name for name in every_name if name not in without]
    rows = ((_title(name), *(cell(fit, name) for fit in fits), *([name] * typed)) for name in names)
    return table("sizes", ("parameter", *beside, *([_TYPED] * typed)), rows)


def of_hypotheses(compared: results.HypothesesResult) -> Description:
    """The verdict, what the readings say of each hypothesis, sizes, pulls and predictions."""
    beside = {hypothesis.name: hypothesis for hypothesis in compared.hypotheses}
    most, pulls, predictions = sentences.most_apart(compared), [], []
    # one reading after the other, each beside the predictions of all hypotheses
    for readings in zip(*(hypothesis.rows for hypothesis in compared.hypotheses), strict=True):
        label, measured_cell, *_ = (column.cell(readings[0]) for column in _READING)
        apart, leads = compared.apart[readings[0].label], readings[0].label in most
        cells = (shown(reading.pull, "+.2f") for reading in readings)
        pulls.append(row(label, *cells, shown(apart, ".1f"), strong=leads))
        cells = (Cell(sentences.prediction_text(x), x.model, x.model_sigma) for x in readings)
        predictions.append(row(label, measured_cell, *cells, strong=leads))
    return described(
        "hypotheses side by side",
        strong(f"{sentences.verdict_words(compared.verdict)}: {compared.reason}"),
        (f"{name}: {sentences.hypothesis_text(fitted)}" for name, fitted in beside.items()),
        side_by_side("hypotheses", _FIGURES_OF_HYPOTHESES, beside, Column("", "quantity")),
        _LEGEND_OF_HYPOTHESES,
        sizes_beside(beside, (LIGHT_YIELD,)),
        strong(sentences.apart_text(compared)),
        table("pulls", ("reading", *beside, "apart"), pulls),
        "apart: largest difference of two predictions, in standard errors of the reading",
        table("predictions", ("reading", "measured", *beside), predictions),
        **_spent(compared),
    )


# Explanations of a misfit, how large each may be, what to measure next.

_ID = Column("id", "effect", left=True, small=True)
_LIGHT = Column("light yield", LIGHT_YIELD)
_LEGEND_OF_EXPLANATIONS = (
    "probability: among all that was tried and nothing, averaged over plausible sizes, with what "
    "adds nothing to it; Bayes factor: what the readings do to the odds of the effect alone; "
    "{}gain: fall of chi2, with the simulation's error; p, fit: of the fit with the effect; left "
    "out: rms error on readings left out of the fit, in standard errors"
)
_LEGEND_OF_LIGHT = "light yield: photons per keV, and its change; "


def _size(candidate: Candidate) -> Cell:
    """All sizes of an effect or a pair; a data frame has a row for each."""
    cells = [estimated(estimate) for estimate in candidate.sizes.values()]
    sigmas = tuple(cell.sigma for cell in cells if not isinstance(cell.sigma, tuple))
    values = tuple(cell.value for cell in cells)
    return Cell(sentences.size_text(candidate, "\n"), values or None, sigmas or None)


def _yield_with(candidate: Candidate) -> Cell:
    """The light yield with an effect, and by how much it differs from that without."""
    light = candidate.light_yield_ph_per_keV
    if not light:
        return Cell("")
    change = light.get("change")
    in_brackets = "" if change is None else f" ({100 * change:+.1f} %)"
    in_brackets = in_brackets.replace("+0.0 %", "0.0 %").replace("-0.0 %", "0.0 %")
    # as many digits as its error deserves, zeros too
    value = sentences.value_of(pdg(light["value"], light.get("sigma")))
    return Cell(value + in_brackets, light["value"], light.get("sigma"))


def _gain(candidate: Candidate) -> Cell:
    sigma = candidate.delta_chi2_sigma or None
    return Cell(sentences.gain_text(candidate), candidate.delta_chi2, sigma)


def _bayes_factor(candidate: Candidate) -> Cell:
    """Of the readings with an effect over those without any, whatever the odds before them."""
    log = candidate.log_evidence
    text = number(math.exp(log)) if abs(log) < 7.0 else f"1e{log / math.log(10.0):+.0f}"
    return Cell(text, log)


def _has_light_yield(candidates: Sequence[Candidate]) -> bool:
    return any(candidate.light_yield_ph_per_keV is not None for candidate in candidates)


def candidates_table(diagnosis: Diagnosis, candidates: Sequence[Candidate], heading: str) -> Table:
    """Effects, or pairs of them, as explanations; bold what leads; yields where they are known."""
    leading, probabilities = sentences.leading_candidates(diagnosis), diagnosis.probabilities

    def title(candidate: Candidate) -> str:
        return capital(" + ".join(sentences.titles_of(diagnosis, candidate.effects)))

    def likely(p: float | None) -> str:
        return "" if p is None else probability(p)

    columns = (
        Column("effect", "title", of=title),
        Column("probability", of=lambda c: shown(probabilities.get(c.effect), likely)),
        Column("Bayes factor", "log_evidence", of=_bayes_factor),
        Column("", "parameter", of=lambda c: Cell("", tuple(c.sizes) or None), hidden=True),
        Column("size", of=_size, left=True),
        Column("plausible?", "plausibility", of=sentences.plausibility, left=True),
        replace(_LIGHT, of=_yield_with, hidden=not _has_light_yield(candidates)),
        Column("gain in chi2", "delta_chi2", of=_gain),
        Column("p, fit", "p_value", p_text),
        Column("left out", "left_out_error", number),
        _ID,
    )
    return records(heading, columns, candidates, strong=lambda candidate: candidate in leading)


def explanation_tables(diagnosis: Diagnosis) -> list[Table]:
    """Effects alone and in pairs, the likeliest first."""
    titles = "effects, each added alone", "the best pairs of effects"
    return [
        candidates_table(diagnosis, sentences.likeliest_first(diagnosis, tried), title)
        for title, tried in zip(titles, (diagnosis.candidates, diagnosis.pairs), strict=True)
    ]


def explanation_pieces(diagnosis: Diagnosis) -> list[Piece]:
    """What columns of explanations mean, families of effects, and what is alike."""
    families = f"By family (they may act together): {sentences.family_probabilities(diagnosis)}"
    of_light = _LEGEND_OF_LIGHT if _has_light_yield(diagnosis.candidates) else ""
    return [
        _LEGEND_OF_EXPLANATIONS.format(of_light) if diagnosis.candidates else "",
        families if diagnosis.families else "",
        sentences.mistakable(diagnosis),
        sentences.capability_text(diagnosis),
    ]


def others_table(diagnosis: Diagnosis, simulated: Calibration, effects: tuple[str, ...]) -> Table:
    """What the result would be with the first leading explanations; no rows where it is not fitted.

    With the `effects` that were added it is that of their simulation.
    """

    def parameters(candidate: Candidate) -> Mapping[str, ParameterEstimate]:
        return (simulated if candidate.effects == effects else candidate).parameters

    def column(title: str, name: str) -> Column:
        return Column(title, name, of=lambda c: estimated(parameters(c).get(name)))

    columns = (
        Column("explanation", of=lambda c: sentences.in_words(diagnosis, c.effects)),
        column("light yield (photons per keV)", LIGHT_YIELD),
        column("scattering (1/cm)", ALPHA_SCAT),
    )
    leading = sentences.leading_candidates(diagnosis)
    fitted = [c for c in leading if {LIGHT_YIELD, ALPHA_SCAT} & parameters(c).keys()]
    return records("with each of the explanations", columns, fitted[: sentences.MOST_PAIRS])


def _brief(effects: Table, diagnosis: Diagnosis) -> Iterator[Piece]:
    """A table of effects, ids in its last column, of which likely ones are seen; how many not."""
    unlikely = sentences.likeliest_first(diagnosis, diagnosis.candidates)[sentences.MOST_EFFECTS :]
    unlikely += sentences.likeliest_first(diagnosis, diagnosis.pairs)[sentences.MOST_PAIRS :]
    leading = {candidate.effect for candidate in sentences.leading_candidates(diagnosis)}
    hidden = {candidate.effect for candidate in unlikely} - leading
    named = [(line, str(line.cells[-1].value).partition(".")[0]) for line in effects.rows]
    rows = [replace(line, hidden=name in hidden) for line, name in named]
    yield replace(effects, rows=tuple(rows))
    if more := sum(line.hidden for line in rows):
        yield (
            f"and {more} more, less likely than these: the file of --json has all {len(rows)}, "
            "and so has to_dataframe in Python"
        )


def limits_table(diagnosis: Diagnosis) -> Table:
    """How large each effect may be, where the readings need none."""
    columns = (
        Column("effect", "title"),
        Column("", "lower", hidden=True),
        Column("size", "upper"),
        Column("", "excluded", hidden=True),
        Column("parameter", left=True, small=True),
        _ID,
    )
    rows = []
    for effect, limit in diagnosis.upper_limits.items():
        words = capital(sentences.in_words(diagnosis, [effect]))
        size = Cell(sentences.limit_text(limit), limit.upper)
        ends = (Cell("", limit.lower), size, Cell("", limit.excluded))
        rows.append((words, *ends, Cell(limit.parameter or "on or off", limit.parameter), effect))
    return table("what the readings allow, 95 % confidence", columns, rows)


def proposals_table(diagnosis: Diagnosis) -> Table:
    """What to measure next, and what it would tell."""

    def told_apart(measurement: NextMeasurement) -> str:
        return "; ".join(sentences.told_apart(diagnosis, measurement))

    def yield_to(measurement: NextMeasurement) -> Cell:
        return Cell(sentences.outcomes_text(measurement), measurement.light_yield_sigma)

    columns = (
        Column("what to do", of="words"),
        Column("time", "hours", lambda hours: f"{hours:.2g} h"),
        Column("yield to", "light_yield_sigma", of=yield_to, left=True),
        Column("sure to", "probability", _whole_percent),
        Column("gain in chi2", "expected_delta_chi2", number),
        Column("tells apart", "separates", of=told_apart, left=True),
    )
    return records("what to measure next", columns, diagnosis.next_measurements)


def of_diagnosis(diagnosis: results.DiagnosisResult) -> Description:
    """The verdict, the averaged yield, effects as explanations, limits, what to measure next."""
    next_for_average = sentences.next_for_average(diagnosis)
    if diagnosis.next_measurements:  # by another name than the table of further readings
        beginning = "^What to (measure|simulate) next:"
        next_for_average = re.sub(beginning, "Largest part of the error:", next_for_average)
    return described(
        "what explains a campaign's misfit",
        strong(sentences.headline(diagnosis)),
        sentences.shares_text(diagnosis),
        strong(sentences.averaged_yield(diagnosis)),
        f"Without any effect {sentences.quality(diagnosis.baseline)}.",
        suspects_pieces(diagnosis.suspect_readings),
        (_brief(given, diagnosis) for given in explanation_tables(diagnosis)),
        explanation_pieces(diagnosis),
        listed(sentences.how_to_look(diagnosis), "How to look for it, without a fit:"),
        strong(sentences.set_aside_text(diagnosis)),
        _brief(limits_table(diagnosis), diagnosis),
        strong(next_for_average),
        proposals_table(diagnosis),
        (f"not tried: {effect}" for effect in sentences.not_tried(diagnosis)),
        **_spent(diagnosis),
    )


# A step of a repair.


def of_repair(diagnosis: results.RepairResult, *, with_steps: bool = True) -> Description:
    """The steps, the verdict, and the fit with all effects together, or that none was added."""
    fit = diagnosis.calibration
    undetermined, outcome = "", list[Piece]([strong("Nothing was added, and no file written.")])
    if diagnosis.undetermined:
        last = sentences.in_words(diagnosis, diagnosis.repair[-1].effects)
        undetermined = f"With {last}, {diagnosis.undetermined}: diagnose says what to measure next."
    if diagnosis.effects:
        still = "The mended campaign still does not describe its readings."
        outcome = [
            f"With {diagnosis.added} simulated together: chi2 = {number(fit.chi2)} (ndf {fit.ndf}, "
            f"{p_equals(fit.p_value)})",
            parameters_table(fit.parameters, fit.profiles),
            _shapes(fit.profiles),
            strong(still if sentences.fails(fit) else ""),
        ]
    return described(
        "a campaign, mended",
        strong(sentences.averaged_yield(diagnosis, fit, diagnosis.effects)),
        steps_table(diagnosis.repair) if with_steps else None,
        strong(sentences.headline(diagnosis)),
        suspects_pieces(diagnosis.suspect_readings),
        strong(sentences.set_aside_text(diagnosis)),
        undetermined,
        outcome,
        (f"not tried: {effect}" for effect in sentences.not_tried(diagnosis)),
        **_spent(diagnosis),
    )


def steps_table(steps: Iterable[RepairStep]) -> Table:
    """How the misfit falls while effects are added: a step a row, its fit and two parameters."""
    steps = tuple(steps)
    light = LIGHT_YIELD if any(LIGHT_YIELD in step.parameters for step in steps) else SCALE

    def parameter(name: str) -> Column:
        def cell(step: RepairStep) -> Cell:
            return estimated(step.parameters[name]) if name in step.parameters else Cell("fixed")

        return Column(sentences.title_of(name), name, of=cell)

    def per_ndf(step: RepairStep) -> Cell:
        return shown(step.chi2 / step.ndf if step.ndf > 0 else None, number)

    columns = (
        Column("added", of=lambda step: Cell(sentences.added_text(step), step.added)),
        Column("chi2", form=number),
        Column("ndf", form="d"),
        Column("chi2 / ndf", "chi2_per_ndf", of=per_ndf),
        Column("p", "p_value", p_text),
        Column("rms pull", "rms_pull", number),
        Column("left out", "left_out_error", number),
        *map(parameter, (light, ALPHA_SCAT)),
    )
    return records("repair, step by step", columns, steps)


def step_text(step: RepairStep) -> str:
    """A step of a repair in one line, while it is under way."""
    steps = steps_table([step])
    added, *cells = (cell.text for cell in steps.rows[0].cells)
    titles = (column.title for column in steps.columns[1:])
    texts = (f"{title} {text}" for title, text in zip(titles, cells, strict=True))
    return f"step {step.step}, {added}: {', '.join(texts)}"


def of_report(report: results.ReportResult) -> Description:
    """What a report says first; the page has the rest."""
    profiles = report.sections.profiles
    return described(
        "report of a campaign",
        strong(report.sections.headline),
        strong(sentences.averaged_yield(report, report.calibration, report.effects)),
        parameters_table(report.parameters, profiles),
        _shapes(profiles),
        **_spent(report),
    )


# A part of an error, and what a model leaves out.

#: Smaller errors of shifts, in per cent, need no digits.
_LEAST_PERCENT = 0.001
# smaller parts of the value are rounding of shared errors that cancel
_NOTHING = 1e-9


def of_budget(errors: results.BudgetResult) -> Description:
    """Contributions, what the model leaves out, and values with all errors."""
    budgets = {name: errors.contributions[name] for name in errors.main if name in errors.totals}
    main = next((name for name in (LIGHT_YIELD, SCALE) if name in budgets), None)
    # a standard error knows nothing of the bound
    at_bound = "" if budgets else "A parameter ended at its bound: no budget."
    bench, scene = read_scene(scene_path("camoo4.xml")), errors.fit.model.campaign.scene.parameters
    numbers = bench.parameters.keys() - {ALPHA_SCAT, ALPHA_ABS}
    articles = all(scene.get(name) == bench.parameters[name] for name in numbers)
    how_much = "how much" if articles else "how much, on the article's bench"
    columns = (Column(name, left=True) for name in ("cause", "what it does", how_much))
    return described(
        "error budget of a campaign",
        contributions_table("where the errors come from, in the model as it is", budgets),
        strong(at_bound if errors.main else ""),
        strong(sentences.what_next(budgets[main], sentences.quantity(main)) if main else ""),
        _shifts(errors),
        _totals(errors),
        _corrections(errors),
        _places(errors),
        table("neither modelled nor in any error", columns, not_modelled(articles)),
        **_spent(errors),
    )


def contributions_table(title: str, budgets: Mapping[str, ErrorBudget]) -> Table:
    """A row per contribution, a column per budget of `budgets`, sums last; per cent of each value.

    Budgets are by the name of their quantity; the last one puts the rows in order.
    """
    contributions: dict[str, Contribution] = {}
    for budget in reversed(list(budgets.values())):
        for part in budget.contributions:
            contributions.setdefault(part.name, part)
    rows, sums, words = [], [], ("kind", "reducible", "by")
    for name, part in contributions.items():
        parts = (_part(name, budget) for budget in budgets.values())
        reducible = "yes" if part.reducible else "no"
        rows.append((name.replace("_", " "), *parts, part.kind, reducible, part.by))
    for name in ("statistical", "systematic", "total"):
        cells = (_percent_cell(getattr(budget, name)) for budget in budgets.values())
        sums.append(row(name, *cells, *[""] * len(words), strong=True))
    left = (Column(name, left=True) for name in words)
    values = (Column(f"{sentences.quantity(name)}, %", f"{name}, %") for name in budgets)
    return table(title, ("contribution", *values, *left), rows, sums)


def _part(name: str, budget: ErrorBudget) -> Cell:
    """A contribution to a budget; empty where the budget has none of that name."""
    relative = next((part.relative for part in budget.contributions if part.name == name), None)
    if relative is None:
        return Cell("")
    return _percent_cell(abs(relative)) if abs(relative) > _NOTHING else Cell("0", 0.0)


def _percent_cell(fraction: float) -> Cell:
    return shown(100 * fraction, ".1f")


def _shifts(errors: Budget) -> Iterator[Piece]:
    """What each piece of neglected physics does, at fixed coefficients and refitted; what helps."""
    kinds = (
        ("at_fixed", "at the coefficients that were fitted"),
        ("refitted", "with everything fitted again"),
    )
    for kind, condition in kinds if errors.pieces else ():
        # besides the main quantities the ratio of two efficiencies: fitted again, it is that of
        # the readings
        ratios = kind == "at_fixed"
        every = getattr(errors.pieces[0], kind)
        names = [name for name in every if name in errors.main or (ratios and " / " in name)]
        rows = []
        for piece in errors.pieces:
            cells = (_shift(getattr(piece, kind)[name]) for name in names)
            rows.append(row(piece.title, *cells, strong=piece is errors.together))
        title = f"what the model leaves out would move, %, {condition}"
        quantities = (Column(sentences.quantity(name), name) for name in names)
        yield table(title, ("left out", *quantities), rows)
    if errors.pieces:
        yield (
            "Errors: of the simulation, by the differences of its batches with and without; then "
            "of the size of what was put in."
        )
    for piece in errors.neglected:
        kind = "a correction" if piece.correction else "a systematic error"
        yield f"- {piece.title}, {kind}: {piece.put_in}. What helps: {piece.mend}."
    for name, reason in errors.not_estimated.items():
        yield f"- not put in: {name.replace('_', ' ')}: {reason}"


def _shift(shift: Shift) -> Cell:
    """``-4.62 ± 0.08 ± 0.05``: a shift in per cent, with its errors by simulation and by size."""
    per_cent = 100 / abs(shift.before)
    sigmas = [shift.monte_carlo_sigma, *([shift.size_sigma] if shift.size_sigma else [])]
    rounded = [max(per_cent * sigma, _LEAST_PERCENT) for sigma in sigmas]
    text = _signed(pdg_parts(per_cent * shift.shift, *rounded))
    return Cell(text, per_cent * shift.shift, per_cent * math.hypot(*sigmas))


def _signed(text: str) -> str:
    return text if text.startswith("-") else f"+{text}"


def _totals(errors: Budget) -> Iterator[Piece]:
    """The values as they are, and as they ought to be."""
    if not errors.totals:
        return
    corrected = errors.together is not None
    totals = {name: errors.totals[name] for name in errors.main}
    as_fitted = [_two_digits(t.value, t.sigma) for t in totals.values()]
    lasting = [_two_digits(t.value, t.sigma_with_neglected) for t in totals.values()]
    columns = {"as fitted": as_fitted}
    if [cell.text for cell in as_fitted] != [cell.text for cell in lasting]:
        columns["and what is left out for good"] = lasting
    if corrected:
        numbers = ((t.corrected, t.corrected_sigma) for t in totals.values())
        columns["corrected"] = [_two_digits(value, sigma) for value, sigma in numbers]
    rows = zip(map(_title, totals), *columns.values(), strict=True)
    yield table("results, with all errors", ["quantity", *columns], rows)
    yield sentences.which_eta(errors.fit)
    if corrected:
        yield (
            "A correction is no error: make it in the scene or the campaign. The errors of "
            "corrected values have those of the corrections' sizes in them."
        )


def _corrections(errors: Budget) -> Table | None:
    """What the absolute light yield is with each of the corrections that need no simulation."""
    light = errors.fit.parameters.get(LIGHT_YIELD)
    if light is None:
        return None
    rows = []
    for correction in errors.corrections:
        factor = 1.0 if correction.applied else 1.0 + correction.relative
        shift = shown(100 * correction.relative, "+.2f")
        value = _two_digits(factor * light.value, factor * light.sigma)
        rows.append((correction.name, shift, "yes" if correction.applied else "no", value))
    columns = ("correction", "moves it by, %", "is in it", "light yield with it (ph/keV)")
    return table("the absolute light yield", columns, rows)


def not_modelled(articles: bool = True) -> list[tuple[str, str, str]]:
    """Causes, what they do and how much: rows of a table that says what is left out altogether.

    Of another bench than the `articles` those are left out that only this has.
    """
    text = Path(__file__).with_name("not_modelled.toml").read_text(encoding="utf-8")
    causes = tomllib.loads(text)["causes"]
    return [(what, does, much) for what, does, much, *mark in causes if articles or not mark]


def _places(errors: Budget) -> Iterator[Piece]:
    """What it does to the light yield where gammas stop, instead of everywhere, by a map."""
    if errors.places is None:
        return
    everywhere, *_ = errors.places.shifts

    def cells(place: Any) -> Iterator[Cell]:
        for shift in (place.eta_shift, place.yield_shift):
            cell = measured(shift, place.sigma, 100.0)
            yield Cell("") if place is everywhere else replace(cell, text=_signed(cell.text))

    shifts = (Column("eta (%)", "eta_shift"), Column("light yield (%)", "yield_shift"))
    rows = (
        (place.source, measured(place.eta, place.eta_sigma), *cells(place))
        for place in errors.places.shifts
    )
    yield table("where gammas stop, instead of everywhere", ("gammas stop", "eta", *shifts), rows)
    yield (
        f"By the map of {', '.join(errors.places.readings)}, at its coefficients, beside a model "
        "whose light is born everywhere. Where nobody knows which of these the source does, half "
        f"of what lies between them, {100.0 * errors.places.half_range:.2g} %, is a systematic "
        "error of the light yield that no total above has; where it is known, put it into the "
        "model instead (effect source_depth or side_source)."
    )


def _two_digits(value: float | None, sigma: float | None) -> Cell:
    """A value to two digits of its error, so that a correction smaller than it is seen."""
    if value is None or sigma is None:
        return Cell("")
    places = max(1 - math.floor(math.log10(sigma)), 0)
    return Cell(f"{value:.{places}f} ± {sigma:.{places}f}", value, sigma)


# A plan.

_MOST_PLANS = 16


def of_plan(planning: Planning) -> Description:
    """What would be measured, what relative errors plans would leave, and the cheapest plan."""
    solution = ", ".join(
        f"{sentences.title_of(name)} {pdg(estimate.value, estimate.sigma)}"
        for name, estimate in planning.solution.items()
    )
    numbers = {c.name: planning.number([place]) for place, c in enumerate(planning.candidates)}
    # an event's error over the root of 10,000
    signals = (
        Column("configuration", of=lambda c: " ".join(dict.fromkeys((numbers[c.name], c.name)))),
        Column("photons per event", form=".1f", of="signal"),
        Column(
            "error of 10,000 events", of=lambda c: shown(c.event_sigma / c.signal / 100, percent)
        ),
    )
    # of a set of couplings and its expected error
    floors = (
        Column("configurations", of=lambda floor: planning.number(floor[0])),
        Column("total", of=lambda floor: shown(floor[1].total, percent)),
        Column("priors", of=lambda floor: shown(floor[1].priors, percent)),
        Column("detector efficiency", of=lambda floor: shown(floor[1].efficiency, percent)),
    )
    plans = (
        Column("configurations", of=lambda plan: planning.number(plan.configurations)),
        Column("mountings", form="d"),
        Column("events", form=",.0f"),
        Column("hours", form=".1f"),
        Column("light yield, stat.", form=percent, of="light_yield.statistical"),
        Column("syst.", form=percent, of="light_yield.systematic"),
        Column("total", form=percent, of="light_yield.total"),
        Column(
            "alpha_scat", of=lambda p: shown(p.alpha_scat.total, percent) if p.alpha_scat else ""
        ),
    )
    assumed = planning.conditions
    now, undetermined = planning.so_far, "; ".join(map(planning.name, planning.undetermined))
    sets = sorted(planning.floors.items(), key=lambda floor: (len(floor[0]), floor[1].total))
    beats = "plans that no cheaper one beats (relative errors)"
    efficient = planning.efficient[-_MOST_PLANS:]
    left = "what readings without error would leave of the light yield's"
    return described(
        "plan of a measurement",
        f"At the campaign's solution: {solution}",
        records("what would be measured", signals, planning.candidates),
        f"The readings so far count: light yield to {percent(now.total)}" if now else "",
        records(left, floors, sets[:_MOST_PLANS]),
        f"and {len(sets) - _MOST_PLANS} larger sets" if len(sets) > _MOST_PLANS else "",
        records(beats, plans, efficient, strong=lambda plan: plan is planning.cheapest),
        map(strong, sentences.verdict(planning)),
        sentences.rehearsal_text(planning),
        f"Assumed: {assumed.events_per_second:g} events per second in the band, "
        f"{assumed.minutes_per_mounting:g} minutes per mounting, a scatter of "
        f"{percent(assumed.mounting_scatter)} from mounting to mounting, and a spread of "
        f"{percent(assumed.intrinsic_spread)} of an event's light.",
        f"Not enough to determine the parameters: {undetermined}" if undetermined else "",
        notes=planning.notes,
    )
