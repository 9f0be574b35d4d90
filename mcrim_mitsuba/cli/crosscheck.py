"""``mcrim crosscheck``: Mitsuba against the NumPy tracer."""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
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
    refuse_outputs({"--json": json_file}, [scene])
    with terminal.photon_progress() as report:
        run = mcrim.Run(photons, None, seed, threads, variant, report)
        found = mcrim.crosscheck(scene, run=run, **overrides)
    showing.answer(found, json_file)
    return 0 if found.agrees else 1
