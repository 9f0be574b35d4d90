"""One photon meets one interface: reflected or refracted, with or without polarisation.

The polarisation state of a photon is its complex electric field, a unit vector
in space perpendicular to the direction of flight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.tracer.directions import basis
from mcrim_mitsuba.tracer.fresnel import amplitudes, cosine_squared_out, unpolarised_reflectance
from mcrim_mitsuba.tracer.geometry import dot

_NORMAL_INCIDENCE_SINE = 1e-8
"""Below this sine of the angle of incidence any plane of incidence will do: s and p
differ by its square."""


def cross(
    rng: np.random.Generator,
    direction: NDArray[np.float64],
    normal: NDArray[np.float64],
    n_in: float,
    n_out: NDArray[np.float64],
    field: NDArray[np.complex128] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.complex128] | None]:
    """Send photons through an interface, each as one whole quantum.

    Parameters
    ----------
    rng : numpy.random.Generator
    direction : (3, n) float64
        Unit vectors of flight.
    normal : (3, n) float64
        Unit normals that point ahead: ``direction . normal`` is positive.
    n_in : float
        Index of the medium that the photons are in.
    n_out : (n,) float64
        Index of the medium behind the interface.
    field : (3, n) complex128, optional
        Polarisation states; without them the photons are taken as unpolarised.

    Returns
    -------
    direction : (3, n) float64
    transmitted : (n,) bool
    field : (3, n) complex128 or None
    """
    cos_in = dot(direction, normal)
    cos_out = np.sqrt(np.maximum(cosine_squared_out(cos_in, n_in, n_out), 0.0))
    if field is None:
        reflectance = unpolarised_reflectance(cos_in, n_in, n_out, cos_out)
    else:
        s = _across_incidence(direction, normal)
        field_s, field_p = dot(field, s), dot(field, _cross_product(s, direction))
        coefficients = amplitudes(cos_in, n_in, n_out)
        reflected_s = coefficients.reflected_s * field_s
        reflected_p = coefficients.reflected_p * field_p
        reflectance = _square(reflected_s) + _square(reflected_p)
    # the second condition is for rounding: |r| of a total reflection may be 1 - 1e-16
    transmitted = (rng.random(cos_in.shape) >= reflectance) & (cos_out > 0.0)

    outgoing = direction - (2.0 * cos_in) * normal
    through = np.flatnonzero(transmitted)
    if through.size:
        ahead = normal[:, through]
        tangential = direction[:, through] - cos_in[through] * ahead
        refracted = (n_in / n_out[through]) * tangential + cos_out[through] * ahead
        outgoing[:, through] = refracted / np.sqrt(dot(refracted, refracted))
    if field is None:
        return outgoing, transmitted, None

    out_s = np.where(transmitted, coefficients.transmitted_s * field_s, reflected_s)
    out_p = np.where(transmitted, coefficients.transmitted_p * field_p, reflected_p)
    out = out_s * s + out_p * _cross_product(s, outgoing)
    return outgoing, transmitted, out / np.sqrt(_square(out_s) + _square(out_p))


def random_polarisation(
    rng: np.random.Generator, direction: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Fields of unpolarised light: linear at a random angle, (3, n) complex128.

    Every mixture of pure states with the same mean density matrix gives the
    same detection statistics, so circular and elliptic states need no share.

    Parameters
    ----------
    rng : numpy.random.Generator
    direction : (3, n) float64
        Unit vectors of flight.
    """
    u, v = basis(direction)
    angle = 2.0 * np.pi * rng.random(direction.shape[1])
    return (np.cos(angle) * u + np.sin(angle) * v).astype(np.complex128)


def _across_incidence(
    direction: NDArray[np.float64], normal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Unit vectors perpendicular to the planes of incidence and to the directions: (3, n)."""
    s = _cross_product(direction, normal)
    length = np.sqrt(dot(s, s))
    undefined = np.flatnonzero(length < _NORMAL_INCIDENCE_SINE)
    if undefined.size:
        s[:, undefined] = basis(direction[:, undefined])[0]
        length[undefined] = 1.0
    return s / length


def _cross_product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    # numpy.cross is several times slower on (3, n) arrays
    return np.stack(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


def _square(z: NDArray[np.complex128]) -> NDArray[np.float64]:
    return z.real * z.real + z.imag * z.imag
