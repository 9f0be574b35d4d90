"""``mcrim schema``: the JSON schema of campaign files."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.files import refuse_outputs


@click.command()
@click.option("-o", "--output", "path", metavar="FILE.json", default="-", show_default=True,
              help="File to write; - for the screen.")  # fmt: skip
def schema(path) -> None:
    """JSON schema of a campaign (TOML), with which editors complete and explain its entries.

    Even Better TOML, Taplo and others take it by a line at the top of the campaign:
    #:schema FILE.json
    """
    from mcrim_mitsuba.campaign.entries import json_schema

    refuse_outputs({"--output": path})
    terminal.write_json(path, json_schema())
