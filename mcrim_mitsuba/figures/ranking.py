"""Effects by what they gain: which of them explain a misfit, and how large they would be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.special import chdtri

from mcrim_mitsuba.diagnosis.result import Candidate, Diagnosis
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
from mcrim_mitsuba.findings import (
    ACCEPTABLE_P,
    leading_candidates,
    number,
    p_text,
    plausibility,
    size_text,
)
from mcrim_mitsuba.fit.result import ParameterEstimate

COLUMNS = (
    "effect", "leading", "delta_chi2", "delta_chi2_sigma", "chi2", "ndf", "p_value", "p_gain",
    "p_global", "behind", "aicc", "left_out_error", "parameter", "value", "sigma", "plausible",
    "at_bound", "light_yield_ph_per_keV", "mimics",
)  # fmt: skip

_PAIRS_SHOWN = 6
#: Inches: a row, the bars without their names, a character.
_PER_ROW, _BARS_WIDTH, _PER_CHARACTER = 0.34, 4.6, 0.088
#: Height of a size's second line in rows.
_FURTHER_LINE = 0.5
_OTHERS = "#b9c4d0"


def draw_ranking(path: str | Path, diagnosis: Diagnosis) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    diagnosis : Diagnosis

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = ranking_numbers(diagnosis)
    return save(ranking_figure(diagnosis), path), write_numbers(path, columns, rows)


def ranking_numbers(diagnosis: Diagnosis) -> Numbers:
    """Columns and rows of the CSV beside the figure: an effect's parameter a row."""
    leading = leading_candidates(diagnosis)
    rows = [
        (
            c.effect, c in leading, c.delta_chi2, c.delta_chi2_sigma, c.chi2, c.ndf, c.p_value,
            c.p_gain, c.p_global, c.behind, c.aicc, c.left_out_error, name,
            *((known.value, known.sigma) if known else (None, None)), c.plausible, c.at_bound,
            (c.light_yield_ph_per_keV or {}).get("value"), " ".join(c.mimics),
        )
        for c in (*diagnosis.candidates, *diagnosis.pairs)
        for name, known in _sizes(c)
    ]  # fmt: skip
    return COLUMNS, rows


def _sizes(candidate: Candidate) -> list[tuple[str | None, ParameterEstimate | None]]:
    """The parameters of a candidate's effects; one row without, where they have none."""
    names = candidate.effect_parameters
    return [(name, candidate.parameters.get(name)) for name in names] or [(None, None)]


@styled
def ranking_figure(diagnosis: Diagnosis, *, brief: bool = False) -> Figure:
    """The figure of `draw_ranking`: every effect alone, below the best pairs if they were tried.

    `brief` leaves the sizes to a table beside it: it fits a narrow page.
    """
    leading = leading_candidates(diagnosis)
    shown = [*diagnosis.candidates, *diagnosis.pairs[:_PAIRS_SHOWN]]
    if not shown:
        return _nothing_tried(diagnosis)
    # a row is as high as its sizes have lines
    further = [0 if brief else max(len(c.effect_parameters) - 1, 0) for c in shown]
    heights = np.array([1 + _FURTHER_LINE * lines for lines in further])
    places = np.cumsum(heights) - heights / 2
    table = _table(shown)[: 1 if brief else None]
    lines = [[line for text in column for line in text.split("\n")] for column in table]
    widths = [_PER_CHARACTER * max(map(len, column)) + 0.25 for column in lines]
    names = [shortened(candidate.effect, 46) for candidate in shown]
    room = _PER_CHARACTER * max(map(len, names)) + 0.4
    figure = canvas(room + _BARS_WIDTH + sum(widths), 1.8 + _PER_ROW * max(heights.sum(), 4))
    bars, words = figure.subplots(1, 2, sharey=True, width_ratios=(_BARS_WIDTH, sum(widths)))
    for place, candidate in zip(places, shown, strict=True):
        bars.barh(
            place, candidate.delta_chi2, height=0.62, xerr=candidate.delta_chi2_sigma,
            color=DARK if candidate in leading else _OTHERS, edgecolor=DARK, lw=0.8,
            error_kw={"ecolor": WARM, "capsize": 3, "lw": 1.5},
        )  # fmt: skip
    threshold = _draw_threshold(bars, heights, diagnosis.baseline.chi2, shown)
    bars.axvline(0, color=GREY, lw=0.9)
    if diagnosis.pairs and diagnosis.candidates:
        for axes in (bars, words):
            axes.axhline(len(diagnosis.candidates), color=GREY, lw=0.9, ls=":")
    bars.set_yticks(places, names, fontsize=10, parse_math=False)
    for tick, candidate in zip(bars.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if candidate in leading else "normal")
    bars.set_ylim(heights.sum() + 0.1, -0.1)
    bars.set_xlabel("fall of χ² when the effect is added")
    open_axes(bars, "x")
    bars.tick_params(axis="y", length=0)
    words.set_axis_off()
    words.set_xlim(0, sum(widths))
    for (title, *column), left in zip(table, np.cumsum([0.1, *widths[:-1]]), strict=True):
        words.text(left, -0.2, title, fontsize=9.5, weight="bold", va="bottom")
        for place, candidate, text in zip(places, shown, column, strict=True):
            words.text(
                left, place, text, fontsize=9.5, va="center", parse_math=False,
                weight="bold" if candidate in leading else "normal",
            )  # fmt: skip
    _legend(figure, leading, threshold, columns=2 if brief else 4)
    figure.suptitle(_title(diagnosis), x=0.01, ha="left", fontsize=11.5, weight="bold")
    return figure


def _title(diagnosis: Diagnosis) -> str:
    baseline = diagnosis.baseline
    return (
        f"{diagnosis.verdict}; without any effect χ² = {number(baseline.chi2)}, "
        f"ndf {baseline.ndf}, p = {p_text(baseline.p_value)}"
    )


def _nothing_tried(diagnosis: Diagnosis) -> Figure:
    """Why there is nothing to rank."""
    figure = canvas(_BARS_WIDTH + 5.6, 1.6)
    figure.suptitle(_title(diagnosis), x=0.01, ha="left", fontsize=11.5, weight="bold")
    figure.text(0.01, 0.3, "no effect was tried: " + diagnosis.reason, wrap=True, parse_math=False)
    return figure


def _table(shown: Sequence[Candidate]) -> list[list[str]]:
    """Columns beside the bars, each with its title first."""
    return [
        ["p of the fit", *(p_text(c.p_value) for c in shown)],
        ["fitted size", *(size_text(c, "\n") for c in shown)],
        ["in words", *(plausibility(c) for c in shown)],
    ]


def _legend(figure: Figure, leading: Sequence[Candidate], threshold: bool, columns: int) -> None:
    handles: list[Line2D | Patch] = []
    if leading:
        told = "leading: the data cannot tell these apart" if len(leading) > 1 else "leading"
        handles.append(Patch(facecolor=DARK, edgecolor=DARK, label=told))
    handles += [
        Patch(facecolor=_OTHERS, edgecolor=DARK, label="others" if leading else "effects"),
        Line2D([], [], color=WARM, lw=1.5, marker="|", ms=8, label="simulation's error"),
    ]
    if threshold:
        enough = f"enough for p = {ACCEPTABLE_P:g}"
        handles.append(Line2D([], [], color="black", ls="--", lw=1.4, label=enough))
    figure.legend(
        handles=handles, loc="outside lower left", ncols=columns, fontsize=9.5, frameon=False
    )  # fmt: skip


def _draw_threshold(
    axes: Axes,
    heights: np.ndarray,
    chi2: float,
    shown: Sequence[Candidate],
) -> bool:
    """Gain with which a fit becomes acceptable; it depends on how many parameters are added."""
    needed = [chi2 - float(chdtri(c.ndf, ACCEPTABLE_P)) if c.ndf > 0 else chi2 for c in shown]
    if not any(gain > 0 for gain in needed):
        return False
    # seen on dark bars too
    outline = [withStroke(linewidth=3.4, foreground="white")]
    style: dict[str, Any] = {
        "color": "black", "ls": "--", "lw": 1.4, "zorder": 4, "path_effects": outline,
    }  # fmt: skip
    edges = np.cumsum([0.0, *heights])
    axes.plot(np.repeat(needed, 2), np.repeat(edges, 2)[1:-1], **style)
    return True
