"""The light collection efficiency by where the light is born, and what its spread does to a peak.

Births in the cells of a grid over the crystal are counted as they are drawn, so that detected light
over births is eta of a cell. A gamma's light comes from where it stops: what eta varies by over
these places widens its peak by as much, whatever the detector counts (2.355 times the relative rms,
in quadrature to the other parts of the full width at half maximum).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.core.data_table import read_data_table
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there
from mcrim_mitsuba.core.numbers import FWHM, Value, as_attributes, whole_of
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.lighting import Bins, bin_of

if TYPE_CHECKING:
    import xarray

    from mcrim_mitsuba.transport.simulation import Simulation

#: Cells along x, y and z unless asked otherwise, and photons of each: errors of half a per cent
#: where a quarter of the light is detected.
CELLS, PHOTONS_PER_CELL = (10, 10, 10), 100_000
_FEWEST_PER_CELL = 100
_AXES = ("x_mm", "y_mm", "z_mm")
_DEPOSITS = ("x_mm", "y_mm", "z_mm", "energy_keV")


@dataclass(frozen=True, eq=False)
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


@dataclass(frozen=True, eq=False)
class EtaMap:
    """Light collection efficiency of light that is born in the cells of a grid."""

    #: (n + 1,) float64 along x, y and z: Borders of the cells, as the scene has them.
    edges_mm: tuple[Array, Array, Array]
    #: (x, y, z) float64: Efficiency and its Monte Carlo error, nan outside the crystal; cells are
    #: independent.
    eta: Array
    eta_sigma: Array
    #: (x, y, z) float64: Part of the crystal's volume.
    volume: Array
    photons: int
    seed: int
    #: Of the scene.
    parameters: Mapping[str, Value]
    scene_hash: str

    @property
    def centres_mm(self) -> tuple[Array, Array, Array]:
        """Middles of the cells along x, y and z."""
        x, y, z = (0.5 * (edges[1:] + edges[:-1]) for edges in self.edges_mm)
        return x, y, z

    def spread(self, source: str, light: Array) -> Spread:
        """Of gammas that leave so much light (any unit) in the cells, (x, y, z).

        Raises
        ------
        ValueError
            If there is light where there is no crystal, or none at all.
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
        of_square = float(
            4.0 * (part * away) ** 2 @ variance + 2.0 * (part * variance) @ (part * variance)
        )
        rms = math.sqrt(max(square, 0.0))
        # of a root near zero the error is that of the square, not its linear part
        sigma = math.sqrt(of_square) / max(2.0 * rms, of_square**0.25)
        return Spread(source, light, mean, math.sqrt(of_mean), rms / mean, sigma / mean)

    def spreads(self, depth_mm: float) -> tuple[Spread, ...]:
        """Of gammas that stop everywhere, or near a face, at depths that fall as exp(-t/depth_mm).

        The faces are the top and the side of the lowest x.
        """
        x, _, z = self.edges_mm
        downwards = _falling(z[-1] - z[::-1], depth_mm)[::-1]
        from_side = _falling(x - x[0], depth_mm)
        return (
            self.spread("everywhere", self.volume),
            self.spread(f"below the top, 1/e in {depth_mm:.3g} mm", self.volume * downwards),
            self.spread(
                f"behind a side, 1/e in {depth_mm:.3g} mm", self.volume * from_side[:, None, None]
            ),
        )

    def of_deposits(self, path: str | Path) -> Spread:
        """Of a file of deposits: columns x_mm, y_mm, z_mm and energy_keV, a row each.

        Raises
        ------
        InputError
            If the file cannot be read, or a deposit is outside the crystal, with its line.
        """
        table = read_data_table(path, roles=_DEPOSITS)
        if len(table.values.T) != len(_DEPOSITS):
            problem = f"{len(table.values.T)} columns instead of {', '.join(_DEPOSITS)}"
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
        for found, values, problem in wrong:
            if found.any():
                row = int(found.argmax())
                raise _refused(table.path, int(table.lines[row]), problem.format(values[row]))
        light = np.zeros(self.eta.shape)
        np.add.at(light, at, energy)
        return self.spread(f"as {table.path.name} says", light)

    def to_xarray(self) -> xarray.Dataset:
        """Eta, eta_sigma and volume over x_mm, y_mm and z_mm; attributes make it reproducible."""
        import xarray

        made = xarray.Dataset(
            {name: (_AXES, getattr(self, name)) for name in ("eta", "eta_sigma", "volume")},
            dict(zip(_AXES, self.centres_mm, strict=True)),
            {"photons": self.photons, "seed": self.seed, "scene_hash": self.scene_hash}
            | as_attributes(self.parameters),
        )
        made.eta.attrs["long_name"] = "light collection efficiency by place of birth"
        made.volume.attrs["long_name"] = "part of the crystal's volume"
        for name in _AXES:
            made[name].attrs["units"] = "mm"
        return made


def map_eta(simulation: Simulation, cells: Sequence[int] = CELLS, *, run: Run = Run()) -> EtaMap:
    """Follow photons of all places.

    Parameters
    ----------
    simulation : Simulation
        Checked.
    cells : sequence of int
        Along x, y and z of the crystal's bounding box.
    run : Run
        `PHOTONS_PER_CELL` of each cell where it says nothing. Its precision does not matter, its
        variant and threads are the simulation's.

    Raises
    ------
    InputError
        If the scene leaks, light is born outside the crystal, or photons are too few.
    """
    from mcrim_mitsuba.transport import arrivals

    crystal = simulation.crystal
    if crystal.birth_volume != crystal.volume:
        problem = "a beam's photons are not born in the crystal, so that no map shows them"
        raise InputError(problem, "map a scene of light", path=simulation.file.path)
    mend = "give three whole numbers from 1, such as (10, 10, 10)"
    if not np.iterable(cells) or len(cells := list(cells)) != 3:
        raise InputError(f"cells is {cells}", mend)
    cells = [whole_of("a number of cells", n, mend, 1) for n in cells]
    number = math.prod(cells)
    photons = run.photons_or(PHOTONS_PER_CELL * number)
    if photons < _FEWEST_PER_CELL * number:
        problem = f"{photons:,} photons are {photons / number:.3g} in each of {number:,} cells"
        raise InputError(problem, f"follow {_FEWEST_PER_CELL * number:,} at least")
    ends = zip(crystal.lower, crystal.upper, cells, strict=True)
    # single precision leaves 1e-16 where a face is at 0
    x, y, z = (
        np.asarray(np.round(np.linspace(low, high, n + 1), 9) + 0.0, float) for low, high, n in ends
    )
    edges = x, y, z
    inside = crystal.part_inside(edges)
    born = inside * crystal.birth_density(edges)
    bins = Bins(number)
    for launch, tally, place in arrivals.births(simulation, photons, seed=run.seed):
        at = [bin_of(x, e) for x, e in zip(place.T, edges, strict=True)]
        weight, batch = launch.records["w"].astype(float), launch.records["batch"].astype(np.int64)
        bins.add(np.ravel_multi_index(at, inside.shape), weight, batch, launch.photons_per_batch)
        run.tell("mapping births", min(tally.photons, photons), photons)
    light = bins.binned(inside, tally.photons, tally.batches)
    # births are even enough over cells that a detected photon says where light was born, too
    with np.errstate(invalid="ignore"):
        share = np.where(inside > 0.0, born / born.sum(), np.nan)
    return EtaMap(
        edges,
        light.light / share,
        light.sigma / share,
        inside / inside.sum(),
        tally.photons,
        run.seed,
        dict(simulation.file.parameters),
        simulation.file.content_hash,
    )


_OF_MAP = ("eta", "eta_sigma", "volume")
_OF_RUN = ("photons", "seed", "scene_hash")


def read_map(path: str | Path) -> EtaMap:
    """A map as `EtaMap.to_xarray` gives it, from the NetCDF file that ``simulate --map`` writes.

    Raises
    ------
    InputError
        If the file cannot be read, or is something else.
    """
    import xarray

    path = Path(path)
    mend = "name a file that `mcrim simulate --map FILE.nc` wrote"
    if not is_there(path):
        raise InputError("this file does not exist", mend, path=path)
    try:
        with xarray.open_dataset(path, engine="scipy") as data:
            tables = [data[name].to_numpy().astype(float) for name in _OF_MAP]
            centres = [data[name].to_numpy().astype(float) for name in _AXES]
            known = dict(data.attrs)
            photons, seed, scene_hash = (known.pop(name) for name in _OF_RUN)
            dims = {data[name].dims for name in _OF_MAP}
    except (KeyError, OSError, TypeError, ValueError):
        raise InputError("this is no map of eta", mend, path=path) from None
    if dims != {_AXES} or min(len(one) for one in centres) < 2:
        problem = "this is no map of eta over x, y and z, of two cells along each at least"
        raise InputError(problem, mend, path=path)
    x, y, z = (
        np.append(one - 0.5 * (one[1] - one[0]), 1.5 * one[-1] - 0.5 * one[-2]) for one in centres
    )
    eta, sigma, volume = tables
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in known.items()}
    return EtaMap((x, y, z), eta, sigma, volume, int(photons), int(seed), plain, str(scene_hash))


def all_spreads(
    mapped: EtaMap, depth_mm: float, deposits: str | Path | None = None
) -> tuple[Spread, ...]:
    """Of gammas that stop everywhere, near a face, and as a file says, where one is named.

    Raises
    ------
    InputError
        If the depth is not above 0, and as `EtaMap.of_deposits`.
    """
    if not depth_mm > 0.0:
        raise InputError(f"depth_mm = {depth_mm:g} is no depth", "give one above 0")
    own = () if deposits is None else (mapped.of_deposits(deposits),)
    return (*mapped.spreads(depth_mm), *own)


def _falling(depths_mm: Array, length_mm: float) -> Array:
    """Part of what stops between depths, rising from 0, per part of the whole depth."""
    stopped = -np.diff(np.exp(-depths_mm / length_mm))
    return np.asarray(stopped / np.diff(depths_mm), float)


def _refused(path: Path, line: int, problem: str) -> InputError:
    return InputError(problem, "give places inside the crystal and energies", path=path, line=line)
