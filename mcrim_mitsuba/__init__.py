"""MCRIM on Mitsuba 3: light collection efficiency and absolute light yield of scintillators.

    import mcrim_mitsuba as mcrim

    light = mcrim.simulate("scenes/camoo4.xml", n_gap=1.46, photons=2_000_000, seed=1)
    fit = mcrim.calibrate("scenes/camoo4_campaign.toml")

The public names are loaded when they are used; everything else lies in rooms, of which each
imports only from those nearer the ground (docs/architecture.md). Importing changes nothing outside
of this package; who uses Mitsuba's own functions with these scenes calls ``mcrim.use_variant()``
first (docs/mitsuba.md).
"""

import importlib
from typing import TYPE_CHECKING, Any

#: Where the public names are defined.
_HOMES = {
    "output.public": (
        *"add arrival_times budget calibrate check compare crosscheck diagnose eta_map".split(),
        *"eta_spectrum plan reduce render repair report simulate table".split(),
    ),
    "campaign.campaign": ("Campaign", "read_campaign"),
    "core.errors": ("InputError",),
    "core.run": ("Run",),
    "output.registry": ("Result",),
    "scene.scene_file": ("SceneFile", "read_scene"),
    "transport.variants": ("use_variant",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)

if TYPE_CHECKING:  # the same for type checkers and editors
    from mcrim_mitsuba.campaign.campaign import Campaign as Campaign
    from mcrim_mitsuba.campaign.campaign import read_campaign as read_campaign
    from mcrim_mitsuba.core.errors import InputError as InputError
    from mcrim_mitsuba.core.run import Run as Run
    from mcrim_mitsuba.output.public import *  # noqa: F403
    from mcrim_mitsuba.output.registry import Result as Result
    from mcrim_mitsuba.scene.scene_file import SceneFile as SceneFile
    from mcrim_mitsuba.scene.scene_file import read_scene as read_scene
    from mcrim_mitsuba.transport.variants import use_variant as use_variant

    __version__: str

else:

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version

            return version("mcrim-mitsuba")
        if name not in _HOME_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
