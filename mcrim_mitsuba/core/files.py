"""Files: read with care, written whole or not at all; and results as JSON."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import json
import math
import os
import re
import select
import stat
import sys
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from operator import attrgetter
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError, closest

BYTES_PER_MB = 1_000_000
#: Where the operating system knows it.
NONBLOCK = getattr(os, "O_NONBLOCK", 0)
#: How long a pipe or a device may say nothing, in seconds.
PATIENCE_S = 10.0
#: Names of a folder that are compared with one that is not there.
_MOST_COMPARED = 2000
_EMPTY = ("the file is empty", "name another file or fill this one")
#: How files begin that hold tables but are no text: what they are.
_NO_TEXT = (
    (b"PK\x03\x04", "a spreadsheet (.xlsx, .ods) or a ZIP archive"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook (.xls)"),
    (b"%PDF", "a PDF"),
    (b"\x1f\x8b", "a gzip archive"),
)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
#: Of files that are compared byte by byte.
_LIMIT_MB = 50
#: Where the descriptors of this process have names.
_DESCRIPTORS = (Path("/dev/fd"), Path("/proc/self/fd"))
#: Names of standard output.
STDOUT = ("-", "/dev/stdout", *(str(folder / "1") for folder in _DESCRIPTORS))
_MEND = "name a file in a folder you may write to"
#: What helps where a file may grow no further.
LIFT_LIMIT = "lift the limit on the size of files (ulimit -f)"
#: What else helps, by the operating system's error.
_MENDS = dict.fromkeys(
    (errno.ENOSPC, errno.EDQUOT), "free some space, or name a file on another disk"
) | {errno.ENAMETOOLONG: "give it a shorter name", errno.EFBIG: LIFT_LIMIT}
_DEVICES = (Path("/dev"), *_DESCRIPTORS)
_MOST_LINKS = 40
_NEVER = (".xml", ".toml")  # a slip of the hand: results would replace a scene or a campaign


_INSIDE = re.compile(r"(.+\.root)[:#](.+)", re.IGNORECASE | re.DOTALL)


def inside(path: Path) -> tuple[Path, str]:
    """The file of a path, and what it names in that: ``runs.root:dry`` or ``runs.root#dry``."""
    parts = _INSIDE.fullmatch(str(path))
    return (Path(parts[1]), parts[2]) if parts else (path, "")


def path_of(what: str, value: object) -> Path:
    """A path as it is or of its text; raises InputError if it is neither."""
    if isinstance(value, str | os.PathLike):
        return Path(value)
    raise InputError(f"{what} is {value!r}", "name a file by a text or a Path")


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder; there is none of a name that no file can have.

    What must not be looked at is there: reading it says why it cannot be read.
    """
    try:
        path.stat()
    except PermissionError:
        return True
    except (OSError, ValueError):
        return False
    return True


def resolved(path: Path) -> Path:
    """A path without links; of a loop of links, or of a name that no file can have, as it is."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return path.absolute()


#: Paths of what `read_bytes` reads, while somebody collects them.
READS = ContextVar[list[Path] | None]("reads", default=None)
#: Paths of what `write_bytes` writes, while somebody collects them.
WRITES = ContextVar[list[Path] | None]("writes", default=None)


@contextlib.contextmanager
def collected(where: ContextVar[list[Path] | None]) -> Iterator[list[Path]]:
    """The paths of all files that are read (READS) or written (WRITES) meanwhile, in order."""
    paths: list[Path] = []
    token = where.set(paths)
    try:
        yield paths
    finally:
        where.reset(token)


def beside(path: Path, name: str) -> Path:
    """A file that another one names, whose folder may be that of a link or of what it links to."""
    linked = path.parent / name
    itself = resolved(path).parent / name
    return itself if is_there(itself) and not is_there(linked) else linked


def read_bytes(path: Path, limit_mb: int) -> bytes:
    """Content of a file of at most `limit_mb` megabytes.

    Raises InputError if there is no such file, if it is a folder, empty, too large or unreadable,
    or if it is a pipe that nobody writes into.
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
        raise InputError("no such file", look_around(path), path=path) from None
    except (OSError, ValueError) as error:
        problem = f"cannot be read ({_reason(error)})"
        raise InputError(problem, "name another file", path=path) from None
    if not data.strip():
        raise InputError(*_EMPTY, path=path)
    if len(data) > limit_mb * BYTES_PER_MB:
        raise InputError(f"larger than {limit_mb} MB", "is this the file you meant?", path=path)
    if (reads := READS.get()) is not None:
        reads.append(path)
    return data


def _reason(error: OSError | ValueError) -> str:
    return getattr(error, "strerror", None) or str(error)


def _up_to(size: int, descriptor: int) -> bytes:
    """So many bytes, or fewer where there are no more; a pipe's writer may take its time."""
    parts: list[bytes] = []
    while size > 0:
        try:
            part = os.read(descriptor, min(size, BYTES_PER_MB))
        except BlockingIOError:
            if not select.select([descriptor], [], [], PATIENCE_S)[0]:
                problem = f"nothing came through it for {PATIENCE_S:g} s"
                raise TimeoutError(errno.ETIMEDOUT, problem) from None
            continue
        if not part:
            break
        parts.append(part)
        size -= len(part)
    if not parts and stat.S_ISFIFO(os.fstat(descriptor).st_mode):
        raise OSError(errno.EPIPE, "nobody writes into this pipe")
    return b"".join(parts)


def sha256(data: bytes) -> str:
    """SHA-256 of bytes, hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def read_text(path: Path, limit_mb: int) -> str:
    """Content of a UTF-8 text file, a byte order mark removed, line ends as ``\\n``.

    Raises InputError as `read_bytes`; or if the file is not UTF-8 or holds zero bytes, with the
    first bad line.
    """
    data = read_bytes(path, limit_mb)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        problem = "not a UTF-8 text file"
        raise InputError(problem, "save it as UTF-8", path=path, line=line) from None
    return _checked(text, path, "save it as text, in UTF-8")


def read_table_text(path: Path, limit_mb: int) -> str:
    """Content of a text file as instruments and spreadsheets write them, line ends as ``\\n``.

    UTF-8, UTF-16 with a byte order mark (Excel's "Unicode text"), else Windows' Western code
    page: digits and signs are the same bytes in all that is neither, so that numbers are certain,
    and µ, ° and Å of names are read.

    Raises InputError as `read_bytes`; or if this is no text.
    """
    data = read_bytes(path, limit_mb)
    for beginning, what in _NO_TEXT:
        if data.startswith(beginning):
            raise InputError(f"this is {what}, not text", "export the table as CSV", path=path)
    try:
        text = data.decode("utf-16" if data.startswith(_UTF_16) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    text = _checked(text, path, "save the table as CSV, in UTF-8")
    if not text.strip():
        raise InputError(*_EMPTY, path=path)
    return text


def _checked(text: str, path: Path, mend: str) -> str:
    """A text with ``\\n`` at its line ends, refused if it holds zero bytes."""
    if (zero := text.find("\0")) >= 0:
        line = text.count("\n", 0, zero) + 1
        raise InputError("not a text file (it holds zero bytes)", mend, path=path, line=line)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def look_around(path: Path, otherwise: str = "check the path") -> str:
    """Hint for a file that is not there: its likely namesake, a missing folder, or `otherwise`."""
    try:
        if not path.parent.is_dir():
            return f"the folder {path.parent} does not exist: check the path"
        # a campaign is never meant where a scene is asked for
        entries = (entry.name for entry in path.parent.iterdir() if entry.suffix == path.suffix)
        alike = closest(path.name, itertools.islice(entries, _MOST_COMPARED))
    except OSError:  # a folder whose names may not be read
        alike = None
    return f"did you mean {alike}?" if alike else otherwise


def first_duplicates(paths: Sequence[Path]) -> tuple[int, int] | None:
    """Places of two files that are one by their resolved paths or, byte by byte, by their content.

    The earlier comes first; None where there are none. What cannot be read is its reader's to
    refuse.
    """
    seen: dict[Path | str, int] = {}
    for place, path in enumerate(paths):
        keys: list[Path | str] = []
        with contextlib.suppress(InputError, OSError, ValueError, RuntimeError):
            keys.append(path.resolve())
            # a pipe can be read only once
            if path.is_file():
                keys.append(sha256(read_bytes(path, _LIMIT_MB)))
        for key in keys:
            if key in seen:
                return seen[key], place
        seen.update(dict.fromkeys(keys, place))
    return None


# Writing.


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 file so that nobody ever sees half of it; ``-`` is standard output.

    Raises InputError if the place cannot be written.
    """
    if str(path) in STDOUT:
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except BrokenPipeError:
            silence_stdout()
        return
    write_bytes(path, text.encode())


def make_folder(folder: str | Path) -> Path:
    """A folder for results, made if it is not there; raises InputError if that cannot be done."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"the folder cannot be made ({error.strerror or error})"
        mend = _MENDS.get(error.errno or 0, "name one that you may write to")
        raise InputError(problem, mend, path=folder) from None
    return folder


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it; raises InputError if that cannot be."""
    path = Path(path)
    try:
        target = _target(path)
        if target.is_dir():
            raise IsADirectoryError(21, "it is a folder")
        if _is_device(target):
            _write_into(target, content)
            return
        # the file's own name may be as long as a name can be
        write_whole(target, [content], target.parent / f".mcrim_{uuid.uuid4().hex}")
        if (writes := WRITES.get()) is not None:
            writes.append(path)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise _not_written(path, error) from None


def write_whole(
    target: Path, parts: Iterable[Any], temporary: Path, *, durable: bool = True
) -> None:
    """Write a file so that under its name there is all of it or nothing, even after a crash.

    `parts` are bytes or what holds them; until it is whole, the file bears the `temporary` name,
    which is new and on the same disk. One that need not be `durable` may be damaged by a power cut.
    Raises OSError if it cannot be written.
    """
    try:
        with open(temporary, "xb") as stream:
            stream.writelines(parts)
            stream.flush()
            if durable:  # else the name might outlive a power cut, and not the file
                os.fsync(stream.fileno())
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def _not_written(path: Path, error: OSError | ValueError) -> InputError:
    mend = _MENDS.get(getattr(error, "errno", 0), _MEND)
    return InputError(f"cannot be written ({_reason(error)})", mend, path=path)


def _target(path: Path) -> Path:
    """The file that is written in the place of a path: of a link the one that it leads to.

    The links of descriptors are not followed: what they lead to is open already, perhaps to append.
    A link that leads nowhere, or in a circle, is written itself.
    """
    target = path
    for _ in range(_MOST_LINKS):
        if target.parent in _DESCRIPTORS or not target.is_symlink():
            return target if target.parent.is_dir() else path
        target = target.parent / target.readlink()
    return path


def _write_into(path: Path, content: bytes) -> None:
    """Write into a device or a pipe, not into a disk; a pipe must have its reader already.

    What is open already gets it where it stands: a file to append to is not cut short.
    """
    if stat.S_ISBLK(path.stat().st_mode):
        raise OSError(errno.EPERM, "it is a disk")
    is_open = path.parent in _DESCRIPTORS
    descriptor = os.dup(int(path.name)) if is_open else open_to_write(path, os.O_TRUNC)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)


def open_to_write(path: Path, flags: int) -> int:
    """Descriptor of a file, with further `flags`, or of a pipe that somebody reads from.

    Raises OSError if it cannot be opened; a pipe without a reader would else block for ever.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | flags | NONBLOCK, 0o666)
    except OSError as error:
        if error.errno == errno.ENXIO and path.is_fifo():
            raise OSError(errno.ENXIO, "nobody reads from this pipe") from None
        raise
    if NONBLOCK:
        os.set_blocking(descriptor, True)
    return descriptor


def silence_stdout() -> None:
    """Send the rest of standard output nowhere: its reader, `head` perhaps, has seen enough."""
    with contextlib.suppress(OSError, ValueError):  # no descriptor behind it: nothing to send
        descriptor = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def differs(path: Path, content: bytes) -> bool:
    """Whether something else than this content is there; what cannot be read is."""
    try:
        return is_there(path) and not (path.is_file() and path.read_bytes() == content)
    except OSError:
        return True


def refuse_to_replace(texts: Mapping[Path, str]) -> None:
    """Refuse to write over files that hold something else: somebody's work, perhaps.

    The very same may be there: a line that was interrupted goes on. Raises InputError without
    touching a file.
    """
    for path, text in texts.items():
        if differs(path, text.encode()):
            problem = "this file exists already"
            raise InputError(problem, "name another, or remove it first", path=path)


def refuse_suffix(path: str | Path, wanted: tuple[str, ...], cannot: str) -> None:
    """Refuse a file whose name ends in none of the suffixes; `cannot` says who will not write it.

    Raises InputError if it is another one.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in wanted:
        problem = f"{cannot} {suffix or 'a file without suffix'}"
        raise InputError(problem, f"let the name end in {' or '.join(wanted)}", path=path)


def refuse_outputs(
    outputs: Mapping[str, str | None],
    inputs: Iterable[str | Path] = (),
    *,
    suffixes: Mapping[str, tuple[str, ...]] | None = None,
) -> None:
    """Refuse output files that could not be written, or would replace what is read.

    `outputs` are files by option, None where it was not given, and `suffixes` those that an
    option's file must have, if not any; `inputs` are files that the command reads, and folders of
    which it may read any file.

    Raises InputError before any work is done and without touching a file.
    """
    read = [Path(file) for file in inputs]
    taken: dict[Path, str] = {}
    for option, given in outputs.items():
        if given is None:
            continue
        if given and os.path.basename(given) in ("", "."):  # which no Path keeps
            raise InputError(f"{option} names a folder", "name a file in it", path=given)
        path = Path("-" if given in STDOUT else given)
        key = path if str(path) == "-" else resolved(path)
        if key in taken and not _is_device(path):
            problem = f"{taken[key]} and {option} both write {given}"
            raise InputError(problem, "give each a file of its own")
        taken[key] = option
        wanted = (suffixes or {}).get(option)
        if wanted:
            refuse_suffix(given, wanted, f"{option} cannot write")
        if str(path) != "-":
            _refuse_output(option, path, read, wanted or ())


def _refuse_output(option: str, path: Path, inputs: list[Path], wanted: tuple[str, ...]) -> None:
    """Refuse one output file by what is there now."""
    suffix, json_only = path.suffix.lower(), option == "--json"
    refused = (*_NEVER, ".csv") if json_only else _NEVER
    try:
        # of a name that no file can have pathlib says since Python 3.14 that none has it
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            path.lstat()
        there = [file for file in inputs if file.exists()]
        folders = [resolved(file) for file in there if file.is_dir()]
        if path.is_dir():
            wrong = f"{option} names a folder", "name a file in it"
        elif any(map(resolved(path).is_relative_to, folders)) or (
            path.exists() and any(map(path.samefile, there))
        ):
            wrong = f"{option} would replace what this command reads", "name another file"
        elif suffix in refused and suffix not in wanted:
            kind = {".xml": "a scene", ".toml": "a campaign"}.get(suffix, "a table")
            mend = f"let the name end in {'.json' if json_only else '.csv'}"
            wrong = f"{option} would write a result under the name of {kind}", mend
        elif not _target(path).parent.is_dir():
            wrong = f"the folder {path.parent} does not exist", "make it or name another"
        elif path.parent in _DEVICES and not path.exists():
            wrong = "there is no such device", _MEND
        elif not os.access(path if _is_device(path) else _target(path).parent, os.W_OK) or (
            path.exists() and not os.access(path, os.W_OK)
        ):
            wrong = "cannot be written (no permission)", _MEND
        else:
            return
    except (OSError, ValueError) as error:
        raise _not_written(path, error) from None
    raise InputError(*wrong, path=path)


def _is_device(path: Path) -> bool:
    """Whether to write into what is there, a device or a pipe, instead of replacing it."""
    # /dev/stderr leads to a plain file when it is redirected to one
    return path.exists() and (not path.is_file() or _target(path).parent in _DESCRIPTORS)


# Results as JSON: plain types, and the text of a file.


def attributes(result: object, names: str) -> dict[str, Any]:
    """Attributes under their own names (``"value sigma"``), and under others: ``"n=mean.value"``.

    Of ``**NAME``, a mapping or a method that gives one, the items; a name that is there already
    keeps its place.
    """
    values: dict[str, Any] = {}
    for entry in names.split():
        name, _, attribute = entry.partition("=")
        value = attrgetter((attribute or name).removeprefix("**"))(result)
        value = value() if callable(value) else value
        values |= value if name.startswith("**") else {name: value}
    return values


def plain(value: Any) -> Any:
    """A value in types that JSON has; numbers that are not finite become None.

    Dataclasses and mappings become dicts, sequences and arrays lists, paths text. Raises TypeError
    if it holds something else.
    """
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, (np.generic, np.ndarray)):
        return plain(value.tolist())
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"JSON has nothing for a {type(value).__name__}")


def json_text(value: Any, indent: int | None = None) -> str:
    """JSON of a value, see `plain`; on one line without an indent."""
    return json.dumps(plain(value), indent=indent, ensure_ascii=False, allow_nan=False)
