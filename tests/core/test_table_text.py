"""Lines of tables: separators, decimal signs, cells and what is wrong with them."""

from pathlib import Path

import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core import table_text
from mcrim_mitsuba.core.errors import InputError

cases = cases_of(__file__)


@pytest.mark.parametrize(
    ("lines", "separator"),
    [
        (["1;2", "3;4"], ";"),
        (["1,5;2,5", "3,5;4,5"], ";"),
        (["1\t2", "3\t4"], "\t"),
        (["1,2", "3,4"], ","),
        (["1 2", "3  4"], table_text.BLANKS),
        (["1.5", "2.5"], table_text.BLANKS),
        (["1,5", "2,5"], ","),  # with commas, rows decide
        (["12l;3"], ";"),  # of a table without one sound row
        ([], table_text.BLANKS),
    ],
)
def test_the_separator_is_that_by_which_most_lines_are_rows(lines, separator):
    assert table_text.separator_of(lines) == separator


def test_excel_gives_the_separator_in_its_first_line():
    assert [table_text.given_separator(line) for line in ("sep=;", '"sep=,"', "SEP=\t;;", "a")] == [
        ";",
        ",",
        "\t",
        None,
    ]


def test_cells_are_split_where_quotes_end():
    assert table_text.split('"a;b";1', ";") == ["a;b", "1"]
    assert table_text.split("1  -2 \u22123", table_text.BLANKS) == ["1", "-2", "-3"]
    assert table_text.csv_cells('"a,b", 1', Path("a.csv"), 3) == ["a,b", "1"]
    assert table_text.csv_cells('1, "a,b"', Path("a.csv"), 3, skip_blanks=True) == ["1", "a,b"]
    refused = refusal(table_text.csv_cells, '"a', Path("a.csv"), 3)
    assert refused.startswith("a.csv, line 3: not a CSV line")
    assert table_text.without_empty_end(["1", "", ""]) == ["1"]


@cases("cell", "number", "none", "spoilt")
def test_what_a_cell_is(cell, number, none, spoilt):
    assert table_text.is_number(cell) == number
    assert table_text.is_no_number(cell) == none
    assert table_text.is_spoilt(cell) == spoilt


def commas(*cells: str) -> bool:
    def refused(problem: str, mend: str, line: int, column: int) -> InputError:
        return InputError(problem, mend, line=line, column=column)

    placed = [(line, 1, cell) for line, cell in enumerate(cells, start=1)]
    return table_text.has_decimal_commas(placed, refused)


def test_one_decimal_sign_all_through():
    assert commas("1,5", "20") and not commas("1.5", "20") and not commas()
    assert refusal(commas, "1.5", "2,5").startswith("line 2, column 1: '2,5' after '1.5'")
    # all may separate thousands, until one cannot
    assert "'1,234' is 1.234 or 1234" in refusal(commas, "1,234", "2,345")
    assert commas("1,234", "2,5")


def test_names_above_columns():
    assert table_text.names_of("λ (nm);T (%)", ";", 2) == ["λ (nm)", "T (%)"]
    assert table_text.names_of("Wavelength (nm) QE %", table_text.BLANKS, 2) == [
        "Wavelength (nm)",
        "QE %",
    ]
    for line in ("a", "1;2", "a;b;c"):
        assert table_text.names_of(line, ";", 2) is None
    assert [table_text.unit_alone(cell) for cell in ("nm", "(nm)", "%", "1", "T")] == [
        "nm",
        "nm",
        "%",
        None,
        None,
    ]


@cases("cell", "problem")
def test_what_is_wrong_with_a_cell(cell, problem):
    said, mend = table_text.what_is_wrong(cell)
    assert said == problem and mend
    assert table_text.shown("x" * 100) == f"'{'x' * 40}…'"
