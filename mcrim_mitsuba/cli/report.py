"""``mcrim report``: what was measured and found, as one page."""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="REPORT.html", required=True,
              help="The page; replaces only another HTML file.")  # fmt: skip
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@options.work
@options.json_output
def report(campaign, path, json_file, work) -> None:
    """Diagnose and mend CAMPAIGN (TOML), and write all that was found as one HTML file.

    It needs no network and opens in any browser; print it to have it as PDF.
    """
    from mcrim_mitsuba.output.report import SUFFIXES, refuse_output

    read, files = showing.read_campaign(campaign, json_file, further={"--output": (path, SUFFIXES)})
    refuse_output(path, files)
    with work.begin() as run:
        found = mcrim.report(read, path, run=run)
    screen = showing.answer(found, json_file)
    screen.line(f"{found.path} was written: open it in a browser", style="bold")
