"""Standard streams that are closed or full, limits, locales, a folder that is gone: told as such.

Results are all there, or the exit status and one line say that they are not.
"""

import subprocess
import sys
from pathlib import Path

import pytest

MCRIM = f"{sys.executable} -m mcrim_mitsuba"
CLOSED = "mcrim: what standard output goes to: cannot be written (Bad file descriptor); "
FULL = (
    "mcrim: what standard output goes to: cannot be written (No space left on device); "
    "free some space and run it again\n"
)
TOO_LARGE = (
    "mcrim: what standard output goes to: cannot be written (File too large); lift the limit"
)


def typed(line, **environment):
    """What a shell does with a line, `mcrim` in it: status, and both streams."""
    given = [f"export {name}={value}; " for name, value in environment.items()]
    script = "".join(given) + line.replace("mcrim", MCRIM)
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("verb", ["--version", "schema", "simulate {} --photons 1e4 --json a.json"])
@pytest.mark.parametrize(
    ("streams", "status", "said"),
    [
        (">&-", 2, CLOSED),
        (">&- 2>&-", 2, ""),
        pytest.param(
            ">/dev/full",
            2,
            FULL,
            marks=pytest.mark.skipif(
                not Path("/dev/full").exists(), reason="there is no /dev/full"
            ),
        ),
        ("2>&-", 0, ""),
    ],
)
def test_streams_that_take_nothing(scenes, here, verb, streams, status, said):
    done = typed(f"mcrim {verb.format(scenes / 'camoo4.xml')} {streams}")
    assert done.returncode == status and done.stderr.startswith(said)
    assert done.stderr.count("\n") == bool(said)
    # what would be lost is not computed, and what is not lost is there
    assert Path("a.json").exists() == ("simulate" in verb and status == 0)
    assert bool(done.stdout) == (status == 0)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_what_standard_error_does_not_take_costs_no_result(scenes, here):
    line = "mcrim table {} --n-gap 1.0 --photons 1e4 -o - 2>/dev/full"
    done = typed(line.format(scenes / "camoo4.xml"))
    assert done.returncode == 0 and done.stdout.count("\n") == 2
    assert typed("mcrim check nothing.xml 2>/dev/full").returncode == 2


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_is_cut_short_is_no_success(here, unbuffered):
    line = "mkfifo p; cat p >&2 & (ulimit -f 1; mcrim schema >a.json 2>p); x=$?; wait; exit $x"
    done = typed(line, PYTHONUNBUFFERED=unbuffered)
    assert done.returncode == 2 and done.stderr.startswith(TOO_LARGE)
    assert done.stderr.count("\n") == 1


def test_the_locale_posix_has_all_characters(here):
    line = "mcrim lab index CaMoO4 --nm 540"
    usual = typed(line, LC_ALL="C.UTF-8").stdout
    assert not usual.isascii()
    done = typed(line, LC_ALL="POSIX", PYTHONUTF8="0", PYTHONIOENCODING="")
    assert (done.returncode, done.stderr) == (0, "")
    assert all(c in done.stdout for c in usual if c.isalpha())


@pytest.mark.parametrize("verb", ["check", "simulate", "calibrate"])
def test_a_folder_that_is_gone(scenes, here, verb):
    line = f"mkdir gone; cd gone; rmdir ../gone; mcrim {verb} {scenes / 'camoo4.xml'}"
    done = typed(line)
    assert done.returncode == 2 and done.stderr == (
        "mcrim: the folder you are in has been removed; go to another one (cd) and run it again\n"
    )
