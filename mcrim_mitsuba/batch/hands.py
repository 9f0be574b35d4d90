"""Who does many independent calls of a function: processes here, or a Dask cluster."""

from __future__ import annotations

import contextlib
import functools
import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Hashable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click

from mcrim_mitsuba.cli.options import Whole
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.runs.array_job import ArrayPart
from mcrim_mitsuba.runs.keys import package_hash

#: Processes that may die one after the other before a call ends.
_MOST_DEATHS = 3

Name = TypeVar("Name", bound=Hashable)
#: Name of a call, what it gave, or None and why it failed.
Outcomes = Generator[tuple[Name, Any, str | None], None, None]
# A function's folder, and a pickle that is unpacked after modules are looked for there too.
_Packed = tuple[str, bytes]


@dataclass(frozen=True)
class Hands:
    """Who does the work, which part of it, and where it is kept."""

    #: On this machine.
    processes: int = 1
    #: Address of a Dask scheduler that has it done instead.
    cluster: str | None = None
    #: ``(k, n)``: only every n-th piece, beginning with the k-th, counted from 1.
    part: tuple[int, int] = (1, 1)
    #: Of what is done; None for the cache's.
    folder: Path | None = None

    def share(self, work: Sequence[Any]) -> Sequence[Any]:
        """The pieces of this part."""
        number, of = self.part
        return work[number - 1 :: of]

    def outcomes(
        self, function: Callable[..., Any], arguments: Mapping[Name, tuple[Any, ...]]
    ) -> Outcomes[Name]:
        """Call a function again and again, and give what it gives in the order of coming.

        Parameters
        ----------
        function : callable
            Found by its name in its module.
        arguments : mapping of hashable to tuple
            For each call; of classes that are not the main script's.

        Yields
        ------
        name, result, failure : hashable, object, str or None
            A failure is why there is no result, in one line.

        Raises
        ------
        InputError
            If there is no such cluster.
        RuntimeError
            If process after process dies.
        """
        work = {name: _packed(function, those) for name, those in arguments.items()}
        if self.cluster:
            return _by_cluster(self.cluster, work)
        if self.processes == 1:
            return ((name, *_attempt(*packed)) for name, packed in work.items())
        return _by_processes(self.processes, work)


def _read_part(_ctx: click.Context, _param: click.Parameter, text: str | None) -> tuple[int, int]:
    """``K/N`` as numbers, as a callback of click."""
    part = ArrayPart(1, 1) if text is None else ArrayPart.parse(text)
    return part.number, part.count


def hands_options(function: Callable[..., Any]) -> Callable[..., Any]:
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
    @click.option("--log", metavar="FILE",
                  help="Append the progress, trial by trial, to this file.")  # fmt: skip
    @functools.wraps(function)
    def wrapped(**given: Any) -> Any:
        hands = Hands(*(given.pop(name) for name in ("processes", "cluster", "part", "folder")))
        if hands.cluster and hands.part != (1, 1):
            raise click.UsageError("--cluster and --unit: a cluster does all trials; give one")
        return function(hands=hands, **given)

    return wrapped


def _packed(function: Callable[..., Any], arguments: tuple) -> _Packed:
    file = Path(function.__code__.co_filename)
    # a script has another name where it is imported
    module = file.stem if function.__module__ == "__main__" else function.__module__
    folder = file.parents[module.count(".")]
    return str(folder), pickle.dumps((module, function.__name__, arguments))


def _attempt(path: str, packed: bytes) -> tuple[Any, str | None]:
    """What a call gives, or None and why there is nothing."""
    if path not in sys.path:
        sys.path.append(path)
    try:
        module, name, arguments = pickle.loads(packed)
        return getattr(importlib.import_module(module), name)(*arguments), None
    except InputError as error:
        return None, str(error)
    except Exception as error:  # an error of the package's is a result too; the others go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return None, f"{words} ({Path(where.filename).name}, line {where.lineno})"


def _by_processes(count: int, work: Mapping[Name, _Packed]) -> Outcomes[Name]:
    """Outcomes as they come; a process that dies costs the calls under way, which begin anew."""
    waiting, deaths = dict(work), 0
    while waiting:
        if deaths == _MOST_DEATHS:
            raise RuntimeError(
                f"{deaths} processes died before any call ended; is there enough memory?"
            )
        deaths += 1
        # started anew: a fork of a process whose threads run could hang
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(count, context, _begin) as pool:
            try:
                futures = {}
                with contextlib.suppress(BrokenProcessPool):
                    for name, packed in waiting.items():
                        futures[pool.submit(_attempt, *packed)] = name
                for future in as_completed(futures):
                    with contextlib.suppress(BrokenProcessPool):
                        outcome = future.result()
                        deaths = 0
                        yield futures[future], *outcome
                        del waiting[futures[future]]
            except BaseException:
                for process in multiprocessing.active_children():
                    process.terminate()
                raise


def _begin() -> None:
    """Leave interrupts to the parent, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _by_cluster(address: str, work: Mapping[Name, _Packed]) -> Outcomes[Name]:
    """Outcomes as they come; the scheduler gives the calls of workers that die to others."""
    from mcrim_mitsuba.runs.cluster import connect

    with connect(address) as client:
        from distributed import as_completed as as_they_come

        futures = {
            client.submit(_attempt_there, package_hash(), *packed, pure=False): name
            for name, packed in work.items()
        }
        for future in as_they_come(futures):
            try:
                outcome = future.result()
            except Exception as error:  # of the cluster: a call's own are in the outcome
                outcome = None, f"{type(error).__name__}: {error}"
            yield futures[future], *outcome


def _attempt_there(code: str, path: str, packed: bytes) -> tuple[Any, str | None]:
    """`_attempt` on a worker, if it has the same code as who asks for it."""
    if package_hash() != code:
        return None, "a worker has other code of mcrim_mitsuba; install the same everywhere"
    return _attempt(path, packed)
