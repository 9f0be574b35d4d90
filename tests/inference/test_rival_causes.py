"""What is no effect: something without a name, and readings that are wrong, on a bench in formulas.

Seeds are fixed.
"""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from trials import formula_bench as bench

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.inference.compare import find_suspects, likely_swaps
from mcrim_mitsuba.inference.diagnose import diagnosis_of, judge
from mcrim_mitsuba.inference.displacement import BaselineFrame, NullDistribution
from mcrim_mitsuba.inference.drivers import settle
from mcrim_mitsuba.inference.fit import fit_model
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.next_measurements import _most_kept, next_measurements
from mcrim_mitsuba.inference.rehearsal import widening
from mcrim_mitsuba.inference.rival_causes import UNKNOWN, DiscrepancyModel, discrepancy_at
from mcrim_mitsuba.inference.screening import promising_effects
from mcrim_mitsuba.inference.simulations import MeasurementProposals
from mcrim_mitsuba.inference.weighing import weigh_hypotheses
from mcrim_mitsuba.output.sentences import suspicion

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}
LIGHT = LightYieldInput(50.0, 0.1, 0.0)  # a scale of 5 is 1 ph/keV
#: Effects that are hidden, each as strong as in a campaign whose misfit is seen.
HIDDEN = {
    "gap_bubble": ("bubble_fraction", 0.3),
    "gap_absorption": ("gap_absorption_per_cm", 3.0),
    "detector_reflection": ("detector_reflectance", 0.3),
    "surface_absorption": ("surface_loss", 0.03),
    "nonlinearity": ("nonlinearity", 0.01),
    "gap_index": ("gap_index_offset", 0.08),
}
SOME = {n: bench.EFFECTS[n] for n in (*HIDDEN, "scattering_gradient", "anisotropic_scattering")}


def models(seed, values=None, effects=(), change=lambda signal: signal):
    rng = np.random.default_rng(seed)
    signal = bench.signals({**TRUTH, **(values or {})}, effects)
    signal = change(signal * (1.0 + bench.SIGMA * rng.standard_normal(len(signal))))
    rows, noise = bench.readings(signal), bench.simulation_noise(seed)
    prior = TRUTH["alpha_abs_per_cm"] + bench.PRIOR_SIGMA * rng.standard_normal()
    return lambda added: bench.Model(rows, tuple(added), noise, prior, LIGHT)


def diagnosed(models, effects):
    """Of the fit there are no profiles, which nobody asks."""
    return diagnosis_of(judge(models, effects, fit=fit_model(models(()), profile=False)))


def hidden(name, seed, known):
    """A campaign with an effect, diagnosed with these."""
    parameter, size = HIDDEN[name]
    effects = {other: effect for other, effect in SOME.items() if other in known}
    return diagnosed(models(seed, {parameter: size}, (name,)), effects)


def test_a_first_look_leaves_out_what_gains_nothing():
    """With the bench as it is 14 behind the best in chi2, all eight effects got all photons."""
    found = models(6, {"gap_absorption_per_cm": 0.36}, ("gap_absorption",))
    explanations = bench.explanations_of(found, SOME)
    before, fits = explanations.baseline, explanations.singles()
    gains = {name: before.chi2 - fit.chi2 for name, fit in fits.items()}
    assert before.p_value < 0.01 and 14 < max(gains.values()) < 15 and min(gains.values()) < 1
    promising = promising_effects(found, SOME, before)
    assert promising.keys() == {"gap_absorption", "gap_index", "anisotropic_scattering"}
    worse = {*gains} - promising.keys()
    assert min(gains[name] for name in promising) > max(gains[name] for name in worse)
    # nor does a size with which the best effect is as far behind
    low, high = promising["gap_absorption"]
    profile = explanations.profile(("gap_absorption",), "gap_absorption", before)
    nodes = explanations.nodes(("gap_absorption",), "gap_absorption")
    for node, (chi2, _) in zip(nodes, profile, strict=True):
        within = low <= node["gap_absorption_per_cm"] <= high
        assert within == (chi2 < fits["gap_absorption"].chi2 + 14)
    assert 0.3 < low < 0.4 and high == 0.5


@pytest.mark.parametrize(("wrong", "seed"), [((5,), 1), ((2, 11), 2), ((1, 8, 13), 3)])
def test_wrong_readings_are_named(wrong, seed):
    """7 % up or down, as a laboratory's: one, two or three of sixteen."""
    factors = np.ones(len(bench.ROWS))
    factors[list(wrong)] += 0.07 * np.where(np.arange(len(wrong)) % 2, -1.0, 1.0)
    found = diagnosed(models(seed, change=lambda signal: signal * factors), SOME)
    assert found.verdict == "unexplained" and not found.repair[1:]
    labels, first = {f"row{i + 1}" for i in wrong}, found.suspect_readings[0]
    assert set(first.labels) == labels and found.candidates
    if len(wrong) == 1:
        assert first.kind == "bad_reading" and first.pull > 5
        pulls = found.baseline.left_out_pulls
        assert labels == {max(pulls, key=pulls.get)}
    named = [(suspect.kind, suspect.labels) for suspect in found.suspect_readings]
    assert len(named) == len(set(named))  # with stated errors and with larger ones it is one
    likeliest = next(iter(found.probabilities))
    assert all(label in likeliest.replace(" + ", " ").split() for label in labels)
    averaged = found.light_yield_averaged
    assert abs(averaged.value - 8.0) < 3.3 * averaged.sigma < 2.5


def test_swapped_rows_are_named():
    def change(signal):
        order = np.arange(len(signal))
        order[[3, 8]] = 8, 3
        return signal[order]

    found = diagnosed(models(7, change=change), SOME)
    assert found.verdict == "unexplained" and found.families[0].family == "instrument"
    for suspects in (found.suspect_readings, found.baseline.suspects):
        assert suspects[0].kind == "swapped_rows" and suspects[0].labels == ("row4", "row9")
    assert found.baseline.p_value < 1e-6 and found.baseline.suspects[0].p_value > 0.001


@pytest.mark.parametrize("swapped", [False, True])
def test_exchanged_labels_of_treatments_are_named(swapped):
    """Six rows in air have those of gel; as they are nothing is named."""
    signal = bench.signals(TRUTH)
    signal = signal * (1.0 + bench.SIGMA * np.random.default_rng(3).standard_normal(len(signal)))
    rows = []
    for row in bench.readings(signal):
        name = {1.0: "dry", 1.46: "gel"}.get(row.parameters["n_gap"], "others")
        rows.append(replace(row, without=(name,), group=name, group_sigma=0.002))
    dry, gel = ([i for i, row in enumerate(rows) if row.group == name] for name in ("dry", "gel"))
    for i, j in zip(dry, gel, strict=True) if swapped else ():
        assert rows[i].parameters["gap_mm"] == rows[j].parameters["gap_mm"]
        first, second = rows[i], rows[j]
        rows[i] = replace(first, signal=second.signal, sigma=second.sigma)
        rows[j] = replace(second, signal=first.signal, sigma=first.sigma)
    columns = ("gap_mm", "aperture_radius_mm", "crystal_height_mm")

    def model(added):
        treated = bench.Model(tuple(rows), tuple(added), bench.simulation_noise(3))
        treated.campaign.measurements = SimpleNamespace(columns=columns)
        return treated

    some = {name: SOME[name] for name in ("gap_bubble", "surface_absorption")}
    found = diagnosed(model, some)
    if not swapped:
        assert not found.suspect_readings and not found.baseline.suspects
        return
    assert found.verdict == "unexplained" and not found.repair[1:]
    for suspects in (found.suspect_readings, found.baseline.suspects):
        assert suspects[0].kind == "swapped_treatments" and suspects[0].labels == ("dry", "gel")
        assert "labels of all rows of dry and gel look swapped" in suspicion(suspects[0])


def test_many_readings_are_searched_in_little_memory():
    """Three mountings of every configuration, two unlike readings exchanged.

    Their own errors go with them: to first order, too, the best pairs are those of whole fits.
    """
    of_one, noise = bench.readings(bench.signals(TRUTH)), bench.simulation_noise(1)
    errors = bench.SIGMA * np.random.default_rng(1).standard_normal((3, len(of_one)))
    rows = [
        replace(row, label=f"{row.label} {mounting}", signal=row.signal * (1.0 + error))
        for mounting, own in enumerate(errors)
        for row, error in zip(of_one, own, strict=True)
    ]
    for place, other in ((20, rows[41]), (41, rows[20])):
        rows[place] = replace(rows[place], signal=other.signal, sigma=other.sigma)
    explanations = bench.explanations_of(
        lambda added: bench.Model(tuple(rows), added, noise, TRUTH["alpha_abs_per_cm"]), {}
    )
    fit = explanations.baseline
    tracemalloc.start()
    found = find_suspects(fit)
    likeliest = weigh_hypotheses(explanations, NullDistribution(explanations, ())).hypotheses[0]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found[0].labels == likeliest.suspect.labels == ("row5 1", "row10 2")
    assert peak < 20e6, peak

    def chi2(pair):
        return settle(fit.statistic.exchanged(*pair.exchange(len(rows))), fit.theta).chi2

    best = likely_swaps(fit, 5)
    assert sorted(best, key=chi2) == best


def test_the_truth_is_in_no_catalogue():
    """Effects hidden and left out: the yield is covered, and nothing wrong is sure.

    Wanted are 85 % within 2 errors: two of six or fewer have a probability of 0.006.
    """
    away = []
    for seed, name in enumerate(HIDDEN):
        found = hidden(name, seed, set(SOME) - {name})
        averaged = found.light_yield_averaged
        away.append((averaged.value - 8.0) / averaged.sigma)
        assert found.verdict != "adequate", name
        assert found.verdict != "missing_effect" or abs(away[-1]) < 2.0, name
        if found.verdict == "unexplained" and not found.suspect_readings:
            assert not found.repair[1:] and averaged.catalogue > 0.01 * averaged.value
    assert np.sum(np.abs(away) < 2.0) > 2, away


def test_what_looks_like_a_wrong_reading_may_have_no_name():
    """The interval is as narrow as if nothing were missing, and was widened by what wide ones need.

    Of 40 effects withheld five look like a wrong reading, or two (`scripts/trials formulas`).
    """
    factors = np.where(np.arange(len(bench.ROWS)) == 5, 1.07, 1.0)
    own = models(5, change=lambda signal: signal * factors)
    explanations = bench.explanations_of(own, SOME)
    null = NullDistribution(explanations, explanations.singles())
    weighing = weigh_hypotheses(explanations, null)
    assert weighing.families["instrument"] > 0.95

    def half_95(sigma, p_instrument):
        one = np.ones(1)
        _, factor = widening(weighing.design, (one, 0.0 * one, sigma * one), 0.0, p_instrument)
        return 1.96 * sigma * factor

    # where it may be, an interval ends where effects that look so end, whatever its own width
    assert half_95(0.005, 1.0) == pytest.approx(half_95(0.002, 1.0)) and half_95(0.002, 1.0) > 0.05
    assert half_95(0.002, 0.0) == pytest.approx(0.0039, rel=0.01)
    assert weighing.widening[0] < 2.0 < weighing.widening[1] < 10.0


def test_caution_costs_little_where_the_truth_is_known():
    """Twelve draws: the median of six was between 1.22 and 1.32 by their choice."""
    dearer = []
    for seed, name in enumerate([*HIDDEN, *HIDDEN]):
        found = hidden(name, seed, set(SOME))
        averaged = found.light_yield_averaged
        assert name in found.leading and abs(averaged.value - 8.0) < 3.3 * averaged.sigma, name
        (own,) = (each for each in found.candidates if each.effect == name)
        dearer.append(averaged.sigma / own.light_yield_ph_per_keV["sigma"])
    assert np.median(dearer) < 1.3, dearer


@pytest.mark.parametrize("row", [8, 10, 11])
def test_a_wrong_reading_that_pushes_a_fit_to_a_bound_is_enough(row):
    """Absorption ends at nothing: no second cause is needed, and the yield is that of the rest."""

    def written(signal):
        return np.where(np.arange(len(signal)) == row, 0.7 * signal, signal)

    explanations = bench.explanations_of(models(1, change=written), SOME)
    baseline = explanations.baseline
    assert baseline.at_bound[baseline.names.index("alpha_abs_per_cm")] == "min"
    null = NullDistribution(explanations, explanations.singles())
    weighing = weigh_hypotheses(explanations, null)
    first = weighing.hypotheses[0]
    assert first.causes == (f"bad reading row{row + 1}",) and weighing.shares[0] > 0.5
    scale = baseline.values["scale"] * np.exp(first.log_scale)
    assert abs(np.log(scale / TRUTH["scale"])) < 3.0 * first.log_scale_sigma < 0.05


def test_something_without_a_name_grows_with_the_misfit():
    """Its size is learned: the likeliest amplitude rises with what was drawn."""
    pattern = np.array(
        [(row["aperture_radius_mm"] < 8.0) * (row["n_gap"] - 1.3) for row in bench.ROWS]
    )
    likeliest = []
    for drawn in (0.0, 0.2, 0.8):
        own = models(9, change=lambda signal, a=drawn: signal * np.exp(a * pattern))
        explanations = bench.explanations_of(own, SOME)
        weighing = weigh_hypotheses(explanations, NullDistribution(explanations, ()))
        unknown = [h for h in weighing.hypotheses if h.name == UNKNOWN]
        likeliest.append(max(unknown, key=lambda h: h.log_weight).amplitude)
        nothing = weighing.families["none"]
        assert nothing > 0.5 if drawn == 0.0 else nothing < 1e-6
    assert likeliest[0] < likeliest[1] < likeliest[2]


def test_a_proposed_reading_buys_what_it_then_does():
    """Where there is one explanation the error is that of the fit with it: readings, a number."""
    signal = bench.signals(TRUTH)
    rows = bench.readings(signal)

    def explained(taken, numbers=1):
        sigma = bench.PRIOR_SIGMA / np.sqrt(numbers)
        return bench.explanations_of(
            lambda added: bench.Model(taken, added, light_yield=LIGHT, prior_sigma=sigma), {}
        )

    few = tuple(rows[i] for i in (0, 4, 8))
    before = explained(few)
    null = NullDistribution(before, ())
    weighing = weigh_hypotheses(before, null)
    only = next(hypothesis for hypothesis in weighing.hypotheses if not hypothesis.causes)
    judge = Judgement(before, null, replace(weighing, hypotheses=(only,), shares=np.ones(1)))
    minutes = {"crystal_height_mm": 90.0}
    proposals = MeasurementProposals(
        bench.ROWS[6:14],
        [lambda added: bench.Model(rows[6:14], added)],
        lambda added: bench.Model(few, added),
        bench.SIGMA,
        minutes,
    )
    found = next_measurements(judge, proposals)
    assert {one.kind for one in found} == {"reading", "number", "reading + reading"}
    for one in found:
        numbers = one.kind.count("number")
        chosen = [each for each in (one.parameters, one.also) if each]
        further = tuple(rows[bench.ROWS.index(each)] for each in chosen)
        after = explained((*few, *further), 1 + numbers).evidence(())
        sigma = after.sigma["scale"] / after.mean["scale"]
        assert one.light_yield_sigma == pytest.approx(sigma, rel=0.15)
        heights = {each["crystal_height_mm"] for each in chosen}
        assert one.hours == pytest.approx(0.5 * len(chosen) + 1.5 * len(heights) + numbers)


def test_what_has_no_name_is_likely_to_go_on_where_it_was_measured():
    """Drawn at the readings themselves it is their residual; far from all it is only as large."""
    change = np.where([row["aperture_radius_mm"] < 8.0 for row in bench.ROWS], 0.94, 1.0)
    explanations = bench.explanations_of(models(5, change=lambda signal: signal * change), SOME)
    frame, amplitude = BaselineFrame(explanations.baseline), 0.8
    fit = explanations.baseline
    thetas = np.repeat(fit.theta[None], 400, axis=0)
    far = {**bench.ROWS[0], "n_gap": 9.0}
    discrepancy = DiscrepancyModel(explanations, frame)
    drawn = discrepancy_at(fit, discrepancy, amplitude, thetas, [*bench.ROWS, far])
    residual = fit.statistic.signal / fit.signal - 1.0
    assert np.abs(drawn.mean(axis=0)[:-1] - residual).max() < 0.02
    covariance = discrepancy.covariance([far])
    unread = amplitude * np.sqrt(np.diag(covariance))
    # what a reading has alone is not repeated
    assert (drawn[:, :-1].std(axis=0) / unread[:-1]).max() < 0.6
    assert drawn[:, -1].std() == pytest.approx(unread[-1], rel=0.15)


def test_what_is_promised_is_what_most_outcomes_keep():
    """Of outcomes that go either way the median may be between, where hardly any end."""
    errors = np.array([0.010] * 40 + [0.011] * 20 + [0.025] * 5 + [0.060] * 55)
    assert _most_kept(errors) == (pytest.approx(0.010), 0.5, pytest.approx(0.060))
    assert np.median(errors) == pytest.approx(0.018)
    assert _most_kept(np.array([0.02] * 9 + [0.0])) == (
        pytest.approx(0.02),
        0.9,
        pytest.approx(0.0),
    )
    assert _most_kept(np.full(9, 0.02)) == (pytest.approx(0.02), 1.0, None)
