"""Light born in a slab, and several detectors told apart: in simulations, tables and campaigns.

Statistical tests have fixed seeds and compare at z < 4: right programs fail this file in one run of
500.
"""

import json

import numpy as np
import pytest
from comparisons import assert_all_light_is_told, assert_compatible
from places import cases_of
from refusals import refusal
from scipy.special import expn
from scipy.stats import kstest

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.attenuation import attenuations
from mcrim_mitsuba.efficiency.eta_grid import tells_detectors
from mcrim_mitsuba.efficiency.response_maker import ResponseMaker
from mcrim_mitsuba.efficiency.table import eta_table
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.spectrophotometer import spectrophotometer_of
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

Z = 4.0
LENGTH = 100.0
#: An end that detects all light.
_END = """<shape type="rectangle" id="{}"><transform name="to_world"><scale x="3" y="3"/>
  <rotate x="1" angle="{}"/><translate z="{}"/></transform><bsdf type="photodetector"/>
  <ref name="interior" id="crystal"/></shape>"""
#: A bar between perfect mirrors, whose ends detect all that arrives.
_MIRRORS = f"""<scene version="3.0.0">
  <default name="source_z_mm" value="30"/><default name="source_width_mm" value="0.2"/>
  <default name="alpha_scat_per_cm" value="0"/><default name="alpha_abs_per_cm" value="0.2"/>
  <default name="detector" value="all"/>
  <integrator type="light_collection"><string name="detector" value="$detector"/></integrator>
  <medium type="bulk" id="crystal"><float name="alpha_abs_per_cm" value="$alpha_abs_per_cm"/>
    <float name="alpha_scat_per_cm" value="$alpha_scat_per_cm"/></medium>
  <emitter type="scintillation"><ref id="crystal"/>
    <float name="source_z_mm" value="$source_z_mm"/>
    <float name="source_width_mm" value="$source_width_mm"/></emitter>
  <shape type="gap_sides" id="mirror"><float name="width" value="6"/>
    <float name="thickness" value="{LENGTH}"/>
    <transform name="to_world"><translate z="{LENGTH}"/></transform>
    <bsdf type="photodetector"><float name="specular" value="1"/></bsdf>
    <ref name="interior" id="crystal"/></shape>
  {_END.format("left", 180, 0)}{_END.format("right", 0, LENGTH)}</scene>"""


@pytest.fixture
def mirrors(tmp_path):
    path = tmp_path / "mirrors.xml"
    path.write_text(_MIRRORS)
    return read_scene(path)


@pytest.mark.parametrize("z", [10.0, 30.0, 85.0])
def test_between_mirrors_light_falls_as_the_second_exponential_integral(mirrors, z):
    """Every ray keeps its angle: eta = 1/2 int exp(-a z / mu) d mu = E_2(a z) / 2 at each end."""
    light = Simulation(mirrors, {"source_z_mm": z}).collect(1_000_000, seed=3)
    assert_all_light_is_told(light)
    for end, away_cm in {"left": z / 10.0, "right": (LENGTH - z) / 10.0}.items():
        eta, sigma = light.eta_by_detector[end], light.eta_by_detector_sigma[end]
        assert_compatible(eta, sigma, 0.5 * expn(2, 0.2 * away_cm), 0.0, end, z_max=Z)
    assert light.eta_by_detector["mirror"] == 0.0


def test_what_is_counted_is_eta_and_the_rest_stays_as_it_is(mirrors):
    whole = Simulation(mirrors).collect(200_000, seed=1)
    assert whole.eta == pytest.approx(sum(whole.eta_by_detector.values()), rel=1e-9)
    one = Simulation(mirrors, {"detector": "right"}).collect(200_000, seed=1)
    assert (one.eta, one.eta_sigma) == (
        whole.eta_by_detector["right"],
        whole.eta_by_detector_sigma["right"],
    )
    assert one.budget == whole.budget and sum(one.budget.values()) == pytest.approx(1.0)


def test_a_symmetric_bar_sees_the_same_from_either_end(scenes):
    bar, etas = scenes / "plastic_bar.xml", {}
    for z in (12.0, 50.0, LENGTH - 12.0):
        light = Simulation(bar, {"source_z_mm": z, "source_width_mm": 2.0}).collect(500_000, seed=7)
        for end, eta in light.eta_by_detector.items():
            etas[end, z] = eta, light.eta_by_detector_sigma[end]
    for z in (12.0, 50.0, LENGTH - 12.0):
        pair = *etas["left", z], *etas["right", LENGTH - z]
        assert_compatible(*pair, f"{z} mm", z_max=Z)
    assert etas["left", 12.0][0] > 1.2 * etas["left", 88.0][0]


@pytest.mark.parametrize(
    "name", ["camoo4", "camoo4_cylinder", "camoo4_cylinder_lying", "camoo4_hexagonal"]
)
def test_births_fill_the_slab_evenly_whatever_the_crystal(scenes, tmp_path, name):
    """From 2 to 7 mm above the bottom and nowhere else, at 1e-4 by Kolmogorov and Smirnov."""
    crystal = _with_slab(scenes / f"{name}.xml", tmp_path, 4.5, 5.0).crystal
    rng = np.random.default_rng(5)
    x, y, z = np.array(crystal.born_from(*_uniforms(rng, 20_000)))
    z = z - crystal.lower[2]
    assert z.min() >= 2.0 - 1e-4 and z.max() <= 7.0 + 1e-4
    if name != "camoo4_cylinder_lying":  # which is wider in the middle
        assert kstest((z - 2.0) / 5.0, "uniform").pvalue > 1e-4
    beside = _with_slab(scenes / f"{name}.xml", tmp_path, 0.5, 2.0).crystal
    assert beside.born_lower[2] == beside.lower[2]
    assert beside.born_upper[2] - beside.lower[2] == pytest.approx(1.5)
    assert abs(x.mean() - (crystal.lower[0] + crystal.upper[0]) / 2) < 0.1
    assert abs(y.mean() - (crystal.lower[1] + crystal.upper[1]) / 2) < 0.1


def test_collimated_gammas_from_the_side_are_born_in_a_slab_near_it(scenes, tmp_path):
    side = '<float name="side_depth_mm" value="1.5"/>'
    crystal = _with_slab(scenes / "camoo4.xml", tmp_path, 8.0, 2.0, side).crystal
    x, _, z = np.array(crystal.born_from(*_uniforms(np.random.default_rng(6), 20_000)))
    assert kstest((z - 7.0) / 2.0, "uniform").pvalue > 1e-4
    depth = (x + 5.0) / 1.5
    assert kstest(-np.expm1(-depth) / -np.expm1(-10.0 / 1.5), "uniform").pvalue > 1e-4


def _uniforms(rng, count):
    import mitsuba as mi

    return [mi.Float(u) for u in rng.random((3, count)).astype(np.float32)]


def _with_slab(path, folder, z, width, more="") -> Simulation:
    """A scene whose light is born in a slab, beside the scene that it is made of."""
    for other in path.parent.glob("*.xml"):
        (folder / other.name).write_text(other.read_text())
    slab = f'<float name="source_z_mm" value="{z}"/><float name="source_width_mm" value="{width}"/>'
    scene = folder / path.name
    text = scene.read_text()
    assert '<ref id="crystal"/>\n  </emitter>' in text
    text = text.replace(
        '<ref id="crystal"/>\n  </emitter>', f'<ref id="crystal"/>{slab}{more}\n  </emitter>'
    )
    scene.write_text(text)
    return Simulation(scene)


def test_records_of_one_simulation_serve_all_detectors(mirrors):
    """A table counts no more photons for three columns than for one, and agrees with runs alone."""
    coefficients = {"alpha_scat_per_cm": [0.05], "alpha_abs_per_cm": [0.2]}
    run = Run(photons=262_144, seed=2)
    ends = eta_table(mirrors, {"detector": ["left", "right", "all"], **coefficients}, run=run)
    alone = eta_table(mirrors, {"detector": ["right"], **coefficients}, run=run)
    assert ends.photons == alone.photons and ends.eta[1] == pytest.approx(alone.eta[0], rel=1e-12)
    left, right, whole = ends.eta.ravel()
    assert left + right == pytest.approx(whole, rel=1e-5)
    given = {"alpha_scat_per_cm": 0.05, "detector": "left"}
    light = Simulation(mirrors, given).collect(1_000_000, seed=9)
    assert_compatible(left, ends.eta_sigma.ravel()[0], light.eta, light.eta_sigma, "left", z_max=Z)


_CAMPAIGN = """scene = "mirrors.xml"
measurements = "ends.csv"
[parameters.alpha_scat_per_cm]
start = 0.05
fixed = true
[parameters.alpha_abs_per_cm]
start = 0.2
[tolerances]
none = true
"""


def _campaign(folder, *rows):
    (folder / "ends.toml").write_text(_CAMPAIGN)
    (folder / "ends.csv").write_text("\n".join(["label,signal,sigma,source_z_mm,detector", *rows]))
    return folder / "ends.toml"


def test_readings_of_both_ends_find_the_absorption_from_one_simulation(mirrors, tmp_path):
    signals = {end: 50.0 * expn(2, 0.2 * away) for end, away in (("left", 3.0), ("right", 7.0))}
    rows = [f"{end},{signal},{0.01 * signal},30,{end}" for end, signal in signals.items()]
    rows.append(f"sum,{sum(signals.values())},0.5,30,all")
    campaign = read_campaign(_campaign(tmp_path, *rows))
    maker = ResponseMaker(campaign, Run(photons=65_536, seed=4))
    log_eta = maker.make([]).log_eta
    assert maker.schedule.photons == 4 * 65_536
    etas = np.exp(log_eta)
    assert etas[0] + etas[1] == pytest.approx(etas[2], rel=1e-5)
    assert (etas[0] > etas[1]).all()


@cases("row", "words")
def test_a_reading_of_a_detector_that_is_not_there(mirrors, tmp_path, row, words):
    said = refusal(read_campaign, _campaign(tmp_path, row))
    assert words in said and ("did you mean left?" in said) == ("lef" in row)


@cases("given", "words")
def test_what_the_scene_cannot_count_or_light(mirrors, given, words):
    assert words in refusal(Simulation, mirrors, given)


def test_a_slab_wants_its_middle_and_no_depth(scenes, tmp_path):
    slab = '<float name="source_width_mm" value="2"/>'
    middle = '<float name="source_z_mm" value="5"/>'
    depth = f'{middle}<float name="source_depth_mm" value="1"/>'
    text = (scenes / "camoo4.xml").read_text()
    told = {slab: "without source_z_mm", slab + depth: "falls with the depth"}
    for more, words in {**told, middle: "without source_width_mm"}.items():
        path = tmp_path / "slab.xml"
        path.write_text(text.replace("</emitter>", f"{more}</emitter>"))
        assert words in refusal(Simulation, path)


def test_the_beam_of_a_bar_has_one_detector(scenes):
    beam = spectrophotometer_of(read_scene(scenes / "plastic_bar.xml"))
    assert "detector" not in beam.parameters and not tells_detectors(beam)
    assert Simulation(beam).model.detectors == ["beam_detector"]


def test_attenuation_lengths_and_their_errors():
    """Lines are found as they are; what batches share at both ends adds up in their ratio."""
    z, length, batches = np.array([10.0, 40.0, 90.0]), 250.0, 64
    axes = {"source_z_mm": tuple(z), "detector": ("left", "right", "all")}
    log_eta = np.stack([-z / length, (z - 100.0) / length, 0.0 * z], axis=1) - 1.0
    noise = 0.01 * np.random.default_rng(8).standard_normal((batches, 3))
    deviations = np.stack([noise, -noise, 0.0 * noise], axis=2)
    left, right, ratio = attenuations(axes, log_eta, deviations)
    assert [fit.light for fit in (left, right, ratio)] == ["left", "right", "left / right"]
    for fit in (left, right, ratio):
        assert fit.length_mm == pytest.approx(length) and fit.departure < 1e-12
    slope_sigma = 0.01 / np.sqrt(batches * ((z - z.mean()) ** 2).sum())
    assert left.length_mm_sigma == pytest.approx(length**2 * slope_sigma, rel=0.3)
    # of opposite errors, with twice the slope: no better than either end
    assert ratio.length_mm_sigma == pytest.approx(left.length_mm_sigma)
    # the slope has Gaussian errors, and may be 1.645 of them steeper
    steepest = 1.0 / length + 1.645 * left.length_mm_sigma / length**2
    assert left.lower_limit_mm == pytest.approx(1.0 / steepest)
    assert attenuations({"source_z_mm": (1.0, 2.0)}, np.zeros(2), np.zeros((4, 2))) == ()


def test_a_table_over_places_tells_them(mirrors, request):
    """Light that keeps its angle falls faster than the axis' own exponential."""
    axes = ("--axis", "source_z_mm=10,30,50,70,90", "--axis", "detector=left,right")
    given = (*axes, "--alpha-scat", "0.001", "--photons", "65536")
    table = request.getfixturevalue("mcrim").json("table", mirrors.path, *given)
    lengths = {fit["light"]: fit for fit in table["attenuation"]}
    assert list(lengths) == ["left", "right", "left / right"]
    for fit in lengths.values():
        assert fit["length_mm"] < 1.0 / 0.02 and fit["departure"] > 0.01
    assert not any("attenuation length" in note for note in table["notes"])
    assert json.dumps(table["rows"][0]).startswith('{"source_z_mm": 10.0, "detector": "left"')


def test_a_length_that_light_does_not_tell_is_said_to_be_longer(mirrors, request):
    """200000 ± 1000000 mm stood in the table without a word."""
    given = ("--axis", "source_z_mm=10,50,90", "-D", "alpha_abs_per_cm=1e-6", "--photons", "65536")
    table = request.getfixturevalue("mcrim").json("table", mirrors.path, *given)
    (fit,), (note,) = table["attenuation"], (n for n in table["notes"] if "attenuation" in n)
    assert fit["length_mm_sigma"] > 0.6 * fit["length_mm"] and "is not told" in note
    assert 1000.0 < float(note.split(" above ")[1].split()[0]) < 0.5 * fit["length_mm"]


def test_a_map_of_where_light_arrives_is_of_one_detector(scenes):
    bar = scenes / "luag_fibre.xml"
    one = mcrim.simulate(bar, photons=65_536, detector="right")
    ((_, light),) = one.lights
    assert light.eta == one.eta == one.eta_by_detector["right"]
    said = refusal(lambda: mcrim.simulate(bar, photons=65_536).lights)
    assert "does not lie in one plane" in said and "detector = left" in said
