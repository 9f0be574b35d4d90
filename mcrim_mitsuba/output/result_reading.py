"""Reads what commands wrote: JSON of calibrate, compare, diagnose, simulate, table; tables' CSV."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import read_text, resolved
from mcrim_mitsuba.core.numbers import parse_number
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.core.table_text import csv_cells
from mcrim_mitsuba.efficiency.table import COLUMNS
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.output.result_writing import (
    AT_BOUND,
    CALIBRATION,
    DIAGNOSIS,
    ETA_TABLE,
    HYPOTHESES,
    LOWER,
    RESULT,
    SIGMA,
    SIMULATION,
    UPPER,
    Cell,
    ResultTable,
)

_LIMIT_MB = 200
_WHAT = "give what --json of calibrate, compare, diagnose, report, simulate or table wrote"
#: Whole numbers beyond are nobody's result, and no float can hold the largest that JSON may have.
_LARGEST_WHOLE = 2**63
# a column's name: what NetCDF and CSV can hold
_NAME = re.compile(r"[^\W\d][^\x00-\x1f/\"]*")


class JsonResult:
    """An object of a JSON file; `place` says where in it, for messages.

    What it is asked for and holds as something else is an `InputError`.
    """

    def __init__(self, path: Path, content: dict[str, Any], place: str = "") -> None:
        self.path, self.content, self._place = path, content, place

    def __contains__(self, name: str) -> bool:
        return self.content.get(name) is not None

    def number(self, name: str) -> float | int | None:
        """A finite number, or None for null and for what is not there."""
        value = self.content.get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refusal(name, "not a number")
        if isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
            raise self.refusal(name, "a whole number of more than 64 bits")
        if not math.isfinite(value):
            raise self.refusal(name, "not finite")
        if name.endswith("sigma") and value < 0:
            raise self.refusal(name, "a negative error")
        return value

    def numbers(self, *names: str) -> dict[str, Cell]:
        """Such numbers by name."""
        return {name: self.number(name) for name in names}

    def estimate(self, name: str) -> tuple[float | None, float | None, str | None]:
        """Value, error and bound of a fitted parameter; at a bound there is no error."""
        known = self.object(name)
        bound = known.text("at_bound")
        return known.number("value"), None if bound else known.number("sigma"), bound

    def text(self, name: str) -> str | None:
        """A text, or None where there is none."""
        return self._of_kind(str, name, "not a text")

    def flag(self, name: str) -> bool | None:
        """True, false, or None where there is none."""
        return self._of_kind(bool, name, "neither true nor false")

    def _of_kind(self, kind: type, name: str, problem: str) -> Any:
        value = self.content.get(name)
        if value is not None and not isinstance(value, kind):
            raise self.refusal(name, problem)
        return value

    def object(self, name: str) -> JsonResult:
        """An object in this one; an empty one where there is none."""
        value = self.content.get(name, {})
        if not isinstance(value, dict):
            raise self.refusal(name, "not an object")
        for key in value:
            if not _NAME.fullmatch(key):
                raise self.refusal(name, f"the name {key[:40]!r} cannot be a column")
        return JsonResult(self.path, value, self._at(name))

    def objects(self, name: str) -> Iterator[JsonResult]:
        """Objects of a list in this one; none where there is no list."""
        value = self.content.get(name, [])
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            raise self.refusal(name, "not a list of objects")
        for place, each in enumerate(value):
            yield JsonResult(self.path, each, f"{self._at(name)}[{place}]")

    def refusal(self, name: str, problem: str) -> InputError:
        """The error that says what is wrong with the entry `name`."""
        return InputError(f"{self._at(name)}: {problem}", _WHAT, path=self.path)

    def _at(self, name: str) -> str:
        return f"{self._place}.{name}" if self._place else name


def read_json(path: Path) -> JsonResult:
    """Read a file that holds one JSON object.

    Raises
    ------
    InputError
        If it cannot be read, is no JSON, or holds something else.
    """
    try:
        content = json.loads(read_text(path, _LIMIT_MB))
    except json.JSONDecodeError as error:
        problem = f"not JSON ({error.msg})"
        raise InputError(problem, _WHAT, path=path, line=error.lineno, column=error.colno) from None
    except (RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("JSON that is nested too deeply or too long", _WHAT, path=path) from None
    try:
        json.dumps(content, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        problem = "JSON with half a character (\\ud800 or the like)"
        raise InputError(problem, _WHAT, path=path) from None
    if not isinstance(content, dict):
        raise InputError("JSON, but not of a result", _WHAT, path=path)
    return JsonResult(path, content)


def not_a_result(path: Path) -> InputError:
    """JSON of another program, or of a command without a result in numbers."""
    return InputError("JSON, but no result of mcrim that can be converted", _WHAT, path=path)


# From documents to rows.

#: Reading of a file: its rows, its readings, its provenance.
Parts = tuple[list[dict[str, Cell]], list[dict[str, Cell]], dict[str, Any]]
_PROVENANCE = (
    "seed",
    "photons",
    "cached_photons",
    "scene_hash",
    "versions",
    "parameters",
    "command",
    "notes",
    "polarization",
    "transport",
    "batch",
)


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
    read: dict[str, Parts] = {}
    first = None
    for path, name in zip(files, _names(files), strict=True):
        kind, read[name] = _read(path)
        first = first or kind
        if kind != first:
            problem = f"this is of the kind {kind}, but {files[0]} of the kind {first}"
            raise InputError(problem, "convert results of one kind at a time", path=path)
    return _joined(str(first), read)


def _joined(kind: str, read: dict[str, Parts]) -> ResultTable:
    """Results of one kind, by name."""
    return ResultTable(
        kind,
        tuple({RESULT: name, **row} for name, (rows, _, _) in read.items() for row in rows),
        tuple({RESULT: name, **row} for name, (_, rows, _) in read.items() for row in rows),
        {name: known for name, (_, _, known) in read.items()},
    )


def table_of_document(document: dict[str, Any], name: str) -> ResultTable:
    """What ``--json`` would write, as rows and columns; `name` stands for the file.

    Raises
    ------
    InputError
        If it is no result of calibrate, compare, diagnose, report, simulate or table.
    """
    whole = JsonResult(Path(name), document)
    kind, convert = _kind(whole)
    return _joined(kind, {name: convert(whole)})


def _names(files: Sequence[Path]) -> list[str]:
    """Short names, unlike each other: without folder and suffix where that suffices."""
    for short in (lambda p: p.stem, lambda p: p.name, lambda p: f"{p.parent.name}/{p.name}", str):
        names = [short(file) for file in files]
        if len(set(names)) == len(names):
            return names
    return [str(resolved(file)) for file in files]


def _read(path: Path) -> tuple[str, Parts]:
    if path.suffix.lower() == ".csv":
        return ETA_TABLE, _table_of_csv(path)
    if path.suffix.lower() != ".json":
        problem = f"a result ends in .json or .csv, not in {path.suffix or 'nothing'}"
        raise InputError(problem, "give the file that --json or table -o wrote", path=path)
    document = read_json(path)
    kind, convert = _kind(document)
    return kind, convert(document)


def _kind(document: JsonResult) -> tuple[str, Callable[[JsonResult], Parts]]:
    """What a JSON is, by what only such a result has."""
    if "calibration" in document:
        return CALIBRATION, lambda whole: _calibration(whole.object("calibration"), whole)
    if "verdict" in document and "candidates" in document and "baseline" in document:
        return DIAGNOSIS, _diagnosis
    if "hypotheses" in document and "leading" in document:
        return HYPOTHESES, _hypotheses
    if "chi2" in document and "parameters" in document and "rows" in document:
        return CALIBRATION, lambda whole: _calibration(whole, whole)
    if "eta" in document and "budget" in document:
        return SIMULATION, _simulation
    if "rows" in document and "scene_hash" in document:
        return ETA_TABLE, _table_of_json
    raise not_a_result(document.path)


def is_convertible(document: dict[str, Any]) -> bool:
    """Whether `table_of_document` takes a document."""
    try:
        return bool(_kind(JsonResult(Path(), document)))
    except InputError:
        return False


_QUALITY = ("chi2", "ndf", "p_value")


def _provenance(document: JsonResult) -> dict[str, Any]:
    return {name: document.content[name] for name in _PROVENANCE if name in document}


def _estimates(parameters: JsonResult) -> dict[str, Cell]:
    """Fitted parameters as columns."""
    cells: dict[str, Cell] = {}
    for name in parameters.content:
        cells[name], cells[name + SIGMA], bound = parameters.estimate(name)
        if cells[name] is None:
            raise parameters.refusal(name, "it has no value")
        ends = parameters.object(name).numbers("lower", "upper")
        cells[name + LOWER], cells[name + UPPER] = ends.values()
        if bound:
            cells[name + AT_BOUND] = bound
    return cells


def _calibration(fit: JsonResult, whole: JsonResult) -> Parts:
    row = fit.numbers(*_QUALITY) | _estimates(fit.object("parameters"))
    held = fit.object("fixed")
    row |= held.numbers(*(name for name in held.content if name not in row))
    known = _provenance(whole)
    if whole is fit:
        known.pop("parameters", None)  # the fit's, which are the row
    return [row], _readings(fit), known


_OF_READING = ("measured", "sigma", "model", "model_sigma", "pull", "eta", "eta_sigma")


def _readings(fit: JsonResult) -> list[dict[str, Cell]]:
    """Every reading beside its prediction."""
    return [
        {"label": each.text("label"), **each.numbers(*_OF_READING), "use": each.flag("use")}
        for each in fit.objects("rows")
    ]


def _hypotheses(document: JsonResult) -> Parts:
    """In the order in which they were given."""
    rows: list[dict[str, Cell]] = []
    readings: list[dict[str, Cell]] = []
    said = ("left_out_error", "log_evidence", "log_evidence_sigma", "probability")
    for one in document.objects("hypotheses"):
        name, effects = one.text("name"), one.content.get("effects")
        added = " + ".join(map(str, effects)) if isinstance(effects, list) else ""
        rows.append(
            {
                "hypothesis": name,
                "effects": added or "none",
                **one.numbers(*_QUALITY, *said),
                **_estimates(one.object("parameters")),
            }
        )
        readings += [{"hypothesis": name, **each} for each in _readings(one)]
    return rows, readings, _provenance(document)


def _diagnosis(document: JsonResult) -> Parts:
    """Without any effect first, then the candidates as they were ranked."""
    verdict, leading = document.text("verdict"), document.content.get("leading") or []
    baseline = document.object("baseline")
    rows = [
        {
            "verdict": verdict,
            "effect": "none",
            "leading": False,
            **baseline.numbers(*_QUALITY),
            **_light_yield(baseline.object("parameters")),
        }
    ]
    gain = ("delta_chi2", "delta_chi2_sigma", "p_global", "left_out_error", "aicc")
    for candidate in document.objects("candidates"):
        effect = candidate.text("effect")
        rows.append(
            {
                "verdict": verdict,
                "effect": effect,
                "leading": effect in leading,
                **candidate.numbers(*_QUALITY, *gain),
                "size": _size(candidate),
                "plausible": candidate.flag("plausible"),
                **_light_yield(candidate),
            }
        )
    return rows, [], _provenance(document)


def _light_yield(parameters: JsonResult) -> dict[str, Cell]:
    if LIGHT_YIELD not in parameters:
        return {}
    value, sigma, _ = parameters.estimate(LIGHT_YIELD)
    return {LIGHT_YIELD: value, LIGHT_YIELD + SIGMA: sigma}


def _size(candidate: JsonResult) -> str:
    """``bubble_fraction = 0.27 ± 0.07``; of an effect that is on or off: ``on``."""
    names = candidate.content.get("effect_parameters") or []
    fitted = candidate.object("parameters")
    sizes = []
    for name in names if isinstance(names, list) else []:
        if name not in fitted:
            continue
        value, sigma, bound = fitted.estimate(name)
        if value is not None:
            size = f"{value:.4g}, at its bound" if bound else pdg(value, sigma)
            sizes.append(f"{name} = {size}")
    return "; ".join(sizes) or "on"


def _simulation(document: JsonResult) -> Parts:
    row = document.numbers("eta", "eta_sigma")
    fates, sigmas = document.object("budget"), document.object("budget_sigma")
    for name in fates.content:
        row[name], row[name + SIGMA] = fates.number(name), sigmas.number(name)
    row["photons"] = document.number("photons")
    parameters = document.object("parameters")
    for name, value in parameters.content.items():
        if isinstance(value, float | int | bool | str):
            known = value if isinstance(value, bool | str) else parameters.number(name)
            row[name if name not in row else f"parameter_{name}"] = known
    return [row], [], _provenance(document)


def _table_of_json(document: JsonResult) -> Parts:
    rows = [each.numbers(*COLUMNS) for each in document.objects("rows")]
    if any(None in row.values() for row in rows):
        raise not_a_result(document.path)
    return _one_each(rows, document.path), [], _provenance(document)


def _table_of_csv(path: Path) -> Parts:
    """Lines that begin with # and hold ``name: value`` are provenance."""
    known: dict[str, Any] = {}
    lines = []
    for number, text in enumerate(read_text(path, _LIMIT_MB).split("\n"), start=1):
        if text.startswith("#"):
            name, colon, value = text.lstrip("# ").partition(": ")
            if colon and name.isidentifier():
                known[name] = value
        elif text.strip():
            lines.append((number, text))
    if not lines or tuple(csv_cells(lines[0][1], path, lines[0][0])) != COLUMNS:
        mend = f"its header is {','.join(COLUMNS)}, as mcrim table writes it"
        raise InputError("no table of eta", mend, path=path, line=lines[0][0] if lines else None)
    rows: list[dict[str, Cell]] = []
    for number, text in lines[1:]:
        cells = csv_cells(text, path, number)
        if len(cells) != len(COLUMNS):
            problem = f"{len(cells)} cells under {len(COLUMNS)} columns"
            raise InputError(problem, "give each column one cell", path=path, line=number)
        rows.append(
            {
                name: parse_number(name, cell, path=path, line=number, column=name)
                for name, cell in zip(COLUMNS, cells, strict=True)
            }
        )
    return _one_each(rows, path), [], known


def _one_each(rows: list[dict[str, Cell]], path: Path) -> list[dict[str, Cell]]:
    """Rows without those that say the same again."""
    points: dict[tuple, dict[str, Cell]] = {}
    for row in rows:
        point = tuple(row[name] for name in COLUMNS[:3])
        if points.setdefault(point, row) != row:
            where = ", ".join(f"{n} = {v:g}" for n, v in zip(COLUMNS, point, strict=False))
            raise InputError(f"two values of eta at {where}", "keep one", path=path)
    if not points:
        raise InputError("a table without rows", "give one with rows", path=path)
    return list(points.values())
