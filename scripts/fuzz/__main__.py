"""The command: `python scripts/fuzz`."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))
from shared import markdown

from fuzz.worker import FOUND, READY
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError

#: The readers, see `targets.TARGETS`, which takes its time to load.
NAMES = (
    "scene",
    "measurements",
    "campaign",
    "raw_campaign",
    "campaign_writing",
    "table",
    "spectrum",
    "histogram",
    "relative",
    "typed",
    "chunk",
    "results",
    "adding",
    "commands",
)
_PROGRESS = "progress"
_STATUS = re.compile(r"#(\d+)\s.*\bcov: (\d+)")
_SAVED = re.compile(r"Test unit written to (\S+)")
_EVERY_S = 30.0


@dataclass
class Tally:
    """What fuzzing one reader gave."""

    seconds: float = 0.0
    inputs: int = 0
    coverage: int = 0
    findings: list[str] = field(default_factory=list)


@click.command()
@click.option(
    "--target",
    type=click.Choice(("all", *NAMES)),
    default="all",
    show_default=True,
    help="Which reader.",
)
@click.option(
    "--seconds",
    type=options.Number("NUMBER", 1, 1e6),
    default=600.0,
    show_default=True,
    help="For each reader.",
)
@click.option(
    "-o",
    "--output",
    "folder",
    metavar="FOLDER",
    default="fuzz",
    show_default=True,
    help="Where findings and interesting inputs are kept.",
)
@click.option(
    "--again", metavar="FILE", help="Give the reader this one input, and show what it raises."
)
def main(target: str, seconds: float, folder: str, again: str | None) -> int:
    """Fuzz the readers of scenes, campaigns, tables, results and command lines."""
    if again is not None:
        return _once_more(target, Path(again))
    place = Path(folder).resolve()
    screen = terminal.console()
    rows, broken = [], False
    for name in NAMES if target == "all" else (target,):
        tally = _fuzz(name, seconds, place, screen.line)
        broken = broken or bool(tally.findings)
        for found in tally.findings:
            screen.line(f"{name}: {found}")
        rows.append(
            (
                name,
                f"{tally.seconds:.0f}",
                f"{tally.inputs:,}",
                f"{tally.coverage:,}",
                len(tally.findings),
            )
        )
    head = ("reader", "seconds", "inputs", "edges reached", "findings")
    screen.line("\n".join(markdown(head, rows, range(1, 5))))
    return terminal.OUR_FAULT if broken else terminal.DONE


def _fuzz(name: str, seconds: float, folder: Path, say: Callable[[str], None]) -> Tally:
    """Workers one after another until the time is over: what hangs or eats memory ends one."""
    tally = Tally()
    (folder / name).mkdir(parents=True, exist_ok=True)
    while (left := seconds - tally.seconds) >= 1.0:
        before, start = (tally.inputs, len(tally.findings)), None
        for line in _said_by_worker(name, round(left), folder):
            if line == READY:  # loading and instrumenting the package is not fuzzing
                start = time.monotonic()
            elif found := _STATUS.search(line):
                tally.inputs = before[0] + int(found[1])
                tally.coverage = max(tally.coverage, int(found[2]))
            elif line.startswith(FOUND):
                if (words := line.removeprefix(FOUND)) not in tally.findings:
                    tally.findings.append(words)
                    say(f"{name}: {words}")
            elif found := _SAVED.search(line):
                tally.findings.append(f"hangs, or takes too much memory: {found[1]}")
            elif line == _PROGRESS:
                say(
                    f"{name}: {tally.inputs:,} inputs, {tally.coverage:,} edges, "
                    f"{len(tally.findings)} findings"
                )
        if start is None:
            raise InputError(f"the reader {name} cannot be fuzzed", "install the extra fuzz")
        tally.seconds += time.monotonic() - start
    return tally


def _said_by_worker(name: str, seconds: int, folder: Path) -> Iterator[str]:
    """Lines of one worker, and now and then `_PROGRESS`."""
    worker = Path(__file__).with_name("worker.py")
    command = [sys.executable, str(worker), name, str(seconds), str(folder)]
    last = time.monotonic()
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as process:
        for line in process.stderr:
            yield line.rstrip()
            if time.monotonic() - last > _EVERY_S:
                last = time.monotonic()
                yield _PROGRESS


def _once_more(name: str, path: Path) -> int:
    from fuzz import targets

    if name == "all":
        raise InputError("--again without a reader", "name it with --target")
    data = path.read_bytes()
    start = time.process_time()
    with targets.workplace():
        error = targets.attempt(targets.TARGETS[name], data)
    screen = terminal.console()
    screen.line(f"{time.process_time() - start:.2f} s of processor time")
    if error is not None:
        raise error
    screen.line("read, or refused in one line")
    return terminal.DONE


if __name__ == "__main__":
    sys.exit(terminal.run(main, "fuzz"))
