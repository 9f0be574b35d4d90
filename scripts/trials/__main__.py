"""The command: `python scripts/trials`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))
from mcrim_mitsuba.cli import terminal
from trials import (
    calibrated,
    closure,
    digitiser,
    faults,
    followed,
    formulas,
    hidden,
    kill,
    peak,
    wrapped,
)


@click.group()
def main() -> None:
    """Is what the package says of itself right?"""


for one in (
    calibrated,
    closure,
    digitiser,
    faults,
    followed,
    formulas,
    hidden,
    kill,
    peak,
    wrapped,
):
    main.add_command(one.main, one.__name__.rpartition(".")[2])


if __name__ == "__main__":
    sys.exit(terminal.run(main, "trials"))
