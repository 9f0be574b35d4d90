"""The page's small picture of a bench shows what effects add to it, as large as it is."""

from types import SimpleNamespace

import pytest

from mcrim_mitsuba.app.bench_picture import bench_picture

BENCH = {
    "crystal_width_mm": 10.0,
    "crystal_height_mm": 10.0,
    "gap_mm": 0.05,
    "n_gap": 1.46,
    "window_width_mm": 28.0,
    "window_thickness_mm": 1.0,
    "aperture_radius_mm": 14.0,
}
LIGHT = SimpleNamespace(of_beam=False)
BARE = ("none", "top", "sides", "top sides")


def shapes(**more) -> list[dict]:
    return bench_picture(LIGHT, BENCH | more)["shapes"]


@pytest.mark.parametrize(
    ("name", "value", "kind", "side"),
    [
        ("bubble_fraction", 0.2, "air", "width"),
        ("collar_mm", 1.0, "liquid", "height"),
        ("chamfer_mm", 0.3, "air", "width"),
    ],
)
def test_what_is_added_grows_with_its_size(name, value, kind, side):
    (none, *small), (_, *large) = (
        shapes(**{name: size})[len(shapes()) - 1 :] for size in (value, 2 * value)
    )
    assert none == shapes()[-1]
    assert {shape["kind"] for shape in small} == {kind}
    for one, twice in zip(small, large, strict=True):
        assert twice[side] == pytest.approx(2 * one[side])


def test_rough_faces_reflectors_and_an_offset_mask_are_seen():
    assert len(shapes(rms_roughness_nm=5.0)) == len(shapes()) + 4
    assert len(shapes(ground_top_alpha=0.3)) == len(shapes()) + 1
    assert shapes(top_reflectance=0.9)[-1]["kind"] == "mask"
    # a wrapping is on the sides too, where it is not taken off
    faces = {bare: shapes(wrap_reflectance=0.98, bare=bare)[len(shapes()) :] for bare in BARE}
    assert [len(faces[bare]) for bare in BARE] == [3, 2, 1, 0]
    assert faces["sides"][0]["y"] < faces["top"][0]["y"] and {
        shape["kind"] for shape in faces["none"]
    } == {"mask"}
    left, right = (s for s in shapes(aperture_radius_mm=9.0, mask_offset_mm=4.0)[4:])
    assert left["width"] > 5 * right["width"] > 0
    # without a liquid there is neither bubble nor collar
    dry = shapes(n_gap=1.0, bubble_fraction=0.3, collar_mm=1.0)
    assert len(dry) == len(shapes())
