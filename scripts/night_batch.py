"""A night's batch: every campaign calibrated, diagnosed or reported, and one table of it all.

    python scripts/night_batch.py campaigns/*.toml -o night
    python scripts/night_batch.py campaigns/*.toml --verb report -o night

A campaign that fails does not stop the others: the table says why. The same line goes on after an
interruption: results that are there are kept, unless the campaign's files, the options or the
software have changed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from mcrim_mitsuba.batch.campaigns import (
    FAILED,
    KEPT,
    MADE,
    REFUSED,
    SUMMARY,
    VERBS,
    campaign_jobs,
    do,
    refuse_summary,
    summary_text,
)
from mcrim_mitsuba.batch.tables import make_folder
from mcrim_mitsuba.cli import options
from mcrim_mitsuba.cli import terminal as output
from mcrim_mitsuba.cli.terminal import DONE, INTERRUPTED, OUR_FAULT, YOUR_INPUT, run
from mcrim_mitsuba.core.files import refuse_outputs, write_text


@click.command()
@click.argument("campaigns", nargs=-1, required=True, metavar="CAMPAIGN...")
@click.option("--verb", type=click.Choice(VERBS), default=VERBS[0], show_default=True,
              help="What is done with each.")  # fmt: skip
@click.option("-o", "--output", "folder", required=True, metavar="FOLDER",
              help="Where results and summary.csv go; made if it is not there.")  # fmt: skip
@options.photons("the verb's own")
@options.seed
@options.machine
@click.option("--log", metavar="FILE", help="Append the progress, unit by unit, to this file.")
def main(campaigns, verb, folder, photons, seed, variant, threads, log) -> int:
    """Run a verb of mcrim on every CAMPAIGN (TOML), and write a summary of all.

    FOLDER gets each campaign's JSON (and report), and summary.csv. Exit status 2 if campaigns
    were refused, 1 if one failed by our fault.
    """
    place = Path(folder)
    jobs = campaign_jobs(
        campaigns, verb, place, photons=photons, seed=seed, variant=variant, threads=threads,
        log=log,
    )  # fmt: skip
    make_folder(place)
    refuse_outputs({"the summary": str(place / SUMMARY)}, campaigns)
    refuse_summary(place / SUMMARY)
    for job in jobs:
        job.refuse_place()
    screen = output.console()
    rows = []
    try:
        with output.photon_progress(log=log) as report:
            for number, job in enumerate(jobs):
                report("campaigns", number, len(jobs), str(job.campaign))
                row = do(job)
                rows.append(row)
                write_text(place / SUMMARY, summary_text(rows))
                what = row["reason"] or job.result
                screen.line(f"{job.campaign}: {row['status']}: {what}")
    except KeyboardInterrupt:
        screen.say(f"interrupted after {len(rows)} of {len(jobs)}; the same line goes on from here")
        return INTERRUPTED
    counts = {status: sum(row["status"] == status for row in rows)
              for status in (MADE, KEPT, REFUSED, FAILED)}  # fmt: skip
    words = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    screen.line(f"{len(jobs)} campaigns: {words}; {place / SUMMARY}")
    return OUR_FAULT if counts[FAILED] else YOUR_INPUT if counts[REFUSED] else DONE


if __name__ == "__main__":
    sys.exit(run(main, "night_batch"))
