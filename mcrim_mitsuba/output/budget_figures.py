"""Error budgets of a fit and of all that its model leaves out, and what a plan would bring."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, NamedTuple

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
    "pedestal": ("pedestal, background", SYSTEMATIC),
    "tolerances": ("the bench's numbers", SYSTEMATIC),
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
        (name, value, *part, 100 * part.sigma / abs(value) if value else None)
        for name, estimate in fitted
        if estimate.at_bound is None
        for value in [estimate.value]
        for part in contributions(estimate)
    ]
    columns = ("parameter", "value", *ErrorPart._fields, "percent_of_value")
    if not fitted:
        return style.sentence_instead("nothing was fitted: there are no errors", (columns, rows))
    down, across = style.panels_of(len(fitted))
    figure = style.canvas(max(_BUDGET_WIDE * across + 1.3, 7.2), _HIGH * down + 0.9)
    for axes, (name, estimate) in zip(style.panels(figure, len(fitted), "x"), fitted, strict=True):
        _draw_contributions(axes, name, estimate)
    handles = [Patch(label=kind, **bar) for kind, bar in BARS.items()]
    style.legend_of(figure, handles, "lower center", 3)
    return style.Drawing(figure, columns, rows)


class ErrorPart(NamedTuple):
    """What one origin adds to a parameter's error, in quadrature."""

    origin: str
    #: `STATISTICAL`, `SYSTEMATIC` or `TOTAL`.
    kind: str
    #: In the parameter's unit.
    sigma: float


def contributions(estimate: ParameterEstimate) -> list[ErrorPart]:
    """All parts of a parameter's error, sums last.

    ``systematic, together`` is there where more than one is systematic; ``total`` always.
    """
    parts = [
        ErrorPart(name, kind, estimate.contributions[origin])
        for origin, (name, kind) in _ORIGINS.items()
        if estimate.contributions.get(origin)
    ]
    systematic = [part.sigma for part in parts if part.kind == SYSTEMATIC]
    if len(systematic) > 1:
        parts.append(ErrorPart("systematic, together", SYSTEMATIC, math.hypot(*systematic)))
    return [*parts, ErrorPart("total", TOTAL, estimate.sigma)]


def _draw_contributions(axes: Axes, name: str, estimate: ParameterEstimate) -> None:
    """A parameter's errors as bars, in per cent if the value is larger; at a bound in words."""
    axes.set_title(style.parameter_title(name), loc="left", fontsize=11)
    if estimate.at_bound is not None:
        axes.text(0.02, 0.5, estimate_text(estimate), transform=axes.transAxes, color=style.GREY)
        axes.set_axis_off()
        return
    in_percent = abs(estimate.value) > estimate.sigma
    parts = contributions(estimate)
    factor = 100 / abs(estimate.value) if in_percent else 1.0
    sizes = [factor * part.sigma for part in parts]
    for place, (part, size) in enumerate(zip(parts, sizes, strict=True)):
        _bar(axes, place, part.kind, size, f"{number(size)} %" if in_percent else number(size))
    style.rows_of_bars(axes, [part.origin for part in parts], fontsize=10)
    axes.set(ylim=(max(len(parts), _FEWEST_ROWS) - 0.5, -0.5), xlim=(0, 1.28 * max(sizes)))
    unit = "% of" if in_percent else "own unit;"
    axes.set_xlabel(f"{unit} {estimate_text(estimate)}", fontsize=10, parse_math=False)


def _bar(axes: Axes, place: int, kind: str, size: float, text: str, colour: str = "black") -> None:
    """A bar in the look of its kind, with what it stands for at the right of its end."""
    axes.barh(place, size, height=0.66, lw=1, **_STYLES[kind])
    style.text_after_bar(axes, text, (size, place), color=colour)


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
    no_shift = (None, None, None)
    for name, total in budget.totals.items():
        per_cent = 100 / abs(total.value)
        rows += [
            (name, total.value, part.name, part.kind, 100 * abs(part.relative), *no_shift, part.by)
            for part in budget.contributions[name].contributions
        ]
        whole, words = per_cent * total.sigma_with_neglected, "total, with what is left out"
        rows.append((name, total.value, "total", TOTAL, per_cent * total.sigma, *no_shift, ""))
        rows.append((name, total.value, words, TOTAL, whole, *no_shift, ""))
        for piece in budget.pieces:
            shift = piece.refitted[name]
            sigmas = (per_cent * shift.monte_carlo_sigma, per_cent * shift.size_sigma)
            cells = (per_cent * shift.as_error, 100 * shift.relative, *sigmas)
            rows.append((name, total.value, piece.title, _kind(piece), *cells, piece.mend))
    columns = (
        "quantity value origin kind percent_of_value shift_percent "
        "shift_monte_carlo_percent shift_size_percent by_what"
    ).split()
    return columns, rows


def _kind(piece: Neglected) -> str:
    return _CORRECTION if piece.correction else SYSTEMATIC


class _BudgetRow(NamedTuple):
    """A contribution to several quantities."""

    name: str
    kind: str
    #: By quantity: length in per cent of it, and text.
    bars: dict[str, tuple[float, str]]


@style.styled
def draw_neglected(budget: Budget) -> style.Drawing:
    """The whole error budget of a campaign, what its model leaves out included.

    A panel per quantity, in per cent of its value; one row per contribution in all panels.
    """
    names, numbers = [n for n in budget.main if n in budget.totals], _neglected_numbers(budget)
    if not names:
        return style.sentence_instead("a parameter ended at its bound: no budget", numbers)
    rows = _rows(budget, names)
    wide, high, across = _NAMES + _NEGLECTED_WIDE * len(names), 1.5 + _ROW * len(rows), len(names)
    options: dict[str, Any] = {"lines": "x", "sharey": True, "squeeze": False}
    figure, all_axes = style.axes_of(wide, high, 1, across, **options)
    for axes, name in zip(all_axes[0], names, strict=True):
        total = budget.totals[name]
        for place, row in enumerate(rows):
            if name in row.bars:
                length, text = row.bars[name]
                colour = style.GREY if length < _LEAST_PERCENT else "black"
                _bar(axes, place, row.kind, length, text, colour)
        # room at the right for the texts
        longest = max((row.bars[name][0] for row in rows if name in row.bars), default=1.0)
        axes.set_xlim(0, 1.42 * longest if math.isfinite(longest) and longest else 1.0)
        style.rows_of_bars(axes, [row.name for row in rows], fontsize=10)
        title = style.parameter_title(name).replace("(photons per keV)", "(ph/keV)")
        axes.set_title(title, loc="left", fontsize=11)
        axes.set_xlabel(f"% of {pdg(total.value, total.sigma)}", fontsize=10)
    kinds = {row.kind for row in rows}
    handles = [Patch(label=kind, **look) for kind, look in _STYLES.items() if kind in kinds]
    style.legend_of(figure, handles, "lower center", 4)
    return style.Drawing(figure, *numbers)


def _rows(budget: Budget, names: list[str]) -> list[_BudgetRow]:
    """Contributions, the total, errors left out, and corrections with the sign of their shift."""
    contributions: dict[str, _BudgetRow] = {}
    # the light yield, last, puts the rows in order
    for name in reversed(names):
        for part in budget.contributions[name].contributions:
            row = _BudgetRow(part.name.replace("_", " "), part.kind, {})
            length = 100 * abs(part.relative)
            bars = contributions.setdefault(part.name, row).bars
            bars[name] = length, f"{number(length, 2)} %"
    totals = {n: 100 * t.sigma / abs(t.value) for n, t in budget.totals.items()}
    total_bars = {n: (length, f"{number(length)} %") for n, length in totals.items()}
    rows = [*contributions.values(), _BudgetRow("total", TOTAL, total_bars)]
    # corrections last; `pieces` has among them all corrections at once
    corrections = (p for p in budget.pieces if p.correction)
    for piece in (*(p for p in budget.neglected if not p.correction), *corrections):
        bars = {}
        for name, shift in piece.refitted.items():
            if shift.before and piece.correction:
                bars[name] = abs(100 * shift.relative), f"{100 * shift.relative:+.2g} %"
            elif shift.before:
                length = 100 * shift.as_error / abs(shift.before)
                bars[name] = length, f"{number(length, 2)} %" if length > _LEAST_PERCENT else "0"
        title = piece.title if piece.correction else f"{piece.title} (left out)"
        rows.append(_BudgetRow(title, _kind(piece), bars))
    return rows


# The light yield's error over events, by couplings.


_COLOURS = (style.DARK, style.WARM, style.LIGHT)
_LINES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))
#: A set of couplings: places in `Planning.candidates`.
_Couplings = tuple[int, ...]
#: Curves that differ by no more than this part of themselves are drawn as one.
_ON_EACH_OTHER = 0.06
#: A set whose error is as many times that of the best, and the wanted one, is of no use to anybody.
_USELESS = 3.0


@style.styled
def draw_plan(planning: Planning) -> style.Drawing:
    """The light yield's error over events, by couplings; the numbers of all plans.

    Drawn are the statistical part and the whole, for the number of mountings that the verdict
    names, of the sets of couplings that bring most, one for all whose curves lie on each other.
    Sets of no use, beside which others' curves would not be told apart, are left out and counted.
    """
    figure, (statistical, total) = style.axes_of(10.4, 4.6, 1, 2)
    mountings = (planning.cheapest or planning.cheapest_statistical or planning.plans[-1]).mountings
    plans: dict[_Couplings, list[Plan]] = {}
    for plan in sorted(planning.plans, key=lambda p: p.events):
        if plan.mountings == mountings:
            plans.setdefault(plan.configurations, []).append(plan)
    # the set whose plan of most events is the most precise first
    best = sorted(plans, key=lambda couplings: plans[couplings][-1].light_yield.of_plan)
    # (2, events) each: statistical part and whole, per cent
    curves = {
        couplings: 100.0
        * np.array([(p.light_yield.statistical, p.light_yield.total) for p in plans[couplings]]).T
        for couplings in best
    }
    least = min(curve[1].min() for curve in curves.values())
    most = _USELESS * max(100.0 * planning.wanted, least)
    useful = {couplings: curve for couplings, curve in curves.items() if curve[1].min() < most}
    looks = itertools.product(_LINES, _COLOURS)
    drawn = _without_covered(useful)
    for (couplings, covered), (line, colour) in zip(drawn.items(), looks, strict=False):
        look = {"color": colour, "ls": line, "lw": 1.6, "marker": "o", "ms": 3.5}
        events = [plan.events for plan in plans[couplings]]
        label = style.shortened(planning.number(couplings), 44)
        label += f", and {counted(covered, 'set')} alike" if covered else ""
        statistical.plot(events, curves[couplings][0], label=label, **look)
        total.plot(events, curves[couplings][1], **look)
    _finish_plan(statistical, total, planning.wanted)
    for place, at in enumerate(planning.candidates if planning.is_numbered else (), 1):
        total.plot([], [], " ", label=style.in_lines(f"{place}: {at.name}", 40))
    words = f"{counted(mountings, 'mounting')} of each"
    if useless := len(curves) - len(useful):
        words += f"; not drawn: {counted(useless, 'set')} with errors above {most:.0f} %"
    figure.suptitle(words, x=0.01, ha="left", fontsize=11)
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


def _without_covered(curves: dict[_Couplings, np.ndarray]) -> dict[_Couplings, int]:
    """Sets of couplings that are drawn, and how many others' curves would lie on each one's."""
    drawn: dict[_Couplings, int] = {}
    for couplings, curve in curves.items():
        for other in (o for o in drawn if curves[o].shape == curve.shape):
            if np.allclose(curve, curves[other], rtol=_ON_EACH_OTHER, atol=0.0):
                drawn[other] += 1
                break
        else:
            drawn[couplings] = 0
    return drawn


def _finish_plan(statistical: Axes, total: Axes, wanted: float) -> None:
    """Axes, titles and a line at the wanted error of the light yield, a fraction of it."""
    label = f"wanted: {percent(wanted)}"  # in the legend, where it hides no curve
    for axes, title in ((statistical, "statistical part"), (total, "statistical and systematic")):
        axes.axhline(100 * wanted, color=style.GREY, lw=1, ls="--", zorder=1, label=label)
        label = ""
        axes.set(xscale="log", xlabel="events in the band, per mounting")
        axes.set_title(title, loc="left", fontsize=11)
    statistical.set(yscale="log", ylabel="expected error of the light yield (%)")
    statistical.yaxis.set_major_formatter("{x:g}")
    # others stand too close to the next power of ten
    statistical.yaxis.set_minor_locator(LogLocator(subs=(2, 3, 4, 5, 7)))
    statistical.yaxis.set_minor_formatter("{x:g}")
    total.set_ylim(0, 1.05 * total.get_ylim()[1])
