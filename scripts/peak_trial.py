"""Are the centroids of histograms right, and their errors honest?

    python scripts/peak_trial.py [--repeats 200] [--json FILE]

Histograms of 14.3 and 24.5 photons per event with ten minutes' statistics are drawn and fitted
again and again. A pull is a centroid's deviation in its own errors: of the mean number of photons
for the shape "counting"; for "gaussian", which finds the top of the band, of the centroid of the
expected counts. Their mean should be 0 and their standard deviation 1.
"""

from __future__ import annotations

import math

import click
import numpy as np

from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.physics.peak import COUNTING, GAUSSIAN, fit_peak
from mcrim_mitsuba.physics.photon_histogram import spectrum_of
from mcrim_mitsuba.physics.rounding import pdg

MEANS, MINUTES, PER_S = (14.3, 24.5), 10.0, 33.0


@click.command()
@click.option("--repeats", default=200, show_default=True, type=click.IntRange(2))
@options.seed
@options.json_output
def main(repeats: int, seed: int, json_file: str | None) -> None:
    """Mean and width of the pulls, for two mean numbers of photons and two shapes."""
    rows = [row for mean in MEANS for row in trial(mean, repeats, seed)]
    output.write_json(json_file, {"rows": rows, "repeats": repeats, "seed": seed})
    screen = output.console(json_file)
    shown = output.table(
        f"{repeats} histograms of {MINUTES:g} minutes at {PER_S:g} events per second",
        "photons", "shape", "centroid", "one error", "bias, errors", "mean pull", "pull width",
        "p < 1 %", "taken by auto",
    )  # fmt: skip
    for row in rows:
        shown.add_row(
            f"{row['photons']:g}", row["shape"], pdg(row["centroid"], row["centroid_error"]),
            f"{row['sigma']:.3f}", f"{row['bias']:+.2f}",
            pdg(row["mean_pull"], row["mean_pull_error"]), pdg(row["width"], row["width_error"]),
            f"{100 * row['bad']:.1f} %", f"{100 * row['taken']:.1f} %",
        )  # fmt: skip
    screen.print(shown)


def trial(mean: float, repeats: int, seed: int) -> list[dict]:
    """A row of the table for each shape."""
    spectrum = spectrum_of(mean, PER_S * 60 * MINUTES)
    random = np.random.default_rng((seed, round(1000 * mean)))
    photons = spectrum.photons()
    chosen = [fit_peak(photons, spectrum.sample(random)) for _ in range(repeats)]
    expected = fit_peak(photons, spectrum.expected(photons))
    rows = []
    for shape in (COUNTING, GAUSSIAN):
        fits = [one if one.shape == shape else one.other for one in chosen]
        of_expected = expected if expected.shape == shape else expected.other
        truth = mean if shape == COUNTING else of_expected.centroid
        found = np.array([one.centroid for one in fits])
        sigmas = np.array([one.centroid_sigma for one in fits])
        pulls = (found - truth) / sigmas
        rows.append({
            "photons": mean, "shape": shape,
            "centroid": found.mean(), "centroid_error": found.std(ddof=1) / math.sqrt(repeats),
            "sigma": sigmas.mean(),
            "bias": (of_expected.centroid - mean) / of_expected.centroid_sigma,
            "mean_pull": pulls.mean(), "mean_pull_error": pulls.std(ddof=1) / math.sqrt(repeats),
            "width": pulls.std(ddof=1), "width_error": pulls.std(ddof=1) / math.sqrt(2 * repeats),
            "bad": np.mean([one.p_value < 0.01 for one in fits]),
            "taken": np.mean([one.shape == shape for one in chosen]),
        })  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
