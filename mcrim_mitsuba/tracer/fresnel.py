"""Fresnel's formulae for plane, lossless interfaces.

Sources: M. Born and E. Wolf, Principles of Optics, 7th ed., sec. 1.5.2
(amplitudes), 1.5.3 (reflectivity) and 1.5.4 (total reflection). ``cos_in`` is
the cosine of the angle of incidence, ``n_in`` and ``n_out`` the indices before
and behind the interface. All functions take arrays that broadcast together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Amplitudes(NamedTuple):
    """Complex amplitude coefficients, (n,) complex128 each."""

    reflected_s: NDArray[np.complex128]
    reflected_p: NDArray[np.complex128]
    transmitted_s: NDArray[np.complex128]
    transmitted_p: NDArray[np.complex128]


#: One number, or one for every photon.
_Number = float | NDArray[np.float64]


def cosine_squared_out(cos_in: _Number, n_in: _Number, n_out: _Number) -> NDArray[np.float64]:
    """Squared cosine of the angle of refraction; not positive under total reflection.

    Snell's law, arranged so that equal indices give back ``cos_in`` squared
    exactly, also at grazing incidence.
    """
    ratio_squared = np.square(np.divide(n_in, n_out))
    return (1.0 - ratio_squared) + ratio_squared * np.square(cos_in)


def unpolarised_reflectance(
    cos_in: _Number, n_in: _Number, n_out: _Number, cos_out: _Number
) -> NDArray[np.float64]:
    """Mean of the s and p reflectivities: (n,) float64.

    ``cos_out`` is the cosine of the angle of refraction, 0 under total
    reflection, which makes the result 1 exactly.
    """
    cos_in, cos_out = np.asarray(cos_in), np.asarray(cos_out)
    s = (n_in * cos_in - n_out * cos_out) / (n_in * cos_in + n_out * cos_out)
    p = (n_out * cos_in - n_in * cos_out) / (n_out * cos_in + n_in * cos_out)
    return 0.5 * (s * s + p * p)


def amplitudes(cos_in: _Number, n_in: _Number, n_out: _Number) -> Amplitudes:
    """Amplitude coefficients with the phases of total reflection.

    In frames where s x (propagation direction) is p for every wave, as in Born
    and Wolf's figure 1.10. Beyond the critical angle the cosine of refraction
    is +i sqrt(sin^2/n^2 - 1), for the time dependence exp(-i omega t).
    """
    squared = cosine_squared_out(cos_in, n_in, n_out)
    cos_out: NDArray[np.complex128] = np.sqrt(squared.astype(np.complex128))
    s_in, s_out = n_in * cos_in, n_out * cos_out
    p_in, p_out = n_out * cos_in, n_in * cos_out
    return Amplitudes(
        reflected_s=(s_in - s_out) / (s_in + s_out),
        reflected_p=(p_in - p_out) / (p_in + p_out),
        transmitted_s=2.0 * s_in / (s_in + s_out),
        transmitted_p=2.0 * s_in / (p_in + p_out),
    )
