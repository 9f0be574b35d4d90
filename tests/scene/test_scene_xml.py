"""Scene files: what is read from them, and how bad ones are refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.runs.scene_units import PortableScene
from mcrim_mitsuba.scene.scene_file import DefaultParameter, SceneFile, parse_define, read_scene
from mcrim_mitsuba.scene.xml_tree import parse_scene_xml, three_numbers, transform_matrix

cases = cases_of(__file__)

SCENE = Path(__file__).with_name("bench.xml").read_text()


def write(tmp_path, text, name="bench.xml"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_parameters_keep_their_comment_unit_and_line(tmp_path):
    scene = read_scene(write(tmp_path, SCENE))
    known = scene.defaults
    assert isinstance(known["n_gap"], DefaultParameter) and isinstance(scene, SceneFile)
    assert list(known) == ["n_crystal", "n_gap", "gap_mm", "polarization", "max_depth", "below_mm"]
    assert known["n_crystal"].comment.startswith("Refractive index of the crystal at the")
    assert known["n_gap"].comment == "index of the gap"
    assert known["gap_mm"].comment == ""  # the comment above belongs to n_gap
    assert known["polarization"].comment == "track polarisation"
    assert (known["gap_mm"].unit, known["n_gap"].unit, known["gap_mm"].line) == ("mm", None, 9)
    assert known["below_mm"].value == "-$gap_mm"
    assert scene.parameters == {
        "n_crystal": 2.01,
        "n_gap": 1.0,
        "gap_mm": 0.05,
        "polarization": False,
        "max_depth": 100,
        "below_mm": -0.05,
    }


def test_elements_have_names_put_in_and_the_line_where_they_start(tmp_path):
    scene = read_scene(write(tmp_path, SCENE))
    assert [e.get("value") for e in scene.root.iter("float")] == ["2.01", "1.00"]
    assert [e.get("z") for e in scene.root.iter("translate")] == ["-0.05", "-0.05"]
    assert scene.place_of_id("top")[1] == 19  # its tag ends on line 20
    assert scene.place_of_id("crystal")[1] == 27  # not the <ref>
    assert scene.place_of(scene.root.find("shape")) == (scene.path, 19)


def test_spectra_that_an_attribute_names_are_a_part_of_the_scene(tmp_path):
    """Else the cache took what was simulated with another spectrum for this one."""
    spectrum = '<emitter type="constant"><spectrum name="radiance" filename="s.spd"/></emitter>'
    path = write(tmp_path, SCENE.replace("</scene>", f"{spectrum}</scene>"))
    scenes = []
    for content in ("400 1\n700 1\n", "400 1\n700 2\n"):
        (tmp_path / "s.spd").write_text(content)
        scenes.append(read_scene(path))
        assert tmp_path / "s.spd" in scenes[-1].files
        assert PortableScene.of(scenes[-1]).files == (("s.spd", content.encode()),)
    assert scenes[0].content_hash != scenes[1].content_hash


def test_overrides_win_and_only_those_that_change_something_count(tmp_path):
    scene = read_scene(write(tmp_path, SCENE))
    same = scene.with_overrides({"n_gap": 1.0, "polarization": "False"})
    assert same.overrides_for_mitsuba() == {}
    assert same.content_hash == scene.content_hash

    gel = scene.with_overrides({"n_gap": np.float64(1.46), "polarization": np.True_})
    assert gel.overrides_for_mitsuba() == {"n_gap": "1.46", "polarization": "true"}
    assert gel.parameters["n_gap"] == 1.46
    assert gel.root.find("shape/bsdf/float[@name='ext_ior']").get("value") == "1.46"
    assert gel.content_hash != scene.content_hash
    assert gel.with_overrides({"max_depth": 5.0}).overrides_for_mitsuba()["max_depth"] == "5"


def test_hash_ignores_layout_and_comments(tmp_path):
    other = SCENE.replace("<!-- The bench -->", "").replace("    <", "\n <")
    scenes = [read_scene(write(tmp_path, text, "x.xml")) for text in (SCENE, other)]
    assert scenes[0].content_hash == scenes[1].content_hash


def test_includes_share_names_and_the_first_default_wins(tmp_path):
    (tmp_path / "parts").mkdir()
    part = """<scene version="3.0.0">
      <default name="n_gap" value="9"/><default name="n_window" value="1.52"/>

      <shape id="inner" ior="$n_gap"/></scene>"""
    whole = """<scene version="3.0.0"><default name="n_gap" value="1.46"/><shape id="first"/>
      <include filename="parts/window.xml"/><shape id="last" ior="$n_window"/></scene>"""
    write(tmp_path, part, "parts/window.xml")
    scene = read_scene(write(tmp_path, whole))
    assert [e.get("id") for e in scene.root] == ["first", "inner", "last"]
    assert [e.get("ior") for e in scene.root] == [None, "1.46", "1.52"]
    assert scene.place_of(scene.root[1]) == (tmp_path / "parts/window.xml", 4)
    assert scene.defaults["n_window"].path == tmp_path / "parts/window.xml"


def test_scene_that_was_read_does_not_change_with_the_file(tmp_path):
    scene = read_scene(write(tmp_path, SCENE))
    scene.path.unlink()
    assert scene.with_overrides({"n_gap": 1.3}).parameters["n_gap"] == 1.3


def test_an_edited_text_stands_for_the_file(tmp_path):
    scene = read_scene(write(tmp_path, SCENE), {"gap_mm": 0.2})
    edited = scene.edited(SCENE.replace('"1.00"', '"1.33"'))
    assert (edited.parameters["n_gap"], scene.parameters["n_gap"]) == (1.33, 1.0)
    assert edited.overrides == scene.overrides
    assert edited.content_hash != scene.content_hash
    assert scene.unwritten_text is None and '"1.33"' in edited.unwritten_text
    further = edited.with_overrides({"n_crystal": 1.9})
    assert further.parameters["n_gap"] == 1.33 and further.unwritten_text == edited.unwritten_text

    for each in (scene, further):
        copy = pickle.loads(pickle.dumps(each))
        assert copy.content_hash == each.content_hash and copy.parameters == each.parameters
    write(tmp_path, SCENE.replace("2.01", "2.05"))
    assert scene.read_again().content_hash != scene.content_hash
    assert further.read_again().content_hash == further.content_hash
    assert "bench.xml, line 3" in refusal(
        scene.edited, "<scene version='3'>\n\n<a b='$c'/></scene>"
    )


@cases(
    "text",
    "place",
    "says",
    more=[(b"<scene version='3.0.0'>\n<a b='\xe9'/></scene>", "line 2", "UTF-8")],
)
def test_bad_scenes_are_refused_in_one_line(tmp_path, text, place, says):
    refused = refusal(read_scene, write(tmp_path, text))
    assert str(tmp_path / "bench.xml") in refused and place in refused and says in refused


@cases("overrides", "says")
def test_bad_overrides_are_refused(tmp_path, overrides, says):
    refused = refusal(read_scene, write(tmp_path, SCENE), overrides)
    # nothing on a line of the file is wrong
    assert says in refused and "bench.xml: " in refused


def test_files_that_cannot_be_opened(tmp_path):
    write(tmp_path, SCENE)
    for name, says in [
        ("bensh.xml", "did you mean bench.xml?"),
        ("", "folder"),
        ("no/bench.xml", "does not exist"),
    ]:
        assert says in refusal(read_scene, tmp_path / name)
    large = write(tmp_path, SCENE + " " * 5_000_000, "large.xml")
    assert "larger than 5 MB" in refusal(read_scene, large)


def test_define():
    assert parse_define("n_gap = 1.46") == ("n_gap", "1.46")
    for text in ("n_gap", "=1", "n_gap=", "n gap=1"):
        assert "write for example -D n_gap=1.46" in refusal(parse_define, text)


def test_transforms_are_matrices_step_after_step():
    def matrix(steps):
        data = f'<scene version="3"><shape><transform name="to_world">{steps}</transform></shape>'
        shape = parse_scene_xml(f"{data}</scene>".encode(), Path("bench.xml"))[0]
        return transform_matrix(shape.named("to_world"))

    turned = matrix('<scale value="2"/><rotate z="1" angle="90"/><translate x="1" z="-3"/>')
    expected = [[0, -2, 0, 1], [2, 0, 0, 0], [0, 0, 2, -3], [0, 0, 0, 1]]
    np.testing.assert_allclose(turned, expected, atol=1e-15)
    written = " ".join(str(n) for row in expected for n in row)
    np.testing.assert_array_equal(matrix(f'<matrix value="{written}"/>'), expected)
    np.testing.assert_array_equal(transform_matrix(None), np.eye(4))
    node = parse_scene_xml(b'<scene version="3"><scale value="1, 2, 3"/></scene>', Path("a.xml"))
    assert three_numbers(node[0], 1.0) == [1.0, 2.0, 3.0]
    for wrong, words in (
        ('<lookat origin="0 0 0"/>', "<lookat> of a transform"),
        ('<rotate z="1"/>', "convert string to float"),
        ('<translate value="1 2"/>', "shape"),
    ):
        with pytest.raises(ValueError, match=words):
            matrix(wrong)
