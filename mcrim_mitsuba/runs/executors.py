"""Who does the units of a job: this process, unless `use_executor` names another executor."""

from __future__ import annotations

import contextlib
import contextvars
import json
import logging
import pickle
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cloudpickle
from numpy.typing import NDArray

from mcrim_mitsuba.core.files import sha256
from mcrim_mitsuba.core.run import OWN_MODULES, Progress
from mcrim_mitsuba.runs.cache import RecordCache
from mcrim_mitsuba.runs.cache_files import Chunk


def number_of(*identity: object) -> int:
    """A chunk's number, made of what JSON can hold and what tells it from others of its job."""
    text = json.dumps(identity, sort_keys=True, default=str)
    return int(sha256(text.encode())[:15], 16)


#: What a unit makes under one number: arrays of one dimension, and what JSON can hold.
Content = tuple[Mapping[str, NDArray[Any]], Mapping[str, object]]


class Unit(Protocol):
    """A piece of work whose result depends on what it says itself, and on nothing else."""

    @property
    def what(self) -> str:
        """Of what it is a part, for people."""

    @property
    def photons(self) -> int:
        """That it follows."""

    @property
    def expected_s(self) -> float:
        """Processor time that it takes, roughly."""

    @property
    def variant(self) -> str:
        """Of Mitsuba."""

    @property
    def modules(self) -> set[str]:
        """Whose code makes it, for `runs.cache.record_versions`."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the chunks that it makes, in the cache of its job."""

    def make(self, threads: int | None) -> dict[int, Content]:
        """The chunks by number; `threads` (all when None) do not change them."""

    def check(self, threads: int | None) -> None:
        """Refuse, by an InputError, what no unit should be made of; before it is made."""

    def portable(self) -> Unit:
        """The same unit as it is sent to another machine: without a need of files here."""


@dataclass(frozen=True, eq=False)
class Task:
    """A unit and where it is kept."""

    unit: Unit
    #: Of its job: the key says what all units of it have in common.
    cache: RecordCache


# How far a job is: for whoever asked for it, and for the log.

#: One line per unit that is begun, made or kept; silent unless somebody listens.
log = logging.getLogger("mcrim_mitsuba.runs")
log.addHandler(logging.NullHandler())
log.setLevel(logging.INFO)
log.propagate = False


class Track:
    """Counts units and their photons, and says so."""

    def __init__(self, tasks: Sequence[Task], progress: Progress | None) -> None:
        self._tasks, self._progress = tasks, progress
        # by part: units, and photons
        self._count = Counter(task.unit.what for task in tasks)
        self._total, self._done, self._photons = Counter[str](), Counter[str](), Counter[str]()
        for unit in (task.unit for task in tasks):
            self._total[unit.what] += unit.photons

    def begun(self, index: int) -> None:
        """A unit is about to be made."""
        log.info("unit %d of %d begun, %s", index + 1, len(self._tasks), self._id(index))
        self.tell(self._tasks[index].unit.what)

    def done(self, index: int, *, cached: bool) -> None:
        """A unit is there."""
        unit = self._tasks[index].unit
        how = "kept" if cached else f"made, {unit.photons} photons"
        log.info("unit %d of %d %s, %s", index + 1, len(self._tasks), how, self._id(index))
        self._photons[unit.what] += unit.photons
        self._done[unit.what] += 1
        self.tell(unit.what)

    def tell(self, what: str, remark: str = "") -> None:
        """Say how far a part is, and what there is to be said of it."""
        if self._progress is None:
            return
        units = f"{self._done[what]} of {self._count[what]} units"
        note = f"{units}, {remark}" if remark else units
        self._progress(what, self._photons[what], self._total[what], note)

    def _id(self, index: int) -> str:
        task = self._tasks[index]
        return f"{task.cache.name}-{task.unit.numbers[0]}"


@dataclass(frozen=True, eq=False)
class Done:
    """A unit with its result."""

    #: Place among the tasks that were asked for.
    index: int
    task: Task
    #: By number.
    chunks: dict[int, Chunk]
    #: Whether the cache had it.
    cached: bool


class Executor:
    """Does units in this process, one after the other."""

    def cache(self, key: Mapping[str, object]) -> RecordCache:
        """Where the units of a job are kept, by what they have in common."""
        return RecordCache(key)

    def do(
        self,
        tasks: Sequence[Task],
        *,
        threads: int | None = None,
        by_all: bool = False,
        progress: Progress | None = None,
    ) -> Iterator[Done]:
        """Results in the order of the tasks, whoever does them and whenever they come.

        Parameters
        ----------
        tasks : sequence of Task
            What their cache has is not made again; what is made goes there at once.
        threads : int, optional
            Processor threads of a unit; all when not given.
        by_all : bool
            Few units that decide what comes next: each process of an array job makes all of
            them for itself.
        progress : callable, optional
            See `Progress`.

        Raises
        ------
        InputError
            If a unit refuses what it is made of.
        """
        track = Track(tasks, progress)
        for index, task in enumerate(tasks):
            chunks = kept(task)
            cached = chunks is not None
            if chunks is None:
                track.begun(index)
                chunks = self.make(task, threads)
            track.done(index, cached=cached)
            yield Done(index, task, chunks, cached)

    def make(self, task: Task, threads: int | None) -> dict[int, Chunk]:
        """Make a unit here and now, and keep it."""
        task.unit.check(threads)
        return keep(task, task.unit.make(threads))


class HandingExecutor(Executor):
    """Hands units to others, some ahead of their turn, and keeps what comes back."""

    def do(
        self, tasks: Sequence[Task], *, progress: Progress | None = None, **_how: Any
    ) -> Iterator[Done]:
        """See `Executor.do`; threads are those of whoever does the units."""
        track = Track(tasks, progress)
        # what is handed out, what is there ahead of its turn, and how many were begun
        out: dict[Any, int] = {}
        there: dict[int, Done] = {}
        begun = 0
        try:
            for wanted in range(len(tasks)):
                while wanted not in there:
                    # what is there ahead of its turn takes memory too
                    for index in range(begun, min(len(tasks), wanted + self.ahead())):
                        begun, task = index + 1, tasks[index]
                        chunks = kept(task)
                        if chunks is not None:
                            track.done(index, cached=True)
                            there[index] = Done(index, task, chunks, cached=True)
                            continue
                        track.begun(index)
                        out[self.submit(task.unit)] = index
                    for future in [] if wanted in there else self.finished(out, tasks, track):
                        index = out.pop(future)
                        chunks = keep(tasks[index], self.result(future, tasks[index]))
                        track.done(index, cached=False)
                        there[index] = Done(index, tasks[index], chunks, cached=False)
                yield there.pop(wanted)
        finally:
            self.give_up(list(out))

    def ahead(self) -> int:
        """How many units may be under way, or wait for their turn."""
        raise NotImplementedError

    def submit(self, unit: Unit) -> Any:
        """Hand a unit out; gives what stands for its result, hashable."""
        raise NotImplementedError

    def finished(
        self, out: Mapping[Any, int], tasks: Sequence[Task], track: Track
    ) -> Iterable[Any]:
        """Wait for results; none where there is none for a while."""
        raise NotImplementedError

    def result(self, future: Any, task: Task) -> dict[int, Content]:
        """What came back."""
        raise NotImplementedError

    def give_up(self, futures: Sequence[Any]) -> None:
        """Nobody wants these any more."""
        raise NotImplementedError


def pickled(unit: Unit) -> bytes:
    """A unit as bytes, with the user's own effects by value: others do not have their modules."""
    own = [module for name, module in sys.modules.items() if name.startswith(OWN_MODULES)]
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        return cloudpickle.dumps(unit, protocol=pickle.HIGHEST_PROTOCOL)
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def kept(task: Task) -> dict[int, Chunk] | None:
    """A unit's chunks from the cache; None unless all of them are there."""
    found = {}
    for number in task.unit.numbers:
        chunk = task.cache.read(number)
        if chunk is None:
            return None
        found[number] = chunk
    return found


def keep(task: Task, contents: Mapping[int, Content]) -> dict[int, Chunk]:
    """Put what a unit made into the cache."""
    for number, content in contents.items():
        task.cache.write(number, *content)
    return {n: Chunk(n, dict(arrays), dict(data)) for n, (arrays, data) in contents.items()}


_current: contextvars.ContextVar[Executor] = contextvars.ContextVar("executor")


def current_executor() -> Executor:
    """The executor of the innermost `use_executor`; without one, this process."""
    return _current.get(None) or Executor()


@contextlib.contextmanager
def use_executor(executor: Executor) -> Iterator[Executor]:
    """Let an executor do the units of everything that is begun within the ``with`` block.

    Examples
    --------
    >>> from mcrim_mitsuba.runs.cluster import ClusterExecutor
    >>> with use_executor(ClusterExecutor("tcp://127.0.0.1:8786")):  # doctest: +SKIP
    ...     calibrate("camoo4_campaign.toml")
    """
    token = _current.set(executor)
    try:
        yield executor
    finally:
        _current.reset(token)
