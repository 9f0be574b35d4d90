"""Mitsuba's own way in: mi.render, mi.traverse, derivatives, rays of the emitter, and their page.

Derivatives are compared with those of reweighting and with finite differences, at 3 sigma.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
from comparisons import assert_compatible
from places import BALL, ROOT, cases_of, mitsuba_alone
from scipy.stats import chisquare

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_surface import record_surface
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.bulk import lane_generators
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import ENVIRONMENT_VARIABLE, selected_llvm, use_variant

cases = cases_of(__file__)

SCAT, ABS = "crystal.alpha_scat_per_cm", "crystal.alpha_abs_per_cm"
PAGE = (ROOT / "docs" / "mitsuba.md").read_text()


@pytest.fixture
def mi():
    return use_variant()


@pytest.fixture
def load(mi, scenes):
    """A shipped scene as a user of Mitsuba has it."""

    def load(name="camoo4.xml", **parameters):
        texts = {name: str(value) for name, value in parameters.items()}
        return mi.load_file(str(scenes / name), parallel=False, optimize=False, **texts)

    return load


def sampled(mi, emitter, count=50_000):
    """Rays (Ray3f) and weights from a scene or an emitter of a scene."""
    rng = lane_generators(count, 3)
    one, *four = (rng.next_float32() for _ in range(5))
    sample = getattr(emitter, "sample_emitter_ray", None) or emitter.sample_ray
    return sample(0.0, one, mi.Point2f(*four[:2]), mi.Point2f(*four[2:]), True)[:2]


@cases("name")
def test_mitsuba_renders_a_shipped_scene(mi, load, scenes, name):
    scene = load(name)
    assert "LightMeter" in str(scene)
    image = mi.render(scene, spp=20_000, seed=1)
    ours = Simulation(scenes / name).collect(20_000, seed=1)
    assert image.shape == (1, 1, 1) and image.array[0] == np.float32(ours.eta)
    assert scene.integrator().tally.eta_sigma == ours.eta_sigma


@pytest.mark.parametrize("name", ["camoo4_wrapped.xml", "spectrophotometer.xml"])
def test_scenes_that_mitsuba_has_optimised_give_the_same_eta(mi, scenes, name):
    """It makes one face of those that are alike, without bounds, and one of alike media."""
    scene = mi.load_file(str(scenes / name))
    mi.render(scene, spp=100_000)
    found, ours = scene.integrator().tally, Simulation(scenes / name).collect(400_000, seed=5)
    assert_compatible(found.eta, found.eta_sigma, ours.eta, ours.eta_sigma, name, z_max=3)


def test_photons_are_as_many_as_the_sensor_says(mi, load):
    scene = load()
    for given, photons in (({}, 1_000_000), ({"photons": 30_000}, 30_000)):
        mi.render(scene, sensor=mi.load_dict({"type": "light_meter", **given}))
        assert scene.integrator().tally.photons == photons
    with pytest.raises(Exception, match="No sensor specified! Add a sensor in the scene"):
        mi.render(mi.load_file(str(BALL)))


def test_a_coefficient_that_was_set_is_one_that_was_loaded(mi, load):
    """To the last digit."""
    scene = load(n_gap=1.46)
    params = mi.traverse(scene)
    assert params[SCAT] == 0.54
    params[SCAT], params["window.alpha_abs_per_cm"] = 0.8, mi.Float64(0.3)
    params.update()
    found = mi.render(scene, spp=20_000)
    assert found.array[0] != mi.render(load(n_gap=1.46), spp=20_000).array[0]
    params["window.alpha_abs_per_cm"] = 0.0
    params.update()
    loaded = load(n_gap=1.46, alpha_scat_per_cm=0.8)
    assert mi.render(scene, spp=20_000).array[0] == mi.render(loaded, spp=20_000).array[0]


def test_derivatives_are_those_of_reweighting_and_of_finite_differences(mi, load, scenes):
    scene, photons = load(), 400_000
    params = mi.traverse(scene)
    for name in (SCAT, ABS):
        dr.enable_grad(params[name])
    dr.backward(3.0 * mi.render(scene, params, spp=photons, seed=1))
    slopes = scene.integrator().slopes
    bench = read_scene(scenes / "camoo4.xml")
    surface, _ = record_surface(bench, [(0.54, 0.039)], run=Run(photons=4_000_000, seed=2))
    exact = surface.evaluate(0.54, 0.039).gradient
    for name, step in ((SCAT, 0.1), (ABS, 0.02)):
        slope, sigma = slopes[name]
        assert params[name].grad[0] == pytest.approx(3.0 * slope)
        assert 0 < sigma < 0.2 * abs(slope)
        coefficient = name.removeprefix("crystal.")
        assert_compatible(slope, sigma, exact[coefficient], 0.3 * sigma, name, z_max=3)
        middle = bench.parameters[coefficient]
        ends = [
            Simulation(bench, {coefficient: middle + side}).collect(10**6, seed=3)
            for side in (-step, step)
        ]
        # the same photons on both ends: the errors of eta nearly cancel
        difference = (ends[1].eta - ends[0].eta) / (2 * step)
        error = np.hypot(ends[0].eta_sigma, ends[1].eta_sigma) / (2 * step)
        assert_compatible(slope, sigma, difference, error, name, z_max=3)
    # along both at once, from the same photons
    for name, along in ((SCAT, 2.0), (ABS, 5.0)):
        dr.set_grad(params[name], along)
    eta = mi.render(scene, params, spp=photons, seed=1)
    change = dr.forward_to(eta).array[0]
    assert change == pytest.approx(2.0 * slopes[SCAT][0] + 5.0 * slopes[ABS][0], rel=1e-5)


def test_absorption_that_is_not_there_has_a_derivative(mi, load, scenes):
    """Of the window: light crosses at least its millimetre."""
    scene, name = load(n_gap=1.46), "window.alpha_abs_per_cm"
    params = mi.traverse(scene)
    dr.enable_grad(params[name])
    dr.backward(mi.render(scene, params, spp=200_000))
    slope, sigma = scene.integrator().slopes[name]
    etas = []
    for alpha in (0.0, 0.02):
        params[name] = alpha
        etas.append(scene.integrator().render(scene, spp=200_000).array[0])
    assert_compatible(slope, sigma, (etas[1] - etas[0]) / 0.02, 0.005 * abs(slope), z_max=3)
    assert slope < -0.1 * etas[0]


def test_what_has_no_derivative_is_refused(mi, load):
    scene = load()
    params = mi.traverse(scene)
    for name, said in (
        ("window_beside_gap.vertex_positions", "there is no derivative of eta by window_beside"),
        ("gap.alpha_scat_per_cm", "gap.alpha_scat_per_cm is 0, and light that does not scatter"),
    ):
        dr.enable_grad(params[name])
        with pytest.raises(InputError, match=said):
            dr.backward(mi.render(scene, params, spp=1000))
        dr.disable_grad(params[name])
    params[SCAT] = -0.1
    with pytest.raises(InputError, match=r"alpha_scat_per_cm of medium 'crystal' is -0\.1; give"):
        scene.integrator().render(scene)
    dark = mi.load_string('<scene version="3.0.0"><integrator type="light_collection"/></scene>')
    with pytest.raises(InputError, match="the scene has 0 scintillation emitters, not one"):
        dark.integrator().render(dark)


def test_a_loaded_scenes_emitter_gives_rays_from_the_crystal(mi, load):
    """Evenly, in any direction; chi-square over ten slices at a false-alarm level of 1e-4."""
    wide, other = load(crystal_height_mm=20), load()
    ray, weight = sampled(mi, wide.emitters()[0])
    assert np.allclose(np.array(weight), 1.0)
    for axis, (low, high) in enumerate(((-5, 5), (-5, 5), (0, 20))):
        counts, _ = np.histogram(np.array(ray.o[axis]), bins=10, range=(low, high))
        assert counts.sum() == 50_000 and chisquare(counts).pvalue > 1e-4
        counts, _ = np.histogram(np.array(ray.d[axis]), bins=10, range=(-1, 1))
        assert counts.sum() == 50_000 and chisquare(counts).pvalue > 1e-4
    assert float(dr.max(sampled(mi, other.emitters()[0])[0].o.z)[0]) < 10.0
    # one of several, which Mitsuba calls while it records
    sky = {"sky": {"type": "constant"}, "light": other.emitters()[0]}
    faces = {shape.id(): shape for shape in other.shapes()}
    both = mi.load_dict({"type": "scene", **sky, **faces}, optimize=False)
    # beside one of another scene that lives on and cannot be lit: it is asked too then
    wide_beam = load("spectrophotometer.xml", beam_diameter_mm=10.5)
    with pytest.raises(InputError, match=r"the beam is 10\.5 mm wide"):
        sampled(mi, wide_beam.emitters()[0])
    ray, _ = sampled(mi, both)
    assert np.isfinite(np.array(ray.d)).all()
    inside = dr.all(dr.abs(ray.o - mi.Point3f(0, 0, 5)) <= 5.0)
    assert 0.45 < np.mean(np.array(inside)) < 0.56


def test_rays_of_a_ball_and_of_a_beam(mi, load):
    ball = mi.load_file(str(BALL))
    ray, _ = sampled(mi, ball.emitters()[0])
    shares = np.array(dr.norm(ray.o - mi.Point3f(1, -2, 3)) / 5.0) ** 3
    counts, _ = np.histogram(shares, bins=10, range=(0, 1))
    assert counts.sum() == 50_000 and chisquare(counts).pvalue > 1e-4
    beam = load("spectrophotometer.xml")
    ray, _ = sampled(mi, beam.emitters()[0], 1000)
    assert np.allclose(np.array(ray.d), [[1.0], [0.0], [0.0]])


def run(*words) -> subprocess.CompletedProcess:
    """A process that finds an LLVM as good as ours, whoever imports Dr.Jit first."""
    variables = os.environ | {ENVIRONMENT_VARIABLE: selected_llvm().path}
    return subprocess.run(words, capture_output=True, text=True, cwd=ROOT, env=variables)


@mitsuba_alone
def test_the_package_may_come_after_mitsubas_variant():
    done = run(
        sys.executable,
        "-c",
        "import mitsuba as mi; mi.set_variant('llvm_ad_mono'); import mcrim_mitsuba as mcrim\n"
        "assert mcrim.use_variant('llvm_ad_mono') is mi\n"
        "print(mi.render(mi.load_file('scenes/camoo4.xml'), spp=20_000).shape)",
    )
    assert done.stdout == "(1, 1, 1)\n", done.stderr


def test_the_page_does_what_it_says():
    """All its code, in a process of its own."""
    first, rest, derivatives, along, optimiser, rays = re.findall(
        r"```python\n(.*?)```", PAGE, re.DOTALL
    )
    code = [first, "first = eta", rest, derivatives, along, "change = eta.grad.array[0]"]
    code += [f"slopes = scene.integrator().slopes['{ABS}']", optimiser, rays]
    code += ["print(first, change, *slopes, eta.array[0], dr.all(dr.abs(ray.o.z - 5) < 5)[0])"]
    done = run(sys.executable, "-c", "\n".join(code))
    first, change, slope, sigma, last, inside = done.stdout.split()[-6:]
    assert abs(float(first) - 0.4335) < 0.004 and "±" in done.stdout, done.stderr
    assert float(change) == pytest.approx(float(slope)) == pytest.approx(-1.18, abs=0.02)
    assert 0.0 < float(sigma) < 0.01 and inside == "True"
    assert float(last) == pytest.approx(0.4, abs=0.012)


@mitsuba_alone
def test_mitsubas_own_command_knows_no_plugins_of_python():
    done = run(Path(sys.executable).with_name("mitsuba"), "scenes/camoo4.xml", "-m", "llvm_ad_rgb")
    assert done.returncode != 0
    # whichever it met first
    assert re.search(r'failed to instantiate \w+ plugin .*Plugin "\w+" not found!', done.stderr)
