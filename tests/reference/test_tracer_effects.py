"""The independent tracer's effects against closed forms and against each other.

Seeds are fixed, so a test passes or fails for good. Statistical tests ask for
|z| < 4.5, which a correct tracer exceeds with probability 7e-6; the
file makes about 220 such comparisons, so 1.5e-3 is the chance that a new seed
makes a correct tracer fail.
"""

import dataclasses
import math

import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_compatible, assert_same_eta
from many import (
    about,
    births,
    cross,
    detections,
    dot,
    inside,
    isotropic,
    random_polarisation,
    scattered_cosines,
    unpolarised_reflectance,
    visible_normals,
)
from places import cases_of, tables_of
from scipy import special

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.optics.thin_film import ThinFilm, cathode_index
from mcrim_mitsuba.reference import walk
from mcrim_mitsuba.reference.faces import BenchSurface, FacedBench, polygon
from mcrim_mitsuba.reference.scene_bench import cathode_index as own_cathode_index
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.reference.tracer import trace

cases = cases_of(__file__)
TABLES = tables_of(__file__)

CLEAR = {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.0}
MATCHED = {"n_crystal": 1.0, "n_gap": 1.0, "n_window": 1.0}
GEL = {"n_gap": 1.46}
OPEN_MASK = {"aperture_radius_mm": 20.0}


def traced(numbers, photons, seed, **options):
    return trace(bench_scene(**numbers), photons, seed, **options)


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
    cosine = scattered_cosines(np.random.default_rng(1), 200_000, False, g)
    assert np.abs(cosine).max() <= 1.0
    assert_mean(cosine, g)
    assert_mean(cosine**2, (1 + 2 * g * g) / 3)  # its Legendre moments are g^l


def test_rayleigh_moments():
    cosine = scattered_cosines(np.random.default_rng(2), 200_000, True, 0.0)
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


def cube(side, optics, volume="crystal"):
    """Faces of a cube on z = 0, which all wear the same."""
    top = side * np.array([(-0.5, -0.5, 1.0), (0.5, -0.5, 1.0), (0.5, 0.5, 1.0), (-0.5, 0.5, 1.0)])
    foot = top * (1.0, 1.0, 0.0)
    walls = zip(foot, np.roll(foot, -1, 0), np.roll(top, -1, 0), top, strict=True)
    faces = [polygon(corners) for corners in (top, foot[::-1], *map(list, walls))]
    return BenchSurface(name="walls", faces=faces, interior=volume, optics=optics)


@pytest.mark.parametrize("gradient", [0.0, -0.8, 1.0])
def test_free_paths_follow_the_local_scattering(gradient):
    """Of a cube whose walls all detect: what leaves unscattered, and what is absorbed by then."""
    crystal = {"scattering": 0.1, "absorption": 0.02, "gradient": gradient}
    bench = FacedBench(
        surfaces=[cube(10.0, {"kind": walk.DETECTOR, "least_cosine": -1.0})],
        volumes={"crystal": crystal},
        birth={"axis": 2},
    )
    result = trace(bench, 100_000, 5, histories=True)
    rng, count = np.random.default_rng(5), 400_000
    start, ray = 10.0 * rng.random((3, count)), isotropic(rng, count)
    way = (np.where(ray > 0, 10.0 - start, -start) / ray).min(axis=0)
    # the optical depth is that of the mean of a linear function
    middle = 1.0 + gradient * ((2.0 * start[2] + way * ray[2]) / 10.0 - 1.0)
    unscattered = np.exp(-way * (0.1 * middle + 0.02))
    share = np.mean(result.histories.scatterings == 0) * result.eta
    sigma = math.sqrt(share * (1 - share) / result.photons)
    error = unscattered.std() / math.sqrt(count)
    assert_compatible(share, sigma, unscattered.mean(), error)
    # the path that is weighed with the scattering is as long, on average, as scatterings tell:
    # of all light; of that which is detected, by how eta changes with the coefficient
    more = dataclasses.replace(bench, volumes={"crystal": crystal | {"scattering": 0.13}})
    seen = result.histories
    weight = 1.3**seen.scatterings * np.exp(-0.3 * seen.scattering_path_cm)
    assert_weighted_eta(result, weight, trace(more, 100_000, 6))


def test_phase_functions_are_read():
    for effect, expected in (
        ({}, (False, 0.0)),
        ({"scattering_g": 0.6}, (False, 0.6)),
        ({"rayleigh_scattering": True}, (True, 0.0)),
    ):
        crystal = read_bench(bench_scene(**effect)).volumes["crystal"]
        assert (crystal["rayleigh"], crystal["g"]) == expected


@pytest.mark.parametrize("gap", [{}, GEL])
def test_histories_predict_other_scattering_with_a_gradient(gap):
    bench = {**gap, "scattering_gradient": 0.9}
    near = traced(bench, 60_000, 6, histories=True)
    seen = near.histories
    assert np.abs(seen.scattering_path_cm - seen.path_cm).max() > 0.1
    weight = (0.4 / 0.54) ** seen.scatterings * np.exp(-(0.4 - 0.54) * seen.scattering_path_cm)
    weight *= np.exp(-(0.1 - 0.039) * seen.path_cm)
    assert weight.shape == (near.counts["detected"],)
    moved = traced(bench | {"alpha_scat_per_cm": 0.4, "alpha_abs_per_cm": 0.1}, 60_000, 7)
    assert_weighted_eta(near, weight, moved)
    assert moved.histories is None
    plain = traced({}, 1_000, 8, histories=True).histories
    assert np.array_equal(plain.path_cm, plain.scattering_path_cm)


@pytest.mark.parametrize("depth", [0.2, 3.0, 100.0, 1e6, math.inf])
@pytest.mark.parametrize("name", ["source_depth_mm", "side_depth_mm"])
def test_births_near_the_top_or_a_side(name, depth):
    bench = read_bench(bench_scene(**{name: depth}))
    (x, y, z), _ = births(bench, np.random.default_rng(9), 100_000)
    assert z.min() >= 0 and z.max() <= 10 and np.abs([x, y]).max() <= 5
    z, evenly = (z, x) if name == "source_depth_mm" else (5 - x, 5 + z - 10)
    assert_mean(evenly, 0.0)
    # mean of the exponential cut off at the crystal's height
    expected = 5.0 if depth >= 1e6 else depth - 10 / math.expm1(10 / depth)
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
    steps = 400
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
    reflectance = unpolarised_reflectance(np.minimum(cosine, 1.0), n_in, n_out)
    up = 2 * cosine * facet[2] - view[2]  # of the reflected direction
    down = ratio * view[2] - (ratio * cosine - cosine_out) * facet[2]  # minus the refracted one
    first = 1 + _lambda(view[2], alpha, beckmann)
    upwards, downwards = (_lambda(np.clip(c, 1e-9, 1 - 1e-15), alpha, beckmann) for c in (up, down))
    reflected = weight @ np.where(up > 0, reflectance * first / (first + upwards), 0)
    leaving = first * special.beta(first, 1 + downwards)
    through = weight @ np.where((down > 0) & (cosine_out > 0), (1 - reflectance) * leaving, 0)
    normal = np.repeat([[0.0], [0.0], [-1.0]], count, axis=1)
    rng, ways = np.random.default_rng(11), -view * np.ones(count)
    direction, transmitted, field = cross(
        rng,
        ways,
        normal,
        n_in,
        n_out,
        random_polarisation(rng, ways),
        alpha=alpha,
        beckmann=beckmann,
    )
    np.testing.assert_allclose(np.abs(dot(field, direction)), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.sum(np.abs(field) ** 2, axis=0), 1.0, rtol=1e-12)
    assert np.array_equal(direction[2] < 0, transmitted)
    share = transmitted.mean()
    error = 4.5 * math.sqrt(share * (1 - share) / count) + 3e-4
    assert through - error < share < 1 - reflected + error


@pytest.mark.parametrize("polarization", [False, True])
def test_rough_faces_lose_nothing_and_let_trapped_light_out(polarization):
    rough = {**CLEAR, **GEL, "roughness_alpha": 0.2}
    result = traced(rough | {"polarization": polarization}, 10_000, 12)
    ends = ("detected", "escaped", "absorbed_aperture")
    assert sum(result.counts[fate] for fate in ends) == result.photons


@pytest.mark.parametrize("gap", [{}, GEL])
def test_almost_no_roughness_is_none(gap):
    for polarization in (False, True):
        polished = {**gap, "polarization": polarization}
        rough = polished | {"roughness_alpha": 1e-5}
        assert_same_eta(traced(polished, 60_000, 13), traced(rough, 60_000, 14))


def test_surfaces_that_absorb_all_they_reflect_let_through_the_first_transmittance():
    bench = {**CLEAR, "n_gap": 1.0, "n_window": 1.0, "surface_loss": 1.0}
    result = traced(bench, 60_000, 17)
    rng = np.random.default_rng(18)
    start, ray = rng.random((3, 200_000)), isotropic(rng, 200_000)
    way = np.where(ray > 0, 1 - start, -start) / ray
    cosine = np.abs(ray)[way.argmin(axis=0), np.arange(200_000)]
    lost = unpolarised_reflectance(cosine, 2.01, 1.0)
    value, sigma = result.budget["absorbed_surface"], result.budget_sigma["absorbed_surface"]
    assert_compatible(value, sigma, lost.mean(), lost.std() / math.sqrt(200_000))
    # light is reflected from outside without loss
    assert result.counts["absorbed_crystal"] == result.counts["truncated"] == 0


# ---------------------------------------------------------------- chamfers


def test_chamfered_box_has_its_volume_and_eighteen_faces():
    leg = 0.9
    bench = read_bench(bench_scene(chamfer_mm=leg, crystal_height_mm=8.0))
    faces = [f for s in bench.surfaces for f in s.faces if s.interior == "crystal"]
    assert len(faces) == 18
    rng = np.random.default_rng(19)
    points = rng.random((3, 400_000)) * [[10.0], [10.0], [8.0]] - [[5.0], [5.0], [0.0]]
    # along each edge half a square of the leg; where three meet, each pair of the three
    # counts once only: 3/4 leg^3 of every corner is off
    length = 8 * (10 - 2 * leg) + 4 * (8 - 2 * leg)
    removed = leg**2 / 2 * length + 8 * 3 / 4 * leg**3
    assert_mean(inside(bench, "crystal", points), 1 - removed / 800)
    corners = np.array([[4.1, 5.0, 4.0], [4.1, 5.0, 4.2], [-5.0, 0.0, 0.89], [0.0, 4.9, 7.3]])
    corners = (corners.T - [[0], [0], [4]]) * (1 - 1e-9) + [[0], [0], [4]]
    assert inside(bench, "crystal", corners).tolist() == [True, True, False, False]
    # births keep to it
    born, _ = births(bench, rng, 50_000)
    assert inside(bench, "crystal", born).all()
    assert_mean(born[2], 4.0)


@cases("effect")
def test_crystals_absorb_from_a_room_what_the_room_absorbs_from_them(effect):
    """Reciprocity: n^2 V / alpha times the part that the other absorbs of even light is the same.

    The room has grey walls and an air that absorbs.
    """
    side, in_room, in_crystal = 24.0, 0.01, 0.05
    read = read_bench(bench_scene(**effect, alpha_abs_per_cm=10.0 * in_crystal, n_gap=1.0))
    crystal = [
        dataclasses.replace(s, exterior="room") for s in read.surfaces if s.interior == "crystal"
    ]
    walls = cube(side, {"kind": walk.REFLECTS, "reflectance": 0.6}, "room")
    walls = dataclasses.replace(
        walls,
        interior="",
        exterior="room",
        faces=[moved_down(face, 7.0).flipped for face in walls.faces],
    )
    volumes = {"crystal": read.volumes["crystal"], "room": {"absorption": in_room}}
    bench = dataclasses.replace(
        read, surfaces=[*crystal, walls, black_detector()], volumes=volumes, birth={"axis": 2}
    )
    shares = {}
    for source, other in (("crystal", "room"), ("room", "crystal")):
        result = trace(dataclasses.replace(bench, crystal=source), 150_000, 43)
        shares[source] = [x[f"absorbed_{other}"] for x in (result.budget, result.budget_sigma)]
        assert result.counts["lost"] == 0
    leg = effect.get("chamfer_mm", 0.0)
    volume = 1000 - 60 * leg**2 + 6 * leg**3
    factors = {"crystal": 2.01**2 * volume / in_room, "room": (side**3 - volume) / in_crystal}
    (a, sigma_a), (b, sigma_b) = (factors[n] * np.array(shares[n]) for n in factors)
    assert_compatible(a, sigma_a, b, sigma_b)


def moved_down(face, length):
    """A face somewhat lower."""
    shift = length * face.plane[2]
    bounds = [space - [0, 0, 0, length * space[2]] for space in face.bounds]
    plane = face.plane - [0, 0, 0, shift]
    return dataclasses.replace(face, plane=plane, bounds=bounds, box=face.box - [0, 0, length])


def black_detector():
    """Far away: every bench has one."""
    corners = [(50, 0, 0), (51, 0, 0), (51, 1, 0), (50, 1, 0)]
    return BenchSurface(name="detector", faces=[polygon(corners)], optics={"kind": walk.DETECTOR})


def test_no_chamfer_is_the_plain_bench_and_a_small_one_is_close():
    plain = trace(bench_scene(**GEL), 60_000, 21)
    assert trace(bench_scene(**GEL, chamfer_mm=0.0), 60_000, 21) == plain
    assert_same_eta(plain, trace(bench_scene(**GEL, chamfer_mm=1e-4), 60_000, 22))


# ---------------------------------------------------------------- the gap


def test_thicker_gaps_and_other_liquids():
    # binary fractions, so that sums are exact
    thick = trace(bench_scene(**GEL, gap_mm=0.75), 10_000, 23)
    assert trace(bench_scene(**GEL, gap_mm=0.5, gap_offset_mm=0.25), 10_000, 23) == thick
    light = trace(bench_scene(n_gap=1.25), 10_000, 24)
    assert trace(bench_scene(n_gap=1.5, gap_index_offset=-0.25), 10_000, 24) == light


def test_effects_of_the_liquid_do_nothing_in_an_air_gap():
    liquid = {"gap_index_offset": 0.1, "gap_absorption_per_cm": 20.0, "bubble_fraction": 0.5}
    assert traced(liquid, 10_000, 25).counts == traced({}, 10_000, 25).counts
    gap = read_bench(bench_scene(**GEL, **liquid)).tables()[0].volumes[2]
    assert (gap["index"], gap["absorption"]) == (pytest.approx(1.56), 2.0)


def test_bubbles_of_no_size():
    tiny = traced({**GEL, "bubble_fraction": 1e-5}, 60_000, 26)
    assert_same_eta(tiny, traced(GEL, 60_000, 27))


# ---------------------------------------------------------------- the sheet on top


@pytest.mark.parametrize("reflectance", [0.3, 0.9])
def test_sheet_above_a_matched_crystal(reflectance):
    result = trace(bench_scene(**MATCHED, **CLEAR, top_reflectance=reflectance), 60_000, 30)
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


def test_a_black_sheet_takes_what_escapes():
    black, plain = (traced(n, 5_000, 33).counts for n in ({"top_reflectance": 0.0}, {}))
    assert black["detected"] == plain["detected"]
    assert black["absorbed_reflector"] + black["escaped"] == plain["escaped"]


# ---------------------------------------------------------------- the detector and the mask


@pytest.mark.parametrize("gap", [{}, GEL])
def test_acceptances_weigh_the_histories_of_the_plain_bench(gap):
    plain = trace(bench_scene(**gap), 80_000, 34, histories=True)
    seen = plain.histories
    by_angle = 1 - 0.9 * (1 - seen.arrival_cosine)
    by_radius = 1 - 0.8 * np.minimum(1 / 0.8, (seen.arrival_radius_mm / 14) ** 2)
    both = {"angular_falloff": 0.9, "radial_falloff": 0.8}
    direct = traced(gap | both, 80_000, 35)
    assert_weighted_eta(plain, by_angle * by_radius, direct)
    # what is refused is absorbed
    refused = direct.counts["absorbed_surface"] / direct.photons
    arrived = refused + direct.eta
    assert_compatible(arrived, direct.eta_sigma, plain.eta, plain.eta_sigma)
    for name, weight in (("angular_falloff", by_angle), ("radial_falloff", by_radius)):
        alone = traced(gap | {name: both[name]}, 40_000, 36)
        assert_weighted_eta(plain, weight, alone, name)


def test_detector_reflects_before_it_refuses():
    plain = trace(bench_scene(**MATCHED, **CLEAR), 60_000, 37)
    # in a matched bench what is sent back never returns
    grey = trace(bench_scene(**MATCHED, **CLEAR, detector_reflectance=0.4), 60_000, 38)
    assert_compatible(grey.eta, grey.eta_sigma, 0.6 * plain.eta, 0.6 * plain.eta_sigma)
    bench = bench_scene(**MATCHED, **CLEAR, detector_reflectance=0.4, angular_falloff=1.0)
    both = trace(bench, 60_000, 39)
    arrived = both.counts["detected"] + both.counts["absorbed_surface"]
    assert_compatible(
        arrived / both.photons, grey.eta_sigma, 0.6 * plain.eta, 0.6 * plain.eta_sigma
    )
    white = trace(bench_scene(**GEL, detector_reflectance=1.0), 5_000, 40)
    assert white.counts["detected"] == white.counts["absorbed_surface"] == 0


def test_the_tracers_table_of_the_photocathode_is_the_transports():
    """Two tables, written apart, and two interpolations."""
    for wavelength in np.linspace(380.0, 680.0, 601):
        assert own_cathode_index(wavelength) == pytest.approx(cathode_index(wavelength), abs=1e-12)
    text = bench_scene(cathode_nm=20.0).unwritten_text
    far = '<float name="wavelength_nm" value="680.1"/><float name="cathode_nm"'
    scene = bench_scene().edited(text.replace('<float name="cathode_nm"', far))
    with pytest.raises(InputError, match="photocathode's index at 680"):
        read_bench(scene)


def test_detectors_that_see_slanted_light_better_count_relative_to_head_on():
    """In a matched bench, where nothing that is sent back returns."""
    matched = {**MATCHED, **CLEAR}
    plain = traced(matched, 60_000, 50, histories=True)
    cosine = plain.histories.arrival_cosine
    film = ThinFilm(cathode_index(540.0), 20.0 / 540.0, 1.0)
    weights = {
        "angular_falloff": (-0.7, 1 + 0.7 * (1 - cosine), 1 / 1.7),
        "cathode_nm": (20.0, film.absorptance(cosine) / film.head_on, film.head_on),
        "detector_specular": (0.3, np.full(len(cosine), 0.7), 1.0),
    }
    for name, (value, weight, head_on) in weights.items():
        direct = traced(matched | {name: value}, 120_000, 51)
        assert direct.head_on == pytest.approx(head_on, rel=1e-12), name
        assert_weighted_eta(plain, weight, direct, name)
        assert sum(direct.counts.values()) == direct.photons


@pytest.mark.parametrize("polarization", [False, True])
def test_a_film_is_met_as_often_as_its_formulas_say(polarization):
    """Reflected, absorbed and lost parts of a beam onto the detector, unpolarised."""
    bench = read_bench(bench_scene(cathode_nm=15.5))
    film, count = ThinFilm(cathode_index(540.0), 15.5 / 540.0, 1.52), 200_000
    for angle in np.radians([20.0, 45.0, 70.0]):
        rng = np.random.default_rng(52)
        ways = np.repeat([[np.sin(angle)], [0.0], [-np.cos(angle)]], count, axis=1)
        field = random_polarisation(rng, ways) if polarization else None
        fates, ways, states = detections(rng, bench, ways, field)
        reflected, transmitted = (part.mean() for part in film.powers(np.cos(angle)))
        for code, part in ((-1, reflected), (walk.SURFACE, transmitted)):
            error = math.sqrt(max(part * (1 - part), 1e-9) / count)
            assert_compatible(np.mean(fates == code), error, part, what=f"{angle}, {code}")
        up = ways[:, fates == -1]
        assert np.allclose(up.T, [np.sin(angle), 0.0, np.cos(angle)])
        if polarization:
            # by the film's own amplitudes: what is reflected is polarised across the plane
            states = states[:, fates == -1]
            s, p = film.powers(np.cos(angle))[0]
            np.testing.assert_allclose(np.abs(dot(states, up)), 0.0, atol=1e-12)
            assert_mean(np.abs(states[1]) ** 2, s / (s + p))


def test_a_mask_that_reflects_sends_light_out_of_a_matched_bench():
    plain = trace(bench_scene(**MATCHED, **CLEAR, aperture_radius_mm=6.0), 60_000, 54)
    bench = bench_scene(**MATCHED, **CLEAR, aperture_radius_mm=6.0, housing_reflectance=0.4)
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
    below = trace(bench_scene(**GEL, aperture_radius_mm=1e-3, housing_reflectance=1.0), 20_000, 56)
    assert below.eta < 1e-3 and below.counts["absorbed_aperture"] < 20


def test_a_shifted_mask_is_one_over_a_crystal_that_is_shifted_back():
    """Straight light of a matched bench, by hand, at the mask's plane."""
    offset, radius = 4.0, 5.0
    bench = {**MATCHED, **CLEAR, "aperture_radius_mm": radius, "mask_offset_mm": offset}
    result = traced(bench, 60_000, 57)
    rng, count = np.random.default_rng(58), 400_000
    start, ray = 10 * rng.random((3, count)), isotropic(rng, count)
    start[:2] -= 5
    at_mask, at_back = (start[:2] - (start[2] + z) / ray[2] * ray[:2] for z in (0.05, 1.05))
    seen = (ray[2] < 0) & (np.hypot(at_mask[0] - offset, at_mask[1]) < radius)
    seen &= np.abs(at_back).max(axis=0) < 14
    error = seen.std() / math.sqrt(count)
    assert_compatible(result.eta, result.eta_sigma, seen.mean(), error)
    assert_same_eta(traced(bench | {"mask_offset_mm": -offset}, 60_000, 59), result)


@pytest.mark.parametrize("gap", [{}, GEL])
@pytest.mark.parametrize("offset", [0.0, 3.0])
@pytest.mark.parametrize("at_detector", [False, True])
def test_histories_of_an_open_mask_predict_every_aperture(gap, at_detector, offset):
    bench = {**gap, "aperture_at_detector": at_detector, "mask_offset_mm": offset}
    opened = traced(bench | {"aperture_radius_mm": 25.0}, 80_000, 41, histories=True)
    assert opened.counts["absorbed_aperture"] == 0
    for radius in (4.0, 7.0, 14.0):
        direct = traced(bench | {"aperture_radius_mm": radius}, 40_000, 42)
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
        bench = {**gap, **effect, "polarization": polarization}
        result = traced(bench, 4_000, 50 + number, histories=True)
        assert result.counts["lost"] == result.counts["truncated"] == 0, effect
        assert sum(result.counts.values()) == result.photons
        assert result.histories.path_cm.shape == (result.counts["detected"],)
        assert 0.05 < result.eta < 0.6, effect


@cases("wrong", more=[{"alpha_scat_per_cm": None}])
def test_bench_refuses_values_that_cannot_be(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Bench.from_parameters(wrong)
