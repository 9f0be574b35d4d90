"""Readings of a measurement file: one of them is one configuration of the bench."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.measurement_table import MeasurementTable, Row, read_table
from mcrim_mitsuba.files.values import Value


@dataclass(frozen=True)
class Reading:
    """One reading.

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
        Line in the file; the first mounting's where the reading comes from histograms.
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
        All of them, those that are not used included.
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
    """Read and check a measurement file that gives every reading's signal and error.

    Parameters
    ----------
    path, scene_parameters
        As for `measurement_table.read_table`.

    Raises
    ------
    InputError
        With file, line and column, if anything cannot be used, or if a row names a histogram.
    """
    table = read_table(path, scene_parameters)
    for row in table.rows:
        if row.histogram is not None:
            raise table.refusal(
                row, "histogram", "a histogram where a signal is expected",
                "give signal and sigma, which `mcrim reduce` of its campaign writes",
            )  # fmt: skip
    return measurements_of(table, (reading_in(row) for row in table.rows))


def reading_in(row: Row) -> Reading:
    """The reading of a row that gives numbers."""
    assert row.signal is not None and row.sigma is not None
    return reading_of(row, row.signal, row.sigma)


def reading_of(row: Row, signal: float, sigma: float, *, use: bool | None = None) -> Reading:
    """The reading of a row, its first mounting's where there are several."""
    return Reading(
        row.label, signal, sigma, row.parameters, row.use if use is None else use, row.group,
        row.group_sigma, row.line,
    )  # fmt: skip


def measurements_of(table: MeasurementTable, readings: Iterable[Reading]) -> Measurements:
    """A table's readings, seen side by side.

    Raises
    ------
    InputError
        If a group has two errors, or if no reading is in use.
    """
    readings = tuple(readings)
    groups: dict[str, Reading] = {}
    for reading in readings:
        if reading.group is None:
            continue
        first = groups.setdefault(reading.group, reading)
        if first.group_sigma != reading.group_sigma:
            raise InputError(
                f"group {reading.group} has {reading.group_sigma:g} here and "
                f"{first.group_sigma:g} on line {first.line}",
                "give a group one group_sigma: its readings share that error",
                column="group_sigma",
                path=table.path,
                line=reading.line,
            )
    if not any(reading.use for reading in readings):
        raise InputError(
            "no reading is in use", "add rows, or set use to 1 in some", path=table.path
        )
    return Measurements(table.path, table.comments, table.columns, readings)
