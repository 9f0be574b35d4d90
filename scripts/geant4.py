"""Run Geant4 on a bench, in a process of its own."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run, arguments_of, processors
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.reference.tracer import TracerResult

_PROCESS = Path(__file__).with_name("geant4_process.py")
#: Volumes in which the light that ends is counted, and what the other programs call that fate.
DETECTOR, CRYSTAL, MASK = "detector", "crystal", "mask"
FATES = {DETECTOR: "detected", CRYSTAL: "absorbed_crystal", MASK: "absorbed_aperture"}
#: Escaped, or absorbed in the gap or the window.
ELSEWHERE = "elsewhere"


class Geant4Error(RuntimeError):
    """Geant4 ended without a result; one line says how."""


@dataclass(frozen=True)
class Geant4Result(TracerResult):
    """Every photon's fate, counted: one of `FATES`, or `ELSEWHERE`."""

    #: Wall time of the event loop.
    seconds: float
    #: Geant4's, such as ``11.4.1``.
    version: str


#: Geant4 has no limit on the number of flights: light that total reflection traps must meet
#: something, on average after this path at most.
LONGEST_MEAN_PATH_CM = 1000.0


def is_installed() -> bool:
    """Whether ``geant4_pybind`` can be found.

    Importing it here would not do: without its data sets it asks on the terminal, or downloads
    them where the variable CI is set.
    """
    return importlib.util.find_spec("geant4_pybind") is not None


def refuse_missing() -> None:
    """Refuse (InputError) to go on where `is_installed` says no."""
    if not is_installed():
        mend = "install it: pip install 'mcrim-mitsuba[geant4]'"
        raise InputError("Geant4 is not installed", mend)


def trace_geant4(
    bench: Bench,
    photons: int,
    seed: int,
    *,
    threads: int | None = None,
    depolarize: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Geant4Result:
    """Trace photons from birth to fate in Geant4 and count them by their fates.

    Geant4 follows linear polarisation always, whatever the bench says, without the phase of total
    reflection and without losing it when light scatters. Only with `depolarize` is its light the
    unpolarised light of the other two programs.

    Parameters
    ----------
    photons : int
        Number of photons to emit, at least 1.
    seed : int
        Not negative. The same seed, photons and threads give the same count.
    threads : int, optional
        Processor threads; all when not given.
    depolarize : bool
        Give light a random polarisation after every step; a call of Python each, which makes
        Geant4 some four times slower.
    progress : callable, optional
        Called now and then with the number of photons done.

    Raises
    ------
    InputError
        If ``geant4_pybind`` is not installed, a number is none or too small, or the bench is one
        that Geant4 cannot trace here.
    Geant4Error
        If Geant4 ends without a result.
    """
    photons, seed = arguments_of(photons, seed)
    threads = Run(threads=threads).threads or processors()
    refuse_missing()
    refuse_bench(bench)
    job = {
        "bench": dataclasses.asdict(bench),
        "photons": photons,
        # any whole number into the 31 bits that all of Geant4's engines take
        "engine_seed": int(np.random.SeedSequence(seed).generate_state(1)[0] >> 1) or 1,
        "threads": threads,
        "depolarize": depolarize,
    }
    found = run_job(job, progress)
    counts = {fate: found["ended"][volume] for volume, fate in FATES.items()}
    return Geant4Result(
        photons=photons,
        seed=seed,
        counts=counts | {ELSEWHERE: photons - sum(counts.values())},
        seconds=found["seconds"],
        version=found["version"],
    )


#: Parameters of the plainest bench: a box on a gap, a window and a mask.
PLAIN_PARAMETERS = (
    "crystal_width_mm",
    "crystal_height_mm",
    "n_crystal",
    "alpha_scat_per_cm",
    "alpha_abs_per_cm",
    "gap_mm",
    "n_gap",
    "window_width_mm",
    "window_thickness_mm",
    "n_window",
    "aperture_radius_mm",
)
#: Parameters of a bench that `construction` builds; all others must be at their defaults.
KNOWN_PARAMETERS = (
    *PLAIN_PARAMETERS,
    "polarization",
    "gap_absorption_per_cm",
    "window_absorption_per_cm",
)


def refuse_bench(bench: Bench) -> None:
    """Refuse a bench that `trace_geant4` cannot trace.

    Raises
    ------
    InputError
        If it has what Geant4 is not told of here, or traps light for ever.
    """
    for field in dataclasses.fields(Bench):
        if field.name not in KNOWN_PARAMETERS and getattr(bench, field.name) != field.default:
            problem = f"the bench in Geant4 does not know {field.name}"
            raise InputError(problem, f"leave {field.name} out")
    extinction = bench.alpha_scat_per_cm + bench.alpha_abs_per_cm
    if extinction * LONGEST_MEAN_PATH_CM < 1.0:
        problem = "in Geant4 light that is trapped in so clear a crystal would never end"
        mend = f"give alpha_scat_per_cm + alpha_abs_per_cm of {1 / LONGEST_MEAN_PATH_CM:g} or more"
        raise InputError(problem, mend)


def run_job(job: dict, progress: Callable[[int], None] | None) -> dict:
    """Do a job in a new process and return what it reports last."""
    with tempfile.TemporaryDirectory(prefix="mcrim-geant4-") as folder:
        # Optical photons need none of Geant4's data, but without this file it does not start.
        Path(folder, "ENSDFSTATE.dat").touch()
        log = Path(folder, "log")
        with log.open("w") as noise:
            process = subprocess.Popen(
                [sys.executable, str(_PROCESS), json.dumps(job)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=noise,
                text=True,
                env=os.environ | {"GEANT4_DATA_DIR": folder, "G4ENSDFSTATEDATA": folder},
            )
        assert process.stdout is not None
        report: dict = {}
        try:
            for line in process.stdout:
                report = json.loads(line)
                if progress is not None and "done" in report:
                    progress(report["done"])
            status = process.wait()
        finally:
            process.kill()
            process.stdout.close()
            process.wait()
        if status != 0 or "ended" not in report:
            raise Geant4Error(_how_it_ended(status, log.read_text(errors="replace")))
    return report


def _how_it_ended(status: int, log: str) -> str:
    """One line: the exit status and the last thing that Geant4 said."""
    try:
        how = signal.Signals(-status).name
    except ValueError:
        how = f"status {status}"
    said = [line.strip() for line in log.splitlines() if line.strip()]
    return f"Geant4 ended with {how}" + (f": {said[-1]}" if said else "")
