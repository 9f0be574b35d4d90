"""Numbers whose errors keep the names of their origins, so that shared ones stay shared.

Errors of one origin move all numbers that have it together: the scale of a tube raises the
signals of two crystals alike and leaves their quotient as it is. Errors of different origins are
independent. To first order a number is then its value and a signed error per origin, and the
whole covariance of several numbers is in these names.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls
from scipy.special import chdtrc

from mcrim_mitsuba.errors import InputError

# Added to a variance, relative to the largest: without it, values whose errors are all shared
# would have no covariance to invert.
_RIDGE = 1e-9
# Variance of a difference, relative to the largest, from which it has an error of its own.
_DISTINCT = 1e-7


@dataclass(frozen=True)
class Uncertain:
    """A value and its standard errors by origin, in the value's own unit.

    A negative error moves the value against others of the same origin. An origin may say whose
    it is after a comma: ``counts, air`` and ``counts, gel`` are two independent origins.

    Attributes
    ----------
    value : float
        The number.
    statistical : mapping of str to float
        Signed standard errors by origin that repeating the measurement reduces.
    systematic : mapping of str to float
        Those that it does not reduce.

    Raises
    ------
    ValueError
        If an origin is of both kinds or an error is not finite.
    """

    value: float
    statistical: Mapping[str, float] = field(default_factory=dict)
    systematic: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if both := self.statistical.keys() & self.systematic.keys():
            raise ValueError(f"{', '.join(sorted(both))} cannot be statistical and systematic")
        for origin, sigma in self.contributions.items():
            if not math.isfinite(sigma):
                raise ValueError(f"the error {origin} is {sigma}")

    @property
    def contributions(self) -> dict[str, float]:
        """Signed standard errors of both kinds by origin, in the value's unit."""
        return {**self.statistical, **self.systematic}

    @property
    def relative(self) -> dict[str, float]:
        """`contributions` as fractions of the value."""
        return {origin: sigma / self.value for origin, sigma in self.contributions.items()}

    @property
    def statistical_sigma(self) -> float:
        """All statistical errors in quadrature, in the value's unit."""
        return math.hypot(*self.statistical.values())

    @property
    def systematic_sigma(self) -> float:
        """All systematic errors in quadrature, in the value's unit."""
        return math.hypot(*self.systematic.values())

    @property
    def sigma(self) -> float:
        """All errors in quadrature, in the value's unit."""
        return math.hypot(self.statistical_sigma, self.systematic_sigma)

    def own(self, whose: str) -> Uncertain:
        """The same number with none of its errors shared: origins become ``ORIGIN, WHOSE``."""
        return Uncertain(
            self.value,
            {f"{origin}, {whose}": sigma for origin, sigma in self.statistical.items()},
            {f"{origin}, {whose}": sigma for origin, sigma in self.systematic.items()},
        )


@dataclass(frozen=True, eq=False)
class CommonValue:
    """What several measurements of one quantity say together.

    Attributes
    ----------
    mean : Uncertain
        The weighted mean, its errors by origin.
    weights : (values,) float64
        None negative; their sum is 1.
    chi2 : float or None
        Of the values about the mean, with the covariance that gave the weights; None for a
        single value, and where differences between values have no error.
    ndf : int
        Values less one.
    p_value : float or None
        Probability of a larger chi2 if all measure the same; None where `chi2` is.
    """

    mean: Uncertain
    weights: NDArray[np.float64]
    chi2: float | None
    ndf: int
    p_value: float | None


def quotient(
    above: Iterable[tuple[str, Uncertain | float]], below: Iterable[tuple[str, Uncertain | float]]
) -> Uncertain:
    """Product of the factors `above` over the product of those `below`.

    To first order: relative errors of one origin are added with their signs, so that what
    numerator and denominator share cancels.

    Parameters
    ----------
    above, below : iterable of (name, Uncertain or float)
        Factors, all above 0; a plain number has no error. Names serve the error message.

    Raises
    ------
    InputError
        If a factor, or the result, is not above 0 or not finite.
    ValueError
        If an origin is statistical in one factor and systematic in another.
    """
    value = 1.0
    statistical: dict[str, float] = {}
    systematic: dict[str, float] = {}
    for factors, power in ((above, 1), (below, -1)):
        for name, factor in factors:
            known = factor if isinstance(factor, Uncertain) else Uncertain(float(factor))
            if not (known.value > 0 and math.isfinite(known.value)):
                raise InputError(f"the {name} is {known.value:g}", "give a number above 0")
            value = value * known.value if power > 0 else value / known.value
            for sums, errors in (
                (statistical, known.statistical),
                (systematic, known.systematic),
            ):
                for origin, sigma in errors.items():
                    sums[origin] = sums.get(origin, 0.0) + power * sigma / known.value
    if not 0 < value < math.inf:
        raise InputError(f"the result is {value:g}", "check the powers of ten of all factors")
    return Uncertain(
        value,
        {origin: value * relative for origin, relative in statistical.items()},
        {origin: value * relative for origin, relative in systematic.items()},
    )


def common_value(values: Sequence[Uncertain]) -> CommonValue:
    """Mean of several measurements of one quantity that share some of their errors.

    The best linear unbiased estimate (generalised least squares) with two precautions, without
    which shared errors can put it outside the values that it is made of:

    - Errors are relative ones of the common value, not of every single measurement. Shared
      absolute errors would favour the low values (Peelle's pertinent puzzle: 1.5 and 1.0, each
      with 10 % of its own and 20 % in common, would give 0.88 and not 1.25).
    - For the weights, an origin's error counts as shared up to the smaller of two values'
      errors. If the mean could use the difference of two errors that are nearly the same, a
      rounding in the third digit would decide which measurement is used at all. (The mean is
      unbiased whatever the weights; A. Valassi and R. Chierici, Eur. Phys. J. C 74 (2014) 2717.)

    The mean's errors are those of its origins, fully shared, with these weights.

    Parameters
    ----------
    values : sequence of Uncertain
        At least one; all above 0.

    Raises
    ------
    InputError
        If a value is not above 0.
    ValueError
        If there are none, or an origin is of two kinds.
    """
    if not values:
        raise ValueError("no values")
    for known in values:
        if not (known.value > 0 and math.isfinite(known.value)):
            raise InputError(f"one of the values is {known.value:g}", "give numbers above 0")
    origins = list(dict.fromkeys(origin for known in values for origin in known.relative))
    errors = np.array([[known.relative.get(origin, 0.0) for origin in origins] for known in values])
    covariance = _for_weights(errors)
    largest = covariance.max() or 1.0
    root = np.linalg.cholesky(covariance + _RIDGE * largest * np.eye(len(values)))
    # minimises w C w for w >= 0 and sum 1: the multiplier of the sum is a common factor
    weights, _ = nnls(root.T, solve_triangular(root, np.ones(len(values)), lower=True))
    weights /= weights.sum()
    mean = float(weights @ [known.value for known in values])
    sigma = dict(zip(origins, (mean * weights @ errors).tolist(), strict=True))
    statistical = {origin for known in values for origin in known.statistical}
    systematic = {origin for known in values for origin in known.systematic}
    chi2, ndf = None, len(values) - 1
    differences = np.diff(np.diff(covariance, axis=0), axis=1)
    if ndf and np.linalg.eigvalsh(differences)[0] > _DISTINCT * largest:
        pulls = solve_triangular(root, [known.value / mean - 1 for known in values], lower=True)
        chi2 = float(pulls @ pulls)
    return CommonValue(
        Uncertain(
            mean,
            {origin: part for origin, part in sigma.items() if origin in statistical},
            {origin: part for origin, part in sigma.items() if origin in systematic},
        ),
        weights,
        chi2,
        ndf,
        None if chi2 is None else float(chdtrc(ndf, chi2)),
    )


def _for_weights(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(values, values) covariance from (values, origins) errors, shared up to the smaller one."""
    size, sign = np.abs(errors), np.sign(errors)
    shared = np.minimum(size[:, None, :], size[None, :, :]) ** 2
    return (sign[:, None, :] * sign[None, :, :] * shared).sum(axis=2)


def relative_error(*parts: float) -> float:
    """Relative errors of independent factors in quadrature: 0.12, 0.10, 0.016 give 0.157."""
    return math.hypot(*parts)
