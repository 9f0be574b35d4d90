"""The text of a scene, changed in place: what is not touched stays byte for byte."""

import difflib
from pathlib import Path

import pytest
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.xml_tree import Node

cases = cases_of(__file__)

BENCH = SCENES / "camoo4.xml"


@pytest.fixture
def editor() -> SceneEditor:
    return SceneEditor(read_scene(BENCH), {})


def edited(text: str | bytes, folder: Path, name: str = "bench.xml") -> SceneEditor:
    """An editor of a scene of this text."""
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return SceneEditor(read_scene(folder / name), {})


def changes(editor: SceneEditor) -> tuple[list[str], list[str]]:
    """Lines taken away and lines put in."""
    lines = difflib.ndiff(
        editor.scene.path.read_bytes().decode().splitlines(), editor.finished().splitlines()
    )
    kept = [line for line in lines if line[0] in "-+"]
    return [x[2:] for x in kept if x[0] == "-"], [x[2:] for x in kept if x[0] == "+"]


def test_nothing_changed_is_the_file_byte_for_byte(editor):
    assert editor.finished().encode() == BENCH.read_bytes()


def test_parts_of_the_bench_are_found_by_what_they_are(editor):
    assert editor.crystal is editor.by_id["crystal"] and editor.crystal.type == "bulk"
    assert (editor.gap, editor.window) == (editor.by_id["gap"], editor.by_id["window"])
    assert editor.emitter.type == "scintillation"
    assert len(editor.crystal_faces) == 6 and set(editor.crystal_faces) < set(editor.shapes)
    bottom = editor.by_id["crystal_bottom"]
    assert editor.media(bottom) == (editor.crystal, editor.gap)
    assert editor.medium(editor.by_id["crystal_top"], "exterior") is None
    assert editor.bsdf(bottom) is editor.by_id["crystal_to_gap"]
    assert editor.targets(editor.emitter, "medium") == [editor.crystal]
    assert editor.worn_by(bottom) == [editor.by_id["crystal_to_gap"]]
    assert {p.label for p in editor.crystal_polish} == {"crystal_to_gap", "crystal_to_air"}
    [detector] = editor.detectors
    assert editor.before(detector) == {editor.window}
    assert editor.index_before(detector) == "$n_window"
    assert editor.masks == editor.all("bsdf", "aperture") and len(editor.masks) == 2
    assert editor.default("gap_mm").attrib["value"] == "0.05"
    with pytest.raises(KeyError):
        editor.default("nothing")


def test_nodes_know_their_neighbours(editor):
    top = editor.by_id["crystal_top"]
    assert isinstance(top, Node) and top.getparent() is editor.root
    assert top in editor.root.elements and top in list(editor.root.iter())
    transform = top.named("to_world")
    assert transform is top.find("transform[@name='to_world']") and transform.getparent() is top
    assert top.find("transform[@name='other']") is None and top.named("other") is None
    assert transform.getprevious() is None and transform.getnext() in top.elements
    assert transform.label == "the <transform> of type " and top.label == "crystal_top"


def test_every_change_is_made_where_it_was_asked_for(editor):
    crystal, air = editor.crystal, editor.by_id["crystal_to_air"]
    editor.insert_first(crystal, '<float name="first" value="1"/>')
    editor.insert_last(crystal, '<float name="a" value="2"/>\n<float name="b" value="3"/>')
    editor.insert_last(editor.gap, '<float name="index" value="4"/>')  # it had no content
    editor.set_attribute(air, "type", 'po"lish')
    editor.insert_after(editor.by_id["window"], '<medium type="bulk" id="new"/>')
    editor.set_default("gap_mm", 0.1)
    editor.declare("new_mm", 0.25, "A <new> number, mm")
    editor.reword(editor.emitter, "everywhere", "somewhere")
    editor.reword(editor.emitter, "not there", "x")
    taken, put = changes(editor)
    assert taken == [
        '  <default name="gap_mm" value="0.05"/>',
        '  <medium type="bulk" id="gap"/>',
        "  <!-- Scintillation: photons are born everywhere in the crystal, in all directions -->",
        '  <bsdf type="dielectric" id="crystal_to_air">',
    ]
    assert put == [
        '  <default name="gap_mm" value="0.1"/>',
        "  <!-- A &lt;new&gt; number, mm -->",
        '  <default name="new_mm" value="0.25"/>',
        '    <float name="first" value="1"/>',
        '    <float name="a" value="2"/>',
        '    <float name="b" value="3"/>',
        '  <medium type="bulk" id="gap">',
        '    <float name="index" value="4"/>',
        "  </medium>",
        '  <medium type="bulk" id="new"/>',
        "  <!-- Scintillation: photons are born somewhere in the crystal, in all directions -->",
        '  <bsdf type="po&quot;lish" id="crystal_to_air">',
    ]


def test_elements_are_replaced_and_removed_with_their_blanks(editor):
    top = editor.by_id["crystal_top"]
    text = editor.source(top)
    assert text.startswith('<shape type="rectangle" id="crystal_top">\n  <transform')
    editor.replace(top, text.replace("crystal_top", "lid"))
    editor.remove(editor.by_id["gap"])
    editor.set_comment(editor.by_id["crystal"], "no comment is directly above it")
    editor.insert_shape('<shape type="disk" id="disk"/>', after=editor.shapes[-1])
    taken, put = changes(editor)
    assert taken[0] == '  <medium type="bulk" id="gap"/>' and "crystal_top" in taken[1]
    assert ['  <shape type="disk" id="disk"/>' in put, len(taken)] == [True, 2]
    editor.refuse_id("disk")
    assert refusal(editor.refuse_id, "window").startswith(f"{BENCH}, line ")


def test_changes_that_overlap_are_our_fault(editor):
    editor.replace(editor.by_id["crystal_top"], "<shape/>")
    editor.remove(editor.by_id["crystal_top"])
    with pytest.raises(ValueError, match="two changes of a scene overlap"):
        editor.finished()


def test_names_are_put_in_at_other_parameters_too(editor):
    last = editor.shapes[-1]
    assert editor.resolved()[last].get("id") == last.attrib["id"]
    gap = editor.by_id["crystal_to_gap"]
    values = [
        editor.resolved({"n_gap": n})[gap].findall("float")[1].get("value") for n in (1.2, 1.4)
    ]
    assert values == ["1.2", "1.4"]


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_line_ends_marks_and_other_letters_stay(tmp_path, line_end, mark):
    text = BENCH.read_text().replace("polished CaMoO4", "polished CaMoO₄ 晶体 ±")
    text = mark + text.replace("\n", line_end)
    editor = edited(text, tmp_path)
    editor.insert_last(editor.crystal, '<!-- wird größer -->\n<float name="g" value="1"/>')
    after = editor.finished()
    new = f'    <!-- wird größer -->{line_end}    <float name="g" value="1"/>{line_end}'
    assert after.replace(new, "", 1) == text and new in after


def test_other_indentation_is_followed(tmp_path):
    text = BENCH.read_text().replace("  ", "\t")
    editor = edited(text, tmp_path)
    assert editor.source(editor.by_id["crystal_to_air"]).split("\n")[1].startswith("  <float")
    editor.insert_last(editor.crystal, '<phase type="hg">\n  <float name="g" value="1"/>\n</phase>')
    assert '\n\t\t<phase type="hg">\n\t\t\t<float name="g" value="1"/>\n\t\t</phase>\n' in (
        editor.finished()
    )


PART = """<?xml version="1.0"?>
<!-- the volumes -->
<scene version="3.0.0">
  <default name="gap_mm" value="9"/>
  <medium type="bulk" id="gap"/>
</scene>
"""


def test_an_included_file_stays_until_a_change_stands_in_it(tmp_path):
    text = BENCH.read_text().replace(
        '  <medium type="bulk" id="gap"/>\n', '  <include filename="part.xml"/>\n'
    )
    (tmp_path / "part.xml").write_text(PART)
    editor = edited(text, tmp_path)
    editor.insert_last(editor.crystal, '<float name="x" value="1"/>')
    assert '<include filename="part.xml"/>' in editor.finished()
    editor.insert_last(editor.gap, '<float name="y" value="1"/>')
    after = editor.finished()
    assert "<include" not in after and "the volumes" in after
    # the first default of a name has won, and the second one is left out
    assert after.count('name="gap_mm"') == 1
    assert '  <medium type="bulk" id="gap">\n    <float name="y" value="1"/>\n  </medium>' in after
    assert editor.refusal("p", "m", editor.gap).place == f"{tmp_path / 'part.xml'}, line 5"


def test_defaults_that_have_lost_are_left_out_wherever_they_stand(tmp_path):
    """One that was the first in an included file moved all that was changed behind it."""
    (tmp_path / "part.xml").write_text(PART.replace("<!-- the volumes -->\n", ""))
    text = BENCH.read_text().replace('  <medium type="bulk" id="gap"/>\n', "")
    include = '  <include filename="part.xml"/>\n'
    first = '<scene version="3.0.0">\n'
    for place, kept in (("</scene>", "0.05"), (first, "9")):
        whole = text.replace(place, first + include if place == first else include + place)
        editor = edited(whole, tmp_path)
        editor.insert_last(editor.gap, '<float name="y" value="1"/>')
        scene = editor.scene.edited(editor.finished())
        assert scene.parameters["gap_mm"] == editor.scene.parameters["gap_mm"] == float(kept)
        assert editor.finished().count('name="gap_mm"') == 1
        assert scene.root.find("medium[@id='gap']/float").get("name") == "y"


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-16"])
def test_what_is_no_utf_8_is_not_edited(tmp_path, encoding):
    text = BENCH.read_text().replace('encoding="utf-8"', f'encoding="{encoding}"')
    with pytest.raises(InputError, match="only scenes in UTF-8 can be edited"):
        edited(text.encode(encoding), tmp_path)


@cases("old", "new", "part", "says")
def test_a_bench_without_a_part_is_refused_with_the_mend(tmp_path, old, new, part, says):
    text = BENCH.read_text()
    assert old in text
    editor = edited(text.replace(old, new), tmp_path)
    assert says in refusal(getattr, editor, part)
