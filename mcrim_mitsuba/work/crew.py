"""Who does the units of a job: this process, unless `use_crew` names another crew."""

from __future__ import annotations

import contextlib
import contextvars
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mcrim_mitsuba.cache import Chunk, RecordCache
from mcrim_mitsuba.work.progress import Progress, Track
from mcrim_mitsuba.work.unit import Content, Task


@dataclass(frozen=True, eq=False)
class Done:
    """A unit with its result.

    Attributes
    ----------
    index : int
        Place among the tasks that were asked for.
    task : Task
    chunks : dict of int to Chunk
        By number.
    cached : bool
        Whether the cache had it.
    """

    index: int
    task: Task
    chunks: dict[int, Chunk]
    cached: bool


class Crew:
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
                chunks = make(task, threads)
            track.done(index, cached=cached)
            yield Done(index, task, chunks, cached)


def kept(task: Task) -> dict[int, Chunk] | None:
    """A unit's chunks from the cache; None unless all of them are there."""
    found = {}
    for number in task.unit.numbers:
        chunk = task.cache.read(number)
        if chunk is None:
            return None
        found[number] = chunk
    return found


def make(task: Task, threads: int | None) -> dict[int, Chunk]:
    """Make a unit here and now, and keep it."""
    task.unit.check(threads)
    return keep(task, task.unit.make(threads))


def keep(task: Task, contents: Mapping[int, Content]) -> dict[int, Chunk]:
    """Put what a unit made into the cache."""
    for number, content in contents.items():
        task.cache.write(number, *content)
    return {n: Chunk(n, dict(arrays), dict(data)) for n, (arrays, data) in contents.items()}


_current: contextvars.ContextVar[Crew] = contextvars.ContextVar("crew")


def current_crew() -> Crew:
    """The crew of the innermost `use_crew`; without one, this process."""
    return _current.get(None) or Crew()


@contextlib.contextmanager
def use_crew(crew: Crew) -> Iterator[Crew]:
    """Let a crew do the units of everything that is begun within the ``with`` block.

    Examples
    --------
    >>> from mcrim_mitsuba.work.cluster import ClusterCrew
    >>> with use_crew(ClusterCrew("tcp://127.0.0.1:8786")):  # doctest: +SKIP
    ...     calibrate("camoo4_campaign.toml")
    """
    token = _current.set(crew)
    try:
        yield crew
    finally:
        _current.reset(token)
