"""Plan a measurement: which couplings, how many mountings, how many events for a wanted error.

The campaign is fitted as it is. At its solution the model predicts the signals of candidate
configurations, counting statistics and the mountings' scatter predict their errors, and the fit's
own Fisher information, priors and the readings so far included, predicts the errors of what would
be fitted to all of them. The simulation's error counts as none: photons are cheap. What the model
neglects comes on top: what the readings of the proposed plan could tell of it is rehearsed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.treatments import as_in_scene, states
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed
from mcrim_mitsuba.core.numbers import ALPHA_SCAT, Value, judge, said
from mcrim_mitsuba.core.rounding import p_equals, short_text
from mcrim_mitsuba.core.run import Run, one_thread
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import settle
from mcrim_mitsuba.inference.estimates import ParameterEstimate
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.fit import Calibration
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.model import Model
from mcrim_mitsuba.inference.rehearsal import Capability
from mcrim_mitsuba.inference.settings import PLANNING
from mcrim_mitsuba.inference.simulations import CampaignSimulations, buildable
from mcrim_mitsuba.inference.statistic import Statistic, Weights, is_misfit, undetermined
from mcrim_mitsuba.inference.weighing import weigh_hypotheses
from mcrim_mitsuba.laboratory.peak import COUNTING, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX

#: Origins of the light yield's error; that of a prior goes on with its parameter.
PRIOR = "prior of "
EVENTS_ORIGIN, MOUNTINGS_ORIGIN, EFFICIENCY = "events", "mountings", "detector efficiency"
#: Of the campaign's readings of light, where these count.
SO_FAR = "readings so far"
STATISTICAL = (EVENTS_ORIGIN, MOUNTINGS_ORIGIN, SO_FAR)


@dataclass(frozen=True)
class Conditions:
    """How measurements are done."""

    #: In the band, not in the pedestal.
    events_per_second: float = 30.0
    #: To mount the crystal, besides the counting of events.
    minutes_per_mounting: float = 30.0
    #: Relative standard deviation of the signal from one mounting to the next.
    mounting_scatter: float = PLANNING.mounting_scatter
    #: Relative standard deviation of an event's light, besides the counting of its photons.
    intrinsic_spread: float = PLANNING.intrinsic_spread

    def hours(self, configurations: int, mountings: int, events: float) -> float:
        """Time that a plan takes."""
        each = self.minutes_per_mounting / 60 + events / self.events_per_second / 3600
        return configurations * mountings * each


@dataclass(frozen=True)
class PlanCandidate:
    """A configuration that may be measured."""

    #: What differs from the scene, and 1 or 0 of what columns switch.
    parameters: dict[str, Value]
    #: Photons per event that the model predicts at the solution.
    signal: float
    #: Error of the mean that a fit finds times the square root of the events in the band:
    #: the band's width, and what the fitted background and the window lose.
    event_sigma: float
    #: In words: ``gap index 1.46, wrapped``.
    name: str


@dataclass(frozen=True)
class ExpectedError:
    """Expected relative standard error of a parameter."""

    #: By origin: ``events``, ``mountings``, ``readings so far``, ``prior of NAME`` (a parameter, a
    #: number of the bench, or the label of a transmittance that was measured) and, of the light
    #: yield, ``detector efficiency`` or what makes its error; they add up in quadrature.
    parts: dict[str, float]

    @property
    def statistical(self) -> float:
        """What more events and mountings lower."""
        return math.hypot(*(self.parts.get(origin, 0.0) for origin in STATISTICAL))

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
    #: What readings of the proposed plan could say of effects that are missing; None where nothing
    #: is left to check the model with, so that none could show.
    capability: Capability | None = None
    #: These effects in words.
    titles: dict[str, str] = field(default_factory=dict)
    #: What the readings so far leave of the light yield; None where plans start anew.
    so_far: ExpectedError | None = None

    @property
    def proposed(self) -> Plan:
        """The cheapest plan, or the most precise one where none reaches the wanted error."""
        return self.cheapest or min(self.plans, key=lambda p: p.light_yield.total)

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
        plans: list[Plan] = []
        for plan in self.plans:
            of_plan = plan.light_yield.of_plan
            if not plans or of_plan < PLANNING.better * plans[-1].light_yield.of_plan:
                plans.append(plan)
        return tuple(plans)

    @property
    def lowest_floor(self) -> tuple[tuple[int, ...], ExpectedError]:
        """The set of configurations that could become most precise, and how precise."""
        return min(self.floors.items(), key=lambda item: (item[1].total, len(item[0])))

    @property
    def is_numbered(self) -> bool:
        """Whether sets are told by numbers: where configurations differ in more than one name."""
        return len({name for at in self.candidates for name in at.parameters}) > 1

    def number(self, configurations: Sequence[int]) -> str:
        """``1 + 3``, places among `candidates`; the `name` where these are not numbered."""
        if not self.is_numbered:
            return self.name(configurations)
        return " + ".join(str(place + 1) for place in configurations)

    def name(self, configurations: Sequence[int]) -> str:
        """``gap index 1, 1.46``."""
        chosen = [self.candidates[i] for i in configurations]
        names = {name for each in chosen for name in each.parameters}
        if len(names) == 1:
            (name,) = names
            return said(name, ", ".join(short_text(each.parameters[name]) for each in chosen))
        return "; ".join(each.name for each in chosen)


def plan(
    campaign: str | Path | Campaign,
    wanted: float,
    *,
    n_gap: Sequence[float] | None = None,
    mountings: Sequence[int] = PLANNING.mountings,
    events: Sequence[float] = PLANNING.events,
    conditions: Conditions | None = None,
    anew: bool = False,
    run: Run = Run(),
) -> Planning:
    """What every set of configurations, number of mountings and of events would bring.

    Parameters as of the public function `plan`. Plans add to the campaign's readings, or start
    `anew`, with its priors: its readings then tell where it stands alone.

    Raises InputError as `calibrate`; if a coupling cannot be measured, no peak would stand out of
    the pedestal, or no set of couplings determines the parameters.
    """
    campaign = as_campaign(campaign)
    _refuse_unplannable(campaign)
    configurations = _configurations(campaign, n_gap)
    conditions = conditions or measured_conditions(campaign)
    simulations = CampaignSimulations(campaign, run)
    fit = simulations.fit()
    in_scene = [as_in_scene(campaign, cells)[0] for cells in configurations]
    further = simulations.predict_at(in_scene, tolerances=True)(())
    expected = Expectation(fit, further, configurations, conditions, counted=not anew)
    plans, floors, without = list[Plan](), {}, []
    places = range(len(expected.candidates))
    for chosen in chain.from_iterable(combinations(places, n + 1) for n in places):
        if not expected.determined(chosen):
            without.append(chosen)
            continue
        floors[chosen] = expected.floor(chosen)
        plans += [
            Plan(chosen, m, n, conditions.hours(len(chosen), m, n), *expected.errors(chosen, m, n))
            for m, n in product(sorted(set(mountings)), sorted(set(events)))
        ]
    if not plans:
        problem = f"none of these couplings together determine {', '.join(fit.names)}"
        mend = "allow more couplings in --n-gap, or give the campaign a prior"
        raise InputError(problem, mend, path=campaign.path)
    planning = Planning(
        wanted=wanted,
        conditions=conditions,
        candidates=expected.candidates,
        plans=tuple(sorted(plans, key=lambda p: (p.hours, p.light_yield.total))),
        floors=floors,
        solution=fit.parameters,
        undetermined=tuple(without),
        notes=(*campaign.remarks, *_doubt(fit), *simulations.provenance().notes),
        so_far=None if anew or not expected.determined(()) else expected.errors((), 1, 1)[0],
    )
    return _rehearsed(planning, expected.measured(planning.proposed), fit, run)


def _refuse_unplannable(campaign: Campaign) -> None:
    """Refuse campaigns of which there is nothing to plan."""
    if campaign.samples:
        problem = "the campaign has several samples, and a plan is of one crystal"
        mend = "plan with a campaign that leaves [samples] and their rows out"
        raise InputError(problem, mend, path=campaign.path)
    if SCALE not in campaign.free:
        problem = "the scale is held, so that there is no light yield to plan for"
        raise InputError(problem, "plan with a campaign that fits it", path=campaign.path)


def _doubt(fit: Calibration) -> Iterator[str]:
    """Whether the campaign's own fit fails, or ended at a bound."""
    if is_misfit(fit.chi2, fit.p_value):
        yield (
            f"the model does not describe the readings: chi2 = {fit.chi2:.3g}, "
            f"{p_equals(fit.p_value)}: the doubt about the model is not in these plans"
        )
    for name, estimate in fit.parameters.items():
        if estimate.at_bound is not None:
            yield f"the campaign's own fit ended with {name} at its bound: plans start from there"


def _rehearsed(planning: Planning, proposed: Campaign, fit: Calibration, run: Run) -> Planning:
    """With what readings of the proposed plan, made into a campaign, could say of effects."""
    if proposed.ndf <= 0:
        return planning
    simulations = CampaignSimulations(proposed, run)
    possible = simulations.possible()
    models = simulations.simulate(tuple(possible), look=possible)
    run.tell("weighing what the proposed plan could name", 1, 1)
    with one_thread():
        # readings and priors as the solution predicts them: there is nothing to be explained
        statistic = Statistic(models.model())
        theta = statistic.theta(fit.values)
        exact = statistic.against(statistic.model.predict(theta).signal[statistic.used], theta)
        explanations = Explanations(models.model, possible, settle(exact, theta))
        tried = [name for name in possible if explanations.possible((name,))]
        null = NullDistribution(explanations, tried, run.seed)
        weighing = weigh_hypotheses(explanations, null, closed=True)
        capability = Judgement(explanations, null, weighing).capability(run.seed)
    titles = {name: effect.title for name, effect in possible.items()}
    notes = (*planning.notes, *simulations.refusals, *simulations.provenance().notes)
    notes = tuple(dict.fromkeys(notes))
    return replace(planning, capability=capability, titles=titles, notes=notes)


def _configurations(campaign: Campaign, n_gap: Sequence[float] | None) -> list[dict[str, Value]]:
    """Cells of what may be measured: with these couplings, or else as the campaign has it.

    That is what its ``[next_measurements]`` lists, or the configurations of its readings; of many
    their couplings, and usual couplings where there is but one.
    """
    rows = [campaign.cells(row) for row in campaign.measurements.in_use if not row.of_beam]
    measured = [{n: v for n, v in cells.items() if v is not None} for cells in rows]
    if n_gap is None:
        by_hand = {*campaign.scene.parameters, *campaign.measurements.switches}
        listed = by_hand & campaign.next_measurements.keys()
        cells = buildable(campaign) if listed else measured
        cells = [row for place, row in enumerate(cells) if row not in cells[:place]]
        nominal = campaign.scene.parameters.get(GAP_INDEX, 1.0)
        couplings = [float(row.get(GAP_INDEX, nominal)) for row in cells]
        few = len(cells) <= PLANNING.most_configurations or len({*couplings}) == 1
        if listed or (few and len(cells) > 1):
            return _few(cells, "list fewer in [next_measurements], or give couplings in --n-gap")
        n_gap = couplings if len(cells) > 1 else PLANNING.n_gap
    # what rows switch is as in the first
    switches = {name: measured[0][name] for name in campaign.measurements.switches}
    return [{GAP_INDEX: value, **switches} for value in _couplings(campaign, n_gap)]


def _few(cells: list[Any], mend: str) -> list[Any]:
    """These, unless they have too many combinations."""
    if len(cells) > PLANNING.most_configurations:
        problem = f"{len(cells)} configurations have too many combinations"
        raise InputError(problem, f"{mend}: {PLANNING.most_configurations} at most")
    return cells


def _couplings(campaign: Campaign, n_gap: Sequence[float]) -> list[float]:
    """Couplings that can be measured, each once."""
    if not isinstance(campaign.scene.parameters.get("n_gap"), float):
        problem = "the scene has no number n_gap"
        raise InputError(problem, "declare it as a <default> of the gap", path=campaign.scene.path)
    if "n_gap" in campaign.free:
        problem = "n_gap is fitted: a measurement cannot set it"
        raise InputError(problem, "hold it with fixed = true", path=campaign.path)
    values = list(dict.fromkeys(float(value) for value in n_gap))
    for value in values:
        if (wrong := judge("n_gap", value)) is not None:
            raise InputError(f"n_gap = {value:g}: {wrong[1]}", wrong[2])
    return _few(values, "give fewer")


# ---- what counting statistics and mountings do to a reading ----


def event_sigma(mean_photons: float, conditions: Conditions) -> float:
    """Error of a band's mean times the square root of its events, as the peak's fit has it.

    Without background and with all bins it would be the band's width, the square root of
    N + (spread N)^2, N photons. The fit is made of the expected counts themselves.

    Raises InputError if no peak stands out of the pedestal.
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
        used = [m.peak for m in reading.mountings if m.row.use and m.peak is not None]
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


# ---- expected errors by the fit's own Fisher information ----


class Expectation:
    """Errors that fits to candidates would have."""

    def __init__(
        self,
        fit: Calibration,
        further: Model,
        configurations: Sequence[Mapping[str, Value]],
        conditions: Conditions,
        *,
        counted: bool = False,
    ) -> None:
        prediction = further.predict(fit.theta, check=True, covariance=True)
        campaign, candidates = fit.model.campaign, []
        switches = campaign.measurements.switches
        for cells, signal in zip(configurations, prediction.signal.tolist(), strict=True):
            by_hand = [said(name, value) for name, value in cells.items() if name not in switches]
            name = ", ".join(by_hand + states(campaign, as_in_scene(campaign, cells)[1]))
            with placed(name):
                event = event_sigma(signal, conditions)
            candidates.append(PlanCandidate(dict(cells), signal, event, name))
        self.candidates = tuple(candidates)
        self._fit, self._scatter = fit, conditions.mounting_scatter
        # offsets of the bench's numbers, in their tolerances, are parameters with priors, and so is
        # what the calibration of channels moves all readings of light by, old and new
        common = campaign.common_errors
        shifted = common.moved(prediction.signal, np.ones(len(candidates), bool))
        of_channels = ("pedestal", common.offset_sigma), ("nonlinearity", common.nonlinearity_sigma)
        numbers = [PRIOR + number.tolerance.number.words for number in fit.offsets]
        numbers += [PRIOR + name for name, sigma in of_channels if sigma]
        moved = np.zeros((len(candidates), len(fit.offsets)))
        if prediction.eta_of_tolerances is not None:
            moved = prediction.signal_per_eta[:, None] * prediction.eta_of_tolerances
        # (candidates, free + numbers) d log(signal) / d parameter
        moved = np.hstack([prediction.signal_slopes, moved, shifted])
        self._slopes = moved / prediction.signal[:, None]
        self._names = (*fit.names, *numbers)
        statistic = fit.minimum.statistic
        priors = np.diag([*np.sqrt(statistic.prior_weight), *np.ones(len(numbers))])
        origins = (*(PRIOR + name for name in fit.names), *numbers)
        # by origin, (rows, free + numbers) d known / d parameter, in standard errors of what is
        # known, independent of each other
        pairs = zip(origins, priors, strict=True)
        self._known = {origin: row[None] for origin, row in pairs if row.any()}
        # transmittances are not measured again: what they told goes on, like priors
        beams = np.array([reading.of_beam for reading in fit.model.readings if reading.use])
        errors, none = fit.minimum.weights.errors, np.zeros((len(beams), 0))
        of_common, others = np.split(errors.pedestal, [shifted.shape[1]], axis=1)
        measured = np.hstack([fit.minimum.slopes, errors.tolerances, of_common])
        # the simulation's errors count as none, the offsets are parameters here
        weights = Weights(replace(errors, simulated=none, tolerances=none, pedestal=others))
        rows = weights.whiten((measured * (beams | counted)[:, None]).T).T
        named = zip(statistic.labels, rows, beams, strict=True)
        self._known |= {PRIOR + label: row[None] for label, row, of_beam in named if of_beam}
        self._counted = counted
        if counted:
            self._known[SO_FAR] = rows[~beams]

    def determined(self, chosen: Sequence[int]) -> bool:
        """Whether these configurations, and the priors, determine all parameters."""
        information = self._information(chosen, np.full(len(chosen), PLANNING.perfect))
        return not undetermined(information, self._names)

    def floor(self, chosen: Sequence[int]) -> ExpectedError:
        """The light yield's error with readings of no error."""
        nothing = np.zeros(len(chosen))
        error = self._parts(SCALE, chosen, nothing + PLANNING.perfect, nothing)
        return ExpectedError({**error.parts, EVENTS_ORIGIN: 0.0, MOUNTINGS_ORIGIN: 0.0})

    def errors(
        self, chosen: Sequence[int], mountings: int, events: float
    ) -> tuple[ExpectedError, ExpectedError | None]:
        """Of the light yield and of alpha_scat."""
        of_events, of_mountings = self._of_readings(chosen, mountings, events)
        light_yield = self._parts(SCALE, chosen, of_events, of_mountings)
        if ALPHA_SCAT not in self._fit.names:
            return light_yield, None
        return light_yield, self._parts(ALPHA_SCAT, chosen, of_events, of_mountings)

    def measured(self, plan: Plan) -> Campaign:
        """The campaign with a plan's readings besides those that count; transmittances stay."""
        campaign, chosen = self._fit.model.campaign, plan.configurations
        errors = np.hypot(*self._of_readings(chosen, plan.mountings, plan.events)).tolist()
        used = [self.candidates[place] for place in chosen]
        light = []
        for line, (at, error) in enumerate(zip(used, errors, strict=True), 1):
            changed, off = as_in_scene(campaign, at.parameters)
            sigma = at.signal * error
            light.append(Reading(at.name, at.signal, sigma, changed, line=line, without=off))
        kept = campaign.measurements.in_use
        readings = (*light, *(r for r in kept if self._counted or r.of_beam))
        columns = tuple(dict.fromkeys(name for row in readings for name in row.parameters))
        measured = replace(campaign.measurements, columns=columns, readings=readings)
        return replace(campaign, measurements=measured)

    def _of_readings(
        self, chosen: Sequence[int], mountings: int, events: float
    ) -> tuple[Array, Array]:
        """(chosen,) relative errors of readings, by events and by mountings."""
        used = [self.candidates[i] for i in chosen]
        of_events = np.array([each.event_sigma / each.signal for each in used])
        of_mountings = np.full(len(chosen), self._scatter / math.sqrt(mountings))
        return of_events / math.sqrt(events * mountings), of_mountings

    def _parts(
        self, name: str, chosen: Sequence[int], of_events: Array, of_mountings: Array
    ) -> ExpectedError:
        """A parameter's relative error by origin, from the readings' relative errors."""
        place, errors = self._fit.names.index(name), np.hypot(of_events, of_mountings)
        covariance = np.linalg.inv(self._information(chosen, errors))[place]
        # how readings move the estimate, by their relative change
        response = self._slopes[list(chosen)] @ covariance / errors**2
        parts = {
            EVENTS_ORIGIN: np.linalg.norm(response * of_events),
            MOUNTINGS_ORIGIN: np.linalg.norm(response * of_mountings),
            **{of: np.linalg.norm(covariance @ rows.T) for of, rows in self._known.items()},
        }
        relative = {n: float(part / abs(self._fit.theta[place])) for n, part in parts.items()}
        known = self._fit.model.campaign.light_yield
        if name == SCALE and known is not None:
            # by origin where spectra tell
            sigmas = known.efficiency_parts or {EFFICIENCY: known.detector_efficiency_sigma}
            relative |= {n: sigma / known.detector_efficiency for n, sigma in sigmas.items()}
        return ExpectedError(relative)

    def _information(self, chosen: Sequence[int], relative: Array) -> Array:
        """(free, free) Fisher's, of readings with these relative errors and of what is known."""
        chosen_slopes = self._slopes[list(chosen)] / relative[:, None]
        rows = np.vstack([chosen_slopes, *self._known.values()])
        return rows.T @ rows
