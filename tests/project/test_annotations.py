"""What functions say of their arguments holds, as mypy sees it."""

import subprocess
import sys

import pytest
from places import ROOT

pytest.importorskip("mypy", reason="extra test")


def test_types_agree(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
