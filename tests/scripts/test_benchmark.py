"""The scalar tracer that speeds are compared with has the physics of the independent tracer."""

import math

import pytest
from bench_scene import bench_scene
from benchmark import scalar

from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.reference.tracer import trace

PHOTONS = 100_000
SMALL_MASK = {"gap_mm": 0.5, "aperture_radius_mm": 4.0}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    try:
        return scalar.build(tmp_path_factory.mktemp("scalar"))
    except scalar.ScalarTracerError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("numbers", [{"n_gap": 1.46}, SMALL_MASK], ids=["gel", "small mask"])
def test_every_fate_is_that_of_the_independent_tracer(program, numbers):
    """|z| below 4 for five fates of two benches: by chance 6e-4 of the seeds would fail."""
    numpy = trace(bench_scene(**numbers), PHOTONS, seed=1)
    found = scalar.trace_scalar(program, Bench(**numbers), 20 * PHOTONS, seed=2)
    assert sum(found["fates"].values()) == pytest.approx(1.0, abs=1e-9)
    assert found["fates"]["detected"] == found["eta"]
    for fate, value in found["fates"].items():
        # of whole photons; weights vary less
        sigma = math.hypot(numpy.budget_sigma[fate], math.sqrt(value * (1 - value) / 20 / PHOTONS))
        assert abs(value - numpy.budget[fate]) < 4.0 * sigma, (fate, value, numpy.budget)


def test_trapped_light_in_one_step_and_other_threads_give_the_same(program):
    bench = Bench(**SMALL_MASK)
    found = scalar.trace_scalar(program, bench, PHOTONS, seed=3, threads=1)
    again = scalar.trace_scalar(program, bench, PHOTONS, seed=3, threads=3)
    assert again["fates"] == found["fates"]
    other = scalar.trace_scalar(program, bench, PHOTONS, seed=4)
    assert other["eta"] != found["eta"]
    # the same random numbers, and so the same photons, up to rounding at a decision
    unfolded = scalar.trace_scalar(program, bench, PHOTONS, seed=3, unfold=True)
    assert unfolded["eta"] == pytest.approx(found["eta"], rel=1e-3)


def test_light_that_is_trapped_for_ever_ends(program):
    """Of a bare cube 1 - 3 (1 - sqrt(1 - 1/n^2)) is trapped: |z| below 4, by chance 1e-4 fail."""
    bench = Bench(alpha_scat_per_cm=0.0, alpha_abs_per_cm=0.0, aperture_radius_mm=1e-3)
    for unfold in (False, True):
        found = scalar.trace_scalar(program, bench, 4_000, seed=5, unfold=unfold)
        trapped = 1.0 - 3.0 * (1.0 - math.sqrt(1.0 - 1.0 / 2.01**2))
        sigma = math.sqrt(trapped * (1.0 - trapped) / 4_000)
        assert abs(found["fates"]["truncated"] - trapped) < 4.0 * sigma


def test_without_a_compiler_one_line_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(scalar.shutil, "which", lambda name: None)
    with pytest.raises(scalar.ScalarTracerError, match=r"^no C\+\+ compiler was found \(g\+\+, "):
        scalar.build(tmp_path)
