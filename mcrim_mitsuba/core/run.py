"""How simulations are done (`Run`), and what a result says of how it was done (`Provenance`)."""

from __future__ import annotations

import contextlib
import functools
import gc
import itertools
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value, number_of, unit_of, whole_of

if TYPE_CHECKING:
    import xarray
    from threadpoolctl import ThreadpoolController

#: What the names of modules begin with that are a user's own files of effects.
OWN_MODULES = "mcrim_effect_"
DEFAULT_VARIANT = "llvm_ad_rgb"
#: That any run may be asked for.
MOST_PHOTONS = 10**13
MOST_THREADS = 1024
#: Relative error that may be asked for: 2 is meant for 2 %.
LARGEST_PRECISION = 0.5
#: By which people, terminals and batch systems end a job.
ENDING_SIGNALS = tuple(s for s in signal.Signals if s.name in ("SIGINT", "SIGTERM", "SIGHUP"))


def processors() -> int:
    """How many processors this process may use, at least 1.

    That are ``PYTHON_CPU_COUNT``, with which Python 3.13 says so, or those that it may run on: a
    batch system or a container often grants fewer than the machine has.
    """
    stated = os.environ.get("PYTHON_CPU_COUNT", "")
    if stated.isdecimal() and int(stated):
        return int(stated)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Progress(Protocol):
    """What is told of a job's progress."""

    def __call__(self, what: str, done: int, total: int, note: str = "", /) -> None:
        """Say how far `what` is, the part of the job.

        That is in photons; in benches, of which `total` are few, where they are solved without any.
        The note is of units, and the error reached: ``12 of 180 units, error 0.3 %``.
        """


#: Names of a job's parts, or how they begin, in their order, with the time that each takes.
Parts = Sequence[tuple[str, float]]


class JobProgress:
    """How far a whole job is, by what is told of its parts: one bar, which never goes back.

    Parts that go on side by side count together. Those that are not among the `parts` to come take
    most of what is left.
    """

    _MOST = 0.95
    #: Before so much of a part is done, and for so long, nobody knows how long it takes; nor before
    #: so much of the whole, for what comes first compiles.
    _FIRST, _FIRST_S, _FIRST_OF_ALL = 0.04, 2.0, 0.15

    def __init__(self, parts: Parts = ()) -> None:
        #: The whole job, 0 to 1.
        self.done = 0.0
        whole = sum(share for _, share in parts) / self._MOST
        ends = itertools.accumulate((share / whole for _, share in parts), initial=0.0)
        places = zip(parts, itertools.pairwise(ends), strict=True)
        self._coming = [(name, begin, end) for (name, _), (begin, end) in places]
        # what goes on now, how far that is, and its place in the whole
        self._open: dict[str, tuple[int, int]] = {}
        self._begin, self._end, self._since_s = 0.0, 0.0, 0.0
        # when that was told, and how long the whole takes at its pace
        self._told_s, self._whole_s = 0.0, 0.0

    def tell(self, what: str, done: int, total: int) -> None:
        """Take over how far a part is, as `Progress` says."""
        before = self._open.get(what)
        ended = all(part >= whole for part, whole in self._open.values())
        if ended if before is None else done < before[0]:
            # the next one: where it stands among those to come, or at the end of the last one
            self._open, self._since_s = {}, time.monotonic()
            places = (i for i, (name, *_) in enumerate(self._coming) if what.startswith(name))
            if (place := next(places, None)) is not None:
                _, begin, self._end = self._coming[place]
                self._begin = self.done = max(self.done, begin)
                self._coming = self._coming[place + 1 :]
            elif not self._coming:
                self._begin = self.done = max(self.done, self._end)
                self._end = self.done + self._MOST * (0.99 - self.done)
        self._open[what] = done, total
        done, total = (sum(counts) for counts in zip(*self._open.values(), strict=True))
        if total > len(self._open):
            now = self._begin + (self._end - self._begin) * done / total
            self.done, self._told_s = max(self.done, now), time.monotonic()
            seconds = self._told_s - self._since_s
            if now > self._begin and done > self._FIRST * total and seconds > self._FIRST_S:
                self._whole_s = seconds / (now - self._begin)

    @property
    def left(self) -> str:
        """``40 s left``, at the pace of what went on last; empty where nobody knows."""
        seconds = self._whole_s * (1.0 - self.done) - (time.monotonic() - self._told_s)
        if seconds < 1 or self.done < self._FIRST_OF_ALL:
            return ""
        return f"{seconds:.0f} s left" if seconds < 100 else f"{seconds / 60:.0f} min left"


def seldom_garbage() -> None:
    """Let Python look seldom for garbage, in a process of ours: it took a thirtieth of the time."""
    gc.set_threshold(50_000, 20, 20)


@dataclass(frozen=True)
class Run:
    """What all simulations of a job have in common; who does them is said by `runs.executors`.

    Raises InputError if a field is what no run can have.
    """

    #: To be followed; with `precision`, at most. None: as many as the job usually takes.
    photons: int | None = None
    #: Wanted relative standard error of eta, where the job can be told one.
    precision: float | None = None
    seed: int = 0
    #: Processor threads; one for each of `processors` when None.
    threads: int | None = None
    _: KW_ONLY
    #: Of Mitsuba.
    variant: str = DEFAULT_VARIANT
    #: Told of the progress, if anybody is.
    progress: Progress | None = None
    #: Whether scenes that are simulated are checked first.
    check: bool = True

    def __post_init__(self) -> None:
        """Turn what was given into plain numbers, and refuse what no run can have."""
        photons, seed = arguments_of(1 if self.photons is None else self.photons, self.seed)
        taken: dict[str, float] = {"seed": seed}
        if self.photons is not None:
            taken["photons"] = photons
        if self.threads is not None:
            what, mend = "the number of threads", f"give a whole number, 1 to {MOST_THREADS}"
            taken["threads"] = whole_of(what, self.threads, mend, 1, MOST_THREADS)
        if self.precision is not None:
            what = "the precision"
            mend = f"give a relative error above 0, {LARGEST_PRECISION} at most"
            taken["precision"] = number_of(what, self.precision, mend)
            if not 0 < taken["precision"] <= LARGEST_PRECISION:
                raise InputError(f"{what} is {self.precision}", mend)
        if not isinstance(self.variant, str):
            raise InputError(f"the variant is {self.variant}", f"give a name: {DEFAULT_VARIANT}")
        if self.progress is not None and not callable(self.progress):
            raise InputError(f"progress is {self.progress!r}", "give a function")
        for name, value in taken.items():
            object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, Any]:
        # who is told is in this process
        return {**self.__dict__, "progress": None}

    def photons_or(self, usual: int) -> int:
        """Photons to follow, where `usual` are if nothing else is said."""
        return usual if self.photons is None else self.photons

    def tell(self, what: str, done: int, total: int, note: str = "") -> None:
        """Say how far it is, where there is somebody to say it to; see `Progress`."""
        if self.progress is not None:
            self.progress(what, done, total, note)


@dataclass(frozen=True)
class Provenance:
    """What makes a result reproducible, and what it took."""

    seed: int
    #: That the result rests on, and those of them that the cache had.
    photons: int
    cached_photons: int
    #: SHA-256 of the scene after substitution.
    scene_hash: str
    _: KW_ONLY
    #: Of all software that the result depends on, by name.
    versions: dict[str, str]
    #: Wall time.
    seconds: float
    #: What the reader must know of the simulation.
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class OverAxes:
    """What an answer over axes, such as a table or a map, says of its simulation."""

    photons: int
    seed: int
    #: Of the scene.
    parameters: Mapping[str, Value]
    #: SHA-256 of the scene after substitution.
    scene_hash: str

    def dataset(
        self, values: Mapping[str, tuple], axes: Mapping[str, Any], **attributes: Any
    ) -> xarray.Dataset:
        """Values, as xarray takes them, over axes with units; attributes make it reproducible."""
        import xarray

        attributes |= {"photons": self.photons, "seed": self.seed, "scene_hash": self.scene_hash}
        # NetCDF has no true and false
        attributes |= {n: str(v) if isinstance(v, bool) else v for n, v in self.parameters.items()}
        dataset = xarray.Dataset(values, axes, attributes)
        for name in axes:
            if (unit := unit_of(name)) is not None:
                dataset[name].attrs["units"] = unit
        return dataset


def arguments_of(photons: object, seed: object) -> tuple[int, int]:
    """A number of photons and a seed, of whatever kind; raises InputError if no run has them."""
    mend = "give a whole number, 1 to 1e13"
    return (
        whole_of("the number of photons", photons, mend, 1, MOST_PHOTONS),
        whole_of("the seed", seed, "give 0 or a positive integer", 0),
    )


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """While it lasts, linear algebra has one thread; a decorator of functions, too.

    Small matrices gain nothing by more, which wait for each other, and digits would change.
    """
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """While it lasts, Python's handlers of signals that end a job wait; a decorator, too.

    Mitsuba and Dr.Jit call Python from C++, where a KeyboardInterrupt becomes a refusal of the
    scene or a fault of ours; raised while they are imported, it ends in an abort. A handler that
    waited is called at the end, in place of any other exception.
    """
    # only the main thread calls handlers, and may set them; what the system does needs none
    present = {n: signal.getsignal(n) for n in ENDING_SIGNALS}
    is_main = threading.current_thread() is threading.main_thread()
    handlers = {int(n): handler for n, handler in present.items() if is_main and callable(handler)}
    pending: list[int] = []
    waits = True

    def wait(number: int, frame: FrameType | None) -> None:
        if waits:
            pending.append(number)
        else:  # it comes while the handlers are being put back
            handlers[number](number, frame)

    try:
        for number in handlers:
            signal.signal(number, wait)
        yield
    finally:
        waits = False
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for first in pending[:1]:
            wait(first, None)


@functools.cache
def _libraries() -> ThreadpoolController:
    # of this process; to look for them takes milliseconds
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
