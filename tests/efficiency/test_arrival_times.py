"""Arrival times against closed forms: spheres of one index, a slab, exponential decays.

Random tests have fixed seeds; a right program fails one of them in a thousand runs, where nothing
else is said.
"""

import numpy as np
import pytest
from places import SCENES, cases_of
from scipy.integrate import quad
from scipy.optimize import brentq

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency import time_distribution as distribution
from mcrim_mitsuba.efficiency.arrival_times import MM_PER_PS
from mcrim_mitsuba.optics.materials import material
from mcrim_mitsuba.reference.tracer import trace

cases = cases_of(__file__)

BENCH = SCENES / "camoo4.xml"
#: chi2 of ten below and above it in one run in 1,000 each, and |z| of one.
CHI2_OF_TEN, LARGEST_Z = (1.48, 29.6), 3.3
RADIUS, INDEX = 10.0, 1.8
#: A ball whose surface detects; light is born in all of it, or in a core of the same index.
BALL = """<scene version="3.0.0"><integrator type="light_collection"/>
<medium type="bulk" id="crystal"/>{medium}
<emitter type="scintillation"><ref id="crystal"/></emitter>{core}
<shape type="sphere" id="wall"><float name="radius" value="10"/>
<bsdf type="photodetector"/><ref name="interior" id="{inside}"/></shape></scene>"""
CORE = """<shape type="sphere" id="core"><float name="radius" value="0.002"/>
<bsdf type="dielectric"><float name="int_ior" value="1.5"/>
<float name="ext_ior" value="1.5"/></bsdf>
<ref name="interior" id="crystal"/><ref name="exterior" id="liquid"/></shape>"""


def ball(folder, core: bool):
    file = folder / "ball.xml"
    parts = {"core": CORE, "medium": '<medium type="bulk" id="liquid"/>', "inside": "liquid"}
    none = {"core": "", "medium": "", "inside": "crystal"}
    file.write_text(BALL.format(**(parts if core else none)))
    return file


def arrived(time_ps: float) -> float:
    """Part of the light of a ball that is born everywhere, of density 3/4R (1 - (l/2R)^2)."""
    path = np.clip(time_ps * MM_PER_PS / INDEX / RADIUS, 0.0, 2.0)
    return 0.75 * (path - path**3 / 12.0)


def test_light_from_the_centre_of_a_ball_arrives_at_once(tmp_path):
    indices = {"crystal": 5.0, "liquid": INDEX}
    given = {"group_index": indices, "photons": 20_000, "check": False}
    found = mcrim.arrival_times(ball(tmp_path, core=True), **given)
    at_once = INDEX * RADIUS / MM_PER_PS
    # half precision of the path, and the core's two thousandths of a millimetre
    assert found.mean_ps == pytest.approx(at_once, rel=1e-3) and found.rms_ps < 0.06
    assert found.first[0].mean_ps == pytest.approx(at_once, rel=2e-3)
    assert {one.name: one.group_index for one in found.parts} == indices | {"outside": 1.0}
    later = mcrim.arrival_times(ball(tmp_path, core=True), decay_ns=2.0, detected=5, **given)
    waiting = 2000.0 / (5.0 - np.arange(5))
    assert later.first[0].mean_ps == pytest.approx(at_once + waiting.cumsum(), rel=1e-3)
    assert later.first[0].rms_ps == pytest.approx(np.sqrt((waiting**2).cumsum()), rel=1e-3)
    assert later.rise_ps == pytest.approx(2000.0 * np.log(9.0), rel=1e-3)


def test_light_from_all_of_a_ball(tmp_path):
    """Mean, rms, rise, histogram and first photons of ten runs, with their errors."""
    scale, photons = INDEX * RADIUS / MM_PER_PS, 100
    first = quad(lambda t: (1.0 - arrived(t)) ** photons, 0.0, 2.0 * scale)[0]
    square = quad(lambda t: 2.0 * t * (1.0 - arrived(t)) ** photons, 0.0, 2.0 * scale)[0]
    ends = [brentq(lambda t, p=p: arrived(t) - p, 0.0, 2.0 * scale) for p in (0.1, 0.9)]
    expected = {
        "mean_ps": 0.75 * scale,
        "rms_ps": scale * np.sqrt(0.8 - 0.75**2),
        "begin_ps": ends[0],
        "rise_ps": ends[1] - ends[0],
    }
    zs: dict[str, list[float]] = {}
    parts = []
    for seed in range(10):
        found = mcrim.arrival_times(
            ball(tmp_path, core=False),
            group_index={"crystal": INDEX},
            detected=photons,
            photons=30_000,
            seed=seed,
        )
        for name, value in expected.items():
            z = (getattr(found, name) - value) / getattr(found, f"{name}_sigma")
            zs.setdefault(name, []).append(z)
        one = found.first[0]
        zs.setdefault("first", []).append((one.mean_ps[0] - first) / one.mean_ps_sigma[0])
        rms = np.sqrt(square - first**2)
        zs.setdefault("its rms", []).append((one.rms_ps[0] - rms) / one.rms_ps_sigma[0])
        part = np.diff([arrived(t) for t in found.edges_ps])
        parts.append(((found.part - part) / found.part_sigma)[part > 1e-3])
    for name, values in zs.items():
        assert CHI2_OF_TEN[0] < np.square(values).sum() < CHI2_OF_TEN[1], (name, values)
    # neighbours hardly correlate: z of 500 bins and more
    together = np.concatenate([each[:50] for each in parts])
    assert 0.8 < together.std() < 1.25


def test_weights_of_a_beam_in_a_slab():
    """Round trips between two faces: a geometric series, dimmed by absorption."""
    index, group, absorption, length = 4.0, 4.4, 0.5, 10.0
    found = mcrim.arrival_times(
        SCENES / "spectrophotometer.xml",
        group_index={"crystal": group},
        n_crystal=index,
        alpha_abs_per_cm=absorption,
        alpha_scat_per_cm=0,
        acceptance_deg=90,
        photons=300_000,
        seed=5,
    )
    again = ((index - 1.0) / (index + 1.0)) ** 4 * np.exp(-2.0 * absorption * length / 10.0)
    trip = 2.0 * length * group / MM_PER_PS
    (crystal,) = (one for one in found.parts if one.name == "crystal")
    expected = 0.5 * trip + trip * again / (1.0 - again)
    assert abs(crystal.mean_ps - expected) < LARGEST_Z * crystal.mean_ps_sigma
    rms = trip * np.sqrt(again) / (1.0 - again)
    assert abs(found.rms_ps - rms) < LARGEST_Z * found.rms_ps_sigma
    assert crystal.mean_ps_sigma < 0.01 * (expected - 0.5 * trip) * 3.0
    # a beam has no depths
    assert [one.born for one in found.first] == ["everywhere"]


def test_first_of_many_from_another_depth_in_every_event():
    """Depths that give one time each: events differ, photons of one event do not."""
    times, light = np.array([10.0, 20.0]), np.ones((1, 2))
    mean, rms = distribution.first_photons(times, light[0], 3, 2)
    # of three photons the first is late if all are, the second if two are
    assert mean == pytest.approx([11.25, 15.0]) and rms[1] == pytest.approx(5.0)
    edges = distribution.cell_edges(0.0, 100.0, 50.0)
    cells = distribution.TimeCells(edges, 1)
    at = np.array([[30.0, 30.0, 60.0, 1e5]]), np.ones(4), np.arange(4), np.zeros(4, int)
    cells.add(*at)
    late = distribution.decayed(edges, cells.times_ps, cells.light.sum(axis=(0, 1)), 50.0)
    assert late.sum() == pytest.approx(4.0) and late[edges[1:] <= 30.0].sum() == 0.0
    by_100 = 2.0 * -np.expm1(-70.0 / 50.0) - np.expm1(-40.0 / 50.0)
    assert late[edges[1:] <= 100.0].sum() == pytest.approx(by_100, rel=1e-3)


def test_crystal_paths_are_those_of_the_other_tracer():
    found = mcrim.arrival_times(BENCH, group_index={"crystal": 2.08}, photons=1_000_000, seed=2)
    (crystal,) = (one for one in found.parts if one.name == "crystal")
    own = trace(BENCH, 60_000, 3, histories=True).histories
    assert own is not None
    times = own.path_cm * 10.0 * 2.08 / MM_PER_PS
    error = np.hypot(times.std() / np.sqrt(len(times)), crystal.mean_ps_sigma)
    assert abs(times.mean() - crystal.mean_ps) < LARGEST_Z * error
    assert found.notes[0].startswith("of window (1.52) the index")


def test_group_indices_are_those_of_the_materials():
    glass, micron = material("BK7").ordinary.formula, 0.54
    exact = sum(
        b * c * micron**2 / (micron**2 - c) ** 2
        for b, c in zip(glass.coefficients[1::2], glass.coefficients[2::2], strict=True)
    ) / material("BK7").index(540.0)
    assert material("BK7").group_index(540.0) == pytest.approx(
        material("BK7").index(540.0) + exact, rel=1e-8
    )
    found = mcrim.arrival_times(
        BENCH,
        n_crystal="CaMoO4@540nm",
        n_window="BK7@540nm",
        n_gap="Cargille_0607@540nm",
        group_index={"gap": "glycerol@540nm"},
        photons=20_000,
    )
    names = {"crystal": "CaMoO4", "window": "BK7", "gap": "glycerol"}
    for one in found.parts:
        if one.name in names:
            assert one.group_index == material(names[one.name]).group_index(540.0)
    assert not any("stands for the group index" in note for note in found.notes)


@cases("given", "told")
def test_wrong_input_is_refused(given, told):
    with pytest.raises(InputError, match=told):
        mcrim.arrival_times(BENCH, **{"photons": 1000} | given)


def test_times_as_a_dataset_and_beside_a_simulation(here, mcrim):
    shown = mcrim.shown(
        "simulate",
        BENCH,
        *"--photons 20000 --times t.csv --figure light.png".split(),
        *"--group-index crystal=2.08 --detected 3".split(),
    )
    assert "first of 3 detected photons" in shown and "light_times.png" in shown
    lines = (here / "t.csv").read_text().splitlines()
    assert lines[0] == "time_ps,part,part_sigma"
    assert sum(float(line.split(",")[1]) for line in lines[1:]) == pytest.approx(0.995, abs=0.003)
    assert (here / "light_times.csv").read_text().count("at one depth") == 3
    assert mcrim("simulate", BENCH, "--decay-ns", "3").status == 2
    data = times_of_the_bench().to_xarray()
    assert data.part.dims == ("time_ps",) and data.first_mean_ps.dims == ("born", "photon")
    # all light is emitted at once: there is no decay time to be told
    assert data.time_ps.attrs["units"] == "ps" and "decay_ns" not in data.attrs


def times_of_the_bench():
    return mcrim.arrival_times(BENCH, photons=20_000)
