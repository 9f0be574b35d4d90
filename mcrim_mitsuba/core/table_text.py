"""Texts that hold tables of numbers: names and units, cells, and which lines are the table."""

from __future__ import annotations

import csv
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.rounding import counted

#: Units by their spellings, small letters; what is not here is kept as it was written.
_SPELLINGS = {
    "nm": ("nm", "nm.", "nanometer", "nanometers", "nanometre", "nanometres",
           "нм"),
    "µm": ("μm", "um", "micron", "microns", "micrometer", "micrometers", "micrometre",
           "micrometres", "мкм"),
    "Å": ("å", "ang", "angstrom", "angstroms", "ångström", "ångstrom"),
    "eV": ("ev", "эв"),
    "1/cm": ("1/cm", "cm-1", "cm^-1", "cm⁻¹"),
    "%": ("%", "percent", "per cent", "pct", "pct.", "prozent", "procent", "proc.", "proc", "проц.",
          "процент"),
    "fraction": ("fraction", "1"),
    "a.u.": ("a.u.", "a. u.", "a.u", "au", "arb. u.", "arb. units", "arb.units", "arb.u.",
             "arbitrary units", "rel. u.", "r.u."),
}  # fmt: skip
_UNITS = {
    unicodedata.normalize("NFKC", spelling): unit
    for unit, spellings in _SPELLINGS.items()
    for spelling in spellings
}
# "A" is an Ångström beside wavelengths and an absorbance elsewhere: its reader must know
_UNITS["a"] = "A"
#: Words that are units only in brackets or after a name.
_NOT_ALONE = ("1", "fraction", "proc", "a", "micron", "microns", "au")
_IN_BRACKETS = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
_AFTER_A_MARK = re.compile(r"(?P<name>.*[^\s,/_])\s*[,/_]\s*(?P<unit>[^,/_]+|1/cm|cm[-^].*)")
_AFTER_A_BLANK = re.compile(r"(?P<name>\D*?[^\s\d])(?:\s+in)?\s+(?P<unit>per\s+cent|\S+)", re.I)
_PERCENT = re.compile(r"%\s*(?P<after>[A-Za-z].*)|(?P<before>[A-Za-z][^%=\d]*?)\s*%")


def unit_alone(cell: str) -> str | None:
    """The unit that a cell is, such as ``nm``; None where it is none or may be a name."""
    key = _key(cell)
    bare = key.strip("()[]{}")
    return None if key in _NOT_ALONE else _UNITS.get(bare)


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit.

    Parameters
    ----------
    cell : str
        ``Wavelength (nm)``, ``λ/nm``, ``λ, nm``, ``wavelength_nm``, ``Wavelength nm``, ``%T``,
        ``QE [%]``, ``nm``.

    Returns
    -------
    name : str
        As written; a cell that is only a unit is its own name.
    unit : str or None
        ``nm``, ``µm``, ``Å``, ``A``, ``eV``, ``1/cm``, ``%``, ``fraction`` or ``a.u.`` in any of
        their spellings; another one as written, where it stands in brackets at the end.
    """
    text = " ".join(unicodedata.normalize("NFKC", cell).split())
    if (alone := unit_alone(text)) is not None:
        return text, alone
    brackets = list(_IN_BRACKETS.finditer(text))
    for bracket in brackets:
        if (unit := _known(bracket[1])) is not None:
            return _without(text, bracket), unit
    if brackets and brackets[-1].end() == len(text) and brackets[-1].start() > 0:
        return _without(text, brackets[-1]), brackets[-1][1].strip() or None
    for form in (_AFTER_A_MARK, _AFTER_A_BLANK):
        found = form.fullmatch(text)
        if found and (unit := _known(found["unit"])) is not None:
            return found["name"].strip(), unit
    if found := _PERCENT.fullmatch(text):
        return (found["after"] or found["before"]).strip(), "%"
    return text, None


def _key(text: str) -> str:
    return unicodedata.normalize("NFKC", text).strip().lower()


def _known(text: str) -> str | None:
    return _UNITS.get(_key(text))


def _without(text: str, found: re.Match) -> str:
    return " ".join((text[: found.start()] + " " + text[found.end() :]).split())


# Lines of a table: which separator, which decimal sign, which cells are numbers.

BLANKS = " "
#: How to mend a table whose columns are not told apart.
SEPARATE = "separate the columns by semicolons, tabs, commas or blanks"
#: Where two explain the same number of lines, the first is taken.
_SEPARATORS = (";", "\t", ",", BLANKS)
#: Lines that decide on the separator, at most.
_MOST_TRIED = 2000
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\d*[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
_QUOTED_OR_WORD = re.compile(r'"[^"]*"|[^\s"]+')
_SPOILT = re.compile(r"[+-]?[.,]?\d", re.ASCII)
_DATE_OR_TIME = re.compile(r"\d+[-/:.]\d+[-/:.]\d+.*|\d+:\d+.*", re.ASCII)
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}([ '’\u00a0\u202f]\d{3})+([.,]\d+)?|[+-]?\d{1,3}(,\d{3})+\.\d*"
    r"|[+-]?\d{1,3}(\.\d{3})+,\d*|[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}"
)
#: A number whose comma may separate thousands or decimals.
MAY_BE_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
_OTHER_SEPARATOR = re.compile(r"[+-]?[\d.,]*\s*([|:&])\s*([+-]?[\d.,]+)?")
_NO_NUMBER = {
    "nan", "+nan", "-nan", "inf", "+inf", "-inf", "infinity", "-infinity", "∞", "-∞", "-", "--",
    "---", "–", "—", "*", "**", "***", "****", "?", ".", "na", "n/a", "n.a.", "none", "null",
    "#n/a", "#na", "#nv", "#div/0!", "#value!", "#num!", "#ref!", "#wert!", "#zahl!", "over",
    "ovr", "overflow", "ovrflw", "overload", "sat", "saturated",
}  # fmt: skip
_SHOWN = 40


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    return _NUMBER.fullmatch(cell) is not None


def is_no_number(cell: str) -> bool:
    """Whether a cell says that there is no number: ``NaN``, ``#N/A``, ``-``."""
    return cell.lower() in _NO_NUMBER


def is_spoilt(cell: str) -> bool:
    """Whether a cell was meant as a number and is none: empty, ``n/a``, ``54l``; not a date."""
    if not cell or is_no_number(cell):
        return True
    cell = cell.strip('"')
    return (
        _SPOILT.match(cell) is not None
        and not is_number(cell)
        and _DATE_OR_TIME.fullmatch(cell) is None
    )


def split(text: str, separator: str) -> list[str]:
    """Cells of one line without quotes and blanks around them."""
    if separator == BLANKS and '"' not in text:
        cells = text.split()
    elif separator == BLANKS:
        cells = [cell.strip('"') for cell in _QUOTED_OR_WORD.findall(text)]
    elif '"' in text:
        try:
            row = csv.reader([text], delimiter=separator, strict=True, skipinitialspace=True)
            cells = next(row)
        except csv.Error:
            # quotes that do not match: where a cell ends is not certain
            cells = [text]
    else:
        cells = text.split(separator)
    return [cell.strip().replace("\u2212", "-") for cell in cells]


def csv_cells(text: str, path: Path, line: int, *, skip_blanks: bool = False) -> list[str]:
    """Cells of one line of CSV; a quoted cell cannot go on in the next.

    Quotes may follow a comma and blanks where these are skipped.

    Raises
    ------
    InputError
        If quotes do not match.
    """
    try:
        cells = next(csv.reader([text], strict=True, skipinitialspace=skip_blanks))
    except csv.Error as error:
        problem = f"not a CSV line ({error})"
        raise InputError(problem, "check the quotation marks", path=path, line=line) from None
    return [cell.strip() for cell in cells]


def separator_of(lines: Sequence[str]) -> str:
    """What separates the columns: the sign by which most lines are rows of numbers.

    Returns
    -------
    str
        ``;``, a tab, ``,`` or `BLANKS`, which is also the answer for a single column.
    """
    tried = lines[:: -(-len(lines) // _MOST_TRIED)] if lines else lines
    alone = sum(len(text.split()) == 1 and is_number(text.strip(' "\t')) for text in tried)
    scores = {sign: sum(_is_row(text, sign) for text in tried) for sign in _SEPARATORS}
    best = max(_SEPARATORS, key=scores.__getitem__)
    if not alone and not scores[best]:
        return _likely_separator(tried)
    # with commas, a line that is one number may be two columns: rows decide
    alone_leads = alone > scores[best] and best != ","
    return BLANKS if alone_leads or not scores[best] else best


def _likely_separator(lines: Sequence[str]) -> str:
    """Of a table without one sound row: what a line that begins with a digit holds."""
    for text in lines:
        if _SPOILT.match(text.strip(' "\t')):
            return next((sign for sign in _SEPARATORS[:-1] if sign in text), BLANKS)
    return BLANKS


def _is_row(text: str, separator: str) -> bool:
    """Whether a line is a row of two numbers or more."""
    if separator != BLANKS and separator not in text:
        return False
    cells = without_empty_end(split(text, separator))
    return len(cells) > 1 and all(map(is_number, cells))


def without_empty_end(cells: list[str]) -> list[str]:
    """Cells up to the last that holds something: lines may end in separators."""
    end = len(cells)
    while end and not cells[end - 1]:
        end -= 1
    return cells[:end]


def names_of(text: str, separator: str, columns: int) -> list[str] | None:
    """Names above so many columns; None where a line holds none.

    Parameters
    ----------
    text : str
        A line above the numbers.
    """
    cells = split(text, separator)
    if separator == BLANKS and len(cells) != columns:
        cells = _joined(cells)
    named = without_empty_end(cells)
    if not named or len(named) > columns or len(cells) < columns:
        return None
    if any(map(is_number, named)):
        return None
    return named + [""] * (columns - len(named))


def _joined(words: list[str]) -> list[str]:
    """Names with their units: ``Wavelength (nm) QE %`` are two."""
    cells: list[str] = []
    for word in words:
        if cells and (word[:1] in "([" or unit_alone(word) is not None):
            cells[-1] += f" {word}"
        else:
            cells.append(word)
    return cells


def shown(text: str) -> str:
    """A cell or line in quotes, cut where it is long."""
    text = " ".join(text.split())
    return f"'{text}'" if len(text) <= _SHOWN else f"'{text[:_SHOWN]}…'"


def what_is_wrong(cell: str) -> tuple[str, str]:
    """Problem and mend of a cell that is no number."""
    if not cell:
        return "the cell is empty", "write the number, or remove the row"
    if is_no_number(cell):
        return f"{shown(cell)} is not a finite number", "write the number, or remove the row"
    if _THOUSANDS.fullmatch(cell):
        return (f"{shown(cell)} has thousands separators",
                "write numbers without them, such as 1234.5")  # fmt: skip
    if found := _OTHER_SEPARATOR.fullmatch(cell):
        return f"columns are separated by '{found[1]}'", SEPARATE
    if cell.endswith("%") and is_number(cell[:-1].strip()):
        return f"{shown(cell)} ends in %", "write % in the column's name, and numbers below it"
    return (f"{shown(cell)} is not a number",
            "correct it, or begin the line with # if it is no row of the table")  # fmt: skip


# Where in a file of text the table of numbers is, and what around it is surely no part of it.

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

    def refusal(
        self, problem: str, mend: str, line: int | None, column: int | None = None
    ) -> InputError:
        """An error that names the file, a line of it and a column (from 0)."""
        named = None if column is None else self.label(column)
        return InputError(problem, mend, path=self.path, line=line, column=named)


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
    """Refuse what precedes the table unless it is surely no part of it.

    Single numbers are none above a line of text or a comment, as in headers of spectrometers.

    Raises
    ------
    InputError
    """
    between = None
    for line in reversed(lines):
        _check(line, between, columns)
        if line.kind == TEXT or (line.kind == COMMENTED and between is None):
            between = line


def check_below(lines: Sequence[Line], columns: Columns) -> None:
    """Refuse what follows the table unless it is surely no part of it; see `check_above`."""
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
    mend = f"give every row {counted(wanted, 'number')}"
    if "," in line.text and "." not in line.text:
        mend += "; if commas are decimal signs, " + EXPORT
    return columns.refusal(f"{counted(cells, 'cell')}, not {wanted}", mend, line.number)


def _interrupted(line: Line, columns: Columns) -> InputError:
    if line.kind == TEXT and _is_mixed(line, columns):
        return _spoilt(line, columns)
    return columns.refusal(
        f"text between rows of numbers: {shown(line.text)}",
        "give each table a file of its own, or begin the line with #",
        line.number,
    )


def _spoilt(line: Line, columns: Columns) -> InputError:
    """Of the first cell that is no number."""
    cells = line.cells + [""] * (columns.number - len(line.cells))
    column = next(i for i, cell in enumerate(cells) if not is_number(cell))
    return columns.refusal(*what_is_wrong(cells[column]), line.number, column)
