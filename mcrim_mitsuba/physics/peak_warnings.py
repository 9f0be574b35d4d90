"""What makes the centroid of a fitted peak doubtful."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.physics.peak_band import LEAST_P, Peak
from mcrim_mitsuba.physics.peak_search import SHALLOW, Found
from mcrim_mitsuba.physics.peak_shapes import GAUSSIAN, numbers_per_bin

# Widths on each side of the centroid that a fit must see.
_SEEN = 1.5
# Part of the height by which a background must not rise: the usual one falls.
_RISE = 0.25
# The same for its fall; and what it does to the centroid, in widths, if the background is no line
# but a flat continuum that ends at the centroid: 0.26 to 0.31 of the expected counts of 14.3 and
# 24.5 photons.
_FALL, _SHIFT = 0.10, 0.3
# Part of the centroid, in photons, above which the square of the width is that of counting.
_COUNTED = 0.3
# Relative error of the centroid above which there were too few events.
_POOR = 0.02


def warnings_of(
    values: NDArray[np.float64], peak: Peak, found: Found, given: tuple[float, float] | None
) -> list[str]:
    """A sentence for each doubt.

    Parameters
    ----------
    values : (bins,) float64
        All bins of the histogram.
    peak : Peak
    found : Found
        Where the peak was searched.
    given : (float, float) or None
        The window that the user chose.
    """
    said = []
    half = 0.5 * peak.bin_width
    for seen, side, at_end, level in (
        (peak.centroid - peak.low + half, "below", peak.low == values[0], found.low_level),
        (peak.high - peak.centroid + half, "above", peak.high == values[-1], found.high_level),
    ):
        how_far = f"{seen / peak.width:.2g} widths {side} its centroid"
        # no event has less than no photon
        cut = seen < _SEEN * peak.width and not (side == "below" and values[0] == 0 and at_end)
        if given is not None:
            if cut:
                said.append(f"the peak is cut by the window, only {how_far}: choose a wider one")
        elif cut and at_end:
            said.append(f"the peak is cut by the end of the histogram, only {how_far}")
        elif cut or level > SHALLOW:
            said.append(
                f"the peak is merged with what lies {side} it: between them the counts fall to "
                f"{100 * level:.0f} % of its height, and the fit ends {how_far}"
            )
    rise = peak.background_slope * (peak.high - peak.low)
    height = peak.counts_at(np.array(peak.centroid)) - peak.background
    if rise > _RISE * height > 0:
        said.append(
            "the peak is merged with what lies above it: the background rises by "
            f"{100 * rise / height:.0f} % of its height"
        )
    shift = -_SHIFT * rise / height * peak.width if height > 0 else 0.0
    if -rise > _FALL * height > 0 and shift > peak.centroid_sigma:
        said.append(
            f"the background falls by {-100 * rise / height:.0f} % of the peak's height, and may "
            f"be no line: the centroid may be off by some {shift:.2g} "
            f"({100 * shift / max(peak.centroid, 1e-9):.1g} %), too low if a continuum ends under "
            "the peak, too high if the tail of a pedestal reaches in"
        )
    relative = peak.centroid_sigma / max(abs(peak.centroid), 1e-9)
    if relative > _POOR:
        said.append(
            f"the peak is poor, some {peak.events:.0f} events: its centroid is known to "
            f"± {peak.centroid_sigma:.2g} only ({100 * relative:.1f} %)"
        )
    if peak.p_value < LEAST_P:
        said.append(
            f"the fit is bad (chi2 = {peak.chi2:.1f}, ndf = {peak.ndf}, p = {peak.p_value:.1g}): "
            f"its errors are {math.sqrt(peak.chi2 / peak.ndf):.2g} times those of the counts"
        )
    if (
        peak.shape == GAUSSIAN
        and peak.width**2 > _COUNTED * peak.centroid > 0
        and numbers_per_bin(values) is None
    ):
        # mean less mode is about k3 / (2 k2); of counted photons whose mean m has the variance v,
        # k2 = m + v and k3 = m + 3 v: 0.63 of 14.94 with v = (10 %)^2, where this gives 0.60
        lean = peak.width**2 / (2 * peak.centroid)
        if lean > peak.centroid_sigma:
            said.append(
                "the bins are no whole photon numbers, and a Gaussian was fitted: if they are "
                "photons or photoelectrons that were counted, the band leans, the Gaussian finds "
                f"its top, and the mean lies some {lean:.2g} ({100 * lean / peak.centroid:.1g} %) "
                "higher, or more where the charge of a single one varies"
            )
    if abs(peak.bin_width - 1.0) < 0.01 and abs(values[0] % 1.0 - 0.5) < 0.01:
        said.append(
            "the bins are centred between whole numbers: if their lower edges are the numbers of "
            "photons, the centroid is 0.5 too high"
        )
    return said


def doubts_of_shape(peak: Peak, other: Peak | None) -> list[str]:
    """Where whole numbers are not photons, or another shape describes them better."""
    if peak.shape == GAUSSIAN:
        return [
            f"the peak is narrower, {peak.width:.3g}, than counted photons can be (the square root "
            f"of {peak.centroid:.4g}): its bins are no photon numbers, and a Gaussian was fitted; "
            "if they are, something else reaches into the window: choose the shape counting"
        ]
    if other is None or peak.p_value >= LEAST_P or other.p_value <= peak.p_value:
        return []
    return [
        f"a Gaussian describes the counts better, with a centroid of {other.centroid:.4g} instead "
        f"of {peak.centroid:.4g}: if the bins are photon numbers, look for what else reaches into "
        "the window, and choose another; if not, choose the shape gaussian"
    ]
