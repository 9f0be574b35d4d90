"""Pictures: everything is labelled, the gap is seen, and what is no bench is refused in a line."""

import functools
import shutil
from itertools import combinations

import mitsuba as mi
import numpy as np
import pytest
from places import SCENES, tables_of
from refusals import refusal
from test_cross_section import TEXTS

from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.output.cross_section import heading
from mcrim_mitsuba.output.photograph import apart, render
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.photograph import surface_triangles
from mcrim_mitsuba.transport.photograph_parts import PhotographedBench
from mcrim_mitsuba.transport.simulation import Simulation

#: Scene, what is changed, and its parts, lowest first.
CASES = tables_of(__file__)["cases"]


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A function that renders a case once, small and coarse.

    Colours are looked at of two; of the others faces are as bright as their directions say: for
    light two kernels of 6,000 operations would be compiled for each.
    """
    folder, traced = tmp_path_factory.mktemp("scenes"), mi.render

    def directions(scene, **options):
        normals = mi.load_dict({"type": "aov", "aovs": "normal:sh_normal"})
        found = np.abs(np.array(traced(scene, integrator=normals, **options))[:, :, -3:])
        return found @ np.full((3, 3), [[0.9], [0.6], [0.3]])

    @functools.cache
    def rendered(case: str):
        scene, overrides, _ = CASES[case]
        path = SCENES / scene
        if not path.is_file():
            path = folder / f"{scene}.xml"
            text = TEXTS.get(scene) or add(scene, read_scene(SCENES / "camoo4.xml"))
            path.write_text(text, encoding="utf-8")
        if case in ("air", "gel"):
            return render(path, overrides, samples=2, scale=0.4)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(mi, "render", directions)
            return render(path, overrides, samples=1, scale=0.4)

    return rendered


@pytest.mark.parametrize("case", CASES)
def test_every_part_is_named_and_no_texts_overlap(case, picture):
    made = picture(case)
    assert sorted(made.parts) == sorted(CASES[case][2])
    named = {label.text for label in made.labels if label.target is not None}
    assert set(made.parts) <= named
    high, wide, _ = made.pixels.shape
    for label in made.labels:
        left, top, right, bottom = label.box
        assert 0 <= left < right <= wide and 0 <= top < bottom <= high
        if label.target is not None:
            assert 0 < label.target[0] < wide and 0 < label.target[1] < high
    for one, other in combinations(made.labels, 2):
        a, b = one.box, other.box
        clear = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
        assert clear, (one.text, other.text)
    assert made.view[60:-60, 90:-90].std() > 10  # and there is something to be seen


def colour_at(made, name: str) -> np.ndarray:
    """Mean colour a little to the left of where the leader of a part's label ends."""
    x, y = next(label.target for label in made.labels if label.text == name and label.target)
    x, y = round(x - 60 * 0.4), round(y)
    return made.pixels[y - 2 : y + 3, x - 4 : x + 5].reshape(-1, 3).mean(axis=0)


def test_gap_is_seen_and_gel_is_not_air(picture):
    floor = picture("air").pixels[-3:, -3:].reshape(-1, 3).mean(axis=0)
    air, gel = (colour_at(picture(case), "gap") for case in ("air", "gel"))
    for one, other in ((air, floor), (gel, floor), (air, gel)):
        assert np.abs(one - other).max() > 10
    red, green, blue = gel  # amber
    assert red > green > blue + 40
    # and at the enlarged edge: the layer in the middle is amber, or empty
    for case in ("air", "gel"):
        made = picture(case)
        box = next(label.box for label in made.labels if label.text.startswith("gap, n ="))
        x, y = round(box[0] - 10), round((box[1] + box[3]) / 2)
        red, green, blue = made.pixels[y - 1 : y + 2, x - 6 : x].reshape(-1, 3).mean(axis=0)
        assert (red > blue + 60) == (case == "gel")


def test_the_bench_alone_has_no_labels(picture):
    """A report's first picture was a crop of all, with a ring and "enlarged below"."""
    made = picture("gel")
    high, wide, _ = made.view.shape
    (ring,) = (label.box for label in made.labels if label.text == "enlarged below")
    left, top, right, bottom = (round(side) for side in ring)
    place = np.s_[top - 40 : bottom - 40, left:right]  # the panel begins 40 pixels below the top
    assert (high, wide) == (236, 356) and made.view[place].std() < 4
    assert made.pixels[top:bottom, left:right].std() > 20


def test_rims_of_plates_and_rough_faces_are_frosted(tmp_path):
    """A clear rim showed the plate's edges as a ladder; a hazy cube looked polished."""
    path = tmp_path / "hazy.xml"
    path.write_text(add("surface_haze", read_scene(SCENES / "camoo4.xml")), encoding="utf-8")
    for scene, hazy in ((SCENES / "camoo4.xml", False), (path, True)):
        model = Simulation(scene, check=False).model
        parts = PhotographedBench(model, surface_triangles(model), {"crystal": 2.0}).parts()
        rough = {
            part.name: [b.finish.roughness for b in part.bodies if b.finish.kind == "glass"]
            for part in parts
        }
        assert sorted(rough["window"]) == [0.0] * 3 + [0.4] * 4
        assert (min(rough["crystal"]) > 0.0) == hazy == (max(rough["crystal"]) > 0.0)


def test_detector_is_red(picture):
    red, green, blue = colour_at(picture("air"), "detector")
    assert red > 1.8 * max(green, blue)


def test_same_seed_gives_the_same_picture():
    # as large as the others, for which kernels are compiled
    one, same, other = (
        render(SCENES / "camoo4.xml", samples=1, scale=0.4, run=Run(seed=seed))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one.pixels, same.pixels)
    assert not np.array_equal(one.pixels, other.pixels)
    assert one.png() == same.png()


def test_labels_move_apart_in_their_order():
    tops = apart([10, 11, 12, 80], [10, 10, 10, 10], 0, 90)
    assert tops == pytest.approx([1, 11, 21, 80])
    assert apart([85, 86], [10, 10], 0, 90) == pytest.approx([70, 80])


UNSOUND = {
    "no file": (None, "no such file"),
    "no XML": ("something else", "line 1"),
    "no bench": ('<scene version="3.0.0"/>', "integrator"),
    "a face is missing": (
        (SCENES / "camoo4.xml")
        .read_text(encoding="utf-8")
        .replace(
            '<shape type="rectangle" id="crystal_top">',
            '<shape type="rectangle" id="crystal_top"><boolean name="flip_normals" value="true"/>',
        ),
        "crystal_top",
    ),
}


@pytest.mark.parametrize("case", UNSOUND)
def test_what_is_no_sound_bench_is_refused_as_check_does(case, tmp_path, mcrim):
    text, said = UNSOUND[case]
    scene = tmp_path / "bench.xml"
    if text is not None:
        scene.write_text(text, encoding="utf-8")
    refused = mcrim.refused("render", scene, "-o", tmp_path / "a.png")
    checked = mcrim("check", scene)
    assert (checked.status, checked.err) == (2, refused) and said in refused
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize("name", ["bench.jpg", "bench", "folder.png", "bench.xml", "no/a.png", "-"])
def test_bad_places_are_refused_before_any_work(name, here, mcrim):
    scene = shutil.copy(SCENES / "camoo4.xml", here / "bench.xml")
    (here / "folder.png").mkdir()
    mcrim.refused("render", scene, "-o", name)
    assert scene.read_bytes() == (SCENES / "camoo4.xml").read_bytes()


def test_variants_without_colour_are_refused():
    bench = SCENES / "camoo4.xml"
    assert "llvm_ad_rgb" in refusal(render, bench, run=Run(variant="llvm_ad_mono"))


def test_parameters_above_a_picture_break_between_each_other():
    for longer in range(8):
        parameters = {f"parameter_{'x' * longer}{number:02}": 10.0 for number in range(13)}
        first, second = heading("bench.xml", [], parameters)[1].split("\n")
        assert first.endswith(",") and second.startswith("parameter_")
