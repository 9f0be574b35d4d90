"""Histograms of photons per event with their fitted peaks, as in Fig. 2 of the article."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

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
from mcrim_mitsuba.files.histogram import Histogram
from mcrim_mitsuba.findings import number
from mcrim_mitsuba.physics.peak import Peak
from mcrim_mitsuba.physics.rounding import pdg

COLUMNS = (
    "histogram", "photons_per_event", "events", "fitted", "fitted_background", "shape", "centroid",
    "centroid_sigma", "width", "chi2", "ndf",
)  # fmt: skip

#: Of each group in turn; histograms of one group differ in their lines and markers.
_COLOURS = (WARM, DARK, LIGHT, GREY)
_LINES = (
    ("-", "o"), ((0, (6, 1.6)), "^"), ((0, (1.6, 1.2)), "s"), ((0, (6, 1.6, 1.4, 1.6)), "D"),
)  # fmt: skip
_FIT: dict[str, Any] = {"lw": 2.2, "zorder": 4}
_THIN: dict[str, Any] = {"lw": 1.5, "zorder": 4}
_BACKGROUND: dict[str, Any] = {"lw": 0.9, "ls": (0, (4, 2)), "zorder": 3}
#: Error bars at most, in one histogram; histograms with steps and error bars, beyond which each
#: has markers.
_MOST_BARS, _MOST_STEPS = 60, 2
#: Histograms whose legend has room inside.
_MOST_INSIDE = 3
#: Height of the picture over the highest fitted peak: pedestals go out of it.
_ROOM = 1.3


class FittedHistogram(NamedTuple):
    """A histogram with its name, its peak, and what it is a measurement of.

    Histograms of one group, such as the mountings of one configuration, share a colour; without
    a group, each has its own.
    """

    name: str
    histogram: Histogram
    peak: Peak | None
    group: str | None = None


def draw_histograms(
    path: str | Path, fitted: Sequence[FittedHistogram], *, title: str = ""
) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    fitted : sequence of FittedHistogram
    title : str

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = histograms_numbers(fitted)
    figure = histograms_figure(fitted, title=title)
    return save(figure, path), write_numbers(path, columns, rows)


def histograms_numbers(fitted: Sequence[FittedHistogram]) -> Numbers:
    """Columns and rows of the CSV: a bin a row, with the fit where it was made."""
    rows = []
    for name, histogram, peak, _ in fitted:
        of_peak: tuple[object, ...] = (None,) * 6
        curves = np.full((2, len(histogram.photons)), np.nan)
        if peak is not None:
            of_peak = (
                peak.shape, peak.centroid, peak.centroid_sigma, peak.width, peak.chi2, peak.ndf
            )  # fmt: skip
            inside = (histogram.photons >= peak.low) & (histogram.photons <= peak.high)
            curves[0, inside] = peak.counts_at(histogram.photons[inside])
            curves[1, inside] = peak.background_at(histogram.photons[inside])
        for photons, events, *of_bin in zip(
            histogram.photons, histogram.counts, *curves, strict=True
        ):
            rows.append((name, float(photons), int(events), *map(float, of_bin), *of_peak))
    return COLUMNS, rows


@styled
def histograms_figure(fitted: Sequence[FittedHistogram], *, title: str = "") -> Figure:
    """The figure of `draw_histograms`."""
    figure = canvas(7.2 if len(fitted) <= _MOST_INSIDE else 10.4, 5.0)
    axes = figure.add_subplot()
    handles, tops = [], []
    styles = _styles([each.group for each in fitted])
    few = len(fitted) <= _MOST_STEPS
    for (name, histogram, peak, _), (colour, line, marker) in zip(fitted, styles, strict=True):
        look: dict[str, Any] = {"color": colour, "ls": line, **(_FIT if few else _THIN)}
        if few:
            _draw_steps(axes, histogram, colour)
        else:
            axes.plot(histogram.photons, histogram.counts, color=colour, **_marked(marker), ls="")
        if peak is not None:
            _draw_peak(axes, peak, look)
            tops.append(float(peak.counts_at(_inside(peak)).max()))
        else:
            tops.append(float(histogram.counts.max()))
        mark = {} if few else _marked(marker)
        handles.append(Line2D([], [], label=_label(name, peak), **look | mark))
    if any(each.peak is not None for each in fitted):
        handles.append(Line2D([], [], color=GREY, label="linear background", **_BACKGROUND))
    top = _ROOM * max(tops, default=1.0)
    highest = max((float(each.histogram.counts.max()) for each in fitted), default=1.0)
    axes.set_ylim(0, max(top, 1.0) if highest > top else None)
    axes.set_xlim(left=min((float(each.histogram.photons[0]) for each in fitted), default=0.0))
    axes.set_xlabel("detected photons per event")
    axes.set_ylabel("events per bin")
    axes.set_title(shortened(title, 90), loc="left", fontsize=11, parse_math=False)
    open_axes(axes)
    place: dict[str, Any] = {"loc": "upper right"}
    if len(fitted) > _MOST_INSIDE:
        place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    legend = axes.legend(handles=handles, fontsize=9.5, frameon=False, handlelength=2.6, **place)
    for text in legend.get_texts():
        text.set_parse_math(False)
    if highest > top:
        axes.text(
            0.015, 0.985, f"↑ pedestal, up to {number(highest)} events", transform=axes.transAxes,
            fontsize=9, color=GREY, va="top", zorder=5,
            bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1.5},
        )  # fmt: skip
    return figure


def _styles(groups: Sequence[str | None]) -> list[tuple[str, object, str]]:
    """Colour, line and marker of each histogram."""
    keys = [("", i) if group is None else (group, -1) for i, group in enumerate(groups)]
    order = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    found = []
    for i, key in enumerate(keys):
        # colours that come again have other lines
        place = keys[:i].count(key) + order[key] // len(_COLOURS)
        found.append((_COLOURS[order[key] % len(_COLOURS)], *_LINES[place % len(_LINES)]))
    return found


def _marked(marker: str) -> dict:
    return {"marker": marker, "ms": 3.6, "mfc": "white", "mew": 0.9, "zorder": 3}


def _draw_steps(axes: Axes, histogram: Histogram, colour: str) -> None:
    """Steps, with the square roots of the counts as error bars."""
    photons, counts = histogram.photons, histogram.counts
    half = 0.5 * (photons[1] - photons[0])
    edges = np.append(photons - half, photons[-1] + half)
    axes.stairs(counts, edges, color=colour, lw=1.2, zorder=2)
    axes.stairs(counts, edges, color=colour, fill=True, alpha=0.10, lw=0, zorder=1)
    some = slice(None, None, -(-len(photons) // _MOST_BARS))
    axes.errorbar(
        photons[some], counts[some], yerr=np.sqrt(counts[some]), fmt="none", ecolor=colour,
        elinewidth=0.9, zorder=2,
    )  # fmt: skip


def _draw_peak(axes: Axes, peak: Peak, look: dict) -> None:
    fine = _inside(peak)
    axes.plot(fine, peak.counts_at(fine), **look)
    axes.plot(fine, peak.background_at(fine), color=look["color"], **_BACKGROUND)
    axes.vlines(
        peak.centroid, 0, float(peak.counts_at(np.array(peak.centroid))), color=look["color"],
        lw=1, ls=":", zorder=3,
    )  # fmt: skip


def _inside(peak: Peak) -> np.ndarray:
    return np.linspace(peak.low, peak.high, 300)


def _label(name: str, peak: Peak | None) -> str:
    name = shortened(name, 40)
    if peak is None:
        return f"{name}: no peak stands out"
    return (
        f"{name}: centroid {pdg(peak.centroid, peak.centroid_sigma)}\n"
        f"({peak.shape}, χ² = {number(peak.chi2)}, ndf {peak.ndf})"
    )
