"""Results on campaigns described: their tables and sentences; see `description`."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.rounding import (
    capital,
    number,
    p_equals,
    p_text,
    pdg,
    pdg_parts,
    percent,
    probability,
)
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output import sentences
from mcrim_mitsuba.output.description import (
    Cell,
    Column,
    Description,
    Part,
    Sentence,
    Table,
    listed,
    measured,
    row,
    shown,
    table,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.inference.budget import Budget
    from mcrim_mitsuba.inference.candidates import Candidate
    from mcrim_mitsuba.inference.compare import Suspect
    from mcrim_mitsuba.inference.corrections import Shift
    from mcrim_mitsuba.inference.diagnose import Diagnosis, RepairStep
    from mcrim_mitsuba.inference.estimates import FittedRow, ParameterEstimate
    from mcrim_mitsuba.inference.fit import Calibration
    from mcrim_mitsuba.inference.hypotheses import FittedHypothesis
    from mcrim_mitsuba.inference.plan import Planning
    from mcrim_mitsuba.inference.profiles import Profile
    from mcrim_mitsuba.laboratory.error_budget import Contribution, ErrorBudget
    from mcrim_mitsuba.output.campaign_results import (
        BudgetResult,
        CampaignShown,
        ComparisonResult,
        DiagnosisResult,
        FitResult,
        HypothesesResult,
        RepairResult,
        ReportResult,
    )


# Fits.

#: What parameters are called in files, and by programs.
_TYPED = Column("id", "id", left=True, small=True)
_ORIGINS = ("statistical", "prior", "monte_carlo", "detector_efficiency")


def of_fit(fit: FitResult) -> Description:
    """Parameters, where their errors come from, readings beside the model, what it took."""
    light = fit.parameters.get(LIGHT_YIELD)
    by_detector = (None if light is None else light.efficiency_contributions) or {}
    listing = ", ".join(f"{name} {part:.2g}" for name, part in by_detector.items())
    of_detector = f"detector efficiency in {sentences.title_of(LIGHT_YIELD)}: {listing}"
    values: list[Iterable[str | Cell]] = []
    errors: list[Iterable[str | Cell]] = []
    wider = {profile.name: profile.interval_95 for profile in fit.profiles}
    for name, estimate in fit.parameters.items():
        titled = Cell(sentences.title_of(name), name)
        ends = (estimate.lower, estimate.upper, *wider.get(name, (None, None)))
        values.append((titled, _estimated(estimate), *(shown(end, ".4g") for end in ends), name))
        contributions = {} if estimate.at_bound else estimate.contributions
        errors.append((titled, *(shown(contributions.get(origin), ".2g") for origin in _ORIGINS)))
    origins = ("parameter", *(name.replace("_", " ") for name in _ORIGINS))
    parts: list[Part] = [
        *_strong("" if light is None else _light_yield(fit, light)),
        table(
            "parameters",
            (
                "parameter",
                "value",
                Column("68.3 % from", "lower"),
                Column("to", "upper"),
                *(Column(end, hidden=True) for end in ("lower_95", "upper_95")),
                _TYPED,
            ),
            values,
        ),
        *_shapes(fit.profiles),
        table("where the errors come from", origins, errors),
        *([Sentence(of_detector)] if by_detector else []),
        *_strong(sentences.next_for_fit(fit, fit.model.campaign.priors)),
        table(
            "readings",
            ("reading", "measured", "model", "pull", Column("eta (simulation's error)", "eta")),
            (
                (*_reading(reading), measured(reading.eta, reading.eta_sigma or None))
                for reading in fit.rows
            ),
        ),
    ]
    chance = (
        "no p-value without degrees of freedom" if fit.p_value is None else p_equals(fit.p_value)
    )
    parts.append(
        Sentence(
            f"chi2 = {fit.chi2:.3g}, ndf = {fit.ndf}, {chance}; {fit.provenance.photons:,} photons "
            f"in {len(fit.rows)} readings, seed {fit.provenance.seed}, {fit.seconds:.1f} s"
        )
    )
    return Description("fit of a campaign", tuple(parts), notes=fit.notes)


def _light_yield(fit: Calibration, light: ParameterEstimate) -> str:
    """The result, and whether to believe it."""
    doubt = ", but the model does not describe the readings" if sentences.fails(fit) else ""
    return f"Light yield: {sentences.estimate_text(light)} ph/keV{doubt}"


def _strong(text: str) -> list[Sentence]:
    """What is to be looked at first; nothing where nothing is said."""
    return [Sentence(text, strong=True)] if text else []


def _shapes(profiles: Iterable[Profile]) -> list[Sentence]:
    return [Sentence(f"- {words}", strong=True) for words in sentences.shapes(profiles)]


def _estimated(estimate: ParameterEstimate) -> Cell:
    # at a bound sigma is no error: it knows nothing of the bound
    return Cell(
        sentences.estimate_text(estimate),
        estimate.value,
        None if estimate.at_bound else estimate.sigma,
    )


def _reading(reading: FittedRow) -> tuple[str | Cell, ...]:
    """A reading beside the model, and its pull."""
    return (
        _name(reading),
        *(
            Cell(sentences.signal_text(reading.of_beam, value, sigma), value, sigma)
            for value, sigma in (
                (reading.measured, reading.sigma),
                (reading.model, reading.model_sigma),
            )
        ),
        shown(reading.pull, "+.2f"),
    )


def _name(reading: FittedRow) -> str:
    return reading.label if reading.use else f"{reading.label} (not used)"


def parameters_table(parameters: Mapping[str, ParameterEstimate]) -> Table:
    """Every fitted parameter with its error."""
    rows = (
        (Cell(sentences.title_of(name), name), _estimated(estimate), name)
        for name, estimate in parameters.items()
    )
    return table("parameters", ("parameter", "value", _TYPED), rows)


def _parameters(parameters: Mapping[str, ParameterEstimate]) -> list[Table]:
    """The table; nothing where all is held."""
    return [parameters_table(parameters)] if parameters else []


def _described(title: str, parts: Iterable[Part], result: CampaignShown) -> Description:
    """What a result shows, what it rests on, and what the reader must know."""
    provenance = result.provenance
    spent = (
        f"{provenance.photons:,} photons ({provenance.cached_photons:,} of the cache), seed "
        f"{provenance.seed}, {provenance.seconds:.1f} s"
    )
    return Description(title, tuple(parts), spent, result.notes)


# Where a model fails, and what explains it.


def of_comparison(comparison: ComparisonResult) -> Description:
    """Readings beside predictions, what chi2 says, and where the misfit lies."""
    shares, left_out = sentences.misfit_shares(comparison), comparison.left_out_pulls
    suspects = {label for suspect in comparison.suspects for label in suspect.labels}
    columns = (
        "reading",
        "measured",
        "model",
        "pull",
        Column("pull from the others", "left_out_pull"),
        Column("of the misfit", "part_of_misfit"),
    )
    rows = (
        row(
            *_reading(reading),
            shown(left_out.get(reading.label), "+.2f"),
            Cell(f"{100 * shares[reading.label]:.0f} %", shares[reading.label])
            if reading.use
            else "",
            strong=reading.label in suspects,
        )
        for reading in comparison.rows
    )
    parts: list[Part] = [
        table("readings", columns, rows),
        Sentence(sentences.quality(comparison), strong=True),
        *([Sentence(f"- {sentences.carriers(comparison)}")] if sentences.fails(comparison) else []),
        *(Sentence(f"- {words}") for words in sentences.beam_conflict(comparison)),
        *_suspects(comparison.suspects),
        *(Sentence(f"- {sentences.trend_text(trend)}") for trend in comparison.trends),
        *listed(
            "Fitted parameters that may have taken up a misfit:",
            (parameter.words for parameter in comparison.absorbed),
        ),
        *_parameters(comparison.parameters),
    ]
    return _described("a campaign beside its model", parts, comparison)


_OF_HYPOTHESES = (
    "ln evidence: natural logarithm of the likelihood averaged over plausible sizes, less that of "
    "the best; probability: among those compared, each as likely as the others before the "
    "readings; left out: rms error on readings left out of the fit, in standard errors; light "
    "yield: photons per keV, with the statistical and the systematic error"
)


def of_hypotheses(compared: HypothesesResult) -> Description:
    """The verdict, what the readings say of each hypothesis, sizes, pulls and predictions."""
    hypotheses = compared.hypotheses
    names = [hypothesis.name for hypothesis in hypotheses]
    figures = {
        "chi2": [shown(hypothesis.chi2, number) for hypothesis in hypotheses],
        "ndf": [shown(hypothesis.ndf, "d") for hypothesis in hypotheses],
        "p": [shown(hypothesis.p_value, p_text) for hypothesis in hypotheses],
        "left out": [shown(hypothesis.left_out_error, number) for hypothesis in hypotheses],
        "ln evidence": list(map(_log_evidence, hypotheses)),
        "probability": [shown(hypothesis.probability, probability) for hypothesis in hypotheses],
    }
    fitted_names = dict.fromkeys(
        name for hypothesis in hypotheses for name in hypothesis.parameters
    )
    sizes = {
        name: [hypothesis.parameters.get(name) for hypothesis in hypotheses]
        for name in fitted_names
    }
    if lights := sizes.pop(LIGHT_YIELD, None):
        figures["light yield"] = [
            Cell(sentences.value_with_errors(light), light.value, light.sigma)
            if light
            else Cell("")
            for light in lights
        ]
    most, pulls, predictions = sentences.most_apart(compared), [], []
    for of_all in zip(*(hypothesis.rows for hypothesis in hypotheses), strict=True):
        label, measured_cell, *_ = _reading(of_all[0])
        far, strong = compared.apart[of_all[0].label], of_all[0].label in most
        values = (shown(reading.pull, "+.2f") for reading in of_all)
        pulls.append(row(label, *values, shown(far, ".1f"), strong=strong))
        values = (Cell(sentences.prediction_text(x), x.model, x.model_sigma) for x in of_all)
        predictions.append(row(label, measured_cell, *values, strong=strong))
    fitted = (
        (
            Cell(sentences.title_of(size), size),
            *(_estimated(estimate) if estimate else "" for estimate in estimates),
        )
        for size, estimates in sizes.items()
    )
    parts: list[Part] = [
        Sentence(f"{sentences.verdict_words(compared.verdict)}: {compared.reason}", strong=True),
        *(
            Sentence(f"{hypothesis.name}: {sentences.hypothesis_text(hypothesis)}")
            for hypothesis in hypotheses
        ),
        table(
            "hypotheses",
            (Column("", "quantity"), *names),
            ((what, *cells) for what, cells in figures.items()),
        ),
        Sentence(_OF_HYPOTHESES),
        table("sizes", ("parameter", *names), fitted),
        Sentence(sentences.apart_text(compared), strong=True),
        table("pulls", ("reading", *names, "apart"), pulls),
        Sentence("apart: largest difference of two predictions, in standard errors of the reading"),
        table("predictions", ("reading", "measured", *names), predictions),
    ]
    return _described("hypotheses side by side", parts, compared)


def _log_evidence(hypothesis: FittedHypothesis) -> Cell:
    """The best is what the others are compared with."""
    text = (
        pdg(hypothesis.log_evidence, hypothesis.log_evidence_sigma)
        if hypothesis.log_evidence_sigma
        else "0"
    )
    return Cell(text, hypothesis.log_evidence, hypothesis.log_evidence_sigma or None)


def _suspects(suspects: Sequence[Suspect]) -> Iterator[Sentence]:
    return listed(
        "Look at these readings before physics is blamed:", map(sentences.suspicion, suspects)
    )


def of_diagnosis(diagnosis: DiagnosisResult) -> Description:
    """The averaged yield, the verdict, effects as explanations, limits, what to measure next."""
    columns = (
        "configuration",
        Column("time", "hours"),
        Column("yield to", "light_yield_sigma"),
        Column("sure to", "probability"),
        Column("gain in chi2", "expected_delta_chi2"),
        Column("tells apart", "separates"),
    )
    rows: Iterable[tuple[str | Cell, ...]] = (
        (
            proposal.words,
            *map(
                Cell,
                sentences.measurement_value(proposal),
                (proposal.hours, proposal.light_yield_sigma, proposal.probability),
            ),
            shown(proposal.expected_delta_chi2, number),
            "; ".join(sentences.told_apart(diagnosis, proposal)),
        )
        for proposal in diagnosis.next_measurements
    )
    parts: list[Part] = [
        *_strong(sentences.averaged_yield(diagnosis)),
        Sentence(sentences.headline(diagnosis), strong=True),
        Sentence(f"Without any effect {sentences.quality(diagnosis.baseline)}."),
        *_suspects(diagnosis.suspect_readings),
        *_explanations(diagnosis),
        *_strong(sentences.set_aside_text(diagnosis)),
        *(_brief(limits_table(diagnosis), diagnosis) if diagnosis.upper_limits else ()),
        *_strong(_beside_the_table(diagnosis, sentences.next_for_average(diagnosis))),
        *([table("what to measure next", columns, rows)] if diagnosis.next_measurements else []),
        *(Sentence(f"not tried: {effect}") for effect in sentences.not_tried(diagnosis)),
    ]
    return _described("what explains a campaign's misfit", parts, diagnosis)


def _beside_the_table(diagnosis: Diagnosis, what: str) -> str:
    """What makes most of the error, by another name than the table of further readings."""
    if not diagnosis.next_measurements:
        return what
    return re.sub("^What to (measure|simulate) next:", "Largest part of the error:", what)


_ID = Column("id", "effect", left=True, small=True)
_LIGHT = Column("light yield", LIGHT_YIELD)
_CANDIDATE = (
    Column("effect", "title"),
    "probability",
    Column("", "parameter", hidden=True),
    Column("size", left=True),
    Column("plausible?", "plausibility", left=True),
    _LIGHT,
    Column("gain in chi2", "delta_chi2"),
    Column("p, fit", "p_value"),
    Column("left out", "left_out_error"),
    _ID,
)
_EXPLANATION = (
    "probability: among all that was tried and nothing, averaged over plausible sizes; light "
    "yield: photons per keV, and its change; gain: fall of chi2, with the simulation's error; p, "
    "fit: of the fit with the effect; left out: rms error on readings left out of the fit, in "
    "standard errors"
)


def _explanations(diagnosis: Diagnosis) -> Iterator[Part]:
    """Effects alone and in pairs, the best first."""
    leading = sentences.leading_candidates(diagnosis)
    titles = (
        (diagnosis.candidates, "effects, each added alone"),
        (diagnosis.pairs, "the best pairs of effects"),
    )
    for candidates, title in titles:
        if candidates:
            rows = (
                row(*_candidate(diagnosis, candidate), strong=candidate in leading)
                for candidate in candidates
            )
            # a scale is no light yield
            dark = all(candidate.light_yield_ph_per_keV is None for candidate in candidates)
            columns = (replace(_LIGHT, hidden=dark) if c is _LIGHT else c for c in _CANDIDATE)
            yield from _brief(table(title, columns, rows), diagnosis)
    if diagnosis.candidates:
        yield Sentence(_EXPLANATION)
    if diagnosis.families:
        yield Sentence(f"By family: {sentences.family_probabilities(diagnosis)}")
    if text := sentences.mistakable(diagnosis):
        yield Sentence(text)
    yield from listed("How to look for it, without a fit:", sentences.how_to_look(diagnosis))


def _brief(given: Table, diagnosis: Diagnosis) -> Iterator[Part]:
    """A table of effects, of which people see those that matter, and how many they do not see."""
    behind = {
        candidate.effect
        for candidate in (
            *diagnosis.candidates[sentences.MOST_EFFECTS :],
            *diagnosis.pairs[sentences.MOST_PAIRS :],
        )
    } - {candidate.effect for candidate in sentences.leading_candidates(diagnosis)}
    rows = [
        # a limit is named EFFECT or EFFECT.PARAMETER
        replace(line, hidden=str(line.cells[-1].value).partition(".")[0] in behind)
        for line in given.rows
    ]
    yield replace(given, rows=tuple(rows))
    if more := sum(line.hidden for line in rows):
        yield Sentence(
            f"and {more} more, less likely than these: the file of --json has all {len(rows)}, "
            "and so has to_dataframe in Python"
        )


def _candidate(diagnosis: Diagnosis, candidate: Candidate) -> tuple[str | Cell, ...]:
    p = diagnosis.probabilities.get(candidate.effect)
    light = candidate.light_yield_ph_per_keV or {}
    change = light.get("change")
    changed = "" if change is None else f" ({sentences.change_text(change)})"
    sizes = {
        n: _estimated(candidate.parameters[n])
        for n in candidate.effect_parameters
        if n in candidate.parameters
    }
    return (
        capital(" + ".join(sentences.titles_of(diagnosis, candidate.effects))),
        "" if p is None else Cell(probability(p), p),
        Cell("", tuple(sizes) or None),
        Cell(
            sentences.size_text(candidate, "\n"),
            tuple(cell.value for cell in sizes.values()) or None,
            tuple(c.sigma for c in sizes.values() if not isinstance(c.sigma, tuple)) or None,
        ),
        sentences.plausibility(candidate),
        Cell(number(light["value"]) + changed, light["value"], light.get("sigma")) if light else "",
        Cell(
            sentences.gain_text(candidate), candidate.delta_chi2, candidate.delta_chi2_sigma or None
        ),
        shown(candidate.p_value, p_text),
        shown(candidate.left_out_error, number),
        candidate.effect,
    )


def limits_table(diagnosis: Diagnosis) -> Table:
    """How large each effect may be, where the readings need none."""
    rows = (
        (
            capital(sentences.in_words(diagnosis, [name])),
            Cell("", limit.lower),
            Cell(sentences.limit_text(limit), limit.upper),
            Cell("", limit.excluded),
            Cell(limit.parameter or "on or off", limit.parameter),
            name,
        )
        for name, limit in diagnosis.upper_limits.items()
    )
    columns = (
        Column("effect", "title"),
        Column("", "lower", hidden=True),
        Column("size", "upper"),
        Column("", "excluded", hidden=True),
        Column("parameter", left=True, small=True),
        _ID,
    )
    return table("what the readings allow, 95 % confidence", columns, rows)


def of_repair(diagnosis: RepairResult, *, with_steps: bool = True) -> Description:
    """The steps, the verdict, and the fit with all effects simulated together."""
    fit = diagnosis.calibration
    parts: list[Part] = [
        *_strong(sentences.averaged_yield(diagnosis)),
        *([steps_table(diagnosis.repair)] if with_steps else []),
        Sentence(sentences.headline(diagnosis), strong=True),
        *_suspects(diagnosis.suspect_readings),
        *_strong(sentences.set_aside_text(diagnosis)),
    ]
    if diagnosis.undetermined:
        last = sentences.in_words(diagnosis, diagnosis.repair[-1].effects)
        text = f"With {last}, {diagnosis.undetermined}: diagnose says what to measure next."
        parts.append(Sentence(text))
    if diagnosis.effects:
        together = f"With {diagnosis.added} simulated together: "
        quality = f"chi2 = {number(fit.chi2)} (ndf {fit.ndf}, {p_equals(fit.p_value)})"
        parts += [Sentence(together + quality), *_parameters(fit.parameters)]
        parts += _shapes(fit.profiles)
        if sentences.fails(fit):
            parts += _strong("The mended campaign still does not describe its readings.")
    else:
        parts += _strong("Nothing was added, and no file written.")
    return _described("a campaign, mended", parts, diagnosis)


def steps_table(steps: Iterable[RepairStep]) -> Table:
    """How the misfit falls while effects are added."""
    repair = tuple(steps)
    light = LIGHT_YIELD if any(LIGHT_YIELD in step.parameters for step in repair) else SCALE
    columns: tuple[str | Column, ...] = (
        "added",
        "chi2",
        "ndf",
        Column("chi2 / ndf", "chi2_per_ndf"),
        Column("p", "p_value"),
        Column("rms pull", "rms_pull"),
        Column("left out", "left_out_error"),
        *(Column(sentences.title_of(name), name) for name in (light, ALPHA_SCAT)),
    )
    rows = (
        (
            Cell(_added(step), step.added),
            shown(step.chi2, number),
            shown(step.ndf, "d"),
            shown(step.chi2 / step.ndf if step.ndf > 0 else None, number),
            shown(step.p_value, p_text),
            shown(step.rms_pull, number),
            shown(step.left_out_error, number),
            *(
                _estimated(step.parameters[name]) if name in step.parameters else Cell("fixed")
                for name in (light, ALPHA_SCAT)
            ),
        )
        for step in repair
    )
    return table("repair, step by step", columns, rows)


def _added(step: RepairStep) -> str:
    return "as it came" if step.added is None else f"+ {step.title or step.added}"


def step_text(step: RepairStep) -> str:
    """A step in one line."""
    name, light = sentences.light_yield_text(step.parameters)
    estimate = step.parameters.get(ALPHA_SCAT)
    scattering = "fixed" if estimate is None else f"{sentences.estimate_text(estimate)} /cm"
    per_ndf = f" = {number(step.chi2 / step.ndf)}" if step.ndf > 0 else ""
    return (
        f"step {step.step}, {_added(step)}: chi2 / ndf {number(step.chi2)} / {step.ndf}{per_ndf}, "
        f"{p_equals(step.p_value)}, rms pull {number(step.rms_pull)}, left-out error "
        f"{number(step.left_out_error)}, {name} {light}, alpha_scat {scattering}"
    )


def of_report(report: ReportResult) -> Description:
    """What a report says first; the page has the rest."""
    parts: list[Part] = [
        Sentence(report.sections.headline, strong=True),
        *_parameters(report.parameters),
        *_shapes(report.sections.profiles),
    ]
    return _described("report of a campaign", parts, report)


# Where errors come from.

#: Smaller errors of shifts, in per cent, need no digits.
_LEAST_PERCENT = 0.001
# smaller parts of the value are rounding of shared errors that cancel
_NOTHING = 1e-9


def of_budget(errors: BudgetResult) -> Description:
    """Contributions, what the model leaves out, and values with all errors."""
    budgets = {name: errors.contributions[name] for name in errors.main if name in errors.totals}
    title = "where the errors come from, in the model as it is"
    origins: list[Part] = [contributions_table(title, budgets)] if budgets else []
    if not budgets and errors.main:
        # a standard error knows nothing of the bound
        origins += _strong("A parameter ended at its bound: no budget.")
    main = next((name for name in (LIGHT_YIELD, SCALE) if name in budgets), None)
    if main is not None:
        origins += _strong(sentences.what_next(budgets[main], sentences.parameter_label(main)))
    columns = (Column(name, left=True) for name in ("cause", "what it does", "how much"))
    parts: list[Part] = [
        *origins,
        *_shifts(errors),
        *_totals(errors),
        *_corrections(errors),
        *_places(errors),
        table("neither modelled nor in any error", columns, not_modelled()),
    ]
    return _described("error budget of a campaign", parts, errors)


def contributions_table(title: str, budgets: Mapping[str, ErrorBudget]) -> Table:
    """A row per contribution, a column per budget, sums last; per cent of each value.

    The last budget puts the rows in order.
    """
    contributions: dict[str, Contribution] = {}
    for budget in reversed(list(budgets.values())):
        for part in budget.contributions:
            contributions.setdefault(part.name, part)
    rows = (
        (
            name.replace("_", " "),
            *(_part(name, budget) for budget in budgets.values()),
            part.kind,
            "yes" if part.reducible else "no",
            part.by,
        )
        for name, part in contributions.items()
    )
    sums = (
        row(
            name,
            *(_percent_cell(getattr(budget, name)) for budget in budgets.values()),
            "",
            "",
            "",
            strong=True,
        )
        for name in ("statistical", "systematic", "total")
    )
    left = (Column(name, left=True) for name in ("kind", "reducible", "by"))
    values = (Column(f"{sentences.quantity(name)}, %", f"{name}, %") for name in budgets)
    return table(title, ("contribution", *values, *left), rows, sums)


def _part(name: str, budget: ErrorBudget) -> Cell:
    relative = next((part.relative for part in budget.contributions if part.name == name), None)
    if relative is None:
        return Cell("")
    return _percent_cell(abs(relative)) if abs(relative) > _NOTHING else Cell("0", 0.0)


def _percent_cell(fraction: float) -> Cell:
    return Cell(f"{100 * fraction:.1f}", 100 * fraction)


def _shifts(errors: Budget) -> Iterator[Part]:
    """What every piece of neglected physics does, at fixed coefficients and refitted."""
    kinds = (
        ("at_fixed", "at the coefficients that were fitted"),
        ("refitted", "with everything fitted again"),
    )
    for kind, how in kinds if errors.pieces else ():
        moved = getattr(errors.pieces[0], kind)
        # fitted again, the ratio is that of the readings
        names = [n for n in moved if n in errors.main or (kind == "at_fixed" and " / " in n)]
        rows = (
            row(
                piece.title,
                *(_shift(getattr(piece, kind)[name]) for name in names),
                strong=piece is errors.together,
            )
            for piece in errors.pieces
        )
        title = f"what the model leaves out would move, %, {how}"
        moves = (Column(sentences.quantity(name), name) for name in names)
        yield table(title, ("left out", *moves), rows)
    if errors.pieces:
        yield Sentence(
            "Errors: of the simulation, by the differences of its batches with and without; then "
            "of the size of what was put in."
        )
    for piece in errors.neglected:
        kind = "a correction" if piece.correction else "a systematic error"
        text = f"- {piece.title}, {kind}: {piece.put_in}. What helps: {piece.mend}."
        yield Sentence(text)
    for name, reason in errors.not_estimated.items():
        yield Sentence(f"- not put in: {name.replace('_', ' ')}: {reason}")


def _shift(shift: Shift) -> Cell:
    """``-4.62 ± 0.08 ± 0.05``: a shift in per cent with its errors."""
    per_cent = 100 / abs(shift.before)
    sigmas = [shift.monte_carlo_sigma, *([shift.size_sigma] if shift.size_sigma else [])]
    rounded = [max(per_cent * sigma, _LEAST_PERCENT) for sigma in sigmas]
    text = pdg_parts(per_cent * shift.shift, *rounded)
    signed = text if text.startswith("-") else f"+{text}"
    return Cell(signed, per_cent * shift.shift, per_cent * math.hypot(*sigmas))


def _totals(errors: Budget) -> Iterator[Part]:
    """The values as they are, and as they ought to be."""
    if not errors.totals:
        return
    corrected = errors.together is not None
    columns = [
        "quantity",
        "as fitted",
        "and what is left out for good",
        *(["corrected"] if corrected else []),
    ]
    rows = []
    for name in errors.main:
        total = errors.totals[name]
        cells = [
            _two_digits(total.value, sigma) for sigma in (total.sigma, total.sigma_with_neglected)
        ]
        if total.corrected is not None and total.corrected_sigma is not None:
            cells.append(_two_digits(total.corrected, total.corrected_sigma))
        rows.append(row(Cell(sentences.title_of(name), name), *cells))
    yield table("results, with all errors", columns, rows)
    if corrected:
        yield Sentence(
            "A correction is no error: make it in the scene or the campaign. The errors of "
            "corrected values have those of the corrections' sizes in them."
        )


def _corrections(errors: Budget) -> Iterator[Part]:
    """What the absolute light yield is with each of the corrections that need no simulation."""
    light = errors.fit.parameters.get(LIGHT_YIELD)
    if light is None or not errors.corrections:
        return
    rows = []
    for correction in errors.corrections:
        factor = 1.0 if correction.applied else 1.0 + correction.relative
        moved = Cell(f"{100 * correction.relative:+.2f}", 100 * correction.relative)
        value = _two_digits(factor * light.value, factor * light.sigma)
        rows.append(row(correction.name, moved, "yes" if correction.applied else "no", value))
    columns = ("correction", "moves it by, %", "is in it", "light yield with it (ph/keV)")
    yield table("the absolute light yield", columns, rows)


def not_modelled() -> list[tuple[str, str, str]]:
    """Causes, what they do and how much: rows of a table that says what is left out altogether."""
    text = Path(__file__).with_name("not_modelled.toml").read_text(encoding="utf-8")
    return list(map(tuple, tomllib.loads(text)["causes"]))


def _places(errors: Budget) -> Iterator[Part]:
    """What it does to readings where gammas stop."""
    if errors.places is None:
        return
    columns = (
        "gammas stop",
        "eta",
        Column("eta (%)", "eta_shift"),
        Column("light yield (%)", "yield_shift"),
    )
    everywhere, *_ = errors.places.shifts
    rows = (
        row(
            place.source,
            measured(place.eta, place.eta_sigma),
            *(
                Cell("") if place is everywhere else _signed(100.0 * moved, 100.0 * place.sigma)
                for moved in (place.eta_shift, place.yield_shift)
            ),
        )
        for place in errors.places.shifts
    )
    yield table("where gammas stop, instead of everywhere", columns, rows)
    yield Sentence(
        f"By the map of {', '.join(errors.places.readings)}, at its coefficients, beside a model "
        "whose light is born everywhere. Where nobody knows which of these the source does, half "
        f"of what lies between them, {100.0 * errors.places.half_range:.2g} %, is a systematic "
        "error of the light yield that no total above has; where it is known, put it into the "
        "model instead (effect source_depth or side_source)."
    )


def _signed(value: float, sigma: float) -> Cell:
    """A shift with its sign and error."""
    text = pdg(value, sigma)
    return Cell(text if text.startswith("-") else f"+{text}", value, sigma)


def _two_digits(value: float, sigma: float) -> Cell:
    """Two digits of the error, so that a correction smaller than it is seen."""
    places = max(1 - math.floor(math.log10(sigma)), 0)
    return Cell(f"{value:.{places}f} ± {sigma:.{places}f}", value, sigma)


_MOST_PLANS = 16


def of_plan(planning: Planning) -> Description:
    """What would be measured, what errors plans would leave, and the cheapest plan."""
    at = ", ".join(
        f"{sentences.title_of(name)} {pdg(estimate.value, estimate.sigma)}"
        for name, estimate in planning.solution.items()
    )
    rows: Iterable[Any] = (
        (
            coupling.name,
            shown(coupling.signal, ".1f"),
            _relative(coupling.event_sigma / coupling.signal / 100),
        )
        for coupling in planning.candidates
    )
    columns: tuple[str, ...] = ("coupling", "photons per event", "error of 10,000 events")
    signals = table("what would be measured", columns, rows)
    rows = (
        (planning.name(chosen), *map(_relative, (error.total, error.priors, error.efficiency)))
        for chosen, error in planning.floors.items()
    )
    columns = ("couplings", "total", "priors", "detector efficiency")
    title = "what readings without error would leave of the light yield's"
    floors = table(title, columns, rows)
    rows = (
        row(
            planning.name(plan.configurations),
            shown(plan.mountings, "d"),
            shown(plan.events, ",.0f"),
            shown(plan.hours, ".1f"),
            *map(
                _relative,
                (plan.light_yield.statistical, plan.light_yield.systematic, plan.light_yield.total),
            ),
            "" if plan.alpha_scat is None else _relative(plan.alpha_scat.total),
            strong=plan is planning.cheapest,
        )
        for plan in planning.efficient[-_MOST_PLANS:]
    )
    columns = (
        "couplings",
        "mountings",
        "events",
        "hours",
        "light yield, stat.",
        "syst.",
        "total",
        "alpha_scat",
    )
    plans = table("plans that no cheaper one beats (relative errors)", columns, rows)
    begin = Sentence(f"At the campaign's solution: {at}")
    parts: tuple[Part, ...] = (begin, signals, floors, plans, *_verdict_of_plan(planning))
    return Description("plan of a measurement", parts, notes=planning.notes)


def _verdict_of_plan(planning: Planning) -> list[Sentence]:
    """What to do, what was assumed, and what would not determine the parameters."""
    assumed, sets = planning.conditions, "; ".join(map(planning.name, planning.undetermined))
    return [
        *(Sentence(line, strong=True) for line in sentences.verdict(planning)),
        Sentence(
            f"Assumed: {assumed.events_per_second:g} events per second in the band, "
            f"{assumed.minutes_per_mounting:g} minutes per mounting, a scatter of "
            f"{percent(assumed.mounting_scatter)} from mounting to mounting, and a spread of "
            f"{percent(assumed.intrinsic_spread)} of an event's light."
        ),
        *([Sentence(f"Not enough to determine the parameters: {sets}")] if sets else []),
    ]


def _relative(fraction: float) -> Cell:
    return shown(fraction, percent)
