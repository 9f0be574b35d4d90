"""Mitsuba and the independent NumPy tracer agree, on the shipped scenes and on other benches.

All z-scores together are tested at a family-wise false-alarm level of 1 %, with fixed seeds.
`scripts/validate` does the same at a higher precision, on more benches and with Geant4.
"""

import dataclasses

import pytest
from places import tables_of
from scipy.stats import kstest, norm

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.reference import tracer as module
from mcrim_mitsuba.reference.crosscheck import FAMILY_LEVEL, crosscheck

TABLES = tables_of(__file__)
BENCHES = TABLES["benches"]


def test_mitsuba_equals_the_numpy_tracer(scenes):
    scores, etas = {}, []
    for number, (scene, change) in enumerate(BENCHES):
        found = crosscheck(scenes / f"{scene}.xml", change, run=Run(40_000, seed=100 + number))
        for row in found.rows:
            if row.z is not None:
                scores[(scene, *change.items(), row.quantity)] = row.z
        etas.append(found.rows[0].z)
    where = max(scores, key=lambda key: abs(scores[key]))
    p_value = len(scores) * 2 * norm.sf(abs(scores[where]))
    assert p_value > FAMILY_LEVEL, (where, scores[where], p_value)
    # the etas are independent of each other: their z-scores are a standard normal sample
    p_value = kstest(etas, norm.cdf).pvalue
    assert p_value > FAMILY_LEVEL, (p_value, etas)


def test_the_crosscheck_can_fail(scenes, monkeypatch):
    """A reference whose index is 1 % off must not pass unseen."""
    honest = module.trace

    def other_bench(bench, *arguments, **options):
        return honest(dataclasses.replace(bench, n_crystal=2.03), *arguments, **options)

    monkeypatch.setattr(module, "trace", other_bench)
    assert not crosscheck(scenes / "camoo4.xml", run=Run(150_000, seed=1)).agrees


def test_another_bench_than_the_parameters_describe_is_refused(scenes, tmp_path):
    """The tracer builds its bench from names: a scene without the mask is not comparable."""
    text = (scenes / "camoo4.xml").read_text()
    path = tmp_path / "open.xml"
    path.write_text(text.replace('<ref id="masked_window_to_air"/>', '<ref id="window_to_air"/>'))
    with pytest.raises(InputError, match=r"line \d+: .*differs from it at window_beside_gap"):
        crosscheck(path, run=Run(1000))
