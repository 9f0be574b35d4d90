"""The page's charts: readings with pulls, and the error falling from fit to fit.

They are plain dicts, as plotly.js takes them: to check them as Python's plotly does takes longer
than all the rest of an answer.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import Any

from mcrim_mitsuba.app.state import FitStep, Shown
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.output.figure_style import DARK, GREY, WARM, shortened, units_of_signals
from mcrim_mitsuba.output.findings import signal_text, together

Figure = dict[str, Any]

#: Least extent of the axis of pulls, and how far those of two fits stand apart.
_LEAST_PULL, _APART = 3.2, 0.16
#: An axis grows by this factor, again and again: mostly it stays while a slider moves, and what
#: stays need not be drawn anew.
_STEP = 1.25
_INK, _GRID = "#1c1c1c", "#e6e6e6"
_LABEL_LENGTH = 22
#: Height of a character of a slanting label.
_LABEL_PIXELS = 5.5
#: In a chart nothing is dragged or zoomed: on a telephone that hinders scrolling.
_STILL: dict[str, Any] = {"fixedrange": True, "zeroline": False}
_LAYOUT: dict[str, Any] = {
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": _INK},
    "paper_bgcolor": "white",
    "plot_bgcolor": "white",
    "margin": {"l": 60, "r": 15, "t": 30, "b": 40},
    "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
    "hoverlabel": {"namelength": -1},
}


def literal(text: str, most: int | None = None) -> str:
    """A user's text for a chart, whose own small markup language must not read it."""
    return html.escape(text if most is None else shortened(text, most), quote=False)


def readings_chart(
    readings: Sequence[FittedRow], shown: Shown | None, baseline: Calibration | None
) -> Figure:
    """Readings beside predictions, and below them the pulls.

    Parameters
    ----------
    readings : sequence of FittedRow
        Whatever is known of the readings: their predictions are not looked at.
    shown : Shown or None
        The model at the present settings; None before it was simulated.
    baseline : Calibration or None
        The campaign as it came.
    """
    places = list(range(len(readings)))
    labels = [literal(row.label, 4 * _LABEL_LENGTH) for row in readings]
    units = units_of_signals([(row.measured, row.of_beam) for row in readings]).tolist()
    told = [literal(signal_text(row.of_beam, row.measured, row.sigma)) for row in readings]
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter", "mode": "markers", "name": "reading", "x": places,
            "y": [unit * row.measured for unit, row in zip(units, readings, strict=True)],
            "error_y": {"type": "data", "color": _INK,
                        "array": [u * row.sigma for u, row in zip(units, readings, strict=True)]},
            "marker": {"color": [_INK if row.use else "white" for row in readings], "size": 8,
                       "line": {"color": _INK, "width": 1.5}},
            "text": labels, "customdata": told,
            "hovertemplate": "%{text}: %{customdata}<extra>reading</extra>",
        }
    ]  # fmt: skip
    fits = []
    if shown is not None:
        if baseline is not None:
            fits.append(("as it came", baseline.rows, WARM, "white", -_APART, 14))
        fits.append(("model", shown.rows, DARK, DARK, _APART, 20))
    pulls = [row.pull for _, rows, *_ in fits for row in rows]
    for name, rows, colour, fill, aside, width in fits:
        traces.append({
            "type": "scatter", "mode": "markers", "name": name, "legendgroup": name,
            "x": places, "y": [unit * row.model for unit, row in zip(units, rows, strict=True)],
            "customdata": [signal_text(r.of_beam, r.model, None) for r in rows],
            "marker": {"symbol": "line-ew", "size": width, "color": colour,
                       "line": {"width": 3 if name == "model" else 2, "color": colour}},
            "text": labels, "hovertemplate": "%{text}: %{customdata}<extra>" + name + "</extra>",
        })  # fmt: skip
        traces.append({
            "type": "bar", "legendgroup": name, "showlegend": False, "yaxis": "y2", "width": 0.28,
            "x": [place + aside for place in places], "y": [row.pull for row in rows],
            "marker": {"color": fill, "line": {"color": colour, "width": 1.5}},
            "text": labels, "textposition": "none",
            "hovertemplate": "%{text}: %{y:+.2f}<extra>pull, " + name + "</extra>",
        })  # fmt: skip
    longest = max(min(len(row.label), _LABEL_LENGTH) for row in readings)
    extent = _stepped(_LEAST_PULL, [1.1 * abs(pull) for pull in pulls])
    models = [
        unit * row.model for _, rows, *_ in fits for unit, row in zip(units, rows, strict=True)
    ]
    both = list(zip(units, readings, strict=True))
    top = _stepped(1.08 * max(0.0, *(u * (row.measured + row.sigma) for u, row in both)), models)
    least = min(u * (row.measured - row.sigma) for u, row in both)
    bottom = -_stepped(-1.08 * min(0.0, least), [-model for model in models])
    layout: dict[str, Any] = {
        **_LAYOUT,
        "xaxis": {**_STILL, "tickvals": places, "tickangle": -45, "anchor": "y2",
                  "ticktext": [literal(row.label, _LABEL_LENGTH) for row in readings],
                  "range": [-0.6, len(readings) - 0.4], "showgrid": False},
        "yaxis": {**_STILL, "domain": [0.47, 1], "title": {"text": "signal"},
                  "range": [bottom, top], "gridcolor": _GRID},
        "yaxis2": {**_STILL, "domain": [0, 0.4], "title": {"text": "pull (σ)"},
                   "range": [-extent, extent], "gridcolor": _GRID, "zeroline": True,
                   "zerolinecolor": GREY},
        "shapes": [
            {"type": "rect", "layer": "below", "fillcolor": colour, "line": {"width": 0},
             "xref": "paper", "x0": 0, "x1": 1, "yref": "y2", "y0": -sigmas, "y1": sigmas}
            for sigmas, colour in ((2, "#eeeeee"), (1, "#dddddd"))
        ],
        "barmode": "overlay",
        # measuring the labels in the browser would take longer than drawing them
        "margin": {**_LAYOUT["margin"], "b": 30 + _LABEL_PIXELS * longest},
    }  # fmt: skip
    of_beam = [unit for unit, row in both if row.of_beam]
    if of_beam:
        ends = [100 * end / of_beam[0] for end in (bottom, top)]
        layout["yaxis3"] = {
            **_STILL, "overlaying": "y", "side": "right", "range": ends, "showgrid": False,
            "title": {"text": "transmittance (%)"},
        }  # fmt: skip
        layout["margin"] = {**layout["margin"], "r": 60}
        # an axis without a trace is not drawn
        traces.append(
            {"type": "scatter", "x": [0], "y": [None], "yaxis": "y3", "showlegend": False}
        )
    return {"data": traces, "layout": layout}


def _stepped(least: float, wanted: Sequence[float]) -> float:
    """At least `least`, grown by steps until all fit."""
    most = max([value for value in wanted if math.isfinite(value)], default=least)
    if most <= least or least <= 0:
        return max(most, least)
    return least * _STEP ** math.ceil(math.log(most / least, _STEP))


def falling_chart(steps: Sequence[FitStep]) -> Figure:
    """chi2 over its degrees of freedom, fit by fit; at 1 the model describes the readings."""
    names = [
        f"with {shortened(together(step.effects), 40)}" if step.effects else "as it came"
        for step in steps
    ]
    fits, places = [step.calibration for step in steps], list(range(len(steps)))
    trace = {
        "type": "scatter", "mode": "lines+markers+text", "showlegend": False, "x": places,
        "y": [fit.chi2 / fit.ndf if fit.ndf > 0 else None for fit in fits],
        "text": [f"{fit.chi2:.3g} / {fit.ndf}" for fit in fits], "textposition": "top right",
        "line": {"color": DARK, "shape": "hv", "width": 2.5}, "cliponaxis": False,
        "marker": {"size": 10, "color": DARK},
        "hovertemplate": "χ² / ndf = %{text}<extra></extra>",
    }  # fmt: skip
    layout: dict[str, Any] = {
        **_LAYOUT,
        "xaxis": {**_STILL, "tickvals": places, "ticktext": list(map(literal, names)),
                  "range": [-0.5, max(len(steps) - 0.5, 1.5)], "showgrid": False},
        "yaxis": {**_STILL, "type": "log", "dtick": "D2", "gridcolor": _GRID,
                  "title": {"text": "χ² / degrees of freedom"}},
        "shapes": [
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 1, "y1": 1,
             "line": {"color": GREY, "dash": "dash", "width": 1.5}}
        ],
    }  # fmt: skip
    return {"data": [trace], "layout": layout}
