"""Is a diagnosis as sure of the light yield as it says, through a campaign's simulated responses?

    python scripts/trials calibrated [CAMPAIGN] [--trials 200] [--excess | --traced] [--json FILE]

Simulation-based calibration (S. Talts et al., arXiv:1804.06788): causes, their sizes, coefficients
and offsets are drawn from what a diagnosis takes for known before it sees a reading, and so are
wrong readings, understated errors and what has no name (`rivals`); readings follow by the
campaign's own responses, with their errors, the simulation's and those of the bench's numbers.
Where the truth lies in the diagnosis's distribution is then even from 0 to 1, and causes are there
as often as their probability says. Scattering has no prior, so that a diagnosis takes all between
its bounds for equally likely: it is drawn evenly about that of the fit.

With `--excess` the chi2 that the campaign as it is leaves of the readings, less its degrees of
freedom, is spread evenly to `EXCESS`. With `--traced` it is, too, and readings are the independent
tracer's, of a bench with all that is drawn in it, instead of the responses'.
"""

from __future__ import annotations

import functools
import itertools
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from mcrim_mitsuba.core.files import sha256
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
from trials import formulas, rivals
from trials.executor import Trial, Trials, executor_options
from trials.rivals import Besides, Rivals
from trials.truth import do_missing, drawn_at_last

CAMPAIGN = Path(__file__).resolve().parents[2] / "scenes" / "camoo4_misfit.toml"
#: Least and most of the scattering that is drawn, in parts of the fitted one.
ABOUT = (0.5, 1.5)
#: Parts of the distribution whose coverage is told.
PARTS = (0.5, 0.68, 0.9, 0.95)
#: Ends of the probabilities of causes that are told together.
BINS = (0.0, 0.02, 0.1, 0.3, 0.7, 0.9, 1.0)
#: Draws before one is given up.
_MOST_DRAWS = 10_000
#: Largest excess of chi2 where one is asked for, and parts of it that are drawn in turn.
EXCESS, _STEPS = 670.0, 10
#: Relative error of a traced reading: a third of that of a usual one.
_TRACED_SIGMA = 0.0025


@click.command()
@click.argument("campaign", type=click.Path(exists=True, path_type=Path), default=CAMPAIGN)
@click.option("--trials", "number", default=200, show_default=True, type=options.Whole(1, 10_000))
@click.option("--photons", type=options.Whole(1), help="Of a simulation; default: as `diagnose`.")
@click.option("--excess", is_flag=True, help="Spread the excess of chi2 evenly.")
@click.option("--traced", is_flag=True, help="That, with the tracer's readings.")
@options.seed
@options.json_output
@executor_options
def main(
    campaign: Path,
    number: int,
    photons: int | None,
    excess: bool,
    traced: bool,
    seed: int,
    json_file: str | None,
    executor,
    log: str | None,
) -> int:
    """Are probabilities of causes and of the light yield those of draws from the prior?"""
    screen = terminal.console(json_file)
    wanted = [Trial("drawn", n) for n in range(number)]
    code = [Path(__file__), Path(formulas.__file__), Path(rivals.__file__)]
    # a campaign that was edited, or lies elsewhere under the same name, is another one
    read = sorted({path.resolve() for path in mcrim.read_campaign(campaign).files})
    of = [f"{path.name} {sha256(path.read_bytes())}" for path in read]
    what = {"campaign": of, "photons": photons, "traced": traced, "seed": seed}
    what |= {"excess": excess or traced}
    trials = Trials("calibrated", what, wanted, code, executor)
    arguments = {
        t: (str(campaign), photons, traced, excess, t.number, seed) for t in trials.missing
    }
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
            # a campaign's causes stand for each other, so that campaigns are what is independent;
            # where all are there, or none is, their scatter tells nothing, but chance does
            over, chance = ((there - said) * at).sum(axis=1), (said * (1.0 - said))[at].sum()
            alike = there[at].all() or not there[at].any()
            error = math.sqrt(chance if alike else np.square(over).sum())
            cells = (f"{100 * low:g} to {100 * high:g} %", f"{at.sum()}", f"{said[at].sum():.1f}")
            off = f"{over.sum() / error:+.1f}" if error else ""
            rows.append((*cells, f"{there[at].sum()}", off))
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


def weigh_one(
    path: str, photons: int | None, traced: bool, excess: bool, number: int, seed: int
) -> dict:
    """Draw a campaign from the prior, weigh all hypotheses, and score what is said of it."""
    models, effects, baseline = simulated(path, photons)
    explanations = Explanations(models.model, effects, baseline)
    rivals, rng = Rivals(explanations), np.random.default_rng([seed, number])
    step = number % _STEPS if traced or excess else None

    def draw() -> tuple[Truth, Campaign] | None:
        truth = _drawn_truth(explanations, rivals, rng, nothing=not step)
        if truth is None:
            return None
        campaign = _drawn_readings(explanations, models, truth, rng, step, traced)
        return None if campaign is None else (truth, campaign)

    truth, campaign = drawn_at_last(draw, _MOST_DRAWS, f"draw {number}: no readings as wanted")
    judged = judge(replace(models, campaign=campaign).model, effects)
    if judged.judgement is None:
        raise RuntimeError(f"draw {number}: nothing to judge")
    judgement, fitted = judged.judgement, judged.fit.minimum.values[SCALE]

    def said(cause: str) -> float:
        return judgement.weighing.probability(lambda hypothesis: cause in hypothesis.causes)

    return {
        "hidden": [*truth.effects, *truth.besides.names],
        "chi2": judged.fit.minimum.chi2,
        "chi2_of_truth": judged.explanations.fit(truth.effects).chi2,
        "verdict": judgement.verdict.word,
        "said": {cause: said(cause) for cause in (*effects, *rivals.names)},
        **formulas.scores(judgement, math.log(truth.values[SCALE] / fitted)),
    }


# ---- one draw ----


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What a bench hides."""

    effects: tuple[str, ...]
    besides: Besides
    #: Of all free parameters, by name.
    values: dict[str, float]


def _drawn_truth(
    explanations: Explanations, rivals: Rivals, rng: np.random.Generator, *, nothing: bool
) -> Truth | None:
    """Causes and their sizes; None of sets that are not weighed, and of `nothing` unless wanted."""
    besides = rivals.drawn(rng)
    drawn = (n for n in explanations.effects if rng.random() < expit(explanations.log_odds([n])))
    hidden = tuple(sorted(drawn))  # as models have them: their parameters are in that order
    if len(hidden) > besides.most_effects or not explanations.possible(hidden):
        return None
    if not nothing and not hidden and not besides.names:
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
    return Truth(effects=hidden, besides=besides, values=values | statistic.values(theta))


def _drawn_readings(
    explanations: Explanations,
    models: CampaignModels,
    truth: Truth,
    rng: np.random.Generator,
    step: int | None,
    traced: bool,
) -> Campaign | None:
    """The campaign with readings of a truth; None where it will not do.

    A `step` is asked of the excess of readings with all their errors: no diagnosis sees that of
    the truth without them, and draws chosen by it would not be those of its prior any more.
    """
    of_these, besides = explanations.statistic(truth.effects), truth.besides
    theta = of_these.theta(truth.values)
    prediction = of_these.model.predict(theta)
    if not np.all(prediction.signal > 0.0):
        return None
    rows, used = models.campaign.measurements.readings, of_these.used
    sigma = prediction.signal * [row.sigma / row.signal for row in rows]
    plain = _with_readings(models.campaign, prediction.signal, sigma)
    errors = Statistic(replace(models, campaign=plain).model(truth.effects)).errors_at(theta)
    signal = prediction.signal[used]
    own = besides.errors(errors.readings / np.outer(signal, signal))
    numbers = rng.standard_normal(len(signal))
    of_model = errors.predicted @ rng.standard_normal(errors.predicted.shape[1]) / signal
    away = np.linalg.cholesky(own) @ numbers + of_model
    campaign = _written(plain, besides, prediction.signal, away)
    if campaign is None:
        return None
    if step is not None:
        fit = find_minima(Statistic(replace(models, campaign=campaign).model()))[0]
        if not step <= _STEPS * max(fit.chi2 - fit.ndf, 0.0) / EXCESS < step + 1:
            return None
    if not traced:
        return campaign
    found = _traced(models, truth, theta, prediction.eta, rng)
    if found is None:
        return None
    signal, of_tracer = found
    own -= np.diag(np.minimum(of_tracer[used] ** 2, 0.9 * np.diag(own)))
    return _written(plain, besides, signal, np.linalg.cholesky(own) @ numbers)


def _traced(
    models: CampaignModels,
    truth: Truth,
    theta: Array,
    eta: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array] | None:
    """(readings,) signals by the tracer, the bench's numbers off as tolerances say; and errors.

    Errors are relative. `eta` says how many photons it takes. None of a bench that cannot be.
    """
    campaign, values = models.campaign.with_effects(truth.effects), truth.values
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
    everything = frozenset([*campaign.effects, *campaign.parameters])
    anchor = Anchor(everything, values, np.array(log_eta), np.zeros((BATCHES, len(eta))))
    signal = models.model_of(campaign, anchor).predict(theta).signal
    return signal, np.array(errors)


def _written(plain: Campaign, besides: Besides, signal: Array, away: Array) -> Campaign | None:
    """A campaign with readings of these signals, as they are written down.

    `away`, (used,), are relative errors of those in use; stated errors go where their readings go.
    None where a reading is not positive.
    """
    rows = plain.measurements.readings
    used = np.array([row.use for row in rows])
    signal = signal.copy()
    signal[used] *= np.exp(besides.discrepancy) * (1.0 + away)
    sigma = signal * [row.sigma / row.signal for row in rows]
    signal[used], sigma[used] = besides.exchanged(signal[used]), besides.exchanged(sigma[used])
    return _with_readings(plain, signal, sigma) if np.all(signal > 0.0) else None


def _with_readings(campaign: Campaign, signal: Array, sigma: Array) -> Campaign:
    """The campaign with other readings, and their errors."""
    rows = campaign.measurements.readings
    readings = [
        replace(row, signal=light, sigma=error)
        for row, light, error in zip(rows, signal.tolist(), sigma.tolist(), strict=True)
    ]
    return replace(campaign, measurements=campaign.measurements.with_readings(readings))
