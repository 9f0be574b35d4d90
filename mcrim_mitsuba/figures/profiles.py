"""Profile likelihoods of all fitted parameters: how well each is known, and how lopsidedly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from mcrim_mitsuba.figures.labels import parameter_title
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    PALE,
    WARM,
    Numbers,
    canvas,
    open_axes,
    panels,
    save,
    styled,
    write_numbers,
)
from mcrim_mitsuba.fit.profiles import END, ONE_SIGMA, TWO_SIGMA, Profile
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.physics.rounding import pdg

COLUMNS = ("parameter", "point", "value", "delta_chi2", "delta_chi2_parabola")

_LEVELS = ((ONE_SIGMA, "68.3 %"), (TWO_SIGMA, "95.4 %"))
_CURVE: dict[str, Any] = {"color": DARK, "lw": 2.2, "zorder": 4}
_PARABOLA: dict[str, Any] = {"color": WARM, "lw": 1.5, "ls": (0, (5, 2)), "zorder": 3}
_PRIOR: dict[str, Any] = {"color": "0.6", "lw": 2.2, "ls": (0, (1, 1.4)), "zorder": 5}
_CROSSING: dict[str, Any] = {
    "marker": "o",
    "mfc": "white",
    "mec": DARK,
    "mew": 1.6,
    "ms": 6,
    "ls": "",
    "zorder": 5,
}
_BOUND: dict[str, Any] = {"facecolor": PALE, "edgecolor": GREY, "hatch": "////", "lw": 0}
#: Most panels side by side; inches of one.
_ACROSS, _WIDE, _HIGH = 3, 4.0, 3.3
_TOP = END + 0.6


def draw_profiles(path: str | Path, profiles: Sequence[Profile]) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    profiles : sequence of Profile
        See `fit.profiles.profiles_of`.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = profiles_numbers(profiles)
    return save(profiles_figure(profiles), path), write_numbers(path, columns, rows)


def profiles_numbers(profiles: Sequence[Profile]) -> Numbers:
    """Columns and rows of the CSV: the curves' points, then where they cross the levels."""
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
    return COLUMNS, rows


def _parabola(profile: Profile, values: np.ndarray) -> np.ndarray:
    return ((values - profile.value) / profile.sigma) ** 2


@styled
def profiles_figure(profiles: Sequence[Profile]) -> Figure:
    """The figure of `draw_profiles`."""
    if not profiles:
        figure = canvas(6.0, 1.2)
        figure.text(0.02, 0.5, "nothing was fitted: there is no profile to draw", va="center")
        return figure
    # what all is done for comes first
    profiles = sorted(profiles, key=lambda profile: profile.name != LIGHT_YIELD)
    down = math.ceil(len(profiles) / _ACROSS)
    across = math.ceil(len(profiles) / down)
    figure = canvas(max(_WIDE * across, 7.2), _HIGH * down + 0.5)
    for i, (axes, profile) in enumerate(
        zip(panels(figure, len(profiles), _ACROSS, sharey=True), profiles, strict=True)
    ):
        _draw(axes, profile)
        if i % across == 0:
            axes.set_ylabel("Δχ² above the solution")
    figure.legend(
        handles=_handles(profiles), loc="outside lower center", ncols=4 if across > 2 else 2,
        fontsize=9.5, frameon=False,
    )  # fmt: skip
    return figure


def _draw(axes: Axes, profile: Profile) -> None:
    low, high = _range(profile)
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
        axes.axhline(rise, color=GREY, lw=0.8)
        axes.text(
            0.995, rise + 0.08, level, fontsize=9, color=GREY, ha="right", va="bottom",
            transform=axes.get_yaxis_transform(), zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6},
        )  # fmt: skip
        for value in profile.crossings(rise):
            if value is not None:
                axes.plot(value, rise, **_CROSSING)
                axes.vlines(value, 0, rise, color=DARK, lw=0.8, ls=":")
    axes.axvline(profile.value, color=DARK, lw=0.8)
    axes.set_xlim(low, high)
    axes.set_ylim(0, _TOP)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(parameter_title(profile.name))
    axes.set_title(_interval(profile), loc="left", fontsize=11, parse_math=False)
    open_axes(axes, "x")


def _range(profile: Profile) -> tuple[float, float]:
    """What is drawn: the curve, and a little beyond a bound that cuts it off."""
    low, high = (float(value) for value in profile.values[[0, -1]])
    margin = 0.05 * (high - low) or profile.sigma
    return low - margin, high + margin


def _interval(profile: Profile) -> str:
    """``0.276 +0.034 −0.025``: the solution and the ends of the 68.3 % interval."""
    ends = profile.crossings(ONE_SIGMA)
    if ends[0] is None or ends[1] is None:
        limits = [
            f"{'>' if side == 0 else '<'} {value:.4g}"
            for side, value in enumerate(ends)
            if value is not None
        ]
        return " ".join([f"{profile.value:.4g}", *(limits and [f"({limits[0]}, 68.3 %)"])])
    below, above = profile.value - ends[0], ends[1] - profile.value
    value = pdg(profile.value, min(below, above))
    if value.startswith("("):
        return f"{profile.value:.4g} +{above:.2g} −{below:.2g}"
    value, _, error = value.partition(" ± ")
    decimals = len(error.partition(".")[2])
    return f"{value} +{above:.{decimals}f} −{below:.{decimals}f}"


def _handles(profiles: Sequence[Profile]) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="profile over all other parameters", **_CURVE),
        Line2D([], [], label="parabola of the standard error", **_PARABOLA),
    ]
    if any(p.prior is not None for p in profiles):
        handles.append(Line2D([], [], label="prior alone", **_PRIOR))
    if any(end is not None for p in profiles for end in p.ends):
        handles.append(Patch(label="beyond the bound", **_BOUND))
    return handles
