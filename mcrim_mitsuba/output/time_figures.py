"""Arrival times in pictures: the histogram of detected light, and an event's first photons."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.efficiency.arrival_times import ArrivalTimes
from mcrim_mitsuba.output import figure_style as style

#: Times are shown in ns from here on.
_LONG_PS = 10_000.0
_LOOKS = ((style.DARK, "o", -0.12), (style.WARM, "s", 0.12))


@style.styled
def draw_times(found: ArrivalTimes) -> style.Drawing:
    """The histogram with its mean and 10 to 90 %, and the first photons with their rms."""
    figure = style.canvas(10.4, 4.5)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_histogram(left, found)
    _draw_first(right, found)
    names = "mean_ps", "mean_ps_sigma", "rms_ps", "rms_ps_sigma"
    columns = ("time_ps", "part", "part_sigma", "born", "photon", *names)
    first = [
        (None, None, None, one.born, place + 1,
         *(float(getattr(one, name)[place]) for name in names))
        for one in found.first
        for place in range(len(one.mean_ps))
    ]  # fmt: skip
    rows = [(*row, *(None,) * (1 + 1 + len(names))) for row in found.rows]
    return style.Drawing(figure, columns, [*rows, *first])


def _draw_histogram(axes: Axes, found: ArrivalTimes) -> None:
    unit, per = ("ns", 1000.0) if found.edges_ps[-1] > _LONG_PS else ("ps", 1.0)
    edges = found.edges_ps / per
    percent, sigma = 100.0 * found.part, 100.0 * found.part_sigma
    axes.stairs(percent, edges, color=style.DARK, lw=1.6)
    low, high = (np.append(band, band[-1]) for band in (percent - sigma, percent + sigma))
    axes.fill_between(edges, low, high, step="post", color=style.DARK, alpha=0.25, lw=0)
    mean = f"{pdg(found.mean_ps / per, found.mean_ps_sigma / per)} {unit}"
    axes.axvline(found.mean_ps / per, color=style.WARM, lw=1.4, ls=(0, (5, 1.6)),
                 label=f"mean, {mean}")  # fmt: skip
    begin, end = found.begin_ps / per, (found.begin_ps + found.rise_ps) / per
    axes.axvspan(begin, end, color=style.LIGHT, alpha=0.18, lw=0,
                 label=f"10 to 90 % of the light, {end - begin:.3g} {unit}")  # fmt: skip
    axes.set(xlabel=f"arrival time ({unit})", ylabel=f"detected light (% per {edges[1]:g} {unit})",
             xlim=(0, edges[-1]), ylim=(0, None))  # fmt: skip
    style.open_axes(axes)
    style.legend_above(axes, ncols=1, handlelength=2.6)


def _draw_first(axes: Axes, found: ArrivalTimes) -> None:
    number = np.arange(1, len(found.first[0].mean_ps) + 1)
    for one, (colour, marker, shift) in zip(found.first, _LOOKS, strict=False):
        axes.errorbar(number + shift, one.mean_ps, one.rms_ps, color=colour, fmt=marker, ms=4.5,
                      lw=1.2, capsize=2.5, label=f"light of an event born {one.born}")  # fmt: skip
    axes.set(xlabel=f"number among {found.detected:,} detected photons",
             ylabel="arrival time, mean and rms (ps)", ylim=(0, None), xticks=number)  # fmt: skip
    style.open_axes(axes)
    style.legend_above(axes, ncols=1)
