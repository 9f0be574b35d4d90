"""``mcrim add`` as users type it."""

import shutil

from places import cases_of

from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)


def test_help_lists_the_catalogue(mcrim):
    out = mcrim.shown("add", "--help")
    assert "  gap_bubble              Air bubble in the gap (bubble_fraction 0..0.6)\n" in out
    assert "  background              Constant background (for campaigns only)\n" in out


@cases("effect", "scene", "new", "says")
def test_refusals_leave_no_file(mcrim, scenes, tmp_path, effect, scene, new, says):
    (tmp_path / "there.xml").write_text("mine")
    assert says in mcrim.refused("add", effect, scenes / scene, "-o", tmp_path / new)
    assert [path.name for path in tmp_path.iterdir()] == ["there.xml"]
    assert (tmp_path / "there.xml").read_text() == "mine"


def test_the_scene_itself_is_never_replaced(mcrim, tmp_path, scenes):
    scene = shutil.copy(scenes / "camoo4.xml", tmp_path / "bench.xml")
    refused = mcrim.refused("add", "gap_index", scene, "-o", scene)
    assert "would replace what this command reads" in refused


def test_what_was_included_stands_in_the_new_scene(mcrim, tmp_path, scenes):
    new = tmp_path / "new.xml"
    out = mcrim.shown("add", "surface_absorption", scenes / "cawo4.xml", "-o", new)
    assert "note: camoo4.xml, which the scene included, is now part of it" in out
    assert read_scene(new).parameters["n_crystal"] == 1.92
