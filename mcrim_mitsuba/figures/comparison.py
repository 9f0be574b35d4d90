"""Readings beside predictions, and the pulls below: before a repair and after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mcrim_mitsuba.diagnosis.result import Comparison, Suspect
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    WARM,
    Numbers,
    canvas,
    open_axes,
    save,
    shortened,
    styled,
    write_numbers,
)
from mcrim_mitsuba.findings import number, p_text
from mcrim_mitsuba.fit.result import Calibration

COLUMNS = (
    "label", "use", "measured", "sigma", "model", "model_sigma", "pull", "left_out_pull", "suspect",
    "model_after", "model_sigma_after", "pull_after",
)  # fmt: skip

_AS_IT_IS: dict[str, Any] = {
    "color": WARM,
    "marker": "o",
    "mfc": "white",
    "mew": 1.6,
    "ms": 6.5,
    "ls": "",
}
_MENDED: dict[str, Any] = {"color": DARK, "marker": "D", "ms": 5.5, "ls": ""}
_SUSPECTS: dict[str, Any] = {
    "bad_reading": ("suspected bad reading", {"facecolor": "#f6dccd", "edgecolor": WARM}),
    "swapped_rows": (
        "suspected swap", {"facecolor": "none", "edgecolor": WARM, "hatch": "///", "alpha": 0.55},
    ),
}  # fmt: skip
#: After a repair the suspicion is history.
_NO_LONGER: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.6", "ls": ":"}
#: Half the width of a prediction's dash, and how far before and after stand apart.
_DASH, _APART = 0.32, 0.13
#: Width of a reading, height of a character of its name, and the widest figure: inches.
_PER_READING, _PER_CHARACTER, _WIDEST = 0.46, 0.068, 26.0


def draw_comparison(
    path: str | Path,
    before: Comparison | Calibration,
    after: Calibration | None = None,
    *,
    added: str = "",
) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    before : Comparison or Calibration
        The campaign as it came; only a comparison knows of suspect readings.
    after : Calibration, optional
        Of the mended campaign: the same readings.
    added : str
        What mended it, for the legend.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = comparison_numbers(before, after)
    figure = comparison_figure(before, after, added=added)
    return save(figure, path), write_numbers(path, columns, rows)


def comparison_numbers(
    before: Comparison | Calibration, after: Calibration | None = None
) -> Numbers:
    """Columns and rows of the CSV beside the figure, a reading a row."""
    suspects = {label: one.kind for one in _suspects(before)[::-1] for label in one.labels}
    left_out = before.left_out_pulls if isinstance(before, Comparison) else {}
    mended = {row.label: row for row in after.rows} if after else {}
    rows = []
    for row in before.rows:
        own = mended.get(row.label)
        rows.append((
            row.label, row.use, row.measured, row.sigma, row.model, row.model_sigma, row.pull,
            left_out.get(row.label), suspects.get(row.label),
            *((own.model, own.model_sigma, own.pull) if own else (None, None, None)),
        ))  # fmt: skip
    return COLUMNS, rows


def _suspects(before: Comparison | Calibration) -> tuple[Suspect, ...]:
    return before.suspects if isinstance(before, Comparison) else ()


@styled
def comparison_figure(
    before: Comparison | Calibration, after: Calibration | None = None, *, added: str = ""
) -> Figure:
    """The figure of `draw_comparison`."""
    names = [shortened(row.label) for row in before.rows]
    longest = max(map(len, names), default=0)
    width = min(max(8.0, 1.6 + _PER_READING * len(names)), _WIDEST)
    upright = longest * _PER_CHARACTER < 0.85 * (width - 1.6) / max(len(names), 1)
    figure = canvas(width, 6.0 + (0.0 if upright else _PER_CHARACTER * longest))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1))
    places = np.arange(len(names))
    _draw_signals(upper, places, before, after)
    _draw_pulls(lower, places, before, after, added)
    crowded = _PER_READING * len(names) > _WIDEST
    lower.set_xticks(
        places, names, rotation=0 if upright else 90, fontsize=5 if crowded else 9.5,
        parse_math=False,
    )  # fmt: skip
    suspects = {label for one in _suspects(before) for label in one.labels}
    for row, tick in zip(before.rows, lower.get_xticklabels(), strict=True):
        if row.label in suspects:
            tick.set(fontweight="bold", color=WARM if after is None else GREY)
    lower.set_xlim(-0.6, len(names) - 0.4)
    return figure


def _draw_signals(
    axes: Axes, places: np.ndarray, before: Comparison | Calibration, after: Calibration | None
) -> None:
    """Readings with errors, and predictions as dashes."""
    used = np.array([row.use for row in before.rows], bool)
    measured = np.array([row.measured for row in before.rows])
    sigma = np.array([row.sigma for row in before.rows])
    handles: list[Any] = []
    kinds = ((used, "black", "reading with its error"), (~used, "white", "reading not used"))
    for which, face, label in kinds:
        if which.any():
            handles.append(
                axes.errorbar(
                    places[which], measured[which], yerr=sigma[which], fmt="o", ms=4.5,
                    color="black", mfc=face, capsize=3, lw=1.3, zorder=5, label=label,
                )
            )  # fmt: skip
    fits: list[tuple[Comparison | Calibration, str, str, Any]] = [
        (before, "model", WARM, (0, (2.2, 1.2)))
    ]
    if after is not None:
        fits.append((after, "mended model", DARK, "-"))
    for fit, label, colour, style in fits:
        model = [row.model for row in fit.rows]
        dash: dict[str, Any] = {"color": colour, "lw": 2, "ls": style}
        axes.hlines(model, places - _DASH, places + _DASH, zorder=4, **dash)
        handles.append(Line2D([], [], label=label, **dash))
    handles += _mark_suspects(axes, places, before, mended=after is not None)
    axes.set_ylabel("signal (unit of the\nmeasurement file)")
    axes.set_ylim(bottom=min(0.0, 1.1 * float(measured.min(initial=0.0))))
    open_axes(axes, "y")
    _legend_above(axes, handles, columns=3)


def _draw_pulls(
    axes: Axes,
    places: np.ndarray,
    before: Comparison | Calibration,
    after: Calibration | None,
    added: str,
) -> None:
    """Residuals in standard errors over bands of one and two of them."""
    axes.axhspan(-2, 2, color="0.93", lw=0)
    axes.axhspan(-1, 1, color="0.85", lw=0)
    axes.axhline(0, color=GREY, lw=0.9)
    name = "as it is" if isinstance(before, Comparison) else "fit"
    series = [(name, before, _AS_IT_IS, 0.0)]
    if after is not None:
        mended = f"with {shortened(added, 56)}" if added else "mended"
        series = [(name, before, _AS_IT_IS, -_APART), (mended, after, _MENDED, _APART)]
    handles, extent = [], 3.2
    for name, fit, style, aside in series:
        pulls = np.array([row.pull for row in fit.rows])
        axes.vlines(places + aside, 0, pulls, color=style["color"], lw=1.1, zorder=3)
        axes.plot(places + aside, pulls, zorder=4, **style)
        extent = max(extent, 1.15 * float(np.abs(pulls).max(initial=0.0)))
        # an exact fit's chi2 is rounding
        label = f"{name}: χ² = {number(round(fit.chi2, 6))}, ndf {fit.ndf}"
        if fit.p_value is not None:
            label += f", p = {p_text(fit.p_value)}"
        handles.append(Line2D([], [], label=label, **style))
    _mark_suspects(axes, places, before, mended=after is not None)
    axes.set_ylim(-extent, extent)
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.set_ylabel("pull (standard errors;\nbands: ±1 and ±2)")
    open_axes(axes, "y")
    _legend_above(axes, handles, columns=1)


def _mark_suspects(
    axes: Axes, places: np.ndarray, before: Comparison | Calibration, *, mended: bool
) -> list[Patch]:
    """Columns behind suspect readings, pale once mended; returns what the legend needs."""
    position = {row.label: place for row, place in zip(before.rows, places, strict=True)}
    handles = []
    for kind, (title, box) in _SUSPECTS.items():
        labels = {label for one in _suspects(before) if one.kind == kind for label in one.labels}
        if mended:
            title, box = f"{title} before the repair", box | _NO_LONGER
        for label in labels & position.keys():
            axes.axvspan(position[label] - 0.42, position[label] + 0.42, zorder=2, **box)
        if labels:
            handles.append(Patch(label=title, **box))
    return handles


def _legend_above(axes: Axes, handles: list, columns: int) -> None:
    """A legend over the axes, where it can hide nothing."""
    legend = axes.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, fontsize=9.5,
        frameon=False, columnspacing=1.4, handlelength=1.8, borderaxespad=0.2,
    )  # fmt: skip
    for text in legend.get_texts():
        text.set_parse_math(False)
