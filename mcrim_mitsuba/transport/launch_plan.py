"""Plans of launches, tallies of what they found, and the records of detected photons.

A plan says which lane follows how many photons, from which proposal, in which statistical batch;
a tally adds launches up and knows how well eta is known, and how many photons that lacks.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core.run import MOST_PHOTONS

#: Lanes of one kernel launch. Fewer lanes with more photons each wait less for the slowest lane of
#: their packet (sums over many photons vary less); more than this gains nothing on two cores.
LANES = 16_384
#: Independent parts of every launch: their spread gives the standard errors, to 4.4 %.
BATCHES = 256
#: Photons of a run's first launch, which compiles the kernel and shows that all is well.
FIRST_LAUNCH = 4 * LANES
#: Lanes that one batch has in a full launch, and so the finest share of a proposal.
SHARE_STEPS = LANES // BATCHES
#: More photons than a precision lacks by the present error, which has an error itself.
MARGIN = 1.06


@dataclass(frozen=True, eq=False)
class LanePlan:
    """Plan of one launch; arrays have shape (lanes,).

    Neighbouring lanes, which share a vector register, follow the same proposal: their
    paths are of like length.
    """

    #: ndarray of int64: Photons that the lane follows, one after the other.
    photons: NDArray[np.int64]
    #: ndarray of int64: Batch that the lane's photons count in, from 0 to below `BATCHES`.
    batch: NDArray[np.int64]
    #: ndarray of int64: Which of the scattering coefficients the lane's photons are drawn with.
    proposal: NDArray[np.int64]
    #: ndarray of int64: Photon s of the lane is number ``rank + stride * s`` of its batch and
    #: proposal.
    rank: NDArray[np.int64]
    stride: NDArray[np.int64]

    @property
    def lanes(self) -> int:
        """How many lanes the launch has."""
        return len(self.photons)

    @property
    def first_slot(self) -> NDArray[np.int64]:
        """(lanes,) number of each lane's first photon among all of the launch."""
        return np.cumsum(self.photons) - self.photons

    def per_batch(self, values: NDArray[np.integer | np.floating]) -> NDArray[np.float64]:
        """(batches,) sums of one value per lane; empty batches of a small launch are left out."""
        return np.asarray(np.bincount(self.batch, values), float)


@functools.lru_cache(maxsize=16)
def plan_lanes(
    photons: int, units: tuple[int, ...] = (SHARE_STEPS,), batches: int = BATCHES
) -> LanePlan:
    """Share photons out among lanes, batches (`BATCHES` at most) and proposals.

    `units` are the proposals' shares, 0 or more, in units of 1 / their sum. This is `SHARE_STEPS`,
    or a part of it for few photons: there are then as many times fewer lanes. With more than one
    proposal the photons are a multiple of the lanes, so that all follow as many.

    Raises ValueError if the shares do not sum to the whole or a part, or if the photons cannot be
    shared out so.
    """
    whole = sum(units)
    if min(units) < 0 or whole <= 0 or SHARE_STEPS % whole:
        problem = f"do not sum to {SHARE_STEPS} or a part of it, or one is negative"
        raise ValueError(f"shares {tuple(units)} {problem}")
    lanes = batches * whole
    if len(units) > 1 and photons % lanes:
        raise ValueError(f"{photons} photons of several proposals: not a multiple of {lanes}")
    lane = np.arange(min(lanes, photons))
    base, extra = divmod(photons, len(lane))
    unit = lane // batches
    # Spread over the lanes, so that every processor gets its part of each proposal's long paths.
    place = np.concatenate([(np.arange(count) + 0.5) / count for count in units])
    order = np.argsort(place, kind="stable")
    proposal = np.repeat(np.arange(len(units)), units)[order]
    return LanePlan(
        photons=base + (lane < extra).astype(np.int64),
        batch=lane % batches,
        proposal=proposal[unit],
        rank=np.concatenate([np.arange(count) for count in units])[order][unit],
        stride=np.asarray(units, dtype=np.int64)[proposal[unit]],
    )


#: What begins the name of the light that one of several detectors took.
_BY_DETECTOR = "detected by "


def detected_by(detector: str) -> str:
    """Name of the light that one of several detectors took, among the sums of a tally."""
    return f"{_BY_DETECTOR}{detector}"


@dataclass
class FateTally:
    """Weights per fate, accumulated over launches; tallies can be merged.

    A batch's photons are independent of other batches', so the spread between
    batches gives every fate's standard error, whatever the weights and however
    evenly the photons of one batch are spread.
    """

    photons: int = 0
    batches: int = 0
    #: Weight that met each fate, and what each of several detectors took (`detected_by`).
    sums: dict[str, float] = field(default_factory=dict)
    #: Sum over batches of (weight in the batch)^2 / (photons of the batch).
    squares: dict[str, float] = field(default_factory=dict)
    #: What the detector detects of light that arrives head-on, with which it was calibrated.
    head_on: float = 1.0
    #: Of the sums, that which is eta.
    counted: str = "detected"

    def add(self, photons_per_batch: np.ndarray, weights: dict[str, np.ndarray]) -> None:
        """Take in one launch: photons (int) and weights per fate (float64) of its batches."""
        photons, batches = int(photons_per_batch.sum()), len(photons_per_batch)
        sums = {name: float(values.sum()) for name, values in weights.items()}
        squares = {n: float(np.sum(values**2 / photons_per_batch)) for n, values in weights.items()}
        self.merge(FateTally(photons, batches, sums, squares))

    def merge(self, other: FateTally) -> None:
        """Take in what another one has tallied."""
        self.photons += other.photons
        self.batches += other.batches
        for mine, theirs in ((self.sums, other.sums), (self.squares, other.squares)):
            for name, value in theirs.items():
                mine[name] = mine.get(name, 0.0) + value

    def fraction(self, name: str) -> float:
        """Fraction of the emitted energy that met a fate."""
        return self.sums[name] / self.photons

    def sigma(self, name: str) -> float:
        """Standard error of `fraction`.

        Where no photon met the fate the spread is zero and says nothing; one
        photon's worth is given, which is an upper limit at 63 % confidence.
        """
        if self.sums[name] == 0.0 or self.batches < 2:
            return 1.0 / self.photons
        spread = self.squares[name] - self.sums[name] ** 2 / self.photons
        return float(np.sqrt(max(spread, 0.0) / (self.batches - 1) / self.photons))

    @property
    def budget(self) -> dict[str, float]:
        """`fraction` of every fate."""
        return {n: self.fraction(n) for n in self.sums if not n.startswith(_BY_DETECTOR)}

    @property
    def budget_sigma(self) -> dict[str, float]:
        """`sigma` of every fate."""
        return {name: self.sigma(name) for name in self.budget}

    @property
    def by_detector(self) -> dict[str, tuple[float, float]]:
        """Eta of each of several detectors, and its standard error."""
        names = (n for n in self.sums if n.startswith(_BY_DETECTOR))
        etas = {n: (self.fraction(n) / self.head_on, self.sigma(n) / self.head_on) for n in names}
        return {name.removeprefix(_BY_DETECTOR): eta for name, eta in etas.items()}

    @property
    def eta(self) -> float:
        """Light collection efficiency: what is counted, over what is of light head-on."""
        return self.fraction(self.counted) / self.head_on

    @property
    def eta_sigma(self) -> float:
        """Its standard error."""
        return self.sigma(self.counted) / self.head_on

    def reaches(self, precision: float | None) -> bool:
        """Whether eta is known to a relative standard error; none is never reached."""
        if precision is None or not self.photons:
            return False
        return self.eta > 0 and self.eta_sigma <= precision * self.eta

    def lacking(self, precision: float) -> int:
        """Photons that a relative error of eta still takes, by the present one; whole lanes."""
        if self.eta <= 0:
            return MOST_PHOTONS
        more = self.photons * (MARGIN * (self.eta_sigma / (precision * self.eta)) ** 2 - 1.0)
        return LANES * max(4, math.ceil(min(more, MOST_PHOTONS) / LANES))


# What a simulation hands the fit: the histories of the detected photons.

_KINDS = {
    "k": np.uint32,
    "path_cm": np.float32,
    "w": np.float32,
    "batch": np.uint8,
    "photons_per_proposal": np.int64,
    "alpha_scat_proposals_per_cm": np.float64,
}


@dataclass(frozen=True, eq=False)
class PhotonRecords:
    """Histories of a configuration's detected photons; ValueError for what no simulation gives."""

    #: (detected,) uint32: Scatterings in the crystal.
    k: NDArray[np.uint32]
    #: (detected,) float32: Path in the crystal.
    path_cm: NDArray[np.float32]
    #: (detected,) float32: Weight at detection at the proposals' absorption: an unbiased estimate
    #: of exp(-alpha_abs_proposal_per_cm path_cm), times whatever else dims the photon, times what
    #: the detector detects of it over what it does of light that arrives head-on.
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
        columns: list[NDArray] = [self.k, self.path_cm, self.w, self.batch, *self.further.values()]
        if len({len(column) for column in columns}) != 1:
            raise ValueError(
                f"k, path_cm, w, batch{''.join(f', {n}' for n in self.further)} differ in length"
            )
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
