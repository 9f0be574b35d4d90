"""What a result looks like, said once: tables and sentences, shown by a terminal or a notebook.

A description holds texts as people read them and, in the cells of its tables, the numbers behind
them. `describe_scene`, `describe_campaign` and `describe_laboratory` make one of every result;
`text`, `renderables` (of rich), `html` and `Table.frame` show it.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import compress
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len
from rich.console import Console, JustifyMethod, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from mcrim_mitsuba.core.errors import visible
from mcrim_mitsuba.core.rounding import pdg

if TYPE_CHECKING:
    import pandas

#: Characters of what has no width of its own, such as a pipe: its sentences are never broken.
UNLIMITED = 200


@dataclass(frozen=True)
class Column:
    """A column of a table; all but the first are numbers, unless they stand at the left."""

    #: As it is shown, with the unit.
    title: str
    #: As a data frame has it; the error of NAME is NAME_sigma. Empty: as the title.
    name: str = ""
    #: How a record's value is shown, as of `shown`; ± beside its error, the attribute NAME_sigma.
    form: str | Callable[[Any], str] = ""
    _: KW_ONLY
    #: An attribute of records, or what makes a text or a cell of one. Empty: `name`, or the title.
    of: str | Callable[[Any], Any] = ""
    left: bool = False
    #: In small print: what has to be typed, such as an id.
    small: bool = False
    #: Of data frames alone.
    hidden: bool = False

    def cell(self, record: Any) -> Cell:
        """What it shows of a record."""
        attribute = self.of or self.name or self.title
        value = attribute(record) if callable(attribute) else attrgetter(attribute)(record)
        if isinstance(value, Cell):
            return value
        if self.form == "±":
            return measured(value, attrgetter(f"{attribute}_sigma")(record))
        return shown(value, self.form) if self.form else cell_of(value)


@dataclass(frozen=True)
class Cell:
    """A text and what it stands for; several things as a tuple, each a row of a data frame."""

    text: str
    value: object = None
    #: Standard error of the value, where the text has one.
    sigma: float | tuple[float | None, ...] | None = None


@dataclass(frozen=True)
class TableRow:
    """A row of a table."""

    cells: tuple[Cell, ...]
    #: Whether it is to be looked at first.
    strong: bool = False
    #: Whether data frames alone have it.
    hidden: bool = False
    #: Whether it does not count.
    weak: bool = False


@dataclass(frozen=True)
class Table:
    """A table with its title, which may be empty."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    #: Rows below a rule.
    sums: tuple[TableRow, ...] = ()

    @property
    def seen(self) -> Table:
        """What people are shown of it."""
        seen = [not column.hidden for column in self.columns]
        parts = ([line for line in lines if not line.hidden] for lines in (self.rows, self.sums))
        rows, sums = (
            tuple(replace(line, cells=tuple(compress(line.cells, seen))) for line in lines)
            for lines in parts
        )
        return Table(self.title, tuple(compress(self.columns, seen)), rows, sums)

    def frame(self) -> pandas.DataFrame:
        """Numbers of the rows, errors in columns of their own: ``NAME_sigma`` after ``NAME``."""
        import pandas

        columns: dict[str, list] = {}
        for place, column in enumerate(self.columns):
            name, cells = column.name or column.title, [row.cells[place] for row in self.rows]
            columns[name] = [cell.value for cell in cells]
            if any(cell.sigma is not None for cell in cells):
                columns[f"{name}_sigma"] = [cell.sigma for cell in cells]
        several = [n for n, values in columns.items() if any(isinstance(v, tuple) for v in values)]
        frame = pandas.DataFrame(columns)
        if several:
            frame = frame.explode(several, ignore_index=True).infer_objects()
        # what is known nowhere is a number that is none
        return frame.astype(dict.fromkeys(frame.columns[frame.isna().all()], float))


@dataclass(frozen=True)
class Sentence:
    """A line of text."""

    text: str
    #: Whether it is to be looked at first.
    strong: bool = False


#: What a description is made of.
Part = Table | Sentence


@dataclass(frozen=True)
class Description:
    """A result as it is shown."""

    #: What it is, in a few words.
    title: str
    parts: tuple[Part, ...]
    #: What it rests on: photons, seed, time.
    spent: str = ""
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...] = ()

    @property
    def whole(self) -> tuple[Part, ...]:
        """Its parts, and below them what it rests on and its notes."""
        lines = (self.spent, *(f"note: {note}" for note in self.notes))
        return (*self.parts, *(Sentence(line) for line in lines if line))

    @property
    def tables(self) -> dict[str, Table]:
        """By title."""
        return {part.title: part for part in self.parts if isinstance(part, Table)}


def table(
    title: str,
    columns: Iterable[object],
    rows: Iterable[TableRow | Iterable[object]],
    sums: Iterable[TableRow | Iterable[object]] = (),
) -> Table:
    """A table from columns, or their titles, and rows of texts or cells."""
    above, below = (
        tuple(line if isinstance(line, TableRow) else row(*line) for line in lines)
        for lines in (rows, sums)
    )
    return Table(title, _columns(columns), above, below)


def row(*cells: object, strong: bool = False, hidden: bool = False) -> TableRow:
    """A row; a text stands for itself."""
    return TableRow(tuple(map(cell_of, cells)), strong, hidden)


def cell_of(content: object) -> Cell:
    """A cell; a text stands for itself."""
    return content if isinstance(content, Cell) else Cell(str(content), content or None)


def records(
    title: str,
    columns: Iterable[object],
    items: Iterable[Any],
    *,
    strong: Callable[[Any], bool] = lambda _: False,
    weak: Callable[[Any], bool] = lambda _: False,
) -> Table:
    """A table of records, a row each: every column says what it shows of them.

    Those that are `strong` are to be looked at first, and `weak` ones do not count.
    """
    heads = _columns(columns)
    rows = (
        TableRow(tuple(column.cell(x) for column in heads), strong(x), weak=weak(x)) for x in items
    )
    return Table(title, heads, tuple(rows))


def _columns(columns: Iterable[object]) -> tuple[Column, ...]:
    """Columns; a text is a title."""
    return tuple(c if isinstance(c, Column) else Column(str(c)) for c in columns)


def measured(value: float, sigma: float | None, factor: float = 1.0) -> Cell:
    """A value with its error, both times a factor: 100 for per cent."""
    value, sigma = factor * value, None if sigma is None else factor * sigma
    return Cell(pdg(value, sigma), value, sigma)


def shown(value: Any, form: str | Callable[[Any], str]) -> Cell:
    """A number by a format, which has nothing to show where there is none, or by a function."""
    if callable(form):
        return Cell(form(value), value)
    return Cell("" if value is None else format(value, form), value)


#: What `described` takes: parts, texts of sentences, nothing, or several of these.
Piece = Part | str | None | Iterable[Any]


def described(
    title: str, *pieces: Piece, spent: str = "", notes: Iterable[str] = ()
) -> Description:
    """A description; a text is a sentence, and tables without rows are left out."""
    return Description(title, tuple(parts_of(pieces)), spent, tuple(notes))


def parts_of(pieces: Iterable[Piece]) -> Iterator[Part]:
    """The parts among some pieces, in their order."""
    for piece in pieces:
        if isinstance(piece, Table):
            yield from [piece] if piece.rows else ()
        elif isinstance(piece, Sentence):
            yield piece
        elif isinstance(piece, str):
            yield from [Sentence(piece)] if piece else ()
        elif piece is not None:
            yield from parts_of(piece)


def strong(text: str) -> Sentence | None:
    """A sentence that is to be looked at first; nothing without words."""
    return Sentence(text, strong=True) if text else None


def listed(sentences: Iterable[str], heading: str = "") -> Iterator[Sentence]:
    """A list, below a heading where there is one; nothing without sentences."""
    for place, sentence in enumerate(sentences):
        if place == 0 and heading:
            yield Sentence(heading, strong=True)
        yield Sentence(f"- {sentence}")


# In a terminal, by rich: no word is cut there, and no number parted from its error.

#: What is never broken: a word, numbers with the signs of their errors between them, or "p = 0.3".
_WORD = re.compile(r"\S+(?: [±=<>] \S+)*")
#: Characters that a table takes for a column beside its text.
_RULES = 3
#: Characters of its last line.
_END = 1


def wrapped(content: str, width: int) -> str:
    """A text with line ends between its words; only words longer than the width are cut."""
    return "\n".join(line for paragraph in content.split("\n") for line in _lines(paragraph, width))


def _lines(content: str, width: int) -> Iterator[str]:
    """A text in lines of at most `width` columns; those of a list are indented."""
    if width >= UNLIMITED or cell_len(content) <= width:
        yield content
        return
    margin = "  " if content.startswith("- ") else ""
    line = ""
    for word in _WORD.findall(content):
        if line.strip() and cell_len(line) + 1 + cell_len(word) > width:
            yield line
            line = margin
        line += f" {word}" if line.strip() else word
        while cell_len(line) > width:
            yield line[:width]
            line = margin + line[width:]
    yield line


def sentence(content: str, width: int, style: str = "") -> Text:
    """A sentence for rich, for a terminal of so many characters."""
    return Text(wrapped(visible(content, keep="\n"), width), style=style)


def renderables(parts: Iterable[Part], width: int) -> Iterator[RenderableType]:
    """What rich prints, for a terminal of so many characters."""
    for part in parts:
        if isinstance(part, Table):
            yield from rich_tables(part, width)
        else:
            yield sentence(part.text, width, "bold" if part.strong else "")


def rich_tables(given: Table, width: int) -> Iterator[RichTable]:
    """A table for rich; where it is too wide, several with the same first column.

    Its cells are shown as they are, what looks like markup or an emoji too.
    """
    given = given.seen
    lines = [[column.title for column in given.columns]]
    lines += [[cell.text for cell in line.cells] for line in (*given.rows, *given.sums)]
    turned = zip(*lines, strict=True)
    columns = [[visible(content, keep="\n") for content in texts] for texts in turned]
    usual, least = [], []
    for at, (column, (head, *cells)) in enumerate(zip(given.columns, columns, strict=True)):
        widest = max((cell_len(part) for c in cells for part in c.split("\n")), default=0)
        breakable = (head, *cells) if at == 0 or column.left else (head,)
        words = max((cell_len(word) for c in breakable for word in _WORD.findall(c)), default=0)
        usual.append(max(widest, cell_len(head)))
        least.append(words if len(breakable) > 1 else max(words, widest))
    for place, block in enumerate(_blocks(least, width)):
        room = width - _END - _RULES * len(block) - sum(least[at] for at in block)
        wide = {at: least[at] for at in block}
        # what wants little gets it
        by_need = sorted(block, key=lambda at: usual[at] - least[at])
        for left, at in zip(range(len(block), 0, -1), by_need, strict=True):
            more = min(usual[at] - least[at], max(room, 0) // left)
            wide[at], room = wide[at] + more, room - more
        title = f"{given.title}, continued" if place and given.title else given.title
        shown = RichTable(title=title or None, title_justify="left", title_style="bold")
        # the first column has another width in every one
        broken = {at: [wrapped(content, wide[at]) for content in columns[at]] for at in block}
        for at in block:
            side: JustifyMethod = "left" if at == 0 or given.columns[at].left else "right"
            look: dict[str, Any] = {"style": "dim" if given.columns[at].small else ""}
            look |= {"no_wrap": True, "overflow": "fold"}
            shown.add_column(Text(broken[at][0]), justify=side, **look)
        for number, line in enumerate((*given.rows, *given.sums), start=1):
            if number == len(given.rows) + 1:
                shown.add_section()
            texts = [broken[at][number] for at in block]
            if place == 0 or any(texts[1:]):
                weight = "bold" if line.strong else "dim" if line.weak else ""
                shown.add_row(*map(Text, texts), style=weight)
        yield shown


def _blocks(least: Sequence[int], width: int) -> list[list[int]]:
    """Which columns stand beside each other: the first, with as many others as there is room."""
    blocks: list[list[int]] = [[0]]
    for at in range(1, len(least)):
        block = [*blocks[-1], at]
        taken = _END + sum(_RULES + least[place] for place in block)
        if taken > width and len(block) > 2:
            blocks.append([0, at])
        else:
            blocks[-1] = block
    return blocks


def text(described: Description, width: int = UNLIMITED) -> str:
    """The whole as lines of text."""
    stream = io.StringIO()
    # in a notebook rich would show each part by itself, and leave the text empty
    console = Console(file=stream, width=width, highlight=False, force_jupyter=False)
    for part in renderables(described.whole, width):
        console.print(part, soft_wrap=isinstance(part, Text))
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip("\n").split("\n"))
