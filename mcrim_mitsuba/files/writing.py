"""Writes result files whole or not at all, and says beforehand where that cannot be."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import NONBLOCK, resolved

#: Names of standard output.
STDOUT = ("-", "/dev/stdout")
_MEND = "name a file in a folder you may write to"
_FREE = "free some space, or name a file on another disk"
_DEVICES = (Path("/dev"), Path("/dev/fd"))
_NEVER = (".xml", ".toml")  # a slip of the hand: results would replace a scene or a campaign


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 file so that nobody ever sees half of it; ``-`` is standard output.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    if str(path) in STDOUT:
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except BrokenPipeError:
            silence_stdout()
        return
    write_bytes(path, text.encode())


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    path = Path(path)
    temporary = None
    try:
        if path.is_dir():
            raise IsADirectoryError(21, "it is a folder")
        if _is_device(path):
            _write_into(path, content)
            return
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())  # else the name might outlive a power cut, and not the file
        # mkstemp makes private files; results are as readable as any other new file
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        reason = getattr(error, "strerror", None) or str(error)
        full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
        raise InputError(
            f"cannot be written ({reason})", _FREE if full else _MEND, path=path
        ) from None


def _write_into(path: Path, content: bytes) -> None:
    """Write into a device or a pipe, not into a disk; a pipe must have its reader already."""
    if stat.S_ISBLK(path.stat().st_mode):
        raise OSError(errno.EPERM, "it is a disk")
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_TRUNC | NONBLOCK)
    except OSError as error:
        if error.errno == errno.ENXIO and path.is_fifo():
            raise OSError(errno.ENXIO, "nobody reads from this pipe") from None
        raise
    with os.fdopen(descriptor, "wb") as stream:
        if NONBLOCK:
            os.set_blocking(descriptor, True)
        stream.write(content)


def silence_stdout() -> None:
    """Send the rest of standard output nowhere: its reader, `head` perhaps, has seen enough."""
    with contextlib.suppress(OSError, ValueError):  # no descriptor behind it: nothing to send
        descriptor = sys.stdout.fileno()
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def refuse_outputs(
    outputs: Mapping[str, str | None],
    inputs: Iterable[str | Path] = (),
    *,
    suffixes: Mapping[str, tuple[str, ...]] | None = None,
) -> None:
    """Refuse output files that could not be written, or would replace what is read.

    Parameters
    ----------
    outputs : mapping of str to (str or None)
        File by option; None where the option was not given.
    inputs : iterable of str or Path
        Files that the command reads.
    suffixes : mapping of str to tuple of str, optional
        Suffixes that an option's file must have, if not any.

    Raises
    ------
    InputError
        Before any work is done and without touching a file.
    """
    read = [Path(file) for file in inputs]
    taken: dict[Path, str] = {}
    for option, given in outputs.items():
        if given is None:
            continue
        path = Path("-" if given in STDOUT else given)
        key = path if str(path) == "-" else resolved(path)
        if key in taken and not _is_device(path):
            raise InputError(
                f"{taken[key]} and {option} both write {given}", "give each a file of its own"
            )
        taken[key] = option
        wanted = (suffixes or {}).get(option)
        if wanted and path.suffix.lower() not in wanted:
            raise InputError(
                f"{option} cannot write {path.suffix or 'a file without suffix'}",
                f"let the name end in {' or '.join(wanted)}",
                path=given,
            )
        if str(path) != "-":
            _refuse_output(option, path, read, wanted or ())


def _refuse_output(option: str, path: Path, inputs: list[Path], wanted: tuple[str, ...]) -> None:
    """Refuse one output file by what is there now."""
    try:
        if path.is_dir():
            raise InputError(f"{option} names a folder", "name a file in it", path=path)
        for file in inputs:
            if path.exists() and file.exists() and path.samefile(file):
                raise InputError(
                    f"{option} would replace what this command reads", "name another file",
                    path=path,
                )  # fmt: skip
        refused = (*_NEVER, ".csv") if option == "--json" else _NEVER
        if path.suffix.lower() in refused and path.suffix.lower() not in wanted:
            raise InputError(
                f"{option} would write a result under the name of "
                + {".xml": "a scene", ".toml": "a campaign"}.get(path.suffix.lower(), "a table"),
                f"let the name end in {'.json' if option == '--json' else '.csv'}",
                path=path,
            )
        if not path.parent.is_dir():
            raise InputError(
                f"the folder {path.parent} does not exist", "make it or name another", path=path
            )
        if path.parent in _DEVICES and not path.exists():
            raise InputError("there is no such device", _MEND, path=path)
        replaced = path if _is_device(path) else path.parent
        writable = os.access(replaced, os.W_OK) and (not path.exists() or os.access(path, os.W_OK))
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot be written ({reason})", _MEND, path=path) from None
    if not writable:
        raise InputError("cannot be written (no permission)", _MEND, path=path)


def _is_device(path: Path) -> bool:
    """Whether to write into what is there, a device or a pipe, instead of replacing it."""
    # /dev/stderr is a link to a plain file when it is redirected to one
    return path.exists() and (not path.is_file() or path.parent in _DEVICES)
