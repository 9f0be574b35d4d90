"""A disk that is full: one line says so, and what was finished is there when there is room."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from refusals import refusal
from trials.executor import Trial, TrialExecutor, Trials

from mcrim_mitsuba.app.exchange import with_readings
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output.photograph import begin_photograph
from mcrim_mitsuba.scene.scene_file import read_scene

#: Room for one of the units below, which leave 30 kB each, but not for two.
ONE_UNIT, ROOM = "64k", "4m"


def mount(*words):
    return subprocess.run(["mount", *words], capture_output=True, text=True, check=False)


@pytest.fixture
def disk(tmp_path):
    """A small file system, and what gives it another size."""
    if os.name != "posix" or os.geteuid() != 0:
        pytest.skip("only root may mount a small file system")
    folder = tmp_path / "disk"
    folder.mkdir()
    made = mount("-t", "tmpfs", "-o", f"size={ONE_UNIT}", "tmpfs", str(folder))
    if made.returncode:
        pytest.skip(f"no file system can be mounted here: {made.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder):
    with (folder / "filling").open("wb", buffering=0) as stream, pytest.raises(OSError, match="No"):
        while True:
            stream.write(bytes(4096))


def test_units_survive_a_full_disk(scenes, disk, tmp_path, monkeypatch, capsys):
    result = disk / "table.json"
    line = [
        "table",
        str(scenes / "camoo4.xml"),
        *"--alpha-scat 0.1,0.5 --alpha-abs 0.039 --n-gap 1.0,1.3,1.46 --photons 2e5".split(),
    ]
    assert main([*line, "--json", str(tmp_path / "whole.json")]) == 0
    whole = json.loads((tmp_path / "whole.json").read_text())
    monkeypatch.setenv("MCRIM_CACHE", str(disk / "cache"))
    capsys.readouterr()
    # the cache is full after one unit; the result is there all the same
    assert main([*line, "--json", str(result), "--log", str(disk / "log")]) == 0
    said = capsys.readouterr().out
    assert said.count("No space left on device") == 1
    assert f"note: {disk}/cache: photon records cannot be kept" in said
    assert json.loads(result.read_text())["rows"] == whole["rows"]
    (unit,) = disk.rglob("*.chunk")
    made = unit.stat().st_mtime_ns
    # no room for the result either: that before stays
    fill(disk)
    before = result.read_bytes()
    assert main([*line, "--json", str(result)]) == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1 and errors.startswith(f"mcrim: {result}: cannot be written (No")
    assert result.read_bytes() == before
    (disk / "filling").unlink()
    assert not mount("-o", f"remount,size={ROOM}", str(disk)).returncode
    assert main([*line, "--json", str(result)]) == 0
    found = json.loads(result.read_text())
    assert found["rows"] == whole["rows"]
    assert 0 < found["cached_photons"] == whole["photons"] // 3
    assert unit.stat().st_mtime_ns == made and len(list(disk.rglob("*.chunk"))) == 3
    assert not [file for file in disk.rglob("*") if "unfinished" in file.name]


def test_trials_survive_a_full_disk(disk):
    def trials():
        wanted = [Trial("number", n) for n in range(5)]
        return Trials("test", {}, wanted, [], TrialExecutor(folder=disk / "units"))

    def full(trial, result):
        if trial.number == 1:
            fill(disk)

    with pytest.raises(InputError, match="No space left on device") as refused:
        first = trials()
        first.do(number, {trial: (trial.number,) for trial in first.missing}, found=full)
    assert "free some space" in str(refused.value)
    (disk / "filling").unlink()
    assert [trial.number for trial in trials().missing] == [2, 3, 4]


def number(n):
    return n


TABLE = "table {bench} --alpha-scat 0.5 --alpha-abs 0.039 --n-gap 1 --photons 2e4".split()


@pytest.mark.parametrize(
    "line",
    [
        [*TABLE, "-o", "{disk}/table.nc"],
        ["simulate", "{bench}", "--photons", "2e4", "--figure", "{disk}/light.png"],
        ["check", "{bench}", "-o", "{disk}/bench.png"],
        ["scenes", "-o", "{disk}/scenes"],
    ],
    ids=lambda line: line[0],
)
def test_every_output_says_that_there_is_no_space(scenes, disk, capsys, line):
    fill(disk)
    assert main([word.format(bench=scenes / "camoo4.xml", disk=disk) for word in line]) == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1 and f"mcrim: {disk}" in errors
    assert "cannot be written (No space left on device); free some space" in errors


def test_no_more_folders_is_no_space(disk, mcrim):
    assert not mount("-o", "remount,nr_inodes=1", str(disk)).returncode
    refused = mcrim.refused("scenes", "-o", disk / "scenes")
    assert "the folder cannot be made (No space left on device); free some space" in refused


def test_a_part_of_an_array_job_is_told_of_its_own_folder(scenes, disk, capsys):
    units = disk / "units"
    line = [word.format(bench=scenes / "camoo4.xml") for word in TABLE[:-3]]
    line += ["1.0,1.2,1.3,1.46", "--photons", "2e5", "--unit", "1/1", "--units", str(units)]
    assert main(line) == 2
    errors = capsys.readouterr().err
    assert errors == (
        f"mcrim: {units}: photon records cannot be kept (No space left on device): a unit would "
        "be lost; free or unlock this place, and run this part again\n"
    )


def test_a_full_temporary_folder_is_named(scenes, disk, monkeypatch):
    fill(disk)
    monkeypatch.setattr(tempfile, "tempdir", str(disk))
    with pytest.raises(OSError, match=f"No space left on device: '{disk}'"):
        begin_photograph(read_scene(scenes / "camoo4.xml"), Run(), 0.1)
    campaign = read_campaign(scenes / "camoo4_campaign.toml")
    line = refusal(with_readings, campaign, "mine.csv", b"label,signal,sigma\n", disk)
    assert "cannot be written (No space left on device); free some space" in line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("further", [[], ["--json", "-"]])
def test_standard_output_on_a_full_disk(further):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, *"-m mcrim_mitsuba lab index CaMoO4 --nm 540".split(), *further],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == (
        "mcrim: what standard output goes to: cannot be written (No space left on device); "
        "free some space and run it again\n"
    )
