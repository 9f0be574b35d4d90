"""Where light arrives on the detector, at which angle, and which fate the rest meets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import placed
from mcrim_mitsuba.core.run import Run

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.arrivals import DetectorPlane
    from mcrim_mitsuba.transport.simulation import Simulation

DEFAULT_PHOTONS = 1_000_000
#: Cells of the map along the detector's longer side; rings of the profile; degrees of an angle bin.
MAP_CELLS, RINGS, ANGLE_BIN_DEG = 56, 40, 2.0


@dataclass(frozen=True, eq=False)
class Binned:
    """Light in bins, as fractions of all that is emitted."""

    #: ndarray of float64, shape (bins,) or (y bins, x bins): Fraction and its standard error, from
    #: independent batches of photons. Where no photon arrived, the error is one photon's worth.
    light: NDArray[np.float64]
    sigma: NDArray[np.float64]
    #: ndarray of float64, of the same shape: What a bin covers: of the detector's area (mm2), or of
    #: the angle (degrees).
    size: NDArray[np.float64]

    @property
    def density(self) -> NDArray[np.float64]:
        """Light per mm2 or degree and emitted photon; nan where a bin covers nothing."""
        return self.light / np.where(self.size > 0.0, self.size, np.nan)

    @property
    def density_sigma(self) -> NDArray[np.float64]:
        """Standard error of `density`."""
        return self.sigma / np.where(self.size > 0.0, self.size, np.nan)


@dataclass(frozen=True, eq=False)
class Light:
    """The light of one configuration."""

    #: Light collection efficiency and its standard error.
    eta: float
    eta_sigma: float
    #: Fraction of the energy per fate and its standard error.
    budget: dict[str, float]
    budget_sigma: dict[str, float]
    #: ndarray of float64: Of the map's cells, from the detector's centre in its own plane.
    x_edges_mm: NDArray[np.float64]
    y_edges_mm: NDArray[np.float64]
    #: Shape (y, x).
    map: Binned
    #: ndarray of float64: From the detector's centre.
    radius_edges_mm: NDArray[np.float64]
    radius: Binned
    #: ndarray of float64: To the detector's normal, in the medium before it.
    angle_edges_deg: NDArray[np.float64]
    angle: Binned
    #: At which light gets through the face opposite the detector, by refraction; ``None`` where
    #: any angle does.
    largest_angle_deg: float | None
    #: ndarray of float64, shape (n, 2), or None: Outline of the crystal over the detector, closed.
    crystal_mm: NDArray[np.float64] | None
    #: x, y and radius of masks' holes.
    masks_mm: tuple[tuple[float, float, float], ...]
    photons: int


class Bins:
    """Weight in bins, with its spread between batches, over launches: see `FateTally`."""

    def __init__(self, bins: int) -> None:
        self._bins = bins
        self._sums, self._squares = np.zeros(bins), np.zeros(bins)

    def add(
        self,
        cells: NDArray[np.int64],
        weight: NDArray[np.float64],
        batch: NDArray[np.int64],
        photons_per_batch: NDArray[np.int64],
    ) -> None:
        """Take in a launch's detected photons."""
        batches = len(photons_per_batch)
        sums = np.bincount(batch * self._bins + cells, weight, batches * self._bins)
        sums = sums.reshape(batches, self._bins)
        self._sums += sums.sum(axis=0)
        self._squares += (np.square(sums) / photons_per_batch[:, None]).sum(axis=0)

    def binned(self, size: NDArray[np.float64], photons: int, batches: int) -> Binned:
        """Of all launches; `size` gives the shape."""
        spread = np.maximum(self._squares - np.square(self._sums) / photons, 0.0)
        sigma = np.sqrt(spread / max(batches - 1, 1) / photons)
        sigma = np.where((self._sums == 0.0) | (batches < 2), 1.0 / photons, sigma)
        return Binned((self._sums / photons).reshape(size.shape), sigma.reshape(size.shape), size)


def follow_light(simulation: Simulation, *, run: Run = Run()) -> Light:
    """Follow a configuration's light.

    Parameters
    ----------
    simulation : Simulation
        Checked.
    run : Run
        Of a million photons where it says nothing. Its precision does not matter, its variant and
        threads are the simulation's.

    Raises
    ------
    InputError
        If the scene leaks, or its detector is not flat.
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
    on_map, on_rings, at_angles = (
        Bins(bins) for bins in (cells.prod(), RINGS, len(angle_edges) - 1)
    )
    for launch, tally, place in arrivals.arrivals(simulation, photons, seed=run.seed):
        x, y = plane.coordinates(place).T
        column, row = bin_of(x, x_edges), bin_of(y, y_edges)
        weight, angle = (launch.records[n].astype(float) for n in ("w", "arrival_angle_deg"))
        rest = weight, launch.records["batch"].astype(np.int64), launch.photons_per_batch
        on_map.add(row * cells[0] + column, *rest)
        on_rings.add(bin_of(np.hypot(x, y), radius_edges), *rest)
        at_angles.add(bin_of(angle, angle_edges), *rest)
        run.tell("following the light", min(tally.photons, photons), photons)
    so_many = tally.photons, tally.batches
    interfaces = interfaces_of(simulation.file, model)
    return Light(
        eta=tally.eta,
        eta_sigma=tally.eta_sigma,
        budget=tally.budget,
        budget_sigma=tally.budget_sigma,
        x_edges_mm=x_edges,
        y_edges_mm=y_edges,
        map=on_map.binned(plane.cell_areas(x_edges, y_edges), *so_many),
        radius_edges_mm=radius_edges,
        radius=on_rings.binned(plane.ring_areas(radius_edges), *so_many),
        angle_edges_deg=angle_edges,
        angle=at_angles.binned(np.diff(angle_edges), *so_many),
        largest_angle_deg=arrivals.largest_angle_deg(model, interfaces, plane),
        crystal_mm=arrivals.outline_of(model, simulation.crystal.volume, plane),
        masks_mm=arrivals.masks_of(model, plane),
        photons=tally.photons,
    )


def refuse_curved(simulation: Simulation) -> DetectorPlane:
    """The plane of a flat detector; another one is refused, by an InputError that names it."""
    from mcrim_mitsuba.transport.arrivals import detector_plane

    with placed(path=simulation.file.path):
        return detector_plane(simulation.model)


def bin_of(values: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the bin of each value; what rounding puts beyond the last edge counts in it."""
    step = edges[1] - edges[0]
    return np.clip(((values - edges[0]) / step).astype(np.int64), 0, len(edges) - 2)
