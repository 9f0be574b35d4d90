"""``mcrim table``: eta over coefficients and couplings."""

from __future__ import annotations

import math
from pathlib import Path

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import STDOUT, refuse_outputs, write_bytes
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT
from mcrim_mitsuba.output import scene_descriptions
from mcrim_mitsuba.scene.values import parse_list, refuse_many_points
from mcrim_mitsuba.transport.launch_plan import LANES

_LIST = "such as 0.1,0.5 or 0.01:2:40 (start:stop:count) or log:0.01:2:40"
_COUPLINGS = "such as 1.0,1.46 or 1.0:1.6:7 (start:stop:count) or 1.0,glycerol@540nm"
_MOST_SHOWN = 6
_OWN_OPTIONS = {"n_gap": "--n-gap", ALPHA_ABS: "--alpha-abs", ALPHA_SCAT: "--alpha-scat"}
_NO_CAP = (
    f"Photon records come in launches of {LANES:,} photons: numbers are rounded up. Each point "
    "that they say too little about is simulated on its own and may take as many again."
)


@click.command()
@options.scene_argument
@click.option("--alpha-scat", required=True, metavar="LIST", help=f"Scattering, 1/cm: {_LIST}.")
@click.option("--alpha-abs", required=True, metavar="LIST", help=f"Absorption, 1/cm: {_LIST}.")
@click.option("--n-gap", required=True, metavar="LIST", help=f"Index of the gap: {_COUPLINGS}.")
@click.option("--axis", "axes", multiple=True, metavar="NAME=LIST", callback=options.read_defines,
              help="Values of any other parameter of the scene (may be repeated).")  # fmt: skip
@click.option("-o", "--output", "path", metavar="FILE",
              help="CSV (or NetCDF, .nc) to write; - for the screen.")  # fmt: skip
@options.defines
@options.photons("2e6 per coupling", at_most=True, further=_NO_CAP)
@options.precision
@options.seed
@options.machine
@options.work
@options.json_output
def table(scene, alpha_scat, alpha_abs, n_gap, axes, path, overrides, json_file, work) -> None:
    """Table of the light collection efficiency of SCENE, one simulation per coupling."""
    folder = Path(scene).parent
    for name, option in _OWN_OPTIONS.items():
        if name in axes:
            raise InputError(f"--axis {name} has an option of its own", f"give {option} only")
    lists = {name: parse_list(f"--axis {name}", text, name, folder) for name, text in axes.items()}
    lists |= {
        "n_gap": parse_list("--n-gap", n_gap, "n_gap", folder),
        ALPHA_ABS: parse_list("--alpha-abs", alpha_abs),
        ALPHA_SCAT: parse_list("--alpha-scat", alpha_scat),
    }
    refuse_many_points(math.prod(map(len, lists.values())))
    refuse_outputs({"--output": path, "--json": json_file}, [scene])
    file = mcrim.read_scene(scene, overrides)
    screen = terminal.console(json_file, path)
    said = [f"alpha_scat {_abbreviated(lists[ALPHA_SCAT])} /cm",
            f"alpha_abs {_abbreviated(lists[ALPHA_ABS])} /cm"]  # fmt: skip
    said += [f"{n} {_abbreviated(v)}" for n, v in lists.items() if n not in (ALPHA_ABS, ALPHA_SCAT)]
    screen.print("; ".join(said), markup=False, soft_wrap=True)
    with work.begin() as run:
        made = mcrim.table(file, run=run, **lists)
    if path and path.lower().endswith(".nc"):
        from mcrim_mitsuba.output.result_writing import netcdf_bytes

        write_bytes(path, netcdf_bytes(made.to_xarray()))
    elif path:
        made.write(path)
    terminal.write_json(json_file, made.document)
    seconds = made.document["seconds"]
    described = scene_descriptions.of_table(made.found, seconds=seconds, written=path)
    if path in STDOUT:
        screen.say(described.spent)  # unlike the JSON, the CSV has no place for it
    showing.show(screen, described)


def _abbreviated(values: list[float]) -> str:
    """``0.1, 0.5``; of a long list both ends: ``0.01, 0.06, ..., 2 (40 values)``."""
    texts = [f"{value:.6g}" for value in values]
    if len(texts) > _MOST_SHOWN:
        return f"{texts[0]}, {texts[1]}, ..., {texts[-1]} ({len(texts)} values)"
    return ", ".join(texts)
