"""Tables of eta for a list of scenes and of their parameters, one CSV each.

    python scripts/eta_tables.py scenes/camoo4.xml scenes/cawo4.xml --alpha-scat log:0.01:2:40 \\
        --alpha-abs 0.014,0.039 --n-gap 1.0,1.46 -D gap_mm=0.02,0.05 -o tables

A table that is refused does not stop the others. The same line goes on after an interruption: what
was simulated is in the cache.
"""

from __future__ import annotations

import itertools
import math
import re
import sys
from pathlib import Path

import click
from shared import one_after_another, refuse_foreign, status_of

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.cli.scene_verbs import axes_options, read_axes
from mcrim_mitsuba.core.files import json_text, make_folder, refuse_outputs, write_text
from mcrim_mitsuba.core.numbers import value_text
from mcrim_mitsuba.scene.values import parse_list, refuse_many_points

_SOURCE = "# source: mcrim_mitsuba "


@click.command()
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...")
@axes_options
@options.defined(
    "-D",
    "NAME=LIST",
    "Values of a scene parameter; each combination gets a table.",
    "variations",
)
@click.option(
    "-o",
    "--output",
    "folder",
    required=True,
    metavar="FOLDER",
    help="Where the tables go; made if it is not there.",
)
@options.photons("2e6 per coupling", at_most=True)
@options.precision
@options.run
@click.option("--log", metavar="FILE", help="Append the progress, unit by unit, to this file.")
def main(scenes, variations, folder, run, log, **lists) -> int:
    """Tables of the light collection efficiency of SCENEs, one CSV per scene and combination of -D.

    Comments in each say what it rests on. Kept is a table whose photons the cache has.
    """
    axes, notes = read_axes(lists)
    terminal.console().say_notes(notes)
    tables = wanted(scenes, axes, variations, Path(folder))

    def make(place: Path, progress) -> dict[str, str]:
        made = mcrim.table(tables[place], run=run, progress=progress, **axes)
        lines = [*_comments(tables[place], made, run), *made.csv_lines()]
        write_text(place, "\n".join(lines) + "\n")
        terminal.console().say_notes(f"{place.name}: {note}" for note in made.notes)
        return {
            "status": status_of(made),
            "result": (
                f"{len(made.rows)} points, {made.photons:,} photons "
                f"({made.cached_photons:,} of the cache), {made.seconds:.1f} s"
            ),
        }

    return one_after_another("tables", list(tables), make, folder, log)


def wanted(scenes, axes, variations: dict[str, str], folder: Path) -> dict[Path, mcrim.SceneFile]:
    """Scenes with each combination of the varied parameters, by the place of their table."""
    tables: dict[Path, mcrim.SceneFile] = {}
    places, points = {}, 0
    for path in scenes:
        scene = mcrim.read_scene(path)
        values = [_values(scene, name, text) for name, text in variations.items()]
        points += math.prod(map(len, (*values, *axes.values())))
        refuse_many_points(points)
        for combination in itertools.product(*values):
            changes = dict(zip(variations, combination, strict=True))
            told = "".join(f"_{name}={value_text(value)}" for name, value in changes.items())
            place = folder / (re.sub(r"[^\w.+=,-]", "-", scene.path.stem + told) + ".csv")
            places[f"{path}{told}"] = str(place)
            tables[place] = scene.with_overrides(changes)
    make_folder(folder)
    refuse_outputs(places, scenes)
    for place in tables:
        refuse_foreign(place, lambda text: text.startswith(_SOURCE))
    return tables


def _values(scene: mcrim.SceneFile, name: str, text: str) -> list:
    """Values of a varied parameter, each once."""
    known = scene.parameters.get(name)
    if isinstance(known, float | int) and not isinstance(known, bool):
        return list(dict.fromkeys(parse_list(f"-D {name}", text, name, scene.path.parent)))
    return list(dict.fromkeys(part.strip() for part in text.split(",")))


def _comments(scene: mcrim.SceneFile, made: mcrim.Result, run: mcrim.Run) -> list[str]:
    """What the numbers are and how they came about."""
    from mcrim_mitsuba.transport.variants import versions

    known = {
        "source": f"mcrim_mitsuba {mcrim.__version__}",
        "units": "coefficients in 1/cm; eta, a fraction, with its standard error",
        "scene": scene.path,
        "parameters": json_text({n: v for n, v in made.parameters.items() if n not in made.axes}),
        **{name: getattr(made, name) for name in ("scene_hash", "photons", "seed")},
        "versions": json_text(versions(run.variant, run.threads)),
        **({"notes": json_text(list(made.notes))} if made.notes else {}),
    }
    return [f"# {name}: {' '.join(str(value).split())}" for name, value in known.items()]


if __name__ == "__main__":
    sys.exit(terminal.run(main, "eta_tables"))
