"""`check` finds what is wrong with a scene and names the place; the shipped scenes are sound."""

import pytest
from places import BALL, SCENES, cases_of, tables_of
from refusals import refusal

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.table import eta_table
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.xml_tree import PLUGIN_TYPES
from mcrim_mitsuba.transport.plugins import properties_of_plugins
from mcrim_mitsuba.transport.simulation import Simulation, check_scene
from mcrim_mitsuba.transport.variants import use_variant

cases = cases_of(__file__)

BENCH = (SCENES / "camoo4.xml").read_text(encoding="utf-8")


def shape(name: str) -> str:
    """Text of one shape of the bench."""
    start = BENCH.index(
        f'  <shape type="{"frame" if name == "window_beside_gap" else "rectangle"}" id="{name}"'
    )
    return BENCH[start : BENCH.index("</shape>", start) + len("</shape>\n")]


def replaced(old: str, new: str, text: str = BENCH) -> str:
    assert old in text
    return text.replace(old, new)


def edited(*edits: tuple[str, str, str]) -> str:
    """The bench with texts of a shape, or of all of it (""), replaced in turn."""
    text = BENCH
    for name, old, new in edits:
        where = shape(name) if name else text
        text = replaced(where, replaced(old or where, new, where), text)
    return text


def test_all_that_is_wrong_with_the_text_is_told_at_once(tmp_path):
    """Each once, at its first place, and nothing of what uses a default that is wrong itself."""
    edits = (
        ("", 'name="gap_mm" value="0.05"', 'name="gap_mm" value="-1"'),
        ("", 'name="window_thickness_mm" value="1"', 'name="window_thickness_mm" value="1,5"'),
        ("", "$aperture_radius_mm", "$apertur"),
    )
    path = tmp_path / "scene.xml"
    path.write_text(edited(*edits), encoding="utf-8")
    problems = [problem.text for problem in check_scene(path).problems]
    assert problems == [
        "window_thickness_mm = '1,5' has a decimal comma",
        "$apertur is not declared above this line",
        "gap_mm = -1 turns -$gap_mm into '--1', which is no number",
    ]
    assert refusal(read_scene, path).endswith("write a decimal point: 1.5")


#: Text of the scene, kind of the problem, words that the one line must contain.
BROKEN = {
    name: (edited(*case["edits"]), case["kind"], case["says"])
    for name, case in tables_of(__file__)["broken"].items()
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_scene_is_refused_with_one_line(tmp_path, name):
    text, kind, words = BROKEN[name]
    path = tmp_path / "scene.xml"
    path.write_text(text, encoding="utf-8")
    report = check_scene(path)
    assert not report.ok
    line = str(report.problems[0])
    assert report.problems[0].kind == kind, line
    assert "\n" not in line and line.startswith(str(path)), line
    assert report.problems[0].line or kind == "file", line
    for word in words:
        assert word in line, line


def test_a_wrong_parameter_is_told_once_where_it_is_written(tmp_path):
    """Three faces have its value: each was told as a fault of its own."""
    path = tmp_path / "scene.xml"
    path.write_text(BENCH)
    (problem,) = check_scene(path, {"n_gap": -1.0}).problems
    assert problem.text.startswith("the value given for n_gap is -1: this is no refractive index")
    # another number is another fault
    path.write_text(replaced('name="int_ior" value="$n_crystal"', 'name="int_ior" value="0.5"'))
    assert len(check_scene(path, {"n_gap": -1.0}).problems) > 1


def test_a_height_may_be_anywhere():
    """At the lower end of a crystal half of a slab is inside; 0 was no positive length."""
    overrides = {"source_z_mm": 0.0, "source_width_mm": 5.0}
    assert check_scene(SCENES / "luag_fibre.xml", overrides, light=False).ok


def test_a_stretched_sphere_is_refused(tmp_path):
    """It was called sound, and traced as another shape: eta 0.169 where 0.217 is right."""
    path, radius = tmp_path / "scene.xml", '<float name="radius" value="5"/>'
    for scale, sound in ("3, 3, 3", True), ("3, 4, 2", False):
        turned = f'<scale value="{scale}"/><rotate x="1" angle="30"/><translate y="1"/>'
        path.write_text(
            replaced(
                '<point name="center" x="1" y="-2" z="3"/>\n    ' + radius,
                f'<transform name="to_world">{turned}</transform>',
                BALL.read_text(),
            )
        )
        report = check_scene(path, light=False)
        assert report.ok == sound, report.problems
        assert sound or "ball is stretched by its transform; scale x, y and z" in str(
            report.problems[0]
        )


def test_a_fault_of_an_included_file_is_told_there(tmp_path):
    folder = tmp_path / "with blanks"
    folder.mkdir()
    part = (
        '<bsdf type="aperture" id="u">\n<float name="radus" value="2"/><bsdf type="null"/></bsdf>'
    )
    (folder / "part.xml").write_text(f'<scene version="3.0.0">\n{part}</scene>')
    included = BENCH.replace("</scene>", '<include filename="part.xml"/></scene>')
    (folder / "scene.xml").write_text(included)
    (problem,) = check_scene(folder / "scene.xml").problems
    assert (problem.path, problem.line) == (str(folder / "part.xml"), 3)
    assert problem.mend == "did you mean radius?"
    assert "radius" in properties_of_plugins()["aperture"]


def test_a_rough_face_of_mitsubas_own_is_told_to_lose_light(tmp_path):
    path = tmp_path / "scene.xml"
    rough = '<bsdf type="roughdielectric" id="crystal_to_air"><float name="alpha" value="0.3"/>'
    path.write_text(replaced('<bsdf type="dielectric" id="crystal_to_air">', rough))
    report = check_scene(path, light=False)
    assert report.ok and any(
        word.startswith("crystal_top loses what its facets send on to others")
        for word in report.words
    )


def test_types_of_plugins_that_are_proposed_exist():
    mi = use_variant("llvm_ad_rgb")
    for types in PLUGIN_TYPES.values():
        for name in types:
            try:
                mi.load_dict({"type": name})
            except Exception as error:  # of what it lacks, this or that
                assert "not found" not in str(error), name


def test_a_default_that_nothing_uses_is_a_warning(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(BENCH.replace("<default", '<default name="spare" value="3"/>\n  <default', 1))
    line = BENCH[: BENCH.index("<default")].count("\n") + 1
    said = f"spare of scene.xml, line {line}, is declared but never used"
    report = mcrim.check(path)
    assert report.ok and [note.startswith(said) for note in report.description.notes] == [True]
    found = mcrim.simulate(path, photons=1)
    assert sum(note.startswith(said) for note in found.document["notes"]) == 1
    # what would change nothing is still refused
    assert "never used" in refusal(read_scene, path, {"spare": 4})


@pytest.mark.parametrize("path", sorted(SCENES.rglob("*.xml")), ids=lambda p: p.stem)
def test_shipped_scenes_are_sound(path):
    report = check_scene(path)
    assert report.ok, report.problems


@cases("overrides")
def test_sound_variations_are_not_refused(monkeypatch, overrides):
    use_variant()  # whose plugins give up sooner what is trapped in a clear crystal
    monkeypatch.setattr("mcrim_mitsuba.transport.plugins.light.MAX_DEPTH_CLEAR", 100)
    report = check_scene(SCENES / "camoo4.xml", overrides)
    assert report.ok, report.problems


def test_curved_scenes_are_checked_too(tmp_path):
    report = check_scene(BALL)
    assert report.ok, report.problems
    assert any("Mitsuba for" in sentence for sentence in report.words)
    flipped = '<float name="radius" value="5"/><boolean name="flip_normals" value="true"/>'
    path = tmp_path / "reversed.xml"
    path.write_text(replaced('<float name="radius" value="5"/>', flipped, BALL.read_text()))
    (problem, *_) = check_scene(path).problems
    assert problem.kind == "reversed_face" and "ball" in problem.text


def test_a_detector_inside_the_crystal_is_named(tmp_path):
    path = tmp_path / "inside.xml"
    path.write_text(replaced('"radius" value="20"', '"radius" value="0.5"', BALL.read_text()))
    (problem, *_) = check_scene(path).problems
    assert "detector" in str(problem) and "nan" not in str(problem)


#: A tetrahedron on z = 2.
MESH = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
-3 -3 2
3 -3 2
0 3 2
0 0 8
3 0 2 1
3 0 1 3
3 1 2 3
3 2 0 3
"""
SPHERE = """<shape type="sphere" id="ball">
    <point name="center" x="1" y="-2" z="3"/>
    <float name="radius" value="5"/>
"""


@cases("kind", "old", "new", "says", more=[("ply", "", "", "")])
def test_a_broken_mesh_is_refused_by_its_name(tmp_path, kind, old, new, says):
    named = f'<shape type="{kind}" id="ball"><string name="filename" value="crystal.{kind}"/>'
    path = tmp_path / "scene.xml"
    path.write_text(replaced(SPHERE, named, BALL.read_text()))
    if old != "no file":
        text = replaced(old, new, MESH) if old else MESH
        (tmp_path / f"crystal.{kind}").write_text(text)
    told = [str(problem) for problem in check_scene(path, light=False).problems]
    assert len(told) == bool(says), told
    assert all(f"crystal.{kind}" in line and says in line for line in told), told


def test_a_crystal_without_a_size_is_no_matter_of_units(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(replaced('"radius" value="5"', '"radius" value="0"', BALL.read_text()))
    (problem, *_) = check_scene(path, light=False).problems
    assert problem.text == "the crystal measures 0 x 0 x 0 mm: it is empty"


@pytest.mark.parametrize(("angle", "notes"), [(0, 1), (180, 0)])
def test_a_reflector_that_turns_its_black_back_to_the_crystal_is_noted(tmp_path, angle, notes):
    """Eta is 0.25 so, and 0.31 the other way round."""
    foil = f"""<shape type="rectangle" id="foil"><transform name="to_world"><scale value="20"/>
<rotate x="1" angle="{angle}"/><translate z="12"/></transform><bsdf type="diffuse">
<spectrum name="reflectance" value="0.5"/></bsdf></shape>"""
    path = tmp_path / "scene.xml"
    path.write_text(BENCH.replace("</scene>", f"{foil}</scene>"))
    report = check_scene(path, light=False)
    assert report.ok
    assert sum("foil reflects at its front alone" in note for note in report.notes) == notes


def test_mitsubas_warnings_are_notes_and_never_in_standard_output(tmp_path, capfd):
    """They came before the JSON that was asked for, coloured."""
    path = tmp_path / "scene.xml"
    wide = '<shape type="cylinder" id="ball"><transform name="to_world"><scale x="2"/></transform>'
    path.write_text(replaced(SPHERE, wide, BALL.read_text()))
    notes = check_scene(path, light=False).notes
    assert any("Mitsuba warns: [Cylinder] 'to_world' transform" in note for note in notes), notes
    assert capfd.readouterr().out == ""


def test_an_index_left_out_is_missed_where_its_bsdf_is_written(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(BROKEN["outer index left out"][0])
    (problem,) = check_scene(path).problems
    assert problem.line == read_scene(path).place_of_id("crystal_to_air")[1]


@cases("overrides", "words")
def test_the_python_api_refuses_what_the_command_line_refuses(overrides, words):
    assert words in refusal(Simulation, SCENES / "camoo4.xml", overrides)


def test_a_table_checks_the_scene_at_each_coupling(tmp_path):
    """With air in the gap the mistake makes no difference; with gel it takes 40 % of eta."""
    path = tmp_path / "gel.xml"
    start = BENCH.index('<bsdf type="dielectric" id="crystal_to_gap">')
    path.write_text(BENCH[:start] + BENCH[start:].replace('value="$n_gap"', 'value="1.0"', 1))
    refused = refusal(eta_table, path, {"n_gap": [1.0, 1.46]}, run=Run(10_000))
    assert "crystal_bottom gives the gap the index 1" in refused
