"""The page's parts: what stands where. What they do is in `page`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dash import dcc, html

from mcrim_mitsuba.app.controls import Control
from mcrim_mitsuba.app.results import merits, readings_table
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.effects import Effect

#: Steps of a slider.
SLIDER_STEPS = 1000
#: Where the browser asks for predictions while a slider moves, below the page's address.
PREDICTIONS = "predictions"
#: Milliseconds between looks at the running job, and when there is none.
BUSY_MS, IDLE_MS = 300, 4000
_NO_BAR: dcc.Graph.Config = {"displayModeBar": False, "responsive": True}


def number_id(name: str) -> dict[str, str]:
    """Of a parameter's number field."""
    return {"kind": "number", "name": name}


def slider_id(name: str) -> dict[str, str]:
    """Of its slider."""
    return {"kind": "slider", "name": name}


def effect_id(name: str) -> dict[str, str]:
    """Of an effect's switch."""
    return {"kind": "effect", "name": name}


def sizes_id(name: str) -> dict[str, str]:
    """Of the place for its sliders."""
    return {"kind": "sizes", "name": name}


def page(session: Session) -> html.Div:
    """The whole page, as the session is now."""
    return html.Div(
        [
            dcc.Interval(id="clock", interval=BUSY_MS),
            dcc.Store(id="state-number", data=-1),
            dcc.Store(id="settings-number", data=session.state.settings_number),
            dcc.Store(id="file-number", data=session.state.file_number),
            dcc.Store(id="shown"),
            dcc.Store(id="drawn"),
            dcc.Store(id="settled"),
            dcc.Store(id="kick", data=0),
            dcc.Store(id="upload-content"),
            dcc.Store(id="reload", data=0),
            dcc.Download(id="download"),
            _header(session),
            html.Main(
                [
                    html.Div(
                        [_files(), _parameters(session), _effects(session)], className="controls"
                    ),
                    html.Div([_model(session), _diagnosis()], className="results"),
                ],
                className="columns",
            ),
        ],
        id="page",
    )


def _header(session: Session) -> html.Header:
    campaign = session.campaign
    return html.Header(
        [
            html.H1(["MCRIM: ", html.Bdi(campaign.path.name)]),
            html.P(
                [
                    "scene ",
                    html.Bdi(campaign.scene.path.name),
                    ", readings ",
                    html.Bdi(campaign.measurements.path.name, id="readings-name"),
                    f" ({len(campaign.measurements.readings)})",
                ],
                className="sources",
            ),
            html.Div(
                [
                    html.Progress(id="progress", value="0", max="1"),
                    html.Span("starting", id="status", role="status"),
                    html.Button("Stop", id="stop", className="quiet", hidden=True),
                ],
                className="job",
            ),
            html.P(id="slip", role="alert", className="error"),
            html.P(id="error", role="alert", className="error"),
        ]
    )


def _files() -> html.Section:
    aria: dict[str, Any] = {"aria-label": "files"}
    return html.Section(
        [
            html.H2("Files"),
            dcc.Upload(
                html.Button("Upload readings (CSV)", id="upload-button"),
                id="upload", className="upload", className_active="upload over",
            ),
            html.P(
                "Or drop the file here. The scene and what is known beforehand stay.",
                className="hint",
            ),
            html.Div(
                [
                    html.Button("Download scene", id="get-scene"),
                    html.Button("Download campaign", id="get-campaign"),
                    html.Button("Download report", id="get-report"),
                ],
                className="buttons",
            ),
        ],
        **aria,
    )  # fmt: skip


def _parameters(session: Session) -> html.Section:
    settings = session.state.settings
    rows = [
        _control(control, settings.values.get(control.name, control.start))
        for control in session.controls
    ]
    free = any(control.name == "scale" for control in session.controls)
    return html.Section(
        [
            html.H2("Parameters"),
            *rows,
            dcc.Checklist(
                [{"label": "the scale follows the readings", "value": "fit"}],
                ["fit"] if settings.fit_scale else [],
                id="fit-scale",
                style=None if free else {"display": "none"},
            ),
            html.Div(
                [
                    html.Button("Fit", id="fit", className="main"),
                    html.Button("Back to the campaign as it came", id="back"),
                ],
                className="buttons",
            ),
        ]
    )


def _effects(session: Session) -> html.Section:
    return html.Section(
        [
            html.H2("Effects"),
            html.P(
                "Each was left out of the bench. The first use of one simulates it.",
                className="hint",
            ),
            *(_effect(session, effect, controls) for effect, controls in session.effects.values()),
            *(html.P(html.Bdi(reason), className="hint") for reason in session.refused),
        ]
    )


def _effect(session: Session, effect: Effect, controls: Sequence[Control]) -> html.Div:
    on = effect.name in session.state.settings.effects
    return html.Div(
        [
            dcc.Checklist(
                [{"label": _name_of(effect), "value": "on"}],
                ["on"] if on else [],
                id=effect_id(effect.name),
            ),
            html.Div(sizes(session, controls) if on else [], id=sizes_id(effect.name)),
        ],
        className="effect",
    )


def sizes(session: Session, controls: Sequence[Control]) -> list[html.Div]:
    """What moves an effect that is on; all that the page holds slows every change of it."""
    values = session.state.settings.values
    return [_control(control, values.get(control.name, control.start)) for control in controls]


def _name_of(effect: Effect) -> html.Span:
    """What it is called for people and in files; its physics where the mouse rests."""
    return html.Span([effect.title, " ", html.Small(effect.name)], title=effect.physics)


def _control(control: Control, value: float) -> html.Div:
    """A name, a slider and a number that follow each other."""
    unit = f" ({control.unit})" if control.unit else ""
    return html.Div(
        [
            html.Label(
                control.title + unit, htmlFor=_dom(number_id(control.name)),
                title=control.meaning or control.name,
            ),
            dcc.Input(
                id=slider_id(control.name), type="range", min=0, max=SLIDER_STEPS, step=1,
                value=position(control, value), debounce=False,
            ),
            dcc.Input(
                id=number_id(control.name), type="number", value=float(f"{value:.6g}"),
                min=control.minimum, max=control.maximum, step="any", debounce=True,
            ),
            dcc.Store(
                id={"kind": "axis", "name": control.name},
                data={
                    "minimum": control.minimum, "maximum": control.maximum,
                    "coordinate": control.coordinate, "scale": control.scale,
                    "steps": SLIDER_STEPS,
                },
            ),
        ],
        className="control",
    )  # fmt: skip


def position(control: Control, value: float) -> int:
    """Where the slider stands."""
    low, high = (control.coordinate_of(end) for end in (control.minimum, control.maximum))
    part = (control.coordinate_of(control.inside(value)) - low) / (high - low)
    return round(SLIDER_STEPS * part)


def _model(session: Session) -> html.Section:
    return html.Section(
        [
            html.H2("Readings and model"),
            html.Div(merits(session.light_title), id="figures-of-merit", className="merits"),
            html.P(id="pending", className="hint"),
            # drawn by the browser itself: through Dash it would take longer
            html.Div(html.Div(), id="readings-chart", className="chart tall"),
            html.Details(
                [
                    html.Summary("The same as a table"),
                    html.Div(
                        readings_table(session.campaign.measurements.readings),
                        id="rows",
                        className="scroll",
                    ),
                ],
                id="table-details",
            ),
        ]
    )


def _diagnosis() -> html.Section:
    return html.Section(
        [
            html.H2("What is missing?"),
            html.Div(
                [html.Button("Diagnose", id="diagnose", className="main")], className="buttons"
            ),
            html.Div(id="diagnosis"),
            html.H2("The error, fit by fit"),
            _chart("falling-chart", "chart"),
            html.Div(id="fitted", className="scroll"),
        ]
    )


def _chart(chart_id: str, class_name: str) -> html.Div:
    # the graph fills what is around it, whatever its own class says
    return html.Div(dcc.Graph(id=chart_id, config=_NO_BAR), className=class_name)


def _dom(component_id: dict[str, str]) -> str:
    """The id in the browser of a component with a compound one."""
    pairs = ",".join(f'"{key}":"{component_id[key]}"' for key in sorted(component_id))
    return f"{{{pairs}}}"
