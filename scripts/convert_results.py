"""Results of mcrim as a CSV, a NetCDF file (xarray) or a LaTeX table.

    python scripts/convert_results.py night/*.json -o night.csv
    python scripts/convert_results.py table.csv -o table.nc
    python scripts/convert_results.py calibrated.json -o results.tex

Files of one kind at a time; what is no result of mcrim is refused in one line.
"""

from __future__ import annotations

import sys

import click

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output.codec import SUFFIXES, read_results, write_table


@click.command()
@click.argument("results", nargs=-1, required=True, metavar="RESULT...")
@click.option(
    "-o",
    "--output",
    "path",
    required=True,
    metavar="FILE",
    help="What to write: .csv, .nc (NetCDF 3) or .tex (needs booktabs).",
)
def main(results: tuple[str, ...], path: str) -> None:
    """Convert RESULTs of one kind: JSON of calibrate, compare, diagnose, report, simulate or table,
    or the CSV of table.

    A calibration or simulation becomes a row, a diagnosis one row per effect, a table of eta one
    per point. NetCDF has readings and provenance too, and eta over n_gap, alpha_abs and alpha_scat.
    LaTeX has values with errors, rounded as the Particle Data Group does.
    """
    refuse_outputs({"--output": path}, results, suffixes={"--output": SUFFIXES})
    table = read_results(results)
    write_table(table, path)
    terminal.console().line(f"{path}: {table.kind}, {len(table.rows)} rows of {len(results)} files")


if __name__ == "__main__":
    sys.exit(terminal.run(main, "convert_results"))
