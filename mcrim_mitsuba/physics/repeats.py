"""One number from repeated measurements, as the article has from four mountings of its crystal.

Mountings scatter by nature, and by more than the error of each centroid: the article's by 0.4 of
14.3 photons, where the fit of a histogram knows its centroid to 0.07. The mean therefore takes its
error from the scatter, and a scatter above the errors is reported, not a fault. Of three values or
two it is hardly known, its relative error being 1 / sqrt(2 (n - 1)), and this is said.
Inconsistent are

- an outlier: a value that differs from the mean of the others by more than their own scatter (or
  the errors, if larger) lets expect, by Student's t with two degrees of freedom less than there are
  values. The chance that any of n values is called so by mistake is 1 % (p < 1 % / n each). Three
  values at least; of four, an outlier is 23 standard deviations of the others away;
- a scatter above 10 % of the mean, three times the article's, which the errors do not explain
  (p < 1 %). For two values this is the only test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import t as student

from mcrim_mitsuba.errors import InputError

# Chance of an alarm where nothing is wrong; relative scatter that no mounting makes.
_LEAST_P, _MOST_SCATTER = 0.01, 0.10
# Values whose scatter is hardly known.
_FEW = 3


@dataclass(frozen=True)
class Repeated:
    """Mean of repeated measurements.

    Attributes
    ----------
    mean, sigma : float
        Plain mean, and the larger of the two errors below.
    scatter_sigma : float or None
        Standard deviation of the values over the square root of their number; None for one value.
    internal_sigma : float
        From the errors of the values.
    chi2, ndf : float, int
        Of the values about their weighted mean, with their own errors.
    p_value : float or None
        Chance of a larger chi2; None for one value. Below 1 %, mountings scatter by more than
        the errors.
    consistent : bool
        Neither an outlier nor a scatter that no mounting makes.
    outliers : tuple of int
        Positions of the outliers, from 0.
    warnings : tuple of str
        What is inconsistent, outliers first, and that the values are few, a sentence each.
    """

    mean: float
    sigma: float
    scatter_sigma: float | None
    internal_sigma: float
    chi2: float
    ndf: int
    p_value: float | None
    consistent: bool
    outliers: tuple[int, ...]
    warnings: tuple[str, ...]


def combine(values: Sequence[float], sigmas: Sequence[float]) -> Repeated:
    """Mean of repeated measurements with both of its errors.

    Parameters
    ----------
    values, sigmas : sequence of float
        Each value with its own error, above 0.

    Raises
    ------
    InputError
        If there is no value, or a number is not finite or an error not above 0.
    """
    x, errors = np.asarray(values, float), np.asarray(sigmas, float)
    if not len(x) or x.shape != errors.shape:
        raise InputError(
            f"{len(x)} values with {len(errors)} errors", "give each value an error, one at least"
        )
    for value, error in zip(x, errors, strict=True):
        if not (math.isfinite(value) and math.isfinite(error) and error > 0):
            raise InputError(f"{value:g} ± {error:g} cannot be averaged", "give an error above 0")
    mean, internal = float(x.mean()), float(np.linalg.norm(errors)) / len(x)
    if len(x) == 1:
        return Repeated(mean, internal, None, internal, 0.0, 0, None, True, (), ())
    spread = float(x.std(ddof=1))
    scatter = spread / math.sqrt(len(x))
    weighted = float(np.average(x, weights=errors**-2.0))
    chi2, ndf = float(np.sum(((x - weighted) / errors) ** 2)), len(x) - 1
    p_value = float(chi2_distribution.sf(chi2, ndf))
    outliers = _outliers(x, errors)
    said = [
        f"value {i + 1}, {x[i]:.4g}, is an outlier: the others have a mean of "
        f"{np.delete(x, i).mean():.4g} and scatter by {np.delete(x, i).std(ddof=1):.2g}"
        for i in outliers
    ]
    if spread > _MOST_SCATTER * abs(mean) and p_value < _LEAST_P:
        said.append(
            f"the values scatter by {spread:.2g}, more than {100 * _MOST_SCATTER:.0f} % of their "
            f"mean: are they all of one configuration?"
        )
    consistent = not said
    if len(x) <= _FEW:
        said.append(
            f"the scatter of only {len(x)} values is itself known to "
            f"{100 / math.sqrt(2 * ndf):.0f} %, and the error of their mean no better: measure more"
        )
    return Repeated(
        mean, max(scatter, internal), scatter, internal, chi2, ndf, p_value, consistent, outliers,
        tuple(said),
    )  # fmt: skip


def _outliers(x: np.ndarray, errors: np.ndarray) -> tuple[int, ...]:
    """Values that the others do not let expect."""
    count = len(x)
    if count < 3:
        return ()
    found = []
    for i in range(count):
        others, their_errors = np.delete(x, i), np.delete(errors, i)
        expected = max(
            others.var(ddof=1) * count / (count - 1),
            errors[i] ** 2 + np.mean(their_errors**2) / (count - 1),
        )
        t = abs(x[i] - others.mean()) / math.sqrt(expected)
        if 2 * student.sf(t, count - 2) < _LEAST_P / count:
            found.append(i)
    return tuple(found)
