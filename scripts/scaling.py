"""How far does it scale? Workers on this machine, a simulated cluster, and very many photons.

    python scripts/scaling.py                          # some minutes on an idle machine
    python scripts/scaling.py --couplings 20           # does it work? its numbers are rough
    python scripts/scaling.py --photons-on-paper       # what 10^10 photons take

A table of eta with a simulation per coupling is made by this process and by 1, 2 and 4 workers of a
Dask cluster on this machine, with one thread each and a cache that is empty. Units that do nothing,
and units that only bring back as many bytes as usual, go the same way: what they take is overhead.
With the measured times a cluster of any size is simulated. All is printed as Markdown.
"""

from __future__ import annotations

import contextlib
import heapq
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from shared import SCENE, environment, markdown

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, Run
from mcrim_mitsuba.efficiency.table import EtaTable, eta_table
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE, SIZE_VARIABLE, RecordCache
from mcrim_mitsuba.runs.cluster import AHEAD, LEAST_AHEAD, ClusterExecutor, connect
from mcrim_mitsuba.runs.executors import Content, Task, use_executor

WORKERS = (1, 2, 4)
SIMULATED_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128)
#: Per coupling: a first look and a second stage, which knows better.
PHOTONS = 524_288
#: Units that do nothing.
EMPTY_UNITS = 300
#: Units of a night's job, in stages, for the simulated cluster; each takes so many seconds.
NIGHT_UNITS, NIGHT_STAGES, NIGHT_S = 20_000, 2, 5.0
#: Measured; beyond 1.3e8 photons units are larger.
PAPER_PHOTONS = (1e7, 1e8, 4e8)
ON_PAPER = 1e10
VERBS = {
    "simulate": ("simulate", str(SCENE)),
    "table": ("table", str(SCENE), "--alpha-scat", "log:0.1:2:20", "--alpha-abs", "0.039",
              "--n-gap", "1.46"),
}  # fmt: skip


@dataclass(frozen=True)
class NoWork:
    """A unit that brings back nothing but so many bytes."""

    number: int
    size: int
    what: str = "no work"
    photons: int = 1
    variant: str = DEFAULT_VARIANT

    @property
    def numbers(self) -> tuple[int, ...]:
        return (self.number,)

    def check(self, threads: int | None) -> None:
        """Nothing to refuse."""

    def portable(self) -> NoWork:
        return self

    def make(self, threads: int | None) -> dict[int, Content]:
        noise = np.random.default_rng(self.number).integers(0, 256, self.size, np.uint8)
        return {self.number: ({"noise": noise}, {})}


@dataclass
class Timed:
    """A table that was made by so many workers; 0: this process."""

    workers: int
    seconds: float
    table: EtaTable
    firsts: list[float] = field(default_factory=list)  # seconds of each worker's first unit
    units: list[float] = field(default_factory=list)  # and of others, in the order of their ends
    sizes: list[int] = field(default_factory=list)  # bytes that came back of each


@contextlib.contextmanager
def empty_cache() -> Iterator[str]:
    """A cache of its own."""
    with (
        tempfile.TemporaryDirectory(prefix="mcrim-scaling-") as folder,
        environment(FOLDER_VARIABLE, folder),
    ):
        yield folder


@contextlib.contextmanager
def cluster_of(workers: int) -> Iterator[tuple[ClusterExecutor, str]]:
    """So many workers of one thread on this machine, and the scheduler's address."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=":0", memory_limit=0,
        silence_logs=logging.CRITICAL,
    ) as made:  # fmt: skip
        made.wait_for_workers(workers)
        executor = ClusterExecutor(made.scheduler_address)
        yield executor, made.scheduler_address
        executor.close()


def make_table(workers: int, couplings: int) -> Timed:
    """The workload: two units per coupling, in two stages."""
    indices = np.linspace(1.2, 1.5, couplings).round(6).tolist()
    start = time.perf_counter()
    table = eta_table(
        SCENE, {"n_gap": indices, ALPHA_ABS: [0.039], ALPHA_SCAT: [0.2, 0.5, 1.0]},
        run=Run(PHOTONS, threads=1),
    )  # fmt: skip
    return Timed(workers, time.perf_counter() - start, table)


def timed_table(workers: int, couplings: int) -> Timed:
    """Make it with so many workers; 0 for this process."""
    with empty_cache():
        if not workers:
            return make_table(0, couplings)
        from distributed import get_task_stream

        with cluster_of(workers) as (executor, address):
            with connect(address) as watcher, get_task_stream(watcher) as stream:
                with use_executor(executor):
                    made = make_table(workers, couplings)
    known = set()
    for task in sorted(stream.data, key=lambda task: task["startstops"][-1]["stop"]):
        (seconds,) = (
            s["stop"] - s["start"] for s in task["startstops"] if s["action"] == "compute"
        )
        made.sizes.append(task["nbytes"])
        (made.units if task["worker"] in known else made.firsts).append(seconds)
        known.add(task["worker"])
    return made


def overhead(workers: int, size: int) -> tuple[float, float]:
    """Seconds of a unit that only brings back bytes: one alone, there and back; of many, each."""
    with empty_cache(), cluster_of(workers) as (executor, _):

        def seconds(first: int, count: int) -> float:
            cache = RecordCache({"scaling": first})
            start = time.perf_counter()
            for _ in executor.do([Task(NoWork(first + n, size), cache) for n in range(count)]):
                pass
            return time.perf_counter() - start

        seconds(0, 10 * workers)  # workers import the package
        alone = statistics.median(seconds(1000 + n, 1) for n in range(20))
        return alone, seconds(2000, EMPTY_UNITS) / EMPTY_UNITS


class Times(NamedTuple):
    """Measured times in seconds.

    Of the client for a unit: to pack and hand it out; to take in and keep its result. Beside
    these, from the client to the worker and back. Of a worker, before its first unit.
    """

    submit: float
    gather: float
    latency: float
    start: float


class Schedule(NamedTuple):
    """What came of it, and the parts of the time in which workers and the client are at work."""

    workers: int
    seconds: float
    busy: float
    client: float


def schedule(workers: int, stages: Sequence[Sequence[float]], times: Times) -> Schedule:
    """How a cluster with any number of workers would get on.

    The client is one process that does one thing at a time: it hands out a unit, or takes in a
    result and keeps it. It hands out so many units ahead of the first one that is lacking. Stages
    (seconds of their units on a worker of one thread) follow each other. The network and the
    scheduler take some time with each unit, during which they do others too.
    """
    now = client = 0.0
    free = [times.start] * workers  # when each worker can begin
    heapq.heapify(free)
    ahead = max(LEAST_AHEAD, AHEAD * workers)
    for units in stages:
        coming: list[tuple[float, int]] = []  # when results are there for the client
        gathered = np.zeros(len(units), bool)
        first = following = 0
        while first < len(units):
            if following < min(len(units), first + ahead):
                now += times.submit
                client += times.submit
                begin = max(heapq.heappop(free), now + times.latency / 2)
                end = begin + units[following]
                heapq.heappush(free, end)
                heapq.heappush(coming, (end + times.latency / 2, following))
                following += 1
                continue
            arrival, number = heapq.heappop(coming)
            now = max(now, arrival) + times.gather
            client += times.gather
            gathered[number] = True
            while first < len(units) and gathered[first]:
                first += 1
    worked = sum(map(sum, stages))
    return Schedule(workers, now, worked / (workers * now), client / now)


def limit(found: Schedule, units: int, times: Times, stages: int) -> str:
    """Why it is not faster, in words."""
    if found.busy > 0.85:
        return "the workers"
    if found.client > 0.85:
        return "the client, which takes in one result after the other"
    if times.start > 0.3 * found.seconds:
        return "the workers' start"
    if units / stages < 4 * found.workers:
        return "too few units of a stage for so many workers"
    return "waiting for the last units of each stage"


def measure(verb: str, photons: float) -> np.ndarray:
    """Run a verb in a process and a cache of its own; InputError if it fails.

    (6,): photons; seconds, and of processors; MB, the largest resident size; MB and files in the
    cache.
    """
    with empty_cache() as folder, environment(SIZE_VARIABLE, "1000"):
        words = [*VERBS[verb], "--photons", f"{photons:g}"]
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mcrim_mitsuba", *words], stdout=subprocess.DEVNULL
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise InputError(f"mcrim {verb} failed", "see above")
        seconds = time.perf_counter() - start
        sizes = [file.stat().st_size for file in Path(folder).rglob("*.chunk")]
    on_processors, memory_mb = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
    return np.array([photons, seconds, on_processors, memory_mb, sum(sizes) / 1e6, len(sizes)])


def extrapolate(low: np.ndarray, high: np.ndarray, photons: float) -> np.ndarray:
    """A line through two runs, as `measure` gives them."""
    slopes = np.maximum((high - low) / (high[0] - low[0]), 0.0)
    return high + slopes * (photons - high[0])


def paper_row(verb: str, cost: np.ndarray, how: str) -> list[str]:
    """A run, as `measure` gives it, in words."""
    photons, seconds, on_processors, memory_mb, disk_mb, files = cost
    exponent = int(np.log10(photons) + 1e-9)
    factor = photons / 10**exponent
    power = f"10^{exponent}" if abs(factor - 1) < 1e-6 else f"{factor:g}·10^{exponent}"
    disk = f"{disk_mb:.0f} MB" if disk_mb >= 1 else f"{1000 * disk_mb:.0f} kB"
    times = [f"{s:.0f} s" if s < 600 else f"{s / 60:.0f} min" for s in (seconds, on_processors)]
    return [f"`{verb}`", power, how, *times, f"{memory_mb:.0f} MB", disk, f"{files:.0f}"]


def show_runs(screen: terminal.Screen, runs: Sequence[Timed]) -> bool:
    """Markdown of the measured tables; whether all have the same digits."""
    one = runs[1].seconds
    units = len(runs[1].units) + len(runs[1].firsts)
    rows = []
    for each in runs:
        processors = min(max(each.workers, 1), os.cpu_count() or 1)
        rows.append([
            each.workers or "no cluster", f"{each.seconds:.1f}", f"{units / each.seconds:.2f}",
            f"{one / each.seconds:.2f}", f"{100 * one / each.seconds / processors:.0f} %",
            f"{statistics.mean(each.units):.3f}" if each.units else "",
        ])  # fmt: skip
    head = ("workers", "seconds", "units/s", "speed-up", "efficiency", "a unit, s")
    show_table(screen, head, rows, range(6))
    same = all(each.table.rows == runs[0].table.rows for each in runs)
    screen.line(
        f"\n{units} units, {runs[1].table.photons:,} photons; efficiency: of the processors that "
        f"the workers have; digits: {'the same in all runs' if same else 'NOT THE SAME'}.\n"
    )
    return same


def show_table(screen: terminal.Screen, head: Sequence[str], *how) -> None:
    for line in markdown(head, *how):
        screen.line(line)


def show_schedule(screen: terminal.Screen, runs: Sequence[Timed], times: Times) -> None:
    """Markdown of the simulated cluster."""
    known, random = runs[1].units, np.random.default_rng(0)
    half, mean = len(known) // 2, statistics.mean(known)
    night = random.choice(np.array(known) / mean * NIGHT_S, NIGHT_UNITS)
    table = [known[:half], known[half:]]
    # what the client does between units: sums, shares, and the table itself
    own = max(0.0, runs[1].seconds - schedule(1, table, times).seconds) / len(known)
    times = times._replace(gather=times.gather + own)
    of_night = f"a night's job, {NIGHT_UNITS:,} units of {NIGHT_S:g} s in {NIGHT_STAGES} stages"
    jobs = {f"the table above, {len(known)} units of {mean:.2f} s in 2 stages": table}
    for name, stages in (jobs | {of_night: np.array_split(night, NIGHT_STAGES)}).items():
        alone, units = sum(map(sum, stages)), sum(map(len, stages))
        screen.line(f"Simulated: {name}.\n")
        rows = []
        for workers in SIMULATED_WORKERS:
            found = schedule(workers, stages, times)
            rows.append([
                workers, f"{found.seconds:,.1f}", f"{alone / found.seconds:.1f}",
                f"{100 * found.busy:.0f} %", f"{100 * found.client:.0f} %",
                limit(found, units, times, len(stages)),
            ])  # fmt: skip
        head = ("workers", "seconds", "speed-up", "workers busy", "client busy", "limited by")
        show_table(screen, head, rows, range(5))
        serial = times.submit + times.gather
        screen.line(
            f"\nThe client's {1000 * serial:.1f} ms per unit ({1000 * own:.1f} ms of them for what "
            "the verb itself makes of results) would keep up with "
            f"{alone / units / serial:,.0f} workers at most.\n"
        )


def show_paper(screen: terminal.Screen, billion: bool) -> None:
    """Markdown of what many photons take."""
    rows = []
    for verb in VERBS:
        sizes = (*PAPER_PHOTONS, *([1e9] if billion and verb == "simulate" else []))
        measured = [measure(verb, photons) for photons in sizes]
        rows += [paper_row(verb, cost, "measured") for cost in measured]
        for photons in (1e9, ON_PAPER):
            if photons > sizes[-1]:
                cost = extrapolate(*measured[-2:], photons)
                rows.append(paper_row(verb, cost, "extrapolated"))
    head = ("verb", "photons", "", "time", "on processors", "memory", "in the cache", "files")
    show_table(screen, head, rows, (1, *range(3, 8)))


@click.command()
@click.option("--couplings", type=options.Whole(8, 10_000), default=150, show_default=True,
              help="Of the table: each makes two units.")  # fmt: skip
@click.option("--photons-on-paper", "on_paper", is_flag=True,
              help="Measure runs of 1e7 to 4e8 photons instead, and extrapolate to 1e10.",
              )  # fmt: skip
@click.option("--billion", is_flag=True, help="Measure 1e9 photons of `simulate` too.")
def main(couplings: int, on_paper: bool, billion: bool) -> int:
    """Measure how the work scales, and print it as Markdown.

    Exit status 1 if the number of workers changed a digit.
    """
    screen = terminal.console()
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    screen.line(f"{os.cpu_count()} processors, load {load} when it began.\n")
    if on_paper:
        show_paper(screen, billion)
        return terminal.DONE
    runs = [timed_table(workers, couplings) for workers in (0, *WORKERS)]
    same = show_runs(screen, runs)
    size = round(statistics.median(runs[1].sizes))
    alone, many = overhead(1, 0)
    _, with_bytes = overhead(1, size)
    screen.line(
        f"A unit without work: {1000 * alone:.1f} ms there and back, {1000 * many:.1f} ms each of "
        f"{EMPTY_UNITS}; with {size / 1e3:,.0f} kB, as many as usual, {1000 * with_bytes:.1f} ms "
        "each, kept on the disk included. A worker's first unit takes "
        f"{statistics.mean(runs[1].firsts):.1f} s.\n"
    )
    # half of an empty unit's time is its way there
    times = Times(many / 2, with_bytes - many / 2, max(alone - many, 0.0), runs[1].firsts[0])
    show_schedule(screen, runs, times)
    return terminal.DONE if same else terminal.OUR_FAULT


if __name__ == "__main__":
    sys.exit(terminal.run(main, "scaling"))
