"""One mcrim command on a cluster that is started for it: what the cluster_*.py scripts share."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from typing import Any

import click

from mcrim_mitsuba.cli.main import mcrim
from mcrim_mitsuba.cli.options import Whole
from mcrim_mitsuba.cli.running import run
from mcrim_mitsuba.errors import InputError

#: Arguments of the mcrim command, after the script's own.
COMMAND = click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)


def job_options(function: Callable[..., None]) -> Callable[..., None]:
    """Options of every batch system's jobs."""
    for decorate in (
        click.option("--show", is_flag=True, help="Show what would be submitted, and do nothing."),
        click.option("--log-directory", metavar="FOLDER", help="Where the jobs' own logs go."),
        click.option("--memory", default="8GB", show_default=True, help="Of a job."),
        click.option("--cores", type=Whole(1, 1024), default=4, show_default=True,
                     help="Of a job: as many workers, of one thread each."),
        click.option("--jobs", type=Whole(1, 10_000), default=4, show_default=True,
                     help="That are submitted."),
    ):  # fmt: skip
        function = decorate(function)
    return function


def run_on(
    cluster: Callable[[], Any],
    command: tuple[str, ...],
    *,
    jobs: int = 0,
    submit: str = "",
    show: bool = False,
) -> None:
    """Start a cluster, run ``mcrim COMMAND --cluster ADDRESS``, stop it, and exit as that does.

    Parameters
    ----------
    cluster : callable
        Makes a Dask cluster object.
    command : tuple of str
    jobs : int
        To be submitted, where the cluster has no workers yet.
    submit : str
        The batch system's command for that.
    show : bool
        Print a job's script instead.

    Raises
    ------
    InputError
        If the cluster does not start.
    """
    if jobs and not show and shutil.which(submit) is None:
        raise InputError(
            f"there is no command {submit} here", "run this where jobs can be submitted"
        )
    words = command[1:] if command[0] == "mcrim" else command
    try:
        started = cluster()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(
            f"the cluster does not start ({' '.join(str(error).split())})",
            "run this where jobs can be submitted",
        ) from None
    with started:
        if show:
            click.echo(started.job_script())
            return
        if jobs:
            started.scale(jobs=jobs)
        status = run(mcrim, "mcrim", [*words, "--cluster", started.scheduler_address])
    sys.exit(status)


def main(command: click.Command, name: str) -> None:
    """Run a script's command; bad input becomes one line and exit status 2."""
    try:
        command.main(standalone_mode=False)
    except InputError as wrong:
        print(f"{name}: {wrong}", file=sys.stderr)
        sys.exit(2)
    except click.ClickException as wrong:
        print(f"{name}: {wrong.format_message()}", file=sys.stderr)
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(f"{name}: interrupted; what was finished is kept")
