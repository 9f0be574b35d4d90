"""The page's behaviour: what follows from a slider, a switch, a button, a file.

Ids in the browser: `readings-chart`, `falling-chart`, `chi2`, `p-value`, `light-yield`, `rows` (the
table), `verdict`, `status`, `progress`, `error` (of a job), `slip` (of a file or a button),
`pending`; buttons `upload-button` (its file field lies in `upload`), `fit`, `back`, `diagnose`,
`stop`, `get-scene`, `get-campaign`, `get-report`; compound ids are JSON with sorted keys, such as
``{"kind":"slider","name":"alpha_scat_per_cm"}``, of kinds `slider`, `number`, `effect` and
``{"effects":...,"kind":"add"}``.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import flask
from dash import ALL, MATCH, ClientsideFunction, Dash, Input, Output, State, ctx, dcc, no_update

from mcrim_mitsuba.app import layout
from mcrim_mitsuba.app.charts import falling_chart, readings_chart
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import Settings
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.inference.estimates import FittedRow

_BUSY = "something is running already: wait for it, or stop it"
#: Of components that are many: kind and name.
_Ids = Sequence[Mapping[str, str]]
#: What the controls say, in the order in which `_settings` takes it.
_CONTROLS = (
    ({"kind": "number", "name": ALL}, "value"),
    ({"kind": "number", "name": ALL}, "id"),
    ({"kind": "effect", "name": ALL}, "value"),
    ({"kind": "effect", "name": ALL}, "id"),
    ("fit-scale", "value"),
)


def make_page(session: Session, prefix: str) -> Dash:
    """The application that shows a session, under a path with slashes at both ends."""
    application = Dash(
        "mcrim_mitsuba.app", title="MCRIM", update_title="", url_base_pathname=prefix,
        assets_folder=str(Path(__file__).parent / "assets"), suppress_callback_exceptions=True,
        compress=False, enable_mcp=False, add_log_handler=False,
        meta_tags=[{"name": "viewport", "content": "width=device-width, initial-scale=1"}],
    )  # fmt: skip
    # the browser redraws a chart's frame where its text differs: let it be that of Dash's own way
    application.server.json.sort_keys = False
    application.layout = lambda: layout.page(session)
    _follow(application)
    _redraw(application, session, prefix)
    _watch(application, session)
    _act(application, session)
    _upload(application, session)
    return application


def _settings(
    numbers: Sequence[Any], number_ids: _Ids, effects: Sequence[Any], effect_ids: _Ids,
    fit_scale: Sequence[str], session: Session,
) -> Settings:  # fmt: skip
    """What the controls say; fields that hold no number keep what was there."""
    values = dict(session.state.settings.values)
    values |= {
        known["name"]: float(value)
        for known, value in zip(number_ids, numbers, strict=True)
        if isinstance(value, (int, float))
    }
    on = tuple(known["name"] for known, chosen in zip(effect_ids, effects, strict=True) if chosen)
    return Settings(on, values, fit_scale=bool(fit_scale))


def _follow(application: Dash) -> None:
    """What the browser does by itself."""

    def browser(does: str, *what: Output | Input | State, **options: bool) -> None:
        application.clientside_callback(ClientsideFunction("mcrim", does), *what, **options)

    number, axis = {"kind": "number", "name": MATCH}, {"kind": "axis", "name": MATCH}
    browser("follow", Output({"kind": "slider", "name": MATCH}, "value"), Input(number, "value"),
            State(axis, "data"), State(axis, "id"))  # fmt: skip
    browser("settle", Output("settled", "data"), Input("settings-number", "data"))
    browser("show", Output("drawn", "data"), Input("shown", "data"))
    browser("reload", Output("reload", "data"), Input("reload", "data"))
    browser(
        "accept", Output("upload-content", "data"),
        Output("slip", "children", allow_duplicate=True),
        Input("upload", "contents"), State("upload", "filename"), prevent_initial_call=True,
    )  # fmt: skip


def _redraw(application: Dash, session: Session, prefix: str) -> None:
    @application.server.post(f"{prefix}{layout.PREDICTIONS}")
    def predict() -> flask.Response:
        """A slider's way past Dash, whose own takes several times as long."""
        asked = flask.request.get_json()
        known = session.state.settings.values
        moved = {n: float(v) for n, v in asked["values"].items() if n in known and _is_number(v)}
        effects = tuple(n for n in asked["effects"] if n in session.effects)
        settings = Settings(effects, {**known, **moved}, fit_scale=bool(asked["fit_scale"]))
        return flask.jsonify(_shown(session, settings, asked["settings_number"]))

    @application.callback(
        Output("shown", "data"),
        Input("state-number", "data"),
        *(Input(*control) for control in _CONTROLS if control[1] == "value"),
        *(State(*control) for control in _CONTROLS if control[1] == "id"),
        State("settings-number", "data"),
    )
    def redraw(_number: int, *given: Any) -> dict[str, Any]:
        numbers, effects, fit_scale, number_ids, effect_ids, settings_number = given
        settings = _settings(numbers, number_ids, effects, effect_ids, fit_scale, session)
        return _shown(session, settings, settings_number)

    @application.callback(
        Output({"kind": "sizes", "name": MATCH}, "children"),
        Input({"kind": "effect", "name": MATCH}, "value"),
        State({"kind": "effect", "name": MATCH}, "id"),
        prevent_initial_call=True,
    )
    def unfold(chosen: list[str], effect_id: dict[str, str]) -> list[Any]:
        _, controls = session.effects[effect_id["name"]]
        return layout.sizes(session, controls) if chosen else []


def _shown(session: Session, settings: Settings, settings_number: int) -> dict:
    """What the browser writes and draws at some settings."""
    # controls that are about to be moved by a fit say what was before it
    settings = session.remember(settings, settings_number)
    try:
        shown = session.show(settings)
    except InputError as error:  # effects that exclude each other
        return {"texts": {"pending": str(error)}}
    nan = float("nan")
    rows = shown.rows if shown else [
        FittedRow(r.label, r.signal, r.sigma, nan, nan, nan, nan, nan, r.use, r.kind)
        for r in session.campaign.measurements.readings
    ]  # fmt: skip
    pending = ""
    if shown and shown.pending:
        pending = f"Not in the model yet: {', '.join(shown.pending)}"
    return {
        "chart": readings_chart(rows, shown, session.state.baseline),
        "cells": layout.readings_cells(rows, shown is not None),
        "texts": {**layout.merit_texts(shown), "pending": pending},
    }


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _watch(application: Dash, session: Session) -> None:
    """The clock: how far the job is, and what it found."""

    @application.callback(
        Output("status", "children"),
        Output("progress", "value"),
        Output("progress", "max"),
        Output("stop", "hidden"),
        Output("error", "children"),
        Output("clock", "interval"),
        Output("state-number", "data"),
        Output("download", "data"),
        Output("file-number", "data"),
        Input("clock", "n_intervals"),
        Input("kick", "data"),
        State("state-number", "data"),
        State("file-number", "data"),
    )
    def look(_ticks: int, _kicks: int, known: int, known_file: int) -> tuple[Any, ...]:
        status, state = session.jobs.status, session.state
        # an answer may be overtaken and dropped: the file is offered until the page knows it
        file = state.file if state.file_number != known_file else None
        words = status.stage or "ready"
        if status.busy and status.stage != status.job:
            words = f"{status.job}: {status.stage}"
        if status.busy and status.total > 1:
            words += f", {100 * status.done / status.total:.0f} %"
        return (
            words,
            # none of a bar that runs to and fro
            str(status.done) if status.total > 1 or not status.busy else None,
            str(max(status.total, 1)),
            not status.busy,
            status.error,
            layout.BUSY_MS if status.busy else layout.IDLE_MS,
            no_update if state.number == known else state.number,
            no_update if file is None else dcc.send_bytes(file[1], file[0]),
            state.file_number,
        )

    @application.callback(
        Output("diagnosis", "children"),
        Output("falling-chart", "figure"),
        Output("fitted", "children"),
        Output("settings-number", "data"),
        Output({"kind": "number", "name": ALL}, "value"),
        Output({"kind": "effect", "name": ALL}, "value"),
        Output("fit-scale", "value"),
        Input("state-number", "data"),
        State("settings-number", "data"),
        State({"kind": "number", "name": ALL}, "id"),
        State({"kind": "effect", "name": ALL}, "id"),
    )
    def take_over(_number: int, known: int, number_ids: _Ids, effect_ids: _Ids) -> tuple[Any, ...]:
        state = session.state
        numbers: list[Any] = [no_update] * len(number_ids)
        effects: list[Any] = [no_update] * len(effect_ids)
        fit_scale: Any = no_update
        if state.settings_number != known:
            settings = state.settings
            numbers = [
                float(f"{settings.values[i['name']]:.6g}")
                if i["name"] in settings.values else no_update
                for i in number_ids
            ]  # fmt: skip
            effects = [["on"] if i["name"] in settings.effects else [] for i in effect_ids]
            fit_scale = ["fit"] if settings.fit_scale else []
        return (
            layout.diagnosis_panel(state.diagnosed), falling_chart(state.steps),
            layout.fitted_panel(state), state.settings_number, numbers, effects, fit_scale,
        )  # fmt: skip


def _act(application: Dash, session: Session) -> None:
    """Buttons and switches that start a job."""
    starts = {"fit": session.fit}
    for what in ("scene", "campaign", "report"):
        starts[f"get-{what}"] = partial(session.offer, what)

    @application.callback(
        Output("kick", "data"),
        Output("slip", "children"),
        *(Input(name, "n_clicks") for name in (*starts, "diagnose", "back", "stop")),
        Input({"kind": "add", "effects": ALL}, "n_clicks"),
        Input({"kind": "effect", "name": ALL}, "value"),
        State("kick", "data"),
        *(State(*control) for control in _CONTROLS),
        prevent_initial_call=True,
    )
    def act(*given: Any) -> tuple[Any, ...]:
        kicks, numbers, number_ids, effects, effect_ids, fit_scale = given[len(starts) + 5 :]
        settings = _settings(numbers, number_ids, effects, effect_ids, fit_scale, session)
        pressed = ctx.triggered_id
        began = True
        if pressed == "stop":
            session.jobs.cancel()
        elif pressed == "back":
            session.go_back()
        elif pressed == "diagnose":
            began = session.diagnose()
        elif isinstance(pressed, str):
            began = starts[pressed](settings)
        elif pressed and pressed["kind"] == "add" and _is_clicked():
            began = session.add(pressed["effects"].split(), settings)
        else:
            ready = session.state.ready
            missing = [name for name in settings.effects if ready is None or name not in ready]
            if not missing or ready is None:
                return no_update, no_update
            began = session.switch_on(missing)
        return kicks + 1, "" if began else _BUSY


def _is_clicked() -> bool:
    """Whether a button was: one that was just made reports itself too, without a click.

    It may do so together with the boxes of the effects that are switched on.
    """
    return any(e["value"] for e in ctx.triggered if e["prop_id"].endswith(".n_clicks"))


def _upload(application: Dash, session: Session) -> None:
    @application.callback(
        Output("reload", "data", allow_duplicate=True),
        Output("slip", "children", allow_duplicate=True),
        Output("upload", "contents"),
        Input("upload-content", "data"),
        prevent_initial_call=True,
    )
    def take(file: dict[str, str] | None) -> tuple[Any, ...]:
        if not file:
            return no_update, no_update, no_update
        if session.jobs.status.busy:
            return no_update, _BUSY, None
        try:
            content = base64.b64decode(file["content"].partition(",")[2], validate=True)
            session.take_readings(file["name"], content)
        except InputError as error:
            return no_update, str(error), None
        except binascii.Error:
            return no_update, "the file did not arrive whole; upload it again", None
        return 1, "", None
