"""Documents of results read again: as tables, and these as datasets.

`registry.encoded` makes what ``--json`` writes of a result; its ``kind`` says here how it is read.
A result becomes rows of numbers, an error beside each (`ResultTable`), and these a dataset of
xarray, or NetCDF. ``scripts/convert_results.py`` reads files, whose entries it checks, and tables
of eta among them; it writes LaTeX and CSV too.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba import __version__
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import json_text
from mcrim_mitsuba.core.numbers import unit_of
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD

if TYPE_CHECKING:
    import xarray

#: What tables are of; fits are also what comparisons, repairs and reports end with.
CALIBRATION = "calibration"
HYPOTHESES = "hypotheses"
DIAGNOSIS = "diagnosis"
SIMULATION = "simulation"

#: Column that names the file a row is from.
RESULT = "result"
SIGMA = "_sigma"
LOWER = "_lower"
UPPER = "_upper"
AT_BOUND = "_at_bound"
ENDINGS = {
    SIGMA: "standard error",
    LOWER: "lower end of the 68.3 % interval",
    UPPER: "upper end of the 68.3 % interval",
    AT_BOUND: "bound that stopped the fit",
}

Cell = float | int | bool | str | None
Row = dict[str, Any]
#: Reading of a file: its rows, its readings, its provenance.
Part = tuple[list[Row], list[Row], dict[str, Any]]


@dataclass(frozen=True)
class ResultTable:
    """Results of one kind."""

    #: `CALIBRATION`, `HYPOTHESES`, `DIAGNOSIS` or `SIMULATION`.
    kind: str
    #: By column; the error of NAME is NAME_sigma. Calibrations and simulations have one row
    #: each, hypotheses one each, diagnoses one per effect.
    rows: tuple[Row, ...]
    #: Of calibrations and hypotheses: a reading beside its prediction each.
    readings: tuple[Row, ...]
    #: Per result what makes it reproducible: seed, hashes, versions, parameters, notes.
    provenance: dict[str, dict[str, Any]]


def columns_of(rows: Sequence[Row]) -> list[str]:
    """Columns in the order of their first appearance, a name's error right after it."""
    names: list[str] = []
    for row in rows:
        before = None
        for name in row:
            if name not in names:
                names.insert(len(names) if before is None else names.index(before) + 1, name)
            before = name
    return names


# ---------------------------------------------------------------- documents


class JsonObject:
    """An object of a document, in which entries may be missing, or null."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content

    def __contains__(self, name: str) -> bool:
        return self.content.get(name) is not None

    def cell(self, name: str) -> Any:
        """A number, a text or a flag; None for null and for what is not there."""
        return self.content.get(name)

    def row(self, *names: str) -> Row:
        """Such cells by name."""
        return {name: self.cell(name) for name in names}

    def estimate(self, name: str) -> Row:
        """A fitted parameter as columns; at a bound there is no error."""
        read = self.object(name).row("value", "sigma", "lower", "upper", "at_bound")
        bound = read["at_bound"]
        row = {name: read["value"], name + SIGMA: None if bound else read["sigma"]}
        row |= {name + LOWER: read["lower"], name + UPPER: read["upper"]}
        return row | ({name + AT_BOUND: bound} if bound else {})

    def object(self, name: str) -> JsonObject:
        """An object in this one; an empty one where there is none."""
        return JsonObject(self.content.get(name, {}))

    def objects(self, name: str) -> Iterator[JsonObject]:
        """Objects of a list in this one; none where there is no list."""
        return map(JsonObject, self.content.get(name, []))


def joined(kind: str, parts: Mapping[str, Part]) -> ResultTable:
    """Results of one kind, by name."""
    rows = tuple({RESULT: name, **row} for name, (rows, *_) in parts.items() for row in rows)
    below = tuple({RESULT: name, **row} for name, (_, rows, _) in parts.items() for row in rows)
    return ResultTable(kind, rows, below, {name: work for name, (*_, work) in parts.items()})


def read_document(
    document: JsonObject, readers: Mapping[str, tuple[str, Reader]] | None = None
) -> tuple[str, Part]:
    """What its table is of, and its rows, readings and provenance; its kind is one of `READERS`.

    Or one of other `readers`, which are like these.
    """
    kind, read = (readers or READERS)[document.content["kind"]]
    rows, readings = read(document)
    provenance = {name: document.content[name] for name in _PROVENANCE if name in document}
    if kind == CALIBRATION and "calibration" not in document:
        provenance.pop("parameters", None)  # the fit's, which are the row
    return kind, (rows, readings, provenance)


_PROVENANCE = (
    "seed photons cached_photons scene_hash versions parameters command notes polarization "
    "transport batch"
).split()
_QUALITY = ("chi2", "ndf", "p_value")
_OF_READING = ("label", "measured", "sigma", "model", "model_sigma", "pull", "eta", "eta_sigma")
_OF_HYPOTHESIS = ("left_out_error", "log_evidence", "log_evidence_sigma", "probability")
_OF_CANDIDATE = ("delta_chi2", "delta_chi2_sigma", "p_global", "left_out_error", "aicc")

Rows = tuple[list[Row], list[Row]]
Reader = Callable[[JsonObject], Rows]


def _estimates(document: JsonObject) -> Row:
    """The parameters of a fit as columns."""
    parameters = document.object("parameters")
    return {n: cell for name in parameters.content for n, cell in parameters.estimate(name).items()}


def _fit(document: JsonObject) -> Rows:
    """A fit, or the one with which a repair, a report or a budget ends."""
    fit = document.object("calibration") if "calibration" in document else document
    row = fit.row(*_QUALITY) | _estimates(fit)
    held = fit.object("fixed")
    row |= held.row(*(name for name in held.content if name not in row))
    return [row], _readings(fit)


def _readings(fit: JsonObject) -> list[Row]:
    """Every reading beside its prediction."""
    return [row.row(*_OF_READING, "use") for row in fit.objects("rows")]


def _hypotheses(document: JsonObject) -> Rows:
    """Hypotheses in the order in which they were given."""
    rows: list[Row] = []
    readings: list[Row] = []
    for hypothesis in document.objects("hypotheses"):
        name, effects = hypothesis.cell("name"), hypothesis.content.get("effects")
        added = " + ".join(map(str, effects)) if isinstance(effects, list) else ""
        numbers = hypothesis.row(*_QUALITY, *_OF_HYPOTHESIS) | _estimates(hypothesis)
        rows.append({"hypothesis": name, "effects": added or "none", **numbers})
        readings += [{"hypothesis": name, **row} for row in _readings(hypothesis)]
    return rows, readings


def _diagnosis(document: JsonObject) -> Rows:
    """The campaign without any effect first, then the candidates as they were ranked."""
    leading, baseline = document.content.get("leading") or [], document.object("baseline")
    verdict = document.row("verdict")
    without = {"effect": "none", "leading": False, **baseline.row(*_QUALITY)}
    rows = [verdict | without | _light_yield(baseline.object("parameters"))]
    for candidate in document.objects("candidates"):
        row = verdict | candidate.row("effect")
        row |= {"leading": row["effect"] in leading}
        row |= candidate.row(*_QUALITY, *_OF_CANDIDATE)
        row["size"] = _size(candidate)
        rows.append(row | candidate.row("plausible") | _light_yield(candidate))
    return rows, []


def _light_yield(parameters: JsonObject) -> Row:
    if LIGHT_YIELD not in parameters:
        return {}
    estimate = parameters.estimate(LIGHT_YIELD)
    return {name: estimate[name] for name in (LIGHT_YIELD, LIGHT_YIELD + SIGMA)}


def _size(candidate: JsonObject) -> str:
    """``bubble_fraction = 0.27 ± 0.07``; of an effect that is on or off: ``on``."""
    names = candidate.content.get("effect_parameters")
    fitted, sizes = candidate.object("parameters"), []
    for name in names if isinstance(names, list) else []:
        if name in fitted:
            row = fitted.estimate(name)
            at_bound, value = name + AT_BOUND in row, row[name]
            size = f"{value:.4g}, at its bound" if at_bound else pdg(value, row[name + SIGMA])
            sizes.append(f"{name} = {size}")
    return "; ".join(sizes) or "on"


def _simulation(document: JsonObject) -> Rows:
    """Eta, the fates with their errors, photons and the scene's parameters in one row."""
    row = document.row("eta", "eta_sigma")
    fates, sigmas = document.object("budget"), document.object("budget_sigma")
    for name in fates.content:
        row |= {name: fates.cell(name), name + SIGMA: sigmas.cell(name)}
    row |= document.row("photons")
    parameters = document.object("parameters")
    for name, value in parameters.content.items():
        if isinstance(value, float | int | str):
            cell = value if isinstance(value, bool | str) else parameters.cell(name)
            row[name if name not in row else f"parameter_{name}"] = cell
    return [row], []


#: By a document's kind: what its table is of, and how it is read.
READERS: dict[str, tuple[str, Reader]] = {
    "simulation": (SIMULATION, _simulation),
    **dict.fromkeys("fit comparison repair report budget".split(), (CALIBRATION, _fit)),
    "hypotheses": (HYPOTHESES, _hypotheses),
    "diagnosis": (DIAGNOSIS, _diagnosis),
}


# ---------------------------------------------------------------- xarray, NetCDF 3
#
# NetCDF 3 needs SciPy alone. It knows neither missing values of whole numbers nor numbers of more
# than 32 bits: such columns become floats, and an unknown number becomes NaN. Texts that are not
# known become empty.

_MEANINGS = {
    "eta": "light collection efficiency",
    "n_gap": "refractive index of the gap",
    "alpha_abs_per_cm": "absorption coefficient of the crystal",
    "alpha_scat_per_cm": "scattering coefficient of the crystal",
    LIGHT_YIELD: "absolute light yield",
    "scale": "signal per light collection efficiency",
    "p_value": "probability of a larger chi2",
    "pull": "(measured - model) over all errors of the two",
}
_LARGEST_INT = 2**31 - 1


def dataset(table: ResultTable, data: xarray.Dataset | None = None) -> xarray.Dataset:
    """Results as a dataset, or what `data` have over axes of their own.

    Every column lies over ``row`` (``result`` where each result has one row), and readings over
    ``reading``. Units and meanings are attributes of the variables, what makes the results
    reproducible is one of the dataset.
    """
    import xarray

    if data is None:
        single = len(table.rows) == len(table.provenance)
        data = xarray.Dataset(_variables(table.rows, RESULT if single else "row"))
        if single:
            data = data.set_coords(RESULT)
        data = data.assign(_variables(table.readings, "reading", prefix="reading_"))
    for name, variable in data.variables.items():
        variable.attrs.update(_attributes(str(name)))
    data.attrs |= {
        "title": f"mcrim_mitsuba: {table.kind}",
        "source": f"mcrim_mitsuba {__version__}",
        "kind": table.kind,
        "provenance": json_text(table.provenance),
    }
    if len(table.provenance) == 1:
        (provenance,) = table.provenance.values()
        texts = {n: v if isinstance(v, str) else json_text(v) for n, v in provenance.items()}
        data.attrs |= {name: text for name, text in texts.items() if name.isidentifier()}
    return data


def netcdf_bytes(data: xarray.Dataset) -> bytes:
    """The dataset as the content of a NetCDF 3 file.

    Raises InputError if a variable has a name that SciPy cannot write.
    """
    for name in map(str, (*data.variables, *data.attrs)):
        if not name.isascii():
            problem = f"NetCDF 3 cannot hold the name {name[:40]}"
            raise InputError(problem, "write .csv, or rename it")
    return bytes(data.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))


def _variables(rows: Sequence[Row], dimension: str, prefix: str = "") -> dict[str, Any]:
    """Columns as variables; those of which nothing is known are left out."""
    columns = {name: [row.get(name) for row in rows] for name in columns_of(rows)}
    return {
        prefix + name: (dimension, _array(cells))
        for name, cells in columns.items()
        if not all(cell is None or cell == "" for cell in cells)
    }


def _array(cells: Sequence[Cell]) -> np.ndarray:
    """Cells as an array of texts, flags, whole numbers or floats that NetCDF 3 can hold."""
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    if all(isinstance(cell, bool) for cell in cells):
        return np.array(cells, dtype=np.int8)
    if all(type(cell) is int and abs(cell) <= _LARGEST_INT for cell in cells):
        return np.array(cells, dtype=np.int32)
    return np.array([np.nan if cell is None else float(cell) for cell in cells])


def _attributes(name: str) -> dict[str, str]:
    """Unit and meaning of a variable."""
    name = name.removeprefix("reading_")
    ending = next((end for end in ENDINGS if name.endswith(end)), "")
    quantity, what = name.removesuffix(ending), ENDINGS.get(ending, "")
    meaning = _MEANINGS.get(quantity, quantity if what else "")
    unit = unit_of(quantity) or ("1" if quantity in _MEANINGS else "")
    attributes = {"long_name": " of ".join(filter(None, (what, meaning)))}
    attributes["units"] = "" if ending == AT_BOUND else unit.replace("ph/", "1/")
    return {attribute: text for attribute, text in attributes.items() if text}


def csv_lines(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """CSV with all digits; None is an empty cell, true is 1."""
    text = io.StringIO()
    cells = ([int(c) if isinstance(c, bool) else c for c in row] for row in rows)
    csv.writer(text, lineterminator="\n").writerows([columns, *cells])
    return text.getvalue()
