"""One simulation with the tables of eta that are made of its photons: a unit of diagnoses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.eta_table import EtaTable, Gathering, Grid
from mcrim_mitsuba.fit.proposals import Proposals
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.work.loaded import loaded_simulation
from mcrim_mitsuba.work.portable_scene import PortableScene
from mcrim_mitsuba.work.unit import Content

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.simulation import Simulation

MASK = "mask_radius_mm"
#: What a chunk holds, flattened.
_COLUMNS = ("log_eta", "deviations")
#: Tables that are made at once.
_AT_ONCE = 2

Weight = Callable[
    [Mapping[str, NDArray], Mapping[str, float], Mapping[str, Value]], NDArray[np.float64]
]


@dataclass(frozen=True)
class TableRequest:
    """A table that is wanted of a simulation's photons.

    Attributes
    ----------
    number : int
        Of its chunk.
    coarse : bool
        Which of the two grids.
    radius_mm : float or None
        Of a mask, to be cut out of the records; None: photons count as they are.
    mask : str
        Column that holds the radius which a mask must have to let the photon through.
    weight : callable or None
        ``weight(columns, values, parameters)`` of the photons.
    columns : tuple of str
        That the weight asks for.
    values : dict of str to float
        Of the effect's parameters.
    parameters : dict of str to value
        Of the configuration.
    """

    number: int
    coarse: bool
    radius_mm: float | None
    mask: str = MASK
    weight: Weight | None = None
    columns: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class TableUnit:
    """One simulation with the tables that are made of it.

    Attributes
    ----------
    what : str
    scene : SceneFile or PortableScene
    proposals : Proposals
    photons, seed : int
    variant : str
    grids : (Grid, Grid)
        The fine one and the coarse one.
    requests : tuple of TableRequest
    checked : bool
        Whether the scene is known to be sound, or need not be.
    """

    what: str
    scene: SceneFile | PortableScene
    proposals: Proposals
    photons: int
    seed: int
    variant: str
    grids: tuple[Grid, Grid]
    requests: tuple[TableRequest, ...]
    checked: bool

    @property
    def numbers(self) -> tuple[int, ...]:
        return tuple(request.number for request in self.requests)

    def check(self, threads: int | None) -> None:
        if not self.checked:
            self._loaded(threads, check=True)

    def portable(self) -> TableUnit:
        assert isinstance(self.scene, SceneFile)
        return replace(self, scene=PortableScene.of(self.scene))

    def make(self, threads: int | None) -> dict[int, Content]:
        from mcrim_mitsuba.kernel.records import Recorder

        columns: list[str] = []
        for request in self.requests:
            if request.radius_mm is not None:
                columns.append(MASK)
            if request.weight is not None:
                columns += [*request.columns, request.mask]
        recorder = Recorder(self._loaded(threads))
        records = recorder.record(
            self.proposals, self.photons, seed=self.seed, number=0,
            columns=tuple(dict.fromkeys(columns)),
        )  # fmt: skip
        groups: dict[tuple[bool, str, float | None], list[TableRequest]] = {}
        for request in self.requests:
            key = request.coarse, request.mask, request.radius_mm
            groups.setdefault(key, []).append(request)
        # threads of the linear algebra would change digits, and gain nothing
        with threadpool_limits(1, "blas"), ThreadPoolExecutor(_AT_ONCE) as pool:
            made = pool.map(lambda group: self._tables(records, group), groups.values())
            return {number: content for tables in made for number, content in tables}

    def _loaded(self, threads: int | None, *, check: bool = False) -> Simulation:
        try:
            return loaded_simulation(self.scene, self.variant, threads, check=check)
        except InputError as error:
            if not isinstance(self.scene, SceneFile) or self.scene.unwritten_text is None:
                raise
            # its lines are those of a text that nobody has seen
            raise InputError(
                f"with an effect in it (as mcrim add writes it) the scene is refused: "
                f"{error.problem}", error.mend, path=self.scene.path,
            ) from None  # fmt: skip

    def _tables(
        self, records: PhotonRecords, group: list[TableRequest]
    ) -> list[tuple[int, Content]]:
        """Tables on one grid behind one mask."""
        first = group[0]
        kept = None if first.radius_mm is None else records.further[first.mask] <= first.radius_mm
        gathering = Gathering(records, self.grids[first.coarse], kept)
        columns = {name: column[gathering.order] for name, column in records.further.items()}
        made: list[tuple[int, Content]] = []
        for request in group:
            weight = None
            if request.weight is not None:
                weight = request.weight(columns, request.values, request.parameters)
            table = gathering.table(weight)
            made.append((request.number, ({n: getattr(table, n).ravel() for n in _COLUMNS}, {})))
        return made


def table_of(arrays: Mapping[str, NDArray], grid: Grid) -> EtaTable:
    """The table that a chunk holds."""
    shape = grid.counts
    return EtaTable(arrays["log_eta"].reshape(shape), arrays["deviations"].reshape(-1, *shape))
