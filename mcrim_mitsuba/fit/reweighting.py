"""One simulation, every alpha: eta at any scattering and absorption from photons' histories.

With absorption applied as a weight, the number k of scatterings in the crystal and the path
L there are all of a photon's history that depends on the coefficients: its density is
a_s^k exp(-a_s L) times what the geometry makes of it, its weight exp(-a_a L). Photons drawn
from several proposals a_j, N_j from each, are used together by the balance heuristic
(E. Veach and L. J. Guibas, SIGGRAPH 95, 419): each counts with the target's density over
that of the mixture,

    c = w exp(-(a_a - a_a0) L) a_s^k exp(-a_s L) / sum_j (N_j / N) a_j^k exp(-a_j L),

and eta = sum(c) / N is unbiased wherever one proposal scatters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT, EtaPoint, Surface

__all__ = ["EtaSurface", "PhotonRecords"]

# Where fewer photons than these carry eta, or carry its error (the same measure of the
# squares), neither can be trusted. The second is the one that shows missing photons: eta was
# 50 % low with an effective sample of 1300. Compared with direct runs of the NumPy tracer (the
# article's bench, air gap, 8e4 and 4e5 photons), what all limits of this module let through
# was 3.3 sigma off at worst in 800 comparisons; without them, 47 sigma.
_LEAST_EFFECTIVE_SAMPLE = 100.0
_LEAST_VARIANCE_SAMPLE = 10.0

# How far from the outermost proposals alpha_scat may go, by the same comparisons.
_FACTOR_BELOW = 10.0
_FACTOR_ABOVE = 1.5

# Records per step of a sum: the working arrays stay in the processor's cache, and the dot
# products below the length from which OpenBLAS would start threads. 5e5 records take 4 ms.
_BLOCK = 8_192

# Stands for log(0): times k it ends every photon that scattered and leaves k = 0 alone.
_LOG_ZERO = -1e300


class EtaSurface(Surface):
    """The light collection efficiency of one configuration at any alpha_scat and alpha_abs.

    The statistical error is that of a stratified sample, N_j photons from each proposal,
    the undetected ones counting as zeros.

    Parameters
    ----------
    records : PhotonRecords
    """

    def __init__(self, records: PhotonRecords) -> None:
        order = np.argsort(records.proposal, kind="stable")
        self._k = records.k[order].astype(np.float64)
        self._path = records.path_cm[order].astype(np.float64)
        self._photons = records.photons_per_proposal.astype(np.float64)
        self._proposals = records.alpha_scat_proposals_per_cm
        self._alpha_abs_proposal = float(records.alpha_abs_proposal_per_cm)
        with np.errstate(divide="ignore"):  # a weight of 0 contributes exp(-inf) = 0
            log_w = np.log(records.w[order].astype(np.float64))
        # all of log(c) that does not depend on the target
        self._log_base = log_w + self._alpha_abs_proposal * self._path - self._log_mixture()
        ends = np.cumsum(records.detected_per_proposal)
        self._blocks = [
            (stratum, slice(start, min(start + _BLOCK, end)))
            for stratum, (begin, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
            for start in range(begin, end, _BLOCK)
        ]

    def _log_mixture(self) -> NDArray[np.float64]:
        """(detected,) log of sum_j (N_j / N) a_j^k exp(-a_j L)."""
        log_shares = np.log(self._photons / self._photons.sum())[:, None]
        proposals = np.asarray(self._proposals, dtype=np.float64)[:, None]
        with np.errstate(divide="ignore"):
            log_proposals = np.maximum(np.log(proposals), _LOG_ZERO)  # 0^0 = 1, 0^k = 0
        mixture = np.empty(len(self._k))
        for start in range(0, len(mixture), _BLOCK):
            block = slice(start, start + _BLOCK)
            terms = log_shares + log_proposals * self._k[block] - proposals * self._path[block]
            top = terms.max(axis=0)
            terms -= top
            mixture[block] = top + np.log(np.exp(terms, out=terms).sum(axis=0))
        return mixture

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        scattering = self._proposals[self._proposals > 0]
        return float(scattering.min()) / _FACTOR_BELOW, float(scattering.max()) * _FACTOR_ABOVE

    def evaluate(
        self, alpha_scat_per_cm: float, alpha_abs_per_cm: float, *, check: bool = True
    ) -> EtaPoint:
        """Efficiency, its error and its gradient; see `Surface.evaluate`.

        alpha_scat may also be exactly 0: of light that never scatters, only what finds its
        way out without is detected.
        """
        self._refuse_out_of_range(alpha_scat_per_cm, alpha_abs_per_cm)
        strata = np.zeros((len(self._photons), 2))  # sums of c and c^2
        fourth = with_k = with_path = 0.0  # sums of c^4, c k, c L
        with np.errstate(over="ignore", invalid="ignore"):  # judged by the sums below
            for stratum, block, c, square in self._contributions(
                alpha_scat_per_cm, alpha_abs_per_cm
            ):
                np.multiply(c, c, out=square)
                strata[stratum] += (c.sum(), square.sum())
                fourth += square @ square
                with_k += c @ self._k[block]
                with_path += c @ self._path[block]
        total, squares = strata.sum(axis=0)
        if not math.isfinite(squares + with_k + with_path):
            self._refuse_uninformed(alpha_scat_per_cm, alpha_abs_per_cm, 0.0, 0.0)
        photons = self._photons.sum()
        sample = total**2 / squares if squares > 0 else 0.0
        if check:
            variance_sample = squares**2 / fourth if fourth > 0 else 0.0
            self._refuse_uninformed(alpha_scat_per_cm, alpha_abs_per_cm, sample, variance_sample)
        scattered = (
            with_k / alpha_scat_per_cm
            if alpha_scat_per_cm > 0
            else self._scattered_once(alpha_abs_per_cm)
        )
        return EtaPoint(
            eta=float(total / photons),
            sigma=math.sqrt(self._covariance_of_mean(strata[:, 0], strata[:, 0], strata[:, 1])),
            gradient={
                ALPHA_SCAT: float((scattered - with_path) / photons),
                ALPHA_ABS: float(-with_path / photons),
            },
            effective_sample_size=float(sample),
        )

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        sums = np.zeros((len(self._photons), 3))
        walks = (self._contributions(point[ALPHA_SCAT], point[ALPHA_ABS])
                 for point in (first, second))  # fmt: skip
        for (stratum, _, c, _), (_, _, other, _) in zip(*walks, strict=True):
            sums[stratum] += (c.sum(), other.sum(), c @ other)
        return self._covariance_of_mean(*sums.T)

    def _contributions(
        self, alpha_scat: float, alpha_abs: float
    ) -> Iterator[tuple[int, slice, NDArray[np.float64], NDArray[np.float64]]]:
        """Stratum, place, c of the records there, and an array of that size to work in.

        Both arrays are used again for the next block.
        """
        log_scat = math.log(alpha_scat) if alpha_scat > 0 else _LOG_ZERO
        values, scratch = np.empty(_BLOCK), np.empty(_BLOCK)
        for stratum, block in self._blocks:
            size = block.stop - block.start
            c, work = values[:size], scratch[:size]
            np.multiply(self._k[block], log_scat, out=c)
            np.multiply(self._path[block], alpha_scat + alpha_abs, out=work)
            c -= work
            c += self._log_base[block]
            np.exp(c, out=c)
            yield stratum, block, c, work

    def _scattered_once(self, alpha_abs: float) -> float:
        """Limit of sum(c k) / alpha_scat for alpha_scat to 0: the records with k = 1."""
        once = self._k == 1
        return float(np.exp(self._log_base[once] - alpha_abs * self._path[once]).sum())

    def _covariance_of_mean(self, sum_1, sum_2, products) -> float:
        """Covariance of two stratified means from sums per stratum, each (proposals,)."""
        n = self._photons
        within = (products - sum_1 * sum_2 / n) / (n - 1)
        return float(np.sum(n * within)) / n.sum() ** 2

    def _refuse_out_of_range(self, alpha_scat: float, alpha_abs: float) -> None:
        """Refuse coefficients that the proposals do not reach."""
        if not (math.isfinite(alpha_abs) and alpha_abs >= 0):
            raise InputError(
                f"alpha_abs_per_cm = {alpha_abs:g} is not a finite number of 0 or more",
                "give alpha_abs in 1/cm",
            )
        low, high = self.alpha_scat_bounds_per_cm
        # a fit's bounds come back from logarithms: allow for their rounding
        if alpha_scat == 0 or low * (1 - 1e-9) <= alpha_scat <= high * (1 + 1e-9):
            return
        raise InputError(
            f"alpha_scat_per_cm = {alpha_scat:g} is outside {low:g}..{high:g}, what photons "
            f"simulated at {', '.join(f'{a:g}' for a in self._proposals)} /cm can tell",
            "simulate a proposal nearer to it",
        )

    def _refuse_uninformed(
        self, alpha_scat: float, alpha_abs: float, sample: float, variance_sample: float
    ) -> None:
        """Refuse a point where too few photons carry eta or its error."""
        where = f"alpha_scat_per_cm = {alpha_scat:g}, alpha_abs_per_cm = {alpha_abs:g}"
        # Light that total reflection traps flies until it scatters. The square of its
        # contribution goes as exp(-growth L): for a negative one the variance is infinite
        # and no finite sample shows it. Unscattered light (alpha_scat = 0) is not trapped.
        lowest = float(self._proposals[self._proposals > 0].min())
        growth = 2 * (alpha_scat + alpha_abs) - lowest - self._alpha_abs_proposal
        if alpha_scat > 0 and growth < 0:
            raise InputError(
                f"at {where} light flies too far for photons simulated at no less than "
                f"{lowest:g} /cm of scattering and {self._alpha_abs_proposal:g} /cm of absorption",
                "simulate a lower scattering or absorption",
            )
        if sample < _LEAST_EFFECTIVE_SAMPLE or variance_sample < _LEAST_VARIANCE_SAMPLE:
            raise InputError(
                f"at {where} eta rests on {sample:.0f} photons and its error on "
                f"{variance_sample:.0f} (needed: {_LEAST_EFFECTIVE_SAMPLE:.0f} and "
                f"{_LEAST_VARIANCE_SAMPLE:.0f})",
                "simulate more photons, or a scattering and an absorption nearer to these",
            )
