"""``mcrim lab efficiency``: the detector's efficiency for a scintillator's light."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import Share
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.described import table


@click.command(short_help="Quantum efficiency weighted with an emission spectrum, Eq. 3.")
@click.argument("emission", type=click.Path(path_type=str))
@click.argument("quantum_efficiency", type=click.Path(path_type=str))
@click.option(
    "--scale-sigma", type=Share(), default="5%", show_default=True, metavar="FRACTION",
    help="Relative error that all points of the quantum efficiency share.",
)  # fmt: skip
@options.figure("both curves with their product and the weighted mean")
@options.json_output
def efficiency(emission, quantum_efficiency, scale_sigma, figure, json_file) -> None:
    """Quantum efficiency weighted with an emission spectrum (Eq. 3 of the article).

    \b
    mcrim lab efficiency emission.csv quantum_efficiency.csv

    Both tables have the columns wavelength, value and, where it is known, the value's standard
    error (named sigma). Wavelengths are in nm unless their name says µm, Å, eV or 1/cm, quantum
    efficiencies fractions unless their name says %. Errors of points are independent.
    """
    from mcrim_mitsuba.laboratory.detector_efficiency import detector_efficiency
    from mcrim_mitsuba.optics.spectrum_file import read_spectrum

    showing.refuse_places(json_file, [emission, quantum_efficiency], figure)
    light = read_spectrum(emission, "emission")
    curve = read_spectrum(quantum_efficiency, "quantum_efficiency")
    found = detector_efficiency(light, curve, scale_sigma)
    notes = [*light.notes, *curve.notes, *found.notes]
    terminal.write_json(
        json_file,
        {
            "emission": emission, "quantum_efficiency": quantum_efficiency,
            "scale_sigma": scale_sigma, "detector_efficiency": found.value,
            "detector_efficiency_sigma": found.sigma, "contributions": found.contributions,
            "spread": found.spread, "outside": found.mean.outside, "notes": notes,
        },
    )  # fmt: skip
    drawn: tuple[Path, ...] = ()
    if figure is not None:
        from mcrim_mitsuba.output.laboratory_figures import draw_efficiency

        drawn = draw_efficiency(light, curve, found).save(figure)
    screen = terminal.console(json_file)
    screen.line(
        f"detector efficiency {pdg(found.value, found.sigma)} "
        f"({100 * found.sigma / found.value:.2g} %)",
        style="bold",
    )
    rows = (
        (origin, f"{sigma:.2g}", f"{100 * sigma / found.value:.2g} %")
        for origin, sigma in found.contributions.items()
    )
    screen.show(table("", ("where the error comes from", "error", "relative"), rows))
    screen.line(
        f"over the emission the quantum efficiency varies by {found.spread:.2g} (standard "
        "deviation): the mean is for this emission only"
    )
    showing.say_drawn(screen, drawn)
    screen.say_notes(notes)
