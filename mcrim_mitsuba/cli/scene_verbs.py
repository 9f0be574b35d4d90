"""Verbs on scenes: ``mcrim scenes``, ``check``, ``simulate``, ``table`` and others."""

from __future__ import annotations

import contextlib
import math
import shlex
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import Number, Whole, defined, option
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import READS, STDOUT, collected, write_bytes, write_text
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, COUNTED
from mcrim_mitsuba.output import describe_scene
from mcrim_mitsuba.output.registry import VerbResult
from mcrim_mitsuba.scene.shipped import copy_scenes, scene_files, scenes_folder
from mcrim_mitsuba.scene.values import parse_list, refuse_many_points, told_of_comma
from mcrim_mitsuba.transport.launch_plan import LANES


@click.command(short_help="List or copy the scenes and campaigns of the package.")
@options.folder("Copy all of them there, to be edited; replaces nothing.")
def scenes(folder) -> None:
    """List the scenes, campaigns and measurements that come with the package, or copy them."""
    if folder is None:
        click.echo(f"in {scenes_folder()}:")
        for name in scene_files():
            click.echo(f"  {name.as_posix()}")
        return
    copies = copy_scenes(folder)
    scene = shlex.quote(str(Path(folder) / "camoo4.xml"))
    click.echo(f"{len(copies)} files were copied to {folder}. Next: mcrim check {scene}")


@click.command(short_help="JSON schema of a campaign, for completion in editors.")
@options.output("FILE.json", "File to write; - for the screen.", default="-")
def schema(path) -> None:
    """JSON schema of a campaign (TOML), with which editors complete and explain its entries.

    Even Better TOML, Taplo and others take it by a line at the top of the campaign:
    #:schema FILE.json
    """
    from mcrim_mitsuba.campaign.entries import json_schema

    showing.refuse_places(None, [], written={"--output": (path, ())})
    terminal.write_json(path, json_schema())


@click.command(short_help="Check a scene and say what it means.")
@click.argument("scene", required=False, type=click.Path(path_type=str))
@options.defines
@options.output(
    "FILE",
    "Draw a cross-section to scale, with paths of photons, as .png, .svg or .pdf.",
    "picture",
)
@options.machine
@options.json_output
def check(scene, overrides, picture, variant, threads, json_file) -> None:
    """Check SCENE and say what it means; without a scene, say what is installed."""
    if scene is None:
        from mcrim_mitsuba.transport.variants import describe_installation

        showing.refuse_places(json_file, [])
        parts = describe_installation(variant, threads)
        document = {"ok": True, "problems": [], "installation": parts}
        shown = describe_scene.of_installation(parts)
        showing.answer(VerbResult(kind="installation", shown=shown, numbers=document), json_file)
        return
    inputs: list = [scene]
    with contextlib.suppress(InputError):  # what is wrong is among the result's problems
        inputs += [mcrim.read_scene(scene, overrides)]
    written = {"--output": (picture, (".png", ".svg", ".pdf"))} if picture else {}
    showing.refuse_places(json_file, inputs, written=written)
    checked = mcrim.check(scene, run=mcrim.Run(variant=variant, threads=threads), **overrides)
    terminal.write_json(json_file, checked.document)
    drawn = picture and Path(scene).is_file()  # of nothing nothing is drawn
    if drawn:
        from mcrim_mitsuba.output.cross_section import write_cross_section

        write_cross_section(checked.plot(), picture)
    screen = terminal.console(json_file)
    showing.show(screen, describe_scene.of_check(checked, first=False))
    if drawn:
        screen.line(f"cross-section drawn to {picture}")
    if not checked.ok:
        raise checked.problems[0].error()
    screen.line("the scene is sound")


@click.command(short_help="Light collection efficiency of a scene, with all fates.")
@options.scene
@options.defines
@options.photons("2e6", at_most=True)
@options.precision
@options.method
@options.figure(
    "where the light arrives on the detector, and at which angle (and which fates light meets, "
    "NAME_fates), from the run's photons, the first 4e6 of more"
)
@options.file(
    "--map",
    "Map the efficiency by where light is born, from 1e8 photons or --photons, and say what its "
    "spread adds to a peak; its picture is NAME_map of --figure.",
    "map_file",
    metavar="FILE.nc",
)
@options.depth(-math.inf, default="1")
@options.deposits
@options.file(
    "--spectrum",
    "Light over wavelengths: wavelength_nm, emission, if known efficiency, and parameters of the "
    "scene that vary; its picture is NAME_spectrum of --figure.",
    metavar="EMISSION.csv",
)
@options.file(
    "--quantum-efficiency",
    "The detector's efficiency over wavelengths, for --spectrum.",
    metavar="QE.csv",
)
@options.file(
    "--times",
    "Histogram of the times at which the run's photons arrive (the first 4e7 of more), with their "
    "mean and the first photons; its picture is NAME_times of --figure.",
    "times_file",
    metavar="FILE.csv",
)
@option(
    "--decay-ns",
    Number("NS", 1e-6, 1e9),
    "Decay time of the scintillation, for --times; left out: all light is emitted at once.",
)
@option(
    "--detected",
    Whole(1, 10**9),
    "Detected photons of an event, for the first ones of --times (default: 1000).",
    metavar="COUNT",
)
@defined(
    "--group-index",
    "MEDIUM=INDEX",
    "Group index of a medium for --times, or a material such as CaMoO4@540nm (may "
    "be repeated; default: that of the scene's materials).",
    "group_index",
    example="crystal=2.134",
)
@options.work
def simulate(
    scene,
    overrides,
    method,
    figure,
    map_file,
    depth_mm,
    deposits,
    spectrum,
    quantum_efficiency,
    times_file,
    json_file,
    work,
    **of_times,
) -> None:
    """Light collection efficiency of one configuration of SCENE, with every photon's fate."""
    followed = {"--figure": None if spectrum else figure, "--map": map_file, "--times": times_file}
    of_times = {name: given for name, given in of_times.items() if given}
    _refuse_alone(spectrum, quantum_efficiency, times_file, of_times)
    for flag, given in followed.items():
        if given and method == "modes":
            problem = f"{flag} follows photons, and --method modes none"
            raise InputError(problem, "leave one of them out")
    file = mcrim.read_scene(scene, overrides)
    named = (text.partition("@")[2] for text in of_times.get("group_index", {}).values())
    inputs = [file, *filter(None, [deposits, spectrum, quantum_efficiency])]
    inputs += [file.path.parent / name for name in named if name]
    asked = {"map": map_file, "spectrum": spectrum, "times": times_file}
    endings = ["fates", *(name for name, given in asked.items() if given)]
    wanted = {"--map": (map_file, (".nc",)), "--times": (times_file, (".csv",))}
    written = {flag: place for flag, place in wanted.items() if place[0]}
    showing.refuse_places(json_file, inputs, figure or None, *endings, written=written)
    if figure or times_file:
        _refuse_beforehand(file, work.run, figure, times_file, of_times)
    further: dict[str, mcrim.Result] = {}
    with work.begin() as run:
        light = mcrim.simulate(file, run=run, method=method)
        whole = replace(run, precision=None)
        if map_file and not light.interrupted:
            further["map"] = mcrim.eta_map(file, depth_mm=depth_mm, deposits=deposits, run=whole)
        if spectrum and not light.interrupted:
            whose = {"quantum_efficiency": quantum_efficiency, "method": method}
            further["spectrum"] = mcrim.eta_spectrum(file, spectrum, run=run, **whose)
        if times_file and not light.interrupted:
            whole = replace(whole, photons=light.photons)
            further["times"] = times = mcrim.arrival_times(file, run=whole, **of_times)
    document = light.document | {name: result.document for name, result in further.items()}
    screen = terminal.console(json_file)
    if light.interrupted:
        showing.show(screen, light.description)
        how = "no file was written, and the same line goes on from what the cache has"
        raise KeyboardInterrupt(f"interrupted: {how}")
    terminal.write_json(json_file, document)
    if spectrum:
        screen.line("at the scene's own values, of one wavelength:", style="bold")
    showing.show(screen, light.description, light.draw(figure) if figure else ())
    for name, result in further.items():
        from mcrim_mitsuba.output.codec import csv_lines, netcdf_bytes

        files = [] if name == "spectrum" else [Path(asked[name])]
        if name == "map":
            write_bytes(map_file, netcdf_bytes(result.to_xarray()))
        elif name == "times":
            write_text(times_file, csv_lines(("time_ps", "part", "part_sigma"), times.rows))
        drawn = result.draw(showing.further_picture(figure, name)) if figure else ()
        showing.show(screen, result.description, [*files, *drawn])


def _refuse_alone(spectrum, quantum_efficiency, times_file, of_times: dict) -> None:
    """Refuse options that mean nothing without another."""
    options.refuse_without_map()
    if quantum_efficiency and not spectrum:
        problem = "--quantum-efficiency says what the detector sees of an emission"
        raise InputError(problem, "give --spectrum EMISSION.csv too")
    if of_times and not times_file:
        option = f"--{next(iter(of_times)).replace('_', '-')}"
        raise InputError(f"{option} is for arrival times", "give --times FILE.csv too")


def _refuse_beforehand(file, run, figure, times_file, of_times: dict) -> None:
    """Refuse what figures and arrival times would find wrong after the run."""
    from mcrim_mitsuba.efficiency.arrival_times import group_indices
    from mcrim_mitsuba.efficiency.lighting import refuse_curved
    from mcrim_mitsuba.transport.simulation import Simulation

    loaded = Simulation(file, variant=run.variant, threads=run.threads)
    if figure:
        refuse_curved(loaded)
    if times_file:
        group_indices(loaded, of_times.get("group_index", {}))


_LIST = "such as 0.1,0.5 or 0.01:2:40 (start:stop:count) or log:0.01:2:40"
_OWN = "default: the scene's value"
_COUPLINGS = "such as 1.0,1.46 or 1.0:1.6:7 (start:stop:count) or 1.0,glycerol@540nm"
_MOST_SHOWN = 6
#: Endings of tables.
_TABLES = (".csv", ".txt", ".nc")
#: Axes of every table: option and help, by parameter.
AXES = {
    "n_gap": ("--n-gap", f"Index of the gap: {_COUPLINGS}; {_OWN}."),
    ALPHA_ABS: ("--alpha-abs", f"Absorption, 1/cm: {_LIST}; {_OWN}."),
    ALPHA_SCAT: ("--alpha-scat", f"Scattering, 1/cm: {_LIST}; {_OWN}."),
}
_NO_CAP = (
    f"Photon records come in launches of {LANES:,} photons: numbers are rounded up. Each point "
    "that they say too little about is simulated on its own and may take as many again."
)


def axes_options(function):
    """Options of `AXES`, as texts."""
    for name, (flag, what) in AXES.items():
        function = option(flag, "LIST", what, name)(function)
    return function


def read_axes(
    given: Mapping[str, str | None],
    more: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Values by parameter, and notes on how they were understood.

    `given` are texts of the options of `AXES` by parameter, None of those that were left out,
    `more` those of ``--axis``; paths of spectra start from the folder.

    Raises InputError if none is given, or one is no list of numbers.
    """
    typed = [(f"--axis {name}", name, text) for name, text in (more or {}).items()]
    typed += [(AXES[name][0], name, text) for name in AXES if (text := given[name]) is not None]
    if not typed:
        problem = "a table needs values of one parameter at least"
        options_of_axes = ", ".join(option for option, _ in AXES.values())
        raise InputError(problem, f"give {options_of_axes} or another, such as 0.1,0.5")
    notes = [note for option, _, text in typed for note in told_of_comma(option, text)]
    lists = {
        name: [part.strip() for part in text.split(",")]
        if name == COUNTED
        else parse_list(option, text, name, folder)
        for option, name, text in typed
    }
    return lists, notes


@click.command(short_help="Table of the light collection efficiency of a scene.")
@options.scene
@axes_options
@defined(
    "--axis", "NAME=LIST", "Values of any other parameter of the scene (may be repeated).", "axes"
)
@options.output("FILE", "CSV (.csv, .txt) or NetCDF (.nc) to write; - for the screen.")
@options.defines
@options.photons("2e6 per coupling", at_most=True, further=_NO_CAP)
@options.precision
@options.method
@options.figure("the efficiency over the longest list, a line for each combination of the others")
@options.work
def table(scene, axes, path, overrides, method, figure, json_file, work, **lists_typed) -> None:
    """Table of the light collection efficiency of SCENE, one simulation per coupling.

    Parameters that no list is given for keep the scene's values.
    """
    for name, (flag, _) in AXES.items():
        if name in axes:
            raise InputError(f"--axis {name} has an option of its own", f"give {flag} only")
    with collected(READS) as spectra:
        lists, notes = read_axes(lists_typed, axes, Path(scene).parent)
    refuse_many_points(math.prod(map(len, lists.values())))
    # a name without an ending tells of no other format
    endings = _TABLES if path and Path(path).suffix else ()
    written = {"--output": (path, endings)} if path else {}
    file = mcrim.read_scene(scene, overrides)
    showing.refuse_places(json_file, [file, *spectra], figure, written=written)
    if figure:
        from mcrim_mitsuba.output.light_figures import lines_of_table

        lines_of_table(lists)
    screen = terminal.console(json_file, path)
    screen.say_notes(notes)
    words = {ALPHA_SCAT: "alpha_scat {} /cm", ALPHA_ABS: "alpha_abs {} /cm"}
    words |= {name: f"{name} {{}}" for name in lists if name not in words}
    screen.line("; ".join(words[n].format(_abbreviated(lists[n])) for n in words if n in lists))
    with work.begin() as run:
        tabulated = mcrim.table(file, run=run, method=method, **lists)
    # the table that is named is meant, and the same numbers
    drawn = tabulated.draw(figure, replace=True) if figure else ()
    if path and path.lower().endswith(".nc"):
        from mcrim_mitsuba.output.codec import netcdf_bytes

        write_bytes(path, netcdf_bytes(tabulated.to_xarray()))
    elif path:
        tabulated.write(path)
    terminal.write_json(json_file, tabulated.document)
    description = describe_scene.of_table(tabulated, written=path)
    if path in STDOUT:
        screen.say(description.spent)  # unlike the JSON, the CSV has no place for it
    showing.show(screen, description, drawn)


def _abbreviated(values: list[float] | list[str]) -> str:
    """``0.1, 0.5``; of a long list both ends: ``0.01, 0.06, ..., 2 (40 values)``."""
    texts = [value if isinstance(value, str) else f"{value:.6g}" for value in values]
    if len(texts) > _MOST_SHOWN:
        return f"{texts[0]}, {texts[1]}, ..., {texts[-1]} ({len(texts)} values)"
    return ", ".join(texts)


@click.command(short_help="Run a scene in Mitsuba and in an independent tracer.")
@options.scene
@options.defines
@options.photons("1e6 in the independent tracer, four times as many in Mitsuba")
@options.run
@options.json_output
def crosscheck(scene, overrides, run, json_file) -> int:
    """Run SCENE in Mitsuba and in the independent tracer and compare every fate."""
    file = mcrim.read_scene(scene, overrides)
    showing.refuse_places(json_file, [file])
    with terminal.photon_progress() as report:
        compared = mcrim.crosscheck(file, run=replace(run, progress=report))
    showing.answer(compared, json_file)
    return 0 if compared.agrees else 1


@click.command(short_help="Photograph a scene, whole and taken apart.")
@options.scene
@options.output(
    "PICTURE.png", "The picture, a .png of 1800 x 1150 pixels.", "picture", required=True
)
@options.defines
@option("--samples", Whole(1, 4096), "Light paths per pixel: more are smoother (default: 16).")
@options.run
@options.json_output
def render(scene, picture, overrides, samples, run, json_file) -> None:
    """Photograph SCENE: as it stands, taken apart and, enlarged, at the crystal's lower edge.

    Glass is shown clear: what it scatters and absorbs is left out, and its tint is there to
    tell parts apart.
    """
    file = mcrim.read_scene(scene, overrides)
    showing.refuse_places(json_file, [file], written={"--output": (picture, (".png",))})
    start = time.monotonic()
    with terminal.photon_progress() as report:
        rendering = mcrim.render(file, samples=samples, run=replace(run, progress=report))
    rendering.save(picture)
    seconds = time.monotonic() - start
    terminal.write_json(json_file, rendering.document(picture, seconds))
    screen = terminal.console(json_file)
    screen.line(f"picture of {', '.join(rendering.parts)} written to {picture} ({seconds:.0f} s)")
