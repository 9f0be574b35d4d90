"""``mcrim lab gammas``: how deep a source's gammas go into a crystal."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.described import table

_DEPTHS_MM = (1.0, 2.0, 5.0, 10.0)


@click.command(short_help="Depth at which gammas stop in a crystal: a prior.")
@click.argument("formula")
@click.option("--energy-keV", "energy_keV", type=options.Number(), required=True, metavar="KEV",
              help="Energy of the gammas, keV.")  # fmt: skip
@click.option("--density-g-per-cm3", "density", type=options.Number(), metavar="DENSITY",
              help="Density in g/cm3 (default: that of the catalogue's material).")  # fmt: skip
@options.json_output
def gammas(formula, energy_keV, density, json_file) -> None:
    """Where gammas stop in a crystal of a chemical FORMULA: the prior of source_depth_mm.

    \b
    mcrim lab gammas CaMoO4 --energy-keV 59.5

    The length is that in which their number falls to 1/e at normal incidence; slanting gammas
    stop nearer to the surface.
    """
    from mcrim_mitsuba.optics.gammas import SOURCE, attenuation_length_mm

    refuse_outputs({"--json": json_file})
    found = attenuation_length_mm(formula, energy_keV, density)
    stopped = {depth: float(found.stopped_within(depth)) for depth in _DEPTHS_MM}
    parts = {
        "photoelectric": found.photoelectric_per_cm,
        "incoherent": found.incoherent_per_cm,
        "coherent": found.coherent_per_cm,
    }
    terminal.write_json(
        json_file,
        {
            "formula": found.formula, "energy_keV": found.energy_keV,
            "density_g_per_cm3": found.density_g_per_cm3, "length_mm": found.length_mm,
            "length_sigma_mm": found.sigma_mm, "tables_sigma_mm": found.tables_sigma_mm,
            "process_sigma_mm": found.process_sigma_mm,
            "without_coherent_mm": found.without_coherent_mm, "per_cm": found.per_cm,
            "parts_per_cm": parts,
            "stopped": [{"depth_mm": depth, "share": share} for depth, share in stopped.items()],
            "source": SOURCE,
        },
    )  # fmt: skip
    screen = terminal.console(json_file)
    screen.line(
        f"attenuation length {pdg(found.length_mm, found.sigma_mm)} mm: {found.per_cm:.4g} /cm for "
        f"{found.energy_keV:g} keV in {found.formula} of {found.density_g_per_cm3:g} g/cm3",
        style="bold",
    )
    screen.line(
        "of the first interactions "
        + ", ".join(f"{100 * part / found.per_cm:.1f} % are {name}" for name, part in parts.items())
    )
    screen.line(
        f"error: {found.tables_sigma_mm:.2g} mm by the tables, {found.process_sigma_mm:.2g} mm by "
        f"the coherent scattering, without which it is {found.without_coherent_mm:.4g} mm"
    )
    rows = ((f"{depth:g}", f"{100 * share:.1f} %") for depth, share in stopped.items())
    screen.show(table("", ("depth, mm", "stopped within"), rows))
    screen.line(f"source: {SOURCE}")
