"""Responses of readings to effects, against simulations with the effect in the scene.

Comparisons of independent simulations: z < 4.5 fails a right code in fewer than one run in 1000
(some forty comparisons of a fixed seed).
"""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from places import SCENES, cases_of, tables_of
from validate.benches import home

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.eta_grid import BATCHES, EtaGrid, difference
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.efficiency.proposals import Beyond, coverage_of
from mcrim_mitsuba.efficiency.response_maker import EFFECT_PHOTONS, PLAIN_FACTOR, ResponseMaker
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.inference.repair import mended_files, repair
from mcrim_mitsuba.inference.simulations import CampaignSimulations, calibrate
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.spectrophotometer import spectrophotometer_of
from mcrim_mitsuba.transport.launch_plan import LANES
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

SCENE = SCENES / "camoo4.xml"
READINGS = """label,signal,sigma,n_gap,aperture_radius_mm
air,10.0,0.1,1.0,14
gel,17.0,0.1,1.46,14
masked gel,14.0,0.1,1.46,7
"""
KNOWN = {"alpha_scat_per_cm": 0.5, "alpha_abs_per_cm": 0.039}
#: Between nodes, and where the catalogue's prediction is not a weight near the end of its range.
SIZES = tables_of(__file__)["sizes"]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "readings.csv").write_text(READINGS)
    (folder / "campaign.toml").write_text(
        f'scene = "{SCENE}"\nmeasurements = "readings.csv"\n'
        "[parameters.alpha_scat_per_cm]\nstart = 0.5\n"
        "[parameters.alpha_abs_per_cm]\nstart = 0.039\nprior = 0.039\nprior_sigma = 0.012\n"
        "[tolerances]\nnone = true\n"
    )
    return read_campaign(folder / "campaign.toml")


@pytest.fixture(scope="module")
def made(campaign):
    """A maker, and what it made of all effects at once."""
    maker = ResponseMaker(campaign, Run(8 * LANES, seed=3, check=False))
    return maker, maker.make([campaign.catalogue[name] for name in SIZES])


def point(model, *values):
    """Values in the order of a model's parameters, by their names; later ones win."""
    known = {name: value for some in values for name, value in some.items()}
    return np.array([known[parameter.name] for parameter in model.free])


def directly(campaign, sizes, row, seed, photons=200_000):
    """Eta and its error of a reading's configuration with effects in the scene."""
    scene, values = campaign.scene, {}
    for name, size in sizes.items():
        scene = scene.edited(add(campaign.catalogue[name], scene, size))
        values |= size
    reading = campaign.measurements.readings[row].parameters
    own = {**KNOWN, **reading, **values}
    found = Simulation(scene.with_overrides(own), check=False).collect(photons, seed=seed)
    return found.eta, found.eta_sigma


def predicted(campaign, responses, sizes, anchor=None):
    """(readings,) eta and its error from the responses."""
    mended = campaign.with_effects(list(sizes))
    effects = [campaign.catalogue[name] for name in sizes]
    model = ResponseModel(mended, responses, effects, anchor)
    found = model.predict(point(model, KNOWN, {"scale": 40.0}, *sizes.values()), check=True)
    return np.stack([found.eta, np.hypot(found.eta_sigma, found.interpolation_error)], axis=1)


@pytest.mark.parametrize("name", SIZES)
def test_prediction_of_an_effect_is_what_its_scene_gives(campaign, made, name):
    ours = predicted(campaign, made[1], {name: SIZES[name]})
    for row, (eta, sigma) in enumerate(ours):
        expected, expected_sigma = directly(campaign, {name: SIZES[name]}, row, seed=11)
        assert abs(eta - expected) < 4.5 * math.hypot(sigma, expected_sigma), (row, eta, expected)


def test_contact_with_a_wrapping_is_predicted_between_its_nodes(campaign):
    """And its mirror part, and its bare foot; on a bar of LYSO whose foot is dry or greased."""
    scene = home("wrap_contact").with_overrides(
        {"n_crystal": 1.82, "crystal_width_mm": 3.0, "crystal_height_mm": 15.0}
    )
    wrapped = replace(campaign, scene=scene)
    maker = ResponseMaker(wrapped, Run(4 * LANES, seed=3, check=False))
    names = ("wrap_contact", "wrap_specular", "wrap_missing")
    responses = maker.make([wrapped.catalogue[name] for name in names])
    sizes = (
        (names[0], 0.01),
        (names[0], 0.15),
        (names[1], 0.5),
        (names[2], 0.02),
        (names[2], 0.16),
    )
    for name, value in sizes:
        size = {name: {name: value}}
        for row, (eta, sigma) in enumerate(predicted(wrapped, responses, size)[:2]):
            # its error is below the prediction's
            expected, expected_sigma = directly(wrapped, size, row, seed=13, photons=2**17)
            assert abs(eta - expected) < 4.5 * math.hypot(sigma, expected_sigma), (name, row)
            assert sigma < 0.015 * eta


WHITE = """<shape type="rectangle" id="plate">
  <transform name="to_world"><scale value="14"/><translate z="12"/></transform>
  <bsdf type="twosided">
    <bsdf type="diffuse"><spectrum name="reflectance" value="0.95"/></bsdf>
  </bsdf>
</shape>
<sensor """


SPECULAR = ('photodetector"/', 'photodetector"><float name="specular" value="0.3"/></bsdf')


@pytest.mark.parametrize(
    ("name", "bench", "edit"),
    [
        ("detector_reflection", "camoo4", SPECULAR),
        ("top_reflector", "camoo4", ("<sensor ", WHITE)),
        ("source_depth", "camoo4_pyramid", ("pyramid_height_mm", "crystal_height_mm")),
        ("aperture_at_detector", "bgo_esr", ("<!-- ", "<!-- ")),
    ],
)
def test_weights_are_left_where_they_do_not_hold(campaign, name, bench, edit):
    """They took all that detectors or reflectors send back for the effect's, and all for a box."""
    scene = read_scene(SCENES / f"{bench}.xml")
    other = replace(campaign, scene=scene.edited(scene.path.read_text().replace(*edit)))
    effect = other.catalogue[name]
    assert not effect.weighs_in(other.scene) and effect.weighs_in(campaign.scene)
    responses = ResponseMaker(other, Run(2 * LANES, seed=3, check=False)).make([effect])
    size = {name: SIZES[name]}
    for row, (eta, sigma) in enumerate(predicted(other, responses, size)):
        expected, expected_sigma = directly(other, size, row, seed=13)
        assert abs(eta - expected) < 4.5 * math.hypot(sigma, expected_sigma), (row, eta, expected)


def test_births_are_weighted_in_boxes_and_upright_solids_alone(campaign):
    def weighed(scene):
        names = ("source_depth", "side_source")
        return [campaign.catalogue[name].weighs_in(scene) for name in names]

    assert (
        weighed(campaign.scene) == weighed(read_scene(SCENES / "lyso_teflon.xml")) == [True, True]
    )
    hexagon = read_scene(SCENES / "camoo4_hexagonal.xml")
    text = hexagon.path.read_text().replace("crystal_across_flats_mm", "crystal_width_mm")
    assert weighed(hexagon.edited(text)) == [True, False]
    bevelled = campaign.scene.edited(add("edge_chamfer", campaign.scene))
    assert weighed(bevelled) == [False, False]
    column = '<emitter type="scintillation"><float name="source_across_mm" value="4"/>'
    text = SCENE.read_text().replace('<emitter type="scintillation">', column)
    with pytest.raises(InputError, match="source_across_mm says where light is born"):
        add("side_source", campaign.scene.edited(text))


def test_interpolation_says_how_wrong_it_may_be(campaign, made):
    """Of every effect the error given is below 0.6 %, half a reading's sigma or so."""
    for name, size in SIZES.items():
        mended = campaign.with_effects([name])
        model = ResponseModel(mended, made[1], [campaign.catalogue[name]])
        found = model.predict(point(model, KNOWN, {"scale": 40.0}, size), check=True)
        worst = (found.interpolation_error / found.eta).max()
        assert worst < 0.006, (name, worst)


def test_effects_together_are_simulated_together(campaign, made):
    """Where two strong effects do not add up, the anchor puts it right."""
    sizes = {"top_reflector": {"top_reflectance": 0.9}, "gap_bubble": {"bubble_fraction": 0.5}}
    values = {**KNOWN, "top_reflectance": 0.9, "bubble_fraction": 0.5}
    maker, responses = made
    assert not maker.is_exact([campaign.catalogue[name] for name in sizes])
    assert maker.is_exact([campaign.catalogue["surface_absorption"]])
    mended = campaign.with_effects(list(sizes))
    own = ResponseMaker(mended, Run(8 * LANES, seed=3, check=False))
    anchor = own.anchor([campaign.catalogue[name] for name in sizes], values)
    summed, anchored = (predicted(campaign, responses, sizes, a) for a in (None, anchor))
    for row in range(3):
        expected, expected_sigma = directly(campaign, sizes, row, seed=12)
        eta, sigma = anchored[row]
        assert abs(eta - expected) < 4.5 * math.hypot(sigma, expected_sigma)
    # and the sum alone is not it: the test would notice an anchor that does nothing
    gel = directly(campaign, sizes, 1, seed=12)[0]
    assert abs(summed[1, 0] - gel) > 0.01 * gel


def test_two_effects_that_do_not_add_up_are_predicted(campaign):
    """Of a masked reading their sum is 6 % off."""
    sizes = {"mask_offset": {"mask_offset_mm": 2.0}, "side_source": {"side_depth_mm": 1.5}}
    maker, pair = ResponseMaker(campaign, Run(8 * LANES, seed=3, check=False)), " + ".join(sizes)
    responses = maker.make([campaign.catalogue[name] for name in sizes], pairs=[pair])
    eta, sigma = directly(campaign, sizes, 2, seed=4)
    known, error = predicted(campaign, responses, sizes)[2]
    assert abs(known - eta) < 4.5 * math.hypot(error, sigma)
    singles = {name: responses.effects[name] for name in sizes}
    added, _ = predicted(campaign, replace(responses, effects=singles), sizes)[2]
    assert abs(added - eta) > max(0.04 * eta, 4.5 * math.hypot(error, sigma))


def test_the_bench_as_it_is_is_that_of_the_solver(campaign, made):
    """Between the nodes, within the error of its photons, of which there are nine times as many."""
    for row, (eta, sigma) in enumerate(predicted(campaign, made[1], {})):
        parameters = campaign.measurements.readings[row].parameters
        solved = solve_box(Bench(**parameters, alpha_scat_per_cm=0.5, alpha_abs_per_cm=0.039)).eta
        assert abs(eta - solved) < 4.5 * sigma < 0.02 * eta, (row, eta, solved)
    photons = ResponseMaker(campaign, Run(LANES, check=False)).make([]).photons
    assert photons == 2 * PLAIN_FACTOR * LANES  # both masks are cut out of one simulation


def test_readings_get_the_photons_that_their_errors_ask_for():
    """Two errors of 32 batches, each known to 13 %, and powers of two: three sigma are 1.6."""
    wrapped = read_campaign(SCENES / "lyso_bar.toml")
    made = ResponseMaker(wrapped, Run(check=False), sigma=0.01).make([], tolerances=False)
    readings = wrapped.measurements.readings
    assert made.photons < 0.25 * len(readings) * PLAIN_FACTOR * EFFECT_PHOTONS
    i, j = (count // 2 for count in made.grid.counts)
    for row, reading in enumerate(readings):
        error = made.deviations[:, row, i, j].std(ddof=1) / math.sqrt(BATCHES / PLAIN_FACTOR)
        assert error < 0.7 * 1.6 * reading.sigma / reading.signal, reading.label
    half = ResponseMaker(wrapped, Run(check=False), part=0.5, sigma=0.01).make([], tolerances=False)
    assert half.photons < made.photons


def test_all_photons_fly_near_the_sizes_that_matter(campaign):
    """At nodes between these and next to them; elsewhere, at every node, as in a first look."""
    bench, effect = CampaignSimulations(campaign, Run(8 * LANES, check=False)), "side_roughness"
    (look,) = bench.simulate([effect], look=[effect]).responses.effects.values()
    models = bench.simulate([effect], near={effect: (0.07, 0.09)})
    (near,) = models.responses.effects.values()
    (whole,) = bench.simulate([effect]).responses.effects.values()
    assert bench.models.precise == {effect} and models.precise == set()
    sizes = np.array(near.axes[0].values)
    assert near.axes[0].values == whole.axes[0].values == (0.0, 0.012, 0.035, 0.08, 0.16, 0.3, 0.5)
    same = (near.log_ratio == whole.log_ratio).all(axis=(1, 2, 3))
    np.testing.assert_array_equal(same, (sizes == 0.0) | (0.03 < sizes) & (sizes < 0.2))
    assert (near.log_ratio[-1] == look.log_ratio[-1]).all()
    for size, at in ((0.06, False), (0.07, True), (0.09, True), (0.1, False)):
        assert models.is_precise(effect, {"side_roughness_alpha": size}) == at
        assert bench.models.is_precise(effect, {"side_roughness_alpha": size})


def test_the_article_s_readings_get_all_photons():
    article = read_campaign(SCENES / "camoo4_table1.toml")
    made = ResponseMaker(article, Run(check=False), sigma=0.01).make([], tolerances=False)
    assert made.photons == 2 * PLAIN_FACTOR * EFFECT_PHOTONS  # all masks are cut out of two


def test_proposals_end_where_the_campaign_does():
    ends = coverage_of(read_campaign(SCENES / "lyso_bar.toml"), Beyond(low=True, high=True)).fine
    assert ends.alpha_scat_range_per_cm == (0.0005, 1.0)


def test_what_plain_photons_are_off_by_is_taken_away():
    """A hundred simulations whose error is mostly that of the plain bench, and others'."""
    rng, shape, true = np.random.default_rng(5), (BATCHES, 2, 2), 0.3
    known = EtaGrid(np.full(shape[1:], -1.0), np.zeros(shape))
    found = {0.9: [], 0.0: []}
    for like, each in found.items():
        for _ in range(100):
            plain = 0.02 * rng.standard_normal(shape)
            other = like * plain + 0.004 * rng.standard_normal(shape)
            tables = (
                EtaGrid(level + batches.mean(axis=0), batches - batches.mean(axis=0))
                for level, batches in ((-1.0 + true, other), (-1.0, plain))
            )
            made = difference(*tables, known)
            each.append((made.log_eta[0, 0], made.deviations[:, 0, 0].std(ddof=1)))
        value, spread = np.array(each).T
        error = spread / math.sqrt(BATCHES)
        # unbiased, its error right and that of what differs alone; limits at 1e-4 two-sided
        assert abs((value - true).mean()) < 3.9 * 0.004 / math.sqrt(BATCHES * 100)
        assert 0.7 < value.std(ddof=1) / error.mean() < 1.35
        assert error.mean() < 1.2 * 0.004 / math.sqrt(BATCHES)


def test_sizes_that_the_readings_leave_open_get_what_is_plausible(tmp_path):
    """Three readings and one prior for four parameters: once nothing was written."""
    three = replace(read_campaign(SCENES / "camoo4_three.toml"), tolerances=())
    bench = CampaignSimulations(three, Run(LANES, check=False))
    bench.simulate(("top_roughness",))
    fit = bench.settled_fit(("top_roughness",))
    # 95 % of what is plausible, up to 0.05
    assert fit.model.campaign.priors["top_roughness_alpha"] == (
        0.0,
        pytest.approx(0.05 / 1.96, rel=1e-4),
    )
    assert fit.ndf == 1 and fit.chi2 < 3.0
    assert any("top_roughness_alpha 0 ± 0.0255" in note for note in fit.notes)
    scene, text = mended_files(three, fit, tmp_path / "mended.toml")
    written = tomllib.loads(text)["parameters"]["top_roughness_alpha"]
    assert (written["prior"], written["prior_sigma"]) == (0.0, 0.0255122)
    assert scene.parameters["top_roughness_alpha"] == written["start"]


def test_a_beam_that_an_effect_darkens_is_faint():
    """No photon arrives behind ground faces: the diagnosis of all effects was refused for it."""
    three = replace(read_campaign(SCENES / "camoo4_three.toml"), tolerances=())
    models = CampaignSimulations(three, Run(LANES, seed=1, check=False)).simulate(["ground"])
    model = models.model(["ground"])
    values = {"alpha_scat_per_cm": 0.05, "alpha_abs_per_cm": 0.01, "scale": 48.0}
    signals = model.predict(point(model, values, {"ground_alpha": 0.6})).signal
    assert 0.0 < signals[2] < 1e-2 and signals[0] > 5.0


def test_a_fibre_that_an_effect_darkens_is_faint(tmp_path, scenes):
    """None comes to its far end through rough faces: a diagnosis was refused for it, too."""
    head = (
        f'title = "x"\nunit = "pe"\nscene = "{scenes / "luag_fibre.xml"}"\nmeasurements = "f.csv"'
    )
    (tmp_path / "f.toml").write_text(f"{head}\n[parameters.alpha_scat_per_cm]\nstart = 0.02\n")
    rows = ["label,signal,sigma,n_gap,detector", "one,3,0.1,1,left", "other,2,0.1,1,right"]
    (tmp_path / "f.csv").write_text("\n".join(rows))
    fibre = replace(read_campaign(tmp_path / "f.toml"), tolerances=())
    effect = fibre.catalogue["surface_roughness"]
    ratio = ResponseMaker(fibre, Run(LANES, seed=3, check=False)).make([effect])
    rough = ratio.effects["surface_roughness"].log_ratio
    assert np.isfinite(rough).all() and rough[-1].max() < -2.0


def test_an_effect_that_a_switch_of_the_scene_is_acts(campaign):
    """The configuration's own value of the switch once won: the light stayed unpolarised."""
    effect = campaign.catalogue["polarization"]
    maker = ResponseMaker(campaign, Run(LANES, check=False))
    (response,) = maker.make([effect]).effects.values()
    assert (abs(response.log_ratio) > 0).all()
    without, with_it = (maker.anchor(effects, KNOWN).log_eta for effects in ([], [effect]))
    assert (without != with_it).all()


@pytest.mark.parametrize(
    "name, low, high", [("n_crystal", 1.8, 2.2), ("n_crystal", 1.91, 2.11), ("gap_mm", 0.02, 0.2)]
)
def test_nodes_of_a_fitted_number_of_the_scene_stay_in_its_range(campaign, name, low, high):
    """Of these ranges rounding takes the first or the last one beyond: every verb broke off."""
    path = campaign.path.with_name("number.toml")
    number = f"[parameters.{name}]\nmin = {low}\nmax = {high}\n"
    path.write_text(campaign.path.read_text() + number)
    responses = ResponseMaker(read_campaign(path), Run(LANES, check=False)).make([])
    (axis,) = responses.effects[name].axes
    nodes = [axis.nominal + value for value in axis.values]
    assert (min(nodes), max(nodes)) == (low, high)


def test_an_effect_of_filled_gaps_is_in_no_empty_one(campaign):
    """What an edit does in air does not count: alone it was left out, beside others it was not."""

    def edit(editor):
        editor.insert_last(
            editor.gap, '<float name="alpha_abs_per_cm" value="$gap_absorption_per_cm"/>'
        )

    effect = replace(campaign.catalogue["gap_absorption"], edit=edit, weight=None, columns=())
    maker = ResponseMaker(campaign, Run(LANES, check=False))
    values = {**KNOWN, "gap_absorption_per_cm": 9.0}
    without, with_it = (maker.anchor(effects, values).log_eta for effects in ([], [effect]))
    assert with_it[0] == without[0]
    assert (with_it[1:] < without[1:] - 0.01).all()


def test_few_photons_are_not_the_usual_number(campaign):
    """A share that rounds to none is the least that records can have."""
    reflected = campaign.with_effects(["top_reflector"])
    runs = (Run(2, check=False), Run(LANES, check=False), Run(precision=0.5, check=False))
    benches = [CampaignSimulations(reflected, run) for run in runs]
    for bench in benches:
        calibrate(bench)
    least, *others = (bench.provenance().photons for bench in benches)
    assert others == [least, least]


def test_slopes_of_the_model_are_those_of_its_values(campaign, made):
    sizes = {
        "gap_index": {"gap_index_offset": 0.045},
        "nonlinearity": {"nonlinearity": 0.01},
        "source_depth": {"source_depth_mm": 3.0},
        "background": {"background": 0.3},
        "gain_drift": {"gain_drift": -0.04},
        "sample_scale": {"sample_scale": 0.07},
    }
    rows = [
        replace(
            reading,
            label=f"{reading.label} of a thin piece",
            line=9 + i,
            parameters={**reading.parameters, "crystal_height_mm": 5.0},
        )
        for i, reading in enumerate(campaign.measurements.readings)
    ]
    measured = replace(
        campaign.measurements,
        readings=(*campaign.measurements.readings, *rows),
        columns=(*campaign.measurements.columns, "crystal_height_mm"),
    )
    campaign = replace(campaign, measurements=measured)
    mended = campaign.with_effects(list(sizes))
    effects = [campaign.catalogue[name] for name in sizes]
    maker = ResponseMaker(campaign, Run(LANES, seed=3, check=False))
    model = ResponseModel(mended, maker.make(effects), effects)
    values = {"alpha_scat_per_cm": 0.6, "alpha_abs_per_cm": 0.03, "scale": 40.0}
    theta = point(model, values, *sizes.values())
    slopes = model.predict(theta).signal_slopes
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-5 * theta[i]
        by_difference = (
            model.predict(theta + step).signal - model.predict(theta - step).signal
        ) / (2 * step[i])
        assert slopes[:, i] == pytest.approx(by_difference, rel=1e-4, abs=1e-6), model.free[i].name
    assert model.predict_many(theta[None])[0] == pytest.approx(model.predict(theta).signal)
    # drift and yield change nothing but what they are said to
    names = [p.name for p in model.free]
    assert np.all((slopes[:, names.index("sample_scale")] == 0.0) == [True] * 3 + [False] * 3)
    drift = slopes[:, names.index("gain_drift")]
    assert drift[0] < drift[1] < drift[2] < 0.0 < drift[3] < drift[5]


def test_rows_know_when_they_were_read_and_of_which_crystal(campaign, tmp_path):
    """Rows that are not used count, transmittances do not, and what is proposed comes last."""
    table = (
        "label,kind,signal,sigma,n_gap,crystal_height_mm,use\n"
        "air,light,10,0.1,1,10,1\nbeam,transmittance,0.7,0.01,1,10,1\n"
        "thin,light,11,0.1,1,5,0\ngel,light,17,0.1,1.46,10.0,1\n"
    )
    (tmp_path / "rows.csv").write_text(table)
    text = campaign.path.read_text().replace("readings.csv", "rows.csv")
    (tmp_path / "rows.toml").write_text(text)
    own = read_campaign(tmp_path / "rows.toml").with_effects(["gain_drift", "sample_scale"])
    proposed = replace(own.measurements.readings[2], label="next", line=0)
    readings = (*own.measurements.readings, proposed)
    own = replace(own, measurements=replace(own.measurements, readings=readings))
    maker = ResponseMaker(own, Run(LANES, seed=3, check=False))
    model = ResponseModel(own, maker.make(own.switched_on), own.switched_on)
    values = {"alpha_scat_per_cm": 0.6, "alpha_abs_per_cm": 0.03, "scale": 40.0}
    plain, both = (
        model.predict(point(model, values, {"gain_drift": drift, "sample_scale": more})).signal
        for drift, more in ((0.0, 0.0), (0.1, 0.2))
    )
    assert both / plain == pytest.approx([0.95, 1.0, 1.2, 1.05, 1.2 * 1.05])
    # where no row in use is of another crystal there is nothing to try
    tried = CampaignSimulations(read_campaign(tmp_path / "rows.toml"), Run(LANES)).possible()
    assert "gain_drift" in tried and "sample_scale" not in tried


def test_a_mended_campaign_says_the_same_by_every_command(campaign, tmp_path, monkeypatch):
    """Readings with surface losses: repair finds them, calibrate repeats its numbers, and the
    scene that was written gives the predictions."""
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "cache"))
    truth = {"surface_absorption": {"surface_loss": 0.03}}
    rows = ["label,signal,sigma,n_gap,aperture_radius_mm,crystal_height_mm"]
    configurations = [
        (n, radius, height) for n in (1.0, 1.46) for radius in (14, 7) for height in (10, 3)
    ]
    for number, (n, radius, height) in enumerate(configurations):
        scene = campaign.scene.edited(
            add(
                campaign.catalogue["surface_absorption"],
                campaign.scene,
                truth["surface_absorption"],
            )
        )
        own = {"n_gap": n, "aperture_radius_mm": radius, "crystal_height_mm": height}
        found = Simulation(scene.with_overrides(own), check=False).collect(250_000, seed=number)
        signal = 40.0 * found.eta
        rows.append(f"reading {number},{signal:.5g},{0.005 * signal:.3g},{n},{radius},{height}")
    (tmp_path / "readings.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "own.toml").write_text(
        campaign.path.read_text()
        + "[light_yield]\nenergy_keV = 59.5\ndetector_efficiency = 0.127\n"
        + "[next_measurements]\nn_gap = [1.333]\n"
    )
    own = read_campaign(tmp_path / "own.toml")
    tried = ("surface_absorption", "gap_bubble", "detector_angle", "source_depth")
    own = replace(own, catalogue={name: own.catalogue[name] for name in tried})
    mended = repair(own, tmp_path / "new.toml", run=Run(4 * LANES, seed=1))
    assert "surface_absorption" in mended.effects
    assert mended.diagnosis.baseline.p_value < 1e-3 < mended.fit.p_value
    written = read_campaign(tmp_path / "new.toml")
    again = calibrate(CampaignSimulations(written, Run(4 * LANES, seed=1)))
    for name, known in mended.fit.parameters.items():
        other = again.parameters[name]
        assert abs(known.value - other.value) < 0.5 * known.sigma, name
    # what was added is one of what may be missing: no verb forgets it
    averaged = mended.diagnosis.light_yield_averaged
    assert "was added by repair" in again.notes[0] and str(averaged) in again.notes[1]
    scene = read_campaign(tmp_path / "new.toml").scene
    for row, (n, radius, height) in zip(mended.fit.rows, configurations, strict=True):
        own = {"n_gap": n, "aperture_radius_mm": radius, "crystal_height_mm": height}
        found = Simulation(scene.with_overrides(own), check=False).collect(100_000, seed=99)
        assert abs(found.eta - row.eta) < 4.5 * math.hypot(found.eta_sigma, row.eta_sigma)


# ---- a beam through the crystal ----

_AT = {"alpha_scat_per_cm": 0.3, "alpha_abs_per_cm": 0.02, "scale": 1.0}


@pytest.fixture(scope="module")
def with_beam(tmp_path_factory):
    """A campaign with a transmittance, whose acceptance is fitted."""
    folder = tmp_path_factory.mktemp("beam")
    (folder / "readings.csv").write_text(
        "label,kind,signal,sigma,n_gap\nair,light,14.3,0.2,1\ngel,light,24.5,0.4,1.46\n"
        "t,transmittance,0.76,0.012,\n"
    )
    (folder / "campaign.toml").write_text(
        f'scene = "{SCENE}"\nmeasurements = "readings.csv"\n'
        "[parameters.alpha_scat_per_cm]\nmin = 0.002\nmax = 5\n"
        "[parameters.alpha_abs_per_cm]\nprior = 0.02\nprior_sigma = 0.01\n"
        "[tolerances]\nnone = true\n"
    )
    return read_campaign(folder / "campaign.toml")


@pytest.fixture(scope="module", params=["fitted", "forward_beam"])
def of_acceptance(request, with_beam, tmp_path_factory):
    """Models with more effects, where the acceptance is a fitted parameter, or an effect."""
    campaign, own = with_beam, ["forward_beam"]
    if request.param == "fitted":
        folder = with_beam.path.parent
        text = with_beam.path.read_text() + "[parameters.acceptance_deg]\nmin = 1\nmax = 30\n"
        (folder / "fitted.toml").write_text(text)
        campaign, own = read_campaign(folder / "fitted.toml"), []
    known = campaign.catalogue
    effects = [known[name] for name in (*own, "surface_roughness", "crystal_index")]
    made = ResponseMaker(campaign, Run(2 * LANES, check=False)).make(effects)

    def model(*names):
        more = campaign.with_effects([*own, *names])
        return ResponseModel(more, made, more.switched_on)

    return model


@cases("effect", "size")
@pytest.mark.parametrize("angle", [1.3, 4.0, 12.0])
def test_a_fitted_acceptance_acts_as_in_the_scene(with_beam, of_acceptance, effect, size, angle):
    model = of_acceptance(*[effect] if effect else [])
    values = {**_AT, **size, "acceptance_deg": angle}
    theta = point(model, values)
    found = model.predict(theta, check=True)
    scene = (
        with_beam.scene
        if not effect
        else with_beam.scene.edited(add(effect, with_beam.scene, size))
    )
    values.pop("scale")
    beam = spectrophotometer_of(scene).with_overrides(values)
    directly = Simulation(beam, check=False).collect(2 * LANES, seed=5)
    error = math.hypot(found.eta_sigma[2], directly.eta_sigma, found.interpolation_error[2])
    assert abs(found.eta[2] - directly.eta) < 4.5 * error < 0.03
    # the bench does not know it, and the scale acts on light only
    place = [p.name for p in model.free].index("acceptance_deg")
    assert found.signal_slopes[:2, place] == pytest.approx(0.0, abs=1e-12)
    assert found.signal_slopes[2, [p.name for p in model.free].index("scale")] == 0.0
    step = np.zeros(len(theta))
    step[place] = 0.01
    upper, lower = (model.predict(theta + sign * step).signal[2] for sign in (1, -1))
    assert found.signal_slopes[2, place] == pytest.approx(
        (upper - lower) / 0.02, rel=1e-3, abs=1e-6
    )
    many = model.predict_many(np.stack([theta, theta + step]))
    assert many[0] == pytest.approx(found.signal, rel=1e-9)


@pytest.mark.parametrize("how", ["fitted", "forward_beam"])
def test_a_proposed_beam_has_the_instrument_s_acceptance_unless_it_says_another(with_beam, how):
    """One that says the instrument's own had no acceptance at all: a diagnosis broke off."""
    campaign, effects = with_beam, ("forward_beam",)
    if how == "fitted":
        path = with_beam.path.with_name("proposed.toml")
        path.write_text(
            with_beam.path.read_text() + "[parameters.acceptance_deg]\nmin = 1\nmax = 30\n"
        )
        campaign, effects = read_campaign(path), ()
    beams = [
        {"kind": "transmittance", "acceptance_deg": angle, "beam_axis": "z"}
        for angle in (5.0, 30.0)
    ]
    run = Run(16 * LANES, check=False)
    model = CampaignSimulations(campaign, run).predict_at(beams)(effects)
    ends = [{**_AT, "acceptance_deg": angle} for angle in (2.0, 25.0)]
    narrow, wide = (model.predict(point(model, at)).eta for at in ends)
    assert wide[0] > narrow[0] and wide[1] == narrow[1]
