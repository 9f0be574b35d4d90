"""Every effect in the scene against the same effect in the NumPy tracer, which shares no code.

One size and configuration each at 1 %; `scripts/crosscheck_effects.py` does all at 0.3 %. z < 4.5:
right programs fail one of the 18 comparisons in one run of 8000.
"""

import math
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
import crosscheck_effects

from mcrim_mitsuba.effects import catalogue

#: The last size of every effect, in the second of its configurations.
CASES = {name: (size, configuration) for name, size, configuration in crosscheck_effects.cases()}


def test_every_effect_of_the_scene_is_compared():
    assert set(CASES) == {name for name, e in catalogue().items() if e.reading is None}


@pytest.mark.parametrize("name", CASES)
def test_effect_is_the_same_in_both_programs(name):
    size, configuration = CASES[name]
    eta, sigma = crosscheck_effects.mitsuba_eta(name, size, configuration, 200_000, seed=21)
    photons = round((1 - eta) / eta / 0.01**2)
    other, other_sigma = crosscheck_effects.numpy_eta(name, size, configuration, photons, seed=22)
    assert abs(eta - other) < 4.5 * math.hypot(sigma, other_sigma)
