"""Some launches of a run of photon records, gathered in cells: a unit of tables and campaigns."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.fit.cells import CellSums
from mcrim_mitsuba.fit.proposals import Proposals
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.fit.reweighting import largest_coefficient
from mcrim_mitsuba.work.loaded import loaded_simulation
from mcrim_mitsuba.work.portable_scene import PortableScene
from mcrim_mitsuba.work.unit import Content, number_of


@dataclass(frozen=True)
class RecordBlock:
    """Launches that follow each other.

    Attributes
    ----------
    what : str
    scene : SceneFile or PortableScene
    proposals : Proposals
    seed : int
    variant : str
    first : int
        Number of the first launch in the run.
    launches : tuple of int
        Photons of each.
    checked : bool
        Whether the scene is known to be sound, or need not be.
    """

    what: str
    scene: SceneFile | PortableScene
    proposals: Proposals
    seed: int
    variant: str
    first: int
    launches: tuple[int, ...]
    checked: bool

    @property
    def photons(self) -> int:
        return sum(self.launches)

    @property
    def numbers(self) -> tuple[int, ...]:
        return (number_of(self.first, self.launches),)

    def check(self, threads: int | None) -> None:
        if not self.checked:
            loaded_simulation(self.scene, self.variant, threads, check=True)

    def portable(self) -> RecordBlock:
        assert isinstance(self.scene, SceneFile)
        return replace(self, scene=PortableScene.of(self.scene))

    def make(self, threads: int | None) -> dict[int, Content]:
        """Simulate; one thread gathers a launch's records while the next one is under way."""
        from mcrim_mitsuba.kernel.records import Recorder

        recorder = Recorder(loaded_simulation(self.scene, self.variant, threads))
        gathered: CellSums | None = None

        def gather(records: PhotonRecords) -> None:
            nonlocal gathered
            if gathered is None:
                gathered = CellSums(records, largest_coefficient(records))
            else:
                gathered.add(records)

        with ThreadPoolExecutor(1) as gatherer:
            pending: Future[None] | None = None
            for number, photons in enumerate(self.launches, self.first):
                records = recorder.record(self.proposals, photons, seed=self.seed, number=number)
                if pending is not None:
                    pending.result()
                pending = gatherer.submit(gather, records)
            if pending is not None:
                pending.result()
        assert gathered is not None
        return {self.numbers[0]: gathered.to_arrays()}
