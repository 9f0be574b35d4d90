"""How fast is it? Our transport, the NumPy tracer and Geant4 on the same bench, in one run.

    python scripts/benchmark.py             # some minutes, on an idle machine
    python scripts/benchmark.py --quick     # does it work? half a minute; its numbers are rough

The first part compares how fast photons are followed, and how fast a precision of eta is reached.
The second compares a table of eta from reweighted photons with one simulation per point.
All use every processor core. Start-up and the compilation of kernels are timed apart.
"""

from __future__ import annotations

import dataclasses
import functools
import multiprocessing
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from benchmark_table import TARGET, TableRace, race_the_table, show_race

from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import refuse_outputs
from mcrim_mitsuba.fit.proposals import Proposals
from mcrim_mitsuba.geant4 import Geant4Error, is_installed, trace_geant4
from mcrim_mitsuba.kernel.lane_plan import LANES, UNITS
from mcrim_mitsuba.kernel.records import Recorder
from mcrim_mitsuba.kernel.simulation import Simulation, versions
from mcrim_mitsuba.tracer import Bench, trace

SCENE = Path(__file__).parents[1] / "scenes" / "camoo4.xml"
COUPLINGS = {"air": 1.0, "gel": 1.46}
OURS = "ours"
#: Relative standard error of eta, the time to which is compared.
GOAL = 0.001
#: Photons of an engine's first runs, the very first of which compiles its kernels.
FIRST_PHOTONS, FIRST_PHOTONS_SLOW = 1_000_000, 20_000
#: Records are kept in memory, from launches of this size.
MOST_RECORDED_PHOTONS, RECORDED_PER_LAUNCH = 10_000_000, 128 * LANES


@dataclass(frozen=True)
class Effort:
    """How much time is spent.

    Attributes
    ----------
    rounds : int
        Timed runs of every engine; engines take turns, so that all share the machine's moods.
    seconds : float
        That a timed run lasts, about.
    precision : float
        Relative standard error of the table.
    separate : int or None
        Separate points per absorption and coupling, evenly spread over alpha_scat and with its
        two ends; all when None.
    """

    rounds: int
    seconds: float
    precision: float
    separate: int | None


QUICK = Effort(rounds=1, seconds=0.4, precision=0.01, separate=2)
FULL = Effort(rounds=5, seconds=2.0, precision=0.001, separate=6)


@dataclass(frozen=True)
class Sample:
    """One run: photons, wall time of following them (s), eta and its standard error."""

    photons: int
    seconds: float
    eta: float
    eta_sigma: float


Run = Callable[[int, int], Sample]


@dataclass
class Engine:
    """One way to simulate the bench.

    Attributes
    ----------
    coupling, name : str
    run : callable
        ``run(photons, seed)``.
    photons : int
        Of a timed run.
    start_up_s : float
        Wall time until the first photons are done.
    samples : list of Sample
    """

    coupling: str
    name: str
    run: Run
    photons: int
    start_up_s: float
    samples: list[Sample] = dataclasses.field(default_factory=list)

    @property
    def photons_per_s(self) -> float:
        return statistics.median(s.photons / s.seconds for s in self.samples)

    @property
    def eta(self) -> float:
        return sum(s.photons * s.eta for s in self.samples) / self._all_photons

    @property
    def eta_sigma(self) -> float:
        squares = sum((s.photons * s.eta_sigma) ** 2 for s in self.samples)
        return squares**0.5 / self._all_photons

    @property
    def variance_per_photon(self) -> float:
        """Relative variance of eta from one photon: sigma^2 N / eta^2."""
        return (self.eta_sigma / self.eta) ** 2 * self._all_photons

    @property
    def goal_s(self) -> float:
        """Seconds until eta is known to `GOAL`."""
        return self.variance_per_photon / GOAL**2 / self.photons_per_s

    @property
    def _all_photons(self) -> int:
        return sum(s.photons for s in self.samples)


def _ours(coupling: str, *, polarization: bool = False, general: bool = False) -> Run:
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling], "polarization": polarization})

    def run(photons: int, seed: int) -> Sample:
        found = simulation.collect(photons, seed=seed, general=general)
        if found.interrupted:
            raise KeyboardInterrupt
        return Sample(found.photons, found.seconds, found.eta, found.eta_sigma)

    return run


def _ours_recording(coupling: str) -> Run:
    """Photons drawn as in a plain run, with what reweighting needs kept of each."""
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling]})
    own = simulation.file.parameters
    drawn = Proposals((own["alpha_scat_per_cm"],), (UNITS,), own["alpha_abs_per_cm"])

    recorder = Recorder(simulation)

    def run(photons: int, seed: int) -> Sample:
        photons = min(photons, MOST_RECORDED_PHOTONS)
        launches = -(-photons // RECORDED_PER_LAUNCH)
        size = -(-photons // (launches * LANES)) * LANES
        begin = time.perf_counter()
        kept = [recorder.record(drawn, size, seed=seed, number=n) for n in range(launches)]
        seconds = time.perf_counter() - begin
        per_batch = sum(np.bincount(part.batch, part.w, part.batches) for part in kept)
        sigma = per_batch.std(ddof=1) * len(per_batch) ** 0.5 / (launches * size)
        return Sample(launches * size, seconds, per_batch.sum() / (launches * size), sigma)

    return run


def _numpy(coupling: str, *, pool) -> Run:
    bench = Bench(n_gap=COUPLINGS[coupling])

    def run(photons: int, seed: int) -> Sample:
        cores = os.cpu_count() or 1
        share = -(-photons // cores)
        jobs = [(bench, share, seed * cores + core) for core in range(cores)]
        begin = time.perf_counter()
        found = pool.starmap(trace, jobs, chunksize=1)
        seconds = time.perf_counter() - begin
        eta = statistics.fmean(part.eta for part in found)
        sigma = sum(part.eta_sigma**2 for part in found) ** 0.5 / cores
        return Sample(share * cores, seconds, eta, sigma)

    return run


def _geant4(coupling: str) -> Run:
    bench = Bench(n_gap=COUPLINGS[coupling])

    def run(photons: int, seed: int) -> Sample:
        found = trace_geant4(bench, photons, seed)
        return Sample(found.photons, found.seconds, found.eta, found.eta_sigma)

    return run


@contextmanager
def _workers() -> Iterator:
    """One process per core, ready; an interrupt is for this process to handle."""
    context = multiprocessing.get_context("spawn")
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with context.Pool(os.cpu_count() or 1, signal.signal, ignore) as pool:
        yield pool


def _prepare(
    coupling: str, name: str, make: Callable[[str], Run], first: int, effort: Effort
) -> Engine:
    """Start an engine, and find how many photons a timed run takes."""
    begin = time.perf_counter()
    run = make(coupling)
    run(FIRST_PHOTONS_SLOW, 0)
    start_up_s = time.perf_counter() - begin
    sample = run(first, 1)
    if sample.seconds < effort.seconds / 4.0:
        sample = run(round(first * effort.seconds / 4.0 / sample.seconds), 1)
    wanted = sample.photons * effort.seconds / sample.seconds
    return Engine(coupling, name, run, max(first, round(wanted)), start_up_s)


def measure_engines(effort: Effort, report) -> list[Engine]:
    """Time all engines with both couplings."""
    with _workers() as pool:
        slow = FIRST_PHOTONS_SLOW
        makers = {
            OURS: (_ours, FIRST_PHOTONS),
            "ours, polarised": (functools.partial(_ours, polarization=True), FIRST_PHOTONS),
            "ours, records kept": (_ours_recording, FIRST_PHOTONS),
            "ours, general path": (functools.partial(_ours, general=True), slow),
            "NumPy tracer": (functools.partial(_numpy, pool=pool), slow),
        }
        if is_installed():
            makers["Geant4"] = (_geant4, slow)
        steps = len(COUPLINGS) * len(makers) * (1 + effort.rounds)
        done, engines = 0, []

        def step(engine: str, coupling: str) -> None:
            nonlocal done
            report("transport", done, steps, f"{engine}, {coupling}")
            done += 1

        for coupling in COUPLINGS:
            for name, (make, first) in makers.items():
                step(name, coupling)
                engines.append(_prepare(coupling, name, make, first, effort))
        for number in range(effort.rounds):
            for engine in engines:
                step(engine.name, engine.coupling)
                engine.samples.append(engine.run(engine.photons, 2 + number))
        report("transport", steps, steps)
    return engines


def _show_engines(screen, engines: list[Engine]) -> None:
    shown = output.table(
        f"{SCENE.name}: following photons", "engine", "photons/s", "ours is faster by", "eta",
        "error", "variance/photon", f"s to {100 * GOAL:g} %", "ours is sooner by", "start-up, s",
    )  # fmt: skip
    for coupling in COUPLINGS:
        ours = _find(engines, coupling, OURS)
        for engine in (e for e in engines if e.coupling == coupling):
            shown.add_row(
                f"{coupling}: {engine.name}", f"{engine.photons_per_s:,.0f}",
                f"{ours.photons_per_s / engine.photons_per_s:.3g}", f"{engine.eta:.5f}",
                f"{engine.eta_sigma:.5f}", f"{engine.variance_per_photon:.3g}",
                f"{engine.goal_s:.3g}", f"{engine.goal_s / ours.goal_s:.3g}",
                f"{engine.start_up_s:.2f}",
            )  # fmt: skip
        shown.add_section()
    screen.print(shown)
    if not is_installed():
        screen.print("Geant4 is not installed: pip install '.[geant4]' lets it take part")


def _find(engines: list[Engine], coupling: str, name: str) -> Engine:
    return next(e for e in engines if (e.coupling, e.name) == (coupling, name))


def _as_json(engines: list[Engine], race: TableRace, quick: bool) -> dict:
    numbers = ("photons_per_s", "eta", "eta_sigma", "variance_per_photon", "goal_s", "start_up_s")
    rows = []
    for engine in engines:
        ours = _find(engines, engine.coupling, OURS)
        rows.append(
            {"coupling": engine.coupling, "engine": engine.name}
            | {name: getattr(engine, name) for name in numbers}
            | {
                "ours_faster_by": ours.photons_per_s / engine.photons_per_s,
                "ours_sooner_by": engine.goal_s / ours.goal_s,
            }
        )
    return {
        "quick": quick,
        "goal": GOAL,
        "engines": rows,
        "table": dataclasses.asdict(race) | {"ratio": race.ratio, "target": TARGET},
        "versions": versions("llvm_ad_rgb"),
    }


@click.command()
@click.option("--quick", is_flag=True, help="See that it works, in half a minute.")
@click.option("--all-points", is_flag=True, help="Simulate every point of the table separately.")
@options.json_output
def main(quick: bool, all_points: bool, json_file: str | None) -> None:
    """Compare speeds on the article's bench."""
    refuse_outputs({"--json": json_file}, [SCENE])
    # Records that an earlier run left on disk would make the table look faster than it is.
    os.environ["MCRIM_CACHE"] = "off"
    effort = QUICK if quick else FULL
    if all_points:
        effort = dataclasses.replace(effort, separate=None)
    screen = output.console(json_file)
    with output.photon_progress() as report:
        engines = measure_engines(effort, report)
        race = race_the_table(
            SCENE, list(COUPLINGS.values()), effort.precision, effort.separate, report
        )
    output.write_json(json_file, _as_json(engines, race, quick))
    _show_engines(screen, engines)
    show_race(screen, race)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        sys.exit(2)
    except Geant4Error as error:
        sys.exit(f"benchmark: {error}")
