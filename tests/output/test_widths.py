"""What verbs show can be read in terminals of any width; what is shown, the golden tests keep."""

import io
import itertools
import json
import re
import sys
from pathlib import Path

import pytest
from click import Context

from mcrim_mitsuba.cli.main import mcrim
from mcrim_mitsuba.cli.terminal import Screen, console, photon_progress
from mcrim_mitsuba.output.description import Column, Part, Sentence, Table, table

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("*.json"))
WIDTHS = 80, 100, 140
#: Longer words, such as paths, may be cut: they would not fit into a table of two columns.
LONGEST = 60
BORDERS = "│┃"
RULES = {*"│┃├└┡"}
#: What must stay together: a word, a number with its errors, "p = 0.3".
WHOLE = re.compile(r"\S+(?: [±=<>] \S+)*")


def parts_of(lines: list[str]) -> list[Part]:
    """Tables and sentences that a command without a terminal has printed."""
    parts: list[Part] = []
    for block in re.split("(^┏(?:.*\n[┃┡│├└])+.*$)", "\n".join(lines), flags=re.M):
        if not block.startswith("┏"):
            # of a long output only some lines are kept: a table may lack its head
            parts += [
                Sentence(one) for one in block.strip("\n").split("\n") if one[:1] not in RULES
            ]
            continue
        first, *inner = block.split("\n")
        edges = [at for at, sign in enumerate(first) if sign in "┏┳┓"]
        groups: list[list[list[str]]] = [[]]
        for line in inner:
            if line[0] in BORDERS:
                cells = itertools.pairwise(edges)
                groups[-1].append([line[a + 2 : b - 1] for a, b in cells])
            else:
                groups.append([])
        heads, rows, sums = (*groups, [])[:3]
        columns = [
            Column(" ".join(one[at].strip() for one in heads), left=is_left(rows, at))
            for at in range(len(edges) - 1)
        ]
        parts.append(
            table("", columns, *([map(str.strip, one) for one in some] for some in (rows, sums)))
        )
    return parts


def is_left(rows: list[list[str]], at: int) -> bool:
    return not any(row[at].startswith(" ") and row[at].strip() for row in rows)


def words_of(part: Part) -> set[str]:
    if isinstance(part, Sentence):
        return set(WHOLE.findall(part.text))
    assert isinstance(part, Table)
    cells = [cell.text for row in (*part.rows, *part.sums) for cell in row.cells]
    return {w for c in (*cells, *(x.title for x in part.columns)) for w in WHOLE.findall(c)}


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("file", GOLDEN, ids=lambda file: file.stem)
def test_no_word_is_cut_and_no_number_parted_from_its_error(file, width):
    for run in json.loads(file.read_text())["runs"]:
        printed = run.get("stdout")
        if not isinstance(printed, list) or "--help" in run["command"] or "{" in printed:
            continue
        parts = parts_of(printed)
        stream = io.StringIO()
        screen = Screen(file=stream, force_terminal=True, color_system=None, width=width)
        screen.show(*parts)
        lines = stream.getvalue().split("\n")
        assert max(map(len, lines)) <= width
        shown = {
            word
            for line in lines
            for cell in re.split(f"[{BORDERS}]", line)
            for word in WHOLE.findall(cell)
        }
        wanted = set().union(*map(words_of, parts))
        assert {word for word in wanted - shown if len(word) <= LONGEST} == set(), run["command"]


@pytest.mark.parametrize("group", ["mcrim", "lab"])
def test_summaries_of_commands_are_whole_sentences(group):
    commands = mcrim if group == "mcrim" else mcrim.get_command(Context(mcrim), "lab")
    context = Context(commands, info_name=group, terminal_width=80)
    listing = commands.get_help(context).partition("Commands:")[2]
    names = commands.list_commands(context)
    assert len(names) == len(listing.split("\n")) - 1 > 8
    for name in names:
        summary = commands.get_command(context, name).short_help
        assert summary.endswith(".") and f"{name:10}  {summary}\n" in f"{listing}\n"


@pytest.mark.parametrize("width", WIDTHS)
def test_a_bar_cuts_no_number(width, monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm")
    note = "262 of 262 million photons, eta to 0.052 %"
    with photon_progress() as report:
        report("n_gap = 1.46, crystal_height_mm = 10, gap_bubble", 10, 10, note)
    assert " 94 %" in stream.getvalue() and "0:00:00" in stream.getvalue()


def test_a_pipe_is_as_wide_as_columns_says(monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    assert console().room == 90
    monkeypatch.delenv("COLUMNS")
    assert console().room == 200
