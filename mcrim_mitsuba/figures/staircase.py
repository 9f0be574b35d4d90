"""How the error falls while effects are added one by one, and what the results become."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from mcrim_mitsuba.diagnosis.result import RepairStep
from mcrim_mitsuba.figures.labels import parameter_title
from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    PALE,
    WARM,
    Numbers,
    canvas,
    open_axes,
    save,
    shortened,
    styled,
    write_numbers,
)
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.findings import ACCEPTABLE_P, estimate_text, number, p_text
from mcrim_mitsuba.fit.result import LIGHT_YIELD, Calibration, ParameterEstimate
from mcrim_mitsuba.fit.surface import ALPHA_SCAT

COLUMNS = (
    "step", "added", "final_simulation", "chi2", "ndf", "delta_chi2_sigma", "p_value",
    "rms_pull", "left_out_error",
    "light_yield_ph_per_keV", "light_yield_sigma", "scale", "scale_sigma",
    "alpha_scat_per_cm", "alpha_scat_sigma",
)  # fmt: skip

_AS_IT_CAME, _FINAL_SIMULATION = "as it came", "final simulation"
#: From this chi2 per degree of freedom its axis is logarithmic.
_STEEP = 10.0
#: p-values below are drawn there.
_SMALLEST_P = 1e-30
_STEP: dict[str, Any] = {"fmt": "o", "ms": 7}
_FINAL: dict[str, Any] = {"fmt": "D", "ms": 8.5, "mfc": "white", "mew": 2}
#: Width of a character of a step's name, inches.
_PER_CHARACTER = 0.085


@dataclass(frozen=True)
class _Stair:
    """A column of the figure: a step of the repair, or the final simulation.

    Attributes
    ----------
    step : int
    added : str or None
    final : bool
        Whether all effects were simulated together where the fit ended; else their responses
        are added.
    chi2, ndf, p_value, rms_pull, left_out_error, parameters
        As in `RepairStep`; the last two of a fit with all together are not known.
    """

    step: int
    added: str | None
    final: bool
    chi2: float
    ndf: int
    p_value: float | None
    rms_pull: float
    left_out_error: float | None
    delta_chi2_sigma: float | None
    parameters: dict[str, ParameterEstimate]


def draw_staircase(
    path: str | Path, steps: Sequence[RepairStep], final: Calibration | None = None
) -> tuple[Path, Path]:
    """Write the figure (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    steps : sequence of RepairStep
        The first is the campaign as it came.
    final : Calibration, optional
        Of the mended campaign, its effects simulated together where the fit ends; the steps
        add the effects' responses.

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = staircase_numbers(steps, final)
    return save(staircase_figure(steps, final), path), write_numbers(path, columns, rows)


def staircase_numbers(steps: Sequence[RepairStep], final: Calibration | None = None) -> Numbers:
    """Columns and rows of the CSV beside the figure: a step a row, the final fit last."""
    rows = []
    for stair in _stairs_of(steps, final):
        known = [stair.parameters.get(name) for name in (LIGHT_YIELD, SCALE, ALPHA_SCAT)]
        rows.append((
            stair.step, stair.added, stair.final, stair.chi2, stair.ndf,
            stair.delta_chi2_sigma, stair.p_value, stair.rms_pull, stair.left_out_error,
            *(cell for k in known for cell in ((k.value, k.sigma) if k else (None, None))),
        ))  # fmt: skip
    return COLUMNS, rows


def _stairs_of(steps: Sequence[RepairStep], final: Calibration | None) -> list[_Stair]:
    stairs = [
        _Stair(
            s.step, s.added, False, s.chi2, s.ndf, s.p_value, s.rms_pull, s.left_out_error,
            s.delta_chi2_sigma, s.parameters,
        )
        for s in steps
    ]  # fmt: skip
    if final is not None:
        squares = [row.pull**2 for row in final.rows if row.use]
        stairs.append(_Stair(
            steps[-1].step, None, True, final.chi2, final.ndf, final.p_value,
            math.sqrt(sum(squares) / len(squares)), None, None, final.parameters,
        ))  # fmt: skip
    return stairs


def _name(stair: _Stair) -> str:
    if stair.final:
        return _FINAL_SIMULATION
    return _AS_IT_CAME if stair.added is None else f"+ {shortened(stair.added, 30)}"


@styled
def staircase_figure(steps: Sequence[RepairStep], final: Calibration | None = None) -> Figure:
    """The figure of `draw_staircase`."""
    stairs = _stairs_of(steps, final)
    names = [_name(stair) for stair in stairs]
    width = max(9.0, 3.0 + 2.0 * len(stairs))
    figure = canvas(width, 8.6)
    grid = figure.subplots(3, 2, sharex=True)
    per_ndf, p_values, pulls, left_out, light, scattering = grid.ravel()
    _draw_chi2(per_ndf, stairs)
    _draw_p_values(p_values, stairs)
    for axes, title, heights in (
        (pulls, "rms pull", [s.rms_pull for s in stairs]),
        (left_out, "rms error on readings left out", [s.left_out_error for s in stairs]),
    ):
        axes.axhline(1, color=GREY, lw=1, ls="--")
        _stairs(
            axes, stairs, heights, ["not computed" if h is None else number(h) for h in heights]
        )
        axes.set_ylim(bottom=0)
        _title(axes, f"{title} (in σ; dashed: 1)")
    of_light = LIGHT_YIELD if any(LIGHT_YIELD in s.parameters for s in stairs) else SCALE
    _draw_parameter(light, stairs, of_light)
    _draw_parameter(scattering, stairs, ALPHA_SCAT)
    slanted = max(map(len, names)) * _PER_CHARACTER > (width / 2 - 0.8) / len(names)
    for axes in grid[-1]:
        axes.set_xticks(
            range(len(names)), names, rotation=25 if slanted else 0, rotation_mode="anchor",
            ha="right" if slanted else "center", fontsize=10, parse_math=False,
        )  # fmt: skip
        axes.set_xlim(-0.5, len(names) - 0.5)
    return figure


def _draw_chi2(axes: Axes, steps: Sequence[_Stair]) -> None:
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
    _stairs(axes, steps, heights, [f"{number(s.chi2)} / {s.ndf}" for s in steps])
    if highest > _STEEP:
        axes.set_ylim(0.2, 4 * highest)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axes.set_ylim(bottom=0)
    _title(axes, "χ² per degree of freedom (band: 1 ± √(2/ndf))")


def _draw_p_values(axes: Axes, steps: Sequence[_Stair]) -> None:
    """p-values, on a logarithmic axis."""
    heights = [math.nan if s.p_value is None else max(s.p_value, _SMALLEST_P) for s in steps]
    axes.axhline(ACCEPTABLE_P, color=GREY, lw=1, ls="--")
    axes.set_yscale("log")
    _stairs(axes, steps, heights, [p_text(s.p_value) for s in steps])
    lowest = min((math.log10(h) for h in heights if math.isfinite(h)), default=0.0)
    lowest = math.floor(min(lowest, -2.0)) - 1
    # room for numbers above the points, but no ticks: there are no such probabilities
    axes.set_ylim(10.0 ** (1.1 * lowest), 10.0 ** (-0.2 * lowest))
    axes.yaxis.set_major_locator(
        FixedLocator([10.0**power for power in range(0, lowest - 1, -math.ceil(-lowest / 6))])
    )
    axes.yaxis.set_minor_locator(NullLocator())
    _title(axes, f"p-value (dashed: {ACCEPTABLE_P:g})")


def _draw_parameter(axes: Axes, steps: Sequence[_Stair], name: str) -> None:
    """A fitted parameter with its errors; where it is at a bound, without."""
    known = [step.parameters.get(name) for step in steps]
    _title(axes, parameter_title(name))
    if not any(known):
        axes.text(0.5, 0.5, "not fitted", transform=axes.transAxes, ha="center", color=GREY)
        axes.set_yticks([])
        return
    errors = [k.sigma if k and k.at_bound is None else 0.0 for k in known]
    heights = [k.value if k else math.nan for k in known]
    _stairs(axes, steps, heights, [estimate_text(k) if k else "" for k in known], errors)


def _stairs(
    axes: Axes,
    steps: Sequence[_Stair],
    heights: Sequence[float | None],
    texts: Sequence[str],
    errors: Sequence[float] | None = None,
) -> None:
    """One value per step with its number, joined by a staircase."""
    finite = [math.nan if h is None or not math.isfinite(h) else h for h in heights]
    places = range(len(finite))
    axes.plot(places, finite, color=DARK, lw=1.2, drawstyle="steps-mid", zorder=3)
    for place, height, step in zip(places, finite, steps, strict=True):
        axes.errorbar(
            place, height, yerr=None if errors is None else errors[place], color=DARK, ecolor=WARM,
            capsize=4, lw=1.6, zorder=4, **(_FINAL if step.final else _STEP),
        )  # fmt: skip
    tops = finite if errors is None else [h + e for h, e in zip(finite, errors, strict=True)]
    for place, top, text, step in zip(places, tops, texts, steps, strict=True):
        axes.annotate(
            text, (place, top if math.isfinite(top) else axes.get_ylim()[0]),
            (0, 9 if step.final else 7),
            textcoords="offset points", ha="center", fontsize=9.5, parse_math=False, zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )  # fmt: skip
    axes.margins(y=0.28)


def _title(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=11)
    open_axes(axes, "y")
