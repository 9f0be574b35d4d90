"""Campaigns from their files to the result: simulated, fitted, and what that took."""

import functools
import math

import pytest
from places import SCENES

from mcrim_mitsuba.campaign.campaign import as_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.noise_free import solve_simulation
from mcrim_mitsuba.inference.calibrate import PILOT_PHOTONS, calibrate, calibrate_without_noise
from mcrim_mitsuba.transport.simulation import Simulation


@pytest.fixture
def campaign(scenes, tmp_path):
    """Writes the article's campaign with other rows; gives its path."""

    def write(rows: str, columns: str = "label,signal,sigma,n_gap"):
        for name in ("camoo4.xml", "camoo4_campaign.toml"):
            (tmp_path / name).write_text((scenes / name).read_text())
        (tmp_path / "camoo4_measured.csv").write_text(f"{columns}\n{rows}")
        return tmp_path / "camoo4_campaign.toml"

    return write


ARTICLE = "air,14.3,0.2,1.00\ngel,24.5,0.4,1.46\n"


def test_photons_are_shared_out_and_accounted_for(campaign):
    result = calibrate(campaign(ARTICLE), run=Run(2_000_000, seed=1))
    found = result.calibration.parameters
    # references with the campaign's ratio of 0.5837: 0.560 + 0.006, unpolarised
    part = found["alpha_scat_per_cm"].contributions
    assert abs(found["alpha_scat_per_cm"].value - 0.566) < 3.5 * part["monte_carlo"]
    # what 27 million photons, the default, are to bring below 0.003
    assert part["monte_carlo"] < 0.003 * math.sqrt(27 / 2) * 1.1
    spent = [each.photons for each in result.spent]
    assert sum(spent) == pytest.approx(2_000_000, rel=0.02)
    assert result.provenance.photons == sum(spent) + 2 * PILOT_PHOTONS
    # eta of the air gap has the larger relative error per photon, and weighs as much
    assert spent[0] > spent[1]
    assert [each.parameters["n_gap"] for each in result.spent] == [1.0, 1.46]


def test_precision_is_reached_where_readings_are_used(campaign):
    rows = "air,14.3,0.2,1.00,1\nwater,20.0,0.4,1.333,0\ngel,24.5,0.4,1.46,1\n"
    path = campaign(rows, "label,signal,sigma,n_gap,use")
    result = calibrate(path, run=Run(precision=0.003, seed=2))
    air, water, gel = result.spent
    for each in (air, gel):
        assert each.eta_relative_sigma <= 0.003
    assert water.photons < min(air.photons, 300_000)
    row = result.calibration.rows[1]
    assert not row.use and row.eta_sigma / row.eta < 0.02


def test_a_misfit_is_not_lessened_by_poor_simulations(campaign):
    """Liquid readings behind the narrow mask are 20 % too low, as staff tried it.

    A first look's photons, weighted as far as 10 /cm, give anything: the best fit was there.
    """
    rows, wrong = "", {(1.333, 5.0): 0.8, (1.46, 5.0): 0.8}
    for n_gap in (1.0, 1.333, 1.46):
        for radius in (10.0, 5.0):
            bench = {"n_gap": n_gap, "aperture_radius_mm": radius, "alpha_scat_per_cm": 0.54}
            eta = solve_simulation(Simulation(SCENES / "camoo4.xml", bench)).eta
            signal = 55.0 * eta * wrong.get((n_gap, radius), 1.0)
            rows += f"{n_gap} {radius},{signal:.5g},{0.007 * signal:.5g},{n_gap},{radius}\n"
    path = campaign(rows, "label,signal,sigma,n_gap,aperture_radius_mm")
    found = calibrate(path, run=Run(4_000_000, seed=0)).calibration
    best = calibrate_without_noise(as_campaign(path)).calibration
    assert found.chi2 == pytest.approx(best.chi2, rel=0.15)
    value, known = found.parameters["alpha_scat_per_cm"], best.parameters["alpha_scat_per_cm"]
    assert abs(value.value - known.value) < known.sigma


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("air,1e-9,1e-12,1.00\ngel,1e9,0.4,1.46\n", "cannot be fitted together"),
        ("air,24.5,0.4,1.00\ngel,14.3,0.2,1.46\n", None),
        ("air,13.4,0.2,1.00\ngel,16.9,0.2,1.46\n", None),
    ],
    ids=["absurd", "swapped", "strange"],
)
def test_strange_readings_end_in_a_line_or_in_a_fit_that_says_so(campaign, rows, says):
    """Where a first look leads to an end of what it simulated, a second one looks there.

    What follows depends on the few photons: a fit far off, or the hint at swapped rows.
    """
    run = functools.partial(calibrate, campaign(rows), run=Run(800_000, seed=3))
    if says is not None:
        with pytest.raises(InputError, match=says):
            run()
        return
    try:
        found = run().calibration
    except InputError as error:
        assert "check that no rows are swapped" in str(error)
        return
    assert found.chi2 > 3 or any("bound" in note for note in found.notes)
    assert found.parameters["alpha_scat_per_cm"].value > 3
