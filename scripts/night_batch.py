"""A night's batch: every campaign calibrated, diagnosed or reported, and one table of it all.

    python scripts/night_batch.py campaigns/*.toml -o night
    python scripts/night_batch.py campaigns/*.toml --verb report -o night

A campaign that fails does not stop the others: the table says why. The same line goes on after an
interruption: what was simulated is in the cache.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from convert_results import read_results
from shared import one_after_another, refuse_foreign, status_of

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import make_folder, refuse_outputs, resolved, write_text
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output.codec import csv_lines

_QUALITY = ("chi2", "ndf", "p_value")
_COLUMNS = (
    "campaign",
    "status",
    "verdict",
    "leading",
    *_QUALITY,
    ALPHA_SCAT,
    f"{ALPHA_SCAT}_sigma",
    LIGHT_YIELD,
    f"{LIGHT_YIELD}_sigma",
    "result",
    "reason",
)


@click.command()
@click.argument("campaigns", nargs=-1, required=True, metavar="CAMPAIGN...")
@click.option(
    "--verb",
    type=click.Choice(("calibrate", "diagnose", "report")),
    default="calibrate",
    show_default=True,
    help="What is done with each.",
)
@click.option(
    "-o",
    "--output",
    "folder",
    required=True,
    metavar="FOLDER",
    help="Where results and summary.csv go; made if it is not there.",
)
@options.photons("the verb's own")
@options.run
@click.option("--log", metavar="FILE", help="Append the progress, unit by unit, to this file.")
def main(campaigns, verb, folder, run, log) -> int:
    """Run a verb of mcrim on every CAMPAIGN (TOML), and write a summary of all.

    FOLDER gets each campaign's JSON (and report), and summary.csv. Kept is a result whose photons
    the cache has. Exit status 2 if campaigns were refused, 1 if one failed by our fault.
    """
    place = make_folder(folder)
    summary, results = place / "summary.csv", _results(campaigns, place)
    places = {str(campaign): str(result) for campaign, result in results.items()}
    refuse_outputs({"the summary": str(summary), **places}, campaigns)
    refuse_foreign(summary, lambda text: text.startswith(",".join(_COLUMNS)))
    for result in results.values():
        refuse_foreign(result, lambda _, result=result: bool(read_results([result]).rows))

    def do(campaign: Path, progress) -> dict:
        result = results[campaign]
        report = [result.with_suffix(".html")] if verb == "report" else []
        found = getattr(mcrim, verb)(campaign, *report, run=run, progress=progress)
        row = findings(json.loads(found.to_json(result)))
        return {"status": status_of(found.provenance), "result": str(result), **row}

    def told(rows: Mapping[Path, dict]) -> None:
        lines = [{"campaign": str(campaign), **row} for campaign, row in rows.items()]
        cells = ([line.get(name) for name in _COLUMNS] for line in lines)
        write_text(summary, csv_lines(_COLUMNS, cells))

    return one_after_another("campaigns", list(results), do, summary, log, told)


def _results(campaigns: Sequence[str], folder: Path) -> dict[Path, Path]:
    """JSON by campaign, named after it, and after its folder where needed."""
    paths = list({resolved(Path(campaign)): Path(campaign) for campaign in campaigns}.values())
    stems = [path.stem for path in paths]
    names = (
        p.stem if stems.count(p.stem) == 1 else f"{resolved(p).parent.name}_{p.stem}" for p in paths
    )
    return {path: folder / f"{name}.json" for path, name in zip(paths, names, strict=True)}


def findings(document: dict) -> dict:
    """What the summary says of a result; of a diagnosis the fit without further effects."""
    fit = document.get("calibration") or document.get("baseline") or document
    found = {name: fit[name] for name in _QUALITY}
    for name in (ALPHA_SCAT, LIGHT_YIELD):
        if known := fit["parameters"].get(name):
            found[name] = known["value"]
            found[f"{name}_sigma"] = None if known["at_bound"] else known["sigma"]
    leading = " or ".join(document.get("leading", ()))
    return found | {"verdict": document.get("verdict"), "leading": leading}


if __name__ == "__main__":
    sys.exit(terminal.run(main, "night_batch"))
