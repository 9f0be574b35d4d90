"""``mcrim budget``: where all errors come from, and what the model leaves out."""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("--material", metavar="NAME",
              help="What the crystal is made of, such as CaMoO4 (default: what the campaign says): "
              "its indices, and how it stops gammas, are then known.")  # fmt: skip
@click.option("--emission", metavar="FILE",
              help="Emission spectrum (default: the campaign's, else a Gaussian band).",
)  # fmt: skip
@click.option("--wavelength-nm", type=options.Number(200, 2000), metavar="NM",
              help="Maximum of that Gaussian band (default: the material's).")  # fmt: skip
@options.figure("the budget, with what the model leaves out")
@options.photons("5e5 of each simulation with another index, fewer for many configurations",
                 further=showing.FURTHER_PHOTONS)  # fmt: skip
@options.seed
@options.machine
@options.work
@options.json_output
def budget(campaign, material, emission, wavelength_nm, figure, json_file, work) -> None:
    """Show where the errors of CAMPAIGN (TOML) come from, and which can be reduced.

    The fit is repeated with every piece of physics that the model leaves out: where the source's
    gammas stop, polarisation, the index of the material, its spread over the emission band, and
    birefringence. What the model can take is a correction, to be made; what one index cannot
    describe is added to the errors.
    """
    read, files = showing.read_campaign(campaign, json_file, figure)
    if emission:
        showing.refuse_places(json_file, [*files, emission], figure)
    with work.begin() as run:
        found = mcrim.budget(
            read, material=material, emission=emission, wavelength_nm=wavelength_nm, run=run
        )
    showing.answer(found, json_file, figure)
