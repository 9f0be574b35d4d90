"""Reads tables of numbers as instruments and spreadsheets write them.

Only what is certain is read; everything else is refused with its line:

- UTF-8, UTF-16 with a byte order mark or Windows' code page; line ends of any kind;
- columns separated by semicolons, tabs, commas or blanks, one of them all through; the line
  ``sep=;`` of Excel; cells in quotes; separators at the ends of lines; empty lines, ``;;;`` too;
- decimal points, or decimal commas where commas separate no columns or cells are in quotes;
- lines that begin with ``#``, ``//``, ``!`` or ``%`` and a blank are comments, wherever they are;
- lines of text above the numbers and below them, as spectrometers write them. Text between rows
  is refused, and so are rows of other lengths, empty cells, ``NaN``, ``#N/A`` and the like;
- the line above the numbers, a comment perhaps, names the columns if it has as many cells; a line
  of units may stand between.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.core import table_text
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_table_text
from mcrim_mitsuba.core.numbers import LARGEST, SMALLEST
from mcrim_mitsuba.core.rounding import counted
from mcrim_mitsuba.core.table_text import BLANKS, SEPARATE, is_number, shown

_MOST_LINES = 2_000_000
_LONGEST_LINE = 100_000
_LEADING_ZERO = re.compile(r"[+-]?0\d+", re.ASCII)
_WHOLE = re.compile(r"[+-]?\d+([eE][+-]?\d+)?", re.ASCII)
#: In a line of units, these are some too.
_COUNTED = ("counts", "cts", "cps", "counts/s", "events", "photons")
_COMMENT = re.compile(
    r"\s*(#(?!n/?a\b|nv\b|div/|value!|num!|ref!|wert!|zahl!)|//|!|%(?=[\s%]|$))", re.IGNORECASE
)
#: Lines that a cell in quotes may run over, such as a name in two lines.
_MOST_JOINED = 4
_MOST_SHOWN = 40
EXPORT = "export the table with semicolons between columns, or with decimal points"
#: Kinds of lines.
BLANK = 0
COMMENTED = 1
TEXT = 2
SPOILT = 3
ROW = 4


@dataclass(frozen=True, eq=False)
class DataTable:
    """A table of finite numbers."""

    #: The file.
    path: Path
    #: Comments and lines of text without their signs, in the file's order; not the names.
    comments: tuple[str, ...]
    #: Names of the columns, without units; None where the file has none.
    names: tuple[str, ...] | None
    #: Their units, see `table_text.name_and_unit`.
    units: tuple[str | None, ...]
    _: KW_ONLY
    #: (rows, columns) float64
    values: NDArray[np.float64]
    #: (rows,) int64: Line of each row in the file, from 1.
    lines: NDArray[np.int64]
    #: What the columns hold, for messages about columns without a name.
    roles: tuple[str, ...]

    def refusal(self, row: int | None, column: int | None, problem: str, mend: str) -> InputError:
        """An error that names the file, the row's line and the column (each from 0, or None)."""
        line = None if row is None else int(self.lines[row])
        columns = _Columns(self.path, self.values.shape[1], self.names, self.roles)
        return columns.refusal(problem, mend, line, column)


def read_data_table(
    path: str | Path, *, roles: Sequence[str] = (), limit_mb: int = 10
) -> DataTable:
    """Read a table of numbers from a text of at most so many megabytes, as this module says.

    Messages name columns by their `roles`, in order, where the file does not: what they hold, such
    as ``("bin centre", "counts")``.

    Raises InputError, with file, line and column, if the table cannot be read with certainty.
    """
    path, roles = Path(path), tuple(roles)
    texts = read_table_text(path, limit_mb).split("\n")
    if len(texts) > _MOST_LINES:
        problem = f"more than {_MOST_LINES:,} lines"
        raise InputError(problem, "sort a longer list of events into bins first", path=path)
    long = next((i for i, text in enumerate(texts) if len(text) > _LONGEST_LINE), None)
    if long is not None:
        problem = f"a line of more than {_LONGEST_LINE:,} characters"
        raise InputError(problem, "write one row a line", path=path, line=long + 1)
    given = table_text.given_separator(texts[0])
    if given:
        texts[0] = ""
    numbered = list(_whole_lines(texts))
    plain = [text for _, text in numbered if text.strip() and not _is_comment(text)]
    separator = given or table_text.separator_of(plain)
    lines = [_line_of(number, text, separator) for number, text in numbered]
    first, last = _longest_run(lines, path, roles)
    rows = [line for line in lines[first:last] if line.kind == ROW]
    count = len(rows[0].cells)
    names, units, header = _names(lines[:first], separator, count, path)
    columns = _Columns(path, count, names, roles)
    _check_above(lines[:first], columns)
    _check_below(lines[last:], columns)
    if separator == ",":
        _refuse_uncertain_commas(rows, names, path)
    words = (line for line in lines if line.kind in (COMMENTED, TEXT))
    comments = tuple(_bare(line.text) for line in words if line.number not in header)
    numbers = np.array([row.number for row in rows])
    return DataTable(
        path, comments, names, units, values=_numbers(rows, columns), lines=numbers, roles=roles
    )


def _names(
    lines: Sequence[_Line], separator: str, columns: int, path: Path
) -> tuple[tuple[str, ...] | None, tuple[str | None, ...], set[int]]:
    """Names and units of the columns, and the numbers of the lines that hold them."""
    above = [line for line in reversed(lines) if line.kind in (TEXT, COMMENTED)][:2]
    rows = [table_text.names_of(_bare(line.text), separator, columns) for line in above]
    if not above or rows[0] is None:
        if above and above[0].kind == TEXT:
            cells = table_text.without_empty_end(table_text.split(above[0].text, separator))
            if any(table_text.name_and_unit(cell)[1] is not None for cell in cells):
                raise InputError(
                    f"{counted(len(cells), 'name')} above {counted(columns, 'column')}",
                    "give every column one name, "
                    + ("without blanks" if separator == BLANKS else "separated as the numbers are")
                    + ", or begin the line with #",
                    path=path,
                    line=above[0].number,
                )
        return None, (None,) * columns, set()
    alone = [table_text.unit_alone(cell) for cell in rows[0]]
    of_units = any(alone) and all(
        unit or not cell or cell.lower() in _COUNTED
        for unit, cell in zip(alone, rows[0], strict=True)
    )
    if of_units and len(rows) > 1 and rows[1] is not None:
        named = [table_text.name_and_unit(cell) for cell in rows[1]]
        pairs = zip(alone, named, strict=True)
        units = tuple(unit or unit_of_name for unit, (_, unit_of_name) in pairs)
        used = above
    else:
        named = [table_text.name_and_unit(cell) for cell in rows[0]]
        units = tuple(unit for _, unit in named)
        used = above[:1]
    header = {line.number for line in used if line.kind == TEXT}
    return tuple(name for name, _ in named), units, header


def _refuse_uncertain_commas(rows: list[_Line], names: Sequence[str] | None, path: Path) -> None:
    """Refuse commas between columns that may as well be decimal commas."""
    for row in rows:
        for cell in row.cells:
            if _LEADING_ZERO.fullmatch(cell):
                problem = f"{shown(cell)} begins with 0, as after a decimal comma"
                raise InputError(problem, EXPORT, path=path, line=row.number)
    columns = len(rows[0].cells)
    unnamed = columns > 2 and names is None
    if unnamed and all(_WHOLE.fullmatch(cell) for row in rows for cell in row.cells):
        raise InputError(
            f"{shown(rows[0].text)} may be {columns} whole numbers, or fewer with decimal commas",
            f"name the {columns} columns in a line above, or {EXPORT}",
            path=path,
            line=rows[0].number,
        )


def _numbers(rows: list[_Line], columns: _Columns) -> NDArray[np.float64]:
    """(rows, columns) of the cells, one decimal sign all through."""
    placed = ((row.number, i, cell) for row in rows for i, cell in enumerate(row.cells))
    comma = table_text.has_decimal_commas(placed, columns.refusal)
    cells = (cell.replace(",", ".") if comma else cell for row in rows for cell in row.cells)
    values = np.fromiter(map(float, cells), float).reshape(len(rows), -1)
    sizes = np.abs(values)
    for i, column in np.argwhere((sizes > LARGEST) | ((sizes < SMALLEST) & (sizes > 0)))[:1]:
        what = "large" if sizes[i, column] > LARGEST else "small"
        problem = f"{shown(rows[i].cells[column])} is too {what} for a number"
        raise columns.refusal(problem, "correct it", rows[i].number, int(column))
    return values


# ---- where in a file of text the table is, and what around it is surely no part of it ----


def _is_comment(text: str) -> bool:
    """Whether a line begins with a comment sign."""
    return _COMMENT.match(text) is not None


def _bare(text: str) -> str:
    """A line without its comment sign."""
    sign = _COMMENT.match(text)
    return (text[sign.end() :].lstrip("#/!%") if sign else text).strip()


class _Line(NamedTuple):
    """One line of the file; `width` counts the empty cells at its end too."""

    number: int
    kind: int
    text: str
    cells: list[str]
    width: int


class _Columns(NamedTuple):
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

    def refusal(
        self, problem: str, mend: str, line: int | None, column: int | None = None
    ) -> InputError:
        """An error that names the file, a line of it and a column (from 0)."""
        named = None if column is None else self.label(column)
        return InputError(problem, mend, path=self.path, line=line, column=named)


def _whole_lines(texts: list[str]) -> Iterator[tuple[int, str]]:
    """Numbered lines; those that a cell in quotes runs over are one."""
    skip = 0
    for i, text in enumerate(texts):
        if skip:
            skip -= 1
            continue
        if text.count('"') % 2 and not _is_comment(text):
            for more in range(1, min(_MOST_JOINED, len(texts) - i - 1) + 1):
                if texts[i + more].count('"') % 2:
                    text, skip = " ".join(texts[i : i + more + 1]), more
                    break
        yield i + 1, text


def _line_of(number: int, text: str, separator: str) -> _Line:
    """A line with its cells and kind."""
    # a list of a million events must be read in seconds
    if separator not in text and is_number(text):
        return _Line(number, ROW, text, [text], 1)
    if not text.strip():
        return _Line(number, BLANK, text, [], 0)
    if _is_comment(text):
        return _Line(number, COMMENTED, text, [], 0)
    every = table_text.split(text, separator)
    cells = table_text.without_empty_end(every)
    if not cells:
        kind = BLANK
    elif all(map(is_number, cells)):
        kind = ROW
    elif table_text.is_spoilt(cells[0]) or is_number(cells[0]):
        kind = SPOILT
    else:
        kind = TEXT
    return _Line(number, kind, text, cells, len(every))


def _longest_run(lines: Sequence[_Line], path: Path, roles: Sequence[str]) -> tuple[int, int]:
    """Where the table begins and ends: most rows with the same number of cells, uninterrupted.

    Of two runs as long, the one whose number of cells more rows of the file have. Raises InputError
    if no line is a row of numbers.
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
            raise _spoilt(line, _Columns(path, len(line.cells), None, roles))
    problem = "no row of numbers"
    raise InputError(problem, f"write a table: one row a line, numbers only; {SEPARATE}", path=path)


def _check_above(lines: Sequence[_Line], columns: _Columns) -> None:
    """Refuse what precedes the table unless it is surely no part of it.

    Single numbers are none above a line of text or a comment, as in headers of spectrometers.
    """
    between = None  # the text that stands between the line and the table
    for line in reversed(lines):
        _check(line, between, columns)
        if line.kind == TEXT or (line.kind == COMMENTED and between is None):
            between = line


def _check_below(lines: Sequence[_Line], columns: _Columns) -> None:
    """Refuse what follows the table unless it is surely no part of it; see `_check_above`."""
    between, apart = None, False
    for line in lines:
        _check(line, between, columns)
        if line.kind == BLANK:
            apart = True
        elif line.kind == TEXT:
            if between is None and not apart and _is_mixed(line, columns):
                raise _spoilt(line, columns)
            between = between or line


def _check(line: _Line, between: _Line | None, columns: _Columns) -> None:
    """Refuse a line beside the table that may belong to it; `between` is text on the way there.

    A spoilt line is refused if it touches the table or has as many cells. A row of as many cells
    is refused for the text between, any other for its number of cells, but for a single number
    beyond text.
    """
    cells, wanted = len(line.cells), columns.number
    if line.kind == SPOILT and (between is None or cells == wanted):
        raise _spoilt(line, columns)
    if line.kind != ROW:
        return
    if between is not None and cells == wanted:
        if between.kind == TEXT and _is_mixed(between, columns):
            raise _spoilt(between, columns)
        problem = f"text between rows of numbers: {shown(between.text)}"
        mend = "give each table a file of its own, or begin the line with #"
        raise columns.refusal(problem, mend, between.number)
    if between is None or cells > 1:
        if cells < wanted <= line.width:
            raise _spoilt(line, columns)
        mend = f"give every row {counted(wanted, 'number')}"
        if "," in line.text and "." not in line.text:
            mend += "; if commas are decimal signs, " + EXPORT
        raise columns.refusal(f"{counted(cells, 'cell')}, not {wanted}", mend, line.number)


def _is_mixed(line: _Line, columns: _Columns) -> bool:
    """Whether a line looks like a row with cells that are no numbers."""
    return len(line.cells) == columns.number and any(map(is_number, line.cells))


def _spoilt(line: _Line, columns: _Columns) -> InputError:
    """The refusal of a line's first cell that is no number."""
    cells = line.cells + [""] * (columns.number - len(line.cells))
    column = next(i for i, cell in enumerate(cells) if not is_number(cell))
    return columns.refusal(*table_text.what_is_wrong(cells[column]), line.number, column)
