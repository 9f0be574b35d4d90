"""What two effects do together, by their responses, against simulations with both in the scene.

    python scripts/validate/pairs.py [--pairs 40] [--seed 11]

Pairs of the catalogue's effects and their sizes are drawn at random, on the misfit's bench. Told is
how far eta is off, in chi2 of its 16 readings with their errors: where responses of single effects
are added, where both are simulated together at one size of each with few photons, as a diagnosis
does at first, and as it does with likely pairs. The simulations' own errors are in it; what they
make of chi2 is told beside.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from shared import SCENE

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.response_maker import EFFECT_PHOTONS, ResponseMaker
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.simulations import CampaignSimulations
from mcrim_mitsuba.output.description import table

WAYS = ("added", "at one size", "in full")


def compare(
    simulations: CampaignSimulations, names: Sequence[str], random: np.random.Generator
) -> list[tuple[float, float]] | None:
    """Of each of `WAYS` chi2, and what the simulations' errors make of it; None if none can be."""
    campaign, baseline = simulations.campaign, simulations.fit().minimum
    pair = tuple(sorted(random.choice(names, 2, replace=False).tolist()))
    possible = simulations.possible()
    explanations = Explanations(simulations.models.model, possible, baseline)
    if not explanations.possible(pair):
        return None
    name, all_effects = " + ".join(pair), tuple(possible)
    looks = [(all_effects, ()), ((*all_effects, name), {name}), ((*all_effects, name), ())]
    models = [simulations.simulate(effects, look).model(pair) for effects, look in looks]
    statistic, values = explanations.statistic(pair), baseline.values
    known = explanations.priors(pair)
    sizes = {p.name for effect in pair for p in possible[effect].parameters}
    for free in statistic.free:
        if free.name in sizes:
            size = known[free.name].value(random.normal(size=1))[0]
            values[free.name] = float(np.clip(size, free.minimum, free.maximum))
    theta = np.clip(statistic.theta(values), *statistic.bounds)
    with_both = campaign.with_effects(pair)
    there = values | dict(zip(statistic.names, theta.tolist(), strict=True))
    slow = ResponseMaker(with_both, Run(EFFECT_PHOTONS)).anchor(with_both.switched_on, there)
    batches = len(slow.deviations)
    noise = np.square(slow.deviations).sum(axis=0) / (batches * (batches - 1))
    weight = [(row.signal / row.sigma) ** 2 for row in campaign.measurements.readings]
    found = []
    for model in models:
        fast = model.predict(theta, check=True)
        off = np.square(np.log(fast.eta) - slow.log_eta)
        own = noise + np.square(fast.eta_sigma / fast.eta)
        found.append((float(off @ weight), float(own @ weight)))
    return found


@click.command()
@click.option("--pairs", "count", type=options.Whole(1, 10_000), default=40, show_default=True)
@options.seed
def main(count: int, seed: int) -> int:
    """How far pairs of effects are from the sum of both, and from their own responses."""
    simulations = CampaignSimulations(
        mcrim.read_campaign(SCENE.with_name("camoo4_misfit.toml")), Run()
    )
    possible = simulations.possible()
    models = simulations.simulate(tuple(possible))
    names = [n for n, effect in possible.items() if effect.edit is not None and models.acts(n)]
    random = np.random.default_rng(seed)
    drawn = (compare(simulations, names, random) for _ in range(count))
    told = np.array([found for found in drawn if found is not None])
    rows = []
    for way, of in zip(WAYS, told.swapaxes(0, 1), strict=True):
        quantiles = [f"{q:.0f}" for q in np.quantile(of[:, 0], (0.5, 0.9, 1.0))]
        above, noise = f"{(of[:, 0] > 12).sum()}", f"{np.median(of[:, 1]):.0f}"
        rows.append((way, *quantiles, above, noise))
    columns = ("responses", "chi2: median", "90 %", "largest", "above 12", "of simulations' errors")
    terminal.console(None).show(table(f"{len(told)} pairs of effects", columns, rows))
    return 0


if __name__ == "__main__":
    sys.exit(terminal.run(main, "pairs"))
