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

from mcrim_mitsuba.cli import campaign_jobs as batch
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import make_folder, refuse_outputs, write_text


@click.command()
@click.argument("campaigns", nargs=-1, required=True, metavar="CAMPAIGN...")
@click.option("--verb", type=click.Choice(batch.VERBS), default=batch.VERBS[0], show_default=True,
              help="What is done with each.")  # fmt: skip
@click.option("-o", "--output", "folder", required=True, metavar="FOLDER",
              help="Where results and summary.csv go; made if it is not there.")  # fmt: skip
@options.photons("the verb's own")
@options.seed
@options.machine
@click.option("--log", metavar="FILE", help="Append the progress, unit by unit, to this file.")
def main(campaigns, folder, log, **how) -> int:
    """Run a verb of mcrim on every CAMPAIGN (TOML), and write a summary of all.

    FOLDER gets each campaign's JSON (and report), and summary.csv. Exit status 2 if campaigns
    were refused, 1 if one failed by our fault.
    """
    place = Path(folder)
    summary = place / batch.SUMMARY
    jobs = batch.campaign_jobs(campaigns, folder=place, log=log, **how)
    make_folder(place)
    refuse_outputs({"the summary": str(summary)}, campaigns)
    batch.refuse_summary(summary)
    for job in jobs:
        job.refuse_place()
    screen = terminal.console()
    rows = []
    try:
        with terminal.photon_progress(log=log) as report:
            for number, job in enumerate(jobs):
                report("campaigns", number, len(jobs), str(job.campaign))
                row = batch.do(job)
                rows.append(row)
                write_text(summary, batch.summary_text(rows))
                screen.line(f"{job.campaign}: {row['status']}: {row['reason'] or job.result}")
    except KeyboardInterrupt:
        screen.say(f"interrupted after {len(rows)} of {len(jobs)}; the same line goes on from here")
        return terminal.INTERRUPTED
    statuses = [row["status"] for row in rows]
    counts = {one: statuses.count(one) for one in batch.STATUSES}
    words = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    screen.line(f"{len(jobs)} campaigns: {words}; {summary}")
    if batch.FAILED in statuses:
        return terminal.OUR_FAULT
    return terminal.YOUR_INPUT if batch.REFUSED in statuses else terminal.DONE


if __name__ == "__main__":
    sys.exit(terminal.run(main, "night_batch"))
