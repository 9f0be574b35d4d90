"""Does the fit know its own errors? Synthetic campaigns with a known truth, fitted and judged.

    python scripts/trials closure                      # half an hour on two cores
    python scripts/trials closure --campaigns 100      # some minutes; its verdicts are rough

Every campaign has eight readings of the article's crystal and of a flat one, a truth of its own,
and a measured absorption for a prior. The readings come from one simulation, the fit's model from
others with fewer photons and other seeds, so that the model's Monte Carlo error counts as it does
in life: too small an error of the fit, or one counted twice, shows in the pulls.

Two efforts are judged: few photons, whose Monte Carlo error is 0.2 to 0.6 of a reading's,
and those of `mcrim calibrate` without options. Campaigns of one realisation (one simulation of all
configurations) share its error, so the errors shown are from the spread between realisations
(jackknife), and those of a pull's mean hold the error of the true efficiencies as well.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import click
import numpy as np
from scipy.stats import kstest
from shared import SCENE

from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.measurements import Measurements, Reading
from mcrim_mitsuba.campaign.parameter import SCALE, CampaignParameter
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_surface import EtaSurface, record_surface
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.output.description import table
from mcrim_mitsuba.runs.cache import FOLDER_VARIABLE
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from trials import truth as common
from trials.executor import Trial, TrialExecutor, Trials, executor_options
from trials.surface_model import CampaignModel, RecordSurface
from trials.truth import PRIOR_SIGMA_PER_CM, TRUE_ALPHA_ABS_PER_CM, TRUE_ALPHA_SCAT_PER_CM

NAMES = (ALPHA_SCAT, ALPHA_ABS, SCALE)
#: Columns of the measurements, and what stands in them: four couplings, two crystals of one boule.
COLUMNS = ("n_gap", "crystal_height_mm")
Configuration = tuple[float, float]
CONFIGURATIONS = tuple((n, height) for n in (1.0, 1.333, 1.46, 1.515) for height in (10.0, 5.0))
#: Relative standard error of a reading.
READING_SIGMA = 0.01
#: Absorptions that are simulated, 1/cm, from a tenth of the usual one, as a campaign's fit has it.
SIMULATED_ALPHA_ABS_PER_CM = (0.0039, 0.3)
#: Photons per configuration of the truth.
TRUTH_PHOTONS = 24_000_000
#: Photons of all configurations of the usual effort.
DEFAULT_PHOTONS = 27_000_000
#: A simulation covers the true scattering times and over this.
REACH = 3.0
#: Photons per configuration of the effort with few.
FEW_PHOTONS = 100_000
FEWEST_CAMPAIGNS, FEWEST_REALISATIONS = 20, 20
#: What is wanted of every parameter: coverage, pull's width, absolute pull's mean at most.
COVERAGE, WIDTH, BIAS = (0.64, 0.72), (0.93, 1.07), 0.12
#: Of every fit in the JSON.
FIT_COLUMNS = ("truth", "value", "sigma", "lower", "upper", "p_value", "realisation")
#: Least p-value of the Kolmogorov-Smirnov test.
LEAST_KS_P = 0.001


class Effort(NamedTuple):
    """How well the fit's model is simulated: photons per configuration, and how often.

    Realisations are independent simulations of all configurations, shared by the campaigns. The
    more a simulation's error weighs, the more of them an average over campaigns needs.
    """

    name: str
    photons: int
    realisations: int


class DrawnCampaign(NamedTuple):
    """Truth and readings of one campaign, and the absorption as measured beforehand.

    The truth (3,) is in the order of `NAMES`: 1/cm, 1/cm, the readings' unit. The signals, and
    what the Monte Carlo errors of the true efficiencies make of them, are (readings,).
    """

    truth: Array
    signals: Array
    signal_truth_sigmas: Array
    prior_per_cm: float


class Realisation(NamedTuple):
    """One simulation of all configurations, and the campaigns that are fitted with it.

    Configurations are per reading, seeds per distinct one, which is simulated once. The truth of
    alpha_scat is that of all its campaigns; the simulation covers this times and over `REACH`.
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
    """What stands for the truth: surfaces of photons that no fit uses, so many per configuration.

    Of the distinct configurations, in their order; `report` takes what, how much is done, and the
    total. Raises InputError as `record_surface`.
    """
    distinct = list(dict.fromkeys(configurations))
    low, high = TRUE_ALPHA_SCAT_PER_CM
    points = [
        (a_s, a_a) for a_s in (low, (low * high) ** 0.5, high) for a_a in TRUE_ALPHA_ABS_PER_CM
    ]
    surfaces = []
    for number, own_seed in enumerate(seeds_of(seed, 0, count=len(distinct))):
        report("truth", number, len(distinct))
        scene, run = _scene_of(distinct[number]), Run(photons, seed=own_seed)
        surfaces.append(record_surface(scene, points, run=run)[0])
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
    """Truths and readings of an effort's campaigns; realisations differ by one in their number.

    Configurations are per reading, truths of the distinct ones, in their order. Efforts at
    different places, which begin at 1, have independent random numbers.
    """
    realisations = min(effort.realisations, campaigns)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place, 0)))
    distinct = list(dict.fromkeys(configurations))
    surfaces = [truths[distinct.index(configuration)] for configuration in configurations]

    def drawn_campaign(alpha_scat: float) -> DrawnCampaign:
        truth = np.array([alpha_scat, *common.draw_absorption_and_scale(rng)])
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
            number,
            effort.photons,
            seeds_of(seed, place, 1 + number, count=len(distinct)),
            tuple(configurations),
            float(alpha_scat),
            tuple(drawn_campaign(alpha_scat) for _ in range(number, campaigns, realisations)),
        )
        for number, alpha_scat in enumerate(np.exp(low + (high - low) * middles))
    ]


def fit_realisation(realisation: Realisation) -> list[dict[str, Any] | str]:
    """Simulate the configurations, on one thread, and fit all campaigns.

    In the campaigns' order, as JSON can hold it; where the simulation or the fit was refused, the
    reason. Lists of 3 in the order of `NAMES`: ``truth``; ``value``, ``sigma``, ``lower`` and
    ``upper`` as in `ParameterEstimate`; ``monte_carlo``, a part of sigma; ``truth_sigma``, what
    the Monte Carlo errors of the true efficiencies make of the value. Also ``realisation``, its
    number, ``correlation`` (3 times 3) and ``p_value``.
    """
    try:
        with patch.dict(os.environ, {FOLDER_VARIABLE: "off"}):  # its records are used once
            surfaces = _simulate(realisation)
    except InputError as error:
        return [str(error)] * len(realisation.campaigns)

    def surface_of(parameters: Mapping[str, object]) -> RecordSurface:
        return surfaces[tuple(parameters[name] for name in COLUMNS)]

    fits: list[dict[str, Any] | str] = []
    for drawn in realisation.campaigns:
        try:
            campaign = as_campaign(realisation.configurations, drawn)
            found = fit_model(CampaignModel(campaign, surface_of))
        except InputError as error:
            fits.append(str(error))
            continue
        estimates = [found.parameters[name] for name in NAMES]
        ends = ("value", "sigma", "lower", "upper")
        fits.append(
            {name: [float(getattr(one, name)) for one in estimates] for name in ends}
            | {
                "realisation": realisation.number,
                "truth": drawn.truth.tolist(),
                "monte_carlo": [float(one.contributions["monte_carlo"]) for one in estimates],
                "truth_sigma": _truth_sigma(found, realisation.configurations, drawn).tolist(),
                "correlation": found.correlation.tolist(),
                "p_value": found.p_value,
            }
        )
    return fits


def _truth_sigma(
    found: Calibration, configurations: Sequence[Configuration], drawn: DrawnCampaign
) -> Array:
    """(3,) what the errors of the truth make of the estimates."""
    by_reading = found.response * drawn.signal_truth_sigmas
    # readings of one configuration share the error
    shared = np.array([[one == other for other in configurations] for one in configurations])
    return np.sqrt(np.einsum("ij,jk,ik->i", by_reading, shared.astype(float), by_reading))


def _simulate(realisation: Realisation) -> dict[Configuration, RecordSurface]:
    """Surfaces of the fit by configuration."""
    truth, distinct = realisation.alpha_scat_per_cm, dict.fromkeys(realisation.configurations)
    points = [
        (factor * truth, a_a)
        for factor in (1 / 1.2, 1.0, 1.2)
        for a_a in (SIMULATED_ALPHA_ABS_PER_CM[0], *TRUE_ALPHA_ABS_PER_CM)
    ]
    surfaces = {}
    for configuration, seed in zip(distinct, realisation.seeds, strict=True):
        surface, _ = record_surface(
            _scene_of(configuration),
            points,
            alpha_scat_range_per_cm=(truth / REACH, truth * REACH),
            alpha_abs_range_per_cm=SIMULATED_ALPHA_ABS_PER_CM,
            # the truth's simulation has checked the same scenes
            run=Run(realisation.photons, seed=seed, threads=1, check=False),
        )
        surfaces[configuration] = RecordSurface(surface.grid, surface.table)
    return surfaces


def as_campaign(configurations: Sequence[Configuration], drawn: DrawnCampaign) -> Campaign:
    """The campaign that a user would write down.

    The user knows the readings, not the truth: sigma is 1 % of the reading. That weighs low
    readings more and so lowers the scale, by 2 sigma^2 = 0.02 %, a hundredth of its error.
    """
    readings = tuple(
        Reading(
            f"reading {number}",
            float(signal),
            READING_SIGMA * float(signal),
            dict(zip(COLUMNS, configuration, strict=True)),
            line=number,
        )
        for number, (configuration, signal) in enumerate(
            zip(configurations, drawn.signals, strict=True), start=2
        )
    )
    parameters = (
        CampaignParameter(ALPHA_SCAT, 0.5, 1e-3, 10.0, fixed=False),
        CampaignParameter(
            ALPHA_ABS,
            0.039,
            *SIMULATED_ALPHA_ABS_PER_CM,
            prior=drawn.prior_per_cm,
            prior_sigma=PRIOR_SIGMA_PER_CM,
        ),
    )
    return Campaign(
        path=Path("closure.toml"),
        text="",
        scene=read_scene(SCENE),
        measurements=Measurements(Path("closure.csv"), (), COLUMNS, readings),
        parameters={one.name: one for one in parameters},
        scale=None,
        effects=(),
        effects_folder=None,
        light_yield=None,
        next_measurements={},
    )


class Outcomes:
    """Fits of many campaigns: what `fit_realisation` gives, as arrays with (fits,) in front.

    ``refusals`` are the reasons why other fits have no numbers; InputError if all were refused.
    """

    def __init__(self, fits: Sequence[dict[str, Any] | str]) -> None:
        self.refusals = tuple(fit for fit in fits if isinstance(fit, str))
        done = [fit for fit in fits if isinstance(fit, dict)]
        if not done:
            raise InputError(f"every fit was refused: {self.refusals[0]}", "give more --photons")
        for name in done[0]:
            setattr(self, name, np.array([fit[name] for fit in done]))

    @property
    def pull(self) -> Array:
        """(fits, 3) distance from the truth over the standard error."""
        return (self.value - self.truth) / self.sigma

    @property
    def interval_pull(self) -> Array:
        """(fits, 3) the same over that side of the interval which looks at the truth."""
        ends = np.where(self.value > self.truth, self.lower, self.upper)
        return (self.value - self.truth) / np.abs(self.value - ends)

    @property
    def covered(self) -> Array:
        """(fits, 3) 1 where the interval holds the truth, else 0."""
        return ((self.lower <= self.truth) & (self.truth <= self.upper)).astype(np.float64)


@dataclass(frozen=True)
class Judged:
    """A number with its standard error, and whether it is as wanted."""

    value: float
    error: float
    within: bool


@dataclass(frozen=True)
class ParameterRow:
    """One parameter over all campaigns.

    `monte_carlo`: its part of the standard error, in units of the whole; root mean square.
    """

    parameter: str
    monte_carlo: float
    coverage: Judged
    pull_mean: Judged
    pull_width: Judged

    @property
    def within(self) -> bool:
        return self.coverage.within and self.pull_mean.within and self.pull_width.within


def judge(outcomes: Outcomes) -> list[ParameterRow]:
    """Coverage and pulls of every parameter, of two realisations at least."""
    # the same error in all campaigns: their number does not lower it
    truth_part = np.sqrt(np.mean((outcomes.truth_sigma / outcomes.sigma) ** 2, axis=0))
    relative = np.sqrt(np.mean((outcomes.monte_carlo / outcomes.sigma) ** 2, axis=0))
    return [
        ParameterRow(
            name,
            float(relative[i]),
            _jackknife(outcomes, outcomes.covered[:, i], np.mean, *COVERAGE),
            _jackknife(outcomes, outcomes.pull[:, i], np.mean, -BIAS, BIAS, truth_part[i]),
            _jackknife(outcomes, outcomes.pull[:, i], np.std, *WIDTH),
        )
        for i, name in enumerate(NAMES)
    ]


def _jackknife(
    outcomes: Outcomes,
    values: Array,
    statistic: Callable[..., np.float64],
    least: float,
    most: float,
    further_error: float = 0.0,
) -> Judged:
    """A statistic of (fits,) values; its error is that of one realisation left out in turn."""
    numbers = np.unique(outcomes.realisation)
    without = [statistic(values[outcomes.realisation != number]) for number in numbers]
    error = np.hypot(np.std(without) * np.sqrt(len(numbers) - 1), further_error)
    value = float(statistic(values))
    return Judged(value, float(error), least <= value <= most)


class EffortTrials:
    """An effort's realisations as trials; for its place see `draw_realisations`."""

    def __init__(
        self, effort: Effort, campaigns: int, seed: int, place: int, executor: TrialExecutor
    ) -> None:
        self._drawn = effort, campaigns, CONFIGURATIONS
        self._place = seed, place
        count = min(effort.realisations, campaigns)
        self._wanted = [Trial(effort.name.replace(" ", "-"), number) for number in range(count)]
        common_ones = {"campaigns": campaigns, "seed": seed, "place": place, "truth": TRUTH_PHOTONS}
        code = [Path(__file__), Path(common.__file__)]
        parameters = effort._asdict() | common_ones
        self.trials = Trials("closure", parameters, self._wanted, code, executor)

    def do(self, truths: Sequence[EtaSurface], report: Callable) -> list[str]:
        """Fit what is missing; gives why something could not be."""
        drawn = draw_realisations(*self._drawn, truths, *self._place)
        arguments = {trial: (drawn[trial.number],) for trial in self.trials.missing}
        name = self._drawn[0].name
        return self.trials.do(fit_realisation, arguments, lambda _, *how: report(name, *how))

    def outcomes(self) -> Outcomes:
        """Of all fits, in the realisations' order."""
        return Outcomes([fit for one in self._wanted for fit in self.trials.results[one]])


def _show(screen, effort: Effort, outcomes: Outcomes, rows: list[ParameterRow], p: float) -> None:
    title = (
        f"{effort.name}: {len(outcomes.value)} campaigns on "
        f"{len(np.unique(outcomes.realisation))} simulations of {effort.photons:,} photons "
        "per configuration"
    )
    head = (
        "parameter",
        "Monte Carlo / error",
        "coverage, %",
        "pull's mean",
        "pull's width",
        "verdict",
    )
    cells = [
        (
            row.parameter,
            f"{row.monte_carlo:.2f}",
            _shown(row.coverage, 100, 1),
            _shown(row.pull_mean, 1, 3, sign="+"),
            _shown(row.pull_width, 1, 3),
            "within" if row.within else "OUTSIDE (!)",
        )
        for row in rows
    ]
    screen.show(table(title, head, cells))
    verdict = "within" if p >= LEAST_KS_P else "OUTSIDE"
    screen.print(
        f"p-values: Kolmogorov-Smirnov p = {p:.2g} ({verdict}, at least {LEAST_KS_P:g}); "
        f"{len(outcomes.refusals)} fits refused"
    )
    for refusal in dict.fromkeys(outcomes.refusals):
        screen.print(f"refused: {refusal}", markup=False)


def _shown(judged: Judged, factor: float, digits: int, sign: str = "") -> str:
    """``68.1 ± 1.5``, with a sign of alarm where it is not as wanted."""
    value, error = factor * judged.value, factor * judged.error
    mark = "" if judged.within else " (!)"
    return f"{value:{sign}.{digits}f} ± {error:.{digits}f}{mark}"


@click.command()
@click.option(
    "--campaigns",
    type=options.Whole(FEWEST_CAMPAIGNS, 1_000_000),
    default=1000,
    show_default=True,
    help="Campaigns to fit with either effort.",
)
@options.photons(f"{FEW_PHOTONS:,} per configuration, for the effort with few")
@options.seed
@options.json_output
@executor_options
def main(
    campaigns: int, photons: int | None, seed: int, json_file: str | None, executor, log
) -> int:
    """Fit synthetic campaigns and judge intervals, pulls and p-values.

    Wanted of every parameter: 68.3 % intervals that hold the truth in 64 % to 72 % of all
    campaigns, pulls of a width from 0.93 to 1.07 and of a mean within 0.12. Exit status 1 if not.
    """
    refuse_outputs({"--json": json_file}, [SCENE])
    start = time.perf_counter()
    efforts = (
        Effort("few photons", photons or FEW_PHOTONS, 5 * FEWEST_REALISATIONS),
        Effort("default effort", DEFAULT_PHOTONS // len(CONFIGURATIONS), FEWEST_REALISATIONS),
    )
    screen = terminal.console(json_file)
    work = [
        EffortTrials(effort, campaigns, seed, place, executor)
        for place, effort in enumerate(efforts, start=1)
    ]
    failures = []
    if any(one.trials.missing for one in work):
        with terminal.photon_progress(log=log) as report:
            truths = simulate_truth(CONFIGURATIONS, TRUTH_PHOTONS, seed, report)
            failures = [failure for one in work for failure in one.do(truths, report)]
    trials = [one.trials for one in work]
    lacking = bool(failures) or any(one.elsewhere for one in trials)
    ended = common.unfinished(screen, "closure", failures, *trials, lacking=lacking)
    if ended is not None:
        return ended
    found, good = [], True
    for effort, one in zip(efforts, work, strict=True):
        outcomes = one.outcomes()
        rows, p = judge(outcomes), float(kstest(outcomes.p_value, "uniform").pvalue)
        good &= all(row.within for row in rows) and p >= LEAST_KS_P and not outcomes.refusals
        found.append(
            effort._asdict()
            | {
                "campaigns": len(outcomes.value),
                "parameters": [asdict(row) | {"within": row.within} for row in rows],
                "kolmogorov_smirnov_p": p,
                "refusals": list(outcomes.refusals),
                "fits": {"names": list(NAMES)}
                | {name: getattr(outcomes, name).tolist() for name in FIT_COLUMNS},
            }
        )
        _show(screen, effort, outcomes, rows, p)
    seconds = time.perf_counter() - start
    terminal.write_json(json_file, {"ok": good, "seed": seed, "seconds": seconds, "efforts": found})
    screen.print(f"{'all as wanted' if good else 'NOT as wanted'}; seed {seed}, {seconds:.0f} s")
    return terminal.DONE if good else terminal.OUR_FAULT
