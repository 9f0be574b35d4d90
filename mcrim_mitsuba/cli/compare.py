"""``mcrim compare``: a campaign beside its model, laid out to show where the model fails."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents
from mcrim_mitsuba.output.findings import fails, together


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@options.figure("readings, predictions and pulls")
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@work_options
@options.json_output
def compare(campaign, figure, photons, seed, variant, threads, json_file, work) -> None:
    """Show where the model of CAMPAIGN (TOML) fails to describe its readings.

    Pulls are (reading - prediction) in standard errors; those from the others compare with a
    fit to all other readings. Suspect readings are named before physics is blamed.
    """
    from mcrim_mitsuba.inference.compare import compare as run

    showing.refuse_places(json_file, [campaign], figure)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, figure)
    with work.begin() as report:
        found = run(read, run=Run(photons, None, seed, threads, variant, report))
    terminal.write_json(json_file, documents.of_comparison(found))
    drawn: tuple[Path, ...] = ()
    if figure:
        from mcrim_mitsuba.output.fit_figures import draw_comparison

        drawn = draw_comparison(found.comparison).save(figure)
    screen = terminal.console(json_file)
    showing.show(screen, descriptions.of_comparison(found), drawn)
    screen.line(_next_step(campaign, read.measurements.path, found.comparison), style="bold")


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
