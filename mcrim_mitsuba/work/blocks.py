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


def planned(
    photons: int, begun: int, first: int, size: int
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Units of a run's next launches: the number of each one's first launch, and their photons.

    Parameters
    ----------
    photons : int
        To be followed.
    begun : int
        Launches that the run has made.
    first, size : int
        Photons of the run's very first launch, and of all others.
    """
    launches: list[int] = []
    while photons > 0:
        launches.append(min(size if begun or launches else first, photons))
        photons -= launches[-1]
    for block in blocks(launches):
        yield begun, block
        begun += len(block)
