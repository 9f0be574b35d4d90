"""Synthetic campaigns with a known truth: drawn, simulated and fitted; `closure.py` judges them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)
from mcrim_mitsuba.cache.location import FOLDER_VARIABLE
from mcrim_mitsuba.campaigns import REACH
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter
from mcrim_mitsuba.files.measurements import Measurements, Reading
from mcrim_mitsuba.files.scene_xml import read_scene
from mcrim_mitsuba.fit import Calibration, EtaSurface, calibrate
from mcrim_mitsuba.fit.surface import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.recording import RunOptions, record_surface

SCENE = Path(__file__).parents[1] / "scenes" / "camoo4.xml"
NAMES = (ALPHA_SCAT, ALPHA_ABS, SCALE)
#: Columns of the measurements, and what stands in them: four couplings, two crystals of one boule.
COLUMNS = ("n_gap", "crystal_height_mm")
CONFIGURATIONS = tuple((n, height) for n in (1.0, 1.333, 1.46, 1.515) for height in (10.0, 5.0))
#: Relative standard error of a reading.
READING_SIGMA = 0.01
#: Where truths are drawn: alpha_scat evenly in its logarithm, the others evenly.
TRUE_ALPHA_SCAT_PER_CM, TRUE_ALPHA_ABS_PER_CM = (0.15, 1.2), (0.027, 0.051)
TRUE_SCALE = (20.0, 60.0)
#: Standard error of the absorption that is measured beforehand, 1/cm.
PRIOR_SIGMA_PER_CM = 0.012
#: Least absorption that is simulated, 1/cm: a tenth of the usual one, as a campaign's fit has it.
SIMULATED_ALPHA_ABS_PER_CM = 0.0039


@dataclass(frozen=True)
class Effort:
    """How well the fit's model is simulated.

    Attributes
    ----------
    name : str
    photons : int
        Per configuration.
    realisations : int
        Independent simulations of all configurations, shared by the campaigns. The more a
        simulation's error weighs, the more of them an average over campaigns needs.
    """

    name: str
    photons: int
    realisations: int


@dataclass(frozen=True, eq=False)
class DrawnCampaign:
    """Truth and readings of one campaign.

    Attributes
    ----------
    truth : (3,) float64
        In the order of `NAMES`; 1/cm, 1/cm, the readings' unit.
    signals : (readings,) float64
    signal_truth_sigmas : (readings,) float64
        What the Monte Carlo errors of the true efficiencies make of the signals.
    prior_per_cm : float
        Measured absorption.
    """

    truth: NDArray[np.float64]
    signals: NDArray[np.float64]
    signal_truth_sigmas: NDArray[np.float64]
    prior_per_cm: float


@dataclass(frozen=True)
class Realisation:
    """One simulation of all configurations, and the campaigns that are fitted with it.

    Attributes
    ----------
    number : int
    photons : int
        Per configuration.
    seeds : tuple of int
        Per configuration.
    configurations : tuple of (n_gap, crystal_height_mm)
        Per reading; equal ones are simulated once.
    alpha_scat_per_cm : float
        Truth of all its campaigns; as in a campaign's second look, the simulation covers this
        times and over `campaigns.REACH`.
    campaigns : tuple of DrawnCampaign
    """

    number: int
    photons: int
    seeds: tuple[int, ...]
    configurations: tuple[tuple[float, float], ...]
    alpha_scat_per_cm: float
    campaigns: tuple[DrawnCampaign, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """One fitted campaign; arrays of shape (3,) in the order of `NAMES`.

    Attributes
    ----------
    realisation : int
        Its number.
    truth, value, sigma, lower, upper : float64
        As in `ParameterEstimate`.
    monte_carlo : float64
        Part of `sigma`.
    truth_sigma : float64
        What the Monte Carlo errors of the true efficiencies make of `value`.
    correlation : (3, 3) float64
    p_value : float
    """

    realisation: int
    truth: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    monte_carlo: NDArray[np.float64]
    truth_sigma: NDArray[np.float64]
    correlation: NDArray[np.float64]
    p_value: float

    def to_json(self) -> dict:
        """All attributes, arrays as lists."""
        return {field.name: np.asarray(getattr(self, field.name)).tolist()
                for field in fields(self)}  # fmt: skip


def seeds_of(seed: int, *place: int, count: int) -> tuple[int, ...]:
    """Independent seeds of a place in this program, (count,) from 0 to 2^63 - 1."""
    state = np.random.SeedSequence(seed, spawn_key=place).generate_state(count, np.uint64)
    return tuple(int(s) >> 1 for s in state)


def simulate_truth(
    configurations: Sequence[tuple[float, float]],
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
    surfaces = []
    for number, own_seed in enumerate(seeds_of(seed, 0, count=len(distinct))):
        report("truth", number, len(distinct))
        low, high = TRUE_ALPHA_SCAT_PER_CM
        points = [(a_s, a_a) for a_s in (low, (low * high) ** 0.5, high)
                  for a_a in TRUE_ALPHA_ABS_PER_CM]  # fmt: skip
        surface, _ = record_surface(
            read_scene(SCENE).with_overrides(dict(zip(COLUMNS, distinct[number], strict=True))),
            points,
            photons=photons,
            options=RunOptions(own_seed),
        )
        surfaces.append(surface)
    report("truth", len(distinct), len(distinct))
    return surfaces


def draw_realisations(
    effort: Effort,
    campaigns: int,
    configurations: Sequence[tuple[float, float]],
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
    # evenly spread, for there may be few
    middles = (np.arange(realisations) + 0.5) / realisations
    low, high = np.log(TRUE_ALPHA_SCAT_PER_CM)
    drawn = []
    for number, alpha_scat in enumerate(np.exp(low + (high - low) * middles)):
        own = []
        for _ in range(number, campaigns, realisations):
            truth = np.array(
                [alpha_scat, rng.uniform(*TRUE_ALPHA_ABS_PER_CM), rng.uniform(*TRUE_SCALE)]
            )
            points = [surface.evaluate(*truth[:2]) for surface in surfaces]
            exact = truth[2] * np.array([point.eta for point in points])
            own.append(
                DrawnCampaign(
                    truth=truth,
                    signals=exact * (1 + READING_SIGMA * rng.standard_normal(len(exact))),
                    signal_truth_sigmas=truth[2] * np.array([point.sigma for point in points]),
                    prior_per_cm=rng.normal(truth[1], PRIOR_SIGMA_PER_CM),
                )
            )
        drawn.append(
            Realisation(
                number=number,
                photons=effort.photons,
                seeds=seeds_of(seed, place, 1 + number, count=len(distinct)),
                configurations=tuple(configurations),
                alpha_scat_per_cm=float(alpha_scat),
                campaigns=tuple(own),
            )
        )
    return drawn


def fit_to_json(realisation: Realisation) -> list[dict | str]:
    """`fit_realisation` as JSON holds it, of records that are made to be used once."""
    with _no_cache():
        fits = fit_realisation(realisation)
    return [fit if isinstance(fit, str) else fit.to_json() for fit in fits]


@contextmanager
def _no_cache() -> Iterator[None]:
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = "off"
    try:
        yield
    finally:
        del os.environ[FOLDER_VARIABLE]
        if before is not None:
            os.environ[FOLDER_VARIABLE] = before


def fit_realisation(realisation: Realisation) -> list[Fit | str]:
    """Simulate the configurations, on one thread, and fit all campaigns.

    Returns
    -------
    list of (Fit or str)
        In the campaigns' order; where the simulation or the fit was refused, the reason.
    """
    try:
        surfaces = _simulate(realisation)
    except InputError as error:
        return [str(error)] * len(realisation.campaigns)

    def surface_of(parameters: Mapping[str, object]) -> EtaSurface:
        return surfaces[tuple(parameters[name] for name in COLUMNS)]

    fits: list[Fit | str] = []
    for drawn in realisation.campaigns:
        try:
            found = calibrate(as_campaign(realisation.configurations, drawn), surface_of)
        except InputError as error:
            fits.append(str(error))
            continue
        estimates = [found.parameters[name] for name in NAMES]
        fits.append(
            Fit(
                realisation=realisation.number,
                truth=drawn.truth,
                value=np.array([estimate.value for estimate in estimates]),
                sigma=np.array([estimate.sigma for estimate in estimates]),
                lower=np.array([estimate.lower for estimate in estimates]),
                upper=np.array([estimate.upper for estimate in estimates]),
                monte_carlo=np.array([e.contributions["monte_carlo"] for e in estimates]),
                truth_sigma=_truth_sigma(found, realisation.configurations, drawn),
                correlation=found.correlation,
                p_value=found.p_value,
            )
        )
    return fits


def _truth_sigma(
    found: Calibration, configurations: Sequence[tuple[float, float]], drawn: DrawnCampaign
) -> NDArray[np.float64]:
    """(3,) what the errors of the truth make of the estimates."""
    by_reading = found.response * drawn.signal_truth_sigmas
    # readings of one configuration share the error
    shared = np.array([[one == other for other in configurations] for one in configurations])
    return np.sqrt(np.einsum("ij,jk,ik->i", by_reading, shared.astype(float), by_reading))


def _simulate(realisation: Realisation) -> dict[tuple[float, float], EtaSurface]:
    """Surfaces of the fit by configuration."""
    scene, truth = read_scene(SCENE), realisation.alpha_scat_per_cm
    points = [(factor * truth, a_a) for factor in (1 / 1.2, 1.0, 1.2)
              for a_a in (SIMULATED_ALPHA_ABS_PER_CM, *TRUE_ALPHA_ABS_PER_CM)]  # fmt: skip
    surfaces = {}
    distinct = dict.fromkeys(realisation.configurations)
    for configuration, seed in zip(distinct, realisation.seeds, strict=True):
        surfaces[configuration], _ = record_surface(
            scene.with_overrides(dict(zip(COLUMNS, configuration, strict=True))),
            points,
            photons=realisation.photons,
            alpha_scat_range_per_cm=(truth / REACH, truth * REACH),
            # the truth's simulation has checked the same scenes
            options=RunOptions(seed, threads=1, check=False),
        )
    return surfaces


def as_campaign(configurations: Sequence[tuple[float, float]], drawn: DrawnCampaign) -> Campaign:
    """The campaign that a user would write down.

    The user knows the readings, not the truth: sigma is 1 % of the reading. That weighs low
    readings more and so lowers the scale, by 2 sigma^2 = 0.02 %, a hundredth of its error.
    """
    readings = tuple(
        Reading(
            label=f"reading {number}",
            signal=float(signal),
            sigma=READING_SIGMA * float(signal),
            parameters=dict(zip(COLUMNS, configuration, strict=True)),
            use=True,
            group=None,
            group_sigma=None,
            line=number,
        )
        for number, (configuration, signal) in enumerate(
            zip(configurations, drawn.signals, strict=True), start=2
        )
    )
    alpha_scat = CampaignParameter(ALPHA_SCAT, 0.5, 1e-3, 10.0, None, None, fixed=False)
    alpha_abs = CampaignParameter(
        ALPHA_ABS, 0.039, 0.0, 1.0, drawn.prior_per_cm, PRIOR_SIGMA_PER_CM, fixed=False
    )
    return Campaign(
        path=Path("closure.toml"),
        scene=read_scene(SCENE),
        measurements=Measurements(Path("closure.csv"), (), COLUMNS, readings),
        parameters={ALPHA_SCAT: alpha_scat, ALPHA_ABS: alpha_abs},
        scale=None,
        effects=(),
        effects_folder=None,
        light_yield=None,
        next_measurements={},
    )
