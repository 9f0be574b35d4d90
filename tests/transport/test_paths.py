"""The two ways through a scene: curved and oblique surfaces, Mitsuba's answers against ours.

Statistical tests use fixed seeds. The whole file makes 44 comparisons at z < 3.5: a correct
program would fail it with a probability of at most 2 %.
"""

import itertools
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_compatible, assert_same_fates, assert_same_light
from lxml import etree
from refusals import refusal
from scipy.integrate import dblquad, quad
from scipy.spatial import ConvexHull

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.optics.fresnel import amplitudes
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.transport import general_path, surface_physics
from mcrim_mitsuba.transport.conversion import surface_properties
from mcrim_mitsuba.transport.scene_model import Surface
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.variants import use_variant

Z = 3.5

HEAD = """<scene version="3.0.0">
  <default name="n" value="1.9"/>
  <default name="alpha_abs_per_cm" value="0"/>
  <default name="alpha_scat_per_cm" value="0"/>
  <default name="polarization" value="false"/>
  <integrator type="light_collection">
    <boolean name="polarization" value="$polarization"/></integrator>
  <medium type="bulk" id="crystal">
    <float name="alpha_abs_per_cm" value="$alpha_abs_per_cm"/>
    <float name="alpha_scat_per_cm" value="$alpha_scat_per_cm"/></medium>
  <emitter type="scintillation"><ref id="crystal"/></emitter>
  <bsdf type="dielectric" id="polish">
    <float name="int_ior" value="$n"/><float name="ext_ior" value="1.0"/></bsdf>
"""
AROUND = """<shape type="sphere" id="detector"><float name="radius" value="20"/>
  <bsdf type="photodetector"/></shape></scene>"""
BELOW = """<shape type="rectangle" id="detector"><transform name="to_world">
  <scale value="20"/><translate z="-1"/></transform><bsdf type="photodetector"/></shape></scene>"""
SKIN = '<ref id="polish"/><ref name="interior" id="crystal"/>'
# all of the ball is asked of Mitsuba, and of the rod where it is told so
BALL = f"""{HEAD}<shape type="sphere" id="ball"><point name="center" x="1" y="-2" z="3"/>
  <float name="radius" value="5"/>{SKIN}</shape>{AROUND}"""
ROD = f"""{HEAD}<shape type="cylinder" id="side"><float name="radius" value="3"/>
  <point name="p0" x="0" y="0" z="-4"/><point name="p1" x="0" y="0" z="4"/>{SKIN}</shape>
  <shape type="disk" id="top"><transform name="to_world"><scale value="3"/>
  <translate z="4"/></transform>{SKIN}</shape>
  <shape type="disk" id="bottom"><transform name="to_world"><scale value="3"/>
  <rotate x="1" angle="180"/><translate z="-4"/></transform>{SKIN}</shape>{AROUND}"""


#: Scenes that are known to be sound: each is checked once, whatever its numbers.
SOUND = set()


def simulation(tmp_path, text, overrides=None) -> Simulation:
    path = tmp_path / "scene.xml"
    text = text if isinstance(text, str) else etree.tostring(text, encoding="unicode")
    path.write_text(text)
    made = Simulation(path, overrides, check=text not in SOUND)
    SOUND.add(text)
    return made


@pytest.mark.parametrize("less", [1, 16], ids=["offset", "a_16th_of_it"])
def test_total_reflection_traps_light_in_a_clear_ball_for_good(tmp_path, monkeypatch, less):
    """Impact parameters b (radius 1) of light born evenly have the density 3 b sqrt(1 - b^2).

    A start off the surface must not change them, nor may one that rounding puts beyond it.
    """
    monkeypatch.setattr(general_path, "RAY_OFFSET", general_path.RAY_OFFSET / less)
    result = simulation(tmp_path, BALL).collect(30_000, seed=1, max_depth=1000 // less)
    trapped = (1 - 1 / 1.9**2) ** 1.5
    sigma = np.sqrt(trapped * (1 - trapped) / result.photons)
    assert_compatible(result.budget["truncated"], sigma, trapped, z_max=Z)
    assert result.eta + result.budget["truncated"] == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("general", [False, True])
def test_total_reflection_traps_light_in_a_clear_rod_for_good(tmp_path, general):
    """Light stays if neither its ends nor its side, met at cos^2 = (1 - u^2)(1 - b^2), pass it."""
    result = simulation(tmp_path, ROD).collect(30_000, seed=2, max_depth=300, general=general)
    kept = 1 - 1 / 1.9**2  # least cosine squared of light that is let out
    trapped, _ = dblquad(
        lambda b, u: 4 / np.pi * np.sqrt(1 - b * b),
        0,
        np.sqrt(kept),
        lambda u: np.sqrt(max(0.0, 1 - kept / (1 - u * u))),
        1,
    )
    sigma = np.sqrt(trapped * (1 - trapped) / result.photons)
    assert_compatible(result.budget["truncated"], sigma, trapped, z_max=Z)


@pytest.mark.parametrize("polarization", [False, True], ids=["unpolarised", "polarised"])
def test_light_leaves_an_absorbing_ball_as_fresnel_says(tmp_path, polarization):
    """A photon meets a ball at one angle for ever, and stays s or p polarised as it was born."""
    x = 0.4  # absorption over the radius
    result = simulation(
        tmp_path, BALL, {"alpha_abs_per_cm": x / 0.5, "polarization": polarization}
    ).collect(300_000, seed=3)

    def escape(b):
        half = np.sqrt(1 - b * b)
        reflected = [abs(a) ** 2 for a in amplitudes(half, 1.9, 1.0)]
        if not polarization:
            reflected = [np.mean(reflected)]
        arrives = -np.expm1(-2 * x * half) / (2 * x * half)
        leaves = np.mean([(1 - r) / (1 - r * np.exp(-2 * x * half)) for r in reflected])
        return 3 * b * half * arrives * leaves

    expected, _ = quad(escape, 0, 1 / 1.9, epsabs=1e-8)
    assert_compatible(result.eta, result.eta_sigma, expected, z_max=Z)


def bench_with_curved_parts(scenes):
    """The bench with curved faces that change nothing: a black housing, and matched balls."""
    root = etree.parse(scenes / "camoo4.xml", etree.XMLParser(remove_comments=True)).getroot()
    root.insert(0, etree.fromstring('<medium type="bulk" id="core"/>'))
    root.extend(etree.parse(Path(__file__).with_name("curved_parts.xml")).getroot())
    return root


@pytest.mark.parametrize(
    ("n_gap", "polarization"), [(1.0, False), (1.46, True)], ids=["air", "gel_polarised"]
)
def test_curved_parts_of_the_bench_that_change_nothing(
    scenes, tmp_path, monkeypatch, n_gap, polarization
):
    numbers = {"n_gap": n_gap, "polarization": polarization}
    bench = simulation(tmp_path, bench_with_curved_parts(scenes), numbers)
    mixed = bench.collect(400_000, seed=4)
    reference = trace(bench_scene(**numbers), 200_000, 5)
    # what the tracer lets go, the housing takes
    renamed = {"absorbed_reflector": "escaped", "escaped": "absorbed_reflector"}
    assert_same_light(mixed, reference, z_max=Z, renamed=renamed)
    assert_same_light(mixed, trace(bench.file, 100_000, 10), z_max=Z)
    monkeypatch.setattr(general_path, "MOST_FACES", 0)
    traced = bench.collect(200_000, seed=6)
    assert mixed.transport != traced.transport
    assert_same_light(mixed, traced, z_max=Z)


def turned_bench(scenes):
    """The bench without its mask, turned as a whole by an odd angle about an odd axis."""
    root = etree.parse(scenes / "camoo4.xml", etree.XMLParser(remove_comments=True)).getroot()
    for mask in root.findall("bsdf[@type='aperture']"):
        mask.find("bsdf").set("id", mask.get("id"))
        root.replace(mask, mask.find("bsdf"))
    root.remove(root.find("default[@name='aperture_radius_mm']"))
    for transform in root.iter("transform"):
        turn = etree.fromstring('<rotate x="0.36" y="-0.48" z="0.8" angle="37"/>')
        move = etree.fromstring('<translate x="2" y="3" z="-7"/>')
        transform.extend([turn, move])
    return root


def cut_cube(tmp_path, fine: bool = False) -> str:
    """A cube with all edges and corners cut, as a mesh: 44 triangles, or each of them in four."""
    near, far = 3.8, 5.0
    corners = {*itertools.permutations((near, near, far))}
    signs = list(itertools.product((-1, 1), repeat=3))
    vertices = np.array([np.multiply(c, s) for c in corners for s in signs])
    triangles = vertices[ConvexHull(vertices).simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inwards = (normals * triangles.mean(axis=1)).sum(axis=1) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    if fine:
        a, b, c = triangles.transpose(1, 0, 2)
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, d, f), (d, b, e), (f, e, c), (d, e, f))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    points, indices = np.unique(
        triangles.reshape(-1, 3).round(6) + 0.0, axis=0, return_inverse=True
    )
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    lines += ["end_header", *(" ".join(f"{x:.7g}" for x in point) for point in points)]
    lines += ["3 " + " ".join(map(str, index)) for index in indices.reshape(-1, 3)]
    (tmp_path / f"cube_{len(triangles)}.ply").write_text("\n".join(lines) + "\n")
    return f"""{HEAD}<shape type="ply" id="cube">
      <string name="filename" value="cube_{len(triangles)}.ply"/>
      <transform name="to_world"><rotate x="0.48" y="0.6" z="-0.64" angle="29"/>
      <translate z="6.5"/></transform>{SKIN}</shape>{BELOW}"""


@pytest.mark.parametrize("polarization", [False, True], ids=["unpolarised", "polarised"])
def test_a_turned_bench_is_the_same_bench(scenes, tmp_path, polarization):
    numbers = {"n_gap": 1.46, "polarization": polarization}
    bench = simulation(tmp_path, turned_bench(scenes), numbers)
    fast = bench.collect(600_000, seed=7)
    assert fast.transport == "fast path for flat faces"
    for scene in (bench_scene(**numbers, aperture_radius_mm=400.0), bench.file):
        assert_same_light(fast, trace(scene, 200_000, 8), z_max=Z)
    assert_same_light(fast, bench.collect(200_000, seed=9, general=True), z_max=Z)


def test_a_cube_with_cut_edges_by_either_path_and_in_any_number_of_triangles(tmp_path):
    """The mesh has no normals of its own; Mitsuba's smooth ones must not bend the light."""
    numbers = {"n": 1.8, "alpha_abs_per_cm": 0.1, "alpha_scat_per_cm": 0.3, "polarization": True}
    coarse = simulation(tmp_path, cut_cube(tmp_path), numbers)
    fast = coarse.collect(300_000, seed=10)
    assert fast.transport == "fast path for flat faces"
    assert any(face.triangle for face in coarse.model.faces)
    traced = coarse.collect(150_000, seed=11, general=True)
    assert_same_light(fast, traced, z_max=Z)
    fine = simulation(tmp_path, cut_cube(tmp_path, fine=True), numbers)
    mixed = fine.collect(150_000, seed=12)
    assert_same_light(mixed, trace(fine.file, 100_000, 13), z_max=Z)
    assert len({fast.transport, traced.transport, mixed.transport}) == 3
    assert_same_light(fast, mixed, z_max=Z)


def test_a_dielectric_answers_as_its_own_sample_would():
    """The same random number gives the same choice and the same direction, from both sides."""
    use_variant()
    count = 100_000
    rng = mi.PCG32(size=count)
    direction = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    choice = rng.next_float32()
    for n_in, n_out in ((2.01, 1.0), (1.0, 1.52), (2.01, 1.46), (1.52, 1.52)):
        bsdf = mi.load_dict({"type": "dielectric", "int_ior": n_in, "ext_ior": n_out})
        face = Surface("face", 1, 0, **surface_properties(bsdf))
        table = surface_physics.SurfaceTables([face], [(0, 0, 1)])
        row = table.at(dr.zeros(mi.UInt32, count), mi.Bool(True))
        ours = surface_physics.interact(
            row, mi.Point3f(0.0), direction, None, (choice, mi.Float(0.5), mi.Float(0.5))
        )
        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
        si.wi = -direction
        context = mi.BSDFContext(mi.TransportMode.Importance)
        sample, weight = bsdf.sample(context, si, choice, mi.Point2f(0.5), True)
        difference = np.abs(np.array(ours.direction) - np.array(sample.wo)).max(axis=0)
        # at the edge of a choice or of total reflection rounding may decide
        assert (difference > 1e-3).mean() < 1e-4
        assert np.abs(np.array(weight) - 1).max() < 1e-4


def test_a_bsdf_of_mitsubas_own_on_a_flat_face_is_asked(scenes, tmp_path):
    """A nearly smooth rough face is as good as a polished one, and only it is asked of Mitsuba."""
    text = (scenes / "camoo4.xml").read_text()
    top = text.index('id="crystal_top"')
    face = text[top:].replace(
        '<ref id="crystal_to_air"/>',
        '<bsdf type="roughdielectric"><float name="alpha" value="0.0005"/>'
        '<float name="int_ior" value="$n_crystal"/><float name="ext_ior" value="1.0"/></bsdf>',
        1,
    )
    rough = simulation(tmp_path, text[:top] + face).collect(300_000, seed=13)
    assert rough.transport == "fast path for flat faces, Mitsuba for other shapes"
    smooth = Simulation(scenes / "camoo4.xml").collect(600_000, seed=14)
    assert rough.budget.pop("absorbed_surface") < 1e-3
    assert_same_fates(rough, smooth, z_max=Z)


def test_an_instance_is_refused(tmp_path):
    group = """<shape type="shapegroup" id="group"><shape type="sphere" id="inner"/></shape>
      <shape type="instance" id="copy"><ref id="group"/></shape>"""
    path = tmp_path / "instance.xml"
    path.write_text(BALL.replace("</scene>", group + "</scene>"))
    with pytest.raises(InputError, match="copy: the transport does not follow instances"):
        Simulation(path, check=False)


def test_an_endless_liquid_may_have_a_detector_in_it_and_no_surface(tmp_path):
    """Light in the liquid passed through either: eta was a third of what it is, and 0."""
    oil = '<medium type="bulk" id="oil"><boolean name="endless" value="true"/></medium>'
    wet = """<bsdf type="dielectric"><float name="int_ior" value="$n"/>
      <float name="ext_ior" value="1.4"/></bsdf><ref name="interior" id="crystal"/>"""
    names_it = '<ref name="exterior" id="oil"/></shape>'
    results = []
    for end in ("</shape>", names_it):
        low, side = f"{wet}{names_it}", f'<shape type="cylinder" id="side">{SKIN}</shape>'
        top = f"""<shape type="disk" id="top"><transform name="to_world"><translate z="1"/>
          </transform>{SKIN}</shape><shape type="disk" id="low"><transform name="to_world">
          <rotate x="1" angle="180"/></transform>{low}{BELOW.replace("</shape>", end)}"""
        path = tmp_path / "oil.xml"
        path.write_text(HEAD + oil + side + top)
        results.append(Simulation(path).collect(10_000, seed=9))
    assert results[0].eta == results[1].eta > 0.1
    surface = """<shape type="rectangle" id="above"><transform name="to_world"><scale value="20"/>
      <translate z="5"/></transform><ref id="polish"/><ref name="interior" id="oil"/></shape>"""
    path.write_text(path.read_text().replace("</scene>", f"{surface}</scene>"))
    assert "above is a surface of 'oil', which is endless; close" in refusal(Simulation, path)
