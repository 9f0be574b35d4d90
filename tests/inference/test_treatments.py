"""Rows that switch effects, sizes that are shared, and several lines.

Statistical tests have fixed seeds and state their false-alarm level.
"""

import dataclasses

import numpy as np
import pytest
from places import SCENES, cases_of
from refusals import refusal
from scipy import stats

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects, measurements_text
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.inference.compare import find_trends
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.fit import fit_model, result_of
from mcrim_mitsuba.inference.repair import mended_scene, scene_text
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.output.public import simulate
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.transport.launch_plan import LANES

cases = cases_of(__file__)

CSV = """label,signal,sigma,ground_top,ground_side,wrap_contact,nonlinearity,energy_keV
polished,1.0,0.05,0,0,0,0,511
top,1.5,0.05,1,0,0,1,511
sides,0.4,0.02,0,1,0,1,511
both,0.4,0.02,1,1,1,1,511
both high,0.9,0.02,1,1,1,1,1275
both higher,0.9,0.03,1,1,1,1,1400
"""
TEXT = f"""scene = '{SCENES / "gagg" / "gagg.xml"}'
measurements = "rows.csv"
effects = ["ground_side", "ground_top"]
[parameters.ground_side_alpha]
start = 0.3
min = 0.1
max = 0.8
[parameters.ground_top_alpha]
same_as = "ground_side_alpha"
[parameters.alpha_scat_per_cm]
start = 0.05
[parameters.alpha_abs_per_cm]
start = 0.02
prior = 0.02
prior_sigma = 0.005
[tolerances]
none = true
"""
TRUTH = {
    "ground_side_alpha": 0.45,
    "alpha_scat_per_cm": 0.08,
    "alpha_abs_per_cm": 0.022,
    "scale": 2.0,
}


@pytest.fixture
def read(tmp_path):
    def read(text=TEXT, rows=CSV):
        (tmp_path / "rows.csv").write_text(rows)
        (tmp_path / "campaign.toml").write_text(text)
        return read_campaign(tmp_path / "campaign.toml")

    return read


@pytest.fixture(scope="module")
def shipped():
    """The shipped bar of six finishes, its numbers exact, and its model."""
    campaign = dataclasses.replace(read_campaign(SCENES / "gagg" / "gagg.toml"), tolerances=())
    return campaign, CampaignSimulations(campaign, Run(4 * LANES, seed=5)).models.model()


def test_each_finish_is_predicted_as_it_is_simulated(shipped):
    """One fit of 1000 says otherwise: sizes far from where they begin, rows by their own scenes."""
    campaign, model = shipped
    sizes = {n: TRUTH[n] for n in ("ground_side_alpha", "alpha_scat_per_cm", "alpha_abs_per_cm")}
    theta = np.array([{**sizes, "scale": 1.0}[parameter.name] for parameter in model.free])
    predicted = model.predict(theta, check=True)
    away = []
    for row, eta, sigma in zip(model.readings, predicted.eta, predicted.eta_sigma, strict=True):
        ground = {n: 0.45 for n in ("top", "side", "bottom") if f"ground_{n}" not in row.without}
        alphas = {f"ground_{n}_alpha": ground.get(n, 0.0) for n in ("top", "side", "bottom")}
        values = {**campaign.scene.parameters, **sizes, **alphas}
        scene = campaign.scene.with_overrides(values)
        slow = simulate(scene, photons=200_000, seed=9)
        away.append((eta - slow.eta) / np.hypot(sigma, slow.eta_sigma))
    assert np.square(away).sum() < stats.chi2.ppf(0.999, len(away)), away


def test_shared_sizes_are_found_again(shipped):
    """Pulls of 100 campaigns: each limit fails one test of 1000."""
    campaign, model = shipped
    names = [parameter.name for parameter in model.free]
    truth = np.array([TRUTH[name] for name in names])
    true = model.predict(truth).signal
    rng, pulls = np.random.default_rng(11), []
    for _ in range(100):
        drawn = true * (1.0 + 0.01 * rng.standard_normal(len(true)))
        prior = 0.022 + 0.002 * rng.standard_normal()
        rows = [
            dataclasses.replace(row, signal=signal, sigma=0.01 * at)
            for row, signal, at in zip(model.readings, drawn, true, strict=True)
        ]
        measured = dataclasses.replace(campaign.measurements, readings=tuple(rows))
        drawn_campaign = dataclasses.replace(campaign, measurements=measured)
        drawn_campaign = drawn_campaign.with_priors({"alpha_abs_per_cm": (prior, 0.002)})
        drawn_model = type(model)(drawn_campaign, model.responses, (), model.anchor)
        fit = result_of(find_minima(Statistic(drawn_model)), profile=False)
        sigmas = [fit.parameters[name].sigma for name in names]
        pulls.append((np.array([fit.values[name] for name in names]) - truth) / sigmas)
    # Monte Carlo noise is part of the errors and not of these readings, which are the model's own
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 100) / 100)
    assert (np.std(pulls, axis=0) < high).all(), np.std(pulls, axis=0)
    assert (np.std(pulls, axis=0) > 0.8 * low).all(), np.std(pulls, axis=0)
    assert (np.abs(np.mean(pulls, axis=0)) < 3.5 / 10).all(), np.mean(pulls, axis=0)


def test_pulls_are_told_along_what_columns_switch(shipped):
    """Rows with a ground top 10 % too bright: compare said nothing of the column, nor a report."""
    campaign, model = shipped
    readings = []
    for row in campaign.measurements.readings:
        too_bright = 1.1 if "ground_top" not in row.without else 1.0
        readings.append(dataclasses.replace(row, signal=too_bright * row.signal))
    measured = dataclasses.replace(campaign.measurements, readings=tuple(readings))
    changed = dataclasses.replace(campaign, measurements=measured)
    fit = find_minima(Statistic(type(model)(changed, model.responses, (), model.anchor)))[0]
    trends = {trend.parameter: trend for trend in find_trends(fit)}
    assert trends.keys() == {"ground_top", "ground_side", "ground_bottom"}
    low, high = trends["ground_top"].mean_pulls
    assert trends["ground_top"].levels == (0.0, 1.0) and low < high
    bare, *_, ground = (changed.cells(row) for row in readings)
    assert set(bare.values()) == {0.0} and 1.0 in ground.values()
    rows = result_of([fit], profile=False).rows
    assert [row.parameters for row in rows] == [changed.cells(row) for row in readings]


def test_columns_take_a_wrapping_off(read):
    """By its id, or a face: what is left is as if it was written so."""
    rows = "label,signal,sigma,wrapping,n_gap\nwrapped,3,0.1,1,1.46\nbare,1,0.1,0,1.46\n"
    scene = SCENES / "lyso_teflon.xml"
    text = f"scene = '{scene}'\nmeasurements = 'rows.csv'\n[parameters.alpha_scat_per_cm]\n"
    text += "start = 0.05\nfixed = true\n[parameters.alpha_abs_per_cm]\nstart = 0.03\n"
    text += "fixed = true\n[tolerances]\nnone = true\n"
    faces = rows.replace("wrapping", "sides").replace("bare,", "side bare,")
    for csv, without in ((rows, "top sides"), (faces, "sides")):
        campaign = read(text, csv)
        bare = campaign.scene.with_overrides(campaign.measurements.readings[1].parameters)
        assert without in {str(value) for value in bare.parameters.values()}
        # as the file has it, without what that is made of
        column = csv.split(",")[3]
        cells = [campaign.cells(row) for row in campaign.measurements.readings]
        assert cells == [{"n_gap": 1.46, column: 1.0}, {"n_gap": 1.46, column: 0.0}]
        written = scene.read_text().replace(
            'name="film" value="$film_mm"/>',
            f'name="film" value="$film_mm"/>\n    <string name="without" value="{without}"/>',
        )
        first, second = (
            simulate(each, photons=20_000, seed=3, n_gap=1.46)
            for each in (bare, read_scene(scene).edited(written))
        )
        assert first.eta == second.eta
        if without == "top sides":  # then there is none, to five standard errors
            plain = simulate(SCENES / "lyso_sipm.xml", photons=20_000, seed=4, n_gap=1.46)
            assert abs(first.eta - plain.eta) < 5 * np.hypot(first.eta_sigma, plain.eta_sigma)
    message = refusal(read, text, rows.replace("0,1.46", "0.5,1.46"))
    assert "neither 0 nor 1" in message
    message = refusal(read, f"{text}[next_measurements]\nwrapping = [0.5]\n", rows)
    assert "wrapping is not a list of 0 and 1; write wrapping = [0, 1]" in message
    candidate = rows.replace("wrapping", "wrap_contact")
    message = refusal(read, f"{text}[next_measurements]\nwrap_contact = [0, 1]\n", candidate)
    assert "switches an effect that is not in the bench; remove wrap_contact, or name it" in message


@pytest.mark.parametrize("apart", [False, True])
def test_columns_take_a_sheet_off(read, tmp_path, apart):
    """Paper over the crystal, which wears a bsdf of its own or one by its id; nothing else."""
    plain = read_scene(SCENES / "lyso_sipm.xml")
    text = add("top_reflector", plain).replace('id="top_reflector"', 'id="paper"')
    if apart:
        start = text.index("<bsdf", text.index('id="paper"'))
        end = text.index("</bsdf>", start) + len("</bsdf>")
        white = text[start:end].replace("<bsdf", '<bsdf id="white"')
        text = text[:start] + '<ref id="white"/>' + text[end:]
        text = text.replace("  <!-- A white reflector exactly", f"  {white}\n  <!-- A white")
    (tmp_path / "bench.xml").write_text(text)
    campaign = "scene = 'bench.xml'\nmeasurements = 'rows.csv'\n[parameters.alpha_abs_per_cm]\n"
    campaign += "start = 0.03\nfixed = true\n[parameters.alpha_scat_per_cm]\nstart = 0.05\n"
    rows = "label,signal,sigma,paper\nwith it,1.2,0.1,1\nbare,1,0.1,0\n"
    scene, (first, second) = (c := read(campaign, rows)).scene, c.measurements.readings
    for row, bench in ((first, read_scene(tmp_path / "bench.xml")), (second, plain)):
        etas = [
            simulate(each, photons=5_000, seed=3).eta
            for each in (scene.with_overrides(row.parameters), bench)
        ]
        assert etas[0] == etas[1]
    for name in ("crystal_top", "detector", "papers"):
        message = refusal(read, campaign, rows.replace("paper", name))
        assert f"column {name}: neither a column" in message and "\n" not in message


def test_a_switch_masks_what_only_weighs_or_reads(read):
    """A column of an effect that is not switched on is of a candidate, which acts on its rows."""
    campaign = read(TEXT.replace('"ground_top"]', '"ground_top", "nonlinearity"]'))
    assert campaign.effects == ("nonlinearity",)
    simulations = CampaignSimulations(campaign, Run(LANES, seed=2, check=False))
    models = simulations.simulate(["wrap_contact", "ground_loss"])
    on = np.array([0, 0, 0, 1, 1, 1], dtype=bool)
    moved = np.abs(models.responses.effects["wrap_contact"].log_ratio).max(axis=(0, 2, 3))
    assert ((moved > 0) == on).all()
    # what acts on ground faces has nothing to act on where none is
    moved = np.abs(models.responses.effects["ground_loss"].log_ratio).max(axis=(0, 2, 3))
    assert ((moved > 0) == [False, True, True, True, True, True]).all()
    model = models.model()
    start = {parameter.name: parameter.start for parameter in model.free} | {"scale": 2.0}
    bent = {**start, "nonlinearity": 0.3}
    plain, read_bent = (
        model.predict(np.array([values[p.name] for p in model.free])).signal
        for values in ({**start, "nonlinearity": 0.0}, bent)
    )
    assert read_bent == pytest.approx(plain / (1 + 0.3 * plain * (np.arange(6) > 0)), rel=1e-12)


def test_light_is_in_proportion_to_the_energy(read):
    """Of one configuration, but for a scintillator that is not proportional, with its slope."""
    campaign = read().with_effects(["non_proportionality"])
    simulations = CampaignSimulations(campaign, Run(LANES, seed=2, check=False))
    model = simulations.models.model()
    values = {p.name: p.start for p in model.free} | {"scale": 2.0, "non_proportionality": 0.1}
    theta = np.array([values[p.name] for p in model.free])
    signal = model.predict(theta).signal
    ratio = np.array([511.0, 1275.0, 1400.0]) / 511.0
    assert signal[3:] / signal[3] == pytest.approx(ratio**1.1, rel=1e-12)
    assert model.predict_many(theta[None])[0] == pytest.approx(signal, rel=1e-6)
    column = [p.name for p in model.free].index("non_proportionality")
    step = np.eye(len(theta))[column] * 1e-5
    slope = (model.predict(theta + step).signal - model.predict(theta - step).signal) / 2e-5
    assert model.predict(theta).signal_slopes[:, column] == pytest.approx(slope, rel=1e-6)


def test_a_second_line_tells_a_bent_readout_from_all_else(read):
    """A readout that bends by 30 % is found with the second line, and hides without it."""
    rows = CSV.replace("nonlinearity,", "").replace(",0,511", ",511").replace(",1,511", ",511")
    rows = rows.replace(",1,1275", ",1275").replace(",1,1400", ",1400")
    # what grinding does is known, so that one line says anything at all
    text = TEXT.replace("start = 0.3\n", "start = 0.3\nprior = 0.3\nprior_sigma = 0.02\n")
    campaign = read(text, rows).with_effects(["nonlinearity"])
    model = CampaignSimulations(campaign, Run(LANES, seed=2)).models.model()
    values = {p.name: p.start for p in model.free} | {"scale": 2.0, "nonlinearity": 0.3}
    true = model.predict(np.array([values[p.name] for p in model.free])).signal

    def size_of(used):
        readings = tuple(
            dataclasses.replace(row, signal=at, sigma=0.01 * at, use=on)
            for row, at, on in zip(model.readings, true, used, strict=True)
        )
        measured = dataclasses.replace(campaign.measurements, readings=readings)
        own = dataclasses.replace(campaign, measurements=measured)
        fit = fit_model(type(model)(own, model.responses, own.switched_on, model.anchor))
        return fit.parameters["nonlinearity"]

    both, one = size_of([True] * 6), size_of([True] * 4 + [False] * 2)
    assert both.value == pytest.approx(0.3, abs=2 * both.sigma) and both.sigma < 0.05
    assert one.sigma > 4 * both.sigma


@cases("before", "after", "where", "says")
def test_bad_treatments_are_refused_in_one_line(read, before, after, where, says):
    text, rows = TEXT, CSV
    assert (before in text) != (before in rows), before
    message = refusal(read, text.replace(before, after), rows.replace(before, after))
    assert where in message and says in message, message


def test_what_was_switched_is_written_and_read_again(read, tmp_path):
    """A mended campaign has the effects in its scene, and its columns still switch them."""
    campaign = read()
    written = measurements_text(campaign.measurements)
    (tmp_path / "rows.csv").write_text(written)
    assert read(rows=written).measurements.readings == campaign.measurements.readings
    target = tmp_path / "mended.toml"
    # the size of the other face is tied to it
    scene = mended_scene(campaign, (), {"ground_side_alpha": 0.4})
    (tmp_path / "mended.xml").write_text(scene_text(scene))
    starts = {"ground_side_alpha": 0.4}
    target.write_text(campaign_with_effects(campaign, target, target.with_suffix(".xml"), starts))
    again = read_campaign(target)
    assert (again.treatments, again.ties) == (campaign.treatments, campaign.ties)
    assert again.scene.parameters["ground_top_alpha"] == 0.4
    assert again.measurements.readings[0].parameters["ground_top_alpha"] == 0.0
