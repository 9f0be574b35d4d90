"""Opens the files a user names, or says in one line why it cannot."""

from __future__ import annotations

import errno
import itertools
import os
import select
import stat
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.suggest import closest

BYTES_PER_MB = 1_000_000
#: Where the operating system knows it.
NONBLOCK = getattr(os, "O_NONBLOCK", 0)
#: How long a pipe or a device may say nothing, in seconds.
_PATIENCE_S = 10.0
#: Names of a folder that are compared with one that is not there.
_MOST_COMPARED = 2000


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder; there is none of a name that no file can have.

    What must not be looked at is there: reading it says why it cannot be read.
    """
    try:
        return path.exists()
    except PermissionError:
        return True
    except (OSError, ValueError):
        return False


def resolved(path: Path) -> Path:
    """A path without links; of a loop of links, or of a name that no file can have, as it is."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return path.absolute()


def read_bytes(path: Path, limit_mb: int) -> bytes:
    """Content of a file of at most `limit_mb` megabytes.

    Raises
    ------
    InputError
        If there is no such file, if it is a folder, empty, too large or unreadable, or if it is
        a pipe that nobody writes into.
    """
    try:
        # a pipe without a writer would else block here for ever
        descriptor = os.open(path, os.O_RDONLY | NONBLOCK | getattr(os, "O_BINARY", 0))
        with os.fdopen(descriptor, "rb", buffering=0) as stream:
            # one byte more than allowed: enough to know, however large the file is
            data = _up_to(limit_mb * BYTES_PER_MB + 1, stream.fileno())
    except IsADirectoryError:
        raise InputError("this is a folder", "name a file in it", path=path) from None
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("no such file", _look_around(path), path=path) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot be read ({reason})", "name another file", path=path) from None
    if not data.strip():
        raise InputError("the file is empty", "name another file or fill this one", path=path)
    if len(data) > limit_mb * BYTES_PER_MB:
        raise InputError(f"larger than {limit_mb} MB", "is this the file you meant?", path=path)
    return data


def _up_to(size: int, descriptor: int) -> bytes:
    """So many bytes, or fewer where there are no more; a pipe's writer may take its time."""
    parts: list[bytes] = []
    while size > 0:
        try:
            part = os.read(descriptor, min(size, BYTES_PER_MB))
        except BlockingIOError:
            if not select.select([descriptor], [], [], _PATIENCE_S)[0]:
                raise TimeoutError(
                    errno.ETIMEDOUT, f"nothing came through it for {_PATIENCE_S:g} s"
                ) from None
            continue
        if not part:
            break
        parts.append(part)
        size -= len(part)
    if not parts and stat.S_ISFIFO(os.fstat(descriptor).st_mode):
        raise OSError(errno.EPIPE, "nobody writes into this pipe")
    return b"".join(parts)


def read_text(path: Path, limit_mb: int) -> str:
    """Content of a UTF-8 text file, a byte order mark removed, line ends as ``\\n``.

    Raises
    ------
    InputError
        As `read_bytes`; or if the file is not UTF-8 or holds zero bytes, with the first bad line.
    """
    data = read_bytes(path, limit_mb)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            "not a UTF-8 text file", "save it as UTF-8", path=path, line=line
        ) from None
    if (zero := text.find("\0")) >= 0:
        raise InputError(
            "not a text file (it holds zero bytes)", "save it as text, in UTF-8", path=path,
            line=text.count("\n", 0, zero) + 1,
        )  # fmt: skip
    return text.replace("\r\n", "\n").replace("\r", "\n")


#: How files begin that hold tables but are no text: what they are.
_NO_TEXT = (
    (b"PK\x03\x04", "a spreadsheet (.xlsx, .ods) or a ZIP archive"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook (.xls)"),
    (b"%PDF", "a PDF"),
    (b"\x1f\x8b", "a gzip archive"),
)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def read_table_text(path: Path, limit_mb: int) -> str:
    """Content of a text file as instruments and spreadsheets write them, line ends as ``\\n``.

    UTF-8, UTF-16 with a byte order mark (Excel's "Unicode text"), else Windows' Western code
    page: digits and signs are the same bytes in all that is neither, so that numbers are certain,
    and µ, ° and Å of names are read.

    Raises
    ------
    InputError
        As `read_bytes`; or if this is no text.
    """
    data = read_bytes(path, limit_mb)
    for beginning, what in _NO_TEXT:
        if data.startswith(beginning):
            raise InputError(f"this is {what}, not text", "export the table as CSV", path=path)
    try:
        if data.startswith(_UTF_16):
            text = data.decode("utf-16")
        else:
            text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    zero = text.find("\0")
    if zero >= 0:
        raise InputError(
            "not a text file (it holds zero bytes)", "save the table as CSV, in UTF-8",
            path=path, line=text.count("\n", 0, zero) + 1,
        )  # fmt: skip
    if not text.strip():
        raise InputError("the file is empty", "name another file or fill this one", path=path)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _look_around(path: Path) -> str:
    """Hint for a file that is not there: its likely namesake, or that the folder is missing."""
    try:
        if not path.parent.is_dir():
            return f"the folder {path.parent} does not exist: check the path"
        # a campaign is never meant where a scene is asked for
        entries = (entry.name for entry in path.parent.iterdir() if entry.suffix == path.suffix)
        alike = closest(path.name, itertools.islice(entries, _MOST_COMPARED))
    except OSError:  # a folder whose names may not be read
        alike = None
    return f"did you mean {alike}?" if alike else "check the path"
