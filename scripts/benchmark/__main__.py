"""The command: `python scripts/benchmark`."""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from geant4 import Geant4Error, is_installed
from shared import SCENE

from benchmark.engines import (
    ALPHA_ABS_PER_CM,
    ALPHA_SCAT_PER_CM,
    COUPLINGS,
    FULL,
    GOAL,
    OURS,
    QUICK,
    SAME_MODEL,
    Effort,
    Engine,
    measure_engines,
)
from benchmark.scalar import ScalarTracerError, build
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.table import eta_table
from mcrim_mitsuba.output.description import table
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import versions

#: Standard errors by which an engine of the same model may differ from ours: by chance that
#: happens in one run of 2,600 at most.
LARGEST_Z = 4.0
#: The ratio that we want the table to reach at least.
TARGET = 12.0
#: Relative error of a first table that is not timed: it compiles the kernels.
FIRST_PRECISION = 0.05
#: Photons from which the number that a separate point needs is estimated; they are not timed.
PILOT_PHOTONS = 65_536


def _rows(engines: list[Engine]) -> list[dict]:
    """What is told of each."""
    rows = [{"coupling": one.coupling, "engine": one.name, **one.told()} for one in engines]
    ours = {row["coupling"]: row for row in rows if row["engine"] == OURS}
    for row in rows:
        of_ours = ours[row["coupling"]]
        row["ours_faster_by"] = None
        if row["photons_per_idle_s"] is not None:
            row["ours_faster_by"] = of_ours["photons_per_idle_s"] / row["photons_per_idle_s"]
        row["ours_sooner_by"] = row["goal_s"] / of_ours["goal_s"]
        sigma = math.hypot(row["eta_sigma"], of_ours["eta_sigma"])
        row["z_from_ours"] = (row["eta"] - of_ours["eta"]) / sigma
    return rows


#: Columns of what is shown of engines: the number's name, and its format.
_SHOWN = {
    "photons/s by the clock": ("photons_per_s", ",.0f"),
    "photons/s if idle": ("photons_per_idle_s", ",.0f"),
    "ours is faster by": ("ours_faster_by", ".3g"),
    "eta": ("eta", ".5f"),
    "error": ("eta_sigma", ".5f"),
    "z": ("z_from_ours", ".1f"),
    "variance/photon": ("variance_per_photon", ".3g"),
    f"s to {100 * GOAL:g} %": ("goal_s", ".3g"),
    "ours is sooner by": ("ours_sooner_by", ".3g"),
    "start-up, s": ("start_up_s", ".2f"),
}


def _show_engines(screen: terminal.Screen, rows: list[dict], no_scalar: str | None) -> None:
    cells = [
        [
            f"{row['coupling']}: {row['engine']}",
            *(
                "" if row[name] is None else format(row[name], form)
                for name, form in _SHOWN.values()
            ),
        ]
        for row in rows
    ]
    screen.show(table(f"{SCENE.name}: following photons", ["engine", *_SHOWN], cells))
    if not is_installed():
        screen.line("Geant4 is not installed: pip install '.[geant4]' lets it take part")
    if no_scalar is not None:
        screen.line(f"the scalar tracer does not take part: {no_scalar}")
    screen.print(
        "if idle: from processor time, as on a machine without other work; all ratios, and the "
        "seconds to a precision, are of these. z: difference of eta from ours in standard errors; "
        "polarised light, and Geant4's, is another model; modes are solved for by one thread, and "
        "their error is no statistical one"
    )


def race_the_table(effort: Effort, report: Callable[..., None]) -> dict[str, float]:
    """A table by reweighting against one simulation per point, at the same largest error.

    Seconds of reading and checking the scene are apart, and those of separate points are simulated,
    and between them by interpolation; the largest z-score is over the points simulated.
    """
    n_gaps = list(COUPLINGS.values())

    def make_table(wanted: float):
        return eta_table(
            SCENE,
            {"n_gap": n_gaps, ALPHA_ABS: ALPHA_ABS_PER_CM, ALPHA_SCAT: ALPHA_SCAT_PER_CM},
            run=Run(precision=wanted, progress=report),
        )

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
    return {
        "points": len(rows),
        "separate_points": total,
        "worst_error": worst_error,
        "start_up_s": start_up_s,
        "table_s": table_s,
        "separate_s": separate_s,
        "largest_z": max(scores),
        "ratio": separate_s / table_s,
        "target": TARGET,
    }


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
    program, no_scalar = None, None
    with tempfile.TemporaryDirectory(prefix="mcrim-benchmark-") as folder:
        try:
            program = build(Path(folder))
        except ScalarTracerError as error:
            no_scalar = str(error)
        with terminal.photon_progress() as report:
            rows = _rows(measure_engines(effort, report, program))
            race = race_the_table(effort, report)
    found = {"quick": quick, "goal": GOAL, "engines": rows, "table": race}
    terminal.write_json(json_file, found | {"versions": versions("llvm_ad_rgb")})
    _show_engines(screen, rows, no_scalar)
    _show_race(screen, race)
    astray = [
        row for row in rows if row["engine"] in SAME_MODEL and abs(row["z_from_ours"]) > LARGEST_Z
    ]
    for row in astray:
        name = f"{row['coupling']}: {row['engine']}"
        screen.say(f"{name}: eta differs from ours by {row['z_from_ours']:.1f} standard errors")
    if astray:
        click.get_current_context().exit(terminal.OUR_FAULT)


if __name__ == "__main__":
    try:
        main()
    except (InputError, Geant4Error) as error:
        print(f"benchmark: {error}", file=sys.stderr)
        sys.exit(2 if isinstance(error, InputError) else 1)
