"""The independent tracer's beam, hazy faces and rough faces one by one, against closed forms.

Seeds are fixed, so a test passes or fails for good. Statistical tests ask for |z| < 4.5, which a
correct tracer exceeds with probability 7e-6; the file makes about 90 such comparisons, so 6e-4 is
the chance that a new seed makes a correct tracer fail.
"""

import math

import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_compatible, assert_same_eta
from many import births, cross, dot, hazy_directions, lambertian, unpolarised_reflectance
from places import cases_of

from mcrim_mitsuba.reference import interface
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.reference.tracer import trace

cases = cases_of(__file__)

BEAM = {"beam_diameter_mm": 3.0, "alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.02}


def through_slab(n, absorbed_part, specular=(1.0, 1.0)):
    """Transmittance of a slab, all of whose reflections are collected.

    `specular`: what haze leaves of the transmission and of the inner reflection of a face.
    """
    face = ((n - 1.0) / (n + 1.0)) ** 2
    inside, through = 1.0 - absorbed_part, (1.0 - face) * specular[0]
    return through**2 * inside / (1.0 - (face * specular[1] * inside) ** 2)


@pytest.mark.parametrize("n", [1.82, 2.01])
def test_the_polished_crystal_follows_the_closed_form(n):
    for number, (scat, absorption) in enumerate(
        (s, a) for s in (0.0, 0.02, 0.1, 0.5) for a in (0.005, 0.05, 0.2)
    ):
        found = trace(
            bench_scene(
                n_crystal=n,
                beam_diameter_mm=3.0,
                alpha_scat_per_cm=scat,
                alpha_abs_per_cm=absorption,
                acceptance_deg=0.3,
            ),
            60_000,
            100 + number,
        )
        exact = through_slab(n, -math.expm1(-(scat + absorption)))
        assert_compatible(found.eta, found.eta_sigma, exact, what=f"{scat}, {absorption}")
        assert found.counts["lost"] == 0
        # what comes back from the two faces, and what is scattered backwards
        assert found.budget["escaped"] > ((n - 1) / (n + 1)) ** 2


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_way_through_the_crystal_is_its_size_along_the_beam(axis):
    bench = bench_scene(**BEAM | {"alpha_abs_per_cm": 0.4}, beam_axis=axis, crystal_height_mm=4.0)
    found = trace(bench, 60_000, 1)
    path = 0.4 if axis == "z" else 1.0
    assert_compatible(found.eta, found.eta_sigma, through_slab(2.01, -math.expm1(-0.4 * path)))


def test_a_beam_is_round_even_and_centred():
    bench = read_bench(bench_scene(**BEAM, crystal_height_mm=6.0))
    (x, y, z), direction = births(bench, np.random.default_rng(2), 50_000)
    z -= 3.0
    assert (x < -5.0).all()
    radius2 = y * y + z * z
    assert radius2.max() <= 1.5**2
    count = y.size
    assert_compatible(radius2.mean(), 1.5**2 / math.sqrt(12 * count), 1.5**2 / 2)
    for across in (y, z):
        assert_compatible(across.mean(), 0.75 / math.sqrt(count), 0.0)
    np.testing.assert_array_equal(direction, np.repeat([[1.0], [0.0], [0.0]], count, 1))


@pytest.mark.parametrize("axis", ["x", "z"])
def test_histories_of_all_light_answer_every_acceptance(axis):
    bench = {
        "beam_diameter_mm": 3.0,
        "beam_axis": axis,
        "alpha_scat_per_cm": 0.5,
        "scattering_g": 0.9,
        "polarization": axis == "z",
    }
    wide = bench_scene(**bench, acceptance_deg=90.0)
    everything = trace(wide, 60_000, 3, histories=True).histories
    assert everything.arrival_radius_mm.max() < math.hypot(5.0, 5.0)
    for angle in (1.0, 5.0, 30.0):
        within = np.count_nonzero(everything.arrival_cosine >= math.cos(math.radians(angle)))
        direct = trace(bench_scene(**bench, acceptance_deg=angle), 60_000, int(10 + angle))
        part = within / 60_000
        sigma = math.sqrt(part * (1 - part) / 60_000)
        assert_compatible(direct.eta, direct.eta_sigma, part, sigma, f"{angle}")


@pytest.mark.parametrize(("n_in", "n_out"), [(2.01, 1.0), (1.0, 2.01), (2.01, 1.46)])
def test_haze_takes_its_part_of_the_specular_light(n_in, n_out):
    """1 - exp(-q^2) of what is reflected and of what is refracted.

    It leaves by Lambert's law times what light on the way back would have been reflected or
    refracted, and scattered.
    """
    rng, count, heights = np.random.default_rng(4), 60_000, 20.0 / 540.0
    axis = (0.0, 0.6, 0.8)

    def scattered(path):
        return -np.expm1(-((2.0 * math.pi * heights * path) ** 2))

    def backwards(through):
        """Cosines, and the density of what is scattered to them."""
        near, far = (n_out, n_in) if through else (n_in, n_out)
        cosine = (np.arange(20_000) + 0.5) / 20_000
        beyond = np.sqrt(np.maximum(0.0, 1.0 - (near / far) ** 2 * (1.0 - cosine**2)))
        reflected = unpolarised_reflectance(cosine, near, far)
        density = cosine * (
            (1.0 - reflected) * scattered(near * cosine - far * beyond)
            if through
            else reflected * scattered(2.0 * near * cosine)
        )
        return cosine, density / density.sum()

    for angle in (0.0, 25.0, 60.0):
        cos_in = math.cos(math.radians(angle))
        sine = n_in / n_out * math.sin(math.radians(angle))
        phases = {False: 2.0 * n_in * cos_in}
        if sine < 1.0:
            phases[True] = abs(n_in * cos_in - n_out * math.sqrt(1.0 - sine * sine))
        for through, path in phases.items():
            found = interface.haze(cos_in, n_in, n_out, through, heights)[1]
            assert found == pytest.approx(scattered(path), rel=1e-12)
            direction = hazy_directions(rng, axis, n_in, n_out, through, heights, count)
            away = dot(direction, axis) * (1.0 if through else -1.0)
            assert away.min() > 0.0
            cosine, density = backwards(through)
            for power in (1, 2, 8):
                values = away**power
                error = values.std() / math.sqrt(count)
                assert_compatible(values.mean(), error, density @ cosine**power, 1e-5)
            if through and n_out > n_in:
                # nothing comes back through a face under total reflection
                assert away.min() > math.sqrt(1.0 - (n_in / n_out) ** 2)


@pytest.mark.parametrize("polarization", [False, True])
def test_a_hazy_beam_keeps_its_specular_part(polarization):
    n, height = 2.01, 25.0 / 600.0
    bench = bench_scene(
        **BEAM,
        rms_roughness_nm=22.5,  # at 540 nm
        acceptance_deg=0.2,
        polarization=polarization,
    )
    found = trace(bench, 200_000, 5)
    kept = [math.exp(-((2.0 * math.pi * height * path) ** 2)) for path in (n - 1.0, 2.0 * n)]
    exact = through_slab(n, -math.expm1(-0.02), kept)
    assert_compatible(found.eta, found.eta_sigma, exact)
    assert sum(found.counts.values()) == found.photons and found.counts["lost"] == 0


def test_light_that_haze_scatters_has_no_polarisation_left():
    rng, count = np.random.default_rng(6), 40_000
    normal = np.repeat([[1.0], [0.0], [0.0]], count, axis=1)
    way = lambertian(rng, normal)
    s = np.cross(way.T, [1.0, 0.0, 0.0]).T
    s /= np.sqrt(dot(s, s))
    # heights of two wavelengths leave nothing specular
    direction, transmitted, field = cross(rng, way, normal, 2.01, 1.0, s.astype(complex), 2.0)
    direction, field = direction[:, ~transmitted], field[:, ~transmitted]
    assert (direction[0] < 0.0).all()
    np.testing.assert_allclose(np.abs(dot(field, direction)), 0.0, atol=1e-12)
    s = np.cross(direction.T, [1.0, 0.0, 0.0]).T
    s /= np.sqrt(dot(s, s))
    power = np.abs(dot(field, s)) ** 2
    assert_compatible(power.mean(), power.std() / math.sqrt(power.size), 0.5)


def test_rough_faces_one_by_one_are_all_faces():
    for bench in ({"n_gap": 1.46}, {**BEAM, "acceptance_deg": 30.0}):
        sizes = dict.fromkeys(
            ("top_roughness_alpha", "side_roughness_alpha", "bottom_roughness_alpha"), 0.1
        )
        each = trace(bench_scene(**bench, **sizes), 5_000, 8)
        assert each == trace(bench_scene(**bench, roughness_alpha=0.1), 5_000, 8)
        assert each != trace(bench_scene(**bench), 5_000, 8)


@pytest.mark.parametrize(
    ("axis", "unseen"), [("x", ("top", "bottom")), ("y", ("top", "bottom")), ("z", ("side",))]
)
def test_a_beam_meets_the_faces_that_it_goes_through(axis, unseen):
    bench = {**BEAM, "beam_axis": axis, "acceptance_deg": 30.0}
    plain = trace(bench_scene(**bench), 5_000, 9)
    for face in ("top", "side", "bottom"):
        rough = trace(bench_scene(**bench, **{f"{face}_roughness_alpha": 0.1}), 5_000, 9)
        assert (rough == plain) == (face in unseen)


def test_a_chamfer_takes_what_it_covers_from_a_wide_beam():
    """A plane beam of the whole width, which a clear crystal of index 1 only shades."""
    bench = bench_scene(
        n_crystal=1.0,
        alpha_scat_per_cm=0.0,
        alpha_abs_per_cm=5.0,
        beam_diameter_mm=9.999,
        chamfer_mm=1.0,
        acceptance_deg=90.0,
    )
    rng = np.random.default_rng(10)
    radius, azimuth = 4.9995 * np.sqrt(rng.random(400_000)), 2.0 * np.pi * rng.random(400_000)
    y, z = radius * np.cos(azimuth), radius * np.sin(azimuth)
    # both ends of a line are cut where it is within the leg of an edge
    short = np.maximum(0.0, np.maximum(np.abs(y), np.abs(z)) - 4.0)
    expected = np.exp(-0.5 * (10.0 - 2.0 * short))
    found = trace(bench, 100_000, 11)
    error = expected.std() / math.sqrt(expected.size)
    assert_compatible(found.eta, found.eta_sigma, expected.mean(), error)


@cases("own", "air", "gel", "error")
def test_the_numbers_of_another_tracer(own, air, gel, error):
    """A third program's efficiencies, with their errors."""
    for number, (n_gap, expected) in enumerate(((1.0, air), (1.46, gel))):
        found = trace(bench_scene(n_gap=n_gap, **own), 60_000, 12 + number)
        assert_compatible(found.eta, found.eta_sigma, expected, error)


@pytest.mark.parametrize(("rms_nm", "expected"), [(2.0, 0.56005), (10.0, 0.22180)])
def test_light_trapped_by_hazy_faces_is_absorbed_as_in_another_program(rms_nm, expected):
    """A third program's absorption, to 0.0005: a clear cube in air, hundreds of reflections.

    It knows this cube only, and draws what is scattered from a table of the density's integral.
    """
    clear = {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.01}
    bench = bench_scene(n_gap=1.0, n_window=1.0, rms_roughness_nm=rms_nm, **clear)
    found = trace(bench, 40_000, 17, max_depth=200_000)
    absorbed, sigma = (x["absorbed_crystal"] for x in (found.budget, found.budget_sigma))
    assert_compatible(absorbed, sigma, expected, 5e-4)


def test_polarisation_is_nothing_to_normal_incidence():
    polarised = trace(bench_scene(**BEAM, polarization=True), 60_000, 14)
    assert_same_eta(polarised, trace(bench_scene(**BEAM), 60_000, 15))
