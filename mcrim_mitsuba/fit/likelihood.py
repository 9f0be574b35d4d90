"""The statistic of a campaign: Gaussian readings, correlated errors, Gaussian priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from mcrim_mitsuba.files.campaign_parameter import SCALE
from mcrim_mitsuba.fit.model import Model, Prediction


@dataclass(frozen=True)
class ErrorMatrices:
    """Covariance of the readings in use, by origin; each (used, used) float64.

    Attributes
    ----------
    readings : ndarray
        Their own errors, and the relative errors that mountings share: group_sigma^2 times
        the two predicted signals.
    monte_carlo : ndarray
        Of the predictions.
    """

    readings: NDArray[np.float64]
    monte_carlo: NDArray[np.float64]

    @property
    def total(self) -> NDArray[np.float64]:
        """Covariance of reading minus prediction."""
        return self.readings + self.monte_carlo


class Likelihood:
    """Readings and priors against a model.

    Parameters
    ----------
    model : CampaignModel or ResponseModel

    Attributes
    ----------
    used : (readings,) bool
        Which of the model's readings the statistic uses.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        readings = model.readings
        self.used = np.array([reading.use for reading in readings])
        self._signal = np.array([r.signal for r in readings])[self.used]
        self._variance = np.array([r.sigma for r in readings])[self.used] ** 2
        used = [reading for reading in readings if reading.use]
        # group_sigma^2 where two readings share a mounting, else 0
        self._shared = np.array(
            [[(a.group_sigma or 0.0) ** 2 * (a.group == b.group) for b in used] for a in used]
        )
        self._scale_column = np.array([float(p.name == SCALE) for p in model.free])
        self._prior = np.array([p.prior if p.prior is not None else 0.0 for p in model.free])
        # 1 / sigma^2, 0 for no knowledge
        self.prior_weight = np.array(
            [p.prior_sigma**-2 if p.prior_sigma is not None else 0.0 for p in model.free]
        )

    def residuals(self, prediction: Prediction) -> NDArray[np.float64]:
        """(used,) reading minus predicted signal."""
        return self._signal - prediction.signal[self.used]

    def signal_slopes(self, prediction: Prediction) -> NDArray[np.float64]:
        """(used, free) d predicted signal / d parameter."""
        return prediction.signal_slopes[self.used]

    def errors_at(self, theta: NDArray[np.float64]) -> ErrorMatrices:
        """Covariance of the readings in use as a point in parameter space predicts it."""
        prediction = self.model.predict(theta, covariance=True)
        assert prediction.eta_covariance is not None  # asked for
        signal, per_eta = prediction.signal[self.used], prediction.signal_per_eta[self.used]
        monte_carlo = prediction.eta_covariance[np.ix_(self.used, self.used)]
        return ErrorMatrices(
            np.diag(self._variance) + self._shared * np.outer(signal, signal),
            np.outer(per_eta, per_eta) * monte_carlo,
        )

    def errors_before_any_fit(self) -> ErrorMatrices:
        """The same without a model: shared errors from the readings, no Monte Carlo error."""
        shared = self._shared * np.outer(self._signal, self._signal)
        return ErrorMatrices(np.diag(self._variance) + shared, np.zeros_like(shared))

    def best_scale(self, eta: NDArray[np.float64], errors: ErrorMatrices) -> float:
        """The scale that fits (readings,) efficiencies best: the statistic is quadratic in it."""
        eta = eta[self.used]
        weighted = np.linalg.solve(errors.total, eta)
        position = self._scale_column.astype(bool)
        prior_weight, prior = self.prior_weight[position].sum(), self._prior[position].sum()
        return float(
            (weighted @ self._signal + prior_weight * prior) / (weighted @ eta + prior_weight)
        )

    def prior_pulls(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(free,) distance from the prior in its sigmas; 0 without a prior."""
        return (theta - self._prior) * np.sqrt(self.prior_weight)


class FrozenStatistic:
    """chi2 with the covariance held at one estimate of the parameters.

    The shared and the Monte Carlo errors scale with the predicted signal. Left free, they
    would let the fit buy a smaller chi2 with larger errors, unless the logarithm of their
    determinant were added; held, and updated between fits, they give the same estimate as
    iteratively reweighted least squares, without that bias and without R. W. Peelle's (which
    comes from scaling them with the readings).

    Parameters
    ----------
    likelihood : Likelihood
    errors : ErrorMatrices

    Attributes
    ----------
    log_determinant : float
        Of the covariance: what two statistics with different ones differ by besides chi2.
    """

    def __init__(self, likelihood: Likelihood, errors: ErrorMatrices) -> None:
        self.likelihood = likelihood
        self.errors = errors
        self._factor = cho_factor(errors.total)
        self.log_determinant = 2.0 * float(np.sum(np.log(np.diag(self._factor[0]))))
        self._last: tuple[bytes, Prediction] | None = None

    def chi2(self, theta: NDArray[np.float64]) -> float:
        """Readings' chi2 plus the priors'."""
        residuals = self.likelihood.residuals(self._predict(theta))
        pulls = self.likelihood.prior_pulls(theta)
        return float(residuals @ cho_solve(self._factor, residuals) + pulls @ pulls)

    def gradient(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(free,) d chi2 / d parameter, exact."""
        prediction = self._predict(theta)
        weighted = cho_solve(self._factor, self.likelihood.residuals(prediction))
        of_readings = self.likelihood.signal_slopes(prediction).T @ weighted
        of_priors = self.likelihood.prior_pulls(theta) * np.sqrt(self.likelihood.prior_weight)
        return 2.0 * (of_priors - of_readings)

    def information(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(free, free) Fisher information, priors included."""
        slopes = self.likelihood.signal_slopes(self._predict(theta))
        return slopes.T @ cho_solve(self._factor, slopes) + np.diag(self.likelihood.prior_weight)

    def response(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(free, used) J^T C^-1: how the readings move the estimate, before the covariance."""
        return cho_solve(self._factor, self.likelihood.signal_slopes(self._predict(theta))).T

    def _predict(self, theta: NDArray[np.float64]) -> Prediction:
        """The model's prediction; a minimiser asks for chi2 and gradient of one point in turn."""
        key = theta.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, self.likelihood.model.predict(theta))
        return self._last[1]
