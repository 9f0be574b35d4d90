"""A mcrim command on a cluster that is started for it, and ends with it.

    python scripts/cluster.py slurm --jobs 16 --cores 4 -- diagnose campaign.toml --json d.json
    python scripts/cluster.py htcondor --jobs 16 --cores 4 -- diagnose campaign.toml --json d.json
    python scripts/cluster.py local --workers 4 -- diagnose campaign.toml --json d.json

Slurm and HTCondor: run it where jobs can be submitted and where it may stay, for it holds the
scheduler, and keeps what the workers send back. The jobs need the same Python environment, in a
folder that all machines see, and must be able to reach this machine. A job that dies costs the
units it was at; one that starts later joins in. Interrupted, the same line goes on.

Local: one worker process per processor of this machine. A plain command uses all processors too,
within one process; workers are worth it where single simulations are short, and to try what a
cluster will do. All need pip install 'mcrim-mitsuba[cluster]'.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from typing import Any

import click

from mcrim_mitsuba.cli.main import mcrim
from mcrim_mitsuba.cli.options import Whole
from mcrim_mitsuba.cli.terminal import DONE, run
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import processors

_WHERE = "run this where jobs can be submitted"
_SETTINGS = {"ignore_unknown_options": True}
#: Of the mcrim command, after this script's own.
_COMMAND = click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)


def _job_options(function: Callable[..., int]) -> Callable[..., int]:
    """Options of every batch system's jobs, and the command."""
    for decorate in (
        _COMMAND,
        click.option("--show", is_flag=True, help="Show what would be submitted, and do nothing."),
        click.option("--log-directory", metavar="FOLDER", help="Where the jobs' own logs go."),
        click.option("--memory", default="8GB", show_default=True, help="Of a job."),
        click.option(
            "--cores",
            type=Whole(1, 1024),
            default=4,
            show_default=True,
            help="Of a job: as many workers, of one thread each.",
        ),
        click.option(
            "--jobs",
            type=Whole(1, 10_000),
            default=4,
            show_default=True,
            help="That are submitted.",
        ),
    ):
        function = decorate(function)
    return function


def _run_on(cluster: Callable[[], Any], command: tuple[str, ...], jobs: int, show: bool) -> int:
    """Start a cluster, run ``mcrim COMMAND --cluster ADDRESS``, stop it; the exit status of that.

    Of a batch system, `jobs` are submitted; `show` prints a job's script instead.
    """
    words = command[1:] if command[0] == "mcrim" else command
    verb = mcrim.get_command(click.Context(mcrim), words[0]) if words else None
    # groups tell of their verbs themselves, and later
    taken = verb is None or isinstance(verb, click.Group)
    if not taken and not any("--cluster" in option.opts for option in verb.params):
        raise InputError(f"{words[0]} has no option --cluster", "run it without this script")
    try:
        started = cluster()
    except (OSError, RuntimeError, ValueError) as error:
        why = " ".join(str(error).split())
        raise InputError(f"the cluster does not start ({why})", _WHERE) from None
    with started:
        if show:
            click.echo(started.job_script())
            return DONE
        if jobs:
            started.scale(jobs=jobs)
        return run(mcrim, "mcrim", [*words, "--cluster", started.scheduler_address])


def _submit(kind: str, by: str, command: tuple[str, ...], jobs: int, show: bool, **job: Any) -> int:
    """`_run_on` a cluster of dask-jobqueue, whose jobs the command `by` submits."""
    import dask_jobqueue

    if not show and shutil.which(by) is None:
        raise InputError(f"there is no command {by} here", _WHERE)
    of_kind = getattr(dask_jobqueue, kind)
    return _run_on(lambda: of_kind(processes=job["cores"], **job), command, jobs, show)


@click.group()
def main() -> None:
    """Run a mcrim command with workers that are started for it."""


@main.command(context_settings=_SETTINGS)
@click.option("--queue", metavar="NAME", help="Partition (default: the site's).")
@click.option("--account", metavar="NAME", help="Whom the time is charged to, where needed.")
@click.option("--walltime", default="02:00:00", show_default=True, help="Of a job.")
@_job_options
def slurm(**options: Any) -> int:
    """Run mcrim COMMAND with workers that Slurm starts."""
    return _submit("SLURMCluster", "sbatch", **options)


@main.command(context_settings=_SETTINGS)
@click.option("--disk", default="2GB", show_default=True, help="Of a job.")
@_job_options
def htcondor(**options: Any) -> int:
    """Run mcrim COMMAND with workers that HTCondor starts."""
    return _submit("HTCondorCluster", "condor_submit", **options)


@main.command(context_settings=_SETTINGS)
@click.option(
    "--workers",
    type=Whole(1, 1024),
    default=processors(),
    show_default=True,
    help="Processes of one thread each.",
)
@_COMMAND
def local(workers: int, command: tuple[str, ...]) -> int:
    """Run mcrim COMMAND with worker processes of this machine."""
    from distributed import LocalCluster

    return _run_on(
        lambda: LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ),
        command,
        jobs=0,
        show=False,
    )


if __name__ == "__main__":
    sys.exit(run(main, "cluster"))
