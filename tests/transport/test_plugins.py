"""The plugins as Mitsuba sees them: registered in every variant, usable from any XML."""

import gc
import threading

import drjit as dr
import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from mcrim_mitsuba.output.photograph import render
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.bulk import BirthLattice, PhotonSeeds, lane_generators, lane_numbers
from mcrim_mitsuba.transport.collection import Recorder, follow_trails
from mcrim_mitsuba.transport.conversion import (
    opaque,
    parameters_of,
    read_scene_model,
    write_parameters,
)
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals, plan_lanes
from mcrim_mitsuba.transport.simulation import Simulation, load_scene
from mcrim_mitsuba.transport.variants import use_variant


@pytest.fixture
def mi():
    yield use_variant()
    use_variant()  # whatever variant a test leaves behind


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_mono_polarized", "llvm_ad_rgb"])
def test_mitsubas_own_switch_of_variant_keeps_the_plugins(scenes, mi, variant):
    """Python classes belong to one variant's base classes: a switch defines them again."""
    mi.set_variant(variant)
    scene = mi.load_file(
        str(scenes / "camoo4_wrapped.xml"), parallel=False, optimize=False, n_gap="1.46"
    )
    assert isinstance(scene.integrator(), mi.Integrator)
    image = scene.integrator().render(scene, spp=20_000, seed=1)
    assert float(np.array(image).squeeze()) == pytest.approx(0.6925, abs=0.02)


def test_births_fill_the_crystal_and_nothing_else(scenes, mi):
    """Uniform in each coordinate: chi-square over ten slices at a false-alarm level of 1e-4."""
    crystal = Simulation(scenes / "camoo4.xml", {"crystal_height_mm": 20}).crystal
    rng = lane_generators(50_000, 1)
    for point in (
        crystal.from_uniforms(*(rng.next_float32() for _ in range(3))),
        crystal.sample(rng, 50_000),
    ):
        dr.eval(point)
        for axis, (low, high) in enumerate(((-5, 5), (-5, 5), (0, 20))):
            counts, _ = np.histogram(np.array(point[axis]), bins=10, range=(low, high))
            assert counts.sum() == 50_000
            assert chisquare(counts).pvalue > 1e-4


@pytest.mark.parametrize(
    "use", ["load", "collect", "general", "record", "follow", "emit", "render"]
)
def test_a_simulation_that_is_dropped_takes_its_scene_along(scenes, mi, use):
    """Mitsuba's virtual calls compile code for all shapes, BSDFs, media and emitters that live.

    Dr.Jit numbers them: a new one gets the lowest number that is free.
    """

    def lowest_free_numbers():
        gc.collect()
        kinds = {"rectangle": "Shape", "diffuse": "BSDF", "bulk": "Medium", "constant": "Emitter"}
        made = [(mi.load_dict({"type": plugin}), kind) for plugin, kind in kinds.items()]
        pointers = [getattr(mi, f"{kind}Ptr")(thing) for thing, kind in made]
        return [int(dr.reinterpret_array(mi.UInt32, pointer)[0]) for pointer in pointers]

    before = lowest_free_numbers()
    _use(mi, scenes / "camoo4.xml", use)
    assert lowest_free_numbers() == before


def _use(mi, path, use) -> None:
    """Use a simulation as the package does."""
    if use == "render":
        render(path, samples=1, scale=0.4)  # as test_render's, for which kernels are compiled
        return
    simulation = Simulation(path)
    if use in ("collect", "general"):
        simulation.collect(1000, general=use == "general")
    elif use == "record":
        Recorder(simulation).record(
            ScatteringProposals((0.54,), (SHARE_STEPS,), 0.039), LANES, seed=1, number=0
        )
    elif use == "emit":
        middle = mi.Point2f(0.5)
        simulation.scene.emitters()[0].sample_ray(0.0, 0.5, middle, middle)
    elif use == "follow":
        follow_trails(simulation, 1000)


def test_flat_faces_are_read_from_the_scene_and_merged(scenes, mi):
    """The frame is four rectangles, a cube six: triangles would be tested twice as often."""
    box = """<scene version="3.0.0"><shape type="cube" id="box"><transform name="to_world">
        <rotate x="0.6" y="0.8" angle="40"/><translate x="7"/></transform></shape>"""
    curved = mi.load_string(
        box + '<shape type="sphere" id="ball"/></scene>', parallel=False, optimize=False
    )
    assert read_scene_model(curved).faces is None
    bench = read_scene_model(
        mi.load_file(str(scenes / "camoo4.xml"), parallel=False, optimize=False)
    )
    assert len(bench.faces) == 20 and not any(face.triangle for face in bench.faces)
    box = mi.load_string(box + "</scene>", parallel=False, optimize=False)
    faces = read_scene_model(box).faces
    assert len(faces) == 6 and not any(face.triangle for face in faces)
    centre = np.mean([f.corner + (f.edge_u + f.edge_v) / 2 for f in faces], axis=0)
    assert centre == pytest.approx([7, 0, 0], abs=1e-5)
    for face in faces:
        outwards = face.corner + (face.edge_u + face.edge_v) / 2 - centre
        assert outwards @ face.normal == pytest.approx(1, abs=1e-5)


def test_numbers_of_lanes_that_are_kept_are_those_made_anew(mi):
    plan, other = plan_lanes(4096, batches=32), plan_lanes(8192, batches=32)
    kept = lane_numbers(mi.variant(), plan, 3, 1)
    assert lane_numbers(mi.variant(), plan, 3, 1) is kept
    stream, seeds, lattice, first_slot = kept
    assert np.array_equal(np.array(stream), np.array(lane_generators(plan.lanes, 3, 1).inc))
    serial = mi.UInt32(5)
    anew = PhotonSeeds(plan.lanes, 3, 1, 2).state(serial), BirthLattice(plan, 3, 1)
    assert np.array_equal(np.array(seeds.state(serial)), np.array(anew[0]))
    assert np.array_equal(np.array(lattice.mirrored(serial)), np.array(anew[1].mirrored(serial)))
    assert first_slot[-1] == plan.first_slot[-1]
    # of another plan, launch or seed they are others
    for numbers in (lane_numbers(mi.variant(), plan, 3, 2), lane_numbers(mi.variant(), plan, 4, 1)):
        assert not np.array_equal(np.array(numbers[0]), np.array(stream))
    assert lane_numbers(mi.variant(), other, 3, 1)[3][-1] == other.first_slot[-1]


def test_parameters_are_written_as_by_traversal(mi):
    """A mesh is the same, whoever gives it its corners, and where it is follows."""
    corners, faces = mi.Float([0, 0, 1, 2, 0, 1, 0, 3, 1]), mi.UInt32([0, 1, 2])
    mesh, slow = mi.Mesh("fast", 3, 1), mi.Mesh("slow", 3, 1)
    write_parameters(mesh, vertex_positions=corners, faces=faces)
    parameters = mi.traverse(slow)
    parameters["vertex_positions"], parameters["faces"] = corners, faces
    parameters.update()
    assert list(mesh.bbox().max) == list(slow.bbox().max) == [2, 3, 1]
    own = parameters_of(mesh, nested=False)
    assert {"vertex_positions", "faces"} < own.keys() < parameters_of(mesh).keys()
    for name, value in own.items():
        assert np.array_equal(np.array(value), np.array(parameters[name])), name


def test_lanes_and_their_photons_draw_unrelated_numbers(mi):
    """Across lanes, every draw is a uniform sample; lanes, photons, launches, seeds: uncorrelated.

    PCG32's own streams 0, 1, 2, ... fail this by p = 1e-17.
    """
    lanes, draws = 16_384, []
    for seed in ((0, 0), (0, 1), (1, 0), (2, 7)):
        rng = lane_generators(lanes, *seed)
        for _ in range(25):
            draws.append(np.array(rng.next_float32(), dtype=float))
            dr.eval(rng.state)  # or each kernel would draw once more all that was drawn
    seeds = PhotonSeeds(lanes, 2, 7)
    for serial in range(25):
        # opaque, or each number would have a kernel of its own
        rng.state = seeds.state(opaque([serial], mi.UInt32))
        draws += [np.array(rng.next_float32(), dtype=float) for _ in range(2)]
    p_values = [chisquare(np.histogram(drawn, 64, (0, 1))[0]).pvalue for drawn in draws]
    # p-values of a good generator are uniform themselves: too good is bad as well
    assert kstest(p_values, "uniform").pvalue > 1e-3
    draws = np.array(draws) - 0.5
    correlation = np.corrcoef(draws)[np.triu_indices(len(draws), 1)]
    assert np.abs(correlation).max() < 5.5 / np.sqrt(lanes)  # 11175 pairs: 4e-4 by chance
    neighbours = (draws[:, :-1] * draws[:, 1:]).mean(axis=1) * 12
    assert np.abs(neighbours).max() < 5 / np.sqrt(lanes)


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono_polarized"])
def test_bsdfs_are_good_for_pictures(mi, variant):
    """A polish is drawn as a smooth dielectric, a detector as what it reflects: 0.3, diffusely."""
    mi.set_variant(variant)
    count = 10_000
    rng = mi.PCG32(count)
    u, v, choice = (rng.next_float32() for _ in range(3))
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.wi = mi.Vector3f(0.0, 0.6, -0.8)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    indices = {"int_ior": 2.01, "ext_ior": 1.46}
    samples = [
        mi.load_dict({"type": kind, **indices}).sample(context, si, choice, mi.Point2f(u, v))
        for kind in ("dielectric", "polish")
    ]
    for one, other in zip(*([s.wo, mi.unpolarized_spectrum(w)] for s, w in samples), strict=True):
        assert np.array_equal(np.array(one), np.array(other))
    detector = mi.load_dict({"type": "photodetector", "reflectance": 0.3})
    sample, weight = detector.sample(context, si, choice, mi.Point2f(u, v))
    assert np.all(np.array(sample.wo.z) < 0)
    assert np.allclose(np.array(mi.unpolarized_spectrum(weight)), 0.3)
    value = mi.unpolarized_spectrum(detector.eval(context, si, sample.wo))
    pdf = detector.pdf(context, si, sample.wo)
    assert np.allclose(np.array(value / pdf), 0.3, rtol=1e-4)
    assert np.allclose(np.array(pdf), np.array(sample.pdf), rtol=1e-4)


def test_plugins_are_made_one_after_the_other(scenes, mi, monkeypatch):
    """Mitsuba's threads race when they make plugins: one load of some 300 was refused."""
    from mcrim_mitsuba.transport.plugins.shapes import Polygons  # wants a variant

    makers = []
    made = Polygons.__init__

    def noted(self, props):
        makers.append(threading.get_ident())
        made(self, props)

    monkeypatch.setattr(Polygons, "__init__", noted)
    file = read_scene(scenes / "camoo4_wrapped.xml")
    for bench in (file, file.edited(file.source(file.path).decode())):
        for _ in range(20):
            load_scene(mi, bench)
    assert set(makers) == {threading.get_ident()}
