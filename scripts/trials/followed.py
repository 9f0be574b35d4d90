"""Is the light yield's error after the next measurement what was promised?

    python scripts/trials followed [--trials 60] [--any] [--json FILE]

On the bench in formulas causes, their sizes, coefficients and errors are drawn from what a
diagnosis takes for known. Of eight readings it says what to measure next, of four further
configurations, readings once more and numbers again; that is done, and diagnosed. A look is
promised no error of a light yield that could be drawn, and is passed over. The place of the error
that is left among those of the promised outcomes is even from 0 to 1 where promises are honest.
What is proposed first is what promises most, so that it keeps a little less; with `--any` one of
all that is proposed is done.
"""

from __future__ import annotations

import functools
import math
import statistics
from pathlib import Path
from unittest.mock import patch

import click
import numpy as np
from scipy.special import expit
from scipy.stats import kstest

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.inference import next_measurements as advice
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.output.description import table
from trials import formula_bench as bench
from trials.executor import Trial, Trials, executor_options
from trials.truth import (
    MOST_CAUSES,
    TRUE_ALPHA_SCAT_PER_CM,
    do_missing,
    draw_absorption_and_scale,
    drawn_at_last,
)

#: Readings that there are, and further ones that can be built.
FIRST, FURTHER = 8, 4
#: Draws before one is given up.
_MOST_DRAWS = 300


@click.command()
@click.option("--trials", "number", default=60, show_default=True, type=options.Whole(1, 10_000))
@click.option("--any", "of_all", is_flag=True, help="One of all proposals, not the first.")
@options.seed
@options.json_output
@executor_options
def main(number: int, of_all: bool, seed: int, json_file: str | None, executor, log: str | None):
    """Is an error after the next measurement as promised?"""
    screen = terminal.console(json_file)
    wanted = [Trial("followed", n) for n in range(number)]
    code = [Path(__file__), Path(bench.__file__)]
    trials = Trials("followed", {"seed": seed, "any": of_all}, wanted, code, executor)
    arguments = {trial: (trial.number, seed, of_all) for trial in trials.missing}
    ended = do_missing(screen, "followed", trials, follow, arguments, log)
    if ended is not None:
        return ended
    outcomes = [found for trial in wanted if (found := trials.results[trial])]
    terminal.write_json(json_file, {"trials": outcomes, "seed": seed})
    places, gained, promised = (
        [found[name] for found in outcomes] for name in ("place", "gained", "promised")
    )
    counts, _ = np.histogram(places, 5, (0.0, 1.0))
    distance = kstest(places, "uniform")
    rows = [
        ("ln(error) falls by", f"{statistics.mean(gained):.3f}"),
        ("promised, mean of the outcomes", f"{statistics.mean(promised):.3f}"),
        ("places among the outcomes, in fifths", " ".join(map(str, counts))),
        ("distance from evenness", f"{distance.statistic:.3f} (p = {distance.pvalue:.2g})"),
        ("above it in 5 of 100 cases", f"{1.36 / math.sqrt(len(outcomes)):.3f}"),
    ]
    screen.show(table("what is left", ("", f"{len(outcomes)} campaigns"), rows))
    return terminal.DONE


def follow(number: int, seed: int, of_all: bool) -> dict:
    """Draw a campaign, do what is proposed, and tell what came of it; empty if only looks are."""
    rng = np.random.default_rng([seed, number])
    words = f"campaign {number}: no readings as wanted"
    drawn = drawn_at_last(functools.partial(_draw, rng), _MOST_DRAWS, words)
    values, hidden, first, further = drawn
    made = {"values": values, "effects": hidden, "known": tuple(bench.EFFECTS)}
    made |= {"rows": first, "seed": int(rng.integers(2**31))}
    campaign = bench.Followed(**made)
    before = campaign.judged()
    # what is public of outcomes are their median and how many are near it
    outcomes, kept = {}, advice._most_kept

    def listen(errors: np.ndarray) -> tuple[float, float, float | None]:
        told = kept(errors)
        outcomes[told] = np.asarray(errors)
        return told

    with patch.object(advice, "_most_kept", listen):
        proposed = advice.next_measurements(before, campaign.proposals(further))
    proposed = [one for one in proposed if advice.LOOK not in one.kind]
    if not proposed:
        return {}
    one = proposed[int(rng.integers(len(proposed))) if of_all else 0]
    promise = one.light_yield_sigma, one.light_yield_kept, one.light_yield_sigma_otherwise
    errors = np.sort(outcomes[promise])
    more = tuple(bench.ROWS.index(row) for row in (one.parameters, one.also) if row)
    after = bench.Followed(**made, more=more, numbers=1 + one.kind.count(advice.NUMBER))
    now, then = _error(before), _error(after.judged())
    # of equal ones the middle
    place = sum(np.searchsorted(errors, then, side) for side in ("left", "right")) / 2
    return {
        "hidden": list(hidden),
        "kind": one.kind,
        "place": float(place / len(errors)),
        "gained": math.log(now / then),
        # an outcome at which a single point is left has no error
        "promised": float(np.mean(np.log(now / np.maximum(errors, 0.1 * errors.max())))),
    }


def _error(judged: Judgement) -> float:
    """Relative error of the light yield."""
    light = judged.light_yield
    assert light is not None
    return light.sigma / light.value


def _draw(rng: np.random.Generator):
    """Values, causes, rows and further rows of a campaign; None where it will not do."""
    scattering = float(np.exp(rng.uniform(*np.log(TRUE_ALPHA_SCAT_PER_CM))))
    absorption, scale = draw_absorption_and_scale(rng)
    values = {"alpha_scat_per_cm": scattering, "alpha_abs_per_cm": absorption, "scale": scale}
    every = tuple(range(len(bench.ROWS)))
    explanations = bench.explanations_of(
        bench.Followed(values, (), (), every).models, bench.EFFECTS
    )
    odds = ((n, explanations.log_odds([n])) for n in bench.EFFECTS)
    hidden = tuple(n for n, log_odds in odds if rng.random() < expit(log_odds))
    if len(hidden) > MOST_CAUSES or not explanations.possible(hidden):
        return None
    values |= bench.sizes(explanations, hidden, rng)
    signal = bench.signals(values, hidden)
    if not np.all(np.isfinite(signal) & (signal > 0.0)):
        return None
    first, further = np.split(rng.permutation(every)[: FIRST + FURTHER], [FIRST])
    return values, hidden, tuple(np.sort(first).tolist()), tuple(further.tolist())
