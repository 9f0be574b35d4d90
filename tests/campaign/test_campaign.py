"""Measurement and campaign files: what is read from them, and how bad ones are refused."""

import math
import pickle
import tomllib

import pytest
from measured import read_measurements
from places import SCENES
from refusals import refusal

from mcrim_mitsuba.campaign.campaign import LightYieldInput, read_campaign
from mcrim_mitsuba.campaign.entries import json_schema
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.inference.fit import TooLittleSimulatedError

SCENE = """<scene version="3.0.0">
  <default name="n_gap" value="1.00"/>
  <default name="gap_mm" value="0.05"/>
  <default name="alpha_scat_per_cm" value="0.54"/>
  <default name="alpha_abs_per_cm" value="0.039"/>
  <default name="scattering_g" value="0"/>
  <default name="polarization" value="false"/>
  <default name="tilt" value="0"/>
  <shape a="$n_gap" b="-$gap_mm" c="$alpha_scat_per_cm" d="$alpha_abs_per_cm"
         e="$scattering_g" f="$polarization" g="$tilt"/>
</scene>
"""
CSV = """# CaMoO4, 59.5 keV
label,signal,sigma,n_gap
air,14.3,0.2,1.00
gel,24.5,0.4,1.46
"""
CAMPAIGN = """scene = "camoo4.xml"
measurements = "measured.csv"
effects = []
[parameters.alpha_scat_per_cm]
start = 0.5
min = 0.001
max = 10.0
[parameters.alpha_abs_per_cm]
prior = 0.039
prior_sigma = 0.012
[light_yield]
energy_keV = 59.5
detector_efficiency = 0.127
detector_efficiency_sigma = 0.0127
"""
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


HEADER = "label,signal,sigma\n"
GROUPS = "label,signal,sigma,group,group_sigma\n"


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ("", "", "is empty"),
        ("# only words\n", "", "begin with label,signal,sigma"),
        ("label,signal\n", "line 1", "no column sigma"),
        ("label,signal,sigma,n_gapp\n", "line 1, column n_gapp", "did you mean n_gap?"),
        ("label,signal,sigma,sigma\n", "line 1, column sigma", "keep one"),
        ("label,signal,sigma,\n", "line 1, column 4", "no name"),
        ("label,signal,sigma,group\n", "line 1", "group_sigma"),
        ("label;signal;sigma\nair;14,3;0,2\n", "line 1", "separated by semicolons"),
        (HEADER + "air,14.3\n", "line 2", "2 cells under 3 columns"),
        (HEADER + "air,14,3,0.2\n", "line 2", "point, not a comma"),
        (HEADER + 'air,"14,3",0.2\n', "line 2, column signal", "a decimal point: 14.3"),
        (HEADER + "air,bright,0.2\n", "line 2, column signal", "not a finite number"),
        (HEADER + "air,nan,0.2\n", "line 2, column signal", "not a finite number"),
        (HEADER + "air,1,1e999\n", "line 2, column sigma", "not a finite number"),
        (HEADER + "air,0,0.2\n", "line 2, column signal", "a light signal is above 0"),
        (HEADER + "air,-14.3,0.2\n", "line 2, column signal", "signal = -14.3"),
        (HEADER + "air,,0.2\n", "line 2, column signal", "is empty"),
        (HEADER + "\n# note\nair,1,0\n", "line 4, column sigma", "not above 0"),
        (HEADER + ",1,1\n", "line 2, column label", "no label"),
        (HEADER + 'a"ir,1,1\n"gel,1,1\n', "line 3", "quotation marks"),
        (HEADER + "air,1,1\nair,2,1\n", "line 3, column label", "line 2 already"),
        (HEADER, "", "no reading is in use"),
        ("label,signal,sigma,use\na,1,1,yes\n", "line 2, column use", "neither 0 nor 1"),
        ("label,signal,sigma,n_gap\na,1,1,\n", "line 2, column n_gap", "empty"),
        ("label,signal,sigma,polarization\na,1,1,1\n", "column polarization", "true or false"),
        (GROUPS + "a,1,1,m,0.1\nb,1,1,m,0.2\n", "line 3, column group_sigma", "0.1 on line 2"),
        (GROUPS + "a,1,1,m,\n", "column group_sigma", "empty"),
        (GROUPS + "a,1,1,m,2\n", "column group_sigma", "2 %"),
        (GROUPS + "a,1,1,,0.1\n", "column group", "name the group"),
        (b"label,signal,sigma\nair,1,1\n\xe9,1,1\n", "line 3", "save it as UTF-8"),
        (b"x" * 10_000_001, "", "larger than 10 MB"),
    ],
)
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
    assert read.priors == ("alpha_abs_per_cm",)
    assert read.ndf == 0
    assert read.scene.parameters["n_gap"] == 1.0
    assert len(read.measurements.in_use) == 2
    assert (read.scale, read.effects, read.effects_folder, read.next_measurements) == (
        None, (), None, {},
    )  # fmt: skip


def test_fixed_scale_and_lengths(folder):
    text = (
        'scene = "camoo4.xml"\nmeasurements = "measured.csv"\n'
        "parameters.scale = {start = 1, fixed = true}\nparameters.gap_mm = {}\n"
        "[next_measurements]\nn_gap = [1, 1.46, 1.0]\nsigma_relative = 0.007\n"
    )
    read = campaign(folder, text)
    assert (read.free, read.ndf) == (("gap_mm",), 1)
    assert (read.scale.start, read.scale.maximum) == (1.0, math.inf)
    assert read.parameters["gap_mm"].maximum == pytest.approx(0.5)
    assert read.next_measurements == {"n_gap": [1.0, 1.46], "sigma_relative": 0.007}


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
    assert more.parameters["background"].maximum == math.inf
    assert read.effects == ("surface_absorption", "polarization")
    for name, says in (
        ("polarization", "named twice"),
        ("no", "there is no effect no"),
        ("crystal_index", "needs n_crystal"),
        ("source_depth", "needs crystal_height_mm"),
    ):
        assert says in refusal(read.with_effects, [name])


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


def test_effects_of_the_users_own(folder):
    (folder / "mine").mkdir()
    (folder / "mine/drift.py").write_text(
        "from mcrim_mitsuba.effects import Effect, EffectParameter\n"
        "EFFECT = Effect('drift', 'Drift', '...', '...', (EffectParameter('drift', '', 'Gain', "
        "0.5, 2, 1.1, 1.0, (0.9, 1.1), ()),), reading=lambda s, g: (g * s, g + 0 * s, s))\n"
    )
    text = CAMPAIGN.replace("effects = []", 'effects = ["drift"]\neffects_folder = "mine"')
    text += "[parameters.scale]\nstart = 1\nfixed = true\n"
    read = campaign(folder, text)
    assert read.parameters["drift"].start == 1.1
    assert read.effects_folder == folder / "mine"
    (folder / "mine/drift.py").write_text("EFFECT = 1\n")
    with pytest.raises(InputError, match=r"drift.py, line 1: EFFECT is of type int"):
        campaign(folder, text)
    assert "drift" not in campaign(folder, CAMPAIGN).catalogue


@pytest.mark.parametrize(
    ("old", "new", "place", "says"),
    [
        ("effects = []", "effects = [", "line 4, column 2", "not TOML"),
        ("effects = []", "effect = []", "line 3", "did you mean effects?"),
        ("effects = []", 'effects = ["gap_buble"]', "line 3", "did you mean gap_bubble?"),
        ("effects = []", 'effects = ["background", "background"]', "line 3", "twice"),
        ("effects = []", "effects = [1]", "line 3", "not a list of names"),
        ("effects = []", 'effects = ["rayleigh_scattering", "anisotropic_scattering"]', "line 3",
         "rayleigh_scattering and anisotropic_scattering exclude each other"),
        ("effects = []", 'effects = ["crystal_index"]', "line 3", "crystal_index needs n_crystal"),
        ("effects = []", 'effects = ["source_depth"]', "line 3",
         "source_depth needs crystal_height_mm"),
        ("effects = []", "parameters.loss = {}", "line 3", "nor of an effect in effects"),
        ("effects = []", "parameters.surface_loss = {}", "line 3", 'write "surface_absorption"'),
        ("effects = []", 'effects = ["background"]\nparameters.backgruond = {}', "line 4",
         "did you mean background?"),
        *(
            ("[light", f"[next_measurements]\n{entry}\n[light", "line 12", says)
            for entry, says in (
                ("n_gapp = [1]", "did you mean n_gap?"), ("n_gap = 1", "not a list of numbers"),
                ("n_gap = [1, 5]", "n_gap = 5: "), ("n_gap = [nan]", "n_gap = nan: "),
                (f"n_gap = [{2**63}]", "n_gap"), ("polarization = [1]", "not a number"),
                ("alpha_scat_per_cm = [1]", "fitted: a measurement cannot set it"),
                ("sigma_relative = 2", "0.007 for 0.7 %"),
            )
        ),
        ("effects = []", 'effects_folder = "mine"', "line 3", "is not a folder"),
        ("camoo4.xml", "camoo5.xml", "line 1", "relative to the campaign file"),
        ('scene = "camoo4.xml"', "", "campaign.toml", 'add scene = "..."'),
        ('"measured.csv"', "3", "line 2", 'write measurements = "..."'),
        ("alpha_scat_per_cm", "alpha_scatt_per_cm", "line 4", "did you mean alpha_scat_per_cm?"),
        ("alpha_scat_per_cm", "polarization", "line 4", "not a number"),
        ("[parameters.alpha_scat", "[parameter.alpha_scat", "line 4", "did you mean parameters?"),
        ("alpha_scat_per_cm]\n", "n_gap]\n", "line 4", "a column of measured.csv"),
        ("start = 0.5", "start = 50", "line 5", "outside 0.001..10"),
        ("start = 0.5", "start = 0,5", "line 5, column 10", "decimals with a point"),
        ("start = 0.5", 'start = "0.5"', "line 5", "without quotes"),
        ("start = 0.5", "start = nan", "line 5", "not a finite number"),
        ("start = 0.5", "begin = 0.5", "line 5", "known are: start"),
        ("min = 0.001", "min = 20", "line 6", "not below max = 10"),
        ("prior_sigma = 0.012", "prior_sigma = 0", "line 10", "fixed = true"),
        ("prior_sigma = 0.012", "", "line 8", "give both or none"),
        ("prior_sigma = 0.012", "fixed = 1", "line 10", "write fixed = true"),
        ("prior = 0.039\nprior_sigma = 0.012\n", "", "campaign.toml", "(alpha_scat_per_cm, "),
        ("alpha_abs_per_cm]", "tilt]", "line 8", "give min and max"),
        ("prior = 0.039\nprior_sigma = 0.012", "[parameters.scale]", "line 9", "start"),
        ("energy_keV = 59.5", "energy_keV = -1", "line 12", "not above 0"),
        ("energy_keV = 59.5", "", "line 11", "needs energy_keV"),
        ("efficiency = 0.127", "efficiency = 12.7", "line 13", "0.127 for 12.7 %"),
        ("sigma = 0.0127", "sigma = -0.1", "line 14", "negative"),
        # entries of other kinds
        ("start = 0.5", "start = 1979-05-27", "line 5", "start is not a number"),
        ("start = 0.5", "start = true", "line 5", "start is not a number"),
        ("start = 0.5", "start = inf", "line 5", "start"),
        ("start = 0.5", "strat = 0.5", "line 5", "did you mean start?"),
        ("start = 0.5", "start = 1e300", "line 5", "too large"),
        ("effects = []", 'effects_folder = "/dev/zero"', "line 3", "is not a folder"),
        ("effects = []", 'effects_folder = "camoo4.xml"', "line 3", "is not a folder"),
        ("effects = []", f"effects = [{'1, ' * 100_000}]", "line 3", "not a list of names"),
        ("effects = []", f'effects = ["{"x" * 500_000}"]', "line 3", "there is no effect"),
    ],
)  # fmt: skip
def test_bad_campaigns_are_refused_in_one_line(folder, old, new, place, says):
    assert old in CAMPAIGN
    refused = refusal(campaign, folder, CAMPAIGN.replace(old, new, 1))
    assert refused.startswith(str(folder / "campaign.toml"))
    assert place in refused and says in refused


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
    worse = TooLittleSimulatedError("too few", "more photons", {"scale": 2.0})
    assert pickle.loads(pickle.dumps(worse)).where == {"scale": 2.0}


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
    ):
        assert known.is_valid(tomllib.loads(CAMPAIGN))
        assert not known.is_valid(tomllib.loads(CAMPAIGN.replace(old, new))), new
