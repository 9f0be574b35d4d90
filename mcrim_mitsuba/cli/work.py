"""Options of long commands: who does their units, and where their progress is written."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import RenderableType

from mcrim_mitsuba.cache import record_versions
from mcrim_mitsuba.cli import output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import resolved
from mcrim_mitsuba.kernel.variants import DEFAULT_VARIANT
from mcrim_mitsuba.work import Crew, Progress, current_crew, use_crew
from mcrim_mitsuba.work.array_job import (
    DEFAULT_FOLDER,
    Part,
    PartCrew,
    PartDoneError,
    UnitFolder,
)

#: Suffixes of files that lines of a log would spoil.
_NO_LOGS = (".xml", ".toml", ".csv", ".json")


@dataclass(frozen=True)
class Work:
    """What the options say.

    Attributes
    ----------
    cluster : str or None
        Address of a Dask scheduler.
    part : Part or None
        Of an array job.
    units : str
        Folder of the array job.
    log : str or None
        File for the progress.
    """

    cluster: str | None
    part: Part | None
    units: str
    log: str | None

    @contextlib.contextmanager
    def begin(self, above: RenderableType | None = None) -> Iterator[Progress]:
        """Let what follows be done by whom the options name.

        Parameters
        ----------
        above : renderable, optional
            Shown over the bar.

        Yields
        ------
        Progress

        Raises
        ------
        InputError
            If the cluster does not answer, or the array job's folder cannot be used.
        PartDoneError
            At the end of a part of an array job.
        """
        with (
            output.photon_progress(above, log=self.log) as report,
            self._crew() as crew,
            use_crew(crew),
        ):
            if not isinstance(crew, PartCrew):
                yield report
                return
            try:
                yield report
                # a part has no result, even where it finds all units made
                raise crew.done
            except PartDoneError as done:
                crew.finish(done)
                raise

    @contextlib.contextmanager
    def _crew(self) -> Iterator[Crew]:
        if self.cluster is not None and self.part is not None:
            raise InputError(
                "--cluster and --unit are two ways to share the work out", "give one of them"
            )
        if self.cluster is not None:
            from mcrim_mitsuba.work.cluster import ClusterCrew

            crew = ClusterCrew(self.cluster)
            try:
                if not crew.workers:
                    waiting = f"no workers at {self.cluster} yet: the work begins with the first"
                    output.console("-").say_notes([waiting])
                yield crew
            finally:
                crew.close()
        elif self.part is not None:
            folder = UnitFolder(self.units)
            folder.begin(_command(), self.part)
            yield PartCrew(folder, self.part)
        else:
            yield current_crew()


def options(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--cluster``, ``--unit``, ``--units`` and ``--log``, as one argument `work`."""

    @functools.wraps(function)
    def with_work(*arguments: Any, cluster, unit, units, log, **given: Any) -> Any:
        part = None if unit is None else Part.parse(unit)
        if part is None and units != DEFAULT_FOLDER:
            raise InputError(
                "--units without --unit: nobody shares this folder", "give --unit K/N too"
            )
        if log is not None:
            _refuse_log(log, given)
        if part is not None and given.get("precision") is not None:
            raise InputError(
                "--precision with --unit: nobody knows beforehand how many units it takes",
                "give --photons",
            )
        return function(*arguments, work=Work(cluster, part, units, log), **given)

    for decorate in (
        click.option(
            "--log", metavar="FILE",
            help="Append the progress, unit by unit, to this file.",
        ),
        click.option(
            "--units", metavar="FOLDER", default=DEFAULT_FOLDER, show_default=True,
            help="Folder that the parts of --unit share.",
        ),
        click.option(
            "--unit", metavar="K/N",
            help="Do part K of N only, as one job of an array; `mcrim merge` puts them together.",
        ),
        click.option(
            "--cluster", metavar="ADDRESS",
            help="Let the workers of a Dask scheduler do the work (tcp://host:8786).",
        ),
    ):  # fmt: skip
        with_work = decorate(with_work)
    return with_work


def _refuse_log(log: str, given: Mapping[str, Any]) -> None:
    """Refuse a log whose lines would go into something else."""
    path = Path(log)
    if log == "-" or path.suffix.lower() in _NO_LOGS:
        raise InputError("--log would write its lines there", "let the name end in .log", path=log)
    for word in given.values():
        if isinstance(word, str) and resolved(Path(word)) == resolved(path):
            raise InputError(
                "--log names what the command reads or writes", "give it a file of its own",
                path=log,
            )  # fmt: skip


def _command() -> dict[str, Any]:
    """The command of this process without what differs from part to part."""
    context = click.get_current_context()
    given = list((context.find_root().obj or {}).get("arguments", ()))
    arguments, skip = [], False
    for word in given:
        if skip or word in ("--unit", "--units", "--log"):
            skip = not skip
        elif not word.startswith(("--unit=", "--units=", "--log=")):
            arguments.append(word)
    return {
        "arguments": arguments,
        "folder": os.getcwd(),
        "versions": record_versions(context.params.get("variant") or DEFAULT_VARIANT),
    }
