"""Hypotheses side by side: on a bench in formulas, then from files with few photons."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from convert_results import read_results
from places import SCENES, cases_of
from refusals import refusal
from trials import formula_bench as bench

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.fit import result_of
from mcrim_mitsuba.inference.hypotheses import refuse_unlike, side_by_side
from mcrim_mitsuba.inference.statistic import Statistic

cases = cases_of(__file__)

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}


def drawn(values, effects, seed=5):
    """``model(effects)`` of readings of a bench with these effects."""
    rng = np.random.default_rng(seed)
    signal = bench.signals({**TRUTH, **values}, effects)
    rows = bench.readings(signal * (1.0 + bench.SIGMA * rng.standard_normal(len(signal))))
    noise = bench.simulation_noise(seed)
    return lambda added: bench.Model(rows, tuple(added), noise)


def explained(model, **effects):
    """Explanations by name, with one prior of the scale."""
    made = {}
    for name, own in effects.items():
        scales = next((each.scales for each in made.values()), {})
        made[name] = bench.explanations_of(
            model, {each: bench.EFFECTS[each] for each in own}, scales
        )
    return made


def compared(explanations):
    fits = {name: own.fit(own.effects) for name, own in explanations.items()}
    results = {name: result_of([fit], profile=False) for name, fit in fits.items()}
    return side_by_side(explanations, results)


@pytest.fixture(scope="module")
def with_a_bubble():
    return drawn({"bubble_fraction": 0.25}, ("gap_bubble",))


def test_evidences_are_those_of_a_diagnosis_and_the_right_one_is_preferred(with_a_bubble):
    made = explained(with_a_bubble, A=(), B=("gap_bubble",), C=("edge_chamfer", "background"))
    found = compared(made)
    whole = bench.explanations_of(with_a_bubble, bench.EFFECTS)
    logs = {n: whole.evidence(one.effects).log for n, one in found.named.items()}
    for name, one in found.named.items():
        assert one.log_evidence == pytest.approx(logs[name] - logs["B"], abs=1e-6)
        assert one.chi2 == pytest.approx(whole.fit(one.effects).chi2, abs=1e-3)
        odds = sum(math.exp(log - logs[name]) for log in logs.values())
        assert one.probability == pytest.approx(1.0 / odds)
    assert (found.verdict, found.leading) == ("preferred", ("B",))
    assert found.reason.startswith("B (air bubble in the gap) is the likeliest of those compared, ")
    sizes = [one.parameters.get("bubble_fraction") for one in found.hypotheses]
    assert sizes[0] is sizes[2] is None and abs(sizes[1].value - 0.25) < 4 * sizes[1].sigma
    models = np.array([[row.model for row in one.rows] for one in found.hypotheses])
    errors = [row.sigma for row in found.hypotheses[0].rows]
    assert list(found.apart.values()) == pytest.approx(np.ptp(models, axis=0) / errors)


def test_what_readings_cannot_tell_and_what_describes_none_of_them(with_a_bubble):
    found = compared(explained(with_a_bubble, A=("gap_bubble",), B=("gap_bubble",), C=()))
    assert found.verdict == "ambiguous" and {*found.leading} == {"A", "B"}
    assert [one.probability for one in found.hypotheses] == pytest.approx([0.5, 0.5, 0.0])
    assert found.reason.startswith("the readings cannot tell apart ")
    found = compared(explained(with_a_bubble, A=(), B=("polarization",)))
    assert found.verdict == "unexplained" and "does not describe the readings" in found.reason


def test_a_hypothesis_may_ask_for_sizes_that_are_not_usual(with_a_bubble):
    """Bounds without the effect's absence, and beyond what is plausible."""

    def within(low, high):
        def model(added):
            made = with_a_bubble(added)
            made.free = tuple(
                replace(p, start=low, minimum=low, maximum=high)
                if p.name == "bubble_fraction"
                else p
                for p in made.free
            )
            return made

        explanations = bench.explanations_of(model, {"gap_bubble": bench.EFFECTS["gap_bubble"]})
        prior = explanations.priors(("gap_bubble",))["bubble_fraction"]
        return explanations.plausible(("gap_bubble",))["bubble_fraction"], prior

    u = np.linspace(0.0, 1.0, 101)
    usual, prior = within(0.05, 0.9)
    values = prior.quantile(u)
    assert values[0] == pytest.approx(0.05) and values[-1] == pytest.approx(0.9)
    # a part of the whole density, cut off: odds inside are as before
    _, whole = within(0.0, 0.9)
    below = np.interp(0.05, whole.quantile(u), u)
    assert prior.quantile(0.5) == pytest.approx(whole.quantile(below + 0.5 * (1 - below)), rel=0.02)
    _, beyond = within(usual[1], 1.0)
    assert beyond.quantile(0.5) == pytest.approx(0.5 * (usual[1] + 1.0))


def test_a_fit_begins_at_all_sizes_of_its_effects(with_a_bubble):
    """Responses that bend at a node have minima on both sides of it."""
    model = with_a_bubble(("gap_bubble",))
    place = [p.name for p in model.free].index("bubble_fraction")
    straight = model.predict

    def with_a_hill(theta, **wanted):
        away, made = (theta[place] - 0.15) / 0.04, straight(theta, **wanted)
        rows = np.arange(len(made.signal)) % 2
        raised = 1.0 + 0.3 * rows * math.exp(-(away**2))
        slopes = made.signal_slopes * raised[:, None]
        slopes[:, place] -= made.signal * (raised - 1.0) * 2.0 * away / 0.04
        return replace(made, signal=made.signal * raised, signal_slopes=slopes)

    model.predict = with_a_hill
    model.free = tuple(
        replace(p, start=0.05) if p.name == "bubble_fraction" else p for p in model.free
    )
    best, other = find_minima(Statistic(model))
    assert abs(best.values["bubble_fraction"] - 0.25) < 0.06
    assert other.values["bubble_fraction"] < 0.15 and other.chi2 > best.chi2 + 1.0


# ---- from files ----


@pytest.fixture
def files(here):
    """``file(name, effects)`` makes campaigns of the misfit; the readings as text may change."""
    shutil.copy(SCENES / "camoo4.xml", here)

    def file(name, effects="", change=lambda text: text, of_campaign=lambda text: text):
        campaign = (SCENES / "camoo4_misfit.toml").read_text()
        campaign = campaign.replace("effects = []", f"effects = [{effects}]")
        Path(f"{name}.toml").write_text(
            of_campaign(campaign.replace("camoo4_misfit.csv", f"{name}.csv"))
        )
        Path(f"{name}.csv").write_text(change((SCENES / "camoo4_misfit.csv").read_text()))
        return f"{name}.toml"

    return file


@cases("old", "new", "says")
def test_other_readings_are_refused_at_the_first_row(files, old, new, says):
    first, other = files("a"), files("b", change=lambda text: text.replace(old, new, 1))
    said = refusal(refuse_unlike, [mcrim.read_campaign(first), mcrim.read_campaign(other)])
    assert says in said and "let both campaigns name the same measurements" in said


def test_rows_too_many_and_too_few_and_other_scales_are_refused(mcrim, files):
    def last_row_left_out(text):
        return "\n".join(text.splitlines()[:-1]) + "\n"

    first, fewer = files("a"), files("b", change=last_row_left_out)
    assert "b.csv: gel hole 4 of a.csv is not among the readings" in mcrim.refused(
        "compare", first, fewer
    )
    said = mcrim.refused("compare", fewer, first)
    assert "a.csv, line 19: gel hole 4 is not among the readings of b.csv" in said
    held = files(
        "c", of_campaign=lambda text: text + "\n[parameters.scale]\nstart = 60\nfixed = true\n"
    )
    said = mcrim.refused("compare", first, held)
    assert said.startswith("mcrim: c.toml: the scale is not treated as in a.toml")
    assert "4 hypotheses cannot be compared" in mcrim.refused("compare", *[first] * 4)


def test_side_by_side_from_files(mcrim, files):
    """An effect of the readings, and one in a scene of its own: few photons, one file each."""

    def one_number(text):  # most of the time is not for numbers
        return f"{text}\n[tolerances]\nnone = true\nwindow_thickness_mm = 0.05\n"

    one = files("a", of_campaign=one_number)
    other = files("b", '"background", "gap_bubble"', of_campaign=one_number)
    words = ["compare", one, other, "--photons", "2e4"]
    out = mcrim.shown(*words, "--json", "r.json", "--figure", "f.png")
    told = json.loads(Path("r.json").read_text())
    a, b = told["hypotheses"]
    assert (a["name"], a["effects"], b["effects"]) == ("A", [], ["background", "gap_bubble"])
    assert told["leading"] == ["B"] and out.startswith(
        "Preferred: B (constant background with air bubble in the gap)"
    )
    assert a["chi2"] > 26 > b["chi2"] and b["ndf"] == a["ndf"] - 2
    assert a["probability"] + b["probability"] == pytest.approx(1.0) and b["log_evidence"] == 0.0
    assert "They differ most at gel hole 4: " in out and "Next: mcrim " in out
    # one fit, whoever shows it
    mcrim.shown("calibrate", other, "--photons", "2e4", "--json", "c.json")
    alone = json.loads(Path("c.json").read_text())
    assert b["chi2"] == alone["chi2"]
    for name, fitted in b["parameters"].items():
        assert fitted == {n: alone["parameters"][name][n] for n in fitted}, name
    # what is called apart are the predictions that stand beside each other
    for mine, theirs in zip(a["rows"], b["rows"], strict=True):
        far = abs(mine["model"] - theirs["model"]) / mine["sigma"]
        assert told["apart"][mine["label"]] == pytest.approx(far)
    assert Path("f.png").read_bytes().startswith(b"\x89PNG")
    assert Path("f.csv").read_text().startswith("label,use,measured,sigma,apart,model_A,")
    read = read_results(["r.json"])
    assert [row["hypothesis"] for row in read.rows] == ["A", "B"]
    assert len(read.readings) == 2 * len(told["apart"]) and "bubble_fraction" in read.rows[1]
