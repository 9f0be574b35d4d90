"""A peak's width by its origins, of synthetic histograms with known ones.

Random tests have fixed seeds; a right program fails one in a thousand runs.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mcrim_mitsuba.core.numbers import FWHM
from mcrim_mitsuba.laboratory.peak import fit_peak
from mcrim_mitsuba.laboratory.peak_band import width_parts
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum

#: chi2 of ten below and above it in one run in 1,000 each.
CHI2_OF_TEN = 1.48, 29.6
PLACE, REST, PHOTONS = 0.06, 0.08, 40.0


def peaks():
    band = PhotonSpectrum(PHOTONS, 20_000, intrinsic_spread=math.hypot(PLACE, REST))
    for seed in range(10):
        found = fit_peak(band.photons().astype(float), band.sample(seed).astype(float))
        assert found is not None
        yield found


def test_the_rest_is_what_was_put_in():
    parts = [width_parts(peak, "everywhere", PLACE, 0.001) for peak in peaks()]
    z = np.array([(one.rest.fwhm - FWHM * REST) / one.rest.sigma for one in parts])
    assert CHI2_OF_TEN[0] < (z**2).sum() < CHI2_OF_TEN[1], z
    for one in parts:
        squares = [each.fwhm**2 for each in (one.counting, one.place, one.rest)]
        assert_allclose(sum(squares), one.total.fwhm**2)
        assert one.counting.fwhm == pytest.approx(FWHM / math.sqrt(PHOTONS), rel=0.02)
        assert one.excess == 0.0


def test_places_that_would_make_it_wider_leave_nothing_and_say_so():
    one = width_parts(next(peaks()), "everywhere", 0.2, 0.001)
    assert one.rest.fwhm == 0.0 < one.rest.sigma and one.excess > 3.0
