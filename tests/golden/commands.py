"""Runs `python -m mcrim_mitsuba` for several commands in one process: importing takes a second.

    python commands.py CASE.json SHOWN.json

CASE.json lists the commands' arguments; SHOWN.json gets what each showed, and its exit status.
"""

import contextlib
import json
import os
import runpy
import sys
import tempfile
import traceback
from collections.abc import Iterator
from pathlib import Path


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
    asked, answered = map(Path, sys.argv[1:])
    answered.write_text(json.dumps([run(arguments) for arguments in json.loads(asked.read_text())]))
