"""The error budget: every contribution, what kind it is, and what would reduce it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from mcrim_mitsuba.physics.contributions import Uncertain

Kind = Literal["statistical", "systematic"]

_COUNTS = "longer runs and more mountings: the mean's error is their scatter over sqrt(n)"
_ABSORPTION = "a longer sample or several thicknesses, all orientations, a better spectrophotometer"


@dataclass(frozen=True)
class Advice:
    """What is known of an origin of errors.

    Attributes
    ----------
    kind : str
        ``statistical`` (chance: more of the same reduces it) or ``systematic``.
    reducible : bool
        Whether a laboratory can reduce it on this bench and with this model.
    by : str
        By what; where it cannot, why.
    """

    kind: Kind
    reducible: bool
    by: str


#: By origin, as `Uncertain` and `ParameterEstimate.contributions` name them.
ADVICE: dict[str, Advice] = {
    "counts": Advice("statistical", True, _COUNTS),
    "statistical": Advice("statistical", True, _COUNTS),
    "signal": Advice(
        "systematic", True, "the counting's threshold and dead time, measured with a pulsed lamp"
    ),
    "events": Advice("statistical", True, "longer runs"),
    "mountings": Advice("statistical", True, "more mountings, each with a gap of its own"),
    "monte_carlo": Advice("statistical", True, "more photons (--photons, --precision)"),
    "eta": Advice(
        "systematic", True,
        "absorption: a longer sample, several thicknesses; scattering: more couplings and liquids",
    ),
    "prior": Advice("systematic", True, f"what the prior rests on; for absorption {_ABSORPTION}"),
    "absorption": Advice("systematic", True, _ABSORPTION),
    "transmittance": Advice(
        "systematic", True,
        "a longer sample or several thicknesses, a better spectrophotometer, its 100 % line",
    ),
    "thickness": Advice("systematic", True, "the sample measured with a micrometer"),
    "orientations": Advice(
        "systematic", True, "more orientations, the one of the light's path above all"
    ),
    "scattering": Advice(
        "statistical", True,
        "more couplings and liquids: it is fitted to the ratios of the signals",
    ),
    "detector_efficiency": Advice(
        "systematic", True,
        "the tube's calibration against a standard, an emission spectrum of one's own",
    ),
    "tube scale": Advice(
        "systematic", True,
        "not by repeating: only by calibrating the tube against a standard (5 % to 1-2 %)",
    ),
    "quantum efficiency curve": Advice(
        "systematic", True, "a measurement of this very tube with a calibrated lamp"
    ),
    "emission spectrum": Advice(
        "systematic", True,
        "a measurement on this very crystal, the spectrometer corrected with a calibrated lamp",
    ),
    "energy": Advice("systematic", False, "lines of sources are known far better than the rest"),
    "reference light yield": Advice(
        "systematic", True, "a reference that is known better, or several references"
    ),
    "index": Advice(
        "systematic", True, "the index measured on this material (prism, ellipsometer)"
    ),
    "index spread": Advice(
        "systematic", False, "the model has one index over the whole emission band"
    ),
    "birefringence": Advice(
        "systematic", False, "the model has one index for all directions of polarisation"
    ),
    "source depth": Advice(
        "systematic", True, "the effect source_depth in the campaign, its prior from `lab gammas`"
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Contribution:
    """One row of a budget.

    Attributes
    ----------
    name : str
        The origin, with whose it is after a comma where it says so.
    relative : float
        Standard error as a fraction of the value; its sign is that of `Uncertain`.
    kind : str
        ``statistical`` or ``systematic``.
    reducible : bool
    by : str
        As in `Advice`.
    """

    name: str
    relative: float
    kind: Kind
    reducible: bool
    by: str

    @property
    def origin(self) -> str:
        """The name without whose it is."""
        return self.name.partition(",")[0]


@dataclass(frozen=True)
class ErrorBudget:
    """Independent contributions to one number's error.

    Attributes
    ----------
    contributions : tuple of Contribution
        The largest first.
    """

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
        return ErrorBudget(
            tuple(contribution(origin, size, kind) for (origin, kind), size in together.items())
        )

    def share(self, row: Contribution) -> float:
        """Part of the variance that is this contribution's, 0..1; 0 where nothing has an error."""
        return (row.relative / self.total) ** 2 if self.total else 0.0


def contribution(origin: str, relative: float, kind: Kind | None = None) -> Contribution:
    """A row of a budget, with what is known of its origin.

    Parameters
    ----------
    origin : str
        One of `ADVICE`, or one with whose it is: ``counts, air``.
    relative : float
        Standard error as a fraction of the value.
    kind : str, optional
        That of `ADVICE` unless the number itself says otherwise.

    Raises
    ------
    ValueError
        If the origin is not in `ADVICE`.
    """
    known = ADVICE.get(origin.partition(",")[0])
    if known is None:
        raise ValueError(f"no advice for the error {origin!r}: known are {', '.join(ADVICE)}")
    return Contribution(origin, relative, kind or known.kind, known.reducible, known.by)


def budget_of(known: Uncertain) -> ErrorBudget:
    """The budget of a number, its kinds as the number has them.

    Raises
    ------
    ValueError
        If an origin is not in `ADVICE`.
    """
    return ErrorBudget(
        tuple(
            contribution(origin, relative, "statistical" if origin in known.statistical else
                         "systematic")
            for origin, relative in known.relative.items()
        )
    )  # fmt: skip


def budget_from(relative: Mapping[str, float]) -> ErrorBudget:
    """The budget of relative errors by origin, their kinds from `ADVICE`.

    Raises
    ------
    ValueError
        If an origin is not in `ADVICE`.
    """
    return ErrorBudget(tuple(contribution(*part) for part in relative.items()))
