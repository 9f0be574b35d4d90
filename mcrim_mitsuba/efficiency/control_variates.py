"""Eta of the bench as it is, where it needs no photons, and photons that tell what differs from it.

Where a scene is a polished box its efficiency is solved (`reference.polished_box`). Photons of it
are followed all the same, as many as of a bench with an effect and with the same random numbers:
what they are off by from the solution, those with the effect are mostly off by, too. It is taken
away as far as the two go together in batches (a control variate: J. M. Hammersley and
D. C. Handscomb, Monte Carlo Methods, Methuen 1964, chapter 5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.eta_grid import BATCHES, EtaGrid, Grid
from mcrim_mitsuba.reference.polished_box import solve_box
from mcrim_mitsuba.reference.scene_bench import bench_of
from mcrim_mitsuba.runs.executors import Content
from mcrim_mitsuba.runs.scene_units import SceneUnit

#: Processor time of a grid's solution.
_EXPECTED_S = 0.2
#: Relative error that is enough beside readings' of some 0.7 %: errors are estimated to be below,
#: and are a third of that.
_PRECISION = 1e-3


@dataclass(frozen=True)
class SolvedUnit(SceneUnit):
    """Eta of one configuration at the nodes of a grid, without photons."""

    #: Of the mask; None: the scene's.
    radius_mm: float | None
    grid: Grid
    #: Of its chunk.
    number: int

    @property
    def photons(self) -> int:
        return 0

    @property
    def expected_s(self) -> float:
        return _EXPECTED_S

    @property
    def numbers(self) -> tuple[int]:
        return (self.number,)

    def make(self, threads: int | None) -> dict[int, Content]:
        """log(eta) at the nodes; nothing but why not, where the scene is no such box."""
        try:
            bench = bench_of(self.loaded(threads))
            if self.radius_mm is not None:
                bench = replace(bench, aperture_radius_mm=self.radius_mm)
            eta = solve_box(bench, *self.grid.coefficients_per_cm(), precision=_PRECISION).eta
        except InputError as refusal:
            return {self.number: ({}, {"refused": refusal.problem})}
        return {self.number: ({"log_eta": np.log(eta).ravel()}, {})}


def solved_grid(grid: Grid) -> Grid:
    """The nodes that are solved: polynomials through them are right to 4e-4 on all of a grid."""
    return replace(grid, counts=(grid.counts[0], grid.counts[1] + 1))


def solved_table(arrays: Mapping[str, NDArray[Any]], solved: Grid, grid: Grid) -> EtaGrid | None:
    """What `SolvedUnit` made, on another grid and without errors; None where it was refused."""
    if "log_eta" not in arrays:
        return None
    scattering, absorption = (
        getattr(solved, axis).weights_at(getattr(grid, axis).nodes)
        for axis in ("scattering", "absorption")
    )
    log_eta = scattering @ arrays["log_eta"].reshape(solved.counts) @ absorption.T
    return EtaGrid(log_eta, np.zeros((BATCHES, *grid.counts), dtype=np.float32))


def difference(changed: EtaGrid, plain: EtaGrid, known: EtaGrid) -> EtaGrid:
    """What an effect adds to log(eta).

    Parameters
    ----------
    changed, plain : EtaGrid
        Photons with the effect and without, of the same random numbers.
    known : EtaGrid
        Eta without the effect, better known.
    """
    with_it = changed.deviations - known.deviations
    without = plain.deviations - known.deviations
    square = float((without.astype(float) ** 2).sum())
    common = float((with_it.astype(float) * without).sum()) / square if square > 0 else 0.0
    share = min(max(common, 0.0), 1.0)
    return EtaGrid(
        changed.log_eta - known.log_eta - share * (plain.log_eta - known.log_eta),
        with_it - np.float32(share) * without,
    )
