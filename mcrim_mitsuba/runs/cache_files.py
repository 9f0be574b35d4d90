"""One launch's records as one file, in which no changed bit goes unnoticed; the cache kept tidy.

A file is the SHA-256 of what follows it, 32 bytes; the length of the header, 8 bytes,
little-endian; the header, JSON with ``key``, ``number``, ``metadata`` and ``arrays`` (by name their
dtypes and lengths); and the bytes of these. Each array begins at a multiple of 64 bytes, after
blanks or zeros: what is read at once need not be copied.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import operator
import os
import re
import shutil
import time
import uuid
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DIGEST_BYTES = 32
_LENGTH_BYTES = 8
_PREAMBLE_BYTES = _DIGEST_BYTES + _LENGTH_BYTES
_ALIGNMENT_BYTES = 64
_PLAIN_KINDS = "biufc"  # bool, integers, floats, complex: what bytes and a dtype's name restore


@dataclass(frozen=True, eq=False)
class Chunk:
    """What one launch yielded."""

    #: Which launch, counted from 0.
    number: int
    #: One-dimensional, with the names, dtypes and order they were written with.
    arrays: dict[str, NDArray]
    #: As JSON gives it back: tuples have become lists.
    metadata: dict[str, Any]


def encode(
    key: Mapping[str, object],
    number: int,
    arrays: Mapping[str, NDArray],
    metadata: Mapping[str, object],
) -> list[bytes | memoryview]:
    """The parts of a chunk's file, in order.

    `key` determines the records, and `number`, from 0, says which of its chunks it is. Arrays, of
    any length, are of bool, integers, floats or complex numbers, and not copied where contiguous;
    the metadata are small.

    Raises TypeError or ValueError if an array has not one dimension or another dtype, or something
    else is not for JSON.
    """
    header = _header(key, number, arrays, metadata)
    parts: list[bytes | memoryview] = [len(header).to_bytes(_LENGTH_BYTES, "little"), header]
    for array in arrays.values():
        array = np.ascontiguousarray(array)
        parts += [array.view(np.uint8).data, bytes(-array.nbytes % _ALIGNMENT_BYTES)]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return [digest.digest(), *parts]


def _header(
    key: Mapping[str, object],
    number: int,
    arrays: Mapping[str, NDArray],
    metadata: Mapping[str, object],
) -> bytes:
    """What arrays are of, with blanks at its end."""
    described = {}
    for name, array in arrays.items():
        array = np.asarray(array)
        if array.ndim != 1 or array.dtype.kind not in _PLAIN_KINDS:
            raise ValueError(f"{name} has shape {array.shape} and dtype {array.dtype}")
        described[name] = array.dtype.str, len(array)
    named = {"key": key, "number": operator.index(number), "metadata": {**metadata}}
    text = json.dumps(named | {"arrays": described}).encode()
    return text + b" " * (-(_PREAMBLE_BYTES + len(text)) % _ALIGNMENT_BYTES)


def decode(content: NDArray[np.uint8], key: Mapping[str, object], number: int) -> Chunk | None:
    """The chunk that a file holds, or None unless it is exactly what `encode` gave for it.

    Arrays of the result are views of `content`, (file size,) uint8.
    """
    if hashlib.sha256(content[_DIGEST_BYTES:].data).digest() != content[:_DIGEST_BYTES].tobytes():
        return None
    # a digest keeps off damage, not those who write other files: a cache may be a shared folder
    with contextlib.suppress(Exception):
        length_bytes = content[_DIGEST_BYTES:_PREAMBLE_BYTES].tobytes()
        start = _PREAMBLE_BYTES + int.from_bytes(length_bytes, "little")
        header, arrays = content[_PREAMBLE_BYTES:start].tobytes(), dict[str, NDArray]()
        told = json.loads(header)
        for name, (dtype, length) in told["arrays"].items():
            arrays[name] = np.frombuffer(content, dtype, length, start)
            stop = start + arrays[name].nbytes
            start = stop + -stop % _ALIGNMENT_BYTES
            if content[stop:start].any():
                return None
        if start == len(content) and _header(key, number, arrays, told["metadata"]) == header:
            return Chunk(number, arrays, told["metadata"])
    return None


# Keeps the cache small and tidy, beside other processes that use it at the same time.
#
# The cache holds one folder per key, named by the key's SHA-256; the time of its last change is
# that of the key's last use. Nothing else in the cache's folder is touched, whatever the user may
# keep there; only what bears the very name that a key or a chunk of it is about to get has to make
# way.

_KEY_FOLDER = re.compile(r"[0-9a-f]{64}")
_UNFINISHED = ".mcrim-unfinished-"
_REMOVED = ".mcrim-removed-"
#: No write takes that long: who left an unfinished file behind for this long is no more.
_LEFT_BEHIND_S = 6 * 3600.0
#: So long a cache that is not half full is not looked through again: of thousands of files that
#: takes longer than writing one, and what other processes write meanwhile finds its room.
_TRUSTED_S = 5.0
#: By cache: when it was looked through, and its bytes then and what this process wrote since.
_looked_through: dict[Path, tuple[float, int]] = {}


def unfinished(folder: Path) -> Path:
    """A new name in a folder for something that is still being written."""
    return folder / f"{_UNFINISHED}{uuid.uuid4().hex}"


def remove(path: Path, cache: Path) -> None:
    """Remove a key's folder, or what lies in its or a chunk's place, for all processes at once.

    OSError if it cannot be moved away.
    """
    grave = cache / f"{_REMOVED}{uuid.uuid4().hex}"
    os.rename(path, grave)
    _bury(grave)


def _bury(grave: Path | str) -> None:
    """Remove a folder with all that is in it, a file, or a link but not what it leads to."""
    if os.path.isdir(grave) and not os.path.islink(grave):  # rmtree would wait for a pipe
        shutil.rmtree(grave, ignore_errors=True)
    with contextlib.suppress(OSError):
        os.unlink(grave)


def make_room(cache: Path, needed_bytes: int, limit_bytes: int, in_use: Collection[Path]) -> bool:
    """Remove least recently used keys until so much more fits under the limit.

    Key folders `in_use` stay, come what may. Tells whether there is room now; if not, nothing was
    removed. OSError if a key's folder cannot be removed.
    """
    now_s, (looked_s, known_bytes) = time.monotonic(), _looked_through.get(cache, (-math.inf, 0))
    if now_s - looked_s < _TRUSTED_S and known_bytes + needed_bytes < limit_bytes / 2:
        _looked_through[cache] = looked_s, known_bytes + needed_bytes
        return True
    folders = _key_folders(cache)
    known_bytes = sum(size_bytes for _, _, size_bytes in folders) + needed_bytes
    _looked_through[cache] = now_s, known_bytes
    removable = sorted(folder for folder in folders if folder[1] not in in_use)
    excess_bytes = known_bytes - limit_bytes
    if sum(size_bytes for *_, size_bytes in removable) < excess_bytes:
        return False
    for _, path, size_bytes in removable:
        if excess_bytes <= 0:
            break
        with contextlib.suppress(FileNotFoundError):  # removed by another process
            remove(path, cache)
        excess_bytes -= size_bytes
    return True


def clear_left_behind(cache: Path) -> None:
    """Remove what processes that were killed have left unfinished or half removed."""
    before_s = time.time() - _LEFT_BEHIND_S
    for entry in _entries(cache):
        unfinished_since_s = _status(entry)[0] if entry.name.startswith(_UNFINISHED) else math.inf
        if entry.name.startswith(_REMOVED) or unfinished_since_s < before_s:
            _bury(entry.path)


def _key_folders(cache: Path) -> list[tuple[float, Path, int]]:
    """When each key was last used (seconds since 1970), its folder, and its size in bytes."""
    folders = []
    for entry in _entries(cache):
        # others too name files by a SHA-256, but ours are folders
        if _KEY_FOLDER.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
            size_bytes = sum(_status(file)[1] for file in _entries(entry.path))
            folders.append((_status(entry)[0], Path(entry.path), size_bytes))
    return folders


def _entries(folder: Path | str) -> list[os.DirEntry]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except OSError:
        return []


def _status(entry: os.DirEntry) -> tuple[float, int]:
    """Time of the last change (seconds since 1970) and bytes; what has gone is new and empty."""
    try:
        status = entry.stat(follow_symlinks=False)
    except OSError:
        return math.inf, 0
    return status.st_mtime, status.st_size
