"""Shapes of a band in a histogram of photons per event, with their derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

GAUSSIAN, COUNTING = "gaussian", "counting"

# Nodes of the sum over the mean number of photons: reach in standard deviations, and spacing in
# widths of what is summed. The error of the rule is exp(-2 pi^2 / spacing^2), 1e-9.
_REACH, _SPACING = 6.0, 1.0


def band(
    shape: str, values: NDArray[np.float64], centroid: float, spread: float, bin_width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Density per unit of the bins, and its (2, bins) derivatives by centroid and spread.

    The spread is the width of a Gaussian, or the variance of the mean number of photons.
    """
    if shape == GAUSSIAN:
        return gaussian(values, centroid, spread)
    return counting(values, centroid, spread, round(bin_width))


def gaussian(
    values: NDArray[np.float64], centroid: float, width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Density of a Gaussian, and its (2, bins) derivatives by centroid and width."""
    deviation = (values - centroid) / width
    density = np.exp(-0.5 * deviation**2) / (width * math.sqrt(2.0 * math.pi))
    return density, np.stack([density * deviation, density * (deviation**2 - 1.0)]) / width


def counting(
    values: NDArray[np.float64], mean: float, variance: float, bin_width: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Density per photon of counted photons whose mean number varies as a Gaussian.

    Probability P(n) of n photons, by the generating function exp(m (z - 1) + v (z - 1)^2 / 2),
    whence dP/dm = P(n - 1) - P(n) and dP/dv = (P(n - 2) - 2 P(n - 1) + P(n)) / 2.

    Parameters
    ----------
    values : (bins,) float64
        Bin centres; between the bins, the gamma function carries P on.
    mean, variance : float
        Of the Gaussian; the variance of the numbers is larger by the mean.
    bin_width : int
        Numbers in a bin.

    Returns
    -------
    density : (bins,) float64
    slopes : (2, bins) float64
        Derivatives by mean and variance.
    """
    first = values - 0.5 * (bin_width - 1)
    spread = math.sqrt(max(variance, 0.0))
    nodes = math.ceil(_REACH / _SPACING * math.sqrt(1.0 + variance / mean))
    deviations = np.linspace(-_REACH, _REACH, 2 * nodes + 1)
    weights = np.exp(-0.5 * deviations**2)
    means = np.maximum(mean + spread * deviations, 1e-9)
    # P(n - 2), P(n - 1) and the numbers of the bin
    numbers = first[:, None] + np.arange(-2, bin_width)
    counted = np.maximum(numbers, 0.0)
    exponents = counted[..., None] * np.log(means) - means - gammaln(counted + 1.0)[..., None]
    chances = np.exp(exponents) @ (weights / weights.sum())
    chances[numbers <= -1.0] = 0.0
    below, before, last = (
        chances[:, i : i + bin_width].sum(axis=1) / bin_width for i in range(3)
    )  # fmt: skip
    return last, np.stack([before - last, 0.5 * (below - 2.0 * before + last)])


def numbers_per_bin(values: NDArray[np.float64]) -> int | None:
    """How many whole numbers each bin holds; None where bins are not of whole numbers.

    Parameters
    ----------
    values : (bins,) float64
        Bin centres, ascending, all bins of one width.
    """
    width = values[1] - values[0]
    numbers = round(width)
    lowest = values[0] - 0.5 * (numbers - 1)
    whole = numbers >= 1 and abs(width - numbers) < 0.01 and abs(lowest - round(lowest)) < 0.01
    return numbers if whole else None
