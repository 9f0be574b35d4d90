"""What a simulation hands the fit: the histories of the detected photons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_KINDS = {
    "k": np.uint16,
    "path_cm": np.float32,
    "w": np.float32,
    "proposal": np.uint8,
    "photons_per_proposal": np.int64,
    "alpha_scat_proposals_per_cm": np.float64,
}


@dataclass(frozen=True, eq=False)
class PhotonRecords:
    """Histories of the detected photons of one configuration.

    Attributes
    ----------
    k : (detected,) uint16
        Scatterings in the crystal.
    path_cm : (detected,) float32
        Path in the crystal.
    w : (detected,) float32
        Weight at detection at the proposals' absorption: an unbiased estimate of
        exp(-alpha_abs_proposal_per_cm path_cm), times whatever else dims the photon.
    proposal : (detected,) uint8
        Index of the scattering proposal that the photon was drawn from.
    photons_per_proposal : (proposals,) int64
        Photons emitted, detected or not, at least 2 each.
    alpha_scat_proposals_per_cm : (proposals,) float64
        Scattering coefficients that were simulated.
    alpha_abs_proposal_per_cm : float
        Absorption coefficient that was simulated.

    Raises
    ------
    ValueError
        If the arrays do not fit each other or hold values that no simulation gives.
    """

    k: NDArray[np.uint16]
    path_cm: NDArray[np.float32]
    w: NDArray[np.float32]
    proposal: NDArray[np.uint8]
    photons_per_proposal: NDArray[np.int64]
    alpha_scat_proposals_per_cm: NDArray[np.float64]
    alpha_abs_proposal_per_cm: float

    def __post_init__(self) -> None:
        for name, kind in _KINDS.items():
            array = np.asarray(getattr(self, name))
            if array.ndim != 1:
                raise ValueError(f"{name} has {array.ndim} dimensions, expected 1")
            converted = array.astype(kind, copy=False)
            if np.issubdtype(kind, np.integer) and not np.array_equal(converted, array):
                raise ValueError(f"{name} does not fit into {np.dtype(kind)}")
            object.__setattr__(self, name, converted)
        if len({len(self.k), len(self.path_cm), len(self.w), len(self.proposal)}) != 1:
            raise ValueError("k, path_cm, w and proposal differ in length")
        proposals = len(self.alpha_scat_proposals_per_cm)
        if len(self.photons_per_proposal) != proposals:
            raise ValueError("photons_per_proposal does not have one number per proposal")
        if len(self.proposal) and self.proposal.max() >= proposals:
            raise ValueError(f"proposal names number {self.proposal.max()} of {proposals}")
        if np.any(self.photons_per_proposal < np.maximum(self.detected_per_proposal, 2)):
            raise ValueError("photons_per_proposal is below the photons detected, or below 2")
        for name in ("path_cm", "w", "alpha_scat_proposals_per_cm", "alpha_abs_proposal_per_cm"):
            values = np.asarray(getattr(self, name))
            if not np.all(np.isfinite(values) & (values >= 0)):
                raise ValueError(f"{name} is negative or not finite")
        if not np.any(self.alpha_scat_proposals_per_cm > 0):
            raise ValueError("no proposal scatters: alpha_scat_proposals_per_cm are all 0")

    @property
    def detected_per_proposal(self) -> NDArray[np.int64]:
        """(proposals,) photons that have a record."""
        return np.bincount(self.proposal, minlength=len(self.photons_per_proposal))
