"""Wrappings of boxes, cylinders and prisms, which may touch them, mirror in part, or be paint.

In a closed cavity whose floor detects, closed forms know the answer. Statistical tests have fixed
seeds and compare at z < 4: right programs fail this file in one run of 500.
"""

import numpy as np
import pytest
from comparisons import assert_compatible, assert_same_light
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.reference.crosscheck import crosscheck
from mcrim_mitsuba.reference.scene_bench import read_bench
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

Z = 4.0
WIDTH, HEIGHT, FILM = 10.0, 20.0, 0.02
_FACE = """<shape type="rectangle" id="{}"><transform name="to_world"><scale x="{}" y="{}"/>
  <rotate x="{}" y="{}" angle="{}"/><translate x="{}" y="{}" z="{}"/></transform>{}
  <ref name="interior" id="crystal"/></shape>"""
#: A crystal of index 1.8, or another, wrapped; what its bottom wears. The film's lower rim reflects
#: all.
_CAVITY = """<scene version="3.0.0">
  <default name="rho" value="1"/><default name="c" value="0"/><default name="s" value="0"/>
  <default name="film" value="0.02"/><default name="bare" value="0"/><default name="n" value="1.8"/>
  <default name="alpha_abs_per_cm" value="0"/><default name="alpha_scat_per_cm" value="0"/>
  <integrator type="light_collection"/>
  <medium type="bulk" id="crystal"><float name="alpha_abs_per_cm" value="$alpha_abs_per_cm"/>
    <float name="alpha_scat_per_cm" value="$alpha_scat_per_cm"/>
  </medium><emitter type="scintillation"><ref id="crystal"/></emitter>
  <bsdf type="dielectric" id="polish"><float name="int_ior" value="$n"/>
    <float name="ext_ior" value="1.0"/></bsdf>{faces}
  <shape type="wrapping" id="wrapping">{size}
    <float name="height" value="20"/><float name="film" value="$film"/>
    <float name="contact" value="$c"/><float name="specular" value="$s"/>
    <float name="missing" value="$bare"/>{without}
    <bsdf type="diffuse"><spectrum name="reflectance" value="$rho"/></bsdf></shape>
  <shape type="frame" id="rim"><float name="outer_width" value="18"/>{hole}
    <bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf></shape></scene>"""
_DETECTOR = '<bsdf type="photodetector"/>'


def _box(bottom: str) -> str:
    half, middle, polished = WIDTH / 2, HEIGHT / 2, '<ref id="polish"/>'
    sides = [
        (f"side_{n}", *sizes, x, y, angle, half * along[0], half * along[1], middle, polished)
        for n, (sizes, x, y, angle, along) in enumerate(
            [
                ((middle, half), 0, 1, 90, (1, 0)),
                ((middle, half), 0, 1, -90, (-1, 0)),
                ((half, middle), 1, 0, -90, (0, 1)),
                ((half, middle), 1, 0, 90, (0, -1)),
            ]
        )
    ]
    ends = [
        ("top", half, half, 1, 0, 0, 0, 0, HEIGHT, polished),
        ("bottom", half, half, 1, 0, 180, 0, 0, 0, bottom),
    ]
    return "".join(_FACE.format(*face) for face in [*sides, *ends])


_UP, _TURN = '<translate z="20"/>', '<rotate x="1" angle="180"/>'
_END = """<shape type="{}" id="{}">{}<transform name="to_world">{}</transform>{}
  <ref name="interior" id="crystal"/></shape>"""


def _solid(kind: str, sizes: str, side: str, bottom: str) -> str:
    """Faces of a crystal whose ends are of a kind of shape."""
    scale = '<scale x="5" y="5"/>' if kind == "disk" else ""
    top = _END.format(kind, "top", sizes, scale + _UP, '<ref id="polish"/>')
    return side + top + _END.format(kind, "bottom", sizes, scale + _TURN, bottom)


_SIX = '<integer name="sides" value="6"/>'
_ACROSS = '<float name="width" value="10"/>'


def _cavity(form: str, bottom: str = _DETECTOR, without: str = "") -> str:
    """A scene's text, of a crystal 20 mm high and 10 mm wide."""
    kept = f'<string name="without" value="{without}"/>' if without else ""
    if form == "box":
        hole = '<float name="inner_width" value="10"/>'
        return _CAVITY.format(faces=_box(bottom), size=_ACROSS, hole=hole, without=kept)
    if form == "prism":
        side = _END.format(
            "prism_sides",
            "side",
            f'{_ACROSS}{_SIX}<float name="height" value="20"/>',
            "",
            '<ref id="polish"/>',
        )
        faces = _solid("polygon", _ACROSS + _SIX, side, bottom)
        hole = f'<float name="inner_width" value="10"/>{_SIX}'
        return _CAVITY.format(faces=faces, size=_ACROSS + _SIX, hole=hole, without=kept)
    scale = '<scale x="5" y="5" z="20"/>'
    side = _END.format("cylinder", "side", "", scale, '<ref id="polish"/>')
    return _CAVITY.format(
        faces=_solid("disk", "", side, bottom),
        size='<float name="diameter" value="10"/>',
        hole='<float name="inner_diameter" value="10"/>',
        without=kept,
    )


FORMS = ("box", "cylinder", "prism")


@pytest.fixture
def cavity(tmp_path):
    def load(form="box", bottom=_DETECTOR, without="", **overrides) -> Simulation:
        path = tmp_path / "cavity.xml"
        path.write_text(_cavity(form, bottom, without))
        return Simulation(path, overrides, check=False)

    return load


@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
def test_ground_faces_take_their_part_before_a_wrapping_that_touches_them(tmp_path, general):
    """Of what meets them they take 0.2, and the wrapping half of the rest: it had half of all."""
    ground = """<bsdf type="polish" id="polish"><float name="roughness_alpha" value="0.3"/>
      <float name="ground_loss" value="0.2"/>"""
    path = tmp_path / "ground.xml"
    path.write_text(_cavity("box").replace('<bsdf type="dielectric" id="polish">', ground))
    simulation = Simulation(path, {"c": 1, "rho": 0.5}, check=False)
    budget = simulation.collect(100_000, seed=81, general=general).budget
    part = budget["absorbed_surface"] / (budget["absorbed_surface"] + budget["absorbed_reflector"])
    assert abs(part - 1 / 3) < Z * np.sqrt(2 / 9 / 60_000)


@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("contact", "specular"), [(0, 0), (0.05, 0), (1, 0), (0, 1), (0.4, 0.5)])
@pytest.mark.parametrize("film", [0.02, 1.0, 0.0])
def test_what_loses_nothing_detects_all(cavity, form, contact, specular, film, general):
    simulation = cavity(form, c=contact, s=specular, film=film)
    result = simulation.collect(4_096, seed=1, general=general)
    # what is mirrored along a round wall for ever, Mitsuba loses sometimes
    assert result.eta + result.budget["truncated"] == pytest.approx(
        1, abs=3e-4 if general else 1e-4
    )
    # what flies along the floor, mirrored for ever
    assert result.budget["truncated"] < 5e-3


@pytest.mark.parametrize("rho", [0.9, 0.3])
def test_a_mirror_without_a_film_is_a_box_of_images(cavity, rho):
    """rho^m exp(-a L) of straight light that passes m walls of mirrored boxes to the floor."""
    ours = cavity(c=1, s=1, rho=rho, alpha_abs_per_cm=0.1).collect(400_000, seed=2)
    rng, count = np.random.default_rng(3), 1_000_000
    cosine, azimuth = 2 * rng.random(count) - 1, 2 * np.pi * rng.random(count)
    sine = np.sqrt(1 - cosine**2)
    # down at once, or by the image of the floor above the top
    up = cosine > 0
    length = (np.where(up, 2 * HEIGHT, 0) + np.where(up, -1, 1) * HEIGHT * rng.random(count)) / abs(
        cosine
    )
    walls = sum(
        abs(np.floor(rng.random(count) + length * sine * along(azimuth) / WIDTH))
        for along in (np.cos, np.sin)
    )
    weight = rho ** (walls + up) * np.exp(-0.01 * length)
    sigma = weight.std() / np.sqrt(count)
    assert_compatible(ours.eta, ours.eta_sigma, weight.mean(), sigma, z_max=Z)


def test_both_paths_agree(cavity):
    simulation = cavity(c=0.2, s=0.5, rho=0.9, alpha_abs_per_cm=0.05)
    fast, slow = (simulation.collect(200_000, seed=4 + g, general=bool(g)) for g in (0, 1))
    assert fast.transport != slow.transport and fast.budget["absorbed_reflector"] > 0.2
    assert_same_light(fast, slow, z_max=Z)


@pytest.mark.parametrize("form", FORMS)
def test_a_contact_that_hardly_ever_is_leaves_a_bare_strip_as_it_is(cavity, form):
    """Light from inside that met the strip went on as if it had come from outside."""
    size = {"rho": 0.9, "bare": 0.4, "alpha_scat_per_cm": 0.2}
    with_contact, without = (cavity(form, c=c, **size).collect(100_000, seed=6) for c in (1e-6, 0))
    assert without.budget["escaped"] > 0.1
    assert_same_light(with_contact, without, z_max=Z)


def test_polarised_light_is_mirrored_as_in_the_other_program(scenes):
    """At little scattering, which would depolarise; a metal turns one component round."""
    scene = read_scene(scenes / "camoo4_wrapped.xml")
    for effect, size in (("wrap_specular", 1.0), ("wrap_contact", 0.2)):
        scene = scene.edited(add(effect, scene, {effect: size}))
    numbers = {"polarization": True, "alpha_scat_per_cm": 0.02}
    assert crosscheck(scene, numbers, run=Run(60_000, seed=7)).agrees


def test_what_is_within_the_wrapping_touches_it_and_no_more(scenes):
    """Not the crystal's foot over a bubble, which borders air as well."""
    scene = read_scene(scenes / "camoo4_wrapped.xml")
    for effect in ("gap_bubble", "wrap_contact"):
        scene = scene.edited(add(effect, scene))
    model = Simulation(scene, {"n_gap": 1.46}, check=False).model
    assert "crystal_bottom_bubble" in [surface.name for surface in model.surfaces]
    touched = [surface.name for surface in model.surfaces if surface.contact]
    assert touched == [
        "crystal_top",
        *(f"crystal_side_{s}" for s in "right left back front".split()),
    ]


@cases("old", "new", "says")
def test_what_cannot_touch_is_refused(tmp_path, old, new, says):
    text = _cavity("box").replace('name="c" value="0"', 'name="c" value="0.1"')
    assert old in text
    text = text.replace(old, new, 1)
    if says == "let it wear":
        head, _, tail = text.partition('<bsdf type="diffuse">')
        text = f'{head}<bsdf type="conductor">{tail}'
    (tmp_path / "cavity.xml").write_text(text)
    assert says in refusal(Simulation, tmp_path / "cavity.xml", check=False)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("", "", ()),
        ('"height" value="20"', '"height" value="21"', ("the top of wrapping: 1 mm from what",)),
        (_ACROSS, _ACROSS.replace("10", "14"), ("the sides of wrapping: 2 mm from what it",)),
    ],
)
def test_a_wrapping_that_stands_off_gets_a_note(tmp_path, old, new, note):
    """A crystal that is smaller than its tape was told to be as large, and sound."""
    (tmp_path / "cavity.xml").write_text(_cavity("box").replace(old, new, 1))
    simulation = Simulation(tmp_path / "cavity.xml", check=False)
    assert [text[: len(says)] for text, says in zip(simulation.model.notes, note, strict=True)] == [
        *note
    ]
    assert simulation.collect(4096).notes[-len(note) :] == simulation.model.notes or not note


@pytest.mark.parametrize("size", ['value="10.2"', 'value="9.8"'])
def test_paint_lies_on_its_crystal(tmp_path, size):
    text = _cavity("cylinder").replace('name="film" value="0.02"', 'name="film" value="0"')
    path = tmp_path / "cavity.xml"
    path.write_text(text.replace('"diameter" value="10"', f'"diameter" {size}'))
    assert "own sizes" in refusal(Simulation, path, check=False)


# ---- equilibrium --------------------------------------------------------------------------------

#: A hole in a white mask on the bottom: a small port, through which light is detected.
_HOLE = """<bsdf type="aperture"><float name="radius" value="1"/>
  <float name="reflectance" value="1"/><bsdf type="photodetector"/></bsdf>"""
#: Perimeter and area of what is so wide across flats, over the width and its square.
_OUTLINE = {
    "box": (4.0, 1.0),
    "cylinder": (np.pi, np.pi / 4.0),
    "prism": (6.0 / np.sqrt(3.0), np.sqrt(3.0) / 2.0),
}


def _from_air(index: float) -> float:
    """What a face lets through of light that comes from all directions of the air."""
    cosine = (np.arange(20_000) + 0.5) / 20_000
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (index * cosine - inside) / (index * cosine + inside)
    return float(1.0 - np.mean((s**2 + p**2) * cosine))


@pytest.mark.parametrize("form", FORMS)
@cases("numbers")
def test_an_integrating_cavity_shares_its_light_by_areas(cavity, form, numbers):
    """Light that has gone round often is as bright all over, n^2 brighter in the crystal.

    A small port of area A takes n^2 A over that with all losses: n^2 (1 - R) of the areas that are
    met from inside, X of what is bare, X (1 - c) a / (X + a) of the film, whose reflector loses
    a = (1 - R) area; X = T area is what passes between crystal and air. The rest, of the order of
    the port over the cavity's cross-section, is 2 %.
    """
    index, contact = 1.5, numbers.get("c", 0.0)
    simulation = cavity(form, _HOLE, n=index, alpha_scat_per_cm=1.0, **numbers)
    result = simulation.collect(20_000, seed=5)
    perimeter, area = _OUTLINE[form]
    film, loss = numbers["film"], 1.0 - numbers["rho"]
    side, top = perimeter * WIDTH * HEIGHT, area * WIDTH**2
    passes = _from_air(index)
    if film:
        wide = WIDTH + 2.0 * film
        outside = loss * (perimeter * wide * (HEIGHT + film) + area * wide**2)
        passes *= side + top
        losses = passes * (1.0 - contact) * outside / (passes + outside)
        losses += index**2 * contact * loss * (side + top)
    else:
        bare = side if "without" in numbers else 0.0
        losses = index**2 * loss * (side + top - bare) + passes * bare
    expected = index**2 * np.pi / (index**2 * np.pi + losses)
    assert result.eta == pytest.approx(expected, abs=4.0 * result.eta_sigma + 0.02 * expected)


_WHITE = """<bsdf type="twosided"><bsdf type="diffuse">
  <spectrum name="reflectance" value="0.9"/></bsdf></bsdf>"""


def _by_hand(form: str, film: float, bare: float) -> str:
    """The faces of a crystal that is bare up to a height, and what is around it, as shapes."""
    kind, props, scale, wall = {
        "prism": ("polygon", _ACROSS + _SIX, "", "prism_sides"),
        "cylinder": ("disk", "", '<scale x="5" y="5"/>', "cylinder"),
    }[form]

    def side(name, low, high, width, wears, inwards=False):
        sizes, steps = "", f'<translate z="{low}"/>'
        if form == "prism":
            sizes = f'<float name="width" value="{width}"/>{_SIX}'
            sizes += f'<float name="height" value="{high - low}"/>'
        else:
            steps = f'<scale x="{width / 2}" y="{width / 2}" z="{high - low}"/>{steps}'
        text = _END.format(wall, name, sizes, steps, wears)
        return text if not inwards else text.replace('<ref name="interior" id="crystal"/>', "")

    def end(name, level, wears, width=10, inside=True):
        sizes, steps = f'<float name="width" value="{width}"/>{_SIX}', f'<translate z="{level}"/>'
        if form == "cylinder":
            sizes, steps = "", f'<scale x="{width / 2}" y="{width / 2}"/>{steps}'
        text = _END.format(kind, name, sizes, steps, wears)
        return text if inside else text.replace('<ref name="interior" id="crystal"/>', "")

    polish = '<ref id="polish"/>'
    bottom = _END.format(kind, "bottom", props, scale + _TURN, _DETECTOR)
    if not film:
        lower, upper = side("low", 0, bare, 10, polish), side("high", bare, HEIGHT, 10, _WHITE)
        return bottom + lower + upper + end("top", HEIGHT, _WHITE)
    wide = WIDTH + 2 * film
    around = side("sleeve", bare, HEIGHT + film, wide, _WHITE, inwards=True)
    around += end("lid", HEIGHT + film, _WHITE, wide, inside=False)
    return bottom + side("all", 0, HEIGHT, 10, polish) + end("top", HEIGHT, polish) + around


@pytest.mark.parametrize("form", ["cylinder", "prism"])
@pytest.mark.parametrize("film", [0.0, 0.5], ids=["paint", "film"])
def test_a_bare_foot_is_that_of_faces_written_one_by_one(tmp_path, form, film):
    text = _cavity(form)
    before, rim = text[: text.index("<shape")], text[text.index('<shape type="frame"') :]
    own = '<bsdf type="diffuse"><spectrum name="reflectance" value="$rho"/></bsdf></shape>'
    assert own in text
    results = []
    for seed, written, numbers in (
        (6, text.replace(own, f"{_WHITE}</shape>"), {"film": film, "bare": 0.1}),
        (7, before + _by_hand(form, film, 2.0) + rim, {}),
    ):
        path = tmp_path / f"{seed}.xml"
        path.write_text(written)
        simulation = Simulation(path, {"n": 1.5, "alpha_scat_per_cm": 0.3} | numbers, check=False)
        results.append(simulation.collect(150_000, seed=seed))
    assert results[0].budget["escaped"] > 0.05
    assert_same_light(*results, z_max=Z)


def test_a_black_rim_takes_what_the_whole_chip_would_detect(scenes):
    whole, rimmed = (
        Simulation(
            scenes / "lyso_teflon.xml", {"rim_reflectance": 0, "dead_rim_mm": rim}, check=False
        ).collect(200_000, seed=8)
        for rim in (0.0, 0.7)
    )
    assert rimmed.eta < 0.9 * whole.eta
    lost = rimmed.budget["absorbed_reflector"] - whole.budget["absorbed_reflector"]
    sigma = np.hypot(whole.eta_sigma, rimmed.eta_sigma)
    assert_compatible(rimmed.eta + lost, sigma, whole.eta, 0.0, z_max=Z)


def test_paint_does_not_reach_a_neighbour_in_the_other_program(tmp_path):
    """A face 1 mm beside the painted crystal was painted: `crosscheck` blamed Mitsuba."""
    beside = """<medium type="bulk" id="other"/><shape type="cube" id="beside">
      <transform name="to_world"><scale value="5"/><translate x="11" z="5"/></transform>
      <ref id="polish"/><ref name="interior" id="other"/></shape></scene>"""
    path = tmp_path / "two.xml"
    path.write_text(_cavity("box").replace("</scene>", beside))
    surfaces = {s.name: s for s in read_bench(read_scene(path, {"film": 0})).surfaces}
    assert [face.wrapping for face in surfaces["side_0"].faces] == ["wrapping"]
    assert not any(face.wrapping for face in surfaces["beside"].faces)
