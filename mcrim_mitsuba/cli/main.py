"""``mcrim``: the command line. Each verb mirrors one function of the Python API."""

from __future__ import annotations

import importlib
import os

import click

from mcrim_mitsuba import __version__
from mcrim_mitsuba.cli.terminal import run
from mcrim_mitsuba.core.errors import InputError, closest
from mcrim_mitsuba.core.run import seldom_garbage

#: Verbs by the module of this folder that has them.
_VERBS = {
    "lab": ("lab",),
    "other_verbs": ("add", "merge", "paper"),
    "campaign_verbs": tuple("app budget calibrate compare diagnose reduce repair report".split()),
    "scene_verbs": tuple("check crosscheck render scenes schema simulate table".split()),
}
_HOME_OF = {verb: module for module, verbs in _VERBS.items() for verb in verbs}


class _Commands(click.Group):
    """Verbs that are imported when they are used: all of them take a second."""

    def list_commands(self, ctx):
        return sorted(_HOME_OF)

    def get_command(self, ctx, cmd_name):
        if cmd_name not in _HOME_OF:
            return None
        return getattr(importlib.import_module(f"mcrim_mitsuba.cli.{_HOME_OF[cmd_name]}"), cmd_name)

    def resolve_command(self, ctx, args):
        alike = closest(args[0], _HOME_OF) if args and args[0] not in _HOME_OF else None
        if alike and not args[0].startswith("-"):
            ctx.fail(f"No such command '{args[0]}'. Did you mean '{alike}'?")
        return super().resolve_command(ctx, args)


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="mcrim")
@click.pass_context
def mcrim(ctx) -> None:
    """Light collection efficiency and absolute light yield of scintillators (MCRIM).

    Lengths are in mm, coefficients in 1/cm, energies in keV.
    """
    try:
        os.getcwd()
    except FileNotFoundError:
        problem = "the folder you are in has been removed"
        raise InputError(problem, "go to another one (cd) and run it again") from None
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault."""
    seldom_garbage()
    return run(mcrim, "mcrim", arguments)
