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
from mcrim_mitsuba.inference.next_measurements import configuration_words
from mcrim_mitsuba.inference.profiles import profiles_of
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
    from mcrim_mitsuba.inference.diagnose import Diagnosis, RepairStep
    from mcrim_mitsuba.inference.estimates import FittedRow, ParameterEstimate
    from mcrim_mitsuba.inference.fit import Calibration
    from mcrim_mitsuba.inference.hypotheses import FittedHypothesis
    from mcrim_mitsuba.inference.neglected import Shift
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
    for name, known in fit.parameters.items():
        titled = Cell(sentences.title_of(name), name)
        ends = (known.lower, known.upper, *wider.get(name, (None, None)))
        values.append((titled, _estimated(known), *(shown(end, ".4g") for end in ends), name))
        contributions = {} if known.at_bound else known.contributions
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
            ((*_reading(one), measured(one.eta, one.eta_sigma or None)) for one in fit.rows),
        ),
    ]
    if fit.spent:
        declared = fit.model.campaign.scene.defaults.items()
        said = {name: default.comment or "" for name, default in declared}
        rows = (
            (
                configuration_words(each.parameters, said) or "the scene's own",
                shown(each.photons, ","),
                shown(each.cached_photons, ","),
                Cell(f"{100 * each.eta_relative_sigma:.2g} %", each.eta_relative_sigma),
            )
            for each in fit.spent
        )
        columns = ("configuration", "photons", "of the cache", "eta to")
        parts.append(table("photons spent", columns, rows))
    chance = (
        "no p-value without degrees of freedom" if fit.p_value is None else p_equals(fit.p_value)
    )
    parts.append(
        Sentence(
            f"chi2 = {fit.chi2:.3g}, ndf = {fit.ndf}, {chance}; {fit.photons:,} photons in "
            f"{len(fit.rows)} readings, seed {fit.seed}, {fit.seconds:.1f} s"
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


def _estimated(known: ParameterEstimate) -> Cell:
    # at a bound sigma is no error: it knows nothing of the bound
    return Cell(
        sentences.estimate_text(known), known.value, None if known.at_bound else known.sigma
    )


def _reading(one: FittedRow) -> tuple[str | Cell, ...]:
    """A reading beside the model, and its pull."""
    return (
        _name(one),
        *(
            Cell(sentences.signal_text(one.of_beam, value, sigma), value, sigma)
            for value, sigma in ((one.measured, one.sigma), (one.model, one.model_sigma))
        ),
        shown(one.pull, "+.2f"),
    )


def _name(one: FittedRow) -> str:
    return one.label if one.use else f"{one.label} (not used)"


def parameters_table(parameters: Mapping[str, ParameterEstimate]) -> Table:
    """Every fitted parameter with its error."""
    rows = (
        (Cell(sentences.title_of(name), name), _estimated(known), name)
        for name, known in parameters.items()
    )
    return table("parameters", ("parameter", "value", _TYPED), rows)


def _parameters(parameters: Mapping[str, ParameterEstimate]) -> list[Table]:
    """The table; nothing where all is held."""
    return [parameters_table(parameters)] if parameters else []


def _described(title: str, parts: Iterable[Part], result: CampaignShown) -> Description:
    """What a result shows, what it rests on, and what the reader must know."""
    spent = (
        f"{result.photons:,} photons ({result.cached_photons:,} of the cache), seed "
        f"{result.seed}, {result.provenance.seconds:.1f} s"
    )
    return Description(title, tuple(parts), spent, result.notes)


# Where a model fails, and what explains it.


def of_comparison(comparison: ComparisonResult) -> Description:
    """Readings beside predictions, what chi2 says, and where the misfit lies."""
    shares, left_out = sentences.misfit_shares(comparison), comparison.left_out_pulls
    suspects = {label for one in comparison.suspects for label in one.labels}
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
            *_reading(one),
            shown(left_out.get(one.label), "+.2f"),
            Cell(f"{100 * shares[one.label]:.0f} %", shares[one.label]) if one.use else "",
            strong=one.label in suspects,
        )
        for one in comparison.rows
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
            (one.words for one in comparison.absorbed),
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
    names = [one.name for one in hypotheses]
    figures = {
        "chi2": [shown(one.chi2, number) for one in hypotheses],
        "ndf": [shown(one.ndf, "d") for one in hypotheses],
        "p": [shown(one.p_value, p_text) for one in hypotheses],
        "left out": [shown(one.left_out_error, number) for one in hypotheses],
        "ln evidence": list(map(_log_evidence, hypotheses)),
        "probability": [shown(one.probability, probability) for one in hypotheses],
    }
    fitted_names = dict.fromkeys(name for one in hypotheses for name in one.parameters)
    sizes = {name: [one.parameters.get(name) for one in hypotheses] for name in fitted_names}
    if lights := sizes.pop(LIGHT_YIELD, None):
        figures["light yield"] = [
            Cell(sentences.value_with_errors(light), light.value, light.sigma)
            if light
            else Cell("")
            for light in lights
        ]
    most, pulls, predictions = sentences.most_apart(compared), [], []
    for of_all in zip(*(one.rows for one in hypotheses), strict=True):
        label, measured_cell, *_ = _reading(of_all[0])
        far, strong = compared.apart[of_all[0].label], of_all[0].label in most
        told = (shown(one.pull, "+.2f") for one in of_all)
        pulls.append(row(label, *told, shown(far, ".1f"), strong=strong))
        told = (Cell(sentences.prediction_text(x), x.model, x.model_sigma) for x in of_all)
        predictions.append(row(label, measured_cell, *told, strong=strong))
    fitted = (
        (
            Cell(sentences.title_of(size), size),
            *(_estimated(known) if known else "" for known in each),
        )
        for size, each in sizes.items()
    )
    parts: list[Part] = [
        Sentence(f"{sentences.verdict_words(compared.verdict)}: {compared.reason}", strong=True),
        *(Sentence(f"{one.name}: {sentences.hypothesis_text(one)}") for one in hypotheses),
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


def _log_evidence(one: FittedHypothesis) -> Cell:
    """The best is what the others are compared with."""
    text = pdg(one.log_evidence, one.log_evidence_sigma) if one.log_evidence_sigma else "0"
    return Cell(text, one.log_evidence, one.log_evidence_sigma or None)


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
            one.words,
            *map(
                Cell,
                sentences.measurement_value(one),
                (one.hours, one.light_yield_sigma, one.probability),
            ),
            shown(one.expected_delta_chi2, number),
            "; ".join(sentences.told_apart(diagnosis, one)),
        )
        for one in diagnosis.next_measurements
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
        *(Sentence(f"not tried: {one}") for one in sentences.not_tried(diagnosis)),
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
            rows = (row(*_candidate(diagnosis, one), strong=one in leading) for one in candidates)
            # a scale is no light yield
            dark = all(one.light_yield_ph_per_keV is None for one in candidates)
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
        one.effect
        for one in (
            *diagnosis.candidates[sentences.MOST_EFFECTS :],
            *diagnosis.pairs[sentences.MOST_PAIRS :],
        )
    } - {one.effect for one in sentences.leading_candidates(diagnosis)}
    rows = [
        # a limit is named EFFECT or EFFECT.PARAMETER
        replace(one, hidden=str(one.cells[-1].value).partition(".")[0] in behind)
        for one in given.rows
    ]
    yield replace(given, rows=tuple(rows))
    if more := sum(one.hidden for one in rows):
        yield Sentence(
            f"and {more} more, less likely than these: the file of --json has all {len(rows)}, "
            "and so has to_dataframe in Python"
        )


def _candidate(diagnosis: Diagnosis, one: Candidate) -> tuple[str | Cell, ...]:
    p = diagnosis.probabilities.get(one.effect)
    light = one.light_yield_ph_per_keV or {}
    change = light.get("change")
    changed = "" if change is None else f" ({sentences.change_text(change)})"
    sizes = {n: _estimated(one.parameters[n]) for n in one.effect_parameters if n in one.parameters}
    return (
        capital(" + ".join(sentences.titles_of(diagnosis, one.effects))),
        "" if p is None else Cell(probability(p), p),
        Cell("", tuple(sizes) or None),
        Cell(
            sentences.size_text(one, "\n"),
            tuple(cell.value for cell in sizes.values()) or None,
            tuple(c.sigma for c in sizes.values() if not isinstance(c.sigma, tuple)) or None,
        ),
        sentences.plausibility(one),
        Cell(number(light["value"]) + changed, light["value"], light.get("sigma")) if light else "",
        Cell(sentences.gain_text(one), one.delta_chi2, one.delta_chi2_sigma or None),
        shown(one.p_value, p_text),
        shown(one.left_out_error, number),
        one.effect,
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
        parts += _shapes(profiles_of(diagnosis.model, fit))
        if sentences.fails(fit):
            parts += _strong("The mended campaign still does not describe its readings.")
    else:
        parts += _strong("Nothing was added, and no file written.")
    return _described("a campaign, mended", parts, diagnosis)


def steps_table(steps: Iterable[RepairStep]) -> Table:
    """How the misfit falls while effects are added."""
    made = tuple(steps)
    light = LIGHT_YIELD if any(LIGHT_YIELD in one.parameters for one in made) else SCALE
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
            Cell(_added(one), one.added),
            shown(one.chi2, number),
            shown(one.ndf, "d"),
            shown(one.chi2 / one.ndf if one.ndf > 0 else None, number),
            shown(one.p_value, p_text),
            shown(one.rms_pull, number),
            shown(one.left_out_error, number),
            *(
                _estimated(one.parameters[name]) if name in one.parameters else Cell("fixed")
                for name in (light, ALPHA_SCAT)
            ),
        )
        for one in made
    )
    return table("repair, step by step", columns, rows)


def _added(one: RepairStep) -> str:
    return "as it came" if one.added is None else f"+ {one.title or one.added}"


def step_text(one: RepairStep) -> str:
    """A step in one line."""
    name, light = sentences.light_yield_text(one.parameters)
    known = one.parameters.get(ALPHA_SCAT)
    scattering = "fixed" if known is None else f"{sentences.estimate_text(known)} /cm"
    per_ndf = f" = {number(one.chi2 / one.ndf)}" if one.ndf > 0 else ""
    return (
        f"step {one.step}, {_added(one)}: chi2 / ndf {number(one.chi2)} / {one.ndf}{per_ndf}, "
        f"{p_equals(one.p_value)}, rms pull {number(one.rms_pull)}, left-out error "
        f"{number(one.left_out_error)}, {name} {light}, alpha_scat {scattering}"
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


def of_budget(found: BudgetResult) -> Description:
    """Contributions, what the model leaves out, and values with all errors."""
    budgets = {name: found.contributions[name] for name in found.main if name in found.totals}
    title = "where the errors come from, in the model as it is"
    origins: list[Part] = [contributions_table(title, budgets)] if budgets else []
    if not budgets and found.main:
        # a standard error knows nothing of the bound
        origins += _strong("A parameter ended at its bound: no budget.")
    main = next((name for name in (LIGHT_YIELD, SCALE) if name in budgets), None)
    if main is not None:
        origins += _strong(sentences.what_next(budgets[main], sentences.parameter_label(main)))
    columns = (Column(name, left=True) for name in ("cause", "what it does", "how much"))
    parts: list[Part] = [
        *origins,
        *_shifts(found),
        *_totals(found),
        *_corrections(found),
        *_places(found),
        table("neither modelled nor in any error", columns, not_modelled()),
    ]
    return _described("error budget of a campaign", parts, found)


def contributions_table(title: str, budgets: Mapping[str, ErrorBudget]) -> Table:
    """A row per contribution, a column per budget, sums last; per cent of each value.

    The last budget puts the rows in order.
    """
    known: dict[str, Contribution] = {}
    for budget in reversed(list(budgets.values())):
        for one in budget.contributions:
            known.setdefault(one.name, one)
    rows = (
        (
            name.replace("_", " "),
            *(_part(name, budget) for budget in budgets.values()),
            one.kind,
            "yes" if one.reducible else "no",
            one.by,
        )
        for name, one in known.items()
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
    found = next((one.relative for one in budget.contributions if one.name == name), None)
    if found is None:
        return Cell("")
    return _percent_cell(abs(found)) if abs(found) > _NOTHING else Cell("0", 0.0)


def _percent_cell(fraction: float) -> Cell:
    return Cell(f"{100 * fraction:.1f}", 100 * fraction)


def _shifts(found: Budget) -> Iterator[Part]:
    """What every piece of neglected physics does, at fixed coefficients and refitted."""
    kinds = (
        ("at_fixed", "at the coefficients that were fitted"),
        ("refitted", "with everything fitted again"),
    )
    for kind, how in kinds if found.pieces else ():
        moved = getattr(found.pieces[0], kind)
        # fitted again, the ratio is that of the readings
        names = [n for n in moved if n in found.main or (kind == "at_fixed" and " / " in n)]
        rows = (
            row(
                piece.title,
                *(_shift(getattr(piece, kind)[name]) for name in names),
                strong=piece is found.together,
            )
            for piece in found.pieces
        )
        title = f"what the model leaves out would move, %, {how}"
        moves = (Column(sentences.quantity(name), name) for name in names)
        yield table(title, ("left out", *moves), rows)
    if found.pieces:
        yield Sentence(
            "Errors: of the simulation, by the differences of its batches with and without; then "
            "of the size of what was put in."
        )
    for piece in found.neglected:
        kind = "a correction" if piece.correction else "a systematic error"
        text = f"- {piece.title}, {kind}: {piece.put_in}. What helps: {piece.mend}."
        yield Sentence(text)
    for name, reason in found.not_estimated.items():
        yield Sentence(f"- not put in: {name.replace('_', ' ')}: {reason}")


def _shift(shift: Shift) -> Cell:
    """``-4.62 ± 0.08 ± 0.05``: a shift in per cent with its errors."""
    per_cent = 100 / abs(shift.before)
    sigmas = [shift.monte_carlo_sigma, *([shift.size_sigma] if shift.size_sigma else [])]
    rounded = [max(per_cent * sigma, _LEAST_PERCENT) for sigma in sigmas]
    text = pdg_parts(per_cent * shift.shift, *rounded)
    signed = text if text.startswith("-") else f"+{text}"
    return Cell(signed, per_cent * shift.shift, per_cent * math.hypot(*sigmas))


def _totals(found: Budget) -> Iterator[Part]:
    """The values as they are, and as they ought to be."""
    if not found.totals:
        return
    corrected = found.together is not None
    columns = [
        "quantity",
        "as fitted",
        "and what is left out for good",
        *(["corrected"] if corrected else []),
    ]
    rows = []
    for name in found.main:
        total = found.totals[name]
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


def _corrections(found: Budget) -> Iterator[Part]:
    """What the absolute light yield is with each of the corrections that need no simulation."""
    known = found.calibration.parameters.get(LIGHT_YIELD)
    if known is None or not found.corrections:
        return
    rows = []
    for one in found.corrections:
        factor = 1.0 if one.applied else 1.0 + one.relative
        moved = Cell(f"{100 * one.relative:+.2f}", 100 * one.relative)
        value = _two_digits(factor * known.value, factor * known.sigma)
        rows.append(row(one.name, moved, "yes" if one.applied else "no", value))
    columns = ("correction", "moves it by, %", "is in it", "light yield with it (ph/keV)")
    yield table("the absolute light yield", columns, rows)


def not_modelled() -> list[tuple[str, str, str]]:
    """Causes, what they do and how much: rows of a table that says what is left out altogether."""
    text = Path(__file__).with_name("not_modelled.toml").read_text(encoding="utf-8")
    return list(map(tuple, tomllib.loads(text)["causes"]))


def _places(found: Budget) -> Iterator[Part]:
    """What it does to readings where gammas stop."""
    if found.places is None:
        return
    columns = (
        "gammas stop",
        "eta",
        Column("eta (%)", "eta_shift"),
        Column("light yield (%)", "yield_shift"),
    )
    everywhere, *_ = found.places.shifts
    rows = (
        row(
            one.source,
            measured(one.eta, one.eta_sigma),
            *(
                Cell("") if one is everywhere else _signed(100.0 * moved, 100.0 * one.sigma)
                for moved in (one.eta_shift, one.yield_shift)
            ),
        )
        for one in found.places.shifts
    )
    yield table("where gammas stop, instead of everywhere", columns, rows)
    yield Sentence(
        f"By the map of {', '.join(found.places.readings)}, at its coefficients, beside a model "
        "whose light is born everywhere. Where nobody knows which of these the source does, half "
        f"of what lies between them, {100.0 * found.places.half_range:.2g} %, is a systematic "
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


def of_plan(found: Planning) -> Description:
    """What would be measured, what errors plans would leave, and the cheapest plan."""
    at = ", ".join(
        f"{sentences.title_of(name)} {pdg(known.value, known.sigma)}"
        for name, known in found.solution.items()
    )
    rows: Iterable[Any] = (
        (each.name, shown(each.signal, ".1f"), _relative(each.event_sigma / each.signal / 100))
        for each in found.candidates
    )
    columns: tuple[str, ...] = ("coupling", "photons per event", "error of 10,000 events")
    signals = table("what would be measured", columns, rows)
    rows = (
        (found.name(chosen), *map(_relative, (error.total, error.priors, error.efficiency)))
        for chosen, error in found.floors.items()
    )
    columns = ("couplings", "total", "priors", "detector efficiency")
    title = "what readings without error would leave of the light yield's"
    floors = table(title, columns, rows)
    rows = (
        row(
            found.name(plan.configurations),
            shown(plan.mountings, "d"),
            shown(plan.events, ",.0f"),
            shown(plan.hours, ".1f"),
            *map(
                _relative,
                (plan.light_yield.statistical, plan.light_yield.systematic, plan.light_yield.total),
            ),
            "" if plan.alpha_scat is None else _relative(plan.alpha_scat.total),
            strong=plan is found.cheapest,
        )
        for plan in found.efficient[-_MOST_PLANS:]
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
    assumed, sets = found.conditions, "; ".join(map(found.name, found.undetermined))
    below = [
        *(Sentence(line, strong=True) for line in sentences.verdict(found)),
        Sentence(
            f"Assumed: {assumed.events_per_second:g} events per second in the band, "
            f"{assumed.minutes_per_mounting:g} minutes per mounting, a scatter of "
            f"{percent(assumed.mounting_scatter)} from mounting to mounting, and a spread of "
            f"{percent(assumed.intrinsic_spread)} of an event's light."
        ),
        *([Sentence(f"Not enough to determine the parameters: {sets}")] if sets else []),
    ]
    begin = Sentence(f"At the campaign's solution: {at}")
    parts: tuple[Part, ...] = (begin, signals, floors, plans, *below)
    return Description("plan of a measurement", parts, notes=found.notes)


def _relative(fraction: float) -> Cell:
    return shown(fraction, percent)
