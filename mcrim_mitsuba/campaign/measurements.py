"""Measurement files: their rows, which give readings or name histograms, and the readings."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core import files, table_text
from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean
from mcrim_mitsuba.core.numbers import ENERGIES_KEV, IN_KEV, Value, parse_number, value_text
from mcrim_mitsuba.core.table_text import is_number, shown
from mcrim_mitsuba.scene.spectrophotometer import BEAM_PARAMETERS, refused_of_beam
from mcrim_mitsuba.scene.values import parse_like

_LIMIT_MB = 10
_MOST_ROWS = 10_000
_MOST_COLUMNS = 1000
_NUMBERS = ("signal", "sigma")
_HISTOGRAM = "histogram"
#: What columns are called elsewhere.
_ALSO = {
    "signal": ("counts", "light", "light_yield", "value"),
    "sigma": ("err", "error", "std", "uncertainty"),
    _HISTOGRAM: ("hist", "spectrum"),
}
_WINDOW = ("window_low", "window_high")
#: Columns that hold no numbers.
_TEXTS = ("label", "histogram", "group", "kind", "sample", "shared")
#: An error in per cent.
_SHARE = re.compile(r"([0-9]+\.?[0-9]*) ?%")
_OPTIONAL = ("use", "group", "group_sigma")
#: The highest over the lowest line of one campaign, at most: 5.9 to 1333 keV.
_WIDEST_ENERGIES = 250.0
#: Labels are written into CSV that people open in spreadsheets.
_FORMULA = re.compile(r"[=@]|[+-][^(|]*[(|]")
KIND = "kind"
LIGHT = "light"
TRANSMITTANCE = "transmittance"
SAMPLE = "sample"
#: Energy of a row's line: the light is in proportion to it.
ENERGY = "energy_keV"
_SIGNALS = {LIGHT: "light signal", TRANSMITTANCE: TRANSMITTANCE}
#: Errors that readings share, such as a common background's.
SHARED = "shared"
_FORMAT = ("label", *_NUMBERS, _HISTOGRAM, *_WINDOW, *_OPTIONAL, KIND, SAMPLE, ENERGY, SHARED)
_HEADERS = "the header is label,signal,sigma,... or label,histogram,..."


@dataclass(frozen=True)
class Reading:
    """One row of a measurement file: a reading, or one mounting's histogram that it comes from."""

    #: Its name, unlike all others in the file; the histograms of repeated mountings share one.
    label: str
    #: The reading and its standard error, both in the file's unit; nan in a row that names a
    #: histogram.
    signal: float
    sigma: float
    #: Scene parameters of this configuration, by name; what is not here stays at the
    #: scene's value.
    parameters: dict[str, Value]
    _: KW_ONLY
    #: False leaves it out of the fit but keeps it in sight.
    use: bool = True
    #: Mounting that it shares with other rows.
    group: str | None = None
    #: Relative error (0.02 is 2 %) that all rows of the group share; None without a group.
    group_sigma: float | None = None
    #: What independent sources of errors move it by that other readings share, in its unit.
    shared: tuple[float, ...] = ()
    #: Line in the file; the first mounting's where the reading comes from histograms.
    line: int = 0
    #: The file with the histogram; None where the row gives numbers.
    histogram: Path | None = None
    #: Lowest and highest value of the histogram that are fitted; None: chosen by the fit.
    window: tuple[float, float] | None = None
    #: ``light``, a signal of the bench, or ``transmittance``, the part of a spectrophotometer's
    #: beam that the crystal lets through, without the campaign's scale.
    kind: str = LIGHT
    #: Which crystal was measured; empty: the campaign's own.
    sample: str = ""
    #: Energy that was deposited; None where the file does not say it: that of all others.
    energy_keV: float | None = None
    #: Effects, wrappings, faces of them and sheets that are switched off in this row.
    without: tuple[str, ...] = ()

    @property
    def of_beam(self) -> bool:
        """Whether it is a transmittance."""
        return self.kind == TRANSMITTANCE


@dataclass(frozen=True)
class Measurements:
    """A measurement file: its rows as they were read, or the readings that they give."""

    #: The file.
    path: Path
    #: Its comment lines without the ``#``: units, provenance.
    comments: tuple[str, ...]
    #: Scene parameters that differ from row to row, in the file's order.
    columns: tuple[str, ...]
    #: All of them, those that are not used included.
    readings: tuple[Reading, ...]
    #: Effects, wrappings, their faces and sheets that a column switches, in the file's order.
    switches: tuple[str, ...] = ()

    @property
    def in_use(self) -> tuple[Reading, ...]:
        """The readings that a fit uses."""
        return tuple(reading for reading in self.readings if reading.use)

    @property
    def by_label(self) -> dict[str, list[Reading]]:
        """Rows of every reading, in the file's order."""
        rows: dict[str, list[Reading]] = {}
        for row in self.readings:
            rows.setdefault(row.label, []).append(row)
        return rows

    def refusal(self, row: Reading, column: str | None, problem: str, mend: str) -> InputError:
        """The error to raise about a cell, or about a row."""
        return InputError(problem, mend, path=self.path, line=row.line, column=column)

    def refuse_other_units(self, others_keV: Collection[float] = ()) -> None:
        """Refuse energies so far apart, `others_keV` too, that one is in another unit."""
        rows = {row.energy_keV: row for row in self.readings if row.energy_keV is not None}
        energies = [*rows, *others_keV]
        if rows and max(energies) > _WIDEST_ENERGIES * min(energies):
            row, both = rows.get(min(energies)) or rows[max(rows)], (min(energies), max(energies))
            problem = "{} = {:g} beside {:g}: these are hardly one unit".format(ENERGY, *both)
            raise self.refusal(row, ENERGY, problem, "write all in keV: 1275 for 1.275 MeV")

    def with_readings(self, readings: Iterable[Reading]) -> Measurements:
        """The file with what its rows give, seen side by side.

        Raises InputError if a group has two errors, or if no reading is in use.
        """
        readings = tuple(readings)
        groups: dict[str, Reading] = {}
        for reading in readings:
            if reading.group is None:
                continue
            first = groups.setdefault(reading.group, reading)
            if first.group_sigma != reading.group_sigma:
                there = f"{first.group_sigma:g} on line {first.line}"
                problem = f"group {reading.group} has {reading.group_sigma:g} here and {there}"
                mend = "give a group one group_sigma: its readings share that error"
                raise self.refusal(reading, "group_sigma", problem, mend)
        if not any(reading.use for reading in readings):
            problem = "no reading is in use"
            raise InputError(problem, "add rows, or set use to 1 in some", path=self.path)
        return replace(self, readings=readings)


def read_table(
    path: str | Path, scene_parameters: Mapping[str, Value], effects: Iterable[str] = ()
) -> Measurements:
    """Read a measurement file (CSV), every row checked by itself and beside its namesakes.

    It is as instruments and spreadsheets write it: columns separated by commas, semicolons or tabs,
    decimal points or commas, in the encodings of `core.files.read_table_text`. Columns: label;
    signal and sigma, or histogram (a file; relative paths begin at this file's folder) with
    window_low and window_high, or all of them, with the cells of one kind empty; optionally use,
    group with group_sigma, shared, sample, energy_keV, any parameters of the scene
    (`SceneFile.parameters`), cells of the same kind as these, and names of `effects`, which 0 and 1
    switch row by row. Lines that begin with # are comments.

    Raises InputError, with file, line and column, if anything cannot be used.
    """
    path = Path(path)
    comments, lines, separator = _text_of(path)
    header_line, header = lines[0]
    separator = separator or max(",;\t", key=header.count)
    names = table_text.csv_cells(header, path, header_line, separator, skip_blanks=True)
    columns = table_text.without_empty_end(names)
    if KIND in columns:
        scene_parameters = {**scene_parameters, **BEAM_PARAMETERS}
    switches = tuple(name for name in columns if name in set(effects))
    _check_header(columns, [*scene_parameters, *effects], path, header_line)
    rows = [_Cells(columns, row, separator, path, line) for line, row in lines[1:]]

    def refusal(problem: str, mend: str, line: int, column: str) -> InputError:
        return InputError(problem, mend, path=path, line=line, column=column)

    numbers = [(cells.line, *number) for cells in rows for number in cells.numbers.items()]
    if table_text.has_decimal_commas(numbers, refusal):
        for cells in rows:
            cells |= {name: cell.replace(",", ".") for name, cell in cells.numbers.items()}
    of_scene = tuple(name for name in columns if name not in (*_FORMAT, *switches))
    readings = tuple(cells.row(scene_parameters, switches) for cells in rows)
    table = Measurements(path, comments, of_scene, readings, switches)
    _check_labels(table)
    _check_histograms(table)
    table.refuse_other_units()
    return table


def _text_of(path: Path) -> tuple[tuple[str, ...], list[tuple[int, str]], str | None]:
    """A measurement file's comments, its numbered lines, the header first, and its separator.

    Empty lines are left out; the separator is the one that a first line of Excel gives.
    """
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    texts = files.read_table_text(path, _LIMIT_MB).split("\n")
    if separator := table_text.given_separator(texts[0]):
        texts[0] = ""
    for line, text in enumerate(texts, start=1):
        # spreadsheets write empty rows as ,,, fill rows with these, and put quotes around comments;
        # below the header a label may begin so
        if text.lstrip(" \t" if lines else ' \t"').startswith("#"):
            comments.append(text.strip(' \t",;').lstrip("#").strip())
        elif text.strip(" \t,;"):
            lines.append((line, text))
    if not lines:
        raise InputError("no header line", "begin with label,signal,sigma", path=path)
    if len(lines) > _MOST_ROWS + 1:
        problem = f"more than {_MOST_ROWS:,} readings"
        mend = "is this the file you meant?"
        raise InputError(problem, mend, path=path, line=lines[_MOST_ROWS + 1][0])
    return tuple(comments), lines, separator


def _check_header(columns: list[str], others: Iterable[str], path: Path, line: int) -> None:
    """Refuse names of columns that are not known, or do not belong together."""
    refusal = partial(InputError, path=path, line=line)
    if len(columns) > _MOST_COLUMNS:
        raise refusal(f"more than {_MOST_COLUMNS:,} columns", "is this the file you meant?")
    raw = _HISTOGRAM in columns
    # a table of histograms may have rows with numbers too
    numbers = _NUMBERS if not raw or any(name in columns for name in _NUMBERS) else ()
    for name in ("label", *numbers):
        if name not in columns:
            unknown = [column for column in columns if column not in _FORMAT]
            pairs = [(alike, name)] if (alike := closest(name, unknown)) else []
            also = {c: n for n in (_HISTOGRAM, name) for c in unknown if c in _ALSO.get(n, ())}
            pairs += also.items()
            guess = "is it {}? Then write {}".format(*pairs[0]) if pairs else _HEADERS
            raise refusal(f"there is no column {name}", guess)
    for position, name in enumerate(columns):
        if not name:
            raise refusal("a column has no name", "name it or remove it", column=position + 1)
        if name in columns[:position]:
            raise refusal("the column is there twice", "keep one", column=name)
        if name not in (names := [*_FORMAT, *others]):
            problem = "neither a column of the format nor a parameter of the scene nor an effect"
            raise refusal(problem, did_you_mean(name, names), column=name)
    for first, second in (("group", "group_sigma"), _WINDOW):
        if (first in columns) != (second in columns):
            raise refusal(f"of {first} and {second} only one is there", "give both columns or none")
    if _WINDOW[0] in columns and not raw:
        raise refusal("a window without a column histogram", "remove it, or name histograms")


class _Cells(dict[str, str]):
    """Cells of one line by column name."""

    def __init__(
        self, columns: list[str], text: str, separator: str, path: Path, line: int
    ) -> None:
        self.path, self.line = path, line
        cells = table_text.csv_cells(text, path, line, separator, skip_blanks=True)
        if len(cells) <= _MOST_COLUMNS:
            # spreadsheets fill rows up
            cells = cells[: max(len(columns), len(table_text.without_empty_end(cells)))]
        if len(cells) != len(columns):
            problem = f"{len(cells)} cells under {len(columns)} columns"
            mend = "give each column one cell"
            if separator == "," and len(cells) > len(columns):
                mend += ": separate columns with semicolons, then decimal commas may stay"
                mend += ", or write points"
            raise InputError(problem, mend, path=path, line=line)
        super().__init__(zip(columns, cells, strict=True))

    def row(self, scene_parameters: Mapping[str, Value], switches: Collection[str]) -> Reading:
        """The row, checked by itself."""
        if not self["label"]:
            raise self.refusal("label", "the reading has no label", "name it")
        if _FORMULA.match(self["label"]):
            problem = f"spreadsheets would take {shown(self['label'])} for a formula"
            raise self.refusal("label", problem, "begin the label with a letter")
        signal, sigma, histogram = math.nan, math.nan, self._histogram()
        kind = self.get(KIND) or LIGHT
        if kind not in (LIGHT, TRANSMITTANCE):
            problem = f"kind = {shown(kind)} is neither {LIGHT} nor {TRANSMITTANCE}"
            raise self.refusal(KIND, problem, f"write one of these; an empty cell means {LIGHT}")
        if histogram is None:
            signal, sigma = self._signal(kind)
        elif kind == TRANSMITTANCE:
            problem = "a transmittance with a histogram"
            raise self.refusal(_HISTOGRAM, problem, "give its signal and sigma")
        group, group_sigma = self._group()
        window, shared = self._window(histogram), self.get(SHARED, "").split()
        parameters = self._parameters(scene_parameters, kind, switches)
        use = "use" not in self or self._switch("use", "write 1 to fit it, 0 not to")
        mend = "the column switches the effect: write 1 where a row has it, 0 where not"
        return Reading(
            self["label"],
            signal,
            sigma,
            parameters,
            use=use,
            group=group,
            group_sigma=group_sigma,
            shared=tuple(self.number(SHARED, text) for text in shared),
            line=self.line,
            histogram=histogram,
            window=window,
            kind=kind,
            sample=self.get(SAMPLE, ""),
            energy_keV=self._energy(kind),
            without=tuple(name for name in switches if not self._switch(name, mend)),
        )

    @property
    def numbers(self) -> dict[str, str]:
        """Those of the cells that are numbers."""
        return {name: cell for name, cell in self.items() if name not in _TEXTS and is_number(cell)}

    def place(self, name: str) -> dict[str, Any]:
        return {"path": self.path, "line": self.line, "column": name}

    def number(self, name: str, text: str | None = None) -> float:
        """A cell's number, or that of a `text` in it."""
        text = self[name] if text is None else text
        share = _SHARE.fullmatch(text) if name in ("sigma", SHARED) else None
        if share and is_number(self.get("signal", "")):
            sigma = float(share[1]) / 100 * float(self["signal"])
            problem = f"{name} = {text} is in per cent"
            raise self.refusal(name, problem, f"write it in the unit of the signal: {sigma:.3g}")
        return parse_number(name, text, **self.place(name))

    def refusal(self, name: str, problem: str, mend: str) -> InputError:
        return InputError(problem, mend, **self.place(name))

    def _switch(self, name: str, mend: str) -> bool:
        """Whether a cell of 0 or 1 says yes."""
        if self[name] not in ("0", "1"):
            raise self.refusal(name, f"{name} = '{self[name]}' is neither 0 nor 1", mend)
        return self[name] == "1"

    def _energy(self, kind: str) -> float | None:
        """Energy of the row's line in keV; None where there is no such column, or of a beam."""
        if ENERGY not in self or (kind == TRANSMITTANCE and not self[ENERGY]):
            return None
        energy = self.number(ENERGY)
        if kind == TRANSMITTANCE:
            raise self.refusal(ENERGY, f"{ENERGY} of a transmittance", "empty the cell")
        if not ENERGIES_KEV[0] <= energy <= ENERGIES_KEV[1]:
            problem = f"{ENERGY} = {energy:g} is no energy of a line in keV"
            raise self.refusal(ENERGY, problem, IN_KEV)
        return energy

    def _histogram(self) -> Path | None:
        """The file of the histogram that gives the signal; None for a row with numbers."""
        name = self.get(_HISTOGRAM)
        if not name:
            if _HISTOGRAM in self and not self.get("signal"):
                instead = "give signal and sigma" if "signal" in self else "remove the row"
                problem = "the row has no histogram"
                raise self.refusal(_HISTOGRAM, problem, f"name its file, or {instead}")
            return None
        for number in _NUMBERS:
            if self.get(number):
                problem = f"{number} beside a histogram, which gives it"
                raise self.refusal(number, problem, f"empty the cell, or that of {_HISTOGRAM}")
        path = files.beside(self.path, name)
        if not files.is_there(files.inside(path)[0]):
            problem = f"{name} does not exist"
            mend = files.look_around(path, f"paths are relative to {self.path.name}")
            raise self.refusal(_HISTOGRAM, problem, mend)
        return path

    def _signal(self, kind: str) -> tuple[float, float]:
        """Signal and standard error, both above 0."""
        signal, sigma = self.number("signal"), self.number("sigma")
        if signal <= 0:
            problem = f"signal = {signal:g}, but a {_SIGNALS[kind]} is above 0"
            mend = "give the reading in the unit of sigma, or remove the row"
            raise self.refusal("signal", problem, mend)
        if sigma <= 0:
            mend = "give the standard error of the reading, or use = 0 to leave it out"
            raise self.refusal("sigma", f"sigma = {sigma:g} is not above 0", mend)
        if kind == LIGHT and sigma > signal and self.get("use") != "0":
            problem = f"sigma = {sigma:g} is more than the signal, {signal:g}"
            mend = "give both in one unit, or use = 0: are the two columns exchanged?"
            raise self.refusal("sigma", problem, mend)
        for name, value in (("signal", signal), ("sigma", sigma)):
            if kind == TRANSMITTANCE and value >= 1.0:
                mend = "give the fraction of the beam: 0.76 for 76 %"
                raise self.refusal(name, f"{name} = {value:g} of a transmittance", mend)
        return signal, sigma

    def _window(self, histogram: Path | None) -> tuple[float, float] | None:
        """The part of the histogram that a peak is fitted in; None where the row gives none."""
        given = [name for name in _WINDOW if self.get(name)]
        if not given:
            return None
        if histogram is None:
            raise self.refusal(given[0], "a window without a histogram", "empty the cell")
        if len(given) == 1:
            problem = "only one end of the window is given"
            raise self.refusal(given[0], problem, "give both ends or none")
        low, high = (self.number(name) for name in _WINDOW)
        if not low < high:
            problem = f"the window begins at {low:g} and ends at {high:g}"
            raise self.refusal(_WINDOW[0], problem, "let it begin below its end")
        return low, high

    def _group(self) -> tuple[str | None, float | None]:
        """The mounting that readings share, and its relative error; None of both without one."""
        group = self.get("group")
        if not group:
            if self.get("group_sigma"):
                problem = "group_sigma without a group"
                raise self.refusal("group", problem, "name the group or empty the cell")
            return None, None
        group_sigma = self.number("group_sigma")
        if not 0 < group_sigma < 1:
            problem = f"group_sigma = {group_sigma:g} is not between 0 and 1"
            raise self.refusal("group_sigma", problem, "it is a relative error: write 0.02 for 2 %")
        return group, group_sigma

    def _parameters(
        self, scene_parameters: Mapping[str, Value], kind: str, switches: Collection[str]
    ) -> dict[str, Value]:
        """Scene parameters of the row, without those of the bench that a beam has not."""
        parameters: dict[str, Value] = {}
        for name, cell in self.items():
            if name in _FORMAT or name in switches:
                continue
            if not cell and (name in BEAM_PARAMETERS) != (kind == TRANSMITTANCE):
                continue  # the bench has no beam, and the beam no gap
            if not cell and self.get(SAMPLE):
                continue  # as the campaign says of the sample
            if not cell:
                usual = value_text(scene_parameters[name])
                mend = f"write {usual}, the scene's value, if it is meant: no value is taken over"
                raise self.refusal(name, "the cell is empty", mend)
            if name in BEAM_PARAMETERS and kind == LIGHT:
                raise self.refusal(name, f"{name} of a reading of light", "empty the cell")
            parameters[name] = parse_like(name, cell, scene_parameters[name], **self.place(name))
            if (wrong := refused_of_beam(name, parameters[name])) is not None:
                raise self.refusal(name, *wrong)
        return parameters


def _check_labels(table: Measurements) -> None:
    """Refuse a label of several rows, unless they are mountings of one configuration."""
    separate = "give each configuration its own label"
    for label, (first, *others) in table.by_label.items():
        for row in others:
            if first.histogram is None or row.histogram is None:
                problem = f"the label {label} is on line {first.line} already"
                raise table.refusal(row, "label", problem, "give every reading its own label")
            if row.sample != first.sample:
                problem = f"{label} is of another sample here than on line {first.line}"
                raise table.refusal(row, SAMPLE, problem, "give every sample's readings own labels")
            for name, value in row.parameters.items():
                if value != first.parameters.get(name):
                    there = f"{first.parameters[name]} on line {first.line}"
                    problem = f"{label} has {name} = {value} here and {there}"
                    mend = f"{separate}: rows of one label are repeated mountings"
                    raise table.refusal(row, name, problem, mend)
            if (row.energy_keV, row.without) != (first.energy_keV, first.without):
                problem = f"{label} has another energy or other effects here than on its first line"
                raise table.refusal(row, "label", problem, separate)
            if (row.group, row.group_sigma) != (first.group, first.group_sigma):
                problem = f"{label} is of another group here than on line {first.line}"
                mend = "give the mountings of one reading one group"
                raise table.refusal(row, "group", problem, mend)


def _check_histograms(table: Measurements) -> None:
    """Refuse a histogram that two rows name: a measurement counts once."""
    named = [(row, row.histogram) for row in table.readings if row.histogram is not None]
    duplicates = files.first_duplicates([file for _, file in named])
    if duplicates is None:
        return
    (first, first_file), (row, file) = (named[place] for place in duplicates)
    how = (
        f"is named on line {first.line} already"
        if files.resolved(first_file) == files.resolved(file)
        else f"holds the same bytes as {first_file.name} on line {first.line}"
    )
    problem = f"{file.name} {how}"
    raise table.refusal(row, _HISTOGRAM, problem, "name every histogram once: it would count twice")
