"""Plans: expected errors are those that fits to synthetic campaigns have."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from formula_surfaces import FormulaSurface
from refusals import refusal
from scipy import stats
from trials.surface_model import CampaignModel, RecordSurface

from mcrim_mitsuba.campaign.calibration import CommonErrors
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.core.rounding import percent
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_surface import record_surface
from mcrim_mitsuba.inference import plan as measuring
from mcrim_mitsuba.inference.diagnose import diagnose
from mcrim_mitsuba.inference.fit import fit_model
from mcrim_mitsuba.inference.plan import (
    EFFICIENCY,
    Conditions,
    Expectation,
    event_sigma,
    measured_conditions,
    plan,
)
from mcrim_mitsuba.inference.settings import REHEARSALS
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.inference.statistic import ErrorMatrices
from mcrim_mitsuba.laboratory.peak import COUNTING, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.output.sentences import rehearsal_text, verdict
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.launch_plan import LANES

# a right code fails each statistical test with one in 1000 fresh seeds
FALSE_ALARM = 1e-3
LIGHT_YIELD = "light_yield_ph_per_keV"
#: What is planned, if nothing else is.
TWO = {"n_gap": [1.0, 1.46], "mountings": [4], "events": [1e4], "anew": True}


#: Usual couplings.
LIQUIDS = 1.0, 1.333, 1.46, 1.515


def formulas(parameters):
    """Efficiency as a formula of both coefficients and the coupling, without any error."""
    filled = parameters["n_gap"] - 1

    def eta(a_s, a_a):
        grown = 0.12 + 0.4 * filled + (0.15 - 0.12 * filled) * a_s / (a_s + 0.3)
        return grown * math.exp(-(2.5 - 2 * filled) * a_a)

    return FormulaSurface(eta)


@pytest.mark.parametrize("chi2, told", [(11.0, True), (9.0, False)])
def test_a_campaign_whose_fit_fails_says_so(chi2, told):
    """Two degrees of freedom."""
    fit = SimpleNamespace(chi2=chi2, p_value=stats.chi2(2).sf(chi2), parameters={})
    notes = list(measuring._doubt(fit))
    assert bool(notes) is told
    assert not told or "chi2 = 11, p = 0.0041: the doubt about the model is not in" in notes[0]


@pytest.fixture
def article(scenes):
    return read_campaign(scenes / "camoo4_campaign.toml")


@pytest.fixture
def without_photons(monkeypatch):
    """Models by given surfaces instead of simulations; gives the campaigns that ask for them."""
    simulated = []

    def use(surfaces):
        def simulations(campaign, run):
            simulated.append(campaign)

            def predict_at(configurations, tolerances):
                readings = [
                    Reading(f"{i}", 1.0, 1.0, dict(values), line=2)
                    for i, values in enumerate(configurations)
                ]
                measured = replace(campaign.measurements, readings=tuple(readings))
                changed = replace(campaign, measurements=measured)
                return lambda effects: CampaignModel(changed, surfaces)

            return SimpleNamespace(
                fit=lambda: fit_model(CampaignModel(campaign, surfaces), profile=False),
                predict_at=predict_at,
                possible=dict,
                refusals=[],
                simulate=lambda effects, look: SimpleNamespace(
                    model=lambda effects=(): CampaignModel(campaign, surfaces)
                ),
                provenance=lambda: SimpleNamespace(notes=()),
            )

        monkeypatch.setattr(measuring, "CampaignSimulations", simulations)
        return simulated

    return use


def measured(campaign, planned, chosen, signals, mountings, events, prior=None):
    """The campaign with a plan's readings."""
    readings = []
    for i, signal in zip(chosen, signals, strict=True):
        each = planned.candidates[i]
        counted = each.event_sigma / math.sqrt(events * mountings)
        scatter = planned.conditions.mounting_scatter * each.signal / math.sqrt(mountings)
        sigma = math.hypot(counted, scatter)
        readings.append(Reading(f"{i}", float(signal), sigma, dict(each.parameters), line=2))
    made = replace(campaign, measurements=replace(campaign.measurements, readings=tuple(readings)))
    if prior is None:
        return made
    known = replace(campaign.parameters[ALPHA_ABS], prior=prior)
    return replace(made, parameters={**campaign.parameters, ALPHA_ABS: known})


def planned_error(planned, chosen, mountings, events):
    return next(
        p
        for p in planned.plans
        if (p.configurations, p.mountings, p.events) == (chosen, mountings, events)
    )


@pytest.mark.parametrize("mean", [14.3, 24.5])
def test_a_centroid_scatters_as_predicted(mean):
    """Fits of 80 histograms of 5000 events: their scatter, and the error from the expected one."""
    predicted = event_sigma(mean, Conditions()) / math.sqrt(5000)
    spectrum = PhotonSpectrum(mean, 5000)
    rng = np.random.default_rng(5)
    found = [fit_peak(spectrum.photons(), spectrum.sample(rng), shape=COUNTING) for _ in range(80)]
    chi2 = np.var([peak.centroid for peak in found], ddof=1) * 79 / predicted**2
    low, high = stats.chi2(79).ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2])
    assert low < chi2 < high
    # the background costs more than a factor of two over the bare width of the band
    bare = math.sqrt(mean + (0.1 * mean) ** 2) / math.sqrt(5000)
    assert 1.5 < predicted / bare < 3.0


def test_expected_errors_are_the_fit_s_own(article, without_photons):
    without_photons(formulas)
    planned = plan(article, 0.1, n_gap=[1.0, 1.333, 1.46], mountings=[3], events=[2e4], anew=True)
    for chosen in ((0, 2), (0, 1, 2)):
        expected = planned_error(planned, chosen, 3, 2e4)
        signals = [planned.candidates[i].signal for i in chosen]
        # an Asimov campaign: the readings are the predictions, the prior is the solution
        at = planned.solution[ALPHA_ABS].value
        asimov = measured(article, planned, chosen, signals, 3, 2e4, prior=at)
        found = fit_model(CampaignModel(asimov, formulas), profile=False).parameters
        light, scattering = found[LIGHT_YIELD], found[ALPHA_SCAT]
        for ours, theirs in ((expected.light_yield, light), (expected.alpha_scat, scattering)):
            assert ours.total == pytest.approx(theirs.sigma / theirs.value, rel=1e-4)
        for ours, theirs in (
            (expected.light_yield.statistical, light.contributions["statistical"]),
            (expected.light_yield.parts["prior of alpha_abs_per_cm"], light.contributions["prior"]),
            (expected.light_yield.parts[EFFICIENCY], light.contributions["detector_efficiency"]),
        ):
            assert ours == pytest.approx(theirs / light.value, rel=1e-3)


@pytest.mark.parametrize("of_channels", [{}, {"offset_sigma": 0.5, "nonlinearity_sigma": 0.002}])
def test_readings_so_far_count(article, without_photons, of_channels):
    """With what the calibration of channels moves all by, old and new.

    A plan began anew, as if nothing had been measured: the errors were those of its own rows.
    """
    without_photons(formulas)
    article = replace(article, common_errors=CommonErrors(**of_channels))
    planned = plan(article, 0.1, n_gap=[1.0, 1.333], mountings=[3], events=[2e4])
    kept = list(article.measurements.readings)

    def fitted(*chosen):
        """The whole errors of a fit to the campaign's readings and to some of a plan's."""
        signals = [planned.candidates[i].signal for i in chosen]
        new = measured(article, planned, chosen, signals, 3, 2e4).measurements
        both = replace(new, readings=(*kept, *new.readings))
        whole = CampaignModel(replace(article, measurements=both), formulas)
        found = fit_model(whole, profile=False).parameters
        return [found[name].sigma / found[name].value for name in (LIGHT_YIELD, ALPHA_SCAT)]

    so_far, _ = fitted()
    assert planned.so_far.total == pytest.approx(so_far, rel=1e-4)
    assert planned.undetermined == () and planned.so_far.parts["events"] == 0.0
    for chosen in ((0,), (1,), (0, 1)):
        expected = planned_error(planned, chosen, 3, 2e4)
        both = [expected.light_yield.total, expected.alpha_scat.total]
        assert both == pytest.approx(fitted(*chosen), rel=2e-3)
        assert expected.light_yield.total < planned.so_far.total
    # sets of long names go by numbers in tables
    assert planned.number((0, 1)) == "gap index 1, 1.333"
    candidates = (
        replace(of, parameters={**of.parameters, "top": 1.0}) for of in planned.candidates
    )
    assert replace(planned, candidates=tuple(candidates)).number((0, 1)) == "1 + 2"
    assert verdict(replace(planned, wanted=1.01 * so_far)) == (
        f"The readings so far have the light yield to {percent(so_far)}: enough.",
    )


def test_what_is_planned_is_what_the_bench_was_measured_with(scenes, tmp_path):
    """Couplings that this laboratory has not, and never what its columns switch."""
    text = (scenes / "bgo_esr.toml").read_text().replace('= "bgo', f'= "{scenes}/bgo')
    path = tmp_path / "bgo.toml"

    def cells(more="", n_gap=None):
        path.write_text(text + more)
        return measuring._configurations(read_campaign(path), n_gap)

    state = {"top": 1.0, "sides": 1.0}, {"top": 0.0, "sides": 1.0}, {"top": 0.0, "sides": 0.0}
    assert cells() == [{"n_gap": n, **of} for n in (1.0, 1.465) for of in state]
    assert cells(n_gap=[1.0, 1.3]) == [{"n_gap": n, **state[0]} for n in (1.0, 1.3)]
    lid = "[next_measurements]\nn_gap = [1.5]\ntop = [0, 1]\n"
    assert cells(lid) == [{"n_gap": 1.5, **of} for of in (state[1], state[0])]
    gaps = f"[next_measurements]\ngap_mm = {[0.01 * i for i in range(1, 10)]}\n"
    assert "9 configurations have too many" in refusal(cells, gaps)
    # of one coupling, at seven places and both ends
    bar = read_campaign(scenes / "plastic_bar.toml")
    assert "14 configurations have too many" in refusal(measuring._configurations, bar, None)
    many = read_campaign(scenes / "camoo4_misfit.toml")
    assert [row["n_gap"] for row in measuring._configurations(many, None)] == list(LIQUIDS)
    article = read_campaign(scenes / "camoo4_campaign.toml")
    (air, _) = article.measurements.readings
    dry = replace(article, measurements=replace(article.measurements, readings=(air,)))
    assert measuring._configurations(dry, None) == [{"n_gap": n} for n in LIQUIDS]


def test_tolerances_are_in_a_plan_as_in_the_fit_of_its_readings(scenes, tmp_path, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))  # both have the same photons
    for name in ("camoo4.xml", "camoo4_campaign.toml", "camoo4_measured.csv"):
        (tmp_path / name).write_text((scenes / name).read_text())
    path, run = tmp_path / "camoo4_campaign.toml", Run(16 * LANES)
    with path.open("a") as file:
        file.write("[tolerances]\nn_gap = 0.03\nn_crystal = 0.03\ngap_mm = 0.015\n")
    planning = plan(path, 0.2, **TWO, run=run)
    (best,) = (each for each in planning.plans if len(each.configurations) == 2)
    scatter = planning.conditions.mounting_scatter / math.sqrt(best.mountings)
    events = best.mountings * best.events
    rows = []
    for i, each in enumerate(planning.candidates):
        error = math.hypot(each.event_sigma / math.sqrt(events), scatter * each.signal)
        rows.append(f"{i},{each.signal},{error},{each.parameters['n_gap']}")
    (tmp_path / "camoo4_measured.csv").write_text("\n".join(["label,signal,sigma,n_gap", *rows]))
    fit = CampaignSimulations(read_campaign(path), run).fit().parameters[LIGHT_YIELD]
    # the simulation's error, which a plan has not, apart
    sigma = math.sqrt(fit.sigma**2 - fit.contributions["monte_carlo"] ** 2)
    assert best.light_yield.total == pytest.approx(sigma / fit.value, rel=0.02)
    of_numbers = [best.light_yield.parts[f"prior of {n}"] for n in ("gap index 1.46", "gap")]
    assert of_numbers[0] > 3.0 * of_numbers[1] > 0.0
    tolerances = [part for name, part in best.light_yield.parts.items() if "of " in name]
    absorption = best.light_yield.parts["prior of alpha_abs_per_cm"]
    assert math.hypot(*tolerances) == pytest.approx(
        math.hypot(absorption, fit.contributions["tolerances"] / fit.value), rel=0.05
    )


def test_100_synthetic_campaigns_scatter_as_planned(scenes, article, without_photons):
    """Gaussian readings of simulated efficiencies, and priors, drawn anew and fitted each time."""
    known = replace(article.parameters[ALPHA_ABS], prior_sigma=0.006)
    campaign = replace(article, parameters={**article.parameters, ALPHA_ABS: known})
    scene, made = read_scene(scenes / "camoo4.xml"), {}

    def surfaces(parameters):
        index = parameters["n_gap"]
        if index not in made:
            surface, _ = record_surface(
                scene.with_overrides({"n_gap": index}),
                [(0.3, 0.02), (0.55, 0.04), (1.0, 0.06)],
                run=Run(49_152, seed=3),
                alpha_scat_range_per_cm=(0.1, 3.0),
                alpha_abs_range_per_cm=(0.0, 0.15),
            )
            made[index] = RecordSurface(surface.grid, surface.table)
        return made[index]

    without_photons(surfaces)
    planned = plan(campaign, 0.1, n_gap=[1.0, 1.515], mountings=[8], events=[1e5], anew=True)
    expected = planned_error(planned, (0, 1), 8, 1e5)
    truth = {name: known.value for name, known in planned.solution.items()}
    rng = np.random.default_rng(11)
    pulls = []
    for _ in range(100):
        exact = [each.signal for each in planned.candidates]
        drawn = measured(campaign, planned, (0, 1), exact, 8, 1e5)
        signals = [rng.normal(r.signal, r.sigma) for r in drawn.measurements.readings]
        prior = rng.normal(truth[ALPHA_ABS], 0.006)
        synthetic = measured(campaign, planned, (0, 1), signals, 8, 1e5, prior=prior)
        found = fit_model(CampaignModel(synthetic, surfaces), profile=False).parameters
        off = [found[name].value / truth[name] - 1 for name in ("scale", ALPHA_SCAT)]
        # the scale does not know of the detector efficiency
        errors = [expected.light_yield.of_plan, expected.alpha_scat.total]
        pulls.append(np.divide(off, errors))
    low, high = stats.chi2(100).ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2])
    for of_one in np.transpose(pulls):
        assert low < np.sum(of_one**2) < high, np.sum(of_one**2)


def test_plans_are_ordered_and_add_up(article, without_photons):
    without_photons(formulas)
    conditions = Conditions(events_per_second=10.0, minutes_per_mounting=60.0)
    choice = {"n_gap": [1.0, 1.46], "mountings": [4, 1], "events": [1e3, 1e4], "anew": True}
    planned = plan(article, 0.2, conditions=conditions, **choice)
    assert planned.undetermined == ((0,), (1,))
    order = [(1, 1e3), (1, 1e4), (4, 1e3), (4, 1e4)]
    assert [(p.mountings, p.events) for p in planned.plans] == order
    assert planned.plans[-1].hours == pytest.approx(2 * 4 * (1 + 1e4 / 36e3))
    for each in planned.plans:
        light = each.light_yield
        assert light.total == pytest.approx(math.hypot(light.statistical, light.systematic))
        assert light.parts["events"] > 0 and light.total > planned.floors[(0, 1)].total
    few, many = planned.plans[0].light_yield, planned.plans[1].light_yield
    assert many.parts["events"] == pytest.approx(few.parts["events"] / math.sqrt(10), rel=0.05)
    assert planned.cheapest is planned.plans[0]
    (line,) = verdict(planned)
    cheapest = "Cheapest plan for a light yield to 20.0 %: gap index 1, 1.46; 1 mounting"
    assert line.startswith(cheapest)


def test_what_forbids_a_precision_is_named(article, without_photons):
    without_photons(formulas)
    forbidden = plan(article, 0.09, **TWO)
    first, second = verdict(forbidden)
    assert "cannot be reached, however many events and mountings" in first
    assert "What forbids it first is the detector efficiency" in first
    assert "quantum efficiency is calibrated better" in first
    assert second.startswith("The statistical part alone reaches 9.0 % with gap index 1, 1.46")
    # as much as is said there suffices
    told = float(first.partition("would have to fall to ")[2].split()[0]) / 100
    efficiency = article.light_yield.detector_efficiency
    better = replace(article.light_yield, detector_efficiency_sigma=0.99 * told * efficiency)
    assert plan(replace(article, light_yield=better), 0.09, **TWO).cheapest is not None
    # with an exact efficiency the prior is what is left
    light = replace(article.light_yield, detector_efficiency_sigma=0.0)
    exact = replace(article, light_yield=light)
    assert "mcrim lab absorption" in verdict(plan(exact, 0.01, **TWO))[0]
    # and what statistics could reach is said to be reachable
    three = plan(exact, 0.01, n_gap=[1, 1.2, 1.46], mountings=[1], events=[1e3], anew=True)
    assert "is not among these plans" in verdict(three)[0]


def test_the_efficiency_s_error_is_named_by_its_origins(article, without_photons):
    without_photons(formulas)
    known = article.light_yield
    parts = {
        "tube scale": 0.06 * known.detector_efficiency,
        "quantum efficiency curve": 0.08 * known.detector_efficiency,
    }
    campaign = replace(article, light_yield=replace(known, efficiency_parts=parts))
    planned = plan(campaign, 0.09, **TWO)
    light = planned.plans[0].light_yield
    assert light.efficiency == pytest.approx(0.1)
    assert light.total == pytest.approx(math.hypot(light.of_plan, 0.1))
    first = verdict(planned)[0]
    assert "What forbids it first is the quantum efficiency curve" in first
    assert "this very detector" in first


def test_two_errors_that_differ_are_said_differently(article, without_photons):
    without_photons(formulas)
    found = plan(article, 0.12, n_gap=[1.0, 1.46], mountings=[1], events=[1e3], anew=True)
    floor = found.lowest_floor[1].total
    first, *_ = verdict(replace(found, wanted=floor * (1 - 1e-5)))
    said = re.search(r"to ([\d.]+) % cannot be reached.* would leave ([\d.]+) %", first)
    assert float(said[1]) < float(said[2])
    first, *_ = verdict(replace(found, wanted=found.plans[0].light_yield.total * (1 - 1e-5)))
    said = re.search(r"to ([\d.]+) % is not among.* light yield to ([\d.]+) %", first)
    assert float(said[1]) < float(said[2])


def test_a_plan_that_leaves_nothing_to_check_with_says_so_without_photons(article, without_photons):
    simulated = without_photons(formulas)
    two = plan(article, 0.2, **TWO)
    assert simulated == [article] and two.capability is None
    assert rehearsal_text(two) == (
        "No missing effect could show in readings of gap index 1, 1.46: none is left to check the "
        "model with. That takes one more, with another coupling, mask or height."
    )
    three = plan(article, 0.01, n_gap=[1.0, 1.2, 1.46], mountings=[4], events=[1e4], anew=True)
    assert three.capability is not None and three.proposed.configurations == (0, 1, 2)
    rows = simulated[-1].measurements.readings
    assert [row.parameters for row in rows] == [of.parameters for of in three.candidates]


def test_a_plan_could_name_what_a_diagnosis_of_its_readings_could(article, tmp_path, monkeypatch):
    """Readings as the solution predicts them, with the errors that are expected."""
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))  # both have the same photons
    names = ("gap_bubble", "edge_chamfer", "background")
    known = {name: article.catalogue[name] for name in names}
    campaign = replace(article, catalogue=known, tolerances=())
    run, couplings = Run(photons=8 * LANES), (1.0, 1.1, 1.2, 1.333, 1.46, 1.6, 1.74, 1.9)
    planned = plan(
        campaign,
        0.01,
        n_gap=couplings,
        mountings=[1],
        events=[1e7],
        conditions=Conditions(mounting_scatter=0.001),
        run=run,
        anew=True,
    )
    chosen = planned.proposed.configurations
    signals = [planned.candidates[place].signal for place in chosen]
    readings = measured(campaign, planned, chosen, signals, 1, 1e7)
    could, can = planned.capability, diagnose(CampaignSimulations(readings, run)).capability
    assert could.named.keys() == can.named.keys() == set(names)
    assert max(could.named.values()) > 0.5
    # the same draws, of which one may lie at the edge of being named
    for name in names:
        assert could.named[name] == pytest.approx(can.named[name], abs=1.5 / REHEARSALS.draws)
    assert could.false == pytest.approx(can.false, abs=0.5 / REHEARSALS.draws)
    assert could.light_yield_sigma == pytest.approx(can.light_yield_sigma, rel=1e-3)
    assert "What readings of gap index 1, 1.1, " in (said := rehearsal_text(planned))
    assert (
        "of 3 effects of usual sizes they would name 1 more often than not (bevel of the edges"
        in said
    )


def _hold_the_scale(campaign):
    known = replace(campaign.parameters[ALPHA_ABS], name="scale", start=1.0, fixed=True)
    return replace(campaign, scale=known)


def _efficiencies(campaign):
    readings = [
        replace(r, signal=r.signal / 57, sigma=r.sigma / 57) for r in campaign.measurements.readings
    ]
    return replace(campaign, measurements=replace(campaign.measurements, readings=tuple(readings)))


@pytest.mark.parametrize(
    ("change", "n_gap", "says"),
    [
        (lambda c: c, [1.0] + [1.3 + 0.01 * i for i in range(8)], "too many combinations"),
        (lambda c: c, [0.5, 1.0], "no refractive index"),
        (lambda c: c, [1.0], "none of these couplings together determine"),
        (_hold_the_scale, [1.0, 1.46], "the scale is held"),
        (_efficiencies, [1.0, 1.46], "does not stand out of the pedestal"),
    ],
    ids=["many", "no-index", "one", "held", "efficiencies"],
)
def test_what_cannot_be_planned(article, without_photons, change, n_gap, says):
    without_photons(formulas)
    with pytest.raises(InputError, match=says):
        plan(change(article), 0.1, n_gap=n_gap, mountings=[1], events=[1e4], anew=True)


def test_the_default_precision_is_shown_as_it_is_written(mcrim):
    assert "[default: 10%]" in mcrim.shown("lab", "plan", "--help")


def test_the_scatter_of_a_raw_campaign_is_its_own(article):
    def reading(centroids, sigma):
        peaks = [
            SimpleNamespace(centroid=c, centroid_sigma=sigma, shape=COUNTING, intrinsic_spread=0.08)
            for c in centroids
        ]
        mountings = [SimpleNamespace(row=SimpleNamespace(use=True), peak=peak) for peak in peaks]
        combined = SimpleNamespace(mean=float(np.mean(centroids)))
        return SimpleNamespace(mountings=mountings, combined=combined)

    raw = SimpleNamespace(readings={"air": reading([9.5, 10.5], 0.3), "gel": reading([20, 20], 0)})
    found = measured_conditions(replace(article, raw=raw))
    # variances 0.005 - 0.0009 and 0 of one degree of freedom each
    assert found.mounting_scatter == pytest.approx(math.sqrt((0.005 - 0.0009) / 2))
    assert found.intrinsic_spread == 0.08
    assert measured_conditions(article).mounting_scatter == pytest.approx(0.028, rel=0.01)


# ---- transmittances ----


def test_transmittances_that_were_not_measured_are_proposed(scenes):
    few = Run(photons=LANES, check=False)

    def exact(name):
        return replace(read_campaign(scenes / name), tolerances=())

    def proposed(campaign):
        found = CampaignSimulations(campaign, few).proposals()
        beams = [each for each in found.configurations if each.get("kind") == "transmittance"]
        return beams, np.asarray(found.relative_sigma)[-len(beams) :]

    light = exact("camoo4_campaign.toml")
    assert proposed(light)[0] == [{"kind": "transmittance", "acceptance_deg": 5.0}]
    three = exact("camoo4_three.toml")
    beams, sigmas = proposed(three)
    own = {"kind": "transmittance", "acceptance_deg": 5.0}
    along = own | {"beam_axis": "z"}
    assert beams == [
        own | {"acceptance_deg": 1.0},
        own | {"acceptance_deg": 30.0},
        along,
        along | {"crystal_height_mm": 20.0},
    ]
    assert sigmas == pytest.approx(0.012 / 0.76)
    only = replace(three, next_measurements={"n_gap": [1.0, 1.333]})
    assert CampaignSimulations(only, few).proposals().configurations == [{"n_gap": 1.333}]
    angles = replace(three, next_measurements={"acceptance_deg": [2.0, 5.0]})
    assert CampaignSimulations(angles, few).proposals().configurations == [
        {"kind": "transmittance", "acceptance_deg": 2.0}
    ]
    # a scene that does not name the crystal's width
    text = light.scene.path.read_text().replace("crystal_width_mm", "side_mm")
    literal = replace(light, scene=light.scene.edited(text))
    found = CampaignSimulations(literal, few).proposals().configurations
    assert not any("kind" in each for each in found)


def test_a_measured_transmittance_goes_on_into_a_plan(scenes, without_photons):
    """Its slopes know nothing of the scale, and what it tells narrows what light leaves open."""
    three = read_campaign(scenes / "camoo4_three.toml")
    light = [reading for reading in three.measurements.readings if not reading.of_beam]
    (beam,) = (reading for reading in three.measurements.readings if reading.of_beam)
    slopes = np.array([[8.0, 0.29], [3.0, 0.52], [-0.7, 0.0], [-0.7, 0.0]])

    def expected(readings, group_sigma=0.0):
        """Of a fit to these readings, two of light and perhaps beams, which are of one group."""
        own = np.array([reading.sigma for reading in readings]) ** 2
        shared, none = np.full(len(readings), group_sigma), np.zeros((len(readings), 0))
        mountings = np.array([0, 1, 2, 2])[: len(readings)]
        labels = [reading.label for reading in readings]
        statistic = SimpleNamespace(prior_weight=np.zeros(2), labels=labels)
        fit = SimpleNamespace(
            theta=np.array([0.1, 48.0]),
            names=("alpha_scat_per_cm", "scale"),
            model=SimpleNamespace(readings=readings, campaign=three),
            minimum=SimpleNamespace(
                statistic=statistic,
                slopes=slopes[: len(readings)],
                weights=SimpleNamespace(
                    errors=ErrorMatrices(own, shared, mountings, none, none, none)
                ),
            ),
            offsets=(),
        )
        prediction = SimpleNamespace(
            signal=np.array([14.0, 25.0]),
            signal_slopes=slopes[:2],
            signal_per_eta=np.full(2, 48.0),
            eta_of_tolerances=None,
        )
        further = SimpleNamespace(predict=lambda theta, **asked: prediction)
        return Expectation(fit, further, [{"n_gap": 1.0}, {"n_gap": 1.46}], Conditions())

    found, without = expected([*light, beam]), expected(light)
    assert found.determined([0]) and not without.determined([0])
    told, less = (each.errors([0, 1], 4, 1e4)[0] for each in (found, without))
    assert told.of_plan < less.of_plan
    assert told.parts["prior of transmittance"] > 0 and told.priors > 0 == less.priors
    # what two share is not told twice
    sigma = math.hypot(beam.sigma / math.sqrt(2), 0.03)
    one = expected([*light, replace(beam, sigma=sigma)])
    two = expected([*light, beam, replace(beam, label="again")], 0.03)
    assert two.errors([0, 1], 4, 1e4)[0].total == pytest.approx(one.errors([0, 1], 4, 1e4)[0].total)
