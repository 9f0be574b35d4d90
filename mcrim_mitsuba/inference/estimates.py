"""What a fit says: parameters with errors by origin, readings beside predictions, statistics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, LightYieldInput
from mcrim_mitsuba.campaign.measurements import LIGHT, TRANSMITTANCE
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.tolerances import Tolerance
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.inference.drivers import Minimum
from mcrim_mitsuba.inference.model import Model, Prediction
from mcrim_mitsuba.inference.settings import BUDGETING, LINEAR

LIGHT_YIELD = "light_yield_ph_per_keV"


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
    #: ``prior``, ``monte_carlo``, ``pedestal`` and ``tolerances`` where the campaign has any and,
    #: for the light yield, ``detector_efficiency``; they add up in quadrature.
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
    #: (measured - model) over the square root of the variances of reading, mounting, calibration
    #: of channels and Monte Carlo, added.
    pull: float
    #: Light collection efficiency and its Monte Carlo standard error.
    eta: float
    eta_sigma: float
    #: Whether the fit used it.
    use: bool
    #: ``light``, or ``transmittance``: the fraction of a beam, which `eta` is then too.
    kind: str = LIGHT
    #: What differs from reading to reading, by column (`Campaign.cells`), where it has it.
    parameters: dict[str, Value] = field(default_factory=dict)

    @property
    def of_beam(self) -> bool:
        """Whether it is a transmittance."""
        return self.kind == TRANSMITTANCE


@dataclass(frozen=True, kw_only=True)
class NumberOffset:
    """How far a number of the bench is off, as the readings have it."""

    tolerance: Tolerance
    #: In the number's unit; what is known beforehand, the tolerance around 0, is in it.
    offset: float
    sigma: float
    #: Relative standard error of the scale, and so of the light yield, by the tolerance; None where
    #: the scale is held.
    of_scale: float | None

    def matters(self, relative_sigma: float) -> bool:
        """Whether it is worth a line beside a scale with this error: by its part, or where it is.

        One that the campaign names always is.
        """
        return (
            self.tolerance.given
            or abs(self.offset) > BUDGETING.off * self.tolerance.sigma
            or (self.of_scale or 0.0) > BUDGETING.matters * relative_sigma
        )


def offsets(minimum: Minimum) -> tuple[NumberOffset, ...]:
    """Offsets of the bench's numbers, which were integrated out of a fit's statistic.

    With T what standard uncertainties do to the predictions, they are T^T C^-1 r and have the
    variances 1 - T^T P T, in these units; P is `Minimum.precision`, r the residuals.
    """
    moved = minimum.weights.errors.tolerances
    mean = moved.T @ minimum.weighted_residuals
    variances = 1.0 - np.einsum("rt,rs,st->t", moved, minimum.precision, moved)
    of_scale: list[float | None] = [None] * len(mean)
    if SCALE in minimum.names:
        relative = minimum.response[minimum.names.index(SCALE)] @ moved / minimum.values[SCALE]
        of_scale = np.abs(relative).tolist()
    tolerances = minimum.statistic.model.campaign.tolerances if len(mean) else ()
    return tuple(
        NumberOffset(
            tolerance=tolerance,
            offset=tolerance.sigma * offset,
            sigma=tolerance.sigma * math.sqrt(max(variance, 0.0)),
            of_scale=part,
        )
        for tolerance, offset, variance, part in zip(
            tolerances, mean.tolist(), variances.tolist(), of_scale, strict=True
        )
    )


def estimates(minimum: Minimum) -> dict[str, ParameterEstimate]:
    """Every free parameter with its errors by origin, and the light yield where it is known how.

    To first order the estimate is theta = V (J^T C^-1 y + P prior), V the covariance of the
    parameters and V J^T C^-1 their response to the readings: each part of C and P propagates by
    itself, and the parts add up to V. The intervals are those of the linear theory: value -+ sigma,
    cut off at the bounds.
    """
    statistic, covariance, response = minimum.statistic, minimum.covariance, minimum.response
    errors = minimum.weights.errors
    variances = {
        "statistical": errors.statistical_variances(response),
        "prior": covariance**2 @ (statistic.prior_weight + minimum.bounds_weight),
        "monte_carlo": np.square(response @ errors.simulated).sum(axis=1),
    }
    if errors.pedestal.size:
        variances["pedestal"] = np.square(response @ errors.pedestal).sum(axis=1)
    if errors.tolerances.size:
        variances["tolerances"] = np.square(response @ errors.tolerances).sum(axis=1)
    parameters = {}
    for i, bounds in enumerate(statistic.free):
        whole, value = max(float(covariance[i, i]), 0.0), float(minimum.theta[i])
        sigma = math.sqrt(whole)
        parameters[bounds.name] = ParameterEstimate(
            value=value,
            sigma=sigma,
            lower=max(value - sigma, bounds.minimum),
            upper=min(value + sigma, bounds.maximum),
            at_bound=minimum.at_bound[i],
            contributions={
                # what only rounding makes is none
                origin: math.sqrt(part[i]) if part[i] > LINEAR.rounding**2 * whole else 0.0
                for origin, part in variances.items()
            },
        )
    return parameters | light_yields(parameters, statistic.model.campaign)


def light_yield(scale: ParameterEstimate, known: LightYieldInput) -> ParameterEstimate:
    """Photons per keV: scale / (energy efficiency), the efficiency's error in quadrature."""
    value = scale.value * known.per_scale
    of_efficiency = value * known.relative_sigma

    def end(of_scale: float | None, sign: float) -> float | None:
        if of_scale is None:
            return None
        return value + sign * math.hypot((of_scale - scale.value) * known.per_scale, of_efficiency)

    parts = {origin: part * known.per_scale for origin, part in scale.contributions.items()}
    return ParameterEstimate(
        value=value,
        sigma=math.hypot(scale.sigma * known.per_scale, of_efficiency),
        lower=end(scale.lower, -1.0),
        upper=end(scale.upper, +1.0),
        at_bound=scale.at_bound,
        contributions={**parts, "detector_efficiency": of_efficiency},
        efficiency_contributions={
            origin: value * part / known.detector_efficiency
            for origin, part in known.efficiency_parts.items()
        }
        or None,
    )


def light_yields(
    fitted: Mapping[str, ParameterEstimate], campaign: Campaign
) -> dict[str, ParameterEstimate]:
    """`light_yield` of every fitted scale of which the campaign says how to get it, by name."""
    return {
        name: light_yield(fitted[scale], known)
        for scale, (name, known) in campaign.light_yields.items()
        if scale in fitted
    }


def fitted_rows(
    model: Model, prediction: Prediction, eta_sigmas: Sequence[float]
) -> tuple[FittedRow, ...]:
    """Every reading beside its prediction; `eta_sigmas` are eta's Monte Carlo standard errors."""
    rows, of_light = [], np.array([not reading.of_beam for reading in model.readings])
    by_channels = model.campaign.common_errors.moved(prediction.signal, of_light)
    for i, reading in enumerate(model.readings):
        signal, eta_sigma = float(prediction.signal[i]), float(eta_sigmas[i])
        model_sigma = abs(float(prediction.signal_per_eta[i])) * eta_sigma
        of_group = (reading.group_sigma or 0.0) * signal
        spread = math.hypot(reading.sigma, of_group, model_sigma, *reading.shared, *by_channels[i])
        cells = model.campaign.cells(reading).items()
        rows.append(
            FittedRow(
                label=reading.label,
                measured=reading.signal,
                sigma=reading.sigma,
                model=signal,
                model_sigma=model_sigma,
                pull=(reading.signal - signal) / spread,
                eta=float(prediction.eta[i]),
                eta_sigma=eta_sigma,
                use=reading.use,
                kind=reading.kind,
                parameters={name: cell for name, cell in cells if cell is not None},
            )
        )
    return tuple(rows)


# ---- statistics of a fit, by linear error propagation ----


def corrected(p: float, tries: float) -> float:
    """The p-value of the smallest of some independent ones (Z. Sidak, JASA 62 (1967) 626)."""
    return -math.expm1(tries * math.log1p(-p)) if p < 1.0 else 1.0


def left_out(fit: Minimum) -> tuple[Array, Array]:
    """How the fit to all other readings and priors predicts every reading.

    Given are (used,) errors, the reading minus its prediction by the others, infinite where they do
    not predict it; and (used,) pulls, the same in its standard error, the prediction's included,
    whose square is what chi2 falls by where the reading is left out.

    Exact for a linear model with correlated errors and Gaussian priors: with P the inverse
    covariance of readings whose parameters are unknown (`Minimum.precision`) and r the residuals of
    the fit to all, the error is (C^-1 r)_i / P_ii and its variance 1 / P_ii (the PRESS residuals of
    D. M. Allen, Technometrics 16 (1974) 125, with the covariance in place of the unit matrix).
    """
    weighted = fit.weighted_residuals
    weight = np.diag(fit.precision).copy()
    seen = weight > LINEAR.least_leverage * np.diag(fit.weights.inverse)
    errors, pulls = np.full(len(weight), np.inf), np.zeros(len(weight))
    errors[seen] = weighted[seen] / weight[seen]
    pulls[seen] = weighted[seen] / np.sqrt(weight[seen])
    return errors, pulls


def left_out_error(fit: Minimum) -> float:
    """Root mean square error on readings left out of the fit, in units of their sigma.

    Sigma is a reading's own and its mounting's. Infinite where the others do not tell some reading.
    """
    errors, _ = left_out(fit)
    error = float(np.sqrt(np.mean(errors**2 / np.diag(fit.weights.errors.readings))))
    return error if error < LINEAR.largest_error else math.inf


def pulls(fit: Minimum) -> Array:
    """(used,) residuals in units of the readings' whole standard error."""
    return fit.residuals / np.sqrt(np.diag(fit.weights.covariance))


def rms_pull(fit: Minimum) -> float:
    """Root mean square of `pulls`."""
    return float(np.sqrt(np.mean(pulls(fit) ** 2)))


def aicc(fit: Minimum) -> float:
    """Akaike's information criterion for small samples, up to a constant of the campaign.

    -2 log(likelihood) + 2 k + 2 k (k + 1) / (n - k - 1), k free parameters, n readings and priors
    (C. M. Hurvich and C.-L. Tsai, Biometrika 76 (1989) 297); infinite where n <= k + 1.
    """
    n, k = fit.statistic.knowns, len(fit.names)
    if n - k - 1 <= 0:
        return math.inf
    return fit.deviance + 2.0 * k + 2.0 * k * (k + 1) / (n - k - 1)


def chi2_of_batches(fit: Minimum) -> Array | None:
    """(batches,) first-order change of chi2 with the simulation's batches; None without any.

    At a minimum only the prediction's direct change counts, not that of the parameters.
    """
    batches = getattr(fit.statistic.model, "eta_batches", None)
    if batches is None:
        return None
    prediction, used = fit.statistic.model.predict(fit.theta), fit.statistic.used
    deviations = (batches(fit.theta) * prediction.eta * prediction.signal_per_eta)[:, used]
    return -2.0 * deviations @ fit.weighted_residuals


def spread(batches: Array) -> Array:
    """(...) standard errors of means from the (batches, ...) deviations from them."""
    count = len(batches)
    return np.sqrt((batches**2).sum(axis=0) / (count * (count - 1)))


def error_of_difference(fit: Minimum, other: Minimum) -> float:
    """The simulation's standard error of two fits' difference in chi2.

    Both were made with the same batches, so that much of their error is common.
    """
    if fit is other:
        return 0.0
    one, two = chi2_of_batches(fit), chi2_of_batches(other)
    return 0.0 if one is None or two is None or len(one) < 2 else float(spread(one - two))
