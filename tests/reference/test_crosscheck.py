"""Mitsuba and the independent tracer agree, on the shipped scenes and on other benches.

All z-scores together are tested at a family-wise false-alarm level of 1 %, with fixed seeds.
`scripts/validate` does the same at a higher precision, on more benches and with Geant4.
"""

from pathlib import Path

import pytest
from bench_scene import bench_scene
from places import tables_of
from scipy.stats import kstest, norm

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.reference import tracer as module
from mcrim_mitsuba.reference.crosscheck import FAMILY_LEVEL, crosscheck
from mcrim_mitsuba.scene.scene_file import read_scene

TABLES = tables_of(__file__)
BENCHES = TABLES["benches"]


#: Benches of a user, where they are.
TRIALS = sorted(Path("/work/shared/trials/lyso").glob("*.xml"))


def test_mitsuba_equals_the_independent_tracer(scenes):
    scores, etas = {}, []
    benches = [(scenes / f"{scene}.xml", change) for scene, change in BENCHES]
    benches += [(path, {}) for path in TRIALS]
    for number, (path, change) in enumerate(benches):
        found = crosscheck(path, change, run=Run(40_000, seed=100 + number, check=False))
        for row in found.rows:
            if row.z is not None:
                scores[(path.stem, *change.items(), row.quantity)] = row.z
        etas.append(found.rows[0].z)
    where = max(scores, key=lambda key: abs(scores[key]))
    p_value = len(scores) * 2 * norm.sf(abs(scores[where]))
    assert p_value > FAMILY_LEVEL, (where, scores[where], p_value)
    # the etas are independent of each other: their z-scores are a standard normal sample
    p_value = kstest(etas, norm.cdf).pvalue
    assert p_value > FAMILY_LEVEL, (p_value, etas)


def test_every_shipped_scene_is_compared(scenes):
    assert {f"{scene}.xml" for scene, _ in BENCHES} >= {path.name for path in scenes.glob("*.xml")}


def test_the_crosscheck_can_fail(scenes, monkeypatch):
    """A reference whose index is 1 % off must not pass unseen."""
    honest = module.trace

    def other_bench(bench, *arguments, **options):
        return honest(bench_scene(n_crystal=2.03), *arguments, **options)

    monkeypatch.setattr(module, "trace", other_bench)
    assert not crosscheck(scenes / "camoo4.xml", run=Run(150_000, seed=1)).agrees


def test_uneven_scattering_behind_a_round_wall(scenes):
    """Where no collision came of it, the tracer's light was still on the wall, and missed it."""
    scene = read_scene(scenes / "csi_photodiode.xml")
    uneven = add("scattering_gradient", scene, {"scattering_gradient": 0.45})
    assert crosscheck(scene.edited(uneven), run=Run(50_000, seed=1)).agrees


def test_light_that_a_clear_crystal_keeps_is_cut_off_after_as_many_flights(scenes):
    """Mitsuba passed over reflections, the tracer did not: 1 % was cut off there, nothing here."""
    compared = crosscheck(
        scenes / "luag_fibre.xml", {"alpha_scat_per_cm": 0.0}, run=Run(20_000, seed=1)
    )
    assert compared.agrees
    (cut_off,) = (row for row in compared.rows if row.quantity == "truncated")
    assert cut_off.z is not None


def test_a_scene_that_shall_not_be_checked_is_not(scenes):
    """It was, whatever the run said: here a gap that looks like micrometres."""
    run = Run(1000, seed=2, check=False)
    assert crosscheck(scenes / "camoo4.xml", {"gap_mm": 50.0}, run=run).rows
    with pytest.raises(InputError, match="micrometres"):
        crosscheck(scenes / "camoo4.xml", {"gap_mm": 50.0}, run=Run(1000))


def test_a_part_that_the_tracer_does_not_know_is_named(scenes, tmp_path):
    """A plate of plastic beside the crystal, which Mitsuba's own plugin knows."""
    plate = """<shape type="sphere" id="pearl"><point name="center" x="9" y="0" z="5"/>
      <bsdf type="plastic"/></shape></scene>"""
    path = tmp_path / "pearl.xml"
    path.write_text((scenes / "camoo4.xml").read_text().replace("</scene>", plate))
    with pytest.raises(InputError, match=r"pearl.xml, line \d+: .*a bsdf of type plastic"):
        crosscheck(path, run=Run(1000))
