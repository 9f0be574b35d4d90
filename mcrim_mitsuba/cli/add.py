"""``mcrim add``: a scene with one more physical effect in it."""

from __future__ import annotations

import difflib
from pathlib import Path

import click
from rich.text import Text

from mcrim_mitsuba import effects
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import STDOUT, refuse_to_replace, write_text
from mcrim_mitsuba.core.rounding import capital
from mcrim_mitsuba.effects.trust import execute_allowed
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

_COLOURS = {"+": "green", "-": "red", "@": "cyan"}


def _range(parameter) -> str:
    limits = f"{parameter.minimum:g}..{parameter.maximum:g}"
    words = (parameter.name, "off by" if parameter.nominal else "", limits, parameter.unit)
    return " ".join(filter(None, words))


def _listing() -> str:
    """The catalogue, one line each."""
    catalogue = effects.catalogue().values()
    wide = max(len(effect.name) for effect in catalogue)
    lines = []
    for effect in catalogue:
        values = "; ".join(map(_range, effect.parameters))
        where = "for campaigns only" if effect.edit is None else values or "on or off"
        lines.append(f"  {effect.name:{wide}}  {capital(effect.title)} ({where})")
    return "\b\nThe catalogue:\n" + "\n".join(lines)


@click.command(short_help="Write a scene with an effect in it as a new scene.", epilog=_listing())
@click.argument("effect", shell_complete=options.complete_effects)
@options.scene
@options.output("NEW.xml", "The new scene; - for the screen. Never replaces a file.", required=True)
@click.option(
    "-D",
    "values",
    multiple=True,
    metavar="NAME=VALUE",
    callback=options.read_defines,
    help="A value of the effect (may be repeated); mm, 1/cm.",
)
@click.option(
    "--effects-folder",
    "folder",
    type=options.Folder(),
    metavar="DIR",
    help="Folder of effects of your own (*.py, which are executed).",
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
        refuse_to_replace({Path(path): text})
        _refuse_place(new, Path(path))
    write_text(path, text)
    if path not in STDOUT:
        read_scene(path)
    before = old.source(old.path).decode()
    for line in difflib.unified_diff(
        before.splitlines(), text.splitlines(), scene, path, lineterm="", n=2
    ):
        screen.print(Text(line, style=_COLOURS.get(line[0], "")), soft_wrap=True)
    for included in dict.fromkeys(old.included):
        if included not in new.included:
            screen.say(f"note: {included.name}, which the scene included, is now part of it")
    screen.line(f"written to {path}; now let  mcrim check {path}  look at it")


def _refuse_place(scene: SceneFile, path: Path) -> None:
    """Refuse a folder from which the scene's files are not found."""
    if path.resolve().parent == scene.path.resolve().parent:
        return
    named = [str(e.get("filename") or e.get("value")) for e, _ in scene.naming()]
    named += [file.name for file in scene.included]
    for name in named:
        if not Path(name).is_absolute():
            problem = f"the scene names {name}, which is not found from another folder"
            raise InputError(problem, f"write the new scene into {scene.path.parent}", path=path)
