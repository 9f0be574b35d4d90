"""Which fates light meets: one stacked bar per configuration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mcrim_mitsuba.figures.fate_style import fate_style, ordered
from mcrim_mitsuba.figures.style import (
    Numbers,
    canvas,
    open_axes,
    save,
    shortened,
    styled,
    write_numbers,
)
from mcrim_mitsuba.lighting import Light
from mcrim_mitsuba.physics.rounding import pdg

COLUMNS = ("configuration", "fate", "fraction", "fraction_sigma", "photons")

#: Percent: narrower parts have their label above the bar, and the narrowest have none.
_INSIDE, _LEAST = 6.8, 0.1
#: Percent that a label above the bar takes.
_LABEL = 6.6
_HEIGHT = 0.56


def draw_fates(path: str | Path, lights: Sequence[tuple[str, Light]]) -> tuple[Path, Path]:
    """Write the figure (in the format of its suffix) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    lights : sequence of (str, Light)
        Configurations with their names, from top to bottom; at least one.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    return save(fates_figure(lights), path), write_numbers(path, *fates_numbers(lights))


def fates_numbers(lights: Sequence[tuple[str, Light]]) -> Numbers:
    """Columns and rows of the numbers behind the figure: every fate of the budget."""
    rows = [
        (name, fate, light.budget[fate], light.budget_sigma[fate], light.photons)
        for name, light in lights
        for fate in ordered(light.budget)
    ]
    return COLUMNS, rows


@styled
def fates_figure(lights: Sequence[tuple[str, Light]]) -> Figure:
    """The figure of `draw_fates`."""
    figure = canvas(9.6, 1.75 + 0.95 * len(lights))
    axes = figure.subplots()
    shown = ordered(
        fate for _, light in lights for fate, share in light.budget.items() if 100 * share >= _LEAST
    )
    for row, (_, light) in enumerate(lights):
        _draw_bar(axes, row, light, shown)
    names = [f"{shortened(n, 30)}\nη = {pdg(x.eta, x.eta_sigma)}" for n, x in lights]
    axes.set_yticks(range(len(lights)), names, parse_math=False)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(lights) - 0.5, -0.72)
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of the emitted light (%)")
    open_axes(axes, "x")
    axes.spines["left"].set_visible(False)
    handles = [Patch(label=fate_style(fate).words, **_look(fate)) for fate in shown]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=min(4, len(handles)), fontsize=10,
        frameon=False, handlelength=1.8, handleheight=1.1, columnspacing=1.6,
    )  # fmt: skip
    return figure


def _look(fate: str) -> dict:
    style = fate_style(fate)
    return {
        "facecolor": style.fill,
        "edgecolor": style.edge,
        "hatch": style.hatch,
        "linewidth": 0.8,
    }


def _draw_bar(axes: Axes, row: int, light: Light, shown: Sequence[str]) -> None:
    """One configuration's bar with its percentages."""
    left, narrow = 0.0, []
    for fate in shown:
        percent = 100 * light.budget.get(fate, 0.0)
        axes.barh(row, percent, _HEIGHT, left, **_look(fate))
        middle, text = left + percent / 2, f"{percent:.1f} %"
        left += percent
        if percent >= _INSIDE:
            box = {"boxstyle": "round,pad=0.15", "fc": fate_style(fate).fill, "ec": "none"}
            axes.text(
                middle, row, text, ha="center", va="center", fontsize=10,
                color=fate_style(fate).text, bbox=box,
            )  # fmt: skip
        elif percent >= _LEAST:
            narrow.append((middle, text))
    top = row - _HEIGHT / 2
    for (middle, text), at in zip(narrow, _apart([m for m, _ in narrow]), strict=True):
        axes.annotate(
            text, (middle, top), (at, top - 0.13), ha="center", va="center", fontsize=9,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "lw": 0.6, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def _apart(middles: Sequence[float]) -> list[float]:
    """Where labels above a bar go, from left to right: near their parts, none on another."""
    places: list[float] = []
    for middle in middles:
        places.append(max(middle, places[-1] + _LABEL if places else _LABEL / 2))
    most = 100 - _LABEL / 2
    for i in reversed(range(len(places))):
        places[i] = min(places[i], most)
        most = places[i] - _LABEL
    return places
