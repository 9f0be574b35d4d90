"""The independent tracer against closed forms and against the bench's reference numbers.

Seeds are fixed, so a test passes or fails for good. Statistical tests ask for
|z| < 4.5, which a correct tracer exceeds with probability 7e-6; the
file makes about 30 such comparisons, so 2e-4 is the chance that a new seed
makes a correct tracer fail.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_compatible
from many import (
    amplitudes,
    basis,
    cross,
    dot,
    isotropic,
    lambertian,
    nearest,
    random_polarisation,
    unpolarised_reflectance,
)

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.reference.tracer import trace

CLEAR = {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.0}
MATCHED = {"n_crystal": 1.0, "n_gap": 1.0, "n_window": 1.0}


def test_amplitudes_at_normal_incidence_brewsters_angle_and_total_reflection():
    normal = amplitudes(np.array([1.0]), 1.0, 1.5)
    np.testing.assert_allclose(normal.reflected_s, -0.2, rtol=1e-14)
    np.testing.assert_allclose(normal.reflected_p, 0.2, rtol=1e-14)
    brewster = amplitudes(np.array([math.cos(math.atan(1.5))]), 1.0, 1.5)
    assert abs(brewster.reflected_p[0]) < 1e-15
    # Born and Wolf, eq. 1.5.4 (60): tan(delta/2) = cos sqrt(sin^2 - n^2) / sin^2,
    # delta the phase of p minus that of s up to the sign of the time dependence
    angle, n = np.radians([45.0, 54.6, 80.0]), 1.0 / 1.51
    total = amplitudes(np.cos(angle), 1.51, 1.0)
    np.testing.assert_allclose(np.abs(total.reflected_s), 1.0, rtol=1e-14)
    np.testing.assert_allclose(np.abs(total.reflected_p), 1.0, rtol=1e-14)
    sine = np.sin(angle)
    expected = 2.0 * np.arctan(np.cos(angle) * np.sqrt(sine**2 - n**2) / sine**2)
    delta = np.abs(np.angle(total.reflected_p / total.reflected_s))
    np.testing.assert_allclose(delta, expected, rtol=1e-12)


@pytest.mark.parametrize(("n_in", "n_out"), [(1.0, 2.01), (2.01, 1.0), (1.46, 1.46)])
def test_reflected_and_transmitted_energy_add_up(n_in, n_out):
    cos_in = np.linspace(1e-3, 1.0, 1000)
    a = amplitudes(cos_in, n_in, n_out)
    cos_out = np.sqrt((1.0 - (n_in / n_out) ** 2 * (1.0 - cos_in**2)).astype(complex)).real
    flux = n_out * cos_out / (n_in * cos_in)
    for r, t in ((a.reflected_s, a.transmitted_s), (a.reflected_p, a.transmitted_p)):
        np.testing.assert_allclose(np.abs(r) ** 2 + flux * np.abs(t) ** 2, 1.0, atol=1e-9)
    mean = 0.5 * (np.abs(a.reflected_s) ** 2 + np.abs(a.reflected_p) ** 2)
    np.testing.assert_allclose(unpolarised_reflectance(cos_in, n_in, n_out), mean, atol=1e-9)


def test_fresnel_rhomb_turns_linear_light_circular():
    # Born and Wolf, sec. 1.5.4: two total reflections at 54 deg 37' in glass of n = 1.51
    angle = math.radians(54.0 + 37.0 / 60.0)
    direction = np.array([[math.sin(angle)], [0.0], [math.cos(angle)]])
    s, p = np.array([[0.0], [1.0], [0.0]]), np.array([[math.cos(angle)], [0.0], [-math.sin(angle)]])
    field = ((s + p) / math.sqrt(2.0)).astype(complex)
    rng = np.random.default_rng(0)
    for side in (1.0, -1.0):
        normal = np.array([[0.0], [0.0], [side]])
        direction, transmitted, field = cross(rng, direction, normal, 1.51, 1.0, field)
        assert not transmitted[0]
    handedness = np.imag(np.cross(np.conj(field[:, 0]), field[:, 0])) @ direction[:, 0]
    assert abs(handedness) == pytest.approx(1.0, abs=1e-4)


def test_crossing_keeps_fields_transverse_and_obeys_snell():
    rng = np.random.default_rng(1)
    count = 20_000
    normal = isotropic(rng, count)
    direction = lambertian(rng, normal)
    direction[:, 0] = normal[:, 0]  # exactly normal incidence has no plane of incidence
    u, v = basis(direction)
    field = (u + 1j * v) / math.sqrt(2.0)  # circular: reflected like unpolarised light
    outgoing, transmitted, out = cross(rng, direction, normal, 1.5, 1.2, field)
    np.testing.assert_allclose(dot(outgoing, outgoing), 1.0, rtol=1e-13)
    np.testing.assert_allclose(np.abs(dot(out, outgoing)), 0.0, atol=1e-13)
    np.testing.assert_allclose(np.sum(np.abs(out) ** 2, axis=0), 1.0, rtol=1e-13)
    assert np.array_equal(dot(outgoing, normal) > 0.0, transmitted)
    ratio = np.where(transmitted, 1.2 / 1.5, 1.0)
    tangential_in = direction - dot(direction, normal) * normal
    tangential_out = outgoing - dot(outgoing, normal) * normal
    np.testing.assert_allclose(ratio * tangential_out, tangential_in, atol=1e-13)
    cos_in = dot(direction, normal)
    expected = 1.0 - unpolarised_reflectance(cos_in, 1.5, 1.2)
    sigma = math.sqrt(np.sum(expected * (1.0 - expected))) / count
    assert_compatible(transmitted.mean(), sigma, expected.mean(), what="transmitted")


def test_fields_at_a_mirror_and_at_no_interface():
    rng = np.random.default_rng(15)
    normal = isotropic(rng, 1_000)
    direction = lambertian(rng, normal)
    field = random_polarisation(rng, direction)
    # an infinite index is a mirror: the tangential fields cancel, which fixes the
    # sign of p against that of s
    outgoing, transmitted, out = cross(rng, direction, normal, 1.0, 1e9, field)
    total = (out + field)[:, ~transmitted]
    tangential = total - dot(total, normal[:, ~transmitted]) * normal[:, ~transmitted]
    assert np.count_nonzero(~transmitted) > 990
    np.testing.assert_allclose(np.abs(tangential), 0.0, atol=1e-6)
    outgoing, transmitted, out = cross(rng, direction, normal, 1.46, 1.46, field)
    assert transmitted.all()
    np.testing.assert_allclose(outgoing, direction, atol=1e-12)
    np.testing.assert_allclose(out, field, atol=1e-12)


def test_rays_meet_a_box_where_they_should():
    bench = read_bench(bench_scene())
    position = np.array([[0.0, 0.0, 20.0], [0.0, 0.0, 20.0], [4.0, 4.0, 4.0]]).T
    direction = np.array([[0, 0, -1], [1, 0, 0], [0.6, 0, 0.8]], dtype=float).T
    names = [surface.name for surface in bench.surfaces for _ in surface.faces]
    distance, face = nearest(bench, "", position, direction)
    assert distance[0] == 10.0 and names[face[0]] == "crystal_top"
    assert np.isinf(distance[1]) and face[1] == -1
    distance, face = nearest(bench, "crystal", position, direction)
    assert distance[2] == pytest.approx(1.0 / 0.6) and names[face[2]] == "crystal_side_right"


@pytest.mark.parametrize("leg", [0.0, 0.01, 1.5])
def test_convex_bodies_answer_as_their_half_spaces_do(leg):
    """Exit by M. Cyrus and J. Beck, Computers and Graphics 3; and back again."""
    bench, rng = read_bench(bench_scene(chamfer_mm=leg)), np.random.default_rng(18)
    faces = enumerate((s.interior, f.plane) for s in bench.surfaces for f in s.faces)
    own = [(i, plane) for i, (volume, plane) in faces if volume == "crystal"]
    numbers, planes = np.array([i for i, _ in own]), np.array([plane for _, plane in own])
    inner = rng.random((3, 20_000)) * 6.9 - [[3.45], [3.45], [-1.55]]
    way = isotropic(rng, 20_000)
    times = (planes[:, 3:] - planes[:, :3] @ inner) / (planes[:, :3] @ way)
    leaves = np.where(times > 0.0, times, np.inf)
    distance, face = nearest(bench, "crystal", inner, way)
    np.testing.assert_allclose(distance, leaves.min(axis=0), rtol=1e-12)
    assert np.mean(face == numbers[leaves.argmin(axis=0)]) > 0.999  # but for edges
    at_top = face != next(i for i, p in own if p[2] == -1.0)
    back, met = nearest(bench, "", (inner + (distance + 7.0) * way)[:, at_top], -way[:, at_top])
    free = met == face[at_top]  # nothing else of the bench is in the way
    np.testing.assert_allclose(back[free], 7.0, rtol=1e-11)
    assert free.mean() > 0.8


def test_neighbours_through_the_plates_entrance_face():
    bench = read_bench(bench_scene(n_gap=1.46, chamfer_mm=1.0, bubble_fraction=0.3))
    names = [surface.name for surface in bench.surfaces for _ in surface.faces]
    # gel from x = -2 on; the crystal's foot to 4; footprint to 5
    across = np.array([[3.9, 4.5, 0.0, -1.9, -2.1], [0, 0, -4.5, 0, 0]])
    up = np.repeat([[0.0], [0.0], [1.0]], 5, axis=1)
    face = nearest(bench, "gap", np.vstack((across[:, :4], [-0.02] * 4)), up[:, :4])[1]
    assert [names[i] == "crystal_bottom" for i in face] == [True, False, False, True]
    face = nearest(bench, "window", np.vstack((across, [-0.5] * 5)), up)[1]
    exteriors = {s.name: s.exterior for s in bench.surfaces}
    assert [exteriors[names[i]] for i in face] == ["gap"] * 4 + [""]


def test_lambertian_directions_have_the_cosine_law():
    rng = np.random.default_rng(3)
    normal = isotropic(rng, 100_000)
    cosine = dot(lambertian(rng, normal), normal)
    assert cosine.min() > 0.0
    # cos^2 is uniform on (0, 1) under the cosine law
    assert_compatible(np.mean(cosine**2), math.sqrt(1 / 12 / 1e5), 0.5, what="<cos^2>")
    assert_compatible(np.mean(cosine), math.sqrt(1 / 18 / 1e5), 2 / 3, what="<cos>")


@pytest.mark.parametrize("polarization", [False, True])
def test_clear_cube_traps_the_fraction_between_the_escape_cones(polarization):
    # whatever lies in no escape cone is reflected for ever (bench.md, "More anchors");
    # the plate sends light back only within the cones
    result = trace(bench_scene(**CLEAR, polarization=polarization), 12_000, 4, max_depth=300)
    expected = 1.0 - 3.0 * (1.0 - math.sqrt(1.0 - 1.0 / 2.01**2))
    truncated, sigma = result.budget["truncated"], result.budget_sigma["truncated"]
    assert_compatible(truncated, sigma, expected, what="trapped")
    assert result.counts["absorbed_crystal"] == result.counts["lost"] == 0


def test_index_matched_bench_is_straight_lines():
    bench = SimpleNamespace(
        crystal_width_mm=10.0,
        alpha_abs_per_cm=0.5,
        crystal_height_mm=6.0,
        gap_mm=0.8,
        gap_absorption_per_cm=4.0,
        window_width_mm=18.0,
        window_absorption_per_cm=3.0,
        window_thickness_mm=2.0,
        aperture_radius_mm=5.0,
    )
    numbers = {**vars(bench), **MATCHED, "alpha_scat_per_cm": 0.0}
    of_volumes = {name: numbers.pop(f"{name}_absorption_per_cm") for name in ("gap", "window")}
    read = read_bench(bench_scene(**numbers))
    # in the scene a gap as thin as air does not absorb
    for name, alpha_per_cm in of_volumes.items():
        read.volumes[name]["absorption"] = alpha_per_cm / 10.0
    result = trace(read, 100_000, 5)
    expected, expected_sigma = _straight_lines(bench, 400_000, 6)
    for fate, fraction in expected.items():
        value, sigma = result.budget[fate], result.budget_sigma[fate]
        assert_compatible(value, sigma, fraction, expected_sigma[fate], fate)
    assert result.counts["lost"] == 0


def _straight_lines(bench, count, seed):
    """Expected budget, and its error, of an index-matched bench without scattering."""
    rng = np.random.default_rng(seed)
    half, plate = bench.crystal_width_mm / 2, bench.window_width_mm / 2
    x, y, z = rng.random((3, count))
    x, y, z = (2 * x - 1) * half, (2 * y - 1) * half, z * bench.crystal_height_mm
    dx, dy, dz = rng.standard_normal((3, count))
    norm = np.sqrt(dx**2 + dy**2 + dz**2)
    dx, dy, dz = dx / norm, dy / norm, dz / norm

    def to_sides(reach):
        return np.minimum(
            (reach - x * np.sign(dx)) / np.abs(dx), (reach - y * np.sign(dy)) / np.abs(dy)
        )

    ends = np.where(dz > 0, bench.crystal_height_mm - z, z) / np.abs(dz)
    down = dz < 0
    to_mask = (z + bench.gap_mm) / np.abs(dz)
    to_back = to_mask + bench.window_thickness_mm / np.abs(dz)
    in_crystal = np.minimum(ends, to_sides(half))
    in_gap = np.where(down, np.maximum(np.minimum(to_mask, to_sides(half)) - in_crystal, 0), 0)
    on_plate = down & (to_mask < to_sides(plate))
    in_hole = np.hypot(x + to_mask * dx, y + to_mask * dy) <= bench.aperture_radius_mm
    in_window = np.where(on_plate & in_hole, np.minimum(to_back, to_sides(plate)) - to_mask, 0.0)
    after_crystal = np.exp(-bench.alpha_abs_per_cm * in_crystal / 10)
    after_gap = after_crystal * np.exp(-bench.gap_absorption_per_cm * in_gap / 10)
    after_window = after_gap * np.exp(-bench.window_absorption_per_cm * in_window / 10)
    detected = after_window * (on_plate & in_hole & (to_back < to_sides(plate)))
    aperture = after_gap * (on_plate & ~in_hole)
    samples = {
        "absorbed_crystal": 1 - after_crystal,
        "absorbed_gap": after_crystal - after_gap,
        "absorbed_window": after_gap - after_window,
        "absorbed_aperture": aperture,
        "detected": detected,
        "escaped": after_window - detected - aperture,
    }
    return (
        {fate: w.mean() for fate, w in samples.items()},
        {fate: w.std() / math.sqrt(count) for fate, w in samples.items()},
    )


def test_black_wrap_takes_five_faces_light_of_six():
    # by symmetry each face of an index-matched cube passes a sixth
    result = trace(bench_scene(**MATCHED, **CLEAR, wrap_reflectance=0.0, film_mm=1e-6), 100_000, 7)
    assert_compatible(
        result.budget["absorbed_reflector"], result.budget_sigma["absorbed_reflector"], 5 / 6
    )


def test_grey_wrap_agrees_with_a_random_walk_in_an_open_box():
    reflectance = 0.8
    result = trace(
        bench_scene(**MATCHED, **CLEAR, wrap_reflectance=reflectance, film_mm=1e-6), 60_000, 16
    )
    absorbed, sigma = result.budget["absorbed_reflector"], result.budget_sigma["absorbed_reflector"]
    expected = _absorbed_in_open_box(reflectance, 200_000, 17)
    expected_sigma = math.sqrt(expected * (1 - expected) / 200_000)
    assert_compatible(absorbed, sigma, expected, expected_sigma)


def _absorbed_in_open_box(reflectance, count, seed):
    """Fraction absorbed by five Lambertian walls of a cube without a bottom."""
    rng = np.random.default_rng(seed)
    point = rng.random((count, 3))
    ray = rng.standard_normal((count, 3))
    absorbed = 0
    while len(point):
        steps = np.where(ray > 0, 1 - point, -point) / ray
        axis = steps.argmin(axis=1)
        rows = np.arange(len(point))
        high = ray[rows, axis] > 0
        stays = (axis != 2) | high
        reflected = rng.random(len(point)) < reflectance
        absorbed += np.count_nonzero(stays & ~reflected)
        point = np.clip(point + steps[rows, axis, None] * ray, 0, 1)
        point[rows, axis] = high
        # a point on the unit sphere that touches the wall from inside: the cosine law
        ray = rng.standard_normal(point.shape)
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        ray[rows, axis] += np.where(high, -1, 1)
        point, ray = point[stays & reflected], ray[stays & reflected]
    return absorbed / count


@pytest.mark.parametrize("film_mm", [0.01, 2.0])
def test_white_wrap_without_absorption_loses_nothing(film_mm):
    result = trace(
        bench_scene(alpha_abs_per_cm=0.0, n_gap=1.46, wrap_reflectance=1.0, film_mm=film_mm),
        10_000,
        8,
        max_depth=20_000,
    )
    counts = result.counts
    assert counts["absorbed_crystal"] == counts["truncated"] == counts["lost"] == 0
    # the wrap's outside absorbs; a wide rim lets light reach it and the mask
    ends = ("detected", "escaped", "absorbed_aperture", "absorbed_reflector")
    assert sum(counts[fate] for fate in ends) == result.photons


@pytest.mark.parametrize(
    ("n_gap", "polarization", "reference"),
    [(1.0, False, 0.2520), (1.46, False, 0.4335), (1.0, True, 0.2526), (1.46, True, 0.4332)],
)
def test_bench_has_the_reference_efficiency(n_gap, polarization, reference):
    # bench.md, first table; its statistical error is 0.1 % relative
    result = trace(bench_scene(n_gap=n_gap, polarization=polarization), 150_000, 9)
    assert_compatible(result.eta, result.eta_sigma, reference, 0.001 * reference, "eta")
    assert result.counts["lost"] == result.counts["truncated"] == 0
    assert sum(result.counts.values()) == result.photons


def test_runs_are_reproducible_whatever_the_threads_and_report_progress():
    done, scene = [], bench_scene()
    first = trace(scene, 40_000, 12, threads=1, progress=done.append, histories=True)
    assert done == sorted(done) and len(done) > 2 and done[-1] == 40_000
    again = trace(scene, 40_000, 12, threads=2, histories=True)
    assert first == again
    assert np.array_equal(first.histories.path_cm, again.histories.path_cm)
    assert first.counts != trace(scene, 40_000, 13).counts
    # photons have numbers of their own: the first of many are those of few
    assert trace(scene, 20_000, 12, histories=True).histories.path_cm.tolist() == (
        first.histories.path_cm[: trace(scene, 20_000, 12).counts["detected"]].tolist()
    )


def test_sigma_is_binomial_and_never_zero():
    result = trace(bench_scene(), 5_000, 14)
    eta = result.eta
    assert result.eta_sigma == pytest.approx(math.sqrt(eta * (1 - eta) / 5_000), rel=1e-3)
    assert result.counts["absorbed_gap"] == 0
    assert 0.5 / 5_000 < result.budget_sigma["absorbed_gap"] < 2 / 5_000
    assert math.fsum(result.budget.values()) == pytest.approx(1.0, abs=1e-15)


def test_a_part_that_is_not_known_is_refused_with_its_place(tmp_path):
    text = bench_scene().source(bench_scene().path).decode()
    for old, new, words in (
        ('"dielectric" id="crystal_to_air"', '"plastic" id="crystal_to_air"', "type plastic"),
        ('<bsdf type="photodetector"/>', '<bsdf type="mask"/>', "a bsdf of type mask"),
        ('type="rectangle" id="crystal_top"', 'type="bsplinecurve" id="crystal_top"', "bsplinecu"),
        ('<medium type="bulk" id="gap"/>', '<medium type="grid" id="gap"/>', "of type grid"),
    ):
        path = tmp_path / "other.xml"
        path.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=rf"other.xml, line \d+: .*does not know .*{words}"):
            trace(path, 10, 1)


@pytest.mark.parametrize(
    ("name", "value"),
    [("photons", 0), ("photons", 1e6 + 0.5), ("seed", -1), ("max_depth", 0), ("max_depth", True)],
)
def test_trace_refuses_numbers_that_are_not_counts(name, value):
    arguments = {"photons": 10, "seed": 1, name: value}
    with pytest.raises(InputError, match=name):
        trace(bench_scene(), **arguments)
