"""A TOML file whose entries remember their lines, for error messages."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mcrim_mitsuba.core.errors import InputError, did_you_mean, said_by
from mcrim_mitsuba.core.files import beside, read_text
from mcrim_mitsuba.core.numbers import parse_number

_LIMIT_MB = 1
_POSITION = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_TABLE = re.compile(r"\s*\[\[?([^\]]+)\]")
_PERCENT = re.compile(r"[^=#\"']*=\s*(\d+(?:\.\d+)?)\s*%")
#: An entry whose number has a unit.
_WITH_UNIT = re.compile(
    r"[ \t]*[\w.-]+[ \t]*=[ \t]*([+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)"
    r"[ \t]*[^\W\d_][^#,\"']*(?:#.*)?"
)
_KEY = re.compile(r"\s*([\w.\"'-]+)\s*=")
#: Levels of tables and lists: no entry of ours is deeper than four. tomllib's time grows with the
#: square of a dotted name's length, so that long ones must not reach it.
_DEEPEST = 20
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_NAME = re.compile(rf"""(?<![\w"'-])(?:{_PART}[ \t]*\.[ \t]*){{{_DEEPEST}}}""")
_DEEP_VALUE = re.compile(rf"(?:[\[{{][^\[{{\]}}]*+){{{_DEEPEST}}}")
_LARGEST_WHOLE = 2**63
_MANY_DIGITS = re.compile(r"[0-9_]{1000}")


@dataclass(frozen=True)
class TomlDocument:
    """Content of a TOML file."""

    #: The file.
    path: Path
    #: As `tomllib` gives it.
    content: dict[str, Any]
    #: Line of every table and key by its dotted name. tomllib keeps no lines: these come
    #: from a plain scan and serve error messages only.
    lines: dict[str, int]
    #: All of it.
    text: str
    #: What the file is, for error messages.
    kind: str = "a campaign"

    def refusal(self, key: str, problem: str, mend: str) -> InputError:
        """The error to raise about the entry with this dotted name."""
        name = key
        while name and name not in self.lines:
            # an entry of an inline table, or a missing one: the table's own line
            name = name.rpartition(".")[0]
        return InputError(problem, mend, path=self.path, line=self.lines.get(name))

    def table(self, key: str, entries: Iterable[str] | None = None) -> TomlTable:
        """The table of this dotted name (the whole file for ""), empty if it is not there.

        Raises InputError if it is not a table or holds a key that is not in `entries`.
        """
        content: Any = self.content
        for part in key.split(".") if key else []:
            content = content.get(part, {})
            if not isinstance(content, dict):
                raise self.refusal(key, f"{part} is not a table", f"write [{key}]")
        table = TomlTable(self, key, content)
        for name in content:
            if entries is not None and name not in entries:
                where = f"[{key}]" if key else self.kind
                problem = f"{where} has no entry {name}"
                raise table.refusal(name, problem, did_you_mean(name, entries))
        return table


class TomlTable(dict[str, Any]):
    """A table of a TOML file, and where it stands: `key` is its dotted name."""

    def __init__(self, document: TomlDocument, key: str, content: dict[str, Any]) -> None:
        super().__init__(content)
        self.document, self.key = document, key

    def refusal(self, name: str, problem: str, mend: str) -> InputError:
        """The error to raise about an entry, or about the table itself (name "")."""
        key = f"{self.key}.{name}".lstrip(".") if name else self.key
        return self.document.refusal(key, problem, mend)

    def path_of(self, name: str, given: object) -> Path:
        """What an entry gives as a path, relative to the file, which need not be there.

        Raises InputError if it is no text, or empty.
        """
        if not isinstance(given, str) or not given:
            raise self.refusal(name, f"{name} is not a path", f'write {name} = "..."')
        return beside(self.document.path, given)

    def number(self, name: str) -> float | None:
        """A finite number as float, None without it; raises InputError if it is something else."""
        value = self.get(name)
        if value is None:
            return None
        if isinstance(value, str):
            raise self.refusal(name, f'{name} = "{value}" is text', "write a number without quotes")
        if not is_plain_number(value):
            raise self.refusal(name, f"{name} is not a number", "write one, such as 0.5")
        with said_by(partial(self.refusal, name)):
            return parse_number(name, repr(value))

    def known_number(self, name: str) -> float:
        """`number` of an entry that is there."""
        number = self.number(name)
        assert number is not None
        return number


def is_plain_number(value: object) -> bool:
    """Whether an entry's value is a number: true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def read_toml(path: Path, kind: str = "a campaign") -> TomlDocument:
    """Read a TOML file; `kind` says what it is, for error messages.

    Raises InputError if it cannot be read, or with line and column if it is not TOML.
    """
    text = read_text(path, _LIMIT_MB)
    if deep := _DEEP_NAME.search(text):
        raise _too_deep(path, _line_of(deep, text))
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise _too_deep(path, _line_of(_DEEP_VALUE.search(text), text)) from None
    except tomllib.TOMLDecodeError as error:
        position = _POSITION.search(str(error))
        line, column = position.groups() if position else (None, None)
        number = int(line) if line else len(text.rstrip().split("\n"))
        unit = _WITH_UNIT.fullmatch(text.split("\n")[number - 1])
        mend = 'entries are name = value, text in "quotes", decimals with a point'
        if percents := _PERCENT.match(text.split("\n")[number - 1]):
            mend = f"write a fraction: {float(percents[1]) / 100.0:g}"
        raise InputError(
            f"not TOML: {_POSITION.sub('', str(error))}",
            f"write {unit[1]}, without a unit" if unit else mend,
            path=path,
            line=number,
            column=int(column) if column else None,
        ) from None
    except ValueError:  # Python's limit of the digits of a whole number
        problem = "a whole number has thousands of digits"
        line = _line_of(_MANY_DIGITS.search(text), text)
        raise InputError(problem, "correct it", path=path, line=line) from None
    document = TomlDocument(path, content, _lines(text), text, kind)
    _refuse_monsters(document)
    return document


def _line_of(match: re.Match[str] | None, text: str) -> int | None:
    return None if match is None else text.count("\n", 0, match.start()) + 1


def _too_deep(path: Path, line: int | None) -> InputError:
    problem = f"tables or lists are nested more than {_DEEPEST} deep"
    return InputError(problem, "is this the file you meant?", path=path, line=line)


def _refuse_monsters(document: TomlDocument) -> None:
    """Refuse entries that are nested very deep, and whole numbers of more than 64 bits."""
    values: list[tuple[str, Any, int]] = [("", document.content, 0)]
    while values:
        name, value, depth = values.pop()
        if depth > _DEEPEST:
            raise _too_deep(document.path, document.lines.get(name))
        if isinstance(value, dict):
            values += [
                (f"{name}.{key}".lstrip("."), inner, depth + 1) for key, inner in value.items()
            ]
        elif isinstance(value, list):
            values += [(name, inner, depth + 1) for inner in value]
        elif isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
            problem = f"{name.rpartition('.')[2]} is a whole number of more than 64 bits"
            raise document.refusal(name, problem, "correct it")


def _lines(text: str) -> dict[str, int]:
    """Lines of tables and keys by dotted name; the first one of a name counts."""
    lines: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _TABLE.match(line):
            table = _bare(header.group(1))
            name = table
        elif key := _KEY.match(line):
            name = f"{table}.{_bare(key.group(1))}".lstrip(".")
        else:
            continue
        parts = name.split(".")
        # [parameters.x] makes the table parameters too
        for end in range(1, len(parts) + 1):
            lines.setdefault(".".join(parts[:end]), number)
    return lines


def _bare(name: str) -> str:
    """A dotted name without quotes and blanks."""
    return ".".join(part.strip().strip("\"'") for part in name.split("."))
