"""What several scripts share."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mcrim_mitsuba import reference

SCENES = Path(__file__).resolve().parents[1] / "scenes"
#: The article's bench.
SCENE = SCENES / "camoo4.xml"
_REFERENCE = Path(reference.__file__).parent
#: Modules of the NumPy tracer, and of Geant4, which knows the tracer's bench.
GEANT4_CODE = [*_REFERENCE.glob("geant4*.py"), _REFERENCE / "bench.py"]
TRACER_CODE = sorted(
    file for file in _REFERENCE.glob("*.py") if not file.stem.startswith(("geant4", "crosscheck"))
)


def markdown(head: Sequence[str], rows: Iterable[Sequence], right: Iterable[int] = ()) -> list[str]:
    """Lines of a table in Markdown; the numbered columns are aligned to the right."""
    rule = ["---:" if column in right else "---" for column in range(len(head))]
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, *rows)]
    return [lines[0].replace("|  |", "| |"), f"|{'|'.join(rule)}|", *lines[1:]]


def fraction_error(k: int, n: int) -> float:
    """Standard deviation of k / n under a uniform prior: never 0."""
    return math.sqrt((k + 1) * (n - k + 1) / ((n + 2) ** 2 * (n + 3)))


@contextlib.contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """A variable of the environment has a value, for a while."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before
