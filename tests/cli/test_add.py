"""``mcrim add`` as users type it."""

import shutil

import pytest
from places import cases_of

from mcrim_mitsuba import add as added
from mcrim_mitsuba.effects.trust import UntrustedEffectsError
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


def test_effects_of_ones_own_are_executed_when_the_user_says_so(mcrim, here, scenes):
    (here / "theirs").mkdir()
    (here / "theirs/mine.py").write_text(
        "from mcrim_mitsuba.effects import Effect, EffectParameter\n"
        "from pathlib import Path\nPath('ran').touch()\n"
        "def edit(editor, values):\n    return None\n"
        'EFFECT = Effect("mine", "M", "...", "...", edit=edit)\n'
    )
    line = ["add", "mine", scenes / "camoo4.xml", "--effects-folder", "theirs", "-o", "-"]
    refused = mcrim.refused(*line)
    assert "the Python in theirs would be executed (mine.py)" in refused
    assert "--trust-effects" in refused
    with pytest.raises(UntrustedEffectsError):
        added("mine", scenes / "camoo4.xml", effects_folder="theirs")
    assert not (here / "ran").exists()
    mcrim(*line, "--trust-effects")
    assert (here / "ran").exists()
    assert "name a folder" in mcrim.refused(*line[:4], "nowhere", *line[5:])


def test_what_was_included_stands_in_the_new_scene(mcrim, tmp_path, scenes):
    new = tmp_path / "new.xml"
    out = mcrim.shown("add", "surface_absorption", scenes / "cawo4.xml", "-o", new)
    assert "note: camoo4.xml, which the scene included, is now part of it" in out
    assert read_scene(new).parameters["n_crystal"] == 1.92
    # a face is said to be written there, where that is not the scene itself
    for scene, at in ((scenes / "cawo4.xml", "camoo4.xml: 109 "), (scenes / "camoo4.xml", " 109 ")):
        line = next(x for x in mcrim.shown("check", scene).splitlines() if "crystal_top" in x)
        assert line.split("│")[-2].strip() == at.strip()
