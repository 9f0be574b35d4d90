"""A command's JSON, asked for what it must hold; what is not there is refused in one line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.reading import read_text

_LIMIT_MB = 200
_WHAT = "give what --json of calibrate, compare, diagnose, report, simulate or table wrote"
#: Whole numbers beyond are nobody's result, and no float can hold the largest that JSON may have.
_LARGEST_WHOLE = 2**63
# a column's name: what NetCDF and CSV can hold
_NAME = re.compile(r"[^\W\d][^\x00-\x1f/\"]*")


class JsonResult:
    """An object of a JSON file.

    Parameters
    ----------
    path : Path
        The file.
    content : dict
    place : str
        Where in the file, for messages.
    """

    def __init__(self, path: Path, content: dict[str, Any], place: str = "") -> None:
        self.path, self.content, self._place = path, content, place

    def __contains__(self, name: str) -> bool:
        return self.content.get(name) is not None

    def number(self, name: str) -> float | int | None:
        """A finite number, or None for null and for what is not there."""
        value = self.content.get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refusal(name, "not a number")
        if isinstance(value, int) and abs(value) > _LARGEST_WHOLE:
            raise self.refusal(name, "a whole number of more than 64 bits")
        if not math.isfinite(value):
            raise self.refusal(name, "not finite")
        if name.endswith("sigma") and value < 0:
            raise self.refusal(name, "a negative error")
        return value

    def text(self, name: str) -> str | None:
        """A text, or None where there is none; `InputError` for anything else."""
        value = self.content.get(name)
        if value is not None and not isinstance(value, str):
            raise self.refusal(name, "not a text")
        return value

    def flag(self, name: str) -> bool | None:
        """True, false, or None where there is none; `InputError` for anything else."""
        value = self.content.get(name)
        if value is not None and not isinstance(value, bool):
            raise self.refusal(name, "neither true nor false")
        return value

    def object(self, name: str) -> JsonResult:
        """An object in this one; an empty one where there is none."""
        value = self.content.get(name, {})
        if not isinstance(value, dict):
            raise self.refusal(name, "not an object")
        for key in value:
            if not _NAME.fullmatch(key):
                raise self.refusal(name, f"the name {key[:40]!r} cannot be a column")
        return JsonResult(self.path, value, self._at(name))

    def objects(self, name: str) -> Iterator[JsonResult]:
        """Objects of a list in this one; none where there is no list."""
        value = self.content.get(name, [])
        if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
            raise self.refusal(name, "not a list of objects")
        for place, each in enumerate(value):
            yield JsonResult(self.path, each, f"{self._at(name)}[{place}]")

    def refusal(self, name: str, problem: str) -> InputError:
        """The error that says what is wrong with the entry `name`."""
        return InputError(f"{self._at(name)}: {problem}", _WHAT, path=self.path)

    def _at(self, name: str) -> str:
        return f"{self._place}.{name}" if self._place else name


def read_json(path: Path) -> JsonResult:
    """Read a file that holds one JSON object.

    Raises
    ------
    InputError
        If it cannot be read, is no JSON, or holds something else.
    """
    try:
        content = json.loads(read_text(path, _LIMIT_MB))
    except json.JSONDecodeError as error:
        raise InputError(
            f"not JSON ({error.msg})", _WHAT, path=path, line=error.lineno, column=error.colno
        ) from None
    except (RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("JSON that is nested too deeply or too long", _WHAT, path=path) from None
    if not _is_text(content):
        raise InputError("JSON with half a character (\\ud800 or the like)", _WHAT, path=path)
    if not isinstance(content, dict):
        raise InputError("JSON, but not of a result", _WHAT, path=path)
    return JsonResult(path, content)


def _is_text(content: Any) -> bool:
    r"""Whether all texts can be written: ``\ud800`` alone stands for no character."""
    try:
        json.dumps(content, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True


def not_a_result(path: Path) -> InputError:
    """JSON of another program, or of a command without a result in numbers."""
    return InputError("JSON, but no result of mcrim that can be converted", _WHAT, path=path)
