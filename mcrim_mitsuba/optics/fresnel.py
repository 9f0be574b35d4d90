"""Fresnel reflection at a plane interface, and what it lets out of a bare cube.

Angles are measured from the normal inside the medium that the light comes from.
All functions take scalars or arrays that broadcast against each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError


def amplitudes(
    cos_i: ArrayLike, n_from: ArrayLike, n_to: ArrayLike
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Complex amplitude reflection coefficients ``(r_s, r_p)``.

    Born & Wolf, Principles of Optics, section 1.5.2. Fields go as
    exp(-i omega t), so in total internal reflection ``cos_t = +i |cos_t|`` (a wave
    that decays away from the interface); at normal incidence r_p = -r_s.

    Raises InputError if a cosine is outside [0, 1] or an index is not above 0.

    Parameters
    ----------
    cos_i : float or array
        Cosine of the angle of incidence, in [0, 1].
    n_from, n_to : float or array
        Real refractive indices before and behind the interface, above 0.

    Returns
    -------
    r_s, r_p : complex or array of complex
        Ratio of reflected to incident electric field, s and p polarisation;
        both of modulus 1 in total internal reflection.
    """
    cos_i, n_from, n_to = (np.asarray(x, dtype=float) for x in (cos_i, n_from, n_to))
    if not np.all((cos_i >= 0) & (cos_i <= 1)):
        raise InputError("a cosine of incidence is outside 0..1", "count it from the normal")
    if not (np.all(n_from > 0) and np.all(n_to > 0)):
        raise InputError("a refractive index is not above 0", "vacuum is 1, glass about 1.5")
    cos_t = np.sqrt((1 - _sin2_t(cos_i, n_from, n_to)).astype(complex))
    return _ratio(n_from * cos_i, n_to * cos_t), _ratio(n_to * cos_i, n_from * cos_t)


def _sin2_t(cos_i: NDArray, n_from: NDArray, n_to: NDArray) -> Array:
    """Snell's law: squared sine of the angle of refraction, above 1 in total reflection."""
    # (1 - c)(1 + c) keeps the digits of sin^2 near normal incidence
    return (n_from / n_to) ** 2 * (1 - cos_i) * (1 + cos_i)


def _ratio(a: NDArray, b: NDArray) -> NDArray[np.complex128]:
    """(a - b) / (a + b), and 0 where both vanish: equal indices at grazing incidence."""
    total = a + b
    return (a - b) / np.where(total == 0, 1, total)


def reflectance(cos_i: ArrayLike, n_from: ArrayLike, n_to: ArrayLike) -> Array:
    """Power reflectance of unpolarised light, ``(|r_s|^2 + |r_p|^2)/2``.

    It is exactly 1 in total internal reflection.

    Raises InputError if a cosine is outside [0, 1] or an index is not above 0.
    """
    r_s, r_p = amplitudes(cos_i, n_from, n_to)
    mean = (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2
    cos_i, n_from, n_to = (np.asarray(x, dtype=float) for x in (cos_i, n_from, n_to))
    # exactly 1, which |r|^2 misses by a rounding error
    return np.where(_sin2_t(cos_i, n_from, n_to) > 1, 1.0, mean)[()]


def escape_fraction(n: ArrayLike) -> Array:
    """Fraction of isotropic light that leaves a bare polished box by one face.

    Eq. 6 of Alenkov et al. (JINST 8 P06002), after Keil: (1 - sqrt(1 - 1/n^2))/2,
    without bulk scattering or absorption. Fresnel reflection does not enter: what is
    reflected inside the escape cone leaves by this face or the opposite one. All six faces
    together let six times this out only where `trapped_fraction` is valid.

    Raises InputError if n, relative to the surroundings, is below 1: there is no escape cone then.
    """
    n = np.asarray(n, dtype=float)
    if not np.all(n >= 1):
        problem = f"the relative index {np.min(n):g} is below 1"
        raise InputError(problem, "divide the index of the crystal by that of the medium around it")
    return ((1 - np.sqrt(1 - 1 / n**2)) / 2)[()]


def trapped_fraction(n: ArrayLike) -> Array:
    """Fraction of isotropic light that a bare polished box never lets out.

    1 - 6 `escape_fraction` = 1 - 3 (1 - sqrt(1 - 1/n^2)). Specular reflection keeps the
    three direction cosines' sizes, so light outside all escape cones stays for ever. Valid
    where the cones about the three axes do not overlap: critical angle at most 45
    degrees, n >= sqrt(2), relative to the one medium that surrounds all six faces.

    Raises InputError if n is below sqrt(2).
    """
    # a hair of tolerance: sqrt(2) itself is valid and is not exact in floating point
    if not np.all(np.asarray(n) >= np.sqrt(2) * (1 - 1e-12)):
        mend = (
            "the escape cones overlap there and the trapped light has no closed form: simulate it"
        )
        raise InputError(f"the relative index {np.min(n):g} is below sqrt(2) = 1.414", mend)
    return 1 - 6 * escape_fraction(n)
