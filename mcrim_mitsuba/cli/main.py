"""``mcrim``: the command line. Each verb mirrors one function of the Python API."""

from __future__ import annotations

import contextlib
import signal
import sys
import traceback
from collections.abc import Iterator

import click

from mcrim_mitsuba import __version__
from mcrim_mitsuba.cli.add import add
from mcrim_mitsuba.cli.app import app
from mcrim_mitsuba.cli.calibrate import calibrate
from mcrim_mitsuba.cli.check import check
from mcrim_mitsuba.cli.compare import compare
from mcrim_mitsuba.cli.crosscheck import crosscheck
from mcrim_mitsuba.cli.diagnose import diagnose
from mcrim_mitsuba.cli.lab import lab
from mcrim_mitsuba.cli.paper import paper
from mcrim_mitsuba.cli.render import render
from mcrim_mitsuba.cli.repair import repair
from mcrim_mitsuba.cli.report import report
from mcrim_mitsuba.cli.simulate import simulate
from mcrim_mitsuba.cli.table import table
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import silence_stdout

DONE, OUR_FAULT, YOUR_INPUT, INTERRUPTED = 0, 1, 2, 130


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
    check, simulate, table, calibrate, compare, diagnose, add, repair, report, render, app,
    crosscheck, paper, lab,
):  # fmt: skip
    mcrim.add_command(verb)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault."""
    # A batch system's SIGTERM is an interrupt too, and shells let background jobs ignore SIGINT:
    # either way what was done is reported.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        status = mcrim.main(arguments, prog_name="mcrim", standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else DONE
    except InputError as error:
        return _say(str(error), YOUR_INPUT)
    except click.UsageError as error:
        return _say_usage(error)
    except (click.Abort, KeyboardInterrupt):
        return _say("interrupted before there was a result", INTERRUPTED)
    except BrokenPipeError:
        silence_stdout()
        return DONE
    except click.ClickException as error:
        return _say(error.format_message(), YOUR_INPUT)
    except Exception:
        traceback.print_exc()
        return _say("this is our fault, not yours: please report the lines above", OUR_FAULT)


def _say_usage(error: click.UsageError) -> int:
    """A slip of the command line: what is wrong, and the help that tells more."""
    text = " ".join(error.format_message().split()).rstrip(".")
    if error.ctx is None:
        return _say(text, YOUR_INPUT)
    see = f"`{error.ctx.command_path} --help`"
    hint = f" See {see}" if text.endswith("?") else f"; see {see}"
    return _say(text + hint, YOUR_INPUT, error.ctx.command_path)


def _say(line: str, status: int, who: str = "mcrim") -> int:
    print(f"{who}: {line}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
