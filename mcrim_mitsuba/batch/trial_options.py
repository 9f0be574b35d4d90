"""Options of scripts that do trials: who does them, where they are kept, where progress goes."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from mcrim_mitsuba.batch.hands import Hands
from mcrim_mitsuba.cli.options import Whole


class Part(click.ParamType):
    """One part of several: 3/20."""

    name = "K/N"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", value.strip())
        part = found and (int(found[1]), int(found[2]))
        if not part or not 1 <= part[0] <= part[1]:
            self.fail(f"{value!r} is no part; give 1/20 to 20/20 to the 20 parts", param, ctx)
        return part


def hands(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--processes``, ``--cluster``, ``--unit`` and ``--units`` as one argument `hands`; `log`."""

    @click.option("--processes", type=Whole(1, 1024), default=os.cpu_count() or 1,
                  show_default="all processors", help="Trials that are under way at a time.",
                  )  # fmt: skip
    @click.option("--cluster", metavar="ADDRESS", help="Dask scheduler that does them instead.")
    @click.option("--unit", "part", type=Part(), metavar="K/N", default=(1, 1),
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
