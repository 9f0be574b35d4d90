"""What several scripts share."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

SCENES = Path(__file__).resolve().parents[1] / "scenes"
#: The article's bench.
SCENE = SCENES / "camoo4.xml"


def markdown(
    head: Sequence[str], rows: Iterable[Sequence[object]], align: str = "---"
) -> list[str]:
    """Lines of a table in Markdown; `align` of all columns but the first: ``---:`` right."""
    cells = [head, ["---", *[align] * (len(head) - 1)], *rows]
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in cells]
    lines[1] = lines[1].replace(" ", "")
    return lines


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
