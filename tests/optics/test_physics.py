"""Closed-form optics and the article's arithmetic, against results obtained another way."""

import numpy as np
import pytest
from refusals import refusal

from mcrim_mitsuba.laboratory.light_yield import light_yield_ph_per_keV
from mcrim_mitsuba.optics.fresnel import amplitudes, escape_fraction, reflectance, trapped_fraction
from mcrim_mitsuba.optics.slab_transmittance import (
    absorption_coefficient,
    internal_transmittance,
    measured_transmittance,
    transmittance,
)
from mcrim_mitsuba.optics.thin_film import ThinFilm, cathode_index

#: A/A(0), and R of it at 540 nm, of the photocathode in the catalogue's definitions.
ANGLES_DEG = [0.0, 38.0, 45.0, 50.0, 60.0, 75.0]
ABSORBED = {
    540.0: [1.0, 0.983, 1.381, 1.646, 1.909, 1.816],
    420.0: [1.0, 0.992, 1.293, 1.453, 1.496, 1.214],
}
REFLECTED_540 = [0.163, 0.189, 0.505, 0.410, 0.316, 0.349]


def photocathode(wavelength_nm, index=None, thickness_nm=15.5, window=1.52):
    index = cathode_index(wavelength_nm) if index is None else index
    return ThinFilm(index, thickness_nm / wavelength_nm, window)


@pytest.mark.parametrize("wavelength_nm", ABSORBED)
def test_the_photocathode_of_the_definitions(wavelength_nm):
    film, cosine = photocathode(wavelength_nm), np.cos(np.radians(ANGLES_DEG))
    relative = film.absorptance(cosine) / film.head_on
    assert relative == pytest.approx(ABSORBED[wavelength_nm], abs=5.5e-4)
    if wavelength_nm == 540.0:
        assert film.powers(cosine)[0].mean(axis=0) == pytest.approx(REFLECTED_540, abs=5.1e-4)
        given = photocathode(540.0, 3.22 + 0.706j)
        assert given.absorptance(cosine) == pytest.approx(film.absorptance(cosine), abs=3e-4)
    assert photocathode(420.0).index == 2.57 + 1.57j


def test_a_film_obeys_what_holds_for_all_films():
    cosine = np.linspace(0.0, 1.0, 201)
    film = photocathode(540.0)
    reflected, transmitted = film.powers(cosine)
    # both polarisations are alike head-on, all is reflected at grazing incidence
    assert reflected[0, -1] == pytest.approx(reflected[1, -1])
    assert reflected[:, 0] == pytest.approx([1.0, 1.0])
    beyond = cosine < np.sqrt(1 - 1 / 1.52**2)
    assert not transmitted[:, beyond].any() and (transmitted[:, ~beyond] > 0).all()
    assert (reflected + transmitted <= 1 + 1e-12).all()
    # a film of glass, of vacuum or of no thickness is the bare face
    cosine = cosine[1:]
    bare = np.abs(np.array(amplitudes(cosine, 1.52, 1.0))) ** 2
    for other in (
        photocathode(540.0, 1.52),
        photocathode(540.0, 1.0),
        photocathode(540.0, thickness_nm=0.0),
    ):
        reflected, transmitted = other.powers(cosine)
        assert reflected == pytest.approx(bare, abs=1e-12)
        assert reflected + transmitted == pytest.approx(np.ones_like(bare), abs=1e-12)
    # a thick one is its front face, of an absorbing medium
    thick = photocathode(540.0, 3.22 + 0.706j, thickness_nm=1e4)
    assert thick.powers(1.0)[0] == pytest.approx(
        abs((1.52 - thick.index) / (1.52 + thick.index)) ** 2
    )
    # a clear film reflects as the Airy sum of its two faces says
    clear = photocathode(540.0, 2.0, thickness_nm=80.0)
    front, back = (1.52 - 2.0) / 3.52, 1.0 / 3.0
    phase = np.exp(4j * np.pi * 2.0 * 80.0 / 540.0)
    expected = abs((front + back * phase) / (1 + front * back * phase)) ** 2
    assert clear.powers(1.0)[0] == pytest.approx([expected, expected])


def test_the_photocathodes_index_is_known_where_it_was_measured():
    assert cathode_index(530.0) == 3.26 + 0.86j
    assert "wavelength_nm = 700: the photocathode's index is not known" in refusal(
        cathode_index, 700.0
    )


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
