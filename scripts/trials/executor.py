"""Trials that scripts do: each depends on its number alone, and is kept when it is done.

Executors of trials are processes of this machine, or the workers of a Dask cluster.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import click
from shared import package_hash, source_hash

from mcrim_mitsuba.cli import options
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import make_folder, read_text, sha256, write_text
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, Progress, processors
from mcrim_mitsuba.runs.array_job import ArrayPart
from mcrim_mitsuba.runs.cache import cache_folder
from mcrim_mitsuba.runs.cluster import connect
from mcrim_mitsuba.runs.executors import log
from mcrim_mitsuba.transport.variants import software_versions

#: Processes that may die one after the other before a call ends.
_MOST_DEATHS = 3

Name = TypeVar("Name", bound=Hashable)
#: Name of a call, what it gave, or None and why it failed.
Outcomes = Generator[tuple[Name, Any, str | None], None, None]
# A function's folder, and a pickle that is unpacked after modules are looked for there too.
_Packed = tuple[str, bytes]


@dataclass(frozen=True)
class TrialExecutor:
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


def executor_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--processes``, ``--cluster``, ``--unit`` and ``--units`` as `executor`; ``--log``."""

    @click.option(
        "--processes",
        type=options.Whole(1, 1024),
        default=processors(),
        show_default="all processors",
        help="Trials that are under way at a time.",
    )
    @click.option("--cluster", metavar="ADDRESS", help="Dask scheduler that does them instead.")
    @click.option(
        "--unit",
        "part",
        metavar="K/N",
        callback=_read_part,
        help="Do the K-th of N parts only, such as one of an array job; afterwards the "
        "same line without it finds what all parts have done.",
    )
    @click.option(
        "--units",
        "folder",
        type=click.Path(file_okay=False, path_type=Path),
        help="Folder of finished trials, which are not done again; default: in the user's cache.",
    )
    @options.file("--log", "Append the progress, trial by trial, to this file.")
    @functools.wraps(function)
    def wrapped(**given: Any) -> Any:
        executor = TrialExecutor(
            *(given.pop(name) for name in ("processes", "cluster", "part", "folder"))
        )
        if executor.cluster and executor.part != (1, 1):
            raise click.UsageError("--cluster and --unit: a cluster does all trials; give one")
        return function(executor=executor, **given)

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
            problem = f"{deaths} processes died before any call ended; is there enough memory?"
            raise RuntimeError(problem)
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
    scripts = str(Path(__file__).parents[1])
    with connect(address) as client:
        from distributed import as_completed as as_they_come

        futures = {
            client.submit(_by_value, scripts, package_hash(), *packed, pure=False): name
            for name, packed in work.items()
        }
        for future in as_they_come(futures, loop=client.loop):
            try:
                outcome = future.result()
            except Exception as error:  # of the cluster: a call's own are in the outcome
                outcome = None, f"{type(error).__name__}: {error}"
            yield futures[future], *outcome


def _by_value(scripts: str, code: str, path: str, packed: bytes) -> tuple[Any, str | None]:
    """`attempt_on_worker`, which a worker finds only where these scripts lie."""
    import sys

    if scripts not in sys.path:
        sys.path.append(scripts)
    from trials.executor import attempt_on_worker

    return attempt_on_worker(code, path, packed)


#: What is of no module that others have is sent as a whole, not by its name.
_by_value.__module__ = "__main__"


def attempt_on_worker(code: str, path: str, packed: bytes) -> tuple[Any, str | None]:
    """`_attempt` on a worker, if it has the same code as who asks for it."""
    if package_hash() != code:
        return None, "a worker has other code of mcrim_mitsuba; install the same everywhere"
    return _attempt(path, packed)


_LIMIT_MB = 200


def trial_key(name: str, parameters: dict[str, Any], code: Iterable[Path]) -> str:
    """SHA-256 (hexadecimal) of what trials of a kind have in common, and of the software.

    `code` are Python files that make the trials. Of the package's own the commands do not count.
    """
    own = {"code": package_hash(), "trials": source_hash(code)}
    software = {**software_versions(DEFAULT_VARIANT), **own}
    named = {"software": software, "name": name, "parameters": parameters}
    return sha256(json.dumps(named, sort_keys=True).encode())


@dataclass(frozen=True)
class Trial:
    """One trial."""

    #: Good for the name of a folder.
    kind: str
    #: What its random numbers depend on, beside the kind and what all trials have in common.
    number: int

    def __str__(self) -> str:
        return f"{self.kind} {self.number}"


class Trials:
    """Trials that are wanted, and those that are done.

    Parameters
    ----------
    name : str
        Of the script, good for the name of a folder.
    parameters : dict
        What all trials have in common, of what JSON can hold.
    wanted : sequence of Trial
    code : iterable of Path
        Python files that the results depend on, beside this package.
    executor : TrialExecutor

    Attributes
    ----------
    missing : list of Trial
        Those that are not done, of this part.
    results : dict of Trial to object
        As JSON gives them back.

    Raises
    ------
    InputError
        If the trials of a part would not be kept.
    """

    def __init__(
        self,
        name: str,
        parameters: dict[str, Any],
        wanted: Sequence[Trial],
        code: Sequence[Path],
        executor: TrialExecutor,
    ) -> None:
        self._key, self._executor = trial_key(name, parameters, code), executor
        cache = cache_folder()
        place = executor.folder or (cache and cache / "trials")
        if executor.part != (1, 1) and place is None:
            raise InputError("a part's trials must be kept", "name a folder by --units")
        self._folder = place and place / f"{name}-{self._key[:12]}"
        self._wanted = list(wanted)
        kept = {trial: self._read(trial) for trial in wanted}
        self.results = {trial: found for trial, found in kept.items() if found is not None}
        self.missing = [trial for trial in executor.share(wanted) if trial not in self.results]

    @property
    def elsewhere(self) -> int:
        """Trials that other parts have to do."""
        return len(self._wanted) - len(self.results) - len(self.missing)

    def state(self) -> str:
        """How many are done, in words."""
        words = f"{len(self.results)} of {len(self._wanted)} trials done"
        if self.elsewhere:
            return f"{words}; the same line without --unit goes on when the other parts are done"
        return f"{words}; the same line goes on from here"

    def do(
        self,
        function: Callable[..., Any],
        arguments: Mapping[Trial, tuple],
        report: Progress = lambda what, done, total, note="": None,
        found: Callable[[Trial, Any], None] = lambda trial, result: None,
    ) -> list[str]:
        """Do missing trials, and keep each as soon as it is done.

        Parameters
        ----------
        function : callable
            Gives what JSON can hold, never None; found by its name in its module.
        arguments : mapping of Trial to tuple
            Of the trials to do.
        report : callable
            ``report("trials", done, total)``.
        found : callable
            Told of each trial as it ends.

        Returns
        -------
        list of str
            Why others have failed; nothing is kept of those.

        Raises
        ------
        InputError
            If a trial cannot be kept, or there is no such cluster.
        KeyboardInterrupt
            If it was interrupted, with how many are done, in words.
        RuntimeError
            As `TrialExecutor.outcomes`.
        """
        failures = []
        waiting = [trial for trial in arguments if trial not in self.results]
        total = len(self.results) + len(waiting)
        report("trials", len(self.results), total)
        work = {trial: arguments[trial] for trial in waiting}
        with contextlib.closing(self._executor.outcomes(function, work)) as outcomes:
            try:
                for trial, result, failure in outcomes:
                    how = "made" if failure is None else f"failed: {failure}"
                    log.info("trial %s %s", trial, how)
                    if failure is not None:
                        failures.append(f"{trial}: {failure}")
                        continue
                    # as it will be read: tuples have become lists
                    text = json.dumps(result)
                    self._write(trial, text)
                    self.results[trial] = json.loads(text)
                    self.missing = [other for other in self.missing if other != trial]
                    found(trial, self.results[trial])
                    report("trials", len(self.results), total)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(f"interrupted: {self.state()}") from None
        return failures

    def _file(self, trial: Trial) -> Path:
        assert self._folder is not None
        return self._folder / f"{trial.kind}-{trial.number:06d}.json"

    def _read(self, trial: Trial) -> Any:
        """What was kept; None where that is nothing, or damaged."""
        if self._folder is None or not self._file(trial).is_file():
            return None
        try:
            content = json.loads(read_text(self._file(trial), _LIMIT_MB))
            text = json.dumps(content["result"])
            sound = (content["key"], content["sha256"]) == (self._key, sha256(text.encode()))
        except (ValueError, KeyError, TypeError):  # an InputError, too
            return None
        return content["result"] if sound else None

    def _write(self, trial: Trial, text: str) -> None:
        if self._folder is not None:
            make_folder(self._folder)
            head = f'{{"key": "{self._key}", "sha256": "{sha256(text.encode())}"'
            write_text(self._file(trial), f'{head},\n "result": {text}}}\n')
