"""What the pages of docs/ say of commands, effects and parts of a bench, as Markdown.

    python scripts/write_pages.py

It stands between marks in the pages, is read from the package itself, and may be read in a clone
without a built site. A test says when a page has fallen behind.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.cli.main import mcrim
from mcrim_mitsuba.core.files import write_text
from mcrim_mitsuba.core.rounding import capital
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.output.describe_campaign import not_modelled
from mcrim_mitsuba.transport.variants import use_variant

DOCS = Path(__file__).resolve().parents[1] / "docs"
_HELP_WIDTH = 88
#: What Markdown would take for a mark; an underscore within a word is none.
_SPECIAL = re.compile(r"([\\*\[\]<>$|]|(?<!\w)_|_(?!\w))")
#: An attribute in a plugin's docstring: names, type and default, and its indented meaning.
_ATTRIBUTE = re.compile(r"^(``.+?|nested .+?)(?: : (.*))?\n((?:    .+\n?)+)", re.MULTILINE)


def plain(text: str) -> str:
    """Text that Markdown takes as it is; what stands in backticks stays code."""
    parts = re.split(r"(`+[^`]*`+)", text)
    return "".join(part if part[:1] == "`" else _SPECIAL.sub(r"\\\1", part) for part in parts)


def table(*rows: tuple[str, ...]) -> list[str]:
    """Lines of a table; the first row is its head."""
    head, *others = (
        "| " + " | ".join(re.sub(r"(?<!\\)\|", r"\\|", cell) for cell in cells) + " |"
        for cells in rows
    )
    return [head, "|" + "---|" * len(rows[0]), *others]


# ---- commands --------------------------------------------------------------------------


def commands() -> Iterator[str]:
    """What every command says of itself, word for word."""
    yield from _command(mcrim, "mcrim", None, 2)


def _command(
    command: click.Command, name: str, above: click.Context | None, level: int
) -> Iterator[str]:
    context = command.make_context(
        name, [], parent=above, resilient_parsing=True, terminal_width=_HELP_WIDTH
    )
    yield from (f"{'#' * level} {context.command_path}", "")
    yield from ("```text", *command.get_help(context).splitlines(), "```", "")
    if isinstance(command, click.Group):
        for verb in command.list_commands(context):
            under = command.get_command(context, verb)
            assert under is not None
            yield from _command(under, verb, context, level + 1)


# ---- effects ---------------------------------------------------------------------------


def effects_table() -> Iterator[str]:
    """All effects of the catalogue, a row for each parameter."""
    rows = [
        (f"[{effect.name}](#{effect.name})", effect.group, *cells, _prediction(effect))
        for effect in catalogue().values()
        for cells in map(_parameter_cells, effect.parameters or (None,))
    ]
    yield from table(("effect", "part", "parameter", "range", "absent at", "predicted by"), *rows)


def effects_sections() -> Iterator[str]:
    """A section on each effect."""
    for effect in catalogue().values():
        yield f"## {effect.name}\n\n**{plain(capital(effect.title))}.** {plain(effect.physics)}\n"
        for parameter in effect.parameters:
            usual = _span(*parameter.plausible, parameter.unit)
            line = f"- `{parameter.name}`: {plain(parameter.meaning)}. Usual: {usual}."
            if parameter.nominal:
                line += f" Numbers are offsets from the scene's `{parameter.nominal}`."
            yield f"{line} A fit begins at {_number(parameter.start)}."
        if effect.parameters:
            yield ""
        if effect.filled_only:
            yield "Does nothing where the gap is not filled: `n_gap` at most 1.0005.\n"
        if effect.excludes:
            yield f"Excludes {', '.join(f'`{other}`' for other in effect.excludes)}.\n"
        yield f"Source: {plain(effect.source)}.\n"


def _number(value: float | None) -> str:
    if value is None:
        return "none"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:g}".replace("-", "−")


def _span(low: float, high: float, unit: str) -> str:
    if math.isinf(low) and math.isinf(high):
        return "any"
    return f"{_number(low)} to {_number(high)} {unit}".strip()


def _prediction(effect: Effect) -> str:
    """How a campaign's readings are predicted with the effect."""
    if effect.reading is not None:
        return "exactly, from the readings"
    return "simulation" if effect.weight is None else "weights of photon records"


def _parameter_cells(parameter: EffectParameter | None) -> tuple[str, str, str]:
    """A parameter's name, range, and where it is absent."""
    if parameter is None:
        return "on or off", "", "off"
    reach = _span(parameter.minimum, parameter.maximum, parameter.unit)
    if parameter.nominal:
        return f"`{parameter.name}`", f"offset of {reach}", "0"
    return f"`{parameter.name}`", reach, _number(parameter.absent)


def unmodelled() -> Iterator[str]:
    """What is in no effect and in no error, as `mcrim budget` prints it."""
    yield from table(("what", "what it does", "how much"), *not_modelled())


# ---- parts of a bench ------------------------------------------------------------------


def parts() -> Iterator[str]:
    """Every plugin of a kind with its attributes, as its class explains them."""
    use_variant()
    from mcrim_mitsuba.transport.plugins import bsdfs, light, shapes, solids, wrapping

    for module in (light, bsdfs, shapes, solids, wrapping):
        for plugin in dict.fromkeys(filter(inspect.isclass, vars(module).values())):
            if plugin.__module__ == module.__name__ and "XML:" in (plugin.__doc__ or ""):
                yield from _part(plugin)


def _part(plugin: type[Any]) -> Iterator[str]:
    text = inspect.getdoc(plugin) or ""
    told, _, xml = text.partition("XML:")
    element = re.search(r"``(<.+?>)(.*?)``", xml, re.DOTALL)
    assert element is not None, plugin
    name = re.search(r'type="(\w+)"', element[1])
    assert name is not None, plugin
    yield f"## {name[1]}\n\n{_paragraphs(told)}\n"
    attributes, end = [], element.end()
    for found in _ATTRIBUTE.finditer(xml):
        names, kind, meaning = found.groups(default="")
        attributes.append((names.replace("``", "`"), _paragraphs(kind), _paragraphs(meaning)))
        end = found.end()
    yield f"```xml\n{' '.join((element[1] + element[2]).split())}\n```\n"
    if attributes:
        yield from (*table(("attribute", "is", "meaning"), *attributes), "")
    after = re.split(r"\n(?:Attributes|Parameters)\n---", xml[end:])[0].strip()
    if attributes and after:
        yield f"{_paragraphs(after)}\n"


def _paragraphs(text: str) -> str:
    """Words of a docstring as Markdown: lines joined, code in single backticks."""
    joined = (" ".join(paragraph.split()) for paragraph in inspect.cleandoc(text).split("\n\n"))
    return plain("\n\n".join(joined).replace("``", "`").strip())


# ---- pages -----------------------------------------------------------------------------

#: By page and mark.
WRITERS: dict[tuple[str, str], Callable[[], Iterator[str]]] = {
    ("commands.md", "commands"): commands,
    ("effects.md", "table"): effects_table,
    ("effects.md", "sections"): effects_sections,
    ("theory.md", "not modelled"): unmodelled,
    ("parts.md", "parts"): parts,
}


def written(page: str, text: str) -> str:
    """The text of a page with all that stands between its marks written anew."""
    for (name, mark), lines in WRITERS.items():
        if name == page:
            begin, end = f"<!-- {mark}: scripts/write_pages.py -->", f"<!-- end of {mark} -->"
            before, _, behind = text.partition(begin)
            _, found, behind = behind.partition(end)
            assert found, f"docs/{page} lacks the marks of {mark}"
            body = "\n".join(lines()).strip()
            text = f"{before}{begin}\n\n{body}\n\n{end}{behind}"
    return text


@click.command()
def main() -> None:
    """Write all pages of docs/ that say what the package says of itself."""
    for page in dict.fromkeys(name for name, _ in WRITERS):
        path = DOCS / page
        write_text(path, written(page, path.read_text(encoding="utf-8")))


if __name__ == "__main__":
    sys.exit(terminal.run(main, "write_pages"))
