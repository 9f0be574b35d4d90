"""``mcrim paper``: every number of the article beside ours."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, showing
from mcrim_mitsuba.core.files import make_folder
from mcrim_mitsuba.output.registry import VerbResult


@click.command(short_help="Reproduce the article: its numbers beside ours.")
@click.option(
    "-o",
    "--output",
    "folder",
    default="mcrim_paper",
    show_default=True,
    type=options.Folder(),
    metavar="FOLDER",
    help="Where the figures go: PNG, PDF and CSV.",
)
@click.option(
    "--photons",
    type=options.PhotonCount(),
    help="Photons of each of four efficiency surfaces (default: 8e6); "
    "single configurations get a tenth.",
)
@options.work
def paper(folder, json_file, work) -> None:
    """Reproduce the article behind the method: its numbers beside ours, and its figures.

    That is V. Alenkov et al., JINST 8 (2013) P06002, with Figs. 3 and 4, and Fig. 2 from
    synthetic histograms. Units are the article's: mm, 1/cm, %, keV, photons per keV.
    """
    from mcrim_mitsuba.article.reproduce import described, document_of, reproduce_article

    # before a minute of simulation, not after it
    make_folder(folder)
    showing.refuse_places(json_file, [])
    with work.begin() as run:
        result = reproduce_article(run=run)
    document = document_of(result, result.draw(folder))
    shown = described(result, folder)
    showing.answer(VerbResult(kind="article", shown=shown, numbers=document), json_file)
