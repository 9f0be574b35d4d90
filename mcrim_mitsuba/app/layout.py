"""What the page shows: its texts and tables, and what stands where."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dash import dcc, html

from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import Control, FitStep, Shown, State
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.rounding import number, p_text, pdg, probability
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.diagnose import Diagnosed
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.output.described import Table
from mcrim_mitsuba.output.descriptions import limits_table, parameters_table
from mcrim_mitsuba.output.findings import (
    averaged_yield,
    bought,
    configuration_text,
    gain_text,
    headline,
    leading_candidates,
    looks,
    plausibility,
    set_aside_text,
    signal_text,
    size_text,
    suspicion,
    together,
)

#: Candidates that are shown.
_MOST_CANDIDATES = 8
#: Below it chi2 is rounding.
_NO_CHI2 = 5e-4
_READINGS_HEAD = ("reading", "measured", "model", "pull", "η")
_NO_CELLS = ("",) * (len(_READINGS_HEAD) - 1)


def merits(light_title: str) -> list[html.Div]:
    """Places for chi2, p-value and light yield, which `merit_texts` fills."""
    names = {"chi2": "χ²", "p-value": "p", "light-yield": light_title}
    return [
        html.Div(className="merit", children=[
            html.Span(name, className="name"),
            html.Span("…", className="value", id=place),
            html.Span(className="words", id=f"{place}-words"),
        ])
        for place, name in names.items()
    ]  # fmt: skip


def merit_texts(shown: Shown | None) -> dict[str, str]:
    """What stands in the places of `merits`, by id."""
    if shown is None:
        return {"chi2-words": "being simulated"}
    texts = {
        "chi2": _chi2_text(shown.chi2),
        "chi2-words": f"{shown.ndf} degrees of freedom",
        "p-value": p_text(shown.p_value),
        "p-value-words": "chance of a larger χ² if the model is right",
        "light-yield": number(shown.scale, 4),
        "light-yield-words": "signal at η = 1",
    }
    if shown.p_value is None:
        texts["p-value-words"] = "nothing to judge by: the readings determine the parameters"
    if shown.light_yield is not None:
        value, statistical, systematic = shown.light_yield
        digits = 3 if statistical < 0.05 else 2
        texts["light-yield"] = f"{value:.{digits}f}"
        texts["light-yield-words"] = (
            f"± {statistical:.{digits}f} readings, all else held; ± {systematic:.2f} detector"
        )
    return texts


def _chi2_text(chi2: float) -> str:
    """What is only the fit's rounding counts as none."""
    return number(chi2) if chi2 >= _NO_CHI2 else "0"


def readings_table(readings: Sequence[Reading]) -> html.Table:
    """Every reading, with empty cells for `readings_cells`."""
    labels = [r.label if r.use else f"{r.label} (not used)" for r in readings]
    return _table(_READINGS_HEAD, [(html.Bdi(label), *_NO_CELLS) for label in labels])


def readings_cells(rows: Sequence[FittedRow], shown: bool) -> list[list[str]]:
    """What stands beside the readings' labels; predictions only where there are some.

    The browser writes it into the table by itself: hundreds of components would take too long.
    """
    if not shown:
        return [[signal_text(r.of_beam, r.measured, r.sigma), "…", "…", "…"] for r in rows]
    return [
        [signal_text(row.of_beam, row.measured, row.sigma),
         signal_text(row.of_beam, row.model, row.model_sigma), f"{row.pull:+.2f}",
         "" if row.of_beam else pdg(row.eta, row.eta_sigma)]
        for row in rows
    ]  # fmt: skip


def diagnosis_panel(found: Diagnosed | None) -> list:
    """The verdict and the candidates, each with a button that adds it."""
    if found is None:
        return [_hint(
            "The campaign as it came is fitted with each effect of the catalogue in turn. "
            "The first time takes about a minute; what was simulated is kept."
        )]  # fmt: skip
    diagnosis = found.diagnosis
    parts: list = []
    if averaged := averaged_yield(diagnosis):
        parts.append(html.P(html.Bdi(averaged), className="verdict", id="averaged"))
    parts.append(html.P(html.Bdi(headline(diagnosis)), className="verdict", id="verdict"))
    parts += [_hint(html.Bdi(suspicion(one))) for one in diagnosis.suspect_readings]
    leading = leading_candidates(diagnosis)
    if diagnosis.candidates:
        ranked = {id(c): c for c in (*leading, *diagnosis.candidates[:_MOST_CANDIDATES])}
        parts.append(_candidates(ranked.values(), leading, diagnosis.probabilities))
        parts += [_hint(html.Bdi(text)) for text in (set_aside_text(diagnosis),) if text]
        looking = html.Ul([html.Li(html.Bdi(text)) for text in looks(diagnosis)])
        if leading:
            parts.append(_details("How to look for it, without a fit", looking))
    if diagnosis.upper_limits:
        limits = _shown(limits_table(diagnosis))
        parts.append(_details("What the readings allow (95 % confidence)", limits))
    if diagnosis.next_measurements:
        configurations = [(configuration_text(m), *bought(m)) for m in diagnosis.next_measurements]
        head = ("configuration", "time", "light yield to", "sure to")
        parts.append(_details("What to measure next", _table(head, configurations)))
    return parts


def _hint(text: Any, **options: Any) -> html.P:
    return html.P(text, className="hint", **options)


def _details(summary: str, table: html.Table | html.Ul) -> html.Details:
    return html.Details([html.Summary(summary), html.Div(table, className="scroll")])


def _candidates(
    candidates: Iterable[Candidate], leading: Sequence[Candidate], known: Mapping[str, float]
) -> html.Div:
    cells = []
    for place, one in enumerate(candidates):
        aria: dict[str, Any] = {"aria-label": f"add {together(one.effects)} and fit"}
        button = html.Button(
            "Add", id={"kind": "add", "effects": " ".join(one.effects)},
            className="main" if place == 0 and leading else "", **aria,
        )  # fmt: skip
        cells.append((
            button, html.Bdi(one.effect), _bar(known.get(one.effect)), size_text(one, ", "),
            plausibility(one), gain_text(one), p_text(one.p_value),
        ))  # fmt: skip
    head = ("", "effect", "probability", "size", "plausible?", "fall of χ²", "p of the fit")
    return html.Div(_table(head, cells), className="scroll")


def _bar(p: float | None) -> html.Div | str:
    """A probability with a bar as long."""
    if p is None:
        return ""
    return html.Div([html.Progress(value=f"{p:.4f}", max="1"), f" {probability(p)}"])


def fitted_panel(state: State) -> list:
    """The parameters of the last fit, and what must be known of it."""
    if not state.steps:
        return []
    step: FitStep = state.steps[-1]
    fit = step.calibration
    what = f"with {together(step.effects)}" if step.effects else "as it came"
    return [
        html.H3(f"The last fit, {what}: χ² = {_chi2_text(fit.chi2)}, ndf {fit.ndf}, "
                f"p = {p_text(fit.p_value)}"),
        _shown(parameters_table(fit.parameters)),
        *(_hint(html.Bdi(note)) for note in fit.notes),
    ]  # fmt: skip


def _shown(table: Table) -> html.Table:
    head = [column.title for column in table.columns]
    return _table(head, ([cell.text for cell in row.cells] for row in table.rows))


def _table(head: Sequence[str], rows: Iterable[Sequence]) -> html.Table:
    return html.Table([
        html.Thead(html.Tr([html.Th(name, scope="col") for name in head])),
        html.Tbody([html.Tr([html.Td(cell) for cell in row]) for row in rows]),
    ])  # fmt: skip


# What stands where; what it does is in `page`.

#: Steps of a slider.
SLIDER_STEPS = 1000
#: Where the browser asks for predictions while a slider moves, below the page's address.
PREDICTIONS = "predictions"
#: Milliseconds between looks at the running job, and when there is none.
BUSY_MS, IDLE_MS = 300, 4000
_NO_BAR: dcc.Graph.Config = {"displayModeBar": False, "responsive": True}


def id_of(kind: str, name: str) -> dict[str, str]:
    """Of a parameter's `slider` or `number` field; of an `effect`'s switch, and its `sizes`."""
    return {"kind": kind, "name": name}


def page(session: Session) -> html.Div:
    """The whole page, as the session is now."""
    numbers = {
        "state-number": -1, "settings-number": session.state.settings_number,
        "file-number": session.state.file_number, "kick": 0, "reload": 0,
    }  # fmt: skip
    return html.Div(id="page", children=[
        dcc.Interval(id="clock", interval=BUSY_MS),
        *(dcc.Store(id=name, data=data) for name, data in numbers.items()),
        *(dcc.Store(id=name) for name in ("shown", "drawn", "settled", "upload-content")),
        dcc.Download(id="download"),
        _header(session),
        html.Main(className="columns", children=[
            html.Div([_files(), _parameters(session), _effects(session)], className="controls"),
            html.Div([_model(session), _diagnosis()], className="results"),
        ]),
    ])  # fmt: skip


def _header(session: Session) -> html.Header:
    campaign = session.campaign
    return html.Header([
        html.H1(["MCRIM: ", html.Bdi(campaign.path.name)]),
        html.P(className="sources", children=[
            "scene ", html.Bdi(campaign.scene.path.name), ", readings ",
            html.Bdi(campaign.measurements.path.name, id="readings-name"),
            f" ({len(campaign.measurements.readings)})",
        ]),
        html.Div(className="job", children=[
            html.Progress(id="progress", value="0", max="1"),
            html.Span("starting", id="status", role="status"),
            html.Button("Stop", id="stop", className="quiet", hidden=True),
        ]),
        *(html.P(id=name, role="alert", className="error") for name in ("slip", "error")),
    ])  # fmt: skip


def _buttons(names: Mapping[str, str], main: str = "") -> html.Div:
    """Buttons by id; one of them may be the `main` one."""
    look: dict[str, dict[str, Any]] = {main: {"className": "main"}}
    return html.Div(className="buttons", children=[
        html.Button(name, id=key, **look.get(key, {})) for key, name in names.items()
    ])  # fmt: skip


def _files() -> html.Section:
    aria: dict[str, Any] = {"aria-label": "files"}
    return html.Section([
        html.H2("Files"),
        dcc.Upload(
            html.Button("Upload readings (CSV)", id="upload-button"),
            id="upload", className="upload", className_active="upload over",
        ),
        _hint("Or drop the file here. The scene and what is known beforehand stay."),
        _buttons({f"get-{what}": f"Download {what}" for what in ("scene", "campaign", "report")}),
    ], **aria)  # fmt: skip


def _switch(name: Any, value: str, on: bool, **options: Any) -> dcc.Checklist:
    return dcc.Checklist([{"label": name, "value": value}], [value] if on else [], **options)


def _parameters(session: Session) -> html.Section:
    free = any(control.name == "scale" for control in session.controls)
    return html.Section([
        html.H2("Parameters"),
        *sizes(session, session.controls),
        _switch(
            "the scale follows the readings", "fit", session.state.settings.fit_scale,
            id="fit-scale", style=None if free else {"display": "none"},
        ),
        _buttons({"fit": "Fit", "back": "Back to the campaign as it came"}, main="fit"),
    ])  # fmt: skip


def _effects(session: Session) -> html.Section:
    return html.Section([
        html.H2("Effects"),
        _hint("Each was left out of the bench. The first use of one simulates it."),
        *(_effect(session, effect, controls) for effect, controls in session.effects.values()),
        *(_hint(html.Bdi(reason)) for reason in session.refused),
    ])  # fmt: skip


def _effect(session: Session, effect: Effect, controls: Sequence[Control]) -> html.Div:
    """Its physics stands where the mouse rests on its name."""
    on = effect.name in session.state.settings.effects
    name = html.Span([effect.title, " ", html.Small(effect.name)], title=effect.physics)
    return html.Div(className="effect", children=[
        _switch(name, "on", on, id=id_of("effect", effect.name)),
        html.Div(sizes(session, controls) if on else [], id=id_of("sizes", effect.name)),
    ])  # fmt: skip


def sizes(session: Session, controls: Sequence[Control]) -> list[html.Div]:
    """What moves parameters, and effects that are on: all on the page slows every change of it."""
    values = session.state.settings.values
    return [_control(control, values.get(control.name, control.start)) for control in controls]


def _control(control: Control, value: float) -> html.Div:
    """A name, a slider and a number that follow each other."""
    unit = f" ({control.unit})" if control.unit else ""
    field = id_of("number", control.name)
    axis = {name: getattr(control, name) for name in ("minimum", "maximum", "coordinate", "scale")}
    return html.Div(className="control", children=[
        html.Label(
            control.title + unit, title=control.meaning or control.name,
            # its id in the browser
            htmlFor=json.dumps(field, sort_keys=True, separators=(",", ":")),
        ),
        dcc.Input(
            id=id_of("slider", control.name), type="range", min=0, max=SLIDER_STEPS, step=1,
            value=round(SLIDER_STEPS * control.part_at(value)), debounce=False,
        ),
        dcc.Input(
            id=field, type="number", value=float(f"{value:.6g}"),
            min=control.minimum, max=control.maximum, step="any", debounce=True,
        ),
        dcc.Store(id=id_of("axis", control.name), data=axis | {"steps": SLIDER_STEPS}),
    ])  # fmt: skip


def _model(session: Session) -> html.Section:
    readings = session.campaign.measurements.readings
    return html.Section([
        html.H2("Readings and model"),
        html.Div(merits(session.light_title), id="figures-of-merit", className="merits"),
        _hint(None, id="pending"),
        # drawn by the browser itself: through Dash it would take longer
        html.Div(html.Div(), id="readings-chart", className="chart tall"),
        html.Details(id="table-details", children=[
            html.Summary("The same as a table"),
            html.Div(readings_table(readings), id="rows", className="scroll"),
        ]),
    ])  # fmt: skip


def _diagnosis() -> html.Section:
    chart = dcc.Graph(id="falling-chart", config=_NO_BAR)
    return html.Section([
        html.H2("What is missing?"),
        _buttons({"diagnose": "Diagnose"}, main="diagnose"),
        html.Div(id="diagnosis"),
        html.H2("The error, fit by fit"),
        # the graph fills what is around it, whatever its own class says
        html.Div(chart, className="chart"),
        html.Div(id="fitted", className="scroll"),
    ])  # fmt: skip
