"""How the error falls while effects are added one by one, and what the results become."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from mcrim_mitsuba.diagnosis.result import RepairStep
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    PALE,
    WARM,
    canvas,
    open_axes,
    save,
    shortened,
    styled,
    write_numbers,
)
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.findings import ACCEPTABLE_P, estimate_text, number, p_text
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_SCAT

COLUMNS = (
    "step", "added", "chi2", "ndf", "delta_chi2_sigma", "p_value", "rms_pull", "left_out_error",
    "light_yield_ph_per_keV", "light_yield_sigma", "scale", "scale_sigma",
    "alpha_scat_per_cm", "alpha_scat_sigma",
)  # fmt: skip

_AS_IT_CAME = "as it came"
#: From this chi2 per degree of freedom its axis is logarithmic.
_STEEP = 10.0
#: p-values below are drawn there.
_SMALLEST_P = 1e-30
#: Width of a character of a step's name, inches.
_PER_CHARACTER = 0.085
_TITLES = {
    LIGHT_YIELD: "light yield (photons per keV)",
    SCALE: "scale (signal per efficiency)",
    ALPHA_SCAT: r"$α_\mathrm{scat}$ (1/cm)",
}


def draw_staircase(path: str | Path, steps: Sequence[RepairStep]) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    steps : sequence of RepairStep
        The first is the campaign as it came.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    rows = []
    for step in steps:
        known = [step.parameters.get(name) for name in (LIGHT_YIELD, SCALE, ALPHA_SCAT)]
        rows.append((
            step.step, step.added, step.chi2, step.ndf, step.delta_chi2_sigma, step.p_value,
            step.rms_pull, step.left_out_error,
            *(cell for k in known for cell in ((k.value, k.sigma) if k else (None, None))),
        ))  # fmt: skip
    return save(staircase_figure(steps), path), write_numbers(path, COLUMNS, rows)


@styled
def staircase_figure(steps: Sequence[RepairStep]) -> Figure:
    """The figure of `draw_staircase`."""
    names = [_AS_IT_CAME if s.added is None else f"+ {shortened(s.added, 30)}" for s in steps]
    width = max(9.0, 3.0 + 2.0 * len(steps))
    figure = canvas(width, 8.6)
    grid = figure.subplots(3, 2, sharex=True)
    per_ndf, p_values, pulls, left_out, light, scattering = grid.ravel()
    _draw_chi2(per_ndf, steps)
    _draw_p_values(p_values, steps)
    for axes, title, heights in (
        (pulls, "rms pull", [s.rms_pull for s in steps]),
        (left_out, "rms error on readings left out", [s.left_out_error for s in steps]),
    ):
        axes.axhline(1, color=GREY, lw=1, ls="--")
        _stairs(axes, heights, [number(height) for height in heights])
        axes.set_ylim(bottom=0)
        _title(axes, f"{title} (in σ; dashed: 1)")
    of_light = LIGHT_YIELD if any(LIGHT_YIELD in s.parameters for s in steps) else SCALE
    _draw_parameter(light, steps, of_light)
    _draw_parameter(scattering, steps, ALPHA_SCAT)
    slanted = max(map(len, names)) * _PER_CHARACTER > (width / 2 - 0.8) / len(names)
    for axes in grid[-1]:
        axes.set_xticks(
            range(len(names)), names, rotation=25 if slanted else 0, rotation_mode="anchor",
            ha="right" if slanted else "center", fontsize=10, parse_math=False,
        )  # fmt: skip
        axes.set_xlim(-0.5, len(names) - 0.5)
    return figure


def _draw_chi2(axes: Axes, steps: Sequence[RepairStep]) -> None:
    """chi2 per degree of freedom over the band where a right model's lies in two of three cases."""
    spread = [math.sqrt(2 / s.ndf) if s.ndf > 0 else math.nan for s in steps]
    for place, wide in enumerate(spread):
        axes.fill_between(
            [place - 0.5, place + 0.5], max(1 - wide, 0), 1 + wide, color=PALE, lw=0
        )  # fmt: skip
    heights = [s.chi2 / s.ndf if s.ndf > 0 else math.nan for s in steps]
    highest = max((height for height in heights if math.isfinite(height)), default=1.0)
    if highest > _STEEP:
        axes.set_yscale("log")
    _stairs(axes, heights, [f"{number(s.chi2)} / {s.ndf}" for s in steps])
    if highest > _STEEP:
        axes.set_ylim(0.2, 4 * highest)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axes.set_ylim(bottom=0)
    _title(axes, "χ² per degree of freedom (band: 1 ± √(2/ndf))")


def _draw_p_values(axes: Axes, steps: Sequence[RepairStep]) -> None:
    """p-values, on a logarithmic axis."""
    heights = [math.nan if s.p_value is None else max(s.p_value, _SMALLEST_P) for s in steps]
    axes.axhline(ACCEPTABLE_P, color=GREY, lw=1, ls="--")
    axes.set_yscale("log")
    _stairs(axes, heights, [p_text(s.p_value) for s in steps])
    lowest = min((math.log10(h) for h in heights if math.isfinite(h)), default=0.0)
    lowest = math.floor(min(lowest, -2.0)) - 1
    # room for numbers above the points, but no ticks: there are no such probabilities
    axes.set_ylim(10.0 ** (1.1 * lowest), 10.0 ** (-0.2 * lowest))
    axes.yaxis.set_major_locator(
        FixedLocator([10.0**power for power in range(0, lowest - 1, -math.ceil(-lowest / 6))])
    )
    axes.yaxis.set_minor_locator(NullLocator())
    _title(axes, f"p-value (dashed: {ACCEPTABLE_P:g})")


def _draw_parameter(axes: Axes, steps: Sequence[RepairStep], name: str) -> None:
    """A fitted parameter with its errors; where it is at a bound, without."""
    known = [step.parameters.get(name) for step in steps]
    _title(axes, _TITLES[name])
    if not any(known):
        axes.text(0.5, 0.5, "not fitted", transform=axes.transAxes, ha="center", color=GREY)
        axes.set_yticks([])
        return
    errors = [k.sigma if k and k.at_bound is None else 0.0 for k in known]
    heights = [k.value if k else math.nan for k in known]
    _stairs(axes, heights, [estimate_text(k) if k else "" for k in known], errors)


def _stairs(
    axes: Axes,
    heights: Sequence[float],
    texts: Sequence[str],
    errors: Sequence[float] | None = None,
) -> None:
    """One value per step with its number, joined by a staircase."""
    finite = [height if math.isfinite(height) else math.nan for height in heights]
    places = range(len(finite))
    axes.plot(places, finite, color=DARK, lw=1.2, drawstyle="steps-mid", zorder=3)
    axes.errorbar(
        places, finite, yerr=errors, fmt="o", ms=7, color=DARK, ecolor=WARM, capsize=4, lw=1.6,
        zorder=4,
    )  # fmt: skip
    tops = finite if errors is None else [h + e for h, e in zip(finite, errors, strict=True)]
    for place, top, text in zip(places, tops, texts, strict=True):
        axes.annotate(
            text, (place, top if math.isfinite(top) else axes.get_ylim()[0]), (0, 7),
            textcoords="offset points", ha="center", fontsize=9.5, parse_math=False, zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )  # fmt: skip
    axes.margins(y=0.28)


def _title(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=11)
    open_axes(axes, "y")
