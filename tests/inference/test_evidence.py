"""Evidence: averages over plausible sizes, against plain averages and closed forms."""

import itertools
import math

import numpy as np
import pytest
from places import cases_of
from scipy import special, stats
from trials import formula_bench as bench

import mcrim_mitsuba
from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.inference.evidence import even, evidence_of, gaussian, size
from mcrim_mitsuba.inference.weighing import Hypothesis, Weighing

cases = cases_of(__file__)

TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}


def explanations(sigma):
    """Of a campaign with a bubble of moderate size, read to this precision."""
    rng = np.random.default_rng(7)
    signal = bench.signals({**TRUTH, "bubble_fraction": 0.04})
    signal = signal * (1.0 + sigma * rng.standard_normal(len(signal)))
    rows, noise = bench.readings(signal, sigma), bench.simulation_noise(7)
    return bench.explanations_of(
        lambda added: bench.Model(rows, tuple(added), noise), bench.EFFECTS
    )


def log_likelihood(fit, priors):
    """Of (points, free) standard normal numbers, written anew."""

    def of_normals(z):
        columns = [priors[name].value(z[:, i]) for i, name in enumerate(fit.names)]
        statistic = fit.statistic
        predicted = statistic.model.predict_many(np.stack(columns, axis=1))[:, statistic.used]
        residuals = fit.weights.whiten(statistic.signal - predicted)
        return -0.5 * ((residuals**2).sum(1) + fit.weights.log_determinant)

    return of_normals


@pytest.fixture(scope="module")
def rough():
    """Readings of 6 %: of points that are drawn from the priors many count."""
    return explanations(0.06)


@cases("effects")
def test_evidence_is_the_average_over_the_priors(rough, effects):
    """To 0.1 in the logarithm, by 262,144 even points, of which several hundred count."""
    fit, priors = rough.fit(effects), rough.priors(effects)
    # a scale that is known to a factor of two either way, not 30: more of the points count
    priors["scale"] = even(0.5 * fit.values["scale"], 2.0 * fit.values["scale"])
    found = evidence_of(fit, priors)
    even_points = stats.qmc.Sobol(len(fit.names), seed=1).random_base2(18)
    logs = log_likelihood(fit, priors)(np.clip(special.ndtri(even_points), -8.0, 8.0))
    average = special.logsumexp(logs) - math.log(len(logs))
    counting = math.exp(2.0 * special.logsumexp(logs) - special.logsumexp(2.0 * logs))
    assert counting > 300
    assert found.log_sigma < 0.1
    assert abs(found.log - average) < 0.1


def test_few_points_tell_what_matters_little():
    """Nine effects, which few points are the worst at, and their pairs: the logarithm's error."""
    models = explanations(bench.SIGMA)
    names = "anisotropic_scattering background detector_angle detector_reflection edge_chamfer"
    names += " gap_bubble nonlinearity surface_absorption top_reflector"
    differences, again = [], 0
    singles = [(name,) for name in names.split()]
    for effects in singles + list(itertools.combinations(names.split(), 2)):
        fit, priors = models.fit(effects), models.priors(effects)
        few, all_points = (evidence_of(fit, priors, rough=how) for how in (True, False))
        differences.append(few.log - all_points.log)
        again += few.log == all_points.log
        assert few.log_sigma < 0.3 or few.log_sigma == all_points.log_sigma
    assert 0 < again < 10  # that few are not enough is seen
    assert np.abs(differences).max() < 0.8
    assert np.sqrt(np.mean(np.square(differences))) < 0.25


@pytest.mark.parametrize("effects", [(), ("gap_bubble",), ("background",)])
def test_evidence_of_precise_readings_is_that_of_a_fine_grid(effects):
    """Readings of 0.7 %, with the priors that a diagnosis has."""
    precise = explanations(bench.SIGMA)
    found = precise.evidence(effects)
    fit, priors = precise.fit(effects), precise.priors(effects)
    logarithm = log_likelihood(fit, priors)

    def height(z):
        return logarithm(z) - 0.5 * (z**2).sum(1) - 0.5 * z.shape[1] * math.log(2.0 * math.pi)

    # axes along which the readings are about equally sensitive, by a rough cloud that is weighted
    centre = np.array([priors[name].z_of(value) for name, value in fit.values.items()])
    factor = 0.1 * np.eye(len(centre))
    rng = np.random.default_rng(1)
    for _ in range(6):
        away = rng.standard_normal((4000, len(centre)))
        z = centre + 1.5 * away @ factor.T
        weight = special.softmax(height(z) + 0.5 * (away**2).sum(1))
        centre = weight @ z
        covariance = (weight * (z - centre).T) @ (z - centre)
        factor = np.linalg.cholesky(covariance + 1e-8 * np.eye(len(centre)))
    axis = np.linspace(-7.0, 7.0, 19)
    logs = [
        height(
            centre
            + np.stack(np.meshgrid([first], *[axis] * (len(centre) - 1)), -1).reshape(
                -1, len(centre)
            )
            @ factor.T
        )
        for first in axis
    ]
    cell = (axis[1] - axis[0]) ** len(centre) * np.prod(np.diag(factor))
    assert found.log == pytest.approx(special.logsumexp(logs) + math.log(cell), abs=0.1)


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
        # of a mean below its bounds, whose far end was infinite
        (gaussian(-0.02, 0.012, 0.0, 0.3), 0.0, 0.01, 0.87),
    ],
)
def test_densities_hold_what_they_say(density, low, high, inside):
    """Part of the density inside the plausible range; a cut range leaves a little more of it."""
    values = density.quantile((np.arange(20_000) + 0.5) / 20_000)
    assert np.all(np.diff(values) >= 0)
    assert np.mean((values >= low) & (values <= high)) == pytest.approx(inside, abs=0.012)
    assert density.value(np.array([density.z_of(values[6000])]))[0] == pytest.approx(values[6000])
    assert np.isfinite(density.value(np.array([-40.0, 40.0]))).all()


def weighing(hypotheses):
    """Some hypotheses by their weights."""
    hypotheses = tuple(hypotheses)
    return Weighing(
        hypotheses=hypotheses,
        shares=special.softmax([hypothesis.log_weight for hypothesis in hypotheses]),
        inclusion={},
        families={},
        closed_part=0.0,
        closed_error=0.0,
        moving=0.0,
        p_value=0.5,
        design=None,
    )


def test_the_averaged_yield_is_the_mixtures():
    known = LightYieldInput(50.0, 0.1, 0.01)  # a scale of 5 is 1 ph/keV
    scales, sigmas = np.array([40.0, 35.0, 30.0]), np.array([0.025, 0.03, 0.05])
    weighed = weighing(
        Hypothesis(
            effects=effects,
            besides=besides,
            amplitude=0.1 * bool(besides),
            log_weight=log,
            log_scale=math.log(scale / 40.0),
            log_scale_sigma=sigma,
        )
        for effects, besides, log, scale, sigma in zip(
            ((), ("one",), ("other",)),
            ((), (), ("unknown",)),
            (0.0, 2.0, 1.5),
            scales,
            sigmas,
            strict=True,
        )
    )
    assert [hypothesis.name for hypothesis in weighed.hypotheses] == [
        "none",
        "one",
        "other + unknown",
    ]
    p = special.softmax([0.0, 2.0, 1.5])
    assert weighed.probability(lambda h: bool(h.effects)) == pytest.approx(p[1] + p[2])
    averaged = weighed.light_yield(known, 40.0)
    # the median and the intervals that hold 68 and 95 %, by drawing; its parts as the variances are
    rng = np.random.default_rng(4)
    model = rng.choice(3, 400_000, p=p)
    widths = np.hypot(sigmas, 0.1)
    logs = np.log(scales / 5.0)
    drawn = np.exp(logs[model] + widths[model] * rng.standard_normal(len(model)))
    ends = np.quantile(drawn, [0.025, 0.159, 0.5, 0.841, 0.975])
    assert ends == pytest.approx(
        [averaged.lower_95, averaged.lower, averaged.value, averaged.upper, averaged.upper_95],
        rel=4e-3,
    )
    assert averaged.sigma == pytest.approx(0.5 * (ends[3] - ends[1]), rel=5e-3)
    away = (logs - p @ logs) ** 2
    variances = np.array(
        [
            p[:2] @ sigmas[:2] ** 2 + 0.01,  # the efficiency's error with it
            p[:2] @ away[:2],
            p[2] * (sigmas[2] ** 2 + away[2]),
        ]
    )
    parts = np.sqrt(variances)
    parts *= averaged.sigma / np.linalg.norm(parts)
    assert parts == pytest.approx([averaged.within, averaged.between, averaged.catalogue], rel=5e-3)


def test_an_unlikely_model_far_away_is_no_error():
    """One in fifty is off by half: the standard deviation would be seven times the likely one."""

    def light_yield(log):
        return weighing(
            Hypothesis(log_weight=at, log_scale=math.log(scale / 40.0), log_scale_sigma=0.01)
            for at, scale in ((0.0, 40.0), (log, 20.0))
        ).light_yield(LightYieldInput(50.0, 0.1, 0.0), 40.0)

    alone = light_yield(-50.0)
    assert alone.sigma == pytest.approx(0.08, rel=2e-3)
    assert light_yield(math.log(0.02)).sigma < 1.2 * alone.sigma
    # the interval that holds 95 % knows of it where it is as likely as one in eleven
    unsure = light_yield(math.log(0.1))
    assert unsure.lower_95 < 4.2 and unsure.upper_95 < 8.3


def test_a_model_without_free_parameters_is_its_likelihood(scenes):
    """The article's Table 1 has none: all is held, or a column."""
    found = mcrim_mitsuba.diagnose(
        scenes / "camoo4_table1.toml", only="gap_thickness", photons=20_000
    )
    assert found.probabilities.keys() >= {"none", "wrong:gap_mm"}
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
