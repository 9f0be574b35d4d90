"""What of the software determines photon records."""

from __future__ import annotations

import functools
import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path

from mcrim_mitsuba.kernel.variants import software_versions

#: Parts of this package that turn a scene and a seed into what units make.
_SOURCES = ("kernel", "physics", "effects", "fit", "work", "units.py")


def record_versions(variant: str) -> dict[str, str]:
    """Versions of everything that photon records depend on, as a part of a cache's key.

    The package's own code counts by its content: in a working copy it changes while its
    version stays.

    Parameters
    ----------
    variant : str
        Mitsuba variant; those that start with ``llvm`` depend on LLVM too.

    Raises
    ------
    InputError
        If the variant needs LLVM and there is none.
    """
    return software_versions(variant) | {
        "variant": variant,
        "machine": platform.machine(),
        "source_hash": _source_hash(),
    }


def other_version(versions: Mapping[str, str]) -> tuple[str, str, str] | None:
    """The first version in which this process differs from others' `record_versions`.

    Returns
    -------
    name, theirs, mine : str
        Hashes are shortened. None if all agree.
    """
    mine = record_versions(versions["variant"])
    for name in sorted({*mine, *versions}):
        if mine.get(name) != versions.get(name):
            theirs, own = (str(each.get(name, "none"))[:12] for each in (versions, mine))
            return name.replace("_", " "), theirs, own
    return None


@functools.cache
def _source_hash() -> str:
    """SHA-256 (hexadecimal) of the code that simulates: names and contents of its files."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for source in _SOURCES:
        path = package / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            content = file.read_bytes()
            digest.update(f"{file.relative_to(package).as_posix()} {len(content)}\n".encode())
            digest.update(content)
    return digest.hexdigest()
