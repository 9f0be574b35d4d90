"""Expected errors by the fit's own Fisher information."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter
from mcrim_mitsuba.files.light_yield_input import LightYieldInput
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.fit.likelihood import FrozenStatistic, Likelihood
from mcrim_mitsuba.fit.model import CampaignModel, Prediction
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.surface import ALPHA_SCAT
from mcrim_mitsuba.planning.conditions import Conditions
from mcrim_mitsuba.planning.plans import (
    EFFICIENCY,
    EVENTS_ORIGIN,
    MOUNTINGS_ORIGIN,
    PRIOR,
    STATISTICAL,
    Candidate,
    ExpectedError,
)

# Relative error of readings that counts as none, and keeps the information's inverse exact.
_PERFECT = 1e-5
# As in the fit: below it some combination of parameters changes no reading.
_LEAST_INFORMATION = 1e-10


@dataclass(frozen=True)
class _Readings:
    """Some candidates as readings of a model, at the solution alone: what the likelihood asks."""

    campaign: Campaign
    free: tuple[CampaignParameter, ...]
    readings: tuple[Reading, ...]
    prediction: Prediction

    def predict(
        self, theta: NDArray[np.float64], *, check: bool = False, covariance: bool = False
    ) -> Prediction:
        return self.prediction


class Expectation:
    """Errors that fits to candidates would have."""

    def __init__(
        self,
        campaign: Campaign,
        model: CampaignModel | ResponseModel,
        theta: NDArray[np.float64],
        prediction: Prediction,
        candidates: Sequence[Candidate],
        conditions: Conditions,
    ) -> None:
        self._campaign, self._free, self._theta = campaign, model.free, theta
        self._prediction, self._candidates = prediction, candidates
        self._scatter = conditions.mounting_scatter
        self._names = [known.name for known in model.free]
        self._first = len(prediction.signal) - len(candidates)

    def determined(self, chosen: Sequence[int]) -> bool:
        """Whether these configurations, and the priors, determine all parameters."""
        information = self._statistic(chosen, [_PERFECT] * len(chosen)).information(self._theta)
        diagonal = np.diag(information)
        if not np.all(diagonal > 0):
            return False
        scaled = information / np.sqrt(np.outer(diagonal, diagonal))
        return bool(np.linalg.eigvalsh(scaled)[0] > _LEAST_INFORMATION)

    def floor(self, chosen: Sequence[int]) -> ExpectedError:
        """The light yield's error with readings of no error."""
        nothing = np.zeros(len(chosen))
        found = self._parts(SCALE, chosen, nothing + _PERFECT, nothing)
        return ExpectedError(found.parts | dict.fromkeys(STATISTICAL, 0.0))

    def errors(
        self, chosen: Sequence[int], mountings: int, events: float
    ) -> tuple[ExpectedError, ExpectedError | None]:
        """Of the light yield and of alpha_scat."""
        of_events = np.array(
            [
                self._candidates[i].event_sigma / self._candidates[i].signal
                for i in chosen
            ]
        ) / math.sqrt(events * mountings)  # fmt: skip
        of_mountings = np.full(len(chosen), self._scatter / math.sqrt(mountings))
        light_yield = self._parts(SCALE, chosen, of_events, of_mountings)
        if ALPHA_SCAT not in self._names:
            return light_yield, None
        return light_yield, self._parts(ALPHA_SCAT, chosen, of_events, of_mountings)

    def _parts(
        self,
        name: str,
        chosen: Sequence[int],
        of_events: NDArray[np.float64],
        of_mountings: NDArray[np.float64],
    ) -> ExpectedError:
        """A parameter's relative error by origin, from the readings' relative errors."""
        statistic = self._statistic(chosen, np.hypot(of_events, of_mountings))
        covariance = np.linalg.inv(statistic.information(self._theta))
        place = self._names.index(name)
        response = (covariance @ statistic.response(self._theta))[place]
        signal = self._prediction.signal[self._rows(chosen)]
        weights = statistic.likelihood.prior_weight
        parts = {
            EVENTS_ORIGIN: float(np.linalg.norm(response * of_events * signal)),
            MOUNTINGS_ORIGIN: float(np.linalg.norm(response * of_mountings * signal)),
        }
        for j in np.flatnonzero(weights):
            parts[PRIOR + self._names[j]] = float(abs(covariance[place, j]) * math.sqrt(weights[j]))
        relative = {origin: part / abs(self._theta[place]) for origin, part in parts.items()}
        known = self._campaign.light_yield
        if name == SCALE and known is not None:
            relative |= _of_efficiency(known)
        return ExpectedError(relative)

    def _statistic(self, chosen: Sequence[int], relative: Iterable[float]) -> FrozenStatistic:
        """Of a campaign whose readings are the predictions, with these relative errors."""
        rows = self._rows(chosen)
        readings = tuple(
            Reading(f"{i}", float(signal), float(sigma * signal), {}, True, None, None, 0)
            for i, (signal, sigma) in enumerate(
                zip(self._prediction.signal[rows], relative, strict=True)
            )
        )
        seen = replace(
            self._prediction,
            signal=self._prediction.signal[rows],
            signal_slopes=self._prediction.signal_slopes[rows],
        )
        likelihood = Likelihood(_Readings(self._campaign, self._free, readings, seen))
        return FrozenStatistic(likelihood, likelihood.errors_before_any_fit())

    def _rows(self, chosen: Sequence[int]) -> list[int]:
        return [self._first + i for i in chosen]


def _of_efficiency(known: LightYieldInput) -> dict[str, float]:
    """Relative errors of the detector efficiency, by origin where spectra tell."""
    sigmas = known.efficiency_parts or {EFFICIENCY: known.detector_efficiency_sigma}
    return {name: sigma / known.detector_efficiency for name, sigma in sigmas.items()}
