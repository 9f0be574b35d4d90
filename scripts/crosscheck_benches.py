"""Mitsuba against the NumPy tracer on many benches, each to a wanted precision of eta.

    python scripts/crosscheck_benches.py --precision 0.2%

Prints a z-score for eta and for each fate, and one test of them all at a family-wise 1 %.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import click
from scipy.stats import norm

from mcrim_mitsuba.cli.options import Precision
from mcrim_mitsuba.crosscheck import FAMILY_LEVEL, crosscheck
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.kernel.simulation import Simulation

SCENES = Path(__file__).parents[1] / "scenes"
_CHANGES = (
    {},
    {"polarization": True},
    {"gap_mm": 0.02},
    {"gap_mm": 2},
    {"crystal_width_mm": 5, "crystal_height_mm": 20},
    {"aperture_radius_mm": 3},
    {"alpha_scat_per_cm": 0},
    {"alpha_scat_per_cm": 20},
)
#: Scene and what is changed in it: all shipped scenes, and benches of other dimensions.
BENCHES = (
    *(("camoo4", change | {"n_gap": n}) for change, n in itertools.product(_CHANGES, (1.0, 1.46))),
    ("camoo4", {"n_gap": 1.2}),
    ("camoo4", {"n_gap": 1.8}),
    ("cawo4", {}),
    ("camoo4_thin", {}),
    ("camoo4_wrapped", {}),
    ("camoo4_wrapped", {"polarization": True}),
)


@click.command()
@click.option("--precision", type=Precision(), default=0.002, help="Of eta in the NumPy tracer.")
@click.option("--seed", type=int, default=0)
def main(precision: float, seed: int) -> None:
    """Cross-check all benches."""
    scores = []
    for number, (scene, change) in enumerate(BENCHES):
        path = SCENES / f"{scene}.xml"
        eta = Simulation(path, change).collect(100_000).eta
        photons = round((1 - eta) / eta / precision**2)
        found = crosscheck(path, change, photons=photons, seed=seed + number)
        own = {row.quantity: row.z for row in found.rows if row.z is not None}
        scores += own.values()
        row = found.rows[0]
        name = " ".join([scene, *(f"{k}={v}" for k, v in change.items())])
        print(
            f"{name:<62} eta {row.mitsuba:.5f} / {row.numpy:.5f}  "
            + "  ".join(f"{k} {z:+.2f}" for k, z in own.items()),
            flush=True,
        )
    worst = max(abs(z) for z in scores)
    p_value = min(1.0, len(scores) * 2 * float(norm.sf(worst)))
    print(
        f"{len(BENCHES)} benches, {len(scores)} z-scores, largest {worst:.2f}: family-wise "
        f"p = {p_value:.3g}, tested at {FAMILY_LEVEL:g}"
    )
    sys.exit(0 if p_value >= FAMILY_LEVEL else 1)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"crosscheck_benches: {error}")
