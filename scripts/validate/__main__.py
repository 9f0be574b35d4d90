"""Runs the command: `python scripts/validate`."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])
    from mcrim_mitsuba.cli.terminal import run
    from validate.command import main

    sys.exit(run(main, "validate"))
