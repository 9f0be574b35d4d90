"""TOML whose entries know their lines."""

from pathlib import Path

import pytest
from refusals import refusal

from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable, is_plain_number, read_toml

TEXT = """# a campaign
scene = "bench.xml"
[parameters.n_gap]
start = 1.5
"fixed" = true
[parameters.gap_mm]
start = { value = 3 }
"""


@pytest.fixture
def document(here) -> TomlDocument:
    Path("campaign.toml").write_text(TEXT)
    return read_toml(Path("campaign.toml"))


def test_entries_know_their_lines(document):
    assert document.lines["scene"] == 2 and document.lines["parameters"] == 3
    assert document.lines["parameters.n_gap.fixed"] == 5
    # of what is not there, or within an inline table: the line of what holds it
    for key, line in (("parameters.gap_mm.start.value", 7), ("parameters.n_gap.no", 3)):
        assert str(document.refusal(key, "p", "m")) == f"campaign.toml, line {line}: p; m"
    assert str(document.refusal("no", "p", "m")) == "campaign.toml: p; m"


def test_tables_and_what_they_may_hold(document):
    table = document.table("parameters.n_gap", ("start", "fixed"))
    assert isinstance(table, TomlTable) and dict(table) == {"start": 1.5, "fixed": True}
    assert document.table("nothing.here") == {}
    assert refusal(document.table, "scene") == (
        "campaign.toml, line 2: scene is not a table; write [scene]"
    )
    assert refusal(document.table, "parameters.n_gap", ("start", "fix")) == (
        "campaign.toml, line 5: [parameters.n_gap] has no entry fixed; did you mean fix? Known "
        "are: start, fix"
    )
    assert "a campaign has no entry scene" in refusal(document.table, "", ("scenes",))


def test_numbers_and_paths_of_a_table(here):
    Path("a.toml").write_text('x = 2\ny = "2"\nz = true\nu = nan\nfile = "b.csv"\nempty = ""\n')
    table = read_toml(Path("a.toml"), "a list").table("")
    assert table.number("x") == 2.0 and table.number("no") is None
    assert table.known_number("x") == 2.0
    assert is_plain_number(table["x"]) and not is_plain_number(True)
    for name, says in (
        ("y", 'line 2: y = "2" is text; write a number without quotes'),
        ("z", "line 3: z is not a number"),
        ("u", "line 4: u = 'nan' is not a finite number"),
    ):
        assert says in refusal(table.number, name)
    assert table.path_of("file", table["file"]) == Path("b.csv")
    for name in ("empty", "x"):
        assert f"{name} is not a path" in refusal(table.path_of, name, table[name])
    assert str(table.refusal("", "p", "m")) == "a.toml: p; m"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = 5 mm", "line 1, column 7: not TOML"),
        ("a = 1\nx = 5 mm", "write 5, without a unit"),
        (
            "a = 1\nx = 95 % # of it",
            "line 2, column 8: not TOML: Expected newline or end of document "
            "after a statement; write a fraction: 0.95",
        ),
        ("x = ", 'entries are name = value, text in "quotes", decimals with a point'),
        ("x = 1" + "0" * 5000, "a whole number has thousands of digits"),
        (f"x = {2**70}", "line 1: x is a whole number of more than 64 bits"),
        (".".join("a" * 30) + " = 1", "nested more than 20 deep"),
        ("x = " + "[" * 30 + "]" * 30, "nested more than 20 deep"),
    ],
)
def test_what_is_no_toml_or_a_monster_is_refused(here, text, says):
    Path("a.toml").write_text(text)
    assert says in refusal(read_toml, Path("a.toml"))
