"""Histograms of photons per event with their fitted peaks, like Fig. 2 of the article.

    python scripts/draw_histograms.py AIR.csv GEL.csv -o fig2.png --labels air,gel
    python scripts/draw_histograms.py --synthetic scenes

The second makes `scenes/camoo4_histogram_air.csv` and `_gel.csv`. They are synthetic: the
article prints no histogram, only the centroids of the peaks.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import poisson

from mcrim_mitsuba.article import published
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.figures.histograms import draw_histograms
from mcrim_mitsuba.files.histogram import read_histogram
from mcrim_mitsuba.files.writing import write_text
from mcrim_mitsuba.physics.peak import fit_peak

SEED = 20130602
PHOTONS = np.arange(61.0)
#: Events in the peak, the pedestal and the background; the latter two fall off exponentially
#: with these numbers of photons.
PEAK, PEDESTAL, BACKGROUND = 20_000, 15_000, 3_000
PEDESTAL_PHOTONS, BACKGROUND_PHOTONS = 1.2, 25.0
#: Relative standard deviation of the light of an event, besides the counting of its photons.
INTRINSIC_SPREAD = 0.10


@click.command()
@click.argument("files", nargs=-1)
@click.option("-o", "--output", default="histograms.png", show_default=True)
@click.option("--labels", default="", help="Names, with commas between them.")
@click.option("--synthetic", metavar="FOLDER", help="Write the synthetic histograms there.")
def main(files: tuple[str, ...], output: str, labels: str, synthetic: str | None) -> None:
    """Draw histograms (FILES: bin centre, counts) and fit their peaks."""
    try:
        if synthetic is not None:
            write_synthetic(Path(synthetic))
        if files:
            names = labels.split(",") if labels else [Path(file).stem for file in files]
            if len(names) != len(files):
                raise InputError(
                    f"{len(names)} labels for {len(files)} files", "give each file a label"
                )
            histograms = [read_histogram(file) for file in files]
            for path in draw_histograms(output, list(zip(names, histograms, strict=True))):
                print(path)
    except InputError as error:
        sys.exit(f"draw_histograms: {error}")


def write_synthetic(folder: Path) -> None:
    """Histograms whose peaks have the article's centroids."""
    for name, signal, seed in (
        ("air", published.SIGNAL_AIR, SEED), ("gel", published.SIGNAL_GEL, SEED + 1),
    ):  # fmt: skip
        mean = mean_of_centroid(signal.value)
        events = np.random.default_rng(seed).poisson(expected(mean))
        lines = [
            f"# SYNTHETIC, not measured: photons per event of a CaMoO4 crystal, {name} in the gap",
            "# V. Alenkov et al., JINST 8 (2013) P06002, print no histogram, only the centroid",
            f"# of the peak, {signal.value:g} photons; scripts/draw_histograms.py --synthetic made",
            f"# this one with seed {seed}: Poisson numbers of photons with mean {mean:.3f} and",
            f"# {100 * INTRINSIC_SPREAD:g} % intrinsic spread ({PEAK} events), a pedestal and a "
            f"background",
            f"# (exp(-n/{PEDESTAL_PHOTONS:g}), {PEDESTAL}, and exp(-n/{BACKGROUND_PHOTONS:g}), "
            f"{BACKGROUND} events). The peak is lopsided as Poisson",
            "# numbers are: the mean is such that the centroid of a Gaussian is the article's.",
            "photons_per_event,events",
            *(f"{photons:g},{count}" for photons, count in zip(PHOTONS, events, strict=True)),
        ]
        write_text(folder / f"camoo4_histogram_{name}.csv", "\n".join(lines) + "\n")


def mean_of_centroid(centroid: float) -> float:
    """The mean number of photons for which a Gaussian fit gives a centroid."""

    def apart(mean: float) -> float:
        return fit_peak(PHOTONS, expected(mean)).centroid - centroid

    return brentq(apart, 0.97 * centroid, 1.12 * centroid, xtol=1e-4)


def expected(mean: float) -> NDArray[np.float64]:
    """(bins,) expected events: peak, pedestal and background."""
    # an event's mean varies as a Gaussian
    deviations = np.linspace(-4, 4, 81)
    weights = np.exp(-(deviations**2) / 2)
    means = mean * (1 + INTRINSIC_SPREAD * deviations)
    peak = poisson.pmf(PHOTONS[:, None], means) @ (weights / weights.sum())
    return PEAK * peak + sum(
        events * -math.expm1(-1 / photons) * np.exp(-PHOTONS / photons)
        for events, photons in (
            (PEDESTAL, PEDESTAL_PHOTONS), (BACKGROUND, BACKGROUND_PHOTONS),
        )
    )  # fmt: skip


if __name__ == "__main__":
    main()
