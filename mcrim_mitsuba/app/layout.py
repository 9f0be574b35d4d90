"""What the page shows: its texts and tables, and what stands where."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from dash import dcc, html

from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import Control, FitStep, Shown, State
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.rounding import number, p_text, pdg
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.inference.candidates import Candidate
from mcrim_mitsuba.inference.diagnose import Diagnosed
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.output.described import Table
from mcrim_mitsuba.output.descriptions import limits_table, parameters_table
from mcrim_mitsuba.output.findings import (
    configuration_text,
    headline,
    leading_candidates,
    plausibility,
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
    names = (("chi2", "χ²"), ("p-value", "p"), ("light-yield", light_title))
    return [
        html.Div(
            [
                html.Span(name, className="name"),
                html.Span("…", className="value", id=place),
                html.Span(className="words", id=f"{place}-words"),
            ],
            className="merit",
        )
        for place, name in names
    ]


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
        return [[pdg(row.measured, row.sigma), "…", "…", "…"] for row in rows]
    return [
        [
            pdg(row.measured, row.sigma),
            pdg(row.model, row.model_sigma),
            f"{row.pull:+.2f}",
            pdg(row.eta, row.eta_sigma),
        ]
        for row in rows
    ]


def diagnosis_panel(found: Diagnosed | None) -> list:
    """The verdict and the candidates, each with a button that adds it."""
    if found is None:
        return [
            html.P(
                "The campaign as it came is fitted with each effect of the catalogue in turn. "
                "The first time takes one to two minutes; what was simulated is kept.",
                className="hint",
            )
        ]
    diagnosis = found.diagnosis
    parts: list = [html.P(html.Bdi(headline(diagnosis)), className="verdict", id="verdict")]
    parts += [html.P(html.Bdi(suspicion(s)), className="hint") for s in diagnosis.suspect_readings]
    leading = leading_candidates(diagnosis)
    if diagnosis.candidates:
        ranked = list(dict.fromkeys(
            [id(c) for c in (*leading, *diagnosis.candidates[:_MOST_CANDIDATES])]
        ))  # fmt: skip
        known = {id(c): c for c in (*diagnosis.candidates, *diagnosis.pairs)}
        parts.append(_candidates([known[each] for each in ranked], leading))
    if diagnosis.upper_limits:
        parts.append(
            html.Details([
                html.Summary("What the readings allow (95 % confidence)"),
                html.Div(_shown(limits_table(diagnosis)), className="scroll"),
            ])
        )  # fmt: skip
    if diagnosis.next_measurements:
        configurations = [
            (configuration_text(m), number(m.expected_delta_chi2))
            for m in diagnosis.next_measurements
        ]
        parts.append(
            html.Details([
                html.Summary("What to measure next"),
                html.Div(
                    _table(("configuration", "expected gain in χ²"), configurations),
                    className="scroll",
                ),
            ])
        )  # fmt: skip
    return parts


def _candidates(candidates: Iterable[Candidate], leading: Sequence[Candidate]) -> html.Div:
    cells = []
    for place, one in enumerate(candidates):
        key = " ".join(one.effects)
        aria: dict[str, Any] = {"aria-label": f"add {together(one.effects)} and fit"}
        button = html.Button(
            "Add", id={"kind": "add", "effects": key},
            className="main" if place == 0 and leading else "",
            **aria,
        )  # fmt: skip
        cells.append((
            button, html.Bdi(one.effect), pdg(one.delta_chi2, one.delta_chi2_sigma or None),
            p_text(one.p_value), size_text(one, ", "), plausibility(one),
        ))  # fmt: skip
    head = ("", "effect", "fall of χ²", "p of the fit", "size", "plausible?")
    return html.Div(_table(head, cells), className="scroll")


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
        *(html.P(html.Bdi(note), className="hint") for note in fit.notes),
    ]  # fmt: skip


def _shown(table: Table) -> html.Table:
    head = [column.title for column in table.columns]
    return _table(head, ([cell.text for cell in row.cells] for row in table.rows))


def _table(head: Sequence[str], rows: Iterable[Sequence]) -> html.Table:
    return html.Table(
        [
            html.Thead(html.Tr([html.Th(name, scope="col") for name in head])),
            html.Tbody([html.Tr([html.Td(cell) for cell in row]) for row in rows]),
        ]
    )


# What stands where; what it does is in `page`.

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
