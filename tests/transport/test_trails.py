"""Trails end where their fate says, and are those of the photons that are simulated.

Statistical tests have fixed seeds and state their false-alarm level.
"""

from itertools import pairwise

import numpy as np
import pytest

from mcrim_mitsuba.output.cross_section import LEAST_SHARE, MOST_FLIGHTS, chosen_paths
from mcrim_mitsuba.transport import loop as transport
from mcrim_mitsuba.transport.collection import FLIGHTS_KEPT, choose_path, follow_trails
from mcrim_mitsuba.transport.launch_plan import plan_lanes
from mcrim_mitsuba.transport.record_store import TrailStore
from mcrim_mitsuba.transport.simulation import Simulation

PHOTONS = 8192
#: scene, what differs from it
CASES = {
    "gel, mask": ("camoo4.xml", {"n_gap": 1.46, "aperture_radius_mm": 3}),
    "wrapped": ("camoo4_wrapped.xml", {}),
}
#: Boxes of the volumes (mm), as the scenes describe them; single precision has 1e-6 of 28 mm.
BOXES = {
    "crystal": ((-5, -5, 0), (5, 5, 10)),
    "gap": ((-5, -5, -0.05), (5, 5, 0)),
    "window": ((-14, -14, -1.05), (14, 14, -0.05)),
}
ROUNDING = 1e-4
KEPT = FLIGHTS_KEPT - 1


@pytest.fixture(scope="module", params=CASES)
def followed(request, scenes):
    scene, overrides = CASES[request.param]
    simulation = Simulation(scenes / scene, overrides, check=False)
    trails = follow_trails(simulation, PHOTONS, seed=5)
    return simulation, trails, trails.ways(KEPT, 0.0)


def inside(points, name: str, slack: float):
    low, high = BOXES[name]
    return ((points >= np.subtract(low, slack)) & (points <= np.add(high, slack))).all(axis=1)


def test_trails_end_where_their_fate_says(followed):
    _, trails, points = followed
    whole = np.flatnonzero(trails.flights <= KEPT)
    last = points[whole, trails.flights[whole]]
    ends = {fate: last[trails.fates[whole] == fate] for fate in trails.shares}
    assert np.abs(ends["detected"][:, 2] + 1.05).max() < ROUNDING
    assert np.abs(ends["detected"][:, :2]).max() < 14 + ROUNDING
    assert inside(ends["absorbed_crystal"], "crystal", ROUNDING).all()
    # somewhere on the flight, not at its end: nearly none on a face
    assert inside(ends["absorbed_crystal"], "crystal", -ROUNDING).mean() > 0.99
    if "absorbed_aperture" in ends:
        assert np.abs(ends["absorbed_aperture"][:, 2] + 0.05).max() < ROUNDING
        assert np.hypot(*ends["absorbed_aperture"][:, :2].T).min() > 3 - ROUNDING
    if "absorbed_reflector" in ends:
        from_middle = np.abs(ends["absorbed_reflector"] - (0, 0, 5)).max(axis=1)
        assert from_middle == pytest.approx(5.01, abs=2 * ROUNDING)


def test_each_flight_stays_in_its_volume(followed):
    simulation, trails, points = followed
    there = np.isfinite(points[:, 1:, 0])
    begin, end = points[:, :-1][there], points[:, 1:][there]
    volumes = trails.starts[:, :KEPT, 3][there]
    for volume, name in enumerate(simulation.model.volume_names):
        mine = volumes == volume
        if volume:  # boxes are convex
            assert mine.any() and inside(begin[mine], name, ROUNDING).all()
            assert inside(end[mine], name, ROUNDING).all()
        else:
            between = begin[mine] + 0.5 * (end - begin)[mine]
            far = np.linalg.norm((end - begin)[mine], axis=1) > 10 * ROUNDING
            assert not any(inside(between[far], name, -ROUNDING).any() for name in BOXES)
    out = np.flatnonzero((trails.fates == "escaped") & (trails.flights <= KEPT))
    assert len(out) and not trails.starts[out, trails.flights[out] - 1, 3].any()


def test_shares_are_those_of_the_simulation(followed):
    """9 comparisons at z = 4: false alarms 6e-4 (births are more even than independent ones)."""
    simulation, trails, _ = followed
    known = simulation.collect(200_000, seed=9)
    assert set(trails.shares) <= set(known.budget)
    for fate, expected in known.budget.items():
        sigma = np.hypot(np.sqrt(expected * (1 - expected) / PHOTONS), known.budget_sigma[fate])
        assert abs(trails.shares.get(fate, 0.0) - expected) < 4 * sigma + 1 / PHOTONS


def test_light_is_absorbed_in_proportion_to_its_path(followed):
    """Absorptions in the crystal against alpha times the path there; z = 4: 1.3e-4 in two."""
    simulation, trails, points = followed
    volume = simulation.crystal.volume
    steps = np.linalg.norm(np.diff(points, axis=1), axis=2)
    path_mm = np.nansum(steps[trails.starts[:, :KEPT, 3] == volume])
    absorbed = ((trails.fates == "absorbed_crystal") & (trails.flights <= KEPT)).sum()
    expected = simulation.model.volumes[volume].alpha_abs_per_mm * path_mm
    assert abs(absorbed - expected) < 4 * np.sqrt(expected)


def test_following_trails_changes_nothing(scenes):
    """Without absorption, photons meet the same fates to the last digit."""
    simulation = Simulation(
        scenes / "camoo4.xml", {"alpha_abs_per_cm": 0, "aperture_radius_mm": 6}, check=False
    )
    path = choose_path(simulation.model, False)
    plan, options = plan_lanes(4096), {"seed": 2, "number": 0, "max_depth": 5000}
    found = [
        transport.launch(path, simulation.crystal, plan, **options, trails=trails)
        for trails in (None, TrailStore(4096, 4))
    ]
    assert found[0].weights["escaped"].sum() > 1000
    for fate, weights in found[0].weights.items():
        assert np.array_equal(weights, found[1].weights[fate])


def test_every_fate_that_matters_is_drawn(followed):
    simulation, *_ = followed
    view = np.array([[4.0, -0.1], [5.0, 0.1]])
    paths, shares = chosen_paths(simulation, view)
    assert {path.fate for path in paths} == set(shares)
    assert min(shares.values()) >= LEAST_SHARE
    assert sum(shares.values()) > 0.97
    assert all(len(path.points) <= MOST_FLIGHTS + 1 for path in paths)
    # one is seen in the enlarged part, on its way through the gap
    ways = [np.linspace(a, b, 2000) for path in paths for a, b in pairwise(path.points)]
    assert any(((way > view[0]) & (way < view[1])).all(axis=1).any() for way in ways)
    again, _ = chosen_paths(simulation, view)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(paths, again, strict=True))
