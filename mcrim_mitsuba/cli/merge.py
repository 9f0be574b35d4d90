"""``mcrim merge``: put the parts of an array job together."""

from __future__ import annotations

import os
from pathlib import Path

import click

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.runs.array_job import DEFAULT_FOLDER, MergingExecutor, UnitFolder
from mcrim_mitsuba.runs.cache import other_version
from mcrim_mitsuba.runs.executors import use_executor

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
    mcrim = context.find_root().command
    _refuse_other_verbs(units, command, mcrim, context)
    _refuse_missing(units, command)
    _refuse_other_versions(units, command)
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


def _refuse_other_verbs(
    units: UnitFolder, command: dict, mcrim: click.Group, context: click.Context
) -> None:
    """Refuse what takes no ``--unit``: nobody has run parts of it."""
    verb: click.Command | None = mcrim
    words = iter(command["arguments"])
    while isinstance(verb, click.Group):
        verb = verb.get_command(context, next(words, ""))
    if verb is None or all(option.name != "unit" for option in verb.params):
        problem = "the folder holds a command that has no parts"
        raise InputError(problem, "remove it and run the parts again", path=units.path)


def _refuse_missing(units: UnitFolder, command: dict) -> None:
    missing = units.missing()
    if missing:
        named = ", ".join(map(str, missing[:_MOST_NAMED]))
        named += ", ..." if len(missing) > _MOST_NAMED else ""
        words = " ".join(command["arguments"])
        raise InputError(
            f"{len(missing)} of {command['parts']} parts are not done: {named}",
            f"run them first: mcrim {words} --unit {missing[0]}/{command['parts']} "
            f"--units {units.path}",
            path=units.path,
        )


def _refuse_other_versions(units: UnitFolder, command: dict) -> None:
    versions = command["versions"]
    wrong = other_version(versions)
    if wrong is not None:
        problem = f"the parts were made with {wrong[0]} {wrong[1]}, here is {wrong[2]}"
        mend = "merge with the same versions, or run the parts again"
        raise InputError(problem, mend, path=units.path)
