"""The wheel: everything is in it, nothing else, and it works away from the checkout."""

import os
import py_compile
import re
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from places import ROOT
from test_golden import hold, process, run_case


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    """Built from the checkout as `pip install .` does it."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "-q", "-w", folder, ROOT]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    [built] = folder.iterdir()
    with zipfile.ZipFile(built) as opened:
        yield opened


@pytest.fixture(scope="module")
def unpacked(wheel, tmp_path_factory) -> Path:
    """Where the wheel lies, and nothing of the checkout."""
    folder = tmp_path_factory.mktemp("another") / "folder with blanks, ünïcode"
    wheel.extractall(folder)
    return folder


def files_below(folder: Path) -> set[str]:
    return {
        path.relative_to(folder.parent).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def metadata(wheel, name: str) -> str:
    [found] = [entry for entry in wheel.namelist() if entry.endswith(f".dist-info/{name}")]
    return wheel.read(found).decode()


def test_package_and_scenes_are_in_it_and_nothing_else(wheel):
    packed = {name for name in wheel.namelist() if ".dist-info/" not in name}
    scenes = {f"mcrim_mitsuba/{name}" for name in files_below(ROOT / "scenes")}
    assert packed == files_below(ROOT / "mcrim_mitsuba") | scenes
    assert {"mcrim_mitsuba/scenes/camoo4.xml", "mcrim_mitsuba/app/assets/style.css"} <= packed


def test_it_says_what_it_is(wheel):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    known = Parser().parsestr(metadata(wheel, "METADATA"))
    assert (known["Name"], known["Version"]) == (project["name"], project["version"])
    assert known["Requires-Python"] == project["requires-python"]
    assert set(known.get_all("Provides-Extra")) == set(project["optional-dependencies"])
    assert known.get_all("Classifier") == project["classifiers"]
    assert "Apache License" in metadata(wheel, "licenses/LICENSE")
    assert "mcrim = mcrim_mitsuba.__main__:main" in metadata(wheel, "entry_points.txt")


def test_one_version_everywhere():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    [cited] = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    released = re.findall(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert (cited, released[0]) == (version, version)


WHERE = """
import mcrim_mitsuba
from mcrim_mitsuba.scene.shipped import copy_scenes, scene_path
copy_scenes("bench")
print(mcrim_mitsuba.__file__, mcrim_mitsuba.__version__, scene_path("camoo4.xml"), sep="\\n")
"""


def test_it_reproduces_the_article_away_from_the_checkout(wheel, unpacked, tmp_path):
    package = unpacked / "mcrim_mitsuba"
    version = Parser().parsestr(metadata(wheel, "METADATA"))["Version"]
    # before the editable install of the tests
    found = subprocess.run(
        [sys.executable, "-P", "-c", WHERE],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        env=os.environ | {"PYTHONPATH": str(unpacked)},
    )
    assert found.stdout.splitlines() == [
        str(package / "__init__.py"),
        version,
        str(package / "scenes/camoo4.xml"),
    ], found.stderr
    assert files_below(tmp_path / "bench") == {
        name.replace("scenes", "bench", 1) for name in files_below(ROOT / "scenes")
    }
    # as -O has it: no `assert` of the package is more than an assertion. Of the package alone,
    # for else all libraries would be compiled anew, and by nobody else.
    for source in package.rglob("*.py"):
        py_compile.compile(str(source), cache_from_source(source), doraise=True, optimize=1)
    with process("-P", PYTHONPATH=str(unpacked)) as answers:
        hold("paper", run_case("paper", tmp_path / "article", answers))
    assert files_below(package) <= set(wheel.namelist())  # nothing is written where it lies
