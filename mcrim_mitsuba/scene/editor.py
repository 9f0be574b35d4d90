"""Edits the text of a scene so that everything that is not touched stays byte for byte.

Parts of the bench are found by what they are (the crystal is what the scintillation emitter
names), not by their ids. Edits are collected, and made together by `SceneEditor.finished`.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape

import numpy as np
from lxml import etree

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value, value_text
from mcrim_mitsuba.scene.scene_file import SceneFile

_COMMENT = "!--"
_BYTE_ORDER_MARK = "\ufeff"
_DECLARATION = re.compile(r"\s*(<\?xml.*?\?>)?\s*", re.DOTALL)
_ENCODING = re.compile(r"encoding\s*=\s*[\"']([^\"']+)[\"']")
# a > within quotes does not end it
_START_TAG = re.compile(r"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>")
_ATTRIBUTE = re.compile(r"\s*([^\s=/>]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_READABLE = ("utf-8", "utf8", "us-ascii", "ascii")
#: Bsdfs that are a clear interface with an index on either side.
INTERFACES = ("dielectric", "polish")
#: Their indices, behind the face and in front of it.
INDICES = ("int_ior", "ext_ior")


@dataclass(eq=False)
class Node:
    """An element (or a comment) of the text."""

    #: ``!--`` for a comment.
    tag: str
    #: As written, ``$name`` not substituted.
    attributes: dict[str, str]
    parent: Node | None
    #: Where it begins, and where the text behind it begins.
    start: int
    #: Where its content begins and its end tag does; both `end` for ``<a/>``.
    inside: int = 0
    close: int = 0
    end: int = 0
    children: list[Node] = field(default_factory=list)

    @property
    def elements(self) -> list[Node]:
        """Children that are no comments."""
        return [child for child in self.children if child.tag != _COMMENT]

    @property
    def type(self) -> str:
        """Which plugin it is; empty for other elements."""
        return self.attributes.get("type", "")

    @property
    def label(self) -> str:
        """The element's id, or what it is."""
        return self.attributes.get("id") or f"the <{self.tag}> of type {self.type}"

    @property
    def neighbours(self) -> tuple[Node | None, Node | None]:
        """The elements or comments before and after it in its parent."""
        siblings = self.parent.children if self.parent is not None else [self]
        place, around = siblings.index(self), [None, *siblings, None]
        return around[place], around[place + 2]

    def walk(self) -> Iterator[Node]:
        """The element itself and all below it, in document order."""
        yield self
        for child in self.elements:
            yield from child.walk()

    def child(self, tag: str, **attributes: str) -> Node | None:
        """The first child element of this tag with these attributes."""
        for node in self.elements:
            if node.tag == tag and attributes.items() <= node.attributes.items():
                return node
        return None

    def named(self, name: str) -> Node | None:
        """The property of this name, whatever its kind."""
        return next((node for node in self.elements if node.attributes.get("name") == name), None)


@dataclass(frozen=True)
class _Piece:
    """A stretch of a file: ``text[start:end]`` of the file at `path`."""

    path: Path
    text: str
    start: int
    end: int


class SceneEditor:
    """A scene's text, the parts of the bench in it, and the changes to be made.

    Included files are seen as if they stood in the scene. If a change touches what stands in an
    included file, that file's content takes the place of its ``<include>``; otherwise includes
    stay what they are. XML that is put in is written with ``\\n`` and two blanks per level; it
    gets the line ends and the indentation of its new place.

    `values` are those of the effect's parameters, `root` is ``<scene>``.

    Raises InputError if a file of the scene is not UTF-8.
    """

    def __init__(self, scene: SceneFile, values: Mapping[str, float]) -> None:
        self.scene = scene
        self.values = dict(values)
        self._main = _text_of(scene, scene.path)
        self._pieces = list(self._flatten(scene.path, set()))
        # where each piece ends in the flat text
        self._ends = list(itertools.accumulate(p.end - p.start for p in self._pieces))
        self._text = "".join(piece.text[piece.start : piece.end] for piece in self._pieces)
        self.root = _parse(self._text, scene.path)
        self._splices: list[tuple[int, int, str]] = []
        self._first: dict[Node, list[str]] = {}
        self._last: dict[Node, list[str]] = {}
        self._resolved: dict[tuple, dict[Node, etree._Element]] = {}
        self._newline = "\r\n" if "\r\n" in self._main else "\n"
        # the blanks of one level
        indentations = map(self._indentation, self.root.elements)
        self._unit = next(indentations, None) or "  "

    # ------------------------------- finding parts of the bench -------------------------------

    def all(self, tag: str, plugin: str) -> list[Node]:
        """Elements of this tag and type, in document order."""
        return [node for node in self.root.walk() if node.tag == tag and node.type == plugin]

    @functools.cached_property
    def by_id(self) -> dict[str, Node]:
        """Elements by id, aliases included."""
        nodes = {}
        for node in self.root.walk():
            if "id" in node.attributes and node.tag not in ("ref", "alias"):
                nodes[node.attributes["id"]] = node
        for node in self.root.walk():
            if node.tag == "alias" and node.attributes.get("id") in nodes:
                nodes[node.attributes.get("as", "")] = nodes[node.attributes["id"]]
        return nodes

    @functools.cached_property
    def shapes(self) -> list[Node]:
        """The shapes of the scene, in their order."""
        return [node for node in self.root.elements if node.tag == "shape"]

    def targets(self, node: Node, tag: str) -> list[Node]:
        """Elements of a tag that a node holds, or points at with ``<ref>``."""
        nodes = (
            self.by_id.get(inner.attributes.get("id", "")) if inner.tag == "ref" else inner
            for inner in node.elements
        )
        return [inner for inner in nodes if inner is not None and inner.tag == tag]

    def medium(self, shape: Node, side: str) -> Node | None:
        """The medium on the ``interior`` or ``exterior`` side of a shape; None for air."""
        named = shape.named(side)
        if named is not None and named.tag == "ref":
            named = self.by_id.get(named.attributes.get("id", ""))
        return named if named is not None and named.tag == "medium" else None

    def media(self, shape: Node) -> tuple[Node | None, Node | None]:
        """Media behind and in front of a shape."""
        return self.medium(shape, "interior"), self.medium(shape, "exterior")

    def _beside(self, shapes: list[Node], *without: Node) -> list[Node]:
        """Media that shapes border, each once, those known already left out."""
        media = {medium for shape in shapes for medium in self.media(shape)}
        return [medium for medium in media if medium is not None and medium not in without]

    def bsdf(self, shape: Node) -> Node | None:
        """What a shape wears."""
        return next(iter(self.targets(shape, "bsdf")), None)

    @functools.cached_property
    def emitter(self) -> Node:
        """The scintillation, or the beam."""
        for plugin in ("scintillation", "collimated_beam"):
            for node in self.all("emitter", plugin):
                return node
        raise self.refusal("the scene has no scintillation", "add an emitter of that type")

    @functools.cached_property
    def crystal(self) -> Node:
        """The medium that scintillates."""
        media = self.targets(self.emitter, "medium")
        if len(media) != 1 or media[0].type != "bulk":
            problem = "the scintillation names no medium of type bulk"
            raise self.refusal(problem, "name the crystal's medium", self.emitter)
        return media[0]

    @functools.cached_property
    def crystal_faces(self) -> list[Node]:
        """Shapes with the crystal on one side."""
        faces = [shape for shape in self.shapes if self.crystal in self.media(shape)]
        if not faces:
            raise self.refusal("no shape borders the crystal", "name it as interior", self.crystal)
        return faces

    @functools.cached_property
    def gap(self) -> Node:
        """The medium that touches the crystal."""
        # crept up beside the crystal, the gap's liquid is a medium of its own
        beside = self._beside(self.crystal_faces, self.crystal)
        media = [medium for medium in beside if medium.named("endless") is None]
        if len(media) != 1 or media[0].type != "bulk":
            problem = f"{len(media)} media of type bulk touch the crystal"
            mend = "name the gap's medium as exterior of the crystal's bottom face"
            raise self.refusal(f"{problem}; the gap must be the only one", mend, self.crystal)
        return media[0]

    @functools.cached_property
    def window(self) -> Node:
        """The medium on the other side of the gap."""
        faces = [shape for shape in self.shapes if self.gap in self.media(shape)]
        media = self._beside(faces, self.gap, self.crystal)
        if len(media) != 1:
            problem = f"{len(media)} media touch the gap beside the crystal"
            mend = "name the window's medium as interior of its entrance face"
            raise self.refusal(f"{problem}; the window must be the only one", mend, self.gap)
        return media[0]

    @functools.cached_property
    def detectors(self) -> list[Node]:
        """The ``photodetector`` bsdfs, one for each face or shared."""
        bsdfs = self.all("bsdf", "photodetector")
        if not bsdfs:
            raise self.refusal("the scene has no photodetector", "let a shape wear one")
        return bsdfs

    def before(self, detector: Node) -> set[Node]:
        """The media before a detector; none where that is air."""
        faces = [shape for shape in self.shapes if detector in self.worn_by(shape)]
        return {medium for face in faces for medium in self.media(face) if medium is not None}

    def index_before(self, detector: Node) -> str:
        """Index of the medium before a detector, as an interface of that medium writes it."""
        media = self.before(detector)
        for shape in self.shapes:
            for index, medium in zip(INDICES, self.media(shape), strict=True):
                for bsdf in self.worn_by(shape) if medium in media else ():
                    number = bsdf.named(index) if bsdf.type in INTERFACES else None
                    if number is not None:
                        return number.attributes["value"]
        problem = "no interface says the index of what is before the detector"
        raise self.refusal(problem, "name the window's medium on its faces", detector)

    def worn_by(self, node: Node) -> list[Node]:
        """The bsdfs that a shape, or a bsdf, wears, those within them too."""
        worn = self.targets(node, "bsdf")
        return [bsdf for outer in worn for bsdf in (outer, *self.worn_by(outer))]

    @functools.cached_property
    def masks(self) -> list[Node]:
        """The ``aperture`` bsdfs."""
        return self.all("bsdf", "aperture")

    @functools.cached_property
    def crystal_polish(self) -> list[Node]:
        """The interfaces that the crystal's faces wear; no other face does."""
        interfaces: dict[Node, None] = {}
        for face in self.crystal_faces:
            bsdf = self.bsdf(face)
            inner = bsdf
            if bsdf is not None and bsdf.type == "aperture":
                inner = next(iter(self.targets(bsdf, "bsdf")), None)
            if inner is None or inner.type not in INTERFACES:
                problem = f"{face.label} does not wear a dielectric"
                raise self.refusal(problem, "only faces of plain polish can be changed", face)
            interfaces[inner] = None
        for shape in self.shapes:
            for bsdf in set(self.worn_by(shape)) & set(interfaces):
                if shape not in self.crystal_faces:
                    raise self.refusal(
                        f"{bsdf.label} is worn by {shape.label} too, which is no face of the "
                        "crystal",
                        "give the crystal's faces a bsdf of their own",
                        bsdf,
                    )
        return list(interfaces)

    def resolved(self, overrides: Mapping[str, Value] | None = None) -> dict[Node, etree._Element]:
        """Every element with ``$name`` put in, at other parameters perhaps."""
        key = tuple(sorted((overrides or {}).items()))
        if key not in self._resolved:
            flat = self.scene.edited(self._text).with_overrides(overrides or {})
            nodes = (node for node in self.root.walk() if node.tag != "default")
            elements = flat.root.iter(etree.Element)
            self._resolved[key] = dict(zip(nodes, elements, strict=True))
        return self._resolved[key]

    # ------------------------------------- changing them --------------------------------------

    def source(self, node: Node) -> str:
        """The text of a node, as `insert_after` takes it."""
        text = self._text[node.start : node.end].replace("\r\n", "\n")
        first, *lines = text.replace("\n" + (self._indentation(node) or ""), "\n").split("\n")
        for number, line in enumerate(lines):
            levels = 0
            while line.startswith(self._unit):
                levels, line = levels + 1, line[len(self._unit) :]
            lines[number] = "  " * levels + line
        return "\n".join([first, *lines])

    def refuse_id(self, name: str) -> None:
        """Refuse a scene in which the id of a new element is taken."""
        if name in self.by_id:
            mend = "the effect may be there already, or rename this"
            raise self.refusal(f"the id {name} is taken", mend, self.by_id[name])

    def set_attribute(self, node: Node, name: str, value: str) -> None:
        """Give an attribute, which must be there, another value."""
        position = node.start + 1 + len(node.tag)
        while match := _ATTRIBUTE.match(self._text, position):
            if match.group(1) == name:
                start, end = match.span(2)
                self._splices.append((start + 1, end - 1, escape(value, {'"': "&quot;"})))
                return
            position = match.end()
        raise KeyError(name)

    def insert_first(self, node: Node, xml: str) -> None:
        """Put XML at the beginning of an element; several in the order of the calls."""
        self._first.setdefault(node, []).append(xml)

    def insert_last(self, node: Node, xml: str) -> None:
        """Put XML at the end of an element; several in the order of the calls."""
        self._last.setdefault(node, []).append(xml)

    def insert_after(self, node: Node, xml: str) -> None:
        """Put XML after an element, with a blank line between if there is one before it."""
        end = self._end_with_comment(node)
        indentation = self._indentation(node)
        if indentation is None:
            self._splices.append((end, end, xml))
            return
        between = self._text[: _start_with_comment(self._text, node)]
        blank = "\n" if between[len(between.rstrip()) :].count("\n") > 1 else ""
        self._splices.append((end, end, f"{blank}\n" + self._block(xml, indentation)))

    def insert_shape(self, xml: str, after: Node) -> None:
        """Put a shape after another one; at the scene's end if that one is included."""
        is_in_scene = self._in_scene_itself(after.start, after.end) is not None
        self.insert_after(after if is_in_scene else self.root.elements[-1], xml)

    def replace(self, node: Node, xml: str) -> None:
        """Put XML in the place of an element (or of a comment)."""
        block = self._block(xml, self._indentation(node) or "")
        self._splices.append((node.start, node.end, block.lstrip(" \t")))

    def remove(self, node: Node) -> None:
        """Take an element out, and the blanks before it."""
        start = len(self._text[: node.start].rstrip())
        self._splices.append((start, node.end, ""))

    def declare(self, name: str, value: float | str, comment: str) -> None:
        """Add a ``<default>`` at the end of the scene's own first block of them."""
        xml = f'<!-- {escape(comment)} -->\n<default name="{name}" value="{value_text(value)}"/>'
        block: list[Node] = []
        for node in self.root.elements:
            if node.tag != "default" or self._in_scene_itself(node.start, node.end) is None:
                break
            block.append(node)
        if block:
            end = self._end_with_comment(block[-1])
            indented = self._block(xml, self._indentation(block[-1]) or self._unit)
            self._splices.append((end, end, f"\n{indented}"))
        else:
            self.insert_first(self.root, xml)

    def set_default(self, name: str, value: float | bool | str) -> None:
        """Give a declared parameter another value, in the scene itself."""
        node = self.default(name)
        if self._in_scene_itself(node.start, node.end) is None:
            # an included file's: the first default wins, so one above it does
            self.declare(name, value, self.scene.defaults[name].comment or name)
        else:
            self.set_attribute(node, "value", value_text(value))

    def default(self, name: str) -> Node:
        """The ``<default>`` that a parameter's value comes from; KeyError if there is none."""
        for node in self.root.walk():
            if node.tag == "default" and node.attributes.get("name") == name:
                return node
        raise KeyError(name)

    def reword(self, node: Node, old: str, new: str) -> None:
        """Replace words, if they are there, in the comment before an element."""
        before, _ = node.neighbours
        if before is not None and before.tag == _COMMENT:
            place = self._text.find(old, before.start, before.end)
            if place >= 0:
                self._splices.append((place, place + len(old), new))

    def set_comment(self, node: Node, words: str) -> None:
        """Give the comment directly above an element, if there is one, other words."""
        start = _start_with_comment(self._text, node)
        if start < node.start:
            end = self._text.index("-->", start) + 3
            self._splices.append((start, end, f"<!-- {words} -->"))

    def finished(self) -> str:
        """The new text.

        Raises InputError if what changes stands in an included file that cannot be put into the
        scene's own.
        """
        splices = sorted([*self._splices, *self._insertions()], key=lambda splice: splice[:2])
        for (_, end, _), (start, _, _) in itertools.pairwise(splices):
            if start < end:
                raise ValueError("two changes of a scene overlap")
        mapped = [self._in_scene_itself(start, end) for start, end, _ in splices]
        text, places = self._main, [place for place in mapped if place is not None]
        if None in mapped:
            self._refuse_inclusion(splices[mapped.index(None)][0])
            text, places = self._text, [(start, end) for start, end, _ in splices]
        for (start, end), (_, _, new) in list(zip(places, splices, strict=True))[::-1]:
            text = text[:start] + new.replace("\n", self._newline) + text[end:]
        return text

    def refusal(self, problem: str, mend: str, node: Node | None = None) -> InputError:
        """The error to raise about an element, with its file and line."""
        if node is None:
            return InputError(problem, mend, path=self.scene.path)
        path, line = self._place(node.start)
        return InputError(problem, mend, path=path, line=line)

    # ----------------------------------- text and positions -----------------------------------

    def _flatten(self, path: Path, declared: set[str]) -> Iterator[_Piece]:
        """A file in pieces, those of included files in place of their ``<include>``.

        Defaults that have lost against one of the same name before them are left out.
        """
        text = _text_of(self.scene, path)
        root = _parse(text, path)
        if path == self.scene.path:
            place, end = 0, len(text)
            cuts: list[tuple[int, int, Node | None]] = []
        else:
            # the comments above <scene>, and what is in it
            without_mark = text.removeprefix(_BYTE_ORDER_MARK)
            place = len(text) - len(without_mark) + len(_declaration(without_mark))
            end = len(text[: root.close].rstrip())
            cuts = [(len(text[: root.start].rstrip()), root.inside, None)]
            if place == root.start:
                content = text[root.inside :]
                cuts = [(place, root.inside + len(content) - len(content.lstrip()), None)]
        for node in root.walk():
            if node.tag == "default":
                name = node.attributes.get("name", "")
                if name in declared:
                    first = _start_with_comment(text, node)
                    cuts.append((len(text[:first].rstrip()), node.end, None))
                declared.add(name)
            elif node.tag == "include":
                cuts.append((node.start, node.end, node))
        for start, stop, include in cuts:
            yield _Piece(path, text, place, start)
            if include is not None:
                yield from self._flatten(self._included(include, path, text), declared)
            place = stop
        yield _Piece(path, text, place, end)

    def _included(self, include: Node, path: Path, text: str) -> Path:
        name = include.attributes["filename"]
        if "$" in name:
            problem = f"the name {name} of an included file is a parameter"
            line = text.count("\n", 0, include.start) + 1
            raise InputError(problem, "write the name itself", path=path, line=line)
        return path.parent / name

    def _place(self, position: int) -> tuple[Path, int]:
        """File and line of a position in the flat text."""
        for piece, end in zip(self._pieces, self._ends, strict=True):
            if position < end:
                return piece.path, piece.text.count("\n", 0, piece.end - end + position) + 1
        return self.scene.path, self._main.count("\n") + 1

    def _in_scene_itself(self, start: int, end: int) -> tuple[int, int] | None:
        """Where a stretch of the flat text stands in the scene's own file; None: not in it."""
        for piece, flat_end in zip(self._pieces, self._ends, strict=True):
            shift = piece.end - flat_end
            inside = piece.start <= start + shift and end <= flat_end
            if inside and piece.path == self.scene.path:
                return start + shift, end + shift
        return None

    def _refuse_inclusion(self, position: int) -> None:
        """Refuse to write included files into the scene where their own paths would change."""
        path, line = self._place(position)
        home = self.scene.path.parent.resolve()
        if any(piece.path.parent.resolve() != home for piece in self._pieces):
            raise InputError(
                f"what the effect changes is in this file, which {self.scene.path.name} includes",
                "add the effect to this file, or move it beside the scene",
                path=path,
                line=line,
            )

    def _insertions(self) -> Iterator[tuple[int, int, str]]:
        """Splices of what goes into elements."""
        for node in {**self._first, **self._last}:
            first, last = self._first.get(node, []), self._last.get(node, [])
            if not node.elements:
                yield self._filled(node, "\n".join([*first, *last]))
                continue
            at_end = self._end_with_comment(node.elements[-1])
            for parts, beside, place in (
                (first, node.elements[0], node.inside),
                (last, node.elements[-1], at_end),
            ):
                if parts:
                    inner = self._indentation(beside)
                    lines = "" if inner is None else "\n" + self._block("\n".join(parts), inner)
                    yield place, place, lines or "".join(parts)

    def _filled(self, node: Node, xml: str) -> tuple[int, int, str]:
        """The splice that gives an element without elements a content."""
        indentation = self._indentation(node)
        block = xml if indentation is None else f"\n{self._block(xml, indentation + self._unit)}"
        after = "" if indentation is None else f"\n{indentation}"
        if node.inside < node.end:
            # a comment may be in it, and blanks
            end = len(self._text[: node.close].rstrip())
            return end, node.close, block + after
        start = len(self._text[: node.end - 2].rstrip())
        return start, node.end, f">{block}{after}</{node.tag}>"

    def _block(self, xml: str, indentation: str) -> str:
        """XML with the scene's indentation."""
        lines = []
        for line in xml.split("\n"):
            levels = (len(line) - len(line.lstrip(" "))) // 2
            lines.append(indentation + self._unit * levels + line.lstrip(" ") if line else "")
        return "\n".join(lines)

    def _indentation(self, node: Node) -> str | None:
        """The blanks before a node; None if it is not the first on its line."""
        line = self._text[self._text.rfind("\n", 0, node.start) + 1 : node.start]
        return None if line.strip() else line

    def _end_with_comment(self, node: Node) -> int:
        """Where a node ends, or the comment after it on its line."""
        _, after = node.neighbours
        if after is not None and after.tag == _COMMENT:
            between = self._text[node.end : after.start]
            if not between.strip() and "\n" not in between:
                return after.end
        return node.end


def _start_with_comment(text: str, node: Node) -> int:
    """Where the comment directly above a node starts, or the node."""
    comment, _ = node.neighbours
    if comment is not None and comment.tag == _COMMENT:
        between = text[comment.end : node.start]
        own_line = not text[text.rfind("\n", 0, comment.start) + 1 : comment.start].strip()
        if not between.strip() and between.count("\n") == 1 and own_line:
            return comment.start
    return node.start


def _declaration(text: str) -> str:
    """``<?xml ... ?>`` at the begin of a text; empty where there is none."""
    return match.group() if (match := _DECLARATION.match(text)) else ""


def _text_of(scene: SceneFile, path: Path) -> str:
    """A file's text, byte order mark and line ends included, if it is UTF-8."""
    refused = InputError(
        "only scenes in UTF-8 can be edited", 'save it as UTF-8, with encoding="utf-8"', path=path
    )
    try:
        text = scene.source(path).decode()
    except UnicodeDecodeError:
        raise refused from None
    declared = _ENCODING.search(_declaration(text.removeprefix(_BYTE_ORDER_MARK)))
    if (declared is not None and declared.group(1).lower() not in _READABLE) or "\0" in text:
        raise refused
    return text


def _parse(text: str, path: Path) -> Node:
    """``<scene>`` of a text, with everything's position."""
    data = text.encode()
    # the parser counts bytes: the character that each begins, or belongs to
    characters = np.cumsum(np.frombuffer(data, np.uint8) & 0xC0 != 0x80) - 1
    parser = expat.ParserCreate()
    top = Node("", {}, None, 0)
    stack = [top]

    def place() -> int:
        return int(characters[parser.CurrentByteIndex])

    def start(tag: str, attributes: dict[str, str]) -> None:
        node = Node(tag, attributes, stack[-1], place())
        tag_text = _START_TAG.match(text, node.start)
        assert tag_text is not None  # the parser has just read one
        node.inside = tag_text.end()
        stack[-1].children.append(node)
        stack.append(node)

    def end(_tag: str) -> None:
        node = stack.pop()
        if text.endswith("/>", 0, node.inside):
            node.close = node.end = node.inside
        else:
            node.close = place()
            node.end = text.index(">", node.close) + 1

    def comment(_words: str) -> None:
        node = Node(_COMMENT, {}, stack[-1], place())
        node.inside = node.close = node.end = text.index("-->", node.start) + 3
        stack[-1].children.append(node)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CommentHandler = comment
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        # libxml2, which read the scene, takes more letters for those of names
        raise InputError(
            f"this scene cannot be edited: {expat.ErrorString(error.code)}",
            "write names of elements and attributes in letters, digits and _",
            path=path,
            line=error.lineno,
            column=error.offset + 1,
        ) from None
    root = top.elements[0]
    root.parent = None
    return root
