"""Whether the scattering that a fit finds agrees with the transmittance that was measured."""

from __future__ import annotations

import math

from mcrim_mitsuba.laboratory.raw_data import RawData
from mcrim_mitsuba.units import MM_PER_CM

# In standard errors of the transmittance: it shows clearly less scattering than was fitted.
_CLEARLY = 3.0


def beam_notes(raw: RawData, alpha_scat_per_cm: float) -> list[str]:
    """A sentence where isotropic scattering would weaken a spectrophotometer's beam, but does not.

    The beam loses what is scattered out of it, exp(-alpha_scat d), besides what is absorbed.

    Parameters
    ----------
    raw : RawData
    alpha_scat_per_cm : float
        As fitted.
    """
    if raw.absorption is None:
        return []
    found, path_mm = raw.absorption.found, raw.absorption.entry.thickness_mm
    left = math.exp(-alpha_scat_per_cm * path_mm / MM_PER_CM)
    through, sigma = found.internal_transmittance, found.internal_transmittance_sigma
    if through - left < _CLEARLY * sigma:
        return []
    return [
        f"isotropic scattering of {alpha_scat_per_cm:.2g} /cm takes {100 * (1 - left):.0f} % out "
        f"of a beam through {path_mm:g} mm, yet {100 * through:.1f} % of it arrived where the "
        "transmittance was measured: the spectrophotometer collects scattered light, or scattering "
        "is forward (effect anisotropic_scattering), or something else redirects light, such as "
        "the surfaces"
    ]
