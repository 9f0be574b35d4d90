"""One simulation, every alpha: eta at any scattering and absorption from photons' histories.

With absorption applied as a weight, the number k of scatterings in the crystal and the path
L there are all of a photon's history that depends on the coefficients: its density is
a_s^k exp(-a_s L) times what the geometry does, its weight exp(-a_a L). Photons drawn from
several proposals a_j, N_j from each, are used together by the balance heuristic
(E. Veach and L. J. Guibas, SIGGRAPH 95, 419): each counts with its target density over the
density of the mixture,

    c = w exp(-(a_a - a_a0) L) a_s^k exp(-a_s L) / sum_j (N_j / N) a_j^k exp(-a_j L),

and eta = sum(c) / N is unbiased.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, xlogy

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT, EtaPoint

# Below it the relative error of eta exceeds 10 % and is itself badly known.
MINIMUM_EFFECTIVE_SAMPLE = 100.0

# How far alpha_scat may go beyond the outermost proposals.
FACTOR_BELOW = 5.0
FACTOR_ABOVE = 1.5

# Records per step of a sum: the working arrays stay in the processor's cache.
_BLOCK = 16_384

# Stands for log(0): times k it ends a photon that scattered, and leaves k = 0 alone.
_LOG_ZERO = -1e300


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
        exp(-alpha_abs_proposal_per_cm path_cm), times what else dims the photon.
    proposal : (detected,) uint8
        Index of the proposal it was drawn from.
    photons_per_proposal : (proposals,) int
        Photons emitted, detected or not, at least 2 each.
    alpha_scat_proposals_per_cm : (proposals,) float
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
        for name, kind in (("k", np.uint16), ("path_cm", np.float32), ("w", np.float32),
                           ("proposal", np.uint8), ("photons_per_proposal", np.int64),
                           ("alpha_scat_proposals_per_cm", np.float64)):  # fmt: skip
            array = np.asarray(getattr(self, name))
            if array.ndim != 1:
                raise ValueError(f"{name} has {array.ndim} dimensions, expected 1")
            object.__setattr__(self, name, array.astype(kind, copy=False))
        if len({len(self.k), len(self.path_cm), len(self.w), len(self.proposal)}) != 1:
            raise ValueError("k, path_cm, w and proposal differ in length")
        if len(self.photons_per_proposal) != len(self.alpha_scat_proposals_per_cm):
            raise ValueError("photons_per_proposal and alpha_scat_proposals_per_cm differ in length")
        detected = np.bincount(self.proposal, minlength=len(self.photons_per_proposal))
        if len(detected) > len(self.photons_per_proposal):
            raise ValueError("proposal names a proposal that is not there")
        if np.any(self.photons_per_proposal < np.maximum(detected, 2)):
            raise ValueError("photons_per_proposal is below the photons detected, or below 2")
        for name in ("path_cm", "w", "alpha_scat_proposals_per_cm", "alpha_abs_proposal_per_cm"):
            values = np.asarray(getattr(self, name))
            if not np.all(np.isfinite(values) & (values >= 0)):
                raise ValueError(f"{name} is negative or not finite")


class EtaSurface:
    """The light collection efficiency of one configuration at any alpha_scat and alpha_abs.

    Every method takes the two coefficients in 1/cm. The statistical error is that of a
    stratified sample (N_j photons from each proposal), undetected photons counting as zeros.

    Parameters
    ----------
    records : PhotonRecords
    """

    parameters = (ALPHA_SCAT, ALPHA_ABS)

    def __init__(self, records: PhotonRecords) -> None:
        order = np.argsort(records.proposal, kind="stable")
        self._k = records.k[order].astype(np.float64)
        self._path = records.path_cm[order].astype(np.float64)
        self._strata = np.asarray(records.photons_per_proposal, dtype=np.float64)
        self._photons = float(self._strata.sum())
        self._proposals = records.alpha_scat_proposals_per_cm
        self._log_base = self._log_weight_over_mixture(records, order)
        ends = np.cumsum(np.bincount(records.proposal, minlength=len(self._strata)))
        self._blocks = [
            (stratum, slice(start, min(start + _BLOCK, end)))
            for stratum, (begin, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
            for start in range(begin, end, _BLOCK)
        ]

    def _log_weight_over_mixture(
        self, records: PhotonRecords, order: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """log of w exp(a_a0 L) / sum_j (N_j / N) a_j^k exp(-a_j L), which no target changes."""
        mixture = logsumexp(
            [
                math.log(share) + xlogy(self._k, proposal) - proposal * self._path
                for share, proposal in zip(
                    self._strata / self._photons, self._proposals, strict=True
                )
            ],
            axis=0,
        )
        with np.errstate(divide="ignore"):  # w = 0 contributes exp(-inf) = 0
            log_w = np.log(records.w[order].astype(np.float64))
        return log_w + records.alpha_abs_proposal_per_cm * self._path - mixture

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        positive = self._proposals[self._proposals > 0]
        return float(positive.min()) / FACTOR_BELOW, float(positive.max()) * FACTOR_ABOVE

    def raw(self, alpha_scat_per_cm, alpha_abs_per_cm):
        s1 = s2 = sk = sl = 0.0
        sums = np.zeros((len(self._strata), 2))
        for stratum, block, c in self._contributions(alpha_scat_per_cm, alpha_abs_per_cm):
            k, path = self._k[block], self._path[block]
            sums[stratum] += (c.sum(), c @ c)
            sk += c @ k
            sl += c @ path
        total, sq = sums.sum(0)
        var = (self._strata * (sums[:, 1] - sums[:, 0] ** 2 / self._strata) / (self._strata - 1)).sum()
        return total / self._photons, math.sqrt(var) / self._photons, total**2 / sq, sk, sl

    def _contributions(self, alpha_scat_per_cm, alpha_abs_per_cm):
        log_scat = math.log(alpha_scat_per_cm) if alpha_scat_per_cm > 0 else _LOG_ZERO
        both = alpha_scat_per_cm + alpha_abs_per_cm
        values, scratch = np.empty(_BLOCK), np.empty(_BLOCK)
        for stratum, block in self._blocks:
            size = block.stop - block.start
            c, s = values[:size], scratch[:size]
            np.multiply(self._k[block], log_scat, out=c)
            np.multiply(self._path[block], both, out=s)
            c -= s
            c += self._log_base[block]
            np.exp(c, out=c)
            yield stratum, block, c
