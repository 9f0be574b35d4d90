"""Texts that hold tables of numbers: names with their units, separators and cells."""

from __future__ import annotations

import csv
import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from mcrim_mitsuba.core.errors import InputError

#: Units by their spellings, small letters; what is not here is kept as it was written.
_SPELLINGS = {
    "nm": "nm|nm.|nanometer|nanometers|nanometre|nanometres|нм",
    "µm": "μm|um|micron|microns|micrometer|micrometers|micrometre|micrometres|мкм",
    "Å": "å|ang|angstrom|angstroms|ångström|ångstrom",
    "eV": "ev|эв",
    "1/cm": "1/cm|cm-1|cm^-1|cm⁻¹",
    "%": "%|percent|per cent|pct|pct.|prozent|procent|proc.|proc|проц.|процент",
    "fraction": "fraction|1",
    "a.u.": "a.u.|a. u.|a.u|au|arb. u.|arb. units|arb.units|arb.u.|arbitrary units|rel. u.|r.u.",
}
_UNITS = {
    unicodedata.normalize("NFKC", spelling): unit
    for unit, spellings in _SPELLINGS.items()
    for spelling in spellings.split("|")
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
    return None if key in _NOT_ALONE else _UNITS.get(key.strip("()[]{}"))


def name_and_unit(cell: str) -> tuple[str, str | None]:
    """A column's name without its unit, as written, and the unit; None without one.

    Cells are as ``Wavelength (nm)``, ``λ/nm``, ``λ, nm``, ``wavelength_nm``, ``Wavelength nm``,
    ``%T``, ``QE [%]``, or ``nm``, which is its own name. Units are ``nm``, ``µm``, ``Å``, ``A``,
    ``eV``, ``1/cm``, ``%``, ``fraction`` or ``a.u.`` in any of their spellings; another one as
    written, where it stands in brackets at the end.
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
        match = form.fullmatch(text)
        if match and (unit := _known(match["unit"])) is not None:
            return match["name"].strip(), unit
    if match := _PERCENT.fullmatch(text):
        return (match["after"] or match["before"]).strip(), "%"
    return text, None


def _key(text: str) -> str:
    return unicodedata.normalize("NFKC", text).strip().lower()


def _known(text: str) -> str | None:
    return _UNITS.get(_key(text))


def _without(text: str, match: re.Match) -> str:
    return " ".join((text[: match.start()] + " " + text[match.end() :]).split())


# Lines of a table: which separator, which decimal sign, which cells are numbers.

BLANKS = " "
#: How to mend a table whose columns are not told apart.
SEPARATE = "separate the columns by semicolons, tabs, commas or blanks"
#: Where two explain the same number of lines, the first is taken.
_SEPARATORS = (";", "\t", ",", BLANKS)
#: Lines that decide on the separator, at most.
_MOST_TRIED = 2000
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\d*[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
_SEP_LINE = re.compile(r'"?sep=(.)"?[;,\t ]*', re.IGNORECASE)
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
    *"nan +nan -nan inf +inf -inf infinity -infinity ∞ -∞ na n/a n.a. none null".split(),
    *"- -- --- – — * ** *** **** ? .".split(),
    *"#n/a #na #nv #div/0! #value! #num! #ref! #wert! #zahl!".split(),
    *"over ovr overflow ovrflw overload sat saturated".split(),
}
_SHOWN = 40


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal point or comma."""
    # counts and channels are most of what is read, a million at a time
    return (cell.isdigit() and cell.isascii()) or _NUMBER.fullmatch(cell) is not None


def is_no_number(cell: str) -> bool:
    """Whether a cell says that there is no number: ``NaN``, ``#N/A``, ``-``."""
    return cell.lower() in _NO_NUMBER


def is_spoilt(cell: str) -> bool:
    """Whether a cell was meant as a number and is none: empty, ``n/a``, ``54l``; not a date."""
    if not cell or is_no_number(cell):
        return True
    cell = cell.strip('"')
    return bool(_SPOILT.match(cell)) and not is_number(cell) and not _DATE_OR_TIME.fullmatch(cell)


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


def csv_cells(
    text: str, path: Path, line: int, separator: str = ",", *, skip_blanks: bool = False
) -> list[str]:
    """Cells of one line of CSV; a quoted cell cannot go on in the next.

    Quotes may follow a separator and blanks where these are skipped. Raises InputError if quotes do
    not match.
    """
    try:
        rows = csv.reader([text], delimiter=separator, strict=True, skipinitialspace=skip_blanks)
        cells = next(rows)
    except csv.Error as error:
        problem = f"not a CSV line ({error})"
        raise InputError(problem, "check the quotation marks", path=path, line=line) from None
    return [cell.strip() for cell in cells]


Named = TypeVar("Named", int, str)


def has_decimal_commas(
    cells: Iterable[tuple[int, Named, str]], refusal: Callable[[str, str, int, Named], InputError]
) -> bool:
    """Whether the numbers of a table have decimal commas: one sign all through.

    `cells` are line, column and text of every cell that is to be a number.
    Raises the `refusal` of a problem and its mend at a line and a column, an InputError, if both
    signs are there, or all commas may as well separate thousands.
    """
    comma = point = None
    thousands = True
    for place in cells:
        cell = place[2]
        if "," in cell:
            comma = comma or place
            thousands = thousands and MAY_BE_THOUSANDS.fullmatch(cell) is not None
        elif "." in cell:
            point = point or place
        if comma and point:
            # what is read now is one of the two
            first = point if comma is place else comma
            raise refusal(
                f"{shown(cell)} after {shown(first[2])}: decimal commas and points in one table",
                "write all numbers with a decimal point",
                *place[:2],
            )
    if comma and thousands:
        text = comma[2]
        raise refusal(
            f"{shown(text)} is {text.replace(',', '.')} or {text.replace(',', '')}: all commas of "
            "this table may be either",
            "write decimal points, and no thousands separators",
            *comma[:2],
        )
    return comma is not None


def given_separator(line: str) -> str | None:
    """The sign that Excel's first line ``sep=;`` gives; None where this is no such line."""
    match = _SEP_LINE.fullmatch(line.strip())
    return match[1] if match else None


def separator_of(lines: Sequence[str]) -> str:
    """The sign by which most lines are rows of numbers; `BLANKS` for a single column, too."""
    tried = lines[:: -(-len(lines) // _MOST_TRIED)] if lines else lines
    alone = sum(len(text.split()) == 1 and is_number(text.strip(' "\t')) for text in tried)
    scores = {sign: sum(_is_row(text, sign) for text in tried) for sign in _SEPARATORS}
    best = max(_SEPARATORS, key=scores.__getitem__)
    if not alone and not scores[best]:
        # not one sound row: what a line with a digit first holds
        spoilt = next((text for text in tried if _SPOILT.match(text.strip(' "\t'))), "")
        return next((sign for sign in _SEPARATORS[:-1] if sign in spoilt), BLANKS)
    # with commas, a line that is one number may be two columns: rows decide
    alone_leads = alone > scores[best] and best != ","
    return BLANKS if alone_leads or not scores[best] else best


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
    """Names in a line above so many columns of numbers; None where it holds none."""
    cells = split(text, separator)
    if separator == BLANKS and len(cells) != columns:
        cells = _joined(cells)
    named = without_empty_end(cells)
    if not named or len(named) > columns or len(cells) < columns or any(map(is_number, named)):
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
        mend = "write numbers without them, such as 1234.5"
        return f"{shown(cell)} has thousands separators", mend
    if match := _OTHER_SEPARATOR.fullmatch(cell):
        return f"columns are separated by '{match[1]}'", SEPARATE
    if cell.endswith("%") and is_number(cell[:-1].strip()):
        return f"{shown(cell)} ends in %", "write % in the column's name, and numbers below it"
    mend = "correct it, or begin the line with # if it is no row of the table"
    return f"{shown(cell)} is not a number", mend
