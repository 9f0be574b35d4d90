"""What can be checked by reading a scene: words, values, indices and surfaces; its XML."""

import struct
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from places import ROOT, SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.scene import check_text, xml_tree
from mcrim_mitsuba.scene.check_text import CheckReport, Interface, SceneProblem, problems_of_text
from mcrim_mitsuba.scene.mesh_file import read_mesh, refuse_broken_meshes
from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)

BENCH = SCENES / "camoo4.xml"
TEXT = BENCH.read_text()


def problems(folder: Path, *changes: tuple[str, str]) -> list[str]:
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "bench.xml").write_text(text)
    return [str(problem) for problem in problems_of_text(read_scene(folder / "bench.xml"))]


def test_a_sound_bench_has_no_problem(tmp_path):
    assert problems(tmp_path) == []


def test_mesh_files_are_read_in_all_their_forms(tmp_path):
    """With colours, comments, other ends of lines; and one in which the -1 is binary."""
    corners, facets = np.eye(4, 3), [(0, 2, 1), (0, 1, 3)]
    head = "ply\r\nformat {} 1.0\r\ncomment c\r\nelement vertex 4\r\nproperty float x\r\n"
    head += "property float y\r\nproperty uchar red\r\nproperty float z\r\nelement face 2\r\n"
    head += "property list uchar int vertex_index\r\nend_header\r\n"
    text = "\n".join(f"{x} {y} 9 {z}" for x, y, z in corners) + "\n3 0 2 1 3\n0 1 3"
    (tmp_path / "text.ply").write_text(head.format("ascii") + text, newline="")
    for order, name in (("<", "little"), (">", "big")):
        data = b"".join(struct.pack(f"{order}ffBf", x, y, 9, z) for x, y, z in corners)
        data += b"".join(struct.pack(f"{order}Biii", 3, *facet) for facet in facets)
        start = head.format(f"binary_{name}_endian").encode()
        (tmp_path / f"{name}.ply").write_bytes(start + data)
        (tmp_path / "minus.ply").write_bytes(start + data[:-12] + b"\xff" * 4 + data[-8:])
        assert "vertex -1" in refusal(read_mesh, tmp_path / "minus.ply", "ply")
    obj = "".join(f"v {x} {y} {z} # p\n" for x, y, z in corners) + "f 1//1 3//1 2//1\nf 1 2 4\n"
    (tmp_path / "text.obj").write_text(obj)
    for name in ("text.ply", "little.ply", "big.ply", "text.obj"):
        vertices, triangles = read_mesh(tmp_path / name, name[-3:])
        assert np.array_equal(vertices, corners) and triangles.tolist() == [*map(list, facets)]


def test_the_mesh_is_judged_that_mitsuba_takes(tmp_path):
    """The last <path> is searched first, the scene's own folder after all of them."""
    named = '<path value="a"/><shape type="obj"><string name="filename" value="m.obj"/></shape>'
    (tmp_path / "s.xml").write_text(f'<scene version="3.0.0">{named}</scene>')
    (tmp_path / "a").mkdir()
    file = read_scene(tmp_path / "s.xml")
    assert "line 1: there is no mesh file m.obj" in refusal(refuse_broken_meshes, file)
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    refuse_broken_meshes(file)
    (tmp_path / "a" / "m.obj").write_text("v 0 0 0\n")
    assert "a/m.obj: the mesh has no triangles" in refusal(refuse_broken_meshes, file)


def test_what_is_counted_is_a_detector_of_the_scene(tmp_path):
    assert check_text.detectors_of(read_scene(SCENES / "plastic_bar.xml")) == ["left", "right"]
    counted = '<string name="detector" value="detectro"/>'
    (told,) = problems(tmp_path, ("</integrator>", f"{counted}</integrator>"))
    assert (
        "detector = 'detectro' is the id of no shape" in told and "did you mean detector?" in told
    )
    file = read_scene(tmp_path / "bench.xml")
    assert [str(problem) for problem in check_text.problems_of_counted(file)] == [told]


@cases("old", "new", "line", "says")
def test_a_value_is_blamed_where_it_was_written(tmp_path, old, new, line, says):
    assert old in TEXT
    path = tmp_path / "bench.xml"
    path.write_text(TEXT.replace(old, new, 1))
    refused = refusal(read_scene, path)
    assert refused.startswith(f"{path}, line {line}: ") and says in refused
    included = tmp_path / "whole.xml"
    included.write_text('<scene version="3.0.0"><include filename="bench.xml"/></scene>')
    assert refusal(read_scene, included) == refused


def test_a_value_that_was_given_is_not_blamed_on_a_line(tmp_path):
    path = tmp_path / "bench.xml"
    path.write_text(
        TEXT.replace('name="polarization" value="false"', 'name="polarization" value="no"')
    )
    refused = refusal(read_scene, path, {"polarization": "yes"})
    assert refused.startswith(f"{path}: the value given for polarization, 'yes', is neither true")
    assert read_scene(path, {"polarization": "true"}).parameters["polarization"] == "true"


SHIPPED = sorted([*SCENES.rglob("*.xml"), *(ROOT / "tests" / "trials").glob("*.xml")])


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_no_value_of_a_shipped_scene_is_doubted(path):
    assert read_scene(path).notes == ()


AIR = '<float name="ext_ior" value="1.0"/>'


@cases("old", "new", "says")
def test_problems_are_told_with_line_and_mend(tmp_path, old, new, says):
    changed = [(old, new), ("</emitter>", "</emiter>")] if "emiter" in new else [(old, new)]
    told = problems(tmp_path, *changed)
    text = (tmp_path / "bench.xml").read_text()
    place = f"{tmp_path / 'bench.xml'}, line {text[: text.index(new)].count(chr(10)) + 1}: "
    assert any(line.startswith(place) and says in line for line in told), told


def test_an_id_of_two_elements_is_told_with_both_places(tmp_path):
    [told] = problems(tmp_path, ('id="crystal_top"', 'id="crystal_to_gap"'))
    assert f"{tmp_path / 'bench.xml'}, line 109: the id 'crystal_to_gap' is given a second" in told
    assert "(first on line 78 of bench.xml); an id is of one element: write another" in told


def test_an_index_that_is_not_written_is_told(tmp_path):
    [told] = problems(tmp_path, (AIR, ""))
    assert "bsdf 'crystal_to_air' does not say its ext_ior: Mitsuba would take 1.000277" in told


def test_a_value_that_was_given_is_not_blamed_on_the_file():
    [problem] = problems_of_text(read_scene(BENCH, {"gap_mm": 50.0}))
    assert str(problem).startswith(f"{BENCH}: the value given for gap_mm is 50: ")
    assert problem.kind == "unit" and problem.error().mend == "write it in mm: 0.05"


def test_a_rotation_that_would_shear_is_told(tmp_path):
    [told] = problems(tmp_path, ('<rotate x="1"', '<rotate x="1" y="1"'))
    assert "has the length 1.414: Mitsuba would distort the shape" in told
    assert told.endswith('give it the length 1: x="0.707107" y="0.707107" z="0"')


def test_shapes_without_id_or_surface_are_told(tmp_path):
    shapes = '<shape type="disk"/><shape type="disk" id="d"/></scene>'
    told = problems(tmp_path, ("</scene>", shapes))
    assert [line.split(": ", 1)[1] for line in told] == [
        'this shape has no id; give it one: <shape id="...">',
        "d has no bsdf: Mitsuba would make it a grey diffuse reflector; say what light meets "
        "there, for example with a <ref/> to a dielectric",
    ]


def test_surfaces_and_indices_of_faces():
    scene = read_scene(BENCH, {"n_gap": 1.46})
    shapes = {shape.get("id"): shape for shape in scene.parts.shapes}
    bottom = shapes["crystal_bottom"]
    assert scene.parts.bsdf(bottom).get("id") == "crystal_to_gap"
    assert check_text.indices_of(scene, bottom) == (2.01, 1.46)
    assert check_text.indices_of(scene, shapes["crystal_top"]) == (2.01, 1.0)
    assert None in [check_text.indices_of(scene, shape) for shape in shapes.values()]
    assert check_text.is_filled(1.46) and not check_text.is_filled(1.0003)


def test_a_report_is_in_order_without_problems():
    problem = SceneProblem("value", "it is wrong", "mend it", BENCH, 3)
    assert str(problem) == f"{BENCH}, line 3: it is wrong; mend it"
    face = Interface("top", "dielectric", "crystal", "outside", 2.01, 1.0, BENCH, 3)
    assert CheckReport((), {}, (face,)).ok and not CheckReport((problem,), {}).ok


HEAD = '<scene version="3.0.0">'


def test_xml_keeps_the_line_where_an_element_starts():
    root = xml_tree.parse_scene_xml(f"{HEAD}\n<shape\n  type='disk'\n/></scene>".encode(), BENCH)
    assert [(e.tag, e.sourceline) for e in root.iter()] == [("scene", 1), ("shape", 2)]
    # whoever gets it may change it
    root.clear()
    again = xml_tree.parse_scene_xml(f"{HEAD}\n<shape\n  type='disk'\n/></scene>".encode(), BENCH)
    assert len(again) == 1


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_lines_are_those_of_the_file_in_any_encoding(encoding, line_end):
    head = (
        f'<?xml version="1.0" encoding="{encoding.removesuffix("-sig")}"?>\n<!-- é > " -->\n{HEAD}'
    )
    text = head + "<!-- <a/> -->\n<![CDATA[ <b>\n ]]><c\n d='>'\n/>\n<?e <f>?><g\n/></scene>"
    root = xml_tree.parse_scene_xml(text.replace("\n", line_end).encode(encoding), BENCH)
    assert [node.sourceline for node in root.iter("scene", "c", "g")] == [3, 5, 8]


def test_elements_and_comments_know_where_they_stand():
    text = f"<!-- <a/> -->{HEAD}<!-- > --><b c='>'/> <d><![CDATA[<e>]]></d></scene>\n<!-- -->"
    root = xml_tree.parse_scene_xml(text.encode(), BENCH)
    spans = xml_tree.spans_of(root, text)
    assert [text[span.start : span.end] for span in spans.values()] == [
        text[13:-9],
        "<!-- > -->",
        "<b c='>'/>",
        "<d><![CDATA[<e>]]></d>",
    ]
    b, d = root.elements
    assert isinstance(spans[b], xml_tree.Span) and spans[b].inside == spans[b].close == spans[b].end
    assert text[spans[d].inside : spans[d].close] == "<![CDATA[<e>]]>"
    assert xml_tree.comment_before(b) is root[0] and xml_tree.comment_after(root[0]) is None


def test_references_lead_through_aliases_to_the_same_element():
    parts = read_scene(BENCH).parts
    parts.root.append(parts.root.makeelement("alias", {"id": "gap", "as": "other"}))
    reference = parts.root.makeelement("ref", {"id": "other"})
    assert parts.target(reference) is parts.by_id["gap"] and parts.target(parts.root) is parts.root


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"{HEAD}<shape></scene>", "malformed XML: Opening and ending tag mismatch"),
        ("<bench/>", "the outermost element is <bench>, not <scene>"),
        ("<scene/>", 'line 1: <scene> has no version; write <scene version="3.0.0">'),
        ('<!DOCTYPE scene [<!ENTITY a "b">]>' + HEAD + "&a;</scene>", "are not accepted"),
        (HEAD + "<a>" * 60 + "</a>" * 60 + "</scene>", "nested more than 50 deep"),
        (HEAD + "<a " + " ".join(f'b{i}=""' for i in range(101)) + "/></scene>", "100 attributes"),
        (HEAD + "<a/>" * 200_000 + "</scene>", "more than 200,000 tags"),
    ],
)
def test_xml_that_is_no_scene_is_refused(text, says):
    assert says in refusal(xml_tree.parse_scene_xml, text.encode(), Path("a.xml"))


def test_a_comment_explains_the_element_beside_or_below_it():
    root = etree.fromstring(
        "<a>\n<!-- above\n b --><b/>\n<c/> <!-- beside c -->\n<d/>\n<!-- far -->\n\n<e/></a>"
    )
    assert [xml_tree.comment_of(e) for e in root.iter("b", "c", "d", "e")] == [
        "above b",
        "beside c",
        "",
        "",
    ]


@cases("text", "says")
def test_words_that_mitsuba_does_not_know(text, says):
    *_, last = etree.fromstring(text).iter()
    wrong = xml_tree.misspelt(last)
    assert [part.split(" Known")[0] for part in wrong or ()] == says


def test_references_to_nothing_or_on_no_side():
    root = etree.fromstring(
        '<scene><medium type="bulk" id="m"/><alias id="m" as="n"/><shape type="disk" id="s">'
        '<ref id="q"/><ref id="m"/><ref name="interior" id="n"/></shape></scene>'
    )
    parts = xml_tree.SceneParts(root)
    assert [(e.get("id"), problem) for e, problem, _ in xml_tree.misled(parts)] == [
        ("q", "'q' is the id of nothing in this scene"),
        ("m", "the volume 'm' is on no side of this shape: name=''"),
    ]
