"""The page's texts and tables: figures of merit, readings, diagnosis, parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from dash import html

from mcrim_mitsuba.app.state import Shown, State, Step
from mcrim_mitsuba.diagnosing import Diagnosed
from mcrim_mitsuba.diagnosis.result import Candidate
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.findings import (
    configuration_text,
    estimate_text,
    headline,
    leading_candidates,
    limit_text,
    number,
    p_text,
    plausibility,
    size_text,
    suspicion,
    together,
)
from mcrim_mitsuba.fit.result import FittedRow
from mcrim_mitsuba.physics.rounding import pdg

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
        limits = [
            (name, limit.parameter or "on or off", limit_text(limit))
            for name, limit in diagnosis.upper_limits.items()
        ]
        parts.append(
            html.Details([
                html.Summary("What the readings allow (95 % confidence)"),
                html.Div(_table(("effect", "parameter", "size"), limits), className="scroll"),
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
    step: Step = state.steps[-1]
    fit = step.calibration
    what = f"with {together(step.effects)}" if step.effects else "as it came"
    cells = [(name, estimate_text(known)) for name, known in fit.parameters.items()]
    return [
        html.H3(f"The last fit, {what}: χ² = {_chi2_text(fit.chi2)}, ndf {fit.ndf}, "
                f"p = {p_text(fit.p_value)}"),
        _table(("parameter", "value"), cells),
        *(html.P(html.Bdi(note), className="hint") for note in fit.notes),
    ]  # fmt: skip


def _table(head: Sequence[str], rows: Iterable[Sequence]) -> html.Table:
    return html.Table(
        [
            html.Thead(html.Tr([html.Th(name, scope="col") for name in head])),
            html.Tbody([html.Tr([html.Td(cell) for cell in row]) for row in rows]),
        ]
    )
