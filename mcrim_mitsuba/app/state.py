"""What the page's controls move, and what its session holds: plain, frozen, replaced as a whole."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value, unit_of, without_unit
from mcrim_mitsuba.effects.effect import EffectParameter
from mcrim_mitsuba.inference.diagnose import Diagnosed
from mcrim_mitsuba.inference.estimates import FittedRow
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.model import ResponseModel

#: Smallest value of a slider that runs along a logarithm, as part of the largest.
_LEAST_PART = 1e-3


@dataclass(frozen=True)
class Control:
    """A number with a slider."""

    #: The parameter's.
    name: str
    #: What it is called on the page.
    title: str
    unit: str
    minimum: float
    maximum: float
    start: float
    #: In what the slider is even: ``linear``, ``reciprocal`` (1 / (value + scale)) or
    #: ``logarithmic`` (log(1 + value / scale)).
    coordinate: str = "linear"
    scale: float = 1.0
    meaning: str = ""

    def coordinate_of(self, value: float) -> float:
        """Where a value lies on the slider's axis."""
        if self.coordinate == "reciprocal":
            return 1.0 / (value + self.scale)
        if self.coordinate == "logarithmic":
            return math.log1p(value / self.scale)
        return value

    def part_at(self, value: float) -> float:
        """Where a value lies along the slider, 0 to 1; `start` for what is not finite."""
        inside = min(max(value, self.minimum), self.maximum) if math.isfinite(value) else self.start
        low, high, x = map(self.coordinate_of, (self.minimum, self.maximum, inside))
        return (x - low) / (high - low)


def parameter_control(
    parameter: CampaignParameter, covered: tuple[float, float] | None = None
) -> Control:
    """Of a parameter that the campaign fits.

    Parameters
    ----------
    parameter : CampaignParameter
    covered : tuple of float, optional
        What simulations cover.
    """
    low, high = parameter.minimum, parameter.maximum
    if covered is not None:
        low, high = max(low, covered[0]), min(high, covered[1])
    start = min(max(parameter.start, low), high)
    if not math.isfinite(high):
        high = 10.0 * max(abs(start), 1.0)
    if not math.isfinite(low):
        low = -high
    name, coordinate, scale = parameter.name, "linear", 1.0
    if name in (ALPHA_SCAT, ALPHA_ABS):
        # log(1 + value / scale) is as good as log(value) where the scale is small
        coordinate, scale = "logarithmic", max(low, _LEAST_PART * high)
    meaning = ""
    if parameter.prior is not None:
        meaning = f"known beforehand: {parameter.prior:g} ± {parameter.prior_sigma:g}"
    title, unit = without_unit(name), unit_of(name) or ""
    return Control(name, title, unit, low, high, start, coordinate, scale, meaning)


def effect_control(
    parameter: EffectParameter,
    scene: Mapping[str, Value],
    configurations: Sequence[Mapping[str, Value]],
    largest_signal: float,
) -> Control:
    """Of an effect's parameter.

    Parameters
    ----------
    parameter : EffectParameter
    scene : mapping of str to value
        Parameters of the scene.
    configurations : sequence of mapping of str to value
        The same of every reading.
    largest_signal : float
        Ends the slider of what has no range.
    """
    start, low, high = parameter.range_in(scene)
    if parameter.limits is not None:
        zero = start - parameter.start
        ends = [parameter.limits(values) for values in configurations]
        low, high = max(low, *(zero + e[0] for e in ends)), min(high, *(zero + e[1] for e in ends))
    low = low if math.isfinite(low) else start - largest_signal
    high = high if math.isfinite(high) else start + largest_signal
    coordinate, scale = parameter.coordinate, parameter.scale
    if coordinate == "logarithmic" and scale < 0:
        coordinate = "linear"
    return Control(
        parameter.name, without_unit(parameter.name), parameter.unit, low, high,
        min(max(start, low), high), coordinate, scale, parameter.meaning,
    )  # fmt: skip


# What the session holds and shows.


@dataclass(frozen=True)
class Settings:
    """What the page's controls say."""

    #: Switched on, besides the campaign's own.
    effects: tuple[str, ...] = ()
    #: By parameter; the scale is among them where it is not fitted.
    values: Mapping[str, float] = field(default_factory=dict)
    #: Whether the scale follows the readings.
    fit_scale: bool = True


@dataclass(frozen=True)
class Shown:
    """What the page shows of the model at some settings."""

    rows: tuple[FittedRow, ...]
    #: Readings in use and priors.
    chi2: float
    #: Of a fit of all that is shown.
    ndf: int
    p_value: float | None
    #: Signal at an efficiency of 1.
    scale: float
    #: Photons per keV: value, statistical error with all else held, systematic error.
    light_yield: tuple[float, float, float] | None
    #: Effects that are switched on but not simulated yet.
    pending: tuple[str, ...]


@dataclass(frozen=True)
class FitStep:
    """A fit that was made on the page."""

    effects: tuple[str, ...]
    calibration: Calibration


@dataclass(frozen=True)
class State:
    """All that jobs change, replaced as a whole."""

    #: Rises with every change.
    number: int = 0
    #: Effects that were simulated; None before the bench as it is was.
    ready: frozenset[str] | None = None
    #: Of the campaign as it came.
    baseline: Calibration | None = None
    #: By the effects switched on: models that were simulated where their fit ended.
    settled: Mapping[tuple[str, ...], ResponseModel] = field(default_factory=dict)
    steps: tuple[FitStep, ...] = ()
    diagnosed: Diagnosed | None = None
    #: What the controls should say; pages take them over when `settings_number` rises.
    settings: Settings = field(default_factory=Settings)
    settings_number: int = 0
    #: Name and content of what is to be downloaded.
    file: tuple[str, bytes] | None = None
    #: Rises with every file: a page downloads one that it has not had.
    file_number: int = 0
