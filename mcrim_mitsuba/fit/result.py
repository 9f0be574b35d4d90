"""What a calibration hands back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIGHT_YIELD = "light_yield_ph_per_keV"


@dataclass(frozen=True)
class ParameterEstimate:
    """One fitted parameter, in the unit of its name.

    Attributes
    ----------
    value : float
    sigma : float
        Standard error by linear propagation of every error (inverse Fisher information).
    lower, upper : float or None
        Ends of the 68.3 % interval by profile likelihood; None where not asked for.
    at_bound : str or None
        ``min`` or ``max`` where the fit ended at that bound: `sigma` then describes the
        statistic's curvature, and the interval is one-sided.
    contributions : dict of str to float
        `sigma` by origin: ``statistical`` (readings, what mountings share included),
        ``prior``, ``monte_carlo`` and, for the light yield, ``detector_efficiency``; they
        add up in quadrature.
    efficiency_contributions : dict of str to float, or None
        The part ``detector_efficiency`` by its own origins, where the campaign has the spectra;
        None elsewhere.
    """

    value: float
    sigma: float
    lower: float | None
    upper: float | None
    at_bound: str | None
    contributions: dict[str, float]
    efficiency_contributions: dict[str, float] | None = None


@dataclass(frozen=True)
class FittedRow:
    """One reading beside its prediction.

    Attributes
    ----------
    label : str
    measured, sigma : float
        The reading and its own standard error.
    model, model_sigma : float
        Predicted signal and its Monte Carlo standard error.
    pull : float
        (measured - model) over the square root of the variances of reading, mounting and
        Monte Carlo, added.
    eta, eta_sigma : float
        Light collection efficiency and its Monte Carlo standard error.
    use : bool
        Whether the fit used it.
    """

    label: str
    measured: float
    sigma: float
    model: float
    model_sigma: float
    pull: float
    eta: float
    eta_sigma: float
    use: bool


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted campaign.

    Attributes
    ----------
    parameters : dict of str to ParameterEstimate
        The free ones, ``scale`` among them, and ``light_yield_ph_per_keV`` where the
        campaign says how to get it.
    fixed : dict of str to float
        Those that the campaign holds.
    chi2 : float
        Readings in use and priors, with the covariance that the solution predicts.
    ndf : int
        Readings in use + priors - free parameters.
    p_value : float or None
        Probability of a larger chi2 if the model is right; None without degrees of freedom.
        Valid for Gaussian errors and parameters away from their bounds.
    rows : tuple of FittedRow
        All readings, in the file's order.
    names : tuple of str
        The free parameters, in the order of `covariance`.
    covariance : (free, free) float64
        Of the free parameters, in their units.
    response : (free, rows) float64
        How much the estimate changes per unit of every reading, to first order.
    converged : bool
        Whether the minimiser was content.
    notes : tuple of str
        What the reader must know before using the numbers.
    """

    parameters: dict[str, ParameterEstimate]
    fixed: dict[str, float]
    chi2: float
    ndf: int
    p_value: float | None
    rows: tuple[FittedRow, ...]
    names: tuple[str, ...]
    covariance: NDArray[np.float64]
    response: NDArray[np.float64]
    converged: bool
    notes: tuple[str, ...]

    @property
    def correlation(self) -> NDArray[np.float64]:
        """(free, free) correlation coefficients."""
        sigma = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(sigma, sigma)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; what is not finite becomes None."""
        return _plain(
            {
                "parameters": {name: vars(known) for name, known in self.parameters.items()},
                "fixed": self.fixed,
                "chi2": self.chi2,
                "ndf": self.ndf,
                "p_value": self.p_value,
                "rows": [vars(row) for row in self.rows],
                "covariance": {"names": self.names, "matrix": self.covariance.tolist()},
                "correlation": {"names": self.names, "matrix": self.correlation.tolist()},
                "converged": self.converged,
                "notes": self.notes,
            }
        )


def _plain(value: Any) -> Any:
    """The same in types that JSON has."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
