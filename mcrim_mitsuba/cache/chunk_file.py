"""One launch's records as one file, in which no changed bit goes unnoticed.

::

    16 bytes   "mcrim records 1\\n"; another layout gets another number
    32 bytes   SHA-256 of everything that follows
     8 bytes   length of the header, little-endian
    header     JSON: key_hash, number, metadata, arrays [{name, dtype, length}]; blanks at its end
    arrays     their bytes in the header's order, each followed by zeros up to a multiple of 64
"""

from __future__ import annotations

import hashlib
import json
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

_MAGIC = b"mcrim records 1\n"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 8
_PREAMBLE_BYTES = len(_MAGIC) + _DIGEST_BYTES + _LENGTH_BYTES
_ALIGNMENT_BYTES = 64
_PLAIN_KINDS = "biufc"  # bool, integers, floats, complex: what bytes and a dtype's name restore
_ORDERS: tuple[Literal["<"], Literal[">"]] = ("<", ">")
_PLAIN_DTYPES = frozenset(
    np.dtype(code).newbyteorder(order).str
    for code in "?" + np.typecodes["AllInteger"] + np.typecodes["AllFloat"]
    for order in _ORDERS
)


@dataclass(frozen=True, eq=False)
class Chunk:
    """What one launch yielded.

    Attributes
    ----------
    number : int
        Which launch, counted from 0.
    arrays : dict of str to ndarray
        One-dimensional, with the names, dtypes and order they were written with.
    metadata : dict
        As JSON gives it back: tuples have become lists.
    """

    number: int
    arrays: dict[str, NDArray]
    metadata: dict[str, Any]


def encode(
    key_hash: str, number: int, arrays: Mapping[str, NDArray], metadata: Mapping[str, object]
) -> list[bytes | memoryview]:
    """The parts of a chunk's file, in order.

    Parameters
    ----------
    key_hash : str
        Of the key that the records belong to.
    number : int
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

    Parameters
    ----------
    content : (file size,) uint8
        The arrays of the result are views of it.
    key_hash : str
    number : int
        The file must say of itself that it holds this chunk of this key.
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
    for each in described:
        match each:
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
