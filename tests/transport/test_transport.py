"""The transport against closed forms, against itself on its other path, and its books.

Statistical tests use fixed seeds and z < 4: with some sixty comparisons a correct program
would fail this file with a probability of 0.4 %.
"""

from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest
from comparisons import (
    assert_all_light_is_told,
    assert_compatible,
    assert_same_eta,
    assert_same_fates,
)
from places import BALL

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.table import eta_table
from mcrim_mitsuba.optics.fresnel import amplitudes, escape_fraction, reflectance, trapped_fraction
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport import collection, dielectric
from mcrim_mitsuba.transport import loop as transport
from mcrim_mitsuba.transport import surface_physics as physics
from mcrim_mitsuba.transport.bulk import lane_generators
from mcrim_mitsuba.transport.launch_plan import LANES, plan_lanes
from mcrim_mitsuba.transport.scene_model import DIELECTRIC, Surface
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import use_variant

Z = 4.0
CLEAR = {"alpha_scat_per_cm": 0, "alpha_abs_per_cm": 0}
INDEX_MATCHED = {"n_crystal": 1, "n_gap": 1, "n_window": 1}


def from_box(rng, photons):
    """Births in the default crystal, directions, and distances to its faces."""
    position = (rng.random((photons, 3)) - (0.5, 0.5, 0.0)) * 10.0
    direction = rng.standard_normal((photons, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    far = np.where(direction > 0, (5.0, 5.0, 10.0), (-5.0, -5.0, 0.0))
    return position, direction, ((far - position) / direction).min(axis=1)


@pytest.mark.parametrize("n", [2.01, 1.6])
@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
def test_clear_cube_traps_what_the_closed_form_says_and_ends(scenes, n, general):
    simulation = Simulation(scenes / "camoo4.xml", CLEAR | {"n_crystal": n}, check=False)
    # the last of the flat cases ends by the limit of its own; what is not trapped is out earlier
    for photons, max_depth in [(40_000, 300)] if general else [(4 * LANES, 300), (2_000, None)]:
        result = simulation.collect(photons, seed=1, general=general, max_depth=max_depth)
        trapped = trapped_fraction(n)
        sigma = np.sqrt(trapped * (1 - trapped) / result.photons)
        assert_compatible(result.budget["truncated"], sigma, trapped, z_max=Z)
    # what is not trapped comes out: a sixth of it through each face (Eq. 6)
    assert 1 - trapped == pytest.approx(6 * escape_fraction(n))
    assert any("still under way" in note for note in result.notes)


@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
def test_beer_lambert(scenes, general):
    result = Simulation(
        scenes / "camoo4.xml", INDEX_MATCHED | {"alpha_scat_per_cm": 0, "alpha_abs_per_cm": 1.5}
    ).collect(300_000, seed=2, general=general)
    *_, distance = from_box(np.random.default_rng(2), 400_000)
    absorbed = 1 - np.exp(-0.15 * distance)
    expected, error = absorbed.mean(), absorbed.std() / np.sqrt(len(absorbed))
    fate = "absorbed_crystal"
    assert_compatible(result.budget[fate], result.budget_sigma[fate], expected, error, z_max=Z)


def test_free_path_law_and_number_of_scatterings(scenes):
    """Unscattered light at the detector: exp(-alpha d) of what flies straight to it."""
    simulation = Simulation(
        scenes / "camoo4.xml", INDEX_MATCHED | {"alpha_scat_per_cm": 2, "alpha_abs_per_cm": 0}
    )
    photons = 409_600
    found = transport.launch(
        collection.choose_path(simulation.model, False),
        simulation.crystal,
        plan_lanes(photons),
        seed=3,
        number=0,
        max_depth=2000,
        columns=(),
    )
    k = found.records["k"]
    ours = np.count_nonzero(k == 0) / photons
    position, direction, distance = from_box(np.random.default_rng(3), photons)

    def at_height(z):
        return position + (z - position[:, 2:]) / direction[:, 2:] * direction

    at_mask, at_back = at_height(-0.05), at_height(-1.05)
    hits = direction[:, 2] < 0
    hits &= np.hypot(at_mask[:, 0], at_mask[:, 1]) < 14
    hits &= np.abs(at_back[:, :2]).max(axis=1) < 14
    straight = np.exp(-0.2 * distance) * hits
    sigma = np.sqrt(ours / photons)
    assert_compatible(ours, sigma, straight.mean(), straight.std() / np.sqrt(photons), z_max=Z)
    assert k.max() > 5


def ball(n=1.0, **overrides) -> Simulation:
    """Of radius 5 mm, within a sphere that detects all."""
    return Simulation(BALL, {"n": n, "alpha_scat_per_cm": 0, **overrides}, check=False)


@pytest.mark.parametrize("x", [0.1, 1.0, 4.0])
def test_sphere_on_the_general_path(x):
    """Escape from an absorbing sphere with an isotropic source, e.g. Case et al. 1953."""
    result = ball(alpha_abs_per_cm=x / 0.5).collect(100_000, seed=4)
    assert "Mitsuba for" in result.transport
    escape = 3 / (8 * x**3) * (2 * x**2 - 1 + (1 + 2 * x) * np.exp(-2 * x))
    assert_compatible(result.eta, result.eta_sigma, escape, z_max=Z)
    assert sum(result.budget.values()) == pytest.approx(1, abs=1e-6)


def test_without_absorption_all_light_comes_out_of_a_scattering_ball():
    simulation = ball(1.9, alpha_abs_per_cm=0, alpha_scat_per_cm=1)
    result = simulation.collect(20_000, seed=5)
    assert result.eta + result.budget["truncated"] == pytest.approx(1, abs=1e-6)
    assert result.budget["truncated"] < 1e-3


@pytest.mark.parametrize("polarization", [False, True], ids=["unpolarised", "polarised"])
@pytest.mark.parametrize("scene", ["camoo4", "camoo4_wrapped"])
def test_both_paths_agree_and_account_for_all_light(scenes, scene, polarization):
    simulation = Simulation(scenes / f"{scene}.xml", {"polarization": polarization, "n_gap": 1.46})
    fast, slow = (
        simulation.collect(200_000, seed=seed, general=general)
        for seed, general in ((6, False), (7, True))
    )
    assert fast.transport != slow.transport
    assert_all_light_is_told(fast, slow)
    assert_same_fates(fast, slow, z_max=Z, rare=1e-4)


@pytest.mark.parametrize(
    ("n_gap", "polarization", "eta"),
    [(1.0, False, 0.2520), (1.46, False, 0.4335), (1.0, True, 0.2526), (1.46, True, 0.4332)],
)
def test_bench_gives_the_reference_efficiency(scenes, n_gap, polarization, eta):
    """An independent exact calculation of the bench, itself good to 0.1 %."""
    result = Simulation(
        scenes / "camoo4.xml", {"n_gap": n_gap, "polarization": polarization}
    ).collect(3_000_000, seed=8)
    assert_compatible(result.eta, result.eta_sigma, eta, 0.001 * eta, z_max=3)
    assert result.eta == pytest.approx(eta, rel=0.003)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_mono_polarized", "llvm_ad_rgb"])
def test_every_variant_gives_the_same_photons(scenes, variant):
    """Light is monochromatic and polarisation is a parameter of the scene, not of the variant."""
    for general in (False, True):
        result = Simulation(scenes / "camoo4.xml", variant=variant).collect(
            100_000, seed=9, general=general
        )
        reference = 0.2520
        assert_compatible(result.eta, result.eta_sigma, reference, z_max=Z)


def test_same_seed_same_digits_whatever_the_threads(scenes):
    def run(seed, threads):
        simulation = Simulation(scenes / "camoo4.xml", threads=threads)
        return simulation.collect(200_000, seed=seed)

    first, again, one_thread, other = run(1, 2), run(1, 2), run(1, 1), run(2, 2)
    assert first.budget == again.budget
    for fate, value in first.budget.items():
        assert one_thread.budget[fate] == pytest.approx(value, rel=1e-12)
    assert first.eta != other.eta


def test_one_kernel_serves_every_number(scenes):
    """Seeds, coefficients, indices and sizes are data; only the kind of scene is code."""

    def kernels(simulation, seed, general):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            simulation.collect(1000, seed=seed, general=general)
            return {kernel["hash"] for kernel in dr.kernel_history([dr.KernelType.JIT])}

    bench = Simulation(scenes / "camoo4.xml")
    other = Simulation(
        scenes / "camoo4.xml", {"n_gap": 1.46, "gap_mm": 0.3, "alpha_abs_per_cm": 0.1}
    )
    assert kernels(bench, 1, False) == kernels(other, 2, False)
    # Mitsuba's own plugins are part of the code that calls them: one kernel per loaded scene
    assert kernels(bench, 1, True) == kernels(bench, 2, True)


def test_errors_are_the_spread_between_seeds(scenes):
    simulation = Simulation(scenes / "camoo4.xml")
    runs = [simulation.collect(20_000, seed=seed) for seed in range(60)]
    for fate in ("detected", "absorbed_crystal", "absorbed_aperture", "escaped"):
        spread = np.std([run.budget[fate] for run in runs], ddof=1)
        stated = np.mean([run.budget_sigma[fate] for run in runs])
        # the spread of 60 values is known to 9 %
        assert spread / stated == pytest.approx(1, abs=4 * 0.092), fate


def test_interrupt_reports_what_was_done(scenes, monkeypatch):
    simulation = Simulation(scenes / "camoo4.xml")
    launches = []

    real = transport.launch

    def interrupted(*args, **options):
        if len(launches) == 2:
            raise KeyboardInterrupt
        launches.append(args[2].photons.sum())
        return real(*args, **options)

    monkeypatch.setattr(transport, "launch", interrupted)
    monkeypatch.setattr(collection, "PER_LANE_FLAT", 1)
    result = simulation.collect(10**9, seed=1)
    assert result.interrupted
    assert result.photons == sum(launches) == collection.FIRST_LAUNCH + LANES
    assert "interrupted after" in result.notes[0]


def test_precision_is_reached_and_no_more(scenes):
    result = Simulation(scenes / "camoo4.xml").collect(10**8, precision=0.004, seed=1)
    assert result.eta_sigma / result.eta <= 0.004
    assert result.photons < 6_000_000


def test_a_leaking_scene_gives_no_number(scenes, tmp_path):
    text = (scenes / "camoo4.xml").read_text()
    start = text.index('  <shape type="rectangle" id="crystal_top">')
    path = tmp_path / "open.xml"
    path.write_text(text[:start] + text[text.index("</shape>", start) + 8 :])
    with pytest.raises(InputError, match="without crossing a face"):
        Simulation(path, check=False).collect(10_000)
    with pytest.raises(InputError, match="not closed at z = 10"):
        Simulation(path)


def test_fresnel_both_ways():
    """Reflection is chosen exactly below the closed form's reflectance, from either side."""
    mi = use_variant()
    n_in, n_out = 2.01, 1.46
    cosines = np.linspace(0.02, 1.0, 200)
    face = Surface("face", 1, 0, DIELECTRIC, eta=n_in / n_out)
    table = physics.SurfaceTables([face], [(0, 0, 1)])
    rows = table.at(dr.zeros(mi.UInt32, 200), mi.Bool(True))
    for sign, (n_from, n_to) in ((1.0, (n_in, n_out)), (-1.0, (n_out, n_in))):
        expected = reflectance(cosines, n_from, n_to)
        direction = mi.Vector3f(np.sqrt(1 - cosines**2), 0.0, sign * cosines)
        for shift, crosses in ((1e-4, True), (-1e-4, False)):
            choice = expected + shift
            outcome = physics.interact(
                rows,
                mi.Point3f(0.0),
                direction,
                None,
                (mi.Float(choice), mi.Float(0.5), mi.Float(0.5)),
            )
            possible = (choice > 0) & (choice < 1)
            assert np.all((np.array(outcome.crossed) == crosses)[possible])
            bent = np.array(outcome.direction)
            sine = np.sqrt(1 - cosines**2) * (n_from / n_to if crosses else 1.0)
            assert bent[0][possible] == pytest.approx(sine[possible], abs=1e-5)  # Snell's law


def test_polarised_reflection_follows_the_amplitudes():
    """Reflectance and phase of s, p and mixed light, total reflection included."""
    mi = use_variant()
    cosines = np.linspace(0.05, 0.999, 100)
    sines = np.sqrt(1 - cosines**2)
    r_s, r_p = amplitudes(cosines, 2.01, 1.0)
    table = physics.SurfaceTables([Surface("face", 1, 0, DIELECTRIC, eta=2.01)], [(0, 0, 1)])
    rows = table.at(dr.zeros(mi.UInt32, 100), mi.Bool(True))
    direction = mi.Vector3f(sines, 0.0, cosines)
    for c_s, c_p in ((1.0, 0.0), (0.0, 1.0), (np.sqrt(0.5), np.sqrt(0.5))):
        # s along y, p in the plane of incidence
        field = dielectric.Field(
            mi.Vector3f(c_p * cosines, float(c_s), -c_p * sines), mi.Vector3f(0.0)
        )
        expected = np.abs(r_s * c_s) ** 2 + np.abs(r_p * c_p) ** 2
        for shift in (1e-4, -1e-4):
            outcome = physics.interact(
                rows,
                mi.Point3f(0.0),
                direction,
                field,
                (mi.Float(expected + shift), mi.Float(0.5), mi.Float(0.5), mi.Float(0.0)),
            )
            possible = (expected + shift > 0) & (expected + shift < 1)
            assert np.all((np.array(outcome.crossed) == (shift > 0))[possible])
        new = np.array(outcome.field.re) + 1j * np.array(outcome.field.im)
        # reflected: direction (sin, 0, -cos); p along direction x y
        along_p = new[0] * -cosines + new[2] * -sines
        along_s = new[1]
        reflected = ~np.array(outcome.crossed)
        if c_s and c_p:
            ratio = (along_p / along_s)[reflected]
            # p is d x s before and after, as in the closed form
            assert np.allclose(ratio, (r_p / r_s)[reflected], atol=1e-3, rtol=1e-3)
        assert np.allclose(np.abs(along_p) ** 2 + np.abs(along_s) ** 2, 1, atol=1e-5)


def test_a_lanes_photons_do_not_depend_on_how_the_last_one_ended(scenes, tmp_path, monkeypatch):
    """A rough face may decide by its random direction that a photon ends; the next is isotropic.

    With one photon per lane there is no last one: both must give the same.
    """
    text = (scenes / "camoo4.xml").read_text()
    rough = text.replace(
        '<bsdf type="dielectric" id="crystal_to_air">',
        '<bsdf type="roughdielectric" id="crystal_to_air"><float name="alpha" value="0.6"/>',
    )
    path = tmp_path / "rough.xml"
    path.write_text(rough)
    simulation = Simulation(path, {"alpha_abs_per_cm": 0, "aperture_radius_mm": 400})
    many = simulation.collect(250_000, seed=11)
    monkeypatch.setattr(collection, "PER_LANE_GENERAL", 1)
    monkeypatch.setattr(collection, "FIRST_LAUNCH", LANES)
    single = simulation.collect(250_000, seed=12)
    assert {"detected", "absorbed_surface", "escaped"} <= set(many.budget)
    assert_same_fates(many, single, z_max=Z)


def test_tables_do_not_lose_the_light_that_takes_long(scenes):
    """Without absorption all light gets out, however late: no depth limit may cut it off."""
    bench = {"crystal_width_mm": 1, "crystal_height_mm": 1}
    bare = read_scene(scenes / "camoo4.xml", bench)
    axes = {"n_gap": [1.0], "alpha_abs_per_cm": [0.0], "alpha_scat_per_cm": [0.05]}
    (row,) = eta_table(bare, axes, run=Run(30_000, seed=1)).rows
    clear = bench | {"alpha_scat_per_cm": 0.05, "alpha_abs_per_cm": 0}
    patient = Simulation(scenes / "camoo4.xml", clear).collect(30_000, seed=2, max_depth=10**6)
    assert patient.budget["truncated"] == 0
    assert_same_eta(SimpleNamespace(**row), patient, z_max=Z)


def test_seeds_beyond_32_bits_are_seeds_of_their_own():
    first, second = lane_generators(8, 3, 5), lane_generators(8, 5 * 2**32 + 3, 0)
    assert not np.array_equal(np.array(first.state), np.array(second.state))
