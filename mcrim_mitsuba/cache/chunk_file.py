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

import numpy as np
from numpy.typing import NDArray

_MAGIC = b"mcrim records 1\n"
_DIGEST_BYTES = 32
_LENGTH_BYTES = 8
_PREAMBLE_BYTES = len(_MAGIC) + _DIGEST_BYTES + _LENGTH_BYTES
_ALIGNMENT_BYTES = 64
_PLAIN_KINDS = "biufc"  # bool, integers, floats, complex: what bytes and a dtype's name restore


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
    metadata: dict[str, object]


def encode(
    key_hash: str, number: int, arrays: Mapping[str, NDArray], metadata: Mapping[str, object]
) -> list[bytes | NDArray[np.uint8]]:
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
    described, data = [], []
    for name, array in arrays.items():
        array = np.asarray(array)
        if array.ndim != 1 or array.dtype.kind not in _PLAIN_KINDS:
            raise ValueError(f"{name} has shape {array.shape} and dtype {array.dtype}")
        array = np.ascontiguousarray(array)
        described.append({"name": name, "dtype": array.dtype.str, "length": len(array)})
        data += [array.view(np.uint8), bytes(-array.nbytes % _ALIGNMENT_BYTES)]
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
    digest = hashlib.sha256(content[after_digest:]).digest()
    if content[len(_MAGIC) : after_digest].tobytes() != digest:
        return None
    # from here on the content is what some process wrote, so that it can be taken at its word
    length = int.from_bytes(content[after_digest:_PREAMBLE_BYTES].tobytes(), "little")
    start = _PREAMBLE_BYTES + length
    header = json.loads(content[_PREAMBLE_BYTES:start].tobytes())
    if (header["key_hash"], header["number"]) != (key_hash, number):
        return None
    arrays = {}
    for described in header["arrays"]:
        dtype = np.dtype(described["dtype"])
        stop = start + described["length"] * dtype.itemsize
        arrays[described["name"]] = content[start:stop].view(dtype)
        start = stop + -stop % _ALIGNMENT_BYTES
    return Chunk(number, arrays, header["metadata"])
