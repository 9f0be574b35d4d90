"""How fast is it? Our transport, the NumPy tracer and Geant4 on the same bench, in one run.

    python scripts/benchmark.py             # some minutes, on an idle machine
    python scripts/benchmark.py --quick     # does it work? half a minute; its numbers are rough

The first part compares how fast photons are followed, and how fast a precision of eta is reached.
The second compares a table of eta from reweighted photons with one simulation per point.
All use every processor core. Start-up and the compilation of kernels are timed apart.
"""

from __future__ import annotations

import functools
import math
import multiprocessing
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import click
import numpy as np
from shared import SCENE

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.table import eta_table
from mcrim_mitsuba.output.described import table
from mcrim_mitsuba.reference.bench import Bench
from mcrim_mitsuba.reference.geant4 import Geant4Error, is_installed, trace_geant4
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.transport.collection import Recorder
from mcrim_mitsuba.transport.launch_plan import LANES, UNITS, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import versions

COUPLINGS = {"air": 1.0, "gel": 1.46}
OURS = "ours"
#: Relative standard error of eta, the time to which is compared.
GOAL = 0.001
#: Photons of an engine's first runs, the very first of which compiles its kernels.
FIRST_PHOTONS, FIRST_PHOTONS_SLOW = 1_000_000, 20_000
#: Records are kept in memory, from launches of this size.
MOST_RECORDED_PHOTONS, RECORDED_PER_LAUNCH = 10_000_000, 128 * LANES
#: The table, and the ratio that we want it to reach at least.
ALPHA_SCAT_PER_CM, ALPHA_ABS_PER_CM = np.geomspace(0.02, 3.0, 40), (0.014, 0.039, 0.072)
TARGET = 12.0
#: Relative error of a first table that is not timed: it compiles the kernels.
FIRST_PRECISION = 0.05
#: Photons from which the number that a separate point needs is estimated; they are not timed.
PILOT_PHOTONS = 65_536


class Effort(NamedTuple):
    """How much time is spent."""

    rounds: int  # in which engines take turns, so that all share the machine's moods
    seconds: float  # of a timed run
    precision: float  # of the table, relative
    separate: int  # points per absorption and coupling, evenly spread over all alpha_scat


QUICK = Effort(rounds=1, seconds=0.4, precision=0.01, separate=2)
FULL = Effort(rounds=5, seconds=2.0, precision=0.001, separate=6)


class Sample(NamedTuple):
    """One run: photons, wall time of following them (s), eta and its standard error."""

    photons: int
    seconds: float
    eta: float
    eta_sigma: float


#: ``run(photons, seed)``
Sampler = Callable[[int, int], Sample]


@dataclass
class Engine:
    """One way to simulate the bench; `photons` are those of a timed run."""

    coupling: str
    name: str
    run: Sampler
    photons: int
    start_up_s: float  # wall time until the first photons are done
    samples: list[Sample] = field(default_factory=list)

    def told(self) -> dict[str, float]:
        """Of all runs, as the JSON has it.

        The relative variance of eta from one photon is sigma^2 N / eta^2; eta is known to `GOAL`
        after `goal_s`.
        """
        photons, seconds, etas, sigmas = np.array(self.samples).T
        rate, total = float(np.median(photons / seconds)), float(photons.sum())
        eta = float(photons @ etas) / total
        eta_sigma = float(np.linalg.norm(photons * sigmas)) / total
        variance = (eta_sigma / eta) ** 2 * total
        return {"photons_per_s": rate, "eta": eta, "eta_sigma": eta_sigma,
                "variance_per_photon": variance, "goal_s": variance / GOAL**2 / rate,
                "start_up_s": self.start_up_s}  # fmt: skip


def _ours(coupling: str, *, polarization: bool = False, general: bool = False) -> Sampler:
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling], "polarization": polarization})

    def run(photons: int, seed: int) -> Sample:
        found = simulation.collect(photons, seed=seed, general=general)
        if found.interrupted:
            raise KeyboardInterrupt
        return Sample(found.photons, found.seconds, found.eta, found.eta_sigma)

    return run


def _ours_recording(coupling: str) -> Sampler:
    """As in a plain run, with what reweighting needs kept of each photon."""
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling]})
    own = simulation.file.parameters
    drawn = ScatteringProposals((own["alpha_scat_per_cm"],), (UNITS,), own["alpha_abs_per_cm"])
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


def _numpy(coupling: str, *, pool) -> Sampler:
    bench, cores = Bench(n_gap=COUPLINGS[coupling]), os.cpu_count() or 1

    def run(photons: int, seed: int) -> Sample:
        share = -(-photons // cores)
        jobs = [(bench, share, seed * cores + core) for core in range(cores)]
        begin = time.perf_counter()
        found = pool.starmap(trace, jobs, chunksize=1)
        seconds = time.perf_counter() - begin
        sigma = sum(part.eta_sigma**2 for part in found) ** 0.5 / cores
        return Sample(share * cores, seconds, statistics.fmean(p.eta for p in found), sigma)

    return run


def _geant4(coupling: str) -> Sampler:
    def run(photons: int, seed: int) -> Sample:
        found = trace_geant4(Bench(n_gap=COUPLINGS[coupling]), photons, seed)
        return Sample(found.photons, found.seconds, found.eta, found.eta_sigma)

    return run


def _prepare(
    coupling: str, name: str, make: Callable[[str], Sampler], first: int, effort: Effort
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


def measure_engines(effort: Effort, report: Callable[..., None]) -> list[Engine]:
    """Time all engines with both couplings."""
    # one process per core, ready; an interrupt is for this process to handle
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with multiprocessing.get_context("spawn").Pool(None, signal.signal, ignore) as pool:
        fast, slow = FIRST_PHOTONS, FIRST_PHOTONS_SLOW
        makers = {
            OURS: (_ours, fast),
            "ours, polarised": (functools.partial(_ours, polarization=True), fast),
            "ours, records kept": (_ours_recording, fast),
            "ours, general path": (functools.partial(_ours, general=True), slow),
            "NumPy tracer": (functools.partial(_numpy, pool=pool), slow),
        }
        if is_installed():
            makers["Geant4"] = (_geant4, slow)
        pairs = [(coupling, name) for coupling in COUPLINGS for name in makers]
        engines: list[Engine] = []
        for number in range(-1, effort.rounds):
            for place, (coupling, name) in enumerate(pairs):
                done, steps = (1 + number) * len(pairs) + place, len(pairs) * (1 + effort.rounds)
                report("transport", done, steps, f"{name}, {coupling}")
                if number < 0:
                    engines.append(_prepare(coupling, name, *makers[name], effort))
                else:
                    engine = engines[place]
                    engine.samples.append(engine.run(engine.photons, 2 + number))
        report("transport", steps, steps)
    return engines


def _rows(engines: list[Engine]) -> list[dict]:
    """What is told of each."""
    rows = [{"coupling": one.coupling, "engine": one.name, **one.told()} for one in engines]
    ours = {row["coupling"]: row for row in rows if row["engine"] == OURS}
    for row in rows:
        of_ours = ours[row["coupling"]]
        row["ours_faster_by"] = of_ours["photons_per_s"] / row["photons_per_s"]
        row["ours_sooner_by"] = row["goal_s"] / of_ours["goal_s"]
    return rows


#: Columns of what is shown of engines: the number's name, and its format.
_SHOWN = {
    "photons/s": ("photons_per_s", ",.0f"), "ours is faster by": ("ours_faster_by", ".3g"),
    "eta": ("eta", ".5f"), "error": ("eta_sigma", ".5f"),
    "variance/photon": ("variance_per_photon", ".3g"), f"s to {100 * GOAL:g} %": ("goal_s", ".3g"),
    "ours is sooner by": ("ours_sooner_by", ".3g"), "start-up, s": ("start_up_s", ".2f"),
}  # fmt: skip


def _show_engines(screen: terminal.Screen, rows: list[dict]) -> None:
    cells = [[f"{row['coupling']}: {row['engine']}",
              *(format(row[name], form) for name, form in _SHOWN.values())]
             for row in rows]  # fmt: skip
    screen.show(table(f"{SCENE.name}: following photons", ["engine", *_SHOWN], cells))
    if not is_installed():
        screen.line("Geant4 is not installed: pip install '.[geant4]' lets it take part")


def race_the_table(effort: Effort, report: Callable[..., None]) -> dict[str, float]:
    """A table by reweighting against one simulation per point, at the same largest error.

    Seconds of reading and checking the scene are apart, and those of separate points are simulated,
    and between them by interpolation; the largest z-score is over the points simulated.
    """
    n_gaps = list(COUPLINGS.values())

    def make_table(wanted: float):
        return eta_table(
            SCENE, {"n_gap": n_gaps, ALPHA_ABS: ALPHA_ABS_PER_CM, ALPHA_SCAT: ALPHA_SCAT_PER_CM},
            run=Run(precision=wanted, progress=report),
        )  # fmt: skip

    make_table(FIRST_PRECISION)
    begin = time.perf_counter()
    for n_gap in n_gaps:
        Simulation(SCENE, {"n_gap": n_gap})
    start_up_s = time.perf_counter() - begin
    begin = time.perf_counter()
    table = make_table(effort.precision)
    rows = table.rows
    table_s = time.perf_counter() - begin - start_up_s
    worst_error = table.largest_relative_sigma

    width = len(ALPHA_SCAT_PER_CM)
    chosen = np.round(np.linspace(0, width - 1, effort.separate)).astype(int)
    curves = [rows[first : first + width] for first in range(0, len(rows), width)]
    separate_s, scores, total = 0.0, [], len(curves) * len(chosen)
    for curve in curves:
        seconds = []
        for index in chosen:
            report("separate points", len(scores), total)
            taken, z = _separate_point(curve[index], worst_error)
            seconds.append(taken)
            scores.append(abs(z))
        separate_s += float(np.interp(np.arange(width), chosen, seconds).sum())
    report("separate points", total, total)
    return {"points": len(rows), "separate_points": total, "worst_error": worst_error,
            "start_up_s": start_up_s, "table_s": table_s, "separate_s": separate_s,
            "largest_z": max(scores), "ratio": separate_s / table_s, "target": TARGET}  # fmt: skip


def _separate_point(row: dict[str, float], worst_error: float) -> tuple[float, float]:
    """Simulate one point of the table until its error is the given one.

    Gives the wall time of the transport, s, brought to exactly that error, and the difference from
    the table in standard errors.
    """
    eta, eta_sigma = row.pop("eta"), row.pop("eta_sigma")
    simulation = Simulation(SCENE, row, check=False)
    pilot = simulation.collect(PILOT_PHOTONS, seed=1)
    needed = PILOT_PHOTONS * (pilot.eta_sigma / pilot.eta / worst_error) ** 2
    found = simulation.collect(max(PILOT_PHOTONS, round(needed)), seed=2)
    if pilot.interrupted or found.interrupted:
        raise KeyboardInterrupt
    excess = found.eta_sigma / found.eta / worst_error
    z = (found.eta - eta) / math.hypot(found.eta_sigma, eta_sigma)
    return found.seconds * excess**2, z


def _show_race(screen: terminal.Screen, race: dict[str, float]) -> None:
    title = f"{race['points']} points of eta, each to {100 * race['worst_error']:.3g} % or better"
    reweighted = ("one simulation per coupling, reweighted", f"{race['table_s']:.2f}", "1")
    separate = ("one simulation per point", f"{race['separate_s']:.2f}", f"{race['ratio']:.3g}")
    screen.show(table(title, ("way", "seconds", "ratio"), (reweighted, separate)))
    screen.print(
        f"{race['separate_points']} points, spread over the table, were simulated separately, and "
        f"the others' times interpolated; largest difference {race['largest_z']:.2g} standard "
        f"errors; start-up {race['start_up_s']:.2f} s apart; ratio wanted: {TARGET:g} at least"
    )


@click.command()
@click.option("--quick", is_flag=True, help="See that it works, in half a minute.")
@options.json_output
def main(quick: bool, json_file: str | None) -> None:
    """Compare speeds on the article's bench."""
    refuse_outputs({"--json": json_file}, [SCENE])
    # Records that an earlier run left on disk would make the table look faster than it is.
    os.environ["MCRIM_CACHE"] = "off"
    effort = QUICK if quick else FULL
    screen = terminal.console(json_file)
    with terminal.photon_progress() as report:
        rows = _rows(measure_engines(effort, report))
        race = race_the_table(effort, report)
    found = {"quick": quick, "goal": GOAL, "engines": rows, "table": race}
    terminal.write_json(json_file, found | {"versions": versions("llvm_ad_rgb")})
    _show_engines(screen, rows)
    _show_race(screen, race)


if __name__ == "__main__":
    try:
        main()
    except (InputError, Geant4Error) as error:
        print(f"benchmark: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 1)
