"""`check` finds what is wrong with a scene and names the place; the shipped scenes are sound."""

import pytest
from places import BALL, SCENES
from refusals import refusal

from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.transport.simulation import check_scene

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


def edited(name: str, old: str, new: str) -> str:
    return replaced(shape(name), replaced(old, new, shape(name)))


def added(text: str) -> str:
    return replaced("</scene>", text + "\n</scene>")


HOMOGENEOUS = """<medium type="homogeneous" id="crystal">
    <float name="sigma_t" value="$alpha_scat_per_cm"/><float name="albedo" value="{}"/>
    <float name="scale" value="$alpha_abs_per_cm"/></medium>"""
BULK = BENCH[
    BENCH.index('<medium type="bulk" id="crystal">') : BENCH.index('<medium type="bulk" id="gap"/>')
]
DISC = """<shape type="rectangle" id="extra"><transform name="to_world"><scale value="3"/>
  <translate z="{}"/></transform><ref id="crystal_to_air"/></shape>"""
BLOCK = """<medium type="bulk" id="block"/><shape type="cube" id="block_faces">
  <transform name="to_world"><translate x="{}" y="0.1" z="5.1"/></transform>
  <ref id="crystal_to_air"/><ref name="interior" id="block"/></shape>"""

#: what is broken: (text of the scene, kind, words that the one line must contain)
BROKEN = {
    "gap index of one face": (
        edited("crystal_bottom", '<ref id="crystal_to_gap"/>', '<ref id="crystal_to_air"/>').replace(
            '"n_gap" value="1.00"', '"n_gap" value="1.46"'),
        "index", ["crystal_bottom", "gap", "1.46"]),
    "crystal index of one face": (
        edited("crystal_side_left", '<ref id="crystal_to_air"/>',
               '<bsdf type="dielectric"><float name="int_ior" value="1.9"/>'
               '<float name="ext_ior" value="1.0"/></bsdf>'),
        "index", ["crystal_side_left", "1.9", "2.01"]),
    "index beside an unnamed gap": (
        replaced('    <ref name="exterior" id="gap"/>\n', "", replaced(
            '    <ref name="interior" id="gap"/>\n', "")).replace(
            '  <medium type="bulk" id="gap"/>\n', "").replace(
            '"n_gap" value="1.00"', '"n_gap" value="1.46"').replace(
            shape("crystal_bottom").replace('    <ref name="exterior" id="gap"/>\n', ""),
            shape("crystal_bottom").replace('    <ref name="exterior" id="gap"/>\n', "").replace(
                "crystal_to_gap", "crystal_to_air")),
        "index", ["says"]),
    "outer index left out": (
        replaced('    <float name="int_ior" value="$n_crystal"/>\n    <float name="ext_ior" value="1.0"/>',
                 '    <float name="int_ior" value="$n_crystal"/>'),
        "index", ["crystal_to_air", "ext_ior", "1.000277"]),
    "named air": (
        replaced('    <float name="int_ior" value="$n_crystal"/>\n    <float name="ext_ior" value="1.0"/>',
                 '    <float name="int_ior" value="$n_crystal"/>\n    <string name="ext_ior" value="air"/>'),
        "index", ["1.00028", "index beside it"]),
    "missing top": (replaced(shape("crystal_top"), ""), "missing_face", ["crystal", "z = 10"]),
    "missing side of the gap": (
        replaced(shape("gap_side_left"), ""), "missing_face", ["gap", "x = -5"]),
    "missing detector": (replaced(shape("detector"), ""), "file", ["detector", "photodetector"]),
    "leaking top": (
        edited("crystal_top", '<scale value="0.5"/>', '<scale value="0.499"/>'),
        "leak", ["crystal", "z = 10"]),
    "reversed top": (
        edited("crystal_top", '<scale value="0.5"/>',
               '<rotate x="1" angle="180"/>\n      <scale value="0.5"/>'),
        "reversed_face", ["crystal_top", "turn it"]),
    "reversed entrance face": (
        edited("window_under_gap", '<scale value="0.5"/>',
               '<rotate y="1" angle="180"/>\n      <scale value="0.5"/>'),
        "reversed_face", ["window_under_gap"]),
    "face drawn twice": (
        added(shape("gap_side_front").replace("gap_side_front", "gap_side_again")),
        "overlap", ["gap_side_again", "gap_side_front"]),
    "face under the gap's bottom": (added(DISC.format("-0.0501")), "thin_gap", ["extra", "thin"]),
    "block inside the crystal": (added(BLOCK.format(0.3)), "overlap", ["crystal", "block"]),
    "block half in the crystal": (added(BLOCK.format(5.0)), "overlap", ["crystal", "block"]),
    "albedo above 1": (
        replaced(BULK, HOMOGENEOUS.format(1.2)), "coefficient", ["crystal", "albedo", "1.2"]),
    "negative absorption": (
        replaced('value="0.039"', 'value="-0.039"'), "coefficient", ["alpha_abs_per_cm", "negative"]),
    "coefficient per metre": (replaced('value="0.54"', 'value="540"'), "unit", ["1/m", "5.4"]),
    "gap too thin": (replaced('value="0.05"', 'value="0.002"'), "thin_gap", ["0.002", "0.003"]),
    "gap in metres": (replaced('value="0.05"', 'value="0.00005"'), "unit", ["gap_mm", "metres"]),
    "gap in micrometres": (replaced('value="0.05"', 'value="50"'), "unit", ["gap_mm", "0.05"]),
    "crystal in metres": (
        replaced('"crystal_width_mm" value="10"', '"crystal_width_mm" value="0.01"'),
        "unit", ["crystal_width_mm", "metres"]),
    "everything in metres, names without a unit": (
        BENCH.replace("_mm", "").replace('value="10"', 'value="0.01"').replace(
            'value="0.05"', 'value="0.00005"').replace('value="28"', 'value="0.028"').replace(
            'value="1"', 'value="0.001"').replace('value="14"', 'value="0.014"'),
        "unit", ["crystal", "metres", "10 x 10 x 10"]),
    "face without area": (
        edited("crystal_top", '<scale value="0.5"/>', '<scale value="0"/>'),
        "file", ["crystal_top", "no area"]),
    "duplicate id": (
        replaced('id="crystal_top"', 'id="crystal_bottom"'), "file", ["duplicate", "crystal_bottom"]),
    "prefix of a declared name": (
        edited("gap_side_left", "$gap_mm", "$gap_mm2"), "file", ["$gap_mm2", "gap_mm"]),
    "undeclared name": (edited("detector", "$gap_mm", "$gap"), "file", ["gap"]),
    "detector behind a wall": (
        edited("window_under_gap", '<ref id="masked_window_to_gap"/>', '<ref id="wall"/>').replace(
            shape("window_beside_gap"), shape("window_beside_gap").replace(
                "masked_window_to_air", "wall")).replace(
            '<bsdf type="dielectric" id="gap_to_air">',
            '<bsdf type="twosided" id="wall"><bsdf type="diffuse">'
            '<spectrum name="reflectance" value="0"/></bsdf></bsdf>\n'
            '  <bsdf type="dielectric" id="gap_to_air">').replace(
            # the masks are no longer used
            BENCH[BENCH.index('  <bsdf type="aperture" id="masked_window_to_gap">'):
                  BENCH.index("  <!-- ============================= Crystal")], "").replace(
            '  <!-- Radius of the round hole in the black mask on the window\'s entrance face, mm -->\n'
            '  <default name="aperture_radius_mm" value="14"/>\n', ""),
        "detector", ["detector", "no light"]),
    "axis of a rotation that is not a unit vector": (
        edited("crystal_side_right", '<rotate y="1" angle="90"/>', '<rotate y="2" angle="90"/>'),
        "value", ["rotate", "length 2", 'y="1"']),
    "axis of a rotation that is no number": (
        edited("crystal_side_right", '<rotate y="1" angle="90"/>', '<rotate y="up" angle="90"/>'),
        "file", ["axis", "'up'", "number"]),
    "medium with a reserved name": (
        BENCH.replace('id="window"', 'id="outside"'), "file", ["outside", "id"]),
    "medium without a name": (
        edited("gap_side_left", '<ref name="interior" id="gap"/>',
               '<medium name="interior" type="bulk"/>'),
        "file", ["gap_side_left", "id"]),
    "aperture on a vertical face": (
        edited("window_edge_left", '<ref id="window_to_air"/>', '<ref id="masked_window_to_air"/>'),
        "file", ["window_edge_left", "horizontal"]),
    "aperture in an aperture": (
        replaced('    <bsdf type="dielectric">\n      <float name="int_ior" value="$n_window"/>\n'
                 '      <float name="ext_ior" value="$n_gap"/>\n    </bsdf>',
                 '    <bsdf type="aperture"><float name="radius" value="7"/><bsdf type="dielectric">'
                 '<float name="int_ior" value="$n_window"/>'
                 '<float name="ext_ior" value="$n_gap"/></bsdf></bsdf>'),
        "file", ["aperture", "narrower"]),
    "detector with another side": (
        replaced('<bsdf type="photodetector"/>', '<bsdf type="twosided"><bsdf type="photodetector"/>'
                 '<bsdf type="diffuse"/></bsdf>'),
        "file", ["detector", "alone"]),
    "coloured reflector": (
        added('<shape type="rectangle" id="card"><transform name="to_world"><translate z="15"/>'
              '</transform><bsdf type="diffuse"><rgb name="reflectance" value="0.9 0.1 0.1"/></bsdf>'
              '</shape>'),
        "file", ["card", "monochromatic"]),
    "reflector with its black back to the crystal": (
        edited("crystal_top", '<ref id="crystal_to_air"/>',
               '<bsdf type="diffuse"><spectrum name="reflectance" value="0.9"/></bsdf>'),
        "file", ["crystal_top", "twosided"]),
    "mirror with its black back to the crystal": (
        edited("crystal_top", '<ref id="crystal_to_air"/>', '<bsdf type="conductor"/>'),
        "file", ["crystal_top", "twosided"]),
    "thin glass as an interface": (
        replaced('<bsdf type="dielectric" id="crystal_to_air">',
                 '<bsdf type="thindielectric" id="crystal_to_air">'),
        "file", ["thindielectric", "refract"]),
    "shape without an id": (
        replaced('<shape type="rectangle" id="crystal_top">', '<shape type="rectangle">'),
        "surface", ["no id"]),
    "crystal wider than its window": (
        replaced('"crystal_width_mm" value="10"', '"crystal_width_mm" value="30"'),
        "value", ["crystal_width_mm", "window_width_mm"]),
    "shape without a surface": (
        edited("crystal_top", '    <ref id="crystal_to_air"/>\n', ""), "surface", ["crystal_top"]),
    "decimal comma": (replaced('value="2.01"', 'value="2,01"'), "file", ["n_crystal", "2.01"]),
    "misspelt property": (
        replaced('name="alpha_scat_per_cm" value="$', 'name="alpha_scatt_per_cm" value="$'),
        "file", ["alpha_scatt_per_cm"]),
    "emitter in a medium without faces": (
        replaced('<emitter type="scintillation">\n    <ref id="crystal"/>',
                 '<medium type="bulk" id="other"/><emitter type="scintillation">\n    <ref id="other"/>'),
        "file", ["no face borders the medium 'other'"]),
    "unknown plugin": (replaced('type="photodetector"', 'type="photodetecter"'), "file", ["photodetecter"]),
}  # fmt: skip


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


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.xml")), ids=lambda p: p.stem)
def test_shipped_scenes_are_sound(path):
    report = check_scene(path)
    assert report.ok, report.problems


@pytest.mark.parametrize(
    "overrides",
    [
        {"gap_mm": 0.02}, {"gap_mm": 2, "n_gap": 1.8},
        {"crystal_width_mm": 5, "crystal_height_mm": 20},
        {"aperture_radius_mm": 3, "alpha_scat_per_cm": 20},
        {"alpha_scat_per_cm": 0, "alpha_abs_per_cm": 0},
    ],
    ids=str,
)  # fmt: skip
def test_sound_variations_are_not_refused(overrides):
    report = check_scene(SCENES / "camoo4.xml", overrides)
    assert report.ok, report.problems


def test_curved_scenes_are_checked_too(tmp_path):
    report = check_scene(BALL)
    assert report.ok, report.problems
    assert any("ray_intersect" in sentence for sentence in report.words)
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


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"alpha_abs_per_cm": -1}, "negative"),
        ({"n_gap": 0.3}, "refractive index"),
        ({"gap_mm": 50}, "micrometres"),
        ({"gap_mm": 0.001}, "too thin"),
    ],
)
def test_the_python_api_refuses_what_the_command_line_refuses(overrides, words):
    from mcrim_mitsuba.transport.simulation import Simulation

    assert words in refusal(Simulation, SCENES / "camoo4.xml", overrides)


def test_a_table_checks_the_scene_at_each_coupling(tmp_path):
    """With air in the gap the mistake makes no difference; with gel it takes 40 % of eta."""
    from mcrim_mitsuba.efficiency.table import eta_table

    path = tmp_path / "gel.xml"
    start = BENCH.index('<bsdf type="dielectric" id="crystal_to_gap">')
    path.write_text(BENCH[:start] + BENCH[start:].replace('value="$n_gap"', 'value="1.0"', 1))
    refused = refusal(eta_table, path, {"n_gap": [1.0, 1.46]}, run=Run(10_000))
    assert "crystal_bottom gives the gap the index 1" in refused
