"""Reads a measurement file: one row is one configuration of the bench."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import read_text
from mcrim_mitsuba.files.suggest import did_you_mean
from mcrim_mitsuba.files.values import Value, parse_like, parse_number, parse_value

_LIMIT_MB = 10
_REQUIRED = ("label", "signal", "sigma")
_OPTIONAL = ("use", "group", "group_sigma")


@dataclass(frozen=True)
class Reading:
    """One row.

    Attributes
    ----------
    label : str
        Its name, unlike all others in the file.
    signal, sigma : float
        The reading and its standard error, both in the file's unit.
    parameters : dict of str to float, int, bool or str
        Scene parameters of this configuration, by name; what is not here stays at the
        scene's value.
    use : bool
        False leaves it out of the fit but keeps it in sight.
    group : str or None
        Mounting that it shares with other rows.
    group_sigma : float or None
        Relative error (0.02 is 2 %) that all rows of the group share; None without a group.
    line : int
        Line in the file.
    """

    label: str
    signal: float
    sigma: float
    parameters: dict[str, Value]
    use: bool
    group: str | None
    group_sigma: float | None
    line: int


@dataclass(frozen=True)
class Measurements:
    """A measurement file.

    Attributes
    ----------
    path : Path
        The file.
    comments : tuple of str
        Its comment lines without the ``#``: units, provenance.
    columns : tuple of str
        Scene parameters that differ from row to row, in the file's order.
    readings : tuple of Reading
        All rows, those that are not used included.
    """

    path: Path
    comments: tuple[str, ...]
    columns: tuple[str, ...]
    readings: tuple[Reading, ...]

    @property
    def in_use(self) -> tuple[Reading, ...]:
        """The readings that a fit uses."""
        return tuple(reading for reading in self.readings if reading.use)


def read_measurements(
    path: str | Path, scene_parameters: Mapping[str, Value] | None = None
) -> Measurements:
    """Read and check a measurement file (CSV, UTF-8).

    Parameters
    ----------
    path : str or Path
        The file; columns label, signal, sigma, optionally use, group with group_sigma, and any
        scene parameters; lines that begin with # are comments.
    scene_parameters : mapping of str to value, optional
        Parameters of the scene (`SceneFile.parameters`): a column must be one of them and
        its cells of the same kind. Without it every further column is accepted.

    Raises
    ------
    InputError
        With file, line and column, if anything cannot be used.
    """
    path = Path(path)
    comments, rows = [], []
    for line, text in enumerate(read_text(path, _LIMIT_MB).split("\n"), start=1):
        if text.lstrip().startswith("#"):
            comments.append(text.lstrip().lstrip("#").strip())
        elif text.strip(" \t,"):  # spreadsheets write empty rows as ,,,
            rows.append((line, text))
    if not rows:
        raise InputError("no header line", "begin with label,signal,sigma", path=path)
    header_line, header = rows[0]
    columns = _read_header(header, scene_parameters, path, header_line)
    readings = tuple(_read_rows(rows[1:], columns, scene_parameters, path))
    _check_together(readings, path)
    parameters = tuple(name for name in columns if name not in _REQUIRED + _OPTIONAL)
    return Measurements(path, tuple(comments), parameters, readings)


def _split(text: str, path: Path, line: int) -> list[str]:
    """Cells of one line; a quoted cell cannot go on in the next."""
    try:
        cells = next(csv.reader([text], strict=True, skipinitialspace=True))
    except csv.Error as error:
        raise InputError(
            f"not a CSV line ({error})", "check the quotation marks", path=path, line=line
        ) from None
    return [cell.strip() for cell in cells]


def _read_header(
    text: str, scene_parameters: Mapping[str, Value] | None, path: Path, line: int
) -> list[str]:
    """Names of the columns, checked."""
    place = {"path": path, "line": line}
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in text and "," not in text:
            raise InputError(
                f"the columns are separated by {name}",
                "separate them by commas and write decimals with a point (export as CSV, English)",
                **place,
            )
    columns = _split(text, path, line)
    for name in _REQUIRED:
        if name not in columns:
            raise InputError(
                f"there is no column {name}", "the header is label,signal,sigma,...", **place
            )
    for position, name in enumerate(columns):
        if not name:
            raise InputError(
                "a column has no name", "name it or remove it", column=position + 1, **place
            )
        if name in columns[:position]:
            raise InputError("the column is there twice", "keep one", column=name, **place)
        if name in _REQUIRED + _OPTIONAL or scene_parameters is None:
            continue
        if name not in scene_parameters:
            raise InputError(
                "neither a column of the format nor a parameter of the scene",
                did_you_mean(name, [*_REQUIRED, *_OPTIONAL, *scene_parameters]),
                column=name,
                **place,
            )
    if ("group" in columns) != ("group_sigma" in columns):
        raise InputError(
            "of group and group_sigma only one is there", "give both columns or none", **place
        )
    return columns


def _read_rows(
    rows: list[tuple[int, str]],
    columns: list[str],
    scene_parameters: Mapping[str, Value] | None,
    path: Path,
) -> Iterator[Reading]:
    """Readings of the lines below the header, each checked by itself."""
    for line, text in rows:
        cells = _split(text, path, line)
        if len(cells) != len(columns):
            raise InputError(
                f"{len(cells)} cells under {len(columns)} columns",
                "give each column one cell; decimals take a point, not a comma"
                if len(cells) > len(columns)
                else "give each column one cell",
                path=path,
                line=line,
            )
        yield _read_row(dict(zip(columns, cells, strict=True)), scene_parameters, path, line)


def _read_row(
    cells: dict[str, str], scene_parameters: Mapping[str, Value] | None, path: Path, line: int
) -> Reading:
    """One reading from its cells by column name."""

    def number(name: str) -> float:
        return parse_number(name, cells[name], path=path, line=line, column=name)

    def refuse(name: str, problem: str, mend: str) -> InputError:
        return InputError(problem, mend, path=path, line=line, column=name)

    if not cells["label"]:
        raise refuse("label", "the reading has no label", "name it")
    signal, sigma = number("signal"), number("sigma")
    if signal <= 0:
        raise refuse(
            "signal",
            f"signal = {signal:g}, but a light signal is above 0",
            "give the reading in the unit of sigma, or remove the row",
        )
    if sigma <= 0:
        raise refuse(
            "sigma",
            f"sigma = {sigma:g} is not above 0",
            "give the standard error of the reading, or use = 0 to leave it out",
        )
    use = cells.get("use", "1")
    if use not in ("0", "1"):
        raise refuse("use", f"use = '{use}' is neither 0 nor 1", "write 1 to fit it, 0 not to")
    group, group_sigma = cells.get("group") or None, None
    if group:
        group_sigma = number("group_sigma")
        if not 0 < group_sigma < 1:
            raise refuse(
                "group_sigma",
                f"group_sigma = {group_sigma:g} is not between 0 and 1",
                "it is a relative error: write 0.02 for 2 %",
            )
    elif cells.get("group_sigma"):
        raise refuse("group", "group_sigma without a group", "name the group or empty the cell")
    parameters: dict[str, Value] = {}
    for name in cells:
        if name in _REQUIRED + _OPTIONAL:
            continue
        place = {"path": path, "line": line, "column": name}
        if not cells[name]:
            raise InputError("the cell is empty", "write the parameter's value", **place)
        parameters[name] = (
            parse_value(name, cells[name], **place)
            if scene_parameters is None
            else parse_like(name, cells[name], scene_parameters[name], **place)
        )
    return Reading(cells["label"], signal, sigma, parameters, use == "1", group, group_sigma, line)


def _check_together(readings: tuple[Reading, ...], path: Path) -> None:
    """What only shows when rows are seen side by side."""
    labels: dict[str, int] = {}
    groups: dict[str, Reading] = {}
    for reading in readings:
        place = {"path": path, "line": reading.line}
        if reading.label in labels:
            raise InputError(
                f"the label {reading.label} is on line {labels[reading.label]} already",
                "give every reading its own label",
                column="label",
                **place,
            )
        labels[reading.label] = reading.line
        if reading.group is None:
            continue
        first = groups.setdefault(reading.group, reading)
        if first.group_sigma != reading.group_sigma:
            raise InputError(
                f"group {reading.group} has {reading.group_sigma:g} here and "
                f"{first.group_sigma:g} on line {first.line}",
                "give a group one group_sigma: its readings share that error",
                column="group_sigma",
                **place,
            )
    if not any(reading.use for reading in readings):
        raise InputError("no reading is in use", "add rows, or set use to 1 in some", path=path)
