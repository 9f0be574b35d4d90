"""The most likely parameters of a model of Poisson counts.

S. Baker and R. D. Cousins, Nucl. Instr. Meth. 221 (1984) 437: the likelihood ratio of the counts is
distributed as chi2.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

# Steps of a fit; least damping, and damping at which no step leads on; gain in chi2 that ends it.
_MOST_STEPS, _LEAST_DAMPED, _MOST_DAMPED, _CLOSE = 100, 1e-9, 1e6, 1e-5

#: Expected counts, all above 0, and their (parameters, bins) derivatives.
Model = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


def most_likely(
    expected: Model,
    counts: NDArray[np.float64],
    start: NDArray[np.float64],
    least: NDArray[np.float64],
    most: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float]:
    """Parameters within bounds of the largest likelihood.

    Fisher's scoring, damped as Levenberg and Marquardt do.

    Parameters
    ----------
    expected : callable
    counts : (bins,) float64
    start, least, most : (parameters,) float64

    Returns
    -------
    parameters : (parameters,) float64
    of_model : (bins,) float64
        Expected counts.
    slopes : (parameters, bins) float64
        Their derivatives.
    chi2 : float
    """
    filled = counts > 0

    def chi2_of(of_model: NDArray[np.float64]) -> float:
        ratio = np.log(counts[filled] / of_model[filled])
        return float(2 * (np.sum(of_model - counts) + np.sum(counts[filled] * ratio)))

    p = np.clip(start, least, most)
    of_model, slopes = expected(p)
    chi2, damping = chi2_of(of_model), 1e-3
    for _ in range(_MOST_STEPS):
        gradient = slopes @ (1.0 - counts / of_model)
        held = ((p <= least) & (gradient > 0)) | ((p >= most) & (gradient < 0))
        step = np.zeros(len(p))
        information, size = _scaled_information(slopes[~held], of_model)
        damped = information + damping * np.eye(len(size))
        step[~held] = size * np.linalg.solve(damped, size * gradient[~held])
        tried = np.clip(p - step, least, most)
        model_there, slopes_there = expected(tried)
        chi2_there = chi2_of(model_there)
        if not chi2_there < chi2:
            damping *= 10.0
            if damping > _MOST_DAMPED:
                break
            continue
        gained = chi2 - chi2_there
        p, of_model, slopes, chi2 = tried, model_there, slopes_there, chi2_there
        damping = max(0.1 * damping, _LEAST_DAMPED)
        if gained < _CLOSE:
            break
    return p, of_model, slopes, max(chi2, 0.0)


def inverse_information(
    slopes: NDArray[np.float64], of_model: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Inverse of Fisher's information: the covariance of the parameters.

    Parameters
    ----------
    slopes : (parameters, bins) float64
    of_model : (bins,) float64
    """
    information, size = _scaled_information(slopes, of_model)
    return np.linalg.pinv(information, hermitian=True) * np.outer(size, size)


def _scaled_information(
    slopes: NDArray[np.float64], of_model: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fisher's information of parameters in the units that follow, which make its diagonal 1."""
    information = (slopes / of_model) @ slopes.T
    size = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return information * np.outer(size, size), size
