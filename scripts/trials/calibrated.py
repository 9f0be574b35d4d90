"""Is a diagnosis as sure of the light yield as it says, through a campaign's simulated responses?

    python scripts/trials calibrated [CAMPAIGN] [--trials 200] [--traced] [--json FILE]

Simulation-based calibration (S. Talts et al., arXiv:1804.06788): causes, their sizes, coefficients
and offsets are drawn from what a diagnosis takes for known before it sees a reading; readings
follow by the campaign's own responses, with their errors, the simulation's and those of the bench's
numbers. Where the truth lies in the diagnosis's distribution is then even from 0 to 1, and causes
are there as often as their probability says. Scattering has no prior, so that a diagnosis takes all
between its bounds for equally likely: it is drawn evenly about that of the fit. Readings are wrong
in no draw, though a diagnosis expects some.

`--traced` readings are the independent tracer's, of a bench with all that is drawn in it, instead
of the responses'; what is drawn then leaves an excess of chi2 that is spread evenly to `EXCESS`.
"""

from __future__ import annotations

import functools
import itertools
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from scipy.special import expit
from scipy.stats import kstest
from shared import fraction_error

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.campaign.campaign import Campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_SCAT
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.efficiency.eta_grid import BATCHES
from mcrim_mitsuba.efficiency.response_maker import ResponseMaker
from mcrim_mitsuba.efficiency.responses import Anchor
from mcrim_mitsuba.inference.diagnose import judge
from mcrim_mitsuba.inference.drivers import Minimum, find_minima
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.judgement import ADEQUATE
from mcrim_mitsuba.inference.simulations import CampaignModels, CampaignSimulations
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.output.description import table
from mcrim_mitsuba.reference.tracer import trace
from trials import formulas
from trials.executor import Trial, Trials, executor_options
from trials.truth import MOST_CAUSES, do_missing, drawn_at_last

CAMPAIGN = Path(__file__).resolve().parents[2] / "scenes" / "camoo4_misfit.toml"
#: Least and most of the scattering that is drawn, in parts of the fitted one.
ABOUT = (0.5, 1.5)
#: Parts of the distribution whose coverage is told.
PARTS = (0.5, 0.68, 0.9, 0.95)
#: Ends of the probabilities of causes that are told together.
BINS = (0.0, 0.02, 0.1, 0.3, 0.7, 0.9, 1.0)
#: Draws before one is given up.
_MOST_DRAWS = 10_000
#: Largest excess of chi2 of traced draws, and parts of it that are drawn in turn.
EXCESS, _STEPS = 670.0, 10
#: Relative error of a traced reading: a third of that of a usual one.
_TRACED_SIGMA = 0.0025


@click.command()
@click.argument("campaign", type=click.Path(exists=True, path_type=Path), default=CAMPAIGN)
@click.option("--trials", "number", default=200, show_default=True, type=options.Whole(1, 10_000))
@click.option("--photons", type=options.Whole(1), help="Of a simulation; default: as `diagnose`.")
@click.option("--traced", is_flag=True, help="Readings of the independent tracer.")
@options.seed
@options.json_output
@executor_options
def main(
    campaign: Path,
    number: int,
    photons: int | None,
    traced: bool,
    seed: int,
    json_file: str | None,
    executor,
    log: str | None,
) -> int:
    """Are probabilities of causes and of the light yield those of draws from the prior?"""
    screen = terminal.console(json_file)
    wanted = [Trial("drawn", n) for n in range(number)]
    code = [Path(__file__), Path(formulas.__file__)]
    what = {"campaign": str(campaign), "photons": photons, "traced": traced, "seed": seed}
    trials = Trials("calibrated", what, wanted, code, executor)
    arguments = {t: (str(campaign), photons, traced, t.number, seed) for t in trials.missing}
    ended = do_missing(screen, "calibrated", trials, weigh_one, arguments, log)
    if ended is not None:
        return ended
    outcomes = [trials.results[trial] for trial in wanted]
    terminal.write_json(json_file, {"trials": outcomes, "seed": seed})
    _show(screen, outcomes)
    return terminal.DONE


def _show(screen: terminal.Screen, outcomes: Sequence[Mapping]) -> None:
    """Coverage, distance from evenness, and how often causes are there."""
    below = np.array([outcome["below"] for outcome in outcomes])
    nothing = np.array([not outcome["hidden"] for outcome in outcomes])
    adequate = np.array([outcome["verdict"] == ADEQUATE for outcome in outcomes])

    def share(hits: Array) -> str:
        if not len(hits):
            return ""
        error = fraction_error(int(hits.sum()), len(hits))
        return f"{100 * hits.mean():.0f} ± {100 * error:.0f} %"

    holds = {f"{100 * p:.0f} % of its distribution": np.abs(below - 0.5) <= 0.5 * p for p in PARTS}
    rows = [(words, share(hits), share(hits[nothing])) for words, hits in holds.items()]
    rows.append(("adequate", share(adequate), share(adequate[nothing])))
    of_none = f"{nothing.sum()} with nothing hidden"
    screen.show(table("hold the light yield", ("", f"{len(below)} draws", of_none), rows))
    distance = kstest(below, "uniform")
    screen.line(
        f"Kolmogorov-Smirnov's distance from evenness {distance.statistic:.3f} "
        f"(p = {distance.pvalue:.2g}; 5 of 100 times above {1.36 / math.sqrt(len(below)):.3f}), "
        f"log density {statistics.mean(o['log_density'] for o in outcomes):.2f}, "
        f"CRPS {100 * statistics.mean(o['crps'] for o in outcomes):.2f} %"
    )
    said = np.array([list(outcome["said"].values()) for outcome in outcomes])
    there = np.array([[n in o["hidden"] for n in o["said"]] for o in outcomes])
    rows = []
    for low, high in itertools.pairwise(BINS):
        at = (said >= low) & ((said < high) | (high == BINS[-1]))
        if at.any():
            # a campaign's causes stand for each other, so that campaigns are what is independent
            over = ((there - said) * at).sum(axis=1)
            cells = (f"{100 * low:g} to {100 * high:g} %", f"{at.sum()}", f"{said[at].sum():.1f}")
            off = over.sum() / math.sqrt(np.square(over).sum())
            rows.append((*cells, f"{there[at].sum()}", f"{off:+.1f}"))
    screen.show(table("causes", ("said", "causes", "sum of it", "there", "errors off"), rows))


@functools.cache
def simulated(path: str, photons: int | None) -> tuple[CampaignModels, dict[str, Effect], Minimum]:
    """What models of a campaign rest on, what may be missing, and its own fit."""
    campaign = mcrim.read_campaign(path)
    defaults = Run() if photons is None else Run(photons=photons)
    simulations = CampaignSimulations(campaign, defaults)
    simulations.simulate()
    baseline = simulations.fit().minimum
    possible = simulations.possible()
    models = simulations.simulate(tuple(possible))
    return models, {n: e for n, e in possible.items() if models.acts(n)}, baseline


def weigh_one(path: str, photons: int | None, traced: bool, number: int, seed: int) -> dict:
    """Draw a campaign from the prior, weigh all hypotheses, and score what is said of it."""
    models, effects, baseline = simulated(path, photons)
    explanations = Explanations(models.model, effects, baseline)
    rng = np.random.default_rng([seed, number])
    step = number % _STEPS if traced else None
    draw = functools.partial(_draw, explanations, models, rng, step)
    drawn = drawn_at_last(draw, _MOST_DRAWS, f"draw {number}: no readings as wanted")
    campaign, hidden, scale = drawn
    judged = judge(replace(models, campaign=campaign).model, effects)
    if judged.judgement is None:
        raise RuntimeError(f"draw {number}: nothing to judge")
    judgement, fitted = judged.judgement, judged.fit.minimum.values[SCALE]
    return {
        "hidden": list(hidden),
        "chi2": judged.fit.minimum.chi2,
        "chi2_of_truth": judged.explanations.fit(hidden).chi2,
        "verdict": judgement.verdict.word,
        "said": {name: judgement.weighing.inclusion.get(name, 0.0) for name in effects},
        **formulas.scores(judgement, math.log(scale / fitted)),
    }


def _draw(
    explanations: Explanations,
    models: CampaignModels,
    rng: np.random.Generator,
    step: int | None,
) -> tuple[Campaign, tuple[str, ...], float] | None:
    """A campaign with readings as drawn, its causes and its scale; None where it will not do.

    With the `step` of an excess readings are traced.
    """
    drawn = (n for n in explanations.effects if rng.random() < expit(explanations.log_odds([n])))
    hidden = tuple(sorted(drawn))  # as models have them: their parameters are in that order
    if len(hidden) > MOST_CAUSES or not explanations.possible(hidden) or (step and not hidden):
        return None
    statistic, values = explanations.statistic(hidden), explanations.baseline.values
    known = explanations.priors(hidden)
    of_effects = {p.name for name in hidden for p in explanations.effects[name].parameters}
    for parameter in statistic.free:
        if parameter.prior is None and parameter.name not in of_effects:
            continue
        value = known[parameter.name].value(rng.standard_normal(1))[0]
        values[parameter.name] = float(np.clip(value, parameter.minimum, parameter.maximum))
    values[ALPHA_SCAT] *= rng.uniform(*ABOUT)
    theta = np.clip(statistic.theta(values), *statistic.bounds)
    signal = statistic.model.predict(theta).signal
    if not np.all(signal > 0.0):
        return None
    plain = _with_signals(models.campaign, signal)
    of_these = Statistic(replace(models, campaign=plain).model(hidden))
    if step is None:
        errors = np.linalg.cholesky(of_these.errors_at(theta).total)
        signal = signal.copy()
        signal[of_these.used] += errors @ rng.standard_normal(len(errors))
    else:
        excess = find_minima(Statistic(replace(models, campaign=plain).model()))[0].chi2
        if not step <= _STEPS * excess / EXCESS < step + 1:
            return None
        eta = of_these.model.predict(theta).eta
        values |= dict(zip(of_these.names, theta.tolist(), strict=True))
        traced = _traced(models, hidden, values, eta, rng)
        if traced is None:
            return None
        log_eta, errors = traced
        campaign = models.campaign.with_effects(hidden)
        everything = frozenset([*campaign.effects, *campaign.parameters])
        anchor = Anchor(everything, values, log_eta, np.zeros((BATCHES, len(eta))))
        signal = models.model_of(campaign, anchor).predict(theta).signal
        sigma = np.array([row.sigma / row.signal for row in plain.measurements.readings])
        rest = np.sqrt(np.maximum(sigma**2 - errors**2, 0.0))
        signal = signal * (1.0 + rest * rng.standard_normal(len(signal)))
    if not np.all(signal > 0.0):
        return None
    return _with_signals(plain, signal), hidden, values[SCALE]


def _traced(
    models: CampaignModels,
    hidden: tuple[str, ...],
    values: Mapping[str, float],
    eta: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array] | None:
    """(readings,) log(eta) by the tracer, the bench's numbers off as tolerances say; and errors.

    `eta` says how many photons it takes. None of a bench that cannot be.
    """
    campaign = models.campaign.with_effects(hidden)
    off = {
        of.number: float(np.clip(of.sigma * rng.standard_normal(), *of.farthest))
        for of in campaign.tolerances
    }
    benches = ResponseMaker(campaign, Run()).benches_with(campaign.switched_on, values)
    log_eta, errors = [], []
    for row, (scene, there), usual in zip(
        campaign.measurements.readings, benches, eta, strict=True
    ):
        own = {**campaign.values, **row.parameters}
        for number, offset in off.items():
            if number.is_of(own):
                there[number.parameter] = float(there[number.parameter]) + offset
        photons = int((1.0 - usual) / usual / _TRACED_SIGMA**2)
        try:
            bench = scene.with_overrides({n: v for n, v in there.items() if n in scene.parameters})
            found = trace(bench, photons, int(rng.integers(2**31)), threads=1)
        except InputError:
            return None
        log_eta.append(math.log(found.eta))
        errors.append(found.eta_sigma / found.eta)
    return np.array(log_eta), np.array(errors)


def _with_signals(campaign: Campaign, signal: Array) -> Campaign:
    """The campaign with other readings, whose relative errors are those of the old ones."""
    rows = campaign.measurements.readings
    readings = [
        replace(row, signal=float(light), sigma=row.sigma / row.signal * float(light))
        for row, light in zip(rows, signal, strict=True)
    ]
    return replace(campaign, measurements=campaign.measurements.with_readings(readings))
