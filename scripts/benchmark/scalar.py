"""The scalar tracer of `scalar_tracer.cpp`, compiled when it is needed."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

from geant4 import PLAIN_PARAMETERS

from mcrim_mitsuba.core.run import processors
from mcrim_mitsuba.efficiency.bench import Bench

SOURCE = Path(__file__).with_name("scalar_tracer.cpp")
COMPILERS = ("g++", "c++", "clang++")
FLAGS = ("-std=c++17", "-O3", "-march=native", "-pthread")


class ScalarTracerError(RuntimeError):
    """The tracer cannot be had here; one line says why."""


def build(folder: Path) -> Path:
    """Compile the tracer into a folder; returns the program.

    Raises
    ------
    ScalarTracerError
        If there is no compiler, or it does not like the code or the flags.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise ScalarTracerError(f"no C++ compiler was found ({', '.join(COMPILERS)})")
    program = folder / SOURCE.stem
    line = [compiler, *FLAGS, str(SOURCE), "-o", str(program)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    if done.returncode:
        first = next(iter(done.stderr.splitlines()), f"status {done.returncode}")
        raise ScalarTracerError(f"{compiler} does not compile it: {first}")
    return program


def trace_scalar(
    program: Path,
    bench: Bench,
    photons: int,
    seed: int,
    *,
    unfold: bool = False,
    threads: int | None = None,
) -> dict[str, Any]:
    """Trace photons, on all cores unless threads are given; what the program prints.

    With `unfold`, light that total reflection traps in the crystal goes to its next scattering in
    one step: a polished box folds a straight line into what its faces make of it. The names are
    ``eta``, ``eta_sigma``, ``fates`` (fractions of the light emitted), ``photons``, ``seconds``
    (wall time), ``processor_s`` and ``photons_per_second``.
    """
    # what else a bench has the tracer does not look at
    given = {name: getattr(bench, name) for name in PLAIN_PARAMETERS} | {
        "photons": photons,
        "seed": seed,
        "threads": threads or processors(),
        "unfold": int(unfold),
    }
    line = [str(program), *(f"{name}={value}" for name, value in given.items())]
    return json.loads(subprocess.run(line, stdout=subprocess.PIPE, check=True).stdout)
