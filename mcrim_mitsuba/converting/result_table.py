"""Results in rows and columns, whatever they came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

CALIBRATION, DIAGNOSIS, SIMULATION, ETA_TABLE = (
    "calibration", "diagnosis", "simulation", "eta table",
)  # fmt: skip
#: Column that names the file a row is from.
RESULT = "result"
SIGMA, LOWER, UPPER, AT_BOUND = "_sigma", "_lower", "_upper", "_at_bound"

Cell = float | int | bool | str | None


@dataclass(frozen=True)
class ResultTable:
    """Results of one kind.

    Attributes
    ----------
    kind : str
        ``calibration``, ``diagnosis``, ``simulation`` or ``eta table``.
    rows : tuple of dict of str to (float, int, bool, str or None)
        By column; the error of NAME is NAME_sigma. Calibrations and simulations have one row
        each, diagnoses one per effect, eta tables one per point.
    readings : tuple of dict
        Of calibrations: a reading beside its prediction each.
    provenance : dict of str to dict
        Per result what makes it reproducible: seed, hashes, versions, parameters, notes.
    """

    kind: str
    rows: tuple[dict[str, Cell], ...]
    readings: tuple[dict[str, Cell], ...]
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
