"""Writes results as CSV, NetCDF or LaTeX, by the file's suffix."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from mcrim_mitsuba.converting.result_table import ETA_TABLE, RESULT, Cell, ResultTable, columns_of
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import write_bytes


def write_table(table: ResultTable, path: str | Path) -> None:
    """Write results whole or not at all.

    Parameters
    ----------
    table : ResultTable
    path : str or Path
        Ends in ``.csv``, ``.nc`` or ``.tex``.

    Raises
    ------
    InputError
        If the suffix is another one, or the file cannot be written.
    """
    write = _WRITERS.get(Path(path).suffix.lower())
    if write is None:
        raise InputError(
            "results are written as .csv, .nc or .tex", "let the name end in one of these",
            path=path,
        )  # fmt: skip
    write_bytes(path, write(table))


def csv_text(table: ResultTable) -> str:
    """A row per row; what is not known is an empty cell.

    One eta table has the columns of ``mcrim table``, which reads like one again.
    """
    columns = columns_of(table.rows)
    if table.kind == ETA_TABLE and len(table.provenance) == 1:
        columns.remove(RESULT)
    return cells_text(columns, table.rows)


def cells_text(columns: Sequence[str], rows: Sequence[dict[str, Cell]]) -> str:
    """CSV of some columns; what a row does not have is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row.get(name)) for name in columns] for row in rows)
    return text.getvalue()


def _cell(value: Cell) -> str:
    """All digits, so that nothing is lost."""
    if value is None:
        return ""
    return str(int(value)) if isinstance(value, bool) else str(value)


def _csv(table: ResultTable) -> bytes:
    return csv_text(table).encode()


def _netcdf(table: ResultTable) -> bytes:
    from mcrim_mitsuba.converting.netcdf import dataset, netcdf_bytes

    return netcdf_bytes(dataset(table))


def _latex(table: ResultTable) -> bytes:
    from mcrim_mitsuba.converting.latex import latex_text

    return latex_text(table).encode()


_WRITERS: dict[str, Callable[[ResultTable], bytes]] = {
    ".csv": _csv, ".nc": _netcdf, ".tex": _latex,
}  # fmt: skip
#: Suffixes of the files that `write_table` writes.
SUFFIXES = tuple(_WRITERS)
