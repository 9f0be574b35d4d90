"""Numbers whose errors keep the names of their origins, and the error budget made of them.

Errors of one origin move all numbers that have it together: the scale of a tube raises the
signals of two crystals alike and leaves their quotient as it is. Errors of different origins are
independent. To first order a number is then its value and a signed error per origin, and the
whole covariance of several numbers is in these names.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal

import numpy as np

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError

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

    Raises ValueError if an origin is of both kinds or an error is not finite.
    """

    #: The number.
    value: float
    #: Signed standard errors by origin that repeating the measurement reduces.
    statistical: Mapping[str, float] = field(default_factory=dict)
    #: Those that it does not reduce.
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
        """This number with none of its errors shared: origins become ``ORIGIN, WHOSE``."""
        statistical, systematic = (
            {f"{origin}, {whose}": sigma for origin, sigma in errors.items()}
            for errors in (self.statistical, self.systematic)
        )
        return Uncertain(self.value, statistical, systematic)


@dataclass(frozen=True, eq=False)
class CommonValue:
    """What several measurements of one quantity say together."""

    #: The weighted mean, its errors by origin.
    mean: Uncertain
    #: (values,) float64: None negative; their sum is 1.
    weights: Array
    #: Of the values about the mean, with the covariance that gave the weights; None for a
    #: single value, and where differences between values have no error.
    chi2: float | None
    #: Values less one.
    ndf: int
    _: KW_ONLY
    #: Probability of a larger chi2 if all measure the same; None where `chi2` is.
    p_value: float | None


def quotient(
    above: Iterable[tuple[str, Uncertain | float]], below: Iterable[tuple[str, Uncertain | float]]
) -> Uncertain:
    """Product of the factors `above` over the product of those `below`.

    To first order: relative errors of one origin are added with their signs, so that what
    numerator and denominator share cancels. Factors come with their names, for messages.

    Raises InputError if a factor, or the result, is not above 0 or not finite; ValueError if an
    origin is statistical in one factor and systematic in another.
    """
    value = 1.0
    statistical: dict[str, float] = {}
    systematic: dict[str, float] = {}
    for factors, power in ((above, 1), (below, -1)):
        for name, factor in factors:
            number = factor if isinstance(factor, Uncertain) else Uncertain(float(factor))
            if not (number.value > 0 and math.isfinite(number.value)):
                raise InputError(f"the {name} is {number.value:g}", "give a number above 0")
            value = value * number.value if power > 0 else value / number.value
            by_kind = (statistical, number.statistical), (systematic, number.systematic)
            for sums, errors in by_kind:
                for origin, sigma in errors.items():
                    sums[origin] = sums.get(origin, 0.0) + power * sigma / number.value
    if not 0 < value < math.inf:
        raise InputError(f"the result is {value:g}", "check the powers of ten of all factors")
    kinds = (statistical, systematic)
    scaled = ({origin: value * part for origin, part in kind.items()} for kind in kinds)
    return Uncertain(value, *scaled)


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

    Raises InputError if a value is not above 0; ValueError if there are none, or an origin is of
    two kinds.
    """
    # which take longer to import than commands that show a budget take for all else
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls
    from scipy.special import chdtrc

    if not values:
        raise ValueError("no values")
    for number in values:
        if not (number.value > 0 and math.isfinite(number.value)):
            raise InputError(f"one of the values is {number.value:g}", "give numbers above 0")
    relative = [number.relative for number in values]
    origins = list(dict.fromkeys(origin for errors in relative for origin in errors))
    errors = np.array([[parts.get(origin, 0.0) for origin in origins] for parts in relative])
    # (values, values), shared up to the smaller one
    size, sign = np.abs(errors), np.sign(errors)
    shared = np.minimum(size[:, None, :], size[None, :, :]) ** 2
    covariance = (sign[:, None, :] * sign[None, :, :] * shared).sum(axis=2)
    largest = covariance.max() or 1.0
    root = np.linalg.cholesky(covariance + _RIDGE * largest * np.eye(len(values)))
    # minimises w C w for w >= 0 and sum 1: the multiplier of the sum is a common factor
    weights, _ = nnls(root.T, solve_triangular(root, np.ones(len(values)), lower=True))
    weights /= weights.sum()
    mean = float(weights @ [number.value for number in values])
    sigma = dict(zip(origins, (mean * weights @ errors).tolist(), strict=True))
    chi2, ndf = None, len(values) - 1
    differences = np.diff(np.diff(covariance, axis=0), axis=1)
    if ndf and np.linalg.eigvalsh(differences)[0] > _DISTINCT * largest:
        pulls = solve_triangular(root, [number.value / mean - 1 for number in values], lower=True)
        chi2 = float(pulls @ pulls)
    statistical, systematic = (
        {o: part for o, part in sigma.items() if any(o in getattr(n, kind) for n in values)}
        for kind in ("statistical", "systematic")
    )
    p_value = None if chi2 is None else float(chdtrc(ndf, chi2))
    together = Uncertain(mean, statistical, systematic)
    return CommonValue(together, weights, chi2, ndf, p_value=p_value)


# The error budget: every contribution, what kind it is, and what would reduce it.

Kind = Literal["statistical", "systematic"]

_COUNTS = "longer runs and more mountings: the mean's error is their scatter over sqrt(n)"
_ABSORPTION = "a longer sample or several thicknesses, all orientations, a better spectrophotometer"


@dataclass(frozen=True)
class Advice:
    """What is known of an origin of errors."""

    #: What reduces it; where nothing can, why.
    by: str
    #: ``statistical`` (chance: more of the same reduces it) or ``systematic``.
    kind: Kind = "systematic"
    #: Whether a laboratory can reduce it on this bench and with this model.
    reducible: bool = True


#: By origin, as `Uncertain` and `ParameterEstimate.contributions` name them.
ADVICE: dict[str, Advice] = {
    "counts": Advice(_COUNTS, "statistical"),
    "statistical": Advice(_COUNTS, "statistical"),
    "signal": Advice("the counting's threshold and dead time, measured with a pulsed lamp"),
    "events": Advice("longer runs", "statistical"),
    "mountings": Advice("more mountings, each with a gap of its own", "statistical"),
    "monte_carlo": Advice("more photons (--photons, --precision)", "statistical"),
    "eta": Advice(
        "absorption: a longer sample, several thicknesses; scattering: more couplings and liquids"
    ),
    "prior": Advice(f"what the prior rests on; for absorption {_ABSORPTION}"),
    "bounds": Advice("a measurement of this number, as its prior: the readings do not tell it"),
    "plausible": Advice("further readings, which determine the size of what is missing"),
    "absorption": Advice(_ABSORPTION),
    "transmittance": Advice(
        "a longer sample or several thicknesses, a better spectrophotometer, its 100 % line"
    ),
    "thickness": Advice("the sample measured with a micrometer"),
    "orientations": Advice("more orientations, the one of the light's path above all"),
    "scattering": Advice(
        "more couplings and liquids: it is fitted to the ratios of the signals", "statistical"
    ),
    "detector_efficiency": Advice(
        "the detector's calibration against a standard, an emission spectrum of one's own"
    ),
    "tube scale": Advice(
        "not by repeating: only by calibrating the detector against a standard (5 % to 1-2 %)"
    ),
    "quantum efficiency curve": Advice("a measurement of this detector with a calibrated lamp"),
    "emission spectrum": Advice(
        "a measurement on this very crystal, the spectrometer corrected with a calibrated lamp"
    ),
    "collection_efficiency": Advice("the spectrum of single photoelectrons, at this threshold"),
    "photoelectron scale": Advice(
        "single photoelectrons: more events; the ranges' ratio: one pulse in both"
    ),
    "pedestal": Advice("longer runs in the dark, a nonlinearity that is measured better"),
    "crosstalk": Advice("dark counts against the threshold, at this overvoltage"),
    "tolerances": Advice("the bench's numbers, measured again"),
    "tolerance": Advice("this number, measured again"),
    "energy": Advice("lines of sources are known far better than the rest", reducible=False),
    "reference light yield": Advice("a reference that is known better, or several references"),
    "index": Advice("the index measured on this material (prism, ellipsometer)"),
    "index spread": Advice("the model has one index over the whole emission band", reducible=False),
    "birefringence": Advice(
        "the model has one index for all directions of polarisation", reducible=False
    ),
    "source depth": Advice("the effect source_depth in the campaign, its prior from `lab gammas`"),
}


@dataclass(frozen=True)
class Contribution:
    """One row of a budget."""

    #: The origin, with whose it is after a comma where it says so.
    name: str
    #: Standard error as a fraction of the value; its sign is that of `Uncertain`.
    relative: float
    #: ``statistical`` or ``systematic``.
    kind: Kind
    reducible: bool
    _: KW_ONLY
    #: As in `Advice`.
    by: str

    @property
    def origin(self) -> str:
        """The name without whose it is."""
        return self.name.partition(",")[0]


@dataclass(frozen=True)
class ErrorBudget:
    """Independent contributions to one number's error."""

    #: The largest first.
    contributions: tuple[Contribution, ...]

    def __post_init__(self) -> None:
        largest_first = sorted(self.contributions, key=lambda row: -abs(row.relative))
        object.__setattr__(self, "contributions", tuple(largest_first))

    @property
    def total(self) -> float:
        """Relative error: all contributions in quadrature."""
        return math.hypot(*(row.relative for row in self.contributions))

    @property
    def statistical(self) -> float:
        """The statistical ones in quadrature, relative."""
        return self._of("statistical")

    @property
    def systematic(self) -> float:
        """The systematic ones in quadrature, relative."""
        return self._of("systematic")

    def _of(self, kind: Kind) -> float:
        return math.hypot(*(row.relative for row in self.contributions if row.kind == kind))

    @property
    def merged(self) -> ErrorBudget:
        """One contribution an origin: ``counts`` for ``counts, air`` and ``counts, gel``."""
        together: dict[tuple[str, Kind], float] = {}
        for row in self.contributions:
            key = row.origin, row.kind
            together[key] = math.hypot(together.get(key, 0.0), row.relative)
        rows = (contribution(origin, size, kind) for (origin, kind), size in together.items())
        return ErrorBudget(tuple(rows))

    def share(self, row: Contribution) -> float:
        """Part of the variance that is this contribution's, 0..1; 0 where nothing has an error."""
        return (row.relative / self.total) ** 2 if self.total else 0.0


def contribution(origin: str, relative: float, kind: Kind | None = None) -> Contribution:
    """A row of a budget, with what is known of its origin.

    The origin is one of `ADVICE`, perhaps with whose it is: ``counts, air``; the error is a
    fraction of the value, and its kind that of `ADVICE` unless the number itself says otherwise.

    Raises ValueError if the origin is not in `ADVICE`.
    """
    advice = ADVICE.get(origin.partition(",")[0])
    if advice is None:
        raise ValueError(f"no advice for the error {origin!r}: known are {', '.join(ADVICE)}")
    return Contribution(origin, relative, kind or advice.kind, advice.reducible, by=advice.by)


def budget_of(number: Uncertain) -> ErrorBudget:
    """The budget of a number, its kinds as the number has them.

    Raises ValueError if an origin is not in `ADVICE`.
    """
    kinds: dict[str, Kind] = dict.fromkeys(number.statistical, "statistical")
    parts = number.relative.items()
    rows = (contribution(origin, part, kinds.get(origin, "systematic")) for origin, part in parts)
    return ErrorBudget(tuple(rows))
