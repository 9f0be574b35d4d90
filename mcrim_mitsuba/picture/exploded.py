"""Takes a bench apart: how far each part is lifted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mcrim_mitsuba.picture.parts import Part


def exploded(parts: Sequence[Part], spacing: float) -> list[float]:
    """Lift (mm) of every part so that none touches another.

    Parts that lie beside each other are not moved apart.

    Parameters
    ----------
    parts : sequence of Part
        Lowest first.
    spacing : float
        Between parts above each other, over the width of the widest.
    """
    spacing *= max(float((part.upper - part.lower)[:2].max()) for part in parts)
    lifts: list[float] = []
    for number, part in enumerate(parts):
        tops = [
            below.upper[2] + lift + spacing
            for below, lift in zip(parts[:number], lifts, strict=True)
            if _one_above_the_other(part, below)
        ]
        lifts.append(float(max(tops, default=part.lower[2]) - part.lower[2]))
    return lifts


def raised(points: np.ndarray, lift: float) -> np.ndarray:
    """Points (shape (..., 3), mm) that are lifted."""
    return points + np.array([0.0, 0.0, lift])


def _one_above_the_other(one: Part, other: Part) -> bool:
    return bool(np.all((one.lower < other.upper)[:2] & (other.lower < one.upper)[:2]))
