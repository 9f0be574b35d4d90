"""The cross-section shows every volume where it is and names all of it without overlaps."""

import functools
import struct
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib import _pylab_helpers
from matplotlib.figure import Figure
from matplotlib.image import imread
from places import SCENES, cases_of, tables_of
from refusals import refusal

import mcrim_mitsuba as mcrim_api
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.output.cross_section import COLOURS, cross_section_figure, write_cross_section
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.check import interfaces_of
from mcrim_mitsuba.transport.cut import cross_section, masked
from mcrim_mitsuba.transport.scene_model import DIFFUSE, Surface
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

BENCH = (SCENES / "camoo4.xml").read_text(encoding="utf-8")

#: A cube (one mesh) with edges of 4 mm, tilted, all of its faces oblique in the plane y = 0.
BLOCK = """<medium type="bulk" id="block"/><shape type="cube" id="block_faces">
  <transform name="to_world"><scale value="2"/><rotate y="1" angle="30"/>
  <translate x="8" y="1" z="14"/></transform>
  <ref id="crystal_to_air"/><ref name="interior" id="block"/></shape></scene>"""
TEXTS = {
    "ball": Path(__file__).with_name("ball.xml").read_text(),
    "block": BENCH.replace("</scene>", BLOCK),
    "open": BENCH.replace(
        '<shape type="rectangle" id="crystal_top">',
        '<shape type="rectangle" id="crystal_top"><boolean name="flip_normals" value="true"/>',
    ),
}

TABLES = tables_of(__file__)
#: scene, what is changed, areas that the plane cuts (mm2, analytic)
CASES = TABLES["cases"]


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    """A function that loads a case once: its simulation, interfaces and cross-section."""
    folder = tmp_path_factory.mktemp("scenes")

    @functools.cache
    def loaded(case: str):
        scene, overrides, _ = CASES.get(case, (case, {}, {}))
        path = SCENES / scene
        if scene in TEXTS:
            path = folder / f"{scene}.xml"
            path.write_text(TEXTS[scene], encoding="utf-8")
        simulation = Simulation(path, overrides, check=False)
        middle = (simulation.crystal.lower[1] + simulation.crystal.upper[1]) / 2
        faces = interfaces_of(simulation.file, simulation.model)
        return simulation, faces, cross_section(simulation.model, middle)

    return loaded


@pytest.fixture(scope="module")
def drawn(load):
    """A function that draws a case once, in full; to write its figure changes nothing."""
    return functools.cache(lambda case: cross_section_figure(*load(case)[:2]))


def traces_of(simulation, cut, surface: str):
    number = [s.name for s in simulation.model.surfaces].index(surface)
    return [trace for trace in cut.traces if trace.surface == number]


@pytest.mark.parametrize("case", CASES)
def test_filled_areas_are_those_of_the_volumes(case, load):
    simulation, _, cut = load(case)
    found = {v.name: cut.area(i) for i, v in enumerate(simulation.model.volumes) if i}
    # places are located to 4e-5 mm (LINES, FINEST); round shapes are polygons
    tolerance = 2e-4 if case == "ball" else 2e-5
    assert found == pytest.approx(CASES[case][2], rel=tolerance)


def test_regions_lie_where_the_volumes_are(load):
    simulation, _, cut = load("camoo4")
    boxes = {"crystal": (-5, 0, 5, 10), "gap": (-5, -0.05, 5, 0), "window": (-14, -1.05, 14, -0.05)}
    for volume, name in enumerate(simulation.model.volume_names[1:], start=1):
        corners = cut.corners(volume)
        assert [*corners.min(axis=0), *corners.max(axis=0)] == pytest.approx(boxes[name], abs=1e-4)


def test_a_ball_is_round(load):
    simulation, _, cut = load("ball")
    # all but the last points towards its left and right end, where its outline is vertical
    points = cut.corners(simulation.crystal.volume)
    points = points[np.abs(points[:, 0] - 1) < 4.99]
    assert np.hypot(*(points - (1, 5.3)).T) == pytest.approx(5, abs=1e-3)


def test_plane_beside_the_crystal_shows_the_window_only(load):
    simulation, _, _ = load("camoo4")
    cut = cross_section(simulation.model, 7.0)
    names = simulation.model.volume_names
    assert {names[region.volume] for region in cut.regions} == {"window"}
    assert cut.area(names.index("window")) == pytest.approx(28, rel=2e-5)


def test_detector_is_the_whole_back_face(load):
    simulation, _, cut = load("camoo4")
    points = np.concatenate([t.points for t in traces_of(simulation, cut, "detector")])
    assert (points[:, 0].min(), points[:, 0].max()) == pytest.approx((-14, 14), abs=1e-4)
    assert points[:, 1] == pytest.approx(-1.05, abs=1e-5)


@pytest.mark.parametrize(("case", "covered"), [("mask", 2 * (14 - 3)), ("camoo4", 0.0)])
def test_mask_covers_the_face_outside_its_hole(case, covered, load):
    simulation, _, cut = load(case)
    parts = [trace.points for trace in masked(simulation.model, cut)]
    length = sum(np.ptp(points[:, 0]) for points in parts)
    assert length == pytest.approx(covered, abs=1e-3)
    for points in parts:
        assert points[:, 1] == pytest.approx(-0.05, abs=1e-5)
        assert np.abs(points[:, 0]).min() > 3 - 1e-3


def test_mask_seen_off_the_axis_of_its_hole(load):
    simulation, _, _ = load("mask")
    parts = masked(simulation.model, cross_section(simulation.model, 2.0))
    inner = min(np.abs(trace.points[:, 0]).min() for trace in parts)
    assert inner == pytest.approx(np.sqrt(3**2 - 2**2), abs=1e-3)
    parts = masked(simulation.model, cross_section(simulation.model, 3.5))
    assert sum(np.ptp(t.points[:, 0]) for t in parts) == pytest.approx(28, abs=1e-3)


def test_wrapping_is_hatched_on_the_side_away_from_the_crystal(load):
    simulation, _, cut = load("wrapped")
    traces = traces_of(simulation, cut, "wrapping")
    assert {tuple(trace.back) for trace in traces} == {(-1, 0), (1, 0), (0, 1)}
    for trace in traces:
        assert (trace.points.mean(axis=0) - (0, 5)) @ trace.back > 4.9


def test_volumes_whose_faces_contradict_are_left_empty(load, drawn, tmp_path):
    simulation, _, cut = load("open")
    assert cut.area(simulation.crystal.volume) == 0
    write_cross_section(drawn("open"), tmp_path / "open.png")
    assert (tmp_path / "open.png").stat().st_size > 20_000


#: Words that must be found in the main panel; in the enlarged one.
WORDS = TABLES["words"]


@pytest.mark.parametrize("case", CASES)
def test_everything_is_named_to_scale_and_nothing_overlaps(case, load, drawn):
    simulation, figure = load(case)[0], drawn(case)
    assert len(figure.axes) == 2
    for ax, words in zip(figure.axes, WORDS[case], strict=True):
        x_scale, z_scale = np.diff(ax.transData.transform([(0, 0), (1, 1)]), axis=0)[0]
        assert x_scale == pytest.approx(z_scale, rel=1e-6)
        texts = [text for text in ax.texts if text.get_text()]
        said = "\n".join(text.get_text() for text in texts)
        assert [word for word in words if word not in said] == []
        boxes = [text.get_window_extent() for text in texts]
        for one, two in combinations(boxes, 2):
            assert not one.overlaps(two)
        frame = ax.get_window_extent()
        for box in boxes:
            assert frame.x0 < box.x0 < box.x1 < frame.x1
            assert frame.y0 < box.y0 < box.y1 < frame.y1
    heads = [text.get_window_extent() for text in figure.texts]
    assert all(0 < box.x0 and box.x1 < figure.bbox.width for box in heads)
    assert simulation.file.path.name in figure.texts[0].get_text()
    assert all(f"{name}=" in figure.texts[1].get_text() for name in simulation.file.parameters)


def test_what_effects_add_to_faces_is_drawn_and_named(tmp_path):
    """A rough cube, a bubble or a collar looked like the polished bench with a full gap."""
    for effect, values, words in (
        ("surface_haze", {"rms_roughness_nm": 20.0}, "hazy face, 58 % scattered"),
        ("ground_top", {"ground_top_alpha": 0.3}, "rough face, α = 0.3"),
        ("gap_bubble", {"bubble_fraction": 0.3}, "air bubble in the gap"),
        ("gel_creep", {"collar_mm": 1.5}, "collar of the liquid"),
        ("edge_chamfer", {"chamfer_mm": 0.5}, "bevelled edge"),
        ("mask_offset", {"mask_offset_mm": 3.0}, "about x = 3, y = 0 mm"),
    ):
        path = tmp_path / f"{effect}.xml"
        path.write_text(add(effect, read_scene(SCENES / "camoo4.xml")), encoding="utf-8")
        simulation = Simulation(path, {"n_gap": 1.46, **values}, check=False)
        faces = interfaces_of(simulation.file, simulation.model)
        figure = cross_section_figure(simulation, faces, brief=True)
        assert words in "\n".join(text.get_text() for text in figure.axes[0].texts)


def test_a_cylinder_that_lies_is_cut_across_its_axis_too(load, drawn):
    simulation, _, _ = load("camoo4_cylinder_lying.xml")
    across = cross_section(simulation.model, 0.0, normal=0)
    assert across.area(simulation.crystal.volume) == pytest.approx(25 * np.pi, rel=2e-3)
    panels = drawn("camoo4_cylinder_lying.xml").axes
    (title,) = (ax.get_title(loc="left") for ax in panels if ax.get_xlabel() == "y (mm)")
    assert title.startswith("Vertical plane x = 0 mm")


LID = """<shape type="rectangle" id="lid"><transform name="to_world"><scale value="3"/>
  <translate z="$crystal_height_mm"/></transform><ref id="crystal_to_air"/>
  <ref name="interior" id="crystal"/></shape></scene>"""


def test_what_is_wrong_with_a_scene_is_red(tmp_path, mcrim):
    """Of a scene that is not sound there was no picture."""
    path, red = tmp_path / "wrong.xml", (255, 31, 31)
    for text, values, drawn in (
        (BENCH.replace("</scene>", LID), {}, "crystal_top (line 109) and lid lie on each other"),
        (BENCH, {"n_gap": -1.0, "gap_mm": 0.07}, "no refractive index"),
        (
            BENCH.replace('"alpha_scat_per_cm" value="', '"alpha_scat_per_cm" value="-', 1),
            {"n_gap": -1.0},
            "negative",
        ),
        (BENCH.replace("</medium>", "</medum>", 1), {}, None),
    ):
        path.write_text(text, encoding="utf-8")
        checked = mcrim_api.check(path, **values)
        figure = checked.plot()
        texts = "\n".join(text.get_text().replace("\n", " ") for text in figure.texts)
        assert not checked.ok and bool(figure.axes) == (drawn is not None)
        assert (drawn or "   63    </medum>") in texts
        assert [p.text for p in checked.problems if p.text not in texts] == []  # all of them
        if drawn:
            assert "gap_mm" not in values or "gap_mm=0.07" in texts  # what is right is drawn
            assert "here" in [text.get_text() for text in figure.axes[0].texts]
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]
        assert (pixels == red).all(axis=2).sum() > (2000 if drawn else 300)
    # the command says what is wrong, and fails, as without a picture
    status, _, said = mcrim("check", str(path), "-o", str(tmp_path / "drawn.png"))
    assert status == 2 and "line 63" in said and (tmp_path / "drawn.png").stat().st_size > 5000
    mcrim.refused("check", tmp_path / "none.xml", "-o", tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def test_what_mirrors_and_what_is_black_is_called_so():
    """Both were diffuse reflectors, of 98 % and of no percentage."""
    sheet = functools.partial(Surface, "foil", 0, 0, DIFFUSE)
    white, mirror = sheet(reflectance=0.98), sheet(reflectance=0.98, mirror_part=1.0)
    black = sheet(reflectance=0.0)
    said = [face.kind_name for face in (white, mirror, black)]
    assert said == ["diffuse reflector", "mirror", "black surface"]


def test_detail_shows_the_gap_at_the_crystals_lower_edge(drawn):
    main, detail = drawn("camoo4").axes
    (x0, x1), (z0, z1) = detail.get_xlim(), detail.get_ylim()
    assert x0 < 5 < x1
    assert z0 < -0.05 < 0 < z1
    # the gap fills a good part of it, and the magnification is the one that is stated
    assert 0.05 / (z1 - z0) > 0.25
    times = np.ptp(main.get_xlim()) / np.ptp(detail.get_xlim())
    assert f"enlarged {times:.1f} times" in detail.get_title(loc="left")


def test_a_side_that_leans_is_straight_at_the_enlarged_edge(load):
    simulation, _, _ = load("camoo4_pyramid.xml")
    cut = cross_section(simulation.model, 0.0)
    # 5 mm from the axis below, 3 mm at a height of 10 mm
    for z_mm in (0.01, 0.05, 0.1):
        assert cut.levels(z_mm, 1)[-1] == pytest.approx(5.0 - 0.2 * z_mm, abs=1e-3)
    x_mm, z_mm = cut.corners(simulation.crystal.volume).T
    side = (x_mm > 3.0) & (z_mm > 1e-3)
    assert side.sum() > 1
    assert x_mm[side] == pytest.approx(5.0 - 0.2 * z_mm[side], abs=2e-3)


def test_png_holds_the_volumes_in_colours_that_differ_in_grey(drawn, tmp_path):
    path = tmp_path / "bench.PNG"
    write_cross_section(drawn("camoo4"), path)
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">I", header[16:20])[0] == 1800
    pixels = np.rint(255 * imread(path, format="png")[:, :, :3]).astype(int)
    greys = [255]
    for colour in COLOURS[:3]:
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (pixels == rgb).all(axis=2).mean() > 0.01
        greys.append(np.dot(rgb, (0.299, 0.587, 0.114)))
    assert min(abs(a - b) for a, b in combinations(greys, 2)) > 20
    assert not _pylab_helpers.Gcf.figs


def test_svg_and_pdf_are_sound(drawn, tmp_path):
    figure = drawn("camoo4")
    write_cross_section(figure, tmp_path / "bench.pdf")
    assert (tmp_path / "bench.pdf").read_bytes().startswith(b"%PDF")
    write_cross_section(figure, tmp_path / "bench.svg")
    root = ElementTree.parse(tmp_path / "bench.svg").getroot()
    assert root.tag.endswith("svg")
    assert sum(1 for _ in root.iter("{http://www.w3.org/2000/svg}path")) > 50


@cases("name", "words")
def test_refusals_name_the_file_and_say_how_to_mend_it(name, words, tmp_path):
    (tmp_path / "folder.png").mkdir()
    line = refusal(write_cross_section, Figure(), tmp_path / name)
    assert str(tmp_path / name) in line
    assert [word for word in words if word not in line] == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder.png"]
