r"""One launch's records as one file, in which no changed bit goes unnoticed.

::

    16 bytes   "mcrim records 1\n"; another layout gets another number
    32 bytes   SHA-256 of everything that follows
     8 bytes   length of the header, little-endian
    header     JSON: key_hash, number, metadata, arrays [{name, dtype, length}]; blanks at its end
    arrays     their bytes in the header's order, each followed by zeros up to a multiple of 64"""

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

_MAGIC = b"mcrim records 1\n"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 8
_PREAMBLE_BYTES = len(_MAGIC) + _DIGEST_BYTES + _LENGTH_BYTES
_ALIGNMENT_BYTES = 64
_PLAIN_KINDS = "biufc"  # bool, integers, floats, complex: what bytes and a dtype's name restore
_PLAIN_DTYPES = frozenset(
    np.dtype(order + code).str
    for code in "?" + np.typecodes["AllInteger"] + np.typecodes["AllFloat"]
    for order in "<>"
)


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
    key_hash: str, number: int, arrays: Mapping[str, NDArray], metadata: Mapping[str, object]
) -> list[bytes | memoryview]:
    """The parts of a chunk's file, in order.

    Parameters
    ----------
    key_hash, number
        Of the key that the records belong to, and of the chunk.
    arrays : mapping of str to (any length,) ndarray
        Of bool, integers, floats or complex numbers; not copied where contiguous.
    metadata : mapping
        Small, of what JSON can hold.

    Raises
    ------
    TypeError, ValueError
        If an array has not one dimension or another dtype, or `metadata` is not for JSON.
    """
    described: list[dict[str, object]] = []
    data: list[bytes | memoryview] = []
    for name, array in arrays.items():
        array = np.asarray(array)
        if array.ndim != 1 or array.dtype.kind not in _PLAIN_KINDS:
            raise ValueError(f"{name} has shape {array.shape} and dtype {array.dtype}")
        array = np.ascontiguousarray(array)
        described.append({"name": name, "dtype": array.dtype.str, "length": len(array)})
        data += [array.view(np.uint8).data, bytes(-array.nbytes % _ALIGNMENT_BYTES)]
    header = json.dumps(
        {
            "key_hash": key_hash,
            "number": operator.index(number),
            "metadata": dict(metadata),
            "arrays": described,
        }
    ).encode()
    header += b" " * (-(_PREAMBLE_BYTES + len(header)) % _ALIGNMENT_BYTES)
    body = [len(header).to_bytes(_LENGTH_BYTES, "little"), header, *data]
    digest = hashlib.sha256()
    for part in body:
        digest.update(part)
    return [_MAGIC, digest.digest(), *body]


def decode(content: NDArray[np.uint8], key_hash: str, number: int) -> Chunk | None:
    """The chunk that a file holds, or None unless it is exactly what `encode` gave for it.

    Arrays of the result are views of `content`, (file size,) uint8, which must say of itself that
    it holds this chunk of this key.
    """
    after_digest = len(_MAGIC) + _DIGEST_BYTES
    if content[: len(_MAGIC)].tobytes() != _MAGIC:
        return None
    digest = hashlib.sha256(content[after_digest:].data).digest()
    if content[len(_MAGIC) : after_digest].tobytes() != digest:
        return None
    # a digest keeps off damage, not those who write other files: a cache may be a shared folder
    length = int.from_bytes(content[after_digest:_PREAMBLE_BYTES].tobytes(), "little")
    start = _PREAMBLE_BYTES + length
    try:
        header = json.loads(content[_PREAMBLE_BYTES:start].tobytes().decode())
    except (ValueError, RecursionError):
        return None
    match header:
        case {"key_hash": k, "number": n, "metadata": dict(metadata), "arrays": list(described)}:
            arrays = _arrays(content, start, described) if (k, n) == (key_hash, number) else None
            return None if arrays is None else Chunk(number, arrays, metadata)
    return None


def _arrays(
    content: NDArray[np.uint8], start: int, described: list[object]
) -> dict[str, NDArray] | None:
    """Arrays that begin at `start`, as views; None if what follows is not just these."""
    arrays = {}
    for entry in described:
        match entry:
            case {"name": str(name), "dtype": str(dtype), "length": int(length)} if (
                dtype in _PLAIN_DTYPES and length >= 0
            ):
                stop = start + length * np.dtype(dtype).itemsize
                if stop > len(content):
                    return None
                arrays[name] = content[start:stop].view(dtype)
                start = stop + -stop % _ALIGNMENT_BYTES
                if content[stop:start].any():
                    return None
            case _:
                return None
    return arrays if start == len(content) else None


# Keeps the cache small and tidy, beside other processes that use it at the same time.
#
# The cache holds one folder per key, named by the key's SHA-256. A folder appears and disappears
# by being renamed, so that under its name it is always whole. Nothing else in the cache's folder
# is touched, whatever the user may keep there; only what bears the very name that a key or a chunk
# of it is about to get has to make way.

#: Holds the key, readable; the time of its last change is the time of the key's last use.
KEY_FILE = "key.json"
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


def is_passing(path: Path) -> bool:
    """Whether a name is that of something unfinished or half removed."""
    return path.name.startswith((_UNFINISHED, _REMOVED))


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
    staying_bytes = sum(size_bytes for _, path, size_bytes in folders if path in in_use)
    if staying_bytes + needed_bytes > limit_bytes:
        return False
    excess_bytes = known_bytes - limit_bytes
    for _, path, size_bytes in sorted(folders):
        if excess_bytes <= 0:
            break
        if path not in in_use:
            with contextlib.suppress(FileNotFoundError):  # removed by another process
                remove(path, cache)
            excess_bytes -= size_bytes
    return True


def clear_left_behind(cache: Path) -> None:
    """Remove what processes that were killed have left unfinished or half removed."""
    before_s = time.time() - _LEFT_BEHIND_S
    for entry in _entries(cache):
        if entry.name.startswith(_REMOVED):
            _bury(entry.path)
        elif entry.name.startswith(_UNFINISHED) and _changed_s(entry) < before_s:
            _bury(entry.path)
        elif _is_key_folder(entry):
            for file in _entries(entry.path):
                if file.name.startswith(_UNFINISHED) and _changed_s(file) < before_s:
                    with contextlib.suppress(OSError):
                        os.unlink(file.path)


def _key_folders(cache: Path) -> list[tuple[float, Path, int]]:
    """When each key was last used (seconds since 1970), its folder, and its size in bytes.

    What vanishes meanwhile counts as empty.
    """
    folders = []
    for entry in _entries(cache):
        if not _is_key_folder(entry):
            continue
        used_s, size_bytes = 0.0, 0
        for file in _entries(entry.path):
            with contextlib.suppress(OSError):
                status = file.stat(follow_symlinks=False)
                size_bytes += status.st_size
                if file.name == KEY_FILE:
                    used_s = status.st_mtime
        folders.append((used_s, Path(entry.path), size_bytes))
    return folders


def _is_key_folder(entry: os.DirEntry) -> bool:
    """By its name; others too name files by a SHA-256, but ours are folders."""
    try:
        return bool(_KEY_FOLDER.fullmatch(entry.name)) and entry.is_dir(follow_symlinks=False)
    except OSError:
        return False


def _entries(folder: Path | str) -> list[os.DirEntry]:
    try:
        with os.scandir(folder) as entries:
            return list(entries)
    except OSError:
        return []


def _changed_s(entry: os.DirEntry) -> float:
    """Time of the last change; of what is gone, the future."""
    try:
        return entry.stat(follow_symlinks=False).st_mtime
    except OSError:
        return float("inf")
