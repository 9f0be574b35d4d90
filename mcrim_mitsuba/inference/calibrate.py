"""Calibrate a campaign: simulate its configurations, then fit its readings."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mcrim_mitsuba.campaign.campaign import Campaign, as_campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Provenance, Run
from mcrim_mitsuba.efficiency.recording import SurfaceWish, record_surfaces, surfaces_answer
from mcrim_mitsuba.efficiency.response_maker import PLAIN_FACTOR
from mcrim_mitsuba.efficiency.reweighting import Coefficients
from mcrim_mitsuba.efficiency.surface import EfficiencySurface
from mcrim_mitsuba.inference.fit import Calibration, TooLittleSimulatedError, fit_model
from mcrim_mitsuba.inference.model import (
    CampaignModel,
    ResponseModel,
    configurations,
    refuse_unnamed_coefficients,
)
from mcrim_mitsuba.inference.profiles import Profile, profiles_of

#: Photons of a campaign, shared out among its configurations, and the fewest for each.
DEFAULT_PHOTONS, FEWEST_PHOTONS = 27_000_000, 1_000_000
#: Photons per configuration of the first look, which shows where the fit will end.
PILOT_PHOTONS = 262_144
#: Photons times precision squared of a usual eta (a quarter), weights included.
PHOTONS_PER_PRECISION = 4.0
#: Range of alpha_scat (1/cm) that the first look covers, within the campaign's bounds.
PILOT_RANGE_PER_CM = (0.02, 8.0)
#: The second look covers the first solution times and over this, and 4 standard errors.
REACH = 3.0
#: Part of an equal share that every configuration gets, however little its errors matter.
LEAST_SHARE = 0.2
#: Where errors are to be smallest, in standard errors from the first solution.
_ABOUT = (-1.0, 0.0, 1.0)


@dataclass(frozen=True)
class Spent:
    """What one configuration took."""

    #: Columns of the readings, and fitted scene parameters, that make the configuration.
    parameters: dict[str, Value]
    #: Photons that its surface rests on, and how many of them the cache had.
    photons: int
    cached_photons: int
    #: Monte Carlo standard error of eta at the first look's solution, over eta.
    eta_relative_sigma: float


@dataclass(frozen=True)
class CampaignResult:
    """A calibration with what it took."""

    calibration: Calibration
    #: The one that was fitted.
    model: CampaignModel | ResponseModel
    #: Per configuration, the first look left out; none of a campaign with effects.
    spent: tuple[Spent, ...]
    #: Of the simulations, the first look's included; the fit has notes of its own.
    provenance: Provenance

    @cached_property
    def profiles(self) -> tuple[Profile, ...]:
        """How chi2 rises along every free parameter and the light yield."""
        return profiles_of(self.model, self.calibration)


def calibrate(campaign: str | Path | Campaign, *, run: Run = Run()) -> CampaignResult:
    """Fit a campaign's readings, and with them the light yield.

    Every configuration is simulated twice: a short look over the whole range of alpha_scat, and a
    long one over the part where the first fit ended. The long one's photons go where their error
    weighs most on the fitted parameters.

    Parameters
    ----------
    run : Run
        Its photons are those of all configurations together, its precision that of eta in every
        configuration, around the solution.

    Raises
    ------
    InputError
        If a file is wrong, a configuration's scene is not sound, or the readings do not
        determine the parameters.
    """
    from mcrim_mitsuba.transport.variants import versions

    start = time.perf_counter()
    campaign = as_campaign(campaign)
    refuse_unnamed_coefficients(campaign, "declare it as a <default> of the crystal")
    # whether surfaces of photon records serve all configurations
    scene, distinct = campaign.scene, _distinct(campaign)
    if (
        campaign.effects
        or campaign.beam
        or campaign.samples
        or campaign.spectrum is not None
        or not all(surfaces_answer(scene.with_overrides(own)) for own in distinct.values())
    ):
        return _calibrate_with_effects(campaign, run)
    points = _pilot_points(campaign)
    whole = points[0][0], points[-1][0]
    first = _look(campaign, replace(run, photons=PILOT_PHOTONS, precision=None), points, whole)
    fitting = f"fitting {len(campaign.measurements.in_use)} readings"
    run.tell(fitting, 1, 1)
    try:
        pilot = fit_model(first.model, profile=False)
        solution = {name: (known.value, known.sigma) for name, known in pilot.parameters.items()}
        shares = _shares(campaign, pilot)
    except TooLittleSimulatedError as error:
        if not error.where:
            raise
        # a first look may be too poor where the fit leads, but it tells where to look better
        solution = {name: (value, abs(value) / REACH) for name, value in error.where.items()}
        shares = [1.0 / len(first.spent)] * len(first.spent)
    photons = run.photons
    if photons is None and run.precision is None:
        photons = max(DEFAULT_PHOTONS, FEWEST_PHOTONS * len(first.spent))
    # far from the first look's seeds, and what was checked need not be checked again
    later = replace(run, photons=photons, seed=run.seed + 500_000_007, check=False)
    try:
        final = _look(campaign, later, *_final_points(campaign, solution, whole), shares)
        run.tell(fitting, 1, 1)
        found = fit_model(final.model)
    except TooLittleSimulatedError as error:
        if not error.where:
            raise
        # the better simulation's solution is another one: once more, around that
        solution |= {n: (v, solution[n][1]) for n, v in error.where.items() if n in solution}
        final = _look(campaign, later, *_final_points(campaign, solution, whole), shares)
        found = fit_model(final.model)
    return CampaignResult(
        calibration=found,
        model=final.model,
        spent=tuple(final.spent),
        provenance=Provenance(
            seed=run.seed,
            photons=sum(each.photons for each in (*first.spent, *final.spent)),
            cached_photons=sum(each.cached_photons for each in (*first.spent, *final.spent)),
            scene_hash=campaign.scene.content_hash,
            versions=versions(run.variant, run.threads),
            seconds=time.perf_counter() - start,
            notes=tuple(dict.fromkeys((*first.notes, *final.notes))),
        ),
    )


def _calibrate_with_effects(campaign: Campaign, run: Run) -> CampaignResult:
    """Fit a campaign by the responses of its readings, which know of effects."""
    from mcrim_mitsuba.inference.workbench import Workbench

    each, precision = None, run.precision
    if run.photons is not None:
        each = run.photons // (PLAIN_FACTOR * len(_distinct(campaign)))
    if precision is not None:
        wanted = round(PHOTONS_PER_PRECISION / precision**2 / PLAIN_FACTOR)
        each = wanted if each is None else min(each, wanted)
    if each is not None:
        each = max(each, 1)  # few are asked for, not the usual number
    bench = Workbench(campaign, replace(run, photons=each))
    bench.simulate()
    model, found = bench.settled_model()
    spent = bench.provenance()
    worst = max(row.eta_sigma / row.eta for row in found.rows)
    if precision is not None and worst > precision:
        note = f"eta is known to {100 * worst:.2g} % only in one of the configurations"
        spent = replace(spent, notes=(*spent.notes, note))
    return CampaignResult(found, model, (), spent)


@dataclass(frozen=True)
class _CampaignLook:
    """The campaign's model from simulations of all its configurations, and what they took."""

    model: CampaignModel
    spent: list[Spent]
    notes: list[str]


def _look(
    campaign: Campaign,
    run: Run,
    points: list[Coefficients],
    alpha_scat_range_per_cm: tuple[float, float],
    shares: Sequence[float] | None = None,
) -> _CampaignLook:
    """Simulate all configurations, each with random numbers of its own.

    The photons of `run`, with a precision at most, are those of a configuration with a share of 1,
    which all have without `shares`. At `points` errors matter, and the range is to be covered.
    """
    asked = configurations(campaign)
    wishes = []
    for number, parameters in enumerate(asked, 1):
        share = 1.0 if shares is None else shares[number - 1]
        mine = None if run.photons is None else max(1, round(share * run.photons))
        used = any(_is_of(reading, parameters) for reading in campaign.measurements.in_use)
        wish = SurfaceWish(
            f"configuration {number}",
            campaign.scene.with_overrides(parameters),
            points,
            replace(
                run,
                # far apart, so that configurations are statistically independent
                seed=run.seed + 1_000_003 * number,
                # what is only looked at need not be precise
                photons=mine if used else PILOT_PHOTONS,
                precision=run.precision if used else None,
            ),
            alpha_scat_range_per_cm,
        )
        wishes.append(wish)
    # those parameters that tell the configurations of the campaign apart
    own = {n for n, known in campaign.parameters.items() if not known.fixed}
    own |= {n for reading in campaign.measurements.readings for n in reading.parameters}
    made: list[EfficiencySurface] = []
    spent: list[Spent] = []
    notes: list[str] = []
    for parameters, (surface, work) in zip(asked, record_surfaces(wishes), strict=True):
        middle = surface.evaluate(*points[len(points) // 2], check=False)
        told = {n: v for n, v in parameters.items() if n in own}
        spent.append(Spent(told, work.photons, work.cached_photons, middle.sigma / middle.eta))
        notes += work.notes
        made.append(surface)
    model = CampaignModel(campaign, lambda parameters: made[asked.index(parameters)])
    return _CampaignLook(model, spent, notes)


def _distinct(campaign: Campaign) -> dict[tuple, dict[str, Value]]:
    """What the columns say, each set of values once."""
    return {tuple(r.parameters.items()): r.parameters for r in campaign.measurements.readings}


def _is_of(reading: Reading, scene: Mapping[str, object]) -> bool:
    """Whether a reading was taken in a configuration."""
    return all(scene.get(name, value) == value for name, value in reading.parameters.items())


def _held(campaign: Campaign, name: str) -> float | None:
    """A coefficient's value where it is not fitted."""
    known = campaign.parameters.get(name)
    if known is None:
        return float(campaign.scene.parameters[name])
    return known.start if known.fixed else None


def _pilot_points(campaign: Campaign) -> list[Coefficients]:
    """The whole range of alpha_scat, at the least absorption that the fit may ask for."""
    value = _held(campaign, ALPHA_SCAT)
    if value is not None:
        low, high = value / 1.2, value * 1.2
    else:
        known = campaign.parameters[ALPHA_SCAT]
        low = max(PILOT_RANGE_PER_CM[0], known.minimum)
        high = min(PILOT_RANGE_PER_CM[1], known.maximum)
    return [(float(a), _lowest_absorption(campaign)) for a in np.geomspace(low, high, 9)]


def _final_points(
    campaign: Campaign, found: Mapping[str, tuple[float, float]], whole: tuple[float, float]
) -> tuple[list[Coefficients], tuple[float, float]]:
    """Where errors matter, around a solution, and the range to be covered."""
    least = _lowest_absorption(campaign)
    absorption = [least]
    if ALPHA_ABS in found:
        value, sigma = found[ALPHA_ABS]
        least = min(least, max(value, 0.0))
        absorption = [least, max(value, least), max(value + sigma, least)]
    if ALPHA_SCAT not in found:
        value = (whole[0] + whole[1]) / 2
        return [(value, a_a) for a_a in absorption], whole
    value, sigma = found[ALPHA_SCAT]
    # also where the first look's photons told nothing: there its solution is chance
    most = campaign.parameters[ALPHA_SCAT].maximum
    sigma = sigma if sigma < most else value / REACH
    low = max(whole[0], min(value / REACH, max(value - 4 * sigma, 0.0)))
    high = min(most, max(value * REACH, value + 4 * sigma))
    about = [min(max(value + pull * sigma, low), high) for pull in _ABOUT]
    return [(a_s, a_a) for a_s in about for a_a in absorption], (low, high)


def _shares(campaign: Campaign, pilot: Calibration) -> list[float]:
    """Every configuration's part of the photons: where they lower the parameters' errors most.

    With N_c photons the errors' Monte Carlo part is a sum of s_c^2 / N_c, which is least, for a
    given sum of N_c, where N_c goes as s_c.
    """
    sigmas = np.sqrt(np.diag(pilot.covariance))
    rows = np.array([row.model_sigma for row in pilot.rows])
    pulls = pilot.response * rows / sigmas[:, None] if len(sigmas) else rows[None]
    weights = []
    for scene in configurations(campaign):
        mine = [_is_of(reading, scene) for reading in campaign.measurements.readings]
        weights.append(float(np.linalg.norm(pulls[:, mine])))
    total, equal = sum(weights), 1.0 / len(weights)
    return [
        LEAST_SHARE * equal + (1.0 - LEAST_SHARE) * (weight / total if total > 0 else equal)
        for weight in weights
    ]


def _lowest_absorption(campaign: Campaign) -> float:
    """Below most of what the fit will ask for; weights reach a little further."""
    value = _held(campaign, ALPHA_ABS)
    if value is not None:
        return value
    known = campaign.parameters[ALPHA_ABS]
    if known.prior is not None and known.prior_sigma is not None:
        return max(known.minimum, known.prior - 3 * known.prior_sigma, 0.1 * known.prior, 0.0)
    return max(known.minimum, 0.1 * known.start)
