"""Errors of fitted quantities by origin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mcrim_mitsuba.fit import Calibration
from mcrim_mitsuba.fit.likelihood import Likelihood
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_ABS
from mcrim_mitsuba.neglect import pieces
from mcrim_mitsuba.neglect.quantities import Quantities
from mcrim_mitsuba.neglect.result import Neglected, Total
from mcrim_mitsuba.physics.error_budget import ErrorBudget, contribution

#: Parts of an error smaller than this, relative to the largest, are rounding.
_ROUNDING = 1e-6
#: Priors that have advice of their own.
_PRIORS = {ALPHA_ABS: "absorption", pieces.DEPTH_MM: "source depth"}


def _errors(
    model: ResponseModel, found: Calibration, quantities: Quantities
) -> dict[str, dict[str, float]]:
    """Standard errors of every quantity by origin, in its own unit."""
    theta = np.array([found.parameters[name].value for name in found.names])
    likelihood = Likelihood(model)
    readings = likelihood.errors_at(theta).readings
    # (quantities, used readings): how a reading moves a quantity
    pulled = quantities.slopes @ found.response[:, likelihood.used]
    parts = {"counts": np.sqrt(np.einsum("ij,jk,ik->i", pulled, readings, pulled))}
    for i, parameter in enumerate(model.free):
        if parameter.prior_sigma is not None:
            origin = _PRIORS.get(parameter.name, f"prior, {parameter.name}")
            moved = quantities.slopes @ found.covariance[:, i] / parameter.prior_sigma
            parts[origin] = np.abs(moved)
    parts["monte_carlo"] = quantities.sigmas
    return {
        name: {origin: float(part[i]) for origin, part in parts.items()}
        for i, name in enumerate(quantities.names)
    }


def contributions_to(
    model: ResponseModel, found: Calibration, quantities: Quantities
) -> dict[str, ErrorBudget]:
    """The budget of every quantity, the detector's part of the light yield's included."""
    errors = _errors(model, found, quantities)
    known = model.campaign.light_yield
    if LIGHT_YIELD in errors and known is not None:
        value = found.parameters[LIGHT_YIELD].value
        parts = known.efficiency_parts or {"detector_efficiency": known.detector_efficiency_sigma}
        errors[LIGHT_YIELD] |= {
            origin: value * sigma / known.detector_efficiency for origin, sigma in parts.items()
        }
    at_bound = [n for n, fitted in found.parameters.items() if fitted.at_bound is not None]
    return {
        name: ErrorBudget(
            tuple(
                contribution(origin, sigma / abs(value))
                for origin, sigma in errors[name].items()
                if sigma > _ROUNDING * max(errors[name].values())
            )
        )
        for name, value in zip(quantities.names, quantities.values.tolist(), strict=True)
        if value and not at_bound
    }


def totals(
    own: Quantities,
    contributions: Mapping[str, ErrorBudget],
    neglected: tuple[Neglected, ...],
    corrected: pieces.Refit | None,
) -> dict[str, Total]:
    """Every quantity with all its errors, as it is and corrected."""
    after: dict[str, float] = {}
    budgets: dict[str, ErrorBudget] = {}
    if corrected is not None:
        quantities = corrected.refitted
        after = dict(zip(quantities.names, quantities.values.tolist(), strict=True))
        budgets = contributions_to(corrected.model, corrected.calibration, quantities)
    found = {}
    for name, value in zip(own.names, own.values.tolist(), strict=True):
        if name not in contributions:
            continue
        sigma = contributions[name].total * abs(value)
        lasting = math.hypot(*(p.refitted[name].as_error for p in neglected if not p.correction))
        total = Total(value, sigma, lasting)
        if name in budgets:
            sizes = (p.refitted[name].size_sigma for p in neglected if p.correction)
            parts = (budgets[name].total * abs(after[name]), lasting, *sizes)
            total = replace(total, corrected=after[name], corrected_sigma=math.hypot(*parts))
        found[name] = total
    return found
