"""What determines a result, as one hash: where that has not changed, nothing is made again.

Code counts by its content, for in a working copy it changes while its version stays. Of trials,
which take a night, it counts without comments and docstrings; to parse it takes half a second.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
import platform
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.files import read_bytes
from mcrim_mitsuba.core.run import DEFAULT_VARIANT
from mcrim_mitsuba.transport.variants import software_versions

_LIMIT_MB = 200
_PACKAGE = Path(__file__).parents[1]
#: Rooms that turn a scene and a seed into what units make. What `scene` makes of a file is hashed
#: itself.
_RECORD_ROOMS = ("core", "optics", "effects", "transport", "runs", "efficiency")


def record_versions(variant: str) -> dict[str, str]:
    """Versions of everything that photon records depend on, as a part of a cache's key.

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
        "source_hash": _content_hash(*_RECORD_ROOMS),
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


def key_of(**parts: Any) -> str:
    """SHA-256 (hexadecimal) of named numbers, texts, lists and dicts, and of the software."""
    software = {**software_versions(str(parts.get("variant", ""))), "code": _content_hash()}
    return _hash({"software": software, **parts})


def trial_key(name: str, parameters: dict[str, Any], code: Iterable[Path]) -> str:
    """SHA-256 (hexadecimal) of what trials of a kind have in common, and of the software.

    Parameters
    ----------
    name : str
    parameters : dict
        Of what JSON can hold.
    code : iterable of Path
        Python files that make the trials. Of the package's own the commands do not count.
    """
    software = {
        **software_versions(DEFAULT_VARIANT),
        "code": package_hash(),
        "trials": source_hash(code),
    }
    return _hash({"software": software, "name": name, "parameters": parameters})


def hashes(files: Iterable[str | Path]) -> list[str]:
    """SHA-256 (hexadecimal) of each file's content.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    return [hashlib.sha256(read_bytes(Path(file), _LIMIT_MB)).hexdigest() for file in files]


def source_hash(files: Iterable[Path]) -> str:
    """SHA-256 (hexadecimal) of Python files; comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    for file in sorted(files):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in _documented(tree):
            node.body = node.body[1:]
        digest.update(f"{file.name}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()


def _documented(tree: ast.AST) -> Iterator[Any]:
    """Nodes of a syntax tree that begin with a docstring."""
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    for node in ast.walk(tree):
        if isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None:
            yield node


@functools.cache
def package_hash() -> str:
    """`source_hash` of this package but its commands."""
    files = _PACKAGE.rglob("*.py")
    return source_hash(f for f in files if "cli" not in f.relative_to(_PACKAGE).parts)


@functools.cache
def _content_hash(*rooms: str) -> str:
    """SHA-256 (hexadecimal) of the code of some rooms, or of the whole package."""
    digest = hashlib.sha256()
    for folder in [_PACKAGE / room for room in rooms] or [_PACKAGE]:
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.relative_to(_PACKAGE).as_posix().encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def _hash(named: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()
