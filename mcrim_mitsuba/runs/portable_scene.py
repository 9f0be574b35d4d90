"""A scene as it is sent to another machine: put together, with the files that it names."""

from __future__ import annotations

import functools
import re
import tempfile
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lxml import etree

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation


#: A name that cannot lead out of the folder that it is written to.
_HARMLESS = re.compile(r"[\w. +=,()-]+(/[\w. +=,()-]+)*")


@dataclass(frozen=True)
class PortableScene:
    """One XML text without parameters or includes, and the contents of what it names."""

    #: Where the scene lies at its owner's, for words.
    path: str
    #: Of the `SceneFile`.
    content_hash: str
    #: All parameters and includes put in.
    text: bytes = field(repr=False)
    #: Meshes and spectra, by the place below the scene's folder where they are looked for.
    #: What is named by a place elsewhere must lie there on the other machine too.
    files: dict[str, bytes] = field(repr=False)

    @classmethod
    def of(cls, scene: SceneFile) -> PortableScene:
        """Of a scene, with the contents that its files have now."""
        home, files = scene.path.parent, {}
        folders = ["", *(element.get("value", "") for element in scene.root.iter("path"))]
        for element in scene.root.iter("string"):
            if element.get("name") != "filename":
                continue
            for folder in folders:
                place = "/".join(part for part in (folder, element.get("value", "")) if part)
                steps = place.split("/")
                if _HARMLESS.fullmatch(place) and ".." not in steps and (home / place).is_file():
                    files[place] = (home / place).read_bytes()
        text = etree.tostring(scene.root, encoding="utf-8")
        return cls(str(scene.path), scene.content_hash, text, files)

    def unpacked(self) -> SceneFile:
        """The scene, in a temporary folder of this machine.

        Raises
        ------
        InputError
            If a file that it names is another one here.
        """
        return _unpacked(self.path, self.content_hash, self.text, tuple(self.files.items()))


@functools.lru_cache(maxsize=4)
def _unpacked(
    owners_path: str, content_hash: str, text: bytes, files: tuple[tuple[str, bytes], ...]
) -> SceneFile:
    folder = Path(_scratch().name) / content_hash
    for place, content in files:
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_bytes(content)
    folder.mkdir(exist_ok=True)
    path = folder / "scene.xml"
    path.write_bytes(text)
    scene = read_scene(path)
    if scene.content_hash != content_hash:
        raise InputError(
            "a worker of the cluster does not see the same files as are named there",
            "name meshes and spectra relative to the scene, below its folder, or share the folder "
            "with all workers", path=owners_path,
        )  # fmt: skip
    return scene


@functools.cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes when this process does."""
    return tempfile.TemporaryDirectory(prefix="mcrim-scenes-")


# Scenes that are loaded: units that follow each other are often of one.

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
        As `transport.simulation.Simulation`.
    """
    from mcrim_mitsuba.transport.simulation import Simulation
    from mcrim_mitsuba.transport.variants import use_variant

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
