"""The page's temporary folder: it goes with the page, and those of killed ones with the next."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest
from places import SCENES

PAGE = [
    "-m",
    "mcrim_mitsuba",
    "app",
    SCENES / "camoo4_campaign.toml",
    "--no-browser",
    "--photons",
    "1000",
    "--threads",
    "1",
]


@pytest.mark.skipif(os.name != "posix", reason="folders have no locks there")
def test_what_a_killed_page_leaves_goes_with_the_next_one(tmp_path):
    with ExitStack() as stack:

        def opened():
            """A page that is ready, and its folder."""
            before = set(tmp_path.glob("mcrim_app_*"))
            page = subprocess.Popen(
                [sys.executable, *PAGE],
                env=os.environ | {"TMPDIR": str(tmp_path)},
                stdout=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(page)
            stack.callback(page.kill)
            assert "the page is at" in page.stdout.readline()
            (folder,) = set(tmp_path.glob("mcrim_app_*")) - before
            return page, folder

        living, kept = opened()
        killed, left = opened()
        (left / "readings.csv").write_text("label,signal,sigma\n")
        killed.kill()
        killed.wait()
        assert left.exists()
        following, own = opened()
        assert set(tmp_path.glob("mcrim_app_*")) == {kept, own}
        for page in (living, following):
            page.send_signal(signal.SIGINT)
            page.wait(timeout=60)
        assert not any(tmp_path.glob("mcrim_*"))
