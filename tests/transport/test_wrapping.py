"""Wrappings of boxes, cylinders and prisms, which may touch them, mirror in part, or be paint.

In a closed cavity whose floor detects, closed forms know the answer. Statistical tests have fixed
seeds and compare at z < 4: right programs fail this file in one run of 500.
"""

import numpy as np
import pytest
from comparisons import assert_compatible, assert_same_light
from refusals import refusal

from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.reference.crosscheck import crosscheck
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.simulation import Simulation

Z = 4.0
WIDTH, HEIGHT, FILM = 10.0, 20.0, 0.02
_FACE = """<shape type="rectangle" id="{}"><transform name="to_world"><scale x="{}" y="{}"/>
  <rotate x="{}" y="{}" angle="{}"/><translate x="{}" y="{}" z="{}"/></transform>{}
  <ref name="interior" id="crystal"/></shape>"""
#: A crystal of index 1.8 whose bottom detects, wrapped; the film's lower rim reflects all.
_CAVITY = """<scene version="3.0.0">
  <default name="rho" value="1"/><default name="c" value="0"/><default name="s" value="0"/>
  <default name="alpha_abs_per_cm" value="0"/><integrator type="light_collection"/>
  <medium type="bulk" id="crystal"><float name="alpha_abs_per_cm" value="$alpha_abs_per_cm"/>
  </medium><emitter type="scintillation"><ref id="crystal"/></emitter>
  <bsdf type="dielectric" id="polish"><float name="int_ior" value="1.8"/>
    <float name="ext_ior" value="1.0"/></bsdf>{faces}
  <shape type="wrapping" id="wrapping"><float name="width" value="10"/>
    <float name="height" value="20"/><float name="film" value="0.02"/>
    <float name="contact" value="$c"/><float name="specular" value="$s"/>
    <bsdf type="diffuse"><spectrum name="reflectance" value="$rho"/></bsdf></shape>
  <shape type="frame" id="rim"><float name="outer_width" value="10.04"/>
    <float name="inner_width" value="10"/><bsdf type="diffuse">
    <spectrum name="reflectance" value="1"/></bsdf></shape></scene>"""


def _faces() -> str:
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
        ("bottom", half, half, 1, 0, 180, 0, 0, 0, '<bsdf type="photodetector"/>'),
    ]
    return "".join(_FACE.format(*face) for face in [*sides, *ends])


@pytest.fixture
def cavity(tmp_path):
    def load(**overrides) -> Simulation:
        path = tmp_path / "cavity.xml"
        path.write_text(_CAVITY.format(faces=_faces()))
        return Simulation(path, overrides, check=False)

    return load


@pytest.mark.parametrize("general", [False, True], ids=["flat", "general"])
@pytest.mark.parametrize(
    "numbers", [(0, 0), (0.05, 0), (0.4, 0), (1, 0), (0, 1), (0.4, 0.5), (1, 1)]
)
def test_what_loses_nothing_detects_all(cavity, numbers, general):
    contact, specular = numbers
    result = cavity(c=contact, s=specular).collect(20_000, seed=1, general=general)
    assert result.eta + result.budget["truncated"] == pytest.approx(1, abs=1e-4)
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


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name="c" value="0.1"', 'name="c" value="1.5"', "contact is 1.5; give 0 to 1"),
        ('name="s" value="0"', 'name="s" value="-1"', "specular is -1; give 0 to 1"),
        ('name="film" value="0.02"', 'name="film" value="-1"', "must be positive"),
        ('<spectrum name="reflectance" value="$rho"/>', "", "let it wear"),
        ('name="interior" id="crystal"', 'name="exterior" id="crystal"', "turn the face around: its normal"),
    ],
)
def test_what_cannot_touch_is_refused(tmp_path, old, new, says):
    text = _CAVITY.format(faces=_faces()).replace('name="c" value="0"', 'name="c" value="0.1"')
    assert old in text
    text = text.replace(old, new, 1)
    if says == "let it wear":
        head, _, tail = text.partition('<bsdf type="diffuse">')
        text = f'{head}<bsdf type="conductor">{tail}'
    (tmp_path / "cavity.xml").write_text(text)
    assert says in refusal(Simulation, tmp_path / "cavity.xml", check=False)


#: The solids of the shipped benches, what wraps each, and bounds that may be left out.
_SOLIDS = {
    "camoo4.xml": ('<float name="width" value="$crystal_width_mm"/>', 5.0),
    "camoo4_cylinder.xml": ('<float name="diameter" value="$crystal_diameter_mm"/>', 5.0),
    "camoo4_hexagonal.xml": (
        '<float name="width" value="$crystal_across_flats_mm"/><integer name="sides" value="6"/>',
        5.0,
    ),
}
_WRAPPED = """<scene version="3.0.0"><default name="rho" value="1"/>
  <default name="film_mm" value="0.02"/><default name="n_gap" value="1.46"/>
  <default name="alpha_abs_per_cm" value="0"/>
  {default}<include filename="{bench}"/>
  <shape type="wrapping" id="wrapping">{size}<float name="height" value="$crystal_height_mm"/>
    <float name="film" value="$film_mm"/>{numbers}
    <bsdf type="diffuse"><spectrum name="reflectance" value="$rho"/></bsdf></shape></scene>"""


@pytest.fixture
def wrapped(scenes, tmp_path):
    """A shipped bench with a wrapping around its crystal: what loads it, from its file."""

    def load(bench: str, numbers: str = "", size: str | None = None, **overrides) -> Simulation:
        (tmp_path / bench).write_text((scenes / bench).read_text())
        path = tmp_path / f"wrapped_{bench}"
        size = _SOLIDS[bench][0] if size is None else size
        path.write_text(_WRAPPED.format(bench=bench, size=size, numbers=numbers, default=""))
        return Simulation(path, overrides, check=False)

    return load
