"""What very many photons take: measured runs of growing size, and a line through them."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcrim_mitsuba.cache.location import FOLDER_VARIABLE, SIZE_VARIABLE
from mcrim_mitsuba.errors import InputError

SCENE = str(Path(__file__).parents[1] / "scenes" / "camoo4.xml")
VERBS = {
    "simulate": ("simulate", SCENE),
    "table": ("table", SCENE, "--alpha-scat", "log:0.1:2:20", "--alpha-abs", "0.039",
              "--n-gap", "1.46"),
}  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """What so many photons took, or would take.

    Attributes
    ----------
    verb : str
    photons : float
    seconds, processor_s : float
    memory_mb : float
        Largest resident size.
    disk_mb, files : float
        In the cache.
    measured : bool
    """

    verb: str
    photons: float
    seconds: float
    processor_s: float
    memory_mb: float
    disk_mb: float
    files: float
    measured: bool


def measure(verb: str, photons: float) -> Cost:
    """Run a verb in a process and a cache of its own.

    Raises
    ------
    InputError
        If it fails.
    """
    with tempfile.TemporaryDirectory(prefix="mcrim-scaling-") as folder:
        start = time.perf_counter()
        process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "mcrim_mitsuba",
                *VERBS[verb],
                "--photons",
                f"{photons:g}",
            ],
            env=os.environ | {FOLDER_VARIABLE: folder, SIZE_VARIABLE: "1000"},
            stdout=subprocess.DEVNULL,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise InputError(f"mcrim {verb} failed", "see above")
        seconds = time.perf_counter() - start
        sizes = [file.stat().st_size for file in Path(folder).rglob("*.chunk")]
    return Cost(
        verb, photons, seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024,
        sum(sizes) / 1e6, len(sizes), True,
    )  # fmt: skip


def extrapolate(costs: Sequence[Cost], photons: float) -> Cost:
    """A line through the two largest runs."""
    low, high = sorted(costs, key=lambda cost: cost.photons)[-2:]

    def at(value: Callable[[Cost], float]) -> float:
        slope = (value(high) - value(low)) / (high.photons - low.photons)
        return value(high) + max(slope, 0.0) * (photons - high.photons)

    return Cost(
        high.verb, photons, at(lambda c: c.seconds), at(lambda c: c.processor_s),
        at(lambda c: c.memory_mb), at(lambda c: c.disk_mb), at(lambda c: c.files), False,
    )  # fmt: skip


def rows(costs: Sequence[Cost]) -> list[str]:
    """A Markdown table."""
    lines = [
        "| verb | photons | | time | on processors | memory | in the cache | files |",
        "|---|---:|---|---:|---:|---:|---:|---:|",
    ]
    for cost in costs:
        lines.append(
            f"| `{cost.verb}` | {_power(cost.photons)} | "
            f"{'measured' if cost.measured else 'extrapolated'} | {_time(cost.seconds)} | "
            f"{_time(cost.processor_s)} | {cost.memory_mb:.0f} MB | {_size(cost.disk_mb)} | "
            f"{cost.files:.0f} |"
        )
    return lines


def _power(photons: float) -> str:
    exponent = int(np.log10(photons) + 1e-9)
    factor = photons / 10**exponent
    return f"10^{exponent}" if abs(factor - 1) < 1e-6 else f"{factor:g}·10^{exponent}"


def _size(megabytes: float) -> str:
    return f"{megabytes:.0f} MB" if megabytes >= 1 else f"{1000 * megabytes:.0f} kB"


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 60:.0f} min"
