"""Raw data described: every step to readings, efficiency and priors, with its errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.rounding import number, p_text, pdg
from mcrim_mitsuba.output.described import (
    Cell,
    Column,
    Described,
    Part,
    Sentence,
    Table,
    measured,
    row,
    shown,
    table,
)

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.raw_data import (
        Mounting,
        RawData,
        ReducedAbsorption,
        ReducedSourceDepth,
    )

_SCATTER = (
    "The error of a reading is the larger of the mountings' scatter and their peaks' own errors; p "
    "below 0.01: mountings differ by more than their peaks' errors, which is usual"
)


def of_reduction(raw: RawData) -> Described:
    """Every step from raw data to readings, efficiency and priors, with its errors."""
    parts: list[Part] = []
    if raw.readings:
        parts += [_peaks(raw), _means(raw), Sentence(_SCATTER)]
    if raw.efficiency is not None:
        found = raw.efficiency.found
        title = "detector efficiency"
        parts += [
            _origins_table(title, "", found.contributions, found.value),
            Sentence(f"detector efficiency {pdg(found.value, found.sigma)}", strong=True),
        ]
    if raw.absorption is not None:
        parts += _absorption(raw.absorption)
    if raw.source_depth is not None:
        parts += _source_depth(raw.source_depth)
    return Described("reduction of raw data", tuple(parts), notes=raw.notes)


def _peaks(raw: RawData) -> Table:
    """Every mounting's peak."""
    columns = ("reading", Column("histogram", left=True), "shape", "centroid", "width",
               "chi2 / ndf", "p")  # fmt: skip
    rows = (
        (reduced.reading.label, *_peak(mounting))
        for reduced in raw.readings.values()
        for mounting in reduced.mountings
    )
    return table("peaks of the histograms", columns, rows)


def _peak(mounting: Mounting) -> tuple[str | Cell, ...]:
    name = mounting.file.name
    if not mounting.use:
        name += " (not used)"
    elif not mounting.consistent:
        name += " (far from the others)"
    peak = mounting.peak
    if peak is None:
        return name, "no peak", "", "", "", ""
    return (
        name, peak.shape, measured(peak.centroid, peak.centroid_sigma),
        measured(peak.width, peak.width_sigma), f"{number(peak.chi2)} / {peak.ndf}",
        shown(peak.p_value, p_text),
    )  # fmt: skip


def _means(raw: RawData) -> Table:
    """What the mountings of a reading make together."""
    columns = ("reading", "signal", "error by scatter", "by the peaks",
               "chi2 / ndf of the mountings", "p")  # fmt: skip
    rows = []
    for reduced in raw.readings.values():
        mean, reading = reduced.combined, reduced.reading
        rows.append(row(
            reading.label if reading.use else f"{reading.label} (not used)",
            measured(reading.signal, reading.sigma),
            shown(mean.scatter_sigma, ".2g"),
            shown(mean.internal_sigma, ".2g"),
            f"{number(mean.chi2)} / {mean.ndf}" if mean.ndf else "",
            "" if mean.p_value is None else shown(mean.p_value, p_text),
            strong=not mean.consistent,
        ))  # fmt: skip
    return table("readings", columns, rows)


def _origins_table(title: str, unit: str, parts: Mapping[str, float], value: float) -> Table:
    """An error by its origins."""
    rows = (
        (
            origin, shown(part, ".2g"),
            Cell(f"{100 * part / value:.2g} %", part / value) if value > 0 else "",
        )
        for origin, part in parts.items()
    )  # fmt: skip
    return table(title, ("origin of the error", unit or "absolute", "relative"), rows)


def _absorption(reduced: ReducedAbsorption) -> Iterator[Part]:
    entry, found = reduced.entry, reduced.found
    names = [path.name for path in entry.files if path is not None]
    if not names and entry.value is not None:
        names = [pdg(entry.value, entry.transmittance_sigma)]
    rows = (
        (name, shown(alpha, ".3g")) for name, alpha in zip(names, found.each_per_cm, strict=True)
    )
    yield table("absorption", ("transmittance", "alpha_abs, 1/cm"), rows)
    parts = {name: part for name, part in found.contributions.items() if part > 0}
    yield _origins_table("", "1/cm", parts, found.alpha_abs_per_cm)
    band = (
        "" if found.spread_band_per_cm is None
        else f"; over the detected light it varies by {found.spread_band_per_cm:.2g}"
    )  # fmt: skip
    yield Sentence(
        f"alpha_abs {pdg(found.alpha_abs_per_cm, found.sigma)} /cm, internal transmittance "
        f"{pdg(found.internal_transmittance, found.internal_transmittance_sigma)} of "
        f"{entry.thickness_mm:g} mm (n = {found.n:.4g}){band}",
        strong=True,
    )


def _source_depth(reduced: ReducedSourceDepth) -> Iterator[Part]:
    found = reduced.found
    parts = {
        "tabulated cross-sections": found.tables_sigma_mm,
        "coherent scattering, a stop or not": found.process_sigma_mm,
    }
    yield _origins_table("where the gammas stop", "mm", parts, found.length_mm)
    yield Sentence(
        f"source depth {pdg(found.length_mm, found.sigma_mm)} mm: {found.energy_keV:g} keV in "
        f"{found.formula}, {found.density_g_per_cm3:g} g/cm3",
        strong=True,
    )
