"""The closure test of the fit, small: `scripts/trials closure` does the same on 1000 campaigns.

Simulation, surfaces, likelihood and intervals together, on campaigns with a known truth whose
readings come from photons of their own. Few photons make the model's Monte Carlo error as large
as the readings', so that one left out, or counted twice, shows.
"""

import numpy as np
import pytest
from scipy import stats
from trials import closure
from trials.executor import Trial, TrialExecutor

SEED, CAMPAIGNS, REALISATIONS = 1, 60, 15
PHOTONS, TRUTH_PHOTONS = 49_152, 1_500_000
# every configuration read twice: eight readings of four simulations
CONFIGURATIONS = tuple((n_gap, height) for n_gap in (1.0, 1.46) for height in (10.0, 5.0)) * 2
# a right code fails each comparison with one in 1000 fresh seeds
FALSE_ALARM = 1e-3


@pytest.fixture(scope="module")
def truths():
    return closure.simulate_truth(CONFIGURATIONS, TRUTH_PHOTONS, SEED)


@pytest.fixture(scope="module")
def outcomes(truths):
    effort = closure.Effort("test", PHOTONS, REALISATIONS)
    drawn = closure.draw_realisations(effort, CAMPAIGNS, CONFIGURATIONS, truths, SEED, place=1)
    found = closure.Outcomes([fit for r in drawn for fit in closure.fit_realisation(r)])
    assert found.refusals == ()
    return found


def shared(outcomes):
    """Correlation of two campaigns of one realisation: the Monte Carlo part of the variance."""
    return float(np.max(np.mean((outcomes.monte_carlo / outcomes.sigma) ** 2, axis=0)))


def test_intervals_are_as_wide_as_the_estimates_scatter(outcomes):
    """Interval pulls z of a campaign, with their correlation rho: z rho^-1 z is chi2 of 3.

    The sum over campaigns is chi2 of 3 times as many, widened for what realisations share: the
    chi2 of two campaigns with a correlation f correlate with f^2.
    """
    z, precision = outcomes.interval_pull, np.linalg.inv(outcomes.correlation)
    mean = np.mean(np.einsum("ni,nij,nj->n", z, precision, z)) / 3
    sharing = 1 + (CAMPAIGNS / REALISATIONS - 1) * shared(outcomes) ** 2
    degrees = 3 * CAMPAIGNS / sharing
    ends = stats.chi2(degrees).ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2]) / degrees
    assert ends[0] < mean < ends[1], (mean, ends)


def test_estimates_are_not_biased(outcomes):
    sharing = 1 + (CAMPAIGNS / REALISATIONS - 1) * shared(outcomes)
    of_truth = np.mean((outcomes.truth_sigma / outcomes.sigma) ** 2, axis=0)
    error = np.sqrt(sharing / CAMPAIGNS + of_truth)
    z = np.abs(outcomes.pull.mean(axis=0)) / error
    # the largest of three, as if they were independent
    assert z.max() < stats.norm.isf(FALSE_ALARM / 6), z


def test_coverage(outcomes):
    """All parameters together; they count as one, for they are correlated."""
    sharing = 1 + (CAMPAIGNS / REALISATIONS - 1) * shared(outcomes)
    error = np.sqrt(0.683 * 0.317 * sharing / CAMPAIGNS)
    z = (outcomes.covered.mean() - 0.683) / error
    assert abs(z) < stats.norm.isf(FALSE_ALARM / 2), z


def test_p_values_are_even(outcomes):
    assert stats.kstest(outcomes.p_value, "uniform").pvalue > FALSE_ALARM


def test_fits_of_an_interrupted_script_are_kept(truths, outcomes, tmp_path, monkeypatch):
    """The same digits as without the files, and nothing is fitted twice."""
    monkeypatch.setattr(closure, "CONFIGURATIONS", CONFIGURATIONS)
    effort = closure.Effort("test", PHOTONS, REALISATIONS)

    def trials():
        executor = TrialExecutor(folder=tmp_path)
        return closure.EffortTrials(effort, CAMPAIGNS, SEED, place=1, executor=executor)

    def interrupted(what, done, total):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trials().do(truths, interrupted)
    going_on = trials()
    assert [trial.number for trial in going_on.trials.missing] == list(range(1, REALISATIONS))
    # one more is enough here
    going_on.trials.missing = going_on.trials.missing[:1]
    assert going_on.do(truths, lambda *_: None) == []
    found = [fit for n in range(2) for fit in going_on.trials.results[Trial("test", n)]]
    direct = outcomes.value[outcomes.realisation < 2]
    np.testing.assert_array_equal(np.array([fit["value"] for fit in found]), direct)


def test_the_script_s_verdicts():
    """What is judged, on pulls that are normal, too wide, or shifted."""
    rng = np.random.default_rng(3)

    def rows(width, shift, interval):
        ones = np.ones(3)
        fits = [
            dict(
                realisation=number % 50,
                truth=0 * ones,
                value=value,
                sigma=ones,
                lower=value - interval,
                upper=value + interval,
                monte_carlo=0.3 * ones,
                truth_sigma=0 * ones,
                correlation=np.eye(3),
                p_value=0.5,
            )
            for number, value in enumerate(rng.normal(shift, width, (4000, 3)))
        ]
        return closure.judge(closure.Outcomes(fits))

    for row in rows(1.0, 0.0, 1.0):
        assert row.within
        assert row.monte_carlo == pytest.approx(0.3)
        # jackknife of independent campaigns: the binomial error and the like, to 10 %
        expected = np.array([np.sqrt(0.683 * 0.317), 1.0, np.sqrt(0.5)]) / np.sqrt(4000)
        errors = [row.coverage.error, row.pull_mean.error, row.pull_width.error]
        assert errors == pytest.approx(expected, rel=0.4)
    for row in rows(1.25, 0.0, 1.25):
        assert (row.coverage.within, row.pull_mean.within) == (True, True)
        assert not row.pull_width.within
    for row in rows(1.0, 0.3, 1.1):
        assert (row.pull_mean.within, row.pull_width.within) == (False, True)
    assert not any(row.coverage.within for row in rows(1.0, 0.0, 0.8))
