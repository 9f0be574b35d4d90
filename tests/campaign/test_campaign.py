"""Measurement and campaign files: what is read from them, and how bad ones are refused."""

import math
import pickle
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured import read_measurements
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.campaign.campaign import LightYieldInput, read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects
from mcrim_mitsuba.campaign.entries import json_schema
from mcrim_mitsuba.campaign.parameter import CampaignParameter
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.effects.trust import UntrustedEffectsError, fingerprint, trust
from mcrim_mitsuba.inference.fit import UndeterminedError
from mcrim_mitsuba.optics.materials import material

cases = cases_of(__file__)

SCENE = Path(__file__).with_name("bench.xml").read_text()
CSV = """# CaMoO4, 59.5 keV
label,signal,sigma,n_gap
air,14.3,0.2,1.00
gel,24.5,0.4,1.46
"""
CAMPAIGN = Path(__file__).with_name("campaign.toml").read_text()
PARAMETERS = {"n_gap": 1.0, "gap_mm": 0.05, "polarization": False}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "camoo4.xml").write_text(SCENE)
    (tmp_path / "measured.csv").write_text(CSV)
    return tmp_path


def campaign(folder, text):
    path = folder / "campaign.toml"
    path.write_text(text)
    return read_campaign(path)


def readings(tmp_path, text, parameters=PARAMETERS):
    path = tmp_path / "rows.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_measurements(path, parameters)


def test_measurements_of_the_article(tmp_path):
    measured = readings(tmp_path, CSV)
    assert measured.comments == ("CaMoO4, 59.5 keV",)
    assert measured.columns == ("n_gap",)
    air, gel = measured.readings
    assert (gel.label, gel.signal, gel.sigma, gel.line) == ("gel", 24.5, 0.4, 4)
    assert gel.parameters == {"n_gap": 1.46}
    assert (air.use, air.group, air.group_sigma) == (True, None, None)


def test_measurements_as_a_spreadsheet_writes_them(tmp_path):
    text = (
        "\ufefflabel,signal,sigma,use,group,group_sigma,polarization\r\n"
        '"air, dry",14.3,0.2,1,m1,0.02,TRUE\r\n'
        "gel,24.5,0.4,0,,,false\r\n"
        ",,,,,,\r\n"
    )
    measured = readings(tmp_path, text)
    air, gel = measured.readings
    assert (air.label, air.group, air.group_sigma) == ("air, dry", "m1", 0.02)
    assert (air.parameters, gel.group) == ({"polarization": True}, None)
    assert measured.in_use == (air,)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("separator", [";", "\t"])
def test_measurements_as_a_german_spreadsheet_writes_them(tmp_path, encoding, separator):
    text = (
        '# CaMoO4;59,5 keV;;\r\n"# counted; twice";;;\r\nlabel;signal;sigma;n_gap;;\r\n'
        '"Öl; dick";14,3;0,2;1,000;;\r\nGel, dünn;24,5;0,4;1,46;;\r\n;;;;;\r\n'
    ).replace(";", separator)
    measured = readings(tmp_path, text.encode(encoding))
    assert measured.comments == (f"CaMoO4{separator}59,5 keV", f"counted{separator} twice")
    oil, gel = measured.readings
    assert (oil.label, oil.signal, oil.sigma) == (f"Öl{separator} dick", 14.3, 0.2)
    assert (gel.label, gel.parameters, gel.line) == ("Gel, dünn", {"n_gap": 1.46}, 5)


def test_the_line_of_a_spreadsheet_that_names_the_separator(tmp_path):
    (air,) = readings(tmp_path, "sep=;\nlabel;signal;sigma\nair, dry;14,3;0,2\n").readings
    assert (air.label, air.signal, air.line) == ("air, dry", 14.3, 3)


HEADER = "label,signal,sigma\n"
GROUPS = "label,signal,sigma,group,group_sigma\n"


@cases("text", "place", "says", more=[(b"x" * 10_000_001, "", "larger than 10 MB")])
def test_bad_measurements_are_refused_in_one_line(tmp_path, text, place, says):
    refused = refusal(readings, tmp_path, text)
    assert refused.startswith(str(tmp_path / "rows.csv")) and place in refused and says in refused


def test_campaign_of_the_article(folder):
    read = campaign(folder, CAMPAIGN)
    scat, absorption = read.parameters.values()
    assert (scat.start, scat.minimum, scat.maximum, scat.prior) == (0.5, 0.001, 10.0, None)
    # what is left out: the scene's value and the usual range
    assert (absorption.start, absorption.minimum, absorption.maximum) == (0.039, 0.0, 1.0)
    assert (absorption.prior, absorption.prior_sigma) == (0.039, 0.012)
    assert read.light_yield == LightYieldInput(59.5, 0.127, 0.0127)
    assert read.free == ("alpha_scat_per_cm", "alpha_abs_per_cm", "scale")
    assert tuple(read.priors) == ("alpha_abs_per_cm",)
    assert read.ndf == 0
    assert read.scene.parameters["n_gap"] == 1.0
    assert len(read.measurements.in_use) == 2
    assert (read.scale, read.effects, read.effects_folder, read.next_measurements) == (
        None,
        (),
        None,
        {},
    )


def test_fixed_scale_and_lengths(folder):
    text = (
        'scene = "camoo4.xml"\nmeasurements = "measured.csv"\n'
        "parameters.scale = {start = 1, fixed = true}\nparameters.gap_mm = {}\n"
        "[next_measurements]\nn_gap = [1, 1.46, 1.0]\nsigma_relative = 0.007\n"
        "minutes = {n_gap = 20}\n"
    )
    read = campaign(folder, text)
    assert (read.free, read.ndf) == (("gap_mm",), 1)
    assert (read.scale.start, read.scale.maximum) == (1.0, math.inf)
    gap = read.parameters["gap_mm"]
    assert (gap.minimum, gap.maximum) == (pytest.approx(0.005), pytest.approx(0.5))
    assert read.next_measurements == {
        "n_gap": [1.0, 1.46],
        "sigma_relative": 0.007,
        "minutes": {"n_gap": 20.0},
    }
    for minutes, problem in (
        ("20", "minutes is not a table; write minutes = { n_gap = 20 }"),
        ("{n_gpa = 20}", "n_gpa is not a parameter of camoo4.xml; did you mean n_gap"),
        ("{n_gap = -1}", "n_gap = -1 is not a number of minutes"),
    ):
        with pytest.raises(InputError) as refused:
            campaign(folder, text.replace("{n_gap = 20}", minutes))
        assert refused.value.line == 8 and problem in str(refused.value)


PRIORS = """
[parameters.surface_loss]
prior = 0.01
prior_sigma = 0.001
[parameters.scale]
start = 1
fixed = true
"""


def test_effects_bring_their_parameters(folder):
    text = CAMPAIGN.replace("effects = []", 'effects = ["surface_absorption", "polarization"]')
    read = campaign(folder, text + PRIORS)
    assert read.effects == ("surface_absorption", "polarization")
    assert read.free == ("alpha_scat_per_cm", "alpha_abs_per_cm", "surface_loss")
    loss = read.parameters["surface_loss"]
    assert (loss.start, loss.minimum, loss.maximum, loss.prior) == (0.005, 0.0, 0.05, 0.01)
    assert read.ndf == 1

    more = read.with_effects(["background"])
    assert more.free[-1] == "background" and more.ndf == 0
    # no more than the weakest reading is subtracted too much, or too little
    assert more.parameters["background"].maximum == 14.3
    assert read.effects == ("surface_absorption", "polarization")
    for name, says in (
        ("polarization", "named twice"),
        ("no", "there is no effect no"),
        ("crystal_index", "needs n_crystal"),
        ("source_depth", "needs crystal_height_mm"),
    ):
        assert says in refusal(read.with_effects, [name])


@pytest.mark.parametrize("bounds", ["", "min = 0.0\nmax = 1.0\n"])
def test_an_effect_is_held_where_it_is_simulated(folder, bounds):
    """Beyond, its responses are carried on: light yields were off by a third, or eta overflowed."""
    text = CAMPAIGN.replace("effects = []", 'effects = ["surface_absorption"]')
    held = f"{text}\n[parameters.surface_loss]\nfixed = true\n{bounds}start = "
    assert campaign(folder, f"{held}0.05\n").parameters["surface_loss"].start == 0.05
    for beyond in (0.2, -0.1):
        said = refusal(campaign, folder, f"{held}{beyond}\n")
        assert f"start = {beyond} of surface_loss is outside 0..0.05; move start" in said


def test_the_old_name_of_an_effect_is_read(folder):
    """In all forms of TOML; what goes on from such a campaign says the new one, once."""
    (folder / "measured.csv").write_text(CSV + "oil,26,0.4,1.52\n")
    on = CAMPAIGN.replace("effects = []", 'effects = ["saturation"]')
    table = "[parameters.saturation]\nstart = 0.003\nprior = 0.002\nprior_sigma = 0.001\n"
    inline = "[parameters]\nsaturation = {start = 0.003, prior = 0.002, prior_sigma = 0.001}\n"
    old = campaign(folder, on + table)
    assert old.effects == ("nonlinearity",)
    size = CampaignParameter("nonlinearity", 0.003, -0.05, 0.05, prior=0.002, prior_sigma=0.001)
    assert old.parameters["nonlinearity"] == size and "saturation" not in old.parameters
    same = campaign(
        folder,
        on.replace("[parameters.alpha_scat_per_cm]", f"{inline}[parameters.alpha_scat_per_cm]"),
    )
    assert same.parameters["nonlinearity"] == size
    assert campaign(folder, CAMPAIGN).with_effects(["saturation"]).effects == ("nonlinearity",)

    campaign(folder, on + table)
    text = campaign_with_effects(old, folder / "on.toml", old.scene.path, {"nonlinearity": 0.001})
    assert "saturation" not in text and text.count("[parameters.nonlinearity]") == 1
    again = campaign(folder, text).parameters["nonlinearity"]
    assert again == replace(size, start=0.001)

    for more, says in (
        ("[parameters.saturation]\nstart = 1\n", ", line 16: start = 1 of nonlinearity is outside"),
        (table + "[parameters.nonlinearity]\n", "saturation is not a parameter of camoo4.xml"),
    ):
        with pytest.raises(InputError) as refused:
            campaign(folder, on + more)
        assert says in str(refused.value)


def test_readings_that_are_not_used_limit_no_size(folder):
    """A reading with use = 0, of a hundredth of the others, made all backgrounds impossible."""
    rows = CSV.replace("n_gap\n", "n_gap,use\n").replace("1.00\n", "1.00,1\n")
    rows = rows.replace("1.46\n", "1.46,1\n")
    off = "".join(f"{name},{signal},0.2,1.46,0\n" for name, signal in (("dark", 0.1), ("odd", 900)))
    known = []
    for text in (rows, rows + off):
        (folder / "measured.csv").write_text(text)
        effects = campaign(folder, CAMPAIGN).catalogue
        known.append([effects[name].parameters[0] for name in ("background", "nonlinearity")])
    assert known[0] == known[1]
    background, bend = known[0]
    assert (background.minimum, background.maximum) == (-14.3, 14.3)
    assert background.plausible == pytest.approx((-1.43, 1.43))
    assert bend.plausible == pytest.approx((-0.1 / 24.5, 0.2 / 24.5))


def test_an_index_begins_beside_the_scenes(folder):
    scene = SCENE.replace("<shape", '<default name="n_crystal" value="2.01"/><shape n="$n_crystal"')
    (folder / "camoo4.xml").write_text(scene)
    text = CAMPAIGN.replace("effects = []", 'effects = ["crystal_index"]')
    text += "[parameters.n_crystal]\nmax = 2.02\nprior = 2.01\nprior_sigma = 0.01\n"
    index = campaign(folder, text).parameters["n_crystal"]
    assert (index.start, index.minimum, index.maximum) == (2.02, 1.91, 2.02)


def test_an_effect_that_is_only_in_the_scene_is_held(folder):
    read = campaign(folder, CAMPAIGN)
    assert "scattering_g" not in read.parameters
    text = CAMPAIGN + "[parameters.scattering_g]\nprior = 0\nprior_sigma = 0.1\n"
    known = campaign(folder, text).parameters["scattering_g"]
    # fitted although its effect is not switched on: from the scene's value, within the range
    assert (known.start, known.minimum, known.maximum) == (0.0, -0.5, 0.95)
    (folder / "measured.csv").write_text("label,signal,sigma,scattering_g\na,1,1,0\nb,1,1,0.1\n")
    text = CAMPAIGN.replace("effects = []", 'effects = ["anisotropic_scattering"]')
    with pytest.raises(InputError, match="scattering_g is fitted here and a column"):
        campaign(folder, text)


def test_title_and_unit_are_kept_where_a_campaign_goes_on(folder):
    assert (campaign(folder, CAMPAIGN).title, campaign(folder, CAMPAIGN).unit) == ("campaign", "")
    words = 'title = "CaMoO4,\\n air\\u202e"\nunit = "electrons"\n'
    first = campaign(folder, words + CAMPAIGN)
    assert (first.title, first.unit) == ("CaMoO4, air<U+202E>", "electrons")
    text = campaign_with_effects(first, folder / "mended.toml", first.scene.path, {})
    again = campaign(folder, text)
    assert (again.title, again.unit) == (first.title, first.unit)


def test_effects_of_the_users_own(folder, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder / "settings"))
    (folder / "mine").mkdir()
    (folder / "mine/drift.py").write_text(
        "from mcrim_mitsuba.effects import Effect, EffectParameter\n"
        "size = EffectParameter(name='drift', meaning='Gain', minimum=0.5, maximum=2, start=1.1, "
        "absent=1.0, plausible=(0.9, 1.1), nodes=())\n"
        "EFFECT = Effect('drift', 'Drift', '...', '...', parameters=(size,), "
        "reading=lambda s, g: (g * s, g + 0 * s, s))\n"
    )
    text = CAMPAIGN.replace("effects = []", 'effects = ["drift"]\neffects_folder = "mine"')
    text += "[parameters.scale]\nstart = 1\nfixed = true\n"
    drift = (folder / "mine/drift.py").read_text()
    (folder / "mine/drift.py").write_text("raise SystemExit('executed')\n")
    # nothing is executed that nobody has allowed
    with pytest.raises(UntrustedEffectsError, match=r"toml, line 4: the Python in .*\(drift.py\)"):
        campaign(folder, text)
    (folder / "mine/drift.py").write_text(drift)
    trust(folder / "mine", keep=True)
    assert (
        fingerprint(folder / "mine")
        in (folder / "settings/mcrim_mitsuba/trusted_effects.txt").read_text()
    )
    read = campaign(folder, text)
    assert read.parameters["drift"].start == 1.1
    assert read.effects_folder == folder / "mine"
    said = f"effects of the campaign's own were executed: drift.py in {folder / 'mine'}, SHA-256 "
    assert read.notes == (said + fingerprint(folder / "mine")[:16],)
    # by content: other files ask again
    (folder / "mine/drift.py").write_text("EFFECT = 1\n")
    with pytest.raises(UntrustedEffectsError):
        campaign(folder, text)
    with pytest.raises(InputError, match=r"drift.py, line 1: EFFECT is of type int"):
        read_campaign(folder / "campaign.toml", trust_effects=True)
    assert "drift" not in campaign(folder, CAMPAIGN).catalogue


@cases(
    "old",
    "new",
    "place",
    "says",
    more=[
        ("effects = []", f"effects = [{'1, ' * 100_000}]", "line 3", "not a list of names"),
        ("effects = []", f'effects = ["{"x" * 500_000}"]', "line 3", "there is no effect"),
    ],
)
def test_bad_campaigns_are_refused_in_one_line(folder, old, new, place, says):
    assert old in CAMPAIGN
    refused = refusal(campaign, folder, CAMPAIGN.replace(old, new, 1))
    assert refused.startswith(str(folder / "campaign.toml"))
    assert place in refused and says in refused


def test_whose_convention_a_campaign_has(folder, scenes):
    assert campaign(folder, CAMPAIGN).convention is None
    assert read_campaign(scenes / "camoo4_campaign.toml").convention == "article"
    assert read_campaign(scenes / "camoo4_three.toml").convention is None


def with_yield(scenes, folder, entries="", scene=lambda text: text, energy="59.5"):
    """The article's campaign by this package's conventions, with more in its [light_yield]."""
    for name in ("camoo4_measured.csv", "camoo4.xml"):
        (folder / name).write_text((scenes / name).read_text())
    (folder / "camoo4.xml").write_text(scene((scenes / "camoo4.xml").read_text()))
    text = (scenes / "camoo4_campaign.toml").read_text()
    without = text.replace(CONVENTION_LINE, "").replace("keV = 59.5", f"keV = {energy}")
    assert without != text
    return campaign(folder, without + entries)


def test_an_energy_in_mev_beside_rows_in_kev_is_refused(folder, scenes):
    path, table = with_yield(scenes, folder, energy="1.275").path, folder / "camoo4_measured.csv"
    text = table.read_text().replace("n_gap\n", "n_gap,energy_keV\n")
    table.write_text(re.sub(r"^(air|gel)(.*)", r"\1\2,1275", text, flags=re.MULTILINE))
    assert "1.275 beside 1275: these are hardly" in refusal(read_campaign, path)


def test_an_efficiency_without_error_is_told(folder, scenes):
    noted = "detector_efficiency has no error: the light yield's lacks it"
    path = with_yield(scenes, folder).path
    assert noted not in read_campaign(path).notes
    path.write_text(re.sub("detector_efficiency_sigma.*", "", path.read_text()))
    assert noted in read_campaign(path).notes


CONVENTION_LINE = 'convention = "article"                # its own conventions and physics\n'
INSIDE = 'efficiency_of = "inside the window"\n'


def test_an_efficiency_measured_in_air_contains_the_windows_reflection(folder, scenes):
    """Normal incidence, ((n - 1) / (n + 1))^2: 4.26 % at the scene's 1.52; errors go along."""
    article = read_campaign(scenes / "camoo4_campaign.toml").light_yield
    assert article == LightYieldInput(59.5, 0.127, 0.0127)
    ours = with_yield(scenes, folder).light_yield
    reflected = (0.52 / 2.52) ** 2
    assert ours.per_scale == pytest.approx((1 - reflected) * article.per_scale, rel=1e-12)
    assert ours.detector_efficiency_sigma == pytest.approx(0.1 * ours.detector_efficiency)
    assert with_yield(scenes, folder, INSIDE).light_yield == article
    # the campaign's own index of the window, where it has one
    own = "[parameters.n_window]\nstart = 1.47\nfixed = true\n"
    found = with_yield(scenes, folder, own).light_yield
    assert found.detector.window_reflectance == pytest.approx((0.47 / 2.47) ** 2)


@pytest.mark.parametrize("before", ["", '    <ref name="interior" id="crystal"/>\n'])
def test_a_detector_in_air_or_on_the_crystal_has_no_window(folder, scenes, before):
    def bare(text):
        window = '    <bsdf type="photodetector"/>\n    <ref name="interior" id="window"/>\n'
        assert window in text
        return text.replace(window, '    <bsdf type="photodetector"/>\n' + before)

    found = with_yield(scenes, folder, scene=bare)
    assert found.light_yield == LightYieldInput(59.5, 0.127, 0.0127)
    assert len(found.notes) == 1  # of the collection


def test_an_impossible_index_is_left_to_whoever_checks_the_scene(folder, scenes):
    found = with_yield(scenes, folder, scene=lambda text: text.replace('value="1.52"', 'value="0"'))
    assert found.light_yield.detector.window_reflectance == 0.0


def test_what_a_detector_collects_is_a_factor_with_an_error_of_its_own(folder, scenes):
    entries = INSIDE + "collection_efficiency = 0.9\ncollection_efficiency_sigma = 0.045\n"
    found = with_yield(scenes, folder, entries)
    known = found.light_yield
    assert known.detector_efficiency == pytest.approx(0.9 * 0.127)
    parts = {"detector_efficiency": 0.1, "collection_efficiency": 0.05}
    assert known.efficiency_parts == pytest.approx(
        {origin: part * 0.9 * 0.127 for origin, part in parts.items()}
    )
    assert known.detector_efficiency_sigma == pytest.approx(math.hypot(*parts.values()) * 0.1143)
    # all is said
    assert found.notes == ()


def test_what_fires_besides_photoelectrons_is_a_factor_too(folder, scenes):
    """Vinogradov's mean of a branching process: 10 % crosstalk fires 11.8 % more cells."""
    entries = INSIDE + "crosstalk = 0.1\ncrosstalk_sigma = 0.02\nafterpulsing = 0.03\n"
    found = with_yield(scenes, folder, entries)
    rng, cells = np.random.default_rng(3), 1.03 / (1.0 + math.log(0.9))
    generation = np.ones(200_000, dtype=int)
    fired = generation.sum()
    while generation.any():
        generation = rng.poisson(-math.log(0.9) * generation)
        fired += generation.sum()
    assert 1.03 * fired / 200_000 == pytest.approx(cells, abs=4 * 0.0009)
    known = found.light_yield
    assert known.detector_efficiency == pytest.approx(cells * 0.127)
    # d ln cells / d crosstalk, by a difference
    slope = math.log((1 + math.log(0.9)) / (1 + math.log(0.899))) / 0.001
    parts = {"detector_efficiency": 0.1, "crosstalk": 0.02 * slope}
    assert known.efficiency_parts == pytest.approx(
        {origin: part * cells * 0.127 for origin, part in parts.items()}, rel=0.01
    )
    assert found.notes == ()


def test_notes_say_once_what_the_light_yield_rests_on(folder, scenes):
    article, ours = read_campaign(scenes / "camoo4_campaign.toml"), with_yield(scenes, folder)
    for read, words in ((article, "is too high by that"), (ours, "is lower by that")):
        window, collection = read.notes
        assert "4.26 %" in window and words in window
        assert "collection_efficiency is not given" in collection


def test_too_few_readings_are_counted(folder):
    refused = refusal(
        campaign, folder, CAMPAIGN.replace("prior = 0.039\nprior_sigma = 0.012\n", "")
    )
    assert "3 free parameters " in refused and " but 2 readings in use and 0 priors" in refused
    (folder / "measured.csv").write_text("label,signal,sigma\nair,1,1\n")
    assert "but 1 reading in use and 1 prior;" in refusal(campaign, folder, CAMPAIGN)


def test_a_row_that_the_scene_cannot_take_is_named(folder):
    (folder / "measured.csv").write_text("label,signal,sigma,gap_mm\na,1,1,0.1\nb,1,1,-0.1\n")
    refused = refusal(campaign, folder, CAMPAIGN)
    assert "measured.csv, line 3, column gap_mm: gap_mm = -0.1: " in refused
    (folder / "measured.csv").write_text(CSV.replace("1.46", "146"))
    refused = refusal(campaign, folder, CAMPAIGN)
    assert "measured.csv, line 4, column n_gap: n_gap = 146: " in refused
    assert "camoo4.xml" not in refused


def test_a_scene_is_no_campaign(folder):
    refused = refusal(read_campaign, folder / "camoo4.xml")
    assert "camoo4.xml: this is a scene, not a campaign" in refused


def test_only_files_of_the_same_kind_are_suggested(folder):
    assert "no such file; check the path" in refusal(read_campaign, folder / "camoo4.toml")
    campaign(folder, CAMPAIGN)
    assert "did you mean campaign.toml?" in refusal(read_campaign, folder / "campagne.toml")


def test_a_refusal_comes_whole_from_another_process():
    error = InputError("too long", "shorten it", path="a.csv", line=3, column="label")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.line, again.mend) == (str(error), 3, "shorten it")
    worse = pickle.loads(pickle.dumps(UndeterminedError("too few", "more readings", line=7)))
    assert isinstance(worse, UndeterminedError) and (worse.mend, worse.line) == ("more readings", 7)


def test_schema_for_editors_takes_what_ships_and_refuses_slips():
    jsonschema = pytest.importorskip("jsonschema")
    known = jsonschema.Draft7Validator(json_schema())
    known.check_schema(known.schema)
    shipped = [tomllib.loads(path.read_text()) for path in SCENES.rglob("*.toml")]
    campaigns = [content for content in shipped if "scene" in content]
    assert len(campaigns) > 5 and all(map(known.is_valid, campaigns))
    for old, new in (
        ("effects = []", "effect = []"),
        ("effects = []", "effects = 1"),
        ("start = 0.5", 'start = "0.5"'),
        ("start = 0.5", "begin = 0.5"),
        ("start = 0.5", "transmittance = 0.76"),
        ("energy_keV = 59.5", "energy_keV = 0"),
        ("[light_yield]", "[next_measurements]\nn_gap = 1\n[light_yield]"),
        ("[light_yield]", "[next_measurements]\nminutes = {n_gap = -1}\n[light_yield]"),
    ):
        assert known.is_valid(tomllib.loads(CAMPAIGN))
        assert not known.is_valid(tomllib.loads(CAMPAIGN.replace(old, new))), new


# ---- transmittances ----


@pytest.fixture
def three(tmp_path):
    """The article's three numbers, in a folder of their own."""
    for ending, scene in (("toml", "camoo4_three"), ("csv", "camoo4_three"), ("xml", "camoo4")):
        text = (SCENES / f"{scene}.{ending}").read_text().replace("camoo4_three.csv", "three.csv")
        (tmp_path / f"three.{ending}").write_text(text.replace("camoo4.xml", "three.xml"))
    return tmp_path


@cases("file", "old", "new", "place", "says")
def test_bad_transmittances_are_refused_in_one_line(three, file, old, new, place, says):
    path = three / f"three.{file}"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    refused = refusal(read_campaign, three / "three.toml")
    assert refused.startswith(str(three)) and place in refused and says in refused


def rows(three, header, *cells):
    (three / "three.csv").write_text(
        "\n".join([f"label,kind,signal,sigma,{header}", *cells]) + "\n"
    )
    return read_campaign(three / "three.toml")


def test_each_kind_of_reading_leaves_the_others_cells_empty(three):
    read = rows(
        three,
        "n_gap,acceptance_deg",
        "air,light,14.3,0.2,1,",
        "gel,,24.5,0.4,1.46,",
        "t,transmittance,0.76,0.012,,1",
        "t wide,transmittance,0.77,0.012,1,30",
    )
    assert [reading.of_beam for reading in read.measurements.readings] == [False, False, True, True]
    assert [reading.parameters for reading in read.measurements.readings][2:] == [
        {"acceptance_deg": 1.0},
        {"n_gap": 1.0, "acceptance_deg": 30.0},
    ]
    assert read.beam == {"beam_diameter_mm": 3.0, "beam_axis": "x", "acceptance_deg": 5.0}
    assert read.values["acceptance_deg"] == 5.0 and "acceptance_deg" not in read.scene.parameters


@cases("header", "row", "says")
def test_bad_cells_beside_transmittances_are_refused(three, header, row, says):
    starts = ("air,light,14.3,0.2,", "gel,light,24.5,0.4,", "t,transmittance,0.76,0.012,")
    cells = [start + cell for start, cell in zip(starts, row, strict=True)]
    assert says in refusal(rows, three, header, *cells)


def test_a_transmittance_has_no_histogram(three):
    cells = ["air,light,14.3,0.2,1,", "t,transmittance,,,,three.csv"]
    refused = refusal(rows, three, "n_gap,histogram", *cells)
    assert "line 3, column histogram" in refused and "give its signal and sigma" in refused


def test_the_schema_knows_the_beam(three):
    jsonschema = pytest.importorskip("jsonschema")
    known = jsonschema.Draft7Validator(json_schema())
    text = (three / "three.toml").read_text()
    assert known.is_valid(tomllib.loads(text))
    for old, new in (("deg = 5.0", "deg = 0"), ("deg = 5.0", "deg = 120"), ('"x"', '"w"')):
        assert not known.is_valid(tomllib.loads(text.replace(old, new))), new


def test_a_liquid_without_a_parameter_cannot_be_left_out_of_the_beam(three):
    scene = (three / "three.xml").read_text().replace("$n_gap", "1.46")
    (three / "three.xml").write_text(scene.replace('<default name="n_gap" value="1.00"/>', ""))
    cells = "air,light,14.3,0.2,1", "t,transmittance,0.76,0.012,1"
    refused = refusal(rows, three, "crystal_height_mm", *cells)
    assert "three.xml" in refused and "name the liquid's index as a parameter n_gap" in refused


@cases("entry", "names")
def test_every_value_of_a_column_is_a_part_with_a_tolerance(folder, entry, names):
    (folder / "measured.csv").write_text(CSV + "water,20.0,0.3,1.333\n")
    only = "none = true\n" * (entry != "none = true")
    read = campaign(folder, f"{CAMPAIGN}[tolerances]\n{only}{entry}\n")
    assert sorted(tolerance.number.name for tolerance in read.tolerances) == names
    air = {"n_gap": 1.0, "gap_mm": 0.05}
    assert not any(t.number.is_of(air) for t in read.tolerances if t.number.parameter == "n_gap")
    assert all(t.sigma == 0.01 for t in read.tolerances)


def test_a_number_that_is_not_named_is_as_exact_as_is_usual(folder):
    """By kind; sizes of effects, and what is fitted, have their errors elsewhere."""
    new = '<default name="{}" value="{}"/>'
    more = {
        "n_window": "BK7@540nm",
        "height_mm": "30",
        "crystal_depth_mm": "20",
        "film_mm": "0.02",
        "wrap_reflectance": "0.97",
    }
    more |= {"top_roughness_alpha": "0.1", "surface_loss": "0.01", "chamfer_mm": "0"}
    lines = "".join(f"\n  {new.format(*item)}" for item in more.items())
    (folder / "camoo4.xml").write_text(re.sub(r"(<scene [^>]*>)", rf"\1{lines}", SCENE, count=1))
    for entry, exact in (("", []), ("[tolerances]\nheight_mm = 0\n", ["height_mm"])):
        read = campaign(folder, CAMPAIGN + entry)
        found = {t.number.name: (round(t.sigma, 9), t.given) for t in read.tolerances}
        usual = {
            "n_gap=1.46": 0.005,
            "gap_mm": 0.015,
            "n_window": material("BK7").sigma,
            "height_mm": 0.3,
            # along y: no depth that gammas reach
            "crystal_depth_mm": 0.2,
            "film_mm": 0.006,
            # its reflectance cannot be more than two of these higher
            "wrap_reflectance": 0.01,
        }
        assert found == {n: (sigma, False) for n, sigma in usual.items() if n not in exact}
    far = {t.number.name: t.farthest for t in read.tolerances}
    assert far["n_gap=1.46"] == (-0.1, 0.1) and far["gap_mm"] == (-0.04, 0.15)
    assert far["wrap_reflectance"][1] <= 0.03
