"""What is derived from a scene: its plan, its spectrophotometer, its light; what ships."""

import pickle

import numpy as np
import pytest
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.scene import shipped
from mcrim_mitsuba.scene.check_text import indices_of
from mcrim_mitsuba.scene.emitted_light import Colours, EmittedLight, read_light
from mcrim_mitsuba.scene.scene_file import ScenePlan, read_scene
from mcrim_mitsuba.scene.spectrophotometer import (
    BEAM_PARAMETERS,
    polished_slab,
    refused_of_beam,
    scattered_share,
    spectrophotometer_of,
    too_wide,
)

cases = cases_of(__file__)

BENCH = SCENES / "camoo4.xml"


@pytest.fixture
def bench():
    return read_scene(BENCH)


def test_a_scene_knows_its_places_files_and_whether_it_changed(tmp_path):
    path = tmp_path / "bench.xml"
    path.write_text(BENCH.read_text())
    scene = read_scene(path)
    line = 1 + path.read_text().partition('id="crystal_top"')[0].count("\n")
    assert scene.place_of_id("crystal_top") == (path, line)
    with pytest.raises(KeyError):
        scene.place_of_id("nothing")
    assert scene.source(path) == path.read_bytes() and scene.files == (path,)
    assert scene.included == () and list(scene.naming()) == [] and scene.notes == ()
    assert scene.is_unchanged()
    path.write_text(BENCH.read_text().replace("  ", "    "))  # blanks aside
    assert scene.is_unchanged()
    path.write_text(BENCH.read_text().replace('"gap_mm" value="0.05"', '"gap_mm" value="0.06"'))
    assert not scene.is_unchanged() and scene.read_again().parameters["gap_mm"] == 0.06
    other = scene.read_again()
    assert scene.text_or_hash != other.text_or_hash and scene.content_hash != other.content_hash


def test_a_plan_is_put_together_when_it_is_needed(bench):
    plan = ScenePlan(bench, {"n_gap": 1.46})
    assert plan.path == BENCH and plan.file.parameters["n_gap"] == 1.46
    assert plan.file.content_hash == bench.with_overrides({"n_gap": 1.46}).content_hash
    assert pickle.loads(pickle.dumps(plan)).parameters["n_gap"] == 1.46  # the scene itself is sent
    assert "is not a parameter of this scene" in refusal(
        getattr, ScenePlan(bench, {"x": 1}), "file"
    )


@pytest.mark.parametrize(
    ("name", "mend"),
    [
        ("wrapping", 'give bare the value "top sides" (all)'),
        ("sides", "a column sides of 0 and 1 in measurements"),
        ("dead_rim", "take it out of a copy of the scene"),
        ("wraping", "known are: "),
    ],
)
def test_a_part_is_no_parameter_and_it_is_said_what_to_do(name, mend):
    """`-D wrapping=0` was taken for a misspelt parameter, though columns take it off so."""
    wrapped = read_scene(SCENES / "lyso_teflon.xml")
    assert mend in wrapped.mend_of(name) and mend in refusal(wrapped.with_overrides, {name: 0.0})
    # what stands there already need not be written
    assert (
        read_scene(SCENES / "bgo_esr.xml").mend_of("foil").startswith("to take it off, give bare")
    )


def test_the_beam_s_scene_is_the_crystal_alone_in_air(bench):
    derived = spectrophotometer_of(bench.with_overrides({"n_gap": 1.46, "n_crystal": 1.9}))
    assert {shape.get("id") for shape in derived.parts.shapes} >= {"crystal_top", "beam_detector"}
    assert not any("window" in (shape.get("id") or "") for shape in derived.parts.shapes)
    faces = [indices_of(derived, shape) for shape in derived.parts.shapes]
    assert set(faces) == {(1.9, 1.0), None}
    assert derived.parameters.items() >= BEAM_PARAMETERS.items()
    assert "n_window" not in derived.parameters
    assert spectrophotometer_of(derived) is derived


def test_a_bench_whose_liquid_has_no_name_has_no_beam(tmp_path):
    path = tmp_path / "bench.xml"
    path.write_text(
        BENCH.read_text().replace('name="ext_ior" value="$n_gap"', 'name="ext_ior" value="1.46"')
    )
    assert "touches an index of 1.46 in the beam, too" in refusal(
        spectrophotometer_of, read_scene(path)
    )


@cases("name", "value", "says")
def test_beams_that_no_instrument_has(name, value, says):
    assert refused_of_beam(name, value)[1].startswith(says)
    assert refused_of_beam(name, BEAM_PARAMETERS[name]) is None


def test_a_beam_must_not_pass_beside_the_crystal():
    values = {**BEAM_PARAMETERS, "crystal_width_mm": 10.0, "crystal_height_mm": 2.5}
    assert too_wide(values)[0] == "the beam is 3 mm wide, and the crystal across it 2.5 mm"
    assert too_wide({**values, "beam_axis": "z"}) is None


def test_the_slab_in_the_beam_is_that_of_the_faces(bench):
    """Whatever its index is called (a traceback), and thinner one way than the other."""
    text = BENCH.read_text().replace("n_crystal", "n_scint")
    text = text.replace('e y="$crystal_width_mm"', 'e y="5"')
    scene = spectrophotometer_of(bench.edited(text.replace('e y="-$crystal_width_mm"', 'e y="-5"')))
    assert polished_slab(scene) == (2.01, 10.0)
    assert polished_slab(scene.with_overrides({"beam_axis": "y"})) == (2.01, 5.0)
    assert polished_slab(scene.with_overrides({"beam_axis": "z"})) == (2.01, 10.0)
    leaning = text.replace('<rotate x="1" angle="90"/>', '<rotate x="1" angle="80"/>')
    assert polished_slab(spectrophotometer_of(bench.edited(leaning))) is None


def test_the_share_of_scattered_light_behind_plain_polish(bench):
    n, _ = polished_slab(spectrophotometer_of(bench))
    whole, narrow = scattered_share(n, 90.0), scattered_share(n, 1.0)
    # of a cone in the crystal: (1 - cos) / 2
    assert whole == pytest.approx((1 - np.sqrt(1 - 1 / 2.01**2)) / 2)
    assert narrow == pytest.approx(np.sin(np.radians(1.0)) ** 2 / 2.01**2 / 4, rel=1e-3)
    rough = bench.edited(
        BENCH.read_text().replace(
            'type="dielectric" id="crystal_to_air"', 'type="polish" id="crystal_to_air"'
        )
    )
    assert polished_slab(spectrophotometer_of(rough)) is None


def test_light_is_weighed_and_parted_into_colours(bench, tmp_path):
    (tmp_path / "light.csv").write_text(
        "wavelength_nm,emission (photons/nm),efficiency,alpha_scat_per_cm\n"
        "400,0,0.2,4\n500,1,0.2,2\n600,0,0.1,1\n"
    )
    light = read_light(tmp_path / "light.csv", bench)
    assert isinstance(light, EmittedLight) and light.detected
    assert light.weights.sum() == pytest.approx(1.0)
    assert light.mean_nm < 500.0  # red light is detected less well
    assert light.at(450.0) == {"alpha_scat_per_cm": pytest.approx(3.0)}
    colours = light.colours(3)
    assert isinstance(colours, Colours) and colours.parts.sum() == pytest.approx(1.0)
    assert np.all(np.diff(colours.scattering) < 0) and np.all(colours.absorption == 1.0)
    flat = light.seen_by(Spectrum(np.array([300.0, 700.0]), np.array([0.5, 0.5])))
    assert flat.mean_nm == pytest.approx(500.0)


@cases("header", "row", "says")
def test_a_table_of_light_that_cannot_be_used(bench, tmp_path, header, row, says):
    first = "400,1,0.5"[: len(row) if "," in row[4:] else 5]
    (tmp_path / "light.csv").write_text(f"{header}\n{first}\n{row}\n")
    assert says in refusal(read_light, tmp_path / "light.csv", bench)


def test_what_ships_is_found_and_copied_to_be_edited(tmp_path):
    assert shipped.scenes_folder() == SCENES
    assert shipped.scene_path("camoo4.xml") == BENCH
    assert "the scene no.xml is not installed" in refusal(shipped.scene_path, "no.xml")
    names = shipped.scene_files()
    assert names[0].parent == names[0].parent.parent and not any(
        "__pycache__" in n.parts for n in names
    )
    copies = shipped.copy_scenes(tmp_path / "bench")
    assert [path.relative_to(tmp_path / "bench") for path in copies] == list(names)
    assert shipped.copy_scenes(tmp_path / "bench") == copies  # the same may be there
    copies[0].write_text("changed")
    assert "it is there already" in refusal(shipped.copy_scenes, tmp_path / "bench")
