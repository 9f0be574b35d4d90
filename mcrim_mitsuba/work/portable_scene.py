"""A scene as it is sent to another machine: put together, with the files that it names."""

from __future__ import annotations

import functools
import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from lxml import etree

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene

#: A name that cannot lead out of the folder that it is written to.
_HARMLESS = re.compile(r"[\w. +=,()-]+(/[\w. +=,()-]+)*")


@dataclass(frozen=True)
class PortableScene:
    """One XML text without parameters or includes, and the contents of what it names.

    Attributes
    ----------
    path : str
        Where the scene lies at its owner's, for words.
    content_hash : str
        Of the `SceneFile`.
    text : bytes
        All parameters and includes put in.
    files : dict of str to bytes
        Meshes and spectra, by the place below the scene's folder where they are looked for.
        What is named by a place elsewhere must lie there on the other machine too.
    """

    path: str
    content_hash: str
    text: bytes = field(repr=False)
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
