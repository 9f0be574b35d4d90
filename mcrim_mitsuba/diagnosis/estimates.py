"""A fit's parameters and rows in the form that a calibration has, by linear error propagation."""

from __future__ import annotations

import math

import numpy as np

from mcrim_mitsuba.diagnosis.solver import Fit
from mcrim_mitsuba.files.campaign import LightYieldInput
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.fit.calibration import fitted_rows
from mcrim_mitsuba.fit.result import LIGHT_YIELD, FittedRow, ParameterEstimate


def estimates(fit: Fit, light_yield: LightYieldInput | None = None) -> dict[str, ParameterEstimate]:
    """Every free parameter, and the light yield where the campaign says how to get it.

    The interval is value -+ sigma, cut off at the bounds.
    """
    covariance = fit.parameter_covariance
    response = covariance @ fit.slopes.T @ fit.weights.inverse
    variances = {
        "statistical": np.einsum("ij,jk,ik->i", response, fit.errors.readings, response),
        "prior": covariance**2 @ fit.problem.prior_weight,
        "monte_carlo": np.einsum("ij,jk,ik->i", response, fit.errors.monte_carlo, response),
    }
    found = {}
    for i, parameter in enumerate(fit.problem.free):
        value, sigma = float(fit.theta[i]), math.sqrt(max(covariance[i, i], 0.0))
        found[parameter.name] = ParameterEstimate(
            value=value,
            sigma=sigma,
            lower=max(value - sigma, parameter.minimum),
            upper=min(value + sigma, parameter.maximum),
            at_bound=fit.at_bound[i],
            contributions={
                origin: math.sqrt(max(float(v[i]), 0.0)) for origin, v in variances.items()
            },
        )
    if light_yield is not None and SCALE in found:
        found[LIGHT_YIELD] = _light_yield(found[SCALE], light_yield)
    return found


def _light_yield(scale: ParameterEstimate, known: LightYieldInput) -> ParameterEstimate:
    """Photons per keV: scale / (energy efficiency), the efficiency's error in quadrature."""
    per_scale = 1.0 / (known.energy_keV * known.detector_efficiency)
    value = scale.value * per_scale
    of_efficiency = value * known.detector_efficiency_sigma / known.detector_efficiency
    sigma = math.hypot(scale.sigma * per_scale, of_efficiency)
    parts = {origin: part * per_scale for origin, part in scale.contributions.items()}
    return ParameterEstimate(
        value=value,
        sigma=sigma,
        lower=value - sigma,
        upper=value + sigma,
        at_bound=scale.at_bound,
        contributions={**parts, "detector_efficiency": of_efficiency},
    )


def rows(fit: Fit) -> tuple[FittedRow, ...]:
    """Every reading beside its prediction."""
    model = fit.problem.model
    prediction = model.predict(fit.theta, covariance=True)
    assert prediction.eta_covariance is not None  # asked for
    sigmas = np.sqrt(np.diag(prediction.eta_covariance))
    return fitted_rows(model.readings, prediction, sigmas.tolist())
