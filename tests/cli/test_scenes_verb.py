"""`mcrim scenes`: what the package brings along, listed and copied."""

from pathlib import Path

import pytest

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.scene.scene_file import read_scene


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_copies_are_whole_and_stand_on_their_own(scenes, tmp_path, mcrim):
    copied = tmp_path / "a new folder" / "bench"
    said = mcrim.shown("scenes", "-o", copied)
    assert said.endswith(f"Next: mcrim check '{copied / 'camoo4.xml'}'\n")
    assert contents(copied) == contents(scenes)
    for path in copied.glob("*.xml"):
        read_scene(path)
    campaigns = [*copied.glob("camoo4_*.toml"), *copied.glob("camoo4_raw/*.toml")]
    assert len(campaigns) >= 6
    for path in campaigns:
        assert read_campaign(path).scene.path.is_relative_to(copied)


def test_nothing_is_replaced_and_nothing_begun(tmp_path, mcrim):
    edited = tmp_path / "camoo4_raw" / "air_1.csv"
    edited.parent.mkdir()
    edited.write_text("mine")
    refused = mcrim.refused("scenes", "-o", tmp_path)
    assert refused == f"mcrim: {edited}: it is there already; name another folder\n"
    assert contents(tmp_path) == {"camoo4_raw/air_1.csv": b"mine"}


@pytest.mark.parametrize("below", ["file", "file/further"])
def test_a_folder_that_cannot_be_made(tmp_path, mcrim, below):
    (tmp_path / "file").touch()
    assert "the folder cannot be made" in mcrim.refused("scenes", "-o", tmp_path / below)
