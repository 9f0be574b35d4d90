"""How the ratio of two signals tells the scattering coefficient: what MCRIM rests on."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import Calibration
from mcrim_mitsuba.fit.surface import ALPHA_SCAT

_COUPLING = "n_gap"
_POINTS = 120
#: How far from the solution curves are drawn, as a factor.
_REACH = 30.0


@dataclass(frozen=True, eq=False)
class RatioCurve:
    """Two configurations that differ in their coupling only, against scattering.

    Attributes
    ----------
    labels : tuple of str
        The one of lower index first.
    alpha_scat_per_cm : (points,) float64
    eta : (points, 2) float64
        All other parameters at the solution.
    ratio : (points,) float64
        Second signal over first.
    measured, measured_sigma : float
    solution_per_cm : float
        Fitted alpha_scat.
    """

    labels: tuple[str, str]
    alpha_scat_per_cm: NDArray[np.float64]
    eta: NDArray[np.float64]
    ratio: NDArray[np.float64]
    measured: float
    measured_sigma: float
    solution_per_cm: float


def ratio_curve(model: ResponseModel, calibration: Calibration) -> RatioCurve | None:
    """The curve of a fit; None where alpha_scat is not fitted or only one coupling was measured."""
    pair = _pair(model.campaign)
    if pair is None or ALPHA_SCAT not in calibration.names:
        return None
    readings = model.campaign.measurements.readings
    rows = [readings.index(reading) for reading in pair]
    index = calibration.names.index(ALPHA_SCAT)
    theta = np.array([calibration.parameters[name].value for name in calibration.names])
    solution, known = float(theta[index]), model.free[index]
    low, high = max(solution / _REACH, known.minimum), min(solution * _REACH, known.maximum)
    if not 0 < low < high:
        return None
    alphas, eta, signals = np.geomspace(low, high, _POINTS), [], []
    for alpha in alphas:
        theta[index] = alpha
        prediction = model.predict(theta)
        eta.append(prediction.eta[rows])
        signals.append(prediction.signal[rows])
    first, second = pair
    measured = second.signal / first.signal
    return RatioCurve(
        labels=(first.label, second.label),
        alpha_scat_per_cm=alphas,
        eta=np.array(eta),
        ratio=np.array([s[1] / s[0] for s in signals]),
        measured=measured,
        measured_sigma=measured
        * math.hypot(first.sigma / first.signal, second.sigma / second.signal),
        solution_per_cm=solution,
    )


def _pair(campaign: Campaign) -> tuple[Reading, Reading] | None:
    """The readings of lowest and highest index in the gap among those that differ in it only."""
    nominal = campaign.scene.parameters

    def elsewhere(reading: Reading) -> dict:
        return {n: v for n, v in {**nominal, **reading.parameters}.items() if n != _COUPLING}

    if _COUPLING not in nominal:
        return None
    best, widest = None, 0.0
    for pair in itertools.combinations(campaign.measurements.in_use, 2):
        first, second = sorted(
            pair, key=lambda r: float(r.parameters.get(_COUPLING, nominal[_COUPLING]))
        )
        low, high = (
            float(r.parameters.get(_COUPLING, nominal[_COUPLING])) for r in (first, second)
        )
        if high - low > widest and elsewhere(first) == elsewhere(second):
            best, widest = (first, second), high - low
    return best
