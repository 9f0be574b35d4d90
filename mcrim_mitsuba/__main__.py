"""``python -m mcrim_mitsuba`` is the ``mcrim`` command."""

import signal
import sys

# until the command takes them, signals end the process in silence: Python would show what it loads
signal.signal(signal.SIGINT, signal.SIG_DFL)

from mcrim_mitsuba.cli.main import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
