"""What a unit is made by is in its key: all that it imports, and nothing else."""

import ast
import functools
import io
import os
import random
import shutil
import subprocess
import sys
import tokenize
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects import crystal, crystal_faces, detector, gap, readings, surroundings
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, modules_of
from mcrim_mitsuba.efficiency.eta_grid import TableUnit
from mcrim_mitsuba.efficiency.eta_surface import GridBlock
from mcrim_mitsuba.efficiency.simulate import TallyBlock
from mcrim_mitsuba.runs import cache
from mcrim_mitsuba.runs.cache import code_hash, record_versions

PACKAGE = Path(cache.__file__).parents[1]
UNITS = [kind.__module__ for kind in (TallyBlock, GridBlock, TableUnit)]
#: Each decides what some unit makes, and is no near neighbour of it.
DECIDING = (
    "scene.check_text transport.plugins.bsdfs transport.surface_physics optics.thin_film "
    "efficiency.proposals efficiency.surface"
).split()


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The package under another name, which may be changed."""
    folder = tmp_path_factory.mktemp("package")
    shutil.copytree(
        PACKAGE, folder / "mcrim_copy", ignore=shutil.ignore_patterns("__pycache__", "*.css")
    )
    for file in (folder / "mcrim_copy").rglob("*.py"):
        file.write_text(file.read_text().replace("mcrim_mitsuba", "mcrim_copy"))
    sys.path.insert(0, str(folder))
    yield folder / "mcrim_copy"
    sys.path.remove(str(folder))


READ = cache._code_and_imports.__wrapped__


@functools.cache
def read(file: Path, package: str, *_contents: bytes) -> tuple[str, set[str]]:
    return READ(file, package, b"")


def read_as_it_is(file: Path, package: str, _content: bytes) -> tuple[str, set[str]]:
    """What counts of a module as it and its table are now: most of them are as they were."""
    there = (each for each in (file, file.with_suffix(".toml")) if each.is_file())
    return read(file, package, *(each.read_bytes() for each in there))


def keys() -> dict[str, str]:
    for kept in (cache._closure, cache._files):
        kept.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "_code_and_imports", read_as_it_is)
        return {unit: code_hash([unit.replace("mcrim_mitsuba", "mcrim_copy")]) for unit in UNITS}


def statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All of a module but those for type checkers only, without going through expressions."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            todo += getattr(node, part, ())


def imported(package: Path, start: str) -> set[Path]:
    """Files that a module needs, by Python's own parser."""
    files, todo = set(), {start.replace(PACKAGE.name, package.name)}
    while todo:
        steps = todo.pop().split(".")
        for end in range(1, len(steps) + 1):
            place = package.parent.joinpath(*steps[:end])
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            if file in files or not file.is_file():
                continue
            files.add(file)
            for node in statements(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    todo |= {name.name for name in node.names}
                elif isinstance(node, ast.ImportFrom):
                    todo |= {f"{node.module}.{name.name}" for name in node.names}
    return files


def constants(file: Path) -> list[ast.Constant]:
    """Numbers of a module, those within formatted strings left out."""
    found, todo = [], deque([ast.parse(file.read_text())])
    while todo:
        node = todo.popleft()
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            found.append(node)
        elif not isinstance(node, ast.JoinedStr):
            todo.extend(ast.iter_child_nodes(node))
    return found


def changed(file: Path, draw: random.Random) -> str:
    """A module's text with one number changed."""
    number = draw.choice(constants(file))
    lines = file.read_bytes().splitlines(keepends=True)
    line, value = lines[number.lineno - 1], repr(number.value + 1).encode()
    lines[number.lineno - 1] = line[: number.col_offset] + value + line[number.end_col_offset :]
    return b"".join(lines).decode()


def test_a_changed_number_makes_those_units_anew_that_import_its_module(copy):
    draw = random.Random(37)
    modules = [file for file in sorted(copy.rglob("*.py")) if constants(file)]
    drawn = draw.sample(modules, int(os.environ.get("MCRIM_MODULES", 20)))
    drawn += [copy.joinpath(*name.split(".")).with_suffix(".py") for name in DECIDING]
    needed = {unit: imported(copy, unit) for unit in UNITS}
    before, hits = keys(), 0
    for file in drawn:
        text = file.read_text()
        try:
            file.write_text(changed(file, draw))
            after = keys()
        finally:
            file.write_text(text)
        anew = {unit for unit in UNITS if after[unit] != before[unit]}
        assert anew == {unit for unit in UNITS if file in needed[unit]}, file
        hits += bool(anew)
    assert 0 < hits < len(drawn)
    table = copy / "optics" / "materials.toml"
    table.write_text(table.read_text() + "\n# read\n")
    assert all(key != before[unit] for unit, key in keys().items())


def test_comments_docstrings_and_empty_lines_make_nothing_anew(copy):
    before = keys()
    for file in copy.rglob("*.py"):
        file.write_text(commented(file.read_text()))
    assert keys() == before


def commented(code: str) -> str:
    """The same code with other docstrings, comments and empty lines, by Python's own parser."""
    lines = code.split("\n")
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    for node in statements(ast.parse(code)):
        if isinstance(node, kinds) and ast.get_docstring(node) is not None:
            text = node.body[0]
            lines[text.lineno - 1] = lines[text.lineno - 1].replace('"""', '"""Otherwise: ', 1)
    tokens = list(tokenize.generate_tokens(io.StringIO("\n".join(lines)).readline))
    ends = [token.start for token in tokens if token.type == tokenize.NEWLINE]
    comments = [token for token in tokens if token.type == tokenize.COMMENT]
    for row in {row for row, _ in ends} - {comment.start[0] for comment in comments}:
        lines[row - 1] += '  # \'a remark\n\n# """ another'
    return "\n".join(lines)


def test_units_need_nothing_above_them():
    """What shows and judges results makes no unit anew."""
    below = {"__init__.py", "core", "optics", "scene", "transport", "runs", "efficiency"}
    for unit in UNITS:
        rooms = {file.relative_to(PACKAGE).parts[0] for file in imported(PACKAGE, unit)}
        assert rooms == (below if unit == TallyBlock.__module__ else below | {"effects"})


def test_libraries_that_numbers_come_from_are_in_the_key():
    versions = record_versions("llvm_ad_rgb", GridBlock.__module__)
    assert {"drjit", "mitsuba", "numpy", "scipy", "llvm"} <= set(versions)
    assert not {"matplotlib", "iminuit"} & set(versions)


OWN = """from mcrim_mitsuba.effects import Effect
from mcrim_mitsuba.optics.fresnel import reflectance
def weight(columns, values, parameters):
    return columns["k"] * SIZE
EFFECT = Effect("dark_spot", "a dark spot", "A spot.", "nowhere", columns=("k",), weight=weight)
"""


def test_effects_count_by_what_they_are_now_and_import(tmp_path):
    hashes = []
    for place in ("here", "there"):
        (tmp_path / place).mkdir()
        for size in (1, 2):
            (tmp_path / place / "spot.py").write_text(OWN.replace("SIZE", f"{size}  # of {place}"))
            effect = catalogue(tmp_path / place)["dark_spot"]
            hashes.append(code_hash(modules_of([effect])))
    # changed while this process goes on; of one name and content in two folders
    assert hashes[0] != hashes[1] and hashes[:2] == hashes[2:]
    # a worker, which gets the file itself, must have what it imports
    named = record_versions("llvm_ad_rgb", TableUnit.__module__, *modules_of([effect]))["modules"]
    assert "mcrim_mitsuba.optics.fresnel.reflectance" in named and "spot" not in named
    (tmp_path / "there" / "spot.py").unlink()
    with pytest.raises(InputError, match=r"spot\.py"):
        code_hash(modules_of([effect]))
    parts = (crystal, crystal_faces, detector, gap, readings, surroundings)
    homes = {
        value: part.__name__
        for part in parts
        for value in vars(part).values()
        if isinstance(value, Effect)
    }
    for effect in catalogue().values():
        # what acts on one side of the crystal is written once, and what it writes is in the scene
        places = {homes[effect], "mcrim_mitsuba.effects.scene_edits"}
        assert modules_of([effect]) & places


def test_another_copy_of_the_package_mixes_into_nothing(scenes, here, mcrim):
    """A rule of the scenes that plugins follow: from which index on a gap is filled."""
    copy = here / "copy" / PACKAGE.name
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    rule = copy / "scene" / "check_text.py"
    text = rule.read_text()
    rule.write_text(text.replace("FILLED_ABOVE = 1.0005", "FILLED_ABOVE = 1.9"))
    assert rule.read_text() != text
    line = "table gap.xml --alpha-scat 0.5 --alpha-abs 0.039 --n-gap 1.46 --photons 6e4 -o T.csv"

    def table(package: Path, *arguments: str, cache: str = "cache") -> None:
        done = subprocess.run(
            [sys.executable, "-m", PACKAGE.name, *line.split(), *arguments],
            text=True,
            capture_output=True,
            env=os.environ | {"PYTHONPATH": str(package), "MCRIM_CACHE": cache},
        )
        assert done.returncode == 0, done.stderr

    size = "gap_absorption_per_cm=10"
    mcrim.shown("add", "gap_absorption", scenes / "camoo4.xml", "-o", "gap.xml", "-D", size)
    tables = []
    for made in (
        lambda: table(copy.parent),
        lambda: table(PACKAGE.parent),
        lambda: mcrim.shown(*line.split()),  # without a cache
    ):
        made()
        tables.append(Path("T.csv").read_text())
    other, cached, ours = tables
    assert cached == ours != other
    # nor what a part of an array job made
    table(copy.parent, "--unit", "1/1", "--units", "units", cache="off")
    assert "the parts were made with source hash" in mcrim.refused("merge", "units")
