"""Mergeable tallies of photon fates: counts, sums and spread, in float64."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class FateTally:
    """Weights per fate, accumulated over launches.

    A lane's photons are independent of other lanes', so the spread between
    lanes gives every fate's standard error, whatever the weights.

    Attributes
    ----------
    photons, lanes : int
    sums : dict of str to float
        Weight that met each fate.
    squares : dict of str to float
        Sum over lanes of (weight in the lane)^2 / (photons of the lane).
    """

    photons: int = 0
    lanes: int = 0
    sums: dict[str, float] = field(default_factory=dict)
    squares: dict[str, float] = field(default_factory=dict)

    def add(self, photons_per_lane: np.ndarray, weights: dict[str, np.ndarray]) -> None:
        """Take in one launch: photons per lane (int) and weight per fate and lane (float64)."""
        self.photons += int(photons_per_lane.sum())
        self.lanes += len(photons_per_lane)
        for name, values in weights.items():
            square = float(np.sum(values**2 / photons_per_lane))
            self.sums[name] = self.sums.get(name, 0.0) + float(values.sum())
            self.squares[name] = self.squares.get(name, 0.0) + square

    def fraction(self, name: str) -> float:
        """Fraction of the emitted energy that met a fate."""
        return self.sums[name] / self.photons

    def sigma(self, name: str) -> float:
        """Standard error of `fraction`.

        Where no photon met the fate the spread is zero and says nothing; one
        photon's worth is given, which is an upper limit at 63 % confidence.
        """
        if self.sums[name] == 0.0 or self.lanes < 2:
            return 1.0 / self.photons
        spread = self.squares[name] - self.sums[name] ** 2 / self.photons
        return float(np.sqrt(max(spread, 0.0) / (self.lanes - 1) / self.photons))
