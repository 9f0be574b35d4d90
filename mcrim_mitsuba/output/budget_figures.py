"""Error budgets of a fit and of all that its model leaves out, and what a plan would bring."""

from __future__ import annotations

import itertools
import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from mcrim_mitsuba.core.rounding import counted, number, pdg, percent
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.plan import Plan, Planning
from mcrim_mitsuba.output import figure_style as style
from mcrim_mitsuba.output.sentences import estimate_text

if TYPE_CHECKING:
    from mcrim_mitsuba.inference.budget import Budget
    from mcrim_mitsuba.inference.corrections import Neglected


#: Kinds of contributions.
STATISTICAL = "statistical"
SYSTEMATIC = "systematic"
TOTAL = "total"
#: Contributions of `ParameterEstimate`, as the figure names them, and what they are.
_ORIGINS = {
    "statistical": ("readings", STATISTICAL),
    "prior": ("priors", SYSTEMATIC),
    "detector_efficiency": ("detector efficiency", SYSTEMATIC),
    "monte_carlo": ("simulation", STATISTICAL),
}
BARS: dict[str, dict[str, Any]] = {
    STATISTICAL: {"facecolor": style.LIGHT, "edgecolor": style.DARK},
    SYSTEMATIC: {"facecolor": "#f3c9ad", "edgecolor": style.WARM, "hatch": "///"},
    TOTAL: {"facecolor": style.DARK, "edgecolor": style.DARK},
}
_CORRECTION = "correction, to be made"
_STYLES = BARS | {_CORRECTION: {"facecolor": "white", "edgecolor": style.DARK}}
#: Inches of a panel of the budget.
_BUDGET_WIDE = 3.5
_HIGH = 2.5
#: Of the line above the panels.
_LETTERS_PER_INCH = 11.5
#: Rows for which there is room, lest few bars become thick.
_FEWEST_ROWS = 5


@style.styled
def draw_budget(calibration: Calibration) -> style.Drawing:
    """Parts of every parameter's error by origin, in per cent of its value, a panel each.

    A value nearer to 0 than its error has its errors in the parameter's own unit. Parameters at a
    bound have no budget: their standard errors know nothing of the bound.
    """
    # the light yield first: it is what all is done for
    fitted = sorted(calibration.parameters.items(), key=lambda item: item[0] != LIGHT_YIELD)
    rows = [
        (
            name,
            estimate.value,
            *part,
            100 * part[-1] / abs(estimate.value) if estimate.value else None,
        )
        for name, estimate in fitted
        if estimate.at_bound is None
        for part in contributions(estimate)
    ]
    columns = ("parameter", "value", "origin", "kind", "sigma", "percent_of_value")
    if not fitted:
        nothing = style.said_alone("nothing was fitted: there are no errors")
        return style.Drawing(nothing, columns, rows)
    down, across = style.panels_of(len(fitted))
    figure = style.canvas(max(_BUDGET_WIDE * across + 1.3, 7.2), _HIGH * down + 0.9)
    for axes, (name, estimate) in zip(style.panels(figure, len(fitted)), fitted, strict=True):
        _draw_contributions(axes, name, estimate)
    light = calibration.parameters.get(LIGHT_YIELD)
    if light is not None and light.at_bound is None:
        letters = round(_LETTERS_PER_INCH * figure.get_figwidth())
        lines = (textwrap.fill(line, letters) for line in _spelled_out(light).split("\n"))
        figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=11)
    style.legend_of(
        figure, [Patch(label=kind, **bar) for kind, bar in BARS.items()], "lower center", 3
    )
    return style.Drawing(figure, columns, rows)


def contributions(estimate: ParameterEstimate) -> list[tuple[str, str, float]]:
    """(origin, kind, sigma) of every contribution that a parameter has, sums last.

    ``systematic, together`` is there where more than one is; ``total`` always. Contributions
    add up in quadrature.
    """
    parts = [
        (name, kind, estimate.contributions[origin])
        for origin, (name, kind) in _ORIGINS.items()
        if estimate.contributions.get(origin)
    ]
    systematic = [sigma for _, kind, sigma in parts if kind == SYSTEMATIC]
    if len(systematic) > 1:
        parts.append(("systematic, together", SYSTEMATIC, math.hypot(*systematic)))
    return [*parts, ("total", TOTAL, estimate.sigma)]


def _draw_contributions(axes: Axes, name: str, estimate: ParameterEstimate) -> None:
    """A parameter's errors by origin as bars, in per cent where the value is above its error."""
    axes.set_title(style.parameter_title(name), loc="left", fontsize=11)
    if estimate.at_bound is not None:
        axes.text(0.02, 0.5, estimate_text(estimate), transform=axes.transAxes, color=style.GREY)
        axes.set_axis_off()
        return
    in_percent = abs(estimate.value) > estimate.sigma
    parts = contributions(estimate)
    sizes = [100 * sigma / abs(estimate.value) if in_percent else sigma for _, _, sigma in parts]
    for place, ((_, kind, _), size) in enumerate(zip(parts, sizes, strict=True)):
        _bar(axes, place, kind, size, f"{number(size)} %" if in_percent else number(size))
    axes.set_yticks(range(len(parts)), [origin for origin, _, _ in parts], fontsize=10)
    axes.set(ylim=(max(len(parts), _FEWEST_ROWS) - 0.5, -0.5), xlim=(0, 1.28 * max(sizes)))
    axes.set_xlabel(
        f"{'% of' if in_percent else 'own unit;'} {estimate_text(estimate)}",
        fontsize=10,
        parse_math=False,
    )
    style.open_axes(axes, "x")
    axes.tick_params(axis="y", length=0)


def _bar(axes: Axes, place: int, kind: str, size: float, text: str, colour: str = "black") -> None:
    """A bar with what it stands for behind its end."""
    axes.barh(place, size, height=0.66, lw=1, **_STYLES[kind])
    style.behind(axes, text, (size, place), color=colour)


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


# The whole budget of a campaign, what its model leaves out included.


#: Inches of a panel of what is neglected.
_NEGLECTED_WIDE = 2.6
#: Inches of the names at the left.
_NAMES = 2.4
#: Inches of a row.
_ROW = 0.33
#: Shares smaller than this have no digits worth showing, per cent.
_LEAST_PERCENT = 0.005


def _neglected_numbers(budget: Budget) -> style.Numbers:
    """Of all quantities: contributions, sums, what is left out."""
    rows: list[tuple] = []
    for name, total in budget.totals.items():
        percent = 100 / abs(total.value)
        errors = [
            *(
                (row.name, row.kind, 100 * abs(row.relative), row.by)
                for row in budget.contributions[name].contributions
            ),
            ("total", TOTAL, percent * total.sigma, ""),
            ("total, with what is left out", TOTAL, percent * total.sigma_with_neglected, ""),
        ]
        rows += [(name, total.value, *cells, None, None, None, by) for *cells, by in errors]
        for piece in budget.pieces:
            moved = piece.refitted[name]
            rows.append(
                (
                    name,
                    total.value,
                    piece.title,
                    _kind(piece),
                    percent * moved.as_error,
                    100 * moved.relative,
                    percent * moved.monte_carlo_sigma,
                    percent * moved.size_sigma,
                    piece.mend,
                )
            )
    columns = (
        "quantity value origin kind percent_of_value shift_percent "
        "shift_monte_carlo_percent shift_size_percent by_what"
    ).split()
    return columns, rows


def _kind(piece: Neglected) -> str:
    return _CORRECTION if piece.correction else SYSTEMATIC


@style.styled
def draw_neglected(budget: Budget) -> style.Drawing:
    """The whole error budget of a campaign, what its model leaves out included.

    A panel per quantity, in per cent of its value; one row per contribution in all panels.
    """
    names, numbers = [n for n in budget.main if n in budget.totals], _neglected_numbers(budget)
    if not names:
        nothing = style.said_alone("a parameter ended at its bound: no budget")
        return style.Drawing(nothing, *numbers)
    rows = _rows(budget, names)
    figure = style.canvas(_NAMES + _NEGLECTED_WIDE * len(names), 1.5 + _ROW * len(rows))
    every = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(every, names, strict=True):
        total = budget.totals[name]
        drawn = [
            (place, kind, *sizes[name])
            for place, (_, kind, sizes) in enumerate(rows)
            if name in sizes
        ]
        for place, kind, size, text in drawn:
            _bar(axes, place, kind, size, text, style.GREY if size < _LEAST_PERCENT else "black")
        longest = max((size for *_, size, _ in drawn), default=1.0)
        axes.set_xlim(0, 1.42 * longest if math.isfinite(longest) and longest else 1.0)
        style.open_axes(axes, "x")
        axes.tick_params(axis="y", length=0)
        title = style.parameter_title(name).replace("(photons per keV)", "(ph/keV)")
        axes.set_title(title, loc="left", fontsize=11)
        axes.set_xlabel(f"% of {pdg(total.value, total.sigma)}", fontsize=10)
    every[0].set_yticks(range(len(rows)), [row[0] for row in rows], fontsize=10)
    every[0].set_ylim(len(rows) - 0.5, -0.5)
    kinds = {kind for _, kind, _ in rows}
    handles = [Patch(label=kind, **look) for kind, look in _STYLES.items() if kind in kinds]
    style.legend_of(figure, handles, "lower center", 4)
    return style.Drawing(figure, *numbers)


def _rows(budget: Budget, names: list[str]) -> list[tuple[str, str, dict[str, tuple]]]:
    """Name, kind, and per quantity (length of the bar, its text), all in per cent."""
    rows: dict[str, tuple[str, dict[str, tuple]]] = {}
    # the light yield, last, puts the rows in order
    for name in reversed(names):
        for row in budget.contributions[name].contributions:
            size = 100 * abs(row.relative)
            rows.setdefault(row.name, (row.kind, {}))[1][name] = size, f"{number(size, 2)} %"
    bars = [(name.replace("_", " "), kind, sizes) for name, (kind, sizes) in rows.items()]
    totals = {n: 100 * t.sigma / abs(t.value) for n, t in budget.totals.items()}
    bars.append(("total", TOTAL, {n: (size, f"{number(size)} %") for n, size in totals.items()}))
    # corrections last; what makes all of them together is one
    for piece in (
        *(p for p in budget.neglected if not p.correction),
        *(p for p in budget.pieces if p.correction),
    ):
        sizes = {}
        for name, moved in piece.refitted.items():
            if moved.before and piece.correction:
                sizes[name] = abs(100 * moved.relative), f"{100 * moved.relative:+.2g} %"
            elif moved.before:
                size = 100 * moved.as_error / abs(moved.before)
                sizes[name] = size, f"{number(size, 2)} %" if size > _LEAST_PERCENT else "0"
        title = piece.title if piece.correction else f"{piece.title} (left out)"
        bars.append((title, _kind(piece), sizes))
    return bars


# The light yield's error over events, by couplings.


_COLOURS = (style.DARK, style.WARM, style.LIGHT)
_LINES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))
#: Curves that differ by no more than this part of themselves are drawn as one.
_ON_EACH_OTHER = 0.06


@style.styled
def draw_plan(planning: Planning) -> style.Drawing:
    """The light yield's error over events, by couplings; the numbers of all plans.

    Drawn are the statistical part and the whole, for the number of mountings that the verdict
    names, of the sets of couplings that bring most, one for all whose curves lie on each other.
    """
    figure = style.canvas(10.4, 4.6)
    statistical, total = figure.subplots(1, 2)
    mountings = (planning.cheapest or planning.cheapest_statistical or planning.plans[-1]).mountings
    plans: dict[tuple[int, ...], list[Plan]] = {}
    for plan in sorted(planning.plans, key=lambda p: p.events):
        if plan.mountings == mountings:
            plans.setdefault(plan.configurations, []).append(plan)
    best = sorted(plans, key=lambda chosen: plans[chosen][-1].light_yield.of_plan)
    # per set of couplings (2, events) percentages, and those whose curves would lie on its own
    curves = {
        chosen: 100.0
        * np.array([(p.light_yield.statistical, p.light_yield.total) for p in plans[chosen]]).T
        for chosen in best
    }

    def covers(drawn: tuple[int, ...], chosen: tuple[int, ...]) -> bool:
        curve, other = curves[drawn], curves[chosen]
        return curve.shape == other.shape and np.allclose(
            other, curve, rtol=_ON_EACH_OTHER, atol=0.0
        )

    alike: dict[tuple[int, ...], int] = {}
    for chosen in best:
        drawn = next((twin for twin in alike if covers(twin, chosen)), chosen)
        alike[drawn] = alike.get(drawn, -1) + 1
    looks = itertools.product(_LINES, _COLOURS)
    for (chosen, others), (line, colour) in zip(alike.items(), looks, strict=False):
        look = {"color": colour, "ls": line, "lw": 1.6, "marker": "o", "ms": 3.5}
        events = [plan.events for plan in plans[chosen]]
        label = style.shortened(planning.name(chosen), 44) + (
            f", and {others} alike" * (others > 0)
        )
        statistical.plot(events, curves[chosen][0], label=label, **look)
        total.plot(events, curves[chosen][1], **look)
    _finish_plan(statistical, total, planning.wanted)
    times = counted(mountings, "mounting")
    figure.suptitle(f"{times} of each coupling", x=0.01, ha="left", fontsize=11)
    figure.legend(loc="outside right upper", fontsize=9, frameon=False, handlelength=3.4)
    numbers = style.numbers_of(
        planning.plans,
        "couplings mountings events hours",
        couplings=lambda plan: planning.name(plan.configurations),
        light_yield_statistical_percent=lambda plan: 100 * plan.light_yield.statistical,
        light_yield_systematic_percent=lambda plan: 100 * plan.light_yield.systematic,
        light_yield_total_percent=lambda plan: 100 * plan.light_yield.total,
        alpha_scat_total_percent=lambda p: 100 * p.alpha_scat.total if p.alpha_scat else None,
    )
    return style.Drawing(figure, *numbers)


def _finish_plan(statistical: Axes, total: Axes, wanted: float) -> None:
    """Axes, titles and what is wanted, a relative error."""
    for axes, title in ((statistical, "statistical part"), (total, "statistical and systematic")):
        axes.axhline(100 * wanted, color=style.GREY, lw=1, ls="--", zorder=1)
        axes.set(xscale="log", xlabel="events in the band, per mounting")
        axes.set_title(title, loc="left", fontsize=11)
        style.open_axes(axes)
    statistical.set(yscale="log", ylabel="expected error of the light yield (%)")
    statistical.yaxis.set_major_formatter("{x:g}")
    # others stand too close to the next power of ten
    statistical.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 4, 5, 7)))
    statistical.yaxis.set_minor_formatter("{x:g}")
    total.set_ylim(bottom=0)
    total.annotate(
        f"wanted: {percent(wanted)}",
        (0.99, 100 * wanted),
        (0, -3),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=9.5,
        color=style.GREY,
    )
