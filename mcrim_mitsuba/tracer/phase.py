"""Phase functions: the direction in which light is scattered."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.bench import Bench
from mcrim_mitsuba.tracer.directions import about, isotropic

#: Draws new directions, (3, n), for photons that fly along (3, n).
PhaseFunction = Callable[[np.random.Generator, NDArray[np.float64]], NDArray[np.float64]]


def phase_function(bench: Bench) -> PhaseFunction:
    """The law by which the bench's crystal scatters."""
    if bench.rayleigh_scattering:
        return lambda rng, direction: about(
            rng, direction, rayleigh_cosine(rng, direction.shape[1])
        )
    g = bench.scattering_g
    if g:
        return lambda rng, direction: about(
            rng, direction, henyey_greenstein_cosine(rng, direction.shape[1], g)
        )
    return lambda rng, direction: isotropic(rng, direction.shape[1])


def henyey_greenstein_cosine(rng: np.random.Generator, count: int, g: float) -> NDArray[np.float64]:
    """Cosines of deflection with mean ``g``: (count,) float64.

    L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70; the
    inverse of the distribution function as in A. N. Witt, ApJ Suppl. 35 (1977) 1.

    Parameters
    ----------
    rng : numpy.random.Generator
    count : int
    g : float
        Between -1 and 1, not 0.
    """
    ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * rng.random(count))
    return np.clip((1.0 + g * g - ratio * ratio) / (2.0 * g), -1.0, 1.0)


def rayleigh_cosine(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Cosines with density 3/8 (1 + cos^2): (count,) float64.

    J. R. Frisvad, Importance sampling the Rayleigh phase function, Journal of
    the Optical Society of America A 28 (2011) 2436.
    """
    draw = 2.0 * (2.0 * rng.random(count) - 1.0)
    root = np.cbrt(draw + np.sqrt(draw * draw + 1.0))
    return np.clip(root - 1.0 / root, -1.0, 1.0)
