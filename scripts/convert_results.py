"""Results of mcrim as a CSV, a NetCDF file (xarray) or a LaTeX table.

    python scripts/convert_results.py night/*.json -o night.csv
    python scripts/convert_results.py table.csv -o table.nc
    python scripts/convert_results.py calibrated.json -o results.tex

Files of one kind at a time; what is no result of mcrim is refused in one line.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas
import xarray
from shared import refuse_foreign

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import read_text, refuse_outputs, resolved, write_bytes
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.table_text import csv_cells
from mcrim_mitsuba.effects.effect import with_new_names
from mcrim_mitsuba.efficiency.table import COLUMNS
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output.codec import (
    AT_BOUND,
    DIAGNOSIS,
    ENDINGS,
    HYPOTHESES,
    READERS,
    RESULT,
    SIGMA,
    SIMULATION,
    JsonObject,
    Part,
    ResultTable,
    Row,
    Rows,
    columns_of,
    csv_lines,
    joined,
    netcdf_bytes,
    read_document,
)
from mcrim_mitsuba.output.codec import dataset as dataset_of

_LIMIT_MB = 200
#: Whole numbers beyond are nobody's result, and no float can hold the largest that JSON may have.
_LARGEST_WHOLE = 2**63
#: By which an interpolated part of the light may leave 0 to 1.
_ROUNDING = 1e-3
#: Of the names of a document that are read here.
_VERSION = 1
MEND = "give what --json of calibrate, compare, diagnose, report, simulate or table wrote"
#: What tables are of besides those of `codec`: a row is a point.
ETA_TABLE = "eta table"
# a column's name: what NetCDF and CSV can hold
_NAME = re.compile(r"[^\W\d][^\x00-\x1f/\"]*")
#: Entries that are no numbers.
_TEXTS = ("label", "name", "verdict", "effect", "at_bound")
_FLAGS = ("use", "plausible")


def impossible(name: str, value: float) -> str:
    """What is wrong with a number of this name that no result has; empty where nothing is."""
    if name.endswith("sigma") and value < 0:
        return "a negative error"
    if name == "eta" and not -_ROUNDING <= value <= 1 + _ROUNDING:
        return "no fraction of the light"
    if name in ("p_value", "p_global", "probability") and not 0 <= value <= 1:
        return "no probability"
    return "below 0" if name in ("chi2", "photons") and value < 0 else ""


class CheckedObject(JsonObject):
    """An object of a JSON file; `place` says where in it, for messages.

    What it is asked for and holds as something else is an `InputError`.
    """

    def __init__(self, path: Path, content: dict[str, Any], place: str = "") -> None:
        super().__init__(content)
        self.path, self._place = path, place

    def cell(self, name: str) -> Any:
        """A finite number, a text or a flag; None for null and for what is not there."""
        value, problem = self.content.get(name), ""
        if value is None:
            return None
        if name in _TEXTS:
            problem = "" if isinstance(value, str) else "not a text"
        elif name in _FLAGS:
            problem = "" if isinstance(value, bool) else "neither true nor false"
        elif isinstance(value, bool) or not isinstance(value, int | float):
            problem = "not a number"
        elif isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
            problem = "a whole number of more than 64 bits"
        elif not math.isfinite(value):
            problem = "not finite"
        else:
            problem = impossible(name, value)
        if problem:
            raise self.refusal(name, problem)
        return value

    def estimate(self, name: str) -> Row:
        """A fitted parameter as columns, which must have a value."""
        row = super().estimate(name)
        if row[name] is None:
            raise self.refusal(name, "it has no value")
        return row

    def object(self, name: str) -> JsonObject:
        """An object in this one; an empty one where there is none."""
        value = self.content.get(name, {})
        if not isinstance(value, dict):
            raise self.refusal(name, "not an object")
        for key in value:
            if not _NAME.fullmatch(key):
                raise self.refusal(name, f"the name {key[:40]!r} cannot be a column")
        return CheckedObject(self.path, value, self._at(name))

    def objects(self, name: str) -> Iterator[JsonObject]:
        """Objects of a list in this one; none where there is no list."""
        items = self.content.get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self.refusal(name, "not a list of objects")
        for place, item in enumerate(items):
            yield CheckedObject(self.path, item, f"{self._at(name)}[{place}]")

    def refusal(self, name: str, problem: str) -> InputError:
        """The error that says what is wrong with the entry `name`."""
        return InputError(f"{self._at(name)}: {problem}", MEND, path=self.path)

    def _at(self, name: str) -> str:
        return f"{self._place}.{name}" if self._place else name


def _not_a_result(path: Path) -> InputError:
    """JSON of another program, or of a command without a result in numbers."""
    return InputError("JSON, but no result of mcrim that can be converted", MEND, path=path)


def kind_of(content: Mapping[str, Any]) -> str:
    """The `kind` of a document, if it is one that tables are made of; else empty.

    Documents of the version before `kind` are read for one release, by what only such a result
    has; this goes with the next.
    """
    if "kind" in content:
        return next((kind for kind in (*READERS, "table") if kind == content["kind"]), "")
    there = {name for name, value in content.items() if value is not None}
    by_keys = (
        ("repair", {"calibration"}),
        ("diagnosis", {"verdict", "candidates", "baseline"}),
        ("hypotheses", {"hypotheses", "leading"}),
        ("fit", {"chi2", "parameters", "rows"}),
        ("simulation", {"eta", "budget"}),
        ("table", {"rows", "scene_hash"}),
    )
    return next((kind for kind, keys in by_keys if keys <= there), "")


def read_results(paths: Sequence[str | Path]) -> ResultTable:
    """Read results of one kind.

    Parameters
    ----------
    paths : sequence of str or Path
        ``.json`` of calibrate, compare, diagnose, report, simulate or table, or the ``.csv`` that
        table writes. A report counts as the calibration that it ends with.

    Raises
    ------
    InputError
        If a file is none of these, is there twice, or is of another kind than the first.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise InputError("no result is named", "name one file at least")
    for path, count in Counter(map(resolved, files)).items():
        if count > 1:
            raise InputError("named twice", "name it once", path=path)
    parts: dict[str, Part] = {}
    first = ""
    for path, name in zip(files, _short_names(files), strict=True):
        kind, parts[name] = _read(path)
        first = first or kind
        if kind != first:
            problem = f"this is of the kind {kind}, but {files[0]} of the kind {first}"
            raise InputError(problem, "convert results of one kind at a time", path=path)
    return joined(first, parts)


def read_json(path: Path) -> CheckedObject:
    """Read a file that holds one JSON object.

    Raises
    ------
    InputError
        If it cannot be read, is no JSON, or holds something else.
    """
    text = read_text(path, _LIMIT_MB)
    try:
        content = with_new_names(json.loads(text))
        json.dumps(content, ensure_ascii=False).encode()
    except json.JSONDecodeError as error:
        problem = f"not JSON ({error.msg})"
        raise InputError(problem, MEND, path=path, line=error.lineno, column=error.colno) from None
    except UnicodeEncodeError:
        problem = "JSON with half a character (\\ud800 or the like)"
        raise InputError(problem, MEND, path=path) from None
    except (RecursionError, ValueError):
        raise InputError("JSON that is nested too deeply or too long", MEND, path=path) from None
    if not isinstance(content, dict):
        raise InputError("JSON, but not of a result", MEND, path=path)
    return CheckedObject(path, content)


def _short_names(files: Sequence[Path]) -> list[str]:
    """Short names, unlike each other: without folder and suffix where that suffices."""
    for short in (lambda p: p.stem, lambda p: p.name, lambda p: f"{p.parent.name}/{p.name}", str):
        names = [short(file) for file in files]
        if len(set(names)) == len(names):
            return names
    return [str(resolved(file)) for file in files]


def _read(path: Path) -> tuple[str, Part]:
    if path.suffix.lower() == ".csv":
        return ETA_TABLE, _table_of_csv(path)
    if path.suffix.lower() != ".json":
        problem = f"a result ends in .json or .csv, not in {path.suffix or 'nothing'}"
        raise InputError(problem, "give the file that --json or table -o wrote", path=path)
    document = read_json(path)
    if not (kind := kind_of(document.content)):
        raise _not_a_result(path)
    version = document.content.get("version", _VERSION)
    if version != _VERSION:
        problem = f"a document of version {version!r}, but version {_VERSION} is read here"
        raise InputError(problem, "convert it with the mcrim that wrote it", path=path)
    document.content["kind"] = kind

    def table_of_json(document: JsonObject) -> Rows:
        rows = [point.row(*COLUMNS) for point in document.objects("rows")]
        if any(None in row.values() for row in rows):
            raise _of_other_axes(path)
        return without_repeated(rows, path), []

    return read_document(document, READERS | {"table": (ETA_TABLE, table_of_json)})


def _of_other_axes(path: Path, line: int | None = None) -> InputError:
    """A table of eta over other parameters, or of something else."""
    problem = f"no table of eta over n_gap, alpha_abs and alpha_scat ({','.join(COLUMNS)})"
    mend = (
        "give mcrim table --n-gap, --alpha-abs and --alpha-scat; of all axes it writes .nc itself"
    )
    return InputError(problem, mend, path=path, line=line)


def without_repeated(rows: list[Row], path: Path) -> list[Row]:
    """Rows without those that say the same again."""
    points: dict[tuple, Row] = {}
    for row in rows:
        point = tuple(row[name] for name in COLUMNS[:3])
        if points.setdefault(point, row) != row:
            where = ", ".join(f"{n} = {v:g}" for n, v in zip(COLUMNS, point, strict=False))
            raise InputError(f"two values of eta at {where}", "keep one", path=path)
    if not points:
        raise InputError("a table without rows", "give one with rows", path=path)
    return list(points.values())


def _table_of_csv(path: Path) -> Part:
    """Lines that begin with # and hold ``name: value`` are provenance."""
    provenance: dict[str, Any] = {}
    lines = []
    for number, text in enumerate(read_text(path, _LIMIT_MB).split("\n"), start=1):
        if text.startswith("#"):
            name, colon, value = text.lstrip("# ").partition(": ")
            if colon and name.isidentifier():
                provenance[name] = value
        elif text.strip():
            lines.append((number, text))
    if not lines or tuple(csv_cells(lines[0][1], path, lines[0][0])) != COLUMNS:
        raise _of_other_axes(path, lines[0][0] if lines else None)
    rows: list[Row] = []
    for number, text in lines[1:]:
        cells = csv_cells(text, path, number)
        if len(cells) != len(COLUMNS):
            problem = f"{len(cells)} cells under {len(COLUMNS)} columns"
            raise InputError(problem, "give each column one cell", path=path, line=number)
        row: Row = {}
        for name, cell in zip(COLUMNS, cells, strict=True):
            row[name] = parse_number(name, cell, path=path, line=number, column=name)
            if problem := impossible(name, row[name]):
                at = {"path": path, "line": number, "column": name}
                raise InputError(f"{name} = {cell}: {problem}", MEND, **at)
        rows.append(row)
    return without_repeated(rows, path), [], provenance


# ---------------------------------------------------------------- xarray


def dataset(table: ResultTable) -> xarray.Dataset:
    """Results as a dataset, as `codec.dataset` has them.

    Of eta tables: eta and eta_sigma over (n_gap, alpha_abs_per_cm, alpha_scat_per_cm), with
    `result` before them where there is more than one table; points that a table does not have are
    NaN.
    """
    if table.kind != ETA_TABLE:
        return dataset_of(table)
    names = list(table.provenance)
    frame = pandas.DataFrame(table.rows).astype(dict.fromkeys(COLUMNS, float))
    grid = frame.set_index([RESULT, *COLUMNS[:3]])[["eta", "eta_sigma"]].to_xarray()
    grid = grid.reindex({RESULT: names}).assign_coords({RESULT: np.array(names)})
    return dataset_of(table, grid.isel({RESULT: 0}, drop=True) if len(names) == 1 else grid)


# ---------------------------------------------------------------- LaTeX
# (booktabs), rounded as the Particle Data Group does

_HEADINGS = {
    LIGHT_YIELD: r"light yield (ph\,keV$^{-1}$)",
    "alpha_scat_per_cm": r"$\alpha_{\mathrm{scat}}$ (cm$^{-1}$)",
    "alpha_abs_per_cm": r"$\alpha_{\mathrm{abs}}$ (cm$^{-1}$)",
    "n_gap": r"$n_{\mathrm{gap}}$",
    "n_crystal": r"$n_{\mathrm{crystal}}$",
    "eta": r"$\eta$",
    "chi2": r"$\chi^2$",
    "delta_chi2": r"$\Delta\chi^2$",
    "p_value": "$p$",
}
_LEFT_OUT = {
    DIAGNOSIS: ("p_global", "left_out_error", "aicc", "plausible", "verdict"),
    SIMULATION: ("photons",),
}
_SPECIAL = str.maketrans(
    {character: f"\\{character}" for character in "{}$&#%_"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}"}
    | {"±": r"$\pm$", "\u2212": "$-$"}
)
_POWER = re.compile(r"\((.*)\)e([+-]?\d+)")


def latex_text(table: ResultTable) -> str:
    """A ``tabular``; its document needs the package booktabs.

    Values get the places that their errors deserve; what makes the results reproducible is in
    the JSON and in NetCDF, not here.
    """
    columns = _columns_to_read(table)
    texts = {n for row in table.rows for n, cell in row.items() if isinstance(cell, str | bool)}
    headings = [_HEADINGS.get(name) or escaped(name.replace("_", " ")) for name in columns]
    names = ", ".join(visible(" ".join(name.split())) for name in table.provenance)
    lines = [
        rf"% needs \usepackage{{booktabs}}; made by mcrim_mitsuba from {names}",
        r"\begin{tabular}{" + "".join("l" if name in texts else "r" for name in columns) + "}",
        r"\toprule",
        _latex_line(headings),
        r"\midrule",
        *(_latex_line([_latex_cell(row, name) for name in columns]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _latex_line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def escaped(text: str) -> str:
    """A text that LaTeX shows as it is."""
    return visible(" ".join(text.split())).translate(_SPECIAL)


def _columns_to_read(table: ResultTable) -> list[str]:
    """Columns of a table that is read: errors stand beside values, what is alike is left out."""
    names = columns_of(table.rows)
    columns = []
    for name in names:
        cells = [row.get(name) for row in table.rows]
        beside = any(name.endswith(end) and name.removesuffix(end) in names for end in ENDINGS)
        if beside or name in _LEFT_OUT.get(table.kind, ()) or all(c in (None, "") for c in cells):
            continue
        several_rows = table.kind in (ETA_TABLE, DIAGNOSIS, HYPOTHESES)
        if name == RESULT and several_rows and len(table.provenance) == 1:
            continue
        # parameters of scenes, and fates that no light met
        if table.kind == SIMULATION and name not in (RESULT, "eta"):
            alike = name + SIGMA not in names and all(cell == cells[0] for cell in cells)
            if alike or all(cell == 0 for cell in cells):
                continue
        columns.append(name)
    return columns


def _latex_cell(row: Row, name: str) -> str:
    value = row.get(name)
    if value is None or value == "":
        return "--"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return escaped(value)
    if row.get(name + AT_BOUND):
        return f"{_latex_number(value)} (at its bound)"
    sigma = row.get(name + SIGMA)
    if sigma is not None and float(sigma) > 0:
        return _latex_rounded(pdg(float(value), float(sigma)))
    return _latex_number(value)


def _latex_rounded(text: str) -> str:
    r"""``7.5 ± 1.2`` as ``$7.5 \pm 1.2$``."""
    power = _POWER.fullmatch(text)
    body = (power[1] if power else text).replace("±", r"\pm")
    return rf"$({body}) \times 10^{{{power[2]}}}$" if power else f"${body}$"


def _latex_number(value: float | int) -> str:
    """A number without an error: an integer as it is, others in four digits."""
    if isinstance(value, int):
        return f"${value}$"
    mantissa, _, power = f"{value:.4g}".partition("e")
    return rf"${mantissa} \times 10^{{{int(power)}}}$" if power else f"${mantissa}$"


# ---------------------------------------------------------------- files


def write_table(table: ResultTable, path: str | Path) -> None:
    """Write results whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in ``.csv``, ``.nc`` or ``.tex``.

    Raises
    ------
    InputError
        If the suffix is another one, or the file cannot be written.
    """
    write = _WRITERS.get(Path(path).suffix.lower())
    if write is None:
        problem = "results are written as .csv, .nc or .tex"
        raise InputError(problem, "let the name end in one of these", path=path)
    write_bytes(path, write(table))


def csv_text(table: ResultTable) -> str:
    """A row per row; what is not known is an empty cell.

    One eta table has the columns of ``mcrim table``, which reads like one again.
    """
    columns = columns_of(table.rows)
    if table.kind == ETA_TABLE and len(table.provenance) == 1:
        columns.remove(RESULT)
    return csv_lines(columns, ([row.get(name) for name in columns] for row in table.rows))


_WRITERS: dict[str, Callable[[ResultTable], bytes]] = {
    ".csv": lambda table: csv_text(table).encode(),
    ".nc": lambda table: netcdf_bytes(dataset(table)),
    ".tex": lambda table: latex_text(table).encode(),
}
#: How texts begin that `write_table` writes.
_BEGINNINGS = {".csv": (f"{RESULT},", ",".join(COLUMNS)), ".tex": r"% needs \usepackage{booktabs}"}
#: Suffixes of the files that `write_table` writes.
SUFFIXES = tuple(_WRITERS)


@click.command()
@click.argument("results", nargs=-1, required=True, metavar="RESULT...")
@click.option(
    "-o",
    "--output",
    "path",
    required=True,
    metavar="FILE",
    help="What to write: .csv, .nc (NetCDF 3) or .tex (needs booktabs).",
)
def main(results: tuple[str, ...], path: str) -> None:
    """Convert RESULTs of one kind: JSON of calibrate, compare, diagnose, report, simulate or table,
    or the CSV of table.

    A calibration or simulation becomes a row, a diagnosis one row per effect, a table of eta one
    per point. NetCDF has readings and provenance too, and eta over n_gap, alpha_abs and alpha_scat.
    LaTeX has values with errors, rounded as the Particle Data Group does.
    """
    refuse_outputs({"--output": path}, results, suffixes={"--output": SUFFIXES})
    if begins := _BEGINNINGS.get(Path(path).suffix.lower()):
        refuse_foreign(Path(path), lambda text: text.startswith(begins))
    table = read_results(results)
    write_table(table, path)
    terminal.console().line(f"{path}: {table.kind}, {len(table.rows)} rows of {len(results)} files")


if __name__ == "__main__":
    sys.exit(terminal.run(main, "convert_results"))
