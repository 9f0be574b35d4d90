"""Evidence: averages over plausible sizes, against nested sampling and closed forms."""

import math

import dynesty
import numpy as np
import pytest
import synthetic_bench as bench
from scipy import stats

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.inference.evidence import Evidence, even, gaussian, size, weigh
from mcrim_mitsuba.inference.explanations import Explanations

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}


@pytest.fixture(scope="module")
def explanations():
    """Of a campaign with a bubble of moderate size."""
    rng = np.random.default_rng(7)
    signal = bench.signals({**TRUTH, "bubble_fraction": 0.04})
    rows = bench.readings(signal * (1.0 + bench.SIGMA * rng.standard_normal(len(signal))))
    noise = bench.simulation_noise(7)
    return Explanations(
        lambda added: bench.Model(rows, tuple(added), noise), bench.EFFECTS, bench.SCENE
    )


@pytest.mark.parametrize(
    "effects",
    [(), ("gap_bubble",), ("scattering_gradient",), ("background",), ("source_depth",),
     ("edge_chamfer", "gap_bubble")],
)  # fmt: skip
def test_evidence_is_that_of_nested_sampling(explanations, effects):
    """To 0.3 in the logarithm; nested sampling itself knows it to 0.1."""
    found = explanations.evidence(effects)
    fit, priors = explanations.fit(effects), explanations.priors(effects)
    quantiles = [priors[name].quantile for name in fit.names]
    whitener, used = fit.weights.whitener, fit.problem.used

    def log_likelihood(theta):
        residuals = whitener @ (fit.problem.signal - fit.problem.model.predict(theta).signal[used])
        return -0.5 * (residuals @ residuals + fit.weights.log_determinant)

    sampler = dynesty.NestedSampler(
        log_likelihood,
        lambda u: np.array([float(q(np.array([p]))[0]) for q, p in zip(quantiles, u, strict=True)]),
        len(quantiles), nlive=150, rstate=np.random.default_rng(1), bound="multi", sample="rwalk",
    )  # fmt: skip
    sampler.run_nested(dlogz=0.05, print_progress=False)
    assert sampler.results.logzerr[-1] < 0.35
    assert found.log_sigma < 0.1
    assert abs(found.log - sampler.results.logz[-1]) < 0.3


def test_evidence_of_a_gaussian_is_its_closed_form():
    """A size that shifts readings: N(y; 0, s^2 + w^2) if its density is N(0, w^2)."""
    prior = gaussian(0.0, 0.3, -50.0, 50.0)
    z = np.linspace(-6.0, 6.0, 2001)
    average = np.trapezoid(stats.norm.pdf(1.0, prior.value(z), 0.5) * stats.norm.pdf(z), z)
    assert average == pytest.approx(stats.norm.pdf(1.0, 0.0, math.hypot(0.3, 0.5)), rel=1e-6)


@pytest.mark.parametrize(
    ("density", "low", "high", "inside"),
    [
        (size(0.0, (0.0, 0.1), 0.0, 0.3), 0.0, 0.1, 0.955),
        (size(0.0, (-0.2, 0.4), -1.0, 1.0), -0.2, 0.4, 0.956),
        (size(2.01, (1.96, 2.06), 1.91, 2.11), 1.96, 2.06, 0.966),
        (even(0.002, 5.0), 0.002, 0.1, 0.5),
    ],
)
def test_densities_hold_what_they_say(density, low, high, inside):
    """Part of the density inside the plausible range; a cut range leaves a little more of it."""
    values = density.quantile((np.arange(20_000) + 0.5) / 20_000)
    assert np.all(np.diff(values) >= 0)
    assert np.mean((values >= low) & (values <= high)) == pytest.approx(inside, abs=0.012)
    assert density.value(np.array([density.z_of(values[6000])]))[0] == pytest.approx(values[6000])


def test_probabilities_and_the_averaged_yield():
    known = LightYieldInput(50.0, 0.1, 0.01)  # a scale of 5 is 1 ph/keV
    at = {(): (0.0, 40.0), ("one",): (3.0, 35.0), ("other",): (2.0, 30.0)}
    evidences = {
        key: Evidence(log, 0.0, {"scale": scale}, {"scale": 1.0}, 1e3)
        for key, (log, scale) in at.items()
    }
    found = weigh(evidences, 2, known)
    odds = np.array([1.0, math.exp(3.0) / 2, math.exp(2.0) / 2])
    p = odds / odds.sum()
    assert list(found.probabilities.values()) == pytest.approx(p)
    values = np.array([8.0, 7.0, 6.0])
    mean = p @ values
    assert found.light_yield.value == pytest.approx(mean)
    assert found.light_yield.between == pytest.approx(math.sqrt(p @ (values - mean) ** 2))
    assert found.light_yield.within == pytest.approx(math.hypot(0.2, 0.1 * mean))
