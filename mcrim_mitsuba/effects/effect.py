"""What a physical effect of the catalogue is: data plus one small piece of code."""

from __future__ import annotations

import functools
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, ParamSpec

import numpy as np

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value, said, unit_of, without_unit
from mcrim_mitsuba.core.run import OWN_MODULES
from mcrim_mitsuba.scene.check_text import is_filled
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.spectrophotometer import GAP_INDEX

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
#: Before the name of a number of the bench, as the name of the effect that it is wrong.
WRONG = "wrong:"
#: Today's names of effects, and of their parameters, by those that older files and commands have.
OLD_NAMES = {"saturation": "nonlinearity"}
#: By family of effects the part of the bench that they change, after its sign.
_GROUPS = {
    "source": "✦ source",
    **dict.fromkeys(("bulk", "light"), "◆ crystal"),
    "surface": "▨ surface",
    "gap": "≡ gap",
    **dict.fromkeys(("housing", "alignment"), "⌂ surroundings"),
    **dict.fromkeys(("detector reflects", "detector accepts"), "◉ detector"),
    **dict.fromkeys(("readings", "beam"), "∿ readings"),
}
_COORDINATES = ("linear", "reciprocal", "logarithmic")

Columns = Mapping[str, np.ndarray]
Values = Mapping[str, float]
Parameters = Mapping[str, Value]
Weight = Callable[[Columns, Values, Parameters], np.ndarray]


def with_new_names(content: Any) -> Any:
    """A name as it is today; of documents all keys, all in lists, and texts under ``effect``."""
    if isinstance(content, dict):
        return {
            # both are left where both are given, for others to refuse
            key if OLD_NAMES.get(key) in content else OLD_NAMES.get(key, key): (
                text if isinstance(text, str) and key != "effect" else with_new_names(text)
            )
            for key, text in content.items()
        }
    if isinstance(content, (list, tuple)):
        return list(map(with_new_names, content))
    return OLD_NAMES.get(content, content) if isinstance(content, str) else content


@dataclass(frozen=True)
class Rows:
    """What effects of the readings may know of these besides their signals, all float64 or bool."""

    #: (readings,) float64: When each was read, from -1/2, the first row of the file, to 1/2, the
    #: last. Rows of light count, used or not; what will be measured next comes with the last one.
    position: np.ndarray
    #: (readings,) bool: Whether its crystal is another piece: its size is not the scene's.
    other_sample: np.ndarray
    #: (readings,) float64: Energy of its line over that of the light yield, or of the first row.
    energy_ratio: np.ndarray = field(default_factory=lambda: np.ones(1))


#: Readings, and their derivatives by signal and by the effect's value, all of the signals' shape.
Predicted = tuple[np.ndarray, np.ndarray, np.ndarray]
Reading = Callable[[np.ndarray, float, Rows], Predicted]


def filled(parameters: Mapping[str, Value]) -> bool:
    """Whether a configuration's gap holds a liquid or gel: its nominal ``n_gap`` tells."""
    return is_filled(float(parameters["n_gap"]))


@dataclass(frozen=True, kw_only=True)
class EffectParameter:
    """A number that says how large an effect is; ValueError if its fields contradict each other."""

    #: The scene's ``<default>`` (or, for readings, the campaign's parameter).
    name: str
    #: In words, as the comment of the ``<default>`` has it; what is plausible, too.
    meaning: str
    #: The range in which the effect is defined and fitted; usual effects begin at 0.
    minimum: float = 0.0
    maximum: float
    #: Where a fit begins, and what `add` writes unless told otherwise.
    start: float
    #: "mm" or "1/cm": the one that its name ends in, unless given; empty: a pure number.
    unit: str = ""
    #: The value at which the effect is not there; infinite where only 1/value reaches it; None:
    #: no value is like that.
    absent: float | None = 0.0
    #: Lowest and highest value that a laboratory usually meets.
    plausible: tuple[float, float]
    #: Rising values at which responses are computed, `absent` left out.
    nodes: tuple[float, ...]
    #: The value that takes it out of a scene, where that is none of the range; None: `absent`.
    off: float | None = None
    #: Scene parameter whose value in the scene is the absent one; all numbers here are then
    #: offsets from it.
    nominal: str | None = None
    #: In what responses are smooth: "linear", the value; "reciprocal", 1 / (value + scale);
    #: "logarithmic", log(1 + value / scale).
    coordinate: str = "linear"
    #: Of these coordinates, in the parameter's unit.
    scale: float = 1.0
    #: Whether responses bend sharply somewhere: cubics from node to node join the nodes then, not
    #: one polynomial.
    kinked: bool = False
    #: ``limits(scene parameters)`` -> lowest and highest value that a bench takes, where its
    #: dimensions allow less than the range.
    limits: Callable[[Mapping[str, Value]], tuple[float, float]] | None = None
    #: ``plausible_beside(signals)`` -> what is plausible beside readings of light, in their unit,
    #: where that depends on them.
    plausible_beside: Callable[[np.ndarray], tuple[float, float]] | None = None
    #: ``range_beside(signals)`` -> minimum and maximum beside such readings, where that depends on
    #: their unit.
    range_beside: Callable[[np.ndarray], tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        """Refuse (ValueError) what makes no sense in a catalogue, before anything is simulated."""
        object.__setattr__(self, "unit", self.unit or unit_of(self.name) or "")
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"the parameter's name {self.name!r} is not letters, digits and _")
        if "--" in self.meaning:
            raise ValueError(f"the meaning of {self.name} contains --, which ends an XML comment")
        if not self.minimum <= self.start <= self.maximum or self.minimum == self.maximum:
            raise ValueError(f"{self.name}: start must lie between minimum and maximum")
        low, high = self.plausible
        if not self.minimum <= low < high <= self.maximum:
            raise ValueError(f"{self.name}: plausible must rise, between minimum and maximum")
        inside = all(self.minimum <= node <= self.maximum for node in self.nodes)
        if not inside or list(self.nodes) != sorted(set(self.nodes)) or self.absent in self.nodes:
            problem = f"{self.name}: nodes must rise, between minimum and maximum, without absent"
            raise ValueError(problem)
        if self.coordinate not in _COORDINATES:
            raise ValueError(f"{self.name}: coordinate is not one of {', '.join(_COORDINATES)}")

    def coordinate_of(self, value: float) -> float:
        """Where a value lies on the axis of interpolation."""
        return self.coordinate_and_slope(value)[0]

    def coordinates_of(self, values: np.ndarray) -> np.ndarray:
        """`coordinate_of` many values."""
        if self.coordinate == "reciprocal":
            return 1.0 / (values + self.scale)
        return np.log1p(values / self.scale) if self.coordinate == "logarithmic" else values

    def coordinate_and_slope(self, value: float) -> tuple[float, float]:
        """`coordinate_of`, and its derivative."""
        if self.coordinate == "reciprocal":
            coordinate = 1.0 / (value + self.scale)
            return coordinate, -(coordinate**2)
        if self.coordinate == "logarithmic":
            return math.log1p(value / self.scale), 1.0 / (self.scale + value)
        return value, 1.0

    def origin(self, parameters: Mapping[str, Value]) -> float:
        """What the numbers here count from; KeyError if the scene lacks the nominal parameter."""
        return 0.0 if self.nominal is None else float(parameters[self.nominal])

    def range_in(self, parameters: Mapping[str, Value]) -> tuple[float, float, float]:
        """Start, minimum and maximum as the scene's parameter takes them, offsets added.

        Raises KeyError if the scene, which is without the effect, lacks the nominal parameter.
        """
        zero = self.origin(parameters)
        # without the noise of binary sums: 2.01 + 0.03 is 2.04
        numbers = self.start, self.minimum, self.maximum
        start, low, high = (round(zero + value, 12) if zero else value for value in numbers)
        return start, low, high

    def plausible_in(self, parameters: Mapping[str, Value]) -> tuple[float, float]:
        """What a laboratory usually meets, as the scene's parameter takes it.

        `parameters` are the scene's, where numbers are offsets from one of them.
        """
        zero, (low, high) = self.origin(parameters), self.plausible
        return zero + low, zero + high

    def beside(self, signals: np.ndarray) -> EffectParameter:
        """It with what is possible and plausible beside readings of light, (readings,) float64."""
        low, high, usual = self.minimum, self.maximum, self.plausible
        if self.range_beside is not None:
            low, high = self.range_beside(signals)
        if self.plausible_beside is not None:
            usual = self.plausible_beside(signals)
        least, most, start = np.clip([*usual, self.start], low, high).tolist()
        return replace(self, minimum=low, maximum=high, plausible=(least, most), start=start)

    def comment(self) -> str:
        """The words beside its ``<default>``: meaning, unit, range."""
        unit = f", {self.unit}" if self.unit else ""
        if not math.isfinite(self.maximum - self.minimum):
            return self.meaning + unit
        return f"{self.meaning}{unit}: {self.minimum:g} to {self.maximum:g}"


_Fields = ParamSpec("_Fields")


def _alone(make: Callable[_Fields, EffectParameter]) -> Callable[_Fields, tuple[EffectParameter]]:
    """What makes a parameter, as what makes a tuple of it alone."""
    return lambda *given, **fields: (make(*given, **fields),)


#: `Effect.parameters` of an effect that has one; takes the fields of an `EffectParameter`.
one_parameter = _alone(EffectParameter)


@dataclass(frozen=True)
class BenchNumber:
    """A number of the bench: a scene parameter, or one of its values where readings differ."""

    parameter: str
    #: None: all of them.
    value: float | None = None

    @property
    def name(self) -> str:
        """``n_window``; of one value of several ``aperture_radius_mm=7``."""
        return self.parameter if self.value is None else f"{self.parameter}={self.value:g}"

    @property
    def words(self) -> str:
        """``window index``; ``mask radius 7 mm``."""
        if self.value is None:
            return without_unit(self.parameter)
        return said(self.parameter, self.value)

    @property
    def is_index(self) -> bool:
        """Whether it is an index of refraction."""
        return self.parameter.startswith("n_")

    @property
    def offset_name(self) -> str:
        """What a fitted offset of it is called: ``wrong_aperture_radius_7_offset_mm``."""
        unit = unit_of(self.parameter)
        ending = f"_{unit}" if unit == "mm" else ""
        value = "" if self.value is None else f"_{self.value:g}".translate({46: "_", 45: "m"})
        return f"wrong_{self.parameter.removesuffix(ending)}{value}_offset{ending}"

    def is_of(self, values: Mapping[str, Value]) -> bool:
        """Whether a configuration with these values has it; the index of air is known."""
        if self.parameter not in values or (self.parameter == GAP_INDEX and not filled(values)):
            return False
        return self.value is None or self.value == values[self.parameter]


@dataclass(frozen=True)
class Effect:
    """Something that the plain bench leaves out and a laboratory may meet.

    An effect enters through `edit` (it is simulated), through `weight` (photon records of a
    scene without it, or with it at `proposal`, are reweighted exactly), through `reading`
    (it acts on signals, whatever the photons did) or by a `number` that is off. One with a
    `weight` usually has an `edit` too, for people who want to see it in a scene.

    Raises ValueError if it has none of `edit`, `weight`, `colours`, `reading` and `number`, or
    contradicts itself.
    """

    #: Its id.
    name: str
    #: What it is in a few words, as in the middle of a sentence: ``air bubble in the gap``.
    title: str
    #: What happens, in a paragraph, and where to read about it.
    physics: str
    source: str
    _: KW_ONLY
    #: None: the effect is there or not.
    parameters: tuple[EffectParameter, ...] = ()
    #: Effects that cannot be there at the same time.
    excludes: tuple[str, ...] = ()
    #: Scene parameters, numbers, that its prediction reads.
    needs: tuple[str, ...] = ()
    #: Does nothing where the gap is not filled (`filled`); needs ``n_gap``.
    filled_only: bool = False
    #: Acts on transmittances only; its parameters are the spectrophotometer's.
    of_beam: bool = False
    #: ``lacks(scene)`` -> what a scene lacks for it to act on and how that is mended, in words, or
    #: None. It is no candidate there.
    lacks: Callable[[SceneFile], tuple[str, str] | None] | None = None
    #: ``there(scene)`` -> whether the scene has it; needed where no parameter tells.
    there: Callable[[SceneFile], bool] | None = None
    #: ``edit(editor)`` writes it into a scene. ``$name`` of its parameters may be used: `add`
    #: declares them.
    edit: Callable[[SceneEditor], None] | None = None
    #: Columns of photon records that its prediction needs.
    columns: tuple[str, ...] = ()
    #: ``weight(columns, values, parameters)`` -> float64 (photons,): factor on every photon's
    #: weight, from record columns, the effect's parameter values and the configuration's
    #: scene parameters.
    weight: Weight | None = None
    #: ``weighs_in(scene)`` -> whether the `weight` holds in a scene; elsewhere it is simulated.
    weighs_in: Callable[[SceneFile], bool] | None = None
    #: Parameter values at which the records to be reweighted are simulated; None: without the
    #: effect.
    proposal: Mapping[str, float] | None = field(default=None, hash=False)
    #: ``colours(values, parameters)`` -> parts of the light, which sum to 1, and factors on its
    #: alpha_scat, (colours,) float64 each: in place of a `weight`, of the same arguments.
    colours: Callable[[Values, Parameters], tuple[np.ndarray, np.ndarray]] | None = None
    #: The radius that a smaller aperture cuts at.
    mask_column: str = "mask_radius_mm"
    #: ``reading(signals, value, rows)`` -> reading, d reading / d signal, d reading / d value, all
    #: of the signals' shape, whose last axis is that of the rows; ``rows`` may be left out of what
    #: it takes. It acts on light, never on transmittances.
    reading: Reading | None = None
    #: The number of the bench whose offset its one parameter is.
    number: BenchNumber | None = None
    #: Whether a diagnosis tries it; else it acts where a campaign's ``effects`` name it.
    offered: bool = True
    #: Of several effects on the readings, that of the lower number acts first.
    order: int = 0
    #: What it is a relative of, such as ``surface`` or ``gap``: a verdict may name the family where
    #: the data cannot choose inside it.
    family: str = "others"
    #: How to look for it without any fit, in a sentence or two.
    look: str = ""
    #: Whether every bench has it: to look for it would tell nothing.
    always_there: bool = False

    @property
    def group(self) -> str:
        """The part of the bench that it changes, after a sign of one letter: ``≡ gap``."""
        return _GROUPS.get(self.family, "• others")

    def missing(self, parameters: Parameters) -> str | None:
        """A parameter that the effect needs and that a scene's, or a campaign's, lack."""
        nominal = (p.nominal for p in self.parameters if p.nominal is not None)
        needed = (*nominal, *self.needs, *(["n_gap"] if self.filled_only else []))
        return next((name for name in needed if not isinstance(parameters.get(name), float)), None)

    def beside(self, signals: np.ndarray) -> Effect:
        """The effect beside readings of light that are in use, (readings,) float64.

        What is possible and what is plausible of its parameters are then in their unit.
        """
        depends = any(p.range_beside or p.plausible_beside for p in self.parameters)
        if not len(signals) or not depends:
            return self
        return replace(self, parameters=tuple(p.beside(signals) for p in self.parameters))

    @property
    def switched_off(self) -> dict[str, float] | None:
        """Values of its parameters that take it out of a scene that has it; None: none do."""
        values = {p.name: p.absent if p.off is None else p.off for p in self.parameters}
        finite = {n: v for n, v in values.items() if v is not None and math.isfinite(v)}
        nominal = any(p.nominal is not None for p in self.parameters)
        can = self.edit is not None and values and not nominal
        return finite if can and len(finite) == len(values) else None

    def acts_in(self, scene: SceneFile) -> bool:
        """Whether a scene has what the effect acts on."""
        return self.lacks is None or self.lacks(scene) is None

    def refuse_without_part(self, scene: SceneFile) -> None:
        """Refuse (InputError) a scene that lacks what the effect acts on."""
        if self.lacks is not None and (lacking := self.lacks(scene)) is not None:
            what, mend = lacking
            raise InputError(f"{self.name} acts on {what}", mend, path=scene.path)

    def is_in(self, scene: SceneFile) -> bool:
        """Whether a scene has it already, at whatever size."""
        if self.there is not None:
            return self.there(scene)
        names = [parameter.name for parameter in self.parameters if parameter.nominal is None]
        return bool(names) and all(name in scene.parameters for name in names)

    def __post_init__(self) -> None:
        """Refuse (ValueError) what makes no sense; a function of the reading gets all arguments."""
        object.__setattr__(self, "excludes", tuple(with_new_names(self.excludes)))
        if self.number is None and not _NAME.fullmatch(self.name):
            raise ValueError(f"the name {self.name!r} is not letters, digits and _")
        acts = (self.edit, self.weight, self.colours, self.reading, self.number)
        if all(act is None for act in acts):
            problem = "has none of edit, weight, colours and reading: it does nothing"
            raise ValueError(f"{self.name} {problem}")
        for parameter in self.parameters:
            if not isinstance(parameter, EffectParameter):
                raise ValueError(f"{self.name}: parameters must be a tuple of EffectParameter")
        if self.reading is not None:
            if len(self.parameters) != 1:
                raise ValueError(f"{self.name}: an effect of the readings has one parameter")
            given = inspect.signature(self.reading).parameters.values()
            taken = sum(argument.kind is not argument.KEYWORD_ONLY for argument in given)
            # a copy of an effect has been here before
            if taken == 2 and getattr(self.reading, "func", None) is not _of_signal_alone:
                of_signal = functools.partial(_of_signal_alone, self.reading)
                functools.update_wrapper(of_signal, self.reading)
                object.__setattr__(self, "reading", of_signal)
            elif taken not in (2, 3):
                problem = "its reading must take signals and value, and may take rows"
                raise ValueError(f"{self.name}: {problem}")
        if self.proposal is not None and set(self.proposal) != {p.name for p in self.parameters}:
            raise ValueError(f"{self.name}: proposal must give each of its parameters a value")


def _of_signal_alone(
    reading: Callable[..., Predicted], signals: np.ndarray, value: float, rows: Rows
) -> Predicted:
    """What an effect does that need not know when a row was read."""
    return reading(signals, value)


def weight_of_reflections(
    columns: Columns,
    values: Values,
    parameters: Parameters,
    *,
    column: str,
    name: str,
    simulated_at: float,
    then_absorbed: bool,
) -> np.ndarray:
    """(rho / simulated rho)^m of m reflections off something, counted in a column of the records.

    `name` is the parameter rho, or the like. Where photons end in what reflects (`then_absorbed`),
    times (1 - rho) / (1 - simulated rho).
    """
    reflectance = values[name]
    ratio = (reflectance / simulated_at) ** columns[column].astype(np.float64)
    return (1.0 - reflectance) / (1.0 - simulated_at) * ratio if then_absorbed else ratio


def reflections(
    name: str, column: str, simulated_at: float, *, then_absorbed: bool = False
) -> dict[str, Any]:
    """Fields of an effect that reflects a part `name` of light, as of `weight_of_reflections`."""
    further: dict[str, Any] = {"simulated_at": simulated_at, "then_absorbed": then_absorbed}
    weight = functools.partial(weight_of_reflections, name=name, column=column, **further)
    return {"columns": (column,), "weight": weight, "proposal": {name: simulated_at}}


def function_of(act: Callable[..., Any]) -> Callable[..., Any]:
    """The function behind what an effect does, which may have some of its arguments already."""
    function = inspect.unwrap(act)
    return getattr(function, "func", function)


def modules_of(effects: Iterable[Effect]) -> set[str]:
    """Where effects are written: the modules of their functions, or a user's own files."""
    acts = [act for e in effects for act in (e.edit, e.weight, e.colours, e.reading) if act]
    functions = list(map(function_of, acts))
    # several folders may have files of one name
    files = {f.__globals__["__file__"] for f in functions if f.__module__.startswith(OWN_MODULES)}
    return files | {f.__module__ for f in functions if not f.__module__.startswith(OWN_MODULES)}
