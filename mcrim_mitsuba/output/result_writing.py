"""Results as tables of values, and these as LaTeX, xarray, NetCDF or CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba import __version__
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import json_text, write_bytes
from mcrim_mitsuba.core.numbers import unit_of
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD

if TYPE_CHECKING:
    import xarray


CALIBRATION, HYPOTHESES, DIAGNOSIS, SIMULATION, ETA_TABLE = (
    "calibration",
    "hypotheses",
    "diagnosis",
    "simulation",
    "eta table",
)
#: Column that names the file a row is from.
RESULT = "result"
SIGMA, LOWER, UPPER, AT_BOUND = "_sigma", "_lower", "_upper", "_at_bound"
_ENDINGS = {
    SIGMA: "standard error",
    LOWER: "lower end of the 68.3 % interval",
    UPPER: "upper end of the 68.3 % interval",
    AT_BOUND: "bound that stopped the fit",
}

Cell = float | int | bool | str | None


@dataclass(frozen=True)
class ResultTable:
    """Results of one kind."""

    #: ``calibration``, ``hypotheses``, ``diagnosis``, ``simulation`` or ``eta table``.
    kind: str
    #: By column; the error of NAME is NAME_sigma. Calibrations and simulations have one row
    #: each, hypotheses one each, diagnoses one per effect, eta tables one per point.
    rows: tuple[dict[str, Cell], ...]
    #: Of calibrations and hypotheses: a reading beside its prediction each.
    readings: tuple[dict[str, Cell], ...]
    #: Per result what makes it reproducible: seed, hashes, versions, parameters, notes.
    provenance: dict[str, dict[str, Any]]


def columns_of(rows: Sequence[dict[str, Cell]]) -> list[str]:
    """Columns in the order of their first appearance, a name's error right after it."""
    names: list[str] = []
    for row in rows:
        before = None
        for name in row:
            if name not in names:
                names.insert(len(names) if before is None else names.index(before) + 1, name)
            before = name
    return names


# Results as a LaTeX table (booktabs), rounded as the Particle Data Group does.

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
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "±": r"$\pm$",
    "\u2212": "$-$",
}
_POWER = re.compile(r"\((.*)\)e([+-]?\d+)")


def latex_text(table: ResultTable) -> str:
    """A ``tabular``; its document needs the package booktabs.

    Values get the places that their errors deserve; what makes the results reproducible is in
    the JSON and in NetCDF, not here.
    """
    columns = _columns(table)
    texts = {n for row in table.rows for n, cell in row.items() if isinstance(cell, str | bool)}
    lines = [
        r"% needs \usepackage{booktabs}; made by mcrim_mitsuba from "
        + ", ".join(visible(" ".join(name.split())) for name in table.provenance),
        r"\begin{tabular}{" + "".join("l" if name in texts else "r" for name in columns) + "}",
        r"\toprule",
        _line([_HEADINGS.get(name) or escaped(name.replace("_", " ")) for name in columns]),
        r"\midrule",
        *(_line([_latex_cell(row, name) for name in columns]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    """A text that LaTeX shows as it is."""
    shown = visible(" ".join(text.split()))
    return "".join(_SPECIAL.get(character, character) for character in shown)


def _columns(table: ResultTable) -> list[str]:
    """Columns of a table that is read: errors stand beside values, what is alike is left out."""
    names = columns_of(table.rows)
    found = []
    for name in names:
        cells = [row.get(name) for row in table.rows]
        own = any(name.endswith(end) and name.removesuffix(end) in names for end in _ENDINGS)
        if own or name in _LEFT_OUT.get(table.kind, ()) or all(c in (None, "") for c in cells):
            continue
        several_rows = table.kind in (ETA_TABLE, DIAGNOSIS, HYPOTHESES)
        if name == RESULT and several_rows and len(table.provenance) == 1:
            continue
        # parameters of scenes, and fates that no light met
        if table.kind == SIMULATION and name not in (RESULT, "eta"):
            alike = name + SIGMA not in names and all(cell == cells[0] for cell in cells)
            if alike or all(cell == 0 for cell in cells):
                continue
        found.append(name)
    return found


def _latex_cell(row: dict[str, Cell], name: str) -> str:
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
        return _rounded(pdg(float(value), float(sigma)))
    return _latex_number(value)


def _rounded(text: str) -> str:
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


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


# Results as a dataset of xarray, and that as NetCDF 3, which needs SciPy alone.
#
# NetCDF 3 knows neither missing values of whole numbers nor numbers of more than 32 bits: such
# columns become floats, and an unknown number becomes NaN. Texts that are not known become empty.

_AXES = ("n_gap", "alpha_abs_per_cm", "alpha_scat_per_cm")
_MEANINGS = {
    "eta": "light collection efficiency",
    "n_gap": "refractive index of the gap",
    "alpha_abs_per_cm": "absorption coefficient of the crystal",
    "alpha_scat_per_cm": "scattering coefficient of the crystal",
    "light_yield_ph_per_keV": "absolute light yield",
    "scale": "signal per light collection efficiency",
    "p_value": "probability of a larger chi2",
    "pull": "(measured - model) over all errors of the two",
}
_UNITS = {"light_yield_ph_per_keV": "1/keV"}
_LARGEST_INT = 2**31 - 1


def dataset(table: ResultTable) -> xarray.Dataset:
    """Results as a dataset.

    Returns
    -------
    xarray.Dataset
        Of eta tables: eta and eta_sigma over (n_gap, alpha_abs_per_cm, alpha_scat_per_cm), with
        `result` before them where there is more than one table; points that a table does not
        have are NaN. Of others: every column over ``row`` (``result`` where each has one row),
        and readings over ``reading``. Units and meanings are attributes of the variables, what
        makes the results reproducible is one of the dataset.
    """
    import xarray

    if table.kind == ETA_TABLE:
        made = _grid(table)
    else:
        single = len(table.rows) == len(table.provenance)
        made = xarray.Dataset(_variables(table.rows, RESULT if single else "row"))
        if single:
            made = made.set_coords(RESULT)
        readings = _variables(table.readings, "reading", prefix="reading_")
        made = made.assign(readings)
    for name, variable in made.variables.items():
        variable.attrs.update(_attributes(str(name)))
    made.attrs |= {
        "title": f"mcrim_mitsuba: {table.kind}",
        "source": f"mcrim_mitsuba {__version__}",
        "kind": table.kind,
        "provenance": json_text(table.provenance),
    }
    if len(table.provenance) == 1:
        (known,) = table.provenance.values()
        texts = {n: v if isinstance(v, str) else json_text(v) for n, v in known.items()}
        made.attrs |= {name: text for name, text in texts.items() if name.isidentifier()}
    return made


def netcdf_bytes(made: xarray.Dataset) -> bytes:
    """The dataset as the content of a NetCDF 3 file.

    Raises
    ------
    InputError
        If a variable has a name that SciPy cannot write.
    """
    for name in map(str, (*made.variables, *made.attrs)):
        if not name.isascii():
            problem = f"NetCDF 3 cannot hold the name {name[:40]}"
            raise InputError(problem, "write .csv, or rename it")
    return bytes(made.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))


def _grid(table: ResultTable) -> xarray.Dataset:
    import pandas

    names = list(table.provenance)
    numbers = dict.fromkeys((*_AXES, "eta", "eta_sigma"), float)
    frame = pandas.DataFrame(table.rows).astype(numbers).set_index([RESULT, *_AXES])
    made = frame[["eta", "eta_sigma"]].to_xarray().reindex({RESULT: names})
    made = made.assign_coords({RESULT: np.array(names)})
    return made.isel({RESULT: 0}, drop=True) if len(names) == 1 else made


def _variables(rows: Sequence[dict[str, Cell]], dimension: str, prefix: str = "") -> dict:
    """Columns as variables; those of which nothing is known are left out."""
    made = {}
    for name in columns_of(rows):
        cells = [row.get(name) for row in rows]
        if not all(cell is None or cell == "" for cell in cells):
            made[prefix + name] = (dimension, _array(cells))
    return made


def _array(cells: Sequence[Cell]) -> np.ndarray:
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    if all(isinstance(cell, bool) for cell in cells):
        return np.array(cells, dtype=np.int8)
    if all(type(cell) is int and abs(cell) <= _LARGEST_INT for cell in cells):
        return np.array(cells, dtype=np.int32)
    return np.array([np.nan if cell is None else float(cell) for cell in cells])


def _attributes(name: str) -> dict[str, str]:
    """Unit and meaning of a variable."""
    plain = name.removeprefix("reading_")
    ending = next((end for end in _ENDINGS if plain.endswith(end)), "")
    base, what = plain.removesuffix(ending), _ENDINGS.get(ending, "")
    meaning = _MEANINGS.get(base, "")
    long_name = " of ".join(part for part in (what, meaning or (base if what else "")) if part)
    unit = _UNITS.get(base) or unit_of(base) or ("1" if base in _MEANINGS else None)
    found = {"long_name": long_name} if long_name else {}
    if unit is not None and ending != AT_BOUND:
        found["units"] = unit
    return found


# Writes results as CSV, NetCDF or LaTeX, by the file's suffix.


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
    return cells_text(columns, table.rows)


def cells_text(columns: Sequence[str], rows: Sequence[dict[str, Cell]]) -> str:
    """CSV of some columns, all digits; what a row does not have is an empty cell."""
    return csv_lines(columns, ([row.get(name) for name in columns] for row in rows))


def csv_lines(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """CSV; None is an empty cell, true is 1."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([int(c) if isinstance(c, bool) else c for c in row] for row in rows)
    return text.getvalue()


_WRITERS: dict[str, Callable[[ResultTable], bytes]] = {
    ".csv": lambda table: csv_text(table).encode(),
    ".nc": lambda table: netcdf_bytes(dataset(table)),
    ".tex": lambda table: latex_text(table).encode(),
}
#: Suffixes of the files that `write_table` writes.
SUFFIXES = tuple(_WRITERS)
