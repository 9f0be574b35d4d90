"""Light to and fro between a box's mirrors in one step: when it goes so, and that it fares as light
from face to face.

Statistical tests have fixed seeds; right programs fail this file in one run of 500.
"""

import numpy as np
import pytest
from comparisons import assert_same_light, z_score
from places import cases_of

from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.collection import Recorder
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

Z = 4.0


def mirrored(scenes, *effects, **values) -> Simulation:
    """The wrapped box in mirrors."""
    scene = read_scene(scenes / "camoo4_wrapped.xml")
    for effect in ("wrap_specular", *effects):
        scene = scene.edited(add(effect, scene))
    return Simulation(scene, {"wrap_specular": 1.0, **values}, check=False)


@cases("effects", "values", "goes")
def test_it_takes_mirrors_before_whole_polished_faces(scenes, effects, values, goes):
    path = mirrored(scenes, *effects, **values).launcher().path
    assert (path.shuttle is not None) == goes


@pytest.mark.parametrize("number", range(3))
def test_light_fares_as_from_face_to_face(scenes, number):
    """Flat and tall boxes, thin and thick films, mirrors that lose nothing."""
    random = np.random.default_rng(number)
    values = {
        "n_crystal": random.uniform(1.4, 2.2),
        "n_gap": random.choice([1.0, 1.46]),
        "wrap_reflectance": [0.9, 0.98, 1.0][number],
        "film_mm": [0.02, 0.35, 0.1][number],
        "crystal_width_mm": [3.0, 4.0, 12.0][number],
        "crystal_height_mm": [15.0, 9.0, 2.0][number],
        "alpha_scat_per_cm": 10 ** random.uniform(-2, 0),
        "alpha_abs_per_cm": 10 ** random.uniform(-2, -0.5),
    }
    simulation = mirrored(scenes, **values)
    assert simulation.launcher().path.shuttle is not None
    fast, slow = (simulation.collect(150_000, seed=7 + fold, fold=fold) for fold in (True, False))
    assert_same_light(fast, slow, z_max=Z)


def test_its_records_tell_what_it_has_passed(scenes):
    simulation = Simulation(scenes / "lyso_esr.xml", check=False)
    columns = ("reflections", "reflector_hits", "path_outside_cm")
    proposals = ScatteringProposals((0.2,), (SHARE_STEPS,), 0.02)
    means = []
    for fold in (True, False):
        recorder = Recorder(simulation, fold=fold)
        records = recorder.record(proposals, 4 * LANES, seed=fold, number=0, columns=columns)
        every = {"k": records.k, "path": records.path_cm, **records.further}
        per_batch = [
            np.bincount(records.batch, records.w * values, records.batches)
            for values in every.values()
        ]
        means.append([(sums.mean(), sums.std() / len(sums) ** 0.5) for sums in per_batch])
    for name, fast, slow in zip(every, *means, strict=True):
        assert abs(z_score(*fast, *slow)) < Z, name
