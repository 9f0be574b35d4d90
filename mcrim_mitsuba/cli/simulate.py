"""``mcrim simulate``: eta of one configuration."""

from __future__ import annotations

from pathlib import Path

import click

from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import options as work_options
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.simulate import collect
from mcrim_mitsuba.output import descriptions, documents

#: Photons of the figures, at most: more would not be seen.
MOST_FOR_FIGURES = 4_000_000


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
@work_options
@options.json_output
def simulate(
    scene, overrides, photons, precision, figure, seed, variant, threads, json_file, work
) -> None:
    """Light collection efficiency of one configuration of SCENE, with every photon's fate."""
    from mcrim_mitsuba.transport.simulation import Simulation

    figures = (figure, showing.further_picture(figure, "fates")) if figure else ()
    if figures:
        showing.refuse_places(json_file, [scene], *figures)
    else:
        refuse_outputs({"--json": json_file}, [scene])
    simulation = Simulation(scene, overrides, variant=variant, threads=threads)
    if figures:
        from mcrim_mitsuba.efficiency.lighting import refuse_curved

        refuse_curved(simulation)
    with work.begin() as report:
        run = Run(photons, precision, seed, threads, variant, report)
        result = collect(simulation, run=run)
    terminal.write_json(json_file, documents.of_simulation(result))
    drawn: tuple[Path, ...] = ()
    if figures and not result.interrupted:
        drawn = _draw(figures, simulation, min(result.photons, MOST_FOR_FIGURES), seed)
    showing.show(terminal.console(json_file), descriptions.of_simulation(result), drawn)


def _draw(figures, simulation, photons: int, seed: int) -> tuple[Path, ...]:
    """Follow light once more, keeping where it arrives, and draw it."""
    from mcrim_mitsuba.efficiency.lighting import follow_light
    from mcrim_mitsuba.output.light_figures import draw_arrival, draw_fates

    with terminal.photon_progress() as report:
        light = follow_light(simulation, run=Run(photons, seed=seed, progress=report))
    file, (arrival, fates) = simulation.file, figures
    changed = [f"{name}={file.parameters[name]}" for name in file.overrides]
    named = [(", ".join([file.path.name, *changed]), light)]
    return (*draw_arrival(named).save(arrival), *draw_fates(named).save(fates))
