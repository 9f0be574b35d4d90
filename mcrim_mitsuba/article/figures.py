"""Figs. 2 to 4 of the article, the latter two with our curves, and one that it has not."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullLocator

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.contradiction import Contradiction
from mcrim_mitsuba.article.simulated import COUPLINGS, CURVE_PER_CM, SimulatedLine
from mcrim_mitsuba.core.files import make_folder
from mcrim_mitsuba.core.rounding import capital, pdg
from mcrim_mitsuba.laboratory.histogram import read_histogram
from mcrim_mitsuba.laboratory.peak import fit_peak
from mcrim_mitsuba.optics.slab_transmittance import measured_transmittance, transmittance
from mcrim_mitsuba.output import figure_style as style
from mcrim_mitsuba.output.laboratory_figures import FittedHistogram, draw_histograms
from mcrim_mitsuba.scene.shipped import scene_path

#: Per transmittance: colour (its darkness tells the lines apart in grey), marker.
_STYLE = {98.6: (style.WARM, "^"), 96.0: (style.DARK, "o"), 93.0: (style.LIGHT, "s")}
_UNPOLARISED: dict[str, Any] = {"color": "black", "lw": 0.7, "ls": (0, (1, 2)), "zorder": 3}
_OURS: dict[str, Any] = {"marker": "x", "color": "black", "ms": 7, "mew": 1.8, "zorder": 6}
_PRINTED: dict[str, Any] = {"ms": 8, "mfc": "white", "mew": 1.8, "capsize": 3, "zorder": 5}
#: Heights of the rows of scattering coefficients at the foot of Fig. 4, in units of R.
_ARTICLE_HEIGHT = 0.381
_OURS_HEIGHT = 0.345
#: The lines beside the nominal one lie so much lower, clear of its error bar.
_LOWER = 0.014
_BAND: dict[str, Any] = {"color": style.GREY, "alpha": 0.3, "lw": 0}
_TITLE = "Synthetic histograms, one mounting of each coupling (the article prints none)"
_FINE = np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, 400)
#: Place of R behind the efficiencies of air and gel.
_RATIO = 2
_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2)


def draw_figures(
    folder: str | Path, lines: Sequence[SimulatedLine], contradiction: Contradiction
) -> tuple[Path, ...]:
    """Write the figures and their numbers into a folder, which is made if it is not there.

    Fig. 2 is drawn from synthetic histograms with the article's centroids: it prints none. Raises
    InputError if the folder cannot be written to.
    """
    folder = make_folder(folder)
    drawings = {
        "fig2_histograms": draw_histograms([_synthetic(name) for name in COUPLINGS], title=_TITLE),
        "fig3_light_collection_efficiency": draw_efficiency(lines),
        "fig4_ratio": draw_ratio(lines),
        "transmittance": draw_contradiction(lines, contradiction),
    }
    paths: list[Path] = []
    for name, drawing in drawings.items():
        picture, numbers = drawing.save(folder / f"{name}.png")
        paths += (picture, style.save(drawing.figure, folder / f"{name}.pdf"), numbers)
    return tuple(paths)


def _synthetic(name: str) -> FittedHistogram:
    """The first mounting of the raw example, in one coupling."""
    histogram = read_histogram(scene_path(f"camoo4_raw/{name}_1.csv"))
    peak = fit_peak(histogram.photons, histogram.counts)
    return FittedHistogram(f"{name} in the gap", histogram, peak)


#: What every row of the curves begins with, and the place on its curve.
_OF_CURVE = ("transmittance_percent", "alpha_abs_per_cm", "alpha_scat_per_cm")


def _points(line: SimulatedLine, place: int) -> Iterator[tuple[float, ...]]:
    """`_OF_CURVE`, value and error of the points of an efficiency or the ratio."""
    printed = line.printed.transmittance_percent.value, line.printed.alpha_abs_per_cm.value
    for point in zip(CURVE_PER_CM, *(side[place] for side in line.curves), strict=True):
        yield *printed, *point


@style.styled
def draw_efficiency(lines: Sequence[SimulatedLine]) -> style.Drawing:
    """Fig. 3: eta against alpha_scat for two couplings and three transmittances; Table 1 beside."""
    rows = [
        (polarised, n_gap, *point)
        for polarised in (True, False)
        for place, n_gap in enumerate(COUPLINGS.values())
        for line in lines
        if line.polarised is polarised
        for point in _points(line, place)
    ]
    figure, axes = style.axes_of()
    for line, (place, dashes) in itertools.product(lines, enumerate(("--", "-"))):
        _draw_curve(axes, line, place, 100.0, ls=dashes)
        if not line.polarised:
            continue
        colour, marker = _STYLE[line.printed.transmittance_percent.value]
        printed = line.printed.etas_percent[place]
        look: dict[str, Any] = {"fmt": marker, "mec": colour, "ecolor": colour, **_PRINTED}
        axes.errorbar(line.printed.alpha_scat_per_cm.value, printed.value, printed.rounding, **look)
        axes.plot(line.alpha_scat.value, 100 * line.etas[place], **_OURS)
    _scattering_axis(axes)
    axes.set_ylim(0, 56)
    axes.set_ylabel("light collection efficiency η (%)")
    for name, height in (("gel in the gap, n = 1.46", 51.5), ("air in the gap, n = 1.00", 8.5)):
        axes.text(0.0105, height, name, weight="bold", va="center")
    table_1: dict[str, Any] = {"marker": "o", "mfc": "white", "mew": 1.8, "ms": 8}
    article = Line2D([], [], ls="", color=style.GREY, label="article, Table 1", **table_1)
    ours = Line2D([], [], ls="", label="Mitsuba, where R = 0.583", **_OURS)
    _legend(axes, "lower right", "polarisation ignored", article, ours)
    return style.Drawing(figure, ("polarised", "n_gap", *_OF_CURVE, "eta", "eta_sigma"), rows)


@style.styled
def draw_ratio(lines: Sequence[SimulatedLine]) -> style.Drawing:
    """Fig. 4: R against alpha_scat, the measured band and the scattering coefficient."""
    rows = [(line.polarised, *point) for line in lines for point in _points(line, _RATIO)]
    figure, axes = style.axes_of()
    ratio, error = p.RATIO.value, p.RATIO.stated_sigma
    axes.axhspan(ratio - error, ratio + error, color=style.PALE, lw=0)
    axes.axhline(ratio, color=style.GREY, lw=0.9)
    words = f"measured R = {ratio:.3f} ± {error:.3f}"
    axes.text(0.0105, ratio + error + 0.003, words, fontsize=10, color=style.GREY, va="bottom")
    for line in lines:
        nominal = line.printed == p.NOMINAL
        if line.polarised or nominal:
            _draw_curve(axes, line, _RATIO, lw=2.4 if nominal else 1.5)
        if line.polarised:
            _mark_solution(axes, line)
    for name, height in (("article", _ARTICLE_HEIGHT), ("Mitsuba", _OURS_HEIGHT)):
        axes.text(0.0105, height, rf"$α_\mathrm{{scat}}$, {name}", va="center", fontsize=10)
    _scattering_axis(axes)
    axes.set_ylim(0.318, 0.72)
    axes.set_ylabel(r"$R = η_\mathrm{air} / η_\mathrm{gel}$")
    _legend(axes, "upper left", "polarisation ignored (T = 96.0 %)")
    return style.Drawing(figure, ("polarised", *_OF_CURVE, "ratio", "ratio_sigma"), rows)


@style.styled
def draw_contradiction(
    lines: Sequence[SimulatedLine], contradiction: Contradiction
) -> style.Drawing:
    """The three numbers of one crystal beside the model, and what may be missing in it."""
    figure, (axes, bars) = style.axes_of(11.0, 4.4, 1, 2, width_ratios=(1.15, 1.0))
    # the measured ratio and transmittance beside what the model allows
    for line in lines:
        if line.polarised:
            continue
        internal = transmittance(_FINE + line.printed.alpha_abs_per_cm.value, p.CRYSTAL_MM.value)
        colour, _ = _STYLE[line.printed.transmittance_percent.value]
        percent = 100 * measured_transmittance(internal, p.N_CRYSTAL.value)
        label = rf"$α_\mathrm{{abs}}$ = {line.printed.alpha_abs_per_cm.text} /cm"
        axes.plot(percent, line.smooth(_FINE)[_RATIO], color=colour, lw=2.2, label=label)
    measured = (p.MEASURED_TRANSMITTANCE.value, p.RATIO.value)
    sigma = next(r.sigma for r in contradiction.diagnosis.baseline.rows if r.measured < 1.0)
    look: dict[str, Any] = {"fmt": "o", "ms": 8, "color": "black", "capsize": 3, "zorder": 6}
    axes.errorbar(*measured, p.RATIO.stated_sigma, 100 * sigma, **look)
    beside: dict[str, Any] = {"xytext": (-10, 10), "textcoords": "offset points", "ha": "right"}
    axes.annotate("measured", measured, weight="bold", **beside)
    axes.set_xlim(0, 92)
    axes.set_xlabel("transmittance through 10 mm (%)")
    axes.set_ylabel(r"$R = η_\mathrm{air} / η_\mathrm{gel}$")
    axes.set_title("the article's model, whatever it scatters", fontsize=11)
    axes.legend(loc="lower left", frameon=False, fontsize=10)
    _draw_explanations(bars, contradiction)
    yields = contradiction.light_yields
    rows = [(name, p, yields.get(name)) for name, p in contradiction.likeliest.items()]
    return style.Drawing(figure, ("explanation", "probability", "light_yield_ph_per_keV"), rows)


def _draw_explanations(axes: Axes, contradiction: Contradiction) -> None:
    """The likeliest explanations, each with its light yield."""
    explanations = list(contradiction.likeliest.items())[::-1]
    percent = [100 * p for _, p in explanations]
    axes.barh(range(len(percent)), percent, color=style.DARK, height=0.6)
    for place, (name, probability) in enumerate(explanations):
        of_light = contradiction.light_yields.get(name)
        text = "" if of_light is None else f"  {of_light:.1f} ph/keV"
        axes.text(100 * probability, place, text, va="center", fontsize=10)
    titles = [capital(contradiction.title(name)) for name, _ in explanations]
    axes.set_yticks(range(len(explanations)), titles)
    axes.set_xlim(0, 135 * max(p for _, p in explanations))
    axes.set_xlabel("probability (%)")
    averaged = contradiction.diagnosis.light_yield_averaged
    if averaged is not None:
        title = f"light yield {pdg(averaged.value, averaged.sigma)} ph/keV on average"
        axes.set_title(f"{title}\nthe article: {p.LIGHT_YIELD.text}", fontsize=11)


def _legend(axes: Axes, place: str, unpolarised: str, *further: Line2D) -> None:
    """A legend of what both figures have in common, and of `further` entries."""
    handles = [
        Line2D([], [], color=style.GREY, lw=2.2, label="Mitsuba, polarisation followed"),
        Patch(label="its Monte Carlo error, ±2σ", **_BAND),
        Line2D([], [], label=unpolarised, **_UNPOLARISED),
        *further,
    ]
    style.legend(axes, handles, loc=place, fontsize=10)


def _mark_solution(axes: Axes, line: SimulatedLine) -> None:
    """Draw where a curve meets the measured ratio, led down to the article's value and ours."""
    colour, marker = _STYLE[line.printed.transmittance_percent.value]
    solution = line.alpha_scat
    nominal = line.printed == p.NOMINAL
    printed = p.ALPHA_SCAT if nominal else line.printed.alpha_scat_per_cm
    lower = 0.0 if nominal else _LOWER
    foot = _OURS_HEIGHT - lower
    axes.plot(solution.value, p.RATIO.value, **_OURS)
    axes.plot([solution.value] * 2, [p.RATIO.value, foot], color=colour, lw=0.8, ls=":")
    look: dict[str, Any] = {"fmt": marker, "mec": colour, "ecolor": colour, **_PRINTED}
    axes.errorbar(printed.value, _ARTICLE_HEIGHT - lower, xerr=printed.sigma, **look)
    axes.plot(solution.value, foot, **_OURS)
    if not nominal:
        return
    assert solution.lower is not None and solution.upper is not None  # profiled
    low, high = solution.value - solution.lower, solution.upper - solution.value
    axes.errorbar(
        solution.value, foot, xerr=[[low], [high]], fmt="none", ecolor="black", capsize=3, zorder=6
    )
    for height, value, error in (
        (_ARTICLE_HEIGHT, printed.value, printed.sigma),
        (_OURS_HEIGHT, solution.value, solution.contributions["statistical"]),
    ):
        text = f"{value:.2f} ± {error:.2f} /cm"
        axes.text(0.3, height, text, color=colour, va="center", ha="right", fontsize=10)


def _draw_curve(
    axes: Axes, line: SimulatedLine, place: int, factor: float = 1.0, lw: float = 2.2, ls: str = "-"
) -> None:
    """A curve with two Monte Carlo standard errors on either side; dotted if unpolarised."""
    smooth = factor * line.smooth(_FINE)[place]
    if not line.polarised:
        axes.plot(_FINE, smooth, **_UNPOLARISED)
        return
    colour, _ = _STYLE[line.printed.transmittance_percent.value]
    axes.plot(_FINE, smooth, color=colour, lw=lw, ls=ls)
    values, sigmas = (factor * side[place] for side in line.curves)
    low, high = values - 2 * sigmas, values + 2 * sigmas
    axes.fill_between(CURVE_PER_CM, low, high, color=colour, alpha=0.25, lw=0)
    # the transmittance at the curve's right end, a little apart from its neighbours'
    percent = line.printed.transmittance_percent
    apart = 3 * np.sign(percent.value - p.NOMINAL.transmittance_percent.value)
    look: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 10}
    end = (p.SCANNED_TO.value, values[-1])
    axes.annotate(f"T = {percent.text} %", end, (5, apart), color=colour, **look)


def _scattering_axis(axes: Axes) -> None:
    """The range of scattering coefficients that the article scans, as a logarithmic axis."""
    axes.set_xscale("log")
    axes.set_xlim(p.SCANNED_FROM.value * 0.95, p.SCANNED_TO.value * 1.05)
    axes.xaxis.set_major_locator(FixedLocator(_TICKS))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(r"scattering coefficient $α_\mathrm{scat}$ (1/cm)")
