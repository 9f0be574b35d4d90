"""The progress of a command as lines of a file, for whoever comes back in the morning."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator

from mcrim_mitsuba.errors import InputError

Report = Callable[..., None]
#: Seconds between two lines on how far a part is; its end is always written.
_EVERY_S = 10.0
#: What there is more of than this are photons, else trials or tables.
_MOST_PIECES = 10_000


@contextlib.contextmanager
def progress_log(path: str) -> Iterator[Report]:
    """A log with the time (UTC) on each line.

    It has a line for every unit that is begun, made, or found in the cache, and lines on how far
    each part is.

    Parameters
    ----------
    path : str
        Lines are appended.

    Yields
    ------
    Progress

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    try:
        handler = _Lines(path, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})", "let --log name a file", path=path
        ) from None
    form = logging.Formatter("%(asctime)sZ %(message)s", "%Y-%m-%dT%H:%M:%S")
    form.converter = time.gmtime
    handler.setFormatter(form)
    log = logging.getLogger("mcrim_mitsuba.work")
    log.addHandler(handler)
    parts: dict[str, tuple[float, float]] = {}

    def report(what: str, done: int, total: int, note: str = "") -> None:
        now = time.monotonic()
        begun, told = parts.get(what, (now, -_EVERY_S))
        if now - told >= _EVERY_S or done >= total:
            parts[what] = begun, now
            log.info("%s", _line(what, done, total, note, now - begun))

    try:
        yield report
    finally:
        log.removeHandler(handler)
        handler.close()


class _Lines(logging.FileHandler):
    """A file that may fill up: the work goes on without it."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Nothing more is written."""
        with contextlib.suppress(OSError):
            self.close()


def _line(what: str, done: int, total: int, note: str, seconds: float) -> str:
    """``simulation: 2.6e+06 of 4.7e+07 photons, 12 of 180 units, 90 s left``."""
    parts = [what]
    if total > _MOST_PIECES:
        parts = [f"{what}: {done:.3g} of {total:.3g} photons"]
    elif total > 1:
        parts = [f"{what}: {done} of {total}"]
    parts += [note] if note else []
    if 0 < done < total and seconds > 0:
        parts.append(f"{seconds * (total - done) / done:.0f} s left")
    return ", ".join(parts)
