"""Every verb on every campaign: no traceback, one chi2, one light yield."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import ROOT, SCENES

from mcrim_mitsuba.campaign import campaign as campaigns
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.measurements import read_table
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.responses import Point
from mcrim_mitsuba.inference import plan as planning
from mcrim_mitsuba.inference.drivers import find_minima, minuit, newton
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.transport.launch_plan import LANES

TRIALS = ROOT / "tests" / "trials"
CAMPAIGNS = {
    path.relative_to(ROOT).as_posix(): path
    for path in [*sorted(SCENES.rglob("*.toml")), *sorted(TRIALS.glob("*.toml"))]
    # the reference of a relative method is no campaign
    if path.name != "cawo4_reference.toml"
}
#: What is typed besides the campaign, and where a document has the campaign's own fit; a diagnosis
#: of one effect goes the way of one of all.
VERBS = {
    "calibrate": ([], ()),
    "compare": ([], ()),
    "diagnose": (["--only", "background"], ("baseline",)),
    "budget": ([], ("calibration",)),
}
FEW = ["--photons", LANES, "--seed", 3]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """What one verb simulated serves the others."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def few_rows(monkeypatch):
    """Four of every table, from its first to its last: verbs do with few what they do with many."""

    def thinned(*words):
        table = read_table(*words)
        places = np.unique(np.linspace(0, len(table.readings) - 1, 4).round().astype(int))
        return replace(table, readings=tuple(table.readings[place] for place in places))

    monkeypatch.setattr(campaigns, "read_table", thinned)


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_every_verb_tells_the_same_of_a_campaign(mcrim, here, monkeypatch, cache, name):
    """A parameter at its bound was a traceback in `calibrate`; chi2 was 45.7 here, 110.2 there."""
    monkeypatch.setenv("MCRIM_CACHE", str(cache))
    campaign, fits = CAMPAIGNS[name], {}
    for verb, (further, way) in VERBS.items():
        status, _, err = mcrim(verb, campaign, *further, *FEW, "--json", f"{verb}.json")
        assert status == 0, err
        fit = json.loads(Path(f"{verb}.json").read_text())
        for step in way:
            fit = fit[step]
        fits[verb] = fit
    first = fits["calibrate"]
    for verb, fit in fits.items():
        for name in ("chi2", "ndf", "fixed", "covariance", "tolerances", "converged"):
            assert fit[name] == first[name], (verb, name)
        pairs = [(first["parameters"][n], fit["parameters"][n]) for n in first["parameters"]]
        for known, same in (*pairs, *zip(first["rows"], fit["rows"], strict=True)):
            both = known.keys() & same.keys()  # some verbs have more, or no wide interval
            assert len(both) > 4 and [known[n] for n in both] == [same[n] for n in both], verb
    # a plan may be refused: a campaign may have no light yield to plan for, or several samples
    monkeypatch.setattr(planning, "_rehearsed", lambda plans, *_: plans)  # that is a diagnosis
    try:
        plans = planning.plan(campaign, 0.1, run=Run(LANES, seed=3), mountings=[1], events=[1e4])
    except InputError as refused:
        assert refused.mend and "\n" not in str(refused)
    else:
        assert plans.so_far.total >= plans.proposed.light_yield.total


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_both_drivers_end_at_the_same_chi2(monkeypatch, cache, name):
    """From the start of the search, with the weights of the minimum."""
    monkeypatch.setenv("MCRIM_CACHE", str(cache))
    run = Run(LANES, seed=3, check=False)
    statistic = Statistic(CampaignSimulations(read_campaign(CAMPAIGNS[name]), run).models.model())
    best = find_minima(statistic)[0]
    # some standard errors away
    start = np.clip(best.theta + 2.0 * np.sqrt(np.diag(best.covariance)), *statistic.bounds)
    by_newton = newton(statistic, start, best.weights, precision=1e-9).height
    _, by_minuit, content = minuit(statistic, start, best.weights)
    assert content and abs(by_newton - by_minuit) < 1e-6
    assert abs(by_newton - best.chi2) < 1e-6


def test_a_fit_that_goes_below_its_grid_is_not_disturbed_by_noise_above():
    """The wide grid went up to 10 /cm, with 35 % of noise there: slopes here jumped by 30 %."""
    campaign = replace(read_campaign(CAMPAIGNS["tests/trials/lyso_C.toml"]), tolerances=())
    simulations = CampaignSimulations(campaign, Run(photons=2 * LANES, seed=0))
    responses, readings = simulations.models.responses, campaign.measurements.readings
    assert simulations.maker.grid.alpha_scat_range_per_cm == (0.0005, 0.2)
    slopes = [
        Point.of(responses.grid, [a_s] * len(readings), [0.03] * len(readings)).value_and_slopes(
            responses.log_eta
        )[1]
        for a_s in np.geomspace(0.0006, 0.004, 12)
    ]
    # light that is trapped until it scatters: ever less slope, and 1 / (1 + a_s / a_a)^2 at least
    assert np.all(np.diff(slopes, axis=0) < 0)
    assert np.all(slopes[-1] > 0.75 * slopes[0])
