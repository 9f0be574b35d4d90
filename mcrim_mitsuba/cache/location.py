"""Where the cache of photon records lies and how large it may grow."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import platformdirs

from mcrim_mitsuba.errors import InputError

FOLDER_VARIABLE = "MCRIM_CACHE"
SIZE_VARIABLE = "MCRIM_CACHE_GB"
DEFAULT_SIZE_GB = 5.0
BYTES_PER_GB = 1_000_000_000
_LARGEST_SIZE_GB = 1e6


def cache_folder() -> Path | None:
    """Folder of the cache, or None where ``MCRIM_CACHE`` is empty or ``off``.

    Without ``MCRIM_CACHE`` it is the operating system's place for caches, made when something
    is written; a folder that ``MCRIM_CACHE`` names is made at once.

    Raises
    ------
    InputError
        If ``MCRIM_CACHE`` names something that is no folder and cannot become one.
    """
    given = os.environ.get(FOLDER_VARIABLE)
    if given is None:
        return platformdirs.user_cache_path("mcrim_mitsuba", appauthor=False)
    if given.strip().lower() in ("", "off"):
        return None
    try:
        folder = Path(given).expanduser().absolute()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: ~name of an unknown user
        if isinstance(error, FileExistsError):
            reason = "it is not a folder"
        else:
            reason = cause(error)
        raise InputError(
            f"the cache cannot lie there ({reason})",
            f"let {FOLDER_VARIABLE} name a folder, or set it to off",
            path=f"{FOLDER_VARIABLE}={given}",
        ) from None
    return folder


def cause(error: Exception) -> str:
    """Why something could not be made in the cache, for the user.

    Folders on the way are made too: where one is said to be missing all the same, as in /proc,
    the file system takes none.
    """
    if getattr(error, "errno", None) == errno.ENOENT:
        return "no file can be made in this file system"
    return getattr(error, "strerror", None) or str(error)


def size_limit_bytes() -> int:
    """Largest size of the whole cache: ``MCRIM_CACHE_GB`` in units of 10^9 bytes, 5 by default.

    Raises
    ------
    InputError
        If ``MCRIM_CACHE_GB`` is not a number above 0 and up to a million.
    """
    given = os.environ.get(SIZE_VARIABLE, "").strip()
    try:
        size_gb = float(given) if given else DEFAULT_SIZE_GB
    except ValueError:
        size_gb = 0.0
    if not 0 < size_gb <= _LARGEST_SIZE_GB:
        raise InputError(
            f"'{given}' is no size for the cache",
            f"give a number of GB above 0, such as {DEFAULT_SIZE_GB:g}; "
            f"{FOLDER_VARIABLE}=off does without a cache",
            path=SIZE_VARIABLE,
        )
    return round(size_gb * BYTES_PER_GB)
