"""A beam through the crystal: the spectrophotometer's scene, fine roughness, faces of their own."""

import math

import numpy as np
import pytest
from places import SCENES, cases_of
from refusals import refusal
from scipy.special import ndtri

from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.optics.slab_transmittance import measured_transmittance, transmittance
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.spectrophotometer import (
    polished_slab,
    scattered_share,
    spectrophotometer_of,
)
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

BEAM = SCENES / "spectrophotometer.xml"
PAIRS = [(s, a) for s in (0.0, 0.02, 0.1, 0.5) for a in (0.005, 0.05, 0.2)]


def transmitted(scene, photons, **overrides):
    found = Simulation(scene, overrides, check=False).collect(photons)
    return found.eta, found.eta_sigma


def test_the_polished_crystal_follows_the_closed_form():
    """12 pairs of coefficients at two indices, to 0.1 %; family-wise false alarms 1 %."""
    z = []
    for n in (1.82, 2.01):
        for scat, absorption in PAIRS:
            exact = float(measured_transmittance(transmittance(scat + absorption, 10.0), n))
            photons = int((1.0 / exact - 1.0) / 0.9e-3**2)
            found, sigma = transmitted(
                BEAM,
                photons,
                n_crystal=n,
                alpha_scat_per_cm=scat,
                alpha_abs_per_cm=absorption,
                acceptance_deg=0.5,
            )
            assert sigma < 1.05e-3 * found
            z.append((found - exact) / sigma)
    assert np.abs(z).max() < -ndtri(0.005 / len(z))


def test_the_beam_of_a_bench_is_the_scene_that_is_shipped():
    values = {"alpha_scat_per_cm": 0.3, "alpha_abs_per_cm": 0.02, "acceptance_deg": 30.0}
    derived = spectrophotometer_of(read_scene(SCENES / "camoo4.xml"))
    assert transmitted(derived, 2**17, **values) == transmitted(BEAM, 2**17, **values)


@pytest.mark.parametrize("axis", ["y", "z"])
def test_a_cube_is_the_same_along_all_axes(axis):
    along, sigma = transmitted(BEAM, 2**18, beam_axis=axis)
    assert abs(along - transmitted(BEAM, 2**18)[0]) < 4.0 * math.sqrt(2.0) * sigma


def test_effects_of_the_bench_alone_leave_the_beam_as_it_is():
    bench = read_scene(SCENES / "camoo4.xml")
    plain = spectrophotometer_of(bench).content_hash
    seen = {
        name: spectrophotometer_of(bench.edited(add(name, bench))).content_hash != plain
        for name in (
            "detector_angle top_reflector source_depth gap_thickness surface_haze "
            "side_roughness scattering_gradient crystal_index"
        ).split()
    }
    assert [
        name for name, is_seen in seen.items() if is_seen
    ] == "surface_haze side_roughness scattering_gradient crystal_index".split()


def test_what_the_liquid_does_is_not_seen_by_the_beam():
    """Faces that a bubble or a collar parts are whole in it: the same photons."""
    bench = read_scene(SCENES / "camoo4.xml")
    plain = transmitted(spectrophotometer_of(bench), 2**16)
    for name in ("gap_bubble", "gap_bubble_round", "gel_creep"):
        derived = spectrophotometer_of(bench.edited(add(name, bench)))
        assert transmitted(derived, 2**16) == plain, name


@pytest.mark.parametrize("name", ["side_roughness", "bottom_roughness", "surface_haze"])
def test_an_effect_on_the_crystal_can_be_added_to_the_beam_itself(name):
    bench, beam = read_scene(SCENES / "camoo4.xml"), read_scene(BEAM)
    added = transmitted(beam.edited(add(name, beam)), 2**16, acceptance_deg=30.0, beam_axis="z")
    derived = spectrophotometer_of(bench.edited(add(name, bench)))
    values = {"alpha_scat_per_cm": 0.03, "alpha_abs_per_cm": 0.02}
    assert added == transmitted(derived, 2**16, acceptance_deg=30.0, beam_axis="z", **values)


def test_effects_of_the_bench_cannot_be_added_to_the_beam():
    beam = read_scene(BEAM)
    for name in ("top_reflector", "edge_chamfer", "gap_bubble"):
        assert "the scene has no parameter" in refusal(lambda name=name: add(name, beam))


def test_a_hazy_beam_keeps_its_specular_part():
    """What is left is exp(-q^2) at both faces, and exp(-q'^2) for every reflection inside."""
    bench = read_scene(SCENES / "camoo4.xml")
    scene = spectrophotometer_of(bench.edited(add("surface_haze", bench)))
    n, s = 2.01, 25.0 / 540.0
    r = ((n - 1.0) / (n + 1.0)) ** 2
    through = (1.0 - r) * math.exp(-((2.0 * math.pi * s * (n - 1.0)) ** 2))
    back = r * math.exp(-((4.0 * math.pi * s * n) ** 2))
    inside = math.exp(-0.02)
    exact = through**2 * inside / (1.0 - (back * inside) ** 2)
    found, sigma = transmitted(
        scene,
        2**20,
        rms_roughness_nm=25.0,
        alpha_scat_per_cm=0.0,
        alpha_abs_per_cm=0.02,
        acceptance_deg=0.2,
    )
    assert abs(found - exact) < 3.5 * sigma < 0.005


def test_where_the_closed_form_holds_and_how_well():
    n, _ = polished_slab(read_scene(BEAM))
    assert scattered_share(n, 5.0) == pytest.approx(4.7e-4, rel=0.01)
    assert scattered_share(n, 90.0) == pytest.approx(0.0662, rel=0.01)
    bench = read_scene(SCENES / "camoo4.xml")
    for name in ("surface_roughness", "anisotropic_scattering", "edge_chamfer"):
        edited = spectrophotometer_of(bench.edited(add(name, bench)))
        assert polished_slab(edited) is None


@cases("overrides", "words")
def test_what_no_spectrophotometer_is(overrides, words):
    assert words in refusal(lambda: Simulation(BEAM, overrides))
