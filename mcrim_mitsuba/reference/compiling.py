"""Compiles the tracer's functions by numba; where that is missing they run interpreted."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import platformdirs

numba: Any = None
with contextlib.suppress(ImportError):
    numba = importlib.import_module("numba")
    if not numba.config.CACHE_DIR:
        # Machine code has a folder for each state of the sources that it is made of: numba looks
        # at the file of a function only, and not at those that this calls. Its files are written
        # beside and renamed, so that processes may share them.
        _sources = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
        _named = hashlib.sha256(b"".join(_sources)).hexdigest()[:16]
        _folder = platformdirs.user_cache_path("mcrim_mitsuba", appauthor=False) / "numba" / _named
        with contextlib.suppress(OSError):  # where nothing can be kept, each process compiles
            _folder.mkdir(parents=True, exist_ok=True)
            numba.config.CACHE_DIR = str(_folder) if os.access(_folder, os.W_OK) else ""


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is compiled when it is first called, and then kept on disk."""
    if numba is None:
        return function
    # without counted references and calls, which would cost half of the time each;
    # none makes arrays
    options = {"nogil": True, "error_model": "numpy", "_nrt": False, "forceinline": True}
    compile_it: Callable[..., Any] = numba.njit(cache=bool(numba.config.CACHE_DIR), **options)
    return compile_it(function)


def say_if_slow() -> None:
    """Warn, once in a process, where nothing is compiled."""
    if numba is None:
        warnings.warn(
            "numba is not installed: the independent tracer is interpreted, some 1000 times "
            "slower; pip install 'mcrim-mitsuba[reference]'",
            stacklevel=2,
        )
