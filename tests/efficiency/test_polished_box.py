"""The solver without photons, against closed forms, quadratures, photons and itself."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from places import cases_of, tables_of
from scipy.integrate import quad

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.box_openings import fresnel
from mcrim_mitsuba.efficiency.polished_box import _Modes, _nodes, _points, solve_box

cases = cases_of(__file__)
TABLES = tables_of(__file__)

GEL = Bench(n_gap=1.46)
THIN_GAP = 1e-9
#: No side light reaches the window, and the mask leaves the whole bottom free.
NARROW = {"window_width_mm": 10.0, "gap_mm": THIN_GAP, "aperture_radius_mm": 7.1}


def _fresnel(cosine: float, n_in: float, n_out: float) -> float:
    return float(fresnel(np.array(cosine), n_in, n_out))


def _bottom_by_images(n_gap: float, alpha_per_mm: float, height: float) -> float:
    """Light detected through the bottom without scattering, by its mirror images one by one."""
    n, n_window = 2.01, 1.52

    def detected(mu: float) -> float:
        sine = n * math.sqrt(1.0 - mu * mu)
        if sine >= n_gap:
            return 0.0
        first = _fresnel(mu, n, n_gap)
        second = _fresnel(math.sqrt(1.0 - (sine / n_gap) ** 2), n_gap, n_window)
        passes = (1.0 - first) * (1.0 - second) / (1.0 - first * second)
        top = _fresnel(mu, n, 1.0)
        once = math.exp(-alpha_per_mm * height / mu)
        flux = 0.5 * mu / (alpha_per_mm * height) * (1.0 - once) * (1.0 + top * once)
        images = sum(((1.0 - passes) * top * once * once) ** k for k in range(400))
        return flux * passes * images

    cuts = [math.sqrt(1.0 - (n_gap / n) ** 2), math.sqrt(1.0 - 1.0 / n**2), 1.0]
    panels = [(a, b) for a, b in itertools.pairwise(cuts) if b > a]
    return sum(quad(detected, *panel, epsrel=1e-10)[0] for panel in panels)


@pytest.mark.parametrize("n_gap", [1.0, 1.1])
@pytest.mark.parametrize("alpha_per_cm", [0.5, 5.0])
def test_bottom_without_scattering_is_the_sum_over_images(n_gap, alpha_per_cm):
    bench = Bench(n_gap=n_gap, alpha_scat_per_cm=0.0, alpha_abs_per_cm=alpha_per_cm, **NARROW)
    expected = _bottom_by_images(n_gap, alpha_per_cm / 10.0, bench.crystal_height_mm)
    assert solve_box(bench).eta == pytest.approx(expected, rel=3e-6)


def test_side_light_that_all_lands_is_a_quadrature():
    # a window without end and without mask: half of what leaves the sides falls on it
    bench = Bench(
        alpha_scat_per_cm=0.0,
        alpha_abs_per_cm=5.0,
        gap_mm=THIN_GAP,
        window_width_mm=1e8,
        aperture_radius_mm=1e8,
    )
    theta, w_theta = np.polynomial.legendre.leggauss(80)
    phi, w_phi = theta * math.pi / 2.0, w_theta * math.pi / 2.0
    theta, w_theta = (1.0 + theta) * math.pi / 4.0, w_theta * math.pi / 4.0
    theta, phi = theta[:, None], phi[None, :]
    v_x, v_y, v_z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    n, way = bench.n_crystal, 0.5 * bench.crystal_width_mm
    u_x = np.sqrt(1.0 - (v_y**2 + v_z**2) / n**2)
    mirror, once = fresnel(u_x, n, 1.0), np.exp(-way / u_x)
    falls = np.sin(theta) * v_x / n**2 / way * (1.0 - once) * (1.0 - mirror) / (1.0 - mirror * once)
    falls = falls * (1.0 - fresnel(v_z + 0.0 * phi, 1.0, bench.n_window))
    by_sides = 4.0 / (4.0 * math.pi) * w_theta @ falls @ w_phi
    by_bottom = _bottom_by_images(1.0, 0.5, 10.0)
    assert solve_box(bench).eta == pytest.approx(by_sides + by_bottom, rel=1e-5)


@pytest.mark.parametrize("bench", [Bench(), GEL, Bench(crystal_height_mm=1.0), Bench(gap_mm=1.0)])
def test_without_absorption_everything_leaves(bench):
    found = solve_box(bench, [0.05, 0.5, 3.0], 0.0)
    assert found.fates["absorbed_crystal"] == pytest.approx(0.0, abs=1e-12)
    assert sum(found.fates.values()) == pytest.approx(1.0, abs=2e-5)
    assert (found.fates["elsewhere"] > 0.2).all()


def test_fates_with_absorption_sum_to_one():
    found = solve_box(GEL, [[0.0], [0.5], [2.0]], [0.01, 0.1, 1.0])
    assert sum(found.fates.values()) == pytest.approx(1.0, abs=2e-5)


def test_a_clear_cube_in_air_traps_what_no_cone_takes():
    # paper's Eq. 6: each face takes (1 - sqrt(1 - 1/n^2)) / 2
    found = solve_box(Bench(gap_mm=THIN_GAP), 0.0, 0.0)
    assert found.fates["trapped"] == pytest.approx(
        1.0 - 3.0 * (1.0 - math.sqrt(1.0 - 2.01**-2)), abs=1e-6
    )


def test_one_mode_by_hand():
    # light that forgets its place at every collision: eta is a geometric series
    bench = Bench()
    nodes = _nodes(bench, 0.54, 0.039)[0]._replace(across=1, upwards=1, coupled=0)
    modes = _Modes.of(bench, (nodes, nodes))
    found = modes.systems(np.array([0.0579]))
    kernel, detected, left = (float(x[0, 0].item()) for x in found)
    kernel += 1.0  # of one mode: total reflection by all faces keeps everything
    by_hand = detected / (1.0 - 0.54 / 0.579 * kernel)
    assert by_hand == pytest.approx(float(solve_box(bench).eta), rel=0.02)
    assert kernel < 1.0
    assert 1.0 - kernel == pytest.approx(left, abs=1e-4)


def test_strong_scattering_lets_less_and_less_out():
    # light random-walks, and what is born deep is absorbed: eta falls, slowly
    bench = Bench(crystal_height_mm=4.0, crystal_width_mm=4.0, aperture_radius_mm=6.0)
    etas = solve_box(bench, [5.0, 10.0, 20.0], 1.0).eta
    assert (np.diff(etas) < 0.0).all()
    assert etas[2] > 0.5 * etas[0]


@cases("numbers")
def test_error_holds_against_twice_the_modes_and_nodes(numbers):
    bench = Bench(**numbers)
    coefficients = bench.alpha_scat_per_cm, bench.alpha_abs_per_cm
    few, coarser = _nodes(bench, *coefficients)
    more = few._replace(
        across=2 * few.across,
        upwards=2 * few.upwards,
        cosine=28,
        around_ends=8,
        around_sides=10,
        foot=14,
        coupled=max(few.coupled, 1),
    )
    better = _points(_Modes.of(bench, (more, coarser)), *np.array([coefficients]).T, rough=False)
    for precision in (None, 1e-3):
        found = solve_box(bench, precision=precision)
        assert abs(better[0] - found.eta) <= found.error
    assert found.error <= 1e-3 * found.eta


@pytest.mark.parametrize("bench", [Bench(), GEL])
def test_a_table_is_its_points(bench):
    scat, absorb = np.geomspace(0.02, 6.0, 9), np.array([[0.0], [0.01], [0.3], [1.0]])
    table = solve_box(bench, scat, absorb)
    for i, j in itertools.product((0, 2, 5, 8), range(4)):
        point = solve_box(bench, scat[i], absorb[j, 0])
        assert table.eta[j, i] == pytest.approx(float(point.eta), rel=1e-6)


#: What photons gave: ``mcrim simulate scenes/camoo4.xml --seed SEED``. All together: the family of
#: 26 comparisons is tested at 1e-3, by Bonferroni at abs(z) < 4.06 each.
PHOTONS = TABLES["photons"]


@pytest.mark.parametrize(("changed", "eta", "sigma", "photons", "seed"), PHOTONS)
def test_photons_agree(changed, eta, sigma, photons, seed):
    found = solve_box(Bench(**changed))
    z = (found.eta - eta) / math.hypot(sigma, found.error)
    assert abs(z) < 4.06, f"z = {z:.2f} against {photons:g} photons of seed {seed}"


@cases("changed", "name")
def test_what_it_does_not_know_is_refused_in_a_line(changed, name):
    with pytest.raises(InputError, match=name) as refused:
        solve_box(Bench.from_parameters(changed))
    assert "\n" not in str(refused.value)
    assert "simulate photons" in str(refused.value)


def test_coefficients_are_refused():
    with pytest.raises(InputError, match="alpha_abs_per_cm"):
        solve_box(Bench(), 0.5, [-0.1])


def test_window_absorption_and_angles_of_the_detector_only_take_light_away():
    plain, tinted = solve_box(GEL), solve_box(replace(GEL, window_absorption_per_cm=1.0))
    # at least 1 mm, at most the way of light at the critical angle of air
    ratio = float(tinted.eta / plain.eta)
    assert 0.7 < ratio < math.exp(-0.1)
    worse, better = (solve_box(replace(GEL, angular_falloff=a)) for a in (0.5, -0.5))
    assert worse.eta < plain.eta
    # relative to light head-on it is linear, and what is detected less than that
    assert worse.eta + better.eta == pytest.approx(2 * plain.eta, rel=1e-9)
    assert better.fates["detected"] == pytest.approx(better.eta / 1.5)
    assert better.fates["elsewhere"] > plain.fates["elsewhere"]
