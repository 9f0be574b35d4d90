"""``mcrim check``: is a scene sound, and what does it mean?"""

from __future__ import annotations

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output import documents, scene_descriptions


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
    refuse_outputs(
        {"--output": picture, "--json": json_file}, [scene],
        suffixes={"--output": (".png", ".svg", ".pdf")},
    )  # fmt: skip
    found = mcrim.check(scene, run=mcrim.Run(variant=variant, threads=threads), **overrides)
    terminal.write_json(json_file, found.document)
    if picture and found.ok:
        from mcrim_mitsuba.output.cross_section import write_cross_section

        write_cross_section(found.plot(), picture)
    screen = terminal.console(json_file)
    screen.show(*found.described.parts)
    if not found.ok:
        raise found.problems[0].error()
    if picture:
        screen.print(f"cross-section drawn to {picture}", markup=False)
    screen.print("the scene is sound")
    return 0


def _installation(variant, threads, json_file) -> int:
    from mcrim_mitsuba.transport.variants import describe_installation

    found = describe_installation(variant, threads)
    terminal.write_json(json_file, documents.of_installation(found))
    terminal.console(json_file).show(*scene_descriptions.of_installation(found).parts)
    return 0
