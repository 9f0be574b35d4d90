"""Campaigns whose spectra are in channels of a digitiser: their readings, and what these share."""

import json
import math

import numpy as np
import pytest
from formula_surfaces import air, couplings, gel
from places import cases_of
from refusals import refusal
from scipy.stats import binom
from trials.digitiser import ALPHA_ABS, ALPHA_SCAT, EFFICIENCY, ENERGY_KEV, LIGHT_YIELD
from trials.digitiser import write_campaign as write
from trials.surface_model import CampaignModel

from mcrim_mitsuba.app.page import make_page
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.campaign.calibration import CommonErrors
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import write_plain
from mcrim_mitsuba.campaign.measurements import read_table
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.fit import fit_model
from mcrim_mitsuba.laboratory.digitiser import read_channels
from mcrim_mitsuba.output.laboratory_figures import draw_raw_data

cases = cases_of(__file__)

YIELD = "light_yield_ph_per_keV"
COUPLINGS = [(1.0, 10.0), (1.46, 10.0)]
ETA = [of(ALPHA_SCAT, ALPHA_ABS) for of in (air, gel)]


def drawn(folder, seed):
    """A campaign in channels of the bench in formulas."""
    folder.mkdir(exist_ok=True)
    path = write(folder, np.random.default_rng(seed), ETA, COUPLINGS)
    readings = folder / "readings.csv"
    readings.write_text(readings.read_text().replace(",crystal_height_mm", "").replace(",10.0", ""))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return drawn(tmp_path_factory.mktemp("channels"), 1).parent


@pytest.fixture
def campaign(folder):
    return read_campaign(folder / "campaign.toml")


def fitted(campaign, **options):
    return fit_model(CampaignModel(campaign, couplings()), **options)


def test_the_light_yield_covers_the_truth_and_the_ratio_has_the_peaks_error(tmp_path):
    """Within two errors as often as 95.4 % lets expect (binomial, 0.1 %); ratios too."""
    draws, covered, ratios = 12, 0, 0
    for seed in range(draws):
        campaign = read_campaign(drawn(tmp_path / "draw", seed))
        estimate = fitted(campaign, profile=False).parameters[YIELD]
        covered += abs(estimate.value - LIGHT_YIELD) < 2 * estimate.sigma
        dry, wet = campaign.measurements.readings
        sigma = math.hypot(dry.sigma / dry.signal, wet.sigma / wet.signal)
        ratios += abs(dry.signal / wet.signal / (ETA[0] / ETA[1]) - 1) < 2 * sigma
        # the scale's error is in the light yield, and not in the readings
        assert sigma < 0.002 < campaign.common_errors.scale_sigma < 0.005
    least = binom.ppf(0.001, draws, 0.954)
    assert covered >= least and ratios >= least


def test_what_readings_share_is_in_the_light_yield_and_moves_ratios(campaign):
    common = campaign.common_errors
    scale = LIGHT_YIELD * ENERGY_KEV * EFFICIENCY
    for reading, eta in zip(campaign.measurements.readings, ETA, strict=True):
        assert abs(reading.signal - scale * eta) < 5 * math.hypot(
            reading.sigma, common.scale_sigma * reading.signal
        )
    assert common.scale_sigma == pytest.approx(campaign.raw.calibration.scale_sigma, rel=1e-5)
    assert common.offset_sigma == pytest.approx(campaign.raw.calibration.offset_sigma, rel=1e-5)
    parts = campaign.light_yield.efficiency_parts
    assert parts["photoelectron scale"] == pytest.approx(
        common.scale_sigma * campaign.light_yield.detector_efficiency
    )
    fit = fitted(campaign)
    errors = fit.minimum.weights.errors
    # one shift of all: correlated; a transmittance has no pedestal
    assert np.allclose(errors.pedestal, common.offset_sigma) and errors.pedestal.shape == (2, 1)
    assert errors.total[0, 1] == pytest.approx(common.offset_sigma**2)
    estimate = fit.parameters[YIELD]
    assert 0 < estimate.contributions["pedestal"] < estimate.contributions["statistical"]
    assert estimate.efficiency_contributions["photoelectron scale"] / estimate.value == (
        pytest.approx(common.scale_sigma)
    )
    moved = CommonErrors(offset_sigma=0.5, nonlinearity_sigma=1e-6).moved(
        np.array([1000.0, 2000.0, 0.7]), np.array([True, True, False])
    )
    assert moved.tolist() == [[0.5, 1.0], [0.5, 4.0], [0.0, 0.0]]


def test_the_plain_form_shares_the_same(campaign, tmp_path):
    plain = tmp_path / "plain.toml"
    write_plain(campaign, plain)
    read = read_campaign(plain)
    assert read.raw is None and read.common_errors == campaign.common_errors
    for one, other in zip(
        fitted(campaign).parameters.values(), fitted(read).parameters.values(), strict=True
    ):
        assert one.value == pytest.approx(other.value, rel=1e-4)
        assert one.sigma == pytest.approx(other.sigma, rel=1e-4)


def test_a_common_background_correlates_readings_that_lie_on_it_alike(folder, tmp_path):
    """Of two mountings, each its own reading, and one elsewhere; in the plain form as well."""
    again = drawn(tmp_path, 2).parent / "0.csv"
    (folder / "again.csv").write_bytes(again.read_bytes())
    rows = "label,histogram,n_gap\na,0.csv,1.0\nb,again.csv,1.0\nc,1.csv,1.46\n"
    (folder / "three.csv").write_text(rows)
    text = (folder / "campaign.toml").read_text()
    (folder / "three.toml").write_text(text.replace("readings.csv", "three.csv"))
    campaign = read_campaign(folder / "three.toml")
    a, b, c = campaign.measurements.readings
    assert len(a.shared) == len(b.shared) == 2 and not c.shared
    peaks = [of.mountings[0].peak.centroid_sigma for of in campaign.raw.readings.values()]
    for reading, sigma in zip((a, b, c), peaks, strict=True):
        assert math.hypot(reading.sigma, *reading.shared) == pytest.approx(sigma, rel=1e-3)
    errors = CampaignModel(campaign, couplings())
    covariance = fit_model(errors).minimum.weights.errors.total
    offset = campaign.common_errors.offset_sigma**2
    assert covariance[0, 1] - offset == pytest.approx(np.dot(a.shared, b.shared))
    assert covariance[0, 2] == pytest.approx(offset) and np.dot(a.shared, b.shared) > 0
    write_plain(campaign, tmp_path / "plain.toml")
    plain = read_campaign(tmp_path / "plain.toml")
    assert [r.shared for r in plain.measurements.readings] == [a.shared, b.shared, ()]


def test_spectra_may_all_lie_in_one_root_file(folder, campaign, tmp_path):
    uproot = pytest.importorskip("uproot")
    text, rows = ((folder / name).read_text() for name in ("campaign.toml", "readings.csv"))
    with uproot.recreate(tmp_path / "runs.root") as file:
        for name in ("few", "dark", "room", "0", "1"):
            read = read_channels(folder / f"{name}.csv")
            file[f"h{name}"] = read.counts, np.append(read.channels, len(read.channels)) - 0.5
            text = text.replace(f'"{name}.csv"', f'"runs.root:h{name}"')
            rows = rows.replace(f"{name}.csv", f"runs.root#h{name}")
    times = "live_time_s = 600\nbackground_live_time_s = 900\n[light_yield]"
    (tmp_path / "campaign.toml").write_text(text.replace("[light_yield]", times))
    (tmp_path / "readings.csv").write_text(rows)
    read = read_campaign(tmp_path / "campaign.toml")
    for one, other in zip(read.measurements.readings, campaign.measurements.readings, strict=True):
        assert (one.signal, one.sigma) == pytest.approx((other.signal, other.sigma), rel=1e-6)
    assert {file.path.name for file in read.raw.files} == {"runs.root"}
    write_plain(read, tmp_path / "plain.toml")
    assert "runs.root#h0" in (tmp_path / "plain.csv").read_text()


def test_every_step_is_shown(folder, campaign, mcrim, tmp_path):
    mcrim.shown("reduce", folder / "campaign.toml", "--json", tmp_path / "r.json")
    found = json.loads((tmp_path / "r.json").read_text())["calibration"]
    gain = found["single_photoelectrons"]
    assert abs(found["value"] - 45.0) < 5 * found["sigma"] and gain["p_value"] > 1e-4
    assert abs(gain["mean"] - 0.8) < 5 * gain["mean_sigma"]
    roles = [file.role for file in campaign.raw.files]
    assert roles[:3] == ["single photoelectrons", "pedestal", "background"]
    assert campaign.raw.kinds == ("histograms", "calibration")
    drawing = draw_raw_data(campaign.raw, "calibration")
    steps = {row[0] for row in drawing.rows}
    assert steps == {"single photoelectrons", "pedestal", "background"}
    # and a file of the table alone serves a spectrum alone
    shown = mcrim.shown(
        "lab", "peak", folder / "0.csv", "--calibration", folder / "campaign.toml", "--json", "-"
    )
    peak = json.loads(shown)["histograms"][0]["peak"]
    assert peak["centroid"] == pytest.approx(campaign.measurements.readings[0].signal, rel=1e-5)


def test_the_page_shows_every_step(campaign, tmp_path):
    session = Session(campaign, Run(), tmp_path)
    session.jobs.close(60)
    page = make_page(session, "/key/").test_client()
    shown = page.get("/key/").get_data(as_text=True)
    assert all(f'src="picture/{kind}"' in shown for kind in ("histograms", "calibration"))
    assert page.get("/key/picture/calibration").data.startswith(b"\x89PNG")
    assert page.get("/key/picture/spectra").status_code == 404


ENTRIES = 'single_photoelectron = "few.csv"\npedestal = "dark.csv"'


@cases("old", "new", "says")
def test_tables_that_cannot_be_used_are_refused(folder, old, new, says):
    path = folder / "broken.toml"
    path.write_text((folder / "campaign.toml").read_text().replace(old, new))
    assert says in refusal(read_campaign, path)


def test_readings_of_several_kinds_are_not_mixed(folder):
    rows = folder / "readings.csv"
    text, path = rows.read_text(), folder / "campaign.toml"
    try:
        rows.write_text("label,histogram,signal,sigma,n_gap\na,0.csv,,,1.0\nb,,1400,3,1.46\n")
        assert "b is a number beside [calibration]" in refusal(read_campaign, path)
        rows.write_text("label,signal,sigma,n_gap\na,800,2,1.0\nb,1400,3,1.46\n")
        assert "a is a number beside [calibration]" in refusal(read_campaign, path)
    finally:
        rows.write_text(text)
    without = folder / "without.toml"
    lines = path.read_text().splitlines(keepends=True)
    cut = [lines.index("[calibration]\n"), lines.index("[light_yield]\n")]
    without.write_text("".join(lines[: cut[0]] + lines[cut[1] :]))
    assert "holds channels of a digitiser, not photoelectrons; give a calibration" in refusal(
        read_campaign, without
    )
    assert len(read_table(rows, {"n_gap": 1.0}).readings) == 2
