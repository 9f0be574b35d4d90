"""The public names: quick to import, in any order with Mitsuba, and shown in every way."""

import copy
import dataclasses
import functools
import math
import os
import pickle
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from places import SCENES, cases_of, mitsuba_alone

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.output.photograph import Photograph
from mcrim_mitsuba.transport.variants import ENVIRONMENT_VARIABLE, selected_llvm

cases = cases_of(__file__)

BENCH = SCENES / "camoo4.xml"
VERBS = {
    *("simulate", "table", "calibrate", "compare", "diagnose", "repair", "budget", "plan"),
    *("check", "reduce", "render", "report", "crosscheck", "add"),
}


def python(code: str, **variables: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=os.environ | variables,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_name_is_there_and_explained():
    for name in mcrim.__all__:
        assert getattr(mcrim, name).__doc__, name
    assert {*VERBS, "read_scene", "read_campaign", "Run"} <= set(mcrim.__all__)
    assert set(mcrim.__all__) <= set(dir(mcrim))
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        _ = mcrim.simulat


def test_importing_changes_nothing_outside():
    code = (
        "import os, sys; before = list(sys.meta_path), dict(os.environ), list(sys.path_hooks)\n"
        "import mcrim_mitsuba; mcrim_mitsuba.Run, mcrim_mitsuba.use_variant\n"
        "assert (list(sys.meta_path), dict(os.environ), list(sys.path_hooks)) == before\n"
        "print(*{'mitsuba', 'drjit'} & {*sys.modules})"
    )
    assert python(code) == "\n"


def test_one_function_brings_the_plugins_and_llvm():
    """Into the variant that it is called for, and into those that Mitsuba switches to later."""
    code = (
        "import mcrim_mitsuba as mcrim, os; mi = mcrim.use_variant(threads=1)\n"
        "assert mi.variant() == 'llvm_ad_rgb' and os.environ['DRJIT_LIBLLVM_PATH']\n"
        "for variant in ('llvm_ad_mono', 'llvm_ad_rgb', 'scalar_rgb', 'llvm_ad_mono'):\n"
        "    mi.set_variant(variant)\n"
        "    if variant != 'scalar_rgb':\n"
        "        assert 'LightMeter' in str(mi.load_dict({'type': 'light_meter'}))\n"
        "import drjit; print(drjit.thread_count())"
    )
    assert python(code, DRJIT_LIBLLVM_PATH="") == "1\n"


@mitsuba_alone
@pytest.mark.parametrize("first", ["mcrim_mitsuba", "mitsuba"])
def test_mitsuba_may_be_imported_before_or_after(first):
    """Where the LLVM that Dr.Jit finds by itself is fit: here the variable names it."""
    second = "mitsuba" if first == "mcrim_mitsuba" else "mcrim_mitsuba"
    code = (
        f"import {first}, {second}\nimport mcrim_mitsuba as mcrim\n"
        f"print(mcrim.simulate({str(BENCH)!r}, photons=20_000, seed=3).eta)"
    )
    found = python(code, **{ENVIRONMENT_VARIABLE: selected_llvm().path})
    assert float(found) == mcrim.simulate(BENCH, photons=20_000, seed=3).eta


def test_a_run_is_given_whole_or_field_by_field():
    run = mcrim.Run(photons=20_000, seed=5)
    whole = mcrim.simulate(BENCH, run=run, n_gap=1.46)
    fields = mcrim.simulate(BENCH, photons=2e4, seed=5, n_gap=1.46)
    assert whole.eta == fields.eta and whole.n_gap == 1.46 and whole.seed == 5


def test_an_answer_is_shown_in_every_way(tmp_path, monkeypatch):
    light = mcrim.simulate(BENCH, photons=20_000, seed=1)
    # in a notebook as well
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert str(light).startswith("eta = 0.25") and "where the light ends" in str(light)
    assert "<table>" in light._repr_html_() and "light collection efficiency" in repr(light)
    fates = light.to_dataframe()
    assert fates["fraction"].sum() == pytest.approx(1.0)
    assert '"eta": ' in light.to_json(tmp_path / "light.json")
    assert (tmp_path / "light.json").read_text() == light.to_json() + "\n"
    assert light.to_xarray().eta.item() == light.eta
    with pytest.raises(mcrim.InputError, match=r"there is no picture 'fate'.*arrival, fates"):
        light.plot("fate")
    with pytest.raises(AttributeError, match="has no photon"):
        _ = light.photon


def test_any_parameter_is_an_axis():
    axes = {"gap_mm": [0.02, 0.2], "n_gap": [1.0, 1.46], "alpha_scat_per_cm": [0.3, 0.5, 1.0]}
    table = mcrim.table(BENCH, **axes, photons=20_000, seed=1)
    found = table.to_xarray()
    assert dict(found.eta.sizes) == {"gap_mm": 2, "n_gap": 2, "alpha_scat_per_cm": 3}
    assert found.gap_mm.attrs["units"] == "mm" and found.attrs["n_crystal"] == 2.01
    one = mcrim.table(BENCH, gap_mm=0.2, n_gap=[1.46], alpha_scat_per_cm=[0.5], photons=2e4, seed=1)
    (row,) = one.rows
    there = found.sel(gap_mm=0.2, n_gap=1.46, alpha_scat_per_cm=0.5)
    assert np.isclose(there.eta, row["eta"], rtol=0.02)
    assert len(table.rows) == len(table.to_dataframe()) == 12
    labels = [line.get_label() for line in table.plot().axes[0].containers]
    assert labels[0] == "gap 0.02 mm, gap index 1"
    # the error beside its value, rounded by it; numbers keep columns of their own
    (shown,) = table.description.tables.values()
    assert [column.title for column in shown.columns] == [*axes, "eta"]
    first = table.rows[0]
    assert shown.rows[0].cells[-1].text == pdg(first["eta"], first["eta_sigma"])
    assert list(table.to_dataframe()) == [*axes, "eta", "eta_sigma"]
    with pytest.raises(mcrim.InputError, match=r"no parameter gap_m.*did you mean gap_mm"):
        mcrim.table(BENCH, gap_m=[0.1])


def test_fitted_parameters_say_their_units():
    fit = mcrim.calibrate(SCENES / "camoo4_campaign.toml", photons=131_072)
    assert str(fit.light_yield_ph_per_keV) == "7.5 ± 0.8 ph/keV"
    assert str(fit.alpha_scat_per_cm).endswith("1/cm") and fit.ndf == 0
    # a sample's is no energy
    of_sample = dataclasses.replace(fit.light_yield_ph_per_keV, name="light_yield_b_ph_per_keV")
    assert str(of_sample) == "7.5 ± 0.8 ph/keV"
    frame = fit.to_dataframe().set_index("parameter")
    assert set(frame.index) >= {"alpha_scat_per_cm", "light_yield_ph_per_keV"}
    alpha_scat = frame.loc["alpha_scat_per_cm"]
    ends = [alpha_scat[n] for n in ("lower_95", "lower", "value", "upper", "upper_95")]
    assert ends == sorted(ends)
    campaign = mcrim.read_campaign(SCENES / "camoo4_campaign.toml")
    assert repr(campaign).endswith(": 2 readings, scene camoo4.xml>")
    for verb in ("simulate", "table"):
        with pytest.raises(mcrim.InputError, match="did you mean photons"):
            getattr(mcrim, verb)(BENCH, photon=10)
    with pytest.raises(mcrim.InputError, match="did you mean n_gap"):
        mcrim.simulate(BENCH, n_gab=1.2)
    with pytest.raises(mcrim.InputError, match="n_gap is no field of a run"):
        mcrim.calibrate(SCENES / "camoo4_campaign.toml", n_gap=1.0)


def test_answers_and_fitted_parameters_can_be_copied():
    light = copy.copy(mcrim.simulate(BENCH, photons=20_000, seed=1))
    assert light.eta == copy.deepcopy(light).eta


@cases("axis", "said")
def test_axes_that_cannot_be_are_refused(axis, said, mcrim):
    lists = ["--alpha-scat", "0.5", "--alpha-abs", "0.039", "--n-gap", "1"]
    assert said in mcrim.refused("table", BENCH, *lists, "--axis", axis)


def test_what_is_wrong_with_a_scene_is_shown(tmp_path):
    scene = tmp_path / "bench.xml"
    scene.write_text(BENCH.read_text().replace('value="10"', 'value="10,0"', 1))
    found = mcrim.check(scene)
    assert not found.ok and str(found).startswith(f"{scene}, line ") and "10,0" in str(found)
    with pytest.raises(mcrim.InputError) as refused:
        mcrim.simulate(scene)
    # all that a notebook shows of it
    assert refused.value._render_traceback_() == [f"InputError: {refused.value}"]


def test_proposals_that_were_asked_for_and_are_not_listed_are_said():
    campaign = mcrim.read_campaign(SCENES / "camoo4_campaign.toml")
    few = {name: campaign.catalogue[name] for name in ("gap_bubble", "background")}
    campaign = dataclasses.replace(
        campaign, next_measurements={"n_gap": [1.333]}, catalogue=few, tolerances=()
    )
    found = mcrim.diagnose(campaign, photons=16_384)
    assert found.verdict == "too_few_readings" and not found.next_measurements
    notes = found.provenance.notes
    assert any("listed only where effects are to be told apart" in note for note in notes)


def test_the_old_name_of_an_effect_is_taken():
    campaign = SCENES / "camoo4_table1.toml"
    for only, without in (("saturation", "nonlinearity"), (["nonlinearity"], ["saturation"])):
        with pytest.raises(mcrim.InputError, match="no effect is left to be tried"):
            mcrim.diagnose(campaign, only=only, without=without)


def test_add_replaces_no_file(tmp_path):
    """It wrote over the scene that it was given, where that stood for the new file."""
    scene = tmp_path / "own.xml"
    scene.write_bytes((SCENES / "camoo4.xml").read_bytes())
    with pytest.raises(mcrim.InputError, match=r"own\.xml: this file exists already"):
        mcrim.add("gap_bubble", scene, scene)
    assert scene.read_bytes() == (SCENES / "camoo4.xml").read_bytes()
    for _ in range(2):  # the very same may be there
        mcrim.add("gap_bubble", scene, tmp_path / "new.xml")


def test_results_are_sent_between_processes():
    code = (
        "import functools, multiprocessing, mcrim_mitsuba as mcrim\n"
        "if __name__ == '__main__':\n"
        "    run = functools.partial(mcrim.simulate, photons=20_000, threads=1)\n"
        "    with multiprocessing.get_context('fork').Pool(1) as pool:\n"
        f"        found, same = pool.map(run, 2 * [{str(BENCH)!r}])\n"
        "    print(found.eta == same.eta, found.plot('fates') is not None)"
    )
    assert python(code).split() == ["True", "True"]


@cases("verb", "given")
def test_every_result_is_what_it_was_after_pickling(verb, given, shared_cache, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE", str(shared_cache))  # one bench for all verbs
    source = BENCH
    if verb in ("calibrate", "compare", "diagnose", "repair", "budget", "plan"):
        source = mcrim.read_campaign(SCENES / "camoo4_campaign.toml")
        few = (
            "gap_bubble",
            "background",
        )  # a budget asked for polarization, and ended in a KeyError
        source = dataclasses.replace(source, catalogue={n: source.catalogue[n] for n in few})
    run = mcrim.Run(photons=20_000, threads=1, progress=lambda *_: None)
    found = getattr(mcrim, verb)(source, run=run, **given)
    sent = pickle.loads(pickle.dumps(found))
    assert (str(sent), sent.to_json()) == (str(found), found.to_json())
    if verb in ("check", "table"):
        assert sent.plot().axes


def test_a_picture_that_is_still_drawn_is_waited_for_when_it_is_sent():
    process = subprocess.Popen(
        [sys.executable, "-c", "raise SystemExit('no')"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert pickle.loads(pickle.dumps(Photograph(process))).trouble == "no"


ARRAYS = [np.int32(2), np.uint8(2), np.float32(2), np.array(2)]
WHOLE = [*ARRAYS, 2.0, "2", "2e0", Fraction(2), Decimal(2)]
NO_NUMBERS = ["two", "", True, np.True_, [2], np.array([2]), 2j, {}, b"2", object()]
NOT_WHOLE = [2.5, math.nan, math.inf, -math.inf, *NO_NUMBERS, -1, 10**400]


@pytest.mark.parametrize("field", ["photons", "seed", "threads"])
def test_numbers_of_any_kind_are_taken_or_refused(field):
    for value in WHOLE:
        taken = getattr(mcrim.Run(**{field: value}), field)
        assert (taken, type(taken)) == (2, int), value
    for value in NOT_WHOLE:
        with pytest.raises(mcrim.InputError, match=f"the .*{field}"):
            mcrim.Run(**{field: value})
    assert mcrim.Run(seed="123456789012345678").seed == 123456789012345678
    with pytest.raises(mcrim.InputError, match="the seed is None"):
        mcrim.Run(seed=None)


def test_what_is_no_argument_is_refused_in_a_line():
    campaign = SCENES / "camoo4_campaign.toml"
    for verb, given, told in (
        (mcrim.simulate, [None], "the scene is None; name a file"),
        (mcrim.read_scene, [b"camoo4.xml"], "the scene is b'camoo4.xml'"),
        (mcrim.diagnose, [["a.toml"]], "the campaign is ['a.toml']"),
        (mcrim.report, [campaign, None], "output is None"),
        (mcrim.eta_spectrum, [BENCH, 5], "spectrum is 5"),
        (functools.partial(mcrim.simulate, run={"seed": 1}), [BENCH], "give a Run"),
        (functools.partial(mcrim.simulate, progress=3), [BENCH], "progress is 3; give a function"),
        (mcrim.read_scene, [BENCH, 5], "give a dictionary"),
        (functools.partial(mcrim.diagnose, only=[3]), [campaign], "only is [3]; give a name"),
        (functools.partial(mcrim.diagnose, only=np.array(3)), [campaign], "give a name, or a list"),
        (functools.partial(mcrim.plan, n_gap=[]), [campaign, 0.1], "there is no value of n_gap"),
        (mcrim.calibrate, [], "mcrim.calibrate: missing a required argument: 'campaign'"),
        (mcrim.simulate, [BENCH, 1e6], "mcrim.simulate: too many positional arguments"),
    ):
        with pytest.raises(mcrim.InputError) as refused:
            verb(*given)
        assert told in str(refused.value)


def test_other_numbers_of_any_kind_are_taken_or_refused():
    for value in (np.float32(0.5), "0.5", Fraction(1, 2), Decimal("0.5"), np.array(0.5)):
        assert mcrim.Run(precision=value).precision == 0.5
    for value in (*NOT_WHOLE[1:], 0):
        with pytest.raises(mcrim.InputError, match=r"precision|is empty"):
            mcrim.Run(precision=value)
    light = functools.partial(mcrim.table, BENCH, photons=1000, threads=1)
    same = light(n_gap=np.array([1.0, 1.46], np.float32)).eta
    assert np.all(light(n_gap=["1", Decimal("1.46")]).eta == pytest.approx(same))
    assert light(n_gap=np.array(1.46)).eta == pytest.approx(same[1])
    for value in ([[1.0, 1.46]], np.array([[1.46]]), [1, None], [math.nan], [True], b"1.46", None):
        with pytest.raises(mcrim.InputError):
            light(n_gap=value)
    for cells in (2, (2, 2), (0, 2, 2), (2.5, 2, 2), (None, 2, 2), np.array(2), "", {}):
        with pytest.raises(mcrim.InputError, match="cells"):
            mcrim.eta_map(BENCH, cells=cells, photons=1000, threads=1)
    plan = functools.partial(mcrim.plan, SCENES / "camoo4_campaign.toml", photons=1000)
    for given in ({"mountings": [2.5]}, {"events": [None]}, {"n_gap": [[1.0]]}, {"mounting": 4}):
        with pytest.raises(mcrim.InputError):
            plan(0.1, **given)
    for wanted in (None, "much", math.nan, [0.1], 0, 9):
        with pytest.raises(mcrim.InputError, match="wanted"):
            plan(wanted)
