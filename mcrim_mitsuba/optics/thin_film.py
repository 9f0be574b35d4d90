"""A thin absorbing film on glass: what a photocathode reflects, absorbs and lets through.

The film lies between a window, from which light comes, and vacuum. It is thinner than a wavelength,
so that waves to and fro in it interfere (M. Born and E. Wolf, Principles of Optics, section 1.6.4,
and 14.4 for absorbing films). Beyond the window's critical angle nothing gets out into the vacuum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.core.errors import InputError

#: Wavelength in vacuum, nm, and n and k of the index n + ik of the bialkali photocathode KCsSb:
#: D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217, as tabulated in WCSim
#: (data/CathodeParameters_KCsCb.txt); at 420 and 540 nm the numbers that this catalogue fixes.
_KCSSB_NM = """
    380 395 410 420 425 440 455 470 485 500 515 530
    540 545 560 575 590 605 620 635 650 665 680
"""
_KCSSB_N = """
    1.92 2.18 2.38 2.57 2.61 2.70 2.87 3.00 3.00 3.00 3.09 3.26
    3.22 3.20 3.12 3.06 3.01 2.98 2.96 2.95 2.95 2.95 2.96
"""
_KCSSB_K = """
    1.69 1.69 1.71 1.57 1.53 1.50 1.44 1.34 1.11 1.06 1.05 0.86
    0.7055 0.63 0.53 0.46 0.42 0.38 0.37 0.35 0.34 0.34 0.33
"""


def cathode_index(wavelength_nm: float) -> complex:
    """Index n + ik of KCsSb, on straight lines between its wavelengths; InputError beyond."""
    wavelengths, n, k = (np.array(row.split(), float) for row in (_KCSSB_NM, _KCSSB_N, _KCSSB_K))
    if not wavelengths[0] <= wavelength_nm <= wavelengths[-1]:
        problem = f"wavelength_nm = {wavelength_nm:g}: the photocathode's index is not known there"
        raise InputError(problem, f"give {wavelengths[0]:g} to {wavelengths[-1]:g} nm")
    return complex(*(float(np.interp(wavelength_nm, wavelengths, part)) for part in (n, k)))


@dataclass(frozen=True)
class ThinFilm:
    """A film between a window and vacuum."""

    #: Of refraction, n + ik.
    index: complex
    #: Thickness over the wavelength in vacuum.
    wavelengths: float
    #: Of the window, real.
    window_index: float

    def powers(self, cosine: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Reflectance and transmittance, (2, n): s polarised in the first row, p in the second.

        At (n,) cosines of the angle of incidence in the window. What is neither reflected nor
        transmitted is absorbed.
        """
        cosine = np.asarray(cosine, dtype=float)
        # components of the wave vectors across the film, in units of the window's wave number
        film, vacuum = complex(self.index) / self.window_index, 1.0 / self.window_index
        sine2 = (1.0 - cosine) * (1.0 + cosine)
        inside, beyond = (np.sqrt(np.asarray(m**2 - sine2, dtype=complex)) for m in (film, vacuum))
        # what a wave's field becomes on its way across the film
        across = np.exp(2j * math.pi * self.wavelengths * self.window_index * inside)
        reflectances, transmittances = [], []
        # s, then p polarised
        for film_square, vacuum_square in ((1.0, 1.0), (film**2, vacuum**2)):
            # admittances of window, film and vacuum, in units of the window's index
            a, b, c = cosine, inside / film_square, beyond / vacuum_square
            # amplitudes at the two faces; at grazing incidence all is reflected
            front, back = (a - b) / (a + b), (b - c) / (b + c)
            round_trip = 1.0 + front * back * across**2
            reflected = (front + back * across**2) / round_trip
            through = (1.0 + front) * (1.0 + back) * across / round_trip
            reflectances.append(np.abs(reflected) ** 2)
            # over the cosine as a quotient that exists at grazing incidence too
            entering = np.where(a == 0.0, 0.0, c.real / np.where(a == 0.0, 1.0, a))
            transmittances.append(entering * np.abs(through) ** 2)
        return np.array(reflectances), np.array(transmittances)

    def absorptance(self, cosine: ArrayLike) -> NDArray[np.float64]:
        """Part of unpolarised light that the film absorbs, at (n,) cosines in the window."""
        reflected, transmitted = self.powers(cosine)
        return 1.0 - (reflected + transmitted).mean(axis=0)

    @property
    def head_on(self) -> float:
        """Part of the light that the film absorbs at normal incidence."""
        return float(self.absorptance(1.0))
