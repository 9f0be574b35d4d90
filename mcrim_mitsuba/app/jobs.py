"""The page's jobs: one after the other, each begun by a button and stopped by it."""

from __future__ import annotations

import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import JobProgress, Parts


class CancelledError(Exception):
    """The user wants the job to end."""


@dataclass(frozen=True)
class PageJob:
    """Something that takes longer."""

    #: What asked for it: a button, or an effect's switch.
    key: str
    #: What it does.
    words: str
    work: Callable[[], None]
    _: KW_ONLY
    #: Called where it came to nothing, the waiting one that is stopped included.
    undo: Callable[[], None] = lambda: None
    #: Whether it is begun once more when it is asked for while it runs.
    again: bool = False
    #: What it tells of, as `JobProgress` has it.
    parts: Parts = ()


@dataclass(frozen=True, kw_only=True)
class Status:
    """What the job thread is doing."""

    #: The job that runs, None when idle; its work is not looked at.
    job: PageJob | None = None
    #: What the job is at.
    stage: str = ""
    #: How far all of it is.
    bar: JobProgress = field(default_factory=JobProgress)
    #: Those behind it.
    waiting: tuple[PageJob, ...] = ()
    #: Why jobs came to nothing since the user last began one.
    failures: tuple[str, ...] = ()
    #: The one that was stopped, as the user wished.
    stopped: str = ""

    @property
    def words(self) -> str:
        """What is going on, ``ready`` when idle."""
        if self.job is None:
            return "ready"
        apart = "" if self.stage in ("", self.job.words) else f": {self.stage}"
        part = f"{100 * self.bar.done:.0f} %" if self.bar.done else ""
        return ", ".join(filter(None, (f"{self.job.words}{apart}", part, self.bar.left)))


class Jobs:
    """Runs jobs one after the other.

    All of them run in the same thread: Mitsuba's variant belongs to a thread. `changed` is called
    whenever one was begun or ended.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._waiting: deque[PageJob] = deque()
        self._there_is_work = threading.Condition()
        self._closed = self._cancelled = False
        self._status = Status()
        # Ctrl-C need not wait for a long simulation
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    @property
    def status(self) -> Status:
        """What is going on now."""
        with self._there_is_work:
            return replace(self._status, waiting=tuple(self._waiting))

    def start(self, job: PageJob) -> None:
        """Begin a job when all before it are done; one that is under way is not begun again."""
        with self._there_is_work:
            self._status = replace(self._status, failures=(), stopped="")
            ends = self._status.job is None or self._cancelled or job.again
            running = () if ends else (self._status.job,)
            if all(job.key != other.key for other in (*running, *self._waiting)):
                self._waiting.append(job)
                self._there_is_work.notify()
        self._changed()

    def stop(self, key: str | None = None) -> bool:
        """End the job of a button, or let it not begin; None: the running one. Was there one?"""
        with self._there_is_work:
            running = self._status.job
            if running is not None and key in (None, running.key):
                self._cancelled = True
                self._status = replace(self._status, stage="stopping")
                return True
            dropped = [job for job in self._waiting if job.key == key]
            self._waiting = deque(job for job in self._waiting if job.key != key)
        for job in dropped:
            job.undo()
        return bool(dropped)

    def stop_all(self) -> None:
        """Let nothing that was begun go on."""
        for job in self.status.waiting:
            self.stop(job.key)
        self.stop()

    def report(self, stage: str, done: int, total: int, _note: str = "") -> None:
        """Take over how far the running job is.

        Raises CancelledError if the job is to end.
        """
        with self._there_is_work:
            if self._cancelled:
                raise CancelledError
            self._status.bar.tell(stage, done, total)
            self._status = replace(self._status, stage=stage)

    def close(self, patience_seconds: float) -> None:
        """Stop the running job and take no more; waits for so long at most."""
        with self._there_is_work:
            self._closed = self._cancelled = True
            self._waiting.clear()
            self._there_is_work.notify()
        self._thread.join(patience_seconds)

    def _work(self) -> None:
        while True:
            with self._there_is_work:
                self._there_is_work.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                job = self._waiting.popleft()
                self._cancelled = False
                self._status = replace(self._status, job=job, stage="", bar=JobProgress(job.parts))
            error, stopped = self._run(job)
            if error or stopped:
                with suppress(InputError):
                    job.undo()
            with self._there_is_work:
                before = self._status
                failures = (*before.failures, error) if error else before.failures
                self._status = Status(failures=failures, stopped=stopped or before.stopped)
            self._changed()

    @staticmethod
    def _run(job: PageJob) -> tuple[str, str]:
        """Why it came to nothing, by a fault and by the user's wish; empty where it did not."""
        try:
            job.work()
        except CancelledError:
            return "", f"{job.words}: stopped; what was simulated is kept"
        except InputError as refusal:
            return f"{job.words}: {refusal}", ""
        except Exception as fault:
            traceback.print_exc(file=sys.stderr)
            return (
                f"{job.words}: this is our fault, not yours ({type(fault).__name__}): please "
                "report the lines in the terminal"
            ), ""
        return "", ""
