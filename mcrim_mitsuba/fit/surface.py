"""What every surface of light collection efficiency offers the fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

ALPHA_SCAT = "alpha_scat_per_cm"
ALPHA_ABS = "alpha_abs_per_cm"


@dataclass(frozen=True)
class EtaPoint:
    """The light collection efficiency at one point of a surface.

    Attributes
    ----------
    eta, sigma : float
        Light collection efficiency and its Monte Carlo standard error.
    gradient : dict of str to float
        d eta / d parameter for every parameter of the surface, each per unit of that parameter.
    effective_sample_size : float
        Detected photons of equal weight that would be worth as much.
    interpolation_error : float
        Estimated size of the error from interpolation between simulations, not part of
        `sigma`; 0 where nothing was interpolated.
    """

    eta: float
    sigma: float
    gradient: dict[str, float]
    effective_sample_size: float
    interpolation_error: float = 0.0


class Surface(Protocol):
    """The light collection efficiency of one configuration as a function of its unknowns.

    Attributes
    ----------
    parameters : tuple of str
        What `evaluate` takes: ``alpha_scat_per_cm``, ``alpha_abs_per_cm``, and any further
        scene parameters.
    alpha_scat_bounds_per_cm : tuple of two floats
        Where the surface may be asked; the lower end is above 0.
    """

    @property
    def parameters(self) -> tuple[str, ...]: ...

    @property
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]: ...

    def evaluate(
        self, alpha_scat_per_cm: float, alpha_abs_per_cm: float, **scene_parameters: float
    ) -> EtaPoint:
        """Efficiency, its error and its gradient; InputError where the surface says nothing."""

    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        """Monte Carlo covariance of eta at two points, each a value for every parameter."""
