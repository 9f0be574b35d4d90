"""``python -m mcrim_mitsuba`` is the ``mcrim`` command."""

import sys

from mcrim_mitsuba.cli.main import main

sys.exit(main())
