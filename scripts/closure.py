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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import click
import numpy as np
from closure_campaigns import (
    CONFIGURATIONS,
    NAMES,
    SCENE,
    Effort,
    Fit,
    Realisation,
    draw_realisations,
    fit_realisation,
    simulate_truth,
)
from numpy.typing import NDArray
from scipy.stats import kstest

from mcrim_mitsuba.campaigns import DEFAULT_PHOTONS
from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import refuse_outputs

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
