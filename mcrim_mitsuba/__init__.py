"""MCRIM on Mitsuba 3: light collection efficiency and absolute light yield of scintillators.

    import mcrim_mitsuba as mcrim

    light = mcrim.simulate("scenes/camoo4.xml", n_gap=1.46, photons=2_000_000, seed=1)
    fit = mcrim.calibrate("scenes/camoo4_campaign.toml")

The public names are loaded when they are used; everything else lies in rooms, of which each
imports only from those nearer the ground (docs/architecture.md). Where Mitsuba is used besides, its
variants have the plugins of the scenes from then on (docs/mitsuba.md).
"""

import importlib
import sys
from typing import Any

#: Where the public names are defined.
_HOMES = {
    "output.public": (
        "Answer",
        "add",
        "arrival_times",
        "budget",
        "calibrate",
        "check",
        "compare",
        "crosscheck",
        "diagnose",
        "eta_map",
        "eta_spectrum",
        "plan",
        "reduce",
        "render",
        "repair",
        "report",
        "simulate",
        "table",
    ),
    "campaign.campaign": ("Campaign", "read_campaign"),
    "core.errors": ("InputError",),
    "core.run": ("Run",),
    "scene.scene_file": ("SceneFile", "read_scene"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)


class _BesideMitsuba:
    """Looks on what is imported: Dr.Jit, which opens an LLVM library at once, and variants."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        if name == "drjit":
            from mcrim_mitsuba.transport.llvm import claim_llvm

            claim_llvm()
        elif name.startswith(("mitsuba.llvm_", "mitsuba.cuda_")):
            _register()


def _register() -> None:
    """Have this package's plugins in every variant of Mitsuba, the active one included."""
    from mcrim_mitsuba.transport.variants import join_mitsuba

    join_mitsuba()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("mcrim-mitsuba")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


sys.meta_path.insert(0, _BesideMitsuba)
if "mitsuba" in sys.modules:
    _register()
