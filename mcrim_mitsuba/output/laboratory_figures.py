"""Figures of raw data: histograms as in Fig. 2 of the article, spectra, transmittances."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mcrim_mitsuba.campaign.reduction import Mounting, RawData
from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.core.rounding import number, pdg
from mcrim_mitsuba.laboratory.calibration import CalibratedHistogram
from mcrim_mitsuba.laboratory.energy_scale import Line, intrinsic_width
from mcrim_mitsuba.laboratory.histogram import Histogram
from mcrim_mitsuba.laboratory.light_yield import SCALE, DetectorEfficiency
from mcrim_mitsuba.laboratory.peak import Peak
from mcrim_mitsuba.laboratory.peak_band import Width, WidthParts
from mcrim_mitsuba.optics.absorption import Absorption, Index
from mcrim_mitsuba.optics.slab_transmittance import clear_limit
from mcrim_mitsuba.optics.spectrum import Spectrum, common_grid
from mcrim_mitsuba.output import figure_style as style

#: Of each group in turn; histograms of one group differ in their lines and markers.
_COLOURS = (style.WARM, style.DARK, style.LIGHT, style.GREY)
_LINES = (("-", "o"), ((0, (6, 1.6)), "^"), ((0, (1.6, 1.2)), "s"), ((0, (6, 1.6, 1.4, 1.6)), "D"))
_BACKGROUND: dict[str, Any] = {"lw": 0.9, "ls": (0, (4, 2)), "zorder": 3}
#: Error bars at most, in one histogram.
_MOST_BARS = 60
#: Histograms with steps and error bars, beyond which each has markers.
_MOST_STEPS = 2
#: Histograms whose legend has room inside.
_MOST_INSIDE = 3
#: Height of the picture over the highest fitted peak: pedestals go out of it.
_HISTOGRAM_ROOM = 1.3


class FittedHistogram(NamedTuple):
    """A histogram with its name, its peak, and what it is a measurement of.

    Histograms of one group, such as the mountings of one configuration, share a colour; without
    a group, each has its own.
    """

    name: str
    histogram: Histogram
    peak: Peak | None
    group: str | None = None


def _histograms_numbers(fitted: Sequence[FittedHistogram]) -> style.Numbers:
    """A bin a row, with the fit where it was made, and in every row its peak."""
    of_peak = "shape centroid centroid_sigma width chi2 ndf".split()
    rows: list[Sequence[object]] = []
    columns = [*"histogram photons_per_event events fitted fitted_background".split(), *of_peak]
    for name, histogram, peak, _ in fitted:
        fit, background = np.full((2, len(histogram.photons)), np.nan)
        if peak is not None:
            inside = (histogram.photons >= peak.low) & (histogram.photons <= peak.high)
            fit[inside] = peak.counts_at(histogram.photons[inside])
            background[inside] = peak.background_at(histogram.photons[inside])
        counts = histogram.counts
        if np.array_equal(counts, np.floor(counts)):
            counts = counts.astype(int)
        cells = (name, histogram.photons, counts, fit, background)
        of_fit = (getattr(peak, field, None) for field in of_peak)
        rows += style.numbers_in(dict(zip(columns, (*cells, *of_fit), strict=True)))[1]
    return columns, rows


@style.styled
def draw_histograms(fitted: Sequence[FittedHistogram], *, title: str = "") -> style.Drawing:
    """Histograms of photons per event with their peaks; higher pedestals go out of the picture."""
    figure, axes = style.axes_of(7.2 if len(fitted) <= _MOST_INSIDE else 10.4, 5.0)
    handles: list[Artist] = []
    tops = []
    styles = _styles([entry.group for entry in fitted])
    few = len(fitted) <= _MOST_STEPS
    for (name, histogram, peak, _), (colour, line, marker) in zip(fitted, styles, strict=True):
        look: dict[str, Any] = {"color": colour, "ls": line, "lw": 2.2 if few else 1.5, "zorder": 4}
        mark: dict[str, Any] = {}
        if few:
            _draw_steps(axes, histogram, colour)
        else:
            mark = {"marker": marker, "ms": 3.6, "mfc": "white", "mew": 0.9, "zorder": 3}
            axes.plot(histogram.photons, histogram.counts, color=colour, **mark, ls="")
        if peak is not None:
            fine = np.linspace(peak.low, peak.high, 300)
            counts = peak.counts_at(fine)
            axes.plot(fine, counts, **look)
            # windows of several lie on each other: together as dark as one
            axes.axvspan(peak.low, peak.high, color=colour, alpha=0.12 / len(fitted), lw=0)
            axes.plot(fine, peak.background_at(fine), color=colour, **_BACKGROUND)
            height = float(peak.counts_at(np.array(peak.centroid)))
            axes.vlines(peak.centroid, 0, height, color=colour, lw=1, ls=":", zorder=3)
            tops.append(float(counts.max()))
        else:
            tops.append(float(histogram.counts.max()))
        handles.append(Line2D([], [], label=_label(name, peak), **look | mark))
    if any(entry.peak is not None for entry in fitted):
        handles.append(Line2D([], [], color=style.GREY, label="background", **_BACKGROUND))
        handles.append(Patch(color=style.PALE, label="window of the fit"))
    top = _HISTOGRAM_ROOM * max(tops, default=1.0)
    highest = max((float(entry.histogram.counts.max()) for entry in fitted), default=1.0)
    # without events a peak's height may be 0
    # what is left of a subtracted background may lie below 0
    lowest = min((float(entry.histogram.counts.min()) for entry in fitted), default=0.0)
    axes.set_ylim(max(min(lowest, 0.0), -0.2 * top), max(top, 1.0) if highest > top else None)
    axes.set_xlim(left=min((float(entry.histogram.photons[0]) for entry in fitted), default=0.0))
    axes.set(xlabel="detected photons per event", ylabel="events per bin")
    axes.set_title(style.shortened(title, 90), loc="left", fontsize=11, parse_math=False)
    outside = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    place: dict[str, Any] = outside if len(fitted) > _MOST_INSIDE else {"loc": "upper right"}
    style.legend(axes, handles, handlelength=2.6, **place)
    if highest > top:
        look = {"transform": axes.transAxes, "fontsize": 9, "color": style.GREY, "va": "top"}
        words = f"↑ up to {number(highest)} events"
        axes.text(0.015, 0.985, words, zorder=5, bbox=style.paper(0.8, 1.5), **look)
    return style.Drawing(figure, *_histograms_numbers(fitted))


def _styles(groups: Sequence[str | None]) -> list[tuple[str, object, str]]:
    """Colour, line and marker of each histogram: a colour for each group, lines within it."""
    # a histogram without a group is one by itself
    keys = [("", i) if group is None else (group, -1) for i, group in enumerate(groups)]
    distinct, styles = list(dict.fromkeys(keys)), []
    for i, key in enumerate(keys):
        # colours that come again begin with another line
        again, colour = divmod(distinct.index(key), len(_COLOURS))
        styles.append((_COLOURS[colour], *_LINES[(keys[:i].count(key) + again) % len(_LINES)]))
    return styles


def _draw_steps(axes: Axes, histogram: Histogram, colour: str) -> None:
    """Steps, with the standard errors of the counts as error bars."""
    photons, counts, edges = histogram.photons, histogram.counts, _edges(histogram.photons)
    variances = counts
    if isinstance(histogram, CalibratedHistogram) and histogram.variances is not None:
        variances = histogram.variances
    axes.stairs(counts, edges, color=colour, lw=1.2, zorder=2)
    axes.stairs(counts, edges, color=colour, fill=True, alpha=0.10, lw=0, zorder=1)
    some = slice(None, None, -(-len(photons) // _MOST_BARS))
    look: dict[str, Any] = {"fmt": "none", "ecolor": colour, "elinewidth": 0.9, "zorder": 2}
    axes.errorbar(photons[some], counts[some], yerr=np.sqrt(variances[some]), **look)


def _label(name: str, peak: Peak | None) -> str:
    """What a histogram is called, and its peak in numbers."""
    name = style.shortened(name, 40)
    if peak is None:
        return f"{name}: no peak stands out"
    fit = f"({peak.shape}, χ² = {number(peak.chi2)}, ndf {peak.ndf})"
    return f"{name}: centroid {pdg(peak.centroid, peak.centroid_sigma)}\n{fit}"


# From channels to photoelectrons: single photoelectrons, pedestals, the background.

#: What is drawn of a spectrum: its label, places (channels or photoelectrons) and events.
_Curve = tuple[str, np.ndarray, np.ndarray]
_SINGLE = "single photoelectrons"
_PEDESTAL = "pedestal"
_BACKGROUND_STEP = "background"
#: Spectra whose pedestals are drawn, at most, and widths of the noise around them.
_MOST_PEDESTALS = 8
_PEDESTAL_WIDTHS = 8.0


@style.styled
def draw_calibration(histograms: Sequence[Histogram]) -> style.Drawing:
    """What calibrates histograms in channels: a panel for each step that there is."""
    calibrated = [h for h in histograms if isinstance(h, CalibratedHistogram)]
    first, calibration = calibrated[0], calibrated[0].calibration
    #: Curves of every step by its name and its unit; pedestals have the height 1.
    steps: dict[tuple[str, str], list[_Curve]] = {}
    gain, pedestal, run = calibration.gain, calibration.pedestal, calibration.pedestal_run
    if gain.spectrum is not None and gain.fit is not None:
        filled = np.flatnonzero(gain.spectrum.counts)
        inside = slice(filled[0], filled[-1] + 1)
        channels, counts = gain.spectrum.channels[inside], gain.spectrum.counts[inside]
        curves = [(gain.spectrum.path.name, channels, counts)]
        if gain.fit.spread is not None:
            words = f"{pdg(gain.value, gain.sigma)} channels per photoelectron"
            curves.append((words, channels, np.diff(gain.fit.counts_below(_edges(channels)))))
        steps[_SINGLE, "channel"] = curves
    runs = [(h.spectrum, h.pedestal) for h in calibrated[:_MOST_PEDESTALS]]
    if run is not None and pedestal is not None:
        runs = [(run, pedestal)]
    curves = []
    for spectrum, at in runs:
        reach = _PEDESTAL_WIDTHS * max(at.width or 0.0, 1.0)
        near = np.abs(spectrum.channels - at.position) < reach
        events = spectrum.counts[near] / max(float(spectrum.counts[near].max(initial=0.0)), 1.0)
        words = f"{spectrum.path.name}: {pdg(at.position, at.sigma or None)}"
        curves.append((words, spectrum.channels[near], events))
    steps[_PEDESTAL, "channel"] = curves
    if first.background is not None:
        whole = (first.path.name, first.photons, first.counts + first.background)
        under = ("background in its live time", first.photons, first.background)
        difference = ("difference", first.photons, first.counts)
        steps[_BACKGROUND_STEP, "photoelectrons"] = [whole, under, difference]
    figure, panels = style.axes_of(7.2, 0.6 + 3.2 * len(steps), len(steps), squeeze=False)
    rows: list[Sequence[object]] = []
    for axes, ((step, unit), curves) in zip(panels[:, 0], steps.items(), strict=True):
        for (name, places, events), colour in zip(curves, itertools.cycle(_COLOURS), strict=False):
            axes.stairs(events, _edges(places), color=colour, label=name)
            rows += [(step, name, *row) for row in zip(places, events, strict=True)]
        places, events = curves[0][1:]
        # pedestals go out of the picture of what is subtracted
        top = 1.4 * float(events[places > 0.1 * places[-1]].max(initial=1.0))
        if step == _SINGLE:
            axes.set(yscale="log", ylim=(0.5, 4.0 * float(events.max())))
        elif step == _BACKGROUND_STEP:
            axes.set(ylim=(min(0.0, float(curves[-1][2].min())), top), xlim=(0.0, places[-1]))
        axes.set(xlabel=unit, ylabel="events, highest 1" if step == _PEDESTAL else "events")
        axes.set_title(step, loc="left", fontsize=11)
        style.legend(axes, loc="upper right")
    return style.Drawing(figure, "step spectrum place events".split(), rows)


def _edges(centres: np.ndarray) -> np.ndarray:
    """Edges of bins of one width."""
    half = 0.5 * (centres[1] - centres[0])
    return np.append(centres - half, centres[-1] + half)


# Spectra behind the detector's efficiency and the crystal's absorption.


#: Per spectrum, in turn: colour and line.
_STYLES = ((style.WARM, "-"), (style.DARK, "--"), (style.LIGHT, "-"), (style.GREY, "-."))
_EMISSION = "#e8c15a"
_DASHED: dict[str, Any] = {"color": style.GREY, "lw": 1.4, "ls": (0, (5, 2)), "zorder": 3}
#: Room over the highest curve, for the legend.
_SPECTRUM_ROOM = 1.35
#: Of its maximum: where an emission is seen to begin and end.
_SEEN = 0.002


def _efficiency_numbers(efficiency: DetectorEfficiency) -> style.Numbers:
    """Both curves at the points of both, as far as both go; the emission's maximum is 1.

    Errors stand at a curve's own points.
    """
    emission, detector = efficiency.emission, efficiency.quantum_efficiency
    grid = common_grid(emission, detector)

    def own_sigmas(curve: Spectrum, factor: float) -> np.ndarray:
        sigmas = np.full(grid.shape, np.nan)
        if curve.sigmas is not None:
            _, places, of_curve = np.intersect1d(grid, curve.wavelength_nm, return_indices=True)
            sigmas[places] = curve.sigmas[of_curve] / factor
        return sigmas

    highest = float(emission.values.max())
    light, quantum_efficiency = emission.at(grid) / highest, detector.at(grid)
    columns = {"wavelength_nm": grid}
    columns |= {"emission": light, "emission_sigma": own_sigmas(emission, highest)}
    columns |= {"quantum_efficiency": quantum_efficiency}
    columns |= {"quantum_efficiency_sigma": own_sigmas(detector, 1.0)}
    columns |= {"product": light * quantum_efficiency}
    mean = {"weighted_mean": efficiency.value, "weighted_mean_sigma": efficiency.sigma}
    return style.numbers_in(columns | mean)


@style.styled
def draw_efficiency(efficiency: DetectorEfficiency) -> style.Drawing:
    """Emission, quantum efficiency and their weighted mean, by Eq. 3 of the article."""
    figure, axes = style.axes_of(7.2, 4.8)
    emission, curve = efficiency.emission, efficiency.quantum_efficiency
    low, high = _seen(emission)
    shown = (curve.wavelength_nm >= low) & (curve.wavelength_nm <= high)
    ends = curve.at(np.clip((low, high), curve.first_nm, curve.last_nm))
    top = 100 * float(max(curve.values[shown].max(initial=0), efficiency.value, *ends))
    axes.set(ylim=(0, _SPECTRUM_ROOM * top), xlim=(low, high))
    _shade_emission(axes, emission, 0.0, top, "emission, relative")
    # errors of the points, and the one of the tube's scale that they share
    scale_sigma = efficiency.contributions[SCALE] / efficiency.value
    sigmas = np.zeros_like(curve.values) if curve.sigmas is None else curve.sigmas
    band = 100 * np.hypot(sigmas, scale_sigma * curve.values)
    nm, percent = curve.wavelength_nm, 100 * curve.values
    style.band(axes, nm, percent, band, color=style.DARK, alpha=0.15, zorder=3)
    look: dict[str, Any] = {"color": style.DARK, "lw": 2, "ms": 4, "zorder": 4}
    look["marker"] = "o" if np.count_nonzero(shown) <= 40 else ""
    axes.plot(nm, percent, label="quantum efficiency ± error", **look)
    grid = common_grid(emission, curve)
    product = 100 * curve.at(grid) * emission.at(grid) / emission.values.max()
    look = {"color": style.WARM, "lw": 1.8, "zorder": 4}
    axes.plot(grid, product, label="emission × quantum efficiency", **look)
    mean, sigma = 100 * efficiency.value, 100 * efficiency.sigma
    axes.axhspan(mean - sigma, mean + sigma, color=style.GREY, alpha=0.15, lw=0, zorder=2)
    axes.axhline(mean, label=f"weighted mean {pdg(mean, sigma)} %", **_DASHED)
    axes.set(xlabel="wavelength, nm", ylabel="quantum efficiency, %")
    style.legend(axes, loc="upper center", ncols=2)
    return style.Drawing(figure, *_efficiency_numbers(efficiency))


def _absorption_numbers(absorption: Absorption) -> style.Numbers:
    """A row for each point of each spectrum: transmittance, a clear sample's, coefficient."""
    columns = (
        "spectrum wavelength_nm transmittance transmittance_sigma clear_limit "
        "alpha_per_cm alpha_sigma_per_cm alpha_abs_per_cm alpha_abs_sigma_per_cm"
    ).split()
    rows: list[Sequence[object]] = []
    for measured, curve in zip(absorption.spectra, absorption.curves, strict=True):
        nm = curve.wavelength_nm
        transmittance = (measured.at(nm), [measured.sigma_at(float(place)) for place in nm])
        alphas = (curve.values, curve.sigmas, absorption.alpha_abs_per_cm, absorption.sigma)
        limit = _limits(absorption.index, nm)
        cells = (Path(measured.name).name, nm, *transmittance, limit, *alphas)
        rows += style.numbers_in(dict(zip(columns, cells, strict=True)))[1]
    return columns, rows


@style.styled
def draw_absorption(absorption: Absorption) -> style.Drawing:
    """Transmittances, and the coefficient that they give."""
    emission = absorption.emission
    figure, (above, below) = style.axes_of(7.2, 6.4, 2, sharex=True)
    low = min(curve.first_nm for curve in absorption.curves)
    high = max(curve.last_nm for curve in absorption.curves)
    if emission is not None:
        low, high = max(low, _seen(emission)[0]), min(high, _seen(emission)[1])
    seen_t, seen_alpha = [], []  # what the axes have to hold
    pairs = zip(absorption.spectra, absorption.curves, strict=True)
    for (measured, curve), (colour, line) in zip(pairs, itertools.cycle(_STYLES), strict=False):
        look = {"color": colour, "ls": line, "lw": 1.6, "zorder": 4}
        inside = (curve.wavelength_nm >= low) & (curve.wavelength_nm <= high)
        percent = 100 * measured.at(curve.wavelength_nm)
        label = style.shortened(Path(measured.name).name, 28)
        above.plot(curve.wavelength_nm, percent, label=label, **look)
        below.plot(curve.wavelength_nm, curve.values, **look)
        if curve.sigmas is not None:
            pale = {"color": colour, "alpha": 0.12, "zorder": 3}
            style.band(below, curve.wavelength_nm, curve.values, curve.sigmas, **pale)
        seen_t += percent[inside].tolist()
        seen_alpha += curve.values[inside].tolist()
    fine = np.linspace(low, high, 200)
    limits = 100 * _limits(absorption.index, fine)
    above.plot(fine, limits, label="a sample that absorbs nothing", **_DASHED)
    alpha, sigma = absorption.alpha_abs_per_cm, absorption.sigma
    below.axhspan(alpha - sigma, alpha + sigma, color=style.GREY, alpha=0.18, lw=0, zorder=2)
    label = f"coefficient {pdg(alpha, sigma or None)} /cm"
    below.axhline(alpha, color=style.GREY, lw=1.4, zorder=2, label=label)
    _frame(above, [*seen_t, *limits.tolist()], low, high)
    _frame(below, [*seen_alpha, alpha - sigma, alpha + sigma, 0.0], low, high)
    if emission is not None:
        for axes in (above, below):
            bottom, top = axes.get_ylim()
            _shade_emission(axes, emission, bottom, 0.6 * top + 0.4 * bottom, "light, relative")
    above.set_ylabel("measured transmittance, %")
    below.set(ylabel="absorption coefficient, 1/cm", xlabel="wavelength, nm")
    for axes in (above, below):
        style.legend(axes, loc="upper center", ncols=2)
    return style.Drawing(figure, *_absorption_numbers(absorption))


def _frame(axes: Axes, values: Sequence[float], low: float, high: float) -> None:
    """Axes that hold values, with room for a legend over them."""
    least, most = min(values), max(values)
    height = (most - least) or 1.0
    axes.set(ylim=(least - 0.08 * height, most + 0.45 * height), xlim=(low, high))


def _shade_emission(axes: Axes, emission: Spectrum, bottom: float, top: float, label: str) -> None:
    """The emission behind the curves, its maximum at the height `top`."""
    heights = bottom + (top - bottom) * np.maximum(emission.values, 0) / emission.values.max()
    look: dict[str, Any] = {"color": _EMISSION, "alpha": 0.45, "lw": 0, "zorder": 1}
    axes.fill_between(emission.wavelength_nm, bottom, heights, label=label, **look)


def _seen(emission: Spectrum) -> tuple[float, float]:
    """Wavelengths (nm) at which an emission begins and ends: a point beyond what can be seen."""
    seen = np.flatnonzero(emission.values > _SEEN * emission.values.max())
    first, last = max(seen[0] - 1, 0), min(seen[-1] + 1, emission.values.size - 1)
    return float(emission.wavelength_nm[first]), float(emission.wavelength_nm[last])


def _limits(n: Index, wavelength_nm: np.ndarray) -> np.ndarray:
    """Transmittance of a sample that absorbs nothing."""
    return clear_limit(n(wavelength_nm) if callable(n) else np.full(wavelength_nm.shape, n))


# All that a campaign's raw data give.

#: Histograms that one picture can show.
MOST_HISTOGRAMS = 8


def draw_raw_data(raw: RawData, kind: str) -> style.Drawing:
    """A campaign's raw data of one kind, as `RawData.kinds` names it.

    Of too many histograms, the first mounting of every reading; the numbers are those of all.
    """
    if kind == "spectra":
        assert raw.efficiency is not None
        return draw_efficiency(raw.efficiency)
    if kind == "calibration":
        return draw_calibration([m.histogram for r in raw.readings.values() for m in r.mountings])
    if kind == "transmittance":
        assert raw.absorption is not None
        return draw_absorption(raw.absorption)
    readings = raw.readings.items()
    histograms = [_fitted(label, m) for label, reading in readings for m in reading.mountings]
    shown = histograms
    if len(histograms) > MOST_HISTOGRAMS:
        shown = [_fitted(label, reading.mountings[0]) for label, reading in raw.readings.items()]
    figure = draw_histograms(shown[:MOST_HISTOGRAMS]).figure
    return style.Drawing(figure, *_histograms_numbers(histograms))


def _fitted(label: str, mounting: Mounting) -> FittedHistogram:
    name = mounting.file.name + ("" if mounting.row.use else " (not used)")
    return FittedHistogram(name, mounting.histogram, mounting.peak, label)


@style.styled
def draw_lines(lines: Mapping[str, Sequence[Line]]) -> style.Drawing:
    """Light per energy over that of the highest line, and widths against the light."""
    figure, (left, right) = style.axes_of(9.6, 4.4, 1, 2)
    rows: list[Sequence[object]] = []
    for (name, of_file), colour in zip(lines.items(), itertools.cycle(_COLOURS), strict=False):
        look: dict[str, Any] = {"color": colour, "fmt": "o", "label": style.shortened(name, 26)}
        names = (
            "energy_keV peak.centroid relative relative_sigma width.total.fwhm width.total.sigma"
        )
        cells = np.array(list(map(attrgetter(*names.split()), of_file)))
        energies, counts, relative, errors, fwhm, sigma = cells.T
        left.errorbar(energies, relative, errors, **look)
        right.errorbar(counts**-0.5, 100 * fwhm, 100 * sigma, **look)
        rows += [(name, *row) for row in cells.tolist()]
        if (fit := intrinsic_width(of_file)) is not None:
            fine = np.linspace(0.0, 1.1 * float((counts**-0.5).max()), 100)
            squares = fit[0].fwhm ** 2 + (FWHM * fine) ** 2 * fit[1]
            words = f"intrinsic {100 * fit[0].fwhm:.2g} %, {fit[1]:.3g} / N"
            right.plot(fine, 100 * np.sqrt(np.maximum(squares, 0)), color=colour, label=words)
    left.set(xscale="log", xlabel="energy, keV", ylabel="photons per keV, highest line 1")
    right.set(xlabel="1 / √N of N photons", ylabel="full width at half maximum, %")
    right.set_xlim(left=0.0)
    right.set_ylim(bottom=0.0)
    for axes in (left, right):
        style.legend(axes)
    columns = "histogram energy_keV photons relative relative_sigma fwhm fwhm_sigma".split()
    return style.Drawing(figure, columns, rows)


# Widths of peaks by their origins: a bar for every peak and every place where gammas stop.

#: Of each part: its name and words, and its colours and those of words on it.
_OF_WIDTHS = {
    "counting": ("counted photoelectrons", style.DARK, "white"),
    "place": ("where gammas stop", style.LIGHT, "black"),
    "rest": ("rest: crystal, tube, electronics", "0.78", "black"),
}
#: Per cent of the variance below which a part has no number in it.
_NARROW = 9.0


@style.styled
def draw_widths(widths: Mapping[str, Sequence[WidthParts]]) -> style.Drawing:
    """A bar for each histogram and place where gammas stop: shares of the variance, which add."""
    rows = [(name, parts) for name, by_place in widths.items() for parts in by_place]
    figure, axes = style.axes_of(9.6, 1.5 + 0.55 * len(rows), lines="x")
    longest = 100.0
    for row, (_, parts) in enumerate(rows):
        left = 0.0
        for origin, (_, fill, text_colour) in _OF_WIDTHS.items():
            width: Width = getattr(parts, origin)
            percent = 100.0 * (width.fwhm / parts.total.fwhm) ** 2
            axes.barh(row, percent, 0.62, left, color=fill, edgecolor="#222222", lw=0.8)
            if percent >= _NARROW:
                words, middle = f"{100.0 * width.fwhm:.2g} %", left + percent / 2
                style.text_in_bar(axes, words, (middle, row), color=text_colour)
            left += percent
        # parts that are too wide for the peak reach beyond its 100 %
        longest = max(longest, left)
    names = [
        f"{style.shortened(name, 26)}, FWHM {100 * parts.total.fwhm:.2g} %\n"
        f"{style.shortened(parts.source)}: {100 * parts.place.fwhm:.2g} %"
        for name, parts in rows
    ]
    style.rows_of_bars(axes, names, parse_math=False, fontsize=9.5)
    axes.set(xlim=(0.0, longest), xlabel="share of the peak's variance (%)")
    looks = _OF_WIDTHS.values()
    handles = [Patch(fc=fill, ec="#222222", lw=0.8, label=words) for words, fill, _ in looks]
    style.legend_of(figure, handles, "upper center", 3, handlelength=1.8)
    columns, table = ["histogram", "gammas_stop"], [[name, parts.source] for name, parts in rows]
    for origin in ("total", *_OF_WIDTHS):
        columns += [f"{origin}_fwhm", f"{origin}_fwhm_sigma"]
        for cells, (_, parts) in zip(table, rows, strict=True):
            cells += [getattr(parts, origin).fwhm, getattr(parts, origin).sigma]
    return style.Drawing(figure, columns, table)
