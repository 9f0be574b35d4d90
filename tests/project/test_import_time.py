"""How long it takes to import the package."""

import subprocess
import sys

import pytest

CODE = """
import time; t = time.perf_counter(); import mcrim_mitsuba; t = time.perf_counter() - t
import sys; print(t, *{"numpy", "mitsuba", "click"} & {*sys.modules})
"""


@pytest.mark.alone
def test_importing_is_quick_and_loads_nothing():
    command = [sys.executable, "-c", CODE]
    shown = [subprocess.run(command, capture_output=True, check=True).stdout for _ in range(5)]
    seconds, *loaded = min(line.split() for line in shown)
    assert float(seconds) < 0.1 and loaded == []
