"""Along which bench parameter the pulls run."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from mcrim_mitsuba.diagnosis.result import Trend
from mcrim_mitsuba.diagnosis.solver import Array, Fit
from mcrim_mitsuba.diagnosis.statistics import corrected, pulls

# Factors of levels that the free parameters follow but for this part are absorbed.
_ABSORBED = 1e-6


def find_trends(fit: Fit) -> tuple[Trend, ...]:
    """Bench parameters by how clearly the pulls differ between their values.

    Every value (level) of a bench parameter is given a factor of its own on the signal, and the
    fall of chi2 is compared with what is left, as an analysis of variance does:
    F = (fall / factors) / (rest / its degrees of freedom). What the free parameters follow is no
    factor: all is weighed with `Fit.precision`. With too many levels for the readings a straight
    line takes their place.

    Parameters
    ----------
    fit : Fit

    Returns
    -------
    tuple of Trend
        One per column of the measurement file with two values or more, the clearest first.
    """
    readings = [r for r in fit.problem.model.readings if r.use]
    columns = dict.fromkeys(name for r in readings for name in r.parameters)
    found = []
    for name in columns:
        cells = [r.parameters.get(name) for r in readings]
        levels = sorted(set(cells), key=lambda v: (isinstance(v, str), v))
        if len(levels) > 1:
            found.append((name, tuple(levels), np.array([levels.index(c) for c in cells])))
    trends = [_trend(fit, name, levels, which, len(found)) for name, levels, which in found]
    # without a p-value the fall in chi2 decides
    return tuple(sorted(trends, key=lambda t: (t.p_value is None, t.p_value, -t.delta_chi2)))


def _trend(fit: Fit, name: str, levels: tuple, which: np.ndarray, tried: int) -> Trend:
    predicted = fit.signal[fit.problem.used]
    factors = predicted[:, None] * (which[:, None] == np.arange(len(levels)))
    if len(levels) - 1 > max(fit.ndf // 2, 1):
        factors = (predicted * (which - which.mean()))[:, None]
    fall, count = _fall(fit, factors)
    rest, ndf = max(fit.chi2 - fall, 0.0), fit.ndf - count
    p = None
    if count > 0 and ndf > 0:
        f = (fall / count) / max(rest / ndf, 1e-300)
        p = corrected(float(fdtrc(count, ndf, f)), tried)
    own = pulls(fit)
    means = tuple(float(own[which == i].mean()) for i in range(len(levels)))
    return Trend(name, levels, means, fall, count, p)


def _fall(fit: Fit, factors: Array) -> tuple[float, int]:
    """Fall of chi2 with a factor per column, and how many of them the parameters do not follow."""
    seen = factors.T @ fit.precision @ factors
    whole = np.sqrt(np.einsum("ij,ij->j", factors, fit.weights.inverse @ factors))
    values, vectors = np.linalg.eigh(seen / np.outer(whole, whole))
    kept = values > _ABSORBED
    along = vectors[:, kept].T @ (factors.T @ (fit.weights.inverse @ fit.residuals) / whole)
    return float((along**2 / values[kept]).sum()), int(kept.sum())
