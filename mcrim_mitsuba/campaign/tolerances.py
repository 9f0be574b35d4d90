"""How exactly the numbers of a bench are known: ``[tolerances]`` of a campaign.

    [tolerances]
    n_window = 0.01
    gap_mm = { sigma = 0.02, each = "all" }

Every number of a scene was measured by somebody with something. Where a column of the readings
gives several values, each is a part of its own, such as three masks, with an offset of its own;
``each = "all"`` says that one ruler, or one index, is wrong for all of them. What is left out has
what is usual for a number of its kind; with ``none = true`` it is exact.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.measurements import Measurements
from mcrim_mitsuba.core.errors import did_you_mean
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, SOURCE_Z, THIN, Value, judge, unit_of
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable
from mcrim_mitsuba.effects.effect import WRONG, BenchNumber, Effect, EffectParameter
from mcrim_mitsuba.effects.scene_edits import HEIGHT, WIDTH
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX

#: A cylinder's width, and that of the plate under a crystal.
_DIAMETER = "crystal_diameter_mm"
_WINDOW = "window_width_mm"
#: Lowest and highest values by name, of numbers that the rest of the bench limits.
Room = Mapping[str, tuple[float, float]]
#: Standard uncertainties by which a number is moved either way to see what it does. Photons of both
#: ends are the same; farther away what it does is less straight, nearer the photons tell less.
#: So it is not by a larger part of its value than this, where it is known so well.
_REACH, _STRAIGHT = 4.0, 0.05
#: Standard uncertainties that a number must be able to be off by.
_POSSIBLE = 2.0
#: Usual standard uncertainties: of lengths, in part and at least; of gaps and films, in part; of
#: indices that no material tells; of reflectances.
LENGTH_PART, LENGTH_MM, GAP_PART, INDEX, REFLECTANCE = 0.01, 0.05, 0.3, 0.005, 0.02
#: What is near an end of what there is cannot be off so far: parts of these, of which the first is
#: taken by twice which the number stays inside.
_NEAR_AN_END = 1.0, 0.5, 0.25, 0.1
#: The same in words.
USUAL = (
    f"lengths {100 * LENGTH_PART:g} %, at least {LENGTH_MM:g} mm; gaps {100 * GAP_PART:g} %; "
    f"indices {INDEX:g}, or what the material says; reflectances {REFLECTANCE:g}; of these "
    f"{', '.join(f'{part:g}' for part in _NEAR_AN_END[1:])} where twice as much would pass an end, "
    "as a reflectance of 1"
)
#: Standard uncertainties by which a number that is wrong, not inexact, may be off: a drawing that
#: was read wrongly; and those within which it usually is. Another glass is another index.
_WRONG_BY, _USUALLY_BY, _OTHER_INDEX = 10.0, 6.0, 0.1
#: Part of the farthest at which what an index does is simulated as well: it may bend.
_BETWEEN = 0.5
#: Part of a number that it cannot be too large by.
_MOST_LESS = 0.8


@dataclass(frozen=True)
class Tolerance:
    """Standard uncertainty of a number of the bench."""

    number: BenchNumber
    #: Of the scene, or of a column; of several the smallest.
    value: float
    #: In the number's unit.
    sigma: float
    #: How far it may be off where it is wrong, below and above.
    farthest: tuple[float, float]
    #: Whether the campaign says so; else it is what is usual.
    given: bool = True

    @property
    def near(self) -> tuple[float, float]:
        """Offsets from which what its uncertainty does is told."""
        (low, high), value = self.farthest, abs(self.value)
        reach = max(_POSSIBLE * self.sigma, min(_REACH * self.sigma, _STRAIGHT * value))
        return max(low, -reach), min(high, reach)

    @property
    def _instrument(self) -> str:
        name = self.number.parameter
        if name == GAP_INDEX:
            return "a drop on a refractometer, at the temperature of the bench"
        if self.number.is_index:
            return "the deviation of a laser in a prism of the same piece, or Brewster's angle"
        if name.endswith("reflectance"):
            return "an integrating sphere, beside a standard of known reflectance"
        if any(word in name for word in THIN):
            return "a feeler gauge, or a microscope focused on both faces"
        return "a micrometer or a travelling microscope, at several places"

    @cached_property
    def wrong(self) -> Effect:
        """The effect that the number is wrong: beyond what its uncertainty allows."""
        words, (low, high) = self.number.words, self.farthest
        usual = _USUALLY_BY * self.sigma
        nodes = {low, *self.near, high} - {0.0}  # an end may be where it is
        if self.number.is_index:
            nodes |= {_BETWEEN * low, _BETWEEN * high}
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
                    minimum=low,
                    maximum=high,
                    start=0.0,
                    plausible=(max(low, -usual), min(high, usual)),
                    nodes=tuple(sorted(nodes)),
                    # where an index passes that of a neighbour total reflection begins, and beyond
                    # the nodes of a first look lines are safe
                    kinked=True,
                ),
            ),
            family="numbers",
            look=f"Measure the {words} again, with another instrument: {self._instrument}.",
            number=self.number,
        )


def read_tolerances(
    document: TomlDocument,
    scene: SceneFile,
    measurements: Measurements,
    of_effects: Collection[str] = (),
) -> tuple[Tolerance, ...]:
    """``[tolerances]`` of a campaign, and what is usual of the scene's other numbers.

    Sizes of effects, `of_effects`, and fitted parameters have their errors elsewhere. Raises
    InputError, with the line, if a name is no number of the scene or is a parameter of the
    campaign, or where the uncertainty is larger than the number can be.
    """
    table, tolerances = document.table(schema.TOLERANCES), list[Tolerance]()
    elsewhere = {*document.table("parameters"), ALPHA_SCAT, ALPHA_ABS}
    rows = [{**scene.parameters, **reading.parameters} for reading in measurements.readings]
    room = _room(rows)
    for name in table:
        _refuse_name(table, name, scene, elsewhere)
    for name, own in scene.parameters.items():
        usual = schema.NONE not in table and name not in elsewhere and name not in of_effects
        if not isinstance(own, float) or not (usual or name in table):
            continue
        each, sigma = schema.EACH_VALUE, table.get(name)
        if isinstance(sigma, dict):
            entry = document.table(f"{schema.TOLERANCES}.{name}", schema.TOLERANCE)
            each = schema.choice(entry, schema.EACH, schema.TOLERANCE) or each
            if (sigma := entry.number(schema.SIGMA)) is None:
                raise table.refusal(name, f"{name} has no {schema.SIGMA}", f"write {name} = 0.01")
        elif name in table:
            sigma = table.known_number(name)
        # where the column varies each value is a part; the index of air is none
        of_rows = dict.fromkeys(float(row[name]) for row in rows)
        parts = [BenchNumber(name, value) for value in of_rows]
        parts = [part for part in parts if any(map(part.is_of, rows))]
        found = [
            _usual(scene, room, part) if sigma is None else _given(table, room, part, float(sigma))
            for part in parts
        ]
        of_parts = [tolerance for tolerance in found if tolerance is not None]
        if len(of_rows) > 1 and each == schema.EACH_VALUE:
            tolerances += of_parts
        elif of_parts:
            tolerances.append(_all_alike(of_parts))
    return tuple(tolerances)


def wrong_numbers(tolerances: Iterable[Tolerance]) -> dict[str, Effect]:
    """Effects that a number is wrong, by name; where values differ, that all are by as much too."""
    of_each = dict[str, list[Tolerance]]()
    for tolerance in tolerances:
        of_each.setdefault(tolerance.number.parameter, []).append(tolerance)
    for parts in of_each.values():
        if len(parts) > 1:
            parts.append(_all_alike(parts))
    return {part.wrong.name: part.wrong for parts in of_each.values() for part in parts}


def _all_alike(parts: Sequence[Tolerance]) -> Tolerance:
    """That of all values of a number at once, which are off by as much."""
    lows, highs = zip(*(part.farthest for part in parts), strict=True)
    farthest, number = (max(lows), min(highs)), BenchNumber(parts[0].number.parameter)
    value, sigma = min(part.value for part in parts), min(part.sigma for part in parts)
    return replace(parts[0], number=number, value=value, sigma=sigma, farthest=farthest)


def _refuse_name(table: TomlTable, name: str, scene: SceneFile, known: Collection[str]) -> None:
    """Refuse what is no number of the scene, and what has its error elsewhere."""
    numbers = [n for n, value in scene.parameters.items() if isinstance(value, float)]
    if name == schema.NONE:
        if table[name] is not True:
            mend = "write none = true: what is not named is exact; or remove it"
            raise table.refusal(name, "none is not true", mend)
        return
    if name in known:
        mend = f"give its prior and prior_sigma in [parameters.{name}]"
        raise table.refusal(name, f"{name} belongs among the parameters", mend)
    if name not in scene.parameters:
        problem = f"{name} is not a parameter of {scene.path.name}"
        raise table.refusal(name, problem, did_you_mean(name, [*numbers, schema.NONE]))
    if name not in numbers:
        raise table.refusal(name, f"{name} is not a number", f"remove {name}")


def _room(rows: Sequence[Mapping[str, Value]]) -> Room:
    """Where numbers must stay so that light is born in the crystal, on its window, in all rows."""
    room = dict[str, tuple[float, float]]()
    for inner, outer in ((SOURCE_Z, HEIGHT), (WIDTH, _WINDOW), (_DIAMETER, _WINDOW)):
        both = [(float(r[inner]), float(r[outer])) for r in rows if {inner, outer} <= r.keys()]
        if both and all(least <= most for least, most in both):
            inners, outers = zip(*both, strict=True)
            room[inner], room[outer] = (0.0, min(outers)), (max(inners), math.inf)
    return room


def _usual(scene: SceneFile, room: Room, part: BenchNumber) -> Tolerance | None:
    """What is usual of a number of its kind; None of other kinds."""
    name, value = part.parameter, part.value
    assert value is not None  # of a column, or the scene's own
    if part.is_index:
        named = scene.materials.get(name)
        own = named is not None and named.value == value
        sigma = named.material.sigma or INDEX if named is not None and own else INDEX
    elif name.endswith("reflectance"):
        sigma = REFLECTANCE
    elif name.endswith("_mm"):
        thin = any(word in name for word in THIN)
        sigma = GAP_PART * value if thin else max(LENGTH_PART * value, LENGTH_MM)
    else:
        return None
    for less in _NEAR_AN_END:
        farthest = _farthest(room, part, less * sigma)
        if sigma > 0.0 and -farthest[0] >= _POSSIBLE * less * sigma <= farthest[1]:
            return Tolerance(part, value, less * sigma, farthest, given=False)
    return None


def _given(table: TomlTable, room: Room, part: BenchNumber, sigma: float) -> Tolerance | None:
    """What the campaign says of a number; None where it is exact.

    Refuses an uncertainty by which the number would be impossible.
    """
    name, value = part.parameter, part.value
    assert value is not None  # of a column, or the scene's own
    if sigma < 0.0:
        mend = "give the standard uncertainty, or 0: it is exact then"
        raise table.refusal(name, f"the uncertainty {sigma:g} of {name} is below 0", mend)
    # how far a place is off from a zero that is not well known may take some rows past an end
    of_place = name == SOURCE_Z
    for end in (value - _POSSIBLE * sigma, value + _POSSIBLE * sigma)[of_place:]:
        if (why := judge(name, end)) is not None:
            problem = f"{name} = {value:g} ± {sigma:g} reaches {end:g}: {why[1]}"
            raise table.refusal(name, problem, "give a smaller uncertainty")
    return Tolerance(part, value, sigma, _farthest(room, part, sigma)) if sigma else None


def _farthest(room: Room, part: BenchNumber, sigma: float) -> tuple[float, float]:
    """How far a number may be off where it is wrong, below and above; 0: not at all."""
    name, value = part.parameter, part.value
    assert value is not None  # of a column, or the scene's own
    far = max(_WRONG_BY * sigma, _OTHER_INDEX if part.is_index else 0.0)
    ends = []
    for most in (-min(far, _MOST_LESS * value) if value > 0.0 else -far, far):
        shares = (1.0, 0.7, 0.5, 0.4, 0.3, 0.2)
        possible = (share for share in shares if judge(name, value + share * most) is None)
        ends.append(round(next(possible, 0.0) * most, 12))
    low, high = room.get(name, (-math.inf, math.inf))
    return max(ends[0], low - value), min(ends[1], high - value)
