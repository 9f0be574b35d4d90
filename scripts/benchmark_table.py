"""A table of eta from reweighted photons against one simulation per point."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from mcrim_mitsuba.cli import output
from mcrim_mitsuba.kernel.simulation import Simulation
from mcrim_mitsuba.tables import TableRow, eta_table

ALPHA_SCAT_PER_CM = np.geomspace(0.02, 3.0, 40)
ALPHA_ABS_PER_CM = (0.014, 0.039, 0.072)
#: Ratio that we want the table to reach at least.
TARGET = 12.0
#: Relative error of a first table that is not timed: it compiles the kernels.
FIRST_PRECISION = 0.05
#: Photons from which the number that a separate point needs is estimated; they are not timed.
PILOT_PHOTONS = 65_536

_POINT = ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")


@dataclass(frozen=True)
class TableRace:
    """A table by reweighting against one simulation per point, at the same largest error.

    Attributes
    ----------
    points, separate_points : int
        Of the table, and those simulated separately.
    worst_error : float
        Largest relative standard error of the table, to which the separate points were run.
    start_up_s, table_s : float
        Reading and checking the scene (not counted), and the table.
    separate_s : float
        All points separately: those simulated, and between them by interpolation.
    largest_z : float
        Largest difference of the two in standard errors, over the points simulated.
    """

    points: int
    separate_points: int
    worst_error: float
    start_up_s: float
    table_s: float
    separate_s: float
    largest_z: float

    @property
    def ratio(self) -> float:
        return self.separate_s / self.table_s


def race_the_table(
    scene: Path,
    n_gaps: Sequence[float],
    precision: float,
    separate: int | None,
    report: Callable[..., None],
) -> TableRace:
    """Time the table both ways.

    Parameters
    ----------
    scene : Path
    n_gaps : sequence of float
    precision : float
        Relative standard error of the table's points.
    separate : int or None
        Points simulated separately per coupling and absorption, evenly spread over alpha_scat and
        with its two ends; all when None.
    report : callable
        See `cli.output.photon_progress`.
    """

    def make_table(wanted: float):
        return eta_table(
            scene, ALPHA_SCAT_PER_CM, ALPHA_ABS_PER_CM, n_gaps, precision=wanted, progress=report
        )

    make_table(FIRST_PRECISION)
    begin = time.perf_counter()
    for n_gap in n_gaps:
        Simulation(scene, {"n_gap": n_gap})
    start_up_s = time.perf_counter() - begin
    begin = time.perf_counter()
    table = make_table(precision)
    table_s = time.perf_counter() - begin - start_up_s
    worst_error = max(row.eta_sigma / row.eta for row in table.rows)

    width = len(ALPHA_SCAT_PER_CM)
    chosen = np.arange(width)
    if separate is not None:
        chosen = np.round(np.linspace(0, width - 1, separate)).astype(int)
    curves = [table.rows[first : first + width] for first in range(0, len(table.rows), width)]
    separate_s, scores = 0.0, []
    for number, curve in enumerate(curves):
        seconds = []
        for index in chosen:
            done = number * len(chosen) + len(seconds)
            report("separate points", done, len(curves) * len(chosen))
            taken, z = _separate_point(scene, curve[index], worst_error)
            seconds.append(taken)
            scores.append(z)
        separate_s += float(np.interp(np.arange(width), chosen, seconds).sum())
    report("separate points", len(scores), len(scores))
    return TableRace(
        points=len(table.rows),
        separate_points=len(scores),
        worst_error=worst_error,
        start_up_s=start_up_s,
        table_s=table_s,
        separate_s=separate_s,
        largest_z=max(map(abs, scores)),
    )


def _separate_point(scene: Path, row: TableRow, worst_error: float) -> tuple[float, float]:
    """Simulate one point of the table until its error is the given one.

    Returns
    -------
    seconds : float
        Wall time of the transport, brought to exactly that error.
    z : float
        Difference from the table in standard errors.
    """
    point = {name: getattr(row, name) for name in _POINT}
    simulation = Simulation(scene, point, check=False)
    pilot = simulation.collect(PILOT_PHOTONS, seed=1)
    needed = PILOT_PHOTONS * (pilot.eta_sigma / pilot.eta / worst_error) ** 2
    found = simulation.collect(max(PILOT_PHOTONS, round(needed)), seed=2)
    if pilot.interrupted or found.interrupted:
        raise KeyboardInterrupt
    excess = found.eta_sigma / found.eta / worst_error
    z = (found.eta - row.eta) / math.hypot(found.eta_sigma, row.eta_sigma)
    return found.seconds * excess**2, z


def show_race(screen: Console, race: TableRace) -> None:
    """Print the outcome."""
    shown = output.table(
        f"{race.points} points of eta, each to {100 * race.worst_error:.3g} % or better",
        "way", "seconds", "ratio",
    )  # fmt: skip
    shown.add_row("one simulation per coupling, reweighted", f"{race.table_s:.2f}", "1")
    shown.add_row("one simulation per point", f"{race.separate_s:.2f}", f"{race.ratio:.3g}")
    screen.print(shown)
    which = "all points were simulated separately"
    if race.separate_points < race.points:
        which = (
            f"{race.separate_points} points, spread over the table, were simulated separately, and "
            "the others' times interpolated (--all-points: all)"
        )
    screen.print(
        f"{which}; largest difference {race.largest_z:.2g} standard errors; start-up "
        f"{race.start_up_s:.2f} s apart; ratio wanted: {TARGET:g} at least"
    )
