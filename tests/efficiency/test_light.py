"""Where light arrives: sums, errors, the NumPy tracer's answer, figures and the command.

Statistical tests have fixed seeds and state their false-alarm level.
"""

import csv
import dataclasses
import json
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.text import Text
from refusals import refusal
from scipy.stats import chi2

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.lighting import follow_light
from mcrim_mitsuba.output.light_figures import draw_arrival, draw_fates
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.arrivals import arrivals, detector_plane
from mcrim_mitsuba.transport.scene_model import DETECTOR, FlatFace
from mcrim_mitsuba.transport.simulation import Simulation

PHOTONS = 400_000
#: What differs from camoo4.xml; largest angle at which light comes into the window (degrees).
CASES = {
    "air, mask": ({"aperture_radius_mm": 5}, np.degrees(np.arcsin(1 / 1.52))),
    "gel": ({"n_gap": 1.46}, np.degrees(np.arcsin(1.46 / 1.52))),
    "dense": ({"n_gap": 1.7}, None),
}


@pytest.fixture(scope="module")
def lights(scenes):
    return {
        name: follow_light(Simulation(scenes / "camoo4.xml", overrides), run=Run(PHOTONS, seed=3))
        for name, (overrides, _) in CASES.items()
    }


@pytest.mark.parametrize("case", CASES)
def test_everything_adds_up(case, lights):
    light = lights[case]
    # weights are kept in single precision
    for binned in (light.map, light.radius, light.angle):
        assert binned.light.sum() == pytest.approx(light.eta, rel=1e-6)
        assert np.nansum(binned.density * binned.size) == pytest.approx(light.eta, rel=1e-6)
    assert sum(light.budget.values()) == pytest.approx(1, abs=1e-6)
    assert light.map.size.sum() == pytest.approx(28**2)
    assert light.radius.size.sum() == pytest.approx(28**2, rel=1e-4)
    assert light.radius.size[:20] == pytest.approx(np.pi * np.diff(light.radius_edges_mm**2)[:20])
    assert light.photons == PHOTONS


@pytest.mark.parametrize("options", [{"photons": 100_001}, {"precision": 0.01}], ids=str)
def test_pictures_of_a_simulation_are_of_the_run_that_is_printed(scenes, tmp_path, options):
    found = mcrim.simulate(scenes / "camoo4.xml", seed=6, **options)
    files = found.draw(tmp_path / "light.png")
    arrival, fates = (list(csv.DictReader(f.open())) for f in files if f.suffix == ".csv")
    (detected,) = (row for row in fates if row["fate"] == "detected")
    drawn = [float(detected[name]) for name in ("fraction", "fraction_sigma", "photons")]
    assert drawn == pytest.approx([found.eta, found.eta_sigma, found.photons], rel=1e-6)
    arrived = sum(float(row["light"]) for row in arrival if row["part"] == "map")
    # a wanted precision is approached in launches of its own
    assert arrived == pytest.approx(found.eta, rel=1e-6 if "photons" in options else 0.02)


def test_records_know_their_batch_where_lanes_follow_unlike_numbers(scenes):
    ((launch, _, _),) = arrivals(Simulation(scenes / "camoo4.xml"), 50_000, seed=3)
    assert len(set(launch.photons_per_batch)) > 1
    sums = np.bincount(launch.records["batch"], launch.records["w"], len(launch.photons_per_batch))
    assert sums == pytest.approx(launch.weights["detected"], rel=1e-5)


@pytest.mark.parametrize("case", CASES)
def test_light_keeps_within_mask_and_refraction(case, lights):
    light, (overrides, most) = lights[case], CASES[case]
    assert light.largest_angle_deg == (None if most is None else pytest.approx(most, abs=1e-3))
    if most is not None:
        beyond = light.angle_edges_deg[:-1] > most
        assert light.angle.light[beyond].sum() < 1e-3 * light.eta
    ((_, _, radius),) = light.masks_mm
    assert radius == overrides.get("aperture_radius_mm", 14)
    assert np.abs(light.crystal_mm) == pytest.approx(5)
    if radius == 5:
        # straight through a window of 1 mm
        reach = radius + np.tan(np.radians(most))
        assert light.radius.light[light.radius_edges_mm[:-1] > reach + 1e-3].sum() == 0


def test_errors_tell_how_far_two_runs_differ(scenes, lights):
    """Chi2 of 4 x 20 bins or so within 0.1 % on both sides: false alarms 0.8 %."""
    for name in ("air, mask", "gel"):
        one = lights[name]
        other = follow_light(
            Simulation(scenes / "camoo4.xml", CASES[name][0]), run=Run(PHOTONS, seed=4)
        )
        for a, b in ((one.radius, other.radius), (one.angle, other.angle)):
            # enough photons for a normal distribution
            used = (a.light * one.photons > 50) & (b.light * other.photons > 50)
            score = ((a.light - b.light)[used] ** 2 / (a.sigma**2 + b.sigma**2)[used]).sum()
            low, high = chi2.ppf((0.001, 0.999), used.sum())
            assert low < score < high


@pytest.mark.parametrize("case", ["air, mask", "gel"])
def test_the_numpy_tracer_finds_the_same(case, scenes, lights):
    """Chi2 over rings and over angles at 0.1 %: false alarms 0.4 % in all."""
    light = lights[case]
    scene, photons = read_scene(scenes / "camoo4.xml", CASES[case][0]), 150_000
    found = trace(scene, photons, 8, histories=True).histories
    angle = np.degrees(np.arccos(np.minimum(found.arrival_cosine, 1.0)))
    for ours, edges, theirs in (
        (light.radius, light.radius_edges_mm, found.arrival_radius_mm),
        (light.angle, light.angle_edges_deg, angle),
    ):
        counts = np.histogram(theirs, edges)[0]
        assert counts.sum() == len(theirs)
        used = ours.light * photons > 25
        expected = ours.light[used]
        variance = expected * (1 - expected) / photons + ours.sigma[used] ** 2
        score = ((counts[used] / photons - expected) ** 2 / variance).sum()
        assert score < chi2.ppf(0.999, used.sum())
        assert counts[~used].sum() < 200


def face(corner, u, v, surface=0, triangle=False):
    corner, u, v = (np.array(vector, dtype=float) for vector in (corner, u, v))
    normal = np.cross(u, v)
    return FlatFace(corner, u, v, normal / np.linalg.norm(normal), triangle, surface)


def model(*faces, curved=()):
    count = 1 + max(f.surface for f in faces)
    surfaces = [SimpleNamespace(kind=DETECTOR, detector=number) for number in range(count)]
    of_all = {"counted": None, "detectors": [f"detector_{number}" for number in range(count)]}
    return SimpleNamespace(
        surfaces=surfaces, flat_faces=faces, curved=curved, size_mm=30.0, **of_all
    )


def test_coordinates_are_the_detectors_own():
    # 6 mm along y and 4 mm along z, upright at x = 7, looking at -x
    plane = detector_plane(model(face((7, 1, 2), (0, 0, 4), (0, 6, 0))))
    assert plane.centre == pytest.approx([7, 4, 4])
    points = plane.coordinates([[7, 4, 4], [7, 5, 4], [7, 4, 6]])
    assert points == pytest.approx(np.array([[0, 0], [1, 0], [0, 2]]))
    assert plane.half_mm == pytest.approx([3, 2])
    assert plane.on_detector(np.array([[2.9, 1.9], [3.1, 0], [0, -2.1]])).tolist() == [True, 0, 0]
    # a triangle off the axis, seen from below: half of its rectangle
    plane = detector_plane(model(face((10, 0, -1), (0, 8, 0), (8, 0, 0), triangle=True)))
    assert plane.coordinates([[15, 5, -1]]) == pytest.approx(np.array([[1, 1]]))
    edges = np.linspace(-4, 4, 9)
    assert plane.cell_areas(edges, edges).sum() == pytest.approx(32, rel=0.05)


def test_a_detector_in_two_planes_or_curved_is_refused():
    bent = model(face((0, 0, 0), (1, 0, 0), (0, 1, 0)), face((1, 0, 0), (0, 0, 1), (0, 1, 0), 1))
    curved = model(face((0, 0, 0), (1, 0, 0), (0, 1, 0)), curved=(0,))
    for detector in (bent, curved):
        assert "one plane" in refusal(detector_plane, detector)


@pytest.mark.parametrize("wrong", [{"photons": 0}, {"seed": -1}])
def test_impossible_numbers_are_refused(wrong):
    refusal(lambda: Run(**wrong))


def test_numbers_behind_the_figures_add_up(lights, tmp_path):
    named = list(lights.items())
    fates, arrival = draw_fates(named), draw_arrival(named[:1])
    columns, rows = fates.columns, fates.rows
    for name in lights:
        shares = [row[columns.index("fraction")] for row in rows if row[0] == name]
        assert sum(shares) == pytest.approx(1, abs=1e-6)
    columns, rows = arrival.columns, arrival.rows
    for part in ("map", "radius", "angle"):
        light = [row[columns.index("light")] for row in rows if row[1] == part]
        assert sum(light) == pytest.approx(named[0][1].eta, rel=1e-6)
    picture, table = draw_arrival(named).save(tmp_path / "light.PDF")
    assert picture.read_bytes().startswith(b"%PDF")
    with table.open() as stream:
        assert len(list(csv.DictReader(stream))) == 3 * len(rows)
    with pytest.raises(ValueError):
        draw_arrival([("again", lights["gel"])] * 5)


def test_percentages_do_not_cover_each_other(lights):
    budget = {
        "detected": 0.02,
        "absorbed_crystal": 0.02,
        "absorbed_gap": 0.01,
        "escaped": 0.87,
        "absorbed_aperture": 0.03,
        "absorbed_surface": 0.003,
        "truncated": 0.03,
        "lost": 0.017,
    }
    light = dataclasses.replace(lights["gel"], budget=budget)
    figure = draw_fates([("50 % $grey", light), ("much\nlonger " * 8, lights["gel"])]).figure
    figure.canvas.draw()
    (axes,) = figure.axes
    # without the lines that lead to narrow parts
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    assert len(boxes) > 10
    assert not any(one.overlaps(two) for one, two in combinations(boxes, 2))
    assert all(0 < box.x0 and box.x1 < figure.bbox.width for box in boxes)


def test_simulate_draws_and_says_the_same(mcrim, scenes, tmp_path):
    command = ["simulate", scenes / "camoo4.xml", "--photons", "3e4"]
    without, found = mcrim.json(*command), tmp_path / "found.json"
    said = mcrim.shown(*command, "--json", found, "--figure", tmp_path / "light.png")
    assert "light_fates.csv" in said
    drawn = json.loads(found.read_text())
    assert (without["eta"], without["budget"]) == (drawn["eta"], drawn["budget"])
    for name in ("light", "light_fates"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / f"{name}.csv").stat().st_size > 200


@pytest.mark.parametrize(
    ("figure", "words"),
    [("light.jpg", ".png or .pdf"), ("no/light.png", "does not exist"), (".", "suffix")],
)
def test_places_that_cannot_be_written_are_refused_first(figure, words, mcrim, scenes, tmp_path):
    assert words in mcrim.refused("simulate", scenes / "camoo4.xml", "--figure", tmp_path / figure)
    assert list(tmp_path.iterdir()) == []
