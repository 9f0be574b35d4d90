"""What commands show (tables, JSON, progress, a log), and how they end."""

from __future__ import annotations

import codecs
import contextlib
import errno
import io
import logging
import os
import re
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FrameType

import click
from rich import progress
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Column
from rich.text import Text

from mcrim_mitsuba.core import files
from mcrim_mitsuba.core.errors import InputError, visible
from mcrim_mitsuba.core.files import STDOUT, silence_stdout
from mcrim_mitsuba.core.run import ENDING_SIGNALS, OWN_MODULES, JobProgress, Parts
from mcrim_mitsuba.output.description import UNLIMITED, Part, renderables, sentence
from mcrim_mitsuba.runs.array_job import PartDoneError
from mcrim_mitsuba.runs.executors import log

Report = Callable[..., None]
#: Seconds between two lines on how far a part is; its end is always written.
_EVERY_S = 10.0
#: What there is more of than this are photons, else trials or tables.
MOST_PIECES = 10_000


@contextlib.contextmanager
def progress_log(path: str) -> Iterator[Report]:
    """A log with the time (UTC) on each line, appended to a file.

    It has a line for every unit that is begun, made, or found in the cache, and lines on how far
    each part is. Raises InputError if the file cannot be written.
    """
    try:
        handler = _Lines(path, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        raise InputError(problem, "let --log name a file", path=path) from None
    form = logging.Formatter("%(asctime)sZ %(message)s", "%Y-%m-%dT%H:%M:%S")
    form.converter = time.gmtime
    handler.setFormatter(form)
    log.addHandler(handler)
    parts: dict[str, tuple[float, float]] = {}

    def report(what: str, done: int, total: int, note: str = "") -> None:
        now = time.monotonic()
        begun, reported = parts.get(what, (now, -_EVERY_S))
        if now - reported >= _EVERY_S or done >= total:
            parts[what] = begun, now
            log.info("%s", _line(what, done, total, note, now - begun))

    try:
        yield report
    finally:
        log.removeHandler(handler)
        handler.close()


class _Lines(logging.FileHandler):
    """A file that may fill up, or a pipe whose reader leaves: the work goes on without it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, if it can be written now."""
        with contextlib.suppress(OSError):  # of opening what `handleError` has closed
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """This line is lost; the next one is tried again."""
        with contextlib.suppress(OSError):
            self.close()

    def _open(self) -> io.TextIOWrapper:
        descriptor = files.open_to_write(Path(self.baseFilename), os.O_CREAT | os.O_APPEND)
        return open(descriptor, "a", encoding=self.encoding, errors=self.errors)


def _line(what: str, done: int, total: int, note: str, seconds: float) -> str:
    """``simulation: 2.6e+06 of 4.7e+07 photons, 12 of 180 units, 90 s left``."""
    if total > MOST_PIECES:
        what = f"{what}: {done:.3g} of {total:.3g} photons"
    elif total > 1:
        what = f"{what}: {done} of {total}"
    begun = 0 < done < total and seconds > 0
    left = f"{seconds * (total - done) / done:.0f} s left" if begun else ""
    return ", ".join(filter(None, (what, note, left)))


# What commands show: tables, JSON, progress.


class Screen(Console):
    """Where a command writes for people; see `console`."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        """What is shown, with characters that would steer the terminal as their codes."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else visible(text, keep="\n"), style, control)

    @property
    def room(self) -> int:
        """Characters of a line; in a terminal, sentences are broken between words."""
        return min(self.width, UNLIMITED - 1) if self.is_terminal else _piped_width()

    def say(self, line: str) -> None:
        """One line that must be seen: on standard error where standard output is a file's."""
        # A new one: this one keeps everything else off standard error.
        (Screen(stderr=True, highlight=False) if self.stderr else self).line(line)

    def line(  # type: ignore[override]  # rich asks only the console of a Live for empty lines
        self, text: str, style: str = ""
    ) -> None:
        """One sentence as it is, labels that look like markup too."""
        self.print(sentence(text, self.room, style), soft_wrap=True)

    def show(self, *parts: Part) -> None:
        """Tables and sentences of a result."""
        for shown in renderables(parts, self.room):
            self.print(shown, soft_wrap=isinstance(shown, Text))

    def say_notes(self, notes: Iterable[str]) -> None:
        """What the reader must know before using the numbers, one line each."""
        for note in notes:
            self.say(f"note: {note}")


def console(*files: str | None) -> Screen:
    """Where a command writes for people: standard output, unless one of its `files` goes there."""
    if any(file in STDOUT for file in files):
        return Screen(stderr=True, highlight=False, quiet=True)
    # A pipe or a file has no width, and tables are never cut there, unless COLUMNS says so.
    return Screen(highlight=False, width=None if sys.stdout.isatty() else _piped_width())


def write_json(json_file: str | None, result: dict) -> None:
    """Write a result where ``--json`` asks for it.

    Numbers that are not finite become null: JSON has no others.
    """
    if json_file is None:
        return
    text = files.json_text(result, indent=2) + "\n"
    # names of files that are no UTF-8 hold what only JSON's own escapes can write
    files.write_text(json_file, text.encode(errors="backslashreplace").decode())


class _Progress(progress.Progress):
    """Bars below something that grows while they run."""

    above: RenderableType | None = None

    def get_renderables(self) -> Iterator[RenderableType]:
        if self.above is not None:
            yield self.above
        yield from super().get_renderables()


#: Characters of a line, from the environment.
_WIDTH = re.compile(r"[1-9][0-9]{1,3}")


def _piped_width() -> int:
    """Characters of a line in a pipe or a file: as many as wanted, but for what COLUMNS says."""
    columns = os.environ.get("COLUMNS", "")
    return min(int(columns), UNLIMITED) if _WIDTH.fullmatch(columns) else UNLIMITED


class _Words(progress.TextColumn):
    """Words that are cut in a narrow terminal, before any number beside them is."""

    def __init__(self, text_format: str) -> None:
        # rich takes room from columns that may wrap, and from others only if that is not enough
        super().__init__(text_format, table_column=Column(no_wrap=False))

    def render(self, task: progress.Task) -> Text:
        words = super().render(task)
        words.no_wrap, words.overflow = True, "ellipsis"
        return words


@contextlib.contextmanager
def photon_progress(
    above: RenderableType | None = None, log: str | None = None, parts: Parts = ()
) -> Iterator[Report]:
    """One bar for all `parts` of a command, on standard error, silent in a pipe.

    What stands `above` it is shown again and again as it changes; the progress is appended to a
    `log`, unit by unit. Raises InputError if that cannot be written.
    """
    bar = _Progress(
        _Words("{task.description}"),
        progress.BarColumn(20),
        progress.TextColumn("{task.percentage:>3.0f} %"),
        _Words("{task.fields[note]}"),
        progress.TimeElapsedColumn(),
        progress.TextColumn("{task.fields[job].left}"),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    bar.above, job = above, JobProgress(parts)
    tasks: list[progress.TaskID] = []

    with contextlib.ExitStack() as opened:
        written = None if log is None else opened.enter_context(progress_log(log))

        def report(what: str, done: int, total: int, note: str = "") -> None:
            shown = f"{done / 1e6:.3g} of {total / 1e6:.3g} million photons, {note}"
            shown = shown if total >= MOST_PIECES else note
            job.tell(what, done, total)
            if not tasks:
                tasks.append(bar.add_task(what, total=1.0, note="", job=job))
            bar.update(tasks[0], description=what, completed=job.done, note=shown)
            if written is not None:
                written(what, done, total, note)

        opened.enter_context(bar)
        yield report


# Runs a command to its exit status; what goes wrong becomes one line.

#: Exit statuses.
DONE = 0
OUR_FAULT = 1
YOUR_INPUT = 2
INTERRUPTED = 130
#: What helps where a file takes no more.
_ROOM = dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space")
_ROOM[errno.EFBIG] = files.LIFT_LIMIT
_OUTPUT = "what standard output goes to"


def run(command: click.Command, name: str, arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status: 0 done, 2 wrong input, 1 our fault.

    Where a signal ended it, it is 128 and the signal's number: 130 of Ctrl-C, 143 of SIGTERM.
    `name` says who speaks in a line on standard error; `arguments` are those of this process,
    unless others are given.
    """
    received: list[int] = []
    written: list[Path] = []
    interrupts: tuple[type[BaseException], ...] = click.Abort, KeyboardInterrupt

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupts
        received.append(number)
        interrupts = (BaseException,)  # libraries make anything of it
        raise _InterruptError

    # A batch system's SIGTERM is an interrupt too, and shells let background jobs ignore SIGINT:
    # either way what was done is reported. Only nohup means it.
    for number in ENDING_SIGNALS:
        if number in (signal.SIGINT, signal.SIGTERM) or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        if arguments is None:
            _open_streams()
        given = sys.argv[1:] if arguments is None else arguments
        with files.collected(files.WRITES) as written:
            status = command.main(
                arguments, prog_name=name, standalone_mode=False, obj={"arguments": given}
            )
        sys.stdout.flush()
        return status if isinstance(status, int) else DONE
    except PartDoneError as part:
        work_done = f"{part.units} units, {part.photons:,} photons"
        print(f"{name}: this part is done ({work_done}); mcrim merge puts all parts together")
        return DONE
    except interrupts as error:
        _ignore_signals()
        # Python ends as if SIGINT had killed it where a KeyboardInterrupt left text that is
        # executed, as dataclasses do: whatever is executed then makes it forget that
        eval("0")
        status = 128 + received[0] if received else INTERRUPTED
        return _say(name, _how_far(error, written), status)
    except InputError as error:
        return _say(name, str(error), YOUR_INPUT)
    except click.UsageError as error:
        return _say_usage(name, error)
    except click.ClickException as error:
        return _say(name, error.format_message(), YOUR_INPUT)
    except Exception as error:
        for frame, lineno in reversed(list(traceback.walk_tb(error.__traceback__))):
            # what a user's effect does, when it acts, is not checked before
            if str(frame.f_globals.get("__name__")).startswith(OWN_MODULES):
                file, problem = frame.f_code.co_filename, f"{type(error).__name__}: {error}"
                refusal = InputError(problem, "mend this line", path=file, line=lineno)
                return _say(name, str(refusal), YOUR_INPUT)
        if not isinstance(error, OSError) or error.errno not in _ROOM:
            traceback.print_exc()
            line = "this is our fault, not yours: please report the lines above"
            return _say(name, line, OUR_FAULT)
        silence_stdout()
        where, mend = error.filename or "a temporary file", _ROOM[error.errno]
        line = f"{where}: cannot be written ({error.strerror}); {mend} and run it again"
        return _say(name, line, YOUR_INPUT)
    finally:
        if arguments is None:
            _ignore_signals()


def _how_far(error: BaseException, written: list[Path]) -> str:
    """What an interrupted command had done: what it says itself, or which files it had written."""
    if written:
        return f"interrupted when {', '.join(map(str, written))} had been written"
    # click makes an Abort of what was raised
    cause = error.__cause__ if isinstance(error, click.Abort) else error
    words = str(cause) if isinstance(cause, KeyboardInterrupt) else ""
    return words or "interrupted before there was a result"


class _InterruptError(KeyboardInterrupt):
    """An interrupt; Python's own, where it ends an `exec`, lets the process die of SIGINT."""


class _Stream(io.TextIOWrapper):
    """A standard stream: the command goes on to its end when its reader leaves, as `head` does.

    What standard error does not take is lost, and no result with it.
    """

    def write(self, text: str) -> int:
        with self._judged():
            super().write(text)
        return len(text)

    def flush(self) -> None:
        with self._judged():
            super().flush()

    @contextlib.contextmanager
    def _judged(self) -> Iterator[None]:
        """Let errors of output pass as they are meant: a reader that left ends it in silence."""
        try:
            yield
        except OSError as error:
            if self.fileno() == 1 and isinstance(error, BrokenPipeError):
                silence_stdout()
            elif self.fileno() == 1:
                error.filename = _OUTPUT
                raise


def _open_streams() -> None:
    """Open the standard streams anew, so that nothing is lost in silence.

    Those that were closed lead nowhere: else the next files would get their numbers, and with that
    what libraries say. Output that takes a part only is an error, even without Python's buffers.
    Raises InputError if nothing can be written to standard output.
    """
    problem = None
    try:
        os.write(1, b"")  # what is closed, or full for ever, refuses even that
    except OSError as error:
        mend = _ROOM.get(error.errno or 0, "send it to a file, or to /dev/null,")
        mend += " and run it again"
        problem = InputError(f"cannot be written ({error.strerror})", mend, path=_OUTPUT)
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(descriptor)
    sys.stdin = sys.stdin or open(0, closefd=False)
    for number, name in enumerate(("stdout", "stderr"), 1):
        encoding = getattr(getattr(sys, name), "encoding", "utf-8")
        if codecs.lookup(encoding).name == "ascii":  # of the locale POSIX; it would end at a ±
            encoding = "utf-8"
        binary, by_line = open(number, "wb", closefd=False), number == 2 or os.isatty(number)
        setattr(sys, name, _Stream(binary, encoding, "backslashreplace", line_buffering=by_line))
    if problem is not None:
        raise problem


def _ignore_signals() -> None:
    """Who is impatient interrupts what ends already, and whose status is known."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _say_usage(name: str, error: click.UsageError) -> int:
    """A slip of the command line: what is wrong, and the help that tells more."""
    text = " ".join(error.format_message().split()).rstrip(".")
    if isinstance(error, click.NoSuchOption) and error.option_name[1:].isdigit():
        text += ": write -- before a number below 0"
    if error.ctx is None:
        return _say(name, text, YOUR_INPUT)
    see = f"`{error.ctx.command_path} --help`"
    hint = f" See {see}" if text.endswith("?") else f"; see {see}"
    return _say(error.ctx.command_path, text + hint, YOUR_INPUT)


def _say(who: str, line: str, status: int) -> int:
    # what was typed may hold what steers a terminal
    print(f"{who}: {visible(line)}", file=sys.stderr)
    return status
