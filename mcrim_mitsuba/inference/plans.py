"""How measurements are done, and what counting statistics and mountings make of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.inference.calibration import ParameterEstimate
from mcrim_mitsuba.inference.likelihood import FrozenStatistic, Likelihood
from mcrim_mitsuba.inference.model import CampaignModel, Prediction, ResponseModel
from mcrim_mitsuba.laboratory.peak import COUNTING, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum

#: Of the article's four mountings: 0.2 of 14.3 photons is the error of their mean.
MOUNTING_SCATTER = 0.2 / 14.3 * math.sqrt(4)
#: Relative standard deviation of an event's light, besides the counting of its photons.
INTRINSIC_SPREAD = 0.10


@dataclass(frozen=True)
class Conditions:
    """How measurements are done."""

    #: In the band, not in the pedestal.
    events_per_second: float = 30.0
    #: To mount the crystal, besides the counting of events.
    minutes_per_mounting: float = 30.0
    #: Relative standard deviation of the signal from one mounting to the next.
    mounting_scatter: float = MOUNTING_SCATTER
    #: Relative standard deviation of an event's light, besides the counting of its photons.
    intrinsic_spread: float = INTRINSIC_SPREAD

    def hours(self, configurations: int, mountings: int, events: float) -> float:
        """Time that a plan takes."""
        each = self.minutes_per_mounting / 60 + events / self.events_per_second / 3600
        return configurations * mountings * each


def event_sigma(mean_photons: float, conditions: Conditions) -> float:
    """Error of a band's mean times the square root of its events, as the peak's fit has it.

    Without background and with all bins it would be the band's width, the square root of
    N + (spread N)^2. The fit is made of the expected counts themselves.

    Parameters
    ----------
    mean_photons : float
        N.
    conditions : Conditions

    Raises
    ------
    InputError
        If no peak stands out of the pedestal.
    """
    spectrum = PhotonSpectrum(mean_photons, intrinsic_spread=conditions.intrinsic_spread)
    photons = spectrum.photons()
    peak = fit_peak(photons, spectrum.expected(photons), shape=COUNTING)
    if peak is None or abs(peak.centroid - mean_photons) > 0.2 * mean_photons:
        raise InputError(
            f"a band of {mean_photons:.3g} photons per event does not stand out of the pedestal",
            "the campaign's signals must be detected photons per event; leave such couplings out",
        )
    return peak.centroid_sigma * math.sqrt(spectrum.peak_events)


def measured_conditions(campaign: Campaign) -> Conditions:
    """The usual conditions, with the scatter and the spread of the campaign's own histograms."""
    readings = () if campaign.raw is None else campaign.raw.readings.values()
    variances, degrees, spreads = 0.0, 0, []
    for reading in readings:
        used = [m.peak for m in reading.mountings if m.use and m.peak is not None]
        spreads += [p.intrinsic_spread for p in used if p.intrinsic_spread is not None]
        if len(used) > 1:
            relative = [peak.centroid / reading.combined.mean for peak in used]
            counted = [peak.centroid_sigma / reading.combined.mean for peak in used]
            own = np.var(relative, ddof=1) - np.mean(np.square(counted))
            variances += (len(used) - 1) * float(own)
            degrees += len(used) - 1
    known = Conditions()
    if degrees:
        known = replace(known, mounting_scatter=math.sqrt(max(variances / degrees, 0.0)))
    if spreads:
        known = replace(known, intrinsic_spread=float(np.median(spreads)))
    return known


# Plans of a measurement with the errors that they would bring.

#: Origins of the light yield's error; that of a prior goes on with its parameter.
PRIOR = "prior of "
EVENTS_ORIGIN, MOUNTINGS_ORIGIN, EFFICIENCY = "events", "mountings", "detector efficiency"
STATISTICAL = (EVENTS_ORIGIN, MOUNTINGS_ORIGIN)
# A plan is more precise than another if its error is less than this part of the other's.
_BETTER = 0.98


@dataclass(frozen=True)
class PlanCandidate:
    """A configuration that may be measured."""

    #: What differs from the scene.
    parameters: dict[str, float]
    #: Photons per event that the model predicts at the solution.
    signal: float
    #: Error of the mean that a fit finds times the square root of the events in the band:
    #: the band's width, and what the fitted background and the window lose.
    event_sigma: float

    @property
    def name(self) -> str:
        """``n_gap = 1.46``."""
        return ", ".join(f"{name} = {value:g}" for name, value in self.parameters.items())


@dataclass(frozen=True)
class ExpectedError:
    """Expected relative standard error of a parameter."""

    #: By origin: ``events``, ``mountings``, ``prior of NAME`` and, of the light yield,
    #: ``detector efficiency`` or what makes its error; they add up in quadrature.
    parts: dict[str, float]

    @property
    def statistical(self) -> float:
        """What more events and mountings lower."""
        return math.hypot(self.parts[EVENTS_ORIGIN], self.parts[MOUNTINGS_ORIGIN])

    @property
    def systematic(self) -> float:
        """Priors and detector efficiency."""
        return math.hypot(self.priors, self.efficiency)

    @property
    def total(self) -> float:
        """All parts in quadrature, relative."""
        return math.hypot(*self.parts.values())

    @property
    def priors(self) -> float:
        """The parts by priors in quadrature, relative."""
        return math.hypot(*(p for n, p in self.parts.items() if n.startswith(PRIOR)))

    @property
    def of_plan(self) -> float:
        """What depends on the plan: all but the detector efficiency."""
        return math.hypot(self.statistical, self.priors)

    @property
    def efficiency(self) -> float:
        """Of the detector."""
        own = (*STATISTICAL, PRIOR)
        return math.hypot(*(p for n, p in self.parts.items() if not n.startswith(own)))


@dataclass(frozen=True)
class Plan:
    """One way to measure."""

    #: Places in `Planning.candidates`.
    configurations: tuple[int, ...]
    #: Of each configuration.
    mountings: int
    #: In the band, of each mounting.
    events: float
    hours: float
    #: Of the scale, where the campaign has no light yield.
    light_yield: ExpectedError
    #: None where the campaign holds it.
    alpha_scat: ExpectedError | None


@dataclass(frozen=True)
class Planning:
    """Plans, and what they rest on."""

    #: Relative error of the light yield.
    wanted: float
    conditions: Conditions
    candidates: tuple[PlanCandidate, ...]
    #: The cheapest first; sets of configurations that do not determine the parameters have none.
    plans: tuple[Plan, ...]
    #: Per set of configurations, what readings without any error would leave of the light
    #: yield's.
    floors: dict[tuple[int, ...], ExpectedError]
    #: The campaign's own calibration, from which all was predicted.
    solution: dict[str, ParameterEstimate]
    #: Sets that do not determine the parameters.
    undetermined: tuple[tuple[int, ...], ...]
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...]

    @property
    def cheapest(self) -> Plan | None:
        """The first plan whose whole error is the wanted one or less."""
        return next((p for p in self.plans if p.light_yield.total <= self.wanted), None)

    @property
    def cheapest_statistical(self) -> Plan | None:
        """The first plan whose statistical part is the wanted error or less."""
        return next((p for p in self.plans if p.light_yield.statistical <= self.wanted), None)

    @property
    def efficient(self) -> tuple[Plan, ...]:
        """Plans that are more precise than every cheaper one, the cheapest first."""
        found: list[Plan] = []
        for plan in self.plans:
            of_plan = plan.light_yield.of_plan
            if not found or of_plan < _BETTER * found[-1].light_yield.of_plan:
                found.append(plan)
        return tuple(found)

    @property
    def lowest_floor(self) -> tuple[tuple[int, ...], ExpectedError]:
        """The set of configurations that could become most precise, and how precise."""
        return min(self.floors.items(), key=lambda item: (item[1].total, len(item[0])))

    def name(self, configurations: Sequence[int]) -> str:
        """``n_gap = 1, 1.46``."""
        chosen = [self.candidates[i] for i in configurations]
        names = {name for each in chosen for name in each.parameters}
        if len(names) == 1:
            (name,) = names
            return f"{name} = {', '.join(f'{each.parameters[name]:g}' for each in chosen)}"
        return "; ".join(each.name for each in chosen)


# Expected errors by the fit's own Fisher information.

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
        model: CampaignModel | ResponseModel,
        theta: NDArray[np.float64],
        prediction: Prediction,
        candidates: Sequence[PlanCandidate],
        conditions: Conditions,
    ) -> None:
        self._model, self._theta, self._prediction = model, theta, prediction
        self._candidates, self._scatter = candidates, conditions.mounting_scatter
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
        used = [self._candidates[i] for i in chosen]
        of_events = np.array([each.event_sigma / each.signal for each in used])
        of_events /= math.sqrt(events * mountings)
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
        known = self._model.campaign.light_yield
        if name == SCALE and known is not None:
            # by origin where spectra tell
            sigmas = known.efficiency_parts or {EFFICIENCY: known.detector_efficiency_sigma}
            relative |= {n: sigma / known.detector_efficiency for n, sigma in sigmas.items()}
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
        likelihood = Likelihood(_Readings(self._model.campaign, self._model.free, readings, seen))
        return FrozenStatistic(likelihood, likelihood.errors_before_any_fit())

    def _rows(self, chosen: Sequence[int]) -> list[int]:
        return [self._first + i for i in chosen]
