"""The page's temporary folder: it goes with the page, and those of killed ones with the next."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest
from places import SCENES

PAGE = [
    "-m",
    "mcrim_mitsuba",
    "app",
    SCENES / "camoo4_campaign.toml",
    *"--no-browser --photons 1000 --threads 1".split(),
]


@pytest.mark.skipif(os.name != "posix", reason="folders have no locks there")
def test_what_a_killed_page_leaves_goes_with_the_next_one(tmp_path):
    browser, address = tmp_path / "browser", []
    browser.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/opened.tmp\nmv {tmp_path}/opened*')
    browser.write_text(f"{browser.read_text()} {tmp_path}/arguments\n")
    browser.chmod(0o700)
    with ExitStack() as stack:

        def opened(command=PAGE):
            """A page that is ready, and its folder."""
            before = set(tmp_path.glob("mcrim_app_*"))
            page = subprocess.Popen(
                [sys.executable, *command],
                env=os.environ | {"TMPDIR": str(tmp_path), "BROWSER": f"{browser} %s"},
                stdout=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(page)
            stack.callback(page.kill)
            address.append(page.stdout.readline().removeprefix("the page is at ").strip())
            (folder,) = set(tmp_path.glob("mcrim_app_*")) - before
            return page, folder

        living, kept = opened()
        killed, left = opened()
        (left / "readings.csv").write_text("label,signal,sigma\n")
        killed.kill()
        killed.wait()
        assert left.exists()
        following, own = opened([word for word in PAGE if word != "--no-browser"])
        # the address is in no list of processes: the browser opens a file of the user's alone
        while not (tmp_path / "arguments").exists():
            time.sleep(0.01)
        door = own / "open.html"
        assert (tmp_path / "arguments").read_text() == f"{door.as_uri()}\n"
        assert door.stat().st_mode & 0o777 == 0o600 and address[-1] in door.read_text()
        assert set(tmp_path.glob("mcrim_app_*")) == {kept, own}
        for page in (living, following):
            page.send_signal(signal.SIGINT)
            page.wait(timeout=60)
        assert not any(tmp_path.glob("mcrim_*"))
