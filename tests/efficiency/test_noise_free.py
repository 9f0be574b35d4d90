"""The method `modes` of simulate and table: the solver on scenes."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from places import SCENES, cases_of

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)

SCENE = "scenes/camoo4.xml"


def test_a_scene_is_solved_as_its_bench():
    found = mcrim.simulate(SCENE, method="modes", n_gap=1.46, gap_mm=0.1)
    assert found.eta == float(solve_box(Bench(n_gap=1.46, gap_mm=0.1)).eta)
    assert (found.photons, found.eta_sigma > 0.0) == (0, True)
    assert "no statistical noise" in str(found)
    assert sum(found.budget.values()) == pytest.approx(1.0, abs=1e-5)


def test_a_table_lies_over_its_axes():
    made = mcrim.table(
        SCENE,
        method="modes",
        gap_mm=[0.02, 0.05],
        alpha_scat_per_cm=[0.1, 0.5, 1.0],
        alpha_abs_per_cm=[0.01, 0.1],
    )
    assert made.eta.shape == (2, 2, 3)
    assert list(made.axes) == ["gap_mm", "alpha_abs_per_cm", "alpha_scat_per_cm"]
    own = solve_box(Bench(gap_mm=0.02), 0.5, 0.1)
    assert made.eta[0, 1, 1] == pytest.approx(float(own.eta), rel=1e-12)
    assert (np.diff(made.eta, axis=1) < 0.0).all()
    assert len(made.rows) == 12


def test_progress_is_told_bench_by_bench():
    told = []
    run = mcrim.Run(progress=lambda what, done, total, note="": told.append((what, done, total)))
    mcrim.simulate(SCENE, method="modes", run=run)
    mcrim.table(SCENE, method="modes", gap_mm=[0.02, 0.05], run=run)
    counted = [(0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    assert told == [("solving without photons", *each) for each in counted]


def test_one_point_is_a_table_too():
    made = mcrim.table(SCENE, method="modes", n_gap=[1.0])
    assert made.eta.shape == (1,)
    assert made.eta[0] == pytest.approx(float(solve_box(Bench()).eta), rel=1e-12)


def test_a_precision_is_enough_or_is_said_to_be_too_much():
    found = mcrim.simulate(SCENE, method="modes", precision=1e-3)
    exact = mcrim.simulate(SCENE, method="modes")
    assert exact.eta_sigma < found.eta_sigma < 1e-3 * found.eta
    assert abs(found.eta - exact.eta) < found.eta_sigma
    assert "comes to" not in str(found)
    # a bench that few nodes do not do: it gets all
    made = mcrim.table(SCENE, method="modes", n_gap=[1.0, 1.74], n_crystal=2.2, precision=5e-4)
    assert (made.eta_sigma < 5e-4 * made.eta).all()
    too_much = mcrim.simulate(SCENE, method="modes", precision=1e-6)
    assert "the precision asked for is 0.0001 %; this method comes to 0.00" in str(too_much)


@cases("given", "said")
def test_what_does_not_fit_is_refused(given, said):
    with pytest.raises(InputError, match=said):
        mcrim.simulate(SCENE, **{"method": "modes", **given})


def test_no_other_bench_is_taken_for_it(tmp_path):
    """A mask at the detector and Rayleigh scattering, which have no parameter, were left out."""
    plain, solved = read_scene(SCENE), []
    overrides = {"n_gap": 1.46, "aperture_radius_mm": 6.0}
    benches = {path.name: read_scene(path) for path in sorted(SCENES.glob("*.xml"))}
    for name in catalogue():
        with contextlib.suppress(InputError):  # what camoo4.xml has nothing for
            benches[name] = plain.edited(add(name, plain))
    text = plain.path.read_text()
    shallow = '"light_collection"><integer name="max_depth" value="10"/>'
    benches["shallow"] = plain.edited(text.replace('"light_collection">', shallow, 1))
    glowing = text.replace('<ref id="crystal"/>', '<ref id="window"/>', 1)
    benches["glowing"] = plain.edited(glowing)
    for name, scene in benches.items():
        own = {n: v for n, v in overrides.items() if n in scene.parameters}
        with contextlib.suppress(InputError):
            solved.append(name)
            eta = mcrim.simulate(scene, method="modes", check=False, **own).eta
            found = mcrim.simulate(scene, photons=200_000, seed=1, check=False, **own)
            assert abs(found.eta - eta) < 4.5 * found.eta_sigma, name
            continue
        solved.pop()
    assert len(benches) > 50 and {"camoo4.xml", "source_depth"} <= set(solved)
