"""What a result looks like, said once: tables and sentences, shown by a terminal or a notebook.

A description holds texts as people read them and, in the cells of its tables, the numbers behind
them. `descriptions` makes one of every result; `text`, `renderables` (of rich), `html` and
`Table.frame` show it.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from markupsafe import Markup
from rich.console import Console, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from mcrim_mitsuba.core.errors import visible
from mcrim_mitsuba.core.rounding import pdg

if TYPE_CHECKING:
    import pandas

#: Characters of a terminal from which tables show all their columns.
WIDE = 150
#: Characters of what has no width of its own, such as a pipe: tables are never cut there.
UNLIMITED = 200


@dataclass(frozen=True)
class Column:
    """A column of a table; all but the first are numbers, unless they stand at the left."""

    #: As it is shown, with the unit.
    title: str
    #: As a data frame has it; the error of NAME is NAME_sigma. Empty: as the title.
    name: str = ""
    left: bool = False
    #: Whether it is left out where there is no room.
    wide: bool = False


@dataclass(frozen=True)
class Cell:
    """A text and what it stands for."""

    text: str
    value: object = None
    #: Standard error of the value, where the text has one.
    sigma: float | None = None


@dataclass(frozen=True)
class TableRow:
    """A row of a table."""

    cells: tuple[Cell, ...]
    #: Whether it is to be looked at first.
    strong: bool = False


@dataclass(frozen=True)
class Table:
    """A table with its title, which may be empty."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    #: Rows below a rule.
    sums: tuple[TableRow, ...] = ()

    def frame(self) -> pandas.DataFrame:
        """Numbers of the rows, errors in columns of their own: ``NAME_sigma`` after ``NAME``."""
        import pandas

        columns: dict[str, list] = {}
        for place, column in enumerate(self.columns):
            name, cells = column.name or column.title, [row.cells[place] for row in self.rows]
            columns[name] = [cell.value for cell in cells]
            if any(cell.sigma is not None for cell in cells):
                columns[f"{name}_sigma"] = [cell.sigma for cell in cells]
        return pandas.DataFrame(columns)


@dataclass(frozen=True)
class Sentence:
    """A line of text."""

    text: str
    #: Whether it is to be looked at first.
    strong: bool = False
    #: Whether it is said only where columns are left out.
    narrow: bool = False


#: What a description is made of.
Part = Table | Sentence


@dataclass(frozen=True)
class Described:
    """A result as it is shown."""

    #: What it is, in a few words.
    title: str
    parts: tuple[Part, ...]
    #: What it rests on: photons, seed, time.
    spent: str = ""
    #: What the reader must know before using the numbers.
    notes: tuple[str, ...] = ()

    @property
    def tables(self) -> dict[str, Table]:
        """By title."""
        return {part.title: part for part in self.parts if isinstance(part, Table)}


def table(
    title: str,
    columns: Iterable[str | Column],
    rows: Iterable[TableRow | Iterable[str | Cell]],
    sums: Iterable[TableRow | Iterable[str | Cell]] = (),
) -> Table:
    """A table from columns by title and rows of texts or cells."""
    heads = tuple(Column(one) if isinstance(one, str) else one for one in columns)
    below, above = (
        tuple(one if isinstance(one, TableRow) else row(*one) for one in some)
        for some in (sums, rows)
    )
    return Table(title, heads, above, below)


def row(*cells: str | Cell, strong: bool = False) -> TableRow:
    """A row; a text stands for itself."""
    return TableRow(tuple(Cell(c, c or None) if isinstance(c, str) else c for c in cells), strong)


def measured(value: float, sigma: float | None) -> Cell:
    """A value with its error."""
    return Cell(pdg(value, sigma), value, sigma)


def shown(value: Any, form: str | Callable[[Any], str]) -> Cell:
    """A number by a format, which has nothing to show where there is none, or by a function."""
    if callable(form):
        return Cell(form(value), value)
    return Cell("" if value is None else format(value, form), value)


def listed(heading: str, sentences: Iterable[str]) -> Iterator[Sentence]:
    """A heading with a list below; nothing without sentences."""
    for place, sentence in enumerate(sentences):
        if place == 0:
            yield Sentence(heading, strong=True)
        yield Sentence(f"- {sentence}")


# In a terminal, by rich.


def renderables(parts: Iterable[Part], width: int) -> Iterator[RenderableType]:
    """What rich prints, for a terminal of so many characters."""
    for part in parts:
        if isinstance(part, Table):
            yield rich_table(part, wide=width >= WIDE)
        elif not part.narrow or width < WIDE:
            yield Text(part.text, style="bold" if part.strong else "")


def rich_table(given: Table, *, wide: bool = True) -> RichTable:
    """A table for rich; its cells are shown as they are, what looks like markup or an emoji too."""
    made = RichTable(title=given.title or None, title_justify="left", title_style="bold")
    places = [at for at, column in enumerate(given.columns) if wide or not column.wide]
    for at in places:
        column = given.columns[at]
        made.add_column(
            Text(visible(column.title)), justify="left" if at == 0 or column.left else "right",
            overflow="fold",
        )  # fmt: skip
    for number, one in enumerate((*given.rows, *given.sums)):
        if number == len(given.rows):
            made.add_section()
        texts = (Text(visible(one.cells[at].text, keep="\n")) for at in places)
        made.add_row(*texts, style="bold" if one.strong else "")
    return made


def text(described: Described, width: int = UNLIMITED) -> str:
    """The whole as lines of text."""
    stream = io.StringIO()
    console = Console(file=stream, width=width, highlight=False)
    for part in renderables(described.parts, width):
        console.print(part, soft_wrap=isinstance(part, Text))
    for line in (described.spent, *(f"note: {note}" for note in described.notes)):
        if line:
            console.print(Text(visible(line)), soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip("\n").split("\n"))


# In a notebook.


def html(described: Described) -> Markup:
    """The whole as a piece of a page; all texts are shown as they are."""
    parts = [_html_table(p) if isinstance(p, Table) else _html_line(p) for p in described.parts]
    spent = [_line(described.spent)] if described.spent else []
    notes = [_line(f"note: {note}") for note in described.notes]
    return Markup("<div>{}</div>").format(Markup("\n").join([*parts, *spent, *notes]))


def _html_line(sentence: Sentence) -> Markup:
    return Markup("") if sentence.narrow else _line(sentence.text, sentence.strong)


def _line(content: str, strong: bool = False) -> Markup:
    inner = Markup("<strong>{}</strong>" if strong else "{}").format(visible(content))
    return Markup("<p>{}</p>").format(inner)


def _html_table(given: Table) -> Markup:
    def line(tag: str, texts: Iterable[str], strong: bool = False) -> Markup:
        cells = (
            Markup('<{} style="text-align:{}{}">{}</{}>').format(
                tag, "left" if at == 0 or column.left else "right",
                ";font-weight:bold" if strong else "", visible(content, keep="\n"), tag,
            )
            for at, (column, content) in enumerate(zip(given.columns, texts, strict=True))
        )  # fmt: skip
        return Markup("<tr>{}</tr>").format(Markup("").join(cells))

    title = Markup("<caption>{}</caption>").format(visible(given.title)) if given.title else ""
    head = line("th", (column.title for column in given.columns))
    rows = [line("td", (c.text for c in r.cells), r.strong) for r in (*given.rows, *given.sums)]
    return Markup("<table>{}<thead>{}</thead><tbody>{}</tbody></table>").format(
        title, head, Markup("").join(rows)
    )
