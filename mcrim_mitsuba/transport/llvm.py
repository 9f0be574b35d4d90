"""Choose the LLVM library before Dr.Jit loads one.

Dr.Jit opens LLVM when it is imported. With a version that is too old the first kernel
aborts the whole process (``Cannot select: fmaximum``; measured with LLVM 15 and
16), which no ``except`` can catch. So `variants.use_variant`, by which every
simulation begins, has the choice made, and checked, here.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import functools
import glob
import importlib.metadata
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.core.errors import InputError

#: Oldest version seen to work with Dr.Jit 1.5; 15 and 16 abort, 17 and 18 were not available.
OLDEST_LLVM = 19
ENVIRONMENT_VARIABLE = "DRJIT_LIBLLVM_PATH"
#: Wheels that bring LLVM: to Linux on x86-64; elsewhere, for Python 3.12 and newer.
WHEELS = ("karellen-llvm-core", "llvm-nanobind")
#: What a library of LLVM is called in them; on macOS by a code, which says nothing.
_LIBRARY_NAME = re.compile(r"libLLVM[.-].*|LLVM\.dll|.*\.dylib")
_MEND = (
    f"unset {ENVIRONMENT_VARIABLE} to use the LLVM that `pip install` brought, "
    f"or point it at a libLLVM of version {OLDEST_LLVM} or newer"
)


@dataclass(frozen=True)
class LlvmLibrary:
    """An LLVM shared library that Dr.Jit can use."""

    #: File that Dr.Jit will open.
    path: str
    #: Major, minor, patch.
    version: tuple[int, int, int]
    #: Where it comes from: the user's ``environment``, the installed ``wheel``, the ``system``,
    #: or ``already loaded`` when Dr.Jit was imported before it was asked for.
    origin: str


def llvm_version(path: str | Path) -> tuple[int, int, int] | None:
    """Version of an LLVM shared library; ``None`` when it is older than 16.

    ``LLVMGetVersion`` exists since LLVM 16, so a library without it is too old.

    Raises
    ------
    OSError
        If the file is not a loadable shared library.
    """
    library = ctypes.CDLL(str(path))
    try:
        get_version = library.LLVMGetVersion
    except AttributeError:
        return None
    major, minor, patch = numbers = [ctypes.c_uint() for _ in range(3)]
    get_version(*map(ctypes.byref, numbers))
    return major.value, minor.value, patch.value


@functools.cache
def selected_llvm() -> LlvmLibrary:
    """The library that Dr.Jit uses, or will use when it is imported.

    The user's ``DRJIT_LIBLLVM_PATH`` is respected; else the library of the installed wheel is
    taken, else the newest one of the system, and this variable names it from then on.

    Raises
    ------
    InputError
        If the user's choice is missing, not a library or too old, if no usable library is
        found, or if Dr.Jit was imported first and has loaded one that is too old.
    """
    if "drjit" in sys.modules:
        return _already_loaded()
    chosen = os.environ.get(ENVIRONMENT_VARIABLE)
    if chosen:
        return _of_the_user(chosen)
    places = ("wheel", _in_wheels), ("system", _in_system)
    usable = (_usable(path, origin) for origin, paths in places for path in paths())
    library = next(filter(None, usable), None)
    if library is None:
        raise InputError(
            f"no LLVM library of version {OLDEST_LLVM} or newer was found",
            f"run `pip install {WHEELS[0]}` (Linux on x86-64) or `pip install {WHEELS[1]}` "
            f"(other systems, Python 3.12 or newer), or let {ENVIRONMENT_VARIABLE} name your "
            "system's libLLVM",
        )
    os.environ[ENVIRONMENT_VARIABLE] = library.path
    return library


def _already_loaded() -> LlvmLibrary:
    """What Dr.Jit has opened, where the system lists it (Linux); else what it was told to."""
    maps = Path("/proc/self/maps")
    lines = maps.read_text().splitlines() if maps.exists() else []
    paths = sorted({line.split()[-1] for line in lines if "libLLVM" in line})
    path = paths[0] if paths else os.environ.get(ENVIRONMENT_VARIABLE, "")
    library = _usable(Path(path), "already loaded") if path else None
    if library is None:
        raise InputError(
            f"Dr.Jit was imported first and uses {path or 'no LLVM'}, which is too old",
            "call mcrim_mitsuba.use_variant() before mitsuba and drjit are imported",
        )
    return library


def _of_the_user(path: str) -> LlvmLibrary:
    place = f"{ENVIRONMENT_VARIABLE}={path}"
    if not Path(path).is_file():
        raise InputError("there is no such file", _MEND, path=place)
    try:
        version = llvm_version(path)
    except OSError:
        raise InputError("this is not a shared library", _MEND, path=place) from None
    if version is None or version[0] < OLDEST_LLVM:
        name = "older than 16" if version is None else ".".join(map(str, version))
        what = f"this LLVM ({name}) is too old: Dr.Jit's first kernel would abort the process"
        raise InputError(what, _MEND, path=place)
    return LlvmLibrary(path, version, "environment")


def _usable(path: Path, origin: str) -> LlvmLibrary | None:
    try:
        version = llvm_version(path)
    except OSError:
        return None
    if version is None or version[0] < OLDEST_LLVM:
        return None
    return LlvmLibrary(str(path), version, origin)


def _in_wheels() -> list[Path]:
    # where a virtual environment has it; asking the installer's records takes longer
    if quick := sorted((Path(sys.prefix) / "lib").glob("libLLVM.so.*")):
        return [path.resolve() for path in quick]
    files: list[importlib.metadata.PackagePath] = []
    for wheel in WHEELS:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            files += importlib.metadata.files(wheel) or []
    # karellen's unversioned names are symbolic links that exist only after the
    # first start of the interpreter; the versioned file is there at once.
    paths = [Path(file.locate()) for file in files if _LIBRARY_NAME.fullmatch(file.name)]
    return list(dict.fromkeys(path.resolve() for path in paths if path.is_file()))


def _in_system() -> list[Path]:
    patterns = [
        "/usr/lib/*/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    ]
    libraries = {Path(name).resolve() for pattern in patterns for name in glob.glob(pattern)}
    linked = ctypes.util.find_library("LLVM")
    if linked and Path(linked).is_file():
        libraries.add(Path(linked))

    def newest_first(path: Path) -> int:
        number = re.search(r"\d+", path.name)
        return -int(number[0]) if number else 0

    return sorted(libraries, key=newest_first)
