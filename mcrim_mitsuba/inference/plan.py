"""Plan a measurement: which couplings, how many mountings, how many events for a wanted error.

The campaign is calibrated as it is. At its solution the model predicts the signals of candidate
configurations, counting statistics and the mountings' scatter predict their errors, and the fit's
own Fisher information, priors included, predicts the errors of what would be fitted to them. The
simulation's error counts as none: photons are cheap. What the model neglects comes on top.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, read_campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import judge
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.calibrate import calibrate
from mcrim_mitsuba.inference.calibration import ParameterEstimate
from mcrim_mitsuba.inference.plans import (
    Conditions,
    Expectation,
    Plan,
    PlanCandidate,
    Planning,
    event_sigma,
    measured_conditions,
)

#: Couplings: air, water, the article's gel, a usual immersion oil.
N_GAP = (1.0, 1.333, 1.46, 1.515)
EVENTS = (1e3, 1e4, 1e5, 1e6)
MOUNTINGS = (1, 2, 4, 8, 16)
#: Configurations among which sets are chosen: 2^8 sets take seconds.
MOST_CONFIGURATIONS = 8

# Error of eta that the simulation may leave: a tenth of the best centroid's.
_PRECISION = 0.001
# A candidate has not been measured: in the calibration its error is beyond all that counts.
_UNMEASURED = 1e6


def plan(
    campaign: str | Path | Campaign,
    wanted: float,
    *,
    n_gap: Sequence[float] = N_GAP,
    mountings: Sequence[int] = MOUNTINGS,
    events: Sequence[float] = EVENTS,
    conditions: Conditions | None = None,
    run: Run = Run(),
) -> Planning:
    """What every set of couplings, number of mountings and of events would bring.

    Parameters
    ----------
    campaign : str, Path or Campaign
        Its readings, photons per event, tell where it stands; plans start anew, with its priors.
    wanted : float
        Relative error of the light yield.
    n_gap : sequence of float
        Couplings that can be measured; all else as the scene has it.
    mountings : sequence of int
        Of each coupling.
    events : sequence of float
        In the band, of each mounting.
    conditions : Conditions, optional
        Without it scatter and spread are the raw campaign's own, if it has histograms.
    run : Run
        As for `calibrate`; its precision is 0.1 %.

    Raises
    ------
    InputError
        As `calibrate`; if a coupling cannot be measured, no peak would stand out of
        the pedestal, or no set of couplings determines the parameters.
    """
    if not isinstance(campaign, Campaign):
        campaign = read_campaign(campaign)
    configurations = _couplings(campaign, n_gap)
    if SCALE not in campaign.free:
        raise InputError(
            "the scale is held, so that there is no light yield to plan for",
            "plan with a campaign that fits it", path=campaign.path,
        )  # fmt: skip
    result = calibrate(
        _with_candidates(campaign, configurations), run=replace(run, precision=_PRECISION)
    )
    found, model = result.calibration, result.model
    theta = np.array([found.parameters[name].value for name in found.names])
    prediction = model.predict(theta, check=True)
    conditions = conditions or measured_conditions(campaign)
    at = len(campaign.measurements.readings)
    candidates = tuple(
        _candidate(parameters, float(signal), conditions)
        for parameters, signal in zip(configurations, prediction.signal[at:], strict=True)
    )
    expected = Expectation(model, theta, prediction, candidates, conditions)
    plans, floors, undetermined = [], {}, []
    for chosen in _sets(len(candidates)):
        if not expected.determined(chosen):
            undetermined.append(chosen)
            continue
        floors[chosen] = expected.floor(chosen)
        plans += [
            Plan(chosen, m, n, conditions.hours(len(chosen), m, n), *expected.errors(chosen, m, n))
            for m, n in itertools.product(sorted(set(mountings)), sorted(set(events)))
        ]
    if not plans:
        raise InputError(
            f"none of these couplings together determine {', '.join(found.names)}",
            "allow more couplings in --n-gap, or give the campaign a prior", path=campaign.path,
        )  # fmt: skip
    return Planning(
        wanted=wanted,
        conditions=conditions,
        candidates=candidates,
        plans=tuple(sorted(plans, key=lambda p: (p.hours, p.light_yield.total))),
        floors=floors,
        solution=found.parameters,
        undetermined=tuple(undetermined),
        notes=(*_doubts(found.parameters), *result.notes),
    )


def _candidate(
    parameters: dict[str, float], signal: float, conditions: Conditions
) -> PlanCandidate:
    try:
        return PlanCandidate(parameters, signal, event_sigma(signal, conditions))
    except InputError as error:
        where = ", ".join(f"{name} = {value:g}" for name, value in parameters.items())
        raise InputError(f"{where}: {error.problem}", error.mend) from None


def _couplings(campaign: Campaign, n_gap: Sequence[float]) -> list[dict[str, float]]:
    """Configurations with these couplings, each once."""
    if not isinstance(campaign.scene.parameters.get("n_gap"), float):
        raise InputError(
            "the scene has no number n_gap", "declare it as a <default> of the gap",
            path=campaign.scene.path,
        )  # fmt: skip
    if "n_gap" in campaign.free:
        raise InputError(
            "n_gap is fitted: a measurement cannot set it", "hold it with fixed = true",
            path=campaign.path,
        )  # fmt: skip
    values = list(dict.fromkeys(float(value) for value in n_gap))
    if len(values) > MOST_CONFIGURATIONS:
        raise InputError(
            f"{len(values)} couplings have too many combinations",
            f"give {MOST_CONFIGURATIONS} at most",
        )
    for value in values:
        if (wrong := judge("n_gap", value)) is not None:
            raise InputError(f"n_gap = {value:g}: {wrong[1]}", wrong[2])
    return [{"n_gap": value} for value in values]


def _with_candidates(campaign: Campaign, configurations: Sequence[dict[str, float]]) -> Campaign:
    """The campaign with candidates as readings that carry no weight.

    Readings out of use would do too, but get few photons, and slopes need more than signals.
    """
    measured = campaign.measurements
    labels = {reading.label for reading in measured.readings}
    typical = float(np.mean([reading.signal for reading in measured.readings]))
    added = []
    for place, parameters in enumerate(configurations):
        label = next(
            name for name in (f"candidate {place}{'_' * n}" for n in itertools.count())
            if name not in labels
        )  # fmt: skip
        added.append(
            Reading(label, typical, _UNMEASURED * typical, dict(parameters), True, None, None, 0)
        )
    return replace(campaign, measurements=replace(measured, readings=(*measured.readings, *added)))


def _sets(count: int) -> list[tuple[int, ...]]:
    """All sets of so many things, small ones first."""
    return [
        chosen
        for size in range(1, count + 1)
        for chosen in itertools.combinations(range(count), size)
    ]


def _doubts(solution: Mapping[str, ParameterEstimate]) -> list[str]:
    """Where a prediction from the solution means little."""
    return [
        f"the campaign's own fit ended with {name} at its bound: the plans start from there"
        for name, known in solution.items()
        if known.at_bound is not None
    ]
