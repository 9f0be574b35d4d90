"""Scenes that are loaded: units that follow each other are often of one."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.work.portable_scene import PortableScene

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.simulation import Simulation

#: Loaded scenes are held by Mitsuba too, and take memory.
_MOST = 2
_loaded: OrderedDict[tuple[str, str, str], Simulation] = OrderedDict()


def loaded_simulation(
    scene: SceneFile | PortableScene,
    variant: str,
    threads: int | None,
    *,
    check: bool = False,
) -> Simulation:
    """The scene, loaded into Mitsuba, as it is on the disk now.

    Parameters
    ----------
    scene : SceneFile or PortableScene
    variant : str
    threads : int or None
        All when None.
    check : bool
        Refuse a scene that is not sound.

    Raises
    ------
    InputError
        As `kernel.simulation.Simulation`.
    """
    from mcrim_mitsuba.kernel.simulation import Simulation
    from mcrim_mitsuba.kernel.variants import use_variant

    key = str(scene.path), scene.content_hash, variant
    if key in _loaded and not check:
        _loaded.move_to_end(key)
        use_variant(variant, threads)
        return _loaded[key]
    file = scene.unpacked() if isinstance(scene, PortableScene) else scene
    return _keep(key, Simulation(file, variant=variant, threads=threads, check=check))


def remember(simulation: Simulation) -> None:
    """Let units of a scene that somebody has loaded be made with it."""
    file = simulation.file
    _keep((str(file.path), file.content_hash, simulation.variant), simulation)


def _keep(key: tuple[str, str, str], simulation: Simulation) -> Simulation:
    while len(_loaded) >= _MOST:
        _loaded.popitem(last=False)
    _loaded[key] = simulation
    return simulation
