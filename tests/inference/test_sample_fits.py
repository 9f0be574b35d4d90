"""Several crystals in one fit: slopes, the truth of readings made by another way, evidences.

Statistical tests have fixed seeds and state their false-alarm level.
"""

from dataclasses import replace

import numpy as np
import pytest
from bench_scene import bench_scene
from places import SCENES
from scipy.stats import chi2
from trials.formula_bench import explanations_of

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.simulations import CampaignSimulations, calibrate
from mcrim_mitsuba.reference.tracer import trace

PHOTONS = 40_000
#: Of tests that hold whatever eta is.
FEW = Run(16_384)
TRUTH = {
    "alpha_scat_per_cm": 0.5,
    "alpha_abs_per_cm": 0.04,
    "alpha_abs_b_per_cm": 0.12,
    "scale": 56.0,
}
CAMPAIGN = f"""scene = '{SCENES / "camoo4.xml"}'
measurements = "rows.csv"
[parameters.alpha_scat_per_cm]
start = 1.0
max = 5.0
[parameters.alpha_abs_per_cm]
start = 0.08
max = 0.3
[samples.b.scene]
n_crystal = 1.92
[samples.b.parameters.alpha_abs_per_cm]
start = 0.06
max = 0.3
[tolerances]
none = true
"""


def test_two_thicknesses_of_a_boule_beside_another_crystal(tmp_path):
    """Readings by the NumPy tracer; two limits that one fit of 5000 exceeds each."""
    rows = ["label,sample,signal,sigma,n_gap,crystal_height_mm"]
    crystals = [("", 2.01, 10, 0.04), ("", 2.01, 3, 0.04), ("b", 1.92, 10, 0.12)]
    for number, (sample, n, height, a_a) in enumerate(crystals):
        for n_gap in (1.0, 1.46):
            bench = bench_scene(
                n_crystal=n,
                crystal_height_mm=height,
                alpha_scat_per_cm=0.5,
                alpha_abs_per_cm=a_a,
                n_gap=n_gap,
            )
            seen = trace(bench, PHOTONS, seed=20 + 2 * number + (n_gap > 1))
            signal, sigma = (TRUTH["scale"] * x for x in (seen.eta, seen.eta_sigma))
            rows.append(f"{number} {n_gap},{sample},{signal!r},{sigma!r},{n_gap},{height}")
    (tmp_path / "rows.csv").write_text("\n".join(rows))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    bench = CampaignSimulations(read_campaign(tmp_path / "campaign.toml"), Run(seed=1))
    found = calibrate(bench)
    assert set(found.names) == set(TRUTH) and found.converged
    away = np.array([found.values[name] - TRUTH[name] for name in found.names])
    distance = away @ np.linalg.solve(found.covariance, away)
    assert distance < chi2.ppf(1 - 1 / 5000, 4), found.parameters
    assert found.ndf == 2 and found.chi2 < chi2.ppf(1 - 1 / 5000, 2)
    # the second crystal's own absorption is told from the boule's
    own = found.parameters["alpha_abs_b_per_cm"]
    assert own.value - 3 * own.sigma > found.parameters["alpha_abs_per_cm"].value


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """The shipped example, with the scattering of CaWO4 and its scale free."""
    text = (SCENES / "camoo4_cawo4.toml").read_text()
    for name in ("camoo4.xml", "camoo4_cawo4.csv"):
        text = text.replace(f'"{name}"', f"'{SCENES / name}'")
    text = text.replace("start = 0.061\nfixed = true", "prior = 0.061\nprior_sigma = 0.02")
    text = "\n".join(x for x in text.split("\n") if not x.startswith("light_yield_ph"))
    path = tmp_path_factory.mktemp("samples") / "campaign.toml"
    path.write_text(text.replace("shared_efficiency_sigma", "# ") + SCALE_PRIOR)
    return CampaignSimulations(read_campaign(path), FEW).simulate()


SCALE_PRIOR = """
[samples.cawo4.parameters.scale]
"""


def test_slopes_by_own_and_shared_parameters(bench):
    model = bench.model()
    names = [p.name for p in model.free]
    start = {**{p.name: p.start for p in model.free}, "scale": 57.0, "scale_cawo4": 220.0}
    theta = np.array([start[name] for name in names])
    here = model.predict(theta)
    for place, name in enumerate(names):
        step = np.zeros(len(theta))
        step[place] = 1e-5 * theta[place]
        high, low = model.predict(theta + step), model.predict(theta - step)
        slopes = (high.signal - low.signal) / (2 * step[place])
        scale = np.abs(slopes).max()
        np.testing.assert_allclose(
            here.signal_slopes[:, place], slopes, rtol=2e-5, atol=1e-7 * scale, err_msg=name
        )
        # air and gel are of the one crystal, the third reading of the other
        assert list(slopes != 0) == (
            [False] * 2 + [True] if "cawo4" in name else [True] * 2 + [False]
        )
    many = model.predict_many(np.array([theta, 1.01 * theta]))
    np.testing.assert_allclose(many[0], here.signal, rtol=1e-9)
    np.testing.assert_allclose(many[1], model.predict(1.01 * theta).signal, rtol=1e-9)


def test_a_factor_on_all_efficiencies_is_one_for_all_samples():
    exact = replace(read_campaign(SCENES / "camoo4_cawo4.toml"), tolerances=())
    bench = CampaignSimulations(exact, FEW)
    model = bench.simulate().model()
    theta = np.array([57.0 if p.name == "scale" else p.start for p in model.free])
    place = [p.name for p in model.free].index("efficiency_factor")
    assert theta[place] == 1.0
    here, doubled = model.predict(theta), theta.copy()
    doubled[place] = 2.0
    np.testing.assert_allclose(model.predict(doubled).signal, 2 * here.signal, rtol=1e-12)
    np.testing.assert_allclose(here.signal_slopes[:, place], here.signal, rtol=1e-12)
    np.testing.assert_allclose(model.predict_many(doubled[None])[0], 2 * here.signal, rtol=1e-9)


def test_a_reference_is_of_its_own_line(tmp_path):
    """Its known light yield made photoelectrons per 122 keV, which were read as per 59.5 keV."""
    text = (SCENES / "camoo4_cawo4.toml").read_text()
    first, table, reference = text.partition("[samples.cawo4.light_yield]")
    text = first + table + reference.replace("59.5", "122")
    text = text.replace('"camoo4.xml"', f"'{SCENES / 'camoo4.xml'}'")
    (tmp_path / "campaign.toml").write_text(text)
    rows = (SCENES / "camoo4_cawo4.csv").read_text().replace("n_gap", "n_gap,energy_keV")
    rows = rows.replace("1.46", "1.46,59.5").replace("0.2,1.00", "0.2,1.00,59.5")
    (tmp_path / "camoo4_cawo4.csv").write_text(rows.replace("0.4,1.00", "0.4,1.00,122"))
    model = CampaignSimulations(read_campaign(tmp_path / "campaign.toml"), FEW).simulate().model()
    theta = np.array([57.0 if p.name == "scale" else p.start for p in model.free])
    read, names = model.predict(theta), [p.name for p in model.free]
    scales = theta[[names.index(name) for name in ("scale", "scale", "scale_cawo4")]]
    np.testing.assert_allclose(read.signal / read.eta, scales, rtol=1e-12)


def test_evidence_of_a_campaign_whose_samples_have_own_scales(bench):
    explanations = explanations_of(bench.model, {})
    assert set(explanations.scales) == {"scale", "scale_cawo4"}
    found = explanations.evidence(())
    assert np.isfinite(found.log) and found.effective_points > 100
    for name in ("scale", "scale_cawo4"):
        at = explanations.baseline.values[name]
        assert abs(found.mean[name] - at) < found.sigma[name] < 0.5 * at
