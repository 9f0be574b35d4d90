"""``mcrim check``: is a scene sound, and what does it mean?"""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output import descriptions, documents


@click.command()
@click.argument("scene", required=False)
@options.defines
@click.option("-o", "--output", "picture", metavar="FILE",
              help="Draw a cross-section to scale, with paths of photons, as .png, .svg or "
              ".pdf.")  # fmt: skip
@options.machine
@options.json_output
def check(scene, overrides, picture, variant, threads, json_file) -> int:
    """Check SCENE and say what it means; without a scene, say what is installed."""
    if scene is None:
        refuse_outputs({"--json": json_file})
        return _installation(variant, threads, json_file)
    from mcrim_mitsuba.transport.check import check_scene

    refuse_outputs(
        {"--output": picture, "--json": json_file}, [scene],
        suffixes={"--output": (".png", ".svg", ".pdf")},
    )  # fmt: skip
    report = check_scene(scene, overrides, variant=variant, threads=threads)
    terminal.write_json(json_file, documents.of_check(report))
    if picture and report.ok:
        from mcrim_mitsuba.output.cross_section import draw_cross_section
        from mcrim_mitsuba.transport.simulation import Simulation

        simulation = Simulation(scene, overrides, variant=variant, threads=threads, check=False)
        draw_cross_section(simulation, report.interfaces, picture)
    screen = terminal.console(json_file)
    screen.show(*descriptions.of_check(report).parts)
    if not report.ok:
        raise report.problems[0].error()
    if picture:
        screen.print(f"cross-section drawn to {picture}", markup=False)
    screen.print("the scene is sound")
    return 0


def _installation(variant, threads, json_file) -> int:
    from mcrim_mitsuba.transport.variants import describe_installation

    found = describe_installation(variant, threads)
    terminal.write_json(json_file, documents.of_installation(found))
    terminal.console(json_file).show(*descriptions.of_installation(found).parts)
    return 0
