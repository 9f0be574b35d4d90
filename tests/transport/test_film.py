"""Light through the film before a wrapping and back in one step: when it goes so, and that it fares
as light from face to face.

Statistical tests have fixed seeds; right programs fail this file in one run of 300.
"""

import numpy as np
import pytest
from comparisons import assert_same_light

from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.convex import convex_solids
from mcrim_mitsuba.transport.film import film_before
from mcrim_mitsuba.transport.simulation import Simulation

Z = 4.0


def wrapped(scenes, *effects, old="", new="", **overrides) -> Simulation:
    scene = read_scene(scenes / "camoo4_wrapped.xml")
    for effect in effects:
        scene = scene.edited(add(effect, scene))
    if old:
        text = (scenes / "camoo4_wrapped.xml").read_text()
        assert old in text
        scene = scene.edited(text.replace(old, new))
    return Simulation(scene, overrides, check=False)


def film_of(simulation: Simulation):
    volume = simulation.crystal.volume
    (solid,) = (s for s in convex_solids(simulation.model) if s.volume == volume)
    return film_before(simulation.model, solid)


def test_the_film_before_every_wall_is_found(scenes):
    film = film_of(wrapped(scenes, film_mm=0.3))
    assert len(film.walls) == 5 and film.distance_mm == pytest.approx(0.3, rel=1e-5)
    assert film.surface.reflectance == pytest.approx(0.97)
    model = wrapped(scenes).model
    names = [model.surfaces[model.flat_faces[number].surface].name for number in film.walls]
    assert sorted(names) == [f"crystal_side_{n}" for n in ("back", "front", "left", "right")] + [
        "crystal_top"
    ]


def test_films_of_one_geometry_differ_in_their_walls(scenes):
    kept = [film_of(wrapped(scenes, wrap_reflectance=r)).surface.reflectance for r in (0.9, 0.8)]
    assert kept == pytest.approx([0.9, 0.8])


@pytest.mark.parametrize("effect", ["wrap_contact", "wrap_specular"])
def test_a_wrapping_that_touches_or_mirrors_has_its_film(scenes, effect):
    assert film_of(wrapped(scenes, effect)) is not None


@pytest.mark.parametrize("effect", ["side_roughness", "surface_haze", "surface_absorption"])
def test_faces_that_do_more_than_refract_are_met_one_by_one(scenes, effect):
    film = film_of(wrapped(scenes, effect))
    # the top stays polished where the sides are rough
    assert film is None or len(film.walls) == 1


def test_nothing_may_stand_in_the_film(scenes):
    speck = '<shape type="disk" id="speck"><transform name="to_world"><scale value="0.1"/>'
    speck += '<translate z="10.1"/></transform><bsdf type="diffuse"><spectrum name="reflectance" '
    speck += 'value="0.5"/></bsdf></shape></scene>'
    assert film_of(wrapped(scenes, old="</scene>", new=speck, film_mm=0.3)) is None
    assert film_of(wrapped(scenes, film_mm=0.3)) is not None


def test_polarised_light_and_trails_go_from_face_to_face(scenes):
    paths = [
        wrapped(scenes).launcher().path,
        wrapped(scenes).launcher(fold=False).path,
        wrapped(scenes, polarization="true").launcher().path,
    ]
    assert [path.film is not None for path in paths] == [True, False, False]


def _random_bench(number: int) -> dict[str, float]:
    random = np.random.default_rng(number)
    return {
        "n_crystal": random.uniform(1.4, 2.2),
        "n_gap": random.choice([1.0, 1.46]),
        "wrap_reflectance": random.uniform(0.5, 1.0),
        "film_mm": 10 ** random.uniform(-2, 0.3),
        "crystal_width_mm": random.uniform(2, 12),
        "crystal_height_mm": random.uniform(2, 20),
        "alpha_scat_per_cm": 10 ** random.uniform(-2, 0.5),
        "alpha_abs_per_cm": 10 ** random.uniform(-2, -0.5),
    }


@pytest.mark.parametrize("number", range(6))
def test_light_fares_as_from_face_to_face(scenes, number):
    """Where all touches, and above a bare foot, reflections are not passed over."""
    touching = [["wrap_contact"], ["wrap_contact", "wrap_missing"], ["wrap_contact"]]
    effects = [[], ["wrap_specular"], [], *touching][number]
    values = {"wrap_contact": 1.0} if number == 5 else {}
    simulation = wrapped(scenes, *effects, **_random_bench(number), **values)
    assert simulation.launcher().path.film is not None
    assert_same_as_from_face_to_face(simulation, 400_000)


@pytest.mark.parametrize("scene", ["bgo_cylinder", "znwo4_hexagonal", "plastic_bar"])
def test_other_crystals_have_their_films(scenes, scene):
    simulation = Simulation(scenes / f"{scene}.xml", check=False)
    walls = film_of(simulation).walls
    # of a round wall and a lid, of six sides beside a lid in parts, of four sides
    assert len(walls) == {"bgo_cylinder": 2, "znwo4_hexagonal": 6, "plastic_bar": 4}[scene]
    assert_same_as_from_face_to_face(simulation, 200_000)


def assert_same_as_from_face_to_face(simulation: Simulation, photons: int) -> None:
    fast, slow = (simulation.collect(photons, seed=5 + fold, fold=fold) for fold in (True, False))
    assert_same_light(fast, slow, z_max=Z)
