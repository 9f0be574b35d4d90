"""Light attenuation in a slab: Beer-Lambert, and the multiple reflections of its faces.

Coefficients are in 1/cm and lengths in mm, the units in which people give them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import MM_PER_CM

_OUTSIDE = ("an internal transmittance is outside 0..1", "give a fraction: 0.96 for 96 %")


def transmittance(alpha_per_cm: ArrayLike, path_mm: ArrayLike) -> Array:
    """Beer's law, T = exp(-alpha d) (Eq. 4 of the article); InputError if one is negative."""
    alpha_per_cm, path_mm = np.asarray(alpha_per_cm, float), np.asarray(path_mm, float)
    if not (np.all(alpha_per_cm >= 0) and np.all(path_mm >= 0)):
        raise InputError("a coefficient or a path is negative", "give values of 0 or more")
    return np.exp(-alpha_per_cm * path_mm / MM_PER_CM)


def absorption_coefficient(transmittance: ArrayLike, path_mm: ArrayLike) -> Array:
    """Coefficient in 1/cm that gives an internal transmittance over a path: -ln(T)/d.

    Raises InputError if a transmittance is not above 0 and at most 1, or a path not above 0.
    """
    internal, path_mm = np.asarray(transmittance, float), np.asarray(path_mm, float)
    if not np.all((internal > 0) & (internal <= 1)):
        raise InputError(*_OUTSIDE)
    if not np.all(path_mm > 0):
        raise InputError("a path length is not above 0", "give the thickness in mm")
    # + 0.0 turns the -0.0 of a perfectly clear sample into 0.0
    return -np.log(internal) * MM_PER_CM / path_mm + 0.0


def _face_reflectance(n: ArrayLike) -> Array:
    """R = ((n-1)/(n+1))^2 of one face in air, normal incidence."""
    n = np.asarray(n, dtype=float)
    if not np.all(n >= 1):
        raise InputError(f"the refractive index {np.min(n):g} is below 1", "a solid has n > 1")
    return ((n - 1) / (n + 1)) ** 2


def measured_transmittance(internal: ArrayLike, n: ArrayLike) -> Array:
    """What a spectrophotometer reads on a polished slab in air.

    All orders of reflection between the two faces, added without interference at normal
    incidence (the correction of Kushnir et al., the article's reference 21):
    (1-R)^2 T / (1 - R^2 T^2) with R = ((n-1)/(n+1))^2.

    Raises InputError if an internal transmittance T is outside 0..1 or an index of the slab below
    1.
    """
    internal, face = np.asarray(internal, dtype=float), _face_reflectance(n)
    if not np.all((internal >= 0) & (internal <= 1)):
        raise InputError(*_OUTSIDE)
    return (1 - face) ** 2 * internal / (1 - (face * internal) ** 2)


def internal_transmittance(measured: ArrayLike, n: ArrayLike) -> Array:
    """Inverse of `measured_transmittance`: the transmittance of the bulk alone.

    The positive root of R^2 M T^2 + (1-R)^2 T - M = 0, written without the difference
    that loses digits at small R.

    Raises InputError if a reading M is not above 0 and at most that of a clear slab
    (`clear_limit`).
    """
    measured, limit = np.asarray(measured, dtype=float), clear_limit(n)
    # the tolerance lets a clear slab's own reading come back as T = 1
    if not np.all((measured > 0) & (measured <= limit * (1 + 1e-12))):
        raise InputError(
            f"a measured transmittance is not between 0 and {np.min(limit):.4f}, the reading of "
            "a slab that absorbs nothing",
            "give a fraction (0.76 for 76 %) and check the refractive index",
        )
    return np.minimum(_internal(measured, n), 1.0)


def clear_limit(n: ArrayLike) -> Array:
    """Reading on a clear slab, (1-R)/(1+R): 0.798 for n = 2.01; InputError for n below 1."""
    face = _face_reflectance(n)
    return (1 - face) / (1 + face)


def apparent_absorption(measured: ArrayLike, n: ArrayLike, thickness_mm: float) -> Array:
    """Coefficient in 1/cm behind a slab's reading, below 0 where the reading is above its limit.

    Readings are noisy: averages over many stay without bias only if none is clipped.

    Raises InputError if a reading or the thickness is not above 0, or an index below 1.
    """
    measured = np.asarray(measured, dtype=float)
    if not np.all(measured > 0):
        raise InputError("a measured transmittance is not above 0", "give a thinner sample's")
    if not thickness_mm > 0:
        raise InputError("the thickness is not above 0", "give it in mm")
    # + 0.0 turns the -0.0 of a perfectly clear sample into 0.0
    return -np.log(_internal(measured, n)) * MM_PER_CM / thickness_mm + 0.0


def absorption_derivatives(
    measured: ArrayLike, n: ArrayLike, thickness_mm: float
) -> tuple[Array, Array]:
    """Change of `apparent_absorption` with the reading, and with the index, in 1/cm."""
    measured, n, face = np.asarray(measured, float), np.asarray(n, float), _face_reflectance(n)
    internal = _internal(measured, n)
    # of M = (1-R)^2 T / (1 - R^2 T^2), by its logarithm
    squared = (face * internal) ** 2
    by_internal = measured / internal * (1 + squared) / (1 - squared)
    by_face = measured * (-2 / (1 - face) + 2 * face * internal**2 / (1 - squared))
    face_by_n = 4 * (n - 1) / (n + 1) ** 3
    of_internal = -MM_PER_CM / thickness_mm / internal
    return of_internal / by_internal, -of_internal * by_face * face_by_n / by_internal


def _internal(measured: Array, n: ArrayLike) -> Array:
    """Transmittance T of the bulk behind a reading M: root of R^2 M T^2 + (1-R)^2 T - M = 0."""
    face = _face_reflectance(n)
    clear = (1 - face) ** 2
    return 2 * measured / (clear + np.sqrt(clear**2 + (2 * face * measured) ** 2))
