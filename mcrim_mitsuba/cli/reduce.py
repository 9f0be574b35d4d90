"""``mcrim reduce``: a campaign's raw data as readings, priors and efficiency."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.terminal import Screen, add_literal_row
from mcrim_mitsuba.core.rounding import number, p_text, pdg


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="NEW.toml",
              help="The campaign in plain numbers, its readings beside it (NEW.csv).")  # fmt: skip
@options.figure("the histograms with their peaks (and NAME_spectra, the detector's efficiency, and "
                "NAME_transmittance, the absorption)")  # fmt: skip
@options.json_output
def reduce(campaign, path, figure, json_file) -> None:
    """Reduce the raw data of CAMPAIGN (TOML), every step with its errors.

    Histograms become readings (photons per event; repeated mountings their mean), emission and
    quantum efficiency the detector's efficiency, transmittance the absorption (1/cm), the
    source's gammas the depth of the source (mm). All commands do this by themselves; here it is
    shown.
    """
    from mcrim_mitsuba.campaign.plain import readings_beside, to_json
    from mcrim_mitsuba.campaign.plain import reduce as run

    figures = (figure, *(showing.further_picture(figure, name) for name in _FURTHER))
    written = {}
    if path is not None:
        written = {
            "--output": (path, (".toml",)),
            "the readings of --output": (str(readings_beside(Path(path))), (".csv",)),
        }
    showing.refuse_places(json_file, [campaign], *figures, further=written)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, *figures, further=written)
    showing.refuse_to_replace(written)
    raw = run(read, path).raw
    assert raw is not None  # refused otherwise
    terminal.write_json(json_file, {"campaign": read.path, **to_json(raw), "plain_campaign": path})
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.laboratory_figures import draw_raw_data

        drawn = draw_raw_data(figures, raw)
    screen = terminal.console(json_file)
    _show_histograms(screen, raw)
    if raw.efficiency is not None:
        _show_efficiency(screen, raw.efficiency)
    if raw.absorption is not None:
        _show_absorption(screen, raw.absorption)
    if raw.source_depth is not None:
        _show_source_depth(screen, raw.source_depth)
    showing.say_drawn(screen, drawn)
    screen.say_notes(raw.notes)
    if path is not None:
        screen.line(f"{path} and {readings_beside(Path(path))} were written", style="bold")
    screen.line(f"Next: {showing.command('calibrate', path or campaign)}", style="bold")


_FURTHER = ("spectra", "transmittance")


def _show_histograms(screen: Screen, raw) -> None:
    """Every mounting's peak, then what they make together."""
    if not raw.readings:
        return
    peaks = terminal.table(
        "peaks of the histograms", "reading", "histogram", "shape", "centroid", "width",
        "chi2 / ndf", "p",
    )  # fmt: skip
    peaks.columns[1].justify = "left"
    means = terminal.table(
        "readings", "reading", "signal", "error by scatter", "by the peaks",
        "chi2 / ndf of the mountings", "p",
    )  # fmt: skip
    for reduced in raw.readings.values():
        for mounting in reduced.mountings:
            add_literal_row(peaks, reduced.reading.label, *_peak_cells(mounting))
        combined, reading = reduced.combined, reduced.reading
        add_literal_row(
            means,
            reading.label if reading.use else f"{reading.label} (not used)",
            pdg(reading.signal, reading.sigma),
            "" if combined.scatter_sigma is None else f"{combined.scatter_sigma:.2g}",
            f"{combined.internal_sigma:.2g}",
            f"{number(combined.chi2)} / {combined.ndf}" if combined.ndf else "",
            "" if combined.p_value is None else p_text(combined.p_value),
            style="" if combined.consistent else "bold",
        )
    screen.print(peaks)
    screen.print(means)
    screen.line(_EXPLANATION)


_EXPLANATION = (
    "The error of a reading is the larger of the mountings' scatter and their peaks' own errors; p "
    "below 0.01: mountings differ by more than their peaks' errors, which is usual"
)


def _peak_cells(mounting) -> tuple[str, ...]:
    name = mounting.row.histogram.name
    if not mounting.use:
        name += " (not used)"
    elif not mounting.consistent:
        name += " (far from the others)"
    peak = mounting.peak
    if peak is None:
        return name, "no peak", "", "", "", ""
    return (
        name,
        peak.shape,
        pdg(peak.centroid, peak.centroid_sigma),
        pdg(peak.width, peak.width_sigma),
        f"{number(peak.chi2)} / {peak.ndf}",
        p_text(peak.p_value),
    )


def _show_parts(
    screen: Screen, title: str, unit: str, found: dict[str, float], value: float
) -> None:
    """An error by its origins."""
    table = terminal.table(title, "origin of the error", unit or "absolute", "relative")
    for origin, part in found.items():
        relative = f"{100 * part / value:.2g} %" if value > 0 else ""
        add_literal_row(table, origin, f"{part:.2g}", relative)
    screen.print(table)


def _show_efficiency(screen: Screen, reduced) -> None:
    found = reduced.found
    _show_parts(screen, "detector efficiency", "", found.contributions, found.value)
    screen.line(f"detector efficiency {pdg(found.value, found.sigma)}", style="bold")


def _show_absorption(screen: Screen, reduced) -> None:
    entry, found = reduced.entry, reduced.found
    table = terminal.table("absorption", "transmittance", "alpha_abs, 1/cm")
    names = [path.name for path in entry.files] or [pdg(entry.value, entry.transmittance_sigma)]
    for name, alpha in zip(names, found.each_per_cm, strict=True):
        add_literal_row(table, name, f"{alpha:.3g}")
    screen.print(table)
    parts = {name: part for name, part in found.contributions.items() if part > 0}
    _show_parts(screen, "", "1/cm", parts, found.alpha_abs_per_cm)
    band = (
        "" if found.spread_band_per_cm is None
        else f"; over the detected light it varies by {found.spread_band_per_cm:.2g}"
    )  # fmt: skip
    screen.line(
        f"alpha_abs {pdg(found.alpha_abs_per_cm, found.sigma)} /cm, internal transmittance "
        f"{pdg(found.internal_transmittance, found.internal_transmittance_sigma)} of "
        f"{entry.thickness_mm:g} mm (n = {found.n:.4g}){band}",
        style="bold",
    )


def _show_source_depth(screen: Screen, reduced) -> None:
    found = reduced.found
    parts = {
        "tabulated cross-sections": found.tables_sigma_mm,
        "coherent scattering, a stop or not": found.process_sigma_mm,
    }
    _show_parts(screen, "where the gammas stop", "mm", parts, found.length_mm)
    screen.line(
        f"source depth {pdg(found.length_mm, found.sigma_mm)} mm: {found.energy_keV:g} keV in "
        f"{found.formula}, {found.density_g_per_cm3:g} g/cm3",
        style="bold",
    )
