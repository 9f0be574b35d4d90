"""Does the fit know its own errors? Synthetic campaigns with a known truth, fitted and judged.

    python scripts/closure.py                          # half an hour on two cores
    python scripts/closure.py --campaigns 100          # some minutes; its verdicts are rough

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

import dataclasses
import multiprocessing
import multiprocessing.pool
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

import mcrim_mitsuba  # noqa: F401  (must come before mitsuba)
from mcrim_mitsuba.campaigns import DEFAULT_PHOTONS, REACH
from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.campaign import Campaign
from mcrim_mitsuba.files.campaign_parameter import SCALE, CampaignParameter
from mcrim_mitsuba.files.measurements import Measurements, Reading
from mcrim_mitsuba.files.scene_xml import read_scene
from mcrim_mitsuba.files.writing import refuse_outputs
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
#: Photons per configuration of the truth.
TRUTH_PHOTONS = 24_000_000
#: Photons per configuration of the effort with few.
FEW_PHOTONS = 100_000
FEWEST_CAMPAIGNS, FEWEST_REALISATIONS = 20, 20
#: What is wanted of every parameter: coverage, pull's width, absolute pull's mean at most.
COVERAGE, WIDTH, BIAS = (0.64, 0.72), (0.93, 1.07), 0.12
#: Least p-value of the Kolmogorov-Smirnov test.
LEAST_KS_P = 0.001


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


class Outcomes:
    """Fits of many campaigns.

    Parameters
    ----------
    fits : sequence of (Fit or str)
        What `fit_realisation` gives.

    Attributes
    ----------
    realisation, truth, value, sigma, lower, upper, monte_carlo, truth_sigma, correlation, p_value
        As in `Fit`, with one axis more in front: (fits, ...) ndarray.
    refusals : tuple of str
        Why other fits have no numbers.

    Raises
    ------
    InputError
        If every fit was refused.
    """

    def __init__(self, fits: Sequence[Fit | str]) -> None:
        self.refusals = tuple(fit for fit in fits if isinstance(fit, str))
        done = [fit for fit in fits if isinstance(fit, Fit)]
        if not done:
            raise InputError(f"every fit was refused: {self.refusals[0]}", "give more --photons")
        for field in dataclasses.fields(Fit):
            setattr(self, field.name, np.array([getattr(fit, field.name) for fit in done]))

    @property
    def pull(self) -> NDArray[np.float64]:
        """(fits, 3) distance from the truth over the standard error."""
        return (self.value - self.truth) / self.sigma

    @property
    def interval_pull(self) -> NDArray[np.float64]:
        """(fits, 3) the same over that side of the interval which looks at the truth."""
        ends = np.where(self.value > self.truth, self.lower, self.upper)
        return (self.value - self.truth) / np.abs(self.value - ends)

    @property
    def covered(self) -> NDArray[np.float64]:
        """(fits, 3) 1 where the interval holds the truth, else 0."""
        return ((self.lower <= self.truth) & (self.truth <= self.upper)).astype(np.float64)


@dataclass(frozen=True)
class Judged:
    """A number with its standard error.

    Attributes
    ----------
    value, error : float
    within : bool
        Whether the value is as wanted.
    """

    value: float
    error: float
    within: bool


@dataclass(frozen=True)
class ParameterRow:
    """One parameter over all campaigns.

    Attributes
    ----------
    parameter : str
    monte_carlo : float
        Monte Carlo part of the standard error, in units of the whole; root mean square.
    coverage, pull_mean, pull_width : Judged
    """

    parameter: str
    monte_carlo: float
    coverage: Judged
    pull_mean: Judged
    pull_width: Judged

    @property
    def within(self) -> bool:
        return self.coverage.within and self.pull_mean.within and self.pull_width.within


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


def judge(outcomes: Outcomes) -> list[ParameterRow]:
    """Coverage and pulls of every parameter.

    Parameters
    ----------
    outcomes : Outcomes
        Of two realisations at least.
    """
    # the same error in all campaigns: their number does not lower it
    truth_part = np.sqrt(np.mean((outcomes.truth_sigma / outcomes.sigma) ** 2, axis=0))
    relative = np.sqrt(np.mean((outcomes.monte_carlo / outcomes.sigma) ** 2, axis=0))
    rows = []
    for i, name in enumerate(NAMES):
        coverage, coverage_error = _jackknife(outcomes, outcomes.covered[:, i], np.mean)
        mean, mean_error = _jackknife(outcomes, outcomes.pull[:, i], np.mean)
        width, width_error = _jackknife(outcomes, outcomes.pull[:, i], np.std)
        rows.append(
            ParameterRow(
                parameter=name,
                monte_carlo=float(relative[i]),
                coverage=Judged(coverage, coverage_error, COVERAGE[0] <= coverage <= COVERAGE[1]),
                pull_mean=Judged(
                    mean, float(np.hypot(mean_error, truth_part[i])), abs(mean) < BIAS
                ),
                pull_width=Judged(width, width_error, WIDTH[0] <= width <= WIDTH[1]),
            )
        )
    return rows


def _jackknife(
    outcomes: Outcomes, values: NDArray[np.float64], statistic: Callable[..., np.float64]
) -> tuple[float, float]:
    """A statistic of (fits,) values and its standard error, one realisation left out in turn."""
    numbers = np.unique(outcomes.realisation)
    without = [statistic(values[outcomes.realisation != number]) for number in numbers]
    error = np.std(without) * np.sqrt(len(numbers) - 1)
    return float(statistic(values)), float(error)


def _fit_all(
    pool: multiprocessing.pool.Pool,
    effort: Effort,
    realisations: Sequence[Realisation],
    report: Callable[[str, int, int], None],
) -> Outcomes:
    """Fits of all realisations, in their order."""
    fits: list[Fit | str] = []
    report(effort.name, 0, len(realisations))
    for done, found in enumerate(pool.imap(fit_realisation, realisations), start=1):
        fits += found
        report(effort.name, done, len(realisations))
    return Outcomes(fits)


def _show(screen, effort: Effort, outcomes: Outcomes, rows: list[ParameterRow], p: float) -> None:
    shown = output.table(
        f"{effort.name}: {len(outcomes.value)} campaigns on "
        f"{len(np.unique(outcomes.realisation))} simulations of {effort.photons:,} photons "
        "per configuration",
        "parameter", "Monte Carlo / error", "coverage, %", "pull's mean", "pull's width", "verdict",
    )  # fmt: skip
    for row in rows:
        shown.add_row(
            row.parameter,
            f"{row.monte_carlo:.2f}",
            _shown(row.coverage, 100, 1),
            _shown(row.pull_mean, 1, 3, sign="+"),
            _shown(row.pull_width, 1, 3),
            "within" if row.within else "OUTSIDE (!)",
        )
    screen.print(shown)
    screen.print(
        f"p-values: Kolmogorov-Smirnov p = {p:.2g} "
        f"({'within' if p >= LEAST_KS_P else 'OUTSIDE'}, at least {LEAST_KS_P:g}); "
        f"{len(outcomes.refusals)} fits refused"
    )
    for refusal in dict.fromkeys(outcomes.refusals):
        screen.print(f"refused: {refusal}", markup=False)


def _shown(judged: Judged, factor: float, digits: int, sign: str = "") -> str:
    """``68.1 ± 1.5``, with a sign of alarm where it is not as wanted."""
    value, error = factor * judged.value, factor * judged.error
    mark = "" if judged.within else " (!)"
    return f"{value:{sign}.{digits}f} ± {error:.{digits}f}{mark}"


def _as_json(effort: Effort, outcomes: Outcomes, rows: list[ParameterRow], p: float) -> dict:
    columns = ("truth", "value", "sigma", "lower", "upper")
    return {
        **dataclasses.asdict(effort),
        "campaigns": len(outcomes.value),
        "parameters": [dataclasses.asdict(row) | {"within": row.within} for row in rows],
        "kolmogorov_smirnov_p": p,
        "refusals": list(outcomes.refusals),
        "fits": {
            "names": list(NAMES),
            **{name: getattr(outcomes, name).tolist() for name in columns},
            "p_value": outcomes.p_value.tolist(),
            "realisation": outcomes.realisation.tolist(),
        },
    }


@click.command()
@click.option("--campaigns", type=options.Whole(FEWEST_CAMPAIGNS, 1_000_000), default=1000,
              show_default=True, help="Campaigns to fit with either effort.")  # fmt: skip
@options.photons(f"{FEW_PHOTONS:,} per configuration, for the effort with few")
@options.seed
@options.json_output
def main(campaigns: int, photons: int | None, seed: int, json_file: str | None) -> None:
    """Fit synthetic campaigns and judge intervals, pulls and p-values.

    Wanted of every parameter: 68.3 % intervals that hold the truth in 64 % to 72 % of all
    campaigns, pulls of a width from 0.93 to 1.07 and of a mean within 0.12. Exit status 1 if not.
    """
    refuse_outputs({"--json": json_file}, [SCENE])
    # records are made to be used once
    os.environ["MCRIM_CACHE"] = "off"
    start = time.perf_counter()
    efforts = (
        Effort("few photons", photons or FEW_PHOTONS, 5 * FEWEST_REALISATIONS),
        Effort("default effort", DEFAULT_PHOTONS // len(CONFIGURATIONS), FEWEST_REALISATIONS),
    )
    screen = output.console(json_file)
    found, good = [], True
    # processes started anew: a fork of one whose threads run could hang; Ctrl-C is the parent's
    workers = multiprocessing.get_context("spawn").Pool(
        initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN)
    )
    with output.photon_progress() as report, workers as pool:
        truths = simulate_truth(CONFIGURATIONS, TRUTH_PHOTONS, seed, report)
        for place, effort in enumerate(efforts, start=1):
            drawn = draw_realisations(effort, campaigns, CONFIGURATIONS, truths, seed, place)
            outcomes = _fit_all(pool, effort, drawn, report)
            rows, p = judge(outcomes), float(kstest(outcomes.p_value, "uniform").pvalue)
            good &= all(row.within for row in rows) and p >= LEAST_KS_P and not outcomes.refusals
            found.append(_as_json(effort, outcomes, rows, p))
            _show(screen, effort, outcomes, rows, p)
    seconds = time.perf_counter() - start
    output.write_json(json_file, {"ok": good, "seed": seed, "seconds": seconds, "efforts": found})
    screen.print(f"{'all as wanted' if good else 'NOT as wanted'}; seed {seed}, {seconds:.0f} s")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    try:
        main(standalone_mode=False)
    except InputError as wrong:
        print(f"closure: {wrong}", file=sys.stderr)
        sys.exit(2)
    except click.ClickException as wrong:
        print(f"closure: {wrong.format_message()}", file=sys.stderr)
        sys.exit(2)
    except click.Abort:
        sys.exit("closure: interrupted before there was a result")
