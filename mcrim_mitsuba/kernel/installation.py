"""What is installed, and whether it works."""

from __future__ import annotations

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.llvm import selected_llvm
from mcrim_mitsuba.kernel.simulation import versions
from mcrim_mitsuba.kernel.variants import SUPPORTED_VARIANTS, use_variant


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
        raise InputError(
            f"{variant} computes wrongly (a sum is {total}, not 624500)", "reinstall Dr.Jit"
        )
    found = versions(variant)
    if variant.startswith("llvm"):
        llvm = selected_llvm()
        found["llvm library"] = f"{llvm.path} (chosen by: {llvm.origin})"
    found["variants"] = ", ".join(v for v in SUPPORTED_VARIANTS if v in mi.variants())
    return found
