"""What the page shows: its texts, and the documents from which the browser draws and writes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from mcrim_mitsuba.app.bench_picture import bench_picture, bench_words
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import HELD, Control, FitStep, Settings, Shown
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, SAMPLE, TRANSMITTANCE, Reading
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.files import plain
from mcrim_mitsuba.core.numbers import titled
from mcrim_mitsuba.core.rounding import (
    capital,
    counted,
    number,
    p_equals,
    p_text,
    pdg,
    pdg_parts,
    probability,
    unbroken,
)
from mcrim_mitsuba.efficiency.response_maker import configurations
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.diagnose import Diagnosed, Diagnosis
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow, ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.output import sentences
from mcrim_mitsuba.output.describe_campaign import limits_table
from mcrim_mitsuba.output.description import Table
from mcrim_mitsuba.output.figure_style import shortened, units_of_signals

#: Candidates that are shown.
_MOST_CANDIDATES = 8
#: Below it chi2 is rounding.
_NO_CHI2 = 5e-4
#: Characters of a reading's label in the chart.
_LABEL_LENGTH = 22
#: Steps of a slider.
_SLIDER_STEPS = 1000


def _compound_id(kind: str, name: str) -> str:
    """The id of a parameter's `slider`, `number` and `known`, or of an `effect`'s switch."""
    return json.dumps({"kind": kind, "name": name}, sort_keys=True, separators=(",", ":"))


_TEMPLATES = jinja2.Environment(
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    finalize=unbroken,
    loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
)
_TEMPLATES.filters["capital"] = capital
_TEMPLATES.globals |= {"id_of": _compound_id, "steps": _SLIDER_STEPS}


def page(session: Session) -> str:
    """The whole page, as the session is now."""
    campaign = session.state.campaign
    columns = [(name, titled(name)) for name in campaign.measurements.columns]
    choices: dict[str, tuple[str, ...]] = {}
    if session.has_beams:
        choices[KIND] = (LIGHT, TRANSMITTANCE)
    if campaign.samples:
        choices[SAMPLE] = ("", *campaign.samples)
    heads = [
        ("use", "use"),
        ("label", "reading"),
        *((name, name) for name in choices),
        ("signal", "measured"),
        ("sigma", "± error"),
        *columns,
        *(("", title) for title in ("model", "pull", "η", "")),
    ]
    return _TEMPLATES.get_template("page.html").render(
        session=session,
        campaign=campaign,
        range_text=range_text,
        heads=heads,
        columns=columns,
        choices=choices,
        merits={
            "chi2": "χ²",
            "p-value": "p",
            "light-yield": _light_title(session),
            "averaged": "averaged over models",
        },
    )


def range_text(control: Control) -> str:
    """What a field takes, in words."""
    unit = f" {control.unit}" if control.unit and control.name != SCALE else ""
    return f"from {number(control.minimum, 4)} to {number(control.maximum, 4)}{unit}"


def _light_title(session: Session) -> str:
    """What is proportional to the light: the light yield, or else the scale."""
    campaign = session.state.campaign
    has_yield = campaign.light_yield is not None and SCALE in campaign.free
    return "light yield (ph/keV)" if has_yield else SCALE


# How the session is.


def state(session: Session, shown_number: int) -> dict[str, Any]:
    """What the browser asks again and again: only numbers, where it shows the state of this one."""
    status, now, history = session.jobs.status, session.state, session.history
    document: dict[str, Any] = {
        "number": history.number,
        "settings_number": history.settings_number,
        "file_number": history.file_number,
        "bench_number": history.bench_number,
        "job": {
            "key": status.job and status.job.key,
            "words": status.words,
            "done": status.done,
            "total": status.total,
            "said": status.failures,
            "stopped": status.stopped,
            "waiting": [{"key": job.key, "words": job.words} for job in status.waiting],
        },
    }
    if history.number == shown_number:
        return document
    settings = now.settings
    document |= {
        "settings": {**settings.to_json(), "known": session.model.live.controls.known(settings)},
        "readings": [
            {
                "label": r.label,
                "signal": r.signal,
                "sigma": r.sigma,
                "use": r.use,
                KIND: r.kind,
                SAMPLE: r.sample,
                **{name: r.parameters.get(name, "") for name in now.campaign.measurements.columns},
            }
            for r in now.campaign.measurements.readings
        ],
        "steps": [_falling(step) for step in now.steps],
        "can_undo": history.can_undo,
        "parts": {
            "diagnosis": _diagnosis_panel(now.diagnosed),
            "fitted": _fits_panel(session),
        },
    }
    return plain(document)


def _falling(step: FitStep) -> dict[str, Any]:
    """A fit in the chart of the error."""
    fit = step.calibration
    return {
        "name": step_name(step),
        "text": f"{fit.chi2:.3g} / {fit.ndf}",
        "height": fit.chi2 / fit.ndf if fit.ndf > 0 else None,
    }


def step_name(step: FitStep) -> str:
    """``with air bubble in the gap, without air``; of the campaign's own fit ``as it came``."""
    titles = [step.campaign.catalogue[name].title for name in step.settings.effects]
    parts = [f"with {sentences.together(titles)}"] if titles else []
    return ", ".join([*parts, step.words] if step.words else parts) or "as it came"


# What the model says.


def predictions(session: Session, settings: Settings) -> dict[str, Any]:
    """What the browser writes and draws at some settings."""
    readings = session.state.campaign.measurements.readings
    try:
        shown = session.model.show(settings)
    except ValueError as error:  # effects that exclude each other
        return {
            "settings_number": session.history.settings_number,
            "texts": {"pending": str(error)},
        }
    beside = session.model.shown_beside()
    pending = ""
    if shown and shown.pending:
        titles = [session.model.live.controls.effects[name][0].title for name in shown.pending]
        pending = f"These numbers are without {sentences.together(titles)}: not simulated yet."
    texts = {**_merit_texts(shown, session), "pending": pending}
    return plain(
        {
            "settings_number": session.history.settings_number,
            "texts": texts,
            "cells": _readings_cells(readings, shown),
            "scale": shown and shown.scale,
            "pending": bool(pending),
            "chart": _chart(readings, shown, beside, session.state.campaign.unit),
        }
    )


def _merit_texts(shown: Shown | None, session: Session) -> dict[str, str]:
    """What stands in the places of the figures of merit, by id."""
    texts = dict.fromkeys(("chi2", "p-value", "light-yield"), "…")
    texts |= {"averaged": "", **{f"{place}-words": "" for place in (*texts, "averaged")}}
    if shown is None:
        idle = session.jobs.status.job is None
        texts["chi2-words"] = "nothing is simulated yet: press Fit" if idle else "being simulated"
        return texts
    texts |= {
        "chi2": _chi2_text(shown.chi2),
        "chi2-words": counted(shown.ndf, "degree") + " of freedom",
        "p-value": p_text(shown.p_value),
        "p-value-words": "chance of a larger χ²",
        "light-yield": number(shown.scale, 4),
        "light-yield-words": "signal at η = 1",
    }
    if shown.p_value is None:
        texts["p-value-words"] = "nothing to judge by: the readings determine the parameters"
    if shown.light_yield is not None:
        value, statistical, systematic = shown.light_yield
        parts = [part for part in (statistical, systematic) if part]
        texts["light-yield"] = pdg_parts(value, *parts) if parts else number(value, 4)
        words = ["readings, all else held" if statistical else "", "detector" if systematic else ""]
        texts["light-yield-words"] = " ".join(f"± {origin}" for origin in words if origin)
    diagnosed = session.state.diagnosed
    averaged = diagnosed and diagnosed.diagnosis.light_yield_averaged
    if averaged:
        texts["averaged"] = pdg(averaged.value, averaged.sigma)
        texts["averaged-words"] = "ph/keV ± whole error, by Diagnose"
    return texts


def _chi2_text(chi2: float) -> str:
    """What is only the fit's rounding counts as none."""
    return number(chi2) if chi2 >= _NO_CHI2 else "0"


def _readings_cells(readings: Sequence[Reading], shown: Shown | None) -> list[list[str]]:
    """What the model says of every reading; nothing before there are predictions."""
    if shown is None:
        return [["…", "…", "…"] for _ in readings]
    return [
        [
            sentences.signal_text(row.of_beam, row.model, row.model_sigma),
            f"{row.pull:+.2f}",
            "" if row.of_beam else pdg(row.eta, row.eta_sigma),
        ]
        for row in shown.rows
    ]


def _chart(
    readings: Sequence[Reading],
    shown: Shown | None,
    beside: tuple[FitStep, Shown] | None,
    unit: str,
) -> dict[str, Any]:
    """Readings beside predictions, each signal in the unit of the chart's axis."""
    units = units_of_signals([(r.signal, r.of_beam) for r in readings]).tolist()

    def heights(rows: Iterable[FittedRow]) -> dict[str, list[float]]:
        pairs = list(zip(rows, units, strict=True))
        return {"model": [u * row.model for row, u in pairs], "pull": [r.pull for r, _ in pairs]}

    return {
        "signal": [u * r.signal for r, u in zip(readings, units, strict=True)],
        "sigma": [u * r.sigma for r, u in zip(readings, units, strict=True)],
        "use": [r.use for r in readings],
        "short": [shortened(r.label, _LABEL_LENGTH) for r in readings],
        "unit": unit,
        "percent": next(
            (u / 100.0 for r, u in zip(readings, units, strict=True) if r.of_beam), None
        ),
        "model": shown and heights(shown.rows),
        "beside": beside and {"name": step_name(beside[0]), **heights(beside[1].rows)},
    }


def reading(session: Session, place: int) -> str:
    """A reading with its bench; what the model says of it, the browser writes there."""
    measurements = session.state.campaign.measurements
    reading = measurements.readings[place]
    values = configurations(session.state.campaign)[place]
    return _TEMPLATES.get_template("reading.html").render(
        reading=reading,
        picture=bench_picture(reading, values),
        words=bench_words(reading, values, measurements.columns),
        measured=sentences.signal_text(reading.of_beam, reading.signal, reading.sigma),
    )


# Panels.


def _diagnosis_panel(diagnosed: Diagnosed | None) -> str:
    """The verdict and the candidates, each with a button that adds it."""
    template = _TEMPLATES.get_template("diagnosis.html")
    if diagnosed is None:
        return template.render(diagnosis=None)
    diagnosis = diagnosed.diagnosis
    leading = sentences.leading_candidates(diagnosis)
    return template.render(
        diagnosis=diagnosis,
        averaged=sentences.averaged_yield(diagnosis),
        headline=sentences.headline(diagnosis),
        leading=bool(leading),
        suspicions=[sentences.suspicion(reading) for reading in diagnosis.suspect_readings],
        titles=("probability", "size", "plausible?", "fall of χ²", "p of the fit"),
        candidates=_ranked(diagnosis, leading) if diagnosis.candidates else (),
        set_aside=sentences.set_aside_text(diagnosis),
        looks=sentences.how_to_look(diagnosis),
        limits=_cells(limits_table(diagnosis).seen) if diagnosis.upper_limits else None,
        next=[(m.words, *sentences.measurement_value(m)) for m in diagnosis.next_measurements],
    )


def _ranked(diagnosis: Diagnosis, leading: Sequence[Candidate]) -> list[dict[str, Any]]:
    """Rows of the ranking; what is no effect stands where its probability puts it."""
    ranked = {id(c): c for c in (*leading, *diagnosis.candidates[:_MOST_CANDIDATES])}
    rows: list[dict[str, Any]] = [
        {
            "effects": candidate.effects,
            "effect": candidate.effect,
            "title": sentences.in_words(diagnosis, candidate.effects),
            "first": bool(leading) and candidate is leading[0],
            "cells": (
                sentences.size_text(candidate, ", "),
                sentences.plausibility(candidate),
                sentences.gain_text(candidate),
                p_text(candidate.p_value),
            ),
        }
        for candidate in ranked.values()
    ]
    rows += [
        {"effects": (), "effect": name, "title": words, "cells": ("",) * 4}
        for name, words in sentences.NO_EFFECTS.items()
        if name in diagnosis.probabilities
    ]
    for row in rows:
        row["p"] = diagnosis.probabilities.get(row["effect"])
        row["probability"] = "" if row["p"] is None else probability(row["p"])
    return sorted(rows, key=lambda row: -(row["p"] or 0.0))


def _cells(table: Table) -> tuple[list[str], list[list[str]]]:
    head = [column.title for column in table.columns]
    return head, [[cell.text for cell in row.cells] for row in table.rows]


def _fits_panel(session: Session) -> str:
    """All fits, the last one's parameters, and two of them side by side."""
    now = session.state
    if not now.steps:
        return ""
    last, beside = now.steps[-1], now.beside
    fixed = last.calibration.fixed.items()
    return _TEMPLATES.get_template("fits.html").render(
        steps=[_listed(session, step) for step in now.steps],
        compared=beside.number,
        last=_listed(session, last),
        parameters=_parameters(last.calibration.parameters),
        held=[f"{sentences.title_of(n)} = {v:.4g}" for n, v in fixed],
        notes=last.calibration.notes,
        beside=None if beside is last else _side_by_side(session, beside, last),
    )


def _listed(session: Session, step: FitStep) -> dict[str, Any]:
    """A fit in the list."""
    fit = step.calibration
    name = LIGHT_YIELD if LIGHT_YIELD in fit.parameters else SCALE
    light = fit.parameters.get(name)
    return {
        "number": step.number,
        "name": step_name(step),
        "chi2": _chi2_text(fit.chi2),
        "ndf": fit.ndf,
        "p": p_text(fit.p_value),
        "chance": p_equals(fit.p_value),
        "light": "held" if light is None else sentences.estimate_text(light),
        "light_title": _light_title(session),
    }


def _titled(name: str) -> str:
    """A parameter in words, and its name in small print where that is another."""
    title = sentences.title_of(name)
    return title if title == name else Markup("{} <small>{}</small>").format(title, name)


def _parameters(parameters: Mapping[str, ParameterEstimate]) -> list[tuple[str, ...]]:
    """What it is, value with the whole error, what repeating lowers of it, and the rest."""
    rows = []
    for name, estimate in parameters.items():
        errors: tuple[str, ...] = ("", "")
        if estimate.at_bound is None and estimate.contributions:
            errors = tuple(number(part, 2) for part in sentences.errors_apart(estimate))
        rows.append((_titled(name), sentences.estimate_text(estimate), *errors))
    return rows


def _side_by_side(session: Session, first: FitStep, second: FitStep) -> dict[str, Any]:
    """Two fits, row by row."""
    fits = (first.calibration, second.calibration)
    listed = [_listed(session, step) for step in (first, second)]
    merits = {"χ²": "chi2", "degrees of freedom": "ndf", "p": "p"}
    rows = [(title, *(fit[merit] for fit in listed)) for title, merit in merits.items()]

    def cell(fit: Calibration, name: str) -> str:
        if name in fit.parameters:
            return sentences.estimate_text(fit.parameters[name])
        return f"{fit.fixed[name]:.4g}, {HELD}" if name in fit.fixed else "-"

    for name in dict.fromkeys(n for fit in fits for n in (*fit.parameters, *fit.fixed)):
        rows.append((_titled(name), *(cell(fit, name) for fit in fits)))
    pulls = [{row.label: f"{row.pull:+.2f}" for row in fit.rows} for fit in fits]
    return {
        "names": [fit["name"] for fit in listed],
        "rows": rows,
        "pulls": [
            (label, *(of_fit.get(label, "-") for of_fit in pulls))
            for label in dict.fromkeys(itertools.chain(*pulls))
        ],
    }
