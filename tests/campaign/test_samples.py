"""Several crystals in one campaign: what is read, what is refused, what is written."""

import math

import pytest
from places import SCENES, cases_of
from refusals import refusal

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects, measurements_text
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.campaign.samples import of_sample
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT

cases = cases_of(__file__)

CSV = """label,sample,signal,sigma,n_gap
air,,14.3,0.2,1.00
gel,,24.5,0.4,1.46
thin,thin,26,0.4,
other,other,30,0.4,1.46
other air,other,20,0.4,1
"""
SPECTRUM = f"spectrum = '{SCENES / 'camoo4_light.csv'}'"
CAMPAIGN = f"""scene = '{SCENES / "camoo4.xml"}'
measurements = "rows.csv"
[parameters.alpha_scat_per_cm]
start = 0.5
[parameters.alpha_abs_per_cm]
start = 0.04
[light_yield]
energy_keV = 59.5
detector_efficiency = 0.127
detector_efficiency_sigma = 0.0127
shared_efficiency_sigma = 0.05
[samples.thin.scene]
crystal_height_mm = 5
n_gap = 1.46
[samples.other.scene]
n_crystal = 1.92
[samples.other.parameters.alpha_abs_per_cm]
start = 0.1
max = 0.5
[samples.other.light_yield]
energy_keV = 59.5
detector_efficiency = 0.2
detector_efficiency_sigma = 0.026
"""
SHARED = "shared_efficiency_sigma = 0.05\n"
INSIDE = CAMPAIGN.replace(SHARED, SHARED + 'efficiency_of = "inside the window"\n')


@pytest.fixture
def read(tmp_path):
    (tmp_path / "rows.csv").write_text(CSV)

    def read(text=CAMPAIGN, rows=CSV):
        (tmp_path / "rows.csv").write_text(rows)
        (tmp_path / "campaign.toml").write_text(text)
        return read_campaign(tmp_path / "campaign.toml")

    return read


def test_what_samples_share_and_what_is_their_own(read):
    campaign = read(INSIDE)
    air, _, thin, other, _ = campaign.measurements.readings
    assert thin.parameters == {"crystal_height_mm": 5.0, "n_gap": 1.46}
    assert other.parameters == {"n_gap": 1.46, "n_crystal": 1.92}
    named = [
        [campaign.parameter_of(r, name) for name in (ALPHA_SCAT, ALPHA_ABS, SCALE)]
        for r in (air, thin, other)
    ]
    shared = [ALPHA_SCAT, ALPHA_ABS, SCALE]
    assert named == [shared, shared, [ALPHA_SCAT, "alpha_abs_other_per_cm", "scale_other"]]
    assert campaign.free == (
        ALPHA_SCAT,
        ALPHA_ABS,
        "alpha_abs_other_per_cm",
        "scale_other",
        "efficiency_factor",
        SCALE,
    )
    own = campaign.parameters["alpha_abs_other_per_cm"]
    assert (own.start, own.maximum) == (0.1, 0.5)
    # what is shared of the efficiency's error is taken out of it: sqrt(0.1^2 - 0.05^2)
    name, known = campaign.light_yields["scale_other"]
    assert name == "light_yield_other_ph_per_keV"
    assert of_sample(name) == ("light_yield_ph_per_keV", "other")
    assert of_sample("alpha_abs_other_per_cm") == (ALPHA_ABS, "other")
    assert all(of_sample(name) is None for name in (*shared, "gap_mm", "sample_scale"))
    assert known.detector_efficiency_sigma == pytest.approx(0.2 * (0.13**2 - 0.05**2) ** 0.5)
    assert campaign.priors == {"efficiency_factor": (1.0, 0.05)}


def test_a_known_light_yield_is_a_prior_of_the_scale(read):
    known = "light_yield_ph_per_keV = 16.2\nlight_yield_ph_per_keV_sigma = 1.62\n"
    campaign = read(INSIDE + known)
    value, sigma = campaign.priors["scale_other"]
    assert value == pytest.approx(16.2 * 59.5 * 0.2)
    assert sigma / value == pytest.approx((0.1**2 + 0.13**2 - 0.05**2) ** 0.5)
    assert list(campaign.light_yields) == [SCALE]


def test_one_detector_reads_all_samples(read):
    """Its window and its collection are factors of all efficiencies; ratios of yields stay."""
    terms = "collection_efficiency = 0.9\ncollection_efficiency_sigma = 0.036\n"
    inside, both = read(INSIDE), read(CAMPAIGN.replace(SHARED, SHARED + terms))
    factor = 0.9 / (1 - (0.52 / 2.52) ** 2)
    for scale, (_, known) in both.light_yields.items():
        _, before = inside.light_yields[scale]
        assert known.detector_efficiency == pytest.approx(factor * before.detector_efficiency)
        # the error that they share is that of the common factor alone
        assert known.detector_efficiency_sigma / known.detector_efficiency == pytest.approx(
            before.detector_efficiency_sigma / before.detector_efficiency
        )
    assert both.priors["efficiency_factor"] == (1.0, pytest.approx(math.hypot(0.05, 0.04)))


@cases(
    "old",
    "new",
    "place",
    "says",
    more=[
        (
            "[parameters.alpha_scat",
            f"{SPECTRUM}\n[parameters.alpha_scat",
            "line 16",
            "spectrum is of one crystal",
        )
    ],
)
def test_bad_samples_are_refused_in_one_line(read, old, new, place, says):
    assert old in CAMPAIGN
    refused = refusal(read, CAMPAIGN.replace(old, new, 1))
    assert "campaign.toml" in refused and place in refused and says in refused


def test_bad_rows_of_samples_are_refused_in_one_line(read):
    refused = refusal(read, rows=CSV.replace("thin,thin", "thin,thim"))
    assert "rows.csv, line 4, column sample" in refused and "did you mean thin?" in refused
    # a coefficient of every row's own cannot be a sample's
    head, *rows = CSV.splitlines()
    with_column = "\n".join([f"{head},alpha_abs_per_cm", *(f"{row},0.1" for row in rows)])
    shared = CAMPAIGN.replace("[parameters.alpha_abs_per_cm]\nstart = 0.04\n", "")
    refused = refusal(read, shared, with_column)
    assert "line 15: alpha_abs_per_cm is fitted here and a column of rows.csv" in refused
    # every row is of a sample with a scale of its own
    others = [head, *(row for row in rows if "other" in row)]
    alone = CAMPAIGN.replace("[samples.thin.scene]\ncrystal_height_mm = 5\nn_gap = 1.46\n", "")
    refused = refusal(read, alone, "\n".join(others))
    assert "no reading of light in use says anything of scale; samples have their own" in refused


def test_samples_are_kept_where_a_campaign_goes_on(read, tmp_path):
    campaign = read()
    starts = {"alpha_abs_other_per_cm": 0.123, "scale_other": 77.0, SCALE: 50.0}
    starts["efficiency_factor"] = 1.02
    text = campaign_with_effects(campaign, tmp_path / "next.toml", campaign.scene.path, starts)
    again = read(text, measurements_text(campaign.measurements))
    assert again.parameters["alpha_abs_other_per_cm"].start == 0.123
    assert again.samples["thin"] == campaign.samples["thin"]
    assert again.free == campaign.free
    rows = zip(again.measurements.readings, campaign.measurements.readings, strict=True)
    assert all(one.parameters == other.parameters for one, other in rows)
