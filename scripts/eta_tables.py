"""Tables of eta for a list of scenes and of their parameters, one CSV each.

    python scripts/eta_tables.py scenes/camoo4.xml scenes/cawo4.xml --alpha-scat log:0.01:2:40 \\
        --alpha-abs 0.014,0.039 --n-gap 1.0,1.46 -D gap_mm=0.02,0.05 -o tables

The same line goes on after an interruption: tables that are there are kept, unless their scene,
their values, the effort or the software has changed.
"""

from __future__ import annotations

import sys
import time

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.table_jobs import TableJob, table_jobs
from mcrim_mitsuba.scene.values import parse_list

_LIST = "such as 0.1,0.5 or 0.01:2:40 (start:stop:count) or log:0.01:2:40"


@click.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...")
@click.option("--alpha-scat", required=True, metavar="LIST", help=f"Scattering, 1/cm: {_LIST}.")
@click.option("--alpha-abs", required=True, metavar="LIST", help=f"Absorption, 1/cm: {_LIST}.")
@click.option("--n-gap", required=True, metavar="LIST",
              help="Index of the gap: 1.0,1.46 or 1.0,glycerol@540nm.")  # fmt: skip
@click.option("-D", "variations", multiple=True, metavar="NAME=LIST", callback=options.read_defines,
              help="Values of a scene parameter; each combination gets a table.")  # fmt: skip
@click.option("-o", "--output", "folder", required=True, metavar="FOLDER",
              help="Where the tables go; made if it is not there.")  # fmt: skip
@options.photons("2e6 per coupling", at_most=True)
@options.precision
@options.seed
@options.machine
@click.option("--log", metavar="FILE", help="Append the progress, unit by unit, to this file.")
def main(scenes, alpha_scat, alpha_abs, n_gap, variations, folder, log, **how) -> int:
    """Tables of the light collection efficiency of SCENEs, one CSV per scene and combination of -D.

    Comments in each say what it rests on. Tables that are there and still right are kept.
    """
    axes = {
        "alpha_scat_per_cm": parse_list("--alpha-scat", alpha_scat),
        "alpha_abs_per_cm": parse_list("--alpha-abs", alpha_abs),
        "n_gap": parse_list("--n-gap", n_gap, "n_gap"),
    }
    jobs = table_jobs(scenes, axes, variations, folder, Run(**how))
    screen = terminal.console()
    made = kept = 0
    try:
        with terminal.photon_progress(log=log) as report:
            for number, job in enumerate(jobs, start=1):
                report("tables", number - 1, len(jobs), job.path.name)
                if job.is_done:
                    kept += 1
                    screen.line(f"{job.path}: kept")
                else:
                    _make(job, report, screen)
                    made += 1
    except KeyboardInterrupt:
        screen.say(f"interrupted: {made} made, {kept} kept; the same line goes on from here")
        return terminal.INTERRUPTED
    screen.line(f"{len(jobs)} tables in {folder}: {made} made, {kept} kept")
    return terminal.DONE


def _make(job: TableJob, report, screen: terminal.Screen) -> None:
    start = time.perf_counter()

    def shown(what: str, done: int, total: int, note: str = "") -> None:
        report(f"{job.path.stem}: {what}", done, total, note)

    table = job.make(shown)
    screen.line(
        f"{job.path}: {len(table.rows)} points, {table.photons:,} photons "
        f"({table.cached_photons:,} of the cache), {time.perf_counter() - start:.1f} s"
    )
    screen.say_notes(f"{job.path.name}: {note}" for note in table.notes)


if __name__ == "__main__":
    sys.exit(terminal.run(main, "eta_tables"))
