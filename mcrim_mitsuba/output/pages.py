"""Descriptions as HTML: what notebooks, the report and the page are pages of."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import jinja2

from mcrim_mitsuba.core.errors import visible
from mcrim_mitsuba.core.rounding import capital, unbroken
from mcrim_mitsuba.output.description import Part, Piece, Table, parts_of


def environment(*loaders: jinja2.BaseLoader) -> jinja2.Environment:
    """What makes pages of this room's templates and others, with texts as they are."""
    pages = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=unbroken,
        loader=jinja2.ChoiceLoader([*loaders, jinja2.PackageLoader("mcrim_mitsuba", "output")]),
    )
    pages.filters |= {"capital": capital, "visible": visible}
    pages.globals["blocks"] = blocks
    return pages


def blocks(pieces: Iterable[Piece]) -> Iterator[tuple[str, list[Part]]]:
    """What stands together of some pieces: each a ``table``, a ``list`` or ``text``."""

    def kind(part: Part) -> str:
        if isinstance(part, Table):
            return "table"
        return "list" if part.text.startswith("- ") else "text"

    return ((name, list(parts)) for name, parts in itertools.groupby(parts_of(pieces), kind))
