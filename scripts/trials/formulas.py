"""Are diagnoses of a bench in formulas as sure as they say? Hundreds of campaigns in minutes.

    python scripts/trials formulas [--trials 60] [--kind withheld] [--json FILE]

Truths and sizes are drawn from what is known of them beforehand, such that what is hidden leaves an
excess chi2 of 40 to 670, or 10 at least where errors are 3 %; there is nothing to simulate. Scores
of the averaged light yield are those of its whole distribution: log density and continuous ranked
probability score (T. Gneiting and A. E. Raftery, J. Am. Stat. Assoc. 102 (2007) 359), both of
ln(yield).

Kinds: what is hidden is one effect (known, or withheld from the catalogue), two or three, nothing,
one to three readings that are 7 % off, errors stated two times too small; or one effect is in
readings of 3 %, in six readings, or in forty.
"""

from __future__ import annotations

import functools
import math
import statistics
import time
from pathlib import Path

import click
import numpy as np
from scipy.special import ndtr
from shared import fraction_error

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.inference.weighing import weigh_hypotheses
from mcrim_mitsuba.output.description import table
from trials import formula_bench as bench
from trials.executor import Trial, Trials, executor_options
from trials.truth import do_missing, drawn_at_last

KINDS = "known withheld pairs triples nothing wrong understated coarse six forty".split()
#: Least and most of it; the least of readings whose errors hide more.
EXCESS, LEAST = (40.0, 670.0), {"coarse": 10.0}
#: Relative error of a reading, by kind.
SIGMA = {"coarse": 0.03}
_MOST_DRAWS = 300


@click.command()
@click.option("--trials", "number", default=60, show_default=True, type=options.Whole(1, 10_000))
@click.option("--kind", "kinds", type=click.Choice([*KINDS, "all"]), multiple=True, default=["all"])
@options.seed
@options.json_output
@executor_options
def main(number: int, kinds: tuple[str, ...], seed: int, json_file: str | None, executor, log):
    """Coverage, scores and names, kind by kind."""
    screen = terminal.console(json_file)
    kinds = KINDS if "all" in kinds else kinds
    wanted = [Trial(kind, n) for kind in kinds for n in range(number)]
    code = [Path(__file__), Path(bench.__file__)]
    trials = Trials("formulas", {"seed": seed}, wanted, code, executor)
    arguments = {trial: (trial.kind, trial.number, seed) for trial in trials.missing}
    ended = do_missing(screen, "formulas", trials, weigh_one, arguments, log)
    if ended is not None:
        return ended
    found = {kind: [trials.results[t] for t in wanted if t.kind == kind] for kind in kinds}
    terminal.write_json(json_file, {"trials": found, "seed": seed})
    head = "hidden|in 68 %|in 95 %|half widths|log density|CRPS, %|first|adequate|named|seconds"
    rows = [(kind, *_scores(results)) for kind, results in found.items()]
    screen.show(table(f"{number} campaigns each", head.split("|"), rows))
    pairs = [pair for results in found.values() for result in results for pair in result["closed"]]
    if pairs:
        odds, yields = (statistics.median(abs(pair[i]) for pair in pairs) for i in (0, 1))
        screen.line(
            f"closed form against evidence, {len(pairs)} sets: median difference of ln(odds) "
            f"{odds:.2f}, of ln(yield) {yields:.2f} of its errors"
        )
    return terminal.DONE


def _scores(results: list[dict]) -> tuple[str, ...]:
    """A row of the table."""

    def share(name: str) -> str:
        hits = [result[name] for result in results if result[name] is not None]
        if not hits:
            return ""
        rate = sum(hits) / len(hits)
        return f"{100 * rate:.0f} ± {100 * fraction_error(sum(hits), len(hits)):.0f} %"

    def mean(name: str, form: str) -> str:
        return format(statistics.mean(result[name] for result in results), form)

    widths = (statistics.median(r[name] for r in results) for name in ("half_68", "half_95"))
    return (
        share("in_68"),
        share("in_95"),
        ", ".join(f"{100 * width:.1f} %" for width in widths),
        mean("log_density", ".2f"),
        f"{100 * statistics.mean(result['crps'] for result in results):.2f}",
        share("first"),
        share("adequate"),
        share("named"),
        f"{statistics.median(result['seconds'] for result in results):.1f}",
    )


# ---- one campaign ----


def weigh_one(kind: str, number: int, seed: int) -> dict:
    """Draw a campaign of a kind, weigh all hypotheses, and score what is said of it."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    words = f"{kind} {number}: no draw has the wanted excess"
    drawn = drawn_at_last(functools.partial(_draw, kind, rng), _MOST_DRAWS, words)
    models, hidden, scale, spoiled = drawn
    known = {n: e for n, e in bench.EFFECTS.items() if kind != "withheld" or n not in hidden}
    began = time.perf_counter()
    baseline = find_minima(Statistic(models(())))[0]
    explanations = Explanations(models, known, baseline)
    null = NullDistribution(explanations, explanations.singles())
    weighing = weigh_hypotheses(explanations, null)
    judge = Judgement(explanations, null, weighing)
    light = judge.light_yield
    seconds = time.perf_counter() - began
    true = bench.LIGHT.per_scale * scale
    names = [name for name in judge.probabilities if name not in ("none", "unknown", "others")]
    first = set(names[0].split(" + ")) if names else set()
    wanted = set(hidden) | {f"bad reading row{row + 1}" for row in spoiled}
    verdict = judge.verdict
    return {
        "in_68": bool(light.lower <= true <= light.upper),
        "in_95": bool(light.lower_95 <= true <= light.upper_95),
        "half_68": 0.5 * (light.upper - light.lower) / true,
        "half_95": 0.5 * (light.upper_95 - light.lower_95) / true,
        **scores(judge, math.log(scale / baseline.values["scale"])),
        # of several causes one may hide all others
        "first": bool(first) and first <= wanted if wanted and kind != "withheld" else None,
        "adequate": verdict.word == "adequate",
        "named": verdict.word == "missing_effect" if hidden else None,
        "seconds": seconds,
        "closed": _closed_against_full(weighing, weigh_hypotheses(explanations, null, closed=True)),
    }


def _draw(kind: str, rng: np.random.Generator):
    """Models, what is hidden, the scale and wrong rows of a campaign; None where it will not do."""
    sigma = SIGMA.get(kind, bench.SIGMA)
    counts = {"pairs": 2, "triples": 3, "nothing": 0, "wrong": 0, "understated": 0}
    scale = float(rng.uniform(20.0, 60.0))
    truth = {
        "alpha_scat_per_cm": float(np.exp(rng.uniform(*np.log([0.15, 1.2])))),
        "alpha_abs_per_cm": float(rng.uniform(0.027, 0.051)),
        "scale": scale,
    }
    hidden = tuple(rng.choice(list(bench.EFFECTS), counts.get(kind, 1), replace=False).tolist())
    used = np.arange(len(bench.ROWS))
    if kind == "six":
        used = np.sort(rng.choice(used, 6, replace=False))
    if kind == "forty":
        used = np.sort(rng.integers(0, len(bench.ROWS), 40))
    prior = truth["alpha_abs_per_cm"] + bench.PRIOR_SIGMA * float(rng.standard_normal())
    if prior <= 0.002:
        return None
    noise = bench.simulation_noise(int(rng.integers(2**31)))

    def models_of(signal: np.ndarray, absorption: float):
        rows = bench.readings_of(used, signal, sigma)
        return lambda added: bench.Model(rows, tuple(added), noise, absorption, bench.LIGHT)

    plain = bench.signals(truth)[used]
    explanations = bench.explanations_of(models_of(plain, truth["alpha_abs_per_cm"]), bench.EFFECTS)
    values = dict(truth)
    for name in hidden:
        if not explanations.possible((name,)):
            return None
        values |= bench.sizes(explanations, (name,), rng)
    signal = bench.signals(values, hidden)[used]
    if not np.all(np.isfinite(signal) & (signal > 0.0)):
        return None
    if hidden:
        fit = find_minima(Statistic(models_of(signal, truth["alpha_abs_per_cm"])(())))[0]
        if not LEAST.get(kind, EXCESS[0]) <= fit.chi2 <= EXCESS[1]:
            return None
    spoiled: list[int] = []
    if kind == "wrong":
        spoiled = rng.choice(len(used), int(rng.integers(1, 4)), replace=False).tolist()
        signal[spoiled] *= 1.0 + 0.07 * rng.choice([-1.0, 1.0], len(spoiled))
    real = 2.0 * sigma if kind == "understated" else sigma
    signal = signal * (1.0 + real * rng.standard_normal(len(signal)))
    return models_of(signal, prior), hidden, scale, spoiled


def scores(judge: Judgement, log_scale: float) -> dict[str, float]:
    """What the distribution of ln(yield) makes of the truth, which is over that of the fit.

    Its log density there, its continuous ranked probability score, and its probability below.
    """
    weighing = judge.weighing
    shares, means, sigmas = weighing.mixture
    sigmas = weighing.widening[0] * sigmas
    densities = np.exp(-0.5 * ((log_scale - means) / sigmas) ** 2) / sigmas / math.sqrt(2 * math.pi)
    at = np.linspace(
        *(f(log_scale, *means) + s * 9 * sigmas.max() for f, s in ((min, -1), (max, 1))), 4001
    )
    below = ndtr((at[:, None] - means) / sigmas) @ shares
    return {
        "log_density": float(np.log(shares @ densities + 1e-300)),
        "crps": float(np.trapezoid((below - (at >= log_scale)) ** 2, at)),
        "below": float(ndtr((log_scale - means) / sigmas) @ shares),
    }


def _closed_against_full(full, closed) -> list[tuple[float, float]]:
    """Differences of ln(odds) and, in errors, of ln(yield), of sets that are likely by evidence."""
    own = {
        (h.name, h.amplitude): (h, p) for h, p in zip(closed.hypotheses, closed.shares, strict=True)
    }
    top = full.hypotheses[0]
    first = own.get((top.name, top.amplitude))
    pairs = []
    for hypothesis, share in zip(full.hypotheses[1:], full.shares[1:].tolist(), strict=True):
        other = own.get((hypothesis.name, hypothesis.amplitude))
        if hypothesis.evidence is None or other is None or first is None or share < 0.01:
            continue
        odds = math.log(share / full.shares[0]) - math.log(other[1] / first[1])
        away = (hypothesis.log_scale - other[0].log_scale) / hypothesis.log_scale_sigma
        pairs.append((odds, away))
    return pairs
