"""Mitsuba's variants: switched to with our plugins in them, or refused; and what is installed."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import os
import platform
import sys
from typing import Any

from mcrim_mitsuba.core.errors import InputError, did_you_mean
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, signals_wait
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
        oldest, found = (".".join(map(str, each)) for each in (OLDEST_CUDA, version))
        return f"the NVIDIA driver is too old (CUDA {found}; Dr.Jit needs {oldest}, driver 535)"
    if "cuInit() failed" in complaint:
        return f"no NVIDIA GPU can be used (the CUDA driver says {complaint.splitlines()[-1]})"
    if "hasn't been initialized" in complaint:
        return "no NVIDIA GPU was found (there is no CUDA driver)"
    if "is inactive" in complaint:
        return "no NVIDIA GPU was found (the CUDA driver sees none)"
    return complaint.splitlines()[0]


#: Variants whose transport is tested here; `cuda_ad_rgb` needs an NVIDIA GPU.
SUPPORTED_VARIANTS = ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_mono_polarized", "cuda_ad_rgb")

#: So far: whether Mitsuba tells of switches, the threads, the variant that plugins belong to.
_state: dict[str, Any] = {"callback": False, "threads": None, "plugins": None}


@signals_wait()
def use_variant(name: str = DEFAULT_VARIANT, threads: int | None = None):
    """Activate a Mitsuba variant, with the package's plugins, and return ``mitsuba``.

    `name` is one of `SUPPORTED_VARIANTS`; `threads` is the size of Dr.Jit's thread pool, all
    processors when not given.

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
    join_mitsuba()
    if mi.variant() != name:
        try:
            mi.set_variant(name)
        except ImportError as error:
            problem = f"the variant {name!r} cannot start here ({str(error).splitlines()[0]})"
            mend = f"use {DEFAULT_VARIANT}, which needs only the processor"
            raise InputError(problem, mend) from None
    # The callback is not called for a variant that was already active.
    if _state["plugins"] != name:
        register_plugins(name)
    wanted = threads or os.cpu_count() or 1
    if _state["threads"] != wanted:
        dr.set_thread_count(wanted)
        _state["threads"] = wanted
    return mi


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
    found = _package_versions()
    if variant.startswith("llvm"):
        return found | {"llvm": ".".join(map(str, selected_llvm().version))}
    return found | cuda_versions()


@functools.cache
def _package_versions() -> dict[str, str]:
    """Read once: it takes as long as a small simulation."""
    names = ("mcrim-mitsuba", "mitsuba", "drjit", "numpy")
    return {name: importlib.metadata.version(name) for name in names}


def register_plugins(variant: str) -> None:
    """(Re)define the plugin classes on the base classes of the active variant.

    Mitsuba's Python base classes belong to one variant, so a class defined
    before a switch is of the wrong type after it.
    """
    before = set(sys.modules)
    from mcrim_mitsuba.transport.plugins import bsdfs, forms, light, shapes

    for module in (shapes, forms, bsdfs, light):
        if module.__name__ in before:
            importlib.reload(module)
    _state["plugins"] = variant


def join_mitsuba() -> None:
    """Have the plugins in the active variant of Mitsuba, and in every one it switches to.

    Raises
    ------
    InputError
        If the active variant computes with an LLVM that is too old.
    """
    import mitsuba as mi

    if _state["callback"]:
        return
    mi.detail.add_variant_callback(_on_variant_change)
    _state["callback"] = True
    _on_variant_change(None, mi.variant())


def _on_variant_change(_old: str | None, new: str | None) -> None:
    if new is None or new.startswith("scalar"):
        return
    if new.startswith("llvm"):
        selected_llvm()
    register_plugins(new)


def versions(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions of everything that a result depends on.

    `threads` are those that were asked for; those that Dr.Jit has when not given.
    """
    return software_versions(variant) | {
        "python": platform.python_version(),
        "variant": variant,
        "threads": str(threads or _state["threads"] or os.cpu_count() or 1),
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
    found = versions(variant)
    if variant.startswith("llvm"):
        llvm = selected_llvm()
        found["llvm library"] = f"{llvm.path} (chosen by: {llvm.origin})"
    found["variants"] = ", ".join(v for v in SUPPORTED_VARIANTS if v in mi.variants())
    return found
