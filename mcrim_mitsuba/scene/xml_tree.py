"""The XML of a scene: one file parsed safely, with the line of every element; its words.

The words are those of the parser of Mitsuba 3.9.1. It refuses others too, but says nothing of what
was meant, and only after what is missing for a misspelt word has been found missing.
"""

from __future__ import annotations

import copy
import functools
import re
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from lxml import etree

from mcrim_mitsuba.core.errors import InputError, did_you_mean

#: Levels of elements; a bench has five.
_DEEPEST = 50
#: Tags and comments; a bench has hundreds.
_MOST_TAGS = 200_000
#: Attributes of one element; a bench's have a few.
_MOST_ATTRIBUTES = 100
_MEANT = "is this the scene you meant?"
_POSITION = re.compile(r", line \d+, column \d+$")


def parse_scene_xml(data: bytes, path: Path) -> etree._Element:
    """Root ``<scene>`` of one file's content, in any encoding; nothing outside of it is read.

    ``sourceline`` of every element is the line of its opening ``<``.

    Raises InputError if the XML is malformed (with line and column), has a DTD or entities, is
    enormous, or is not a ``<scene>`` with a version.
    """
    # whoever gets it changes it
    return copy.deepcopy(_parsed(data, path))


@functools.lru_cache(maxsize=8)
def _parsed(data: bytes, path: Path) -> etree._Element:
    """The root, of scenes that differ in their parameters once."""
    if data.count(b"<") > _MOST_TAGS:
        raise InputError(f"more than {_MOST_TAGS:,} tags", _MEANT, path=path)
    parser = etree.XMLParser(
        resolve_entities=False, load_dtd=False, no_network=True, huge_tree=False
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        message, (line, column) = error.msg or "unreadable", error.position
        problem = f"malformed XML: {_POSITION.sub('', message)}"
        mend = next(mend for words, mend in _MENDS if words in message)
        raise InputError(problem, mend, path=path, line=line, column=column) from None
    if root.getroottree().docinfo.internalDTD is not None:
        # no line in an encoding that is not a superset of ASCII
        start = data.find(b"<!DOCTYPE")
        raise InputError(
            "a DTD (<!DOCTYPE ...>) or entities are not accepted",
            "remove the declaration and write the text itself",
            path=path,
            line=None if start < 0 else data.count(b"\n", 0, start) + 1,
        )
    _mark_start_lines(root, data)
    _refuse_monsters(root, path)
    if root.tag != "scene":
        problem = f"the outermost element is <{etree.QName(root).text}>, not <scene>"
        mend = 'wrap everything in <scene version="3.0.0"> ... </scene>'
        raise InputError(problem, mend, path=path, line=root.sourceline)
    if not root.get("version"):
        mend = 'write <scene version="3.0.0">'
        raise InputError("<scene> has no version", mend, path=path, line=root.sourceline)
    return root


def _refuse_monsters(root: etree._Element, path: Path) -> None:
    """Refuse elements that are nested very deep, or have very many attributes.

    Readers go down by calling themselves, and look attributes up one by one.
    """
    depth = 0
    for event, element in etree.iterwalk(root, events=("start", "end")):
        depth += 1 if event == "start" else -1
        problem = ""
        if depth > _DEEPEST:
            problem = f"elements are nested more than {_DEEPEST} deep"
        elif len(element.attrib) > _MOST_ATTRIBUTES:
            problem = f"an element of more than {_MOST_ATTRIBUTES} attributes"
        if problem:
            raise InputError(problem, _MEANT, path=path, line=element.sourceline)


# How to mend what libxml2 complains about, by words of its complaint.
_MENDS = (
    ("encoding", 'save the file as UTF-8 and declare encoding="UTF-8"'),
    ("UTF-8", 'save the file as UTF-8 and declare encoding="UTF-8"'),
    ("Start tag expected", f"{_MEANT} It does not begin with an <element>"),
    ("attribute", "close the quotes of its attributes, perhaps on a line before"),
    ("AttValue", "put the attribute's value into quotes"),
    ("tag", "give every <element> its end: </element> or <element/>"),
    ("hyphen", "write a comment without -- in it"),
    ("", "mend the file at this place"),
)


def _mark_start_lines(root: etree._Element, data: bytes) -> None:
    """Replace ``sourceline``, where libxml2 has the end of the start tag, by its beginning."""
    lines: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError):
        return  # an encoding that only libxml2 knows: its own lines have to do
    for element, line in zip(root.iter(etree.Element), lines, strict=True):
        element.sourceline = line  # type: ignore[misc]  # lxml lets it be set


def comment_of(element: etree._Element) -> str:
    """The comment that explains an element: after it on its line, or directly before it.

    Runs of blanks are made one; empty if there is no such comment.
    """
    after = element.getnext()
    if isinstance(after, etree._Comment) and "\n" not in (element.tail or ""):
        return _words(after)
    before = element.getprevious()
    if not isinstance(before, etree._Comment) or (before.tail or "").count("\n") > 1:
        return ""
    # a comment that ends the line of another element explains that one
    neighbour: etree._Element | None = before.getprevious()
    if (
        neighbour is not None
        and not isinstance(neighbour, etree._Comment)
        and "\n" not in (neighbour.tail or "")
    ):
        return ""
    return _words(before)


def _words(comment: etree._Element) -> str:
    return " ".join((comment.text or "").split())


# Elements, their attributes, and the plugins that a bench is made of.

_PLUGINS = "bsdf emitter film integrator medium phase rfilter sampler sensor shape texture volume"
_AXES = "value x y z"
#: Attributes that an element must have, and those that it may have.
_ATTRIBUTES = {
    **dict.fromkeys(_PLUGINS.split(), ("type", "id name")),
    **dict.fromkeys(("boolean", "float", "integer", "rgb", "string"), ("name value", "")),
    **dict.fromkeys(("point", "vector"), ("name", _AXES)),
    **dict.fromkeys(("scale", "translate"), ("", _AXES)),
    "alias": ("id as", ""),
    "default": ("name value", ""),
    "include": ("filename", "name"),
    "lookat": ("origin target", "up"),
    "matrix": ("value", ""),
    "path": ("value", ""),
    "ref": ("id", "name"),
    "rotate": ("angle", _AXES),
    "spectrum": ("name", "value filename"),
    "transform": ("name", ""),
}
#: Types of plugins, this package's first, by element; those that a bench can be made of.
PLUGIN_TYPES = {
    kind: names.split()
    for kind, names in {
        "bsdf": "aperture photodetector polish conductor dielectric diffuse mask null plastic "
        "roughconductor roughdielectric thindielectric twosided",
        "emitter": "scintillation collimated_beam",
        "integrator": "light_collection",
        "medium": "bulk homogeneous heterogeneous",
        "phase": "hg isotropic rayleigh",
        "sensor": "light_meter",
        "shape": "beam_detector chamfers frame gap_sides lying_fillet lying_mantle panel polygon "
        "prism_sides round_wall wrapping cube cylinder disk obj ply rectangle sphere",
    }.items()
}
#: Of a face: where its normal comes from, and where it points to.
SIDES = ("interior", "exterior")


def misspelt(element: etree._Element) -> tuple[str, str] | None:
    """What is wrong with the words of one element, and how to mend it; None if nothing is."""
    tag = str(element.tag)
    if tag not in _ATTRIBUTES:
        return f"<{tag}> is no element of a scene", did_you_mean(tag, sorted(_ATTRIBUTES))
    needed, possible = (names.split() for names in _ATTRIBUTES[tag])
    for name in element.attrib:
        if name not in (*needed, *possible):
            problem = f"<{tag}> has no attribute {name}"
            return problem, did_you_mean(str(name), [*needed, *possible])
    for name in needed:
        if name not in element.attrib:
            return f"this <{tag}> has no {name}", f'write <{tag} {name}="...">'
    return None


def misled(root: etree._Element) -> Iterator[tuple[etree._Element, str, str]]:
    """Every ``<ref>`` to nothing, or to a volume on no side; what is wrong, how to mend it."""
    ids = {e.get("id"): str(e.tag) for e in root.iter() if e.tag not in ("ref", "alias")}
    names = {*ids, *(e.get("as") for e in root.iter("alias"))}
    of_shapes = set(root.iterfind("shape/ref"))
    for element in root.iter("ref"):
        if (name := element.get("id", "")) not in names:
            # what carries light's surfaces and volumes, not the shapes that wear them
            meant = [id_ for id_, tag in ids.items() if id_ and tag != "shape"]
            yield element, f"{name!r} is the id of nothing in this scene", did_you_mean(name, meant)
        elif ids.get(name) == "medium" and element in of_shapes:
            if (side := element.get("name", "")) not in SIDES:
                problem = f"the volume {name!r} is on no side of this shape: name={side!r}"
                yield element, problem, did_you_mean(side, SIDES)
