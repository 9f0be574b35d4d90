"""What happens to light inside a medium: free paths, absorption, scattering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Medium:
    """A transparent medium; its scattering may grow linearly from z = 0 to z = ``height_mm``.

    With u = 2 z / height - 1, the scattering coefficient at z is
    ``scattering_per_mm`` (1 + ``gradient`` u).

    Attributes
    ----------
    index : float
    absorption_per_mm, scattering_per_mm : float
    gradient : float
        From -1 to 1.
    height_mm : float
        Without meaning where there is no gradient.
    """

    index: float
    absorption_per_mm: float = 0.0
    scattering_per_mm: float = 0.0
    gradient: float = 0.0
    height_mm: float = 1.0

    @property
    def extinction_per_mm(self) -> float:
        """Absorption and scattering together, at middle height."""
        return self.absorption_per_mm + self.scattering_per_mm

    def free_path(
        self,
        rng: np.random.Generator,
        position: NDArray[np.float64],
        direction: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Draw the distances to the next absorption or scattering: (n,), mm.

        With a gradient the optical depth after s mm is A s + B s^2; the root of
        A s + B s^2 = depth is taken in the form that does not cancel. Where the parabola never
        gets so high, which is outside of 0 <= z <= height, the distance is infinite.

        Parameters
        ----------
        rng : numpy.random.Generator
        position, direction : (3, n) float64
        """
        depth: NDArray[np.float64] = rng.standard_exponential((position.shape[1],))
        if not self.gradient:
            depth /= self.extinction_per_mm
            return depth
        at_start = self.absorption_per_mm + self.scattering_per_mm * self._strength(position)
        growth = self.scattering_per_mm * self._growth_per_mm(direction)
        discriminant = at_start**2 + 4.0 * growth * depth
        denominator = at_start + np.sqrt(np.maximum(discriminant, 0.0))
        never = (discriminant < 0.0) | (denominator == 0.0)
        return np.where(never, np.inf, 2.0 * depth / np.where(never, 1.0, denominator))

    def scatters(
        self, rng: np.random.Generator, position: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Draw for collisions at these points whether they scatter (or absorb): (n,) bool.

        The two exponential laws share one free path.
        """
        if not self.absorption_per_mm:
            return np.ones(position.shape[1], dtype=bool)
        scattering: float | NDArray[np.float64] = self.scattering_per_mm
        if self.gradient:
            scattering = scattering * self._strength(position)
        draw: NDArray[np.float64] = rng.random((position.shape[1],))
        return draw * (self.absorption_per_mm + scattering) >= self.absorption_per_mm

    def scattering_path(
        self,
        position: NDArray[np.float64],
        direction: NDArray[np.float64],
        distance: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Integral of 1 + gradient u along flights from ``position``: (n,) float64, mm."""
        if not self.gradient:
            return distance
        return distance * (self._strength(position) + self._growth_per_mm(direction) * distance)

    def _strength(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scattering relative to that at middle height; rounding never makes it negative."""
        strength = 1.0 + self.gradient * (2.0 * position[2] / self.height_mm - 1.0)
        return np.maximum(strength, 0.0)

    def _growth_per_mm(self, direction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Half of the relative strength's slope along the flight."""
        return self.gradient * direction[2] / self.height_mm
