"""The command."""

from __future__ import annotations

import click

from trials import closure, hidden, kill, peak


@click.group()
def main() -> None:
    """Is what the package says of itself right?"""


for one in (closure, hidden, kill, peak):
    main.add_command(one.main, one.__name__.rpartition(".")[2])
