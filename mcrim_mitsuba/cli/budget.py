"""``mcrim budget``: where all errors come from, and what the model leaves out."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents


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
@work_options
@options.json_output
def budget(
    campaign,
    material,
    emission,
    wavelength_nm,
    figure,
    photons,
    seed,
    variant,
    threads,
    json_file,
    work,
) -> None:
    """Show where the errors of CAMPAIGN (TOML) come from, and which can be reduced.

    The fit is repeated with every piece of physics that the model leaves out: where the source's
    gammas stop, polarisation, the index of the material, its spread over the emission band, and
    birefringence. What the model can take is a correction, to be made; what one index cannot
    describe is added to the errors.
    """
    from mcrim_mitsuba.inference.budget import budget as run

    showing.refuse_places(json_file, [campaign], figure)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, [*files, *([emission] if emission else [])], figure)
    with work.begin() as report:
        found = run(
            read, material=material, emission=emission, wavelength_nm=wavelength_nm,
            run=Run(photons, seed=seed, threads=threads, variant=variant, progress=report),
        )  # fmt: skip
    terminal.write_json(json_file, documents.of_budget(found))
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.budget_figures import draw_neglected

        drawn = draw_neglected(found).save(figure)
    showing.show(terminal.console(json_file), descriptions.of_budget(found), drawn)
