"""Mitsuba's variants: an NVIDIA GPU gives what the processor gives, or one line says why it cannot.

Approximate reciprocals and logarithms differ between the two, so a GPU's digits are not the
processor's: all fates of several benches are compared, with seeds of their own, at five standard
deviations for all of them together (two-sided, Bonferroni).
"""

import sys

import numpy as np
import pytest
from places import tables_of
from refusals import refusal
from scipy.stats import norm

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.transport import simulation as loading
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import cuda_versions, use_variant

PROCESSOR, GPU = "llvm_ad_rgb", "cuda_ad_rgb"
FAMILY_SIGMA = 5.0
#: Fates that fewer photons met than this are no normal variables.
LEAST_PHOTONS = 100

#: Scene, overrides, whether Mitsuba's own intersection (OptiX on a GPU) is asked for.
BENCHES = [
    ("camoo4.xml", {"n_gap": 1.0}, False),
    ("camoo4.xml", {"n_gap": 1.46}, False),
    ("camoo4.xml", {"n_gap": 1.46, "polarization": True}, False),
    ("camoo4_wrapped.xml", {}, False),
    ("camoo4.xml", {"n_gap": 1.46}, True),
    ("cawo4.xml", {"polarization": True}, True),
]


def why_no_gpu() -> str:
    try:
        cuda_versions()
    except InputError as error:
        return error.problem
    return ""


needs_gpu = pytest.mark.skipif(bool(why_no_gpu()), reason=why_no_gpu())
needs_no_gpu = pytest.mark.skipif(not why_no_gpu(), reason="there is an NVIDIA GPU here")


@pytest.fixture(autouse=True)
def ends_on_the_processor():
    """The variant belongs to the process: later tests must not inherit one of these."""
    yield
    use_variant(PROCESSOR)


def z_scores(one, other) -> dict[str, float]:
    """Differences of two results' fates over their errors."""
    scores = {}
    for fate, value in one.budget.items():
        if min(value * one.photons, other.budget[fate] * other.photons) >= LEAST_PHOTONS:
            error = np.hypot(one.budget_sigma[fate], other.budget_sigma[fate])
            scores[fate] = (value - other.budget[fate]) / error
    return scores


def limit(comparisons: int) -> float:
    """Of one |z| among many, for the chance of five standard deviations in all."""
    return norm.isf(norm.sf(FAMILY_SIGMA) / comparisons)


def fates(scenes, scene, overrides, general, *, variant, seed, photons):
    simulation = Simulation(scenes / scene, overrides, variant=variant)
    return simulation.collect(photons, seed=seed, general=general)


def compared(scenes, variant, benches, photons) -> dict[tuple, float]:
    scores = {}
    for number, bench in enumerate(benches):
        one, other = (
            fates(scenes, *bench, variant=each, seed=seed, photons=photons)
            for each, seed in ((PROCESSOR, 100 + number), (variant, 200 + number))
        )
        assert sum(other.budget.values()) == pytest.approx(1.0, abs=1e-5)
        scores |= {(number, fate): z for fate, z in z_scores(one, other).items()}
    return scores


@needs_gpu
def test_a_gpu_gives_what_the_processor_gives(scenes):
    scores = compared(scenes, GPU, BENCHES, photons=20_000_000)
    assert len(scores) >= 4 * len(BENCHES)
    worst = max(scores, key=lambda name: abs(scores[name]))
    assert abs(scores[worst]) < limit(len(scores)), worst


@needs_gpu
def test_a_gpu_gives_the_same_digits_again(scenes):
    """No two lanes write to one place, so that no order of atomic operations matters."""
    for bench in (BENCHES[1], BENCHES[4]):
        one, again = (
            fates(scenes, *bench, variant=GPU, seed=3, photons=1_000_000) for _ in range(2)
        )
        assert one.budget == again.budget


@needs_gpu
def test_a_gpus_photon_records_answer_like_the_processors(mcrim, scenes, tmp_path, monkeypatch):
    """The scattering and absorption of a table are weights of records: sums over their rows."""
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))
    tables, line = (
        [],
        "--alpha-scat 0.1,0.54 --alpha-abs 0.014,0.039 --n-gap 1.0,1.46 --photons 4e6",
    )
    for variant, seed in ((PROCESSOR, "1"), (GPU, "2")):
        path = tmp_path / f"{variant}.csv"
        where = ("--seed", seed, "--variant", variant, "-o", path)
        mcrim.shown("table", scenes / "camoo4.xml", *line.split(), *where)
        tables.append(np.genfromtxt(path, delimiter=",", names=True, comments="#"))
    one, other = tables
    error = np.hypot(one["eta_sigma"], other["eta_sigma"])
    assert np.abs((one["eta"] - other["eta"]) / error).max() < limit(len(error))


def test_the_comparison_passes_what_is_alike_and_sees_one_per_cent(scenes):
    alike = compared(scenes, "llvm_ad_mono", BENCHES[:2], photons=200_000)
    assert max(map(abs, alike.values())) < limit(len(alike))
    bench, changed = BENCHES[1], ("camoo4.xml", {"n_gap": 1.46, "n_crystal": 2.03}, False)
    one, other = (
        fates(scenes, *each, variant=PROCESSOR, seed=seed, photons=200_000)
        for seed, each in ((1, bench), (2, changed))
    )
    assert max(map(abs, z_scores(one, other).values())) > limit(len(alike))


TABLES = tables_of(__file__)
VERBS = TABLES["verbs"]
CHOICE = "known are: llvm_ad_rgb, llvm_ad_mono, llvm_ad_mono_polarized, cuda_ad_rgb"
REFUSED = {
    "llvm_ad_rbg": "the variant 'llvm_ad_rbg' is not supported; did you mean llvm_ad_rgb? K",
    "llvm_ad_spectral": "the variant 'llvm_ad_spectral' is not supported; did you mean llvm_ad_r",
    "scalar_rgb": "the variant 'scalar_rgb' is not supported; vectors of photons are followed: us",
    "gpu": f"the variant 'gpu' is not supported; {CHOICE}",
}


@pytest.fixture
def refused(scenes, here, monkeypatch, mcrim):
    """The one line of a command that begins nothing."""

    def refused(verb: str, variant: str) -> str:
        monkeypatch.setenv("MCRIM_CACHE", str(here / "cache"))
        words = [word.replace("{scenes}", str(scenes)) for word in VERBS[verb]]
        line = mcrim.refused(*words, "--variant", variant)
        assert list(here.iterdir()) == []
        return line

    return refused


@needs_no_gpu
@pytest.mark.parametrize("verb", VERBS)
def test_without_a_gpu_one_line_says_so(verb, refused):
    line = refused(verb, GPU)
    assert "a cuda variant cannot start here: no NVIDIA GPU " in line
    assert "use --variant llvm_ad_rgb, which needs only the processor" in line


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_refuses_a_variant_that_does_not_exist(verb, refused):
    assert REFUSED["llvm_ad_rbg"] in refused(verb, "llvm_ad_rbg")


@pytest.mark.parametrize("variant", REFUSED)
def test_variants_that_are_not_followed(variant):
    assert refusal(use_variant, variant).startswith(REFUSED[variant])


#: What Dr.Jit 1.5 says (as seen with drivers that were made to fail so), the driver's CUDA, ours.
COMPLAINTS = TABLES["complaints"]


@pytest.mark.parametrize(("complaint", "version", "words"), COMPLAINTS)
def test_reasons_in_words(monkeypatch, complaint, version, words):
    class Detail:
        @staticmethod
        def cuda_version():
            return tuple(version)

        @staticmethod
        def cuda_compute_capability():
            raise RuntimeError(complaint)

    monkeypatch.setattr(sys.modules["drjit"], "detail", Detail)
    assert words in refusal(cuda_versions)


def test_a_driver_without_optix_is_no_fault_of_the_scenes(scenes, monkeypatch):
    """As containers have it that may compute, but not draw; Mitsuba's words."""

    def load(mi, file):
        raise RuntimeError("Error while loading: [optix_api.cpp:57] Could not initialize OptiX!")

    monkeypatch.setattr(loading, "_load", load)
    with pytest.raises(InputError, match="does not start here; install a complete") as error:
        Simulation(scenes / "camoo4.xml")
    assert error.value.path is None


def test_records_of_another_gpu_are_not_taken(monkeypatch):
    """CUDA and the GPU's kind decide how kernels are compiled: they are part of a cache's key."""
    known = []
    for version, capability in (((12, 4), 90), ((12, 8), 90), ((12, 4), 120)):
        detail = type(
            "Detail",
            (),
            {
                "cuda_version": staticmethod(lambda version=version: version),
                "cuda_compute_capability": staticmethod(lambda capability=capability: capability),
            },
        )
        monkeypatch.setattr(sys.modules["drjit"], "detail", detail)
        known.append(record_versions(GPU))
    assert known[0]["cuda"] == "12.4" and known[0]["compute_capability"] == "9.0"
    assert known[2]["compute_capability"] == "12.0"
    assert known[0] != known[1] and known[0] != known[2] and "llvm" not in known[0]
