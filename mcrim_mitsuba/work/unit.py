"""What a long job is made of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from mcrim_mitsuba.cache import RecordCache


def number_of(*identity: object) -> int:
    """A chunk's number, made of what JSON can hold and what tells it from others of its job."""
    text = json.dumps(identity, sort_keys=True, default=str)
    return int(hashlib.sha256(text.encode()).hexdigest()[:15], 16)


#: What a unit makes under one number: arrays of one dimension, and what JSON can hold.
Content = tuple[Mapping[str, NDArray[Any]], Mapping[str, object]]


class Unit(Protocol):
    """A piece of work whose result depends on what it says itself, and on nothing else."""

    @property
    def what(self) -> str:
        """Of what it is a part, for people."""

    @property
    def photons(self) -> int:
        """That it follows."""

    @property
    def variant(self) -> str:
        """Of Mitsuba."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the chunks that it makes, in the cache of its job."""

    def make(self, threads: int | None) -> dict[int, Content]:
        """The chunks by number; `threads` (all when None) do not change them."""

    def check(self, threads: int | None) -> None:
        """Refuse, by an InputError, what no unit should be made of; before it is made."""

    def portable(self) -> Unit:
        """The same unit as it is sent to another machine: without a need of files here."""


@dataclass(frozen=True, eq=False)
class Task:
    """A unit and where it is kept.

    Attributes
    ----------
    unit : Unit
    cache : RecordCache
        Of its job: the key says what all units of it have in common.
    """

    unit: Unit
    cache: RecordCache
