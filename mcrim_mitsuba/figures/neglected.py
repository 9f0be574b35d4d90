"""The whole error budget of a campaign, what its model leaves out included."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mcrim_mitsuba.figures.budget import BARS, SYSTEMATIC, TOTAL
from mcrim_mitsuba.figures.labels import parameter_title
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    Numbers,
    canvas,
    open_axes,
    save,
    styled,
    write_numbers,
)
from mcrim_mitsuba.findings import number
from mcrim_mitsuba.physics.rounding import pdg

if TYPE_CHECKING:
    from mcrim_mitsuba.budgeting import Budget
    from mcrim_mitsuba.neglect.result import Neglected

COLUMNS = (
    "quantity", "value", "origin", "kind", "percent_of_value", "shift_percent",
    "shift_monte_carlo_percent", "shift_size_percent", "by_what",
)  # fmt: skip

_CORRECTION = "correction, to be made"
_STYLES: dict[str, dict[str, Any]] = {
    **BARS,
    _CORRECTION: {"facecolor": "white", "edgecolor": DARK},
}
#: Inches of a panel, of the names at the left, of a row.
_WIDE, _NAMES, _ROW = 2.6, 2.4, 0.33
#: Shares smaller than this have no digits worth showing, per cent.
_LEAST_PERCENT = 0.005


def draw_neglected(path: str | Path, budget: Budget) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = neglected_numbers(budget)
    return save(neglected_figure(budget), path), write_numbers(path, columns, rows)


def neglected_numbers(budget: Budget) -> Numbers:
    """Columns and rows of the CSV, for all quantities: contributions, sums, what is left out."""
    rows: list[tuple] = []
    for name, total in budget.totals.items():
        percent = 100 / abs(total.value)
        parts = budget.contributions[name].contributions
        sums = (
            ("total", total.sigma),
            ("total, with what is left out", total.sigma_with_neglected),
        )
        rows += [
            *((name, total.value, row.name, row.kind, 100 * abs(row.relative), None, None, None,
               row.by) for row in parts),
            *((name, total.value, what, TOTAL, percent * sigma, None, None, None, "")
              for what, sigma in sums),
        ]  # fmt: skip
        for piece in budget.pieces:
            moved = piece.refitted[name]
            rows.append((
                name, total.value, piece.title, _kind(piece), percent * moved.as_error,
                100 * moved.relative, percent * moved.monte_carlo_sigma,
                percent * moved.size_sigma, piece.mend,
            ))  # fmt: skip
    return COLUMNS, rows


def _kind(piece: Neglected) -> str:
    return _CORRECTION if piece.correction else SYSTEMATIC


@styled
def neglected_figure(budget: Budget) -> Figure:
    """A panel per quantity, in per cent of its value; one row per contribution in all panels."""
    names = [name for name in budget.main if name in budget.totals]
    if not names:
        figure = canvas(6.0, 1.2)
        figure.text(0.02, 0.5, "a parameter ended at its bound: no budget", va="center")
        return figure
    rows = _rows(budget, names)
    figure = canvas(_NAMES + _WIDE * len(names), 1.5 + _ROW * len(rows))
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        total = budget.totals[name]
        _draw(axes, [(kind, sizes.get(name)) for _, kind, sizes in rows])
        axes.set_title(_title(name), loc="left", fontsize=11)
        axes.set_xlabel(f"% of {pdg(total.value, total.sigma)}", fontsize=10)
    panels[0].set_yticks(range(len(rows)), [row[0] for row in rows], fontsize=10)
    panels[0].set_ylim(len(rows) - 0.5, -0.5)
    kinds = dict.fromkeys(kind for _, kind, _ in rows)
    figure.legend(
        handles=[Patch(label=kind, **_STYLES[kind]) for kind in _STYLES if kind in kinds],
        loc="outside lower center", ncols=4, fontsize=9.5, frameon=False,
    )  # fmt: skip
    return figure


def _title(name: str) -> str:
    return parameter_title(name).replace("(photons per keV)", "(ph/keV)")


def _rows(budget: Budget, names: list[str]) -> list[tuple[str, str, dict[str, tuple]]]:
    """Name, kind, and per quantity (length of the bar, its text), all in per cent."""
    rows: dict[str, tuple[str, dict[str, tuple]]] = {}
    # the light yield, last, puts the rows in order
    for name in reversed(names):
        for row in budget.contributions[name].contributions:
            of_quantities = rows.setdefault(row.name, (row.kind, {}))[1]
            size = 100 * abs(row.relative)
            of_quantities[name] = (size, f"{number(size, 2)} %")
    found = [(name.replace("_", " "), kind, sizes) for name, (kind, sizes) in rows.items()]
    totals = {n: 100 * t.sigma / abs(t.value) for n, t in budget.totals.items()}
    found.append(("total", TOTAL, {n: (size, f"{number(size)} %") for n, size in totals.items()}))
    for piece in (p for p in budget.neglected if not p.correction):
        sizes = {n: 100 * m.as_error / abs(m.before) for n, m in piece.refitted.items() if m.before}
        found.append((
            f"{piece.title} (left out)", SYSTEMATIC,
            {n: (size, f"{number(size, 2)} %" if size > _LEAST_PERCENT else "0")
             for n, size in sizes.items()},
        ))  # fmt: skip
    for piece in (p for p in budget.pieces if p.correction):
        sizes = {n: 100 * m.relative for n, m in piece.refitted.items() if m.before}
        found.append((
            piece.title, _CORRECTION,
            {n: (abs(size), f"{size:+.2g} %") for n, size in sizes.items()},
        ))  # fmt: skip
    return found


def _draw(axes: Axes, bars: list[tuple[str, tuple | None]]) -> None:
    longest = max((bar[0] for _, bar in bars if bar), default=1.0)
    for place, (kind, bar) in enumerate(bars):
        if bar is None:
            continue
        size, text = bar
        axes.barh(place, size, height=0.66, lw=1, **_STYLES[kind])
        axes.annotate(text, (size, place), (4, 0), textcoords="offset points", va="center",
                      fontsize=9.5, color=GREY if size < _LEAST_PERCENT else "black")  # fmt: skip
    axes.set_xlim(0, 1.42 * longest if math.isfinite(longest) and longest else 1.0)
    open_axes(axes, "x")
    axes.tick_params(axis="y", length=0)
