"""A peak's width by its origins: counted photoelectrons, where gammas stop, and the rest.

Relative variances add: of N photoelectrons that are counted 1 / N, of light that is collected
better from some places than from others the square of eta's relative rms over them. What is left is
the crystal's own non-proportionality, the gain's spread of single photoelectrons, and electronics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.laboratory.peak_band import Peak


@dataclass(frozen=True)
class Width:
    """A full width at half maximum over the centroid, and its standard error."""

    fwhm: float
    sigma: float


@dataclass(frozen=True)
class WidthParts:
    """Parts of a peak's width, which add in quadrature."""

    #: Where gammas stop, in words.
    source: str
    total: Width
    #: By counting photoelectrons, as many as the centroid says.
    counting: Width
    #: By where gammas stop.
    place: Width
    #: What is left; 0 where the others make more than the whole.
    rest: Width
    #: By how many standard errors the others' variance exceeds the whole; 0 where it does not.
    excess: float


def width_parts(peak: Peak, source: str, rms: float, rms_sigma: float) -> WidthParts:
    """The width of a peak in photoelectrons, by its origins.

    Parameters
    ----------
    source : str
        Where gammas stop, in words.
    rms, rms_sigma : float
        Relative rms of eta over these places, and its standard error.
    """
    n, n_sigma = peak.centroid, peak.centroid_sigma
    total = (peak.width / n) ** 2
    # of a width and a centroid whose errors are independent
    by_width, by_centroid = 2.0 * total * peak.width_sigma / peak.width, 2.0 * total * n_sigma / n
    of_count, of_place = n_sigma / n**2, 2.0 * rms * rms_sigma
    rest = total - 1.0 / n - rms**2
    # the centroid is in the whole and in the counting
    sigma = math.hypot(by_width, by_centroid - of_count, of_place)
    return WidthParts(
        source,
        _width(total, math.hypot(by_width, by_centroid)),
        _width(1.0 / n, of_count),
        Width(FWHM * rms, FWHM * rms_sigma),
        _width(max(rest, 0.0), sigma),
        max(-rest, 0.0) / sigma,
    )


def _width(variance: float, sigma: float) -> Width:
    """Of a relative variance and its error; near zero the error is that of the square."""
    root = math.sqrt(variance)
    return Width(FWHM * root, FWHM * sigma / max(2.0 * root, math.sqrt(sigma)))
