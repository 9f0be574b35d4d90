"""``mcrim render``: a picture of the bench."""

from __future__ import annotations

import time

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output import documents


@click.command()
@options.scene_argument
@click.option("-o", "--output", "picture", metavar="PICTURE.png", required=True,
              help="The picture, a .png of 1800 x 1150 pixels.")  # fmt: skip
@options.defines
@click.option("--samples", type=options.Whole(1, 4096),
              help="Light paths per pixel: more are smoother (default: 12).")  # fmt: skip
@options.seed
@options.machine
@options.json_output
def render(scene, picture, overrides, samples, seed, variant, threads, json_file) -> None:
    """Photograph SCENE: as it stands, taken apart and, enlarged, at the crystal's lower edge.

    Glass is shown clear: what it scatters and absorbs is left out, and its tint is there to
    tell parts apart.
    """
    refuse_outputs(
        {"--output": picture, "--json": json_file}, [scene], suffixes={"--output": (".png",)}
    )
    start = time.monotonic()
    with terminal.photon_progress() as report:
        run = mcrim.Run(None, None, seed, threads, variant, report)
        made = mcrim.render(scene, samples=samples, run=run, **overrides)
    made.save(picture)
    seconds = time.monotonic() - start
    terminal.write_json(json_file, documents.of_rendering(made, picture, seconds=seconds))
    screen = terminal.console(json_file)
    screen.line(f"picture of {', '.join(made.parts)} written to {picture} ({seconds:.0f} s)")
