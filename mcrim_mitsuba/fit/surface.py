"""What every surface of light collection efficiency offers the fit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

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
        d eta / d parameter for every parameter of the surface, per unit of that parameter.
    effective_sample_size : float
        Detected photons of equal weight that would be worth as much.
    interpolation_error : float
        Estimated size of the error of interpolating between simulations, not part of
        `sigma`; 0 where nothing was interpolated.
    """

    eta: float
    sigma: float
    gradient: dict[str, float]
    effective_sample_size: float
    interpolation_error: float = 0.0


class Surface(ABC):
    """The light collection efficiency of one configuration as a function of its unknowns.

    Attributes
    ----------
    parameters : tuple of str
        What `evaluate` takes: ``alpha_scat_per_cm``, ``alpha_abs_per_cm`` and any further
        scene parameters.
    """

    parameters: tuple[str, ...] = (ALPHA_SCAT, ALPHA_ABS)

    @property
    @abstractmethod
    def alpha_scat_bounds_per_cm(self) -> tuple[float, float]:
        """Range of alpha_scat in which the surface may be asked; its lower end is above 0."""

    @abstractmethod
    def evaluate(
        self,
        alpha_scat_per_cm: float,
        alpha_abs_per_cm: float,
        *,
        check: bool = True,
        errors: bool = True,
        **scene_parameters: float,
    ) -> EtaPoint:
        """Efficiency, its error and its gradient at one point.

        Parameters
        ----------
        alpha_scat_per_cm, alpha_abs_per_cm : float
        check : bool
            Refuse a point whose statistical error cannot be trusted. A search that only
            passes through may do without, and check where it ends.
        errors : bool
            Compute `sigma` and `effective_sample_size`, which takes longest; without, and
            without `check`, they are NaN.
        **scene_parameters : float
            The further `parameters`, in the units of their names.

        Raises
        ------
        InputError
            Outside the surface's range, or where its photons carry no information.
        """

    @abstractmethod
    def covariance(self, first: Mapping[str, float], second: Mapping[str, float]) -> float:
        """Monte Carlo covariance of eta at two points, each a value for every parameter."""

    def eta(self, *coefficients: float, **scene_parameters: float) -> float:
        """Light collection efficiency; arguments and errors as `evaluate`."""
        return self._evaluated(*coefficients, **scene_parameters).eta

    def sigma(self, *coefficients: float, **scene_parameters: float) -> float:
        """Monte Carlo standard error of `eta`; arguments and errors as `evaluate`."""
        return self._evaluated(*coefficients, **scene_parameters).sigma

    def gradient(self, *coefficients: float, **scene_parameters: float) -> dict[str, float]:
        """d eta / d parameter by name; arguments and errors as `evaluate`."""
        return self._evaluated(*coefficients, **scene_parameters).gradient

    def effective_sample_size(self, *coefficients: float, **scene_parameters: float) -> float:
        """Detected photons of equal weight worth as much; arguments and errors as `evaluate`."""
        return self._evaluated(*coefficients, **scene_parameters).effective_sample_size

    def _evaluated(self, *coefficients: float, **scene_parameters: float) -> EtaPoint:
        return self.evaluate(*coefficients, check=True, errors=True, **scene_parameters)
