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

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.efficiency.cells import FACTOR_ABOVE, CellSums
from mcrim_mitsuba.efficiency.surface import Coefficients, EfficiencySurface, EtaPoint
from mcrim_mitsuba.transport.launch_plan import SHARE_STEPS, PhotonRecords, ScatteringProposals

# Where fewer photons than these carry eta, or carry its error (the same measure of the
# squares), neither can be trusted. The second is the one that shows missing photons: eta was
# 50 % low with an effective sample of 1300. Compared with direct runs of the NumPy tracer (the
# article's bench, air gap, 8e4 and 4e5 photons), what all limits of this module let through
# was 3.3 sigma off at worst in 800 comparisons; without them, 47 sigma.
_LEAST_EFFECTIVE_SAMPLE = 100.0
_LEAST_VARIANCE_SAMPLE = 10.0

# How far below the lowest proposal alpha_scat may go, by the same comparisons.
_FACTOR_BELOW = 10.0

# Fourth powers of exp of the first are normal numbers, as is exp of the second in single precision.
_LEAST_LOG, _LEAST_LOG_SINGLE = -170.0, -80.0

# Values of k per path that are tried, and a share that is 0 but for its logarithm.
_RATES, _FAINTEST = 200, 1e-12

# Stands for log(0): times k it ends every photon that scattered and leaves k = 0 alone.
_LOG_ZERO = -1e300


class EtaSurface(EfficiencySurface):
    """The light collection efficiency of one configuration at any alpha_scat and alpha_abs.

    The statistical error is the spread between independent batches of photons.
    """

    def __init__(self, gathered: CellSums) -> None:
        self.alpha_scat_proposals_per_cm = gathered.alpha_scat_proposals_per_cm
        self.alpha_abs_proposal_per_cm = gathered.alpha_abs_proposal_per_cm
        self.photons = gathered.photons
        self._shares = gathered.photons_per_proposal / gathered.photons
        # proposals that scatter, rising
        drawn = np.unique(self.alpha_scat_proposals_per_cm[self._shares > 0])
        self._drawn_per_cm = drawn[drawn > 0]
        self._cells, self._batch_cells = gathered.cells(), gathered.batch_cells()
        self._k = np.tile(self._cells.k, 2)
        spread = np.stack([self._cells.spread_cm, -self._cells.spread_cm])
        self._path = (self._cells.path_cm + spread).ravel()
        with np.errstate(divide="ignore"):  # a weight of 0 contributes exp(-inf) = 0
            log_weight = np.tile(np.log(self._cells.weight / 2), 2)
        # all of the logarithms that does not depend on the target, of both points of a cell ...
        self._log_base = log_weight + self._log_over_mixture(self._k, self._path)
        # ... and at the mean paths, where errors are summed
        self._log_base_mean = self._log_over_mixture(self._cells.k, self._cells.path_cm)
        self._log_base_batch = self._log_over_mixture(
            self._batch_cells.k, self._batch_cells.path_cm
        )

    @classmethod
    def of(cls, *records: PhotonRecords) -> EtaSurface:
        """The surface of one or more chunks of records of one configuration."""
        first, *others = records
        gathered = CellSums(first)
        for chunk in others:
            gathered.add(chunk)
        return cls(gathered)

    def _log_over_mixture(
        self, k: NDArray[np.float64], path_cm: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """-log of exp(-a_a0 L) sum_j (N_j / N) a_j^k exp(-a_j L), shaped like `k`."""
        mixture = np.full(len(k), -np.inf)
        for share, proposal in zip(self._shares, self.alpha_scat_proposals_per_cm, strict=True):
            if share > 0:
                log_density = math.log(share) + _log_target(k, path_cm, proposal, 0.0)
                np.logaddexp(mixture, log_density, out=mixture)
        return self.alpha_abs_proposal_per_cm * path_cm - mixture

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        scattering = self.alpha_scat_proposals_per_cm[self.alpha_scat_proposals_per_cm > 0]
        return float(scattering.min()) / _FACTOR_BELOW, float(scattering.max()) * FACTOR_ABOVE

    # two parameters are all that it has
    def _point(  # type: ignore[override]
        self, target: Coefficients, check: bool, errors: bool
    ) -> EtaPoint:
        """See `EfficiencySurface.evaluate`; alpha_scat may also be exactly 0.

        Of light that never scatters, only what finds its way out without is detected.
        """
        alpha_scat, alpha_abs = target
        self._refuse_out_of_range(*target)
        with np.errstate(over="ignore", invalid="ignore"):  # judged by the sums below
            c = _exp(self._log_base + _log_target(self._k, self._path, *target))
            total, with_k, with_path = c.sum(), _dot(c, self._k), _dot(c, self._path)
            samples = self._samples(target, total) if check or errors else (math.nan, math.nan)
        # squares overflow first, and nothing that matters is so large
        if not math.isfinite(total * total + with_k + with_path):
            self._refuse_uninformed(*target, 0.0, 0.0)
        if check:
            self._refuse_uninformed(*target, *samples)
        if alpha_scat > 0:
            scattered = with_k / alpha_scat
        else:
            # the limit for alpha_scat to 0: the cells with k = 1
            once = self._k == 1
            left = self._log_base[once] - alpha_abs * self._path[once]
            scattered = float(np.exp(left).sum())
        return EtaPoint(
            eta=float(total / self.photons),
            sigma=math.sqrt(_covariance(*[self.batches(*target)] * 2)) if errors else math.nan,
            gradient={
                ALPHA_SCAT: float((scattered - with_path) / self.photons),
                ALPHA_ABS: float(-with_path / self.photons),
            },
            effective_sample_size=samples[0],
        )

    def _samples(self, target: Coefficients, total: float) -> tuple[float, float]:
        """How many photons of equal weight carry eta, and how many its error."""
        log_target = _log_target(self._cells.k, self._cells.path_cm, *target)
        mean = _exp(self._log_base_mean + log_target)
        square = mean * mean
        squares = _dot(square, self._cells.weight2)
        fourth = _dot(square * square, self._cells.weight4)
        if not math.isfinite(fourth) or squares == 0 or fourth == 0:
            return 0.0, 0.0
        return float(total**2 / squares), squares**2 / fourth

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        return _covariance(
            *(self.batches(point[ALPHA_SCAT], point[ALPHA_ABS]) for point in (first, second))
        )

    def answer(self, point: Coefficients) -> EtaPoint | None:
        """`evaluate` without an error; None where it refuses."""
        try:
            return self.evaluate(*point, errors=False)
        except InputError:
            return None

    def evaluate_all(self, points: Sequence[Coefficients]) -> list[EtaPoint | None]:
        """`evaluate` at many points; None where it refuses."""
        found = [self.answer(point) for point in points]
        answered = [point for point, known in zip(points, found, strict=True) if known]
        sigmas = iter(self.relative_sigmas(answered))
        return [
            known and dataclasses.replace(known, sigma=float(next(sigmas)) * known.eta)
            for known in found
        ]

    def relative_sigmas(self, points: Sequence[Coefficients]) -> NDArray[np.float64]:
        """(points,) sigma / eta, unchecked: one product of matrices for all points at once."""
        columns = np.array(points, dtype=np.float64).reshape(-1, 2).T[:, :, None]
        density = np.exp(np.maximum(self._log_batch_density(*columns), _LEAST_LOG_SINGLE))
        # single precision is four times as fast, and errors need no more
        batches = density.astype(np.float32) @ self._batch_cells.weight.astype(np.float32)
        return batches.std(axis=1, ddof=1) / batches.shape[1] ** 0.5 / batches.mean(axis=1)

    def design(
        self, points: Sequence[Coefficients]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What decides the errors that other shares of the proposals would have.

        With density p_j of proposal j, the second moment of a photon's contribution at a point
        is E[f^2 / mixture], a sum over cells.

        Returns
        -------
        densities : (proposals, cells) float64
            p_j relative to the present mixture.
        squares : (points, cells) float64
            Second moments under the present mixture, relative to eta^2, by cell.
        cost : (proposals,) float64
            Time that a photon of each proposal takes, relative: its steps go with the path.
        """
        cells = self._batch_cells
        k, path = cells.k, cells.path_cm
        log_over = self._log_base_batch - self.alpha_abs_proposal_per_cm * path
        logarithms = [
            log_over + _log_target(k, path, a, 0.0) for a in self.alpha_scat_proposals_per_cm
        ]
        densities = _exp(np.array(logarithms))
        squares = np.empty((len(points), len(k)))
        for row, point in zip(squares, points, strict=True):
            c = _exp(self._log_batch_density(*point))
            total = _dot(c, cells.total) / self.photons
            row[:] = c * c * cells.squares / self.photons / total**2
        paths = (densities * cells.total) @ path / self.photons
        return densities, squares, 1.0 + paths / paths.mean()

    def batches(self, alpha_scat: float, alpha_abs: float) -> NDArray[np.float64]:
        """(batches,) eta as every batch alone finds it, for errors: all may be 0.2 % off."""
        density = _exp(self._log_batch_density(alpha_scat, alpha_abs))
        sums = self._batch_cells.weight
        return np.einsum("cb,c->b", sums, density) * (sums.shape[1] / self.photons)

    def _log_batch_density(
        self, alpha_scat: float | NDArray[np.float64], alpha_abs: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(cells,) logarithm of target over mixture; (points, cells) for columns."""
        cells = self._batch_cells
        return self._log_base_batch + _log_target(cells.k, cells.path_cm, alpha_scat, alpha_abs)

    def _refuse_out_of_range(self, alpha_scat: float, alpha_abs: float) -> None:
        """Refuse coefficients that the proposals do not reach."""
        if not (math.isfinite(alpha_abs) and alpha_abs >= 0):
            problem = f"alpha_abs_per_cm = {alpha_abs:g} is not a finite number of 0 or more"
            raise InputError(problem, "give alpha_abs in 1/cm")
        low, high = self.alpha_scat_bounds_per_cm
        # a fit's bounds come back from logarithms: allow for their rounding
        if alpha_scat == 0 or low * (1 - 1e-9) <= alpha_scat <= high * (1 + 1e-9):
            return
        simulated = ", ".join(f"{a:g}" for a in self.alpha_scat_proposals_per_cm)
        raise InputError(
            f"alpha_scat_per_cm = {alpha_scat:g} is outside {low:g}..{high:g}, what photons "
            f"simulated at {simulated} /cm can tell",
            "simulate a proposal nearer to it",
        )

    def _refuse_uninformed(
        self, alpha_scat: float, alpha_abs: float, sample: float, variance_sample: float
    ) -> None:
        """Refuse a point where too few photons carry eta or its error."""
        where = f"alpha_scat_per_cm = {alpha_scat:g}, alpha_abs_per_cm = {alpha_abs:g}"
        # Unscattered light (alpha_scat = 0) is not trapped.
        if alpha_scat > 0 and self._falls_per_cm(alpha_scat, alpha_abs) < 0:
            simulated = ", ".join(f"{a:g}" for a in self._drawn_per_cm)
            raise InputError(
                f"at {where} light flies too far for photons simulated at {simulated} /cm of "
                f"scattering and {self.alpha_abs_proposal_per_cm:g} /cm of absorption",
                "simulate a scattering nearer to it, or a lower absorption",
            )
        if sample < _LEAST_EFFECTIVE_SAMPLE or variance_sample < _LEAST_VARIANCE_SAMPLE:
            raise InputError(
                f"at {where} eta rests on {sample:.0f} photons (needed: "
                f"{_LEAST_EFFECTIVE_SAMPLE:.0f}), and the estimate of its error on "
                f"{variance_sample:.0f}, those that weigh most there (needed: "
                f"{_LEAST_VARIANCE_SAMPLE:.0f})",
                "simulate more photons, or a scattering and an absorption nearer to these",
            )

    @cached_property
    def _trapped_shares(self) -> NDArray[np.float64]:
        """(drawn,) of light scattered at each proposal, the part that scatters again.

        Without absorption. Where it is P, numbers of scatterings k > 0 fall as P^k, and
        P / (1 - P) is the sum of k (k - 1) over that of 2 k.
        """
        k, absorption, drawn = self._cells.k, self.alpha_abs_proposal_per_cm, self._drawn_per_cm
        target = _log_target(k, self._cells.path_cm, drawn[:, None], absorption)
        c = _exp(self._log_base_mean + target) * self._cells.weight
        again, scattered = np.einsum("dc,pc->pd", c, np.stack([k * (k - 1), 2.0 * k]))
        shares = again / np.maximum(again + scattered, _FAINTEST) * (1.0 + absorption / drawn)
        return np.clip(shares, _FAINTEST, 1.0)

    def _falls_per_cm(self, alpha_scat: float, alpha_abs: float) -> float:
        """How fast squared contributions of trapped light fall with its path (docs/theory.md).

        Below 0 their variance is infinite, and no finite sample shows it. With the part p that
        stays, proposal j alone has 2 (alpha_scat + alpha_abs) - a_j - a_0 - p alpha_scat^2 / a_j.
        Of several the one with most photons counts, at the k per path where that leaves most.
        """
        drawn = self._drawn_per_cm[:, None]
        scatters = alpha_scat**2 / drawn
        stays = scatters * np.interp(scatters, drawn[:, 0], self._trapped_shares)
        k_per_cm = np.geomspace(stays.min(), stays.max(), _RATES)
        grows = (drawn + k_per_cm * (1.0 + np.log(stays / k_per_cm))).min(axis=0).max()
        return float(2.0 * (alpha_scat + alpha_abs) - grows - self.alpha_abs_proposal_per_cm)


def _log_target(
    k: NDArray[np.float64],
    path_cm: NDArray[np.float64],
    alpha_scat: float | NDArray[np.float64],
    alpha_abs: float | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Logarithm of a_s^k exp(-(a_s + a_a) L), shaped like `k`, or broadcast with columns."""
    with np.errstate(divide="ignore"):
        log_scat = np.maximum(np.log(alpha_scat), _LOG_ZERO)
    return log_scat * k - (alpha_scat + alpha_abs) * path_cm


def _exp(logarithm: NDArray[np.float64]) -> NDArray[np.float64]:
    """exp, never below 1e-74: subnormal numbers, and powers that become so, take a hundred times
    as long, and nobody misses such contributions."""
    return np.exp(np.maximum(logarithm, _LEAST_LOG))


def _dot(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Scalar product without BLAS, whose threads take longer to wake than the sum takes."""
    return float(np.einsum("i,i->", first, second))


def _covariance(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Covariance of two means from values of the same independent batches."""
    batches = len(first)
    products = _dot(first - first.mean(), second - second.mean())
    return products / (batches * (batches - 1))


# Which scattering coefficients to simulate so that a range of them can be answered.

# Ratio of neighbouring proposals where light scatters a few times; it shrinks where light
# scatters often, because the number of scatterings then tells proposals apart.
_LARGEST_RATIO = 3.2
# Scattering coefficient (1/cm) around which that begins on benches of a centimetre.
_MANY_SCATTERINGS_PER_CM = 2.0
# A proposal below this wastes photons on light that stays trapped; weights reach down from it.
_LOWEST_PROPOSAL_PER_CM = 0.04
# How far above the highest proposal weights reach where light scatters a few times.
_REACH_ABOVE = 0.2
# Below this, light that total reflection traps hardly ever scatters within the depth limit.
_SMALLEST_PER_CM = 1e-3

# Exponent of the p-norm that stands for a maximum, so that there are slopes.
_SHARPNESS = 30.0
# Relative gain in time below which shares are good enough.
_ENOUGH = 1e-4


def choose_proposals(
    lowest_per_cm: float,
    highest_per_cm: float,
    lowest_alpha_abs_per_cm: float,
    units: int = SHARE_STEPS,
) -> ScatteringProposals:
    """Proposals that cover a range of alpha_scat with shares as equal as so many units allow.

    The least absorption that will be asked for is also simulated.
    """
    # Weights keep a finite variance, however much scattered light stays trapped, where
    # 2 (alpha_scat + alpha_abs) > a_j + a_0 + alpha_scat^2 / a_j: up to the root for a_j.
    both = 2.0 * lowest_per_cm + lowest_alpha_abs_per_cm
    reachable = 0.45 * (both + math.sqrt(both**2 - 4.0 * lowest_per_cm**2))
    low = max(lowest_per_cm, min(_LOWEST_PROPOSAL_PER_CM, reachable), _SMALLEST_PER_CM)
    # weights reach a little higher, and less so where the number of scatterings is sharper
    reach = _REACH_ABOVE / (1.0 + highest_per_cm / _MANY_SCATTERINGS_PER_CM)
    high = max(highest_per_cm / (1.0 + reach), 2.0 * low)
    proposals = [low]
    while proposals[-1] < high:
        last = proposals[-1]
        step = np.log(_LARGEST_RATIO) / (1.0 + last / _MANY_SCATTERINGS_PER_CM)
        proposals.append(last * np.exp(step))
    # the last step is shortened, and with it all the others, so that they end at the top
    stretch = np.log(high / low) / np.log(proposals[-1] / low)
    values = low * (np.array(proposals) / low) ** stretch
    equal = np.full(len(values), 1.0 / len(values))
    return ScatteringProposals(
        tuple(values.tolist()), _in_units(equal, units), lowest_alpha_abs_per_cm
    )


def improve_shares(surface: EtaSurface, points: Sequence[Coefficients]) -> ScatteringProposals:
    """Shares that make a surface's largest relative error over some points as small as they can.

    What each share would do to the errors is read off a surface that has been simulated with
    any shares. Time is part of the bargain: a photon of a low proposal flies for longer.
    """
    densities, squares, cost = surface.design(points)

    def worst(logits: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Log of time for a given worst error (smoothed), and its slopes."""
        shares = np.exp(logits - logsumexp(logits))
        mixture = shares @ densities
        over = squares / mixture
        variances = over.sum(axis=1)
        time = shares @ cost
        log_worst = logsumexp(_SHARPNESS * np.log(variances)) / _SHARPNESS
        heed = np.exp(_SHARPNESS * (np.log(variances) - log_worst))
        of_shares = -(heed / variances) @ (over @ (densities / mixture).T) + cost / time
        slopes = shares * (of_shares - shares @ of_shares)
        return float(log_worst + np.log(time)), slopes

    start = np.zeros(len(cost))
    found = minimize(
        worst,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(-6.0, 3.0)] * len(start),
        options={"ftol": _ENOUGH},
    )
    shares = np.exp(found.x - logsumexp(found.x))
    # less than half a unit is not worth a lane; the lowest says how far down weights may reach
    shares[1:][shares[1:] * SHARE_STEPS < 0.5] = 0.0
    return ScatteringProposals(
        tuple(surface.alpha_scat_proposals_per_cm.tolist()),
        _in_units(shares / shares.sum()),
        surface.alpha_abs_proposal_per_cm,
    )


def _in_units(shares: NDArray[np.float64], units: int = SHARE_STEPS) -> tuple[int, ...]:
    """Whole numbers in these proportions with a sum of `units`; only a share of 0 gets 0."""
    least = (shares > 0).astype(int)
    whole = np.maximum(np.floor(shares * units).astype(int), least)
    while whole.sum() != units:
        lacking = shares * units - whole
        if whole.sum() < units:
            whole[np.argmax(lacking)] += 1
        else:
            whole[np.argmin(np.where(whole > least, lacking, np.inf))] -= 1
    return tuple(whole.tolist())
