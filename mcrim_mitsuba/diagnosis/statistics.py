"""What a fit's chi2 says: p-values, expected spread, errors on readings left out, AICc."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mcrim_mitsuba.diagnosis.solver import Fit

# Part of a reading's weight that must be left once the parameters have followed it, for the other
# readings to predict it at all.
_LEAST_LEVERAGE = 1e-9


def p_value(chi2: float, ndf: int) -> float | None:
    """Probability of a larger chi2 if the model is right; None without degrees of freedom."""
    return float(chdtrc(ndf, chi2)) if ndf > 0 else None


def p_of_fit(fit: Fit) -> float | None:
    """`p_value` of a fit."""
    return p_value(fit.chi2, fit.ndf)


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


def error_of_mean(deviations: NDArray[np.float64] | None) -> float:
    """Standard error of the mean of (batches,) deviations from it; 0 without any."""
    if deviations is None or len(deviations) < 2:
        return 0.0
    return float(np.sqrt((deviations**2).sum() / (len(deviations) * (len(deviations) - 1))))
