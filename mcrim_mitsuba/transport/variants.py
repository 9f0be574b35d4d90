"""Mitsuba made ready: an LLVM library, a variant with the plugins in it, threads; and versions.

`use_variant` does it all, and every simulation begins with it. Dr.Jit opens LLVM when it is
imported. With a version that is too old the first kernel aborts the whole process
(``Cannot select: fmaximum``; measured with LLVM 15 and 16), which no ``except`` can catch. So the
choice is made, and checked, before.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import functools
import glob
import importlib
import importlib.metadata
import os
import platform
import re
import struct
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, processors, signals_wait
from mcrim_mitsuba.transport import plugins

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

    Raises OSError if the file is not a loadable shared library.
    """
    library = ctypes.CDLL(str(path))
    try:
        get_version = library.LLVMGetVersion
    except AttributeError:
        return None
    major, minor, patch = numbers = [ctypes.c_uint() for _ in range(3)]
    get_version(*map(ctypes.byref, numbers))
    return major.value, minor.value, patch.value


#: A small library of GCC's that Dr.Jit needs and LLVM asks for, which slim systems lack.
LIBATOMIC = "libatomic.so.1"
#: All that Dr.Jit calls of it, __atomic_compare_exchange_16, for x86-64: by ``lock cmpxchg16b``
#: [rdi] becomes rcx:rdx if it was [rsi], which becomes what it was; al is whether they were equal.
_COMPARE_EXCHANGE = bytes.fromhex("53 4889d3 488b06488b5608 f0480fc70f 488906 48895608 0f94c05bc3")


def _provide_libatomic() -> None:
    """Load a `LIBATOMIC` made in memory where the system has none: others find it by its name.

    Raises InputError if it has none and cannot take this one.
    """
    with contextlib.suppress(OSError):
        ctypes.CDLL(LIBATOMIC)
        return
    try:
        file = os.memfd_create(LIBATOMIC)
        os.write(file, _libatomic())
        ctypes.CDLL(f"/proc/self/fd/{file}")
        os.close(file)
    except OSError as error:
        problem = f"Dr.Jit needs {LIBATOMIC}, which this system lacks ({error})"
        mend = "install it: `apt-get install libatomic1`, or `dnf install libatomic`"
        raise InputError(problem, mend) from None


def _libatomic() -> bytes:
    """A shared library for Linux on x86-64 with one function.

    System V Application Binary Interface, chapters 4 and 5; its versions of symbols: Linux Standard
    Base Core 5.0, chapter 10.
    """
    page, header, linker, rest = 4096, 64, 64 + 4 * 56, 64 + 4 * 56 + 10 * 16
    names = f"\0{LIBATOMIC}\0LIBATOMIC_1.0\0__atomic_compare_exchange_16\0".encode()
    library, version, function = (names.index(name) for name in (b"lib", b"LIB", b"__"))
    symbol = struct.pack("<I2BH2Q", function, 0x12, 0, 1, page, len(_COMPARE_EXCHANGE))
    # by the dynamic linker's tag: names, symbols (the first is none), their hashes and versions
    tables = {
        5: names,
        6: bytes(24) + symbol,
        4: struct.pack("<5I", 1, 2, 1, 0, 0),
        0x6FFFFFF0: struct.pack("<2H", 0, 2),
        0x6FFFFFFC: struct.pack("<4H5I", 1, 0, 2, 1, 0x10F4B60, 20, 0, version, 0),
    }
    # the library's name, sizes of names and of a symbol, number of versions
    tags, body = [14, library, 10, len(names), 11, 24, 0x6FFFFFFD, 1], b""
    for tag, table in tables.items():
        tags += [tag, rest + len(body)]
        body += table + bytes(-len(table) % 8)
    file = struct.pack(
        "<16s2HI3QI6H", b"\x7fELF\2\1\1", 3, 62, 1, 0, header, 0, 0, header, 56, 4, 0, 0, 0
    )
    # tables, code, tables for the linker, and a stack that nothing is executed on
    for kind, rights, start, size, align in (
        (1, 6, 0, rest + len(body), page),
        (1, 5, page, len(_COMPARE_EXCHANGE), page),
        (2, 6, linker, rest - linker, 8),
        (0x6474E551, 6, 0, 0, 16),
    ):
        file += struct.pack("<2I6Q", kind, rights, start, start, start, size, size, align)
    file += struct.pack("<20Q", *tags, 0, 0) + body
    return file.ljust(page, b"\0") + _COMPARE_EXCHANGE


@functools.cache
def selected_llvm() -> LlvmLibrary:
    """The library that Dr.Jit uses, or will use when it is imported.

    The user's ``DRJIT_LIBLLVM_PATH`` is respected; else the library of the installed wheel is
    taken, else the newest one of the system, and this variable names it from then on.

    Raises InputError if the user's choice is missing, not a library or too old, if no usable
    library is found, if the system has no libatomic and takes none, or if Dr.Jit was imported first
    and has loaded one that is too old.
    """
    if "drjit" in sys.modules:
        # what Dr.Jit has opened, where the system lists it (Linux); else what it was told to
        maps = Path("/proc/self/maps")
        lines = maps.read_text().splitlines() if maps.exists() else []
        paths = sorted({line.split()[-1] for line in lines if "libLLVM" in line})
        opened = paths[0] if paths else os.environ.get(ENVIRONMENT_VARIABLE, "")
        library = _usable(Path(opened), "already loaded") if opened else None
        if library is None:
            raise InputError(
                f"Dr.Jit was imported first and was given {opened or 'no LLVM'}, which is too old "
                "or cannot be loaded",
                "call mcrim_mitsuba.use_variant() before mitsuba and drjit are imported",
            )
        return library
    if sys.platform == "linux":
        _provide_libatomic()
    chosen = os.environ.get(ENVIRONMENT_VARIABLE)
    if chosen:
        return _checked(chosen, "environment")
    places = ("wheel", _in_wheels), ("system", _in_system)
    usable = (_usable(path, origin) for origin, there in places for path in there())
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


def _checked(path: str | Path, origin: str) -> LlvmLibrary:
    """The library in a file; raises InputError if it is none, or too old."""
    place = f"{ENVIRONMENT_VARIABLE}={path}"
    if not Path(path).is_file():
        raise InputError("there is no such file", _MEND, path=place)
    try:
        version = llvm_version(path)
    except OSError as error:
        # the loader names the file, and what that needs and has not
        problem = f"this is not a shared library that can be loaded ({error})"
        raise InputError(problem, _MEND, path=place) from None
    if version is None or version[0] < OLDEST_LLVM:
        name = "older than 16" if version is None else ".".join(map(str, version))
        what = f"this LLVM ({name}) is too old: Dr.Jit's first kernel would abort the process"
        raise InputError(what, _MEND, path=place)
    return LlvmLibrary(str(path), version, origin)


def _usable(path: Path, origin: str) -> LlvmLibrary | None:
    """`_checked` library, or none."""
    with contextlib.suppress(InputError):
        return _checked(path, origin)
    return None


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


# Variants.

#: Oldest CUDA that Dr.Jit 1.5 takes; NVIDIA's drivers know it from version 535 on.
OLDEST_CUDA = (12, 2)


@signals_wait()
def cuda_versions() -> dict[str, str]:
    """The driver's CUDA and the GPU's compute capability; InputError if there is no such GPU."""
    with contextlib.suppress(InputError):
        selected_llvm()  # Dr.Jit loads one when it is imported, for later variants too
    import drjit as dr

    version = dr.detail.cuda_version()
    try:
        capability = dr.detail.cuda_compute_capability()
    except RuntimeError as error:
        problem = f"a cuda variant cannot start here: {_reason(str(error), version)}"
        mend = "use --variant llvm_ad_rgb, which needs only the processor"
        raise InputError(problem, mend) from None
    return {
        "cuda": ".".join(map(str, version)),
        "compute_capability": f"{capability // 10}.{capability % 10}",
    }


def _reason(complaint: str, version: tuple[int, int]) -> str:
    """Why there is no GPU, from Dr.Jit's complaint and the driver's CUDA, (0, 0) if unknown."""
    if (0, 0) < version < OLDEST_CUDA:
        oldest, driver = (".".join(map(str, numbers)) for numbers in (OLDEST_CUDA, version))
        return f"the NVIDIA driver is too old (CUDA {driver}; Dr.Jit needs {oldest}, driver 535)"
    if "cuInit() failed" in complaint:
        return f"no NVIDIA GPU can be used (the CUDA driver says {complaint.splitlines()[-1]})"
    if "hasn't been initialized" in complaint:
        return "no NVIDIA GPU was found (there is no CUDA driver)"
    if "is inactive" in complaint:
        return "no NVIDIA GPU was found (the CUDA driver sees none)"
    return complaint.splitlines()[0]


#: Variants whose transport is tested here; `cuda_ad_rgb` needs an NVIDIA GPU.
SUPPORTED_VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_mono_polarized", "cuda_ad_rgb")


@signals_wait()
def use_variant(name: str = DEFAULT_VARIANT, threads: int | None = None) -> Any:
    """Activate a variant of Mitsuba with the plugins of the scenes, and return ``mitsuba``.

    Every simulation comes by here, and who uses Mitsuba's own functions with these scenes calls it
    once (docs/mitsuba.md). Nothing else changes what is outside of this package:

    - where Dr.Jit is not imported yet, ``DRJIT_LIBLLVM_PATH`` names the LLVM that it is to load;
    - the plugins are in this variant and in every other that Mitsuba switches to from then on;
    - Dr.Jit's pool has so many threads, by default one for every processor.

    Raises InputError if the variant is none of `SUPPORTED_VARIANTS`, not built into the installed
    Mitsuba, has no usable LLVM or NVIDIA GPU, or `threads` is not positive.
    """
    refuse_unusable(name)
    if threads is not None and threads < 1:
        raise InputError(f"--threads is {threads}", "give a number of at least 1")
    import drjit as dr
    import mitsuba as mi

    if name not in mi.variants():
        mend = f"use one of {', '.join(v for v in SUPPORTED_VARIANTS if v in mi.variants())}"
        raise InputError(f"the installed Mitsuba {mi.__version__} has no variant {name!r}", mend)
    _follow_switches()
    if mi.variant() != name:
        try:
            mi.set_variant(name)
        except ImportError as error:
            problem = f"the variant {name!r} cannot start here ({str(error).splitlines()[0]})"
            mend = f"use {DEFAULT_VARIANT}, which needs only the processor"
            raise InputError(problem, mend) from None
    wanted = threads or processors()
    if dr.thread_count() != wanted:
        dr.set_thread_count(wanted)
    return mi


@functools.cache
def _follow_switches() -> None:
    """Have the plugins in the active variant, and from now on in every one Mitsuba switches to."""
    import mitsuba as mi

    _on_variant_change(None, mi.variant())
    mi.detail.add_variant_callback(_on_variant_change)


def _on_variant_change(_old: str | None, new: str | None) -> None:
    """Refuse an LLVM that is too old, and define the plugins on the new variant's base classes.

    Python classes belong to one variant: a class that was defined before a switch is of the wrong
    type after it. So modules are executed anew, as Mitsuba does with its own integrators.
    """
    if new is None or new.startswith("scalar"):
        return
    if new.startswith("llvm"):
        selected_llvm()
    for name in ("shapes", "solids", "wrapping", "bsdfs", "light"):
        module = f"{plugins.__name__}.{name}"
        if module in sys.modules:
            importlib.reload(sys.modules[module])
        else:
            importlib.import_module(module)


def refuse_unusable(name: str) -> None:
    """Refuse a variant that is not supported, or has no usable LLVM or GPU, beforehand."""
    if name not in SUPPORTED_VARIANTS:
        mend = did_you_mean(name, SUPPORTED_VARIANTS)
        if name.startswith("scalar"):
            mend = f"vectors of photons are followed: use one of {', '.join(SUPPORTED_VARIANTS)}"
        raise InputError(f"the variant {name!r} is not supported", mend)
    if name.startswith("llvm"):
        selected_llvm()
    else:
        cuda_versions()


def software_versions(variant: str) -> dict[str, str]:
    """Versions of packages, and of LLVM or the GPU, for results; InputError if there is none."""
    if variant.startswith("llvm"):
        return _package_versions() | {"llvm": ".".join(map(str, selected_llvm().version))}
    return _package_versions() | cuda_versions()


@functools.cache
def _package_versions() -> dict[str, str]:
    """Read once: it takes as long as a small simulation."""
    names = ("mcrim-mitsuba", "mitsuba", "drjit", "numpy")
    return {name: importlib.metadata.version(name) for name in names}


def versions(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions of everything that a result depends on; `threads` are Dr.Jit's unless given."""
    drjit = sys.modules.get("drjit")
    return software_versions(variant) | {
        "python": platform.python_version(),
        "variant": variant,
        "threads": str(threads or (drjit.thread_count() if drjit else processors())),
        "platform": f"Python {platform.python_version()} on {platform.system()} "
        f"{platform.release()}, {platform.machine()}",
    }


def describe_installation(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions, LLVM, variants, threads, once a kernel ran; InputError if it cannot, or errs."""
    mi = use_variant(variant, threads)
    import drjit as dr

    total = float(dr.sum(dr.maximum(dr.arange(mi.Float, 1000), 499.5))[0])
    if total != 624_500.0:
        problem = f"{variant} computes wrongly (a sum is {total}, not 624500)"
        raise InputError(problem, "reinstall Dr.Jit")
    installation = versions(variant)
    if variant.startswith("llvm"):
        llvm = selected_llvm()
        installation["llvm library"] = f"{llvm.path} (chosen by: {llvm.origin})"
    installation["variants"] = ", ".join(v for v in SUPPORTED_VARIANTS if v in mi.variants())
    return installation
