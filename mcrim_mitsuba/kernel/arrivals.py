"""Where and at which angle detected light arrives, launch by launch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mcrim_mitsuba.kernel import transport
from mcrim_mitsuba.kernel.collection import choose_path
from mcrim_mitsuba.kernel.lane_plan import FIRST_LAUNCH, LANES, plan_lanes
from mcrim_mitsuba.kernel.simulation import Simulation

#: Photons of a launch: records take 32 bytes each.
_LARGEST_LAUNCH = 64 * LANES
_POSITION = ("arrival_x_mm", "arrival_y_mm", "arrival_z_mm")


@dataclass(frozen=True, eq=False)
class Arrivals:
    """What one launch found.

    Attributes
    ----------
    photons_per_batch : ndarray of int64, shape (batches,)
    weights : dict of str to ndarray of float64, shape (batches,)
        Per fate.
    position_mm : ndarray of float64, shape (detected, 3)
    angle_deg : ndarray of float64, shape (detected,)
        To the detector's normal, in the medium before it.
    weight : ndarray of float64, shape (detected,)
    batch : ndarray of int64, shape (detected,)
    """

    photons_per_batch: np.ndarray
    weights: dict[str, np.ndarray]
    position_mm: np.ndarray
    angle_deg: np.ndarray
    weight: np.ndarray
    batch: np.ndarray


def arrivals(simulation: Simulation, photons: int, *, seed: int = 0) -> Iterator[Arrivals]:
    """Follow photons; launches that are not asked for are not made.

    Parameters
    ----------
    simulation : Simulation
    photons : int
        At least; more than `lane_plan.LANES` are made a multiple of these.
    seed : int
    """
    path = choose_path(simulation.model, simulation.polarization)
    if photons > LANES:
        photons = -(-photons // LANES) * LANES
    done = number = 0
    while done < photons:
        chunk = min(_LARGEST_LAUNCH if number else FIRST_LAUNCH, photons - done)
        found = transport.launch(
            path, simulation.crystal, plan_lanes(chunk), seed=seed, number=number,
            max_depth=simulation.depth_limit, keep_records=True,
            columns=(*_POSITION, "arrival_angle_deg"),
        )  # fmt: skip
        done, number, records = done + chunk, number + 1, found.records
        assert records is not None  # asked for
        yield Arrivals(
            found.photons_per_batch,
            found.weights,
            np.column_stack([records[name] for name in _POSITION]).astype(np.float64),
            records["arrival_angle_deg"].astype(np.float64),
            records["w"].astype(np.float64),
            records["batch"].astype(np.int64),
        )
