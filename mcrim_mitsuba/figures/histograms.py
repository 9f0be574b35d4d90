"""Histograms of photons per event with their fitted peaks, as in Fig. 2 of the article."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
from mcrim_mitsuba.physics.peak import Peak, fit_peak
from mcrim_mitsuba.physics.rounding import pdg

COLUMNS = (
    "histogram", "photons_per_event", "events", "fitted", "fitted_background", "centroid",
    "centroid_sigma", "width", "chi2", "ndf",
)  # fmt: skip

#: Per histogram, in turn: colour, and the line of its steps.
_STYLES = ((WARM, "-"), (DARK, "-"), (LIGHT, "-"), (GREY, "-"))
_FIT = {"lw": 2.4, "zorder": 4}
_BACKGROUND = {"lw": 1.1, "ls": (0, (4, 2)), "zorder": 3}
#: Error bars at most, in one histogram.
_MOST_BARS = 60
#: Histograms whose legend has room inside.
_MOST_INSIDE = 3
#: Height of the picture over the highest fitted peak: pedestals go out of it.
_ROOM = 1.3


def draw_histograms(
    path: str | Path, histograms: Sequence[tuple[str, Histogram]], *, title: str = ""
) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    histograms : sequence of (str, Histogram)
        Each with its name.
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
    columns, rows = histograms_numbers(histograms)
    figure = histograms_figure(histograms, title=title)
    return save(figure, path), write_numbers(path, columns, rows)


def histograms_numbers(histograms: Sequence[tuple[str, Histogram]]) -> Numbers:
    """Columns and rows of the CSV: a bin a row, with the fit where it was made."""
    rows = []
    for name, histogram in histograms:
        peak = fit_peak(histogram.photons, histogram.counts)
        of_peak = (None,) * 5
        if peak is not None:
            of_peak = (peak.centroid, peak.centroid_sigma, peak.width, peak.chi2, peak.ndf)
        for photons, events in zip(histogram.photons, histogram.counts, strict=True):
            fitted = (None, None)
            if peak is not None and peak.low <= photons <= peak.high:
                fitted = float(peak.counts_at(photons)), float(peak.background_at(photons))
            rows.append((name, float(photons), int(events), *fitted, *of_peak))
    return COLUMNS, rows


@styled
def histograms_figure(histograms: Sequence[tuple[str, Histogram]], *, title: str = "") -> Figure:
    """The figure of `draw_histograms`."""
    figure = canvas(7.2 if len(histograms) <= _MOST_INSIDE else 10.4, 5.0)
    axes = figure.add_subplot()
    handles, tops = [], []
    for i, (name, histogram) in enumerate(histograms):
        colour, style = _STYLES[i % len(_STYLES)]
        peak = fit_peak(histogram.photons, histogram.counts)
        _draw_counts(axes, histogram, colour, style, filled=i % 2 == 0)
        if peak is not None:
            _draw_peak(axes, peak, colour)
            tops.append(float(peak.counts_at(np.array(peak.centroid))))
        else:
            tops.append(float(histogram.counts.max()))
        handles.append(Line2D([], [], color=colour, label=_label(name, peak), **_FIT))
    handles.append(Line2D([], [], color=GREY, label="linear background", **_BACKGROUND))
    top = _ROOM * max(tops, default=1.0)
    highest = max((float(h.counts.max()) for _, h in histograms), default=1.0)
    axes.set_ylim(0, max(top, 1.0) if highest > top else None)
    axes.set_xlim(left=min((float(h.photons[0]) for _, h in histograms), default=0.0))
    axes.set_xlabel("detected photons per event")
    axes.set_ylabel("events per bin")
    axes.set_title(shortened(title, 90), loc="left", fontsize=11, parse_math=False)
    open_axes(axes)
    place = {"loc": "upper right"}
    if len(histograms) > _MOST_INSIDE:
        place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    legend = axes.legend(handles=handles, fontsize=9.5, frameon=False, **place)
    for text in legend.get_texts():
        text.set_parse_math(False)
    if highest > top:
        axes.text(
            0.01, 0.985, f"↑ pedestal, up to {number(highest)} events", transform=axes.transAxes,
            fontsize=9, color=GREY, va="top",
        )  # fmt: skip
    return figure


def _draw_counts(
    axes: Axes, histogram: Histogram, colour: str, style: str, *, filled: bool
) -> None:
    """Steps, with the square roots of the counts as error bars."""
    photons, counts = histogram.photons, histogram.counts
    half = 0.5 * (photons[1] - photons[0])
    edges = np.append(photons - half, photons[-1] + half)
    axes.stairs(counts, edges, color=colour, lw=1.2, ls=style, zorder=2)
    if filled:
        axes.stairs(counts, edges, color=colour, fill=True, alpha=0.12, lw=0, zorder=1)
    some = slice(None, None, -(-len(photons) // _MOST_BARS))
    axes.errorbar(
        photons[some], counts[some], yerr=np.sqrt(counts[some]), fmt="none", ecolor=colour,
        elinewidth=0.9, zorder=2,
    )  # fmt: skip


def _draw_peak(axes: Axes, peak: Peak, colour: str) -> None:
    fine = np.linspace(peak.low, peak.high, 300)
    axes.plot(fine, peak.counts_at(fine), color=colour, **_FIT)
    axes.plot(fine, peak.background_at(fine), color=colour, **_BACKGROUND)
    axes.vlines(
        peak.centroid, 0, float(peak.counts_at(np.array(peak.centroid))), color=colour, lw=1,
        ls=":", zorder=3,
    )  # fmt: skip


def _label(name: str, peak: Peak | None) -> str:
    name = shortened(name, 40)
    if peak is None:
        return f"{name}: no peak stands out"
    return (
        f"{name}: centroid {pdg(peak.centroid, peak.centroid_sigma)}\n"
        f"(χ² = {number(peak.chi2)}, ndf {peak.ndf})"
    )
