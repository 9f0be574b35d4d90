"""What commands show: tables, JSON, progress."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from mcrim_mitsuba.characters import visible
from mcrim_mitsuba.cli.progress_log import MOST_PIECES, Report, progress_log
from mcrim_mitsuba.files.writing import STDOUT, silence_stdout, write_text

WIDTH_OF_A_PIPE = 200


class Screen(Console):
    """Where a command writes for people; see `console`.

    Its reader may leave, as `head` does: the command goes on to its end.
    """

    def on_broken_pipe(self) -> None:
        self.quiet = True
        if not self.stderr:
            silence_stdout()

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        """What is shown, with characters that would steer the terminal as their codes."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else visible(text, keep="\n"), style, control)

    def say(self, line: str) -> None:
        """One line that must be seen: on standard error where standard output is a file's."""
        # A new one: this one keeps everything else off standard error.
        place = Screen(stderr=True, highlight=False) if self.stderr else self
        place.print(line, markup=False, emoji=False, soft_wrap=True)

    def line(  # type: ignore[override]  # rich asks only the console of a Live for empty lines
        self, text: str, style: str = ""
    ) -> None:
        """One sentence as it is, labels that look like markup too: terminals wrap it, pipes not."""
        self.print(Text(text, style=style), soft_wrap=True)

    def say_notes(self, notes: Iterable[str]) -> None:
        """What the reader must know before using the numbers, one line each."""
        for note in notes:
            self.say(f"note: {note}")


def console(*files: str | None) -> Screen:
    """Where a command writes for people: standard output, unless one of its `files` goes there."""
    if any(file in STDOUT for file in files):
        return Screen(stderr=True, highlight=False, quiet=True)
    # A pipe or a file has no width: tables are never cut there.
    return Screen(highlight=False, width=None if sys.stdout.isatty() else WIDTH_OF_A_PIPE)


def write_json(json_file: str | None, result: dict) -> None:
    """Write a result where ``--json`` asks for it.

    Numbers that are not finite become null: JSON has no others.
    """
    if json_file is None:
        return
    text = json.dumps(_plain(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # names of files that are no UTF-8 hold what only JSON's own escapes can write
    write_text(json_file, text.encode(errors="backslashreplace").decode())


def _plain(value):
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, bool | int | str) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None


def table(title: str, *columns: str) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(title=title or None, title_justify="left", title_style="bold")
    for number, column in enumerate(columns):
        made.add_column(Text(visible(column)), justify="left" if number == 0 else "right")
    return made


def add_literal_row(table: Table, *cells: str, style: str = "") -> None:
    """A row whose cells are shown as they are, what looks like markup or an emoji too."""
    table.add_row(*(Text(visible(cell, keep="\n")) for cell in cells), style=style)


class _Progress(Progress):
    """Bars below something that grows while they run."""

    above: RenderableType | None = None

    def get_renderables(self) -> Iterator[RenderableType]:
        if self.above is not None:
            yield self.above
        yield from super().get_renderables()


@contextlib.contextmanager
def photon_progress(
    above: RenderableType | None = None, log: str | None = None
) -> Iterator[Report]:
    """A progress bar on standard error, silent in a pipe.

    Parameters
    ----------
    above : renderable, optional
        Shown over the bar, again and again as it changes.
    log : str, optional
        File that the progress is appended to, unit by unit.

    Yields
    ------
    Progress

    Raises
    ------
    InputError
        If the log cannot be written.
    """
    bar = _Progress(
        TextColumn("{task.description}"),
        BarColumn(20),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[photons]}{task.fields[note]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    bar.above = above
    tasks: dict[str, TaskID] = {}

    with contextlib.ExitStack() as opened:
        written = None if log is None else opened.enter_context(progress_log(log))

        def report(what: str, done: int, total: int, note: str = "") -> None:
            photons = _photons(done, total)
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total, note=note, photons=photons)
            bar.update(tasks[what], completed=done, total=total, note=note, photons=photons)
            if written is not None:
                written(what, done, total, note)

        opened.enter_context(bar)
        yield report


def _photons(done: int, total: int) -> str:
    """``8.7 of 20 million photons, ``; nothing of what is counted in other things."""
    if total < MOST_PIECES:
        return ""
    return f"{done / 1e6:.3g} of {total / 1e6:.3g} million photons, "
