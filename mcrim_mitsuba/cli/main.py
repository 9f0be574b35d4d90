"""``mcrim``: the command line. Each verb mirrors one function of the Python API."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import click

from mcrim_mitsuba import __version__
from mcrim_mitsuba.cli.add import add
from mcrim_mitsuba.cli.app import app
from mcrim_mitsuba.cli.budget import budget
from mcrim_mitsuba.cli.calibrate import calibrate
from mcrim_mitsuba.cli.check import check
from mcrim_mitsuba.cli.compare import compare
from mcrim_mitsuba.cli.crosscheck import crosscheck
from mcrim_mitsuba.cli.diagnose import diagnose
from mcrim_mitsuba.cli.lab import lab
from mcrim_mitsuba.cli.merge import merge
from mcrim_mitsuba.cli.paper import paper
from mcrim_mitsuba.cli.reduce import reduce
from mcrim_mitsuba.cli.render import render
from mcrim_mitsuba.cli.repair import repair
from mcrim_mitsuba.cli.report import report
from mcrim_mitsuba.cli.running import DONE, run
from mcrim_mitsuba.cli.scenes import scenes
from mcrim_mitsuba.cli.simulate import simulate
from mcrim_mitsuba.cli.table import table
from mcrim_mitsuba.files.writing import silence_stdout


class _Commands(click.Group):
    """A group that ends well when the reader of its output leaves; click would exit with 1."""

    def make_context(self, *arguments, **options):
        with _reader_may_leave():
            return super().make_context(*arguments, **options)

    def invoke(self, ctx):
        with _reader_may_leave():
            return super().invoke(ctx)


@contextlib.contextmanager
def _reader_may_leave() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        silence_stdout()
        raise click.exceptions.Exit(DONE) from None


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
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


for verb in (
    check, simulate, table, reduce, calibrate, compare, diagnose, add, repair, report, render, app,
    crosscheck, budget, paper, merge, lab, scenes,
):  # fmt: skip
    mcrim.add_command(verb)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault."""
    return run(mcrim, "mcrim", arguments)


if __name__ == "__main__":
    sys.exit(main())
