"""What the verbs share: which places they refuse, and how they show what they found."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.cli.terminal import Screen
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.output.description import Description
from mcrim_mitsuba.output.registry import Result
from mcrim_mitsuba.runs.array_job import MergingExecutor, UnitFolder
from mcrim_mitsuba.runs.executors import current_executor
from mcrim_mitsuba.scene.scene_file import SceneFile

if TYPE_CHECKING:  # it takes a tenth of a second to load
    from mcrim_mitsuba.campaign.campaign import Campaign

_Read = TypeVar("_Read")
#: Outputs by option, each with the suffixes that it may have.
Written = Mapping[str, tuple[str, tuple[str, ...]]]
#: Of pictures after the first.
_ORDINALS = ("second", "third", "fourth", "fifth")


def further_picture(figure: str, ending: str) -> str:
    """Where another picture of ``--figure`` goes: ``fit.png`` gives ``fit_profiles.png``."""
    path = Path(figure)
    return str(path.parent / f"{path.stem}_{ending}{path.suffix}")


def read_campaign(
    campaign: str,
    json_file: str | None,
    figure: str | None = None,
    *endings: str,
    inputs: Iterable[str | Path] = (),
    written: Written | None = None,
):
    """A campaign; outputs are refused as `refuse_places` does, which knows further `inputs`.

    They are looked at before the campaign is read, and again when its files are known.
    """
    refuse_places(json_file, [campaign, *inputs], figure, *endings, written=written, early=True)
    read = when_trusted(
        lambda trusted: mcrim.read_campaign(campaign, trust_effects=trusted),
        "A campaign of somebody else is a program of theirs.",
    )
    refuse_places(json_file, [read, *inputs], figure, *endings, written=written)
    return read


def when_trusted(read: Callable[[bool], _Read], warning: str) -> _Read:
    """What `read` gives; where it executes Python that nobody has allowed yet, the user is asked.

    It is told whether ``--trust-effects`` was given.
    """
    from mcrim_mitsuba.effects.trust import UntrustedEffectsError, trust

    try:
        return read(click.get_current_context().meta[options.TRUST])
    except UntrustedEffectsError as error:
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise
        place = f"{error.place}: " if error.place else ""
        terminal.console("-").say(f"{place}{error.problem}")
        if not click.confirm(f"{warning} Execute it, now and later?", err=True):
            raise
        trust(error.folder, keep=True)
    return read(False)


def refuse_places(
    json_file: str | None,
    inputs: Iterable[str | Path | SceneFile | Campaign],
    figure: str | None = None,
    *endings: str,
    written: Written | None = None,
    early: bool = False,
) -> None:
    """Refuse outputs, also ``--log``, that cannot be written or would replace what is read.

    `inputs` are files that the command reads, of scenes and campaigns all that they are made of;
    an array job's folder is looked at too. `options.FILES` of the command's context keeps the list.
    Beside a figure its numbers are looked at (a table that lies there without a picture is no
    figure's, but perhaps what is read where it is `early` to say), and further pictures by their
    `endings`, as `further_picture` takes them; `written` are other files.

    Raises InputError before any work is done.
    """
    context = click.get_current_context()
    typed = ((read,) if isinstance(read, (str, Path)) else read.files for read in inputs)
    files = context.meta.setdefault(options.FILES, [])
    files += [Path(file) for several in typed for file in several]
    if context.params.get("unit"):
        files = [*files, *UnitFolder(context.params["units"]).files]
    elif isinstance(merging := current_executor(), MergingExecutor):
        files = [*files, *merging.folder.files]
    places: dict[str, str | None] = {"--json": json_file, "--log": context.params.get("log")}
    suffixes: dict[str, tuple[str, ...]] = {}
    beside: list[Path] = []
    for option, (path, wanted) in (written or {}).items():
        places[option], suffixes[option] = path, wanted
    if figure is not None:
        # what draws takes a quarter of a second to load
        from mcrim_mitsuba.output.figure_style import (
            SUFFIXES,
            numbers_beside,
            refuse_table_without_figure,
        )

        pictures = {"--figure": figure}
        for ordinal, ending in zip(_ORDINALS, endings, strict=False):
            pictures[f"the {ordinal} picture of --figure"] = further_picture(figure, ending)
        for option, path in pictures.items():
            places[option], suffixes[option] = path, SUFFIXES
            numbers = numbers_beside(path)
            # a table is the same numbers, and takes their place
            if numbers != Path(places.get("--output") or ""):
                places[f"the numbers of {option.removeprefix('the ')}"] = str(numbers)
                beside.append(numbers)
    refuse_outputs(places, files, suffixes=suffixes)
    for numbers in () if early else beside:
        refuse_table_without_figure(numbers)


def show(screen: Screen, description: Description, drawn: Iterable[Path] = ()) -> None:
    """A result, which figures were drawn of it, and what the reader must know before using it."""
    screen.show(*description.parts)
    if names := [str(path) for path in drawn]:
        from mcrim_mitsuba.output.sentences import together

        screen.line(f"drawn to {together(names)}")
    if description.spent:
        screen.line(description.spent)
    screen.say_notes(description.notes)


def answer(
    result: Result,
    json_file: str | None,
    figure: str | None = None,
    description: Description | None = None,
) -> Screen:
    """Write a result where ``--json`` and ``--figure`` ask for it, and show it.

    It is shown by its own `description` unless another is given.
    """
    terminal.write_json(json_file, result.document)
    drawn = result.draw(figure) if figure else ()
    screen = terminal.console(json_file)
    show(screen, description or result.description, drawn)
    return screen


def command(*words: str | Path) -> str:
    """What to type, such as ``mcrim diagnose 'my campaign.toml'``."""
    return shlex.join(["mcrim", *map(str, words)])
