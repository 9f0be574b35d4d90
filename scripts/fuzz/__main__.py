"""Runs the command: `python scripts/fuzz`."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])
    from fuzz.command import main
    from mcrim_mitsuba.cli.terminal import run

    sys.exit(run(main, "fuzz"))
