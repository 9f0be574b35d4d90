"""A mcrim command on all processors of this machine, one worker process each.

    python scripts/cluster_local.py --workers 4 -- diagnose campaign.toml --json d.json

A plain command uses all processors too, within one process; workers are worth it where single
simulations are short, and to try what a cluster will do. Needs
pip install 'mcrim-mitsuba[cluster]'.
"""

from __future__ import annotations

import os

import click
from cluster_command import COMMAND, main, run_on

from mcrim_mitsuba.cli.options import Whole


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--workers", type=Whole(1, 1024), default=os.cpu_count() or 1, show_default=True,
              help="Processes of one thread each.")  # fmt: skip
@COMMAND
def local(workers: int, command: tuple[str, ...]) -> None:
    """Run mcrim COMMAND with worker processes of this machine."""
    from distributed import LocalCluster

    run_on(
        lambda: LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ),
        command,
    )


if __name__ == "__main__":
    main(local, "cluster_local")
