"""How far does it scale? A table of eta by this process, and by workers on this machine.

    python scripts/scaling.py                          # some minutes on an idle machine
    python scripts/scaling.py --couplings 20           # does it work? its numbers are rough

The table, with a simulation per coupling, is made by this process and by 1, 2 and 4 workers of a
Dask cluster on this machine, with one thread each and a cache that is empty. Units that do nothing,
and units that only bring back as many bytes as usual, go the same way: what they take is overhead,
and limits how many workers the command can keep at work. All is printed as Markdown.
"""

from __future__ import annotations

import contextlib
import logging
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from unittest.mock import patch

import click
import numpy as np
from shared import SCENE, markdown

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, Run, processors
from mcrim_mitsuba.efficiency.table import EtaTable, eta_table
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE, RecordCache
from mcrim_mitsuba.runs.cluster import ClusterExecutor, connect
from mcrim_mitsuba.runs.executors import Content, Job, use_executor

WORKERS = (1, 2, 4)
#: Per coupling: a first look and a second stage, which knows better.
PHOTONS = 524_288
#: Units that do nothing.
EMPTY_UNITS = 300
#: Seconds of a unit in a night's job.
NIGHT_S = 5.0


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
    """A table that was made."""

    workers: int  # 0: this process
    seconds: float
    table: EtaTable
    firsts: list[float] = field(default_factory=list)  # seconds of each worker's first unit
    units: list[float] = field(default_factory=list)  # and of others, in the order of their ends
    sizes: list[int] = field(default_factory=list)  # bytes that came back of each


@contextlib.contextmanager
def empty_cache() -> Iterator[None]:
    with (
        tempfile.TemporaryDirectory(prefix="mcrim-scaling-") as folder,
        patch.dict(os.environ, {FOLDER_VARIABLE: folder}),
    ):
        yield


@contextlib.contextmanager
def cluster_of(workers: int) -> Iterator[tuple[ClusterExecutor, str]]:
    """So many workers of one thread on this machine, and the scheduler's address."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=":0",
        memory_limit=0,
        silence_logs=logging.CRITICAL,
    ) as made:
        made.wait_for_workers(workers)
        executor = ClusterExecutor(made.scheduler_address)
        yield executor, made.scheduler_address
        executor.close()


def timed_table(workers: int, couplings: int) -> Timed:
    """The workload, two units per coupling in two stages, by so many workers; 0: this process."""
    from distributed import get_task_stream

    axes = {
        "n_gap": np.linspace(1.2, 1.5, couplings).round(6).tolist(),
        ALPHA_ABS: [0.039],
        ALPHA_SCAT: [0.2, 0.5, 1.0],
    }
    with empty_cache(), contextlib.ExitStack() as around:
        jobs: list[dict] = []
        if workers:
            executor, address = around.enter_context(cluster_of(workers))
            watcher = around.enter_context(connect(address))
            jobs = around.enter_context(get_task_stream(watcher)).data
            around.enter_context(use_executor(executor))
        start = time.perf_counter()
        table = eta_table(SCENE, axes, run=Run(PHOTONS, threads=1))
        made = Timed(workers, time.perf_counter() - start, table)
    known = set()
    for job in sorted(jobs, key=lambda job: job["startstops"][-1]["stop"]):
        (seconds,) = (s["stop"] - s["start"] for s in job["startstops"] if s["action"] == "compute")
        made.sizes.append(job["nbytes"])
        (made.units if job["worker"] in known else made.firsts).append(seconds)
        known.add(job["worker"])
    return made


def overhead(size: int) -> tuple[float, float]:
    """Seconds of a unit that only brings back bytes: one alone, there and back; of many, each."""
    with empty_cache(), cluster_of(1) as (executor, _):

        def seconds(first: int, count: int) -> float:
            cache = RecordCache({"scaling": first})
            start = time.perf_counter()
            for _ in executor.do([Job(NoWork(first + n, size), cache) for n in range(count)]):
                pass
            return time.perf_counter() - start

        seconds(0, 10)  # the worker imports the package
        alone = statistics.median(seconds(1000 + n, 1) for n in range(20))
        return alone, seconds(2000, EMPTY_UNITS) / EMPTY_UNITS


def show_runs(screen: terminal.Screen, runs: list[Timed]) -> bool:
    """Markdown of the measured tables; whether all have the same digits."""
    one = runs[1].seconds
    units = len(runs[1].units) + len(runs[1].firsts)
    rows = []
    for each in runs:
        busy = min(max(each.workers, 1), processors())
        rows.append(
            [
                each.workers or "no cluster",
                f"{each.seconds:.1f}",
                f"{units / each.seconds:.2f}",
                f"{one / each.seconds:.2f}",
                f"{100 * one / each.seconds / busy:.0f} %",
                f"{statistics.mean(each.units):.3f}" if each.units else "",
            ]
        )
    head = ("workers", "seconds", "units/s", "speed-up", "efficiency", "a unit, s")
    screen.line("\n".join(markdown(head, rows, range(6))))
    same = all(each.table.rows == runs[0].table.rows for each in runs)
    screen.line(
        f"\n{units} units, {runs[1].table.photons:,} photons; efficiency: of the processors that "
        f"the workers have; digits: {'the same in all runs' if same else 'NOT THE SAME'}.\n"
    )
    return same


@click.command()
@click.option(
    "--couplings",
    type=options.Whole(8, 10_000),
    default=150,
    show_default=True,
    help="Of the table: each makes two units.",
)
def main(couplings: int) -> int:
    """Measure how the work scales, and print it as Markdown.

    Exit status 1 if the number of workers changed a digit.
    """
    screen = terminal.console()
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    screen.line(f"{processors()} processors, load {load} when it began.\n")
    runs = [timed_table(workers, couplings) for workers in (0, *WORKERS)]
    same = show_runs(screen, runs)
    size = round(statistics.median(runs[1].sizes))
    alone, many = overhead(0)
    _, with_bytes = overhead(size)
    screen.line(
        f"A unit without work: {1000 * alone:.1f} ms there and back, {1000 * many:.1f} ms each of "
        f"{EMPTY_UNITS}; with {size / 1e3:,.0f} kB, as many as usual, {1000 * with_bytes:.1f} ms "
        "each, kept on the disk included. A worker's first unit takes "
        f"{statistics.mean(runs[1].firsts):.1f} s. A command takes in one result after the other: "
        f"of units of {NIGHT_S:g} s it keeps {NIGHT_S / with_bytes:,.0f} workers busy at most.\n"
    )
    return terminal.DONE if same else terminal.OUR_FAULT


if __name__ == "__main__":
    sys.exit(terminal.run(main, "scaling"))
