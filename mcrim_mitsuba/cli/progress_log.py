"""The progress of a command as lines of a file, for whoever comes back in the morning."""

from __future__ import annotations

import contextlib
import errno
import io
import logging
import os
import stat
import time
from collections.abc import Callable, Iterator

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import NONBLOCK
from mcrim_mitsuba.work.progress import log

Report = Callable[..., None]
#: Seconds between two lines on how far a part is; its end is always written.
_EVERY_S = 10.0
#: What there is more of than this are photons, else trials or tables.
MOST_PIECES = 10_000


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
    """A file that may fill up, or a pipe whose reader leaves: the work goes on without it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, if it can be written now."""
        with contextlib.suppress(OSError):  # of opening what `handleError` has closed
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """This line is lost; the next one is tried again."""
        with contextlib.suppress(OSError):
            self.close()

    def _open(self) -> io.TextIOWrapper:
        # a pipe without a reader would else block here for ever
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | NONBLOCK
        try:
            descriptor = os.open(self.baseFilename, flags, 0o666)
        except OSError as error:
            if error.errno == errno.ENXIO and stat.S_ISFIFO(os.stat(self.baseFilename).st_mode):
                raise OSError(errno.ENXIO, "nobody reads from this pipe") from None
            raise
        if NONBLOCK:
            os.set_blocking(descriptor, True)
        return open(descriptor, "a", encoding=self.encoding, errors=self.errors)


def _line(what: str, done: int, total: int, note: str, seconds: float) -> str:
    """``simulation: 2.6e+06 of 4.7e+07 photons, 12 of 180 units, 90 s left``."""
    parts = [what]
    if total > MOST_PIECES:
        parts = [f"{what}: {done:.3g} of {total:.3g} photons"]
    elif total > 1:
        parts = [f"{what}: {done} of {total}"]
    parts += [note] if note else []
    if 0 < done < total and seconds > 0:
        parts.append(f"{seconds * (total - done) / done:.0f} s left")
    return ", ".join(parts)
