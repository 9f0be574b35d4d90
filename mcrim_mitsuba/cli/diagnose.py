"""``mcrim diagnose``: which effect is missing."""

from __future__ import annotations

from pathlib import Path

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("the ranking of the effects")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@options.work
@options.json_output
def diagnose(campaign, figure, json_file, work) -> None:
    """Rank the catalogue's effects as explanations of a misfit of CAMPAIGN (TOML).

    The campaign is fitted with each effect added in turn, and with pairs where none suffices.
    """
    read, _ = showing.read_campaign(campaign, json_file, figure)
    with work.begin() as run:
        found = mcrim.diagnose(read, run=run)
    screen = showing.answer(found, json_file, figure)
    screen.line(_next_step(campaign, found), style="bold")


def _next_step(campaign: str, diagnosis) -> str:
    """What to do about the verdict, in one line."""
    from mcrim_mitsuba.inference.verdict import ADEQUATE, AMBIGUOUS, MISSING_EFFECT
    from mcrim_mitsuba.output.findings import configuration_text

    path = Path(campaign)
    repair = showing.command("repair", campaign, "-o", path.with_name(f"{path.stem}_mended.toml"))
    if diagnosis.verdict == MISSING_EFFECT:
        return f"Next: {repair}"
    if diagnosis.verdict == ADEQUATE:
        return f"Next: {showing.command('calibrate', campaign)}"
    if diagnosis.verdict == AMBIGUOUS and diagnosis.next_measurements:
        best = configuration_text(diagnosis.next_measurements[0])
        if not diagnosis.next_measurements[0].separates:
            return (
                "Next: nothing that was looked at tells the leading effects apart: look at "
                f"the bench itself, or allow others in [next_measurements]; or {repair}"
            )
        return f"Next: measure {best}, add it to the readings and diagnose again; or {repair}"
    if diagnosis.suspect_readings:
        return f"Next: check the readings named above, then {showing.command('diagnose', campaign)}"
    if diagnosis.verdict == AMBIGUOUS:
        return f"Next: measure more configurations and diagnose again; or {repair}"
    return (
        f"Next: measure more configurations; {showing.command('compare', campaign)} shows the "
        "pattern of the misfit"
    )
