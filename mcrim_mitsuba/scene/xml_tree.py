"""The XML of a scene: one file parsed safely, where its elements stand, its parts; its words.

The words are those of the parser of Mitsuba 3.9.1. It refuses others too, but says nothing of what
was meant, and only after what is missing for a misspelt word has been found missing.
"""

from __future__ import annotations

import codecs
import copy
import functools
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
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
# a > within quotes does not end a tag
_MARKUP = re.compile(
    r"<!--.*?-->|<\?.*?\?>|<!\[CDATA\[.*?\]\]>|<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>", re.DOTALL
)


class Node(etree.ElementBase):
    """An element of a scene, an lxml element; ``$name`` is put in, or stands as it is written."""

    @property
    def elements(self) -> list[Node]:
        """Children that are no comments."""
        return list(self.iterchildren(etree.Element))

    @property
    def type(self) -> str:
        """Which plugin it is; empty for other elements."""
        return self.get("type", "")

    @property
    def label(self) -> str:
        """The element's id, or what it is."""
        return self.get("id") or f"the <{self.tag!s}> of type {self.type}"

    def named(self, name: str) -> Node | None:
        """The property of this name, whatever its kind."""
        return self.find(f"*[@name='{name}']")


def parse_scene_xml(data: bytes, path: Path) -> Node:
    """Root ``<scene>`` of one file's content, in any encoding; nothing outside of it is read.

    ``sourceline`` of every element is the line of its opening ``<``.

    Raises InputError if the XML is malformed (with line and column), has a DTD or entities, is
    enormous, or is not a ``<scene>`` with a version.
    """
    # whoever gets it changes it
    return copy.deepcopy(_parsed(data, path))


@functools.lru_cache(maxsize=32)
def _parsed(data: bytes, path: Path) -> Node:
    """The root, of scenes that differ in their parameters once."""
    if data.count(b"<") > _MOST_TAGS:
        raise InputError(f"more than {_MOST_TAGS:,} tags", _MEANT, path=path)
    parser: etree.XMLParser[Node] = etree.XMLParser(
        resolve_entities=False, load_dtd=False, no_network=True, huge_tree=False
    )
    parser.set_element_class_lookup(etree.ElementDefaultClassLookup(element=Node))
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
        problem = "a DTD (<!DOCTYPE ...>) or entities are not accepted"
        mend = "remove the declaration and write the text itself"
        place = None if start < 0 else data.count(b"\n", 0, start) + 1
        raise InputError(problem, mend, path=path, line=place)
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
    """Refuse elements nested very deep (readers call themselves), or of very many attributes."""
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


def _mark_start_lines(root: Node, data: bytes) -> None:
    """Replace ``sourceline``, where libxml2 has the end of the start tag, by its beginning."""
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if wide else root.getroottree().docinfo.encoding or "utf-8")
    except (LookupError, ValueError):
        return  # an encoding that only libxml2 knows: its own lines have to do
    line, counted, end = 1, 0, "\n" if "\n" in text else "\r"
    for element, span in spans_of(root, text).items():
        line, counted = line + text.count(end, counted, span.start), span.start
        element.sourceline = line  # type: ignore[misc]  # lxml lets it be set


class Span(NamedTuple):
    """Where an element, or a comment, stands in the text of its file."""

    start: int
    #: Where its content begins and its end tag does; both `end` for ``<a/>``.
    inside: int
    close: int
    #: Where the text behind it begins.
    end: int


def spans_of(root: etree._Element, text: str) -> dict[etree._Element, Span]:
    """Where elements and comments stand in the text that they were read from, in its order."""
    nodes, opened = root.iter(), list[etree._Element]()
    spans: dict[etree._Element, Span] = {}
    for mark in _MARKUP.finditer(text):
        start, end = mark.span()
        if text.startswith("</", start):
            node = opened.pop()
            spans[node] = spans[node]._replace(close=start, end=end)
        elif text[start + 1] not in "!?" or (opened and not text.startswith("<![", start)):
            node = next(nodes)
            spans[node] = Span(start, end, end, end)
            if text[start + 1] not in "!?" and text[end - 2] != "/":
                opened.append(node)
    return spans


def comment_of(element: etree._Element) -> str:
    """The comment beside an element, or directly before it, or empty; runs of blanks made one."""
    comment = comment_after(element)
    if comment is None:
        comment = comment_before(element)
    return "" if comment is None else " ".join((comment.text or "").split())


def comment_after(element: etree._Element) -> etree._Element | None:
    """The comment that ends an element's line."""
    after = element.getnext()
    beside = isinstance(after, etree._Comment) and "\n" not in (element.tail or "")
    return after if beside else None


def comment_before(element: etree._Element) -> etree._Element | None:
    """The comment directly before an element, if it does not end the line of another one."""
    before = element.getprevious()
    if not isinstance(before, etree._Comment) or (before.tail or "").count("\n") > 1:
        return None
    neighbour: etree._Element | None = before.getprevious()
    if neighbour is None or isinstance(neighbour, etree._Comment):
        return before
    return None if comment_after(neighbour) is before else before


# What the elements of a scene are to each other.


class SceneParts:
    """Shapes of a scene, what they wear and border, each where it stands or where a ref leads."""

    def __init__(self, root: Node) -> None:
        self.root = root

    def all(self, tag: str, plugin: str) -> list[Node]:
        """Elements of this tag and type, in document order."""
        return [node for node in self.root.iter(tag) if node.type == plugin]

    @functools.cached_property
    def by_id(self) -> dict[str, Node]:
        """Elements by id, aliases included."""
        others = ("ref", "alias")
        nodes = {n.get("id", ""): n for n in self.root.iter(etree.Element) if n.tag not in others}
        for alias in self.root.iter("alias"):
            if (name := alias.get("id", "")) in nodes:
                nodes[alias.get("as", "")] = nodes[name]
        nodes.pop("", None)
        return nodes

    @functools.cached_property
    def shapes(self) -> list[Node]:
        """The shapes of the scene, in their order."""
        return self.root.findall("shape")

    def target(self, node: Node) -> Node | None:
        """The element itself, or the one that a ``<ref>`` points at."""
        return self.by_id.get(node.get("id", "")) if node.tag == "ref" else node

    def targets(self, node: Node, tag: str) -> list[Node]:
        """Elements of a tag that a node holds, or points at with ``<ref>``."""
        nodes = map(self.target, node.elements)
        return [inner for inner in nodes if inner is not None and inner.tag == tag]

    def medium(self, shape: Node, side: str) -> Node | None:
        """The medium on the ``interior`` or ``exterior`` side of a shape; None for air."""
        named = shape.named(side)
        named = None if named is None else self.target(named)
        return named if named is not None and named.tag == "medium" else None

    def media(self, shape: Node) -> tuple[Node | None, Node | None]:
        """Media behind and in front of a shape."""
        return self.medium(shape, SIDES[0]), self.medium(shape, SIDES[1])

    def bsdf(self, shape: Node) -> Node | None:
        """What a shape wears."""
        return next(iter(self.targets(shape, "bsdf")), None)

    def worn_by(self, node: Node) -> list[Node]:
        """The bsdfs that a shape, or a bsdf, wears, those within them too."""
        worn = self.targets(node, "bsdf")
        return [bsdf for outer in worn for bsdf in (outer, *self.worn_by(outer))]


# Numbers of elements.


def three_numbers(element: Node, default: float) -> list[float]:
    """``x``, ``y`` and ``z`` of an element, or its ``value``, of one number or three."""
    written = [float(part) for part in element.get("value", "").replace(",", " ").split()]
    if written:
        return written * 3 if len(written) == 1 else written
    return [float(element.get(axis, default)) for axis in "xyz"]


def transform_matrix(transform: Node | None) -> np.ndarray:
    """Matrix, float64 (4, 4), of what a ``<transform>`` does, or of none, step after step.

    Raises ValueError if a step is of a kind that is not known here, or has no such numbers.
    """
    whole = np.eye(4)
    for part in () if transform is None else transform.elements:
        matrix = np.eye(4)
        if part.tag == "translate":
            matrix[:3, 3] = three_numbers(part, 0.0)
        elif part.tag == "scale":
            matrix[:3, :3] = np.diag(three_numbers(part, 1.0))
        elif part.tag == "rotate":
            # Rodrigues' formula
            (x, y, z), angle = three_numbers(part, 0.0), math.radians(float(part.get("angle", "")))
            turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            matrix[:3, :3] += math.sin(angle) * turn + (1.0 - math.cos(angle)) * turn @ turn
        elif part.tag == "matrix":
            written = [float(n) for n in part.get("value", "").replace(",", " ").split()]
            size = math.isqrt(len(written))
            matrix[:size, :size] = np.reshape(written, (size, size))
        else:
            raise ValueError(f"<{part.tag!s}> of a transform")
        whole = matrix @ whole
    return whole


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
_HOLDERS = tuple(_PLUGINS.split())
#: Elements that elements stand in, where these are not free.
_INSIDE: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("boolean", "float", "integer", "string", "transform"), _HOLDERS),
    **dict.fromkeys(("matrix", "rotate", "scale", "translate"), ("transform",)),
    "bsdf": ("scene", "bsdf", "shape"),
    "emitter": ("scene", "shape"),
    "integrator": ("scene", "integrator"),
    "medium": ("scene", "shape", "emitter", "sensor"),
    "phase": ("scene", "medium", "phase"),
    "sensor": ("scene", "shape"),
    "shape": ("scene",),
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
    """What is wrong with the words of one element, or with its place, and how to mend it."""
    tag = str(element.tag)
    if tag not in _ATTRIBUTES:
        return f"<{tag}> is no element of a scene", did_you_mean(tag, sorted(_ATTRIBUTES))
    needed, possible = (names.split() for names in _ATTRIBUTES[tag])
    for name in element.attrib:
        if name not in (*needed, *possible):
            return f"<{tag}> has no attribute {name}", did_you_mean(str(name), [*needed, *possible])
    for name in needed:
        if name not in element.attrib:
            return f"this <{tag}> has no {name}", f'write <{tag} {name}="...">'
    parent = element.getparent()
    holders = _INSIDE.get(tag)
    if parent is not None and holders is not None and parent.tag not in holders:
        mend = "put it into what it says something of"
        if holders is not _HOLDERS:
            mend = f"it belongs in {' or '.join(f'<{holder}>' for holder in holders)}: move it"
        return f"this <{tag}> stands in <{parent.tag!s}>, which has no use for it", mend
    if (twice := element.get("name")) and tag != "default":
        if any(e.get("name") == twice for e in element.itersiblings(preceding=True)):
            return f"{twice} stands here a second time", "keep one of the two"
    return None


def misled(parts: SceneParts) -> Iterator[tuple[Node, str, str]]:
    """Every ``<ref>`` to nothing, or to a volume on no side; what is wrong, how to mend it."""
    of_shapes = set(parts.root.iterfind("shape/ref"))
    for element in parts.root.iter("ref"):
        name, target = element.get("id", ""), parts.target(element)
        if target is None:
            # what carries light's surfaces and volumes, not the shapes that wear them
            meant = [id_ for id_, node in parts.by_id.items() if node.tag != "shape"]
            yield element, f"{name!r} is the id of nothing in this scene", did_you_mean(name, meant)
        elif target.tag == "medium" and element in of_shapes:
            if (side := element.get("name", "")) not in SIDES:
                problem = f"the volume {name!r} is on no side of this shape: name={side!r}"
                yield element, problem, did_you_mean(side, SIDES)
