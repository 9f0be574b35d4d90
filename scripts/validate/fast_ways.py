"""Fast ways to eta against photons followed one by one, on random benches.

    python scripts/validate/fast_ways.py                        # 400 benches, some 5 minutes
    python scripts/validate/fast_ways.py --way weights --benches 40

Benches are drawn over all that a way accepts; what it refuses is counted. Right ways with right
errors pass in 99 % of such runs: half of the false alarms belong to the sum of squares of z, half
to the largest z (Bonferroni). Errors that are too large do not fail, but are seen in the rms.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.stats import chi2, norm

sys.path.insert(0, str(Path(__file__).parents[1]))
from shared import SCENE, counted

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.efficiency.polished_box import solve_box
from validate.judging import FALSE_ALARM

#: Within these the coefficients of the benches lie, in 1/cm.
ALPHA_SCAT_PER_CM, ALPHA_ABS_PER_CM = (0.003, 5.0), (0.001, 0.3)
#: Photons that weights come from, per configuration of the table.
PHOTONS_OF_TABLE = 4_000_000

Drawn = dict[str, float]


def draw(number: int, seed: int) -> Drawn:
    """Scene parameters of a random bench: any size, coupling, mask and gap."""
    random = np.random.default_rng([seed, number])

    def even(low: float, high: float) -> float:
        return float(np.round(random.uniform(low, high), 4))

    def by_decade(low: float, high: float) -> float:
        return float(f"{math.exp(random.uniform(math.log(low), math.log(high))):.4g}")

    width = even(5.0, 15.0)
    return {
        "crystal_width_mm": width,
        "crystal_height_mm": by_decade(0.5, 50.0),
        "n_crystal": even(1.9, 2.3),
        "alpha_scat_per_cm": by_decade(*ALPHA_SCAT_PER_CM),
        "alpha_abs_per_cm": by_decade(*ALPHA_ABS_PER_CM),
        "gap_mm": even(0.02, 1.0),
        "n_gap": 1.0 if random.random() < 0.3 else even(1.0, 1.65),
        "n_window": even(1.42, 1.6),
        "aperture_radius_mm": round(width * random.uniform(0.3, 1.3), 4),
    }


def by_modes(bench: Drawn, seed: int) -> tuple[float, float]:
    """Eta and its error by the solution without photons; raises InputError for what it refuses."""
    found = solve_box(Bench(**bench))
    return float(found.eta), float(found.error)


def by_weights(bench: Drawn, seed: int) -> tuple[float, float]:
    """Eta and its error by weights of photons that were followed for all coefficients at once."""
    own = dict(bench)
    ranges = {"alpha_scat_per_cm": ALPHA_SCAT_PER_CM, "alpha_abs_per_cm": ALPHA_ABS_PER_CM}
    axes = {name: [low, own.pop(name), high] for name, (low, high) in ranges.items()}
    scene = mcrim.read_scene(SCENE, own)
    table = mcrim.table(scene, **axes, photons=PHOTONS_OF_TABLE, seed=seed, check=False)
    return float(table.eta[1, 1]), float(table.eta_sigma[1, 1])


WAYS: dict[str, Callable[[Drawn, int], tuple[float, float]]] = {
    "modes": by_modes,
    "weights": by_weights,
}


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One bench: eta by a fast way and by photons, with their errors; None where it is refused."""

    number: int
    bench: Drawn
    fast: float | None
    fast_sigma: float | None
    refused: str | None
    slow: float | None = None
    slow_sigma: float | None = None

    @property
    def z(self) -> float:
        """The difference over its error."""
        return (self.fast - self.slow) / math.hypot(self.fast_sigma, self.slow_sigma)


def compare(way: str, number: int, seed: int, photons: int) -> Comparison:
    """Both answers to one random bench, of photons that have nothing in common."""
    bench = draw(number, seed)
    own_seed = int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1)
    named: dict[str, Any] = {"number": number, "bench": bench}
    try:
        eta, sigma = WAYS[way](bench, own_seed)
    except InputError as error:
        return Comparison(**named, fast=None, fast_sigma=None, refused=error.problem)
    # a bench of other sizes is as sound as the shipped one
    slow = mcrim.simulate(SCENE, **bench, photons=photons, seed=own_seed + 1, check=False)
    return Comparison(
        **named,
        fast=eta,
        fast_sigma=sigma,
        refused=None,
        slow=float(slow.eta),
        slow_sigma=float(slow.eta_sigma),
    )


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the z-scores of one way say."""

    benches: int
    refused: int
    rms: float
    largest: float
    #: Bench of the largest.
    where: int
    p_squares: float
    p_largest: float

    @property
    def agrees(self) -> bool:
        """Whether both tests are passed; a right way is so with 1 - `FALSE_ALARM` or more."""
        return min(self.p_squares, self.p_largest) >= FALSE_ALARM / 2


def judge(comparisons: list[Comparison]) -> Verdict:
    """Test all z-scores of a way together."""
    told = [one for one in comparisons if one.refused is None]
    z = np.array([one.z for one in told])
    largest = int(np.argmax(abs(z)))
    return Verdict(
        benches=len(told),
        refused=len(comparisons) - len(told),
        rms=float(np.sqrt(np.mean(z**2))),
        largest=float(z[largest]),
        where=told[largest].number,
        p_squares=float(chi2.sf(np.sum(z**2), len(z))),
        p_largest=min(1.0, 2 * len(z) * float(norm.sf(abs(z[largest])))),
    )


@click.command()
@click.option(
    "--way",
    "ways",
    multiple=True,
    type=click.Choice(list(WAYS)),
    help="Only this fast way (repeatable).",
)
@click.option("--benches", type=options.Whole(1, 100_000), default=400, show_default=True)
@click.option(
    "--photons",
    type=options.PhotonCount(),
    default=16_000_000,
    show_default="16e6",
    help="Per bench, of the slow way.",
)
@options.seed
@options.json_output
def main(ways, benches, photons, seed, json_file) -> int:
    """Compare fast ways to eta with photons on random benches, and test all z-scores together."""
    screen = terminal.console(json_file)
    found, agree = {}, True
    for way in ways or WAYS:
        numbers = counted(benches, f"{way}: ")
        comparisons = [compare(way, number, seed, photons) for number in numbers]
        verdict = judge(comparisons)
        agree &= verdict.agrees
        screen.line(
            f"{way}: {verdict.benches} benches ({verdict.refused} refused), rms z "
            f"{verdict.rms:.2f} (p = {verdict.p_squares:.2g}), largest {verdict.largest:+.1f} "
            f"(bench {verdict.where}, p = {verdict.p_largest:.2g}): "
            f"{'agrees' if verdict.agrees else 'DISAGREES'}"
        )
        rows = [asdict(one) for one in comparisons]
        found[way] = {**asdict(verdict), "agrees": verdict.agrees, "rows": rows}
    terminal.write_json(json_file, found)
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(terminal.run(main, "fast_ways"))
