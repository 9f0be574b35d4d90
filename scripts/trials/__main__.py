"""`python scripts/trials`: see `trials.command`."""

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])
    from trials.command import main

    from mcrim_mitsuba.cli.running import run

    sys.exit(run(main, "trials"))
