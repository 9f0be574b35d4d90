"""Every effect in the scene against the same effect in the NumPy tracer, which shares no code.

One size and configuration each at 1 %; `scripts/validate` does all at 0.2 %. z < 4.5: right
programs fail one of the 18 comparisons in one run of 8000.
"""

import math

import pytest
from validate import benches

from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.transport.simulation import Simulation

#: The last size of every effect, in the second of its configurations.
CASES = {case.effect: case for case in benches.effect_cases()}


def test_every_effect_of_the_scene_is_compared():
    assert set(CASES) == {name for name, e in catalogue().items() if e.reading is None}


@pytest.mark.parametrize("name", CASES)
def test_effect_is_the_same_in_both_programs(name):
    case = CASES[name]
    ours = Simulation(case.scene_file(), check=False).collect(200_000, seed=21)
    photons = round((1 - ours.eta) / ours.eta / 0.01**2)
    other = trace(case.bench(), photons, seed=22, max_depth=200_000)
    assert abs(ours.eta - other.eta) < 4.5 * math.hypot(ours.eta_sigma, other.eta_sigma)
