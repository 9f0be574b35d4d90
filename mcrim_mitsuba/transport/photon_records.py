"""What a simulation hands the fit: the histories of the detected photons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

_KINDS = {
    "k": np.uint16,
    "path_cm": np.float32,
    "w": np.float32,
    "batch": np.uint8,
    "photons_per_proposal": np.int64,
    "alpha_scat_proposals_per_cm": np.float64,
}


@dataclass(frozen=True, eq=False)
class PhotonRecords:
    """Histories of the detected photons of one configuration, or a chunk of them.

    Raises
    ------
    ValueError
        If the arrays do not fit each other or hold values that no simulation gives.
    """

    #: (detected,) uint16: Scatterings in the crystal.
    k: NDArray[np.uint16]
    #: (detected,) float32: Path in the crystal.
    path_cm: NDArray[np.float32]
    #: (detected,) float32: Weight at detection at the proposals' absorption: an unbiased estimate
    #: of exp(-alpha_abs_proposal_per_cm path_cm), times whatever else dims the photon.
    w: NDArray[np.float32]
    #: (detected,) uint8: Which of the `batches` the photon was emitted in. Batches are independent
    #: of each other and have the same numbers of photons from every proposal; within a batch
    #: photons may be spread more evenly than independent ones.
    batch: NDArray[np.uint8]
    #: At least 2.
    batches: int
    #: (proposals,) int64: Photons emitted, detected or not: 0, or at least one per batch.
    photons_per_proposal: NDArray[np.int64]
    #: (proposals,) float64: Scattering coefficients that were simulated.
    alpha_scat_proposals_per_cm: NDArray[np.float64]
    #: Absorption coefficient that was simulated.
    alpha_abs_proposal_per_cm: float
    #: dict of str to (detected,) ndarray: The rest of the histories by name: ``reflections``,
    #: ``path_<medium>_cm``, ``birth_depth_mm``, ``arrival_cosine``, ``arrival_radius_mm`` and
    #: others of `transport.record_store.COLUMNS`.
    further: Mapping[str, NDArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, kind in _KINDS.items():
            array = np.asarray(getattr(self, name))
            if array.ndim != 1:
                raise ValueError(f"{name} has {array.ndim} dimensions, expected 1")
            converted = array.astype(kind, copy=False)
            if np.issubdtype(kind, np.integer) and not np.array_equal(converted, array):
                raise ValueError(f"{name} does not fit into {np.dtype(kind)}")
            object.__setattr__(self, name, converted)
        columns: list[NDArray] = [
            self.k, self.path_cm, self.w, self.batch, *self.further.values()
        ]  # fmt: skip
        if len({len(column) for column in columns}) != 1:
            raise ValueError(f"k, path_cm, w, batch{''.join(f', {n}' for n in self.further)} "
                             "differ in length")  # fmt: skip
        if len(self.alpha_scat_proposals_per_cm) != len(self.photons_per_proposal):
            raise ValueError("photons_per_proposal does not have one number per proposal")
        if self.batches < 2:
            raise ValueError(f"{self.batches} batches have no spread")
        if len(self.batch) and self.batch.max() >= self.batches:
            raise ValueError(f"batch names number {self.batch.max()} of {self.batches}")
        emitted = self.photons_per_proposal
        if emitted.sum() == 0 or np.any((emitted != 0) & (emitted < self.batches)):
            raise ValueError("photons_per_proposal is below one photon per batch")
        if self.photons_per_proposal.sum() < len(self.k):
            raise ValueError("photons_per_proposal is below the photons detected")
        for name in ("path_cm", "w", "alpha_scat_proposals_per_cm", "alpha_abs_proposal_per_cm"):
            values = np.asarray(getattr(self, name))
            if not np.all(np.isfinite(values) & (values >= 0)):
                raise ValueError(f"{name} is negative or not finite")
        if not np.any(self.alpha_scat_proposals_per_cm > 0):
            raise ValueError("no proposal scatters: alpha_scat_proposals_per_cm are all 0")

    @property
    def photons(self) -> int:
        """Photons emitted."""
        return int(self.photons_per_proposal.sum())


@dataclass(frozen=True)
class ScatteringProposals:
    """How photons are to be drawn."""

    #: Scattering coefficients, rising.
    alpha_scat_per_cm: tuple[float, ...]
    #: Share of each in units of 1 / their sum; 0 for one that nobody needs any more.
    units: tuple[int, ...]
    #: Absorption coefficient.
    alpha_abs_per_cm: float
