"""The small minimiser of all fits."""

import numpy as np
import pytest

from mcrim_mitsuba.core.descent import Descent, minimise


def test_a_descent_moves_coordinates_of_any_unit():
    """A valley whose two coordinates have curvatures of 1e40 and 1e-30."""
    units, lowest = np.array([1e-20, 1e15]), np.array([3.0, -2.0])

    def height_at(x):
        residuals = x / units - lowest
        return float(residuals @ residuals), residuals / units, np.diag(units**-2.0)

    infinite = np.full(2, np.inf)
    end = minimise(height_at, np.zeros(2), -infinite, infinite)
    assert end.converged and end.height < 1e-5
    assert end.point / units == pytest.approx(lowest, rel=1e-2)
    # of the point where it ended, whatever steps there were; at a wall and without a step, too
    low = np.array([4.0, -3.0]) * units
    for walls, steps in ((-infinite, 40), (low, 40), (low, 0)):
        end = minimise(height_at, np.zeros(2), walls, infinite, steps=steps)
        assert isinstance(end, Descent) and end.converged == (steps > 0)
        there = zip((end.height, end.gradient, end.curvature), height_at(end.point), strict=True)
        assert all(np.array_equal(ours, theirs) for ours, theirs in there)
        assert np.all(end.point >= walls) and (end.point[0] == low[0]) == (walls is low)
