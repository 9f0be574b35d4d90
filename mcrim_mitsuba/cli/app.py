"""``mcrim app``: the interactive page."""

from __future__ import annotations

import webbrowser

import click

from mcrim_mitsuba.cli import options, showing
from mcrim_mitsuba.cli.terminal import console

#: How long the job that is under way may take to notice that the page is closed.
_PATIENCE_SECONDS = 5.0


@click.command(short_help="Open a campaign in the browser, with sliders and switches.")
@options.campaign
@click.option(
    "--port",
    type=options.Whole(1, 65535),
    metavar="NUMBER",
    help="Where the page is (default: one that is free).",
)
@click.option("--no-browser", is_flag=True, help="Only print the page's address.")
@options.effect_photons
@options.run
def app(campaign, port, no_browser, run) -> None:
    """Open CAMPAIGN (TOML) as a page in the browser, with sliders and switches.

    Every change redraws predictions, pulls, chi2 and the light yield. The page is reached from
    this machine alone, by the address that is printed; Ctrl-C ends it.
    """
    from mcrim_mitsuba.app.access import new_key, serve
    from mcrim_mitsuba.app.exchange import page_folder
    from mcrim_mitsuba.app.page import make_page
    from mcrim_mitsuba.app.session import Session

    read, key, screen = showing.read_campaign(campaign, None), new_key(), console()

    def ready(address: str) -> None:
        screen.line(f"the page is at {address}")
        screen.line("Ctrl-C ends it")
        if not no_browser:
            webbrowser.open(address)

    with page_folder() as folder:
        session = Session(read, run, folder)
        try:
            serve(make_page(session, f"/{key}/"), port=port, key=key, on_ready=ready)
        finally:
            session.jobs.close(_PATIENCE_SECONDS)
