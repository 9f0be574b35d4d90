"""The house: rooms import downwards only, one of them knows Mitsuba, and names stand once."""

import ast
import collections
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "mcrim_mitsuba"
MODULES = sorted(PACKAGE.rglob("*.py"))


def test_rooms_import_downwards_only():
    """By import-linter, as pyproject.toml describes the rooms; circles among modules too."""
    code = "from importlinter.cli import lint_imports_command as command; command()"
    done = subprocess.run(
        [sys.executable, "-c", code, "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout


def test_nothing_but_three_files_is_at_the_root():
    files = {path.name for path in PACKAGE.iterdir() if path.is_file()}
    assert files == {"__init__.py", "__main__.py", "py.typed"}
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert len(rooms) == 15


def test_no_class_name_stands_twice():
    homes = collections.defaultdict(list)
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in homes.items() if len(found) > 1} == {}


@pytest.mark.parametrize(
    "name", ["result", "results", "words", "utils", "helpers", "common", "misc"]
)
def test_no_module_has_a_name_that_says_nothing(name):
    assert [path for path in MODULES if path.stem == name] == []


def test_every_room_says_what_it_is_for():
    for path in PACKAGE.glob("*/__init__.py"):
        assert len((ast.get_docstring(ast.parse(path.read_text())) or "").split()) > 10, path
