"""Edits the text of a scene so that everything that is not touched stays byte for byte.

Parts of the bench are found by what they are (the crystal is what the scintillation emitter
names), not by their ids. Edits are collected, and made together by `SceneEditor.finished`.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

from lxml import etree

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import Value, value_text
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import (
    Node,
    SceneParts,
    Span,
    comment_after,
    comment_before,
    parse_scene_xml,
    spans_of,
)

_BYTE_ORDER_MARK = "\ufeff"
#: What may be above the first comment or element.
_HEAD = re.compile(rf"{_BYTE_ORDER_MARK}?\s*(?:<\?xml.*?\?>)?\s*", re.DOTALL)
_ENCODING = re.compile(r"encoding\s*=\s*[\"']([^\"']+)[\"']")
_ATTRIBUTE = re.compile(r"\s*([^\s=/>]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_READABLE = ("utf-8", "utf8", "us-ascii", "ascii")
#: Bsdfs that are a clear interface with an index on either side.
INTERFACES = ("dielectric", "polish")
#: Their indices, behind the face and in front of it.
INDICES = ("int_ior", "ext_ior")


#: Elements and comments, and where they stand in a text.
_Spans = Mapping[etree._Element, Span]


class _Piece(NamedTuple):
    """A stretch of a file: ``text[start:end]`` of the file at `path`."""

    path: Path
    text: str
    start: int
    end: int


class SceneEditor(SceneParts):
    """A scene's text, the parts of the bench in it, and the changes to be made.

    Included files are seen as if they stood in the scene. If a change touches what stands in an
    included file, that file's content takes the place of its ``<include>``; otherwise includes
    stay what they are. XML that is put in is written with ``\\n`` and two blanks per level; it
    gets the line ends and the indentation of its new place.

    `values` are those of the effect's parameters, `root` is ``<scene>`` with ``$name`` as written.

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
        super().__init__(parse_scene_xml(self._text.encode(), scene.path))
        # as keys the elements stay the same objects, see `SceneFile`
        self._spans = spans_of(self.root, self._text)
        self._splices: list[tuple[int, int, str]] = []
        # what goes to the beginning of an element, and to its end
        self._inner: dict[Node, tuple[list[str], list[str]]] = {}
        self._resolved: dict[tuple, dict[Node, Node]] = {}
        self._newline = "\r\n" if "\r\n" in self._main else "\n"
        # the blanks of one level
        self._unit = next(map(self._indentation, self.root.elements), None) or "  "

    # ------------------------------- finding parts of the bench -------------------------------

    def _beside(self, shapes: list[Node], *without: Node) -> list[Node]:
        """Media that shapes border, each once, those known already left out."""
        media = {medium for shape in shapes for medium in self.media(shape)}
        return [medium for medium in media if medium is not None and medium not in without]

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
                        return number.attrib["value"]
        problem = "no interface says the index of what is before the detector"
        raise self.refusal(problem, "name the window's medium on its faces", detector)

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
                    worn = f"{bsdf.label} is worn by {shape.label} too"
                    mend = "give the crystal's faces a bsdf of their own"
                    raise self.refusal(f"{worn}, which is no face of the crystal", mend, bsdf)
        return list(interfaces)

    def resolved(self, overrides: Mapping[str, Value] | None = None) -> dict[Node, Node]:
        """Every element with ``$name`` put in, at other parameters perhaps."""
        key = tuple(sorted((overrides or {}).items()))
        if key not in self._resolved:
            scene = self.scene.with_overrides(overrides) if overrides else self.scene
            nodes = (node for node in self.root.iter(etree.Element) if node.tag != "default")
            self._resolved[key] = dict(zip(nodes, scene.root.iter(etree.Element), strict=True))
        return self._resolved[key]

    # ------------------------------------- changing them --------------------------------------

    def source(self, node: Node) -> str:
        """The text of a node, as `insert_after` takes it."""
        span = self._spans[node]
        text = self._text[span.start : span.end].replace("\r\n", "\n")
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
        position = self._spans[node].start + 1 + len(str(node.tag))
        while match := _ATTRIBUTE.match(self._text, position):
            if match.group(1) == name:
                start, end = match.span(2)
                self._splices.append((start + 1, end - 1, escape(value, {'"': "&quot;"})))
                return
            position = match.end()
        raise KeyError(name)

    def insert_first(self, node: Node, xml: str) -> None:
        """Put XML at the beginning of an element; several in the order of the calls."""
        self._inner.setdefault(node, ([], []))[0].append(xml)

    def insert_last(self, node: Node, xml: str) -> None:
        """Put XML at the end of an element; several in the order of the calls."""
        self._inner.setdefault(node, ([], []))[1].append(xml)

    def insert_after(self, node: Node, xml: str) -> None:
        """Put XML after an element, with a blank line between if there is one before it."""
        end = self._end_with_comment(node)
        indentation = self._indentation(node)
        if indentation is None:
            self._splices.append((end, end, xml))
            return
        between = self._text[: _start_with_comment(self._spans, node)]
        blank = "\n" if between[len(between.rstrip()) :].count("\n") > 1 else ""
        self._splices.append((end, end, f"{blank}\n" + self._block(xml, indentation)))

    def insert_shape(self, xml: str, after: Node) -> None:
        """Put a shape after another one; at the scene's end if that one is included."""
        self.insert_after(after if self._is_in_scene_itself(after) else self.root.elements[-1], xml)

    def replace(self, node: Node, xml: str) -> None:
        """Put XML in the place of an element (or of a comment)."""
        span, block = self._spans[node], self._block(xml, self._indentation(node) or "")
        self._splices.append((span.start, span.end, block.lstrip(" \t")))

    def remove(self, node: Node) -> None:
        """Take an element out, and the blanks before it."""
        span = self._spans[node]
        self._splices.append((len(self._text[: span.start].rstrip()), span.end, ""))

    def declare(self, name: str, value: float | str, comment: str) -> None:
        """Add a ``<default>`` at the end of the scene's own first block of them."""
        xml = f'<!-- {escape(comment)} -->\n<default name="{name}" value="{value_text(value)}"/>'
        last: Node | None = None
        for node in self.root.elements:
            if node.tag != "default" or not self._is_in_scene_itself(node):
                break
            last = node
        if last is None:
            self.insert_first(self.root, xml)
        else:
            end = self._end_with_comment(last)
            indented = self._block(xml, self._indentation(last) or self._unit)
            self._splices.append((end, end, f"\n{indented}"))

    def set_default(self, name: str, value: float | bool | str) -> None:
        """Give a declared parameter another value, in the scene itself."""
        node = self.default(name)
        if self._is_in_scene_itself(node):
            self.set_attribute(node, "value", value_text(value))
        else:
            # an included file's: the first default wins, so one above it does
            self.declare(name, value, self.scene.defaults[name].comment or name)

    def default(self, name: str) -> Node:
        """The ``<default>`` that a parameter's value comes from; KeyError if there is none."""
        for node in self.root.iter("default"):
            if node.get("name") == name:
                return node
        raise KeyError(name)

    def reword(self, node: Node, old: str, new: str) -> None:
        """Replace words, if they are there, in the comment before an element."""
        before: etree._Element | None = node.getprevious()
        if isinstance(before, etree._Comment):
            place = self._text.find(old, *self._spans[before][::3])
            if place >= 0:
                self._splices.append((place, place + len(old), new))

    def set_comment(self, node: Node, words: str) -> None:
        """Give the comment directly above an element, if there is one, other words."""
        start = _start_with_comment(self._spans, node)
        if start < self._spans[node].start:
            self._splices.append((start, self._text.index("-->", start) + 3, f"<!-- {words} -->"))

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
            # included files cannot be written into the scene where their own paths would change
            path, line = self._place(splices[mapped.index(None)][0])
            home = self.scene.path.parent.resolve()
            if any(piece.path.parent.resolve() != home for piece in self._pieces):
                problem = f"what the effect changes is in this file, which {self.scene.path.name} "
                mend = "add the effect to this file, or move it beside the scene"
                raise InputError(f"{problem}includes", mend, path=path, line=line)
            text, places = self._text, [(start, end) for start, end, _ in splices]
        for (start, end), (_, _, new) in list(zip(places, splices, strict=True))[::-1]:
            text = text[:start] + new.replace("\n", self._newline) + text[end:]
        return text

    def refusal(self, problem: str, mend: str, node: Node | None = None) -> InputError:
        """The error to raise about an element, with its file and line."""
        if node is None:
            return InputError(problem, mend, path=self.scene.path)
        path, line = self._place(self._spans[node].start)
        return InputError(problem, mend, path=path, line=line)

    # ----------------------------------- text and positions -----------------------------------

    def _flatten(self, path: Path, declared: set[str]) -> Iterator[_Piece]:
        """A file in pieces, those of included files in place of their ``<include>``.

        Defaults that have lost against one of the same name before them are left out.
        """
        text, root = _text_of(self.scene, path), parse_scene_xml(self.scene.source(path), path)
        spans = spans_of(root, text)
        place, end, head = 0, len(text), _HEAD.match(text)
        if path != self.scene.path:
            # the comments above <scene>, and what is in it
            span, place = spans[root], head.end() if head else 0
            above = text[place : span.start].rstrip()
            content = text[span.inside : span.close].rstrip()
            yield _Piece(path, text, place, place + len(above))
            place, end = span.inside, span.inside + len(content)
            if not above:
                place += len(content) - len(content.lstrip())
        for node in root.iter("default", "include"):
            if node.tag == "include":
                yield _Piece(path, text, place, spans[node].start)
                if "$" in (name := node.attrib["filename"]):
                    problem = f"the name {name} of an included file is a parameter"
                    line = node.sourceline
                    raise InputError(problem, "write the name itself", path=path, line=line)
                yield from self._flatten(path.parent / name, declared)
            elif (name := node.get("name", "")) not in declared:
                declared.add(name)
                continue
            else:
                start = len(text[: _start_with_comment(spans, node)].rstrip())
                yield _Piece(path, text, place, max(place, start))
            place = spans[node].end
        yield _Piece(path, text, place, end)

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

    def _is_in_scene_itself(self, node: Node) -> bool:
        """Whether an element stands in the scene's own file."""
        return self._in_scene_itself(*self._spans[node][::3]) is not None

    def _insertions(self) -> Iterator[tuple[int, int, str]]:
        """Splices of what goes into elements."""
        for node, (first, last) in self._inner.items():
            if not node.elements:
                yield self._filled(node, "\n".join([*first, *last]))
                continue
            begin, end = node.elements[0], node.elements[-1]
            for parts, beside, place in (
                (first, begin, self._spans[node].inside),
                (last, end, self._end_with_comment(end)),
            ):
                if parts:
                    inner = self._indentation(beside)
                    lines = "" if inner is None else "\n" + self._block("\n".join(parts), inner)
                    yield place, place, lines or "".join(parts)

    def _filled(self, node: Node, xml: str) -> tuple[int, int, str]:
        """The splice that gives an element without elements a content."""
        span, indentation = self._spans[node], self._indentation(node)
        block = xml if indentation is None else f"\n{self._block(xml, indentation + self._unit)}"
        after = "" if indentation is None else f"\n{indentation}"
        if span.inside < span.end:
            # a comment may be in it, and blanks
            return len(self._text[: span.close].rstrip()), span.close, block + after
        start = len(self._text[: span.end - 2].rstrip())
        return start, span.end, f">{block}{after}</{node.tag!s}>"

    def _block(self, xml: str, indentation: str) -> str:
        """XML with the scene's indentation."""
        lines = []
        for line in xml.split("\n"):
            levels = (len(line) - len(line.lstrip(" "))) // 2
            lines.append(indentation + self._unit * levels + line.lstrip(" ") if line else "")
        return "\n".join(lines)

    def _indentation(self, node: Node) -> str | None:
        """The blanks before a node; None if it is not the first on its line."""
        start = self._spans[node].start
        line = self._text[self._text.rfind("\n", 0, start) + 1 : start]
        return None if line.strip() else line

    def _end_with_comment(self, node: Node) -> int:
        """Where a node ends, or the comment after it on its line."""
        after = comment_after(node)
        return self._spans[node if after is None else after].end


def _start_with_comment(spans: _Spans, node: Node) -> int:
    """Where the comment directly above a node starts, or the node."""
    above = comment_before(node)
    return spans[node if above is None else above].start


def _text_of(scene: SceneFile, path: Path) -> str:
    """A file's text, byte order mark and line ends included, if it is UTF-8."""
    refused = InputError(
        "only scenes in UTF-8 can be edited", 'save it as UTF-8, with encoding="utf-8"', path=path
    )
    try:
        text = scene.source(path).decode()
    except UnicodeDecodeError:
        raise refused from None
    declared = _ENCODING.search(text, 0, text.find("?>") + 1)
    if (declared is not None and declared.group(1).lower() not in _READABLE) or "\0" in text:
        raise refused
    return text
