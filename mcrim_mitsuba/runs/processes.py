"""Many small units by processes of this machine, one for each thread that may be used.

A small unit spends as much time in Python, where threads wait for each other, as in its kernel; so
processes with one thread each use all processors, where one process would not. They are started
when they are first needed, wait a while for more, and end with this one.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Progress
from mcrim_mitsuba.runs.executors import (
    Content,
    Done,
    Executor,
    HandingExecutor,
    Task,
    Track,
    Unit,
    current_executor,
    pickled,
)

#: Units that are handed out ahead, per process.
AHEAD = 4
#: From how much processor time on, in several units, it is worth while to start processes.
LEAST_S, FEWEST_UNITS = 5.0, 8
#: Seconds that processes wait for more units, and after which one is looked after.
IDLE_S, LOOK_S = 60.0, 1.0


def many_units_executor(threads: int | None) -> Executor:
    """Who does many small units: processes of this machine, unless somebody else was named.

    `threads` are as many as may be used, all processors when None.
    """
    chosen, processes = current_executor(), threads or os.cpu_count() or 1
    # a process of a pool of others may not have any of its own
    if type(chosen) is Executor and processes > 1 and not multiprocessing.current_process().daemon:
        return ProcessExecutor(processes)
    return chosen


class ProcessExecutor(HandingExecutor):
    """Hands units to processes of this machine."""

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: Any = None

    def do(
        self,
        tasks: Sequence[Task],
        *,
        threads: int | None = None,
        progress: Progress | None = None,
        **how: Any,
    ) -> Iterator[Done]:
        """See `Executor.do`; a little work is done here."""
        if len(tasks) < FEWEST_UNITS or sum(task.unit.expected_s for task in tasks) < LEAST_S:
            return Executor.do(self, tasks, threads=threads, progress=progress, **how)
        return super().do(tasks, progress=progress)

    def ahead(self) -> int:
        return AHEAD * self._processes

    def submit(self, unit: Unit) -> Future[dict[int, Content]]:
        import loky  # slow, and of no use where nothing is missing

        self._pool = loky.get_reusable_executor(self._processes, timeout=IDLE_S, initializer=_begin)
        return self._pool.submit(_make, pickled(unit))

    def finished(
        self, out: Mapping[Future, int], tasks: Sequence[Task], track: Track
    ) -> Iterable[Future]:
        return wait(out, timeout=LOOK_S, return_when=FIRST_COMPLETED).done

    def result(self, future: Future, task: Task) -> dict[int, Content]:
        try:
            return future.result()
        except BrokenProcessPool:
            problem = "a process that simulated was ended from outside"
            mend = "often there is too little memory: give --threads 1, or fewer photons"
            raise InputError(problem, mend) from None

    def give_up(self, futures: Sequence[Future]) -> None:
        if futures:
            self._pool.shutdown(wait=False, kill_workers=True)


def _begin() -> None:
    """An interrupt is the parent's to answer; the records of a large unit are no leak of memory."""
    import loky

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # else loky starts a process anew when one has grown
    loky.process_executor._USE_PSUTIL = False


def _make(sent: bytes) -> dict[int, Content]:
    """Make a unit that `pickled` gave."""
    unit: Unit = pickle.loads(sent)
    unit.check(1)
    return unit.make(1)
