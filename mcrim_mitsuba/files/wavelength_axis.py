"""The wavelengths of a table: their unit, order and gaps."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.files.data_table import DataTable

#: hc in eV nm (exact in the SI of 2019, rounded) and the same for wavenumbers: wavelengths are
#: taken in vacuum, 0.03 % longer than in air.
HC_EV_NM = 1239.841984
NM_PER_CM = 1e7

#: Scintillators emit, and detectors see, within these.
SHORTEST_NM, LONGEST_NM = 100.0, 2500.0
#: Times the usual step: a longer one is a gap. Longer than so many nm, it is refused.
_GAP, LARGEST_STEP_NM = 5.0, 100.0
_MOST_GAPS_NAMED = 3
_FACTORS = {None: 1.0, "nm": 1.0, "µm": 1000.0, "Å": 0.1, "A": 0.1}
_RECIPROCAL = {"eV": HC_EV_NM, "1/cm": NM_PER_CM}
#: Names of columns beside which numbers without a unit are no wavelengths.
_OTHER_AXIS = re.compile(
    r"freq|pixel|chan|kanal|\bbins?\b|\bbin_|photon|\bhv\b|\bhν|event|trigger|time|zeit|\badc\b"
    r"|angle|winkel|position|volt|temp|count|charge|ampl|index|[ek]v\b"
    r"|^(no|nr|n|row|run|point)\.?$|^#$",
    re.IGNORECASE,
)
_WITH_UNIT = re.compile(r"energ|wave ?number|^e$", re.IGNORECASE)
_WAVELENGTH = re.compile(r"wave ?length|lambda|λ|wellenl|длин", re.IGNORECASE)
#: What numbers without a unit may be, by their range.
_LOOKS_LIKE = (
    (0.1, 1.2, "µm"), (1.2, 12.0, "eV"), (2500.0, 10_000.0, "Å"), (10_000.0, 100_000.0, "1/cm"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class WavelengthAxis:
    """Wavelengths of a table's rows, ascending.

    Attributes
    ----------
    wavelength_nm : (points,) float64
    rows : (points,) int64
        Row of the table for each point; repeated rows are left out.
    per_nm : (points,) float64
        What turns a density over the table's own axis into one over wavelength: 1 for
        wavelengths, E^2/hc for energies, up to a constant factor.
    notes : tuple of str
        Gaps, and conversions that rest on an assumption.
    """

    wavelength_nm: NDArray[np.float64]
    rows: NDArray[np.int64]
    per_nm: NDArray[np.float64]
    notes: tuple[str, ...]


def read_axis(table: DataTable, column: int) -> WavelengthAxis:
    """Wavelengths in nm from a column in nm, µm, Å, eV or 1/cm.

    Descending rows are turned round; a row that repeats the one before is left out.

    Raises
    ------
    InputError
        If the column is named as something else, or an energy has no unit; with the row, if a
        value cannot be a wavelength, rows neither ascend nor descend, a
        wavelength has two values, or a gap is larger than `LARGEST_STEP_NM`.
    """
    given = table.values[:, column]
    unit = table.units[column]
    if unit is None:
        _refuse_other_axis(table, column)
    if unit in _RECIPROCAL:
        _refuse_range(table, column, given, lambda x: _RECIPROCAL[unit] / x)
        wavelengths = _RECIPROCAL[unit] / given
        per_nm = given**2 / _RECIPROCAL[unit]
    elif unit in _FACTORS:
        _refuse_range(table, column, given, lambda x: _FACTORS[unit] * x)
        wavelengths, per_nm = _FACTORS[unit] * given, np.ones_like(given)
    else:
        raise table.refusal(
            None, column, f"'{unit}' is no unit of a wavelength that is read",
            "write nm, µm, Å, eV or 1/cm in the column's name",
        )  # fmt: skip
    rows = _ordered(table, column, given, wavelengths)
    return WavelengthAxis(
        wavelengths[rows],
        rows,
        per_nm[rows],
        _notes_on_gaps(table, column, wavelengths[rows], rows),
    )


def _refuse_other_axis(table: DataTable, column: int) -> None:
    """A column without a unit whose name is that of something else, or needs a unit."""
    name = table.names[column] if table.names else ""
    if _WAVELENGTH.search(name):
        return
    if _WITH_UNIT.search(name):
        raise table.refusal(
            None, column, f"'{name}' has no unit", f"write '{name} (eV)' or (1/cm), or give nm"
        )
    if _OTHER_AXIS.search(name):
        raise table.refusal(
            None, column, f"a wavelength is wanted, and '{name}' is something else",
            "name the right file, or the column by its unit: nm, µm, Å, eV or 1/cm",
        )  # fmt: skip


def _refuse_range(
    table: DataTable,
    column: int,
    given: NDArray[np.float64],
    to_nm: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> None:
    """Values that are no light."""
    with np.errstate(divide="ignore"):
        wavelengths = to_nm(given)
    wrong = (wavelengths < SHORTEST_NM) | (wavelengths > LONGEST_NM) | (given <= 0)
    if not np.any(wrong):
        return
    row = int(np.argmax(wrong))
    value = float(given[row])
    unit = table.units[column]
    if unit is None and np.all(wrong):
        for low, high, looks in _LOOKS_LIKE:
            if low <= value < high:
                raise table.refusal(
                    row, column, f"{value:g} is no wavelength in nm; these look like {looks}",
                    f"write ({looks}) in the column's name, or convert to nm",
                )  # fmt: skip
    raise table.refusal(
        row, column, f"{value:g} {unit or 'nm'} is no wavelength from {SHORTEST_NM:g} to "
        f"{LONGEST_NM:g} nm",
        "correct it, or write the unit in the column's name",
    )  # fmt: skip


def _ordered(
    table: DataTable, column: int, given: NDArray[np.float64], wavelengths: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Rows by ascending wavelength, repeated ones once."""
    steps = np.diff(given)
    direction = 1.0 if np.count_nonzero(steps > 0) >= np.count_nonzero(steps < 0) else -1.0
    for i in np.flatnonzero(direction * steps <= 0):
        row = int(i) + 1
        if steps[i] == 0:
            if not np.array_equal(table.values[i], table.values[row]):
                raise table.refusal(
                    row, column,
                    f"{given[row]:g} is on line {table.lines[i]} already, with another value",
                    "keep one of the rows, or their mean",
                )  # fmt: skip
            continue
        raise table.refusal(
            row, column, f"{given[row]:g} after {given[i]:g}: the rows neither ascend nor descend",
            "sort them, and give each scan a file of its own",
        )  # fmt: skip
    kept = np.flatnonzero(np.concatenate(([True], steps != 0)))
    return kept[np.argsort(wavelengths[kept])]


def _notes_on_gaps(
    table: DataTable, column: int, wavelengths: NDArray[np.float64], rows: NDArray[np.int64]
) -> tuple[str, ...]:
    """Refuses gaps in which a straight line is no curve; names smaller ones."""
    steps = np.diff(wavelengths)
    if not steps.size:
        return ()
    largest = int(np.argmax(steps))
    if steps[largest] > LARGEST_STEP_NM:
        raise table.refusal(
            int(max(rows[largest], rows[largest + 1])), column,
            f"no points from {wavelengths[largest]:.6g} to {wavelengths[largest + 1]:.6g} nm",
            f"give points every {LARGEST_STEP_NM:g} nm at least, or cut the table there",
        )  # fmt: skip
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    if not gaps.size:
        return ()
    named = [f"{wavelengths[i]:.5g} to {wavelengths[i + 1]:.5g} nm" for i in gaps]
    more = len(named) - _MOST_GAPS_NAMED
    text = ", ".join(named[:_MOST_GAPS_NAMED]) + (f" and {more} more gaps" if more > 0 else "")
    return (f"{table.path.name}: no points from {text}: the curve is a straight line there",)
