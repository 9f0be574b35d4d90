"""Finds measurements that would count twice."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Sequence
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import read_bytes

_LIMIT_MB = 50


def first_twins(paths: Sequence[Path]) -> tuple[int, int] | None:
    """Two files that are one by their resolved paths or, byte by byte, by their content.

    Parameters
    ----------
    paths : sequence of Path

    Returns
    -------
    (int, int) or None
        Which ones, the earlier first. What cannot be read is its reader's to refuse.
    """
    seen: dict[Path | str, int] = {}
    for place, path in enumerate(paths):
        keys: list[Path | str] = []
        with contextlib.suppress(InputError, OSError, ValueError, RuntimeError):
            keys.append(path.resolve())
            # a pipe can be read only once
            if path.is_file():
                keys.append(hashlib.sha256(read_bytes(path, _LIMIT_MB)).hexdigest())
        for key in keys:
            if key in seen:
                return seen[key], place
        seen.update(dict.fromkeys(keys, place))
    return None
