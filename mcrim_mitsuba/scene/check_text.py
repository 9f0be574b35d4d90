"""What a check hands back, and what can be checked by reading: indices and surfaces of faces.

A loaded Mitsuba scene keeps only the ratio of the two indices of a face, so they are read here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import LARGEST_INDEX, parse_number
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:
    from lxml import etree


#: Index of refraction above which a volume holds a liquid or a solid.
FILLED_ABOVE = 1.0005


def is_filled(index: float) -> bool:
    """Whether a volume of this nominal index holds more than a gas."""
    return index > FILLED_ABOVE


@dataclass(frozen=True)
class SceneProblem:
    """One thing that is wrong with a scene."""

    #: ``index``, ``missing_face``, ``leak``, ``reversed_face``, ``overlap``, ``thin_gap``,
    #: ``coefficient``, ``unit``, ``detector``, ``surface``, ``value`` or ``file``.
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


def shape_elements(file: SceneFile) -> list:
    """The scene's own ``<shape>`` elements, in document order."""
    return [element for element in file.root if element.tag == "shape"]


def bsdf_of(file: SceneFile, shape: etree._Element) -> etree._Element | None:
    """The ``<bsdf>`` element that a shape wears, nested or referred to; ``None`` if it has none."""
    by_id = {e.get("id"): e for e in file.root.iter("bsdf") if e.get("id")}
    for child in shape:
        if child.tag == "bsdf":
            return child
        if child.tag == "ref" and child.get("id") in by_id:
            return by_id[child.get("id")]
    return None


def _dielectric_within(file: SceneFile, bsdf: etree._Element) -> etree._Element | None:
    """The BSDF that carries indices, the element itself or one nested in or referred to by it."""
    if bsdf.get("type") in _WITH_INDICES:
        return bsdf
    nested = bsdf_of(file, bsdf)
    return None if nested is None else _dielectric_within(file, nested)


def indices_of(file: SceneFile, shape: etree._Element) -> tuple[float, float] | None:
    """Index behind and in front of a face, or ``None`` where it has none."""
    bsdf = bsdf_of(file, shape)
    element = None if bsdf is None else _dielectric_within(file, bsdf)
    if element is None:
        return None
    found = {}
    for child in element:
        if child.get("name") in ("int_ior", "ext_ior"):
            text = child.get("value", "")
            found[child.get("name")] = (
                NAMED_INDICES.get(text.lower(), 1.0) if child.tag == "string" else float(text)
            )
    for child in element:
        # only the bsdf `polish` has these
        name, value = child.get("name", ""), child.get("value", "")
        if name in ("int_offset", "ext_offset"):
            side = name.replace("offset", "ior")
            if side in found and is_filled(found[side]):
                found[side] += float(value)
    # Mitsuba's own defaults; `problems_of_surfaces` tells the user to write them out.
    return found.get("int_ior", NAMED_INDICES["bk7"]), found.get("ext_ior", NAMED_INDICES["air"])


def problems_of_surfaces(file: SceneFile) -> list[SceneProblem]:
    """Faces whose optical surface is missing, half written or out of range.

    Raises
    ------
    InputError
        If an index is no number.
    """
    problems = []
    for shape in shape_elements(file):
        name, bsdf = shape.get("id"), bsdf_of(file, shape)
        if not name:
            text, mend = "this shape has no id", 'give it one: <shape id="...">'
            problems.append(SceneProblem("surface", text, mend, *file.place_of(shape)))
        elif bsdf is None:
            text = f"{name} has no bsdf: Mitsuba would make it a grey diffuse reflector"
            mend = "say what light meets there, for example with a <ref/> to a dielectric"
            problems.append(SceneProblem("surface", text, mend, *file.place_of(shape)))
        elif (element := _dielectric_within(file, bsdf)) is not None:
            problems += _problems_of_dielectric(file, element, name)
    # One dielectric may serve many faces: say it once.
    return list(dict.fromkeys(problems))


def _problems_of_dielectric(
    file: SceneFile, element: etree._Element, shape: str
) -> list[SceneProblem]:
    path, line = file.place_of(element)
    written = {c.get("name"): c for c in element if c.get("name") in ("int_ior", "ext_ior")}
    who = f"bsdf {element.get('id')!r}" if element.get("id") else f"the bsdf of {shape}"
    problems = []
    for side, default in (("int_ior", "1.5046"), ("ext_ior", "1.000277")):
        if side not in written:
            text = f"{who} does not say its {side}: Mitsuba would take {default}"
            mend = f'write <float name="{side}" value="..."/> (1.0 for air)'
            problems.append(SceneProblem("index", text, mend, path, line))
            continue
        if written[side].tag != "float":
            continue
        path, line = file.place_of(written[side])
        text = written[side].get("value", "")
        if "@" in text:
            raise InputError(
                f"{who} has {side} = '{text}': only parameters can name a material",
                f'write value="$n_crystal" here and \'<default name="n_crystal" value="{text}"/>\''
                " at the top", path=path, line=line,
            )  # fmt: skip
        value = parse_number(side, text, path=path, line=line)
        if not 1.0 <= value <= LARGEST_INDEX:
            text = f"{who} has {side} = {value:g}, which is no refractive index"
            mend = f"give a number from 1 to {LARGEST_INDEX:g}"
            problems.append(SceneProblem("index", text, mend, path, line))
    return problems
