"""Mergeable tallies of photon fates: counts, sums and spread, in float64."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class FateTally:
    """Weights per fate, accumulated over launches.

    A batch's photons are independent of other batches', so the spread between
    batches gives every fate's standard error, whatever the weights and however
    evenly the photons of one batch are spread.

    Attributes
    ----------
    photons, batches : int
    sums : dict of str to float
        Weight that met each fate.
    squares : dict of str to float
        Sum over batches of (weight in the batch)^2 / (photons of the batch).
    """

    photons: int = 0
    batches: int = 0
    sums: dict[str, float] = field(default_factory=dict)
    squares: dict[str, float] = field(default_factory=dict)

    def add(self, photons_per_batch: np.ndarray, weights: dict[str, np.ndarray]) -> None:
        """Take in one launch: photons (int) and weights per fate (float64) of its batches."""
        self.photons += int(photons_per_batch.sum())
        self.batches += len(photons_per_batch)
        for name, values in weights.items():
            square = float(np.sum(values**2 / photons_per_batch))
            self.sums[name] = self.sums.get(name, 0.0) + float(values.sum())
            self.squares[name] = self.squares.get(name, 0.0) + square

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
