"""Compiles the tracer's functions by numba; where that is missing they run interpreted."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import platformdirs

try:
    import numba
except ImportError:
    numba = None

_SLOW = (
    "numba is not installed: the independent tracer runs interpreted, some 1000 times slower; "
    "pip install 'mcrim-mitsuba[reference]'"
)


def _cache_folder() -> str:
    """Where machine code is kept: a folder for each state of the sources that it is made of.

    Numba itself looks at the file of a function only, and not at those that this calls. Its files
    are written beside and renamed, so that processes may share them.
    """
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return str(platformdirs.user_cache_path("mcrim_mitsuba") / "numba" / digest.hexdigest()[:16])


if numba is not None and not numba.config.CACHE_DIR:
    numba.config.CACHE_DIR = _cache_folder()


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is compiled when it is first called, and then kept on disk."""
    if numba is None:
        return function
    compile_it: Callable[..., Any] = numba.njit(
        cache=True, nogil=True, error_model="numpy", _nrt=False
    )
    return compile_it(function)


def say_if_slow() -> None:
    """Warn, once in a process, where nothing is compiled."""
    if numba is None:
        warnings.warn(_SLOW, stacklevel=2)
