"""Where light is born, where and at which angle it arrives, and which fate the rest meets.

`follow_light` bins detected photons on the detector. `map_eta` bins them, and all that are born, by
their place of birth: the ratio is eta of a cell of a grid over the crystal. A gamma's light comes
from where it stops: what eta varies by over these places widens its peak by as much, whatever the
detector counts (2.355 times the relative rms, in quadrature to the other parts of the full width at
half maximum).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.data_table import read_data_table
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.files import attributes, is_there
from mcrim_mitsuba.core.numbers import FWHM, whole_of
from mcrim_mitsuba.core.run import OverAxes, Run

if TYPE_CHECKING:
    import xarray

    from mcrim_mitsuba.transport.arrivals import DetectorPlane
    from mcrim_mitsuba.transport.launch_plan import FateTally
    from mcrim_mitsuba.transport.loop import Launch
    from mcrim_mitsuba.transport.simulation import Simulation

#: Photons of `follow_light` unless asked otherwise.
DEFAULT_PHOTONS = 1_000_000
#: Cells of the detector's map along its longer side; rings of the profile; degrees of an angle bin.
MAP_CELLS = 56
RINGS = 40
ANGLE_BIN_DEG = 2.0
#: Cells of `map_eta` along x, y and z unless asked otherwise.
CELLS = (10, 10, 10)
#: Photons of each cell: errors of half a per cent where a quarter of the light is detected.
PHOTONS_PER_CELL = 100_000
_FEWEST_PER_CELL = 100
_AXES = ("x_mm", "y_mm", "z_mm")
_DEPOSITS = (*_AXES, "energy_keV")
#: What the map's dataset has over its axes, in words where these say more, and of its run.
_OF_MAP = {
    "eta": {"long_name": "light collection efficiency by place of birth"},
    "eta_sigma": {},
    "volume": {"long_name": "part of the crystal's volume"},
}
_OF_RUN = ("photons", "seed", "scene_hash")


@dataclass(frozen=True, eq=False)
class Binned:
    """Light in bins, as fractions of all that is emitted."""

    #: ndarray of float64, shape (bins,) or (y bins, x bins): Fraction and its standard error, from
    #: independent batches of photons. Where no photon arrived, the error is one photon's worth.
    light: Array
    sigma: Array
    #: ndarray of float64, of the same shape: What a bin covers: of the detector's area (mm2), or of
    #: the angle (degrees).
    size: Array

    @property
    def density(self) -> Array:
        """Light per mm2 or degree and emitted photon; nan where a bin covers nothing."""
        return self.light / np.where(self.size > 0.0, self.size, np.nan)

    @property
    def density_sigma(self) -> Array:
        """Standard error of `density`."""
        return self.sigma / np.where(self.size > 0.0, self.size, np.nan)


class Bins:
    """Weight in bins along axes, with its spread between batches, over launches: see `FateTally`.

    Every axis has (bins + 1,) evenly rising edges.
    """

    def __init__(self, *edges: Array) -> None:
        self._edges, self._shape = edges, tuple(len(along) - 1 for along in edges)
        self._sums, self._squares = np.zeros(self._shape), np.zeros(self._shape)

    def add(self, launch: Launch, *values: Array) -> None:
        """Take in a launch's detected photons, by their (detected,) values along the axes."""
        records, photons = launch.records, launch.photons_per_batch
        shape = len(photons), *self._shape
        places = (bin_of(along, edges) for along, edges in zip(values, self._edges, strict=True))
        cells = np.ravel_multi_index((records["batch"].astype(np.int64), *places), shape)
        sums = np.bincount(cells, records["w"].astype(float), math.prod(shape)).reshape(shape)
        self._sums += sums.sum(axis=0)
        self._squares += (np.square(sums).T / photons).T.sum(axis=0)

    def binned(self, size: Array, tally: FateTally) -> Binned:
        """Light of all launches in the bins, which cover so much."""
        photons, batches = tally.photons, tally.batches
        spread = np.maximum(self._squares - np.square(self._sums) / photons, 0.0)
        sigma = np.sqrt(spread / max(batches - 1, 1) / photons)
        sigma = np.where((self._sums == 0.0) | (batches < 2), 1.0 / photons, sigma)
        return Binned(self._sums / photons, sigma, size)


def bin_of(values: Array, edges: Array) -> NDArray[np.int64]:
    """Number of the bin of each value; what rounding puts beyond the last edge counts in it."""
    step = edges[1] - edges[0]
    return np.clip(((values - edges[0]) / step).astype(np.int64), 0, len(edges) - 2)


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """The light of one configuration."""

    #: Light collection efficiency and its standard error.
    eta: float
    eta_sigma: float
    #: Fraction of the energy per fate and its standard error.
    budget: dict[str, float]
    budget_sigma: dict[str, float]
    #: ndarray of float64: Of the map's cells, from the detector's centre in its own plane.
    x_edges_mm: Array
    y_edges_mm: Array
    #: Shape (y, x).
    map: Binned
    #: ndarray of float64: From the detector's centre.
    radius_edges_mm: Array
    radius: Binned
    #: ndarray of float64: To the detector's normal, in the medium before it.
    angle_edges_deg: Array
    angle: Binned
    #: At which light gets through the face opposite the detector, by refraction; ``None`` where
    #: any angle does.
    largest_angle_deg: float | None
    #: ndarray of float64, shape (n, 2), or None: Outline of the crystal over the detector, closed.
    crystal_mm: Array | None
    #: x, y and radius of masks' holes.
    masks_mm: tuple[tuple[float, float, float], ...]
    photons: int


def follow_light(simulation: Simulation, *, run: Run = Run()) -> Light:
    """Follow the light of a checked simulation to its detector.

    A run has `DEFAULT_PHOTONS` where it says nothing. Its precision does not matter, its variant
    and threads are the simulation's.

    Raises InputError if the scene leaks, or its detector is not flat.
    """
    from mcrim_mitsuba.transport import arrivals
    from mcrim_mitsuba.transport.check import interfaces_of

    photons = run.photons_or(DEFAULT_PHOTONS)
    model, plane = simulation.model, refuse_curved(simulation)
    half = plane.half_mm
    cells = np.maximum(1, np.rint(MAP_CELLS * half / half.max())).astype(int)
    x_edges, y_edges = (np.linspace(-h, h, n + 1) for h, n in zip(half, cells, strict=True))
    radius_edges = np.linspace(0.0, float(np.linalg.norm(half)), RINGS + 1)
    angle_edges = np.arange(0.0, 90.0 + ANGLE_BIN_DEG / 2, ANGLE_BIN_DEG)
    on_map, on_rings, at_angles = Bins(y_edges, x_edges), Bins(radius_edges), Bins(angle_edges)
    for launch, tally, place in arrivals.arrivals(simulation, photons, seed=run.seed):
        x, y = plane.coordinates(place).T
        on_map.add(launch, y, x)
        on_rings.add(launch, np.hypot(x, y))
        at_angles.add(launch, launch.records["arrival_angle_deg"].astype(float))
        run.tell("following the light", min(tally.photons, photons), photons)
    interfaces = interfaces_of(simulation.file, model)
    return Light(
        **attributes(tally, "eta eta_sigma budget budget_sigma photons"),
        x_edges_mm=x_edges,
        y_edges_mm=y_edges,
        map=on_map.binned(plane.cell_areas(x_edges, y_edges), tally),
        radius_edges_mm=radius_edges,
        radius=on_rings.binned(plane.ring_areas(radius_edges), tally),
        angle_edges_deg=angle_edges,
        angle=at_angles.binned(np.diff(angle_edges), tally),
        largest_angle_deg=arrivals.largest_angle_deg(model, interfaces, plane),
        crystal_mm=arrivals.outline_of(model, simulation.crystal.volume, plane),
        masks_mm=arrivals.masks_of(model, plane),
    )


def refuse_curved(simulation: Simulation) -> DetectorPlane:
    """The plane of a flat detector; another one is refused, by an InputError that names it."""
    from mcrim_mitsuba.transport.arrivals import detector_plane

    with placed(path=simulation.file.path):
        return detector_plane(simulation.model)


# Where light is born.


@dataclass(frozen=True, eq=False, kw_only=True)
class Spread:
    """How eta varies over the places where gammas stop."""

    #: These, in words.
    source: str
    #: (x, y, z) float64: Light that they leave in the cells of the map, in any unit.
    light: Array
    #: Mean of eta, and its Monte Carlo error.
    eta: float
    eta_sigma: float
    #: Standard deviation of eta over its mean, without what noise adds to it, and its error.
    relative_rms: float
    relative_rms_sigma: float

    @property
    def fwhm(self) -> float:
        """What it adds in quadrature to a peak's full width at half maximum over its centroid."""
        return FWHM * self.relative_rms


@dataclass(frozen=True, eq=False, kw_only=True)
class EtaMap(OverAxes):
    """Light collection efficiency of light that is born in the cells of a grid."""

    #: (n + 1,) float64 along x, y and z: Borders of the cells, as the scene has them.
    edges_mm: tuple[Array, Array, Array]
    #: (x, y, z) float64: Efficiency and its Monte Carlo error, nan outside the crystal; cells are
    #: independent.
    eta: Array
    eta_sigma: Array
    #: (x, y, z) float64: Part of the crystal's volume.
    volume: Array

    @property
    def centres_mm(self) -> tuple[Array, Array, Array]:
        """Middles of the cells along x, y and z."""
        x, y, z = (0.5 * (edges[1:] + edges[:-1]) for edges in self.edges_mm)
        return x, y, z

    def spread(self, source: str, light: Array) -> Spread:
        """The spread of gammas that leave so much light (any unit) in the cells, (x, y, z).

        Raises ValueError if there is light where there is no crystal, or none at all.
        """
        inside = self.volume > 0.0
        if not light.sum() > 0.0 or light[~inside].any():
            raise ValueError("no light, or light outside the crystal")
        part, eta, variance = light[inside] / light.sum(), self.eta[inside], self.eta_sigma[inside]
        variance = variance**2
        mean = float(part @ eta)
        of_mean = float(part**2 @ variance)
        # noise makes the cells differ too: by its variance, less what the mean follows
        away = eta - mean
        square = float(part @ away**2 - part @ variance + of_mean)
        # what differs of itself would take 4 times it and 2 of noise; noise is in `away`, too
        of_noise = 2.0 * float((part * variance) @ (part * variance))
        of_square = max(4.0 * float((part * away) ** 2 @ variance) - of_noise, of_noise)
        rms = math.sqrt(max(square, 0.0))
        # of a root near zero the error is that of the square, not its linear part
        sigma = math.sqrt(of_square) / max(2.0 * rms, of_square**0.25)
        return Spread(
            source=source,
            light=light,
            eta=mean,
            eta_sigma=math.sqrt(of_mean),
            relative_rms=rms / mean,
            relative_rms_sigma=sigma / mean,
        )

    def spreads(self, depth_mm: float) -> tuple[Spread, ...]:
        """Spreads of gammas that stop everywhere, or at depths that fall as exp(-t/depth_mm).

        Depths count from the top, and from the side of the lowest x.
        """
        x, _, z = self.edges_mm
        downwards = _falling(z[-1] - z[::-1], depth_mm)[::-1]
        from_side = _falling(x - x[0], depth_mm)
        depth = f"1/e in {depth_mm:.3g} mm"
        return (
            self.spread("everywhere", self.volume),
            self.spread(f"below the top, {depth}", self.volume * downwards),
            self.spread(f"behind a side, {depth}", self.volume * from_side[:, None, None]),
        )

    def of_deposits(self, path: str | Path) -> Spread:
        """The spread of a file of deposits: columns x_mm, y_mm, z_mm and energy_keV, a row each.

        Raises InputError if the file cannot be read, or a deposit is outside the crystal, with its
        line.
        """
        table = read_data_table(path, roles=_DEPOSITS)
        pairs = zip(table.names or (), table.units, strict=False)
        named = ["_".join(filter(None, pair)) for pair in pairs]
        mixed = any(n.lower() not in (axis, axis[0]) for n, axis in zip(named, _AXES, strict=False))
        if mixed or len(table.values.T) != len(_DEPOSITS):
            columns = ", ".join(named) or f"{len(table.units)} columns"
            problem = f"{columns}, not {', '.join(_DEPOSITS)}"
            raise _refused(table.path, int(table.lines[0]), problem)
        *places, energy = table.values.T
        cells, wrong = [], [(energy < 0.0, energy, "energy_keV = {:g} is negative")]
        for place, edges, name in zip(places, self.edges_mm, _AXES, strict=True):
            outside = (place < edges[0]) | (place > edges[-1])
            ends = f"{edges[0]:g} to {edges[-1]:g}"
            wrong.append((outside, place, f"{name} = {{:g}} is outside the crystal, {ends}"))
            cells.append(bin_of(place, edges))
        at = tuple(cells)
        wrong.append((self.volume[at] == 0.0, energy, "the deposit is outside the crystal"))
        for refused, values, problem in wrong:
            if refused.any():
                row = int(refused.argmax())
                raise _refused(table.path, int(table.lines[row]), problem.format(values[row]))
        light = np.zeros(self.eta.shape)
        np.add.at(light, at, energy)
        return self.spread(f"as {table.path.name} says", light)

    def to_xarray(self) -> xarray.Dataset:
        """Eta, eta_sigma and volume over x_mm, y_mm and z_mm; attributes make it reproducible."""
        values = {name: (_AXES, getattr(self, name), words) for name, words in _OF_MAP.items()}
        return self.dataset(values, dict(zip(_AXES, self.centres_mm, strict=True)))


def map_eta(simulation: Simulation, cells: Sequence[int] = CELLS, *, run: Run = Run()) -> EtaMap:
    """Follow photons that are born in all cells of the box around a checked simulation's crystal.

    `cells` are their numbers along x, y and z. A run has `PHOTONS_PER_CELL` for each where it says
    nothing. Its precision does not matter, its variant and threads are the simulation's.

    Raises InputError if the scene leaks, light is born outside the crystal, or photons are too few.
    """
    from mcrim_mitsuba.transport import arrivals, launch_plan

    edges = _grid(simulation, cells)
    number = math.prod(len(along) - 1 for along in edges)
    photons = run.photons_or(PHOTONS_PER_CELL * number)
    if photons < _FEWEST_PER_CELL * number:
        problem = f"{photons:,} photons are {photons / number:.3g} in each of {number:,} cells"
        raise InputError(problem, f"follow {_FEWEST_PER_CELL * number:,} at least")
    inside = simulation.crystal.part_inside(edges)
    born, light = np.zeros((2, launch_plan.BATCHES, *inside.shape))
    for launch, tally, place in arrivals.births(simulation, photons, edges, seed=run.seed):
        born += launch.births
        at = launch.records["batch"], *map(bin_of, place.T, edges)
        seen = np.ravel_multi_index(at, born.shape)
        light += np.bincount(seen, launch.records["w"], born.size).reshape(born.shape)
        run.tell("mapping births", min(tally.photons, photons), photons)
    number_born = np.where(inside > 0.0, np.maximum(born.sum(axis=0), 1.0), np.nan)
    eta = light.sum(axis=0) / number_born
    sigma = np.sqrt(np.square(light - eta * born).sum(axis=0)) / number_born
    return EtaMap(
        edges_mm=edges,
        eta=eta,
        eta_sigma=np.where(sigma == 0.0, 1.0 / number_born, sigma),
        volume=inside / inside.sum(),
        photons=tally.photons,
        seed=run.seed,
        parameters=dict(simulation.file.parameters),
        scene_hash=simulation.file.content_hash,
    )


def _grid(simulation: Simulation, cells: Sequence[int]) -> tuple[Array, Array, Array]:
    """Borders of cells along x, y and z, mm; refuses what is no number of cells, and beams."""
    crystal = simulation.crystal
    if crystal.birth_volume != crystal.volume:
        problem = "a beam's photons are not born in the crystal, so that no map shows them"
        raise InputError(problem, "map a scene of light", path=simulation.file.path)
    if crystal.in_part:
        problem = "light is born in a part of the crystal, so that no map shows it from everywhere"
        mend = "let source_width_mm or source_across_mm be all of the crystal"
        raise InputError(problem, mend, path=simulation.file.path)
    mend = "give three whole numbers from 1, such as (10, 10, 10)"
    if not np.iterable(cells) or len(cells := list(cells)) != 3:
        raise InputError(f"cells is {cells}", mend)
    cells = [whole_of("a number of cells", n, mend, 1) for n in cells]
    # single precision leaves 1e-16 where a face is at 0
    x, y, z = (
        np.asarray(np.round(np.linspace(low, high, n + 1), 9) + 0.0, float)
        for low, high, n in zip(crystal.lower, crystal.upper, cells, strict=True)
    )
    return x, y, z


def read_map(path: str | Path) -> EtaMap:
    """A map as `EtaMap.to_xarray` gives it, from the NetCDF file that ``simulate --map`` writes.

    Raises InputError if the file cannot be read, or is something else.
    """
    import xarray

    path = Path(path)
    mend = "name a file that `mcrim simulate --map FILE.nc` wrote"
    if not is_there(path):
        raise InputError("this file does not exist", mend, path=path)
    try:
        with xarray.open_dataset(path, engine="scipy") as data:
            tables: dict[str, Any] = {name: data[name].to_numpy().astype(float) for name in _OF_MAP}
            centres = [data[name].to_numpy().astype(float) for name in _AXES]
            parameters = {name: np.asarray(value).item() for name, value in data.attrs.items()}
            of_run = {name: parameters.pop(name) for name in _OF_RUN}
            dims = {data[name].dims for name in _OF_MAP}
    except (KeyError, OSError, TypeError, ValueError):
        raise InputError("this is no map of eta", mend, path=path) from None
    if dims != {_AXES} or min(map(len, centres)) < 2:
        problem = "this is no map of eta over x, y and z, of two cells along each at least"
        raise InputError(problem, mend, path=path)
    x, y, z = (np.append(c - 0.5 * (c[1] - c[0]), 1.5 * c[-1] - 0.5 * c[-2]) for c in centres)
    return EtaMap(edges_mm=(x, y, z), **tables, **of_run, parameters=parameters)


def all_spreads(
    mapped: EtaMap, depth_mm: float, deposits: str | Path | None = None
) -> tuple[Spread, ...]:
    """Spreads of gammas that stop everywhere, near a face, and as a file says, if it is named.

    Raises InputError as `EtaMap.of_deposits`.
    """
    spreads = mapped.spreads(depth_mm)
    return spreads if deposits is None else (*spreads, mapped.of_deposits(deposits))


def _falling(depths_mm: Array, length_mm: float) -> Array:
    """Part of what stops between depths, rising from 0, per part of the whole depth."""
    return np.asarray(-np.diff(np.exp(-depths_mm / length_mm)) / np.diff(depths_mm), float)


def _refused(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, "give places inside the crystal and energies", path=path, line=line)
