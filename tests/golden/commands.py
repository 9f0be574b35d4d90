"""Runs `python -m mcrim_mitsuba` for many commands in one process: importing takes a second.

Each line of standard input is one case as JSON: the `folder` and the `cache` to work with, and
the `commands`, lists of arguments. Answered is a line of what each showed, and its exit status.
"""

import contextlib
import faulthandler
import json
import os
import runpy
import sys
import tempfile
import traceback
from collections.abc import Iterator


@contextlib.contextmanager
def into_file(stream) -> Iterator:
    """Let all that is written to a standard stream go to a file, which is yielded."""
    with tempfile.TemporaryFile("w+", encoding="utf-8") as file:
        kept = os.dup(stream.fileno())
        os.dup2(file.fileno(), stream.fileno())
        try:
            yield file
        finally:
            stream.flush()
            os.dup2(kept, stream.fileno())
            os.close(kept)


def run(arguments: list[str]) -> dict:
    with into_file(sys.stdout) as out, into_file(sys.stderr) as err:
        sys.argv = ["mcrim", *arguments]
        try:
            runpy.run_module("mcrim_mitsuba", run_name="__main__", alter_sys=True)
            status = 0
        except SystemExit as end:
            status = end.code
        except BaseException:
            traceback.print_exc()
            status = 1
        sys.stdout.flush()
        sys.stderr.flush()
        out.seek(0)
        err.seek(0)
        return {"status": status or 0, "stdout": out.read(), "stderr": err.read()}


if __name__ == "__main__":
    cases, answers, complaints = (open(os.dup(file), mode) for file, mode in enumerate("rww"))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # what is asked is not for the commands
    for line in cases:
        case = json.loads(line)
        os.chdir(case["folder"])
        os.environ["MCRIM_CACHE"] = case["cache"]
        faulthandler.dump_traceback_later(600, exit=True, file=complaints)
        print(json.dumps([run(words) for words in case["commands"]]), file=answers, flush=True)
        faulthandler.cancel_dump_traceback_later()
