"""Options of scripts that do trials: who does them, where they are kept, where progress goes."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from mcrim_mitsuba.batch.hands import Hands
from mcrim_mitsuba.cli.options import Whole
from mcrim_mitsuba.runs.array_job import ArrayPart


def _read_part(_ctx: click.Context, _param: click.Parameter, text: str | None) -> tuple[int, int]:
    """``K/N`` as numbers, as a callback of click."""
    if text is None:
        return 1, 1
    part = ArrayPart.parse(text)
    return part.number, part.count


def hands(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--processes``, ``--cluster``, ``--unit`` and ``--units`` as one argument `hands`; `log`."""

    @click.option("--processes", type=Whole(1, 1024), default=os.cpu_count() or 1,
                  show_default="all processors", help="Trials that are under way at a time.",
                  )  # fmt: skip
    @click.option("--cluster", metavar="ADDRESS", help="Dask scheduler that does them instead.")
    @click.option("--unit", "part", metavar="K/N", callback=_read_part,
                  help="Do the K-th of N parts only, such as one of an array job; afterwards the "
                  "same line without it finds what all parts have done.")  # fmt: skip
    @click.option("--units", "folder", type=click.Path(file_okay=False, path_type=Path),
                  help="Folder of finished trials, which are not done again; default: in the "
                  "user's cache.")  # fmt: skip
    @click.option(
        "--log", metavar="FILE", help="Append the progress, trial by trial, to this file."
    )
    @functools.wraps(function)
    def wrapped(
        *args: Any,
        processes: int,
        cluster: str | None,
        part: tuple[int, int],
        folder: Path | None,
        **kwargs: Any,
    ) -> Any:
        if cluster and part != (1, 1):
            raise click.UsageError("--cluster and --unit: a cluster does all trials; give one")
        return function(*args, hands=Hands(processes, cluster, part, folder), **kwargs)

    return wrapped
