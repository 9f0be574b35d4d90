"""``mcrim crosscheck``: Mitsuba against the NumPy tracer."""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.output import descriptions, documents


@click.command()
@options.scene_argument
@options.defines
@options.photons("1e6 in the NumPy tracer, four times as many in Mitsuba")
@options.seed
@options.machine
@options.json_output
def crosscheck(scene, overrides, photons, seed, variant, threads, json_file) -> int:
    """Run SCENE in Mitsuba and in the independent NumPy tracer and compare every fate."""
    from mcrim_mitsuba.reference.crosscheck import crosscheck as run

    refuse_outputs({"--json": json_file}, [scene])
    with terminal.photon_progress() as report:
        found = run(scene, overrides, run=Run(photons, None, seed, threads, variant, report))
    terminal.write_json(json_file, documents.of_crosscheck(found, seed))
    showing.show(terminal.console(json_file), descriptions.of_crosscheck(found))
    return 0 if found.agrees else 1
