"""How many launches make a unit: a few seconds of work, more of them in long runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

#: Launches of a unit; after so many units larger ones, so that long runs leave few files.
SHORT, SHORT_BLOCKS, LONG = 4, 16, 32


def blocks(launches: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Launches that follow each other, cut into units.

    Longer runs begin with the same units.
    """
    start = 0
    while start < len(launches):
        size = SHORT if start < SHORT * SHORT_BLOCKS else LONG
        yield tuple(launches[start : start + size])
        start += size
