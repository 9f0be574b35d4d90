"""Crystals that are no boxes: cylinders, prisms, pyramids; closed forms and the NumPy tracer.

Statistical tests use fixed seeds. The whole file makes 36 comparisons at z < 3.5: a correct
program would fail it with a probability of at most 2 %.
"""

import numpy as np
import pytest
from comparisons import (
    assert_all_light_is_told,
    assert_compatible,
    assert_same_eta,
    assert_same_fates,
    assert_same_light,
)
from places import cases_of
from scipy.integrate import dblquad

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.convex import convex_solids
from mcrim_mitsuba.transport.simulation import Simulation
from mcrim_mitsuba.transport.solid_names import form_of

cases = cases_of(__file__)

Z = 3.5
IN_REGISTERS = "fast path for flat and round faces"

ROD = """<scene version="3.0.0">
  <default name="n" value="2.01"/>
  <integrator type="light_collection"/>
  <medium type="bulk" id="crystal"/>
  <emitter type="scintillation"><ref id="crystal"/></emitter>
  <bsdf type="dielectric" id="polish">
    <float name="int_ior" value="$n"/><float name="ext_ior" value="1.0"/></bsdf>
  <bsdf type="photodetector" id="mirror"><float name="specular" value="1"/></bsdf>
  <shape type="cylinder" id="side"><float name="radius" value="3"/>
    <point name="p0" {low}/><point name="p1" {high}/>
    <ref id="polish"/><ref name="interior" id="crystal"/></shape>
  <shape type="disk" id="high"><transform name="to_world"><scale value="3"/>{turn}
    <translate {high}/></transform><ref id="mirror"/><ref name="interior" id="crystal"/></shape>
  <shape type="disk" id="low"><transform name="to_world"><scale value="3"/>
    <rotate x="1" angle="180"/>{turn}<translate {low}/></transform>
    <ref id="mirror"/><ref name="interior" id="crystal"/></shape>
</scene>"""


def trapped_in_a_long_cylinder(n: float) -> float:
    """Part of the light that never leaves a long polished cylinder of index n in air.

    Light meets the side at cos^2 = (1 - u^2)(1 - b^2) for ever, u being its cosine to the axis and
    b the distance at which it passes the axis, over the radius: skew rays have b > 0. Born evenly
    and to all sides, u is even in [0, 1] and b has the density 4/pi sqrt(1 - b^2). It is trapped
    where cos^2 < k^2 = 1 - 1/n^2: where s = sqrt(1 - b^2) exceeds k, for u > sqrt(1 - k^2/s^2)
    only. So it escapes with the probability 4/pi times the integral of sqrt(s^2 - k^2) over b from
    0 to 1/n, a quarter of a circle of radius 1/n: 1/n^2.
    """
    return 1.0 - 1.0 / n**2


def test_the_closed_form_of_a_long_cylinder():
    """By quadrature over the directions as angles, with skew rays as points of the disc."""
    n = 2.01

    def kept(radius, angle):
        # a ray from (radius, 0) at this angle in the plane across the axis passes it at b
        s = np.sqrt(1.0 - (radius * np.sin(angle)) ** 2)
        # light at polar angles with sin < k / s is trapped
        sine = min(np.sqrt(1.0 - 1.0 / n**2) / s, 1.0)
        return (1.0 - np.sqrt(1.0 - sine**2)) * 2.0 * radius * 2.0 / np.pi

    found, _ = dblquad(kept, 0.0, np.pi / 2.0, 0.0, 1.0, epsabs=1e-7)
    assert found == pytest.approx(trapped_in_a_long_cylinder(n), abs=1e-5)


@pytest.mark.parametrize("axis", ["z", "x"])
@pytest.mark.parametrize("n", [1.5, 2.01])
def test_light_is_trapped_in_a_long_cylinder(tmp_path, axis, n):
    """Ends that reflect as mirrors make a short one as good as a long one."""
    turn = '<rotate y="1" angle="90"/>' if axis == "x" else ""
    path = tmp_path / "rod.xml"
    low, high = (
        " ".join(f'{one}="{end if one == axis else 0}"' for one in "xyz") for end in (-4, 4)
    )
    path.write_text(ROD.format(low=low, high=high, turn=turn))
    simulation = Simulation(path, {"n": n}, check=False)
    result = simulation.collect({1.5: 150_000, 2.01: 60_000}[n], seed=1, max_depth=400)
    assert result.transport == IN_REGISTERS
    trapped = trapped_in_a_long_cylinder(n)
    sigma = np.sqrt(trapped * (1.0 - trapped) / result.photons)
    assert sigma < 0.003 * trapped
    assert_compatible(result.budget["truncated"], sigma, trapped, z_max=Z)
    assert result.budget["escaped"] + result.budget["truncated"] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("n_gap", [1.0, 1.46])
def test_a_standing_cylinder_as_the_numpy_tracer_has_it(scenes, n_gap):
    ours = Simulation(scenes / "camoo4_cylinder.xml", {"n_gap": n_gap}).collect(1_400_000, seed=2)
    reference = trace(read_scene(scenes / "camoo4_cylinder.xml", {"n_gap": n_gap}), 350_000, 3)
    assert reference.eta_sigma < 0.003 * reference.eta
    assert_same_light(ours, reference, z_max=Z)


@cases("name", "form", "transport")
def test_mitsubas_own_intersections_agree(scenes, name, form, transport):
    simulation = Simulation(scenes / f"camoo4_{name}.xml", {"n_gap": 1.46})
    assert form_of(simulation.model, simulation.crystal.volume) == form
    fast = simulation.collect(400_000, seed=4)
    traced = simulation.collect(100_000, seed=5, general=True)
    assert fast.transport == transport != traced.transport
    assert_all_light_is_told(fast)
    assert_same_fates(fast, traced, z_max=Z)


def test_a_lying_cylinder_is_whole_although_its_side_is_in_two_parts(scenes):
    """The crystal is one convex volume beside a gap that is not; light knows no seam."""
    simulation = Simulation(scenes / "camoo4_cylinder_lying.xml")
    model = simulation.model
    solids = {model.volumes[solid.volume].name: solid for solid in convex_solids(model)}
    assert set(solids) == {"crystal", "window"} and len(solids["crystal"].walls) == 2
    said = "cylinder of 10 mm diameter, 10 mm long, lying along x"
    assert form_of(model, simulation.crystal.volume) == said
    narrow, wide = (
        Simulation(scenes / "camoo4_cylinder_lying.xml", {"wetted_width_mm": width})
        for width in (0.5, 6.0)
    )
    # where the gap is air, its width is nothing
    assert_same_light(narrow.collect(400_000, seed=6), wide.collect(400_000, seed=7), z_max=Z)


def test_births_are_even_in_a_cylinder(scenes):
    """Radius squared, height and angle are even, whichever way the cylinder lies."""
    import mitsuba as mi

    for name, axis in (("cylinder", 2), ("cylinder_lying", 0)):
        crystal = Simulation(scenes / f"camoo4_{name}.xml").crystal
        assert crystal.direct
        u = np.random.default_rng(8).random((3, 20_000)).astype(np.float32)
        points = np.array(crystal.from_uniforms(*(mi.Float(one) for one in u))).T
        middle = (crystal.lower + crystal.upper) / 2.0
        away = np.delete(points - middle, axis, axis=1)
        radius2 = (away**2).sum(axis=1) / 25.0
        along = (points[:, axis] - crystal.lower[axis]) / 10.0
        assert radius2.max() < 1.0 + 1e-6
        for values in (radius2, along):
            assert_compatible(values.mean(), np.sqrt(1.0 / 12.0 / len(values)), 0.5, z_max=Z)
        assert_compatible(away.mean(), np.sqrt(25.0 / 4.0 / 2.0 / len(values)), 0.0, z_max=Z)


def test_a_sheet_around_a_cylinder_is_met_from_both_sides(scenes, tmp_path):
    """A sleeve of Teflon: what it sends back meets it again, and only then."""
    sleeve = """<bsdf type="twosided" id="tape"><bsdf type="diffuse">
      <spectrum name="reflectance" value="0.97"/></bsdf></bsdf>
      <shape type="cylinder" id="sleeve"><float name="radius" value="5.5"/>
      <point name="p0" x="0" y="0" z="1"/><point name="p1" x="0" y="0" z="11"/><ref id="tape"/>
      </shape></scene>"""
    path = tmp_path / "sleeve.xml"
    path.write_text((scenes / "camoo4_cylinder.xml").read_text().replace("</scene>", sleeve))
    simulation = Simulation(path)
    fast = simulation.collect(400_000, seed=9)
    assert fast.transport == IN_REGISTERS
    assert_same_light(fast, trace(path, 100_000, 11), z_max=Z)
    assert_same_fates(fast, simulation.collect(100_000, seed=10, general=True), z_max=Z)


@cases("old", "new", "words")
def test_what_is_no_prism_is_refused(scenes, tmp_path, old, new, words):
    path = tmp_path / "prism.xml"
    path.write_text((scenes / "camoo4_hexagonal.xml").read_text().replace(old, new))
    with pytest.raises(InputError, match=words):
        Simulation(path)


@pytest.mark.parametrize("mirror", ["", '<scale z="-1"/>', '<scale x="-1"/>'])
def test_flipped_and_mirrored_disks_and_cylinders_look_where_mitsubas_do(tmp_path, mirror):
    """Lids that were to look down were black; a mirrored crystal was refused as open."""
    card = """<shape type="{}" id="{}"><boolean name="flip_normals" value="true"/>
      <transform name="to_world"><scale x="3.1" y="3.1" z="8"/><translate z="{}"/></transform>
      <bsdf type="diffuse"><spectrum name="reflectance" value="0.9"/></bsdf></shape>"""
    cards = card.format("disk", "lid", 4.1) + card.format("cylinder", "sleeve", -4) + "</scene>"
    text = ROD.format(low='x="0" y="0" z="-4"', high='x="0" y="0" z="4"', turn="")
    text = text.replace('id="mirror"/><ref name="int', 'id="polish"/><ref name="int', 1)
    text = text.replace('name="specular" value="1"', 'name="specular" value="0"')
    path = tmp_path / "cards.xml"
    path.write_text(
        text.replace("</scene>", cards).replace("</transform>", f"{mirror}</transform>")
    )
    simulation = Simulation(path)
    fast, slow = (simulation.collect(100_000, seed=8, general=general) for general in (0, 1))
    assert fast.transport == IN_REGISTERS and fast.budget["absorbed_reflector"] < 0.2
    for other in (slow, trace(path, 50_000, 8)):
        assert_same_eta(fast, other, z_max=Z)
