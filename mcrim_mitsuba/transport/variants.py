"""Mitsuba's variants: switched to with our plugins in them, or refused; and what is installed."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.metadata
import os
import platform
import sys
from typing import Any

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, signals_wait
from mcrim_mitsuba.transport import plugins
from mcrim_mitsuba.transport.llvm import selected_llvm

#: Oldest CUDA that Dr.Jit 1.5 takes; NVIDIA's drivers know it from version 535 on.
OLDEST_CUDA = (12, 2)


@signals_wait()
def cuda_versions() -> dict[str, str]:
    """The driver's CUDA and the GPU's compute capability, which decide how kernels are compiled.

    Raises
    ------
    InputError
        If there is no NVIDIA GPU that Dr.Jit can use.
    """
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
    - Dr.Jit's pool has so many threads.

    Parameters
    ----------
    name : str
        One of `SUPPORTED_VARIANTS`.
    threads : int, optional
        Processor threads; all processors when not given.

    Raises
    ------
    InputError
        If the variant is not supported, not built into the installed Mitsuba,
        has no usable LLVM or NVIDIA GPU, or `threads` is not positive.
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
    wanted = threads or os.cpu_count() or 1
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
    for name in ("shapes", "solids", "bsdfs", "light"):
        module = f"{plugins.__name__}.{name}"
        if module in sys.modules:
            importlib.reload(sys.modules[module])
        else:
            importlib.import_module(module)


def refuse_unusable(name: str) -> None:
    """Refuse a variant that cannot be used here, before anything is begun with it.

    Raises
    ------
    InputError
        If the variant is not supported, or has no usable LLVM or NVIDIA GPU.
    """
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
    """Versions of the packages, and of the variant's LLVM or GPU, that results depend on.

    Raises
    ------
    InputError
        If the variant needs LLVM or an NVIDIA GPU and there is none.
    """
    if variant.startswith("llvm"):
        return _package_versions() | {"llvm": ".".join(map(str, selected_llvm().version))}
    return _package_versions() | cuda_versions()


@functools.cache
def _package_versions() -> dict[str, str]:
    """Read once: it takes as long as a small simulation."""
    names = ("mcrim-mitsuba", "mitsuba", "drjit", "numpy")
    return {name: importlib.metadata.version(name) for name in names}


def versions(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions of everything that a result depends on.

    `threads` are those that were asked for; those that Dr.Jit has when not given.
    """
    drjit = sys.modules.get("drjit")
    return software_versions(variant) | {
        "python": platform.python_version(),
        "variant": variant,
        "threads": str(threads or (drjit.thread_count() if drjit else os.cpu_count()) or 1),
        "platform": f"Python {platform.python_version()} on {platform.system()} "
        f"{platform.release()}, {platform.machine()}",
    }


def describe_installation(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions, LLVM library, variants and threads, after compiling and running a kernel.

    Raises
    ------
    InputError
        If the variant cannot be used here, or its arithmetic is wrong.
    """
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
