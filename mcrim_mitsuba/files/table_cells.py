"""Lines of a table: which separator, which decimal sign, which cells are numbers."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

from mcrim_mitsuba.files.column_names import unit_alone

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
        cells = _split_quoted(text, separator)
    else:
        cells = text.split(separator)
    return [cell.strip().replace("\u2212", "-") for cell in cells]


def _split_quoted(text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, strict=True, skipinitialspace=True))
    except csv.Error:
        # quotes that do not match: where a cell ends is not certain
        return [text]


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
