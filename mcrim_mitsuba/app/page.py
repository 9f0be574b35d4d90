"""The page's addresses: what a browser may ask for, and what it is answered.

The page itself comes whole from `layout`. From then on the browser asks ``state`` how the session
is, ``predictions`` what the model says at some settings, ``reading`` of a reading's bench,
``picture`` for steps from raw data to readings, and
``do`` for whatever a button does; the answers are JSON. Ids in the browser: `readings-chart`,
`falling-chart`, `chi2`, `p-value`, `light-yield`, `averaged`, `rows` (the table), `reading` (one of
them), `verdict`, `status`, `progress`, `error` (of a job), `slip` (of a file or a button), `lost`
(the connection), `pending`; buttons `upload-button` (its file field lies in `upload`), `fit`,
`back`, `undo`, `redo`, `diagnose`, `stop`, `get-scene`, `get-campaign`, `get-report`,
`get-session`; of a row of the table, counted from 0, fields such as `n_gap-3` and the buttons
`copy-3`, `drop-3`; compound ids are JSON with sorted keys, such as
``{"kind":"slider","name":"alpha_scat_per_cm"}``, of kinds `slider`, `number`, `known`, `effect`.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import flask

from mcrim_mitsuba.app import exchange, layout
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import MALFORMED, Settings, settings_of
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.output.figure_style import content_of
from mcrim_mitsuba.output.laboratory_figures import draw_raw_data

_Asked = Mapping[str, Any]
#: What a request may leave out; the types are those of what it says.
_LEFT_OUT = {"what": "", "name": "", "column": "", "content": "", "moved": False, "known": -1}
_FILES = ("scene", "campaign", "report", "session")
#: What is done with a reading or a fit, whose number is the name.
_NUMBERED = ("edit", "copy", "drop", "show", "compare", "remove")


def make_page(session: Session, prefix: str) -> flask.Flask:
    """The application that shows a session, under a path with slashes at both ends."""
    here = Path(__file__).parent
    application = flask.Flask(
        "mcrim_mitsuba.app", static_folder=here / "assets", static_url_path=f"{prefix}assets"
    )
    actions = _actions(session)

    @application.get(prefix)
    def whole() -> str:
        with session.history.lock:
            return layout.page(session)

    @application.get(f"{prefix}state")
    def state() -> dict[str, Any]:
        with session.history.lock:
            return layout.state(session, flask.request.args.get("known", -1, type=int))

    @application.post(f"{prefix}predictions")
    def predictions() -> dict[str, Any]:
        with session.history.lock:
            _, settings = _read(session)
            return layout.predictions(session, settings)

    @application.post(f"{prefix}do")
    def act() -> dict[str, Any]:
        slip = ""
        with session.history.lock:
            asked, settings = _read(session)
            try:
                actions.get(asked["what"], lambda *_: flask.abort(400))(asked, settings)
            except InputError as error:
                slip = str(error)
            return {**layout.state(session, asked["known"]), "slip": slip}

    @application.get(f"{prefix}reading/<int:place>")
    def reading(place: int) -> flask.Response:
        with session.history.lock:
            # the page may not know yet that a row was taken away
            there = place < len(session.state.campaign.measurements.readings)
            return flask.jsonify({"html": layout.reading(session, place)} if there else None)

    @application.get(f"{prefix}picture/<kind>")
    def picture(kind: str) -> flask.Response:
        raw = session.state.campaign.raw
        if raw is None or kind not in raw.kinds:
            flask.abort(404)
        content = content_of(draw_raw_data(raw, kind).figure, "png")
        return flask.send_file(io.BytesIO(content), "image/png")

    @application.get(f"{prefix}file")
    def file() -> flask.Response:
        offered = session.state.file
        if offered is None:
            flask.abort(404)
        name, content = offered
        return flask.send_file(io.BytesIO(content), as_attachment=True, download_name=name)

    return application


def _read(session: Session) -> tuple[_Asked, Settings]:
    """What a page asks for, and the settings that hold; what no page sends is answered by 400."""
    effects = session.model.live.controls.effects
    try:
        asked = _LEFT_OUT | flask.request.get_json()
        is_ours = all(type(asked[name]) is type(usual) for name, usual in _LEFT_OUT.items())
        what, names = asked["what"], asked["name"].split()
        if what in _NUMBERED:
            asked["name"] = int(asked["name"])
        possible = {"get": _FILES, "add": effects, "effect": effects}.get(what, names)
        is_ours &= set(names) <= set(possible)
        settings = settings_of(asked["settings"], session.state.settings.values, effects)
        number = asked["settings_number"]
    except MALFORMED:
        is_ours = False
    if not is_ours:
        flask.abort(400)
    # another page may ask at its own settings only because something has ended
    by_hand = asked["moved"] or bool(asked["what"])
    return asked, session.history.remember(settings, number, by_hand=by_hand)


def _actions(session: Session) -> dict[str, Callable[[_Asked, Settings], object]]:
    """What buttons and switches do, by name; they get what was asked, and the settings."""

    def upload(asked: _Asked, _: Settings) -> None:
        try:
            content = base64.b64decode(asked["content"].partition(",")[2], validate=True)
        except ValueError:
            raise InputError("the file did not arrive whole", "open it again") from None
        if asked["name"].lower().endswith(".json"):
            session.take_session(asked["name"], content)
        else:
            session.take_readings(asked["name"], content)

    def edit(asked: _Asked, _: Settings) -> None:
        text = str(asked.get("value", ""))
        session.edit(exchange.with_cell, asked["name"], asked["column"], text)

    return {
        "edit": edit,
        "copy": lambda asked, _: session.edit(exchange.with_copy, asked["name"]),
        "drop": lambda asked, _: session.edit(exchange.without_row, asked["name"]),
        "fit": lambda _, settings: session.fit(settings),
        "diagnose": lambda _, settings: session.diagnose(settings),
        "add": lambda asked, settings: session.add(asked["name"].split(), settings),
        "effect": lambda asked, _: session.switch(asked["name"]),
        "get": lambda asked, settings: session.offer(asked["name"], settings),
        "upload": upload,
        "stop": lambda asked, _: session.jobs.stop(asked["name"] or None),
        "back": lambda *_: session.go_back(),
        "undo": lambda *_: session.undo(),
        "redo": lambda *_: session.undo(again=True),
        "show": lambda asked, _: session.show_step(asked["name"]),
        "compare": lambda asked, _: session.compare_with(asked["name"]),
        "remove": lambda asked, _: session.remove_step(asked["name"]),
    }
