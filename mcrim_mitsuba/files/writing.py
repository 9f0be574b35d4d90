"""Writes result files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from mcrim_mitsuba.errors import InputError


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 file so that nobody ever sees half of it.

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
        if path.exists() and not path.is_file():  # /dev/stdout, a pipe
            path.write_text(text, encoding="utf-8")
            return
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            stream.write(text)
        # mkstemp makes private files; results are as readable as any other new file
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot be written ({reason})", "name a file in a folder you may write to", path=path
        ) from None
