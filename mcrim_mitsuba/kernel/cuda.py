"""The NVIDIA GPU that a `cuda` variant needs: what it is, or in words why there is none."""

from __future__ import annotations

from mcrim_mitsuba.errors import InputError

#: Oldest CUDA that Dr.Jit 1.5 takes; NVIDIA's drivers know it from version 535 on.
OLDEST_CUDA = (12, 2)


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
        raise InputError(
            f"a cuda variant cannot start here: {_reason(str(error), version)}",
            "use --variant llvm_ad_rgb, which needs only the processor",
        ) from None
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
