"""Figures of a fit: readings beside the model, and the profile likelihoods of its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mcrim_mitsuba.core.numbers import SOURCE_Z, said, titled
from mcrim_mitsuba.core.rounding import capital, number, p_equals, pdg
from mcrim_mitsuba.inference.compare import Comparison, Suspect
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.hypotheses import FittedHypothesis, SideBySide
from mcrim_mitsuba.inference.profiles import Profile
from mcrim_mitsuba.inference.settings import CURVE, ONE_SIGMA, TWO_SIGMA
from mcrim_mitsuba.output import figure_style as style
from mcrim_mitsuba.output.sentences import quantity

_OPEN: dict[str, Any] = {"marker": "o", "mfc": "white", "mew": 1.6}
_AS_IT_IS: dict[str, Any] = _OPEN | {"color": style.WARM, "ms": 6.5, "ls": ""}
_MENDED: dict[str, Any] = {"color": style.DARK, "marker": "D", "ms": 5.5, "ls": ""}
_THIRD: dict[str, Any] = {"color": style.LIGHT, "marker": "^", "ms": 6.5, "ls": ""}
_HATCHED: dict[str, Any] = {"facecolor": "none", "hatch": "///", "alpha": 0.55}
_SUSPECTS: dict[str, Any] = {
    "bad_reading": ("suspected bad reading", {"facecolor": "#f6dccd", "edgecolor": style.WARM}),
    "swapped_rows": ("suspected swap", _HATCHED | {"edgecolor": style.WARM}),
}
#: Half the width of a prediction's dash.
_DASH = 0.32
#: How far before and after stand apart.
_APART = 0.13
#: Readings along one number of the bench that make a curve, at least.
_LEAST_IN_A_SERIES = 4
#: How far hypotheses stand apart.
_BESIDE = 0.24
#: Inches of a reading's width.
_PER_READING = 0.46
#: Inches of the height of a character of its name.
_PER_CHARACTER = 0.068
#: Inches of the widest figure.
_WIDEST = 26.0
#: Inches at the left and right of the axes.
_MARGINS = 1.6
#: Columns of the CSV, which are fields of `FittedRow`.
_MEASURED = "label use measured sigma"
_PREDICTED = "model model_sigma pull"


class _Pulls(NamedTuple):
    """A fit whose pulls are drawn."""

    name: str
    fit: Calibration | FittedHypothesis
    look: dict[str, Any]
    #: How far beside the places of the readings its marks stand.
    shift: float = 0.0


@style.styled
def draw_comparison(
    before: Calibration, after: Calibration | None = None, *, added: str = "", unit: str = ""
) -> style.Drawing:
    """Readings, predictions and pulls: `before` of the campaign as it came, `after` of the mended.

    Only a comparison knows of suspect readings. What was added is for the legend; the unit is that
    of the signals of light, the measurement file's where it is not known.
    """
    # of several suspicions on one reading the first, which is the strongest
    weakest_first = _suspects(before)[::-1]
    suspects = {label: suspect.kind for suspect in weakest_first for label in suspect.labels}
    numbers = _comparison_numbers(before, after, suspects)
    if series := _series_of(before):
        return style.Drawing(_draw_along(series, before, after, unit), *numbers)
    figure, upper, lower = _over_readings(before.rows, (1.4, 1))
    places = np.arange(len(before.rows))
    name = "as it is" if isinstance(before, Comparison) else "fit"
    fits = [_Pulls(name, before, _AS_IT_IS)]
    if after is not None:
        words = f"with {style.shortened(added, 48)}" if added else "mended"
        fits = [_Pulls(name, before, _AS_IT_IS, -_APART), _Pulls(words, after, _MENDED, _APART)]
    _draw_signals(upper, places, fits, unit)
    _draw_pulls(lower, places, fits)
    if after is None:  # after a repair suspicions are history
        _mark_suspects(lower, places, before)
        for row, tick in zip(before.rows, lower.get_xticklabels(), strict=True):
            if row.label in suspects:
                tick.set(fontweight="bold", color=style.WARM)
    return style.Drawing(figure, *numbers)


def _series_of(fit: Calibration) -> dict[str, list[int]]:
    """Places of readings that are drawn as curves, by what they have in common, in words; or none.

    They lie along where light is born: nobody reads what differs in that as single configurations.
    """
    readings, members = fit.model.readings, dict[str, list[int]]()
    if not readings or not all(SOURCE_Z in reading.parameters for reading in readings):
        return members
    columns = [n for n in fit.model.campaign.measurements.columns if n != SOURCE_Z]
    for place, reading in enumerate(readings):
        others = [said(n, reading.parameters[n]) for n in columns if n in reading.parameters]
        if reading.without:
            others.append(f"without {' and '.join(reading.without)}")
        if reading.energy_keV is not None:
            others.append(f"{reading.energy_keV:g} keV")
        members.setdefault(", ".join([reading.sample, *others]).strip(" ,"), []).append(place)
    enough = max(map(len, members.values())) >= _LEAST_IN_A_SERIES
    return members if enough else {}


def _draw_along(
    series: dict[str, list[int]], before: Calibration, after: Calibration | None, unit: str
) -> Figure:
    """A curve for each treatment over where light is born, and its pulls below."""
    values = np.array([float(reading.parameters[SOURCE_Z]) for reading in before.model.readings])
    parts: dict[str, Any] = {"lines": "y", "sharex": True, "height_ratios": (1.7, 1)}
    figure, (upper, lower) = style.axes_of(8.6, 7.4, 2, **parts)
    _bands_of_pulls(lower)
    fits = [(before, (0, (2.2, 1.2))), *([(after, "-")] if after is not None else [])]
    shown = fits[-1][0]
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, len(series)))
    handles: list[Any] = []
    for (words, places), colour in zip(series.items(), colours, strict=True):
        places = sorted(places, key=lambda place: values[place])
        for fit, line_style in fits:
            models = [fit.rows[place].model for place in places]
            upper.plot(values[places], models, color=colour, lw=1.8, ls=line_style)
        for place in places:
            row, at = shown.rows[place], values[place]
            look: dict[str, Any] = {"color": colour, "mfc": colour if row.use else "white"}
            upper.errorbar(at, row.measured, row.sigma, fmt="o", ms=4.5, capsize=2.5, **look)
            lower.plot(at, row.pull, "o", ms=4.5, **look)
        label = style.shortened(words or "readings", 48)
        handles.append(Line2D([], [], label=label, color=colour, marker="o", lw=1.8))
    names = ("as it is", "mended") if after is not None else ("model",)
    for (fit, line_style), name in zip(fits, names, strict=True):
        label = f"{name}: χ² = {number(round(fit.chi2, 6))}, ndf {fit.ndf}"
        handles.append(Line2D([], [], label=label, color=style.GREY, ls=line_style))
    if not all(row.use for row in shown.rows):
        open_mark: dict[str, Any] = _OPEN | {"color": style.GREY, "ls": ""}
        handles.append(Line2D([], [], label="reading not used", **open_mark))
    upper.set_ylabel(style.signal_title(unit, "\n"), parse_math=False)
    upper.yaxis.set_major_formatter("{x:g}")
    upper.set_ylim(bottom=0.0)
    lower.set_xlabel(titled(SOURCE_Z))
    style.legend_above(upper, handles, ncols=2, handlelength=2.2)
    return figure


def _comparison_numbers(
    before: Calibration, after: Calibration | None, suspects: Mapping[str, str]
) -> style.Numbers:
    """A reading a row: what was measured, what was predicted before and after, and suspicions."""
    left_out = before.left_out_pulls if isinstance(before, Comparison) else {}
    mended = {row.label: row for row in after.rows} if after else {}
    further = {
        f"{name}_after": lambda row, name=name: getattr(mended.get(row.label), name, None)
        for name in _PREDICTED.split()
    }
    return style.numbers_of(
        before.rows,
        f"{_MEASURED} {_PREDICTED}",
        left_out_pull=lambda row: left_out.get(row.label),
        suspect=lambda row: suspects.get(row.label),
        **further,
    )


def _over_readings(
    rows: Sequence[FittedRow], heights: tuple[float, float]
) -> tuple[Figure, Axes, Axes]:
    """Upper and lower axes, their heights in this ratio, over the names of the readings."""
    names = style.shortened_apart([row.label for row in rows])
    longest_inches = _PER_CHARACTER * max(map(len, names), default=0)
    width = min(max(8.0, _MARGINS + _PER_READING * len(names)), _WIDEST)
    upright = longest_inches >= 0.85 * (width - _MARGINS) / max(len(names), 1)
    height = 6.0 + (longest_inches if upright else 0.0)
    parts: dict[str, Any] = {"lines": "y", "sharex": True, "height_ratios": heights}
    figure, (upper, lower) = style.axes_of(width, height, 2, **parts)
    size = 5 if _PER_READING * len(names) > _WIDEST else 9.5
    look: dict[str, Any] = {"rotation": 90 if upright else 0, "fontsize": size}
    lower.set_xticks(np.arange(len(names)), names, parse_math=False, **look)
    lower.set_xlim(-0.6, len(names) - 0.4)
    return figure, upper, lower


@style.styled
def draw_hypotheses(compared: SideBySide) -> style.Drawing:
    """Pulls of hypotheses beside each other, and how far their predictions are from the first's."""
    hypotheses = compared.hypotheses
    first, *others = hypotheses
    figure, upper, lower = _over_readings(first.rows, (1.3, 1))
    places = np.arange(len(first.rows))
    # side by side, about the places of the readings
    shifts = _BESIDE * (np.arange(len(hypotheses)) - 0.5 * (len(hypotheses) - 1))
    looks = (_AS_IT_IS, _MENDED, _THIRD)
    fits = [
        _Pulls(style.shortened(hypothesis.words, 56), hypothesis, look, shift)
        for hypothesis, look, shift in zip(hypotheses, looks, shifts.tolist(), strict=False)
    ]
    _draw_pulls(upper, places, fits)
    lower.axhline(0, color=style.GREY, lw=0.9)
    sigmas = np.array([row.sigma for row in first.rows])
    first_model = np.array([row.model for row in first.rows])
    for hypothesis, (_, fit, look, shift) in zip(others, fits[1:], strict=True):
        differences = (np.array([row.model for row in fit.rows]) - first_model) / sigmas
        label = f"{hypothesis.name} − {first.name}"
        lower.vlines(places + shift, 0, differences, color=look["color"], lw=1.1, zorder=3)
        lower.plot(places + shift, differences, zorder=4, label=label, **look)
    lower.set_ylabel("difference of predictions\n(standard errors)")
    style.legend_above(lower, ncols=2, handlelength=1.8)
    # a reading a row; of each hypothesis the predictions, in columns that end in its name
    columns, rows = style.numbers_of(
        first.rows, _MEASURED, apart=lambda row: compared.apart[row.label]
    )
    for hypothesis in hypotheses:
        predicted, cells = style.numbers_of(hypothesis.rows, _PREDICTED)
        columns += [f"{column}_{hypothesis.name}" for column in predicted]
        rows = [(*row, *predictions) for row, predictions in zip(rows, cells, strict=True)]
    return style.Drawing(figure, columns, rows)


def _suspects(fit: Calibration | FittedHypothesis) -> tuple[Suspect, ...]:
    """Readings that may be wrong, of which only a comparison knows."""
    return fit.suspects if isinstance(fit, Comparison) else ()


def _draw_signals(axes: Axes, places: np.ndarray, fits: Sequence[_Pulls], unit: str) -> None:
    """Readings with errors, open if not used; predictions as dashes; beams by a second scale."""
    before = fits[0].fit
    used = np.array([row.use for row in before.rows], bool)
    # 1 for light; the height at which a transmittance of 1 is drawn
    factors = style.units_of_signals([(row.measured, row.of_beam) for row in before.rows])
    measured = factors * [row.measured for row in before.rows]
    sigma = factors * [row.sigma for row in before.rows]
    handles: list[Any] = []
    look: dict[str, Any] = {"color": "black", "ms": 4.5, "lw": 1.3, "capsize": 3, "zorder": 5}
    kinds = ((used, "black", "reading with its error"), (~used, "white", "reading not used"))
    for chosen, face, label in kinds:
        if chosen.any():
            bars = axes.errorbar(places[chosen], measured[chosen], sigma[chosen], fmt="o", **look)
            bars.lines[0].set(mfc=face)
            bars.set_label(label)
            handles.append(bars)
    for (name, fit, mark, _), line_style in zip(fits, ((0, (2.2, 1.2)), "-"), strict=False):
        # in the colour of its pulls, by the same name
        dash: dict[str, Any] = {"color": mark["color"], "lw": 2, "ls": line_style}
        models = factors * [row.model for row in fit.rows]
        axes.hlines(models, places - _DASH, places + _DASH, zorder=4, **dash)
        handles.append(Line2D([], [], label="model" if name == "fit" else f"model {name}", **dash))
    handles += _mark_suspects(axes, places, before) if len(fits) == 1 else []
    axes.set_ylabel(style.signal_title(unit, "\n"), parse_math=False)
    axes.yaxis.set_major_formatter("{x:g}")  # a power of ten over the axis lies under the legend
    axes.set_ylim(bottom=min(0.0, 1.1 * float(measured.min(initial=0.0))))
    of_beam = [row.of_beam for row in before.rows]
    if any(of_beam):
        whole = float(factors[of_beam.index(True)])
        there_and_back = (lambda y: 100 * y / whole, lambda percent: percent * whole / 100)
        axes.secondary_yaxis("right", functions=there_and_back).set_ylabel("transmittance (%)")
    style.legend_above(axes, handles, ncols=2, handlelength=1.8)


def _bands_of_pulls(axes: Axes) -> None:
    """Axes for pulls, with bands of one and two standard errors."""
    axes.axhspan(-2, 2, color="0.93", lw=0)
    axes.axhspan(-1, 1, color="0.85", lw=0)
    axes.set_ylabel("pull (standard errors;\nbands: ±1 and ±2)")


def _draw_pulls(axes: Axes, places: np.ndarray, fits: Sequence[_Pulls]) -> None:
    """Residuals of fits in standard errors over bands of one and two of them."""
    _bands_of_pulls(axes)
    axes.axhline(0, color=style.GREY, lw=0.9)
    handles, extent = [], 3.2
    for name, fit, look, shift in fits:
        pulls = np.array([row.pull for row in fit.rows])
        axes.vlines(places + shift, 0, pulls, color=look["color"], lw=1.1, zorder=3)
        axes.plot(places + shift, pulls, zorder=4, **look)
        extent = max(extent, 1.15 * float(np.abs(pulls).max(initial=0.0)))
        # an exact fit's chi2 is rounding
        label = f"{name}: χ² = {number(round(fit.chi2, 6))}, ndf {fit.ndf}"
        if fit.p_value is not None:
            label += f", {p_equals(fit.p_value)}"
        handles.append(Line2D([], [], label=label, **look))
    axes.set_ylim(-extent, extent)
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    style.legend_above(axes, handles, ncols=1, handlelength=1.8)


def _mark_suspects(
    axes: Axes, places: np.ndarray, before: Calibration | FittedHypothesis
) -> list[Patch]:
    """Draw a column behind each suspect reading; gives entries of the legend."""
    position = {row.label: place for row, place in zip(before.rows, places, strict=True)}
    handles = []
    for kind, (title, box) in _SUSPECTS.items():
        suspects = (suspect for suspect in _suspects(before) if suspect.kind == kind)
        labels = {label for suspect in suspects for label in suspect.labels}
        for label in labels & position.keys():
            axes.axvspan(position[label] - 0.42, position[label] + 0.42, zorder=2, **box)
        if labels:
            handles.append(Patch(label=title, **box))
    return handles


# Profile likelihoods: how well each parameter is known, and how lopsidedly.

_LEVELS = ((ONE_SIGMA, "68.3 %"), (TWO_SIGMA, "95.4 %"))
_CURVE: dict[str, Any] = {"color": style.DARK, "lw": 2.2, "zorder": 4}
_PARABOLA: dict[str, Any] = {"color": style.WARM, "lw": 1.5, "ls": (0, (5, 2)), "zorder": 3}
_PRIOR: dict[str, Any] = {"color": "0.6", "lw": 2.2, "ls": (0, (1, 1.4)), "zorder": 5}
_CROSSING: dict[str, Any] = _OPEN | {"mec": style.DARK, "ms": 6, "ls": "", "zorder": 5}
_BOUND: dict[str, Any] = dict(facecolor=style.PALE, edgecolor=style.GREY, hatch="////", lw=0)
#: Inches of a panel.
_WIDE = 4.0
_HIGH = 3.3
_TOP = CURVE.end + 0.6


def _parabola(profile: Profile, values: np.ndarray) -> np.ndarray:
    """The rise of chi2 that the standard error alone would have."""
    return ((values - profile.value) / profile.sigma) ** 2


@style.styled
def draw_profiles(profiles: Sequence[Profile]) -> style.Drawing:
    """Profile likelihoods, a panel each: by how much chi2 rises over a parameter's values."""
    rows = []
    for profile in profiles:
        # what the point is, the parameter's value there, and by how much chi2 is above its least
        points = [("curve", *p) for p in zip(profile.values, profile.delta_chi2, strict=True)]
        points += [
            (f"{side} end of {level}", value, rise)
            for rise, level in _LEVELS
            for side, value in zip(("lower", "upper"), profile.crossings(rise), strict=True)
            if value is not None
        ]
        rows += [(profile.name, *point, _parabola(profile, point[1])) for point in points]
    numbers = ("parameter", "point", "value", "delta_chi2", "delta_chi2_parabola"), rows
    if not profiles:
        return style.sentence_instead("nothing was fitted: there is no profile to draw", numbers)
    # the light yield first: it is what all is done for
    profiles = sorted(profiles, key=lambda profile: profile.name != LIGHT_YIELD)
    down, across = style.panels_of(len(profiles))
    figure = style.canvas(max(_WIDE * across, 7.2), _HIGH * down + 0.5)
    all_axes = style.panels(figure, len(profiles), "x", sharey=True)
    for axes, profile in zip(all_axes, profiles, strict=True):
        _draw_profile(axes, profile)
    for axes in all_axes[::across]:
        axes.set_ylabel("Δχ² above the solution")
    handles: list[Artist] = [
        Line2D([], [], label="profile over all other parameters", **_CURVE),
        Line2D([], [], label="parabola of the standard error", **_PARABOLA),
    ]
    if any(p.prior is not None for p in profiles):
        handles.append(Line2D([], [], label="prior alone", **_PRIOR))
    if any(end is not None for p in profiles for end in p.ends):
        handles.append(Patch(label="beyond the bound", **_BOUND))
    style.legend_of(figure, handles, "lower center", 4 if across > 2 else 2)
    return style.Drawing(figure, *numbers)


def _draw_profile(axes: Axes, profile: Profile) -> None:
    """One profile with its parabola, its prior, its bounds and the levels of its intervals."""
    # a little beyond the curve's ends, where it may be cut off by a bound
    low, high = (float(value) for value in profile.values[[0, -1]])
    margin = 0.05 * (high - low) if high > low else profile.sigma
    low, high = low - margin, high + margin
    fine = np.linspace(profile.values[0], profile.values[-1], 400)
    axes.plot(fine, profile.curve(fine), **_CURVE)
    wide = np.linspace(low, high, 400)
    axes.plot(wide, _parabola(profile, wide), **_PARABOLA)
    if profile.prior is not None and profile.prior_sigma is not None:
        axes.plot(wide, ((wide - profile.prior) / profile.prior_sigma) ** 2, **_PRIOR)
    for end, edge, value in zip(profile.ends, (low, high), profile.values[[0, -1]], strict=True):
        if end is not None:  # the curve ends there at a bound of the parameter
            axes.axvspan(edge, value, zorder=1, **_BOUND)
    look: dict[str, Any] = {"fontsize": 9, "color": style.GREY, "ha": "right", "va": "bottom"}
    look |= {"transform": axes.get_yaxis_transform(), "bbox": style.paper(0.8, 0.6), "zorder": 6}
    for rise, level in _LEVELS:
        axes.axhline(rise, color=style.GREY, lw=0.8)
        axes.text(0.995, rise + 0.08, level, **look)
        for value in profile.crossings(rise):
            if value is not None:
                axes.plot(value, rise, **_CROSSING)
                axes.vlines(value, 0, rise, color=style.DARK, lw=0.8, ls=":")
    axes.axvline(profile.value, color=style.DARK, lw=0.8)
    axes.set(xlim=(low, high), ylim=(0, _TOP), xlabel=style.parameter_title(profile.name))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    title = f"{capital(style.shortened(quantity(profile.name), 26))}: {_interval(profile)}"
    axes.set_title(title, loc="left", fontsize=11, parse_math=False)


def _interval(profile: Profile) -> str:
    """``0.276 +0.034 −0.025``: solution, 68.3 % interval; cut off ``0.05 (< 0.08, 68.3 %)``."""
    lower, upper = profile.crossings(ONE_SIGMA)
    if lower is None or upper is None:
        limit = f" (> {lower:.4g}, 68.3 %)" if lower is not None else ""
        limit = f" (< {upper:.4g}, 68.3 %)" if upper is not None else limit
        return f"{profile.value:.4g}{limit}"
    below, above = profile.value - lower, upper - profile.value
    value = pdg(profile.value, min(below, above))
    # a common power of ten: the errors would have to share it
    if value.startswith("("):
        return f"{profile.value:.4g} +{above:.2g} −{below:.2g}"
    value, _, error = value.partition(" ± ")
    decimals = len(error.partition(".")[2])
    return f"{value} +{above:.{decimals}f} −{below:.{decimals}f}"
