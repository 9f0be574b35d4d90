"""A mcrim command on an HTCondor pool: jobs are submitted for it, and end with it.

    python scripts/cluster_htcondor.py --jobs 16 --cores 4 -- diagnose campaign.toml --json d.json

Run it where jobs can be submitted and where it may stay: it holds the scheduler, and keeps what
the workers send back. The jobs need the same Python environment, in a folder that all machines
see, and must be able to reach this machine. A job that dies costs the units it was at; one that
starts later joins in. Interrupted, the same line goes on. Needs
pip install 'mcrim-mitsuba[cluster]'.
"""

from __future__ import annotations

import click
from cluster_command import COMMAND, job_options, main, run_on


@click.command(context_settings={"ignore_unknown_options": True})
@job_options
@click.option("--disk", default="2GB", show_default=True, help="Of a job.")
@COMMAND
def htcondor(jobs, cores, memory, disk, log_directory, show, command) -> None:
    """Run mcrim COMMAND with workers that HTCondor starts."""
    from dask_jobqueue import HTCondorCluster

    run_on(
        lambda: HTCondorCluster(
            cores=cores, processes=cores, memory=memory, disk=disk,
            log_directory=log_directory,
        ),
        command, jobs=jobs, submit="condor_submit", show=show,
    )  # fmt: skip


if __name__ == "__main__":
    main(htcondor, "cluster_htcondor")
