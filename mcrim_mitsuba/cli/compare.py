"""``mcrim compare``: a campaign beside its model, laid out to show where the model fails."""

from __future__ import annotations

from pathlib import Path

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing
from mcrim_mitsuba.output.findings import fails, together


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("readings, predictions and pulls")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@options.work
@options.json_output
def compare(campaign, figure, json_file, work) -> None:
    """Show where the model of CAMPAIGN (TOML) fails to describe its readings.

    Pulls are (reading - prediction) in standard errors; those from the others compare with a
    fit to all other readings. Suspect readings are named before physics is blamed.
    """
    read, _ = showing.read_campaign(campaign, json_file, figure)
    with work.begin() as run:
        found = mcrim.compare(read, run=run)
    screen = showing.answer(found, json_file, figure)
    screen.line(_next_step(campaign, read.measurements.path, found), style="bold")


def _next_step(campaign: str, measurements: Path, comparison) -> str:
    """What to do about it, in one line."""
    explained = [one for one in comparison.suspects if one.explains]
    if explained:
        mend = (
            "swap them back" if explained[0].kind == "swapped_rows"
            else "repeat it, or leave it out with use = 0"
        )  # fmt: skip
        return (
            f"Next: check {together(explained[0].labels)} in {measurements} ({mend}), then "
            f"{showing.command('compare', campaign)} again; "
            f"or {showing.command('diagnose', campaign)}"
        )
    if comparison.p_value is None or fails(comparison):
        return f"Next: {showing.command('diagnose', campaign)}"
    return (
        f"Next: {showing.command('calibrate', campaign)} for the light yield, or "
        f"{showing.command('diagnose', campaign)} for limits on what could be missing"
    )
