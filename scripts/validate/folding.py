"""Flights that pass over total reflections, and through a film, against those from face to face.

    python scripts/validate/folding.py                 # every case, 16 million photons each
    python scripts/validate/folding.py --case wrapped --photons 1e6

Cases are all crystals and all effects of the catalogue with which some of the flights fold. Eta and
the means of record columns are compared; right flights pass in 99 % of such runs (Bonferroni).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from scipy.stats import norm

sys.path.insert(0, str(Path(__file__).parents[1]))
from shared import SCENES

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.effects.catalogue import BUILT_IN, add
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.transport.launch_plan import LANES, SHARE_STEPS, ScatteringProposals
from mcrim_mitsuba.transport.simulation import Simulation
from validate.benches import home
from validate.judging import FALSE_ALARM

#: Coefficients, 1/cm: most light goes round more often than it scatters.
COEFFICIENTS = ScatteringProposals((0.1,), (SHARE_STEPS,), 0.02)
#: What is compared besides eta: its part of light's weight that is detected.
COLUMNS = (
    "reflections",
    "log_rayleigh",
    "path_gap_cm",
    "path_outside_cm",
    "reflector_hits",
    "birth_depth_mm",
    "arrival_cosine",
    "arrival_radius_mm",
)
CRYSTALS = ("", "_cylinder", "_cylinder_lying", "_hexagonal", "_thin", "_wrapped")


def _of_crystal(name: str, **overrides: str) -> SceneFile:
    return read_scene(SCENES / f"camoo4{name}.xml", overrides)


def _with_effect(name: str) -> SceneFile:
    scene = home(name)
    return scene.edited(add(name, scene))


CASES: dict[str, Callable[[], SceneFile]] = {
    **{name.strip("_") or "box": lambda name=name: _of_crystal(name) for name in CRYSTALS},
    **{
        f"polarised{name}": lambda name=name: _of_crystal(name, polarization="true")
        for name in ("_cylinder", "_cylinder_lying", "_thin", "_wrapped")
    },
    "mirrors": lambda: read_scene(SCENES / "lyso_esr.xml"),
    **{
        effect.name: lambda name=effect.name: _with_effect(name)
        for effect in BUILT_IN.values()
        if effect.edit is not None and not effect.of_beam
    },
}


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A mean per photon, folded and not, with their standard errors."""

    case: str
    what: str
    folded: float
    folded_sigma: float
    straight: float
    straight_sigma: float

    @property
    def z(self) -> float:
        """The difference over its error."""
        sigma = math.hypot(self.folded_sigma, self.straight_sigma)
        return (self.folded - self.straight) / sigma if sigma else 0.0


def compare(case: str, photons: int, seed: int) -> list[Difference]:
    """All quantities of a case; none where nothing folds."""
    simulation = Simulation(CASES[case](), {"n_gap": 1.46}, check=False)
    if simulation.launcher().path.folded is None:
        return []
    # cases share no photons, nor do their two flights
    seeds = np.random.SeedSequence([seed, list(CASES).index(case)]).generate_state(2).tolist()
    folded, straight = (
        _means(simulation, photons, seeds[fold], fold=bool(fold)) for fold in (1, 0)
    )
    return [
        Difference(
            case=case,
            what=what,
            folded=folded[what][0],
            folded_sigma=folded[what][1],
            straight=straight[what][0],
            straight_sigma=straight[what][1],
        )
        for what in folded
    ]


def _means(
    simulation: Simulation, photons: int, seed: int, *, fold: bool
) -> dict[str, tuple[float, float]]:
    """Means per photon of the weight, and of the weight times columns, with standard errors."""
    from mcrim_mitsuba.transport.collection import PER_LANE_FLAT, Recorder  # imports Mitsuba

    recorder, launches = Recorder(simulation, fold=fold), -(-photons // (PER_LANE_FLAT * LANES))
    of_batches: dict[str, list[np.ndarray]] = {}
    for number in range(launches):
        lanes = LANES * -(-photons // (launches * LANES))
        records = recorder.record(COEFFICIENTS, lanes, seed=seed, number=number, columns=COLUMNS)
        columns = {"eta": 1.0, "k": records.k, "path_cm": records.path_cm, **records.further}
        for name, values in columns.items():
            sums = np.bincount(records.batch, records.w * values, records.batches)
            of_batches.setdefault(name, []).append(sums * records.batches / records.photons)
    means = {name: np.concatenate(sums) for name, sums in of_batches.items()}
    return {
        name: (float(values.mean()), float(values.std(ddof=1) / math.sqrt(len(values))))
        for name, values in means.items()
    }


def largest(differences: list[Difference]) -> tuple[Difference, float]:
    """That of the largest z, and the probability of as large a one by chance, at most."""
    worst = max(differences, key=lambda difference: abs(difference.z))
    return worst, min(1.0, 2 * len(differences) * float(norm.sf(abs(worst.z))))


@click.command()
@click.option("--case", "cases", multiple=True, type=click.Choice(list(CASES)))
@click.option("--photons", type=options.PhotonCount(), default=16_000_000, show_default="16e6")
@options.seed
@options.json_output
def main(cases, photons, seed, json_file) -> int:
    """Compare folded flights with straight ones in all that light meets."""
    screen, rows = terminal.console(json_file), []
    for case in cases or CASES:
        rows += (differences := compare(case, photons, seed))
        for row in differences[:1]:
            relative = math.hypot(row.folded_sigma, row.straight_sigma) / row.straight
            worst = max(differences, key=lambda difference: abs(difference.z))
            screen.line(
                f"{case}: eta differs by {row.folded / row.straight - 1:+.1e} +- {relative:.1e}, "
                f"largest z {worst.z:+.1f} ({worst.what})"
            )
    worst, p = largest(rows)
    agrees = p >= FALSE_ALARM
    screen.line(
        f"{len(rows)} comparisons, largest z {worst.z:+.1f} ({worst.what} of {worst.case}), "
        f"p = {p:.2g}: {'agrees' if agrees else 'DISAGREES'}"
    )
    terminal.write_json(json_file, {"agrees": agrees, "rows": [asdict(row) for row in rows]})
    return 0 if agrees else 1


if __name__ == "__main__":
    sys.exit(terminal.run(main, "folding"))
