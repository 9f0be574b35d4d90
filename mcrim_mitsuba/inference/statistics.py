"""A fit's parameters and rows in the form that a calibration has, by linear error propagation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.inference.estimates import (
    LIGHT_YIELD,
    FittedRow,
    ParameterEstimate,
    fitted_rows,
    light_yield,
    propagated,
)
from mcrim_mitsuba.inference.least_squares import Fit
from mcrim_mitsuba.inference.likelihood import Interval

# Part of a reading's weight that must be left once the parameters have followed it, for the other
# readings to predict it at all.
_LEAST_LEVERAGE = 1e-9


def corrected(p: float, tries: float) -> float:
    """The p-value of the smallest of some independent ones (Z. Sidak, JASA 62 (1967) 626)."""
    return -math.expm1(tries * math.log1p(-p)) if p < 1.0 else 1.0


def left_out(fit: Fit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How the fit to all other readings and priors predicts every reading.

    Returns
    -------
    errors : (used,) float64
        Reading minus its prediction by the others; infinite where they do not predict it.
    pulls : (used,) float64
        The same in its standard error, the prediction's included; its square is what chi2 falls
        by where the reading is left out.

    Notes
    -----
    Exact for a linear model with correlated errors and Gaussian priors: with P the inverse
    covariance of readings whose parameters are unknown (`Fit.precision`) and r the residuals of the
    fit to all, the error is (C^-1 r)_i / P_ii and its variance 1 / P_ii (the PRESS residuals of
    D. M. Allen, Technometrics 16 (1974) 125, with the covariance in place of the unit matrix).
    """
    weighted = fit.weights.inverse @ fit.residuals
    weight = np.diag(fit.precision).copy()
    seen = weight > _LEAST_LEVERAGE * np.diag(fit.weights.inverse)
    errors, pulls = np.full(len(weight), np.inf), np.zeros(len(weight))
    errors[seen] = weighted[seen] / weight[seen]
    pulls[seen] = weighted[seen] / np.sqrt(weight[seen])
    return errors, pulls


def left_out_error(fit: Fit) -> float:
    """Root mean square error on readings left out of the fit, in units of their sigma.

    Sigma is a reading's own and its mounting's. Infinite where some reading alone determines a
    parameter.
    """
    errors, _ = left_out(fit)
    return float(np.sqrt(np.mean(errors**2 / np.diag(fit.errors.readings))))


def pulls(fit: Fit) -> NDArray[np.float64]:
    """(used,) residuals in units of the readings' whole standard error."""
    return fit.residuals / np.sqrt(np.diag(fit.weights.covariance))


def rms_pull(fit: Fit) -> float:
    """Root mean square of `pulls`."""
    return float(np.sqrt(np.mean(pulls(fit) ** 2)))


def criterion(fit: Fit) -> float:
    """What explanations are ranked by, up to a constant of the campaign: -2 log(likelihood) + 2 k.

    Readings come with their errors. For these Akaike's criterion, which here is C. L. Mallows' Cp
    (Technometrics 15 (1973) 661), is unbiased however few they are; the small-sample term of `aicc`
    is the price of errors estimated from the same readings.
    """
    return fit.deviance + 2.0 * len(fit.names)


def aicc(fit: Fit) -> float:
    """Akaike's information criterion for small samples, up to a constant of the campaign.

    -2 log(likelihood) + 2 k + 2 k (k + 1) / (n - k - 1), k free parameters, n readings and priors
    (C. M. Hurvich and C.-L. Tsai, Biometrika 76 (1989) 297); infinite where n <= k + 1.
    """
    n, k = fit.problem.knowns, len(fit.names)
    if n - k - 1 <= 0:
        return math.inf
    return fit.deviance + 2.0 * k + 2.0 * k * (k + 1) / (n - k - 1)


def chi2_of_batches(fit: Fit) -> NDArray[np.float64] | None:
    """(batches,) first-order change of chi2 with the simulation's batches; None without any.

    At a minimum only the prediction's direct change counts, not that of the parameters.
    """
    batches = getattr(fit.problem.model, "eta_batches", None)
    if batches is None:
        return None
    prediction, used = fit.problem.model.predict(fit.theta), fit.problem.used
    deviations = (batches(fit.theta) * prediction.eta * prediction.signal_per_eta)[:, used]
    return -2.0 * deviations @ (fit.weights.inverse @ fit.residuals)


def spread(batches: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) standard errors of means from the (batches, ...) deviations from them."""
    count = len(batches)
    return np.sqrt((batches**2).sum(axis=0) / (count * (count - 1)))


# ---- explanations in order, and which of them the data cannot tell apart ----

#: Explanations this close to the best in `criterion` lead together with it; twice the simulation's
#: error of the difference is added. In synthetic campaigns with one effect of the catalogue hidden
#: the true one then is among them in more than 97 of 100.
LEADING = 6.0


class Ranking:
    """Explanations, which are sets of effects, by `criterion`: `order` has the best first."""

    def __init__(self, fits: Mapping[tuple[str, ...], Fit]) -> None:
        self._fits = dict(fits)
        self._scores = {key: criterion(fit) for key, fit in fits.items()}
        self.order = tuple(sorted(self._scores, key=lambda key: self._scores[key]))

    @property
    def best(self) -> Fit:
        """Of the first explanation."""
        return self._fits[self.order[0]]

    def behind(self, key: tuple[str, ...]) -> float:
        """How far an explanation is behind the best."""
        return self._scores[key] - self._scores[self.order[0]]

    def leading(self) -> tuple[tuple[str, ...], ...]:
        """Explanations that the data cannot tell from the best, the best first."""
        errors = {key: error_of_difference(self._fits[key], self.best) for key in self.order}
        return tuple(k for k in self.order if self.behind(k) <= LEADING + 2.0 * errors[k])


def error_of_difference(fit: Fit, other: Fit) -> float:
    """The simulation's standard error of two fits' difference in chi2.

    Both were made with the same batches, so that much of their error is common.
    """
    if fit is other:
        return 0.0
    one, two = chi2_of_batches(fit), chi2_of_batches(other)
    if one is None or two is None or len(one) < 2:
        return 0.0
    return float(spread(one - two))


# ---- a fit in the form that a calibration has ----


def estimates(fit: Fit, known: LightYieldInput | None = None) -> dict[str, ParameterEstimate]:
    """Every free parameter, and the light yield where the campaign says how to get it.

    The interval is value -+ sigma, cut off at the bounds.
    """
    covariance = fit.parameter_covariance
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    ends = [
        Interval(max(value - sigma, bounds.minimum), min(value + sigma, bounds.maximum), ())
        for value, sigma, bounds in zip(
            fit.theta.tolist(), sigmas.tolist(), fit.problem.free, strict=True
        )
    ]
    response = covariance @ fit.slopes.T @ fit.weights.inverse
    found = propagated(fit.problem, fit.theta, fit.errors, covariance, response, fit.at_bound, ends)
    if known is not None and SCALE in found:
        of_light = light_yield(found[SCALE], known)
        lower, upper = of_light.value - of_light.sigma, of_light.value + of_light.sigma
        found[LIGHT_YIELD] = replace(
            of_light, lower=lower, upper=upper, efficiency_contributions=None
        )
    return found


def rows(fit: Fit) -> tuple[FittedRow, ...]:
    """Every reading beside its prediction."""
    model = fit.problem.model
    prediction = model.predict(fit.theta, covariance=True)
    assert prediction.eta_covariance is not None  # asked for
    sigmas = np.sqrt(np.diag(prediction.eta_covariance))
    return fitted_rows(model.readings, prediction, sigmas.tolist())
