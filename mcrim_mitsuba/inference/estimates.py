"""What a fit says: parameters with their errors by origin, readings beside predictions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.inference.likelihood import ErrorMatrices, Interval, Likelihood
from mcrim_mitsuba.inference.model import Prediction

LIGHT_YIELD = "light_yield_ph_per_keV"

#: A fit with a lower p-value does not describe the readings.
ACCEPTABLE_P = 0.01


def p_value(chi2: float, ndf: int) -> float | None:
    """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
    return float(chdtrc(ndf, chi2)) if ndf > 0 else None


# Parts of an error smaller than this, relative to it, are rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ParameterEstimate:
    """One fitted parameter, in the unit of its name."""

    value: float
    #: Standard error by linear propagation of every error (inverse Fisher information).
    sigma: float
    #: Ends of the 68.3 % interval by profile likelihood; None where not asked for.
    lower: float | None
    upper: float | None
    #: ``min`` or ``max`` where the fit ended at that bound: `sigma` then describes the
    #: statistic's curvature, and the interval is one-sided.
    at_bound: str | None
    #: `sigma` by origin: ``statistical`` (readings, what mountings share included),
    #: ``prior``, ``monte_carlo`` and, for the light yield, ``detector_efficiency``; they
    #: add up in quadrature.
    contributions: dict[str, float]
    #: The part ``detector_efficiency`` by its own origins, where the campaign has the spectra;
    #: None elsewhere.
    efficiency_contributions: dict[str, float] | None = None


@dataclass(frozen=True)
class FittedRow:
    """One reading beside its prediction."""

    label: str
    #: The reading and its own standard error.
    measured: float
    sigma: float
    #: Predicted signal and its Monte Carlo standard error.
    model: float
    model_sigma: float
    #: (measured - model) over the square root of the variances of reading, mounting and
    #: Monte Carlo, added.
    pull: float
    #: Light collection efficiency and its Monte Carlo standard error.
    eta: float
    eta_sigma: float
    #: Whether the fit used it.
    use: bool


def propagated(
    likelihood: Likelihood,
    theta: NDArray[np.float64],
    errors: ErrorMatrices,
    covariance: NDArray[np.float64],
    response: NDArray[np.float64],
    at_bound: Sequence[str | None],
    ends: Sequence[Interval | None],
) -> dict[str, ParameterEstimate]:
    """Every free parameter with its errors by origin.

    To first order the estimate is theta = V (J^T C^-1 y + P prior), V the covariance: each
    part of C, and P, propagates by itself, and the parts add up to V.

    Parameters
    ----------
    likelihood : Likelihood
    theta : (free,) float64
    errors : ErrorMatrices
        C, by its parts.
    covariance : (free, free) float64
        V.
    response : (free, used) float64
        V J^T C^-1.
    at_bound : (free,) sequence of str or None
    ends : (free,) sequence of Interval or None
        What `lower` and `upper` are.
    """
    variances = {
        "statistical": np.einsum("ij,jk,ik->i", response, errors.readings, response),
        "prior": covariance**2 @ likelihood.prior_weight,
        "monte_carlo": np.einsum("ij,jk,ik->i", response, errors.monte_carlo, response),
    }
    found = {}
    for i, (name, interval) in enumerate(zip(likelihood.names, ends, strict=True)):
        whole = max(float(covariance[i, i]), 0.0)
        found[name] = ParameterEstimate(
            value=float(theta[i]),
            sigma=math.sqrt(whole),
            lower=None if interval is None else interval.lower,
            upper=None if interval is None else interval.upper,
            at_bound=at_bound[i],
            contributions={
                # what only rounding makes is none
                origin: math.sqrt(part[i]) if part[i] > _ROUNDING**2 * whole else 0.0
                for origin, part in variances.items()
            },
        )
    return found


def light_yield(scale: ParameterEstimate, known: LightYieldInput) -> ParameterEstimate:
    """Photons per keV: scale / (energy efficiency), the efficiency's error in quadrature."""
    value = scale.value * known.per_scale
    of_efficiency = value * known.detector_efficiency_sigma / known.detector_efficiency

    def end(of_scale: float | None, sign: float) -> float | None:
        if of_scale is None:
            return None
        return value + sign * math.hypot((of_scale - scale.value) * known.per_scale, of_efficiency)

    return ParameterEstimate(
        value=value,
        sigma=math.hypot(scale.sigma * known.per_scale, of_efficiency),
        lower=end(scale.lower, -1.0),
        upper=end(scale.upper, +1.0),
        at_bound=scale.at_bound,
        contributions={
            **{origin: part * known.per_scale for origin, part in scale.contributions.items()},
            "detector_efficiency": of_efficiency,
        },
        efficiency_contributions={
            origin: value * part / known.detector_efficiency
            for origin, part in known.efficiency_parts.items()
        }
        or None,
    )


def fitted_rows(
    readings: Sequence[Reading], prediction: Prediction, eta_sigmas: Sequence[float]
) -> tuple[FittedRow, ...]:
    """Every reading beside its prediction.

    Parameters
    ----------
    readings : sequence of Reading
    prediction : Prediction
    eta_sigmas : (readings,) sequence of float
        Monte Carlo standard errors of its efficiencies.
    """
    rows = []
    for i, reading in enumerate(readings):
        model, eta_sigma = float(prediction.signal[i]), float(eta_sigmas[i])
        model_sigma = abs(float(prediction.signal_per_eta[i])) * eta_sigma
        spread = math.hypot(reading.sigma, (reading.group_sigma or 0.0) * model, model_sigma)
        rows.append(
            FittedRow(
                label=reading.label,
                measured=reading.signal,
                sigma=reading.sigma,
                model=model,
                model_sigma=model_sigma,
                pull=(reading.signal - model) / spread,
                eta=float(prediction.eta[i]),
                eta_sigma=eta_sigma,
                use=reading.use,
            )
        )
    return tuple(rows)
