"""What a result rests on as one hash: where that has not changed, nothing is made again."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcrim_mitsuba.files.reading import read_bytes

_LIMIT_MB = 200


def key_of(**parts: Any) -> str:
    """SHA-256 (hexadecimal) of named numbers, texts, lists and dicts, and of the software."""
    from mcrim_mitsuba.kernel.variants import software_versions

    software = {**software_versions(str(parts.get("variant", ""))), "code": _code_hash()}
    text = json.dumps({"software": software, **parts}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def hashes(files: Iterable[str | Path]) -> list[str]:
    """SHA-256 (hexadecimal) of each file's content.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    return [hashlib.sha256(read_bytes(Path(file), _LIMIT_MB)).hexdigest() for file in files]


@functools.cache
def _code_hash() -> str:
    """Of all of this package: in a working copy it changes while its version stays."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
