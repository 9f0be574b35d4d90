"""Light of many wavelengths that scatters by a power of them."""

from __future__ import annotations

import math

import numpy as np

from mcrim_mitsuba.core.descent import Array

#: Where a Gaussian band is cut off on both sides, in full widths at half maximum.
CUT_WIDTHS = 1.5
#: Full width at half maximum over the standard deviation.
FWHM = 2.0 * math.sqrt(2.0 * math.log(2.0))
#: Light that nothing else is said of, nm: the maximum of the band and its full width at half
#: maximum; those of CaMoO4 (V. Alenkov et al., JINST 8 (2013) P06002, section 4).
USUAL_NM, USUAL_WIDTH_NM = 540.0, 150.0
_POINTS = 12


def scattering_of_colours(
    exponent: float, wavelength_nm: float, bandwidth_nm: float
) -> tuple[Array, Array]:
    """Parts of the light of a Gaussian band, and scattering over that at its maximum.

    alpha_scat goes as wavelength to the power of -exponent; the band is cut off at `CUT_WIDTHS`.
    By Gauss and Legendre: means of what is smooth over the band are right to 1e-5.

    Returns
    -------
    parts, factors : (points,) float64
        Parts sum to 1.
    """
    x, weights = np.polynomial.legendre.leggauss(_POINTS)
    z = CUT_WIDTHS * FWHM * x
    parts = weights * np.exp(-0.5 * z**2)
    relative = 1.0 + z / FWHM * bandwidth_nm / wavelength_nm
    return parts / parts.sum(), relative**-exponent
