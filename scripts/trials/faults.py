"""Is anything of the user's lost? Every verb that writes is stopped at random moments, and goes on.

    python scripts/trials faults --trials 200          # kill -9, SIGTERM, SIGINT and a full disk
    python scripts/trials faults --trial 17            # one of them again

A trial has a folder and a cache of its own. Old results lie where the verb writes; it is stopped at
a moment drawn from the time that it takes, by a signal or by a disk that is suddenly full. Then
every result must be the old one or the whole new one, what the verb reads must be as it was, and
status 0 means that all results are there. The same line, run again with room on the disk, must end
well, with the digits of a run that nobody stopped. What fails is told with how to repeat it.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from shared import SCENES

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE
from trials.kill import PASSING

_SCENE, _CAMPAIGN, _RAW = "bench/camoo4.xml", "bench/camoo4_campaign.toml", "bench/camoo4_raw"
_FIT = (_CAMPAIGN, "--photons", "65536", "--json", "a.json", "--figure", "f.png")
_TABLE = ("table", _SCENE, "--alpha-scat", "0.2,0.5", "--n-gap", "1.0,1.46", "--photons", "65536")
#: By name: the lines of a job, one after the other. What is called `new` must not be there before.
JOBS: dict[str, tuple[tuple[str, ...], ...]] = {
    "check": (("check", _SCENE, "-o", "c.svg", "--json", "a.json"),),
    "simulate": (
        (
            "simulate",
            _SCENE,
            "--photons",
            "3e5",
            "--json",
            "a.json",
            "--figure",
            "f.pdf",
            "--times",
            "t.csv",
        ),
    ),
    "table": ((*_TABLE, "-o", "t.nc", "--json", "a.json", "--figure", "f.png"),),
    "parts": (
        *((*_TABLE, "-o", "t.csv", "--unit", f"{k}/2", "--units", "units") for k in (1, 2)),
        ("merge", "units"),
    ),
    "calibrate": (("calibrate", *_FIT),),
    "compare": (("compare", *_FIT),),
    "diagnose": (("diagnose", *_FIT, "--only", "gap_bubble"),),
    "budget": (("budget", *_FIT),),
    "plan": (("lab", "plan", _CAMPAIGN, "--json", "a.json", "--figure", "f.png"),),
    "repair": (
        (
            "repair",
            "bench/five.toml",
            "--effect",
            "gap_bubble",
            "--photons",
            "16384",
            "-o",
            "new.toml",
            "--json",
            "a.json",
            "--figure",
            "f.png",
        ),
    ),
    "report": (("report", _CAMPAIGN, "--photons", "16384", "-o", "r.html", "--json", "a.json"),),
    "reduce": (
        (
            "reduce",
            f"{_RAW}/campaign.toml",
            "-o",
            "new.toml",
            "--json",
            "a.json",
            "--figure",
            "f.png",
        ),
    ),
    "add": (("add", "gap_bubble", _SCENE, "-o", "bench/new.xml"),),
    "scenes": (("scenes", "-o", "new"),),
    "render": (("render", _SCENE, "--samples", "1", "-o", "r.png", "--json", "a.json"),),
    "crosscheck": (("crosscheck", _SCENE, "--photons", "2e4", "--json", "a.json"),),
    "paper": (("paper", "--photons", "2e5", "-o", "figures", "--json", "a.json"),),
    "peak": (
        (
            "lab",
            "peak",
            f"{_RAW}/air_1.csv",
            f"{_RAW}/air_2.csv",
            "--figure",
            "f.png",
            "--json",
            "a.json",
        ),
    ),
    "histogram": (("lab", "histogram", "--mean", "14.3", "-o", "new.csv", "--json", "a.json"),),
}
#: Jobs that are drawn less often than others, for they take longer.
_RARE = {"paper": 0.1, "repair": 0.5, "report": 0.5}
#: Readings of the campaign that is repaired: it has more, which would take longer.
_READINGS = ("label", "air,", "air hole 7", "gel,", "gel hole 7", "water,")
#: A page as well as anything else, so that all verbs replace it.
OLD = b"<html>old</html>\n"
FAULTS = ("KILL", "TERM", "INT", "disk")
#: Of a JSON, what tells how it came about.
_PASSING = (*PASSING, "made")
#: What a run leaves that is no result.
_NO_RESULTS = ("units", "cache")
_ROOM = "64m"
#: A run that takes longer than so many times its usual time hangs.
_PATIENCE = 20.0
#: What tells when a file was made, by its ending.
_DATES = {
    ".pdf": rb"/CreationDate \([^)]*\)",
    ".html": rb"\d+ \w+ \d{4}, \d\d:\d\d UTC|[\d.]+ s\b|[\d,]+ \(?of the cache",
    ".svg": rb"<dc:date>[^<]*|id=\"[^\"]*\"|#[a-z0-9]{10,}",
}


@dataclass(frozen=True)
class Ended:
    """How the lines of a job ended."""

    #: Of the last one that ran; negative: of the signal that killed it.
    status: int
    seconds: float
    complaints: str


@dataclass(frozen=True)
class Trial:
    """What is done to which job."""

    number: int
    job: str
    fault: str
    #: When, as a part of the time that the job takes.
    moment: float


def drawn(seed: int, number: int, jobs: Sequence[str]) -> Trial:
    """The trial of a number, whichever others are made."""
    random = np.random.default_rng([seed, number])
    often = np.array([_RARE.get(job, 1.0) for job in jobs])
    job, fault = random.choice(jobs, p=often / often.sum()), random.choice(FAULTS)
    return Trial(number, str(job), str(fault), float(random.uniform(0.0, 1.0)))


def prepare(folder: Path) -> None:
    """The scenes, and a campaign with fewer readings, in a folder to work in."""
    shutil.copytree(SCENES, folder / "bench")
    text = (SCENES / "camoo4_misfit.toml").read_text(encoding="utf-8")
    (folder / "bench/five.toml").write_text(text.replace("camoo4_misfit.csv", "five.csv"))
    lines = (SCENES / "camoo4_misfit.csv").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if line.startswith(_READINGS)]
    (folder / "bench/five.csv").write_text("\n".join(kept) + "\n")


def run(
    job: str, folder: Path, *, at_s: float = float("inf"), fault: str = "", most_s: float = 600.0
) -> Ended:
    """Run a job's lines in a folder, with a fault after so many seconds."""
    start, status, complaints = time.monotonic(), 0, ""
    environment = os.environ | {FOLDER_VARIABLE: str(folder / "cache")}
    environment.pop("COLUMNS", None)
    limit = _limited if fault == "limit" else None
    with tempfile.TemporaryFile() as said:
        for line in JOBS[job]:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mcrim_mitsuba", *line],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
                preexec_fn=limit,
            )
            try:
                left = max(0.0, at_s - (time.monotonic() - start))
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(min(left, most_s))
                if process.poll() is None:
                    _strike(fault, process.pid, folder)
                    process.wait(most_s)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            status = process.returncode
            if status:
                break
        said.seek(0)
        complaints = said.read().decode(errors="replace")
    return Ended(status, time.monotonic() - start, complaints)


def _strike(fault: str, process: int, folder: Path) -> None:
    if fault == "disk":
        with contextlib.suppress(OSError), (folder / "cache.filling").open("wb", 0) as filling:
            while True:
                filling.write(bytes(1 << 16))
    elif fault != "limit":
        os.killpg(process, signal.Signals[f"SIG{fault}"])


def _limited() -> None:
    """A process whose files cannot become long, where no small disk can be mounted."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))


@contextlib.contextmanager
def place(small: bool) -> Iterator[tuple[Path, bool]]:
    """A folder to work in, and whether it is a disk of its own, if it is to be a small one."""
    with tempfile.TemporaryDirectory(prefix="mcrim-faults-") as name:
        mount = ["mount", "-t", "tmpfs", "-o", f"size={_ROOM}", "tmpfs", name]
        mounted = small and not subprocess.run(mount, capture_output=True, check=False).returncode
        try:
            yield Path(name), mounted
        finally:
            if mounted:
                subprocess.run(["umount", "-l", name], check=True)


def contents(folder: Path) -> dict[str, bytes]:
    """All files by their names, but for what is no result."""
    files = (path for path in folder.rglob("*") if path.is_file())
    named = ((path.relative_to(folder).as_posix(), path) for path in files)
    return {
        name: path.read_bytes()
        for name, path in named
        if not name.startswith(_NO_RESULTS)
        and not path.name.startswith(".mcrim_")
        and "__pycache__" not in name
    }


def digits(name: str, content: bytes) -> Any:
    """What must be the same from run to run."""
    if name.endswith(".json"):
        with contextlib.suppress(ValueError):
            return _lasting(json.loads(content))
    dates = _DATES.get(Path(name).suffix)
    return content if dates is None else re.sub(dates, b"", content)


def _lasting(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lasting(item) for key, item in value.items() if key not in _PASSING}
    if isinstance(value, list):
        # a note on a disk that was full
        return [_lasting(item) for item in value if "cannot be kept" not in str(item)]
    return value


@dataclass(frozen=True)
class Whole:
    """A run that nobody stopped."""

    seconds: float
    #: What was there before.
    inputs: dict[str, bytes]
    results: dict[str, bytes]


def whole_run(job: str) -> Whole:
    """Of a job; raises InputError if it fails by itself."""
    with place(small=False) as (folder, _):
        prepare(folder)
        before = contents(folder)
        ended = run(job, folder)
        after = contents(folder)
    results = {name: content for name, content in after.items() if name not in before}
    if ended.status or not results:
        raise InputError(f"{job} failed: {ended.complaints[-300:]}", "mend it")
    return Whole(ended.seconds, before, results)


def faults_of(trial: Trial, whole: Whole) -> list[str]:
    """What is wrong after a trial; nothing, if all is as it must be."""
    with place(small=trial.fault == "disk") as (folder, mounted):
        prepare(folder)
        old = {name for name in whole.results if "new" not in name}
        for name in old:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(OLD)
        fault = "limit" if trial.fault == "disk" and not mounted else trial.fault
        at_s, most_s = trial.moment * whole.seconds, _PATIENCE * whole.seconds + 60.0
        stopped = run(trial.job, folder, at_s=at_s, fault=fault, most_s=most_s)
        (folder / "cache.filling").unlink(missing_ok=True)
        wrong = list(wrong_results(stopped, whole, contents(folder), old, trial.fault))
        again = run(trial.job, folder, most_s=most_s)
        if again.status:
            wrong.append(f"the same line ended with {again.status}: {again.complaints[-200:]}")
        return wrong + [f"again: {what}" for what in _missing(whole, contents(folder))]


def wrong_results(
    ended: Ended, whole: Whole, found: dict[str, bytes], old: set[str], fault: str
) -> Iterator[str]:
    """What is wrong after the run that was stopped."""
    number = 0 if fault == "disk" else int(signal.Signals[f"SIG{fault}"])
    # 2: a full disk is told; a signal may come before Python has its handlers
    allowed = {0, 2} if fault == "disk" else {0, 128 + number, -number}
    if ended.status not in allowed:
        yield f"status {ended.status}: {ended.complaints[-200:]}"
    if ended.status >= 0 and re.search("Traceback|our fault", ended.complaints):
        yield f"a traceback: {ended.complaints[-200:]}"
    if ended.status == 0:
        yield from (f"status 0, but {what}" for what in _missing(whole, found))
    for name, content in whole.inputs.items():
        if found.get(name) != content:
            yield f"{name}, which is read, is another one"
    for name in old - found.keys():
        yield f"{name} is gone"
    for name, content in found.items():
        if name in whole.results and not (content == OLD and name in old):
            if digits(name, content) != digits(name, whole.results[name]):
                yield f"{name} is neither the old one nor whole ({len(content)} bytes)"


def _missing(whole: Whole, found: dict[str, bytes]) -> Iterator[str]:
    """What is not as after a run that nobody stopped."""
    for name, content in whole.results.items():
        if name not in found:
            yield f"{name} is missing"
        elif digits(name, found[name]) != digits(name, content):
            yield f"{name} is another one"
    for name in found.keys() - whole.results.keys() - whole.inputs.keys():
        yield f"{name} is left over"


def campaign_of(
    trials: Sequence[Trial], say: Callable[[str], None], seed: int = 0
) -> dict[int, list[str]]:
    """What is wrong, by trial; `say` tells each that fails, with how to repeat it."""
    whole: dict[str, Whole] = {}
    failed: dict[int, list[str]] = {}
    for trial in trials:
        if trial.job not in whole:
            whole[trial.job] = whole_run(trial.job)
        if wrong := faults_of(trial, whole[trial.job]):
            failed[trial.number] = wrong
            say(
                f"{trial.job}, {trial.fault} after {trial.moment:.0%} of its time: "
                f"{'; '.join(wrong)}; again: python scripts/trials faults --seed {seed} "
                f"--trial {trial.number}"
            )
    return failed


@click.command()
@click.option(
    "--trials",
    "count",
    type=options.Whole(1, 100_000),
    default=20,
    show_default=True,
    help="Trials.",
)
@click.option("--trial", type=options.Whole(1, 100_000), help="Only the one of this number.")
@click.option("--job", "only", type=click.Choice(sorted(JOBS)), help="Trials of this job alone.")
@options.seed
def main(count, trial, only, seed) -> int:
    """Stop verbs that write at random moments, or fill their disk, and run them again.

    Exit status 1 if anything was lost, cut or another one; each such trial has a line.
    """
    screen, start = terminal.console(), time.monotonic()
    jobs = [only] if only else sorted(JOBS)
    numbers = range(1, count + 1) if trial is None else [trial]
    trials = [drawn(seed, number, jobs) for number in numbers]
    repeated = f" --job {only}" if only else ""
    failed = campaign_of(trials, lambda line: screen.line(line + repeated), seed)
    seconds = (time.monotonic() - start) / len(trials)
    screen.line(f"{len(failed)} of {len(trials)} trials failed; {seconds:.1f} s per trial")
    return terminal.OUR_FAULT if failed else terminal.DONE
