"""Runs a command to its exit status; what goes wrong becomes one line."""

from __future__ import annotations

import errno
import signal
import sys
import traceback

import click

from mcrim_mitsuba.characters import visible
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import silence_stdout
from mcrim_mitsuba.work.array_job import PartDoneError

DONE, OUR_FAULT, YOUR_INPUT, INTERRUPTED = 0, 1, 2, 130


def run(command: click.Command, name: str, arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault.

    Parameters
    ----------
    command : click.Command
    name : str
        Who speaks in a line on standard error.
    arguments : list of str, optional
        Without it, those of this process.
    """
    # A batch system's SIGTERM is an interrupt too, and shells let background jobs ignore SIGINT:
    # either way what was done is reported.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        given = sys.argv[1:] if arguments is None else arguments
        status = command.main(
            arguments, prog_name=name, standalone_mode=False, obj={"arguments": given}
        )
        sys.stdout.flush()
        return status if isinstance(status, int) else DONE
    except PartDoneError as part:
        made = f"{part.units} units, {part.photons:,} photons"
        print(f"{name}: this part is done ({made}); mcrim merge puts all parts together")
        return DONE
    except InputError as error:
        return _say(name, str(error), YOUR_INPUT)
    except click.UsageError as error:
        return _say_usage(name, error)
    except (click.Abort, KeyboardInterrupt) as error:
        # click makes an Abort of what was raised
        how_far = str(error.__cause__ or error) or "interrupted before there was a result"
        return _say(name, how_far, INTERRUPTED)
    except BrokenPipeError:
        silence_stdout()
        return DONE
    except click.ClickException as error:
        return _say(name, error.format_message(), YOUR_INPUT)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            return _our_fault(name)
        silence_stdout()
        where = error.filename or "what standard output goes to"
        line = f"{where}: cannot be written ({error.strerror}); free some space and run it again"
        return _say(name, line, YOUR_INPUT)
    except Exception:
        return _our_fault(name)


def _our_fault(name: str) -> int:
    traceback.print_exc()
    return _say(name, "this is our fault, not yours: please report the lines above", OUR_FAULT)


def _say_usage(name: str, error: click.UsageError) -> int:
    """A slip of the command line: what is wrong, and the help that tells more."""
    text = " ".join(error.format_message().split()).rstrip(".")
    if error.ctx is None:
        return _say(name, text, YOUR_INPUT)
    see = f"`{error.ctx.command_path} --help`"
    hint = f" See {see}" if text.endswith("?") else f"; see {see}"
    return _say(error.ctx.command_path, text + hint, YOUR_INPUT)


def _say(who: str, line: str, status: int) -> int:
    # what was typed may hold what steers a terminal
    print(f"{who}: {visible(line)}", file=sys.stderr)
    return status
