"""Photons in flight, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Record(IntEnum):
    """Rows of `Photons.record`."""

    SCATTERINGS = 0
    PATH = 1
    SCATTERING_PATH = 2
    MASK_RADIUS = 3


@dataclass
class Photons:
    """Photons that are in the same region; the last axis of every array counts them.

    Attributes
    ----------
    position : (3, n) float64, mm
    direction : (3, n) float64
        Unit vectors.
    touched : (n,) int8
        The body (a `Place`) whose surface a photon in air is on; without meaning elsewhere.
    flights : (n,) int32
        Straight flights so far.
    field : (3, n) complex128 or None
        Polarisation states (see `interface`), None when they are not tracked.
    record : (4, n) float64 or None
        What `DetectedHistories` is made of, by `Record`, in mm; None when nobody asks for it.
    """

    position: NDArray[np.float64]
    direction: NDArray[np.float64]
    touched: NDArray[np.int8]
    flights: NDArray[np.int32]
    field: NDArray[np.complex128] | None
    record: NDArray[np.float64] | None

    def __len__(self) -> int:
        return self.touched.size

    def take(self, who: NDArray[np.intp]) -> Photons:
        """Copies of the photons with these indices."""
        arrays = (getattr(self, field.name) for field in fields(self))
        taken: list[Any] = [None if a is None else a.take(who, axis=-1) for a in arrays]
        return Photons(*taken)

    @staticmethod
    def join(groups: Sequence[Photons]) -> Photons:
        """All photons of several groups as one."""
        if len(groups) == 1:
            return groups[0]
        columns = ([getattr(group, field.name) for group in groups] for field in fields(Photons))
        joined: list[Any] = [
            None if column[0] is None else np.concatenate(column, axis=-1) for column in columns
        ]
        return Photons(*joined)
