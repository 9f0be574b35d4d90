"""Reads a Mitsuba scene file for everyone who does not render: parameters, elements, lines.

The rules are those of Mitsuba 3.9.1 (measured): names take effect from their ``<default>``
on, in document order across ``<include>``; the first default of a name wins; an override
wins over every default. Where Mitsuba guesses in silence, this module refuses.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

from lxml import etree

from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean
from mcrim_mitsuba.core.files import (
    BYTES_PER_MB,
    is_there,
    look_around,
    path_of,
    read_bytes,
    resolved,
)
from mcrim_mitsuba.core.numbers import Value, doubts, unit_of, value_text
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.values import (
    MaterialIndex,
    is_readable,
    parse_like,
    parse_material,
    parse_value,
    refuse_misread,
    refuse_odd_blanks,
)
from mcrim_mitsuba.scene.xml_tree import Node, SceneParts, comment_of, misspelt, parse_scene_xml

_LIMIT_MB = 5
#: What few lines may grow to by includes in includes and parameters in parameters: a bench has
#: tens of files and hundreds of elements.
_MOST_FILES = 100
#: Files one in another.
_MOST_NESTED = 8
_MOST_ELEMENTS = 50_000
#: What is wrong that is told at once.
_MOST_SLIPS = 20
#: Places of parameters, and the characters that they bring.
_MOST_REFERENCES = 50_000
_MOST_CHARACTERS = 5_000_000
LARGEST_NAMED_FILE_MB = 1000
_MEANT = "is this the scene you meant?"
#: What other files of this package are, by their endings.
_OTHERS = {".toml": "a campaign", ".csv": "a table"}
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
#: Of a wrapping.
_FACES = ("top", "sides", "right", "left", "back", "front")
_REFERENCE = re.compile(rf"\$({_NAME.pattern})?")
# by parameter and text
_Indices = dict[tuple[str, str], MaterialIndex]


@dataclass(frozen=True)
class DefaultParameter:
    """One ``<default>`` of a scene."""

    #: As written in the file.
    name: str
    value: str
    #: The XML comment beside or directly above it, or empty.
    comment: str
    #: Unit that the name ends in.
    unit: str | None
    _: KW_ONLY
    #: File that holds it (an included one, perhaps).
    path: Path
    #: Line in that file.
    line: int | None


@dataclass(frozen=True, eq=False)
class SceneFile:
    """A scene with its parameters put in."""

    #: The file that was read.
    path: Path
    #: Declared parameters in document order.
    defaults: dict[str, DefaultParameter]
    #: Their values after overrides.
    parameters: dict[str, Value]
    #: Those that change something, as text; an index stays the material that was named.
    overrides: dict[str, str]
    #: Parameters in force that name a material instead of a number.
    materials: dict[str, MaterialIndex]
    #: Declared parameters that nothing uses.
    unused: tuple[str, ...]
    #: ``<scene>`` with every ``$name`` substituted, includes put in place, and without
    #: comments and ``<default>``; read it, do not change it.
    root: Node = field(repr=False)
    # lxml makes a new Python object per visit unless somebody holds the old one: as keys
    # the elements stay the same objects, so looking one up works
    _files: dict[Node, Path] = field(repr=False)
    _sources: dict[Path, bytes] = field(repr=False)
    _indices: _Indices = field(repr=False)
    _unwritten: bytes | None = field(default=None, repr=False)

    @functools.cached_property
    def parts(self) -> SceneParts:
        """What the elements of `root` are to each other."""
        return SceneParts(self.root)

    def mend_of(self, name: str) -> str:
        """What to do about a name that is none of its parameters, but perhaps a part of it."""
        return _mend_of(name, self.defaults, self._files)

    def place_of(self, element: Node) -> tuple[Path, int | None]:
        """File and line where an element of `root` starts."""
        return self._files[element], element.sourceline

    def place_of_id(self, element_id: str) -> tuple[Path, int | None]:
        """File and line of the element with this ``id``; KeyError if there is none."""
        return self.place_of(self.parts.by_id[element_id])

    def overrides_for_mitsuba(self) -> dict[str, str]:
        """Keyword arguments for ``mitsuba.load_file`` that give this same scene."""
        named = {name: value_text(index.value) for name, index in self.materials.items()}
        return {**self.overrides, **named}

    def with_overrides(self, overrides: Mapping[str, Value]) -> SceneFile:
        """The scene as read before, with more parameters changed; errors as `read_scene`."""
        all_of_them = {**self.overrides, **overrides}
        return _assemble(self.path, all_of_them, self._sources, self._indices, self._unwritten)

    def edited(self, text: str, without: Collection[str] = ()) -> SceneFile:
        """The scene with another text in the place of its file's, which stays as it is.

        Included files are those read before; errors as `read_scene`. Parameters `without` which
        the text does are not overridden any more.
        """
        data = text.encode()
        sources = {**self._sources, resolved(self.path): data}
        overrides = {name: v for name, v in self.overrides.items() if name not in without}
        return _assemble(self.path, overrides, sources, self._indices, data)

    def read_again(self) -> SceneFile:
        """The scene as its files are now; a text that was never written stays the same."""
        sources = {} if self._unwritten is None else {resolved(self.path): self._unwritten}
        return _assemble(self.path, self.overrides, sources, {}, self._unwritten)

    def is_unchanged(self) -> bool:
        """Whether it says what it said, as its files are now, blanks aside."""
        itself = None if self._unwritten is None else resolved(self.path)
        if not any(self.naming()) and not any(index.emission for index in self.materials.values()):
            # most scenes: nothing is put together again where no byte differs
            read = {resolved(path) for path in set(self._files.values())} - {itself}
            with contextlib.suppress(InputError, KeyError):  # KeyError: a link leads elsewhere now
                if all(read_bytes(path, _LIMIT_MB) == self._sources[path] for path in read):
                    return True
        return self.read_again().content_hash == self.content_hash

    def source(self, path: Path) -> bytes:
        """Content of one of its files as it was read; KeyError if it is none of them."""
        return self._sources[resolved(path)]

    @property
    def included(self) -> tuple[Path, ...]:
        """Files that it includes, and spectra that its indices are averaged over, each once."""
        spectra = [index.emission for index in self.materials.values() if index.emission]
        files = [path for path in self._files.values() if path != self.path]
        return tuple(dict.fromkeys([*files, *spectra]))

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it is made of: its own, those included, spectra, meshes; each once."""
        named = (file for _, files in self.naming() for file in files)
        return tuple(dict.fromkeys([self.path, *self.included, *self._sources, *named]))

    def naming(self) -> Iterator[tuple[Node, list[Path]]]:
        """Elements that name files (meshes, spectra), with these in Mitsuba's folders, in order."""
        home = self.path.parent
        named = [home / element.get("value", "") for element in self.root.iter("path")]
        folders = [*reversed(named), home, Path()]
        for element in self.root.iter("string", "spectrum"):
            text = element.get("value" if element.get("name") == "filename" else "filename")
            if text is not None:
                files = [folder / text for folder in folders]
                yield element, [file for file in files if is_there(file) and file.is_file()]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader must know of the scene before using numbers that rest on it."""
        useless = "is declared but never used: changing it would change nothing"
        notes = []
        for name, text in (*((n, useless) for n in self.unused), *doubts(self.parameters)):
            default = self.defaults[name]
            place = f" of {default.path.name}, line {default.line},"
            notes.append(f"{name}{'' if name in self.overrides else place} {text}")
        return tuple(notes)

    @property
    def unwritten_text(self) -> str | None:
        """The text that `edited` gave it; None if it is what its file holds."""
        return None if self._unwritten is None else self._unwritten.decode()

    def __reduce__(self) -> tuple[Callable[..., SceneFile], tuple[Any, ...]]:
        # lxml's elements cannot be pickled: the copy is put together from the same bytes
        return _assemble, (self.path, self.overrides, self._sources, self._indices, self._unwritten)

    @functools.cached_property
    def content_hash(self) -> str:
        """SHA-256 (hexadecimal) of what `root` says, whatever its blanks and attribute order.

        A sensor is no part of it: it changes nothing of what is simulated. The contents of the
        files that it names (meshes, spectra) enter as they are when this is first asked, from
        every folder in which Mitsuba may look for them.
        """
        text = etree.tostring(self.root, encoding="unicode")
        canonical = etree.canonicalize(text, strip_text=True, exclude_tags=["sensor"])
        digest = hashlib.sha256(canonical.encode())
        for element, files in self.naming():
            path, line = self.place_of(element)
            refused = functools.partial(InputError, path=path, line=line)
            for named in files:
                try:
                    if named.stat().st_size > LARGEST_NAMED_FILE_MB * BYTES_PER_MB:
                        problem = f"{named} is larger than {LARGEST_NAMED_FILE_MB} MB"
                        raise refused(problem, "is this the file you meant?")
                    with named.open("rb") as stream:
                        digest.update(hashlib.file_digest(stream, "sha256").digest())
                except OSError as error:
                    problem = f"{named} cannot be read ({error.strerror})"
                    raise refused(problem, "name another file") from None
        return digest.hexdigest()

    @property
    def says(self) -> tuple[object, ...]:
        """All that was read of it and given to it: alike in scenes that say the same."""
        given = (*self.overrides.items(),), (*self.parameters.items(),)
        return (str(self.path), *given, *self._sources.items())

    @functools.cached_property
    def text_or_hash(self) -> bytes | str:
        """Tells scenes apart as `content_hash`, and those that differ in blanks, but sooner."""
        return self.content_hash if any(self.naming()) else etree.tostring(self.root)


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """A scene with more parameters changed, put together when somebody needs it."""

    base: SceneFile
    overrides: Mapping[str, Value]

    @functools.cached_property
    def file(self) -> SceneFile:
        """The scene; errors as `SceneFile.with_overrides`."""
        return self.base.with_overrides(self.overrides)

    @property
    def path(self) -> Path:
        """Path of the file that was read."""
        return self.base.path

    def __reduce__(self) -> tuple[Callable[..., SceneFile], tuple[Any, ...]]:
        # whoever it is sent to needs the scene itself
        make, (path, overrides, *others) = self.base.__reduce__()
        return make, (path, {**overrides, **self.overrides}, *others)


def read_scene(
    path: str | Path | SceneFile, overrides: Mapping[str, Value] | None = None
) -> SceneFile:
    """Read a scene file and put its parameters in.

    Files that it includes must lie in the same folder or below it; a `SceneFile` is not read again.
    Overrides are values that win over the file's defaults.

    Raises InputError if a file cannot be read or is not a sound scene, if a ``$name`` is not
    declared before it is used, or if an override does not fit or is of a default that is not used.
    """
    if not isinstance(overrides or {}, Mapping):
        raise InputError(f"overrides are {overrides!r}", 'give a dictionary: {"n_gap": 1.46}')
    if isinstance(path, SceneFile):
        return path.with_overrides(overrides) if overrides else path
    path = path_of("the scene", path)
    if (kind := _OTHERS.get(path.suffix.lower())) and is_there(path) and path.is_file():
        raise InputError(f"this is {kind}, not a scene", "name a scene (.xml)", path=path)
    return _assemble(path, overrides or {}, {}, {})


def _mend_of(name: str, parameters: Collection[str], elements: Iterable[Node]) -> str:
    """What to do about a name that is no parameter: a part of the scene is switched otherwise."""
    shapes = [element for element in elements if element.tag == "shape"]
    wrappings = [shape for shape in shapes if shape.type == "wrapping"]
    rows = f"a column {name} of 0 and 1 in measurements does so"
    if (name in _FACES and len(wrappings) == 1) or name in {w.get("id") for w in wrappings}:
        lacking = (
            'let the wrapping have <string name="without" value="$bare"/>, write '
            '<default name="bare" value="none"/> at the top, and '
        )
        return (
            f"to take it off, {'' if 'bare' in parameters else lacking}give bare the value "
            f'"top sides" (all) or the faces that are bare; {rows}'
        )
    if name in {shape.get("id") for shape in shapes}:
        return f"it is a part: take it out of a copy of the scene; if it stands in air {rows}"
    return did_you_mean(name, parameters)


def parse_define(text: str, option: str = "-D", example: str = "n_gap=1.46") -> tuple[str, str]:
    """Split ``name=value``, what follows ``-D`` or another `option`; InputError if it is none."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not _NAME.fullmatch(name) or not value:
        mend = f"write for example {option} {example}"
        raise InputError(f"{option} {text} is not name=value", mend)
    return name, value


def _assemble(
    path: Path,
    overrides: Mapping[str, Value],
    sources: dict[Path, bytes],
    indices: _Indices,
    unwritten: bytes | None = None,
) -> SceneFile:
    """One pass through the scene; what is not in `sources` or `indices` yet is read and added."""
    texts = {name: value_text(value) for name, value in overrides.items()}
    assembly = _Assembly(path, texts, sources, indices)
    root = assembly.load(path, ())
    assembly.refuse_leftovers()
    etree.strip_elements(root, etree.Comment, etree.ProcessingInstruction, with_tail=False)
    return SceneFile(
        path,
        assembly.defaults,
        assembly.parameters,
        assembly.changed,
        assembly.materials,
        tuple(name for name in assembly.defaults if name not in assembly.used),
        root,
        _files=assembly.files,
        _sources=sources,
        _indices=indices,
        _unwritten=unwritten,
    )


@dataclass
class _Assembly:
    """State of one pass in document order, the order in which Mitsuba declares and substitutes."""

    path: Path  # the scene file itself
    overrides: dict[str, str]  # name -> text as given
    sources: dict[Path, bytes]  # resolved path -> content
    indices: _Indices
    defaults: dict[str, DefaultParameter] = field(default_factory=dict)
    parameters: dict[str, Value] = field(default_factory=dict)
    changed: dict[str, str] = field(default_factory=dict)  # overrides that differ from the default
    materials: dict[str, MaterialIndex] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # name -> text that replaces $name
    used: set[str] = field(default_factory=set)
    slips: list[InputError] = field(default_factory=list)  # what is wrong so far
    broken: set[str] = field(default_factory=set)  # names of which the default is wrong
    files: dict[Node, Path] = field(default_factory=dict)
    included: int = 0
    references: int = 0  # places of parameters, and the characters that they brought
    characters: int = 0

    def load(self, path: Path, chain: tuple[Path, ...]) -> Node:
        """Root of one file, processed; `chain` holds the files that include it."""
        key = resolved(path)
        if key not in self.sources:
            self.sources[key] = read_bytes(path, _LIMIT_MB)
        root = parse_scene_xml(self.sources[key], path)
        self.files[root] = path
        self.process(root, path, (*chain, key), {})
        return root

    def process(
        self, parent: Node, path: Path, chain: tuple[Path, ...], declared: dict[str, int | None]
    ) -> None:
        """Declare, include and substitute below `parent`; `declared`: lines in this file."""
        defaults = []
        for child in list(parent.iterchildren(etree.Element)):
            self.files[child], tag = path, child.tag
            place: dict[str, Any] = {"path": path, "line": child.sourceline}
            if len(self.files) > _MOST_ELEMENTS:
                raise InputError(f"more than {_MOST_ELEMENTS:,} elements", _MEANT, **place)
            written = child.items()
            try:
                if tag == "default":
                    defaults.append(child)
                    self.declare(child, declared, place)
                    continue
                for key, text in written:
                    if "$" in text:
                        child.set(key, self.substitute(text, place))
                    self.refuse_misread(child, key, text, place)
            except InputError as slip:
                if self.broken.isdisjoint(_REFERENCE.findall(str(written))):
                    self.slips.append(slip)
                if len(self.slips) == _MOST_SLIPS:
                    self.refuse_leftovers()
                if tag == "default":
                    self.broken.add(child.get("name", ""))
                    continue
            if tag == "include":
                self.include(child, chain, place)
            elif len(child):
                self.process(child, path, chain, declared)
        # only now: the comments of later defaults are found through their neighbours
        for child in defaults:
            parent.remove(child)

    def refuse_misread(self, element: Node, key: str, written: str, place: dict[str, Any]) -> None:
        """Refuse a value that Mitsuba could not read, at the place where somebody wrote it."""
        tag = str(element.tag)
        if is_readable(tag, key, element.get(key, "")):
            return
        name = element.get("name") if key == "value" else None
        what, given = name or f"{key} of <{tag}>", written.removeprefix("$") in self.changed
        if written[:1] == "$" and (default := self.defaults.get(written[1:])) is not None:
            what, place = default.name, {"path": default.path, "line": default.line}
        place = {"path": self.path} if given else place
        refuse_misread(tag, key, what, element.get(key, ""), given=given, **place)

    def declare(
        self, element: Node, declared: dict[str, int | None], place: dict[str, Any]
    ) -> None:
        """Take note of a ``<default>`` and of the text that stands for it from here on."""
        if (slip := misspelt(element)) is not None:
            raise InputError(*slip, **place)
        name, raw = element.get("name", ""), element.get("value", "")
        if not _NAME.fullmatch(name):
            problem = "a <default> needs a name of letters, digits and _"
            raise InputError(problem, 'write <default name="gap_mm" value="0.05"/>', **place)
        if name in declared:
            problem = f"{name} is declared a second time (first on line {declared[name]})"
            raise InputError(problem, "keep one of the two", **place)
        declared[name] = element.sourceline
        refuse_odd_blanks(name, raw, **place)
        text = self.substitute(raw, place)
        named = self.material_in(name, text, **place)
        if named is not None:
            text = value_text(named.value)
        value = parse_value(name, text, **place)
        if name in self.defaults:
            return  # the first default wins across files
        comment = comment_of(element)
        self.defaults[name] = DefaultParameter(name, raw, comment, unit_of(name), **place)
        if named is not None:
            self.materials[name] = named
        if name in self.overrides:
            value, text = self.overridden(name, value, text)
        self.parameters[name], self.texts[name] = value, text

    def overridden(self, name: str, default: Value, default_text: str) -> tuple[Value, str]:
        """Value and text of a parameter that an override names; no line of the file is to blame."""
        given = self.overrides[name]
        if "$" in given:
            problem = f"the value given for {name}, '{given}', contains a $"
            raise InputError(problem, "give the value itself", path=self.path)
        named = self.material_in(name, given, given=True, path=self.path)
        if named is None:
            value = parse_like(name, given, default, given=True, path=self.path)
        else:
            value = named.value
        if value == default:
            # 1.0 for "1.00": the file's own spelling, so that the same scene has one hash
            return default, default_text
        self.materials.pop(name, None)
        if named is None:
            self.changed[name] = value_text(value)
        else:
            self.materials[name], self.changed[name] = named, named.text
        return value, value_text(value)

    def material_in(self, name: str, text: str, **place: Any) -> MaterialIndex | None:
        """The index that a text names by a material, worked out once for all assemblies."""
        if (name, text) not in self.indices:
            named = parse_material(name, text, folder=self.path.parent, **place)
            if named is None:
                return None
            self.indices[name, text] = named
            if named.emission is not None:
                self.sources[resolved(named.emission)] = read_bytes(named.emission, _LIMIT_MB)
        return self.indices[name, text]

    def substitute(self, text: str, place: dict[str, Any]) -> str:
        """Replace every ``$name`` in an attribute."""

        def replacement(match: re.Match[str]) -> str:
            name = match.group(1)
            if name not in self.texts:
                raise self.undeclared(name or "", place)
            self.used.add(name)
            new = self.texts[name]
            minus = text.startswith("-", match.start() - 1) and match.start() > 0
            if minus and new.startswith(("-", "+")):
                mend = f"give {name} a value above 0, without a sign"
                if name in self.changed and new.startswith("-"):
                    problem = f"the value given for {name}, {new}, is negative"
                    raise InputError(problem, mend, path=self.path)
                problem = f"{name} = {new} turns -${name} into '-{new}', which is no number"
                raise InputError(problem, mend, **place)
            self.characters += len(new)
            self.references += 1
            if self.characters > _MOST_CHARACTERS or self.references > _MOST_REFERENCES:
                problem = (
                    f"parameters stand at more than {_MOST_REFERENCES:,} places, or make more than "
                    f"{_MOST_CHARACTERS:,} characters of this scene"
                )
                raise InputError(problem, _MEANT, **place)
            return new

        return _REFERENCE.sub(replacement, text)

    def undeclared(self, name: str, place: dict[str, Any]) -> InputError:
        """The refusal of a ``$name`` that no default above it declares."""
        if not name:
            return InputError("a $ without a name", "write $name or remove it", **place)
        beginnings = (declared for declared in self.texts if name.startswith(declared))
        start = max(beginnings, key=len, default="")
        if start:
            silently = self.texts[start] + name.removeprefix(start)
            problem = f"${name} is not declared; only its beginning, {start}, is"
            problem += f": Mitsuba would silently read it as '{silently}'"
            return InputError(problem, f"write ${start} or declare {name}", **place)
        if (meant := self.misdeclared(name)) is not None:
            problem = f"{meant.name} is declared, and used nowhere; "
            problem += f"${name} is used, and not declared"
            mend = f"if {name} is meant here, write it so"
            return InputError(problem, mend, path=meant.path, line=meant.line)
        guess = f"{did_you_mean(name, self.texts)}; or " if closest(name, self.texts) else ""
        mend = f'{guess}add <default name="{name}" value="..."/> at the top'
        return InputError(f"${name} is not declared above this line", mend, **place)

    def misdeclared(self, name: str) -> DefaultParameter | None:
        """The default that is meant by a name and has another: that of no bench, used nowhere."""
        alike = closest(name, self.defaults)
        if alike is None:
            return None
        shipped = scene_path("camoo4.xml").read_text(encoding="utf-8")
        if f'<default name="{name}"' not in shipped or f'<default name="{alike}"' in shipped:
            return None
        uses = re.compile(rf"\${alike}(?![A-Za-z0-9_])".encode())
        used = any(uses.search(source) for source in self.sources.values())
        return None if used else self.defaults[alike]

    def include(self, element: Node, chain: tuple[Path, ...], place: dict[str, Any]) -> None:
        """Put the content of an included file in the place of its ``<include>``."""
        filename = element.get("filename")
        if not filename:
            mend = 'write <include filename="part.xml"/>'
            raise InputError("<include> has no filename", mend, **place)
        target = place["path"].parent / filename
        if not resolved(target).is_relative_to(resolved(self.path.parent)):
            problem = f"{filename} lies outside the scene's folder"
            raise InputError(problem, "move it into the folder", **place)
        if resolved(target) in chain:
            problem = f"{filename} includes itself, directly or through others"
            raise InputError(problem, "remove one of the <include>s", **place)
        if not is_there(target):
            mend = look_around(target, "check <include filename>")
            raise InputError(f"{filename} does not exist", mend, **place)
        self.included += 1
        if self.included > _MOST_FILES or len(chain) > _MOST_NESTED:
            nested = f"more than {_MOST_NESTED} one in another"
            problem = f"more than {_MOST_FILES} files are included, or {nested}"
            raise InputError(problem, "put the parts into fewer files", **place)
        for child in list(self.load(target, chain))[::-1]:
            element.addnext(child)
        parent = element.getparent()
        assert parent is not None  # an <include> is not the outermost element
        parent.remove(element)

    def refuse_leftovers(self) -> None:
        """Refuse what was found wrong, and overrides of what is not there, or changes nothing."""
        if self.slips:
            first = self.slips[0]
            # the same at many places is told once, at the first
            slips = {slip.problem: slip for slip in self.slips[::-1]}.values()
            first.others = tuple(slip for slip in slips if slip is not first)[::-1]
            raise first
        for name in self.overrides:
            if name not in self.defaults:
                problem = f"{name} is not a parameter of this scene"
                mend = _mend_of(name, self.defaults, self.files)
                raise InputError(problem, mend, path=self.path)
            if name not in self.used:
                default = self.defaults[name]
                problem = f"{name} is declared but never used: changing it would change nothing"
                mend = f"use ${name} or remove this <default>"
                raise InputError(problem, mend, path=default.path, line=default.line)
