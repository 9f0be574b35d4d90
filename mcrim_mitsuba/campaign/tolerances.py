"""How exactly the numbers of a bench are known: ``[tolerances]`` of a campaign.

    [tolerances]
    n_window = 0.01
    gap_mm = { sigma = 0.02, each = "all" }

Every number of a scene was measured by somebody with something. Where a column of the readings
gives several values, each is a part of its own, such as three masks, with an offset of its own;
``each = "all"`` says that one ruler, or one index, is wrong for all of them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

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
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, judge, unit_of
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.effects.effect import WRONG, BenchNumber, Effect, EffectParameter
from mcrim_mitsuba.scene.scene_file import SceneFile

#: Standard uncertainties by which a number is moved either way to see what it does. Photons of both
#: ends are the same; farther away what it does is less straight, nearer the photons tell less.
REACH = 2.0
#: Standard uncertainties by which a number that is wrong, not inexact, may be off: another glass, a
#: drawing that was read wrongly. The smaller ones are for numbers that cannot be off so far.
_WRONG_BY = (10.0, 7.0, 5.0, 4.0, 3.0, REACH)
#: Part of it that is usual.
_USUAL_PART = 0.6


@dataclass(frozen=True)
class Tolerance:
    """Standard uncertainty of a number of the bench."""

    number: BenchNumber
    #: In the number's unit.
    sigma: float
    #: How far it may be off where it is wrong.
    farthest: float

    @property
    def wrong(self) -> Effect:
        """The effect that the number is wrong: beyond what its uncertainty allows."""
        words, far = self.number.words, self.farthest
        return Effect(
            name=f"{WRONG}{self.number.name}",
            title=f"wrong {words}",
            physics=f"The {words} is not what the scene says, and not by its uncertainty of "
            f"{self.sigma:g} only: it was measured wrongly, read off another drawing, or the part "
            "is another one. What is fitted is how far it is off.",
            source="JCGM 100:2008 (GUM), 3.4.7, on blunders",
            parameters=(
                EffectParameter(
                    name=self.number.offset_name,
                    meaning=f"Off the {words} of the scene",
                    unit=unit_of(self.number.parameter) or "",
                    minimum=-far,
                    maximum=far,
                    start=0.0,
                    plausible=(-_USUAL_PART * far, _USUAL_PART * far),
                    nodes=(-far, -0.4 * far, 0.4 * far, far),
                ),
            ),
            family="numbers",
            look=f"Measure the {words} again, with another instrument.",
            number=self.number,
        )


def read_tolerances(
    document: TomlDocument, scene: SceneFile, measurements: Measurements
) -> tuple[Tolerance, ...]:
    """``[tolerances]`` of a campaign.

    Raises InputError, with the line, if a name is no number of the scene or is a parameter of the
    campaign, or where the uncertainty is none or larger than the number can be.
    """
    table, tolerances = document.table(TOLERANCES), list[Tolerance]()
    known = document.table("parameters")
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
        parts = [BenchNumber(name, value) for value in of_rows]
        parts = [part for part in parts if any(map(part.is_of, rows))]
        far = [_farthest(table, part, sigma) for part in parts]
        if len(of_rows) > 1 and each == EACH_VALUE:
            tolerances += [Tolerance(n, sigma, f) for n, f in zip(parts, far, strict=True)]
        elif parts:
            tolerances.append(Tolerance(BenchNumber(name), sigma, min(far)))
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


def _farthest(table: TomlTable, part: BenchNumber, sigma: float) -> float:
    """How far a number may be off where it is wrong.

    Refuses an uncertainty that is none, or by which the number would be impossible.
    """
    name, value = part.parameter, part.value
    assert value is not None  # of a column, or the scene's own
    if not sigma > 0.0:
        mend = f"give the standard uncertainty, or remove {name}: it is exact then"
        raise table.refusal(name, f"the uncertainty {sigma:g} of {name} is not above 0", mend)
    for times in _WRONG_BY:
        ends = (value - times * sigma, value + times * sigma)
        wrong = [(end, why) for end in ends if (why := judge(name, end)) is not None]
        if not wrong:
            return times * sigma
    ((end, why), *_) = wrong
    problem = f"{name} = {value:g} ± {sigma:g} reaches {end:g}: {why[1]}"
    raise table.refusal(name, problem, "give a smaller uncertainty")
