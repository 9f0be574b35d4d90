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

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest
from shared import SCENE

from mcrim_mitsuba.batch.hands import Hands
from mcrim_mitsuba.batch.trial_options import hands as hands_options
from mcrim_mitsuba.batch.trials import Trial, Trials
from mcrim_mitsuba.cli import options
from mcrim_mitsuba.cli import terminal as output
from mcrim_mitsuba.cli.terminal import DONE, OUR_FAULT
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.efficiency.reweighting import EtaSurface
from mcrim_mitsuba.inference.calibrate import DEFAULT_PHOTONS
from trials.closure_campaigns import (
    CONFIGURATIONS,
    NAMES,
    Effort,
    draw_realisations,
    fit_uncached,
    simulate_truth,
)
from trials.truth import unfinished

#: Photons per configuration of the truth.
TRUTH_PHOTONS = 24_000_000
#: Photons per configuration of the effort with few.
FEW_PHOTONS = 100_000
FEWEST_CAMPAIGNS, FEWEST_REALISATIONS = 20, 20
#: What is wanted of every parameter: coverage, pull's width, absolute pull's mean at most.
COVERAGE, WIDTH, BIAS = (0.64, 0.72), (0.93, 1.07), 0.12
#: Least p-value of the Kolmogorov-Smirnov test.
LEAST_KS_P = 0.001


class Outcomes:
    """Fits of many campaigns: what `fit_realisation` gives, as arrays with (fits,) in front.

    ``refusals`` are the reasons why other fits have no numbers.

    Raises
    ------
    InputError
        If every fit was refused.
    """

    def __init__(self, fits: Sequence[dict[str, Any] | str]) -> None:
        self.refusals = tuple(fit for fit in fits if isinstance(fit, str))
        done = [fit for fit in fits if isinstance(fit, dict)]
        if not done:
            raise InputError(f"every fit was refused: {self.refusals[0]}", "give more --photons")
        for name in done[0]:
            setattr(self, name, np.array([fit[name] for fit in done]))

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
    rows = []
    for i, name in enumerate(NAMES):
        coverage, coverage_error = _jackknife(outcomes, outcomes.covered[:, i], np.mean)
        mean, mean_error = _jackknife(outcomes, outcomes.pull[:, i], np.mean)
        width, width_error = _jackknife(outcomes, outcomes.pull[:, i], np.std)
        mean_error = float(np.hypot(mean_error, truth_part[i]))
        rows.append(
            ParameterRow(
                name,
                float(relative[i]),
                Judged(coverage, coverage_error, COVERAGE[0] <= coverage <= COVERAGE[1]),
                Judged(mean, mean_error, abs(mean) < BIAS),
                Judged(width, width_error, WIDTH[0] <= width <= WIDTH[1]),
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


class EffortTrials:
    """An effort's realisations as trials; for its place see `draw_realisations`."""

    def __init__(self, effort: Effort, campaigns: int, seed: int, place: int, hands: Hands) -> None:
        self._drawn = effort, campaigns, CONFIGURATIONS
        self._place = seed, place
        count = min(effort.realisations, campaigns)
        self._wanted = [Trial(effort.name.replace(" ", "-"), number) for number in range(count)]
        parameters = dataclasses.asdict(effort) | {
            "campaigns": campaigns, "seed": seed, "place": place, "truth": TRUTH_PHOTONS,
        }  # fmt: skip
        here = Path(__file__).parent
        code = [*here.glob("closure*.py"), here / "truth.py"]
        self.trials = Trials("closure", parameters, self._wanted, code, hands)

    def do(self, truths: Sequence[EtaSurface], report: Callable) -> list[str]:
        """Fit what is missing; gives why something could not be."""
        drawn = draw_realisations(*self._drawn, truths, *self._place)
        arguments = {trial: (drawn[trial.number],) for trial in self.trials.missing}

        def shown(_: str, done: int, total: int) -> None:
            report(self._drawn[0].name, done, total)

        return self.trials.do(fit_uncached, arguments, shown)

    def outcomes(self) -> Outcomes:
        """Of all fits, in the realisations' order."""
        return Outcomes([fit for one in self._wanted for fit in self.trials.results[one]])


def _show(screen, effort: Effort, outcomes: Outcomes, rows: list[ParameterRow], p: float) -> None:
    shown = output.table(
        f"{effort.name}: {len(outcomes.value)} campaigns on "
        f"{len(np.unique(outcomes.realisation))} simulations of {effort.photons:,} photons "
        "per configuration",
        "parameter", "Monte Carlo / error", "coverage, %", "pull's mean", "pull's width", "verdict",
    )  # fmt: skip
    for row in rows:
        shown.add_row(
            row.parameter, f"{row.monte_carlo:.2f}", _shown(row.coverage, 100, 1),
            _shown(row.pull_mean, 1, 3, sign="+"), _shown(row.pull_width, 1, 3),
            "within" if row.within else "OUTSIDE (!)",
        )  # fmt: skip
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
    columns = ("truth", "value", "sigma", "lower", "upper", "p_value", "realisation")
    return {
        **dataclasses.asdict(effort),
        "campaigns": len(outcomes.value),
        "parameters": [dataclasses.asdict(row) | {"within": row.within} for row in rows],
        "kolmogorov_smirnov_p": p,
        "refusals": list(outcomes.refusals),
        "fits": {"names": list(NAMES)}
        | {name: getattr(outcomes, name).tolist() for name in columns},
    }


@click.command()
@click.option("--campaigns", type=options.Whole(FEWEST_CAMPAIGNS, 1_000_000), default=1000,
              show_default=True, help="Campaigns to fit with either effort.")  # fmt: skip
@options.photons(f"{FEW_PHOTONS:,} per configuration, for the effort with few")
@options.seed
@options.json_output
@hands_options
def main(campaigns: int, photons: int | None, seed: int, json_file: str | None, hands, log) -> int:
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
    screen = output.console(json_file)
    work = [EffortTrials(effort, campaigns, seed, place, hands)
            for place, effort in enumerate(efforts, start=1)]  # fmt: skip
    failures = []
    if any(one.trials.missing for one in work):
        with output.photon_progress(log=log) as report:
            truths = simulate_truth(CONFIGURATIONS, TRUTH_PHOTONS, seed, report)
            failures = [failure for one in work for failure in one.do(truths, report)]
    lacking = bool(failures) or any(one.trials.elsewhere for one in work)
    ended = unfinished(screen, "closure", failures, *(w.trials for w in work), lacking=lacking)
    if ended is not None:
        return ended
    found, good = [], True
    for effort, one in zip(efforts, work, strict=True):
        outcomes = one.outcomes()
        rows, p = judge(outcomes), float(kstest(outcomes.p_value, "uniform").pvalue)
        good &= all(row.within for row in rows) and p >= LEAST_KS_P and not outcomes.refusals
        found.append(_as_json(effort, outcomes, rows, p))
        _show(screen, effort, outcomes, rows, p)
    seconds = time.perf_counter() - start
    output.write_json(json_file, {"ok": good, "seed": seed, "seconds": seconds, "efforts": found})
    screen.print(f"{'all as wanted' if good else 'NOT as wanted'}; seed {seed}, {seconds:.0f} s")
    return DONE if good else OUR_FAULT
