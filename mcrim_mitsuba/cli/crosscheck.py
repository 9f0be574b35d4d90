"""``mcrim crosscheck``: Mitsuba against the NumPy tracer."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs


@click.command()
@options.scene_argument
@options.defines
@options.photons("1e6 in the NumPy tracer, four times as many in Mitsuba")
@options.seed
@options.machine
@options.json_output
def crosscheck(scene, overrides, photons, seed, variant, threads, json_file) -> int:
    """Run SCENE in Mitsuba and in the independent NumPy tracer and compare every fate."""
    from mcrim_mitsuba.reference.crosscheck import FAMILY_LEVEL
    from mcrim_mitsuba.reference.crosscheck import crosscheck as run

    refuse_outputs({"--json": json_file}, [scene])
    with terminal.photon_progress() as report:
        found = run(
            scene, overrides, photons=photons or 1_000_000, seed=seed, variant=variant,
            threads=threads, progress=report,
        )  # fmt: skip
    terminal.write_json(
        json_file,
        {
            "rows": found.rows,
            "family_p_value": found.family_p_value,
            "agrees": found.agrees,
            "photons": {"mitsuba": found.mitsuba_photons, "numpy": found.numpy_photons},
            "seed": seed,
        },
    )
    screen = terminal.console(json_file)
    shown = terminal.table("", "quantity", "Mitsuba", "error", "NumPy", "error", "z")
    for row in found.rows:
        z = "too few" if row.z is None else f"{row.z:+.2f}"
        shown.add_row(row.quantity, f"{row.mitsuba:.6f}", f"{row.mitsuba_sigma:.6f}",
                      f"{row.numpy:.6f}", f"{row.numpy_sigma:.6f}", z)  # fmt: skip
    screen.print(shown)
    verdict = "agree" if found.agrees else "DISAGREE"
    screen.print(
        f"the two {verdict}: family-wise p = {found.family_p_value:.3g}, tested at "
        f"{FAMILY_LEVEL:g}; {found.mitsuba_photons:,} and {found.numpy_photons:,} photons"
    )
    return 0 if found.agrees else 1
