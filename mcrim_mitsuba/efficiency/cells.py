"""Photon histories gathered in small cells of scatterings and path, chunk by chunk.

All that eta at any coefficients needs of a history is its number k of scatterings and its path
L in the crystal, and what it multiplies them with is smooth in L. So histories of equal k and
nearly equal L are kept together: the sums of w, w L and w L^2 of a cell stand for it as two
points at its mean path plus and minus the standard deviation, a Gauss rule. Over a cell of width
h, exp(-a L) is then summed to (a h)^4 / 4320 at worst, far below any Monte Carlo error, in
memory and time that do not grow with the number of photons. Where light scatters often, k tells
its path to within L / sqrt(k), and cells may be wider by as much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.transport.launch_plan import PhotonRecords

#: How far above the highest proposal alpha_scat may go: see `efficiency.reweighting`.
FACTOR_ABOVE = 1.5
# Width of a cell times the largest coefficient that the proposals were made for.
_WIDTH = 0.4
# Short paths are what large coefficients see: there, cells of a tenth of the path from here on.
_FINE_CM, _FINE_CELLS = 0.01, 10.0
# Cells of k scatterings are wider by 1 + sqrt(k) / this.
_WIDENING = 8.0
# Errors need less: sums by batch have cells as wide as this many, and numbers of scatterings
# between n^2 / 16 and (n + 1)^2 / 16 share one.
_COARSER, _PER_ROOT = 4.0, 4.0
# Batch sums beyond this many numbers are merged in pairs, at the price of a less sure error.
_MOST_SUMS = 30_000_000
# Keys up to this many are looked up in a table instead of being sorted.
_MOST_KEYS = 8_000_000


@dataclass(frozen=True, eq=False)
class Cells:
    """Sums over the histories of every cell; float64 arrays of shape (cells,)."""

    #: Scatterings.
    k: NDArray[np.float64]
    #: Weighted mean and standard deviation of the path.
    path_cm: NDArray[np.float64]
    spread_cm: NDArray[np.float64]
    #: Sums of w, w^2 and w^4.
    weight: NDArray[np.float64]
    weight2: NDArray[np.float64]
    weight4: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BatchCells:
    """Sums by batch over the histories of wider cells."""

    #: (cells,) float64: Weighted means of scatterings and path.
    k: NDArray[np.float64]
    path_cm: NDArray[np.float64]
    #: (cells,) float64: Sums of w and w^2 over all batches.
    total: NDArray[np.float64]
    squares: NDArray[np.float64]
    #: (cells, batches) float64: Sums of w.
    weight: NDArray[np.float64]


class CellSums:
    """Gathers chunks of photon records of one configuration.

    Chunks have the same proposals and batches; the shares of the proposals may differ. Cells
    resolve the largest coefficients that the proposals are made for; larger ones are still
    resolved where they see short paths.
    """

    def __init__(self, first: PhotonRecords) -> None:
        self.alpha_scat_proposals_per_cm = first.alpha_scat_proposals_per_cm
        self.alpha_abs_proposal_per_cm = float(first.alpha_abs_proposal_per_cm)
        #: (proposals,) int64: Emitted so far.
        self.photons_per_proposal = np.zeros(len(first.photons_per_proposal), dtype=np.int64)
        largest_per_cm = FACTOR_ABOVE * float(first.alpha_scat_proposals_per_cm.max())
        self._cell_cm = _WIDTH / (largest_per_cm + self.alpha_abs_proposal_per_cm)
        self._batches = first.batches
        self._cells = _Sums(5)
        self._by_batch = _Sums(3 + self._batches)
        self.add(first)

    @property
    def photons(self) -> int:
        """Photons emitted so far."""
        return int(self.photons_per_proposal.sum())

    def merge(self, other: CellSums) -> None:
        """Take in what another one has gathered, of the same proposals and with the same cells."""
        self.photons_per_proposal += other.photons_per_proposal
        self._cells.add(other._cells.keys, other._cells.sums)
        self._by_batch.add(other._by_batch.keys, other._by_batch.sums)

    def to_arrays(self) -> tuple[dict[str, NDArray], dict[str, object]]:
        """All of it as arrays of one dimension and what JSON can hold; see `from_arrays`."""
        by_batch = self._by_batch.sums.ravel()
        # a launch fills few cells of a batch
        filled = np.flatnonzero(by_batch)
        return {
            "keys": self._cells.keys,
            "sums": self._cells.sums.ravel(),
            "batch_keys": self._by_batch.keys,
            "batch_places": filled.astype(np.uint32),
            "batch_sums": by_batch[filled],
        }, {
            "photons_per_proposal": self.photons_per_proposal.tolist(),
            "alpha_scat_proposals_per_cm": self.alpha_scat_proposals_per_cm.tolist(),
            "alpha_abs_proposal_per_cm": self.alpha_abs_proposal_per_cm,
            "cell_cm": self._cell_cm,
            "batches": self._batches,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], metadata: Mapping[str, Any]) -> CellSums:
        """What `to_arrays` gave, to the last digit."""
        made = cls.__new__(cls)
        made.alpha_scat_proposals_per_cm = np.array(metadata["alpha_scat_proposals_per_cm"])
        made.alpha_abs_proposal_per_cm = float(metadata["alpha_abs_proposal_per_cm"])
        made.photons_per_proposal = np.array(metadata["photons_per_proposal"], dtype=np.int64)
        made._cell_cm, made._batches = float(metadata["cell_cm"]), int(metadata["batches"])
        made._cells, made._by_batch = _Sums(5), _Sums(3 + made._batches)
        made._cells.add(arrays["keys"], arrays["sums"].reshape(-1, 5))
        by_batch = np.zeros(len(arrays["batch_keys"]) * (3 + made._batches))
        by_batch[arrays["batch_places"]] = arrays["batch_sums"]
        made._by_batch.add(arrays["batch_keys"], by_batch.reshape(-1, 3 + made._batches))
        return made

    def add(self, records: PhotonRecords) -> None:
        """Take in one more chunk."""
        self.photons_per_proposal += records.photons_per_proposal
        w = records.w.astype(np.float64)
        path = records.path_cm.astype(np.float64)
        root = np.sqrt(records.k.astype(np.float32))
        wider = 1.0 + root / np.float32(_WIDENING)
        keys, place = _distinct(_key(records.path_cm, self._cell_cm * wider, 1.0, records.k))
        terms = (w, w * path, w * path * path, w * w, w**4)
        self._cells.add(keys, np.stack([np.bincount(place, t, len(keys)) for t in terms], axis=1))
        group = (np.float32(_PER_ROOT) * root).astype(np.int64)
        wider = _COARSER * (1.0 + group / np.float32(_PER_ROOT * _WIDENING))
        keys, place = _distinct(_key(records.path_cm, self._cell_cm * wider, _COARSER, group))
        weighted = (w * records.k, w * path, w * w)
        moments = [np.bincount(place, t, len(keys)) for t in weighted]
        place = place * self._batches + records.batch
        by_batch = np.bincount(place, w, len(keys) * self._batches).reshape(-1, self._batches)
        self._by_batch.add(keys, np.column_stack([*moments, by_batch]))

    def cells(self) -> Cells:
        """What was gathered so far."""
        weight, first, second, weight2, weight4 = np.ascontiguousarray(self._cells.sums.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(weight > 0, first / weight, 0.0)
            variance = np.where(weight > 0, second / weight - mean**2, 0.0)
        # rounding can make a variance negative, or put a point below a path of 0
        spread = np.minimum(np.sqrt(np.maximum(variance, 0.0)), mean)
        scatterings = (self._cells.keys & 0xFFFF).astype(np.float64)
        return Cells(scatterings, mean, spread, weight, weight2, weight4)

    def batch_cells(self) -> BatchCells:
        """What was gathered so far, by batch."""
        in_k, in_path, squares = np.ascontiguousarray(self._by_batch.sums[:, :3].T)
        by_batch = self._by_batch.sums[:, 3:]
        total = by_batch.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            k, path = (np.where(total > 0, sums / total, 0.0) for sums in (in_k, in_path))
        while by_batch.size > _MOST_SUMS and by_batch.shape[1] % 2 == 0:
            by_batch = by_batch[:, ::2] + by_batch[:, 1::2]
        return BatchCells(k, path, total, squares, by_batch)


class _Sums:
    """Sums by key, (keys, columns) float64, that grow with the keys."""

    def __init__(self, columns: int) -> None:
        self.keys = np.empty(0, dtype=np.int64)
        self.sums = np.empty((0, columns))

    def add(self, keys: NDArray[np.int64], sums: NDArray[np.float64]) -> None:
        """Add (keys, columns) sums of sorted, distinct keys."""
        everywhere = np.union1d(self.keys, keys)
        if len(everywhere) > len(self.keys):
            wider = np.zeros((len(everywhere), sums.shape[1]))
            wider[np.searchsorted(everywhere, self.keys)] = self.sums
            self.keys, self.sums = everywhere, wider
        self.sums[np.searchsorted(everywhere, keys)] += sums


def _key(
    path_cm: NDArray, cell_cm: NDArray, fine: float, group: NDArray[np.integer]
) -> NDArray[np.int64]:
    """(detected,) a number that histories of one cell share.

    Cells are `cell_cm` wide, those of short paths `fine` tenths of the path. What else they share,
    `group`, is the low 16 bits of the key.
    """
    per_path = np.float32(_FINE_CELLS / fine)
    cell = path_cm / cell_cm + per_path * np.log1p(path_cm / np.float32(_FINE_CM))
    return (cell.astype(np.int64) << 16) | group


def _distinct(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Distinct keys, sorted, and the place of every key among them."""
    if not len(keys):
        return np.unique(keys, return_inverse=True)
    # k takes 16 bits of a key, but few values: close the gaps
    most = int((keys & 0xFFFF).max()) + 1
    if ((int(keys.max()) >> 16) + 1) * most > _MOST_KEYS:
        return np.unique(keys, return_inverse=True)
    dense = (keys >> 16) * most + (keys & 0xFFFF)
    occupied = np.flatnonzero(np.bincount(dense))
    place = np.empty(occupied[-1] + 1, dtype=np.int64)
    place[occupied] = np.arange(len(occupied))
    return (occupied // most << 16) | (occupied % most), place[dense]
