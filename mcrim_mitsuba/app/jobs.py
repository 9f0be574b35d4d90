"""One long job at a time, in a thread of its own, watched and cancelled from others."""

from __future__ import annotations

import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import SimpleQueue

from mcrim_mitsuba.errors import InputError


class CancelledError(Exception):
    """The user wants the job to end."""


@dataclass(frozen=True)
class Status:
    """What the job thread is doing.

    Attributes
    ----------
    job : str
        In words; empty when idle.
    stage : str
        What the job is at.
    done, total : int
        Of the stage.
    error : str
        Why the last job came to nothing; empty if it did not fail.
    """

    job: str = ""
    stage: str = ""
    done: int = 0
    total: int = 0
    error: str = ""

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        return bool(self.job)


class Jobs:
    """Runs jobs one after the other.

    All of them run in the same thread: Mitsuba's variant belongs to a thread.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        # Ctrl-C need not wait for a long simulation
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()
        self._lock = threading.Lock()
        self._status = Status()
        self._cancelled = False

    @property
    def status(self) -> Status:
        """What is going on now."""
        return self._status

    def start(self, job: str, work: Callable[[], None]) -> bool:
        """Begin a job, unless another one is running; returns whether it began."""
        with self._lock:
            if self._status.busy:
                return False
            self._cancelled = False
            self._status = Status(job=job, stage=job)
        self._waiting.put(work)
        return True

    def cancel(self) -> None:
        """Let the running job end at its next report."""
        self._cancelled = True

    def report(self, stage: str, done: int, total: int, _note: str = "") -> None:
        """Told by the job how far it is.

        Raises
        ------
        CancelledError
            If the job is to end.
        """
        if self._cancelled:
            raise CancelledError
        self._status = replace(self._status, stage=stage, done=done, total=total)

    def close(self, patience_seconds: float) -> None:
        """Stop the running job and take no more; waits for so long at most."""
        self.cancel()
        self._waiting.put(None)
        self._thread.join(patience_seconds)

    def _work(self) -> None:
        while (work := self._waiting.get()) is not None:
            self._run(work)

    def _run(self, work: Callable[[], None]) -> None:
        error = ""
        try:
            work()
        except CancelledError:
            error = f"{self._status.job}: stopped; what was simulated is kept"
        except InputError as refusal:
            error = str(refusal)
        except Exception as fault:
            traceback.print_exc(file=sys.stderr)
            error = (
                f"this is our fault, not yours ({type(fault).__name__}): please report the lines "
                "in the terminal"
            )
        self._status = Status(error=error)
