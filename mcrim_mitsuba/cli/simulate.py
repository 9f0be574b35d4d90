"""``mcrim simulate``: eta of one configuration."""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing
from mcrim_mitsuba.core.files import refuse_outputs


@click.command()
@options.scene_argument
@options.defines
@options.photons("2e6", at_most=True)
@options.precision
@options.figure(
    "where the light arrives on the detector, and at which angle (and which fates light meets, "
    "NAME_fates), from photons of their own, as many but 4e6 at most"
)
@options.seed
@options.machine
@options.work
@options.json_output
def simulate(scene, overrides, figure, json_file, work) -> None:
    """Light collection efficiency of one configuration of SCENE, with every photon's fate."""
    if figure:
        showing.refuse_places(json_file, [scene], figure, showing.further_picture(figure, "fates"))
        from mcrim_mitsuba.efficiency.lighting import refuse_curved
        from mcrim_mitsuba.transport.simulation import Simulation

        run = work.run
        refuse_curved(Simulation(scene, overrides, variant=run.variant, threads=run.threads))
    else:
        refuse_outputs({"--json": json_file}, [scene])
    with work.begin() as run:
        found = mcrim.simulate(mcrim.read_scene(scene, overrides), run=run)
    showing.answer(found, json_file, None if found.interrupted else figure)
