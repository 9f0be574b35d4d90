"""Where the errors of the fitted parameters come from: the error budget."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mcrim_mitsuba.figures.labels import parameter_title
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    LIGHT,
    WARM,
    Numbers,
    canvas,
    open_axes,
    panels,
    save,
    styled,
    write_numbers,
)
from mcrim_mitsuba.findings import estimate_text, number
from mcrim_mitsuba.fit.result import LIGHT_YIELD, Calibration, ParameterEstimate

COLUMNS = ("parameter", "value", "origin", "kind", "sigma", "percent_of_value")

STATISTICAL, SYSTEMATIC, TOTAL = "statistical", "systematic", "total"
#: Contributions of `ParameterEstimate`, as the figure names them, and what they are.
_ORIGINS = {
    "statistical": ("readings", STATISTICAL),
    "prior": ("priors", SYSTEMATIC),
    "detector_efficiency": ("detector efficiency", SYSTEMATIC),
    "monte_carlo": ("simulation", STATISTICAL),
}
BARS: dict[str, dict[str, Any]] = {
    STATISTICAL: {"facecolor": LIGHT, "edgecolor": DARK},
    SYSTEMATIC: {"facecolor": "#f3c9ad", "edgecolor": WARM, "hatch": "///"},
    TOTAL: {"facecolor": DARK, "edgecolor": DARK},
}
#: Most panels side by side; inches of one.
_ACROSS, _WIDE, _HIGH = 3, 3.5, 2.5
#: Of the line above the panels.
_LETTERS_PER_INCH = 11.5
#: Rows for which there is room, lest few bars become thick.
_FEWEST_ROWS = 5


def draw_budget(path: str | Path, calibration: Calibration) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    calibration : Calibration

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = budget_numbers(calibration)
    return save(budget_figure(calibration), path), write_numbers(path, columns, rows)


def budget_numbers(calibration: Calibration) -> Numbers:
    """Columns and rows of the CSV: a contribution to a parameter's error a row.

    Parameters at a bound have no budget: their standard errors know nothing of the bound.
    """
    rows = []
    for name, known in _ordered(calibration).items():
        if known.at_bound is None:
            rows += [
                (name, known.value, origin, kind, sigma, _percent(sigma, known))
                for origin, kind, sigma in contributions(known)
            ]
    return COLUMNS, rows


def contributions(known: ParameterEstimate) -> list[tuple[str, str, float]]:
    """(origin, kind, sigma) of every contribution that a parameter has, sums last.

    ``systematic, together`` is there where more than one is; ``total`` always. Contributions
    add up in quadrature.
    """
    found = [
        (name, kind, known.contributions[origin])
        for origin, (name, kind) in _ORIGINS.items()
        if known.contributions.get(origin)
    ]
    systematic = [sigma for _, kind, sigma in found if kind == SYSTEMATIC]
    if len(systematic) > 1:
        found.append(("systematic, together", SYSTEMATIC, math.hypot(*systematic)))
    return [*found, ("total", TOTAL, known.sigma)]


def _percent(sigma: float, known: ParameterEstimate) -> float | None:
    """None where the value is 0."""
    return 100 * sigma / abs(known.value) if known.value else None


def _ordered(calibration: Calibration) -> dict[str, ParameterEstimate]:
    """Parameters, the light yield first: it is what all is done for."""
    parameters = calibration.parameters
    first = {LIGHT_YIELD: parameters[LIGHT_YIELD]} if LIGHT_YIELD in parameters else {}
    return first | parameters


@styled
def budget_figure(calibration: Calibration) -> Figure:
    """The figure of `draw_budget`: a panel per parameter, in per cent of its value.

    A value nearer to 0 than its error has its errors in the parameter's own unit.
    """
    parameters = _ordered(calibration)
    if not parameters:
        figure = canvas(6.0, 1.2)
        figure.text(0.02, 0.5, "nothing was fitted: there are no errors", va="center")
        return figure
    down = math.ceil(len(parameters) / _ACROSS)
    across = math.ceil(len(parameters) / down)
    figure = canvas(max(_WIDE * across + 1.3, 7.2), _HIGH * down + 0.9)
    for axes, name in zip(panels(figure, len(parameters), _ACROSS), parameters, strict=True):
        _draw(axes, name, parameters[name])
    light = parameters.get(LIGHT_YIELD)
    if light is not None and light.at_bound is None:
        letters = round(_LETTERS_PER_INCH * figure.get_figwidth())
        lines = (textwrap.fill(line, letters) for line in _spelled_out(light).split("\n"))
        figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=11)
    figure.legend(
        handles=[Patch(label=kind, **bar) for kind, bar in BARS.items()],
        loc="outside lower center", ncols=3, fontsize=9.5, frameon=False,
    )  # fmt: skip
    return figure


def _draw(axes: Axes, name: str, known: ParameterEstimate) -> None:
    axes.set_title(parameter_title(name), loc="left", fontsize=11)
    if known.at_bound is not None:
        axes.text(0.02, 0.5, estimate_text(known), transform=axes.transAxes, color=GREY)
        axes.set_axis_off()
        return
    in_percent = abs(known.value) > known.sigma
    parts = contributions(known)
    sizes = [100 * sigma / abs(known.value) if in_percent else sigma for _, _, sigma in parts]
    places = range(len(parts))
    for place, (_, kind, _), size in zip(places, parts, sizes, strict=True):
        axes.barh(place, size, height=0.66, lw=1, **BARS[kind])
        text = f"{number(size)} %" if in_percent else number(size)
        axes.annotate(text, (size, place), (4, 0), textcoords="offset points", va="center",
                      fontsize=9.5)  # fmt: skip
    axes.set_yticks(places, [origin for origin, _, _ in parts], fontsize=10)
    axes.set_ylim(max(len(parts), _FEWEST_ROWS) - 0.5, -0.5)
    axes.set_xlim(0, 1.28 * max(sizes))
    axes.set_xlabel(
        f"{'% of' if in_percent else 'own unit;'} {estimate_text(known)}",
        fontsize=10, parse_math=False,
    )  # fmt: skip
    open_axes(axes, "x")
    axes.tick_params(axis="y", length=0)


def _spelled_out(light: ParameterEstimate) -> str:
    """How the light yield's error adds up."""
    parts = [
        (origin, 100 * sigma / light.value)
        for origin, _, sigma in contributions(light)
        if origin not in ("systematic, together", "total")
    ]
    words = ", ".join(f"{origin} {number(percent)} %" for origin, percent in parts)
    squares = " + ".join(f"{number(percent)}²" for _, percent in parts)
    total = 100 * light.sigma / light.value
    return f"Light yield {estimate_text(light)} ph/keV: {words}\n√({squares}) % = {number(total)} %"
