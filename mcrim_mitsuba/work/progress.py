"""How far a job is: for whoever asked for it, and for the log."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Protocol

from mcrim_mitsuba.work.unit import Task

#: One line per unit that is begun, made or kept; silent unless somebody listens.
log = logging.getLogger("mcrim_mitsuba.work")
log.addHandler(logging.NullHandler())
log.setLevel(logging.INFO)
log.propagate = False


class Progress(Protocol):
    """What is told of a job's progress."""

    def __call__(self, what: str, done: int, total: int, note: str = "", /) -> None:
        """Say how far it is.

        Parameters
        ----------
        what : str
            The part of the job.
        done, total : int
            In photons.
        note : str
            Units, and the error reached, such as ``12 of 180 units, error 0.3 %``.
        """


class Track:
    """Counts units and their photons, and says so.

    Parameters
    ----------
    tasks : sequence of Task
    progress : callable or None
    """

    def __init__(self, tasks: Sequence[Task], progress: Progress | None) -> None:
        self._tasks, self._progress = tasks, progress
        self._total: dict[str, int] = {}
        self._count: dict[str, int] = {}
        for unit in (task.unit for task in tasks):
            self._total[unit.what] = self._total.get(unit.what, 0) + unit.photons
            self._count[unit.what] = self._count.get(unit.what, 0) + 1
        self._photons = dict.fromkeys(self._total, 0)
        self._done = dict.fromkeys(self._total, 0)

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
        if self._progress is not None:
            units = f"{self._done[what]} of {self._count[what]} units"
            note = f"{units}, {remark}" if remark else units
            self._progress(what, self._photons[what], self._total[what], note)

    def _id(self, index: int) -> str:
        task = self._tasks[index]
        return f"{task.cache.name}-{task.unit.numbers[0]}"
