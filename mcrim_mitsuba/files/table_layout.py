"""Where in a file of text the table of numbers is, and what around it is surely no part of it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.table_cells import (
    SEPARATE,
    is_number,
    is_spoilt,
    shown,
    split,
    what_is_wrong,
    without_empty_end,
)

_COMMENT = re.compile(r"\s*(#(?!n/?a\b|nv\b|div/|value!|num!|ref!|wert!|zahl!)|//|!|%(?=[\s%]|$))",
                      re.IGNORECASE)  # fmt: skip
#: Lines that a cell in quotes may run over, such as a name in two lines.
_MOST_JOINED = 4
_MOST_SHOWN = 40
EXPORT = "export the table with semicolons between columns, or with decimal points"
BLANK, COMMENTED, TEXT, SPOILT, ROW = range(5)


def is_comment(text: str) -> bool:
    """Whether a line begins with a comment sign."""
    return _COMMENT.match(text) is not None


def bare(text: str) -> str:
    """A line without its comment sign."""
    found = _COMMENT.match(text)
    return (text[found.end() :].lstrip("#/!%") if found else text).strip()


class Line(NamedTuple):
    """One line of the file; `width` counts the empty cells at its end too."""

    number: int
    kind: int
    text: str
    cells: list[str]
    width: int


class Columns(NamedTuple):
    """The columns of a table, for messages.

    `names` is None where the file has none; `roles` are what the caller wants in them.
    """

    path: Path
    number: int
    names: Sequence[str] | None
    roles: Sequence[str]

    def label(self, column: int) -> str | int:
        """A column's name, else its role, else its number from 1."""
        if self.names is not None and column < len(self.names) and self.names[column]:
            return self.names[column][:_MOST_SHOWN]
        return self.roles[column] if column < len(self.roles) else column + 1


def whole_lines(texts: list[str]) -> Iterator[tuple[int, str]]:
    """Numbered lines; those that a cell in quotes runs over are one."""
    skip = 0
    for i, text in enumerate(texts):
        if skip:
            skip -= 1
            continue
        if text.count('"') % 2 and not is_comment(text):
            for more in range(1, min(_MOST_JOINED, len(texts) - i - 1) + 1):
                if texts[i + more].count('"') % 2:
                    text, skip = " ".join(texts[i : i + more + 1]), more
                    break
        yield i + 1, text


def line_of(number: int, text: str, separator: str) -> Line:
    """A line with its cells and kind."""
    # a list of a million events must be read in seconds
    if separator not in text and is_number(text):
        return Line(number, ROW, text, [text], 1)
    if not text.strip():
        return Line(number, BLANK, text, [], 0)
    if is_comment(text):
        return Line(number, COMMENTED, text, [], 0)
    every = split(text, separator)
    cells = without_empty_end(every)
    if not cells:
        kind = BLANK
    elif all(map(is_number, cells)):
        kind = ROW
    elif is_spoilt(cells[0]) or is_number(cells[0]):
        kind = SPOILT
    else:
        kind = TEXT
    return Line(number, kind, text, cells, len(every))


def longest_run(lines: Sequence[Line], path: Path, roles: Sequence[str]) -> tuple[int, int]:
    """Where the table begins and ends: most rows with the same number of cells, uninterrupted.

    Of two runs as long, the one whose number of cells more rows of the file have.

    Raises
    ------
    InputError
        If no line is a row of numbers.
    """
    rows = Counter(len(line.cells) for line in lines if line.kind == ROW)
    best, start, end, columns, count = (0, 0, 0, 0), 0, 0, 0, 0
    for i, line in enumerate(lines):
        if line.kind == ROW:
            if len(line.cells) != columns:
                start, columns, count = i, len(line.cells), 0
            count, end = count + 1, i + 1
            if (count, rows[columns]) > best[:2]:
                best = (count, rows[columns], start, end)
        elif line.kind in (TEXT, SPOILT):
            columns = 0
    if best[0]:
        return best[2:]
    for line in lines:
        if line.kind == SPOILT:
            raise _spoilt(line, Columns(path, len(line.cells), None, roles))
    raise InputError(
        "no row of numbers", f"write a table: one row a line, numbers only; {SEPARATE}", path=path
    )


def check_above(lines: Sequence[Line], columns: Columns) -> None:
    """Whether what precedes the table is surely no part of it.

    Single numbers are none above a line of text or a comment, as in headers of spectrometers.

    Raises
    ------
    InputError
        If it may be one.
    """
    between = None
    for line in reversed(lines):
        _check(line, between, columns)
        if line.kind == TEXT or (line.kind == COMMENTED and between is None):
            between = line


def check_below(lines: Sequence[Line], columns: Columns) -> None:
    """Whether what follows the table is surely no part of it; see `check_above`."""
    between, apart = None, False
    for line in lines:
        _check(line, between, columns)
        if line.kind == BLANK:
            apart = True
        elif line.kind == TEXT:
            if between is None and not apart and _is_mixed(line, columns):
                raise _spoilt(line, columns)
            between = between or line


def _check(line: Line, between: Line | None, columns: Columns) -> None:
    """Refuse a line beside the table that may belong to it; `between` is text on the way there."""
    cells = len(line.cells)
    if line.kind == SPOILT and (between is None or cells == columns.number):
        raise _spoilt(line, columns)
    if line.kind != ROW:
        return
    if between is not None and cells == columns.number:
        raise _interrupted(between, columns)
    if between is None or cells > 1:
        raise _ragged(line, columns)


def _is_mixed(line: Line, columns: Columns) -> bool:
    """Whether a line looks like a row with cells that are no numbers."""
    return len(line.cells) == columns.number and any(map(is_number, line.cells))


def _ragged(line: Line, columns: Columns) -> InputError:
    cells, wanted = len(line.cells), columns.number
    if cells < wanted <= line.width:
        return _spoilt(line, columns)
    mend = f"give every row {wanted} {'number' if wanted == 1 else 'numbers'}"
    if "," in line.text and "." not in line.text:
        mend += "; if commas are decimal signs, " + EXPORT
    return InputError(
        f"{cells} {'cell' if cells == 1 else 'cells'}, not {wanted}", mend,
        path=columns.path, line=line.number,
    )  # fmt: skip


def _interrupted(line: Line, columns: Columns) -> InputError:
    if line.kind == TEXT and _is_mixed(line, columns):
        return _spoilt(line, columns)
    return InputError(
        f"text between rows of numbers: {shown(line.text)}",
        "give each table a file of its own, or begin the line with #",
        path=columns.path, line=line.number,
    )  # fmt: skip


def _spoilt(line: Line, columns: Columns) -> InputError:
    """Of the first cell that is no number."""
    cells = line.cells + [""] * (columns.number - len(line.cells))
    column = next(i for i, cell in enumerate(cells) if not is_number(cell))
    return InputError(
        *what_is_wrong(cells[column]), path=columns.path, line=line.number,
        column=columns.label(column),
    )  # fmt: skip
