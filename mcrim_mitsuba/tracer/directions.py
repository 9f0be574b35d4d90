"""Random directions and the frames they are drawn in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def isotropic(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Unit vectors, uniform over the sphere: (3, count) float64."""
    z = 1.0 - 2.0 * rng.random(count)
    radius = np.sqrt(1.0 - z * z)
    azimuth = 2.0 * np.pi * rng.random(count)
    return np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), z))


def lambertian(rng: np.random.Generator, normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors with density cos(theta)/pi about unit normals.

    Parameters
    ----------
    rng : numpy.random.Generator
    normal : (3, n) float64

    Returns
    -------
    (3, n) float64
        Never along the surface: the cosine is above zero.
    """
    return about(rng, normal, np.sqrt(1.0 - rng.random(normal.shape[1])))


def about(
    rng: np.random.Generator, axis: NDArray[np.float64], cosine: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit vectors at given angles to axes, at random azimuths.

    Parameters
    ----------
    rng : numpy.random.Generator
    axis : (3, n) float64
        Unit vectors.
    cosine : (n,) float64
        Cosines of the angles.

    Returns
    -------
    (3, n) float64
    """
    sine = np.sqrt(1.0 - cosine * cosine)
    azimuth = 2.0 * np.pi * rng.random(cosine.size)
    u, v = basis(axis)
    direction = sine * (np.cos(azimuth) * u + np.sin(azimuth) * v) + cosine * axis
    # over thousands of scatterings rounding would add up
    return direction / np.sqrt(np.sum(direction * direction, axis=0))


def basis(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors that form a right-handed frame with each axis.

    T. Duff et al., Building an orthonormal basis, revisited, Journal of
    Computer Graphics Techniques 6(1), 2017.

    Parameters
    ----------
    axis : (3, n) float64
        Unit vectors.

    Returns
    -------
    u, v : (3, n) float64
        With u x v = axis.
    """
    x, y, z = axis
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    u = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x))
    v = np.stack((b, sign + y * y * a, -y))
    return u, v
