"""Signals that end a job: told as what they are, wherever they come.

A profiler sends them at the first call of a function: amid the import of Mitsuba, in Python that
its C++ calls, in a kernel that is being traced.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path
from signal import SIGINT, SIGTERM

import pytest
from places import cases_of

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import signals_wait

cases = cases_of(__file__)

#: Runs a command that sends itself a signal: its number, where, and the words of the command.
COMMAND = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup, which is heeded
number, place, *sys.argv[1:] = sys.argv[1:]

def send(frame, event, _):
    code = frame.f_code
    if event == "call" and f"{code.co_filename}:{code.co_qualname}".endswith(place):
        sys.setprofile(None)
        os.kill(os.getpid(), int(number))

sys.setprofile(send)
from mcrim_mitsuba.cli.main import main
sys.exit(main())
"""


@cases("name", "place", "verb")
def test_signals_wait_for_mitsuba(scenes, here, name, place, verb):
    number = signal.Signals[name]
    words = [verb[0], str(scenes / "camoo4.xml"), "--threads", "1", *verb[1:]]
    line = [sys.executable, "-c", COMMAND, str(int(number)), place, *words]
    done = subprocess.run(line, stderr=subprocess.PIPE, text=True, check=False)
    said = "mcrim: interrupted before there was a result\n"
    assert (done.returncode, done.stderr.lstrip()) == (128 + number, said)


def test_the_status_is_of_the_signal_where_exec_is_interrupted(here):
    """As it is while a dataclass is made: Python kept the interrupt in mind, and died of SIGINT."""
    Path("job.py").write_text(
        "import click, os, sys\n"
        "from mcrim_mitsuba.cli.terminal import run\n"
        "command = click.command()(lambda: exec('os.kill(os.getpid(), 15); 1'))\n"
        "sys.exit(run(command, 'mcrim'))"
    )
    done = subprocess.run([sys.executable, "-m", "job"], check=False)
    assert done.returncode == 128 + SIGTERM


def test_a_signal_before_the_command_has_begun_ends_it_in_silence():
    code = COMMAND.replace("from mcrim_mitsuba.cli.main", "from mcrim_mitsuba.__main__")
    line = [sys.executable, "-c", code, str(int(SIGINT)), "click/__init__.py:<module>", "--version"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-SIGINT, "", "")


def test_a_signal_that_waits_comes_at_the_end_and_before_all_else():
    received = []

    def handle(number, frame):
        received.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, handle) for number in (SIGINT, SIGTERM)}
    try:
        with pytest.raises(KeyboardInterrupt), signals_wait():
            with signals_wait():
                os.kill(os.getpid(), SIGTERM)
                os.kill(os.getpid(), SIGINT)
            assert not received
            raise InputError("Mitsuba refuses the scene", "mend it")
        assert received == [SIGTERM]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), SIGINT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
