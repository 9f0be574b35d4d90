"""Habits that keep the code readable, counted: what is above a limit today may not grow.

`python tests/project/test_habits.py` shows the figures, and where they come from.
"""

import ast
import collections
import functools
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "mcrim_mitsuba"

#: Local names and parameters that say nothing of what a thing is.
BANNED = {"found", "one", "each", "own", "made", "said", "known", "told"}
MOST_BANNED = 210
#: Lines that a function should have, and those that it must not exceed.
LONG = 60
TOO_LONG = 80
MOST_LONG = 15
MOST_TOO_LONG = 0
#: The transport's step is one page in titled sections.
MAY_BE_LONG = {"transport/loop.py:step"}
#: Constants of modules that stand in one statement with others: ``A, B = 1, 2``.
MOST_PACKED = 46
#: Fields that a class may take by position, and classes that take more.
BY_POSITION = 4
MOST_BY_POSITION = 74
#: Lines of the tests that the formatter leaves alone.
MOST_SKIPPED_IN_TESTS = 10

#: What its room's tests need not name: a type for checkers.
UNTESTED = {"core/run.py:Progress"}

Functions = ast.FunctionDef | ast.AsyncFunctionDef


@functools.cache
def modules() -> tuple[tuple[str, ast.Module], ...]:
    """The package's modules: path below the package, and syntax tree."""
    return tuple(
        (path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text()))
        for path in sorted(PACKAGE.rglob("*.py"))
    )


def banned_names() -> collections.Counter[str]:
    """How often locals and parameters have banned names, by room."""
    count: collections.Counter[str] = collections.Counter()
    for path, tree in modules():
        for node in ast.walk(tree):
            stored = isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
            name = node.arg if isinstance(node, ast.arg) else node.id if stored else None
            count[path.split("/")[0]] += name in BANNED
    return count


def long_functions(lines: int) -> dict[str, int]:
    """Functions with more lines than that, docstrings included, the longest first."""
    sizes = {
        f"{path}:{node.name}": node.end_lineno - node.lineno + 1
        for path, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, Functions)
    }
    longest = sorted(sizes.items(), key=lambda item: -item[1])
    return {name: size for name, size in longest if size > lines and name not in MAY_BE_LONG}


def packed_constants() -> collections.Counter[str]:
    """How many constants stand in one statement with others, by module."""
    count: collections.Counter[str] = collections.Counter()
    for path, tree in modules():
        for node in tree.body:
            for target in node.targets if isinstance(node, ast.Assign) else ():
                count[path] += len(target.elts) if isinstance(target, ast.Tuple) else 0
    return count


def taken_by_position() -> list[str]:
    """Dataclasses that take more fields by position than they should."""
    classes = []
    for path, tree in modules():
        for node in ast.walk(tree):
            decorators = map(ast.unparse, getattr(node, "decorator_list", ()))
            if isinstance(node, ast.ClassDef) and (
                how := [d for d in decorators if "dataclass" in d]
            ):
                kinds = [
                    ast.unparse(n.annotation) for n in node.body if isinstance(n, ast.AnnAssign)
                ]
                fields = kinds.index("KW_ONLY") if "KW_ONLY" in kinds else len(kinds)
                if fields > BY_POSITION and "kw_only" not in how[0]:
                    classes.append(f"{path}:{node.name}")
    return classes


def skipped_lines(folder: Path) -> list[str]:
    """Places that ask the formatter to leave them alone."""
    mark = re.compile(r"#\s*fmt:\s*" + "(skip|off)")
    return [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sorted(folder.rglob("*.py"))
        for number, line in enumerate(path.read_text().splitlines(), start=1)
        if mark.search(line)
    ]


def test_local_names_say_what_a_thing_is():
    count = banned_names()
    assert count.total() <= MOST_BANNED, count.most_common()


@pytest.mark.parametrize(("lines", "most"), [(LONG, MOST_LONG), (TOO_LONG, MOST_TOO_LONG)])
def test_functions_are_short(lines, most):
    longer = long_functions(lines)
    assert len(longer) <= most, longer


def test_every_constant_has_a_line():
    count = packed_constants()
    assert count.total() <= MOST_PACKED, count.most_common()


def test_few_fields_are_taken_by_position():
    classes = taken_by_position()
    assert len(classes) <= MOST_BY_POSITION, classes


def test_the_formatter_lays_out_everything():
    assert skipped_lines(PACKAGE) == []
    assert len(skipped_lines(ROOT / "tests")) <= MOST_SKIPPED_IN_TESTS


@pytest.mark.parametrize("room", ["core", "scene"])
def test_every_public_name_of_the_ground_rooms_is_tested_in_its_room(room):
    tests = "\n".join(path.read_text() for path in (ROOT / "tests" / room).glob("*.py"))
    untested = []
    for path, tree in modules():
        definitions = [n for n in tree.body if isinstance(n, (*Functions.__args__, ast.ClassDef))]
        methods = [
            node
            for owner in definitions
            for node in (owner.body if isinstance(owner, ast.ClassDef) else ())
            if owner.name[0] != "_" and isinstance(node, Functions)
        ]
        for node in (*definitions, *methods) if path.startswith(f"{room}/") else ():
            if node.name[0] != "_" and not re.search(rf"\b{node.name}\b", tests):
                untested.append(f"{path}:{node.name}")
    assert [name for name in untested if name not in UNTESTED] == []


if __name__ == "__main__":
    names = banned_names()
    print(f"{names.total()} banned names:", dict(names.most_common()))
    for name, size in long_functions(LONG).items():
        print(f"{size:4d} {name}")
    print("packed constants:", dict(packed_constants().most_common(20)))
    print("taken by position:", *taken_by_position())
    print(*skipped_lines(ROOT), sep="\n")
    sys.exit()
