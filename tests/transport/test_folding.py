"""Flights that pass over total reflections: when they may, and that they end where others do.

That photons fare the same is seen by every test of light in a polished crystal against closed
forms, the NumPy tracer and the solution without noise; against flights from one reflection to the
next they are held in `tests/scripts/test_validate.py`.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from places import cases_of

from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.convex import NO_FACE, convex_solids
from mcrim_mitsuba.transport.folding import (
    MOST_WIDTHS,
    FoldedBody,
    folded_axes,
    total_from,
    wall_folds,
)
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

GEL = {"n_gap": 1.46}


@pytest.fixture
def folded(scenes):
    """The scene of a crystal, with effects in it, loaded."""

    def load(crystal="", *effects, **overrides) -> Simulation:
        scene = read_scene(scenes / f"camoo4{crystal}.xml")
        for effect in effects:
            scene = scene.edited(add(effect, scene))
        return Simulation(scene, GEL | overrides, check=False)

    return load


@cases("crystal", "effects", "axes", "wall")
def test_flights_pass_over_what_only_reflects(folded, crystal, effects, axes, wall):
    simulation = folded(crystal, *effects)
    (solid,) = (s for s in convex_solids(simulation.model) if s.volume == simulation.crystal.volume)
    assert list(folded_axes(simulation.model, solid)) == axes
    assert wall_folds(simulation.model, solid) == wall
    path = simulation.launcher().path.folded
    assert isinstance(path, FoldedBody) if axes or wall else path is None


def test_trails_are_not_folded(folded):
    assert folded().launcher(fold=False).path.folded is None
    # nor is what Mitsuba intersects
    assert folded().launcher(general=True).path.folded is None


def test_total_reflection_begins_at_the_critical_angle(folded):
    model = folded().model
    of = {s.name: total_from(s, model.volume_names.index("crystal")) for s in model.surfaces}
    assert of["crystal_top"] == pytest.approx(1 / 2.01**2, rel=2e-6)
    assert of["crystal_bottom"] == pytest.approx((1.46 / 2.01) ** 2, rel=2e-6)
    assert of["crystal_top"] > 1 / 2.01**2
    # light of other volumes, masks and detectors
    assert min(of["detector"], of["window_under_gap"]) > 1.0


def _flights(count: int, longest: float):
    """Places in a cube of half a width of 1, unit directions, lengths: single precision's."""
    random = np.random.default_rng(8)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    flights = random.uniform(-1, 1, (count, 3)), direction, random.uniform(0, longest, count)
    return [numbers.astype(np.float32).astype(float) for numbers in flights]


def _ends(body, place, direction, length):
    """Where folded flights end, with directions there and numbers of reflections."""
    end, flying, folds = body.folded(
        mi.Point3f(place.T.astype(np.float32)),
        mi.Vector3f(direction.T.astype(np.float32)),
        mi.Float(length.astype(np.float32)),
        mi.UInt32(NO_FACE),
        mi.Mask(True),
    )
    dr.eval(end, flying, folds)
    return np.array(end).T, np.array(flying).T, np.array(folds)


def _middle_of(body):
    """Of a solid's planes by their axes, and of its round wall."""
    middle, circle = np.zeros(3), body.solid.circle
    for plane in body.solid.planes:
        middle += 0.5 * plane.offset * np.abs(plane.axis)
    if circle is not None:
        middle[list(circle.across)] = circle.centre_mm
    return middle


def test_a_folded_flight_ends_where_one_from_face_to_face_does(folded):
    """To 6e-6 of a width, as is said, and as many reflections later."""
    body = folded("_thin").launcher().path.folded
    low, high = np.array([-5.0, -5.0, 0.0]), np.array([5.0, 5.0, 1.0])
    place, direction, length = _flights(4000, MOST_WIDTHS * 10.0)
    place = ((low + high) / 2 + place * (high - low) / 2).astype(np.float32).astype(float)
    end, flying, folds = _ends(body, place, direction, length)
    reflections = np.zeros(len(place), dtype=int)
    going = np.arange(len(place))
    while len(going):
        o, d = place[going], direction[going]
        t = np.where(d > 0, high - o, low - o) / d
        axis = np.argmin(t, axis=1)
        nearest = t[np.arange(len(going)), axis]
        meets = nearest < length[going]
        going, o, d, axis = going[meets], o[meets], d[meets], axis[meets]
        met = np.arange(len(going)), axis
        o = o + nearest[meets, None] * d
        o[met] = np.where(d[met] > 0, high[axis], low[axis])
        d[met] = -d[met]
        place[going], direction[going] = o, d
        length[going] -= nearest[meets]
        reflections[going] += 1
    np.testing.assert_allclose(end, place + length[:, None] * direction, rtol=0, atol=6e-5)
    same = reflections == folds
    np.testing.assert_allclose(flying[same], direction[same], rtol=0, atol=1e-6)
    # what ends at a face may have met it or not
    assert np.count_nonzero(~same) < 8


@cases("crystal", "effects", "folds")
def test_polarised_light_is_folded_where_no_face_lets_it_out(folded, crystal, effects, folds):
    """Total reflection turns its field, of which nothing is left when it has scattered."""
    body = folded(crystal, *effects, polarization="true").launcher().path.folded
    assert (body is not None) == folds
    if body is None:
        return
    place, direction, length = _flights(4000, 300.0)
    # not far from the middle, so that even round walls are met head-on
    place = (place / 16 + _middle_of(body)).astype(np.float32).astype(float)
    end, flying, number = _ends(body, place, direction, length)
    every = folded(crystal, *effects).launcher().path.folded
    as_others = _ends(every, place, direction, length)
    trapped = number > 0
    np.testing.assert_array_equal(end[trapped], as_others[0][trapped])
    np.testing.assert_array_equal(flying[trapped], as_others[1][trapped])
    np.testing.assert_allclose(
        end[~trapped], (place + length[:, None] * direction)[~trapped], atol=1e-4
    )
    np.testing.assert_array_equal(flying[~trapped], direction.astype(np.float32)[~trapped])
    leaves = np.abs(direction).max(axis=1) > 1.02 * np.sqrt(1 - 1 / 2.01**2)
    assert 0.02 < trapped.mean() < 0.8 and 0.2 < leaves.mean()
    assert not (trapped & leaves).any()


@pytest.mark.parametrize(("crystal", "n_out"), [("_cylinder", 1.0), ("_cylinder_lying", 1.46)])
def test_a_flight_round_a_wall_ends_where_one_from_chord_to_chord_does(folded, crystal, n_out):
    body = folded(crystal).launcher().path.folded
    circle = body.solid.circle
    across, middle = list(circle.across), _middle_of(body)
    place, direction, length = _flights(4000, MOST_WIDTHS * 2 * circle.radius_mm)
    place *= 0.7 * circle.radius_mm
    away, along = place[:, across], direction[:, across]
    lever = away[:, 0] * along[:, 1] - away[:, 1] * along[:, 0]
    cosine2 = (along**2).sum(axis=1) - (lever / circle.radius_mm) ** 2
    # light that the wall keeps in, in air or where it lies in gel
    kept = cosine2 < 1 - (n_out / 2.01) ** 2 - 0.01
    assert 0.2 < kept.mean() < 0.9
    place, direction, length = place[kept], direction[kept], length[kept]
    end, flying, folds = _ends(body, place + middle, direction, length)
    place, direction = place[:, across], direction[:, across]
    going = np.arange(len(place))
    while len(going):
        o, d = place[going], direction[going]
        a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1)
        t = (-b + np.sqrt(b * b - a * (c - circle.radius_mm**2))) / a
        meets = t < length[going]
        going, o, d, t = going[meets], o[meets], d[meets], t[meets]
        o = o + t[:, None] * d
        normal = o / np.linalg.norm(o, axis=1)[:, None]
        direction[going] = d - 2 * (d * normal).sum(axis=1)[:, None] * normal
        # exactly on the wall, where the next chord has its other end
        place[going] = normal * circle.radius_mm
        length[going] -= t
    expected = middle[across] + place + length[:, None] * direction
    np.testing.assert_allclose(end[:, across], expected, rtol=0, atol=2e-3)
    assert np.linalg.norm(flying, axis=1) == pytest.approx(np.ones(len(flying)), abs=1e-5)
    assert folds.max() > 50


def test_light_that_nothing_takes_goes_on_for_ever(folded):
    """Beyond the longest flight there is another one; what is born in no face's cone stays."""
    simulation = folded(alpha_scat_per_cm=0.0, alpha_abs_per_cm=0.0)
    results = [
        simulation.collect(100_000, seed=2, max_depth=60, fold=fold) for fold in (True, False)
    ]
    truncated = [result.budget["truncated"] for result in results]
    assert truncated[0] == pytest.approx(truncated[1], abs=4e-3)
    assert truncated[0] > 0.2
