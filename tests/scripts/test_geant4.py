"""Geant4 agrees with Mitsuba and with the NumPy tracer, and says what it cannot do."""

import math

import geant4 as geant4_trace
import pytest
from bench_scene import bench_scene
from geant4 import Geant4Error, is_installed, trace_geant4

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.transport.simulation import Simulation

PHOTONS = 60_000
needs_geant4 = pytest.mark.skipif(
    not is_installed(), reason="geant4_pybind is not installed: pip install '.[geant4]'"
)


@needs_geant4
@pytest.mark.parametrize("n_gap", [1.0, 1.46])
def test_geant4_agrees_with_mitsuba_and_numpy(scenes, n_gap):
    ours = Simulation(scenes / "camoo4.xml", {"n_gap": n_gap}).collect(1_000_000, seed=1)
    numpy = trace(bench_scene(n_gap=n_gap), PHOTONS, seed=2)
    found = trace_geant4(Bench(n_gap=n_gap), PHOTONS, seed=3)
    for other in (ours, numpy):
        z = (found.eta - other.eta) / math.hypot(found.eta_sigma, other.eta_sigma)
        assert abs(z) < 3.5, (found, other.eta, other.eta_sigma)


@needs_geant4
def test_every_fate_is_the_same_with_the_mask_under_the_crystal_too():
    numbers = {"aperture_radius_mm": 3.0, "n_gap": 1.46}
    numpy = trace(bench_scene(**numbers), PHOTONS, seed=4)
    found = trace_geant4(Bench(**numbers), PHOTONS // 2, seed=5, depolarize=True)
    assert sum(found.counts.values()) == found.photons
    for fate, value in found.budget.items():
        other = "escaped" if fate == "elsewhere" else fate
        sigma = math.hypot(found.budget_sigma[fate], numpy.budget_sigma[other])
        assert abs(value - numpy.budget[other]) < 3.5 * sigma, (fate, found, numpy)


@needs_geant4
def test_the_same_seed_gives_the_same_count_and_another_seed_another():
    progress = []
    once, again, other = (
        trace_geant4(Bench(), 10_001, seed, threads=2, progress=progress.append)
        for seed in (7, 7, 8)
    )
    assert once.counts == again.counts != other.counts
    assert once.photons == 10_001
    assert all(0 < done <= 10_001 for done in progress)


@needs_geant4
def test_a_failure_of_the_process_is_one_line():
    job = {
        "bench": {"n_crystal": -1.0},
        "photons": 100,
        "engine_seed": 1,
        "threads": 1,
        "depolarize": False,
    }
    with pytest.raises(Geant4Error, match=r"^Geant4 ended with status 1: .*n_crystal.*$"):
        geant4_trace.run_job(job, None)


@needs_geant4
@pytest.mark.parametrize(
    "bench, words",
    [
        (Bench(source_depth_mm=2.0), "does not know source_depth_mm"),
        (Bench(angular_falloff=0.5), "does not know angular_falloff"),
        (Bench(alpha_scat_per_cm=0.0, alpha_abs_per_cm=0.0), "never end"),
    ],
)
def test_benches_that_geant4_cannot_trace_are_refused(bench, words):
    with pytest.raises(InputError, match=words):
        trace_geant4(bench, 100, seed=1)


def test_without_geant4_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(geant4_trace, "is_installed", lambda: False)
    with pytest.raises(InputError, match=r"not installed; .*mcrim-mitsuba\[geant4\]"):
        trace_geant4(Bench(), 100, seed=1)
