"""Synthetic campaigns with a known truth: drawn, simulated and fitted; `closure` judges them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shared import SCENE, environment

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.efficiency.recording import RunOptions, record_surface
from mcrim_mitsuba.efficiency.reweighting import EtaSurface
from mcrim_mitsuba.inference.calibrate import REACH
from mcrim_mitsuba.inference.calibration import Calibration, calibrate
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from trials.truth import (
    PRIOR_SIGMA_PER_CM,
    TRUE_ALPHA_ABS_PER_CM,
    TRUE_ALPHA_SCAT_PER_CM,
    draw_absorption_and_scale,
)

NAMES = (ALPHA_SCAT, ALPHA_ABS, SCALE)
#: Columns of the measurements, and what stands in them: four couplings, two crystals of one boule.
COLUMNS = ("n_gap", "crystal_height_mm")
Configuration = tuple[float, float]
CONFIGURATIONS: tuple[Configuration, ...] = tuple(
    (n, height) for n in (1.0, 1.333, 1.46, 1.515) for height in (10.0, 5.0)
)
#: Relative standard error of a reading.
READING_SIGMA = 0.01
#: Least absorption that is simulated, 1/cm: a tenth of the usual one, as a campaign's fit has it.
SIMULATED_ALPHA_ABS_PER_CM = 0.0039


@dataclass(frozen=True)
class Effort:
    """How well the fit's model is simulated: photons per configuration, and how often.

    Realisations are independent simulations of all configurations, shared by the campaigns. The
    more a simulation's error weighs, the more of them an average over campaigns needs.
    """

    name: str
    photons: int
    realisations: int


@dataclass(frozen=True, eq=False)
class DrawnCampaign:
    """Truth and readings of one campaign, and the absorption as measured beforehand.

    The truth (3,) is in the order of `NAMES`: 1/cm, 1/cm, the readings' unit. The signals, and
    what the Monte Carlo errors of the true efficiencies make of them, are (readings,).
    """

    truth: NDArray[np.float64]
    signals: NDArray[np.float64]
    signal_truth_sigmas: NDArray[np.float64]
    prior_per_cm: float


@dataclass(frozen=True)
class Realisation:
    """One simulation of all configurations, and the campaigns that are fitted with it.

    Configurations are per reading, seeds per distinct one, which is simulated once. The truth of
    alpha_scat is that of all its campaigns; as in a campaign's second look, the simulation covers
    this times and over `campaigns.REACH`.
    """

    number: int
    photons: int
    seeds: tuple[int, ...]
    configurations: tuple[Configuration, ...]
    alpha_scat_per_cm: float
    campaigns: tuple[DrawnCampaign, ...]


def seeds_of(seed: int, *place: int, count: int) -> tuple[int, ...]:
    """Independent seeds of a place in this program, (count,) from 0 to 2^63 - 1."""
    state = np.random.SeedSequence(seed, spawn_key=place).generate_state(count, np.uint64)
    return tuple(int(s) >> 1 for s in state)


def _scene_of(configuration: Configuration) -> SceneFile:
    return read_scene(SCENE).with_overrides(dict(zip(COLUMNS, configuration, strict=True)))


def simulate_truth(
    configurations: Sequence[Configuration],
    photons: int,
    seed: int,
    report: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> list[EtaSurface]:
    """What stands for the truth: surfaces of photons that no fit uses.

    Parameters
    ----------
    configurations : sequence of (n_gap, crystal_height_mm)
    photons : int
        Per configuration.
    seed : int
    report : callable
        ``report(what, done, total)``.

    Returns
    -------
    list of EtaSurface
        Of the distinct configurations, in their order.

    Raises
    ------
    InputError
        As `record_surface`.
    """
    distinct = list(dict.fromkeys(configurations))
    low, high = TRUE_ALPHA_SCAT_PER_CM
    points = [(a_s, a_a) for a_s in (low, (low * high) ** 0.5, high)
              for a_a in TRUE_ALPHA_ABS_PER_CM]  # fmt: skip
    surfaces = []
    for number, own_seed in enumerate(seeds_of(seed, 0, count=len(distinct))):
        report("truth", number, len(distinct))
        scene, options = _scene_of(distinct[number]), RunOptions(own_seed)
        surfaces.append(record_surface(scene, points, photons=photons, options=options)[0])
    report("truth", len(distinct), len(distinct))
    return surfaces


def draw_realisations(
    effort: Effort,
    campaigns: int,
    configurations: Sequence[Configuration],
    truths: Sequence[EtaSurface],
    seed: int,
    place: int,
) -> list[Realisation]:
    """Truths and readings of an effort's campaigns.

    Parameters
    ----------
    effort : Effort
    campaigns : int
        At least as many as realisations are used.
    configurations : sequence of (n_gap, crystal_height_mm)
        Per reading.
    truths : sequence of EtaSurface
        Of the distinct configurations, in their order.
    seed, place : int
        Efforts at different places have independent random numbers; places begin at 1.

    Returns
    -------
    list of Realisation
        With numbers of campaigns that differ by one at most.
    """
    realisations = min(effort.realisations, campaigns)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place, 0)))
    distinct = list(dict.fromkeys(configurations))
    surfaces = [truths[distinct.index(configuration)] for configuration in configurations]

    def drawn_campaign(alpha_scat: float) -> DrawnCampaign:
        truth = np.array([alpha_scat, *draw_absorption_and_scale(rng)])
        points = [surface.evaluate(*truth[:2]) for surface in surfaces]
        exact = truth[2] * np.array([point.eta for point in points])
        return DrawnCampaign(
            truth=truth,
            signals=exact * (1 + READING_SIGMA * rng.standard_normal(len(exact))),
            signal_truth_sigmas=truth[2] * np.array([point.sigma for point in points]),
            prior_per_cm=rng.normal(truth[1], PRIOR_SIGMA_PER_CM),
        )

    # evenly spread, for there may be few
    middles = (np.arange(realisations) + 0.5) / realisations
    low, high = np.log(TRUE_ALPHA_SCAT_PER_CM)
    return [
        Realisation(
            number=number,
            photons=effort.photons,
            seeds=seeds_of(seed, place, 1 + number, count=len(distinct)),
            configurations=tuple(configurations),
            alpha_scat_per_cm=float(alpha_scat),
            campaigns=tuple(
                drawn_campaign(alpha_scat) for _ in range(number, campaigns, realisations)
            ),
        )
        for number, alpha_scat in enumerate(np.exp(low + (high - low) * middles))
    ]


def fit_uncached(realisation: Realisation) -> list[dict[str, Any] | str]:
    """`fit_realisation` with records that are made to be used once."""
    with environment(FOLDER_VARIABLE, "off"):
        return fit_realisation(realisation)


def fit_realisation(realisation: Realisation) -> list[dict[str, Any] | str]:
    """Simulate the configurations, on one thread, and fit all campaigns.

    Returns
    -------
    list of (dict or str)
        In the campaigns' order, as JSON can hold it; where the simulation or the fit was refused,
        the reason. Lists of 3 in the order of `NAMES`: ``truth``; ``value``, ``sigma``, ``lower``
        and ``upper`` as in `ParameterEstimate`; ``monte_carlo``, a part of sigma; ``truth_sigma``,
        what the Monte Carlo errors of the true efficiencies make of the value. Also
        ``realisation``, its number, ``correlation`` (3 times 3) and ``p_value``.
    """
    try:
        surfaces = _simulate(realisation)
    except InputError as error:
        return [str(error)] * len(realisation.campaigns)

    def surface_of(parameters: Mapping[str, object]) -> EtaSurface:
        return surfaces[tuple(parameters[name] for name in COLUMNS)]

    fits: list[dict[str, Any] | str] = []
    for drawn in realisation.campaigns:
        try:
            found = calibrate(as_campaign(realisation.configurations, drawn), surface_of)
        except InputError as error:
            fits.append(str(error))
            continue
        estimates = [found.parameters[name] for name in NAMES]
        fits.append(
            {
                "realisation": realisation.number,
                "truth": drawn.truth.tolist(),
                **{
                    name: [float(getattr(one, name)) for one in estimates]
                    for name in ("value", "sigma", "lower", "upper")
                },
                "monte_carlo": [float(one.contributions["monte_carlo"]) for one in estimates],
                "truth_sigma": _truth_sigma(found, realisation.configurations, drawn).tolist(),
                "correlation": found.correlation.tolist(),
                "p_value": found.p_value,
            }
        )
    return fits


def _truth_sigma(
    found: Calibration, configurations: Sequence[Configuration], drawn: DrawnCampaign
) -> NDArray[np.float64]:
    """(3,) what the errors of the truth make of the estimates."""
    by_reading = found.response * drawn.signal_truth_sigmas
    # readings of one configuration share the error
    shared = np.array([[one == other for other in configurations] for one in configurations])
    return np.sqrt(np.einsum("ij,jk,ik->i", by_reading, shared.astype(float), by_reading))


def _simulate(realisation: Realisation) -> dict[Configuration, EtaSurface]:
    """Surfaces of the fit by configuration."""
    truth, distinct = realisation.alpha_scat_per_cm, dict.fromkeys(realisation.configurations)
    points = [(factor * truth, a_a) for factor in (1 / 1.2, 1.0, 1.2)
              for a_a in (SIMULATED_ALPHA_ABS_PER_CM, *TRUE_ALPHA_ABS_PER_CM)]  # fmt: skip
    return {
        configuration: record_surface(
            _scene_of(configuration),
            points,
            photons=realisation.photons,
            alpha_scat_range_per_cm=(truth / REACH, truth * REACH),
            # the truth's simulation has checked the same scenes
            options=RunOptions(seed, threads=1, check=False),
        )[0]
        for configuration, seed in zip(distinct, realisation.seeds, strict=True)
    }


def as_campaign(configurations: Sequence[Configuration], drawn: DrawnCampaign) -> Campaign:
    """The campaign that a user would write down.

    The user knows the readings, not the truth: sigma is 1 % of the reading. That weighs low
    readings more and so lowers the scale, by 2 sigma^2 = 0.02 %, a hundredth of its error.
    """
    readings = tuple(
        Reading(
            label=f"reading {number}", signal=float(signal), sigma=READING_SIGMA * float(signal),
            parameters=dict(zip(COLUMNS, configuration, strict=True)),
            use=True, group=None, group_sigma=None, line=number,
        )
        for number, (configuration, signal) in enumerate(
            zip(configurations, drawn.signals, strict=True), start=2
        )
    )  # fmt: skip
    prior = drawn.prior_per_cm, PRIOR_SIGMA_PER_CM
    parameters = (
        CampaignParameter(ALPHA_SCAT, 0.5, 1e-3, 10.0, None, None, fixed=False),
        CampaignParameter(ALPHA_ABS, 0.039, 0.0, 1.0, *prior, fixed=False),
    )
    return Campaign(
        path=Path("closure.toml"),
        scene=read_scene(SCENE),
        measurements=Measurements(Path("closure.csv"), (), COLUMNS, readings),
        parameters={one.name: one for one in parameters},
        scale=None, effects=(), effects_folder=None, light_yield=None, next_measurements={},
    )  # fmt: skip
