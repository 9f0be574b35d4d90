"""``mcrim calibrate``: fit a campaign."""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("readings with their pulls (and NAME_profiles, the profile likelihoods, and "
                "NAME_budget, the error budget)")  # fmt: skip
@options.photons("2.7e7 for all configurations together", at_most=True)
@options.precision
@options.seed
@options.machine
@options.work
@options.json_output
def calibrate(campaign, figure, json_file, work) -> None:
    """Fit CAMPAIGN (TOML): scattering coefficient (1/cm), light yield (photons per keV).

    A short first look of 262,144 photons per configuration is added to --photons: it shows
    where in alpha_scat, and on which configurations, to spend them. --precision is that of the
    light collection efficiency of every configuration.
    """
    figures = (showing.further_picture(figure, name) for name in ("profiles", "budget"))
    read, _ = showing.read_campaign(campaign, json_file, figure, *figures)
    with work.begin() as run:
        found = mcrim.calibrate(read, run=run)
    showing.answer(found, json_file, figure)
