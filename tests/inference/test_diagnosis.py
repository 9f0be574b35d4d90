"""The mathematics of compare, diagnose and repair, on a bench in formulas."""

import json
import math
import re
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.special import softmax
from trials import formula_bench as bench

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.core.files import plain
from mcrim_mitsuba.inference import judgement, simulations
from mcrim_mitsuba.inference.candidates import upper_limits
from mcrim_mitsuba.inference.compare import comparison_of, find_trends
from mcrim_mitsuba.inference.diagnose import diagnosis_of, judge
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import find_minima, newton, settle
from mcrim_mitsuba.inference.estimates import left_out, left_out_error
from mcrim_mitsuba.inference.fit import fit_model
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.screening import promising_effects
from mcrim_mitsuba.inference.simulations import MeasurementProposals
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.inference.weighing import Hypothesis
from mcrim_mitsuba.output.registry import encoded
from mcrim_mitsuba.output.sentences import limit_text

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}
#: A part of the catalogue, where all of it would only take longer.
SOME = {
    name: bench.EFFECTS[name]
    for name in (
        "polarization scattering_gradient source_depth surface_absorption gap_bubble "
        "detector_angle detector_radius background nonlinearity"
    ).split()
}
#: Family-wise false alarms of the statistical tests below; seeds are fixed.
FALSE_ALARM = 0.001


def campaign(seed, values=None, effects=(), change=lambda signal: signal, light=None):
    """``models(effects)`` of a campaign drawn from these values."""
    rng = np.random.default_rng(seed)
    signal = bench.signals({**TRUTH, **(values or {})}, effects)
    signal = change(signal * (1.0 + bench.SIGMA * rng.standard_normal(len(signal))))
    rows, noise = bench.readings(signal), bench.simulation_noise(seed)
    prior = TRUTH["alpha_abs_per_cm"] + bench.PRIOR_SIGMA * rng.standard_normal()
    return lambda added: bench.Model(rows, tuple(added), noise, prior, light)


def promising(models):
    """Effects of some that deserve more photons."""
    baseline = bench.explanations_of(models, {}).baseline
    return promising_effects(models, SOME, baseline)


def diagnosed(*args, **kwargs):
    return diagnosis_of(judge(campaign(*args, **kwargs), SOME))


def test_solver_finds_what_minuit_finds():
    models = campaign(1, {"bubble_fraction": 0.1}, ("gap_bubble",))
    for added in ((), ("gap_bubble",), ("detector_angle",), ("gap_bubble", "scattering_gradient")):
        model = models(added)
        theirs = find_minima(Statistic(model))[0]
        explanations = bench.explanations_of(models, bench.EFFECTS)
        ours = explanations.fit(added)
        assert ours.chi2 < theirs.chi2 + 0.002
        if ours.chi2 > theirs.chi2 - 0.01:
            sigma = np.sqrt(np.diag(ours.covariance))
            free = np.array([side is None for side in ours.at_bound])
            assert (np.abs(ours.theta - theirs.theta) / sigma)[free].max() < 0.05


def test_left_out_errors_are_those_of_fits_without_the_reading():
    models = campaign(2)
    fit = find_minima(Statistic(models(())))[0]
    errors, pulls = left_out(fit)
    for i in (0, 5, 15):
        rows = models(()).readings
        model = bench.Model(rows[:i] + rows[i + 1 :], (), bench.simulation_noise(2))
        model.prior = models(()).prior
        model.__post_init__()
        without = settle(Statistic(model), fit.theta)
        predicted = models(()).predict(without.theta).signal[i]
        assert rows[i].signal - predicted == pytest.approx(errors[i], abs=0.1 * rows[i].sigma)
        assert fit.chi2 - without.chi2 == pytest.approx(pulls[i] ** 2, abs=0.1)


@pytest.fixture(scope="module")
def under_the_null():
    """Baseline p-values, and the effects' p-values, of campaigns with nothing hidden."""
    names = ("gap_index", "scattering_gradient", "gap_bubble")
    effects = {name: bench.EFFECTS[name] for name in names}
    found = []
    for seed in range(45):
        explanations = bench.explanations_of(campaign(1000 + seed), effects)
        if seed % 15 == 0:
            # the null distribution hardly depends on the data: drawn anew now and then
            null = NullDistribution(explanations, names, seed)
        base = explanations.baseline
        gains = {name: base.chi2 - fit.chi2 for name, fit in explanations.singles().items()}
        found.append(
            {name: null.p_gain(name, gain) for name, gain in gains.items()}
            | {"global": null.p_global(max(gains.values())), "fit": base.p_value}
            | {"trend": find_trends(base)[0].p_value}
        )
    return {name: np.array([one[name] for one in found]) for name in found[0]}


@pytest.mark.parametrize("name", ["fit", "global", "gap_index", "scattering_gradient"])
def test_p_values_are_uniform_where_nothing_is_hidden(under_the_null, name):
    assert stats.kstest(under_the_null[name], "uniform").pvalue > FALSE_ALARM / 5


def test_p_values_at_a_boundary_are_uniform_inside(under_the_null):
    p = under_the_null["gap_bubble"]
    # at the boundary itself the gain is 0 but for rounding, and p anything from 0.5
    below = p[p < 0.48] / 0.48
    assert stats.binomtest(len(below), len(p), 0.48).pvalue > FALSE_ALARM / 5
    assert stats.kstest(below, "uniform").pvalue > FALSE_ALARM / 5


def test_no_more_false_alarms_than_stated(under_the_null):
    """Of trying all effects, and of trying all bench parameters, at 5 %."""
    for name in ("global", "trend"):
        alarms = int((under_the_null[name] < 0.05).sum())
        test = stats.binomtest(alarms, len(under_the_null[name]), 0.05, alternative="greater")
        assert test.pvalue > FALSE_ALARM


def test_nothing_hidden_is_adequate_with_limits():
    found = diagnosis_of(judge(campaign(3), bench.EFFECTS))
    assert found.verdict == "adequate" and found.leading == ()
    assert [step.added for step in found.repair] == [None]
    assert set(found.upper_limits) == set(bench.EFFECTS)
    bubble, depth = found.upper_limits["gap_bubble"], found.upper_limits["source_depth"]
    assert bubble.lower is None and 0.0 < bubble.upper < 0.1
    assert depth.upper is None and 0.2 < depth.lower < 100.0
    gap = found.upper_limits["gap_index"]
    assert gap.lower < 0.0 < gap.upper
    # chi2 has risen by what the confidence says
    explanations = bench.explanations_of(campaign(3), bench.EFFECTS)
    fit = explanations.fit(("gap_bubble",))
    place = fit.statistic.index("bubble_fraction")
    at = fit.statistic.theta({**fit.values, "bubble_fraction": bubble.upper})
    there = newton(fit.statistic, at, fit.weights, held=[place]).height
    assert there - fit.chi2 == pytest.approx(2.706, abs=0.1)


def test_limits_do_not_begin_at_a_worse_minimum():
    """Where a fit ended above the bench as it is, its limits were that value, twice."""
    effects = {"gap_thickness": bench.EFFECTS["gap_thickness"]}
    explanations = bench.explanations_of(campaign(3), effects)
    right = upper_limits(explanations)["gap_thickness"]
    key = ("gap_thickness",)
    fit = explanations.fit(key)
    place = fit.statistic.index("gap_offset_mm")
    at = fit.statistic.theta({**fit.values, "gap_offset_mm": 0.4})
    end = newton(fit.statistic, at, fit.weights, held=[place])
    assert end.height > explanations.baseline.chi2 + 3.841
    explanations._fits[key] = replace(fit, theta=end.point, chi2=end.height)
    found = upper_limits(explanations)["gap_thickness"]
    for ours, theirs in ((found.lower, right.lower), (found.upper, right.upper)):
        assert ours == pytest.approx(theirs, abs=0.01)
    assert found.lower < 0.0 < found.upper


def test_what_cannot_be_absent_is_excluded_not_limited():
    film = {"photocathode_film": bench.EFFECTS["photocathode_film"]}
    explanations = bench.explanations_of(campaign(3), film)
    fit = explanations.fit(tuple(film))
    explanations._fits[tuple(film)] = replace(fit, chi2=explanations.baseline.chi2 + 20.0)
    (limit,) = upper_limits(explanations).values()
    assert limit.excluded and limit.lower is None and limit.upper is None
    assert limit_text(limit) == "excluded (chi2 rises by 20 with it)"


@pytest.fixture(scope="module")
def one_hidden():
    """The diagnosis of a campaign with surface absorption hidden."""
    light = LightYieldInput(60.0, 0.1, 0.01)
    models = campaign(4, {"surface_loss": 0.02}, ("surface_absorption",), light=light)
    return diagnosis_of(judge(models, SOME))


def test_a_hidden_effect_is_found_and_repaired(one_hidden):
    found = one_hidden
    assert found.verdict == "missing_effect" and found.leading == ("surface_absorption",)
    best = found.candidates[0]
    assert best.effect == "surface_absorption" and best.plausible and best.p_global < 1e-6
    assert best.delta_chi2 > 50 and 0 < best.delta_chi2_sigma < 5
    estimate = best.parameters["surface_loss"]
    assert abs(estimate.value - 0.02) < 4.0 * estimate.sigma
    assert [step.added for step in found.repair] == [None, "surface_absorption"]
    before, after = found.repair
    assert after.chi2 < before.chi2 and after.left_out_error < before.left_out_error
    truth = TRUTH["scale"] / 6.0
    light = after.light_yield_ph_per_keV
    assert abs(light["value"] - truth) < 3.0 * light["sigma"]


@pytest.mark.parametrize("size", [-0.004, 0.004])
def test_a_readout_that_bends_either_way_is_named(size):
    names = "nonlinearity background gap_bubble surface_absorption polarization source_depth"
    models = campaign(7, {"nonlinearity": size, "scale": 3.0 * TRUTH["scale"]})
    found = diagnosis_of(judge(models, {name: SOME[name] for name in names.split()}))
    assert found.verdict == "missing_effect" and found.leading == ("nonlinearity",)
    estimate = found.candidates[0].parameters["nonlinearity"]
    assert abs(estimate.value - size) < 3.0 * estimate.sigma


def test_a_race_keeps_what_may_explain_the_readings():
    """What is hidden goes on, and few others; where nothing is missing hardly any does."""
    cases = {"gap_bubble": 0.3, "surface_absorption": 0.03, "detector_radius": 0.4}
    for hidden, size in cases.items():
        (name,) = (parameter.name for parameter in SOME[hidden].parameters)
        going_on = promising(campaign(7, {name: size}, (hidden,)))
        assert hidden in going_on and len(going_on) <= 3
    kept = [len(promising(campaign(seed))) for seed in range(12)]
    # nine effects, each of which gains 6 with a probability of about 1 %
    assert stats.binom.sf(sum(kept) - 1, 12 * len(SOME), 0.02) > FALSE_ALARM


def test_two_hidden_effects_are_found_together():
    hidden = {"source_depth_mm": 0.5, "bubble_fraction": 0.15}
    found = diagnosed(5, hidden, ("source_depth", "gap_bubble"))
    assert found.verdict in ("missing_effect", "ambiguous")
    assert set(found.repair[-1].effects) == {"source_depth", "gap_bubble"}
    assert found.repair[-1].p_value > 0.001


def test_what_no_effect_explains_is_unexplained():
    pattern = np.random.default_rng(8).standard_normal(len(bench.ROWS))
    found = diagnosed(8, change=lambda signal: signal * np.exp(0.04 * pattern))
    assert found.verdict == "unexplained" and found.leading == ()
    assert {family.family: family.probability for family in found.families}["unknown"] > 0.5


def test_too_few_readings_are_said_to_be():
    first, *rows = bench.readings(bench.signals(TRUTH))

    def models(added):
        return bench.Model((first, rows[3]), tuple(added))

    found = diagnosis_of(judge(models, bench.EFFECTS))
    assert found.verdict == "too_few_readings"
    assert found.baseline.p_value is None and found.baseline.ndf == 0


@dataclass(frozen=True)
class Fitted:
    """A fit as far as settling needs it."""

    chi2: float
    notes: tuple = ()
    names: tuple = ()
    values: tuple = ()
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))


def test_few_readings_are_ambiguous_and_ask_for_more():
    rows = bench.readings(bench.signals({**TRUTH, "bubble_fraction": 0.3}, ("gap_bubble",)))
    few = tuple(rows[i] for i in (0, 2, 4, 6, 8))

    def models(added):
        return bench.Model(few, tuple(added))

    proposals = MeasurementProposals(
        bench.ROWS, [lambda added: bench.Model(rows, added)], models, bench.SIGMA
    )
    found = diagnosis_of(judge(models, SOME), proposals)
    assert found.verdict == "ambiguous" and "gap_bubble" in found.leading
    measured = [row.parameters for row in few]
    best = next(each for each in found.next_measurements if each.kind == "reading")
    assert best.parameters not in measured and best.hours == 0.5
    together = next(each for each in found.next_measurements if " + " in each.kind)
    assert together.separates and together.expected_delta_chi2 > 4 and together.hours == 1.0
    sure = max(found.probabilities.values())
    assert sure + 0.05 < best.probability < together.probability < 1.0


def test_what_is_as_in_the_scene_takes_no_time_to_change():
    rows, own = [{"n_gap": 1.46, "gap_mm": 0.05}, {"gap_mm": 0.5}], {"n_gap": 1.0, "gap_mm": 0.05}
    minutes = {"n_gap": 6.0, "gap_mm": 60.0}
    proposals = MeasurementProposals(rows, [], None, 0.01, minutes, own=own)
    assert proposals.hours(rows[0]) == pytest.approx(0.6)
    assert proposals.hours(*rows) == pytest.approx(0.6 + 1.5)


@pytest.mark.parametrize("together, told", [(103.0, True), (12.0, False)])
def test_effects_that_do_not_add_up_are_told(monkeypatch, together, told):
    """chi2 = 10.3 by responses; the note is one of the fit, for terminal, JSON and report."""
    heights = iter([10.3, together, together])
    fitted = lambda *_, **__: Fitted(next(heights))  # noqa: E731
    monkeypatch.setattr(simulations, "fit_model", fitted)
    monkeypatch.setattr(simulations.CampaignSimulations, "anchored_model", lambda *_: None)
    models = SimpleNamespace(model_of=lambda campaign: None)
    monkeypatch.setattr(simulations.CampaignSimulations, "models", models)
    own = object.__new__(simulations.CampaignSimulations)
    own.maker = SimpleNamespace(is_exact=lambda effects: False)
    effects = SimpleNamespace(switched_on=(), effects=("one", "other"))
    found = own._settled(effects)
    assert bool(found.notes) is told
    assert not told or "one and other simulated together chi2 is 103, not 10.3" in found.notes[0]


def test_a_trend_is_that_of_the_bench_parameter():
    deep = np.array([row["crystal_height_mm"] < 3.0 for row in bench.ROWS])
    model = campaign(9, change=lambda s: s * np.where(deep, 1.04, 1.0))(())
    found = comparison_of(fit_model(model))
    assert found.trends[0].parameter == "crystal_height_mm" and found.trends[0].p_value < 0.01


def test_json_has_the_fields_of_the_interface(one_hidden):
    found = plain(encoded(one_hidden))
    text = json.dumps(found, allow_nan=False)
    assert json.loads(text) == found
    whole = (
        "verdict baseline candidates upper_limits suspect_readings leading repair "
        "next_measurements seconds"
    )
    of_candidate = (
        "effect chi2 ndf p_value delta_chi2 delta_chi2_sigma parameters light_yield_ph_per_keV "
        "left_out_error aicc plausible mimics"
    )
    assert set(whole.split()) <= set(found)
    assert set(of_candidate.split()) <= set(found["candidates"][0])
    of_step = "step added chi2 ndf p_value rms_pull left_out_error"
    assert set(of_step.split()) <= set(found["repair"][0])
    baseline = found["baseline"]
    assert {"parameters", "chi2", "ndf", "p_value", "rows"} <= set(baseline)
    assert baseline["expected_chi2"][1] == pytest.approx(14 + math.sqrt(28))


def test_left_out_error_sees_what_a_useless_parameter_costs():
    explanations = bench.explanations_of(campaign(10), bench.EFFECTS)
    fit = explanations.fit(("anisotropic_scattering",))
    assert fit.chi2 <= explanations.baseline.chi2 + 0.01
    assert left_out_error(fit) > left_out_error(explanations.baseline)


def test_a_sentence_names_some_of_many_explanations():
    judge = SimpleNamespace(explanations=SimpleNamespace(title=" with ".join))
    leading = tuple((name,) for name in "abcdefg")
    assert Judgement._titles(judge, leading[:4]) == "a, b, c and d"
    assert Judgement._titles(judge, leading) == "a, b, c, d and 3 others"
    assert Judgement._titles(judge, leading[:5]) == "a, b, c, d and e"


def test_what_only_the_simulations_error_lets_lead_is_named_apart(monkeypatch):
    """Staff read that 96 % could not be told apart from less than 0.1 %."""
    logs = {("bubble",): 0.0, ("bevel",): -2.0, ("source",): -10.0, ("haze",): -40.0}
    logs |= {("bubble", "source"): -9.0}  # holds a leading one
    effects = {name: SimpleNamespace(family=name) for key in logs for name in key}
    explanations = SimpleNamespace(
        fit=lambda key: SimpleNamespace(key=key, chi2=5.0, ndf=3, p_value=0.15),
        title=" with ".join,
        effects=effects,
    )
    monkeypatch.setattr(judgement, "error_of_difference", lambda fit, best: 8.5)
    # the leading ones hold 95 %: of bubble and bevel, or of bubble alone
    for without, words in (
        ((), "^bubble and bevel may explain .*; more photons .* whether source may as well$"),
        (("bevel",), "^bubble may explain .*; more photons .* whether source may as well$"),
    ):
        hypotheses = tuple(
            Hypothesis(
                effects=key, log_weight=log, log_scale=0.0, log_scale_sigma=0.1, evidence=object()
            )
            for key, log in logs.items()
            if key != without
        )
        shares = softmax([hypothesis.log_weight for hypothesis in hypotheses])
        weighing = SimpleNamespace(hypotheses=hypotheses, shares=shares, families={"bubble": 0.9})
        judge = Judgement(explanations, None, weighing)
        verdict = judge._of_leading(())
        assert verdict.word == "ambiguous" and re.search(words, verdict.reason), verdict.reason
        assert verdict.unsettled == (("source",),) and ("haze",) not in verdict.leading


def test_effects_of_no_family_are_not_told_as_one(monkeypatch):
    """Two of a user's own led: "of the family others"."""
    monkeypatch.setattr(judgement, "error_of_difference", lambda fit, best: 0.0)
    even = {"log_weight": 0.0, "log_scale": 0.0, "log_scale_sigma": 0.1, "evidence": object()}
    hypotheses = tuple(Hypothesis(effects=(name,), **even) for name in ("label", "browning"))
    explanations = SimpleNamespace(
        fit=lambda key: SimpleNamespace(chi2=5.0, ndf=3, p_value=0.15), title=" with ".join
    )
    for families, ending in (
        ({"others": 0.99}, "with the first"),
        ({"surface": 0.99, "others": 0.98}, "that it is of the family surface is as good as sure"),
    ):
        weighing = SimpleNamespace(
            hypotheses=hypotheses, shares=np.array([0.5, 0.5]), families=families
        )
        assert Judgement(explanations, None, weighing)._of_leading(()).reason.endswith(ending)


@pytest.mark.parametrize("best", [0.5, 1e-5])
def test_what_the_readings_refuse_leads_only_beside_its_like(best):
    """A mask off its axis led that gained nothing: larger errors explained the readings."""
    p_values = {("bubble",): best, ("mask",): 1e-5, ("top",): 1e-4}
    explanations = SimpleNamespace(
        fit=lambda key: SimpleNamespace(chi2=5.0, ndf=3, p_value=p_values[key]),
        possible=lambda key: True,
    )
    of_scale = {"log_scale": 0.0, "log_scale_sigma": 0.1, "evidence": object()}
    hypotheses = tuple(
        Hypothesis(effects=key, besides=besides, log_weight=log, p_value=p, **of_scale)
        for key, besides, log, p in (
            (("bubble",), (), 0.0, best),
            (("mask",), ("understated errors",), -2.0, 0.6),
            (("top",), (), -5.0, 1e-4),
        )
    )
    shares = softmax([hypothesis.log_weight for hypothesis in hypotheses])
    judge = Judgement(explanations, None, SimpleNamespace(hypotheses=hypotheses, shares=shares))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judgement, "error_of_difference", lambda fit, best: 8.5)
        described = best > 1e-3
        assert judge.leading == ((("bubble",),) if described else (("bubble",), ("mask",)))
        assert judge.unsettled == (() if described else (("top",),))


def test_hypotheses_that_differ_by_rounding_only_keep_their_order():
    """Two wrong readings of a symmetric campaign: the order is not the processor's."""
    bad = [
        Hypothesis(besides=(name,), log_weight=0.0, log_scale=0.0, log_scale_sigma=0.1)
        for name in ("bad reading air", "bad reading gel")
    ]
    for shares in ([0.5, np.nextafter(0.5, 1.0)], [np.nextafter(0.5, 1.0), 0.5]):
        weighing = SimpleNamespace(hypotheses=bad, shares=np.array(shares))
        judge = Judgement(None, None, weighing)
        assert list(judge.probabilities)[:2] == ["bad reading air", "bad reading gel"]


@pytest.mark.parametrize(
    ("chi2", "p", "word", "says"),
    [(4.0, 0.4, "missing_effect", "explains the misfit: "), (23.0, 1e-5, "ambiguous", "not all")],
)
def test_what_leaves_a_fifth_of_a_misfit_is_not_named(chi2, p, word, says):
    """A photocathode at its bound was said to explain readings that it left at 23 of 2."""
    fit = SimpleNamespace(chi2=chi2, ndf=2, p_value=p)
    explanations = SimpleNamespace(
        fit=lambda key: fit,
        title=" with ".join,
        effects={"film": SimpleNamespace(family="detector")},
        baseline=SimpleNamespace(chi2=116.0, ndf=3),
    )
    only = Hypothesis(
        effects=("film",), log_weight=0.0, log_scale=0.0, log_scale_sigma=0.1, evidence=object()
    )
    families = {"detector": 0.997}
    weighing = SimpleNamespace(hypotheses=(only,), shares=np.ones(1), families=families)
    verdict = Judgement(explanations, None, weighing)._of_leading(())
    assert verdict.word == word and says in verdict.reason, verdict.reason
