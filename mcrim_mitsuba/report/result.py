"""The result of a report: what is quoted, its errors apart, and the efficiency of every reading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import Calibration, ParameterEstimate

#: What repeating lowers, of the measurement or of the simulation; all else is systematic.
STATISTICAL = ("statistical", "monte_carlo")


@dataclass(frozen=True)
class Quantity:
    """A fitted parameter with its errors apart, in the unit of its name.

    Attributes
    ----------
    name : str
    value : float
    statistical : float
        Of the readings and of the simulation: repeating them lowers it.
    systematic : float
        Of what is known beforehand, and of the detector's efficiency.
    total : float
        Both in quadrature.
    lower, upper : float or None
        Ends of the 68.3 % interval by profile likelihood.
    at_bound : str or None
        ``min`` or ``max`` where the fit ended there: the errors are none then.
    contributions : dict of str to float
        By origin.
    """

    name: str
    value: float
    statistical: float
    systematic: float
    total: float
    lower: float | None
    upper: float | None
    at_bound: str | None
    contributions: dict[str, float]


@dataclass(frozen=True)
class Efficiency:
    """The light collection efficiency of one reading's configuration.

    Attributes
    ----------
    label : str
    parameters : dict of str to Value
        What differs from reading to reading.
    eta, sigma : float
        Fraction of the light that is detected; the error is that of the fit and of the simulation.
    """

    label: str
    parameters: dict[str, Value]
    eta: float
    sigma: float


def quantities(calibration: Calibration) -> dict[str, Quantity]:
    """All fitted parameters and the light yield."""
    return {name: _quantity(name, known) for name, known in calibration.parameters.items()}


def _quantity(name: str, known: ParameterEstimate) -> Quantity:
    origins = known.contributions
    return Quantity(
        name=name,
        value=known.value,
        statistical=math.hypot(*(origins.get(origin, 0.0) for origin in STATISTICAL)),
        systematic=math.hypot(*(s for o, s in origins.items() if o not in STATISTICAL)),
        total=known.sigma,
        lower=known.lower,
        upper=known.upper,
        at_bound=known.at_bound,
        contributions=dict(origins),
    )


def efficiencies(model: ResponseModel, calibration: Calibration) -> tuple[Efficiency, ...]:
    """The efficiency of every reading, its error propagated from the fit."""
    theta = np.array([calibration.parameters[name].value for name in calibration.names])
    slopes = model.predict(theta).eta_slopes
    fitted = np.einsum("ri,ij,rj->r", slopes, calibration.covariance, slopes)
    return tuple(
        Efficiency(
            row.label,
            dict(reading.parameters),
            row.eta,
            math.sqrt(max(variance, 0.0) + row.eta_sigma**2),
        )
        for row, reading, variance in zip(calibration.rows, model.readings, fitted, strict=True)
    )


def to_json(found: Mapping[str, Quantity], of_readings: tuple[Efficiency, ...]) -> dict[str, Any]:
    """The same for JSON."""
    return {
        "result": {name: vars(quantity) for name, quantity in found.items()},
        "efficiencies": [vars(each) for each in of_readings],
    }
