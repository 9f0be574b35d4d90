"""What the page shows: its texts, and the documents from which the browser draws and writes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2

from mcrim_mitsuba.app.bench_picture import bench_picture, bench_words
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import Control, FitStep, Settings, Shown
from mcrim_mitsuba.campaign.measurements import KIND, LIGHT, SAMPLE, TRANSMITTANCE, Reading
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.files import attributes, plain
from mcrim_mitsuba.core.numbers import titled
from mcrim_mitsuba.core.rounding import counted, number, p_equals, p_text, pdg, probability
from mcrim_mitsuba.efficiency.response_maker import configurations
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.judgement import ADEQUATE
from mcrim_mitsuba.inference.statistic import is_misfit
from mcrim_mitsuba.output import describe_campaign, sentences
from mcrim_mitsuba.output.description import Column, Table, table
from mcrim_mitsuba.output.figure_style import shortened_apart, units_of_signals
from mcrim_mitsuba.output.pages import environment

#: Candidates that are shown.
_MOST_CANDIDATES = 8
#: Below it chi2 is rounding.
_NO_CHI2 = 5e-4
#: Characters of a reading's label in the chart.
_LABEL_LENGTH = 18
#: Steps of a slider.
_SLIDER_STEPS = 1000


def _chi2_text(chi2: float) -> str:
    """What is only the fit's rounding counts as none."""
    return number(chi2) if chi2 >= _NO_CHI2 else "0"


_TEMPLATES = environment(jinja2.FileSystemLoader(Path(__file__).parent / "templates"))
_TEMPLATES.filters |= {"chi2": _chi2_text, "probability": probability}
_TEMPLATES.filters |= {"p": p_text, "p_equals": p_equals}
_TEMPLATES.globals |= {
    # of a parameter's `slider`, `number` and `known`, or of an `effect`'s switch
    "id_of": lambda kind, name: json.dumps({"kind": kind, "name": name}, separators=(",", ":")),
    "steps": _SLIDER_STEPS,
}
_TEMPLATES.globals |= {"sentences": sentences, "describe": describe_campaign, "pdg": pdg}


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
        *(("", title) for title in ("model", "pull", "η", "copy, remove")),
    ]
    merits = {"chi2": "χ²", "p-value": "p", "light-yield": _light_title(session).partition(" (")[0]}
    return _TEMPLATES.get_template("page.html").render(
        session=session,
        campaign=campaign,
        range_text=range_text,
        heads=heads,
        columns=columns,
        choices=choices,
        merits=merits | {"averaged": "averaged over models"},
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
    document = attributes(history, "number settings_number file_number file_kind bench_number")
    job = attributes(status, "words done=bar.done said=failures stopped")
    waiting = [attributes(job, "key words") for job in status.waiting]
    document["job"] = {"key": status.job and status.job.key, **job, "waiting": waiting}
    if history.number == shown_number:
        return document
    settings, measurements = now.settings, now.campaign.measurements
    controls = session.model.live.controls
    # what was undone may know nothing of a number that the readings have now
    values = {**controls.starts, **settings.values}
    tried = now.diagnosis.candidates if now.diagnosis else ()
    gaining = [candidate for candidate in tried if candidate.delta_chi2 > 1.0]
    document |= {
        "settings": settings.to_json() | {"values": values, "known": controls.known(settings)},
        "readings": [
            attributes(reading, f"label signal sigma use {KIND} {SAMPLE}")
            | {n: reading.parameters.get(n, "") for n in measurements.columns}
            for reading in measurements.readings
        ],
        "steps": [
            {"name": step_name(step), "text": f"{fit.chi2:.3g} / {fit.ndf}"}
            | {"height": fit.chi2 / fit.ndf if fit.ndf > 0 else None}
            for step, fit in ((step, step.calibration) for step in now.steps)
        ],
        **attributes(history, "can_undo can_redo"),
        "parts": {"diagnosis": _diagnosis_panel(session), "fitted": _fits_panel(session)},
        "gains": {c.effect: (c.delta_chi2, f"χ² −{sentences.gain_text(c)}") for c in gaining},
    }
    return plain(document)


def step_name(step: FitStep) -> str:
    """``with air bubble in the gap, without air``; of the campaign's own fit ``as it came``."""
    titles = [step.campaign.catalogue[name].title for name in step.settings.effects]
    parts = [f"with {sentences.together(titles)}"] if titles else []
    return ", ".join([*parts, step.words] if step.words else parts) or "as it came"


# What the model says.


def predictions(session: Session, settings: Settings) -> dict[str, Any]:
    """What the browser writes and draws at some settings."""
    readings = session.state.campaign.measurements.readings
    document = attributes(session.history, "settings_number can_undo can_redo")
    try:
        shown = session.model.show(settings)
    except ValueError as error:  # effects that exclude each other
        return document | {"texts": {"pending": str(error)}}
    beside = session.model.shown_beside()
    pending = ""
    if shown and shown.pending:
        titles = [session.model.live.controls.effects[name][0].title for name in shown.pending]
        pending = f"These numbers are without {sentences.together(titles)}: not simulated yet."
    document |= {
        "texts": {**_texts(session, settings, shown), "pending": pending},
        "cells": _readings_cells(readings, shown),
        "scale": shown and shown.scale,
        "pending": bool(pending),
        "chart": {**_chart(readings, shown, beside), "unit": session.state.campaign.unit},
    }
    return plain(document)


def _texts(session: Session, settings: Settings, shown: Shown | None) -> dict[str, str]:
    """What the model says in words and in figures of merit, by the ids of their places."""
    texts = dict.fromkeys(("chi2", "p-value", "light-yield"), "…")
    texts |= {"averaged": "", **{f"{place}-words": "" for place in (*texts, "averaged")}}
    if shown is None:
        idle = session.jobs.status.job is None
        words = "nothing is simulated yet: press Fit" if idle else "being simulated"
        return texts | {"chi2-words": words, "answer": words, "warning": ""}
    step, unit = session.model.fit_at(settings), "" if shown.light_yield is None else " ph/keV"
    light = number(shown.scale if shown.light_yield is None else shown.light_yield, 4)
    light = light if step is None else sentences.light_text(step.calibration)
    texts |= {
        "chi2": _chi2_text(shown.chi2),
        "chi2-words": counted(shown.ndf, "degree") + " of freedom",
        "p-value": p_text(shown.p_value),
        "p-value-words": "chance of a larger χ²",
        "light-yield": f"{light}{unit}",
        "light-yield-words": "whole error of the fit" if step else "moved by hand: press Fit",
        "answer": _answer(session, settings, shown, step),
        "warning": "" if step is None else _gravest(step.calibration),
    }
    if shown.p_value is None:
        texts["p-value-words"] = "nothing to judge by: the readings determine the parameters"
    diagnosis = session.state.diagnosis
    averaged = diagnosis and diagnosis.light_yield_averaged
    if averaged:
        texts["averaged"] = f"{pdg(averaged.value, averaged.sigma)} ph/keV"
        texts["averaged-words"] = "whole error, by Diagnose"
    return texts


def _answer(session: Session, settings: Settings, shown: Shown, step: FitStep | None) -> str:
    """Whether the bench explains the readings, in a sentence."""
    titles = [session.model.live.controls.effects[name][0].title for name in settings.effects]
    bench = f"The bench with {sentences.together(titles)}" if titles else "The bench"
    bench += "" if step else ", moved by hand,"
    fails = is_misfit(shown.chi2, shown.p_value)
    if shown.p_value is None and not fails:
        return f"{bench} cannot be judged: these readings only just determine its parameters."
    verb = "does not explain" if fails else "explains"
    diagnosis = session.state.diagnosis
    needless = titles and diagnosis and diagnosis.verdict == ADEQUATE
    without = " Nothing had to be added: it does without." if needless else ""
    return f"{bench} {verb} these readings: {p_equals(shown.p_value)}.{without}"


def _gravest(fit: Calibration) -> str:
    """What a reader must know of a fit before anything else; empty where there is nothing."""
    of_fit = [note for note in fit.notes if note not in fit.model.campaign.notes]
    lost = [note for note in of_fit if "decimal point" in note]
    misfit = [n.partition("; ")[2] for n in of_fit if n.startswith("the model does not describe")]
    if misfit:
        return f"Do not quote the numbers of this fit: {(*lost, *misfit)[0]}"
    return next((f"Note: {note}" for note in (*of_fit, *fit.notes)), "")


def _readings_cells(readings: Sequence[Reading], shown: Shown | None) -> list[list[str]]:
    """What the model says of every reading; nothing before there are predictions."""
    if shown is None:
        return [["…", "…", "…"] for _ in readings]
    cells = []
    for row in shown.rows:
        model = sentences.signal_text(row.of_beam, row.model, row.model_sigma)
        eta = "" if row.of_beam else pdg(row.eta, row.eta_sigma)
        cells.append([model, f"{row.pull:+.2f}", eta])
    return cells


def _chart(
    readings: Sequence[Reading], shown: Shown | None, beside: tuple[FitStep, Shown] | None
) -> dict[str, Any]:
    """Readings beside predictions, each signal in the unit of the chart's axis."""
    units = units_of_signals([(r.signal, r.of_beam) for r in readings])
    of_beams = (unit / 100.0 for r, unit in zip(readings, units, strict=True) if r.of_beam)

    def heights(rows: Sequence[FittedRow]) -> dict[str, Any]:
        return {"model": units * [row.model for row in rows], "pull": [row.pull for row in rows]}

    return {
        "signal": units * [r.signal for r in readings],
        "sigma": units * [r.sigma for r in readings],
        "use": [r.use for r in readings],
        "short": shortened_apart([r.label for r in readings], _LABEL_LENGTH),
        "percent": next(of_beams, None),
        "model": shown and heights(shown.rows),
        "beside": beside and {"name": step_name(beside[0]), **heights(beside[1].rows)},
    }


def reading(session: Session, place: int) -> str:
    """A reading with its bench; what the model says of it, the browser writes there."""
    measurements = session.state.campaign.measurements
    reading = measurements.readings[place]
    campaign, settings = session.state.campaign, session.state.settings
    # what is switched on is drawn as large as it is now
    on = [p.name for name in settings.effects for p in campaign.catalogue[name].parameters]
    sizes = {name: settings.values[name] for name in on if name in settings.values}
    values = {**configurations(campaign)[place], **sizes}
    return _TEMPLATES.get_template("reading.html").render(
        reading=reading,
        picture=bench_picture(reading, values),
        words=bench_words(reading, values, measurements.columns),
        measured=sentences.signal_text(reading.of_beam, reading.signal, reading.sigma),
    )


# Panels.


def _diagnosis_panel(session: Session) -> str:
    """A card of what leads, and the candidates, each with a button that adds it."""
    diagnosis, shown = session.state.diagnosis, None
    leading = sentences.leading_candidates(diagnosis) if diagnosis else []
    if leading:
        settings = Settings(leading[0].effects, session.state.settings.values)
        shown = session.model.live.show(session.state.campaign, session.at_found(settings))
    ranked: list[tuple[str, Candidate | None, float | None]] = []
    if diagnosis:  # what is no effect stands where its probability puts it
        chances = diagnosis.probabilities
        candidates = {c.effect: c for c in (*leading, *diagnosis.candidates[:_MOST_CANDIDATES])}
        named = [*candidates, *(name for name in sentences.NO_EFFECTS if name in chances)]
        named.sort(key=lambda name: -chances.get(name, 0.0))
        ranked = [(name, candidates.get(name), chances.get(name)) for name in named]
    template = _TEMPLATES.get_template("diagnosis.html")
    return template.render(diagnosis=diagnosis, ranked=ranked, leading=leading, shown=shown)


def _fits_panel(session: Session) -> str:
    """All fits, the last one's parameters, and two of them side by side."""
    now = session.state
    if not now.steps:
        return ""
    last, beside = now.steps[-1], now.beside
    return _TEMPLATES.get_template("fits.html").render(
        steps=now.steps,
        last=last,
        name_of=step_name,
        light_title=_light_title(session),
        held=[f"{sentences.title_of(n)} = {v:.4g}" for n, v in last.calibration.fixed.items()],
        beside=beside,
        compared=() if beside is last else _side_by_side(beside, last),
    )


_MERITS = (
    Column("χ²", form=_chi2_text, of="chi2"),
    Column("degrees of freedom", form="d", of="ndf"),
    Column("p", form=p_text, of="p_value"),
)


def _side_by_side(*steps: FitStep) -> tuple[Table, Table, Table]:
    """Two fits, row by row: how good they are, their parameters, and their pulls."""
    fits = {f"{place}. {step_name(step)}": step.calibration for place, step in enumerate(steps, 1)}
    pulls = [{row.label: f"{row.pull:+.2f}" for row in fit.rows} for fit in fits.values()]
    labels = dict.fromkeys(itertools.chain(*pulls))
    rows = ((label, *(of_fit.get(label, "-") for of_fit in pulls)) for label in labels)
    return (
        describe_campaign.side_by_side("", _MERITS, fits),
        describe_campaign.sizes_beside(fits, typed=True),
        table("", ("reading", *fits), rows),
    )
