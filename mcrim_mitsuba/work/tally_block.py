"""Some launches of a simulation, tallied by the photons' fates: a unit of `simulate`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.work.loaded import loaded_simulation
from mcrim_mitsuba.work.portable_scene import PortableScene
from mcrim_mitsuba.work.unit import Content, number_of

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.tally import FateTally


@dataclass(frozen=True)
class TallyBlock:
    """Launches that follow each other, of a scene that is known to be sound.

    Attributes
    ----------
    what : str
    scene : SceneFile or PortableScene
    seed : int
    variant : str
    max_depth : int
        Free flights after which a photon is given up.
    first : int
        Number of the first launch in the run.
    launches : tuple of int
        Photons of each.
    """

    what: str
    scene: SceneFile | PortableScene
    seed: int
    variant: str
    max_depth: int
    first: int
    launches: tuple[int, ...]

    @property
    def photons(self) -> int:
        return sum(self.launches)

    @property
    def numbers(self) -> tuple[int, ...]:
        return (number_of(self.first, self.launches),)

    def check(self, threads: int | None) -> None:
        """Nothing: whoever makes such blocks has checked the scene."""

    def portable(self) -> TallyBlock:
        assert isinstance(self.scene, SceneFile)
        return replace(self, scene=PortableScene.of(self.scene))

    def make(self, threads: int | None) -> dict[int, Content]:
        from mcrim_mitsuba.kernel import transport
        from mcrim_mitsuba.kernel.collection import choose_path, refuse_leaks
        from mcrim_mitsuba.kernel.lane_plan import plan_lanes
        from mcrim_mitsuba.kernel.tally import FateTally

        simulation = loaded_simulation(self.scene, self.variant, threads)
        path = choose_path(simulation.model, simulation.polarization)
        start, tally = time.perf_counter(), FateTally()
        for number, photons in enumerate(self.launches, self.first):
            found = transport.launch(
                path, simulation.crystal, plan_lanes(photons), seed=self.seed, number=number,
                max_depth=self.max_depth,
            )  # fmt: skip
            tally.add(found.photons_per_batch, found.weights)
            refuse_leaks(tally)
        data = {
            "photons": tally.photons, "batches": tally.batches, "sums": tally.sums,
            "squares": tally.squares, "seconds": time.perf_counter() - start, "path": path.name,
        }  # fmt: skip
        return {self.numbers[0]: ({}, data)}


def tally_of(metadata: Mapping[str, Any]) -> FateTally:
    """The tally that a block made."""
    from mcrim_mitsuba.kernel.tally import FateTally

    return FateTally(
        metadata["photons"], metadata["batches"], dict(metadata["sums"]), dict(metadata["squares"])
    )
