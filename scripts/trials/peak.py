"""Are the centroids of histograms right, and their errors honest?

    python scripts/trials peak [--repeats 200] [--json FILE]

Histograms of 14.3 and 24.5 photons per event with ten minutes' statistics are drawn and fitted
again and again. A pull is a centroid's deviation in its own errors: of the mean number of photons
for the shape "counting"; for "gaussian", which finds the top of the band, of the centroid of the
expected counts. Their mean should be 0 and their standard deviation 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import click
import numpy as np

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.laboratory.peak import COUNTING, GAUSSIAN, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.output.description import table
from trials.executor import Trial, Trials, executor_options
from trials.truth import do_missing

MEANS, MINUTES, PER_S = (14.3, 24.5), 10.0, 33.0
#: Histograms of a trial.
BLOCK = 20


@click.command()
@click.option("--repeats", default=200, show_default=True, type=click.IntRange(2))
@options.seed
@options.json_output
@executor_options
def main(repeats: int, seed: int, json_file: str | None, executor, log) -> int:
    """Mean and width of the pulls, for two mean numbers of photons and two shapes."""
    screen = terminal.console(json_file)
    blocks = range(math.ceil(repeats / BLOCK))
    wanted = [Trial(f"{mean:g}-photons", block) for mean in MEANS for block in blocks]
    trials = Trials("peak", {"seed": seed}, wanted, [Path(__file__)], executor)
    arguments = {one: (float(one.kind.split("-")[0]), seed, one.number) for one in trials.missing}
    ended = do_missing(screen, "peak", trials, fit_block, arguments, log)
    if ended is not None:
        return ended
    rows = []
    for mean in MEANS:
        of_mean = [trials.results[one] for one in wanted if one.kind == f"{mean:g}-photons"]
        rows += judge(mean, list(chain(*of_mean))[:repeats])
    terminal.write_json(json_file, {"rows": rows, "repeats": repeats, "seed": seed})
    title = f"{repeats} histograms of {MINUTES:g} minutes at {PER_S:g} events per second"
    head = (
        "photons",
        "shape",
        "centroid",
        "one error",
        "bias, errors",
        "mean pull",
        "pull width",
        "p < 1 %",
        "taken by auto",
    )
    cells = [
        (
            f"{row['photons']:g}",
            row["shape"],
            pdg(row["centroid"], row["centroid_error"]),
            f"{row['sigma']:.3f}",
            f"{row['bias']:+.2f}",
            pdg(row["mean_pull"], row["mean_pull_error"]),
            pdg(row["width"], row["width_error"]),
            f"{100 * row['bad']:.1f} %",
            f"{100 * row['taken']:.1f} %",
        )
        for row in rows
    ]
    screen.show(table(title, head, cells))
    return terminal.DONE


def fit_block(mean: float, seed: int, number: int) -> list[dict]:
    """Both fits of each of `BLOCK` histograms: centroid, its error and p by shape; the chosen."""
    spectrum = PhotonSpectrum(mean, PER_S * 60 * MINUTES)
    random = np.random.default_rng((seed, round(1000 * mean)))
    # one sequence for all blocks: to draw is nothing beside a fit
    drawn = [spectrum.sample(random) for _ in range((number + 1) * BLOCK)][number * BLOCK :]
    fits = []
    for counts in drawn:
        found = fit_peak(spectrum.photons(), counts)
        both = {
            one.shape: [one.centroid, one.centroid_sigma, one.p_value]
            for one in (found, found.other)
        }
        fits.append({"chosen": found.shape, **both})
    return fits


def judge(mean: float, fits: Sequence[dict]) -> list[dict]:
    """A row of the table for each shape, of what `fit_block` gives."""
    spectrum, repeats = PhotonSpectrum(mean, PER_S * 60 * MINUTES), len(fits)
    photons = spectrum.photons()
    expected = fit_peak(photons, spectrum.expected(photons))
    rows = []
    for shape in (COUNTING, GAUSSIAN):
        of_expected = expected if expected.shape == shape else expected.other
        truth = mean if shape == COUNTING else of_expected.centroid
        found, sigmas, p_values = np.array([one[shape] for one in fits], dtype=float).T
        pulls = (found - truth) / sigmas
        rows.append(
            {
                "photons": mean,
                "shape": shape,
                "centroid": found.mean(),
                "centroid_error": found.std(ddof=1) / math.sqrt(repeats),
                "sigma": sigmas.mean(),
                "bias": (of_expected.centroid - mean) / of_expected.centroid_sigma,
                "mean_pull": pulls.mean(),
                "mean_pull_error": pulls.std(ddof=1) / math.sqrt(repeats),
                "width": pulls.std(ddof=1),
                "width_error": pulls.std(ddof=1) / math.sqrt(2 * repeats),
                "bad": np.mean(p_values < 0.01),
                "taken": np.mean([one["chosen"] == shape for one in fits]),
            }
        )
    return rows
