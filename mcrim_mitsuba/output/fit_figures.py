"""Figures of a fit: readings beside the model, and the profile likelihoods of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mcrim_mitsuba.core.rounding import number, p_equals, pdg
from mcrim_mitsuba.inference.compare import Comparison, Suspect
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD, FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.hypotheses import FittedHypothesis, SideBySide
from mcrim_mitsuba.inference.profiles import Profile
from mcrim_mitsuba.inference.settings import CURVE, ONE_SIGMA, TWO_SIGMA
from mcrim_mitsuba.output import figure_style as style

_AS_IT_IS: dict[str, Any] = {
    "color": style.WARM,
    "marker": "o",
    "mfc": "white",
    "mew": 1.6,
    "ms": 6.5,
    "ls": "",
}
_MENDED: dict[str, Any] = {"color": style.DARK, "marker": "D", "ms": 5.5, "ls": ""}
_HYPOTHESES: tuple[dict[str, Any], ...] = (
    _AS_IT_IS,
    _MENDED,
    {"color": style.LIGHT, "marker": "^", "ms": 6.5, "ls": ""},
)
_SUSPECTS: dict[str, Any] = {
    "bad_reading": ("suspected bad reading", {"facecolor": "#f6dccd", "edgecolor": style.WARM}),
    "swapped_rows": (
        "suspected swap",
        {
            "facecolor": "none",
            "edgecolor": style.WARM,
            "hatch": "///",
            "alpha": 0.55,
        },
    ),
}
#: After a repair the suspicion is history.
_NO_LONGER: dict[str, Any] = {"facecolor": "none", "edgecolor": "0.6", "ls": ":"}
#: Half the width of a prediction's dash.
_DASH = 0.32
#: How far before and after stand apart.
_APART = 0.13
#: How far hypotheses stand apart.
_BESIDE = 0.24
#: Inches of a reading's width.
_PER_READING = 0.46
#: Inches of the height of a character of its name.
_PER_CHARACTER = 0.068
#: Inches of the widest figure.
_WIDEST = 26.0
_MEASURED = "label use measured sigma"
_PREDICTED = "model model_sigma pull"
#: A name, a fit, how it looks, and how far beside the places of the readings it stands.
_Series = tuple[str, Calibration | FittedHypothesis, dict[str, Any], float]


@style.styled
def draw_comparison(
    before: Calibration,
    after: Calibration | None = None,
    *,
    added: str = "",
    unit: str = "",
) -> style.Drawing:
    """Readings, predictions and pulls.

    Parameters
    ----------
    before : Calibration
        The campaign as it came; only a comparison knows of suspect readings.
    after : Calibration, optional
        Of the mended campaign: the same readings.
    added : str
        What mended it, for the legend.
    unit : str
        Of the signals of light; the measurement file's where it is not known.
    """
    figure, upper, lower = _over_readings(before.rows, (1.4, 1))
    places = np.arange(len(before.rows))
    _draw_signals(upper, places, before, after, unit)
    name = "as it is" if isinstance(before, Comparison) else "fit"
    series: list[_Series] = [(name, before, _AS_IT_IS, 0.0)]
    if after is not None:
        words = f"with {style.shortened(added, 56)}" if added else "mended"
        series = [(name, before, _AS_IT_IS, -_APART), (words, after, _MENDED, _APART)]
    _draw_pulls(lower, places, series)
    _mark_suspects(lower, places, before, mended=after is not None)
    suspects = {
        label: suspect.kind for suspect in _suspects(before)[::-1] for label in suspect.labels
    }
    for row, tick in zip(before.rows, lower.get_xticklabels(), strict=True):
        if row.label in suspects:
            tick.set(fontweight="bold", color=style.WARM if after is None else style.GREY)
    left_out = before.left_out_pulls if isinstance(before, Comparison) else {}
    mended = {row.label: row for row in after.rows} if after else {}
    then: dict[str, Any] = {
        f"{name}_after": lambda row, name=name: getattr(mended.get(row.label), name, None)
        for name in _PREDICTED.split()
    }
    numbers = style.numbers_of(
        before.rows,
        f"{_MEASURED} {_PREDICTED}",
        left_out_pull=lambda row: left_out.get(row.label),
        suspect=lambda row: suspects.get(row.label),
        **then,
    )
    return style.Drawing(figure, *numbers)


def _over_readings(
    rows: Sequence[FittedRow], heights: tuple[float, float]
) -> tuple[Figure, Axes, Axes]:
    """A figure of two axes, one over the other, above the names of the readings."""
    names = [style.shortened(row.label) for row in rows]
    longest = max(map(len, names), default=0)
    width = min(max(8.0, 1.6 + _PER_READING * len(names)), _WIDEST)
    upright = longest * _PER_CHARACTER < 0.85 * (width - 1.6) / max(len(names), 1)
    figure = style.canvas(width, 6.0 + (0.0 if upright else _PER_CHARACTER * longest))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    crowded = _PER_READING * len(names) > _WIDEST
    lower.set_xticks(
        np.arange(len(names)),
        names,
        rotation=0 if upright else 90,
        fontsize=5 if crowded else 9.5,
        parse_math=False,
    )
    lower.set_xlim(-0.6, len(names) - 0.4)
    return figure, upper, lower


@style.styled
def draw_hypotheses(compared: SideBySide) -> style.Drawing:
    """Pulls of hypotheses beside each other, and how far their predictions are from the first's."""
    hypotheses = compared.hypotheses
    first, *others = hypotheses
    figure, upper, lower = _over_readings(first.rows, (1.3, 1))
    places = np.arange(len(first.rows))
    aside = _BESIDE * (np.arange(len(hypotheses)) - 0.5 * (len(hypotheses) - 1))
    looks = list(zip(hypotheses, _HYPOTHESES, aside.tolist(), strict=False))
    _draw_pulls(
        upper,
        places,
        [
            (style.shortened(hypothesis.words, 56), hypothesis, look, at)
            for hypothesis, look, at in looks
        ],
    )
    lower.axhline(0, color=style.GREY, lw=0.9)
    sigmas = np.array([row.sigma for row in first.rows])
    of_first = np.array([row.model for row in first.rows])
    far = {
        hypothesis.name: (np.array([row.model for row in hypothesis.rows]) - of_first) / sigmas
        for hypothesis in others
    }
    for hypothesis, look, at in looks[1:]:
        label = f"{hypothesis.name} − {first.name}"
        lower.vlines(places + at, 0, far[hypothesis.name], color=look["color"], lw=1.1, zorder=3)
        lower.plot(places + at, far[hypothesis.name], zorder=4, label=label, **look)
    lower.set_ylabel("difference of predictions\n(standard errors)")
    style.open_axes(lower, "y")
    style.legend_above(lower, ncols=2, handlelength=1.8)
    tables = {
        hypothesis.name: style.numbers_of(hypothesis.rows, _PREDICTED) for hypothesis in hypotheses
    }
    columns, rows = style.numbers_of(
        first.rows, _MEASURED, apart=lambda row: compared.apart[row.label]
    )
    for name, (predicted, cells) in tables.items():
        columns += [f"{column}_{name}" for column in predicted]
        rows = [(*row, *more) for row, more in zip(rows, cells, strict=True)]
    return style.Drawing(figure, columns, rows)


def _suspects(before: Calibration) -> tuple[Suspect, ...]:
    return before.suspects if isinstance(before, Comparison) else ()


def _draw_signals(
    axes: Axes,
    places: np.ndarray,
    before: Calibration,
    after: Calibration | None,
    unit: str,
) -> None:
    """Readings with errors, and predictions as dashes."""
    used = np.array([row.use for row in before.rows], bool)
    units = style.units_of_signals([(row.measured, row.of_beam) for row in before.rows])
    measured = units * [row.measured for row in before.rows]
    sigma = units * [row.sigma for row in before.rows]
    handles: list[Any] = []
    kinds = ((used, "black", "reading with its error"), (~used, "white", "reading not used"))
    for which, face, label in kinds:
        if which.any():
            handles.append(
                axes.errorbar(
                    places[which],
                    measured[which],
                    yerr=sigma[which],
                    fmt="o",
                    ms=4.5,
                    color="black",
                    mfc=face,
                    capsize=3,
                    lw=1.3,
                    zorder=5,
                    label=label,
                )
            )
    fits = (
        (before, "model", style.WARM, (0, (2.2, 1.2))),
        (after, "mended model", style.DARK, "-"),
    )
    for fit, label, colour, look in fits:
        if fit is None:
            continue
        dash: dict[str, Any] = {"color": colour, "lw": 2, "ls": look}
        models = units * [row.model for row in fit.rows]
        axes.hlines(models, places - _DASH, places + _DASH, zorder=4, **dash)
        handles.append(Line2D([], [], label=label, **dash))
    handles += _mark_suspects(axes, places, before, mended=after is not None)
    axes.set_ylabel(style.signal_title(unit, "\n"), parse_math=False)
    axes.set_ylim(bottom=min(0.0, 1.1 * float(measured.min(initial=0.0))))
    style.open_axes(axes, "y")
    of_beam = [row.of_beam for row in before.rows]
    if any(of_beam):
        style.second_scale(axes, float(units[of_beam.index(True)]))
    style.legend_above(axes, handles, ncols=3, handlelength=1.8)


def _draw_pulls(axes: Axes, places: np.ndarray, series: Sequence[_Series]) -> None:
    """Residuals in standard errors over bands of one and two of them."""
    axes.axhspan(-2, 2, color="0.93", lw=0)
    axes.axhspan(-1, 1, color="0.85", lw=0)
    axes.axhline(0, color=style.GREY, lw=0.9)
    handles, extent = [], 3.2
    for name, fit, look, aside in series:
        pulls = np.array([row.pull for row in fit.rows])
        axes.vlines(places + aside, 0, pulls, color=look["color"], lw=1.1, zorder=3)
        axes.plot(places + aside, pulls, zorder=4, **look)
        extent = max(extent, 1.15 * float(np.abs(pulls).max(initial=0.0)))
        # an exact fit's chi2 is rounding
        label = f"{name}: χ² = {number(round(fit.chi2, 6))}, ndf {fit.ndf}"
        if fit.p_value is not None:
            label += f", {p_equals(fit.p_value)}"
        handles.append(Line2D([], [], label=label, **look))
    axes.set_ylim(-extent, extent)
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.set_ylabel("pull (standard errors;\nbands: ±1 and ±2)")
    style.open_axes(axes, "y")
    style.legend_above(axes, handles, ncols=1, handlelength=1.8)


def _mark_suspects(
    axes: Axes, places: np.ndarray, before: Calibration, *, mended: bool
) -> list[Patch]:
    """Columns behind suspect readings, pale once mended; returns what the legend needs."""
    position = {row.label: place for row, place in zip(before.rows, places, strict=True)}
    handles = []
    for kind, (title, box) in _SUSPECTS.items():
        labels = {
            label
            for suspect in _suspects(before)
            if suspect.kind == kind
            for label in suspect.labels
        }
        if mended:
            title, box = f"{title} before the repair", box | _NO_LONGER
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
_CROSSING: dict[str, Any] = {
    "marker": "o",
    "mfc": "white",
    "mec": style.DARK,
    "mew": 1.6,
    "ms": 6,
    "ls": "",
    "zorder": 5,
}
_BOUND: dict[str, Any] = dict(facecolor=style.PALE, edgecolor=style.GREY, hatch="////", lw=0)
#: Inches of a panel.
_WIDE = 4.0
_HIGH = 3.3
_TOP = CURVE.end + 0.6


def _profiles_numbers(profiles: Sequence[Profile]) -> style.Numbers:
    """The curves' points, then where they cross the levels."""
    rows = []
    for profile in profiles:
        points = [("curve", *p) for p in zip(profile.values, profile.delta_chi2, strict=True)]
        for rise, level in _LEVELS:
            for side, value in zip(("lower", "upper"), profile.crossings(rise), strict=True):
                if value is not None:
                    points.append((f"{side} end of {level}", value, rise))
        rows += [
            (profile.name, what, float(value), float(rise), float(_parabola(profile, value)))
            for what, value, rise in points
        ]
    columns = ("parameter", "point", "value", "delta_chi2", "delta_chi2_parabola")
    return columns, rows


def _parabola(profile: Profile, values: np.ndarray) -> np.ndarray:
    return ((values - profile.value) / profile.sigma) ** 2


@style.styled
def draw_profiles(profiles: Sequence[Profile]) -> style.Drawing:
    """Profile likelihoods, see `inference.profiles.profiles_of`."""
    numbers = _profiles_numbers(profiles)
    if not profiles:
        nothing = style.said_alone("nothing was fitted: there is no profile to draw")
        return style.Drawing(nothing, *numbers)
    # what all is done for comes first
    profiles = sorted(profiles, key=lambda profile: profile.name != LIGHT_YIELD)
    down, across = style.panels_of(len(profiles))
    figure = style.canvas(max(_WIDE * across, 7.2), _HIGH * down + 0.5)
    all_axes = style.panels(figure, len(profiles), sharey=True)
    for axes, profile in zip(all_axes, profiles, strict=True):
        _draw(axes, profile)
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


def _draw(axes: Axes, profile: Profile) -> None:
    """One profile with its parabola, its prior, its bounds and the levels of its intervals."""
    # the curve, and a little beyond a bound that cuts it off
    low, high = (float(value) for value in profile.values[[0, -1]])
    margin = 0.05 * (high - low) or profile.sigma
    low, high = low - margin, high + margin
    fine = np.linspace(profile.values[0], profile.values[-1], 400)
    axes.plot(fine, profile.curve(fine), **_CURVE)
    wide = np.linspace(low, high, 400)
    axes.plot(wide, _parabola(profile, wide), **_PARABOLA)
    if profile.prior is not None and profile.prior_sigma is not None:
        axes.plot(wide, ((wide - profile.prior) / profile.prior_sigma) ** 2, **_PRIOR)
    for end, side, value in zip(profile.ends, (low, high), profile.values[[0, -1]], strict=True):
        if end is not None:
            axes.axvspan(side, value, zorder=1, **_BOUND)
    for rise, level in _LEVELS:
        axes.axhline(rise, color=style.GREY, lw=0.8)
        axes.text(
            0.995,
            rise + 0.08,
            level,
            fontsize=9,
            color=style.GREY,
            ha="right",
            va="bottom",
            transform=axes.get_yaxis_transform(),
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6},
        )
        for value in profile.crossings(rise):
            if value is not None:
                axes.plot(value, rise, **_CROSSING)
                axes.vlines(value, 0, rise, color=style.DARK, lw=0.8, ls=":")
    axes.axvline(profile.value, color=style.DARK, lw=0.8)
    axes.set(xlim=(low, high), ylim=(0, _TOP), xlabel=style.parameter_title(profile.name))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_title(_interval(profile), loc="left", fontsize=11, parse_math=False)
    style.open_axes(axes, "x")


def _interval(profile: Profile) -> str:
    """``0.276 +0.034 −0.025``: the solution and the ends of the 68.3 % interval."""
    ends = profile.crossings(ONE_SIGMA)
    if ends[0] is None or ends[1] is None:
        limits = [f"{s} {v:.4g}" for s, v in zip("><", ends, strict=True) if v is not None]
        return f"{profile.value:.4g}" + (f" ({limits[0]}, 68.3 %)" if limits else "")
    below, above = profile.value - ends[0], ends[1] - profile.value
    value = pdg(profile.value, min(below, above))
    if value.startswith("("):
        return f"{profile.value:.4g} +{above:.2g} −{below:.2g}"
    value, _, error = value.partition(" ± ")
    decimals = len(error.partition(".")[2])
    return f"{value} +{above:.{decimals}f} −{below:.{decimals}f}"
