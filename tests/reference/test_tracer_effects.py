"""The NumPy tracer's effects against closed forms and against each other.

Seeds are fixed, so a test passes or fails for good. Statistical tests ask for
|z| < 4.5, which a correct tracer exceeds with probability 7e-6; the
file makes about 220 such comparisons, so 1.5e-3 is the chance that a new seed
makes a correct tracer fail.
"""

import dataclasses
import math

import numpy as np
import pytest
from comparisons import assert_compatible, assert_same_eta
from places import cases_of, tables_of
from scipy import special

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.bench import CATHODE_WAVELENGTHS_NM, Bench
from mcrim_mitsuba.optics.thin_film import ThinFilm, cathode_index
from mcrim_mitsuba.reference.flight import (
    Flights,
    PhotonArrays,
    birth_positions,
    henyey_greenstein_cosine,
    rayleigh_cosine,
)
from mcrim_mitsuba.reference.geometry import BOTTOM, TOP, Layout, Medium, Place, box, dot
from mcrim_mitsuba.reference.interface import (
    about,
    cross_rough,
    isotropic,
    random_polarisation,
    unpolarised_reflectance,
    visible_normals,
)
from mcrim_mitsuba.reference.interface import cathode_index as own_cathode_index
from mcrim_mitsuba.reference.tracer import trace

cases = cases_of(__file__)
TABLES = tables_of(__file__)

CLEAR = {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.0}
MATCHED = {"n_crystal": 1.0, "n_gap": 1.0, "n_window": 1.0}
GEL = {"n_gap": 1.46}
OPEN_MASK = {"aperture_radius_mm": 20.0}


def assert_mean(sample, expected, what=""):
    assert_compatible(np.mean(sample), np.std(sample) / math.sqrt(len(sample)), expected, what=what)


def assert_weighted_eta(plain, weight, direct, what=""):
    """Detected photons of one run, weighted, give the efficiency of another one."""
    eta = weight.sum() / plain.photons
    sigma = math.sqrt((np.sum(weight**2) / plain.photons - eta**2) / plain.photons)
    assert_compatible(eta, sigma, direct.eta, direct.eta_sigma, what)


# ---------------------------------------------------------------- the bulk


@pytest.mark.parametrize("g", [-0.5, 0.3, 0.95])
def test_henyey_greenstein_moments(g):
    cosine = henyey_greenstein_cosine(np.random.default_rng(1), 200_000, g)
    assert np.abs(cosine).max() <= 1.0
    assert_mean(cosine, g)
    assert_mean(cosine**2, (1 + 2 * g * g) / 3)  # its Legendre moments are g^l


def test_rayleigh_moments():
    cosine = rayleigh_cosine(np.random.default_rng(2), 200_000)
    assert np.abs(cosine).max() <= 1.0
    assert_mean(cosine, 0.0)
    assert_mean(cosine**2, 2 / 5)
    assert_mean(cosine**4, 3 / 8 * (2 / 5 + 2 / 7))


def test_directions_about_an_axis_have_the_angle_and_any_azimuth():
    rng = np.random.default_rng(3)
    axis, cosine = isotropic(rng, 50_000), rng.uniform(-1, 1, 50_000)
    direction = about(rng, axis, cosine)
    np.testing.assert_allclose(dot(direction, axis), cosine, atol=1e-12)
    np.testing.assert_allclose(dot(direction, direction), 1.0, rtol=1e-14)
    across = direction - cosine * axis
    for component in across:
        assert_mean(component, 0.0)


@pytest.mark.parametrize(
    ("effect", "mean_square"),
    [
        ({}, 1 / 3),
        ({"scattering_g": 0.6}, (1 + 2 * 0.36) / 3),
        ({"rayleigh_scattering": True}, 2 / 5),
    ],
)
def test_the_crystal_scatters_by_its_phase_function_and_depolarises(effect, mean_square):
    bench = Bench(
        alpha_scat_per_cm=1e5, alpha_abs_per_cm=0, polarization=True, **effect, crystal_width_mm=9
    )
    flights = Flights(bench, np.random.default_rng(4), records=True)
    photons = flights.births(50_000)
    before, state = photons.direction.copy(), photons.field.copy()
    flights.fly(Place.CRYSTAL, photons)
    scattered = photons.record[0] == 1
    assert scattered.mean() > 0.99
    assert_mean(dot(before, photons.direction)[scattered] ** 2, mean_square)
    np.testing.assert_allclose(np.abs(dot(photons.field, photons.direction)), 0.0, atol=1e-12)
    # the new state is about the new direction at random: over a frame of it, half
    s = np.cross(before.T, photons.direction.T).T
    s /= np.sqrt(dot(s, s))
    assert_mean(np.abs(dot(photons.field, s))[scattered] ** 2, 0.5)
    assert not np.allclose(state, photons.field)


def test_gradient_weighs_free_paths_and_the_choice_of_scattering():
    rng = np.random.default_rng(5)
    medium = Medium(2.0, 0.01, 0.3, gradient=-0.8, height_mm=10.0)
    count = 100_000
    position, direction = 10.0 * rng.random((3, count)), isotropic(rng, count)
    path = medium.free_path(rng, position, direction)
    height = position[2] + path * direction[2]
    # the optical depth, from the mean of a linear function over the path, is exponential
    middle = 1 - 0.8 * ((position[2] + height) / 10.0 - 1)
    inside = (height > 0) & (height < 10)
    depth = path * (0.01 + 0.3 * middle)
    np.testing.assert_allclose(
        medium.scattering_path(position, direction, path)[inside], (path * middle)[inside]
    )
    far = np.where(direction[2] > 0, (10 - position[2]), -position[2]) / direction[2]
    limit = 0.01 * far + 0.3 * medium.scattering_path(position, direction, far)
    assert np.array_equal(path < far, inside)
    # E[min(depth, limit)] = 1 - exp(-limit)
    assert_mean(np.where(inside, depth, limit) - 1 + np.exp(-limit), 0.0)
    assert_mean(inside - (1 - np.exp(-limit)), 0.0)
    at_top = np.full((3, count), 10.0)
    assert_mean(medium.scatters(rng, at_top), 0.3 * 0.2 / (0.01 + 0.3 * 0.2))
    nothing = Medium(2.0, 0.0, 0.3, gradient=-1.0, height_mm=10.0)
    up = np.repeat([[0.6], [0.0], [0.8]], count, axis=1)
    assert np.isinf(nothing.free_path(rng, at_top, up)).all()


@pytest.mark.parametrize("gap", [{}, GEL])
def test_histories_predict_other_scattering_with_a_gradient(gap):
    bench = Bench(**gap, scattering_gradient=0.9)
    near = trace(bench, 60_000, 6, histories=True)
    seen = near.histories
    assert np.abs(seen.scattering_path_cm - seen.path_cm).max() > 0.1
    weight = (0.4 / 0.54) ** seen.scatterings * np.exp(-(0.4 - 0.54) * seen.scattering_path_cm)
    weight *= np.exp(-(0.1 - 0.039) * seen.path_cm)
    assert weight.shape == (near.counts["detected"],)
    moved = trace(
        dataclasses.replace(bench, alpha_scat_per_cm=0.4, alpha_abs_per_cm=0.1), 60_000, 7
    )
    assert_weighted_eta(near, weight, moved)
    assert moved.histories is None
    plain = trace(Bench(), 1_000, 8, histories=True).histories
    assert np.array_equal(plain.path_cm, plain.scattering_path_cm)


@pytest.mark.parametrize("depth", [0.2, 3.0, 100.0, 1e9, math.inf])
@pytest.mark.parametrize("name", ["source_depth_mm", "side_depth_mm"])
def test_births_near_the_top_or_a_side(name, depth):
    bench = Bench(crystal_width_mm=10.0, **{name: depth})
    x, y, z = birth_positions(bench, None, np.random.default_rng(9), 100_000)
    assert z.min() >= 0 and z.max() <= 10 and np.abs([x, y]).max() <= 5
    z, evenly = (z, x) if name == "source_depth_mm" else (5 - x, 5 + z - 10)
    assert_mean(evenly, 0.0)
    # mean of the exponential cut off at the crystal's height
    expected = 5.0 if depth > 1e6 else depth - 10 / math.expm1(10 / depth)
    assert_mean(10 - z, expected)


# ---------------------------------------------------------------- the crystal's surface


def _lambda(cosine, alpha, beckmann):
    """Smith's Lambda of light that leaves upwards (Walter et al. 2007, Heitz 2014)."""
    a = cosine / (alpha * np.sqrt(1 - cosine**2))
    if beckmann:
        return (special.erf(a) - 1) / 2 + np.exp(-a * a) / (2 * a * math.sqrt(math.pi))
    return (np.sqrt(1 + 1 / a**2) - 1) / 2


def _facets(view, alpha, beckmann=False):
    """Grid over the hemisphere: facets (3, n) and the visible normals' probabilities (n,).

    D_v = max(0, v.m) D over the area that is seen, which is v.n (1 + Lambda) from above and
    |v.n| Lambda from below (Heitz 2018, eqs. 1 to 4, and Heitz et al. 2016).
    """
    steps = 800
    # tan(theta)^2 / alpha^2 = (1 - v) / v, or -ln(v), has D cos(theta) dm uniform in v; v = t^4
    # gives the long tail of steep facets enough points
    t = (np.arange(steps) + 0.5) / steps
    azimuth = 2 * np.pi * t
    t, azimuth = (a.ravel() for a in np.meshgrid(t, azimuth))
    tangent = alpha * (np.sqrt(-4 * np.log(t)) if beckmann else np.sqrt(1 / t**4 - 1))
    cosine = 1 / np.hypot(1, tangent)
    facet = cosine * np.stack((tangent * np.cos(azimuth), tangent * np.sin(azimuth), t / t))
    along = view[2, 0]
    area = abs(along) * ((along > 0) + _lambda(abs(along), alpha, beckmann))
    seen = np.maximum(0, view[:, 0] @ facet) / area
    return facet, seen / cosine * 4 * t**3 / steps**2


@pytest.mark.parametrize("beckmann", [False, True])
@cases("alpha", "angle")
def test_visible_normals_have_heitzs_distribution(alpha, angle, beckmann):
    """Also those that light sees which flies up, away from the face."""
    angle = math.radians(angle)
    view = np.array([[math.sin(angle)], [0.0], [math.cos(angle)]])
    grid, weight = _facets(view, alpha, beckmann)
    assert weight.sum() == pytest.approx(1.0, abs=3e-4)
    count = 60_000
    normal = np.repeat([[0.0], [0.0], [1.0]], count, axis=1)
    rng = np.random.default_rng(10)
    facet = visible_normals(rng, view * np.ones(count), normal, alpha, beckmann)
    np.testing.assert_allclose(dot(facet, facet), 1.0, rtol=1e-13)
    assert dot(facet, view).min() > 0.0
    for sample, value in [
        (facet[2], grid[2]),
        (facet[0], grid[0]),
        (facet[0] ** 2, grid[0] ** 2),
        (facet[1] ** 2, grid[1] ** 2),
        (dot(facet, view), view[:, 0] @ grid),
    ]:
        assert_mean(sample, weight @ value)


def test_views_straight_from_above_see_all_slopes_evenly():
    normal = np.repeat([[0.0], [0.0], [1.0]], 60_000, axis=1)
    for alpha, beckmann in ((0.05, True), (0.3, True)):
        facet = visible_normals(np.random.default_rng(10), normal, normal, alpha, beckmann)
        for component in facet[:2]:
            assert_mean(component / facet[2], 0.0)
            assert_mean((component / facet[2]) ** 2, alpha**2 / 2)


@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize(("n_in", "n_out"), [(2.01, 1.0), (1.0, 2.01), (2.01, 1.46)])
@pytest.mark.parametrize("angle", [10.0, 32.0, 80.0])
def test_rough_faces_reflect_and_transmit_what_single_facets_do_and_more(
    n_in, n_out, angle, beckmann
):
    """By several facets goes what is left.

    The share u of the face that is lower than the first facet has u^(1 + Lambda_in) uniform; light
    leaves upwards with probability u^Lambda_up and downwards with (1 - u)^Lambda_down, which gives
    the shadowing factors of Walter et al. and of Heitz et al. over those of the view alone.
    """
    angle, alpha, count = math.radians(angle), 0.2, 60_000
    view = np.array([[math.sin(angle)], [0.0], [math.cos(angle)]])
    facet, weight = _facets(view, alpha, beckmann)
    cosine = np.maximum(view[:, 0] @ facet, 1e-9)
    ratio = n_in / n_out
    cosine_out = np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0))
    reflectance = unpolarised_reflectance(cosine, n_in, n_out, cosine_out)
    up = 2 * cosine * facet[2] - view[2]  # of the reflected direction
    down = ratio * view[2] - (ratio * cosine - cosine_out) * facet[2]  # minus the refracted one
    first = 1 + _lambda(view[2], alpha, beckmann)
    upwards, downwards = (_lambda(np.clip(c, 1e-9, 1 - 1e-15), alpha, beckmann) for c in (up, down))
    reflected = weight @ np.where(up > 0, reflectance * first / (first + upwards), 0)
    leaving = first * special.beta(first, 1 + downwards)
    through = weight @ np.where((down > 0) & (cosine_out > 0), (1 - reflectance) * leaving, 0)
    normal = np.repeat([[0.0], [0.0], [-1.0]], count, axis=1)
    direction, transmitted, _ = cross_rough(
        np.random.default_rng(11),
        -view * np.ones(count),
        normal,
        n_in,
        np.full(count, n_out),
        np.full(count, alpha),
        beckmann=beckmann,
    )
    assert np.array_equal(direction[2] < 0, transmitted)
    share = transmitted.mean()
    error = 4.5 * math.sqrt(share * (1 - share) / count) + 3e-4
    assert through - error < share < 1 - reflected + error


@pytest.mark.parametrize("polarization", [False, True])
def test_rough_faces_lose_nothing_and_let_trapped_light_out(polarization):
    bench = Bench(**CLEAR, **GEL, roughness_alpha=0.2, polarization=polarization)
    result = trace(bench, 10_000, 12)
    ends = ("detected", "escaped", "absorbed_aperture")
    assert sum(result.counts[fate] for fate in ends) == result.photons


@pytest.mark.parametrize("gap", [{}, GEL])
def test_almost_no_roughness_is_none(gap):
    polished, rough = Bench(**gap), Bench(**gap, roughness_alpha=1e-5)
    assert_same_eta(trace(polished, 60_000, 13), trace(rough, 60_000, 14))
    assert_same_eta(
        trace(dataclasses.replace(polished, polarization=True), 30_000, 15),
        trace(dataclasses.replace(rough, polarization=True), 30_000, 16),
    )


def test_surfaces_that_absorb_all_they_reflect_let_through_the_first_transmittance():
    bench = Bench(**CLEAR, n_gap=1.0, n_window=1.0, surface_loss=1.0)
    result = trace(bench, 60_000, 17)
    rng = np.random.default_rng(18)
    start, ray = rng.random((3, 200_000)), isotropic(rng, 200_000)
    way = np.where(ray > 0, 1 - start, -start) / ray
    cosine = np.abs(ray)[way.argmin(axis=0), np.arange(200_000)]
    cosine_out = np.sqrt(np.maximum(1 - 2.01**2 * (1 - cosine**2), 0))
    lost = unpolarised_reflectance(cosine, 2.01, 1.0, cosine_out)
    value, sigma = result.budget["absorbed_surface"], result.budget_sigma["absorbed_surface"]
    assert_compatible(value, sigma, lost.mean(), lost.std() / math.sqrt(200_000))
    # light is reflected from outside without loss
    assert result.counts["absorbed_crystal"] == result.counts["truncated"] == 0


# ---------------------------------------------------------------- chamfers


def test_chamfered_box_has_its_volume_and_eighteen_faces():
    body, leg = box(5.0, 0.0, 8.0, 0.9), 0.9
    assert body.normals.shape == (18, 3)
    np.testing.assert_allclose(np.linalg.norm(body.normals, axis=1), 1.0, rtol=1e-15)
    rng = np.random.default_rng(19)
    points = rng.random((3, 400_000)) * [[10.0], [10.0], [8.0]] - [[5.0], [5.0], [0.0]]
    # along each edge half a square of the leg; where three meet, each pair of the three
    # counts once only: 3/4 leg^3 of every corner is off
    length = 8 * (10 - 2 * leg) + 4 * (8 - 2 * leg)
    removed = leg**2 / 2 * length + 8 * 3 / 4 * leg**3
    assert_mean(body.contains(points), 1 - removed / 800)
    corners = np.array([[4.1, 5.0, 4.0], [4.1, 5.0, 4.2], [-5.0, 0.0, 0.89], [0.0, 4.9, 7.3]])
    inside = body.contains(corners.T * (1 - 1e-12))
    assert inside.tolist() == [True, True, False, False]
    # births keep to it
    born = birth_positions(Bench(chamfer_mm=0.9, crystal_height_mm=8.0), body, rng, 50_000)
    assert body.contains(born).all()
    assert_mean(born[2], 4.0)


def test_rays_through_a_chamfered_box_come_back():
    rng = np.random.default_rng(20)
    body = box(5.0, 0.0, 10.0, 1.0)
    inside = birth_positions(Bench(chamfer_mm=1.0), body, rng, 20_000)
    direction = isotropic(rng, 20_000)
    out, out_face, _ = body.exit(inside, direction)
    back, in_face, strayed = body.entry(inside + (out + 3.0) * direction, -direction)
    np.testing.assert_allclose(back, 3.0, rtol=1e-11)
    assert np.array_equal(out_face, in_face) and not strayed.any()
    assert set(out_face) == set(range(18))


def test_neighbours_at_chamfer_and_bubble():
    layout = Layout(Bench(**GEL, chamfer_mm=1.0, bubble_fraction=0.3))
    # gel from x = -2 on; crystal to 4; footprint to 5
    points = np.array([[3.9, 4.5, 0.0, -1.9, -2.1, 5.1], [0, 0, -4.5, 0, 0, 0], [0.0] * 6])
    up = layout.behind(Place.GAP, np.full(4, TOP), points[:, :4])
    assert up.tolist() == [Place.CRYSTAL, Place.OUTSIDE, Place.OUTSIDE, Place.CRYSTAL]
    down = layout.behind(Place.CRYSTAL, np.full(2, BOTTOM), points[:, 3:5])
    assert down.tolist() == [Place.GAP, Place.OUTSIDE]
    assert layout.behind(Place.CRYSTAL, np.arange(6, 18), np.zeros((3, 12))).tolist() == (
        [Place.OUTSIDE] * 12
    )
    points[2] = -0.05
    up = layout.behind(Place.WINDOW, np.full(6, TOP), points)
    assert up.tolist() == [Place.GAP] * 4 + [Place.OUTSIDE] * 2


@pytest.mark.parametrize(
    "effect",
    [
        {"chamfer_mm": 1.5, "polarization": True},
        {"chamfer_mm": 1.5, "scattering_g": 0.7, "scattering_gradient": 0.9},
    ],
)
def test_chamfered_crystals_absorb_from_outside_what_they_emit(effect):
    # Kirchhoff's law for a body in air: light that is uniform and isotropic inside escapes with
    # probability P, and light that is so outside is absorbed. With lines through a sphere of
    # radius R, the absorbed fraction is n^2 a V P / (pi R^2).
    bench = Bench(n_gap=1.0, n_window=1.0, alpha_abs_per_cm=0.5, **OPEN_MASK, **effect)
    count, radius, leg = 150_000, 9.0, bench.chamfer_mm
    inside = trace(bench, count, 43)
    escape, sigma = 1 - inside.budget["absorbed_crystal"], inside.budget_sigma["absorbed_crystal"]
    volume = 1000 - 60 * leg**2 + 6 * leg**3
    factor = bench.n_crystal**2 * 0.05 * volume / (math.pi * radius**2)
    absorbed = _absorbed_from_outside(bench, radius, count, 44)
    error = math.sqrt(absorbed * (1 - absorbed) / count)
    assert_compatible(absorbed, error, factor * escape, factor * sigma)


def _absorbed_from_outside(bench, radius, count, seed):
    """Fraction absorbed of light along isotropic lines through a sphere about the crystal."""
    rng = np.random.default_rng(seed)
    flights, body = Flights(bench, rng, records=False), Layout(bench).bodies[Place.CRYSTAL]
    direction = isotropic(rng, count)
    across = about(rng, direction, np.zeros(count)) * radius * np.sqrt(rng.random(count))
    start = across - 2 * radius * direction + [[0.0], [0.0], [bench.crystal_height_mm / 2]]
    distance, face, _ = body.entry(start, direction)
    position = start + (distance - 1e-6) * direction  # just before the crystal
    groups = []
    for region, who in ((Place.GAP, face == BOTTOM), (Place.OUTSIDE, face != BOTTOM)):
        who = np.flatnonzero(who & np.isfinite(distance))
        photons = flights.births(who.size)
        photons.position, photons.direction = position[:, who], direction[:, who]
        photons.touched[:] = Place.FILM
        if photons.field is not None:
            photons.field = random_polarisation(rng, photons.direction)
        groups.append((region, photons))
    absorbed = 0
    while groups:
        region = max(groups, key=lambda group: len(group[1]))[0]
        photons = PhotonArrays.join([group for place, group in groups if place == region])
        groups = [group for group in groups if group[0] != region]
        place = flights.fly(region, photons)
        absorbed += np.count_nonzero(place == Place.ABSORBED_CRYSTAL)
        for other in (Place.CRYSTAL, Place.GAP, Place.WINDOW, Place.OUTSIDE):
            if np.any(place == other):
                groups.append((other, photons.take(np.flatnonzero(place == other))))
    return absorbed / count


def test_no_chamfer_is_the_plain_bench_and_a_small_one_is_close():
    plain = trace(Bench(**GEL), 60_000, 21)
    assert trace(Bench(**GEL, chamfer_mm=0.0), 60_000, 21) == plain
    assert_same_eta(plain, trace(Bench(**GEL, chamfer_mm=1e-4), 60_000, 22))


# ---------------------------------------------------------------- the gap


def test_thicker_gaps_and_other_liquids():
    # binary fractions, so that sums are exact
    thick = trace(Bench(**GEL, gap_mm=0.75), 10_000, 23)
    assert trace(Bench(**GEL, gap_mm=0.5, gap_offset_mm=0.25), 10_000, 23) == thick
    light = trace(Bench(n_gap=1.25), 10_000, 24)
    assert trace(Bench(n_gap=1.5, gap_index_offset=-0.25), 10_000, 24) == light


def test_effects_of_the_liquid_do_nothing_in_an_air_gap():
    liquid = {"gap_index_offset": 0.1, "gap_absorption_per_cm": 20.0, "bubble_fraction": 0.5}
    assert trace(Bench(**liquid), 10_000, 25) == trace(Bench(), 10_000, 25)
    assert Layout(Bench(**GEL, **liquid)).media[Place.GAP] == Medium(1.56, 2.0)


def test_bubbles_of_no_size_and_bubbles_in_a_liquid_as_thin_as_air(monkeypatch):
    tiny = trace(Bench(**GEL, bubble_fraction=1e-9), 60_000, 26)
    assert_same_eta(tiny, trace(Bench(**GEL), 60_000, 27))
    air = trace(Bench(), 100_000, 28)
    monkeypatch.setattr("mcrim_mitsuba.efficiency.bench.FILLED_ABOVE", 0.5)
    # there is nothing that a bubble's wall could do
    assert_same_eta(trace(Bench(bubble_fraction=0.4), 100_000, 29), air)
    assert_same_eta(
        trace(Bench(bubble_fraction=0.4, gap_mm=1.0), 60_000, 36),
        trace(Bench(gap_mm=1.0), 60_000, 37),
    )


# ---------------------------------------------------------------- the sheet on top


@pytest.mark.parametrize("reflectance", [0.3, 0.9])
def test_sheet_above_a_matched_crystal(reflectance):
    bench = Bench(**MATCHED, **CLEAR, top_reflectance=reflectance)
    result = trace(bench, 60_000, 30)
    rng, count = np.random.default_rng(31), 400_000
    start, ray = 10 * rng.random((3, count)), isotropic(rng, count)
    start[:2] -= 5

    def seen(point, ray):
        """Whether light that flies down passes the mask's hole and stays in the plate."""
        at_mask = point[:2] - (point[2] + 0.05) / ray[2] * ray[:2]
        at_back = point[:2] - (point[2] + 1.05) / ray[2] * ray[:2]
        return (ray[2] < 0) & (np.hypot(*at_mask) < 14) & (np.abs(at_back).max(axis=0) < 14)

    at_sheet = start + (10.01 - start[2]) / ray[2] * ray
    meets = (ray[2] > 0) & (np.abs(at_sheet[:2]).max(axis=0) < 5)
    down = np.repeat([[0.0], [0.0], [-1.0]], count, axis=1)
    returned = seen(at_sheet, about(rng, down, np.sqrt(1 - rng.random(count))))
    weight = seen(start, ray) + reflectance * (meets & returned)
    error = weight.std() / math.sqrt(count)
    assert_compatible(result.eta, result.eta_sigma, weight.mean(), error)
    absorbed, sigma = result.budget["absorbed_reflector"], result.budget_sigma["absorbed_reflector"]
    error = math.sqrt(meets.mean() / count)
    assert_compatible(absorbed, sigma, (1 - reflectance) * meets.mean(), error)


def test_no_sheet_is_the_plain_bench():
    assert trace(Bench(top_reflectance=0.0), 5_000, 33) == trace(Bench(), 5_000, 33)


# ---------------------------------------------------------------- the detector and the mask


@pytest.mark.parametrize("gap", [{}, GEL])
def test_acceptances_weigh_the_histories_of_the_plain_bench(gap):
    plain = trace(Bench(**gap), 80_000, 34, histories=True)
    seen = plain.histories
    by_angle = 1 - 0.9 * (1 - seen.arrival_cosine)
    by_radius = 1 - 0.8 * np.minimum(1 / 0.8, (seen.arrival_radius_mm / 14) ** 2)
    both = Bench(**gap, angular_falloff=0.9, radial_falloff=0.8)
    direct = trace(both, 80_000, 35)
    assert_weighted_eta(plain, by_angle * by_radius, direct)
    # what is refused is absorbed
    refused = direct.counts["absorbed_surface"] / direct.photons
    arrived = {"detected": round((refused + direct.eta) * direct.photons)}
    assert_same_eta(dataclasses.replace(direct, counts=arrived), plain)
    for name, weight in (("angular_falloff", by_angle), ("radial_falloff", by_radius)):
        alone = dataclasses.replace(Bench(**gap), **{name: getattr(both, name)})
        assert_weighted_eta(plain, weight, trace(alone, 40_000, 36), name)


def test_detector_reflects_before_it_refuses():
    plain = trace(Bench(**MATCHED, **CLEAR), 60_000, 37)
    # in a matched bench what is sent back never returns
    grey = trace(Bench(**MATCHED, **CLEAR, detector_reflectance=0.4), 60_000, 38)
    assert_compatible(grey.eta, grey.eta_sigma, 0.6 * plain.eta, 0.6 * plain.eta_sigma)
    bench = Bench(**MATCHED, **CLEAR, detector_reflectance=0.4, angular_falloff=1.0)
    both = trace(bench, 60_000, 39)
    arrived = both.counts["detected"] + both.counts["absorbed_surface"]
    assert_compatible(
        arrived / both.photons, grey.eta_sigma, 0.6 * plain.eta, 0.6 * plain.eta_sigma
    )
    white = trace(Bench(**GEL, detector_reflectance=1.0), 5_000, 40)
    assert white.counts["detected"] == white.counts["absorbed_surface"] == 0


def test_the_tracers_table_of_the_photocathode_is_the_transports():
    """Two tables, written apart, and two interpolations."""
    for wavelength in np.linspace(*CATHODE_WAVELENGTHS_NM, 601):
        assert own_cathode_index(wavelength) == pytest.approx(cathode_index(wavelength), abs=1e-12)
    for outside in (379.9, 680.1):
        with pytest.raises(InputError, match="the photocathode's index is not known there"):
            Bench(cathode_nm=20.0, wavelength_nm=outside)


def test_detectors_that_see_slanted_light_better_count_relative_to_head_on():
    """In a matched bench, where nothing that is sent back returns."""
    matched = Bench(**MATCHED, **CLEAR)
    plain = trace(matched, 60_000, 50, histories=True)
    cosine = plain.histories.arrival_cosine
    film = ThinFilm(cathode_index(540.0), 20.0 / 540.0, 1.0)
    weights = {
        "angular_falloff": (-0.7, 1 + 0.7 * (1 - cosine), 1 / 1.7),
        "cathode_nm": (20.0, film.absorptance(cosine) / film.head_on, film.head_on),
        "detector_specular": (0.3, np.full(len(cosine), 0.7), 1.0),
    }
    for name, (value, weight, head_on) in weights.items():
        direct = trace(dataclasses.replace(matched, **{name: value}), 120_000, 51)
        assert direct.head_on == pytest.approx(head_on, rel=1e-12), name
        assert_weighted_eta(plain, weight, direct, name)
        assert sum(direct.counts.values()) == direct.photons


@pytest.mark.parametrize("polarization", [False, True])
def test_a_film_is_met_as_often_as_its_formulas_say(polarization):
    """Reflected, absorbed and lost parts of a beam onto the detector, unpolarised."""
    bench = Bench(cathode_nm=15.5, polarization=polarization)
    film, count = ThinFilm(cathode_index(540.0), 15.5 / 540.0, 1.52), 200_000
    for angle in np.radians([20.0, 45.0, 70.0]):
        flights = Flights(bench, np.random.default_rng(52), records=False)
        photons = flights.births(count)
        photons.position[:] = [[0.0], [0.0], [-0.5]]
        photons.direction[:] = [[np.sin(angle)], [0.0], [-np.cos(angle)]]
        if polarization:
            photons.field = random_polarisation(np.random.default_rng(53), photons.direction)
        place = flights.fly(Place.WINDOW, photons)
        reflected, transmitted = (part.mean() for part in film.powers(np.cos(angle)))
        for code, part in ((Place.WINDOW, reflected), (Place.ABSORBED_SURFACE, transmitted)):
            error = math.sqrt(max(part * (1 - part), 1e-9) / count)
            assert_compatible(np.mean(place == code), error, part, what=f"{angle}, {code}")
        up = photons.direction[:, place == Place.WINDOW]
        assert np.allclose(up.T, [np.sin(angle), 0.0, np.cos(angle)])
        if polarization:
            # by the film's own amplitudes: what is reflected is polarised across the plane
            states = photons.field[:, place == Place.WINDOW]
            s, p = film.powers(np.cos(angle))[0]
            assert_mean(np.abs(states[1]) ** 2, s / (s + p))


def test_a_mask_that_reflects_sends_light_out_of_a_matched_bench():
    plain = trace(Bench(**MATCHED, **CLEAR, aperture_radius_mm=6.0), 60_000, 54)
    bench = Bench(**MATCHED, **CLEAR, aperture_radius_mm=6.0, housing_reflectance=0.4)
    grey = trace(bench, 60_000, 55)
    assert_same_eta(grey, plain)
    masked, sigma = (
        getattr(plain, name)["absorbed_aperture"] for name in ("budget", "budget_sigma")
    )
    assert_compatible(
        grey.budget["absorbed_aperture"],
        grey.budget_sigma["absorbed_aperture"],
        0.6 * masked,
        0.6 * sigma,
    )
    # its lower side is black: light that total reflection keeps in the plate ends there
    below = trace(Bench(**GEL, aperture_radius_mm=1e-3, housing_reflectance=1.0), 20_000, 56)
    assert below.eta < 1e-3 and below.counts["absorbed_aperture"] < 20


def test_a_shifted_mask_is_one_over_a_crystal_that_is_shifted_back():
    """Straight light of a matched bench, by hand, at the mask's plane."""
    offset, radius = 4.0, 5.0
    bench = Bench(**MATCHED, **CLEAR, aperture_radius_mm=radius, mask_offset_mm=offset)
    result = trace(bench, 60_000, 57)
    rng, count = np.random.default_rng(58), 400_000
    start, ray = 10 * rng.random((3, count)), isotropic(rng, count)
    start[:2] -= 5
    at_mask, at_back = (start[:2] - (start[2] + z) / ray[2] * ray[:2] for z in (0.05, 1.05))
    seen = (ray[2] < 0) & (np.hypot(at_mask[0] - offset, at_mask[1]) < radius)
    seen &= np.abs(at_back).max(axis=0) < 14
    error = seen.std() / math.sqrt(count)
    assert_compatible(result.eta, result.eta_sigma, seen.mean(), error)
    assert_same_eta(trace(dataclasses.replace(bench, mask_offset_mm=-offset), 60_000, 59), result)


@pytest.mark.parametrize("gap", [{}, GEL])
@pytest.mark.parametrize("offset", [0.0, 3.0])
@pytest.mark.parametrize("at_detector", [False, True])
def test_histories_of_an_open_mask_predict_every_aperture(gap, at_detector, offset):
    bench = Bench(
        **gap, aperture_radius_mm=25.0, aperture_at_detector=at_detector, mask_offset_mm=offset
    )
    opened = trace(bench, 80_000, 41, histories=True)
    assert opened.counts["absorbed_aperture"] == 0
    for radius in (4.0, 7.0, 14.0):
        direct = trace(dataclasses.replace(bench, aperture_radius_mm=radius), 40_000, 42)
        kept = (opened.histories.mask_radius_mm <= radius).astype(float)
        assert_weighted_eta(opened, kept, direct, f"{radius} mm")
    if at_detector:
        seen = opened.histories
        assert np.array_equal(seen.mask_radius_mm, seen.arrival_radius_mm)


# ---------------------------------------------------------------- all of them

EFFECTS = TABLES["effects"]


@pytest.mark.parametrize("polarization", [False, True])
@pytest.mark.parametrize("gap", [{}, GEL], ids=["air", "gel"])
def test_nothing_is_ever_lost(gap, polarization):
    excluded = (
        "rayleigh_scattering side_depth_mm gap_absorption_per_cm bubble_area_fraction".split()
    )
    everything = {name: size for name, size in EFFECTS.items() if name not in excluded}
    alone = [{name: size} for name, size in EFFECTS.items()]
    for number, effect in enumerate([*alone, everything]):
        bench = Bench(**gap, **effect, polarization=polarization)
        result = trace(bench, 4_000, 50 + number, histories=True)
        assert result.counts["lost"] == result.counts["truncated"] == 0, effect
        assert sum(result.counts.values()) == result.photons
        assert result.histories.path_cm.shape == (result.counts["detected"],)
        assert 0.05 < result.eta < 0.6, effect


def test_fields_stay_transverse_whatever_is_met():
    bench = Bench(
        **GEL,
        roughness_alpha=0.2,
        chamfer_mm=1.0,
        bubble_fraction=0.5,
        polarization=True,
        top_reflectance=0.9,
        detector_reflectance=0.5,
    )
    flights, met = Flights(bench, np.random.default_rng(70), records=False), set()
    groups = [(Place.CRYSTAL, flights.births(10_000))]
    for _ in range(60):
        region, photons = groups.pop(0)
        place = flights.fly(region, photons)
        np.testing.assert_allclose(np.abs(dot(photons.field, photons.direction)), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.sum(np.abs(photons.field) ** 2, axis=0), 1.0, rtol=1e-12)
        np.testing.assert_allclose(dot(photons.direction, photons.direction), 1.0, rtol=1e-12)
        met.add(region)
        for other in (Place.CRYSTAL, Place.GAP, Place.WINDOW, Place.OUTSIDE):
            who = np.flatnonzero(place == other)
            if who.size:
                groups.append((other, photons.take(who)))
    assert met == {Place.CRYSTAL, Place.GAP, Place.WINDOW, Place.OUTSIDE}


@cases("wrong", more=[{"alpha_scat_per_cm": None}, {"roughness_alpha": None}])
def test_bench_refuses_values_that_cannot_be(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Bench.from_parameters(wrong)
