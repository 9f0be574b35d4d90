"""``mcrim``: the command line. Each verb mirrors one function of the Python API."""

from __future__ import annotations

import signal
import sys
import traceback

import click

from mcrim_mitsuba import __version__
from mcrim_mitsuba.cli.calibrate import calibrate
from mcrim_mitsuba.cli.check import check
from mcrim_mitsuba.cli.crosscheck import crosscheck
from mcrim_mitsuba.cli.paper import paper
from mcrim_mitsuba.cli.simulate import simulate
from mcrim_mitsuba.cli.table import table
from mcrim_mitsuba.errors import InputError

DONE, OUR_FAULT, YOUR_INPUT, INTERRUPTED = 0, 1, 2, 130


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="mcrim")
def mcrim() -> None:
    """Light collection efficiency and absolute light yield of scintillators (MCRIM).

    Lengths are in mm, coefficients in 1/cm, energies in keV.
    """


for verb in (check, simulate, table, calibrate, crosscheck, paper):
    mcrim.add_command(verb)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault."""
    # A batch system's SIGTERM is an interrupt too, and shells let background jobs ignore SIGINT:
    # either way what was done is reported.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        status = mcrim.main(arguments, prog_name="mcrim", standalone_mode=False)
        return status if isinstance(status, int) else DONE
    except InputError as error:
        return _say(str(error), YOUR_INPUT)
    except click.UsageError as error:
        place = f"{error.ctx.command_path}: " if error.ctx else ""
        hint = f"; see `{error.ctx.command_path} --help`" if error.ctx else ""
        return _say(" ".join(f"{place}{error.format_message()}{hint}".split()), YOUR_INPUT)
    except (click.Abort, KeyboardInterrupt):
        return _say("interrupted before there was a result", INTERRUPTED)
    except BrokenPipeError:
        # the reader, `head` perhaps, has seen enough
        sys.stderr.close()
        return DONE
    except click.ClickException as error:
        return _say(error.format_message(), YOUR_INPUT)
    except Exception:
        traceback.print_exc()
        return _say("this is our fault, not yours: please report the lines above", OUR_FAULT)


def _say(line: str, status: int) -> int:
    print(f"mcrim: {line}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
