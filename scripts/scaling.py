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
import dataclasses
import logging
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from scaling_paper import VERBS, Cost, extrapolate, measure, rows
from scaling_schedule import Times, limit, schedule

from mcrim_mitsuba.cache import RecordCache
from mcrim_mitsuba.cache.location import FOLDER_VARIABLE
from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.cli.running import DONE, OUR_FAULT, run
from mcrim_mitsuba.kernel.variants import DEFAULT_VARIANT
from mcrim_mitsuba.tables import EtaTable, eta_table
from mcrim_mitsuba.work import Content, Task, use_crew
from mcrim_mitsuba.work.cluster import ClusterCrew, connect

SCENE = Path(__file__).parents[1] / "scenes" / "camoo4.xml"
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


@dataclass(frozen=True)
class NoWork:
    """A unit that brings back nothing but bytes.

    Attributes
    ----------
    number : int
    size : int
        Bytes.
    """

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


@dataclass(frozen=True)
class Run:
    """A table that was made.

    Attributes
    ----------
    workers : int
        0: this process.
    seconds : float
    table : EtaTable
    units : list of float
        Seconds of each on a worker, in the order of their ends.
    firsts : list of float
        Those of each worker's first unit.
    sizes : list of int
        Bytes that came back of each.
    """

    workers: int
    seconds: float
    table: EtaTable
    units: list[float]
    firsts: list[float]
    sizes: list[int]


@contextlib.contextmanager
def empty_cache() -> Iterator[None]:
    """A cache of its own."""
    before = os.environ.get(FOLDER_VARIABLE)
    with tempfile.TemporaryDirectory(prefix="mcrim-scaling-") as folder:
        os.environ[FOLDER_VARIABLE] = folder
        try:
            yield
        finally:
            del os.environ[FOLDER_VARIABLE]
            if before is not None:
                os.environ[FOLDER_VARIABLE] = before


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[str]:
    """Address of a scheduler with so many workers of one thread, on this machine."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=":0", memory_limit=0,
        silence_logs=logging.CRITICAL,
    ) as made:  # fmt: skip
        made.wait_for_workers(workers)
        yield made.scheduler_address


def make_table(couplings: int) -> EtaTable:
    """The workload: two units per coupling, in two stages."""
    indices = np.linspace(1.2, 1.5, couplings).round(6).tolist()
    return eta_table(SCENE, [0.2, 0.5, 1.0], 0.039, indices, photons=PHOTONS, threads=1)


def timed_table(workers: int, couplings: int) -> Run:
    """Make it with so many workers; 0 for this process."""
    with empty_cache():
        if not workers:
            start = time.perf_counter()
            table = make_table(couplings)
            return Run(0, time.perf_counter() - start, table, [], [], [])
        from distributed import get_task_stream

        with cluster(workers) as address:
            crew = ClusterCrew(address)
            with connect(address) as watcher, get_task_stream(watcher) as stream:
                start = time.perf_counter()
                with use_crew(crew):
                    table = make_table(couplings)
                seconds = time.perf_counter() - start
            crew.close()
    return Run(workers, seconds, table, *_of_workers(stream.data))


def _of_workers(tasks: Sequence[dict]) -> tuple[list[float], list[float], list[int]]:
    """Seconds of units, of each worker's first, and bytes, from Dask's record of its tasks."""
    units, firsts, sizes, known = [], [], [], set()
    for task in sorted(tasks, key=lambda task: task["startstops"][-1]["stop"]):
        (seconds,) = (
            s["stop"] - s["start"] for s in task["startstops"] if s["action"] == "compute"
        )
        sizes.append(task["nbytes"])
        (units if task["worker"] in known else firsts).append(seconds)
        known.add(task["worker"])
    return units, firsts, sizes


def overhead(workers: int, size: int) -> tuple[float, float]:
    """Seconds of a unit without work: one alone, there and back, and of many, each.

    Parameters
    ----------
    workers : int
    size : int
        Bytes that it brings back.
    """
    with empty_cache(), cluster(workers) as address:
        crew = ClusterCrew(address)

        def seconds(first: int, count: int) -> float:
            cache = RecordCache({"scaling": first})
            start = time.perf_counter()
            for _ in crew.do([Task(NoWork(first + n, size), cache) for n in range(count)]):
                pass
            return time.perf_counter() - start

        seconds(0, 10 * workers)  # workers import the package
        alone = statistics.median(seconds(1000 + n, 1) for n in range(20))
        many = seconds(2000, EMPTY_UNITS) / EMPTY_UNITS
        crew.close()
    return alone, many


def show_machine(screen: output.Screen) -> None:
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    screen.line(f"{os.cpu_count()} processors, load {load} when it began.\n")


def show_runs(screen: output.Screen, runs: Sequence[Run]) -> None:
    """Markdown of the measured tables."""
    one = runs[1].seconds
    units = len(runs[1].units) + len(runs[1].firsts)
    screen.line("| workers | seconds | units/s | speed-up | efficiency | a unit, s |")
    screen.line("|---:|---:|---:|---:|---:|---:|")
    for each in runs:
        at_work = f"{statistics.mean(each.units):.3f}" if each.units else ""
        processors = min(max(each.workers, 1), os.cpu_count() or 1)
        screen.line(
            f"| {each.workers or 'no cluster'} | {each.seconds:.1f} | {units / each.seconds:.2f} "
            f"| {one / each.seconds:.2f} | {100 * one / each.seconds / processors:.0f} % "
            f"| {at_work} |"
        )
    same = all(each.table.rows == runs[0].table.rows for each in runs)
    screen.line(
        f"\n{units} units, {runs[1].table.photons:,} photons; efficiency: of the processors that "
        f"the workers have; digits: {'the same in all runs' if same else 'NOT THE SAME'}.\n"
    )


def show_schedule(screen: output.Screen, runs: Sequence[Run], times: Times) -> None:
    """Markdown of the simulated cluster."""
    known, random = runs[1].units, np.random.default_rng(0)
    half = len(known) // 2
    night = random.choice(np.array(known) / statistics.mean(known) * NIGHT_S, NIGHT_UNITS)
    table = [known[:half], known[half:]]
    # what the client does between units: sums, shares, and the table itself
    own = max(0.0, runs[1].seconds - schedule(1, table, times).seconds) / len(known)
    times = dataclasses.replace(times, gather=times.gather + own)
    jobs = {
        f"the table above, {len(known)} units of {statistics.mean(known):.2f} s in 2 stages": table,
        f"a night's job, {NIGHT_UNITS:,} units of {NIGHT_S:g} s in {NIGHT_STAGES} stages": (
            np.array_split(night, NIGHT_STAGES)
        ),
    }  # fmt: skip
    for name, stages in jobs.items():
        alone = sum(map(sum, stages))
        screen.line(f"Simulated: {name}.\n")
        screen.line("| workers | seconds | speed-up | workers busy | client busy | limited by |")
        screen.line("|---:|---:|---:|---:|---:|---|")
        for workers in SIMULATED_WORKERS:
            found = schedule(workers, stages, times)
            why = limit(found, sum(map(len, stages)), times, len(stages))
            screen.line(
                f"| {workers} | {found.seconds:,.1f} | {alone / found.seconds:.1f} "
                f"| {100 * found.busy:.0f} % | {100 * found.client:.0f} % | {why} |"
            )
        serial = times.submit + times.gather
        screen.line(
            f"\nThe client's {1000 * serial:.1f} ms per unit ({1000 * own:.1f} ms of them for what "
            "the verb itself makes of results) would keep up with "
            f"{alone / sum(map(len, stages)) / serial:,.0f} workers at most.\n"
        )


def show_paper(screen: output.Screen, billion: bool) -> None:
    """Markdown of what many photons take."""
    costs: list[Cost] = []
    for verb in VERBS:
        sizes = (*PAPER_PHOTONS, *([1e9] if billion and verb == "simulate" else []))
        measured = [measure(verb, photons) for photons in sizes]
        lacking = [p for p in (1e9, ON_PAPER) if p > sizes[-1]]
        costs += [*measured, *(extrapolate(measured, photons) for photons in lacking)]
    for line in rows(costs):
        screen.line(line)


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
    screen = output.console()
    show_machine(screen)
    if on_paper:
        show_paper(screen, billion)
        return DONE
    runs = [timed_table(workers, couplings) for workers in (0, *WORKERS)]
    show_runs(screen, runs)
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
    return DONE if all(each.table.rows == runs[0].table.rows for each in runs) else OUR_FAULT


if __name__ == "__main__":
    sys.exit(run(main, "scaling"))
