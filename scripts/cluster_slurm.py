"""A mcrim command on a Slurm cluster: jobs are submitted for it, and end with it.

    python scripts/cluster_slurm.py --jobs 16 --cores 4 -- diagnose campaign.toml --json d.json

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
@click.option("--queue", metavar="NAME", help="Partition (default: the site's).")
@click.option("--account", metavar="NAME", help="Whom the time is charged to, where needed.")
@click.option("--walltime", default="02:00:00", show_default=True, help="Of a job.")
@COMMAND
def slurm(jobs, cores, memory, queue, account, walltime, log_directory, show, command) -> None:
    """Run mcrim COMMAND with workers that Slurm starts."""
    from dask_jobqueue import SLURMCluster

    run_on(
        lambda: SLURMCluster(
            cores=cores, processes=cores, memory=memory, queue=queue, account=account,
            walltime=walltime, log_directory=log_directory,
        ),
        command, jobs=jobs, submit="sbatch", show=show,
    )  # fmt: skip


if __name__ == "__main__":
    main(slurm, "cluster_slurm")
