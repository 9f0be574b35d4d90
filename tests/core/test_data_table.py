"""Tables of numbers as instruments and spreadsheets write them: read rightly, or refused."""

import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core.data_table import DataTable, read_data_table
from mcrim_mitsuba.core.table_text import name_and_unit

cases = cases_of(__file__)

ROLES = ("wavelength", "value")


def read(tmp_path, content) -> DataTable:
    path = tmp_path / "table.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_data_table(path, roles=ROLES)


TWO = [[400.5, 0.1], [401.0, 0.25]]


@cases("content")
def test_the_same_table_however_it_is_written(tmp_path, content):
    table = read(tmp_path, content)
    assert table.values.tolist() == TWO and table.values.dtype == np.float64


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252", "latin-1"])
def test_excel_s_encodings(tmp_path, encoding):
    text = "# gemessen bei 20 °C\r\nWellenlänge (µm)\tT (%)\r\n0,4\t75,5\r\n0,5\t76\r\n"
    table = read(tmp_path, text.encode(encoding))
    assert table.units == ("µm", "%") and table.names == ("Wellenlänge", "T")
    assert table.comments == ("gemessen bei 20 °C",)
    assert table.values.tolist() == [[0.4, 75.5], [0.5, 76.0]] and table.lines.tolist() == [3, 4]


@cases("cell", "name", "unit")
def test_names_and_units(cell, name, unit):
    assert name_and_unit(cell) == (name, unit or None)


@cases("content", "names", "units")
def test_names_above_the_numbers(tmp_path, content, names, units):
    table = read(tmp_path, content)
    assert list(table.names or ()) == names
    assert [unit or "" for unit in table.units] == units
    assert table.values.tolist() == [[400.0, 20.5]]


def test_a_single_column_and_its_comments(tmp_path):
    table = read(tmp_path, "# run 7\nphotons\n12\n13.5\n14\n")
    assert table.values.shape == (3, 1) and table.names == ("photons",)
    assert table.comments == ("run 7",) and table.lines.tolist() == [3, 4, 5]
    assert table.refusal(1, 0, "bad", "mend").place.endswith("line 4, column photons")
    assert table.refusal(None, None, "bad", "mend").place == str(table.path)


@cases(
    "content",
    "says",
    more=[
        (b"PK\x03\x04\x14\x00", "a spreadsheet (.xlsx, .ods)"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "an Excel workbook (.xls)"),
        (b"%PDF-1.4\n", "a PDF"),
        (b"\x1f\x8b\x08\x00", "a gzip archive"),
        ("400,1\n".encode("utf-16-le"), "zero bytes"),
        # no such thing as a table
        ("1 " * 4_000_000, "line 1: a line of more than 100,000 characters"),
        ("x,y\n1,2\n" + "a b" * 1_000_000, "line 3: a line of more than"),
        ("\n" * 9_000_000 + "1", "more than 2,000,000 lines"),
    ],
)
def test_what_is_not_certain_is_refused_with_its_row(tmp_path, content, says):
    refused = refusal(read, tmp_path, content)
    assert says in refused and refused.startswith(str(tmp_path))


def test_decimal_commas_are_certain_where_one_is_no_thousand(tmp_path):
    table = read(tmp_path, "400;1,234\n401;0,345\n402;12\n")
    assert table.values[:, 1].tolist() == [1.234, 0.345, 12.0]


def test_whole_numbers_between_commas_are_columns_if_these_are_named(tmp_path):
    assert read(tmp_path, "bin,counts\n0,12\n1,30\n").values.tolist() == [[0, 12], [1, 30]]
    assert read(tmp_path, "bin,counts,sigma\n0,12,3\n1,30,5\n").values.shape == (2, 3)


def test_random_tables_come_back(tmp_path):
    rng = np.random.default_rng(5)
    for _ in range(40):
        shape = int(rng.integers(1, 30)), int(rng.integers(2, 5))
        values = rng.normal(size=shape) * 10.0 ** rng.integers(-8, 9, size=shape)
        separator = [",", ";", "\t", " "][rng.integers(4)]
        text = "\n".join(separator.join(map(repr, row)) for row in values.tolist())
        if separator != "," and rng.random() < 0.5:
            text = text.replace(".", ",")
        assert np.array_equal(read(tmp_path, text).values, values)
