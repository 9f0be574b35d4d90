"""What the detector does with light that reaches it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.bench import Bench

#: Distance from the axis, in mm, at which the radial falloff is reached.
FALLOFF_RADIUS_MM = 14.0


class Detector:
    """Reflectance and acceptance of the plate's back face.

    Attributes
    ----------
    reflectance : float
        Probability of a diffuse reflection back into the plate, decided first.
    detects_all : bool
        Whether everything that reaches the detector is detected.
    """

    def __init__(self, bench: Bench) -> None:
        self.reflectance = bench.detector_reflectance
        self._angular, self._radial = bench.angular_falloff, bench.radial_falloff
        self.detects_all = not (self.reflectance or self._angular or self._radial)

    def acceptance(
        self, position: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Probability that light which is not reflected is detected: (n,) float64.

        Parameters
        ----------
        position : (3, n) float64, mm
            Where it arrives.
        direction : (3, n) float64
            Its direction in the plate.
        """
        by_angle = 1.0 - self._angular * (1.0 - np.abs(direction[2]))
        reach = (position[0] ** 2 + position[1] ** 2) / FALLOFF_RADIUS_MM**2
        by_radius = 1.0 - self._radial * reach
        return np.clip(by_angle, 0.0, 1.0) * np.clip(by_radius, 0.0, 1.0)
