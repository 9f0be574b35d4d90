"""What a fit says of efficiencies and parameters, with the errors of every batch of photons.

Two fits whose simulations drew the same random numbers share most of their errors. Batches of one
number belong together in both, so that the spread of their differences is the error of the
difference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import LIGHT_YIELD, Calibration

_ETA, _OVER = "eta ", " / "
_SHOWN_EFFICIENCIES = 2


@dataclass(frozen=True, eq=False)
class Quantities:
    """Numbers that depend on the simulation, by name.

    Attributes
    ----------
    names : tuple of str
        ``eta LABEL`` of every reading, ``eta LABEL / eta LABEL`` of two readings in use, and
        parameters by their own names.
    values : (quantities,) float64
        In the units of their names.
    batches : (batches, quantities) float64
        How far every batch of photons alone would be from `values`, to first order.
    slopes : (quantities, free parameters) float64
        d quantity / d free parameter of the fit.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    batches: NDArray[np.float64]
    slopes: NDArray[np.float64]

    def main(self, priors: Sequence[str]) -> tuple[str, ...]:
        """What to show: two efficiencies, parameters not among `priors`, the light yield last."""
        efficiencies = [n for n in self.names if n.startswith(_ETA) and _OVER not in n]
        parameters = [n for n in self.names if not n.startswith(_ETA) and n not in priors]
        parameters.sort(key=lambda name: name in (LIGHT_YIELD, SCALE))
        return (*efficiencies[:_SHOWN_EFFICIENCIES], *parameters)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(quantities,) Monte Carlo standard errors."""
        return spread(self.batches)


def spread(batches: NDArray[np.float64]) -> NDArray[np.float64]:
    """(quantities,) standard errors of means from (batches, quantities) deviations."""
    count = len(batches)
    return np.sqrt((batches**2).sum(axis=0) / (count * (count - 1)))


def at(model: ResponseModel, values: Mapping[str, float]) -> Quantities:
    """Efficiencies and their ratio where the free parameters have given values.

    Parameters
    ----------
    model : ResponseModel
    values : mapping of str to float
        At least of the model's free parameters.
    """
    theta = np.array([values[parameter.name] for parameter in model.free])
    prediction = model.predict(theta)
    batches = prediction.eta * model.eta_batches(theta)
    return _of_eta(model, prediction.eta, batches, prediction.eta_slopes)


def fitted(model: ResponseModel, found: Calibration) -> Quantities:
    """Efficiencies, their ratio and parameters where a fit ended.

    Where a batch alone would give other efficiencies, the fit would end elsewhere: by the
    response of the estimate to the readings, to first order.
    """
    theta = np.array([found.parameters[name].value for name in found.names])
    prediction = model.predict(theta)
    own = prediction.eta * model.eta_batches(theta)
    # a model that predicts more acts as a reading that is lower
    moved = -(own * prediction.signal_per_eta) @ found.response.T
    slopes = prediction.eta_slopes
    etas = _of_eta(model, prediction.eta, own + moved @ slopes.T, slopes)
    names, rows = [], []
    for i, name in enumerate(found.names):
        per_scale = _light_per_scale(model.campaign) if name == SCALE else None
        names.append(name if per_scale is None else LIGHT_YIELD)
        rows.append(np.eye(len(theta))[i] * (per_scale or 1.0))
    parameters = np.array(rows).reshape(len(names), len(theta))
    return Quantities(
        (*names, *etas.names),
        np.concatenate([parameters @ theta, etas.values]),
        np.hstack([moved @ parameters.T, etas.batches]),
        np.vstack([parameters, etas.slopes]),
    )


def _of_eta(
    model: ResponseModel,
    eta: NDArray[np.float64],
    batches: NDArray[np.float64],
    slopes: NDArray[np.float64],
) -> Quantities:
    """Efficiencies, and the ratio of the two where two readings are in use."""
    names = [f"{_ETA}{reading.label}" for reading in model.readings]
    used = [i for i, reading in enumerate(model.readings) if reading.use]
    if len(used) == 2:
        one, two = used
        names.append(f"{names[one]}{_OVER}{names[two]}")
        ratio = eta[one] / eta[two]

        def relative(of_eta: NDArray[np.float64]) -> NDArray[np.float64]:
            return of_eta[..., one, None] / eta[one] - of_eta[..., two, None] / eta[two]

        batches = np.hstack([batches, ratio * relative(batches)])
        slopes = np.vstack([slopes, ratio * relative(slopes.T).T])
        eta = np.append(eta, ratio)
    return Quantities(tuple(names), eta, batches, slopes)


def _light_per_scale(campaign: Campaign) -> float | None:
    """Photons per keV that a unit of the scale stands for."""
    known = campaign.light_yield
    return None if known is None else 1.0 / (known.energy_keV * known.detector_efficiency)


@dataclass(frozen=True)
class Shift:
    """How a number moves when a piece of physics is put into the model.

    Attributes
    ----------
    before, after : float
        Without it and with it, in the unit of the number.
    monte_carlo_sigma : float
        Standard error of the difference from the simulation.
    size_sigma : float
        Standard error of the difference because the size of the piece is known to its own error
        only; 0 where it has none.
    """

    before: float
    after: float
    monte_carlo_sigma: float
    size_sigma: float = 0.0

    @property
    def shift(self) -> float:
        """after - before."""
        return self.after - self.before

    @property
    def relative(self) -> float:
        """`shift` over `before`; NaN where that is 0."""
        return self.shift / self.before if self.before else math.nan

    @property
    def as_error(self) -> float:
        """Size of the shift, its own error in quadrature: for what is not corrected."""
        return math.hypot(self.shift, self.size_sigma)


def shifts(
    before: Quantities, after: Quantities, size_sigmas: Mapping[str, float] | None = None
) -> dict[str, Shift]:
    """Shifts of all quantities that both have.

    Parameters
    ----------
    before, after : Quantities
        Of simulations with the same seed.
    size_sigmas : mapping of str to float, optional
        `Shift.size_sigma` by quantity.
    """
    common = [name for name in before.names if name in after.names]
    first, second = ([side.names.index(name) for name in common] for side in (before, after))
    sigmas = spread(after.batches[:, second] - before.batches[:, first])
    return {
        name: Shift(
            float(before.values[i]), float(after.values[j]), float(sigma),
            (size_sigmas or {}).get(name, 0.0),
        )
        for name, i, j, sigma in zip(common, first, second, sigmas, strict=True)
    }  # fmt: skip
