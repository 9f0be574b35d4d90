"""Spectra behind the detector's efficiency and the crystal's absorption."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from mcrim_mitsuba.physics.absorption import Absorption
from mcrim_mitsuba.physics.attenuation import clear_limit
from mcrim_mitsuba.physics.detector_efficiency import SCALE, DetectorEfficiency
from mcrim_mitsuba.physics.rounding import pdg
from mcrim_mitsuba.physics.slab import Index
from mcrim_mitsuba.physics.spectrum import Spectrum

EFFICIENCY_COLUMNS = (
    "wavelength_nm", "emission", "emission_sigma", "quantum_efficiency",
    "quantum_efficiency_sigma", "product", "weighted_mean", "weighted_mean_sigma",
)  # fmt: skip
ABSORPTION_COLUMNS = (
    "spectrum", "wavelength_nm", "transmittance", "transmittance_sigma", "clear_limit",
    "alpha_per_cm", "alpha_sigma_per_cm", "alpha_abs_per_cm", "alpha_abs_sigma_per_cm",
)  # fmt: skip

#: Per spectrum, in turn: colour and line.
_STYLES = ((WARM, "-"), (DARK, "--"), (LIGHT, "-"), (GREY, "-."))
_EMISSION = "#e8c15a"
#: Room over the highest curve, for the legend.
_ROOM = 1.35
#: Of its maximum: where an emission is seen to begin and end.
_SEEN = 0.002


def draw_efficiency(
    path: str | Path, emission: Spectrum, quantum_efficiency: Spectrum, found: DetectorEfficiency
) -> tuple[Path, Path]:
    """Write the figure of Eq. 3 (PNG or PDF) and its numbers (CSV of the same name).

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = efficiency_numbers(emission, quantum_efficiency, found)
    figure = efficiency_figure(emission, quantum_efficiency, found)
    return save(figure, path), write_numbers(path, columns, rows)


def efficiency_numbers(
    emission: Spectrum, quantum_efficiency: Spectrum, found: DetectorEfficiency
) -> Numbers:
    """Columns and rows of the CSV: the points of both curves where both are; emission's highest
    value is 1, and errors stand at the points that have them."""
    rows = []
    highest = float(emission.values.max())
    emitted, detected = (
        {} if curve.sigmas is None
        else dict(zip(curve.wavelength_nm.tolist(), curve.sigmas.tolist(), strict=True))
        for curve in (emission, quantum_efficiency)
    )  # fmt: skip
    for nm in _common(emission, quantum_efficiency).tolist():
        light, share = float(emission.at(nm)) / highest, float(quantum_efficiency.at(nm))
        sigma = emitted[nm] / highest if nm in emitted else None
        rows.append(
            (nm, light, sigma, share, detected.get(nm), light * share, found.value, found.sigma)
        )
    return EFFICIENCY_COLUMNS, rows


@styled
def efficiency_figure(
    emission: Spectrum, quantum_efficiency: Spectrum, found: DetectorEfficiency
) -> Figure:
    """The figure of `draw_efficiency`."""
    figure = canvas(7.2, 4.8)
    axes = figure.add_subplot()
    low, high = _seen(emission)
    curve = quantum_efficiency
    shown = (curve.wavelength_nm >= low) & (curve.wavelength_nm <= high)
    top = 100 * max(float(curve.at(curve.wavelength_nm[shown]).max(initial=0)), found.value)
    top = max(top, *(100 * float(curve.at(np.clip(nm, curve.first_nm, curve.last_nm)))
                     for nm in (low, high)))  # fmt: skip
    axes.set_ylim(0, _ROOM * top)
    axes.set_xlim(low, high)
    _shade_emission(axes, emission, top)
    scale = found.contributions[SCALE] / found.value
    sigmas = np.zeros_like(curve.values) if curve.sigmas is None else curve.sigmas
    band = 100 * np.hypot(sigmas, scale * curve.values)
    percent = 100 * curve.values
    axes.fill_between(
        curve.wavelength_nm, percent - band, percent + band, color=DARK, alpha=0.15, lw=0, zorder=3
    )
    dots = "o" if np.count_nonzero(shown) <= 40 else ""
    axes.plot(
        curve.wavelength_nm, percent, color=DARK, lw=2, marker=dots, ms=4, zorder=4,
        label="quantum efficiency ± error",
    )  # fmt: skip
    grid = _common(emission, curve)
    product = 100 * curve.at(grid) * emission.at(grid) / emission.values.max()
    axes.plot(grid, product, color=WARM, lw=1.8, zorder=4,
              label="emission × quantum efficiency")  # fmt: skip
    mean, sigma = 100 * found.value, 100 * found.sigma
    axes.axhspan(mean - sigma, mean + sigma, color=GREY, alpha=0.15, lw=0, zorder=2)
    axes.axhline(mean, color=GREY, lw=1.4, ls=(0, (5, 2)), zorder=3,
                 label=f"weighted mean {pdg(mean, sigma)} %")  # fmt: skip
    axes.set_xlabel("wavelength, nm")
    axes.set_ylabel("quantum efficiency, %")
    open_axes(axes)
    axes.legend(loc="upper center", ncols=2, fontsize=9.5, frameon=False)
    return figure


def draw_absorption(
    path: str | Path,
    transmittances: Sequence[tuple[str, Spectrum]],
    n: Index,
    found: Absorption,
    emission: Spectrum | None = None,
) -> tuple[Path, Path]:
    """Write the figure of the transmittances (PNG or PDF) and its numbers (CSV of the same name).

    Parameters
    ----------
    path : str or Path
    transmittances : sequence of (str, Spectrum)
        Each with its name; those that `found` was made of, in the same order.
    n : float or callable
        As for `absorption_from_transmittance`.
    found : Absorption
    emission : Spectrum, optional

    Returns
    -------
    tuple of Path
        Figure and numbers.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    columns, rows = absorption_numbers(transmittances, n, found)
    figure = absorption_figure(transmittances, n, found, emission)
    return save(figure, path), write_numbers(path, columns, rows)


def absorption_numbers(
    transmittances: Sequence[tuple[str, Spectrum]], n: Index, found: Absorption
) -> Numbers:
    """Columns and rows of the CSV: the points that the coefficient rests on."""
    rows = []
    for (name, measured), curve in zip(transmittances, found.curves, strict=True):
        limits = _limits(n, curve.wavelength_nm)
        for i, (nm, alpha) in enumerate(zip(curve.wavelength_nm, curve.values, strict=True)):
            rows.append((
                name, float(nm), float(measured.at(nm)), measured.sigma_at(float(nm)),
                float(limits[i]), float(alpha),
                None if curve.sigmas is None else float(curve.sigmas[i]),
                found.alpha_abs_per_cm, found.sigma,
            ))  # fmt: skip
    return ABSORPTION_COLUMNS, rows


@styled
def absorption_figure(
    transmittances: Sequence[tuple[str, Spectrum]],
    n: Index,
    found: Absorption,
    emission: Spectrum | None = None,
) -> Figure:
    """The figure of `draw_absorption`."""
    figure = canvas(7.2, 6.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1))
    low = min(curve.first_nm for curve in found.curves)
    high = max(curve.last_nm for curve in found.curves)
    if emission is not None:
        low, high = max(low, _seen(emission)[0]), min(high, _seen(emission)[1])
    seen_t, seen_alpha = [], []
    for i, ((name, measured), curve) in enumerate(zip(transmittances, found.curves, strict=True)):
        colour, line = _STYLES[i % len(_STYLES)]
        style = {"color": colour, "ls": line, "lw": 1.6, "zorder": 4}
        inside = (curve.wavelength_nm >= low) & (curve.wavelength_nm <= high)
        percent = 100 * measured.at(curve.wavelength_nm)
        above.plot(curve.wavelength_nm, percent, label=shortened(name, 28), **style)
        below.plot(curve.wavelength_nm, curve.values, **style)
        if curve.sigmas is not None:
            below.fill_between(
                curve.wavelength_nm, curve.values - curve.sigmas, curve.values + curve.sigmas,
                color=colour, alpha=0.12, lw=0, zorder=3,
            )  # fmt: skip
        seen_t += percent[inside].tolist()
        seen_alpha += curve.values[inside].tolist()
    fine = np.linspace(low, high, 200)
    limits = 100 * _limits(n, fine)
    above.plot(fine, limits, color=GREY, lw=1.4, ls=(0, (5, 2)), zorder=3,
               label="a sample that absorbs nothing")  # fmt: skip
    alpha, sigma = found.alpha_abs_per_cm, found.sigma
    below.axhspan(alpha - sigma, alpha + sigma, color=GREY, alpha=0.18, lw=0, zorder=2)
    below.axhline(alpha, color=GREY, lw=1.4, zorder=2,
                  label=f"coefficient {pdg(alpha, sigma or None)} /cm")  # fmt: skip
    _frame(above, [*seen_t, *limits.tolist()], low, high)
    _frame(below, [*seen_alpha, alpha - sigma, alpha + sigma, 0.0], low, high)
    if emission is not None:
        for axes in (above, below):
            bottom, top = axes.get_ylim()
            _shade_emission(axes, emission, 0.6 * top + 0.4 * bottom, bottom, "light, relative")
    above.set_ylabel("measured transmittance, %")
    below.set_ylabel("absorption coefficient, 1/cm")
    below.set_xlabel("wavelength, nm")
    for axes in (above, below):
        open_axes(axes)
        legend = axes.legend(loc="upper center", ncols=2, fontsize=9.5, frameon=False)
        for text in legend.get_texts():
            text.set_parse_math(False)
    return figure


def _frame(axes: Axes, values: Sequence[float], low: float, high: float) -> None:
    """Axes that hold values, with room for a legend over them."""
    least, most = min(values), max(values)
    height = (most - least) or 1.0
    axes.set_ylim(least - 0.08 * height, most + 0.45 * height)
    axes.set_xlim(low, high)


def _shade_emission(
    axes: Axes, emission: Spectrum, top: float, bottom: float = 0.0,
    label: str = "emission, relative",
) -> None:  # fmt: skip
    """The emission behind the curves, its maximum at the height `top`."""
    relative = np.maximum(emission.values, 0) / emission.values.max()
    axes.fill_between(
        emission.wavelength_nm, bottom, bottom + (top - bottom) * relative,
        color=_EMISSION, alpha=0.45, lw=0, zorder=1, label=label,
    )  # fmt: skip


def _seen(emission: Spectrum) -> tuple[float, float]:
    """Where an emission begins and ends."""
    seen = np.flatnonzero(emission.values > _SEEN * emission.values.max())
    first, last = max(seen[0] - 1, 0), min(seen[-1] + 1, emission.values.size - 1)
    return float(emission.wavelength_nm[first]), float(emission.wavelength_nm[last])


def _common(first: Spectrum, second: Spectrum) -> np.ndarray:
    """Points of both curves where both are."""
    grid = np.union1d(first.wavelength_nm, second.wavelength_nm)
    low, high = max(first.first_nm, second.first_nm), min(first.last_nm, second.last_nm)
    return grid[(grid >= low) & (grid <= high)]


def _limits(n: Index, wavelength_nm: np.ndarray) -> np.ndarray:
    return clear_limit(n(wavelength_nm) if callable(n) else np.full(wavelength_nm.shape, n))
