"""How exactly the numbers of a bench are known: ``[tolerances]`` of a campaign.

    [tolerances]
    n_window = 0.01
    gap_mm = { sigma = 0.02, each = "all" }

Every number of a scene was measured by somebody with something. Where a column of the readings
gives several values, each is a part of its own, such as three masks, with an offset of its own;
``each = "all"`` says that one ruler, or one index, is wrong for all of them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from mcrim_mitsuba.campaign.entries import (
    EACH,
    EACH_VALUE,
    NONE,
    SIGMA,
    TOLERANCE,
    TOLERANCES,
    choice,
)
from mcrim_mitsuba.campaign.measurements import Measurements
from mcrim_mitsuba.core.errors import did_you_mean
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value, judge, said, without_unit
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.effects.effect import filled
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX

#: Standard uncertainties by which a number is moved either way to see what it does. Photons of both
#: ends are the same; farther away what it does is less straight, nearer the photons tell less.
REACH = 2.0


@dataclass(frozen=True)
class Tolerance:
    """Standard uncertainty of a scene parameter, or of one of its values."""

    parameter: str
    #: In the parameter's unit.
    sigma: float
    #: The readings' value that it is of; None: of all.
    value: float | None = None

    @property
    def name(self) -> str:
        """``n_window``; of one value of several ``aperture_radius_mm = 7``."""
        return self.parameter if self.value is None else f"{self.parameter} = {self.value:g}"

    @property
    def words(self) -> str:
        """``window index``; ``aperture radius 7 mm``."""
        if self.value is None:
            return without_unit(self.parameter)
        return said(self.parameter, self.value)

    def is_of(self, values: Mapping[str, Value]) -> bool:
        """Whether the part is in a configuration with these values; the index of air is known."""
        if self.parameter not in values or (self.parameter == GAP_INDEX and not filled(values)):
            return False
        return self.value is None or self.value == values[self.parameter]


def read_tolerances(
    document: TomlDocument, scene: SceneFile, measurements: Measurements, known: Collection[str]
) -> tuple[Tolerance, ...]:
    """``[tolerances]`` of a campaign; `known` are the parameters that it fits or holds.

    Raises InputError, with the line, if a name is no number of the scene or is among `known`, or
    where the uncertainty is none or larger than the number can be.
    """
    table, tolerances = document.table(TOLERANCES), list[Tolerance]()
    if table.get(NONE) is True and len(table) == 1:
        return ()
    for name in table:
        _refuse_name(table, name, scene, known)
        each, sigma = EACH_VALUE, table[name]
        if isinstance(sigma, dict):
            entry = document.table(f"{TOLERANCES}.{name}", TOLERANCE)
            each, sigma = choice(entry, EACH, TOLERANCE) or each, entry.number(SIGMA)
            if sigma is None:
                raise table.refusal(name, f"{name} has no {SIGMA}", f"write {name} = 0.01")
        else:
            sigma = table.known_number(name)
        # where the column varies each value is a part; the index of air is none
        rows = [{**scene.parameters, **reading.parameters} for reading in measurements.readings]
        of_rows = dict.fromkeys(float(row[name]) for row in rows)
        whole = Tolerance(name, sigma)
        parts = [replace(whole, value=value) for value in of_rows]
        parts = [part for part in parts if any(map(part.is_of, rows))]
        for part in parts:
            _refuse_sigma(table, part)
        if len(of_rows) > 1 and each == EACH_VALUE:
            tolerances += parts
        elif parts:
            tolerances.append(whole)
    return tuple(tolerances)


def _refuse_name(table: TomlTable, name: str, scene: SceneFile, known: Collection[str]) -> None:
    """Refuse what is no number of the scene, and what has its error elsewhere."""
    numbers = [n for n, value in scene.parameters.items() if isinstance(value, float)]
    if name == NONE:
        mend = "write none = true alone: all numbers are exact; or remove it"
        raise table.refusal(name, "none stands beside other entries, or is not true", mend)
    if name in known or name in (ALPHA_SCAT, ALPHA_ABS):
        mend = f"give its prior and prior_sigma in [parameters.{name}]"
        raise table.refusal(name, f"{name} belongs among the parameters", mend)
    if name not in scene.parameters:
        problem = f"{name} is not a parameter of {scene.path.name}"
        raise table.refusal(name, problem, did_you_mean(name, [*numbers, NONE]))
    if name not in numbers:
        raise table.refusal(name, f"{name} is not a number", f"remove {name}")


def _refuse_sigma(table: TomlTable, part: Tolerance) -> None:
    """Refuse an uncertainty that is none, or by which the number would be impossible."""
    name, value, sigma = part.parameter, part.value, part.sigma
    assert value is not None  # of a column, or the scene's own
    if not sigma > 0.0:
        mend = f"give the standard uncertainty, or remove {name}: it is exact then"
        raise table.refusal(name, f"the uncertainty {sigma:g} of {name} is not above 0", mend)
    for end in (value - REACH * sigma, value + REACH * sigma):
        if (wrong := judge(name, end)) is not None:
            problem = f"{name} = {value:g} ± {sigma:g} reaches {end:g}: {wrong[1]}"
            raise table.refusal(name, problem, "give a smaller uncertainty")
