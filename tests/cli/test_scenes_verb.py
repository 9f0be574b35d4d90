"""`mcrim scenes`: what the package brings along, listed and copied."""

from pathlib import Path

import pytest

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.scene.scene_file import read_scene


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_all_are_listed(scenes, capsys):
    assert main(["scenes"]) == 0
    first, *names = capsys.readouterr().out.splitlines()
    assert first == f"in {scenes}:"
    assert sorted(name.strip() for name in names) == sorted(contents(scenes))


def test_copies_are_whole_and_stand_on_their_own(scenes, tmp_path, capsys):
    copied = tmp_path / "a new folder" / "bench"
    assert main(["scenes", "-o", str(copied)]) == 0
    said = capsys.readouterr().out
    assert said.endswith(f"Next: mcrim check '{copied / 'camoo4.xml'}'\n")
    assert contents(copied) == contents(scenes)
    for path in copied.glob("*.xml"):
        read_scene(path)
    campaigns = [*copied.glob("camoo4_*.toml"), *copied.glob("camoo4_raw/*.toml")]
    assert len(campaigns) >= 6
    for path in campaigns:
        assert read_campaign(path).scene.path.is_relative_to(copied)


def test_nothing_is_replaced_and_nothing_begun(tmp_path, capsys):
    edited = tmp_path / "camoo4_raw" / "air_1.csv"
    edited.parent.mkdir()
    edited.write_text("mine")
    assert main(["scenes", "-o", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"mcrim: {edited}: it is there already; name another folder\n"
    )
    assert contents(tmp_path) == {"camoo4_raw/air_1.csv": b"mine"}


@pytest.mark.parametrize("below", ["file", "file/further"])
def test_a_folder_that_cannot_be_made(tmp_path, capsys, below):
    (tmp_path / "file").touch()
    assert main(["scenes", "-o", str(tmp_path / below)]) == 2
    err = capsys.readouterr().err
    assert "the folder cannot be made" in err and err.count("\n") == 1
