"""What a check hands back, and what can be checked by reading: values, indices and surfaces.

A loaded Mitsuba scene keeps only the ratio of the two indices of a face, so they are read here.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from mcrim_mitsuba.core import numbers
from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import Node, misled, misspelt, three_numbers, transform_matrix

#: Index of refraction above which a volume holds a liquid or a solid.
FILLED_ABOVE = 1.0005


def is_filled(index: float) -> bool:
    """Whether a volume of this nominal index holds more than a gas."""
    return index > FILLED_ABOVE


@dataclass(frozen=True)
class SceneProblem:
    """One thing that is wrong with a scene."""

    #: ``index``, ``missing_face``, ``tilted_face``, ``leak``, ``reversed_face``, ``overlap``,
    #: ``thin_gap``, ``coefficient``, ``unit``, ``detector``, ``surface``, ``value`` or ``file``.
    kind: str
    #: What is wrong; what to do.
    text: str
    mend: str
    #: None for a file that has no name.
    path: Path | str | None
    line: int | None = None
    column: str | int | None = None

    def error(self) -> InputError:
        """The problem as the exception that the command line prints."""
        return InputError(self.text, self.mend, path=self.path, line=self.line, column=self.column)

    def __str__(self) -> str:
        return str(self.error())


@dataclass(frozen=True)
class Interface:
    """A face and what it says of its two sides."""

    #: Id of the shape.
    surface: str
    #: What light meets there.
    kind: str
    #: Volumes behind and in front of it; ``outside`` where none is named.
    interior: str
    exterior: str
    #: Refractive indices; ``None`` for surfaces that have none (detector, reflector).
    n_interior: float | None
    n_exterior: float | None
    path: Path
    #: Where the shape is written.
    line: int | None


@dataclass(frozen=True)
class CheckReport:
    """The result of `check_scene`."""

    #: Most basic first; later checks are left out where an earlier one makes them meaningless.
    problems: tuple[SceneProblem, ...]
    #: Effective scene parameters.
    parameters: dict[str, object]
    interfaces: tuple[Interface, ...] = ()
    #: What the scene means, in sentences.
    words: tuple[str, ...] = ()
    #: What is no mistake, but may not be meant.
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.problems


# The refractive indices that a scene's text gives for the two sides of every face.

#: Names that Mitsuba accepts in place of a number (its include/mitsuba/render/ior.h).
NAMED_INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.470,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "diamond": 2.419,
}
_WITH_INDICES = {"dielectric", "polish", "roughdielectric", "thindielectric"}


def _dielectric_of(file: SceneFile, shape: Node) -> Node | None:
    """The bsdf of a face that carries indices."""
    return next((bsdf for bsdf in file.parts.worn_by(shape) if bsdf.type in _WITH_INDICES), None)


def indices_of(file: SceneFile, shape: Node) -> tuple[float, float] | None:
    """Index behind and in front of a face, or ``None`` where it has none."""
    element = _dielectric_of(file, shape)
    if element is None:
        return None
    indices = []
    # Mitsuba's own defaults; `problems_of_text` tells the user to write them out.
    for side, default in (("int", "bk7"), ("ext", "air")):
        index, offset = element.named(f"{side}_ior"), element.named(f"{side}_offset")
        value = NAMED_INDICES[default]
        if index is not None:
            value = _nominal(index)
            # only the bsdf `polish` has an offset
            if offset is not None and is_filled(value):
                value += float(offset.get("value", ""))
        indices.append(value)
    return indices[0], indices[1]


def _nominal(index: Node) -> float:
    """The number of an index, or of the name in its place."""
    text = index.get("value", "")
    return NAMED_INDICES.get(text.lower(), 1.0) if index.tag == "string" else float(text)


# What is wrong with a scene, as far as its text tells.


def problems_of_text(file: SceneFile) -> list[SceneProblem]:
    """Problems seen without loading; InputError if an index or an axis is no number."""
    parameters = _problems_of_parameters(file)
    if words := _problems_of_words(file):  # what they were to say would be found missing
        return [*words, *parameters.values()]
    return [
        *parameters.values(),
        *problems_of_counted(file),
        *_problems_of_rotations(file),
        *_problems_of_spheres(file),
        *_problems_of_faces(file, {file.parameters[name] for name in parameters}),
        *_problems_of_media(file),
        *_problems_of_defaults(file),
    ]


def _problems_of_words(file: SceneFile) -> list[SceneProblem]:
    """Elements that Mitsuba does not know, or not there, ids of two, references to nothing."""
    slips = [(e, *slip) for e in file.root.iterdescendants() if (slip := misspelt(e)) is not None]
    first: dict[str, Node] = {}
    for element in file.root.iter(etree.Element):
        name = element.get("id", "") if element.tag not in ("ref", "alias") else ""
        if name and (other := first.setdefault(name, element)) is not element:
            path, line = file.place_of(other)
            text = f"the id {name!r} is given a second time (first on line {line} of {path.name})"
            slips.append((element, text, "an id is of one element: write another"))
    slips += misled(file.parts)
    return [SceneProblem("file", text, mend, *file.place_of(node)) for node, text, mend in slips]


def _problems_of_parameters(file: SceneFile) -> dict[str, SceneProblem]:
    """Scene parameters that are negative, out of range or look like another unit."""
    problems = {}
    for name, value in file.parameters.items():
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and (wrong := numbers.judge(name, float(value))) is not None:
            kind, text, mend = wrong
            what, default = f"{name} = {value:g}", file.defaults[name]
            place: tuple[Path, int | None] = default.path, default.line
            if name in file.overrides:
                what, place = f"the value given for {name} is {value:g}", (file.path, None)
            problems[name] = SceneProblem(kind, f"{what}: {text}", mend, *place)
    return problems


def detectors_of(file: SceneFile) -> list[str]:
    """Ids of the shapes that wear a photodetector."""
    parts = file.parts
    wear = (s for s in parts.shapes if any(b.type == "photodetector" for b in parts.worn_by(s)))
    return [shape.get("id", "") for shape in wear]


def problems_of_counted(file: SceneFile) -> list[SceneProblem]:
    """An integrator that is to count a detector which there is not."""
    problems = []
    for integrator in file.root.iter("integrator"):
        counted = integrator.named(numbers.COUNTED)
        names = [numbers.ALL_DETECTORS, *detectors_of(file)]
        if counted is not None and (name := counted.get("value", "")) not in names:
            text = f"{numbers.COUNTED} = {name!r} is the id of no shape that wears a photodetector"
            place = (file.path, None) if file.overrides else file.place_of(counted)
            problems.append(SceneProblem("detector", text, did_you_mean(name, names), *place))
    return problems


def _problems_of_rotations(file: SceneFile) -> Iterator[SceneProblem]:
    """Rotations whose axis is not a unit vector: Mitsuba shears and scales with them."""
    for element in file.root.iter("rotate"):
        axis = three_numbers(element, 0.0)
        length = math.hypot(*axis)
        if abs(length - 1.0) > 1e-4:
            unit = [value / length for value in axis] if length else [0.0, 0.0, 1.0]
            mended = " ".join(f'{n}="{v:.6g}"' for n, v in zip("xyz", unit, strict=False))
            what = f"the axis of this <rotate> has the length {length:.4g}"
            text = f"{what}: Mitsuba would distort the shape"
            mend = f"give it the length 1: {mended}"
            yield SceneProblem("value", text, mend, *file.place_of(element))


def _problems_of_spheres(file: SceneFile) -> Iterator[SceneProblem]:
    """Spheres that are stretched: Mitsuba knows balls alone, and would trace another shape."""
    for shape in file.parts.shapes:
        if shape.type != "sphere":
            continue
        with contextlib.suppress(ValueError):  # a step that is not known here
            axes = transform_matrix(shape.named("to_world"))[:3, :3]
            lengths = axes.T @ axes
            size = float(np.trace(lengths)) / 3.0
            if np.abs(lengths - size * np.eye(3)).max() > 1e-4 * size:
                text = f"{shape.get('id') or 'this sphere'} is stretched by its transform"
                mend = "scale x, y and z alike; an ellipsoid can be a mesh (ply)"
                yield SceneProblem("value", text, mend, *file.place_of(shape))


def _problems_of_faces(file: SceneFile, told: Collection[numbers.Value]) -> list[SceneProblem]:
    """Faces whose optical surface is missing, half written or out of range.

    What a parameter put there that is wrong, and has been told, is not told again.
    """
    problems: list[SceneProblem] = []
    for shape in file.parts.shapes:
        name = shape.get("id")
        if name and file.parts.bsdf(shape) is not None:
            if (element := _dielectric_of(file, shape)) is not None:
                problems += _problems_of_dielectric(file, element, name, told)
            continue
        text, mend = "this shape has no id", 'give it one: <shape id="...">'
        if name:
            text = f"{name} has no bsdf: Mitsuba would make it a grey diffuse reflector"
            mend = "say what light meets there, for example with a <ref/> to a dielectric"
        problems.append(SceneProblem("surface", text, mend, *file.place_of(shape)))
    # One dielectric may serve many faces: say it once.
    return list(dict.fromkeys(problems))


def _problems_of_media(file: SceneFile) -> Iterator[SceneProblem]:
    """Media whose own index, which tells whether they are air, is not that of their faces."""
    for shape in file.parts.shapes:
        face = _dielectric_of(file, shape)
        for medium, side in zip(file.parts.media(shape), ("int_ior", "ext_ior"), strict=True):
            nominal = None if medium is None else medium.named("index")
            index = None if face is None else face.named(side)
            if medium is None or nominal is None or index is None:
                continue
            if abs(_nominal(nominal) - _nominal(index)) > 1e-6:
                text = f"{medium.label} has the index {_nominal(nominal):g}, but {shape.label} "
                text += f"(line {index.sourceline}) gives it {_nominal(index):g}"
                mend = "let both name the same index"
                yield SceneProblem("index", text, mend, *file.place_of(nominal))


#: What Mitsuba takes where a plugin is not told its most important numbers, and what may be meant
#: besides.
_UNTOLD = {
    "diffuse": {"reflectance": ("0.5", "")},
    "homogeneous": {"sigma_t": ("1 per mm", ""), "albedo": ("0.75", "")},
    "hg": {"g": ("0.8", "")},
    "roughdielectric": {"alpha": ("0.1", ', or type="dielectric" for a polished face')},
}


def _problems_of_defaults(file: SceneFile) -> Iterator[SceneProblem]:
    """Plugins whose most important numbers are nowhere written."""
    for element in file.root.iter("bsdf", "medium", "phase"):
        for name, (default, besides) in _UNTOLD.get(element.type, {}).items():
            if element.named(name) is None:
                text = f"a {element.type} without {name}: Mitsuba would take {default}"
                mend = f'write <float name="{name}" value="..."/>{besides}'
                yield SceneProblem("surface", text, mend, *file.place_of(element))


def _problems_of_dielectric(
    file: SceneFile, element: Node, shape: str, told: Collection[numbers.Value]
) -> Iterator[SceneProblem]:
    """Indices of a dielectric that the scene does not write, or that no medium has."""
    who = f"bsdf {element.get('id')!r}" if element.get("id") else f"the bsdf of {shape}"
    for side, default in (("int_ior", "1.5046"), ("ext_ior", "1.000277")):
        index = element.named(side)
        if index is None:
            text = f"{who} does not say its {side}: Mitsuba would take {default}"
            mend = f'write <float name="{side}" value="..."/> (1.0 for air)'
            names = {e.get("name", ""): e for e in element.elements}
            if slip := closest(side, names.keys() - {"int_ior", "ext_ior"}):
                text, mend = f"{who} knows no {slip}", f"did you mean {side}?"
            place = file.place_of(names[slip] if slip else element)
            yield SceneProblem("index", text, mend, *place)
            continue
        if index.tag != "float":
            continue
        path, line = file.place_of(index)
        text = index.get("value", "")
        if "@" in text:
            problem = f"{who} has {side} = '{text}': only parameters can name a material"
            default = f'<default name="n_crystal" value="{text}"/>'
            mend = f"write value=\"$n_crystal\" here and '{default}' at the top"
            raise InputError(problem, mend, path=path, line=line)
        value = numbers.parse_number(side, text, path=path, line=line)
        if not 1.0 <= value <= numbers.LARGEST_INDEX and value not in told:
            text = f"{who} has {side} = {value:g}, which is no refractive index"
            mend = f"give a number from 1 to {numbers.LARGEST_INDEX:g}"
            yield SceneProblem("index", text, mend, path, line)
