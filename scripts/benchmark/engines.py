"""The ways to simulate the bench, and how long each takes."""

from __future__ import annotations

import functools
import itertools
import math
import multiprocessing
import os
import signal
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from geant4 import Geant4Result, is_installed, trace_geant4
from shared import SCENE

from benchmark.scalar import trace_scalar
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import processors
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.reference.tracer import TracerResult, trace
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation

COUPLINGS = {"air": 1.0, "gel": 1.46}
OURS = "ours"
#: Engines of the same model of light as ours: their eta must be the same.
SAME_MODEL = (SCALAR, UNFOLDING, NUMPY, NEW_BENCH, KNOWN_BENCH, IN_TABLE) = (
    "scalar tracer, C++",
    "scalar tracer, C++, unfolding",
    "NumPy tracer",
    "modes, of a new bench",
    "modes, of a known bench",
    "modes, in a table",
)
#: Those that follow no photons.
MODES = (NEW_BENCH, KNOWN_BENCH, IN_TABLE)
#: The table's coefficients.
ALPHA_SCAT_PER_CM, ALPHA_ABS_PER_CM = np.geomspace(0.02, 3.0, 40), (0.014, 0.039, 0.072)
#: Relative standard error of eta, the time to which is compared.
GOAL = 0.001
#: Photons of an engine's first runs, the very first of which compiles its kernels.
FIRST_PHOTONS, FIRST_PHOTONS_SLOW = 1_000_000, 20_000
#: Records are kept in memory, from launches of this size.
MOST_RECORDED_PHOTONS, RECORDED_PER_LAUNCH = 10_000_000, 128 * LANES
_CORES = processors()


class Effort(NamedTuple):
    """How much time is spent."""

    rounds: int  # in which engines take turns, so that all share the machine's moods
    seconds: float  # of a timed run
    precision: float  # of the table, relative
    separate: int  # points per absorption and coupling, evenly spread over all alpha_scat


QUICK = Effort(rounds=1, seconds=0.4, precision=0.01, separate=2)
FULL = Effort(rounds=5, seconds=2.0, precision=0.001, separate=6)


class Sample(NamedTuple):
    """One run: photons, wall and processor time of following them (s), eta and its error."""

    photons: int
    seconds: float
    processor_s: float
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

    def told(self) -> dict[str, float | None]:
        """Of all runs, as the JSON has it.

        The relative variance of eta from one photon is sigma^2 N / eta^2; eta is known to `GOAL`
        after `goal_s` on all cores of a machine without other work: it comes from processor time.
        """
        photons, seconds, processor_s, etas, sigmas = np.array(self.samples).T
        total = float(photons.sum())
        idle_rate = float(np.median(photons / processor_s)) * _CORES
        eta = float(photons @ etas) / total
        eta_sigma = float(np.linalg.norm(photons * sigmas)) / total
        variance = (eta_sigma / eta) ** 2 * total
        return {
            "photons_per_s": float(np.median(photons / seconds)),
            "photons_per_idle_s": idle_rate,
            "eta": eta,
            "eta_sigma": eta_sigma,
            "variance_per_photon": variance,
            "goal_s": variance / GOAL**2 / idle_rate,
            "start_up_s": self.start_up_s,
        }


class NoPhotons(Engine):
    """The solver: its photons are points, each to `GOAL` or better by its own estimate."""

    def told(self) -> dict[str, float | None]:
        """As of others, with None for what is of photons; its error is no statistical one."""
        points, _, processor_s, etas, errors = np.array(self.samples).T
        return {
            "photons_per_s": None,
            "photons_per_idle_s": None,
            "eta": float(etas[0]),
            "eta_sigma": float(errors[0]),
            "variance_per_photon": None,
            "goal_s": float(np.median(processor_s / points)) / _CORES,
            "start_up_s": self.start_up_s,
        }


def _modes(coupling: str, name: str) -> Sampler:
    """A known bench is one of which other coefficients were asked for before."""
    bench, numbers = Bench(n_gap=COUPLINGS[coupling]), itertools.count(1)
    coefficients = {}
    if name == IN_TABLE:
        coefficients = {
            ALPHA_SCAT: ALPHA_SCAT_PER_CM,
            ALPHA_ABS: np.array(ALPHA_ABS_PER_CM)[:, None],
        }

    def run(times: int, seed: int) -> Sample:
        begin, processor_begin = time.perf_counter(), time.process_time()
        for _ in range(times):
            own = bench
            if name == NEW_BENCH:  # none is quite as another was
                own = replace(bench, gap_mm=bench.gap_mm * (1.0 + 1e-9 * next(numbers)))
            found = solve_box(own, **coefficients, precision=GOAL)
        processor_s = time.process_time() - processor_begin
        seconds = time.perf_counter() - begin
        if (found.error > GOAL * found.eta).any():
            raise RuntimeError(f"modes, {coupling}: no {100 * GOAL:g} % at some points")
        own = solve_box(bench, precision=GOAL)
        points = times * found.eta.size
        return Sample(points, seconds, processor_s, float(own.eta), float(own.error))

    return run


def _prepare_modes(coupling: str, name: str, effort: Effort) -> Engine:
    """As `_prepare`, of the solver."""
    run = _modes(coupling, name)
    begin = time.perf_counter()
    run(1, 0)
    start_up_s = time.perf_counter() - begin
    times = math.ceil(0.5 * effort.seconds / run(3, 0).seconds * 3)
    return NoPhotons(coupling, name, run, times, start_up_s)


def _ours(coupling: str, *, polarization: bool = False, general: bool = False) -> Sampler:
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling], "polarization": polarization})

    def run(photons: int, seed: int) -> Sample:
        begin = time.process_time()
        found = simulation.collect(photons, seed=seed, general=general)
        processor_s = time.process_time() - begin
        if found.interrupted:
            raise KeyboardInterrupt
        return Sample(found.photons, found.seconds, processor_s, found.eta, found.eta_sigma)

    return run


def _ours_recording(coupling: str) -> Sampler:
    """As in a plain run, with what reweighting needs kept of each photon."""
    simulation = Simulation(SCENE, {"n_gap": COUPLINGS[coupling]})
    own = simulation.file.parameters
    drawn = ScatteringProposals(
        (own["alpha_scat_per_cm"],), (SHARE_STEPS,), own["alpha_abs_per_cm"]
    )
    # it imports Dr.Jit, which takes the system's LLVM where none was chosen before
    from mcrim_mitsuba.transport.collection import Recorder

    recorder = Recorder(simulation)

    def run(photons: int, seed: int) -> Sample:
        photons = min(photons, MOST_RECORDED_PHOTONS)
        launches = -(-photons // RECORDED_PER_LAUNCH)
        size = -(-photons // (launches * LANES)) * LANES
        begin, processor_begin = time.perf_counter(), time.process_time()
        kept = [recorder.record(drawn, size, seed=seed, number=n) for n in range(launches)]
        seconds = time.perf_counter() - begin
        processor_s = time.process_time() - processor_begin
        per_batch = sum(np.bincount(part.batch, part.w, part.batches) for part in kept)
        sigma = per_batch.std(ddof=1) * len(per_batch) ** 0.5 / (launches * size)
        eta = per_batch.sum() / (launches * size)
        return Sample(launches * size, seconds, processor_s, eta, sigma)

    return run


def _scalar(coupling: str, *, program: Path, unfold: bool = False) -> Sampler:
    bench = Bench(n_gap=COUPLINGS[coupling])

    def run(photons: int, seed: int) -> Sample:
        found = trace_scalar(program, bench, photons, seed, unfold=unfold)
        times = found["seconds"], found["processor_s"]
        return Sample(photons, *times, found["eta"], found["eta_sigma"])

    return run


def trace_timed(n_gap: float, photons: int, seed: int) -> tuple[TracerResult, float]:
    """The independent tracer, and the processor time that it took in this process, s."""
    begin = time.process_time()
    found = trace(read_scene(SCENE, {"n_gap": n_gap}), photons, seed, threads=1)
    return found, time.process_time() - begin


def _numpy(coupling: str, *, pool) -> Sampler:
    n_gap = COUPLINGS[coupling]

    def run(photons: int, seed: int) -> Sample:
        share = -(-photons // _CORES)
        jobs = [(n_gap, share, seed * _CORES + core) for core in range(_CORES)]
        begin = time.perf_counter()
        parts, processor_s = zip(*pool.starmap(trace_timed, jobs, chunksize=1), strict=True)
        seconds = time.perf_counter() - begin
        sigma = sum(part.eta_sigma**2 for part in parts) ** 0.5 / _CORES
        eta = statistics.fmean(part.eta for part in parts)
        return Sample(share * _CORES, seconds, sum(processor_s), eta, sigma)

    return run


def _geant4(coupling: str) -> Sampler:
    bench = Bench(n_gap=COUPLINGS[coupling])

    def follow(photons: int, seed: int) -> tuple[Geant4Result, float]:
        """With the processor time of its process, s."""
        before = os.times()
        found = trace_geant4(bench, photons, seed)
        after = os.times()
        user_s = after.children_user - before.children_user
        return found, user_s + after.children_system - before.children_system

    # what the process takes before it follows photons
    _, first_s = follow(1, 0)

    def run(photons: int, seed: int) -> Sample:
        found, processor_s = follow(photons, seed)
        times = found.seconds, processor_s - first_s
        return Sample(found.photons, *times, found.eta, found.eta_sigma)

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


def measure_engines(
    effort: Effort, report: Callable[..., None], scalar_program: Path | None
) -> list[Engine]:
    """Time all engines with both couplings; the scalar tracer takes part if it is compiled."""
    # one process per core, ready; an interrupt is for this process to handle
    ignore = (signal.SIGINT, signal.SIG_IGN)
    with multiprocessing.get_context("spawn").Pool(None, signal.signal, ignore) as pool:
        fast, slow = FIRST_PHOTONS, FIRST_PHOTONS_SLOW
        makers = {
            OURS: (_ours, fast),
            "ours, polarised": (functools.partial(_ours, polarization=True), fast),
            "ours, records kept": (_ours_recording, fast),
            "ours, general path": (functools.partial(_ours, general=True), slow),
            NUMPY: (functools.partial(_numpy, pool=pool), slow),
        }
        if scalar_program is not None:
            scalar = functools.partial(_scalar, program=scalar_program)
            makers[SCALAR] = (scalar, fast)
            makers[UNFOLDING] = (functools.partial(scalar, unfold=True), fast)
        if is_installed():
            makers["Geant4"] = (_geant4, slow)
        names = [*makers, *MODES]
        pairs = [(coupling, name) for coupling in COUPLINGS for name in names]
        engines: list[Engine] = []
        for number in range(-1, effort.rounds):
            for place, (coupling, name) in enumerate(pairs):
                done, steps = (1 + number) * len(pairs) + place, len(pairs) * (1 + effort.rounds)
                report("transport", done, steps, f"{name}, {coupling}")
                if number < 0 and name not in makers:
                    engines.append(_prepare_modes(coupling, name, effort))
                elif number < 0:
                    engines.append(_prepare(coupling, name, *makers[name], effort))
                else:
                    engine = engines[place]
                    engine.samples.append(engine.run(engine.photons, 2 + number))
        report("transport", steps, steps)
    return engines
