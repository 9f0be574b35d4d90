"""Verbs that stand alone: ``mcrim merge``, ``mcrim paper`` and ``mcrim add``."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

import click
from rich.text import Text

from mcrim_mitsuba import effects
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import option
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import STDOUT, make_folder, refuse_to_replace, write_text
from mcrim_mitsuba.core.rounding import capital
from mcrim_mitsuba.effects.trust import execute_allowed
from mcrim_mitsuba.inference.repair import text_for_folder
from mcrim_mitsuba.output.registry import VerbResult
from mcrim_mitsuba.runs.array_job import DEFAULT_FOLDER, MergingExecutor, UnitFolder
from mcrim_mitsuba.runs.cache import other_version
from mcrim_mitsuba.runs.executors import use_executor
from mcrim_mitsuba.scene.scene_file import read_scene

_MOST_NAMED = 12


@click.command(short_help="Put the parts of an array job together.")
@click.argument("folder", default=DEFAULT_FOLDER)
@click.pass_context
def merge(context, folder) -> int:
    """Put the parts of an array job together: the command that was run with --unit K/N.

    It is run once more with the units of FOLDER; what depends on all parts, such as the simulation
    of a fit's end, is simulated now. Its outputs are written where it says, from the folder that
    it was given in.
    """
    units = UnitFolder(Path(folder).absolute())
    command = units.command()
    mcrim = verb = context.find_root().command
    words = iter(command["arguments"])
    while isinstance(verb, click.Group):
        verb = verb.get_command(context, next(words, ""))
    if verb is None or all(option.name != "unit" for option in verb.params):
        problem = "the folder holds a command that has no parts"
        raise InputError(problem, "remove it and run the parts again", path=units.path)
    if missing := units.missing():
        named, parts = ", ".join(map(str, missing[:_MOST_NAMED])), command["parts"]
        named += ", ..." if len(missing) > _MOST_NAMED else ""
        words = f"{' '.join(command['arguments'])} --unit {missing[0]}/{parts}"
        problem = f"{len(missing)} of {parts} parts are not done: {named}"
        mend = f"run them first: mcrim {words} --units {units.path}"
        raise InputError(problem, mend, path=units.path)
    if (wrong := other_version(command["versions"])) is not None:
        problem = f"the parts were made with {wrong[0]} {wrong[1]}, here is {wrong[2]}"
        mend = "merge with the same versions, or run the parts again"
        raise InputError(problem, mend, path=units.path)
    try:
        os.chdir(command["folder"])
    except OSError as error:
        raise InputError(
            f"the parts were run in {command['folder']}, where one cannot go ({error.strerror})",
            "merge on a machine that has this folder",
            path=units.path,
        ) from None
    with use_executor(MergingExecutor(units)):
        return mcrim.main(command["arguments"], prog_name="mcrim", standalone_mode=False)


@click.command(short_help="Reproduce the article: its numbers beside ours.")
@options.folder("Where the figures go: PNG, PDF and CSV.", default="mcrim_paper")
@option(
    "--photons",
    options.PhotonCount(),
    "Photons of each of four efficiency surfaces (default: 8e6); "
    "single configurations get a tenth.",
)
@options.work
def paper(folder, json_file, work) -> None:
    """Reproduce the article behind the method: its numbers beside ours, and its figures.

    That is V. Alenkov et al., JINST 8 (2013) P06002, with Figs. 3 and 4, and Fig. 2 from
    synthetic histograms. Units are the article's: mm, 1/cm, %, keV, photons per keV.
    """
    from mcrim_mitsuba.article.reproduce import described, document_of, reproduce_article

    # before a minute of simulation, not after it
    make_folder(folder)
    showing.refuse_places(json_file, [])
    with work.begin() as run:
        result = reproduce_article(run=run)
    document = document_of(result, result.draw(folder))
    shown = described(result, folder)
    showing.answer(VerbResult(kind="article", shown=shown, numbers=document), json_file)


_COLOURS = {"+": "green", "-": "red", "@": "cyan"}


def _listing() -> str:
    """The catalogue, one line each below the part of the bench."""
    groups = [effect.group for effect in effects.catalogue().values()]
    catalogue = sorted(effects.catalogue().values(), key=lambda effect: groups.index(effect.group))
    wide = max(len(effect.name) for effect in catalogue)
    lines = []
    for effect in catalogue:
        if (heading := f"  {effect.group}:") not in lines:
            lines.append(heading)
        ranges = (
            (p.name, "off by" * bool(p.nominal), f"{p.minimum:g}..{p.maximum:g}", p.unit)
            for p in effect.parameters
        )
        values = "; ".join(" ".join(filter(None, words)) for words in ranges)
        where = "for campaigns only" if effect.edit is None else values or "on or off"
        lines.append(f"    {effect.name:{wide}}  {capital(effect.title)} ({where})")
    return "\b\nThe catalogue:\n" + "\n".join(lines)


@click.command(short_help="Write a scene with an effect in it as a new scene.", epilog=_listing())
@click.argument("effect", shell_complete=options.complete_effects)
@options.scene
@options.output("NEW.xml", "The new scene; - for the screen. Never replaces a file.", required=True)
@options.defined("-D", "NAME=VALUE", "A value of the effect (may be repeated); mm, 1/cm.", "values")
@option(
    "--effects-folder",
    options.Folder("DIR"),
    "Folder of effects of your own (*.py, which are executed).",
    "folder",
)
@options.trust_effects("--effects-folder")
def add(effect, scene, path, values, folder) -> None:
    """Write SCENE with EFFECT in it as a new scene, and show what changed.

    Values that -D does not give are those where a fit begins.
    """
    suffixes = () if path in STDOUT else (".xml",)
    old = read_scene(scene)
    sources = [] if folder is None else Path(folder).glob("*.py")
    showing.refuse_places(None, [old, *sources], written={"--output": (path, suffixes)})
    screen = terminal.console(path)

    def added(trusted: bool) -> str:
        execute_allowed(folder, trusted=trusted)
        return effects.add(effect, old, values, folder)

    text = showing.when_trusted(added, "Effects of somebody else are programs of theirs.")
    new = old.edited(text)
    if path not in STDOUT:
        text = text_for_folder(new, Path(path).parent)
        refuse_to_replace({Path(path): text})
    write_text(path, text)
    if path not in STDOUT:
        read_scene(path)
    before, after = old.source(old.path).decode().splitlines(), text.splitlines()
    for line in difflib.unified_diff(before, after, scene, path, lineterm="", n=2):
        screen.print(Text(line, style=_COLOURS.get(line[0], "")), soft_wrap=True)
    for included in dict.fromkeys(old.included):
        if included not in new.included:
            screen.say(f"note: {included.name}, which the scene included, is now part of it")
    screen.line(f"written to {path}; now let  mcrim check {path}  look at it")
