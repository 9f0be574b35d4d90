"""The article's numbers: its own arithmetic, the rule of the verdicts, and our simulations.

Seeds are fixed. The simulated numbers are compared with an independent exact calculation of
the bench (float64, analytic geometry), whose alpha_scat is good to 0.003 /cm and whose eta to
0.1 %; the allowances add twice our own Monte Carlo error.
"""

import csv
import dataclasses
import math
from functools import partial

import numpy as np
import pytest
from places import cases_of, tables_of
from refusals import refusal
from scipy import optimize

from mcrim_mitsuba.article import arithmetic, contradiction, simulated, yield_rows
from mcrim_mitsuba.article import efficiency_rows as table1
from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.efficiency_rows import position_of_maximum
from mcrim_mitsuba.article.published import (
    AGREES,
    DIFFERS,
    INCONSISTENT,
    REFERENCE,
    compare,
    printed,
)
from mcrim_mitsuba.article.reproduce import reproduce_article
from mcrim_mitsuba.article.simulated import article_campaign
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import add
from mcrim_mitsuba.efficiency.simulate import collect
from mcrim_mitsuba.inference import diagnose
from mcrim_mitsuba.inference.corrections import Quantities
from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
from mcrim_mitsuba.laboratory.error_budget import Uncertain
from mcrim_mitsuba.optics.slab_transmittance import clear_limit
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.scene.spectrophotometer import spectrophotometer_of
from mcrim_mitsuba.transport.simulation import Simulation

cases = cases_of(__file__)

# alpha_scat, 1/cm, where R = 0.583, by (polarised, T in %); of an independent calculation
ALPHA_SCAT_REFERENCE = {
    (True, 98.6): 0.379,
    (True, 96.0): 0.542,
    (True, 93.0): 0.687,
    (False, 98.6): 0.395,
    (False, 96.0): 0.560,
    (False, 93.0): 0.709,
}
# eta, %, at (0.039, 0.54) /cm
ETA_REFERENCE = {
    "eta_air at (0.039, 0.54) /cm, pol.": 25.26,
    "eta_gel at (0.039, 0.54) /cm, pol.": 43.32,
    "eta_air at (0.039, 0.54) /cm, unpol.": 25.20,
    "eta_gel at (0.039, 0.54) /cm, unpol.": 43.35,
}


@pytest.fixture(scope="module")
def result():
    """With one explanation of the transmittance, and no advice: the golden results have all."""
    few = partial(contradiction.diagnose, only=("top_roughness",))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contradiction, "diagnose", few)
        patch.setattr(diagnose, "next_measurements", lambda *_: ())
        return reproduce_article(run=Run(2_000_000, seed=2))


def row(rows, quantity):
    (found,) = [row for row in rows if row.quantity == quantity]
    return found


def test_printed_numbers_know_their_rounding():
    number = printed("0.54±0.10", "Sec. 6.2", "1/cm")
    assert (number.value, number.sigma, number.rounding) == (0.54, 0.10, 0.005)
    assert printed("76", "Sec. 4").rounding == 0.5
    middle = printed("0.3-0.4", "Sec. 6.2")
    assert (middle.value, middle.rounding) == (pytest.approx(0.35), pytest.approx(0.05))
    with pytest.raises(ValueError):
        printed("about 5", "nowhere")


@cases("ours", "errors", "expected", more=[(None, {}, REFERENCE)])
def test_verdict(ours, errors, expected):
    assert compare("", printed("7.5", ""), ours, **errors).verdict == expected


def test_printed_error_enters_the_verdict():
    number = printed("7.5±1.2", "", "ph/keV")
    assert compare("", number, 9.9).verdict == AGREES
    assert compare("", number, 9.96).verdict == DIFFERS
    assert compare("", None, 9.9, unit="%").verdict == REFERENCE


def test_numbers_that_follow_from_the_article_alone():
    rows = [
        *arithmetic.transmittance_rows(),
        *arithmetic.bare_crystal_rows(),
        *arithmetic.ratio_rows(),
        *arithmetic.light_yield_rows(),
        *arithmetic.relative_rows(),
        *arithmetic.table_2_rows(),
    ]
    for quantity, (value, verdict) in tables_of(__file__)["expected"].items():
        found = row(rows, quantity)
        digits = len(str(value).partition(".")[2])
        assert round(found.ours, digits) == value, quantity
        assert found.verdict == verdict, quantity
    # what the article computes from its own numbers is either right or a recorded blemish
    assert not [found.quantity for found in rows if found.verdict == DIFFERS]
    assert row(rows, "R = 14.3/24.5, Eq. 5").sigma == pytest.approx(0.01255, abs=5e-6)


def test_rounding_of_inputs_is_the_change_it_makes():
    value, moved = p.from_printed(lambda a, b: a / b, printed("10", ""), printed("4", ""))
    assert value == 2.5
    assert moved == pytest.approx(0.5 / 4 + (10 / 4 - 10 / 4.5))


@pytest.mark.parametrize("n", [1.25, 2.01 / 1.46, 1.45, 2.01])
def test_light_per_face_where_escape_cones_overlap(n):
    # directions between the cones' limit and the corner: inside any of the six cones?
    directions = np.random.default_rng(1).normal(size=(2_000_000, 3))
    largest = np.abs(directions).max(axis=1) / np.linalg.norm(directions, axis=1)
    inside = np.mean(largest > math.sqrt(1 - 1 / n**2))
    sigma = math.sqrt(inside * (1 - inside) / len(directions)) / 6
    assert abs(arithmetic.escape_per_face(n) - inside / 6) < 4 * sigma


def test_light_per_face_refuses_three_cones_at_once():
    with pytest.raises(ValueError):
        arithmetic.escape_per_face(1.22)


def test_scattering_coefficients_agree_with_an_independent_calculation(result):
    assert len(result.lines) == len(ALPHA_SCAT_REFERENCE)
    for line in result.lines:
        expected = ALPHA_SCAT_REFERENCE[line.polarised, line.printed.transmittance_percent.value]
        monte_carlo = line.alpha_scat.contributions["monte_carlo"]
        assert abs(line.alpha_scat.value - expected) < 0.012 + 2 * monte_carlo, line
        assert monte_carlo < 0.02
        air, gel = line.etas
        assert air / gel == pytest.approx(p.RATIO.value, abs=2e-6)


def test_error_of_alpha_scat_is_the_article_s(result):
    found = row(result.rows, "error of alpha_scat from that of R, Sec. 6.2")
    # five seeds gave 0.1024 to 0.1164, 0.106 in the mean, each known to 0.0032: a fixed band of
    # 0.006 would fail a right code in one run of 15
    assert abs(found.ours - 0.107) < 4.5 * found.sigma < 4.5 * 0.004
    assert found.verdict == AGREES


def test_efficiencies_agree_with_an_independent_calculation(result):
    for quantity, expected in ETA_REFERENCE.items():
        found = row(result.rows, quantity)
        assert abs(found.ours - expected) < 0.003 * expected + 2 * found.sigma, quantity
        assert found.verdict == AGREES


def test_bare_crystal_by_mitsuba(result):
    for quantity, exact in (
        ("one face, n = 2.01, by Mitsuba", 6.6272),
        ("one face, n = 1.377, by Mitsuba", 15.3561),
        ("trapped for ever, n = 2.01, by Mitsuba", 60.2371),
    ):
        found = row(result.rows, quantity)
        assert abs(found.ours - exact) < 3.5 * found.sigma, quantity
        assert found.sigma < 0.004 * exact


def test_curves_have_the_shapes_that_the_article_describes(result):
    peak = row(result.rows, "maximum of the gel curve, Sec. 6.2")
    assert peak.verdict == AGREES and abs(peak.ours - 0.362) < 3 * peak.sigma < 0.03
    flat = row(result.rows, "eta_air grows from 0.5 to 2 /cm by")
    steep = row(result.rows, "eta_air grows from 0.1 to 0.5 /cm by")
    assert flat.ours == pytest.approx(5.5, abs=1.5)
    assert steep.ours == pytest.approx(26, abs=1.5)


def test_other_crystals_and_what_differs(result):
    for quantity, expected, verdict in (
        ("eta of thin CaMoO4, 1 mm, gel, Sec. 6.2", 59.6, DIFFERS),
        ("CaWO4 of [20]: 3.8/0.25, Sec. 6.2", 15.2, AGREES),
        ("eta of CaWO4, air, Sec. 6.4", 16.9, DIFFERS),
        ("eta of CaMoO4 cube, wrapped, gel, Sec. 6.5", 69.2, DIFFERS),
    ):
        found = row(result.rows, quantity)
        assert found.ours == pytest.approx(expected, abs=0.1 + 3 * (found.sigma or 0)), quantity
        assert found.verdict == verdict
    wrapped = row(result.rows, "eta of CaMoO4 cube, wrapped, gel, Sec. 6.5")
    assert wrapped.systematic == pytest.approx(1.9, abs=0.2)  # 0.67 to 0.71
    differs = [found.quantity for found in result.rows if found.verdict == DIFFERS]
    assert differs == [
        "eta of thin CaMoO4, 1 mm, gel, Sec. 6.2",
        "eta of CaWO4, air, Sec. 6.4",
        "eta of CaMoO4 cube, wrapped, gel, Sec. 6.5",
        "[13] with our wrapped eta",
    ]
    assert row(result.rows, "[13] with our wrapped eta").ours == pytest.approx(6.32, abs=0.03)


def test_light_yields(result):
    fitted = result.yields.fitted
    assert fitted.value == pytest.approx(7.5, abs=0.03)
    assert fitted.systematic_sigma / fitted.value == pytest.approx(
        math.hypot(0.1, 0.095), abs=0.004
    )
    in_air = row(result.rows, "the same, detector efficiency measured in air")
    assert in_air.ours == pytest.approx((1 - (0.52 / 2.52) ** 2) * fitted.value)
    assert result.yields.relative.value == pytest.approx(6.74, abs=0.08)
    first, second = result.yields.at_article_point
    assert abs(first.value - second.value) < 0.05
    assert first.statistical_sigma / first.value == pytest.approx(0.0142, abs=0.0002)
    assert "0.2 standard errors" in result.agreement[0]
    assert "DISAGREE" not in " ".join(result.agreement)


def test_error_budget_is_that_of_the_fit(result):
    """Our spread of eta is 9 %, not the conservative 12 %; with 10 % and 1.2 %: 13.5 %."""
    eta, counts, total = (
        row(result.rows, f"error budget: {part}").ours for part in ("eta", "counts", "total")
    )
    assert eta == pytest.approx(9.0, abs=0.5)
    assert counts == pytest.approx(1.22, abs=0.05)
    assert total == pytest.approx(math.sqrt(eta**2 + counts**2 + 10.0**2), rel=1e-3)


def test_what_the_article_leaves_out_has_rows(result):
    """59.5 keV gammas stop in the first millimetre; what one index leaves out is next to nothing.

    Shifts within 4 of their standard errors (a false alarm in 1 of 16,000) of runs with 17 million
    photons per configuration.
    """
    for quantity, expected, unit in (
        ("eta_air", -4.83, "%"),
        ("eta_gel", -4.36, "%"),
        ("alpha_scat", 0.025, "1/cm"),
        ("Y", 0.376, "ph/keV"),
    ):
        found = row(result.rows, f"shift of {quantity} by source depth")
        assert abs(found.ours - expected) < 4 * found.sigma and found.unit == unit
        assert found.systematic > 0 and found.verdict == REFERENCE
    assert "1.03 ± 0.06 mm" in row(result.rows, "shift of Y by source depth").remark
    for what in ("index spread", "birefringence"):
        assert 0 < row(result.rows, f"error of eta_air by {what}").ours < 0.1


def test_two_readings_fix_scattering_as_their_ratio_does(result):
    """With the absorption held; R of the two signals is 0.1 % beside the printed one."""
    couplings = next(line.couplings for line in result.lines if line.polarised)
    for line in p.TABLE_1:
        alpha_abs = line.alpha_abs_per_cm.value
        found = couplings.fit(article_campaign(alpha_abs)).parameters[ALPHA_SCAT]
        ratio = p.SIGNAL_AIR.value / p.SIGNAL_GEL.value

        def beyond(alpha_scat, alpha_abs=alpha_abs, ratio=ratio):
            return couplings.at(alpha_scat, alpha_abs).values[2] - ratio

        assert found.value == pytest.approx(optimize.brentq(beyond, 0.1, 1.4), rel=1e-3)
        assert found.contributions["prior"] == 0


def test_statistical_error_of_the_yield_is_that_of_repeated_fits(result):
    couplings = next(line.couplings for line in result.lines if line.polarised)
    campaign = article_campaign(p.NOMINAL.alpha_abs_per_cm.value)

    def log_yield(*signals):
        pairs = zip(campaign.measurements.readings, signals, strict=True)
        readings = tuple(dataclasses.replace(r, signal=signal) for r, signal in pairs)
        measured = dataclasses.replace(campaign.measurements, readings=readings)
        found = couplings.fit(dataclasses.replace(campaign, measurements=measured))
        return math.log(found.parameters[LIGHT_YIELD].value)

    air, gel = p.SIGNAL_AIR, p.SIGNAL_GEL
    moved = math.hypot(
        log_yield(air.value + 0.1, gel.value) - log_yield(air.value - 0.1, gel.value),
        log_yield(air.value, gel.value + 0.2) - log_yield(air.value, gel.value - 0.2),
    )  # the two steps are half of the errors 0.2 and 0.4 to each side
    fitted = result.yields.fitted
    expected = math.hypot(moved, fitted.statistical["monte_carlo"] / fitted.value)
    assert fitted.statistical_sigma / fitted.value == pytest.approx(expected, rel=0.03)


def test_yields_that_disagree_are_called_so():
    def known(value, counts, shared=0.0):
        return Uncertain(value, {"counts": counts}, {"detector_efficiency": shared})

    sentence = yield_rows.agreement("a and b", known(7.5, 0.3), known(6.2, 0.4), "x")
    assert "DISAGREE" in sentence and "2.6 standard errors" in sentence
    sentence = yield_rows.agreement("a and b", known(7.5, 0.3, 9.0), known(7.0, 0.4), "x")
    assert " agree" in sentence and "1.0 standard errors" in sentence


def hill(noise):
    """Points of a curve with its maximum at 0.35 /cm, and (batches, points) deviations."""
    x = np.log(np.array(table1.PEAK_POINTS_PER_CM) / 0.35)
    etas = 0.43 - 0.015 * x**2 - 0.004 * x**3 + noise.mean(axis=0)
    columns = zip(etas, noise.T - noise.T.mean(axis=1, keepdims=True), strict=True)
    return [
        Quantities((), np.array([eta]), of[:, None], np.empty((0, 1)), np.empty(0))
        for eta, of in columns
    ]


def test_error_of_the_maximum_is_the_spread_of_repetitions():
    sigma, points, batches = 1e-4, len(table1.PEAK_POINTS_PER_CM), 32
    exact, _ = position_of_maximum(hill(np.zeros((batches, points))), 0)
    assert exact == pytest.approx(0.35, rel=1e-9)
    rng = np.random.default_rng(5)
    # half of the variance is common to all points
    shape, common = (400, batches, points), (400, batches, 1)
    noise = sigma * math.sqrt(0.5 * batches) * (rng.normal(size=shape) + rng.normal(size=common))
    places, claimed = np.transpose([position_of_maximum(hill(of), 0) for of in noise])
    # 400 draws: 3.5 %
    assert np.sqrt(np.mean(claimed**2)) == pytest.approx(np.std(places), rel=0.15)


def test_rows_come_in_the_article_s_order(result):
    sections = [found.section for found in result.rows]
    together = list(dict.fromkeys(sections))
    assert len(together) == 12 and sections == sorted(sections, key=together.index)
    assert len({(found.section, found.quantity) for found in result.rows}) == len(result.rows)


def test_the_two_claims_on_the_transmittance(result):
    """At the fitted point it is another by far; what it allows misses the ratio by two sigmas."""
    rows, found = result.rows, result.contradiction
    fitted = row(rows, "transmittance with the fitted alpha_scat and alpha_abs, Eqs. 3-4")
    sphere = row(rows, "the same into a sphere")
    # by hand, 262,144 photons: 0.1 %
    assert (fitted.ours, sphere.ours) == (
        pytest.approx(44.3, abs=0.05),
        pytest.approx(49.8, abs=0.4),
    )
    assert {fitted.verdict, sphere.verdict} == {INCONSISTENT}
    forward = row(rows, "the same into a sphere, scattering forward (g = 0.9)")
    assert forward.ours == pytest.approx(70.8, abs=0.4) and "ratio of 0.5" in forward.remark
    # what is known of the bench takes from the misfit; by 32 times the photons chi2 is 4.1 to 4.3,
    # 0.3 more were all numbers exact: its Monte Carlo error is 1 here (six seeds: 2.9 to 5.6)
    known, ignorant = found.diagnosis.baseline, found.ignorant
    assert (known.ndf, ignorant.ndf) == (1, 1)
    assert known.chi2 == pytest.approx(4.2, abs=1.5)
    # which of the two is larger here is chance
    assert ignorant.chi2 == pytest.approx(4.5, abs=1.5)
    claims = contradiction.sentences(found)
    assert "44 %, or 50 % into a sphere" in claims[0] and "standard errors" in claims[1]
    assert "over this catalogue with these priors" in claims[2]


def test_hazy_faces_lose_what_the_transport_says():
    """50 nm of rms would leave 39 % of the beam; and a simulated one that of 10 nm."""
    assert contradiction.hazy_transmittance(0.0) == pytest.approx(float(clear_limit(2.01)))
    assert 100 * contradiction.hazy_transmittance(50.0) == pytest.approx(39.5, abs=0.1)
    bench = read_scene(scene_path("camoo4.xml")).with_overrides(
        {"alpha_scat_per_cm": 0.0, "alpha_abs_per_cm": 0.0}
    )
    hazy = bench.edited(add("surface_haze", bench, {"rms_roughness_nm": 10.0}))
    simulation = Simulation(spectrophotometer_of(hazy), {"acceptance_deg": 1.0})
    found = collect(simulation, run=Run(200_000, seed=3))
    # of the light that a face scatters one part in 3000 leaves within a degree
    assert abs(found.eta - contradiction.hazy_transmittance(10.0)) < 4 * found.eta_sigma


def test_figures_and_their_numbers(result, tmp_path):
    files = result.draw(tmp_path / "new" / "folder")
    assert {file.suffix for file in files} == {".png", ".pdf", ".csv"}
    for file in files:
        start = file.read_bytes()[:5]
        assert {".png": b"\x89PNG\r", ".pdf": b"%PDF-"}.get(file.suffix, start) == start
    eta = list(csv.DictReader(files[5].open()))
    ratio = list(csv.DictReader(files[8].open()))
    assert len(eta) == 2 * 2 * 3 * 25 and len(ratio) == 2 * 3 * 25
    key = ("polarised", "transmittance_percent", "alpha_scat_per_cm")
    found = {(*(r[k] for k in key), r["n_gap"]): float(r["eta"]) for r in eta}
    for r in ratio:
        place = tuple(r[k] for k in key)
        expected = found[(*place, "1")] / found[(*place, "1.46")]
        assert float(r["ratio"]) == pytest.approx(expected, rel=1e-5)
        assert 0 < float(r["ratio_sigma"]) < 0.01
    assert {float(r["alpha_scat_per_cm"]) for r in eta} >= {0.01, 2.0}


def test_what_cannot_be_done_is_refused(tmp_path, mcrim):
    (tmp_path / "taken").touch()
    assert "taken" in mcrim.refused("paper", "-o", tmp_path / "taken")
    assert "too few" in refusal(simulated.simulate_article, run=Run(1000))
    assert scene_path("camoo4.xml").is_file()
    assert "nothing.xml" in refusal(scene_path, "nothing.xml")
