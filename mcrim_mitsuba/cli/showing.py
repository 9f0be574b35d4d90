"""What the verbs share: which places they refuse, and how they show what they found."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.cli.terminal import Screen
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import is_there
from mcrim_mitsuba.output.described import Described

#: How ``--photons`` is explained: the default, and what it counts.
PHOTONS = "2.6e5 of each simulation with an effect in the scene"
FURTHER_PHOTONS = "Configurations as they are get nine times as many."


_ORDINALS = ("first", "second", "third")


def further_picture(figure: str | None, ending: str) -> str | None:
    """Where another picture of ``--figure`` goes: ``fit.png`` gives ``fit_profiles.png``."""
    if figure is None:
        return None
    path = Path(figure)
    return str(path.parent / f"{path.stem}_{ending}{path.suffix}")


def read_campaign(
    campaign: str,
    json_file: str | None,
    *figures: str | None,
    further: Mapping[str, tuple[str | None, tuple[str, ...]]] | None = None,
):
    """A campaign, and the files that were read for it; outputs are refused as `refuse_places` does.

    They are looked at before the campaign is read, and again when its files are known.
    """
    refuse_places(json_file, [campaign], *figures, further=further)
    read, files = read_with_files(campaign)
    refuse_places(json_file, files, *figures, further=further)
    return read, files


def read_with_files(campaign: str):
    """A campaign, and the files that were read for it."""
    read = mcrim.read_campaign(campaign)
    scene = read.scene
    raw = () if read.raw is None else read.raw.files
    return read, [
        campaign, scene.path, *scene.included, read.measurements.path,
        *(file.path for file in raw),
    ]  # fmt: skip


def refuse_places(
    json_file: str | None,
    inputs: Iterable[str | Path],
    *figures: str | None,
    further: Mapping[str, tuple[str | None, tuple[str, ...]]] | None = None,
) -> None:
    """Refuse outputs that could not be written or would replace what is read.

    Parameters
    ----------
    json_file : str or None
    inputs : iterable of str or Path
        Files that the command reads.
    figures : str or None
        Pictures; the numbers beside them are looked at too.
    further : mapping of str to (str or None, tuple of str)
        Other files by option, each with the suffixes that it may have.

    Raises
    ------
    InputError
        Before any work is done.
    """
    from mcrim_mitsuba.core.files import refuse_outputs
    from mcrim_mitsuba.output.figure_style import SUFFIXES, numbers_beside

    places: dict[str, str | None] = {"--json": json_file}
    suffixes: dict[str, tuple[str, ...]] = {}
    for option, (path, wanted) in (further or {}).items():
        places[option], suffixes[option] = path, wanted
    for count, path in enumerate(figures):
        if path is not None:
            option = "--figure" if count == 0 else f"the {_ORDINALS[count]} picture of --figure"
            places[option], suffixes[option] = path, SUFFIXES
            places[f"the numbers of {option.removeprefix('the ')}"] = str(numbers_beside(path))
    refuse_outputs(places, inputs, suffixes=suffixes)


def refuse_to_replace(written: Mapping[str, tuple[str, tuple[str, ...]]]) -> None:
    """Refuse outputs that are there already: a campaign or a scene may hold somebody's work.

    Parameters
    ----------
    written : mapping of str to (str, tuple of str)
        As `refuse_places` takes `further`.

    Raises
    ------
    InputError
    """
    for path, _ in written.values():
        if is_there(Path(path)) and Path(path).is_file():
            raise InputError(
                "this file exists already", "name another, or remove it first", path=path
            )


def show(screen: Screen, described: Described, drawn: Iterable[Path] = ()) -> None:
    """A result, which figures were drawn of it, and what the reader must know before using it."""
    screen.show(*described.parts)
    say_drawn(screen, drawn)
    if described.spent:
        screen.line(described.spent)
    screen.say_notes(described.notes)


def answer(found: mcrim.Answer, json_file: str | None, figure: str | None = None) -> Screen:
    """Write an answer where ``--json`` and ``--figure`` ask for it, and show it."""
    terminal.write_json(json_file, found.document)
    drawn = found.draw(figure) if figure else ()
    screen = terminal.console(json_file)
    show(screen, found.described, drawn)
    return screen


def say_drawn(screen: Screen, files: Iterable[Path]) -> None:
    """Which figures were written."""
    if names := [str(path) for path in files]:
        from mcrim_mitsuba.output.findings import together

        screen.line(f"drawn to {together(names)}")


def command(*words: str | Path) -> str:
    """What to type, such as ``mcrim diagnose 'my campaign.toml'``."""
    return shlex.join(["mcrim", *map(str, words)])
