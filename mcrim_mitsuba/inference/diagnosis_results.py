"""What compare, diagnose and repair hand back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mcrim_mitsuba.core.json_text import plain
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.inference.calibration import FittedRow, ParameterEstimate

#: The verdicts of a diagnosis.
TOO_FEW_READINGS = "too_few_readings"
ADEQUATE = "adequate"
MISSING_EFFECT = "missing_effect"
AMBIGUOUS = "ambiguous"
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class _Plain:
    """Turns a dataclass into what JSON can hold."""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts; what is not finite becomes None."""
        return plain(self)


@dataclass(frozen=True)
class Suspect(_Plain):
    """Readings that may be wrong, rather than the model."""

    #: ``bad_reading`` (one reading off) or ``swapped_rows`` (two signals exchanged).
    kind: str
    #: The reading, or the two.
    labels: tuple[str, ...]
    #: What chi2 falls by without the reading, or with the two exchanged.
    delta_chi2: float
    #: Probability of as much by chance, corrected for having tried all readings or pairs.
    p_gain: float
    #: Of the fit without it.
    chi2: float
    ndf: int
    p_value: float | None
    #: Of the single reading from what the others predict, in standard errors.
    pull: float | None
    #: Whether the fit without it is acceptable.
    explains: bool


@dataclass(frozen=True)
class Trend(_Plain):
    """How the pulls run along one bench parameter."""

    #: A column of the measurement file.
    parameter: str
    #: Its values, ascending.
    levels: tuple[Value, ...]
    #: Weighted mean residual of each level, in readings' standard errors.
    mean_pulls: tuple[float, ...]
    #: What chi2 falls by if every level may have a factor of its own.
    delta_chi2: float
    #: Factors that the free parameters do not absorb.
    ndf: int
    #: Of the spread between levels against that within (F test), corrected for the number of
    #: bench parameters; None without degrees of freedom left.
    p_value: float | None


@dataclass(frozen=True)
class Absorbed(_Plain):
    """A fitted parameter that looks as if it had taken up a misfit."""

    parameter: str
    #: ``prior_pulled``, ``bound_reached`` or ``implausible``.
    sign: str
    value: float
    #: The same for the reader.
    words: str


@dataclass(frozen=True)
class Comparison(_Plain):
    """A fitted campaign, laid out to show where the model fails."""

    parameters: dict[str, ParameterEstimate]
    #: As in `Calibration`.
    chi2: float
    ndf: int
    p_value: float | None
    #: ndf - sqrt(2 ndf), ndf + sqrt(2 ndf): where chi2 lies in 2 of 3 campaigns.
    expected_chi2: tuple[float, float]
    #: In standard errors of the readings; the second of readings left out of the fit.
    rms_pull: float
    left_out_error: float
    rows: tuple[FittedRow, ...]
    #: By label: how far every reading in use is from what the others predict, in standard errors.
    left_out_pulls: dict[str, float]
    #: Single bad readings and swapped rows that account for the misfit, the likeliest first.
    suspects: tuple[Suspect, ...]
    #: The clearest first.
    trends: tuple[Trend, ...]
    absorbed: tuple[Absorbed, ...]


@dataclass(frozen=True)
class Candidate(_Plain):
    """The campaign fitted with one effect added, or with a pair."""

    #: Its name; of a pair both, joined by ``+``.
    effect: str
    effects: tuple[str, ...]
    #: Of the fit with it.
    chi2: float
    ndf: int
    p_value: float | None
    #: What chi2 falls by, and the simulation's error of that.
    delta_chi2: float
    delta_chi2_sigma: float
    #: Probability of this gain by chance, were this effect the only one tried; None for a pair.
    p_gain: float | None
    #: Of the best of all effects gaining as much; None for a pair.
    p_global: float | None
    #: Relative to the baseline: negative is better; None where there are too few readings.
    aicc: float | None
    #: How far behind the best in chi2 + 2 per free parameter, by which candidates are ranked.
    behind: float
    left_out_error: float
    #: All free ones.
    parameters: dict[str, ParameterEstimate]
    #: Those that the effect brings.
    effect_parameters: tuple[str, ...]
    #: ``value``, ``sigma``, ``change`` (from the baseline, relative); None where the campaign
    #: does not say how to get it.
    light_yield_ph_per_keV: dict[str, float] | None
    #: Whether the effect has a size that a laboratory meets.
    plausible: bool
    #: Whether one of its parameters ended at its bound.
    at_bound: bool
    #: Part (0..1) of what the effect does to the readings that the other parameters follow.
    collinearity: float
    #: Effects that it could be mistaken for.
    mimics: tuple[str, ...]


@dataclass(frozen=True)
class Limit(_Plain):
    """What adequate data say about an effect's size, at 95 % confidence."""

    #: None where the effect is on or off.
    parameter: str | None
    #: Value at which it is not there.
    absent: float | None
    #: Ends of what is allowed; None on the side of a boundary at which the effect is absent.
    #: Infinite where the data allow everything up to the end of the range.
    lower: float | None
    upper: float | None
    #: Fall of chi2 with the effect; negative where it makes the fit worse.
    delta_chi2: float
    #: Of an effect that is on or off: whether the data refuse it.
    excluded: bool


@dataclass(frozen=True)
class RepairStep(_Plain):
    """One step of the repair."""

    step: int
    #: The effect; None for the campaign as it came.
    added: str | None
    #: All added so far.
    effects: tuple[str, ...]
    #: Of the fit.
    chi2: float
    ndf: int
    p_value: float | None
    rms_pull: float
    left_out_error: float
    #: Simulation's error of chi2's fall in this step.
    delta_chi2_sigma: float
    parameters: dict[str, ParameterEstimate]
    #: ``value`` and ``sigma``.
    light_yield_ph_per_keV: dict[str, float] | None


@dataclass(frozen=True)
class NextMeasurement(_Plain):
    """A configuration that would tell leading effects apart."""

    #: Scene parameters.
    parameters: dict[str, Value]
    #: Pairs of leading effects that it would tell apart.
    separates: tuple[tuple[str, str], ...]
    #: Mean over all pairs of what the wrong one's chi2 would rise above the right one's.
    expected_delta_chi2: float


@dataclass(frozen=True)
class Diagnosis(_Plain):
    """Why a campaign does not fit, as far as its readings tell."""

    #: ``adequate``, ``missing_effect``, ``ambiguous``, ``unexplained``, ``too_few_readings``.
    verdict: str
    #: In a sentence.
    reason: str
    #: The campaign as it is.
    baseline: Comparison
    #: Every effect alone, the best first.
    candidates: tuple[Candidate, ...]
    #: The best pairs, where no effect alone suffices; the best first.
    pairs: tuple[Candidate, ...]
    #: Effects that the data cannot tell apart, the best first; of pairs, their effects.
    leading: tuple[str, ...]
    #: The same as sets that each explain the data.
    leading_sets: tuple[tuple[str, ...], ...]
    #: Where the data are adequate.
    upper_limits: dict[str, Limit]
    suspect_readings: tuple[Suspect, ...]
    repair: tuple[RepairStep, ...]
    next_measurements: tuple[NextMeasurement, ...]
    #: Effects that could not be fitted, with the reason.
    not_tried: dict[str, str]
    #: Wall time.
    seconds: float
