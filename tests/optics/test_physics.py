"""Closed-form optics and the article's arithmetic, against results obtained another way."""

import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.laboratory.light_yield import light_yield_ph_per_keV
from mcrim_mitsuba.optics.attenuation import (
    absorption_coefficient,
    internal_transmittance,
    measured_transmittance,
    transmittance,
)
from mcrim_mitsuba.optics.fresnel import amplitudes, escape_fraction, reflectance, trapped_fraction

cases = cases_of(__file__)


def test_fresnel_normal_brewster_and_equal_indices():
    assert reflectance(1.0, 1.0, 1.5) == pytest.approx(0.04)
    r_s, r_p = amplitudes(np.cos(np.arctan(1.5)), 1.0, 1.5)
    assert abs(r_p) < 1e-15
    assert r_s.real == pytest.approx((1 - 1.5**2) / (1 + 1.5**2))
    assert np.all(reflectance(np.linspace(0, 1, 5), 2.01, 2.01) == 0)


def test_fresnel_is_the_same_from_both_sides():
    # reciprocity: the refracted ray sent back meets the same reflectance
    cos_i = np.linspace(0.05, 1, 20)
    cos_t = np.sqrt(1 - (1.0 / 2.01) ** 2 * (1 - cos_i**2))
    np.testing.assert_allclose(reflectance(cos_i, 1.0, 2.01), reflectance(cos_t, 2.01, 1.0))


def test_total_internal_reflection_is_whole_and_has_the_textbook_phase():
    angle = np.radians([35.0, 50.0, 80.0])  # beyond the critical 29.8 degrees of n = 2.01
    assert np.all(reflectance(np.cos(angle), 2.01, 1.0) == 1)
    r_s, r_p = amplitudes(np.cos(angle), 2.01, 1.0)
    # Born & Wolf 1.5.4, eq. (60), fields as exp(-i omega t): r = exp(i delta)
    n = 1.0 / 2.01
    root = np.sqrt(np.sin(angle) ** 2 - n**2)
    np.testing.assert_allclose(np.tan(np.angle(r_s) / 2), -root / np.cos(angle))
    np.testing.assert_allclose(np.tan(np.angle(r_p) / 2), -root / (n**2 * np.cos(angle)))


def test_escape_and_trapping_of_the_bare_cube():
    assert escape_fraction(2.01) == pytest.approx(0.066, abs=5e-4)
    assert escape_fraction(2.01 / 1.46) == pytest.approx(0.156, abs=5e-4)
    assert trapped_fraction(2.01) == pytest.approx(0.602, abs=5e-4)
    # the same by counting directions outside all three escape cones
    directions = np.random.default_rng(1).normal(size=(200_000, 3))
    cosines = np.abs(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    trapped = np.mean(np.all(cosines < np.sqrt(1 - 1 / 1.5**2), axis=1))
    assert trapped_fraction(1.5) == pytest.approx(trapped, abs=5 * 0.5 / np.sqrt(200_000))
    assert trapped_fraction(np.sqrt(2)) == pytest.approx(1 - 3 * (1 - np.sqrt(0.5)))


def test_multiple_reflection_is_the_sum_of_its_orders_and_inverts():
    internal, face = 0.7, (1.01 / 3.01) ** 2
    orders = sum((1 - face) ** 2 * internal * (face * internal) ** (2 * k) for k in range(40))
    assert measured_transmittance(internal, 2.01) == pytest.approx(orders)
    for t in (1e-6, 0.3, 1.0):
        for n in (1.0, 1.5, 2.01):
            assert internal_transmittance(measured_transmittance(t, n), n) == pytest.approx(t)


@cases("value", "sigma", "text", more=[
    (0.252, None, "0.252"),
])  # fmt: skip
def test_pdg_rounding(value, sigma, text):
    assert pdg(value, sigma) == text


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: escape_fraction(0.9), "0.9 is below 1"),
        (lambda: trapped_fraction(1.4), "below sqrt(2)"),
        (lambda: reflectance(1.2, 1.0, 1.5), "outside 0..1"),
        (lambda: internal_transmittance(0.85, 2.01), "0.7976"),
        (lambda: internal_transmittance(76, 2.01), "0.76 for 76 %"),
        (lambda: absorption_coefficient(0.0, 10), "0.96 for 96 %"),
        (lambda: transmittance(-1, 10), "negative"),
        (lambda: light_yield_ph_per_keV(14.3, 0.25, 0.0, 59.5), "detector efficiency is 0"),
    ],
)
def test_impossible_values_are_refused(call, says):
    assert says in refusal(call)
