"""Does a job survive kill -9? It is killed at random moments, run again, and compared.

    python scripts/trials kill                                      # 30 kills of a diagnosis
    python scripts/trials kill --kills 5 --signal TERM -- simulate scenes/camoo4.xml --photons 4e7

Every trial has a cache of its own: the job runs in it, is killed with all its processes at a
moment drawn from the processor time that it takes, which does not depend on who else uses the
machine, and runs again to its end. Its JSON must then be that of an uninterrupted run, but for how
long it took and what the cache had; no finished unit may be made again; and what a kill costs is
one unit per process. All this is read from the job's log, and what was made again from the cache
too: its files have been replaced then.
"""

from __future__ import annotations

import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from shared import SCENES

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.output.description import table
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE

JOB = ("diagnose", str(SCENES / "camoo4_misfit.toml"), "--photons", "65536")
#: What of a result tells how it came about, and may differ.
PASSING = ("seconds", "photons_per_second", "cached_photons", "cached_units")
_PASSING_LINE = re.compile(rf'\s*"({"|".join(PASSING)})": [^\[{{]*')
#: A log's line about a unit.
_UNIT = re.compile(r"unit .*?(begun|made|kept)(?:, ([\d,]+) photons)?, (\S+)$")
#: Seconds between two looks at a job's processor time.
_LOOK_S = 0.01


@dataclass(frozen=True)
class Log:
    """What a run's log says of its units."""

    begun: set[str]
    made: dict[str, int]  # their photons
    kept: set[str]

    @classmethod
    def read(cls, file: Path) -> Log:
        """Empty where there is none; a last line that a kill cut short does not count."""
        found: dict[str, dict[str, int]] = {"begun": {}, "made": {}, "kept": {}}
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        for line in text.split("\n")[:-1]:
            if unit := _UNIT.search(line):
                what, photons, name = unit.groups("0")
                found[what][name] = int(photons.replace(",", ""))
        return cls(set(found["begun"]), found["made"], set(found["kept"]))

    @property
    def lost(self) -> set[str]:
        """Units that were begun and came to nothing."""
        return self.begun - set(self.made) - self.kept


@dataclass(frozen=True)
class Row:
    """What one kill did."""

    trial: int
    killed_s: float  # when, in processor seconds of the job
    status: int  # the exit status of the killed run; negative: of the signal
    stopped_s: float  # from the signal to the end of all its processes
    finished: int  # units that were so then
    begun: int  # units that were under way then, and lost
    lost_photons: int  # theirs, as the next run made them
    remade: int  # finished units that the next run made again: none may be
    again_s: float  # processor seconds of the next run
    same: bool  # is the result that of the uninterrupted run?

    def as_wanted(self, processes: int) -> bool:
        """Whether nothing was lost but what a kill may cost."""
        return self.same and not self.remade and self.begun <= processes


@dataclass(frozen=True)
class Ran:
    """What came of a run."""

    status: int  # negative: of the signal that killed it
    said: str
    log: Log
    processor_s: float
    stopped_s: float  # after the signal; nan without one


class Job:
    """A command of mcrim whose runs can be killed, with a folder for caches and logs."""

    def __init__(self, words: Sequence[str], folder: Path, number: signal.Signals) -> None:
        self._words, self._folder, self._signal = list(words), folder, number
        self._runs = 0

    def cache(self, name: str) -> Path:
        """A new one."""
        cache = self._folder / name
        cache.mkdir()
        return cache

    def run(self, cache: Path, kill_after_s: float | None = None) -> Ran:
        """Run it, to its end or to a kill after so many processor seconds.

        Raises InputError if it fails by itself.
        """
        self._runs += 1
        log = self._folder / f"{self._runs}.log"
        said, complained = (log.with_suffix(suffix) for suffix in (".json", ".err"))
        command = [sys.executable, "-P", "-m", "mcrim_mitsuba", *self._words]
        stopped_s, before_s = float("nan"), _of_children_s()
        # into files: a killed reader's pipe would be one more thing that can go wrong
        with said.open("w") as out, complained.open("w") as err:
            process = subprocess.Popen(
                [*command, "--json", "-", "--log", str(log)],
                stdout=out,
                stderr=err,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                env=os.environ | {FOLDER_VARIABLE: str(cache)},
            )
            try:
                while kill_after_s is not None and process.poll() is None:
                    if _processor_s(process.pid) < kill_after_s:
                        time.sleep(_LOOK_S)
                        continue
                    start = time.perf_counter()
                    os.killpg(process.pid, self._signal)
                    process.wait()
                    stopped_s = time.perf_counter() - start
                process.wait()
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        status, complaint = process.returncode, complained.read_text(encoding="utf-8").strip()
        if status not in (terminal.DONE, -self._signal, 128 + self._signal):
            raise InputError(f"{shlex.join(self._words)} failed: {complaint[-300:]}", "mend it")
        if "Traceback" in complaint:
            raise InputError(f"a killed run had a traceback: {complaint[-300:]}", "mend it")
        used_s = _of_children_s() - before_s
        return Ran(status, said.read_text(encoding="utf-8"), Log.read(log), used_s, stopped_s)


def _processor_s(process: int) -> float:
    """Processor time of a process that runs."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:  # it has ended
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _of_children_s() -> float:
    """Processor time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def lasting(text: str) -> str:
    """A JSON's text without what may differ from run to run."""
    kept = (line for line in text.split("\n") if not _PASSING_LINE.fullmatch(line))
    # the line before one that was left out may end in a comma or not
    return "\n".join(line.removesuffix(",") for line in kept)


def files(cache: Path) -> dict[Path, tuple[int, int]]:
    """What units have left in a cache, with what changes when a file is replaced."""
    statuses = ((file, file.stat()) for file in cache.rglob("*.chunk"))
    return {file: (status.st_ino, status.st_mtime_ns) for file, status in statuses}


def row_of(
    trial: int, moment: float, killed: Ran, before: dict, again: Ran, after: dict, whole: Ran
) -> Row:
    """What a kill did: `before` and `after` are the files before and after the next run."""
    log, log_again = killed.log, again.log
    # some were finished, but for the line in the log
    lost = log.lost - log_again.kept
    # a unit that was under way may have left a part of its files
    jobs = {unit.split("-")[0] for unit in lost}
    replaced = [
        file
        for file, status in before.items()
        if after.get(file) != status and file.parent.name[:8] not in jobs
    ]
    return Row(
        trial,
        float(moment),
        killed.status,
        killed.stopped_s,
        finished=len(log.made) + len(log.kept),
        begun=len(lost),
        lost_photons=sum(log_again.made.get(unit, 0) for unit in lost),
        # the log's word and the files' must agree that nothing was
        remade=max(len(replaced), len(set(log.made) & set(log_again.made))),
        again_s=again.processor_s,
        same=lasting(again.said) == lasting(whole.said),
    )


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("words", nargs=-1, type=click.UNPROCESSED, metavar="[-- VERB...]")
@click.option(
    "--kills", type=options.Whole(1, 10_000), default=30, show_default=True, help="Trials."
)
@click.option(
    "--signal",
    "how",
    type=click.Choice(["KILL", "TERM", "INT"]),
    default="KILL",
    show_default=True,
    help="What kills it.",
)
@click.option(
    "--processes",
    type=options.Whole(1, 1024),
    default=1,
    show_default=True,
    help="Processes of the job that make units: as many units may be lost in a kill.",
)
@options.seed
@options.json_output
def main(words, kills, how, processes, seed, json_file) -> int:
    """Kill a job of mcrim at random moments, run it again and compare.

    VERB is a diagnosis of scenes/camoo4_misfit.toml by default. Exit status 1 if a result was not
    the same, or more was made again than a kill may cost.
    """
    words = words or JOB
    screen = terminal.console(json_file)
    with tempfile.TemporaryDirectory(prefix="mcrim-kill-") as folder:
        job = Job(words, Path(folder), signal.Signals[f"SIG{how}"])
        start = time.perf_counter()
        whole = job.run(job.cache("cache"))
        seconds, photons = time.perf_counter() - start, sum(whole.log.made.values())
        screen.line(
            f"mcrim {shlex.join(words)}: {seconds:.1f} s uninterrupted ({whole.processor_s:.1f} s "
            f"of processors), {len(whole.log.made)} units, {photons:,} photons"
        )
        rows = []
        moments = np.random.default_rng(seed).uniform(0.0, whole.processor_s, kills)
        for trial, moment in enumerate(moments, start=1):
            cache = job.cache(f"cache-{trial}")
            killed = job.run(cache, moment)
            before = files(cache)
            row = row_of(trial, moment, killed, before, job.run(cache), files(cache), whole)
            shutil.rmtree(cache)
            rows.append(row)
            screen.line(
                f"{row.trial:4d}  killed after {row.killed_s:6.1f} s with {row.finished} units "
                f"finished, {row.begun} under way ({row.lost_photons:,} photons); {row.remade} "
                f"made again; {'the same' if row.same else 'ANOTHER'} result"
            )
    terminal.write_json(
        json_file,
        {
            "command": ["mcrim", *words],
            "signal": how,
            "seed": seed,
            "seconds": seconds,
            "processor_s": whole.processor_s,
            "units": len(whole.log.made),
            "photons": photons,
            "rows": [asdict(row) for row in rows],
        },
    )
    _show(screen, rows, how)
    return terminal.DONE if all(row.as_wanted(processes) for row in rows) else terminal.OUR_FAULT


def _show(screen: terminal.Screen, rows: Sequence[Row], how: str) -> None:
    killed = [row for row in rows if row.status != terminal.DONE]
    finished, same = [row.finished for row in rows], sum(row.same for row in rows)
    points = {
        f"killed by SIG{how}": f"{len(killed)} of {len(rows)}",
        "units finished at the kill, least to most": f"{min(finished)} to {max(finished)}",
        "result identical to the uninterrupted one": f"{same} of {len(rows)}",
        "finished units made again": str(sum(row.remade for row in rows)),
        "units lost in a kill, at most": str(max(row.begun for row in rows)),
        "photons lost in a kill, at most": f"{max(row.lost_photons for row in rows):,}",
    }
    if killed:
        slowest = max(row.stopped_s for row in killed)
        points["from the signal to the end, at most"] = f"{slowest:.2f} s"
    screen.show(table("", ("point", "figure"), points.items()))
