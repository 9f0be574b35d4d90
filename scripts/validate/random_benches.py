"""The shipped scenes with random numbers and effects: Mitsuba against the independent tracer.

    python scripts/validate/random_benches.py                   # 200 benches, some 10 minutes
    python scripts/validate/random_benches.py --benches 20 --seed 7

What one effect does beside another, in an order of the two programs' own, is asked nowhere else.
Every fate is compared, and the solution without photons where it knows the bench; right programs
pass in 99 % of such runs (Bonferroni). What a scene or the tracer refuses is counted.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from shared import SCENES, counted

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.effects.catalogue import BUILT_IN, add
from mcrim_mitsuba.effects.effect import Effect
from mcrim_mitsuba.reference.crosscheck import crosscheck
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from validate.judging import FALSE_ALARM

#: Within these the coefficients of the benches lie, in 1/cm.
RANGES_PER_CM = {ALPHA_SCAT: (0.005, 4.0), ALPHA_ABS: (0.002, 0.5)}
#: Effects that are tried at once; many exclude each other, or need what a scene lacks.
MOST_EFFECTS = 5
#: Lengths are off by this factor's logarithm; some stay.
SPREAD = 0.3


@dataclass(frozen=True, kw_only=True)
class RandomBench:
    """What the two programs said of one bench; None where it was refused."""

    number: int
    scene: str
    changed: Mapping[str, Value]
    effects: Mapping[str, Mapping[str, float]]
    p_value: float | None
    #: Of the refusal, or the quantity that is farthest off.
    words: str


def _numbers(scene: SceneFile, random: np.random.Generator) -> dict[str, Value]:
    """Other values of a scene's parameters."""
    changed: dict[str, Value] = {}
    for name, value in scene.parameters.items():
        if name in RANGES_PER_CM:
            low, high = np.log(RANGES_PER_CM[name])
            changed[name] = math.exp(random.uniform(low, high))
        elif name == "n_gap":
            changed[name] = 1.0 if random.random() < 0.3 else random.uniform(1.0, 1.7)
        elif "reflectance" in name:
            changed[name] = random.uniform(0.4, 0.99)
        elif name == "polarization":
            changed[name] = str(random.random() < 0.3).lower()
        elif name.endswith("_mm") and random.random() < 0.6:
            changed[name] = float(value) * math.exp(random.normal(0.0, SPREAD))
        elif name.startswith("n_") and random.random() < 0.5:
            changed[name] = float(value) * random.uniform(0.93, 1.07)
    return {n: v if isinstance(v, str) else float(f"{v:.4g}") for n, v in changed.items()}


def _sizes(effect: Effect, random: np.random.Generator) -> dict[str, float]:
    """Plausible values of an effect's parameters."""
    ends = {p.name: np.nan_to_num(p.plausible, posinf=1e3) for p in effect.parameters}
    return {name: float(f"{random.uniform(*of):.4g}") for name, of in ends.items()}


def compare(number: int, seed: int, photons: int) -> RandomBench:
    """A random bench in both programs."""
    random = np.random.default_rng([seed, number])
    # a beam's crystal has no bench
    path = random.choice(sorted(set(SCENES.glob("*.xml")) - {SCENES / "spectrophotometer.xml"}))
    scene = read_scene(path)
    changed, effects = _numbers(scene, random), dict[str, dict[str, float]]()
    p_value, words = None, ""
    tried = random.permutation(list(BUILT_IN.values()))[: random.integers(MOST_EFFECTS + 1)]
    try:
        scene = scene.with_overrides(changed)
        for effect in tried:
            sizes = _sizes(effect, random)
            try:
                scene = scene.edited(add(effect, scene, sizes))
            except InputError:  # this one does not go with this bench
                continue
            effects[effect.name] = sizes
        both = crosscheck(scene, run=Run(photons, seed=number))
        z = {row.quantity: row.z for row in both.rows if row.z is not None}
        by_modes = {f"{row.quantity} by modes": row.modes_z for row in both.rows}
        z |= {quantity: of for quantity, of in by_modes.items() if of is not None}
        worst = max(z, key=lambda quantity: abs(z[quantity]))
        p_value, words = both.family_p_value, f"{worst}: z = {z[worst]:+.1f}"
    except InputError as refusal:
        words = refusal.problem
    return RandomBench(
        number=number,
        scene=path.name,
        changed=changed,
        effects=effects,
        p_value=p_value,
        words=words,
    )


@click.command()
@click.option("--benches", type=options.Whole(1, 100_000), default=200, show_default=True)
@click.option(
    "--photons",
    type=options.PhotonCount(),
    default=200_000,
    show_default="2e5",
    help="Per bench, of the tracer; Mitsuba follows four times as many.",
)
@options.seed
@options.json_output
def main(benches, photons, seed, json_file) -> int:
    """Compare Mitsuba with the independent tracer on random benches with random effects."""
    screen, rows = terminal.console(json_file), []
    for number in counted(benches):
        rows.append(compare(number, seed, photons))
        row = rows[-1]
        if row.p_value is not None and row.p_value * benches < FALSE_ALARM:
            screen.line(f"bench {number}, {row.scene} {row.changed} {row.effects}: {row.words}")
    p_values = [row.p_value for row in rows if row.p_value is not None]
    p_value = min(1.0, len(p_values) * min(p_values, default=1.0))
    agrees = p_value >= FALSE_ALARM
    screen.line(
        f"{len(p_values)} benches ({len(rows) - len(p_values)} refused), "
        f"{sum(len(row.effects) for row in rows)} effects, p = {p_value:.2g}: "
        f"{'agrees' if agrees else 'DISAGREES'}"
    )
    terminal.write_json(
        json_file, {"p_value": p_value, "agrees": agrees, "rows": [asdict(r) for r in rows]}
    )
    return 0 if agrees else 1


if __name__ == "__main__":
    sys.exit(terminal.run(main, "random_benches"))
