"""``mcrim report``: what was measured and found, as one page."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents


@click.command()
@click.argument("campaign", type=click.Path(path_type=str))
@click.option("-o", "--output", "path", metavar="REPORT.html", required=True,
              help="The page; replaces only another HTML file.")  # fmt: skip
@options.photons(showing.PHOTONS, further=showing.FURTHER_PHOTONS)
@options.seed
@options.machine
@work_options
@options.json_output
def report(campaign, path, photons, seed, variant, threads, json_file, work) -> None:
    """Diagnose and mend CAMPAIGN (TOML), and write all that was found as one HTML file.

    It needs no network and opens in any browser; print it to have it as PDF.
    """
    from mcrim_mitsuba.output.report import SUFFIXES, refuse_output
    from mcrim_mitsuba.output.report import report as run

    places = {"--output": (path, SUFFIXES)}
    showing.refuse_places(json_file, [campaign], further=places)
    read, files = showing.read_with_files(campaign)
    showing.refuse_places(json_file, files, further=places)
    refuse_output(path, files)
    with work.begin() as shown:
        found = run(read, path, run=Run(photons, None, seed, threads, variant, shown))
    terminal.write_json(json_file, documents.of_report(found))
    screen = terminal.console(json_file)
    showing.show(screen, descriptions.of_report(found))
    screen.line(f"{found.path} was written: open it in a browser", style="bold")
