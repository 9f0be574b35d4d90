"""Units that simulate a scene: how it is sent to another machine, loaded, and its launches cut."""

from __future__ import annotations

import functools
import re
import tempfile
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from lxml import etree

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.runs.executors import number_of
from mcrim_mitsuba.scene.scene_file import SceneFile, ScenePlan, read_scene
from mcrim_mitsuba.transport.launch_plan import FIRST_LAUNCH
from mcrim_mitsuba.transport.variants import use_variant

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.simulation import Simulation

# A scene as it is sent to another machine: put together, with the files that it names.

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
    files: tuple[tuple[str, bytes], ...] = field(repr=False)

    @classmethod
    def of(cls, scene: SceneFile) -> PortableScene:
        """Of a scene, with the contents that its files have now."""
        home, files = scene.path.parent, dict[str, bytes]()
        for file in (file for _, named in scene.naming() for file in named):
            place = file.relative_to(home).as_posix() if file.is_relative_to(home) else ""
            if _HARMLESS.fullmatch(place) and ".." not in place.split("/"):
                files[place] = file.read_bytes()
        text = etree.tostring(scene.root, encoding="utf-8")
        return cls(str(scene.path), scene.content_hash, text, tuple(files.items()))


@functools.lru_cache(maxsize=4)
def unpacked(sent: PortableScene) -> SceneFile:
    """A scene that was sent, written into a folder of this process and read again.

    Raises InputError if a file that it names is another one here.
    """
    folder = Path(_scratch().name) / sent.content_hash
    for place, content in (("scene.xml", sent.text), *sent.files):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_bytes(content)
    scene = read_scene(folder / "scene.xml")
    if scene.content_hash != sent.content_hash:
        raise InputError(
            "a worker of the cluster does not see the same files as are named there",
            "name meshes and spectra relative to the scene, below its folder, or share the folder "
            "with all workers",
            path=sent.path,
        )
    return scene


@functools.cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes when this process does."""
    return tempfile.TemporaryDirectory(prefix="mcrim-scenes-")


# Scenes that are loaded: units that follow each other are often of one.

#: Loaded scenes are held by Mitsuba too, and take memory.
_MOST = 2
_loaded: OrderedDict[tuple[str, bytes | str, str], Simulation] = OrderedDict()


def remember(simulation: Simulation) -> None:
    """Let units of a scene that somebody has loaded be made with it."""
    file = simulation.file
    _keep((str(file.path), file.text_or_hash, simulation.variant), simulation)


def _keep(key: tuple[str, bytes | str, str], simulation: Simulation) -> Simulation:
    while len(_loaded) >= _MOST:
        _loaded.popitem(last=False)
    _loaded[key] = simulation
    return simulation


@dataclass(frozen=True)
class SceneUnit:
    """What all units have in common that simulate a scene; see `runs.executors.WorkItem`."""

    what: str
    scene: SceneFile | ScenePlan | PortableScene
    seed: int
    variant: str
    #: Whether the scene is known to be sound, or need not be.
    checked: bool

    @property
    def modules(self) -> set[str]:
        """See `runs.executors.WorkItem`."""
        return {type(self).__module__}

    def loaded(self, threads: int | None, *, check: bool = False) -> Simulation:
        """The scene, loaded into Mitsuba, as it is on the disk now; `check` that it is sound.

        Raises InputError as `transport.simulation.Simulation`.
        """
        from mcrim_mitsuba.transport.simulation import Simulation

        of = self.scene
        told_by = of.content_hash if isinstance(of, PortableScene) else self.own_scene.text_or_hash
        key = str(of.path), told_by, self.variant
        if key in _loaded and not check:
            _loaded.move_to_end(key)
            use_variant(self.variant, threads)
            return _loaded[key]
        file = unpacked(of) if isinstance(of, PortableScene) else self.own_scene
        return _keep(key, Simulation(file, variant=self.variant, threads=threads, check=check))

    @property
    def own_scene(self) -> SceneFile:
        """The scene, of a unit that is not portable."""
        assert not isinstance(self.scene, PortableScene)
        return self.scene.file if isinstance(self.scene, ScenePlan) else self.scene

    def check(self, threads: int | None) -> None:
        """Refuse a scene that is not sound, by an InputError."""
        if not self.checked:
            self.loaded(threads, check=True)

    def portable(self) -> Self:
        """This unit without a need of files on this machine."""
        return replace(self, scene=PortableScene.of(self.own_scene))


@dataclass(frozen=True)
class LaunchBlock(SceneUnit):
    """Launches that follow each other, as a unit with one chunk."""

    #: Number of the first one in the run.
    first: int
    #: Photons of each.
    launches: tuple[int, ...]

    @property
    def photons(self) -> int:
        """Of all launches."""
        return sum(self.launches)

    @property
    def numbers(self) -> tuple[int]:
        """Of the chunk, in the cache of its run."""
        return (number_of(self.first, self.launches),)


#: Launches of a unit, a few seconds of work.
SHORT = 4
#: Units after which larger ones follow, so that long runs leave few files.
SHORT_BLOCKS = 16
#: Launches of these.
LONG = 32


def blocks(launches: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Launches that follow each other, cut into units.

    Longer runs begin with the same units.
    """
    start = 0
    while start < len(launches):
        size = SHORT if start < SHORT * SHORT_BLOCKS else LONG
        yield tuple(launches[start : start + size])
        start += size


def planned(photons: int, begun: int, size: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Units of a run's next launches: the number of each one's first launch, and their photons.

    `photons` are to be followed after the launches that the run has `begun`; all have `size` of
    them but the run's very first one.
    """
    launches: list[int] = []
    while photons > 0:
        launches.append(min(size if begun or launches else FIRST_LAUNCH, photons))
        photons -= launches[-1]
    for block in blocks(launches):
        yield begun, block
        begun += len(block)
