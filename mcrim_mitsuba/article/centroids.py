"""What a Gaussian's centroid means where photons are counted (Sec. 6.1)."""

from __future__ import annotations

from scipy.optimize import brentq

from mcrim_mitsuba.physics.peak import GAUSSIAN, fit_peak
from mcrim_mitsuba.physics.photon_histogram import PhotonSpectrum


def mean_of_centroid(centroid: float) -> float:
    """Mean number of photons of a band in which a Gaussian finds a centroid.

    The band's intrinsic spread, pedestal and continuum are those that `PhotonSpectrum` takes as
    usual; spreads of 5 and 15 % move the mean by 0.9 %.
    """

    def apart(mean: float) -> float:
        spectrum = PhotonSpectrum(mean)
        photons = spectrum.photons()
        peak = fit_peak(photons, spectrum.expected(photons), shape=GAUSSIAN)
        assert peak is not None  # a clear one was drawn
        return peak.centroid - centroid

    return brentq(apart, 0.97 * centroid, 1.15 * centroid, xtol=1e-4)
