"""Two figures of the report's own: the readings, and how their ratio gives the scattering."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mcrim_mitsuba.figures.style import (
    DARK,
    GREY,
    WARM,
    Numbers,
    canvas,
    open_axes,
    shortened,
    styled,
)
from mcrim_mitsuba.files.measurements import Measurements
from mcrim_mitsuba.report.ratio import RatioCurve

_PER_READING, _TALLEST = 0.24, 14.0


@styled
def readings_figure(measurements: Measurements) -> Figure:
    """Every reading with its error, from top to bottom as in the file."""
    readings = measurements.readings
    height = min(1.1 + _PER_READING * len(readings), _TALLEST)
    figure = canvas(7.2, height)
    axes = figure.subplots()
    places = np.arange(len(readings))
    for used, face in ((True, DARK), (False, "white")):
        at = [i for i, reading in enumerate(readings) if reading.use is used]
        if at:
            axes.errorbar(
                [readings[i].signal for i in at], at, xerr=[readings[i].sigma for i in at],
                fmt="o", ms=5.5, color=DARK, mfc=face, capsize=3, lw=1.4,
                label="reading with its error" if used else "not used in the fit",
            )  # fmt: skip
    names = [shortened(reading.label, 40) for reading in readings]
    crowded = height == _TALLEST
    axes.set_yticks(places, names, parse_math=False, fontsize=6 if crowded else 10)
    axes.set_ylim(len(readings) - 0.5, -0.5)
    axes.set_xlim(left=0)
    axes.set_xlabel("signal (unit of the measurement file)")
    open_axes(axes, "both")
    if any(not reading.use for reading in readings):
        axes.legend(frameon=False, fontsize=9.5)
    return figure


def readings_numbers(measurements: Measurements) -> Numbers:
    """The numbers behind `readings_figure`."""
    columns = ("label", "signal", "sigma", "use", "group", "group_sigma", *measurements.columns)
    rows = [
        (
            *(r.label, r.signal, r.sigma, r.use, r.group, r.group_sigma),
            *(r.parameters[name] for name in measurements.columns),
        )
        for r in measurements.readings
    ]
    return columns, rows


@styled
def ratio_figure(curve: RatioCurve) -> Figure:
    """Efficiencies of two configurations against scattering, and the ratio of their signals."""
    figure = canvas(8.4, 3.9)
    left, right = figure.subplots(1, 2)
    names = [shortened(label, 24) for label in curve.labels]
    for eta, name, colour, style in zip(curve.eta.T, names, (WARM, DARK), ("--", "-"), strict=True):
        left.plot(curve.alpha_scat_per_cm, eta, color=colour, ls=style, lw=2, label=name)
    left.set_ylabel("light collection efficiency η")
    left.set_ylim(bottom=0)
    legend = left.legend(frameon=False, fontsize=9.5)
    for text in legend.get_texts():
        text.set_parse_math(False)
    right.axhspan(
        curve.measured - curve.measured_sigma, curve.measured + curve.measured_sigma,
        color="#f2cdb9", lw=0, label="measured, ± 1 standard error",
    )  # fmt: skip
    right.axhline(curve.measured, color=WARM, lw=1.2)
    right.plot(curve.alpha_scat_per_cm, curve.ratio, color=DARK, lw=2, label="simulated")
    right.set_ylabel("ratio of the two signals")
    right.legend(frameon=False, fontsize=9.5)
    for axes in (left, right):
        axes.axvline(curve.solution_per_cm, color=GREY, lw=1.2, ls=":")
        axes.set_xscale("log")
        axes.set_xlabel(r"$α_\mathrm{scat}$ (1/cm); dotted: fitted")
        open_axes(axes)
    return figure


def ratio_numbers(curve: RatioCurve) -> Numbers:
    """The numbers behind `ratio_figure`."""
    columns = ("alpha_scat_per_cm", "eta_first", "eta_second", "ratio", "measured_ratio",
               "measured_ratio_sigma")  # fmt: skip
    rows = [
        (float(alpha), float(first), float(second), float(ratio), curve.measured,
         curve.measured_sigma)
        for alpha, (first, second), ratio in zip(
            curve.alpha_scat_per_cm, curve.eta, curve.ratio, strict=True
        )
    ]  # fmt: skip
    return columns, rows
