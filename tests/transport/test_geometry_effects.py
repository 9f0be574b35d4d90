"""Chamfers, bubbles, thicker gaps and reflectors: shapes that change the bench's geometry.

Statistical tests use fixed seeds. The file makes 26 comparisons at z < 3.7: a correct program would
fail it with a probability of at most 0.5 %.
"""

import functools
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from bench_scene import bench_scene
from comparisons import assert_same_fates
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.optics.fresnel import reflectance
from mcrim_mitsuba.output.cross_section import cross_section
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.bulk import lane_generators
from mcrim_mitsuba.transport.convex import convex_solids
from mcrim_mitsuba.transport.simulation import Simulation, check_scene

cases = cases_of(__file__)

Z = 3.7
BENCH = (SCENES / "camoo4.xml").read_text(encoding="utf-8")
#: Of the catalogue, and their sizes.
EFFECTS = {
    "chamfer": ("edge_chamfer", {"chamfer_mm": 0.4}),
    "bubble": ("gap_bubble", {"bubble_fraction": 0.3}),
    "thickness": ("gap_thickness", {"gap_offset_mm": 0.1}),
    "reflector": ("top_reflector", {"top_reflectance": 0.9}),
    "creep": ("gel_creep", {"collar_mm": 1.2}),
    "round": ("gap_bubble_round", {"bubble_area_fraction": 0.3}),
}


def text_of(*effects: str) -> str:
    """The bench with some effects."""
    scene = read_scene(SCENES / "camoo4.xml")
    for name, values in (EFFECTS[effect] for effect in effects):
        scene = scene.edited(add(name, scene, values))
    return scene.unwritten_text or BENCH


def shape(text: str, name: str) -> str:
    return re.search(rf'<shape type="\w+" id="{name}">.*?</shape>', text, re.S).group()


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """A function that writes the bench with some effects and gives its path."""
    folder = tmp_path_factory.mktemp("scenes")

    @functools.cache
    def written(*effects: str) -> Path:
        path = folder / f"{'_'.join(effects) or 'plain'}.xml"
        path.write_text(text_of(*effects), encoding="utf-8")
        return path

    return written


def loaded(path: Path, **overrides) -> Simulation:
    return Simulation(path, overrides, check=False)


def body_of(model, name: str):
    """Volume, area and vector area (mm3, mm2, mm2) of what the faces of a volume enclose."""
    number, content, area, closing = model.volume_names.index(name), 0.0, 0.0, np.zeros(3)
    for face in model.faces:
        surface = model.surfaces[face.surface]
        if number in (surface.interior, surface.exterior):
            own = np.linalg.norm(np.cross(face.edge_u, face.edge_v)) / (1 + face.triangle)
            outwards = face.normal * (1 if surface.interior == number else -1)
            content, area = content + own * (face.corner @ outwards) / 3, area + own
            closing += own * outwards
    return content, area, closing


@pytest.mark.parametrize(("width", "height", "leg"), [(10, 10, 0.4), (10, 2, 0.95), (6, 20, 0.01)])
def test_a_chamfered_crystal_has_its_volume_and_area(write, width, height, leg):
    """Prisms are cut off along the edges; in a cube of the leg at a corner a quarter is left."""
    sizes = {"crystal_width_mm": width, "crystal_height_mm": height, "chamfer_mm": leg}
    model = loaded(write("chamfer"), **sizes).model
    content, area, closing = body_of(model, "crystal")
    assert content == pytest.approx(
        width**2 * height - leg**2 * (4 * width + 2 * height) + 6 * leg**3, rel=1e-6
    )
    w, h = width - 2 * leg, height - 2 * leg
    slopes = np.sqrt(2) * leg * (8 * w + 4 * h) + 6 * np.sqrt(2) * leg**2
    assert area == pytest.approx(2 * w**2 + 4 * w * h + slopes, rel=1e-6)
    assert np.abs(closing).max() < 1e-4
    assert sum(face.triangle for face in model.faces) == 24
    assert len(model.faces) == 20 + 36 + 4


@pytest.mark.parametrize(
    ("fraction", "leg", "left_out"),
    [(0.3, 0.4, 0), (0.02, 0.4, 1), (0.98, 0.4, 1), (1.0, 0.4, 4), (0.0, 0.0, 4)],
)
def test_a_bubble_takes_its_part_of_the_gap(write, fraction, leg, left_out):
    simulation = loaded(
        write("chamfer", "bubble", "thickness"),
        n_gap=1.46,
        bubble_fraction=fraction,
        chamfer_mm=leg,
        gap_offset_mm=0.2,
    )
    model = simulation.model
    assert len(model.scene.shapes()) - len(model.surfaces) == left_out
    names = [surface.name for surface in model.surfaces]
    assert names == [shape.id() for shape in model.shapes]
    assert ("crystal_bottom_bubble" in names) == (10 * fraction > leg)
    content, area, closing = body_of(model, "crystal")
    assert content == pytest.approx(1000 - 60 * leg**2 + 6 * leg**3, rel=1e-6)
    assert np.abs(closing).max() < 1e-4
    if fraction < 1.0:
        content, area, closing = body_of(model, "gap")
        wide = 10 * (1 - fraction)
        assert content == pytest.approx(10 * wide * 0.25, rel=1e-5)
        assert area == pytest.approx(20 * wide + 2 * (10 + wide) * 0.25, rel=1e-5)
        assert np.abs(closing).max() < 1e-4


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6])
def test_a_round_bubble_takes_its_part_of_the_gap(write, share):
    model = loaded(
        write("round", "thickness"), n_gap=1.46, bubble_area_fraction=share, gap_offset_mm=0.2
    ).model
    areas = {"crystal_bottom_bubble": 0.0, "window_under_bubble": 0.0}
    for face in model.faces:
        name = model.surfaces[face.surface].name
        areas[name] = areas.get(name, 0.0) + face.area
    for whole, part in (
        ("crystal_bottom", "crystal_bottom_bubble"),
        ("window_under_gap", "window_under_bubble"),
    ):
        assert areas[part] == pytest.approx(100.0 * share, rel=1e-5)
        assert areas[whole] == pytest.approx(100.0 * (1.0 - share), rel=1e-5)
    assert len(model.walls) == (share > 0.0)
    for wall in model.walls:
        assert wall.circle.area == pytest.approx(100.0 * share)
        assert (wall.low_mm, wall.high_mm) == (pytest.approx(-0.25), 0.0)
        # what is drawn, and what Mitsuba itself intersects, has the same area
        shape = model.shapes[wall.surface]
        assert shape.surface_area()[0] == pytest.approx(
            2 * np.sqrt(np.pi * 100 * share) * 0.25, rel=2e-3
        )
    assert len(convex_solids(model)) == 3
    assert check_scene(
        write("round", "thickness"), {"bubble_area_fraction": share, "n_gap": 1.46}, light=False
    ).ok


def test_a_round_bubble_passes_what_a_film_of_air_does(write):
    """Crystal, liquid and window of one index, which absorb within a millimetre.

    What arrives has come straight down, or by the sides, which the mask lets nothing else pass.
    """
    numbers = {
        "n_crystal": 1.5,
        "n_window": 1.5,
        "n_gap": 1.5,
        "bubble_area_fraction": 0.3,
        "aperture_radius_mm": 4.9,
        "gap_mm": 0.01,
        "alpha_scat_per_cm": 0.0,
        "alpha_abs_per_cm": 8.0,
        "crystal_height_mm": 12.0,
    }
    rng, count = np.random.default_rng(11), 2_000_000
    start = rng.random((3, count)) * [[10.0], [10.0], [12.0]] - [[5.0], [5.0], [0.0]]
    way = rng.standard_normal((3, count))
    way /= np.linalg.norm(way, axis=0)
    way[2] = -np.abs(way[2])
    length = -start[2] / way[2]
    straight = start[:2] + length * way[:2]
    bounces = np.abs(np.floor(straight / 10.0 + 0.5))
    kept = np.prod(reflectance(np.abs(way[:2]), 1.5, 1.0) ** bounces, axis=0)
    at = np.abs((straight + 5.0) % 20.0 - 10.0) - 5.0
    mirrored = reflectance(-way[2], 1.5, 1.0)
    in_bubble = np.hypot(*at) < np.sqrt(0.3 * 100.0 / np.pi)
    passed = np.where(in_bubble, (1.0 - mirrored) / (1.0 + mirrored), 1.0)
    expected = 0.5 * kept * passed * np.exp(-0.8 * length) * (np.hypot(*at) < 4.9)
    sigma = expected.std() / np.sqrt(count)
    ours = loaded(write("round"), **numbers).collect(10**6, seed=12)
    other = trace(bench_scene(**numbers), 200_000, 13)
    for found in (ours, other):
        assert abs(found.eta - expected.mean()) < Z * np.hypot(found.eta_sigma, sigma)


def test_in_air_there_is_no_bubble(write):
    """Up to an index of 1.0005 a gap counts as air, and the cut is at 0."""
    for index, bubble in ((1.0005, False), (1.0006, True)):
        model = loaded(write("bubble"), n_gap=index).model
        assert ("window_under_bubble" in [s.name for s in model.surfaces]) == bubble


@cases("shape", "words")
def test_nonsense_is_refused_in_one_line(write, tmp_path, shape, words):
    path = tmp_path / "scene.xml"
    extra = f'<shape id="extra" {shape}<ref id="window_to_air"/></shape></scene>'
    path.write_text(BENCH.replace("</scene>", extra))
    refused = refusal(loaded, path)
    assert words in refused and re.search(r", line \d+", refused)


@pytest.mark.parametrize("n_gap", [1.0, 1.46])
@cases("effects", "overrides")
def test_scenes_with_effects_are_sound(write, effects, overrides, n_gap):
    report = check_scene(write(*effects), overrides | {"n_gap": n_gap}, light=False)
    assert report.ok, report.problems
    sides = {face.surface: (face.n_interior, face.n_exterior) for face in report.interfaces}
    assert sides["crystal_bottom"] == (2.01, n_gap)
    assert sides["gap_top_rim"] == (n_gap, 1.0)
    assert sides.get("crystal_bottom_bubble", (2.01, 1.0)) == (2.01, 1.0)
    assert "transport: fast path for flat faces" in report.words


def replaced(text: str, name: str, old: str, new: str) -> str:
    """An edit of a shape in the text, or anywhere where none is named; an old text of "" is all."""
    where = shape(text, name) if name else text
    assert old in where
    return text.replace(where, where.replace(old or where, new))


@cases("effect", "edit", "kinds", "words")
def test_planted_faults_are_found(tmp_path, effect, edit, kinds, words):
    path = tmp_path / "scene.xml"
    path.write_text(replaced(text_of(effect), *edit), encoding="utf-8")
    problem = check_scene(path, {"n_gap": 1.46}, light=False).problems[0]
    assert problem.kind in kinds, problem
    assert all(word in problem.text for word in words), problem


def test_the_cross_section_shows_chamfers_bubble_and_thickness(write):
    simulation = loaded(write("chamfer", "bubble", "thickness", "reflector"), n_gap=1.46)
    cut = cross_section(simulation.model, 0.0)
    areas = {name: cut.area(i) for i, name in enumerate(simulation.model.volume_names) if i}
    expected = {"crystal": 100 - 2 * 0.4**2, "gap": 7 * 0.15, "window": 28}
    assert areas == pytest.approx(expected, rel=3e-5)
    lengths = {}
    for line in cut.traces:
        name = simulation.model.surfaces[line.surface].name
        length = np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum()
        lengths[name] = lengths.get(name, 0.0) + length
    assert lengths["crystal_chamfers"] == pytest.approx(4 * 0.4 * np.sqrt(2), abs=2e-3)
    assert lengths["top_reflector"] == pytest.approx(10, abs=1e-3)
    assert lengths["window_under_bubble"] == pytest.approx(3, abs=1e-3)


@pytest.mark.parametrize("general", [False, True], ids=["fast", "general"])
def test_effects_of_no_size_are_the_plain_bench(write, general):
    """The same random numbers, the same faces: the same photons to the last digit."""
    round_one = loaded(write("round"), n_gap=1.46, bubble_area_fraction=0.0)
    absent = {"chamfer_mm": 0, "bubble_fraction": 0, "gap_offset_mm": 0, "collar_mm": 0}
    with_effects = loaded(write("chamfer", "bubble", "thickness", "creep"), n_gap=1.46, **absent)
    assert len(with_effects.model.surfaces) == len(with_effects.model.scene.shapes()) - 8
    options = {"seed": 1, "general": general}
    there = with_effects.collect(30_000, **options)
    plain = loaded(write(), n_gap=1.46).collect(30_000, **options)
    assert there.transport == plain.transport
    assert there.budget == pytest.approx(plain.budget, abs=1e-3 if general else 0)
    there = round_one.collect(30_000, **options)
    assert there.budget == pytest.approx(plain.budget, abs=1e-3 if general else 0)


def test_a_thicker_gap_is_a_thicker_gap(write):
    """The same random numbers: only rounding parts a photon in a thousand from its like."""
    offset = loaded(write("thickness"), gap_mm=0.05, gap_offset_mm=0.35, n_gap=1.46)
    direct = loaded(write(), gap_mm=0.4, n_gap=1.46)
    one, other = (simulation.collect(100_000, seed=2) for simulation in (offset, direct))
    assert one.budget == pytest.approx(other.budget, abs=1e-3)
    assert one.eta != pytest.approx(
        loaded(write(), n_gap=1.46).collect(100_000, seed=2).eta, abs=3e-3
    )


@cases("effects", "overrides")
def test_both_paths_follow_light_alike(write, effects, overrides):
    """Mitsuba asks faces for their bounds, the fast path planes: what comes out agrees."""
    simulation = loaded(write(*effects), **overrides)
    fast = simulation.collect(400_000, seed=3)
    assert fast.transport == "fast path for flat faces"
    assert fast.budget["lost"] == 0
    traced = simulation.collect(150_000, seed=4, general=True)
    assert traced.budget["lost"] < 1e-5
    assert sum(fraction > 1e-3 for fraction in fast.budget.values()) in (4, 5, 6)
    assert_same_fates(fast, traced, z_max=Z, rare=1e-3)


@pytest.mark.parametrize("index", [1.0, 1.5])
def test_light_goes_straight_from_wet_sides_to_the_hole(write, index):
    """Crystal, liquid and window of one index: below wet sides nothing bends light but the top.

    In air the sides are dry, and most light stays.
    """
    numbers = {
        "n_crystal": 1.5,
        "n_window": 1.5,
        "n_gap": index,
        "collar_mm": 10.0,
        "aperture_radius_mm": 7.0,
        "gap_mm": 0.02,
        "alpha_scat_per_cm": 0.0,
        "alpha_abs_per_cm": 1.0,
    }
    rng, count = np.random.default_rng(8), 400_000
    start = rng.random((3, count)) * 10.0 - [[5.0], [5.0], [0.0]]
    way = rng.standard_normal((3, count))
    way /= np.linalg.norm(way, axis=0)
    to_side = ((np.sign(way[:2]) * 5.0 - start[:2]) / way[:2]).min(axis=0)
    up = way[2] > 0
    to_end = np.where(up, 20.0 - start[2], start[2]) / np.abs(way[2])
    within = np.minimum(to_side, to_end)
    hits_top = up & (to_side > (10.0 - start[2]) / way[2])
    falls = np.where(up, np.where(hits_top, reflectance(np.abs(way[2]), 1.5, 1.0), 0.0), 1.0)
    at = start[:2] + (to_end + 0.02 / np.abs(way[2])) * way[:2]
    expected = falls * np.exp(-within / 10.0) * (np.hypot(*at) < 7.0)
    sigma = expected.std() / np.sqrt(count)
    ours = loaded(write("creep"), **numbers).collect(400_000, seed=9)
    other = trace(bench_scene(**numbers), 100_000, 10)
    for found in (ours, other):
        z = (found.eta - expected.mean()) / np.hypot(found.eta_sigma, sigma)
        assert abs(z) < Z if index == 1.5 else z < -30


@pytest.mark.parametrize("effect", ["creep", "round", "bubble"])
def test_births_are_those_of_the_plain_bench_where_faces_are_in_parts(write, effect):
    """So differences of the two are not blurred by where light is born."""
    plain, parted = (loaded(write(*names), n_gap=1.46).crystal for names in ((), (effect,)))
    assert len(parted.model.faces) > len(plain.model.faces) and parted.direct
    for one, other in zip(plain.frame, parted.frame, strict=True):
        assert one == pytest.approx(other, abs=1e-5)


def test_what_comes_back_into_the_liquid_is_lost(write):
    """A white mask beside wet sides sends light up in the liquid, which is without end."""
    scene = read_scene(write("creep"))
    for name in ("mask_offset", "housing_reflection"):
        scene = scene.edited(add(name, scene))
    numbers = {
        "n_gap": 1.46,
        "collar_mm": 3.0,
        "mask_offset_mm": 4.0,
        "housing_reflectance": 1.0,
        "aperture_radius_mm": 6.0,
    }
    ours = Simulation(scene, numbers, check=False).collect(2**21, seed=15)
    other = trace(bench_scene(**numbers), 400_000, 16)
    for fate in ("detected", "escaped"):
        difference = ours.budget[fate] - other.budget[fate]
        assert abs(difference) < Z * np.hypot(ours.budget_sigma[fate], other.budget_sigma[fate])


def test_births_fill_a_chamfered_crystal_evenly(write):
    """By planes as by Mitsuba's rays; the box between the chamfers gets its share."""
    simulation = loaded(write("chamfer"), chamfer_mm=1.0)
    crystal = simulation.crystal
    assert not crystal.direct
    count = 200_000
    points = np.array(crystal.sample(lane_generators(count, 5), count), dtype=float)
    inset = 5.0 - np.abs(points - [[0], [0], [5]])
    pairs = np.array([inset[0] + inset[1], inset[1] + inset[2], inset[2] + inset[0]])
    assert inset.min() > -1e-5 and pairs.min() > 1.0 - 1e-5
    inner = (inset > 1.0).all(axis=0).mean()
    share = 8**3 / (1000 - 60 + 6)
    assert abs(inner - share) < Z * np.sqrt(share * (1 - share) / count)
    rng = np.random.default_rng(6)
    anywhere = mi.Point3f(rng.uniform([-5.5, -5.5, -0.5], [5.5, 5.5, 10.5], (20_000, 3)).T)
    (solid,) = (s for s in convex_solids(simulation.model) if s.volume == crystal.volume)
    assert (np.array(solid.test()(anywhere)) == np.array(crystal._sees_itself()(anywhere))).all()
