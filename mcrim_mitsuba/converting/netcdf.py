"""Results as a dataset of xarray, and that as NetCDF 3, which needs SciPy alone.

NetCDF 3 knows neither missing values of whole numbers nor numbers of more than 32 bits: such
columns become floats, and an unknown number becomes NaN. Texts that are not known become empty.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba import __version__
from mcrim_mitsuba.converting.result_table import (
    AT_BOUND,
    ETA_TABLE,
    LOWER,
    RESULT,
    SIGMA,
    UPPER,
    Cell,
    ResultTable,
    columns_of,
)
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.values import unit_of

if TYPE_CHECKING:
    import xarray

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
    made.attrs.update(
        {
            "title": f"mcrim_mitsuba: {table.kind}",
            "source": f"mcrim_mitsuba {__version__}",
            "kind": table.kind,
            "provenance": _json(table.provenance),
        }
    )
    if len(table.provenance) == 1:
        (known,) = table.provenance.values()
        made.attrs.update(
            {n: v if isinstance(v, str) else _json(v) for n, v in known.items() if n.isidentifier()}
        )
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
            raise InputError(
                f"NetCDF 3 cannot hold the name {name[:40]}", "write .csv, or rename it"
            )
    return bytes(made.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))


def _grid(table: ResultTable) -> xarray.Dataset:
    import xarray

    names = list(table.provenance)
    axes = {name: sorted({float(_number(row[name])) for row in table.rows}) for name in _AXES}
    places = {name: {v: i for i, v in enumerate(values)} for name, values in axes.items()}
    shape = (len(names), *(len(axes[name]) for name in _AXES))
    values = {name: np.full(shape, np.nan) for name in ("eta", "eta_sigma")}
    for row in table.rows:
        at = (
            names.index(str(row[RESULT])),
            *(places[name][_number(row[name])] for name in _AXES),
        )
        for name, grid in values.items():
            grid[at] = row[name]
    made = xarray.Dataset(
        {name: ((RESULT, *_AXES), grid) for name, grid in values.items()},
        coords={RESULT: names, **axes},
    )
    return made.isel({RESULT: 0}, drop=True) if len(names) == 1 else made


def _variables(rows: Sequence[dict[str, Cell]], dimension: str, prefix: str = "") -> dict:
    """Columns as variables; those of which nothing is known are left out."""
    made = {}
    for name in columns_of(rows):
        cells = [row.get(name) for row in rows]
        if all(cell is None or cell == "" for cell in cells):
            continue
        made[prefix + name] = (dimension, _array(cells))
    return made


def _number(cell: Cell) -> float:
    """What a table of eta has in every column but the result's name."""
    assert isinstance(cell, int | float)
    return cell


def _array(cells: Sequence[Cell]) -> np.ndarray:
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    if all(isinstance(cell, bool) for cell in cells):
        return np.array(cells, dtype=np.int8)
    if all(
        isinstance(c, int) and not isinstance(c, bool) and abs(c) <= _LARGEST_INT for c in cells
    ):
        return np.array(cells, dtype=np.int32)
    return np.array([np.nan if cell is None else float(cell) for cell in cells])


def _attributes(name: str) -> dict[str, str]:
    """Unit and meaning of a variable."""
    plain = name.removeprefix("reading_")
    base, what = plain, ""
    for ending, words in (
        (SIGMA, "standard error"), (LOWER, "lower end of the 68.3 % interval"),
        (UPPER, "upper end of the 68.3 % interval"), (AT_BOUND, "bound that stopped the fit"),
    ):  # fmt: skip
        if plain.endswith(ending):
            base, what = plain.removesuffix(ending), words
            break
    meaning = _MEANINGS.get(base, "")
    long_name = " of ".join(part for part in (what, meaning or (base if what else "")) if part)
    unit = _UNITS.get(base) or unit_of(base) or ("1" if base in _MEANINGS else None)
    found = {"long_name": long_name} if long_name else {}
    if unit is not None and what != "bound that stopped the fit":
        found["units"] = unit
    return found


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
