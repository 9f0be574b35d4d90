"""``mcrim check``: is a scene sound, and what does it mean?"""

from __future__ import annotations

import click

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.files import refuse_outputs


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
    terminal.write_json(
        json_file,
        {
            "ok": report.ok,
            "problems": [
                {
                    "kind": problem.kind,
                    "text": problem.text,
                    "mend": problem.mend,
                    "file": problem.path,
                    "line": problem.line,
                    "column": problem.column,
                }
                for problem in report.problems
            ],
            "parameters": report.parameters,
            "interfaces": [
                {
                    "surface": face.surface,
                    "kind": face.kind,
                    "interior": face.interior,
                    "exterior": face.exterior,
                    "n_interior": face.n_interior,
                    "n_exterior": face.n_exterior,
                    "file": face.path,
                    "line": face.line,
                }
                for face in report.interfaces
            ],
            "words": list(report.words),
        },
    )
    if picture and report.ok:
        from mcrim_mitsuba.output.cross_section import draw_cross_section
        from mcrim_mitsuba.transport.simulation import Simulation

        simulation = Simulation(scene, overrides, variant=variant, threads=threads, check=False)
        draw_cross_section(simulation, report.interfaces, picture)
    screen = terminal.console(json_file)
    for sentence in report.words:
        screen.print(f"- {sentence}", markup=False)
    if report.interfaces:
        faces = terminal.table("", "face", "kind", "behind it", "n", "in front of it", "n", "line")
        for face in report.interfaces:
            faces.add_row(face.surface, face.kind, face.interior, _index(face.n_interior),
                          face.exterior, _index(face.n_exterior), str(face.line))  # fmt: skip
        screen.print(faces)
    if not report.ok:
        for problem in report.problems[1:]:
            screen.print(f"also: {problem}", markup=False)
        raise report.problems[0].error()
    if picture:
        screen.print(f"cross-section drawn to {picture}", markup=False)
    screen.print("the scene is sound")
    return 0


def _index(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _installation(variant, threads, json_file) -> int:
    from mcrim_mitsuba.transport.simulation import describe_installation

    found = describe_installation(variant, threads)
    screen = terminal.console(json_file)
    shown = terminal.table("", "part", "found")
    for name, value in found.items():
        shown.add_row(name, str(value))
    screen.print(shown)
    terminal.write_json(json_file, {"ok": True, "problems": [], "installation": found})
    screen.print("the installation works: a kernel was compiled and run")
    return 0
