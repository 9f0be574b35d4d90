"""What a measurement would bring: the light yield's error over events, by couplings."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    LIGHT,
    WARM,
    Numbers,
    canvas,
    open_axes,
    save,
    shortened,
    styled,
    write_numbers,
)
from mcrim_mitsuba.planning.plans import Plan, Planning
from mcrim_mitsuba.planning.words import percent

COLUMNS = (
    "couplings", "mountings", "events", "hours", "light_yield_statistical_percent",
    "light_yield_systematic_percent", "light_yield_total_percent", "alpha_scat_total_percent",
)  # fmt: skip
_COLOURS, _LINES = (DARK, WARM, LIGHT), ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))


def draw_plan(path: str | Path, found: Planning) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name), all plans a row.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = plan_numbers(found)
    return save(plan_figure(found), path), write_numbers(path, columns, rows)


def plan_numbers(found: Planning) -> Numbers:
    """Columns and rows of the CSV, the cheapest plan first."""
    rows = [
        (
            found.name(plan.configurations), plan.mountings, plan.events, plan.hours,
            100 * plan.light_yield.statistical, 100 * plan.light_yield.systematic,
            100 * plan.light_yield.total,
            None if plan.alpha_scat is None else 100 * plan.alpha_scat.total,
        )
        for plan in found.plans
    ]  # fmt: skip
    return COLUMNS, rows


@styled
def plan_figure(found: Planning) -> Figure:
    """The figure of `draw_plan`: the statistical part and the whole error, for one number of
    mountings, of the sets of couplings that bring most."""
    figure = canvas(10.4, 4.6)
    statistical, total = figure.subplots(1, 2)
    mountings = _mountings(found)
    plans: dict[tuple[int, ...], list[Plan]] = {}
    for plan in sorted(found.plans, key=lambda p: p.events):
        if plan.mountings == mountings:
            plans.setdefault(plan.configurations, []).append(plan)
    most = len(_COLOURS) * len(_LINES)
    best = sorted(plans, key=lambda chosen: plans[chosen][-1].light_yield.of_plan)[:most]
    for i, chosen in enumerate(best):
        style = {"color": _COLOURS[i % len(_COLOURS)], "ls": _LINES[i // len(_COLOURS)],
                 "lw": 1.6, "marker": "o", "ms": 3.5}  # fmt: skip
        events = [plan.events for plan in plans[chosen]]
        errors = [plan.light_yield for plan in plans[chosen]]
        label = shortened(found.name(chosen), 44)
        statistical.plot(events, [100 * e.statistical for e in errors], label=label, **style)
        total.plot(events, [100 * e.total for e in errors], **style)
    for axes, title in ((statistical, "statistical part"), (total, "statistical and systematic")):
        axes.axhline(100 * found.wanted, color=GREY, lw=1, ls="--", zorder=1)
        axes.set_xscale("log")
        axes.set_xlabel("events in the band, per mounting")
        axes.set_title(title, loc="left", fontsize=11)
        open_axes(axes)
    statistical.set_yscale("log")
    statistical.yaxis.set_major_formatter("{x:g}")
    statistical.yaxis.set_minor_formatter("{x:g}")
    total.set_ylim(bottom=0)
    statistical.set_ylabel("expected error of the light yield (%)")
    total.annotate(
        f"wanted: {percent(found.wanted)}", (0.99, 100 * found.wanted),
        xycoords=("axes fraction", "data"), ha="right", va="top", fontsize=9.5, color=GREY,
    )  # fmt: skip
    times = "1 mounting" if mountings == 1 else f"{mountings} mountings"
    figure.suptitle(f"{times} of each coupling", x=0.01, ha="left", fontsize=11)
    figure.legend(loc="outside right upper", fontsize=9, frameon=False, handlelength=3.4)
    return figure


def _mountings(found: Planning) -> int:
    """Of the plan that the verdict names."""
    named = found.cheapest or found.cheapest_statistical or found.plans[-1]
    return named.mountings
