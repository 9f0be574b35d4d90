"""Who does units of work: this process, or processes, unless `use_executor` names another."""

from __future__ import annotations

import contextlib
import contextvars
import json
import logging
import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol

import cloudpickle
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import sha256
from mcrim_mitsuba.core.run import OWN_MODULES, Progress, processors, seldom_garbage
from mcrim_mitsuba.runs.cache import RecordCache
from mcrim_mitsuba.runs.cache_files import Chunk


def number_of(*identity: object) -> int:
    """A chunk's number, made of what JSON can hold and what tells it from others of its key."""
    text = json.dumps(identity, sort_keys=True, default=str)
    return int(sha256(text.encode())[:15], 16)


#: What a unit makes under one number: arrays of one dimension, and what JSON can hold.
Content = tuple[Mapping[str, NDArray[Any]], Mapping[str, object]]
#: All that it makes, by number.
Contents = dict[int, Content]


class WorkItem(Protocol):
    """A piece of work whose result depends on what it says itself, and on nothing else."""

    @property
    def what(self) -> str:
        """Of what it is a part, for people."""

    @property
    def photons(self) -> int:
        """That it follows."""

    @property
    def variant(self) -> str:
        """Of Mitsuba."""

    @property
    def modules(self) -> set[str]:
        """Whose code makes it, for `runs.cache.record_versions`."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the chunks that it makes, in the cache of its key."""

    def make(self, threads: int | None) -> Contents:
        """The chunks by number; `threads` (all when None) do not change them."""

    def check(self, threads: int | None) -> None:
        """Refuse, by an InputError, what no unit should be made of; before it is made."""

    def portable(self) -> WorkItem:
        """This unit as it is sent to another machine: without a need of files here."""


@dataclass(frozen=True, eq=False)
class Job:
    """A unit and where it is kept."""

    unit: WorkItem
    #: Its key says what all units of one work have in common.
    cache: RecordCache


# How far the work is: for whoever asked for it, and for the log.

#: One line per unit that is begun, made or kept; silent unless somebody listens.
log = logging.getLogger("mcrim_mitsuba.runs")
log.addHandler(logging.NullHandler())
log.setLevel(logging.INFO)
log.propagate = False


class Track:
    """Counts units and their photons, and says so."""

    def __init__(self, jobs: Sequence[Job], progress: Progress | None) -> None:
        self._jobs, self._progress = jobs, progress
        # by part: units, and photons
        self._count = Counter(job.unit.what for job in jobs)
        self._total, self._done, self._photons = Counter[str](), Counter[str](), Counter[str]()
        for unit in (job.unit for job in jobs):
            self._total[unit.what] += unit.photons

    def begun(self, index: int) -> None:
        """A unit is about to be made."""
        log.info("unit %d of %d begun, %s", index + 1, len(self._jobs), self._id(index))
        self.tell(self._jobs[index].unit.what)

    def done(self, index: int, *, cached: bool) -> None:
        """A unit is there."""
        unit = self._jobs[index].unit
        how = "kept" if cached else f"made, {unit.photons} photons"
        log.info("unit %d of %d %s, %s", index + 1, len(self._jobs), how, self._id(index))
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
        job = self._jobs[index]
        return f"{job.cache.name}-{job.unit.numbers[0]}"


@dataclass(frozen=True, eq=False)
class Finished:
    """A unit with its result."""

    #: Its place among the jobs that were asked for.
    index: int
    job: Job
    #: By number.
    chunks: dict[int, Chunk]
    #: Whether the cache had it.
    cached: bool


class Executor:
    """Does units in this process, one after the other."""

    def cache(self, key: Mapping[str, object]) -> RecordCache:
        """Where units are kept, by what they have in common."""
        return RecordCache(key)

    def do(
        self,
        jobs: Sequence[Job],
        *,
        threads: int | None = None,
        by_all: bool = False,
        progress: Progress | None = None,
    ) -> Iterator[Finished]:
        """Results in the order of the jobs, whoever does them and whenever they come.

        What their cache has is not made again; what is made goes there at once. A unit has so many
        processor threads, all when None. Few units that decide what comes next are made `by_all`:
        each process of an array job makes all of them for itself.

        Raises InputError if a unit refuses what it is made of.
        """
        track = Track(jobs, progress)
        for index, job in enumerate(jobs):
            chunks = kept(job)
            cached = chunks is not None
            if chunks is None:
                track.begun(index)
                chunks = self.make(job, threads)
            track.done(index, cached=cached)
            yield Finished(index, job, chunks, cached)

    def make(self, job: Job, threads: int | None) -> dict[int, Chunk]:
        """Make a unit here and now, and keep it."""
        job.unit.check(threads)
        return keep(job, job.unit.make(threads))


#: Seconds after which one looks why nothing comes.
LOOK_S = 1.0


class PoolExecutor(Executor):
    """Hands units to a pool, some ahead of their turn, and keeps what comes back.

    The pool is a `concurrent.futures.Executor` of any kind.
    """

    def do(
        self, jobs: Sequence[Job], *, progress: Progress | None = None, **_how: Any
    ) -> Iterator[Finished]:
        """See `Executor.do`; threads are those of whoever does the units."""
        track = Track(jobs, progress)
        # what is handed out, what is there ahead of its turn, and how many were begun
        out: dict[Future[Contents], int] = {}
        there: dict[int, Finished] = {}
        begun = 0
        try:
            for wanted in range(len(jobs)):
                while wanted not in there:
                    # what is there ahead of its turn takes memory too
                    for index in range(begun, min(len(jobs), wanted + self.ahead())):
                        begun, job = index + 1, jobs[index]
                        chunks = kept(job)
                        if chunks is not None:
                            track.done(index, cached=True)
                            there[index] = Finished(index, job, chunks, cached=True)
                            continue
                        track.begun(index)
                        out[self.submit(job.unit)] = index
                    if wanted in there:
                        break
                    done = wait(out, timeout=LOOK_S, return_when=FIRST_COMPLETED).done
                    if not done:
                        self.look(track, jobs[wanted].unit.what)
                    for future in done:
                        index = out.pop(future)
                        chunks = keep(jobs[index], self.result(future, jobs[index]))
                        track.done(index, cached=False)
                        there[index] = Finished(index, jobs[index], chunks, cached=False)
                yield there.pop(wanted)
        finally:
            if out:
                self.give_up()

    def ahead(self) -> int:
        """How many units may be under way, or wait for their turn."""
        raise NotImplementedError

    def submit(self, unit: WorkItem) -> Future[Contents]:
        """Hand a unit out to the pool."""
        raise NotImplementedError

    def look(self, track: Track, what: str) -> None:
        """See why nothing came for a while, and tell `track`; `what` is what is waited for."""

    def result(self, future: Future[Contents], job: Job) -> Contents:
        """What a future that is done brought back; an error that a user can mend as InputError."""
        raise NotImplementedError

    def give_up(self) -> None:
        """Nobody wants any more what is under way."""
        raise NotImplementedError


def pickled(unit: WorkItem) -> bytes:
    """A unit as bytes, with the user's own effects by value: others do not have their modules."""
    # mostly there are none among some two thousand, which takes a sixth of the time to see
    names = sys.modules if OWN_MODULES in " ".join(sys.modules) else ()
    modules = [sys.modules[name] for name in names if name.startswith(OWN_MODULES)]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        return cloudpickle.dumps(unit, protocol=pickle.HIGHEST_PROTOCOL)
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def kept(job: Job) -> dict[int, Chunk] | None:
    """A unit's chunks from the cache; None unless all of them are there."""
    chunks = {}
    for number in job.unit.numbers:
        chunk = job.cache.read(number)
        if chunk is None:
            return None
        chunks[number] = chunk
    return chunks


def keep(job: Job, contents: Mapping[int, Content]) -> dict[int, Chunk]:
    """Put what a unit made into the cache."""
    for number, content in contents.items():
        job.cache.write(number, *content)
    return {n: Chunk(n, dict(arrays), dict(data)) for n, (arrays, data) in contents.items()}


def make_sent(sent: bytes, threads: int = 1) -> Contents:
    """Make a unit that `pickled` gave."""
    unit: WorkItem = pickle.loads(sent)
    unit.check(threads)
    return unit.make(threads)


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


# Many small units by processes of this machine, one for each thread that may be used. A small unit
# spends as much time in Python, where threads wait for each other, as in its kernel; so processes
# with one thread each use all processors, where one process would not. They are started when they
# are first needed, wait a while for more, and end with this one.

#: Units that are handed out ahead, per process.
AHEAD = 4
#: From how many units, and photons in all, on it is worth while to start processes.
FEWEST = 8, 12_500_000
#: The same of the first units where many follow: several times their work.
FEWEST_OF_MANY = 2, 50_000
#: Seconds that processes wait for more units.
IDLE_S = 60.0


_more_follow: contextvars.ContextVar[bool] = contextvars.ContextVar("more_follow", default=False)


@contextlib.contextmanager
def more_units_follow() -> Iterator[None]:
    """Let few units of the ``with`` block be done by processes too, which are started anyway."""
    token = _more_follow.set(True)
    try:
        yield
    finally:
        _more_follow.reset(token)


def many_units_executor(threads: int | None) -> Executor:
    """Who does many small units: processes of this machine, unless somebody else was named.

    `threads` are as many as may be used, all processors when None.
    """
    chosen, processes = current_executor(), threads or processors()
    # a process of a pool of others may not have any of its own
    if type(chosen) is Executor and processes > 1 and not multiprocessing.current_process().daemon:
        return ProcessExecutor(processes)
    return chosen


class ProcessExecutor(PoolExecutor):
    """Hands units to processes of this machine."""

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: Any = None

    def do(
        self,
        jobs: Sequence[Job],
        *,
        threads: int | None = None,
        progress: Progress | None = None,
        **how: Any,
    ) -> Iterator[Finished]:
        """See `Executor.do`; a little work is done here."""
        units, photons = FEWEST_OF_MANY if _more_follow.get() else FEWEST
        if len(jobs) < units or sum(job.unit.photons for job in jobs) < photons:
            return Executor.do(self, jobs, threads=threads, progress=progress, **how)
        return super().do(jobs, progress=progress)

    def ahead(self) -> int:
        return AHEAD * self._processes

    def submit(self, unit: WorkItem) -> Future[Contents]:
        import loky  # slow, and of no use where nothing is missing

        self._pool = loky.get_reusable_executor(
            self._processes, timeout=IDLE_S, initializer=_begin, initargs=(os.getpid(),)
        )
        return self._pool.submit(_make_in, os.getcwd(), pickled(unit))

    def result(self, future: Future[Contents], job: Job) -> Contents:
        try:
            return future.result()
        except BrokenProcessPool:
            mend = "often there is too little memory: give --threads 1, or fewer photons"
            raise InputError("a process that simulated was ended from outside", mend) from None

    def give_up(self) -> None:
        self._pool.shutdown(wait=False, kill_workers=True)


def _make_in(folder: str, sent: bytes) -> Contents:
    """Make a unit that `pickled` gave, with paths from where they are meant: others serve later."""
    os.chdir(folder)
    return make_sent(sent)


def _begin(parent: int) -> None:
    """An interrupt is the parent's to answer; the records of a large unit are no leak of memory.

    The parent is named: asked for here it may have been killed before, and be another.
    """
    import loky

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    seldom_garbage()
    # else loky starts a process anew when one has grown
    loky.process_executor._USE_PSUTIL = False
    # and collects garbage every second, which takes 40 ms of what Mitsuba's modules hold
    loky.process_executor._MEMORY_LEAK_CHECK_DELAY = math.inf
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent was killed: loky's would wait for a reader for ever."""
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(1)
