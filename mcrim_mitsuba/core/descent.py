"""The lowest point of a statistic that is nearly a sum of squares, within bounds.

The one small minimiser of the package: diagnoses and profiles fit with it thousands of times, and
peaks are fitted with it. The method is Levenberg and Marquardt's (K. Levenberg, Q. Appl. Math. 2
(1944) 164; D. W. Marquardt, J. SIAM 11 (1963) 431), with bounds by projection.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: The height at a point, half of its (k,) gradient and about half of its (k, k) second derivatives:
#: chi2, J^T r and J^T J of residuals r with slopes J.
Height = Callable[[Array], tuple[float, Array, Array]]

# Damping to begin with, and that at which no step helps any more.
_FIRST_DAMPING, _LAST_DAMPING = 1e-3, 1e9


class Descent(NamedTuple):
    """Where a walk downhill ended."""

    #: (k,) float64: The lowest point.
    point: Array
    #: There, as the function gives them.
    height: float
    gradient: Array
    curvature: Array
    converged: bool


def minimise(
    height_at: Height,
    start: Array,
    low: Array,
    high: Array,
    *,
    held: Sequence[int] = (),
    longest: Array | float = np.inf,
    steps: int = 40,
    precision: float = 1e-5,
) -> Descent:
    """Walk downhill from a start, which is moved into the bounds; all three are (k,) float64.

    Coordinates that are `held` stay, and no step is longer than `longest`, in any of them or in
    each, (k,). It ends where no more fall than `precision` is to be expected, or after so many
    `steps`.
    """
    x = np.minimum(np.maximum(start, low), high)  # a third of the time of np.clip
    lowest = height_at(x)
    movable = np.ones(len(x), bool)
    movable[list(held)] = False
    damping = _FIRST_DAMPING
    for _ in range(steps):
        height, gradient, curvature = lowest
        (at,) = (movable & (x != np.where(gradient > 0, low, high))).nonzero()
        if not len(at):
            return Descent(x, *lowest, True)
        matrix = curvature[at[:, None], at]
        diagonal = matrix.diagonal()
        # coordinates may have any units: none is small beside another
        size = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        scaled = matrix * (size[:, None] * size)
        scaled.flat[:: len(at) + 1] += damping
        step = np.zeros(len(x))
        step[at] = -np.linalg.solve(scaled, gradient[at] * size) * size
        step = np.minimum(np.maximum(step, -longest), longest)
        trial = np.minimum(np.maximum(x + step, low), high)
        moved = trial - x
        expected = -float(2.0 * gradient @ moved + moved @ curvature @ moved)
        if abs(expected) < precision and damping <= 1.0:
            return Descent(x, *lowest, True)
        there = height_at(trial)
        if there[0] < height:
            gain = height - there[0]
            x, lowest = trial, there
            # a step that kept its promise may be bolder next time
            damping = damping / 10.0 if gain > 0.5 * expected else damping
        else:
            damping = max(10.0 * damping, 1e-3)
            if damping > _LAST_DAMPING:
                # rounding hides what is left to gain
                return Descent(x, *lowest, True)
    return Descent(x, *lowest, False)
