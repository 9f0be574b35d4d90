"""The command: `python scripts/trials`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))
from mcrim_mitsuba.cli import terminal

SCRIPTS = "calibrated closure digitiser faults followed formulas hidden kill peak wrapped"


@click.group()
def main() -> None:
    """Is what the package says of itself right?"""


for name in SCRIPTS.split():
    main.add_command(importlib.import_module(f"trials.{name}").main, name)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "trials"))
