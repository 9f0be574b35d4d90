"""Light in pictures: where it arrives, which fates it meets, eta over a table's axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import FWHM, Value, said, titled
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.efficiency.arrival_times import ArrivalTimes
from mcrim_mitsuba.efficiency.eta_spectrum import EtaSpectrum
from mcrim_mitsuba.efficiency.lighting import EtaMap, Light, Spread
from mcrim_mitsuba.efficiency.table import EtaTable
from mcrim_mitsuba.output import figure_style as style

#: Configurations that have room.
MOST_CONFIGURATIONS = 4
#: Configurations with their names.
Lights = Sequence[tuple[str, Light]]


_COLOURS = (style.DARK, style.WARM, style.LIGHT, style.GREY)
_LINES = ("-", (0, (5, 1.6)), (0, (5, 1.4, 1.2, 1.4)), (0, (1.4, 1.4)))
_HALO = [patheffects.withStroke(linewidth=2.8, foreground="black", alpha=0.8)]
_OVER_MAP: dict[str, Any] = {"color": "white", "lw": 1.3, "path_effects": _HALO}
_LAW = (0, (1, 1.5))
_LIMIT: dict[str, Any] = {"color": style.GREY, "lw": 0.9, "ls": (0, (8, 4))}
_MASK_DASHES = (0, (3.0, 1.6))
#: Axes show light in thousandths of what is emitted.
_UNIT = 1e3


def _arrival_numbers(lights: Lights) -> style.Numbers:
    """A row for each bin of maps, radii and angles; light is a fraction of what is emitted."""
    columns = (
        "configuration part x_low_mm x_high_mm y_low_mm y_high_mm radius_low_mm "
        "radius_high_mm angle_low_deg angle_high_deg light light_sigma area_mm2 "
        "light_per_mm2 light_per_mm2_sigma light_per_degree light_per_degree_sigma"
    ).split()
    rows: list[Sequence[object]] = []
    for name, light in lights:
        map_edges = {"y_{}_mm": light.y_edges_mm, "x_{}_mm": light.x_edges_mm}
        for part, binned, unit, edges in (
            ("map", light.map, "mm2", map_edges),
            ("radius", light.radius, "mm2", {"radius_{}_mm": light.radius_edges_mm}),
            ("angle", light.angle, "degree", {"angle_{}_deg": light.angle_edges_deg}),
        ):
            cells = {"light": binned.light, "light_sigma": binned.sigma}
            cells |= {f"light_per_{unit}": binned.density}
            cells |= {f"light_per_{unit}_sigma": binned.density_sigma}
            cells |= {"area_mm2": binned.size} if unit == "mm2" else {}
            for end, borders in (("low", slice(None, -1)), ("high", slice(1, None))):
                names = (column.format(end) for column in edges)
                grid = np.meshgrid(*(edge[borders] for edge in edges.values()), indexing="ij")
                cells |= dict(zip(names, grid, strict=True))
            flat = {column: np.ravel(values) for column, values in cells.items()}
            of_bins = {"configuration": name, "part": part, **flat}
            rows += style.numbers_in({column: of_bins.get(column) for column in columns})[1]
    return columns, rows


@style.styled
def draw_arrival(lights: Lights) -> style.Drawing:
    """Where and under which angle light reaches the detector, for 1 to `MOST_CONFIGURATIONS`.

    A map for each configuration, then the light over the radius and over the angle: in one line for
    one configuration, else below the maps. Raises ValueError for too many configurations or none.
    """
    if not 1 <= len(lights) <= MOST_CONFIGURATIONS:
        raise ValueError(f"{len(lights)} configurations; give 1 to {MOST_CONFIGURATIONS}")
    if len(lights) == 1:
        figure = style.canvas(14.8, 4.9)
        figure.set_layout_engine("constrained", wspace=0.05)
        grid = figure.add_gridspec(1, 3, width_ratios=(1.12, 1.0, 1.0))
        maps, radial, angular = [grid[0]], *(figure.add_subplot(grid[i]) for i in (1, 2))
    else:
        figure = style.canvas(1.4 + 3.6 * max(len(lights), 2.5), 8.8)
        grid = figure.add_gridspec(2, 2 * len(lights), height_ratios=(1.0, 0.95))
        maps = [grid[0, 2 * i : 2 * i + 2] for i in range(len(lights))]
        radial = figure.add_subplot(grid[1, : len(lights)])
        angular = figure.add_subplot(grid[1, len(lights) :])
    _draw_maps(figure, maps, lights)
    for (name, light), colour, dashes in zip(lights, _COLOURS, _LINES, strict=False):
        look: dict[str, Any] = {"color": colour, "ls": dashes, "label": style.in_lines(name)}
        for axes, edges, binned in (
            (radial, light.radius_edges_mm, light.radius),
            (angular, light.angle_edges_deg, light.angle),
        ):
            density, sigma = _UNIT * binned.density, _UNIT * binned.density_sigma
            _draw_steps(axes, edges, density, sigma, baseline=None, **look)
        # as much light by Lambert's law, up to the largest angle that refraction gives
        most = light.largest_angle_deg or 90.0
        angle = np.linspace(0.0, most, 181)
        # per radian sin(2 a) / sin(most)^2, whose integral is 1
        law = np.sin(2 * np.radians(angle)) / np.sin(np.radians(most)) ** 2 * np.radians(1.0)
        angular.plot(angle, _UNIT * light.eta * law, color=colour, lw=1.0, ls=_LAW)
    ends = []
    for _, light in lights:
        # where next to no light arrives beyond, and a bin more
        inside = np.cumsum(light.radius.light) < 0.9999 * light.radius.light.sum()
        ends.append(light.radius_edges_mm[1:][min(inside.sum() + 1, len(inside) - 1)])
    radial.set_xlabel("distance from the detector's centre (mm)")
    radial.set_ylabel("detected light\n(10⁻³ of the emitted light per mm²)")
    radial.set(xlim=(0, max(ends)), ylim=(0, None))
    style.open_axes(radial)
    style.legend_above(radial, ncols=2 if len(lights) > 2 else 1, handlelength=2.6)
    angular.set_xlabel("angle to the detector's normal, in the window (°)")
    angular.set_ylabel("detected light\n(10⁻³ of the emitted light per degree)")
    angular.set(xlim=(0, 90), xticks=range(0, 91, 15), ylim=(0, None))
    style.open_axes(angular)
    label = "as much light by Lambert's law"
    handles = [Line2D([], [], color=style.GREY, lw=1.0, ls=_LAW, label=label)]
    largest = sorted({round(x.largest_angle_deg, 1) for _, x in lights if x.largest_angle_deg})
    for degrees in largest:
        angular.axvline(degrees, **_LIMIT)
    if largest:
        words = " and ".join(f"{degrees:g}°" for degrees in largest)
        handles.append(Line2D([], [], label=f"largest angle after refraction: {words}", **_LIMIT))
    style.legend_above(angular, handles, ncols=1, handlelength=2.6)
    return style.Drawing(figure, *_arrival_numbers(lights))


def _draw_maps(figure: Figure, places: Sequence[Any], lights: Lights) -> None:
    """Maps at these places of a grid, with one scale of colours."""
    # the brightest cells may be chance: the scale ends at what few exceed
    brightest = max(_UNIT * np.nanpercentile(light.map.density, 99.5) for _, light in lights)
    # as a photograph does: what is dim beside the crystal is seen as well
    norm = PowerNorm(0.5, 0.0, brightest or 1.0)
    all_axes = [figure.add_subplot(place) for place in places]
    for axes, (name, light) in zip(all_axes, lights, strict=True):
        look: dict[str, Any] = {"norm": norm, "cmap": "cividis", "rasterized": True}
        density = _UNIT * light.map.density
        mesh = axes.pcolormesh(light.x_edges_mm, light.y_edges_mm, density, **look)
        if light.crystal_mm is not None:
            axes.plot(*light.crystal_mm.T, **_OVER_MAP)
        for x, y, radius in light.masks_mm:
            axes.add_patch(Circle((x, y), radius, fill=False, ls=_MASK_DASHES, **_OVER_MAP))
        limits = {"xlim": light.x_edges_mm[[0, -1]], "ylim": light.y_edges_mm[[0, -1]]}
        axes.set(aspect="equal", xlabel="x on the detector (mm)", **limits)
        title = f"{style.in_lines(name)}\nη = {pdg(light.eta, light.eta_sigma)}"
        axes.set_title(title, fontsize=11, parse_math=False)
    all_axes[0].set_ylabel("y on the detector (mm)")
    for axes in all_axes[1:]:
        axes.tick_params(labelleft=False)
    bar = figure.colorbar(mesh, ax=all_axes, extend="max", pad=0.02, aspect=24)
    bar.set_label("detected light\n(10⁻³ of the emitted light per mm²)")
    handles: list[Artist] = []
    if any(light.crystal_mm is not None for _, light in lights):
        handles.append(Line2D([], [], label="outline of the crystal", **_OVER_MAP))
    if any(light.masks_mm for _, light in lights):
        handles.append(Line2D([], [], label="hole of the mask", ls=_MASK_DASHES, **_OVER_MAP))
    if handles:
        style.legend_of(figure, handles, "upper left", 2, fontsize=10)


def _draw_steps(
    axes: Axes, edges: np.ndarray, values: np.ndarray, sigma: np.ndarray, **look: Any
) -> None:
    """Values in bins as steps, with a band of one standard error."""
    axes.stairs(values, edges, lw=1.6, **look)
    # a point for each edge: the last bin's ends its step
    low, high = (np.append(side, side[-1]) for side in (values - sigma, values + sigma))
    axes.fill_between(edges, low, high, step="post", color=look["color"], alpha=0.25, lw=0)


# Where light is born: slices of a map, and how eta is spread over where gammas stop.

#: Horizontal slices that are shown.
_SLICES = 3


@style.styled
def draw_map(mapped: EtaMap, spreads: Sequence[Spread]) -> style.Drawing:
    """Three horizontal slices, one upright, eta over the height, and its distributions."""
    figure = style.canvas(11.0, 6.9)
    grid = figure.add_gridspec(2, 6, height_ratios=(1.0, 1.12))
    x, y, z = mapped.edges_mm
    shown = 100.0 * mapped.eta
    look: dict[str, Any] = {"vmin": np.nanmin(shown), "vmax": np.nanmax(shown)}
    look |= {"cmap": "cividis", "rasterized": True}
    flat = []
    # the highest slice, one in the middle and the lowest: z are borders, one more than slices
    for place, k in enumerate(np.linspace(len(z) - 2, 0, _SLICES).round().astype(int)):
        axes = figure.add_subplot(grid[0, 2 * place : 2 * place + 2])
        mesh = axes.pcolormesh(x, y, shown[:, :, k].T, **look)
        axes.set_title(f"z from {z[k]:.3g} to {z[k + 1]:.3g} mm", fontsize=11)
        axes.set(aspect="equal", xlabel="x (mm)", ylabel="" if place else "y (mm)")
        flat.append(axes)
    # of the last slice itself: the legend below it is wider
    bar = figure.colorbar(mesh, cax=flat[-1].inset_axes((1.06, 0.0, 0.06, 1.0)))
    bar.set_label("η (%) of light\nthat is born there")
    upright = figure.add_subplot(grid[1, :2])
    middle = (len(y) - 1) // 2
    upright.pcolormesh(x, z, shown[:, middle].T, **look)
    upright.set_title(f"y from {y[middle]:.3g} to {y[middle + 1]:.3g} mm", fontsize=11)
    upright.set(aspect="equal", xlabel="x (mm)", ylabel="z (mm)")
    # means over the cells of slices, by volume
    volume = mapped.volume.sum(axis=(0, 1))
    eta = np.nansum(mapped.volume * mapped.eta, axis=(0, 1)) / volume
    sigma = np.sqrt(np.nansum((mapped.volume * mapped.eta_sigma) ** 2, axis=(0, 1))) / volume
    heights = figure.add_subplot(grid[1, 2:4])
    look = {"fmt": "o-", "ms": 4, "color": style.DARK, "lw": 1.2, "capsize": 2}
    heights.errorbar(100.0 * eta, mapped.centres_mm[2], xerr=100.0 * sigma, **look)
    heights.set(xlabel="η (%) of a slice", ylabel="z (mm)", ylim=z[[0, -1]])
    style.open_axes(heights)
    # what gammas see: eta of where they stop, by how much of the light is from there
    there, axes = mapped.volume > 0.0, figure.add_subplot(grid[1, 4:])
    percent = 100.0 * mapped.eta[there]
    edges = np.linspace(percent.min(), percent.max(), 36)
    for spread, colour, dashes in zip(spreads, _COLOURS, _LINES, strict=False):
        light = spread.light[there]
        per_bin = np.histogram(percent, edges, weights=100.0 * light / light.sum())[0]
        fwhm = pdg(100.0 * spread.fwhm, 100.0 * FWHM * spread.relative_rms_sigma)
        label = f"{style.shortened(spread.source, 40)}: FWHM {fwhm} %"
        axes.stairs(per_bin, edges, color=colour, ls=dashes, lw=1.6, label=label)
    noise = 100.0 * np.median(mapped.eta_sigma[there])
    title = f"η (%) where gammas stop\n(each ±{noise:.2g} by the simulation)"
    axes.set(xlabel=title, ylabel="light (% per bin)", ylim=(0, None))
    style.open_axes(axes)
    style.legend_above(axes, ncols=1, handlelength=2.6)
    columns = {"volume": mapped.volume, "eta": mapped.eta, "eta_sigma": mapped.eta_sigma}
    centres = np.meshgrid(*mapped.centres_mm, indexing="ij")
    columns = dict(zip(("x_mm", "y_mm", "z_mm"), centres, strict=True)) | columns
    numbers = style.numbers_in({name: cells[there] for name, cells in columns.items()})
    return style.Drawing(figure, *numbers)


# Wavelengths: eta, what it depends on, and the light that is left.


@style.styled
def draw_spectrum(spectrum: EtaSpectrum) -> style.Drawing:
    """Eta over the wavelength above; below, the light as it is emitted and as it is detected."""
    light = spectrum.light
    nm = light.wavelength_nm
    figure, (above, below) = style.axes_of(8.4, 6.4, 2, sharex=True)
    eta, sigma = 100.0 * spectrum.eta, 100.0 * spectrum.eta_sigma
    style.band(above, nm, eta, sigma, color=style.DARK, alpha=0.25)
    above.plot(nm, eta, color=style.DARK, lw=1.8, label="by wavelength")
    mean = 100.0 * (spectrum.eta_detected if light.detected else spectrum.eta_emitted)
    words = "detected" if light.detected else "emitted"
    label = f"mean of the {words} light: {mean:.4g} %"
    above.axhline(mean, color=style.WARM, lw=1.4, ls=_LINES[1], label=label)
    above.axvline(light.mean_nm, **_LIMIT)
    label = f"at {light.mean_nm:.0f} nm, the mean"
    eta_at_mean = 100.0 * spectrum.eta_at_mean
    above.plot(light.mean_nm, eta_at_mean, "o", ms=6, color=style.DARK, label=label)
    above.set(ylabel="η (%)")
    emitted, detected = (v / v.max() for v in (light.emission, spectrum.detected_part))
    below.plot(nm, emitted, color=style.DARK, lw=1.8, label="emitted")
    below.plot(nm, detected, color=style.WARM, lw=1.8, ls=_LINES[1], label="detected")
    if light.detected:
        look: dict[str, Any] = {"color": style.GREY, "lw": 1.4, "ls": _LINES[2]}
        below.plot(nm, light.efficiency, label="the detector's efficiency", **look)
    below.axvline(light.mean_nm, **_LIMIT)
    below.set(xlabel="wavelength (nm)", ylabel="light over its maximum")
    below.set(ylim=(0, None), xlim=(nm[0], nm[-1]))
    for axes in (above, below):
        style.legend_above(axes, ncols=3, handlelength=2.6)
    columns = {"wavelength_nm": nm, "eta": spectrum.eta, "eta_sigma": spectrum.eta_sigma}
    columns |= {"emission": light.emission, "efficiency": light.efficiency}
    columns |= {"detected_part": spectrum.detected_part, **light.parameters}
    return style.Drawing(figure, *style.numbers_in(columns))


# Arrival times: the histogram of detected light, and an event's first photons.

#: Times are shown in ns from here on.
_LONG_PS = 10_000.0
#: Of each place where an event's light is born: colour, marker, and shift from the photon's number.
_OF_BIRTHS = ((style.DARK, "o", -0.12), (style.WARM, "s", 0.12))


@style.styled
def draw_times(times: ArrivalTimes) -> style.Drawing:
    """The histogram with its mean and 10 to 90 %, and the first photons with their rms."""
    figure, (left, right) = style.axes_of(10.4, 4.5, 1, 2, width_ratios=(1.25, 1.0))
    unit, per = ("ns", 1000.0) if times.edges_ps[-1] > _LONG_PS else ("ps", 1.0)
    edges = times.edges_ps / per
    _draw_steps(left, edges, 100.0 * times.part, 100.0 * times.part_sigma, color=style.DARK)
    label = f"mean, {pdg(times.mean_ps / per, times.mean_ps_sigma / per)} {unit}"
    left.axvline(times.mean_ps / per, color=style.WARM, lw=1.4, ls=_LINES[1], label=label)
    begin, end = times.begin_ps / per, (times.begin_ps + times.rise_ps) / per
    label = f"10 to 90 % of the light, {end - begin:.3g} {unit}"
    left.axvspan(begin, end, color=style.LIGHT, alpha=0.18, lw=0, label=label)
    left.set(xlabel=f"arrival time ({unit})", xlim=(0, edges[-1]), ylim=(0, None))
    left.set_ylabel(f"detected light (% per {edges[1]:g} {unit})")
    number = np.arange(1, len(times.first[0].mean_ps) + 1)
    for photons, (colour, marker, shift) in zip(times.first, _OF_BIRTHS, strict=False):
        look: dict[str, Any] = {"color": colour, "fmt": marker, "ms": 4.5, "lw": 1.2}
        look |= {"capsize": 2.5, "label": f"light of an event born {photons.born}"}
        right.errorbar(number + shift, photons.mean_ps, photons.rms_ps, **look)
    right.set(ylabel="arrival time, mean and rms (ps)", ylim=(0, None), xticks=number)
    right.set_xlabel(f"number among {times.detected:,} detected photons")
    style.legend_above(left, ncols=1, handlelength=2.6)
    style.legend_above(right, ncols=1)
    # rows of the histogram, then of the first photons: either kind leaves the other's columns empty
    of_bin = dict.fromkeys(("time_ps", "part", "part_sigma"))
    names = "mean_ps mean_ps_sigma rms_ps rms_ps_sigma".split()
    of_photon = [None] * len(("born", "photon", *names))
    rows: list[Sequence[object]] = [(*row, *of_photon) for row in times.rows]
    for photons in times.first:
        cells = {"born": photons.born, "photon": range(1, len(photons.mean_ps) + 1)}
        values = {name: getattr(photons, name) for name in names}
        columns, of_photons = style.numbers_in(of_bin | cells | values)
        rows += of_photons
    return style.Drawing(figure, columns, rows)


# Fates: one stacked bar per configuration.


#: Percent below which parts have their label above the bar.
_INSIDE = 6.8
#: Percent below which they have none.
_LEAST = 0.1
#: Percent that a label above the bar takes.
_LABEL = 6.6
_HEIGHT = 0.56


@style.styled
def draw_fates(lights: Lights) -> style.Drawing:
    """Which fates light meets, one bar per configuration from top to bottom."""
    figure, axes = style.axes_of(9.6, 1.75 + 0.95 * len(lights), lines="x")
    fates = (part for _, light in lights for part in light.budget.items())
    shown = style.ordered(fate for fate, share in fates if 100 * share >= _LEAST)
    for row, (_, light) in enumerate(lights):
        _draw_bar(axes, row, light, shown)
    names = [f"{style.in_lines(n)}\nη = {pdg(x.eta, x.eta_sigma)}" for n, x in lights]
    style.rows_of_bars(axes, names, 0.72, parse_math=False)
    axes.set(xlim=(0, 100), xlabel="share of the emitted light (%)")
    axes.spines["left"].set_visible(False)
    handles = [Patch(label=style.fate_style(fate).words, **_bar_look(fate)) for fate in shown]
    sizes = {"fontsize": 10, "handlelength": 1.8, "handleheight": 1.1, "columnspacing": 1.6}
    style.legend_of(figure, handles, "upper center", min(4, len(handles)), **sizes)
    columns = ("configuration", "fate", "fraction", "fraction_sigma", "photons")
    rows = [
        (name, fate, light.budget[fate], light.budget_sigma[fate], light.photons)
        for name, light in lights
        for fate in style.ordered(light.budget)
    ]
    return style.Drawing(figure, columns, rows)


def _bar_look(fate: str) -> dict[str, Any]:
    look = style.fate_style(fate)
    return {"facecolor": look.fill, "edgecolor": look.edge, "hatch": look.hatch, "linewidth": 0.8}


def _draw_bar(axes: Axes, row: int, light: Light, shown: Sequence[str]) -> None:
    """A configuration's bar with percentages, of narrow parts above it, of the narrowest none."""
    left, narrow = 0.0, []  # where the next part begins; middles and texts of narrow parts
    for fate in shown:
        percent = 100 * light.budget.get(fate, 0.0)
        axes.barh(row, percent, _HEIGHT, left, **_bar_look(fate))
        middle, text = left + percent / 2, f"{percent:.1f} %"
        left += percent
        if percent >= _INSIDE:
            fate_look = style.fate_style(fate)
            box = {"boxstyle": "round,pad=0.15", "fc": fate_look.fill, "ec": "none"}
            style.text_in_bar(axes, text, (middle, row), color=fate_look.text, bbox=box)
        elif percent >= _LEAST:
            narrow.append((middle, text))
    top = row - _HEIGHT / 2
    # from left to right, near their parts, none on another
    places: list[float] = []
    for middle, _ in narrow:
        places.append(max(middle, places[-1] + _LABEL if places else _LABEL / 2))
    # those that were pushed beyond the bar's end come back, and push others to the left
    most = 100 - _LABEL / 2
    for i in reversed(range(len(places))):
        places[i] = min(places[i], most)
        most = places[i] - _LABEL
    for (middle, text), x in zip(narrow, places, strict=True):
        look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9}
        look["arrowprops"] = {"arrowstyle": "-", "lw": 0.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate(text, (middle, top), (x, top - 0.13), annotation_clip=False, **look)


# A table: lines of eta along its longest axis.

#: Lines that can be told apart.
MOST_LINES = 12
_MARKERS = "os^vDPX*<>ph"


def lines_of_table(axes: Mapping[str, Sequence[Value]]) -> tuple[str, list[str], int]:
    """The longest axis of a table, the others, and how many combinations of values these have.

    Raises InputError if there are more than `MOST_LINES`, or nothing varies.
    """
    along = max(axes, key=lambda name: len(axes[name]), default="")
    others = [name for name in axes if name != along]
    lines = math.prod(len(axes[name]) for name in others)
    if not along or lines > MOST_LINES:
        problem = f"a figure of {lines} lines would tell nothing" if along else "nothing varies"
        mend = f"choose values of {', '.join(others)}: to_xarray() has all" if along else "print it"
        raise InputError(problem, mend)
    return along, others, lines


@style.styled
def draw_table(tabulated: EtaTable) -> style.Drawing:
    """Eta along the table's longest axis, a line for every combination of the other values.

    Raises InputError if there are more lines than can be told apart, or nothing varies.
    """
    along, others, lines = lines_of_table(tabulated.axes)
    table_rows = [list(row.values()) for row in tabulated.rows]
    if tabulated.eta.size == 1:  # a dot in an empty frame
        value, sigma = tabulated.eta.item(), tabulated.eta_sigma.item()
        words = f"one point: η = {pdg(value, sigma)}"
        return style.sentence_instead(words, (tabulated.columns, table_rows))
    place = list(tabulated.axes).index(along)
    # (lines, points)
    both = tabulated.eta, tabulated.eta_sigma
    etas, sigmas = (np.moveaxis(grid, place, -1).reshape(lines, -1) for grid in both)
    figure, axes = style.axes_of(7.2, 4.8)
    values = tabulated.axes[along]
    numeric = not any(isinstance(value, str | bool) for value in values)
    # what is no number, such as a material, stands evenly
    places = values if numeric else range(len(values))
    for line, combination in enumerate(product(*(tabulated.axes[name] for name in others))):
        colour = str(0.75 * line / lines) if lines > 4 else _COLOURS[line]
        look: dict[str, Any] = {"marker": _MARKERS[line], "ms": 5, "lw": 1.2, "color": colour}
        label = ", ".join(map(said, others, combination))
        axes.errorbar(places, etas[line], sigmas[line], label=label, **look)
    if not numeric:
        axes.set_xticks(places, [str(value) for value in values], parse_math=False)
    axes.set_xlabel(titled(along), parse_math=False)
    axes.set_ylabel("light collection efficiency")
    if others:
        figure.legend(loc="outside upper center", ncols=min(3, lines), fontsize=9, frameon=False)
    return style.Drawing(figure, tabulated.columns, table_rows)
