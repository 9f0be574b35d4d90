"""What compare, diagnose and repair hand back."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

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
        return {f.name: plain(getattr(self, f.name)) for f in fields(self)}


def plain(value: Any) -> Any:
    """The same in types that JSON has."""
    if isinstance(value, _Plain):
        return value.to_json()
    if isinstance(value, (ParameterEstimate, FittedRow)):
        return plain(vars(value))
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


@dataclass(frozen=True)
class Suspect(_Plain):
    """Readings that may be wrong, rather than the model.

    Attributes
    ----------
    kind : str
        ``bad_reading`` (one reading off) or ``swapped_rows`` (two signals exchanged).
    labels : tuple of str
        The reading, or the two.
    delta_chi2 : float
        What chi2 falls by without the reading, or with the two exchanged.
    p_gain : float
        Probability of as much by chance, corrected for having tried all readings or pairs.
    chi2, ndf, p_value : float, int, float or None
        Of the fit without it.
    pull : float or None
        Of the single reading from what the others predict, in standard errors.
    explains : bool
        Whether the fit without it is acceptable.
    """

    kind: str
    labels: tuple[str, ...]
    delta_chi2: float
    p_gain: float
    chi2: float
    ndf: int
    p_value: float | None
    pull: float | None
    explains: bool


@dataclass(frozen=True)
class Trend(_Plain):
    """How the pulls run along one bench parameter.

    Attributes
    ----------
    parameter : str
        A column of the measurement file.
    levels : tuple of Value
        Its values, ascending.
    mean_pulls : tuple of float
        Weighted mean residual of each level, in readings' standard errors.
    delta_chi2 : float
        What chi2 falls by if every level may have a factor of its own.
    ndf : int
        Factors that the free parameters do not absorb.
    p_value : float or None
        Of the spread between levels against that within (F test), corrected for the number of
        bench parameters; None without degrees of freedom left.
    """

    parameter: str
    levels: tuple[Value, ...]
    mean_pulls: tuple[float, ...]
    delta_chi2: float
    ndf: int
    p_value: float | None


@dataclass(frozen=True)
class Absorbed(_Plain):
    """A fitted parameter that looks as if it had taken up a misfit.

    Attributes
    ----------
    parameter : str
    sign : str
        ``prior_pulled``, ``bound_reached`` or ``implausible``.
    value : float
    words : str
        The same for the reader.
    """

    parameter: str
    sign: str
    value: float
    words: str


@dataclass(frozen=True)
class Comparison(_Plain):
    """A fitted campaign, laid out to show where the model fails.

    Attributes
    ----------
    parameters : dict of str to ParameterEstimate
    chi2, ndf, p_value
        As in `Calibration`.
    expected_chi2 : tuple of float
        ndf - sqrt(2 ndf), ndf + sqrt(2 ndf): where chi2 lies in 2 of 3 campaigns.
    rms_pull, left_out_error : float
        In standard errors of the readings; the second of readings left out of the fit.
    rows : tuple of FittedRow
    left_out_pulls : dict of str to float
        By label: how far every reading in use is from what the others predict, in standard errors.
    suspects : tuple of Suspect
        Single bad readings and swapped rows that account for the misfit, the likeliest first.
    trends : tuple of Trend
        The clearest first.
    absorbed : tuple of Absorbed
    """

    parameters: dict[str, ParameterEstimate]
    chi2: float
    ndf: int
    p_value: float | None
    expected_chi2: tuple[float, float]
    rms_pull: float
    left_out_error: float
    rows: tuple[FittedRow, ...]
    left_out_pulls: dict[str, float]
    suspects: tuple[Suspect, ...]
    trends: tuple[Trend, ...]
    absorbed: tuple[Absorbed, ...]


@dataclass(frozen=True)
class Candidate(_Plain):
    """The campaign fitted with one effect added, or with a pair.

    Attributes
    ----------
    effect : str
        Its name; of a pair both, joined by ``+``.
    effects : tuple of str
    chi2, ndf, p_value
        Of the fit with it.
    delta_chi2, delta_chi2_sigma : float
        What chi2 falls by, and the simulation's error of that.
    p_gain : float or None
        Probability of this gain by chance, were this effect the only one tried; None for a pair.
    p_global : float or None
        Of the best of all effects gaining as much; None for a pair.
    aicc : float or None
        Relative to the baseline: negative is better; None where there are too few readings.
    behind : float
        How far behind the best in chi2 + 2 per free parameter, by which candidates are ranked.
    left_out_error : float
    parameters : dict of str to ParameterEstimate
        All free ones.
    effect_parameters : tuple of str
        Those that the effect brings.
    light_yield_ph_per_keV : dict of str to float or None
        ``value``, ``sigma``, ``change`` (from the baseline, relative); None where the campaign
        does not say how to get it.
    plausible : bool
        Whether the effect has a size that a laboratory meets.
    at_bound : bool
        Whether one of its parameters ended at its bound.
    collinearity : float
        Part (0..1) of what the effect does to the readings that the other parameters follow.
    mimics : tuple of str
        Effects that it could be mistaken for.
    """

    effect: str
    effects: tuple[str, ...]
    chi2: float
    ndf: int
    p_value: float | None
    delta_chi2: float
    delta_chi2_sigma: float
    p_gain: float | None
    p_global: float | None
    aicc: float | None
    behind: float
    left_out_error: float
    parameters: dict[str, ParameterEstimate]
    effect_parameters: tuple[str, ...]
    light_yield_ph_per_keV: dict[str, float] | None
    plausible: bool
    at_bound: bool
    collinearity: float
    mimics: tuple[str, ...]


@dataclass(frozen=True)
class Limit(_Plain):
    """What adequate data say about an effect's size, at 95 % confidence.

    Attributes
    ----------
    parameter : str or None
        None where the effect is on or off.
    absent : float or None
        Value at which it is not there.
    lower, upper : float or None
        Ends of what is allowed; None on the side of a boundary at which the effect is absent.
        Infinite where the data allow everything up to the end of the range.
    delta_chi2 : float
        Fall of chi2 with the effect; negative where it makes the fit worse.
    excluded : bool
        Of an effect that is on or off: whether the data refuse it.
    """

    parameter: str | None
    absent: float | None
    lower: float | None
    upper: float | None
    delta_chi2: float
    excluded: bool


@dataclass(frozen=True)
class RepairStep(_Plain):
    """One step of the repair.

    Attributes
    ----------
    step : int
    added : str or None
        The effect; None for the campaign as it came.
    effects : tuple of str
        All added so far.
    chi2, ndf, p_value, rms_pull, left_out_error
        Of the fit.
    delta_chi2_sigma : float
        Simulation's error of chi2's fall in this step.
    parameters : dict of str to ParameterEstimate
    light_yield_ph_per_keV : dict of str to float or None
        ``value`` and ``sigma``.
    """

    step: int
    added: str | None
    effects: tuple[str, ...]
    chi2: float
    ndf: int
    p_value: float | None
    rms_pull: float
    left_out_error: float
    delta_chi2_sigma: float
    parameters: dict[str, ParameterEstimate]
    light_yield_ph_per_keV: dict[str, float] | None


@dataclass(frozen=True)
class NextMeasurement(_Plain):
    """A configuration that would tell leading effects apart.

    Attributes
    ----------
    parameters : dict of str to Value
        Scene parameters.
    separates : tuple of (str, str)
        Pairs of leading effects that it would tell apart.
    expected_delta_chi2 : float
        Mean over all pairs of what the wrong one's chi2 would rise above the right one's.
    """

    parameters: dict[str, Value]
    separates: tuple[tuple[str, str], ...]
    expected_delta_chi2: float


@dataclass(frozen=True)
class Diagnosis(_Plain):
    """Why a campaign does not fit, as far as its readings tell.

    Attributes
    ----------
    verdict : str
        ``adequate``, ``missing_effect``, ``ambiguous``, ``unexplained``, ``too_few_readings``.
    reason : str
        In a sentence.
    baseline : Comparison
        The campaign as it is.
    candidates : tuple of Candidate
        Every effect alone, the best first.
    pairs : tuple of Candidate
        The best pairs, where no effect alone suffices; the best first.
    leading : tuple of str
        Effects that the data cannot tell apart, the best first; of pairs, their effects.
    leading_sets : tuple of tuple of str
        The same as sets that each explain the data.
    upper_limits : dict of str to Limit
        Where the data are adequate.
    suspect_readings : tuple of Suspect
    repair : tuple of RepairStep
    next_measurements : tuple of NextMeasurement
    not_tried : dict of str to str
        Effects that could not be fitted, with the reason.
    seconds : float
        Wall time.
    """

    verdict: str
    reason: str
    baseline: Comparison
    candidates: tuple[Candidate, ...]
    pairs: tuple[Candidate, ...]
    leading: tuple[str, ...]
    leading_sets: tuple[tuple[str, ...], ...]
    upper_limits: dict[str, Limit]
    suspect_readings: tuple[Suspect, ...]
    repair: tuple[RepairStep, ...]
    next_measurements: tuple[NextMeasurement, ...]
    not_tried: dict[str, str]
    seconds: float
