"""``mcrim diagnose``: which effect is missing."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("the ranking of the effects")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@work_options
@options.json_output
def diagnose(campaign, figure, photons, seed, variant, threads, json_file, work) -> None:
    """Rank the catalogue's effects as explanations of a misfit of CAMPAIGN (TOML).

    The campaign is fitted with each effect added in turn, and with pairs where none suffices.
    """
    from mcrim_mitsuba.inference.diagnose import diagnose as run

    showing.refuse_places(json_file, [campaign], figure)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, figure)
    with work.begin() as report:
        found = run(read, run=Run(photons, None, seed, threads, variant, report))
    terminal.write_json(json_file, documents.of_diagnosis(found))
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.diagnosis_figures import draw_ranking

        drawn = draw_ranking(found.diagnosis).save(figure)
    screen = terminal.console(json_file)
    showing.show(screen, descriptions.of_diagnosis(found), drawn)
    screen.line(_next_step(campaign, found.diagnosis), style="bold")


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
