"""What a run hands back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class DetectedHistories:
    """What each detected photon went through, for reweighting.

    A photon's weight under other coefficients is (scat'/scat)^scatterings
    exp(-(scat' - scat) scattering_path_cm) exp(-(abs' - abs) path_cm): the
    tracer itself absorbs with abs. And a run whose mask leaves the whole plate
    free answers every aperture: keep the photons with mask_radius_mm up to its
    radius.

    Attributes
    ----------
    scatterings : (detected,) int32
        Number of bulk scatterings.
    path_cm : (detected,) float64
        Path in the crystal.
    scattering_path_cm : (detected,) float64
        The same, weighted with the scattering's strength relative to that at middle height;
        equal to ``path_cm`` where there is no gradient.
    mask_radius_mm : (detected,) float64
        Largest distance from the axis at which the photon met the mask's plane,
        from either side: the plate's entrance face or, with
        ``aperture_at_detector``, its back face.
    arrival_cosine : (detected,) float64
        Cosine of the angle to the detector's normal, in the plate.
    arrival_radius_mm : (detected,) float64
        Distance from the axis at which the photon was detected.
    """

    scatterings: NDArray[np.int32]
    path_cm: NDArray[np.float64]
    scattering_path_cm: NDArray[np.float64]
    mask_radius_mm: NDArray[np.float64]
    arrival_cosine: NDArray[np.float64]
    arrival_radius_mm: NDArray[np.float64]


@dataclass(frozen=True)
class TracerResult:
    """Every photon's fate, counted.

    Attributes
    ----------
    photons, seed : int
    counts : dict of str to int
        Photons by fate; the values add up to ``photons``. The fates: detected,
        absorbed_crystal, absorbed_gap, absorbed_window, absorbed_aperture,
        absorbed_reflector, absorbed_surface (losses at the crystal's faces and
        what the detector refuses), escaped, truncated (still on their way after the
        largest number of flights) and lost (numerically astray: an error of
        ours if it is not 0).
    histories : DetectedHistories or None
        None unless asked for. Results are compared without them.
    """

    photons: int
    seed: int
    counts: dict[str, int]
    histories: DetectedHistories | None = field(default=None, compare=False)

    @property
    def budget(self) -> dict[str, float]:
        """Fraction of the emitted photons by fate."""
        return {fate: count / self.photons for fate, count in self.counts.items()}

    @property
    def budget_sigma(self) -> dict[str, float]:
        """Standard deviation of each fraction.

        That of the binomial proportion's posterior under a uniform prior,
        Beta(k + 1, n - k + 1): sqrt(k (n - k) / n^3) for large counts, and
        about 1/n rather than 0 when no photon, or every one, met that fate.
        """
        n = self.photons
        return {
            fate: ((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3))) ** 0.5
            for fate, k in self.counts.items()
        }

    @property
    def eta(self) -> float:
        """Light collection efficiency: detected over emitted."""
        return self.budget["detected"]

    @property
    def eta_sigma(self) -> float:
        """Standard deviation of `eta`."""
        return self.budget_sigma["detected"]
